"""lib/reflectance.py and lib/transfer.py: by hand, by law, by difference, at the edge.

The problems here are made, see tests/helpers/made_problems.py.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.stats import norm

from lib.analysis.fit import gauss_newton, paper, transport
from lib.analysis.fit.equations import Equations, Layout, Unknowns
from lib.analysis.fit.problem import CauseTerms
from lib.analysis.fit.uncertainty import NormalEquations
from lib.analysis.seen.tile_pixels import TilePixels
from lib.given import transfer_kinds
from lib.given.transfer import CURVES, Metric, Transfer
from tests.helpers.made_problems import COLOURS, made
from tests.helpers.truths import CUBE


def test_gauss_newton_recovers_reflectances_and_gamma_together():
    problem, rho, b = made(COLOURS)
    result = gauss_newton.gauss_newton(problem)
    assert result.converged
    np.testing.assert_allclose(result.state.rho, rho, atol=2e-5)
    np.testing.assert_allclose(result.state.gamma, 2.0, atol=1e-4)
    np.testing.assert_allclose(result.state.b, b, atol=1e-5)


@pytest.mark.parametrize("gamma", [0.3, 0.7, 1.0, 1.8, 2.6, 5.0])
def test_gamma_from_03_to_5(gamma):
    problem, rho, _ = made(COLOURS, gamma=gamma)
    result = gauss_newton.gauss_newton(problem, max_iterations=100)
    np.testing.assert_allclose(result.state.gamma, gamma, rtol=1e-3)
    np.testing.assert_allclose(result.state.rho, rho, atol=1e-3)


def test_derivatives_against_finite_differences():
    problem, rho, _ = made(COLOURS, given_E=False)
    layout = Layout.of(problem)
    light = transport.TileLight(problem)
    light.matrices.F = [problem.F.toarray().astype(float)]
    E = np.full((1, 3), 1.3)
    at = Equations(problem, light, layout, Unknowns(rho, E, Transfer("gamma", 2.1)))
    light.derivative = None
    theta, J = layout.pack(at.state), at.jacobian
    for step in (1e-3, 1e-4):
        for k in range(layout.size):
            d = np.zeros(layout.size)
            d[k] = step * max(abs(theta[k]), 0.1)
            there, back = (
                Equations(problem, light, layout, layout.unpack(theta + s * d, at.state)).residual.reshape(-1)
                for s in (1, -1)
            )
            slope = (there - back) / (2 * d[k])
            # the block solve is stopped at 3e-3, single precision carries 1e-6 / step
            assert np.abs(J[:, k] - slope).max() <= 4e-3 * np.abs(slope).max() + 5e-6 / d[k], (step, k)


def test_bounds_are_reached():
    """rho = 0 and 0.99 are found, and nothing leaves [0, 1] on the way."""
    problem, rho, _ = made([0.0, 0.99, 0.5, 0.2, 0.7])
    result = gauss_newton.gauss_newton(problem, max_iterations=100)
    assert (result.state.rho >= 0).all() and (result.state.rho <= 1).all()
    np.testing.assert_allclose(result.state.rho, rho, atol=2e-3)


@pytest.mark.parametrize("seed", range(5))
def test_sigma_is_honest_at_10_percent_noise(seed):
    """Pixel noise is all there is here: errors stay within 4 sigma, and sigma is no excuse (below 0.02)."""
    problem, rho, _ = made(COLOURS, noise=0.1, seed=seed)
    result = gauss_newton.gauss_newton(problem)
    z = np.abs(result.state.rho - rho)[1:] / result.sigma_rho[1:]
    assert z.max() < 4 and np.median(z) < 1.5
    assert 1e-4 < np.median(result.sigma_rho[1:]) < 0.02
    assert abs(result.state.gamma - 2.0) < 4 * result.sigma_gamma


def test_half_of_a_group_of_another_material_is_settled_soon(monkeypatch):
    """Huber's weights follow slowly, a hundred steps in one direction: the steps go on farther, to the same end."""
    problem, rho, _ = made(COLOURS, noise=0.01, tiles=12)
    pixels = problem.pixels.copy()
    for tile in np.flatnonzero(problem.tile_group == 2)[::2]:
        pixels[problem.start[tile] : problem.start[tile + 1]] *= 0.3
    mixed = replace(problem, pixels=pixels)
    options = {"finish": False, "tolerance": 1e-4, "max_iterations": 200}
    soon = gauss_newton.gauss_newton(mixed, **options)
    monkeypatch.setattr(gauss_newton, "DOUBLINGS", 0)
    late = gauss_newton.gauss_newton(mixed, **options)
    assert soon.converged and soon.iterations < 30 < 80 < late.iterations
    np.testing.assert_allclose(soon.state.rho, late.state.rho, atol=2e-4)


