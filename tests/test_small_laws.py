"""Laws of one line each, by hand: what code mutants (tests/bench/mutants.py) had survived elsewhere."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csr_array

from lib.analysis.answer import disagreements
from lib.analysis.causes import candidates, told_lamps, vignetting
from lib.analysis.causes.candidates import Candidate
from lib.analysis.fit import evidence, misfits
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import Halves
from lib.given import model
from lib.light import adapt, chains, lamps, mirror_view, paths, radiosity
from lib.light import surface as surfaces
from tests.helpers import rooms
from tests.helpers.made_problems import COLOURS, made
from tests.helpers.small_scenes import finish, rectangle, side_of, surface
from tests.helpers.truths import CUBE


def test_two_halves_err_by_half_their_difference():
    G0, G1 = (csr_array(np.array([[x]])) for x in (0.3, 0.1))
    E, b = np.array([[10.0]]), np.array([[2.0]])
    assert Halves(G0, G1, None, None).difference(E, b) == pytest.approx(0.2)
    rays = np.array([[0.05]]), np.array([[0.02]])
    assert Halves(G0, G1, None, None, rays).difference(E, b) == pytest.approx(0.2 + 0.15)


@pytest.mark.parametrize("rest", [-1e-17, 0.0, 1e-17])
def test_what_one_group_alone_tells_is_not_moved_without_it(rest):
    """Left without its group a number's equations are a difference of equals, of either sign: sigma had been 1e133."""
    whole = np.array([[2.0, 0.3], [0.3, 5e-2]])
    left = np.array([[1.0, 1e-18], [-1e-18, rest]])
    np.testing.assert_allclose(evidence.steady(left, np.array([3.0, 1e-18]), whole), [3, 0], atol=1e-9)


def test_a_kept_surface_is_that_of_its_lamps(tmp_path):
    """A lamp has no light from behind: taken for another group, it would have two sides."""
    world = model.load(rooms.write(tmp_path / "model.obj", rooms.room() | rooms.LAMP))
    lit, dark = surfaces.surface(world, ["lamp"]), surfaces.surface(world, [])
    assert lit is not dark
    assert surfaces.surface(world, ["lamp"]) is lit and surfaces.surface(world, []) is dark


def test_a_likelihood_is_a_density():
    """Its integral over the residual is 1, whatever the width."""
    r = np.linspace(-60, 60, 240_001)[:, None]
    found = evidence.likelihood(r, np.full(r.shape, 0.3))
    assert np.exp(found.each).sum() * (r[1, 0] - r[0, 0]) == pytest.approx(1, abs=0.01)


def test_more_numbers_must_bring_more():
    """As many more as they are; of as many numbers, what a cause usually has."""
    problem = SimpleNamespace(tile_group=np.zeros(500))
    simple = SimpleNamespace(complexity=3, evidence=SimpleNamespace(nats=0.0), problem=problem)
    for complexity, more in ((3, candidates.USUAL_NUMBERS), (2, candidates.USUAL_NUMBERS), (5, 2)):
        least = candidates.enough(problem, more)
        for nats, worth in ((least - 0.1, False), (least + 0.1, True)):
            other = SimpleNamespace(complexity=complexity, evidence=SimpleNamespace(nats=nats), problem=problem)
            assert Candidate.is_worth(other, simple) is worth


