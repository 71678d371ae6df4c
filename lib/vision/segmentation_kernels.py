"""Compiled: Potts in one dimension, merging, relabelling, moves of whole rows."""

import numpy as np

from lib.core.compiled import njit, prange

REACH = 3  # pixels to either side along a row from which it takes labels
FAST = {"nnan", "ninf", "nsz", "reassoc", "contract", "arcp"}


# -- 1. rows and columns, each exact


@njit(fastmath=FAST, error_model="numpy")
def potts(z, C, n, gamma, first, work, bits):
    """The exact minimum of |x - z|^2 + gamma x jumps for one line: z (C, n) becomes x; first[r] is where the segment that ends before r starts.

    B(r) = min over l of B(l) + gamma + |z - mean|^2 on l..r-1; an l with B(l) + |z - mean|^2 > B(r) is out for ever (PELT: Killick, Fearnhead and Eckley 2012).
    """
    a, at, s0, s1, s2, cost = (
        work[0],
        work[1],
        work[2],
        work[3],
        work[4],
        work[5],
    )  # the candidates l, packed, so that the loops over them run as vectors
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
        base = (
            Q + gamma + 1.0
        )  # makes every cost positive: then the bits are ordered as the costs, and their minimum is a vector loop
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


# -- labels


@njit()
def find(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit()
def join(parent, i, j):
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
    """Neighbours in a row belong together where u does not jump, in a column where v does not; and the other, too, changes by less than slack.

    (While u and v still differ a little, a gap of one pixel in u would otherwise join regions that v holds apart.)
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
    H, W, C = f.shape
    count = np.zeros(n)
    total = np.zeros((n, C))
    for y in range(H):
        for x in range(W):
            count[labels[y, x]] += 1
            for c in range(C):
                total[labels[y, x], c] += f[y, x, c]
    return count, total


@njit()
def energy(f, labels, weight):
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


# -- 2. merging


@njit()
def slot(keys, key):
    """Where key stands in the hash table, or the free place for it."""
    mask = len(keys) - 1
    h = (key * 0x9E3779B97F4A7C15 >> 20) & mask
    while keys[h] != -1 and keys[h] != key:
        h = (h + 1) & mask
    return h


@njit()
def push(heap, edge, m, key, e):
    """A heap in two arrays, the least key first; both are replaced where they are full."""
    if m == len(heap):
        heap, edge = np.append(heap, np.empty(m + 64)), np.append(edge, np.empty(m + 64, np.int32))
    i = m
    while i and heap[(i - 1) >> 1] > key:
        heap[i], edge[i] = heap[(i - 1) >> 1], edge[(i - 1) >> 1]
        i = (i - 1) >> 1
    heap[i], edge[i] = key, e
    return heap, edge, m + 1


@njit()
def pop(heap, edge, m):
    """Removes the first; the caller has read it."""
    m -= 1
    key, e = heap[m], edge[m]
    i = 0
    while True:
        j = 2 * i + 1
        if j >= m:
            break
        if j + 1 < m and heap[j + 1] < heap[j]:
            j += 1
        if heap[j] >= key:
            break
        heap[i], edge[i] = heap[j], edge[j]
        i = j
    heap[i], edge[i] = key, e
    return m


@njit()
def merge_price(count, total, a, b, length):
    """The lambda from which merging a and b pays: the rise of the squared error per frontier pair that goes."""
    d = 0.0
    for c in range(total.shape[1]):
        d += (total[a, c] / count[a] - total[b, c] / count[b]) ** 2
    return d * count[a] * count[b] / ((count[a] + count[b]) * length)


@njit()
def merge(f, labels, n, weight):
    """Merges neighbours, the least price first, while the price is below weight.  Labels from 0 and their number.

    Near-linear: each merge walks the edges of the region with fewer of them. The other one's mean hardly changes, so its edges are priced anew only
    once it took in an eighth of them; until then a price that is out of date is seen when its turn comes.
    """
    H, W, C = f.shape
    count, total = sums(f, labels, n)
    pairs = 0
    for y in range(H):
        for x in range(W):
            pairs += (x > 0 and labels[y, x] != labels[y, x - 1]) + (y > 0 and labels[y, x] != labels[y - 1, x])
    size = 1024
    while size < 3 * pairs:
        size *= 2
    keys = np.full(size, -1, np.int64)  # lower label * n + higher label
    held = np.empty(size, np.int32)  # -> edge
    ends = np.empty((pairs, 2), np.int32)
    length = np.zeros(pairs)
    edges = 0
    for y in range(H):
        for x in range(W):
            for down in range(2):
                if (y if down else x) == 0:
                    continue
                a, b = labels[y, x], labels[y - down, x - 1 + down]
                if a == b:
                    continue
                key = np.int64(min(a, b)) * n + max(a, b)
                h = slot(keys, key)
                if keys[h] == -1:
                    keys[h], held[h] = key, edges
                    ends[edges, 0], ends[edges, 1] = a, b
                    edges += 1
                length[held[h]] += 1

    head = np.full(n, -1, np.int32)  # a region's edges: a linked list of half-edges 2 e + side
    after = np.empty(2 * edges, np.int32)
    degree = np.zeros(n, np.int32)
    price = np.empty(edges)  # -1: gone
    heap, edge, m = np.empty(edges + 64), np.empty(edges + 64, np.int32), 0
    for e in range(edges):
        for side in range(2):
            a = ends[e, side]
            after[2 * e + side] = head[a]
            head[a] = 2 * e + side
            degree[a] += 1
        price[e] = merge_price(count, total, ends[e, 0], ends[e, 1], length[e])
        if price[e] < weight:
            heap, edge, m = push(heap, edge, m, price[e], e)

    parent = np.arange(n)
    taken = np.zeros(n, np.int32)
    free = size - edges  # of the table; keys of regions that are gone stay in it
    while m:
        key, e = heap[0], edge[0]
        m = pop(heap, edge, m)
        if price[e] != key:
            continue
        a, b = ends[e, 0], ends[e, 1]
        now = merge_price(count, total, a, b, length[e])
        if now > key * (1 + 1e-12):
            price[e] = now
            if now < weight:
                heap, edge, m = push(heap, edge, m, now, e)
            continue
        if degree[a] < degree[b]:
            a, b = b, a
        parent[b] = a
        price[e] = -1.0
        count[a] += count[b]
        for c in range(C):
            total[a, c] += total[b, c]
        taken[a] += 1 + taken[b]
        half = head[b]
        while half != -1:
            following = after[half]
            g = half >> 1
            if price[g] != -1.0:
                other = ends[g, 1 - (half & 1)]
                key = np.int64(min(a, other)) * n + max(a, other)
                h = slot(keys, key)
                if keys[h] != -1 and price[held[h]] != -1.0:
                    length[held[h]] += length[g]
                    price[g] = -1.0
                    g = held[h]
                else:
                    if keys[h] == -1:
                        free -= 1
                    keys[h], held[h] = key, g
                    ends[g, half & 1] = a
                    after[half] = head[a]
                    head[a] = half
                    degree[a] += 1
                price[g] = merge_price(count, total, a, other, length[g])
                if price[g] < weight:
                    heap, edge, m = push(heap, edge, m, price[g], g)
            half = following
        if degree[a] < 64 or 8 * taken[a] > degree[a]:
            taken[a] = 0
            half = head[a]
            head[a] = -1
            degree[a] = 0
            while half != -1:
                following = after[half]
                g = half >> 1
                if price[g] != -1.0:
                    after[half] = head[a]
                    head[a] = half
                    degree[a] += 1
                    now = merge_price(count, total, a, ends[g, 1 - (half & 1)], length[g])
                    if now < price[g]:
                        price[g] = now
                        if now < weight:
                            heap, edge, m = push(heap, edge, m, now, g)
                half = following
        if 4 * free < size:  # a table that fills up is made anew from the edges that live
            living = 0
            for g in range(edges):
                living += price[g] != -1.0
            keys[:] = -1
            free = size - living
            for g in range(edges):
                if price[g] != -1.0:
                    key = np.int64(min(ends[g, 0], ends[g, 1])) * n + max(ends[g, 0], ends[g, 1])
                    h = slot(keys, key)
                    keys[h], held[h] = key, g

    number = np.full(n, -1, np.int32)
    merged = np.empty((H, W), np.int32)
    k = 0
    for y in range(H):
        for x in range(W):
            r = find(parent, labels[y, x])
            if number[r] < 0:
                number[r] = k
                k += 1
            merged[y, x] = number[r]
    return merged, k


# -- 3. frontiers


@njit()
def relabel(f, labels, n, weight):
    """Pixels move, in place, to the neighbouring region that lowers E most; returns how many did. Regions may fall apart by it, which only helps.

    Taking z from region a costs -|z - mean_a|^2 n_a / (n_a - 1), giving it to b |z - mean_b|^2 n_b / (n_b + 1), means before the move; exact.
    """
    H, W, C = f.shape
    count, total = sums(f, labels, n)
    queue = np.empty(H * W, np.int32)
    later = np.empty(H * W, np.int32)
    waiting = np.zeros(H * W, np.bool_)
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
                queue[m] = y * W + x
                waiting[y * W + x] = True
                m += 1
    moved = 0
    near = np.empty(4, np.int32)  # labels of the neighbours
    for _ in range(100):
        q = 0
        for i in range(m):
            y, x = queue[i] // W, queue[i] % W
            waiting[queue[i]] = False
            a = labels[y, x]
            if count[a] == 1:  # merging has looked at that
                continue
            k = 0
            for j in range(4):
                yy, xx = y + (j == 0) - (j == 1), x + (j == 2) - (j == 3)
                if 0 <= yy < H and 0 <= xx < W:
                    near[k] = labels[yy, xx]
                    k += 1
            same = 0
            for j in range(k):
                same += near[j] == a
            if same == k:
                continue
            d = 0.0
            for c in range(C):
                d += (f[y, x, c] - total[a, c] / count[a]) ** 2
            leaving = weight * same - d * count[a] / (count[a] - 1)
            best, to = -1e-9 * weight, -1
            for j in range(k):
                b = near[j]
                if b == a:
                    continue
                d = 0.0
                for c in range(C):
                    d += (f[y, x, c] - total[b, c] / count[b]) ** 2
                change = leaving + d * count[b] / (count[b] + 1)
                for l in range(k):
                    if near[l] == b:
                        change -= weight
                if change < best:
                    best, to = change, b
            if to < 0:
                continue
            moved += 1
            labels[y, x] = to
            count[a] -= 1
            count[to] += 1
            for c in range(C):
                total[a, c] -= f[y, x, c]
                total[to, c] += f[y, x, c]
            for j in range(4):
                yy, xx = y + (j == 0) - (j == 1), x + (j == 2) - (j == 3)
                if 0 <= yy < H and 0 <= xx < W and not waiting[yy * W + xx]:
                    waiting[yy * W + xx] = True
                    later[q] = yy * W + xx
                    q += 1
        queue, later = later, queue
        m = q
        if not m:
            break
    return moved


@njit()
def move_rows(f, labels, n, weight):
    """Each row in turn takes, in place, the labels that make E least, means and other rows held; a pixel chooses among up to ten labels around it.

    Viterbi: the least cost up to x with label l is its own cost and that of its frontier above and below, plus the least before: l's own, or any + weight.
    """
    H, W, C = f.shape
    most = 10
    mean, total = sums(f, labels, n)
    for k in range(n):
        for c in range(C):
            total[k, c] /= mean[k]
    mean = total
    choice = np.empty((W, most), np.int32)
    number = np.empty(W, np.int32)
    back = np.empty((W, most), np.int8)
    cost, last = np.empty(most), np.empty(most)
    for y in range(H):
        busy = False
        for x in range(W):
            m = 1
            choice[x, 0] = labels[y, x]
            for j in range(-REACH - 1, REACH + 2):  # the last two: above and below
                yy, xx = (y, x + j) if abs(j) <= REACH else (y + (1 if j > 0 else -1), x)
                if 0 <= yy < H and 0 <= xx < W and m < most:
                    seen = False
                    for i in range(m):
                        seen |= choice[x, i] == labels[yy, xx]
                    if not seen:
                        choice[x, m] = labels[yy, xx]
                        m += 1
            number[x] = m
            busy |= m > 1
        if not busy:
            continue
        best = 0
        for x in range(W):
            m = number[x]
            for i in range(m):
                label = choice[x, i]
                d = 0.0
                if m > 1:
                    for c in range(C):
                        d += (f[y, x, c] - mean[label, c]) ** 2
                    d += weight * ((y > 0 and labels[y - 1, x] != label) + (y + 1 < H and labels[y + 1, x] != label))
                if x:
                    least, back[x, i] = weight, best  # costs are kept less the least
                    for j in range(number[x - 1]):
                        if choice[x - 1, j] == label and last[j] <= least:
                            least, back[x, i] = last[j], j
                    d += least
                cost[i] = d
            best = np.argmin(cost[:m])
            for i in range(m):
                last[i] = cost[i] - cost[best]
        for x in range(W - 1, -1, -1):
            labels[y, x] = choice[x, best]
            best = back[x, best]