def test_a_group_never_seen_is_found_by_the_light_it_gives():
    """Without noise its light on the others tells it, whatever the prior says."""
    problem, rho, _ = made(COLOURS, unseen=(3,))
    result = gauss_newton.gauss_newton(problem)
    np.testing.assert_allclose(result.state.rho, rho, atol=2e-3)


def test_a_group_never_seen_that_lights_nobody_has_its_prior():
    """Mean of the seen groups by area, with their spread as sigma; the seen groups do not suffer."""
    problem, rho, _ = made(COLOURS, unseen=(3,))
    dark = np.ones(6)
    dark[3] = 0
    problem = replace(problem, F=csr_array(problem.F.toarray() * dark), G=csr_array(problem.G.toarray() * dark))
    result = gauss_newton.gauss_newton(problem)
    seen = [1, 2, 4, 5]
    np.testing.assert_allclose(result.state.rho[3], result.state.rho[seen].mean(axis=0), atol=1e-3)
    np.testing.assert_allclose(result.sigma_rho[3], result.state.rho[seen].std(axis=0), rtol=0.05)


def test_ignorance_of_a_group_never_seen_is_in_the_others_sigma():
    """With 10 % noise its light is barely told from the others': they know less than where it is seen."""
    problem, rho, _ = made(COLOURS, unseen=(3,), noise=0.1, tiles=6)
    result = gauss_newton.gauss_newton(problem)
    sure = gauss_newton.gauss_newton(made(COLOURS, noise=0.1, tiles=6)[0])
    seen = [1, 2, 4, 5]
    assert np.median(result.sigma_rho[seen] / sure.sigma_rho[seen]) > 1
    assert (np.abs(result.state.rho - rho)[seen] < 4 * result.sigma_rho[seen]).all()


def test_an_unknown_lamp_with_a_reference():
    problem, rho, _ = made(COLOURS, given_E=False)
    known = problem.rho.copy()
    known[1] = COLOURS[0]
    result, scale = gauss_newton.fit(replace(problem, rho=known))
    assert scale == "reference"
    np.testing.assert_allclose(result.state.E, 1.5, rtol=2e-3)
    np.testing.assert_allclose(result.state.rho, rho, atol=2e-3)


def test_an_unknown_lamp_by_interreflection_alone():
    """Bright walls: the second bounce fixes the scale, and sigma says how well."""
    problem, rho, _ = made([0.8, 0.7, 0.9, 0.6, 0.8], given_E=False)
    result, scale = gauss_newton.fit(problem)
    assert scale == "interreflection"
    assert abs(result.state.E[0, 0] - 1.5) < 4 * result.sigma_E[0, 0] + 1e-2
    known, _ = gauss_newton.fit(made([0.8, 0.7, 0.9, 0.6, 0.8])[0])
    assert np.median(result.sigma_rho[1:]) > np.median(known.sigma_rho[1:])


def test_several_lamps_none_negative():
    """Two lamps, one of them off: its power is found to be about 0, never below."""
    problem, rho, _ = made(COLOURS, E=(1.5, 0.0), lamps=2, given_E=False)
    known = problem.rho.copy()
    known[1] = COLOURS[0]
    result, _ = gauss_newton.fit(replace(problem, rho=known), max_iterations=100)
    assert (result.state.E >= 0).all()
    np.testing.assert_allclose(result.state.E[0], 1.5, rtol=0.02)
    assert (result.state.E[1] < 0.02).all()


def test_nothing_seen_is_no_crash():
    problem, *_ = made(COLOURS, unseen=(1, 2, 3, 4, 5))
    result = gauss_newton.gauss_newton(problem)
    assert not result.converged and np.isfinite(result.state.rho).all()
    assert result.sigma_gamma is None and result.sigma_rho is None  # unknown, not NaN


