"""Further photographs: where each was taken from, or a refusal with its figures.

Rooms, cameras and pictures: lib/synthetic/further_views.py. Truth is compared here alone.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from lib.core import record
from lib.given import cameras, image
from lib.given import model as models
from lib.given.cameras import Camera, intrinsics, matrix_from_rt, rt_from_matrix
from lib.given.image import Photograph
from lib.synthetic import further_views as views_
from lib.synthetic.optics import Lens
from lib.verdict import answers, records, vision_errors
from lib.verdict.page import further as page
from lib.vision.location import directions, features, files, likeness, positions, session
from lib.vision.location.locate import Taken, World
from lib.vision.refinement.edges import Edges, model_edges
from lib.vision.refinement.rig import Side, moved_px, project, rig_of

SIZE = (320, 240)
STAGE = "stages/locate.py"


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """(case, pictures, folder of a scene): the first camera is posed; a has a lens, b has nothing."""
    case = views_.further_views("location-1", size=SIZE, number=2)
    pictures = views_.photographs(case)
    folder = tmp_path_factory.mktemp("room")
    write(case, pictures, folder)
    return case, pictures, folder


def write(case, pictures, folder):
    recipe = case.recipe
    (folder / "photos").mkdir()
    (folder / "model.obj").write_text(recipe.model()[0])
    (folder / "scene.yaml").write_text(recipe.scene_yaml())
    image.write_png8(folder / "left.png", pictures[0])
    K = recipe.K
    first = Lens((K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    text = views_.camera_text(first, recipe.T_cam_world, recipe.size)
    (folder / "left.posed.cameramodel").write_text(text)
    for name, picture in zip("ab", pictures[1:], strict=True):
        image.write_png8(folder / "photos" / f"{name}.png", picture)
    lens_only = views_.camera_text(case.lenses[0], np.eye(4), recipe.size)
    (folder / "photos" / "a.cameramodel").write_text(lens_only)


def options(folder, out):
    given = {"model": "model.obj", "camera": "left.posed.cameramodel", "photograph": "left.png", "photos": "photos"}
    words = [word for name, file in given.items() for word in (f"--{name}", folder / file)]
    return [STAGE, *words, "--poses", out / "photos.json", "--report", out / "locate.report.json"]


def in_sigmas(T, T_true, covariance):
    """(degrees, mm of the centre, chi2 of the six numbers)."""
    e = rt_from_matrix(T_true @ np.linalg.inv(T))
    apart = np.linalg.norm(np.linalg.inv(T)[:3, 3] - np.linalg.inv(T_true)[:3, 3])
    return float(np.degrees(np.linalg.norm(e[:3]))), 1000 * float(apart), float(e @ np.linalg.solve(covariance, e))


# ---- the stage ----


@pytest.mark.scene
def test_a_known_lens_and_an_unknown_one(room, run, tmp_path):
    case, _, folder = room
    result = run(*options(folder, tmp_path))
    assert result.returncode == 0, result.stderr
    assert "a.png: posed, and not used for the materials yet" in result.stderr
    said = json.loads((tmp_path / "photos.json").read_text())["photographs"]
    for name, T_true, lens in zip("ab", case.poses, case.lenses, strict=True):
        one = said[name]
        assert one["status"] == "found" and one["why"] is None
        camera = cameras.read_cameramodel(tmp_path / "photos" / f"{name}.posed.cameramodel")
        degrees, mm, chi2 = in_sigmas(camera.T_cam_world, T_true, np.array(one["covariance"]))
        assert degrees < 0.1 and mm < 10 and chi2 < 25, (name, degrees, mm, chi2)
        off = camera.K[0, 0] - lens.K[0, 0]
        if name == "a":
            assert off == 0 and one["focal_sigma_px"] is None
        else:
            assert abs(off) < 3 * one["focal_sigma_px"] and abs(off) < 0.01 * lens.K[0, 0]
    shown = page.read(tmp_path / "photos.json", folder / "photos", models.load(folder / "model.obj"))
    html = page.further_section(shown, 320)
    assert "Further photographs" in html and "focal length" in html and html.count("<svg") == 2


@pytest.mark.scene
def test_another_room_is_refused_with_figures(room, run, tmp_path):
    """Of another room the photographs are left out, and the run ends well."""
    _, _, folder = room
    other = views_.further_views("location-2", size=SIZE, number=2)
    scene = tmp_path / "scene"
    scene.mkdir()
    write(other, views_.photographs(other), scene)
    for name in ("model.obj", "left.png", "left.posed.cameramodel"):
        (scene / name).write_bytes((folder / name).read_bytes())
    (scene / "photos" / "b.png").unlink()
    result = run(*options(scene, tmp_path))
    assert result.returncode == 0, result.stderr
    said = json.loads((tmp_path / "photos.json").read_text())["photographs"]
    one = said.pop("a")
    assert not said and one["status"] == "not found" and one["rt_cam_world"] is None and one["covariance"] is None
    assert "needed" in one["why"]
    assert result.stderr.count("pose: not found") == 1
    assert not list((tmp_path / "photos").iterdir())


@pytest.mark.scene
@pytest.mark.slow
def test_other_light_is_refused_unless_lamps_are_said_to_differ(tmp_path):
    """Every edge is there, but what is bright in one photograph is dark in the other.

    Of location-1 the second photograph alone is found on some machines and not on others, whatever its light: the last
    bits of its lines decide which four poses are refined.
    """
    case = views_.further_views("location-3", size=SIZE, number=2)
    pictures, folder = views_.photographs(case), tmp_path
    write(case, pictures, folder)
    model = models.load(folder / "model.obj")
    shot = lambda values: Photograph(values, 8, False, 3)
    first, negative = shot(pictures[0] / 255.0), shot(0.9 - 0.8 * pictures[1] / 255.0)
    left = Camera(case.recipe.K, *SIZE, case.recipe.T_cam_world)
    known = [session.known(model, "left", left, first, files.grey(first))]
    camera = Camera(case.lenses[0].K, *SIZE, np.eye(4))
    taken = Taken("x", negative, files.grey(negative), camera, True)
    place = session.locate_all(model, known, [taken])["x"]
    assert place.camera is None and place.likeness < 0 and "at the same places correlates by -0." in place.why
    place = session.locate_all(model, known, [taken._replace(other_lamps=True)])["x"]
    degrees, mm, _ = in_sigmas(place.camera.T_cam_world, case.poses[0], place.covariance)
    assert degrees < 0.2 and mm < 20


@pytest.mark.scene
@pytest.mark.slow
def test_a_given_pose_that_is_wrong_is_said_and_places_no_other(room, run, tmp_path):
    case, pictures, folder = room
    scene = tmp_path / "scene"
    scene.mkdir()
    write(case, pictures, scene)
    turned = matrix_from_rt([0, 0.15, 0, 0, 0, 0]) @ case.poses[1]
    (scene / "photos" / "b.posed.cameramodel").write_text(views_.camera_text(case.lenses[1], turned, SIZE))
    result = run(*options(scene, tmp_path))
    assert result.returncode == 0, result.stderr
    assert "b.png: pose: given, but the photograph shows" in result.stderr
    said = json.loads((tmp_path / "photos.json").read_text())["photographs"]
    assert said["b"]["status"] == "given" and said["b"]["edges_found"] < 0.5
    assert said["a"]["status"] == "found" and list(said["a"]["matches"]) == ["left"]


def test_what_the_stage_refuses(room, refuses, tmp_path):
    _, _, folder = room
    (tmp_path / "photos").mkdir()
    words = options(folder, tmp_path)
    words[words.index("--photos") + 1] = tmp_path / "photos"
    assert "there are no photographs in it" in refuses(*words)[0]
    (tmp_path / "photos" / "x.png").write_bytes(b"")
    assert "x.png: the file is empty" in refuses(*words)[0]
    assert not (tmp_path / "photos.json").exists()


def test_a_bent_lens_is_made_pinhole(room, tmp_path):
    case, pictures, _ = room
    image.write_png8(tmp_path / "x.png", pictures[1])
    bent = Lens(case.lenses[0].core, (0.05, 0, 0, 0, 0, 0, 0, 0))
    text = views_.cameramodel([*bent.core, *bent.k], np.eye(4), SIZE)
    (tmp_path / "x.cameramodel").write_text(text)
    picture = files.read(files.Further("x", tmp_path / "x.png", None, tmp_path / "x.cameramodel"))
    assert not picture.is_flat and not picture.is_posed
    assert np.abs(picture.photograph.values - pictures[1] / 255).max() > 0.05
    files.write(tmp_path / "photos.json", [picture], {"x": place_of(picture)}, {})
    made = image.read_photograph(tmp_path / "photos" / "x.pinhole.png")
    assert made.bits == 16 and np.allclose(made.values, np.clip(picture.photograph.values, 0, 1), atol=1e-5)


def place_of(picture):
    from lib.vision.location.locate import Place

    return Place(picture.name, picture.camera, "", np.eye(6))


# ---- rotations from straight edges ----


def lines_of(K, R, directions_, places):
    """(n, 2, 2) px of segments through places (n, 3), camera frame, along the world's directions (n, 3)."""
    d = directions_ @ R.T
    ends = np.stack([places - 0.4 * d, places + 0.4 * d], axis=1) @ K.T
    return ends[..., :2] / ends[..., 2:]


