"""Patches: every lit side of every facet, cut by a quadtree in the facet's own plane (section 3.3).

A facet has two *sides*, side = 2 * facet + (0 front, 1 back), each with its own radiosity. A side is meshed
only if light can reach it: not the inside of a solid, and not a side from which nothing at all is seen. The
patches of a side are the leaves of a quadtree over the facet's bounding rectangle, clipped by the facet, so
areas are exact for any polygon and a hit is located by one look into the side's table of finest cells.

Subdivision is finer where patch-constant light would be wrong: a cell is split where its quadrants are unevenly
lit (shadow edges, contacts, gaps), measured with the rays of a first coarse balance, and stays coarse where the
light is smooth.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from lib import rays as ray_tools
from lib.rays import OFFSET, Caster, Local


@dataclass(frozen=True)
class Surface:
    """The model in local coordinates, ready for rays."""
    local: Local
    corners: np.ndarray          # (T, 3, 3) float64 local
    facet: np.ndarray            # (T,) int32 facet of each triangle
    normal: np.ndarray           # (F, 3)
    group: np.ndarray            # (F,) int32
    object: np.ndarray           # (F,) int32
    origin: np.ndarray           # (F, 3) a corner of the bounding rectangle
    axes: np.ndarray             # (F, 2, 3) unit, in the plane; axes[0] x axes[1] = normal
    size: np.ndarray             # (F, 2) of the bounding rectangle
    inside: np.ndarray           # (2 F,) bool: the side looks into a solid
    groups: tuple
    caster: Caster
    shadows: Caster              # facets that can occlude, lamps among them
    n_occluders: int             # facets that can; a lamp of one facet does not stand in its own light
    cast: np.ndarray             # (T, 3, 3) float64 local: corners as they are cast, solids a hair thinner
    overlap: np.ndarray          # (F,) int8: of a solid that may reach into another: 1 where its inside is at the back, -1 at the front; else 0


@dataclass(frozen=True)
class Mesh:
    """Patches; areas and lengths are local (see rays.Local)."""
    side: np.ndarray             # (N,) int32
    area: np.ndarray             # (N,) local
    centre: np.ndarray           # (N, 3) local
    tri_start: np.ndarray        # (N + 1,) int32 into tri_uv, tri_cdf
    tri_uv: np.ndarray           # (K, 3, 2) float64, pieces of the patches in facet coordinates
    tri_cdf: np.ndarray          # (K,) cumulated share of the patch's area
    table_start: np.ndarray      # (2 F,) int64 into leaf; -1: the side has no patches
    table_shape: np.ndarray      # (2 F, 2) int32 finest cells along the two axes
    leaf: np.ndarray             # (...,) int32 patch of each finest cell, -1 outside the facet
    parent: np.ndarray           # (N,) int32, numbers the cells one level up: what a coarser mesh would not tell apart

    def __len__(self):
        return len(self.side)


def surface(model, lamps=()) -> Surface:
    """Facet frames, solids and ray casters. lamps: names of the groups that emit."""
    local = Local.of(model)
    corners = local.points(model.vertices)[model.triangles]
    facet = np.array(model.triangle_facet, np.int32)          # copies: kernels would be compiled again for read-only arrays
    normal = np.array(model.facet_normal, float)
    can = ray_tools.occluders(corners, facet)
    lamp_facet = np.isin(model.facet_group, [model.groups.index(g) for g in lamps if g in model.groups])
    inside = _inside(model, local, corners, facet, normal, lamp_facet)
    overlap = _overlap(corners, facet, model.facet_object, inside)
    corners, covered = _lift(corners, facet, normal, inside, lamp_facet)
    inside |= covered
    order = np.argsort(facet, kind="stable").astype(np.int64)
    start = np.searchsorted(facet[order], np.arange(len(normal) + 1)).astype(np.int64)
    origin, axes, size = _frames(corners, order, start, normal)
    # Solids are cast a hair thinner than they are: a ray inside a cabinet then meets the cabinet, not the wall that its back touches.
    thinner = 0.3 * OFFSET * (inside[0::2].astype(float) - inside[1::2])[:, None] * normal
    cast = corners + thinner[facet][:, None, :]
    return Surface(local, corners, facet, normal, np.asarray(model.facet_group, np.int32), np.asarray(model.facet_object, np.int32),
                   origin, axes, size, inside, tuple(model.groups), Caster(cast), Caster(cast[can[facet]]),
                   int(can[~lamp_facet].sum()) + (int(can[lamp_facet].sum()) if lamp_facet.sum() > 1 else 0), cast, overlap)


@njit(cache=True)
def _frames(corners, order, start, normal):
    """For each facet the smallest of the bounding rectangles along its triangles' edges."""
    F = len(normal)
    origin = np.zeros((F, 3))
    axes = np.zeros((F, 2, 3))
    size = np.zeros((F, 2))
    for f in range(F):
        best = np.inf
        n = normal[f]
        tried = 0
        for s in range(start[f], start[f + 1]):
            for e in range(3):
                if tried > 60:
                    continue
                tried += 1
                a = corners[order[s], e]
                d = corners[order[s], (e + 1) % 3] - a
                d = d - n * np.dot(d, n)
                length = np.sqrt(np.dot(d, d))
                if length <= 0:
                    continue
                x = d / length
                y = np.cross(n, x)
                u0, u1, v0, v1 = np.inf, -np.inf, np.inf, -np.inf
                for r in range(start[f], start[f + 1]):
                    for c in range(3):
                        p = corners[order[r], c]
                        u = np.dot(p, x)
                        v = np.dot(p, y)
                        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
                area = (u1 - u0) * (v1 - v0)
                if area < best * (1 - 1e-9):
                    best = area
                    axes[f, 0] = x
                    axes[f, 1] = y
                    size[f, 0] = u1 - u0
                    size[f, 1] = v1 - v0
                    h = np.dot(corners[order[start[f]], 0], n)
                    origin[f] = u0 * x + v0 * y + h * n
    return origin, axes, size


