"""The synthetic scenes: what is committed is what the recipes say, and its noise is within the stated bounds.  No Mitsuba here."""
import functools
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from lib import cameras, image, model, recipes

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "data"
scenes = pytest.mark.parametrize("name", recipes.NAMES)
pairs = pytest.mark.parametrize("name", recipes.STEREO_NAMES)
made = functools.cache(recipes.make)


def truth(name, file):
    return json.loads((DATA / name / "truth" / file).read_text())


@scenes
def test_recipes_are_deterministic(name):
    a, b = recipes.make(name), recipes.make(name)
    assert a.model() == b.model() and a.cameramodel() == b.cameramodel() and a.scene_yaml() == b.scene_yaml()
    assert a.materials == b.materials and a.lamps == b.lamps and a.gamma == b.gamma


@scenes
def test_committed_files_are_the_recipe(name):
    recipe = recipes.make(name)
    obj, mtl = recipe.model()
    for file, text in (("model.obj", obj), ("model.mtl", mtl), ("left.posed.cameramodel", recipe.cameramodel()), ("scene.yaml", recipe.scene_yaml())):
        assert (DATA / name / file).read_text() == text, file


@scenes
def test_truth_is_the_recipe(name):
    recipe, materials, legend = recipes.make(name), truth(name, "materials.json"), truth(name, "legend.json")
    assert legend["groups"] == list(recipe.groups) and legend["objects"] == list(recipe.objects)
    assert list(materials["groups"]) == [g for g in recipe.groups if g not in recipe.lamps]
    labels = image.read_labels(DATA / name / "truth" / "group.png")
    for k, group in enumerate(recipe.groups):
        if group not in recipe.lamps:
            assert materials["groups"][group]["rho_d"] == list(recipe.materials[group])
            assert materials["groups"][group]["pixels"] == (labels == k + 1).sum()
    assert {g: tuple(v["emittance"]) for g, v in materials["lamps"].items()} == recipe.lamps
    assert materials["transfer"].get("gamma") == recipe.gamma


@scenes
def test_nothing_a_stage_must_not_know(name):
    facts = yaml.safe_load((DATA / name / "scene.yaml").read_text())
    assert set(facts) <= {"lamps", "reference"}


@scenes
def test_model(name):
    """Polygons are planar and convex, the reader agrees with the recipe and has nothing to complain about, lamps shine down."""
    recipe = recipes.make(name)
    for p in recipe.polygons:
        edges = np.roll(p.points, -1, 0) - p.points
        turns = np.cross(edges, np.roll(edges, -1, 0))
        n = turns.sum(0) / np.linalg.norm(turns.sum(0))
        assert (turns @ n > 0).all() and np.abs((p.points - p.points[0]) @ n).max() < 1e-6
        if p.group in recipe.lamps:
            assert n[2] < -0.999
    m = model.load(DATA / name / "model.obj")
    assert m.groups == recipe.groups and m.objects == recipe.objects and m.warnings == ()
    if name != "cornell":           # the ceiling's four quads are one facet there
        assert len(m.facet_group) == len(recipe.polygons)
    solid = dict(zip(m.objects, m.solid_objects()))
    assert not solid["floor"] and any(solid.values())


@scenes
def test_camera(name):
    recipe = recipes.make(name)
    camera = cameras.read_cameramodel(DATA / name / "left.posed.cameramodel")
    assert np.allclose(camera.T_cam_world, recipe.T_cam_world, atol=1e-12) and np.allclose(camera.K, recipe.K, atol=1e-12)
    assert (camera.width, camera.height) == recipe.size
    assert np.linalg.det(recipe.T_cam_world[:3, :3]) == pytest.approx(1, abs=1e-12)
    p = np.concatenate([q.points for q in recipe.polygons])
    p = p[p @ recipe.T_cam_world[2, :3] + recipe.T_cam_world[2, 3] > 0.1]
    assert np.allclose(camera.project(p), recipe.project(p), atol=1e-9)


