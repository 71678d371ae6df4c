"""transforms.json of nerfstudio and instant-ngp: the camera of one frame.

transform_matrix takes the camera to the world; the camera looks along -z, y up (OpenGL). Pixels are counted from the
picture's corner, so half a pixel is taken off. nerfstudio turns the frame of the tool before it, and says how in
applied_transform and applied_scale: that is undone, so that a model of that tool fits, as nerfstudio's exports do.
"""

from __future__ import annotations

import math
from pathlib import PurePosixPath

import numpy as np

from lib.core.stage import BadInput
from lib.given.foreign_cameras import opencv, storage
from lib.given.foreign_cameras.found import Found
from lib.given.formats import Format

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
PLANE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE", "FULL_OPENCV")
LENS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
UNREADABLE = (ValueError, KeyError, TypeError, IndexError, AttributeError, ArithmeticError, np.linalg.LinAlgError)

FORMAT = Format(
    "transforms.json of nerfstudio and instant-ngp",
    (
        "fl_x, fl_y, cx, cy, w, h or camera_angle_x; k1, k2, k3, p1, p2; of the file or of the frame",
        "the frame that IMAGE names",
        "applied_transform and applied_scale: undone",
    ),
    (
        ("fisheye, equirectangular and other models", "run ns-process-data without fisheye, or undistort first"),
        ("k4 and more", "undistort first"),
    ),
    ("depth maps, masks, points",),
)


def is_one(told) -> bool:
    """Is a JSON value one?"""
    return isinstance(told, dict) and isinstance(told.get("frames"), list)


def read(path, told, size, image) -> Found:
    """told : the JSON value;  size : of the photograph, where the file tells none. BadInput: none, or which is open"""
    try:
        frame, said = _frame(path, told["frames"], image)
        told = {**told, **frame}
        sides = storage.whole(told.get("w")), storage.whole(told.get("h"))
        _check_model(path, told)
        K = _matrix(path, told, *(size if None in sides else sides))
        lens, numbers, _ = opencv.of_numbers(path, K, _distortion(path, told))
        T, lines = _pose(told)
    except UNREADABLE as error:
        raise BadInput(f"{path}: not a readable transforms.json: {type(error).__name__}: {error}") from None
    return Found("nerfstudio", lens, numbers, *sides, T, (*said, *lines))


def _frame(path, frames, image):
    """(the frame that is asked for, lines to say)."""
    named = {str(frame.get("file_path", k)): frame for k, frame in enumerate(frames)}
    stem = lambda name: PurePosixPath(str(name).replace("\\", "/")).name.lower()
    without = lambda name: stem(name).rpartition(".")[0] or stem(name)
    same = list(named)
    if image is not None:
        same = [image] if image in named else [name for name in named if stem(name) == stem(image)]
        same = same or [name for name in named if without(name) == without(image)]
    if len(same) == 1:
        return named[same[0]], [] if image in (None, same[0]) else [f"IMAGE: {image} is {same[0]}"]
    listed = sorted(same or named)
    more = f" and {len(listed) - 5} more" if len(listed) > 5 else ""
    why = "say which: " if image is None or same else f"{image} is not there; "
    raise BadInput(f"{path}: IMAGE: {why}IMAGE=... is one of {', '.join(listed[:5])}{more}")


def _check_model(path, told):
    model = str(told.get("camera_model", "PERSPECTIVE")).upper()
    if model not in PLANE:
        raise BadInput(f"{path}: camera_model: {model:.40}: {opencv.UNDISTORT}; read are {', '.join(PLANE)}")
    if told.get("is_fisheye") or told.get("fisheye"):
        raise BadInput(f"{path}: is_fisheye: a fisheye: {opencv.UNDISTORT}")


def _matrix(path, told, width, height):
    """fx, fy, cx, cy; the centre of the first pixel is (0, 0)."""
    across, down = told.get("fl_x"), told.get("fl_y")
    if across is None and told.get("camera_angle_x") is not None:
        across = width / 2 / math.tan(float(told["camera_angle_x"]) / 2)
        if down is None and told.get("camera_angle_y") is not None:
            down = height / 2 / math.tan(float(told["camera_angle_y"]) / 2)
    if across is None:
        raise BadInput(f"{path}: fl_x: is missing, and camera_angle_x: the focal length is not told")
    down = across if down is None else down
    cx, cy = (told.get(name, side / 2) for name, side in (("cx", width), ("cy", height)))
    return np.array([across, down, cx - 0.5, cy - 0.5], float)


def _distortion(path, told):
    """OpenCV's k1 k2 p1 p2 k3, as few as there are."""
    k = {name: float(told.get(name) or 0) for name in LENS}
    if (listed := told.get("distortion_params")) is not None:
        k |= dict(zip(("k1", "k2", "k3", "k4", "p1", "p2"), map(float, listed), strict=False))
    if more := [name for name in ("k4", "k5", "k6") if k[name]]:
        raise BadInput(f"{path}: {more[0]}: {k[more[0]]:g} is of no lens that is read: undistort first")
    numbers = [k[name] for name in ("k1", "k2", "p1", "p2", "k3")]
    return numbers if k["k3"] else numbers[:4] if any(numbers) else []


def _pose(told):
    """((4, 4) world to camera, lines to say)."""
    T_world_cam = np.array(told["transform_matrix"], float)
    T_world_cam = np.vstack([T_world_cam, [0, 0, 0, 1]]) if T_world_cam.shape == (3, 4) else T_world_cam.reshape(4, 4)
    applied, scale = told.get("applied_transform"), float(told.get("applied_scale") or 1)
    said = ["its pose stands in the frame of transforms.json, which is the model's only if the model was made in it"]
    if applied is not None or scale != 1:
        A = np.eye(4)
        A[:3] = np.array(applied, float)[:3] if applied is not None else A[:3]
        T_world_cam[:3, 3] /= scale
        T_world_cam = np.linalg.inv(A) @ T_world_cam
        said = ["applied_transform is undone: its pose stands in the frame of the tool before nerfstudio (COLMAP's)"]
    return FLIP @ np.linalg.inv(T_world_cam), said
