"""Shapes of a Mitsuba scene as meshes with a group for each material; facets look where Mitsuba's normals do."""

from __future__ import annotations

from collections import Counter

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import round_shapes
from lib.given.formats import Format, LeftOut
from lib.given.mesh_files import beside, mesh
from lib.given.mitsuba_xml import Scene
from lib.given.model.obj import read_obj
from lib.given.names import Names

FORMAT = Format(
    "Mitsuba (XML, versions 0.5 to 3)",
    read=(
        "rectangle, cube, obj, ply, stl; disk, sphere and cylinder as facets; merge, shapegroup and instance",
        "flip_normals, to_world, include (of the model's folder), default and $parameters, alias, ref",
        "area emitters: each is a lamp, a group of its own; a group is the outermost bsdf that has an id",
        "the first sensor, perspective or thinlens: it is the camera of the photograph where no other is given",
    ),
    refused=(
        ("a file outside the model's folder, or one that is not there", "put it beside the XML"),
        ("shapes of other kinds (serialized, hair, curves, sdfgrid ...)", "export them as PLY or OBJ"),
        ("parameters without a default, animations", "write their values into the file"),
        ("spheres and cylinders that are stretched, which Mitsuba does not stretch", "export them as PLY or OBJ"),
        ("a shape of several materials, which versions before 2 part by their names", "export a shape for each"),
    ),
    left_out=(
        "lights without faces: point, spot, directional, constant, envmap, sky",
        "shapes that nothing shows (bsdf null), media, further sensors, pictures of materials",
    ),
)
KNOWN = "rectangle, cube, disk, sphere, cylinder, obj, ply, stl"
FILES = ("obj", "ply", "stl")
ANALYTIC = ("disk", "cylinder")  # whose normals a mirroring does not turn round; those of all others it does
GROUPS = ("merge", "shapegroup")
CLEAR = ("dielectric", "thindielectric", "roughdielectric", "mask", "difftrans")  # let light through
MOST_CORNERS = 2_000_000  # of all faces, of small files;
CORNER_BYTES = 4  # and of large ones, so many bytes for each
MOST_SHAPES = 200_000
DEEPEST = 15  # instances in each other
STRETCH = 1e-4  # of two lengths that should be one


def read(path, content) -> tuple[list, dict, list]:
    """([(object, group, points (V, 3), faces)], {group: emits}, lines to say).  BadInput: see FORMAT"""
    return _Shapes(Scene(path, content)).all()


