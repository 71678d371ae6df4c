"""Cameras that people have, as mrcal's cameramodel: of COLMAP, OpenCV, ROS, nerfstudio, fSpy, Blender, mrcal.

Each tool has a module with its `FORMAT`. Pixel (0, 0) is the centre of the first pixel here; each module says where its
tool counts from. Pixels are those that viewers show: the camera of a tool that counts stored ones is turned with the
photograph (`found.of_photograph`). What is no camera of these is refused by its name (lib/given/camera_names.py).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import camera_names, fspy, lenses
from lib.given.foreign_cameras import blender, colmap, nerfstudio, opencv, robots, storage
from lib.given.foreign_cameras.found import Found, check, doubted, of_photograph
from lib.given.formats import Format

READ = "mrcal, COLMAP, OpenCV, ROS, Kalibr, nerfstudio, fSpy, Blender (docs/blender_camera.py)"
MRCAL = Format(
    "mrcal's cameramodel",
    ("any lens of mrcal's", "numbers as NumPy 2 shows them: np.float64(1.5)"),
    (("a lens that cannot be turned, of a photograph that EXIF turns", "save the photograph as viewers show it"),),
    ("optimization_inputs",),
)
FORMATS = (
    *(MRCAL, colmap.FORMAT, opencv.FORMAT, robots.FORMAT, nerfstudio.FORMAT, fspy.FORMAT, blender.FORMAT),
    camera_names.FORMAT,
)
HEAD = 100_000  # bytes that tell what a file is


def read(path, size, image=None, turn=1) -> Found:
    """Any of these files, or a folder of COLMAP's, in the pixels that viewers show.

    size : (width, height) px of the photograph as viewers show it;  turn : EXIF's orientation of it, 1 to 8
    image : the photograph's name in a reconstruction, or which camera of several.
    BadInput: none of them, of another size, or what is not read
    """
    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: there is no such file")
    found = _read(path, size, image)
    check(path, found)
    found = of_photograph(path, found, size, turn)
    return doubted(found)


def _read(path, size, image):
    if path.is_dir() or colmap.is_file(path):
        return colmap.read(path, image)
    content = bounded.content(path)
    bounded.check_utf16(path, content)
    head = content[:HEAD]
    start = re.sub(rb"\A(\xef\xbb\xbf|\s|#[^\n]*(\n|\Z))+", b"", head)  # without comments
    if head.startswith(fspy.MAGIC):
        return _fspy(path)
    if re.search(rb"""["']lensmodel["']\s*:""", head) or re.match(rb"\{\s*(#[^\n]*\n\s*)*'", start):
        return _mrcal(path)
    if line := camera_names.of(head):
        raise BadInput(f"{path}: is {line}")
    if start.startswith((b"{", b"[")):
        return _of_json(path, content, size, image)
    if start.startswith(b"<") or re.match(rb"""%YAML|---|["']?[\w.]+["']? *:(\s|\Z)""", start):
        return _of_table(path, storage.read(path, content), image)
    try:
        return _mrcal(path)
    except BadInput as bad:
        raise BadInput(*(f"{problem}; read are {READ}" for problem in bad.problems)) from None


def _of_json(path, content, size, image):
    told = bounded.json_of(path, content)
    if nerfstudio.is_one(told):
        return nerfstudio.read(path, told, size, image)
    if isinstance(told, dict) and ("cameraTransform" in told or "cameraParameters" in told):
        return _fspy(path)
    if isinstance(told, dict) and "matrix_world" in told:
        return blender.read(path)
    return _of_table(path, storage.read(path, content), image)


def _of_table(path, table, image):
    for reader in (robots, opencv):
        if reader.is_one(table):
            return reader.read(path, table, image)
    listed = ", ".join(f"{name:.40}" for name in table.names[:6])
    raise BadInput(
        f"{path}: is no camera that is known ({listed or 'no names'}): {camera_names.NUMBERS}; read are {READ}"
    )


def _fspy(path):
    camera, said = fspy.read(path)
    K = [camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]]
    size = camera.width, camera.height
    return Found("fSpy", "LENSMODEL_PINHOLE", np.array(K), *size, camera.T_cam_world, said, stored=False)


def _mrcal(path):
    lens = lenses.read(path)
    return Found("mrcal", lens.model, lens.intrinsics, lens.width, lens.height, lens.T_cam_ref)
