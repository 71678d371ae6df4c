"""fSpy's cameras: its JSON export, and its project files, whose camera may have to be solved from the control points.

fSpy's plane of the picture: (0, 0) in the middle, y up, 1 at half the *longer* side. Its focal length and what it calls
the horizontal field of view are of that side. The camera looks along -z, y up; `cameraTransform` takes it to the world.
"""

from __future__ import annotations

import io
import struct

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import picture_files
from lib.given.cameras import Camera
from lib.given.formats import Format

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
MAGIC = b"fspy"
METRES = {"Millimeters": 1e-3, "Centimeters": 1e-2, "Meters": 1.0, "Kilometers": 1e3, "Inches": 0.0254}
METRES |= {"Feet": 0.3048, "Yards": 0.9144, "Miles": 1609.344, "No unit": 1.0}
UNREADABLE = (ValueError, KeyError, TypeError, IndexError, AttributeError, ArithmeticError, struct.error)
DISTANCE = 10.0  # to the origin, where no distance is told
AXES = {f"{'xyz'[k]}{sign}": s * np.eye(3)[k] for k in range(3) for sign, s in (("Positive", 1), ("Negative", -1))}
SAVE = "open it in fSpy 1.0.3 and save it"
PICTURES = (b"\x89PNG", b"\xff\xd8")  # whose headers are read
# The sides in mm of the sensors that fSpy knows by name; older projects hold the name alone
SENSORS = {
    **dict.fromkeys(("canon_1ds", "canon_5d", "35_mm_film"), (36, 24)),
    **dict.fromkeys(("aps-c", "canon_7d", "canon_60d", "canon_500d", "canon_550d", "canon_600d"), (22.3, 14.9)),
    **{"canon_1d": (27.9, 18.6), "canon_1100d": (22.2, 14.7), "canon_g7x_mk2": (13.2, 8.8), "micro_4_3rds": (17.3, 14)},
    **{"nikon_d3s": (36, 23.9), "nikon_d3100": (23.1, 15.4), "sony_a55": (23.4, 15.6), "iphone_6s": (4.8, 3.6)},
    **dict.fromkeys(("nikon_d90", "nikon_d300s", "nikon_d5000"), (23.6, 15.8)),
    **dict.fromkeys(("nikon_d5100", "nikon_d7000"), (23.6, 15.6)),
    **{"red_epic": (30, 15), "red_epic_2k": (11.1, 6.24), "red_epic_3k": (16.65, 9.36), "red_epic_4k": (22.2, 12.6)},
}

FORMAT = Format(
    "fSpy's project or JSON",
    (
        "cameraParameters",
        "projects without them: solved from one or two vanishing points, as fSpy does, in the size of their picture",
    ),
    (("projects that tell too little for a camera", SAVE),),
    ("the picture in the project",),
)


def read(path) -> tuple[Camera, tuple[str, ...]]:
    """(the camera of a .fspy project or of fSpy's JSON, lines to say).

    BadInput: not one, or control points that tell no camera
    """
    content = bounded.content(path)
    try:
        if content.startswith(MAGIC):
            solved, metres, said = _of_project(path, content)
        else:
            told = bounded.json_of(path, content)
            metres, said = 1.0, ("fSpy's JSON tells no unit: read as metres",)
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
    return Camera(K, width, height, T), said


def _of_project(path, content):
    """(what `_told` gives, metres of a unit, lines to say)."""
    version, size, _ = struct.unpack_from("<III", content, 4)
    if version != 1:
        raise BadInput(f"{path}: version {version} of fSpy's projects is not known")
    state = bounded.json_of(path, content[16 : 16 + size])
    settings = state.get("calibrationSettingsBase") or {}
    unit = settings.get("referenceDistanceUnit") or "No unit"
    if unit not in METRES:
        raise BadInput(f"{path}: referenceDistanceUnit: {unit!r:.40} is none of {', '.join(METRES)}")
    said = []
    if not settings.get("referenceDistanceAxis"):
        said.append(f"no reference distance is set in fSpy: its origin is put {DISTANCE:g} units away, of any size")
    elif unit == "No unit":
        said.append("the reference distance has no unit: read as metres")
    told = state.get("cameraParameters")
    if told:
        return _told(told), METRES[unit], tuple(said)
    try:
        solved = _solved(path, state, _size(path, state, content[16 + size :]))
    except UNREADABLE as error:
        why = f"{error} is missing" if isinstance(error, KeyError) else f"{type(error).__name__}: {error}"
        raise BadInput(f"{path}: has no cameraParameters, and too little to solve for them: {why}: {SAVE}") from None
    return solved, METRES[unit], (*said, "no cameraParameters in the project: solved from its control points")


