"""Whether the camera mixes colours: camera-linear = M x scene, rows of M sum to 1, fitted with the rest.

What is seen is unmixed, M^-1 x camera-linear, and compared with the scene's light. White stays white: the lamps'
emittances are camera-referred, and every row has two free numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.candidates import Candidate
from lib.analysis.evidence import promised
from lib.analysis.gauss_newton import gauss_newton
from lib.analysis.problem import CauseTerms

NAME = "matrix"
SPREAD = 0.3  # standard deviation of each number beside the diagonal before anything is seen
MOST = 1.2  # of a number off the unit matrix, either way: sRGB of the widest sensors has up to .9
FREE = 6
ROUNDS, SETTLED = 6, 2e-3
OFF = [(c, j) for c in range(3) for j in range(3) if j != c]


def _cause(at) -> CauseTerms:
    """Numbers of D beside the diagonal, linearised, where (1 + D) is applied to what is seen; rows of D sum to 0."""
    B, columns = at.state.B, np.zeros((*at.state.B.shape, FREE))
    for k, (c, j) in enumerate(OFF):
        columns[:, c, k] = -at.slope[:, c] * (B[:, j] - B[:, c])
    return CauseTerms((NAME,) * FREE, columns, np.full(FREE, SPREAD))


def may(found: Candidate) -> bool:
    """There are colours to be mixed, and mixing is not told or taken yet."""
    problem = found.problem
    return problem.channels == 3 and not problem.transfer.matrix and problem.transfer.kind != "linear"


def promise(found: Candidate) -> float:
    """Nats that one step towards a camera that mixes colours brings."""
    cause = _cause(found.result.at)
    prior = np.diag(1 / cause.spread**2)
    return promised(found.problem, found.result.at, cause.columns, prior=prior).nats - found.evidence.nats


def is_physical(found: Candidate) -> bool:
    """A camera and its screen mix colours no more than this; what mixes more is something else that bent to it."""
    own = found.problem.cause.of(NAME)
    M = stepped(np.array(found.result.state.transfer.matrix), found.result.state.cause[own])
    return all(np.abs(A - np.eye(3)).max() <= MOST for A in (M, np.linalg.inv(M)))


def stepped(mixing, step):
    """(3, 3) M after a step (6,) of D."""
    D = np.zeros((3, 3))
    D[tuple(np.transpose(OFF))] = step
    D -= np.diag(D.sum(axis=1))
    return np.linalg.inv((np.eye(3) + D) @ np.linalg.inv(mixing))


def spread(sigma):
    """Standard deviations of M, three rows, of those of the last step (6,), to first order."""
    S = np.zeros((3, 3))
    S[tuple(np.transpose(OFF))] = sigma
    S += np.diag(np.sqrt((S**2).sum(axis=1)))
    return S.tolist()


def fitted(found: Candidate) -> Candidate:
    """The fit with a camera that mixes colours; `taken` holds M, where that of `found` begins."""
    problem, at, start = found.problem, found.result.at, found.start
    mixing = np.array(problem.transfer.matrix or np.eye(3))
    for _ in range(ROUNDS):
        trial = replace(problem, cause=_cause(at).beside(problem.cause))
        result = gauss_newton(trial, start=start, finish=False, tolerance=1e-3, max_iterations=6)
        at, step = result.at, result.state.cause[trial.cause.of(NAME)]
        mixing = stepped(mixing, step)
        mixed = {"matrix": tuple(map(tuple, mixing.tolist()))}
        problem = replace(problem, transfer=replace(problem.transfer, **mixed))
        start = start._replace(rho=result.state.rho, E=result.state.E, transfer=replace(result.state.transfer, **mixed))
        if np.abs(step).max() < SETTLED:
            break
    last = replace(problem, cause=_cause(at).beside(problem.cause))
    return Candidate.of(last, found.taken | {NAME: {}}, start=start)