def test_a_wrong_lamp_shows_in_the_picture_error():
    """Twice the power cannot be explained away where walls reflect: the error grows, nothing breaks."""
    problem, *_ = made(COLOURS)
    right = gauss_newton.gauss_newton(problem)
    wrong = gauss_newton.gauss_newton(replace(problem, emittance=problem.emittance * 2))
    assert np.isfinite(wrong.state.rho).all() and wrong.rmse > 5 * right.rmse


def test_what_nothing_determines_has_a_sigma_as_large_as_itself():
    """Without interreflection only rho E is seen: both are as unsure as they are large; E becomes 1 by convention."""
    problem, rho, _ = made(COLOURS, given_E=False, transfer="linear")
    dark = replace(problem, F=csr_array((6, 6)), G=csr_array(problem.G.shape), G_plain=csr_array(problem.G.shape))
    seen = rho[problem.tile_group] * problem.D_tile * 0.9
    dark = replace(dark, pixels=np.repeat(seen, 40, axis=0))
    free = gauss_newton.gauss_newton(dark)
    assert (free.sigma_E > 0.5 * free.state.E).all() and (free.sigma_rho[1:] > 0.5 * free.state.rho[1:]).all()
    result, scale = gauss_newton.fit(dark)
    assert scale == "convention" and (result.state.E == 1).all()
    np.testing.assert_allclose(result.state.rho[1:], 0.9 * rho[1:], rtol=1e-4)


def several_lamps(walls, E, *, dark=False):
    """Lamps of unknown power, of which the third lights 2 pixels alone; without light between the walls if dark."""
    problem, rho, _ = made(walls, E=E, lamps=3, given_E=False, transfer="linear", noise=0.01, seed=3)
    D, D_tile = problem.D * [1, 1, 0], problem.D_tile * [1, 1, 0]
    start = np.concatenate([[0], problem.start[1:] + 2 - problem.start[1]])  # the first tile has 2 pixels
    D_tile[0, 2] = 0.002
    E, F = np.array(E)[:, None], 0 * CUBE if dark else CUBE
    b = np.linalg.solve(np.eye(6) - rho * F, rho * (D @ E))
    G = csr_array(problem.G.shape) if dark else problem.G
    shade = np.repeat(rho[problem.tile_group] * (D_tile @ E + G @ b), np.diff(start), axis=0)
    shade *= 1 + 0.01 * np.random.default_rng(5).standard_normal(shade.shape)
    F = csr_array(F)
    return replace(problem, D=D, D_tile=D_tile, start=start, pixels=shade, F=F, G=G, G_plain=G), rho


def test_a_loose_lamp_keeps_its_own_sigma():
    """Bright walls fix the scale for the two others, however little is known of the third."""
    problem, rho = several_lamps([0.8, 0.7, 0.9, 0.6, 0.8], (1.5, 0.9, 3.0))
    result, scale = gauss_newton.fit(problem)
    E, sigma = result.state.E[:, 0], result.sigma_E[:, 0]
    assert scale == "interreflection" and not result.warnings
    assert (np.abs(E[:2] - [1.5, 0.9]) < 4 * sigma[:2] + 0.01).all() and (sigma[:2] < 0.2 * E[:2]).all()
    assert sigma[2] > 0.5 * E[2] and abs(E[2] - 3) < 4 * sigma[2]
    np.testing.assert_allclose(result.state.rho[1:], rho[1:], atol=0.02)


def test_ratios_of_lamps_stand_where_a_convention_fixes_the_scale():
    """Nothing but rho E is seen: the lamp of most light is 1, the other one and the walls are right up to a factor."""
    problem, rho = several_lamps(COLOURS[:, 0], (0.9, 0.5, 3.0), dark=True)
    result, scale = gauss_newton.fit(problem)
    assert scale == "convention" and "'lamp' is taken as 1" in result.warnings[0]
    assert result.state.E[0, 0] == 1 and result.sigma_E[0, 0] == 0
    assert abs(result.state.E[1, 0] - 5 / 9) < 4 * result.sigma_E[1, 0] < 0.02
    assert result.sigma_E[2, 0] > 0.2 * result.state.E[2, 0]
    np.testing.assert_allclose(result.state.rho[1:], 0.9 * rho[1:], rtol=0.01)


