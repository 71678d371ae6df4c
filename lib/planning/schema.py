"""The JSON Schema of scene.yaml, by which editors complete and check it, from the tables that rules.py checks by.

    $ python -m lib.planning.schema > docs/scene.schema.json

A schema sees one file. What hangs on others (names of the model, files of the folder), that a value stands there once
under two keys, and what compares numbers (rho_d + rho_s, alpha_x >= alpha_y) the program says alone. Draft 7: what
editors know.
"""

import json
import math
from pathlib import Path

from lib.core.stage import option_of
from lib.given import causes
from lib.given.kinds import KINDS, LOBES, MIRRORS
from lib.given.units import METRES
from lib.planning import augment, rules
from lib.planning.files import GROUPS_OF, export_kind
from lib.planning.pipeline import read_pipeline

ROOT = Path(__file__).resolve().parents[2]
DRAFT = "http://json-schema.org/draft-07/schema#"
FILE = {"type": "string", "minLength": 1, "not": {"pattern": r"\||^/|(^|/)\.\.(/|$)"}}
POSITIVE = {"type": "number", "exclusiveMinimum": 0}
UNKNOWN = {"const": "unknown"}
WORDS = {
    "board": "The chessboard of boards/: inner corners across and down, and the side of a square in metres.",
    "lens": "mrcal's lens model that is fitted to the boards.",
    "camera": "The pose of `left` in numbers, in the model's frame: metres, degrees.",
    "lamps": "Groups of the model that emit: emittance for R, G, B in units of the photograph's white, or unknown.",
    "reference": "Groups whose diffuse reflectance is known: shares of the light for R, G, B, linear.",
    "transfer": "How the camera makes displayed values of light. Default: auto, linear for EXR.",
    "surfaces": "Groups whose kind is known; the others are decided from the error.",
    "explain": "Causes that may be taken where the picture as a whole disagrees; []: none. Default: all.",
    "refine": "What of the model may be moved by centimetres to fit both photographs.",
    "movable": "Objects of the model that have a pose of their own each.",
    "model": "Unit of the model's lengths (default: m), and which of its axes is up (default: z).",
    "photos": "What is known of photos/<name>: exposure relative to `left`, lamps that differ.",
    "goals": "Files that are wanted; the plan leaves out what none of them needs.",
    "augment": "New pictures of the recovered scene, each a goal: docs/augment.md.",
    "exports": "The recovered scene for other programs, each a goal: docs/exports.md.",
    "params": "Numbers and methods of pipeline.yaml, by stage.",
}


# ---- pieces ----


def record(properties, required=(), **more):
    """A mapping of these keys and no others."""
    known = {"type": "object", "properties": properties, "additionalProperties": False}
    return known | ({"required": list(required)} if required else {}) | more


def named(item):
    """A mapping from names (groups, objects, lamps, stages)."""
    return {"type": "object", "propertyNames": {"type": "string", "minLength": 1}, "additionalProperties": item}


def three(low=-math.inf, high=math.inf, **more):
    """Three numbers from low to high."""
    ends = {"minimum": low, "maximum": high}
    item = {"type": "number", **{key: end for key, end in ends.items() if math.isfinite(end)}, **more}
    return {"type": "array", "items": item, "minItems": 3, "maxItems": 3}


def names_of(item):
    return {"type": "array", "items": item, "uniqueItems": True}


NAMES = names_of({"type": "string", "minLength": 1})
RHO, EMITTANCE, PLACE = three(0, 1), three(0), three()
DIRECTION = three() | {"contains": {"not": {"const": 0}}}  # of any length but 0


# ---- the keys ----


def lamps():
    lobe = record(
        {"aim": DIRECTION, "exponent": {"type": "number", "minimum": 0, "maximum": rules.SHARPEST}},
        ["aim", "exponent"],
    )
    emittance = {"anyOf": [UNKNOWN, EMITTANCE]}
    more = {"emittance": emittance, "place_sigma_m": POSITIVE, "lobe": {"anyOf": [UNKNOWN, lobe]}}
    return named({"anyOf": [UNKNOWN, EMITTANCE, record(more, ["emittance"])]})


