"""The relative pose of two photographs, up to scale, from what both show.

    q_left, q_right = match(grey_left, grey_right)              # (N, 2) px each
    pose = relative_pose(camera_left, camera_right, q_left, q_right)
    pose.rt_right_left, pose.covariance                         # |t| = 1

Features are OpenCV's SIFT, the robust estimation and its refinement are pycolmap's (LO-RANSAC, tangent Sampson error). What is
ours is what can be said about the answer: its covariance, and whether the pair tells it at all (no parallax, one plane only).
"""
from dataclasses import dataclass

import numpy as np

from lib import cameras, frames
from lib.stage import BadInput

LEAST = 15                   # inliers; five determine the pose, the rest have to confirm it
MAX_ERROR = 2.0              # px, of an inlier: Sampson's distance


@dataclass(frozen=True, eq=False)
class RelativePose:
    """rt_right_left : (6,) Rodrigues, translation of length 1
    covariance : (6, 6), rank 5, of (w, dt): R = exp(w) R_found, t = t_found + dt, dt normal to t
    inlier : (N,) bool; rms_px : of the inliers' Sampson distance; parallax_px : RMS of what no rotation alone explains
    planar : one homography explains the inliers as well; other : (6,) the second pose that then explains them, or None
    """

    rt_right_left: np.ndarray
    covariance: np.ndarray
    inlier: np.ndarray
    rms_px: float
    parallax_px: float
    planar: bool
    other: np.ndarray | None

    @property
    def angle_deg(self):
        """Between the axes of the cameras."""
        return float(np.degrees(np.arccos(np.clip(cameras.matrix_from_rt(self.rt_right_left)[2, 2], -1, 1))))


def features(grey):
    """(N, 2) px, (N, 128) float32. `enable_precise_upscale`: without it OpenCV's SIFT lies a quarter of a pixel off."""
    import cv2

    keys, descriptors = cv2.SIFT_create(8000, contrastThreshold=0.02, enable_precise_upscale=True).detectAndCompute(grey, None)
    if descriptors is None or len(keys) < 2:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    q = np.array([key.pt for key in keys])
    _, first = np.unique(q.round(3), axis=0, return_index=True)      # one place, several orientations
    descriptors = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9))      # RootSIFT: Arandjelovic and Zisserman 2012
    return q, descriptors.astype(np.float32)


def match(grey_left, grey_right, ratio=0.8):
    """(N, 2), (N, 2) px: features that are each other's nearest, and clearly nearer than the second."""
    import cv2

    (q_left, d_left), (q_right, d_right) = features(grey_left), features(grey_right)
    if min(len(q_left), len(q_right)) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    there = cv2.BFMatcher().knnMatch(d_left, d_right, k=2)
    back = {m.queryIdx: m.trainIdx for m in cv2.BFMatcher().match(d_right, d_left)}
    pairs = [(a.queryIdx, a.trainIdx) for a, b in there if a.distance < ratio * b.distance and back[a.trainIdx] == a.queryIdx]
    if not pairs:
        return np.zeros((0, 2)), np.zeros((0, 2))
    i, j = np.array(pairs).T
    both = np.concatenate([q_left[i], q_right[j]], 1)
    _, once = np.unique(both.round(2), axis=0, return_index=True)
    return q_left[i][once], q_right[j][once]


def _colmap(camera):
    import pycolmap

    K = frames.K_colmap_from_ours(camera.K)
    return pycolmap.Camera(model="PINHOLE", width=camera.width, height=camera.height, params=[K[0, 0], K[1, 1], K[0, 2], K[1, 2]])


def sampson(rt, K_left, K_right, q_left, q_right):
    """(N,) px, signed: the first-order distance of a pair of pixels to the nearest one that the pose allows (both pictures)."""
    T = cameras.matrix_from_rt(rt)
    t = T[:3, 3]
    E = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]]) @ T[:3, :3]
    F = np.linalg.inv(K_right).T @ E @ np.linalg.inv(K_left)
    left, right = (np.concatenate([q, np.ones((len(q), 1))], 1) for q in (q_left, q_right))
    l_right, l_left = left @ F.T, right @ F
    slope = np.sqrt((l_right[:, :2] ** 2).sum(1) + (l_left[:, :2] ** 2).sum(1))
    return (right * l_right).sum(1) / np.maximum(slope, 1e-300)


def moved(rt, step):
    """rt of exp(w) R and of t turned towards dt (two numbers along an orthonormal basis normal to t), |t| = 1. step : (5,)."""
    T = cameras.matrix_from_rt(rt)
    out = np.eye(4)
    out[:3, :3] = cameras.matrix_from_rt([*step[:3], 0, 0, 0])[:3, :3] @ T[:3, :3]
    t = T[:3, 3] + normal_basis(T[:3, 3]) @ step[3:]
    out[:3, 3] = t / np.linalg.norm(t)
    return cameras.rt_from_matrix(out)


def normal_basis(t):
    """(3, 2) orthonormal, normal to t."""
    return np.linalg.svd(np.reshape(t, (1, 3)))[2][1:].T


