"""Binary glTF 2.

Our own reader, not trimesh's (5.2).  To import trimesh takes 0.6 CPU s more than NumPy; the stage `index` draws in 0.3.
And it loses facts that a model must keep.  A node of two primitives becomes two objects with random names, so that
objects and facets differ from run to run.  Nodes lose their order.  Materials without a name cannot be told apart.  A
triangle fan is dropped silently.  A truncated file is a bare AssertionError, and an index out of range is not noticed.
"""

import struct
from typing import NamedTuple

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given.model.polygons import Polygons

KIND = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TRIANGLES, STRIP = 4, 5  # modes of a primitive; those below are points and lines, those above fans
REMAINDER = "_REMAINDER"  # our own attribute: what single precision leaves of a position


class Mesh(NamedTuple):
    """One primitive of one node, in the file's frame."""

    points: np.ndarray  # (V, 3) m
    triangles: np.ndarray  # (T, 3) int
    object: str
    group: str


def read_glb(path, content, bare=None) -> Polygons:
    """Binary glTF 2: the triangles of the nodes of its scene, in the file's frame (node transforms applied).

    path : for messages        content : the file's bytes
    bare : group of primitives without material; None: such are refused
    """
    try:
        magic, version, total = struct.unpack_from("<4sII", content)
        if version != 2:
            raise BadInput(f"{path}: version: glTF {version} instead of 2")
        if total > len(content):
            raise BadInput(f"{path}: truncated: {total} bytes are announced, {len(content)} are there")
        chunks, at = {}, 12
        while at + 8 <= total:
            length, kind = struct.unpack_from("<I4s", content, at)
            chunks.setdefault(kind, content[at + 8 : at + 8 + length])
            at += 8 + length
        gltf = bounded.json_of(path, chunks[b"JSON"])
        if not isinstance(gltf, dict):
            raise TypeError("the JSON is no table")
        reader = _Reader(path, gltf, chunks.get(b"BIN\0", b""), bare)
        return _polygons(path, list(reader.meshes()), reader.gltf.get("extras") or {})
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, struct.error) as error:
        raise BadInput(f"{path}: not a readable GLB: {type(error).__name__}: {error}") from None


def _polygons(path, meshes, order):
    """All meshes in one list of triangles.

    order : {"objects", "groups": names in their order, "absent": facets}, where a file tells
    """
    known = lambda key: {name: k for k, name in enumerate(dict.fromkeys(map(str, order.get(key, ()))))}
    objects, groups = known("objects"), known("groups")
    count = 0
    vertices, triangles = [np.zeros((0, 3))], [np.zeros((0, 3), int)]
    owner, group = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
    for mesh in meshes:
        vertices.append(mesh.points)
        triangles.append(mesh.triangles + count)
        count += len(mesh.points)
        if len(mesh.triangles):
            owner.append(np.full(len(mesh.triangles), objects.setdefault(mesh.object, len(objects)), np.int32))
            group.append(np.full(len(mesh.triangles), groups.setdefault(mesh.group, len(groups)), np.int32))
    p = np.concatenate(vertices)
    if not np.isfinite(p).all():
        raise BadInput(f"{path}: nodes: a transform is not finite")
    corners = np.concatenate(triangles).ravel()
    starts = np.arange(0, len(corners) + 1, 3)
    absent = tuple((int(n), int(o), int(g)) for n, o, g in order.get("absent", ()))
    if any(not (0 <= o < len(objects) and 0 <= g < len(groups)) for _, o, g in absent):
        raise BadInput(f"{path}: extras.absent: a facet of no object or group")
    parts = np.concatenate(owner), np.concatenate(group), list(objects), list(groups)
    return Polygons(p, corners, starts, *parts, absent)


