"""What the page is made of: read from the files that a scene's stages left, each of which may be missing."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lib.core import record
from lib.given import cameras, image, materials, model
from lib.planning import next_steps
from lib.verdict import records, stage_reports
from lib.verdict.comparison import Comparison
from lib.verdict.page import further
from lib.verdict.page.placed import Placed, place
from lib.verdict.page.vision import SIDES, Vision, see
from lib.vision import facets_file
from lib.vision.matches import read_matches

EXPORTS = ("gltf", "mitsuba", "radiance", "usd", "colmap", "blender")
LEFT_OUT = re.compile(r"^#   without ([\w-]+): (.*)$", re.MULTILINE)  # in the head of plan.mk


@dataclass(frozen=True, eq=False)
class Changed:
    """An entry of `augment`. address : of its file, from the page;  picture : (H, W, C) display, None of a sequence"""

    name: str
    address: str
    picture: np.ndarray | None


@dataclass
class Parts:
    """photograph, rendered : (H, W, C) display values in [0, 1], C = 1 or 3;  linear : the photograph is an EXR

    group, object, facet : (H, W) int, index + 1;  hidden, trusted : (H, W) bool;  depth : (H, W) m, 0 = nothing
    reports : {stage: StageReport};  plan : [(stage, why it was left out)]
    thumbnails : {group: {facet: ladder.Thumbnail}}
    changed : [Changed], the entries of `augment`;  further : [further.Shown], of photos/
    exports : {kind: its file, as the page names it};  view : the HTML of the exported scene in space
    placed : the model over the photograph, where there is but one;  steps : what to do next, lines
    """

    scene: str = "scene"
    photograph: np.ndarray | None = None
    linear: bool = False
    rendered: np.ndarray | None = None
    group: np.ndarray | None = None
    object: np.ndarray | None = None
    facet: np.ndarray | None = None
    hidden: np.ndarray | None = None
    trusted: np.ndarray | None = None
    depth: np.ndarray | None = None
    legend: records.Legend | None = None
    materials: materials.Materials | None = None
    scores: records.Scores | None = None
    comparison: Comparison | None = None
    reports: dict = field(default_factory=dict)
    plan: list = field(default_factory=list)
    thumbnails: dict = field(default_factory=dict)
    vision: Vision | None = None
    changed: list = field(default_factory=list)
    further: list = field(default_factory=list)
    exports: dict = field(default_factory=dict)
    view: str | None = None
    placed: Placed | None = None
    steps: list = field(default_factory=list)

    @property
    def groups(self):
        """{name: materials.Group} of those that are no lamps."""
        if not self.materials:
            return {}
        return {name: g for name, g in self.materials.groups.items() if name not in self.materials.lamps}

    @property
    def transfer(self):
        """The camera's, empty where none was found."""
        return self.materials.transfer if self.materials else materials.FoundTransfer()

    @property
    def compared(self):
        """The comparison with the truth, empty where there is none."""
        return self.comparison or Comparison()


def read(files, scene, reports, page, changed=()) -> Parts:
    """files : {name: path or None};  reports : paths of the stages' reports;  page : path of the page

    changed : paths of what the entries of `augment` made.

    What the plan left out stands in plan.mk beside the page.
    """

    def of(name, reader):
        return reader(files[name]) if files[name] else None

    def labels(name):
        return of(name, image.read_labels)

    photograph = of("photograph", image.read_photograph)
    rendered = of("rendered", image.read_photograph)
    trusted, hidden = labels("trusted"), labels("hidden")
    return Parts(
        scene=scene,
        photograph=photograph.display if photograph else None,
        linear=bool(photograph and photograph.linear),
        rendered=rendered.values if rendered else None,
        group=labels("group"),
        object=labels("object"),
        facet=labels("facet"),
        hidden=None if hidden is None else hidden > 0,
        trusted=None if trusted is None else trusted > 0,
        depth=of("depth", image.read_exr),
        legend=of("legend", lambda path: record.read(path, records.Legend)),
        materials=of("materials", materials.read),
        scores=of("scores", lambda path: record.read(path, records.Scores)),
        comparison=of("comparison", lambda path: record.read(path, Comparison)),
        reports=stage_reports.read_all(reports),
        plan=left_out(Path(page).parent / "plan.mk"),
        vision=_read_vision(files),
        changed=[_changed(page, Path(path)) for path in changed],
        further=_read_further(files),
        placed=_read_placed(files),
        exports={kind: _beside(page, files[kind]) for kind in EXPORTS if files[kind]},
        steps=_steps(files, scene, reports, page),
    )


def _steps(files, scene, reports, page):
    """What to do next, as the terminal says it."""
    stages = {Path(path).name.removesuffix(".report.json") for path in reports}
    stages |= {"fit"} if files["materials"] else set()
    return next_steps.steps(next_steps.read(Path(page).parent, scene, stages))


def _read_placed(files):
    """The model over the one photograph; None of a pair, which shows it after each step."""
    if _is_vision(files) or not (files["posed"] and files["model"]):
        return None
    pose = record.read(files["pose"], records.Pose) if files["pose"] else None
    return place(cameras.read_cameramodel(files["posed"]), model.load(files["model"]), pose)


def _is_vision(files):
    """Is there anything of the vision half? A pose alone is one that a person told."""
    return any(files[name] for name in ("regions", "facets", "calibration", "photograph_right"))


def _read_further(files):
    if not (files["poses"] and files["photos"]):
        return []
    return further.read(files["poses"], files["photos"], model.load(files["model"]) if files["model"] else None)


def _changed(page, path) -> Changed:
    """Of augmented.<name>.png, or the preview of a sequence."""
    name, address = path.stem.partition(".")[2], _beside(page, path)
    return Changed(name, address, image.read_photograph(path).values if path.suffix == ".png" else None)


def _beside(page, path):
    """A file as a page names it."""
    return Path(os.path.relpath(path, Path(page).parent)).as_posix()


def left_out(plan):
    """[(stage, why)] from the head of plan.mk."""
    if not plan.is_file():
        return []
    return LEFT_OUT.findall(plan.read_text(encoding="utf-8", errors="replace").partition("\n\n")[0])


def _read_vision(files):
    """What there is of the vision half, or None."""
    if not _is_vision(files):
        return None

    def pair(name, reader):
        paths = dict(zip(SIDES, (files[name], files[f"{name}_right"]), strict=True))
        return {side: reader(path) for side, path in paths.items() if path}

    def of(name, cls):
        return record.read(files[name], cls) if files[name] else None

    return see(
        photographs=pair("photograph", lambda path: image.read_photograph(path).display),
        regions=pair("regions", image.read_labels),
        surfaces=pair("surfaces", image.read_labels),
        cameras=pair("camera", cameras.read_cameramodel),
        matches=read_matches(files["matches"]) if files["matches"] else None,
        model=model.load(files["model"]) if files["model"] and files["pose"] else None,
        facets=of("facets", facets_file.Facets),
        pose=of("pose", records.Pose),
        calibration=of("calibration", records.Calibration),
        orientation=of("orientation", records.Orientation),
    )
