"""Pose and places of objects by edges: nothing on exact scenes, the given error on perturbed ones, honest sigmas."""

import functools
import re
from dataclasses import replace

import numpy as np
import pytest

from lib.analysis.seen import places
from lib.given import image, model
from lib.given.cameras import Camera, matrix_from_rt, read_cameramodel
from lib.given.view import View
from lib.vision.refinement.edges import model_edges, pyramid
from lib.vision.registration.likelihood import fit, log_likelihood
from lib.vision.registration.motions import Block, State, World, corrected_camera, corrected_model
from lib.vision.registration.pieces import Pieces
from lib.vision.registration.placing import covariance, solve
from lib.vision.registration.register import Registrar, Seen, register


@functools.cache
def scene(root, name):
    """(model, camera, photograph) of a shipped scene."""
    folder = root / "data" / name
    left = next(folder.glob("left.[pe][nx][gr]"))
    return (
        model.load(folder / "model.obj"),
        read_cameramodel(folder / "left.posed.cameramodel"),
        image.read_photograph(left),
    )


def rms_px(world, camera, other):
    """How far two cameras see the model's visible edges apart."""
    registrar = Registrar(world, camera, pyramid(blank(camera), 1)[1])
    p = registrar.sight(State()).p
    return float(np.sqrt(((camera.project(p) - other.project(p)) ** 2).sum(axis=1).mean()))


def blank(camera):
    """A photograph that shows nothing."""
    return image.Photograph(np.full((camera.height, camera.width, 1), 0.5), 8, False, 1)


def pieces(offset, sigma=0.1, edges=None, wrong=(), random=None):
    """Pieces with one peak each, at offset (M,) px; those in `wrong` anywhere."""
    random = random or np.random.default_rng(0)
    offset = np.asarray(offset, float) + sigma * random.normal(size=len(offset))
    offset[list(wrong)] = random.uniform(-15, 15, len(wrong))
    n = len(offset)
    edges = np.arange(n) if edges is None else edges
    one = np.ones(n)
    return Pieces(
        edges,
        0 * edges,
        21 * one,
        one,
        offset[:, None],
        0.8 * one[:, None],
        0.2 * one,
        0 * one[:, None],
        one < 0,
        one < 0,
    )


# ---- laws ----


def test_the_correction_takes_given_coordinates_to_corrected_ones(root):
    world, camera, _ = scene(root, "flat-grey")
    rt = np.array([0.01, -0.02, 0.03, 0.1, -0.2, 0.05])
    corrected = corrected_camera(camera, matrix_from_rt(rt), (0.5, -0.25))
    p = world.vertices[:5]
    given = camera.points(p)
    T = matrix_from_rt(rt)
    assert np.allclose(corrected.points(p), given @ T[:3, :3].T + T[:3, 3])
    assert np.allclose(corrected.K[:2, 2] - camera.K[:2, 2], (0.5, -0.25))


def test_a_moved_object_keeps_numbers_and_planes(root):
    world, _, _ = scene(root, "office")
    thing = world.objects.index("carton")
    T = matrix_from_rt([0, 0, 0.3, 0.1, 0.2, 0])
    moved = corrected_model(world, {thing: T})
    mine = world.facet_object[world.triangle_facet] == thing
    was = world.corners()
    assert np.allclose(moved.corners()[~mine], was[~mine])
    assert np.allclose(moved.corners()[mine], was[mine] @ T[:3, :3].T + T[:3, 3])
    assert (moved.triangle_facet == world.triangle_facet).all() and moved.objects == world.objects
    height = np.einsum("tki,ti->tk", moved.corners(), moved.facet_normal[moved.triangle_facet])
    assert np.allclose(height, moved.facet_offset[moved.triangle_facet][:, None], atol=1e-6)


