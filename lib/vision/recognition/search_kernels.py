"""Compiled: branch and bound over boxes of translation and scale."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit


class Conditions(NamedTuple):
    """What K correspondences ask of the pivot's place c and the scale q, along three axes each.

    low <= A c + q P1 and A c + q P2 <= high (hashing_kernels.Correspondences)
    """

    scene: np.ndarray  # (K,) scene facet
    rows: np.ndarray  # (K, 3, 7) A (3), P1, P2, low, high: what is read together lies together


class Problems(NamedTuple):
    """Problem k has the correspondences member[start[k]:start[k + 1]] and scales within reach[k] of scale[k]."""

    member: np.ndarray  # (M,)
    start: np.ndarray  # (n + 1,)
    scale: np.ndarray  # (n,)
    reach: np.ndarray  # (n,)
    resolution: np.ndarray  # (n,) m: a cell that is smaller is a place


class Limits(NamedTuple):
    """What is searched, and how far."""

    half: np.ndarray  # (3,) m: |c| <= half
    span: float  # of the scene: a step of the scale moves it by so much
    margin: float  # nats behind the best
    most_nodes: int


class Found(NamedTuple):
    """Places of high bounds, at most as many as there is room for."""

    problem: np.ndarray  # (S,)
    place: np.ndarray  # (S, 4) c, q
    score: np.ndarray  # (S,)


class Cells(NamedTuple):
    """Boxes c +- half widths, q +- half width; those to be looked at in a heap, the highest bound on top."""

    box: np.ndarray  # (capacity, 8) c (3), half widths (3), q, half width
    bound: np.ndarray  # (capacity,) weight of what is possible somewhere in the box
    sure: np.ndarray  # (capacity,) weight of what holds everywhere in it
    problem: np.ndarray  # (capacity,)
    heap: np.ndarray  # (capacity,) cells
    free: np.ndarray  # (capacity,) cells that are no longer needed
    count: np.ndarray  # (3,) USED cells, SIZE of the heap, SPARE cells in `free`


USED, SIZE, SPARE = 0, 1, 2


class Scratch(NamedTuple):
    """Room for `allowed` and `halve`."""

    pool: np.ndarray  # correspondences
    marks: np.ndarray  # (3, N) the stamp of the cell that last counted a scene facet
    stamp: np.ndarray  # (1,) the last that was given
    child: np.ndarray  # (8,) a box


@njit()
def search(pairs, problems, weight, limits):
    """Branch and bound over the places c of the pivot, |c| <= half, and scales q, for all problems at once.

    pairs : Conditions;  problems : Problems, one for each rotation and step of scale;  weight : (N,) nats;
    limits : Limits

    The bound of a cell is the weight of the scene facets that some correspondence allows somewhere in it. The cell of
    the highest bound is halved first, so the deepest point comes first, and then everything within `margin` of it.

    Returns Found and the number of cells visited. The answer is complete unless most_nodes were not enough.
    """
    n_problems, largest = len(problems.start) - 1, 0
    for k in range(n_problems):
        largest = max(largest, problems.start[k + 1] - problems.start[k])
    scratch = Scratch(
        np.empty(4 * largest + 4, np.int64), np.full((3, len(weight)), -1), np.zeros(1, np.int64), np.empty(8)
    )
    # each node leaves at most one cell more; memory that is never touched costs nothing
    cells = room(n_problems + limits.most_nodes + 1)
    found, count = Found(np.empty(512, np.int64), np.empty((512, 4)), np.empty(512)), 0
    best, nodes = 0.0, 0
    box = np.empty(8)
    for k in range(n_problems):  # the roots
        length = members(problems, k, scratch)
        box[:3], box[3:6], box[6], box[7] = 0.0, limits.half, problems.scale[k], problems.reach[k]
        _, most, everywhere, middle = allowed(pairs, weight, box, scratch, 0, length, largest)
        best = max(best, middle)
        insert(cells, box, most, everywhere, k)
    while cells.count[SIZE] > 0 and nodes < limits.most_nodes:
        at = pop(cells)
        value, k = cells.bound[at], cells.problem[at]
        if value < best - limits.margin or value <= 0:  # where nothing is possible is no place
            break
        nodes += 1
        box = cells.box[at].copy()
        widest, axis = widest_side(box, limits.span)
        near = place_near(found, count, box, k, limits.span, 3 * problems.resolution[k] + widest)
        if near >= 0 and widest < 2 * problems.resolution[k] and value <= found.score[near]:
            continue  # the same place again
        if widest < problems.resolution[k] or cells.sure[at] >= value - 1e-9:
            count = note(found, count, near, box, k, value)
            continue
        best = halve(cells, box, axis, k, pairs, problems, weight, scratch, best, limits.margin)
    return Found(found.problem[:count], found.place[:count], found.score[:count]), nodes


@njit()
def members(problems, k, scratch):
    """Writes the problem's correspondences to the pool; returns their number."""
    length = problems.start[k + 1] - problems.start[k]
    scratch.pool[:length] = problems.member[problems.start[k] : problems.start[k + 1]]
    return length


