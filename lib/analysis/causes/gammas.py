"""Where a search for gamma may begin: reflectances and gamma share a valley, and some rooms have two.

Dark photographs have another minimum beyond gamma 4, and so have white rooms.
"""

from __future__ import annotations

from lib.analysis.causes import response
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.fit.facts import USUAL_GAMMA

STARTS = (1.2, 1.8, 3.0)  # other gammas to begin at
FAR_GAMMA = 4.0  # Beyond this gamma other starts are tried, whatever is left to explain.
SAME_GAMMA = 0.01  # Gammas that differ by less are of one minimum.
LOST_FROM = (
    0.045  # Display, median of the tiles. A gamma that ran away leaves less (.025), a lamp turned round more (.067).
)
HOPELESS_FROM = 0.015  # Display, median of the tiles. No other start of gamma explains what is so far off.
# Another gamma is tried if a curve still promises so much of what the cause brought. Right ones leave .03; one beside
# a gamma of 5.6 for 2.2 leaves .17.
STUCK_FROM = 0.05


def searched(found: Candidate) -> bool:
    """Another start may find another gamma."""
    return found.problem.fit_transfer and found.kind == "gamma" and found.typical < HOPELESS_FROM


def is_stuck(fitted: Candidate, before: Candidate) -> bool:
    """Another gamma may suit a cause better: a curve still promises much beside what the cause has brought."""
    much = max(enough(fitted.problem), STUCK_FROM * (fitted.evidence.nats - before.evidence.nats))
    return searched(fitted) and response.promise(fitted) >= much


def ran_away(found: Candidate) -> bool:
    """gamma went where hardly a camera is, as in white rooms in dim light, where all reflectances go to 0 with it."""
    gamma = found.result.state.gamma if found.problem.fit_transfer and found.kind == "gamma" else 0.0
    return gamma > FAR_GAMMA and found.typical < LOST_FROM


def from_others(first: Candidate) -> Candidate:
    """The likeliest of the fits that begin elsewhere, or this one."""
    gamma = first.result.state.gamma
    starts = STARTS if gamma > USUAL_GAMMA else STARTS[::-1]
    across = Candidate.of(first.problem, gamma=starts[0])  # from the other side of where the first began
    if abs(across.result.state.gamma - gamma) < SAME_GAMMA:
        return first
    others = [Candidate.of(first.problem, gamma=start) for start in starts[1:]]
    return max([first, across, *others], key=lambda c: c.evidence.nats)