class _Shapes:
    def __init__(self, scene):
        self.scene, self.parts, self.emits, self.refused = scene, [], {}, []
        self.groups, self.objects, self.left = Names(), Names(), LeftOut()
        self.size, self.meshes, self.numbers = scene.size, {}, {}
        self.corners, self.visited, self.round, self.lights, self.clear = 0, 0, False, Counter(), {}

    def all(self):
        shapes = list(self.scene.root.iter("shape"))
        self.numbers = {id(shape): k for k, shape in enumerate(shapes)}
        used = {ref.get("id") for shape in shapes for ref in shape.findall("ref")}
        for element in self.scene.root:
            if element.tag == "shape":
                self.shape(element, np.eye(4), "", 0)
            elif element.tag in ("emitter", "luminaire") and element.get("id") not in used:
                self.lights[element.get("type", "emitter")] += 1
        if self.refused:
            named = ", ".join(self.refused[:5])
            self.scene.refuse(f"shapes that are not read: {named}; export them as PLY or OBJ; read are {KNOWN}")
        if not self.parts:
            self.scene.refuse("has no shape")
        said = [round_shapes.WORDS] if self.round else []
        said += self.groups.lines()
        if self.lights:
            named = ", ".join(f"{kind} ({count})" if count > 1 else kind for kind, count in self.lights.items())
            said.append(f"lights without faces are left out, draw them: {named:.200}")
        if self.clear:
            named = ", ".join(f"{group:.80}" for group in list(self.clear)[:5])
            said.append(f"materials that let light through are taken for opaque ones: {named}")
        self.left.add("material picture", sum(t.get("type") == "bitmap" for t in self.scene.root.iter("texture")))
        self.left.add("sensor after the first", max(0, len(self.scene.root.findall("sensor")) - 1))
        line = self.left.line()
        return self.parts, self.emits, said + ([line] if line else [])

    def shape(self, shape, T, prefix, depth):
        """Appends a shape, or those of a group; T : (4, 4) of the instance that it is in, prefix : its name."""
        self.visited += 1
        kind, name = shape.get("type"), shape.get("id") or shape.get("name") or f"shape{self.numbers[id(shape)]}"
        if self.visited > MOST_SHAPES or depth > DEEPEST:
            self.scene.refuse(f"shape {name:.80}: more than {MOST_SHAPES:,} shapes, or deeper than {DEEPEST}")
        if kind == "shapegroup" and depth == 0:
            return  # what is drawn are its instances
        if kind in GROUPS:
            for child in self.scene.named(shape, "shape"):
                self.shape(child, T, prefix, depth + 1)
        elif kind == "instance":
            for group in self.scene.named(shape, "shape"):
                self.shape(group, T @ self.scene.placed(shape), f"{prefix}{name}.", depth + 1)
        elif kind not in (*FILES, *MAKERS):
            self.refused.append(f"{name:.80} ({kind})")
        elif self.is_unseen(shape):
            self.left.add("shape that nothing shows (bsdf null)")
        else:
            self.add(shape, kind, prefix + name, T)

    def add(self, shape, kind, name, T):
        T = T @ self.scene.placed(shape)
        if kind in FILES:
            points, faces = self.of_file(shape, kind, name)
        else:
            points, faces, own = MAKERS[kind](self.scene, shape)
            self.round |= kind in ("disk", "sphere", "cylinder")
            if kind in ("sphere", "cylinder"):
                self.check_stretch(name, kind, T @ own)
            T = T @ own
        self.corners += sum(map(len, faces))
        most = max(MOST_CORNERS, self.size // CORNER_BYTES)
        if self.corners > most:
            self.scene.refuse(f"shape {name:.80}: all faces have more than {most:,} corners: make fewer instances")
        points = points @ T[:3, :3].T + T[:3, 3]
        turned = self.scene.flag(shape, "flip_normals")
        if kind in ANALYTIC and np.linalg.det(T[:3, :3]) < 0:
            turned = not turned
        faces = [tuple(face)[::-1] if turned else tuple(face) for face in faces]
        thing = self.objects(self.visited, name)
        self.parts.append((thing, self.group(shape, name), points, faces))

    def check_stretch(self, name, kind, T):
        lengths = np.linalg.norm(T[:3, : 3 if kind == "sphere" else 2], axis=0)
        if np.ptp(lengths) > STRETCH * lengths.max():
            self.scene.refuse(f"shape {name:.80}: to_world stretches a {kind}, which Mitsuba does not: export an OBJ")

    def is_unseen(self, shape):
        """Is it a border of a medium alone? A lamp is seen."""
        bsdfs = self.scene.named(shape, "bsdf")
        lit = self.scene.named(shape, "emitter") + self.scene.named(shape, "luminaire")
        return bool(bsdfs) and bsdfs[0].get("type") == "null" and not any(map(self.shines, lit))

    def group(self, shape, name):
        """A lamp is a group of its own; else the outermost material that has an id; else the shape."""
        for emitter in (*self.scene.named(shape, "emitter"), *self.scene.named(shape, "luminaire")):
            if self.shines(emitter):
                group = self.groups(("lamp", id(shape), name), f"lamp-{name}", f"lamp {name}")
                self.emits[group] = True
                return group
        bsdfs = self.scene.named(shape, "bsdf")
        if len(bsdfs) > 1:
            self.scene.refuse(f"shape {name:.80}: has {len(bsdfs)} materials (bsdf): export a shape for each of them")
        own = ("shape", id(shape)), shape.get("id") or shape.get("name") or name, f"shape {name}"
        key, clear = None, False
        while bsdfs:
            (bsdf, *_), clear = bsdfs, clear or bsdfs[0].get("type") in CLEAR
            if bsdf.get("id") and key is None:
                key = ("bsdf", id(bsdf)), bsdf.get("id"), f"bsdf {bsdf.get('id')}"
            bsdfs = self.scene.named(bsdf, "bsdf")
        group = self.groups(*(key or own))
        self.clear |= {group: True} if clear else {}
        return group

    def shines(self, emitter):
        """Is its radiance other than 0? What tells no number (a picture, a file, blackbody, d65) is."""
        told = self.scene.value(emitter, "radiance")
        try:
            return not told or not told.strip() or any(float(word) != 0 for word in told.replace(",", " ").split())
        except ValueError:  # a colour as #rrggbb, a spectrum as wavelength:value
            return True

    def of_file(self, shape, kind, name):
        file = beside(self.scene.path, self.scene.value(shape, "filename") or "")
        if file not in self.meshes:
            if not file.is_file():
                self.scene.refuse(f"shape {name:.80}: {file}: there is no such file: put it there")
            self.size += file.stat().st_size
            self.meshes[file] = _of_obj(file) if kind == "obj" else mesh(file, kind)
        return self.meshes[file]


def _of_obj(file):
    """(points, faces); Mitsuba's materials are the shape's own."""
    lines = bounded.content(file).splitlines()
    content = b"usemtl x\n" + b"\n".join(x for x in lines if not x.lstrip().startswith(b"usemtl"))
    polygons = read_obj(str(file), content)
    if len(polygons.starts) < 2:
        raise BadInput(f"{file}: has no faces")
    return polygons.vertices, np.split(polygons.corners, polygons.starts[1:-1])


def _sphere(scene, shape):
    own = np.diag([*np.full(3, _length(scene, shape, "radius")), 1.0])
    own[:3, 3] = scene.point(shape, "center", (0, 0, 0))
    return *round_shapes.sphere(), own


def _cylinder(scene, shape):
    """Between two points, without lids."""
    p0, p1 = scene.point(shape, "p0", (0, 0, 0)), scene.point(shape, "p1", (0, 0, 1))
    length, own = np.linalg.norm(p1 - p0), np.eye(4)
    if not length > 0:
        scene.refuse(f"shape {shape.get('id') or 'cylinder'}: p0 and p1 are one point")
    z = (p1 - p0) / length
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    radius = _length(scene, shape, "radius")
    own[:3] = np.column_stack([radius * x, radius * np.cross(z, x), z * length, p0])
    return *round_shapes.tube(1.0, 1.0, 0.0, 1.0), own


def _length(scene, shape, name):
    told = scene.number(shape, name, 1.0)
    if not told > 0:
        scene.refuse(f"shape {shape.get('id') or shape.get('type')}: {name} = {told:g} is not positive")
    return told


MAKERS = {  # kind: (scene, shape) -> (points, faces, (4, 4) of its own)
    "rectangle": lambda *_: (round_shapes.SQUARE, [(0, 1, 2, 3)], np.eye(4)),
    "cube": lambda *_: (round_shapes.CUBE, round_shapes.CUBE_FACES, np.eye(4)),
    "disk": lambda *_: (*round_shapes.disk(), np.eye(4)),
    "sphere": _sphere,
    "cylinder": _cylinder,
}
