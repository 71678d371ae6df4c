"""Compiled: what kernels need of pixels, and places pulled back into their facet."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.picture.triangles_kernels import Triangles, holds


class PixelArrays(NamedTuple):
    """What kernels need of Pixels; see there."""

    x: np.ndarray  # (M,) int32
    y: np.ndarray  # (M,) int32
    facet: np.ndarray  # (M,) int32
    side: np.ndarray  # (M,) int32
    p: np.ndarray  # (M, 3) local
    number: np.ndarray  # (H, W) int64


class Viewer(NamedTuple):
    """What turns a place (x, y) in the picture into a ray: from `eye` along M (x, y, 1), local."""

    eye: np.ndarray  # (3,)
    M: np.ndarray  # (3, 3)


@njit(parallel=True)
def pull_in(p, facet, triangles: Triangles, normal):
    """Move places p (M, 3) that lie outside their facet to the nearest place inside, in place.

    A pixel on the rim of a facet may lie a hair outside it, behind the next wall.  facet : (M,);  normal : (F, 3)
    """
    corners, first = triangles
    for i in prange(len(p)):
        f = facet[i]
        if holds(p[i], corners, first[f], first[f + 1], normal[f]):
            continue
        best = np.inf
        nearest = p[i].copy()
        for t in range(first[f], first[f + 1]):
            middle = (corners[t, 0] + corners[t, 1] + corners[t, 2]) / 3
            for e in range(3):
                a, b = corners[t, e], corners[t, (e + 1) % 3]
                d = b - a
                along = min(max(np.dot(p[i] - a, d) / max(np.dot(d, d), 1e-300), 0.0), 1.0)
                q = a + along * d
                distance = np.dot(p[i] - q, p[i] - q)
                if distance < best:
                    best = distance
                    inward = middle - q
                    nearest = q + inward * min(1.0, 4 * OFFSET / max(np.sqrt(np.dot(inward, inward)), 1e-300))
        p[i] = nearest