def seen(recipe, q):
    """Group index + 1 of the nearest polygon at pixel q, or 0: the slow clear way."""
    R, t = recipe.T_cam_world[:3, :3], recipe.T_cam_world[:3, 3]
    eye, d = -R.T @ t, R.T @ np.linalg.solve(recipe.K, [*q, 1.0])
    best, group = np.inf, 0
    for p in recipe.polygons:
        edges = np.roll(p.points, -1, 0) - p.points
        n = np.cross(edges, np.roll(edges, -1, 0)).sum(0)
        if n @ d == 0:
            continue
        s = n @ (p.points[0] - eye) / (n @ d)
        if 1e-9 < s < best and (np.cross(edges, eye + s * d - p.points) @ n >= 0).all():
            best, group = s, recipe.groups.index(p.group) + 1
    return group


@scenes
def test_group_picture_is_what_the_camera_sees(name):
    """Mitsuba's rays against polygons intersected here, at 300 pixels; the border of a group may go either way."""
    recipe = recipes.make(name)
    labels = image.read_labels(DATA / name / "truth" / "group.png")
    W, H = recipe.size
    assert labels.shape == (H, W)
    random = np.random.default_rng(3)
    wrong = 0
    for x, y in zip(random.integers(1, W - 1, 300), random.integers(1, H - 1, 300)):
        here = labels[y - 1:y + 2, x - 1:x + 2]
        if (here == here[1, 1]).all():
            wrong += seen(recipe, (x, y)) != here[1, 1]
    assert wrong == 0


@scenes
def test_photograph(name):
    """The right size and kind; lamps saturate, and nearly nothing else does."""
    recipe = recipes.make(name)
    photograph = image.read_photograph(DATA / name / ("left.exr" if recipe.gamma is None else "left.png"))
    assert photograph.values.shape == (recipe.size[1], recipe.size[0], recipe.channels)
    assert photograph.linear == (recipe.gamma is None) and photograph.channels_in_file == recipe.channels
    labels = image.read_labels(DATA / name / "truth" / "group.png")
    is_lamp = np.isin(labels, [recipe.groups.index(g) + 1 for g in recipe.lamps])
    if recipe.gamma is None:
        inner = is_lamp & (photograph.values.min(-1) > 0.98 * min(min(E) for E in recipe.lamps.values()))
        assert inner.sum() > 0.7 * is_lamp.sum()
    else:
        assert np.median(photograph.values[is_lamp]) == 1
        # office-2 was left as its seed made it: a carton's top and a bar of the frame clip, 0.7 % of the picture
        assert (photograph.values[~is_lamp].max(-1) >= 1).mean() < (0.01 if name == "office-2" else 0.003)
    assert sum(f.stat().st_size for f in (DATA / name).rglob("*") if f.is_file()) < 1.9e6


@scenes
def test_noise(name):
    """Stated in issue and contract: every group mean of 500 pixels or more under 0.1 %, the median pixel under 2.5 %."""
    noise, legend = truth(name, "noise.json"), truth(name, "legend.json")
    labels = image.read_labels(DATA / name / "truth" / "group.png")
    assert noise["passes"] >= 8 and noise["spp"] == noise["passes"] * noise["spp_per_pass"]
    assert 0.002 < max(noise["median_pixel"]) < 0.025
    lamps = recipes.make(name).lamps
    large = {g for k, g in enumerate(legend["groups"]) if (labels == k + 1).sum() >= 500 and g not in lamps}
    assert set(noise["groups"]) == large and large
    for group in noise["groups"].values():
        assert group["passes"] >= 8 and 0 < max(group["noise"]) < 0.001


def test_office_has_what_makes_an_office_hard():
    """Three small groups, a group lit only indirectly, things in contact."""
    recipe = recipes.make("office")
    pixels = {g: v["pixels"] for g, v in truth("office", "materials.json")["groups"].items()}
    assert len(pixels) >= 12 and min(pixels.values()) >= 600
    assert sum(n < 2000 for n in pixels.values()) == 3
    # what the camera sees of the partition lies on the other side of its plane than the whole lamp
    plane = next(p for p in recipe.polygons if p.group == "partition").points
    n = np.cross(plane[1] - plane[0], plane[2] - plane[0])
    eye = np.linalg.inv(recipe.T_cam_world)[:3, 3]
    lamp = next(p for p in recipe.polygons if p.group == "lamp").points
    assert (np.sign((lamp - plane[0]) @ n) == -np.sign((eye - plane[0]) @ n)).all()


