"""The light map made: direct light evaluated again at each texel, indirect light fitted through the patches.

The indirect light is then gathered once more by rays.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.cells import Mesh
from lib.light.surface import Surface
from lib.picture import texels_kernels as kernels
from lib.picture.light_map import LightMap
from lib.picture.pixels import facet_triangles
from lib.picture.ray_light import gathered_light
from lib.picture.triangles_kernels import within

TEXELS = 30_000  # about so many texels in a scene


def light_map(
    surface: Surface,
    mesh: Mesh,
    lamps,
    E,
    indirect,
    exposed,
    rho_facet,
    *,
    glow=None,
    texels=TEXELS,
    samples=32,
    n_rays=64,
    ways=None,
    step=None,
) -> LightMap:
    """Reflected radiosity of every side that has patches, direct light from the lamps and not from the patches.

    lamps : from lamps.emitters;  E : (L, C);  indirect : (N, C) what others send to the patches
    exposed : (N,) share of each patch outside solids;  rho_facet : (F, C)
    glow : outside.Glow, None: it is black around the model
    texels : about so many;  step : local, their width instead, and then the same rays at a texel whatever others see
    samples : shadow rays of each to each lamp;  n_rays : gathering rays of each, or 0
    """
    grid = _grids(surface, _in_order(mesh.tri_side), texels, step)
    normals = surfaces.side_normals(surface)
    f, rho = grid.side // 2, rho_facet.astype(np.float32)
    good = within(grid.p, f, facet_triangles(surface), normals[2 * f])
    good &= ~surfaces.covered(surface, grid.p, normals[grid.side])
    at = np.flatnonzero(good)
    # texels outside the facet or inside a solid take another's value
    fill = kernels.nearest(good, grid.start[grid.sides], grid.count)
    numbers = None if step is None else at
    irradiance, whole = _by_lamps(surface, lamps, E, grid, at, normals, samples, numbers)
    between = np.maximum(_by_patches(surface, mesh, indirect, exposed, grid, at), 0)
    irradiance, whole = irradiance[fill], whole[fill]
    first = irradiance * rho[f]

    value = first + between[fill] * rho[f]
    shown = LightMap(
        grid.start, grid.shape, value, irradiance, good, first, between, whole, float(grid.step), rho, ways, glow
    )
    if n_rays:
        # once more by rays: the light that the patches pass on is then as sharp as the texels, not as the patches
        ones = np.arange(len(at))
        places = grid.p[at], ones, ones + 1, grid.side[at]
        between[at] = gathered_light(surface, shown, lamps, E, *places, n_rays, 650, numbers)[0]
    between = between[fill]
    return replace(shown, value=first + between * rho[f], irradiance=irradiance + between, between=between)


def _in_order(side):
    """The sides that patches lie on as they come: those that a change has added stand behind the others."""
    sides, first = np.unique(side, return_index=True)
    return sides[np.argsort(first)]


class _Grids(NamedTuple):
    """Texels of all sides: K texels on S sides."""

    sides: np.ndarray  # (S,)
    count: np.ndarray  # (S, 2) texels along the two axes
    start: np.ndarray  # (2 F,) int64, first texel of each side, -1
    shape: np.ndarray  # (2 F, 2) int32
    side: np.ndarray  # (K,) int32
    index: np.ndarray  # (K,) number within the side
    p: np.ndarray  # (K, 3) local, the texels' centres
    step: float  # local, about the width of a texel


def _grids(surface, sides, texels, step) -> _Grids:
    size = surface.size[sides // 2]
    step = step or np.sqrt(max(size.prod(axis=1).sum(), 1e-300) / texels)
    # At least 3 texels, so that a half-buried rim keeps one outside.
    count = np.clip(np.ceil(size / step), 3, 4096).astype(np.int64)
    n = count.prod(axis=1)
    start = np.full(2 * len(surface.normal), -1, np.int64)
    start[sides] = np.concatenate([[0], np.cumsum(n)[:-1]])
    shape = np.ones((2 * len(surface.normal), 2), np.int32)
    shape[sides] = count
    side = np.repeat(sides, n).astype(np.int32)
    f = side // 2
    index = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    columns = shape[side, 1]
    uv = (np.stack([index // columns, index % columns], axis=1) + 0.5) * surface.size[f] / shape[side]
    p = surface.origin[f] + uv[:, :1] * surface.axes[f, 0] + uv[:, 1:] * surface.axes[f, 1]
    return _Grids(sides, count, start, shape, side, index, p, step)


def _by_lamps(surface, lamps, E, grid: _Grids, at, normals, samples, numbers):
    """Irradiance (K, C) by the lamps, and the factor to each emitter if nothing stood in between (K, emitters).

    at : the texels that count;  both float32
    """
    p, side = grid.p[at], grid.side[at]
    irradiance = np.zeros((len(grid.p), E.shape[1]), np.float32)
    whole = np.zeros((len(grid.p), len(lamps)), np.float32)
    for k, lamp in enumerate(lamps):
        one = [replace(lamp, lamp=0)]
        whole[at, k] = lamps_.direct(surface, one, p, normals, side, 1, n_samples=1, shadows=False)[:, 0]
        if surface.n_occluders or lamp.mirrors:
            seed = {"n_samples": samples, "seed": 71 + k, "numbers": numbers}
            seen = lamps_.direct(surface, one, p, normals, side, 1, **seed)
        else:
            seen = whole[at, k : k + 1]
        irradiance[at] += seen * E[lamp.lamp]
    return irradiance, whole


def _by_patches(surface, mesh, indirect, exposed, grid: _Grids, at):
    """(K, C) float32 irradiance by other patches at the texels `at`: the patches' own, fitted smoothly."""
    side, C = grid.side[at], indirect.shape[1]
    lit = np.flatnonzero((exposed > 0) & ~mesh.is_cluster)
    place = np.hstack([grid.p[at], kernels.FAR * side[:, None]])
    places = np.hstack([mesh.centre[lit], kernels.FAR * mesh.side[lit, None]])
    patch = _patch_at(mesh, side, grid.index[at], grid.shape, mesh.table_shape[side])
    on, held = np.maximum(patch, 0), patch >= 0
    texels_of_patch = np.bincount(on, held, len(mesh))
    even = held & mesh.is_cluster[on]  # a cluster has no neighbours on its facets
    between = np.zeros((len(grid.p), C), np.float32)
    rest = indirect
    for _ in range(3):
        # A fit through hollow or domed light lies above or below it. What a patch lacks on average is added until the
        # two agree.
        between[at[even]] += rest[on[even]]
        between[at[~even]] += spread(places, rest[lit], place[~even], surface.axes[side[~even] // 2])
        sums = np.stack([np.bincount(on, np.where(held, between[at, c], 0), len(mesh)) for c in range(C)], axis=1)
        found = sums / np.maximum(texels_of_patch, 1)[:, None]
        rest = np.where((texels_of_patch > 0)[:, None], indirect - found, 0)
    return between


def _patch_at(mesh, side, index, shape, cells):
    """The patch under each texel's centre, -1 outside."""
    columns = shape[side, 1]
    a = ((index // columns + 0.5) * cells[:, 0] / shape[side, 0]).astype(np.int64)
    b = ((index % columns + 0.5) * cells[:, 1] / columns).astype(np.int64)
    return mesh.leaf[mesh.table_start[side] + a * cells[:, 1] + b]


def spread(known, value, wanted, axes, neighbours=9):
    """Values at scattered points of planes, by a local linear fit through the nearest known ones.

    known : (N, 4), wanted : (M, 4)  local position, and FAR times a number of the plane: planes do not mix
    value : (N, C);  axes : (M, 2, 3) of the wanted point's plane
    """
    from scipy.spatial import cKDTree

    if len(known) == 0 or len(wanted) == 0:
        return np.zeros((len(wanted), value.shape[1]))
    distance, near = cKDTree(known).query(wanted, k=min(neighbours, len(known)))
    distance, near = distance.reshape(len(wanted), -1), near.reshape(len(wanted), -1)
    return kernels.fit(known[:, :3], value, wanted[:, :3], np.ascontiguousarray(axes), near, distance)
