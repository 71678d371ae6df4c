"""Movable objects: found where they stand, absent ones said to be absent, dimensions of the model checked.

Rooms, their pictures and the truth: lib/synthetic/displaced_pairs.py, seeds that nothing was tuned on.
"""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import lib.vision.objects.place as place_
from lib.given import model as models
from lib.given.cameras import Camera, matrix_from_rt, rt_from_matrix
from lib.given.image import read_photograph, write_png8
from lib.given.model import glb_writer, parts
from lib.synthetic import displaced_pairs
from lib.verdict.vision_errors import object_error
from lib.vision.objects import search, words
from lib.vision.objects.dimensions import Size
from lib.vision.objects.fit import Support
from lib.vision.objects.place import in_world, place
from lib.vision.objects.scenery import Scenery
from lib.vision.refinement.rig import Side

SIZE = 640, 480


def box(name, at, size, group=None):
    """The text of a closed box, its vertices counted from the file's end."""
    x, y, z = at
    corners = [(x + a * size, y + b * size, z + c * size) for c in (0, 1) for b in (0, 1) for a in (0, 1)]
    faces = ((1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6))
    lines = [f"o {name}", *(f"v {a} {b} {c}" for a, b, c in corners), f"usemtl {group or name}"]
    return "\n".join(lines + ["f " + " ".join(str(i - 9) for i in face) for face in faces]) + "\n"


@pytest.fixture
def boxes(tmp_path):
    path = tmp_path / "model.obj"
    path.write_text("".join(box(n, (k, 0, 0), 0.5) for k, n in enumerate("abc")))
    return models.load(path)


# ---- models ----


def test_a_model_without_and_with_an_object_again(boxes):
    rest = parts.without(boxes, ["b"])
    assert rest.objects == rest.groups == ("a", "c") and rest.n_facets == 12
    again = parts.joined(rest, "b", parts.only(boxes, ["b"]))
    assert again.objects == ("a", "c", "b") and again.n_facets == 18
    of = lambda m, name: np.sort(
        m.corners()[m.facet_object[m.triangle_facet] == m.objects.index(name)].reshape(-1, 9), 0
    )
    for name in "abc":
        np.testing.assert_array_equal(of(again, name), of(boxes, name))
    n, d = again.facet_normal[again.triangle_facet], again.facet_offset[again.triangle_facet]
    np.testing.assert_allclose(np.einsum("tcj,tj->tc", again.corners(), n), np.repeat(d[:, None], 3, 1), atol=1e-12)


def test_absent_objects_keep_names_and_numbers_in_the_file(boxes, tmp_path):
    T = matrix_from_rt([0, 0, 0.3, 0.1, 0.2, 0])
    posed = Scenery(boxes, {0: None, 2: T}).posed()
    glb_writer.write_glb(tmp_path / "posed.glb", posed)
    read = models.load(tmp_path / "posed.glb")
    assert (read.objects, read.groups) == (boxes.objects, boxes.groups)
    np.testing.assert_array_equal(read.facet_object, boxes.facet_object)
    np.testing.assert_array_equal(read.facet_group, boxes.facet_group)
    assert set(read.triangle_facet) == set(range(6, 18)) and len(read.triangles) == 24
    there = read.facet_object > 0
    np.testing.assert_allclose(read.facet_normal[there], posed.facet_normal[there], atol=1e-6)
    moved = np.unique(read.corners()[read.facet_object[read.triangle_facet] == 2].reshape(-1, 3).round(5), axis=0)
    drawn = Scenery(boxes).points(2) @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(moved, np.unique(drawn.round(5), axis=0), atol=2e-5)


# ---- laws ----


def test_steps_on_a_support_keep_to_it_and_others_leave_it():
    random = np.random.default_rng(3)
    left = matrix_from_rt(random.normal(size=6))
    normal = random.normal(size=3)
    normal /= np.linalg.norm(normal)
    support, p = Support(normal, random.normal(size=3)), random.normal(size=(5, 3))
    held, off = support.basis(left), support.across(left)
    assert np.linalg.matrix_rank(np.column_stack([held, off])) == 6
    for numbers in random.normal(size=(4, 3)):
        step = np.linalg.inv(left) @ matrix_from_rt(held @ numbers) @ left  # of the world
        np.testing.assert_allclose((p @ step[:3, :3].T + step[:3, 3] - p) @ normal, 0, atol=1e-12)
    for column in off.T:
        step = np.linalg.inv(left) @ matrix_from_rt(1e-3 * column) @ left
        assert np.abs((p @ step[:3, :3].T + step[:3, 3] - p) @ normal).max() > 1e-4


