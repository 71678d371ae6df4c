"""The 13 pairs of real chessboards (data/opencv-stereo13), calibrated with OpenCV, and where the boards are."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.given.cameras import Camera
from lib.vision import matching

BOARDS = Path(__file__).resolve().parents[2] / "data" / "opencv-stereo13" / "boards"
NX, NY, SQUARE_M = 9, 6, 0.025


class BoardPair(NamedTuple):
    """name;  pair : matching.Stereo;  values : two (480, 640, 1) in [0, 1], undistorted
    labels : two (480, 640) int32, 2 on the board and 1 elsewhere
    true : (3,) the board's plane m . x = 1, through its triangulated corners;  middle : (3,) its middle over its depth
    """

    name: str
    pair: matching.Stereo
    values: list
    labels: list
    true: np.ndarray
    middle: np.ndarray


def board_pairs() -> list[BoardPair]:
    import cv2

    board = np.zeros((NX * NY, 3), np.float32)
    board[:, :2] = np.mgrid[:NX, :NY].T.reshape(-1, 2) * SQUARE_M
    names = sorted(p.name[5:7] for p in BOARDS.glob("left-*.png"))
    grey, corners = {}, {}
    for side in ("left", "right"):
        for name in names:
            grey[side, name] = cv2.imread(str(BOARDS / f"{side}-{name}.png"), cv2.IMREAD_GRAYSCALE)
            q = cv2.findChessboardCorners(grey[side, name], (NX, NY))[1]
            window = (5, 5), (-1, -1), (3, 50, 1e-4)
            corners[side, name] = cv2.cornerSubPix(grey[side, name], q.astype(np.float32), *window)
    points = [board] * len(names)
    seen = {s: [corners[s, n] for n in names] for s in ("left", "right")}
    lens = {s: cv2.calibrateCamera(points, seen[s], (640, 480), None, None)[1:3] for s in seen}
    fixed = {"flags": cv2.CALIB_FIX_INTRINSIC}
    R, t = cv2.stereoCalibrate(points, *seen.values(), *lens["left"], *lens["right"], (640, 480), **fixed)[5:7]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t[:, 0]
    cameras = [Camera(lens[s][0], 640, 480, pose) for s, pose in (("left", np.eye(4)), ("right", T))]
    pair = matching.stereo(*cameras)
    return [_one(name, pair, cameras, grey, corners, lens) for name in names]


def _one(name, pair, cameras, grey, corners, lens):
    import cv2

    values, labels, q = [], [], []
    for side in ("left", "right"):
        K, D = lens[side]
        values.append(np.ascontiguousarray(cv2.undistort(grey[side, name], K, D)[..., None] / 255.0))
        q.append(cv2.undistortPoints(corners[side, name], K, D, P=K)[:, 0])
        ring = q[-1].reshape(NY, NX, 2)[[0, 0, -1, -1], [0, -1, -1, 0]]
        H = cv2.getPerspectiveTransform(np.float32([[0, 0], [8, 0], [8, 5], [0, 5]]), np.float32(ring))
        outer = cv2.perspectiveTransform(np.float32([[[-0.9, -0.9], [8.9, -0.9], [8.9, 5.9], [-0.9, 5.9]]]), H)[0]
        drawn = cv2.fillConvexPoly(np.ones((480, 640), np.uint8), np.round(outer).astype(np.int32), 2)
        labels.append(drawn.astype(np.int32))
    p = cv2.triangulatePoints(*(c.K @ c.T_cam_world[:3] for c in cameras), q[0].T, q[1].T)
    p = (p[:3] / p[3]).T
    n = np.linalg.svd(p - p.mean(axis=0))[2][2]
    return BoardPair(name, pair, values, labels, n / (n @ p.mean(axis=0)), p.mean(axis=0) / p.mean(axis=0)[2])
