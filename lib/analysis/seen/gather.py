"""The light that each part of the photograph receives: tiles of its pixels as receivers (gathering).

A tile is a square block of the photograph's pixels on one facet. Its direct light is the mean over its pixels of the
exact lamp factors with shadows. Its indirect light is one row of form factors, whose rays start at the tile's own
pixels. So patch-constant light enters only at the second bounce, and a change of reflectance costs one small linear
solve and no ray.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from lib.buffers.edges import boundary
from lib.buffers.trust import in_blocks
from lib.core import arrays, artefact
from lib.core.arrays import Flag, Real, Starts, Whole
from lib.given.transfer import Transfer
from lib.given.view import View
from lib.given.white_level import is_twelve_bits
from lib.light import factors_file, form_factors, lamps, outside
from lib.light import surface as surfaces
from lib.light.cells import Mesh
from lib.light.factors_file import FormFactors
from lib.light.form_factors import FormFactorRows
from lib.light.surface import Surface, backproject, side_normals

MOST_RAYS = 4096  # from one tile


@dataclass(frozen=True, eq=False)
class Tiles:
    """T tiles of M pixels, L lamps, N patches.

    facet : (T,) int32;  start : (T + 1,) int64 into pixel;  pixel : (M,) int64 flat index y * W + x, tile by tile
    direct : (T, L) mean factor to each lamp, shadows included;  rows : (T, N) indirect light
    """

    facet: np.ndarray
    start: np.ndarray
    pixel: np.ndarray
    direct: np.ndarray
    rows: FormFactorRows

    def __len__(self):
        return len(self.facet)

    def take(self, which) -> Tiles:
        """The tiles numbered `which`."""
        start = np.concatenate([[0], np.cumsum(np.diff(self.start)[which])])
        pixel = self.pixel[form_factors.elements(self.start, which)]
        return Tiles(self.facet[which], start, pixel, self.direct[which], self.rows.take(which))


@dataclass(frozen=True)
class Sampling:
    """How finely light is gathered.

    rays_per_tile, rays_per_facet : at least so many from each;  lamp_samples : of `samples_per_pixel`, to each lamp
    tiles_per_facet : about so many;  largest, smallest : side of a tile, in diagonals of the picture

    So a larger picture has tiles of more pixels, and as many.
    """

    rays_per_tile: int = 512
    rays_per_facet: int = 32768
    lamp_samples: int = 4
    tiles_per_facet: int = 24
    largest: float = 1 / 40
    smallest: float = 1 / 200
    seed: int = 5


USUAL_PX = 800  # diagonal of 640 x 480: in smaller pictures, shares are of such a one, since their pixels limit
LAMP_SAMPLES = 64  # of each lamp in a tile at least
# of its light that a tile has from patches beside a gap: tiles in a gap had .6 and more and were wrong by half their
# light, all others had .1 at most and were as right as without a gap (shelves 20 mm apart, boards 3 to 30 mm off)
IN_GAP = 0.3
AUDIT = Sampling(rays_per_tile=128, rays_per_facet=0, lamp_samples=1, tiles_per_facet=60, seed=77)


def samples_per_pixel(lamp_samples, shape) -> int:
    """Shadow rays that a pixel has in a picture (H, W), for as many in a tile: a power of two, at least one.

    lamp_samples : in one of USUAL_PX

    >>> [samples_per_pixel(4, shape) for shape in ((240, 320), (480, 640), (960, 1280), (1920, 2560))]
    [4, 4, 1, 1]
    """
    return 2 ** max(0, round(np.log2(lamp_samples * (USUAL_PX / max(np.hypot(*shape), USUAL_PX)) ** 2)))


def blocks(facet, used, place=None, hand=1, *, largest=1 / 40, smallest=1 / 200, tiles_per_facet=24):
    """Cut the used pixels into square tiles of one facet each, small on small facets.

    Their sides are shares of the picture's diagonal: light changes with the angle, and what is decided by the number of
    tiles shall not hang on that of the pixels.

    facet : (H, W) int, -1 = nothing;  used : (H, W) bool;  place : (F,) of each facet in the order of the tiles
    hand : of the model: tiles are cut from the left, -1: from the right
    Returns facet (T,), start (T + 1,), pixel (M,).
    """
    pixel = np.arange(facet.size).reshape(facet.shape)[:, ::hand]
    facet, used = facet[:, ::hand], used[:, ::hand]
    y, x = np.nonzero(used & (facet >= 0))
    f = facet[y, x].astype(np.int64)
    if len(f) == 0:
        return np.zeros(0, np.int32), np.zeros(1, np.int64), np.zeros(0, np.int64)
    count = np.bincount(f)
    diagonal = max(np.hypot(*facet.shape), USUAL_PX)
    low, high = (round(share * diagonal, 6) for share in (smallest, largest))
    block = np.clip(np.sqrt(count / tiles_per_facet), low, high).astype(np.int64)[f]
    rows, columns = (side // int(low) + 1 for side in facet.shape)
    key = ((f if place is None else place[f]) * rows + y // block) * columns + x // block
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    return (
        f[order][starts].astype(np.int32),
        np.append(starts, len(order)).astype(np.int64),
        pixel[y, x][order],
    )


def pure(photograph, facet):
    """(H, W) bool: pixels that show one facet alone, not black, and not among saturated ones (5 x 5 pixels).

    Beside a highlight's core those pixels that noise kept below saturation would be too dark on average.
    """
    import cv2

    values = photograph.values
    usable = (facet >= 0) & ~boundary(facet)
    if photograph.linear:
        return usable & (values > 0).all(axis=2)
    share = lambda clipped: cv2.blur(clipped.astype(np.float32), (5, 5)) > photograph.spoilt_share + 1e-6
    saturated = (values >= 250 / 255 - 1e-9).any(axis=2)
    black = share(photograph.black) if photograph.noisy else photograph.black
    return usable & ~black & ~share(saturated)


def _direct(surface, emitters, n_lamps, p, side, start, samples, seed):
    """(T, L) direct factors of the tiles: small ones have more samples of the lamps in each pixel."""
    normals = side_normals(surface)
    of = lambda p, side, start, n, numbers: lamps.direct(
        surface, emitters, p, normals, side, n_lamps, n_samples=n, start=start, seed=seed, numbers=numbers
    )
    numbers = lamps.numbered(len(p), start)
    found = of(p, side, start, samples, numbers)
    count = np.diff(start)
    wanted = (2 ** np.ceil(np.log2(LAMP_SAMPLES / np.maximum(count, 1)))).astype(np.int64)
    for n in np.unique(wanted[wanted > samples]):
        few = wanted == n
        mine = np.repeat(few, count)
        found[few] = of(p[mine], side[mine], np.append(0, np.cumsum(count[few])), int(n), numbers[mine])
    return found


def build(
    surface: Surface, mesh: Mesh, camera, facet, used, emitters, n_lamps, sampling: Sampling = Sampling(), progress=None
) -> Tiles:
    """Tiles of the used pixels with their direct factors and form-factor rows.

    facet : (H, W) int, -1 = nothing;  used : (H, W) bool;  emitters : from lamps.emitters
    """
    s = sampling
    tile_facet, start, pixel = blocks(
        facet,
        used,
        surface.place,
        surface.hand,
        largest=s.largest,
        smallest=s.smallest,
        tiles_per_facet=s.tiles_per_facet,
    )
    p, side = backproject(surface, camera, np.repeat(tile_facet, np.diff(start)), pixel)
    samples = samples_per_pixel(s.lamp_samples, facet.shape)
    direct = _direct(surface, emitters, n_lamps, p, side, start, samples, s.seed - 5)
    tiles_of = np.zeros(0, int)
    if len(tile_facet):
        tiles_of = np.bincount(tile_facet, minlength=len(surface.normal))[tile_facet]
    wanted = np.minimum(np.maximum(s.rays_per_tile, s.rays_per_facet / np.maximum(tiles_of, 1)), MOST_RAYS)
    n_rays = (2 ** np.ceil(np.log2(wanted))).astype(np.int64)
    first = start[:-1]
    rows = form_factors.gather(
        surface, mesh, p, start, side[first] if len(first) else side, n_rays, seed=s.seed, progress=progress
    )
    return Tiles(tile_facet, start, pixel, direct, rows)


# -- gather.npz, audit.npz


@dataclass(frozen=True, eq=False)
class Gathered:
    """What gather.npz holds: the tiles, the photograph's pixels in them, and which groups the photograph shows.

    pixels : (M, C) display values (linear: EXR), in the order of tiles.pixel;  group, object : (T,) int32
    visible : (G,) pixels that show each group, used or not;  linear : the photograph is linear (EXR)
    block_noise : of a JPEG, see Blocks;  edge_noise : (T,) the same of a pixel, where an edge runs through its block
    colour_noise : (C,) the same that all tiles of one colour have in common
    noisy : of Photograph
    """

    tiles: Tiles
    pixels: np.ndarray
    group: np.ndarray
    object: np.ndarray
    visible: np.ndarray
    linear: bool
    channels_in_file: int
    block_noise: float
    edge_noise: np.ndarray
    colour_noise: np.ndarray
    noisy: bool


def usable(view: View, surface: Surface, factors: FormFactors, used):
    """(H, W) bool: used pixels that show the model, but for its lamps: what those show is their emittance."""
    lamp = np.isin(surface.group, [factors.groups.index(name) for name in factors.lamps])
    return used & (view.facet >= 0) & ~lamp[view.facet]


def gathered(view: View, surface: Surface, factors: FormFactors, used, sampling: Sampling) -> Gathered:
    """Tiles of a photograph's usable pixels, used (H, W), but for those that lie in a gap narrower than its patches:
    how light fades in there no patch knows."""
    shown = view.facet >= 0
    emitters = lamps.emitters(surface, factors.lamps)
    tiles = build(
        surface,
        factors.mesh,
        view.camera,
        view.facet,
        usable(view, surface, factors, used),
        emitters,
        len(factors.lamps),
        sampling,
    )
    if (hidden := in_gaps(tiles, factors)).any():
        tiles = tiles.take(np.flatnonzero(~hidden))
    return Gathered(
        tiles,
        view.pixels(tiles.pixel),
        surface.group[tiles.facet],
        surface.object[tiles.facet],
        np.bincount(surface.group[view.facet[shown]], minlength=len(factors.groups)),
        view.photograph.linear,
        view.photograph.channels_in_file,
        view.photograph.blocks.noise if view.photograph.blocks else 0.0,
        _edge_noise(view, tiles),
        _colour_noise(view.photograph),
        view.photograph.noisy,
    )


def in_gaps(tiles: Tiles, factors: FormFactors) -> np.ndarray:
    """(T,) bool: much of the tile's light comes from patches that face others nearer than they are large."""
    return tiles.rows.matrix() @ factors.beside_gaps.astype(np.float32) > IN_GAP


