"""Global causes before materials: what may be wrong with the picture as a whole, judged before any group climbs.

The fit under the given facts comes first. From there one step towards each cause tells what it would bring to held-out
tiles: next to nothing where the facts suffice, and then nothing more is computed. Causes that promise enough are
fitted, the best is taken if it keeps its promise, and the question is asked again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lib.analysis.causes import agreement, glow, lamp_lobe, matrix, patterned, responses, unlike, vignetting
from lib.analysis.causes.agreement import (
    are_told,
    fits,
    in_doubt,
    lamps_of,
    out_of_range,
    promise_of_lamps,
    with_lamps_freed,
)
from lib.analysis.causes.candidates import MIXING, USUAL, Candidate, enough
from lib.analysis.causes.explained import Explained, Taken, surely
from lib.analysis.causes.lamp_lobe import LampLobes
from lib.analysis.fit.facts import USUAL_GAMMA
from lib.analysis.fit.gauss_newton import fit
from lib.analysis.fit.problem import CauseTerms, Problem
from lib.analysis.seen.gather import Gathered
from lib.given.causes import BUILT
from lib.given.falloff import Lens
from lib.given.materials import Why

LAMPS, OBJECT = "lamps", "object"  # what may be wrong that is no cause: emittances that are told, one reflectance
STARTS = (1.2, 1.8, 3.0)  # other gammas to begin at
FAR_GAMMA = 4.0  # beyond it other starts are tried whatever is left to explain
SAME = 0.01  # gammas that differ by less are of one minimum
LOST = 0.045  # display, median of the tiles: gammas that ran away left .025, a lamp turned round .067
HOPELESS = 0.015  # display, median of the tiles: no other start of gamma explains what is so far off
NEARLY = 0.5  # of the most that a cause promises, from which another is fitted beside it: .35 were the most in 16 rooms
STUCK = 0.05  # of what a cause has brought: right ones leave .03, one beside a gamma of 5.6 for 2.2 leaves .17
ALMOST = 0.5  # of what is enough, from which told lamps are set free beside causes: right ones promise .1 at most
ALONE = 0.5  # of what a cause brings, that lamps alone promise at least where they are wrong: .8 to 1; right ones .34
LIGHT_KNOWN_TO = 3e-4  # display: right lamps that were set free changed a white room by 2.1e-4, ones 3 % off by 5.2e-4


@dataclass(frozen=True, eq=False)
class Leave:
    """What may be explained. response : the transfer function is free;  causes : that may be taken

    lens, pixel : where the pixels (M,) of the tiles lie; None: nothing is known of the lens
    lobes : of the lamps, None where nothing is known of the ways of their light
    vain : nothing can be learnt from such values
    """

    response: bool = True
    causes: tuple = BUILT
    lens: Lens | None = None
    pixel: object = None
    lobes: LampLobes | None = None
    vain: bool = False

    @classmethod
    def of(cls, camera, found: Gathered, transfer, causes, lobes=None) -> Leave:
        """camera : Camera or None;  transfer, causes : of scene.yaml, None: all that is left open"""
        lens = None if camera is None else Lens((camera.K[0, 2], camera.K[1, 2]), (camera.width, camera.height))
        causes = tuple(BUILT if causes is None else causes)
        response = transfer in (None, "auto") and "curve" in causes
        return cls(response, causes, lens, found.tiles.pixel, lobes, vain=out_of_range(found))


def explain(problem: Problem, leave: Leave, **options) -> Explained:
    """The fit with the causes that the photograph supports, those of the lamps' lobes last.

    options : of gauss_newton.gauss_newton
    """
    first = started(problem, leave, options.pop("gamma", None), options.get("trace"))
    found = without_lobes(first, leave, **options)
    return with_lobes(found, leave, **options).kept(**options)


def as_given(problem: Problem, **options) -> Explained:
    """The fit under the given facts; neither causes nor rivals are looked for. options : of gauss_newton"""
    return Explained(problem, *fit(problem, **options))


def started(problem: Problem, leave: Leave, gamma=None, trace=None) -> Candidate | Problem:
    """The rough fit under the given facts; the problem itself where nothing can be learnt from one."""
    if leave.vain or not len(problem.tile_group):
        return problem
    first = Candidate.of(problem, trace=trace, gamma=gamma)
    first = _from_other_gammas(first) if _ran_away(first) else first
    return first if leave.lens is None else patterned.beside(first, leave.pixel, leave.lens.size[0])


def without_lobes(first: Candidate | Problem, leave: Leave, **options) -> Explained:
    """The fit with the causes that are of the camera alone. first : of `started`"""
    if isinstance(first, Problem):
        return Explained(first, *fit(first, **options), lens=leave.lens)
    first = _begun(first, leave)
    return _finished(first, first, [], leave, options)


def with_lobes(found: Explained, leave: Leave, **options) -> Explained:
    """The same with lamps that throw their light in lobes, where the photograph asks for that.

    In place of what was taken where that does not suffice, or beside it.
    """
    if leave.lobes is None or found.best is None or not (leave.lobes.asked or in_doubt(found.result)):
        return found
    first = found.given
    least = 0.0 if leave.lobes.asked else enough(first.problem)
    instead, beside = (first, []), (found.best, found.taken)
    bases = [instead] if not found.taken else [beside] if fits(found.result) else [instead, beside]
    for base, before in bases:
        if base is not bases[0][0] and fits(found.result):
            break
        lobed = _lobed(base, leave.lobes, not fits(found.result))
        if lobed is None or lamp_lobe.is_flat(lobed):
            continue
        if lobed.evidence.nats + max(_promises(lobed, leave).values(), default=0.0) < found.best.evidence.nats - least:
            continue
        instead_of = {} if before else {taken.cause: taken.nats for taken in found.taken}
        taken = Taken(lamp_lobe.NAME, lobed.evidence.nats - base.evidence.nats, instead_of)
        other = _finished(first, lobed, [*before, taken], leave, options)
        if other.best.evidence.nats >= found.best.evidence.nats + least:
            found = other
    return found


def lobes_may_explain(found: Explained, leave: Leave, nats) -> bool:
    """Lamps that throw their light in lobes may explain more than something else does by so many nats, all told."""
    if leave.lobes is None or leave.lobes.asked:
        return leave.lobes is not None
    return any(_uneven(base, leave.lobes).evidence.nats > nats for base in (found.given, found.best))


def lamps_alone(first: Candidate, promised: dict, leave: Leave) -> Candidate | None:
    """The fit with lamps of any emittance, where free ones promise more than any cause and keep it.

    Right ones promise nothing, and beside other causes at most a third of what these do; nor are they wrong where sRGB,
    which has no free number, explains as much. promised : of `promises`
    """
    most = max(promised.values())
    if promised.get(LAMPS, -np.inf) < most:
        return None
    free = with_lamps_freed(first)
    if free.evidence.nats - first.evidence.nats < most:
        return None
    asks = leave.response and first.kind == "gamma" and promised.get("response", -np.inf) >= enough(first.problem)
    is_srgb = asks and responses.under_srgb(first).evidence.nats >= free.evidence.nats - enough(first.problem)
    return None if is_srgb else free


def other_transfer(first: Candidate, promised: dict, leave: Leave) -> tuple[Candidate, dict] | None:
    """The fit with the simplest transfer function, and {kind: nats} of all that were fitted, where one is told and
    another promises more than any cause. promised : of `promises`
    """
    if leave.response or promised.get("response", -np.inf) < max(promised.values()):
        return None
    functions = responses.fitted(first)
    best = responses.simplest((first, *functions))
    return None if best is first else (best, _rivals(functions, first))


def promises(first: Candidate, leave: Leave) -> dict:
    """{cause: nats} that one step brings: of the causes of the camera, of LAMPS that are told, of one OBJECT."""
    found = _promises(first, leave) | {OBJECT: _of_one_object(first)}
    return found | ({LAMPS: promise_of_lamps(first)} if are_told(first.problem) else {})


def lamps_told_wrong(found: Explained, leave: Leave, **options) -> list[Why]:
    """Emittances that are told, where causes suffice, but others do so with fewer, or with as many explain more.

    sRGB counts as none: it has no free number.
    """
    told, best = found.given.problem, found.best
    if not found.taken or not are_told(told) or not fits(found.result):
        return []
    free, taken = _with_free_lamps(found, leave)
    gain, least = free.evidence.nats - best.evidence.nats, enough(told)
    as_many = _enough_of_lamps(told)
    spares = len(taken) < sum(not (t.cause == "response" and best.kind == "srgb") for t in found.taken)
    if gain < as_many and (gain < -least or not spares) or not spares and free.off(best) < LIGHT_KNOWN_TO:
        return []
    result, _ = fit(free.problem, start=free.start, **options)
    if not fits(result):
        return []  # what is wrong is something else, to which the lamps bend too
    spared = [t.name for t in found.taken if t.cause not in {u.cause for u in taken}]
    if gain < 0 or matrix.NAME not in spared:  # the camera may mix colours, and have the lamps so
        told = replace(told, emittance=best.problem.transfer.mixed(told.emittance))
    return lamps_of(told, result, gain, spared if gain < as_many else ())


def _enough_of_lamps(problem: Problem) -> float:
    """Nats that lamps of any emittance must bring: a number for each lamp and channel, to which a curve can bend."""
    return enough(problem, int(problem.own_lamps.sum()) * problem.channels)


def _with_free_lamps(found: Explained, leave: Leave):
    """(Candidate, [Taken]): the best explanation by lamps of any emittance, and causes where these do not suffice.

    What was found, where lamps promise nothing beside it.
    """
    given, best = found.given, found.best
    problem, least = agreement.freed(given.problem), best.evidence.nats - enough(given.problem)
    alone = promise_of_lamps(given)
    if len(found.taken) > 1 or alone >= ALONE * (best.evidence.nats - given.evidence.nats):
        first = with_lamps_freed(given)
        if len(found.taken) > 1 or first.evidence.nats >= least:
            return _climbed(first, leave)[:2]
    if best.kind == "curve" and leave.response:  # it bends to lamps that are told wrongly
        simple = responses.under_srgb(Candidate(problem, given.result, given.evidence))
        if simple.evidence.nats >= least:
            return simple, []
    if promise_of_lamps(best) < ALMOST * _enough_of_lamps(problem):
        return best, found.taken
    return with_lamps_freed(best), found.taken


def _finished(given: Candidate, begun: Candidate, taken, leave: Leave, options) -> Explained:
    """With the causes that the photograph supports beside those of `begun`, [Taken]."""
    best, more, functions = _climbed(begun, leave)
    variance = patterned.still(best, leave.pixel, leave.lens)
    problem = replace(best.problem, doubted=doubted(best) if leave.response else None, variance=variance)
    result, scale = fit(problem, start=best.start, **options)
    result.iterations += best.result.iterations
    return Explained(
        problem, result, scale, _rivals(functions, best), [*taken, *more], best.taken, given, best, leave.lens
    )


def doubted(best: Candidate) -> CauseTerms | None:
    """What the camera may be as well."""
    function, mixing = responses.doubted(best.problem, best.result.state), matrix.doubted(best)
    return function.beside(mixing) if function else mixing


def _rivals(functions, best) -> dict:
    """{kind: nats} by which other transfer functions beat the best's."""
    return {c.kind: c.evidence.nats - best.evidence.nats for c in functions if c is not best}


