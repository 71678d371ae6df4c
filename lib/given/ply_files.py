"""PLY: text, and binary of either byte order.

Our own reader, not trimesh's (5.2): that one looks for a picture that a comment names, cuts polygons of more than four
corners into fans, also where they are concave, and passes over strips.
"""

from __future__ import annotations

import re
import struct
from typing import NamedTuple

import numpy as np

from lib.core.stage import BadInput
from lib.given.formats import Format, LeftOut

FORMAT = Format(
    "PLY",
    read=(
        "text, binary_little_endian, binary_big_endian; properties of any type and in any order",
        "faces of any number of corners (vertex_indices, vertex_index), strips (tristrips)",
    ),
    refused=(
        ("a point cloud, also of Gaussian splats", "make a mesh of it"),
        ("a file that ends too early", "copy it again"),
    ),
    left_out=("edges and other elements", "colours and other properties of faces", "pictures: none is looked for"),
)
TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"},
}
LETTERS = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f4": "f", "f8": "d"}
ORDER = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
CORNERS = ("vertex_indices", "vertex_index")
LONGEST_HEADER = 1 << 20  # bytes


class Property(NamedTuple):
    name: str
    type: str
    count: str | None  # the type of a list's length; None: no list


class Element(NamedTuple):
    name: str
    count: int
    properties: list


def read_ply(path, content) -> tuple[np.ndarray, list, list]:
    """(points (V, 3), faces: lists of indices into them, lines to say). BadInput: no faces, damaged"""
    form, elements, body = _header(path, content)
    left, found = LeftOut(), {}
    rows = _Text(path, content[body:]) if form == "ascii" else _Binary(path, content, body, ORDER[form])
    for element in elements:
        table = rows.table(element)
        if element.name in ("vertex", "face", "tristrips"):
            found[element.name] = table
        left.add(element.name, element.count if element.name not in found else 0)
    extra = [p.name for e in elements if e.name == "face" for p in e.properties if p.name not in CORNERS]
    for name in extra if "face" in found else ():
        left.add(f"property of faces ({name:.40})")
    vertex = found.get("vertex", {})
    if not all(axis in vertex for axis in "xyz"):
        raise BadInput(f"{path}: element vertex: it has no x, y and z")
    points = np.column_stack([np.asarray(vertex[axis], float) for axis in "xyz"])
    faces = _faces(path, found)
    if not faces:
        what = "a point cloud of Gaussian splats" if "f_dc_0" in vertex else f"a point cloud of {len(points)} points"
        raise BadInput(f"{path}: has no faces: it is {what}: make a mesh of it, or draw the surfaces")
    return points, faces, [line for line in [left.line()] if line]


def _faces(path, found):
    told, strips = found.get("face", {}), found.get("tristrips", {})
    name = next((name for name in CORNERS if name in told), None)
    if told and not name:
        raise BadInput(f"{path}: element face: it has no {CORNERS[0]}, but {', '.join(told):.80}")
    faces = [face for face in told[name] if len(face)] if name else []
    for strip in next((strips[name] for name in CORNERS if name in strips), ()):
        faces += _of_strip(np.asarray(strip))
    return faces


def _of_strip(strip):
    """Triangles of strips that -1 parts; every other one is turned."""
    made, start = [], 0
    for end in np.flatnonzero(np.append(strip, -1) < 0):
        run, start = strip[start:end], end + 1
        rows = np.stack([run[:-2], run[1:-1], run[2:]], axis=1) if len(run) > 2 else np.zeros((0, 3), int)
        rows[1::2] = rows[1::2][:, [1, 0, 2]]
        made += list(rows)
    return made


