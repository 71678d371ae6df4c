"""Intact shots of chessboards that were misread, or ended in a traceback: each is read rightly, or told in one line."""

import json
import shutil

import cv2
import numpy as np
import pytest
from PIL import Image

from lib.core.stage import BadInput
from lib.given import cameras, image, lenses, mrcal_runner
from lib.vision import board_calibration, board_checks, boards, calibration_answer
from tests.helpers import chessboards

needs_mrcal = pytest.mark.skipif(shutil.which(mrcal_runner.COMMAND) is None, reason="mrcal is not installed")
SIZES = ((640, 480), (640, 480))
PINHOLE = np.array([600.0, 600.0, 344.5, 262.5])  # of both cameras in the case
ORIENTATION = 0x0112  # EXIF's tag


def pinhole(rt=(0, 0, 0, 0, 0, 0)):
    return lenses.Lens("LENSMODEL_PINHOLE", PINHOLE, 640, 480, cameras.matrix_from_rt(rt), "made")


def whole_boards(count, random, right):
    """(n, 4, 4) T_left_board of boards that both cameras see."""
    many = np.array(chessboards.poses(6 * count, random, tilt=0.4, distance=(0.55, 0.8), reach=0.35))
    return many[chessboards.seen(many, pinhole(), right, random).seen.all(0)][:count]


def calibrate(folder, out, board, *more, lens="LENSMODEL_PINHOLE"):
    names = {"camera": "left.cameramodel", "camera-right": "right.cameramodel", "corners": "corners.vnl"}
    names |= {"calibration": "calibration.json", "report": "calibrate.report.json"}
    files = [word for name, file in names.items() for word in (f"--{name}", out / file)]
    words = ["--boards", f"{folder}/", "--board", json.dumps(board), "--lens", json.dumps(lens)]
    return ["stages/calibrate.py", *words, *more, *files]


@pytest.fixture(scope="module")
def phone_boards(tmp_path_factory):
    """Six pairs of JPEGs; every second left one notes EXIF orientation 3 over the sensor's own pixels."""
    folder, random = tmp_path_factory.mktemp("phone") / "boards", np.random.default_rng(7)
    folder.mkdir()
    right = pinhole([0, 0, 0, -0.1, 0, 0])
    for n, T in enumerate(whole_boards(6, random, right)):
        for side, view in (("left", pinhole()), ("right", right)):
            grey = chessboards.render(view, view.T_cam_ref @ T, random, oversampling=2, noise=0)
            exif = Image.Exif()
            if side == "left" and n % 2:
                exif[ORIENTATION] = 3
            Image.fromarray(grey).save(folder / f"{side}-{n:02d}.jpg", quality=95, exif=exif)
    return folder


@pytest.mark.scene
@needs_mrcal
@pytest.mark.slow
def test_orientations_of_board_pictures_are_not_read(phone_boards, run, tmp_path):
    """fx 600, c (344.5, 262.5) px, baseline 0.1 m. It ended in mrcal's `Model 1 has been moved`, and a traceback."""
    result = run(*calibrate(phone_boards, tmp_path, {"corners": [9, 6], "square_m": 0.03}))
    assert result.returncode == 0, result.stderr
    answer = json.loads((tmp_path / "calibration.json").read_text())
    for camera in answer["cameras"].values():
        assert camera["intrinsics"] == pytest.approx(PINHOLE, abs=1.0) and camera["rms"] < 0.05
    assert answer["pair"]["baseline_m"] == pytest.approx(0.1, abs=1e-4)
    assert "left: 3 of 6 pictures of boards note an orientation: not read" in result.stderr
    # the photographs of the pair are shown turned: so is their lens, and the corners that are written stay the sensor's
    turned = tmp_path / "turned"
    (turned / "boards").mkdir(parents=True)
    shutil.copy(tmp_path / "corners.vnl", turned / "boards")
    exif = Image.Exif()
    exif[ORIENTATION] = 3
    for side in boards.SIDES:
        picture = Image.open(phone_boards / f"{side}-00.jpg")
        picture.save(turned / f"{side}.jpg", quality=95, exif=exif)
    photographs = ["--photograph", turned / "left.jpg", "--photograph-right", turned / "right.jpg"]
    result = run(*calibrate(turned / "boards", turned, {"corners": [9, 6], "square_m": 0.03}, *photographs))
    assert result.returncode == 0, result.stderr
    found = lenses.read(turned / "left.cameramodel")
    assert found.intrinsics == pytest.approx([600, 600, 639 - 344.5, 479 - 262.5], abs=1.0)
    assert (turned / "corners.vnl").read_text() == (tmp_path / "corners.vnl").read_text()


