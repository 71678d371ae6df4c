"""A scene is a folder: what lies in it is given.

This reads scene.yaml and refuses what the contract (data/SCENE.md) does.  All problems are reported at once, one line
each, `<folder>/scene.yaml: field: value ...`.  What the contract allows but is not built yet is refused here too, in a
line that says so.  Only PyYAML is needed.
"""

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from lib.core.stage import BadInput
from lib.core.yaml_file import read_yaml
from lib.given.transfer_kinds import OF_PICTURE
from lib.planning import augment, near_misses, rules
from lib.planning.files import (
    FSPY,
    MODEL,
    NO_FILE,
    OBJECTS,
    PHOTOGRAPH,
    PHOTOS,
    PICKED,
    PINHOLE,
    SIDES,
    alternatives,
    centre_of,
    export_kind,
    further,
    here,
    lens_of,
    object_files,
    photograph_of,
    pixels,
)
from lib.planning.folder import folder_problems
from lib.planning.near_misses import alike
from lib.planning.rules import KEYS, LATER, show

IN_METRES = "model.metres.glb"
POSED_MODEL = "model.posed.glb"
PLACED = ("movable", "refine", OBJECTS)  # a scene that asks for one of these has a model with objects at found places
TOLD = ("camera", *PICKED, *FSPY)  # how a person tells where `left` was taken from
GOALS = ("materials.json", "rendered.png", "report.html")
IN_PIXELS = (  # of `left` as it was taken: where one of them is given, the photograph keeps its size
    *("left.regions.png|tif", "left.surfaces.png|tif", "group.png", "object.png", "facet.png", "trusted.png"),
    *("depth.exr", "gather.npz", "coverage.npz"),
)


@dataclass(frozen=True)
class Scene:
    """What a scene's folder and its scene.yaml say."""

    name: str
    folder: Path
    board: dict | None = None
    lens: str = "LENSMODEL_OPENCV8"
    camera: dict | None = None  # eye, at, up, hfov_deg of left
    lamps: dict = field(default_factory=dict)  # group -> [r, g, b] emittance, or "unknown"; or a mapping with more
    reference: dict = field(default_factory=dict)  # group -> [r, g, b] reflectance
    transfer: object = None  # a word, {"gamma": g} or {"curve": file}
    explain: object = None  # causes that may be taken, None: all
    refine: tuple = ()  # what of the model may be moved to fit both photographs
    movable: tuple = ()  # objects of the model with a pose of their own
    model: dict = field(default_factory=dict)  # unit of its lengths; which way is up
    surfaces: dict = field(default_factory=dict)  # group -> kind
    photos: dict = field(default_factory=dict)  # photograph of photos/ -> exposure, lamps
    goals: tuple = GOALS
    augment: tuple = ()
    exports: tuple = ()  # kinds
    params: dict = field(default_factory=dict)  # stage -> name -> value
    megapixels: float = float("inf")  # that a photograph keeps at most; larger ones are made smaller
    problems: tuple = ()  # one line each; empty if the scene may run

    def given(self, file) -> Path | None:
        """Where file lies in the folder, or None.  `left.png|jpg` is whichever is there; `boards/` is a folder."""
        paths = self.candidates(file)
        return paths[0] if paths else None

    def candidates(self, file) -> list[Path]:
        """All files in the folder that `file` may mean."""
        paths = [self.folder / name for name in alternatives(file) if name.split("/", 1)[0] in self._listed]
        return [p for p in paths if (p.is_dir() if file.endswith("/") else p.is_file())]

    @cached_property
    def _listed(self) -> frozenset[str]:
        """What lies in the folder, listed once: a plan asks thousands of times for files that are not there."""
        try:
            return frozenset([*os.listdir(self.folder), os.curdir])
        except (FileNotFoundError, NotADirectoryError):
            return frozenset()

    @cached_property
    def views(self) -> dict[str, str]:
        """What pipeline.yaml's <model>, <left>, <left camera> and so on are in this scene (`views` below)."""
        curve = self.transfer.get("curve", NO_FILE) if isinstance(self.transfer, dict) else NO_FILE
        drawn = MODEL if self.fact("unit") == "m" else IN_METRES
        placed = any(map(self.asks, PLACED))
        return {
            "<drawn model>": drawn,
            "<model>": POSED_MODEL if placed else drawn,
            "<camera pose>": "pose.camera.json" if placed else "pose.json",
            **_recognised(self, placed),
            "<curve>": curve,
            "<edges>": "edges.json" if self.may_explain else NO_FILE,
            **views(self, "left"),
            **views(self, "right"),
        }

    def asks(self, word) -> bool:
        """Whether scene.yaml says something under a key, a file is there, or something lies in a folder `objects/`.

        `exports`: also where a goal lies in one.  `photos/`: where there is a model that they can show.
        """
        if word == "exports":
            return bool(self.exported)
        if word == OBJECTS:
            return bool(object_files(self.given(word)))
        if word == PHOTOS:
            return bool(self.given(MODEL) and self.given(PHOTOGRAPH) and further(self.given(word)))
        return bool(self.given(word) if "." in word else getattr(self, word, False))

    @property
    def exported(self) -> tuple:
        """Kinds of exports that are asked for, by `exports` or by a goal that one of them writes."""
        return tuple(dict.fromkeys([*self.exports, *filter(None, map(export_kind, self.goals))]))

    @property
    def may_explain(self) -> bool:
        """Whether anything may be other than given: `explain: []` and the printed alternation know of nothing."""
        fit = self.params.get("fit")
        method = fit.get("method") if isinstance(fit, dict) else None
        return self.explain != [] and method in (None, "gauss-newton")

    @property
    def is_told(self) -> bool:
        """Whether a person tells the pose of `left`, by picked places or in numbers."""
        return any(map(self.asks, TOLD))

    @property
    def lone_pose(self) -> bool:
        """Is the pose of `left` given or told, and that of `right` not? Then no stage finds it."""
        left, right = (self.given(f"{side}.posed.cameramodel") for side in SIDES)
        return bool((left or self.is_told) and not right)

    def fact(self, key):
        """What a stage is told of scene.yaml under this key of `facts`; None: nothing."""
        if key == "lamp_groups":
            return sorted(self.lamps)
        if key == "lamps":
            return {name: lamp["emittance"] if isinstance(lamp, dict) else lamp for name, lamp in self.lamps.items()}
        if key == "lobes":
            key = "lobe"
        if key in ("place_sigma_m", "lobe"):
            lamps = {name: lamp for name, lamp in self.lamps.items() if isinstance(lamp, dict)}
            return {name: lamp[key] for name, lamp in lamps.items() if key in lamp}
        if key == "unit":
            return self.model.get("unit", "m")
        if key == "up":
            return self.model.get("up", "z")
        if key == "scene":
            return self.name
        if key == "transfer" and self.transfer is None:
            photograph = self.given(PHOTOGRAPH)
            return "linear" if photograph and photograph.suffix == ".exr" else "auto"
        if key == "photos":
            return self.photos or None
        if key in PLACED:
            return list(getattr(self, key)) or None
        return getattr(self, key)

    def entry(self, name) -> dict:
        """The entry of `augment` of that name, its files as paths."""
        return augment.located(self._entry(name), here(self.folder))

    def entry_files(self, name) -> list[Path]:
        """The files that the entry names."""
        return [self.folder / file for _, file in augment.files(self._entry(name))]

    def _entry(self, name):
        return next(value for value in self.augment if value["name"] == name)


