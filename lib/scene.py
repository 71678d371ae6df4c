"""A scene is a folder: what lies in it is given.  This reads scene.yaml and refuses what the contract (data/SCENE.md) does.

All problems are reported at once, one line each, `<folder>/scene.yaml: field: value ...`.  What the contract allows
but is not built yet is refused here too, in a line that says so.  Only PyYAML is needed.
"""
import ast
import json
import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from lib.stage import BadInput

NAME = re.compile(r"[A-Za-z0-9_-]+")
KEYS = ("board", "lens", "lamps", "reference", "transfer", "surfaces", "goals", "augment", "params")
GOALS = ("materials.json", "rendered.png", "report.html")
TRANSFERS = ("gamma", "linear", "srgb", "curve", "linear_per_group", "histogram", "histogram_per_group")
KINDS = ("diffuse", "mirror", "coloured_mirror", "glossy", "textured")


@dataclass(frozen=True)
class Scene:
    name: str
    folder: Path
    board: dict | None = None
    lens: str = "LENSMODEL_OPENCV8"
    lamps: dict = field(default_factory=dict)           # group -> [r, g, b] emittance, or "unknown"
    reference: dict = field(default_factory=dict)       # group -> [r, g, b] reflectance
    transfer: object = None                             # a word, or {"gamma": g}
    surfaces: dict = field(default_factory=dict)        # group -> kind
    goals: tuple = GOALS
    augment: tuple = ()
    params: dict = field(default_factory=dict)          # stage -> name -> value
    problems: tuple = ()                                # one line each; empty if the scene may run

    def given(self, file):
        """Where file lies in the folder, or None.  `left.png|jpg` is whichever is there; `boards/` is a folder."""
        paths = self.candidates(file)
        return paths[0] if paths else None

    def candidates(self, file):
        paths = [self.folder / name for name in alternatives(file)]
        return [p for p in paths if (p.is_dir() if file.endswith("/") else p.is_file())]

    @property
    def views(self):
        """What pipeline.yaml's <left>, <left camera> and so on are in this scene (`views` below)."""
        return {**views(self, "left"), **views(self, "right")}

    def fact(self, key):
        if key == "lamp_groups":
            return sorted(self.lamps)
        if key == "scene":
            return self.name
        if key == "transfer" and self.transfer is None:
            photograph = self.given(PHOTOGRAPH)
            return "linear" if photograph and photograph.suffix == ".exr" else "gamma"
        return getattr(self, key)


def alternatives(file):
    """
    >>> alternatives("left.png|jpg"), alternatives("pose.json")
    (['left.png', 'left.jpg'], ['pose.json'])
    """
    stem, dot, extensions = file.rpartition(".")
    return [f"{stem}{dot}{extension}" for extension in extensions.split("|")]


# ---- which camera and which photograph a stage sees ----

SIDES = ("left", "right")
PINHOLE = "LENSMODEL_PINHOLE"


def views(scene, side):
    """Of one photograph of the pair, the file that each name in angle brackets of pipeline.yaml stands for.

    <side>            the photograph as the analysis sees it: as it was taken, or undistorted where the lens is no pinhole
    <side raw lens>   the camera as calibrated or given, any lens        <side pinhole>   what undistortion writes
    <side lens>       the same as a pinhole                              <side camera>    a pinhole in the pair's frame
    <side posed>      a pinhole in the model's frame
    """
    posed, own = f"{side}.posed.cameramodel", f"{side}.cameramodel"
    taken = f"{side}.png|jpg|tif|exr"
    given = scene.given(taken)
    flat = f"{side}.pinhole.exr" if given and given.suffix == ".exr" else f"{side}.pinhole.png"
    bent = lens(scene, side) != PINHOLE
    known = bent and bool(scene.given(posed))                # a pose and a lens: undistortion keeps both
    straight = f"{side}.pinhole.cameramodel" if bent else own
    pair = f"{side}.oriented.cameramodel" if unoriented(scene) else straight
    if not bent and all(scene.given(f"{s}.posed.cameramodel") for s in SIDES):
        pair = posed
    return {f"<{side}>": flat if bent else taken, f"<{side} raw lens>": posed if known else own, f"<{side} pinhole>": flat,
            f"<{side} lens>": straight, f"<{side} camera>": pair, f"<{side} posed>": straight if known else posed}