def _lobed(base: Candidate, lobes: LampLobes, hopeless) -> Candidate | None:
    """The fit with lamps that throw their light in lobes; None where uneven light brings too little.

    hopeless : nothing else explains the photograph: a lobe may, even where light that is uneven does not
    """
    uneven = _uneven(base, lobes)
    gain = uneven.evidence.nats - base.evidence.nats
    tries = hopeless or lobes.asked or gain >= surely(base.problem)
    if not tries or not lobes.asked and _is_one_object(base, gain):
        return None
    return lamp_lobe.begun(base, uneven, lobes)


def _uneven(base: Candidate, lobes: LampLobes) -> Candidate:
    return base.once("uneven", lambda base: lamp_lobe.uneven(base, lobes))


def _begun(first: Candidate, leave: Leave) -> Candidate:
    """The rough fit under the given facts, from other gammas as well where it leaves something to explain.

    gamma and the reflectances share a valley: dark photographs have another minimum beyond gamma 4, and so have white
    rooms.
    """
    promise = first.once("response", responses.promise)
    if not _searches_gamma(first) or promise < enough(first.problem) or _is_one_object(first, promise):
        return first
    if _may_glow(first, leave) and first.once(glow.NAME, glow.promise) > promise:
        return first  # no gamma is what is wrong
    return _from_other_gammas(first)