def camera():
    angle = {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 180}
    return record({"eye": PLACE, "at": PLACE, "up": PLACE, "hfov_deg": angle}, ["eye", "at", "hfov_deg"])


def board():
    corners = {"type": "array", "items": {"type": "integer", "minimum": 2}, "minItems": 2, "maxItems": 2}
    square = POSITIVE | {"maximum": rules.LARGEST_SQUARE_M}
    return record({"corners": corners, "square_m": square}, ["corners", "square_m"])


def transfer():
    told = [record({"gamma": POSITIVE}, ["gamma"]), record({"curve": FILE}, ["curve"])]
    return {"anyOf": [{"enum": list(rules.TRANSFERS)}, *told]}


def photos():
    exposure = {"anyOf": [UNKNOWN, POSITIVE]}
    return named(record({"exposure": exposure, "lamps": named(EMITTANCE)}))


def goals(stages):
    """Files that stages write, for completion; others may be given, or stand for an entry of `augment`."""
    made = sorted({file for stage in stages.values() for file in stage.files if not set("<>*") & set(file)})
    return {"type": "array", "items": {"anyOf": [{"enum": made}, FILE]}}


def exports(stages):
    files = (file for stage in stages.values() for file in stage.files)
    return names_of({"enum": list(dict.fromkeys(filter(None, map(export_kind, files))))})


def params(stages):
    return record({name: record(dict(_params(stage))) for name, stage in stages.items()})


def _params(stage):
    """(name, schema) of a stage's numbers: the kind of their default, the choices and bounds of its options."""
    parser = stage.parser()
    options = {option: action for action in (parser._actions if parser else ()) for option in action.option_strings}
    for name, default in stage.params.items():
        action = options.get(option_of(name))
        known = _kind(default, action)
        words = {"description": action.help} if action is not None and action.help else {}
        yield name, words | known | ({} if default is None else {"default": default})


def _kind(default, action):
    if action is not None and action.choices:
        return {"enum": list(action.choices)}
    bounds = _bounds(action)
    if isinstance(default, bool):
        return {"type": "boolean"}
    if isinstance(default, int):
        return {"type": "integer", **bounds}
    if isinstance(default, float):
        return {"type": "number", **bounds}
    if default == "auto":
        return {"anyOf": [{"const": "auto"}, {"type": "number", **bounds}]}
    return {"type": "string"} if isinstance(default, str) else {"type": ["number", "string"]}


def _bounds(action):
    """Of an option whose type is `whole` or `real` of lib/core/stage.py."""
    found = getattr(action and action.type, "bounds", None)
    if found is None:
        return {}
    _, low, high, open_low, open_high = found
    ends = {"exclusiveMinimum" if open_low else "minimum": low}
    if high is not None:
        ends["exclusiveMaximum" if open_high else "maximum"] = high
    return {key: end for key, end in ends.items() if math.isfinite(end)}


# ---- augment ----


def material(whole):
    """whole : of an added object, which must have all that its kind needs; else a change of a group."""
    low, high = augment.ALPHA
    alpha = {"type": "array", "items": {"type": "number", "minimum": low, "maximum": high}}
    known = {
        "kind": {"enum": list(KINDS)},
        "rho_d": RHO,
        "rho_s": RHO,
        "alpha": alpha | {"minItems": 2, "maxItems": 2},
        "tangent": DIRECTION,
        "texture": FILE,
        "emittance": EMITTANCE,
    }
    assert known.keys() == set(augment.MATERIAL)
    if not whole:
        del known["emittance"]
    meant = {"alpha": LOBES, "texture": ("textured",), "rho_s": (*LOBES, *MIRRORS)}
    rules_of = [
        {
            "if": {"properties": {"kind": {"const": kind}}, "required": ["kind"]},
            "then": {
                "required": list(augment.NEEDED[kind]),
                "properties": {key: False for key, kinds in meant.items() if kind not in kinds},
            },
        }
        for kind in KINDS
    ]
    more = {"anyOf": [{"required": ["kind"]}, {"required": ["emittance"]}]} if whole else {}
    return record(known, **more, allOf=rules_of)


