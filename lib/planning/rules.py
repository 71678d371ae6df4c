"""The rules of data/SCENE.md, section 3: one function for each key of scene.yaml.

Each yields (field, value, what is wrong).
"""

import argparse
import json
import math
import re

from lib.core.bounded import lies_outside
from lib.core.stage import option_of
from lib.given import causes, transfer_kinds
from lib.given.kinds import KINDS
from lib.given.units import METRES
from lib.planning.near_misses import alike

NAME = re.compile(r"[A-Za-z0-9_-]+")
LENS = re.compile(r"LENSMODEL_[A-Z0-9]+(_[A-Za-z0-9_.=-]+)?")
AUGMENTED = re.compile(r"augmented\.[A-Za-z0-9_-]+\.(png|exr|mp4)")  # goals that an entry of `augment` makes
LATER = ("sky", "materials", "colorchecker")  # keys of data/SCENE.md that are not built yet
KEYS = (
    *("board", "lens", "camera", "lamps", "reference", "transfer", "surfaces", "explain", "refine", "movable"),
    *("model", "photos", "goals", "augment", "exports", "params"),
)
REFINED = ("objects",)  # what `refine` may name
LARGEST_SQUARE_M = 2.0  # m: a chessboard with larger squares is measured in another unit
SHARPEST = 1000  # exponent of a lamp's lobe
AXES = ("x", "y", "z", "-x", "-y", "-z")
TRANSFERS = ("auto", *transfer_kinds.KINDS)


def show(value) -> str:
    """A value in a message, on one line of at most 80 characters."""
    try:
        text = json.dumps(value, default=str, ensure_ascii=False)
    except (ValueError, TypeError):  # holds itself, or keys that JSON has not
        text = str(value)
    return text if len(text) <= 80 else text[:77] + "..."


def finite(value) -> bool:
    """A number, and neither a boolean nor infinite.

    >>> [finite(v) for v in (1, 0.5, True, float("nan"), "1", 10**400)]
    [True, True, False, False, False, False]
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


# ---- the rules, one function for each key ----


def mapping(key, value):
    """The entries of a mapping from names; yields its own problems and returns the rest."""
    if not isinstance(value, dict):
        hint = f": write {key}: {{{value}: unknown}}" if key == "lamps" and isinstance(value, str) else ""
        yield key, value, f"is not a mapping{hint}"
        return {}
    for name in value:
        if not isinstance(name, str) or not name:
            yield key, name, "is not a name (quote it)"
    return {name: item for name, item in value.items() if isinstance(name, str) and name}


def three(key, value, low, high, what):
    if not (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in value)
    ):
        yield key, value, f"is not a list of three numbers{what}"
    elif not all(map(finite, value)):
        yield key, value, "is not finite"
    elif not all(low <= v <= high for v in value):
        percent = high == 1 and all(v == 0 or 2 <= v <= 100 for v in value)
        hint = f": {max(value):g} % is {max(value) / 100:g}" if percent else ""
        yield key, value, "is negative" if high == math.inf else f"is outside [{low}, {high}]{hint}"


def board(value):
    known = yield from mapping("board", value)
    for key in sorted(known.keys() - {"corners", "square_m"}):
        yield f"board.{key}", known[key], "is an unknown key; known are corners, square_m"
    for key in [k for k in ("corners", "square_m") if k not in known]:
        yield f"board.{key}", None, "is missing"
    corners = known.get("corners", [2, 2])
    if not (isinstance(corners, list) and len(corners) == 2 and all(type(c) is int and c >= 2 for c in corners)):
        yield "board.corners", corners, "is not two whole numbers of at least 2"
    square = known.get("square_m", 1.0)
    if not (finite(square) and square > 0):
        yield "board.square_m", square, "is not a positive length in metres"
    elif square > LARGEST_SQUARE_M:
        yield "board.square_m", square, f"is in metres: {square:g} mm are {square / 1000:g}"


def lens(value):
    if not (isinstance(value, str) and LENS.fullmatch(value)):
        yield "lens", value, "is not a name of a mrcal lens model, LENSMODEL_..."


def camera(value):
    known = yield from mapping("camera", value)
    for key in sorted(known.keys() - {"eye", "at", "up", "hfov_deg"}):
        yield f"camera.{key}", known[key], "is an unknown key; known are eye, at, up, hfov_deg"
    for key in [k for k in ("eye", "at", "hfov_deg") if k not in known]:
        yield f"camera.{key}", None, "is missing"
    sound = []
    for key in [k for k in ("eye", "at", "up") if k in known]:
        problems = list(three(f"camera.{key}", known[key], -math.inf, math.inf, ""))
        sound += [] if problems else [key]
        yield from problems
    angle = known.get("hfov_deg", 60)
    if not (finite(angle) and 0 < angle < 180):
        yield "camera.hfov_deg", angle, "is not an angle between 0 and 180 degrees"
    if {"eye", "at"} <= set(sound) and ("up" in sound or "up" not in known):
        view = [a - b for a, b in zip(known["at"], known["eye"], strict=True)]
        up = known.get("up", [0, 0, 1])
        across = [view[i] * up[j] - view[j] * up[i] for i, j in ((1, 2), (2, 0), (0, 1))]
        if not any(view):
            yield "camera.at", known["at"], "is where the eye is"
        elif math.hypot(*across) <= 1e-9 * math.hypot(*view) * math.hypot(*up):
            yield "camera.up", up, "lies along the view from eye to at"


def lamps(value):
    for name, lamp in (yield from mapping("lamps", value)).items():
        where, emittance = f"lamps.{name}", lamp
        if isinstance(lamp, dict):
            where, emittance = f"{where}.emittance", lamp.get("emittance")
            yield from _more_of_lamp(f"lamps.{name}", lamp)
        if emittance != "unknown":
            yield from three(where, emittance, 0, math.inf, " or `unknown`")


def _more_of_lamp(where, lamp):
    """What a lamp's mapping says beside its emittance."""
    for key, value in lamp.items():
        if key == "gradient":
            yield f"{where}.{key}", value, "is not built yet"
        elif key == "lobe":
            yield from _lobe(f"{where}.lobe", value)
        elif key not in ("emittance", "place_sigma_m"):
            known = "emittance, place_sigma_m, lobe, gradient"
            yield f"{where}.{key}", value, f"is an unknown key; known are {known}"
    sigma = lamp.get("place_sigma_m", 1.0)
    if not (finite(sigma) and sigma > 0):
        yield f"{where}.place_sigma_m", sigma, "is not a positive length in metres"


