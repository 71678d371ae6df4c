"""Compiled: the next piece of a ray's way after a mirror or a glossy surface."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light import ward_kernels as ward
from lib.light.surface_kernels import SurfaceArrays


@njit(inline="always")
def mixed(x):
    """A 64-bit number with its bits well mixed (splitmix64)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(inline="always")
def numbers(i, step, seed):
    """Two numbers in (0, 1) for the i-th ray at its specular surface number `step`.

    At the first, the points of Roberts' sequence, which are spread evenly. Further on they are independent of those:
    the same points again would favour some ways over others.
    """
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


class Bounces(NamedTuple):
    """Rays that end on specular facets (m,), among all rays (n,)."""

    rays: np.ndarray  # (n, 6) float32
    t: np.ndarray  # (n,) float32
    at: np.ndarray  # (m,) which of the rays
    facet: np.ndarray  # (m,)
    group: np.ndarray  # (m,) number of the specular group
    glossy: np.ndarray  # (m,) bool
    source: np.ndarray  # (m,) the ray that began the way


class Lobes(NamedTuple):
    """The shapes of Ward lobes."""

    axes: np.ndarray  # (F, 2, 3) tangent frame of each facet
    alpha: np.ndarray  # (M, 2) of each specular group
    form: int


@njit(parallel=True)
def bounced(bounces: Bounces, lobes: Lobes, surface: SurfaceArrays, step, seed):
    """The next pieces of the ways.

    Returns rays (m, 6), weight (m,), 0 where a way ends, density of the lobe (m,), inf at mirrors, where the rays begin
    (m, 3), and the side (m,): 1 front, -1 back, 0 where the ray came out of a solid.
    """
    rays, t, at = bounces.rays, bounces.t, bounces.at
    normal, inside, axes = surface.normal, surface.inside, lobes.axes
    m = len(at)
    out = np.zeros((m, 6), np.float32)
    weight, density = np.zeros(m), np.full(m, np.inf)
    p = np.empty((m, 3))
    sign = np.zeros(m)
    for j in prange(m):
        i, f = at[j], bounces.facet[j]
        along = 0.0
        for d in range(3):
            along += rays[i, 3 + d] * normal[f, d]
        side = 1.0 if along < 0 else -1.0
        for d in range(3):
            p[j, d] = rays[i, d] + t[i] * rays[i, 3 + d]
        if inside[2 * f + (1 if along > 0 else 0)]:
            continue
        sign[j] = side
        if bounces.glossy[j]:
            u, v = numbers(bounces.source[j], step, seed)
            cosine = max(-along * side, 1e-9)
            ax, ay = lobes.alpha[bounces.group[j], 0], lobes.alpha[bounces.group[j], 1]
            ox, oy = 0.0, 0.0
            for d in range(3):
                ox -= rays[i, 3 + d] * axes[f, 0, d]
                oy -= rays[i, 3 + d] * axes[f, 1, d]
            ix, iy, iz = ward.sample(ax, ay, ox, oy, cosine, u, v)
            if iz <= 1e-6:
                continue
            weight[j] = ward.weight(lobes.form, ax, ay, ix, iy, iz, ox, oy, cosine)
            density[j] = ward.pdf(ax, ay, ix, iy, iz, ox, oy, cosine)
            for d in range(3):
                out[j, 3 + d] = ix * axes[f, 0, d] + iy * axes[f, 1, d] + iz * side * normal[f, d]
        else:
            weight[j] = 1.0
            for d in range(3):
                out[j, 3 + d] = rays[i, 3 + d] - 2 * along * normal[f, d]
        for d in range(3):
            out[j, d] = p[j, d] + OFFSET * side * normal[f, d]
    return out, weight, density, p, sign