def _inside(model, local, corners, facet, normal, lamp_facet):
    """(2 F,) bool: sides that look into a solid, an object that closes and holds no lamp inside (SCENE.md 3)."""
    inside = np.zeros(2 * len(normal), bool)
    first = np.unique(facet, return_index=True)[1]
    middle = corners[first].mean(axis=1)
    direction = np.array([0.5377, 0.6339, 0.5560])       # no axis, no diagonal
    for obj in np.flatnonzero(model.solid_objects()):
        mine = np.flatnonzero(model.facet_object == obj)
        one = Caster(corners[np.isin(facet, mine)])

        def odd(points):
            r = np.hstack([points, np.broadcast_to(direction, points.shape)])
            return one.crossings(r) % 2 == 1

        lit = np.flatnonzero(lamp_facet)
        if len(lit) and odd(middle[lit] + 4 * OFFSET * normal[lit]).any():
            continue                                       # a room: the lamp shines inside it
        for back in (0, 1):
            inside[2 * mine + back] = odd(middle[mine] + (1 - 2 * back) * 4 * OFFSET * normal[mine])
    return inside


def _overlap(corners, facet, objects, inside):
    """Facets of solids whose bounding box reaches into that of another solid, see Surface.overlap. Inside one of them a ray
    may first meet the outside of the other; whether it started in a solid is then counted along the whole ray."""
    turn = inside[1::2].astype(np.int8) - inside[0::2]
    solids = np.unique(np.asarray(objects)[turn != 0])
    owner = np.asarray(objects)[facet]
    boxes = np.array([[c.min(axis=(0, 1)), c.max(axis=(0, 1))] for c in (corners[owner == o] for o in solids)]).reshape(-1, 2, 3)
    reach = np.minimum(boxes[:, None, 1], boxes[None, :, 1]) - np.maximum(boxes[:, None, 0], boxes[None, :, 0])      # (S, S, 3)
    meets = (reach > 4 * OFFSET).all(axis=2)
    np.fill_diagonal(meets, False)
    return np.where(np.isin(objects, solids[meets.any(axis=1)]), turn, 0).astype(np.int8)