@pytest.mark.parametrize("turn", image.TURNS)
def test_corners_turn_as_their_picture_does(tmp_path, turn):
    """For each of EXIF's orientations, also those that mirror: the same corners are found where it is shown turned."""
    grey = chessboards.render(
        pinhole(), cameras.matrix_from_rt([0.1, 0.2, 0.1, 0, 0, 0.6]), np.random.default_rng(0), noise=0
    )
    exif = Image.Exif()
    exif[ORIENTATION] = turn
    Image.fromarray(grey).save(tmp_path / "left.png", exif=exif)
    shown = boards.grey8(tmp_path / "left.png")
    q = boards.find(boards.grey8(tmp_path / "left.png", as_stored=True), (9, 6))
    one = boards.Boards((("left.png",), ("right.png",)), np.stack([q, q])[:, None], np.zeros((2, 1, 6, 9)))
    there, sizes = boards.as_shown(one, SIZES, (turn, 1))
    assert sizes == (shown.shape[::-1], (640, 480)) and np.array_equal(there.q[1], one.q[1])
    again = boards.find(shown, (9, 6)).reshape(-1, 2)
    apart = np.linalg.norm(there.q[0].reshape(-1, 1, 2) - again, axis=-1)
    assert apart.min(1).max() < 0.02 and sorted(apart.argmin(1)) == list(range(54))


# ---- the board that is told ----


@pytest.mark.parametrize("corners", [(8, 6), (9, 5), (10, 7), (7, 7), (12, 9)])
def test_a_board_of_other_counts_is_told_by_name(root, refuses, tmp_path, corners):
    """After 76 s calibrate ended in `camera0-0.cameramodel: intrinsics: fx = -7419.75 is not positive`."""
    folder = root / "data/opencv-stereo13/boards"
    lines = refuses(*calibrate(folder, tmp_path / "out", {"corners": corners, "square_m": 0.025}))
    told = f"no board of {corners[0]} x {corners[1]} inner corners; one of 9 x 6 is there"
    assert len(lines) == 1 and told in lines[0] and "left-01.png: board:" in lines[0], lines
    assert ("squares" in lines[0]) == (corners == (10, 7)) and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "scene, corners", [("opencv-stereo13", (9, 6)), ("opencv-stereo13", (6, 9)), ("office-stereo", (10, 7))]
)
def test_a_board_of_these_counts_is_not(root, scene, corners):
    paths = [path for shot in boards.pairs(root / "data" / scene / "boards") for path in shot]
    board_checks.check_counts(paths, corners)


def test_rows_of_a_corner_file(tmp_path):
    """54 corners in rows of nine are no board of 6 x 9, and its number of corners does not tell."""
    random = np.random.default_rng(0)
    made = chessboards.seen(
        chessboards.poses(4, random, reach=0.3), chessboards.lens("left"), chessboards.lens("right"), random
    )
    path = tmp_path / "corners.vnl"
    boards.write_vnl(path, made)
    board_checks.check_order(path, boards.read_vnl(path, (9, 6)), (9, 6))
    for corners in ((6, 9), (18, 3), (27, 2)):
        with pytest.raises(BadInput, match=r"left-0\d.png: its 54 corners are no board .* rows of 9 are") as bad:
            board_checks.check_order(path, boards.read_vnl(path, corners), corners)
        assert str(path) in bad.value.problems[0]


