"""§2.1 Segmentation: minimises equation 2.1, the squared error of a piecewise constant picture plus lambda times its frontiers.

A first version: ADMM over exact rows and columns, then merging and relabelling of the frontiers.
"""
import numpy as np
from numba import njit, prange

@njit(cache=True, fastmath=False)
def line(z, n, C, gamma, S, Q, B, first, cand, keep, recip, out):
    """one line: PELT. z (n, C) flat view"""
    for c in range(C):
        S[0, c] = 0.0
    Q[0] = 0.0
    for i in range(n):
        q = 0.0
        for c in range(C):
            S[i + 1, c] = S[i, c] + z[i, c]
            q += z[i, c] * z[i, c]
        Q[i + 1] = Q[i] + q
    B[0] = -gamma
    m = 0
    for r in range(1, n + 1):
        cand[m] = r - 1           # segment starts at l = r-1 (0-based), cost B[l] + gamma + d
        m += 1
        best = 1e300; at = 0
        for k in range(m):
            l = cand[k]
            d = 0.0
            for c in range(C):
                t = S[r, c] - S[l, c]
                d += t * t
            d = B[l] + (Q[r] - Q[l]) - d * recip[r - l]
            keep[k] = d
            if d < best:
                best = d; at = l
        best += gamma
        B[r] = best; first[r] = at
        j = 0
        for k in range(m):
            if keep[k] <= best:
                cand[j] = cand[k]; j += 1
        m = j
    r = n
    while r > 0:
        l = first[r]
        for c in range(C):
            t = (S[r, c] - S[l, c]) * recip[r - l]
            for i in range(l, r):
                out[i, c] = t
        r = l

@njit(cache=True, parallel=True)
def lines(z, gamma, out):
    H, W, C = z.shape
    recip = np.empty(W + 1)
    recip[0] = 0
    for i in range(1, W + 1):
        recip[i] = 1.0 / i
    K = 8 if H >= 8 else H
    for chunk in prange(K):
        S = np.empty((W + 1, C)); Q = np.empty(W + 1); B = np.empty(W + 1)
        first = np.empty(W + 1, np.int32); cand = np.empty(W + 1, np.int32); keep = np.empty(W + 1)
        for y in range(chunk, H, K):
            line(z[y], W, C, gamma, S, Q, B, first, cand, keep, recip, out[y])

def admm(f, gamma, mu0=1e-2, step=2.0, stop=1e-10, maxit=100, trace=None):
    """f (H, W, C)."""
    H, W, C = f.shape
    mu = mu0 * gamma
    u = np.empty_like(f); vt = np.empty((W, H, C)); 
    v = f.copy(); lam = np.zeros_like(f)
    norm = (f ** 2).sum()
    for it in range(maxit):
        z = (f + mu * v - lam) / (1 + mu)
        lines(z, 2 * gamma / (1 + mu), u)
        z = (f + mu * u + lam) / (1 + mu)
        lines(np.ascontiguousarray(z.transpose(1, 0, 2)), 2 * gamma / (1 + mu), vt)
        v = np.ascontiguousarray(vt.transpose(1, 0, 2))
        err = ((u - v) ** 2).sum() 
        lam += mu * (u - v)
        mu *= step
        if trace: trace(it, u, v, err)
        if err < stop * norm: break
    return u, v, it + 1

@njit(cache=True)
def find(p, i):
    while p[i] != i:
        p[i] = p[p[i]]
        i = p[i]
    return i

