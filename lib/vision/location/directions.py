"""The camera's rotation from straight edges alone: parallel edges of the model meet in one vanishing point.

    turns = rotations(model_directions, segments, K, size)      # best first

A segment and the camera's centre span a plane; an edge of the model seen there is parallel to it. Two segments that
show the same direction fix it in the camera's frame, two such directions the rotation. All pairs of the likeliest
vanishing points are laid on all pairs of the model's directions at the same angle, and each rotation is scored by all
segments.
"""

from typing import NamedTuple

import numpy as np

MOST_SEGMENTS, MOST_DIRECTIONS, MOST_POINTS = 60, 8, 20
FIRST_POINTS, FIRST_SEGMENTS = 8, 16  # that are paired
ALIGNED, LOCATED_PX = 0.01, 0.7  # sine between a segment's plane and a direction that it shows; of its ends, across
ALIKE_RAD = 0.04  # between two angles that are the same
APART_RAD = 0.06  # between two vanishing points
DISTINCT_RAD = 0.05  # between two rotations
CLOSE = 0.8  # of the best score: others that are kept
LEAST_SCORE = 0.35  # of the segments' weight


class Turn(NamedTuple):
    """R : (3, 3) world to camera;  score : share of the segments' length that it explains"""

    R: np.ndarray
    score: float


def of_model(edges) -> np.ndarray:
    """(d, 3) unit: the directions that most of the model's edges have, by their length.  edges : of `model_edges`"""
    d = edges.b - edges.a
    length = np.linalg.norm(d, axis=1)
    d = d / np.maximum(length, 1e-300)[:, None]
    left, chosen = length.copy(), []
    while len(chosen) < MOST_DIRECTIONS and left.max(initial=0) > 0:
        like = np.abs(d @ d.T[:, left.argmax()]) > np.cos(ALIKE_RAD / 2)
        best = int(np.where(like, left, 0).argmax())
        chosen.append((float(left[like].sum()), d[best]))
        left[like] = 0
    total = sum(weight for weight, _ in chosen)
    return np.array([v for weight, v in sorted(chosen, key=lambda c: -c[0]) if weight > 0.01 * total])


def planes(segments, K):
    """((n, 3) unit normals of the planes through the camera's centre, (n,) px, (n,) sine) of segments (m, 2, 2).

    The longest of them, their lengths, and how far directions that they show may lie off their planes.
    """
    px = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    order = np.argsort(-px)[:MOST_SEGMENTS]
    ends = np.concatenate([segments[order], np.ones((len(order), 2, 1))], axis=2) @ np.linalg.inv(K).T
    n = np.cross(ends[:, 0], ends[:, 1])
    return n / np.linalg.norm(n, axis=1, keepdims=True), px[order], ALIGNED + LOCATED_PX / px[order]


def _vanishing_points(n, weight, slack):
    """(k, 3) unit directions in the camera's frame that most segments point to."""
    i, j = np.triu_indices(len(n), 1)
    v = np.cross(n[i], n[j])
    size = np.linalg.norm(v, axis=1)
    v = v[size > 0.05] / size[size > 0.05, None]
    support = np.maximum(1 - (v @ n.T / slack) ** 2, 0) @ weight
    found = []
    for _ in range(MOST_POINTS):
        best = int(support.argmax()) if len(support) else 0
        if len(support) == 0 or support[best] <= 0:
            break
        mine = np.abs(n @ v[best]) < slack
        point = np.linalg.svd(weight[mine, None] * n[mine])[2][2]
        found.append(point)
        support = np.where(np.abs(v @ v[best]) > np.cos(APART_RAD), 0, support)
    return np.array(found).reshape(-1, 3)