def test_both_sides_of_what_is_seen_at_once():
    """From above the front of a floor, from below its back, an odd number."""
    s = surface(
        [("floor", rectangle((-1, -1, 0), (2, 0, 0), (0, 2, 0))), ("mirror", rectangle((9, 0, 0), *np.eye(3)[1:]))]
    )
    rays = [[*s.local.points([[0.3, 0.2, z]])[0], 0, 0, -z] for z in (1.0, -1.0)]
    view = mirror_view.through_mirrors(s, finish(s, mirror="mirror"), chains.Chains(1), np.array(rays, np.float32))
    floor = side_of(s, "floor")
    assert view.facet.tolist() == [floor // 2] * 2 and view.side.tolist() == [floor, side_of(s, "floor", back=True)]


@pytest.mark.parametrize("first", ["left", "right"])
def test_what_runs_out_between_mirrors_is_left(first):
    """A ray for ever between two mirrors is on one of them when the count runs out, be it the first polygon or not."""
    walls = {"left": rectangle((0, 0, 0), (0, 2, 0), (0, 0, 2)), "right": rectangle((1, 0, 0), (0, 0, 2), (0, 2, 0))}
    s = surface([(name, walls[name]) for name in sorted(walls, reverse=first == "right")])
    rays = np.hstack([s.local.points([[0.5, 0.7, 0.9]]), [[1.0, 0, 0]]]).astype(np.float32)
    for depth in (4, 5):
        left = []
        both = finish(s, left="mirror", right="mirror")
        met = paths.first_met(rays, *s.caster.closest(rays))
        assert len(list(paths.follow(s, both, chains.Chains(2), met, depth=depth, left=left))) == depth
        assert [(source.tolist(), weight.tolist()) for source, weight in left] == [([0], [1.0])]


def test_where_a_lamp_stands_is_as_unsure_as_the_light_that_it_moves():
    """The share of a doubt is what the reflectances move by if the patches' light is really another."""
    problem, rho, _ = made(COLOURS, E=(4.0,), transfer="linear")
    move = 0.03 * problem.D
    problem.unsure = ((move, np.zeros_like(problem.D_tile)),)
    doubted = gauss_newton(problem)
    problem.D, problem.unsure = problem.D + move, ()
    moved = gauss_newton(problem)
    off = np.abs(moved.state.rho - rho)[1:] / rho[1:]
    assert doubted.shares["place 0"] == pytest.approx(np.median(off), rel=0.2)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("noise", [0.002, 0.003, 0.005, 0.006, 0.01, 0.03])
def test_the_noise_of_a_photograph_is_what_was_put_in(noise, bits):
    """And what rounding adds to it, on a slope; a plain median of 8 bits is .67 to 1.8 times that."""
    random, depth = np.random.default_rng(1), 2**bits - 1
    shown = np.linspace(0.4, 0.45, 20_000)[:, None] + noise * random.standard_normal((20_000, 3))
    problem, *_ = made(COLOURS)
    start = np.linspace(0, 20_000, len(problem.tile_group) + 1).astype(int)
    seen = replace(problem, pixels=np.round(shown * depth) / depth, start=start)
    assert seen.pixel_noise == pytest.approx(np.hypot(noise, 1 / depth / np.sqrt(12)), rel=0.08)


def test_lenses_darken_edges_by_what_they_are_expected_to():
    """The spread of light lost at the corner before anything is seen: over (1 + t)^-m (1 - cut) of usual lenses."""
    numbers = np.array([vignetting.change(unit) for unit in np.eye(vignetting.TERMS)])
    expected = np.linalg.norm(numbers.sum(axis=1))
    lost = [
        1 - (1 + t) ** -m * (1 - cut) for t in (0.1, 0.3, 0.5, 0.7, 0.9) for m in (1, 1.5, 2) for cut in (0, 0.2, 0.4)
    ]
    assert expected == pytest.approx(vignetting.TIMES_USUAL * np.sqrt(np.mean(np.square(lost))), rel=0.05)
    assert vignetting.sigma(np.eye(vignetting.TERMS)) == pytest.approx(np.linalg.norm(numbers, axis=0))


@pytest.mark.parametrize(
    "k, strange",
    [
        ((-1.24, 1.46, -1.98), True),  # room-2391 beside a gamma of 2.03 for 1.64: below 0 at the corner
        ((-1.10, 0.74, -0.24), False),  # the same room, gamma 1.647
        ((-1.12, 0.80, -0.28), False),  # cos^4, 37 degrees at the corner
        ((0.0, 0.0, 0.0), False),
    ],
)
def test_a_shadow_that_no_lens_has_is_strange(k, strange):
    assert vignetting.is_strange(np.array(k)) == strange


def test_halved_cells_cover_what_the_cell_did(tmp_path):
    """Each side's patches have its area, however often they were halved."""
    s = rooms.surface(tmp_path / "model.obj", rooms.room() | rooms.LAMP)
    mesh = adapt.build(s, patches=30, max_level=2, contrast=0.05, emitters=lamps.emitters(s, ["lamp"]))
    sides = np.unique(mesh.side)
    assert len(mesh) > 2 * len(rooms.patches(s, 30))
    area = np.bincount(mesh.side, mesh.area)[sides]
    assert area == pytest.approx(surfaces.facet_areas(s)[sides // 2], rel=1e-4)


@pytest.mark.parametrize("loss", [1e-2, 1e-4, 1e-6])
def test_a_furnace_is_solved_in_its_first_step(loss):
    """Alike everywhere, E / (1 - rho): the first column of the Hessenberg matrix is as small as 1 - rho."""
    found = radiosity.solve(np.ones(6), np.full(6, 1 - loss), CUBE, tolerance=1e-9)
    np.testing.assert_allclose(found.B, 1 / loss, rtol=1e-6)


@pytest.mark.parametrize(
    "excess, keen",
    [
        ((0.0004, 0, 0, 0, 0, 0.0079), misfits.LEAST),  # small-9129, whose box has a sharp lobe of .08
        ((0.0016, 0.0015, 0.0039, 0.0029, 0.0016, 0.0074), None),  # room-2242, exact: 4.6 times what is usual
        ((0.0025, 0.003, 0.002, 0.0038, 0.0083), None),  # office
        ((0.0004, 0, 0.003, 0, 0, 0.004), None),
        ((), None),
    ],
)
def test_a_group_that_stands_out_by_far_is_looked_at_more_closely(excess, keen):
    found = {g: misfits.Misfit(excess=e, rms=e, noise=0.002, tiles=79, share=0.0027) for g, e in enumerate(excess)}
    assert misfits.keener(found, misfits.THRESHOLD) == keen
    assert misfits.keener(found, 0.003) is None  # told to be keener already


@pytest.mark.parametrize(
    "before, after, thrown",
    [
        ((0.058, 0.013), (0.0, 0.0), True),  # a mirror's bright patches on ceiling and wall
        ((0.058, 0.013), (0.0, 0.012), False),  # one of the two is off still
        ((0.0009, 0.0009), (0.001, 0.001), True),  # hardly to be seen before, and less than a thing leaves
        ((0.004, 0.004), (0.003, 0.003), False),
    ],
)
def test_light_that_mirrors_throw_is_no_thing(before, after, thrown):
    of = lambda values: {g: misfits.Misfit(e, e, 0.002, 79, 0.026) for g, e in enumerate(values)}
    answer = SimpleNamespace(judged=of(before), climb=SimpleNamespace(misfits=of(after)))
    assert disagreements.is_thrown(SimpleNamespace(behind=[0, 1]), answer) == thrown


@pytest.mark.parametrize("nats, promise, doubted", [(0.0, 500.0, True), (-500.0, 500.0, False), (0.0, 0.0, False)])
def test_srgb_under_told_lamps_is_doubted_where_others_explain_as_much(nats, promise, doubted):
    """Sigma of what was found holds what a gamma and other lamps would change; of what was told there is none."""
    problem, *_ = made(COLOURS)
    state = lambda rho: SimpleNamespace(rho=np.array([[rho], [0.3]]), E=np.ones((1, 1)), rho_s=None, bend=None)
    shown = lambda kind, nats, rho: SimpleNamespace(
        kind=kind,
        problem=problem,
        evidence=SimpleNamespace(nats=nats),
        result=SimpleNamespace(state=state(rho)),
        once=lambda question, ask: {"lamps": promise, "freed": shown("gamma", nats, 0.86)}[question],
    )
    sigma = np.array([[0.003], [0.0]])  # the second is a reference
    result = SimpleNamespace(state=state(0.87), sigma_rho=sigma, sigma_E=np.zeros((1, 1)), sigma_rho_s=None)
    result.sigma_bend = None
    told_lamps.doubt_srgb(shown("gamma", nats, 0.9), shown("srgb", 0.0, 0.87), result)
    np.testing.assert_allclose(result.sigma_rho, [[np.hypot(0.003, 0.01) if doubted else 0.003], [0.0]])
