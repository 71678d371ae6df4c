"""§2 Lenses and the relative pose of a pair, by mrcal from chessboards, and how far they can be trusted.

    solution = solve(boards, (9, 6), 0.025, ((640, 480), (640, 480)), "LENSMODEL_OPENCV8", folder)
    answer = judge(solution, distance_m=3.0)          # calibration.json: uncertainty, cross-validation, verdict

An RMS says how well the boards fit, not how well the lens is known: a lens with many parameters fits three boards to nothing.
So the answer is the *projection uncertainty* (mrcal: the corners' noise carried through the solve into a projected pixel) at
the distance of the scene, and a check of it that assumes nothing: two calibrations from half the boards each, and by how much
they differ. mrcal is Debian's and built for another NumPy: it is run as commands, with files in between.
"""

import json
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.core.stage import BadInput
from lib.given.mrcal_runner import COMMAND, environment, last_line, process, require_mrcal

LEAST = 6  # shots that allow two halves of three
COLUMNS = 16  # of the grid on which uncertainty and differences are given
CENTRE = 0.8  # of the picture's width and height: what the verdict is about
TILT = 15.0  # degrees between two boards' normals, from which on they tell the focal length
ALIKE = 0.5  # correlation of neighbouring corners' residuals from which on they are no noise
GOOD, FAIR = 0.5, 2.0  # px: limits of the verdict's first word
SIDES = ("left", "right")


@dataclass(frozen=True, eq=False)
class Solution:
    """models : (left, right) .cameramodel files with their optimisation inputs; halves : [(left, right), (left, right)] or []
    names : (2, n) the boards' files; boards, sizes : what went in"""

    models: tuple
    halves: list
    boards: object
    sizes: tuple
    why_no_halves: str


def focal_guess(boards, corners, sizes):
    """(left, right) px: Zhang's closed form for square pixels and a centred axis (OpenCV's), or the picture's width where it fails."""
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


def _calibrate(boards, corners, square_m, sizes, lens, focal, folder):
    """One run of mrcal on these boards: (left, right) .cameramodel in folder. RuntimeError: mrcal's last line."""
    from lib.given import image
    from lib.vision import boards as files

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    # mrcal tells shots apart by the number in the name, and reads the pictures for their size only
    names = tuple(tuple(f"{side}-{n:05d}.png" for n in range(boards.q.shape[1])) for side in SIDES)
    files.write_vnl(folder / "corners.vnl", files.Boards(names, boards.q, boards.level))
    for side in (0, 1):
        blank = folder / names[side][0]
        image.write_png8(blank, np.zeros(sizes[side][::-1], np.uint8))
        for name in names[side][1:]:
            (folder / name).unlink(missing_ok=True)
            (folder / name).symlink_to(blank.name)
    argv = [
        COMMAND,
        "--corners-cache",
        "corners.vnl",
        "--lensmodel",
        lens,
        "--focal",
        ",".join(f"{f:.6g}" for f in focal),
        "--object-spacing",
        repr(square_m),
        "--object-width-n",
        str(corners[0]),
        "--object-height-n",
        str(corners[1]),
        "--outdir",
        ".",
        "--pairs",
        "left-*.png",
        "right-*.png",
    ]
    run = subprocess.run(argv, cwd=folder, capture_output=True, text=True, env=environment())
    models = tuple(folder / f"camera0-{side}.cameramodel" for side in (0, 1))
    if run.returncode or not all(model.is_file() for model in models):
        raise RuntimeError(last_line(run.stderr))
    return models, float(re.findall(r"RMS error: (\S+)", run.stderr)[-1])