def lens(scene, side):
    """The lens model of one camera, as far as it is known before anything runs: mrcal fits the one that scene.yaml names."""
    for name in (f"{side}.posed.cameramodel", f"{side}.cameramodel"):
        if path := scene.given(name):
            return lens_of(path) or PINHOLE
    return scene.lens if scene.given("boards/") else PINHOLE


def unoriented(scene):
    """Is the relative pose of the pair to be estimated?  Two given lenses of one centre (to 1e-9), or nothing given at all."""
    if all(scene.given(f"{side}.posed.cameramodel") for side in SIDES):
        return False
    paths = [scene.given(f"{side}.cameramodel") for side in SIDES]
    if not all(paths):
        return not any(paths) and not scene.given("boards/")
    centres = [centre_of(path) for path in paths]
    return all(centres) and max(abs(a - b) for a, b in zip(*centres)) <= 1e-9


# ---- YAML ----

class _Loader(yaml.SafeLoader):
    """Safe YAML, except that a key given twice is an error and plain scalars mean what YAML 1.2 says:
    `no` and `on` are words, 1e-3 is a number, 1:30 and 010 are not sixty-based or octal."""


_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
        ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
        ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", list("tTfF")),
        ("int", r"^[-+]?[0-9]+$", list("-+0123456789")),
        ("float", r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$", list("-+0123456789."))):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(_pattern), _first)
_Loader.add_constructor("tag:yaml.org,2002:int", lambda loader, node: int(loader.construct_scalar(node), 10))


def _construct_mapping(loader, node):
    value = {}
    for key_node, value_node in node.value:
        key = loader.construct_object(key_node, deep=True)
        try:
            twice = key in value
        except TypeError:
            raise yaml.constructor.ConstructorError(None, None, "a key must be a word", key_node.start_mark) from None
        if twice:
            raise yaml.constructor.ConstructorError(None, None, f"{key}: the key stands there twice", key_node.start_mark)
        value[key] = loader.construct_object(value_node, deep=True)
    return value


_Loader.add_constructor("tag:yaml.org,2002:map", _construct_mapping)


def read_yaml(path):
    """The one document in path.  BadInput in one line: not there, not UTF-8, not YAML, a key twice."""
    try:
        text = Path(path).read_text(encoding="utf-8")
        return yaml.load(text, _Loader)
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such file") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8: {error.reason} at byte {error.start}") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise BadInput(f"{path}: line {mark.line + 1}: {error.problem}" if mark else f"{path}: {error.problem}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise BadInput(f"{path}: not readable YAML: {str(error) or 'nested too deep'}") from None


def show(value):
    try:
        text = json.dumps(value, default=str, ensure_ascii=False)
    except (ValueError, TypeError):                  # holds itself, or keys that JSON has not
        text = str(value)
    return text if len(text) <= 80 else text[:77] + "..."


def finite(value):
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


# ---- the rules of section 3, one function per key: each yields (field, value, what is wrong) ----

def _mapping(key, value):
    """The entries of a mapping from names; yields its own problems and returns the rest."""
    if not isinstance(value, dict):
        yield key, value, "is not a mapping"
        return {}
    for name in value:
        if not isinstance(name, str) or not name:
            yield key, name, "is not a name (quote it)"
    return {name: item for name, item in value.items() if isinstance(name, str) and name}


def _three(key, value, low, high, what):
    if not (isinstance(value, list) and len(value) == 3 and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in value)):
        yield key, value, f"is not a list of three numbers{what}"
    elif not all(map(finite, value)):
        yield key, value, "is not finite"
    elif not all(low <= v <= high for v in value):
        yield key, value, "is negative" if high == math.inf else f"is outside [{low}, {high}]"


def _board(value):
    known = yield from _mapping("board", value)
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


def _lens(value):
    if not (isinstance(value, str) and re.fullmatch(r"LENSMODEL_[A-Z0-9]+(_[A-Za-z0-9_.=-]+)?", value)):
        yield "lens", value, "is not a name of a mrcal lens model, LENSMODEL_..."


def _lamps(value):
    for name, emittance in (yield from _mapping("lamps", value)).items():
        if emittance != "unknown":
            yield from _three(f"lamps.{name}", emittance, 0, math.inf, " or `unknown`")


def _reference(value):
    for name, rho in (yield from _mapping("reference", value)).items():
        yield from _three(f"reference.{name}", rho, 0, 1, "")


