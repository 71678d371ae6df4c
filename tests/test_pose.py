"""The pose of one photograph as a person tells it: picked points and lines, or where the camera stands and looks."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lib.core.stage import BadInput
from lib.given import cameras, image, reduced
from lib.given import model as models
from lib.given import picks as picks_
from lib.given.cameras import Camera, matrix_from_rt
from lib.given.picks import Picks
from lib.planning import pipeline, scene, walk
from lib.vision import picked, picked_edges
from lib.vision.refinement.edges import model_edges, visible_samples

ROOT = Path(__file__).resolve().parents[1]
OFFICE = ROOT / "data/office"
SIZE = 640, 480
STAGES = pipeline.read_pipeline(ROOT / "pipeline.yaml")


def shot(rng, n, m=0, plane=False):
    """(Camera, q, p, ends, p_ends) of n points and m lines in depths of 2 to 6 m, 60 degrees wide."""
    W, H = SIZE
    K = cameras.intrinsics(W / 2 / np.tan(np.radians(30)), W, H)
    camera = Camera(K, W, H, matrix_from_rt([*rng.normal(size=3), *rng.normal(0, 2, 3)]))
    q = rng.uniform((0, 0), SIZE, (n + 2 * m, 2))
    away = camera.directions(q)
    depth = 4 / (away @ [0.4, 0.2, 1.0]) if plane else rng.uniform(2, 6, n + 2 * m)
    p = camera.centre + depth[:, None] * away @ camera.T_cam_world[:3, :3]
    return camera, q[:n], p[:n], q[n:].reshape(m, 2, 2), p[n:].reshape(m, 2, 3)


def picked_from(rng, seen, noise, wrong=0, sigma=None):
    camera, q, p, ends, p_ends = seen
    q, ends = q + rng.normal(0, noise, q.shape), ends + rng.normal(0, noise, ends.shape)
    q[:wrong] = rng.uniform((0, 0), SIZE, (wrong, 2))
    sigmas = np.full(len(q), sigma or noise), np.full(len(ends), sigma or noise)
    names = tuple(f"p{k}" for k in range(len(q))), tuple(f"l{k}" for k in range(len(ends)))
    return Picks(q, p, sigmas[0], names[0], ends, p_ends, sigmas[1], names[1])


def unknown(camera):
    size = camera.width, camera.height
    return Camera(cameras.intrinsics(1.2 * size[0], *size), *size, None)


def off(found, camera):
    """(rotation in bounds' units is the caller's; rad, the twist's Mahalanobis square, relative error of the focal
    length)"""
    back = camera.T_cam_world @ np.linalg.inv(found.camera.T_cam_world)
    twist = cameras.rt_from_matrix(back)
    square = twist @ np.linalg.solve(found.covariance, twist)
    return np.linalg.norm(twist[:3]), square, abs(found.camera.K[0, 0] / camera.K[0, 0] - 1)


@pytest.mark.parametrize("n, wrong, noise", [(100, 0, 1.0), (100, 50, 1.0), (8, 0, 2.0), (8, 1, 2.0)])
def test_points_reach_the_bound_of_the_right_ones(n, wrong, noise):
    """Cramer and Rao: sigma of the right points alone, focal length unknown; 40 trials each, 200 in `make bench`."""
    rng, turns, focals, named, inside = np.random.default_rng(11), [], [], [], []
    for _ in range(40):
        seen = shot(rng, n)
        picks = picked_from(rng, seen, noise, wrong)
        J = picked._Fit(picks, seen[0], False, seen[0].T_cam_world, 1.0).derivatives()[2 * wrong :] / noise
        bound = np.linalg.inv(J.T @ J)
        found = picked.solve(picks, unknown(seen[0]), focal_known=False)
        turn, square, focal = off(found, seen[0])
        turns.append(turn**2 / np.trace(bound[:3, :3]))
        focals.append(focal**2 / bound[6, 6])
        named.append(set(np.flatnonzero(found.outlier)) == set(range(wrong)))
        inside.append(square < 12.6)  # 95 % of chi-square of 6
    assert np.sqrt(np.mean(turns)) < 1.3 and np.sqrt(np.mean(focals)) < 1.3
    assert np.mean(named) >= 0.9 and np.mean(inside) >= 0.85


@pytest.mark.parametrize(
    "n, m, known",
    [
        pytest.param(0, 8, True, marks=pytest.mark.slow),
        pytest.param(0, 10, False, marks=pytest.mark.slow),
        (4, 4, False),
    ],
)
def test_lines_tell_as_well(n, m, known):
    rng = np.random.default_rng(5)
    for _ in range(3):
        seen = shot(rng, n, m)
        found = picked.solve(picked_from(rng, seen, 0.5), seen[0] if known else unknown(seen[0]), known)
        turn, square, _ = off(found, seen[0])
        assert square < 22 and turn < np.radians(2)


def test_a_plane_tells_the_pose_and_what_it_leaves_open():
    rng = np.random.default_rng(6)
    for _ in range(5):
        seen = shot(rng, 8, plane=True)
        found = picked.solve(picked_from(rng, seen, 0.5), seen[0], focal_known=True)
        assert off(found, seen[0])[1] < 22 or found.rivals


def test_corners_of_a_chessboard_from_a_file(tmp_path):
    """All on one plane, read from pose.csv: columns of its table ended in a traceback of OpenCV."""
    camera, *_ = shot(np.random.default_rng(7), 8)
    p = np.array([(0.1 * i, 0.1 * j, 0) for j in range(6) for i in range(9)]) - [0.4, 0.25, 0]
    board = replace(camera, T_cam_world=cameras.towards(np.array([0.5, -0.6, 1.0]), np.zeros(3), (0, 1, 0)))
    rows = [",".join(map(str, (*q, *at))) for q, at in zip(board.project(p), p, strict=True)]
    (tmp_path / "pose.csv").write_text("\n".join(["x_px,y_px,X,Y,Z", *rows]) + "\n")
    found = picked.solve(picks_.read(tmp_path / "pose.csv"), board, focal_known=True)
    assert np.abs(found.camera.T_cam_world - board.T_cam_world).max() < 1e-6


def test_noise_that_was_not_told_is_found():
    rng = np.random.default_rng(8)
    seen = shot(rng, 60)
    found = picked.solve(picked_from(rng, seen, 3.0, sigma=1.0), unknown(seen[0]), focal_known=False)
    assert found.factor == pytest.approx(3, abs=0.6)
    assert any("3." in text or "2." in text for text in picked.warnings(found, [""] * 60, focal_known=False))


def test_what_cannot_be_checked_is_said():
    rng = np.random.default_rng(9)
    seen = shot(rng, 5)
    found = picked.solve(picked_from(rng, seen, 0.3), unknown(seen[0]), focal_known=False)
    assert any("no check is possible" in text for text in picked.warnings(found, [""] * 5, focal_known=False))


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda q, p: (q[:3], p[:3]), "3 picked places: at least 4"),
        (lambda q, p: (q, np.outer(np.arange(12), [1.0, 2, 3])), "one straight line"),
        (lambda q, p: (q[::-1].copy(), p), "agree with any one camera"),
    ],
)
def test_places_that_tell_no_pose_are_refused(change, said):
    rng = np.random.default_rng(10)
    camera, q, p, ends, p_ends = shot(rng, 12)
    q, p = change(q, p)
    names, none = tuple(map(str, range(len(q)))), np.zeros(0)
    picks = Picks(q, p, np.ones(len(q)), names, ends, p_ends, none, ())
    with pytest.raises(BadInput, match=said):
        picked.solve(picks, camera, focal_known=True)


def test_a_pick_behind_the_camera_is_named():
    """A vertex of the wall at the photographer's back, taken for the one before him."""
    rng = np.random.default_rng(12)
    camera, q, p, ends, p_ends = shot(rng, 12)
    p[4] = 2 * camera.centre - p[4]
    found = picked.solve(picked_from(rng, (camera, q, p, ends, p_ends), 0.5), unknown(camera), focal_known=False)
    assert np.flatnonzero(found.outlier).tolist() == [4]
    (said,) = picked.warnings(found, [f"p{k}" for k in range(12)], focal_known=False)
    assert said == "p4: is behind the camera of the others: left out"


