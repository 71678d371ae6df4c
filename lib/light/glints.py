"""Lamps in the lobes of large glossy planes, sought from the lamp.

A narrow lobe on a floor takes a lamp's light to the walls by way of a spot of the floor as small as the lamp's mirror
image. Gathering rays from a wall meet that spot by chance, few of them, each with much light: the walls are mottled.
So further ways are drawn the other way round: a place on the lamp, and a place on the plane around the one that mirrors
the lamp, spread as the lobe is. All three kinds of ways (the two of lib/light/specular_lamps.py begin with gathering
rays) are weighted by the balance heuristic (Veach and Guibas 1995), so nothing is counted twice and nothing is lost
where the spread is not quite the lobe's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.given.rays import shifts, sobol
from lib.light import glints_kernels as kernels
from lib.light.chains import GLOSSY, Chains, Finish
from lib.light.glints_kernels import GlintArrays
from lib.light.paths_kernels import Lobes
from lib.light.specular_lamps import lamp_areas
from lib.light.surface import Surface, triangle_areas

PLANES = 8  # glossy facets that lamps are sought by, the largest ones
LARGE = 0.02  # of all glossy area: smaller facets are left to the gathering rays
FEWER = 4  # gathering rays for each such way


@dataclass(frozen=True, eq=False)
class Glints:
    """facets : numbers of the planes;  n : ways from each place by each plane to each emitter
    arrays : for kernels
    """

    facets: np.ndarray
    n: int
    arrays: GlintArrays


def glints(surface: Surface, finish: Finish, normal, shot) -> Glints | None:
    """For places of normals (K, 3) that gathering rays come from, `shot` (K,) from each; None: no plane is glossy."""
    of, _ = finish.facets(surface)
    glossy = (of >= 0) & (np.append(finish.kind, -1)[of] == GLOSSY)
    area = np.bincount(surface.facet, triangle_areas(surface.corners), len(surface.normal))
    area = np.where(glossy, area[: len(glossy)], 0)
    order = np.argsort(-area, kind="stable")[:PLANES]
    facets = order[area[order] > max(LARGE * area.sum(), 1e-300)]
    if not len(facets):
        return None
    n = max(2, int(np.max(shot, initial=0)) // FEWER)
    ways = np.zeros(len(surface.normal))
    ways[facets] = n
    return Glints(facets, n, GlintArrays(ways, np.repeat(shot, shot).astype(float), np.repeat(normal, shot, axis=0)))


def light(surface: Surface, finish: Finish, chains: Chains, lamps, of: Glints, places, normal, shot, blocks, seed):
    """What the ways bring: yields (row (m,), emitter, chain, value (m,) for E = 1 and rho_s = 1).

    row : 2 i for the first half of the ways of place i, else 2 i + 1
    places : first, last (K,), p (M, 3);  normal, shot : see `glints`
    blocks : (K,) numbers that the random numbers belong to
    """
    group, axes = finish.facets(surface)
    lobes = Lobes(axes, np.asarray(finish.alpha, float), finish.form)
    sequence, areas = sobol(of.n), lamp_areas(lamps)
    for number, f in enumerate(of.facets):
        chain = int(chains.then(np.zeros(1, int), group[[f]])[0])
        for k, lamp in enumerate(lamps):
            words = sequence, shifts(blocks, of.n, seed + 100 * number + k)
            to, on, value = kernels.found(
                of.n, places, normal, f, group[f], of.n / shot, lamp.arrays, areas[k], lobes, surface.arrays, words
            )
            lit = np.flatnonzero(value > 0)
            triangle, _ = surface.caster.closest(to[lit])
            lit = lit[(triangle >= 0) & (surface.facet[triangle] == f)]
            if surface.n_occluders:
                lit = lit[~surface.shadows.occluded(on[lit], 1 - 1e-4)]
            place, j = np.divmod(lit, of.n)
            yield 2 * place + (2 * j >= of.n), k, chain, value[lit]