def _transfer(value):
    if isinstance(value, dict):
        for key in sorted(map(str, value.keys() - {"gamma"})):
            yield f"transfer.{key}", value.get(key), "is an unknown key; known is gamma"
        if "gamma" not in value:
            yield "transfer.gamma", None, "is missing"
        elif not (finite(value["gamma"]) and value["gamma"] > 0):
            yield "transfer.gamma", value["gamma"], "is not a positive number"
    elif not isinstance(value, str) or value not in TRANSFERS:
        yield "transfer", value, f"is none of {', '.join(TRANSFERS)}, {{gamma: 2.2}}"
    elif value == "curve":
        yield "transfer", value, "is not built yet"


def _surfaces(value):
    for name, kind in (yield from _mapping("surfaces", value)).items():
        if not isinstance(kind, str) or kind not in KINDS:
            yield f"surfaces.{name}", kind, f"is none of {', '.join(KINDS)}"


def _goals(value, known, scene):
    if not isinstance(value, list):
        yield "goals", value, "is not a list"
        return
    for goal in value:
        if not isinstance(goal, str) or not goal:
            yield "goals", goal, "is not a file's name"
        elif outside(goal):
            yield "goals", goal, "lies outside the scene's folder"
        elif goal not in known and not (scene.given(goal) and "|" not in goal and not goal.startswith("truth/")):
            yield "goals", goal, "is neither made by a stage nor given"


def outside(path):
    """An absolute path, or one that climbs.

    >>> outside("a/../../b"), outside("/a"), outside("a/../b")
    (True, True, False)
    """
    depth = 0
    for part in Path(path).parts:
        depth += -1 if part == ".." else 1
        if depth < 0 or part == "/":
            return True
    return False


def _augment(value, scene):
    if not isinstance(value, list):
        yield "augment", value, "is not a list"
        return
    names = set()
    for number, entry in enumerate(value):
        where = f"augment[{number}]"
        if not isinstance(entry, dict):
            yield where, entry, "is not a mapping"
            continue
        for key in entry.keys() - {"name", "camera", "add", "change"}:
            yield f"{where}.{key}", entry[key], "is an unknown key; known are name, camera, add, change"
        name = entry.get("name")
        if not isinstance(name, str) or not NAME.fullmatch(name):
            yield f"{where}.name", name, "is not a name of letters, digits, _ and -"
        elif name in names:
            yield f"{where}.name", name, "stands there twice"
        else:
            names.add(name)
        add = entry.get("add")
        files = {"camera": entry.get("camera"), "add.file": add.get("file") if isinstance(add, dict) else None}
        for key, file in files.items():
            if file is None:
                continue
            if not isinstance(file, str):
                yield f"{where}.{key}", file, "is not a file's name"
            elif outside(file):
                yield f"{where}.{key}", file, "lies outside the scene's folder"
            elif not (scene.folder / file).is_file():
                yield f"{where}.{key}", file, "is not in the scene's folder"
    if value:
        yield "augment", [e.get("name") if isinstance(e, dict) else e for e in value], "is not built yet"


def _params(value, stages):
    for stage, settings in (yield from _mapping("params", value)).items():
        if stage not in stages:
            yield f"params.{stage}", settings, f"belongs to no stage; stages are {', '.join(stages)}"
            continue
        known = stages[stage].params
        for name, setting in (yield from _mapping(f"params.{stage}", settings)).items():
            where = f"params.{stage}.{name}"
            if name not in known:
                yield where, setting, f"is no number of {stage}, which has {', '.join(known) or 'none'}"
            else:
                yield from _param(where, setting, known[name])


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


# ---- what the folder says ----

def model_groups(path):
    """The groups of a model as its text names them (a quick look; the stages read it in earnest), or None where they cannot be told."""
    try:
        data = path.read_bytes()
        if path.suffix == ".obj":
            names = re.findall(rb"^[ \t]*usemtl[ \t]+([^\r\n]*?)[ \t]*\r?$", data, re.M)
            return {name.decode("utf-8", "replace") for name in names}
        length = int.from_bytes(data[12:16], "little")
        names = {material["name"] for material in json.loads(data[20:20 + length])["materials"]}
        return names if data[:4] == b"glTF" else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def lens_of(path):
    """The lens model a camera file names, or None where the file cannot be read (the stage that needs it says why)."""
    try:
        return ast.literal_eval(path.read_text(encoding="utf-8"))["lensmodel"]
    except (OSError, ValueError, SyntaxError, KeyError, TypeError, RecursionError, MemoryError):
        return None


def centre_of(path):
    """The centre of a given camera in its reference frame, or None where the file cannot be read (the stage that needs it says why)."""
    from lib import lenses
    try:
        return lenses.read(path).centre.tolist()
    except BadInput:
        return None


