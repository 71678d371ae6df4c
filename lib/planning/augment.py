"""The rules of `augment` in scene.yaml (data/SCENE.md, section 3): its syntax, and the files that an entry names.

The checks of one entry need no scene, so that the stage makes them too. Each yields (field, value, what is wrong).
"""

import functools
import math
from pathlib import Path

from lib.core.stage import BadInput
from lib.given.kinds import KINDS, LOBES, MIRRORS, NAMELESS
from lib.planning.files import GROUPS_OF
from lib.planning.rules import NAME, finite, mapping, names_of, scene_file, show, three

KEYS = ("name", "camera", "cameras", "frames", "add", "change", "remove", "move", "lamps", "grain")
SHAPES = ("file", "ellipsoid", "sphere")  # one of which an added object has
PLACE = ("at", "scale", "rotate")
MATERIAL = ("kind", "rho_d", "rho_s", "alpha", "tangent", "texture", "emittance")
NEEDED = {"glossy": ("rho_d", "rho_s", "alpha"), "textured": ("texture",), "coloured_mirror": ("rho_s",)}
NEEDED |= {"diffuse": ("rho_d",), "mirror": ()}
ALPHA = 1e-4, 2.0  # Ward's


def augment(value, scene):
    """The whole list, its files looked for in the scene's folder."""
    if not isinstance(value, list):
        yield "augment", value, "is not a list"
        return
    names = set()
    for number, one in enumerate(value):
        where = f"augment[{number}]"
        if not isinstance(one, dict):
            yield where, one, "is not a mapping"
            continue
        yield from entry(where, one)
        name = one.get("name")
        if isinstance(name, str) and name in names:
            yield f"{where}.name", name, "stands there twice"
        elif isinstance(name, str):
            names.add(name)
        for key, file in files(one):
            yield from scene_file(f"{where}.{key}", file, scene)


def entry(where, value):
    """One entry; that its files are there is not looked at."""
    for key in value.keys() - set(KEYS):
        yield f"{where}.{key}", value[key], f"is an unknown key; known are {', '.join(KEYS)}"
    name = value.get("name")
    if not isinstance(name, str) or not NAME.fullmatch(name):
        yield f"{where}.name", name, "is not a name of letters, digits, _ and -"
    yield from _cameras(where, value)
    for number, thing in enumerate(listed(value.get("add", []))):
        yield from _added(f"{where}.add" + f"[{number}]" * isinstance(value["add"], list), thing)
    for group, material in (yield from mapping(f"{where}.change", value.get("change", {}))).items():
        yield from _material(f"{where}.change.{group}", material, whole=False)
    yield from names_of(f"{where}.remove", value.get("remove", []), "a list of objects of the model")
    for thing, offset in (yield from mapping(f"{where}.move", value.get("move", {}))).items():
        yield from three(f"{where}.move.{thing}", offset, -math.inf, math.inf, " in metres")
        if isinstance(value.get("remove"), list) and thing in value["remove"]:
            yield f"{where}.move.{thing}", offset, "is of an object that is removed"
    for lamp, emittance in (yield from mapping(f"{where}.lamps", value.get("lamps", {}))).items():
        yield from three(f"{where}.lamps.{lamp}", emittance, 0, math.inf, "")
    if not isinstance(value.get("grain", False), bool):
        yield f"{where}.grain", value["grain"], "is neither true nor false"


def listed(value):
    """What may be one or a list of such, as a list."""
    return value if isinstance(value, list) else [value]


def _cameras(where, value):
    """`camera`, or `cameras` and `frames`."""
    if "camera" in value and "cameras" in value:
        yield f"{where}.cameras", value["cameras"], "stands beside `camera`: one of them is to go"
    if "camera" in value and not _is_file(value["camera"]):
        yield f"{where}.camera", value["camera"], "is not a file's name"
    if "frames" in value and "cameras" not in value:
        yield f"{where}.frames", value["frames"], "needs `cameras`"
    if "cameras" not in value:
        return
    cameras, frames = value["cameras"], value.get("frames")
    if isinstance(cameras, list):
        if len(cameras) < 2 or not all(map(_is_file, cameras)):
            yield f"{where}.cameras", cameras, "is not a list of at least two files"
        if "frames" not in value:
            yield f"{where}.frames", None, "is missing"
    elif not (_is_file(cameras) and cameras.endswith(".csv")):
        yield f"{where}.cameras", cameras, "is neither a list of files nor a csv file"
    if frames is not None and not (type(frames) is int and 2 <= frames <= 9999):
        yield f"{where}.frames", frames, "is not a whole number from 2 to 9999"


def _is_file(value):
    return isinstance(value, str) and value != "" and "|" not in value


