"""Meshes on their way into an OBJ of ours: PLY and STL, and the text of what was read."""

from __future__ import annotations

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import files_beside
from lib.given.ply_files import read_ply
from lib.given.stl_files import read_stl

READERS = {"ply": read_ply, "stl": read_stl}


def beside(path, name):
    """The path of a file that a model names. BadInput: it lies outside the model's folder."""
    if bounded.lies_outside(name):
        raise BadInput(f"{path}: {name:.80} lies outside the model's folder")
    return files_beside.find(path.parent, name) or path.parent / name


def mesh(path, kind):
    """(points (V, 3), faces: lists of indices into them) of a file; see `read`."""
    return read(path, bounded.content(path), kind)[:2]


def read(path, content, kind) -> tuple[np.ndarray, list, list]:
    """(points (V, 3), faces: lists of indices into them, lines to say) of a PLY or an STL.

    kind : "ply" or "stl".  Points at one place are one.  BadInput: damaged, no faces, an index out of range
    """
    points, faces, said = READERS[kind](path, content)
    corners = np.concatenate([np.asarray(face) for face in faces]) if isinstance(faces, list) else faces.reshape(-1)
    size = np.array([len(face) for face in faces])
    if corners.dtype.kind not in "iu":
        raise BadInput(f"{path}: element face: an index is no whole number")
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        wrong = corners[(corners < 0) | (corners >= len(points))][0]
        raise BadInput(f"{path}: face index {wrong} is out of range (0 to {len(points) - 1})")
    if not np.isfinite(points).all():
        raise BadInput(f"{path}: vertex {np.argwhere(~np.isfinite(points))[0][0]} is not finite")
    used, index = np.unique(points, axis=0, return_inverse=True)  # STL repeats each corner
    corners = index.reshape(-1)[corners.astype(int)]
    return used, np.split(corners, np.cumsum(size)[:-1]), said


def obj(parts) -> bytes:
    """parts : [(object, group, points (V, 3), faces)]"""
    lines, count = ["# written by make new-scene"], 0
    for thing, group, points, faces in parts:
        lines += [f"o {thing}", f"usemtl {group}"]
        lines += ["v " + " ".join(repr(float(x)) for x in p) for p in points]
        lines += ["f " + " ".join(str(count + int(k) + 1) for k in face) for face in faces]
        count += len(points)
    return ("\n".join(lines) + "\n").encode()
