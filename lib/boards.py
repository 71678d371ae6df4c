"""Chessboards: where their corners lie in the photographs, and mrcal's text file of them.

    corners = find("boards/left-03.png", (9, 6))            # (54, 2) px row by row, or None
    write_vnl("corners.vnl", boards)                        # filename x y level; `left-*`, `right-*` without folder

Detection is OpenCV's; what is ours is the window of the sub-pixel step, which follows each corner's own squares.
"""
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.stage import BadInput

SIDES = ("left", "right")
EXTENSIONS = (".png", ".jpg", ".tif")
WINDOW = 0.3                 # half the window, in distances to the nearest neighbouring corner: measured, see `refine`


@dataclass(frozen=True, eq=False)
class Boards:
    """n shots of one board by two cameras at the same moments.

    names : (2, n) str            files without folder, left and right, paired by their sorted order
    q : (2, n, ny, nx, 2) px      corners row by row; nan where one was not seen
    """

    names: tuple
    q: np.ndarray

    @property
    def seen(self):
        """(2, n) bool: the camera saw at least one corner."""
        return np.isfinite(self.q[..., 0]).any((2, 3))


def spacing(q):
    """(ny, nx, 2) px -> (ny, nx) px: the distance to the nearest of the eight neighbouring corners, by the larger coordinate.

    >>> x, y = np.meshgrid(10.0 * np.arange(4), 20.0 * np.arange(3))
    >>> float(spacing(np.stack([x, y], -1)).max())
    10.0
    """
    across, down = np.gradient(q, axis=1), np.gradient(q, axis=0)
    return np.min([np.abs(step).max(-1) for step in (across, down, across + down, across - down)], axis=0)


def refine(grey, q, half=None):
    """Sub-pixel corners. grey : (H, W) uint8; q : (ny, nx, 2) px; half : px, the same half-window for all, or None.

    The window must hold one corner and the edges that meet there, no more. Three tenths of the distance to the nearest
    neighbour is the best at squares of 8 to 40 px (0.04-0.07 px RMS on rendered boards; from 0.4 on, it runs away on tilted ones).
    A fixed half-window of 11 px, OpenCV's example, is wider than the squares of the real pair 02: 1.2 px there instead of 0.17.
    """
    import cv2

    start = np.ascontiguousarray(q, np.float32)
    step = spacing(q)
    out = start.copy()
    halves = np.clip(np.rint(WINDOW * step), 2, 15).astype(int) if half is None else np.full(step.shape, half)
    for w in np.unique(halves):
        these = start[halves == w].reshape(-1, 1, 2)
        cv2.cornerSubPix(grey, these, (int(w), int(w)), (-1, -1), (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4))
        out[halves == w] = these[:, 0]
    strayed = np.abs(out - start).max(-1) > 0.5 * step             # to another corner, or nowhere
    out[strayed] = start[strayed]
    return out.astype(float)


def grey8(path):
    """(H, W) uint8 of a photograph of any depth; linear light is shown with gamma 2.2."""
    from lib import image

    photograph = image.read_photograph(path)
    grey = photograph.values.mean(-1)
    if photograph.linear:
        grey = np.clip(grey, 0, 1) ** (1 / 2.2)
    return np.rint(grey * 255).astype(np.uint8)


def find(grey, corners, half=None):
    """(H, W) uint8 -> (ny, nx, 2) px, or None. OpenCV's quick search, then its slow one (Duda and Frese 2018) where that fails."""
    import cv2

    size = tuple(corners)
    quick = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    ok, q = cv2.findChessboardCorners(grey, size, flags=quick | cv2.CALIB_CB_FAST_CHECK)
    if not ok:
        ok, q = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE)
    if not ok:
        return None
    return refine(grey, q.reshape(size[1], size[0], 2), half)


def _dark(grey, q):
    """Is the board's square between corners (0, 0) and (1, 1) darker than the one beside it, across?"""
    def mean(cell):
        y, x = np.clip(np.rint(cell.reshape(-1, 2).mean(0)[::-1]).astype(int), 0, np.array(grey.shape) - 1)
        return float(grey[y, x])
    return mean(q[0:2, 0:2]) < mean(q[0:2, 1:3])


def turned(q):
    """The ways in which the same board may be numbered: as it is, by half a turn and, if it is square, by quarters."""
    turns = (0, 1, 2, 3) if q.shape[0] == q.shape[1] else (0, 2)
    return [np.rot90(q, k).copy() for k in turns]


def same_order(left, right, grey_left, grey_right):
    """The right camera's corners in the left one's order, (ny, nx, 2) px.

    A board looks the same after half a turn (a square one after a quarter), and each picture is numbered by itself. The colours
    decide where they differ between the numberings; else the direction in the pictures, for the cameras of a pair stand alike.
    """
    candidates = turned(right)
    if left.shape[1] > 2:
        candidates = [q for q in candidates if _dark(grey_right, q) == _dark(grey_left, left)] or candidates
    v = left - left.mean((0, 1))
    return max(candidates, key=lambda q: float((v * (q - q.mean((0, 1)))).sum()))


