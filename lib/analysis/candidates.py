"""Explanations of the whole picture, fitted roughly and compared on held-out tiles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lib.analysis.equations import Unknowns
from lib.analysis.evidence import Evidence, evidence
from lib.analysis.gauss_newton import gauss_newton
from lib.analysis.problem import Problem, Result

NATS = 10.0  # by which a more complex explanation must win, and so much per tile besides
NATS_PER_TILE = 0.02
ROUGH = {"tolerance": 1e-3, "max_iterations": 15}  # of fits that are only compared


@dataclass(frozen=True)
class Candidate:
    """A rough fit, and what it predicts of tiles that it has not seen.

    taken : {cause: its values}, of the causes that this explanation holds
    """

    problem: Problem
    result: Result
    evidence: Evidence
    taken: dict = field(default_factory=dict)

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
        """How many free numbers its transfer function has."""
        return self.problem.fit_transfer * len(self.problem.transfer.parameters)

    @property
    def typical(self):
        """Median of the tiles' residuals, display."""
        return float(np.median(np.abs(self.result.tile_residual)))

    @property
    def start(self) -> Unknowns:
        """Where the next fit begins."""
        state = self.result.state
        return Unknowns(state.rho, state.E, state.transfer)

    def beats(self, other: Candidate) -> bool:
        """By enough, and the typical tile is no worse."""
        gain = self.evidence.nats - other.evidence.nats
        return gain >= enough(other.problem) and self.typical <= other.typical


def enough(problem: Problem) -> float:
    """Nats that a more complex explanation must bring."""
    return NATS + NATS_PER_TILE * len(problem.tile_group)