def _from_other_gammas(first: Candidate) -> Candidate:
    """The likeliest of the fits that begin elsewhere, or this one."""
    found = first.result.state.gamma
    starts = STARTS if found > USUAL_GAMMA else STARTS[::-1]
    across = Candidate.of(first.problem, gamma=starts[0])  # from the other side of where the first began
    if abs(across.result.state.gamma - found) < SAME:
        return first
    others = [Candidate.of(first.problem, gamma=start) for start in starts[1:]]
    return max([first, across, *others], key=lambda c: c.evidence.nats)


def _ran_away(found: Candidate) -> bool:
    """gamma went where hardly a camera is, as in white rooms in dim light, where all reflectances go to 0 with it."""
    gamma = found.result.state.gamma if found.problem.fit_transfer and found.kind == "gamma" else 0.0
    return gamma > FAR_GAMMA and found.typical < LOST


def _climbed(best: Candidate, leave: Leave):
    """The best candidate, [Taken] on the way to it, and the candidates with other transfer functions."""
    taken, functions, tried, errors = [], (), {vignetting.NAME} & best.taken.keys(), 0.0
    while wanted := _promising(best, leave, tried):
        promised, most = wanted, max(wanted, key=wanted.get)
        near = {cause for cause, nats in promised.items() if nats >= NEARLY * promised[most]}
        # the others only bend to a glow and to mixing, colours bend to all else
        wanted = {most} if most in (glow.NAME, matrix.NAME) else near - {matrix.NAME}
        more = promised["response"] if "response" in wanted else 0.0
        if leave.response and best.kind == "gamma" and "response" not in tried:
            wanted |= {"response"}  # sRGB, where nothing else than that may be needed
        tried |= wanted
        candidates = {}
        if "response" in wanted:
            functions = (best, *responses.fitted(best, more if leave.response else np.inf))
            candidates["response"] = _settled(responses.simplest(functions), best, leave) if leave.response else best
            errors = responses.unresolved(functions, candidates["response"], more)
        if "vignetting" in wanted:
            shadow = _settled(_vignetted(best, leave), best, leave)
            candidates |= {"vignetting": shadow} if vignetting.is_shadow(shadow) else {}
        if matrix.NAME in wanted:
            mixed = _settled(matrix.fitted(best), best, leave)
            candidates |= {matrix.NAME: mixed} if matrix.is_of_the_camera(mixed, best) else {}
        if glow.NAME in wanted:
            candidates[glow.NAME] = _settled(_in_glow(best), best, leave)
        better = {
            cause: c
            for cause, c in candidates.items()
            if c is not best and c.beats(best) and c.evidence.nats - best.evidence.nats > errors
        }
        simple = candidates.get("response")
        if simple and simple.kind == "srgb":  # it has no free number, so a cause must beat it by all of its own
            least = simple.evidence.nats + enough(best.problem, USUAL + best.complexity)
            better = {cause: c for cause, c in better.items() if c is simple or c.evidence.nats >= least}
        if not better:
            continue
        cause = max(better, key=lambda cause: better[cause].evidence.nats)
        gain = promised | {name: c.evidence.nats - best.evidence.nats for name, c in candidates.items()}
        taken.append(Taken(cause, gain.pop(cause), gain))
        best, tried = better[cause], {t.cause for t in taken}
        functions = functions if cause == "response" else ()
    return best, taken, functions


