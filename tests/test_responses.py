"""The camera's own tone curve, and which transfer function a photograph supports."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lib.analysis.causes import colour_mixing, explain, response
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.colour_mixing import ColourMixing
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.evidence import evidence, gain, likelihood
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import TilePixels
from lib.core.stage import BadInput
from lib.given import materials, tone_curve
from lib.given.materials import FoundTransfer, Materials
from lib.given.transfer import Metric, Transfer, srgb_from_linear
from tests.helpers.made_problems import COLOURS, made

LIGHT = np.linspace(1e-3, 1, 500)


def sigmoid(B):
    """A camera's picture style: gamma, then contrast about the middle."""
    s = lambda x: 1 / (1 + np.exp(-6 * (x - 0.45)))
    return (s(B ** (1 / 2.2)) - s(0)) / (s(1) - s(0))


def film(B):
    """Hable's filmic curve, white at 4."""
    shape = lambda x: (x * (0.22 * x + 0.03) + 0.002) / (x * (0.22 * x + 0.3) + 0.06) - 1 / 30
    return (shape(4 * B) / shape(4.0)) ** (1 / 2.2)


def wavy():
    return Transfer("curve", shape=tuple(np.log(2.2) + np.random.default_rng(3).normal(0, 0.3, len(tone_curve.KNOTS))))


def test_a_curve_of_one_slope_is_a_gamma():
    curve = Transfer("gamma", 1.8).as_curve()
    np.testing.assert_allclose(curve.display(LIGHT), LIGHT ** (1 / 1.8), rtol=1e-9)
    np.testing.assert_allclose(curve.linear(LIGHT), LIGHT**1.8, rtol=1e-9)


@pytest.mark.parametrize("shown, most", [(srgb_from_linear, 2e-4), (film, 1e-3), (sigmoid, 2e-3)])
def test_few_numbers_follow_real_curves(shown, most):
    from scipy.optimize import least_squares

    off = lambda c: tone_curve.display(LIGHT, tuple(c)) - shown(LIGHT)
    assert np.abs(least_squares(off, np.full(len(tone_curve.KNOTS), 0.7)).fun).max() < most


def test_a_curve_rises_from_black_to_white_and_has_an_inverse():
    curve = wavy()
    shown = curve.display(LIGHT)
    assert (np.diff(shown) > 0).all() and curve.display(1.0) == 1 and curve.display(0.0) == 0
    np.testing.assert_allclose(curve.linear(shown), LIGHT, rtol=1e-4)


def test_derivatives_of_a_curve():
    curve, h = wavy(), 1e-4
    B = np.array([0.01, 0.1, 0.5, 0.9])
    slope = (Metric(curve).value(B + h * B) - Metric(curve).value(B - h * B)) / (2 * h * B)
    np.testing.assert_allclose(Metric(curve).slope(B), slope, rtol=2e-2)
    for k, step in enumerate(h * np.eye(len(tone_curve.KNOTS))):
        there, back = (curve.moved(curve.parameters + sign * step) for sign in (1, -1))
        np.testing.assert_allclose(
            Metric(curve).by_parameters(B)[:, k], (there.display(B) - back.display(B)) / (2 * h), atol=2e-3
        )
        np.testing.assert_allclose(
            curve.linear_by_parameters(B)[:, k], (there.linear(B) - back.linear(B)) / (2 * h), atol=2e-3
        )


MIXING = ((0.9, 0.2, -0.1), (0.1, 0.85, 0.05), (-0.05, 0.25, 0.8))