def _size(path, state, picture):
    """(width, height) px of the project's picture, as it tells them, or as the picture in it is stored.

    fSpy 1.0.3 shows a picture as it is stored, whatever its EXIF says (issues 44 and 57 of stuffmatic/fSpy).
    """
    told = state.get("imageState") or state.get("image") or {}
    if told.get("width") and told.get("height"):
        return int(told["width"]), int(told["height"])
    if not picture:
        raise BadInput(f"{path}: has neither cameraParameters nor a picture: its size is not told: {SAVE}")
    try:
        if not picture.startswith(PICTURES):
            raise ValueError
        with picture_files.opened(io.BytesIO(picture)) as opened:
            size = opened.size
    except Exception:  # whatever a damaged picture makes of it
        raise BadInput(f"{path}: has no cameraParameters, and its picture is not readable: {SAVE}") from None
    bounded.check_picture(path, *size, None)
    return size


def _told(told):
    """(focal length, principal point (2,), T_view (4, 4), width, height) of `cameraParameters`."""
    T = np.array(told["cameraTransform"]["rows"], float).reshape(4, 4)
    f = 1 / np.tan(float(told["horizontalFieldOfView"]) / 2)
    P = _point(told["principalPoint"])
    return f, P, np.linalg.inv(T), int(told["imageWidth"]), int(told["imageHeight"])


def _point(value):
    return np.array([float(value["x"]), float(value["y"])])


def _solved(path, state, size):
    """The same from control points: two vanishing points, or one with a focal length and the horizon."""
    width, height = size
    flat = lambda point: _plane(_point(point), width, height)
    base, settings = state["controlPointsStateBase"], state["calibrationSettingsBase"]
    mode = state["globalSettings"]["calibrationMode"]
    if mode == "TwoVanishingPoints":
        U, V, P, f = _of_two(path, state, flat)
    elif mode == "OneVanishingPoint":
        U, V, P, f = _of_one(path, state, flat)
    else:
        raise BadInput(f"{path}: calibrationMode: {mode!r:.40} is not known: {SAVE}")
    axes = [settings[f"{which}VanishingPointAxis"] for which in ("first", "second")]
    if not np.cross(*(AXES[axis] for axis in axes)).any():
        raise BadInput(f"{path}: the vanishing points are of the axes {axes[0]} and {axes[1]}: choose two axes in fSpy")
    R = _rotation(U - P, V - P, f, *(AXES[axis] for axis in axes))
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = DISTANCE * np.append((flat(base["origin"]) - P) / f, -1)
    if axis := settings.get("referenceDistanceAxis"):
        T[:3, 3] *= float(settings["referenceDistance"]) / _distance(base, T, P, f, AXES[axis], width, height)
    return f, P, T, width, height


def _parts(state, way):
    """Control points of both ways to calibrate, settings and control points of one."""
    return state["controlPointsStateBase"], state[f"calibrationSettings{way}"], state[f"controlPointsState{way}"]


def _of_two(path, state, flat):
    """(two vanishing points, principal point, focal length) in fSpy's plane."""
    base, own, points = _parts(state, "2VP")
    first = base["firstVanishingPoint"]["lineSegments"]
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
    return U, V, P, np.sqrt(square)


def _of_one(path, state, flat):
    """The same of one vanishing point: the focal length is told, and the other point lies along the horizon."""
    base, own, points = _parts(state, "1VP")
    f = 2 * float(own["absoluteFocalLength"]) / max(_sensor(path, state["calibrationSettingsBase"]["cameraData"]))
    P = flat(base["principalPoint"]) if own["principalPointMode"] == "Manual" else np.zeros(2)
    U = _meeting(path, base["firstVanishingPoint"]["lineSegments"], flat)
    ends = points["horizon"]
    ends = [ends["0"], ends["1"]] if isinstance(ends, dict) else ends
    a, b = map(flat, ends)
    length = np.linalg.norm(b - a)
    if not (length > 0 and np.linalg.norm(U - P) > 1e-7):
        raise BadInput(f"{path}: the vanishing point lies in the middle, or the horizon has no length: no camera")
    along = (b - a) / length
    return U, U - along * ((U - P) @ (U - P) + f**2) / ((U - P) @ along), P, f


def _sensor(path, told):
    """(width, height) mm. As fSpy, a sensor by name comes before the sides that are told."""
    preset = told.get("presetData") if told.get("presetId") else None
    if preset:
        return float(preset["sensorWidth"]), float(preset["sensorHeight"])
    if told.get("presetId") in SENSORS:
        return SENSORS[told["presetId"]]
    if told.get("presetId"):
        raise BadInput(f"{path}: cameraData: the sides of the sensor {told['presetId']!r:.40} are not told: {SAVE}")
    return float(told["customSensorWidth"]), float(told["customSensorHeight"])


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
