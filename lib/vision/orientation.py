"""The relative pose of two photographs, up to scale, from what both show.

    q_left, q_right = match(grey_left, grey_right)              # (N, 2) px each
    pose = relative_pose(camera_left, camera_right, q_left, q_right)
    pose.rt_right_left, pose.covariance                         # |t| = 1

Features are OpenCV's SIFT, the robust estimate is pycolmap's (LO-RANSAC, tangent Sampson error). Ours is the refinement
by a loss that forgives long tails, and what can be said about the answer: its covariance, and whether the pair tells it
at all (no parallax, one plane only).
"""

from dataclasses import dataclass

import numpy as np

from lib.core.stage import BadInput
from lib.given import cameras, frames

LEAST = 15  # inliers; five determine the pose, the rest have to confirm it
STILL = 0.6  # share of the matches that a rotation alone may explain: some of the others agree with any pose by chance
MAX_ERROR = 2.0  # px, of an inlier: Sampson's distance
STEP = 1e-6  # of the numerical derivatives


@dataclass(frozen=True, eq=False)
class RelativePose:
    """Where the right camera stands, in units of the baseline.

    rt_right_left : (6,) Rodrigues, translation of length 1
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
    """[((N, 2) px, (N, 128) float32)] of two kinds: SIFT's own blobs, and corners, of which plain rooms have more.

    grey : (H, W) uint8. `enable_precise_upscale`: without it OpenCV's SIFT lies a quarter of a pixel off. Corners are
    described upright and at one size. That tells them apart better, for the cameras of a pair stand alike.
    """
    import cv2

    sift = cv2.SIFT_create(8000, contrastThreshold=0.02, enable_precise_upscale=True)
    keys, descriptors = sift.detectAndCompute(grey, None)
    blobs = np.array([key.pt for key in keys]).reshape(-1, 2), descriptors
    soft = cv2.GaussianBlur(grey, (0, 0), 1.0)
    q = cv2.goodFeaturesToTrack(soft, 2000, 0.003, 4, blockSize=7)
    if q is None:
        return [_unique(*blobs)]
    start = q.copy()
    cv2.cornerSubPix(soft, q, (4, 4), (-1, -1), (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3))
    q = q[np.abs(q - start).max((1, 2)) < 3].reshape(-1, 2)
    keys, descriptors = sift.compute(soft, [cv2.KeyPoint(float(x), float(y), 16.0, 0.0) for x, y in q])
    return [_unique(*blobs), _unique(np.array([key.pt for key in keys]).reshape(-1, 2), descriptors)]


def _unique(q, descriptors):
    """One feature to a place, however many orientations it has, as RootSIFT (Arandjelovic and Zisserman 2012)."""
    if descriptors is None or not len(q):
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    _, first = np.unique(q.round(2), axis=0, return_index=True)
    descriptors = np.sqrt(descriptors[first] / np.maximum(descriptors[first].sum(1, keepdims=True), 1e-9))
    return q[first].astype(float), descriptors.astype(np.float32)


def match(grey_left, grey_right, ratio=0.8):
    """(N, 2), (N, 2) px: features that are each other's nearest, and clearly nearer than the second."""
    import cv2

    found = [np.zeros((0, 4))]
    # strict=False: a picture without corners has blobs only
    for (q_left, d_left), (q_right, d_right) in zip(features(grey_left), features(grey_right), strict=False):
        if min(len(q_left), len(q_right)) < 2:
            continue
        there = cv2.BFMatcher().knnMatch(d_left, d_right, k=2)
        back = {m.queryIdx: m.trainIdx for m in cv2.BFMatcher().match(d_right, d_left)}
        found += [
            np.concatenate([q_left[a.queryIdx], q_right[a.trainIdx]])[None]
            for a, b in there
            if a.distance < ratio * b.distance and back[a.trainIdx] == a.queryIdx
        ]
    both = np.concatenate(found)
    _, once = np.unique(both.round(1), axis=0, return_index=True)
    return both[once, :2], both[once, 2:]


def _colmap(camera):
    import pycolmap

    K = frames.K_colmap_from_ours(camera.K)
    return pycolmap.Camera(
        model="PINHOLE", width=camera.width, height=camera.height, params=[K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    )


def sampson(rt, K_left, K_right, q_left, q_right):
    """(N,) px, signed: the first-order distance of a pair of pixels to the nearest pair that the pose allows.

    Sampson's: x_right^T F x_left, divided by the length of its gradient in both pictures.
    rt : (6,) left to right; K_left, K_right : (3, 3) px; q_left, q_right : (N, 2) px
    """
    T = cameras.matrix_from_rt(rt)
    t = T[:3, 3]
    E = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]]) @ T[:3, :3]
    F = np.linalg.inv(K_right).T @ E @ np.linalg.inv(K_left)
    left, right = (np.concatenate([q, np.ones((len(q), 1))], 1) for q in (q_left, q_right))
    l_right, l_left = left @ F.T, right @ F
    slope = np.sqrt((l_right[:, :2] ** 2).sum(1) + (l_left[:, :2] ** 2).sum(1))
    return (right * l_right).sum(1) / np.maximum(slope, 1e-300)