@pytest.mark.parametrize(
    "text, said",
    [
        ("", "holds nothing"),
        ("x,y,X,Y,Z\n1,2,3,4,5\n", "header"),
        ("x_px,y_px,X,Y,Z\n1,2,3,4\n", "line 2: '1,2,3,4' has 4 values"),
        ("x_px,y_px,X,Y,Z\n# a\n1,2,3,4,nan\n", "line 3: Z: 'nan'"),
        ("x_px,y_px,X,Y,Z,sigma_px\n1,2,3,4,5,0\n", "line 2: sigma_px: '0' is not positive"),
    ],
)
def test_files_that_will_not_do(tmp_path, text, said):
    (tmp_path / "pose.csv").write_text(text)
    with pytest.raises(BadInput, match=said):
        picks_.read(tmp_path / "pose.csv")


def test_a_byte_order_mark_and_windows_lines_are_read(tmp_path):
    (tmp_path / "pose.csv").write_bytes(b"\xef\xbb\xbfx_px,y_px,X,Y,Z,name\r\n1,2,3,4,5,door\r\n")
    found = picks_.read(tmp_path / "pose.csv")
    assert found.names == ("door",) and found.p.tolist() == [[3, 4, 5]]


def test_several_corners_of_one_thing_bear_its_name(tmp_path):
    (tmp_path / "pose.csv").write_text("x_px,y_px,X,Y,Z,name\n1,2,3,4,5,desk\n1,2,3,4,6,desk\n1,2,3,4,7,door\n")
    assert picks_.read(tmp_path / "pose.csv").names == ("desk, line 2", "desk, line 3", "door")


