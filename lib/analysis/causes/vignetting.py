"""Whether the lens is darker towards the corners, and how much: k of lib/given/falloff.py, fitted with the rest."""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace

import numpy as np

from lib.analysis.causes import gammas
from lib.analysis.causes.candidates import Candidate
from lib.analysis.causes.cause import Cause, Rounds, Tried, believed
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.facts import USUAL_GAMMA
from lib.analysis.fit.problem import CauseTerms, Problem
from lib.analysis.seen.gather import Gathered
from lib.given.falloff import Lens
from lib.given.transfer import Metric, Transfer
from lib.given.view import View

TERMS = 3  # powers of the squared radius
TIMES_USUAL = 2.0  # The spread of k before anything is seen, in the spread that lenses have.
MOST_RISE = 0.05  # V of a shadow may rise outwards by so much.
LEAST_DEPTH = (
    0.005  # V of a shadow falls by so much. Curves leave less (.2 % in small-282), and that moves no reflectance.
)
# No lens has unit numbers that are longer. The usual cos^4 has .7; one beside a gamma of 2.03 for 1.64 had 4.0.
STRANGE_FROM = 2.0
FITTED_GAMMAS = 2  # Of all gammas to begin at, so many are fitted with a shadow: those that one step suits best.
# of the unit numbers, round by round of fitting and dividing: at first little more than the usual shape, or a few tiles
# far out pass for outliers and the rest takes any shape
SPREADS = ((0.05, 0.1, 1.0), (0.2, 0.5, 1.0))
MOST_OF_LENS = 10.0  # standard deviation of k that tells nothing


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
    return TIMES_USUAL * axes * np.sqrt(size)


class Vignetting(Cause):
    """A lens that is darker towards the corners: k of V = 1 + k1 r^2 + k2 r^4 + k3 r^6."""

    name = "vignetting"
    is_of_camera = True
    rounds = Rounds(most=10, inner=4, settled=2e-3, tight=len(SPREADS))  # three had left small-2527 half-way

    def __init__(self, lens: Lens, pixel):
        """pixel : (M,) flat, of the tiles"""
        self.lens, self.pixel = lens, pixel

    @classmethod
    def of(cls, scope: Scope):
        return cls(scope.lens, scope.pixel) if scope.lens is not None and cls.name in scope.allowed else None

    def none(self):
        return np.zeros(TERMS)

    def terms(self, problem: Problem, at, values) -> CauseTerms:
        """Unit numbers of a change of k: what is seen, over V, is the light."""
        gain, r2 = 1.0 if problem.gain is None else problem.gain, _means(problem, self.lens.radius2(self.pixel))
        share = np.stack([r2 ** (j + 1) for j in range(TERMS)], axis=-1) / gain @ _lenses()  # (T, k)
        columns = at.displayed(at.state.B)[..., None] * share[:, None, :]
        return CauseTerms((self.name,) * TERMS, columns, np.ones(TERMS), -np.linalg.solve(_lenses(), values))

    def spread(self, round, terms):
        return terms if round >= len(SPREADS) else terms._replace(spread=np.array(SPREADS[round]))

    def moved(self, values, step):
        return values + change(step)

    def standing(self, problem: Problem, values) -> Problem:
        gain = _means(problem, self.lens.gain(self.pixel, values))[:, None] if np.any(values) else None
        return replace(problem, gain=gain)

    def length(self, step):
        """Change of V at the corner."""
        return abs(change(step).sum())

    def tried(self, found: Candidate, promised) -> Tried:
        first = self.fitted(found)
        if not gammas.is_stuck(first, found) and not (gammas.searched(first) and is_strange(k_of(first))):
            return Tried(first)
        other = self.fitted_from(found, (*gammas.STARTS, USUAL_GAMMA))
        return Tried(max(first, other, key=lambda c: c.evidence.nats))

    def fitted_from(self, found: Candidate, gammas) -> Candidate:
        """The fit from where one of these gammas suits best: gamma and the lens's shadow share a valley.

        A gamma that was fitted without the shadow may lie far from the truth, and a shadow that suits it, too.
        """
        told = [
            replace(found.problem, transfer=replace(found.problem.transfer, gamma=gamma), fit_transfer=False)
            for gamma in gammas
        ]
        bare = [Candidate.of(p, found.taken) for p in told]
        bare = sorted(bare, key=lambda c: c.evidence.nats + self.promise(c))[-FITTED_GAMMAS:]
        best = max((self.fitted(c) for c in bare), key=lambda c: c.evidence.nats)
        return self.fitted(replace(best, problem=replace(best.problem, fit_transfer=True), asked={}))

    def is_physical(self, fitted: Candidate, before: Candidate) -> bool:
        return is_shadow(k_of(fitted))

    def evened(self, gathered: Gathered, values, transfer) -> Gathered:
        gain = self.lens.gain(gathered.tiles.pixel, values)
        return replace(gathered, pixels=divided(gathered.pixels, gain, transfer))

    def undone(self, view: View, values, transfer) -> View:
        shown = view.photograph.values
        flat = divided(shown.reshape(-1, shown.shape[2]), self.lens.gain(self.lens.pixels, values), transfer)
        return replace(view, photograph=replace(view.photograph, values=flat.reshape(shown.shape)))

    def says(self, values, problem, result):
        if result.cov_cause is None or not (own := problem.cause.of(self.name)).any():
            return [(None, self._named(values), None)]
        k = values + change(result.state.cause[own])
        spread = believed(sigma(result.cov_cause[np.ix_(own, own)]), MOST_OF_LENS)
        return [(None, self._named(k), spread and {"k": spread})]

    def _named(self, k):
        return {"k": list(map(float, k)), "centre_px": list(self.lens.centre)}


def k_of(found: Candidate) -> np.ndarray:
    """(TERMS,) k of a fit."""
    own = found.problem.cause.of(Vignetting.name)
    return found.taken[Vignetting.name] + change(found.result.state.cause[own])


def is_shadow(k) -> bool:
    """A lens's shadow deepens outwards, and by more than nothing; else the terms have bent to something else."""
    r2 = np.linspace(0, 1, 101)
    V = 1 + sum(value * r2 ** (j + 1) for j, value in enumerate(k))
    return bool((V - np.minimum.accumulate(V)).max() < MOST_RISE and V.min() < 1 - LEAST_DEPTH)


def is_strange(k) -> bool:
    """No lens has such a shadow: it suits a gamma that is wrong."""
    return bool(np.linalg.norm(np.linalg.solve(_lenses(), k)) > STRANGE_FROM)


def change(numbers) -> np.ndarray:
    """(TERMS,) of k by the numbers of a fit's terms."""
    return _lenses() @ numbers


def sigma(covariance) -> list:
    """Standard deviations of k by the covariance of the numbers."""
    return np.sqrt(np.diag(_lenses() @ covariance @ _lenses().T)).tolist()


def _means(problem, values):
    """(T,) of values (M,) of the tiles' pixels."""
    return np.add.reduceat(values, problem.start[:-1]) / problem.n_pixels
