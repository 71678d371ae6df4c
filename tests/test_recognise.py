"""Recognition (§2.4): the closed form by hand, random rooms by law, extremes, photographs, the stage from outside."""

import json
import time
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from lib.core.stage import BadInput
from lib.given import cameras, image
from lib.given import model as models
from lib.given.cameras import Camera
from lib.vision import facets_file
from lib.vision.facets_file import SceneFacets
from lib.vision.recognition import closed_form, rotations, search, symmetry
from lib.vision.recognition import recognise as recognition
from lib.vision.recognition.hashing_kernels import Correspondences
from lib.vision.refinement import pose as refinement
from lib.vision.refinement import rig as rig_
from tests.helpers import facet_trials as trials
from tests.helpers import rooms
from tests.helpers.boxes import BOX, Objects, box, look


def right(pose, camera):
    turn, move = trials.pose_error(pose.T, camera)
    return turn < 1.5 and move < 0.15


# The linear step.


def planes_of(T, q=1.0):
    """Six planes of a box seen from inside by T, exactly."""
    n = np.concatenate([np.eye(3), -np.eye(3)])
    offset = np.array([0.0, 0, 0, -5, -4, -3])  # n . x = offset, fronts inwards
    n_cam, d = n @ T[:3, :3].T, offset + n @ T[:3, :3].T @ T[:3, 3]
    m = n_cam * (q / d)[:, None]
    return m, n, offset, m / (m * m).sum(axis=1)[:, None]


@pytest.mark.parametrize("q", [1.0, 0.37])
def test_closed_form_is_exact_on_exact_planes(q):
    T = cameras.matrix_from_rt([0.3, -0.8, 0.4, 0, 0, 0])
    T[:3, 3] = -T[:3, :3] @ [2.0, 1.5, 1.2]
    m, n, offset, g = planes_of(T, q)
    found, scale = closed_form.closed_form(
        m, np.repeat(1e-6 * np.eye(3)[None], 6, axis=0), n, offset, g, scale_free=q != 1
    )
    np.testing.assert_allclose(found, T, atol=1e-9)
    assert scale == pytest.approx(q, abs=1e-9)


def test_kabsch_never_reflects():
    a = np.eye(3)
    R = rotations.kabsch(a, a * [1, 1, -1], np.ones(3))
    assert np.linalg.det(R) == pytest.approx(1)


# The search.


def test_a_sure_facet_holds_where_it_holds_somewhere_in_the_box():
    """Two facets on planes x = 0, known to 1 mm and to 10 cm; the middle of the box lies 2 cm beside them."""
    height = np.array([0.001, 0.1])
    reach = np.column_stack([height, np.full((2, 2), 1.0)])
    zero = np.zeros((2, 3))
    pairs = Correspondences(np.arange(2), np.array([7, 8]), np.stack([np.eye(3)] * 2), reach, -reach, zero, zero)
    at = lambda resolution: search._matches(pairs, np.arange(2), np.array([0.02, 0, 0]), 1.0, resolution).tolist()
    assert at(0.0) == [[1, 8]]
    assert at(0.03) == [[0, 7], [1, 8]]


