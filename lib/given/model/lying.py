"""What lies on what: points on triangles, and the planes of other objects that an object's open loops lie on."""

from typing import NamedTuple

import numpy as np

from lib.given.model.boxes import Boxes

NEAR = 2e-4  # in diagonals of the model: 2 mm in a room of 10 m. A lid lies no farther from the facets that it lies on.
PARALLEL = 1 - 1e-5  # cosine; 0.25 degrees
AXIS = np.array([0.5377, 0.6339, 0.5560])  # unit; no axis, no diagonal
BLOCK = 1 << 20  # heights of corners above planes that are looked at together


class Planes(NamedTuple):
    """Planes of other objects' facets, in the order of the facets."""

    normals: np.ndarray  # (P, 3)
    offsets: np.ndarray  # (P,) m

    def heights(self, p) -> np.ndarray:
        """(n, P) m: of points p (n, 3) above the planes."""
        return p @ self.normals.T - self.offsets


class Around(NamedTuple):
    """All triangles of a model."""

    model: object
    near: float  # m
    owner: np.ndarray  # (T,) object
    corners: np.ndarray  # (T, 3, 3) m
    boxes: Boxes  # of the triangles, `near` larger than they are
    first: np.ndarray  # (F,) the first triangle of each facet

    @classmethod
    def of(cls, model) -> "Around":
        extent = np.ptp(model.vertices[np.unique(model.triangles)], axis=0)
        near = NEAR * float(np.linalg.norm(extent))
        corners = model.corners()
        first = np.zeros(model.n_facets, int)  # facets of absent objects have no triangle
        there, index = np.unique(model.triangle_facet, return_index=True)
        first[there] = index
        boxes = Boxes(corners.min(axis=1) - near, corners.max(axis=1) + near)
        return cls(model, near, model.facet_object[model.triangle_facet], corners, boxes, first)


class Loop(NamedTuple):
    """Edges that one polygon of an object has, and what of other objects their middles lie on."""

    corners: np.ndarray  # (n, 3) m
    start: np.ndarray  # (n + 1,) into triangle
    triangle: np.ndarray  # (k,)

    def under(self, edge) -> np.ndarray:
        """(k,) int: the triangles that the middle of an edge lies on."""
        return self.triangle[self.start[edge] : self.start[edge + 1]]


