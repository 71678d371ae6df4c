"""Mixed pixels: the A-buffer's fragments, lit where they are seen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lib.given.rays import shifts, sobol
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.form_factors import CHUNK
from lib.light.surface import Surface, backproject
from lib.picture import fragments_kernels as kernels
from lib.picture.fragments_kernels import MixedPixels, SubPixels
from lib.picture.pixels import viewer


@dataclass(frozen=True)
class Fragments:
    """The A-buffer: what pixels show that hold more than one facet.

    pixel : (P,) flat index;  start : (P + 1,) into the fragments;  facet, side : (S,);  share : (S,) of the pixel
    p : (S, 3) local, the middle of what is seen of it;  seen : (S,) bool, a sub-pixel shows it
    owner : (P * 64,) the fragment that each sub-pixel shows, -1;  at : (P * 64, 3) local, where
    """

    pixel: np.ndarray
    start: np.ndarray
    facet: np.ndarray
    side: np.ndarray
    share: np.ndarray
    p: np.ndarray
    owner: np.ndarray
    at: np.ndarray
    seen: np.ndarray


def fragments(surface: Surface, camera, coverage) -> Fragments:
    """Where the camera sees each fragment, by rays through the 8 x 8 sub-pixels.

    coverage : {pixel, start, facet, count of 64}, see lib/buffers/coverage.py
    """
    pixel, start = np.asarray(coverage["pixel"], np.int64), np.asarray(coverage["start"], np.int64)
    facet = np.asarray(coverage["facet"], np.int32)
    p, side = backproject(surface, camera, facet, np.repeat(pixel, np.diff(start)))
    owner, at = np.full(64 * len(pixel), -1, np.int32), np.zeros((64 * len(pixel), 3))
    mixed, eye = MixedPixels(pixel, start, facet, camera.width), viewer(surface, camera)
    for a in range(0, len(owner), CHUNK):
        rays = kernels.sub_rays(a, min(len(owner), a + CHUNK), mixed, eye)
        triangle, _ = surface.caster.closest(rays)
        kernels.sort_out(a, triangle, mixed, eye, surface.arrays, owner, at)
    mine = owner >= 0
    number = np.bincount(owner[mine], minlength=len(facet))
    for d in range(3):
        mean = np.bincount(owner[mine], at[mine, d], len(facet)) / np.maximum(number, 1)
        p[:, d] = np.where(number > 0, mean, p[:, d])
    return Fragments(pixel, start, facet, side, np.asarray(coverage["count"], float) / 64, p, owner, at, number > 0)


def fragment_direct(surface: Surface, lamps, n_lamps, fragments: Fragments, rays_each=2, steady=False):
    """Factor of each fragment to each lamp (S, L), by shadow rays from each sub-pixel.

    A shadow in the corner beside a thin board is darker in the pixel where it lies than anywhere else.
    steady : the same rays in a pixel whatever other pixels are mixed
    """
    factor = np.zeros((len(fragments.facet), n_lamps))
    normals = surfaces.side_normals(surface)
    # the sub-pixels of a fragment, in an order of no direction, take one point after the other of one good set
    which = np.flatnonzero(fragments.owner >= 0)
    which = which[np.lexsort((which * 37 % 64, fragments.owner[which]))]
    rank = np.arange(len(which)) - np.searchsorted(fragments.owner[which], fragments.owner[which])
    blocks = np.repeat(fragments.pixel, np.diff(fragments.start)) if steady else len(fragments.facet)
    sequence, shift = sobol(64 * rays_each), shifts(blocks, 64 * rays_each, 77)
    rank = np.repeat(rank * rays_each, rays_each) + np.tile(np.arange(rays_each), len(which))
    which = np.repeat(which, rays_each)
    places = SubPixels(fragments.owner, fragments.at, fragments.side)
    for lamp in lamps:
        whole = lamps_.direct(
            surface, [replace(lamp, lamp=0)], fragments.p, normals, fragments.side, 1, n_samples=1, shadows=False
        )[:, 0]
        if (surface.n_occluders or lamp.mirrors) and len(which):
            total, seen = np.zeros(len(whole)), np.zeros(len(whole))
            for a in range(0, len(which), CHUNK):
                some = which[a : a + CHUNK]
                rays, weight = kernels.fragment_rays(
                    some, rank[a : a + CHUNK], sequence, shift, places, surface.arrays, lamp.arrays
                )
                visible = lamps_.reached(surface, lamp, rays)
                owner = fragments.owner[some]
                total += np.bincount(owner, weight, len(whole))
                seen += np.bincount(owner, weight * visible, len(whole))
            whole = whole * np.divide(seen, total, out=np.zeros_like(seen), where=total > 0)
        factor[:, lamp.lamp] += whole
    return factor


def beside(values, facet, fragments: Fragments):
    """(S, C) the mean of `values` (H, W, C) over the nearest pixels of each fragment's facet; (S,) if there are any.

    facet : (H, W), -1;  pixels are looked for up to three away
    """
    mixed = MixedPixels(fragments.pixel, fragments.start, fragments.facet, facet.shape[1])
    return kernels.beside(values, facet, mixed)
