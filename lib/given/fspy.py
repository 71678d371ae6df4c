"""fSpy's cameras: its JSON export, and its project files, whose camera may have to be solved from the control points.

fSpy's plane of the picture: (0, 0) in the middle, y up, 1 at half the *longer* side. Its focal length and what it calls
the horizontal field of view are of that side. The camera looks along -z, y up; `cameraTransform` takes it to the world.
"""

from __future__ import annotations

import struct

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given.cameras import Camera

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
MAGIC = b"fspy"
METRES = {"Millimeters": 1e-3, "Centimeters": 1e-2, "Meters": 1.0, "Kilometers": 1e3, "Inches": 0.0254}
METRES |= {"Feet": 0.3048, "Miles": 1609.344, "No unit": 1.0}
UNREADABLE = (ValueError, KeyError, TypeError, IndexError, AttributeError, ArithmeticError, struct.error)
DISTANCE = 10.0  # to the origin, where no distance is told
AXES = {f"{'xyz'[k]}{sign}": s * np.eye(3)[k] for k in range(3) for sign, s in (("Positive", 1), ("Negative", -1))}


def read(path) -> Camera:
    """The camera of a .fspy project or of fSpy's JSON. BadInput: not one, or control points that tell no camera."""
    content = bounded.content(path)
    try:
        if content.startswith(MAGIC):
            version, size, _ = struct.unpack_from("<III", content, 4)
            if version != 1:
                raise BadInput(f"{path}: version {version} of fSpy's projects is not known")
            state = bounded.json_of(path, content[16 : 16 + size])
            metres = METRES[state["calibrationSettingsBase"].get("referenceDistanceUnit", "No unit")]
            told = state.get("cameraParameters")
            solved = _told(told) if told else _solved(path, state)
        else:
            told = bounded.json_of(path, content)
            metres = 1.0
            solved = _told(told.get("cameraParameters", told))
    except UNREADABLE as error:
        raise BadInput(f"{path}: not a readable file of fSpy: {type(error).__name__}: {error}") from None
    f, (x, y), T_view, width, height = solved
    unit = max(width, height) / 2
    K = np.array([[f * unit, 0, width / 2 + x * unit - 0.5], [0, f * unit, height / 2 - y * unit - 0.5], [0, 0, 1]])
    T = FLIP @ T_view
    T[:3, 3] *= metres
    if not (np.isfinite(T).all() and np.isfinite(K).all() and f > 0):
        raise BadInput(f"{path}: the camera is not finite")
    return Camera(K, width, height, T)


def _told(told):
    """(focal length, principal point (2,), T_view (4, 4), width, height) of `cameraParameters`."""
    T = np.array(told["cameraTransform"]["rows"], float).reshape(4, 4)
    f = 1 / np.tan(float(told["horizontalFieldOfView"]) / 2)
    P = _point(told["principalPoint"])
    return f, P, np.linalg.inv(T), int(told["imageWidth"]), int(told["imageHeight"])


def _point(value):
    return np.array([float(value["x"]), float(value["y"])])


