"""Compiled: exact factors of polygons, and shadow rays to lamps."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light.sampling_kernels import scrambled


class LampArrays(NamedTuple):
    """What kernels need of an Emitter; see there."""

    corners: np.ndarray  # (K, 3, 3) local
    normal: np.ndarray  # (K, 3)
    cdf: np.ndarray  # (K,)


@njit()
def polygon_factor(p, n, corners, m, work):
    """Form factor from the element at p with normal n to a polygon, everything in front of it visible.

    Lambert's contour formula, the polygon first clipped at the element's horizon.
    corners : (>= m, 3), the first m are the polygon's;  work : (>= 2 m + 2, 3), room for the clipped polygon
    """
    k = 0
    for i in range(m):
        a = corners[i] - p
        b = corners[(i + 1) % m] - p
        da, db = np.dot(a, n), np.dot(b, n)
        if da >= 0:
            work[k] = a
            k += 1
        if (da > 0 and db < 0) or (da < 0 and db > 0):
            work[k] = a + (b - a) * (da / (da - db))
            k += 1
    total = 0.0
    for i in range(k):
        a = work[i]
        b = work[(i + 1) % k]
        c0 = a[1] * b[2] - a[2] * b[1]
        c1 = a[2] * b[0] - a[0] * b[2]
        c2 = a[0] * b[1] - a[1] * b[0]
        length = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
        if length > 0:
            total += np.arctan2(length, np.dot(a, b)) * (c0 * n[0] + c1 * n[1] + c2 * n[2]) / length
    return total / (2 * np.pi)


@njit(parallel=True)
def factors(p, normal_idx, normals, lamp: LampArrays):
    """(M,) sum over the lamp's triangles of the factor from each point, of those whose front faces it.

    p : (M, 3);  normals : (K, 3);  normal_idx : (M,)
    """
    corners, front = lamp.corners, lamp.normal
    out = np.zeros(len(p))
    for i in prange(len(p)):
        work = np.empty((8, 3))
        n = normals[normal_idx[i]]
        for t in range(len(corners)):
            if np.dot(p[i] - corners[t, 0], front[t]) > 1e-12:
                out[i] += abs(polygon_factor(p[i], n, corners[t], 3, work))
    return out


# ---- shadow rays ----


@njit(inline="always")
def on_lamp(u, v, cdf):
    """A triangle of a lamp and the weights of its corners, of a place uniform over the lamp for uniform (u, v)."""
    t = 0
    while t < len(cdf) - 1 and cdf[t] <= u:
        t += 1
    low = cdf[t - 1] if t > 0 else 0.0
    r = np.sqrt(min(max((u - low) / (cdf[t] - low), 0.0), 1.0))
    return t, 1 - r, r * (1 - v), r * v


@njit(inline="always")
def aim(p, normal, sign, u, v, lamp: LampArrays, rays, row):
    """Write the shadow ray from p (3,) to the place (u, v) of a lamp; returns the light that takes it, up to a factor.

    normal : (3,) of the facet, times sign (1 or -1) that of the side;  rays : (n, 6), origin and vector
    """
    corners, front = lamp.corners, lamp.normal
    t, w0, w1, w2 = on_lamp(u, v, lamp.cdf)
    squared, here, there = 0.0, 0.0, 0.0
    for d in range(3):
        target = w0 * corners[t, 0, d] + w1 * corners[t, 1, d] + w2 * corners[t, 2, d]
        start = p[d] + OFFSET * sign * normal[d]
        x = target + OFFSET * front[t, d] - start
        rays[row, d] = start
        rays[row, 3 + d] = x
        squared += x * x
        here += x * sign * normal[d]
        there -= x * front[t, d]
    return max(here, 0.0) * max(there, 0.0) / max(squared * squared, 1e-30)


@njit(parallel=True)
def shadow_rays(p, normal_idx, normals, which, points, shift, lamp: LampArrays):
    """Rays (m * n, 6) from the points p[which] to a lamp, n each, and the light that takes each way, up to a factor.

    points : (n, 4), shift : (m, 4) uint32
    """
    n = len(points)
    rays = np.empty((len(which) * n, 6), np.float32)
    weight = np.empty(len(which) * n, np.float32)
    for j in prange(len(which)):
        i = which[j]
        for k in range(n):
            u, v = scrambled(points[k, 0], shift[j, 0]), scrambled(points[k, 1], shift[j, 1])
            row = j * n + k
            weight[row] = aim(p[i], normals[normal_idx[i]], 1.0, u, v, lamp, rays, row)
    return rays, weight
