"""Compiled: the triangles of facets, and which places they hold."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange


class Triangles(NamedTuple):
    """The triangles of a surface, facet by facet."""

    corners: np.ndarray  # (T, 3, 3) local
    first: np.ndarray  # (F + 1,) int64, where each facet's begin


@njit(inline="always")
def holds(p, corners, a, b, normal):
    """Whether one of the triangles a to b of a facet holds the point of its plane."""
    for t in range(a, b):
        inside = True
        for e in range(3):
            o, q = corners[t, e], corners[t, (e + 1) % 3]
            x0, x1, x2 = q[0] - o[0], q[1] - o[1], q[2] - o[2]
            y0, y1, y2 = p[0] - o[0], p[1] - o[1], p[2] - o[2]
            if (x1 * y2 - x2 * y1) * normal[0] + (x2 * y0 - x0 * y2) * normal[1] + (x0 * y1 - x1 * y0) * normal[2] < 0:
                inside = False
                break
        if inside:
            return True
    return False


@njit(parallel=True)
def within(p, facet, triangles: Triangles, normal):
    """(M,) bool: the point p (M, 3) lies in one of its facet's triangles.  normal : (M, 3) of the facet"""
    corners, first = triangles
    out = np.zeros(len(p), np.bool_)
    for i in prange(len(p)):
        out[i] = holds(p[i], corners, first[facet[i]], first[facet[i] + 1], normal[i])
    return out