def solve(boards, corners, square_m, sizes, lens, folder, halves=True):
    """Calibrate from all boards and, at the same time, from either half of them; in folder. BadInput where mrcal cannot."""
    from lib.vision import boards as files

    require_mrcal()
    seen = boards.seen
    for side in (0, 1):
        if seen[side].sum() < 2:
            raise BadInput(
                f"boards: {SIDES[side]}: a board of {corners[0]} x {corners[1]} inner corners was found in {seen[side].sum()} of {seen.shape[1]} images; "
                "a lens needs two at the very least, and ten to be known"
            )
    if not (seen[0] & seen[1]).any():
        raise BadInput("boards: no shot shows the board to both cameras, so their relative pose is unknown")
    some = np.flatnonzero(seen.any(0))
    parts, both = [some[0::2], some[1::2]], seen[0] & seen[1]
    why = None if halves else "it was not asked for"
    if min(both[part].sum() for part in parts) < LEAST // 2:
        why = f"{both.sum()} shots that both cameras see are too few for two halves of {LEAST // 2}"
    sets = [some] + (parts if why is None else [])
    take = lambda which: files.Boards(
        tuple(tuple(np.array(names)[which]) for names in boards.names), boards.q[:, which], boards.level[:, which]
    )
    focal = focal_guess(boards, corners, sizes)

    def run(number):
        """With other guesses of the focal length where the first leads nowhere (residuals of a twentieth of a square)."""
        subset, best, said = take(sets[number]), None, None
        for factor in (1.0, 0.6, 1.7):
            try:
                found = _calibrate(
                    subset,
                    corners,
                    square_m,
                    sizes,
                    lens,
                    [f * factor for f in focal],
                    Path(folder) / f"{number}-{factor}",
                )
            except RuntimeError as error:
                said = str(error)
                continue
            if best is None or found[1] < best[1]:
                best = found
            if best[1] < 3:
                break
        return best, said

    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(run, range(len(sets))))
    best, said = results[0]
    if best is None:
        raise BadInput(f"boards: mrcal cannot solve {lens} from {len(some)} boards: {said}")
    if any(result is None for result, _ in results[1:]):
        why = f"mrcal cannot solve {lens} from half the boards"
    models = [result[0] for result, _ in results[1:]] if why is None else []
    return Solution(best[0], models, take(some), sizes, why)


def judge(solution, distance_m=None):
    """What calibration.json says; distance_m of the scene, or None for the boards' own."""
    folder = Path(solution.models[0]).parent
    request, answer = folder / "request.json", folder / "answer.json"
    request.write_text(
        json.dumps(
            {
                "models": [str(m) for m in solution.models],
                "halves": [[str(m) for m in pair] for pair in solution.halves],
                "distance_m": distance_m,
                "columns": COLUMNS,
            }
        ),
        encoding="utf-8",
    )
    process("judge", request, answer)
    with open(answer, encoding="utf-8") as file:
        raw = json.load(file)
    return _summary(solution, raw, "scene" if distance_m is not None else "boards")


