"""§3.2, §4.5 Index buffers: which facet each pixel shows, and how far away it is.

    index = draw(model, camera)                 # OpenGL, headless
    index = reference(model, camera)            # the same by casting rays; no graphics needed

What is nearest wins. Where facets coincide in depth (within the rounding of a float32) the one that turns its front to
the camera wins, then the later one in the file. So a board drawn exactly on a wall hides it, and a panel of two
polygons back to back shows the right one.
"""

from dataclasses import dataclass

import numpy as np

from lib.buffers.cast import cast, caster, shared_planes
from lib.buffers.edges import boundary
from lib.buffers.opengl import Painter, require_graphics, tiles
from lib.buffers.viewport import TIE, viewport_of


@dataclass(frozen=True, eq=False)
class IndexBuffer:
    """What each pixel of a picture shows."""

    facet: np.ndarray  # (H, W) int32, -1 where the model shows nothing
    depth: np.ndarray  # (H, W) float64 m along z, from the facet's plane in double precision; 0 for nothing
    triangle: np.ndarray  # (H, W) int32, -1 for nothing
    method: str  # "opengl" or "rays"


def _buffer(model, camera, view, rank, method):
    """From the rank of the winning triangle at each pixel (-1: none) to facet and depth."""
    rank = _sharpen(model, camera, view, rank)
    seen = rank >= 0
    triangle = np.full(rank.shape, -1, np.int32)
    triangle[seen] = view.triangle[rank[seen]]
    facet = np.full(rank.shape, -1, np.int32)
    facet[seen] = model.triangle_facet[triangle[seen]]
    y, x = np.nonzero(seen)
    v = camera.directions(np.column_stack([x, y]))
    r = rank[seen]
    # A pixel on the rim of a triangle seen edge-on may lie a hair outside, where its plane runs away. Hence the bounds.
    inverse = np.clip(np.einsum("ij,ij->i", view.slope[r], v), view.low[r], view.high[r])
    depth = np.zeros(rank.shape)
    depth[seen] = view.unit / inverse
    return IndexBuffer(facet, depth, triangle, method)


def _sharpen(model, camera, view, rank):
    """Decide anew, in double precision, between the triangles that meet at a pixel beside an edge.

    OpenGL moves corners to the next 1/256 px, Embree has floats: a pixel centre that close to an edge may have gone to
    the wrong side. The candidates are the triangles of the pixel and its eight neighbours.
    """
    if len(view.triangle) == 0:
        return rank
    H, W = rank.shape
    facet = np.append(model.triangle_facet[view.triangle], -1)[rank]
    y, x = np.nonzero(boundary(facet))
    v = camera.directions(np.column_stack([x, y]))
    around = np.pad(rank, 1, mode="edge")
    old = rank[y, x]
    best, winner, empty = np.zeros(len(y)), np.full(len(y), -1), np.zeros(len(y), bool)
    candidates = [around[y + 1 + dy, x + 1 + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    reach = []
    for t in candidates:
        empty |= t < 0
        a, b, c = np.moveaxis(view.p[t], 1, 0)
        turn = np.sign(np.einsum("ij,ij->i", view.slope[t], np.cross(b - a, c - a)))
        inside = t >= 0
        for corner, following in ((a, b), (b, c), (c, a)):  # v . (a x b): on which side of the edge ab
            inside &= np.einsum("ij,ij->i", v, np.cross(corner, following)) * turn >= 0
        inverse = np.clip(np.einsum("ij,ij->i", view.slope[t], v), view.low[t], view.high[t])
        reach.append(np.where(inside, inverse, -1.0))
        best = np.maximum(best, reach[-1])
    for t, inverse in zip(candidates, reach, strict=True):
        slack = TIE * (np.einsum("ij,ij->i", np.abs(view.slope[t]), np.abs(v)) + best)
        winner = np.maximum(winner, np.where((inverse >= 0) & (inverse >= best - slack), t, -1))
    rank = rank.copy()
    rank[y, x] = np.where((winner < 0) & ~empty, old, winner)  # none, though nothing empty is near: a crack
    return rank


def draw(model, camera) -> IndexBuffer:
    """The index buffer by OpenGL. Raises NoGraphics where there is no EGL: use reference() there."""
    require_graphics()
    view = viewport_of(model, camera)
    with Painter(view, camera) as painter:
        rank = np.empty((camera.height, camera.width), np.int32)
        for x0, y0, x1, y1 in tiles(camera.width, camera.height):
            rank[y0:y1, x0:x1] = painter.paint(x0, y0, x1 - x0, y1 - y0)
    return _buffer(model, camera, view, rank, "opengl")


def reference(model, camera) -> IndexBuffer:
    """The index buffer by casting rays: the yardstick of draw(), and what runs where there is no EGL."""
    view = viewport_of(model, camera)
    if len(view.triangle) == 0:
        rank = np.full((camera.height, camera.width), -1)
    else:
        v = camera.directions(camera.pixels().reshape(-1, 2))
        rank = cast(caster(view), view, v, shared_planes(model, view)).reshape(camera.height, camera.width)
    return _buffer(model, camera, view, rank, "rays")


class Probe:
    """What a camera sees at places between pixels, by rays: for a few thousand places much cheaper than a picture.

    Built once for each camera. It shows what reference() shows, but for places within float32 of an edge.
    """

    def __init__(self, model, camera):
        self.camera, self.facet = camera, model.triangle_facet
        self.view = viewport_of(model, camera)
        if len(self.view.triangle):
            self.scene, self.plane = caster(self.view), shared_planes(model, self.view)

    def at(self, q):
        """(facet (n,) int, -1 for nothing;  depth (n,) m along z, inf for nothing) at q (n, 2) px."""
        facet, depth = np.full(len(q), -1), np.full(len(q), np.inf)
        if len(self.view.triangle) == 0 or len(q) == 0:
            return facet, depth
        v = self.camera.directions(q)
        rank = cast(self.scene, self.view, v, self.plane)
        met = np.flatnonzero(rank >= 0)
        r = rank[met]
        inverse = np.clip(np.einsum("ij,ij->i", self.view.slope[r], v[met]), self.view.low[r], self.view.high[r])
        facet[met], depth[met] = self.facet[self.view.triangle[r]], self.view.unit / inverse
        return facet, depth


def facet_depth(model, camera, facet) -> np.ndarray:
    """(H, W) m: the depth of an index buffer that was read from a file, by the planes of its facets; 0 for nothing."""
    n = model.facet_normal @ camera.T_cam_world[:3, :3].T
    height = model.facet_offset - model.facet_normal @ camera.centre
    v = camera.directions(camera.pixels())
    inverse = np.einsum("hwi,hwi->hw", n[facet], v) / np.where(height == 0, 1e-300, height)[facet]
    return np.where((facet >= 0) & (inverse > 0), 1 / np.where(inverse > 0, inverse, 1), 0.0)
