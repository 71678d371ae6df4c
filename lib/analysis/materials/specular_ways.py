"""Light that goes past mirrors and glossy surfaces on its way to the tiles, and the tiles that such surfaces show."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lib.analysis.materials.site import Site
from lib.analysis.seen.receivers import Receivers, Ways, few
from lib.light import form_factors, lamps, specular, specular_lamps
from lib.light.chains import GLOSSY, MIRROR, Chains, Finish
from lib.light.specular import Transport

# tiles, see gather.blocks: of diffuse surfaces in mirrors, and of lobes, whose light changes within smaller angles
PLAIN = {"largest": 1 / 40, "smallest": 1 / 200, "per_facet": 24}
SHEEN = {"largest": 0.015, "smallest": 0.00375}


class Traced(NamedTuple):
    """Light by specular ways at one finish, to the patches and to the tiles; F has the sub-cell correction."""

    transport: Transport
    F: dict
    tiles: Ways


def tiles_of(site: Site, finish: Finish | None, chains: Chains, textured, *, rays=512) -> Receivers:
    """All tiles where the groups of `finish` are specular: those of other groups stay, theirs are made anew.

    textured : numbers of groups, of which not the flattest pixels count but all
    """
    base = replace(site.tiles, fit=site.tiles.fit ^ np.isin(site.tiles.group, textured))
    if finish is None:
        return base
    groups = site.surface.group
    mirrors = [g for g, k in zip(finish.groups, finish.kind, strict=True) if k == MIRROR]
    glossy = [g for g, k in zip(finish.groups, finish.kind, strict=True) if k == GLOSSY]
    number = np.full(len(site.surface.groups), -1, np.int32)
    number[list(finish.groups)] = np.arange(len(finish))
    parts = [base.take(np.flatnonzero(~np.isin(base.group, finish.groups)))]
    if mirrors:
        pixel = site.pixels_of(mirrors)
        shown, pure = site.in_mirrors(finish, chains, pixel)
        good = np.flatnonzero(pure & ~site.is_lamp[shown.facet])
        is_glossy = np.isin(groups[shown.facet[good]], glossy)
        for mine, block in ((good[~is_glossy], PLAIN), (good[is_glossy], {**SHEEN, "per_facet": 300})):
            if len(mine):
                g = groups[shown.facet[mine]]
                lobe = np.where(np.isin(g, glossy), number[g], -1)
                parts.append(site.new_tiles(pixel[mine], shown.of(mine), lobe, rays=rays, seed=31, **block))
    if glossy:
        pixel = site.pure_pixels_of(glossy)
        if len(pixel):
            shown = site.at_once(pixel)
            lobe = number[groups[shown.facet]]
            parts.append(site.new_tiles(pixel, shown, lobe, rays=rays, seed=41, per_facet=400, **SHEEN))
    return Receivers.joined(parts)


def traced(site: Site, finish: Finish, chains: Chains, tiles: Receivers) -> Traced:
    """The specular ways of the light to the patches and to the tiles."""
    n_rays = max(int(site.factors.rows.shot.max(initial=1)), 512)
    transport = specular.transport(
        site.surface, site.mesh, finish, chains, site.lamps, site.n_lamps, outside=site.outside, n_rays=n_rays
    )
    site.effort.note("rays by specular ways", transport.rays)
    site.effort.lost = transport.lost
    mirrored = transport.mirrored, transport.way, transport.complete
    F = {k: (A @ site.subcell).tocsr() for k, A in transport.F.items()}
    return Traced(transport, F, ways(site, finish, chains, tiles, mirrored))


def ways(site: Site, finish: Finish, chains: Chains, tiles: Receivers, mirrored=None) -> Ways:
    """The specular ways of the light to tiles. mirrored : of specular_lamps.mirrored_lamps, where they are known"""
    surface = site.surface
    emitters, way, complete = mirrored or specular_lamps.mirrored_lamps(surface, finish, chains, site.lamps)
    n = np.maximum(np.minimum(tiles.rows.shot, 1024), 64)
    ray_start, make = form_factors.from_points(surface, tiles.p, tiles.start, tiles.side[tiles.start[:-1]], n, seed=5)
    rows = specular.rows(
        surface,
        site.mesh,
        finish,
        chains,
        site.lamps,
        site.n_lamps,
        ray_start,
        specular.from_rays(surface, site.mesh, make),
        outside=site.outside,
        seed=5,
        complete=complete,
        spread=True,
        places=specular.Places(tiles.start, tiles.p, site.normals[tiles.side[tiles.start[:-1]]]),
    )
    site.effort.note("rays by specular ways", rows.rays)
    site.effort.lost = max(rows.lost, site.effort.lost)
    if emitters:
        halves = _mirrored_light(site, tiles, emitters)
        specular_lamps.add_lamps(rows.D, emitters, way, 0.5 * (halves[0] + halves[1]), site.n_lamps)
        specular_lamps.add_lamps(rows.D_spread, emitters, way, 0.5 * (halves[0] - halves[1]), site.n_lamps)
        site.effort.note("mirrored lamps", len(emitters))
    corrected = lambda F: {k: (A @ site.subcell).tocsr() for k, A in F.items()}
    return Ways(corrected(rows.F), rows.D, corrected(rows.F_spread), rows.D_spread)


def _mirrored_light(site, tiles, emitters):
    """Factors (T, n) of tiles to mirrored lamps, from two sets of every other point.

    Mirrors throw light with hard edges: the two sets apart show where.
    """
    one = [replace(lamp, lamp=k) for k, lamp in enumerate(emitters)]
    start, some = few(tiles.start, 32)
    n = np.diff(start)
    number = np.arange(len(some)) - np.repeat(start[:-1], n)
    halves = []
    for odd in (0, 1):
        part = some[np.flatnonzero((number % 2 == odd) | (np.repeat(n, n) == 1))]
        begin = np.concatenate([[0], np.cumsum(np.where(n == 1, 1, (n + 1 - odd) // 2))])
        halves.append(
            lamps.direct(
                site.surface,
                one,
                tiles.p[part],
                site.normals,
                tiles.side[part],
                len(one),
                n_samples=8,
                start=begin,
                seed=odd,
            )
        )
    return halves


def irradiance_past(site: Site, finish: Finish, rho_s, state, tiles: Receivers):
    """Irradiance of tiles by way of the surfaces of `finish`, and its sampling error: (T, C) each, 0 for none.

    rho_s : (M, C)
    """
    if not len(finish):
        return 0.0, 0.0
    chains = Chains(len(finish))
    found = ways(site, finish, chains, tiles)
    return (
        chains.total(rho_s, found.G, found.D, state.b, state.E),
        chains.total(rho_s, found.G_spread, found.D_spread, state.b, state.E),
    )
