"""Compiled: what the pixels of hemicubes show, summed patch by patch."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.light.cells_kernels import PatchTable, patch_under
from lib.light.surface_kernels import SurfaceArrays


class HemicubePixels(NamedTuple):
    """All pixels of a hemicube, face after face."""

    direction: np.ndarray  # (K, 3) in the frame (x, y, normal)
    delta: np.ndarray  # (K,) delta form factors


@njit(parallel=True)
def binned(shown, eye, frames, points, pixels: HemicubePixels, surface: SurfaceArrays, table: PatchTable, columns):
    """Sums of delta factors for each patch, the mean of its `points` hemicubes.

    shown : (k * points, K) facet at each pixel, -1;  eye : (k * points, 3);  frames : (k * points, 3, 3) x, y, normal
    Returns them per patch that is met (k, columns), and of what starts inside a solid and what meets no patch (k,).
    """
    normal, origin, axes = surface.normal, surface.origin, surface.axes
    size, inside = surface.size, surface.inside
    start, shape, leaf = table.start, table.shape, table.leaf
    directions, delta = pixels.direction, pixels.delta
    m = len(eye) // points
    out = np.zeros((m, columns))
    dropped = np.zeros(m)
    lost = np.zeros(m)
    for row in prange(m):
        for i in range(row * points, (row + 1) * points):
            x, y, n = frames[i, 0], frames[i, 1], frames[i, 2]
            for k in range(len(delta)):
                if shown[i, k] < 0:
                    continue
                f = int(shown[i, k])
                facing, height = 0.0, 0.0
                d = np.empty(3)
                for c in range(3):
                    d[c] = directions[k, 0] * x[c] + directions[k, 1] * y[c] + directions[k, 2] * n[c]
                    facing += d[c] * normal[f, c]
                    height += (origin[f, c] - eye[i, c]) * normal[f, c]
                s = 2 * f + (1 if height > 0 else 0)
                if inside[s]:
                    dropped[row] += delta[k] / points
                    continue
                if start[s] < 0:
                    lost[row] += delta[k] / points
                    continue
                t = height / facing if facing != 0 else 0.0
                u, v = 0.0, 0.0
                for c in range(3):
                    p = eye[i, c] + t * d[c] - origin[f, c]
                    u += p * axes[f, 0, c]
                    v += p * axes[f, 1, c]
                patch = patch_under(u, v, s, size[f], start, shape, leaf)
                if patch >= 0:
                    out[row, patch] += delta[k] / points
                else:
                    lost[row] += delta[k] / points
    return out, dropped, lost
