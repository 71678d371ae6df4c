"""What may be wrong with the picture as a whole: causes that are taken, and facts that do not agree."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import eye_array

from lib.analysis.answer import disagreements, strangers
from lib.analysis.answer.audit import Audit, Energy
from lib.analysis.causes import explain, one_object, search, told_lamps, told_transfer
from lib.analysis.causes.candidates import enough
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import Halves
from lib.analysis.seen.gather import Gathered, Tiles
from lib.given import jpeg
from lib.given.falloff import Lens
from lib.given.materials import Why
from lib.given.transfer import Transfer, srgb_from_linear
from lib.light.form_factors import FormFactorRows
from tests.helpers.made_problems import COLOURS, made

SIZE = 120, 90
LENS = Lens(((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2), SIZE)
K = (-1.05, 0.6, -0.15)


def scattered(problem, seed=0):
    """(M,) flat indices: each tile's pixels stand together somewhere in the picture."""
    n = np.random.default_rng(seed).integers(0, SIZE[0] * SIZE[1] - problem.n_pixels.max(), len(problem.tile_group))
    return np.concatenate([at + np.arange(k) for at, k in zip(n, problem.n_pixels, strict=True)])


def darkened(problem, pixel, k=K):
    """The photograph through a lens that is darker towards the corners."""
    gain = LENS.gain(pixel, k)[:, None]
    return replace(problem, pixels=problem.transfer.display(problem.transfer.linear(problem.pixels) * gain))


def photographed(gamma=2.0, **more):
    problem, rho, _ = made(COLOURS, gamma=gamma, noise=0.01, **more)
    return replace(problem, transfer=Transfer("gamma", gamma)), rho


def test_a_vignetted_lens_is_found_and_taken():
    problem, rho = photographed()
    pixel = scattered(problem)
    found = explain.explain(darkened(problem, pixel), Scope(lens=LENS, pixel=pixel), max_iterations=40)
    assert [t.cause for t in found.taken] == ["vignetting"]
    r2 = np.linspace(0, 1, 20)
    shape = lambda k: sum(value * r2 ** (j + 1) for j, value in enumerate(k))
    assert np.abs(shape(found.values["vignetting"]) - shape(K)).max() < 0.02
    off = np.abs(found.result.state.rho - rho)[1:]
    assert off.max() < 0.01 and (off < 4 * found.result.sigma_rho[1:] + 1e-4).all()


@pytest.mark.parametrize("far", [0, 4])
def test_a_shadow_whose_corners_are_hardly_seen(far):
    """Flat tiles stand in the middle, and a few far out: no outliers. What none sees is as lenses have it."""
    problem, rho = photographed()
    pixel, r2 = scattered(problem), LENS.radius2(np.arange(SIZE[0] * SIZE[1]))
    inner, outer = np.flatnonzero(r2 < 0.4), np.flatnonzero((r2 > 0.7) & (r2 < 0.8))
    tile = np.repeat(np.arange(len(problem.tile_group)), problem.n_pixels)
    pixel = np.where(tile % len(problem.tile_group) < far, outer[pixel % len(outer)], inner[pixel % len(inner)])
    k = (-1.12, 0.8, -0.28)  # cos^4, 37 degrees at the corner
    found = explain.explain(darkened(problem, pixel, k), Scope(lens=LENS, pixel=pixel), max_iterations=40)
    assert [t.cause for t in found.taken] == ["vignetting"]
    V = lambda k, r2: 1 + sum(value * r2 ** (j + 1) for j, value in enumerate(k))
    off = lambda r2: abs(V(found.values["vignetting"], r2) - V(k, r2))
    assert off(0.35) < 0.01 and off(0.75) < (0.02 if far else 0.1) and off(1.0) < 0.2
    assert np.abs(found.result.state.rho - rho)[1:].max() < 0.01


def test_an_object_of_another_material_is_no_cause():
    """One of a group's two objects reflects 1.4 times as much: no gamma, curve or lens is tried for that."""
    problem, _ = photographed()
    thing = np.arange(len(problem.tile_group)) % 2
    other = np.repeat((problem.tile_group == 2) & (thing == 1), problem.n_pixels)[:, None]
    light = problem.transfer.linear(problem.pixels) * np.where(other, 1.4, 1.0)
    problem = replace(problem, tile_object=thing, pixels=problem.transfer.display(light))
    found = explain.explain(problem, Scope(lens=LENS, pixel=scattered(problem)), max_iterations=40)
    assert found.taken == []
    most = max(one_object.objects(problem, found.result), key=lambda one: one.nats)
    assert (most.group, most.thing) == (2, 1) and most.nats > 10 and 1.15 < most.ratio.mean() < 1.5


