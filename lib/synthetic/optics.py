"""Cameras of the synthetic scenes: lenses, poses, and their files.

Written apart from lib/given/lenses.py, so that the tests compare two projections.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Lens:
    """mrcal's LENSMODEL_OPENCV8.  Of a point (x, y, 1), with r2 = x^2 + y^2:

    radial = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
    x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2)      u = fx x' + cx
    y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y      v = fy y' + cy
    """

    core: tuple  # fx, fy, cx, cy px
    k: tuple = (0,) * 8  # k1 k2 p1 p2 k3 k4 k5 k6

    @property
    def K(self) -> np.ndarray:
        fx, fy, cx, cy = self.core
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    def project(self, p_cam) -> np.ndarray:
        """(N, 3) m in the camera's frame, before it -> (N, 2) px."""
        fx, fy, cx, cy = self.core
        x, y = p_cam[:, 0] / p_cam[:, 2], p_cam[:, 1] / p_cam[:, 2]
        radial, dx, dy = self._terms(x, y)
        return np.c_[fx * (x * radial + dx) + cx, fy * (y * radial + dy) + cy]

    def unproject(self, u, v) -> tuple:
        """Pixels -> (x, y) of the ray (x, y, 1), for arrays of NumPy or Dr.Jit in double precision.

        The fixed point of x = (x' - tangential) / radial.  Each step gains a digit or more for lenses as mild as
        ours, so 24 steps reach rounding.
        """
        fx, fy, cx, cy = self.core
        xd, yd = (u - cx) / fx, (v - cy) / fy
        x, y = xd, yd
        if any(self.k):
            for _ in range(24):
                radial, dx, dy = self._terms(x, y)
                x, y = (xd - dx) / radial, (yd - dy) / radial
        return x, y

    def _terms(self, x, y):
        """(radial factor, tangential shift in x, in y)."""
        k1, k2, p1, p2, k3, k4, k5, k6 = self.k
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return radial, 2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def look(eye, target, up=(0, 0, 1)) -> np.ndarray:
    """T_cam_world (4, 4) of a camera at `eye`: x right, y down, z towards `target`."""
    eye, target, up = (np.asarray(v, float) for v in (eye, target, up))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = right, np.cross(forward, right), forward
    T[:3, 3] = -T[:3, :3] @ eye
    return T


def pinhole(width, height, focal_px, shift=(0.0, 0.0)) -> np.ndarray:
    """K with square pixels; the principal point `shift` px from the image's centre."""
    return np.array(
        [[focal_px, 0, (width - 1) / 2 + shift[0]], [0, focal_px, (height - 1) / 2 + shift[1]], [0, 0, 1.0]]
    )


def directions(K, size, T_cam_world) -> np.ndarray:
    """(H, W, 3): the ray through each pixel's centre in the world's frame, 1 long along the camera's axis."""
    W, H = size
    x, y = np.meshgrid(np.arange(W), np.arange(H))
    v = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones((H, W))], -1)
    return v @ np.linalg.inv(T_cam_world)[:3, :3].T


def cameramodel(intrinsics, T_cam_ref, size) -> str:
    """mrcal's text format; four intrinsics are a pinhole's, twelve LENSMODEL_OPENCV8's."""
    model, names, frame = {
        4: ("PINHOLE", "fx,fy,cx,cy", "rt_cam_world"),
        12: ("OPENCV8", "fx,fy,cx,cy,k1,k2,p1,p2,k3,k4,k5,k6", "rt_cam_ref"),
    }[len(intrinsics)]
    numbers = lambda xs: ", ".join(f"{x:.15g}" for x in xs)
    return (
        "{\n"
        f"    'lensmodel':  'LENSMODEL_{model}',\n\n"
        f"    # intrinsics are {names}\n"
        f"    'intrinsics': [ {numbers(intrinsics)} ],\n\n"
        f"    # {frame}: a Rodrigues vector, then a translation in metres\n"
        f"    'extrinsics': [ {numbers([*rodrigues(T_cam_ref[:3, :3]), *T_cam_ref[:3, 3]])} ],\n\n"
        f"    'imagersize': [ {size[0]}, {size[1]} ],\n"
        "}\n"
    )


def rodrigues(R) -> np.ndarray:
    """Rotation matrix -> axis * angle (3,); angles below pi."""
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = np.linalg.norm(axis) / 2, (np.trace(R) - 1) / 2
    if sine < 1e-9:  # none of our cameras is turned by pi
        return axis / 2
    return axis / (2 * sine) * np.arctan2(sine, cosine)


def rotation(r) -> np.ndarray:
    """axis * angle (3,) -> rotation matrix: the inverse of `rodrigues`."""
    a = np.linalg.norm(r)
    x, y, z = np.asarray(r) / max(a, 1e-300)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K
