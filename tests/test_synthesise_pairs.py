"""The synthetic stereo scenes: what is committed is what the recipes say, seen through their lenses."""

import itertools

import cv2
import numpy as np
import pytest
import yaml

from lib.given import cameras, image, lenses, model
from lib.synthetic import recipes
from tests.helpers.made_scenes import DATA, made, same_text, truth, wrong_labels

pairs = pytest.mark.parametrize("name", recipes.STEREO_NAMES)


def test_every_pair_is_there():
    assert all((DATA / n / "origin.md").exists() for n in recipes.STEREO_NAMES)


@pairs
@pytest.mark.scene
def test_committed_files_of_a_pair_are_the_recipe(name):
    recipe = made(name)
    obj, mtl = recipe.model()
    files = {"model.obj": obj, "model.mtl": mtl, "scene.yaml": recipe.scene_yaml()} | recipe.pair_files()
    for file, text in files.items():
        assert same_text((DATA / name / file).read_text(), text), file
    materials = truth(name, "materials.json")
    assert {g: tuple(v["rho_d"]) for g, v in materials["groups"].items()} == {
        g: tuple(recipe.materials[g]) for g in recipe.groups if g not in recipe.lamps
    }
    assert materials["transfer"]["gamma"] == recipe.gamma
    assert truth(name, "legend.json")["groups"] == list(recipe.groups)
    if recipe.pair.board:
        T = [cameras.matrix_from_rt(rt) for rt in truth(name, "boards.json")["rt_left_board"]]
        assert np.allclose(T, recipe.pair.board.T_left_board, atol=1e-9)


@pairs
def test_nothing_a_pair_must_not_know(name):
    """The photographer knows lamps and board.

    Neither pose nor transfer lies in the folder, and lenses only where there are no boards.
    """
    files = {p.name for p in (DATA / name).iterdir()}
    boards = made(name).pair.board is not None
    assert set(yaml.safe_load((DATA / name / "scene.yaml").read_text())) == (
        {"lamps", "board"} if boards else {"lamps"}
    )
    assert files == {"scene.yaml", "origin.md", "model.obj", "model.mtl", "left.png", "right.png", "truth"} | (
        {"boards"} if boards else {"left.cameramodel", "right.cameramodel"}
    )


@pairs
def test_rooms_of_a_pair(name):
    """The model has about three times what is seen, and facets as the recipe has them.

    No two rooms are alike, and light cannot pass from one to another.
    """
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
    assert all(a[1] + 0.19 < b[0] for a, b in itertools.pairwise(ordered))
    sizes = [
        sorted(np.round([np.linalg.norm(np.ptp(q.points, axis=0)) for q in polygons if q.group == "blackboard"], 3))
        for polygons in rooms.values()
    ]
    assert len({tuple(s) for s in sizes}) == 3
    assert np.linalg.norm(np.linalg.inv(recipe.T_cam_world)[:3, 3]) > 3  # the model's frame is not the camera's


@pairs
def test_lenses_of_a_pair(name):
    """The recipe's projection is the independent one of lib/given/lenses.py, and there and back again is exact.

    The axes are 5 to 10 degrees apart.
    """

    recipe = made(name)
    W, H = recipe.size
    q = np.random.default_rng(1).uniform((0, 0), (W - 1, H - 1), (500, 2))
    T = {}
    for side, (lens, T_cam_world) in recipe.views().items():
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


@pytest.mark.outside
@pairs
def test_photographs_of_a_pair(name):
    """Few pixels clip, and the noise is what is stated.

    What a pixel shows is where the lens puts it: edges of the group picture.
    """
    recipe, noise = made(name), truth(name, "noise.json")
    assert noise["sensor"] == recipe.pair.noise and all(0 < max(v) < 0.009 for v in noise["median_pixel"].values())
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
    assert wrong_labels(recipe, labels, 150) == 0


@pairs
def test_photograph_is_seen_through_the_lens(name):
    """The borders of the true groups, put through the lens, lie on the photograph's edges.

    Its gradient there is less wherever they are shifted by 2 px.
    """
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
    """The detector finds the boards where truth puts them, on average within a twentieth of a pixel.

    So no half pixel has crept in.
    """

    recipe = made(name)
    board, rms, offsets = recipe.pair.board, [], []
    assert 12 <= len(board.T_left_board) <= 20
    for n in (0, 3, 7, 12, 15):
        for side, lens in zip(("left", "right"), recipe.pair.lenses, strict=True):
            M = board.T_left_board[n] if side == "left" else recipe.pair.T_right_left @ board.T_left_board[n]
            p = board.points() @ M[:3, :3].T + M[:3, 3]
            found, corners = cv2.findChessboardCornersSB(
                cv2.imread(str(DATA / name / "boards" / f"{side}-{n:02d}.png"), 0),
                board.corners,
                flags=cv2.CALIB_CB_ACCURACY,
            )
            if found:
                e = min(
                    (c - lens.project(p) for c in (corners.reshape(-1, 2), corners.reshape(-1, 2)[::-1])),
                    key=np.linalg.norm,
                )  # it may begin at the other end
                rms.append(np.sqrt((e**2).mean()))
                offsets.append(e.mean(0))
    assert len(rms) >= 7 and np.median(rms) < 0.15 and np.abs(np.mean(offsets, 0)).max() < 0.05
    normals = np.array([T[:3, 2] for T in board.T_left_board])
    assert np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1))).max() > 60
    assert sum(f.stat().st_size for f in (DATA / name).rglob("*") if f.is_file()) < 7e6
