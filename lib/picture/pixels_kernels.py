"""Compiled: places pulled back into their facet."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.picture.texels_kernels import holds


@njit(parallel=True)
def pull_in(p, facet, corners, first, normal):
    """A pixel on the rim of a facet may lie a hair outside it, behind the next wall: it moves to the nearest place inside."""
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
