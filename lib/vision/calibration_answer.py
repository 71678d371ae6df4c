"""How far a calibration from boards can be trusted: what calibration.json says.

    answer = judge(solution, distance_m=3.0)          # uncertainty, cross-validation, verdict

An RMS says how well the boards fit, not how well the lens is known: a lens with many parameters fits three boards to
nothing. So the answer is the *projection uncertainty* at the distance of the scene: mrcal carries the corners' noise
through the solve into a projected pixel. A check that assumes nothing stands beside it: two calibrations from half the
boards each, and by how much they differ.
"""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.given import mrcal_runner
from lib.vision.board_calibration import LEAST
from lib.vision.boards import SIDES

COLUMNS = 16  # of the grid on which uncertainty and differences are given
CENTRE = 0.8  # of the picture's width and height: what the verdict is about
TILT = 15.0  # degrees between two boards' normals, from which on they tell the focal length
ALIKE = 0.5  # correlation of neighbouring corners' residuals from which on they are no noise
GOOD, FAIR = 0.5, 2.0  # px: limits of the verdict's first word
OUTLIERS = 0.05  # share of the corners that may fit no board without a word
CORNERS = {"top left": (0, 0), "top right": (0, -1), "bottom left": (-1, 0), "bottom right": (-1, -1)}  # [row, column]


def judge(solution, distance_m=None):
    """What calibration.json says, a dictionary. BadInput where mrcal cannot say it.

    solution : board_calibration.Solution; distance_m : of the scene, or None for the boards' own
    """
    folder = Path(solution.models[0]).parent
    request, answer = folder / "request.json", folder / "answer.json"
    asked = {
        "models": [str(m) for m in solution.models],
        "halves": [[str(m) for m in pair] for pair in solution.halves],
        "distance_m": distance_m,
        "columns": COLUMNS,
    }
    request.write_text(json.dumps(asked), encoding="utf-8")
    mrcal_runner.process("judge", request, answer, of="boards: how far the result can be trusted is not known")
    raw = json.loads(answer.read_text(encoding="utf-8"))
    return _answer(solution, raw, "scene" if distance_m is not None else "boards")


def _answer(solution, raw, distance_of):
    """calibration.json from what mrcal_process.judge wrote."""
    cameras = {
        name: _camera(solution, side, raw["cameras"][side], raw["distance_m"]) for side, name in enumerate(SIDES)
    }
    answer = {
        "unit": "m",
        "from": "boards",
        "distance_m": raw["distance_m"],
        "distance_of": distance_of,
        "noise_px": raw["pair"]["noise_px"],
        "board_warp_m": raw["board_warp_m"],
        "shots": int(solution.boards.seen.any(0).sum()),
        "cameras": cameras,
        "pair": _pair(raw["pair"]),
        "no_cross_validation": solution.why_no_halves,
        "not_computed": raw["not_computed"],
    }
    answer["good_to_px"], answer["verdict"], answer["reasons"] = verdict(answer)
    return answer


def _camera(solution, side, camera, distance_m):
    """One camera's entry."""
    width, height = solution.sizes[side]
    views = [
        {
            "name": solution.boards.names[side][int(view["path"].split("-")[1].split(".")[0])],
            **{key: view[key] for key in ("rms_px", "corners", "outliers", "distance_m")},
        }
        for view in camera["views"]
    ]
    counts = [view["corners"] for view in views]
    total = sum(counts)
    rms = np.sqrt(sum(c * v["rms_px"] ** 2 for c, v in zip(counts, views, strict=True) if c) / max(total, 1))
    fx, fy, cx, cy = camera["intrinsics"][:4]
    q = np.array(camera["q"])
    centre = (np.abs(q / [width - 1, height - 1] - 0.5) <= CENTRE / 2).all(-1)
    return {
        "lens": camera["lens"],
        "size": [width, height],
        "fx": fx,
        "fy": fy,
        "cx": cx,
        "cy": cy,
        "intrinsics": camera["intrinsics"],
        "rms": float(rms),
        "boards": sum(c > 0 for c in counts),
        "corners": total,
        "outliers": sum(len(v["outliers"]) for v in views),
        "views": views,
        "uncertainty": _uncertainty(_array(camera["uncertainty_px"]), q, centre, distance_m),
        "cross_validation": _cross_validation(camera.get("difference_px"), centre),
        "residual_correlation": _correlation(
            [view["residuals_px"] for view in camera["views"]], [view["outliers"] for view in camera["views"]]
        ),
        "coverage": _coverage(solution.boards.q[side], width, height),
        "tilt_deg": _tilt([view["normal"] for view in camera["views"] if view["corners"]]),
    }