def _lobe(where, value):
    """`unknown`, or aim and exponent."""
    if value == "unknown":
        return
    known = value if isinstance(value, dict) else {}
    if "ies" in known:
        yield f"{where}.ies", known["ies"], "is not built yet"
    elif known.keys() != {"aim", "exponent"}:
        yield where, value, "is neither `unknown` nor {aim: [x, y, z], exponent: n}"
    else:
        aim, exponent = known["aim"], known["exponent"]
        if not (isinstance(aim, list) and len(aim) == 3 and all(map(finite, aim)) and any(aim)):
            yield f"{where}.aim", aim, "is not a direction, three numbers"
        if not (finite(exponent) and 0 <= exponent <= SHARPEST):
            yield f"{where}.exponent", exponent, f"is not a number from 0 to {SHARPEST}"


def reference(value):
    for name, rho in (yield from mapping("reference", value)).items():
        yield from three(f"reference.{name}", rho, 0, 1, "")


def explain(value):
    if not isinstance(value, list):
        yield "explain", value, f"is not a list of {', '.join(causes.CAUSES)}"
        return
    for cause in value:
        if cause not in causes.CAUSES:
            yield "explain", cause, f"is none of {', '.join(causes.CAUSES)}"
        elif cause not in causes.BUILT:
            yield "explain", cause, "is not built yet"


def refine(value):
    yield from names_of("refine", value, f"a list of {', '.join(REFINED)}")
    for name in value if isinstance(value, list) else ():
        if isinstance(name, str) and name and name not in REFINED:
            yield "refine", name, f"is none of {', '.join(REFINED)}"


def movable(value):
    yield from names_of("movable", value, "a list of objects of the model")


def names_of(key, value, what):
    """A list of different names."""
    if not isinstance(value, list):
        yield key, value, f"is not {what}"
        return
    for number, name in enumerate(value):
        if not isinstance(name, str) or not name:
            yield key, name, "is not a name (quote it)"
        elif name in value[:number]:
            yield key, name, "stands there twice"


def model(value):
    known = yield from mapping("model", value)
    for key in sorted(known.keys() - {"unit", "up"}):
        yield f"model.{key}", known[key], "is an unknown key; known are unit, up"
    for key, words in (("unit", METRES), ("up", AXES)):
        if key in known and (not isinstance(known[key], str) or known[key] not in words):
            yield f"model.{key}", known[key], f"is none of {', '.join(words)}"


def transfer(value, scene):
    if isinstance(value, dict):
        for key in sorted(map(str, value.keys() - {"gamma", "curve"})):
            yield f"transfer.{key}", value.get(key), "is an unknown key; known are gamma, curve"
        if len(value.keys() & {"gamma", "curve"}) != 1:
            yield "transfer", value, "is neither one gamma nor one curve"
        elif "gamma" in value and not (finite(value["gamma"]) and value["gamma"] > 0):
            yield "transfer.gamma", value["gamma"], "is not a positive number"
        elif "curve" in value:
            yield from scene_file("transfer.curve", value["curve"], scene)
    elif not isinstance(value, str) or value not in TRANSFERS:
        yield "transfer", value, f"is none of {', '.join(TRANSFERS)}, {{gamma: 2.2}}, {{curve: file.json}}"


