"""Compiled: cells clipped by their facet, the table of finest cells, points in a patch."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.light.sampling_kernels import scrambled
from lib.light.surface_kernels import SurfaceArrays


class PatchTable(NamedTuple):
    """Which patch is where: the finest cells of each side; see Mesh."""

    start: np.ndarray  # (2 F,) int64 into leaf; -1: the side has no patches
    shape: np.ndarray  # (2 F, 2) int32
    leaf: np.ndarray  # (...,) int32


class PatchPieces(NamedTuple):
    """The triangles of each patch; see Mesh."""

    side: np.ndarray  # (K,) int32, of each triangle
    start: np.ndarray  # (N + 1,) into uv, cdf
    uv: np.ndarray  # (K, 3, 2)
    cdf: np.ndarray  # (K,)


# ---- cutting ----


ON_LINE = 1e-9  # local; a corner so near to a cell's border lies on it


@njit(inline="always")
def beyond(x, value, greater):
    """How far x lies on the side that is kept; 0 on the border, where rounding is not to cut off a sliver."""
    d = x - value if greater else value - x
    return d if abs(d) > ON_LINE else 0.0


@njit()
def clip(poly, n, axis, value, keep_greater, out):
    """Sutherland-Hodgman against one axis-parallel line; returns the new number of corners."""
    m = 0
    for i in range(n):
        a = poly[i]
        b = poly[(i + 1) % n]
        da = beyond(a[axis], value, keep_greater)
        db = beyond(b[axis], value, keep_greater)
        if da >= 0:
            out[m, 0], out[m, 1] = a[0], a[1]
            m += 1
        if (da > 0 and db < 0) or (da < 0 and db > 0):
            t = da / (da - db)
            out[m, 0] = a[0] + t * (b[0] - a[0])
            out[m, 1] = a[1] + t * (b[1] - a[1])
            out[m, axis] = value
            m += 1
    return m


@njit()
def cut_cells(cells, uv, facet_start, facet_order, keep_below):
    """Clip each cell (facet, u0, v0, u1, v1) by its facet's triangles.

    uv : (T, 3, 2) triangles in facet coordinates;  facet_order : (T,) the triangles facet by facet
    facet_start : (F + 1,) into facet_order;  keep_below : pieces smaller than this share of their cell are left out
    Returns where each cell's pieces begin (n + 1,), pieces (K, 3, 2), their cumulated share of the cell (K,), and
    areas (n,).
    """
    n = len(cells)
    start = np.zeros(n + 1, np.int64)
    area = np.zeros(n)
    capacity = 4 * n + 16
    pieces = np.zeros((capacity, 3, 2))
    weight = np.zeros(capacity)
    k = 0
    p = np.zeros((16, 2))
    q = np.zeros((16, 2))
    for i in range(n):
        f = int(cells[i, 0])
        u0, v0, u1, v1 = cells[i, 1], cells[i, 2], cells[i, 3], cells[i, 4]
        cell_area = (u1 - u0) * (v1 - v0)
        for s in range(facet_start[f], facet_start[f + 1]):
            t = uv[facet_order[s]]
            if (
                max(t[0, 0], t[1, 0], t[2, 0]) <= u0
                or min(t[0, 0], t[1, 0], t[2, 0]) >= u1
                or max(t[0, 1], t[1, 1], t[2, 1]) <= v0
                or min(t[0, 1], t[1, 1], t[2, 1]) >= v1
            ):
                continue
            for c in range(3):
                p[c, 0], p[c, 1] = t[c, 0], t[c, 1]
            m = clip(p, 3, 0, u0, True, q)
            m = clip(q, m, 0, u1, False, p)
            m = clip(p, m, 1, v0, True, q)
            m = clip(q, m, 1, v1, False, p)
            for c in range(1, m - 1):
                a = 0.5 * abs(
                    (p[c, 0] - p[0, 0]) * (p[c + 1, 1] - p[0, 1]) - (p[c + 1, 0] - p[0, 0]) * (p[c, 1] - p[0, 1])
                )
                if a <= keep_below * cell_area:
                    continue
                if k == capacity:
                    capacity *= 2
                    bigger = np.zeros((capacity, 3, 2))
                    bigger[:k] = pieces[:k]
                    pieces = bigger
                    heavier = np.zeros(capacity)
                    heavier[:k] = weight[:k]
                    weight = heavier
                pieces[k, 0], pieces[k, 1], pieces[k, 2] = p[0], p[c], p[c + 1]
                weight[k] = a
                area[i] += a
                k += 1
        start[i + 1] = k
    cdf = np.zeros(k)
    for i in range(n):
        total = 0.0
        for s in range(start[i], start[i + 1]):
            total += weight[s]
            cdf[s] = total / area[i]
        if start[i + 1] > start[i]:
            cdf[start[i + 1] - 1] = 1.0
    return start, pieces[:k].copy(), cdf, area


@njit()
def leaf_table(leaves, finest, shape, start, total):
    """(total,) int32: the leaf on each finest cell of each side, -1 where there is none.

    leaves : (n, 4) side, level, iu, iv;  finest, start : (2 F,) level and place of each side;  shape : (2 F, 2)
    """
    leaf = np.full(total, -1, np.int32)
    for i in range(len(leaves)):
        side, level, iu, iv = leaves[i, 0], leaves[i, 1], leaves[i, 2], leaves[i, 3]
        k = 1 << (finest[side] - level)
        for a in range(iu * k, (iu + 1) * k):
            for b in range(iv * k, (iv + 1) * k):
                leaf[start[side] + a * shape[side, 1] + b] = i
    return leaf


# ---- places ----


@njit(inline="always")
def in_patch(i, u, v, pieces: PatchPieces):
    """A point of patch i, uniform for uniform (u, v): its side, and its coordinates on that side's facet."""
    a, b = pieces.start[i], pieces.start[i + 1]
    s = a
    while s < b - 1 and pieces.cdf[s] <= u:
        s += 1
    low = pieces.cdf[s - 1] if s > a else 0.0
    u = min(max((u - low) / (pieces.cdf[s] - low), 0.0), 1.0)
    r = np.sqrt(u)
    w0, w1, w2 = 1 - r, r * (1 - v), r * v
    t = pieces.uv[s]
    u, v = w0 * t[0, 0] + w1 * t[1, 0] + w2 * t[2, 0], w0 * t[0, 1] + w1 * t[1, 1] + w2 * t[2, 1]
    return pieces.side[s], u, v