def test_gallery_is_white():
    rho = np.array(list(recipes.make("gallery-white").materials.values()))
    assert rho.min() >= 0.70 and rho.max() <= 0.90


def test_seeds_differ():
    made = [recipes.office(seed) for seed in range(4)]
    assert len({r.gamma for r in made}) == 4 and all(1.6 <= r.gamma <= 2.6 for r in made)
    assert len({str(r.lamps) for r in made}) == 4 and len({r.cameramodel() for r in made}) == 4
    assert len({str(r.materials) for r in made}) == 4
    assert any(abs(r.K[0, 2] - 319.5) > 5 for r in made)


@pytest.mark.parametrize("name", recipes.NAMES)
def test_nothing_is_black(name):
    assert min(min(rho) for rho in recipes.make(name).materials.values()) >= 0.03


def test_cornell_channels():
    """The recipe's rounded numbers are colour-science's integrals of the measured spectra."""
    pytest.importorskip("colour")
    channels = recipes.cornell_channels()
    for group, rho in recipes.CORNELL.items():
        assert channels[group] == pytest.approx(rho, abs=6e-5)
    assert channels["light"] == pytest.approx(recipes.CORNELL_LAMP, abs=6e-5)


def test_cornell_geometry():
    """By hand: the lamp is 130 x 105 mm and closes the ceiling's hole, the ceiling 556 x 559.2 mm."""
    def area(p):
        e = p.points - p.points[0]
        return np.linalg.norm(np.cross(e[1:-1], e[2:]).sum(0)) / 2
    recipe = recipes.make("cornell")
    lamp = sum(area(p) for p in recipe.polygons if p.group == "light")
    assert lamp == pytest.approx(.130 * .105, rel=1e-9)
    assert lamp + sum(area(p) for p in recipe.polygons if p.object == "ceiling") == pytest.approx(.556 * .5592, rel=1e-9)
    assert recipe.reference == {"light": (.78, .78, .78)}


# ---- stereo scenes ----

def test_every_pair_is_there():
    assert all((DATA / n / "origin.md").exists() for n in recipes.STEREO_NAMES)


@pairs
def test_committed_files_of_a_pair_are_the_recipe(name):
    recipe = made(name)
    obj, mtl = recipe.model()
    files = {"model.obj": obj, "model.mtl": mtl, "scene.yaml": recipe.scene_yaml()} | recipe.pair_files()
    for file, text in files.items():
        assert (DATA / name / file).read_text() == text, file
    materials = truth(name, "materials.json")
    assert {g: tuple(v["rho_d"]) for g, v in materials["groups"].items()} == {g: tuple(recipe.materials[g]) for g in recipe.groups if g not in recipe.lamps}
    assert materials["transfer"]["gamma"] == recipe.gamma
    assert truth(name, "legend.json")["groups"] == list(recipe.groups)
    if recipe.pair.board:
        T = [cameras.matrix_from_rt(rt) for rt in truth(name, "boards.json")["rt_left_board"]]
        assert np.allclose(T, recipe.pair.board.T_left_board, atol=1e-9)


@pairs
def test_nothing_a_pair_must_not_know(name):
    """The photographer knows lamps and board; neither pose nor transfer lies in the folder, lenses only where there are no boards."""
    files = {p.name for p in (DATA / name).iterdir()}
    boards = made(name).pair.board is not None
    assert set(yaml.safe_load((DATA / name / "scene.yaml").read_text())) == ({"lamps", "board"} if boards else {"lamps"})
    assert files == {"scene.yaml", "origin.md", "model.obj", "model.mtl", "left.png", "right.png", "truth"} | ({"boards"} if boards else {"left.cameramodel", "right.cameramodel"})


