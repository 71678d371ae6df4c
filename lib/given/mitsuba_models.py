"""Shapes of a Mitsuba 3 scene as an OBJ with a group for each material."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given.cameras import matrix_from_rt
from lib.given.mesh_files import beside, mesh
from lib.given.mesh_files import obj as obj_text
from lib.given.model.obj import read_obj

SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
CUBE_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


class Mitsuba:
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
        return obj_text(parts)

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
            file = beside(self.path, name or "")
            if not file.is_file():
                raise BadInput(f"{self.path}: shape {shape.get('id')}: {file}: there is no such file")
            if kind != "obj":
                return mesh(file, kind)
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
