"""Poses from corners (§2.4): lines and corners, objects before texture, wrong models, symmetric ones, what denies."""

import numpy as np
import pytest

from lib.buffers import index_buffer
from lib.given import cameras
from lib.given.cameras import Camera
from lib.synthetic import geometry
from lib.vision.corners import answer as answers
from lib.vision.corners import hypotheses, lines
from lib.vision.facets_file import SceneFacets
from lib.vision.recognition import search_kernels
from lib.vision.recognition.closed_form import contradicted, explained
from lib.vision.recognition.hashing import database, seen_facets
from lib.vision.refinement import edges as edges_
from lib.vision.refinement import evidence
from tests.helpers import facet_trials as trials
from tests.helpers import objects, rooms


def few(scene, keep):
    """The facets `keep` of a scene."""
    polygons = [scene.polygons[k] for k in keep]
    return SceneFacets(scene.m[keep], scene.covariance[keep], polygons, scene.labels[keep], scene.unit)


def seen_of(pair, seed, number):
    """So many facets of what the left camera sees of the object, with noise, and one that is false."""
    random = np.random.default_rng(seed)
    facets, truth = trials.facets_seen(random, pair.full, pair.posed, spurious=0.3, partial=False)
    on_object = [i for i, f in enumerate(truth) if f >= 0 and pair.full.facet_object[f] < len(pair.given.objects)]
    return few(facets, [*on_object[:number], *np.flatnonzero(truth < 0)[:1]])


def no_facets():
    return SceneFacets(np.zeros((0, 3)), np.zeros((0, 3, 3)), [], np.zeros((0, 2), int))


def is_right(T, posed, depth):
    turn, move = trials.pose_error(T, posed, depth)
    return turn < 1 and move < 0.02 * depth


# Lines and corners.


def test_edges_of_two_photographs_lie_on_the_models(tmp_path):
    """Where both photographs show an edge, most of the lines in space are edges of the model, to 2 % of the depth."""
    pair = objects.object_pair(3, tmp_path)
    found = lines.of_edges(pair.sides)
    back = np.linalg.inv(pair.posed.T_cam_world)
    model = edges_.model_edges(pair.given)
    s = np.linspace(0, 1, 200)[:, None, None]
    on_edges = (model.a + s * (model.b - model.a)).reshape(-1, 3)
    far = [
        np.linalg.norm((end @ back[:3, :3].T + back[:3, 3])[:, None] - on_edges, axis=2).min(axis=1)
        for end in (found.a, found.b)
    ]
    right = np.maximum(*far) < 0.02 * found.a[:, 2]
    assert len(right) >= 8 and right.sum() >= 5


def test_a_corner_is_where_its_lines_meet():
    """Two lines at right angles, one ends 1 cm before the other: apex, directions away from it, and reach."""
    a, b = np.array([[0.01, 0, 2.0], [0, 0, 2.0]]), np.array([[0.5, 0, 2.0], [0, 0.3, 2.0]])
    found = lines.corners(lines.Lines(a, b, np.full(2, 0.002), np.zeros((2, 3)), np.full(2, 100.0)))
    np.testing.assert_allclose(found.apex, [[0, 0, 2]], atol=1e-12)
    assert found.angle[0] == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(np.sort(found.reach), [[0.3, 0.5]], atol=1e-12)


def test_lines_that_cross_or_never_meet_are_no_corners():
    a, b = np.array([[-0.5, 0, 2.0], [0, -0.5, 2.0]]), np.array([[0.5, 0, 2.0], [0, 0.5, 2.0]])
    make = lambda a, b: lines.Lines(a, b, np.full(2, 0.002), np.zeros((2, 3)), np.full(2, 100.0))
    assert len(lines.corners(make(a, b)).apex) == 0
    assert len(lines.corners(make(a + [[0.5, 0, 0], [0, 0.5, 0.2]], b + [[0.5, 0, 0], [0, 0.5, 0.2]])).apex) == 0
    assert len(lines.corners(make(a[:0], b[:0])._replace(sigma=a[:0, 0], normal=a[:0], px=a[:0, 0])).apex) == 0


