"""Cameras that people have: mrcal, COLMAP, fSpy, Blender (by our script) and OpenCV, as mrcal's cameramodel.

Pixel (0, 0) is the centre of the first pixel here and in OpenCV; COLMAP and Blender count from its corner, so half a
pixel is taken off their principal points.
"""

from __future__ import annotations

import math
import struct
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.core import bounded, yaml_file
from lib.core.stage import BadInput
from lib.given import fspy, lenses
from lib.given.cameras import FARTHEST, SHORTEST_PX, matrix_from_rt, rt_from_matrix

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
# COLMAP's models: their number, the place of each of fx, fy, cx, cy, and of the parameters of mrcal's lens (-1: 0)
COLMAP = {
    "SIMPLE_PINHOLE": (0, (0, 0, 1, 2), ()),
    "PINHOLE": (1, (0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": (2, (0, 0, 1, 2), (3, -1, -1, -1)),
    "RADIAL": (3, (0, 0, 1, 2), (3, 4, -1, -1)),
    "OPENCV": (4, (0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": (6, (0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
}
COUNT = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "FULL_OPENCV": 12}
OF_OPENCV = {0: "PINHOLE", 4: "OPENCV4", 5: "OPENCV5", 8: "OPENCV8", 12: "OPENCV12"}


@dataclass(frozen=True, eq=False)
class Found:
    """intrinsics : fx, fy, cx, cy, then the lens's own;  T : (4, 4) model to camera, None where only a lens is told"""

    kind: str
    lens: str
    intrinsics: np.ndarray
    width: int
    height: int
    T: np.ndarray | None

    @property
    def name(self):
        """Of the file in the scene's folder."""
        return "left.cameramodel" if self.T is None else "left.posed.cameramodel"

    def write(self, path):
        """As mrcal would."""
        rt = np.zeros(6) if self.T is None else rt_from_matrix(self.T)
        row = lambda values: " ".join(f"{float(v)!r}," for v in values)
        Path(path).write_text(
            f"# from {self.kind}\n{{ 'lensmodel': '{self.lens}',\n  'intrinsics': [ {row(self.intrinsics)} ],\n"
            f"  'extrinsics': [ {row(rt)} ],\n  'imagersize': [ {self.width}, {self.height} ] }}\n",
            encoding="utf-8",
        )

    def project(self, p):
        """(N, 3) m, model -> (N, 2) px."""
        T = np.eye(4) if self.T is None else self.T
        lens = lenses.Lens(self.lens, self.intrinsics, self.width, self.height, T, self.kind)
        return lens.project(np.asarray(p, float) @ T[:3, :3].T + T[:3, 3])


def read(path, size, image=None) -> Found:
    """Any of these files, or a folder of COLMAP's. size : (width, height) px of the photograph

    image : the photograph's name in a COLMAP reconstruction.  BadInput: none of them, or of another size
    """
    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: there is no such file")
    found = _read(path, size, image)
    _check(path, found)
    if (found.width, found.height) != tuple(size):
        raise BadInput(
            f"{path}: size: {found.width} x {found.height} is not the photograph's {size[0]} x {size[1]}: "
            "a camera is of one photograph, at its full size, turned as viewers turn it"
        )
    return found


def _check(path, found):
    """BadInput: numbers that no camera has, or a pose that is no rotation and translation."""
    T = np.eye(4) if found.T is None else found.T
    for name, values in (("intrinsics", found.intrinsics), ("pose", T)):
        if not (np.abs(values) <= FARTHEST).all():
            raise BadInput(f"{path}: {name}: {np.ravel(values).tolist()!r:.80} are not numbers of at most {FARTHEST:g}")
    if min(found.intrinsics[:2]) < SHORTEST_PX:
        raise BadInput(f"{path}: focal length: {found.intrinsics[:2].tolist()} px is not positive")
    if not np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() < 1e-3 or np.linalg.det(T[:3, :3]) < 0:
        raise BadInput(f"{path}: pose: {T[:3, :3].ravel().tolist()!r:.80} is no rotation")


def _read(path, size, image):
    if path.is_dir() or path.name.split(".")[0] in ("cameras", "images") and path.suffix in (".txt", ".bin"):
        return _colmap(path if path.is_dir() else path.parent, image)
    head = bounded.content(path)[:4000]
    if head.startswith(fspy.MAGIC) or b'"cameraTransform"' in head or b'"cameraParameters"' in head:
        camera = fspy.read(path)
        K = [camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]]
        return Found("fSpy", "LENSMODEL_PINHOLE", np.array(K), camera.width, camera.height, camera.T_cam_world)
    if b'"matrix_world"' in head:
        return _blender(path)
    if b"camera_matrix" in head or b"cameraMatrix" in head or b"opencv-matrix" in head or b"opencv_storage" in head:
        return _opencv(path, size)
    lens = lenses.read(path)
    return Found("mrcal", lens.model, lens.intrinsics, lens.width, lens.height, lens.T_cam_ref)


# ---- COLMAP ----


def _colmap(folder, image):
    cameras, images = (_table(folder, name) for name in ("cameras", "images"))
    names = sorted(images)
    if image is None and len(names) == 1:
        image = names[0]
    if image not in images:
        more = f" and {len(names) - 5} more" if len(names) > 5 else ""
        asked = "say which: " if image is None else f"{image} is not there; "
        raise BadInput(f"{folder}: IMAGE: {asked}IMAGE=... is one of {', '.join(names[:5])}{more}")
    camera, q, t = images[image]
    if camera not in cameras:
        raise BadInput(f"{folder}: images: {image}: camera {camera} is not among the cameras")
    model, width, height, params = cameras[camera]
    if model not in COLMAP:
        raise BadInput(
            f"{folder}: camera {camera}: {model}: run COLMAP's image_undistorter; read are {', '.join(COLMAP)}"
        )
    if len(params) != COUNT[model]:
        raise BadInput(f"{folder}: camera {camera}: {model} has {COUNT[model]} parameters, {len(params)} are there")
    _, place, more = COLMAP[model]
    intrinsics = np.array([params[k] for k in place] + [params[k] if k >= 0 else 0.0 for k in more])
    intrinsics[2:4] -= 0.5
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _of_quaternion(q), t
    lens = f"LENSMODEL_{OF_OPENCV[len(more)]}"
    return Found("COLMAP", lens, intrinsics, width, height, T)


def _of_quaternion(q):
    from scipy.spatial.transform import Rotation

    w, x, y, z = q
    if not 1e-9 < np.linalg.norm(q) < FARTHEST:
        return np.zeros((3, 3))  # refused as no rotation
    return Rotation.from_quat([x, y, z, w]).as_matrix()


def _table(folder, name):
    """cameras: {number: (model, width, height, parameters)};  images: {file: (camera, quaternion, translation)}"""
    text, binary = folder / f"{name}.txt", folder / f"{name}.bin"
    try:
        if binary.is_file():
            return (_cameras_bin if name == "cameras" else _images_bin)(bounded.content(binary))
        if text.is_file():
            lines = [x for x in bounded.text(text).split("\n") if not x.startswith("#")]
            return (_cameras_txt if name == "cameras" else _images_txt)(lines)
    except (ValueError, IndexError, KeyError, ArithmeticError, struct.error) as error:
        raise BadInput(f"{folder / name}: not readable: {type(error).__name__}: {error}") from None
    raise BadInput(f"{folder}: {name}.txt or {name}.bin is missing: COLMAP's cameras and images are both needed")


def _cameras_txt(lines):
    rows = [line.split() for line in lines if line.strip()]
    return {int(r[0]): (r[1], int(r[2]), int(r[3]), [float(v) for v in r[4:]]) for r in rows}


def _images_txt(lines):
    """Two lines for each image, the second of which, its points, may be empty."""
    found, lines = {}, list(lines)
    while lines and not lines[-1].strip():
        lines.pop()
    for line in lines[::2]:
        row = line.split(None, 9)
        found[row[9].strip()] = (int(row[8]), [float(v) for v in row[1:5]], [float(v) for v in row[5:8]])
    return found


def _cameras_bin(data):
    models = {number: name for name, (number, _, _) in COLMAP.items()}
    (n,), at, found = struct.unpack_from("<Q", data), 8, {}
    for _ in range(n):
        camera, model, width, height = struct.unpack_from("<IiQQ", data, at)
        at += 24
        if model not in models:
            raise ValueError(f"camera {camera} has the model number {model}: run COLMAP's image_undistorter")
        count = COUNT[models[model]]
        found[camera] = (models[model], width, height, list(struct.unpack_from(f"<{count}d", data, at)))
        at += 8 * count
    return found


def _images_bin(data):
    (n,), at, found = struct.unpack_from("<Q", data), 8, {}
    for _ in range(n):
        _, *pose, camera = struct.unpack_from("<I7dI", data, at)
        end = data.index(b"\0", at + 64)
        name = data[at + 64 : end].decode("utf-8")
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points
        found[name] = (camera, pose[:4], pose[4:])
    return found


# ---- Blender and OpenCV ----


def _blender(path):
    """What docs/blender_camera.py writes."""
    try:
        told = bounded.json_of(path, bounded.content(path))
        lens, (sx, sy) = told["lens_px"], told["shift_px"]
        width, height = told["size_px"]
        T = FLIP @ np.linalg.inv(np.array(told["matrix_world"], float).reshape(4, 4))
        K = np.array([lens[0], lens[1], width / 2 - sx - 0.5, height / 2 + sy - 0.5], float)
        width, height = int(width), int(height)
    except (ValueError, KeyError, TypeError, IndexError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise BadInput(f"{path}: not a camera of docs/blender_camera.py: {type(error).__name__}: {error}") from None
    return Found("Blender", "LENSMODEL_PINHOLE", K, width, height, T)


OPENCV_NAMES = {
    "K": ("camera_matrix", "cameraMatrix", "K"),
    "D": ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D"),
    "r": ("rvec", "rotation"),
    "t": ("tvec", "translation"),
    "width": ("image_width", "imageWidth"),
    "height": ("image_height", "imageHeight"),
}


def _opencv(path, size):
    """camera_matrix, distortion_coefficients, image_width, image_height, perhaps rvec and tvec.

    Our own reader: OpenCV's ends the process at a file of nested brackets.
    """
    told = _storage(path)
    value = {key: next((told[n] for n in names if n in told), None) for key, names in OPENCV_NAMES.items()}
    K, D, r, t = (_matrix(path, OPENCV_NAMES[key][0], value[key]) for key in "KDrt")
    if K is None or K.size != 9:
        raise BadInput(f"{path}: camera_matrix: 3 x 3 numbers are needed")
    K, D = K.reshape(3, 3), np.zeros(0) if D is None else D.ravel()
    if len(D) not in OF_OPENCV:
        raise BadInput(f"{path}: distortion_coefficients: {len(D)} numbers; read are {', '.join(map(str, OF_OPENCV))}")
    T = None
    if r is not None and t is not None:
        if r.size not in (3, 9) or t.size != 3:
            raise BadInput(f"{path}: rvec, tvec: {r.size} and {t.size} numbers instead of 3 (or 9) and 3")
        T = matrix_from_rt(np.concatenate([r.ravel()[:3], t.ravel()]))
        T[:3, :3] = r.reshape(3, 3) if r.size == 9 else T[:3, :3]
    intrinsics = np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], D])
    lens = f"LENSMODEL_{OF_OPENCV[len(D)]}"
    sides = [value["width"], value["height"]]
    sides = [
        int(told) if isinstance(told, int | float) and abs(told) < FARTHEST else own
        for told, own in zip(sides, size, strict=True)
    ]
    return Found("OpenCV", lens, intrinsics, *sides, T)


