"""Compiled: labels of connected regions, the sums over each region, the energy of equation 2.1."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit


class RegionSums(NamedTuple):
    """What equation 2.1 needs to know of each region."""

    count: np.ndarray  # (n,) float: pixels
    total: np.ndarray  # (n, C): sum of their values


@njit()
def find(parent, i):
    """The root of i in a forest; parent[root] = root. Paths are halved on the way."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit()
def join(parent, i, j):
    """The trees of i and j become one; its root is the smaller of the two."""
    i, j = find(parent, i), find(parent, j)
    if i < j:
        parent[j] = i
    else:
        parent[i] = j


@njit()
def numbered(parent, H, W):
    """Labels from 0 in the order of their first pixels, and their number."""
    labels = np.empty(H * W, np.int32)
    n = 0
    for i in range(H * W):
        r = find(parent, i)  # the root is the first pixel
        if r == i:
            labels[i] = n
            n += 1
        else:
            labels[i] = labels[r]
    return labels.reshape(H, W), n


@njit()
def components(labels):
    """The 4-connected parts of equal label."""
    H, W = labels.shape
    parent = np.arange(H * W)
    for y in range(H):
        for x in range(W):
            if x and labels[y, x] == labels[y, x - 1]:
                join(parent, y * W + x, y * W + x - 1)
            if y and labels[y, x] == labels[y - 1, x]:
                join(parent, y * W + x, y * W + x - W)
    return numbered(parent, H, W)


@njit()
def joined(u, v, slack):
    """Labels from 0 of the areas where u and v are constant, and their number.

    Neighbours in a row belong together where u does not jump, in a column where v does not, and the other one changes
    by at most slack. Without that, where u and v still differ a little, a gap of one pixel in u would join regions
    that v holds apart.
    """
    H, W, C = u.shape
    parent = np.arange(H * W)
    for y in range(H):
        for x in range(W):
            for down in range(2):
                if (y if down else x) == 0:
                    continue
                du = dv = 0.0
                for c in range(C):
                    du = max(du, abs(u[y, x, c] - u[y - down, x - 1 + down, c]))
                    dv = max(dv, abs(v[y, x, c] - v[y - down, x - 1 + down, c]))
                along, across = (dv, du) if down else (du, dv)
                if along == 0 and across <= slack:
                    join(parent, y * W + x, (y - down) * W + x - 1 + down)
    return numbered(parent, H, W)


@njit()
def sums(f, labels, n):
    """RegionSums of the picture f (H, W, C) and the labels 0 .. n - 1."""
    H, W, C = f.shape
    count = np.zeros(n)
    total = np.zeros((n, C))
    for y in range(H):
        for x in range(W):
            count[labels[y, x]] += 1
            for c in range(C):
                total[labels[y, x], c] += f[y, x, c]
    return RegionSums(count, total)


@njit()
def energy(f, labels, weight):
    """Equation 2.1."""
    H, W, C = f.shape
    count, total = sums(f, labels, labels.max() + 1)
    error = 0.0
    frontier = 0
    for y in range(H):
        for x in range(W):
            k = labels[y, x]
            for c in range(C):
                error += (f[y, x, c] - total[k, c] / count[k]) ** 2
            frontier += (x > 0 and labels[y, x - 1] != k) + (y > 0 and labels[y - 1, x] != k)
    return error + weight * frontier
