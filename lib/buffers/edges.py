"""Edges: of the model, as a wireframe and as the camera sees them, and between the areas of a label image."""

import numpy as np

from lib.buffers.viewport import NEAR
from lib.core.rows import distinct


def boundary(facet) -> np.ndarray:
    """(H, W) bool: one of the eight neighbours shows another facet."""
    return ~_uniform(facet, 1)


def _uniform(labels, radius):
    """(H, W) bool: the (2 radius + 1)^2 window shows one label only; beyond the picture nothing counts."""
    import cv2

    values = labels.astype(np.float32)  # exact below 2^24
    window = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return cv2.erode(values, window) == cv2.dilate(values, window)


def facet_edges(model) -> np.ndarray:
    """(E, 2) int: vertices at the ends of the edges where a facet ends, by position; each facet has its own copy."""
    t = model.triangles
    position = distinct(model.vertices)[1]
    ends = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    facet = np.tile(model.triangle_facet, 3)
    key = np.column_stack([np.sort(position[ends], axis=1), facet])
    order = np.lexsort(key.T)
    key = key[order]
    same = (key[1:] == key[:-1]).all(axis=1)
    inner = np.concatenate([[False], same]) | np.concatenate([same, [False]])
    return ends[order[~inner]]


def visible_edges(model, camera, facet, depth) -> np.ndarray:
    """The hidden-surface buffer (figure 4.7, middle): (H, W) bool, the pixels that a visible edge of a facet crosses.

    facet, depth : (H, W), the index buffer; slivers thinner than a pixel leave their edges too.
    """
    edges = np.zeros((camera.height, camera.width), bool)
    _, q, seen = _followed_edges(model, camera, facet, depth)
    x, y = _nearest_pixel(camera, q[seen])
    edges[y, x] = True
    return edges


def wireframe(model, camera, facet, depth) -> np.ndarray:
    """(S, 2, 2) px: the visible pieces of the facets' edges, from (x, y) to (x, y); the lines of figure 2.6."""
    owner, q, seen = _followed_edges(model, camera, facet, depth)
    begins = seen & ~np.concatenate([[False], seen[:-1] & (owner[1:] == owner[:-1])]) if len(q) else seen
    ends = seen & ~np.concatenate([seen[1:] & (owner[1:] == owner[:-1]), [False]]) if len(q) else seen
    return np.stack([q[begins], q[ends]], axis=1)


def _nearest_pixel(camera, q):
    x, y = np.floor(q + 0.5).astype(int).T
    return np.clip(x, 0, camera.width - 1), np.clip(y, 0, camera.height - 1)


def clip_to_picture(camera, a, b, near):
    """(begin, end), each (E,): the part of every segment from a to b that lies in the pyramid of the picture.

    begin, end are 0 at a and 1 at b; begin >= end: no part.

    a, b : (E, 3), camera frame        near : least z, the same unit

    The pyramid is five half-spaces through the centre and the near plane, all linear in p.
    """
    K, W, H = camera.K, camera.width, camera.height
    sides = np.array(
        [
            [*(K[0] + [0, 0, 0.5]), 0],
            [*([0, 0, W - 0.5] - K[0]), 0],
            [*(K[1] + [0, 0, 0.5]), 0],
            [*([0, 0, H - 0.5] - K[1]), 0],
            [0, 0, 1.0, -near],
        ]
    )
    begin, end = np.zeros(len(a)), np.ones(len(a))
    for plane in sides:
        fa, fb = a @ plane[:3] + plane[3], b @ plane[:3] + plane[3]
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = fa / (fa - fb)
        begin = np.where((fa < 0) & (fb >= 0), np.maximum(begin, cut), begin)
        end = np.where((fa >= 0) & (fb < 0), np.minimum(end, cut), end)
        end = np.where((fa < 0) & (fb < 0), -1, end)
    return begin, end


def _followed_edges(model, camera, facet, depth):
    """(owner (N,), q (N, 2) px, seen (N,) bool): every facet edge inside the picture, in steps of a quarter of a pixel.

    A point is seen where it is not behind the furthest depth among its pixel and the neighbours.
    """
    K = camera.K
    a, b = np.moveaxis(camera.points(model.vertices)[facet_edges(model)], 1, 0)
    begin, end = clip_to_picture(camera, a, b, NEAR * np.abs(a).max() if len(a) else 1.0)
    inside = begin < end
    a, b, begin, end = a[inside], b[inside], begin[inside, None], end[inside, None]
    a, b = a + begin * (b - a), a + end * (b - a)
    if len(a) == 0:
        return np.zeros(0, int), np.zeros((0, 2)), np.zeros(0, bool)
    w = np.stack([1 / a[:, 2], 1 / b[:, 2]])  # linear along the edge in the picture
    qa, qb = (a @ K.T)[:, :2] * w[0, :, None], (b @ K.T)[:, :2] * w[1, :, None]
    steps = np.maximum(1, np.ceil(4 * np.linalg.norm(qb - qa, axis=1)).astype(int)) + 1
    owner = np.repeat(np.arange(len(a)), steps)
    t = (np.arange(len(owner)) - np.repeat(np.cumsum(steps) - steps, steps)) / (steps - 1)[owner]
    q = qa[owner] + t[:, None] * (qb - qa)[owner]
    inverse = w[0][owner] * (1 - t) + w[1][owner] * t
    x, y = _nearest_pixel(camera, q)
    return owner, q, inverse >= _furthest(facet, depth)[y, x] * (1 - 1e-6)


def _furthest(facet, depth):
    """(H, W): the least 1/z that the facets at a pixel and its neighbours reach, within a pixel of their centres."""
    import cv2

    b = np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0)
    least = b.copy()
    for axis in (0, 1):
        here, there = shifted(axis, 1)
        step = np.where(facet[here] == facet[there], np.abs(b[here] - b[there]), 0)
        slope = np.zeros_like(b)
        slope[here] = step
        np.maximum(slope[there], step, out=slope[there])
        least -= slope
    return cv2.erode(least, np.ones((3, 3), np.uint8))


def shifted(axis, step):
    """Two tuples of slices: two views of a picture, `step` pixels apart along an axis."""
    here, there = [slice(None)] * 2, [slice(None)] * 2
    here[axis], there[axis] = slice(None, -step), slice(step, None)
    return tuple(here), tuple(there)