def _uncertainty(sigma, q, centre, distance_m):
    """The projection uncertainty sigma (rows, columns) px at the pixels q (rows, columns, 2); centre : bool."""
    return {
        "distance_m": distance_m,
        "columns_px": q[0, :, 0],
        "rows_px": q[:, 0, 1],
        "sigma_px": _listed(sigma),
        "centre_px": _worst(sigma[centre]),
        "corners_px": {where: _worst(sigma[at]) for where, at in CORNERS.items()},
    }


def _cross_validation(difference_px, centre):
    """How far the calibrations by half the boards differ, (rows, columns, 2) px; None where there are none."""
    if difference_px is None:
        return None
    difference = np.linalg.norm(_array(difference_px), axis=-1)
    return {
        "difference_px": _listed(difference),
        "centre_rms_px": _rms(difference[centre]),
        "centre_px": _worst(difference[centre]),
        "worst_px": _worst(difference),
    }


def _pair(pair):
    """The pair's entry."""
    rt = np.array(pair["rt_right_left"])
    return {
        "baseline_m": pair["baseline_m"],
        "baseline_sigma_m": pair["baseline_sigma_m"],
        "halves_baseline_m": pair.get("halves_baseline_m"),
        "angle_deg": float(np.degrees(np.linalg.norm(rt[:3]))),
        "rt_right_left": rt,
        "covariance": pair["covariance"],
        "range_sigma_m": pair["range_sigma_m"],
    }


# ---- numbers ----


def _array(listed):
    """Nested lists as an array, null as nan.

    >>> _array([[1, None], [2.5, 0]])
    array([[1. , nan], [2.5, 0. ]])
    """
    return np.array(listed, float)


def _listed(array):
    return [[round(float(v), 5) if np.isfinite(v) else None for v in row] for row in array]


def _worst(values):
    """The largest; None where one is not finite, for what cannot be computed is not good."""
    return float(np.max(values)) if np.isfinite(values).all() else None


def _rms(values):
    return float(np.sqrt(np.mean(values**2))) if np.isfinite(values).all() else None


def _correlation(residuals, outliers):
    """Correlation of the residuals of neighbouring corners.

    residuals : per view (ny, nx, 2) px, lists; outliers : per view [(row, column)], left out

    Noise has none. A bent board has much, and so has a lens model that cannot follow the lens.

    >>> noise, wave = np.random.default_rng(0).normal(size=(2, 6, 9, 2)), np.ones((1, 6, 9, 2))
    >>> abs(_correlation(noise.tolist(), [[], []])) < 0.2, _correlation(wave.tolist(), [[]])
    (True, 1.0)
    """
    products, squares = 0.0, 0.0
    for view, out in zip(residuals, outliers, strict=True):
        e = _array(view)
        for y, x in out:
            e[y, x] = np.nan
        for a, b in ((e[:, :-1], e[:, 1:]), (e[:-1], e[1:])):
            both = np.isfinite(a).all(-1) & np.isfinite(b).all(-1)
            products += float((a[both] * b[both]).sum())
            squares += float((a[both] ** 2 + b[both] ** 2).sum()) / 2
    return products / squares if squares else 0.0


def _coverage(q, width, height):
    """Which corners of the picture, a fifth of its width and height, hold no corner of a board q (..., 2) px.

    And the share of an 8 x 6 grid of cells that hold one.
    """
    q = q[np.isfinite(q[..., 0])]
    x, y = q[:, 0] / width, q[:, 1] / height
    cells = len(set(zip(np.clip(8 * x, 0, 7).astype(int), np.clip(6 * y, 0, 5).astype(int), strict=True)))
    corners = {
        "top left": (x < 0.2) & (y < 0.2),
        "top right": (x > 0.8) & (y < 0.2),
        "bottom left": (x < 0.2) & (y > 0.8),
        "bottom right": (x > 0.8) & (y > 0.8),
    }
    return {"cells": cells / 48, "unreached": [name for name, there in corners.items() if not there.any()]}


def _tilt(normals):
    """Degrees: the largest angle between the normals (n, 3) of two boards. Parallel ones leave the focal length open.

    >>> round(_tilt([[0, 0, 1], [0, 0.6, 0.8]]), 2), _tilt([])
    (36.87, 0.0)
    """
    n = np.array(normals, float)
    return float(np.degrees(np.arccos(np.clip((n @ n.T).min(), -1, 1)))) if len(n) else 0.0


# ---- the verdict ----


