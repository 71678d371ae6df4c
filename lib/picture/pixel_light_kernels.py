"""Compiled: shadow rays of pixels, and where neighbours disagree."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.light.lamps_kernels import LampArrays, aim
from lib.light.sampling_kernels import scrambled
from lib.light.surface_kernels import SurfaceArrays
from lib.picture.pixels_kernels import PixelArrays, Viewer
from lib.picture.triangles_kernels import Triangles, holds


@njit(parallel=True)
def visible_share(weight, occluded):
    """(m,) share of the light of n shadow rays each that arrives.  weight : (m, n);  occluded : (m * n,) bool"""
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
    which,
    sequence,
    shift,
    pixels: PixelArrays,
    viewer: Viewer,
    triangles: Triangles,
    surface: SurfaceArrays,
    lamp: LampArrays,
):
    """Rays (m * n, 6) from all over each of the pixels `which` (m,) to a lamp, and the light that takes each (m, n).

    sequence : (n, 4), shift : (m, 4) uint32
    """
    px, py, side, centres = pixels.x, pixels.y, pixels.side, pixels.p
    eye, M = viewer
    corners, first = triangles
    origin, normal = surface.origin, surface.normal
    n = len(sequence)
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
            x = px[i] + scrambled(sequence[k, 2], shift[j, 2]) - 0.5
            y = py[i] + scrambled(sequence[k, 3], shift[j, 3]) - 0.5
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
            u, v = scrambled(sequence[k, 0], shift[j, 0]), scrambled(sequence[k, 1], shift[j, 1])
            weight[j, k] = aim(p, normal[f], sign, u, v, lamp, rays, j * n + k)
    return rays, weight


@njit(parallel=True)
def disagree(visible, lit, pixels: PixelArrays):
    """(M,) bool: the lamp is partly visible, or unlike at a pixel of the same facet within two.  visible, lit : (M,)"""
    x, y, facet, number = pixels.x, pixels.y, pixels.facet, pixels.number
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
def smoothed(visible, which, pixels: PixelArrays, sigma):
    """(m,) mean over the 3 x 3 pixels about each of `which`, of the same facet, weighted by how alike they are.

    visible : (M,);  sigma : of its sampling
    """
    x, y, facet, number = pixels.x, pixels.y, pixels.facet, pixels.number
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