def _header(path, content):
    """(format, elements, where the numbers begin)."""
    found = re.search(rb"[\r\n][ \t]*end_header(?=\s)", content[:LONGEST_HEADER])  # not of a comment
    if not found:
        raise BadInput(f"{path}: not a readable PLY: it has no end_header")
    end, body = found.start(), found.end()
    while content[body : body + 1] in (b" ", b"\t"):
        body += 1
    body += 2 if content[body : body + 2] == b"\r\n" else 1
    form, elements = None, []
    for line in content[:end].replace(b"\r", b"\n").decode("latin-1").split("\n"):
        words = line.split()
        try:
            if words[:1] == ["format"]:
                form = words[1]
            elif words[:1] == ["element"]:
                elements.append(Element(words[1], int(words[2]), []))
            elif words[:2] == ["property", "list"]:
                elements[-1].properties.append(Property(words[4], TYPES[words[3]], TYPES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1].properties.append(Property(words[2], TYPES[words[1]], None))
        except (IndexError, ValueError, KeyError):
            raise BadInput(f"{path}: header: '{line:.80}' is not understood") from None
    if form not in ORDER:
        raise BadInput(f"{path}: format: {str(form):.40} is none of {', '.join(ORDER)}")
    if any(len({p.name for p in e.properties}) < len(e.properties) for e in elements):
        raise BadInput(f"{path}: header: an element has two properties of one name")
    if any(not 0 <= e.count <= len(content) for e in elements):
        raise BadInput(f"{path}: element: more of them are announced than the file has bytes")
    return form, elements, body


class _Text:
    def __init__(self, path, body):
        self.path, self.words, self.at = path, body.split(), 0

    def table(self, element):
        """{property: (count,) numbers, or lists of them}"""
        if not any(p.count for p in element.properties):  # also where there are none
            width = len(element.properties)
            numbers = self.numbers(element, element.count * width, float).reshape(element.count, width)
            return {p.name: numbers[:, k] for k, p in enumerate(element.properties)}
        made = {p.name: [] for p in element.properties}
        for _ in range(element.count):
            for p in element.properties:
                kind = float if p.type[0] == "f" else int
                if p.count:
                    (length,) = self.numbers(element, 1, int)
                    made[p.name].append(self.numbers(element, length, kind))
                else:
                    made[p.name].append(self.numbers(element, 1, kind)[0])
        return made

    def numbers(self, element, count, kind):
        if count < 0 or self.at + count > len(self.words):
            raise BadInput(f"{self.path}: truncated in element {element.name:.40}")
        words = self.words[self.at : self.at + count]
        self.at += count
        try:
            return np.array([kind(word) for word in words], kind)
        except (ValueError, OverflowError) as error:
            raise BadInput(f"{self.path}: element {element.name:.40}: {error}") from None


class _Binary:
    def __init__(self, path, content, at, order):
        self.path, self.content, self.at, self.order = path, content, at, order

    def table(self, element):
        """{property: (count,) numbers, or lists of them}"""
        try:
            return self.alike(element) if element.properties and element.count else {}
        except (ValueError, struct.error):
            raise BadInput(f"{self.path}: truncated in element {element.name:.40}") from None

    def alike(self, element):
        """Rows whose lists have one length, as triangles have, are read at once; others one by one."""
        at, parts, lengths = self.at, [], {}
        for k, p in enumerate(element.properties):
            if p.count:
                lengths[k] = self.length(p, at)
                parts += [(f"n{k}", self.order + p.count), (f"v{k}", self.order + p.type, (lengths[k],))]
                at += np.dtype(p.count).itemsize + lengths[k] * np.dtype(p.type).itemsize
            else:
                parts.append((f"v{k}", self.order + p.type))
                at += np.dtype(p.type).itemsize
        kind = np.dtype(parts)
        if element.count * kind.itemsize <= len(self.content) - self.at:
            rows = np.frombuffer(self.content, kind, element.count, self.at)
            if all((rows[f"n{k}"] == length).all() for k, length in lengths.items()):
                self.at += element.count * kind.itemsize
                return {p.name: rows[f"v{k}"] for k, p in enumerate(element.properties)}
        elif not lengths:
            raise ValueError("truncated")
        return self.one_by_one(element)

    def one_by_one(self, element):
        made = {p.name: [] for p in element.properties}
        at = self.at
        steps = [(p, np.dtype(self.order + p.type), made[p.name].append) for p in element.properties]
        for _ in range(element.count):
            for p, kind, keep in steps:
                if p.count:
                    length = self.length(p, at)
                    at += np.dtype(p.count).itemsize
                    keep(np.frombuffer(self.content, kind, length, at))
                    at += length * kind.itemsize
                else:
                    keep(np.frombuffer(self.content, kind, 1, at)[0])
                    at += kind.itemsize
        self.at = at
        return made

    def length(self, p, at):
        (length,) = struct.unpack_from(self.order + LETTERS[p.count], self.content, at)
        if not 0 <= length <= len(self.content):
            raise ValueError("a length below nothing, or beyond the file")
        return int(length)
