"""Emittances that scene.yaml tells, where others explain the photograph better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.causes import response
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.fit.equations import Equations, Unknowns
from lib.analysis.fit.evidence import evidence, promised
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import Problem, Result
from lib.analysis.fit.uncertainty import doubt, doubts
from lib.given.materials import Why
from lib.given.transfer import Transfer

NAME = "lamps"
WORTH_A_WORD = 0.02  # A told number is named if it is off by so much, relatively,
IN_SIGMAS = 3  # and by so many standard deviations, where they are known.
# A lamp has another colour, not power alone, if its channels differ by so much of how far it is off in the mean.
COLOURED_FROM = 0.5
ALL_WRONG_BELOW = (
    0.3  # Other lamps are all that is wrong if they leave less than so much of the tiles' typical residual.
)


def lamps(problem, result) -> list[Why]:
    """Emittances that are told, where others fit far better."""
    return lamps_told(problem, result)[0]


def lamps_told(problem, result) -> tuple[list[Why], bool]:
    """The same, and whether other emittances are all that is wrong."""
    return result.once("lamps_told", lambda: _lamps_told(problem, result))


def _lamps_told(problem, result):
    if not are_told(problem):
        return [], False
    nats = evidence(problem, result.at).nats
    if _freed_by_one_step(problem, result.at).nats - nats < enough(problem):
        return [], False
    free = freed_as_found(problem, result)
    gain = free.evidence.nats - nats
    if gain < enough(problem):
        return [], False
    little = free.typical < ALL_WRONG_BELOW * float(np.median(np.abs(result.tile_residual)))
    # that a camera may mix colours, which was not taken, is no doubt of lamps: either is not as told
    function, _ = doubts(free.problem.doubted)
    found = gauss_newton(replace(free.problem, doubted=function), start=free.start)
    return lamps_of(problem, found, gain), little and found.fits


def lamps_behind_curve(problem, result, given: Candidate) -> list[Why]:
    """Emittances that are told, where others beside a plain gamma explain as much as the curve that was taken.

    given : under the given facts, before mirrors and lobes have climbed: the diffuse fit asks the same, but cannot
    tell while they are off
    """
    if result.state.transfer.kind != "curve" or not problem.fit_transfer or not are_told(problem):
        return []
    free = freed_under(given.result.state.transfer, problem, result)
    gain = free.evidence.nats - evidence(problem, result.at).nats
    if gain < -enough(problem):
        return []
    found = gauss_newton(free.problem, start=free.start)
    return lamps_of(problem, found, gain, ("curve",)) if found.fits else []


def lamps_of(problem, found: Result, nats, spared=()) -> list[Why]:
    """Emittances that are told and differ from those of a fit in which they were free.

    spared : causes that these make needless
    """
    told = np.maximum(problem.emittance, 1e-12)
    ratio, unsure = found.state.E / told, 0.0 if found.sigma_E is None else found.sigma_E / told
    far = (np.abs(ratio - 1) > np.maximum(WORTH_A_WORD, IN_SIGMAS * unsure)).any(axis=1)
    return [_lamp(problem.lamps[k], ratio[k], nats, spared) for k in np.flatnonzero(problem.own_lamps & far)]


def are_told(problem) -> bool:
    """The emittances of all lamps are."""
    return bool(problem.own_lamps.any()) and not np.isnan(problem.emittance[problem.own_lamps]).any()


def freed(problem) -> Problem:
    """With the emittances of all lamps unknown."""
    return replace(problem, emittance=np.where(problem.own_lamps[:, None], np.nan, problem.emittance))


def freed_as_found(problem, result) -> Candidate:
    """The rough fit with lamps of any emittance, from where a fit ended."""
    state = result.state
    start = Unknowns(state.rho, state.E, state.transfer, state.rho_s)
    return result.once("lamps_freed", lambda: Candidate.of(freed(problem), start=start))


def freed_under(gamma: Transfer, problem, result) -> Candidate:
    """The same under a plain gamma in place of a curve, which bends to lamps that are told wrongly."""
    plain, state = replace(gamma, matrix=problem.transfer.matrix), result.state
    start = Unknowns(state.rho, state.E, plain, state.rho_s)
    return Candidate.of(replace(freed(problem), transfer=plain, doubted=None), start=start)


def _lamp(name, ratio, gain, spared):
    uneven = np.ptp(ratio) > WORTH_A_WORD * ratio.mean()
    coloured = uneven and np.ptp(ratio) > COLOURED_FROM * abs(ratio.mean() - 1)
    said = ", ".join(f"{v:.3g}" for v in ratio) if uneven else f"{ratio.mean():.3g}"
    better = f"fits the photograph better by {gain:.0f} nats"
    if spared:
        better = f"explains the photograph without {' and '.join(spared)}"
    text = f"lamp {name!r}: {said} times its emittance {better}"
    return Why("lamp_colour" if coloured else "lamp_power", name, text, float(gain))


def with_lamps_freed(first: Candidate) -> Candidate:
    """The fit with lamps of any emittance and the same causes."""
    return first.once("freed", lambda c: Candidate.of(freed(c.problem), c.taken, start=c.start))


def doubt_srgb(given: Candidate | None, best: Candidate, result: Result):
    """Where sRGB was taken under told lamps, and a gamma and other lamps explain as much, sigma holds what these
    change: lamps told .94 of what they were looked like sRGB in a white room, 12 sigma off and green.

    given, best : of Explained
    """
    if given is None or best.kind != "srgb" or given.kind != "gamma" or not are_told(given.problem):
        return
    if promise_of_lamps(given) < enough(given.problem):
        return
    free = with_lamps_freed(given)
    if free.evidence.nats > best.evidence.nats - enough(given.problem):
        doubt(result, free.result.state)


def promise_of_lamps(found: Candidate) -> float:
    """Nats that one step brings in which the emittances that are told are free."""
    by_one_step = lambda found: found.one_step(NAME, _freed_by_one_step(found.problem, found.result.at))
    return found.once(NAME, by_one_step)


def _freed_by_one_step(problem, at: Equations):
    """Evidence after one step from `at` with free lamps."""
    return promised(problem, at, at.by_told_lamps())


def lamps_alone(first: Candidate, promised: dict, is_free) -> Candidate | None:
    """The fit with lamps of any emittance, where free ones promise more than any cause and keep it.

    Right ones promise nothing, and beside other causes at most a third of what these do; nor are they wrong where sRGB,
    which has no free number, explains as much.

    promised : {cause: nats} that one step brings, NAME among them;  is_free : the transfer function is
    """
    most = max(promised.values())
    if promised.get(NAME, -np.inf) < most:
        return None
    free = with_lamps_freed(first)
    if free.evidence.nats - first.evidence.nats < most:
        return None
    asks = is_free and first.kind == "gamma" and promised.get("response", -np.inf) >= enough(first.problem)
    is_srgb = asks and response.under_srgb(first).evidence.nats >= free.evidence.nats - enough(first.problem)
    return None if is_srgb else free
