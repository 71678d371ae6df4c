"""Compiled: which leaves border on each other."""

import numpy as np

from lib.core.compiled import njit
from lib.picture.leaves_kernels import LeafArrays
from lib.picture.pixels_kernels import PixelArrays


@njit()
def lowest_beside(leaves: LeafArrays, pixels: PixelArrays):
    """(K,) the lowest level among the leaves that touch each leaf on its facet."""
    first, last, level, _ = leaves
    x, y, facet, number = pixels.x, pixels.y, pixels.facet, pixels.number
    H, W = number.shape
    of = np.empty(len(x), np.int64)
    for i in range(len(first)):
        of[first[i] : last[i]] = level[i]
    lowest = level.copy()
    for i in range(len(first)):
        for j in range(first[i], last[i]):
            for step in range(4):
                a = x[j] + (1 if step == 0 else -1 if step == 1 else 0)
                b = y[j] + (1 if step == 2 else -1 if step == 3 else 0)
                if 0 <= a < W and 0 <= b < H and number[b, a] >= 0 and facet[number[b, a]] == facet[j]:
                    lowest[i] = min(lowest[i], of[number[b, a]])
    return lowest


@njit()
def bounds(p, first, last):
    """(K, 3) the lowest and the highest coordinates of the points p[first:last] of each leaf."""
    low, high = np.empty((len(first), 3)), np.empty((len(first), 3))
    for i in range(len(first)):
        for d in range(3):
            low[i, d], high[i, d] = p[first[i], d], p[first[i], d]
            for k in range(first[i], last[i]):
                low[i, d] = min(low[i, d], p[k, d])
                high[i, d] = max(high[i, d], p[k, d])
    return low, high