def _recognised(scene, placed) -> dict[str, str]:
    """Where recognise writes the camera and the pose: beside those that a person tells."""
    if scene.is_told:
        return {"<left recognised>": "left.recognised.cameramodel", "<recognised pose>": "pose.recognised.json"}
    pose = "pose.camera.json" if placed else "pose.json"
    return {"<left recognised>": "left.posed.cameramodel", "<recognised pose>": pose}


def views(scene, side) -> dict[str, str]:
    """Of one photograph of the pair, the file that each name in angle brackets of pipeline.yaml stands for.

    <side>            the photograph as the analysis sees it: as taken, or made anew where the lens is no pinhole or the
                      photograph is large
    <side raw lens>   the camera as calibrated or given, any lens        <side pinhole>   what undistortion writes
    <side lens>       the same as a pinhole                              <side camera>    a pinhole in the pair's frame
    <side posed>      a pinhole in the model's frame
    <side told>, <side told lens>   the photograph in which a person tells the pose, and its camera as a pinhole: the
                      one as taken where no lens is given
    """
    posed, own = f"{side}.posed.cameramodel", f"{side}.cameramodel"
    taken = photograph_of(side)
    given = scene.given(taken)
    flat = f"{side}.pinhole.exr" if given and given.suffix == ".exr" else f"{side}.pinhole.png"
    bent = lens(scene, side) != PINHOLE
    anew = bent or _is_large(scene, given)
    # no lens is known but what a person tells of the pose
    bare = anew and not bent and side == "left" and scene.is_told and not (scene.given(own) or scene.given("boards/"))
    known = anew and (bare or bool(scene.given(posed)))  # a pose and a lens: undistortion keeps both
    straight = f"{side}.pinhole.cameramodel" if anew else own
    pair = f"{side}.oriented.cameramodel" if unoriented(scene) else straight
    if not anew and all(scene.given(f"{s}.posed.cameramodel") for s in SIDES):
        pair = posed
    seen = flat if anew else taken
    return {
        f"<{side}>": seen,
        f"<{side} told>": taken if bare else seen,
        f"<{side} told lens>": NO_FILE if bare else straight,
        f"<{side} raw lens>": posed if known else own,
        f"<{side} pinhole>": flat,
        f"<{side} lens>": straight,
        f"<{side} camera>": pair,
        f"<{side} posed>": straight if known else posed,
    }


