"""Indirect light at the pixels.

It is smooth, so it is gathered by many rays at few places: the leaves of one quadtree over the picture for each facet,
finer near contacts, and where neighbours cannot foretell it.
"""

from __future__ import annotations

import numpy as np

from lib.light.surface import Surface
from lib.picture import indirect_kernels as kernels
from lib.picture.leaves import Leaves, block_means, neighbourhoods, pixel_blocks
from lib.picture.light_map import LightMap
from lib.picture.pixels import Pixels
from lib.picture.ray_light import gathered_light


def gather(
    surface: Surface,
    shown: LightMap,
    lamps,
    E,
    pixels: Pixels,
    total_direct,
    *,
    n_rays=256,
    contact=0.35,
    tolerance=0.01,
    trace=None,
) -> Leaves:
    """Indirect light at the leaves, refined from blocks of a 15th of the picture down to 2 px.

    total_direct : (M, C) direct irradiance of the pixels, the scale of what an error means
    n_rays : rays in the end at a leaf an eighth as wide as the largest; twice as many at one twice as wide, because the
        noise of a wide leaf is a blotch, that of a narrow one is not seen and averages out
    contact : a leaf wider than this times the harmonic mean distance of what it sees is split
    tolerance : and one whose light its neighbours do not foretell to this share of its total light
    trace : called at each level with the number of places and the foretold_error, the root mean square of that share
    """

    def look(first, last, n_rays, seed):
        side = pixels.side[first]
        return gathered_light(surface, shown, lamps, E, pixels.p, first, last, side, n_rays, seed)

    brightness = total_direct.mean(axis=1)
    how = {"n_rays": n_rays, "contact": contact, "tolerance": tolerance, "trace": trace}
    return gather_by(look, shown.rho, pixels, brightness, **how)


def _as_it_is(irradiance):
    return irradiance


def gather_by(
    look, rho, pixels: Pixels, brightness, *, n_rays, contact, tolerance, trace=None, judged=_as_it_is, told=_as_it_is
) -> Leaves:
    """The same for any light at the pixels.

    look : (first, last, rays of each, seed) of K blocks of pixels -> light (K, C), half the difference of the two
        halves of the rays (K, C), distance (K,) of what is seen
    rho : (F, C) of the facets, which say where no light matters;  brightness : (M,) what an error is a share of, beside
        the light itself
    judged : of light (K, C), the part (K, c) that must be foretold;  told : the part whose noise is that of the leaves
    """
    smallest, largest = 1, max(2, round(np.log2(max(min(pixels.number.shape) / 15, 1))))
    few = max(16, n_rays // 2)
    gathered = lambda blocks, level: _gathered(look, pixels, *blocks, level, few)
    blocks = pixel_blocks(pixels, np.zeros(1, np.int64), np.array([len(pixels)]), largest)
    done = None
    for level in range(largest, smallest - 1, -1):
        fresh = gathered(blocks, level)
        everything = fresh if done is None else Leaves.joined(done, fresh)
        weight = everything.last - everything.first
        error, noise = _foretold_error(everything, pixels, brightness, judged)
        if trace and len(weight):
            trace(places=len(everything), foretold_error=float(np.sqrt(np.average(error**2, weights=weight))))
        split = everything.extent > contact * everything.distance
        split |= error > np.maximum(tolerance, noise)
        split &= (everything.level == level) & (weight > 4) & (level > smallest)
        done = everything[~split]
        if not split.any():
            break
        blocks = pixel_blocks(pixels, everything.first[split], everything.last[split], level - 1)
    done = _evened_out(done, pixels, gathered)
    _finish(look, rho, pixels, done, brightness, n_rays, largest, told)
    return done


def _foretold_error(leaves, pixels, brightness, judged):
    """(K,) by how much neighbours fail to foretell each leaf's light, and 3 sigma of its noise; shares of its light."""
    weight = leaves.last - leaves.first
    _, foretold = neighbourhoods(leaves, pixels.facet[leaves.first])
    total = block_means(brightness, leaves.first, leaves.last) + leaves.irradiance.mean(axis=1)
    floor = 0.05 * np.average(total, weights=weight) if len(weight) else 0.0
    light = np.maximum(total + floor, 1e-300)
    return np.abs(judged(foretold - leaves.irradiance)).mean(axis=1) / light, 3 * leaves.noise / light


def _evened_out(leaves, pixels, gathered):
    """Split leaves beside others a quarter as wide or less, until there are none: local fits would lean."""
    while len(leaves):
        split = kernels.lowest_beside(leaves.arrays, pixels.arrays) < leaves.level - 1
        if not split.any():
            break
        fresh = []
        for level in np.unique(leaves.level[split]):
            now = split & (leaves.level == level)
            fresh.append(gathered(pixel_blocks(pixels, leaves.first[now], leaves.last[now], level - 1), level - 1))
        leaves = Leaves.joined(leaves[~split], *fresh)
    return leaves


def _finish(look, rho, pixels, leaves, brightness, n_rays, largest, told):
    """The final rays, in place, and their noise.

    Facets whose light comes from few directions (dark ones before a bright gap) get up to four times as many rays,
    those of even light fewer, and those that reflect nothing next to none.
    """
    if not len(leaves):
        return
    facet, weight = pixels.facet[leaves.first], (leaves.last - leaves.first).astype(float)
    total = block_means(brightness, leaves.first, leaves.last) + leaves.irradiance.mean(axis=1)
    noise = (leaves.noise / np.maximum(total, 1e-300)) ** 2
    mean = np.bincount(facet, weight * noise) / np.maximum(np.bincount(facet, weight), 1)
    share = np.clip((np.sqrt(mean) / 0.015) ** (4 / 3), 0.5, 4.0)  # an error falls as rays ** -0.75
    share = np.where(rho[: len(share)].max(axis=1) > 0, share, 0)[facet]
    wanted = n_rays * 2.0 ** (leaves.level - largest + 3) * share
    leaves.rays[:] = 2 ** np.clip(np.round(np.log2(np.maximum(wanted, 16))), 4, 16).astype(int)
    for n in np.unique(leaves.rays):
        mine = np.flatnonzero(leaves.rays == n)
        first, last = leaves.first[mine], leaves.last[mine]
        leaves.irradiance[mine], half, _ = look(first, last, int(n), 950 + int(n))
        leaves.noise[mine] = np.abs(told(half)).mean(axis=1)


def _gathered(look, pixels, first, last, level, n_rays) -> Leaves:
    total, half, distance = look(first, last, n_rays, 900 + level)
    q = np.stack(
        [block_means(pixels.x.astype(float), first, last), block_means(pixels.y.astype(float), first, last)], axis=1
    )
    low, high = kernels.bounds(pixels.p, first, last)
    extent = np.linalg.norm(high - low, axis=1)
    noise = np.abs(half).mean(axis=1)
    return Leaves(
        first, last, np.full(len(first), level), q, extent, total, distance, noise, np.full(len(first), n_rays)
    )
