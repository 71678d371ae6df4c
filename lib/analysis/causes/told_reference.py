"""Reflectances that scene.yaml tells, where others explain the photograph better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.told_lamps import IN_SIGMAS, WORTH_A_WORD
from lib.analysis.fit.evidence import evidence
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import Result
from lib.analysis.fit.uncertainty import doubt
from lib.given.materials import Why


def references(problem, result) -> list[Why]:
    """Reflectances that are told, where others fit far better: a told group climbs no rung and has no sigma."""
    return result.once("references", lambda: _references(problem, result))


def _references(problem, result):
    told = references_told(problem)
    if not told:
        return []
    free, gain, least = _free_references(problem, result)
    if gain < least:
        return []
    found = gauss_newton(free.problem, start=free.start)
    return references_of(problem, found, gain) if found.fits else []  # else something else is wrong


def _free_references(problem, result):
    """(Candidate with other reflectances of told groups, the nats by which it is better, the nats that name them)"""
    here = Candidate(problem, result, evidence(problem, result.at))
    free = result.once("free_references", lambda: with_references_freed(here))
    numbers = len(references_told(problem)) * result.state.rho.shape[1]
    return free, free.evidence.nats - here.evidence.nats, enough(problem, numbers)


def doubt_references(problem, result):
    """Where other reflectances of told groups fit better, by less than names them, sigma holds as large a part of what
    they would change: .72 told for .7 was 18 sigma off and green."""
    if not references_told(problem) or result.sigma_rho is None:
        return
    free, gain, least = _free_references(problem, result)
    if gain > 0:
        doubt(result, free.result.state, min(np.sqrt(gain / least), 1.0))


def freed_as_found(problem, result) -> Candidate:
    """The rough fit with other reflectances of told groups, from where a fit ended."""
    return _free_references(problem, result)[0]


def references_told(problem) -> list[int]:
    """Groups that tiles show, whose diffuse reflectance is told."""
    specular = () if problem.specular is None else problem.specular.groups
    told = problem.known_groups & set(np.flatnonzero(problem.seen_groups))
    return sorted(g for g in told if problem.groups[g] not in problem.lamps and g not in specular)


def with_references_freed(first: Candidate) -> Candidate:
    """The fit with other reflectances of the groups that are told, and the same causes."""
    rho = first.problem.rho.copy()
    rho[references_told(first.problem)] = np.nan
    return Candidate.of(replace(first.problem, rho=rho), first.taken, start=first.start)


def references_of(problem, found: Result, nats) -> list[Why]:
    """Reflectances that are told and differ from those of a fit in which they were free."""
    told = references_told(problem)
    off = np.abs(found.state.rho[told] - problem.rho[told])
    unsure = 0.0 if found.sigma_rho is None else found.sigma_rho[told]
    far = (off > np.maximum(WORTH_A_WORD * problem.rho[told], IN_SIGMAS * unsure)).any(axis=1)
    return [_reference(problem, g, found.state.rho[g], nats) for g, is_far in zip(told, far, strict=True) if is_far]


def _reference(problem, g, rho, gain):
    name = problem.groups[g]
    numbers = lambda values: ", ".join(f"{v:.3g}" for v in values)
    text = (
        f"reference.{name}: {numbers(rho)} fits the photograph better by {gain:.0f} nats than {numbers(problem.rho[g])}"
        ": is it a linear share of the light, not the value of a colour picker?"
    )
    return Why("group_wrong", name, text, float(gain))
