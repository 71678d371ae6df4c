"""Chessboards before a pair of cameras: what they look like, and the places where they are held."""

from dataclasses import dataclass, replace

import numpy as np

from lib.synthetic.geometry import Polygon
from lib.synthetic.optics import rotation

CELLS = 9, 12  # rows and columns into which a picture is parted, to tell which of its parts boards have covered


@dataclass(frozen=True)
class Board:
    """A flat chessboard and where it was held.

    Inner corner (i, j) lies at (i, j, 0) square_m of its frame; z points away from the camera.
    """

    corners: tuple  # inner corners across, down
    square_m: float
    T_left_board: tuple  # of (4, 4)

    def points(self) -> np.ndarray:
        """(across * down, 3) m, row by row."""
        x, y = np.meshgrid(np.arange(self.corners[0]), np.arange(self.corners[1]))
        return np.stack([x, y, 0 * x], -1).reshape(-1, 3) * self.square_m

    def outline(self, margin) -> np.ndarray:
        """(4, 3) m: the corners of the squares' rectangle and `margin` squares around it."""
        (x0, y0), (x1, y1) = (-1 - margin, -1 - margin), (self.corners[0] + margin, self.corners[1] + margin)
        return np.array([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)]) * self.square_m

    def polygons(self, T) -> list[Polygon]:
        """Black and white squares and a white margin, one square wide, in the frame that T (4, 4) leads to."""

        def piece(group, x0, y0, x1, y1):  # the front sees the camera, at -z
            p = np.array([(x0, y0, 0), (x0, y1, 0), (x1, y1, 0), (x1, y0, 0)]) * self.square_m
            return Polygon("board", group, p @ T[:3, :3].T + T[:3, 3])

        nx, ny = self.corners
        out = [piece(("black", "white")[(i + j) % 2], i, j, i + 1, j + 1) for j in range(-1, ny) for i in range(-1, nx)]
        return out + [
            piece("white", -2, -2, nx + 1, -1),
            piece("white", -2, ny, nx + 1, ny + 1),
            piece("white", -2, -1, -1, ny),
            piece("white", nx, -1, nx + 1, ny),
        ]


@dataclass(frozen=True)
class View:
    """How one camera sees a board."""

    kind: str  # whole; hidden: at least 10 corners lie outside the picture; partly: neither
    cells: tuple = ()  # of a whole board: (rows, columns) of the cells that show its corners


def shots(corners, square_m, lenses, T_right_left, size, random, both=12, single=2) -> Board:
    """A board before a pair: `both` times seen wholly by both cameras, and `single` times each, close, by one alone.

    Of 60 places drawn for each shot the one is taken that covers most cells of the two pictures.  Cells that were seen
    seldom before count more.
    """
    seen = np.zeros((2, *CELLS))
    places, board = [], Board(corners, square_m, ())
    cameras = tuple(zip(lenses, (np.eye(4), T_right_left), strict=True))
    for kind in ["both"] * both + [0] * single + [1] * single:
        best, tries = None, 0
        while tries < 60:
            T = _drawn_place(kind, board, lenses, T_right_left, size, random)
            views = _views(kind, board, cameras, T, size)
            if views is None:
                continue
            tries += 1
            shown = [(s, view.cells) for s, view in enumerate(views) if view.kind == "whole"]
            gain = sum((1 / (1 + seen[s][cells]) ** 2).sum() for s, cells in shown)
            if best is None or gain > best[0]:
                best = gain, T, shown
        _, T, shown = best
        places.append(T)
        for s, cells in shown:
            seen[s][cells] += 1
    return replace(board, T_left_board=tuple(places))


def _drawn_place(kind, board, lenses, T_right_left, size, random):
    """T_left_board of a board at a place drawn by `random`; kind: "both", or which camera sees it, close."""
    W, H = size
    z = random.uniform(0.70, 1.8) if kind == "both" else random.uniform(0.50, 0.75)
    side = 0 if kind == "both" else kind
    u, v = random.uniform(0.05 * W, 0.95 * W), random.uniform(0.05 * H, 0.95 * H)
    x, y = lenses[side].unproject(u, v)
    axis = random.uniform(0, 2 * np.pi)
    tilt, roll = random.uniform(0.25, 0.85), random.uniform(-0.5, 0.5)
    R = rotation((np.cos(axis) * tilt, np.sin(axis) * tilt, 0)) @ rotation((0, 0, roll))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, np.array([x, y, 1]) * z - R @ board.points().mean(0)
    return np.linalg.inv(T_right_left) @ T if side == 1 else T


def _views(kind, board, cameras, T_left_board, size):
    """The board in each camera, or None where a camera does not see it as `kind` wants."""
    views = []
    for s, (lens, T_cam_left) in enumerate(cameras):
        view = _seen(board, lens, T_cam_left @ T_left_board, size)
        if view.kind != ("whole" if kind in ("both", s) else "hidden"):
            return None
        views.append(view)
    return views


def _seen(board, lens, T_cam_board, size) -> View:
    """How a camera sees a board; one seen at more than 60 degrees from its normal is not `whole`."""
    W, H = size
    edge, p = (x @ T_cam_board[:3, :3].T + T_cam_board[:3, 3] for x in (board.outline(0.6), board.points()))
    if edge[:, 2].min() < 0.3:
        return View("hidden")
    edge, q = lens.project(edge), lens.project(p)
    inside = (edge > 3).all() and (edge < (W - 4, H - 4)).all()
    if inside and T_cam_board[:3, 2] @ p.mean(0) > 0.5 * np.linalg.norm(p.mean(0)):
        rows, columns = CELLS
        row = np.clip(q[:, 1] / H * rows, 0, rows - 1).astype(int)
        column = np.clip(q[:, 0] / W * columns, 0, columns - 1).astype(int)
        return View("whole", tuple(np.unique((row, column), axis=1)))
    outside = ((q < 0) | (q > (W - 1, H - 1))).any(1)
    return View("hidden" if outside.sum() >= 10 else "partly")