def moved(rt, step):
    """rt (6,) after a step (5,): w turns R to exp(w) R, two numbers along `normal_basis` turn t; |t| = 1."""
    T = cameras.matrix_from_rt(rt)
    out = np.eye(4)
    out[:3, :3] = cameras.matrix_from_rt([*step[:3], 0, 0, 0])[:3, :3] @ T[:3, :3]
    t = T[:3, 3] + normal_basis(T[:3, 3]) @ step[3:]
    out[:3, 3] = t / np.linalg.norm(t)
    return cameras.rt_from_matrix(out)


def normal_basis(t):
    """(3, 2) orthonormal, normal to t."""
    return np.linalg.svd(np.reshape(t, (1, 3)))[2][1:].T


def relative_pose(left, right, q_left, q_right, names="photographs", samples=40, trace=None) -> RelativePose:
    """The pose that most matches agree on, its covariance, and whether it is the only one.

    left, right : cameras.Camera, of which only K and size count; q_left, q_right : (N, 2) px, matched
    names : of the photographs, for messages; samples : of the bootstrap
    trace : called with rms_px= and inliers= at each step of the refinement

    BadInput: too few matches, or no parallax.
    """
    rt = _consensus(left, right, q_left, q_right, names)
    residual = lambda rt, these=slice(None): sampson(rt, left.K, right.K, q_left[these], q_right[these])
    inlier = np.abs(residual(rt)) < MAX_ERROR
    rt, scale = refine(residual, rt, np.flatnonzero(inlier), trace=trace)
    inlier = np.abs(residual(rt)) < min(6 * scale, MAX_ERROR)
    rt, scale = refine(residual, rt, np.flatnonzero(inlier), trace=trace)
    if inlier.sum() < LEAST:
        raise BadInput(_too_few(names, inlier.sum(), len(q_left)))
    rms = float(np.sqrt((residual(rt, inlier) ** 2).mean()))
    if trace:
        trace(rms_px=rms, inliers=int(inlier.sum()))
    parallax = _parallax(left, right, q_left[inlier], q_right[inlier], rms, names)
    cell = (q_left // (max(left.width, left.height) / 8)).astype(int) @ [1000, 1]
    covariance = bootstrap(residual, rt, np.flatnonzero(inlier), cell[inlier], np.random.default_rng(0), samples)
    planar, other = _plane(left, right, q_left[inlier], q_right[inlier], rt, rms)
    return RelativePose(rt, covariance, inlier, rms, parallax, planar, other)


def _consensus(left, right, q_left, q_right, names):
    """(6,) by LO-RANSAC. BadInput: fewer than LEAST matches agree."""
    import pycolmap

    if len(q_left) < LEAST:
        raise BadInput(
            f"{names}: matches: {len(q_left)} features look alike in both, {LEAST} are needed for a relative pose"
        )
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(0)
    colmap = [_colmap(left), _colmap(right)]
    q = [frames.colmap_from_ours(q_left), frames.colmap_from_ours(q_right)]
    options = pycolmap.RANSACOptions(max_error=MAX_ERROR, min_num_trials=1000, confidence=0.99999, random_seed=0)
    found = pycolmap.estimate_relative_pose(colmap[0], q[0], colmap[1], q[1], options)
    count = 0 if found is None else found["num_inliers"]
    if count < LEAST:
        raise BadInput(_too_few(names, count, len(q_left)))
    return _rt(found["cam2_from_cam1"])


def _too_few(names, count, number):
    return f"{names}: matches: {count} of {number} agree on a relative pose, {LEAST} are needed"


def _parallax(left, right, q_left, q_right, rms, names):
    """RMS px of what no rotation alone explains. BadInput: a rotation explains most of the matches."""
    shift = _without_translation(left, right, q_left, q_right)
    still = float((shift < max(3 * rms, 0.5)).mean())
    if still > STILL:
        raise BadInput(
            f"{names}: baseline: turning the camera explains {100 * still:.0f} % of the matches, to "
            f"{np.median(shift):.2f} px: without parallax no relative position and no depth"
        )
    return float(np.sqrt((shift**2).mean()))


def refine(residual, rt, these, scale=None, steps=20, trace=None):
    """(rt, scale px): minimise sum log(1 + (e / scale)^2), Cauchy's loss, by reweighted Gauss-Newton.

    residual : (rt, these) -> (n,) px; these : indices of the matches; scale : px, or None for the residuals' own
    trace : called with rms_px= and inliers= before each step

    Matches in a room slide along edges and sit on shadows: their errors have long tails, and squares would follow them.
    """
    at = lambda h: residual(moved(rt, h), these)
    for _ in range(steps):
        e = residual(rt, these)
        if trace:
            trace(rms_px=float(np.sqrt((e**2).mean())), inliers=len(these))
        s = scale or max(1.4826 * np.median(np.abs(e)), 0.02)
        J = np.stack([(at(h) - at(-h)) / (2 * STEP) for h in STEP * np.eye(5)], 1)
        weight = 1 / (1 + (e / s) ** 2)
        A = J.T @ (weight[:, None] * J)
        step = np.linalg.solve(A + 1e-9 * np.trace(A) * np.eye(5), -J.T @ (weight * e))
        rt = moved(rt, step * min(1.0, 0.2 / np.abs(step).max()))
        if np.abs(step).max() < 1e-7:
            break
    return rt, s


def bootstrap(residual, rt, these, cell, random, samples):
    """(6, 6), rank 5: the spread about rt of the pose from cells of the picture, drawn with replacement.

    residual, these : as in `refine`; cell : (len(these),) which cell each match lies in

    The bootstrap asks nothing of the errors' distribution (Efron 1979). Whole cells with all their matches are drawn
    (Kuensch 1989), for neighbours sit on one edge or shadow and err alike. The usual J^T J is right for independent
    normal errors; in rooms of few features it promised a tenth of the true error.
    """
    _, scale = refine(residual, rt, these, steps=1)
    basis = normal_basis(rt[3:])
    R = cameras.matrix_from_rt(rt)[:3, :3]
    spread = np.zeros((6, 6))
    members = [these[cell == name] for name in np.unique(cell)]
    for _ in range(samples):
        drawn = np.concatenate([members[i] for i in random.integers(len(members), size=len(members))])
        if len(drawn) < 8:
            continue
        other, _ = refine(residual, rt, drawn, scale, steps=5)
        turn = np.eye(4)
        turn[:3, :3] = cameras.matrix_from_rt(other)[:3, :3] @ R.T
        d = np.concatenate([cameras.rt_from_matrix(turn)[:3], basis @ basis.T @ other[3:]])
        spread += np.outer(d, d) / samples
    return spread


def _rt(rigid):
    T = np.eye(4)
    T[:3] = rigid.matrix()
    T[:3, 3] /= np.linalg.norm(T[:3, 3])
    return cameras.rt_from_matrix(T)


def _without_translation(left, right, q_left, q_right):
    """(N,) px: how far each match is from its place under the best rotation alone.

    By reweighting (Cauchy's loss): some of the matches that agree with a wrong pose are wrong, and squares would follow
    those.
    """
    v_left, v_right = (camera.directions(q) for camera, q in ((left, q_left), (right, q_right)))
    u, v = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (v_left, v_right))
    weight = np.ones(len(u))
    for _ in range(30):
        U, _, Vt = np.linalg.svd((weight[:, None] * v).T @ u)
        R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
        p = v_left @ R.T @ right.K.T
        error = np.linalg.norm(p[:, :2] / p[:, 2:] - q_right, axis=1)
        weight = 1 / (1 + (error / max(np.median(error), 0.02)) ** 2)
    return error