def test_the_stage_poses_a_photograph(tmp_path):
    """office by twelve vertices, one of them 40 px off: it is named, and the camera is right within its sigma."""
    camera, model = cameras.read_cameramodel(OFFICE / "left.posed.cameramodel"), models.load(OFFICE / "model.obj")
    q = camera.project(model.vertices)
    inside = np.flatnonzero(np.isfinite(q).all(axis=1) & (q > 5).all(axis=1) & (q < np.subtract(SIZE, 5)).all(axis=1))
    some = np.random.default_rng(3).choice(inside, 12, replace=False)
    noisy = q[some] + np.random.default_rng(4).normal(0, 0.7, (12, 2))
    noisy[3] += 40
    rows = [f"{x:.2f},{y:.2f},{X},{Y},{Z}" for (x, y), (X, Y, Z) in zip(noisy, model.vertices[some], strict=True)]
    (tmp_path / "pose.csv").write_text("\n".join(["x_px,y_px,X,Y,Z", *rows]) + "\n")
    names = {"photograph": OFFICE / "left.png", "points": tmp_path / "pose.csv"}
    out = {"posed": tmp_path / "left.posed.cameramodel", "pose": tmp_path / "pose.json"}
    words = [f"--{name}={path}" for name, path in {**names, **out, "report": tmp_path / "r.json"}.items()]
    done = subprocess.run([sys.executable, ROOT / "stages/pose.py", *words], capture_output=True, text=True)
    assert done.returncode == 0 and "line 5: is" in done.stderr
    found = json.loads(out["pose"].read_text())
    assert [k for k, one in enumerate(found["residuals"]) if one["outlier"]] == [3]
    assert abs(found["focal_px"] - camera.K[0, 0]) < 3 * found["focal_sigma_px"]
    back = camera.T_cam_world @ np.linalg.inv(cameras.read_cameramodel(out["posed"]).T_cam_world)
    twist = cameras.rt_from_matrix(back)
    assert twist @ np.linalg.solve(np.array(found["covariance"]), twist) < 22


