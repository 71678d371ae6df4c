"""The model ready for rays: local coordinates, a frame in each facet's plane, what is solid, what can occlude."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lib.core.rows import distinct
from lib.given import extent
from lib.given import rays as ray_tools
from lib.given.model.lying import NEAR
from lib.given.rays import GRID, Caster, Local
from lib.given.rays_kernels import OFFSET
from lib.light import surface_kernels as kernels
from lib.light.surface_kernels import SurfaceArrays

_kept = deque(maxlen=2)
PLACES, MOST_PLACES, WHOLLY = 16, 32_000, 0.9  # of a facet, at most; of an object; share of them that is in a solid
RAYS_OUT = np.array([(0.5377, 0.6339, 0.5560), (-0.6421, 0.5273, 0.5563), (0.4891, -0.5710, -0.6594)])  # no diagonals


@dataclass(frozen=True)
class Surface:
    """The model in local coordinates, ready for rays. T triangles, F facets.

    Side 2 f is the front of facet f, side 2 f + 1 its back.  The model's facets come first; behind them come the lids
    that make solids of open objects (lib/given/model/lids.py). Both sides of a lid look into a solid, so that no patch
    lies on it and a ray that meets it is dropped. It belongs to no group and casts no shadow; patches know no lids.
    """

    local: Local
    corners: np.ndarray  # (T, 3, 3) float64 local
    facet: np.ndarray  # (T,) int32 facet of each triangle
    normal: np.ndarray  # (F, 3)
    group: np.ndarray  # (F,) int32, -1: a lid
    object: np.ndarray  # (F,) int32
    origin: np.ndarray  # (F, 3) a corner of the bounding rectangle
    axes: np.ndarray  # (F, 2, 3) unit, in the plane; axes[0] x axes[1] = hand * normal
    size: np.ndarray  # (F, 2) of the bounding rectangle
    inside: np.ndarray  # (2 F,) bool: the side looks into a solid
    groups: tuple
    caster: Caster
    shadows: Caster  # facets that can occlude, lamps among them
    n_occluders: int  # facets that can; a lamp of one facet does not stand in its own light
    cast: np.ndarray  # (T, 3, 3) float64 local: corners as they are cast, solids a hair thinner
    # (F,) int8, of a solid that may reach into another: 1 where its inside is at the back, -1 at the front; else 0
    overlap: np.ndarray
    middle: np.ndarray  # (3,) of the model's corners, see lib/given/extent.py
    hand: int  # 1 or -1: that of the model, see lib/given/extent.py. Mirrored it has the same frames, mirrored

    @cached_property
    def place(self) -> np.ndarray:
        """(F,) int: the number of each facet in an order that is the scene's, not the file's: random numbers follow it.

        By what turning the scene leaves as it is, then by middle and normal; all rounded, so that no last bit decides.
        """
        p = self.origin + 0.5 * (self.size[:, :, None] * self.axes).sum(axis=1) - self.middle
        ways = [np.linalg.norm(p, axis=1), np.einsum("ij,ij->i", p, self.normal), *self.size.T]
        order = np.lexsort(np.rint(np.column_stack([self.normal, p, *ways]) / extent.SAME).T)
        return np.argsort(order, kind="stable")

    @cached_property
    def triangle_place(self) -> np.ndarray:
        """(T,) int: the same of the triangles."""
        p = self.corners.mean(axis=1) - self.middle
        order = np.lexsort(np.rint(np.column_stack([p, np.linalg.norm(p, axis=1)]) / extent.SAME).T)
        return np.argsort(order, kind="stable")

    @property
    def arrays(self) -> SurfaceArrays:
        """For kernels."""
        return SurfaceArrays(self.facet, self.normal, self.origin, self.axes, self.size, self.inside)


def surface(model, lamps=(), like=None) -> Surface:
    """Facet frames, solids and ray casters. lamps: names of the groups that emit.

    like : Surface of a model of which this one is a change (lib/given/model/changes.py): local coordinates and frames
        are the same, also of facets that are no longer there
    The last few are kept: several steps of a stage ask for the same.
    """
    lamps = tuple(name for name in lamps if name in model.groups)
    for of, names, kept in _kept:
        if of is model and names == lamps:
            return kept
    made = _surface(model, lamps, like)
    _kept.append((model, lamps, made))
    return made


def _surface(model, lamps, like) -> Surface:
    local = Local.of(model) if like is None else like.local
    corners = local.points(model.vertices)[model.triangles]
    middle = extent.middle(corners.reshape(-1, 3)) if like is None else like.middle
    hand = extent.hand(corners, middle) if like is None else like.hand
    corners = _begun(corners, middle, like)
    facet = np.array(model.triangle_facet, np.int32)  # copies: kernels would be compiled again for read-only arrays
    normal = np.rint(np.array(model.facet_normal, float) * GRID) / GRID  # as local coordinates
    can = ray_tools.occluders(corners, facet, len(normal))
    group, thing = np.array(model.facet_group, np.int32), np.array(model.facet_object, np.int32)
    lamp_facet = np.isin(model.facet_group, [model.groups.index(g) for g in lamps])
    faces = [(lid.object, local.points(lid.corners)) for lid in model.lids.faces]
    inside = _inside(model, faces, corners, facet, normal, lamp_facet)
    solids = np.unique(thing[inside[0::2] | inside[1::2]])
    faces = [(of, p) for of, p in faces if of in solids]
    overlap = _overlap(corners, facet, thing, inside)
    corners, covered = _lift(corners, facet, normal, inside, lamp_facet)
    inside |= covered
    cast = _thinner(corners, facet, normal, inside)
    shadows = Caster(cast[can[facet]])
    if faces:
        corners, facet, normal, cast = _with_lids(corners, facet, normal, cast, [p for _, p in faces])
        inside = np.append(inside, np.ones(2 * len(faces), bool))
        overlap = np.append(overlap, np.isin([of for of, _ in faces], thing[overlap != 0])).astype(np.int8)
        thing = np.append(thing, [of for of, _ in faces]).astype(np.int32)
        group = np.append(group, np.full(len(faces), -1)).astype(np.int32)
    order = np.argsort(facet, kind="stable").astype(np.int64)
    start = np.searchsorted(facet[order], np.arange(len(normal) + 1)).astype(np.int64)
    edges = kernels.frames(on_hand(corners, hand), order, start, normal)
    origin, axes, size = _told_apart(middle, hand, like, *edges)
    if like is not None:
        gone = np.setdiff1d(np.flatnonzero(like.group >= 0), facet)
        origin[gone], axes[gone], size[gone] = like.origin[gone], like.axes[gone], like.size[gone]
    return Surface(
        local,
        corners,
        facet,
        normal,
        group,
        thing,
        origin,
        axes,
        size,
        inside,
        tuple(model.groups),
        Caster(cast),
        shadows,
        int(can[~lamp_facet].sum()) + (int(can[lamp_facet].sum()) if lamp_facet.sum() > 1 else 0),
        cast,
        overlap,
        middle,
        hand,
    )


def _begun(corners, middle, like):
    """Triangles (T, 3, 3), each from its corner farthest from the model's middle, and not where the file begins it; as
    in `like`, where that has the same."""
    first = extent.farthest(corners, middle, 1.0)
    if like is not None and np.count_nonzero(like.group[like.facet] >= 0) == len(corners):
        before = like.corners[: len(corners)]
        away = [np.linalg.norm(np.roll(corners, -k, axis=1) - before, axis=2).sum(axis=1) for k in range(3)]
        first = np.argmin(away, axis=0)
    return np.take_along_axis(corners, ((first[:, None] + np.arange(3)) % 3)[:, :, None], axis=1)


def on_hand(corners, hand):
    """Triangles (T, 3, 3) whose corners go round on the model's hand, as mirrored: what is drawn on them follows it."""
    return corners if hand > 0 else np.ascontiguousarray(corners[:, [0, 2, 1]])