def relative_pose(left, right, q_left, q_right, names="photographs"):
    """left, right : cameras.Camera (only K and size count). BadInput: too few matches, or no parallax."""
    import pycolmap

    if len(q_left) < LEAST:
        raise BadInput(f"{names}: matches: {len(q_left)} features look alike in both, {LEAST} are needed for a relative pose")
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(0)
    colmap = [_colmap(left), _colmap(right)]
    q = [frames.colmap_from_ours(q_left), frames.colmap_from_ours(q_right)]
    options = pycolmap.RANSACOptions(max_error=MAX_ERROR, min_num_trials=1000, confidence=0.99999, random_seed=0)
    found = pycolmap.estimate_relative_pose(colmap[0], q[0], colmap[1], q[1], options)
    if found is None or found["num_inliers"] < LEAST:
        count = 0 if found is None else found["num_inliers"]
        raise BadInput(f"{names}: matches: {count} of {len(q_left)} agree on a relative pose, {LEAST} are needed")
    inlier = np.asarray(found["inlier_mask"], bool).ravel()
    pose = found["cam2_from_cam1"]
    for _ in range(3):                                               # refine, then look again who belongs to it
        refined = pycolmap.refine_relative_pose(pose, colmap[0], q[0], colmap[1], q[1], inlier)
        pose = refined["cam2_from_cam1"] if refined else pose
        rt = _rt(pose)
        error = sampson(rt, left.K, right.K, q_left, q_right)
        scale = 1.4826 * np.median(np.abs(error[inlier]))
        again = np.abs(error) < np.clip(3 * scale, 0.3, MAX_ERROR)
        if again.sum() < LEAST or (again == inlier).all():
            break
        inlier = again
    e = error[inlier]
    rms = float(np.sqrt((e ** 2).mean()))
    parallax, homography = _without_translation(left, right, q_left[inlier], q_right[inlier])
    if parallax < max(3 * rms, 0.5):
        raise BadInput(f"{names}: baseline: turning the camera explains the matches to {parallax:.2f} px: without parallax no relative position and no depth")
    J = np.stack([(sampson(moved(rt, h), left.K, right.K, q_left[inlier], q_right[inlier]) - sampson(moved(rt, -h), left.K, right.K, q_left[inlier], q_right[inlier]))
                  / 2e-6 for h in 1e-6 * np.eye(5)], 1)
    noise2 = (e ** 2).sum() / max(len(e) - 5, 1)
    basis = np.zeros((6, 5))
    basis[:3, :3], basis[3:, 3:] = np.eye(3), normal_basis(rt[3:])
    covariance = basis @ np.linalg.pinv(J.T @ J, rcond=1e-15) @ basis.T * noise2
    planar, other = _plane(left, right, q_left[inlier], q_right[inlier], rt, rms)
    return RelativePose(rt, covariance, inlier, rms, parallax, planar, other)


def _rt(rigid):
    T = np.eye(4)
    T[:3] = rigid.matrix()
    T[:3, 3] /= np.linalg.norm(T[:3, 3])
    return cameras.rt_from_matrix(T)


def _without_translation(left, right, q_left, q_right):
    """RMS px of the matches under the best rotation alone, and that rotation."""
    v_left, v_right = (camera.directions(q) for camera, q in ((left, q_left), (right, q_right)))
    u, v = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (v_left, v_right))
    keep = np.ones(len(u), bool)
    for _ in range(5):                                               # most of a scene far away and something near is parallax, not noise
        U, _, Vt = np.linalg.svd(v[keep].T @ u[keep])
        R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
        p = v_left @ R.T @ right.K.T
        error = np.linalg.norm(p[:, :2] / p[:, 2:] - q_right, axis=1)
    return float(np.sqrt((error ** 2).mean())), R


def _plane(left, right, q_left, q_right, rt, rms):
    """(one homography explains the matches as well as the pose does, the second pose that follows from it or None).

    A plane seen twice has two explanations (Longuet-Higgins 1986; Faugeras and Lustman 1988): both are returned where both
    have every point in front of both cameras."""
    import cv2

    H, _ = cv2.findHomography(q_left, q_right, 0)
    if H is None:
        return False, None
    p = np.concatenate([q_left, np.ones((len(q_left), 1))], 1) @ H.T
    error = np.linalg.norm(p[:, :2] / p[:, 2:] - q_right, axis=1)
    if np.sqrt((error ** 2).mean()) > max(3 * rms, 0.5):
        return False, None
    _, rotations, translations, normals = cv2.decomposeHomographyMat(np.linalg.inv(right.K) @ H @ left.K, np.eye(3))
    v = left.directions(q_left)
    candidates = []
    for R, t, n in zip(rotations, translations, normals):
        length = np.linalg.norm(t)
        if length < 1e-12 or not ((v @ n.ravel() > 0).all() or (v @ n.ravel() < 0).all()):
            continue
        sign = 1 if (v @ n.ravel() > 0).all() else -1                # the plane lies in front: (n, t) and (-n, -t) are the same
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, sign * t.ravel() / length
        candidates.append(cameras.rt_from_matrix(T))
    unlike = [c for c in candidates if _angle(c, rt) > np.radians(2)]
    return True, (min(unlike, key=lambda c: _angle(c, rt)) if unlike else None)


def _angle(a, b):
    """Between the directions of two translations, rad."""
    return float(np.arccos(np.clip(a[3:] @ b[3:] / np.linalg.norm(a[3:]) / np.linalg.norm(b[3:]), -1, 1)))
