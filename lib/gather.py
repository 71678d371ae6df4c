"""The light that each part of the photograph receives: tiles of trusted pixels as receivers (gathering).

A tile is a square block of the photograph's trusted pixels on one facet. Its direct light is the mean over its
pixels of the exact lamp factors with shadows; its indirect light is one row of form factors whose rays start at
the tile's own pixels. Patch-constant light therefore enters only at the second bounce (DESIGN 7: gathering is
the lever), and a change of reflectance costs one small linear solve and no ray.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib import form_factors
from lib.mesh import Mesh, Surface


@dataclass(frozen=True)
class Tiles:
    facet: np.ndarray          # (T,) int32
    start: np.ndarray          # (T + 1,) int64 into pixel
    pixel: np.ndarray          # (M,) int64 flat index y * W + x, tile by tile
    direct: np.ndarray         # (T, L) mean factor to each lamp, shadows included
    rows: form_factors.Rows    # (T, N) indirect light

    def __len__(self):
        return len(self.facet)


def blocks(facet, used, *, largest=20, smallest=4, tiles_per_facet=24):
    """Cut the used pixels into tiles of one facet each.

    facet : (H, W) int, -1 = nothing;  used : (H, W) bool
    Returns facet (T,), start (T + 1,), pixel (M,): square blocks, small on small facets so that each has about
    `tiles_per_facet` of them.
    """
    y, x = np.nonzero(used & (facet >= 0))
    f = facet[y, x].astype(np.int64)
    if len(f) == 0:
        return np.zeros(0, np.int32), np.zeros(1, np.int64), np.zeros(0, np.int64)
    count = np.bincount(f)
    block = np.clip(np.sqrt(count / tiles_per_facet), smallest, largest).astype(np.int64)[f]
    columns = facet.shape[1] // smallest + 1
    key = (f * (facet.shape[0] // smallest + 1) + y // block) * columns + x // block
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    return (f[order][starts].astype(np.int32), np.append(starts, len(order)).astype(np.int64),
            (y * facet.shape[1] + x)[order])


def pure(photograph, facet):
    """(H, W) bool: pixels that show one facet and mix with no other, not black, and none within two of them saturated: beside
    a highlight's core those that noise kept below saturation would be too dark on average."""
    import cv2
    from lib.index_buffer import boundary
    values = photograph.values
    usable = (facet >= 0) & ~boundary(facet)
    if photograph.linear:
        return usable & (values > 0).all(axis=2)
    clipped = (values >= 250 / 255 - 1e-9).any(axis=2).astype(np.uint8)
    return usable & (values > 2 / 255 + 1e-9).any(axis=2) & (cv2.dilate(clipped, np.ones((5, 5), np.uint8)) == 0)


def backproject(surface: Surface, camera, facet, pixel):
    """Where the pixels' centres meet their facets' planes: (M, 3) local, and the side each shows, (M,) int32.

    facet : (M,) int;  pixel : (M,) flat index
    """
    q = np.stack([pixel % camera.width, pixel // camera.width], axis=1).astype(float)
    v = camera.rays(q)
    centre = surface.local.points(camera.centre)
    n = surface.normal[facet]
    height = np.einsum("ij,ij->i", surface.origin[facet] - centre, n)
    along = np.einsum("ij,ij->i", v, n)
    p = centre + v * (height / np.where(np.abs(along) > 1e-12, along, 1e-12))[:, None]
    return p, (2 * facet + (along > 0)).astype(np.int32)


def build(surface: Surface, mesh: Mesh, camera, facet, used, lamps, n_lamps, *, rays_per_tile, rays_per_facet, lamp_samples,
          largest=20, smallest=4, tiles_per_facet=24, seed=5, progress=None) -> Tiles:
    """Tiles of the used pixels with their direct factors and form-factor rows.

    facet : (H, W) int, -1 = nothing;  used : (H, W) bool;  lamps : from form_factors.emitters
    rays_per_tile : at least so many rays from each tile; rays_per_facet : and so many from each facet
    lamp_samples : shadow rays per pixel and lamp
    """
    tile_facet, start, pixel = blocks(facet, used, largest=largest, smallest=smallest, tiles_per_facet=tiles_per_facet)
    per_tile = np.diff(start)
    p, side = backproject(surface, camera, np.repeat(tile_facet, per_tile), pixel)
    first = start[:-1]
    direct = form_factors.direct(surface, lamps, p, form_factors.side_normals(surface), side, n_lamps, n_samples=lamp_samples, start=start, seed=seed - 5)
    tiles_of = np.bincount(tile_facet, minlength=len(surface.normal))[tile_facet] if len(tile_facet) else np.zeros(0, int)
    wanted = np.maximum(rays_per_tile, rays_per_facet / np.maximum(tiles_of, 1))
    n_rays = (2 ** np.ceil(np.log2(np.minimum(wanted, 4096)))).astype(np.int64)
    rows = form_factors.gather(surface, mesh, p, start, side[first] if len(first) else side, n_rays, seed=seed, progress=progress)
    return Tiles(tile_facet, start, pixel, direct, rows)


# -- gather.npz

@dataclass(frozen=True)
class Gathered:
    """What gather.npz holds: the tiles, the photograph's pixels in them, and which groups the photograph shows."""
    tiles: Tiles
    pixels: np.ndarray         # (M, C) display (linear: EXR), in the order of tiles.pixel
    group: np.ndarray          # (T,) int32
    object: np.ndarray         # (T,) int32
    visible: np.ndarray        # (G,) pixels that show each group, trusted or not
    linear: bool               # the photograph is linear (EXR)
    channels_in_file: int


def write(path, gathered: Gathered):
    from dataclasses import fields
    from lib import artefact
    tiles = gathered.tiles
    arrays = {f"rows_{f.name}": getattr(tiles.rows, f.name) for f in fields(form_factors.Rows)}
    arrays |= {f"tiles_{f.name}": getattr(tiles, f.name) for f in fields(Tiles) if f.name != "rows"}
    arrays |= {f.name: getattr(gathered, f.name) for f in fields(Gathered) if f.name != "tiles"}
    artefact.write_npz(path, **arrays)


def read(path) -> Gathered:
    from dataclasses import fields
    from lib import artefact
    rows = [f.name for f in fields(form_factors.Rows)]
    of_tiles = [f.name for f in fields(Tiles) if f.name != "rows"]
    more = [f.name for f in fields(Gathered) if f.name != "tiles"]
    a = artefact.read_npz(path, *(f"rows_{n}" for n in rows), *(f"tiles_{n}" for n in of_tiles), *more)
    arrays = {n: a[f"rows_{n}"] for n in rows}
    arrays["columns"] = int(arrays["columns"])
    tiles = Tiles(**{n: a[f"tiles_{n}"] for n in of_tiles}, rows=form_factors.Rows(**arrays))
    return Gathered(tiles, a["pixels"], a["group"], a["object"], a["visible"], bool(a["linear"]), int(a["channels_in_file"]))
