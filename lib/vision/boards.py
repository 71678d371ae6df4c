"""Chessboards: where their corners lie in the photographs, and mrcal's text file of them.

    corners = find(grey8("boards/left-03.png"), (9, 6))     # (6, 9, 2) px row by row, or None
    write_vnl("corners.vnl", boards)                        # filename x y level; `left-*`, `right-*` without folder

OpenCV detects the boards. The sub-pixel step is ours: it looks at each corner's own squares and no farther.
"""

import os
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import image as pictures

SIDES = ("left", "right")
EXTENSIONS = (".png", ".jpg", ".tif")
WINDOW = 0.3  # half of cornerSubPix's window, in distances to the nearest neighbouring corner: measured, see `refine`
FAR_PX = 1e6  # a corner farther out lies in no picture
MOST_HALVINGS = 32  # of a level


@dataclass(frozen=True, eq=False)
class Boards:
    """n shots of one board by two cameras at the same moments.

    names : (2, n) str            files without folder, left and right, paired by their sorted order
    q : (2, n, ny, nx, 2) px      corners row by row; nan where one was not seen
    level : (2, n, ny, nx)        mrcal's: how often the picture had been halved when the corner was found in it; each
                                  time halves the corner's weight
    """

    names: tuple
    q: np.ndarray
    level: np.ndarray

    @property
    def seen(self):
        """(2, n) bool: the camera saw at least one corner."""
        return np.isfinite(self.q[..., 0]).any((2, 3))


def spacing(q):
    """(ny, nx, 2) px -> (ny, nx) px: to the nearest of the eight neighbouring corners, by the larger coordinate.

    >>> x, y = np.meshgrid(10.0 * np.arange(4), 20.0 * np.arange(3))
    >>> float(spacing(np.stack([x, y], -1)).max())
    10.0
    """
    across, down = np.gradient(q, axis=1), np.gradient(q, axis=0)
    return np.min([np.abs(step).max(-1) for step in (across, down, across + down, across - down)], axis=0)


def refine(grey, q):
    """Sub-pixel corners, (ny, nx, 2) px. grey : (H, W) uint8; q : (ny, nx, 2) px.

    First OpenCV's cornerSubPix, in a window that holds one corner and no more. Three tenths of the distance to the
    nearest neighbour on each side is best for squares of 8 to 40 px. From four tenths on the corners run away on tilted
    boards. The window of OpenCV's example, 23 px, is wider than the squares of the real view left02, and its corners
    there are a pixel off. Then a fit of the picture itself: `saddle`.
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
    """(ny, nx, 2) px: each corner from all pixels of a parallelogram along the board's lines, at most reach_px away.

    q : (ny, nx, 2) px, to start from; share : half the parallelogram's side, in squares; steps : of Gauss-Newton

    The picture of a corner is m + a erf(u / s) erf(v / s): u and v are the distances from the two edges that cross
    there, s is their blur. Gauss-Newton fits the seven unknowns (place, two directions, m, a, s), all corners at once.
    Errors that are symmetric about the corner do not move the crossing: gamma, noise, and that the model is exact only
    where the edges cross at right angles.
    On rendered boards 0.010-0.022 px RMS instead of cornerSubPix's 0.04-0.07; 54 corners in 10-80 ms.
    """
    across, down, start = (v.reshape(-1, 2) for v in (np.gradient(q, axis=1), np.gradient(q, axis=0), q))
    p, z, weight, checker = _corner_windows(grey, start, across, down, share, reach_px)
    state = _start_of_saddle(start, across, down, z, weight, checker)
    sharp = 0.5 * np.maximum(state[:, 5] ** 2, 1)  # holds log s near 0.8 px where the window does not tell
    # u v < 0 where the checker is > 0, or conversely
    turn = -np.sign(across[:, :1] * down[:, 1:] - across[:, 1:] * down[:, :1])
    largest = np.array([1, 1, 0.2, 0.2, 60, 60, 0.5])
    for _ in range(steps):
        mean, checkers, J = _saddle_picture(p, state, turn)
        JT = np.swapaxes(J * weight[..., None], 1, 2)
        A, g = JT @ J, np.einsum("nkp,np->nk", JT, z - mean - checkers)
        A[:, 6, 6] += sharp
        g[:, 6] -= sharp * (state[:, 6] - np.log(0.8))
        A += (1e-4 * np.einsum("nkk->nk", A)[:, :, None] + 1e-9) * np.eye(7)
        state += np.clip(np.linalg.solve(A, g[..., None])[..., 0], -largest, largest)
        state[:, 6] = np.clip(state[:, 6], np.log(0.25), np.log(4))
    return state[:, :2].reshape(q.shape)


def _corner_windows(grey, start, across, down, share, reach_px):
    """The pixels around each corner: p (n, P, 2) px, values, weights and colour of the square (+-1), (n, P) each."""
    k = np.minimum(share, reach_px / np.maximum(np.linalg.norm(across, axis=1), np.linalg.norm(down, axis=1)))
    reach = int(np.ceil((k * (np.abs(across) + np.abs(down)).max(1)).max()))
    window = np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1)]), -1).reshape(-1, 2)
    p = np.rint(start).astype(int)[:, None] + window
    size = np.array(grey.shape[::-1])
    inside = ((p >= 0) & (p < size)).all(-1)
    x, y = np.moveaxis(np.clip(p, 0, size - 1), -1, 0)
    frame = np.stack([across, down], -1) + 1e-9 * np.eye(2)
    board = np.einsum("nij,npj->npi", np.linalg.inv(frame), p - start[:, None])  # in squares
    weight = (inside & (np.abs(board) <= k[:, None, None]).all(-1)).astype(float)
    return p, grey[y, x].astype(float), weight, np.sign(board).prod(-1)


def _start_of_saddle(start, across, down, z, weight, checker):
    """(n, 7): x, y px, the angles of both edges, m, a, log s."""
    total = np.maximum(weight.sum(1), 1)
    return np.stack(
        [
            *start.T,
            np.arctan2(*across.T[::-1]),
            np.arctan2(*down.T[::-1]),
            (weight * z).sum(1) / total,
            (weight * z * checker).sum(1) / total,
            np.full(len(start), np.log(0.8)),
        ],
        1,
    )


def _saddle_picture(p, state, turn):
    """What the model shows at the pixels p (n, P, 2): m (n, 1), a erf erf (n, P); the sum's derivatives (n, P, 7)."""
    from scipy.special import erf

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
    return state[:, [4]], a * eu * ev, J


