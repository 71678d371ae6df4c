"""Meshes on their way into an OBJ of ours: PLY and STL by trimesh, and the text of what was read."""

from __future__ import annotations

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput


def beside(path, name):
    """The path of a file that a model names. BadInput: it lies outside the model's folder."""
    if bounded.lies_outside(name):
        raise BadInput(f"{path}: {name:.80} lies outside the model's folder")
    return path.parent / name


def mesh(path, kind):
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


def obj(parts) -> bytes:
    """parts : [(object, group, points (V, 3), faces)]"""
    lines, count = ["# written by make new-scene"], 0
    for thing, group, points, faces in parts:
        lines += [f"o {thing}", f"usemtl {group}"]
        lines += ["v " + " ".join(repr(float(x)) for x in p) for p in points]
        lines += ["f " + " ".join(str(count + int(k) + 1) for k in face) for face in faces]
        count += len(points)
    return ("\n".join(lines) + "\n").encode()
