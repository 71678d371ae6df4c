"""OpenCV's calibrations and ROS's camera_info: YAML, JSON or XML with a matrix and distortion coefficients.

Our own reader: OpenCV's ends the process at a file of nested brackets. Pixel (0, 0) is the centre of the first.
"""

from __future__ import annotations

import re

import numpy as np

from lib.core.stage import BadInput
from lib.given.cameras import matrix_from_rt
from lib.given.foreign_cameras import storage
from lib.given.foreign_cameras.found import Found
from lib.given.formats import Format, LeftOut

UNDISTORT = "undistort first (cv2.fisheye.undistortImage), and give that picture with its own camera"
LENSES = {0: "PINHOLE", 4: "OPENCV4", 5: "OPENCV5", 8: "OPENCV8", 12: "OPENCV12"}
OF_K = ("cameramatrix", "k", "mtx", "intrinsicmatrix", "intrinsics", "intrinsic", "cameramtx")
OF_D = (
    *("distortioncoefficients", "distcoeffs", "distcoeff", "distortioncoeffs", "dist", "d", "distortion"),
    *("distcoefs", "distortionparameters", "distcoefficients"),
)
SIDE = r"(1|2|l|r|left|right)"
K_OF_SIDE = re.compile(rf"(?:m|k|mtx|cameramatrix|intrinsicmatrix){SIDE}$")
D_OF_SIDE = re.compile(rf"(?:d|dist|distcoeffs?|distortioncoefficients|distortion){SIDE}$")
# Poses that are not the photograph's, or cameras of rectified pictures
ELSEWHERE = {
    **dict.fromkeys(("rvecs", "tvecs", "extrinsicparameters", "extrinsics"), "board pose table"),
    **dict.fromkeys(
        ("rectificationmatrix", "projectionmatrix", "p", "p1", "p2", "r1", "r2", "q"), "rectification value"
    ),
}
# Words of models of lenses, in values of keys like distortion_model; "Omnivision" makes sensors of all kinds
FISHEYE = re.compile(
    r"fish|equi|kannala|\bkb[48]?\b|\bomni(dir\w*|[-_]\w+)?\b|\bmei\b|\beucm\b|\bds\b|\bfov\b|unified|scaramuzza", re.I
)
OTHER = re.compile(r"division|inverse|ptlens|\bftheta\b", re.I)
PLANE = re.compile(r"plumb|rational|rad|brown|pinhole|perspective|opencv|polynomial|none|^$|rectified|thin_prism", re.I)
ZERO_TANGENT = 8  # cv2.CALIB_ZERO_TANGENT_DIST
FRACTIONS_PX = 20.0  # a focal length below it, with a principal point below FRACTIONS_AT, is a share of the width
FRACTIONS_AT = 3.0
LEAST_SKEW = 1e-6  # of the focal length
FAR_M = 100.0  # a translation beyond it is hardly in metres

FORMAT = Format(
    "OpenCV's calibration, ROS's camera_info (YAML, JSON, XML)",
    (
        "camera_matrix, distortion_coefficients (0, 4, 5, 8 or 12 numbers; 14 where the tilt is 0), size, rvec, tvec",
        "names of OpenCV's samples, of Python's dumps (mtx, dist), of ROS 1 and ROS 2 (K, D; k, d)",
        "M1, D1, M2, D2 of a stereo pair: IMAGE=left or IMAGE=right",
    ),
    (
        ("fisheye and omnidirectional lenses", UNDISTORT),
        ("a tilted sensor, skew, numbers that are shares of the width, a matrix by columns", "calibrate or write anew"),
        ("no size, and a principal point far from the middle", "write image_width and image_height"),
    ),
    ("poses of calibration boards", "matrices of rectified pictures"),
)


def is_one(table) -> bool:
    """Does a storage.Table have a camera's matrix?"""
    K = table.get(*OF_K)
    if isinstance(K, dict) and "data" not in K:  # fx, fy, cx, cy by their names
        return False
    return K is not None or any(K_OF_SIDE.match(n) and _is_matrix(v) for n, v in table.values.items())