def _added(where, value):
    """One object of `add`."""
    if not isinstance(value, dict):
        yield where, value, "is not a mapping"
        return
    for key in value.keys() - {*SHAPES, *PLACE, "material"}:
        yield f"{where}.{key}", value[key], f"is an unknown key; known are {', '.join((*SHAPES, *PLACE, 'material'))}"
    shapes = [key for key in SHAPES if key in value]
    if len(shapes) != 1:
        yield where, shapes, f"is not exactly one of {', '.join(SHAPES)}"
    if "file" in value and not (_is_file(value["file"]) and Path(value["file"]).suffix[1:] in GROUPS_OF):
        yield f"{where}.file", value["file"], f"is not a file ending in {' or '.join(GROUPS_OF)}"
    if "ellipsoid" in value:
        axes = value["ellipsoid"]
        if not (isinstance(axes, list) and len(axes) == 3 and all(finite(a) and a > 0 for a in axes)):
            yield f"{where}.ellipsoid", axes, "is not three positive semi-axes in metres"
    if "sphere" in value and not (finite(value["sphere"]) and value["sphere"] > 0):
        yield f"{where}.sphere", value["sphere"], "is not a positive radius in metres"
    for key, what in (("at", " in metres"), ("rotate", " in rad")):
        yield from three(f"{where}.{key}", value.get(key, [0, 0, 0]), -math.inf, math.inf, what)
    if not (finite(value.get("scale", 1.0)) and value.get("scale", 1.0) > 0):
        yield f"{where}.scale", value["scale"], "is not a positive number"
    if "material" not in value:
        yield f"{where}.material", None, "is missing"
    elif is_one(value["material"]):
        yield from _material(f"{where}.material", value["material"], smooth="file" not in value)
    elif "file" not in value:
        yield f"{where}.material", value["material"], f"has no kind, one of {', '.join(KINDS)}"
    else:
        for group, material in (yield from mapping(f"{where}.material", value["material"])).items():
            yield from _material(f"{where}.material.{group}", material)


def is_one(material) -> bool:
    """Whether a `material` is one for the whole object, not {group: material}.

    >>> is_one({"kind": "mirror"}), is_one({"kind": {"kind": "mirror"}}), is_one({"lid": {"kind": "mirror"}})
    (True, False, False)
    """
    return isinstance(material, dict) and any(
        key in MATERIAL and not isinstance(value, dict) for key, value in material.items()
    )


def _material(where, value, whole=True, smooth=False):
    """whole : every field that its kind needs must be there;  smooth : of an ellipsoid"""
    if not isinstance(value, dict):
        yield where, value, "is not a mapping"
        return
    for key in value.keys() - set(MATERIAL):
        yield f"{where}.{key}", value[key], f"is an unknown key; known are {', '.join(MATERIAL)}"
    kind = value.get("kind")
    if kind is None and whole and "emittance" not in value:
        yield f"{where}.kind", None, "is missing"
    elif kind is not None and (not isinstance(kind, str) or kind not in KINDS):
        yield f"{where}.kind", kind, f"is none of {', '.join(KINDS)}"
        return
    if smooth and kind == "textured":
        yield f"{where}.kind", kind, "has no place on an ellipsoid: textures lie on plane facets"
    for key in ("rho_d", "rho_s"):
        if key in value:
            yield from three(f"{where}.{key}", value[key], 0, 1, "")
    for key in NEEDED.get(kind, ()):
        if key not in value:
            yield f"{where}.{key}", None, f"is missing: a {kind} surface needs it"
    if "emittance" in value and not whole:
        yield f"{where}.emittance", value["emittance"], "is of added objects; `lamps` changes a lamp"
    elif "emittance" in value:
        yield from three(f"{where}.emittance", value["emittance"], 0, math.inf, "")
    yield from _lobe_and_texture(where, value, kind)
    if not sum_problem(value):
        return
    yield where, [value["rho_d"], value["rho_s"]], "reflects more than it receives: rho_d + rho_s > 1"


def sum_problem(value) -> bool:
    """Whether rho_d + rho_s of a material exceeds 1 in a channel."""
    rho = [value.get(key) for key in ("rho_d", "rho_s")]
    if not all(isinstance(r, list) and len(r) == 3 and all(map(finite, r)) for r in rho):
        return False
    return any(d + s > 1 + 1e-9 for d, s in zip(*rho, strict=True))


def _lobe_and_texture(where, value, kind):
    if "alpha" in value:
        alpha = value["alpha"]
        good = isinstance(alpha, list) and len(alpha) == 2 and all(map(finite, alpha))
        if not (good and ALPHA[0] <= alpha[1] <= alpha[0] <= ALPHA[1]):
            low, high = ALPHA
            yield f"{where}.alpha", alpha, f"is not [alpha_x, alpha_y], alpha_x >= alpha_y, from {low} to {high}"
    if "tangent" in value:
        tangent = value["tangent"]
        if not (isinstance(tangent, list) and len(tangent) == 3 and all(map(finite, tangent)) and any(tangent)):
            yield f"{where}.tangent", tangent, "is not a direction, three numbers"
    if "texture" in value and not _is_file(value["texture"]):
        yield f"{where}.texture", value["texture"], "is not a file's name"
    for key, kinds in (("alpha", LOBES), ("texture", ("textured",)), ("rho_s", (*LOBES, *MIRRORS))):
        if key in value and kind is not None and kind not in kinds:
            yield f"{where}.{key}", value[key], f"has no meaning for {kind}"


