"""The 3D model: triangles, and the facets, objects and groups they belong to.

    model = load("model.obj")                   # or .glb
    model.groups[model.facet_group[model.triangle_facet[t]]]

A *group* (the file's material) has one photometry, an *object* (`o`, node) is a
thing, a *facet* is a maximal flat piece of one object and one group. The frame
is the file's, the unit is the metre.
"""

import json
import os
import struct
from dataclasses import dataclass, field

import numpy as np

from lib.stage import BadInput

FLAT = 1e-3           # polygons are coplanar within this part of their size (data/SCENE.md, section 2)


@dataclass(frozen=True, eq=False)
class Model:
    """vertices : (V, 3) m, world
    triangles : (T, 3) int32           counter-clockwise seen from the front
    triangle_facet : (T,) int32
    facet_object, facet_group : (F,) int32      indices into objects, groups
    facet_normal : (F, 3)              unit, on the front side
    facet_offset : (F,) m              normal . x = offset on the facet
    objects, groups : tuple of str     those that have a facet, in the file's order
    warnings : tuple of str            what was dropped or mended on the way in
    """

    vertices: np.ndarray
    triangles: np.ndarray
    triangle_facet: np.ndarray
    facet_object: np.ndarray
    facet_group: np.ndarray
    facet_normal: np.ndarray
    facet_offset: np.ndarray
    objects: tuple
    groups: tuple
    warnings: tuple = ()
    closed_objects: np.ndarray = field(default=None, repr=False)   # (O,) bool: every edge, by position, is shared

    @property
    def n_facets(self):
        return len(self.facet_object)

    def corners(self):
        """(T, 3, 3) m, world: the corners of every triangle."""
        return self.vertices[self.triangles]

    def triangle_normals(self):
        """(T, 3), (T,) m2: unit normals on the front side, areas."""
        p = self.corners()
        v = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        length = np.linalg.norm(v, axis=1)
        return v / length[:, None], length / 2

    def facet_area(self):
        """(F,) m2, one side."""
        return np.bincount(self.triangle_facet, self.triangle_normals()[1], self.n_facets)

    def solid_objects(self, camera_centre=None, lamps=()):
        """(O,) bool: objects that close and into which no light can come.

        An object closes when every edge, by position, belongs to an even number of its
        polygons. A room closes too, but around its light: an object that holds the camera
        (camera_centre : (3,) m, world), or into which a facet of a lamp group (lamps:
        names) shines, is not solid.
        """
        solid = self.closed_objects.copy()
        scale = np.ptp(self.vertices, axis=0).max()
        points = [] if camera_centre is None else [np.asarray(camera_centre, float)]
        area = self.triangle_normals()[1]
        for facet in np.flatnonzero(np.isin(self.facet_group, [self.groups.index(name) for name in lamps if name in self.groups])):
            mine = np.flatnonzero(self.triangle_facet == facet)
            middle = self.corners()[mine[np.argmax(area[mine])]].mean(axis=0)
            points.append(middle + 1e-6 * scale * self.facet_normal[facet])
        owner = self.facet_object[self.triangle_facet]
        for i in np.flatnonzero(solid):
            p = self.corners()[owner == i]
            solid[i] = not any(abs(_winding_number(p, point)) > 0.5 for point in points)
        return solid