def grey8(path, as_stored=False):
    """(H, W) uint8 of a photograph of any depth; linear light is shown with gamma 2.2.

    as_stored : the sensor's pixels, whatever orientation the file notes
    """
    photograph = pictures.read_photograph(path, as_stored)
    grey = photograph.values.mean(-1)
    if photograph.linear:
        grey = np.clip(grey, 0, 1) ** (1 / 2.2)
    return np.rint(grey * 255).astype(np.uint8)


def find(grey, corners):
    """(H, W) uint8 -> (ny, nx, 2) px, or None where no board of corners (nx, ny) is seen.

    OpenCV's quick search, the same at twice the size, then its slow one (Duda and Frese 2018). Its `fast check` is left
    out: it overlooks boards with squares under 10 px and saves nothing.
    """
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

    left, right : (ny, nx, 2) px, each numbered by itself

    A board looks the same after half a turn (a square one after a quarter). Where the numberings differ in the squares'
    colours, the colours decide. Else the direction in the pictures does, for the cameras of a pair stand alike.
    """
    candidates = turned(right)
    if left.shape[1] > 2:
        candidates = [q for q in candidates if _dark(grey_right, q) == _dark(grey_left, left)] or candidates
    v = left - left.mean((0, 1))
    return max(candidates, key=lambda q: float((v * (q - q.mean((0, 1)))).sum()))


def images(folder, side):
    """The paths of one camera's images in a folder, sorted. side : "left" or "right" """
    files = sorted(Path(folder).iterdir())
    return [p for p in files if p.name.startswith(f"{side}-") and p.suffix.lower() in EXTENSIONS]


def pairs(folder):
    """[(left path, right path)] of the shots in a folder, paired by sorted name. BadInput: none, or unequal counts."""
    left, right = (images(folder, side) for side in SIDES)
    if len(left) != len(right):
        raise BadInput(
            f"{folder}: pairs: {len(left)} left-* and {len(right)} right-* images; each shot needs one of both"
        )
    if not left:
        raise BadInput(f"{folder}: images: neither left-* and right-* (.png, .jpg, .tif) nor corners.vnl")
    return list(zip(left, right, strict=True))


def detect(shots, corners, progress=None):
    """Boards of the shots ((left path, right path), ...) in the sensors' pixels, and the sizes ((w, h), (w, h)).

    What EXIF notes of the orientation is not read: phones note it anew for each shot, and a lens belongs to the sensor.
    progress : called with the share that is done. BadInput: an image that cannot be read, or images of several sizes
    """
    import cv2

    cv2.setNumThreads(1)  # one picture per thread is the better split

    def one(path):
        try:
            grey = grey8(path, as_stored=True)
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
    sizes = tuple(_one_size(found[side::2], paths[side::2]) for side in (0, 1))
    q = np.full((2, len(shots), corners[1], corners[0], 2), np.nan)
    for n in range(len(shots)):
        (grey_left, left), (grey_right, right) = found[2 * n : 2 * n + 2]
        if left is not None and right is not None:
            right = same_order(left, right, grey_left, grey_right)
        for side, corner in enumerate((left, right)):
            if corner is not None:
                q[side, n] = corner
    names = tuple(tuple(shot[side].name for shot in shots) for side in (0, 1))
    return Boards(names, q, np.zeros(q.shape[:-1])), sizes


def as_shown(boards, sizes, turns):
    """(Boards, sizes) in the pixels that viewers show, of those in the sensors'.

    turns : (left, right) orientations, 1 to 8 as EXIF has them
    """
    q, shown = boards.q.copy(), []
    for side, turn in enumerate(turns):
        swapped, rows, columns = pictures.TURNS[turn]
        width, height = sizes[side][::-1] if swapped else sizes[side]
        x, y = np.moveaxis(boards.q[side][..., ::-1] if swapped else boards.q[side], -1, 0)
        q[side] = np.stack([width - 1 - x if columns else x, height - 1 - y if rows else y], -1)
        shown.append((width, height))
    return Boards(boards.names, q, boards.level), tuple(shown)


