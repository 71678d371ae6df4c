"""Whether a glow comes in where the model is open: its radiosity, fitted with the rest (lib/light/outside.py).

It is even first. What was left out is not, so it may change along three axes, as far as such things usually do: where
the photograph does not tell how, that is in every sigma.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.causes import gammas
from lib.analysis.causes.candidates import Candidate
from lib.analysis.causes.cause import Cause, Tried
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.equations import Unknowns
from lib.analysis.fit.evidence import promised
from lib.analysis.fit.facts import USUAL_GAMMA
from lib.analysis.fit.problem import Problem
from lib.analysis.fit.start import initialise
from lib.analysis.seen.gather import Gathered
from lib.given.view import View
from lib.light import form_factors, outside
from lib.light import surface as surfaces
from lib.light.balance import reflected
from lib.light.factors_file import OUTSIDE, FormFactors

UNEVEN = 0.4  # standard deviation of the change from the middle of the model to an end of it, a share of the glow
CURVED = 0.3  # the same of what goes with the squares and products of the axes
BEYOND = 0.2  # the same of what goes with their cubes, which is not fitted
FEWER = 4  # than were shot: so many rays tell how unsure it is


class Glow(Cause):
    """Light that comes in where the model is open, from a glow outside."""

    name = "glow"
    stands_back = True  # the others only bend to a glow
    is_linearised = False
    before_gammas = True

    @classmethod
    def of(cls, scope: Scope):
        return cls() if cls.name in scope.allowed else None

    def may(self, found: Candidate) -> bool:
        return is_dark(found.problem)

    def one_step(self, found: Candidate) -> float:
        return promise(found)

    def fitted(self, found: Candidate, values=None) -> Candidate:
        return changing(even(found))

    def tried(self, found: Candidate, promised) -> Tried:
        first = self.fitted(found)
        if not gammas.is_stuck(first, found):
            return Tried(first)
        other = fitted_from(found, (*gammas.STARTS, USUAL_GAMMA))
        return Tried(max(first, other, key=lambda c: c.evidence.nats))

    def says(self, values, problem, result):
        return [(None, _named(problem, result.state.E), result.sigma_E is not None and _named(problem, result.sigma_E))]


def _named(problem, E):
    """Radiosity of the glow from outside and its changes, see outside.Outside, of emittances (L, C) or their sigma."""
    three = lambda values: [float(v) for v in np.broadcast_to(values, 3)]
    even, *changes = (three(E[problem.lamps.index(name)]) for name in OUTSIDE)
    return {"radiosity": even, "gradient": changes[:3], "curvature": changes[3:]}


def is_dark(problem: Problem) -> bool:
    """The model is open, and nothing comes in."""
    return not problem.own_lamps.all() and not problem.emittance[~problem.own_lamps].any()


def unsure(view: View, factors: FormFactors, found: Gathered) -> list:
    """[(dD, dD_tile)] by which the light from outside is unsure, since what was left out is no polynomial."""
    around, tiles = factors.outside, found.tiles
    surface = surfaces.surface(view.model, factors.lamps)
    p, side = surfaces.backproject(surface, view.camera, np.repeat(tiles.facet, np.diff(tiles.start)), tiles.pixel)
    to_patches = form_factors.from_patches(surface, factors.mesh, outside.RAYS // FEWER, seed=3)
    n_rays = -(-tiles.rows.shot // FEWER)
    to_tiles = form_factors.from_points(surface, p, tiles.start, side[tiles.start[:-1]], n_rays, seed=15)
    leaving = [outside.Leaving.of(surface, around, *way) for way in (to_patches, to_tiles)]
    there, seen = (rays.sums(around.beyond(rays.q)) for rays in leaving)
    D, D_tile = factors.lamp_factor[:, around.first], tiles.direct[:, around.first]
    mean, changes = seen.sum(axis=0) / max(D_tile.sum(), 1e-12), []
    for k in range(there.shape[1]):
        dD, dD_tile = np.zeros_like(factors.lamp_factor), np.zeros_like(tiles.direct)
        dD[:, around.first] = BEYOND * (there[:, k] - mean[k] * D)
        dD_tile[:, around.first] = BEYOND * (seen[:, k] - mean[k] * D_tile)
        changes.append((dD, dD_tile))
    return changes


def may_come_in(factors: FormFactors, found: Gathered, fit: Candidate) -> bool:
    """A glow would explain more than the dark, where the model is open: only then rays must tell how it comes in.

    factors, found : which do not know the outside yet;  fit : of them
    """
    opened = outside.openings_to_light(factors)
    return outside.is_open(opened) and _promise(fit, opened, outside.openings(found.tiles.rows)) > 0


def in_the_dark(found: Candidate, problem: Problem, unsure) -> Candidate:
    """The same fit, of a problem that knows the outside, from where no light comes yet.

    found : which does not;  unsure : of Problem.unsure_outside
    """
    more = len(problem.lamps) - len(found.problem.lamps)
    none = lambda D: None if D is None else np.pad(D, ((0, 0), (0, more)))
    known = tuple((none(dD), none(dD_tile)) for dD, dD_tile in found.problem.unsure)
    problem = replace(problem, unsure=known, unsure_outside=unsure, variance=found.problem.variance)
    state = found.result.state
    E = np.concatenate([state.E, np.zeros((more, state.E.shape[1]))])
    return Candidate.of(problem, start=Unknowns(state.rho, E, state.transfer))


def promise(found: Candidate) -> float:
    """Nats that one step towards an even glow brings, of each channel for itself."""
    k = found.problem.lamps.index(OUTSIDE[0])
    return _promise(found, found.problem.D[:, k], found.problem.D_tile[:, k])


def _promise(found: Candidate, D, D_tile) -> float:
    """The same of a lamp with factors D (N,) to the patches and D_tile (T,) to the tiles."""
    problem, at, C = found.problem, found.result.at, found.problem.channels
    rho, matrices = at.state.rho[problem.patch_group].astype(np.float32), at.light.matrices
    b = reflected(matrices.F, rho, rho * D[:, None].astype(np.float32), tolerance=1e-3).b
    dB = at.shown_share * (D_tile[:, None] + problem.G @ b)
    each = np.zeros((*dB.shape, C))
    each[:, np.arange(C), np.arange(C)] = dB
    return found.one_step(Glow.name, promised(problem, at, at.displayed(each)))


def fitted_from(found: Candidate, gammas) -> Candidate:
    """The same from where one of these gammas suits best: a gamma that was fitted in the dark may lie far away."""
    told = []
    for gamma in gammas:
        transfer = replace(found.problem.transfer, gamma=gamma)
        start = Unknowns(*initialise(found.problem, transfer), transfer)
        told.append(Candidate.of(_free(replace(found.problem, transfer=transfer, fit_transfer=False)), start=start))
    best = max(told, key=lambda c: c.evidence.nats)
    return changing(even(replace(found, result=best.result)))


def _free(problem: Problem) -> Problem:
    """With an even glow of unknown radiosity."""
    emittance = problem.emittance.copy()
    emittance[problem.lamps.index(OUTSIDE[0])] = np.nan
    return replace(problem, emittance=emittance)


def even(found: Candidate) -> Candidate:
    """The fit with a glow that is the same everywhere."""
    return Candidate.of(_free(found.problem), found.taken | {Glow.name: {}}, start=found.start)


def changing(found: Candidate) -> Candidate:
    """The fit with a glow that may change along the axes. found : the fit with one that may not"""
    problem, E = found.problem, found.result.state.E
    emittance, spread = problem.emittance.copy(), np.full(E.shape, np.inf)
    for name in OUTSIDE[1:]:
        k = problem.lamps.index(name)
        share = UNEVEN if name in OUTSIDE[1:4] else CURVED
        emittance[k], spread[k] = np.nan, share * np.maximum(E[problem.lamps.index(OUTSIDE[0])], 1e-6)
    return Candidate.of(replace(problem, emittance=emittance, spread_E=spread), found.taken, start=found.start)
