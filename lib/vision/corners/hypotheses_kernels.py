"""Compiled: how near the lines of a pair lie to the model's edges, for many poses."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange


class Field(NamedTuple):
    """Distances to the nearest edge on a grid."""

    distance: np.ndarray  # (nx, ny, nz) float32 m
    low: np.ndarray  # (3,) m, the first cell's centre
    cell: float  # m


@njit(parallel=True)
def scores(field, R, t, p, reach, worth):
    """(h,) nats: what points p (n, 3) m of the camera's frame say for poses x_cam = R x + t, R (h, 3, 3), t (h, 3).

    reach : (n,) m: a point so far from all edges tells nothing;  worth : (n,) nats of one on an edge
    """
    out = np.zeros(len(R))
    nx, ny, nz = field.distance.shape
    for h in prange(len(R)):
        total = 0.0
        for k in range(len(p)):
            x, y, z = p[k, 0] - t[h, 0], p[k, 1] - t[h, 1], p[k, 2] - t[h, 2]
            i = int(round((R[h, 0, 0] * x + R[h, 1, 0] * y + R[h, 2, 0] * z - field.low[0]) / field.cell))
            j = int(round((R[h, 0, 1] * x + R[h, 1, 1] * y + R[h, 2, 1] * z - field.low[1]) / field.cell))
            m = int(round((R[h, 0, 2] * x + R[h, 1, 2] * y + R[h, 2, 2] * z - field.low[2]) / field.cell))
            if 0 <= i < nx and 0 <= j < ny and 0 <= m < nz:
                u = field.distance[i, j, m] / reach[k]
                if u < 1:
                    total += worth[k] * (1 - u * u)
        out[h] = total
    return out
