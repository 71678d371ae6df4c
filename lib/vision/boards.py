"""Chessboards: where their corners lie in the photographs, and mrcal's text file of them.

    corners = find("boards/left-03.png", (9, 6))            # (54, 2) px row by row, or None
    write_vnl("corners.vnl", boards)                        # filename x y level; `left-*`, `right-*` without folder

Detection is OpenCV's; what is ours is the sub-pixel step, which looks at each corner's own squares and no farther.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.core.stage import BadInput

SIDES = ("left", "right")
EXTENSIONS = (".png", ".jpg", ".tif")
WINDOW = 0.3  # half of cornerSubPix's window, in distances to the nearest neighbouring corner: measured, see `refine`


@dataclass(frozen=True, eq=False)
class Boards:
    """n shots of one board by two cameras at the same moments.

    names : (2, n) str            files without folder, left and right, paired by their sorted order
    q : (2, n, ny, nx, 2) px      corners row by row; nan where one was not seen
    level : (2, n, ny, nx)        mrcal's: a corner found in a picture halved so many times counts as half so many times as exact
    """

    names: tuple
    q: np.ndarray
    level: np.ndarray

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


def refine(grey, q):
    """Sub-pixel corners. grey : (H, W) uint8; q : (ny, nx, 2) px.

    OpenCV's cornerSubPix, in a window that holds one corner and no more: three tenths of the distance to the nearest neighbour
    on each side is the best for squares of 8 to 40 px, and from four tenths on it runs away on tilted boards. (A window of 23 px,
    OpenCV's example, is wider than the squares of the real view left02: a pixel off there.) Then a fit of the picture itself: `saddle`.
    """
    start = np.ascontiguousarray(q, np.float32)
    step = spacing(q)
    halves = np.clip(np.rint(WINDOW * step), 2, 15).astype(int)
    out = start.copy()
    for w in np.unique(halves):
        out[halves == w] = subpixel(grey, start[halves == w], int(w))
    strayed = np.abs(out - start).max(-1) > 0.5 * step  # to another corner, or nowhere
    out[strayed] = start[strayed]
    fine = saddle(grey, out.astype(float))
    good = np.abs(fine - out).max(-1) < 0.25 * np.maximum(step, 2)
    return np.where(good[..., None], fine, out)


def subpixel(grey, q, half):
    """(..., 2) float32 px: OpenCV's cornerSubPix in windows of 2 half + 1 px."""
    import cv2

    these = q.reshape(-1, 1, 2).copy()
    cv2.cornerSubPix(grey, these, (half, half), (-1, -1), (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4))
    return these.reshape(q.shape)


def saddle(grey, q, share=0.42, reach_px=12.0, steps=8):
    """(ny, nx, 2) px: each corner from all pixels of a parallelogram along the board's own lines, at most reach_px from it.

    The picture of a corner is m + a erf(u / s) erf(v / s): u, v the distances from the two edges that cross there, s their blur.
    Its seven unknowns (place, two directions, m, a, s) are fitted by Gauss-Newton, all corners at once. What is left of
    symmetric wrongs (gamma, noise, a model that is exact for crossing at right angles only) does not move the crossing.
    On rendered boards 0.010-0.022 px RMS instead of cornerSubPix's 0.04-0.07; 54 corners in 10-80 ms.
    """
    from scipy.special import erf

    across, down, start = (v.reshape(-1, 2) for v in (np.gradient(q, axis=1), np.gradient(q, axis=0), q))
    n = len(start)
    k = np.minimum(share, reach_px / np.maximum(np.linalg.norm(across, axis=1), np.linalg.norm(down, axis=1)))
    reach = int(np.ceil((k * (np.abs(across) + np.abs(down)).max(1)).max()))
    window = np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1)]), -1).reshape(-1, 2)
    p = np.rint(start).astype(int)[:, None] + window  # (n, pixels, 2)
    size = np.array(grey.shape[::-1])
    inside = ((p >= 0) & (p < size)).all(-1)
    x, y = np.moveaxis(np.clip(p, 0, size - 1), -1, 0)
    z = grey[y, x].astype(float)
    frame = np.stack([across, down], -1) + 1e-9 * np.eye(2)
    board = np.einsum("nij,npj->npi", np.linalg.inv(frame), p - start[:, None])  # in squares
    weight = (inside & (np.abs(board) <= k[:, None, None]).all(-1)).astype(float)
    checker = np.sign(board).prod(-1)
    total = np.maximum(weight.sum(1), 1)
    contrast = (weight * z * checker).sum(1) / total
    state = np.stack(
        [
            *start.T,
            np.arctan2(*across.T[::-1]),
            np.arctan2(*down.T[::-1]),
            (weight * z).sum(1) / total,
            contrast,
            np.full(n, np.log(0.8)),
        ],
        1,
    )
    sharp = 0.5 * np.maximum(contrast**2, 1)  # holds log s near 0.8 px where the window does not tell
    turn = -np.sign(
        across[:, :1] * down[:, 1:] - across[:, 1:] * down[:, :1]
    )  # u v < 0 where the checker is > 0, or conversely
    largest = np.array([1, 1, 0.2, 0.2, 60, 60, 0.5])
    for _ in range(steps):
        dx, dy = np.moveaxis(p - state[:, None, :2], -1, 0)
        (s1, c1), (s2, c2) = ((np.sin(state[:, [j]]), np.cos(state[:, [j]])) for j in (2, 3))
        scale = np.sqrt(2) * np.exp(state[:, [6]])
        u, v = (c1 * dy - s1 * dx) / scale, (c2 * dy - s2 * dx) / scale
        eu, ev, gu, gv = erf(u), erf(v), 2 / np.sqrt(np.pi) * np.exp(-u * u), 2 / np.sqrt(np.pi) * np.exp(-v * v)
        a = state[:, [5]] * turn
        by_u, by_v = a * gu * ev / scale, a * eu * gv / scale
        J = np.stack(
            [
                by_u * s1 + by_v * s2,
                -by_u * c1 - by_v * c2,
                -by_u * (c1 * dx + s1 * dy),
                -by_v * (c2 * dx + s2 * dy),
                np.ones_like(u),
                turn * eu * ev,
                -(by_u * u + by_v * v) * scale,
            ],
            -1,
        )
        JT = np.swapaxes(J * weight[..., None], 1, 2)
        A, g = JT @ J, np.einsum("nkp,np->nk", JT, z - state[:, [4]] - a * eu * ev)
        A[:, 6, 6] += sharp
        g[:, 6] -= sharp * (state[:, 6] - np.log(0.8))
        A += (1e-4 * np.einsum("nkk->nk", A)[:, :, None] + 1e-9) * np.eye(7)
        state += np.clip(np.linalg.solve(A, g[..., None])[..., 0], -largest, largest)
        state[:, 6] = np.clip(state[:, 6], np.log(0.25), np.log(4))
    return state[:, :2].reshape(q.shape)