def test_a_covariance_along_the_cameras_axes_is_turned_into_the_worlds():
    """By difference: the same small motion, written in both."""
    random = np.random.default_rng(4)
    left, T, A = (
        matrix_from_rt(random.normal(size=6)),
        matrix_from_rt(random.normal(size=6)),
        random.normal(size=(6, 6)),
    )
    C, steps = A @ A.T, []
    for step in 1e-6 * np.linalg.cholesky(C).T:
        moved = np.linalg.inv(left) @ matrix_from_rt(step) @ left @ T
        steps.append(rt_from_matrix(moved @ np.linalg.inv(T)) / 1e-6)
    np.testing.assert_allclose(in_world(left, C, None), np.transpose(steps) @ steps, rtol=1e-3, atol=1e-3)


def test_the_grid_turns_about_the_middle_and_slides_on_the_support():
    n = np.array([0.0, 0.6, 0.8])
    poses = search.grid(np.eye(4), np.array([1.0, 2, 3]), n, 0.1, 0.3, 0.2, 2)
    middles = poses[:, :3, :3] @ [1, 2, 3] + poses[:, :3, 3]
    np.testing.assert_allclose((middles - [1, 2, 3]) @ n, 0, atol=1e-12)
    assert np.linalg.norm(middles - [1, 2, 3], axis=1).max() < 0.36 and len(poses) % 5 == 0
    np.testing.assert_allclose(poses[:, :3, :3] @ n, np.tile(n, (len(poses), 1)), atol=1e-12)


def test_words():
    assert words.text(Size("desk", 0.02, 0.0018, (0, 0, 1), 2)) == "desk: is 2.0 cm higher than the model, 11 sigma"
    assert "1.5 cm shorter along [1.00, 0.00, 0.00]" in words.text(Size("desk", -0.015, 0.001, (1, 0, 0), 2))


# ---- rooms ----


def sides(case, tmp_path):
    out = []
    views = case.recipe.views()
    for (side, (lens, T)), picture in zip(views.items(), displaced_pairs.photographs(case), strict=True):
        write_png8(tmp_path / f"{side}.png", picture)
        out.append(Side(Camera(lens.K, *case.recipe.size, T), read_photograph(tmp_path / f"{side}.png")))
    return out


def given(case, tmp_path):
    (tmp_path / "given.obj").write_text(displaced_pairs.given_model(case))
    return models.load(tmp_path / "given.obj")


@pytest.mark.scene
def test_displaced_and_absent_objects(tmp_path):
    """A static one that stands aside is said, and stays."""
    case = displaced_pairs.displaced_pair("objects-1", 0.03, size=SIZE)
    views, model = sides(case, tmp_path), given(case, tmp_path)
    first, second = case.moves
    result = place(model, views, [first, *case.absent])
    by_name = {p.name: p for p in result.placed}
    right(by_name[first], case.moves[first], parts.only(result.model, [first]))
    assert by_name[case.absent[0]].found is False and by_name[case.absent[0]].T is None
    assert [p.name for p in result.aside] == [second] and "refine" in " ".join(words.warnings(result))
    assert result.model.objects == model.objects and result.model.n_facets == model.n_facets


@pytest.mark.slow
def test_objects_that_are_moved_where_it_is_asked_for(tmp_path):
    """In the model, and one as a file of its own, in a frame of its own."""
    case = displaced_pairs.displaced_pair("objects-1", 0.03, size=SIZE)
    views, model = sides(case, tmp_path), given(case, tmp_path)
    first, second = case.moves
    refined = place(parts.without(model, case.absent), views, [first], refine=True, fixed=case.recipe.lamps)
    assert [p.name for p in refined.placed] == [first, second]
    right(refined.placed[1], case.moves[second], parts.only(refined.model, [second]))

    U = matrix_from_rt([0, 0, 0.8, 3.0, -2.0, 1.0])
    own = Scenery(parts.only(model, [first]), {0: U}).posed()
    result = place(parts.without(model, [first, *case.absent]), views, [], {"thing": own})
    right(result.placed[0], case.moves[first] @ np.linalg.inv(U), parts.only(result.model, ["thing"]))