def _one_size(found, paths):
    """(w, h) of one camera's images, found : [(grey, corners)]. BadInput: they have several."""
    shapes = [grey.shape for grey, _ in found]
    height, width = shapes[0]
    for shape, path in zip(shapes, paths, strict=True):
        if shape != shapes[0]:
            raise BadInput(f"{path}: size: {shape[1]} x {shape[0]} is not the {width} x {height} of {paths[0].name}")
    return width, height


# ---- mrcal's text file ----


def write_vnl(path, boards):
    """mrcal's corners: `filename x y level`, row by row; `-` where nothing was seen."""
    with open(path, "w", encoding="utf-8") as file:
        file.write("# filename x y level\n")
        for names, views, levels in zip(boards.names, boards.q, boards.level, strict=True):
            for name, view, level in zip(names, views, levels, strict=True):
                if not np.isfinite(view).any():
                    file.write(f"{name} - - -\n")
                    continue
                for (x, y), halved in zip(view.reshape(-1, 2), level.ravel(), strict=True):
                    file.write(f"{name} {x:.6f} {y:.6f} {halved:g}\n" if np.isfinite(x) else f"{name} 0 0 -\n")


def read_vnl(path, corners):
    """Boards of a .vnl file. BadInput names the line: another camera, too few or many corners, a number that is none.

    corners : (nx, ny) of the board
    """
    views = _views(path, bounded.text(path))
    _check_counts(path, views, corners)
    names = _shots(views)
    nx, ny = corners
    q = np.full((2, len(names[0]), ny, nx, 2), np.nan)
    level = np.zeros(q.shape[:-1])
    for side in (0, 1):
        for n, name in enumerate(names[side]):
            if views.get(name, [None]) != [None]:
                both = np.array(views[name], float).reshape(ny, nx, 3)
                q[side, n], level[side, n] = both[..., :2], both[..., 2]
    return Boards(tuple(map(tuple, names)), q, level)


def _views(path, text):
    """{filename: [(x, y, level) or None]}, a corner for each line; None where the line says that no board was seen."""
    views, legend = {}, None
    for number, line in enumerate(text.splitlines(), 1):
        where = f"{path}: line {number}"
        if line.startswith("#"):
            if legend is None and not line.startswith(("##", "#!")):
                legend = _legend(where, line)
        elif words := line.split():
            name, corner = _corner(where, words)
            views.setdefault(name, []).append(corner)
    return views


def _legend(where, line):
    """The names of the columns."""
    legend = line[1:].split()
    if legend[:3] != ["filename", "x", "y"]:
        raise BadInput(f"{where}: legend {' '.join(legend)!r} instead of filename x y level")
    return legend


def _corner(where, words):
    """(filename, (x, y, level)); (nan, nan, 0) for a corner that was not found; None for a board that was not seen."""
    if len(words) not in (3, 4):
        raise BadInput(f"{where}: {len(words)} columns instead of filename x y level")
    name, level = words[0], words[3] if len(words) == 4 else "0"
    if not re.match(r"(left|right)-", name) or "/" in name:
        raise BadInput(f"{where}: filename {name} is neither left-* nor right-*, without folder")
    if words[1:3] == ["-", "-"]:
        return name, None
    try:
        x, y = float(words[1]), float(words[2])
        halved = -1.0 if level == "-" else float(level)
    except ValueError:
        raise BadInput(f"{where}: {' '.join(words[1:])} are no numbers") from None
    if not (abs(x) < FAR_PX and abs(y) < FAR_PX):
        raise BadInput(f"{where}: x, y = {words[1]}, {words[2]} lies in no picture")
    if not halved < MOST_HALVINGS:
        raise BadInput(f"{where}: level {level} is not a count of halvings")
    return name, (np.nan, np.nan, 0.0) if halved < 0 else (x, y, halved)


def _check_counts(path, views, corners):
    """BadInput: no view at all, or one that has not all corners of the board."""
    nx, ny = corners
    for name, view in views.items():
        if None in view and len(view) != 1:
            raise BadInput(f"{path}: {name}: `- -` beside corners; one such line says that the board was not seen")
        if view != [None] and len(view) != nx * ny:
            raise BadInput(f"{path}: {name}: {len(view)} corners, where a board of {nx} x {ny} has {nx * ny}")
    if not views:
        raise BadInput(f"{path}: corners: there are none")


def _shots(views):
    """[left names, right names], shot by shot.

    mrcal's own files leave out a view in which nothing was seen. Then the rest of the name tells the shot.
    """
    names = [sorted(name for name in views if name.startswith(side)) for side in SIDES]
    if len(names[0]) != len(names[1]):
        shots = sorted({name.partition("-")[2] for name in views})
        names = [[f"{side}-{shot}" for shot in shots] for side in SIDES]
    return names
