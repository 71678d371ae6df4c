"""What other stages wrote as JSON, as records: legend, scores, pose, facets, calibration, orientation.

    pose = record.read("pose.json", Pose)
    legend = record.read("legend.json", Legend)

Each holds the fields that the comparison or the page uses. data/SCENE.md and data/FORMATS.md describe the files.
"""

from __future__ import annotations

from dataclasses import dataclass

from lib.core.record import flag, items, list_of, list_with, matrix, number, numbers, part, table_of, told, word


@dataclass(frozen=True)
class Legend:
    """legend.json: the names of the indices in group.png and object.png, from 0."""

    groups: list | None = told(list_with(word(), "names"), needed="a list of names")
    objects: list | None = told(list_with(word(), "names"), needed="a list of names")

    def names(self, kind):
        """Those of "group" or of "object"."""
        return {"group": self.groups, "object": self.objects}[kind]


@dataclass(frozen=True)
class TrueLegend(Legend):
    """The same of truth, which may name the groups alone."""

    objects: list | tuple = told(list_with(word(), "names"), ())


@dataclass(frozen=True)
class Score:
    """Of display values in [0, 1], against the photograph."""

    rmse: float | None = told(number())
    ciede2000: float | None = told(number())


@dataclass(frozen=True)
class Scores:
    """rendered.json: of the whole picture, and of each group that is seen."""

    rmse: float | None = told(number())
    ciede2000: float | None = told(number())
    groups: dict = table_of(Score)


# ---- the vision half ----


@dataclass(frozen=True)
class PoseMatch:
    """A reconstructed facet, by its left region's label, and the model's facet, from 0."""

    left_label: int | None = told(number())
    facet: int | None = told(number())


@dataclass(frozen=True)
class PoseStep:
    """scale : metres per unit of the pair, where the step changed it"""

    step: str | None = told(word())
    iteration: int | None = told(number())
    error_px: float | None = told(number())
    rt_cam_world: tuple | None = told(numbers(6))
    scale: float | None = told(number())


@dataclass(frozen=True)
class ObjectPose:
    """rt_world_object : from the place in the model, or the object's own file, to the world;  found : None for unknown

    covariance : (6, 6) of (omega, tau), T = exp(omega, tau) T_hat along the world's axes, rad and m
    """

    rt_world_object: tuple | None = told(numbers(6))
    covariance: tuple | None = told(matrix(6, 6))
    found: bool | None = told(flag)


@dataclass(frozen=True)
class ObjectPoses:
    """Of pose.json, the objects alone."""

    objects: dict = table_of(ObjectPose)


@dataclass(frozen=True)
class FurtherPhotograph:
    """status : given, found or "not found";  covariance : (6, 6) of (omega, tau), rad and m;  why : not found"""

    status: str | None = told(word())
    rt_cam_world: tuple | None = told(numbers(6))
    covariance: tuple | None = told(matrix(6, 6))
    focal_px: float | None = told(number(0))
    focal_sigma_px: float | None = told(number(0))
    rms_px: float | None = told(number(0))
    edges_found: float | None = told(number(0, 1))
    why: str | None = told(word())


@dataclass(frozen=True)
class FurtherPhotographs:
    """photos.json."""

    photographs: dict = table_of(FurtherPhotograph)


@dataclass(frozen=True)
class PickedPlace:
    """px : from where the camera sees it, None behind it"""

    name: str = told(word(), needed="a name")
    px: float | None = told(number())
    outlier: bool = told(flag, needed="true or false")


@dataclass(frozen=True)
class Pose:
    """pose.json. rt_cam_world : Rodrigues vector and metres;  covariance : (6, 6) of (omega, tau), rad and m

    scale : metres per baseline, None where the pair had a length;  ambiguous : other poses that explain the facets, or
    the equal ones of a model that comes onto itself, where the status is `symmetric`
    """

    rt_cam_world: tuple | None = told(numbers(6), needed="six numbers")
    scale: float | None = told(number())
    covariance: tuple | None = told(matrix(6, 6))
    matches: list = list_of(PoseMatch)
    trace: list = list_of(PoseStep)
    ambiguous: list = told(items, list)
    status: str | None = told(word(), absent=True)
    objects: dict = table_of(ObjectPose, absent=True)
    residuals: list = list_of(PickedPlace)

    @property
    def others(self):
        """How many other poses, not equal ones, explain the photographs as well."""
        return 0 if self.status == "symmetric" else len(self.ambiguous)


@dataclass(frozen=True)
class Uncertainty:
    """One sigma of a projected point at distance_m. sigma_px : over the picture, None where it is not known

    centre_px : the largest of the middle of the picture
    """

    distance_m: float | None = told(number())
    centre_px: float | None = told(number())
    sigma_px: tuple | None = told(matrix(unknown=True))


@dataclass(frozen=True)
class CalibratedLens:
    """One camera of calibration.json. size : width and height, px;  rms : px, by point"""

    lens: str | None = told(word())
    size: tuple | None = told(numbers(2))
    fx: float | None = told(number())
    fy: float | None = told(number())
    cx: float | None = told(number())
    cy: float | None = told(number())
    rms: float | None = told(number())
    boards: int | None = told(number())
    corners: int | None = told(number())
    outliers: int | None = told(number())
    uncertainty: Uncertainty = part(Uncertainty)


@dataclass(frozen=True)
class CalibratedPair:
    """The relative pose."""

    baseline_m: float | None = told(number())
    baseline_sigma_m: float | None = told(number())
    angle_deg: float | None = told(number())


@dataclass(frozen=True)
class Calibration:
    """calibration.json. cameras : {"left", "right": CalibratedLens};  verdict : one line for people"""

    verdict: str | None = told(word())
    cameras: dict = table_of(CalibratedLens)
    pair: CalibratedPair = part(CalibratedPair)


@dataclass(frozen=True)
class Orientation:
    """orientation.json: the relative pose up to scale."""

    inliers: int | None = told(number())
    rms_px: float | None = told(number())
    angle_deg: float | None = told(number())
    planar: bool | None = told(flag)


@dataclass(frozen=True)
class DisparityScale:
    """truth/disparity.json: pixels per grey value of disparity.png, and the grey that stands for nothing known."""

    px_per_grey: float | None = told(number(), needed="a number")
    unknown: int | None = told(number(), needed="a number")
