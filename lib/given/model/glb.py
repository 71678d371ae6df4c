"""Binary glTF 2.

Our own reader, not trimesh's (5.2).  To import trimesh takes 0.6 CPU s more than NumPy; the stage `index` draws in 0.3.
And it loses facts that a model must keep.  A node of two primitives becomes two objects with random names, so that
objects and facets differ from run to run.  Nodes lose their order.  Materials without a name cannot be told apart.  A
triangle fan is dropped silently.  A truncated file is a bare AssertionError, and an index out of range is not noticed.
"""

import struct
from typing import NamedTuple

import numpy as np

from lib.core.stage import BadInput
from lib.given import gltf_file
from lib.given.formats import Format, LeftOut
from lib.given.model.polygons import Polygons

FORMAT = Format(
    "glTF 2 (.glb, .gltf)",
    read=(
        "nodes of the file's scene: transforms, mirrored ones too, and instances (EXT_mesh_gpu_instancing)",
        "triangles, strips, fans; positions as floats or integers (KHR_mesh_quantization), normalized, sparse",
        "skins in the pose of their joints' nodes, morph targets at the file's weights",
        "materials as groups, materials of one name told apart; emissiveFactor tells lamps",
        "buffers in the file, as data: addresses, or in files beside it (new-scene packs them)",
    ),
    refused=(
        ("glTF 1", "export it as glTF 2.0"),
        ("Draco and meshopt compression", gltf_file.UNPACK),
        ("any other extension that the file requires", "export it without, or through Blender"),
        ("a primitive without material", "give it one"),
    ),
    left_out=(
        "nodes hidden by KHR_node_visibility, nodes outside the scene",
        "lights without faces (KHR_lights_punctual), cameras, points and lines, animations",
        "pictures and colours of materials, material variants, extensions that are not required",
    ),
)
KIND = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of a primitive; those below are points and lines
REMAINDER = "_REMAINDER"  # our own attribute: what single precision leaves of a position
MOST_INSTANCES = 65_535  # of a node: as many objects as object.png can tell apart
MOST_PLACED = 10_000_000  # vertices of all nodes, where the file has fewer bytes: instances cost it nothing


class Mesh(NamedTuple):
    """One primitive of one node, in the file's frame."""

    points: np.ndarray  # (V, 3) m
    triangles: np.ndarray  # (T, 3) int
    object: str
    group: str


class Placed(NamedTuple):
    """A node of the scene."""

    index: int
    T_world_node: np.ndarray  # (4, 4)
    shown: bool  # neither it nor a node above it is hidden


