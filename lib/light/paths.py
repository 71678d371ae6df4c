"""Rays that go on at mirrors, by Descartes' law, and at glossy surfaces, into a sampled direction of the Ward lobe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.light import paths_kernels as kernels
from lib.light.chains import GLOSSY, Chains, Finish
from lib.light.surface import Surface

DEPTH = 32  # specular surfaces in a row that a ray of the light follows
LOBES = 4  # glossy ones among them


# -- rays that go on


@dataclass
class Met:
    """What rays have met after a specular surface.

    rays : (n, 6) float32, of this last piece of the way;  triangle, t : its end;  source : (n,) the ray that began the way
    chain : (n,) int32;  weight : (n,) without the rho_s;  lobe : (n,) density of the lobe that chose this direction, inf at mirrors
    glossy : (n,) int, glossy surfaces on the way
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


def first_met(rays, triangle, t) -> Met:
    """The ends of rays that have met nothing specular yet."""
    n = len(rays)
    return Met(
        rays, triangle, t, np.arange(n), np.zeros(n, np.int32), np.ones(n), np.full(n, np.inf), np.zeros(n, np.int32)
    )


def follow(
    surface: Surface, finish: Finish, chains: Chains, start: Met, *, depth=DEPTH, seed=0, at_lobe=None, left=None
):
    """Yields Met after each specular surface, until no ray goes on; rays that meet no specular facet end.

    left : list that receives the sources and weights of the rays that would still go on after `depth` surfaces
    at_lobe : called with (p, facet, sign, Met of those that are at a glossy surface, number of the specular group, tangent frames, step)
    """
    of, axes = finish.facets(surface)
    met = start
    for step in range(depth):
        f = np.where(met.triangle >= 0, surface.facet[met.triangle], 0)
        at = np.flatnonzero((met.triangle >= 0) & (of[f] >= 0))
        if len(at):
            f = f[at]
            glossy = np.asarray(finish.kind)[of[f]] == GLOSSY
            keep = (met.glossy[at] < LOBES) | ~glossy
            at, f, glossy = at[keep], f[keep], glossy[keep]
        if not len(at):
            return
        group = of[f]
        rays, weight, lobe, p, sign = kernels.bounced(
            met.rays,
            met.t,
            at,
            f,
            group,
            glossy,
            surface.normal,
            surface.inside,
            axes,
            np.asarray(finish.alpha, float),
            finish.form,
            met.source[at],
            step,
            seed,
        )
        if at_lobe is not None and glossy.any():
            g = np.flatnonzero(glossy & (sign != 0))
            here = Met(
                met.rays[at[g]],
                met.triangle[at[g]],
                met.t[at[g]],
                met.source[at[g]],
                chains.then(met.chain[at[g]], group[g]),
                met.weight[at[g]],
                met.lobe[at[g]],
                met.glossy[at[g]],
            )
            at_lobe(p[g], f[g], sign[g], here, group[g], axes, step)
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
            lobe[live],
            met.glossy[at[live]] + glossy[live],
        )
        yield met
    if left is not None:
        on = (met.triangle >= 0) & (of[surface.facet[np.maximum(met.triangle, 0)]] >= 0)
        left.append((met.source[on], met.weight[on]))