def _summary(solution, raw, distance_of):
    distance, cameras = raw["distance_m"], {}
    for side, (name, camera) in enumerate(zip(SIDES, raw["cameras"])):
        width, height = solution.sizes[side]
        q = np.array(camera["q"])
        centre = (np.abs(q / [width - 1, height - 1] - 0.5) <= CENTRE / 2).all(-1)
        sigma = _array(camera["uncertainty_px"])
        difference = np.linalg.norm(_array(camera["difference_px"]), axis=-1) if "difference_px" in camera else None
        views = [
            {
                "name": solution.boards.names[side][int(view["path"].split("-")[1].split(".")[0])],
                **{key: view[key] for key in ("rms_px", "corners", "outliers", "distance_m")},
            }
            for view in camera["views"]
        ]
        counts = [view["corners"] for view in views]
        total = sum(counts)
        rms = np.sqrt(sum(c * v["rms_px"] ** 2 for c, v in zip(counts, views) if c) / max(total, 1))
        corner = {
            where: _worst(sigma[rows, columns])
            for where, rows, columns in (
                ("top left", 0, 0),
                ("top right", 0, -1),
                ("bottom left", -1, 0),
                ("bottom right", -1, -1),
            )
        }
        f = camera["intrinsics"][:4]
        cameras[name] = {
            "lens": camera["lens"],
            "size": [width, height],
            "fx": f[0],
            "fy": f[1],
            "cx": f[2],
            "cy": f[3],
            "intrinsics": camera["intrinsics"],
            "rms": float(rms),
            "boards": sum(c > 0 for c in counts),
            "corners": total,
            "outliers": sum(len(v["outliers"]) for v in views),
            "views": views,
            "uncertainty": {
                "distance_m": distance,
                "columns_px": q[0, :, 0],
                "rows_px": q[:, 0, 1],
                "sigma_px": _listed(sigma),
                "centre_px": _worst(sigma[centre]),
                "corners_px": corner,
            },
            "cross_validation": None
            if difference is None
            else {
                "difference_px": _listed(difference),
                "centre_rms_px": _rms(difference[centre]),
                "centre_px": _worst(difference[centre]),
                "worst_px": _worst(difference),
            },
            "residual_correlation": _correlation(
                [view["residuals_px"] for view in camera["views"]], [view["outliers"] for view in camera["views"]]
            ),
            "coverage": _coverage(solution.boards.q[side], width, height),
            "tilt_deg": _tilt([view["normal"] for view in camera["views"] if view["corners"]]),
        }
    pair = raw["pair"]
    rt = np.array(pair["rt_right_left"])
    pair = {
        "baseline_m": pair["baseline_m"],
        "baseline_sigma_m": pair["baseline_sigma_m"],
        "halves_baseline_m": pair.get("halves_baseline_m"),
        "angle_deg": float(np.degrees(np.linalg.norm(rt[:3]))),
        "rt_right_left": rt,
        "covariance": pair["covariance"],
        "range_sigma_m": pair["range_sigma_m"],
    }
    answer = {
        "unit": "m",
        "from": "boards",
        "distance_m": distance,
        "distance_of": distance_of,
        "noise_px": raw["pair"]["noise_px"],
        "board_warp_m": raw["board_warp_m"],
        "shots": int(solution.boards.seen.any(0).sum()),
        "cameras": cameras,
        "pair": pair,
        "no_cross_validation": solution.why_no_halves,
    }
    answer["good_to_px"], answer["verdict"], answer["reasons"] = verdict(answer)
    return answer


def _array(listed):
    return np.array(
        [
            [np.nan if v is None else v for v in row]
            if not isinstance(row[0], list)
            else [[np.nan if v is None else v for v in cell] for cell in row]
            for row in listed
        ],
        float,
    )


def _listed(array):
    return [[round(float(v), 5) if np.isfinite(v) else None for v in row] for row in array]


def _worst(values):
    """The largest; None where one is not finite: what cannot be computed is not good."""
    return float(np.max(values)) if np.isfinite(values).all() else None


def _rms(values):
    return float(np.sqrt(np.mean(values**2))) if np.isfinite(values).all() else None


def _correlation(residuals, outliers):
    """Of the residuals of neighbouring corners. Noise has none; a lens model that cannot follow the lens, a bent board, have much.

    >>> noise, wave = np.random.default_rng(0).normal(size=(2, 6, 9, 2)), np.ones((1, 6, 9, 2))
    >>> abs(_correlation(noise.tolist(), [[], []])) < 0.2, _correlation(wave.tolist(), [[]])
    (True, 1.0)
    """
    products, squares = 0.0, 0.0
    for view, out in zip(residuals, outliers):
        e = np.array([[[np.nan if v is None else v for v in corner] for corner in row] for row in view], float)
        for y, x in out:
            e[y, x] = np.nan
        for a, b in ((e[:, :-1], e[:, 1:]), (e[:-1], e[1:])):
            both = np.isfinite(a).all(-1) & np.isfinite(b).all(-1)
            products += float((a[both] * b[both]).sum())
            squares += float((a[both] ** 2 + b[both] ** 2).sum()) / 2
    return products / squares if squares else 0.0


def _coverage(q, width, height):
    """Which fifth-sized corners of the picture no board reaches, and the share of an 8 x 6 grid of cells that hold a corner."""
    q = q[np.isfinite(q[..., 0])]
    x, y = q[:, 0] / width, q[:, 1] / height
    cells = len(set(zip(np.clip(8 * x, 0, 7).astype(int), np.clip(6 * y, 0, 5).astype(int))))
    corners = {
        "top left": (x < 0.2) & (y < 0.2),
        "top right": (x > 0.8) & (y < 0.2),
        "bottom left": (x < 0.2) & (y > 0.8),
        "bottom right": (x > 0.8) & (y > 0.8),
    }
    return {"cells": cells / 48, "unreached": [name for name, there in corners.items() if not there.any()]}