def under_one_curve(found: Gathered | None, transfer: Transfer) -> Gathered | None:
    """The same light, seen by a camera that has one curve for all channels."""
    return found and replace(found, pixels=transfer.in_common(found.pixels))


def with_outside(view, factors: FormFactors, *gathered: Gathered):
    """(factors, *gathered) with the outside among the lamps, where the model is open. view : () -> View"""
    factors = outside.with_outside(factors, lambda: surfaces.surface(view().model, factors.lamps))
    if factors.outside is None:
        return factors, *gathered
    surface, lit = surfaces.surface(view().model, factors.lamps), []
    for found in gathered:
        tiles = found.tiles
        p, side = backproject(surface, view().camera, np.repeat(tiles.facet, np.diff(tiles.start)), tiles.pixel)
        more = outside.of_points(factors, surface, p, tiles.start, side[tiles.start[:-1]], tiles.rows)
        lit.append(replace(found, tiles=replace(tiles, direct=np.hstack([tiles.direct, more]))))
    return factors, *lit


def _colour_noise(photograph):
    """(C,) display: see Blocks; 0 where there is no colour to be rounded."""
    none, blocks = np.zeros(photograph.values.shape[2]), photograph.blocks
    return blocks.colour if blocks and len(blocks.colour) == len(none) else none