def _plane(left, right, q_left, q_right, rt, rms):
    """(one homography explains the matches as well as the pose rt does, the second pose that it allows or None).

    A plane seen twice has two explanations (Longuet-Higgins 1986; Faugeras and Lustman 1988): the other one is returned
    where it has every point in front of both cameras.
    """
    import cv2

    H, on = cv2.findHomography(q_left, q_right, cv2.RANSAC, max(4 * rms, 1.0))
    if H is None or on.mean() < 0.9:
        return False, None
    q_left = q_left[on.ravel() > 0]
    _, rotations, translations, normals = cv2.decomposeHomographyMat(np.linalg.inv(right.K) @ H @ left.K, np.eye(3))
    v = left.directions(q_left)
    candidates = []
    for R, t, n in zip(rotations, translations, normals, strict=True):
        length = np.linalg.norm(t)
        if length < 1e-12 or not ((v @ n.ravel() > 0).all() or (v @ n.ravel() < 0).all()):
            continue
        sign = 1 if (v @ n.ravel() > 0).all() else -1  # the plane lies in front: (n, t) and (-n, -t) are the same
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, sign * t.ravel() / length
        candidates.append(cameras.rt_from_matrix(T))
    unlike = [c for c in candidates if _angle(c, rt) > np.radians(2)]
    return True, (min(unlike, key=lambda c: _angle(c, rt)) if unlike else None)


def _angle(a, b):
    """Between the directions of two translations, rad."""
    return float(np.arccos(np.clip(a[3:] @ b[3:] / np.linalg.norm(a[3:]) / np.linalg.norm(b[3:]), -1, 1)))