def _told_apart(middle, hand, like, origin, axes, size):
    """The same rectangles (origin, axes, size) from their corner farthest from the model's middle, the first side on
    the model's hand: where random numbers fall on a facet follows the scene and not the corners of its file. Facets
    that `like` has, too, keep their corner, so that its patches lie on them where they did.
    """
    ends = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = origin[:, None] + np.einsum("ka,fa,fai->fki", ends, size, axes)
    k = extent.farthest(corners, middle, 1.0)
    along, across = axes[:, 0], axes[:, 1]
    turned = np.stack(
        [np.stack(a, axis=1) for a in ((along, across), (across, -along), (-along, -across), (-across, along))]
    )[:, :, ::hand]
    if like is not None:
        n = np.count_nonzero(like.group >= 0)
        k[:n] = np.einsum("kfi,fi->kf", turned[:, :n, 0], like.axes[:n, 0]).argmax(axis=0)
    f = np.arange(len(k))
    size = np.where((k % 2 == 1)[:, None], size[:, ::-1], size)
    return corners[f, k], np.ascontiguousarray(turned[k, f]), np.ascontiguousarray(size[:, ::hand])


def _inside(model, lids, corners, facet, normal, lamp_facet):
    """(2 F,) bool: sides that look into a solid, an object that closes and holds no lamp inside (SCENE.md 3).

    lids : [(object, (n, 3, 3) local)]
    """
    inside = np.zeros(2 * len(normal), bool)
    there, first = np.unique(facet, return_index=True)
    middle = np.zeros((len(normal), 3))
    middle[there] = corners[first].mean(axis=1)
    absent = np.setdiff1d(np.arange(len(normal)), there)  # of objects that are not there: nothing reaches them
    inside[2 * absent], inside[2 * absent + 1] = True, True
    lit = np.setdiff1d(np.flatnonzero(lamp_facet), absent)
    apart = _apart(corners, facet, normal)
    owner = np.asarray(model.facet_object)[facet]
    order = np.argsort(owner, kind="stable")
    for obj in np.flatnonzero(model.solid_objects()):
        its = order[np.searchsorted(owner, obj, sorter=order) : np.searchsorted(owner, obj, "right", sorter=order)]
        if not len(its):
            continue  # it is not there
        mine = np.unique(facet[its])
        faces = [p for of, p in lids if of == obj]
        solid = np.concatenate([apart[its], *faces])
        # a lamp that lies on a lid may shine in from a little way outside
        heights = (4 * OFFSET, 2 * NEAR) if faces else (4 * OFFSET,)
        if any(_enclosed(solid, middle[lit] + height * normal[lit]).any() for height in heights):
            continue  # a room: the lamp shines inside it
        places = _places(corners[its], facet[its], mine, max(1, min(PLACES, MOST_PLACES // len(mine))))
        up = 4 * OFFSET * normal[mine]
        above = np.stack([places + up, places - up])  # of fronts and of backs
        share = _enclosed(solid, above.reshape(-1, 3)).reshape(2, len(places), -1).mean(axis=1)
        inside[2 * mine], inside[2 * mine + 1] = share > WHOLLY
    return inside


def _places(corners, facet, which, number):
    """(number, f, 3) points spread over the areas of the facets `which` (f,), the first in a triangle's middle."""
    order = np.argsort(facet, kind="stable")
    order = order[np.isin(facet[order], which)]
    area = np.cumsum(np.maximum(triangle_areas(corners[order]), 1e-30))
    end = np.searchsorted(facet[order], which, side="right") - 1
    start = np.searchsorted(facet[order], which)
    before = np.where(start > 0, area[start - 1], 0.0)
    u = (0.5 + np.arange(number)[:, None] * np.array([0.8191725134, 0.6710436067, 0.5497004779])) % 1.0  # R3 of Roberts
    at = before + u[:, :1] * (area[end] - before)
    triangle = corners[order[np.clip(np.searchsorted(area, at), start, end)]]
    v, w = u[:, 1], u[:, 2]
    v, w = np.where(v + w > 1, 1 - v, v), np.where(v + w > 1, 1 - w, w)
    v[0] = w[0] = 1 / 3
    weights = np.stack([1 - v - w, v, w], axis=1)
    return np.einsum("nk,nfkd->nfd", weights, triangle)


def _apart(corners, facet, normal):
    """(T, 3, 3): corners with each facet a part of a ray's offset outwards, those in one plane by different parts.

    Open3D counts one crossing where two facets coincide: the end of a shelf and the side board that it abuts.
    """
    there, first = np.unique(facet, return_index=True)
    turn = np.where(normal[there] @ RAYS_OUT[0] < 0, -1.0, 1.0)[:, None]
    height = np.einsum("ij,ij->i", corners[first, 0], normal[there])[:, None]
    plane = distinct(np.rint(np.hstack([normal[there], height]) * turn / OFFSET))[1]
    order = np.argsort(plane, kind="stable")
    rank = np.empty(len(there), int)
    rank[order] = np.arange(len(there)) - np.searchsorted(plane[order], plane[order])
    part = np.zeros(len(normal))
    part[there] = 0.2 + 0.1 * (rank % 8)
    return corners + (OFFSET * part[:, None] * normal)[facet][:, None, :]


def _enclosed(solid, points):
    """(n,) bool: points (n, 3) inside closed surfaces, which may touch and run through each other.

    solid : (T, 3, 3) local. Rays leave one more surface than they enter; where three do not say the same, since some
    polygons are turned the wrong way, most of them cross an odd number of polygons.
    """
    result = np.zeros(len(points), bool)
    low, high = solid.min(axis=(0, 1)) - OFFSET, solid.max(axis=(0, 1)) + OFFSET
    near = np.flatnonzero(((low <= points) & (points <= high)).all(axis=1))
    if not len(near):
        return result
    points, caster, n = points[near], Caster(solid), len(near)
    normal = np.cross(solid[:, 1] - solid[:, 0], solid[:, 2] - solid[:, 0])
    left, odd = np.zeros((len(RAYS_OUT), n)), np.zeros((len(RAYS_OUT), n))
    for k, out in enumerate(RAYS_OUT):
        ray, triangle = caster.crossings(np.hstack([points, np.broadcast_to(out, points.shape)]))
        left[k] = np.bincount(ray, np.sign(normal[triangle] @ out), n)
        odd[k] = np.bincount(ray, minlength=n) % 2
    result[near] = np.where((left == left[0]).all(axis=0), left[0] != 0, odd.mean(axis=0) > 0.5)
    return result


def _overlap(corners, facet, objects, inside):
    """Surface.overlap, from the bounding boxes of the solids.

    Inside one of two overlapping solids a ray may first meet the outside of the other. Whether it started in a solid
    is then counted along the whole ray.
    """
    turn = inside[1::2].astype(np.int8) - inside[0::2]
    solids = np.unique(np.asarray(objects)[turn != 0])
    owner, count = np.asarray(objects)[facet], int(np.max(objects, initial=0)) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, owner, corners.min(axis=1))
    np.maximum.at(high, owner, corners.max(axis=1))
    low, high = low[solids], high[solids]
    meets = np.zeros(len(solids), bool)
    for k in range(len(solids)):
        others = ((np.minimum(high[k], high) - np.maximum(low[k], low)) > 4 * OFFSET).all(axis=1)
        others[k] = False
        meets[k] = others.any()
    return np.where(np.isin(objects, solids[meets]), turn, 0).astype(np.int8)


def _with_lids(corners, facet, normal, cast, lids):
    """corners, facet, normal, cast of Surface, with the lids [(n, 3, 3) local] behind the model's facets."""
    p = np.concatenate(lids)
    v = [np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]).sum(axis=0) for t in lids]
    n = np.array(v) / np.linalg.norm(v, axis=1, keepdims=True)
    of = np.repeat(np.arange(len(lids)), [len(t) for t in lids])
    return (
        np.concatenate([corners, p]),
        np.concatenate([facet, len(normal) + of]).astype(np.int32),
        np.concatenate([normal, n]),
        np.concatenate([cast, p - 0.3 * OFFSET * n[of][:, None, :]]),  # thinner, see _thinner
    )