def office_by_picks(seed, number, noise):
    """(Camera of office, Picks of so many of its visible corners, the model)."""
    camera, model = cameras.read_cameramodel(OFFICE / "left.posed.cameramodel"), models.load(OFFICE / "model.obj")
    rng, s = np.random.default_rng(seed), visible_samples(model, model_edges(model), camera, 1, step_px=4.0)
    chosen = rng.choice(len(s.q), number, replace=False)
    one = np.full(number, noise)
    q = s.q[chosen] + rng.normal(0, noise, (number, 2))
    none = np.zeros((0, 2, 2))
    names = tuple(map(str, range(number)))
    return camera, Picks(q, s.p[chosen], one, names, none, np.zeros((0, 2, 3)), np.zeros(0), ()), model


@pytest.mark.parametrize("seed", range(4))
def test_edges_refine_what_was_picked(seed):
    """Eight places at 1.5 px, focal length unknown: the edges bring the pose ten times nearer, within its sigma."""
    camera, told, model = office_by_picks(seed, 8, 1.5)
    first = picked.solve(told, unknown(camera), focal_known=False)
    found, trace, why = picked_edges.refined(first, told, model, image.read_photograph(OFFICE / "left.png"), False)
    off = lambda one: np.linalg.norm(one.camera.centre - camera.centre)
    assert not why and off(found) < max(0.3 * off(first), 0.003), (off(first), off(found))
    assert abs(found.camera.K[0, 0] - camera.K[0, 0]) < 3 * found.focal_sigma_px
    twist = cameras.rt_from_matrix(camera.T_cam_world @ np.linalg.inv(found.camera.T_cam_world))
    assert twist @ np.linalg.solve(found.covariance, twist) < 22 and len(trace) > 1


def test_edges_of_a_large_photograph_are_sought_in_a_smaller_one(monkeypatch):
    """Nine times as many pixels, as soft as a telephone's: the same pose, in the pixels of the large photograph."""
    camera, told, model = office_by_picks(3, 8, 1.5)
    seen = image.read_photograph(OFFICE / "left.png")
    wide = replace(seen, values=cv2.resize(seen.values, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC))
    larger = replace(camera, K=reduced.whole(camera.K, 3), width=3 * camera.width, height=3 * camera.height)
    picks_there = replace(told, q=reduced.place(told.q, 1 / 3), sigma=3 * told.sigma)
    first = picked.solve(told, unknown(camera), focal_known=False)
    there = picked.solve(picks_there, unknown(larger), focal_known=False)
    monkeypatch.setattr(picked_edges, "MEGAPIXELS", 0.4)
    small, wide = (
        picked_edges.refined(start, picks_, model, picture, False)[0]
        for start, picks_, picture in ((first, told, seen), (there, picks_there, wide))
    )
    assert np.linalg.norm(wide.camera.centre - small.camera.centre) < 0.003
    assert wide.camera.K[0, 0] / 3 == pytest.approx(small.camera.K[0, 0], rel=2e-3)
    assert wide.camera.K[0, 2] == larger.K[0, 2] and wide.camera.width == larger.width
    assert wide.focal_sigma_px / 3 == pytest.approx(small.focal_sigma_px, rel=0.5)


def test_edges_that_are_not_there_refine_nothing():
    """Another photograph: the pose stays as it was picked, and that is said."""
    camera, told, model = office_by_picks(1, 8, 1.5)
    first = picked.solve(told, unknown(camera), focal_known=False)
    other = image.read_photograph(ROOT / "data/gallery-white/left.png")
    found, trace, why = picked_edges.refined(first, told, model, other, False)
    assert found is first and trace == [] and "not refined on them" in why