# ---- the files of an entry ----


def files(value):
    """[(key, file)] of an entry, as it names them, but what is no file's name: `entry` has a line for that."""
    found = [("camera", value.get("camera"))]
    found += [("cameras", file) for file in listed(value.get("cameras", []))]
    things = [thing for thing in listed(value.get("add", [])) if isinstance(thing, dict)]
    materials = [("change", value.get("change"))]
    for thing in things:
        found.append(("add.file", thing.get("file")))
        material = thing.get("material")
        materials.append(("add.material", {"": material} if is_one(material) else material))
    for key, groups in materials:
        every = groups.values() if isinstance(groups, dict) else ()
        found += [(f"{key}.texture", one.get("texture")) for one in every if isinstance(one, dict)]
    return [(key, file) for key, file in found if _is_file(file)]


def located(value, folder) -> dict:
    """A sound entry whose files are paths: what the stage is told."""

    def moved(one):
        if isinstance(one, dict):
            return {
                key: str(folder / item) if key in ("file", "texture", "camera") else moved(item)
                for key, item in one.items()
            }
        return [moved(item) for item in one] if isinstance(one, list) else one

    result = {key: moved(item) if key not in ("camera", "cameras") else item for key, item in value.items()}
    if "camera" in value:
        result["camera"] = str(folder / value["camera"])
    if "cameras" in value:
        cameras = value["cameras"]
        result["cameras"] = [str(folder / c) for c in cameras] if isinstance(cameras, list) else str(folder / cameras)
    return result


def check(value):
    """BadInput with a line for each thing that is wrong with what the stage was told."""
    found = list(entry("entry", value)) if isinstance(value, dict) else [("entry", value, "is not a mapping")]
    if found:
        raise BadInput(*(f"{where}: {'' if item is None else show(item) + ' '}{wrong}" for where, item, wrong in found))


# ---- against the model, which only NumPy reads ----


def inspect(scene, model):
    """Yields a line for each name that the model has not, and each file of `augment` that cannot be used.

    model : Model, or None where it could not be read
    """
    from lib.given import image, lenses, motion  # NumPy: a plan whose files were found good does without
    from lib.given import model as models

    yaml = scene.folder / "scene.yaml"
    for number, value in enumerate(scene.augment):
        where = f"{yaml}: augment[{number}]"
        if model is not None:
            yield from _unknown(where, value, model, set(scene.lamps))
        for thing in listed(value.get("add", [])):
            # the material that an entry names for a whole object stands for any that its file lacks
            bare = NAMELESS if is_one(thing["material"]) else None
            yield from _unusable(functools.partial(models.load, bare=bare), scene, thing.get("file"))
            if "file" in thing and not is_one(thing["material"]):
                yield from _groups(where, scene, thing, models.load)
        for key, file in files(value):
            if key == "camera" or (key == "cameras" and not file.endswith(".csv")):
                yield from _unusable(lenses.read, scene, file)
            elif key == "cameras":
                yield from _unusable(motion.read_csv, scene, file)
            elif key.endswith("texture"):
                yield from _unusable(image.read_photograph, scene, file)


def _unusable(reader, scene, file):
    if file is not None:
        try:
            reader(scene.folder / file)
        except BadInput as bad:
            yield from bad.problems


def _groups(where, scene, thing, load):
    """Groups of an added file without a material, and materials of groups that it has not."""
    try:
        groups = load(scene.folder / thing["file"]).groups
    except BadInput:
        return  # said already
    for group in groups:
        if group not in thing["material"]:
            yield f"{where}.add.material: group {show(group)} of {thing['file']} is missing"
    for group in thing["material"]:
        if group not in groups:
            yield f"{where}.add.material.{group}: names no group of {thing['file']}, which has {', '.join(groups)}"


def _unknown(where, value, model, lamps):
    """Objects and groups that the model has not."""
    named = [("change", value.get("change", {}), model.groups), ("lamps", value.get("lamps", {}), sorted(lamps))]
    named += [("remove", value.get("remove", []), model.objects), ("move", value.get("move", {}), model.objects)]
    words = {"change": "no group of the model", "lamps": "no lamp of scene.yaml"}
    for key, names, known in named:
        for name in names:
            if name not in known:
                what = words.get(key, "no object of the model")
                yield f"{where}.{key}: {show(name)} names {what}, which has {', '.join(known)}"
            elif key == "change" and name in lamps:
                yield f"{where}.change.{name}: is a lamp; `lamps` changes what it emits"
