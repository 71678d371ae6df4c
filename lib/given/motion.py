"""Cameras along a way: between posed cameras, or by rows of a csv file (data/SCENE.md, `cameras`)."""

from __future__ import annotations

import csv
import math
from dataclasses import replace

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import lenses
from lib.given.cameras import towards
from lib.given.lenses import Lens

HEADER = ["eye_x", "eye_y", "eye_z", "at_x", "at_y", "at_z"]


def read_csv(path) -> np.ndarray:
    """(n, 4, 4) world to camera, of n >= 2 rows: from an eye to a place, in metres, the z axis up in the picture.

    BadInput: another header, a field that is no finite number, a view along the z axis, an eye where it looks at.
    """
    try:
        lines = csv.reader(bounded.text(path).splitlines(), strict=True)
        rows = [(k, row) for k, row in enumerate(lines, 1) if row and not row[0].startswith("#")]
    except csv.Error as error:
        raise BadInput(f"{path}: not a readable CSV file: {error}") from None
    header = [word.strip() for word in rows[0][1]] if rows else []
    if header != HEADER:
        raise BadInput(f"{path}: header: {','.join(header)} is not {','.join(HEADER)}")
    if len(rows) < 3:
        raise BadInput(f"{path}: rows: {len(rows) - 1} are less than two")
    return np.array([_looking(f"{path}: line {k}", *np.reshape(_numbers(path, k, row), (2, 3))) for k, row in rows[1:]])


def _numbers(path, k, row):
    if len(row) != len(HEADER):
        raise BadInput(f"{path}: line {k}: {len(row)} fields instead of {len(HEADER)}")
    values = []
    for name, word in zip(HEADER, row, strict=True):
        try:
            values.append(float(word))
        except ValueError:
            raise BadInput(f"{path}: line {k}: {name}: {word!r} is not a number") from None
        if not math.isfinite(values[-1]):
            raise BadInput(f"{path}: line {k}: {name}: {word} is not finite")
    return values


def _looking(where, eye, at):
    """(4, 4) world to camera."""
    try:
        return towards(eye, at)
    except ValueError:
        raise BadInput(
            f"{where}: at: {at.tolist()} is not beside the upright line through the eye {eye.tolist()}"
        ) from None


def read_cameras(paths) -> list[Lens]:
    """Posed cameras of one lens model and one size. BadInput: they are not."""
    found = [lenses.read(path) for path in paths]
    for path, lens in zip(paths, found, strict=True):
        for what, of in (("lensmodel", lambda a: a.model), ("imagersize", lambda a: (a.width, a.height))):
            if of(lens) != of(found[0]):
                raise BadInput(f"{path}: {what}: {of(lens)} is not {of(found[0])}, that of {paths[0]}")
    return found


def between(cameras: list[Lens], frames) -> list[Lens]:
    """So many cameras, evenly from the first to the last: centres and intrinsics linear, rotations spherical.

    frames : None: the cameras themselves
    """
    from scipy.spatial.transform import Rotation, Slerp

    if frames is None:
        return list(cameras)
    knots = np.arange(len(cameras))
    at = np.linspace(0, knots[-1], frames)
    rotation = Slerp(knots, Rotation.from_matrix([c.T_cam_ref[:3, :3] for c in cameras]))(at).as_matrix()
    along = lambda values: np.stack([np.interp(at, knots, v) for v in np.transpose(values)], axis=1)
    centre, intrinsics = along([c.centre for c in cameras]), along([c.intrinsics for c in cameras])
    result = []
    for R, c, numbers in zip(rotation, centre, intrinsics, strict=True):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, -R @ c
        result.append(replace(cameras[0], intrinsics=numbers, T_cam_ref=T))
    return result
