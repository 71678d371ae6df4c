"""COLMAP's reconstructions, text or binary: the camera of one image.

COLMAP counts pixels from the picture's corner, so half a pixel is taken off. Rigs and frames (COLMAP 3.12 and later)
need no reading: images keep their own poses beside them.
"""

from __future__ import annotations

import struct
from pathlib import PurePosixPath

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given.cameras import FARTHEST
from lib.given.foreign_cameras.found import Found
from lib.given.formats import Format

# The models that are read: the place of each of fx, fy, cx, cy, and of the parameters of mrcal's lens (-1: 0)
READ = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3, -1, -1, -1)),
    "RADIAL": ((0, 0, 1, 2), (3, 4, -1, -1)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
}
# All models of COLMAP 4.2 by their number, and how many parameters each has
MODELS = (
    *(("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8)),
    *(("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4), ("RADIAL_FISHEYE", 5)),
    *(("THIN_PRISM_FISHEYE", 12), ("RAD_TAN_THIN_PRISM_FISHEYE", 16), ("SIMPLE_DIVISION", 4), ("DIVISION", 5)),
    *(("SIMPLE_FISHEYE", 3), ("FISHEYE", 4), ("EUCM", 6), ("EQUIRECTANGULAR", 2)),
)
COUNT = dict(MODELS)
LENSES = {0: "PINHOLE", 4: "OPENCV4", 8: "OPENCV8"}
FOLDERS = ("", "sparse", "colmap/sparse", "colmap", "dense/sparse", "distorted/sparse")  # where tools put models
MOST_MODELS = 200  # folders with numbers that are looked at
UNDISTORT = "run COLMAP's image_undistorter, and give its folder and its picture"

FORMAT = Format(
    "COLMAP's reconstruction",
    (
        "cameras and images, text or binary, of COLMAP up to 4.2",
        f"the models {', '.join(READ)}",
        "images.txt with or without the lines of points",
        "the folder itself, or one with sparse/0 in it",
    ),
    (("other models (fisheyes, FOV, division, EUCM, equirectangular)", UNDISTORT),),
    ("points", "rigs and frames: images keep their own poses"),
)


def is_file(path) -> bool:
    """A file of a reconstruction, by its name."""
    names = ("cameras", "images", "points3D", "rigs", "frames")
    return path.suffix in (".txt", ".bin") and path.name.split(".")[0] in names


def read(path, image) -> Found:
    """path : a folder, or a file of a model;  image : the photograph's name in it. BadInput: none, or which is open"""
    if path.is_dir():
        return _of_folder(path, image)
    return _of_model(path.parent, image, path.suffix)


def _of_folder(path, image):
    folders = models_below(path)
    if not folders:
        raise BadInput(f"{path}: cameras.txt or cameras.bin is missing, and images: no reconstruction of COLMAP's")
    if len(folders) == 1:
        found = _of_model(folders[0], image)
        return found if folders[0] == path else found.saying(f"read of {folders[0].relative_to(path)}")
    holds = {folder: _table(folder, "images", _form(folder)[0]) for folder in folders}
    having = [folder for folder in folders if image and len(_matching(holds[folder], image)) == 1]
    if len(having) == 1:
        return _of_model(having[0], image).saying(f"read of {having[0].relative_to(path)}, which alone has {image}")
    which = ", ".join(f"{folder.relative_to(path)} ({len(holds[folder])} images)" for folder in (having or folders)[:5])
    why = f"{len(having)} of them have {image}" if having else f"none has {image}" if image else "IMAGE is not told"
    raise BadInput(f"{path}: holds {len(folders)} reconstructions, and {why}: give one as CAMERA=: {which}")


def models_below(path):
    """The folders with a reconstruction: this one, or those that tools put below it."""
    if _has_model(path):
        return [path]
    for name in FOLDERS:
        folder = path / name
        if _has_model(folder):
            return [folder]
        if not folder.is_dir():
            continue
        numbered = sorted((f for f in folder.iterdir() if f.name.isdigit()), key=lambda f: (len(f.name), f.name))
        if models := [f for f in numbered[:MOST_MODELS] if _has_model(f)]:
            return models
    return []


def _has_model(folder):
    return any((folder / f"{name}{form}").is_file() for name in ("cameras", "images") for form in (".bin", ".txt"))


def _form(folder, asked=None):
    """(".bin" or ".txt", lines to say). Where both are there, COLMAP reads the binary ones."""
    has = {f: all((folder / f"{name}{f}").is_file() for name in ("cameras", "images")) for f in (".bin", ".txt")}
    if asked and has[asked]:
        return asked, ()
    if all(has.values()):
        return ".bin", ("both .bin and .txt are there: the .bin files are read, as COLMAP does",)
    for form in (".bin", ".txt"):
        if has[form]:
            return form, ()
    there = next(f for f in (".bin", ".txt") for n in ("cameras", "images") if (folder / f"{n}{f}").is_file())
    name = "images" if (folder / f"cameras{there}").is_file() else "cameras"
    raise BadInput(f"{folder}: {name}.txt or {name}.bin is missing: COLMAP's cameras and images are both needed")


def _of_model(folder, image, asked=None):
    form, said = _form(folder, asked)
    cameras, images = (_table(folder, name, form) for name in ("cameras", "images"))
    image, lines = _chosen(folder, images, image)
    camera, q, t = images[image]
    if camera not in cameras:
        raise BadInput(f"{folder}: images: {image}: camera {camera} is not among the cameras")
    model, width, height, params = cameras[camera]
    if model not in READ:
        raise BadInput(f"{folder}: camera {camera}: {model}: {UNDISTORT}; read are {', '.join(READ)}")
    if len(params) != COUNT[model]:
        raise BadInput(f"{folder}: camera {camera}: {model} has {COUNT[model]} parameters, {len(params)} are there")
    place, more = READ[model]
    intrinsics = np.array([params[k] for k in place] + [params[k] if k >= 0 else 0.0 for k in more])
    intrinsics[2:4] -= 0.5
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = of_quaternion(q), t
    lens = f"LENSMODEL_{LENSES[len(more)]}"
    return Found("COLMAP", lens, intrinsics, width, height, T, (*said, *lines))


def _matching(names, asked):
    """The names that may be meant: the same one, else all of that base name, else without regard to case."""
    if asked in names:
        return [asked]
    base = lambda name: PurePosixPath(name.replace("\\", "/")).name
    same = [name for name in names if base(name) == base(asked)]
    return same or [name for name in names if base(name).lower() == base(asked).lower()]


def _chosen(folder, images, asked):
    """(the image that is meant, lines to say). BadInput: none, or one of several."""
    names = sorted(images)
    if not names:
        raise BadInput(f"{folder}: images: there are none in it")
    found = _matching(names, asked) if asked is not None else names
    if len(found) == 1:
        return found[0], () if asked in (None, found[0]) else (f"IMAGE: {asked} is {found[0]}",)
    listed = found if len(found) > 1 else names
    more = f" and {len(listed) - 5} more" if len(listed) > 5 else ""
    why = "say which: " if asked is None else f"{asked} is several: say which: " if found else f"{asked} is not there; "
    raise BadInput(f"{folder}: IMAGE: {why}IMAGE=... is one of {', '.join(listed[:5])}{more}")


def of_quaternion(q):
    """(w, x, y, z), of any length -> (3, 3)."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = q
    if not 1e-9 < np.linalg.norm(q) < FARTHEST:
        return np.zeros((3, 3))  # refused as no rotation
    return Rotation.from_quat([x, y, z, w]).as_matrix()


# ---- the tables ----


def _table(folder, name, form):
    """cameras: {number: (model, width, height, parameters)};  images: {file: (camera, quaternion, translation)}"""
    path = folder / f"{name}{form}"
    try:
        if form == ".bin":
            return (_cameras_bin if name == "cameras" else _images_bin)(bounded.content(path))
        lines = bounded.text(path).split("\n")
        return (_cameras_txt if name == "cameras" else _images_txt)(lines)
    except (ValueError, IndexError, KeyError, ArithmeticError, struct.error) as error:
        raise BadInput(f"{folder / name}: not readable: {type(error).__name__}: {error}") from None


def _cameras_txt(lines):
    rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    return {int(r[0]): (r[1], int(r[2]), int(r[3]), [float(v) for v in r[4:]]) for r in rows}


def _images_txt(lines):
    """An image has a line, and a second one with its points, which may be empty, or left out altogether."""
    found, points_may_follow = {}, False
    for number, line in enumerate(lines, 1):
        if line.startswith("#"):
            continue
        words = line.split(None, 9)
        if not words or (points_may_follow and _is_points(line)):
            points_may_follow = False
        elif _is_image(words):
            name = words[9].strip()
            if name in found:
                raise ValueError(f"line {number}: {name} is there twice")
            found[name] = (int(words[8]), [float(v) for v in words[1:5]], [float(v) for v in words[5:8]])
            points_may_follow = True
        else:
            raise ValueError(f"line {number}: neither an image of ten columns nor the points of one")
    return found


def _is_image(words):
    """IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME; the name may have blanks."""
    return len(words) == 10 and _is_whole(words[0]) and _is_whole(words[8]) and all(map(_is_number, words[1:8]))


def _is_points(line):
    """X Y POINT3D_ID, over and over."""
    words = line.split()
    first = words[:9]
    return len(words) % 3 == 0 and all(map(_is_whole, first[2::3])) and all(map(_is_number, first))


def _is_whole(word):
    return word.removeprefix("-").isdecimal()


def _is_number(word):
    try:
        float(word)
    except ValueError:
        return False
    return True


def _cameras_bin(data):
    (n,), at, found = struct.unpack_from("<Q", data), 8, {}
    for _ in range(n):
        camera, model, width, height = struct.unpack_from("<IiQQ", data, at)
        at += 24
        if not 0 <= model < len(MODELS):
            raise ValueError(f"camera {camera} has the model number {model}, which COLMAP 4.2 does not know")
        name, count = MODELS[model]
        found[camera] = (name, width, height, list(struct.unpack_from(f"<{count}d", data, at)))
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