def test_derivatives_are_those_of_finite_differences(root):
    given, camera, _ = scene(root, "office")
    world = World(given, camera)
    carton = given.objects.index("carton")
    blocks = [Block("pose"), Block("principal_point"), Block("object", carton), Block("turn", carton)]
    state = world.step(State(), blocks, np.array([0.01, 0.02, -0.01, 0.05, 0.02, 0.03, 1, 2, 0.05, -0.02, 0.1]))
    edges = model_edges(given)
    owner = given.facet_object[edges.facets[:, 0]]
    seen = camera.points(edges.a)[:, 2] > 0.5
    p, owner = edges.a[seen], owner[seen]
    J = world.jacobian(state, blocks, world.moved(state, p, owner), owner)
    h = 1e-6
    for k in range(J.shape[2]):
        plus, minus = (world.project(world.step(state, blocks, s * np.eye(J.shape[2])[k]), p, owner) for s in (h, -h))
        assert np.abs((plus - minus) / (2 * h) - J[:, :, k]).max() < 1e-3 * max(np.abs(J[:, :, k]).max(), 1)


def test_an_object_slides_on_what_it_stands_on(root):
    given, camera, _ = scene(root, "office")
    world = World(given, camera)
    axes, normal = world.axes(given.objects.index("carton"))
    assert np.allclose(np.abs(normal), (0, 0, 1)) and axes.shape == (2, 3) and np.allclose(axes @ normal, 0)
    assert given.objects.index("walls") not in world.movable


def test_the_fit_finds_peaks_among_wrong_ones():
    random = np.random.default_rng(1)
    J = random.normal(size=(60, 2))
    truth = np.array([1.5, -2.0])
    found = pieces(J @ truth, wrong=range(0, 60, 4), random=random)
    numbers = fit(found, J, np.zeros(60), np.full(2, 10.0), 0.2)
    assert np.abs(numbers - truth).max() < 0.1
    better = log_likelihood(J @ numbers, found, 0.2).sum() - log_likelihood(np.zeros(60), found, 0.2).sum()
    assert better > 100


def test_the_covariance_covers():
    """Lines with an error of their own: the mean squared error in sigmas is about 1, and not above."""
    random = np.random.default_rng(2)
    line = np.repeat(np.arange(30), 12)
    J = random.normal(size=(30, 3))[line] + 0.1 * random.normal(size=(360, 3))
    distance = []
    for _ in range(60):
        r = 0.1 * random.normal(size=30)[line] + 0.05 * random.normal(size=360)
        prior = np.full(3, 10.0)
        numbers, H, ridge, w = solve(J, r, np.ones(360), prior)
        C = covariance(J, r - J @ numbers, w, H, line, ridge, prior)
        distance.append(numbers @ np.linalg.solve(C, numbers) / 3)
    assert 0.2 < np.mean(distance) < 1.2


# ---- photographs ----


@pytest.mark.parametrize("name", ["office", "flat-grey", "cornell", "two-mirrors", "linear", "desk-glossy", "poster"])
def test_an_exact_scene_has_no_cause(root, name):
    found = register(*scene(root, name))
    assert not found.explained and not found.missing
    assert found.after_px < 0.15 and found.n_edges > 20


def turned_and_moved(camera, scale):
    """A camera whose pose is off by scale x (3 mrad, 5 mm): about scale x 2 px in data/office."""
    T = matrix_from_rt(scale * np.array([0.003, -0.002, 0.002, 0.004, -0.003, 0.002]))
    return Camera(camera.K, camera.width, camera.height, T @ camera.T_cam_world)


def test_a_pose_that_is_two_pixels_off_is_found(root):
    given, camera, photograph = scene(root, "office")
    wrong = turned_and_moved(camera, 1.2)
    before = rms_px(given, camera, wrong)
    found = register(given, wrong, photograph)
    assert 1.5 < before < 3 and found.pose is not None and not found.objects
    assert rms_px(given, camera, found.camera(wrong)) < 0.15
    assert found.nats["pose"] > 50 and found.after_px < 0.15 < found.before_px
    assert np.linalg.eigvalsh(found.covariance).min() > 0


def test_a_photograph_twice_as_large_is_searched_small_and_placed_large(root):
    given, camera, photograph = scene(root, "office")
    K = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1]]) @ camera.K
    large = Camera(K, 2 * camera.width, 2 * camera.height, camera.T_cam_world)
    values = np.repeat(np.repeat(photograph.values, 2, axis=0), 2, axis=1)
    wrong = corrected_camera(turned_and_moved(large, 1.2), np.eye(4))
    found = register(given, wrong, image.Photograph(values, 8, False, photograph.channels_in_file))
    assert found.pose is not None and not found.objects
    assert rms_px(given, large, found.camera(wrong)) < 0.3


