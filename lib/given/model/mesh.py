"""A model: the triangles of a file's polygons, and the facets that they form."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from lib.core.report import Note
from lib.core.rows import distinct
from lib.core.stage import BadInput
from lib.given.model.facets import joined
from lib.given.model.lids import Lids, lids
from lib.given.model.polygons import planar_pieces
from lib.given.model.triangles import triangulated

FARTHEST = 1e12  # the largest coordinate: squares and cubes of it stay far from the end of the numbers


@dataclass(frozen=True, eq=False)
class Model:
    """Triangles, and the facets, objects and groups that they belong to."""

    vertices: np.ndarray  # (V, 3) m, world
    triangles: np.ndarray  # (T, 3) int32, counter-clockwise seen from the front
    triangle_facet: np.ndarray  # (T,) int32
    facet_object: np.ndarray  # (F,) int32: index into objects
    facet_group: np.ndarray  # (F,) int32: index into groups
    facet_normal: np.ndarray  # (F, 3) unit, on the front side
    facet_offset: np.ndarray  # (F,) m: normal . x = offset on the facet
    objects: tuple  # of str: those that have a facet, in the file's order
    groups: tuple  # of str: the same
    warnings: tuple = ()  # of str: what was dropped or mended on the way in
    closed_objects: np.ndarray = field(default=None, repr=False)  # (O,) bool: every edge, by position, is shared
    notes: tuple = ()  # of str: what the file holds that is not read, and what was made of what it holds

    @property
    def n_facets(self) -> int:
        return len(self.facet_object)

    def scaled(self, metres) -> "Model":
        """The same with its vertices times `metres`; itself for 1."""
        if metres == 1.0:
            return self
        return replace(self, vertices=metres * self.vertices, facet_offset=metres * self.facet_offset)

    def corners(self) -> np.ndarray:
        """(T, 3, 3) m, world: the corners of every triangle."""
        return self.vertices[self.triangles]

    def triangle_normals(self) -> tuple[np.ndarray, np.ndarray]:
        """(T, 3), (T,) m2: unit normals on the front side, areas."""
        p = self.corners()
        v = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        length = np.linalg.norm(v, axis=1)
        return v / length[:, None], length / 2

    def facet_area(self) -> np.ndarray:
        """(F,) m2, one side."""
        return np.bincount(self.triangle_facet, self.triangle_normals()[1], self.n_facets)

    @cached_property
    def lids(self) -> Lids:
        """Faces that close objects which stand on others or lean against them, see lids.py."""
        return lids(self)

    def solid_objects(self, camera_centre=None, lamps=()) -> np.ndarray:
        """(O,) bool: objects that close and into which no light can come.

        An object closes when every edge, by position, belongs to an even number of its polygons, or with lids. A room
        closes too, but around its light: an object that holds the camera, or into which a facet of a lamp shines, is
        not solid.

        camera_centre : (3,) m, world        lamps : names of groups
        """
        solid = self.closed_objects.copy()
        solid[list(self.lids.objects)] = True
        scale = np.ptp(self.vertices, axis=0).max()
        points = np.zeros((0, 3)) if camera_centre is None else np.asarray(camera_centre, float)[None]
        lamp_groups = [self.groups.index(name) for name in lamps if name in self.groups]
        emits = np.isin(self.facet_group, lamp_groups)
        if emits.any():
            largest = self.largest_triangles(np.flatnonzero(emits))
            normal = self.facet_normal[self.triangle_facet[largest]]
            points = np.concatenate([points, self.corners()[largest].mean(axis=1) + 1e-6 * scale * normal])
        if len(points) == 0:
            return solid
        corners, owner = self.corners(), self.facet_object[self.triangle_facet]
        order = np.argsort(owner, kind="stable")
        start = np.searchsorted(owner[order], np.arange(len(self.objects) + 1))
        for i in np.flatnonzero(solid):
            mine = order[start[i] : start[i + 1]]
            p = np.concatenate([corners[mine], *(lid.corners for lid in self.lids.faces if lid.object == i)])
            if len(p):
                near = ((p.min(axis=(0, 1)) <= points) & (points <= p.max(axis=(0, 1)))).all(axis=1)
                solid[i] = not any(abs(_winding_number(p, point)) > 0.5 for point in points[near])
        return solid

    def largest_triangles(self, facets):
        """(k,) int: of each of the facets that have triangles the largest, the first of equals."""
        its = np.flatnonzero(np.isin(self.triangle_facet, facets))
        its = its[np.lexsort((its, -self.triangle_normals()[1][its], self.triangle_facet[its]))]
        return its[np.unique(self.triangle_facet[its], return_index=True)[1]]


def _winding_number(p, point):
    """How often the closed triangles p (N, 3, 3) go round the point: +-1 inside, 0 outside."""
    a, b, c = np.moveaxis(p - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    dot = lambda u, v: np.einsum("ij,ij->i", u, v)
    return np.arctan2(numerator, la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb).sum() / (2 * np.pi)


def build(path, polygons) -> Model:
    """The model of what a reader found.  path : for messages

    Vertices at the same place are one.  Raises BadInput where no polygon has an area.
    """
    if len(polygons.starts) < 2:
        raise BadInput(f"{path}: faces: the model has none")
    vertices = polygons.vertices
    far = np.argwhere(~(np.abs(vertices) <= FARTHEST))
    if len(far):
        number, axis = far[0]
        value = vertices[number, axis]
        raise BadInput(
            f"{path}: vertex {number + 1}: {'xyz'[axis]} = {value:g} is not a number of at most {FARTHEST:g}"
        )
    position = distinct(vertices)[1]
    pieces, warnings, crossed = planar_pieces(path, polygons, position)
    facet_of_piece, closed = joined(vertices, position, pieces, len(polygons.objects))
    triangles, of_piece, crossed_too = triangulated(vertices, pieces)
    if crossed + crossed_too:
        warnings.append(f"{crossed + crossed_too} polygons cross themselves: their triangles may overlap")

    triangle_facet = facet_of_piece[of_piece]
    p = vertices[triangles]
    v = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    sliver = np.linalg.norm(v, axis=1) <= 1e-15 * np.ptp(p, axis=1).max(axis=1) ** 2  # of collinear corners
    first = _first_of_its_like(np.column_stack([np.sort(position[triangles], axis=1), triangle_facet]))
    if not first.all():
        warnings.append(Note(f"{np.count_nonzero(~first)} triangles that stand there twice were dropped"))
    keep = first & ~sliver
    triangles, of_piece, triangle_facet, p, v = (a[keep] for a in (triangles, of_piece, triangle_facet, p, v))

    triangle_facet, start = _in_file_order(triangle_facet)
    normal, offset = _planes(p, v, triangle_facet, p[start, 0])
    source = of_piece[start]
    facet_object, objects = _used(pieces.object[source], polygons.objects)
    facet_group, groups = _used(pieces.group[source], polygons.groups)
    for array in (vertices, triangles, triangle_facet, normal, offset):
        array.flags.writeable = False
    built = Model(
        vertices,
        triangles.astype(np.int32),
        triangle_facet,
        facet_object,
        facet_group,
        normal,
        offset,
        objects,
        groups,
        tuple(warnings),
        closed[np.unique(pieces.object[source])],
        tuple(polygons.notes),
    )
    return _with_absent(path, built, polygons) if polygons.absent else built


def _with_absent(path, model, polygons) -> Model:
    """With the facets of objects that are not there: they have numbers and names, and no triangle."""
    number, thing, group = np.array(polygons.absent).T
    total = model.n_facets + len(number)
    if not (np.unique(number).size == len(number) and number.min() >= 0 and number.max() < total):
        raise BadInput(f"{path}: extras.absent: facets {number.tolist()} of {total}")
    there = np.setdiff1d(np.arange(total), number)
    objects, groups = tuple(polygons.objects), tuple(polygons.groups)
    of = lambda names, all_names, index: np.array([all_names.index(name) for name in names], np.int32)[index]
    facet_object, facet_group = np.zeros(total, np.int32), np.zeros(total, np.int32)
    facet_object[there] = of(model.objects, objects, model.facet_object)
    facet_group[there] = of(model.groups, groups, model.facet_group)
    facet_object[number], facet_group[number] = thing, group
    normal, offset = np.tile([0.0, 0.0, 1.0], (total, 1)), np.zeros(total)
    normal[there], offset[there] = model.facet_normal, model.facet_offset
    closed = np.array([name in model.objects and model.closed_objects[model.objects.index(name)] for name in objects])
    return replace(
        model,
        triangle_facet=there[model.triangle_facet].astype(np.int32),
        facet_object=facet_object,
        facet_group=facet_group,
        facet_normal=normal,
        facet_offset=offset,
        objects=objects,
        groups=groups,
        closed_objects=closed,
    )


def _first_of_its_like(key):
    """(T,) bool: no row above is the same."""
    first = np.zeros(len(key), bool)
    first[distinct(key)[0]] = True
    return first


def _in_file_order(triangle_facet):
    """(facets numbered as they first appear, (F,) the first triangle of each)."""
    start, facet = np.unique(triangle_facet, return_index=True, return_inverse=True)[1:]
    rank = np.argsort(np.argsort(start))
    return rank[facet].astype(np.int32), np.sort(start)


def _planes(p, v, triangle_facet, base):
    """(unit normals (F, 3), offsets (F,) m): each facet's mean plane, its triangles weighted by their area.

    p : (T, 3, 3) m        v : (T, 3) twice the area vectors        base : (F, 3) m, a point of each facet
    """
    n, weight = len(base), np.linalg.norm(v, axis=1)
    normal = np.stack([np.bincount(triangle_facet, v[:, k], n) for k in range(3)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    relative = p.mean(axis=1) - base[triangle_facet]
    moments = np.stack([np.bincount(triangle_facet, weight * relative[:, k], n) for k in range(3)], axis=1)
    relative = moments / np.bincount(triangle_facet, weight, n)[:, None]
    return normal, np.einsum("ij,ij->i", normal, base) + np.einsum("ij,ij->i", normal, relative)


def _used(index, names):
    """(index into the names that are used, those names)."""
    used = np.unique(index)
    return np.searchsorted(used, index).astype(np.int32), tuple(names[i] for i in used)