def test_a_lamp_that_lights_nothing_seen_is_unknown():
    problem, *_ = made(COLOURS, E=(1.5, 1.0), lamps=2, given_E=False)
    known = problem.rho.copy()
    known[1] = COLOURS[0]
    off = replace(problem, rho=known, D=problem.D * [1, 0], D_tile=problem.D_tile * [1, 0])
    result = gauss_newton.gauss_newton(off)
    assert (result.sigma_E[1] >= result.state.E[1]).all() and np.isfinite(result.sigma_rho).all()


# -- the paper's alternation


def faces(rho):
    """A cube with one black emitting face and five alike; one tile per face that sees what the face sees."""
    problem, rho_all, _ = made(np.full(5, float(rho)), transfer="linear")
    F = CUBE.copy()
    b = np.linalg.solve(np.eye(6) - rho_all * F, rho_all[:, 0] * F[:, 0] * 1.5)
    B = rho_all[1:] * (F[1:, :1] * 1.5 + (F @ b)[1:, None])
    return replace(
        problem,
        G=csr_array(F[1:]),
        G_plain=csr_array(F[1:]),
        D_tile=F[1:, :1],
        tile_group=np.arange(1, 6),
        tile_object=np.zeros(5, int),
        start=np.arange(6),
        pixels=B,
    )


@pytest.mark.parametrize("rho, most", [(0.45, 15), (0.55, 30), (0.60, 90)])
def test_the_printed_update_slows_down(rho, most):
    result = paper.paper(faces(rho), most=200)
    assert result.converged and result.iterations <= most
    np.testing.assert_allclose(result.state.rho[1:], rho, rtol=5e-3)


@pytest.mark.parametrize("rho", [0.7, 0.8, 0.85])
def test_the_printed_update_diverges_in_bright_rooms_and_the_damped_one_does_not(rho):
    assert not paper.paper(faces(rho), most=300).converged
    damped = paper.paper(faces(rho), damped=True)
    assert damped.converged and damped.iterations <= 10
    np.testing.assert_allclose(damped.state.rho[1:], rho, rtol=5e-3)


def test_the_spread_criterion_of_46():
    """As printed, one object in shadow ({.3, 1, 1}) throws out both good ones; on |ln epsilon| it goes itself."""
    epsilon, pixels = np.array([0.3, 1.0, 1.0]), np.ones(3)
    assert paper.group_correction(epsilon, pixels, symmetric=False) == pytest.approx(0.3)
    assert paper.group_correction(epsilon, pixels, symmetric=True) == pytest.approx(1.0)
    larger = np.array([1.0, 1.1]), np.array([300, 100])
    assert all(paper.group_correction(*larger, symmetric=way) == pytest.approx(1.025) for way in (False, True))


# -- transfer


@pytest.mark.parametrize(
    "transfer", [Transfer("gamma", 2.2), Transfer("gamma", 0.5), Transfer("linear"), *map(Transfer, CURVES)]
)
def test_transfer_and_its_inverse(transfer):
    B = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(transfer.linear(transfer.display(B)), B, atol=2e-7)


@pytest.mark.parametrize("transfer", [Transfer("gamma", 2.2), Transfer("linear"), *map(Transfer, CURVES)])
def test_slope_against_differences(transfer):
    metric = Metric(transfer)
    B = np.array([1e-4, 1e-3, 0.02, 0.3, 0.9, 1.7])
    h = 1e-6 * B
    np.testing.assert_allclose(metric.slope(B), (metric.value(B + h) - metric.value(B - h)) / (2 * h), rtol=1e-5)


def test_every_curve_has_a_name_and_a_formula():
    assert set(CURVES) == set(transfer_kinds.CURVES)


def test_tiles_average_before_the_power():
    """Trap 2: of displays 0 and 1 under gamma 2 the linear mean is 0.5, not (0.5)^2."""
    tiles = TilePixels(np.array([[0.0], [1.0], [0.5], [0.5]]), np.array([0, 2, 4]))
    mean, _ = tiles.linear(Transfer("gamma", 2.0))
    np.testing.assert_allclose(mean[:, 0], [0.5, 0.25], atol=1e-5)


@pytest.mark.parametrize("bits", [255, 65535, None])
def test_tile_means_derivative_in_gamma(bits):
    rng = np.random.default_rng(1)
    pixels = rng.uniform(0.1, 0.9, (60, 3))
    pixels = np.round(pixels * bits) / bits if bits else pixels
    tiles = TilePixels(pixels, np.arange(0, 61, 10))
    _, slope = tiles.linear(Transfer("gamma", 2.0))
    there, back = (tiles.linear(Transfer("gamma", 2.0 + s))[0] for s in (1e-5, -1e-5))
    np.testing.assert_allclose(slope[..., 0], (there - back) / 2e-5, rtol=1e-6)


