"""Deviations of a scene's given files: each changes what it says, and nothing else."""

import filecmp
import json
from argparse import Namespace

import cv2
import numpy as np
import pytest

from lib.given import image
from lib.synthetic import deviations, given_scene, scene_files
from lib.synthetic.deviating_geometry import _covered
from lib.synthetic.deviating_photographs import tone_curve
from lib.synthetic.random_rooms import random_room
from lib.synthetic.sight import first_polygon

PHOTOGRAPHIC = {
    *(
        "vignetting",
        "colours",
        "srgb",
        "tone",
        "gamma",
        "exposure_dark",
        "exposure_bright",
        "jpeg",
        "noise_3",
        "noise_10",
        "bayer",
        "saturation",
        "phone",
    ),
    "12in16",
}
MODEL = {"objects", "lamp", "open", "open_room", "missing_object", "usemtl", "y_up", "millimetres", "flipped_lamp"}
MODEL |= {"objects_1cm", "objects_3cm", "lamps_3cm", "all_3cm", "half_modelled", "extra_object", "phone"}
CAMERA = {"pose", "half_pixel", "turned"}
FACTS = {"neutral_lamp", "lamp_power", "gamma", "exposure_dark", "exposure_bright"}
OBJ, MODEL_FILES = "model.obj", ("model.obj", "model.mtl")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The folder of a room as stages/synthesise.py --gather writes it; its light is a gradient."""
    folder, recipe = tmp_path_factory.mktemp("rooms") / "room", random_room(201, size=(400, 300))
    (folder / "truth").mkdir(parents=True)
    W, H = recipe.size
    B = np.linspace(0, 1.1, W)[None, :, None] * np.linspace(1, 0.2, H)[:, None, None] * np.array([1, 0.8, 0.6])
    for file, text in zip(MODEL_FILES, recipe.model(), strict=True):
        (folder / file).write_text(text)
    (folder / "scene.yaml").write_text(recipe.scene_yaml())
    (folder / "left.posed.cameramodel").write_text(recipe.cameramodel())
    image.write_png8(folder / "left.png", scene_files.displayed(recipe, B))
    image.write_exr(folder / "truth" / "linear.exr", B)
    pixels = dict.fromkeys(recipe.groups, 1000)
    (folder / "truth" / "materials.json").write_text(json.dumps(scene_files.true_materials(recipe, pixels)))
    return Namespace(folder=folder, recipe=recipe, given=given_scene.read(folder))


def deviated(scene, out, kind, seed=1):
    return deviations.deviate(scene.folder, out, kind, seed), given_scene.read(out)


def test_reading_is_the_recipe(scene):
    assert [(p.object, p.group) for p in scene.given.polygons] == [(p.object, p.group) for p in scene.recipe.polygons]
    for p, q in zip(scene.given.polygons, scene.recipe.polygons, strict=True):
        assert np.allclose(p.points, q.points, atol=1e-6)
    free = [n for n in ("crate", "stool", "case") if n in scene.recipe.objects]
    assert set(scene.given.free(1)) == set(free)


@pytest.mark.parametrize("kind", deviations.KINDS)
def test_only_what_it_says(scene, tmp_path, kind):
    said = deviations.deviate(scene.folder, tmp_path / "a", kind, 1)
    assert said["kind"] == kind and json.loads((tmp_path / "a" / "truth" / "deviation.json").read_text()) == json.loads(
        json.dumps(said)
    )
    files = {OBJ} if kind in MODEL else {"left.posed.cameramodel"} if kind in CAMERA else set()
    files |= {"scene.yaml"} if kind in FACTS else set()
    files |= {"left.png"} if kind in PHOTOGRAPHIC else set()
    changed = filecmp.dircmp(scene.folder, tmp_path / "a")
    assert set(changed.diff_files) | set(changed.left_only) == files
    assert set(changed.right_only) == ({"left.jpg"} if kind in ("jpeg", "phone") else set())
    truth = changed.subdirs["truth"]
    assert truth.right_only == ["deviation.json"] and not truth.diff_files and not truth.left_only
    # the same again, byte for byte; another seed draws another, where anything is drawn
    again = deviations.deviate(scene.folder, tmp_path / "b", kind, 1)
    assert again == said and not filecmp.dircmp(tmp_path / "a", tmp_path / "b").diff_files


@pytest.mark.parametrize("seed", range(6))
def test_pose(scene, tmp_path, seed):
    said, given = deviated(scene, tmp_path / "out", "pose", seed)
    p = scene.given.view()[1]
    q = given.camera.project(p) - scene.given.camera.project(p)
    assert np.sqrt((q**2).sum(1).mean()) == pytest.approx(2, rel=0.02) == said["rms_px"]
    eyes = given.eye - scene.given.eye
    assert 0 < np.linalg.norm(eyes) < 0.15


@pytest.mark.parametrize("seed", range(6))
def test_objects(scene, tmp_path, seed):
    said, given = deviated(scene, tmp_path / "out", "objects", seed)
    assert 1 <= len(said["offset_m"]) <= 3
    for p, q in zip(scene.given.polygons, given.polygons, strict=True):
        offset = np.array(said["offset_m"].get(p.object, (0, 0, 0)))
        assert np.allclose(q.points - p.points, offset, atol=2e-6)
    for offset in said["offset_m"].values():
        assert np.linalg.norm(offset) == pytest.approx(0.03) and offset[2] == 0


def test_every_object_moves_by_about_as_much(scene, tmp_path):
    lamps = set(scene.given.lamps)
    things = {p.object for p in scene.given.polygons if p.group not in lamps} - set(given_scene.ROOM)
    drawn = []
    for seed in range(8):
        said, _ = deviated(scene, tmp_path / str(seed), "objects_3cm", seed)
        assert set(said["offset_m"]) <= things
        drawn += [offset[:2] for offset in said["offset_m"].values()]
    assert len(drawn) > 6 * len(things)  # of 8; some stand too close to move
    assert np.std(drawn) == pytest.approx(0.03, rel=0.2)


@pytest.mark.parametrize("seed", range(4))
def test_lamp(scene, tmp_path, seed):
    said, given = deviated(scene, tmp_path / "out", "lamp", seed)
    assert np.linalg.norm(said["offset_m"]) == pytest.approx(0.12)
    walls = np.concatenate([p.points for p in given.polygons if p.object == "walls"])
    for p, q in zip(scene.given.polygons, given.polygons, strict=True):
        moves = np.array(said["offset_m"]) * (p.object == said["lamp"])
        assert np.allclose(q.points - p.points, moves, atol=2e-6)
        assert (q.points >= walls.min(0) - 1e-6).all() and (q.points <= walls.max(0) + 1e-6).all()


def test_open_objects(scene, tmp_path):
    """What is gone lies on others, no ray from the room meets it; bottoms are gone, lids are there."""
    said, given = deviated(scene, tmp_path / "out", "open")
    faces = [(p.object, tuple(np.round(p.points.mean(0), 4))) for p in given.polygons]
    gone = [p for p in scene.given.polygons if (p.object, tuple(np.round(p.points.mean(0), 4))) not in faces]
    assert len(gone) == len(said["faces"]) == len(scene.given.polygons) - len(given.polygons) >= 5
    assert any(p.object == "crate" and p.normal()[2] < -0.9 for p in gone)
    assert not any(p.object in (*given_scene.ROOM, *given.lamps) for p in gone)
    assert all(_covered(p, scene.given.polygons) for p in gone)
    shown = set(scene.given.view()[0])
    assert not any(p is scene.given.polygons[i] for p in gone for i in shown)


def test_open_room(scene, tmp_path):
    said, given = deviated(scene, tmp_path / "out", "open_room")
    assert len(given.polygons) == len(scene.given.polygons) - 1
    assert (given.view()[0] >= 0).all()  # the picture is the same
    behind = np.mean(said["wall"], 0)[None] - given.eye
    assert first_polygon(given.polygons, given.eye, behind)[1] == -1
    corners = np.array(said["wall"])
    inwards = np.cross(corners[1] - corners[0], corners[2] - corners[1])
    assert inwards @ given.camera.T_cam_world[2, :3] > 0


def test_frames_and_groups(scene, tmp_path):
    p = np.concatenate([q.points for q in scene.given.polygons])
    points = lambda given: np.concatenate([q.points for q in given.polygons])
    assert np.allclose(points(deviated(scene, tmp_path / "y", "y_up")[1])[:, 1], p[:, 2], atol=1e-6)
    assert np.allclose(points(deviated(scene, tmp_path / "mm", "millimetres")[1]), 1000 * p, atol=1e-3)
    flipped = deviated(scene, tmp_path / "f", "flipped_lamp")[1]
    assert all(q.normal()[2] > 0.9 for q in flipped.polygons if q.group in flipped.lamps)
    said, missing = deviated(scene, tmp_path / "m", "missing_object")
    assert said["object"] not in missing.objects() and len(missing.objects()) == len(scene.given.objects()) - 1
    said, given = deviated(scene, tmp_path / "u", "usemtl")
    (object,) = {q.object for p, q in zip(scene.given.polygons, given.polygons, strict=True) if p.group != q.group}
    assert object == said["object"] and {q.group for q in given.polygons if q.object == object} == {said["group"]}


def test_cameras(scene, tmp_path):
    K = deviated(scene, tmp_path / "h", "half_pixel")[1].camera.K - scene.given.camera.K
    assert np.allclose(np.abs(K[:2, 2]), 0.5) and np.allclose(K[:, :2], 0)
    ways = set()
    for seed in range(12):
        said, given = deviated(scene, tmp_path / str(seed), "turned", seed)
        turn = given.camera.T_cam_world[:3, :3] @ scene.given.camera.T_cam_world[:3, :3].T
        assert np.allclose(given.eye, scene.given.eye)
        assert turn[2, 2] == pytest.approx(-1 if said["way"] == "back" else 1, abs=0.35)
        ways.add(said["way"])
    assert ways == {"left", "right", "back"}


def test_photographs(scene, tmp_path):
    values = lambda kind, file="left.png": display(deviated_file(scene, tmp_path, kind, file))
    plain = display(scene.folder / "left.png")
    shaded = values("vignetting") ** scene.recipe.gamma / np.maximum(plain, 1e-3) ** scene.recipe.gamma
    assert np.median(shaded[140:160, 190:210]) == pytest.approx(1, abs=0.01)
    off_axis = np.hypot(180.5, 146.5) / np.hypot(199.5, 149.5) * np.tan(np.radians(37))
    assert shaded[3, 19, 0] == pytest.approx(np.cos(np.arctan(off_axis)) ** 4, rel=0.04)
    assert (values("noise_3") - plain)[50:250, 50:200].std() == pytest.approx(0.03, rel=0.05)
    assert np.abs(values("jpeg", "left.jpg") - plain).mean() < 0.01
    stored = cv2.imread(str(deviated_file(scene, tmp_path, "12in16", "left.png")), cv2.IMREAD_UNCHANGED)
    assert stored.max() == 4095 and np.allclose(values("12in16"), plain, atol=0.003)  # 4095 is taken for white
    assert np.abs(values("bayer") - plain)[2:-2, 2:-2].mean() < 0.02
    assert values("exposure_dark").mean() < plain.mean() < values("exposure_bright").mean()


def display(path):
    return image.read_photograph(path).values


def deviated_file(scene, folder, kind, file):
    deviations.deviate(scene.folder, folder / kind, kind, 1)
    return folder / kind / file


def test_another_gamma_at_another_exposure(scene, tmp_path):
    """What is said is what the photograph shows of the true light."""
    gammas, factors = [], set()
    for seed in range(1, 9):
        said, changed = deviated(scene, tmp_path / f"{seed}", "gamma", seed)
        shown = image.read_photograph(changed.folder / "left.png").display
        wanted = np.clip(said["factor"] * scene.given.B, 0, 1) ** (1 / said["gamma"])
        assert np.abs(shown - wanted).max() <= 0.501 / 255
        gammas.append(said["gamma"])
        factors.add(said["factor"])
    assert 1 <= min(gammas) < 1.7 and 2.2 < max(gammas) <= 2.8 and len(factors) == 3


def test_tone_curves():
    """Every kind is there; each rises from 0 to 1, and none is a gamma."""
    kinds, x = set(), np.linspace(0, 1, 2001) ** 2
    for seed in range(40):
        name, T = tone_curve(np.random.default_rng(seed))
        y = T(x)
        assert abs(y[0]) < 1e-9 and y[-1] == pytest.approx(1) and (np.diff(y) > 0).all(), name
        slope = np.log(y[400:1800]) / np.log(x[400:1800])
        assert np.ptp(slope) > 0.02, name
        kinds.add(name.split(",")[0])
    assert kinds == {"filmic", "logistic", "sine", "toe"}


def test_command(scene, tmp_path, run):
    done = run("-m", "lib.synthetic.deviations", scene.folder, tmp_path / "out", "lamp", "--seed", 3)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "out" / "truth" / "deviation.json").read_text())["seed"] == 3
