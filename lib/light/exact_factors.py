"""Form factors in closed form (eq. 3.3): polygons that see each other whole.

    F = polygon_to_polygon(P, Q)                 # (n, 3), (m, 3), counter-clockwise from the front
    F = point_to_polygon(p, n, Q)
    rows = rows(surface, mesh)                   # where nothing can stand between two patches

Stokes' theorem, twice, turns the double area integral of eq. 3.3 into one along both contours

    A_1 F_12 = 1 / (2 pi)  sum over edges of 1, edges of 2 of  (u . v) int int ln r ds dt

once each polygon is clipped by the plane of the other. The inner integral is elementary, for parallel edges the
outer one too. Otherwise it is done by quadrature: Gauss where the edges are apart, and where they are near or touch
tanh-sinh between the points at which the integrand has its logarithms and kinks. Error about 1e-12.
"""

from __future__ import annotations

import numpy as np

from lib.given import rays
from lib.light import exact_factors_kernels as kernels
from lib.light.form_factors import FormFactorRows
from lib.light.lamps_kernels import polygon_factor


class NotExact(ValueError):
    """Something may stand in the way, or patches overlap: these factors would not be exact."""


def _newell(corners):
    """Area vector of a polygon (n, 3), taken relative to its first corner: nothing cancels far from the origin."""
    v = corners - corners[0]
    return 0.5 * np.cross(v[:-1], v[1:]).sum(axis=0)


def polygon_to_polygon(P, Q) -> float:
    """F from the polygon P to the polygon Q, nothing between them: the fraction of the light leaving P's front that
    reaches Q's front. P, Q : (n, 3), counter-clockwise from the front, planar; they may touch, not cross.

    What lies behind the other's plane takes no part. A target without area receives nothing; a source without area
    has no factor and is refused with ValueError.

    >>> square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.]])
    >>> round(polygon_to_polygon(square, square[::-1] + [0, 0, 1]), 12)
    0.199824895698
    """
    P, Q = _corners(P), _corners(Q)
    n_p, n_q = _newell(P), _newell(Q)
    a_p, a_q = np.linalg.norm(n_p), np.linalg.norm(n_q)
    middle = P[0].copy()
    P, Q = P - middle, Q - middle
    size = max(np.ptp(P, axis=0).max(), np.ptp(Q, axis=0).max())
    if not a_p > 1e-14 * np.ptp(P, axis=0).max() ** 2:
        raise ValueError("the polygon that sends has no area: its factor is not defined")
    if not a_q > 1e-14 * np.ptp(Q, axis=0).max() ** 2:
        return 0.0
    return float(kernels.contours(P, n_p / a_p, P[0], Q, n_q / a_q, Q[0], size) / a_p)


def point_to_polygon(p, n, Q) -> float:
    """F from the element at p with the normal n to the polygon Q (m, 3): Lambert's formula, clipped at the horizon.
    As in form_factors, it does not matter which side of Q is the front.

    >>> square = np.array([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2.]]) / 2
    >>> round(abs(point_to_polygon([0, 0, 0], [0, 0, 1], square)), 14)
    0.23945647046077
    """
    Q, p, n = _corners(Q), np.asarray(p, float), np.asarray(n, float)
    if not np.isfinite(p).all() or not np.linalg.norm(n) > 0:
        raise ValueError("the element needs a place and a direction")
    return float(abs(polygon_factor(p, n / np.linalg.norm(n), Q, len(Q), np.empty((2 * len(Q) + 2, 3)))))


def _corners(P):
    P = np.ascontiguousarray(P, float)
    if P.ndim != 2 or P.shape[1] != 3 or len(P) < 3 or not np.isfinite(P).all():
        raise ValueError(f"a polygon has 3 or more corners of 3 finite numbers, not the shape {P.shape}")
    return P


# ---- all patches of a mesh ----


def outlines(surface, mesh):
    """The contour of every patch: corners (K, 3) local, loop_start (L + 1,), patch_start (N + 1,) into the loops.

    The pieces of a patch share edges, which cancel in a contour integral: taken out here, they cost nothing there.
    """
    f = mesh.side // 2
    corners, loop_start, patch_start = [], [0], [0]
    for i in range(len(mesh)):
        pieces = mesh.tri_uv[mesh.tri_start[i] : mesh.tri_start[i + 1]]
        loops = _outline(pieces, 1e-9 * np.ptp(pieces.reshape(-1, 2), axis=0).max())
        for uv in loops:
            p = surface.origin[f[i]] + uv[:, :1] * surface.axes[f[i], 0] + uv[:, 1:] * surface.axes[f[i], 1]
            corners.append(p[::-1] if (mesh.side[i] & 1) ^ (surface.hand < 0) else p)
            loop_start.append(loop_start[-1] + len(p))
        patch_start.append(len(loop_start) - 1)
    return np.ascontiguousarray(np.concatenate(corners)), np.array(loop_start), np.array(patch_start)


