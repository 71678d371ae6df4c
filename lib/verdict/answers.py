"""What came out of the stages, and what is true: the same files under the same names, so both are `Answers`.

true = read_truth(truth_files("data/office/truth"))
found = Answers.read({"group": "build/office/group.png", ...})
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.core import record
from lib.core.stage import BadInput
from lib.given import cameras, image, lenses, materials, model
from lib.verdict import records
from lib.vision import facets_file

READERS = {
    "materials": materials.read,
    "legend": lambda path: record.read(path, records.Legend),
    "scores": lambda path: record.read(path, records.Scores),
    **dict.fromkeys(("group", "object", "facet", "mirror", "surfaces"), image.read_labels),
    "depth": image.read_exr,
    "model": model.load,
    "calibration": lambda path: record.read(path, records.Calibration),
    **dict.fromkeys(("lens", "lens_right"), lenses.read),
    **dict.fromkeys(("camera", "camera_right", "posed"), cameras.read_cameramodel),
    "facets": lambda path: record.read(path, facets_file.Facets),
    "pose": lambda path: record.read(path, records.Pose),
    "poses": lambda path: record.read(path, records.FurtherPhotographs),
}
TRUE_READERS = READERS | {
    "legend": lambda path: record.read(path, records.TrueLegend),
    "pose": lambda path: record.read(path, records.ObjectPoses),
}
# of the vision half: read only where truth says something of it
VISION = (
    *("model", "calibration", "lens", "lens_right", "camera", "camera_right", "posed", "surfaces", "facets", "pose"),
    "poses",
)
IMAGES = ("group", "object", "mirror", "depth")  # compared pixel by pixel
TRUE_FILES = {
    "materials": "materials.json",
    "legend": "legend.json",
    "group": "group.png",
    "object": "object.png",
    "mirror": "mirror.png",
    "depth": "depth.exr",
    "lens": "left.cameramodel",
    "lens_right": "right.cameramodel",
    "posed": "left.posed.cameramodel",
    "calibration": "calibration.json",
    "pose": "pose.json",
    "poses": "photos.json",
}


@dataclass(frozen=True, eq=False)
class Answers:
    """Each may be None: there is no such file.

    group, object, facet : (H, W) index + 1;  mirror : (H, W) index + 1 of the group that a mirror shows
    depth : (H, W) m, 0 = nothing;  surfaces : (H, W) labels from 1
    lens, lens_right : Lens;  camera, camera_right : pinholes in the pair's frame;  posed : in the model's frame
    disparity : (H, W) px, NaN where it is not known; there is only a true one
    """

    materials: materials.Materials | None = None
    legend: records.Legend | None = None
    scores: records.Scores | None = None
    group: np.ndarray | None = None
    object: np.ndarray | None = None
    facet: np.ndarray | None = None
    mirror: np.ndarray | None = None
    depth: np.ndarray | None = None
    model: model.Model | None = None
    calibration: records.Calibration | None = None
    lens: lenses.Lens | None = None
    lens_right: lenses.Lens | None = None
    camera: cameras.Camera | None = None
    camera_right: cameras.Camera | None = None
    posed: cameras.Camera | None = None
    surfaces: np.ndarray | None = None
    facets: facets_file.Facets | None = None
    pose: records.Pose | records.ObjectPoses | None = None  # of truth, the objects alone
    poses: records.FurtherPhotographs | None = None
    disparity: np.ndarray | None = None

    @classmethod
    def read(cls, paths, readers=READERS, **more):
        """paths : {name: path or None}. BadInput: a file breaks its rules, or an index that the legend has not."""
        found = cls(**{name: readers[name](path) for name, path in paths.items() if path}, **more)
        for name, kind in (("group", "group"), ("object", "object"), ("mirror", "group")):
            labels = getattr(found, name)
            if labels is None or found.legend is None:
                continue
            names = found.legend.names(kind)
            if labels.max() > len(names):
                raise BadInput(
                    f"{paths[name]}: index: {labels.max()} is more than the {len(names)} {kind}s of the legend"
                )
        return found

    @property
    def has_vision(self):
        """Anything that tells how good the vision half is."""
        return any(getattr(self, name) is not None for name in (*VISION, "disparity"))


def truth_files(folder):
    """{file name: path} of a folder of true answers; none where folder is None. BadInput: there is no such folder."""
    if folder is None:
        return {}
    if not Path(folder).is_dir():
        raise BadInput(f"{folder}: there is no such folder")
    return {path.name: path for path in sorted(Path(folder).iterdir()) if path.is_file()}


def read_truth(files) -> Answers:
    """files : of `truth_files`"""
    disparity = None
    if "disparity.png" in files:
        path = files["disparity.png"]
        scale, grey = record.read(path.with_suffix(".json"), records.DisparityScale), image.read_labels(path)
        disparity = np.where(grey == scale.unknown, np.nan, grey * scale.px_per_grey)
    paths = {name: files.get(file) for name, file in TRUE_FILES.items()}
    return Answers.read(paths, TRUE_READERS, disparity=disparity)


def read_found(files, true: Answers) -> Answers:
    """files : {name: path or None} of READERS; what truth says nothing of is not read"""
    wanted = [name for name in READERS if name not in VISION or true.has_vision]
    return Answers.read({name: files[name] for name in wanted})


def of_another_size(found: Answers, true: Answers):
    """Names of the images that cannot be compared pixel by pixel."""
    both = [(name, getattr(found, name), getattr(true, name)) for name in IMAGES]
    return [name for name, a, b in both if a is not None and b is not None and a.shape != b.shape]
