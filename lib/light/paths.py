"""Rays that go on at mirrors, by Descartes' law, and at glossy surfaces, into a sampled direction of the Ward lobe."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from lib.light import paths_kernels as kernels
from lib.light.chains import GLOSSY, Chains, Finish
from lib.light.paths_kernels import Bounces, Lobes
from lib.light.surface import Surface

DEPTH = 32  # specular surfaces in a row that a ray of the light follows
LOBES = 4  # glossy ones among them


@dataclass
class Met:
    """The ends of rays (n,), which may have met specular surfaces before.

    rays : (n, 6) float32, of this last piece of the way;  triangle, t : its end;  source : (n,) the ray that began it
    chain : (n,) int32;  weight : (n,) without the rho_s
    lobe : (n,) density of the lobe that chose this direction, inf at mirrors;  glossy : (n,) int, glossy surfaces met
    """

    rays: np.ndarray
    triangle: np.ndarray
    t: np.ndarray
    source: np.ndarray
    chain: np.ndarray
    weight: np.ndarray
    lobe: np.ndarray
    glossy: np.ndarray

    def __len__(self):
        return len(self.source)

    def of(self, which) -> Met:
        """The rays numbered `which`."""
        return Met(*(getattr(self, f.name)[which] for f in fields(self)))


class AtLobes(NamedTuple):
    """Rays that end on glossy surfaces (n,).

    p : (n, 3) local;  facet : (n,);  sign : (n,) 1 front, -1 back;  group : (n,) number of the specular group
    met : the rays, with this surface in their chains;  lobes : shapes;  step : specular surfaces before this one
    """

    p: np.ndarray
    facet: np.ndarray
    sign: np.ndarray
    group: np.ndarray
    met: Met
    lobes: Lobes
    step: int


def first_met(rays, triangle, t) -> Met:
    """The ends of rays that have met nothing specular yet."""
    n = len(rays)
    chain, glossy = np.zeros(n, np.int32), np.zeros(n, np.int32)
    return Met(rays, triangle, t, np.arange(n), chain, np.ones(n), np.full(n, np.inf), glossy)


def follow(
    surface: Surface, finish: Finish, chains: Chains, start: Met, *, depth=DEPTH, seed=0, at_lobe=None, left=None
):
    """Yields Met after each specular surface, until no ray goes on; rays that meet no specular facet end.

    at_lobe : called with AtLobes of the rays that are at a glossy surface
    left : list that receives the sources and weights of the rays that would still go on after `depth` surfaces
    """
    of, axes = finish.facets(surface)
    lobes = Lobes(axes, np.asarray(finish.alpha, float), finish.form)
    met = start
    for step in range(depth):
        bounces = _bounces(surface, finish, of, met)
        if not len(bounces.at):
            return
        at, group, glossy = bounces.at, bounces.group, bounces.glossy
        rays, weight, density, p, sign = kernels.bounced(bounces, lobes, surface.arrays, step, seed)
        if at_lobe is not None and glossy.any():
            g = np.flatnonzero(glossy & (sign != 0))
            here = met.of(at[g])
            here.chain = chains.then(here.chain, group[g])
            at_lobe(AtLobes(p[g], bounces.facet[g], sign[g], group[g], here, lobes, step))
        live = np.flatnonzero(weight > 0)
        if not len(live):
            return
        triangle, t = surface.caster.closest(rays[live])
        met = Met(
            rays[live],
            triangle,
            t,
            met.source[at[live]],
            chains.then(met.chain[at[live]], group[live]),
            met.weight[at[live]] * weight[live],
            density[live],
            met.glossy[at[live]] + glossy[live],
        )
        yield met
    if left is not None:
        on = (met.triangle >= 0) & (of[surface.facet[np.maximum(met.triangle, 0)]] >= 0)
        left.append((met.source[on], met.weight[on]))


def _bounces(surface, finish, of, met: Met) -> Bounces:
    """The rays that go on: those on mirrors, and those on glossy surfaces that have met fewer than LOBES before.

    of : (F,) number of each facet's specular group, -1
    """
    f = np.where(met.triangle >= 0, surface.facet[met.triangle], 0)
    at = np.flatnonzero((met.triangle >= 0) & (of[f] >= 0))
    f = f[at]
    glossy = np.asarray(finish.kind)[of[f]] == GLOSSY
    keep = (met.glossy[at] < LOBES) | ~glossy
    at, f, glossy = at[keep], f[keep], glossy[keep]
    return Bounces(met.rays, met.t, at, f, of[f], glossy, met.source[at])
