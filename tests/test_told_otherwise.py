"""The same model in another unit, place and order: the same surface, patches and rays, to the last bit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lib.given import extent, model
from lib.light import adapt, form_factors
from lib.light import surface as surfaces
from lib.light.lamps import direct, emitters, patch_direct
from tests.helpers import rooms

ORIGIN = (0.0, 0.0, 0.0)


def drawn(seed):
    """A room with a lamp and two boxes somewhere on its floor."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(3, 6, 2)
    objects = {**rooms.room(x, y, 2.5), **rooms.LAMP}
    for k in (1, 2):
        a, b = random.uniform(0.2, 1.8, 2)
        w, d, h = random.uniform(0.3, 0.9, 3)
        objects |= rooms.solid(f"box-{k}", a, b, 0, a + w, b + d, h)
    return objects


def shuffled(objects, seed):
    """The same with its objects and polygons in another order, each polygon begun at another corner."""
    random = np.random.default_rng(seed)
    told = {}
    for name in random.permutation(list(objects)):
        polygons = objects[name]
        told[str(name)] = [
            (polygons[k][0], list(np.roll(np.array(polygons[k][1]), int(random.integers(4)), axis=0)))
            for k in random.permutation(len(polygons))
        ]
    return told


def light(s):
    """What is known of the light, patch by patch and by its corners: areas, lamp's factors, rays that meet others."""
    lamps = emitters(s, ["lamp"])
    mesh = adapt.build(s, patches=60, max_level=2, contrast=0.02, emitters=lamps, n_rays=64)
    D = patch_direct(s, mesh, lamps, 1, n_points=16)[:, 0]
    F = form_factors.rays(s, mesh, n_rays=64).matrix()
    return mesh.area, D, F @ D


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    "placed",
    [
        {"scale": 1e3},
        {"scale": 1e-3},
        {"offset": (1e3, -500.0, 20.0)},
        {"offset": (1e6, -1e6, 5e5)},
        {"scale": 304.8, "offset": (7.0, 8.0, 9.0)},
    ],
    ids=["mm", "km", "1 km away", "1000 km away", "feet elsewhere"],
)
def test_another_unit_or_place_is_the_same_light(tmp_path, seed, placed):
    here = light(rooms.surface(tmp_path / "here.obj", drawn(seed)))
    there = light(rooms.surface(tmp_path / "there.obj", drawn(seed), **placed))
    far = 1e-7 if max(np.abs(placed.get("offset", ORIGIN))) >= 1e6 else 1e-12  # of what a double has left of a corner
    for a, b in zip(here, there, strict=True):
        np.testing.assert_allclose(b, a, rtol=far, atol=far * np.abs(a).max())


@pytest.mark.parametrize("seed", range(6))
def test_another_order_is_the_same_light(tmp_path, seed):
    here = light(rooms.surface(tmp_path / "here.obj", drawn(seed)))
    there = light(rooms.surface(tmp_path / "there.obj", shuffled(drawn(seed), seed)))
    for a, b in zip(here, there, strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-12 * np.abs(a).max())


def mirrored(objects, axis):
    flip = np.where(np.arange(3) == axis, -1.0, 1.0)
    return {name: [(g, list((np.array(p) * flip)[::-1])) for g, p in polygons] for name, polygons in objects.items()}


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("seed", range(6))
def test_a_mirrored_model_is_the_same_light(tmp_path, seed, axis):
    here = rooms.surface(tmp_path / "here.obj", drawn(seed))
    there = rooms.surface(tmp_path / "there.obj", mirrored(drawn(seed), axis))
    assert here.hand == -there.hand
    for a, b in zip(light(here), light(there), strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-12 * np.abs(a).max())


def test_hand():
    """It turns with the places, is the other of what is mirrored, and 1 of what is its own mirror image."""
    for seed in range(20):
        p = np.random.default_rng(seed).normal(size=(9, 3))
        R = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        hand = extent.hand(p, p.mean(axis=0))
        assert extent.hand(p @ R.T, R @ p.mean(axis=0)) == hand == extent.hand(p[::-1], p.mean(axis=0))
        assert extent.hand(-p, -p.mean(axis=0)) == -hand
        flat = np.vstack([p * [1, 1, 0], p * [1, 1, 0]])
        assert extent.hand(flat, flat.mean(axis=0)) == 1
        both = np.vstack([p, p * [1, 1, -1]])
        assert extent.hand(both, both.mean(axis=0)) == 1


