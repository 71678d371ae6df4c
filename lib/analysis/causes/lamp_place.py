"""Whether a lamp stands elsewhere than the model has it, by the light that it throws.

Differences of the lamps' light over a step of the lamp are the columns of a cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lib.analysis.causes.candidates import Candidate
from lib.analysis.causes.cause import Cause, Rounds, plain
from lib.analysis.fit.equations import Equations
from lib.analysis.fit.evidence import promised
from lib.analysis.fit.problem import CauseTerms, Problem
from lib.analysis.fit.transport import TileLight
from lib.analysis.seen.direct_light import DirectLight
from lib.vision.registration.motions import World

STEP_M = 0.02  # over which the light is differenced
FARTHEST_M = 0.1  # of one round
# Of many lamps those are asked for their place that give most light, at least FEW, and as many as have so many facets
# together with the model of each: a question makes the model's surface anew, .2 ms a facet.
FEW, FACETS = 4, 50_000


@dataclass(frozen=True, eq=False)
class Lamps:
    """The lamps that may be moved.

    things : {lamp: (number of its object, (n, 3) unit directions in which it may move)}
    """

    light: DirectLight
    things: dict

    @classmethod
    def of(cls, light: DirectLight, emittance=None) -> Lamps:
        """Those that are small objects of their own; of many those that give the picture most light.

        emittance : (L, C), None: all alike
        """
        model, things = light.view.model, {}
        world = World(model, light.view.camera)
        for lamp in light.factors.own_lamps:
            facets = np.flatnonzero(np.asarray(model.facet_group) == model.groups.index(lamp))
            owner = np.unique(np.asarray(model.facet_object)[facets])
            if len(owner) == 1 and owner[0] in world.movable:
                things[lamp] = int(owner[0]), world.axes(int(owner[0]))[0]
        share = light.found.tiles.direct.mean(axis=0) * (1 if emittance is None else emittance.mean(axis=1))
        given = dict(zip(light.factors.lamps, share, strict=True))
        most = sorted(things, key=given.get, reverse=True)[: max(FEW, FACETS // model.n_facets)]
        return cls(light, {lamp: place for lamp, place in things.items() if lamp in most})

    def moved(self, lamp, offset):
        """The model with one lamp moved by (3,) m."""
        return self.light.moved(self.things[lamp][0], [0, 0, 0, *offset])


@dataclass(frozen=True, eq=False)
class LampPlace(Cause):
    """One lamp that stands elsewhere. Its values: (3,) m from where it is drawn.

    prior_m : standard deviation of its place along each of its axes
    """

    lamps: Lamps
    lamp: str
    prior_m: float

    name = "lamp_place"
    rounds = Rounds(most=6, inner=8, settled=2e-3, must_bring=True)

    def none(self):
        return np.zeros(3)

    @property
    def axes(self):
        """(n, 3) unit directions in which it may move."""
        return self.lamps.things[self.lamp][1]

    def standing(self, problem: Problem, values) -> Problem:
        D, D_tile = self.lamps.light.of(self.lamps.moved(self.lamp, values), self.lamp)
        return replace(problem, D=D, D_tile=D_tile)

    def terms(self, problem: Problem, at: Equations, values) -> CauseTerms:
        """Differences of the lamp's light over STEP_M along each axis."""
        columns = []
        for axis in self.axes:
            there = self.standing(replace(problem, cause=None), values + STEP_M * axis)
            state, light = at.state, TileLight(there)
            b, _ = light.solve(state.rho, state.E, state.b, tolerance=1e-4)
            columns.append(at.displayed(light.shown(state.rho, state.E, b) - state.B) / STEP_M)
        return CauseTerms((self.name,) * len(columns), np.stack(columns, axis=-1), np.full(len(columns), self.prior_m))

    def moved(self, values, step):
        move = step @ self.axes
        return values + move * min(1.0, FARTHEST_M / max(float(np.linalg.norm(move)), 1e-12))

    def length(self, step):
        return float(np.linalg.norm(step @ self.axes))

    def one_step(self, found: Candidate) -> float:
        """From equations without causes: where a lens's shadow was taken, the lamp stands in it."""
        at = plain(found.problem, found.start)
        terms = self.terms(found.problem, at, self.none())
        prior = np.diag(1 / terms.spread**2)
        return promised(found.problem, at, terms.columns, prior=prior).nats - found.evidence.nats

    def promise(self, found: Candidate) -> float:
        return found.once((self.name, self.lamp, "promise"), self.one_step)