def _tilt(normals):
    """Degrees: the largest angle between the normals of two boards; parallel boards leave the focal length open."""
    n = np.array(normals, float)
    return float(np.degrees(np.arccos(np.clip((n @ n.T).min(), -1, 1)))) if len(n) else 0.0


def verdict(answer):
    """(px or None, one line, [reasons]). `good to x px`: in the middle 80 % of both pictures, at the scene's distance, one
    sigma: the projection uncertainty, or half the difference of the two halves where that is more (each half has
    half the boards, so 2 sigma between them are expected), or the part of the residuals that neighbouring corners share."""
    reasons, worst = [], []
    for name, camera in answer["cameras"].items():
        sigma, cross = camera["uncertainty"]["centre_px"], camera["cross_validation"]
        half = cross["centre_rms_px"] / 2 if cross and cross["centre_rms_px"] is not None else None
        alike = camera["residual_correlation"]
        bias = camera["rms"] * np.sqrt(alike) if alike > ALIKE else 0.0
        worst.append(None if sigma is None or (cross and half is None) else float(max(sigma, half or 0, bias)))
        if bias:
            reasons.append(
                f"{name}: what is left, {_two(camera['rms'])} px, is no noise: neighbouring corners err alike (correlation {alike:.1f}): another lens model, or a bent board"
            )
        if camera["boards"] < LEAST:
            reasons.append(f"too few boards: {name} sees {camera['boards']}, ten or more are wanted")
        if camera["tilt_deg"] < TILT:
            reasons.append(
                f"too few tilted boards: {name}'s differ by {camera['tilt_deg']:.0f} degrees at most, so focal length and distance look alike"
            )
        if camera["coverage"]["unreached"]:
            unreached = camera["coverage"]["unreached"]
            there = [camera["uncertainty"]["corners_px"][corner] for corner in unreached]
            known = "unknown there" if None in there else f"{_two(max(there))} px there"
            reasons.append(
                f"boards do not reach {'any corner' if len(unreached) == 4 else 'the ' + ', '.join(unreached)} of {name}'s picture ({known})"
            )
        seen = camera["corners"] + camera["outliers"]
        if camera["outliers"] > 0.05 * seen:
            reasons.append(f"{100 * camera['outliers'] / seen:.0f} % of {name}'s corners fit no board")
        if sigma and half and half > 3 * sigma:
            reasons.append(
                f"{name}: the halves differ {half / sigma:.0f} times more than the corners' noise explains: another lens model, or a bent board"
            )
    if answer["no_cross_validation"]:
        reasons.append(f"no cross-validation: {answer['no_cross_validation']}")
    pair = answer["pair"]
    if pair["baseline_m"] < 5 * pair["baseline_sigma_m"]:
        reasons.append(
            f"both cameras stand at one place (baseline {1000 * pair['baseline_m']:.2g} mm, sigma {1000 * pair['baseline_sigma_m']:.2g}): nothing tells distances"
        )
    good = None if None in worst else max(worst)
    word = "unknown" if good is None else "good" if good <= GOOD else "fair" if good <= FAIR else "poor"
    line = (
        f"{word}: nowhere certain" if good is None else f"{word} to {_two(good)} px at {_two(answer['distance_m'])} m"
    )
    range_sigma = pair["range_sigma_m"]
    if good is not None and range_sigma is not None:
        line += f" (range to {_two(1000 * range_sigma)} mm)"
    return good, "; ".join([line, *reasons]), reasons


def _two(value):
    """Two digits that count.

    >>> _two(0.01234), _two(3.0), _two(1234.0)
    ('0.012', '3.0', '1200')
    """
    if value == 0 or not np.isfinite(value):
        return str(value)
    digits = 1 - int(np.floor(np.log10(abs(value))))
    return f"{round(float(value), digits):.{max(digits, 0)}f}"


# ---- the stage's two ways ----


