"""Lids: faces that people do not draw, because the object stands on them or leans against something with them.

A lid closes a loop of edges that only one polygon of the object has. It lies on facets of other objects, all over. An
object that lids close is a solid for the light (lib/light/surface.py). Nothing else knows lids: they are no facets.

    planes     of other objects' facets, each edge of the loop on one of them
    runs       of edges on one plane; a loop of one run is closed by one flat lid
    corners    a loop of several runs is cut down run by run: by the straight edge that a run shares with both its
               neighbours where these are on one plane, else by the corner where the three planes meet
"""

from typing import NamedTuple

import numpy as np

NEAR = 2e-4  # in diagonals of the model: 2 mm in a room of 10 m. A lid lies no farther from the facets that it lies on.
PARALLEL = 1 - 1e-5  # cosine; 0.25 degrees
LONGEST = 2000  # edges: objects that are more open than that are left so
SAMPLES = 300  # points of a lid that are looked at
REST = 0.98  # part of them that must lie on other objects: a box may stand a little over an edge


class Lid(NamedTuple):
    """One flat face that closes an object."""

    object: int
    corners: np.ndarray  # (n, 3, 3) m, world: triangles, counter-clockwise seen from outside


class Lids(NamedTuple):
    """What closes objects."""

    faces: tuple[Lid, ...] = ()
    objects: tuple[int, ...] = ()  # those that faces close, and those whose loops are too thin to need one


class Plane(NamedTuple):
    """A plane of other objects, and their triangles on it."""

    normal: np.ndarray  # (3,)
    offset: float  # m
    triangles: np.ndarray  # (n, 3, 3) m


class Around(NamedTuple):
    """All triangles of a model."""

    model: object
    owner: np.ndarray  # (T,) object
    corners: np.ndarray  # (T, 3, 3) m
    low: np.ndarray  # (3, T) m, of its box, which is a little larger than it is
    high: np.ndarray  # (3, T) m
    first: np.ndarray  # (F,) the first triangle of each facet


class Run(NamedTuple):
    """Successive edges of a loop that lie on one plane."""

    plane: int
    path: np.ndarray  # (n + 1, 3) m


def lids(model) -> Lids:
    """The lids of all objects of a model that they close; none of an object that stays open somewhere."""
    extent = np.ptp(model.vertices[np.unique(model.triangles)], axis=0)
    near = NEAR * float(np.linalg.norm(extent))
    owner = model.facet_object[model.triangle_facet]
    corners = model.corners()
    first = np.zeros(model.n_facets, int)  # facets of absent objects have no triangle
    there, index = np.unique(model.triangle_facet, return_index=True)
    first[there] = index
    low, high = np.ascontiguousarray(corners.min(axis=1).T), np.ascontiguousarray(corners.max(axis=1).T)
    around = Around(model, owner, corners, low - near, high + near, first)
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(len(model.objects) + 1))
    found, closed = [], []
    for thing in np.flatnonzero(~model.closed_objects):
        mine = corners[order[start[thing] : start[thing + 1]]]
        if len(mine) == 0:
            continue
        loops = _loops(mine)
        if loops is None:
            continue
        loops = [p for p in loops if not _is_thin(p, near)]
        planes = _planes(around, thing, np.concatenate(loops), near) if loops else []
        faces = _faces(loops, planes, near)
        if faces is not None and _is_solid(mine, faces, near):
            closed.append(int(thing))
            found += [Lid(int(thing), face) for face in faces]
    return Lids(tuple(found), tuple(closed))


