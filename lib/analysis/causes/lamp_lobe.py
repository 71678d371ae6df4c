"""Whether lamps throw their light in lobes: aim and exponent of max(0, cos)^exponent, fitted with the rest.

The lambertian lamp's light at each patch and tile takes the lobe's share (lib/light/throws.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.fit.equations import Equations, Layout, Unknowns
from lib.analysis.fit.evidence import evidence, promised
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import CauseTerms, Problem, Result
from lib.analysis.fit.transport import TileLight
from lib.analysis.seen.gather import Gathered
from lib.given.materials import Why
from lib.given.view import View
from lib.light import surface as surfaces
from lib.light import throws
from lib.light.balance import reflected, times
from lib.light.factors_file import FormFactors
from lib.light.throws import Throws

NAME = "lamp_lobe"
LEAST, MOST = 0.05, 100.0  # exponents: what is flatter or sharper is no lobe that a photograph tells of
FLAT = 1.5  # times the least exponent, up to which a lobe is none
SPREAD = np.array([0.5, 0.5, 1.0])  # of a step: two turns of the aim, rad, and the exponent's logarithm
UNEVEN = 1.0  # standard deviation of each number of 1 + a . direction
FADES = 0.3  # of the mean light, the least that uneven light is taken to have left
ALL_WRONG = 0.3  # of the typical residual, below which told lobes are all that is wrong
FIRST = (1.0, 3.0)  # exponents to begin with
SETTLES = 0.2  # of the typical residual: what leaves no more needs no other start
ROUNDS, SETTLED, INNER = 20, 5e-3, 2
SHARES = 1.0, 0.3, 0.1, 0.03  # of a step, until one lowers the error: far away lobes are no lines
# rounds after which the error must have fallen to such a share, and below such a share of what it was without lobes
PATIENCE, GAINS, HOPE = 3, 0.98, 0.9


@dataclass(frozen=True, eq=False)
class LampLobes:
    """The ways of the lamps' light to the patches and the tiles of a scene whose lamps are lambertian in `factors`.

    wanted : names of the lamps that may have a lobe;  asked : scene.yaml asks for one
    """

    view: Callable[[], View]
    factors: FormFactors
    found: Gathered
    wanted: tuple
    asked: bool = False

    @cached_property
    def ways(self) -> dict[str, tuple[Throws, Throws]]:
        """{lamp: to the patches, to the tiles}."""
        view = self.view()
        surface = surfaces.surface(view.model, self.factors.lamps)
        return {
            lamp: (
                throws.to_patches(surface, self.factors, lamp),
                to_tiles(surface, view.camera, self.found, lamp),
            )
            for lamp in self.wanted
        }

    def problem(self, problem: Problem, lobes) -> Problem:
        """The same where lamps have these lobes, {name: (4,)}, and no others."""
        D, D_tile = self.factors.lamp_factor.copy(), self.found.tiles.direct.copy()
        for lamp, lobe in lobes.items():
            k = problem.lamps.index(lamp)
            D[:, k] *= self.ways[lamp][0].share(lobe)
            D_tile[:, k] *= self.ways[lamp][1].share(lobe)
        return replace(problem, D=D, D_tile=D_tile)

    def columns(self, at: Equations, lamp, slopes):
        """(T, C, m) derivatives of the display residual. slopes : those (N, m), (T, m) of the shares of a lamp"""
        problem, state = at.problem, at.state
        k, m = problem.lamps.index(lamp), slopes[0].shape[1]
        E, C = state.E[k], problem.channels
        lambertian = self.factors.lamp_factor[:, k, None], self.found.tiles.direct[:, k, None]
        by_lamp = [s * D for s, D in zip(slopes, lambertian, strict=True)]
        first, seen = ((s[:, :, None] * E).reshape(len(s), m * C) for s in by_lamp)
        rho = np.tile(state.rho[problem.patch_group], m)
        b = reflected(at.light.matrices.F, rho, rho * first, tolerance=1e-3).b
        B = np.tile(state.rho[problem.tile_group], m) * (seen + times([problem.G], b))
        return at.displayed(B.reshape(len(B), m, C).transpose(0, 2, 1))

    def uneven(self, at: Equations) -> CauseTerms:
        """Light that is 1 + a . direction in place of lambertian, of each lamp: the first step towards any lobe."""
        columns = [self.columns(at, lamp, [way.moments() for way in self.ways[lamp]]) for lamp in self.wanted]
        n = len(columns)
        return CauseTerms((NAME,) * 3 * n, np.concatenate(columns, axis=-1), np.full(3 * n, UNEVEN))

    def like(self, lamp, a, exponent):
        """(4,) the lobe that changes as 1 + a . direction does, about the mean direction of the light."""
        to_patches, to_tiles = (way.moments().sum(axis=0) for way in self.ways[lamp])
        middle = to_tiles if to_tiles.any() else to_patches  # no tile need see the lamp
        middle = middle / max(np.linalg.norm(middle), 1e-12)
        slope = (a - (a @ middle) * middle) / max(1 + a @ middle, FADES)
        aim = middle + slope / exponent
        return np.append(aim / max(np.linalg.norm(aim), 1e-12), exponent)

    def cause(self, at: Equations, lobes) -> CauseTerms:
        """Turns and exponents of all lobes, linearised at equations of this very light."""
        columns = []
        for lamp, lobe in lobes.items():
            slopes = [way.slopes(lobe, across(lobe)) for way in self.ways[lamp]]
            columns.append(self.columns(at, lamp, slopes))
        return CauseTerms((NAME,) * 3 * len(lobes), np.concatenate(columns, axis=-1), np.tile(SPREAD, len(lobes)))


def told_wrong(found: Candidate, lobes: LampLobes, told) -> tuple[list[Why], bool]:
    """A line for each lamp whose lobe is told, where others fit far better; and whether they are all that is wrong.

    found : the fit under the given facts;  told : {lamp: (4,)}
    """
    terms = lobes.cause(found.result.at, told)
    prior = np.diag(1 / terms.spread**2)
    promise = promised(found.problem, found.result.at, terms.columns, prior=prior).nats - found.evidence.nats
    if promise < enough(found.problem):
        return [], False
    other = fitted(found, lobes, told)
    gain = other.evidence.nats - found.evidence.nats
    if gain < enough(found.problem):
        return [], False
    why = []
    for lamp, lobe in other.taken[NAME].items():
        aim = ", ".join(f"{v:.2f}" for v in lobe[:3])
        text = f"lamp {lamp!r}: a lobe cos^{lobe[3]:.2f} about ({aim}) fits the photograph better by {gain:.0f} nats"
        why.append(Why(NAME, lamp, text, float(gain)))
    return why, other.typical < ALL_WRONG * found.typical


def to_tiles(surface, camera, found: Gathered, lamp) -> Throws:
    """From a lamp to some pixels of each tile."""
    tiles = found.tiles
    n, places = np.diff(tiles.start), (np.arange(throws.PLACES) + 0.5) / throws.PLACES
    pixel = tiles.pixel[tiles.start[:-1, None] + (n[:, None] * places).astype(np.int64)]
    p, side = surfaces.backproject(surface, camera, np.repeat(tiles.facet, throws.PLACES), pixel.ravel())
    normal = surfaces.side_normals(surface)[side[:: throws.PLACES]]
    return throws.throws(surface, lamp, p.reshape(len(n), throws.PLACES, 3), normal)


def in_lobes(view: View, factors: FormFactors, lobes, *gathered: Gathered):
    """(factors, *gathered) of a scene whose lamps throw their light in lobes {name: (4,)}."""
    surface = surfaces.surface(view.model, factors.lamps)
    result = [throws.in_lobes(factors, surface, lobes)]
    for found in gathered:
        direct = found.tiles.direct.copy()
        for lamp, lobe in lobes.items():
            direct[:, factors.lamps.index(lamp)] *= to_tiles(surface, view.camera, found, lamp).share(lobe)
        result.append(replace(found, tiles=replace(found.tiles, direct=direct)))
    return result


def across(lobe):
    """(2, 3) unit directions in which the aim may turn."""
    aim = lobe[:3]
    one = np.cross(aim, np.eye(3)[np.abs(aim).argmin()])
    one /= np.linalg.norm(one)
    return np.stack([one, np.cross(aim, one)])


def moved(lobe, step):
    """(4,) after two turns, rad, and a step of the exponent's logarithm."""
    aim = lobe[:3] + np.tan(np.clip(step[:2], -0.5, 0.5)) @ across(lobe)
    exponent = np.clip(lobe[3] * np.exp(np.clip(step[2], -1, 1)), LEAST, MOST)
    return np.append(aim / np.linalg.norm(aim), exponent)