def _thinner(corners, facet, normal, inside):
    """(T, 3, 3): corners as they are cast, solids a hair thinner than they are.

    A ray inside a cabinet then meets the cabinet, not the wall that the cabinet's back touches.
    """
    turn = inside[1::2].astype(float) - inside[0::2]
    return corners - 0.3 * OFFSET * (turn[:, None] * normal)[facet][:, None, :]


def _lift(corners, facet, normal, inside, last):
    """Move facets that lie on each other apart by two ray offsets each: a board on a wall, two sheets back to back.

    last : (F,) bool, facets that are drawn last.  Returns corners (T, 3, 3), and (2 F,) bool, the sides that are then
    wholly covered.

    The order is that of the index buffer: what turns its front to us wins, then the later one in the file, lamps last
    of all. Rays that start on what is covered meet the covered side above them and are dropped, as in a solid. The
    side of a solid that touches a wall stays: solids are cast thinner.
    """
    F = len(normal)
    pairs = _coplanar_pairs(corners, facet, normal)
    if len(pairs) == 0:
        return corners, np.zeros(2 * F, bool)
    pairs = _lower_first(pairs, last)
    alike = np.einsum("ij,ij->i", normal[pairs[:, 0]], normal[pairs[:, 1]]) > 0
    area = np.bincount(facet, triangle_areas(corners), F)
    common = _common_areas(corners, facet, normal, pairs)
    meet = common > 1e-6 * area[pairs].min(axis=1)
    solid = inside[0::2] | inside[1::2]
    touching = np.zeros(F, bool)
    touching[pairs[meet & ~alike].ravel()] = True
    level = np.zeros(F, int)
    hidden = np.zeros(2 * F)
    for (i, j), same_way, shared in zip(pairs[meet], alike[meet], common[meet], strict=True):
        if same_way and not (solid[j] and touching[j]):
            level[j] = max(level[j], level[i] + 1)
            hidden[2 * j + 1] += shared / area[j]
        elif not same_way and not solid[i] and not solid[j]:
            level[[i, j]] = np.maximum(level[[i, j]], 1)
            hidden[2 * i + 1] += shared / area[i]
            hidden[2 * j + 1] += shared / area[j]
    return corners + (2 * OFFSET * level[:, None] * normal)[facet][:, None, :], hidden > 0.99