def _loops(corners):
    """[(n, 3)] the loops that lids of triangles (T, 3, 3) run along, or None where their sides do not agree."""
    vertices, position = np.unique(corners.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    a = position.reshape(-1, 3)
    b = np.roll(a, -1, axis=1)
    ends = np.stack([a.ravel(), b.ravel()], axis=1)
    edges, which = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    net = np.bincount(which.reshape(-1), np.where(ends[:, 0] < ends[:, 1], 1, -1), len(edges)).astype(int)
    if np.abs(net).max() > 1 or np.count_nonzero(net) > LONGEST:
        return None
    rim = edges[net != 0]
    turn = net[net != 0] > 0  # a lid has the edge the other way round
    rim = np.where(turn[:, None], rim[:, ::-1], rim)
    after = {}
    for start, end in rim.tolist():
        after.setdefault(start, []).append(end)
    loops = []
    for start in after:
        while after[start]:
            ring = [start]
            while (at := after[ring[-1]].pop()) != start:  # as many edges end at a corner as begin there
                ring.append(at)
            loops.append(vertices[ring])
    return loops


def _is_thin(p, near):
    """Is the loop p (n, 3) no wider than `near`? Of two polygons of one object at a T-junction it is."""
    centred = p - p.mean(axis=0)
    along = np.linalg.svd(centred, full_matrices=False)[2][0]
    return np.linalg.norm(centred - np.outer(centred @ along, along), axis=1).max() <= near


def _planes(around, thing, p, near):
    """[Plane] of other objects than `thing` on which edges of its loops can lie; p : (n, 3) their corners"""
    model, corners = around.model, around.corners
    beside = around.owner != thing
    for k in range(3):
        beside &= (around.low[k] <= p[:, k].max()) & (around.high[k] >= p[:, k].min())
    planes, facets = [], np.unique(model.triangle_facet[beside])
    meets = np.abs(model.facet_normal[facets] @ p.T - model.facet_offset[facets, None]) <= near
    for facet in facets[meets.sum(axis=1) > 1]:
        normal, offset = model.facet_normal[facet], model.facet_offset[facet]
        if any(_is_same(plane, normal, corners[around.first[facet]], near) for plane in planes):
            continue
        height = np.abs(corners[beside] @ normal - offset).max(axis=1)
        parallel = np.abs(model.facet_normal[model.triangle_facet[beside]] @ normal) >= PARALLEL
        planes.append(Plane(normal, offset, corners[beside][parallel | (height <= near)]))
    return planes


def _is_same(plane, normal, triangle, near):
    return abs(plane.normal @ normal) >= PARALLEL and np.abs(triangle @ plane.normal - plane.offset).max() <= near


def covered(triangles, p, near):
    """(n,) bool: points p (n, 3) that lie on one of the triangles (T, 3, 3), or not farther from it than `near`."""
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    t = triangles[((low <= p.max(axis=0) + near) & (high >= p.min(axis=0) - near)).all(axis=1)]
    side = np.roll(t, -1, axis=1) - t
    n = np.cross(side[:, 0], side[:, 1])
    inward = np.cross(n[:, None], side)
    normals = np.concatenate([n[:, None], -n[:, None], inward], axis=1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    result = np.zeros(len(p), bool)
    for corners, normal in zip(t[:, [0, 0, 0, 1, 2]], normals, strict=True):
        result |= (np.einsum("nij,ij->ni", p[:, None] - corners, normal) >= -near).all(axis=1)
    return result


def _faces(loops, planes, near):
    """[(n, 3, 3)] triangles of the lids that close all loops, or None."""
    whole, triangles = {}, []
    if loops and not planes:
        return None
    for p in loops:
        runs = _runs(p, planes, near)
        lids = None if runs is None else _cut_down(runs, planes, near)
        if lids is None:
            return None
        *parts, last = lids
        triangles += [(plane, _triangles([ring])) for plane, ring in parts]
        whole.setdefault(last[0], []).append(last[1])
    for plane, rings in whole.items():
        triangles += [(plane, _triangles(nested)) for nested in _nested(rings, planes[plane])]
    if not all(_lies_on(planes[plane], t, near) for plane, t in triangles):
        return None
    return [t for _, t in triangles]


def _nested(rings, plane):
    """[[outline, hole, ...]] of rings (n, 3) in a plane: a hole turns the other way and lies in its outline."""
    area = np.array([_area_vector(ring) @ plane.normal for ring in rings])
    nests = {}
    for k in np.argsort(-np.abs(area)):
        around = [j for j in nests if area[j] * area[k] < 0 and _winding(plane, rings[j], rings[k][:1])[0]]
        if around:
            nests[around[-1]].append(rings[k])  # the smallest
        else:
            nests[k] = [rings[k]]
    return list(nests.values())


def _runs(p, planes, near):
    """[Run] of a loop p (n, 3), as few as there can be; None where an edge lies on no plane."""
    n = len(p)
    end = np.roll(p, -1, axis=0)
    on = np.zeros((n, len(planes)), bool)
    for k, plane in enumerate(planes):
        height = np.abs(p @ plane.normal - plane.offset) <= near
        on[:, k] = height & np.roll(height, -1)
        if not on[:, k].all():  # of several planes each edge takes one that is really there
            on[:, k] &= covered(plane.triangles, (p + end) / 2, near)
    if not on.any(axis=1).all():
        return None
    if on.all(axis=0).any():
        return [Run(int(on.all(axis=0).argmax()), np.concatenate([p, p[:1]]))]
    parts = min((_parted(on, start) for start in range(n)), key=len)
    return [Run(plane, np.concatenate([p, p])[first : last + 1]) for first, last, plane in parts]


def _parted(on, start):
    """[(first edge, the one after the last, plane)] from the edge `start` once round, each as long as it can be."""
    n = len(on)
    parts, first = [], start
    while first < start + n:
        common, last = on[first % n], first + 1
        while last < start + n and (common & on[last % n]).any():
            common = common & on[last % n]
            last += 1
        parts.append((first, last, int(common.argmax())))
        first = last
    return parts


def _cut_down(runs, planes, near):
    """[(plane, ring (n, 3))] of the lids that close a loop of runs, or None."""
    rings = []
    while len(runs) > 1:
        for k in range(len(runs)):
            before, run, behind = runs[k - 1], runs[k], runs[(k + 1) % len(runs)]
            corner = _corner([planes[r.plane] for r in (before, run, behind)], before.plane == behind.plane)
            if corner is None:
                continue
            ring = np.concatenate([run.path, corner])
            if _lies_on(planes[run.plane], _triangles([ring]), near):
                rings.append((run.plane, ring))
                runs = _without(runs, k, corner)
                break
        else:
            return None
    return [*rings, (runs[0].plane, runs[0].path[:-1])]


def _corner(planes, straight):
    """(0 or 1, 3) m: where three planes meet; nothing where the run is cut off by a straight edge; None: no such."""
    if straight:
        return np.zeros((0, 3))
    normals = np.array([plane.normal for plane in planes])
    if abs(np.linalg.det(normals)) < 0.05:
        return None
    return np.linalg.solve(normals, [plane.offset for plane in planes])[None]


def _without(runs, k, corner):
    """The runs without run k: its neighbours go to the corner, or become one along the straight edge."""
    runs = runs[k:] + runs[:k]
    before, behind = runs[-1], runs[1]
    if len(corner):
        before, behind = (
            Run(before.plane, np.concatenate([before.path, corner])),
            Run(behind.plane, np.concatenate([corner, behind.path])),
        )
        return [behind, *runs[2:-1], before]
    if len(runs) == 2:
        return [Run(before.plane, np.concatenate([before.path, before.path[:1]]))]
    return [*runs[2:-1], Run(before.plane, np.concatenate([before.path, behind.path]))]


def _lies_on(plane, t, near):
    """Do triangles of the plane cover all but a little of the triangles t (n, 3, 3)?"""
    area = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    if not area.sum() > near**2:
        return False
    return bool(covered(plane.triangles, spread(t, SAMPLES), near).mean() >= REST)


def _area_vector(ring):
    """(3,) m2 of a ring (n, 3)."""
    v = ring - ring[0]
    return np.cross(v[:-1], v[1:]).sum(axis=0) / 2


def _triangles(rings):
    """(n, 3, 3) of a flat outline (n, 3) with holes, turned as the outline is."""
    import mapbox_earcut

    normal = _area_vector(rings[0])
    if not np.linalg.norm(normal) > 0:
        return np.zeros((0, 3, 3))
    p = np.concatenate(rings)
    flat = (p - p[0]) @ _axes(normal / np.linalg.norm(normal))
    t = mapbox_earcut.triangulate_float64(flat, np.cumsum([len(ring) for ring in rings]).astype(np.uint32))
    t = p[t.reshape(-1, 3).astype(int)]
    v = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    t = np.where((v @ normal < 0)[:, None, None], t[:, ::-1], t)
    return t[np.linalg.norm(v, axis=1) > 0]


def _axes(normal):
    """(3, 2) two directions in the plane with the unit normal, so that (x, y, normal) is right-handed."""
    x = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(normal, x)], axis=1)