def test_without_noise_the_true_pose_comes_first(tmp_path):
    """Exact edges of an object as lines: the best pose is the true one, to a fifth of a degree."""
    pair = objects.object_pair(5, tmp_path)
    scene = seen_of(pair, 5, 3)
    found = hypotheses.hypotheses(scene, pair.given, pair.sides)
    assert is_right(found.T[0], pair.posed, found.depth)
    assert found.nats[0] > 1.2 * found.nats[1]
    for T in found.T:
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1)


# Answers.


@pytest.mark.scene
@pytest.mark.parametrize(
    ("seeds", "most", "so"), [((100, 103), 2, 1), pytest.param((100, 108), 7, 5, marks=pytest.mark.slow)]
)
def test_objects_before_texture(tmp_path, capsys, seeds, most, so):
    """Two or three facets of each object are known, too few for planes: by corners most are answered, all right."""
    answered, by_corners = 0, 0
    for seed in range(*seeds):
        pair = objects.object_pair(seed, tmp_path)
        told = answers.answer(seen_of(pair, seed, 2 + seed % 2), pair.given, pair.sides)
        if not told.why:
            answered += 1
            by_corners += "hypotheses" in told.found.counts
            own = told.result.cameras[0].T_cam_world
            poses = [own, *(cameras.matrix_from_rt(o["rt_cam_world"]) for o in told.result.ambiguous)]
            assert any(is_right(T, pair.posed, 1.0) for T in poses), seed
    with capsys.disabled():
        print(f"\n{np.ptp(seeds)} objects: {answered} answered, {by_corners} by corners")
    assert answered >= most and by_corners >= so


@pytest.mark.scene
@pytest.mark.parametrize("seeds", [(120, 121), pytest.param((121, 124), marks=pytest.mark.slow)])
def test_a_wrong_model_is_refused_with_its_figures(tmp_path, seeds):
    for seed in range(*seeds):
        pair, other = objects.object_pair(seed, tmp_path), objects.object_pair(seed + 50, tmp_path)
        told = answers.answer(seen_of(pair, seed, 4), other.given, pair.sides)
        assert "% of the best pose's edges, 70 % needed" in told.why and "nats" in told.why, seed
        assert "\n" not in told.why


def test_nothing_to_see(tmp_path):
    """Photographs of nothing and no facets: refused, and both reasons are told."""
    pair = objects.object_pair(0, tmp_path)
    blank = np.full(pair.sides[0].photograph.values.shape, 0.5)
    sides = [type(s)(s.camera, type(s.photograph)(blank, 8, False, 3)) for s in pair.sides]
    told = answers.answer(no_facets(), pair.given, sides)
    assert told.result is None and "at least 3" in told.why and "0 lines" in told.why


def cube(paints):
    return geometry.box("cube", paints[0], (0, 0, 0), (0.5, 0.5, 0.5), top=paints[1], sides=dict(enumerate(paints[2:])))


@pytest.mark.scene
@pytest.mark.parametrize(("paints", "status", "others"), [("aaaaaa", "symmetric", 23), ("abacad", None, None)])
def test_a_cube_has_equal_poses(tmp_path, paints, status, others):
    """A cube of one group is answered, its 23 other poses are listed. Painted, its poses look the same all the same."""
    pair = objects.object_pair(1, tmp_path, cube([f"paint {p}" for p in paints]))
    told = answers.answer(seen_of(pair, 1, 3), pair.given, pair.sides)
    assert not told.why
    own = told.result.cameras[0].T_cam_world
    poses = [own, *(cameras.matrix_from_rt(o["rt_cam_world"]) for o in told.result.ambiguous)]
    assert any(is_right(T, pair.posed, 1.0) for T in poses)
    assert len(poses) > 1 and told.result.status in ("symmetric", "ambiguous")
    if status:
        assert told.result.status == status and len(told.result.ambiguous) == others


# What speaks against a pose.