def read_glb(path, content, bare=None) -> Polygons:
    """Binary glTF 2: the triangles of the nodes of its scene, in the file's frame (node transforms applied).

    path : for messages        content : the file's bytes
    bare : group of primitives without material; None: such are refused
    """
    try:
        gltf, binary, spare = gltf_file.of_glb(path, content)
        gltf_file.check(path, gltf)
        reader = _Reader(path, gltf, binary, bare)
        reader.left.add("spare byte", spare)
        order = (gltf.get("extras") or {}) if gltf_file.own(gltf) else {}
        polygons = _polygons(path, list(reader.meshes()), order)
        return polygons._replace(notes=(*map(str, order.get("notes", ())), *reader.notes()))
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
    """The JSON chunk, and the buffers that it points into; what is left out is counted on the way."""

    def __init__(self, path, gltf, binary, bare):
        self.path, self.gltf, self.bare = path, gltf, bare
        self.buffers = gltf_file.buffers(path, gltf, binary)
        self.groups = gltf_file.groups(gltf)
        self.count, self.most = 0, max(MOST_PLACED, len(binary))
        self.left, self.lights, self.said, self.used = LeftOut(), [], [], set()

    # ---- what is said ----

    def say(self, line):
        if line not in self.said:
            self.said.append(line)

    def notes(self):
        """What is not read, and what was made of what is: when all meshes have been read."""
        names = [gltf_file.written(m.get("name")) for m in self.gltf.get("materials") or ()]
        apart = [self.groups[k] for k in sorted(self.used) if self.groups[k] != names[k] and names[k] in self.groups]
        if apart:
            self.say(f"materials of one name are groups of their own: {_listed(apart)}")
        if clear := [name for name in gltf_file.clear(self.gltf) if name in {self.groups[k] for k in self.used}]:
            self.say(f"materials that let light through are taken for opaque ones: {_listed(clear)}")
        if self.lights:
            self.say(f"lights without faces are left out, draw them: {_listed(self.lights)}")
        self.left.add("animation", len(self.gltf.get("animations") or ()))
        variants = (self.gltf.get("extensions") or {}).get("KHR_materials_variants") or {}
        self.left.add("material variant", len(variants.get("variants") or ()))
        for name in gltf_file.not_understood(self.gltf):
            self.left.add(f"extension {name:.80}", 1)
        return [*self.said, *([self.left.line()] if self.left.line() else [])]

    # ---- nodes ----

    def meshes(self):
        """Every primitive of triangles, node by node."""
        placed = list(self.placed_nodes())
        world = {node.index: node.T_world_node for node in placed}
        nodes = self.gltf.get("nodes", [])
        self.left.add("hidden node", sum("mesh" in nodes[p.index] and not p.shown for p in placed))
        outside = set(range(len(nodes))) - set(world)
        self.left.add("unplaced node", sum("mesh" in nodes[i] for i in outside))
        shown = [p for p in placed if p.shown and self.counted(nodes[p.index])]
        things = [(p.index, T) for p in shown for T in self.instances(nodes[p.index], p.T_world_node)]
        names = self.names([self.name(i) for i, _ in things])
        for (i, T_world_node), name in zip(things, names, strict=True):
            yield from self.of_node(nodes[i], name, T_world_node, world)

    def counted(self, node):
        """Whether it has a mesh; counts what else it has."""
        self.left.add("camera", "camera" in node)
        light = (node.get("extensions") or {}).get(gltf_file.LIGHTS)
        if light is not None:
            told = self.gltf.get("extensions", {}).get(gltf_file.LIGHTS, {}).get("lights", [])[light["light"]]
            self.lights.append(gltf_file.written(node.get("name") or told.get("name") or told.get("type") or "light"))
        return "mesh" in node

    def name(self, index):
        node = self.gltf["nodes"][index]
        mesh = self.gltf["meshes"][node["mesh"]]
        return gltf_file.written(node.get("name")) or gltf_file.written(mesh.get("name")) or f"node {index}"

    def names(self, names):
        """No two alike, but in a file of our own, where nodes of one name are one object."""
        if gltf_file.own(self.gltf):
            return names
        made = gltf_file.apart(names)
        if apart := [new for new, old in zip(made, names, strict=True) if new != old]:
            self.say(f"nodes of one name, and instances, are objects of their own: {_listed(apart)}")
        return made

    def placed_nodes(self):
        """Yields all nodes of the scene, parents first, in the file's order."""
        nodes = self.gltf.get("nodes", [])
        waiting, seen = [(i, np.eye(4), True) for i in reversed(self.roots(nodes))], set()
        while waiting:
            i, T_world_parent, shown = waiting.pop()
            if i in seen:
                raise BadInput(f"{self.path}: nodes: node {i} is reached twice: the nodes are not a tree")
            seen.add(i)
            visibility = (nodes[i].get("extensions") or {}).get(gltf_file.VISIBILITY) or {}
            shown = shown and visibility.get("visible", True) is not False
            T_world_node = T_world_parent @ _local(nodes[i])
            waiting += [(child, T_world_node, shown) for child in reversed(nodes[i].get("children", ()))]
            yield Placed(i, T_world_node, shown)

    def roots(self, nodes):
        """The scene's own nodes; without a scene, those that are nobody's children."""
        scenes = self.gltf.get("scenes")
        if not scenes:
            return sorted(set(range(len(nodes))) - {child for node in nodes for child in node.get("children", ())})
        k = self.gltf.get("scene", 0)
        if len(scenes) > 1:
            self.say(
                f"it has {len(scenes)} scenes, of which '{gltf_file.written(scenes[k].get('name') or k):.80}' is read"
            )
        return scenes[k].get("nodes", [])

    def instances(self, node, T_world_node):
        """T_world_node of each: of one, or of those that an extension lists."""
        told = (node.get("extensions") or {}).get(gltf_file.INSTANCING)
        if told is None:
            return [T_world_node]
        known = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        given = {known[k]: self.accessor(a) for k, a in told["attributes"].items() if k in known}
        counts = {len(values) for values in given.values()}
        if len(counts) != 1:
            raise BadInput(f"{self.path}: node '{node.get('name')}': {gltf_file.INSTANCING}: attributes of {counts}")
        (count,) = counts
        if count > MOST_INSTANCES:
            raise BadInput(f"{self.path}: node '{node.get('name')}': {count} instances: at most {MOST_INSTANCES}")
        if "rotation" in given:  # of integers: not quite of length 1
            given["rotation"] = given["rotation"] / np.linalg.norm(given["rotation"], axis=1, keepdims=True)
        return [T_world_node @ _local({key: a[k] for key, a in given.items()}) for k in range(count)]

    def room(self, more):
        """BadInput: so many more vertices are too many."""
        self.count += more
        if self.count > self.most:
            raise BadInput(f"{self.path}: nodes: more than {self.most} vertices: fewer instances, or simpler ones")

    # ---- meshes ----

    def of_node(self, node, thing, T_world_node, world):
        mesh = self.gltf["meshes"][node["mesh"]]
        weights = node.get("weights") or mesh.get("weights") or ()
        joints = self.joints(self.gltf["skins"][node["skin"]], world) if "skin" in node else None
        for k, primitive in enumerate(mesh["primitives"]):
            mode, where = primitive.get("mode", TRIANGLES), f"{self.path}: node '{thing}', primitive {k}"
            if mode > FAN or mode < 0:
                raise BadInput(f"{where}: mode: {mode} is not known")
            if mode < TRIANGLES:
                self.left.add("point or line primitive")
            else:
                yield self.mesh(primitive, thing, T_world_node, where, weights, joints)

    def mesh(self, primitive, thing, T_world_node, where, weights=(), joints=None):
        """A primitive in the world; where : for messages."""
        if "material" not in primitive and self.bare is None:
            raise BadInput(f"{where}: has no material: give it one")
        group = self.bare
        if "material" in primitive:
            group = self.groups[primitive["material"]]
            self.used.add(primitive["material"])
        p = self.positions(primitive, weights)
        bad = np.argwhere(~np.isfinite(p))
        if len(bad):
            v, axis = bad[0]
            raise BadInput(f"{where}: vertex {v}: {'xyz'[axis]} = {p[v, axis]} is not finite")
        index = self.accessor(primitive["indices"])[:, 0].astype(int) if "indices" in primitive else np.arange(len(p))
        if len(index) and not 0 <= index.min() <= index.max() < len(p):
            wrong = index.max() if index.max() >= len(p) else index.min()
            raise BadInput(f"{where}: face index {wrong} is out of range (0 to {len(p) - 1})")
        triangles = _triangles(primitive.get("mode", TRIANGLES), index)
        if joints is None:
            p, det = p @ T_world_node[:3, :3].T + T_world_node[:3, 3], np.linalg.det(T_world_node[:3, :3])
        else:
            p, det = self.skinned(primitive, p, joints)
        if det < 0:  # mirrored: the front stays the front
            triangles = triangles[:, ::-1]
        return Mesh(p, triangles, thing, group)

    def positions(self, primitive, weights):
        """(V, 3) in the mesh's own frame, with its morph targets at their weights."""
        attributes = primitive["attributes"]
        p = self.accessor(attributes["POSITION"]).astype(float)
        if p.shape[1] != 3:
            raise BadInput(f"{self.path}: accessor {attributes['POSITION']}: type: a position is a VEC3")
        self.room(len(p))
        if REMAINDER in attributes:
            p = p + self.accessor(attributes[REMAINDER])
        targets = primitive.get("targets") or ()
        for weight, target in zip(weights, targets, strict=False):
            if weight and "POSITION" in target:
                p = p + float(weight) * self.accessor(target["POSITION"])
        if targets:
            self.say("morph targets stand at the file's weights")
        return p

    def joints(self, skin, world):
        """(J, 4, 4): from the mesh's own frame to the world, for each joint as its node stands."""
        count = len(skin["joints"])
        inverse = np.tile(np.eye(4), (count, 1, 1))
        if "inverseBindMatrices" in skin:
            told = self.accessor(skin["inverseBindMatrices"]).astype(float)
            inverse = told.reshape(-1, 4, 4).transpose(0, 2, 1)[:count]
        self.say("meshes with a skin stand in the pose of their joints' nodes")
        return np.stack([world[joint] for joint in skin["joints"]]) @ inverse

    def skinned(self, primitive, p, joints):
        """(p in the world (V, 3), the determinant of their middle transform)."""
        T = np.zeros((len(p), 4, 4))
        total = np.zeros(len(p))
        for k in range(len(primitive["attributes"])):
            if f"JOINTS_{k}" not in primitive["attributes"]:
                break
            which = self.accessor(primitive["attributes"][f"JOINTS_{k}"]).astype(int)
            weight = self.accessor(primitive["attributes"][f"WEIGHTS_{k}"]).astype(float)
            total += weight.sum(axis=1)
            for corner in range(which.shape[1]):
                T += weight[:, corner, None, None] * joints[which[:, corner]]
        if not (total > 0).all():
            raise BadInput(f"{self.path}: skin: {np.count_nonzero(~(total > 0))} vertices have no weight")
        T /= total[:, None, None]
        moved = np.einsum("vij,vj->vi", T[:, :3, :3], p) + T[:, :3, 3]
        return moved, float(np.median(np.linalg.det(T[:, :3, :3]))) if len(p) else 1.0

    # ---- numbers ----

    def accessor(self, index):
        """(count, width) of an accessor's type; normalized integers as floats of 0 to 1 or -1 to 1."""
        a = self.gltf["accessors"][index]
        kind, width, count = np.dtype(KIND[a["componentType"]]), WIDTH[a["type"]], a["count"]
        sparse = a.get("sparse")
        if "bufferView" in a:
            values = self.array(index, a["bufferView"], a.get("byteOffset", 0), kind, width, count)
        elif sparse:
            if count > self.most:
                raise BadInput(f"{self.path}: accessor {index}: count: {count} of a file of {self.most} bytes")
            values = np.zeros((count, width), kind)
        else:
            raise BadInput(f"{self.path}: accessor {index}: has no data, or compressed data: {gltf_file.UNPACK}")
        if sparse:
            told, new = sparse["indices"], sparse["values"]
            of = np.dtype(KIND[told["componentType"]])
            where = self.array(index, told["bufferView"], told.get("byteOffset", 0), of, 1, sparse["count"])[:, 0]
            values[where] = self.array(index, new["bufferView"], new.get("byteOffset", 0), kind, width, sparse["count"])
        if a.get("normalized") and kind.kind in "iu":
            return np.maximum(values / np.iinfo(kind).max, -1.0)
        return values

    def array(self, index, view, offset, kind, width, count):
        """(count, width) of a buffer view; index : of the accessor, for messages."""
        view = self.gltf["bufferViews"][view]
        data = self.buffers[view.get("buffer", 0)]
        size = kind.itemsize * width
        start, stride = view.get("byteOffset", 0) + offset, view.get("byteStride", size)
        if stride < size:
            raise BadInput(f"{self.path}: accessor {index}: byteStride: {stride} is less than a value's bytes")
        end, there = start + stride * (count - 1) + size, len(data)
        if "byteLength" in view:
            there = min(there, view.get("byteOffset", 0) + view["byteLength"])
        if count and end > there:
            raise BadInput(f"{self.path}: accessor {index}: truncated: {end} bytes are needed, {there} are there")
        return np.ndarray((count, width), kind, data, start, (stride, kind.itemsize)).copy()


def _listed(names, most=5):
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(f"{name:.80}" for name in names[:most]) + more


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
