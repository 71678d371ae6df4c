"""STL, binary and text."""

from __future__ import annotations

import re

import numpy as np

from lib.core.stage import BadInput
from lib.given import obj_text, strangers_files
from lib.given.formats import Format, LeftOut

FORMAT = Format(
    "STL",
    read=(
        "binary, also with a header that begins with 'solid' or with bytes behind its end",
        "text in any capitals, with one solid or several",
    ),
    refused=(("no triangles", "export it again"), ("fewer bytes than it announces", "copy it again")),
    left_out=("colours in a binary file", "normals: the corners tell the side", "names of solids"),
)
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
NUMBER = rb"[ \t]+([^\s]+)[ \t]+([^\s]+)[ \t]+([^\s]+)"


def read_stl(path, content) -> tuple[np.ndarray, np.ndarray, list]:
    """(points (3 T, 3), faces (T, 3) int, lines to say). The corners' order tells the front, as in other programs."""
    left = LeftOut()
    corners, normals = _of_text(path, content, left) if _is_text(content) else _of_bytes(path, content, left)
    if not len(corners):
        raise BadInput(f"{path}: has no faces")
    said = []
    front = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    turned = np.count_nonzero(np.einsum("ij,ij->i", front, normals) < 0)
    if turned:
        said.append(f"{turned} of {len(corners)} normals point against their corners: the corners tell the front")
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), [*said, *filter(None, [left.line()])]


def _is_text(content):
    """Not every file that begins with "solid" is text: then its length is that of a binary one."""
    start = content[:200].lstrip(b"\xef\xbb\xbf \t\r\n")
    return start[:5].lower() == b"solid" and not strangers_files.is_binary_stl(content)


def _of_bytes(path, content, left):
    if len(content) < 84:
        raise BadInput(f"{path}: {len(content)} bytes are no STL file")
    count = int.from_bytes(content[80:84], "little")
    there = (len(content) - 84) // 50
    if count > there:
        raise BadInput(f"{path}: truncated: {count} triangles are announced, {there} are there")
    facets = np.frombuffer(content, FACET, count, 84)
    left.add("spare byte", len(content) - 84 - 50 * count)
    left.add("triangle colour", int(np.count_nonzero(facets["attribute"])))
    return facets["corners"].astype(float), facets["normal"].astype(float)


def _of_text(path, content, left):
    content = obj_text.decoded(content).lower().encode()
    corners = _numbers(path, content, b"vertex", "vertex")
    normals = _numbers(path, content, rb"facet[ \t]+normal", "facet normal")
    solids = len(re.findall(rb"^[ \t]*solid\b", content, re.M))
    left.add("solid name", solids if solids > 1 else 0)
    facets = len(re.findall(rb"^[ \t]*endfacet|^[ \t]*end[ \t]+facet", content, re.M))
    if len(corners) != 3 * facets:
        raise BadInput(f"{path}: {len(corners)} corners in {facets} facets: three each are read")
    if not re.search(rb"^[ \t]*end[ \t]*solid", content, re.M):
        raise BadInput(f"{path}: truncated: it has no line 'endsolid'")
    return corners.reshape(-1, 3, 3), normals if len(normals) == facets else np.zeros((facets, 3))


def _numbers(path, content, word, what):
    """(n, 3): the three words behind a word at the beginnings of lines."""
    rows = re.findall(rb"^[ \t]*" + word + NUMBER, content, re.M)
    try:
        return np.array(rows).astype(float).reshape(-1, 3) if rows else np.zeros((0, 3))
    except ValueError as error:
        raise BadInput(f"{path}: {what}: {error}") from None
