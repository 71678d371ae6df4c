"""The same model in another unit, place and order: the same surface, patches and rays, to the last bit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lib.given import extent
from lib.light import adapt, form_factors
from lib.light.lamps import emitters, patch_direct
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
