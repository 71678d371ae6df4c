"""Wavefront OBJ."""

import numpy as np

from lib.core.stage import BadInput
from lib.given import strangers_files
from lib.given.model.polygons import Polygons

FAR = 1 << 62  # what becomes of an index too large for an int64; no file reaches it either


def read_obj(path, content, bare=None) -> Polygons:
    """Wavefront OBJ: v, f, o, usemtl; everything else, `g` included, is passed over.

    path : for messages        content : the file's bytes
    bare : group of faces without material; None: such are refused
    """
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise BadInput(f"{path}: is UTF-16: save it as UTF-8")
    if kind := strangers_files.kind_of(content):
        raise BadInput(f"{path}: is {kind}: {strangers_files.way_out(kind)}")
    try:
        text = content.decode("utf-8-sig")  # a mark of the byte order belongs to no statement
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if "\0" in text:
        raise BadInput(f"{path}: not an OBJ file: byte 0 at {text.index(chr(0))}")
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    reader = _Reader(path, bare)
    statements = {"v": reader.vertex, "f": reader.face, "o": reader.new_object, "usemtl": reader.new_group}
    for number, line in _lines(text):
        kind, *rest = line.split(None, 1)
        if kind in statements:
            statements[kind](number, line, rest[0].strip() if rest else None)
    return reader.polygons()


def _lines(text):
    """(number, line) of all that are not empty; a line that ends in a backslash goes on in the next."""
    lines = enumerate(text.split("\n"), 1)
    for number, line in lines:
        while line.rstrip().endswith("\\") and (following := next(lines, None)):
            line = line.rstrip()[:-1] + " " + following[1]
        if line and not line.isspace():
            yield number, line


class _Reader:
    """What has been read so far; each statement takes its line's number, the line, and what follows the first word."""

    def __init__(self, path, bare):
        self.path = path
        self.vertices, self.vertex_lines = [], []
        self.corners, self.starts, self.face_lines = [], [0], []
        self.face_object, self.face_group = [], []
        self.objects, self.groups = {}, {}  # name -> index
        self.object, self.group = None, bare

    def refuse(self, number, problem):
        raise BadInput(f"{self.path}: line {number}: {problem}") from None

    def vertex(self, number, line, _):
        values = line.split()
        if len(values) < 4:
            self.refuse(number, f"vertex has {len(values) - 1} coordinates instead of 3")
        self.vertices.append(values[1:4])
        self.vertex_lines.append(number)

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
        owner, group = np.array(self.face_object, np.int32), np.array(self.face_group, np.int32)
        return Polygons(p, corners, starts, owner, group, list(self.objects), list(self.groups))

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


def _not_a_number(value):
    """
    >>> _not_a_number("1,5"), _not_a_number("0,")
    ('has a decimal comma: write 1.5', 'has a comma: blanks part the coordinates')
    """
    whole, comma, part = value.partition(",")
    if comma and part.isdigit() and whole.lstrip("+-").isdigit():
        return f"has a decimal comma: write {whole}.{part}"
    return "has a comma: blanks part the coordinates" if comma else "is not a number"
