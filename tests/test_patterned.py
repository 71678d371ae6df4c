"""Patterns, which no light makes: found where they are, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from lib.analysis.causes import patterned
from lib.analysis.causes.candidates import Candidate
from lib.picture.albedo_maps import AlbedoMap, unseen
from tests.helpers.changed_scenes import deviated, vignetted
from tests.helpers.made_problems import COLOURS, made

WIDTH, TILES, PIXELS, A = 400, 300, 9, 1  # A: number of the group "a"
NOISE = 0.0015


@pytest.fixture(scope="module")
def exact():
    """(problem, residual (T, C) of noise alone, x and y (T,) of the tiles, pixel (M,) of the tiles' pixels)."""
    problem, _, _ = made(COLOURS, tiles=TILES, pixels=PIXELS)
    random = np.random.default_rng(1)
    x, y = random.integers(2, WIDTH - 2, (2, len(problem.tile_group)))
    pixel = np.repeat(y * WIDTH + x, PIXELS)
    return problem, NOISE * random.standard_normal((len(x), 3)), x / WIDTH, y / WIDTH, pixel


def found(exact, off, group=A):
    """Names of the groups in which a pattern is found, `off` (T,) being added to the residuals of one group."""
    problem, noise, _, _, pixel = exact
    own = problem.tile_group == group
    variance = patterned.variance(problem, noise + np.where(own, off, 0)[:, None], pixel, WIDTH)
    return set() if variance is None else {problem.groups[g] for g in np.unique(problem.tile_group[variance[:, 0] > 0])}


def test_planks_are_a_pattern(exact):
    x = exact[2]
    assert found(exact, 0.02 * np.sign(np.sin(40 * x))) == {"a"}
    assert found(exact, 0.002 * np.sign(np.sin(40 * x))) == set()  # too faint to mislead


def test_light_is_none(exact):
    """Smooth light that is not as it was taken for, another reflectance, a shadow: none is everywhere and uneven."""
    _, _, x, y, _ = exact
    smooth = 0.1 * x - 0.15 * (y - 0.4) ** 2 + 0.05
    assert found(exact, smooth) == set()
    assert found(exact, np.where((x < 0.4) & (y < 0.5), -0.2, 0.0)) == set()


def test_what_differs_everywhere_is_none(exact):
    """Where all groups scatter alike the picture as a whole is wrong, and none may hide."""
    problem, noise, *_, pixel = exact
    assert patterned.variance(problem, 20 * noise, pixel, WIDTH) is None


def test_tiles_with_a_pattern_say_less(exact):
    """Their scatter counts in the likelihood, and neither as the typical residual nor as what neighbours share."""
    problem, _, x, _, pixel = exact
    first = Candidate.of(problem)
    assert patterned.beside(first, pixel, WIDTH) is first
    plank = np.where(problem.tile_group == A, 1 + 0.3 * np.sign(np.sin(60 * x)), 1)
    laid = replace(problem, pixels=problem.pixels * np.repeat(plank, PIXELS)[:, None])
    before = Candidate.of(laid)
    after = patterned.beside(before, pixel, WIDTH)
    assert not after.problem.plain[problem.tile_group == A].any() and after.problem.plain.sum() == 4 * TILES
    assert after.evidence.nats > before.evidence.nats + 100 and after.typical < before.typical
    assert abs(after.result.state.gamma - 2) < 0.02


def test_the_mean_of_a_map_is_as_unsure_as_what_no_pixel_shows():
    random = np.random.default_rng(2)
    albedo = np.clip(0.4 + 0.1 * random.standard_normal((40, 50, 3)), 0, 1).astype(np.float32)
    known, ones = np.ones((40, 50), np.float32), np.ones((40, 50), np.float32)
    of = lambda known: AlbedoMap(0, albedo, known, 0 * ones, ones, np.full(3, 0.4), np.eye(3), 0)
    np.testing.assert_allclose(unseen(of(known)), 0, atol=1e-9)
    known[:10] = 0
    np.testing.assert_allclose(unseen(of(known)), 0.25 * 0.1, rtol=0.1)
    np.testing.assert_allclose(unseen(of(0 * ones)), 0)


@pytest.mark.slow
def test_a_print_in_the_shadow_of_a_lens(tmp_path):
    """The disc on the poster was taken for a thing before it, since the picture fitted badly without its pattern."""
    _, found, off = deviated(tmp_path, vignetted, "poster")
    assert found["status"] == "converged" and [c["cause"] for c in found["explained"]] == ["vignetting"]
    assert {name for name, group in found["groups"].items() if group["kind"] != "diffuse"} == {"poster", "rug"}
    assert off < 3
