"""Compiled: exact factors of polygons, and shadow rays to lamps."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light.cells_kernels import in_patch


@njit()
def polygon_factor(p, n, corners, m, work):
    """Form factor from the element at p with normal n to a polygon, everything in front of it visible.

    Lambert's contour formula, the polygon first clipped at the element's horizon. corners : (>= m, 3)
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
def factors(p, normal_idx, normals, corners, front):
    """Sum over triangles of the factor from each point, of those whose front faces it."""
    out = np.zeros(len(p))
    for i in prange(len(p)):
        work = np.empty((8, 3))
        n = normals[normal_idx[i]]
        for t in range(len(corners)):
            if np.dot(p[i] - corners[t, 0], front[t]) > 1e-12:
                out[i] += abs(polygon_factor(p[i], n, corners[t], 3, work))
    return out


@njit(parallel=True)
def shadow_rays(p, normal_idx, normals, which, n, points, shift, corners, front, cdf):
    rays = np.empty((len(which) * n, 6), np.float32)
    weight = np.empty(len(which) * n, np.float32)
    for j in prange(len(which)):
        i = which[j]
        nrm = normals[normal_idx[i]]
        h0, h1 = shift[j, 0], shift[j, 1]
        for k in range(n):
            u = ((points[k, 0] ^ h0) + 0.5) / 4294967296.0
            v = ((points[k, 1] ^ h1) + 0.5) / 4294967296.0
            t = 0
            while t < len(cdf) - 1 and cdf[t] <= u:
                t += 1
            low = cdf[t - 1] if t > 0 else 0.0
            r = np.sqrt(min(max((u - low) / (cdf[t] - low), 0.0), 1.0))
            row = j * n + k
            squared, cos_here, cos_there = 0.0, 0.0, 0.0
            for d in range(3):
                target = (1 - r) * corners[t, 0, d] + r * (1 - v) * corners[t, 1, d] + r * v * corners[t, 2, d]
                start = p[i, d] + OFFSET * nrm[d]
                x = target + OFFSET * front[t, d] - start
                rays[row, d] = start
                rays[row, 3 + d] = x
                squared += x * x
                cos_here += x * nrm[d]
                cos_there -= x * front[t, d]
            weight[row] = max(cos_here, 0.0) * max(cos_there, 0.0) / max(squared * squared, 1e-30)
    return rays, weight


@njit(parallel=True)
def patch_points(n, points, shift, side, tri_start, tri_uv, tri_cdf, origin, axes):
    out = np.empty((len(side) * n, 3))
    for i in prange(len(side)):
        f = side[i] >> 1
        h0, h1 = shift[i, 0], shift[i, 1]
        for k in range(n):
            u, v = in_patch(
                i,
                ((points[k, 0] ^ h0) + 0.5) / 4294967296.0,
                ((points[k, 1] ^ h1) + 0.5) / 4294967296.0,
                tri_start,
                tri_uv,
                tri_cdf,
            )
            for d in range(3):
                out[i * n + k, d] = origin[f, d] + u * axes[f, 0, d] + v * axes[f, 1, d]
    return out
