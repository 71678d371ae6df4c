"""Where patches are made smaller: where patch-constant light would be wrong.

A cell is split where its quadrants are unevenly lit (shadow edges, contacts, gaps), measured with the rays of a first coarse
balance. It stays coarse where the light is smooth.
"""

from __future__ import annotations

import numpy as np

from lib.given.rays import shifts, sobol
from lib.light import adapt_kernels
from lib.light import form_factors_kernels as kernels
from lib.light.cells import Mesh, Tree
from lib.light.form_factors import CHUNK, counted, trace
from lib.light.lamps import direct
from lib.light.surface import Surface, facet_areas, side_normals, start_inside


def probe(surface: Surface, mesh: Mesh, *, n_rays, seed=0):
    """Share of each patch's rays that meet the lit side of something, (N,)."""
    points, shift = sobol(n_rays), shifts(len(mesh), n_rays, seed + 1000)
    seen = np.zeros(len(mesh))
    step = max(1, CHUNK // n_rays)
    for a in range(0, len(mesh), step):
        b = min(len(mesh), a + step)
        r = kernels.patch_rays(
            a,
            b,
            n_rays,
            points,
            shift,
            mesh.side,
            mesh.tri_start,
            mesh.tri_uv,
            mesh.tri_cdf,
            surface.origin,
            surface.axes,
            surface.normal,
        )
        triangle, _ = surface.caster.closest(r)
        seen[a:b] = ((triangle >= 0) & ~start_inside(surface, r, triangle)).reshape(-1, n_rays).mean(axis=1)
    return seen


def light_spread(surface: Surface, mesh: Mesh, middle, lamps, *, n_rays, seed=0):
    """How unevenly each patch is lit: mean irradiance (N,) and the standard deviation between the means of its four
    quadrants (N,), sampling noise taken off, in a scene of reflectance 0.5 with all lamps at equal power.

    middle : (N, 2) where the cells would be split, facet coordinates
    """
    from lib.light import radiosity

    n_lamps = 1 + max(lamp.lamp for lamp in lamps)
    n_points = min(16, n_rays)
    ray_start = np.arange(len(mesh) + 1, dtype=np.int64) * n_rays
    points, shift = sobol(n_rays), shifts(len(mesh), n_rays, seed)
    rays_, hits = [], []
    step = max(1, CHUNK // n_rays)
    for a in range(0, len(mesh), step):
        r = kernels.patch_rays(
            a,
            min(len(mesh), a + step),
            n_rays,
            points,
            shift,
            mesh.side,
            mesh.tri_start,
            mesh.tri_uv,
            mesh.tri_cdf,
            surface.origin,
            surface.axes,
            surface.normal,
        )
        rays_.append(r)
        hits.append(trace(surface, mesh, r)[0])
    r, hit = np.concatenate(rays_), np.concatenate(hits)
    rows = counted(hit, ray_start, 0, len(mesh), len(mesh))
    # direct light at the starts of the first rays of each patch
    first = (np.arange(len(mesh))[:, None] * n_rays + np.arange(n_points)).ravel()
    factor = direct(
        surface,
        lamps,
        r[first, :3].astype(float),
        side_normals(surface),
        np.repeat(mesh.side, n_points),
        n_lamps,
        n_samples=4,
        seed=seed,
    ).sum(axis=1)
    is_open = hit[first] != kernels.DROPPED
    D = np.bincount(np.repeat(np.arange(len(mesh)), n_points), factor * is_open, minlength=len(mesh)) / np.maximum(
        is_open.reshape(-1, n_points).sum(axis=1), 1
    )
    F = rows.matrix()
    b, _, _ = radiosity.gmres(
        lambda X: X - np.float32(0.5) * (F @ X), (0.5 * D[:, None]).astype(np.float32), tolerance=1e-3
    )
    mean = np.full((len(mesh), 4), np.nan)
    noise = np.full((len(mesh), 4), np.nan)
    adapt_kernels.quadrants(
        r, n_rays, hit, b[:, 0].astype(float), mesh.side, middle, surface.origin, surface.axes, mean, noise
    )
    relative = r[first, :3] - surface.origin[mesh.side // 2].repeat(n_points, axis=0)
    axes = surface.axes[mesh.side // 2].repeat(n_points, axis=0)
    at = np.einsum("nd,nad->na", relative, axes) > middle.repeat(n_points, axis=0)
    cell = 4 * np.repeat(np.arange(len(mesh)), n_points) + 2 * at[:, 0] + at[:, 1]
    count = np.bincount(cell, is_open, minlength=4 * len(mesh)).reshape(-1, 4)
    total = np.bincount(cell, factor * is_open, minlength=4 * len(mesh)).reshape(-1, 4)
    mean += np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    known = np.isfinite(mean)
    several = known.sum(axis=1) >= 2
    middle_value = np.where(known, mean, 0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    spread = (np.where(known, mean - middle_value[:, None], 0) ** 2 - np.where(known, noise, 0)).sum(
        axis=1
    ) / np.maximum(known.sum(axis=1), 1)
    return D + F @ b[:, 0], np.where(several, np.sqrt(np.maximum(spread, 0)), 0)


def live_sides(surface: Surface) -> np.ndarray:
    """Sides that can receive light: not inside a solid, and seeing something. (S,) int."""
    candidates = np.flatnonzero(~surface.inside)
    tree = Tree(surface, candidates, coarse=float(surface.size.max()) / 4)
    mesh = tree.mesh()
    seen = probe(surface, mesh, n_rays=32)
    return np.unique(mesh.side[seen > 0])


def build(surface: Surface, *, patches, max_level, contrast, emitters=(), n_rays=64, uniform=False) -> Mesh:
    """Cut the lit sides into about `patches` root cells (in area), then refine where the light is uneven.

    patches : root cells if all cells had equal area; a small facet always has at least one
    max_level : times a root cell may be halved
    contrast : split a cell if area x (standard deviation of the irradiance between its quadrants) exceeds this
               share of the mean irradiance of the scene times the mean area of a root cell
    uniform : no adaptation; every root cell is halved `max_level` times (for comparison)
    """
    sides = live_sides(surface)
    if len(sides) == 0:
        raise ValueError("no facet sees another: there is no light to balance")
    area = float(facet_areas(surface)[sides // 2].sum())
    tree = Tree(surface, sides, np.sqrt(area / patches))
    for level in range(max_level):
        flags = np.ones(len(tree.leaves), bool)
        if not uniform:
            if not emitters:
                break
            tree.sort()
            mesh = tree.mesh()
            cells = tree.cells()
            middle = (cells[:, 1:3] + cells[:, 3:5]) / 2
            mean, spread = light_spread(surface, mesh, middle, emitters, n_rays=n_rays, seed=level)
            yardstick = float((mean * mesh.area).sum() / area) * area / patches
            flags = (mesh.area * spread > contrast * yardstick) & (tree.leaves[:, 1] == level)
        if not flags.any():
            break
        tree.split(flags)
    tree.sort()
    return tree.mesh()
