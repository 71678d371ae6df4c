"""Index buffers and depth against the true ones.

index.differ, object.differ            share of pixels of another group or object, away from edges
index.differ_all, object.differ_all    the same of all pixels
mirror.differ, mirror.differ_all       the same of what mirrors show, of the pixels that show something in a mirror
depth.median_relative                  median of |z / z* - 1|
"""

from __future__ import annotations

import numpy as np

from lib.verdict.material_errors import median


def count_pixels(labels, names):
    """{name: pixels} of an image of index + 1."""
    counts = np.bincount(labels.ravel(), minlength=len(names) + 1)
    return {name: int(counts[i + 1]) for i, name in enumerate(names)}


def differ(labels, names, true_labels, true_names, seen=None):
    """(share of pixels of another name away from truth's edges, share of all pixels).

    An edge is where a pixel and one of its eight neighbours differ in truth; both of them lie at it.
    seen : (H, W) bool, the pixels that count; default: all
    Either is None where no pixel counts.
    """
    ids = {name: i for i, name in enumerate(dict.fromkeys([*names, *true_names]), start=1)}
    ours, true = (
        np.array([0, *(ids[n] for n in which)])[image] for which, image in ((names, labels), (true_names, true_labels))
    )
    every = np.ones(true.shape, bool) if seen is None else seen
    other, inside = ours != true, every & ~_edges(true)
    return tuple(float(other[some].mean()) if some.any() else None for some in (inside, every))


def _edges(labels):
    """(H, W) bool: pixels that one of their eight neighbours differs from."""
    H, W = labels.shape
    edge = np.zeros(labels.shape, bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, H - dy), slice(max(0, -dx), W - max(0, dx)))
        b = (slice(dy, None), slice(max(0, dx), W + min(0, dx)))
        step = labels[a] != labels[b]
        edge[a] |= step
        edge[b] |= step
    return edge


def depth_error(depth, true_depth):
    """Median relative error over the pixels where both are known, or None; depths (H, W) in m, 0 = nothing."""
    both = (depth > 0) & (true_depth > 0)
    return median(list(abs(depth[both] / true_depth[both] - 1))) if both.any() else None
