"""Chessboards for the tests.

Corners as a lens sees them, and pictures of them by exact ray casting through the same lens.
"""

import numpy as np

from lib.given import cameras, lenses
from lib.vision import boards

CORNERS, SQUARE = (9, 6), 0.03
TRUE = {
    "left": [600.0, 598.0, 322.0, 236.0, -0.20, 0.06, 0.0006, -0.0004, 0.0, 0.0, 0.0, 0.0],
    "right": [596.0, 597.0, 316.0, 243.0, -0.18, 0.05, -0.0003, 0.0005, 0.0, 0.0, 0.0, 0.0],
}
RT_RIGHT_LEFT = np.array([0.004, 0.10, -0.01, -0.30, 0.005, 0.02])


def lens(side, rt=None, model="LENSMODEL_OPENCV8"):
    return lenses.Lens(
        model,
        np.array(TRUE[side]),
        640,
        480,
        cameras.matrix_from_rt(RT_RIGHT_LEFT if rt is None and side == "right" else np.zeros(6) if rt is None else rt),
        side,
    )


def grid(corners=CORNERS, square=SQUARE):
    """(ny, nx, 3) m, in the board's own frame, its middle at the origin."""
    x, y = np.meshgrid(np.arange(corners[0]), np.arange(corners[1]))
    return np.stack([x - (corners[0] - 1) / 2, y - (corners[1] - 1) / 2, 0 * x], -1) * square


def poses(n, random, tilt=0.5, distance=(0.6, 1.2), reach=0.75):
    """(4, 4) T_left_board each: tilted by about `tilt` rad, spread over the left picture."""
    out = []
    while len(out) < n:
        z = random.uniform(*distance)
        q = np.array([319.5, 239.5]) + reach * random.uniform(-1, 1, 2) * [320, 240]
        x, y = (q - [322.0, 236.0]) / 600.0
        out.append(cameras.matrix_from_rt([*random.normal(0, tilt, 2), random.normal(0, 0.2), x * z, y * z, z]))
    return out


def seen(T_left_boards, left, right, random, noise=0.1, corners=CORNERS, square=SQUARE, whole=True):
    """boards.Boards as the two lenses see them, with normal noise (px).

    `whole`: a board that leaves the picture is not seen.
    """
    q = np.full((2, len(T_left_boards), corners[1], corners[0], 2), np.nan)
    T_ref_left = np.linalg.inv(left.T_cam_ref)
    for n, T in enumerate(T_left_boards):
        p = grid(corners, square) @ T[:3, :3].T + T[:3, 3]
        for side, view in enumerate((left, right)):
            T_view_left = view.T_cam_ref @ T_ref_left
            at = view.project(p @ T_view_left[:3, :3].T + T_view_left[:3, 3])
            there = (at > 0).all(-1) & (at < [view.width - 1, view.height - 1]).all(-1)
            if there.all() or (there.any() and not whole):
                q[side, n] = np.where(there[..., None], at + random.normal(0, noise, at.shape), np.nan)
    names = tuple(tuple(f"{side}-{n:02d}.png" for n in range(len(T_left_boards))) for side in boards.SIDES)
    return boards.Boards(names, q, np.zeros(q.shape[:-1]))


def rays(view, s):
    """(s H, s W, 3), z = 1: the ray of every sub-pixel, by cubic splines between every eighth pixel's (1e-5 px)."""
    from scipy.interpolate import RectBivariateSpline

    x, y = np.linspace(-1, view.width, view.width // 8 + 2), np.linspace(-1, view.height, view.height // 8 + 2)
    v = view.unproject(np.stack(np.meshgrid(x, y), -1))
    at = [(np.arange(n * s) + 0.5) / s - 0.5 for n in (view.height, view.width)]
    u = [RectBivariateSpline(y, x, v[..., k])(*at) for k in (0, 1)]
    return np.stack([*u, np.ones_like(u[0])], -1)


def render(view, T_view_board, random, corners=CORNERS, square=SQUARE, oversampling=4, blur=0.5, noise=0.01):
    """(H, W) uint8, gamma 2.2: each pixel the mean of oversampling^2 rays, then a little blur and noise."""
    import cv2

    s = oversampling
    v = rays(view, s)
    H = np.linalg.inv(np.stack([T_view_board[:3, 0], T_view_board[:3, 1], T_view_board[:3, 3]], 1))
    p = v @ H.T
    p = p[..., :2] / p[..., 2:] / square + [(corners[0] - 1) / 2, (corners[1] - 1) / 2]
    cell = np.floor(p).astype(int) + 1
    on = ((cell >= 0) & (cell <= corners)).all(-1)
    paper = ((p > -2) & (p < np.add(corners, 1))).all(-1)
    light = np.where(on & (cell.sum(-1) % 2 == 0), 0.03, np.where(paper, 0.8, 0.2))
    light = cv2.GaussianBlur(light.reshape(view.height, s, view.width, s).mean((1, 3)), (0, 0), blur)
    return np.rint(255 * np.clip(light ** (1 / 2.2) + random.normal(0, noise, light.shape), 0, 1)).astype(np.uint8)