@pairs
def test_rooms_of_a_pair(name):
    """About three times what is seen; facets as the recipe has them; no two rooms alike; light cannot pass from one to another."""
    recipe = made(name)
    m = model.load(DATA / name / "model.obj")
    assert m.warnings == () and len(m.facet_group) == len(recipe.polygons)
    rooms = {}
    for p in recipe.polygons:
        rooms.setdefault(p.object.split("-")[0], []).append(p)
    assert len(rooms) == 3 and 2.5 < len(recipe.polygons) / len(rooms[recipe.pair.room[:-1]]) < 3.5
    spans = []
    for polygons in rooms.values():
        p = np.concatenate([q.points for q in polygons])
        floor = next(q.points for q in polygons if q.object.endswith("-floor"))
        along = (floor[1] - floor[0]) / np.linalg.norm(floor[1] - floor[0])
        axis = spans[0][0] if spans else along
        spans.append((axis, (p @ axis).min(), (p @ axis).max()))
    ordered = sorted(s[1:] for s in spans)
    assert all(a[1] + 0.19 < b[0] for a, b in zip(ordered, ordered[1:]))
    sizes = [sorted(np.round([np.linalg.norm(np.ptp(q.points, axis=0)) for q in polygons if q.group == "blackboard"], 3)) for polygons in rooms.values()]
    assert len({tuple(s) for s in sizes}) == 3
    assert np.linalg.norm(np.linalg.inv(recipe.T_cam_world)[:3, 3]) > 3          # the model's frame is not the camera's


@pairs
def test_lenses_of_a_pair(name):
    """The recipe's projection is the independent one of lib/lenses, and there and back again is exact; axes 5 to 10 degrees apart."""
    from lib import lenses
    recipe = made(name)
    W, H = recipe.size
    q = np.random.default_rng(1).uniform((0, 0), (W - 1, H - 1), (500, 2))
    T = {}
    for (side, (lens, T_cam_world)), sign in zip(recipe.views().items(), (1, -1)):
        other = lenses.read(DATA / name / "truth" / f"{side}.cameramodel")
        x, y = lens.unproject(*q.T)
        p = np.column_stack([x, y, np.ones(len(x))])
        assert np.abs(lens.project(p) - q).max() < 1e-9 and np.abs(other.project(p) - q).max() < 1e-9
        T[side] = other.T_cam_ref
        posed = cameras.read_cameramodel(DATA / name / "truth" / f"{side}.posed.cameramodel")
        assert np.allclose(posed.T_cam_world, T_cam_world, atol=1e-9) and np.allclose(posed.K, other.K)
    relative = T["right"] @ np.linalg.inv(T["left"])
    assert np.allclose(relative, recipe.pair.T_right_left, atol=1e-9)
    assert 5 < np.degrees(np.arccos(relative[2, 2])) < 10 and relative[0, 3] < 0


@pairs
def test_photographs_of_a_pair(name):
    """Few pixels clip, noise is what is stated, and what the pixel shows is where the lens puts it: edges of the group picture."""
    recipe, noise = made(name), truth(name, "noise.json")
    assert noise["sensor"] == recipe.pair.noise and all(0 < max(v) < 0.013 for v in noise["median_pixel"].values())
    for side in ("left", "right"):
        photograph = image.read_photograph(DATA / name / f"{side}.png")
        assert photograph.values.shape == (recipe.size[1], recipe.size[0], recipe.channels)
        assert (photograph.values.max(-1) >= 1).mean() < 0.006
        # second differences along rows: their median size is the noise's, sqrt(6) sigma 0.6745
        d = photograph.values[:, 2:] - 2 * photograph.values[:, 1:-1] + photograph.values[:, :-2]
        sigma = np.median(np.abs(d)) / np.sqrt(6) / 0.6745
        expected = np.hypot(recipe.pair.noise, np.median(noise["median_pixel"][side]))
        assert 0.8 * expected < sigma < 1.25 * expected
    labels = image.read_labels(DATA / name / "truth" / "group.png")
    pixels = truth(name, "materials.json")["groups"]
    assert all(v["pixels"] == (labels == recipe.groups.index(g) + 1).sum() for g, v in pixels.items())
    assert sum(v["pixels"] >= 500 for v in pixels.values()) >= 12 and any(v["pixels"] == 0 for v in pixels.values())
    random, wrong, W, H = np.random.default_rng(3), 0, *recipe.size
    for x, y in zip(random.integers(1, W - 1, 150), random.integers(1, H - 1, 150)):
        here = labels[y - 1:y + 2, x - 1:x + 2]
        if (here == here[1, 1]).all():
            wrong += seen(recipe, (x, y)) != here[1, 1]
    assert wrong == 0


