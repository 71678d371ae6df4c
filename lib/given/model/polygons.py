"""Polygons as a file has them, and the planar pieces that they are mended to."""

from typing import NamedTuple

import numpy as np

from lib.core.report import Note
from lib.core.stage import BadInput
from lib.given.model.triangles import ears

MANY, MOST_WORK = 256, 2e8  # corners; the sum of their squares over polygons of more of them
FLAT = 1e-3  # polygons are coplanar within this part of their size (data/SCENE.md, section 2)


class Polygons(NamedTuple):
    """What a reader of models returns, in the file's order."""

    vertices: np.ndarray  # (V, 3) m
    corners: np.ndarray  # (n,) int: indices into vertices, polygon by polygon
    starts: np.ndarray  # (P + 1,) int: polygon i has the corners from starts[i] to starts[i + 1]
    object: np.ndarray  # (P,) int: index into objects
    group: np.ndarray  # (P,) int: index into groups
    objects: list  # names
    groups: list  # names
    absent: tuple = ()  # facets that are left out and keep their numbers: (number, object, group), by number
    notes: tuple = ()  # of str: what the file holds that is not read, and what was made of what it holds


class Pieces(NamedTuple):
    """Polygons that are planar and have an area, in the file's order."""

    corners: np.ndarray  # (n,) int
    starts: np.ndarray  # (P + 1,) int
    object: np.ndarray  # (P,) int
    group: np.ndarray  # (P,) int
    area_vector: np.ndarray  # (P, 3) m2, on the front side

    @property
    def size(self):
        """(P,): how many corners each has."""
        return np.diff(self.starts)


class Shapes(NamedTuple):
    """Of every polygon."""

    area_vector: np.ndarray  # (P, 3) m2, on the front side
    diameter: np.ndarray  # (P,) m, of its box
    height: np.ndarray  # (P,) m: the greatest distance of a corner from its plane


def following(starts) -> np.ndarray:
    """(n,): for each corner the next one of its polygon, all of which have one."""
    after = np.arange(1, starts[-1] + 1)
    after[starts[1:] - 1] = starts[:-1]
    return after


def shapes(vertices, corners, starts) -> Shapes:
    """Area vectors are Newell's, relative to the first corner, so that nothing cancels far from the origin."""
    size = np.diff(starts)
    count = len(size)
    area_vector, diameter, height = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    some = np.flatnonzero(size > 0)
    if len(some) == 0:
        return Shapes(area_vector, diameter, height)
    owner = np.repeat(np.arange(count), size)
    at = starts[:-1][some]
    origin = np.zeros((count, 3))
    origin[some] = vertices[corners[at]]
    p = vertices[corners] - origin[owner]
    area_vector[some] = np.add.reduceat(np.cross(p, p[following(np.append(at, starts[-1]))]), at) / 2
    low, high = np.minimum.reduceat(p, at), np.maximum.reduceat(p, at)
    diameter[some] = np.linalg.norm(high - low, axis=1)
    mean = np.add.reduceat(p, at) / size[some, None]
    length = np.linalg.norm(area_vector, axis=1, keepdims=True)
    n = area_vector / np.where(length > 0, length, 1)
    offset = np.zeros(count)
    offset[some] = np.einsum("ij,ij->i", n[some], mean)
    height[some] = np.maximum.reduceat(np.abs(np.einsum("ij,ij->i", p, n[owner]) - offset[owner]), at)
    return Shapes(area_vector, diameter, height)


def planar_pieces(path, polygons, position) -> tuple[Pieces, list[str], int]:
    """(pieces, warnings, how many of those cut cross themselves).

    Corners that repeat their predecessor and polygons without area are dropped; polygons that are not planar are cut
    into triangles.  position : (V,) int, equal for vertices at the same place

    Raises BadInput if nothing is left.
    """
    vertices = polygons.vertices
    corners, starts = _without_repeated(polygons, position)
    size, warnings = np.diff(starts), []
    if (size[size > MANY].astype(float) ** 2).sum() > MOST_WORK:  # what ears take for polygons that cross themselves
        raise BadInput(
            f"{path}: faces: {np.count_nonzero(size > MANY)} of more than {MANY} corners, the largest of {size.max()}: "
            "cut them into triangles"
        )
    area_vector, diameter, height = shapes(vertices, corners, starts)
    area = np.linalg.norm(area_vector, axis=1)
    rounding = 4 * np.finfo(float).eps * np.abs(vertices).max()
    empty = (size < 3) | (area <= 1e-12 * diameter**2 + rounding * diameter)
    if empty.any():
        warnings.append(Note(f"{empty.sum()} polygons without area were dropped"))
        if empty.all():
            raise BadInput(f"{path}: faces: none of the {len(size)} has an area")
    crooked = ~empty & (size > 3) & (height > FLAT * np.sqrt(area))
    if crooked.any():
        warnings.append(f"{crooked.sum()} polygons are not planar and were cut into triangles")
    good = ~(empty | crooked)
    rings = [corners[np.repeat(good, size)]]
    sizes, sources, crossed = [size[good]], [np.flatnonzero(good)], 0
    for polygon in np.flatnonzero(crooked):
        cut, crosses = ears(vertices, corners[starts[polygon] : starts[polygon + 1]], area_vector[polygon])
        crossed += crosses
        rings.append(cut.ravel())
        sizes.append(np.full(len(cut), 3))
        sources.append(np.full(len(cut), polygon))
    size, source, corners = np.concatenate(sizes), np.concatenate(sources), np.concatenate(rings)
    if crooked.any():
        corners, size, source = _in_file_order(corners, size, source)
    starts = _starts(size)
    area_vector = shapes(vertices, corners, starts).area_vector
    return Pieces(corners, starts, polygons.object[source], polygons.group[source], area_vector), warnings, crossed


def _starts(size):
    return np.concatenate([[0], np.cumsum(size)])


def _without_repeated(polygons, position):
    """(corners, starts) without corners at the place of their predecessor."""
    corners, starts = polygons.corners, polygons.starts
    keep = position[corners] != position[corners[following(starts)]]
    owner = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    return corners[keep], _starts(np.bincount(owner[keep], minlength=len(starts) - 1))


def _in_file_order(corners, size, source):
    """Pieces sorted by the polygon that they come from."""
    starts, order = _starts(size), np.argsort(source, kind="stable")
    return np.concatenate([corners[starts[i] : starts[i + 1]] for i in order]), size[order], source[order]
