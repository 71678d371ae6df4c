"""Compiled: rays from pixels, and what they see of the light map."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light.lamps_kernels import LampArrays, aim
from lib.light.sampling_kernels import cosine, scrambled
from lib.light.surface_kernels import SurfaceArrays
from lib.picture.light_map_kernels import LightMapArrays, blend, texel


class RayEnds(NamedTuple):
    """Rays, and what they meet first."""

    rays: np.ndarray  # (n, 6) float32
    triangle: np.ndarray  # (n,) int32, -1
    t: np.ndarray  # (n,) float32


class Places(NamedTuple):
    """Places on sides, each of which owns some points."""

    first: np.ndarray  # (K,)
    last: np.ndarray  # (K,) into p
    p: np.ndarray  # (M, 3) local
    side: np.ndarray  # (K,)


@njit(inline="always")
def side_met(rays, i, f, normal):
    """The side of facet f that ray i meets."""
    along = rays[i, 3] * normal[f, 0] + rays[i, 4] * normal[f, 1] + rays[i, 5] * normal[f, 2]
    return 2 * f + (1 if along > 0 else 0)


@njit(inline="always")
def end(rays, t, i):
    """(3,) where ray i ends."""
    p = np.empty(3)
    for d in range(3):
        p[d] = rays[i, d] + t[i] * rays[i, 3 + d]
    return p


@njit(parallel=True)
def reflected_at(ends: RayEnds, surface: SurfaceArrays, start, shape, value):
    """(n, C) value (K, C) of the light map at the ends of rays; 0 inside solids and where no light is.

    start, shape : of a LightMapArrays
    """
    rays, triangle, t = ends
    facet, normal, inside = surface.facet, surface.normal, surface.inside
    origin, axes, size = surface.origin, surface.axes, surface.size
    C = value.shape[1]
    out = np.zeros((len(rays), C))
    for i in prange(len(rays)):
        if triangle[i] < 0:
            continue
        f = facet[triangle[i]]
        s = side_met(rays, i, f, normal)
        if inside[s] or start[s] < 0:
            continue
        here, du, dv, u, v = texel(end(rays, t, i), f, s, origin, axes, size, start, shape)
        for c in range(C):
            out[i, c] = blend(value, c, here, du, dv, u, v)
    return out


@njit(parallel=True)
def close_rays(rows, ends: RayEnds, k, surface: SurfaceArrays, shown: LightMapArrays, lamp: LampArrays):
    """One shadow ray (m, 6) to emitter k from the end of each of the rays `rows` (m,), and its factor there (m,)."""
    rays, triangle, t = ends
    facet, normal, origin, axes, size = surface.facet, surface.normal, surface.origin, surface.axes, surface.size
    start, shape, whole = shown.start, shown.shape, shown.open
    out = np.zeros((len(rows), 6), np.float32)
    factor = np.zeros(len(rows), np.float32)
    for j in prange(len(rows)):
        row = rows[j]
        f = facet[triangle[row]]
        s = side_met(rays, row, f, normal)
        if start[s] < 0:
            continue
        p = end(rays, t, row)
        here, du, dv, u, v = texel(p, f, s, origin, axes, size, start, shape)
        factor[j] = blend(whole, k, here, du, dv, u, v)
        if factor[j] > 0:  # the places on the lamp follow Roberts' sequence
            a, b = (0.5 + 0.7548776662466927 * row) % 1.0, (0.5 + 0.5698402909980532 * row) % 1.0
            aim(p, normal[f], 1.0 - 2.0 * (s & 1), a, b, lamp, out, j)
    return out, factor


@njit(parallel=True)
def cosine_rays(a, b, sequence, shift, places: Places, surface: SurfaceArrays):
    """n cosine-distributed rays from each of the places a..b-1; points and directions are one low-discrepancy set.

    sequence : (n, 4), shift : (K, 4) uint32
    """
    first, last, p, side = places
    axes, normal = surface.axes, surface.normal
    n = len(sequence)
    out = np.empty(((b - a) * n, 6), np.float32)
    for i in prange(a, b):
        f = side[i] >> 1
        nrm = normal[f] * (1.0 - 2.0 * (side[i] & 1))
        for k in range(n):
            place = scrambled(sequence[k, 0], shift[i, 0])
            q = first[i] + min(last[i] - first[i] - 1, int(place * (last[i] - first[i])))
            u, v = scrambled(sequence[k, 2], shift[i, 2]), scrambled(sequence[k, 3], shift[i, 3])
            row = (i - a) * n + k
            for d in range(3):
                out[row, d] = p[q, d] + OFFSET * nrm[d]
            cosine(u, v, nrm, axes[f, 0], axes[f, 1], out, row)
    return out


@njit(parallel=True)
def look(ends: RayEnds, n, surface: SurfaceArrays, shown: LightMapArrays, near, close):
    """What the n rays of each of K places meet.

    near : (K * n,) row of `close` (m, C) for rays whose end is lit by itself or outside of the model, else -1
    Returns the mean radiosity (K, C), half the difference of the rays' two halves (K, C), and the harmonic mean
    distance (K,).

    A ray that meets the inner side of a solid, or a side that no light reaches, began in the wrong place. It is
    dropped.
    """
    rays, triangle, t = ends
    facet, normal, inside = surface.facet, surface.normal, surface.inside
    origin, axes, size = surface.origin, surface.axes, surface.size
    start, shape, value, direct = shown.start, shown.shape, shown.value, shown.direct
    K, C = len(rays) // n, value.shape[1]
    total, half, distance = np.empty((K, C)), np.empty((K, C)), np.empty(K)
    for i in prange(K):
        valid = np.zeros(2)
        sums = np.zeros((2, C))
        hits, inverse = 0, 0.0
        for k in range(n):
            row = i * n + k
            part = 0 if 2 * k < n else 1
            if triangle[row] < 0:
                valid[part] += 1
                if near[row] >= 0:
                    for c in range(C):
                        sums[part, c] += close[near[row], c]
                continue
            f = facet[triangle[row]]
            s = side_met(rays, row, f, normal)
            if inside[s] or start[s] < 0:
                continue
            valid[part] += 1
            hits += 1
            inverse += 1 / max(t[row], OFFSET)
            here, du, dv, u, v = texel(end(rays, t, row), f, s, origin, axes, size, start, shape)
            for c in range(C):
                sums[part, c] += blend(value, c, here, du, dv, u, v)
            m = near[row]
            if m >= 0:
                for c in range(C):
                    sums[part, c] += (
                        close[m, c]
                        - (1 - u) * ((1 - v) * direct[here, c] + v * direct[here + dv, c])
                        - u * ((1 - v) * direct[here + du, c] + v * direct[here + du + dv, c])
                    )
        for c in range(C):
            total[i, c] = (sums[0, c] + sums[1, c]) / max(valid[0] + valid[1], 1.0)
            half[i, c] = 0.5 * (sums[0, c] / max(valid[0], 1.0) - sums[1, c] / max(valid[1], 1.0))
        distance[i] = hits / inverse if hits > 0 else np.inf
    return total, half, distance