def _settled(found: Candidate, before: Candidate, leave: Leave) -> Candidate:
    """With what was taken before fitted again, where that was linearised, if it is another explanation than before."""
    if found is before:
        return found
    if vignetting.NAME in before.taken:
        found = vignetting.fitted(found, leave.lens, leave.pixel)
    return lamp_lobe.fitted(found, leave.lobes) if lamp_lobe.NAME in found.taken else found


def _vignetted(best: Candidate, leave: Leave) -> Candidate:
    """The fit with a vignetted lens, from other gammas as well where the first leaves something to explain."""
    first = vignetting.fitted(best, leave.lens, leave.pixel)
    if not _is_stuck(first, best) and not (_searches_gamma(first) and vignetting.is_strange(first)):
        return first
    other = vignetting.fitted_from(best, (*STARTS, USUAL_GAMMA), leave.lens, leave.pixel)
    return max(first, other, key=lambda c: c.evidence.nats)


def _in_glow(best: Candidate) -> Candidate:
    """The fit with a glow from outside, from other gammas as well where the first leaves something to explain."""
    first = glow.fitted(best)
    if not _is_stuck(first, best):
        return first
    return max(first, glow.fitted_from(best, (*STARTS, USUAL_GAMMA)), key=lambda c: c.evidence.nats)


