"""Two cameras that move together: projection and its derivatives."""

import math
import time
from dataclasses import dataclass

import numpy as np

from lib.core.stage import BadInput
from lib.given import image
from lib.given.cameras import Camera, read_cameramodel, rt_from_matrix
from lib.given.view import size_problem
from lib.vision.recognition.closed_form import moved
from lib.vision.refinement.edges import draw


@dataclass(frozen=True, eq=False)
class Side:
    """One photograph of the pair.

    camera : in the pair's frame; photograph : image.Photograph; surfaces : (H, W) int labels, or None
    """

    camera: Camera
    photograph: object
    surfaces: np.ndarray = None

    @classmethod
    def read(cls, camera, photograph, surfaces=None) -> "Side":
        """From files. BadInput: one that cannot be used, or a picture whose size is not the camera's."""
        labels = None if surfaces is None else image.read_labels(surfaces)
        side = cls(read_cameramodel(camera), image.read_photograph(photograph), labels)
        for path, values in ((photograph, side.photograph.values), (surfaces, labels)):
            if path is not None and (problem := size_problem(path, values, side.camera, camera)):
                raise BadInput(problem)
        return side


# Levenberg-Marquardt on one set of correspondences.


@dataclass(frozen=True, eq=False)
class Rig:
    """The pair, fixed.

    sides : of Side; relative : T_side_left of each, the translation in units of the facets; depth : m, how far away the
    model is seen
    is_zoom : `scale` is no length: it multiplies the focal lengths of a lone camera whose lens is not known
    """

    sides: tuple
    relative: tuple
    depth: float
    is_zoom: bool = False

    def cameras(self, T, scale):
        """Posed by T (4, 4), world to the left camera. scale : m per unit of the facets, or of the focal length"""
        made = []
        for side, D in zip(self.sides, self.relative, strict=True):
            D, K = D.copy(), side.camera.K
            if self.is_zoom:
                K = zoomed(K, scale)
            else:
                D[:3, 3] *= scale
            made.append(Camera(K, side.camera.width, side.camera.height, D @ T))
        return tuple(made)


def zoomed(K, factor):
    """K (3, 3) with both focal lengths so many times as long."""
    K = K.copy()
    K[:2, :2] *= factor
    return K


def project(rig, side, T, scale, p, jacobian=False, free=False):
    """Pixels (N, 2) of world points p (N, 3) m and, if asked for, their derivatives (N, 2, 6), or 7 with ln scale."""
    K, D = rig.sides[side].camera.K, rig.relative[side]
    K, shift = (zoomed(K, scale), 0.0) if rig.is_zoom else (K, scale)
    centre = -T[:3, :3].T @ T[:3, 3]
    x_left = (p - centre) @ T[:3, :3].T
    x = x_left @ D[:3, :3].T + shift * D[:3, 3]
    z = np.where(x[:, 2] > 1e-9, x[:, 2], 1e-9)
    q = (x / z[:, None]) @ K.T
    if not jacobian:
        return q[:, :2]
    dq = np.zeros((len(p), 2, 3))
    dq[:, 0, 0], dq[:, 1, 1] = K[0, 0] / z, K[1, 1] / z
    dq[:, 0, 2], dq[:, 1, 2] = -K[0, 0] * x[:, 0] / z**2, -K[1, 1] * x[:, 1] / z**2
    dx = np.zeros((len(p), 3, 7 if free else 6))
    cross = np.zeros((len(p), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = x_left[:, 2], -x_left[:, 1], x_left[:, 0]
    cross -= cross.transpose(0, 2, 1)
    dx[:, :, :3] = D[:3, :3] @ cross
    dx[:, :, 3:6] = D[:3, :3]
    if free:
        dx[:, :, 6] = shift * D[:3, 3]
    J = dq @ dx
    if free and rig.is_zoom:
        J[:, :, 6] = q[:, :2] - K[:2, 2]
    return q[:, :2], J


def step(T, scale, delta):
    """(T, scale) after a step (6,) of (omega, tau) along the left camera's axes, or (7,) with ln scale."""
    return moved(T, delta), scale * math.exp(min(max(delta[6], -0.5), 0.5)) if len(delta) == 7 else scale


def gap_to_prior(prior, T, scale, size):
    """(size,): the step from the prior's pose to this one."""
    _, T0, scale0 = prior
    D = T @ np.linalg.inv(T0)
    gap = rt_from_matrix(D)
    return np.append(gap, math.log(scale / scale0)) if size == 7 else gap


def point(trace, T, error_px, step="refined", **more):
    """One entry of the trace; the clocks are the process's."""
    return {
        "iteration": len(trace),
        "step": step,
        "error_px": error_px,
        **more,
        "rt_cam_world": rt_from_matrix(T),
        "cpu_s": time.process_time(),
        "wall_s": time.perf_counter(),
    }


@dataclass(frozen=True, eq=False)
class Fit:
    """The last solve. H : normal matrix; per side parts : (J, residuals, robust weights), at : (edge of each sample,
    samples in all), where : (p, normal)"""

    H: np.ndarray
    parts: list
    at: list
    where: list


def rms(parts):
    """px, by the robust weights. parts : [(J, residuals, robust weights)]"""
    total = sum((w * r**2).sum() for _, r, w in parts)
    return float(math.sqrt(total / max(sum(w.sum() for _, _, w in parts), 1e-12)))


def view(rig):
    """(5, 2) px: corners and middle of the left picture; (5, 3) m: points there at the scene's depth, its axes."""
    camera = rig.sides[0].camera
    W, H = camera.width - 1, camera.height - 1
    q = np.array([[0, 0], [W, 0], [0, H], [W, H], [W / 2, H / 2]], float)
    return q, camera.directions(q) * rig.depth


def moved_px(rig, old, T, scale):
    """How far corners and middle of the picture move between two poses, px (largest)."""
    q, x = view(rig)
    T0, scale0 = old
    p = (x - T0[:3, 3]) @ T0[:3, :3]
    if rig.is_zoom:
        q = project(rig, 0, T0, scale0, p)
    return float(np.abs(project(rig, 0, T, scale, p) - q).max())


def rig_of(sides, depth, is_zoom=False):
    """The Rig of the left Side and the right one, if there is one. depth : m"""
    inverse = np.linalg.inv(sides[0].camera.T_cam_world)
    return Rig(tuple(sides), tuple(side.camera.T_cam_world @ inverse for side in sides), depth, is_zoom)


def depth(model, camera):
    """m: the median depth of what the camera would see."""
    small = Camera(
        np.diag([0.125, 0.125, 1]) @ camera.K, max(camera.width // 8, 1), max(camera.height // 8, 1), camera.T_cam_world
    )
    depth = draw(model, small).depth
    return float(np.median(depth[depth > 0])) if (depth > 0).any() else float(np.ptp(model.vertices, axis=0).max())