def stepped(lobes, terms: CauseTerms, cause):
    """Lobes {lamp: (4,)} after the last steps (k,) of a fit with these terms."""
    steps = cause[terms.of(NAME)].reshape(-1, 3)
    return {lamp: moved(lobe, step) for (lamp, lobe), step in zip(lobes.items(), steps, strict=True)}


def uneven(found: Candidate, lobes: LampLobes) -> Candidate:
    """The fit with light that is 1 + a . direction, from which any lobe shows. `taken` holds a, {lamp: (3,)}."""
    terms = lobes.uneven(found.result.at).beside(found.problem.cause)
    problem = replace(found.problem, cause=terms)
    result = gauss_newton(problem, start=found.start, finish=False, tolerance=1e-2, max_iterations=12)
    a = result.state.cause[terms.of(NAME)].reshape(-1, 3)
    return Candidate(problem, result, evidence(problem, result.at), dict(zip(lobes.wanted, a, strict=True)))


def begun(found: Candidate, first: Candidate, lobes: LampLobes) -> Candidate:
    """The fit with a lobe of each lamp, from where uneven light points. first : of `uneven`"""
    tried = []
    for n in FIRST:
        tried.append(fitted(found, lobes, {lamp: lobes.like(lamp, a, n) for lamp, a in first.taken.items()}))
        if tried[-1].typical < SETTLES * found.typical:
            break
    return max(tried, key=lambda c: c.evidence.nats)