def _is_matrix(value):
    """k1, k2 may be a pair's matrices, or numbers of a lens."""
    return isinstance(value, dict | list)


def read(path, table, image) -> Found:
    """table : storage.Table;  image : "left" or "right" of a pair. BadInput: a lens or a matrix that is not read"""
    check_model(path, table)
    K, D, said = _matrices(path, table, image)
    four = of_matrix(path, K)
    if D is not None and _flag(table.get("flags")) & ZERO_TANGENT and D.size == 4 and D.ravel()[2:4].any():
        raise BadInput(
            f"{path}: flags: say that there is no tangential distortion, and numbers 3 and 4 of "
            f"distortion_coefficients are not 0: k1 k2 k3 k4 of a fisheye? {UNDISTORT}"
        )
    told_model = bool(table.get("distortionmodel"))
    lens, numbers, lines = of_numbers(path, four, np.zeros(0) if D is None else D, told_model)
    T, more = _pose(path, table)
    left = LeftOut()
    for name in table.names:
        if what := ELSEWHERE.get(storage.plain(name)):
            left.add(what)
    if T is None and {"r", "t"} <= set(map(storage.plain, table.names)):
        more.append("R and T are not read, they may be of a pair: name the photograph's pose rvec, tvec")
    said = [*said, *lines, *more, *filter(None, [left.line()])]
    return Found("OpenCV", lens, numbers, *_size(path, table), T, tuple(said))


def check_model(path, table):
    """BadInput: the file says anywhere that it is of a fisheye, or of a distortion that is not known."""
    for name, value in table.values.items():
        word, where = value.strip() if isinstance(value, str) else "", f"{path}: {table.spelt(name)}"
        if "fisheye" in name and value not in (0, False, "0", "false", "False", ""):
            raise BadInput(f"{where}: a fisheye: {UNDISTORT}")
        of_lens = "model" in name or name.endswith("type")
        if of_lens and FISHEYE.search(word):
            raise BadInput(f"{where}: {word:.40}: a fisheye: {UNDISTORT}")
        if of_lens and OTHER.search(word) or "distortionmodel" in name and not PLANE.search(word):
            raise BadInput(f"{where}: {word:.40} is not known; read are plumb_bob and rational_polynomial")
    if table.get("xi") is not None:
        raise BadInput(f"{path}: xi: an omnidirectional lens (cv2.omnidir): {UNDISTORT}")
    # OpenCV's sample program writes the flags of its fisheye calibration as a comment
    comments = [line for line in table.words.split("\n") if "#" in line or "<!--" in line]
    if any(word in line for line in comments for word in ("fix_skew", "recompute_extrinsic", "check_cond")):
        raise BadInput(f"{path}: flags: those of a fisheye: {UNDISTORT}")


def _flag(value):
    return storage.whole(value) or 0


def _matrices(path, table, image):
    """(K, D or None, lines to say); of a pair, those of the side that is asked for."""
    if table.get(*OF_K) is not None:
        return storage.matrix(path, "camera_matrix", table.get(*OF_K)), _of(path, table, OF_D), []
    sides = {}
    for pattern, which in ((K_OF_SIDE, 0), (D_OF_SIDE, 1)):
        for name, value in table.values.items():
            if (found := pattern.match(name)) and _is_matrix(value):
                side = "left" if found[1] in ("1", "l", "left") else "right"
                sides.setdefault(side, [None, None])[which] = storage.matrix(path, name, value)
    sides = {side: pair for side, pair in sides.items() if pair[0] is not None}
    asked = {"1": "left", "l": "left", "2": "right", "r": "right"}.get(str(image).lower(), str(image).lower())
    side = next(iter(sides)) if len(sides) == 1 else asked
    if side not in sides:
        raise BadInput(f"{path}: IMAGE: the file has the cameras of a stereo pair: say IMAGE=left or IMAGE=right")
    return *sides[side], [f"the {side} camera of a stereo pair"]


def _of(path, table, names):
    return storage.matrix(path, names[0], table.get(*names))