def _folder(scene):
    """Files that stand in each other's way: two photographs, two models, a folder where a file should be."""
    for file in (PHOTOGRAPH, PHOTOGRAPH.replace("left", "right"), MODEL):
        there = [p.name for p in scene.candidates(file)]
        if len(there) > 1:
            yield f"{scene.folder}: {' and '.join(there)}: only one of them may be given"
        for name in alternatives(file):
            if (scene.folder / name).is_dir():
                yield f"{scene.folder / name}: is a folder, not a file"
    groups = model_groups(scene.given(MODEL)) if scene.given(MODEL) else None
    if groups:
        yield from _groups(scene, groups)


MODEL, PHOTOGRAPH = "model.obj|glb", "left.png|jpg|tif|exr"


def inspect(scene, files):
    """Open in earnest what lies in the folder, so that bad input is refused before any stage has written anything.

    files : names as in pipeline.yaml, of which the model, photographs and cameras are opened.  Returns problems, one line each.
    """
    from lib import image, lenses, model as models
    problems, found = [], {}
    cameras = {f"{side}.{posed}cameramodel": side for side in SIDES for posed in ("posed.", "")}
    photographs = {PHOTOGRAPH.replace("left", side): side for side in SIDES}
    readers = {MODEL: models.load, **dict.fromkeys(photographs, image.read_photograph), **dict.fromkeys(cameras, lenses.read)}
    for file, reader in readers.items():
        if file in files and (path := scene.given(file)):
            try:
                found[file] = reader(path)
            except BadInput as bad:
                problems += bad.problems
    for camera, side in cameras.items():
        for photograph in [name for name, other in photographs.items() if other == side and name in found and camera in found]:
            (height, width), (wide, high) = found[photograph].values.shape[:2], (found[camera].width, found[camera].height)
            if (width, height) != (wide, high):
                problems.append(f"{scene.given(photograph)}: size: {width} x {height} is not the camera's {wide} x {high} ({scene.given(camera)})")
    if MODEL in found:
        problems += _groups(scene, found[MODEL].groups)
    return problems


def _groups(scene, groups):
    for key in ("lamps", "reference", "surfaces"):
        for name, value in getattr(scene, key).items():
            if name not in groups:
                yield f"{scene.folder / 'scene.yaml'}: {key}.{name}: {show(value)} names no group of {scene.given(MODEL).name}, which has {', '.join(sorted(groups))}"


def read(folder, stages):
    """The scene in folder, with its problems listed in `.problems`; stages: name -> an object with `.params` and `.writes`.

    Raises BadInput where scene.yaml is missing or cannot be parsed at all.
    """
    folder = Path(folder)
    path = folder / "scene.yaml"
    if not path.is_file():
        raise BadInput(f"{path}: there is no such file; a scene is a folder that holds it")
    facts = read_yaml(path)
    facts = {} if facts is None else facts
    if not isinstance(facts, dict):
        raise BadInput(f"{path}: {show(facts)} is not a mapping of keys to values")
    bare = Scene(folder.name, folder)
    outputs = {bare.views.get(file, file) for stage in stages.values() for file in stage.writes.values()}
    outputs |= {f"{stage}.report.json" for stage in stages}
    rules = {"board": _board, "lens": _lens, "lamps": _lamps, "reference": _reference, "transfer": _transfer, "surfaces": _surfaces,
             "goals": lambda v: _goals(v, outputs, bare), "augment": lambda v: _augment(v, bare), "params": lambda v: _params(v, stages)}
    problems, sound = [], {}
    for key, value in facts.items():
        if key not in rules:
            found = [(key, value, f"is an unknown key; known are {', '.join(KEYS)}")]
        elif value is None:
            found = [(key, value, "is empty: leave the key out or give it a value")]
        else:
            found = list(rules[key](value))
        problems += [f"{path}: {where}: {'' if item is None else show(item) + ' '}{wrong}" for where, item, wrong in found]
        if not found:
            sound[key] = value
        elif key == "goals":
            sound[key] = ()
    if "goals" in sound:
        sound["goals"] = tuple(dict.fromkeys(sound["goals"]))
    if "augment" in sound:
        sound["augment"] = tuple(sound["augment"])
    scene = Scene(folder.name, folder, **sound)
    return Scene(folder.name, folder, **sound, problems=tuple(problems) + tuple(_folder(scene)))
