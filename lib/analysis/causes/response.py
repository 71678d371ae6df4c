"""Which transfer function the photograph supports: the simplest of gamma, sRGB and a free curve.

Gamma is fitted first, roughly. One step from there towards a curve tells what more freedom would bring to the tiles
that are held out; only where that is worth something sRGB is fitted, which has no free number, a curve where that may
win, and gamma again where the curve is like one. A simpler function wins unless a curve beats it by more than chance. A
function that scene.yaml names is never replaced; what beats it is its rival.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.cause import Cause, Tried
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.equations import smooth
from lib.analysis.fit.evidence import promised
from lib.analysis.fit.facts import USUAL_GAMMA
from lib.analysis.fit.problem import CauseTerms, display_residual, observe
from lib.analysis.fit.uncertainty import RESOLVED
from lib.given.tone_curve import KNOTS
from lib.given.transfer import Metric, Transfer

# Display. A curve that is nearer to a simpler function may be that one; of a linear picture it was by .0045.
ALIKE_TO = 0.02
# A curve is fitted first if so many times what it must bring is promised; sRGB only if the curve is like it.
CURVE_FIRST_FROM = 5
CURVE_AT_ALL_FROM = (
    0.6  # A curve is not fitted if one step promises less of what it must bring. The two differ by a tenth.
)


class Response(Cause):
    """Another transfer function than the one that is fitted or told."""

    name = "response"
    free = 0  # sRGB has no free number
    is_linearised = False

    def __init__(self, is_free):
        """is_free : it may be taken; one that scene.yaml tells only has rivals"""
        self.is_free = is_free

    @classmethod
    def of(cls, scope: Scope):
        return cls(scope.response)

    def may(self, found: Candidate) -> bool:
        return found.problem.transfer.kind != "linear" or not self.is_free  # EXR is linear by what it is

    def comes_along(self, found: Candidate) -> bool:
        return self.is_free and found.kind == "gamma"

    def promise(self, found: Candidate) -> float:
        return promise(found)

    def tried(self, found: Candidate, promised) -> Tried:
        functions = (found, *fitted(found, promised if self.is_free else np.inf))
        best = simplest(functions) if self.is_free else found
        return Tried(best, functions, unresolved(functions, best, promised), is_simpler=best.kind == "srgb")

    def says(self, values, problem, result):
        return [(None, {}, None)]  # `transfer` of materials.json has the curve


def promise(found: Candidate) -> float:
    """Nats that one step from the fit towards a free curve brings."""
    return found.once(Response.name, _one_step)


def _one_step(found: Candidate) -> float:
    at, problem = found.result.at, found.problem
    curve = at.state.transfer.as_curve()
    metric, seen = Metric(curve), observe(problem, curve.bare)
    columns = metric.by_parameters(curve.mixed(at.state.B)) - metric.by_parameters(seen[0])
    columns = columns - metric.slope(seen[0])[..., None] * seen[1]
    prior = smooth(len(KNOTS))
    return found.one_step(Response.name, promised(problem, at, columns, at.layout.responding, prior))


def under_srgb(found: Candidate) -> Candidate:
    """The fit with sRGB."""
    srgb = Transfer("srgb", matrix=found.problem.transfer.matrix)
    return Candidate.of(replace(found.problem, transfer=srgb, fit_transfer=False), found.taken, start=found.start)


def fitted(found: Candidate, promised=np.inf) -> list[Candidate]:
    """The fits under sRGB, which has no free number, with a free curve where so many nats promised let it win, and with
    a gamma where the curve is like one. Where so much is promised that a curve wins, sRGB is fitted if it is like it.

    promised : by `promise`; inf: all are to be compared
    """
    problem, result = found.problem, []
    least = enough(problem, len(KNOTS) - found.complexity)
    if promised < CURVE_FIRST_FROM * least or np.isinf(promised):
        result = [] if found.kind == "srgb" else [under_srgb(found)]
        brought = max((c.evidence.nats - found.evidence.nats for c in result), default=0.0)
        if promised - max(brought, 0.0) < CURVE_AT_ALL_FROM * least:
            return result
    mixed = {"matrix": problem.transfer.matrix}
    curve = replace(Transfer("gamma", USUAL_GAMMA).as_curve(), **mixed)
    # specular problems must begin where mirrors and lobes reflect as found
    begun = lambda transfer: problem.specular and found.start._replace(transfer=transfer, near=None)
    told = replace(problem, transfer=curve, fit_transfer=True)
    free = Candidate.of(told, found.taken | {"curve": {}}, start=begun(curve))
    function = free.result.state.transfer.bare
    if not result and found.kind != "srgb" and is_like(function, Transfer("srgb"), problem):
        result.append(under_srgb(found))
    own = problem.transfer.kind == "gamma" and problem.fit_transfer
    if not own and is_like(function, Transfer("gamma", USUAL_GAMMA), problem):
        gamma = replace(Transfer("gamma", USUAL_GAMMA), **mixed)
        told = replace(problem, transfer=gamma, fit_transfer=True)
        result.append(Candidate.of(told, found.taken, start=begun(gamma)))
    return [free, *result]


def is_like(function: Transfer, simple: Transfer, problem) -> bool:
    """Over the light that the photograph shows, with the gamma that suits best."""
    light = function.linear(np.linspace(*np.quantile(problem.photograph.display(), (0.01, 0.99)), 50))
    shown = function.display(light)
    if simple.kind == "gamma":
        slope = np.polyfit(np.log(np.maximum(shown, 1e-6)), np.log(np.maximum(light, 1e-12)), 1)[0]
        simple = simple.moved([np.clip(slope, *simple.bounds)])
    return bool(np.abs(simple.display(light) - shown).max() < ALIKE_TO)


def simplest(candidates) -> Candidate:
    """The one with the fewest free numbers that no other beats by enough, and by more than light is known to."""
    best = None
    for candidate in sorted(candidates, key=lambda c: c.complexity):
        if best is None or candidate.is_worth(best) and _is_resolved(candidate, best):
            best = candidate
    return best


def unresolved(candidates, best: Candidate, promised=None) -> float:
    """Nats that functions bring that change the picture by less than light is known to: so much errors of it bring.

    candidates : the first is where they began;  promised : by a curve from there, where none was fitted
    """
    bent = [c.evidence.nats - best.evidence.nats for c in candidates if not _is_resolved(c, best)]
    if promised is not None and all(c.kind != "curve" for c in candidates):
        bent.append(promised - (best.evidence.nats - candidates[0].evidence.nats))
    return max(bent, default=0.0)


def rivals_of(functions, best) -> dict:
    """{kind: nats} by which other transfer functions beat the best's."""
    return {c.kind: c.evidence.nats - best.evidence.nats for c in functions if c is not best}


def _is_resolved(one: Candidate, other: Candidate) -> bool:
    return Candidate.off(one, other) >= RESOLVED


def doubted(problem, state) -> CauseTerms | None:
    """What the other one of gamma and sRGB would change: in a narrow range of light nothing tells them apart."""
    transfer, B = state.transfer, state.B
    other = {"gamma": Transfer("srgb"), "srgb": Transfer("gamma", USUAL_GAMMA)}.get(transfer.kind)
    if other is None:
        return None
    there, here = (display_residual(problem, B, t)[0] for t in (replace(other, matrix=transfer.matrix), transfer))
    return CauseTerms(("response",), (there - here)[..., None], np.ones(1))
