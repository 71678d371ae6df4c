"""Lenses as programs of robotics write them: Kalibr's camchain, EuRoC's sensor.yaml, ORB-SLAM and VINS settings.

Pixel (0, 0) is the centre of the first. Their poses are to other sensors, and are not read.
"""

from __future__ import annotations

import re

from lib.core.stage import BadInput
from lib.given.foreign_cameras import opencv, storage
from lib.given.foreign_cameras.found import Found
from lib.given.formats import Format, LeftOut

CAMERA = re.compile(r"cam\d+$")
RADTAN = ("radtan", "radialtangential", "plumbbob", "none", "")

FORMAT = Format(
    "Kalibr's camchain.yaml, EuRoC's sensor.yaml, settings of ORB-SLAM and VINS",
    ("pinhole cameras with radtan distortion; IMAGE=cam0 says which of several",),
    (("omni, ds, eucm, equidistant, fov, KannalaBrandt8, MEI", opencv.UNDISTORT),),
    ("poses to other sensors",),
)


def is_one(table) -> bool:
    """Is a storage.Table one of these?"""
    values = table.values
    flat = isinstance(values.get("intrinsics"), list) and "distortionmodel" in values
    chain = any(CAMERA.match(name) and isinstance(value, dict) for name, value in values.items())
    return chain or flat or "projectionparameters" in values or bool(_slam(values))


def read(path, table, image) -> Found:
    """BadInput: a lens that is not read, or several cameras and no IMAGE"""
    opencv.check_model(path, table)
    values, left = table.values, LeftOut()
    if cameras := {n: v for n, v in values.items() if CAMERA.match(n) and isinstance(v, dict)}:
        name = next(iter(cameras)) if len(cameras) == 1 else str(image).lower()
        if name not in cameras:
            raise BadInput(f"{path}: IMAGE: say which camera: IMAGE={' or IMAGE='.join(sorted(cameras)[:5])}")
        said, values = [f"the camera {name} of {len(cameras)}"] if len(cameras) > 1 else [], cameras[name]
        values = {storage.plain(key): value for key, value in values.items()}
        left.add("pose to another sensor", sum(key.startswith("tc") or key == "tbs" for key in values))
        found = _of_four(path, "Kalibr", values)
    elif numbers := _slam(values):
        said, found = [], _of_names(path, "ORB-SLAM", numbers)
    elif isinstance(values.get("projectionparameters"), dict):
        lens = values.get("distortionparameters")
        numbers = {**values["projectionparameters"], **(lens if isinstance(lens, dict) else {})}
        sides = {side: values.get(f"image{side}") for side in ("width", "height")}
        said, found = [], _of_names(path, "VINS", numbers | sides)
    else:
        left.add("pose to another sensor", sum(storage.plain(name) == "tbs" for name in table.names))
        said, found = [], _of_four(path, "EuRoC", values)
    return found.saying(*said, *filter(None, [left.line()]))


def _of_four(path, kind, values):
    """intrinsics: [fx, fy, cx, cy], distortion_model, distortion_coeffs, resolution."""
    model = str(values.get("cameramodel", "pinhole")).lower()
    if model != "pinhole":
        raise BadInput(f"{path}: camera_model: {model:.40}: {opencv.UNDISTORT}")
    if storage.plain(values.get("distortionmodel") or "") not in RADTAN:
        raise BadInput(f"{path}: distortion_model: {values['distortionmodel']!s:.40} is not radtan: {opencv.UNDISTORT}")
    four = storage.matrix(path, "intrinsics", values.get("intrinsics"))
    if four is None or four.size != 4:
        raise BadInput(f"{path}: intrinsics: 4 numbers are needed: fx, fy, cx, cy")
    D = storage.matrix(path, "distortion_coeffs", values.get("distortioncoeffs", values.get("distortioncoefficients")))
    lens, intrinsics, _ = opencv.of_numbers(path, four.ravel(), [] if D is None else D)
    sides = values.get("resolution")
    sides = [storage.whole(side) for side in sides] if isinstance(sides, list) and len(sides) == 2 else (None, None)
    return Found(kind, lens, intrinsics, *sides, None)


def _slam(values):
    """{fx: ..., k1: ...} of Camera.fx or Camera1.fx; empty where there are none."""
    found = {re.sub(r"camera1?", "", name): value for name, value in values.items() if re.match(r"camera1?[a-z]", name)}
    return found if {"fx", "fy", "cx", "cy"} <= set(found) else {}


def _of_names(path, kind, numbers):
    """Of fx, fy, cx, cy, k1, k2, p1, p2, k3, width, height by name."""
    if opencv.FISHEYE.search(str(numbers.get("type", ""))):
        raise BadInput(f"{path}: Camera.type: {numbers['type']!s:.40}: a fisheye: {opencv.UNDISTORT}")
    of = lambda *names: storage.matrix(path, ", ".join(names), [numbers.get(name) or 0.0 for name in names])
    k3 = ["k3"] if numbers.get("k3") else []
    D = of("k1", "k2", "p1", "p2", *k3)
    lens, intrinsics, _ = opencv.of_numbers(path, of("fx", "fy", "cx", "cy"), D)
    sides = (storage.whole(numbers.get(name)) for name in ("width", "height"))
    return Found(kind, lens, intrinsics, *sides, None)
