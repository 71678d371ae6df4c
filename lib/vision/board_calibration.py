"""§2 Lenses and the relative pose of a pair from chessboards, by mrcal.

    solution = solve(boards, (9, 6), 0.025, ((640, 480), (640, 480)), "LENSMODEL_OPENCV8", folder)
    solution.models, solution.halves            # .cameramodel files: from all boards, and from either half of them

mrcal is Debian's and built for another NumPy: it is run as commands, with files in between.
"""

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.core.stage import BadInput
from lib.given import image, lenses, mrcal_runner
from lib.vision import board_checks
from lib.vision import boards as files
from lib.vision.boards import SIDES

LEAST = 6  # shots that allow two halves of three
FOCAL_FACTORS = (1.0, 0.6, 1.7)  # of the guess, tried one after the other
AGREE = 1.0  # px RMS in pictures 1000 px wide below which boards agree, whatever a rough look says
SOLVED_PX = 3.0  # RMS from which on a solve led nowhere: its residuals are a twentieth of a square


@dataclass(frozen=True, eq=False)
class Solution:
    """What mrcal found.

    models : (left, right) .cameramodel files with their optimisation inputs
    halves : [(left, right), (left, right)], from half of the boards each, or []
    boards : files.Boards that went in; sizes : ((w, h), (w, h)) px
    why_no_halves : in words, or None
    """

    models: tuple
    halves: list
    boards: files.Boards
    sizes: tuple
    why_no_halves: str | None


def focal_guess(boards, corners, sizes):
    """(left, right) px: Zhang's closed form for square pixels and a centred axis (OpenCV's).

    Where it fails, the picture's width. corners : (nx, ny); sizes : ((w, h), (w, h)) px
    """
    import cv2

    nx, ny = corners
    grid = np.zeros((nx * ny, 3), np.float32)
    grid[:, :2] = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), -1).reshape(-1, 2)
    guesses = []
    for side in (0, 1):
        views = [view.reshape(-1, 2) for view in boards.q[side] if np.isfinite(view).all()]
        width = max(sizes[side])
        guess = np.nan
        if views:
            K = cv2.initCameraMatrix2D(
                [grid] * len(views), [v.astype(np.float32).reshape(-1, 1, 2) for v in views], sizes[side]
            )
            guess = float(K[0, 0])
        guesses.append(guess if 0.2 * width < guess < 10 * width else float(width))
    return guesses


def _calibrate(boards, corners, square_m, sizes, lens, focal, folder, trace=None):
    """((left, right) .cameramodel in folder, RMS px) of one run of mrcal.

    RuntimeError: mrcal's last line, or why what it wrote is no lens.

    focal : (left, right) px, to start from; trace : called with (step, RMS px, CPU s of mrcal's process until then)
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    # mrcal tells shots apart by the number in the name, and reads the pictures for their size only
    names = tuple(tuple(f"{side}-{n:05d}.png" for n in range(boards.q.shape[1])) for side in SIDES)
    files.write_vnl(folder / "corners.vnl", files.Boards(names, boards.q, boards.level))
    for side in (0, 1):
        _blank_pictures(folder, names[side], sizes[side])
    said = mrcal_runner.run(
        [
            mrcal_runner.COMMAND,
            *("--corners-cache", "corners.vnl"),
            *("--lensmodel", lens),
            *("--focal", ",".join(f"{f:.6g}" for f in focal)),
            *("--object-spacing", repr(square_m)),
            *("--object-width-n", str(corners[0])),
            *("--object-height-n", str(corners[1])),
            *("--outdir", "."),
            "--pairs",
            *("left-*.png", "right-*.png"),
        ],
        folder,
        _steps_told(trace) if trace else None,
    )
    models = tuple(folder / f"camera0-{side}.cameramodel" for side in (0, 1))
    if not all(model.is_file() for model in models):
        raise RuntimeError(mrcal_runner.last_line(said))
    for model in models:
        try:
            lenses.read(model)
        except BadInput as bad:  # a solve that ran away
            raise RuntimeError(str(bad).removeprefix(f"{model}: ")) from None
    return models, float((RMS_ERROR.findall(said) or ["inf"])[-1])


RMS_ERROR = re.compile(r"RMS error: (\S+)")


def _steps_told(trace):
    """A reader of mrcal's lines: `## <step>`, then `## RMS error: <px>`, which goes to the trace."""
    step = ""

    def told(line, cpu_s):
        nonlocal step
        if found := RMS_ERROR.search(line):
            trace(step, float(found[1]), cpu_s)
        elif line.startswith("## "):
            step = line[3:]

    return told