MISREAD = {
    "x_px and y_px are swapped": lambda x, y: (y, x),
    "y_px is counted from the bottom": lambda x, y: (x, SIZE[1] - 1 - y),
    "the picture was 2 times smaller": lambda x, y: (x / 2, y / 2),
    "the picture was 3 times larger": lambda x, y: (3 * x, 3 * y),
    "the picture was turned by a quarter the other way": lambda x, y: (SIZE[1] - 1 - y, x),
    "if the picture was turned by a quarter": lambda x, y: (y, SIZE[0] - 1 - x),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("words", MISREAD)
def test_picks_that_were_misread_are_told_how(seed, words):
    """Whether they agree with some camera or not, the reading under which all do is named; right ones are not asked."""
    camera, told, _ = office_by_picks(seed, 9, 1.0)
    x, y = told.q.T
    wrong = replace(told, q=np.stack(MISREAD[words](x, y), axis=1))
    line = picked.misread(wrong, unknown(camera), focal_known=False)
    assert line and line.split(", or ")[0].endswith(words)
    right = picked.solve(told, unknown(camera), focal_known=False)
    assert picked.misread(told, unknown(camera), focal_known=False, than=right) is None


def test_a_refusal_says_how_picks_may_be_meant():
    camera, told, _ = office_by_picks(2, 9, 1.0)
    wrong = replace(told, q=told.q * [1, -1] + [0, SIZE[1] - 1])
    with pytest.raises(BadInput, match="all 9 points would agree with one camera if y_px is counted from the bottom"):
        picked.solve(wrong, unknown(camera), focal_known=False)


def planned(tmp_path, facts="", **files):
    """The plan of office without its camera, with more in scene.yaml and other files."""
    folder = tmp_path / "attic"
    shutil.copytree(OFFICE, folder, ignore=shutil.ignore_patterns("left.posed.cameramodel", "truth"))
    for name, text in files.items():
        (folder / name.replace("__", "-").replace("_csv", ".csv")).write_text(text)
    with open(folder / "scene.yaml", "a") as yaml:
        yaml.write(f"\n{facts}\n")
    found = scene.read(folder, STAGES)
    if found.problems:
        return found.problems
    return walk.walk(found, STAGES, tmp_path / "build").planned


LOOK = "camera: {eye: [4, 1, 1.6], at: [1, 3, 1], hfov_deg: 60}"


def test_scenes_that_tell_a_pose_run_no_stereo_stage(tmp_path):
    assert planned(tmp_path / "a", LOOK)[0] == "pose" and "recognise" not in planned(tmp_path / "b", LOOK)
    assert planned(tmp_path / "c", pose_csv="x_px,y_px,X,Y,Z\n")[:2] == ["pose", "edges"]


@pytest.mark.parametrize(
    "facts, said",
    [
        (LOOK, "camera of scene.yaml and pose.csv with pose-lines.csv: only one of them may tell"),
        ("camera: {eye: [1, 1, 1], at: [1, 1, 1], hfov_deg: 60}", "camera.at: [1, 1, 1] is where the eye is"),
        ("camera: {eye: [1, 1, 1], at: [1, 1, 2], hfov_deg: 60}", "camera.up: [0, 0, 1] lies along the view"),
        ("camera: {eye: [1, 1, 1], at: [1, 2, 2], hfov_deg: 180}", "camera.hfov_deg: 180 is not an angle"),
        ("camera: {eye: [1, 1], at: [1, 2, 2]}", "camera.hfov_deg: is missing"),
        ("camera: {eye: [1, 1, 1], at: [1, 2, 2], fov: 3, hfov_deg: 60}", "camera.fov: 3 is an unknown key"),
    ],
)
def test_what_tells_no_pose_or_two_is_refused(tmp_path, facts, said):
    files = {"pose_csv": "x_px,y_px,X,Y,Z\n", "pose__lines_csv": "x1_px\n"} if facts == LOOK else {}
    assert any(said in problem for problem in planned(tmp_path, facts, **files))