@njit(parallel=True)
def patch_points(n, points, shift, pieces: PatchPieces, surface: SurfaceArrays):
    """(N * n, 3) local: n points of each patch.  points : (n, 4), shift : (N, 4) uint32"""
    origin, axes = surface.origin, surface.axes
    N = len(pieces.start) - 1
    out = np.empty((N * n, 3))
    for i in prange(N):
        for k in range(n):
            s, u, v = in_patch(i, scrambled(points[k, 0], shift[i, 0]), scrambled(points[k, 1], shift[i, 1]), pieces)
            f = s >> 1
            for d in range(3):
                out[i * n + k, d] = origin[f, d] + u * axes[f, 0, d] + v * axes[f, 1, d]
    return out


@njit()
def sides_of_points(n, points, shift, pieces: PatchPieces):
    """(N * n,) int32: the side that each of the points of `patch_points` lies on, or from which a ray starts."""
    N = len(pieces.start) - 1
    out = np.empty(N * n, np.int32)
    for i in range(N):
        for k in range(n):
            s, _, _ = in_patch(i, scrambled(points[k, 0], shift[i, 0]), scrambled(points[k, 1], shift[i, 1]), pieces)
            out[i * n + k] = s
    return out


@njit(inline="always")
def patch_under(u, v, s, size, start, shape, leaf):
    """The patch of side s under facet coordinates (u, v), -1 where there is none.

    size : (2,) of the facet's rectangle;  start, shape, leaf : of a PatchTable
    """
    nu, nv = shape[s, 0], shape[s, 1]
    a = min(max(int(u / size[0] * nu), 0), nu - 1)
    b = min(max(int(v / size[1] * nv), 0), nv - 1)
    patch = leaf[start[s] + a * nv + b]
    if patch < 0:  # beyond a slanted border by rounding: the next cell inside
        for da in range(-1, 2):
            for db in range(-1, 2):
                if patch < 0 and 0 <= a + da < nu and 0 <= b + db < nv:
                    patch = leaf[start[s] + (a + da) * nv + b + db]
    return patch