@dataclass(frozen=True, eq=False)
class Calibration:
    """answer : calibration.json; texts : (left, right) .cameramodel; boards : what was found, or None"""

    answer: dict
    texts: tuple
    boards: object

    def errors(self):
        """(name, value, unit, against) for the report."""
        for name, camera in self.answer["cameras"].items():
            if "rms" in camera:
                yield f"rms_{name}", camera["rms"], "px", "the boards' corners"
                yield (
                    f"uncertainty_{name}",
                    camera["uncertainty"]["centre_px"],
                    "px",
                    f"one sigma at {_two(self.answer['distance_m'])} m, worst in the middle {100 * CENTRE:.0f} %",
                )
                if camera["cross_validation"]:
                    yield (
                        f"cross_validation_{name}",
                        camera["cross_validation"]["centre_rms_px"],
                        "px",
                        "between calibrations by half the boards each, RMS in the middle",
                    )
            else:
                yield f"focal_sigma_{name}", camera["sigma"], "px", camera["focal_from"]
        pair = self.answer.get("pair")
        if pair:
            yield "baseline_sigma", pair["baseline_sigma_m"], "m", "the corners' noise"
            yield (
                "range_sigma",
                pair["range_sigma_m"],
                "m",
                f"straight ahead at {_two(self.answer['distance_m'])} m, from the calibration alone",
            )

    def write(self, camera, camera_right, corners, calibration):
        from lib.core import artefact
        from lib.vision import boards as files

        for path, text in zip((camera, camera_right), self.texts):
            Path(path).write_text(text, encoding="utf-8")
        files.write_vnl(
            corners, self.boards or files.Boards(((), ()), np.zeros((2, 0, 1, 1, 2)), np.zeros((2, 0, 1, 1)))
        )
        artefact.write_json(calibration, self.answer)


def from_boards(folder, board, lens, photographs, report, scratch):
    """Calibration by the boards in folder; photographs : (left path, right path) that tell the scene's distance, or None."""
    from lib.core.stage import Bar
    from lib.given import lenses
    from lib.vision import boards as files

    require_mrcal()
    lenses.check_name(lens, "lens")
    if board is None:
        raise BadInput(f"{folder}: board: its corners and squares are not known (scene.yaml: board)")
    corners, square_m = tuple(board["corners"]), float(board["square_m"])
    listed = Path(folder) / "corners.vnl"
    with report.timing("corners"):
        if listed.is_file():
            found = files.read_vnl(listed, corners)
            sizes = _sizes(folder, photographs)
        else:
            found, sizes = files.detect(files.pairs(folder), corners, Bar("corners"))
    with report.timing("solve"):
        solution = solve(found, corners, square_m, sizes, lens, scratch)
    for side, seen in enumerate(found.seen):
        blank = [name for name, there in zip(found.names[side], seen) if not there]
        if blank:
            report.warning(
                f"{SIDES[side]}: no board found in {len(blank)} of {len(seen)} images: {', '.join(blank[:5])}{', ...' if len(blank) > 5 else ''}"
            )
    with report.timing("distance"):
        distance = scene_distance(solution.models, photographs) if photographs else None
    with report.timing("uncertainty"):
        answer = judge(solution, distance)
    return Calibration(answer, tuple(Path(m).read_text(encoding="utf-8") for m in solution.models), found)


