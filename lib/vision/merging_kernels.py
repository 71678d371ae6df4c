"""Compiled: neighbouring regions merge, the pair first for which the smallest lambda is enough."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit
from lib.vision.segmentation_kernels import find, sums

GONE = -1.0  # price of an edge whose two regions are one, or that another edge has replaced
FEW = 64  # a region with fewer edges than this prices all of them anew after each merge
MANY = 8  # one with more does so once it took in a MANY-th of them


class Edges(NamedTuple):
    """Pairs of neighbouring regions. The edges of a region are a linked list of half-edges 2 e + side."""

    ends: np.ndarray  # (E, 2) int32: the two regions
    length: np.ndarray  # (E,): frontier pairs
    price: np.ndarray  # (E,): the lambda from which merging pays, as last seen; or GONE
    head: np.ndarray  # (n,) int32: a region's first half-edge, or -1
    after: np.ndarray  # (2 E,) int32: the half-edge after this one, or -1
    degree: np.ndarray  # (n,) int32: edges of a region, those counted that are gone


class Table(NamedTuple):
    """Hash table with open addressing: which edge joins two regions."""

    keys: np.ndarray  # (size,) int64: lower label * n + higher label, or -1
    edge: np.ndarray  # (size,) int32
    unused: np.ndarray  # (1,) int64: free places; those of regions that are gone are not free


class Heap(NamedTuple):
    """Edges by price, the least first. An edge may stand there more than once: only its last price counts."""

    price: np.ndarray
    edge: np.ndarray
    size: int


# What is asked of each edge is inlined by numba. A call counts all its arrays in and out: 1.2 times slower.

# -- the hash table


@njit(inline="always")
def pair_key(a, b, n):
    return np.int64(min(a, b)) * n + max(a, b)


@njit(inline="always")
def slot(keys, key):
    """Where key stands in the hash table, or the free place for it."""
    mask = len(keys) - 1
    h = (key * 0x9E3779B97F4A7C15 >> 20) & mask
    while keys[h] != -1 and keys[h] != key:
        h = (h + 1) & mask
    return h


@njit()
def make_table_anew(table, edges):
    """Only the edges that live stay in it."""
    n = len(edges.head)
    table.keys[:] = -1
    table.unused[0] = len(table.keys)
    for e in range(len(edges.price)):
        if edges.price[e] != GONE:
            key = pair_key(edges.ends[e, 0], edges.ends[e, 1], n)
            h = slot(table.keys, key)
            table.keys[h], table.edge[h] = key, e
            table.unused[0] -= 1


# -- the heap


@njit()
def push(heap, price, e):
    """The heap with one more edge; its arrays are replaced where they are full."""
    prices, edge, m = heap.price, heap.edge, heap.size
    if m == len(prices):
        prices, edge = np.append(prices, np.empty(m + 64)), np.append(edge, np.empty(m + 64, np.int32))
    i = m
    while i and prices[(i - 1) >> 1] > price:
        prices[i], edge[i] = prices[(i - 1) >> 1], edge[(i - 1) >> 1]
        i = (i - 1) >> 1
    prices[i], edge[i] = price, e
    return Heap(prices, edge, m + 1)


@njit()
def pop(heap):
    """The heap without its first edge, which the caller has read."""
    prices, edge, m = heap.price, heap.edge, heap.size - 1
    price, e = prices[m], edge[m]
    i = 0
    while True:
        j = 2 * i + 1
        if j >= m:
            break
        if j + 1 < m and prices[j + 1] < prices[j]:
            j += 1
        if prices[j] >= price:
            break
        prices[i], edge[i] = prices[j], edge[j]
        i = j
    prices[i], edge[i] = price, e
    return Heap(prices, edge, m)


# -- regions and their neighbours


@njit()
def frontier_pairs(labels):
    """The number of neighbouring pixels with different labels."""
    H, W = labels.shape
    pairs = 0
    for y in range(H):
        for x in range(W):
            pairs += (x > 0 and labels[y, x] != labels[y, x - 1]) + (y > 0 and labels[y, x] != labels[y - 1, x])
    return pairs


@njit()
def neighbours(labels, n):
    """All pairs of neighbouring regions with the lengths of their frontiers, and the table that finds them."""
    H, W = labels.shape
    pairs = frontier_pairs(labels)
    size = 1024
    while size < 3 * pairs:
        size *= 2
    keys, held = np.full(size, -1, np.int64), np.empty(size, np.int32)
    ends, length = np.empty((pairs, 2), np.int32), np.zeros(pairs)
    m = 0
    for y in range(H):
        for x in range(W):
            for down in range(2):
                if (y if down else x) == 0:
                    continue
                a, b = labels[y, x], labels[y - down, x - 1 + down]
                if a == b:
                    continue
                key = pair_key(a, b, n)
                h = slot(keys, key)
                if keys[h] == -1:
                    keys[h], held[h] = key, m
                    ends[m, 0], ends[m, 1] = a, b
                    m += 1
                length[held[h]] += 1
    unused = np.full(1, size - m)
    edges = Edges(
        ends[:m], length[:m], np.empty(m), np.full(n, -1, np.int32), np.empty(2 * m, np.int32), np.zeros(n, np.int32)
    )
    for e in range(m):
        for side in range(2):
            link(edges, 2 * e + side, ends[e, side])
    return edges, Table(keys, held, unused)


@njit(inline="always")
def link(edges, half, a):
    """The half-edge becomes the first of region a."""
    edges.after[half] = edges.head[a]
    edges.head[a] = half
    edges.degree[a] += 1


@njit(inline="always")
def merge_price(regions, a, b, length):
    """The lambda from which merging a and b pays: the rise of the squared error per frontier pair that goes."""
    count, total = regions.count, regions.total
    d = 0.0
    for c in range(total.shape[1]):
        d += (total[a, c] / count[a] - total[b, c] / count[b]) ** 2
    return d * count[a] * count[b] / ((count[a] + count[b]) * length)


@njit(inline="always")
def set_price(edges, heap, e, price, weight):
    """An edge gets its price, and a place in the heap where merging pays."""
    edges.price[e] = price
    if price < weight:
        heap = push(heap, price, e)
    return heap


# -- merging


@njit()
def merge(f, labels, n, weight):
    """Merges neighbours, the least price first, while the price is below weight.  Labels from 0 and their number.

    Near-linear: each merge walks the edges of the region with fewer of them. The other one's mean hardly changes, so
    its edges are priced anew only once it took in an eighth of them. Until then a price that is out of date is seen
    when its turn comes.
    """
    regions = sums(f, labels, n)
    edges, table = neighbours(labels, n)
    m = len(edges.price)
    heap = Heap(np.empty(m + 64), np.empty(m + 64, np.int32), 0)
    for e in range(m):
        price = merge_price(regions, edges.ends[e, 0], edges.ends[e, 1], edges.length[e])
        heap = set_price(edges, heap, e, price, weight)

    parent = np.arange(n)
    taken = np.zeros(n, np.int32)  # regions that a region took in since its edges were priced
    while heap.size:
        price, e = heap.price[0], heap.edge[0]
        heap = pop(heap)
        if edges.price[e] != price:
            continue
        a, b = edges.ends[e, 0], edges.ends[e, 1]
        now = merge_price(regions, a, b, edges.length[e])
        if now > price * (1 + 1e-12):
            heap = set_price(edges, heap, e, now, weight)
            continue
        if edges.degree[a] < edges.degree[b]:
            a, b = b, a
        parent[b] = a
        edges.price[e] = GONE
        absorb(regions, a, b)
        heap = inherit_edges(regions, edges, table, heap, a, b, weight)
        taken[a] += 1 + taken[b]
        if edges.degree[a] < FEW or MANY * taken[a] > edges.degree[a]:
            taken[a] = 0
            heap = price_edges_anew(regions, edges, heap, a, weight)
        if 4 * table.unused[0] < len(table.keys):
            make_table_anew(table, edges)
    return renumbered(labels, parent)


@njit()
def absorb(regions, a, b):
    """Region a gets the pixels of b."""
    regions.count[a] += regions.count[b]
    for c in range(regions.total.shape[1]):
        regions.total[a, c] += regions.total[b, c]


@njit()
def inherit_edges(regions, edges, table, heap, a, b, weight):
    """The edges of b become edges of a; where a has one to the same neighbour, that one gets their length."""
    half = edges.head[b]
    while half != -1:
        following = edges.after[half]
        e = half >> 1
        if edges.price[e] != GONE:
            other = edges.ends[e, 1 - (half & 1)]
            key = pair_key(a, other, len(edges.head))
            h = slot(table.keys, key)
            if table.keys[h] != -1 and edges.price[table.edge[h]] != GONE:
                edges.length[table.edge[h]] += edges.length[e]
                edges.price[e] = GONE
                e = table.edge[h]
            else:
                if table.keys[h] == -1:
                    table.unused[0] -= 1
                table.keys[h], table.edge[h] = key, e
                edges.ends[e, half & 1] = a
                link(edges, half, a)
            heap = set_price(edges, heap, e, merge_price(regions, a, other, edges.length[e]), weight)
        half = following
    return heap


@njit()
def price_edges_anew(regions, edges, heap, a, weight):
    """All edges of a at today's prices, without those that are gone. Risen prices are seen when their turn comes."""
    half = edges.head[a]
    edges.head[a] = -1
    edges.degree[a] = 0
    while half != -1:
        following = edges.after[half]
        e = half >> 1
        if edges.price[e] != GONE:
            link(edges, half, a)
            now = merge_price(regions, a, edges.ends[e, 1 - (half & 1)], edges.length[e])
            if now < edges.price[e]:
                heap = set_price(edges, heap, e, now, weight)
        half = following
    return heap


@njit()
def renumbered(labels, parent):
    """Labels from 0 in the order of their first pixels, after merging; and their number."""
    H, W = labels.shape
    number = np.full(len(parent), -1, np.int32)
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