def test_a_moved_box_keeps_its_frames(tmp_path):
    """Its patches lie on it where they did, wherever its farthest corners are now."""
    box = lambda x: {**rooms.room(4, 3, 2.5), **rooms.LAMP, **rooms.solid("box", x, 1.1, 0, x + 0.8, 1.8, 0.7)}
    models = [model.load(rooms.write(tmp_path / f"{k}.obj", box(x))) for k, x in enumerate((1.2, 2.1))]
    here = surfaces.surface(models[0], ("lamp",))
    alone, like = surfaces.surface(models[1], ("lamp",)), surfaces.surface(replace(models[1]), ("lamp",), here)
    assert np.abs(alone.axes - here.axes).max() > 0.5
    np.testing.assert_allclose(like.axes, here.axes, atol=1e-9)
    step = like.origin - here.origin
    mine = here.object == models[0].objects.index("box")
    np.testing.assert_allclose(
        step[mine], np.broadcast_to([0.9 / here.local.diagonal, 0, 0], step[mine].shape), atol=1e-6
    )
    np.testing.assert_allclose(step[~mine], 0, atol=1e-9)


def test_light_of_one_set_of_pixels_does_not_hang_on_another_s_size(tmp_path):
    """A pixel more in a tile drew other shadow rays for all that follow."""
    s = rooms.surface(tmp_path / "room.obj", drawn(1))
    lamps = emitters(s, ["lamp"])
    random = np.random.default_rng(1)
    p = s.local.points(np.column_stack([random.uniform(0.2, 2.8, (40, 2)), np.full(40, 1e-3)]))
    n, of = (
        np.array([[0.0, 0, 1]]),
        lambda start, p: direct(s, lamps, p, n, np.zeros(len(p), int), 1, n_samples=4, start=start),
    )
    whole, less = of(np.array([0, 13, 30, 40]), p), of(np.array([0, 12, 29, 39]), np.delete(p, 3, axis=0))
    np.testing.assert_array_equal(whole[1:], less[1:])


@pytest.mark.parametrize("n", [2, 3, 4, 5, 8, 50])
def test_smallest_ball(n):
    """It holds all points, and its middle lies among those on its border: no smaller ball does."""
    for seed in range(20):
        p = np.random.default_rng([n, seed]).normal(size=(n, 3)) * [1, 2, 0.5]
        centre, radius = extent.smallest_ball(p)
        distance = np.linalg.norm(p - centre, axis=1)
        assert distance.max() <= radius * (1 + 1e-9)
        border = p[distance > radius * (1 - 1e-7)]
        weights = _nonnegative(border, centre)
        assert np.abs(weights @ border - centre).max() < 1e-6 * radius, "the middle is no mean of border points"


def _nonnegative(border, centre):
    """Weights (k,), at least 0 and of sum 1, of which the mean of the points comes nearest to the centre."""
    from scipy.optimize import nnls

    A = np.vstack([border.T, 1e3 * np.ones(len(border))])
    return nnls(A, np.append(centre, 1e3))[0]


def test_smallest_ball_of_a_box_is_about_its_middle_and_turns_with_it():
    box = np.array([[x, y, z] for x in (0.0, 4.0) for y in (0.0, 3.0) for z in (0.0, 2.0)])
    R = Rotation.random(rng=np.random.default_rng(3)).as_matrix()
    for turn in (np.eye(3), R):
        centre, radius = extent.smallest_ball(box @ turn.T)
        np.testing.assert_allclose(centre, turn @ [2, 1.5, 1], atol=1e-12)
        assert 2 * radius == pytest.approx(np.sqrt(16 + 9 + 4), rel=1e-12)


def test_one_point_and_points_of_one_place():
    assert extent.smallest_ball(np.ones((5, 3)))[1] == 0
    np.testing.assert_array_equal(extent.middle(np.ones((5, 3))), np.ones(3))


def test_the_middle_counts_each_place_once():
    p = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 1e-9], [1, 0, 0]])
    np.testing.assert_allclose(extent.middle(p), [0.5, 0, 0], atol=1e-8)
