"""The search for causes: what may be wrong with the picture as a whole, judged before any group climbs.

The fit under the given facts comes first. From there one step towards each cause tells what it would bring to held-out
tiles: next to nothing where the facts suffice, and then nothing more is computed. Causes that promise enough are
fitted, the best is taken if it keeps its promise, and the question is asked again. The search knows their interface
alone (lib/analysis/causes/cause.py), and which there are from the table.
"""

from __future__ import annotations

from dataclasses import replace

from lib.analysis.causes import colour_mixing, gammas, one_object, patterned, response, saturation, told_lamps
from lib.analysis.causes.candidates import USUAL_NUMBERS, Candidate, enough
from lib.analysis.causes.cause import settled
from lib.analysis.causes.explained import Explained, Taken
from lib.analysis.causes.questions import Question
from lib.analysis.causes.scope import Scope
from lib.analysis.causes.table import causes_of
from lib.analysis.fit.gauss_newton import fit
from lib.analysis.fit.problem import CauseTerms, Problem

# Of the most that a cause promises: another that promises as much is fitted beside it. In 16 rooms with one thing wrong
# the others promised .35 at most.
NEARLY = 0.5
TIE = 2.0  # standard errors over groups, by which one explanation must lead another, or it is said to be a tie


def as_given(problem: Problem, **options) -> Explained:
    """The fit under the given facts; neither causes nor rivals are looked for. options : of gauss_newton"""
    return Explained(problem, *fit(problem, **options))


def started(problem: Problem, scope: Scope, gamma=None, trace=None) -> Candidate | Problem:
    """The rough fit under the given facts; the problem itself where nothing can be learnt from one."""
    if scope.vain or not len(problem.tile_group):
        return problem
    first = Candidate.of(problem, trace=trace, gamma=gamma)
    first = gammas.from_others(first) if gammas.ran_away(first) else first
    return first if scope.lens is None else patterned.beside(first, scope.pixel, scope.lens.size[0])


def with_causes(first: Candidate | Problem, scope: Scope, **options) -> Explained:
    """The fit with the causes that are of the camera alone. first : of `started`"""
    if isinstance(first, Problem):
        return Explained(first, *fit(first, **options), scope=scope)
    first = _begun(first, scope)
    return finished(first, first, [], scope, options)


def finished(given: Candidate, begun: Candidate, taken, scope: Scope, options) -> Explained:
    """With the causes that the photograph supports beside those of `begun`, [Taken]."""
    best, more, functions = climbed(begun, scope)
    variance = patterned.still(best, scope.pixel, scope.lens)
    problem = replace(best.problem, doubted=doubted(best, scope), variance=variance)
    result, scale = fit(problem, start=best.start, **options)
    result.iterations += best.result.iterations
    return Explained(
        problem, result, scale, response.rivals_of(functions, best), [*taken, *more], best.taken, given, best, scope
    )


def doubted(best: Candidate, scope: Scope) -> CauseTerms | None:
    """What the camera may be as well."""
    terms = saturation.doubted(best) if scope.camera else None
    if scope.response:
        for more in (colour_mixing.doubted(best), response.doubted(best.problem, best.result.state)):
            terms = more.beside(terms) if more else terms
    return terms


def _begun(first: Candidate, scope: Scope) -> Candidate:
    """The rough fit under the given facts, from other gammas as well where it leaves something to explain.

    gamma and the reflectances share a valley: dark photographs have another minimum beyond gamma 4, and so have white
    rooms.
    """
    promise = response.promise(first)
    if not gammas.searched(first) or promise < enough(first.problem) or is_one_object(first, promise):
        return first
    if any(c.promise(first) > promise for c in causes_of(scope).values() if c.before_gammas and c.may(first)):
        return first
    return gammas.from_others(first)


