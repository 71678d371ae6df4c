"""Explanations of the whole picture, fitted roughly and compared on held-out tiles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lib.analysis.fit.equations import Unknowns
from lib.analysis.fit.evidence import Difference, Evidence, difference, evidence
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import Problem, Result

# By so much a more complex explanation must win, and so much per tile besides, by the square of its free numbers: the
# errors of neighbouring tiles are no independent witnesses, and what has many numbers can bend to them. Exact rooms
# bring up to .07 nats per tile for a free curve, photographs that went through one 1.1 and more.
NATS = 10.0
NATS_PER_TILE = 0.02 / 9
MIXING = 6  # free numbers of a camera that mixes colours
# An explanation with fewer free numbers wins if its typical residual is at most so many times the other's. Right ones
# without a free number had up to 1.03.
ABOUT_AS_GOOD = 1.05
USUAL_NUMBERS = 3  # Free numbers that a cause has if it does not say how many.
ROUGH = {"tolerance": 1e-3, "max_iterations": 60}  # of fits that are only compared; valleys of white rooms are long


@dataclass(frozen=True)
class Candidate:
    """A rough fit, and what it predicts of tiles that it has not seen.

    taken : {cause: its values}, of the causes that this explanation holds
    asked : {question: its answer}, of `once`
    """

    problem: Problem
    result: Result
    evidence: Evidence
    taken: dict = field(default_factory=dict)
    asked: dict = field(default_factory=dict)

    @classmethod
    def of(cls, problem, taken=None, **options) -> Candidate:
        """Fitted roughly. options : of gauss_newton.gauss_newton"""
        result = gauss_newton(problem, finish=False, **ROUGH, **options)
        return cls(problem, result, evidence(problem, result.at), taken or {})

    @property
    def kind(self):
        """Of its transfer function."""
        return self.problem.transfer.kind

    @property
    def complexity(self):
        """How many free numbers its transfer function has, and the mixing of colours before it."""
        transfer = self.problem.transfer
        return self.problem.fit_transfer * len(transfer.parameters) + MIXING * bool(transfer.matrix)

    @property
    def typical(self):
        """Median of the residuals of plain tiles, display."""
        return float(np.median(np.abs(self.result.tile_residual[self.problem.plain])))

    @property
    def start(self) -> Unknowns:
        """Where the next fit begins."""
        state = self.result.state
        return Unknowns(state.rho, state.E, state.transfer, state.rho_s, near=self.result.at)

    def once(self, question, ask):
        """The answer of ask(self), which is asked only once: what costs a fit is needed in several places."""
        if question not in self.asked:
            self.asked[question] = ask(self)
        return self.asked[question]

    def one_step(self, question, after: Evidence) -> float:
        """Nats that one step towards something brings, kept with their standard error. after : one step from here"""
        self.asked[question, "step"] = difference(self.problem, after, self.evidence)
        return self.asked[question, "step"].nats

    def step(self, question) -> Difference | None:
        """What `one_step` kept, None where it was not asked."""
        return self.asked.get((question, "step"))

    def over(self, other: Candidate) -> Difference:
        """By how much it is better than another one of the same tiles."""
        return difference(self.problem, self.evidence, other.evidence)

    def off(self, other: Candidate) -> float:
        """By how much the two predict held-out tiles differently, display, rms."""
        return float(np.sqrt(np.mean((self.evidence.residual - other.evidence.residual) ** 2)))

    def beats(self, other: Candidate) -> bool:
        """By enough, and the typical tile is no worse; of what has fewer free numbers, hardly worse."""
        more = ABOUT_AS_GOOD if self.complexity < other.complexity else 1.0
        return self.is_worth(other) and self.typical <= more * other.typical

    def is_worth(self, other: Candidate) -> bool:
        """It beats the other by enough, as many free numbers as it has more."""
        more = max(self.complexity - other.complexity, 0) or USUAL_NUMBERS
        return self.evidence.nats - other.evidence.nats >= enough(other.problem, more)


def enough(problem: Problem, more=USUAL_NUMBERS) -> float:
    """Nats that an explanation must bring that has `more` free numbers."""
    return NATS + NATS_PER_TILE * more**2 * len(problem.tile_group)