def _outline(pieces, near):
    """Loops (n, 2), counter-clockwise, round a set of triangles (k, 3, 2)."""
    u, v = pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    pieces = np.where((area < 0)[:, None, None], pieces[:, ::-1], pieces)
    points = pieces.reshape(-1, 2)
    same = {}
    name = [same.setdefault(tuple(key), len(same)) for key in np.round(points / near / 8).astype(np.int64)]
    place = dict(zip(name, points, strict=True))
    loops = [_straighten(np.array([place[k] for k in loop]), near) for loop in _closed(_border(name))]
    return [loop for loop in loops if len(loop) >= 3]


def _border(name):
    """{(a, b): how often} of the directed edges of triangles whose reverse does not occur.

    name : [number of each corner], three to a triangle
    """
    edges = {}
    for a, b, c in zip(name[0::3], name[1::3], name[2::3], strict=True):
        for e in ((a, b), (b, c), (c, a)):
            if e[0] == e[1]:
                continue
            if edges.get(e[::-1]):
                edges[e[::-1]] -= 1
            else:
                edges[e] = edges.get(e, 0) + 1
    return edges


def _closed(edges):
    """Directed edges joined to loops: [[corner, ...]]"""
    following = {}
    for (a, b), count in edges.items():
        for _ in range(count):
            following.setdefault(a, []).append(b)
    loops = []
    while following:
        first = here = next(iter(following))
        loop = []
        while True:
            loop.append(here)
            there = following[here].pop()
            if not following[here]:
                del following[here]
            here = there
            if here == first:
                break
        loops.append(loop)
    return loops


def _straighten(loop, near):
    """Without corners on the straight line between their neighbours."""
    keep = np.ones(len(loop), bool)
    for i in range(len(loop)):
        others = np.flatnonzero(keep)
        if len(others) <= 3:
            break
        k = np.searchsorted(others, i)
        a, b, c = loop[others[k - 1]], loop[i], loop[others[(k + 1) % len(others)]]
        d = c - a
        length = np.hypot(*d)
        near_line = length > 0 and abs(d[0] * (b - a)[1] - d[1] * (b - a)[0]) < near * length
        if near_line and (b - a) @ d >= 0 and (c - b) @ d >= 0:
            keep[i] = False
    return loop[keep]


def factors(surface, mesh) -> np.ndarray:
    """F (N, N) float64 between all patches, exact. Raises NotExact, in one line, where it would not be."""
    standing = np.flatnonzero(rays.occluders(surface.corners, surface.facet))
    if len(standing):
        raise NotExact(
            f"analytic form factors: {len(standing)} facets can stand between two others (the first is facet "
            f"{standing[0]} of group '{surface.groups[surface.group[standing[0]]]}'); use rays"
        )
    corners, loop_start, patch_start = outlines(surface, mesh)
    f = mesh.side // 2
    normal = np.ascontiguousarray(surface.normal[f] * (1 - 2 * (mesh.side & 1))[:, None])
    origin = np.ascontiguousarray(surface.origin[f])
    first = loop_start[patch_start[:-1]]
    owner = np.repeat(np.arange(len(mesh)), np.diff(np.append(first, len(corners))))
    radius = np.zeros(len(mesh))
    np.maximum.at(radius, owner, np.linalg.norm(corners - mesh.centre[owner], axis=1))
    F = kernels.all_pairs(corners, loop_start, patch_start, normal, origin, mesh.area, mesh.centre, radius)
    most = F.sum(axis=1).max(initial=0.0)
    if most > 1 + 1e-6:
        raise NotExact(
            f"analytic form factors: a patch sends {most:.6f} of its light, so others overlap in its sight; use rays"
        )
    return F


def rows(surface, mesh) -> FormFactorRows:
    """`factors` as rows: as if each patch had two rays, and both halves of them agreed."""
    F = factors(surface, mesh)
    at = np.nonzero(F)
    count = F[at].astype(np.float32)
    one = np.ones(len(F), np.float32)
    return FormFactorRows(
        indptr=np.concatenate([[0], np.cumsum((F > 0).sum(axis=1))]).astype(np.int64),
        indices=at[1].astype(np.int32),
        count=2 * count,
        half=count,
        valid=2 * one,
        valid_half=one,
        shot=np.full(len(F), 2),
        lost=0 * one,
        columns=len(F),
    )
