"""Whether a lamp stands elsewhere than the model has it, by the light that it throws.

Differences of the lamps' light over a step of the lamp are the columns of a cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lib.analysis.causes.candidates import Candidate
from lib.analysis.fit.equations import Equations, Layout
from lib.analysis.fit.evidence import evidence, promised
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import CauseTerms, Problem
from lib.analysis.fit.transport import TileLight
from lib.analysis.seen.direct_light import DirectLight
from lib.vision.registration.motions import World

NAME = "lamp_place"
STEP_M = 0.02  # over which the light is differenced
FARTHEST_M = 0.1  # of one round
SETTLED_M = 2e-3
ROUNDS = 6


@dataclass(frozen=True, eq=False)
class Lamps:
    """The lamps that may be moved.

    things : {lamp: (number of its object, (n, 3) unit directions in which it may move)}
    """

    light: DirectLight
    things: dict

    @classmethod
    def of(cls, light: DirectLight) -> Lamps:
        """Those that are small objects of their own."""
        model, things = light.view.model, {}
        world = World(model, light.view.camera)
        for lamp in light.factors.own_lamps:
            facets = np.flatnonzero(np.asarray(model.facet_group) == model.groups.index(lamp))
            owner = np.unique(np.asarray(model.facet_object)[facets])
            if len(owner) == 1 and owner[0] in world.movable:
                things[lamp] = int(owner[0]), world.axes(int(owner[0]))[0]
        return cls(light, things)

    def moved(self, lamp, offset):
        """The model with one lamp moved by (3,) m."""
        return self.light.moved(self.things[lamp][0], [0, 0, 0, *offset])

    def problem(self, problem: Problem, lamp, offset) -> Problem:
        """The same with the light of a lamp that stands (3,) m away."""
        D, D_tile = self.light.of(self.moved(lamp, offset), lamp)
        return replace(problem, D=D, D_tile=D_tile)

    def cause(self, problem: Problem, at: Equations, lamp, offset, prior_m) -> CauseTerms:
        """Moves of the lamp from `offset`, linearised at equations of this very place."""
        columns = []
        for axis in self.things[lamp][1]:
            there = self.problem(replace(problem, cause=None), lamp, offset + STEP_M * axis)
            state, light = at.state, TileLight(there)
            b, _ = light.solve(state.rho, state.E, state.b, tolerance=1e-4)
            columns.append(at.displayed(light.shown(state.rho, state.E, b) - state.B) / STEP_M)
        return CauseTerms((NAME,) * len(columns), np.stack(columns, axis=-1), np.full(len(columns), prior_m))


def _plain(problem: Problem, start) -> Equations:
    """The equations without a cause, where a fit ended."""
    problem = replace(problem, cause=None)
    return Equations(problem, TileLight(problem), Layout.of(problem), start._replace(cause=None))


def promise(found: Candidate, lamps: Lamps, lamp, prior_m) -> float:
    """Nats that one step of the lamp brings."""
    at = _plain(found.problem, found.start)
    cause = lamps.cause(found.problem, at, lamp, np.zeros(3), prior_m)
    prior = np.diag(1 / cause.spread**2)
    return promised(found.problem, at, cause.columns, prior=prior).nats - found.evidence.nats


def fitted(found: Candidate, lamps: Lamps, lamp, prior_m) -> Candidate | None:
    """The fit with this lamp where it suits best, beside the causes that were taken. `taken` holds its offset.

    None where the first fit brings nothing: one step promised too much.
    """
    start, offset, axes = found.start, np.zeros(3), lamps.things[lamp][1]
    for turn in range(ROUNDS):
        problem = lamps.problem(found.problem, lamp, offset)
        at = _plain(problem, start)
        trial = replace(problem, cause=lamps.cause(problem, at, lamp, offset, prior_m).beside(problem.cause))
        result = gauss_newton(trial, start=start, finish=False, tolerance=1e-3, max_iterations=8)
        step = result.state.cause[trial.cause.of(NAME)] @ axes
        if not turn and evidence(trial, result.at).nats < found.evidence.nats:
            return None
        length = float(np.linalg.norm(step))
        step *= min(1.0, FARTHEST_M / max(length, 1e-12))
        offset = offset + step
        start = start._replace(rho=result.state.rho, E=result.state.E, transfer=result.state.transfer)
        if length < SETTLED_M:
            break
    problem = lamps.problem(found.problem, lamp, offset)
    cause = lamps.cause(problem, _plain(problem, start), lamp, offset, prior_m).beside(problem.cause)
    return Candidate.of(replace(problem, cause=cause), found.taken | {NAME: {lamp: offset}}, start=start)
