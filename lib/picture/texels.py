"""The light map made: direct light evaluated again at each texel, indirect light fitted through the patches and gathered once more by rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.cells import Mesh
from lib.light.surface import Surface
from lib.picture import texels_kernels as kernels
from lib.picture.light_map import LightMap
from lib.picture.pixels import facet_triangles
from lib.picture.ray_light import gathered_light

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
    texels=TEXELS,
    samples=32,
    n_rays=64,
    ways=None,
) -> LightMap:
    """Reflected radiosity of every side that has patches, direct light from the lamps and not from the patches.

    lamps : from lamps.emitters;  E : (L, C);  indirect : (N, C) what others send to the patches
    exposed : (N,) share of each patch outside solids;  rho_facet : (F, C)
    """
    sides = np.unique(mesh.side)
    size = surface.size[sides // 2]
    step = np.sqrt(max(size.prod(axis=1).sum(), 1e-300) / texels)
    count = np.clip(np.ceil(size / step), 3, 4096).astype(
        np.int64
    )  # of a rim half inside a solid at least one lies outside
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
    normals = surfaces.side_normals(surface)

    good = kernels.within(p, f, *facet_triangles(surface), normals[2 * f])
    good &= ~surfaces.covered(surface, p, normals[side])
    at, fill = (
        np.flatnonzero(good),
        kernels.nearest(good, start[sides], count),
    )  # texels outside the facet or inside a solid take another's value
    irradiance = np.zeros((len(p), E.shape[1]), np.float32)
    whole = np.zeros((len(p), len(lamps)), np.float32)
    for k, lamp in enumerate(lamps):
        one = [replace(lamp, lamp=0)]
        whole[at, k] = lamps_.direct(surface, one, p[at], normals, side[at], 1, n_samples=1, shadows=False)[:, 0]
        seen = (
            lamps_.direct(surface, one, p[at], normals, side[at], 1, n_samples=samples, seed=71 + k)
            if surface.n_occluders or lamp.mirrors
            else whole[at, k : k + 1]
        )
        irradiance[at] += seen * E[lamp.lamp]
    lit = np.flatnonzero(exposed > 0)
    place, places = (
        np.hstack([p[at], kernels.FAR * side[at, None]]),
        np.hstack([mesh.centre[lit], kernels.FAR * mesh.side[lit, None]]),
    )
    between = np.zeros((len(p), E.shape[1]), np.float32)
    rest, patch = indirect, _patch_at(mesh, side[at], index[at], shape, mesh.table_shape[side[at]])
    number = np.maximum(np.bincount(np.maximum(patch, 0), patch >= 0, len(mesh)), 1)[:, None]
    for _ in range(3):
        # a fit through hollow or domed light lies above or below it: what a patch lacks on average is added until it agrees
        between[at] += spread(places, rest[lit], place, surface.axes[f[at]])
        found = (
            np.stack(
                [
                    np.bincount(np.maximum(patch, 0), np.where(patch >= 0, between[at, c], 0), len(mesh))
                    for c in range(E.shape[1])
                ],
                axis=1,
            )
            / number
        )
        rest = np.where((np.bincount(np.maximum(patch, 0), patch >= 0, len(mesh)) > 0)[:, None], indirect - found, 0)
    between = np.maximum(between, 0)
    irradiance, whole = irradiance[fill], whole[fill]
    rho = rho_facet.astype(np.float32)
    first = irradiance * rho[f]
    if n_rays:
        # once more by rays: the light that the patches pass on is then as sharp as the texels, not as the patches
        once = LightMap(
            start,
            shape,
            first + between[fill] * rho[f],
            irradiance,
            good,
            first,
            between,
            whole,
            float(step),
            rho,
            ways,
        )
        ones = np.arange(len(at))
        between[at] = gathered_light(surface, once, lamps, E, p[at], ones, ones + 1, side[at], n_rays, 650)[0]
    between = between[fill]
    return LightMap(
        start,
        shape,
        first + between * rho[f],
        irradiance + between,
        good,
        first,
        between,
        whole,
        float(step),
        rho,
        ways,
    )


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