def _winding_number(p, point):
    """How often the closed triangles p (N, 3, 3) go round the point: +-1 inside, 0 outside."""
    a, b, c = np.moveaxis(p - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    dot = lambda u, v: np.einsum("ij,ij->i", u, v)
    return np.arctan2(numerator, la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb).sum() / (2 * np.pi)


def load(path) -> Model:
    """Read and check model.obj or model.glb.

    Refused, naming file, line (or primitive) and value: a vertex that is not finite, an index out
    of range, a face without material, no face at all. Polygons without area are dropped, polygons
    that are not planar and those that cross themselves are triangulated; each leaves a warning.
    """
    path = os.fspath(path)
    try:
        with open(path, "rb") as file:
            content = file.read()
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    polygons = _read_glb(path, content) if content[:4] == b"glTF" else _read_obj(path, content)
    return _build(path, *polygons)


# Readers: both return vertices (V, 3), corners (n,), starts (P + 1,), object and group index per polygon, their names.

def _read_obj(path, content):
    """Wavefront OBJ: v, f, o, usemtl; everything else, `g` included, is passed over."""
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if "\0" in text:
        raise BadInput(f"{path}: not an OBJ file: byte 0 at {text.index(chr(0))}")
    vertices, vertex_lines = [], []
    corners, starts, polygon_object, polygon_group, polygon_lines = [], [0], [], [], []
    objects, groups = {}, {}
    thing, material = None, None
    lines = text.split("\n")
    number = 0
    while number < len(lines):
        line = lines[number]
        number += 1
        first = number
        while line.rstrip().endswith("\\") and number < len(lines):
            line = line.rstrip()[:-1] + " " + lines[number]
            number += 1
        word = line.split(None, 1)
        if not word:
            continue
        kind = word[0]
        if kind == "v":
            values = line.split()
            if len(values) < 4:
                raise BadInput(f"{path}: line {first}: vertex has {len(values) - 1} coordinates instead of 3")
            vertices.append(values[1:4])
            vertex_lines.append(first)
        elif kind == "f":
            if material is None:
                raise BadInput(f"{path}: line {first}: face '{line.strip()}' has no material (usemtl)")
            try:
                face = [int(corner.split("/", 1)[0]) for corner in line.split("#", 1)[0].split()[1:]]
            except ValueError:
                raise BadInput(f"{path}: line {first}: face '{line.strip()}' has an index that is not a whole number") from None
            if len(face) < 3:
                raise BadInput(f"{path}: line {first}: face '{line.strip()}' has {len(face)} corners")
            count = len(vertices)
            for index in face:
                if index == 0 or index < -count:
                    raise BadInput(f"{path}: line {first}: face index {index} is out of range (1 to {count})")
            corners += [min(index - 1, 1 << 62) if index > 0 else count + index for index in face]
            starts.append(len(corners))
            if thing is None:
                thing = objects.setdefault("default", len(objects))
            polygon_object.append(thing)
            polygon_group.append(groups.setdefault(material, len(groups)))
            polygon_lines.append(first)
        elif kind == "o":
            name = word[1].strip() if len(word) > 1 else "default"
            thing = objects.setdefault(name, len(objects))
        elif kind == "usemtl":
            material = word[1].strip() if len(word) > 1 else None
    try:
        p = np.array(vertices, float).reshape(-1, 3)
    except ValueError:
        for values, line in zip(vertices, vertex_lines):
            for axis, value in zip("xyz", values):
                try:
                    float(value)
                except ValueError:
                    raise BadInput(f"{path}: line {line}: vertex {axis} = {value} is not a number") from None
        raise
    bad = np.argwhere(~np.isfinite(p))
    if len(bad):
        i, axis = bad[0]
        raise BadInput(f"{path}: line {vertex_lines[i]}: vertex {'xyz'[axis]} = {vertices[i][axis]} is not finite")
    corners, starts = np.array(corners, np.int64), np.array(starts, np.int64)
    beyond = np.flatnonzero(corners >= len(p))
    if len(beyond):
        line = polygon_lines[np.searchsorted(starts, beyond[0], side="right") - 1]
        raise BadInput(f"{path}: line {line}: face index {corners[beyond[0]] + 1} is out of range (1 to {len(p)})")
    return p, corners, starts, polygon_object, polygon_group, list(objects), list(groups)


_GLTF_KIND = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_GLTF_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def _read_glb(path, content):
    """Binary glTF 2: the triangles of the nodes of its scene, in the file's frame (node transforms applied)."""
    try:
        magic, version, total = struct.unpack_from("<4sII", content)
        if version != 2:
            raise BadInput(f"{path}: version: glTF {version} instead of 2")
        if total > len(content):
            raise BadInput(f"{path}: truncated: {total} bytes are announced, {len(content)} are there")
        chunks, at = {}, 12
        while at + 8 <= total:
            length, kind = struct.unpack_from("<I4s", content, at)
            chunks.setdefault(kind, content[at + 8:at + 8 + length])
            at += 8 + length
        return _glb_polygons(path, json.loads(chunks[b"JSON"]), chunks.get(b"BIN\0", b""))
    except (KeyError, IndexError, TypeError, ValueError, struct.error) as error:
        raise BadInput(f"{path}: not a readable GLB: {type(error).__name__}: {error}") from None


def _glb_polygons(path, gltf, binary):
    def accessor(index):
        a = gltf["accessors"][index]
        if "sparse" in a or "bufferView" not in a:
            raise BadInput(f"{path}: accessor {index}: sparse or compressed data is not supported")
        view = gltf["bufferViews"][a["bufferView"]]
        if view.get("buffer", 0) != 0 or "uri" in gltf["buffers"][0]:
            raise BadInput(f"{path}: accessor {index}: data outside the file is not supported")
        kind, width = np.dtype(_GLTF_KIND[a["componentType"]]), _GLTF_WIDTH[a["type"]]
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * width)
        end = start + stride * (a["count"] - 1) + kind.itemsize * width
        if a["count"] and end > len(binary):
            raise BadInput(f"{path}: accessor {index}: truncated: {end} bytes are needed, {len(binary)} are there")
        return np.ndarray((a["count"], width), kind, binary, start, (stride, kind.itemsize)).copy()

    def local(node):
        if "matrix" in node:
            return np.array(node["matrix"], float).reshape(4, 4).T
        T = np.eye(4)
        x, y, z, w = node.get("rotation", (0, 0, 0, 1))
        T[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
        T[:3, :3] *= node.get("scale", (1, 1, 1))
        T[:3, 3] = node.get("translation", (0, 0, 0))
        return T

    vertices, triangles, polygon_object, polygon_group, count = [np.zeros((0, 3))], [np.zeros((0, 3), int)], [], [], 0
    objects, groups = {}, {}
    nodes = gltf.get("nodes", [])
    children = {child for node in nodes for child in node.get("children", ())}
    roots = gltf["scenes"][gltf.get("scene", 0)].get("nodes", []) if gltf.get("scenes") else sorted(set(range(len(nodes))) - children)
    waiting = [(i, np.eye(4)) for i in reversed(roots)]
    seen = set()
    while waiting:
        i, T_world_parent = waiting.pop()
        if i in seen:
            raise BadInput(f"{path}: nodes: node {i} is reached twice: the nodes are not a tree")
        seen.add(i)
        node = nodes[i]
        T_world_node = T_world_parent @ local(node)
        waiting += [(child, T_world_node) for child in reversed(node.get("children", ()))]
        if "mesh" not in node:
            continue
        mesh = gltf["meshes"][node["mesh"]]
        thing = str(node.get("name") or mesh.get("name") or f"node {i}")
        for k, primitive in enumerate(mesh["primitives"]):
            where = f"{path}: node '{thing}', primitive {k}"
            mode = primitive.get("mode", 4)
            if mode < 4:
                continue                                                     # points and lines
            if "material" not in primitive:
                raise BadInput(f"{where}: has no material")
            p = accessor(primitive["attributes"]["POSITION"]).astype(float)
            bad = np.argwhere(~np.isfinite(p))
            if len(bad):
                v, axis = bad[0]
                raise BadInput(f"{where}: vertex {v}: {'xyz'[axis]} = {p[v, axis]} is not finite")
            index = accessor(primitive["indices"])[:, 0].astype(int) if "indices" in primitive else np.arange(len(p))
            if len(index) and index.max() >= len(p):
                raise BadInput(f"{where}: face index {index.max()} is out of range (0 to {len(p) - 1})")
            if mode == 4:
                index = index[:len(index) // 3 * 3].reshape(-1, 3)
            elif mode == 5:                                                  # a strip: every other one turned
                index = np.stack([index[:-2], index[1:-1], index[2:]], 1)
                index[1::2] = index[1::2][:, [1, 0, 2]]
            else:                                                            # a fan
                index = np.stack([np.full(max(len(index) - 2, 0), index[0]), index[1:-1], index[2:]], 1)
            if np.linalg.det(T_world_node[:3, :3]) < 0:                      # mirrored: the front stays the front
                index = index[:, ::-1]
            name = str(gltf["materials"][primitive["material"]].get("name") or f"material {primitive['material']}")
            vertices.append(p @ T_world_node[:3, :3].T + T_world_node[:3, 3])
            triangles.append(index + count)
            count += len(p)
            polygon_object += [objects.setdefault(thing, len(objects))] * len(index)
            polygon_group += [groups.setdefault(name, len(groups))] * len(index)
    p = np.concatenate(vertices)
    if not np.isfinite(p).all():
        raise BadInput(f"{path}: nodes: a transform is not finite")
    corners = np.concatenate(triangles).ravel()
    return p, corners, np.arange(0, len(corners) + 1, 3), polygon_object, polygon_group, list(objects), list(groups)


# From polygons to triangles and facets.

def _build(path, vertices, corners, starts, polygon_object, polygon_group, objects, groups):
    if len(starts) < 2:
        raise BadInput(f"{path}: faces: the model has none")
    polygon_object, polygon_group = np.array(polygon_object, np.int32), np.array(polygon_group, np.int32)
    warnings = []

    # Vertices at the same place are one; corners that repeat their predecessor are dropped.
    position = np.unique(vertices + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    owner = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    following = np.arange(1, len(corners) + 1)
    following[starts[1:] - 1] = starts[:-1]
    keep = position[corners] != position[corners[following]]
    corners, owner = corners[keep], owner[keep]
    size = np.bincount(owner, minlength=len(starts) - 1)

    # Area vectors (Newell), relative to the first corner so that nothing cancels far from the origin.
    starts = np.concatenate([[0], np.cumsum(size)])
    area_vector, diameter, height = _polygon_shape(vertices, corners, starts)
    area = np.linalg.norm(area_vector, axis=1)
    rounding = 4 * np.finfo(float).eps * np.abs(vertices).max()
    empty = (size < 3) | (area <= 1e-12 * diameter**2 + rounding * diameter)
    if empty.any():
        warnings.append(f"{empty.sum()} polygons without area were dropped")
        if empty.all():
            raise BadInput(f"{path}: faces: none of the {len(size)} has an area")

    # Pieces: the polygons, those that are not planar cut into triangles.
    crooked = ~empty & (size > 3) & (height > FLAT * np.sqrt(area))
    keep = ~(empty | crooked)[owner]
    piece_corners, piece_sizes, piece_from = [corners[keep]], [size[~(empty | crooked)]], [np.flatnonzero(~(empty | crooked))]
    crossed = 0
    for polygon in np.flatnonzero(crooked):
        ring = corners[starts[polygon]:starts[polygon + 1]]
        t, bad = _ears(vertices, ring, area_vector[polygon])
        crossed += bad
        piece_corners.append(t.ravel())
        piece_sizes.append(np.full(len(t), 3))
        piece_from.append(np.full(len(t), polygon))
    if crooked.any():
        warnings.append(f"{crooked.sum()} polygons are not planar and were cut into triangles")
    size, came_from = np.concatenate(piece_sizes), np.concatenate(piece_from)
    corners, starts = np.concatenate(piece_corners), np.concatenate([[0], np.cumsum(size)])
    if crooked.any():                                                        # back into the file's order
        order = np.argsort(came_from, kind="stable")
        corners = np.concatenate([corners[starts[i]:starts[i + 1]] for i in order])
        size, came_from = size[order], came_from[order]
        starts = np.concatenate([[0], np.cumsum(size)])
    thing, material = polygon_object[came_from], polygon_group[came_from]
    area_vector = _polygon_shape(vertices, corners, starts)[0]

    facet, closed = _facets(vertices, position, corners, starts, area_vector, thing, material, len(objects))

    # Triangles.
    triangles, of_piece = [corners[np.repeat(size == 3, size)].reshape(-1, 3)], [np.flatnonzero(size == 3)]
    four = np.flatnonzero(size == 4)
    if len(four):
        q = corners[starts[four][:, None] + np.arange(4)]
        cuts = np.array([[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]])
        least = np.stack([np.stack([_signed_area(vertices, q[:, t], area_vector[four]) for t in cut]).min(axis=0) for cut in cuts])
        best = least.argmax(axis=0)
        good = least.max(axis=0) > -1e-12 * np.linalg.norm(area_vector[four], axis=1)
        triangles.append(q[np.arange(len(q))[:, None, None], cuts[best]][good].reshape(-1, 3))
        of_piece.append(np.repeat(four[good], 2))
        many = np.concatenate([four[~good], np.flatnonzero(size > 4)])
    else:
        many = np.flatnonzero(size > 4)
    for i in many:
        t, bad = _ears(vertices, corners[starts[i]:starts[i + 1]], area_vector[i])
        crossed += bad
        triangles.append(t)
        of_piece.append(np.full(len(t), i))
    if crossed:
        warnings.append(f"{crossed} polygons cross themselves: their triangles may overlap")
    triangles, of_piece = np.concatenate(triangles), np.concatenate(of_piece)
    order = np.argsort(of_piece, kind="stable")
    triangles, triangle_facet = triangles[order], facet[of_piece[order]]

    p = vertices[triangles]
    v = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    length = np.linalg.norm(v, axis=1)
    keep = length > 1e-15 * np.ptp(p, axis=1).max(axis=1) ** 2                # slivers of collinear corners
    key = np.column_stack([np.sort(position[triangles], axis=1), triangle_facet])
    first = np.zeros(len(key), bool)
    first[np.unique(key, axis=0, return_index=True)[1]] = True
    if not first.all():
        warnings.append(f"{np.count_nonzero(~first)} triangles that stand there twice were dropped")
    keep &= first
    triangles, triangle_facet, v, p = triangles[keep], triangle_facet[keep], v[keep], p[keep]

    # Facets in the file's order, with the names that are used.
    used, start, facet = np.unique(triangle_facet, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(start))
    triangle_facet = rank[facet].astype(np.int32)
    source = of_piece[order][keep][np.sort(start)]
    n = len(used)
    normal = np.stack([np.bincount(triangle_facet, v[:, k], n) for k in range(3)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    weight = np.bincount(triangle_facet, np.linalg.norm(v, axis=1), n)
    base = p[np.sort(start), 0]
    relative = p.mean(axis=1) - base[triangle_facet]
    relative = np.stack([np.bincount(triangle_facet, np.linalg.norm(v, axis=1) * relative[:, k], n) for k in range(3)], axis=1) / weight[:, None]
    offset = np.einsum("ij,ij->i", normal, base) + np.einsum("ij,ij->i", normal, relative)
    facet_object, objects, closed = _used(thing[source], objects, closed)
    facet_group, groups, _ = _used(material[source], groups, np.zeros(len(groups), bool))
    for array in (vertices, triangles, triangle_facet, normal, offset):
        array.flags.writeable = False
    return Model(vertices, triangles.astype(np.int32), triangle_facet, facet_object, facet_group, normal, offset,
                 objects, groups, tuple(warnings), closed)


def _used(index, names, flags):
    used = np.unique(index)
    return np.searchsorted(used, index).astype(np.int32), tuple(names[i] for i in used), flags[used]


def _polygon_shape(vertices, corners, starts):
    """Per polygon: area vector (P, 3), diameter of its box (P,), greatest distance from its plane (P,)."""
    size = np.diff(starts)
    count = len(size)
    area_vector, diameter, height = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    some = np.flatnonzero(size > 0)
    if len(some) == 0:
        return area_vector, diameter, height
    owner = np.repeat(np.arange(count), size)
    origin = np.zeros((count, 3))
    origin[some] = vertices[corners[starts[:-1][some]]]
    p = vertices[corners] - origin[owner]
    following = np.arange(1, len(corners) + 1)
    following[starts[1:][some] - 1] = starts[:-1][some]
    at = starts[:-1][some]
    area_vector[some] = np.add.reduceat(np.cross(p, p[following]), at) / 2
    low, high = np.minimum.reduceat(p, at), np.maximum.reduceat(p, at)
    diameter[some] = np.linalg.norm(high - low, axis=1)
    mean = np.add.reduceat(p, at) / size[some, None]
    length = np.linalg.norm(area_vector, axis=1, keepdims=True)
    n = area_vector / np.where(length > 0, length, 1)
    offset = np.zeros(count)
    offset[some] = np.einsum("ij,ij->i", n[some], mean)
    height[some] = np.maximum.reduceat(np.abs(np.einsum("ij,ij->i", p, n[owner]) - offset[owner]), at)
    return area_vector, diameter, height


def _signed_area(vertices, triangles, direction):
    p = vertices[triangles]
    v = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return np.einsum("ij,ij->i", v, direction) / (2 * np.linalg.norm(direction, axis=1))


def _ears(vertices, ring, area_vector):
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


def _facets(vertices, position, corners, starts, area_vector, thing, material, n_objects):
    """Which facet each polygon belongs to (P,), and which objects are closed (n_objects,).

    Neighbours join when they are of one object and group, face the same way, and the smaller one
    rises from the other's plane by at most FLAT of their size, both measured across the shared edge.
    A chain of such steps can bend (a finely cut cylinder): a facet that is not flat as a whole
    is parted again with a tenth of the tolerance.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    size = np.diff(starts)
    count = len(size)
    owner = np.repeat(np.arange(count), size)
    following = np.arange(1, len(corners) + 1)
    following[starts[1:] - 1] = starts[:-1]
    ends = np.sort(np.stack([position[corners], position[corners[following]]], axis=1), axis=1)
    order = np.lexsort((thing[owner], ends[:, 1], ends[:, 0]))
    ends, polygon = ends[order], owner[order]
    start_vertex = corners[order]
    length = np.linalg.norm(vertices[start_vertex] - vertices[corners[following][order]], axis=1)

    # Closed objects: within the object, each edge an even number of times.
    new = np.ones(len(ends), bool)
    new[1:] = (ends[1:] != ends[:-1]).any(axis=1) | (thing[polygon[1:]] != thing[polygon[:-1]])
    run = np.cumsum(new) - 1
    times = np.bincount(run)
    closed = np.bincount(thing[polygon[new]], times % 2, n_objects) == 0

    # Pairs of polygons of one object at one edge.
    area = np.linalg.norm(area_vector, axis=1)
    n = area_vector / area[:, None]
    left, right, edge = [], [], []
    for step in range(1, times.max() if len(times) else 1):
        i = np.flatnonzero(run[step:] == run[:-step])
        if len(i) == 0:
            break
        left.append(polygon[i]), right.append(polygon[i + step]), edge.append(length[i])
    if left:
        left, right, edge = np.concatenate(left), np.concatenate(right), np.concatenate(edge)
        same = (material[left] == material[right]) & (left != right) & (np.einsum("ij,ij->i", n[left], n[right]) > 0.99)
        left, right, edge = left[same], right[same], edge[same]
        sine = np.linalg.norm(np.cross(n[left], n[right]), axis=1)
        width = np.stack([area[left], area[right]]) / edge
        bend = np.where(sine < 0.05, sine * width.min(axis=0) / width.max(axis=0), np.inf)
    else:
        left = right = np.zeros(0, int)
        bend = np.zeros(0)

    tolerance = np.full(count, FLAT)
    while True:
        join = bend <= np.minimum(tolerance[left], tolerance[right])
        graph = coo_matrix((np.ones(join.sum(), bool), (left[join], right[join])), shape=(count, count))
        n_facets, facet = connected_components(graph, directed=False)
        total = np.stack([np.bincount(facet, area_vector[:, k], n_facets) for k in range(3)], axis=1)
        total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
        of_corner = facet[owner]
        origin = np.zeros((n_facets, 3))
        origin[of_corner[::-1]] = vertices[corners[::-1]]
        p = vertices[corners] - origin[of_corner]
        height = np.einsum("ij,ij->i", p, total[of_corner])
        low, high = np.full((n_facets, 4), np.inf), np.full((n_facets, 4), -np.inf)
        np.minimum.at(low, of_corner, np.column_stack([p, height]))
        np.maximum.at(high, of_corner, np.column_stack([p, height]))
        extent = high - low
        bent = extent[:, 3] > FLAT * np.linalg.norm(extent[:, :3], axis=1)
        steep = np.einsum("ij,ij->i", n, total[facet]) < 0.998
        bent[facet[steep]] = True
        bent &= np.bincount(facet, minlength=n_facets) > 1
        if not bent.any():
            return facet, closed
        again = bent[facet]
        tolerance[again] = np.where(tolerance[again] > 1e-12, tolerance[again] / 10, -1.0)
