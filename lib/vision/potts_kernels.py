"""Compiled: the Potts problem of one line, exact, and of all rows and columns of a picture."""

import numpy as np

from lib.core.compiled import njit, prange

FAST = {"nnan", "ninf", "nsz", "reassoc", "contract", "arcp"}


@njit(fastmath=FAST, error_model="numpy")
def potts(z, C, n, gamma, first, work, bits):
    """The exact minimum of |x - z|^2 + gamma x jumps for one line.

    z : (C, n), becomes x
    first : (n + 1,) int32, out: where the segment that ends before r starts
    work : (6, n + 1), of which bits is the last row, seen as int64

    B(r) = min over l of B(l) + gamma + |z - mean|^2 on l..r-1. An l with B(l) + |z - mean|^2 > B(r) is out for ever
    (PELT: Killick, Fearnhead and Eckley 2012).
    """
    # The candidates l, packed, so that the loops over them run as vectors.
    a, at, s0, s1, s2, cost = work[0], work[1], work[2], work[3], work[4], work[5]
    Q = S0 = S1 = S2 = 0.0
    m = 0
    B = -gamma
    due = 16
    for r in range(1, n + 1):
        a[m], at[m], s0[m], s1[m], s2[m] = B - Q, r - 1, S0, S1, S2
        m += 1
        t = z[0, r - 1]
        S0 += t
        Q += t * t
        if C == 3:
            t = z[1, r - 1]
            S1 += t
            Q += t * t
            t = z[2, r - 1]
            S2 += t
            Q += t * t
        # base makes every cost positive. Then the bits are ordered as the costs, and their minimum is a vector loop.
        base = Q + gamma + 1.0
        end = float(r)
        if C == 3:
            for k in range(m):
                x, y, w = S0 - s0[k], S1 - s1[k], S2 - s2[k]
                cost[k] = a[k] + base - (x * x + y * y + w * w) / (end - at[k])
        else:
            for k in range(m):
                x = S0 - s0[k]
                cost[k] = a[k] + base - x * x / (end - at[k])
        least = bits[0]
        for k in range(m):
            least = min(least, bits[k])
        k = m - 1
        while bits[k] != least:
            k -= 1
        first[r] = int(at[k])
        best = cost[k] + gamma
        B = best - base + Q
        if m >= due:
            j = 0
            for k in range(m):
                a[j], at[j], s0[j], s1[j], s2[j] = a[k], at[k], s0[k], s1[k], s2[k]
                j += cost[k] <= best
            m = j
            due = m + 8 + m // 4
    r = n
    while r > 0:
        l = first[r]
        for c in range(C):
            t = 0.0
            for i in range(l, r):
                t += z[c, i]
            t /= r - l
            for i in range(l, r):
                z[c, i] = t
        r = l


@njit(parallel=True, error_model="numpy")
def rows(f, v, dual, mu, gamma, u):
    """u <- argmin gamma x jumps along rows + |u - f|^2 / 2 + mu |u - v + dual / mu|^2 / 2."""
    H, W, C = f.shape
    w = 1 / (1 + mu)
    chunks = 16
    for chunk in prange(chunks):
        z = np.empty((C, W))
        first = np.empty(W + 1, np.int32)
        work = np.empty((6, W + 1))
        bits = work[5].view(np.int64)
        for y in range(chunk * H // chunks, (chunk + 1) * H // chunks):
            for x in range(W):
                for c in range(C):
                    z[c, x] = (f[y, x, c] + mu * v[y, x, c] - dual[y, x, c]) * w
            potts(z, C, W, 2 * gamma * w, first, work, bits)
            for x in range(W):
                for c in range(C):
                    u[y, x, c] = z[c, x]


@njit(parallel=True, error_model="numpy")
def columns(f, u, dual, mu, gamma, v):
    """The same for v along columns, eight at a time for the cache; then dual += mu (u - v).  Returns |u - v|^2."""
    H, W, C = f.shape
    w = 1 / (1 + mu)
    chunks = (W + 7) // 8
    apart = np.zeros(chunks)
    for chunk in prange(chunks):
        z = np.empty((8, C, H))
        first = np.empty(H + 1, np.int32)
        work = np.empty((6, H + 1))
        bits = work[5].view(np.int64)
        x0 = 8 * chunk
        width = min(8, W - x0)
        for y in range(H):
            for i in range(width):
                for c in range(C):
                    z[i, c, y] = (f[y, x0 + i, c] + mu * u[y, x0 + i, c] + dual[y, x0 + i, c]) * w
        for i in range(width):
            potts(z[i], C, H, 2 * gamma * w, first, work, bits)
        total = 0.0
        for y in range(H):
            for i in range(width):
                for c in range(C):
                    t = z[i, c, y]
                    d = u[y, x0 + i, c] - t
                    v[y, x0 + i, c] = t
                    dual[y, x0 + i, c] += mu * d
                    total += d * d
        apart[chunk] = total
    return apart.sum()
