"""facets.json: the planes of matched regions, as records of the file and as arrays.

    facets = record.read("facets.json", Facets)         # what compare and the page show
    scene = read_scene("facets.json")                   # what recognition searches: every number checked
    artefact.write_json("facets.json", describe(found, refused, unit))

data/SCENE.md, section 4, describes the file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.core import artefact, record
from lib.core.record import flag, list_of, matrix, number, numbers, part, told, word
from lib.core.stage import BadInput

LARGEST = 1e12  # of any number in the file
UNITS = ("m", "baseline")


@dataclass(frozen=True)
class Plane:
    """n . x = d with |n| = 1; n points towards the camera, so d <= 0."""

    n: tuple | None = told(numbers(3), needed="three numbers")
    d: float | None = told(number(), needed="a number")


@dataclass(frozen=True)
class Facet:
    """One plane. polygon : (k, 3) in the left camera's frame;  covariance : (3, 3) of m = n / d;  labels : from 1

    by : what told it, "contour", "texture" or "both";  loose : the tilt's sigma exceeds 4 degrees
    """

    left_label: int | None = told(number(), needed="a label")
    right_label: int | None = told(number())
    plane: Plane = part(Plane)
    polygon: tuple | None = told(matrix(columns=3), needed="a list of points")
    overlap: float | None = told(number())
    covariance: tuple | None = told(matrix(3, 3))
    rms_px: float | None = told(number())
    by: str | None = told(word("contour", "texture", "both"))
    loose: bool | None = told(flag)


@dataclass(frozen=True)
class Refused:
    """A matched pair that gave no plane, and why."""

    left_label: int | None = told(number())
    right_label: int | None = told(number())
    why: str | None = told(word())


@dataclass(frozen=True)
class Facets:
    """The file. frame : "left";  unit : "m" or "baseline" """

    frame: str | None = told(word())
    unit: str | None = told(word())
    facets: list = list_of(Facet, needed="a list of facets")
    refused: list = list_of(Refused)


@dataclass(frozen=True, eq=False)
class SceneFacets:
    """The planes as arrays.

    m : (N, 3) 1/unit               m . x = 1 on the plane, left frame
    covariance : (N, 3, 3)         of m
    polygons : list of (k, 3)      outlines of what was seen, on the planes
    labels : (N, 2) int            regions, left and right; 0 where nobody said
    unit : "m" or "baseline"
    """

    m: np.ndarray
    covariance: np.ndarray
    polygons: list
    labels: np.ndarray
    unit: str = "m"

    def __len__(self):
        return len(self.m)

    @property
    def normal(self):
        """(N, 3) unit, towards the camera: n . x = d with d <= 0."""
        return -self.m / np.linalg.norm(self.m, axis=1, keepdims=True)

    @property
    def distance(self):
        """(N,) unit: of the planes from the camera."""
        return 1 / np.linalg.norm(self.m, axis=1)


def describe(found, refused, unit) -> dict:
    """The content of the file. found, refused : of facets.reconstruct"""
    facets = [
        Facet(
            *(x.left_label, x.right_label, Plane(*x.plane), x.polygon, x.overlap, x.covariance, x.rms_px, x.by, x.loose)
        )
        for x in found
    ]
    return record.plain(Facets("left", unit, facets, [Refused(x.left_label, x.right_label, x.why) for x in refused]))


def unit_of(orientation):
    """ "m", or "baseline" where orientation.json (path or None) says so."""
    if orientation is None:
        return "m"
    content = artefact.read_json(orientation)
    unit = content.get("unit", "m") if isinstance(content, dict) else None
    if unit not in UNITS:
        raise BadInput(f"{orientation}: unit: {unit!r} is neither 'm' nor 'baseline'")
    return unit


def read_scene(path) -> SceneFacets:
    """The facets as arrays. BadInput: a frame or unit that is none, a plane, covariance or polygon that cannot be."""
    content = record.read(path, Facets)
    for key, value, known in (("frame", content.frame, ("left",)), ("unit", content.unit, UNITS)):
        if value not in known:
            raise BadInput(f"{path}: {key}: {value!r} is not {' or '.join(known)}")
    m, covariance, polygons, labels = [], [], [], []
    for i, facet in enumerate(content.facets):
        where = f"{path}: facets: {i}"
        m.append(_reciprocal(where, facet.plane))
        covariance.append(_symmetric(where, facet.covariance))
        polygons.append(_finite(where, "polygon", facet.polygon).reshape(-1, 3))
        labels.append([int(facet.left_label), int(facet.right_label or 0)])
        if len(facet.polygon) < 3:
            raise BadInput(f"{where}: polygon: {len(facet.polygon)} corners instead of at least 3")
    return SceneFacets(
        np.array(m, float).reshape(-1, 3),
        np.array(covariance, float).reshape(-1, 3, 3),
        polygons,
        np.array(labels, int).reshape(-1, 2),
        content.unit,
    )


def _reciprocal(where, plane):
    """(3,) m = n / d of a Plane."""
    if plane.n is None:
        raise BadInput(f"{where}: plane: is missing")
    n, d = _finite(where, "plane.n", plane.n), float(_finite(where, "plane.d", plane.d))
    length = np.linalg.norm(n)
    if abs(length - 1) > 1e-3 or d >= 0:
        raise BadInput(
            f"{where}: plane: a unit normal towards the camera and d < 0 are needed, got |n| = {length:.4g}, d = {d:g}"
        )
    return n / d


def _finite(where, name, values):
    """As an array of numbers that are not too large to be squared."""
    array = np.array(values, float)
    if not (np.abs(array) <= LARGEST).all():
        raise BadInput(f"{where}: {name}: numbers of at most {LARGEST:g} are needed, got {values!r:.60}")
    return array


def _symmetric(where, covariance):
    """(3, 3), symmetric."""
    if covariance is None:
        raise BadInput(f"{where}: covariance: is missing")
    spread = _finite(where, "covariance", covariance)
    symmetric = (spread + spread.T) / 2
    if np.linalg.eigvalsh(symmetric)[0] < -1e-6 * max(abs(np.trace(spread)), 1e-300):
        raise BadInput(f"{where}: covariance: has a negative eigenvalue")
    return symmetric
