"""Wavefront OBJ."""

import numpy as np

from lib.core.stage import BadInput
from lib.given import obj_text, strangers_files
from lib.given.formats import Format, LeftOut
from lib.given.model.polygons import Polygons

FORMAT = Format(
    "Wavefront OBJ (.obj, .mtl)",
    read=(
        "v, f (and its old name fo), o, usemtl; indices that count from the end; lines that a backslash goes on with",
        "mtllib: libraries beside the file, several, quoted, with the folders of Windows; Ke and map_Ke tell lamps",
        "text in UTF-8 or Latin-1, with line ends of any system",
    ),
    refused=(
        ("call: geometry in another file", "put that file's text in its place"),
        ("free-form surfaces and no faces", "tessellate them: export polygons"),
        ("faces without usemtl", "give them a material"),
        ("UTF-16", "save it as UTF-8"),
    ),
    left_out=(
        "points, lines, free-form curves and surfaces, weights of vertices, commands (csh), which are never run",
        "normals, texture coordinates, colours of vertices, groups (g), smoothing, and other words on looks",
        "material libraries that are not there, or are none",
    ),
)
# Words on looks, on names, and of free-form surfaces, which their first word counts: nothing of them moves a face.
PASSED = {
    *("vt", "vn", "vp", "g", "s", "mg", "mtllib", "maplib", "usemap", "bevel", "c_interp", "d_interp", "lod"),
    *("shadow_obj", "trace_obj", "ctech", "stech", "cstype", "deg", "bmat", "step", "parm", "trim", "hole", "scrv"),
    *("sp", "end", "con", "res", "dline", "off", "newmtl"),
}
COUNTED = {
    **{
        "p": "point element",
        "l": "line element",
        "curv": "free-form curve",
        "curv2": "free-form curve",
        "cdc": "free-form curve",
    },
    **{"surf": "free-form surface", "bzp": "free-form surface", "bsp": "free-form surface"},
    **{"cdp": "free-form surface", "csh": "command (csh)"},
}
FAR = 1 << 62  # what becomes of an index too large for an int64; no file reaches it either


def read_obj(path, content, bare=None) -> Polygons:
    """Wavefront OBJ: v, f, o, usemtl; `g` is passed over, and what else is geometry is counted.

    path : for messages        content : the file's bytes
    bare : group of faces without material; None: such are refused
    """
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise BadInput(f"{path}: is UTF-16: save it as UTF-8")
    if kind := strangers_files.kind_of(content):
        raise BadInput(f"{path}: is {kind}: {strangers_files.way_out(kind)}")
    text = obj_text.decoded(content)
    if "\0" in text:
        raise BadInput(f"{path}: not an OBJ file: byte 0 at {text.index(chr(0))}")
    reader = _Reader(path, bare)
    statements = {"v": reader.vertex, "f": reader.face, "o": reader.new_object, "usemtl": reader.new_group}
    statements |= {"fo": reader.face, "call": reader.call}
    for number, line in obj_text.lines(text):
        kind, *rest = line.split(None, 1)
        if kind in statements:
            statements[kind](number, line, rest[0].strip() if rest else None)
        elif kind not in PASSED:
            reader.left.add(COUNTED.get(kind) or "unknown statement")
    return reader.polygons()