def climbed(best: Candidate, scope: Scope):
    """The best candidate, [Taken] on the way to it, and the candidates with other transfer functions."""
    causes = causes_of(scope)
    taken, functions, errors = [], (), 0.0
    tried = {name for name, cause in causes.items() if cause.is_linearised and name in best.taken}
    while promised := _promising(best, scope, causes, tried):
        wanted = _to_be_fitted(best, causes, promised, tried)
        tried |= wanted
        found = {name: causes[name].tried(best, promised.get(name, 0.0)) for name in wanted}
        functions = next((t.rivals for t in found.values() if t.rivals), functions)
        errors = max((t.errors for t in found.values() if t.rivals), default=errors)
        candidates = {name: settled(t.candidate, best, causes.values()) for name, t in found.items()}
        physical = {name: c is best or causes[name].is_physical(c, best) for name, c in candidates.items()}
        better = {
            name: c
            for name, c in candidates.items()
            if c is not best and physical[name] and c.beats(best) and c.evidence.nats - best.evidence.nats > errors
        }
        simple = next((candidates[name] for name in found if found[name].is_simpler), None)
        if simple:  # it has no free number, so a cause must beat it by all of its own
            least = simple.evidence.nats + enough(best.problem, USUAL_NUMBERS + best.complexity)
            better = {name: c for name, c in better.items() if c is simple or c.evidence.nats >= least}
        chosen = max(better, key=lambda name: better[name].evidence.nats, default=None)
        for name, c in candidates.items():
            said = _decided(name, chosen, physical[name], {n: better[n] for n in better if n in (name, chosen)})
            least = enough(best.problem, causes[name].free)
            scope.note(Question.of(name, best, promised.get(name), c, said, least))
        if chosen is None:
            continue
        gain = promised | {name: c.over(best).nats for name, c in candidates.items() if physical[name]}
        taken.append(Taken(chosen, gain.pop(chosen), gain))
        best, tried = better[chosen], {t.cause for t in taken}
        functions = functions if found[chosen].rivals else ()
    return best, taken, functions


def _decided(name, chosen, is_physical, better) -> str:
    """In words. better : {name: Candidate} of this one and the chosen one, as far as they are better than before"""
    if name == chosen:
        return "taken"
    if name in better:
        tied = better[chosen].over(better[name]).z < TIE
        return f"a tie with {chosen}, which has more nats" if tied else f"less than {chosen}"
    return "no better" if is_physical else "bends to something else"


def _to_be_fitted(best: Candidate, causes, promised, tried) -> set:
    """Names of the causes that promise most, and of those that come along with any."""
    most = max(promised, key=promised.get)
    near = {name for name, nats in promised.items() if nats >= NEARLY * promised[most]}
    wanted = {most} if causes[most].stands_back else {name for name in near if not causes[name].stands_back}
    return wanted | {name for name, cause in causes.items() if name not in tried and cause.comes_along(best)}


def promises(first: Candidate, scope: Scope) -> dict:
    """{cause: nats} that one step brings: of the causes of the camera, of LAMPS that are told, of one OBJECT."""
    found = promises_of(first, causes_of(scope)) | {one_object.NAME: _of_one_object(first)}
    return found | ({told_lamps.NAME: told_lamps.promise_of_lamps(first)} if told_lamps.are_told(first.problem) else {})


def _promising(found: Candidate, scope: Scope, causes, tried) -> dict:
    """{cause: nats} of the causes that one step promises enough of."""
    promised = promises_of(found, causes, tried)
    least = {name: enough(found.problem, causes[name].free) for name in promised}
    held = {name: nats for name, nats in promised.items() if nats >= least[name]}
    is_object = bool(held) and is_one_object(found, max(held.values()))
    for name, nats in promised.items():
        if name not in held or is_object:
            said = "one object explains more" if name in held else "promises too little"
            scope.note(Question.of(name, found, nats, None, said, least[name]))
    return {} if is_object else held


def promises_of(found: Candidate, causes, tried=()) -> dict:
    """{cause: nats} that one step brings, of the causes that may be taken and were not tried."""
    ask = [cause for name, cause in causes.items() if name not in tried and cause.by_one_step]
    return {cause.name: cause.promise(found) for cause in ask if cause.may(found)}


def is_one_object(found: Candidate, promise) -> bool:
    """What is wrong is the reflectance of one object, rather than a cause with such a promise: most tiles are right."""
    return found.typical < gammas.HOPELESS_FROM and _of_one_object(found) > max(promise, enough(found.problem))


def _of_one_object(found: Candidate) -> float:
    """Nats that the reflectance of one object alone promises."""
    return found.once(one_object.NAME, lambda found: one_object.promise(found.problem, found.result))
