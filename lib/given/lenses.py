"""Cameras with any lens of mrcal: reading their files, projecting, and making photographs pinhole.

    lens = lenses.read("left.cameramodel")
    q = lens.project(p)                     # (N, 3) camera frame -> (N, 2) px
    v = lens.unproject(q)                   # (N, 2) px -> (N, 3), z = 1 for the lenses that only look forward
    camera = lenses.pinhole(lens)           # the pinhole in which no pixel is without data
    values = lenses.resample(photograph.values, lens, camera)

Pinhole, stereographic and OpenCV's lenses are computed here. mrcal computes any other (splined, CAHVOR), in a process
of its own. Formulas: https://mrcal.secretsauce.net/lensmodels.html, OpenCV's calib3d (k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3
s4).
"""

import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lib.core.stage import BadInput
from lib.given import cameras, mrcal_runner, reduced

COUNTS = {
    "LENSMODEL_PINHOLE": 4,
    "LENSMODEL_STEREOGRAPHIC": 4,
    "LENSMODEL_LONLAT": 4,
    "LENSMODEL_LATLON": 4,
    "LENSMODEL_OPENCV4": 8,
    "LENSMODEL_OPENCV5": 9,
    "LENSMODEL_OPENCV8": 12,
    "LENSMODEL_OPENCV12": 16,
    "LENSMODEL_CAHVOR": 9,
}
OWN = (
    "LENSMODEL_PINHOLE",
    "LENSMODEL_STEREOGRAPHIC",
    "LENSMODEL_OPENCV4",
    "LENSMODEL_OPENCV5",
    "LENSMODEL_OPENCV8",
    "LENSMODEL_OPENCV12",
)


@dataclass(frozen=True, eq=False)
class Lens:
    """model : LENSMODEL_...; intrinsics : fx, fy, cx, cy (px), then its parameters; width, height : px
    T_cam_ref : (4, 4), the file's extrinsics; path : the file, for what only mrcal can compute"""

    model: str
    intrinsics: np.ndarray
    width: int
    height: int
    T_cam_ref: np.ndarray
    path: str

    @property
    def K(self):
        fx, fy, cx, cy = self.intrinsics[:4]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    @property
    def centre(self):
        """(3,) in the reference frame."""
        return -self.T_cam_ref[:3, :3].T @ self.T_cam_ref[:3, 3]

    def project(self, p):
        """(..., 3) camera frame -> (..., 2) px; nan behind the camera (for the stereographic one: straight behind)."""
        p = np.asarray(p, float)
        if self.model not in OWN:
            return self._mrcal("project", p, 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.model == "LENSMODEL_STEREOGRAPHIC":
                length = np.linalg.norm(p, axis=-1, keepdims=True)
                x = 2 * p[..., :2] / (length + p[..., 2:])
                x = np.where(np.isfinite(x), x, np.nan)
            else:
                x = np.where(p[..., 2:] > 0, p[..., :2] / p[..., 2:], np.nan)
                x = _distort(x, self.intrinsics[4:])[0]
        return x * self.intrinsics[:2] + self.intrinsics[2:4]

    def unproject(self, q):
        """(..., 2) px -> (..., 3) camera frame: z = 1, or of length 1 where the lens may look sideways.

        nan where no ray of the lens's own branch comes to q: the branch around its axis, before its formula folds back.
        """
        q = np.asarray(q, float)
        if self.model not in OWN:
            return self._mrcal("unproject", q, 3)
        x = (q - self.intrinsics[2:4]) / self.intrinsics[:2]
        if self.model == "LENSMODEL_STEREOGRAPHIC":
            r2 = (x**2).sum(-1, keepdims=True) / 4  # tan^2 of half the angle
            return np.concatenate([x, 1 - r2], -1) / (1 + r2)
        if len(self.intrinsics) > 4:
            x = _undistort(x, self.intrinsics[4:])
        return np.concatenate([x, np.where(np.isfinite(x[..., :1]), 1.0, np.nan)], -1)

    def unfolded(self, x, samples=32):
        """(..., 2) tangents -> (...) bool: from the axis to x the formula has not turned back.

        Beyond its turn a polynomial maps rays from outside into the picture, which would then show things twice. Lenses
        without a polynomial do not turn back.
        """
        if self.model not in OWN or len(self.intrinsics) == 4:
            return np.ones(np.shape(x)[:-1], bool)
        straight = np.ones(np.shape(x)[:-1], bool)
        for share in np.arange(1, samples + 1) / samples:
            straight &= _rising(_distort(share * np.asarray(x, float), self.intrinsics[4:])[1])
        return straight

    def _mrcal(self, verb, given, width):
        mrcal_runner.require_mrcal(f"{self.path}: lensmodel: {self.model}")
        with tempfile.TemporaryDirectory(prefix="lens-") as folder:
            source, target = Path(folder) / "given.npy", Path(folder) / "answer.npy"
            np.save(source, np.ascontiguousarray(given.reshape(-1, given.shape[-1])))
            mrcal_runner.process(verb, self.path, source, target)
            return np.load(target, allow_pickle=False).reshape(*given.shape[:-1], width)


def _distort(x, k):
    """(..., 2) tangents -> the same, distorted, and the Jacobian (..., 2, 2).

    OpenCV's rational model with tangential and thin prism terms. k : up to 12 coefficients
    """
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = np.concatenate([k, np.zeros(12 - len(k))])
    u, v = x[..., 0], x[..., 1]
    r = u * u + v * v
    top, bottom = 1 + r * (k1 + r * (k2 + r * k3)), 1 + r * (k4 + r * (k5 + r * k6))
    radial = top / bottom
    slope = (k1 + r * (2 * k2 + 3 * r * k3) - radial * (k4 + r * (2 * k5 + 3 * r * k6))) / bottom  # d radial / d r^2
    out = np.stack(
        [
            u * radial + 2 * p1 * u * v + p2 * (r + 2 * u * u) + r * (s1 + r * s2),
            v * radial + p1 * (r + 2 * v * v) + 2 * p2 * u * v + r * (s3 + r * s4),
        ],
        -1,
    )
    J = np.empty((*u.shape, 2, 2))
    J[..., 0, 0] = radial + 2 * u * u * slope + 2 * p1 * v + 6 * p2 * u + 2 * u * (s1 + 2 * r * s2)
    J[..., 0, 1] = 2 * u * v * slope + 2 * p1 * u + 2 * p2 * v + 2 * v * (s1 + 2 * r * s2)
    J[..., 1, 0] = 2 * u * v * slope + 2 * p1 * u + 2 * p2 * v + 2 * u * (s3 + 2 * r * s4)
    J[..., 1, 1] = radial + 2 * v * v * slope + 6 * p1 * v + 2 * p2 * u + 2 * v * (s3 + 2 * r * s4)
    return out, J


def _rising(J):
    """(..., 2, 2) -> bool: neither mirrored nor turned back."""
    return (J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0] > 1e-9) & (J[..., 0, 0] + J[..., 1, 1] > 0)