def _edge_noise(view, tiles):
    """(T,) display: what rounding adds to the pixels of each tile, as far as edges run through their blocks."""
    blocks = view.photograph.blocks
    if not blocks or not len(tiles):
        return np.zeros(len(tiles))
    held = in_blocks(boundary(view.facet), blocks).reshape(-1)[tiles.pixel]
    return blocks.edge_noise * np.sqrt(np.add.reduceat(held.astype(float), tiles.start[:-1]) / np.diff(tiles.start))


OF_ROWS = [f.name for f in fields(FormFactorRows)]
OF_TILES = [f.name for f in fields(Tiles) if f.name != "rows"]
OF_GATHERED = [f.name for f in fields(Gathered) if f.name != "tiles"]


def write(path, found: Gathered):
    """Whole or absent."""
    tiles = found.tiles
    artefact.write_npz(
        path,
        **{f"rows_{name}": getattr(tiles.rows, name) for name in OF_ROWS},
        **{f"tiles_{name}": getattr(tiles, name) for name in OF_TILES},
        **{name: getattr(found, name) for name in OF_GATHERED},
    )


TILES = {
    "facet": Whole("T"),
    "start": Starts("T+1", into="M"),
    "pixel": Whole("M"),
    "direct": Real("T", "L", low=0),
}
OTHERS = {
    "pixels": Real("M", "C"),
    "group": Whole("T", below="G"),
    "object": Whole("T"),
    "visible": Whole("G"),
    "linear": Flag(),
    "channels_in_file": Whole(),
    "block_noise": Real(low=0),
    "edge_noise": Real("T", low=0),
    "colour_noise": Real("C", low=0),
    "noisy": Flag(),
}


def read(path) -> Gathered:
    """BadInput: an array is missing, or cannot be what it is for."""
    a = artefact.read_npz(
        path, *(f"rows_{name}" for name in OF_ROWS), *(f"tiles_{name}" for name in OF_TILES), *OF_GATHERED
    )
    sizes = arrays.check(path, a, TILES, prefix="tiles_")
    arrays.check(path, a, factors_file.ROWS, {"R": sizes["T"]}, "rows_")
    arrays.check(path, a, OTHERS, sizes)
    rows = {name: a[f"rows_{name}"] for name in OF_ROWS}
    rows["columns"] = int(rows["columns"])
    tiles = Tiles(**{name: a[f"tiles_{name}"] for name in OF_TILES}, rows=FormFactorRows(**rows))
    more = {name: a[name] for name in OF_GATHERED}
    more["linear"], more["channels_in_file"] = bool(more["linear"]), int(more["channels_in_file"])
    more["block_noise"], more["noisy"] = float(more["block_noise"]), bool(more["noisy"])
    return Gathered(tiles, **more)


def out_of_range(found: Gathered) -> bool:
    """The photograph's values are so small that they must be meant for another range."""
    return is_twelve_bits(found.pixels, found.linear)
