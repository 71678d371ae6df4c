"""Where a model lies, told alike in whatever frame, unit and order its file has it.

Numbers that a scene's frame or a file's order would change must decide nothing: which diagonal cuts a quadrilateral,
where a facet's frame begins, which random numbers a patch has. So these decisions ask for places as seen from the
model itself, and what differs by rounding alone is equal.
"""

import itertools

import numpy as np

from lib.core.rows import distinct

SAME = 1e-6  # of the model's size: places that differ by less are one
FLAT = 1e-9  # the volume of three vectors, at most 1 long, that counts as none


def middle(p):
    """(3,) the mean of points (n, 3), each place counted once: a face that a file leaves out moves it nowhere."""
    p = np.asarray(p, float)
    low = p.min(axis=0)
    step = np.rint((p - low) / (SAME * max(float(np.ptp(p, axis=0).max()), 1e-300))).astype(np.int64)  # 20 bits each
    first = np.unique(step @ np.array([1 << 40, 1 << 20, 1]), return_index=True)[1]
    return low + (p[first] - low).mean(axis=0)


def farthest(p, centre, size):
    """(n,) int: of each set of points (n, k, 3) the one farthest from the centre; of equals the one with the least
    coordinates.  size : of the model
    """
    v = np.rint((p - centre) / (SAME * size))
    far = np.rint(np.linalg.norm(p - centre, axis=2) / (SAME * size))
    order = np.lexsort((v[..., 2], v[..., 1], v[..., 0], -far), axis=1)
    return order[:, 0]


def hand(p, centre):
    """1, or -1 where places (n, 3) are the mirror image of those that have 1; 1 of what is its own mirror image.

    The sense of three sums that turn and mirror with the places, each counted once: of v |v|, v |v|^2 and v |v|^3,
    v the way from the centre.
    """
    v = p.reshape(-1, 3) - centre
    v = v[distinct(np.rint(v / (SAME * max(float(np.abs(v).max()), 1e-300))))[0]]
    far = np.linalg.norm(v, axis=1, keepdims=True)
    sums = [(v * far**k).sum(axis=0) / max(float((far ** (k + 1)).sum()), 1e-300) for k in (1, 2, 3)]
    return -1 if np.linalg.det(sums) < -FLAT else 1


def smallest_ball(p):
    """Centre (3,) and radius of the smallest ball around points (n, 3).

    The farthest point that a ball leaves out joins those that hold it, and the ball of these few is the smallest of
    those through two to four of them that leave none of them out (Welzl 1991 has the same steps, one point at a time).

    >>> smallest_ball(np.array([[0.0, 0, 0], [2, 0, 0], [1, 0.5, 0], [1, 0, 1]]))
    (array([1., 0., 0.]), 1.0)
    """
    far = lambda centre: np.linalg.norm(p - centre, axis=1)
    held = [int(far(p[0]).argmax())]
    centre, radius = p[held[0]], 0.0
    for _ in range(len(p)):
        distance = far(centre)
        k = int(distance.argmax())
        if distance[k] <= radius * (1 + 1e-12) + 1e-300 or k in held:
            break
        held.append(k)
        best = None
        for n in range(2, min(4, len(held)) + 1):
            for some in itertools.combinations(held, n):
                c = _equally_far(p[list(some)])
                r = np.linalg.norm(p[some[0]] - c)
                holds = (np.linalg.norm(p[held] - c, axis=1) <= r * (1 + 1e-12)).all()
                if holds and (best is None or r < best[1] * (1 - 1e-12)):
                    best = c, r, list(some)
        centre, radius, held = best
    return centre, float(radius)


def _equally_far(q):
    """(3,) the point of the flat through points q (n, 3) that is as far from each."""
    edges = q[1:] - q[0]
    return q[0] + np.linalg.pinv(2 * edges) @ (edges**2).sum(axis=1)