@pytest.mark.parametrize(("exposure", "named"), [(1.0, True), (0.01, False)])
def test_in_the_dark_an_object_is_of_its_group(exposure, named):
    """A fifth of little light is less than what light in dark corners is off by."""
    problem, _ = photographed()
    thing = np.arange(len(problem.tile_group)) % 2
    other = np.repeat((problem.tile_group == 2) & (thing == 1), problem.n_pixels)[:, None]
    light = exposure * problem.transfer.linear(problem.pixels) * np.where(other, 1.4, 1.0)
    emittance = exposure * problem.emittance
    shown = replace(problem, tile_object=thing, emittance=emittance, pixels=problem.transfer.display(light))
    assert bool(one_object.objects(shown, search.started(shown, Scope()).result)) == named


def test_an_object_of_nearly_the_same_material_is_named_where_nothing_else_is():
    """A crate with a wall's material, 3 % off: it was refused as unknown (room-902)."""
    problem, _ = photographed()
    thing = np.arange(len(problem.tile_group)) % 2
    other = np.repeat((problem.tile_group == 2) & (thing == 1), problem.n_pixels)[:, None]
    shown = lambda times: replace(
        problem,
        tile_object=thing,
        pixels=problem.transfer.display(problem.transfer.linear(problem.pixels) * np.where(other, times, 1.0)),
    )
    slight, exact = (search.as_given(shown(times), max_iterations=40) for times in (1.05, 1.0))
    assert one_object.objects(slight.problem, slight.result) == []
    owner = lambda: np.arange(len(problem.patch_group)) % 2
    fitted = SimpleNamespace(fit=np.ones(2, bool), chain=np.zeros(2), group=np.full(2, 2), object=np.arange(2))
    own = SimpleNamespace(misfits=lambda *_: {}, flagged=lambda *_: [])
    plain = SimpleNamespace(with_group=lambda *_: own, given={}, subcell=None, tiles=fitted)
    named = strangers.alone_unlike(slight, plain, owner, lambda: ["box", "crate"])
    assert [why.cause for why in named] == ["group_wrong"] and ("1.05" in named[0].text or "0.95" in named[0].text)
    assert strangers.alone_unlike(exact, plain, owner, lambda: ["box", "crate"]) == []


def audited(problem, thing) -> Audit:
    """All pixels of a made problem's tiles. thing : (T,) their objects"""
    none, T = np.zeros(0), len(problem.tile_group)
    tiles = Tiles(problem.tile_group, problem.start, none, problem.D_tile, FormFactorRows.dense(problem.G.toarray()))
    found = Gathered(
        tiles, problem.pixels, problem.tile_group, thing, np.ones(6), False, 3, 0.0, np.zeros(T), np.zeros(3), False
    )
    return Audit(found, eye_array(6).tocsr(), {}, 0.0125)


@pytest.mark.parametrize(("times", "named"), [(1.5, True), ((0.5, 1.0, 1.6), True), (1.1, False), (1.0, False)])
def test_an_object_without_a_trusted_tile_is_named_by_the_pixels_of_the_audit(times, named):
    """small-901's thing had none: the fit bent to the light that it threw, and the last audit alone named it."""
    fitted, _ = photographed()
    shown, _ = photographed(seed=1)
    thing = np.arange(len(shown.tile_group)) % 2
    other = np.repeat((shown.tile_group == 2) & (thing == 1), shown.n_pixels)[:, None]
    light = shown.transfer.linear(shown.pixels) * np.where(other, times, 1.0)
    audit = audited(replace(shown, pixels=shown.transfer.display(light)), thing)
    found = search.as_given(fitted, max_iterations=40)
    one = strangers.unlike_in_audit(found, audit)
    why = strangers.alone_unlike(found, audit, lambda: np.zeros(6), lambda: ["box", "crate"], max_iterations=40)
    assert [w.subject for w in why] == ["crate"] * named
    if named:
        assert (one.group, one.thing) == (2, 1) and np.allclose(one.ratio, times, rtol=0.02)
        ratio = [float(v) for v in why[0].text.split("reflects ")[1].split(" times")[0].split(", ")]
        assert np.allclose(ratio, times, atol=0.02)
    else:
        assert one is None


