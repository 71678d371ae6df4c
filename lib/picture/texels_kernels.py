"""Compiled: light fitted through the patches around a texel, and texels that take another's value."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.picture.light_map_kernels import linear

FAR = 10.0  # local coordinates are smaller: facets this far apart do not mix in a search


@njit(parallel=True)
def fit(known, value, wanted, axes, near, distance):
    """(M, C) a local linear fit of value (N, C), known at the points (N, 3), at each wanted point (M, 3).

    axes : (M, 2, 3) of its plane
    near, distance : (M, k) the nearest known points of each, those of other planes FAR away
    """
    m, k = near.shape
    C = value.shape[1]
    out = np.zeros((m, C))
    for i in prange(m):
        n = 0
        while n < k and distance[i, n] < 0.5 * FAR:
            n += 1
        if n == 0:
            continue
        radius = max(1.05 * distance[i, n - 1], 1e-12)
        s0, su, sv, suu, suv, svv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        t = np.zeros((3, C))
        low, high = np.full(C, np.inf), np.full(C, -np.inf)
        for j in range(n):
            q = near[i, j]
            w = 1 - (distance[i, j] / radius) ** 2
            w *= w
            u, v = 0.0, 0.0
            for d in range(3):
                x = (known[q, d] - wanted[i, d]) / radius
                u += x * axes[i, 0, d]
                v += x * axes[i, 1, d]
            s0 += w
            su += w * u
            sv += w * v
            suu += w * u * u
            suv += w * u * v
            svv += w * v * v
            for c in range(C):
                t[0, c] += w * value[q, c]
                t[1, c] += w * u * value[q, c]
                t[2, c] += w * v * value[q, c]
                low[c] = min(low[c], value[q, c])
                high[c] = max(high[c], value[q, c])
        linear(s0, su, sv, suu, suv, svv, t, 0.02)
        for c in range(C):  # beyond the outermost points no more than half the range is continued
            room = 0.5 * (high[c] - low[c])
            out[i, c] = min(max(t[0, c], low[c] - room), high[c] + room)
    return out


@njit()
def nearest(good, start, count):
    """(K,) for each texel a good one of its side, as few steps away as any.

    That is the texel itself where it is good, or where none is.
    good : (K,);  start : (n,), count : (n, 2) of each side
    """
    source = np.arange(len(good))
    queue = np.empty(len(good), np.int64)
    for s in range(len(start)):
        nu, nv = count[s]
        reached = good[start[s] : start[s] + nu * nv].copy()
        head, tail = 0, 0
        for i in range(nu * nv):
            if reached[i]:
                queue[tail] = i
                tail += 1
        while head < tail:
            i = queue[head]
            head += 1
            for step in range(4):
                a = i // nv + (1 if step == 0 else -1 if step == 1 else 0)
                b = i % nv + (1 if step == 2 else -1 if step == 3 else 0)
                j = a * nv + b
                if 0 <= a < nu and 0 <= b < nv and not reached[j]:
                    reached[j] = True
                    source[start[s] + j] = source[start[s] + i]
                    queue[tail] = j
                    tail += 1
    return source
