"""Whether the camera mixes colours: camera-linear = M x scene, rows of M sum to 1, fitted with the rest.

The scene's light is mixed and compared with what is seen. White stays white: every row has two free numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.causes.candidates import MIXING, NATS, Candidate
from lib.analysis.causes.cause import Cause, Rounds
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.evidence import as_others_have_it, gain, promised
from lib.analysis.fit.problem import CauseTerms, Problem, Result

OFF_DIAGONAL = 0.1  # Standard deviation of each number beside the diagonal, before anything is seen.
# A number of M may be off the unit matrix by so much. Sensors' own colours are .1 to .5 off, vivid picture styles .1
# to .3.
MOST_MIXING = 0.6
# All other groups must gain so much of what mixing promises, or the group that gains most is left out of the promise.
BY_OTHER_GROUPS = 0.55
# A group must keep so much of its gain if the others alone say how colours mix. In rooms that were mixed it kept .46
# to 1.
KEPT_BY_OTHERS = 0.35
OFF = [(c, j) for c in range(3) for j in range(3) if j != c]
OFF_AT = tuple(np.transpose(OFF))
STEPS = np.zeros((3, 3, MIXING))  # D = STEPS @ its numbers beside the diagonal
STEPS[(*OFF_AT, np.arange(MIXING))] = 1
STEPS[(OFF_AT[0], OFF_AT[0], np.arange(MIXING))] = -1


class ColourMixing(Cause):
    """A camera that mixes colours: the numbers beside the diagonal of D, M + D in place of M."""

    name = "matrix"
    free = MIXING
    stands_back = True  # colours bend to all else
    is_of_camera = True
    rounds = Rounds(most=6, inner=6, settled=2e-3)

    @classmethod
    def of(cls, scope: Scope):
        return cls() if scope.response else None

    def none(self):
        return ()

    def may(self, found: Candidate) -> bool:
        return may(found)

    def terms(self, problem: Problem, at, values) -> CauseTerms:
        B, columns = at.state.B, np.zeros((*at.state.B.shape, MIXING))
        for k, (c, j) in enumerate(OFF):
            columns[:, c, k] = at.slope[:, c] * (B[:, j] - B[:, c])
        return CauseTerms(
            (self.name,) * MIXING, columns, np.full(MIXING, OFF_DIAGONAL), -np.array(values or np.eye(3))[OFF_AT]
        )

    def moved(self, values, step):
        return tuple(map(tuple, stepped(values, step).tolist()))

    def standing(self, problem: Problem, values) -> Problem:
        return replace(problem, transfer=replace(problem.transfer, matrix=values or None))

    def one_step(self, found: Candidate) -> float:
        """Of all groups but one if that gains most: its light or its material may be what is wrong."""
        total, others = _step(found)
        return total if others >= max(NATS, BY_OTHER_GROUPS * total) else others

    def is_physical(self, fitted: Candidate, before: Candidate) -> bool:
        """It mixes colours of all groups in one way, and no more than cameras do: else something else bent to it.

        The group that gains most must gain by what all others make of the mixing, too.
        """
        problem, at = fitted.problem, fitted.result.at
        most = (
            problem.tile_group == np.bincount(problem.tile_group, fitted.evidence.each - before.evidence.each).argmax()
        )
        own = at.layout.responding.stop + np.flatnonzero(problem.cause.of(self.name))
        without, by_itself = before.evidence.on(most).nats, fitted.evidence.on(most).nats
        by_others = as_others_have_it(problem, at, own, most).nats
        return is_a_cameras(fitted) and by_others - without >= max(KEPT_BY_OTHERS * (by_itself - without), 0)

    def says(self, values, problem, result):
        sigma = None
        if result.cov_cause is not None:
            own = problem.cause.of(self.name)
            sigma = {"matrix": spread(result.cov_cause[np.ix_(own, own)])}
        return [(None, {"matrix": [list(row) for row in found_in(problem, result)]}, sigma)]


def may(found: Candidate) -> bool:
    """There are colours to be mixed, and mixing is not told or taken yet."""
    problem = found.problem
    return problem.channels == 3 and not problem.transfer.matrix and problem.transfer.kind != "linear"


def doubted(found: Candidate) -> CauseTerms | None:
    """What a camera that mixes colours would change, if it may be one and was not taken for one.

    Whatever it promises, by one group or by all: to take it is one thing, to be sure that it is not there another.
    """
    if not may(found) or _step(found)[0] < NATS:
        return None
    return ColourMixing().terms(found.problem, found.result.at, ())


def _step(found: Candidate) -> tuple[float, float]:
    """Nats of one step towards a camera that mixes colours: of all groups, and of all but the one that gains most."""
    terms = ColourMixing().terms(found.problem, found.result.at, ())
    mixed = promised(found.problem, found.result.at, terms.columns, prior=np.diag(1 / terms.spread**2))
    found.one_step(ColourMixing.name, mixed)
    return gain(found.problem, mixed, found.evidence)


def is_a_cameras(mixed: Candidate) -> bool:
    """A camera and its screen mix colours no more than this."""
    own = mixed.problem.cause.of(ColourMixing.name)
    M = stepped(mixed.result.state.transfer.matrix, mixed.result.state.cause[own])
    return bool(np.abs(M - np.eye(3)).max() <= MOST_MIXING)


def found_in(problem: Problem, result: Result):
    """(3, 3) M after the last step of the fit, where the result has one: the ladder holds all causes fast."""
    M, step = result.state.transfer.matrix, result.state.cause
    if step is not None and (own := problem.cause.of(ColourMixing.name)).any():
        M = tuple(map(tuple, stepped(M, step[own]).tolist()))
    return M


def stepped(mixing, step):
    """(3, 3) M after a step (6,) of D."""
    return np.array(mixing or np.eye(3)) + STEPS @ step


def spread(cov):
    """Standard deviations of M, three rows, of the covariance (6, 6) of D."""
    return np.sqrt(np.einsum("iln,nm,ilm->il", STEPS, cov, STEPS)).tolist()
