"""Compiled: the next piece of a ray's way after a mirror or a glossy surface."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light import ward_kernels as kernels


@njit(inline="always")
def mixed(x):
    """A 64-bit number with its bits well mixed (splitmix64)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(inline="always")
def numbers(i, step, seed):
    """Two numbers in (0, 1) for the i-th ray: at its first specular surface the points of Roberts' sequence, which are spread
    evenly; further on independent of those, as they must be (the same points again would favour some ways over others)."""
    if step == 0:
        u = (0.5 + 0.7548776662466927 * i + 0.6180339887498949 * seed) % 1.0
        v = (0.5 + 0.5698402909980532 * i + 0.3247179572447461 * seed) % 1.0
    else:
        x = mixed(
            np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
            + np.uint64(step * 7919 + 1) * np.uint64(0xD1B54A32D192ED03)
            + np.uint64(int(seed * 1000))
        )
        u = float(x >> np.uint64(32)) / 4294967296.0
        v = float(x & np.uint64(0xFFFFFFFF)) / 4294967296.0
    return min(max(u, 1e-9), 1 - 1e-9), v


@njit(parallel=True)
def bounced(rays, t, at, facet, group, glossy, normal, inside, axes, alpha, form, source, step, seed):
    """The next pieces of the ways: rays (m, 6), weight (m,) 0 where a way ends, density (m,), where they begin (m, 3), and the
    side (m,): 1 front, -1 back, 0 where the ray came out of a solid."""
    m = len(at)
    out = np.zeros((m, 6), np.float32)
    weight, lobe = np.zeros(m), np.full(m, np.inf)
    p = np.empty((m, 3))
    sign = np.zeros(m)
    for j in prange(m):
        i, f = at[j], facet[j]
        along = 0.0
        for d in range(3):
            along += rays[i, 3 + d] * normal[f, d]
        side = 1.0 if along < 0 else -1.0
        for d in range(3):
            p[j, d] = rays[i, d] + t[i] * rays[i, 3 + d]
        if inside[2 * f + (1 if along > 0 else 0)]:
            continue
        sign[j] = side
        cosine = max(-along * side, 1e-9)
        dx, dy, dz = 0.0, 0.0, 0.0
        if glossy[j]:
            ox, oy = 0.0, 0.0
            for d in range(3):
                ox -= rays[i, 3 + d] * axes[f, 0, d]
                oy -= rays[i, 3 + d] * axes[f, 1, d]
            ax, ay = alpha[group[j], 0], alpha[group[j], 1]
            u, v = numbers(source[j], step, seed)
            ix, iy, iz = kernels.sample(ax, ay, ox, oy, cosine, u, v)
            if iz <= 1e-6:
                continue
            weight[j] = kernels.weight(form, ax, ay, ix, iy, iz, ox, oy, cosine)
            lobe[j] = kernels.pdf(ax, ay, ix, iy, iz, ox, oy, cosine)
            for d in range(3):
                out[j, 3 + d] = ix * axes[f, 0, d] + iy * axes[f, 1, d] + iz * side * normal[f, d]
        else:
            weight[j] = 1.0
            for d in range(3):
                out[j, 3 + d] = rays[i, 3 + d] - 2 * along * normal[f, d]
        for d in range(3):
            out[j, d] = p[j, d] + OFFSET * side * normal[f, d]
    return out, weight, lobe, p, sign
