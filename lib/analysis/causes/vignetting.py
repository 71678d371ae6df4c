"""Whether the lens is darker towards the corners, and how much: k of lib/given/falloff.py, fitted with the rest."""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace

import numpy as np

from lib.analysis.causes.candidates import Candidate
from lib.analysis.fit.evidence import promised
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import CauseTerms, Problem
from lib.analysis.seen.gather import Gathered
from lib.given.falloff import Lens
from lib.given.transfer import Metric, Transfer
from lib.given.view import View

NAME, TERMS = "vignetting", 3
WIDE = 2.0  # times what lenses have: standard deviations of k before anything is seen
RISES = 0.05  # of V outwards, at most
DEEP = 0.005  # that it falls by, at least: less is what curves leave (.2 % in small-282), and moves no reflectance
STRANGE = 2.0  # of the unit numbers together: the usual cos^4 has .7, and one beside a gamma of 2.03 for 1.64 4.0
LIKELY = 2  # told gammas that one step towards a shadow suits best
# of the unit numbers, round by round of fitting and dividing: at first little more than the usual shape, or a few tiles
# far out pass for outliers and the rest takes any shape
SPREADS = ((0.05, 0.1, 1.0), (0.2, 0.5, 1.0), *((1.0, 1.0, 1.0),) * 8)  # three had left small-2527 half-way
SETTLED = 2e-3  # change of V at the corner that ends them


def divided(pixels, gain, transfer: Transfer) -> np.ndarray:
    """Display values (M, C) as they would be without a gain (M,) of the lens; above white they go on."""
    transfer = transfer.bare  # colours stay mixed
    light = transfer.linear(pixels) / gain[:, None]
    return light if transfer.kind == "linear" else Metric(transfer).value(light)


@functools.cache
def _lenses() -> np.ndarray:
    """(TERMS, 3) k of unit numbers: the root of the mean of k k^T over the shadows that lenses have.

    Trusted tiles seldom reach the corners. What they leave open is what lenses have: V = (1 + t r^2)^-m, cos^4 among
    them, and a barrel that cuts off the edge of the field.
    """
    r2, shadows = np.linspace(0, 1, 101), []
    for t, m, cut, begin in itertools.product((0.1, 0.3, 0.5, 0.7, 0.9), (1.0, 1.5, 2.0), (0.0, 0.2, 0.4), (0.4, 0.7)):
        barrel = 1 - cut * np.clip((np.sqrt(r2) - begin) / (1 - begin), 0, 1) ** 2
        shadows.append((1 + t * r2) ** -m * barrel - 1)
    powers = np.stack([r2 ** (j + 1) for j in range(TERMS)], axis=-1)
    k = np.linalg.lstsq(powers, np.transpose(shadows), rcond=None)[0]
    size, axes = np.linalg.eigh(k @ k.T / len(shadows))
    return WIDE * axes * np.sqrt(size)


def _cause(problem: Problem, at, r2, k=(0.0,) * TERMS) -> CauseTerms:
    """Unit numbers of a change of k, linearised: what is seen, over V, is the light.  k : where the problem stands"""
    gain = 1.0 if problem.gain is None else problem.gain
    share = np.stack([r2 ** (j + 1) for j in range(TERMS)], axis=-1) / gain @ _lenses()  # (T, k)
    columns = at.displayed(at.state.B)[..., None] * share[:, None, :]
    return CauseTerms((NAME,) * TERMS, columns, np.ones(TERMS), -np.linalg.solve(_lenses(), k))


def left_open(problem: Problem, at, lens: Lens, pixel, k) -> CauseTerms:
    """What may be added to k where the photograph was divided by it. pixel : (M,) flat, of the tiles"""
    gain = _means(problem, lens.gain(pixel, k))[:, None]
    return _cause(replace(problem, gain=gain), at, _means(problem, lens.radius2(pixel)), k)


def change(numbers) -> np.ndarray:
    """(TERMS,) of k by the numbers of a fit's terms."""
    return _lenses() @ numbers


def sigma(covariance) -> list:
    """Standard deviations of k by the covariance of the numbers."""
    return np.sqrt(np.diag(_lenses() @ covariance @ _lenses().T)).tolist()


