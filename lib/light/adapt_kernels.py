"""Compiled: the light of a patch's quadrants."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.light.form_factors_kernels import DROPPED
from lib.light.surface_kernels import SurfaceArrays


@njit(parallel=True)
def quadrants(rays, n, hit, light, side, middle, surface: SurfaceArrays):
    """Mean light that arrives at each quadrant of each patch, (N, 4), NaN where no ray starts, and its variance (N, 4).

    rays : (N * n, 6), n of each patch;  hit : (N * n,) the patch that each meets;  light : (N,) radiosity
    side : (N,);  middle : (N, 2) of the patches' cells, facet coordinates
    """
    origin, axes = surface.origin, surface.axes
    out, noise = np.full((len(side), 4), np.nan), np.full((len(side), 4), np.nan)
    for i in prange(len(side)):
        f = side[i] >> 1
        total, square, count = np.zeros(4), np.zeros(4), np.zeros(4)
        for k in range(i * n, (i + 1) * n):
            if hit[k] == DROPPED:
                continue
            u, v = 0.0, 0.0
            for d in range(3):
                x = rays[k, d] - origin[f, d]
                u += x * axes[f, 0, d]
                v += x * axes[f, 1, d]
            q = 2 * (u > middle[i, 0]) + (v > middle[i, 1])
            value = light[hit[k]] if hit[k] >= 0 else 0.0
            total[q] += value
            square[q] += value * value
            count[q] += 1
        for q in range(4):
            if count[q] > 0:
                out[i, q] = total[q] / count[q]
                noise[i, q] = max(square[q] / count[q] - out[i, q] ** 2, 0.0) / count[q]
    return out, noise
