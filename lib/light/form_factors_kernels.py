"""Compiled: rays from patches and points, where they arrive, and how often."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light.cells_kernels import in_patch

ESCAPED, DROPPED, LOST = -1, -2, -3


# -- ray generation


@njit(inline="always")
def cosine(u, v, n, x, y, out, k):
    r = np.sqrt(u)
    phi = 2 * np.pi * v
    a, b, c = r * np.cos(phi), r * np.sin(phi), np.sqrt(max(0.0, 1 - u))
    for d in range(3):
        out[k, 3 + d] = a * x[d] + b * y[d] + c * n[d]


@njit(parallel=True)
def patch_rays(first, last, n, points, shift, side, tri_start, tri_uv, tri_cdf, origin, axes, normal):
    out = np.empty(((last - first) * n, 6), np.float32)
    for i in prange(first, last):
        f = side[i] >> 1
        sign = 1.0 - 2.0 * (side[i] & 1)
        nrm = normal[f] * sign
        h0, h1, h2, h3 = shift[i]
        for k in range(n):
            u, v = in_patch(
                i,
                ((points[k, 0] ^ h0) + 0.5) / 4294967296.0,
                ((points[k, 1] ^ h1) + 0.5) / 4294967296.0,
                tri_start,
                tri_uv,
                tri_cdf,
            )
            row = (i - first) * n + k
            for d in range(3):
                out[row, d] = origin[f, d] + u * axes[f, 0, d] + v * axes[f, 1, d] + OFFSET * nrm[d]
            cosine(
                ((points[k, 2] ^ h2) + 0.5) / 4294967296.0,
                ((points[k, 3] ^ h3) + 0.5) / 4294967296.0,
                nrm,
                axes[f, 0],
                axes[f, 1],
                out,
                row,
            )
    return out


@njit(parallel=True)
def point_rays(ray_start, first, last, points, shift, other, point_start, p, side, axes, normal):
    """Rays of the elements first..last; element i owns the points p[point_start[i]:point_start[i + 1]] (M, 3)."""
    base = ray_start[first]
    out = np.empty((ray_start[last] - base, 6), np.float32)
    for i in prange(first, last):
        f = side[i] >> 1
        nrm = normal[f] * (1.0 - 2.0 * (side[i] & 1))
        m = point_start[i + 1] - point_start[i]
        n = ray_start[i + 1] - ray_start[i]
        for j in range(n):
            # the halves are scrambled independently: their errors are, too (reflectance.py corrects with them)
            k = j if j < (n + 1) // 2 else j - (n + 1) // 2
            h0, _, h2, h3 = shift[i] if j < (n + 1) // 2 else other[i]
            q = point_start[i] + min(m - 1, int(((points[k, 0] ^ h0) + 0.5) / 4294967296.0 * m))
            row = ray_start[i] - base + j
            for d in range(3):
                out[row, d] = p[q, d] + OFFSET * nrm[d]
            cosine(
                ((points[k, 2] ^ h2) + 0.5) / 4294967296.0,
                ((points[k, 3] ^ h3) + 0.5) / 4294967296.0,
                nrm,
                axes[f, 0],
                axes[f, 1],
                out,
                row,
            )
    return out


# -- binning


@njit(parallel=True)
def locate(rays, triangle, distance, facet, normal, origin, axes, size, inside, table_start, table_shape, leaf):
    """The patch each ray arrives at, (n,) int32, or ESCAPED, DROPPED, LOST."""
    n = len(rays)
    out = np.empty(n, np.int32)
    for k in prange(n):
        if triangle[k] < 0:
            out[k] = ESCAPED
            continue
        f = facet[triangle[k]]
        along = rays[k, 3] * normal[f, 0] + rays[k, 4] * normal[f, 1] + rays[k, 5] * normal[f, 2]
        s = 2 * f + (1 if along > 0 else 0)
        if inside[s]:
            out[k] = DROPPED
            continue
        if table_start[s] < 0:  # a side that sees nothing: the ray starts in the crack of a contact
            out[k] = DROPPED
            continue
        u = 0.0
        v = 0.0
        for d in range(3):
            x = rays[k, d] + distance[k] * rays[k, 3 + d] - origin[f, d]
            u += x * axes[f, 0, d]
            v += x * axes[f, 1, d]
        nu, nv = table_shape[s, 0], table_shape[s, 1]
        a = min(max(int(u / size[f, 0] * nu), 0), nu - 1)
        b = min(max(int(v / size[f, 1] * nv), 0), nv - 1)
        patch = leaf[table_start[s] + a * nv + b]
        if patch < 0:  # beyond a slanted border by rounding: the next cell inside
            for da in range(-1, 2):
                for db in range(-1, 2):
                    if patch < 0 and 0 <= a + da < nu and 0 <= b + db < nv:
                        patch = leaf[table_start[s] + (a + da) * nv + b + db]
        out[k] = patch if patch >= 0 else LOST
    return out


@njit(parallel=True)
def compress(hit, ray_start, first, last):
    """Count equal hits per element: entries per row, valid, valid in the first half, lost; hit is sorted in place by (patch, half)."""
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