def rotations(directions, segments, K, most=80) -> list[Turn]:
    """The rotations that explain the segments best, different from each other.

    directions : (d, 3) of `of_model`;  segments : (m, 2, 2) px
    """
    if len(segments) < 4 or len(directions) < 2:
        return []
    n, px, slack = planes(segments, K)
    weight = np.minimum(px, np.median(px) * 3)
    points = _vanishing_points(n, weight, slack)
    if len(points) == 0:
        return []
    i, j = np.triu_indices(len(points), 1)
    R = np.concatenate([_laid(points[i], points[j], directions), _laid(*_square(points, n), directions)])
    if len(R) == 0:
        return []
    score = _scores(R, n, weight, slack, directions)
    order = np.argsort(-score, kind="stable")
    alive, chosen = score[order] >= max(CLOSE * score[order[0]], LEAST_SCORE), []
    while alive.any() and len(chosen) < most:
        k = order[int(alive.argmax())]
        turn = _polished(R[k], n, weight, slack, directions)
        chosen.append(Turn(turn, float(_scores(turn[None], n, weight, slack, directions)[0])))
        alive &= np.linalg.norm(R[order] - R[k], axis=(1, 2)) / np.sqrt(2) > DISTINCT_RAD
    return sorted(chosen, key=lambda turn: -turn.score)


def _square(points, n):
    """(m, 3), (m, 3): the first vanishing points, each with directions square to it that single segments show."""
    v, n = points[:FIRST_POINTS, None], n[None, :FIRST_SEGMENTS]
    w = np.cross(v, n)
    size = np.linalg.norm(w, axis=2)
    clear = size > 0.1  # else the segment shows the point's own direction, and tells no other
    v = np.broadcast_to(v, w.shape)
    return v[clear], w[clear] / size[clear][:, None]


def _laid(u, v, directions):
    """(r, 3, 3) rotations that lay pairs of directions on pairs u, v (m, 3) of the camera's, either sense."""
    A, B = np.nonzero(~np.eye(len(directions), dtype=bool))
    cosine, known = (u * v).sum(axis=1), (directions[A] * directions[B]).sum(axis=1)
    angle, angle_known = np.arccos(np.minimum(np.abs(cosine), 1)), np.arccos(np.minimum(np.abs(known), 1))
    i, j = np.nonzero(np.abs(angle[:, None] - angle_known[None]) < ALIKE_RAD)
    clear = (np.abs(cosine[i]) < 0.97) & (np.abs(known[j]) < 0.97)
    i, j = i[clear], j[clear]
    same = np.where(cosine[i] * known[j] < 0, -1.0, 1.0)
    square = np.abs(cosine[i]) < ALIKE_RAD  # either sense of the second will do
    out = []
    for s in (1.0, -1.0):
        for t, mine in ((same, np.ones(len(i), bool)), (-same, square)):
            own = _frames(s * u[i[mine]], s * t[mine, None] * v[i[mine]])
            out.append(own @ _frames(directions[A[j[mine]]], directions[B[j[mine]]]).transpose(0, 2, 1))
    return np.concatenate(out)


def _frames(u, v):
    """(n, 3, 3) columns: between two unit directions, across, and along both's normal."""
    b, c = u + v, u - v
    b, c = (x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12) for x in (b, c))
    return np.stack([b, c, np.cross(b, c)], axis=2)


def _scores(R, n, weight, slack, directions):
    """(r,) share of the weight of segments that show one of the directions."""
    best = np.full((len(R), len(n)), np.inf)
    for d in directions:
        best = np.minimum(best, np.abs((R @ d) @ n.T))
    return np.maximum(1 - (best / slack) ** 2, 0) @ weight / weight.sum()


def _polished(R, n, weight, slack, directions):
    """The rotation turned until its directions lie in the segments' planes: least squares, robust."""
    from scipy.spatial.transform import Rotation

    for _ in range(6):
        d = directions @ R.T
        off = n @ d.T
        which = np.abs(off).argmin(axis=1)
        r = off[np.arange(len(n)), which]
        w = weight * np.maximum(1 - (r / slack) ** 2, 0) ** 2
        J = np.cross(d[which], n)  # d (n . exp(w) d) / dw
        H = (w[:, None] * J).T @ J
        step = -np.linalg.solve(H + 1e-9 * max(np.trace(H), 1e-12) * np.eye(3), J.T @ (w * r))
        R = Rotation.from_rotvec(step).as_matrix() @ R
    return R
