"""Which transfer function the photograph supports: the simplest of gamma, sRGB and a free curve.

Gamma is fitted first, roughly. One step from there towards a curve tells what more freedom would bring to the tiles
that are held out; only where that is worth something a curve is fitted, and sRGB or gamma again where the curve found
is like them. A simpler function wins unless a curve beats it by more than chance. A function that scene.yaml names is
never replaced; what beats it is its rival.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lib.analysis.equations import Unknowns, smooth
from lib.analysis.evidence import Evidence, evidence, promised
from lib.analysis.facts import USUAL_GAMMA
from lib.analysis.gauss_newton import fit, gauss_newton
from lib.analysis.problem import Problem, Result
from lib.given.tone_curve import KNOTS
from lib.given.transfer import Metric, Transfer

NATS = 10.0  # by which a more complex explanation must win, and so much per tile besides
NATS_PER_TILE = 0.01
ROUGH = {"tolerance": 1e-3, "max_iterations": 15}  # of fits that are only compared
ALIKE = 0.02  # display: a curve that is so near to a simpler function may be that one


@dataclass(frozen=True)
class Chosen:
    """A fit under the transfer function that won. scale : what fixed the scale of the light

    rivals : {kind: nats} of the others that were fitted, by which they are better than this one
    """

    problem: Problem
    result: Result
    scale: str
    rivals: dict = field(default_factory=dict)


@dataclass(frozen=True)
class _Candidate:
    problem: Problem
    result: Result
    evidence: Evidence

    @classmethod
    def of(cls, problem, **options):
        """A rough fit."""
        result = gauss_newton(problem, finish=False, **ROUGH, **options)
        return cls(problem, result, evidence(problem, result.at))

    @property
    def kind(self):
        return self.problem.transfer.kind

    @property
    def complexity(self):
        return self.problem.fit_transfer * len(self.problem.transfer.parameters)

    @property
    def typical(self):
        return float(np.median(np.abs(self.result.tile_residual)))


def enough(problem: Problem) -> float:
    """Nats that a more complex explanation must bring."""
    return NATS + NATS_PER_TILE * len(problem.tile_group)


def choose(problem: Problem, free: bool, **options) -> Chosen:
    """The fit, under the transfer function of the problem, or under what the photograph supports where that is free.

    options : of gauss_newton.gauss_newton
    """
    if not len(problem.tile_group) or problem.transfer.kind == "linear":
        return Chosen(problem, *fit(problem, **options))
    first = _Candidate.of(problem, trace=options.get("trace"), gamma=options.pop("gamma", None))
    best, others = first, []
    if _curve_promises(first) - first.evidence.nats >= enough(problem):
        others = [c for c in _others(first) if c.typical <= first.typical]
        best = _winner(first, others) if free else first
    state = best.result.state
    result, scale = fit(best.problem, start=Unknowns(state.rho, state.E, state.transfer), **options)
    result.iterations += best.result.iterations
    rivals = {c.kind: c.evidence.nats - best.evidence.nats for c in (first, *others) if c is not best}
    return Chosen(best.problem, result, scale, rivals)


def _winner(first, others) -> _Candidate:
    """The simplest one that no more complex one beats by enough."""
    best = None
    for candidate in sorted((first, *others), key=lambda c: c.complexity):
        if best is None or candidate.evidence.nats - best.evidence.nats >= enough(first.problem):
            best = candidate
    return best


def _curve_promises(found: _Candidate) -> float:
    """Nats of one step from the fit towards a free curve."""
    at, problem = found.result.at, found.problem
    curve = at.state.transfer.as_curve()
    metric, seen = Metric(curve), problem.photograph.linear(curve)
    columns = metric.by_parameters(at.state.B) - metric.by_parameters(seen[0])
    columns = columns - metric.slope(seen[0])[..., None] * seen[1]
    own = slice(at.layout.ends[-1], at.layout.size)
    return promised(problem, at, columns, own, smooth(len(KNOTS))).nats


def _others(first: _Candidate):
    """The fit with a free curve, then those under simpler functions that the curve found is like."""
    problem = first.problem
    curve = Transfer("gamma", USUAL_GAMMA).as_curve()
    free = _Candidate.of(replace(problem, transfer=curve, fit_transfer=True))
    yield free
    seen = np.quantile(problem.photograph.display(), (0.01, 0.99))
    light = free.result.state.transfer.linear(np.linspace(*seen, 50))
    shown = free.result.state.transfer.display(light)
    for simple in (Transfer("srgb"), Transfer("gamma", USUAL_GAMMA)):
        own = simple.kind == problem.transfer.kind and problem.fit_transfer == bool(len(simple.parameters))
        if not own and np.abs(_likest(simple, light, shown) - shown).max() < ALIKE:
            yield _Candidate.of(replace(problem, transfer=simple, fit_transfer=len(simple.parameters) > 0))


def _likest(simple: Transfer, light, shown):
    """What the simple function shows of the light, with the gamma that suits best."""
    if simple.kind == "gamma":
        slope = np.polyfit(np.log(np.maximum(shown, 1e-6)), np.log(np.maximum(light, 1e-12)), 1)[0]
        simple = simple.moved([np.clip(slope, *simple.bounds)])
    return simple.display(light)