@pairs
def test_photograph_is_seen_through_the_lens(name):
    """The borders of the true groups, put through the lens, lie on the photograph's edges: its gradient there is less wherever they are shifted by 2 px."""
    recipe = made(name)
    labels = image.read_labels(DATA / name / "truth" / "group.png")
    photograph = image.read_photograph(DATA / name / "left.png").values.mean(-1)
    gradient = np.hypot(*np.gradient(photograph))
    y, x = np.nonzero(labels[:, 1:] != labels[:, :-1])
    q = np.column_stack([x + 0.5, y, np.ones(len(x))])
    q = recipe.pair.lenses[0].project(q @ np.linalg.inv(recipe.K).T)
    W, H = recipe.size
    q = q[(q > 3).all(1) & (q < (W - 4, H - 4)).all(1)]

    def strength(dx, dy):
        at = np.rint(q + (dx, dy)).astype(int)
        return gradient[at[:, 1], at[:, 0]].mean()

    assert all(strength(*d) < strength(0, 0) for d in ((2, 0), (-2, 0), (0, 2), (0, -2)))
    assert strength(2, 0) < 0.6 * strength(0, 0) > strength(-2, 0)


@pytest.mark.parametrize("name", [n for n in recipes.STEREO_NAMES if (DATA / n / "boards").exists()])
def test_boards_of_a_pair(name):
    """The detector finds the boards where truth puts them, on average within a twentieth of a pixel: no half pixel has crept in."""
    import cv2
    recipe = made(name)
    board, rms, offsets = recipe.pair.board, [], []
    assert 12 <= len(board.T_left_board) <= 20
    for n in (0, 3, 7, 12, 15):
        for side, lens, V in zip(("left", "right"), recipe.pair.lenses, (np.eye(4), recipe.pair.T_right_left)):
            M = V @ board.T_left_board[n]
            p = board.points() @ M[:3, :3].T + M[:3, 3]
            found, corners = cv2.findChessboardCornersSB(cv2.imread(str(DATA / name / "boards" / f"{side}-{n:02d}.png"), 0), board.corners, flags=cv2.CALIB_CB_ACCURACY)
            if found:
                e = min((c - lens.project(p) for c in (corners.reshape(-1, 2), corners.reshape(-1, 2)[::-1])), key=np.linalg.norm)     # it may begin at the other end
                rms.append(np.sqrt((e ** 2).mean()))
                offsets.append(e.mean(0))
    assert len(rms) >= 7 and np.median(rms) < 0.15 and np.abs(np.mean(offsets, 0)).max() < 0.05
    normals = np.array([T[:3, 2] for T in board.T_left_board])
    assert np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1))).max() > 60
    assert sum(f.stat().st_size for f in (DATA / name).rglob("*") if f.is_file()) < 7e6


def test_executable():
    """--help needs nothing; an unknown scene is one line and status 2."""
    stage = str(ROOT / "stages" / "synthesise.py")
    assert subprocess.run([sys.executable, "-S", "-I", stage, "--help"], capture_output=True).returncode == 0
    bad = subprocess.run([sys.executable, stage, "--scene", "attic", "--out", "never"], capture_output=True, text=True)
    assert bad.returncode == 2 and "attic" in bad.stderr and bad.stderr.count("\n") == 1
    assert not Path("never").exists()
