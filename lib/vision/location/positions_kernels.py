"""Compiled: how well the model's edges lie on a photograph's straight edges, for many camera positions."""

import math
from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange


class Field(NamedTuple):
    """Where the photograph has straight edges, by their direction.

    near : (B, h, w) float32 in [0, 1], 1 on an edge of that direction, 0 far from all;  chance : (B,) its mean
    shrink : photograph's px to one of the field's
    """

    near: np.ndarray
    chance: np.ndarray
    shrink: float


@njit(parallel=True)
def scores(field, K, R, centres, p, along, weight, visible):
    """(c,) how much more of the model's samples lie on edges than would by chance.

    K (3, 3) px;  R (3, 3) world to camera;  centres (c, 3) m;  p, along (s, 3) samples and their edges' directions
    weight : (s,);  visible : (c, s) bool
    """
    bins, h, w = field.near.shape
    out = np.zeros(len(centres))
    q = np.empty((len(p), 3))
    d = np.empty((len(p), 3))
    for s in range(len(p)):
        for k in range(3):
            q[s, k] = R[k, 0] * p[s, 0] + R[k, 1] * p[s, 1] + R[k, 2] * p[s, 2]
            d[s, k] = R[k, 0] * along[s, 0] + R[k, 1] * along[s, 1] + R[k, 2] * along[s, 2]
    for c in prange(len(centres)):
        o0 = R[0, 0] * centres[c, 0] + R[0, 1] * centres[c, 1] + R[0, 2] * centres[c, 2]
        o1 = R[1, 0] * centres[c, 0] + R[1, 1] * centres[c, 1] + R[1, 2] * centres[c, 2]
        o2 = R[2, 0] * centres[c, 0] + R[2, 1] * centres[c, 1] + R[2, 2] * centres[c, 2]
        total = 0.0
        for s in range(len(p)):
            if not visible[c, s]:
                continue
            z = q[s, 2] - o2
            if z <= 1e-6:
                continue
            x, y = (q[s, 0] - o0) / z, (q[s, 1] - o1) / z
            u, v = K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]
            i, j = int((v + 0.5) / field.shrink), int((u + 0.5) / field.shrink)
            if u < 0 or v < 0 or i >= h or j >= w:
                continue
            du, dv = K[0, 0] * (d[s, 0] - x * d[s, 2]), K[1, 1] * (d[s, 1] - y * d[s, 2])
            angle = math.atan2(dv, du) / math.pi
            b = int(round((angle - math.floor(angle)) * bins)) % bins
            total += weight[s] * (field.near[b, i, j] - field.chance[b])
        out[c] = total
    return out
