"""Which pixels the analysis trusts."""

import numpy as np
import pytest

from lib.buffers.trust import trusted
from lib.given.image import Photograph

H, W = 120, 160
FACET = np.zeros((H, W), np.int32)
FACET[:, 80:] = 1
FACET[:30, :20] = 2
FACET[100:, 150:] = -1
GROUP = np.array([0, 1, 2])
NO_EDGES = np.zeros((H, W), bool)


def photo(values, linear=False):
    values = np.asarray(values, float)
    values = values[..., None] if values.ndim == 2 else values
    return Photograph(values, 0 if linear else 8, linear, values.shape[2])


def flat(level=0.5, noise=0.01, seed=0, channels=3):
    return np.clip(level + noise * np.random.default_rng(seed).normal(size=(H, W, channels)), 0, 1)


def test_no_pixel_that_mixes_two_facets():
    trust = trusted(photo(flat()), FACET, NO_EDGES, GROUP, keep=1)
    mask = trust.mask
    for y, x in np.argwhere(mask):
        assert len(np.unique(FACET[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2])) == 1
    assert not mask[FACET < 0].any()
    assert not mask[50, 77:83].any() and mask[50, 76] and mask[50, 83]  # the mixed pixel and two more on each side


def test_half_of_each_facet():
    mask = trusted(photo(flat()), FACET, NO_EDGES, GROUP, keep=0.5).mask
    all_of_it = trusted(photo(flat()), FACET, NO_EDGES, GROUP, keep=1).mask
    for facet in (0, 1):
        n = (all_of_it & (facet == FACET)).sum()
        assert (mask & (facet == FACET)).sum() == -(-n // 2)
    assert (mask & ~all_of_it).sum() == 0


def test_a_small_group_keeps_what_is_honest():
    """A group of 12 x 20 pixels: margins and the choice give way, so all 10 x 18 that are pure stay.

    A mixed pixel never does.
    """
    small = FACET.copy()
    small[small == 2] = 0
    small[10:22, 10:30] = 2
    mask = trusted(photo(flat()), small, NO_EDGES, GROUP).mask
    assert (mask & (small == 2)).sum() == 10 * 18
    same_group = trusted(photo(flat()), small, NO_EDGES, np.array([0, 1, 0])).mask
    assert (same_group & (small == 2)).sum() <= 6 * 14  # its group has plenty: margins stay


def test_one_pixel_facets_and_empty_facets():
    facet = FACET.copy()
    facet[60, 40] = 2
    mask = trusted(photo(flat()), facet, NO_EDGES, np.array([0, 1, 2, 3, 4])).mask
    assert not mask[59:62, 39:42].any() and mask.any()


@pytest.mark.parametrize("linear", [False, True])
def test_saturated_and_black_pixels_are_out(linear):
    values = flat(noise=0)
    values[:, :40], values[:, 120:] = 1.0, 0.0
    mask = trusted(photo(values, linear), FACET, NO_EDGES, GROUP, keep=1).mask
    assert not mask[:, 120:].any() and mask[:, 60:70].any()
    assert mask[40:100, 10:30].any() == linear  # in an EXR, 1.0 is only light


def test_light_above_one_is_trusted_in_linear_pictures():
    assert trusted(photo(7 * flat(), True), FACET, NO_EDGES, GROUP).left["trusted"] > 5000


@pytest.mark.parametrize("level", [0.2, 0.5, 0.9])
def test_skewed_noise_does_not_bias_the_choice(level):
    """A path tracer's noise: few bright pixels among many that are slightly dark. The chosen pixels keep its mean."""
    rng = np.random.default_rng(3)
    noise = rng.gamma(0.25, 1, (H, W, 3)) / 0.25 - 1  # mean 0, skewness 4
    x = np.arange(W)[None, :, None]
    truth = level * (1 + 0.05 * np.sin(x / 20.0))
    values = truth * (1 + 0.03 * noise)
    mask = trusted(photo(np.clip(values, 0, 1)), FACET, NO_EDGES, GROUP).mask
    sigma = 0.03 * 2 / np.sqrt(3 * mask.sum())
    if mask.sum() > 300:
        ratio = (values[mask] / np.broadcast_to(truth, values.shape)[mask]).mean()
        clipped = (np.clip(values, 0, 1)[mask] / np.broadcast_to(truth, values.shape)[mask]).mean()
        assert abs(ratio - 1) < 4 * sigma + 0.001 and abs(clipped - 1) < 4 * sigma + 0.001
    else:
        assert level == 0.9  # noise that reaches white leaves little


@pytest.mark.parametrize("sigma", [0.03, 0.1])
def test_noise_does_not_choose_where_light_peaks(sigma):
    """Half of a facet is kept, that nearest to a plane; a peak's pixels must not be those that noise has lowered."""
    x, y = np.meshgrid(np.linspace(-1, 1, W), np.linspace(-1, 1, H))
    peak = np.broadcast_to((sigma * np.cos(4 * x) * np.cos(3 * y))[..., None], (H, W, 3))
    slopes = []
    for seed in range(12):
        noise = np.random.default_rng(seed).normal(0, sigma, peak.shape)
        picture = photo(np.round(255 * np.clip(0.5 + peak + noise, 0, 1)) / 255)
        mask = trusted(picture, np.zeros((H, W), np.int32), NO_EDGES, GROUP[:1]).mask
        assert picture.noisy and 0.4 < mask.mean() < 0.6
        slopes.append(np.polyfit(peak[mask].ravel(), noise[mask].ravel(), 1)[0])
    assert abs(np.mean(slopes)) < 4 * np.std(slopes, ddof=1) / np.sqrt(len(slopes)) + 0.002


def test_an_edge_in_the_photograph_is_avoided():
    """A step of 10 % inside a facet, say the shadow of something the model does not have."""
    values = flat(noise=0.01)
    values[:, 120:] -= 0.05
    trust = trusted(photo(values), FACET, NO_EDGES, GROUP, keep=1)
    assert trust.edges[5:95, 118:122].any(axis=1).mean() > 0.9
    assert not trust.mask[5:95, 119:121].all(axis=1).any()


@pytest.mark.parametrize("noise", [0, 0.003, 0.02, 0.1])
def test_noise_and_shading_are_no_edges(noise):
    x, y = np.meshgrid(np.arange(W), np.arange(H))
    shading = (0.3 + 0.4 * np.exp(-((x - 40) ** 2 + (y - 60) ** 2) / 40.0**2))[..., None]
    rng = np.random.default_rng(1)
    values = np.round(np.clip(shading + noise * rng.normal(size=(H, W, 3)), 0, 1) * 255) / 255
    edges = trusted(photo(values), FACET, NO_EDGES, GROUP).edges
    assert edges.mean() < 0.03  # beside a facet's rim shading that curves can pass for one
    assert edges[40:90, 10:70].mean() < 1e-3


@pytest.mark.parametrize(
    "values",
    [np.zeros((H, W, 3)), np.ones((H, W, 1)), np.full((H, W, 1), 0.5), np.random.default_rng(0).random((H, W, 3))],
)
@pytest.mark.parametrize("linear", [False, True])
def test_extreme_photographs(values, linear):
    mask = trusted(photo(values, linear), FACET, NO_EDGES, GROUP).mask
    assert mask.shape == (H, W)
    if not linear and values.max() == values.min() and values.max() != 0.5:
        assert not mask.any()


def test_nothing_of_the_model_in_the_picture():
    trust = trusted(photo(flat()), np.full((H, W), -1, np.int32), NO_EDGES, GROUP)
    assert not trust.mask.any() and trust.left["seen"] == 0
