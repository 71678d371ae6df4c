"""A model without some objects and with others, whose facets keep their numbers: what is added stands behind them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.given.model.mesh import Model
from lib.given.model.parts import joined, only


def emptied(model: Model, objects) -> Model:
    """The model with the facets of these objects, but none of their triangles."""
    gone = np.isin(model.facet_object, [model.objects.index(name) for name in objects])
    keep = ~gone[model.triangle_facet]
    return replace(model, triangles=model.triangles[keep], triangle_facet=model.triangle_facet[keep])


def moved(model: Model, name, offset) -> Model:
    """The model with an object elsewhere: its facets are new ones, in the same order. offset : (3,) m"""
    thing = placed(only(model, [name]), np.eye(3), offset)
    return joined(emptied(model, [name]), f"{name} moved", thing)


def placed(model: Model, turn, at, scale=1.0) -> Model:
    """The model at p_world = at + turn (scale p). turn : (3, 3) rotation;  at : (3,) m"""
    vertices = np.asarray(at, float) + scale * model.vertices @ np.transpose(turn)
    normal = model.facet_normal @ np.transpose(turn)
    offset = scale * model.facet_offset + normal @ np.asarray(at, float)
    return replace(model, vertices=vertices, facet_normal=normal, facet_offset=offset)


def renamed(model: Model, groups) -> Model:
    """The model with other names for its groups, (G,) in their order."""
    return replace(model, groups=tuple(groups))


def turned(angles) -> np.ndarray:
    """(3, 3) Rz Ry Rx. angles : (x, y, z) rad

    >>> turned([0, 0, np.pi / 2]).round(9) @ [1, 0, 0]
    array([0., 1., 0.])
    """
    x, y, z = angles
    cos, sin = np.cos, np.sin
    Rx = np.array([[1, 0, 0], [0, cos(x), -sin(x)], [0, sin(x), cos(x)]])
    Ry = np.array([[cos(y), 0, sin(y)], [0, 1, 0], [-sin(y), 0, cos(y)]])
    Rz = np.array([[cos(z), -sin(z), 0], [sin(z), cos(z), 0], [0, 0, 1]])
    return Rz @ Ry @ Rx


def ellipsoid(axes, group, finer=3) -> Model:
    """A closed surface of flat triangles, whose corners lie on the ellipsoid about the origin, seen from outside.

    axes : (3,) semi-axes, m;  finer : times that the triangles of an icosahedron are halved: 3 are 1,280 of them, whose
    middles lie up to .24 % of the radius inside
    """
    p, triangles = _icosahedron()
    for _ in range(finer):
        p, triangles = _halved(p, triangles)
    vertices = p * np.asarray(axes, float)
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    n = len(triangles)
    zeros = np.zeros(n, np.int32)
    offset = np.einsum("ij,ij->i", normal, corners[:, 0])
    facet = np.arange(n, dtype=np.int32)
    faces = triangles.astype(np.int32)
    return Model(vertices, faces, facet, zeros, zeros, normal, offset, (group,), (group,), (), np.ones(1, bool))


def luminous(axes, group) -> Model:
    """An ellipsoid that is a lamp, of 80 triangles: a place has an exact factor to each. A sphere keeps its area."""
    ball = ellipsoid(axes, group, finer=1)
    sphere = ellipsoid([1, 1, 1], group, finer=1)
    return placed(ball, np.eye(3), np.zeros(3), float(np.sqrt(4 * np.pi / sphere.facet_area().sum())))


def _icosahedron():
    """(12, 3) unit corners, (20, 3) triangles, counter-clockwise seen from outside."""
    g = (1 + np.sqrt(5)) / 2
    p = np.array([[0, a, b * g] for a in (-1, 1) for b in (-1, 1)], float)
    p = np.concatenate([np.roll(p, k, axis=1) for k in range(3)]) / np.sqrt(1 + g * g)
    near = np.linalg.norm(p[:, None] - p[None], axis=2) < 1.1  # the edge is 1.05
    i, j, k = np.nonzero(near[:, :, None] & near[None] & near[:, None, :])
    triangles = np.column_stack([i, j, k])[(i < j) & (j < k)]
    a, b, c = np.moveaxis(p[triangles], 1, 0)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return p, triangles


def _halved(p, triangles):
    """Each triangle cut into four, new corners on the unit sphere."""
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    edges, which = np.unique(sides, axis=0, return_inverse=True)
    middle = p[edges].mean(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    ab, bc, ca = len(p) + which.reshape(3, -1)
    a, b, c = triangles.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([p, middle]), np.concatenate([np.column_stack(part) for part in parts])
