"""Compiled: branch and bound over boxes of translation."""

import numpy as np

from lib.core.compiled import njit


@njit()
def search(
    scene, A, P1, P2, low, high, member, start, scale, reach, weight, half, span, resolution, margin, most_nodes
):
    """Branch and bound over the places c of the pivot, |c| <= half, and scales q, for all problems (rotation, step of scale) at once.

    Problem k has the correspondences member[start[k]:start[k + 1]], scales within reach[k] of scale[k], and is done at resolution[k].
    The bound of a cell is the weight of the scene facets that some correspondence allows somewhere in it; the cell of the highest
    bound is halved first, so the deepest point comes first, and then everything within `margin` of it.

    Returns problem (n,), places (n, 4), scores (n,), cells visited; complete unless most_nodes were not enough.
    """
    marks = np.full((3, len(weight)), -1)
    capacity = 4096
    cell, bound, sure, owner = (
        np.empty((capacity, 8)),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity, np.int64),
    )
    heap, free = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    used, size, spare, stamp = 0, 0, 0, 0
    largest = 0
    for k in range(len(start) - 1):
        largest = max(largest, start[k + 1] - start[k])
    pool = np.empty(4 * largest + 4, np.int64)
    problem, places, scores, count = np.empty(512, np.int64), np.empty((512, 4)), np.empty(512), 0
    best, nodes = 0.0, 0
    child = np.empty(8)
    for k in range(len(start) - 1):  # the roots
        pool[: start[k + 1] - start[k]] = member[start[k] : start[k + 1]]
        child[:3], child[3:6], child[6], child[7] = 0.0, half, scale[k], reach[k]
        stamp += 1
        n, most, everywhere, middle = allowed(
            scene, A, P1, P2, low, high, weight, child, pool, 0, start[k + 1] - start[k], largest, marks, stamp
        )
        best = max(best, middle)
        if used == capacity:
            capacity *= 2
            cell, bound, sure, owner, heap, free = grown(cell, bound, sure, owner, heap, free, capacity)
        cell[used], bound[used], sure[used], owner[used] = child, most, everywhere, k
        size = push(heap, size, bound, used)
        used += 1
    while size > 0 and nodes < most_nodes:
        at = heap[0]
        size = pop(heap, size, bound)
        if bound[at] < best - margin:
            break
        nodes += 1
        k, value, certain = owner[at], bound[at], sure[at]
        here = cell[at].copy()
        free[spare] = at
        spare += 1
        widest, axis = here[7] * span, 3
        for a in range(3):
            if here[3 + a] > widest:
                widest, axis = here[3 + a], a
        near = -1
        for s in range(count):
            if problem[s] == k:
                gap = max(
                    abs(places[s, 0] - here[0]),
                    abs(places[s, 1] - here[1]),
                    abs(places[s, 2] - here[2]),
                    abs(places[s, 3] - here[6]) * span,
                )
                if gap < 3 * resolution[k] + widest:
                    near = s
                    break
        if near >= 0 and widest < 2 * resolution[k] and value <= scores[near]:
            continue  # the same place again
        if widest < resolution[k] or certain >= value - 1e-9:
            if near < 0:
                if count == len(scores):
                    continue  # the others are worse, or as good: enough to know
                near = count
                count += 1
                scores[near] = 0.0
            if value > scores[near]:
                problem[near], scores[near], places[near, :3], places[near, 3] = k, value, here[:3], here[6]
            continue
        stamp += 1
        length = start[k + 1] - start[k]
        pool[:length] = member[start[k] : start[k + 1]]
        n, _, _, _ = allowed(scene, A, P1, P2, low, high, weight, here, pool, 0, length, length, marks, stamp)
        for side in (-1, 1):
            child[:] = here
            if axis == 3:
                child[7] /= 2
                child[6] += side * child[7]
            else:
                child[3 + axis] /= 2
                child[axis] += side * child[3 + axis]
            stamp += 1
            _, most, everywhere, middle = allowed(
                scene, A, P1, P2, low, high, weight, child, pool, length, n, length + n, marks, stamp
            )
            best = max(best, middle)
            if most < best - margin or most <= 0:
                continue
            if spare > 0:
                spare -= 1
                new = free[spare]
            else:
                if used == capacity:
                    capacity *= 2
                    cell, bound, sure, owner, heap, free = grown(cell, bound, sure, owner, heap, free, capacity)
                new = used
                used += 1
            cell[new], bound[new], sure[new], owner[new] = child, most, everywhere, k
            size = push(heap, size, bound, new)
    return problem[:count], places[:count], scores[:count], nodes


@njit()
def grown(cell, bound, sure, owner, heap, free, capacity):
    n = len(bound)
    new_cell, new_bound, new_sure = np.empty((capacity, 8)), np.empty(capacity), np.empty(capacity)
    new_owner, new_heap, new_free = (
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
    )
    new_cell[:n], new_bound[:n], new_sure[:n], new_owner[:n], new_heap[:n], new_free[:n] = (
        cell,
        bound,
        sure,
        owner,
        heap,
        free,
    )
    return new_cell, new_bound, new_sure, new_owner, new_heap, new_free


@njit()
def push(heap, size, bound, item):
    """A heap of items, the highest bound on top, the newer (smaller) cell first among equals; returns the new size."""
    k = size
    while k > 0 and bound[item] >= bound[heap[(k - 1) // 2]]:
        heap[k] = heap[(k - 1) // 2]
        k = (k - 1) // 2
    heap[k] = item
    return size + 1


@njit()
def pop(heap, size, bound):
    """Takes the top away; returns the new size."""
    size -= 1
    item, k = heap[size], 0
    while 2 * k + 1 < size:
        c = 2 * k + 1
        if c + 1 < size and bound[heap[c + 1]] > bound[heap[c]]:
            c += 1
        if bound[item] >= bound[heap[c]]:
            break
        heap[k] = heap[c]
        k = c
    heap[k] = item
    return size


@njit()
def allowed(scene, A, P1, P2, low, high, weight, cell, pool, start, length, end, marks, stamp):
    """Which of the correspondences pool[start:start + length] are possible in a cell; they are written to pool[end:].

    Returns their number and the weights of the scene facets that are possible somewhere, hold everywhere, hold in the middle.
    """
    n, most, everywhere, middle = 0, 0.0, 0.0, 0.0
    q, eq = cell[6], cell[7]
    for s in range(start, start + length):
        k = pool[s]
        possible, certain, holds = True, True, True
        for a in range(3):
            x = A[k, a, 0] * cell[0] + A[k, a, 1] * cell[1] + A[k, a, 2] * cell[2]
            r = abs(A[k, a, 0]) * cell[3] + abs(A[k, a, 1]) * cell[4] + abs(A[k, a, 2]) * cell[5]
            first, second = x + q * P1[k, a] - low[k, a], high[k, a] - x - q * P2[k, a]
            r1, r2 = r + eq * abs(P1[k, a]), r + eq * abs(P2[k, a])
            if first + r1 < 0 or second + r2 < 0:
                possible = False
                break
            if first < r1 or second < r2:
                certain = False
                if first < 0 or second < 0:
                    holds = False
        if possible:
            pool[end + n] = k
            n += 1
            i = scene[k]
            if marks[0, i] != stamp:
                marks[0, i] = stamp
                most += weight[i]
            if certain and marks[1, i] != stamp:
                marks[1, i] = stamp
                everywhere += weight[i]
            if holds and marks[2, i] != stamp:
                marks[2, i] = stamp
                middle += weight[i]
    return n, most, everywhere, middle