def from_pair(photographs, report):
    """The lenses alone, as pinholes of one centre, from the photographs: lib/autocalibration.py. The unit is the baseline."""
    from lib.vision import autocalibration
    from lib.vision import boards as files

    if photographs is None:
        raise BadInput("calibrate: neither boards nor a pair of photographs: nothing tells the lens")
    with report.timing("focal length"):
        greys = [files.grey8(path) for path in photographs]
        focals = autocalibration.focal_length(photographs, greys)
    entries, texts, reasons = {}, [], []
    for name, grey, focal in zip(SIDES, greys, focals):
        height, width = grey.shape
        cx, cy = (width - 1) / 2, (height - 1) / 2
        entries[name] = {
            "lens": "LENSMODEL_PINHOLE",
            "size": [width, height],
            "fx": focal.f,
            "fy": focal.f,
            "cx": cx,
            "cy": cy,
            "sigma": focal.sigma,
            "assumed": focal.assumed,
            "focal_from": focal.origin,
            "witnesses": list(focal.witnesses),
            "bent": focal.bent,
        }
        texts.append(
            f"{{\n 'lensmodel': 'LENSMODEL_PINHOLE',\n 'intrinsics': [ {focal.f!r}, {focal.f!r}, {cx!r}, {cy!r},],\n"
            f" 'extrinsics': [ 0., 0., 0., 0., 0., 0.,],\n 'imagersize': [ {width}, {height},],\n}}\n"
        )
        if focal.assumed:
            reasons.append(
                f"{name}: neither the file nor right angles nor the matches tell the focal length: {_two(autocalibration.DEFAULT)} picture widths are assumed; boards would tell"
            )
        if focal.bent and abs(focal.bent["k1"]) > max(3 * focal.bent["sigma"], 0.02):
            reasons.append(
                f"{name}: straight edges are bent (k1 = {_two(focal.bent['k1'])}), which a pinhole does not know: boards would tell"
            )
    worst = max(focals, key=lambda focal: focal.sigma / focal.f)
    line = (
        "unknown: a focal length is assumed"
        if worst.assumed
        else f"focal length to {_two(100 * worst.sigma / worst.f)} %, from {worst.origin}"
    )
    answer = {
        "unit": "baseline",
        "from": "pair",
        "cameras": entries,
        "pair": None,
        "good_to_px": None,
        "verdict": "; ".join([line, *reasons]),
        "reasons": reasons,
    }
    return Calibration(answer, tuple(texts), None)


def _sizes(folder, photographs):
    """((w, h), (w, h)) where only corners are given: of a board's image if there is one, else of the photographs."""
    from lib.given import image
    from lib.vision import boards as files

    sizes = []
    for side, name in enumerate(SIDES):
        shots = [
            p
            for p in sorted(Path(folder).iterdir())
            if p.name.startswith(f"{name}-") and p.suffix.lower() in files.EXTENSIONS
        ]
        path = shots[0] if shots else photographs[side] if photographs else None
        if path is None:
            raise BadInput(
                f"{folder}: size: corners.vnl does not tell the size of {name}'s pictures, and neither images nor photographs do"
            )
        sizes.append(image.read_photograph(path).values.shape[1::-1])
    return tuple(sizes)


def scene_distance(models, photographs):
    """Median distance of what both photographs show (m, from the left camera), by matched SIFT features; None where they are too few."""
    from lib.given import lenses
    from lib.vision import boards as files
    from lib.vision import orientation

    lens = [lenses.read(model) for model in models]
    greys = [files.grey8(path) for path in photographs]
    for path, grey, view in zip(photographs, greys, lens):
        if grey.shape != (view.height, view.width):
            raise BadInput(
                f"{path}: size: {grey.shape[1]} x {grey.shape[0]} is not the boards' {view.width} x {view.height}"
            )
    q_left, q_right = orientation.match(*greys)
    if len(q_left) < 10:
        return None
    v_left, v_right = lens[0].unproject(q_left), lens[1].unproject(q_right)
    T = lens[1].T_cam_ref @ np.linalg.inv(lens[0].T_cam_ref)
    v_left, v_right = v_left / np.linalg.norm(v_left, axis=1, keepdims=True), v_right @ T[:3, :3]
    v_right /= np.linalg.norm(v_right, axis=1, keepdims=True)
    t = -T[:3, :3].T @ T[:3, 3]  # the right camera's centre, left frame
    normal = np.cross(np.broadcast_to(t, v_left.shape), v_left)
    off = np.abs((normal * v_right).sum(1)) / np.linalg.norm(normal, axis=1)
    c = (v_left * v_right).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (v_left @ t - c * (v_right @ t)) / (1 - c**2)  # the point of the left ray nearest to the right one
    good = (off < 2 / lens[0].intrinsics[0]) & (along > 0) & np.isfinite(along)
    return float(np.median(along[good])) if good.sum() >= 10 else None