def box_and(direction):
    """Directions of a box and one more, unit."""
    return np.concatenate([np.eye(3), [np.asarray(direction) / np.linalg.norm(direction)]])


@pytest.mark.parametrize("each", [3, 1])
def test_rotation_from_straight_edges(each):
    """`each` 1: two edges of one direction, but of the others one each, so that nothing but they show them."""
    random = np.random.default_rng(each)
    K, R = intrinsics(300, 320, 240), matrix_from_rt([0.7, -0.5, 0.3, 0, 0, 0])[:3, :3]
    known = box_and([1, 2, 0])
    which = np.repeat([0, 1, 2, 3], each) if each > 1 else np.array([2, 2, 0, 1])
    places = random.uniform([-1, -0.7, 2.5], [1, 0.7, 4], (len(which), 3))
    turns = directions.rotations(known, lines_of(K, R, known[which], places), K)
    off = [np.degrees(np.arccos(np.clip((np.trace(t.R @ R.T) - 1) / 2, -1, 1))) for t in turns]
    assert min(off) < 0.1 and turns[int(np.argmin(off))].score > 0.99
    assert all(abs(np.linalg.det(turn.R) - 1) < 1e-9 for turn in turns)


def test_too_few_straight_edges():
    K = intrinsics(300, 320, 240)
    assert directions.rotations(np.eye(3), np.zeros((0, 2, 2)), K) == []
    assert directions.rotations(np.eye(3)[:1], np.ones((9, 2, 2)), K) == []