def _lift(corners, facet, normal, inside, last):
    """Facets that lie on each other, a board drawn exactly on a wall or two sheets back to back, moved apart by two
    ray offsets each: corners (T, 3, 3), and which sides are then wholly covered, (2 F,) bool.

    The order is that of the index buffer: what turns its front to us wins, then the later one in the file (lamps
    last of all). Rays that start on what is covered meet the covered side above them and are dropped, as in a solid.
    The side of a solid that touches a wall stays: solids are cast thinner.
    """
    F = len(normal)
    covered = np.zeros(2 * F, bool)
    first = np.unique(facet, return_index=True)[1]
    offset = np.einsum("ij,ij->i", corners[first, 0], normal)
    turn = np.where(normal[np.arange(F), np.abs(normal).argmax(axis=1)] < 0, -1.0, 1.0)
    low, high = np.full((F, 3), np.inf), np.full((F, 3), -np.inf)
    np.minimum.at(low, facet, corners.min(axis=1))
    np.maximum.at(high, facet, corners.max(axis=1))
    axis = int(np.argmax(low.std(axis=0) / np.maximum((high - low).mean(axis=0), OFFSET)))      # where boxes overlap least
    pairs = _coplanar_pairs(np.argsort(low[:, axis], kind="stable"), axis, low, high, np.column_stack([normal, offset]) * turn[:, None])
    if len(pairs) == 0:
        return corners, covered
    rank = np.lexsort((np.arange(F), last)).argsort()
    solid = inside[0::2] | inside[1::2]
    area = np.bincount(facet, 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1), F)
    order = np.argsort(facet, kind="stable")
    start = np.searchsorted(facet[order], np.arange(F + 1))
    level = np.zeros(F, int)
    hidden = np.zeros(2 * F)
    swap = rank[pairs[:, 0]] > rank[pairs[:, 1]]
    pairs[swap] = pairs[swap][:, ::-1]
    pairs = pairs[np.argsort(rank[pairs[:, 1]], kind="stable")]
    alike = np.einsum("ij,ij->i", normal[pairs[:, 0]], normal[pairs[:, 1]]) > 0
    common = np.array([_common_area(corners[order[start[i]:start[i + 1]]], corners[order[start[j]:start[j + 1]]], normal[i]) for i, j in pairs])
    meet = common > 1e-6 * area[pairs].min(axis=1)
    touching = np.zeros(F, bool)
    touching[pairs[meet & ~alike].ravel()] = True
    for (i, j), alike, common in zip(pairs[meet], alike[meet], common[meet]):
        if alike and not (solid[j] and touching[j]):
            level[j] = max(level[j], level[i] + 1)
            hidden[2 * j + 1] += common / area[j]
        elif not alike and not solid[i] and not solid[j]:
            level[[i, j]] = np.maximum(level[[i, j]], 1)
            hidden[2 * i + 1] += common / area[i]
            hidden[2 * j + 1] += common / area[j]
    covered = hidden > 0.99
    return corners + (2 * OFFSET * level[:, None] * normal)[facet][:, None, :], covered


@njit(cache=True)
def _coplanar_pairs(order, axis, low, high, plane):
    """(K, 2): facets in one plane whose bounding boxes overlap, by a sweep along one axis. order : facets by low[:, axis]"""
    found = []
    for a in range(len(order)):
        i = order[a]
        for b in range(a + 1, len(order)):
            j = order[b]
            if low[j, axis] > high[i, axis] + OFFSET:
                break
            apart = 0.0
            for d in range(4):
                apart += (plane[i, d] - plane[j, d]) ** 2
            if apart > OFFSET * OFFSET:
                continue
            thick, long = 0, True
            for d in range(3):
                reach = min(high[i, d], high[j, d]) - max(low[i, d], low[j, d])
                long &= reach > -OFFSET
                thick += reach > OFFSET
            if long and thick >= 2:                       # more than a common edge
                found.append((min(i, j), max(i, j)))
    pairs = np.empty((len(found), 2), np.int64)
    for k in range(len(found)):
        pairs[k, 0], pairs[k, 1] = found[k]
    return pairs


@njit(cache=True)
def _common_area(P, Q, n):
    """Area of the overlap of two sets of triangles in one plane with the normal n."""
    total = 0.0
    a = np.zeros((12, 3))
    b = np.zeros((12, 3))
    for p in P:
        for q in Q:
            m = 3
            a[:3] = q
            turn = 1.0 if np.dot(np.cross(p[1] - p[0], p[2] - p[0]), n) > 0 else -1.0
            for e in range(3):
                inward = turn * np.cross(n, p[(e + 1) % 3] - p[e])
                k = 0
                for i in range(m):
                    u, v = a[i], a[(i + 1) % m]
                    du, dv = np.dot(u - p[e], inward), np.dot(v - p[e], inward)
                    if du >= 0:
                        b[k] = u
                        k += 1
                    if (du > 0 and dv < 0) or (du < 0 and dv > 0):
                        b[k] = u + (v - u) * (du / (du - dv))
                        k += 1
                a[:k] = b[:k]
                m = k
                if m == 0:
                    break
            vector = np.zeros(3)
            for i in range(1, m - 1):
                vector += np.cross(a[i] - a[0], a[i + 1] - a[0])
            total += 0.5 * abs(np.dot(vector, n))
    return total


