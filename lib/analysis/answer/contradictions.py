"""Told numbers where photograph and model disagree: how far values that rest on them may be off.

Lamps, a transfer function or a reference that are told stand in the fit as they are told. Where others explain the
photograph better, either may be so: what the others would make of a value is in its sigma, so that the truth lies
within it whichever holds. Lamps are asked in every answer that is not exact: what the model lacks takes light from all
that it has, which no residual shows, but the light between surfaces does. A room without the furniture behind the
camera was 4.7 % off as a whole, and lamps that were free came out 5.5 % weaker.
"""

from __future__ import annotations

import numpy as np

from lib.analysis.causes import told_lamps, told_reference, told_transfer
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.fit.facts import USUAL_GAMMA
from lib.analysis.fit.uncertainty import doubt
from lib.given.transfer import Transfer

LAMPS = ("lamp_power", "lamp_colour")


def doubt_told(answer, asked):
    """Every sigma of an answer in which something is wrong holds what a told number may be instead.

    asked : transfer, as scene.yaml has it, or None
    Returns the relative standard deviation (C,) of what all values have in common by it, or None: the scale stands.
    """
    causes = {w.cause for w in answer.why}
    problem, result = answer.problem, answer.result
    if result.sigma_rho is None:
        return None
    off = None
    if told_lamps.are_told(problem):
        lamps = np.max([_doubt_lamps(answer, other) for other in _with_other_lamps(answer)], axis=0)
        off = lamps if causes & set(LAMPS) else None
    if "transfer" in causes and (other := told_transfer.instead(problem, result, asked)):
        doubt(result, other.result.state)
    told = {problem.groups[g] for g in told_reference.references_told(problem)}
    accused = told & {w.subject for w in answer.why if w.cause == "group_wrong"}
    if accused:
        state = told_reference.freed_as_found(problem, result).result.state
        doubt(result, state)
        here = [problem.groups.index(name) for name in accused]
        off = np.abs(state.rho[here] / np.maximum(problem.rho[here], 1e-9) - 1).max(axis=0)
    return off


def _with_other_lamps(answer):
    """Rough fits with lamps of any emittance: under the function that was found, and a gamma in place of a curve, where
    that explains as much."""
    problem, result = answer.problem, answer.result
    yield told_lamps.freed_as_found(problem, result)
    if result.state.transfer.kind == "curve" and problem.fit_transfer:
        plain = told_lamps.freed_under(Transfer("gamma", USUAL_GAMMA), problem, result)
        if plain.evidence.nats > answer.nats - enough(problem):
            yield plain


def _doubt_lamps(answer, other: Candidate):
    """(C,) by how much lamps are brighter or darker there than they are told."""
    problem, state = answer.problem, other.result.state
    doubt(answer.result, state)
    own = problem.own_lamps
    return np.abs(state.E[own] / np.maximum(problem.emittance[own], 1e-12) - 1).max(axis=0)