@pytest.mark.parametrize("times", [1.05, 0.8, (1.2, 1.0, 0.9)])
def test_lamps_that_are_told_wrongly_promise_more_than_any_cause(times):
    problem, _ = photographed()
    pixel = scattered(problem)
    scope = Scope(lens=LENS, pixel=pixel)
    wrong = replace(problem, emittance=problem.emittance * times)
    found = {"right": problem, "wrong": wrong, "dark": darkened(problem, pixel)}
    first = {name: search.started(one, scope) for name, one in found.items()}
    promised = {name: search.promises(one, scope) for name, one in first.items()}
    alone = lambda name: told_lamps.lamps_alone(first[name], promised[name], scope.response)
    assert max(promised["right"].values()) < 10
    assert max(promised["dark"], key=promised["dark"].get) == "vignetting"
    assert max(promised["wrong"], key=promised["wrong"].get) == told_lamps.NAME
    assert alone("right") is None is alone("dark")
    found = alone("wrong").result.state.E
    assert np.abs(found / problem.emittance - 1).max() < 0.02


@pytest.mark.parametrize("free", [True, False])
def test_srgb_is_no_lamp_that_is_told_wrongly(free):
    """Lamps bend to a function that is not the camera's; sRGB has no free number, so it goes first where it may."""
    problem, _ = photographed()
    shown = replace(problem, pixels=srgb_from_linear(problem.transfer.linear(problem.pixels)))
    scope = Scope(response=free)
    first = search.started(shown, scope)
    gain = told_lamps.lamps_alone(first, {told_lamps.NAME: 0.0}, False)
    assert gain is not None  # the lamps bend
    promised = {told_lamps.NAME: gain.evidence.nats - first.evidence.nats, "response": enough(shown)}
    assert (told_lamps.lamps_alone(first, promised, scope.response) is None) == free


def test_what_a_table_leaves_is_not_held_against_a_lamp():
    """A mirror's own pixels differ by far more than what a lamp that was moved explains; a small group's by less."""
    before = Energy(flagged=0.2, all=1.0)
    assert before.is_explained_by(Energy(0.2, 0.4)) and not before.is_explained_by(Energy(0.2, 0.9))
    assert Energy(8, 9).is_explained_by(Energy(2, 8)) and not Energy(8, 9).is_explained_by(Energy(7, 7.5))
    assert Energy(0, 0).is_explained_by(Energy(0, 0))


def test_a_clean_lens_takes_no_cause():
    problem, _ = photographed()
    pixel = scattered(problem)
    assert explain.explain(problem, Scope(lens=LENS, pixel=pixel), max_iterations=40).taken == []


def test_without_scope_nothing_is_taken():
    problem, _ = photographed()
    pixel = scattered(problem)
    scope = Scope(allowed=("curve",), lens=LENS, pixel=pixel)
    assert "vignetting" not in explain.explain(darkened(problem, pixel), scope, max_iterations=40).values


@pytest.mark.parametrize("factor, cause", [((1.3, 1.3, 1.3), "lamp_power"), ((1.3, 1.0, 0.8), "lamp_colour")])
def test_a_lamp_that_is_not_as_told_is_named(factor, cause):
    problem, _ = photographed()
    problem = replace(problem, emittance=problem.emittance * factor)
    result = gauss_newton(problem)
    why = told_lamps.lamps(problem, result)
    assert [(w.cause, w.subject) for w in why] == [(cause, "lamp")]


def test_lamps_as_told_are_not_doubted():
    for seed in range(10):
        problem, _ = photographed(seed=seed)
        assert told_lamps.lamps(problem, gauss_newton(problem)) == []


def test_what_neighbours_have_in_common_is_no_noise():
    """Sigma grows where the model errs over whole surfaces, and not where pixels are noisy."""
    problem, _ = photographed()
    problem = replace(problem, halves=Halves(problem.G, problem.G, problem.F, problem.F))
    shade = np.repeat(np.sin(np.linspace(0, 12, len(problem.tile_group))), problem.n_pixels)[:, None]
    wrong = replace(problem, pixels=problem.pixels * (1 + 0.02 * shade))
    clean, off = gauss_newton(problem), gauss_newton(wrong)
    assert clean.fits
    assert off.correlated > 3 * max(clean.correlated, 0.1)
    assert np.nanmedian(off.sigma_rho[1:] / clean.sigma_rho[1:]) > 2


