"""Triangles from planar polygons."""

import numpy as np

from lib.given import extent

TIE = 1e-6  # of a quadrilateral's area: diagonals whose halves differ by less are equally good


def ears(vertices, ring, area_vector) -> tuple[np.ndarray, bool]:
    """Ear clipping of one polygon: (n, 3) vertex indices, and whether it crosses itself."""
    import mapbox_earcut

    n = area_vector / np.linalg.norm(area_vector)
    u = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    u /= np.linalg.norm(u)
    p = vertices[ring] - vertices[ring[0]]
    flat = np.column_stack([p @ u, p @ np.cross(n, u)])
    t = mapbox_earcut.triangulate_float64(flat, np.array([len(ring)], np.uint32)).reshape(-1, 3).astype(np.int64)
    a, b, c = flat[t[:, 0]], flat[t[:, 1]], flat[t[:, 2]]
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    t[area < 0] = t[area < 0][:, ::-1]
    whole = np.linalg.norm(area_vector)
    return ring[t], bool(abs(np.abs(area).sum() - whole) > 1e-6 * whole)


def triangulated(vertices, pieces) -> tuple[np.ndarray, np.ndarray, int]:
    """(triangles (T, 3), the piece of each (T,), how many pieces cross themselves), in the order of the pieces."""
    corners, starts, size = pieces.corners, pieces.starts, pieces.size
    three, four = np.flatnonzero(size == 3), np.flatnonzero(size == 4)
    quads = corners[starts[four][:, None] + np.arange(4)]
    p = vertices[corners] if len(three) < len(size) else np.zeros((1, 3))  # triangles ask for no middle
    whole = extent.middle(p), float(np.ptp(p, axis=0).max())
    halves, of_half, hollow = _halves(vertices, quads, pieces.area_vector[four], whole)
    triangles, of_piece = [corners[np.repeat(size == 3, size)].reshape(-1, 3), halves], [three, four[of_half]]
    crossed = 0
    for i in np.concatenate([four[hollow], np.flatnonzero(size > 4)]):
        ring = corners[starts[i] : starts[i + 1]]
        ring = np.roll(ring, -extent.farthest(vertices[ring][None], *whole)[0])  # begun where no file begins it
        t, crosses = ears(vertices, ring, pieces.area_vector[i])
        crossed += crosses
        triangles.append(t)
        of_piece.append(np.full(len(t), i))
    triangles, of_piece = np.concatenate(triangles), np.concatenate(of_piece)
    order = np.argsort(of_piece, kind="stable")
    return triangles[order], of_piece[order], crossed


CUTS = np.array([[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]])  # of four corners, along either diagonal


def _halves(vertices, q, area_vector, model):
    """Quadrilaterals q (Q, 4) along the better diagonal: (triangles, the quadrilateral of each, those left over).

    Left over are those of which either diagonal leaves the polygon.  model : its middle and size
    """
    least = np.stack(
        [np.stack([_signed_area(vertices, q[:, t], area_vector) for t in cut]).min(axis=0) for cut in CUTS]
    )
    whole = np.linalg.norm(area_vector, axis=1)
    alike = np.abs(least[1] - least[0]) <= TIE * whole
    best = np.where(alike, extent.farthest(vertices[q], *model) % 2, least.argmax(axis=0))
    good = least.max(axis=0) > -1e-12 * whole
    halves = q[np.arange(len(q))[:, None, None], CUTS[best]][good].reshape(-1, 3)
    return halves, np.repeat(np.flatnonzero(good), 2), ~good


def _signed_area(vertices, triangles, direction):
    """(N,) m2: areas of triangles (N, 3), negative where they turn away from direction (N, 3)."""
    p = vertices[triangles]
    v = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return np.einsum("ij,ij->i", v, direction) / (2 * np.linalg.norm(direction, axis=1))