# -- cutting

@njit(cache=True)
def _clip(poly, n, axis, value, keep_greater, out):
    """Sutherland-Hodgman against one axis-parallel line; returns the new number of corners."""
    m = 0
    for i in range(n):
        a = poly[i]
        b = poly[(i + 1) % n]
        da = a[axis] - value if keep_greater else value - a[axis]
        db = b[axis] - value if keep_greater else value - b[axis]
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


@njit(cache=True)
def _cut(cells, uv, facet_start, facet_order, keep_below):
    """Clip each cell (facet, u0, v0, u1, v1) by its facet's triangles -> pieces as triangles, per-cell area."""
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
            if max(t[0, 0], t[1, 0], t[2, 0]) <= u0 or min(t[0, 0], t[1, 0], t[2, 0]) >= u1 \
                    or max(t[0, 1], t[1, 1], t[2, 1]) <= v0 or min(t[0, 1], t[1, 1], t[2, 1]) >= v1:
                continue
            for c in range(3):
                p[c, 0], p[c, 1] = t[c, 0], t[c, 1]
            m = _clip(p, 3, 0, u0, True, q)
            m = _clip(q, m, 0, u1, False, p)
            m = _clip(p, m, 1, v0, True, q)
            m = _clip(q, m, 1, v1, False, p)
            for c in range(1, m - 1):
                a = 0.5 * abs((p[c, 0] - p[0, 0]) * (p[c + 1, 1] - p[0, 1]) - (p[c + 1, 0] - p[0, 0]) * (p[c, 1] - p[0, 1]))
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