def test_jpeg_says_how_much_it_rounds():
    import cv2

    random = np.random.default_rng(0)
    smooth = cv2.resize(random.uniform(60, 190, (6, 8, 3)), (256, 192), interpolation=cv2.INTER_CUBIC)
    smooth = np.clip(smooth, 0, 255)
    measured = []
    for quality in (95, 80, 50):
        data = cv2.imencode(".jpg", smooth.round().astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        error = (cv2.imdecode(data, cv2.IMREAD_COLOR) - smooth) / 255
        blocks = error.reshape(24, 8, 32, 8, 3).mean(axis=(1, 3))
        measured.append(jpeg.blocks(data.tobytes()).noise / blocks.std())
    assert all(0.5 < ratio < 4 for ratio in measured), measured
    assert jpeg.blocks(b"\x89PNG") is None


def test_no_wrong_minimum_of_gamma():
    """Dark, normal and bright photographs of any gamma: none ends in another valley or takes a curve."""
    for seed in range(20):
        random = np.random.default_rng(seed)
        gamma, light = random.uniform(1, 2.8), 1.5 * np.exp(random.uniform(np.log(0.05), np.log(1.5)))
        problem, _, _ = made(COLOURS, gamma=gamma, noise=0.01, E=(light,), seed=seed)
        rounded = np.round(np.clip(problem.pixels, 0, 1) * 65535) / 65535
        problem = replace(problem, transfer=Transfer("gamma", 2.2), pixels=rounded)
        found = explain.explain(problem, Scope(allowed=("curve",)), gamma=2.2, max_iterations=40).result
        assert found.state.transfer.kind == "gamma"
        assert abs(found.state.gamma - gamma) < max(0.02 * gamma, 4 * found.sigma_gamma), (seed, gamma)


@pytest.mark.parametrize("off", [0.0, 0.01, 0.04])
def test_what_a_told_gamma_may_be_off_by_is_in_sigma(off):
    """Tiles would rather have another, by less than what is named (.01) or by more (.04): sigma holds the truth."""
    problem, rho, _ = made(COLOURS, gamma=2.0, noise=0.02, tiles=12)
    asked, told = {"gamma": 2.0 + off}, replace(problem, transfer=Transfer("gamma", 2.0 + off), fit_transfer=False)
    result = gauss_newton(told)
    z = lambda: (np.abs(result.state.rho - rho)[1:] / result.sigma_rho[1:]).max()
    before, seen = z(), SimpleNamespace(linear=False, pixels=told.pixels)
    named = disagreements.disagreements(told, result, seen, asked, {})
    assert [w.cause for w in named] == (["transfer"] if off > 0.02 else [])
    told_transfer.doubt_told(told, result, asked)
    assert (before > 4) == (off > 0) and z() < 3
    free = gauss_newton(replace(told, fit_transfer=True))
    assert off > 0 or result.sigma_rho.mean() < 1.05 * free.sigma_rho.mean()  # no less sure than without it


def through_a_curve(problem, shape):
    """The photograph of a camera with another response."""
    return replace(problem, pixels=shape(problem.transfer.linear(problem.pixels)))


def test_a_told_lamp_that_is_wrong_does_not_hide_behind_a_curve():
    problem, _ = photographed()
    pixel = scattered(problem)
    scope = Scope(lens=LENS, pixel=pixel)
    told = replace(darkened(problem, pixel), emittance=problem.emittance * 1.3)
    found = explain.explain(told, scope, max_iterations=40)
    why = explain.lamps_told_wrong(found, scope)
    assert [(w.cause, w.subject) for w in why] == [("lamp_power", "lamp")]
    assert why[0].text == "lamp 'lamp': 0.769 times its emittance explains the photograph without curve"


def test_a_lamp_as_told_is_not_doubted_beside_a_curve():
    problem, _ = photographed()
    pixel = scattered(problem)
    scope = Scope(lens=LENS, pixel=pixel)
    film = lambda linear: np.clip(linear, 0, 1) ** 0.45 * (1.25 - 0.25 * np.clip(linear, 0, 1))
    for deviating in (through_a_curve(problem, film), darkened(problem, pixel)):
        found = explain.explain(deviating, scope, max_iterations=40)
        assert found.taken and explain.lamps_told_wrong(found, scope) == []


def test_what_is_displaced_tells_what_was_unknown():
    unknown, missing, colour = (
        Why(c, None, c, n) for c, n in (("unknown", None), ("object_missing", 20.0), ("lamp", 30.0))
    )
    assert disagreements.joined([unknown], []) == [unknown]
    assert disagreements.joined([unknown], [missing]) == [missing]
    assert disagreements.joined([colour], [missing]) == [colour, missing] == disagreements.joined([missing], [colour])
