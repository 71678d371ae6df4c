"""Compiled: the frontiers between regions move, pixel by pixel and by whole rows."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit
from lib.vision.segmentation_kernels import sums

REACH = 3  # pixels to either side along a row from which it takes labels
MOST = 10  # labels among which a pixel of a row chooses
ROUNDS = 100  # of pixels that move; 10 are usual


# What is asked of each pixel is inlined by numba. A call counts all its arrays in and out: 1.5 times slower.

# -- pixel by pixel


@njit()
def relabel(f, labels, n, weight):
    """Pixels move, in place, to the neighbouring region that lowers E most; returns how many did.

    Regions may fall apart by it, which only helps. A pixel that moves has its neighbours looked at again.
    """
    H, W, _ = f.shape
    regions = sums(f, labels, n)
    queue, m = frontier(labels)
    later = np.empty(H * W, np.int32)
    waiting = np.zeros(H * W, np.bool_)
    for i in range(m):
        waiting[queue[i]] = True
    near = np.empty(4, np.int32)
    moved = 0
    for _ in range(ROUNDS):
        asked = 0
        for i in range(m):
            waiting[queue[i]] = False
            y, x = queue[i] // W, queue[i] % W
            to = best_region(f, labels, regions, weight, y, x, near)
            if to >= 0:
                move(f, labels, regions, y, x, to)
                asked = ask_neighbours(labels.shape, waiting, later, asked, y, x)
                moved += 1
        queue, later = later, queue
        m = asked
        if not m:
            break
    return moved


@njit()
def frontier(labels):
    """Flat pixels with a neighbour in another region, (H W,) of which the first are filled, and their number."""
    H, W = labels.shape
    pixels = np.empty(H * W, np.int32)
    m = 0
    for y in range(H):
        for x in range(W):
            k = labels[y, x]
            if (
                (x and labels[y, x - 1] != k)
                or (y and labels[y - 1, x] != k)
                or (x + 1 < W and labels[y, x + 1] != k)
                or (y + 1 < H and labels[y + 1, x] != k)
            ):
                pixels[m] = y * W + x
                m += 1
    return pixels, m


@njit(inline="always")
def labels_around(labels, y, x, near):
    """The labels of the up to four neighbours, into near; their number."""
    H, W = labels.shape
    k = 0
    for j in range(4):
        yy, xx = y + (j == 0) - (j == 1), x + (j == 2) - (j == 3)
        if 0 <= yy < H and 0 <= xx < W:
            near[k] = labels[yy, xx]
            k += 1
    return k


@njit(inline="always")
def squared_distance(f, y, x, regions, a):
    """|z - mean of region a|^2 of a pixel."""
    d = 0.0
    for c in range(f.shape[2]):
        d += (f[y, x, c] - regions.total[a, c] / regions.count[a]) ** 2
    return d


@njit(inline="always")
def best_region(f, labels, regions, weight, y, x, near):
    """The neighbouring region to which the pixel moves to lower E most, or -1.

    To take z from region a changes E by -|z - mean_a|^2 n_a / (n_a - 1), to give it to b by
    |z - mean_b|^2 n_b / (n_b + 1), with the means before the move. Both are exact.
    """
    count = regions.count
    a = labels[y, x]
    if count[a] == 1:  # merging has looked at that
        return -1
    k = labels_around(labels, y, x, near)
    same = 0
    for j in range(k):
        same += near[j] == a
    if same == k:
        return -1
    leaving = weight * same - squared_distance(f, y, x, regions, a) * count[a] / (count[a] - 1)
    best, to = -1e-9 * weight, -1
    for j in range(k):
        b = near[j]
        if b == a:
            continue
        change = leaving + squared_distance(f, y, x, regions, b) * count[b] / (count[b] + 1)
        for l in range(k):
            if near[l] == b:
                change -= weight
        if change < best:
            best, to = change, b
    return to


@njit(inline="always")
def move(f, labels, regions, y, x, to):
    """A pixel joins a region, and the sums follow."""
    a = labels[y, x]
    labels[y, x] = to
    regions.count[a] -= 1
    regions.count[to] += 1
    for c in range(f.shape[2]):
        regions.total[a, c] -= f[y, x, c]
        regions.total[to, c] += f[y, x, c]


@njit(inline="always")
def ask_neighbours(shape, waiting, later, asked, y, x):
    """The neighbours that do not wait already are looked at in the next round; returns how many that has now."""
    H, W = shape
    for j in range(4):
        yy, xx = y + (j == 0) - (j == 1), x + (j == 2) - (j == 3)
        if 0 <= yy < H and 0 <= xx < W and not waiting[yy * W + xx]:
            waiting[yy * W + xx] = True
            later[asked] = yy * W + xx
            asked += 1
    return asked


# -- by whole rows


class Row(NamedTuple):
    """The labels among which each pixel of a row chooses, and Viterbi's memory of them."""

    choice: np.ndarray  # (W, MOST) int32: labels, the pixel's own first
    number: np.ndarray  # (W,) int32: how many of them
    back: np.ndarray  # (W, MOST) int8: the best choice of the pixel before
    cost: np.ndarray  # (MOST,): least cost up to this pixel with each of its choices
    last: np.ndarray  # (MOST,): the same of the pixel before, less the least


