"""What explains the picture as a whole: causes of the camera, lamps in lobes, or lamps that are told wrongly."""

from __future__ import annotations

from dataclasses import replace

from lib.analysis.causes import colour_mixing, lamp_lobe, response, told_lamps
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.explained import Explained, Taken, surely
from lib.analysis.causes.lamp_lobe import LampLobe
from lib.analysis.causes.scope import Scope
from lib.analysis.causes.search import climbed, finished, is_one_object, promises_of, started, with_causes
from lib.analysis.causes.table import causes_of
from lib.analysis.causes.told_lamps import are_told, lamps_of, promise_of_lamps, with_lamps_freed
from lib.analysis.fit.gauss_newton import fit
from lib.analysis.fit.problem import Problem
from lib.given.materials import Why

# Told lamps are set free beside causes once one step promises so much of what suffices. In rooms whose lamps were
# told rightly it promised at most a tenth.
FREE_LAMPS_FROM = 0.5
# Told lamps are tried in place of a cause if they promise so much of what it brings. Wrong lamps promised .8 to 1 of
# it, right ones .34.
LAMPS_ALONE_FROM = 0.5
# Display. Free lamps that change the picture by less are no others. In a white room right lamps changed it by 2.1e-4,
# lamps 3 % off by 5.2e-4.
LIGHT_KNOWN_TO = 3e-4


def explain(problem: Problem, scope: Scope, **options) -> Explained:
    """The fit with the causes that the photograph supports, those of the lamps' lobes last.

    options : of gauss_newton.gauss_newton
    """
    first = started(problem, scope, options.pop("gamma", None), options.get("trace"))
    found = with_causes(first, scope, **options)
    return with_lobes(found, scope, **options).kept(**options)


def with_lobes(found: Explained, scope: Scope, **options) -> Explained:
    """The same with lamps that throw their light in lobes, where the photograph asks for that.

    In place of what was taken where that does not suffice, or beside it.
    """
    if scope.lobes is None or found.best is None or not (scope.lobes.asked or found.result.in_doubt):
        return found
    first = found.given
    least = 0.0 if scope.lobes.asked else enough(first.problem)
    instead, beside = (first, []), (found.best, found.taken)
    bases = [instead] if not found.taken else [beside] if found.result.fits else [instead, beside]
    for base, before in bases:
        if base is not bases[0][0] and found.result.fits:
            break
        lobed = _lobed(base, scope.lobes, not found.result.fits)
        if lobed is None or lamp_lobe.is_flat(lobed):
            continue
        most = lobed.evidence.nats + max(promises_of(lobed, causes_of(scope)).values(), default=0.0)
        if most < found.best.evidence.nats - least:
            continue
        instead_of = {} if before else {taken.cause: taken.nats for taken in found.taken}
        taken = Taken(LampLobe.name, lobed.evidence.nats - base.evidence.nats, instead_of)
        other = finished(first, lobed, [*before, taken], scope, options)
        if other.best.evidence.nats >= found.best.evidence.nats + least:
            found = other
    return found


def lobes_may_explain(found: Explained, scope: Scope, nats) -> bool:
    """Lamps that throw their light in lobes may explain more than something else does by so many nats, all told."""
    if scope.lobes is None or scope.lobes.asked:
        return scope.lobes is not None
    return any(_uneven(base, scope.lobes).evidence.nats > nats for base in (found.given, found.best))


def _lobed(base: Candidate, lobes: LampLobe, hopeless) -> Candidate | None:
    """The fit with lamps that throw their light in lobes; None where uneven light brings too little.

    hopeless : nothing else explains the photograph: a lobe may, even where light that is uneven does not
    """
    uneven = _uneven(base, lobes)
    gain = uneven.evidence.nats - base.evidence.nats
    tries = hopeless or lobes.asked or gain >= surely(base.problem)
    if not tries or not lobes.asked and is_one_object(base, gain):
        return None
    return lamp_lobe.begun(base, uneven, lobes)


def _uneven(base: Candidate, lobes: LampLobe) -> Candidate:
    return base.once("uneven", lambda base: lamp_lobe.uneven(base, lobes))


def lamps_told_wrong(found: Explained, scope: Scope, **options) -> list[Why]:
    """Emittances that are told, where causes suffice, but others do so with fewer, or with as many explain more.

    sRGB counts as none: it has no free number.
    """
    told, best = found.given.problem, found.best
    if not found.taken or not are_told(told) or not found.result.fits:
        return []
    free, taken = _with_free_lamps(found, scope)
    gain, least = free.evidence.nats - best.evidence.nats, enough(told)
    as_many = _enough_of_lamps(told)
    spares = len(taken) < sum(not (t.cause == "response" and best.kind == "srgb") for t in found.taken)
    if gain < as_many and (gain < -least or not spares) or not spares and free.off(best) < LIGHT_KNOWN_TO:
        return []
    result, _ = fit(free.problem, start=free.start, **options)
    if not result.fits:
        return []  # what is wrong is something else, to which the lamps bend too
    spared = [t.name for t in found.taken if t.cause not in {u.cause for u in taken}]
    if gain < 0 or colour_mixing.ColourMixing.name not in spared:  # the camera may mix colours, and have the lamps so
        told = replace(told, emittance=best.problem.transfer.mixed(told.emittance))
    return lamps_of(told, result, gain, spared if gain < as_many else ())


def _enough_of_lamps(problem: Problem) -> float:
    """Nats that lamps of any emittance must bring: a number for each lamp and channel, to which a curve can bend."""
    return enough(problem, int(problem.own_lamps.sum()) * problem.channels)


def _with_free_lamps(found: Explained, scope: Scope):
    """(Candidate, [Taken]): the best explanation by lamps of any emittance, and causes where these do not suffice.

    What was found, where lamps promise nothing beside it.
    """
    given, best = found.given, found.best
    problem, least = told_lamps.freed(given.problem), best.evidence.nats - enough(given.problem)
    alone = promise_of_lamps(given)
    if len(found.taken) > 1 or alone >= LAMPS_ALONE_FROM * (best.evidence.nats - given.evidence.nats):
        first = with_lamps_freed(given)
        if len(found.taken) > 1 or first.evidence.nats >= least:
            return climbed(first, scope)[:2]
    if best.kind == "curve" and scope.response:  # it bends to lamps that are told wrongly
        simple = response.under_srgb(Candidate(problem, given.result, given.evidence))
        if simple.evidence.nats >= least:
            return simple, []
    if promise_of_lamps(best) < FREE_LAMPS_FROM * _enough_of_lamps(problem):
        return best, found.taken
    return with_lamps_freed(best), found.taken