class _Reader:
    """The JSON chunk, and the binary one that it points into."""

    def __init__(self, path, gltf, binary, bare):
        self.path, self.gltf, self.binary, self.bare = path, gltf, binary, bare

    def meshes(self):
        """Every primitive of triangles, node by node."""
        for i, T_world_node in self.placed_nodes():
            node = self.gltf["nodes"][i]
            if "mesh" not in node:
                continue
            mesh = self.gltf["meshes"][node["mesh"]]
            thing = str(node.get("name") or mesh.get("name") or f"node {i}")
            for k, primitive in enumerate(mesh["primitives"]):
                if primitive.get("mode", TRIANGLES) >= TRIANGLES:
                    yield self.mesh(primitive, thing, T_world_node, f"{self.path}: node '{thing}', primitive {k}")

    def placed_nodes(self):
        """Yields (index, T_world_node) of all nodes of the scene, parents first, in the file's order."""
        nodes = self.gltf.get("nodes", [])
        waiting, seen = [(i, np.eye(4)) for i in reversed(self.roots(nodes))], set()
        while waiting:
            i, T_world_parent = waiting.pop()
            if i in seen:
                raise BadInput(f"{self.path}: nodes: node {i} is reached twice: the nodes are not a tree")
            seen.add(i)
            T_world_node = T_world_parent @ _local(nodes[i])
            waiting += [(child, T_world_node) for child in reversed(nodes[i].get("children", ()))]
            yield i, T_world_node

    def roots(self, nodes):
        """The scene's own nodes; without a scene, those that are nobody's children."""
        if self.gltf.get("scenes"):
            return self.gltf["scenes"][self.gltf.get("scene", 0)].get("nodes", [])
        return sorted(set(range(len(nodes))) - {child for node in nodes for child in node.get("children", ())})

    def mesh(self, primitive, thing, T_world_node, where):
        """A primitive in the world; where : for messages."""
        if "material" not in primitive and self.bare is None:
            raise BadInput(f"{where}: has no material")
        p = self.accessor(primitive["attributes"]["POSITION"]).astype(float)
        if REMAINDER in primitive["attributes"]:
            p = p + self.accessor(primitive["attributes"][REMAINDER])
        bad = np.argwhere(~np.isfinite(p))
        if len(bad):
            v, axis = bad[0]
            raise BadInput(f"{where}: vertex {v}: {'xyz'[axis]} = {p[v, axis]} is not finite")
        index = self.accessor(primitive["indices"])[:, 0].astype(int) if "indices" in primitive else np.arange(len(p))
        if len(index) and index.max() >= len(p):
            raise BadInput(f"{where}: face index {index.max()} is out of range (0 to {len(p) - 1})")
        triangles = _triangles(primitive.get("mode", TRIANGLES), index)
        if np.linalg.det(T_world_node[:3, :3]) < 0:  # mirrored: the front stays the front
            triangles = triangles[:, ::-1]
        group = self.bare
        if "material" in primitive:
            material = self.gltf["materials"][primitive["material"]]
            group = str(material.get("name") or f"material {primitive['material']}")
        return Mesh(p @ T_world_node[:3, :3].T + T_world_node[:3, 3], triangles, thing, group)

    def accessor(self, index):
        """(count, width) of an accessor's type."""
        a = self.gltf["accessors"][index]
        if "sparse" in a or "bufferView" not in a:
            raise BadInput(f"{self.path}: accessor {index}: sparse or compressed data is not supported")
        view = self.gltf["bufferViews"][a["bufferView"]]
        if view.get("buffer", 0) != 0 or "uri" in self.gltf["buffers"][0]:
            raise BadInput(f"{self.path}: accessor {index}: data outside the file is not supported")
        kind, width = np.dtype(KIND[a["componentType"]]), WIDTH[a["type"]]
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * width)
        if stride < kind.itemsize * width:
            raise BadInput(f"{self.path}: accessor {index}: byteStride: {stride} is less than a value's bytes")
        end = start + stride * (a["count"] - 1) + kind.itemsize * width
        if a["count"] and end > len(self.binary):
            there = len(self.binary)
            raise BadInput(f"{self.path}: accessor {index}: truncated: {end} bytes are needed, {there} are there")
        return np.ndarray((a["count"], width), kind, self.binary, start, (stride, kind.itemsize)).copy()


def _local(node):
    """(4, 4) T_parent_node."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    T = np.eye(4)
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, :3] *= node.get("scale", (1, 1, 1))
    T[:3, 3] = node.get("translation", (0, 0, 0))
    return T


def _triangles(mode, index):
    """(T, 3) of a primitive's indices."""
    if mode == TRIANGLES:
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    if mode == STRIP:  # every other one turned
        triangles = np.stack([index[:-2], index[1:-1], index[2:]], 1)
        triangles[1::2] = triangles[1::2][:, [1, 0, 2]]
        return triangles
    return np.stack([np.full(max(len(index) - 2, 0), index[0]), index[1:-1], index[2:]], 1)  # a fan