@njit()
def widest_side(box, span):
    """(width, axis) of the box's longest side; axis 3 is the scale."""
    widest, axis = box[7] * span, 3
    for a in range(3):
        if box[3 + a] > widest:
            widest, axis = box[3 + a], a
    return widest, axis


@njit()
def place_near(found, count, box, k, span, reach):
    """The first place of problem k that was found within `reach` of the box's middle, or -1."""
    for s in range(count):
        if found.problem[s] == k:
            gap = max(
                abs(found.place[s, 0] - box[0]),
                abs(found.place[s, 1] - box[1]),
                abs(found.place[s, 2] - box[2]),
                abs(found.place[s, 3] - box[6]) * span,
            )
            if gap < reach:
                return s
    return -1


@njit()
def note(found, count, near, box, k, value):
    """Adds the box's middle to what was found, or moves the place `near` there if it is better; returns the count.

    Where there is no room left the others are worse, or as good: enough is known.
    """
    if near < 0:
        if count == len(found.score):
            return count
        near = count
        count += 1
        found.score[near] = 0.0
    if value > found.score[near]:
        found.problem[near], found.score[near] = k, value
        found.place[near, :3], found.place[near, 3] = box[:3], box[6]
    return count


@njit()
def halve(cells, box, axis, k, pairs, problems, weight, scratch, best, margin):
    """Both halves of a box of problem k along an axis go into the heap, but those that cannot come within the margin.

    Returns the best score of a place so far.
    """
    length = members(problems, k, scratch)
    n, _, _, _ = allowed(pairs, weight, box, scratch, 0, length, length)
    child = scratch.child
    for side in (-1, 1):
        child[:] = box
        if axis == 3:
            child[7] /= 2
            child[6] += side * child[7]
        else:
            child[3 + axis] /= 2
            child[axis] += side * child[3 + axis]
        _, most, everywhere, middle = allowed(pairs, weight, child, scratch, length, n, length + n)
        best = max(best, middle)
        if not (most < best - margin or most <= 0):
            insert(cells, child, most, everywhere, k)
    return best


@njit()
def room(capacity):
    """Cells, none of them used."""
    return Cells(
        np.empty((capacity, 8)),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
        np.zeros(3, np.int64),
    )


@njit()
def insert(cells, box, bound, sure, k):
    """A new cell of problem k goes into the heap, in the place of one that is no longer needed if there is one."""
    count = cells.count
    if count[SPARE] > 0:
        count[SPARE] -= 1
        new = cells.free[count[SPARE]]
    else:
        new = count[USED]
        count[USED] += 1
    cells.box[new], cells.bound[new], cells.sure[new], cells.problem[new] = box, bound, sure, k
    push(cells.heap, cells.bound, count[SIZE], new)
    count[SIZE] += 1


@njit()
def push(heap, bound, size, item):
    """Into a heap of so many, the highest bound on top, the newer cell first among equals."""
    k = size
    while k > 0 and bound[item] >= bound[heap[(k - 1) // 2]]:
        heap[k] = heap[(k - 1) // 2]
        k = (k - 1) // 2
    heap[k] = item


@njit()
def pop(cells):
    """Takes the top of the heap away; returns its cell, whose place is free from now on."""
    heap, bound = cells.heap, cells.bound
    top = heap[0]
    cells.count[SIZE] -= 1
    size = cells.count[SIZE]
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
    cells.free[cells.count[SPARE]] = top
    cells.count[SPARE] += 1
    return top


@njit()
def allowed(pairs, weight, box, scratch, start, length, end):
    """Which of the correspondences pool[start:start + length] are possible in a box; they are written to pool[end:].

    Returns their number, and the weights of the scene facets that are possible somewhere in the box, hold everywhere in
    it, hold in its middle.
    """
    scratch.stamp[0] += 1
    pool, marks, stamp = scratch.pool, scratch.marks, scratch.stamp[0]
    scene, rows = pairs.scene, pairs.rows
    n, most, everywhere, middle = 0, 0.0, 0.0, 0.0
    q, eq = box[6], box[7]
    for s in range(start, start + length):
        k = pool[s]
        possible, certain, holds = True, True, True
        for a in range(3):
            x = rows[k, a, 0] * box[0] + rows[k, a, 1] * box[1] + rows[k, a, 2] * box[2]
            r = abs(rows[k, a, 0]) * box[3] + abs(rows[k, a, 1]) * box[4] + abs(rows[k, a, 2]) * box[5]
            P1, P2, low, high = rows[k, a, 3], rows[k, a, 4], rows[k, a, 5], rows[k, a, 6]
            first, second = x + q * P1 - low, high - x - q * P2
            r1, r2 = r + eq * abs(P1), r + eq * abs(P2)
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