def test_furniture_that_the_model_lacks_denies_it(tmp_path):
    """Of the empty room the same facets say yes on the walls, and no on the furniture."""
    random, things, model, camera = trials.room_trial(3, tmp_path, 1)
    facets, truth = trials.facets_seen(random, model, camera, spurious=0, partial=False)
    bare = rooms.write(
        tmp_path / "bare.obj", {name: polygons for name, polygons in things.items() if "thing" not in name}
    )
    furniture = np.array(["thing" in model.objects[model.facet_object[f]] for f in truth])
    seen = seen_facets(facets, camera)
    for what, expected in ((model, np.zeros(len(truth), bool)), (objects.models.load(bare), furniture)):
        db = database(what)
        T = camera.T_cam_world.copy()
        T[:3, 3] += T[:3, :3] @ db.centre
        no = contradicted(seen, db, T, 1.0)
        assert (no <= expected).all() and no.sum() >= 0.7 * expected.sum()
        assert not set(np.flatnonzero(no)) & set(explained(seen, db, T, 1.0)[0][:, 0])


@pytest.mark.parametrize("share", [0.5, 0.7, 0.95])
def test_evidence_of_an_unknown_support(share):
    """A mixture loses at most ln 10 against the one who knew the share, and gains nothing beyond it."""
    chance, number = 0.08, 500
    hits = int(share * number)
    known = (hits * np.log(share / chance) + (number - hits) * np.log((1 - share) / (1 - chance))) / evidence.APART
    assert known - np.log(10) - 1e-9 <= evidence.nats_of(hits, number, chance) <= known + 0.05
    assert evidence.nats_of(int(chance * number), number, chance) < 0


# Cheap samples, and the search where nothing is possible.


def test_rays_show_what_a_picture_shows(tmp_path):
    """Beside nearly all samples both name the same facets; the others lie where a pixel is too coarse."""
    _, _, model, camera = trials.room_trial(0, tmp_path, 1)
    s = edges_.visible_samples(model, edges_.model_edges(model), camera, 1, step_px=3.0, reach=5)
    index = index_buffer.reference(model, camera)
    same = []
    for k, sign in enumerate((-1, 1)):
        at = np.rint(s.q + 2 * sign * s.normal).astype(int)
        inside = (at >= 0).all(axis=1) & (at < [camera.width, camera.height]).all(axis=1) & (s.clear >= 3)
        same.append(index.facet[at[inside, 1], at[inside, 0]] == s.sides[inside, k])
    assert len(s.q) > 200 and np.concatenate(same).mean() > 0.99


def test_a_probe_agrees_with_the_picture_at_pixels(tmp_path):
    _, _, model, camera = trials.room_trial(2, tmp_path, 1)
    index = index_buffer.reference(model, camera)
    q = camera.pixels().reshape(-1, 2)[::37]
    facet, depth = index_buffer.Probe(model, camera).at(q)
    x, y = q.astype(int).T
    same = facet == index.facet[y, x]
    assert same.mean() > 0.998
    np.testing.assert_allclose(depth[same], index.depth[y, x][same], rtol=1e-6)
    away = Camera(camera.K, camera.width, camera.height, camera.T_cam_world + np.eye(4)[:, 3:] @ [[0, 0, 0, 1e3]])
    away.T_cam_world[3, 3] = 1.0
    assert index_buffer.Probe(model, away).at(q[:0])[0].shape == (0,)


def test_where_no_displacement_is_possible_there_is_no_place():
    """One correspondence that asks for a place outside the box: the search ends, and found nothing."""
    row = np.zeros((1, 3, 7))
    row[0, :, :3], row[0, :, 5], row[0, :, 6] = np.eye(3), 10.0, 11.0
    pairs = search_kernels.Conditions(np.zeros(1, np.int64), row)
    problems = search_kernels.Problems(np.zeros(1, np.int64), np.array([0, 1]), np.ones(1), np.zeros(1), np.ones(1))
    found, _ = search_kernels.search(pairs, problems, np.ones(1), search_kernels.Limits(np.ones(3), 1.0, 7.0, 100))
    assert len(found.score) == 0
