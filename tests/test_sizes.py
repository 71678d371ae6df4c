"""Nothing depends on how many pixels a picture has: the same scene is looked at in the same tiles, by one rule."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from lib.analysis.answer import strangers
from lib.analysis.fit import misfits
from lib.analysis.fit.misfits import Misfit
from lib.analysis.seen import gather
from lib.synthetic import recipes
from tests.helpers.made_problems import made

FACETS = ((0, 0, 640, 200), (0, 200, 300, 480), (300, 200, 640, 480), (40, 40, 90, 90), (400, 250, 424, 262))


def facets(finer):
    """(H, W) int: a wall, two floors and two things before them, in 320 x 240 times `finer` pixels."""
    picture = np.zeros((240 * finer, 320 * finer), int)
    for number, corners in enumerate(FACETS):
        x0, y0, x1, y1 = (c * finer // 2 for c in corners)
        picture[y0:y1, x0:x1] = number
    return picture


def test_a_larger_picture_is_cut_into_as_many_tiles():
    count = []
    for finer in (1, 2, 4):
        facet, start, pixel = gather.blocks(facets(finer), np.ones((240 * finer, 320 * finer), bool))
        count.append(np.bincount(facet, minlength=len(FACETS)))
        assert len(pixel) == start[-1] == 240 * 320 * finer**2
    np.testing.assert_allclose(count[1:], np.broadcast_to(count[1], (2, len(FACETS))), rtol=0.3)
    assert (np.array(count[0]) <= 1.3 * count[1]).all()  # where tiles would be of a pixel they are larger


@pytest.mark.parametrize("shape", [(480, 640), (640, 480), (960, 1280), (1920, 2560)])
def test_a_tile_has_as_many_shadow_rays(shape):
    """But for those of pixels that have one already."""
    rays = gather.samples_per_pixel(4, shape) * shape[0] * shape[1]
    assert rays == max(4 * 480 * 640, shape[0] * shape[1])


def off_by(error, pixels, noise):
    """Misfit of 30 tiles of so many pixels each that noise and an error of the model leave, a hundredth of the picture.

    error : linear;  noise : display, of a pixel
    """
    problem, rho, _ = made(np.full((5, 3), 0.4), transfer="linear", pixels=pixels)
    random, tiles = np.random.default_rng(3), problem.tile_group == 1
    problem = replace(problem, shown=100 * pixels * np.count_nonzero(tiles))
    problem.photograph.__dict__["noise"] = noise
    B = np.full((np.count_nonzero(tiles), 3), 0.4)
    sign = np.where(np.arange(len(B)) % 2, 1, -1)[:, None]
    seen = B + error * sign + random.normal(0, noise / np.sqrt(pixels), B.shape)
    return misfits.misfit(problem, problem.transfer, B, seen, np.full(len(B), pixels))


@pytest.mark.parametrize("noise", [0.002, 0.01])
def test_what_a_group_is_off_by_and_may_keep_is_that_of_its_share_of_the_picture(noise):
    found = [off_by(0.01, pixels, noise) for pixels in (103, 400, 1600)]
    np.testing.assert_allclose([m.share for m in found], 0.01)
    np.testing.assert_allclose([m.excess for m in found], found[-1].excess, rtol=0.1)
    assert {misfits.is_over(m, misfits.THRESHOLD) for m in found} == {False}
    assert {misfits.is_over(m, 0.5 * misfits.THRESHOLD) for m in found} == {True}
    np.testing.assert_allclose([m.energy for m in found], found[-1].energy, rtol=0.2)


@pytest.mark.parametrize("pixels", [25, 400, 1600])
def test_noise_alone_is_no_misfit_however_few_pixels_there_are(pixels):
    assert off_by(0, pixels, 0.03).excess == 0


def test_what_stands_out_is_what_a_large_group_may_not_keep():
    whole = Misfit(0.0, 0.0, 0.0, 99, share=1.0)
    assert misfits.tolerance(whole, misfits.THRESHOLD) == misfits.LEAST
    tiny = replace(whole, share=1e-4)
    assert misfits.tolerance(tiny, misfits.THRESHOLD) == misfits.THRESHOLD


def test_a_finer_picture_shows_the_same_view():
    """A point at q of the picture's area, from its corner, is at n q of the finer one's."""
    recipe, p = recipes.make("office"), np.array([[1.0, 2, 1], [2, 3, 0.5]])
    np.testing.assert_allclose(recipe.finer(4).project(p) + 0.5, 4 * (recipe.project(p) + 0.5))
    assert recipe.finer(4).size == (2560, 1920) and recipe.finer(1) is recipe


CORNERS = np.array([[180, 120], [330, 105], [336, 270], [174, 285]])  # of a thing in 640 x 480 px


@pytest.mark.parametrize("finer", [1, 2])
@pytest.mark.parametrize("penumbra, things", [(0.5, 1), (7.0, 0)])
def test_a_thing_has_a_sharp_outline_and_a_shadow_has_none(finer, penumbra, things):
    """penumbra : px of 640 x 480. In a picture of twice as many it is twice as wide, and no thing's outline is."""
    y, x = np.mgrid[: 480 * finer, : 640 * finer] / finer
    mask = cv2.fillConvexPoly(np.zeros(y.shape, np.uint8), CORNERS * finer, 1)
    light = 0.5 + 0.0002 * x + mask * 0.1 * np.tanh((195 - y) / 8)
    light = cv2.GaussianBlur(light, (0, 0), penumbra * (finer if penumbra > 1 else 1))
    picture = object.__new__(strangers._Picture)
    picture.owner = np.zeros(light.shape, int)
    picture.view = SimpleNamespace(shape=light.shape)
    picture.pixel, picture.seen, picture.facet = np.arange(light.size), light.reshape(-1, 1), picture.owner.reshape(-1)
    picture._are_shadows = lambda some, far, factors: np.zeros(len(some), bool)
    found = picture.outlined(None)
    assert len(found) == things
    for mine, pixels, middle, closed in found:
        assert abs(pixels / cv2.contourArea(CORNERS * finer) - 1) < 0.1 and closed > 0.9 and mine.sum() == pixels
        assert np.linalg.norm(middle / finer - CORNERS.mean(axis=0)) < 16
