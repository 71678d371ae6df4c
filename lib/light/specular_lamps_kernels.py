"""Compiled: rays from glossy surfaces to lamps."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light import ward_kernels as ward
from lib.light.glints_kernels import GlintArrays, often
from lib.light.lamps_kernels import LampArrays, on_lamp, thrown
from lib.light.paths_kernels import Lobes, numbers
from lib.light.surface_kernels import SurfaceArrays


class GlossyArrays(NamedTuple):
    """Places on glossy surfaces (n,), and the rays that met them."""

    p: np.ndarray  # (n, 3) local
    facet: np.ndarray
    sign: np.ndarray  # 1 front, -1 back
    group: np.ndarray  # number of the specular group
    rays: np.ndarray  # (n, 6) float32
    source: np.ndarray  # the ray that began the way


@njit(parallel=True)
def to_lamp(
    places: GlossyArrays,
    lobes: Lobes,
    surface: SurfaceArrays,
    lamp: LampArrays,
    area,
    step,
    seed,
    glints: GlintArrays,
):
    """One ray from each place to the lamp, (n, 6) origin and vector, and what it brings into the lobe, (n,).

    What it brings is for E = 1 and rho_s = 1; whether something stands on the way is not asked.

    The value is that of the balance heuristic, whose other half are the rays of the lobe that find the lamp, and where
    glints.ways is not 0 the ways of lib/light/glints.py.
    """
    p, facet, sign, view = places.p, places.facet, places.sign, places.rays
    normal, axes, corners, front = surface.normal, lobes.axes, lamp.corners, lamp.normal
    n = len(p)
    rays = np.zeros((n, 6), np.float32)
    value = np.zeros(n)
    for j in prange(n):
        f = facet[j]
        u, v = numbers(places.source[j], step, seed)
        k, w0, w1, w2 = on_lamp(u, v, lamp.cdf)
        squared, ix, iy, iz, there, ox, oy, oz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for d in range(3):
            target = w0 * corners[k, 0, d] + w1 * corners[k, 1, d] + w2 * corners[k, 2, d]
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
        ax, ay = lobes.alpha[places.group[j], 0], lobes.alpha[places.group[j], 1]
        density = squared / (there * area)
        reflected = ward.value(lobes.form, ax, ay, ix, iy, iz, ox, oy, oz)
        reflected *= thrown(lamp.lobe, -rays[j, 3], -rays[j, 4], -rays[j, 5])
        if glints.ways[f] > 0:
            x_there, p_first = np.empty(3), np.empty(3)
            for d in range(3):
                x_there[d], p_first[d] = rays[j, d] + rays[j, 3 + d], view[j, d]
            n_first, ratio = glints.normal[places.source[j]], glints.ways[f] / glints.shot[places.source[j]]
            density *= 1 + often(p_first, n_first, p[j], x_there, f, ax, ay, ratio, surface, axes)
        value[j] = reflected * iz / (density + ward.pdf(ax, ay, ix, iy, iz, ox, oy, oz))
    return rays, value
