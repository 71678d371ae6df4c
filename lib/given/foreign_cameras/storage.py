"""Tables of names and values as OpenCV, ROS and Python write them: YAML, JSON or XML."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from typing import NamedTuple

import numpy as np

from lib.core import bounded, yaml_file
from lib.core.stage import BadInput

# Names of YAML files whose values are looked at; the others may be long
WANTED = (
    *(r"camera_?matrix\w*", r"mtx\w*", r"intrinsic\w*", r"[mkd][12lr]?", r"xi", r"dist\w*", r"[rt]vec", r"rotation\w*"),
    *(
        r"translation\w*",
        r"(image|img)_?(width|height|size)",
        r"width",
        r"height",
        r"resolution",
        r"dim",
        r"roi",
        r"binning_[xy]",
    ),
    *(r"\w*model\w*", r"\w*type", r"\w*fisheye\w*", r"flags", r"cam\d+", r"camera\d?\.\w+", r"projection_parameters"),
)


MOST_NAMES = 10_000  # of an XML file


class Table(NamedTuple):
    """values : {name: value}, by the name without case, underscores and dots;  names : all that the file has, as it has
    them;  words : its head as text, for comments"""

    values: dict
    names: tuple[str, ...]
    words: str

    def get(self, *names):
        """The value of the first name that is there; None."""
        return next((self.values[name] for name in names if self.values.get(name) is not None), None)

    def spelt(self, name):
        """A name of `values` as the file has it."""
        return next((own for own in self.names if plain(own) == name), name)


def plain(name) -> str:
    """A name as it is looked for.

    >>> plain("Camera_Matrix"), plain("imageWidth")
    ('cameramatrix', 'imagewidth')
    """
    return re.sub(r"[_.\- ]", "", str(name)).lower()


def read(path, content) -> Table:
    """Of bytes. BadInput: not readable. A table without names is none of these files."""
    start = content.lstrip(b"\xef\xbb\xbf \t\r\n")
    bounded.check_size(path, len(content), bounded.LARGEST_TEXT)
    words = content[:100_000].decode("utf-8", "replace")
    if start.startswith(b"<"):
        try:
            root = ElementTree.fromstring(content)
            if len(root) > MOST_NAMES:
                raise ValueError(f"more than {MOST_NAMES} names")
            told = {element.tag: _of_element(element) for element in root}
        except (ElementTree.ParseError, ValueError) as error:
            raise BadInput(f"{path}: not readable XML: {error}") from None
        names = tuple(told)
    elif start.startswith((b"{", b"[")):
        told = bounded.json_of(path, content)
        told = told if isinstance(told, dict) else {}
        names = tuple(told)
    else:
        text = bounded.text_of(path, content)
        told, names = yaml_file.read_opencv(path, text, WANTED), tuple(yaml_file.names_of(text))
    return Table({plain(name): value for name, value in told.items()}, names, words)


def _of_element(element):
    """A number, a list of numbers, a word, or a table."""
    if len(element):
        return {child.tag: _of_element(child) for child in element}
    words = (element.text or "").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return " ".join(words).strip('"')
    return numbers[0] if len(numbers) == 1 and element.tag != "data" else numbers


def matrix(path, name, value):
    """An OpenCV matrix, or a plain list of numbers or of rows, as an array; None where there is none."""
    if value is None:
        return None
    try:
        data = np.array(value["data"] if isinstance(value, dict) else value, float)
        if isinstance(value, dict):
            sides = value["sizes"] if "sizes" in value else [value["rows"], value["cols"]]
            sides = sides if isinstance(sides, list) else [sides]  # XML's list of one is a number
            channels = re.match(r"\d+", str(value.get("dt", "")))  # 3d: triples of numbers
            many = math.prod(sides) * (int(channels[0][:3]) if channels else 1)
            if list(sides) != [int(side) for side in sides] or data.size != many:
                raise ValueError(f"{data.size} numbers instead of {' x '.join(map(str, sides)):.40}")
            data = data.reshape([int(s) for s in sides] + [-1]) if many and channels else data
        return data
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise BadInput(f"{path}: {name}: no matrix: {type(error).__name__}: {error}") from None


def whole(value):
    """A side of a picture as a whole number; None where it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        return None
    return int(value)
