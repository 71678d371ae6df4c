"""Lamps in mirrors and lamps in lobes.

Lamps in plane mirrors are *mirrored lamps*: the exact factor of the mirrored polygon times the share of it that is seen
through the mirror. That has none of the noise of rays which find a small lamp by chance. Lamps in a lobe are found both
by rays to the lamp and by rays of the lobe, weighted by the balance heuristic (Veach and Guibas 1995).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lib.given.rays_kernels import OFFSET
from lib.light import glints_kernels
from lib.light import specular_lamps_kernels as kernels
from lib.light.chains import MIRROR, Chains, Finish
from lib.light.glints_kernels import GlintArrays
from lib.light.lamps import Emitter
from lib.light.paths import DEPTH, AtLobes, Met
from lib.light.paths_kernels import Lobes
from lib.light.specular_lamps_kernels import GlossyArrays
from lib.light.surface import Surface, triangle_areas

MIRRORED_LAMPS = 64  # facets of lamps in plane mirrors; beyond, lamps in mirrors are left to the rays


# ---- lamps in mirrors ----


class MirroredLamps(NamedTuple):
    """lamps : Emitters that know their mirrors;  way : (n,) their chains

    complete : by how many mirrors they are complete; what comes by more is left to the rays
    """

    lamps: list
    way: np.ndarray
    complete: int


class PlaneMirror(NamedTuple):
    """facet : its number;  normal, origin : (3,);  corners : (n, 3);  inside : which of its sides look into a solid"""

    facet: int
    normal: np.ndarray
    origin: np.ndarray
    corners: np.ndarray
    inside: tuple


def mirrored_lamps(
    surface: Surface, finish: Finish, chains: Chains, lamps, *, depth=4, limit=MIRRORED_LAMPS
) -> MirroredLamps:
    """The lamps as plane mirrors show them.

    A lamp in a mirror in a mirror is there too, `depth` deep, or as deep as makes no more than `limit` of them.
    """
    mirrors = _plane_mirrors(surface, finish)
    if not mirrors:
        return MirroredLamps([], np.zeros(0, int), DEPTH)
    of, _ = finish.facets(surface)
    found, way = [], []
    last = [(lamp, 0) for lamp in lamps]
    for level in range(depth):
        fresh = []
        for lamp, chain in last:
            for mirror in mirrors.values():
                image = _in_mirror(lamp, mirror, mirrors.get(lamp.mirrors[0]) if lamp.mirrors else None)
                if image is not None:
                    fresh.append((image, int(chains.then(np.array([chain]), np.array([of[mirror.facet]]))[0])))
        if len(found) + len(fresh) > limit:
            return MirroredLamps(found, np.array(way, int), level)
        found += [lamp for lamp, _ in fresh]
        way += [chain for _, chain in fresh]
        last = fresh
    return MirroredLamps(found, np.array(way, int), depth)


def _plane_mirrors(surface, finish):
    """{facet: PlaneMirror} of the mirrors with a side that light can reach."""
    of, _ = finish.facets(surface)
    mirrors = {}
    for f in np.flatnonzero(of >= 0):
        inside = (surface.inside[2 * f], surface.inside[2 * f + 1])
        if finish.kind[of[f]] == MIRROR and not all(inside):
            corners = surface.corners[surface.facet == f].reshape(-1, 3)
            mirrors[f] = PlaneMirror(f, surface.normal[f], surface.origin[f], corners, inside)
    return mirrors


def _in_mirror(lamp: Emitter, mirror: PlaneMirror, before: PlaneMirror | None) -> Emitter | None:
    """A lamp's image in a mirror; None where the mirror cannot show it.

    before : the mirror that shows this lamp, if it is an image itself: what lights the next mirror is then there
    """
    n, o = mirror.normal, mirror.origin
    if before is not None and before.facet == mirror.facet:
        return None
    height = (lamp.corners - o) @ n
    over = ((lamp.corners.reshape(-1, 3) if before is None else before.corners) - o) @ n
    # Either side will do: the other side of a plane shows the same image, and the rays know which is seen.
    sides = ((1, mirror.inside[0]), (-1, mirror.inside[1]))
    if not any(
        not inside and (sign * over).max() > 4 * OFFSET and (sign * height).max() > 4 * OFFSET for sign, inside in sides
    ):
        return None
    # the mirror must lie before the front of the (mirrored) lamp
    if not ((mirror.corners[:, None] - lamp.corners[None, :, 0]) * lamp.normal[None]).sum(axis=-1).max() > 1e-9:
        return None
    corners = lamp.corners - 2 * height[..., None] * n
    front = lamp.normal - 2 * (lamp.normal @ n)[:, None] * n
    aim, exponent = lamp.lobe[:3], lamp.lobe[3]
    lobe = np.append(aim - 2 * (aim @ n) * n, exponent)
    return Emitter(lamp.lamp, corners, front, lamp.cdf, mirrors=(mirror.facet, *lamp.mirrors), lobe=lobe)


def add_lamps(D, mirrored, way, factor, n_lamps):
    """Add the factors (R, n) of mirrored lamps to D, {chain: (R, L)}."""
    for k, lamp in enumerate(mirrored):
        D.setdefault(int(way[k]), np.zeros((len(factor), n_lamps)))[:, lamp.lamp] += factor[:, k]


# ---- lamps in lobes ----


def lamp_areas(lamps):
    """(n,) local areas of the emitters."""
    return np.array([triangle_areas(lamp.corners).sum() for lamp in lamps])


def no_glints(surface: Surface) -> GlintArrays:
    """No ways are sought from lamps."""
    return GlintArrays(np.zeros(len(surface.normal)), np.zeros(0), np.zeros((0, 3)))


def lobe_light(surface: Surface, lamps, at: AtLobes, *, seed=0, glints: GlintArrays | None = None):
    """(n, lamps) what the lamps send straight into lobes, by one ray to each emitter, without rho_s.

    It is the balance heuristic's share; the rays of the lobe bring the rest, see `lamp_found`.
    glints : what is sought from the lamps by way of the first surface, see lib/light/glints.py
    """
    glints = no_glints(surface) if glints is None or at.step else glints
    places = GlossyArrays(at.p, at.facet, at.sign, at.group, at.met.rays, at.met.source)
    light = np.zeros((len(at.p), len(lamps)))
    for k, (lamp, area) in enumerate(zip(lamps, lamp_areas(lamps), strict=True)):
        rays, value = kernels.to_lamp(
            places, at.lobes, surface.arrays, lamp.arrays, area, at.step, seed + k + 0.37, glints
        )
        lit = np.flatnonzero(value > 0)
        if surface.n_occluders:
            value[lit[surface.shadows.occluded(rays[lit], 1 - 1e-4)]] = 0
        light[:, k] = value * at.met.weight
    return light


def lamp_found(surface: Surface, lamps, met: Met, chains: Chains, complete, *, sought=None):
    """Which emitter the ends of rays lie on (n,), -1: none, and the share (n,) that the balance heuristic gives them.

    Rays that reached a lamp by no more than `complete` mirrors alone are not counted: mirrored lamps are.
    sought : GlintArrays, the Finish, and the Met that the ways began with, where lamps are sought as well
    """
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
    if sought is not None:
        density *= 1 + _sought(surface, met, chains, which, *sought)
    share = 1 / (1 + np.where(np.isfinite(met.lobe), density / np.maximum(met.lobe, 1e-300), 0))
    for k in np.flatnonzero([lamp.has_lobe for lamp in lamps]):
        mine = which == k
        share[mine] *= lamps[k].thrown(-met.rays[mine, 3:])
    return which, np.where(which >= 0, share, 0) * met.weight


def _sought(surface, met, chains, which, glints: GlintArrays, finish: Finish, start: Met):
    """(n,) how often each way was drawn from the lamp as well, over how often from here."""
    of, axes = finish.facets(surface)
    more = np.zeros(len(met))
    at = np.flatnonzero((which >= 0) & (met.glossy == 1) & (chains.counts.sum(axis=1)[met.chain] == 1))
    source = met.source[at]
    facet = surface.facet[start.triangle[source]]
    ends = [m.rays[k, :3] + m.t[k, None].astype(float) * m.rays[k, 3:] for m, k in ((start, source), (met, at))]
    lobes = Lobes(axes, np.asarray(finish.alpha, float), finish.form)
    more[at] = glints_kernels.often_each(
        source, start.rays[source], *ends, facet, of[facet], glints, lobes, surface.arrays
    )
    return more