def added():
    """One object of `add`: a file, whose groups may have a material each, or a smooth shape of one material."""
    one = {"$ref": "#/definitions/material"}
    place = {"at": PLACE, "scale": POSITIVE, "rotate": PLACE}
    plain = {"allOf": [one, {"properties": {"kind": {"not": {"const": "textured"}}}}]}
    file = FILE | {"pattern": rf"\.({'|'.join(GROUPS_OF)})$"}
    shapes = {
        "file": (file, {"anyOf": [one, named(one)]}),
        "ellipsoid": (three(exclusiveMinimum=0), plain),
        "sphere": (POSITIVE, plain),
    }
    assert shapes.keys() == set(augment.SHAPES) and place.keys() == set(augment.PLACE)
    return {
        "oneOf": [
            record({shape: what, **place, "material": of}, [shape, "material"]) for shape, (what, of) in shapes.items()
        ]
    }


def entry():
    thing = {"$ref": "#/definitions/added"}
    frames = {"type": "integer", "minimum": 2, "maximum": 9999}
    listed = {"type": "array", "items": FILE, "minItems": 2}
    known = {
        "name": {"type": "string", "pattern": f"^{rules.NAME.pattern}$"},
        "camera": FILE,
        "cameras": {"anyOf": [listed, FILE | {"pattern": r"\.csv$"}]},
        "frames": frames,
        "add": {"anyOf": [thing, {"type": "array", "items": thing}]},
        "change": named({"$ref": "#/definitions/change"}),
        "remove": NAMES,
        "move": named(PLACE),
        "lamps": named(EMITTANCE),
        "grain": {"type": "boolean"},
    }
    assert known.keys() == set(augment.KEYS)
    rules_of = [
        {"not": {"required": ["camera", "cameras"]}},
        {
            "if": {"properties": {"cameras": {"type": "array"}}, "required": ["cameras"]},
            "then": {"required": ["frames"]},
        },
    ]
    return record(known, ["name"], dependencies={"frames": ["cameras"]}, allOf=rules_of)


# ---- all ----


def schema(stages) -> dict:
    """stages : name -> pipeline.Stage"""
    keys = {
        "board": board(),
        "lens": {"type": "string", "pattern": f"^{rules.LENS.pattern}$"},
        "camera": camera(),
        "lamps": lamps(),
        "reference": named(RHO),
        "transfer": transfer(),
        "surfaces": named({"enum": list(KINDS)}),
        "explain": {"type": "array", "items": {"enum": list(causes.BUILT)}},
        "refine": names_of({"enum": list(rules.REFINED)}),
        "movable": NAMES,
        "model": record({"unit": {"enum": list(METRES)}, "up": {"enum": list(rules.AXES)}}),
        "photos": photos(),
        "goals": goals(stages),
        "augment": {"type": "array", "items": entry()},
        "exports": exports(stages),
        "params": params(stages),
    }
    assert keys.keys() == set(rules.KEYS) == WORDS.keys()
    return {
        "$schema": DRAFT,
        "title": "scene.yaml of anasyn",
        "description": "Facts and goals of a scene: data/SCENE.md, section 3. Made by python -m lib.planning.schema.",
        **record({key: {"description": WORDS[key], **value} for key, value in keys.items()}),
        "type": ["object", "null"],
        "definitions": {"material": material(whole=True), "change": material(whole=False), "added": added()},
    }


def text() -> str:
    """docs/scene.schema.json"""
    return json.dumps(schema(read_pipeline(ROOT / "pipeline.yaml")), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    print(text(), end="")
