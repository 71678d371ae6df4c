"""The light that rays bring back, from the light map; what they meet nearby is lit by itself."""

from __future__ import annotations

import numpy as np

from lib.given.rays import shifts, sobol
from lib.light import glints, paths, specular_lamps
from lib.light import lamps as lamps_
from lib.light.form_factors import CHUNK
from lib.light.surface import Surface
from lib.picture import ray_light_kernels as kernels
from lib.picture.light_map import LightMap
from lib.picture.ray_light_kernels import Places, RayEnds

NEAR = 3.0  # texels: what a gathering ray meets within so many is lit by itself


def gathered_light(surface, shown, lamps, E, p, first, last, side, n_rays, seed, numbers=None):
    """What n_rays rays from each of K places meet.

    p : (M, 3) local;  first, last : (K,) the points p[first:last] of each place;  side : (K,)
    lamps, E : Emitters and their emittances (L, C)
    numbers : (K,) of the places, whose rays are then the same whatever places there are beside them
    Returns the mean radiosity (K, C), half the difference of the rays' two halves (K, C), and the harmonic mean
    distance (K,).
    """
    m, C = len(first), shown.value.shape[1]
    sequence, shift = sobol(n_rays), shifts(m if numbers is None else numbers, n_rays, seed)
    total, half, distance = np.zeros((m, C)), np.zeros((m, C)), np.zeros(m)
    step = max(1, CHUNK // n_rays)
    places, arrays = Places(first, last, p, side), surface.arrays
    for a in range(0, m, step):
        b = min(m, a + step)
        rays = kernels.cosine_rays(a, b, sequence, shift, places, arrays)
        triangle, t = surface.caster.closest(rays)
        near, close = _with_glow(shown, rays, triangle, *lit_nearby(surface, shown, lamps, E, rays, triangle, t))
        total[a:b], half[a:b], distance[a:b] = kernels.look(
            RayEnds(rays, triangle, t), n_rays, arrays, shown.arrays, near, close
        )
        if shown.ways is not None:
            some = first[a:b], last[a:b], p
            blocks = np.arange(a, b) if numbers is None else numbers[a:b]
            by_ways = _by_ways(surface, shown, RayEnds(rays, triangle, t), some, side[a:b], n_rays, blocks, seed)
            total[a:b] += by_ways[0]
            half[a:b] += by_ways[1]
    return total, half, distance


def _with_glow(shown, rays, triangle, near, close):
    """near, close of `lit_nearby`, and what rays find that leave the model."""
    if shown.glow is None:
        return near, close
    gone = np.flatnonzero(triangle < 0)
    near[gone] = len(close) + np.arange(len(gone))
    return near, np.vstack([close, shown.glow.light(rays[gone]).astype(np.float32)])


def _by_ways(surface, shown, ends: RayEnds, places, side, n_rays, blocks, seed):
    """What K places receive from their rays after mirrors and glossy surfaces, and half the difference of the rays' two
    halves, both (K, C).

    places : first, last (K,), p (M, 3);  side : (K,);  blocks : (K,) numbers that their random numbers belong to
    """
    rays, triangle, t = ends
    K, ways = len(side), shown.ways
    f = np.where(triangle >= 0, surface.facet[triangle], 0)
    back = np.einsum("ij,ij->i", rays[:, 3:], surface.normal[f]) > 0
    counts = ~((triangle >= 0) & surface.inside[2 * f + back])
    element = np.arange(len(rays)) * 2 // n_rays  # each half is one
    start = paths.first_met(rays, np.where(counts, triangle, -1), t)
    normal = surface.normal[side // 2] * (1.0 - 2.0 * (side % 2))[:, None]
    shot = np.full(K, n_rays)
    of = glints.glints(surface, ways.finish, normal, shot)
    sums = beyond(surface, shown, start, element, 2 * K, sought=of)
    if of is not None:
        E = ways.E[[lamp.lamp for lamp in ways.lamps]]
        every = glints.light(surface, ways.finish, ways.chains, ways.lamps, of, places, normal, shot, blocks, seed + 17)
        for row, k, chain, value in every:
            found = np.bincount(row, value, 2 * K)
            sums += found[:, None] * E[k] * ways.chains.power(ways.rho_s)[chain]
    number = np.bincount(element, counts, 2 * K)
    sums, number = sums.reshape(K, 2, -1), number.reshape(K, 2, 1)
    each = sums / np.maximum(number, 1)
    return sums.sum(axis=1) / np.maximum(number.sum(axis=1), 1), (each[:, 0] - each[:, 1]) / 2


def beyond(surface: Surface, shown: LightMap, start, element, m, *, seed=11, sought=None):
    """Sums (m, C) over the rays of each element of what they find after the specular surfaces that they have met.

    start : lib.light.paths.Met;  element : (n,) of each ray
    sought : Glints, where lamps in glossy planes are sought as well; what that brings is not part of the sums
    """
    ways = shown.ways
    C = shown.value.shape[1]
    total = np.zeros((m, C))
    E = ways.E[[lamp.lamp for lamp in ways.lamps]]  # of each emitter

    arrays = None if sought is None else sought.arrays
    also = None if sought is None else (arrays, ways.finish, start)

    def add(met, light):
        light = light * ways.chains.power(ways.rho_s)[met.chain]
        for c in range(C):
            total[:, c] += np.bincount(element[met.source], light[:, c], m)

    def at_lobe(at):
        add(at.met, specular_lamps.lobe_light(surface, ways.lamps, at, seed=seed, glints=arrays) @ E)

    for met in paths.follow(surface, ways.finish, ways.chains, start, seed=seed, at_lobe=at_lobe):
        light = reflected_at(surface, shown, met.rays, met.triangle, met.t) * met.weight[:, None]
        which, share = specular_lamps.lamp_found(surface, ways.lamps, met, ways.chains, ways.complete, sought=also)
        on = np.flatnonzero(which >= 0)
        light[on] += share[on, None] * E[which[on]]
        add(met, light)
    return total


def reflected_at(surface: Surface, shown: LightMap, rays, triangle, t):
    """What the ends of rays reflect diffusely towards them, (n, C), or what is outside; nothing inside solids.

    Ends that are nearer than NEAR texels are lit by themselves.
    """

    def look(which, value):
        ends = RayEnds(rays[which], triangle[which], t[which])
        return kernels.reflected_at(ends, surface.arrays, shown.start, shown.shape, value)

    light = look(slice(None), shown.value)
    if shown.glow is not None:
        gone = triangle < 0
        light[gone] = shown.glow.light(rays[gone])
    if shown.ways is not None:
        near, close = lit_nearby(surface, shown, shown.ways.every, shown.ways.E_every, rays, triangle, t)
        near = np.flatnonzero(near >= 0)
        light[near] += np.where(light[near].any(axis=1, keepdims=True), close - look(near, shown.direct), 0)
    return light


def lit_nearby(surface, shown, lamps, E, rays, triangle, t):
    """The radiosity by direct light where rays end within NEAR texels, from one shadow ray to each emitter.

    Such an end is too near for a map of texels: a shadow in the corner matters.
    Returns the number of each such ray (n,), -1 for the others, and the radiosities (m, C).
    """
    near = np.full(len(rays), -1, np.int32)
    rows = np.flatnonzero(t < NEAR * shown.step) if surface.n_occluders else np.zeros(0, np.int64)
    near[rows] = np.arange(len(rows))
    light = np.zeros((len(rows), E.shape[1]), np.float32)
    ends = RayEnds(rays, triangle, t)
    for k, lamp in enumerate(lamps):
        shadow, factor = kernels.close_rays(rows, ends, k, surface.arrays, shown.arrays, lamp.arrays)
        lit = np.flatnonzero(factor > 0)
        factor[lit[~lamps_.reached(surface, lamp, shadow[lit])]] = 0
        light += factor[:, None] * E[lamp.lamp].astype(np.float32)
    return near, light * shown.rho[surface.facet[triangle[rows]]]