def of_matrix(path, K):
    """fx, fy, cx, cy (4,) of K. BadInput: not the matrix of a camera without skew, in pixels, by rows."""
    where = f"{path}: camera_matrix"
    if K is None or K.size != 9:
        raise BadInput(f"{where}: 3 x 3 numbers are needed")
    K = K.reshape(3, 3)
    if K[0, 2] == K[1, 2] == 0 and (K[2, :2] != 0).all():
        raise BadInput(f"{where}: is written by columns (MATLAB, Open3D): write it by rows: fx 0 cx, 0 fy cy, 0 0 1")
    if K[2].tolist() != [0, 0, 1] or K[1, 0] != 0:
        raise BadInput(f"{where}: {K.ravel().tolist()!r:.120} is not fx 0 cx, 0 fy cy, 0 0 1")
    if abs(K[0, 1]) > LEAST_SKEW * abs(K[0, 0]):
        raise BadInput(f"{where}: skew: K[0][1] = {K[0, 1]:g} px is not 0: calibrate without skew")
    four = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
    if 0 < four[:2].max() < FRACTIONS_PX and np.abs(four[2:]).max() < FRACTIONS_AT:
        raise BadInput(
            f"{where}: fx, cx = {four[0]:g}, {four[2]:g} are shares of the picture's width: multiply them by it"
        )
    return four


def of_numbers(path, four, D, told_model=True):
    """(lens model, intrinsics, lines to say) of fx, fy, cx, cy and OpenCV's coefficients. BadInput: too many of them

    told_model : the file says how the coefficients are meant
    """
    D, said = np.asarray(D, float).ravel(), []
    if len(D) == 14 and not D[12:].any():
        D = D[:12]
    if len(D) == 14:
        raise BadInput(
            f"{path}: distortion_coefficients: the last two of 14 numbers tilt the sensor: calibrate without tilt"
        )
    if len(D) not in LENSES:
        raise BadInput(f"{path}: distortion_coefficients: {len(D)} numbers; read are {', '.join(map(str, LENSES))}")
    if len(D) == 4 and D.any() and not told_model:
        said.append("4 distortion coefficients, read as k1 k2 p1 p2; k1 k2 k3 k4 of a fisheye would be misread")
    return f"LENSMODEL_{LENSES[len(D)]}", np.concatenate([four, D]), said


def _pose(path, table):
    """((4, 4) or None, lines to say) of rvec and tvec."""
    r = _of(path, table, ("rvec", "rotation", "rotationvector", "rotationmatrix"))
    t = _of(path, table, ("tvec", "translation", "translationvector"))
    if r is None or t is None:
        missing = "tvec" if t is None else "rvec"
        return None, [] if r is t else [f"a pose without {missing}: not read"]
    if r.size not in (3, 9) or t.size != 3:
        raise BadInput(f"{path}: rvec, tvec: {r.size} and {t.size} numbers instead of 3 (or 9) and 3")
    T = matrix_from_rt(np.concatenate([r.ravel()[:3], t.ravel()]))
    T[:3, :3] = r.reshape(3, 3) if r.size == 9 else T[:3, :3]
    far = np.abs(T[:3, 3]).max() > FAR_M
    return T, [f"tvec is up to {np.abs(t).max():.4g} long: is it in mm? metres are read"] if far else []


def _size(path, table):
    """(width, height) px, None where the file tells none. BadInput: of a part of the sensor, or of joined pixels"""
    for name in ("binningx", "binningy"):
        if _flag(table.get(name)) > 1:
            raise BadInput(
                f"{path}: {table.spelt(name)}: pixels are joined, and the camera is of single ones: divide K by it"
            )
    roi = table.get("roi")
    if isinstance(roi, dict) and any(_flag(roi.get(name)) for name in ("x_offset", "y_offset", "width", "height")):
        raise BadInput(f"{path}: roi: the picture is a part of the sensor's: take cx, cy from its corner, without roi")
    sides = (
        storage.whole(table.get("imagewidth", "width", "imgwidth")),
        storage.whole(table.get("imageheight", "height", "imgheight")),
    )
    pair = table.get("imagesize", "resolution", "imgsize", "dim")
    if None in sides and isinstance(pair, list) and len(pair) == 2:
        sides = storage.whole(pair[0]), storage.whole(pair[1])
    return sides