def _storage(path) -> dict:
    """What OpenCV's FileStorage wrote, by name: YAML, JSON or XML."""
    content = bounded.content(path, bounded.LARGEST_TEXT)
    start = content.lstrip(b"\xef\xbb\xbf \t\r\n")
    if start.startswith(b"<"):
        try:
            return {element.tag: _of_element(element) for element in ElementTree.fromstring(content)}
        except (ElementTree.ParseError, ValueError) as error:
            raise BadInput(f"{path}: not readable XML: {error}") from None
    if start.startswith(b"{"):
        told = bounded.json_of(path, content)
        return told if isinstance(told, dict) else {}
    names = [name for several in OPENCV_NAMES.values() for name in several]
    return yaml_file.read_opencv(path, bounded.text_of(path, content), names)


def _of_element(element):
    """A number, a list of numbers, or a table; None of what is none of these."""
    if len(element):
        return {child.tag: _of_element(child) for child in element}
    try:
        numbers = [float(word) for word in (element.text or "").split()]
    except ValueError:
        return None
    return numbers[0] if len(numbers) == 1 and element.tag != "data" else numbers


def _matrix(path, name, value):
    """An OpenCV matrix, or a plain list of numbers or of rows; None where there is none."""
    if value is None:
        return None
    try:
        data = np.array(value["data"] if isinstance(value, dict) else value, float)
        if isinstance(value, dict):
            sides = value["sizes"] if "sizes" in value else [value["rows"], value["cols"]]
            if list(sides) != [int(side) for side in sides] or data.size != math.prod(sides):
                raise ValueError(f"{data.size} numbers instead of {' x '.join(map(str, sides)):.40}")
        return data
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise BadInput(f"{path}: {name}: no matrix: {type(error).__name__}: {error}") from None
