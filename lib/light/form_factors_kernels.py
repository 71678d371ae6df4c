"""Compiled: rays from patches and points, where they arrive, and how often."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light.cells_kernels import PatchPieces, PatchTable, in_patch, patch_under
from lib.light.sampling_kernels import cosine, scrambled
from lib.light.surface_kernels import SurfaceArrays

ESCAPED, DROPPED, LOST = -1, -2, -3  # where a ray arrives that meets no patch


# ---- ray generation ----


@njit(inline="always")
def inside(u, size):
    """u, a ray's offset away from the ends of 0 ... size: beside a wall that leans over it would start beyond that."""
    return min(max(u, min(OFFSET, 0.5 * size)), max(size - OFFSET, 0.5 * size))


@njit(parallel=True)
def patch_rays(first, last, n, points, shift, pieces: PatchPieces, surface: SurfaceArrays):
    """n rays of each of the patches first..last-1, ((last - first) * n, 6) float32.

    points : (n, 4), shift : (N, 4) uint32
    """
    origin, axes, normal = surface.origin, surface.axes, surface.normal
    out = np.empty(((last - first) * n, 6), np.float32)
    for i in prange(first, last):
        h0, h1, h2, h3 = shift[i]
        for k in range(n):
            s, u, v = in_patch(i, scrambled(points[k, 0], h0), scrambled(points[k, 1], h1), pieces)
            f = s >> 1
            nrm = normal[f] * (1.0 - 2.0 * (s & 1))
            u, v = inside(u, surface.size[f, 0]), inside(v, surface.size[f, 1])
            row = (i - first) * n + k
            for d in range(3):
                out[row, d] = origin[f, d] + u * axes[f, 0, d] + v * axes[f, 1, d] + OFFSET * nrm[d]
            cosine(scrambled(points[k, 2], h2), scrambled(points[k, 3], h3), nrm, axes[f, 0], axes[f, 1], out, row)
    return out


class PointSets(NamedTuple):
    """Sets of points that rays start from."""

    ray_start: np.ndarray  # (K + 1,) int64, the rays of each set
    start: np.ndarray  # (K + 1,) int64 into p
    p: np.ndarray  # (M, 3) local
    side: np.ndarray  # (K,) int32, side of the facet that the points lie on


@njit(parallel=True)
def point_rays(first, last, sets: PointSets, points, shift, other, surface: SurfaceArrays):
    """Rays of the sets first..last-1, (n, 6) float32.

    points : (..., 4);  shift, other : (K, 4) of the first and of the second half of a set's rays, which are scrambled
    independently so that their errors are independent, too (docs/decisions/instruments.md)
    """
    ray_start, start, axes, normal = sets.ray_start, sets.start, surface.axes, surface.normal
    base = ray_start[first]
    out = np.empty((ray_start[last] - base, 6), np.float32)
    for i in prange(first, last):
        f = sets.side[i] >> 1
        nrm = normal[f] * (1.0 - 2.0 * (sets.side[i] & 1))
        m = start[i + 1] - start[i]
        n = ray_start[i + 1] - ray_start[i]
        for j in range(n):
            k = j if j < (n + 1) // 2 else j - (n + 1) // 2
            h0, _, h2, h3 = shift[i] if j < (n + 1) // 2 else other[i]
            q = start[i] + min(m - 1, int(scrambled(points[k, 0], h0) * m))
            row = ray_start[i] - base + j
            for d in range(3):
                out[row, d] = sets.p[q, d] + OFFSET * nrm[d]
            cosine(scrambled(points[k, 2], h2), scrambled(points[k, 3], h3), nrm, axes[f, 0], axes[f, 1], out, row)
    return out


# ---- binning ----


@njit(parallel=True)
def locate(rays, triangle, distance, surface: SurfaceArrays, table: PatchTable):
    """The patch each ray arrives at, (n,) int32, or ESCAPED, DROPPED, LOST."""
    facet, normal, origin, axes = surface.facet, surface.normal, surface.origin, surface.axes
    size, inside = surface.size, surface.inside
    start, shape, leaf = table.start, table.shape, table.leaf
    n = len(rays)
    out = np.empty(n, np.int32)
    for k in prange(n):
        if triangle[k] < 0:
            out[k] = ESCAPED
            continue
        f = facet[triangle[k]]
        along = rays[k, 3] * normal[f, 0] + rays[k, 4] * normal[f, 1] + rays[k, 5] * normal[f, 2]
        s = 2 * f + (1 if along > 0 else 0)
        # a side without patches sees nothing: the ray starts in the crack of a contact
        if inside[s] or start[s] < 0:
            out[k] = DROPPED
            continue
        u = 0.0
        v = 0.0
        for d in range(3):
            x = rays[k, d] + distance[k] * rays[k, 3 + d] - origin[f, d]
            u += x * axes[f, 0, d]
            v += x * axes[f, 1, d]
        patch = patch_under(u, v, s, size[f], start, shape, leaf)
        out[k] = patch if patch >= 0 else LOST
    return out


@njit(parallel=True)
def compress(hit, ray_start, first, last):
    """Count equal hits of each of the elements first..last-1.

    hit : patch of each of their rays;  ray_start : (M + 1,)
    Returns 2 * patch + half of each ray, sorted within its element, and per element the entries of its row, the rays
    that count, those of them in the first half, and the lost ones.
    """
    m = last - first
    base = ray_start[first]
    entries = np.zeros(m, np.int64)
    valid = np.zeros(m, np.float32)
    valid_half = np.zeros(m, np.float32)
    lost = np.zeros(m, np.float32)
    keys = np.empty(len(hit), np.int64)
    for i in prange(m):
        a, b = ray_start[first + i] - base, ray_start[first + i + 1] - base
        middle = a + (b - a + 1) // 2
        for k in range(a, b):
            h = hit[k]
            keys[k] = 2 * np.int64(h) + (1 if k >= middle else 0)
            if h != DROPPED:
                valid[i] += 1
                if k < middle:
                    valid_half[i] += 1
            if h == LOST:
                lost[i] += 1
        keys[a:b].sort()
        previous = np.int64(-1)
        for k in range(a, b):
            patch = keys[k] >> 1
            if patch >= 0 and patch != previous:
                entries[i] += 1
                previous = patch
    return keys, entries, valid, valid_half, lost


@njit(parallel=True)
def fill(keys, ray_start, first, last, indptr):
    """The rows of the elements first..last-1: indices, count and half of FormFactorRows.  keys : of `compress`"""
    base = ray_start[first]
    n = indptr[-1]
    indices = np.empty(n, np.int32)
    count = np.zeros(n, np.float32)
    half = np.zeros(n, np.float32)
    for i in prange(last - first):
        a, b = ray_start[first + i] - base, ray_start[first + i + 1] - base
        out = indptr[i] - 1
        previous = np.int64(-1)
        for k in range(a, b):
            patch = keys[k] >> 1
            if patch < 0:
                continue
            if patch != previous:
                out += 1
                indices[out] = patch
                previous = patch
            count[out] += 1
            if keys[k] & 1 == 0:
                half[out] += 1
    return indices, count, half