def scene_file(key, value, scene):
    """A file of the scene's folder."""
    if not isinstance(value, str) or not value or "|" in value:
        yield key, value, "is not a file's name"
    elif lies_outside(value):
        yield key, value, "lies outside the scene's folder"
    elif not scene.given(value):
        yield key, value, "is not in the scene's folder"


def surfaces(value):
    for name, kind in (yield from mapping("surfaces", value)).items():
        if not isinstance(kind, str) or kind not in KINDS:
            late = "is not built yet" if kind == "glass" else f"is none of {', '.join(KINDS)}"
            yield f"surfaces.{name}", kind, late


def photos(value, there):
    """there : names of the photographs in photos/"""
    for name, said in (yield from mapping("photos", value)).items():
        where = f"photos.{name}"
        if name not in there:
            known = f"it has {', '.join(sorted(there))}" if there else "there is none"
            yield where, said, f"names no photograph of photos/: {known}"
        if not isinstance(said, dict):
            yield where, said, "is not a mapping"
            continue
        for key in sorted(map(str, said.keys() - {"exposure", "lamps"})):
            yield f"{where}.{key}", said.get(key), "is an unknown key; known are exposure, lamps"
        exposure = said.get("exposure", "unknown")
        if exposure != "unknown" and not (finite(exposure) and exposure > 0):
            yield f"{where}.exposure", exposure, "is neither a positive number nor `unknown`"
        for lamp, emittance in (yield from mapping(f"{where}.lamps", said.get("lamps", {}))).items():
            yield from three(f"{where}.lamps.{lamp}", emittance, 0, math.inf, "")


def goals(value, known, scene):
    if not isinstance(value, list):
        yield "goals", value, "is not a list"
        return
    for goal in value:
        if not isinstance(goal, str) or not goal:
            yield "goals", goal, "is not a file's name"
        elif lies_outside(goal):
            yield "goals", goal, "lies outside the scene's folder"
        elif not (goal in known or AUGMENTED.fullmatch(goal)) and not (
            scene.given(goal) and "|" not in goal and not goal.startswith("truth/")
        ):
            yield "goals", goal, f"is neither made by a stage nor given{alike(goal, known)}"


def exports(value, kinds):
    """kinds : of exports that a stage writes"""
    yield from names_of("exports", value, f"a list of {', '.join(kinds)}")
    for name in value if isinstance(value, list) else ():
        if isinstance(name, str) and name and name not in kinds:
            yield "exports", name, f"is none of {', '.join(kinds)}"


def params(value, stages):
    for stage, settings in (yield from mapping("params", value)).items():
        if stage not in stages:
            yield f"params.{stage}", settings, f"belongs to no stage; stages are {', '.join(stages)}"
            continue
        known = stages[stage].params
        for name, setting in (yield from mapping(f"params.{stage}", settings)).items():
            where = f"params.{stage}.{name}"
            if name not in known:
                yield where, setting, f"is no number of {stage}, which has {', '.join(known) or 'none'}"
            else:
                problems = list(_param(where, setting, known[name]))
                yield from problems or _refused_by_stage(stages[stage], where, name, setting)


def _refused_by_stage(stage, where, name, value):
    """What the stage's own option says of the value: choices and ranges, before any stage runs."""
    parser = stage.parser()
    action = next((a for a in parser._actions if option_of(name) in a.option_strings), None) if parser else None
    if action is None or value is None:
        return
    text = value if isinstance(value, str) else json.dumps(value)
    try:
        parsed = action.type(text) if action.type else text
    except (argparse.ArgumentTypeError, TypeError, ValueError) as error:
        wrong = str(error).removeprefix(f"{text!r} ").removeprefix(f"{text} ")
        yield where, value, wrong or "cannot be used"
        return
    if action.choices and parsed not in action.choices:
        yield where, value, f"is none of {', '.join(map(str, action.choices))}"


def _param(where, value, default):
    """The kind of value that the default is; where there is no default, any plain one."""
    if isinstance(value, float) and not math.isfinite(value):
        yield where, value, "is not finite"
    elif isinstance(default, bool):
        if not isinstance(value, bool):
            yield where, value, "is neither true nor false"
    elif isinstance(default, int):
        if type(value) is not int:
            yield where, value, "is not a whole number"
    elif isinstance(default, float):
        if not finite(value):
            yield where, value, "is not a number"
    elif default == "auto":
        if not (value == "auto" or finite(value)):
            yield where, value, "is neither a number nor `auto`"
    elif isinstance(default, str):
        if not isinstance(value, str):
            yield where, value, "is not a word"
    elif not isinstance(value, (int, float, str)):
        yield where, value, "is neither a number nor a word"
