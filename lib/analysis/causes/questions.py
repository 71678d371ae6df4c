"""What the search asked, and what came of it: the rows from which margins are read."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from lib.analysis.causes.candidates import Candidate


@dataclass(frozen=True)
class Question:
    """One question to the photograph, whether a cause explains it better.

    beside : causes that were taken before;  promised : nats of held-out tiles that one step brings
    nats : that the fit brought, None where it was not fitted;  least : nats that were asked for
    dse : standard error over groups of the nats, or of what one step promised;  decision : in words
    """

    cause: str
    beside: list
    promised: float | None
    nats: float | None
    dse: float | None
    least: float | None
    decision: str

    @classmethod
    def of(cls, cause, before: Candidate, promised, fitted: Candidate | None, decision, least=None) -> Question:
        step = before.step(cause)
        told = step if fitted is None or fitted is before else fitted.over(before)
        nats = None if fitted is None else told.nats if fitted is not before else 0.0
        return cls(cause, sorted(before.taken), promised, nats, told and told.dse, least, decision)

    def row(self) -> dict:
        """As fit.report.json has it."""
        finite = lambda value: round(value, 3) if np.isfinite(value) else None  # one group alone has no error
        short = lambda value: finite(value) if isinstance(value, float) else value
        return {name: short(value) for name, value in asdict(self).items()}