def grey8(path):
    """(H, W) uint8 of a photograph of any depth; linear light is shown with gamma 2.2."""
    from lib.given import image

    photograph = image.read_photograph(path)
    grey = photograph.values.mean(-1)
    if photograph.linear:
        grey = np.clip(grey, 0, 1) ** (1 / 2.2)
    return np.rint(grey * 255).astype(np.uint8)


def find(grey, corners):
    """(H, W) uint8 -> (ny, nx, 2) px, or None. OpenCV's quick search, the same at twice the size, then its slow one (Duda and
    Frese 2018). Without its `fast check`, which overlooks boards with squares under 10 px and saves nothing."""
    import cv2

    size, flags = tuple(corners), cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    ok, q = cv2.findChessboardCorners(grey, size, flags=flags)
    if not ok and max(grey.shape) < 2000:
        ok, q = cv2.findChessboardCorners(
            cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC), size, flags=flags
        )
        q = (q - 0.5) / 2 if ok else None  # pixel centres: 2 x + 0.5
    if not ok:
        ok, q = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE)
    if not ok:
        return None
    return refine(grey, q.reshape(size[1], size[0], 2))


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
    left, right = (
        [p for p in sorted(folder.iterdir()) if p.name.startswith(f"{side}-") and p.suffix.lower() in EXTENSIONS]
        for side in SIDES
    )
    if len(left) != len(right):
        raise BadInput(
            f"{folder}: pairs: {len(left)} left-* and {len(right)} right-* images; each shot needs one of both"
        )
    if not left:
        raise BadInput(f"{folder}: images: neither left-* and right-* (.png, .jpg, .tif) nor corners.vnl")
    return list(zip(left, right))


def detect(shots, corners, progress=None):
    """Boards of the shots ((left path, right path), ...), and the sizes ((w, h), (w, h)). BadInput: unreadable, or of several sizes."""
    import os
    from concurrent.futures import ThreadPoolExecutor

    import cv2

    cv2.setNumThreads(1)  # one picture per thread is the better split

    def one(path):
        try:
            grey = grey8(path)
        except BadInput as bad:
            return bad, None
        return grey, find(grey, corners)

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
                raise BadInput(
                    f"{path}: size: {shape[1]} x {shape[0]} is not the {shapes[0][1]} x {shapes[0][0]} of {paths[side].name}"
                )
        sizes.append(shapes[0][::-1])
    for n in range(len(shots)):
        (grey_left, left), (grey_right, right) = found[2 * n : 2 * n + 2]
        if left is not None and right is not None:
            right = same_order(left, right, grey_left, grey_right)
        for side, corner in enumerate((left, right)):
            if corner is not None:
                q[side, n] = corner
    return Boards(tuple(tuple(shot[side].name for shot in shots) for side in (0, 1)), q, np.zeros(q.shape[:-1])), tuple(
        sizes
    )


def write_vnl(path, boards):
    """mrcal's corners: `filename x y level`, row by row; `-` where nothing was seen."""
    with open(path, "w", encoding="utf-8") as file:
        file.write("# filename x y level\n")
        for names, views, levels in zip(boards.names, boards.q, boards.level):
            for name, view, level in zip(names, views, levels):
                if not np.isfinite(view).any():
                    file.write(f"{name} - - -\n")
                    continue
                for (x, y), halved in zip(view.reshape(-1, 2), level.ravel()):
                    file.write(f"{name} {x:.6f} {y:.6f} {halved:g}\n" if np.isfinite(x) else f"{name} 0 0 -\n")


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
            halved = -1.0 if level == "-" else float(level)
        except ValueError:
            raise BadInput(f"{path}: line {number}: {' '.join(words[1:])} are no numbers") from None
        if not (abs(x) < 1e6 and abs(y) < 1e6):
            raise BadInput(f"{path}: line {number}: x, y = {words[1]}, {words[2]} lies in no picture")
        if not halved < 32:
            raise BadInput(f"{path}: line {number}: level {level} is not a count of halvings")
        view.append((np.nan, np.nan, 0.0) if halved < 0 else (x, y, halved))
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
    level = np.zeros(q.shape[:-1])
    for side in (0, 1):
        for n, name in enumerate(names[side]):
            if views.get(name, [None]) != [None]:
                both = np.array(views[name], float).reshape(ny, nx, 3)
                q[side, n], level[side, n] = both[..., :2], both[..., 2]
    return Boards(tuple(map(tuple, names)), q, level)
