"""Direct light at the pixels: the exact factor of the lamp's polygon times its visible share.

The share comes from shadow rays from all over the pixel: few everywhere, and many where neighbouring pixels disagree
(penumbra).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.given.rays import shifts, sobol
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.form_factors import CHUNK
from lib.light.surface import Surface
from lib.picture import pixel_light_kernels as kernels
from lib.picture.leaves import Leaves, block_means, interpolated, pixel_blocks
from lib.picture.pixels import Pixels, facet_triangles, viewer

MANY = 16  # triangles of a lamp above which its light is interpolated between pixels


def direct(surface: Surface, lamps, n_lamps, pixels: Pixels, camera, *, few=4, many=64, steady=False) -> tuple:
    """Factor of each pixel to each lamp with soft shadows, (M, L), and how many pixels lay in a penumbra.

    The exact factor of the lamp's polygon at the pixel's centre times its visible share, from shadow rays that begin
    all over the pixel: a shadow narrower than a pixel darkens it in proportion.
    few : shadow rays per pixel and emitter everywhere;  many : where the pixels of a 5 x 5 neighbourhood disagree
    steady : the same rays at a pixel whichever of the others lie in shadow
    """
    factor = np.zeros((len(pixels), n_lamps))
    normals = surfaces.side_normals(surface)
    arrays = pixels.arrays
    scene = (arrays, viewer(surface, camera), facet_triangles(surface), surface.arrays)
    uncertain = 0
    for number, lamp in enumerate(lamps):
        whole = _whole(surface, lamp, pixels, normals)
        if surface.n_occluders == 0 and not lamp.mirrors:
            factor[:, lamp.lamp] += whole
            continue
        lit = np.flatnonzero(whole > 0)
        visible = np.zeros(len(pixels))
        visible[lit] = _visible(surface, lamp, scene, lit, few, number, steady)
        penumbra = np.flatnonzero(kernels.disagree(visible, whole > 0, arrays))
        uncertain += len(penumbra)
        if len(penumbra):
            visible[penumbra] = _visible(surface, lamp, scene, penumbra, many, number + 500, steady)
            visible[penumbra] = kernels.smoothed(visible, penumbra, arrays, 0.7 / many**0.75)
        factor[:, lamp.lamp] += whole * visible
    return factor, uncertain


def _whole(surface, lamp, pixels, normals):
    """Factor of each pixel to a lamp if nothing stood in between, (M,).

    Exact; for a lamp of many triangles or with a lobe exact at the middles of blocks of 4 x 4 pixels, and interpolated
    between.
    """
    one = [replace(lamp, lamp=0)]
    if (len(lamp.corners) <= MANY and not lamp.has_lobe) or not len(pixels):
        return lamps_.direct(surface, one, pixels.p, normals, pixels.side, 1, n_samples=1, shadows=False)[:, 0]
    first, last = pixel_blocks(pixels, np.zeros(1, np.int64), np.array([len(pixels)]), 2)
    p = np.stack([block_means(pixels.p[:, d], first, last) for d in range(3)], axis=1)
    factor = lamps_.direct(surface, one, p, normals, pixels.side[first], 1, n_samples=1, shadows=False)
    q = np.stack([block_means(v.astype(float), first, last) for v in (pixels.x, pixels.y)], axis=1)
    nothing = np.zeros(len(first))
    blocks = Leaves(first, last, np.full(len(first), 2), q, nothing, factor, nothing, nothing, nothing)
    return interpolated(blocks, pixels)[:, 0]


def _visible(surface, lamp, scene, which, n, seed, steady):
    """Share of the lamp's light that reaches each pixel of `which`, from n shadow rays.

    scene : PixelArrays, Viewer, Triangles, SurfaceArrays
    """
    sequence = sobol(n)
    share = np.zeros(len(which))
    step = max(1, CHUNK // n)
    for a in range(0, len(which), step):
        some = which[a : a + step]
        shift = shifts(some if steady else len(some), n, seed)
        rays, weight = kernels.shadow_rays(some, sequence, shift, *scene, lamp.arrays)
        share[a : a + step] = kernels.visible_share(weight, ~lamps_.reached(surface, lamp, rays))
    return share
