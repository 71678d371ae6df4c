"""§2 Lenses and the relative pose of a pair: from chessboards, or the lenses alone from the photographs.

    found = from_boards("boards", board, "LENSMODEL_OPENCV8", photographs, report, scratch)
    found.answer, found.texts                   # calibration.json, and both .cameramodel files

With boards mrcal solves (board_calibration.py), and calibration_answer.py says how far that can be trusted.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.core import artefact
from lib.core.stage import BadInput, Bar
from lib.given import image, lenses, mrcal_runner
from lib.vision import autocalibration, board_calibration, board_checks, calibration_answer, orientation
from lib.vision import boards as files
from lib.vision.boards import SIDES
from lib.vision.calibration_answer import CENTRE, two_digits

BENT = 0.02  # k1 from which on straight edges are called bent
MET = 10  # matched features that tell the scene's distance


@dataclass(frozen=True, eq=False)
class Calibration:
    """answer : calibration.json; texts : (left, right) .cameramodel; boards : files.Boards found, or None"""

    answer: dict
    texts: tuple
    boards: files.Boards | None

    def errors(self):
        """(name, value, unit, against) for the report."""
        for name, camera in self.answer["cameras"].items():
            if "rms" in camera:
                yield from self._of_boards(name, camera)
            else:
                yield f"focal_sigma_{name}", camera["sigma"], "px", camera["focal_from"]
        if pair := self.answer.get("pair"):
            at = f"straight ahead at {two_digits(self.answer['distance_m'])} m, from the calibration alone"
            yield "baseline_sigma", pair["baseline_sigma_m"], "m", "the corners' noise"
            yield "range_sigma", pair["range_sigma_m"], "m", at

    def _of_boards(self, name, camera):
        at = f"one sigma at {two_digits(self.answer['distance_m'])} m, worst in the middle {100 * CENTRE:.0f} %"
        yield f"rms_{name}", camera["rms"], "px", "the boards' corners"
        yield f"uncertainty_{name}", camera["uncertainty"]["centre_px"], "px", at
        if cross := camera["cross_validation"]:
            between = "between calibrations by half the boards each, RMS in the middle"
            yield f"cross_validation_{name}", cross["centre_rms_px"], "px", between

    def write(self, camera, camera_right, corners, calibration):
        """The stage's four files; corners.vnl is empty where there are no boards."""
        for path, text in zip((camera, camera_right), self.texts, strict=True):
            Path(path).write_text(text, encoding="utf-8")
        nothing = files.Boards(((), ()), np.zeros((2, 0, 1, 1, 2)), np.zeros((2, 0, 1, 1)))
        files.write_vnl(corners, self.boards or nothing)
        artefact.write_json(calibration, self.answer)


# ---- from boards ----


def from_boards(folder, board, lens, photographs, report, scratch) -> Calibration:
    """Calibration by the boards in folder.

    board : {"corners": [nx, ny], "square_m": m}, or None where nobody said; lens : LENSMODEL_...
    photographs : (left path, right path) that tell the scene's distance, or None; scratch : a folder for mrcal's files
    """
    mrcal_runner.require_mrcal()
    lenses.check_name(lens, "lens")
    if board is None:
        raise BadInput(f"{folder}: board: its corners and squares are not known (scene.yaml: board)")
    corners, square_m = tuple(board["corners"]), float(board["square_m"])
    listed = Path(folder) / "corners.vnl"
    with report.timing("corners"):
        if listed.is_file():
            found = files.read_vnl(listed, corners)
            board_checks.check_order(listed, found, corners)
            sizes = _sizes(folder, photographs)
        else:
            shots = files.pairs(folder)
            _warn_of_turns(shots, report)
            board_checks.check_counts([path for shot in shots for path in shot], corners)
            found, sizes = files.detect(shots, corners, Bar("corners"))
        # the lens is wanted for the photographs as they are shown
        turns = [image.orientation(path) for path in photographs] if photographs else (1, 1)
        shown, sizes = files.as_shown(found, sizes, turns)
    with report.timing("solve"):
        solution = board_calibration.solve(shown, corners, square_m, sizes, lens, scratch, trace=_traced(report))
    _warn_of_blanks(found, report)
    with report.timing("distance"):
        distance_m = scene_distance(solution.models, photographs) if photographs else None
    with report.timing("uncertainty"):
        answer = calibration_answer.judge(solution, distance_m)
    return Calibration(answer, tuple(Path(m).read_text(encoding="utf-8") for m in solution.models), found)


def _traced(report):
    """The solve's trace goes to the report. A child that still runs is not in its clocks: mrcal's time is added."""
    return lambda step, rms_px, cpu_s: report.trace(step=step, rms_px=rms_px, cpu_s=report.clocks().cpu + cpu_s)


