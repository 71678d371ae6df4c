"""Whether the camera mixes colours: camera-linear = M x scene, rows of M sum to 1, fitted with the rest.

The scene's light is mixed and compared with what is seen. White stays white: every row has two free numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.causes.candidates import MIXING, NATS, Candidate
from lib.analysis.fit.evidence import as_others_have_it, gain, promised
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import CauseTerms, Problem

NAME = "matrix"
SPREAD = 0.1  # standard deviation of each number beside the diagonal before anything is seen
MOST = 0.6  # of a number off the unit matrix: sensors' own colours are .1 to .5 off, vivid picture styles .1 to .3
SEVERAL = 0.55  # of what mixing promises that other groups gain than the one that gains most
HOLDS = 0.35  # of what a group gains by mixing that it gains by the others' mixing: .46 to 1 in rooms that were mixed
ROUNDS, SETTLED = 6, 2e-3
OFF = [(c, j) for c in range(3) for j in range(3) if j != c]
OFF_AT = tuple(np.transpose(OFF))
STEPS = np.zeros((3, 3, MIXING))  # D = STEPS @ its numbers beside the diagonal
STEPS[(*OFF_AT, np.arange(MIXING))] = 1
STEPS[(OFF_AT[0], OFF_AT[0], np.arange(MIXING))] = -1


def _cause(at, mixing) -> CauseTerms:
    """Numbers beside the diagonal of D, M + D in place of M, whose rows sum to 0; linearised."""
    B, columns = at.state.B, np.zeros((*at.state.B.shape, MIXING))
    for k, (c, j) in enumerate(OFF):
        columns[:, c, k] = at.slope[:, c] * (B[:, j] - B[:, c])
    return CauseTerms((NAME,) * MIXING, columns, np.full(MIXING, SPREAD), -np.array(mixing or np.eye(3))[OFF_AT])


def left_open(problem: Problem, at) -> CauseTerms:
    """What may be added to M where the scene's light was mixed by it."""
    return _cause(at, problem.transfer.matrix)


def may(found: Candidate) -> bool:
    """There are colours to be mixed, and mixing is not told or taken yet."""
    problem = found.problem
    return problem.channels == 3 and not problem.transfer.matrix and problem.transfer.kind != "linear"


def doubted(found: Candidate) -> CauseTerms | None:
    """What a camera that mixes colours would change, if it may be one and was not taken for one.

    Whatever it promises, by one group or by all: to take it is one thing, to be sure that it is not there another.
    """
    return _cause(found.result.at, ()) if may(found) and _step(found)[0] >= NATS else None


def promise(found: Candidate) -> float:
    """Nats that one step towards a camera that mixes colours brings; of all groups but one if that gains most."""
    total, others = _step(found)
    # where one group gains most, its light or its material may be what is wrong
    return total if others >= max(NATS, SEVERAL * total) else others


def _step(found: Candidate) -> tuple[float, float]:
    """Nats of one step towards a camera that mixes colours: of all groups, and of all but the one that gains most."""
    cause = _cause(found.result.at, ())
    prior = np.diag(1 / cause.spread**2)
    mixed = promised(found.problem, found.result.at, cause.columns, prior=prior)
    return gain(found.problem, mixed, found.evidence)


def is_of_the_camera(mixed: Candidate, found: Candidate) -> bool:
    """It mixes colours of all groups in one way, and no more than cameras do: else something else bent to it.

    The group that gains most must gain by what all others make of the mixing, too.  found : the fit without mixing
    """
    problem, at = mixed.problem, mixed.result.at
    most = problem.tile_group == np.bincount(problem.tile_group, mixed.evidence.each - found.evidence.each).argmax()
    own = at.layout.responding.stop + np.flatnonzero(problem.cause.of(NAME))
    without, by_itself = found.evidence.on(most).nats, mixed.evidence.on(most).nats
    by_others = as_others_have_it(problem, at, own, most).nats
    return is_physical(mixed) and by_others - without >= max(HOLDS * (by_itself - without), 0)


def is_physical(mixed: Candidate) -> bool:
    """A camera and its screen mix colours no more than this."""
    own = mixed.problem.cause.of(NAME)
    M = stepped(mixed.result.state.transfer.matrix, mixed.result.state.cause[own])
    return bool(np.abs(M - np.eye(3)).max() <= MOST)


def stepped(mixing, step):
    """(3, 3) M after a step (6,) of D."""
    return np.array(mixing or np.eye(3)) + STEPS @ step


def spread(cov):
    """Standard deviations of M, three rows, of the covariance (6, 6) of D."""
    return np.sqrt(np.einsum("iln,nm,ilm->il", STEPS, cov, STEPS)).tolist()


def fitted(found: Candidate) -> Candidate:
    """The fit with a camera that mixes colours; `taken` holds M, where that of `found` begins."""
    problem, at, start = found.problem, found.result.at, found.start
    mixing = problem.transfer.matrix
    for _ in range(ROUNDS):
        trial = replace(problem, cause=_cause(at, mixing).beside(problem.cause))
        result = gauss_newton(trial, start=start, finish=False, tolerance=1e-3, max_iterations=6)
        at, step = result.at, result.state.cause[trial.cause.of(NAME)]
        mixing = tuple(map(tuple, stepped(mixing, step).tolist()))
        mixed = {"matrix": mixing}
        problem = replace(problem, transfer=replace(problem.transfer, **mixed))
        start = start._replace(rho=result.state.rho, E=result.state.E, transfer=replace(result.state.transfer, **mixed))
        if np.abs(step).max() < SETTLED:
            break
    last = replace(problem, cause=_cause(at, mixing).beside(problem.cause))
    return Candidate.of(last, found.taken | {NAME: {}}, start=start)