@pytest.mark.parametrize("function", [Transfer("gamma", 1.8), Transfer("srgb"), wavy()], ids=lambda t: t.kind)
def test_mixed_colours_are_unmixed(function):
    light = np.random.default_rng(1).uniform(0.05, 0.7, (40, 3))
    mixing = replace(function, matrix=MIXING)
    np.testing.assert_allclose(mixing.display(light), function.display(light @ np.transpose(MIXING)), atol=1e-12)
    np.testing.assert_allclose(mixing.linear(mixing.display(light)), light, atol=2e-3)
    assert mixing.bare == function and mixing.moved(mixing.parameters) == mixing
    tiles = TilePixels(mixing.display(light), np.arange(0, 41, 4))
    seen, slope = tiles.linear(mixing)
    mean = light.reshape(10, 4, 3).mean(axis=1)
    np.testing.assert_allclose(seen, mean, atol=2e-3)
    h = 1e-5
    for k, step in enumerate(h * np.eye(len(mixing.parameters))):
        there, back = (tiles.linear(function.moved(function.parameters + sign * step))[0] for sign in (1, -1))
        np.testing.assert_allclose(slope[:, :, k], (there - back) / (2 * h), atol=1e-3)


def test_a_camera_that_mixes_colours_is_found_and_taken():
    problem, rho, _ = made(COLOURS, gamma=2.0, noise=0.01)
    camera = replace(problem.transfer, matrix=MIXING)
    mixed = replace(problem, pixels=camera.display(problem.transfer.linear(problem.pixels)))
    found = explain.explain(replace(mixed, transfer=Transfer("gamma", 2.0)), Scope(), max_iterations=40)
    assert [t.cause for t in found.taken] == ["matrix"]
    M = np.array(found.result.state.transfer.matrix)
    np.testing.assert_allclose(M, MIXING, atol=0.05)
    np.testing.assert_allclose(M.sum(axis=1), 1, atol=1e-9)
    off = np.abs(found.result.state.rho - rho)[1:]
    assert off.max() < 0.02 and (off < 4 * found.result.sigma_rho[1:] + 1e-3).all()
    unmixed = explain.explain(problem, Scope(), max_iterations=40)
    assert unmixed.taken == []


def test_derivatives_of_mixed_colours():
    problem, _, _ = made(COLOURS, gamma=2.0, noise=0.01)
    problem = replace(problem, transfer=Transfer("gamma", 2.0, matrix=MIXING))
    at = Candidate.of(problem).result.at
    theta = at.layout.pack(at.state)
    for k in range(at.layout.size):
        h = 1e-4 * np.eye(at.layout.size)[k]
        there, back = at.moved(theta + h), at.moved(theta - h)
        slope = (there.residual - back.residual).reshape(-1) / 2e-4
        assert np.abs(at.jacobian[:, k] - slope).max() < 0.02 * np.abs(slope).max() + 1e-4


