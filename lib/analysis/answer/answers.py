"""What was found in one photograph, and what its fit is judged by."""

from __future__ import annotations

from dataclasses import dataclass, field

from lib.analysis.answer.audit import Audit
from lib.analysis.causes.candidates import Candidate
from lib.analysis.causes.explained import Explained
from lib.analysis.fit.evidence import evidence
from lib.analysis.fit.problem import Problem, Result
from lib.analysis.materials.climbing import Climb


@dataclass
class Answer:
    """What was found. problem, result, scale : in the end;  refined : a Refinement, or None

    audit, judged : of all pixels and `explained`, its misfits; None where they were not looked at
    ascent : of the ladder, None where all is diffuse;  ladder : what it did, for the report
    dropped : the climb that explained less than it should, None where none did
    why : [Why] photograph and facts do not agree
    accused : names of groups of which `why` names an object
    sigma_scale : (C,) relative, of what all values have in common where a told number is contradicted, or None
    """

    explained: Explained
    problem: Problem
    result: Result
    scale: str
    audit: Audit | None = None
    judged: dict | None = None
    ascent: object = None
    dropped: Climb | None = None
    ladder: dict = field(default_factory=dict)
    refined: object = None
    why: list = field(default_factory=list)
    accused: set = field(default_factory=set)
    sigma_scale: object = None
    warnings: list = field(default_factory=list)

    @property
    def candidate(self) -> Candidate:
        """Its fit, to be compared with others."""
        of_fit = lambda: Candidate(self.problem, self.result, evidence(self.problem, self.result.at))
        return self.result.once("candidate", of_fit)

    @property
    def nats(self) -> float:
        """Evidence of its fit."""
        return self.candidate.evidence.nats

    @property
    def unexplained(self) -> set:
        """Names of the groups that are off by more than what they were found to be may leave: as a diffuse one that may
        be a mirror, whose climb was taken back or not tried."""
        if self.audit is None:
            return set()
        climbed = {g for g, place in self.climb.places.items() if place.rung != "diffuse"} if self.climb else set()
        flagged = self.audit.flagged(self.problem, self.climb.misfits if self.climb else self.judged)
        return {self.problem.groups[g] for g in flagged if g not in climbed}

    @property
    def climb(self) -> Climb | None:
        return self.ascent.climb if self.ascent else None


def answered(explained: Explained, audit=None, judged=None, **more) -> Answer:
    return Answer(explained, explained.problem, explained.result, explained.scale, audit, judged, **more)


def audit_of(task, explained) -> Audit:
    return Audit.of(task.audit, explained, task.factors, task.surfaces, task.threshold)


def looked(task, explained) -> tuple[Audit, dict]:
    """The audit, and its misfits."""
    audit = audit_of(task, explained)
    return audit, audit.misfits(explained.problem, explained.result)


def things_of(task, explained, audit) -> list:
    """What stands before surfaces that the model has not. audit : of this fit"""
    from lib.analysis.answer import strangers

    return audit.once("things", lambda: strangers.things(task.view(), task.factors, explained, audit))
