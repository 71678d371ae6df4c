"""Where patches are made smaller: where patch-constant light would be wrong.

A cell is split where its quadrants are unevenly lit (shadow edges, contacts, gaps), measured with the rays of a first
coarse balance. It stays coarse where the light is smooth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lib.given.rays import shifts, sobol
from lib.light import adapt_kernels as kernels
from lib.light import clusters, form_factors
from lib.light.balance import reflected
from lib.light.cells import Mesh, Tree
from lib.light.cells_kernels import sides_of_points
from lib.light.form_factors import chunks, counted, from_patches
from lib.light.form_factors_kernels import DROPPED
from lib.light.lamps import direct
from lib.light.surface import Surface, facet_areas, side_normals, start_inside

# Of a patch, to tell where it is unevenly lit. With 64 their noise chose patches: from draw to draw gamma changed by
# .0058 (office-2) and .019 (gallery-white); .0022 and .0095 with 256, for .6 CPU s in 7 (docs/verify.md)
RAYS = 256


def probe(surface: Surface, mesh: Mesh, *, n_rays, seed=0):
    """Share of each patch's rays that meet the lit side of something, (N,)."""
    ray_start, make = from_patches(surface, mesh, n_rays, seed + 1000)
    seen = np.zeros(len(mesh))
    for first, last in chunks(ray_start):
        rays = make(first, last)
        triangle, _ = surface.caster.closest(rays)
        lit = (triangle >= 0) & ~start_inside(surface, rays, triangle)
        seen[first:last] = lit.reshape(-1, n_rays).mean(axis=1)
    return seen


def light_spread(surface: Surface, mesh: Mesh, middle, lamps, *, n_rays, seed=0):
    """How unevenly each patch is lit, in a scene of reflectance 0.5 with all lamps at equal power.

    middle : (N, 2) where the cells would be split, facet coordinates
    Returns the mean irradiance (N,), and the standard deviation between the means of its four quadrants (N,), sampling
    noise taken off.
    """
    ray_start, make = from_patches(surface, mesh, n_rays, seed)
    parts = [(rays, form_factors.trace(surface, mesh, rays)) for rays in (make(*chunk) for chunk in chunks(ray_start))]
    rays, hit = (np.concatenate(part) for part in zip(*parts, strict=True))
    rows = counted(hit, ray_start, 0, len(mesh), len(mesh))
    by_lamps = _direct_light(surface, mesh, middle, lamps, rays, hit, n_rays, seed)
    F = rows.matrix()
    b = reflected([F], 0.5, 0.5 * by_lamps.mean[:, None], tolerance=1e-3).b
    mean, noise = kernels.quadrants(rays, n_rays, hit, b[:, 0].astype(float), mesh.side, middle, surface.arrays)
    mean += by_lamps.quadrants
    known = np.isfinite(mean)
    number = np.maximum(known.sum(axis=1), 1)
    centre = np.where(known, mean, 0).sum(axis=1) / number
    square = np.where(known, mean - centre[:, None], 0) ** 2 - np.where(known, noise, 0)
    variance = square.sum(axis=1) / number
    several = known.sum(axis=1) >= 2
    return by_lamps.mean + F @ b[:, 0], np.where(several, np.sqrt(np.maximum(variance, 0)), 0)


class DirectLight(NamedTuple):
    """mean : (N,) factor of each patch to all lamps;  quadrants : (N, 4), NaN where no ray starts"""

    mean: np.ndarray
    quadrants: np.ndarray