def test_directions_of_a_model_count_by_length():
    a = np.zeros((5, 3))
    b = np.array([[3.0, 0, 0], [-1, 0, 0], [0, 2, 0], [0, 0, 1], [0.001, 0.001, 0]])
    found = directions.of_model(Edges(a, b, np.full((5, 4), -1)))
    assert np.allclose(np.abs(found), np.eye(3))


# ---- places ----


def test_the_place_is_found_among_thousands(room):
    case, pictures, folder = room
    model = models.load(folder / "model.obj")
    K, T = case.recipe.K, case.recipe.T_cam_world
    left = Camera(K, *SIZE, T)
    world = World.of(model, [left])
    camera = Camera(case.lenses[0].K, *SIZE, np.eye(4))
    lines = np.array([q for q in map(np.array, visible_edges(model, replace(camera, T_cam_world=case.poses[0])))])
    turn = directions.Turn(case.poses[0][:3, :3], 1.0)
    best = positions.search(world.room, lines, camera, [turn])[0]
    apart = np.linalg.norm(np.linalg.inv(best.T)[:3, 3] - np.linalg.inv(case.poses[0])[:3, 3])
    assert apart < 0.1


def visible_edges(model, camera):
    """[(2, 2) px]: whole edges of the model that lie before the camera."""
    edges = model_edges(model)
    for a, b in zip(edges.a, edges.b, strict=True):
        q = camera.project(np.array([a, b]))
        if np.isfinite(q).all() and (np.abs(q) < 2000).all():
            yield q


# ---- features, likeness, the unknown focal length ----


def test_features_on_the_model_tell_pose_and_focal_length(room):
    case, _, folder = room
    model = models.load(folder / "model.obj")
    left = Camera(case.recipe.K, *SIZE, case.recipe.T_cam_world)
    other = Camera(case.lenses[1].K, *SIZE, case.poses[1])
    q = np.random.default_rng(0).uniform(0, SIZE, (60, 2))
    seen = features.on_model(model, left, q, q)
    assert np.allclose(left.project(seen.p), seen.q, atol=1e-6)
    seen = seen._replace(q=other.project(seen.p))
    there = np.isfinite(seen.q).all(axis=1)
    seen = features.Seen(seen.q[there], seen.p[there])
    guess = Camera(intrinsics(1.2 * SIZE[0], *SIZE), *SIZE, np.eye(4))
    found = features.absolute_pose(seen, guess, focal_known=False)
    assert abs(found.focal_px / other.K[0, 0] - 1) < 1e-3
    assert np.allclose(found.T, other.T_cam_world, atol=1e-3)
    assert features.agreeing(seen, features.posed(found, guess)) == there.sum()
    assert features.absolute_pose(features.Seen(seen.q[:5], seen.p[:5]), guess, True) is None


