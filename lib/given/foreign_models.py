"""Models in other formats, made what a scene's folder may hold: OBJ and GLB stay as they are, glTF becomes one GLB,
PLY and STL an OBJ of one group, shapes of a Mitsuba scene and meshes of USD an OBJ with a group for each material.
"""

from __future__ import annotations

import base64
import json
import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import strangers_files, usd_models
from lib.given.cameras import matrix_from_rt
from lib.given.model.obj import read_obj

ONE_GROUP = "surface"
SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
CUBE_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def convert(path) -> tuple[dict, list]:
    """({name in the scene's folder: content}, lines to say).  BadInput: a format that is not read, a damaged file."""
    path = Path(path)
    content = bounded.content(path)
    kind = strangers_files.kind_of(content)
    if kind == "a GLB file":
        return {"model.glb": content}, []
    if kind == "a glTF file":
        return {"model.glb": _packed(path, content)}, ["glTF and its buffers were packed into model.glb"]
    if kind in ("a PLY file", "an STL file"):
        text = _of_trimesh(path, kind)
        return {"model.obj": text}, [f"{kind} has no materials: everything is one group, {ONE_GROUP}"]
    if kind == "a Mitsuba scene":
        return {"model.obj": _Mitsuba(path, content).obj()}, []
    if kind == "a USD file" or path.suffix.lower() == ".usdz":
        parts, emits, said = usd_models.read(path)
        lamps = "".join(f"newmtl {group}\nKe 1 1 1\n" for group in emits)
        return {"model.obj": b"mtllib model.mtl\n" + _obj(parts), "model.mtl": lamps.encode()}, said
    if kind:
        raise BadInput(f"{path}: is {kind}: {strangers_files.way_out(kind)}")
    files, said = {"model.obj": content}, []
    for name in _libraries(content):
        beside = path.parent / name
        if beside.parent != path.parent or name in ("", ".", ".."):
            said.append(f"mtllib {name:.80} lies outside the model's folder and is ignored")
        elif beside.is_file() and name not in files:
            files[name] = bounded.content(beside, bounded.LARGEST_TEXT)
    return files, said


def _libraries(content):
    """Names of the .mtl files of an OBJ; what lies elsewhere is not needed."""
    rows = [line.split(None, 1) for line in content.decode("utf-8", "replace").splitlines()]
    return list(dict.fromkeys(row[1].strip() for row in rows if len(row) == 2 and row[0] == "mtllib"))


def emitters(files) -> list[str]:
    """Groups whose material says that it emits: Ke of an .mtl, emissiveFactor of a GLB."""
    found = []
    for name, content in files.items():
        if name.endswith(".mtl"):
            group = None
            for line in content.decode("utf-8", "replace").splitlines():
                word, _, rest = line.strip().partition(" ")
                if word == "newmtl":
                    group = rest.strip()
                elif word == "Ke" and any(float(v) > 0 for v in rest.split()[:3] if _number(v)):
                    found.append(group)
        elif name.endswith(".glb"):
            try:
                length = int.from_bytes(content[12:16], "little")
                for material in bounded.json_of(name, content[20 : 20 + length]).get("materials", []):
                    if any(material.get("emissiveFactor", [])):
                        found.append(material.get("name"))
            except (BadInput, AttributeError, TypeError):
                pass
    return [name for name in dict.fromkeys(found) if name]


def _number(text):
    try:
        return np.isfinite(float(text))
    except ValueError:
        return False


# ---- glTF ----


def _packed(path, content):
    """A GLB of a .gltf and its buffers, which lie beside it or in it."""
    try:
        gltf = bounded.json_of(path, content)
        binary, starts = bytearray(), []
        for buffer in gltf.get("buffers", []):
            starts.append(len(binary))
            uri = buffer.pop("uri")
            inline = uri.startswith("data:")
            data = base64.b64decode(uri.partition(",")[2]) if inline else bounded.content(_beside(path, uri))
            binary += data[: buffer["byteLength"]] + bytes(-buffer["byteLength"] % 4)
        for view in gltf.get("bufferViews", []):
            view["byteOffset"] = view.get("byteOffset", 0) + starts[view.get("buffer", 0)]
            view["buffer"] = 0
        gltf["buffers"] = [{"byteLength": len(binary)}]
        for key in ("images", "textures"):  # pictures are not read, and may lie elsewhere
            gltf.pop(key, None)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError) as error:
        raise BadInput(f"{path}: not readable glTF: {type(error).__name__}: {error}") from None
    words = json.dumps(gltf).encode()
    parts = [(b"JSON", words + b" " * (-len(words) % 4)), (b"BIN\0", bytes(binary))]
    body = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in parts)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def _beside(path, name):
    """The path of a file that a model names. BadInput: it lies outside the model's folder."""
    if bounded.lies_outside(name):
        raise BadInput(f"{path}: {name:.80} lies outside the model's folder")
    return path.parent / name


# ---- PLY, STL, and what Mitsuba names ----


def _of_trimesh(path, kind):
    points, faces = _mesh(path, "ply" if kind == "a PLY file" else "stl")
    return _obj([(ONE_GROUP, ONE_GROUP, points, faces)])


