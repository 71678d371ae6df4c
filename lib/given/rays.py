"""Rays: Embree through open3d, low-discrepancy points, and which facets can cast a shadow at all.

All geometry here is *local*: centred on the model and divided by its diagonal.  So float32 rays mean the same in a
doll's house, a hangar, or a room a thousand kilometres from the origin (docs/decisions/local-coordinates.md).  Form
factors do not change under that map; lengths and areas are multiplied back where they are reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.core import packages
from lib.core.rows import distinct
from lib.given import rays_kernels as kernels
from lib.given.extent import smallest_ball
from lib.given.rays_kernels import OFFSET

GRID = 2.0**36  # steps of local coordinates to a diagonal: another unit of length rounds otherwise, by 1e-16


@dataclass(frozen=True)
class Local:
    """The map into local coordinates: x_local = (x - centre) / diagonal."""

    centre: np.ndarray  # (3,) m
    diagonal: float  # m

    @classmethod
    def of(cls, model) -> Local:
        """Of the vertices that a model's triangles use: of the smallest ball around them. Turned, it is the same."""
        used = model.vertices[np.unique(model.triangles)]
        near = used[0]  # so that nothing cancels far from the origin
        centre, radius = smallest_ball(used - near)
        return cls(near + centre, 2 * radius)

    def points(self, p) -> np.ndarray:
        """(..., 3) m -> local, on a grid: the same places in metres and in millimetres, to the last bit."""
        return np.rint((np.asarray(p, float) - self.centre) / self.diagonal * GRID) / GRID


class Caster:
    """Closest hits and occlusion for triangles in local coordinates, (T, 3, 3) float."""

    def __init__(self, triangles):
        o3d = packages.open3d()
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene()
        self.empty = len(triangles) == 0
        if not self.empty:
            corners = np.ascontiguousarray(triangles, np.float32).reshape(-1, 3)
            index = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
            self._scene.add_triangles(self._tensor(corners), self._tensor(index))

    def closest(self, rays):
        """rays (n, 6) float32: origin, unit direction -> triangle (n,) int32 (-1: none), distance (n,) float32."""
        if self.empty:
            return np.full(len(rays), -1, np.int32), np.full(len(rays), np.inf, np.float32)
        hits = self._scene.cast_rays(self._tensor(rays))
        return hits["primitive_ids"].numpy().view(np.int32), hits["t_hit"].numpy()

    def occluded(self, rays, far=1.0):
        """rays (n, 6) float32: origin, vector to the target -> (n,) bool: something stands before `far` of the way."""
        if self.empty:
            return np.zeros(len(rays), bool)
        return self._scene.test_occlusions(self._tensor(rays), 0.0, far).numpy()

    def crossings(self, rays):
        """All that rays (n, 6) cross: (k,) numbers of rays, (k,) triangles. Of triangles that coincide one is named."""
        met = self._scene.list_intersections(self._tensor(np.ascontiguousarray(rays, np.float32)))
        return met["ray_ids"].numpy().astype(np.int64), met["primitive_ids"].numpy().astype(np.int64)

    def winding(self, rays, turn, facet, normal):
        """How many solids each ray starts in, (n,) int: it leaves one more of them than it enters.

        rays : (n, 6) float32;  turn : (F,), see `overlap` of lib/light/surface.py;  facet : (T,) facet of each triangle
        normal : (F, 3)
        """
        ray, triangle = self.crossings(rays)
        f = facet[triangle]
        leaves = np.sign(np.einsum("ij,ij->i", rays[ray, 3:], normal[f])) * turn[f]
        return np.rint(np.bincount(ray, leaves, len(rays))).astype(int)


def occluders(corners, facet_of_triangle, n_facets=None) -> np.ndarray:
    """Which facets can stand between two points of the model, (F,) bool.

    A facet whose plane has the whole model on one side (the walls of a plain room) bounds the scene and never occludes.
    Where no facet is left, no visibility ray is cast.

    corners : (T, 3, 3) local;  facet_of_triangle : (T,) int;  n_facets : F, by default up to the last that has a
    triangle: those of absent objects have none, and occlude nothing
    """
    points = corners.reshape(-1, 3)
    points = points[distinct(points)[0]]
    n_facets = n_facets or int(facet_of_triangle.max()) + 1
    there, first = np.unique(facet_of_triangle, return_index=True)
    v = corners[first]
    normal = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    if n_facets * len(points) > 50_000_000:  # heights would take 400 MB
        return np.ones(n_facets, bool)
    height = points @ normal.T - np.einsum("ij,ij->i", v[:, 0], normal)
    tolerance = 2 * OFFSET
    can = np.zeros(n_facets, bool)
    can[there] = (height.max(axis=0) > tolerance) & (height.min(axis=0) < -tolerance)
    return can


# ---- low-discrepancy points: Sobol', 4 dimensions (Joe & Kuo), scrambled by a digital shift per element ----


def _directions():
    """(4, 32) uint32: the direction numbers of Joe and Kuo's first four dimensions."""
    V = np.zeros((4, 32), np.uint64)
    V[0] = [1 << (31 - i) for i in range(32)]
    for d, (s, a, m) in enumerate([(1, 0, [1]), (2, 1, [1, 3]), (3, 1, [1, 3, 1])], start=1):
        v = [m[i] << (31 - i) for i in range(s)]
        for i in range(s, 32):
            x = v[i - s] ^ (v[i - s] >> s)
            for k in range(1, s):
                x ^= ((a >> (s - 1 - k)) & 1) * v[i - k]
            v.append(x)
        V[d] = v
    return V.astype(np.uint32)


_V = _directions()


def sobol(n, at=None) -> np.ndarray:
    """(n, 4) uint32, the first n points of the sequence, or those numbered `at`; / 2**32 gives [0, 1).

    Aligned blocks of 2^m points are shifts of each other (x_{b 2^m + k} = x_{b 2^m} xor x_k).  So elements that take
    consecutive blocks are each well spread, and well spread together.
    """
    return kernels.points(np.arange(n, dtype=np.uint64) if at is None else np.asarray(at, np.uint64), _V)


def shifts(elements, n_points, seed) -> np.ndarray:
    """(elements, 4) uint32: element i takes block i of the sequence, all shifted alike by the seed.

    elements : how many, or the numbers (m,) of their blocks
    """
    block = 1 << max(0, int(n_points - 1).bit_length())
    scramble = np.random.default_rng(seed).integers(0, 1 << 32, 4, np.uint32)
    number = np.arange(elements, dtype=np.uint64) if np.ndim(elements) == 0 else np.asarray(elements, np.uint64)
    return sobol(len(number), number * np.uint64(block)) ^ scramble
