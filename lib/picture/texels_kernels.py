"""Compiled: light fitted through the patches around a texel."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.picture.light_map_kernels import linear

FAR = 10.0  # local coordinates are smaller: facets this far apart do not mix in a search


@njit(parallel=True)
def fit(known, value, wanted, axes, near, distance):
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


@njit(parallel=True)
def within(p, facet, corners, start, normal):
    """(M,) bool: the point lies in one of its facet's triangles."""
    out = np.zeros(len(p), np.bool_)
    for i in prange(len(p)):
        out[i] = holds(p[i], corners, start[facet[i]], start[facet[i] + 1], normal[i])
    return out


@njit()
def nearest(good, start, count):
    """(K,) for each texel a good one of its side as few steps away as any (itself where it is good, or where none is)."""
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
