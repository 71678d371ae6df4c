"""Poses from corners: a corner of two lines in space, laid on a corner of the model, fixes the whole pose.

    found = hypotheses(scene, model, sides)         # the best by the lines alone, and how many were compared

A corner of the pair may lie on every corner of the model that has about its angle and edges at least as long, either
way round. Each pose is ranked by all lines of the pair: points on them are looked up in the distance field of the
model's edges. The best are moved until the points lie on the edges as well as they can (least squares, robust). Which
is right the photographs say (lib/vision/refinement).

Lines must be in metres: a corner says nothing of the scale.
"""

from typing import NamedTuple

import numpy as np

from lib.vision.corners import hypotheses_kernels as kernels
from lib.vision.corners import lines as lines_
from lib.vision.recognition.closed_form import DISTINCT, DISTINCT_RAD, moved
from lib.vision.refinement.edges import model_edges

MOST = 37_000  # poses that are ranked
CELLS = 2_000_000  # of the distance field
LOOSE, EXACT = 0.025, 0.004  # of the depth: how far the other lines may be wrong, at first and in the end
POINT_PX = 10.0  # a point for so much of a line in the photograph
WITNESS_PX = 25.0  # and a witness, as elsewhere (refinement/evidence.py)
ANGLE_RAD = 0.06  # that two corners alike may differ by, beside the sigma
LONGER = 1.05  # than the edge of the model a line may be, beside the sigma
POLISHED = 200  # poses that are moved onto the edges


class Hypotheses(NamedTuple):
    """T : (n, 4, 4) world to the left camera, best first;  nats : (n,) what the lines say for them

    tried : how many poses were ranked;  lines, corners : how many the pair has;  depth : m, of the lines
    """

    T: np.ndarray
    nats: np.ndarray
    tried: int
    lines: int
    corners: int
    depth: float


class Points(NamedTuple):
    """Points on the lines: p (n, 3) m, left frame;  sigma (n,) m"""

    p: np.ndarray
    sigma: np.ndarray


