"""Lamps in mirrors and lamps in lobes.

Lamps in plane mirrors are *mirrored lamps*: the exact factor of the mirrored polygon times the share of it that is seen through the
mirror, which has none of the noise of rays that find a small lamp by chance. Lamps in a lobe are found both by rays to the lamp and
by rays of the lobe, weighted by the balance heuristic (Veach and Guibas 1995).
"""

from __future__ import annotations

import numpy as np

from lib.given.rays_kernels import OFFSET
from lib.light import specular_lamps_kernels as kernels
from lib.light.chains import MIRROR, Chains, Finish
from lib.light.lamps import Emitter
from lib.light.paths import DEPTH, Met
from lib.light.surface import Surface

MIRRORED_LAMPS = 64  # facets of lamps in plane mirrors; beyond, lamps in mirrors are left to the rays


# -- lamps in mirrors, lamps in lobes


def mirrored_lamps(surface: Surface, finish: Finish, chains: Chains, lamps, *, depth=4, limit=MIRRORED_LAMPS):
    """The lamps as plane mirrors show them: Emitters that know their mirrors, and their chains (n,).

    A lamp in a mirror in a mirror is there too, `depth` deep or as deep as makes no more than `limit`: they are complete for
    ways by so many mirrors (the third value); what comes by more is left to the rays.
    """
    of, _ = finish.facets(surface)
    mirrors = [
        f
        for f in np.flatnonzero(of >= 0)
        if finish.kind[of[f]] == MIRROR and not (surface.inside[2 * f] and surface.inside[2 * f + 1])
    ]
    if not mirrors:
        return [], np.zeros(0, int), DEPTH
    box = {f: surface.corners[surface.facet == f].reshape(-1, 3) for f in mirrors}
    found, number = [], []
    last = [(lamp, 0) for lamp in lamps]
    for level in range(depth):
        fresh = []
        for lamp, chain in last:
            for f in mirrors:
                n, o = surface.normal[f], surface.origin[f]
                before = lamp.mirrors[0] if lamp.mirrors else -1
                if f == before:
                    continue
                height = (lamp.corners - o) @ n
                seen = box[before] if before >= 0 else lamp.corners.reshape(-1, 3)
                over = (seen - o) @ n  # of what lights the mirror: on which sides of it
                for sign in (1, -1):
                    if (
                        surface.inside[2 * f + (sign < 0)]
                        or (sign * over).max() <= 4 * OFFSET
                        or (sign * height).max() <= 4 * OFFSET
                    ):
                        continue
                    # the mirror must lie before the front of the (mirrored) lamp
                    if not ((box[f][:, None] - lamp.corners[None, :, 0]) * lamp.normal[None]).sum(axis=-1).max() > 1e-9:
                        continue
                    corners = lamp.corners - 2 * height[..., None] * n
                    front = lamp.normal - 2 * (lamp.normal @ n)[:, None] * n
                    fresh.append(
                        (
                            Emitter(lamp.lamp, corners, front, lamp.cdf, mirrors=(f, *lamp.mirrors)),
                            int(chains.then(np.array([chain]), np.array([of[f]]))[0]),
                        )
                    )
                    break  # the other side of a plane shows the same image: the rays know which
        if len(found) + len(fresh) > limit:
            return found, np.array(number, int), level
        found += [lamp for lamp, _ in fresh]
        number += [chain for _, chain in fresh]
        last = fresh
    return found, np.array(number, int), depth


def lamp_areas(lamps):
    """(n,) local areas of the emitters."""
    return np.array(
        [
            0.5
            * np.linalg.norm(
                np.cross(e.corners[:, 1] - e.corners[:, 0], e.corners[:, 2] - e.corners[:, 0]), axis=1
            ).sum()
            for e in lamps
        ]
    )


def lobe_light(surface: Surface, finish: Finish, lamps, p, facet, sign, met: Met, group, axes, step, *, seed=0):
    """What the lamps send straight into lobes, by one ray to each emitter: (n, lamps) of the balance heuristic's share, without rho_s."""
    light = np.zeros((len(p), len(lamps)))
    for k, lamp in enumerate(lamps):
        rays, value = kernels.to_lamp(
            p,
            facet,
            sign,
            met.rays,
            met.source,
            group,
            surface.normal,
            axes,
            np.asarray(finish.alpha, float),
            finish.form,
            lamp.corners,
            lamp.normal,
            lamp.cdf,
            lamp_areas([lamp])[0],
            step,
            seed + k + 0.37,
        )
        lit = np.flatnonzero(value > 0)
        if surface.n_occluders:
            value[lit[surface.shadows.occluded(rays[lit], 1 - 1e-4)]] = 0
        light[:, k] = value * met.weight
    return light


def lamp_found(surface: Surface, lamps, met: Met, chains: Chains, complete):
    """Which emitter the ends of rays lie on (n,), -1: none, and the share (n,) that the balance heuristic gives them.
    Rays that reached a lamp by no more than `complete` mirrors alone are not counted: mirrored lamps are."""
    if not lamps:
        return np.full(len(met), -1), np.zeros(len(met))
    of = np.full(len(surface.normal), -1, np.int32)
    for k, lamp in enumerate(lamps):
        of[list(lamp.facets)] = k
    f = np.where(met.triangle >= 0, surface.facet[met.triangle], 0)
    counted = (met.glossy > 0) | (chains.counts.sum(axis=1)[met.chain] > complete)
    which = np.where((met.triangle >= 0) & counted, of[f], -1)
    along = -np.einsum("ij,ij->i", met.rays[:, 3:], surface.normal[f])
    which[along <= 0] = -1  # the back of a lamp is dark
    density = np.where(which >= 0, met.t.astype(float), 0) ** 2 / np.maximum(along * lamp_areas(lamps)[which], 1e-300)
    share = 1 / (1 + np.where(np.isfinite(met.lobe), density / np.maximum(met.lobe, 1e-300), 0))
    return which, np.where(which >= 0, share, 0) * met.weight


def add_lamps(D, mirrored, way, factor, n_lamps):
    """Add the factors (R, n) of mirrored lamps to D, chain -> (R, L)."""
    for k, lamp in enumerate(mirrored):
        D.setdefault(int(way[k]), np.zeros((len(factor), n_lamps)))[:, lamp.lamp] += factor[:, k]