def _coplanar_pairs(corners, facet, normal):
    """(K, 2) facets in one plane whose bounding boxes overlap."""
    there, first, facet = np.unique(facet, return_index=True, return_inverse=True)  # not those of absent objects
    F, normal = len(there), normal[there]
    height = np.einsum("ij,ij->i", corners[first, 0], normal)
    turn = np.where(normal[np.arange(F), np.abs(normal).argmax(axis=1)] < 0, -1.0, 1.0)
    low, high = np.full((F, 3), np.inf), np.full((F, 3), -np.inf)
    np.minimum.at(low, facet, corners.min(axis=1))
    np.maximum.at(high, facet, corners.max(axis=1))
    # along the axis where the boxes overlap least
    axis = int(np.argmax(low.std(axis=0) / np.maximum((high - low).mean(axis=0), OFFSET)))
    order = np.argsort(low[:, axis], kind="stable")
    return there[kernels.coplanar_pairs(order, axis, low, high, np.column_stack([normal, height]) * turn[:, None])]


def _lower_first(pairs, last):
    """The pairs (K, 2) with the facet that lies below first, sorted by the one above."""
    rank = np.lexsort((np.arange(len(last)), last)).argsort()
    swap = rank[pairs[:, 0]] > rank[pairs[:, 1]]
    pairs[swap] = pairs[swap][:, ::-1]
    return pairs[np.argsort(rank[pairs[:, 1]], kind="stable")]


