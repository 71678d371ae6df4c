"""Compiled: what kernels need of a surface, bounding rectangles of facets, and facets that lie on each other."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit
from lib.given.rays_kernels import OFFSET

SMALLER = 1e-6  # share by which a rectangle must be smaller than one found before: rounding chooses none


class SurfaceArrays(NamedTuple):
    """What kernels need of a Surface; see there."""

    facet: np.ndarray  # (T,) int32
    normal: np.ndarray  # (F, 3)
    origin: np.ndarray  # (F, 3)
    axes: np.ndarray  # (F, 2, 3)
    size: np.ndarray  # (F, 2)
    inside: np.ndarray  # (2 F,) bool


@njit()
def frames(corners, order, start, normal):
    """For each facet the smallest of the bounding rectangles along its triangles' edges."""
    F = len(normal)
    origin = np.zeros((F, 3))
    axes = np.zeros((F, 2, 3))
    size = np.zeros((F, 2))
    for f in range(F):
        best = np.inf
        n = normal[f]
        tried = 0
        for s in range(start[f], start[f + 1]):
            for e in range(3):
                if tried > 60:
                    continue
                tried += 1
                a = corners[order[s], e]
                d = corners[order[s], (e + 1) % 3] - a
                d = d - n * np.dot(d, n)
                length = np.sqrt(np.dot(d, d))
                if length <= 0:
                    continue
                x = d / length
                y = np.cross(n, x)
                u0, u1, v0, v1 = np.inf, -np.inf, np.inf, -np.inf
                for r in range(start[f], start[f + 1]):
                    for c in range(3):
                        p = corners[order[r], c]
                        u = np.dot(p, x)
                        v = np.dot(p, y)
                        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
                area = (u1 - u0) * (v1 - v0)
                if area < best * (1 - SMALLER):
                    best = area
                    axes[f, 0] = x
                    axes[f, 1] = y
                    size[f, 0] = u1 - u0
                    size[f, 1] = v1 - v0
                    h = np.dot(corners[order[start[f]], 0], n)
                    origin[f] = u0 * x + v0 * y + h * n
    return origin, axes, size


@njit()
def coplanar_pairs(order, axis, low, high, plane):
    """(K, 2): facets in one plane whose bounding boxes overlap, by a sweep along one axis.

    order : (F,) facets by low[:, axis];  low, high : (F, 3);  plane : (F, 4) normal and height, turned alike
    """
    found = []
    for a in range(len(order)):
        i = order[a]
        for b in range(a + 1, len(order)):
            j = order[b]
            if low[j, axis] > high[i, axis] + OFFSET:
                break
            apart = 0.0
            for d in range(4):
                apart += (plane[i, d] - plane[j, d]) ** 2
            if apart > OFFSET * OFFSET:
                continue
            thick, long = 0, True
            for d in range(3):
                reach = min(high[i, d], high[j, d]) - max(low[i, d], low[j, d])
                long &= reach > -OFFSET
                thick += reach > OFFSET
            if long and thick >= 2:  # more than a common edge
                found.append((min(i, j), max(i, j)))
    pairs = np.empty((len(found), 2), np.int64)
    for k in range(len(found)):
        pairs[k, 0], pairs[k, 1] = found[k]
    return pairs


@njit()
def common_area(P, Q, n):
    """Area of the overlap of two sets of triangles in one plane with the normal n."""
    total = 0.0
    a = np.zeros((12, 3))
    b = np.zeros((12, 3))
    for p in P:
        for q in Q:
            m = 3
            a[:3] = q
            turn = 1.0 if np.dot(np.cross(p[1] - p[0], p[2] - p[0]), n) > 0 else -1.0
            for e in range(3):
                inward = turn * np.cross(n, p[(e + 1) % 3] - p[e])
                k = 0
                for i in range(m):
                    u, v = a[i], a[(i + 1) % m]
                    du, dv = np.dot(u - p[e], inward), np.dot(v - p[e], inward)
                    if du >= 0:
                        b[k] = u
                        k += 1
                    if (du > 0 and dv < 0) or (du < 0 and dv > 0):
                        b[k] = u + (v - u) * (du / (du - dv))
                        k += 1
                a[:k] = b[:k]
                m = k
                if m == 0:
                    break
            vector = np.zeros(3)
            for i in range(1, m - 1):
                vector += np.cross(a[i] - a[0], a[i + 1] - a[0])
            total += 0.5 * abs(np.dot(vector, n))
    return total