def _solved(path, state):
    """The same from control points: two vanishing points, or one with a focal length and the horizon."""
    image = state.get("imageState") or state.get("image") or {}
    width, height = int(image["width"]), int(image["height"])
    flat = lambda point: _plane(_point(point), width, height)
    base, settings = state["controlPointsStateBase"], state["calibrationSettingsBase"]
    mode = state["globalSettings"]["calibrationMode"]
    first = base["firstVanishingPoint"]["lineSegments"]
    if mode == "TwoVanishingPoints":
        own, points = state["calibrationSettings2VP"], state["controlPointsState2VP"]
        second = points["secondVanishingPoint"]["lineSegments"]
        if own["quadModeEnabled"]:
            second = [[first[0][0], first[1][0]], [first[0][1], first[1][1]]]
        U, V = (_meeting(path, lines, flat) for lines in (first, second))
        P = np.zeros(2)
        if own["principalPointMode"] == "Manual":
            P = flat(base["principalPoint"])
        elif own["principalPointMode"] == "FromThirdVanishingPoint":
            P = _orthocentre(U, V, _meeting(path, points["thirdVanishingPoint"]["lineSegments"], flat))
        square = -(U - P) @ (V - P)
        if not square > 0:
            raise BadInput(f"{path}: the vanishing points tell no focal length: they are of no right angle")
        f = np.sqrt(square)
    else:
        own, points = state["calibrationSettings1VP"], state["controlPointsState1VP"]
        sensor = settings["cameraData"]
        preset = sensor.get("presetData") if sensor.get("presetId") else None
        sides = [preset["sensorWidth"], preset["sensorHeight"]] if preset else None
        sides = sides or [sensor["customSensorWidth"], sensor["customSensorHeight"]]
        f = 2 * float(own["absoluteFocalLength"]) / max(map(float, sides))
        P = flat(base["principalPoint"]) if own["principalPointMode"] == "Manual" else np.zeros(2)
        U = _meeting(path, first, flat)
        a, b = map(flat, points["horizon"])
        along = (b - a) / np.linalg.norm(b - a)
        V = U - along * ((U - P) @ (U - P) + f**2) / ((U - P) @ along)
    R = _rotation(U - P, V - P, f, *(AXES[settings[f"{which}VanishingPointAxis"]] for which in ("first", "second")))
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = DISTANCE * np.append((flat(base["origin"]) - P) / f, -1)
    if axis := settings.get("referenceDistanceAxis"):
        T[:3, 3] *= float(settings["referenceDistance"]) / _distance(base, T, P, f, AXES[axis], width, height)
    return f, P, T, width, height


def _plane(relative, width, height):
    """Relative coordinates (0 to 1, y down) -> fSpy's plane."""
    return (2 * relative - 1) * np.array([width, -height]) / max(width, height)


def _relative(plane, width, height):
    return (plane * max(width, height) / np.array([width, -height]) + 1) / 2


def _meeting(path, lines, flat):
    """Where two lines of the picture meet, in fSpy's plane."""
    a, b = (np.cross(*(np.append(flat(p), 1) for p in line)) for line in lines)
    x, y, w = np.cross(a, b)
    if not abs(w) > 1e-12 * np.hypot(x, y):
        raise BadInput(f"{path}: the lines of a vanishing point are parallel: draw them along other edges")
    return np.array([x, y]) / w


def _orthocentre(a, b, c):
    return np.linalg.solve(np.array([b - c, a - c]), np.array([a @ (b - c), b @ (a - c)]))


def _rotation(u, v, f, first, second):
    """World to view, where the axes `first` and `second` of the world vanish at u and v (about the principal point)."""
    u, v = (np.append(w, -f) / np.linalg.norm(np.append(w, -f)) for w in (u, v))
    return np.column_stack([u, v, np.cross(u, v)]) @ np.array([first, second, np.cross(first, second)])


def _distance(base, T, P, f, axis, width, height):
    """Between the two handles on a line along `axis`, the anchor being on the plane through the origin across it."""
    ray = lambda place: T[:3, :3].T @ np.append((_plane(place, width, height) - P) / f, -1)
    centre = -T[:3, :3].T @ T[:3, 3]
    anchor = _point(base["referenceDistanceAnchor"])
    towards = ray(anchor)
    start = centre - towards * (centre @ axis) / (towards @ axis)
    vanishing = T[:3, :3] @ axis
    vanishing = _relative(P - f * vanishing[:2] / vanishing[2], width, height)
    along = (vanishing - anchor) / np.linalg.norm(vanishing - anchor)
    ends = []
    for offset in base["referenceDistanceHandleOffsets"]:
        d = ray(anchor + float(offset) * along)
        ends.append(np.linalg.lstsq(np.column_stack([axis, -d]), centre - start, rcond=None)[0][0])
    return abs(ends[0] - ends[1])
