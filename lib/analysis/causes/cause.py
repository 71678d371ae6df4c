"""A cause: one thing that may be wrong with the picture as a whole, behind one interface.

The search (lib/analysis/causes/search.py) knows this interface alone. A cause is a file of its own and a line of
lib/analysis/causes/table.py. What one step towards it promises, the fit that linearises it again and again, and its
sigma follow from its `terms`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lib.analysis.causes.candidates import USUAL_NUMBERS, Candidate
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.equations import Equations, Layout, Unknowns
from lib.analysis.fit.evidence import evidence, promised
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import CauseTerms, Problem, Result
from lib.analysis.fit.transport import TileLight
from lib.analysis.seen.gather import Gathered
from lib.given.view import View


class Rounds(NamedTuple):
    """How a cause that is no line is fitted: as one, put where that led, and so on.

    most : rounds;  inner : Gauss-Newton iterations of each;  settled : length of a step that ends them
    shares : of a step, until one lowers the error; far away, what is no line may need a part of a step
    tight : rounds before which they do not end, since `spread` holds the numbers tighter
    patience, gains : rounds after which the error must have fallen to such a share
    hope : and below such a share of what it was without the cause
    must_bring : the first round must be more likely than the fit without the cause
    """

    most: int = 6
    inner: int = 6
    settled: float = 2e-3
    shares: tuple = ()
    tight: int = 0
    patience: int = 10**6
    gains: float = 1.0
    hope: float = np.inf
    must_bring: bool = False


class Tried(NamedTuple):
    """What came of a cause that was fitted.

    candidate : the best;  rivals : [Candidate], other forms of it
    errors : nats that errors of the light bring as well, so that they count for nothing
    is_simpler : it has no free number, so that any other must beat it by all of its own
    """

    candidate: Candidate
    rivals: tuple = ()
    errors: float = 0.0
    is_simpler: bool = False


class Cause:
    """One thing that may be wrong with the picture as a whole.

    name : as materials.json has it;  free : free numbers that it must be worth
    stands_back : it is fitted only where nothing else promises more, since others only bend to it, or it to them
    is_linearised : its fit is one about where it stood, so it is fitted again once another is taken
    is_of_camera : it is fitted again beside what climbs
    rounds : of `fitted`

    A cause has values of a type of its own, kept in Candidate.taken[name].
    """

    name = ""
    free = USUAL_NUMBERS
    stands_back = False
    is_linearised = True
    before_gammas = False  # where it promises more than another response does, no other gamma is looked for
    by_one_step = True  # what it brings is asked of the fit under the given facts
    is_of_camera = False
    rounds = Rounds()

    @classmethod
    def of(cls, scope: Scope) -> Cause | None:
        """This cause in a scene, None where it may not be or nothing is known that it needs."""
        raise NotImplementedError

    def terms(self, problem: Problem, at: Equations, values) -> CauseTerms:
        """Its numbers, linearised at equations of a problem in which it stands at these values."""
        raise NotImplementedError

    def none(self) -> Any:
        """The values at which nothing is wrong."""
        raise NotImplementedError

    def moved(self, values, step):
        """The values after a step (k,) of the numbers."""
        raise NotImplementedError

    def standing(self, problem: Problem, values) -> Problem:
        """The problem in which the cause stands at these values."""
        raise NotImplementedError

    def length(self, step) -> float:
        """Of a step (k,), to be compared with Rounds.settled."""
        return float(np.abs(step).max())

    def spread(self, round, terms: CauseTerms) -> CauseTerms:
        """The terms as they are fitted in a round; the first rounds may hold them tighter."""
        return terms

    def may(self, found: Candidate) -> bool:
        """It is a question at all, of this fit."""
        return True

    def comes_along(self, found: Candidate) -> bool:
        """It is fitted wherever another cause is, since it may need no free number."""
        return False

    def promise(self, found: Candidate) -> float:
        """Nats that one step towards it brings to held-out tiles."""
        return found.once(self.name, self.one_step)

    def one_step(self, found: Candidate) -> float:
        at = found.result.at
        terms = self.terms(found.problem, at, self.none())
        prior = np.diag(1 / terms.spread**2)
        return found.one_step(self.name, promised(found.problem, at, terms.columns, prior=prior))

    def fitted(self, found: Candidate, values=None) -> Candidate | None:
        """The fit with it, from the values that `found` has of it, or from these."""
        return relinearised(self, found, values)

    def tried(self, found: Candidate, promised) -> Tried:
        """The fit with it, from other starts as well where the first leaves something to explain."""
        return Tried(self.fitted(found))

    def is_physical(self, fitted: Candidate, before: Candidate) -> bool:
        """What was found can be: else the terms have bent to something else. before : the fit without it"""
        return True

    def left_open(self, problem: Problem, at: Equations, values) -> CauseTerms:
        """What may be added to values that stand fast in a problem: the photograph was put right by them."""
        return self.terms(self.standing(problem, values), at, values)

    def evened(self, gathered: Gathered, values, transfer) -> Gathered:
        """Tiles as they would be without it, where pixels can be put right."""
        return gathered

    def undone(self, view: View, values, transfer) -> View:
        """The photograph as it would be without it, where pixels can be put right."""
        return view

    def says(self, values, problem: Problem, result: Result) -> list:
        """[(subject, {name: value}, {name: sigma} or None)], as materials.json lists it."""
        return [(None, dict(values), None)]


def relinearised(cause: Cause, found: Candidate, values=None) -> Candidate | None:
    """The fit with a cause that is no line: its numbers beside all others, linearised anew where each round led.

    values : to begin with, those of `found` or none otherwise
    None where the first round brings nothing, if it must.
    """
    how, others = cause.rounds, found.problem.cause and found.problem.cause.without(cause.name)
    values = found.taken.get(cause.name, cause.none()) if values is None else values
    start, base = found.start, replace(found.problem, cause=others)
    problem = cause.standing(base, values)
    at = plain(problem, start)
    errors, hope = [_error(at)], how.hope * np.abs(found.result.tile_residual).mean()
    for number in range(how.most):
        if number >= how.patience and errors[-1] >= min(how.gains * errors[-1 - how.patience], hope):
            break
        terms = cause.spread(number, cause.terms(problem, at, values))
        trial = replace(problem, cause=terms.beside(others))
        result = gauss_newton(trial, start=start, finish=False, tolerance=1e-3, max_iterations=how.inner)
        numbers = result.state.cause[trial.cause.of(cause.name)]
        if number == 0 and how.must_bring and evidence(trial, result.at).nats < found.evidence.nats:
            return None  # one step promised too much
        for share in how.shares or (1.0,):
            there = cause.moved(values, share * numbers)
            stands = cause.standing(base, there)
            begin = _part_way(start, result, share, stands.transfer.matrix)
            after = plain(stands, begin)
            if not how.shares or _error(after) < errors[-1]:
                break
        else:
            break
        values, start, problem, at = there, begin, stands, after
        errors.append(_error(at))
        if number >= how.tight and share * cause.length(numbers) < how.settled:
            break
    last = replace(problem, cause=cause.terms(problem, at, values).beside(others))
    return Candidate.of(last, found.taken | {cause.name: values}, start=start)


def plain(problem: Problem, start: Unknowns) -> Equations:
    """The equations without linearised causes, where a fit ended."""
    problem = replace(problem, cause=None)
    return Equations.begun(problem, TileLight(problem), Layout.of(problem), start._replace(cause=None))


def settled(found: Candidate, before: Candidate, causes) -> Candidate:
    """With what was taken before fitted again where that was linearised, if it is another explanation than before."""
    if found is before:
        return found
    for cause in causes:
        if cause.is_linearised and cause.name in before.taken:
            found = cause.fitted(found)
    return found


def believed(sigma, most):
    """Standard deviations, None where one is beyond all that the value may be: then nothing is known of it."""
    return sigma if sigma is not None and np.max(sigma) <= most else None


def _part_way(start: Unknowns, result: Result, share, mixing) -> Unknowns:
    """From `start` towards where a fit ended. mixing : of colours, or None"""
    state, between = result.state, lambda a, b: a + share * (b - a)
    function = start.transfer.moved(between(start.transfer.parameters, state.transfer.parameters))
    function = replace(function, matrix=mixing)
    near = None if start.near is None else result.at
    rho_s = None if start.rho_s is None else between(start.rho_s, state.rho_s)
    rho, E = between(start.rho, state.rho), between(start.E, state.E)
    return start._replace(rho=rho, E=E, transfer=function, rho_s=rho_s, near=near)


def _error(at: Equations):
    """Mean display error of the tiles: outliers have no more than their share."""
    return np.abs(at.residual).mean()
