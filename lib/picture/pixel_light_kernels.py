"""Compiled: shadow rays of pixels, and where neighbours disagree."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.picture.texels_kernels import holds


@njit(parallel=True)
def visible_share(weight, occluded):
    m, n = weight.shape
    out = np.zeros(m)
    for i in prange(m):
        total, seen = 0.0, 0.0
        for k in range(n):
            total += weight[i, k]
            if not occluded[i * n + k]:
                seen += weight[i, k]
        out[i] = seen / total if total > 0 else 0.0
    return out


@njit(parallel=True)
def shadow_rays(
    which, n, sequence, shift, px, py, side, centres, eye, M, corners, first, origin, normal, lamp, front, cdf
):
    rays = np.empty((len(which) * n, 6), np.float32)
    weight = np.empty((len(which), n), np.float32)
    for j in prange(len(which)):
        i = which[j]
        f = side[i] >> 1
        sign = 1.0 - 2.0 * (side[i] & 1)
        height = 0.0
        for d in range(3):
            height += (origin[f, d] - eye[d]) * normal[f, d]
        p = np.empty(3)
        for k in range(n):
            x = px[i] + ((sequence[k, 2] ^ shift[j, 2]) + 0.5) / 4294967296.0 - 0.5
            y = py[i] + ((sequence[k, 3] ^ shift[j, 3]) + 0.5) / 4294967296.0 - 0.5
            along = 0.0
            for d in range(3):
                p[d] = M[d, 0] * x + M[d, 1] * y + M[d, 2]
                along += p[d] * normal[f, d]
            scale = height / along if abs(along) > 1e-12 else -1.0
            for d in range(3):
                p[d] = eye[d] + scale * p[d]
            if scale <= 0 or not holds(p, corners, first[f], first[f + 1], normal[f]):
                for d in range(3):  # off the facet: its centre, which is on it
                    p[d] = centres[i, d]
            u = ((sequence[k, 0] ^ shift[j, 0]) + 0.5) / 4294967296.0
            v = ((sequence[k, 1] ^ shift[j, 1]) + 0.5) / 4294967296.0
            weight[j, k] = aim(p, normal[f], sign, u, v, lamp, front, cdf, rays, j * n + k)
    return rays, weight


@njit(parallel=True)
def disagree(visible, lit, number, facet, x, y):
    """(M,) bool: partly visible, or unlike a pixel of the same facet within two."""
    H, W = number.shape
    out = np.zeros(len(visible), np.bool_)
    for i in prange(len(visible)):
        if not lit[i]:
            continue
        v = visible[i]
        uneven = v > 1e-3 and v < 1 - 1e-3
        for b in range(max(y[i] - 2, 0), min(y[i] + 2, H - 1) + 1):
            for a in range(max(x[i] - 2, 0), min(x[i] + 2, W - 1) + 1):
                j = number[b, a]
                if j >= 0 and facet[j] == facet[i] and lit[j] and abs(visible[j] - v) > 1e-3:
                    uneven = True
        out[i] = uneven
    return out


@njit(parallel=True)
def smoothed(visible, which, number, facet, x, y, sigma):
    """Mean of the 3 x 3 pixels of the same facet that differ by no more than the sampling does."""
    H, W = number.shape
    out = np.empty(len(which))
    for k in prange(len(which)):
        i = which[k]
        total, weight = visible[i], 1.0
        for b in range(max(y[i] - 1, 0), min(y[i] + 1, H - 1) + 1):
            for a in range(max(x[i] - 1, 0), min(x[i] + 1, W - 1) + 1):
                j = number[b, a]
                if j < 0 or j == i or facet[j] != facet[i]:
                    continue
                w = np.exp(-0.5 * ((visible[j] - visible[i]) / (2 * sigma)) ** 2)
                total += w * visible[j]
                weight += w
        out[k] = total / weight
    return out


@njit(inline="always")
def aim(p, normal, sign, u, v, lamp, front, cdf, rays, row):
    """Write the shadow ray from p to the point (u, v) of a lamp; returns the light that takes this way, up to a factor."""
    t = 0
    while t < len(cdf) - 1 and cdf[t] <= u:
        t += 1
    low = cdf[t - 1] if t > 0 else 0.0
    r = np.sqrt(min(max((u - low) / (cdf[t] - low), 0.0), 1.0))
    squared, here, there = 0.0, 0.0, 0.0
    for d in range(3):
        target = (1 - r) * lamp[t, 0, d] + r * (1 - v) * lamp[t, 1, d] + r * v * lamp[t, 2, d]
        start = p[d] + OFFSET * sign * normal[d]
        x = target + OFFSET * front[t, d] - start
        rays[row, d] = start
        rays[row, 3 + d] = x
        squared += x * x
        here += x * sign * normal[d]
        there -= x * front[t, d]
    return max(here, 0.0) * max(there, 0.0) / max(squared * squared, 1e-30)