def test_no_camera_mixes_colours_so_much():
    """The terms bend to anything: light of other colours at every second tile is no matrix."""
    problem, _, _ = made(COLOURS, gamma=2.0, noise=0.01)
    found = ColourMixing().fitted(Candidate.of(problem))
    assert colour_mixing.is_a_cameras(found)
    wild = ((3.0, -2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    transfer = replace(found.result.state.transfer, matrix=wild)
    found.result.state = replace(found.result.state, transfer=transfer)
    assert not colour_mixing.is_a_cameras(found)


def test_what_helps_one_group_alone_is_told_from_what_helps_all():
    """A board's light was wrong, mixing bent to it (122 nats, room-316): all the others' tiles did not gain."""
    group = np.repeat(np.arange(5), 40)
    off = np.random.default_rng(1).normal(0, 0.003, (200, 3))
    before = likelihood(off, np.full((200, 1), 1e-6))
    one, all_of_them = (
        gain(SimpleNamespace(tile_group=group), likelihood(off * share[:, None], before.variance), before)
        for share in (np.where(group == 2, 0.3, 1.0), np.full(200, 0.7))
    )
    assert one[0] > 20 and abs(one[1]) < 1e-9
    assert all_of_them[0] > 30 and all_of_them[1] > 0.7 * all_of_them[0]


@pytest.mark.parametrize("groups, is_camera", [((1, 2, 3, 4), True), ((2,), False), ((4,), False)])
def test_a_camera_mixes_colours_of_all_groups_in_one_way(groups, is_camera):
    """Where one group's colours alone are mixed, the others' mixing tells nothing of it."""
    problem, _, _ = made(COLOURS, gamma=2.0, noise=0.01)
    camera = replace(problem.transfer, matrix=MIXING)
    mixed = np.isin(problem.tile_group, groups)[np.repeat(np.arange(len(problem.tile_group)), problem.n_pixels)]
    shown = camera.display(problem.transfer.linear(problem.pixels))
    pixels = np.where(mixed[:, None], shown, problem.pixels)
    before = Candidate.of(replace(problem, pixels=pixels, transfer=Transfer("gamma", 2.0)))
    assert ColourMixing().is_physical(ColourMixing().fitted(before), before) == is_camera


def test_sigma_knows_what_mixing_hangs_on_one_group():
    """The light of one group is wrong, so M is: by no more than what leaving that group out changes."""
    problem, _, _ = made(COLOURS, gamma=2.0, noise=0.01)
    camera = replace(problem.transfer, matrix=MIXING)
    group = problem.tile_group[np.repeat(np.arange(len(problem.tile_group)), problem.n_pixels)]
    pixels = camera.display(problem.transfer.linear(problem.pixels))
    bent = pixels + 0.02 * (group == 2)[:, None] * np.sign(pixels - pixels[group == 2].mean(axis=0)) * [1, -1, 1]
    sigma = []
    for values in (pixels, bent):
        mixed = ColourMixing().fitted(Candidate.of(replace(problem, pixels=values, transfer=Transfer("gamma", 2.0))))
        result = gauss_newton(mixed.problem, start=mixed.start)
        sigma.append(np.array(colour_mixing.spread(result.cov_cause)))
        M = colour_mixing.stepped(mixed.problem.transfer.matrix, result.state.cause)
        assert (np.abs(M - MIXING) < 3 * sigma[-1] + 0.01).all()
    assert np.abs(M - MIXING).max() > 0.05 and sigma[1].max() > 3 * sigma[0].max()


def test_sigma_knows_of_colours_in_doubt():
    problem, _, _ = made(COLOURS, gamma=2.0, noise=0.01)
    plain = Candidate.of(problem)
    terms = ColourMixing().terms(plain.problem, plain.result.at, ())
    sure, unsure = (gauss_newton(p).sigma_rho for p in (problem, replace(problem, doubted=terms)))
    assert (unsure >= sure - 1e-12).all() and (unsure > 1.01 * sure).any()


@pytest.mark.parametrize("seed", range(3))
def test_sigma_knows_what_a_narrow_range_does_not_tell(seed):
    """sRGB looks like a gamma of 2.24 where all is nearly as bright: white reflectances are off by as much as that."""
    problem, rho, _ = made(np.array([0.85, 0.8, 0.87, 0.83, 0.82]), gamma=2.0, noise=0, seed=seed)
    light, n = Transfer("gamma", 2.0).linear(problem.pixels), problem.n_pixels[0]
    kept = np.flatnonzero(np.abs(light[::n, 0] - 0.55) < 0.1)
    shown = srgb_from_linear(light.reshape(-1, n, 1)[kept].reshape(-1, 1))
    problem = replace(
        problem,
        G=problem.G[kept],
        G_plain=problem.G_plain[kept],
        D_tile=problem.D_tile[kept],
        tile_group=problem.tile_group[kept],
        tile_object=problem.tile_object[kept],
        start=np.arange(len(kept) + 1) * n,
        pixels=shown + 0.002 * np.random.default_rng(seed).standard_normal(shown.shape),
    )
    doubted = replace(problem, doubted=response.doubted(problem, Candidate.of(problem).result.state))
    off = lambda result: (np.abs(result.state.rho - rho)[1:] / result.sigma_rho[1:]).max()
    assert off(gauss_newton(problem)) > 3 > off(gauss_newton(doubted))


def test_a_function_that_changes_nothing_to_speak_of_is_not_taken():
    """90 nats of a curve that bent to the light between shelves by .0006: errors of the light bring as much."""

    def one(nats, complexity, change):
        evidence = SimpleNamespace(nats=nats, residual=np.full((400, 3), change))
        found = SimpleNamespace(evidence=evidence, complexity=complexity)
        found.is_worth = lambda other: nats - other.evidence.nats > 18
        return found

    simple, bent, other = one(0.0, 1, 0.0), one(90.0, 9, 6e-4), one(90.0, 9, 2e-3)
    assert response.simplest([simple, bent]) is simple and response.unresolved([simple, bent], simple) == 90
    assert response.simplest([simple, other]) is other and response.unresolved([simple, other], simple) == 0


def test_a_curve_is_fitted_only_where_it_may_win():
    """sRGB has no free number and is asked first: a curve that could only be as good costs a fit for nothing."""
    found = Candidate.of(photographed(srgb_from_linear)[0])
    promised = 2 * enough(found.problem, 9)
    assert [c.kind for c in response.fitted(found, promised)] == ["srgb"]
    film = Candidate.of(photographed(lambda light: 0.9 * light**0.55 / (1 - 0.1 * light))[0])
    assert "curve" in {c.kind for c in response.fitted(film, response.promise(film))}
    assert {c.kind for c in response.fitted(found)} == {"curve", "srgb"}  # told functions are compared with all


def photographed(shown, noise=0.01, seed=1, **more):
    """A problem whose photograph went through `shown`, its reflectances, and its light."""
    problem, rho, b = made(COLOURS, noise=noise, seed=seed, transfer="linear", **more)
    pixels = np.round(shown(np.clip(problem.pixels, 0, 1)) * 255) / 255
    start = Transfer("gamma", 2.2)
    return replace(problem, pixels=pixels, transfer=start, fit_transfer=True), rho


@pytest.mark.parametrize("shown, kind", [(lambda B: B ** (1 / 1.8), "gamma"), (film, "curve"), (sigmoid, "curve")])
def test_the_simplest_function_that_the_photograph_supports(shown, kind):
    problem, rho = photographed(shown)
    chosen = explain.explain(problem, Scope(), max_iterations=40)
    assert chosen.problem.transfer.kind == kind and chosen.result.converged
    seen = np.quantile(problem.photograph.linear(chosen.result.state.transfer)[0], (0.01, 0.99))
    light = np.linspace(*seen, 100)
    assert np.abs(chosen.result.state.transfer.display(light) - shown(light)).max() < 0.01
    for taken in chosen.taken:  # `transfer` of materials.json has the curve
        assert chosen.says(taken.cause, chosen.problem, chosen.result) == [(None, {}, None)]


def test_a_function_that_is_told_is_not_replaced_but_its_rival_is_named():
    problem, _ = photographed(sigmoid)
    chosen = explain.explain(problem, Scope(response=False), max_iterations=40)
    assert chosen.problem.transfer.kind == "gamma" and chosen.rivals["curve"] > enough(problem)


def test_evidence_falls_with_a_wrong_function():
    problem, _ = photographed(lambda B: B ** (1 / 2.2))
    nats = {}
    for gamma in (2.2, 2.6):
        told = replace(problem, transfer=Transfer("gamma", gamma), fit_transfer=False)
        nats[gamma] = evidence(told, gauss_newton(told, finish=False).at).nats
    assert nats[2.2] > nats[2.6] + 10


def test_a_curve_in_materials_json_comes_back(tmp_path):
    I = np.linspace(0, 1, 200)
    found = FoundTransfer("curve", linear=tuple(I**2.0), display=tuple(I), sigma=(None,) * 100 + (0.01,) * 100)
    materials.write(tmp_path / "materials.json", Materials("converged", {}, transfer=found))
    read = materials.read(tmp_path / "materials.json").transfer
    np.testing.assert_allclose(read.function.display(LIGHT), LIGHT**0.5, atol=3e-4)
    np.testing.assert_allclose(read.function.linear(LIGHT), LIGHT**2, atol=3e-5)
    assert read.sigma[0] is None and read.sigma[-1] == 0.01


def written(folder, **more):
    """A response that was measured elsewhere, as its file."""
    I = np.linspace(0, 1, 256)
    light = np.interp(I, film(np.linspace(0, 1, 4000)), np.linspace(0, 1, 4000))
    light[-1] = 1.0
    path = folder / "response.json"
    content = {"kind": "curve", "linear": list(light), "display": list(I), "matrix": None, "sigma": None}
    path.write_text(json.dumps(content | more))
    return path


def test_a_measured_response_is_read_from_its_file(tmp_path):
    problem, rho = photographed(film)
    problem = replace(problem, transfer=materials.read_curve(written(tmp_path)), fit_transfer=False)
    chosen = explain.explain(problem, Scope(response=False), max_iterations=40)
    assert chosen.problem.transfer.samples and chosen.result.converged and not chosen.rivals
    np.testing.assert_allclose(chosen.result.state.rho[:2], rho[:2], atol=0.01)


def test_a_measured_response_may_mix_colours(tmp_path):
    function = materials.read_curve(written(tmp_path, matrix=MIXING))
    light = np.random.default_rng(2).uniform(0.05, 0.7, (20, 3))
    np.testing.assert_allclose(function.display(light), film(light @ np.transpose(MIXING)), atol=2e-3)
    np.testing.assert_allclose(function.linear(function.display(light)), light, atol=2e-3)


THREE = {
    "linear": [list(np.linspace(0, 1, 200) ** gamma) for gamma in (1.8, 2.2, 2.6)],
    "display": list(np.linspace(0, 1, 200)),
}


def test_a_measured_response_of_three_channels(tmp_path):
    """Each channel has its curve; the photograph under the green one's shows the same light."""
    function = materials.read_curve(written(tmp_path, **THREE, matrix=MIXING))
    light = np.random.default_rng(2).uniform(0.05, 0.7, (20, 3))
    shown = function.display(light)
    np.testing.assert_allclose(shown, (light @ np.transpose(MIXING)) ** (1 / np.array([1.8, 2.2, 2.6])), atol=2e-3)
    np.testing.assert_allclose(function.linear(shown), light, atol=1e-9)
    np.testing.assert_allclose(function.common.linear(function.in_common(shown)), light, atol=1e-9)
    np.testing.assert_allclose(function.in_common(shown)[..., 1], shown[..., 1], atol=1e-9)
    found = FoundTransfer("curve", linear=tuple(map(tuple, THREE["linear"])), display=tuple(THREE["display"]))
    materials.write(tmp_path / "materials.json", Materials("converged", {}, transfer=found))
    read = materials.read(tmp_path / "materials.json").transfer.function
    np.testing.assert_array_equal(read.display(light), function.bare.display(light))


def test_the_rival_of_a_measured_response_that_is_another_cameras(tmp_path):
    problem, _ = photographed(sigmoid)
    problem = replace(problem, transfer=materials.read_curve(written(tmp_path)), fit_transfer=False)
    assert explain.explain(problem, Scope(response=False), max_iterations=40).rivals["curve"] > enough(problem)


@pytest.mark.parametrize(
    "more, said",
    [
        ({"kind": "gamma", "gamma": 2.2}, "kind: 'gamma'"),
        ({"display": [0, 1]}, "display = [0, 1]"),
        ({"display": list(np.linspace(0, 1, 100))}, "display: 100 values"),
        ({"linear": [list(np.linspace(0, 1, 100))] * 3}, "display: 256 values"),
        ({"linear": [list(np.linspace(0, 1, 256))] * 2}, "linear = "),
        ({"matrix": [[1, 0, 0], [1, 0, 0], [0, 0, 1]]}, "matrix: "),
    ],
)
def test_a_file_that_is_no_curve_is_refused(tmp_path, more, said):
    with pytest.raises(BadInput) as refused:
        materials.read_curve(written(tmp_path, **more))
    assert str(refused.value).startswith(f"{tmp_path / 'response.json'}: {said}")