def _is_stuck(first: Candidate, before: Candidate) -> bool:
    """Another gamma may suit a cause better: a curve still promises much beside what the cause has brought."""
    much = max(enough(first.problem), STUCK * (first.evidence.nats - before.evidence.nats))
    return _searches_gamma(first) and first.once("response", responses.promise) >= much


def _may_glow(found: Candidate, leave: Leave) -> bool:
    """A glow from outside may be what is wrong."""
    return glow.NAME in leave.causes and glow.is_dark(found.problem)


def _searches_gamma(found: Candidate) -> bool:
    """Another start may find another gamma."""
    return found.problem.fit_transfer and found.kind == "gamma" and found.typical < HOPELESS


def _promising(found: Candidate, leave: Leave, tried) -> dict:
    """{cause: nats} of the causes that one step promises enough of."""
    more = {matrix.NAME: MIXING, "response": 0}  # sRGB has no free number
    promises = _promises(found, leave, tried)
    held = {cause: nats for cause, nats in promises.items() if nats >= enough(found.problem, more.get(cause, USUAL))}
    return {} if held and _is_one_object(found, max(held.values())) else held


def _promises(found: Candidate, leave: Leave, tried=()) -> dict:
    """{cause: nats} that one step brings, of the causes that may be taken and were not tried."""
    ask = {}
    if found.problem.transfer.kind != "linear" or not leave.response:  # EXR is linear by what it is
        ask["response"] = responses.promise
    if leave.lens is not None and "vignetting" in leave.causes:
        ask["vignetting"] = lambda found: vignetting.promise(found, leave.lens, leave.pixel)
    if _may_glow(found, leave):
        ask[glow.NAME] = glow.promise
    if leave.response and matrix.NAME not in tried and matrix.may(found):
        ask[matrix.NAME] = matrix.promise
    return {cause: found.once(cause, how) for cause, how in ask.items() if cause not in tried}


def _is_one_object(found: Candidate, promise) -> bool:
    """What is wrong is the reflectance of one object, rather than a cause with such a promise: most tiles are right."""
    return found.typical < HOPELESS and _of_one_object(found) > max(promise, enough(found.problem))


def _of_one_object(found: Candidate) -> float:
    """Nats that the reflectance of one object alone promises."""
    return found.once(OBJECT, lambda found: unlike.promise(found.problem, found.result))