def _undistort(y, k, steps=12):
    """The x (..., 2) whose distortion is y, by Newton along the line from the axis to y.

    Each step starts from the one before, so that the branch around the axis is followed. nan where it folds first, that
    is, where the Jacobian is not positive.
    """
    x, lost = np.zeros_like(y), np.zeros(y.shape[:-1], bool)
    for share in [*np.arange(1, steps + 1) / steps, 1.0, 1.0]:
        for _ in range(3):
            out, J = _distort(x, k)
            lost |= ~_rising(J)
            det = np.where(lost, 1.0, J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0])
            e = np.where(lost[..., None], 0.0, out - share * y)
            x = (
                x
                - np.stack(
                    [
                        J[..., 1, 1] * e[..., 0] - J[..., 0, 1] * e[..., 1],
                        J[..., 0, 0] * e[..., 1] - J[..., 1, 0] * e[..., 0],
                    ],
                    -1,
                )
                / det[..., None]
            )
    error = np.abs(_distort(x, k)[0] - y).max(-1)
    return np.where((lost | ~(error < 1e-9))[..., None], np.nan, x)


def check_name(model, where):
    """BadInput: not a lens model of mrcal."""
    if model not in COUNTS and not model.startswith(("LENSMODEL_SPLINED_STEREOGRAPHIC_", "LENSMODEL_CAHVORE_")):
        raise BadInput(
            f"{where}: {model} is unknown; known are {', '.join(COUNTS)} and LENSMODEL_SPLINED_STEREOGRAPHIC_..."
        )


def read(path) -> Lens:
    """Any .cameramodel of mrcal. BadInput: not one, or numbers that are none or too few."""

    def count(model):
        check_name(model, f"{path}: lensmodel")
        return COUNTS.get(model)

    model, intrinsics, T, width, height = cameras.parse(path, count)
    return Lens(model, intrinsics, width, height, T, str(path))


# ---- photographs made pinhole ----