def fitted(found: Candidate, lobes: LampLobes, more=None) -> Candidate:
    """The fit with lobes where they suit best: those of `found`, and more {lamp: (4,)}. `taken` holds them."""
    lobes_at, start, others = (
        found.taken.get(NAME, {}) | (more or {}),
        found.start,
        found.problem.cause and found.problem.cause.without(NAME),
    )
    base = replace(found.problem, cause=others)
    at = _plain(lobes.problem(base, lobes_at), start)
    errors, enough = [_error(at)], HOPE * np.abs(found.result.tile_residual).mean()
    while len(errors) < ROUNDS and (len(errors) <= PATIENCE or errors[-1] < min(GAINS * errors[-1 - PATIENCE], enough)):
        trial = replace(at.problem, cause=lobes.cause(at, lobes_at).beside(others))
        result = gauss_newton(trial, start=start, finish=False, tolerance=1e-3, max_iterations=INNER)
        for share in SHARES:
            there, begin = stepped(lobes_at, trial.cause, share * result.state.cause), _part_way(start, result, share)
            after = _plain(lobes.problem(base, there), begin)
            if _error(after) < errors[-1]:
                break
        else:
            break
        lobes_at, start, at = there, begin, after
        errors.append(_error(at))
        if share * np.abs(result.state.cause[trial.cause.of(NAME)]).max() < SETTLED:
            break
    last = replace(at.problem, cause=lobes.cause(at, lobes_at).beside(others))
    return Candidate.of(last, found.taken | {NAME: lobes_at}, start=start)


def is_flat(found: Candidate) -> bool:
    """Lamps that are lambertian, or next to it: their lobes have run into the least exponent."""
    return all(lobe[3] <= FLAT * LEAST for lobe in found.taken[NAME].values())


def _part_way(start: Unknowns, result: Result, share) -> Unknowns:
    """From `start` towards where a fit ended."""
    state, between = result.state, lambda a, b: a + share * (b - a)
    transfer = state.transfer.moved(between(start.transfer.parameters, state.transfer.parameters))
    return start._replace(rho=between(start.rho, state.rho), E=between(start.E, state.E), transfer=transfer)


def _error(at: Equations):
    """Mean display error of the tiles: outliers have no more than their share."""
    return np.abs(at.residual).mean()


def _plain(problem, start) -> Equations:
    """The equations without a cause, where a fit ended."""
    problem = replace(problem, cause=None)
    return Equations(problem, TileLight(problem), Layout.of(problem), start._replace(cause=None))