class _Tree:
    """Leaves under construction: side, level, integer cell position at that level, and the root grid per side."""

    def __init__(self, surface: Surface, sides, coarse):
        self.surface = surface
        corners, facet = surface.corners, surface.facet
        relative = corners - surface.origin[facet][:, None, :]
        self.uv = np.stack([np.einsum("tij,tj->ti", relative, surface.axes[facet, a]) for a in (0, 1)], axis=-1)
        self.order = np.argsort(facet, kind="stable").astype(np.int64)
        self.start = np.searchsorted(facet[self.order], np.arange(len(surface.normal) + 1)).astype(np.int64)
        root = np.maximum(1, np.ceil(surface.size / coarse - 1e-9)).astype(np.int64)          # (F, 2)
        self.root = np.repeat(root, 2, axis=0)                                             # per side
        side = np.repeat(sides, self.root[sides].prod(axis=1))
        index = np.concatenate([np.arange(n) for n in self.root[sides].prod(axis=1)]) if len(sides) else np.zeros(0, int)
        nv = self.root[side, 1]
        self.leaves = np.stack([side, np.zeros_like(side), index // nv, index % nv], axis=1)  # side, level, iu, iv
        self._prune()

    def cells(self, leaves=None):
        """(n, 5) facet, u0, v0, u1, v1."""
        leaves = self.leaves if leaves is None else leaves
        side, level, iu, iv = leaves.T
        count = self.root[side] * (1 << level)[:, None]
        step = self.surface.size[side // 2] / count
        return np.stack([side // 2, iu * step[:, 0], iv * step[:, 1], (iu + 1) * step[:, 0], (iv + 1) * step[:, 1]], axis=1)

    def cut(self, leaves=None):
        return _cut(self.cells(leaves), self.uv, self.start, self.order, 1e-9)

    def _prune(self):
        start = self.cut()[0]
        self.leaves = self.leaves[np.diff(start) > 0]

    def split(self, flags):
        parent = self.leaves[flags]
        children = []
        for du in (0, 1):
            for dv in (0, 1):
                children.append(np.stack([parent[:, 0], parent[:, 1] + 1, 2 * parent[:, 2] + du, 2 * parent[:, 3] + dv], axis=1))
        children = np.concatenate(children)
        children = children[np.diff(self.cut(children)[0]) > 0]
        self.leaves = np.concatenate([self.leaves[~flags], children])

    def sort(self):
        self.leaves = self.leaves[np.lexsort((self.leaves[:, 3], self.leaves[:, 2], self.leaves[:, 1], self.leaves[:, 0]))]

    def mesh(self) -> Mesh:
        surface, leaves = self.surface, self.leaves
        start, pieces, cdf, area = self.cut(leaves)
        side, level = leaves[:, 0], leaves[:, 1]
        finest = np.zeros(len(self.root), np.int64)
        np.maximum.at(finest, side, level)
        shape = self.root * (1 << finest)[:, None]
        used = np.zeros(len(self.root), bool)
        used[side] = True
        count = np.where(used, shape.prod(axis=1), 0)
        table = np.where(used, np.concatenate([[0], np.cumsum(count)[:-1]]), -1)
        leaf = _table(leaves, finest, shape, table, int(count.sum()))
        f = side // 2
        weight = np.diff(cdf, prepend=0.0)
        weight[start[:-1]] = cdf[start[:-1]]
        middle = np.add.reduceat(pieces.mean(axis=1) * weight[:, None], start[:-1], axis=0)
        centre = surface.origin[f] + middle[:, :1] * surface.axes[f, 0] + middle[:, 1:] * surface.axes[f, 1]
        above = np.stack([side, level, leaves[:, 2] >> 1, leaves[:, 3] >> 1], axis=1)
        parent = np.unique(above, axis=0, return_inverse=True)[1].reshape(-1)
        return Mesh(side.astype(np.int32), area, centre, start, pieces, cdf, table, shape.astype(np.int32), leaf, parent.astype(np.int32))


@njit(cache=True)
def _table(leaves, finest, shape, start, total):
    leaf = np.full(total, -1, np.int32)
    for i in range(len(leaves)):
        side, level, iu, iv = leaves[i, 0], leaves[i, 1], leaves[i, 2], leaves[i, 3]
        k = 1 << (finest[side] - level)
        for a in range(iu * k, (iu + 1) * k):
            for b in range(iv * k, (iv + 1) * k):
                leaf[start[side] + a * shape[side, 1] + b] = i
    return leaf


def live_sides(surface: Surface) -> np.ndarray:
    """Sides that can receive light: not inside a solid, and seeing something. (S,) int."""
    from lib import form_factors
    candidates = np.flatnonzero(~surface.inside)
    tree = _Tree(surface, candidates, coarse=float(surface.size.max()) / 4)
    mesh = tree.mesh()
    seen = form_factors.probe(surface, mesh, n_rays=32)
    return np.unique(mesh.side[seen > 0])


def build(surface: Surface, *, patches, max_level, contrast, emitters=(), n_rays=64, uniform=False) -> Mesh:
    """Cut the lit sides into about `patches` root cells (in area), then refine where the light is uneven.

    patches : root cells if all cells had equal area; a small facet always has at least one
    max_level : times a root cell may be halved
    contrast : split a cell if area x (standard deviation of the irradiance between its quadrants) exceeds this
               share of the mean irradiance of the scene times the mean area of a root cell
    uniform : no adaptation; every root cell is halved `max_level` times (for comparison)
    """
    from lib import form_factors
    sides = live_sides(surface)
    if len(sides) == 0:
        raise ValueError("no facet sees another: there is no light to balance")
    area = float(facet_areas(surface)[sides // 2].sum())
    tree = _Tree(surface, sides, np.sqrt(area / patches))
    for level in range(max_level):
        flags = np.ones(len(tree.leaves), bool)
        if not uniform:
            if not emitters:
                break
            tree.sort()
            mesh = tree.mesh()
            cells = tree.cells()
            middle = (cells[:, 1:3] + cells[:, 3:5]) / 2
            mean, spread = form_factors.light_spread(surface, mesh, middle, emitters, n_rays=n_rays, seed=level)
            yardstick = float((mean * mesh.area).sum() / area) * area / patches
            flags = (mesh.area * spread > contrast * yardstick) & (tree.leaves[:, 1] == level)
        if not flags.any():
            break
        tree.split(flags)
    tree.sort()
    return tree.mesh()


def facet_areas(surface):
    v = surface.corners
    a = 0.5 * np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1)
    return np.bincount(surface.facet, a, minlength=len(surface.normal))
