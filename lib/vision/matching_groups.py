"""Which candidates of neighbouring regions support each other: §2.2 where a region is like many.

Two candidates, of two neighbours on the left with two neighbours on the right, support each other if each one's plane
says what the other's disparity is: they are of one plane. What supports each other, from neighbour to neighbour, is a
group, and weighs as much as all its regions. A chessboard moved by two squares agrees with itself as well, but not at
its ends: the group of the right ones is larger.
"""

import numpy as np

LARGER = 2.0  # times as heavy is a group that may contest a match
PIXELS = 64  # of a region, that are taken into the other picture
NOT_THERE, THERE = 0.1, 0.5  # of them: fewer in its partner, more in other regions of such a colour
UNLIKE = 2.0  # times the colours' largest difference: what contests a match need not be one itself
GAP_PX = 4  # between neighbours: slivers of the blur lie there
AGREE_PX = 3.0  # between disparities: twice what whole pixels tell (matching_kernels.TOLERANCE_PX)


def weights(labels, left, right, similarity, plane, centre) -> np.ndarray:
    """(n,) of each candidate: the similarities of the regions of its group, its own among them.

    labels : of the two pictures (H, W);  left, right : (n,) region indices, from 0 (labels less 1)
    similarity : (n,), 0 of those that neither support nor are supported
    plane : (n, 3) (a, b, c) of the disparity in rectified px;  centre : (N, 2) of the left regions, rectified px
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n = len(left)
    if n == 0:
        return np.zeros(0)
    k, l = _of_neighbours(_neighbours(labels[0]), left)
    known = (similarity[k] > 0) & (similarity[l] > 0)
    k, l = k[known], l[known]
    beside = _neighbours(labels[1])
    k, l = (x[np.isin(_code(right[k], right[l]), _code(*beside.T))] for x in (k, l))
    at = np.concatenate([centre[left], np.ones((n, 1))], axis=1)
    apart = lambda where: np.abs(((plane[k] - plane[l]) * at[where]).sum(axis=1))
    agree = (apart(k) <= AGREE_PX) & (apart(l) <= AGREE_PX)
    k, l = k[agree], l[agree]
    group = connected_components(coo_matrix((np.ones(len(k)), (k, l)), shape=(n, n)), directed=False)[1]
    # A region counts once in a group, by the best of its candidates there.
    order = np.lexsort((-similarity, left, group))
    first = (np.diff(group[order], prepend=-1) != 0) | (np.diff(left[order], prepend=-1) != 0)
    total = np.bincount(group[order], np.where(first, similarity[order], 0))
    return total[group]


def contested(pair, labels, regions, weight, left, right, plane, colour: float) -> np.ndarray:
    """(M,) bool of each match: heavier groups beside it say that another region is its partner.

    A match stands alone before a pattern where its true partner is not to be had: hidden, cut by the picture's border
    or joined with another. A neighbour's plane takes its region into the other picture. If that misses its
    partner and finds such a colour there, for most of the neighbours on the left or on the right, then it is one of
    the pattern.

    pair, labels, regions : of both pictures;  weight, left, right, plane : (M,) as weights' and of them
    """
    votes = np.zeros((2, 2, len(left)))  # side, for or against, match
    for side, name, mine, theirs in ((0, "left", left, right), (1, "right", right, left)):
        k, n = _of_neighbours(_neighbours(labels[side]), mine)
        k, n = np.r_[k, n], np.r_[n, k]
        heavier = weight[n] > LARGER * weight[k]
        k, n = k[heavier], n[heavier]
        u, v = pair.rectified(_some_pixels(labels[side], regions[side], mine)[k], name).transpose(2, 0, 1)
        a, b, c = plane[n].T[..., None]
        there = u - (a * u + b * v + c) if side == 0 else (u + b * v + c) / (1 - a)
        found = _labels_at(labels[1 - side], pair.photograph(np.stack([there, v], axis=2), ("right", "left")[side]))
        its = found == theirs[k][:, None] + 1
        colour_there = regions[1 - side].mean[found - 1]
        alike = np.abs(colour_there - regions[side].mean[mine[k]][:, None]).max(axis=2) <= UNLIKE * colour
        others = (alike & ~its & (found > 0)).mean(axis=1)
        np.add.at(votes[side], (((its.mean(axis=1) < NOT_THERE) & (others > THERE)).astype(int), k), 1)
    return (votes[:, 1] > votes[:, 0]).any(axis=0)


def _some_pixels(labels, regions, index):
    """(M, PIXELS, 2) px (x, y) of regions, evenly over their pixels."""
    first, number = regions.first[index], regions.pixels[index]
    some = first[:, None] + ((np.arange(PIXELS) + 0.5) / PIXELS * number[:, None]).astype(int)
    flat = regions.order[some]
    return np.stack([flat % labels.shape[1], flat // labels.shape[1]], axis=2)


def _labels_at(labels, q):
    """Labels at (..., 2) px; 0 outside the picture."""
    height, width = labels.shape
    q = np.floor(q + 0.5)
    inside = (q >= 0).all(axis=-1) & (q < [width, height]).all(axis=-1)
    x, y = np.where(inside[..., None], q, 0).astype(int).transpose(2, 0, 1)
    return np.where(inside, labels[y, x], 0)


def _code(a, b):
    """One number for an unordered pair of indices below 2^31."""
    return np.minimum(a, b).astype(np.int64) << 31 | np.maximum(a, b)


def _neighbours(labels) -> np.ndarray:
    """(P, 2) indices (labels less 1) of regions that are at most GAP_PX apart, along rows, columns or diagonals."""
    labels = np.asarray(labels)
    height, width = labels.shape
    found = [np.empty(0, np.int64)]
    for dy, dx in ((0, GAP_PX), (GAP_PX, 0), (GAP_PX, GAP_PX), (GAP_PX, -GAP_PX)):
        here = labels[: height - dy, max(-dx, 0) : width - max(dx, 0)]
        there = labels[dy:, max(dx, 0) : width + min(dx, 0)]
        other = (here != there) & (here > 0) & (there > 0)
        found.append(np.unique(_code(here[other] - 1, there[other] - 1)))
    code = np.unique(np.concatenate(found))
    return np.column_stack([code >> 31, code & (1 << 31) - 1])


def _of_neighbours(pairs, left):
    """(k,), (l,): every candidate of one region with every candidate of the other, for all pairs (P, 2) of regions."""
    order = np.argsort(left, kind="stable")
    low, high = (np.searchsorted(left[order], pairs, side) for side in ("left", "right"))
    count = high - low
    both = count[:, 0] * count[:, 1]
    pair = np.repeat(np.arange(len(pairs)), both)
    within = np.arange(len(pair)) - np.repeat(np.cumsum(both) - both, both)
    k = low[pair, 0] + within // np.maximum(count[pair, 1], 1)
    l = low[pair, 1] + within % np.maximum(count[pair, 1], 1)
    return order[k], order[l]