def pinhole(lens):
    """(cameras.Camera, share of the photograph's area that its picture shows): the pinhole of the same size and pose.

    fx, fy, cx, cy are the lens's own if every pixel then lies inside the photograph, on the lens's own branch. If not,
    fx and fy grow together, as little as need be. A lens that sees more (barrel, fisheye) loses what lies outside, for
    a pinhole cannot hold it at this focal length.
    BadInput where no focal length does: the axis (cx, cy) points past the picture, or the lens folds back at once.
    """
    if not (0 < lens.intrinsics[2] < lens.width - 1 and 0 < lens.intrinsics[3] < lens.height - 1):
        raise BadInput(
            f"{lens.path}: intrinsics: cx, cy = {lens.intrinsics[2]:g}, {lens.intrinsics[3]:g} lies outside the "
            f"picture of {lens.width} x {lens.height}: no pinhole looks there"
        )
    border = _border(lens.width, lens.height)
    size = np.array([lens.width - 1, lens.height - 1])

    def inside(K, q):
        x = (q - K[:2, 2]) / [K[0, 0], K[1, 1]]
        y = lens.project(np.concatenate([x, np.ones((len(q), 1))], -1))
        return bool(
            (np.isfinite(y).all(-1) & (y >= -1e-6).all(-1) & (y <= size + 1e-6).all(-1) & lens.unfolded(x)).all()
        )

    K = lens.K
    if not inside(K, border):
        low, high = 1.0, 2.0
        scaled = lambda s: (
            np.diag([s, s, 1.0]) @ K + np.array([[0, 0, K[0, 2] * (1 - s)], [0, 0, K[1, 2] * (1 - s)], [0, 0, 0]])
        )
        while not inside(scaled(high), border):
            low, high = high, 2 * high
            if high > 1e3:
                raise BadInput(
                    f"{lens.path}: intrinsics: the lens folds back so near to its axis that no pinhole holds its "
                    "picture"
                )
        while high / low - 1 > 1e-6:
            middle = math.sqrt(low * high)
            low, high = (low, middle) if inside(scaled(middle), border) else (middle, high)
        K = scaled(high)
    camera = cameras.Camera(K, lens.width, lens.height, lens.T_cam_ref)
    rim = lens.project(np.concatenate([(border - K[:2, 2]) / [K[0, 0], K[1, 1]], np.ones((len(border), 1))], -1))
    x, y = rim[:, 0], rim[:, 1]
    share = 0.5 * abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) / float(size.prod())
    return camera, share


def pinhole_of(path) -> cameras.Camera:
    """The pinhole of a camera file with any lens; a pinhole as it is."""
    lens = read(path)
    return cameras.read_cameramodel(path) if lens.model == "LENSMODEL_PINHOLE" else pinhole(lens)[0]


def _border(width, height, step=1.0):
    """(N, 2) px once round the rim, about one to each pixel."""
    x, y = np.linspace(0, width - 1, max(2, int(width / step))), np.linspace(0, height - 1, max(2, int(height / step)))
    sides = [
        np.stack([x, 0 * x], -1),
        np.stack([0 * y + width - 1, y], -1),
        np.stack([x[::-1], 0 * x + height - 1], -1),
        np.stack([0 * y, y[::-1]], -1),
    ]
    return np.concatenate([side[:-1] for side in sides])


def source(lens, camera):
    """(height, width, 2) px of the photograph, for every pixel of the pinhole picture, clamped to the photograph.

    BadInput: a pixel that lies outside it by more than 1e-3 px
    """
    q = lens.project(camera.directions(camera.pixels()))
    size = np.array([lens.width - 1, lens.height - 1], float)
    if not (np.isfinite(q).all() and (q >= -1e-3).all() and (q <= size + 1e-3).all()):
        raise BadInput(f"{lens.path}: intrinsics: the lens folds back inside the pinhole's picture")
    return np.clip(q, 0, size)


def straightened(photograph, lens, camera, k=1):
    """image.Photograph through the pinhole; where the blocks of a JPEG lie is then not known.  k : as in `resample`"""
    blocks = photograph.blocks and photograph.blocks._replace(first=None)
    return replace(photograph, values=resample(photograph.values, lens, camera, k), blocks=blocks)


def resample(values, lens, camera, k=1):
    """(H, W, C) -> the same photograph through the pinhole, by cubic B-splines (order 3, interpolating).

    k : how many times smaller than the lens's picture the photograph was made
    """
    from scipy import ndimage

    q = np.clip(reduced.place(source(lens, camera), k), 0, np.array(values.shape[1::-1]) - 1)
    at = [q[..., 1], q[..., 0]]
    out = np.stack(
        [ndimage.map_coordinates(values[..., c], at, order=3, mode="mirror") for c in range(values.shape[2])], -1
    )
    return out