def _direct_light(surface, mesh, middle, lamps, rays, hit, n_rays, seed) -> DirectLight:
    """The lamps' light where the first rays of each patch start."""
    N, n = len(mesh), min(16, n_rays)
    first = (np.arange(N)[:, None] * n_rays + np.arange(n)).ravel()
    start = rays[first, :3]
    n_lamps = 1 + max(lamp.lamp for lamp in lamps)
    side = sides_of_points(n, sobol(n_rays)[:n], shifts(N, n_rays, seed), mesh.pieces)
    factor = direct(
        surface, lamps, start.astype(float), side_normals(surface), side, n_lamps, n_samples=4, seed=seed
    ).sum(axis=1)
    is_open = hit[first] != DROPPED
    patch = np.repeat(np.arange(N), n)
    mean = np.bincount(patch, factor * is_open, minlength=N) / np.maximum(is_open.reshape(-1, n).sum(axis=1), 1)
    relative = start - surface.origin[mesh.side // 2].repeat(n, axis=0)
    axes = surface.axes[mesh.side // 2].repeat(n, axis=0)
    beyond = np.einsum("nd,nad->na", relative, axes) > middle.repeat(n, axis=0)
    cell = 4 * patch + 2 * beyond[:, 0] + beyond[:, 1]
    count = np.bincount(cell, is_open, minlength=4 * N).reshape(-1, 4)
    total = np.bincount(cell, factor * is_open, minlength=4 * N).reshape(-1, 4)
    return DirectLight(mean, np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


def live_sides(surface: Surface) -> np.ndarray:
    """Sides that can receive light: not inside a solid, and seeing something. (S,) int."""
    return sees_something(surface, np.flatnonzero(~surface.inside))


def sees_something(surface: Surface, candidates) -> np.ndarray:
    """Those of some sides (n,) from which something is seen. (S,) int."""
    if not len(candidates):
        return np.zeros(0, int)
    tree = Tree(surface, candidates, coarse=float(surface.size.max()) / 4)
    mesh = tree.mesh()
    seen = probe(surface, mesh, n_rays=32)
    return np.unique(mesh.side[seen > 0])


def build(
    surface: Surface, *, patches, max_level, contrast, emitters=(), n_rays=RAYS, uniform=False, trace=None
) -> Mesh:
    """Cut the lit sides into about `patches` root cells (in area), then refine where the light is uneven.

    patches : root cells if all cells had equal area; a small facet always has at least one
    max_level : times a root cell may be halved
    contrast : split a cell if area x (standard deviation of the irradiance between its quadrants) exceeds this
               share of the mean irradiance of the scene times the mean area of a root cell
    uniform : no adaptation; every root cell is halved `max_level` times (for comparison)
    trace : called at each level with the state of the mesh, see `_state`

    Raises ValueError, in one line, where no facet sees another.
    """
    sides = live_sides(surface)
    if len(sides) == 0:
        raise ValueError("no facet sees another: there is no light to balance")
    area = float(facet_areas(surface)[sides // 2].sum())
    tree = Tree(surface, sides, np.sqrt(area / patches), clustered=len(sides) > clusters.MANY and not uniform)
    for level in range(max_level):
        if uniform:
            flags = np.ones(len(tree.leaves), bool)
        elif emitters:
            flags = _uneven(surface, tree, level, emitters, n_rays, contrast, area, patches, trace)
        else:
            break
        if not flags.any():
            break
        tree.split(flags)
    tree.sort()
    return tree.mesh()


def _uneven(surface, tree, level, emitters, n_rays, contrast, area, patches, trace):
    """(n,) bool: the leaves of this level to be split; the tree is sorted."""
    tree.sort()
    mesh = tree.mesh()
    mean, spread = light_spread(surface, mesh, tree.middles(mesh), emitters, n_rays=n_rays, seed=level)
    if trace is not None:
        trace(**_state(mesh, mean, spread))
    yardstick = float((mean * mesh.area).sum() / area) * area / patches
    uneven = mesh.area * spread > contrast * yardstick
    return uneven[tree.element] & (np.where(tree.clusters == clusters.NONE, tree.leaves[:, 1], tree.clusters) == level)


def _state(mesh, mean, spread):
    """patches : their number;  unevenness : what patches of constant light lose, the mean over their area of the
    standard deviation between the quadrants of a patch, as a share of the mean irradiance"""
    light = float((mesh.area * mean).sum())
    return {"patches": len(mesh), "unevenness": float((mesh.area * spread).sum()) / light if light > 0 else 0.0}