@njit()
def move_rows(f, labels, n, weight):
    """Each row in turn takes, in place, the labels that make E least, means and other rows held.

    A pixel chooses among up to MOST labels around it.
    """
    W = f.shape[1]
    count, mean = sums(f, labels, n)
    for k in range(n):
        for c in range(f.shape[2]):
            mean[k, c] /= count[k]
    row = Row(
        np.empty((W, MOST), np.int32),
        np.empty(W, np.int32),
        np.empty((W, MOST), np.int8),
        np.empty(MOST),
        np.empty(MOST),
    )
    for y in range(f.shape[0]):
        if collect_choices(labels, y, row):
            best = viterbi(f, labels, mean, weight, y, row)
            for x in range(W - 1, -1, -1):
                labels[y, x] = row.choice[x, best]
                best = row.back[x, best]


@njit()
def collect_choices(labels, y, row):
    """The labels around each pixel of row y: its own, REACH along the row, above and below. Has any pixel a choice?"""
    H, W = labels.shape
    choice = row.choice
    busy = False
    for x in range(W):
        m = 1
        choice[x, 0] = labels[y, x]
        for j in range(-REACH - 1, REACH + 2):  # the first and the last: above and below
            yy, xx = (y, x + j) if abs(j) <= REACH else (y + (1 if j > 0 else -1), x)
            if 0 <= yy < H and 0 <= xx < W and m < MOST:
                seen = False
                for i in range(m):
                    seen |= choice[x, i] == labels[yy, xx]
                if not seen:
                    choice[x, m] = labels[yy, xx]
                    m += 1
        row.number[x] = m
        busy |= m > 1
    return busy


@njit()
def viterbi(f, labels, mean, weight, y, row):
    """Fills row.back from left to right; returns the last pixel's best choice.

    The least cost up to x with label l is that of the pixel itself and of its frontier above and below, and the least
    before: with l there too, or with any label and weight. Costs are kept less the least.
    """
    cost, last, number = row.cost, row.last, row.number
    best = 0
    for x in range(f.shape[1]):
        m = number[x]
        for i in range(m):
            label = row.choice[x, i]
            d = own_cost(f, labels, mean, weight, y, x, label) if m > 1 else 0.0
            if x:
                least, row.back[x, i] = weight, best
                for j in range(number[x - 1]):
                    if row.choice[x - 1, j] == label and last[j] <= least:
                        least, row.back[x, i] = last[j], j
                d += least
            cost[i] = d
        best = np.argmin(cost[:m])
        for i in range(m):
            last[i] = cost[i] - cost[best]
    return best


@njit(inline="always")
def own_cost(f, labels, mean, weight, y, x, label):
    """What the pixel costs with that label, its neighbours along the row apart."""
    d = 0.0
    for c in range(f.shape[2]):
        d += (f[y, x, c] - mean[label, c]) ** 2
    return d + weight * (
        (y > 0 and labels[y - 1, x] != label) + (y + 1 < labels.shape[0] and labels[y + 1, x] != label)
    )
