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

from lib.core.rows import distinct
from lib.given.model.lying import Around, Beside, Loop, Planes, spread

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


class Run(NamedTuple):
    """Successive edges of a loop that lie on one plane."""

    plane: int
    path: np.ndarray  # (n + 1, 3) m


def lids(model) -> Lids:
    """The lids of all objects of a model that they close; none of an object that stays open somewhere."""
    open_objects = np.flatnonzero(~model.closed_objects)
    if len(open_objects) == 0:
        return Lids()
    around = Around.of(model)
    order = np.argsort(around.owner, kind="stable")
    start = np.searchsorted(around.owner[order], np.arange(len(model.objects) + 1))
    found, closed = [], []
    for thing in open_objects:
        mine = around.corners[order[start[thing] : start[thing + 1]]]
        loops = _loops(mine) if len(mine) else None
        if loops is None:
            continue
        faces = _faces([p for p in loops if not _is_thin(p, around.near)], around, thing)
        if faces is not None and _is_solid(mine, faces, around.near):
            closed.append(int(thing))
            found += [Lid(int(thing), face) for face in faces]
    return Lids(tuple(found), tuple(closed))


def _loops(corners):
    """[(n, 3)] the loops that lids of triangles (T, 3, 3) run along, or None where their sides do not agree."""
    p = corners.reshape(-1, 3) + 0.0
    first, position = distinct(p)
    vertices, a = p[first], position.reshape(-1, 3)
    ends = np.stack([a.ravel(), np.roll(a, -1, axis=1).ravel()], axis=1)
    undirected = np.sort(ends, axis=1)
    first, which = distinct(undirected)
    edges = undirected[first]
    net = np.bincount(which, np.where(ends[:, 0] < ends[:, 1], 1, -1), len(edges)).astype(int)
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


def _faces(loops, around, thing):
    """[(n, 3, 3)] triangles of the lids that close all loops of an object, or None."""
    if not loops:
        return []
    beside = Beside(around, thing, loops)
    planes = beside.planes()
    if planes is None:
        return None
    whole, triangles = {}, []
    for loop in beside.loops:
        runs = _runs(loop, planes, beside)
        lids = None if runs is None else _cut_down(runs, planes, beside)
        if lids is None:
            return None
        *parts, last = lids
        triangles += [(plane, _triangles([ring])) for plane, ring in parts]
        whole.setdefault(last[0], []).append(last[1])
    for plane, rings in whole.items():
        triangles += [(plane, _triangles(nested)) for nested in _nested(rings, planes.normals[plane])]
    if not all(_lies_on(planes, plane, t, beside) for plane, t in triangles):
        return None
    return [t for _, t in triangles]


def _nested(rings, normal):
    """[[outline, hole, ...]] of rings (n, 3) in a plane: a hole turns the other way and lies in its outline."""
    area = np.array([_area_vector(ring) @ normal for ring in rings])
    nests = {}
    for k in np.argsort(-np.abs(area)):
        around = [j for j in nests if area[j] * area[k] < 0 and _winding(normal, rings[j], rings[k][:1])[0]]
        if around:
            nests[around[-1]].append(rings[k])  # the smallest
        else:
            nests[k] = [rings[k]]
    return list(nests.values())


def _runs(loop: Loop, planes: Planes, beside):
    """[Run] of a loop, as few as there can be; None where an edge lies on no plane."""
    p = loop.corners
    on = np.abs(planes.heights(p)) <= beside.near
    on &= np.roll(on, -1, axis=0)
    doubtful = ~on.all(axis=0)
    for edge, row in enumerate(on):  # of several planes each edge takes one that is really there
        some = np.flatnonzero(row & doubtful)
        row[some] = beside.some_lie_in(loop.under(edge), planes.normals[some], planes.offsets[some])
    if not on.any(axis=1).all():
        return None
    if on.all(axis=0).any():
        return [Run(int(on.all(axis=0).argmax()), np.concatenate([p, p[:1]]))]
    return [Run(plane, np.concatenate([p, p])[first : last + 1]) for first, last, plane in _parted(on)]


def _parted(on):
    """[(first edge, the one after the last, plane)] once round a loop, as few as there can be, from the first edge at
    which so few can begin, each as long as it can be.  on : (n, P) bool, no plane holds all edges
    """
    n = len(on)
    ends, count, end = np.zeros(n, int), np.zeros(on.shape[1], int), 0  # how many of the edges start..end are on each
    for start in range(n):
        while (more := count + on[end % n]).max() == end + 1 - start:
            count, end = more, end + 1
        ends[start] = end
        count = count - on[start]
    at, parts = np.arange(n), np.zeros(n, int)
    while (going := at < np.arange(n) + n).any():
        at = np.where(going, ends[at % n] + at - at % n, at)
        parts += going
    first, behind, found = int(parts.argmin()), int(parts.argmin()) + n, []
    while first < behind:
        last = min(int(ends[first % n]) + first - first % n, behind)
        found.append((first, last, int(on[np.arange(first, last) % n].all(axis=0).argmax())))
        first = last
    return found


def _cut_down(runs, planes, beside):
    """[(plane, ring (n, 3))] of the lids that close a loop of runs, or None."""
    rings = []
    while len(runs) > 1:
        for k in range(len(runs)):
            before, run, behind = runs[k - 1], runs[k], runs[(k + 1) % len(runs)]
            corner = _corner(planes, [r.plane for r in (before, run, behind)])
            if corner is None:
                continue
            ring = np.concatenate([run.path, corner])
            if _lies_on(planes, run.plane, _triangles([ring]), beside):
                rings.append((run.plane, ring))
                runs = _without(runs, k, corner)
                break
        else:
            return None
    return [*rings, (runs[0].plane, runs[0].path[:-1])]


def _corner(planes, three):
    """(0 or 1, 3) m: where three planes meet; nothing where the run is cut off by a straight edge; None: no such."""
    if three[0] == three[2]:
        return np.zeros((0, 3))
    normals = planes.normals[three]
    if abs(np.linalg.det(normals)) < 0.05:
        return None
    return np.linalg.solve(normals, planes.offsets[three])[None]


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


def _lies_on(planes, plane, t, beside):
    """Do triangles of the plane cover all but a little of the triangles t (n, 3, 3)?"""
    area = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    if not area.sum() > beside.near**2:
        return False
    return bool(beside.on(planes.normals[plane], planes.offsets[plane], spread(t, SAMPLES)).mean() >= REST)


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


def _winding(normal, ring, points):
    """(n,) how often the ring goes round each point, seen along a normal."""
    flat = _axes(normal)
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
