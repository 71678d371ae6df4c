"""The sensor of a Mitsuba scene as the camera of the photograph.

Mitsuba's camera looks along z, with x to the left and y up; its film's pixels are counted from the corner.
"""

from __future__ import annotations

import numpy as np

from lib.given.foreign_cameras import Found
from lib.given.mitsuba_xml import Scene

FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])  # left, up, forward -> right, down, forward
FILM_PX = (768, 576)  # where none is told
FOCAL_LENGTH_MM, DIAGONAL_MM = "50mm", np.hypot(36.0, 24.0)  # where none is told; of the film that it is for
PINHOLES = ("perspective", "thinlens")
SIDE_PX = 0.5  # by which a film of the photograph's shape may be wider or higher
LARGEST_PX = 1e6
RIGID = 1e-4  # of 1: how far from a rotation Mitsuba itself takes to_world


def read(path, content, size) -> tuple[Found | None, list]:
    """(the camera at the size of the photograph, lines to say); None, and why, where the scene has none of that kind.

    size : (width, height) px of the photograph.  BadInput: numbers that no camera has
    """
    scene = Scene(path, content)
    sensors = scene.root.findall("sensor") + scene.root.findall("camera")
    if not sensors:
        return None, []
    sensor = sensors[0]
    kind = sensor.get("type")
    if kind not in PINHOLES:
        return None, [f"the scene's sensor is {kind}, which is no pinhole: it is not taken; give CAMERA"]
    width, height, crop = _film(scene, sensor)
    scale = size[0] / crop[0]
    if abs(scale * crop[1] - size[1]) > SIDE_PX * max(scale, 1):
        film = f"{crop[0]:g} x {crop[1]:g}"
        return None, [f"the scene's sensor has {film} px, which is not the shape of the photograph: it is not taken"]
    focal = width / 2 / np.tan(np.radians(_fov(scene, sensor, width / height)) / 2)
    # of perspective alone: Mitsuba refuses a thinlens with it
    offset = [scene.number(sensor, f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
    middle = np.array([width, height]) * (0.5 - np.array(offset)) - crop[2:]
    K = np.array([focal, focal, *middle]) * scale - [0, 0, 0.5, 0.5]
    T = FLIP @ np.linalg.inv(_pose(scene, sensor))
    said = [f"taken from the scene's sensor ({kind})"]
    if kind == "thinlens":
        radius = scene.number(sensor, "aperture_radius", 0.0)
        said.append(f"its aperture of radius {radius:g} is left out: a pinhole is sharp at every distance")
    if scale != 1:
        said.append(f"its film of {crop[0]:g} x {crop[1]:g} px is scaled by {scale:.4g}")
    return Found("Mitsuba", "LENSMODEL_PINHOLE", K, *size, T), said


def _film(scene, sensor):
    """(width, height of the film, (width, height, x, y) of its crop), px"""
    films = scene.named(sensor, "film")
    film = films[0] if films else sensor
    width, height = (scene.number(film, k, v) for k, v in zip(("width", "height"), FILM_PX, strict=True))
    crop = [scene.number(film, "crop_width", width), scene.number(film, "crop_height", height)]
    crop += [scene.number(film, f"crop_offset_{axis}", 0.0) for axis in "xy"]
    if not (min(width, height, *crop[:2]) >= 1 and max(width, height, *crop) <= LARGEST_PX and min(crop[2:]) >= 0):
        scene.refuse(f"sensor: film: {width:g} x {height:g} px, crop {crop}: no size of a picture")
    return width, height, np.array(crop)


def _fov(scene, sensor, aspect):
    """Degrees across the whole film."""
    told = scene.value(sensor, "fov")
    if told is not None and scene.value(sensor, "focal_length") is not None:
        scene.refuse("sensor: fov and focal_length are both told: leave one out")
    if told is not None:
        fov, axis = scene.number(sensor, "fov", 0.0), (scene.value(sensor, "fov_axis") or "x").strip().lower()
        axis = {"smaller": "y" if aspect > 1 else "x", "larger": "x" if aspect > 1 else "y"}.get(axis, axis)
    else:
        mm = (scene.value(sensor, "focal_length") or FOCAL_LENGTH_MM).strip()
        length = scene.numbers("sensor: focal_length", mm.removesuffix("mm"), 1)[0]
        fov, axis = np.degrees(2 * np.arctan2(DIAGONAL_MM, 2 * length)), "diagonal"
    if not 0 < fov < 180:
        scene.refuse(f"sensor: fov: {fov:g} degrees is none of a pinhole")
    half = np.tan(np.radians(fov) / 2)
    if axis not in ("x", "y", "diagonal"):
        scene.refuse(f"sensor: fov_axis: {axis:.80} is none of x, y, diagonal, smaller, larger")
    half *= {"x": 1.0, "y": aspect, "diagonal": aspect / np.hypot(aspect, 1.0)}[axis]
    return np.degrees(2 * np.arctan(half))


def _pose(scene, sensor):
    """(4, 4) camera to world, in Mitsuba's axes."""
    M = scene.placed(sensor)
    if np.abs(M[:3, :3].T @ M[:3, :3] - np.eye(3)).max() > 10 * RIGID:
        scene.refuse("sensor: to_world scales, which Mitsuba refuses: leave the scale out, or give CAMERA")
    if np.linalg.det(M[:3, :3]) < 0:
        scene.refuse("sensor: to_world mirrors the picture: give a photograph and a CAMERA that are not mirrored")
    U, _, V = np.linalg.svd(M[:3, :3])
    M[:3, :3] = U @ V
    return M