@pytest.mark.parametrize("sigma", [0.03, 0.1])
@pytest.mark.parametrize("of_light", [False, True])
def test_a_tile_of_a_noisy_photograph_is_right_wherever_the_noise_came_to_it(sigma, of_light):
    """Noise of the displayed values, or as large of the sensor's light: medians are right for both, means for one."""
    rng = np.random.default_rng(4)
    level, transfer = np.linspace(0.35, 0.8, 40)[:, None, None], Transfer("gamma", 2.2)
    shown = np.broadcast_to(level, (40, 6000, 1))
    light, noise = transfer.linear(shown), rng.normal(0, sigma, shown.shape)
    pixels = transfer.display(np.clip(light + noise * 2.2 * light / shown, 0, 1)) if of_light else shown + noise
    pixels = (np.round(255 * np.clip(pixels, 0, 1)) / 255).reshape(-1, 1)
    seen, _ = TilePixels(pixels, np.arange(0, len(pixels) + 1, 6000), noisy=True).linear(transfer)
    off = transfer.display(seen) - level[:, 0]
    assert abs(off.mean()) < 0.05 * sigma**2 + 2e-4
    assert off.std() < 1.3 * np.sqrt(1.5) * sigma / np.sqrt(6000) + 3e-4


@pytest.mark.parametrize(("left", "unknown"), [(1e-5, 0.5**0.5), (1e-3, 0.5), (1e-2, 0.0)])
def test_what_changes_no_tile_tells_nothing(left, unknown):
    """A function that another resembles to less than light is known to (1e-3) may be that one as likely as not, however
    surely the residuals speak; ten times further apart they alone count."""
    rng = np.random.default_rng(3)
    J, x, across = rng.normal(size=(4000, 3)), np.array([0.3, -0.2, 0.1]), rng.normal(size=4000)
    across -= J @ np.linalg.lstsq(J, across, rcond=None)[0]
    across *= left / np.sqrt(np.mean(across**2))
    terms = CauseTerms(("response",), (J @ x + across)[:, None, None], np.ones(1))
    found = NormalEquations(J, np.zeros(4000), np.full(4000, 1e12)).perhaps(terms, np.arange(4000) % 8, resolved=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(found)) / np.abs(x), unknown, atol=0.01)


@pytest.mark.parametrize("of_groups", [0.0, 1.0])
@pytest.mark.parametrize("information", [2.0, 20.0, 1000.0])
def test_a_doubt_is_as_large_as_what_it_is_about(information, of_groups):
    """A cause that is there in every second photograph: on average over photographs, the second moment of what it does
    to a value is what is said, whether the tiles tell much of it or little, and whatever each group has of its own."""
    rng = np.random.default_rng(5)
    group, J = np.arange(200) % 20, rng.normal(size=(200, 2))
    column = rng.normal(size=200) * np.sqrt(information / 200)
    terms = CauseTerms(("saturation",), column[:, None, None], np.ones(1))
    said, true = [], []
    for number in np.repeat(norm.ppf((np.arange(500) + 0.5) / 500), 2) * (np.arange(1000) % 2):
        each = number + of_groups * rng.normal(size=20)[group]  # what it seems to be, seen by one group
        normal = NormalEquations(J, rng.normal(size=200) + each * column, np.ones(200))
        said.append(np.diag(normal.perhaps(terms, group)))
        true.append((normal.inverse @ J.T @ column * number) ** 2)
    np.testing.assert_allclose(np.mean(said, axis=0) / np.mean(true, axis=0), 1, atol=0.1)


def test_a_doubt_does_not_depend_on_where_in_its_valley_a_fit_ended():
    rng = np.random.default_rng(4)
    J, noise = rng.normal(size=(500, 3)), rng.normal(size=500)
    terms = CauseTerms(("response",), rng.normal(size=(500, 1, 1)), np.ones(1))
    there, beside = (
        NormalEquations(J, noise + J @ off, np.ones(500)).beside(terms) for off in (np.zeros(3), np.ones(3))
    )
    np.testing.assert_allclose(there, beside, rtol=1e-9)
