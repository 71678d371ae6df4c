"""Blender's camera, as docs/blender_camera.py writes it."""

from __future__ import annotations

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given.foreign_cameras.found import Found
from lib.given.formats import Format

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # Blender's camera looks along -z, y up
AGAIN = "run docs/blender_camera.py again in Blender"

FORMAT = Format(
    "Blender's camera, by docs/blender_camera.py",
    ("perspective cameras: lens, sensor fit, shift, pixel aspect, pose",),
    (
        ("orthographic, panoramic and custom cameras", "set the camera to Perspective"),
        ("files of an older script, which do not say the camera's type", AGAIN),
    ),
    ("depth of field",),
)


def read(path) -> Found:
    """BadInput: not one, or of a camera that is not a perspective one."""
    told = bounded.json_of(path, bounded.content(path))
    kind = told.get("type")
    if kind is None:
        raise BadInput(
            f"{path}: type: is missing: an older docs/blender_camera.py wrote it, and also of cameras that are "
            f"orthographic or panoramic: {AGAIN}"
        )
    if kind != "PERSP":
        word = {"ORTHO": "orthographic", "PANO": "panoramic"}.get(str(kind), f"{kind!r:.40}")
        raise BadInput(f"{path}: type: the camera is {word}: set it to Perspective in Blender, and {AGAIN}")
    try:
        lens, (sx, sy) = told["lens_px"], told["shift_px"]
        width, height = map(int, told["size_px"])
        T = FLIP @ np.linalg.inv(np.array(told["matrix_world"], float).reshape(4, 4))
        # Blender's pixels begin at the picture's corner
        K = np.array([lens[0], lens[1], width / 2 - sx - 0.5, height / 2 + sy - 0.5], float)
    except (ValueError, KeyError, TypeError, IndexError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise BadInput(f"{path}: not a camera of docs/blender_camera.py: {type(error).__name__}: {error}") from None
    return Found("Blender", "LENSMODEL_PINHOLE", K, width, height, T, stored=False)