def _mesh(path, kind):
    import trimesh

    try:
        mesh = trimesh.load(str(path), file_type=kind, force="mesh", process=False)
        points, faces = np.array(mesh.vertices, float).reshape(-1, 3), np.array(mesh.faces, int).reshape(-1, 3)
    except Exception as error:  # whatever the package raises
        raise BadInput(f"{path}: not readable: {type(error).__name__}: {error}") from None
    if not len(faces):
        raise BadInput(f"{path}: has no faces")
    if faces.min() < 0 or faces.max() >= len(points):
        wrong = faces[(faces < 0) | (faces >= len(points))][0]
        raise BadInput(f"{path}: face index {wrong} is out of range (0 to {len(points) - 1})")
    if not np.isfinite(points).all():
        raise BadInput(f"{path}: vertex {np.argwhere(~np.isfinite(points))[0][0]} is not finite")
    used, index = np.unique(points, axis=0, return_inverse=True)  # STL repeats each corner
    return used, index.reshape(-1)[faces]


def _obj(parts) -> bytes:
    """parts : [(object, group, points (V, 3), faces)]"""
    lines, count = ["# written by make new-scene"], 0
    for thing, group, points, faces in parts:
        lines += [f"o {thing}", f"usemtl {group}"]
        lines += ["v " + " ".join(repr(float(x)) for x in p) for p in points]
        lines += ["f " + " ".join(str(count + int(k) + 1) for k in face) for face in faces]
        count += len(points)
    return ("\n".join(lines) + "\n").encode()


class _Mitsuba:
    """Shapes of a Mitsuba 3 scene: rectangle, cube, obj, ply, stl; the group is the id of the material."""

    def __init__(self, path, content):
        self.path = path
        try:
            self.root = ElementTree.fromstring(content)
        except ElementTree.ParseError as error:
            raise BadInput(f"{path}: not readable XML: {error}") from None

    def obj(self) -> bytes:
        parts, left = [], []
        for number, shape in enumerate(self.root.iter("shape")):
            name = shape.get("id") or f"shape{number}"
            made = self.shape(shape)
            if made is None:
                left.append(f"{name} ({shape.get('type')})")
                continue
            T = self.transform(shape)
            points = made[0] @ T[:3, :3].T + T[:3, 3]
            flipped = np.linalg.det(T[:3, :3]) < 0
            faces = [tuple(face)[::-1] if flipped else tuple(face) for face in made[1]]
            parts.append((name.replace(" ", "_"), self.group(shape, name).replace(" ", "_"), points, faces))
        if left:
            known = "rectangle, cube, obj, ply, stl"
            raise BadInput(f"{self.path}: shapes that are not read: {', '.join(left[:5])}; read are {known}")
        if not parts:
            raise BadInput(f"{self.path}: has no shape")
        return _obj(parts)

    def group(self, shape, name):
        """A lamp is a group of its own; else the material that the shape names."""
        if shape.find("emitter") is not None:
            return f"lamp-{name}"
        for child in (*shape.findall("ref"), *shape.findall("bsdf")):
            if child.get("name") in (None, "bsdf") and child.get("id"):
                return child.get("id")
        return name

    def shape(self, shape):
        """(points (V, 3), faces), None for a kind that is not read."""
        kind = shape.get("type")
        if kind == "rectangle":
            return SQUARE, [(0, 1, 2, 3)]
        if kind == "cube":
            return CUBE, CUBE_FACES
        if kind in ("ply", "stl", "obj"):
            name = next((s.get("value") for s in shape.findall("string") if s.get("name") == "filename"), None)
            file = _beside(self.path, name or "")
            if not file.is_file():
                raise BadInput(f"{self.path}: shape {shape.get('id')}: {file}: there is no such file")
            if kind != "obj":
                return _mesh(file, kind)
            lines = bounded.content(file).splitlines()
            content = b"usemtl x\n" + b"\n".join(x for x in lines if not x.lstrip().startswith(b"usemtl"))
            polygons = read_obj(str(file), content)
            return polygons.vertices, np.split(polygons.corners, polygons.starts[1:-1])
        return None

    def transform(self, shape):
        """(4, 4): the steps of to_world, each after the ones before it."""
        T = np.eye(4)
        for step in shape.findall("transform/*"):
            T = self.step(step) @ T
        return T

    def step(self, step):
        S = np.eye(4)
        three = lambda key: np.array([float(v) for v in step.get(key).replace(",", " ").split()])
        axes = lambda default: np.array([float(step.get(a, default)) for a in "xyz"])
        try:
            if step.tag == "matrix":
                S = three("value").reshape(4, 4)
            elif step.tag == "translate":
                S[:3, 3] = three("value") if step.get("value") else axes(0)
            elif step.tag == "scale":
                S[:3, :3] = np.diag(three("value") * np.ones(3) if step.get("value") else axes(1))
            elif step.tag == "rotate":
                axis = three("value") if step.get("value") else axes(0)
                angle = np.radians(float(step.get("angle")))
                S = matrix_from_rt(np.concatenate([angle * axis / np.linalg.norm(axis), np.zeros(3)]))
            elif step.tag == "lookat":
                origin, target, up = three("origin"), three("target"), three("up")
                z = (target - origin) / np.linalg.norm(target - origin)
                x = np.cross(up, z) / np.linalg.norm(np.cross(up, z))
                S[:3, :4] = np.column_stack([x, np.cross(z, x), z, origin])
            else:
                raise ValueError(f"{step.tag} is not known")
        except (ValueError, AttributeError, TypeError) as error:
            raise BadInput(f"{self.path}: transform: {step.tag}: {error}") from None
        return S