def pairs(folder):
    """((left path, right path), ...) of the shots in a folder, paired by sorted name. BadInput: none, or unequal counts."""
    folder = Path(folder)
    left, right = ([p for p in sorted(folder.iterdir()) if p.name.startswith(f"{side}-") and p.suffix.lower() in EXTENSIONS] for side in SIDES)
    if len(left) != len(right):
        raise BadInput(f"{folder}: pairs: {len(left)} left-* and {len(right)} right-* images; each shot needs one of both")
    if not left:
        raise BadInput(f"{folder}: images: neither left-* and right-* (.png, .jpg, .tif) nor corners.vnl")
    return list(zip(left, right))


def detect(shots, corners, progress=None, half=None):
    """Boards of the shots ((left path, right path), ...), and the sizes ((w, h), (w, h)). BadInput: unreadable, or of several sizes."""
    import os
    from concurrent.futures import ThreadPoolExecutor

    import cv2

    cv2.setNumThreads(1)                                            # one picture per thread is the better split

    def one(path):
        try:
            grey = grey8(path)
        except BadInput as bad:
            return bad, None
        return grey, find(grey, corners, half)
    paths = [path for shot in shots for path in shot]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        found = []
        for number, result in enumerate(pool.map(one, paths)):
            found.append(result)
            if progress:
                progress((number + 1) / len(paths))
    problems = [problem for result, _ in found if isinstance(result, BadInput) for problem in result.problems]
    if problems:
        raise BadInput(*problems)
    q = np.full((2, len(shots), corners[1], corners[0], 2), np.nan)
    sizes = []
    for side in (0, 1):
        shapes = [grey.shape for grey, _ in found[side::2]]
        for shape, path in zip(shapes, paths[side::2]):
            if shape != shapes[0]:
                raise BadInput(f"{path}: size: {shape[1]} x {shape[0]} is not the {shapes[0][1]} x {shapes[0][0]} of {paths[side].name}")
        sizes.append(shapes[0][::-1])
    for n in range(len(shots)):
        (grey_left, left), (grey_right, right) = found[2 * n:2 * n + 2]
        if left is not None and right is not None:
            right = same_order(left, right, grey_left, grey_right)
        for side, corner in enumerate((left, right)):
            if corner is not None:
                q[side, n] = corner
    return Boards(tuple(tuple(shot[side].name for shot in shots) for side in (0, 1)), q), tuple(sizes)


def write_vnl(path, boards):
    """mrcal's corners: `filename x y level`, row by row; `-` where nothing was seen."""
    with open(path, "w", encoding="utf-8") as file:
        file.write("# filename x y level\n")
        for names, views in zip(boards.names, boards.q):
            for name, view in zip(names, views):
                if not np.isfinite(view).any():
                    file.write(f"{name} - - -\n")
                    continue
                for x, y in view.reshape(-1, 2):
                    file.write(f"{name} {x:.6f} {y:.6f} 0\n" if np.isfinite(x) else f"{name} 0 0 -\n")


def read_vnl(path, corners):
    """Boards of a .vnl file. BadInput names the line: another camera, too few or many corners, a number that is none."""
    nx, ny = corners
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8: {error.reason} at byte {error.start}") from None
    views, legend = {}, None
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("#"):
            if legend is None and not line.startswith(("##", "#!")):
                legend = line[1:].split()
                if legend[:3] != ["filename", "x", "y"]:
                    raise BadInput(f"{path}: line {number}: legend {' '.join(legend)!r} instead of filename x y level")
            continue
        words = line.split()
        if not words:
            continue
        if len(words) not in (3, 4):
            raise BadInput(f"{path}: line {number}: {len(words)} columns instead of filename x y level")
        name = words[0]
        if not re.match(r"(left|right)-", name) or "/" in name:
            raise BadInput(f"{path}: line {number}: filename {name} is neither left-* nor right-*, without folder")
        view = views.setdefault(name, [])
        level = words[3] if len(words) == 4 else "0"
        if words[1:3] == ["-", "-"]:
            view.append(None)
            continue
        try:
            x, y = float(words[1]), float(words[2])
            skip = level == "-" or float(level) < 0
        except ValueError:
            raise BadInput(f"{path}: line {number}: {' '.join(words[1:])} are no numbers") from None
        if not (abs(x) < 1e6 and abs(y) < 1e6):
            raise BadInput(f"{path}: line {number}: x, y = {words[1]}, {words[2]} lies in no picture")
        view.append((np.nan, np.nan) if skip else (x, y))
    for name, view in views.items():
        if None in view and len(view) != 1:
            raise BadInput(f"{path}: {name}: `- -` beside corners; one such line says that the board was not seen")
        if view != [None] and len(view) != nx * ny:
            raise BadInput(f"{path}: {name}: {len(view)} corners, where a board of {nx} x {ny} has {nx * ny}")
    names = [sorted(name for name in views if name.startswith(side)) for side in SIDES]
    if not views:
        raise BadInput(f"{path}: corners: there are none")
    # a view may be missing altogether: mrcal's own files leave out what was not seen. Then the rest of the name tells the shot
    if len(names[0]) != len(names[1]):
        shots = sorted({name.partition("-")[2] for name in views})
        names = [[f"{side}-{shot}" for shot in shots] for side in SIDES]
    q = np.full((2, len(names[0]), ny, nx, 2), np.nan)
    for side in (0, 1):
        for n, name in enumerate(names[side]):
            if views.get(name, [None]) != [None]:
                q[side, n] = np.array(views[name], float).reshape(ny, nx, 2)
    return Boards(tuple(map(tuple, names)), q)