def test_likeness_knows_the_place_at_any_exposure(room):
    case, pictures, folder = room
    model = models.load(folder / "model.obj")
    shot = lambda picture: Photograph(picture / 255.0, 8, False, 3)
    known = [likeness.Known(model, Camera(case.recipe.K, *SIZE, case.recipe.T_cam_world), shot(pictures[0]))]
    camera = Camera(case.lenses[1].K, *SIZE, case.poses[1])
    aside = replace(camera, T_cam_world=matrix_from_rt([0, 0.2, 0, 0, 0, 0]) @ camera.T_cam_world)
    for factor in (1.0, 0.5):
        soft = likeness.blurred(shot(factor * pictures[2]))
        right, wrong = (likeness.likeness(model, known, soft, c) for c in (camera, aside))
        assert right > 0.95 and wrong < right - 0.05


def test_derivatives_by_the_focal_length():
    side = Side(Camera(intrinsics(300, 320, 240), 320, 240, np.eye(4)), None)
    rig, T = rig_of([side], 3.0, is_zoom=True), matrix_from_rt([0.1, -0.2, 0.05, 0.1, 0.2, 0.3])
    p = np.random.default_rng(1).uniform([-1, -1, 2], [1, 1, 4], (9, 3))
    _, J = project(rig, 0, T, 1.1, p, jacobian=True, free=True)
    h = 1e-6
    ahead, behind = (project(rig, 0, T, 1.1 * np.exp(s * h), p) for s in (1, -1))
    assert np.allclose(J[:, :, 6], (ahead - behind) / (2 * h), atol=1e-5)
    K = rig.cameras(T, 1.1)[0].K
    assert np.allclose(K, intrinsics(330, 320, 240)) and np.allclose(ahead, project(rig, 0, T, 1.1, p), atol=1e-2)
    assert moved_px(rig, (T, 1.1), T, 1.1) < 1e-9 and moved_px(rig, (T, 1.0), T, 1.1) > 10


def test_a_photograph_that_was_found_helps_the_next(room, monkeypatch):
    """What was not found is looked for again, but only beside a new one that shares features with it."""
    case, pictures, folder = room
    model = models.load(folder / "model.obj")
    asked = []

    def locate(world, taken, known):
        from lib.vision.location.locate import Place

        asked.append((taken.name, [one.name for one in known]))
        is_found = taken.name == "a" or len(known) > 1
        return Place(taken.name, Camera(taken.camera.K, *SIZE, case.poses[0]) if is_found else None, "far away")

    monkeypatch.setattr(session, "locate", locate)
    shot = lambda picture: Photograph(picture / 255.0, 8, False, 3)
    grey = lambda picture: files.grey(shot(picture))
    left = Camera(case.recipe.K, *SIZE, case.recipe.T_cam_world)
    known = [session.known(model, "left", left, shot(pictures[0]), grey(pictures[0]))]
    taken = [
        Taken(name, shot(p), grey(p), left, True) for name, p in zip("ba", (pictures[1], pictures[1]), strict=True)
    ]
    places = session.locate_all(model, known, taken)
    assert asked == [("b", ["left"]), ("a", ["left"]), ("b", ["left", "a"])]
    assert list(places) == ["b", "a"] and places["b"].camera is not None


def test_the_comparison_with_the_truth():
    """A pose 1 cm and .01 degrees off, one that is missing, one of another room that should not be there."""
    T = matrix_from_rt([0.1, 0.2, 0.3, 1, 2, 3])
    off = matrix_from_rt([np.radians(0.01), 0, 0, 0, 0, 0]) @ T
    off[:3, 3] += off[:3, :3] @ [0.01, 0, 0]
    one = lambda status, T=None, C=None: {
        "status": status,
        "rt_cam_world": None if T is None else rt_from_matrix(T).tolist(),
        "covariance": C,
    }
    C = np.diag([np.radians(0.01) ** 2] * 3 + [0.01**2] * 3).tolist()
    found = {"a": one("found", off, C), "b": one("not found"), "c": one("found", T, C), "d": one("given", T)}
    true = {"a": one("found", T), "b": one("found", T), "c": one("found"), "d": one("found", off)}
    found, true = (
        answers.Answers(poses=record.of({"photographs": each}, "photos.json", records.FurtherPhotographs))
        for each in (found, true)
    )
    errors = {name: value for stage, name, value, _ in vision_errors.against_truth(found, true) if stage == "locate"}
    assert errors["photos.missed"] == 1 and errors["photos.invented"] == 1
    assert abs(errors["photos.max_mm"] - 10) < 0.5 and abs(errors["photos.deg"] - 0.01) < 1e-6
    assert 0.3 < errors["photos.in_sigmas"] < 1
