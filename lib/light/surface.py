"""The model ready for rays: local coordinates, a frame in each facet's plane, what is solid, what can occlude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.given import rays as ray_tools
from lib.given.rays import Caster, Local
from lib.given.rays_kernels import OFFSET
from lib.light import surface_kernels as kernels


@dataclass(frozen=True)
class Surface:
    """The model in local coordinates, ready for rays."""

    local: Local
    corners: np.ndarray  # (T, 3, 3) float64 local
    facet: np.ndarray  # (T,) int32 facet of each triangle
    normal: np.ndarray  # (F, 3)
    group: np.ndarray  # (F,) int32
    object: np.ndarray  # (F,) int32
    origin: np.ndarray  # (F, 3) a corner of the bounding rectangle
    axes: np.ndarray  # (F, 2, 3) unit, in the plane; axes[0] x axes[1] = normal
    size: np.ndarray  # (F, 2) of the bounding rectangle
    inside: np.ndarray  # (2 F,) bool: the side looks into a solid
    groups: tuple
    caster: Caster
    shadows: Caster  # facets that can occlude, lamps among them
    n_occluders: int  # facets that can; a lamp of one facet does not stand in its own light
    cast: np.ndarray  # (T, 3, 3) float64 local: corners as they are cast, solids a hair thinner
    overlap: (
        np.ndarray
    )  # (F,) int8: of a solid that may reach into another: 1 where its inside is at the back, -1 at the front; else 0


def surface(model, lamps=()) -> Surface:
    """Facet frames, solids and ray casters. lamps: names of the groups that emit."""
    local = Local.of(model)
    corners = local.points(model.vertices)[model.triangles]
    facet = np.array(model.triangle_facet, np.int32)  # copies: kernels would be compiled again for read-only arrays
    normal = np.array(model.facet_normal, float)
    can = ray_tools.occluders(corners, facet)
    lamp_facet = np.isin(model.facet_group, [model.groups.index(g) for g in lamps if g in model.groups])
    inside = _inside(model, local, corners, facet, normal, lamp_facet)
    overlap = _overlap(corners, facet, model.facet_object, inside)
    corners, covered = _lift(corners, facet, normal, inside, lamp_facet)
    inside |= covered
    order = np.argsort(facet, kind="stable").astype(np.int64)
    start = np.searchsorted(facet[order], np.arange(len(normal) + 1)).astype(np.int64)
    origin, axes, size = kernels.frames(corners, order, start, normal)
    # Solids are cast a hair thinner than they are: a ray inside a cabinet then meets the cabinet, not the wall that its back touches.
    thinner = 0.3 * OFFSET * (inside[0::2].astype(float) - inside[1::2])[:, None] * normal
    cast = corners + thinner[facet][:, None, :]
    return Surface(
        local,
        corners,
        facet,
        normal,
        np.asarray(model.facet_group, np.int32),
        np.asarray(model.facet_object, np.int32),
        origin,
        axes,
        size,
        inside,
        tuple(model.groups),
        Caster(cast),
        Caster(cast[can[facet]]),
        int(can[~lamp_facet].sum()) + (int(can[lamp_facet].sum()) if lamp_facet.sum() > 1 else 0),
        cast,
        overlap,
    )


def _inside(model, local, corners, facet, normal, lamp_facet):
    """(2 F,) bool: sides that look into a solid, an object that closes and holds no lamp inside (SCENE.md 3)."""
    inside = np.zeros(2 * len(normal), bool)
    first = np.unique(facet, return_index=True)[1]
    middle = corners[first].mean(axis=1)
    direction = np.array([0.5377, 0.6339, 0.5560])  # no axis, no diagonal
    for obj in np.flatnonzero(model.solid_objects()):
        mine = np.flatnonzero(model.facet_object == obj)
        one = Caster(corners[np.isin(facet, mine)])

        def odd(points):
            r = np.hstack([points, np.broadcast_to(direction, points.shape)])
            return one.crossings(r) % 2 == 1

        lit = np.flatnonzero(lamp_facet)
        if len(lit) and odd(middle[lit] + 4 * OFFSET * normal[lit]).any():
            continue  # a room: the lamp shines inside it
        for back in (0, 1):
            inside[2 * mine + back] = odd(middle[mine] + (1 - 2 * back) * 4 * OFFSET * normal[mine])
    return inside


def _overlap(corners, facet, objects, inside):
    """Facets of solids whose bounding box reaches into that of another solid, see Surface.overlap. Inside one of them a ray
    may first meet the outside of the other; whether it started in a solid is then counted along the whole ray."""
    turn = inside[1::2].astype(np.int8) - inside[0::2]
    solids = np.unique(np.asarray(objects)[turn != 0])
    owner = np.asarray(objects)[facet]
    boxes = np.array([[c.min(axis=(0, 1)), c.max(axis=(0, 1))] for c in (corners[owner == o] for o in solids)]).reshape(
        -1, 2, 3
    )
    reach = np.minimum(boxes[:, None, 1], boxes[None, :, 1]) - np.maximum(
        boxes[:, None, 0], boxes[None, :, 0]
    )  # (S, S, 3)
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
    axis = int(np.argmax(low.std(axis=0) / np.maximum((high - low).mean(axis=0), OFFSET)))  # where boxes overlap least
    pairs = kernels.coplanar_pairs(
        np.argsort(low[:, axis], kind="stable"), axis, low, high, np.column_stack([normal, offset]) * turn[:, None]
    )
    if len(pairs) == 0:
        return corners, covered
    rank = np.lexsort((np.arange(F), last)).argsort()
    solid = inside[0::2] | inside[1::2]
    area = np.bincount(
        facet, 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1), F
    )
    order = np.argsort(facet, kind="stable")
    start = np.searchsorted(facet[order], np.arange(F + 1))
    level = np.zeros(F, int)
    hidden = np.zeros(2 * F)
    swap = rank[pairs[:, 0]] > rank[pairs[:, 1]]
    pairs[swap] = pairs[swap][:, ::-1]
    pairs = pairs[np.argsort(rank[pairs[:, 1]], kind="stable")]
    alike = np.einsum("ij,ij->i", normal[pairs[:, 0]], normal[pairs[:, 1]]) > 0
    common = np.array(
        [
            kernels.common_area(
                corners[order[start[i] : start[i + 1]]], corners[order[start[j] : start[j + 1]]], normal[i]
            )
            for i, j in pairs
        ]
    )
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


def facet_areas(surface):
    v = surface.corners
    a = 0.5 * np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1)
    return np.bincount(surface.facet, a, minlength=len(surface.normal))


def buried(surface: Surface, rays, triangle):
    """(k,) int: rays that start in a solid and yet meet an outer side first, that of another solid which overlaps the first."""
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
    """(M,) bool: points p (M, 3) of facets that lie inside a solid, by a ray straight up along their side's normal (M, 3)."""
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