def _common_areas(corners, facet, normal, pairs):
    """(K,) area that the two facets of each pair share."""
    order = np.argsort(facet, kind="stable")
    start = np.searchsorted(facet[order], np.arange(len(normal) + 1))
    of = lambda f: corners[order[start[f] : start[f + 1]]]
    return np.array([kernels.common_area(of(i), of(j), normal[i]) for i, j in pairs])


def triangle_areas(corners):
    """(T,) areas of triangles (T, 3, 3)."""
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def facet_areas(surface: Surface):
    """(F,) local."""
    return np.bincount(surface.facet, triangle_areas(surface.corners), minlength=len(surface.normal))


def group_areas(surface: Surface):
    """(G,) local."""
    real = surface.group >= 0  # not a lid
    return np.bincount(surface.group[real], facet_areas(surface)[real], minlength=len(surface.groups))


def lids(surface: Surface):
    """(L,) int: the object of each lid."""
    return surface.object[surface.group < 0]


def buried(surface: Surface, rays, triangle):
    """(k,) int: rays that start in a solid and yet meet an outer side first, of another solid that overlaps it.

    rays : (n, 6) float32;  triangle : (n,) the first that each meets, -1
    """
    if not surface.overlap.any():
        return np.zeros(0, int)
    doubtful = np.flatnonzero((triangle >= 0) & (surface.overlap[surface.facet[triangle]] != 0))
    if not len(doubtful):  # open3d crashes where it has no ray to follow
        return doubtful
    return doubtful[surface.caster.winding(rays[doubtful], surface.overlap, surface.facet, surface.normal) > 0]


