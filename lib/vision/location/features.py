"""Poses from features: what a posed photograph and another one both show lies on the model, and so is known in space.

    for start in starts(model, posed, photograph, lens):
        start.T, start.focal_px, start.agree

Features and their matches are those of the pair (lib/vision/orientation.py). The model gives each its depth. Pose, and
the focal length where it is unknown, are pycolmap's, by LO-RANSAC (P3P, P4Pf), then by least squares.
"""

from typing import NamedTuple

import numpy as np

from lib.buffers.index_buffer import Probe
from lib.given import frames
from lib.given.cameras import Camera

LEAST = 8  # matches that agree; a start is judged by edges, so a few will do
MAX_ERROR_PX = 6.0
MIN_FOCAL, MAX_FOCAL = 0.4, 4.0  # of the picture's longer side


class Start(NamedTuple):
    """A pose to begin with.  T : (4, 4) world to camera;  focal_px : of the lens;  agree : how much speaks for it"""

    T: np.ndarray
    focal_px: float
    agree: float


class Seen(NamedTuple):
    """n features of a photograph that lie on the model: q (n, 2) px in it, p (n, 3) m, world"""

    q: np.ndarray
    p: np.ndarray


def on_model(model, camera, q_known, q) -> Seen:
    """Matches whose pixel q_known (n, 2) of a posed camera shows the model; q : (n, 2) px of the other photograph."""
    facet, depth = Probe(model, camera).at(q_known)
    met = (facet >= 0) & np.isfinite(depth)
    x = depth[met, None] * camera.directions(q_known[met])
    return Seen(q[met], (x - camera.T_cam_world[:3, 3]) @ camera.T_cam_world[:3, :3])


def absolute_pose(seen, camera, focal_known) -> Start | None:
    """The pose that most features agree on; None where too few do.  camera : Camera, of which K and the size count"""
    import pycolmap

    if len(seen.q) < LEAST:
        return None
    pycolmap.logging.minloglevel = 3
    pycolmap.set_random_seed(0)
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.estimate_focal_length = not focal_known
    options.ransac.max_error = MAX_ERROR_PX
    options.ransac.random_seed = 0
    options.ransac.min_num_trials = 1000
    refining = pycolmap.AbsolutePoseRefinementOptions()
    refining.refine_focal_length = not focal_known
    K = frames.K_colmap_from_ours(camera.K)
    colmap = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=camera.width, height=camera.height, params=[K[0, 0], K[0, 2], K[1, 2]]
    )
    if focal_known:
        colmap = pycolmap.Camera(
            model="PINHOLE", width=camera.width, height=camera.height, params=[K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        )
    found = pycolmap.estimate_and_refine_absolute_pose(
        frames.colmap_from_ours(seen.q), seen.p, colmap, options, refining
    )
    if found is None or found["num_inliers"] < LEAST:
        return None
    focal = float(found["camera"].params[0]) if "camera" in found and not focal_known else float(colmap.params[0])
    longer = max(camera.width, camera.height)
    if not MIN_FOCAL * longer < focal < MAX_FOCAL * longer:
        return None
    T = np.eye(4)
    T[:3] = found["cam_from_world"].matrix()
    return Start(T, focal, float(found["num_inliers"]))


def agreeing(seen, camera) -> int:
    """How many features a posed Camera puts where they are."""
    with np.errstate(invalid="ignore"):
        return int((np.linalg.norm(camera.project(seen.p) - seen.q, axis=1) < MAX_ERROR_PX).sum())


def posed(start, camera) -> Camera:
    """The camera at a start, with its focal length."""
    K = camera.K.copy()
    K[1, 1] *= start.focal_px / K[0, 0]
    K[0, 0] = start.focal_px
    return Camera(K, camera.width, camera.height, start.T)