def right(placed, T_true, thing):
    mm, deg, sigmas = object_error(placed.T, T_true, placed.covariance, thing)
    assert placed.found is True and mm < 3 and deg < 0.5 and sigmas < 2, (mm, deg, sigmas)


@pytest.mark.scene
def test_a_wrong_height_is_said_and_right_ones_are_not(tmp_path):
    case = displaced_pairs.displaced_pair("objects-2", 0.0, size=SIZE, taller_m=0.02)
    result = place(given(case, tmp_path), sides(case, tmp_path), [], refine=True, fixed=case.recipe.lamps)
    ((name, by_m),) = case.taller.items()
    (size,) = result.sizes
    assert (size.name, np.abs(size.axis).tolist()) == (name, [0, 0, 1]) and abs(size.by_m - by_m) < 0.002
    assert abs(size.by_m - by_m) < 4 * size.sigma_m


@pytest.mark.slow
def test_the_stage_from_outside(tmp_path, run, refuses):
    case = displaced_pairs.displaced_pair("objects-3", 0.1, size=SIZE)
    displaced_pairs.write(case, tmp_path, displaced_pairs.photographs(case))
    truth, out = tmp_path / "truth", tmp_path / "out"
    out.mkdir()
    options = {
        "model": tmp_path / "model.obj",
        "camera": truth / "left.posed.cameramodel",
        "photograph": tmp_path / "left.png",
        "camera-right": truth / "right.posed.cameramodel",
        "photograph-right": tmp_path / "right.png",
        "movable": json.dumps([*case.moves, *case.absent]),
        "posed-model": out / "model.posed.glb",
        "pose": out / "pose.json",
        "report": out / "place.report.json",
    }
    argv = lambda **more: [w for k, v in {**options, **more}.items() for w in (f"--{k}", str(v))]
    (line,) = refuses("stages/place.py", *argv(movable='["nobody"]'))
    assert "movable: 'nobody' names no object" in line
    (line,) = refuses("stages/place.py", *argv(refine='["pose"]'))
    assert "only objects can be refined" in line
    assert not list(out.iterdir())
    result = run("stages/place.py", *argv())
    assert result.returncode == 0, result.stderr
    pose = json.loads((out / "pose.json").read_text())
    model = models.load(out / "model.posed.glb")
    for name, T in case.moves.items():
        entry = pose["objects"][name]
        mm, deg, _ = object_error(matrix_from_rt(entry["rt_world_object"]), T, None, parts.only(model, [name]))
        assert entry["found"] is True and mm < 3 and deg < 0.5
    gone = {"rt_world_object": None, "covariance": None, "found": False}
    assert [pose["objects"][name] for name in case.absent] == [gone]
    assert Path(out / "place.report.json").exists()


def test_what_is_seen_where_it_is_drawn_stays_there(monkeypatch):
    """Two right objects of path-traced rooms were moved by 2.4 and 2.7 cm along the line of sight."""
    job, scenery = SimpleNamespace(photographs=None), None
    monkeypatch.setattr(place_, "evidence", lambda *_: (0.86, 0.05, 18.6, 43))
    monkeypatch.setattr(place_, "fitted", lambda *_: pytest.fail("it is looked for elsewhere"))
    assert place_._elsewhere(job, scenery, 0) is None


def test_few_edges_that_are_found_are_no_absence():
    """The bin of `office` by one photograph: 85 % of 46 samples, 9.9 nats. It was said to be absent, and left out."""
    fit = lambda support, nats: SimpleNamespace(support=support, nats=nats, covariance=np.eye(6))
    assert place_._says(fit(0.85, 9.9)) is None and place_._says(fit(0.6, 30.0)) is None
    assert place_._says(fit(0.9, 24.0)) is True
    assert place_._says(fit(0.3, 30.0)) is False and place_._says(None) is False