def _means(problem, values):
    """(T,) of values (M,) of the tiles' pixels."""
    return np.add.reduceat(values, problem.start[:-1]) / problem.n_pixels


def promise(found: Candidate, lens: Lens, pixel) -> float:
    """Nats that one step towards a vignetted picture brings. pixel : (M,) flat, of the tiles"""
    cause = _cause(found.problem, found.result.at, _means(found.problem, lens.radius2(pixel)))
    prior = np.diag(1 / cause.spread**2)
    return promised(found.problem, found.result.at, cause.columns, prior=prior).nats - found.evidence.nats


def fitted(found: Candidate, lens: Lens, pixel) -> Candidate:
    """The fit with a vignetted lens; its problem has the lens's gain. `taken` holds k, where that of `found` begins."""
    problem, at = found.problem, found.result.at
    r2, k = _means(problem, lens.radius2(pixel)), found.taken.get(NAME, {"k": np.zeros(TERMS)})["k"]
    start = found.start
    for spread in SPREADS:
        cause = _cause(problem, at, r2, k)._replace(spread=np.array(spread))
        trial = replace(problem, cause=cause.beside(problem.cause))
        result = gauss_newton(trial, start=start, finish=False, tolerance=1e-3, max_iterations=4)
        at, step = result.at, change(result.state.cause[trial.cause.of(NAME)])
        k = k + step
        problem = replace(problem, gain=_means(problem, lens.gain(pixel, k))[:, None])
        start = start._replace(rho=result.state.rho, E=result.state.E, transfer=result.state.transfer)
        if spread is SPREADS[-1] and abs(step.sum()) < SETTLED:
            break
    last = replace(problem, cause=_cause(problem, at, r2, k).beside(problem.cause))
    return Candidate.of(last, found.taken | {NAME: {"k": k, "centre_px": lens.centre}}, start=start)


def fitted_from(found: Candidate, gammas, lens: Lens, pixel) -> Candidate:
    """The same from where one of these gammas suits best: gamma and the lens's shadow share a valley.

    A gamma that was fitted without the shadow may lie far from the truth, and a shadow that suits it, too.
    """
    told = [
        replace(found.problem, transfer=replace(found.problem.transfer, gamma=gamma), fit_transfer=False)
        for gamma in gammas
    ]
    bare = [Candidate.of(p, found.taken) for p in told]
    bare = sorted(bare, key=lambda c: c.evidence.nats + promise(c, lens, pixel))[-LIKELY:]
    best = max((fitted(c, lens, pixel) for c in bare), key=lambda c: c.evidence.nats)
    return fitted(replace(best, problem=replace(best.problem, fit_transfer=True)), lens, pixel)


def _found(candidate: Candidate):
    """(TERMS,) k of a fit."""
    return candidate.taken[NAME]["k"] + change(candidate.result.state.cause[candidate.problem.cause.of(NAME)])


def is_shadow(found: Candidate) -> bool:
    """A lens's shadow deepens outwards, and by more than nothing; else the terms have bent to something else."""
    r2 = np.linspace(0, 1, 101)
    V = 1 + sum(value * r2 ** (j + 1) for j, value in enumerate(_found(found)))
    return bool((V - np.minimum.accumulate(V)).max() < RISES and V.min() < 1 - DEEP)


def is_strange(found: Candidate) -> bool:
    """No lens has such a shadow: it suits a gamma that is wrong."""
    return bool(np.linalg.norm(np.linalg.solve(_lenses(), _found(found))) > STRANGE)


def corrected(gathered: Gathered, lens: Lens, k, transfer: Transfer) -> Gathered:
    """Tiles of the photograph as it would be without the lens's shadow."""
    gain = lens.gain(gathered.tiles.pixel, k)
    return replace(gathered, pixels=divided(gathered.pixels, gain, transfer))


def without(view: View, lens: Lens, k, transfer: Transfer) -> View:
    """The photograph as it would be without the lens's shadow."""
    values = view.photograph.values
    gain = lens.gain(lens.pixels, k)
    flat = divided(values.reshape(-1, values.shape[2]), gain, transfer)
    return replace(view, photograph=replace(view.photograph, values=flat.reshape(values.shape)))