def start_inside(surface: Surface, rays, triangle):
    """(n,) bool: rays (n, 6) that start inside a solid; triangle : (n,) the first that each meets, -1.

    Such a ray meets an inner side first, or the outer side of another solid that overlaps the one it starts in.
    """
    f = surface.facet[triangle]
    back = np.einsum("ij,ij->i", rays[:, 3:], surface.normal[f]) > 0
    result = (triangle >= 0) & surface.inside[2 * f + back]
    result[buried(surface, rays, triangle)] = True
    return result


def covered(surface: Surface, p, normal):
    """(M,) bool: points of facets that lie inside a solid, by a ray straight up.

    p, normal : (M, 3) local, the normal of the point's side
    """
    if not surface.inside.any():
        return np.zeros(len(p), bool)
    up = np.hstack([p + OFFSET * normal, normal]).astype(np.float32)
    return start_inside(surface, up, surface.caster.closest(up)[0])


def side_normals(surface) -> np.ndarray:
    """(2 F, 3): the normal of each side."""
    return np.stack([surface.normal, -surface.normal], axis=1).reshape(-1, 3)


def backproject(surface: Surface, camera, facet, pixel):
    """Where the pixels' centres meet their facets' planes: (M, 3) local, and the side each shows, (M,) int32.

    facet : (M,) int;  pixel : (M,) flat index
    """
    q = np.stack([pixel % camera.width, pixel // camera.width], axis=1).astype(float)
    v = camera.rays(q)
    centre = surface.local.points(camera.centre)
    n = surface.normal[facet]
    height = np.einsum("ij,ij->i", surface.origin[facet] - centre, n)
    along = np.einsum("ij,ij->i", v, n)
    p = centre + v * (height / np.where(np.abs(along) > 1e-12, along, 1e-12))[:, None]
    return p, (2 * facet + (along > 0)).astype(np.int32)
