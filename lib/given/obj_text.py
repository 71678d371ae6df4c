"""The text of OBJ and MTL without NumPy: its letters, its lines, the names in it, which materials emit."""

from __future__ import annotations

import re

# First words of lines. A line that begins with one is no second half of the line before it.
WORDS = {
    *("v", "vt", "vn", "vp", "f", "fo", "p", "l", "o", "g", "s", "mg", "usemtl", "mtllib", "maplib", "usemap", "call"),
    *("csh", "cstype", "deg", "bmat", "step", "curv", "curv2", "surf", "parm", "trim", "hole", "scrv", "sp", "end"),
    *("con", "bevel", "c_interp", "d_interp", "lod", "shadow_obj", "trace_obj", "ctech", "stech", "newmtl"),
}


HEAD = 1 << 16  # bytes in which a comment may tell the unit


def decoded(content) -> str:
    """Text of bytes in UTF-8, else Latin-1; lines end with a line feed."""
    try:
        text = content.decode("utf-8-sig")  # a mark of the byte order belongs to no statement
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def lines(text):
    """(number, line) of all that hold a statement.

    A line that ends in a backslash goes on in the next. A comment ends with its line, and a name may end in a
    backslash, too (a folder of Windows): then a statement of its own follows.

    >>> list(lines("# in C:\\\\rooms\\\\\\nf 1 2 \\\\\\n3\\no a\\\\\\nv 0 0 0"))
    [(2, 'f 1 2  3'), (4, 'o a\\\\'), (5, 'v 0 0 0')]
    """
    for number, line in _joined(text) if "\\" in text else enumerate(text.split("\n"), 1):
        if line and not line.isspace() and not line.lstrip().startswith("#"):
            yield number, line


def _joined(text):
    """(number, line), a line with those that it goes on in."""
    numbered = enumerate(text.split("\n"), 1)
    ahead = next(numbered, None)
    while ahead:
        number, parts = ahead[0], [ahead[1]]
        ahead = next(numbered, None)
        while ahead and parts[-1].rstrip().endswith("\\") and "#" not in parts[-1] and not _is_statement(ahead[1]):
            parts[-1] = parts[-1].rstrip()[:-1]
            parts.append(ahead[1])
            ahead = next(numbered, None)
        yield number, " ".join(parts)


def _is_statement(line):
    first = line.split(None, 1)
    return bool(first) and (first[0] in WORDS or first[0].startswith("#"))


def names(content, word) -> list[str]:
    """What stands behind a word at the beginnings of lines, in the file's order, each once.

    >>> names(b"usemtl a\\nf 1 2 3\\n usemtl\\tb c\\r\\nusemtl a", "usemtl")
    ['a', 'b c']
    """
    found = re.findall(rf"^[ \t]*{word}[ \t]([^\n]*)$", decoded(content), re.M)
    return list(dict.fromkeys(name.strip() for name in found if name.strip()))


def is_library(content) -> bool:
    """Whether this is a library of materials."""
    return b"\0" not in content and re.search(r"^[ \t]*newmtl[ \t]+\S", decoded(content), re.M | re.I) is not None


def described(content) -> list[str]:
    """Materials of a library."""
    return names(content, "(?i:newmtl)")


def pictures(content) -> int:
    """How many pictures the materials of a library name, but those of what emits.

    >>> pictures(b"newmtl a\\nmap_Kd x.png\\nnewmtl b\\nmap_Kd x.png\\nbump -bm 1 y.png\\nmap_Ke z.png")
    2
    """
    found = re.findall(
        r"^[ \t]*(?:map_(?!ke)\w+|bump|norm|disp|decal|refl)[ \t]+([^\n]*)$", decoded(content), re.M | re.I
    )
    return len({line.split()[-1] for line in found if line.split()})


UNIT = re.compile(
    r"^[ \t]*#.*\bunits?\b[^\n]*?\b(mm|cm|in|ft|m|millimet|centimet|inch|feet|foot|met)(?:re|er)?(?:e?s)?\b",
    re.M | re.I,
)
UNITS = {"millimet": "mm", "centimet": "cm", "inch": "in", "feet": "ft", "foot": "ft", "met": "m"}


def unit(content) -> str | None:
    """The unit that a comment tells, in our words.

    >>> unit(b"# File units = centimeters\\nv 0 0 0"), unit(b"# Units: inches"), unit(b"# unit cube in a room")
    ('cm', 'in', None)
    """
    head = decoded(content[:HEAD])
    found = UNIT.search(head)
    word = found[1].lower() if found and re.search(r"units?\b[ \t]*(?:[=:]|are\b|is\b|in\b)", found[0], re.I) else None
    return UNITS.get(word, word)


def emitting(content) -> list[str]:
    """Materials of a library that emit.

    >>> emitting(b"newmtl a b\\nKe\\t0 0 1\\nnewmtl c\\nKe 0 0 0\\nnewmtl d\\nmap_Ke x.png")
    ['a b', 'd']
    """
    return _of_materials(content, lambda word, rest: word == "map_ke" or (word == "ke" and _some(rest)))


def clear(content) -> list[str]:
    """Materials of a library that let light through: d (dissolve) below 1, or Tr above 0.

    >>> clear(b"newmtl a\\nd 1\\nnewmtl b\\nd -halo 0.3\\nnewmtl c\\nTr 0.5")
    ['b', 'c']
    """

    def through(word, rest):
        last = rest.split()[-1:]
        value = float(last[0]) if last and _finite(last[0]) else None
        return value is not None and ((word == "d" and value < 1) or (word == "tr" and 0 < value < 1))

    return _of_materials(content, through)


def doubled(content) -> list[str]:
    """Materials that stand there twice, with other values.

    >>> doubled(b"newmtl a\\nKd 1 1 1\\nnewmtl b\\nnewmtl a\\nKd 0 0 0\\nnewmtl b")
    ['a']
    """
    parts = re.split(r"^[ \t]*newmtl[ \t]", decoded(content), flags=re.M | re.I)[1:]
    found, bodies = [], {}
    for name, _, body in (part.partition("\n") for part in parts):
        body = [line.split() for line in body.split("\n") if line.split()[:1] and not line.lstrip().startswith("#")]
        if bodies.setdefault(name.strip(), body) != body:
            found.append(name.strip())
    return list(dict.fromkeys(found))


def _of_materials(content, asked):
    """Names of materials one of whose lines is asked(first word in small letters, the rest)."""
    found, material = [], None
    for line in decoded(content).split("\n"):
        word, *rest = line.split(None, 1)[:2] or [""]
        word, rest = word.lower(), rest[0].strip() if rest else ""
        if word == "newmtl":
            material = rest
        elif material and asked(word, rest):
            found.append(material)
    return list(dict.fromkeys(found))


def _some(rest):
    """Whether an amount of light is more than none: r g b, one number, `xyz x y z`, `spectral file`."""
    rest = rest.partition("#")[0]
    return rest.lower().startswith("spectral") or any(float(v) > 0 for v in rest.split() if _finite(v))


def _finite(word):
    try:
        return float(word) - float(word) == 0
    except ValueError:
        return False