def test_objects_that_stand_three_centimetres_aside_are_found(root):
    given, camera, photograph = scene(root, "office")
    offsets = {"bin": (0.02, -0.022, 0), "carton": (-0.03, 0.004, 0)}
    thing = {name: given.objects.index(name) for name in offsets}
    wrong = corrected_model(given, {thing[n]: matrix_from_rt([0, 0, 0, *v]) for n, v in offsets.items()})
    found = register(wrong, camera, photograph)
    assert found.pose is None and found.centre_px is None and set(found.objects) == set(offsets)
    back = found.model(wrong)
    for name, k in thing.items():
        mine = given.facet_object[given.triangle_facet] == k
        assert np.abs(back.corners()[mine] - given.corners()[mine]).max() < 2e-3
        sigma = np.sqrt(np.diag(found.objects[name].covariance))[3:5]
        assert (sigma < 3e-3).all()


def test_a_fixed_object_stays(root):
    given, camera, photograph = scene(root, "office")
    thing = given.objects.index("bin")
    wrong = corrected_model(given, {thing: matrix_from_rt([0, 0, 0, 0.02, -0.022, 0])})
    assert "bin" not in register(wrong, camera, photograph, fixed=("bin",)).objects


def test_a_moved_principal_point_is_not_a_pose(root):
    given, camera, photograph = scene(root, "office")
    found = register(given, corrected_camera(camera, np.eye(4), (1.0, -0.7)), photograph)
    assert found.pose is None and np.abs(found.centre_px - (-1.0, 0.7)).max() < 0.1
    assert "pose" in found.rivals


@pytest.mark.parametrize(("name", "noise"), [("gallery-white", 0.1), ("gallery-white", 0.2), ("office", 0.2)])
def test_noise_hides_edges_and_not_the_camera(root, name, noise):
    """A white room with a fifth of noise shows .19 of its edges: another camera's are found by chance alone."""
    given, camera, photograph = scene(root, name)
    light = photograph.values**2.2
    light = light * (1 + noise * np.random.default_rng(1).standard_normal(light.shape))
    noisy = image.Photograph(np.clip(light, 0, 1) ** (1 / 2.2), 8, False, photograph.channels_in_file)
    right = register(given, camera, noisy).seen
    T = matrix_from_rt([0.1, -0.08, 0.06, 0, 0, 0])
    wrong = register(given, corrected_camera(camera, T), noisy).seen
    assert not right.is_lost and wrong.is_surely_lost and right.found > wrong.found + 0.1


def test_a_photograph_that_shows_nothing_says_nothing(root):
    given, camera, _ = scene(root, "flat-grey")
    found = register(given, camera, blank(camera))
    assert not found.explained and found.n_edges == 0


def test_a_few_edges_that_happen_to_be_there_are_little_evidence():
    """A room in millimetres, laid on its side, has 7.5 pieces before the camera, all found: its axis was named."""
    assert Seen(1.0, 0.11, 7.5).nats < Seen(0.81, 0.18, 45).nats < Seen(0.976, 0.264, 207).nats
    assert Seen(0.2, 0.3, 100).nats == 0


@pytest.mark.parametrize("name", ["office-1", "gallery-white", "flat-grey", "cornell", "two-mirrors"])
@pytest.mark.parametrize(
    ("axes", "words"), [(1, "mirrored .* left to right"), (0, "mirrored .* top to bottom"), ((0, 1), "upside down")]
)
def test_a_photograph_that_was_flipped_is_named(root, name, axes, words):
    """One that is mirrored ended in "too few edges". Of the right ones nothing is said: see above."""
    world, camera, photograph = scene(root, name)
    photograph = replace(photograph, values=np.ascontiguousarray(np.flip(photograph.values, axes)))
    (why,) = places.by_edges(View(camera, world, photograph), []).why
    assert why.cause == "camera" and re.search(words, why.text)
