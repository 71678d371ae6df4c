"""Compiled parts of surfaces.py."""

import numpy as np

from lib.core.compiled import njit

NEAR, FAR = 1.0, 6.0  # px from the border, of the pixels on its two sides that are compared
FEWEST = 12  # of them on either side


@njit()
def borders(labels, cell):
    """(n, 5) int64: (a, b, cell, y, x) of each pair of neighbours with labels a < b; x and y are twice its middle's."""
    H, W = labels.shape
    across = (W + cell - 1) // cell
    out = np.empty((2 * H * W, 5), np.int64)
    n = 0
    for y in range(H):
        for x in range(W):
            for k in range(2):
                v, u = y + k, x + 1 - k
                if v < H and u < W and labels[v, u] != labels[y, x]:
                    a, b = labels[y, x], labels[v, u]
                    out[n, 0], out[n, 1] = min(a, b), max(a, b)
                    out[n, 2] = (y // cell) * across + x // cell
                    out[n, 3], out[n, 4] = y + v, x + u
                    n += 1
    return out[:n].copy()


@njit()
def steps(f, labels, rows, first, count):
    """For each window of a border, (windows, 3, C): the step between its two sides, its standard deviation, and the
    change per pixel of the gradient that both share. NaN where either side has too few pixels.

    f : (H, W, C);  rows : of borders(), sorted by window;  first, count : of each window's rows
    """
    H, W, C = f.shape
    out = np.full((len(first), 3, C), np.nan)
    most = int(4 * FAR * FAR) * 8
    A, F = np.empty((most, 4)), np.empty((most, C))
    for w in range(len(first)):
        mine = rows[first[w] : first[w] + count[w]]
        n, of_b = sides(f, labels, mine, True, A, F)
        if of_b < FEWEST or n - of_b < FEWEST:  # what lies behind a thin region: its next borders would be seen too
            n, of_b = sides(f, labels, mine, False, A, F)
        if of_b < FEWEST or n - of_b < FEWEST:
            continue
        D, values = np.ascontiguousarray(A[:n, :4]), np.ascontiguousarray(F[:n])
        G = D.T @ D
        if np.linalg.cond(G) > 1e10:
            continue
        inverse = np.linalg.inv(G)
        fit = inverse @ (D.T @ values)
        left = values - D @ fit
        for c in range(C):
            out[w, 0, c] = fit[3, c]
            out[w, 1, c] = np.sqrt((left[:, c] ** 2).sum() / (n - 4) * inverse[3, 3])
            out[w, 2, c] = np.sqrt(fit[1, c] ** 2 + fit[2, c] ** 2)
    return out


@njit()
def sides(f, labels, mine, own, A, F):
    """The pixels on both sides of a window's border: their number, and how many are on the side of b.

    mine : its rows;  own : only pixels of a and b, else of any label, on the side of the nearest row
    A : (n, 4) out, (1, y, x, is on the side of b);  F : (n, C) out
    """
    H, W, C = f.shape
    a, b = mine[0, 0], mine[0, 1]
    y0, y1 = max(mine[:, 3].min() // 2 - int(FAR), 0), min(mine[:, 3].max() // 2 + int(FAR) + 2, H)
    x0, x1 = max(mine[:, 4].min() // 2 - int(FAR), 0), min(mine[:, 4].max() // 2 + int(FAR) + 2, W)
    n, of_b = 0, 0
    for y in range(y0, y1):
        for x in range(x0, x1):
            label = labels[y, x]
            if n == len(A) or (own and label != a and label != b):
                continue
            d2, at = np.inf, 0
            for k in range(len(mine)):
                dy, dx = y - mine[k, 3] / 2, x - mine[k, 4] / 2
                if dy * dy + dx * dx < d2:
                    d2, at = dy * dy + dx * dx, k
            if not NEAR * NEAR <= d2 <= FAR * FAR:
                continue
            is_b = label == b
            if not own:
                upright = mine[at, 3] % 2  # the row's two pixels are one above the other
                beyond = y > mine[at, 3] / 2 if upright else x > mine[at, 4] / 2
                last = labels[(mine[at, 3] + upright) // 2, (mine[at, 4] + 1 - upright) // 2]
                is_b = beyond == (last == b)
            A[n, 0], A[n, 1], A[n, 2], A[n, 3] = 1, y - mine[0, 3] / 2, x - mine[0, 4] / 2, is_b
            F[n] = f[y, x]
            of_b += is_b
            n += 1
    return n, of_b


@njit()
def grow(labels, part):
    """Give each pixel whose part is -1 the part that is nearest by steps inside its own label; those of none stay.

    labels, part : (H, W) int, part is changed
    """
    H, W = labels.shape
    queue = np.empty((H * W, 2), np.int64)
    n = 0
    for y in range(H):
        for x in range(W):
            if part[y, x] >= 0:
                queue[n, 0], queue[n, 1] = y, x
                n += 1
    k = 0
    while k < n:
        y, x = queue[k]
        k += 1
        for v, u in ((y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)):
            if 0 <= v < H and 0 <= u < W and part[v, u] < 0 and labels[v, u] == labels[y, x]:
                part[v, u] = part[y, x]
                queue[n, 0], queue[n, 1] = v, u
                n += 1
