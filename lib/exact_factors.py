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
from numba import njit, prange

FLAT = 1e-9          # of a polygon's size: nearer to the other's plane is on it


class NotExact(ValueError):
    """Something may stand in the way, or patches overlap: these factors would not be exact."""


# -- quadrature on [0, 1]

def _gauss(n):
    x, w = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, w / 2


def _tanh_sinh(step=0.125, reach=3.25):
    """Distance from the nearer end (which keeps its digits next to it), whether that is the upper end, and weight."""
    t = np.arange(-round(reach / step), round(reach / step) + 1) * step
    q = np.exp(-np.pi * np.sinh(np.abs(t)))
    return q / (1 + q), t > 0, step * np.pi * np.cosh(t) * q / (1 + q) ** 2


_X6, _W6 = _gauss(6)
_X10, _W10 = _gauss(10)
_X22, _W22 = _gauss(22)
_XT, _UP, _WT = _tanh_sinh()


@njit(cache=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def _inner(px, py, pz, c, v, length, scale):
    """Integral of ln(r / scale) along the edge c + t v, 0 <= t <= length, from the point p."""
    x, y, z = px - c[0], py - c[1], pz - c[2]
    along = x * v[0] + y * v[1] + z * v[2]
    # the distance from the line by the cross product: a difference of squares would lose half the digits
    e0, e1, e2 = y * v[2] - z * v[1], z * v[0] - x * v[2], x * v[1] - y * v[0]
    d2 = e0 * e0 + e1 * e1 + e2 * e2
    d = np.sqrt(d2)
    t1, t0 = length - along, -along
    total = -length
    r2 = (t1 * t1 + d2) / (scale * scale)
    if r2 > 0:
        total += 0.5 * t1 * np.log(r2)
    r2 = (t0 * t0 + d2) / (scale * scale)
    if r2 > 0:
        total -= 0.5 * t0 * np.log(r2)
    if d > 0:
        total += d * np.arctan2(d * length, d2 + t1 * t0)          # the angle that the edge subtends
    return total


@njit(cache=True)
def _parallel(x, h2, scale2):
    """Second antiderivative of ln(sqrt(x^2 + h^2) / scale)."""
    r2 = x * x + h2
    if r2 <= 0:
        return 0.0
    h = np.sqrt(h2)
    return 0.25 * (x * x - h2) * np.log(r2 / scale2) - 0.75 * x * x + h * x * np.arctan2(x, h)


@njit(cache=True)
def _edges(a, b, c, d, scale):
    """(u . v) times the double integral of ln(r / scale) along a-b and c-d."""
    u, v = b - a, d - c
    lu, lv = np.sqrt(_dot(u, u)), np.sqrt(_dot(v, v))
    if lu <= 0 or lv <= 0:
        return 0.0
    if lu > lv:                                                     # along the shorter edge numerically
        a, b, c, d, u, v, lu, lv = c, d, a, b, v, u, lv, lu
    u = u / lu
    v = v / lv
    cosine = _dot(u, v)
    if abs(cosine) < 1e-15:
        return 0.0
    w = c - a
    cross0, cross1, cross2 = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    sine2 = cross0 * cross0 + cross1 * cross1 + cross2 * cross2
    if sine2 < 1e-24:
        along = _dot(w, u)
        h0, h1, h2 = w[0] - along * u[0], w[1] - along * u[1], w[2] - along * u[2]
        h = h0 * h0 + h1 * h1 + h2 * h2
        s2 = scale * scale
        x0, x1 = along, along + (lv if cosine > 0 else -lv)
        # d2/dsdt of the antiderivative of x = t - s has a minus
        value = _parallel(x1, h, s2) - _parallel(x0, h, s2) - _parallel(x1 - lu, h, s2) + _parallel(x0 - lu, h, s2)
        return abs(cosine) * value                                  # dt runs backwards where the cosine is negative
    middle = (a + b - c - d) / 2
    apart = 2 * (np.sqrt(_dot(middle, middle)) - (lu + lv) / 2) / lu
    total = 0.0
    if apart > 0.7:
        if apart > 5:
            X, W = _X6, _W6
        elif apart > 2:
            X, W = _X10, _W10
        else:
            X, W = _X22, _W22
        for k in range(len(X)):
            s = X[k] * lu
            total += W[k] * _inner(a[0] + s * u[0], a[1] + s * u[1], a[2] + s * u[2], c, v, lv, scale)
        return cosine * lu * total
    # near the ends of the other edge and where the lines come closest the integrand has logarithms and kinks
    cuts = np.empty(5)
    cuts[0], cuts[4] = 0.0, lu
    cuts[1] = min(max(_dot(w, u), 0.0), lu)
    cuts[2] = min(max(_dot(d - a, u), 0.0), lu)
    cuts[3] = min(max((_dot(w, u) - _dot(w, v) * cosine) / sine2, 0.0), lu)
    cuts.sort()
    for i in range(4):
        low, high = cuts[i], cuts[i + 1]
        if high - low <= 1e-15 * lu:
            continue
        part = 0.0
        for k in range(len(_XT)):
            s = high - (high - low) * _XT[k] if _UP[k] else low + (high - low) * _XT[k]
            part += _WT[k] * _inner(a[0] + s * u[0], a[1] + s * u[1], a[2] + s * u[2], c, v, lv, scale)
        total += part * (high - low)
    return cosine * total


@njit(cache=True)
def _clip(corners, n, origin, tolerance, out):
    """The part in front of a plane (Sutherland and Hodgman); returns how many corners."""
    count = len(corners)
    m = 0
    for i in range(count):
        a, b = corners[i], corners[(i + 1) % count]
        da, db = _dot(a - origin, n), _dot(b - origin, n)
        if abs(da) <= tolerance:
            da = 0.0
        if abs(db) <= tolerance:
            db = 0.0
        if da >= 0:
            out[m] = a
            m += 1
        if (da > 0 and db < 0) or (da < 0 and db > 0):
            out[m] = a + (b - a) * (da / (da - db))
            m += 1
    return m


@njit(cache=True)
def _contours(P, n_p, o_p, Q, n_q, o_q, size):
    """A_1 F_12 of two planar loops with unit normals n through o."""
    tolerance = FLAT * size
    front = False
    for i in range(len(Q)):
        front |= _dot(Q[i] - o_p, n_p) > tolerance
    if not front:
        return 0.0
    front = False
    for i in range(len(P)):
        front |= _dot(P[i] - o_q, n_q) > tolerance
    if not front:
        return 0.0
    p, q = np.empty((2 * len(P) + 2, 3)), np.empty((2 * len(Q) + 2, 3))
    kp, kq = _clip(P, n_q, o_q, tolerance, p), _clip(Q, n_p, o_p, tolerance, q)
    total = 0.0
    for i in range(kp):
        for j in range(kq):
            total += _edges(p[i], p[(i + 1) % kp], q[j], q[(j + 1) % kq], size)
    return total / (2 * np.pi)


def _newell(corners):
    """Area vector, relative to the first corner so that nothing cancels far from the origin."""
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
    return float(_contours(P, n_p / a_p, P[0], Q, n_q / a_q, Q[0], size) / a_p)


def point_to_polygon(p, n, Q) -> float:
    """F from the element at p with the normal n to the polygon Q (m, 3): Lambert's formula, clipped at the horizon.
    As in form_factors, it does not matter which side of Q is the front.

    >>> square = np.array([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2.]]) / 2
    >>> round(abs(point_to_polygon([0, 0, 0], [0, 0, 1], square)), 14)
    0.23945647046077
    """
    from lib.form_factors import polygon_factor
    Q, p, n = _corners(Q), np.asarray(p, float), np.asarray(n, float)
    if not np.isfinite(p).all() or not np.linalg.norm(n) > 0:
        raise ValueError("the element needs a place and a direction")
    return float(abs(polygon_factor(p, n / np.linalg.norm(n), Q, len(Q), np.empty((2 * len(Q) + 2, 3)))))


def _corners(P):
    P = np.ascontiguousarray(P, float)
    if P.ndim != 2 or P.shape[1] != 3 or len(P) < 3 or not np.isfinite(P).all():
        raise ValueError(f"a polygon has 3 or more corners of 3 finite numbers, not the shape {P.shape}")
    return P


# -- all patches of a mesh

def outlines(surface, mesh):
    """The contour of every patch: corners (K, 3) local, loop_start (L + 1,), patch_start (N + 1,) into the loops.

    The pieces of a patch share edges, which cancel in a contour integral: taken out here, they cost nothing there.
    """
    f = mesh.side // 2
    corners, loop_start, patch_start = [], [0], [0]
    for i in range(len(mesh)):
        pieces = mesh.tri_uv[mesh.tri_start[i]:mesh.tri_start[i + 1]]
        loops = _outline(pieces, 1e-9 * np.ptp(pieces.reshape(-1, 2), axis=0).max())
        for uv in loops:
            p = surface.origin[f[i]] + uv[:, :1] * surface.axes[f[i], 0] + uv[:, 1:] * surface.axes[f[i], 1]
            corners.append(p[::-1] if mesh.side[i] & 1 else p)
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
    place = dict(zip(name, points))
    edges = {}
    for a, b, c in zip(*[iter(name)] * 3):
        for e in ((a, b), (b, c), (c, a)):
            if e[0] == e[1]:
                continue
            if edges.get(e[::-1]):
                edges[e[::-1]] -= 1
            else:
                edges[e] = edges.get(e, 0) + 1
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
        loops.append(_straighten(np.array([place[k] for k in loop]), near))
    return [loop for loop in loops if len(loop) >= 3]


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
        if length > 0 and abs(d[0] * (b - a)[1] - d[1] * (b - a)[0]) < near * length and (b - a) @ d >= 0 and (c - b) @ d >= 0:
            keep[i] = False
    return loop[keep]


@njit(cache=True, parallel=True)
def _all(corners, loop_start, patch_start, normal, origin, area, centre, radius):
    n = len(area)
    AF = np.zeros((n, n))
    for k in prange(n):
        i = k // 2 if k % 2 == 0 else n - 1 - k // 2               # long rows and short rows in turn
        for j in range(i + 1, n):
            ni, nj = normal[i], normal[j]
            if _dot(centre[j] - origin[i], ni) < -radius[j] or _dot(centre[i] - origin[j], nj) < -radius[i]:
                continue
            gap = centre[i] - centre[j]
            size = max(max(radius[i], radius[j]), np.sqrt(_dot(gap, gap)))
            total = 0.0
            for p in range(patch_start[i], patch_start[i + 1]):
                P = corners[loop_start[p]:loop_start[p + 1]]
                for q in range(patch_start[j], patch_start[j + 1]):
                    total += _contours(P, ni, origin[i], corners[loop_start[q]:loop_start[q + 1]], nj, origin[j], size)
            AF[i, j] = AF[j, i] = max(total, 0.0)
    return AF / area.reshape(-1, 1)


def factors(surface, mesh) -> np.ndarray:
    """F (N, N) float64 between all patches, and exact. Raises NotExact, a ValueError of one line, where it would not be."""
    from lib import rays
    standing = np.flatnonzero(rays.occluders(surface.corners, surface.facet))
    if len(standing):
        raise NotExact(f"analytic form factors: {len(standing)} facets can stand between two others (the first is facet {standing[0]} "
                       f"of group '{surface.groups[surface.group[standing[0]]]}'); use rays")
    corners, loop_start, patch_start = outlines(surface, mesh)
    f = mesh.side // 2
    normal = np.ascontiguousarray(surface.normal[f] * (1 - 2 * (mesh.side & 1))[:, None])
    origin = np.ascontiguousarray(surface.origin[f])
    first = loop_start[patch_start[:-1]]
    owner = np.repeat(np.arange(len(mesh)), np.diff(np.append(first, len(corners))))
    radius = np.zeros(len(mesh))
    np.maximum.at(radius, owner, np.linalg.norm(corners - mesh.centre[owner], axis=1))
    F = _all(corners, loop_start, patch_start, normal, origin, mesh.area, mesh.centre, radius)
    most = F.sum(axis=1).max(initial=0.0)
    if most > 1 + 1e-6:
        raise NotExact(f"analytic form factors: a patch sends {most:.6f} of its light, so others overlap in its sight; use rays")
    return F


def rows(surface, mesh, progress=None):
    """The same as form_factors.Rows: as if each patch had two rays, and both halves of them agreed."""
    from lib.form_factors import Rows
    F = factors(surface, mesh)
    at = np.nonzero(F)
    count = F[at].astype(np.float32)
    one = np.ones(len(F), np.float32)
    return Rows(np.concatenate([[0], np.cumsum((F > 0).sum(axis=1))]).astype(np.int64), at[1].astype(np.int32), 2 * count, count,
                2 * one, one, np.full(len(F), 2), 0 * one, len(F))