class Doubts(NamedTuple):
    """One sigma of a camera's projections in the middle of its picture, by three witnesses, px."""

    sigma: float | None  # the corners' noise, carried through the solve; None: it cannot be computed
    half: float | None  # half the difference of the two halves: each has half the boards, so they differ by 2 sigma
    bias: float  # the part of the residuals that neighbouring corners share, if that is much
    complete: bool  # all that could be asked was answered

    @classmethod
    def of(cls, camera):
        """Of a camera's entry."""
        sigma, cross = camera["uncertainty"]["centre_px"], camera["cross_validation"]
        half = cross["centre_rms_px"] / 2 if cross and cross["centre_rms_px"] is not None else None
        alike = camera["residual_correlation"]
        bias = camera["rms"] * np.sqrt(alike) if alike > ALIKE else 0.0
        return cls(sigma, half, bias, sigma is not None and not (cross and half is None))

    @property
    def worst(self):
        """px, or None where one of them is not known."""
        return float(max(self.sigma, self.half or 0, self.bias)) if self.complete else None


def verdict(answer):
    """(px or None, one line, [reasons]) of calibration.json, from its other fields.

    `good to x px`: one sigma in the middle 80 % of both pictures, at the scene's distance: the largest of `Doubts`.
    """
    doubts = {name: Doubts.of(camera) for name, camera in answer["cameras"].items()}
    reasons = [
        reason for name, camera in answer["cameras"].items() for reason in _of_camera(name, camera, doubts[name])
    ]
    reasons += _of_pair(answer)
    reasons += [f"mrcal cannot compute {what}" for what in answer["not_computed"]]
    worst = [doubt.worst for doubt in doubts.values()]
    good = None if None in worst else max(worst)
    return good, "; ".join([_headline(good, answer), *reasons]), reasons


def _headline(good, answer):
    """`good to 0.08 px at 3.1 m (range to 4.5 mm)`."""
    if good is None:
        return "unknown: nowhere certain"
    word = "good" if good <= GOOD else "fair" if good <= FAIR else "poor"
    line = f"{word} to {two_digits(good)} px at {two_digits(answer['distance_m'])} m"
    range_sigma = answer["pair"]["range_sigma_m"]
    return line if range_sigma is None else f"{line} (range to {two_digits(1000 * range_sigma)} mm)"


def _of_camera(name, camera, doubt):
    """Reasons to doubt one camera."""
    if doubt.bias:
        yield (
            f"{name}: what is left, {two_digits(camera['rms'])} px, is no noise: neighbouring corners err alike "
            f"(correlation {camera['residual_correlation']:.1f}): another lens model, or a bent board"
        )
    if camera["boards"] < LEAST:
        yield f"too few boards: {name} sees {camera['boards']}, ten or more are wanted"
    if camera["tilt_deg"] < TILT:
        yield (
            f"too few tilted boards: {name}'s differ by {camera['tilt_deg']:.0f} degrees at most, so focal length and "
            "distance look alike"
        )
    if unreached := camera["coverage"]["unreached"]:
        there = [camera["uncertainty"]["corners_px"][corner] for corner in unreached]
        known = "unknown there" if None in there else f"{two_digits(max(there))} px there"
        which = "any corner" if len(unreached) == len(CORNERS) else "the " + ", ".join(unreached)
        yield f"boards do not reach {which} of {name}'s picture ({known})"
    seen = camera["corners"] + camera["outliers"]
    if camera["outliers"] > OUTLIERS * seen:
        yield f"{100 * camera['outliers'] / seen:.0f} % of {name}'s corners fit no board"
    if doubt.sigma and doubt.half and doubt.half > 3 * doubt.sigma:
        yield (
            f"{name}: the halves differ {doubt.half / doubt.sigma:.0f} times more than the corners' noise explains: "
            "another lens model, or a bent board"
        )


def _of_pair(answer):
    """Reasons to doubt both cameras together."""
    if answer["no_cross_validation"]:
        yield f"no cross-validation: {answer['no_cross_validation']}"
    baseline_m, sigma_m = answer["pair"]["baseline_m"], answer["pair"]["baseline_sigma_m"]
    if baseline_m < 5 * sigma_m:
        yield (
            f"both cameras stand at one place (baseline {1000 * baseline_m:.2g} mm, sigma {1000 * sigma_m:.2g}): "
            "nothing tells distances"
        )


def two_digits(value):
    """Two digits that count.

    >>> two_digits(0.01234), two_digits(3.0), two_digits(1234.0)
    ('0.012', '3.0', '1200')
    """
    if value == 0 or not np.isfinite(value):
        return str(value)
    digits = 1 - int(np.floor(np.log10(abs(value))))
    return f"{round(float(value), digits):.{max(digits, 0)}f}"
