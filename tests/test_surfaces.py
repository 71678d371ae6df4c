"""Surfaces: borders without a step are none, and those with one stay."""

import numpy as np
import pytest

from lib.vision import segmentation
from lib.vision.surfaces import surfaces

H, W = 90, 120
Y, X = np.mgrid[:H, :W]


def picture(light, *, noise=0.004, seed=0, channels=3):
    tint = np.array([1, 0.9, 0.8])[:channels]
    return light[..., None] * tint + np.random.default_rng(seed).normal(0, noise, (*light.shape, channels))


def bands(light, number):
    """Regions cut along levels of the light, labels from 1."""
    return 1 + np.digitize(light, np.linspace(light.min(), light.max(), number + 1)[1:-1])


def connected(labels):
    return segmentation.kernels.components(np.ascontiguousarray(labels, np.int32))[0] + 1


def largest(labels):
    """Share of the picture that its largest surface covers."""
    return np.bincount(labels.ravel()).max() / labels.size


def spot(brightest=0.4):
    """Light of a lamp near a wall."""
    return 0.3 + brightest * np.exp(-((X - 40) ** 2 + (Y - 50) ** 2) / 9000)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("seed", range(3))
def test_levels_of_shading_are_one_surface(channels, seed):
    light = spot()
    found = surfaces(picture(light, seed=seed, channels=channels), connected(bands(light, 7)))
    assert largest(found) > 0.99  # corners of a few pixels have no side to compare


@pytest.mark.parametrize("step", [0.03, 0.1])
def test_a_step_stays(step):
    """Two walls under one shading: the isophotes cross the border between them."""
    light = spot() + step * (X > 70)
    labels = connected(bands(spot(), 6) * 2 + (X > 70))
    found = surfaces(picture(light), labels)
    left, right = found[:, :70], found[:, 71:]
    assert largest(left) > 0.98 and largest(right) > 0.98 and not np.isin(left, right).any()


def test_a_step_that_is_only_noise_is_none():
    light = np.full((H, W), 0.5)
    found = surfaces(picture(light, noise=0.01), connected(1 + (X > 60) + 2 * (Y > 45)))
    assert found.max() == 1


def test_labels_count_from_one_and_regions_stay_whole():
    light = spot() + 0.2 * (Y > 60)
    regions = segmentation.segment(picture(light), 0.002)
    found = surfaces(picture(light), regions)
    assert found.dtype == np.int32 and (np.unique(found) == np.arange(1, found.max() + 1)).all()
    assert all(len(np.unique(found[regions == k])) == 1 for k in np.unique(regions))
    assert (connected(found).max() == found.max()).all()


def test_one_region():
    assert (surfaces(picture(spot()), np.ones((H, W), int)) == 1).all()


def test_a_photograph_is_cut_where_it_has_steps():
    """From the segmentation at the noise's lambda: two walls, a floor and a poster, and nothing else of any size."""
    wall = np.where(X < 60, 0.45 + 0.002 * X, 0.75 - 0.002 * X) + spot(0.15) - 0.3
    light = np.where(Y > 65, 0.2 + 0.001 * X, wall)
    light = np.where((X > 80) & (X < 105) & (Y > 20) & (Y < 45), 0.3 + spot(0.1) - 0.3, light)
    seen = picture(light)
    found = surfaces(seen, segmentation.segment(seen, segmentation.noise_lambda(seen)))
    size = np.bincount(found.ravel())
    assert (size > 0.02 * H * W).sum() in (3, 4)  # the walls meet in a crease where no step is seen
    assert len(np.unique(found[25:40, 85:100])) == len(np.unique(found[70:85, 10:110])) == 1