class Beside:
    """The triangles of other objects than `thing` beside its loops, [(n, 3)] m."""

    def __init__(self, around, thing, loops):
        self.near, self._around, self._thing = around.near, around, thing
        p = np.concatenate(loops)
        self._low, self._high = p.min(axis=0), p.max(axis=0)
        self.loops = []
        for p in loops:
            point, triangle = self._touching((p + np.roll(p, -1, axis=0)) / 2)
            self.loops.append(Loop(p, np.searchsorted(point, np.arange(len(p) + 1)), triangle))

    def planes(self) -> Planes | None:
        """Those that edges lie on, of several that are the same the first; None: an edge lies on none."""
        model = self._around.model
        whole = [self._holding(p) for p, *_ in self.loops]
        for loop, facets in zip(self.loops, whole, strict=True):
            if len(facets) == 0 and (np.diff(loop.start) == 0).any():
                return None  # soon said of most objects, which are open because nobody closed them
        facets = np.unique(model.triangle_facet[self._are_beside(slice(None))])
        found = [np.intersect1d(np.concatenate(whole), facets)]
        for loop, all_of_it in zip(self.loops, whole, strict=True):
            for edge, some in enumerate(self._through_edges(loop, facets)):
                there = self.some_lie_in(loop.under(edge), model.facet_normal[some], model.facet_offset[some])
                if not there.any() and len(all_of_it) == 0:
                    return None
                found.append(some[there])
        return self._different(np.unique(np.concatenate(found)))

    def on(self, normal, offset, p) -> np.ndarray:
        """(n,) bool: points p (n, 3) that lie on triangles of a plane."""
        point, triangle = self._touching(p)
        result = np.zeros(len(p), bool)
        result[point[self._lie_in(triangle, normal[None], np.array([offset]))[:, 0]]] = True
        return result

    def some_lie_in(self, triangles, normals, offsets) -> np.ndarray:
        """(P,) bool: planes in which one of the triangles lies.  normals : (P, 3);  offsets : (P,) m"""
        return self._lie_in(triangles, normals, offsets).any(axis=0)

    def _lie_in(self, triangles, normals, offsets):
        """(t, P) bool: triangles in planes, or parallel to them: what a point touches is not far from it."""
        model = self._around.model
        parallel = np.abs(model.facet_normal[model.triangle_facet[triangles]] @ normals.T) >= PARALLEL
        return parallel | (np.abs(self._around.corners[triangles] @ normals.T - offsets).max(axis=1) <= self.near)

    def _touching(self, p):
        """Pairs of points p (n, 3) and triangles that they lie on: (k,) numbers of points, (k,) of triangles."""
        point, triangle = self._around.boxes.holding(p)
        kept = self._are_beside(triangle)
        point, triangle = point[kept], triangle[kept]
        kept = _lie_on(self._around.corners[triangle], p[point], self.near)
        return point[kept], triangle[kept]

    def _holding(self, p):
        """(k,) int: facets whose planes hold all points p (n, 3)."""
        model = self._around.model
        facets = np.arange(model.n_facets)
        for q in p:
            height = model.facet_normal[facets] @ q - model.facet_offset[facets]
            facets = facets[np.abs(height) <= self.near]
            if len(facets) == 0:
                break
        return facets

    def _through_edges(self, loop, facets):
        """Of each edge the facets (k,), of some, whose planes it lies in."""
        normal, offset = self._around.model.facet_normal[facets], self._around.model.facet_offset[facets]
        p, step = loop.corners, max(1, BLOCK // max(len(facets), 1))
        for first in range(0, len(p), step):
            corners = np.take(p, np.arange(first, min(first + step, len(p)) + 1), axis=0, mode="wrap")
            near = np.abs(corners @ normal.T - offset) <= self.near
            for row in near[:-1] & near[1:]:
                yield facets[row]

    def _different(self, facets):
        """Planes of facets, of several that are the same the first."""
        model = self._around.model
        normal, offset = model.facet_normal[facets], model.facet_offset[facets]
        first = self._around.corners[self._around.first[facets]]
        along = np.abs(normal @ AXIS)  # much the same of planes that are the same
        order = np.argsort(along)
        reach = np.sqrt(2 * (1 - PARALLEL)) * (1 + 1e-6)
        start, end = (np.searchsorted(along[order], along + way * reach) for way in (-1, 1))
        new = np.ones(len(facets), bool)
        for k in range(len(facets)):
            if new[k]:
                others = order[start[k] : end[k]]
                others = others[(others > k) & new[others]]
                others = others[np.abs(normal[others] @ normal[k]) >= PARALLEL]
                new[others[np.abs(first[others] @ normal[k] - offset[k]).max(axis=1) <= self.near]] = False
        return Planes(normal[new], offset[new])

    def _are_beside(self, triangle):
        """bool for each of the triangles: of another object, and it meets the box around the loops."""
        boxes = self._around.boxes
        beside = self._around.owner[triangle] != self._thing
        for k in range(3):
            beside &= (boxes.low[triangle, k] <= self._high[k]) & (boxes.high[triangle, k] >= self._low[k])
        return beside


def covered(triangles, p, near) -> np.ndarray:
    """(n,) bool: points p (n, 3) that lie on one of the triangles (T, 3, 3), or not farther from it than `near`."""
    point, triangle = Boxes(triangles.min(axis=1) - near, triangles.max(axis=1) + near).holding(p)
    result = np.zeros(len(p), bool)
    result[point[_lie_on(triangles[triangle], p[point], near)]] = True
    return result


def _lie_on(triangles, p, near):
    """(n,) bool: does each point of p (n, 3) lie on its own triangle (n, 3, 3)?"""
    side = np.roll(triangles, -1, axis=1) - triangles
    n = np.cross(side[:, 0], side[:, 1])
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    result = np.abs(np.einsum("ij,ij->i", p - triangles[:, 0], n)) <= near
    inward = np.cross(n[:, None], side)
    inward /= np.linalg.norm(inward, axis=2, keepdims=True)
    return result & (np.einsum("nkj,nkj->nk", p[:, None] - triangles, inward) >= -near).all(axis=1)


def spread(triangles, count) -> np.ndarray:
    """(n, 3) about `count` points, evenly over triangles (T, 3, 3): the additive sequence of the plastic number."""
    v = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(v, axis=1)
    counts = np.ceil(count * area / area.sum()).astype(int)
    a, b, c = np.moveaxis(np.repeat(triangles, counts, axis=0), 1, 0)
    number = np.arange(len(a)) - np.repeat(np.cumsum(counts) - counts, counts)
    u, v = (0.5 + np.outer([0.7548776662466927, 0.5698402909980532], number)) % 1
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    return a + u[:, None] * (b - a) + v[:, None] * (c - a)
