"""A transfer function that scene.yaml tells, where another explains the photograph better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.causes import response
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.fit.equations import Unknowns
from lib.analysis.fit.evidence import evidence
from lib.analysis.fit.facts import USUAL_GAMMA
from lib.analysis.fit.problem import CauseTerms, display_residual
from lib.analysis.fit.uncertainty import doubt, widen
from lib.given.materials import Why
from lib.given.transfer import Transfer
from lib.given.transfer_kinds import OF_PICTURE

TOLD_TO = 0.1  # Standard deviation of a gamma that is told, before anything is seen.
# Where mirrors or lobes leave an error, another gamma must bring so many times what is enough. Right ones were beaten
# by 1.65 times.
CLEARLY_FROM = 2.0


def transfer_told(problem, asked, rivals) -> list[Why]:
    """A transfer function that scene.yaml tells, where another fits far better."""
    if asked in (None, "auto") or not rivals:
        return []
    most = max(rivals.values())
    if most < enough(problem):
        return []
    near = [kind for kind, nats in rivals.items() if nats > most - enough(problem)]
    kind = min(near, key=lambda kind: kind == "curve")  # the simplest of those that are as good
    text = f"the transfer function {kind} fits better than {_named(asked)} by {rivals[kind]:.0f} nats"
    return [Why("transfer", None, text, float(rivals[kind]))]


def another_gamma(problem, result, asked) -> list[Why]:
    """A gamma that fits better than what is told: one number is found where a free curve promises too little for nine.

    Right gammas are beaten by -8 to 0 nats; by up to 7 beside mirrors and lobes, and by 17 where these leave an error.
    """
    if not _is_told(asked):
        return []
    found, gain, least = _free_gamma(problem, result)
    if gain < least:
        return []
    text = f"gamma {found.result.state.gamma:.3g} fits better than {_named(asked)} by {gain:.0f} nats"
    return [Why("transfer", None, text, float(gain))]


def doubt_told(problem, result, asked):
    """A transfer function that is told is believed to TOLD_TO of a gamma, as far as the picture does not tell: gamma
    2.4 told for 2.2 beside a mirror, 9 % off, was 45 sigma off and green, since no other fitted better; sRGB told for a
    gamma of 2.4 in dim light 15 %, 56 sigma.

    Where a free one fits better, by less than names it, sigma holds as large a part of what it would change:
    mirrored-2371 told 2.49 for 2.53 was 14 nats worse, of 23, and 19 sigma off.
    """
    if not _is_told(asked) or result.sigma_rho is None:
        return
    widen(problem, result, _as_told(problem, result))
    found, gain, least = _free_gamma(problem, result)
    if gain > 0:
        doubt(result, found.result.state, min(np.sqrt(gain / least), 1.0))  # nats grow as the square of what is wrong


def instead(problem, result, asked) -> Candidate | None:
    """The likeliest fit with another transfer function than the one that is told; None where none is."""
    if asked in (None, "auto"):
        return None
    here = Candidate(problem, result, evidence(problem, result.at))
    return max((_free_gamma(problem, result)[0], *response.fitted(here)), key=lambda c: c.evidence.nats)


def _as_told(problem, result) -> CauseTerms:
    """How far a told function may be off: another gamma, or as much of an exponent; what is said to be sRGB may be a
    gamma."""
    B, transfer = result.state.B, result.state.transfer
    if transfer.kind == "gamma":
        by_gamma = display_residual(replace(problem, fit_transfer=True), B, transfer)[2]
        return CauseTerms(("transfer",), by_gamma, np.array([TOLD_TO]))
    shown = np.clip(transfer.bare.display(transfer.mixed(B)), 1e-6, 1)
    by_exponent = (shown * np.log(shown))[..., None]
    terms = CauseTerms(("transfer",), by_exponent, np.array([TOLD_TO / USUAL_GAMMA]))
    return terms.beside(response.doubted(problem, result.state))


def _is_told(asked):
    return asked not in (None, "auto", "linear", *OF_PICTURE)


def _free_gamma(problem, result):
    """(Candidate with a gamma that is free, the nats by which it is better, the nats that name it)"""
    state = result.state
    free = replace(problem, transfer=Transfer("gamma", USUAL_GAMMA), fit_transfer=True, doubted=None)
    start = Unknowns(state.rho, state.E, free.transfer, state.rho_s)
    found = result.once("free_gamma", lambda: Candidate.of(free, start=start))
    is_bent = problem.specular is not None and found.evidence.discrepancy > 0
    least = (CLEARLY_FROM if is_bent else 1) * enough(problem, 1)
    return found, found.evidence.nats - evidence(problem, result.at).nats, least


def _named(asked):
    if asked in OF_PICTURE:
        return f"linear, which {asked} is until the picture is shown"
    if not isinstance(asked, dict):
        return asked
    return f"the curve of {asked['curve']}" if "curve" in asked else f"gamma {asked['gamma']:g}"


def of_a_picture(first: Candidate, asked) -> list[Why]:
    """What looks at the photograph is asked for to be compared with: of the light it is linear, which is the first to
    be suspected."""
    if asked not in OF_PICTURE:
        return []
    functions = response.fitted(first)
    function = response.simplest(functions).result.state.transfer.bare
    if response.is_like(function, Transfer("linear"), first.problem):
        return []
    return transfer_told(first.problem, asked, response.rivals_of(functions, first))


def other_transfer(first: Candidate, promised: dict, is_free) -> tuple[Candidate, dict] | None:
    """The fit with the simplest transfer function, and {kind: nats} of all that were fitted, where one is told and
    another promises more than any cause.

    promised : {cause: nats} that one step brings;  is_free : the transfer function is
    """
    if is_free or promised.get("response", -np.inf) < max(promised.values()):
        return None
    functions = response.fitted(first)
    best = response.simplest((first, *functions))
    return None if best is first else (best, response.rivals_of(functions, first))