def _blank_pictures(folder, names, size):
    """One empty picture, and links to it by the other names."""
    blank = folder / names[0]
    image.write_png8(blank, np.zeros(size[::-1], np.uint8))
    for name in names[1:]:
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(blank.name)


def solve(boards, corners, square_m, sizes, lens, folder, halves=True, trace=None) -> Solution:
    """Calibrate from all boards and, at the same time, from either half of them. BadInput where mrcal cannot.

    corners : (nx, ny); sizes : ((w, h), (w, h)) px; lens : LENSMODEL_...; folder : for mrcal's files
    trace : called with (step, RMS px, CPU s of mrcal's process until then), of the solve from all boards
    """
    mrcal_runner.require_mrcal()
    _check_seen(boards.seen, corners)
    some = np.flatnonzero(boards.seen.any(0))
    parts, why = _two_halves(boards.seen, some)
    if not halves:
        parts, why = [], why or "it was not asked for"
    sets = [_shots(boards, which) for which in (some, *parts)]
    focal = focal_guess(boards, corners, sizes)
    board_checks.check_views(boards)
    if doubt := board_checks.contradiction(boards, corners, focal, sizes):
        _refuse_unless_solved(doubt, sets[0], corners, square_m, sizes, lens, focal, Path(folder) / "doubt")

    def run(number):
        """(models, RMS) or None, and what mrcal said last where it failed. The trace is that of all boards."""
        at = Path(folder) / str(number)
        return _best_start(sets[number], corners, square_m, sizes, lens, focal, at, trace if number == 0 else None)

    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(run, range(len(sets))))
    best, said = results[0]
    if best is None:
        raise BadInput(
            f"boards: mrcal cannot solve {lens} from {len(some)} boards: {said}: more boards, tilted otherwise, or a "
            "simpler lens (lens: LENSMODEL_OPENCV4 in scene.yaml) may do"
        )
    if any(result is None for result, _ in results[1:]):
        why = f"mrcal cannot solve {lens} from half the boards"
    models = [result[0] for result, _ in results[1:]] if why is None else []
    return Solution(best[0], models, sets[0], sizes, why)


def _refuse_unless_solved(doubt, boards, corners, square_m, sizes, lens, focal, folder):
    """BadInput(doubt) where one run of mrcal cannot make the boards agree."""
    try:
        rms_px = _calibrate(boards, corners, square_m, sizes, lens, focal, folder)[1]
    except RuntimeError:
        raise BadInput(doubt) from None
    if not rms_px < AGREE * max(1.0, max(map(max, sizes)) / 1000):
        raise BadInput(doubt)


def _check_seen(seen, corners):
    """BadInput where the boards that were seen, (2, n) bool, cannot tell lenses or relative pose."""
    for side in (0, 1):
        if seen[side].sum() < 2:
            raise BadInput(
                f"boards: {SIDES[side]}: a board of {corners[0]} x {corners[1]} inner corners was found in "
                f"{seen[side].sum()} of {seen.shape[1]} images; a lens needs two at the very least, and ten to be known"
            )
    if not (seen[0] & seen[1]).any():
        raise BadInput("boards: no shot shows the board to both cameras, so their relative pose is unknown")


def _two_halves(seen, some):
    """([every second shot of some, the others], None), or ([], why not)."""
    parts, both = [some[0::2], some[1::2]], seen[0] & seen[1]
    if min(both[part].sum() for part in parts) < LEAST // 2:
        return [], f"{both.sum()} shots that both cameras see are too few for two halves of {LEAST // 2}"
    return parts, None


def _shots(boards, which):
    """The Boards of some shots."""
    names = tuple(tuple(np.array(names)[which]) for names in boards.names)
    return files.Boards(names, boards.q[:, which], boards.level[:, which])


def _best_start(boards, corners, square_m, sizes, lens, focal, folder, trace):
    """(((left, right) models, RMS px) or None, mrcal's last words or None), from several focal lengths if need be."""
    best, said = None, None
    for factor in FOCAL_FACTORS:
        start = [f * factor for f in focal]
        try:
            found = _calibrate(boards, corners, square_m, sizes, lens, start, f"{folder}-{factor}", trace)
        except RuntimeError as error:
            said = str(error)
            continue
        if best is None or found[1] < best[1]:
            best = found
        if best[1] < SOLVED_PX:
            break
    return best, said