@njit(cache=True)
def components(lab):
    """4-connected parts of equal label, numbered from 0 in scan order"""
    H, W = lab.shape
    p = np.arange(H * W)
    for y in range(H):
        for x in range(W):
            i = y * W + x
            if x and lab[y, x] == lab[y, x - 1]:
                a = find(p, i - 1); b = find(p, i)
                if a < b: p[b] = a
                else: p[a] = b
            if y and lab[y, x] == lab[y - 1, x]:
                a = find(p, i - W); b = find(p, i)
                if a < b: p[b] = a
                else: p[a] = b
    out = np.empty((H, W), np.int32)
    k = 0
    for i in range(H * W):
        r = find(p, i)
        if r == i:
            out[i // W, i % W] = k; k += 1
        else:
            out[i // W, i % W] = out[r // W, r % W]
    return out, k

@njit(cache=True)
def joined(u, v, tol):
    """components of links: horizontal where u equal, vertical where v equal"""
    H, W, C = u.shape
    p = np.arange(H * W)
    for y in range(H):
        for x in range(W):
            i = y * W + x
            if x:
                d = 0.0
                for c in range(C):
                    d = max(d, abs(u[y, x, c] - u[y, x - 1, c]))
                if d <= tol:
                    a = find(p, i - 1); b = find(p, i)
                    if a < b: p[b] = a
                    else: p[a] = b
            if y:
                d = 0.0
                for c in range(C):
                    d = max(d, abs(v[y, x, c] - v[y - 1, x, c]))
                if d <= tol:
                    a = find(p, i - W); b = find(p, i)
                    if a < b: p[b] = a
                    else: p[a] = b
    out = np.empty((H, W), np.int32)
    k = 0
    for i in range(H * W):
        r = find(p, i)
        if r == i:
            out[i // W, i % W] = k; k += 1
        else:
            out[i // W, i % W] = out[r // W, r % W]
    return out, k

@njit(cache=True)
def sums(f, lab, n):
    H, W, C = f.shape
    cnt = np.zeros(n); S = np.zeros((n, C))
    for y in range(H):
        for x in range(W):
            k = lab[y, x]; cnt[k] += 1
            for c in range(C): S[k, c] += f[y, x, c]
    return cnt, S

@njit(cache=True)
def energy(f, lab, lam):
    H, W, C = f.shape
    n = lab.max() + 1
    cnt, S = sums(f, lab, n)
    e = 0.0; L = 0
    for y in range(H):
        for x in range(W):
            k = lab[y, x]
            for c in range(C):
                e += (f[y, x, c] - S[k, c] / cnt[k]) ** 2
            if x and lab[y, x - 1] != k: L += 1
            if y and lab[y - 1, x] != k: L += 1
    return e + lam * L

# ---- merging

@njit(cache=True)
def slot(keys, mask, key):
    h = (key * 0x9E3779B97F4A7C15 >> 20) & mask      # int64 wraps
    while keys[h] != -1 and keys[h] != key:
        h = (h + 1) & mask
    return h

@njit(cache=True)
def up(hk, he, i):
    k = hk[i]; e = he[i]
    while i:
        j = (i - 1) >> 1
        if hk[j] <= k: break
        hk[i] = hk[j]; he[i] = he[j]; i = j
    hk[i] = k; he[i] = e

@njit(cache=True)
def down(hk, he, n):
    """after the last was put at the top"""
    k = hk[0]; e = he[0]; i = 0
    while True:
        j = 2 * i + 1
        if j >= n: break
        if j + 1 < n and hk[j + 1] < hk[j]: j += 1
        if hk[j] >= k: break
        hk[i] = hk[j]; he[i] = he[j]; i = j
    hk[i] = k; he[i] = e

@njit(cache=True)
def threshold(cnt, S, a, b, length, C):
    d = 0.0
    for c in range(C):
        t = S[a, c] / cnt[a] - S[b, c] / cnt[b]
        d += t * t
    return d * cnt[a] * cnt[b] / ((cnt[a] + cnt[b]) * length)

@njit(cache=True)
def merge(f, lab, n, lam):
    """greedy merging of the partition lab (ids 0..n-1) up to lam. -> root of each region"""
    H, W, C = f.shape
    cnt, S = sums(f, lab, n)
    # count boundary pairs
    pairs = 0
    for y in range(H):
        for x in range(W):
            if x and lab[y, x] != lab[y, x - 1]: pairs += 1
            if y and lab[y, x] != lab[y - 1, x]: pairs += 1
    size = 1024
    while size < 2 * pairs: size *= 2
    mask = size - 1
    keys = np.full(size, -1, np.int64); val = np.empty(size, np.int32)
    ends = np.empty((pairs, 2), np.int32); length = np.zeros(pairs)
    E = 0
    for y in range(H):
        for x in range(W):
            for k in range(2):
                if k == 0:
                    if x == 0: continue
                    a = lab[y, x]; b = lab[y, x - 1]
                else:
                    if y == 0: continue
                    a = lab[y, x]; b = lab[y - 1, x]
                if a == b: continue
                if a > b: a, b = b, a
                h = slot(keys, mask, np.int64(a) * n + b)
                if keys[h] == -1:
                    keys[h] = np.int64(a) * n + b; val[h] = E
                    ends[E, 0] = a; ends[E, 1] = b; E += 1
                length[val[h]] += 1
    nxt = np.empty(2 * E, np.int32); head = np.full(n, -1, np.int32); tail = np.full(n, -1, np.int32)
    deg = np.zeros(n, np.int32)
    for e in range(E):
        for s in range(2):
            a = ends[e, s]
            nxt[2 * e + s] = head[a]
            if head[a] == -1: tail[a] = 2 * e + s
            head[a] = 2 * e + s; deg[a] += 1
    cur = np.empty(E)         # current key in heap; -1 dead
    hk = np.empty(2 * E + 64); he = np.empty(2 * E + 64, np.int32); m = 0
    for e in range(E):
        t = threshold(cnt, S, ends[e, 0], ends[e, 1], length[e], C)
        cur[e] = t
        if t < lam:
            hk[m] = t; he[m] = e; up(hk, he, m); m += 1
    root = np.arange(n)
    since = np.zeros(n, np.int32)
    while m:
        k = hk[0]; e = he[0]
        m -= 1
        if m:
            hk[0] = hk[m]; he[0] = he[m]; down(hk, he, m)
        if cur[e] != k: continue
        a = ends[e, 0]; b = ends[e, 1]
        t = threshold(cnt, S, a, b, length[e], C)
        if t > k * (1 + 1e-12) :
            cur[e] = t
            if t < lam:
                hk[m] = t; he[m] = e; up(hk, he, m); m += 1
            continue
        if deg[a] < deg[b]: a, b = b, a          # b into a
        root[b] = a
        cur[e] = -1.0
        cnt[a] += cnt[b]
        for c in range(C): S[a, c] += S[b, c]
        since[a] += 1 + since[b]
        h = head[b]
        while h != -1:
            following = nxt[h]
            g = h >> 1
            if cur[g] != -1.0:
                o = ends[g, 1 - (h & 1)]
                lo = min(a, o); hi = max(a, o)
                j = slot(keys, mask, np.int64(lo) * n + hi)
                if keys[j] != -1 and cur[val[j]] != -1.0:
                    q = val[j]
                    length[q] += length[g]
                    cur[g] = -1.0
                    g = q
                else:
                    keys[j] = np.int64(lo) * n + hi; val[j] = g
                    ends[g, h & 1] = a
                    nxt[h] = head[a]; head[a] = h; deg[a] += 1
                t = threshold(cnt, S, a, o, length[g], C)
                if t != cur[g]:
                    cur[g] = t
                    if t < lam:
                        if m == len(hk):
                            hk, he = grow(hk, he)
                        hk[m] = t; he[m] = g; up(hk, he, m); m += 1
            h = following
        if deg[a] < 64 or since[a] * 8 > deg[a]:
            since[a] = 0
            h = head[a]; d = 0; last = -1; head[a] = -1
            while h != -1:
                following = nxt[h]
                g = h >> 1
                if cur[g] != -1.0:
                    d += 1
                    nxt[h] = head[a]; head[a] = h
                    t = threshold(cnt, S, a, ends[g, 1 - (h & 1)], length[g], C)
                    if t < cur[g] or (t < lam and cur[g] >= lam):
                        cur[g] = t
                        if t < lam:
                            if m == len(hk):
                                hk, he = grow(hk, he)
                            hk[m] = t; he[m] = g; up(hk, he, m); m += 1
                h = following
            deg[a] = d
    new = np.full(n, -1, np.int32)
    k = 0
    out = np.empty((H, W), np.int32)
    for y in range(H):
        for x in range(W):
            r = lab[y, x]
            while root[r] != r: 
                root[r] = root[root[r]]
                r = root[r]
            if new[r] < 0: new[r] = k; k += 1
            out[y, x] = new[r]
    return out, k

@njit(cache=True)
def grow(hk, he):
    a = np.empty(2 * len(hk)); a[:len(hk)] = hk
    b = np.empty(2 * len(he), np.int32); b[:len(he)] = he
    return a, b

# ---- relabelling

@njit(cache=True)
def relabel(f, lab, n, lam, rounds):
    """ICM with exact changes, in place; labels may fall apart"""
    H, W, C = f.shape
    cnt, S = sums(f, lab, n)
    N = H * W
    queue = np.empty(N, np.int32); nextq = np.empty(N, np.int32)
    inq = np.zeros((H, W), np.uint8)
    m = 0
    for y in range(H):
        for x in range(W):
            k = lab[y, x]
            if (x and lab[y, x - 1] != k) or (y and lab[y - 1, x] != k) or (x + 1 < W and lab[y, x + 1] != k) or (y + 1 < H and lab[y + 1, x] != k):
                queue[m] = y * W + x; m += 1; inq[y, x] = 1
    moved = 0
    cl = np.empty(4, np.int32)
    for rnd in range(rounds):
        q = 0
        for i in range(m):
            y = queue[i] // W; x = queue[i] % W
            inq[y, x] = 0
            a = lab[y, x]
            if cnt[a] <= 1: continue
            same = 0; nn = 0; nb = 0
            if x: cl[nb] = lab[y, x - 1]; nb += 1
            if x + 1 < W: cl[nb] = lab[y, x + 1]; nb += 1
            if y: cl[nb] = lab[y - 1, x]; nb += 1
            if y + 1 < H: cl[nb] = lab[y + 1, x]; nb += 1
            for j in range(nb):
                if cl[j] == a: same += 1
            if same == nb: continue
            d = 0.0
            for c in range(C):
                t = f[y, x, c] - S[a, c] / cnt[a]
                d += t * t
            out = -d * cnt[a] / (cnt[a] - 1) + lam * same
            best = -1e-12; to = -1
            for j in range(nb):
                b = cl[j]
                if b == a: continue
                w = 0
                for g in range(nb):
                    if cl[g] == b: w += 1
                d = 0.0
                for c in range(C):
                    t = f[y, x, c] - S[b, c] / cnt[b]
                    d += t * t
                d = out + d * cnt[b] / (cnt[b] + 1) - lam * w
                if d < best: best = d; to = b
            if to >= 0:
                moved += 1
                cnt[a] -= 1; cnt[to] += 1
                for c in range(C):
                    S[a, c] -= f[y, x, c]; S[to, c] += f[y, x, c]
                lab[y, x] = to
                for j in range(4):
                    yy = y + (j == 0) - (j == 1); xx = x + (j == 2) - (j == 3)
                    if 0 <= yy < H and 0 <= xx < W and inq[yy, xx] == 0 :
                        inq[yy, xx] = 1; nextq[q] = yy * W + xx; q += 1
        queue, nextq = nextq, queue
        m = q
        if m == 0: break
    return moved


def noise(values):
    """Standard deviation per channel-mean of white noise, from the median of second differences (Immerkaer's mask, robust)."""
    v = values
    if min(v.shape[:2]) < 3:
        return 0.0
    d = v[2:, 2:] - 2 * v[2:, 1:-1] + v[2:, :-2] - 2 * (v[1:-1, 2:] - 2 * v[1:-1, 1:-1] + v[1:-1, :-2]) + v[:-2, 2:] - 2 * v[:-2, 1:-1] + v[:-2, :-2]
    return float(np.median(np.abs(d)) / 0.6745 / 6)


def segment(values, lam):
    """(H, W) labels from 1, each one 4-connected region, of the (H, W, C) picture."""
    f = np.ascontiguousarray(values, float)
    H, W, _ = f.shape
    if lam == 0:
        labels, n = joined(f, f, 0.0)
        return labels + 1
    if lam > f.size:
        return np.ones((H, W), np.int32)
    u, v, _ = admm(f, lam)
    labels, n = joined(u, v, 1e-9)
    labels, n = merge(f, labels, n, lam)
    while relabel(f, labels, n, lam, 100):
        labels, n = components(labels)
        labels, n = merge(f, labels, n, lam)
    labels, n = components(labels)
    return labels + 1
