"""Pinhole cameras, and mrcal's text files of them.

    camera = read_cameramodel("left.posed.cameramodel")
    q = camera.project(p_world)                 # (N, 2) px
    v_world = camera.rays(q)                    # (N, 3) unit

Axes: x right, y down, z forward; pixel (0, 0) is the centre of the top-left
pixel. mrcal itself is not needed: its files are Python literals.
"""

import re
from dataclasses import dataclass

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import camera_names

HEAD = 100_000  # bytes at the start of a file that tell what it is
FARTHEST = 1e9  # px or m: the largest number of a camera
MOST_TURN = 1e3  # rad, of a rotation vector
SHORTEST_PX = 1e-3  # of a focal length


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera posed in the model's frame.

    K : (3, 3) px               [[fx, s, cx], [0, fy, cy], [0, 0, 1]]
    width, height : px
    T_cam_world : (4, 4)        rigid; world (= model) coordinates in metres to camera coordinates
    """

    K: np.ndarray
    width: int
    height: int
    T_cam_world: np.ndarray

    @property
    def centre(self):
        """(3,) m, world."""
        return -self.T_cam_world[:3, :3].T @ self.T_cam_world[:3, 3]

    def points(self, p_world):
        """(N, 3) m, world -> (N, 3) m, camera.

        The centre is subtracted first, so that far from the origin nothing cancels later.
        """
        return (np.asarray(p_world, float) - self.centre) @ self.T_cam_world[:3, :3].T

    def project(self, p_world):
        """(N, 3) m, world -> (N, 2) px; nan for a point that is not in front of the camera.

        >>> camera = Camera(np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]), 101, 81, np.eye(4))
        >>> camera.project(np.array([[0.0, 0, 2], [1, 0, 2], [0, 0, -1]]))
        array([[ 50.,  40.],
               [100.,  40.],
               [ nan,  nan]])
        """
        p = self.points(p_world)
        z = np.where(p[..., 2:] > 0, p[..., 2:], np.nan)
        return ((p / z) @ self.K.T)[..., :2]

    def directions(self, q):
        """(N, 2) px -> (N, 3), camera frame, scaled so that z = 1: depth times this is the point."""
        q = np.asarray(q, float)
        y = (q[..., 1] - self.K[1, 2]) / self.K[1, 1]
        x = (q[..., 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def rays(self, q):
        """(N, 2) px -> (N, 3) unit directions, world, from the centre through the pixel."""
        v = self.directions(q)
        v /= np.linalg.norm(v, axis=-1, keepdims=True)
        return v @ self.T_cam_world[:3, :3]

    def pixels(self):
        """(height, width, 2) px: the centre (x, y) of every pixel."""
        x, y = np.meshgrid(np.arange(self.width, dtype=float), np.arange(self.height, dtype=float))
        return np.stack([x, y], axis=-1)


def intrinsics(focal_px, width, height):
    """K (3, 3) of square pixels, the principal point in the middle.

    >>> intrinsics(100.0, 101, 81)
    array([[100.,   0.,  50.],
           [  0., 100.,  40.],
           [  0.,   0.,   1.]])
    """
    return np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1.0]])


def towards(eye, at, up=(0, 0, 1)):
    """T_cam_world (4, 4) of a camera at `eye` that looks to `at`, (3,) m each, with `up` upwards in the picture.

    ValueError where `up` lies along the view, or there is none.
    """
    eye, up = np.asarray(eye, float), np.asarray(up, float)
    forward = np.asarray(at, float) - eye
    right = np.cross(forward, up)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up):
        raise ValueError(f"up {up.tolist()} lies along the view from {eye.tolist()} to {np.asarray(at).tolist()}")
    right, forward = right / np.linalg.norm(right), forward / np.linalg.norm(forward)
    T = np.eye(4)
    T[:3, :3] = right, np.cross(forward, right), forward
    T[:3, 3] = -T[:3, :3] @ eye
    return T


def look_at(eye, at, hfov_deg, width, height, up=(0, 0, 1)) -> Camera:
    """The camera `towards` a place, square pixels, fx = width / (2 tan(hfov / 2)), the principal point in the middle.

    >>> look_at([0, -2, 1], [0, 0, 1], 90, 101, 81).project([[0.0, 0, 1], [1, 0, 1], [0, 0, 2]])
    array([[50.  , 40.  ],
           [75.25, 40.  ],
           [50.  , 14.75]])
    """
    K = intrinsics(width / (2 * np.tan(np.radians(hfov_deg) / 2)), width, height)
    return Camera(K, width, height, towards(eye, at, up))


def matrix_from_rt(rt):
    """(6,) Rodrigues vector, translation -> (4, 4) rigid.

    >>> matrix_from_rt([0, 0, np.pi / 2, 1, 2, 3]).round(9) + 0.0
    array([[ 0., -1.,  0.,  1.],
           [ 1.,  0.,  0.,  2.],
           [ 0.,  0.,  1.,  3.],
           [ 0.,  0.,  0.,  1.]])
    """
    r = np.asarray(rt[:3], float)
    angle = np.linalg.norm(r)
    cross = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    sinc = np.sinc(angle / np.pi)  # sin(a) / a
    versine = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2  # (1 - cos a) / a^2
    T = np.eye(4)
    T[:3, :3] += sinc * cross + versine * cross @ cross
    T[:3, 3] = rt[3:]
    return T


def rt_from_matrix(T):
    """(4, 4) rigid -> (6,) Rodrigues vector of length at most pi, translation. By quaternion: steady at 0 and at pi."""
    from scipy.spatial.transform import Rotation

    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def _numbers(path, content, key, count):
    value = content.get(key)
    if value is None:
        needed = f", {count} numbers" if count else ""
        raise BadInput(f"{path}: {key}: is missing{needed}")
    if not isinstance(value, (list, tuple)) or (count is not None and len(value) != count):
        raise BadInput(f"{path}: {key}: {count} numbers are needed, got {value!r:.80}")
    for number in value:
        if isinstance(number, bool) or not isinstance(number, (int, float)) or not abs(number) <= FARTHEST:
            raise BadInput(f"{path}: {key}: {number!r:.80} is not a number of at most {FARTHEST:g}")
    return np.array(value, float)


def _literal(path, raw):
    """The Python literal that a camera file is. BadInput says what the file is instead, where that is known."""
    text = raw[:HEAD].decode("utf-8-sig", "replace").strip()
    if not text:
        raise BadInput(f"{path}: the file is empty: not a camera model")
    try:
        return bounded.literal_of(path, NUMPY_2.sub(rb"\1", raw))
    except ValueError as error:
        wrong = _foreign(raw[:HEAD]) or error
    raise BadInput(f"{path}: not a camera model: {wrong}") from None


CONVERTS = "make new-scene CAMERA=... converts it"
# Numbers and words as NumPy 2 shows them: np.float64(1.5)
NUMPY_2 = re.compile(rb"""\b(?:np|numpy)\.(?:(?:float|int|uint)\d+|str_)\(\s*([-+\w.]+|'[^'\n]*'|"[^"\n]*")\s*\)""")


def _foreign(start):
    """What a camera file of another program is, by its first bytes; None where it is none that is known."""
    text = start.decode("utf-8-sig", "replace").strip()
    head, first = text[:2000], text.split(None, 1)[0]
    if re.search(r"^[0-9]+ (SIMPLE_)?(PINHOLE|RADIAL|OPENCV|FULL_OPENCV|FOV)\w*( [-+.0-9e]+){4}", head, re.M):
        return f"looks like COLMAP's cameras.txt: {CONVERTS}"
    if head.startswith("# Image list") or re.search(r"^[0-9]+( [-+.0-9e]+){7} [0-9]+ \S+\s*$", head, re.M):
        return f"looks like COLMAP's images.txt: {CONVERTS}"
    if '"cameraTransform"' in head or '"cameraParameters"' in head or head.startswith("fspy"):
        return f"looks like fSpy's JSON: {CONVERTS}"
    if "lensmodel" not in text and (line := camera_names.of(start)):
        return f"is {line}"
    if first.startswith("%YAML") or "opencv-matrix" in head or "opencv_storage" in head:
        return f"looks like OpenCV's YAML: {CONVERTS}"
    if re.match(r"cam\d+ *:", head):
        return f"looks like Kalibr's camchain: {CONVERTS}"
    if re.match(r"(header|image_width|camera_matrix|distortion_model) *:", head):
        return f"looks like ROS's camera_info: {CONVERTS}"
    if head.startswith("{") and '"frames"' in text:
        return f"looks like nerfstudio's transforms.json: {CONVERTS}"
    if head.startswith("{") and '":' in head:
        return f"looks like JSON, and is a file of mrcal's no more: {CONVERTS}"
    if re.fullmatch(r"[-+.,;0-9eE\s\[\]]+", text):
        return "is a table of numbers: not a camera model; mrcal's has lensmodel, intrinsics, extrinsics, imagersize"
    return None


def _other_camera(content, start):
    """The same of what Python can read as well."""
    if "cameraTransform" in content or "cameraParameters" in content:
        return f"looks like fSpy's JSON: {CONVERTS}"
    if "camera_matrix" in content:
        return f"looks like OpenCV's JSON: {CONVERTS}"
    return None if "lensmodel" in content else _foreign(start)


def parse(path, count_of):
    """(lens, intrinsics (n,), (4, 4) reference to camera, width, height) of a .cameramodel file, checked.

    count_of : lens -> how many intrinsics it has, or None for any number. It raises BadInput for a lens that the caller
    does not take.
    """
    raw = bounded.content(path, bounded.LARGEST_TEXT)
    content = _literal(path, raw)
    if not isinstance(content, dict):
        known = camera_names.of(raw[:HEAD])
        wrong = f"is {known}" if known else f"a {type(content).__name__} instead of a dictionary"
        raise BadInput(f"{path}: not a camera model: {wrong}")
    if other := _other_camera(content, raw[:HEAD]):
        raise BadInput(f"{path}: not a camera model: {other}")

    lens = content.get("lensmodel")
    if not isinstance(lens, str):
        raise BadInput(f"{path}: lensmodel: {lens!r} is not a name")
    intrinsics = _numbers(path, content, "intrinsics", count_of(lens))
    size = _numbers(path, content, "imagersize", 2)
    # mrcal calls this rt_fromref, later rt_cam_ref: reference to camera
    key = "rt_cam_ref" if "extrinsics" not in content and "rt_cam_ref" in content else "extrinsics"
    rt = _numbers(path, content, key, 6)
    for name, focal in zip(("fx", "fy"), intrinsics[:2], strict=True):
        if focal < SHORTEST_PX:
            least = "not positive" if focal <= 0 else f"less than {SHORTEST_PX:g} px"
            raise BadInput(f"{path}: intrinsics: {name} = {focal:g} is {least}")
    for name, length in zip(("width", "height"), size, strict=True):
        if length < 1 or length != int(length):
            raise BadInput(f"{path}: imagersize: {name} = {length:g} is not a whole positive number")
        if length > bounded.WIDEST_PX:
            raise BadInput(f"{path}: imagersize: {name} = {length:g} is more than a picture's {bounded.WIDEST_PX}")
    if np.linalg.norm(rt[:3]) > MOST_TURN:
        turn = np.linalg.norm(rt[:3])
        raise BadInput(f"{path}: {key}: a rotation of {turn:g} rad is more than {MOST_TURN:g}")
    return lens, intrinsics, matrix_from_rt(rt), int(size[0]), int(size[1])


def read_cameramodel(path) -> Camera:
    """The pinhole camera of a .cameramodel file (mrcal's text format).

    Any other lens is refused: photographs are made pinhole before the analysis.
    """

    def four(lens):
        if lens != "LENSMODEL_PINHOLE":
            raise BadInput(
                f"{path}: lensmodel: {lens} is not a pinhole; undistort the photograph first (LENSMODEL_PINHOLE)"
            )
        return 4

    _, (fx, fy, cx, cy), T, width, height = parse(path, four)
    return Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), width, height, T)


def write_cameramodel(path, camera):
    """Write a pinhole camera as mrcal would. The round trip keeps K to the last bit, and the pose to 1e-15."""
    if camera.K[0, 1] != 0:
        raise ValueError(f"skew {camera.K[0, 1]} has no place in LENSMODEL_PINHOLE")
    row = lambda values: " ".join(f"{value!r}," for value in values)
    intrinsics = [float(camera.K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2))]
    extrinsics = [float(value) for value in rt_from_matrix(camera.T_cam_world)]
    with open(path, "w", encoding="utf-8") as file:
        file.write(
            "{\n    'lensmodel':  'LENSMODEL_PINHOLE',\n\n"
            "    # intrinsics are fx,fy,cx,cy\n"
            f"    'intrinsics': [ {row(intrinsics)}],\n\n"
            "    # extrinsics are rt_fromref: the model's frame to the camera\n"
            f"    'extrinsics': [ {row(extrinsics)}],\n\n"
            f"    'imagersize': [ {row([camera.width, camera.height])}],\n}}\n"
        )
