"""Whether lamps throw their light in lobes: aim and exponent of max(0, cos)^exponent, fitted with the rest.

The lambertian lamp's light at each patch and tile takes the lobe's share (lib/light/throws.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.cause import Cause, Rounds, believed
from lib.analysis.fit.equations import Equations
from lib.analysis.fit.evidence import evidence, promised
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import CauseTerms, Problem, Result
from lib.analysis.seen.gather import Gathered
from lib.given.materials import Why
from lib.given.view import View
from lib.light import surface as surfaces
from lib.light import throws
from lib.light.balance import reflected, times
from lib.light.factors_file import FormFactors
from lib.light.throws import Throws

LEAST_EXPONENT, MOST_EXPONENT = 0.05, 100.0  # Flatter or sharper lobes are none that a photograph tells of.
FLAT_UP_TO = 1.5  # A lobe is none up to so many times the least exponent.
# Standard deviations of a step: two turns of the aim, rad, and the exponent's logarithm.
STEP_SPREAD = np.array([0.5, 0.5, 1.0])
UNEVEN_SPREAD = 1.0  # Standard deviation of each number of 1 + a . direction.
LEAST_LEFT = 0.3  # Uneven light is taken to have left at least so much of the mean light.
ALL_WRONG_BELOW = 0.3  # Told lobes are all that is wrong if others leave less than so much of the typical residual.
FIRST_EXPONENTS = (1.0, 3.0)  # The search begins at these exponents.
NO_OTHER_START = 0.2  # No other start is tried if a fit leaves less than so much of the typical residual.


@dataclass(frozen=True, eq=False)
class LampLobe(Cause):
    """Lamps that throw their light in lobes. Its values: {lamp: (4,) unit aim and exponent}.

    It holds the ways of the light to the patches and the tiles of a scene whose lamps are lambertian in `factors`.

    wanted : names of the lamps that may have a lobe;  asked : scene.yaml asks for one
    """

    view: Callable[[], View]
    factors: FormFactors
    found: Gathered
    wanted: tuple
    asked: bool = False

    name = "lamp_lobe"
    by_one_step = False  # rays have to tell where the light goes
    # far away lobes are no lines
    rounds = Rounds(most=19, inner=2, settled=5e-3, shares=(1.0, 0.3, 0.1, 0.03), patience=3, gains=0.98, hope=0.9)

    def none(self):
        return {}

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

    def standing(self, problem: Problem, lobes) -> Problem:
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
        return CauseTerms((self.name,) * 3 * n, np.concatenate(columns, axis=-1), np.full(3 * n, UNEVEN_SPREAD))

    def like(self, lamp, a, exponent):
        """(4,) the lobe that changes as 1 + a . direction does, about the mean direction of the light."""
        to_patches, to_tiles = (way.moments().sum(axis=0) for way in self.ways[lamp])
        middle = to_tiles if to_tiles.any() else to_patches  # no tile need see the lamp
        middle = middle / max(np.linalg.norm(middle), 1e-12)
        slope = (a - (a @ middle) * middle) / max(1 + a @ middle, LEAST_LEFT)
        aim = middle + slope / exponent
        return np.append(aim / max(np.linalg.norm(aim), 1e-12), exponent)

    def terms(self, problem, at: Equations, lobes) -> CauseTerms:
        """Turns and exponents of all lobes."""
        columns = []
        for lamp, lobe in lobes.items():
            slopes = [way.slopes(lobe, across(lobe)) for way in self.ways[lamp]]
            columns.append(self.columns(at, lamp, slopes))
        return CauseTerms(
            (self.name,) * 3 * len(lobes), np.concatenate(columns, axis=-1), np.tile(STEP_SPREAD, len(lobes))
        )

    def moved(self, lobes, step):
        return {lamp: moved(lobe, one) for (lamp, lobe), one in zip(lobes.items(), step.reshape(-1, 3), strict=True)}

    def fitted(self, found: Candidate, more=None) -> Candidate:
        """The fit with lobes where they suit best: those of `found`, and more {lamp: (4,)}."""
        return super().fitted(found, found.taken.get(self.name, {}) | (more or {}))

    def says(self, lobes, problem, result):
        lobes = found_in(lobes, problem, result)
        named = lambda lobe: {"aim": list(map(float, lobe[:3])), "exponent": float(lobe[3])}
        return [(lamp, named(lobe), sigma_of(lamp, lobes, problem, result)) for lamp, lobe in lobes.items()]


def told_wrong(found: Candidate, lobes: LampLobe, told) -> tuple[list[Why], bool]:
    """A line for each lamp whose lobe is told, where others fit far better; and whether they are all that is wrong.

    found : the fit under the given facts;  told : {lamp: (4,)}
    """
    terms = lobes.terms(found.problem, found.result.at, told)
    prior = np.diag(1 / terms.spread**2)
    promise = promised(found.problem, found.result.at, terms.columns, prior=prior).nats - found.evidence.nats
    if promise < enough(found.problem):
        return [], False
    other = lobes.fitted(found, told)
    gain = other.evidence.nats - found.evidence.nats
    if gain < enough(found.problem):
        return [], False
    why = []
    for lamp, lobe in other.taken[LampLobe.name].items():
        aim = ", ".join(f"{v:.2f}" for v in lobe[:3])
        text = f"lamp {lamp!r}: a lobe cos^{lobe[3]:.2f} about ({aim}) fits the photograph better by {gain:.0f} nats"
        why.append(Why(LampLobe.name, lamp, text, float(gain)))
    return why, other.typical < ALL_WRONG_BELOW * found.typical


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
    exponent = np.clip(lobe[3] * np.exp(np.clip(step[2], -1, 1)), LEAST_EXPONENT, MOST_EXPONENT)
    return np.append(aim / np.linalg.norm(aim), exponent)


def found_in(lobes, problem: Problem, result: Result):
    """{lamp: (4,)} after the last step of the fit, where the result has one."""
    step, terms = result.state.cause, problem.cause
    if step is None or terms is None or not (own := terms.of(LampLobe.name)).any():
        return lobes
    steps = step[own].reshape(-1, 3)
    return {lamp: moved(lobe, one) for (lamp, lobe), one in zip(lobes.items(), steps, strict=True)}


def sigma_of(lamp, lobes, problem: Problem, result: Result) -> dict | None:
    """Of the aim, degrees, and of the exponent; None where they are not known. lobes : {lamp: (4,)} that were found"""
    if result.cov_cause is None:
        return None
    k = list(lobes).index(lamp)
    own = np.flatnonzero(problem.cause.of(LampLobe.name))[3 * k : 3 * k + 3]
    variance = np.diag(result.cov_cause)[own]
    aim_deg = believed(float(np.degrees(np.sqrt(variance[:2].sum() / 2))), 180.0)
    return None if aim_deg is None else {"aim_deg": aim_deg, "exponent": float(lobes[lamp][3] * np.sqrt(variance[2]))}


def uneven(found: Candidate, lobes: LampLobe) -> Candidate:
    """The fit with light that is 1 + a . direction, from which any lobe shows. `taken` holds a, {lamp: (3,)}."""
    terms = lobes.uneven(found.result.at).beside(found.problem.cause)
    problem = replace(found.problem, cause=terms)
    result = gauss_newton(problem, start=found.start, finish=False, tolerance=1e-2, max_iterations=12)
    a = result.state.cause[terms.of(LampLobe.name)].reshape(-1, 3)
    return Candidate(problem, result, evidence(problem, result.at), dict(zip(lobes.wanted, a, strict=True)))


def begun(found: Candidate, first: Candidate, lobes: LampLobe) -> Candidate:
    """The fit with a lobe of each lamp, from where uneven light points. first : of `uneven`"""
    tried = []
    for n in FIRST_EXPONENTS:
        tried.append(lobes.fitted(found, {lamp: lobes.like(lamp, a, n) for lamp, a in first.taken.items()}))
        if tried[-1].typical < NO_OTHER_START * found.typical:
            break
    return max(tried, key=lambda c: c.evidence.nats)


def is_flat(found: Candidate) -> bool:
    """Lamps that are lambertian, or next to it: their lobes have run into the least exponent."""
    return all(lobe[3] <= FLAT_UP_TO * LEAST_EXPONENT for lobe in found.taken[LampLobe.name].values())