def spread(triangles, count):
    """(n, 3) about `count` points, evenly over triangles (T, 3, 3): the additive sequence of the plastic number."""
    v = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(v, axis=1)
    counts = np.ceil(count * area / area.sum()).astype(int)
    a, b, c = np.moveaxis(np.repeat(triangles, counts, axis=0), 1, 0)
    number = np.arange(len(a)) - np.repeat(np.cumsum(counts) - counts, counts)
    u, v = (0.5 + np.outer([0.7548776662466927, 0.5698402909980532], number)) % 1
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    return a + u[:, None] * (b - a) + v[:, None] * (c - a)


def _winding(plane, ring, points):
    """(n,) how often the ring goes round each point, seen along the plane's normal."""
    flat = _axes(plane.normal)
    a, q = (ring - ring[0]) @ flat, (points - ring[0]) @ flat
    b = np.roll(a, -1, axis=0)
    up = (a[:, 1] <= q[:, None, 1]) & (b[:, 1] > q[:, None, 1])
    down = (a[:, 1] > q[:, None, 1]) & (b[:, 1] <= q[:, None, 1])
    d, e = b - a, q[:, None] - a
    left = d[:, 0] * e[..., 1] - d[:, 1] * e[..., 0]
    return (up & (left > 0)).sum(axis=1) - (down & (left < 0)).sum(axis=1)


def _is_solid(corners, faces, near):
    """Is the volume positive, and higher than `near` above the lids?"""
    lids = np.concatenate([np.zeros((0, 3, 3)), *faces])
    t = np.concatenate([corners, lids]) - corners[0, 0]
    volume = np.einsum("ij,ij->", t[:, 0], np.cross(t[:, 1], t[:, 2])) / 6
    area = np.linalg.norm(np.cross(lids[:, 1] - lids[:, 0], lids[:, 2] - lids[:, 0]), axis=1).sum() / 2
    return bool(volume > near * area)