# ---- shots that contradict each other ----


@pytest.fixture(scope="module")
def real_corners(root):
    return boards.detect(boards.pairs(root / "data/opencv-stereo13/boards"), (9, 6))


def contradiction(found, sizes=SIZES):
    board_checks.check_views(found)
    return board_checks.contradiction(found, (9, 6), board_calibration.focal_guess(found, (9, 6), sizes), sizes)


def changed(found, side, shots, change):
    """Boards with change(corners) instead of the corners of some shots."""
    q = found.q.copy()
    for n in shots:
        q[side, n] = change(q[side, n])
    return boards.Boards(found.names, q, found.level)


MIRRORED = lambda q: (q * [-1, 1] + [639, 0])[:, ::-1]
TURNED = lambda q: ([639, 479] - q)[::-1, ::-1]
MOVED = lambda q: q + [25, 0]


@pytest.mark.parametrize("change", [MIRRORED, TURNED, MOVED], ids=["mirrored", "turned", "moved"])
@pytest.mark.parametrize("side", [0, 1])
def test_shots_that_contradict_the_others_are_named(real_corners, side, change):
    found, sizes = real_corners
    assert contradiction(found, sizes) is None
    said = contradiction(changed(found, side, (2, 7), change), sizes)
    assert all(f"left-{n}.png and right-{n}.png" in said for n in ("03", "08")), said
    assert said.count("left-") == 2 and "the other 11 shots" in said


@needs_mrcal
def test_pairs_that_do_not_belong_together(real_corners, tmp_path):
    """The right pictures are one shot late: mrcal ran for minutes, and ended in a traceback."""
    found, sizes = real_corners
    late = boards.Boards(found.names, np.stack([found.q[0], np.roll(found.q[1], 1, 0)]), found.level)
    with pytest.raises(BadInput, match="the n-th right-\\* picture, sorted by name, must show the board at one moment"):
        board_calibration.solve(late, (9, 6), 0.025, sizes, "LENSMODEL_OPENCV4", tmp_path)


def test_one_shot_again_and_again(real_corners):
    found, sizes = real_corners
    same = boards.Boards(found.names, np.repeat(found.q[:, :1], 13, 1), found.level)
    with pytest.raises(BadInput, match="left: all 13 pictures with a board show it at one place"):
        contradiction(same, sizes)


@pytest.mark.parametrize("seed", range(6))
def test_sound_shots_pass(seed):
    """Distortion, a few shots or many, a right camera on its head."""
    random = np.random.default_rng(seed)
    rolled = [0, 0, np.pi, 0.3, 0, 0] if seed % 3 == 0 else None
    many = chessboards.poses(20, random, reach=0.5)
    made = chessboards.seen(many, chessboards.lens("left"), chessboards.lens("right", rolled), random, noise=0.2)
    assert contradiction(made) is None


@needs_mrcal
def test_what_only_looks_wrong_is_solved(tmp_path):
    """Small boards in noise, nearly parallel: a rough look says that they contradict each other, and mrcal does not."""
    random = np.random.default_rng(12)
    poses = chessboards.poses(12, random, distance=(2.0, 4.0), reach=0.4)
    made = chessboards.seen(poses, chessboards.lens("left"), chessboards.lens("right"), random, noise=0.5)
    assert solve(made, tmp_path, halves=False).models


# ---- what mrcal refuses ----


@pytest.fixture
def made_corners():
    random = np.random.default_rng(3)
    poses = chessboards.poses(8, random, reach=0.3, tilt=0.35)
    return chessboards.seen(poses, chessboards.lens("left"), chessboards.lens("right"), random)


def solve(found, folder, **options):
    return board_calibration.solve(found, (9, 6), chessboards.SQUARE, SIZES, "LENSMODEL_OPENCV4", folder, **options)


