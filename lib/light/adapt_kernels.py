"""Compiled: the light of a patch's quadrants."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.light.form_factors_kernels import DROPPED


@njit(parallel=True)
def quadrants(rays, n, hit, light, side, middle, origin, axes, out, noise):
    """Mean light arriving at each quadrant of each patch from its rays, (N, 4) NaN where no ray starts, and the
    variance of that mean. middle : (N, 2) of the cell, facet coordinates; light : (N,) radiosity."""
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
