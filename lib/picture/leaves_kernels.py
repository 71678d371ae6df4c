"""Compiled: local linear fits over neighbouring leaves."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.picture.light_map_kernels import linear
from lib.picture.pixels_kernels import PixelArrays


class LeafArrays(NamedTuple):
    """What kernels need of Leaves; see there."""

    first: np.ndarray  # (K,)
    last: np.ndarray  # (K,)
    level: np.ndarray  # (K,)
    q: np.ndarray  # (K, 2) px


@njit(parallel=True)
def local_fits(q, value, near, distance):
    """Local linear fits of value (K, C) at places q (K, 2): see `neighbourhoods`.

    near, distance : (K, k) the nearest of the places, those of other facets more than 5e5 away
    """
    m, k = near.shape
    C = value.shape[1]
    fits = np.zeros((m, 3, C))
    foretold = np.zeros((m, C))
    for i in prange(m):
        n = 0
        while n < k and distance[i, n] < 5e5:
            n += 1
        radius = max(1.05 * distance[i, n - 1], 1e-9) if n > 1 else 1.0
        for own in range(2):
            s0, su, sv, suu, suv, svv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            t = np.zeros((3, C))
            for j in range(n):
                g = near[i, j]
                if g == i and own == 0:
                    continue
                w = 1 - (distance[i, j] / radius) ** 2
                w *= w
                u, v = (q[g, 0] - q[i, 0]) / radius, (q[g, 1] - q[i, 1]) / radius
                s0 += w
                su += w * u
                sv += w * v
                suu += w * u * u
                suv += w * u * v
                svv += w * v * v
                for c in range(C):
                    t[0, c] += w * value[g, c]
                    t[1, c] += w * u * value[g, c]
                    t[2, c] += w * v * value[g, c]
            if s0 <= 0:  # alone on its facet
                for c in range(C):
                    foretold[i, c] = value[i, c]
                continue
            linear(s0, su, sv, suu, suv, svv, t, 0.01)
            for c in range(C):
                if own == 0:
                    foretold[i, c] = t[0, c]
                else:
                    fits[i, 0, c] = t[0, c]
                    fits[i, 1, c] = t[1, c] / radius
                    fits[i, 2, c] = t[2, c] / radius
    return fits, foretold


@njit()
def splat(leaves: LeafArrays, fits, pixels: PixelArrays):
    """(M, C) the local fits (K, 3, C) of the leaves around each pixel, blended smoothly, never across facets."""
    first, last, level, q = leaves
    facet, number = pixels.facet, pixels.number
    H, W = number.shape
    m, _, C = fits.shape
    total = np.zeros((len(facet), C))
    weight = np.zeros(len(facet))
    for i in range(m):
        radius = 1.5 * (1 << level[i])
        x0, x1 = max(int(np.ceil(q[i, 0] - radius)), 0), min(int(q[i, 0] + radius), W - 1)
        y0, y1 = max(int(np.ceil(q[i, 1] - radius)), 0), min(int(q[i, 1] + radius), H - 1)
        for b in range(y0, y1 + 1):
            for a in range(x0, x1 + 1):
                j = number[b, a]
                if j < 0 or facet[j] != facet[first[i]]:
                    continue
                du, dv = a - q[i, 0], b - q[i, 1]
                w = 1 - (du * du + dv * dv) / (radius * radius)
                if w <= 0:
                    continue
                w *= w / (radius * radius)  # the finer leaf knows better
                weight[j] += w
                for c in range(C):
                    total[j, c] += w * (fits[i, 0, c] + fits[i, 1, c] * du + fits[i, 2, c] * dv)
    for j in range(len(facet)):
        if weight[j] > 0:
            for c in range(C):
                total[j, c] /= weight[j]
    for i in range(m):
        for j in range(first[i], last[i]):
            if weight[j] <= 0:
                total[j] = fits[i, 0]
    return total