class _Reader:
    """What has been read so far; each statement takes its line's number, the line, and what follows the first word."""

    def __init__(self, path, bare):
        self.path = path
        self.vertices, self.vertex_lines = [], []
        self.corners, self.starts, self.face_lines = [], [0], []
        self.face_object, self.face_group = [], []
        self.objects, self.groups = {}, {}  # name -> index
        self.object, self.group = None, bare
        self.left = LeftOut()

    def refuse(self, number, problem):
        raise BadInput(f"{self.path}: line {number}: {problem}") from None

    def vertex(self, number, line, _):
        values = line.split()
        if len(values) != 4 or "#" in line:
            values = self.other_vertex(number, line)
        self.vertices.append(values[1:4])
        self.vertex_lines.append(number)

    def other_vertex(self, number, line):
        """The words of a vertex of other than three numbers: a fourth alone is a weight, three more are a colour."""
        values = line.partition("#")[0].split()
        if len(values) < 4:
            self.refuse(number, f"vertex has {len(values) - 1} coordinates instead of 3")
        if len(values) == 5 and not _is_one(values[4]):
            self.left.add("vertex weight")
        return values

    def call(self, number, line, name):
        self.refuse(number, f"'{line.strip():.80}': geometry in another file is not read: put its text in this place")

    def new_object(self, number, line, name):
        self.object = self.objects.setdefault(name or "default", len(self.objects))

    def new_group(self, number, line, name):
        self.group = name

    def face(self, number, line, _):
        if self.group is None:
            self.refuse(number, f"face '{line.strip()}' has no material (usemtl)")
        try:
            face = [int(corner.split("/", 1)[0]) for corner in line.split("#", 1)[0].split()[1:]]
        except ValueError:
            self.refuse(number, f"face '{line.strip()}' has an index that is not a whole number")
        if len(face) < 3:
            self.refuse(number, f"face '{line.strip()}' has {len(face)} corners")
        count = len(self.vertices)
        for index in face:
            if index == 0 or index < -count:
                self.refuse(number, f"face index {index} is out of range (1 to {count})")
        self.corners += [min(index - 1, FAR) if index > 0 else count + index for index in face]
        self.starts.append(len(self.corners))
        self.face_lines.append(number)
        if self.object is None:
            self.new_object(number, line, None)
        self.face_object.append(self.object)
        self.face_group.append(self.groups.setdefault(self.group, len(self.groups)))

    def polygons(self) -> Polygons:
        """All of it, when the last line has been read: vertices may stand below the faces that use them."""
        p = self.points()
        corners, starts = np.array(self.corners, np.int64), np.array(self.starts, np.int64)
        beyond = np.flatnonzero(corners >= len(p))
        if len(beyond):
            number = self.face_lines[np.searchsorted(starts, beyond[0], side="right") - 1]
            self.refuse(number, f"face index {corners[beyond[0]] + 1} is out of range (1 to {len(p)})")
        line = self.left.line()
        if not len(starts) - 1 and line:
            raise BadInput(f"{self.path}: faces: the model has none ({line}): export it as polygons")
        owner, group = np.array(self.face_object, np.int32), np.array(self.face_group, np.int32)
        return Polygons(
            p, corners, starts, owner, group, list(self.objects), list(self.groups), (), (line,) if line else ()
        )

    def points(self):
        """(V, 3) m."""
        try:
            p = np.array(self.vertices, float).reshape(-1, 3)
        except ValueError:
            self.refuse_words()
            raise
        bad = np.argwhere(~np.isfinite(p))
        if len(bad):
            i, axis = bad[0]
            self.refuse(self.vertex_lines[i], f"vertex {'xyz'[axis]} = {self.vertices[i][axis]} is not finite")
        return p

    def refuse_words(self):
        """Refuse the first coordinate that is not a number."""
        for values, number in zip(self.vertices, self.vertex_lines, strict=True):
            for axis, value in zip("xyz", values, strict=True):
                try:
                    float(value)
                except ValueError:
                    self.refuse(number, f"vertex {axis} = {value} {_not_a_number(value)}")


def _is_one(word):
    try:
        return float(word) == 1
    except ValueError:
        return False


def _not_a_number(value):
    """
    >>> _not_a_number("1,5"), _not_a_number("0,")
    ('has a decimal comma: write 1.5', 'has a comma: blanks part the coordinates')
    """
    whole, comma, part = value.partition(",")
    if comma and part.isdigit() and whole.lstrip("+-").isdigit():
        return f"has a decimal comma: write {whole}.{part}"
    return "has a comma: blanks part the coordinates" if comma else "is not a number"
