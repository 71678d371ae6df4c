"""The pixels that show one facet each, and the places of the model that they show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.light.surface import Surface, backproject
from lib.picture import pixels_kernels as kernels
from lib.picture.pixels_kernels import PixelArrays, Viewer
from lib.picture.triangles_kernels import Triangles


@dataclass(frozen=True)
class Pixels:
    """The pixels that show something, in Morton's order facet by facet: a block of a facet is a range.

    x, y, facet, side : (M,);  p : (M, 3) local;  key : (M,) facet and Morton code
    number : (H, W) place in this order, -1
    """

    x: np.ndarray
    y: np.ndarray
    facet: np.ndarray
    side: np.ndarray
    p: np.ndarray
    key: np.ndarray
    number: np.ndarray

    def __len__(self):
        return len(self.x)

    @property
    def arrays(self) -> PixelArrays:
        """For kernels."""
        return PixelArrays(self.x, self.y, self.facet, self.side, self.p, self.number)


def _morton(v):
    """The bits of v (n,), each followed by a 0, uint64."""
    v = v.astype(np.uint64)
    for shift, mask in (
        (16, 0x0000FFFF0000FFFF),
        (8, 0x00FF00FF00FF00FF),
        (4, 0x0F0F0F0F0F0F0F0F),
        (2, 0x3333333333333333),
        (1, 0x5555555555555555),
    ):
        v = (v | (v << np.uint64(shift))) & np.uint64(mask)
    return v


def pixels(surface: Surface, camera, facet, at=None) -> Pixels:
    """facet : (H, W) int, -1 = nothing
    at : ((H, W, 3) local, (H, W) side) of what mirrors show; by default where the camera sees it
    """
    y, x = np.nonzero(facet >= 0)
    bits = max(1, int(max(facet.shape) - 1).bit_length())
    key = (facet[y, x].astype(np.uint64) << np.uint64(2 * bits)) | _morton(x) | (_morton(y) << np.uint64(1))
    order = np.argsort(key)
    x, y, key = x[order].astype(np.int32), y[order].astype(np.int32), key[order].astype(np.int64)
    number = np.full(facet.shape, -1, np.int64)
    number[y, x] = np.arange(len(x))
    f = facet[y, x].astype(np.int32)
    if at is None:
        p, side = backproject(surface, camera, f, y.astype(np.int64) * camera.width + x)
    else:
        p, side = (values[y, x] for values in at)
    kernels.pull_in(p, f, facet_triangles(surface), surface.normal)
    return Pixels(x, y, f, side, p, key, number)


def facet_triangles(surface) -> Triangles:
    """The triangles of a surface, facet by facet."""
    order = np.argsort(surface.facet, kind="stable").astype(np.int64)
    first = np.searchsorted(surface.facet[order], np.arange(len(surface.normal) + 1)).astype(np.int64)
    return Triangles(surface.corners[order], first)


def viewer(surface, camera) -> Viewer:
    """Of a camera; without one (pixels that mirrors show) no place but a pixel's own is known: M = 0."""
    if camera is None:
        return Viewer(np.zeros(3), np.zeros((3, 3)))
    M = camera.T_cam_world[:3, :3].T @ np.linalg.inv(camera.K)
    return Viewer(surface.local.points(camera.centre), M)
