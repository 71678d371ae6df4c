"""Which transfer function the photograph supports: the simplest of gamma, sRGB and a free curve.

Gamma is fitted first, roughly. One step from there towards a curve tells what more freedom would bring to the tiles
that are held out; only where that is worth something a curve is fitted, and sRGB or gamma again where the curve found
is like them. A simpler function wins unless a curve beats it by more than chance. A function that scene.yaml names is
never replaced; what beats it is its rival.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.candidates import Candidate
from lib.analysis.equations import smooth
from lib.analysis.evidence import promised
from lib.analysis.facts import USUAL_GAMMA
from lib.analysis.problem import CauseTerms, display_residual, observe
from lib.analysis.uncertainty import RESOLVED
from lib.given.tone_curve import KNOTS
from lib.given.transfer import Metric, Transfer

ALIKE = 0.02  # display: a curve that is so near to a simpler function may be that one


def promise(found: Candidate) -> float:
    """Nats that one step from the fit towards a free curve brings."""
    at, problem = found.result.at, found.problem
    curve = at.state.transfer.as_curve()
    metric, seen = Metric(curve), observe(problem, curve.bare)
    columns = metric.by_parameters(curve.mixed(at.state.B)) - metric.by_parameters(seen[0])
    columns = columns - metric.slope(seen[0])[..., None] * seen[1]
    prior = smooth(len(KNOTS))
    return promised(problem, at, columns, at.layout.responding, prior).nats - found.evidence.nats


def under_srgb(found: Candidate) -> Candidate:
    """The fit with sRGB."""
    srgb = Transfer("srgb", matrix=found.problem.transfer.matrix)
    return Candidate.of(replace(found.problem, transfer=srgb, fit_transfer=False), found.taken, start=found.start)


def fitted(found: Candidate) -> list[Candidate]:
    """The fit with a free curve, then those under simpler functions that the curve is like."""
    problem, taken = found.problem, found.taken
    mixed = {"matrix": problem.transfer.matrix}
    curve = replace(Transfer("gamma", USUAL_GAMMA).as_curve(), **mixed)
    # specular problems must begin where mirrors and lobes reflect as found
    begun = lambda transfer: problem.specular and found.start._replace(transfer=transfer, near=None)
    told = replace(problem, transfer=curve, fit_transfer=True)
    free = Candidate.of(told, taken | {"curve": {}}, start=begun(curve))
    seen = np.quantile(problem.photograph.display(), (0.01, 0.99))
    function = free.result.state.transfer.bare
    light = function.linear(np.linspace(*seen, 50))
    shown = function.display(light)
    result = [free]
    for simple in (Transfer("srgb"), Transfer("gamma", USUAL_GAMMA)):
        has_parameters = len(simple.parameters) > 0
        own = simple.kind == problem.transfer.kind and problem.fit_transfer == has_parameters
        if not own and np.abs(_likest(simple, light, shown) - shown).max() < ALIKE:
            simple = replace(simple, **mixed)
            told = replace(problem, transfer=simple, fit_transfer=has_parameters)
            result.append(Candidate.of(told, taken, start=begun(simple)))
    return result


def _likest(simple: Transfer, light, shown):
    """What the simple function shows of the light, with the gamma that suits best."""
    if simple.kind == "gamma":
        slope = np.polyfit(np.log(np.maximum(shown, 1e-6)), np.log(np.maximum(light, 1e-12)), 1)[0]
        simple = simple.moved([np.clip(slope, *simple.bounds)])
    return simple.display(light)


def simplest(candidates) -> Candidate:
    """The one with the fewest free numbers that no other beats by enough, and by more than light is known to."""
    best = None
    for candidate in sorted(candidates, key=lambda c: c.complexity):
        if best is None or candidate.is_worth(best) and _is_resolved(candidate, best):
            best = candidate
    return best


def unresolved(candidates, best: Candidate) -> float:
    """Nats that functions bring that change the picture by less than light is known to: so much errors of it bring."""
    bent = [c.evidence.nats - best.evidence.nats for c in candidates if not _is_resolved(c, best)]
    return max(bent, default=0.0)


def _is_resolved(one: Candidate, other: Candidate) -> bool:
    return np.sqrt(np.mean((one.evidence.residual - other.evidence.residual) ** 2)) >= RESOLVED


def doubted(found: Candidate) -> CauseTerms | None:
    """What the other one of gamma and sRGB would change: in a narrow range of light nothing tells them apart."""
    transfer, B = found.result.state.transfer, found.result.state.B
    other = {"gamma": Transfer("srgb"), "srgb": Transfer("gamma", USUAL_GAMMA)}.get(transfer.kind)
    if other is None:
        return None
    there, here = (display_residual(found.problem, B, t)[0] for t in (replace(other, matrix=transfer.matrix), transfer))
    return CauseTerms(("response",), (there - here)[..., None], np.ones(1))