def hypotheses(scene, model, sides, most=24) -> Hypotheses:
    """The best poses by the lines of the pair, different from each other.

    scene : SceneFacets in metres, any number;  sides : rig.Side of both photographs;  most : poses that are returned
    """
    edges = model_edges(model)
    lines = lines_.of_pair(scene, sides)
    corners = lines_.corners(lines)
    R, t = _poses(corners, model, edges)
    depth = float(np.median(np.concatenate([lines.a[:, 2], lines.b[:, 2]]))) if len(lines.a) else 0.0
    counts = (len(R), len(lines.a), len(corners.apex), depth)
    if len(R) == 0:
        return Hypotheses(np.zeros((0, 4, 4)), np.zeros(0), *counts)
    points, grid = _points(lines), _Grid(edges)
    reach = np.maximum(np.hypot(LOOSE * depth, 2 * points.sigma), 1.5 * grid.field.cell)
    nats = kernels.scores(grid.field, R, t, points.p, reach, grid.worth(reach))
    best = _different(R, t, nats, points, depth, POLISHED)
    R, t = R[best], t[best]
    least = np.maximum(EXACT * depth, 2 * points.sigma)
    for part in (1.0, 0.6, 0.35, 0.2):
        R, t = _settled(R, t, points, np.maximum(part * reach, least), grid)
    nats = _exact(R, t, points, least, grid)
    best = _different(R, t, nats, points, depth, most)
    T = np.tile(np.eye(4), (len(best), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R[best], t[best]
    return Hypotheses(T, nats[best], *counts)


# Corners on corners.


def _poses(corners, model, edges):
    """(R (h, 3, 3), t (h, 3)) of every corner of the pair on every one of the model that is like it, at most MOST.

    The best corners of the pair come first. A facet's corner lies on a corner of a facet that shows its front.
    """
    apex, u, v, length, angle, normal = _model_corners(model, edges)
    turned = _frames(u, v), _frames(v, u)
    R, t, number = [], [], 0
    for k, own in enumerate(_frames(corners.u, corners.v)):
        alike = np.abs(angle - corners.angle[k]) < ANGLE_RAD + corners.sigma[k]
        for order, frames in ((slice(None), turned[0]), (slice(None, None, -1), turned[1])):
            room = LONGER * length[:, order] + 3 * corners.sigma[k] * length[:, order] >= corners.reach[k]
            mine = np.flatnonzero(alike & room.all(axis=1))
            turn = np.einsum("ij,hkj->hik", own, frames[mine])
            if corners.normal[k].any():
                shown = np.einsum("i,hij,hj->h", corners.normal[k], turn, normal[mine])
                mine, turn = mine[shown >= 0], turn[shown >= 0]
            R.append(turn)
            t.append(corners.apex[k] - np.einsum("hij,hj->hi", turn, apex[mine]))
            number += len(mine)
        if number > MOST:
            break
    if not R:
        return np.zeros((0, 3, 3)), np.zeros((0, 3))
    return np.concatenate(R)[:MOST], np.concatenate(t)[:MOST]


def _frames(u, v):
    """(n, 3, 3) columns: between two unit directions, across, and along both's normal."""
    b, c = u + v, u - v
    b, c = (x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-12) for x in (b, c))
    return np.stack([b, c, np.cross(b, c)], axis=-1)


def _model_corners(model, edges):
    """Corners of every two edges that meet: apex (m, 3), u, v (m, 3) along both, their lengths (m, 2), angle (m,).

    And the normal (m, 3) of the facet that has both, 0 where none has or where its back can be seen too.
    """
    ends, lengths = np.concatenate([edges.a, edges.b]), np.linalg.norm(edges.b - edges.a, axis=1)
    place = np.unique(ends + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    order = np.argsort(place, kind="stable")
    pairs = []
    for group in np.split(order, np.flatnonzero(np.diff(place[order])) + 1):
        i, j = np.triu_indices(len(group), 1)
        pairs.append(np.column_stack([group[i], group[j]]))
    first, second = np.concatenate(pairs).T
    E = len(lengths)
    away = np.concatenate([edges.b - edges.a, edges.a - edges.b]) / np.maximum(np.tile(lengths, 2), 1e-12)[:, None]
    u, v = away[first], away[second]
    angle = np.arccos(np.clip(np.einsum("ni,ni->n", u, v), -1, 1))
    keep = (angle > lines_.LEAST_RAD / 2) & (angle < np.pi - lines_.LEAST_RAD / 2)
    first, second, u, v, angle = first[keep], second[keep], u[keep], v[keep], angle[keep]
    of_first, of_second = edges.facets[first % E], edges.facets[second % E]
    same = (of_first[:, :, None] == of_second[:, None, :]) & (of_first[:, :, None] >= 0)
    one = same.any(axis=2)
    facet = np.where(one.sum(axis=1) == 1, of_first[np.arange(len(first)), one.argmax(axis=1)], -1)
    solid = (facet >= 0) & model.closed_objects[model.facet_object[facet]]
    normal = np.where(solid[:, None], model.facet_normal[facet], 0)
    return ends[first], u, v, np.column_stack([lengths[first % E], lengths[second % E]]), angle, normal


# Lines on edges.


def _points(lines) -> Points:
    """A point for every POINT_PX of a line."""
    count = np.maximum(1, np.round(lines.px / POINT_PX).astype(int))
    line = np.repeat(np.arange(len(count)), count)
    s = (np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[line]
    return Points(lines.a[line] + s[:, None] * (lines.b - lines.a)[line], lines.sigma[line])


class _Grid:
    """The model's edges on a grid: distances, and which edge is nearest."""

    def __init__(self, edges):
        from scipy.ndimage import distance_transform_edt

        ends = np.concatenate([edges.a, edges.b])
        low, size = ends.min(axis=0), np.ptp(ends, axis=0)
        margin = 0.05 * size.max()
        low, size = low - margin, size + 2 * margin
        cell = float((np.prod(size) / CELLS) ** (1 / 3))
        shape = tuple(np.maximum(2, np.ceil(size / cell)).astype(int) + 1)
        length = np.linalg.norm(edges.b - edges.a, axis=1)
        count = np.maximum(2, np.ceil(2 * length / cell).astype(int) + 1)
        edge = np.repeat(np.arange(len(count)), count)
        s = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)) / (count[edge] - 1)
        p = edges.a[edge] + s[:, None] * (edges.b - edges.a)[edge]
        owner = np.full(shape, -1, np.int32)
        owner[tuple(np.rint((p - low) / cell).astype(int).T)] = edge
        far, at = distance_transform_edt(owner < 0, return_indices=True)
        self.field = kernels.Field((far * cell).astype(np.float32), low, cell)
        self.owner = owner[tuple(at)]
        self.a, self.length = edges.a, length
        self.along = (edges.b - edges.a) / np.maximum(length, 1e-12)[:, None]
        self.spread = np.sort(self.field.distance[::3, ::3, ::3].ravel())

    def worth(self, reach):
        """(n,) nats of a point within `reach` (n,) of an edge, by how much of the model's box is as near to one."""
        chance = np.searchsorted(self.spread, reach) / len(self.spread)
        return -np.log(np.clip(chance, 1e-3, 1)) * POINT_PX / WITNESS_PX

    def nearest(self, w):
        """(edge (...,), the nearest place on it (..., 3), distance (...,)) of world points w (..., 3)."""
        cell = np.clip(np.rint((w - self.field.low) / self.field.cell), 0, np.array(self.owner.shape) - 1).astype(int)
        edge = self.owner[tuple(np.moveaxis(cell, -1, 0))]
        s = np.clip(np.einsum("...i,...i->...", w - self.a[edge], self.along[edge]), 0, self.length[edge])
        at = self.a[edge] + s[..., None] * self.along[edge]
        return edge, at, np.linalg.norm(w - at, axis=-1)


def _settled(R, t, points, gate, grid, steps=2):
    """Gauss-Newton steps that bring the points onto their nearest edges.  gate : (n,) m, where a point loses its say"""
    R, t = R.copy(), t.copy()
    for _ in range(steps):
        for h in range(len(R)):
            w = (points.p - t[h]) @ R[h]
            edge, at, far = grid.nearest(w)
            mine = np.flatnonzero(far < gate)
            if len(mine) < 8:
                continue
            weight = (1 - (far[mine] / gate[mine]) ** 2) ** 2 / np.maximum(points.sigma[mine], 1e-9) ** 2
            x, along = at[mine] @ R[h].T + t[h], grid.along[edge[mine]] @ R[h].T
            r = points.p[mine] - x
            r -= np.einsum("ni,ni->n", r, along)[:, None] * along
            J = np.zeros((len(mine), 3, 6))
            J[:, 0, 1], J[:, 0, 2], J[:, 1, 2] = x[:, 2], -x[:, 1], x[:, 0]
            J[:, :, :3] -= J[:, :, :3].transpose(0, 2, 1)
            J[:, :, 3:] = np.eye(3)
            J -= along[:, :, None] * np.einsum("ni,nik->nk", along, J)[:, None]
            JW = J * weight[:, None, None]
            H, b = np.einsum("nik,nil->kl", JW, J), np.einsum("nik,ni->k", JW, r)
            H += 1e-6 * np.diag(np.diag(H)) + 1e-12 * np.trace(H) * np.eye(6)
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = R[h], t[h]
            T = moved(T, np.linalg.solve(H, b))
            R[h], t[h] = T[:3, :3], T[:3, 3]
    return R, t


def _exact(R, t, points, gate, grid):
    """(h,) nats, by distances to the edges themselves."""
    worth = grid.worth(np.maximum(gate, 0.7 * grid.field.cell))
    far = np.array([grid.nearest((points.p - c) @ turn)[2] for turn, c in zip(R, t, strict=True)])
    return (worth * np.maximum(1 - (far / gate) ** 2, 0)).sum(axis=1)


def _different(R, t, nats, points, depth, most):
    """(n,) the best poses, without those that put the scene where a better one puts it."""
    pivot = np.median(points.p, axis=0)
    order = np.argsort(-nats, kind="stable")[: 40 * most]
    centre = np.einsum("hji,hj->hi", R[order], pivot - t[order])
    alive, chosen = np.ones(len(order), bool), []
    while alive.any() and len(chosen) < most:
        k = int(alive.argmax())
        chosen.append(order[k])
        turn = np.linalg.norm(R[order] - R[order[k]], axis=(1, 2)) / np.sqrt(2)
        alive &= (turn > DISTINCT_RAD) | (np.linalg.norm(centre - centre[k], axis=1) > DISTINCT * depth)
    return np.array(chosen, int)


def warm_up():
    """Compiles, or reads from the cache, what is compiled."""
    field = kernels.Field(np.zeros((2, 2, 2), np.float32), np.zeros(3), 1.0)
    one = np.ones(1)
    kernels.scores(field, np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 3)), one, one)