@needs_mrcal
def test_a_failure_of_mrcal_is_one_line(made_corners, tmp_path, monkeypatch):
    """Its words, without the folder in which it ran, and the way out."""

    def fails(argv, folder, told=None):
        raise RuntimeError("Exception: too many outliers")

    monkeypatch.setattr(mrcal_runner, "run", fails)
    with pytest.raises(BadInput, match="boards: mrcal cannot solve LENSMODEL_OPENCV4 .*too many outliers: more boards"):
        solve(made_corners, tmp_path)


@needs_mrcal
def test_a_solve_that_ran_away_is_none(made_corners, tmp_path, monkeypatch):
    """A focal length of -7419 px was told as a fault of a file under /tmp."""

    def runs_away(argv, folder, told=None):
        for side in (0, 1):
            numbers = "'extrinsics': [0., 0., 0., 0., 0., 0.], 'imagersize': [640, 480]"
            text = f"{{'lensmodel': 'LENSMODEL_PINHOLE', 'intrinsics': [-7419.75, 600., 320., 240.], {numbers}}}\n"
            (folder / f"camera0-{side}.cameramodel").write_text(text)
        return "## RMS error: 0.2\n"

    monkeypatch.setattr(mrcal_runner, "run", runs_away)
    with pytest.raises(BadInput) as bad:
        solve(made_corners, tmp_path, halves=False)
    assert "fx = -7419.75 is not positive" in str(bad.value) and str(tmp_path) not in str(bad.value)


@needs_mrcal
def test_what_cannot_be_computed_beside_a_calibration_keeps_it(made_corners, tmp_path):
    """mrcal's functions may refuse: the lenses and the pose stay, and the verdict says what is missing."""
    solution = solve(made_corners, tmp_path)
    broken = tmp_path / "broken.cameramodel"
    broken.write_text("no camera")
    halves = [(solution.models[0], broken)] * 2
    spoilt = board_calibration.Solution(solution.models, halves, solution.boards, SIZES, None)
    answer = calibration_answer.judge(spoilt, 1.0)
    assert answer["pair"]["baseline_m"] == pytest.approx(np.linalg.norm(chessboards.RT_RIGHT_LEFT[3:]), abs=2e-3)
    assert "mrcal cannot compute cross-validation: " in answer["verdict"] and answer["cameras"]["left"]["rms"] < 0.3
    without = board_calibration.Solution((broken, broken), [], solution.boards, SIZES, None)
    with pytest.raises(BadInput, match="boards: how far the result can be trusted is not known: mrcal: "):
        calibration_answer.judge(without, 1.0)


@pytest.mark.scene
@needs_mrcal
def test_a_camera_on_its_head(tmp_path):
    """Half a turn between the cameras, as if `Model 1 has been moved` (mrcal): a right sigma of the range, or none."""
    random = np.random.default_rng(3)
    right = chessboards.lens("right", [0.0, 0.0, np.pi, 0.3, 0.0, 0.0])
    poses = chessboards.poses(10, random, reach=0.3, tilt=0.35)
    solution = solve(chessboards.seen(poses, chessboards.lens("left"), right, random), tmp_path)
    answer = calibration_answer.judge(solution, 1.0)
    assert answer["pair"]["baseline_m"] == pytest.approx(0.3, abs=5e-4)
    assert answer["pair"]["range_sigma_m"] is not None or "mrcal cannot compute the range's sigma" in answer["verdict"]


def test_pictures_of_several_sizes(refuses, tmp_path, root):
    folder = tmp_path / "boards"
    folder.mkdir()
    for side in boards.SIDES:
        for n in ("01", "03"):
            shutil.copy(root / f"data/opencv-stereo13/boards/{side}-{n}.png", folder)
    grey = boards.grey8(folder / "left-03.png")
    image.write_png8(folder / "left-03.png", cv2.resize(grey, (320, 240), interpolation=cv2.INTER_AREA))
    lines = refuses(*calibrate(folder, tmp_path / "out", {"corners": [9, 6], "square_m": 0.025}))
    assert len(lines) == 1 and "left-03.png: size: 320 x 240 is not the 640 x 480 of left-01.png" in lines[0]