@pytest.mark.scene
@pytest.mark.parametrize("count", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_random_rooms(tmp_path, capsys, count):
    """Three furnished rooms, one of them seen; half of the facets spurious, most of the others partial.

    No wrong answer, and 95 % answered. Other poses are named only where they explain as many facets, or one less,
    within their covariance.
    """
    status, spent, far = {}, [], []
    recognition.warm_up()
    for seed in range(count):
        random, _, model, camera = trials.room_trial(seed, tmp_path)
        facets, truth = trials.facets_seen(random, model, camera)
        begin = time.process_time()
        found = recognition.recognise(facets, model, camera)
        spent.append(time.process_time() - begin)
        status[found.status] = status.get(found.status, 0) + 1
        if found.status == "unique":
            assert right(found.poses[0], camera), seed
            wrong = [i for i, f in found.poses[0].matches if truth[i] < 0]
            assert len(wrong) <= 1, seed  # a spurious facet may lie on a wall
            gap = cameras.rt_from_matrix(camera.T_cam_world @ np.linalg.inv(found.poses[0].T))
            far.append(gap @ np.linalg.solve(found.poses[0].covariance, gap))
        if found.status == "ambiguous":
            best = found.poses[0]
            for pose in found.poses[1:]:
                assert len(pose.matches) >= len(best.matches) - 1 and pose.chi2 <= 2 * closed_form.GATE * len(
                    pose.matches
                ), seed
    with capsys.disabled():
        print(f"\n{count} rooms: {status}, CPU {np.mean(spent):.2f} s a trial, at most {np.max(spent):.2f} s")
    # so many searches were complete, too: one that gives up after its cells is unproved
    assert status["unique"] >= 0.95 * count
    assert np.mean(np.array(far) < chi2.ppf(0.95, 6)) >= 0.90  # the covariance is honest


@pytest.mark.scene
def test_a_symmetric_room_is_ambiguous(tmp_path):
    """A bare box looks the same after half a turn. At least two of the poses bring it onto itself, one is the truth."""
    box = np.array([[x, y, z] for x in (0, 5) for y in (0, 4) for z in (0, 2.8)])
    for seed in range(4):
        random, _, model, camera = trials.room_trial(seed, tmp_path, 1, symmetric=True)
        facets, _ = trials.facets_seen(random, model, camera)
        found = recognition.recognise(facets, model, camera)
        assert found.status == "ambiguous"
        assert any(right(pose, camera) for pose in found.poses)
        explained = 0
        for pose in found.poses:
            D = np.linalg.inv(camera.T_cam_world) @ pose.T
            moved = box @ D[:3, :3].T + D[:3, 3]
            explained += np.linalg.norm(moved[:, None] - box[None], axis=2).min(axis=1).max() < 0.4
        assert explained >= 2


@pytest.mark.scene
@pytest.mark.parametrize("seed", [0, 3, 7, 8])
def test_a_left_handed_model_is_not_recognised(tmp_path, seed):
    random, things, model, camera = trials.room_trial(seed, tmp_path)
    facets, _ = trials.facets_seen(random, model, camera)
    mirrored = {
        name: [(group, (np.array(p) * [1, -1, 1])[::-1]) for group, p in polygons] for name, polygons in things.items()
    }
    found = recognition.recognise(facets, models.load(rooms.write(tmp_path / "mirrored.obj", mirrored)), camera)
    assert found.status in ("unproved", "not recognised")
    assert all(np.linalg.det(pose.T[:3, :3]) == pytest.approx(1) for pose in found.poses)


def test_a_model_ten_times_larger(tmp_path):
    for seed in (0, 2):
        random, _, model, camera = trials.room_trial(seed, tmp_path, 10)
        facets, _ = trials.facets_seen(random, model, camera)
        found = recognition.recognise(facets, model, camera)
        assert found.status == "unique" and right(found.poses[0], camera)


def test_far_from_the_origin(tmp_path):
    random, things, model, camera = trials.room_trial(2, tmp_path)
    facets, _ = trials.facets_seen(random, model, camera)
    offset = np.array([1e6, 2e6, -5e5])
    away = {name: [(group, np.array(p) + offset) for group, p in polygons] for name, polygons in things.items()}
    near, far = (
        recognition.recognise(facets, m, camera).poses[0]
        for m in (model, models.load(rooms.write(tmp_path / "far.obj", away)))
    )
    T = far.T.copy()
    T[:3, 3] += T[:3, :3] @ offset
    np.testing.assert_allclose(T, near.T, atol=1e-4)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_unit_of_length_does_not_matter(tmp_path, factor):
    """A doll's house and a hangar: the same rotation, translations times the factor; linear step and refinement."""
    random, things, model, camera = trials.room_trial(4, tmp_path)
    facets, _ = trials.facets_seen(random, model, camera)
    large = models.load(rooms.write(tmp_path / "large.obj", things, scale=factor))
    other = SceneFacets(
        facets.m / factor, facets.covariance / factor**2, [factor * p for p in facets.polygons], facets.labels
    )
    shot = trials.photograph(random, model, camera)
    side = rig_.Side(Camera(camera.K, camera.width, camera.height, np.eye(4)), shot)
    results = []
    for f, m, k in ((facets, model, 1), (other, large, factor)):
        found = recognition.recognise(f, m, camera)
        refined = refinement.refine(m, [side], found).cameras[0].T_cam_world.copy()
        T = found.poses[0].T.copy()
        for pose in (T, refined):
            pose[:3, 3] /= k
        results.append((found.status, T, refined))
    assert results[0][0] == results[1][0] == "unique"
    np.testing.assert_allclose(results[1][1], results[0][1], atol=1e-3)
    np.testing.assert_allclose(results[1][2], results[0][2], atol=1e-4)


@pytest.mark.scene
def test_unknown_scale(tmp_path):
    """Lengths in baselines: the model gives the scale, and the poses are in metres."""
    for seed in (0, 3):
        random, _, model, camera = trials.room_trial(seed, tmp_path)
        facets, _ = trials.facets_seen(random, model, camera, unit="baseline", baseline=0.3)
        found = recognition.recognise(facets, model, camera)
        assert found.status == "unique" and right(found.poses[0], camera)
        assert found.poses[0].scale == pytest.approx(0.3, rel=0.01)


def test_too_little_is_said_to_be_too_little(tmp_path):
    random, _, model, camera = trials.room_trial(0, tmp_path)
    facets, _ = trials.facets_seen(random, model, camera, spurious=0)
    part = lambda keep: SceneFacets(
        facets.m[keep], facets.covariance[keep], [facets.polygons[k] for k in keep], facets.labels[keep]
    )
    for keep in ([], [0], [0, 1]):
        found = recognition.recognise(part(keep), model, camera)
        assert found.status == "not recognised" and "at least 3" in found.why
    n = facets.normal
    parallel = np.flatnonzero(np.abs(n @ n[0]) > 0.99)
    same = part(np.resize(parallel, 4))
    assert "can slide" in recognition.recognise(same, model, camera).why


# The refinement.


def rig_of(camera, baseline=0.4):
    T_right_left = cameras.matrix_from_rt([0.01, 0.12, 0.005, -baseline, 0.01, 0.03])
    return T_right_left, (
        Camera(camera.K, camera.width, camera.height, np.eye(4)),
        Camera(camera.K, camera.width, camera.height, T_right_left),
    )


def start(T, random, degrees, metres):
    step = np.concatenate([random.normal(size=3) * np.radians(degrees), random.normal(size=3) * metres])
    T0 = closed_form.moved(T, step)
    C = np.diag([np.radians(degrees) ** 2] * 3 + [metres**2] * 3)
    return SimpleNamespace(poses=(closed_form.Pose(T0, 1.0, C, np.zeros((0, 2), int), 0, 0, 0, T0),), status="unique")


def test_derivatives_of_the_projection(tmp_path):
    _, _, model, camera = trials.room_trial(0, tmp_path, 1)
    D, pair = rig_of(camera)
    rig = rig_.rig_of([rig_.Side(c, None) for c in pair], 3.0)
    p = camera.T_cam_world[:3, :3].T @ (np.array([[0.3, 0.2, 2.5], [-0.5, 0.4, 4]]) - camera.T_cam_world[:3, 3]).T
    for side in (0, 1):
        _, J = rig_.project(rig, side, camera.T_cam_world, 1.3, p.T, True, True)
        for k in range(7):
            q = []
            for sign in (-1, 1):
                T, scale = rig_.step(camera.T_cam_world, 1.3, sign * 1e-6 * np.eye(7)[k])
                q.append(rig_.project(rig, side, T, scale, p.T))
            np.testing.assert_allclose((q[1] - q[0]) / 2e-6, J[:, :, k], rtol=1e-5, atol=1e-3)


@pytest.mark.scene
@pytest.mark.parametrize(
    "scene, degrees, metres, turn, move",
    [("office", 3, 0.15, 0.01, 0.0005), ("linear", 2, 0.08, 0.01, 0.0005), ("cornell", 1, 0.03, 0.02, 0.0005)],
)
def test_path_traced_photographs(root, scene, degrees, metres, turn, move):
    """One photograph alone, from degrees and decimetres away: hundredths of a degree, half a millimetre."""
    folder = root / "data" / scene
    model, camera = models.load(folder / "model.obj"), cameras.read_cameramodel(folder / "left.posed.cameramodel")
    photograph = image.read_photograph(next(p for p in folder.glob("left.*") if p.suffix in (".png", ".exr")))
    side = rig_.Side(Camera(camera.K, camera.width, camera.height, np.eye(4)), photograph)
    for seed in range(2):
        result = refinement.refine(
            model, [side], start(camera.T_cam_world, np.random.default_rng(seed), degrees, metres)
        )
        off = trials.pose_error(result.cameras[0].T_cam_world, camera)
        assert off[0] < turn and off[1] < move
        assert result.support > 0.7 and result.evidence > refinement.PROOF


@pytest.mark.scene
@pytest.mark.slow
def test_the_covariance_is_honest(tmp_path):
    """Rooms seen by pairs whose principal points and focal lengths are 0.1 px wrong, 1 % noise."""
    far = []
    for seed in range(12):
        random, _, model, camera = trials.room_trial(seed, tmp_path, 1)
        D, pair = rig_of(camera)
        shots = [
            trials.photograph(
                np.random.default_rng(seed), model, Camera(c.K, c.width, c.height, c.T_cam_world @ camera.T_cam_world)
            )
            for c in pair
        ]
        sides = []
        for c, shot in zip(pair, shots, strict=True):
            f, x, y = random.normal(size=3) * 0.1
            K = c.K + np.array([[0, 0, x], [0, 0, y], [0, 0, 0]])
            K[[0, 1], [0, 1]] *= 1 + f / np.hypot(c.width / 2, c.height / 2)
            sides.append(rig_.Side(Camera(K, c.width, c.height, c.T_cam_world), shot))
        result = refinement.refine(model, sides, start(camera.T_cam_world, random, 1, 0.03))
        gap = cameras.rt_from_matrix(camera.T_cam_world @ np.linalg.inv(result.cameras[0].T_cam_world))
        far.append(gap @ np.linalg.solve(result.covariance, gap))
    assert np.mean(np.array(far) < chi2.ppf(0.95, 6)) >= 0.8
    assert 1.5 < np.median(far) < 9  # 5.3 expected: neither boasting nor hiding


def test_the_photographs_settle_what_planes_leave_open(tmp_path):
    """Of two poses that the facets cannot tell apart only one puts edges on edges; the wrong one alone is refused."""
    random, _, model, camera = trials.room_trial(1, tmp_path, 1)
    shot = trials.photograph(random, model, camera)
    side = rig_.Side(Camera(camera.K, camera.width, camera.height, np.eye(4)), shot)
    good, bad = (
        start(camera.T_cam_world, random, 0.3, 0.01).poses[0],
        start(closed_form.moved(camera.T_cam_world, [0, 0.5, 0, 0.7, 0, 0]), random, 0.3, 0.01).poses[0],
    )
    result = refinement.refine(model, [side], SimpleNamespace(poses=(bad, good), status="ambiguous"))
    assert result.status == "unique" and result.chosen == 1
    assert trials.pose_error(result.cameras[0].T_cam_world, camera)[0] < 0.1
    for status in ("unproved", "unique"):
        result = refinement.refine(model, [side], SimpleNamespace(poses=(bad,), status=status))
        assert result.status == "not recognised" and result.support < refinement.LEAST


# Symmetries.


def boxed(folder, high, groups="a", move=(0.3, -2, 5)):
    scene = Objects().add("box", box((0, 0, 0), high), BOX, groups)
    return models.load(scene.write(folder / f"{'-'.join(map(str, high))}-{len(set(groups))}.obj", move=move))


@pytest.mark.parametrize(
    ("high", "groups", "alike", "exact"),
    [
        ((1, 1, 1), "a", 23, 23),
        ((1, 1, 1), ["b", *"aaaaa"], 23, 3),
        ((1, 1, 2), "a", 7, 7),
        ((5, 4, 2.8), "a", 3, 3),
    ],
)
def test_boxes_come_onto_themselves(tmp_path, high, groups, alike, exact):
    """The turns of a cube, a square prism and a box, by the order of their groups."""
    model = boxed(tmp_path, high, groups)
    found = symmetry.motions(model)
    assert len(found) == alike and sum(motion.is_exact for motion in found) == exact
    for motion in found:
        moved = model.vertices @ motion.T[:3, :3].T + motion.T[:3, 3]
        assert np.linalg.norm(moved[:, None] - model.vertices[None], axis=2).min(axis=1).max() < 1e-9
        assert np.linalg.det(motion.T[:3, :3]) == pytest.approx(1)


def test_furniture_leaves_a_room_nearly_itself(tmp_path):
    """Three half turns bring the walls onto themselves, and nothing brings the furniture."""
    _, _, model, _ = trials.room_trial(1, tmp_path, 1)
    found = symmetry.motions(model)
    assert len(found) == 3 and not any(motion.is_exact for motion in found)
    assert symmetry.motions(boxed(tmp_path, (1, 1.5, 1e-3))) != []


@pytest.mark.parametrize(("groups", "status"), [("a", "symmetric"), (["b", *"aaaaa"], "ambiguous")])
def test_a_cube_gets_an_answer_and_its_equals(tmp_path, groups, status):
    """24 poses show the same edges; where one side is of another group, only four of them are the same."""
    model, random = boxed(tmp_path, (1, 1, 1), groups, move=(0, 0, 0)), np.random.default_rng(0)
    camera = look((2.4, 1.9, 1.7), (0.5, 0.5, 0.45))
    side = rig_.Side(Camera(camera.K, camera.width, camera.height, np.eye(4)), trials.photograph(random, model, camera))
    found = start(camera.T_cam_world, random, 0.5, 0.01)
    found.status = "unproved"  # three facets of one size tell nothing; the photograph does
    result = refinement.refine(model, [side], found)
    assert result.status == status and len(result.ambiguous) == 23
    assert trials.pose_error(result.cameras[0].T_cam_world, camera)[0] < 0.2
    corners = lambda T: model.vertices @ T[:3, :3].T + T[:3, 3]
    here = corners(result.cameras[0].T_cam_world)
    for other in result.ambiguous:
        there = corners(cameras.matrix_from_rt(other["rt_cam_world"]))
        assert np.linalg.norm(there[:, None] - here[None], axis=2).min(axis=1).max() < 1e-6


# The executable.


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """A folder with all that the stage reads, and the true camera: a furnished room, drawn from the index buffer."""
    folder = tmp_path_factory.mktemp("recognise")
    random, _, model, camera = trials.room_trial(5, folder, 2)
    facets, _ = trials.facets_seen(random, model, camera)
    write_facets(folder / "facets.json", facets)
    _, pair = rig_of(camera)
    for name, c in zip(("left", "right"), pair, strict=True):
        shot = trials.photograph(
            np.random.default_rng(5), model, Camera(c.K, c.width, c.height, c.T_cam_world @ camera.T_cam_world)
        )
        image.write_png8(folder / f"{name}.png", np.round(255 * shot.values).astype(np.uint8))
        image.write_png16(folder / f"{name}.surfaces.png", np.ones((c.height, c.width), np.uint16))
        cameras.write_cameramodel(folder / f"{name}.cameramodel", c)
    return folder, camera


def write_facets(path, facets, **more):
    entries = [
        {
            "left_label": int(a),
            "right_label": int(b),
            "plane": {"n": list(n), "d": -float(d)},
            "polygon": polygon.tolist(),
            "overlap": 0.9,
            "covariance": C.tolist(),
        }
        for (a, b), n, d, polygon, C in zip(
            facets.labels, facets.normal, facets.distance, facets.polygons, facets.covariance, strict=True
        )
    ]
    path.write_text(json.dumps({"frame": "left", "unit": facets.unit, "facets": entries} | more))


def words(folder, out, **other):
    files = {
        "facets": "facets.json",
        "model": "model.obj",
        "photograph": "left.png",
        "photograph-right": "right.png",
        "surfaces": "left.surfaces.png",
        "surfaces-right": "right.surfaces.png",
        "camera": "left.cameramodel",
        "camera-right": "right.cameramodel",
    } | other
    made = {
        "posed": "left.posed.cameramodel",
        "posed-right": "right.posed.cameramodel",
        "pose": "pose.json",
        "report": "recognise.report.json",
    }
    return [
        "stages/recognise.py",
        *(w for name, value in files.items() for w in (f"--{name}", folder / value)),
        *(w for name, value in made.items() for w in (f"--{name}", out / value)),
    ]


@pytest.mark.outside
def test_from_outside(run, chain, tmp_path):
    folder, camera = chain
    result = run(*words(folder, tmp_path))
    assert result.returncode == 0, result.stderr
    left, other = (cameras.read_cameramodel(tmp_path / f"{name}.posed.cameramodel") for name in ("left", "right"))
    off = trials.pose_error(left.T_cam_world, camera)
    assert off[0] < 0.1 and off[1] < 0.004
    np.testing.assert_allclose(other.T_cam_world @ np.linalg.inv(left.T_cam_world), rig_of(camera)[0], atol=1e-9)
    pose = json.loads((tmp_path / "pose.json").read_text())
    assert pose["status"] == "unique" and pose["ambiguous"] == []
    assert np.linalg.eigvalsh(pose["covariance"])[0] > 0
    assert pose["trace"][0]["step"] == "linear" and pose["trace"][-1]["error_px"] < 0.5 < pose["trace"][0]["error_px"]
    report = json.loads((tmp_path / "recognise.report.json").read_text())
    assert report["edges_found"] > 0.6 and len(report["trace"]) == len(pose["trace"])


@pytest.mark.scene
def test_refusals_are_one_line(refuses, chain, tmp_path, files_under):
    folder, _ = chain
    content = json.loads((folder / "facets.json").read_text())
    bad = folder / "bad.json"

    def refused(what, infinite=None, **options):
        text = json.dumps(what)
        bad.write_text(text.replace(infinite, "1e999") if infinite else text)
        lines = refuses(*words(folder, tmp_path, facets="bad.json", **options))
        assert len(lines) == 1 and not files_under(tmp_path)
        return lines[0]

    blank = folder / "blank.png"
    image.write_png8(blank, np.full(image.read_photograph(folder / "left.png").values.shape, 90))
    nothing = {"photograph": "blank.png", "photograph-right": "blank.png"}
    assert "at least 3" in refused(content | {"facets": content["facets"][:1]}, **nothing)
    assert "unit: 'foot'" in refused(content | {"unit": "foot"})
    assert "orientation is missing" in refused(content | {"unit": "baseline"})
    first = content["facets"][0]
    assert "plane" in refused(content | {"facets": [first | {"plane": {"n": [1, 1, 1], "d": -1}}]})
    assert "covariance" in refused(content | {"facets": [first | {"covariance": [[1, 2], [3, 4]]}]})
    assert "negative eigenvalue" in refused(content | {"facets": [first | {"covariance": (-np.eye(3)).tolist()}]})
    assert "covariance: is missing" in refused(content | {"facets": [first | {"covariance": None}]})
    assert "facets[0].covariance[2][2]: 1e999 is not a finite number" in refused(
        content | {"facets": [first | {"covariance": np.eye(3).tolist()[:2] + [[0, 0, 7e77]]}]}, infinite="7e+77"
    )
    assert "polygon" in refused(content | {"facets": [first | {"polygon": [[0, 0, 1]]}]})
    assert "polygon" in refused(content | {"facets": [first | {"polygon": [[0, 0], [0, 1], [1, 1]]}]})


def test_no_facets_is_bad_input_only_where_it_must(tmp_path):
    path = tmp_path / "facets.json"
    path.write_text('{"frame": "left", "unit": "m", "facets": []}')
    assert len(facets_file.read_scene(path)) == 0
    path.write_text('{"frame": "right", "unit": "m", "facets": []}')
    with pytest.raises(BadInput, match="frame"):
        facets_file.read_scene(path)


@pytest.mark.parametrize(
    "own, found, rival, found_rival, told",
    [
        (40, 36, 40, 0, True),  # its poster is there, the rival's is not
        (40, 26, 0, 0, False),  # two of its poster's edges are there by chance; the rival shows no poster
        (40, 10, 40, 0, False),  # neither's poster is there
        (0, 0, 60, 0, True),  # the rival shows what is not there
        (0, 0, 20, 0, False),  # ... but hardly enough of it
    ],
)
def test_twins_are_told_apart_by_what_is_there(own, found, rival, found_rival, told):
    """Two rooms alike but for one thing: the photographs decide only where they show it."""
    from lib.vision.refinement.evidence import refuted

    def predicted(number, found, x):
        common = np.column_stack([np.arange(100) * 5.0, np.zeros(100)])
        q = np.concatenate([common, np.column_stack([np.arange(number) * 5.0, np.full(number, x)])])
        return [(q, np.tile([0.0, 1.0], (len(q), 1)), np.arange(len(q)) < 100 + found, np.zeros(len(q)))]

    assert refuted(predicted(own, found, 100.0), predicted(rival, found_rival, 200.0), 0.9, 0.08, 8.0) == told