def _is_large(scene, photograph) -> bool:
    """Whether a given photograph (or None) has more pixels than are analysed."""
    fixed = photograph is None or any(map(scene.given, IN_PIXELS))
    return not fixed and (pixels(photograph) or 0) > 1e6 * scene.megapixels


def lens(scene, side) -> str:
    """The lens model of one camera, as far as it is known before anything runs.

    mrcal fits the one that scene.yaml names.
    """
    for name in (f"{side}.posed.cameramodel", f"{side}.cameramodel"):
        if path := scene.given(name):
            return lens_of(path) or PINHOLE
    return scene.lens if scene.given("boards/") else PINHOLE


def unoriented(scene) -> bool:
    """Is the relative pose of the pair to be estimated?

    Yes for two given lenses of one centre (to 1e-9 m), or where nothing is given at all.
    """
    if all(scene.given(f"{side}.posed.cameramodel") for side in SIDES):
        return False
    paths = [scene.given(f"{side}.cameramodel") for side in SIDES]
    if not all(paths):
        return not any(paths) and not scene.given("boards/")
    centres = [centre_of(path) for path in paths]
    return all(centres) and max(abs(a - b) for a, b in zip(*centres, strict=True)) <= 1e-9


def read(folder, stages) -> Scene:
    """The scene in folder, with its problems listed in `.problems`.

    stages : name -> pipeline.Stage

    Raises BadInput where scene.yaml is missing or cannot be parsed at all.
    """
    folder = Path(folder)
    path = folder / "scene.yaml"
    if not path.is_file():
        raise BadInput(
            *near_misses.scene_yaml(folder) or [f"{path}: there is no such file; a scene is a folder that holds it"]
        )
    bare = Scene(folder.name, folder)
    outputs = {bare.views.get(file, file): stage for stage in stages.values() for file in stage.files}
    kinds = list(dict.fromkeys(filter(None, map(export_kind, outputs))))
    checks = {
        "board": rules.board,
        "lens": rules.lens,
        "camera": rules.camera,
        "lamps": rules.lamps,
        "reference": rules.reference,
        "transfer": lambda v: rules.transfer(v, bare),
        "explain": rules.explain,
        "refine": rules.refine,
        "movable": rules.movable,
        "model": rules.model,
        "surfaces": rules.surfaces,
        "photos": lambda v: rules.photos(v, {one.name for one in further(bare.given(PHOTOS))}),
        "goals": lambda v: rules.goals(v, outputs, bare),
        "augment": lambda v: augment.augment(v, bare),
        "exports": lambda v: rules.exports(v, kinds),
        "params": lambda v: rules.params(v, stages),
    }
    sound, problems = _checked(path, checks)
    if "goals" in sound:
        sound["goals"] = tuple(dict.fromkeys(sound["goals"]))
    for key in ("augment", "refine", "movable", "exports"):
        if key in sound:
            sound[key] = tuple(sound[key])
    if sound.get("augment") and sound.get("transfer") in OF_PICTURE:
        why = f"needs a transfer function of the light alone, which {sound['transfer']} is not"
        problems.append(f"{path}: augment: {why}")
    known = stages["undistort"].params if "undistort" in stages else {}
    most = {**known, **sound.get("params", {}).get("undistort", {})}.get("megapixels", Scene.megapixels)
    scene = Scene(folder.name, folder, **sound, megapixels=most)
    return replace(scene, problems=(*problems, *folder_problems(scene)))


def _checked(path, checks):
    """(what is sound of scene.yaml, problems); goals that are not sound are none at all."""
    facts = read_yaml(path)
    facts = {} if facts is None else facts
    if not isinstance(facts, dict):
        raise BadInput(f"{path}: {show(facts)} is not a mapping of keys to values")
    sound, problems = {}, []
    for key, value in facts.items():
        if key in LATER:
            found = [(key, value, "is not built yet")]
        elif key not in checks:
            found = [(key, value, f"is an unknown key{alike(key, KEYS)}; known are {', '.join(KEYS)}")]
        elif value is None:
            found = [(key, value, "is empty: leave the key out or give it a value")]
        else:
            found = list(checks[key](value))
        for where, item, wrong in found:
            problems.append(f"{path}: {where}: {'' if item is None else show(item) + ' '}{wrong}")
        if not found:
            sound[key] = value
        elif key == "goals":
            sound[key] = ()
    return sound, problems
