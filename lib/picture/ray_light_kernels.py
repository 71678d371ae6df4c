"""Compiled: rays from pixels, and what they see of the light map."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.picture.light_map_kernels import texel
from lib.picture.pixel_light_kernels import aim


@njit(parallel=True)
def reflected_at(rays, triangle, t, facet, normal, origin, axes, size, inside, start, shape, value):
    C = value.shape[1]
    out = np.zeros((len(rays), C))
    for i in prange(len(rays)):
        if triangle[i] < 0:
            continue
        f = facet[triangle[i]]
        along = rays[i, 3] * normal[f, 0] + rays[i, 4] * normal[f, 1] + rays[i, 5] * normal[f, 2]
        s = 2 * f + (1 if along > 0 else 0)
        if inside[s] or start[s] < 0:
            continue
        p = np.empty(3)
        for d in range(3):
            p[d] = rays[i, d] + t[i] * rays[i, 3 + d]
        here, du, dv, u, v = texel(p, f, s, origin, axes, size, start, shape)
        for c in range(C):
            out[i, c] = (1 - u) * ((1 - v) * value[here, c] + v * value[here + dv, c]) + u * (
                (1 - v) * value[here + du, c] + v * value[here + du + dv, c]
            )
    return out


@njit(parallel=True)
def close_rays(rows, rays, triangle, t, k, facet, normal, origin, axes, size, start, shape, whole, lamp, front, cdf):
    out = np.zeros((len(rows), 6), np.float32)
    factor = np.zeros(len(rows), np.float32)
    for j in prange(len(rows)):
        row = rows[j]
        f = facet[triangle[row]]
        along = rays[row, 3] * normal[f, 0] + rays[row, 4] * normal[f, 1] + rays[row, 5] * normal[f, 2]
        s = 2 * f + (1 if along > 0 else 0)
        if start[s] < 0:
            continue
        p = np.empty(3)
        for d in range(3):
            p[d] = rays[row, d] + t[row] * rays[row, 3 + d]
        here, du, dv, u, v = texel(p, f, s, origin, axes, size, start, shape)
        factor[j] = (1 - u) * ((1 - v) * whole[here, k] + v * whole[here + dv, k]) + u * (
            (1 - v) * whole[here + du, k] + v * whole[here + du + dv, k]
        )
        if factor[j] > 0:  # the places on the lamp follow Roberts' sequence
            aim(
                p,
                normal[f],
                1.0 - 2.0 * (s & 1),
                (0.5 + 0.7548776662466927 * row) % 1.0,
                (0.5 + 0.5698402909980532 * row) % 1.0,
                lamp,
                front,
                cdf,
                out,
                j,
            )
    return out, factor


@njit(parallel=True)
def cosine_rays(a, b, n, sequence, shift, first, last, p, side, axes, normal):
    """Cosine-distributed rays from the pixels of leaves a to b; points and directions are one low-discrepancy set."""
    out = np.empty(((b - a) * n, 6), np.float32)
    for i in prange(a, b):
        f = side[i] >> 1
        sign = 1.0 - 2.0 * (side[i] & 1)
        for k in range(n):
            place = ((sequence[k, 0] ^ shift[i, 0]) + 0.5) / 4294967296.0
            q = first[i] + min(last[i] - first[i] - 1, int(place * (last[i] - first[i])))
            u = ((sequence[k, 2] ^ shift[i, 2]) + 0.5) / 4294967296.0
            phi = 2 * np.pi * ((sequence[k, 3] ^ shift[i, 3]) + 0.5) / 4294967296.0
            r = np.sqrt(u)
            x, y, z = r * np.cos(phi), r * np.sin(phi), np.sqrt(max(0.0, 1 - u)) * sign
            row = (i - a) * n + k
            for d in range(3):
                out[row, d] = p[q, d] + OFFSET * sign * normal[f, d]
                out[row, 3 + d] = x * axes[f, 0, d] + y * axes[f, 1, d] + z * normal[f, d]
    return out


@njit(parallel=True)
def look(
    rays,
    triangle,
    t,
    n,
    facet,
    normal,
    origin,
    axes,
    size,
    inside,
    start,
    shape,
    value,
    direct,
    near,
    close,
    total,
    half,
    distance,
):
    """Mean radiosity that the rays of each leaf meet, half the difference of its two halves, harmonic mean distance.

    A ray that meets the inner side of a solid, or a side that no light reaches, began in the wrong place and is dropped.
    """
    C = value.shape[1]
    for i in prange(len(total)):
        valid = np.zeros(2)
        sums = np.zeros((2, C))
        hits, inverse = 0, 0.0
        for k in range(n):
            row = i * n + k
            part = 0 if 2 * k < n else 1
            if triangle[row] < 0:
                valid[part] += 1
                continue
            f = facet[triangle[row]]
            along = rays[row, 3] * normal[f, 0] + rays[row, 4] * normal[f, 1] + rays[row, 5] * normal[f, 2]
            s = 2 * f + (1 if along > 0 else 0)
            if inside[s] or start[s] < 0:
                continue
            valid[part] += 1
            hits += 1
            inverse += 1 / max(t[row], OFFSET)
            p = np.empty(3)
            for d in range(3):
                p[d] = rays[row, d] + t[row] * rays[row, 3 + d]
            here, du, dv, u, v = texel(p, f, s, origin, axes, size, start, shape)
            for c in range(C):
                sums[part, c] += (1 - u) * ((1 - v) * value[here, c] + v * value[here + dv, c]) + u * (
                    (1 - v) * value[here + du, c] + v * value[here + du + dv, c]
                )
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
