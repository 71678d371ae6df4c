"""Compiled: rays from glossy surfaces to lamps."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light import ward_kernels as kernels
from lib.light.paths_kernels import numbers


@njit(parallel=True)
def to_lamp(p, facet, sign, view, source, group, normal, axes, alpha, form, corners, front, cdf, area, step, seed):
    n = len(p)
    rays = np.zeros((n, 6), np.float32)
    value = np.zeros(n)
    for j in prange(n):
        f = facet[j]
        u, v = numbers(source[j], step, seed)
        k = 0
        while k < len(cdf) - 1 and cdf[k] <= u:
            k += 1
        low = cdf[k - 1] if k > 0 else 0.0
        r = np.sqrt(min(max((u - low) / (cdf[k] - low), 0.0), 1.0))
        squared, ix, iy, iz, there, ox, oy, oz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for d in range(3):
            target = (1 - r) * corners[k, 0, d] + r * (1 - v) * corners[k, 1, d] + r * v * corners[k, 2, d]
            begin = p[j, d] + OFFSET * sign[j] * normal[f, d]
            x = target + OFFSET * front[k, d] - begin
            rays[j, d] = begin
            rays[j, 3 + d] = x
            squared += x * x
            ix += x * axes[f, 0, d]
            iy += x * axes[f, 1, d]
            iz += x * sign[j] * normal[f, d]
            there -= x * front[k, d]
            ox -= view[j, 3 + d] * axes[f, 0, d]
            oy -= view[j, 3 + d] * axes[f, 1, d]
            oz -= view[j, 3 + d] * sign[j] * normal[f, d]
        if iz <= 0 or there <= 0 or oz <= 0:
            continue
        length = np.sqrt(squared)
        ix, iy, iz, there = ix / length, iy / length, iz / length, there / length
        ax, ay = alpha[group[j], 0], alpha[group[j], 1]
        density = squared / (there * area)
        value[j] = (
            kernels.value(form, ax, ay, ix, iy, iz, ox, oy, oz)
            * iz
            / (density + kernels.pdf(ax, ay, ix, iy, iz, ox, oy, oz))
        )
    return rays, value