def _warn_of_turns(shots, report):
    """Pictures of boards whose orientation is not read."""
    for side, paths in zip(SIDES, zip(*shots, strict=True), strict=True):
        if noted := sum(image.orientation(path) != 1 for path in paths):
            why = "a lens belongs to the sensor"
            report.warning(
                f"{side}: {noted} of {len(paths)} pictures of boards note an orientation: not read, for {why}"
            )


def _warn_of_blanks(found, report):
    """Images in which no board was found."""
    for side, seen in enumerate(found.seen):
        blank = [name for name, there in zip(found.names[side], seen, strict=True) if not there]
        if blank:
            named = ", ".join(blank[:5]) + (", ..." if len(blank) > 5 else "")
            report.warning(f"{SIDES[side]}: no board found in {len(blank)} of {len(seen)} images: {named}")


def _sizes(folder, photographs):
    """((w, h), (w, h)) of the sensors where only corners are given: of a board's image if there is one, else of the
    photographs."""
    sizes = []
    for side, name in enumerate(SIDES):
        shots = files.images(folder, name)
        path = shots[0] if shots else photographs[side] if photographs else None
        if path is None:
            raise BadInput(
                f"{folder}: size: corners.vnl does not tell the size of {name}'s pictures, and neither images nor "
                "photographs do"
            )
        sizes.append(image.read_photograph(path, as_stored=True).values.shape[1::-1])
    return tuple(sizes)


def scene_distance(models, photographs):
    """Median distance of what both photographs show, m from the left camera; None where too little is matched.

    models, photographs : (left path, right path). SIFT features are matched, and each ray of the left camera goes to
    the point nearest to its partner's.
    """
    lens = [lenses.read(model) for model in models]
    greys = [files.grey8(path) for path in photographs]
    for path, grey, view in zip(photographs, greys, lens, strict=True):
        if grey.shape != (view.height, view.width):
            height, width = grey.shape
            raise BadInput(f"{path}: size: {width} x {height} is not the boards' {view.width} x {view.height}")
    q_left, q_right = orientation.match(*greys)
    if len(q_left) < MET:
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
        along = (v_left @ t - c * (v_right @ t)) / (1 - c**2)
    good = (off < 2 / lens[0].intrinsics[0]) & (along > 0) & np.isfinite(along)
    return float(np.median(along[good])) if good.sum() >= MET else None


# ---- from the pair alone ----


def from_pair(photographs, report) -> Calibration:
    """The lenses alone, as pinholes of one centre, from the photographs (autocalibration.py). The unit is the baseline.

    photographs : (left path, right path), or None where there are none, which is BadInput
    """
    if photographs is None:
        raise BadInput("calibrate: neither boards nor a pair of photographs: nothing tells the lens")
    with report.timing("focal length"):
        greys = [files.grey8(path) for path in photographs]
        focals = autocalibration.focal_length(photographs, greys, report.trace)
    entries, texts, reasons = {}, [], []
    for name, grey, focal in zip(SIDES, greys, focals, strict=True):
        entries[name] = _entry(grey.shape[::-1], focal)
        texts.append(_pinhole_text(entries[name]))
        reasons += _doubts(name, focal)
    worst = max(focals, key=lambda focal: focal.sigma / focal.f)
    line = "unknown: a focal length is assumed"
    if not worst.assumed:
        line = f"focal length to {two_digits(100 * worst.sigma / worst.f)} %, from {worst.origin}"
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


def _entry(size, focal):
    """A camera's entry of calibration.json. size : (w, h) px"""
    width, height = size
    return {
        "lens": "LENSMODEL_PINHOLE",
        "size": [width, height],
        "fx": focal.f,
        "fy": focal.f,
        "cx": (width - 1) / 2,
        "cy": (height - 1) / 2,
        "sigma": focal.sigma,
        "assumed": focal.assumed,
        "focal_from": focal.origin,
        "witnesses": list(focal.witnesses),
        "bent": focal.bent,
    }


def _pinhole_text(entry):
    """The .cameramodel of an entry, at the origin."""
    intrinsics = ", ".join(repr(entry[key]) for key in ("fx", "fy", "cx", "cy"))
    width, height = entry["size"]
    return (
        f"{{\n 'lensmodel': 'LENSMODEL_PINHOLE',\n 'intrinsics': [ {intrinsics},],\n"
        f" 'extrinsics': [ 0., 0., 0., 0., 0., 0.,],\n 'imagersize': [ {width}, {height},],\n}}\n"
    )


def _doubts(name, focal):
    """Reasons to doubt one camera's focal length."""
    if focal.assumed:
        yield (
            f"{name}: neither the file nor right angles nor the matches tell the focal length: "
            f"{two_digits(autocalibration.DEFAULT)} picture widths are assumed; boards would tell"
        )
    if focal.bent and abs(focal.bent["k1"]) > max(3 * focal.bent["sigma"], BENT):
        yield (
            f"{name}: straight edges are bent (k1 = {two_digits(focal.bent['k1'])}), which a pinhole does not know: "
            "boards would tell"
        )
