"""From one photograph's facts and light to its materials: causes of the whole picture, then geometry, then the ladder.

    answer = solve(task, report)

What explains least comes first, and what is not needed is not computed. Where the model should have been another
the answer says so (`refined`), and is good for nothing else: all is to be made again from it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path

from lib.analysis.answer import blackness, contradictions, disagreements, set_aside, told_first
from lib.analysis.answer.answers import Answer, answered, looked
from lib.analysis.answer.own_materials import materials
from lib.analysis.answer.task import Task
from lib.analysis.causes import (
    explain,
    glow,
    search,
    told_lamps,
    told_reference,
    told_transfer,
)
from lib.analysis.causes.candidates import Candidate
from lib.analysis.causes.explained import Explained
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.problem import Problem
from lib.analysis.materials.climbing import SPECULAR
from lib.core.report import Note, Report


def solve(task: Task, report: Report) -> Answer:
    """report : gets the trace, and what the ladder did"""
    once = lambda task: _solved(task, report)
    dark = blackness.groups(task)
    answer = blackness.solved(task, dark, once) if dark else once(task)
    if task.can_look:
        answer.why = answer.why or disagreements.left_over(answer)
        answer.why = disagreements.of_the_file(answer.why, task.view().photograph)
    if answer.why:
        _doubt(task, answer)
        answer = _of_the_rest(task, answer)
    if answer.ladder:
        report["ladder"] = answer.ladder
    if task.asked:
        report["questions"] = [question.row() for question in task.asked]
    return answer


def _of_the_rest(task, answer: Answer) -> Answer:
    """The answer, or that without what is named, where it is better."""
    if not task.can_look:
        return answer
    accused = disagreements.accused_groups(task, answer.why)
    again = set_aside.of_the_rest(task, answer, _scope(task), **task.options)
    if again is not None:
        answer = again
        _doubt(task, answer)
    answer.accused = accused
    return answer


def _doubt(task, answer: Answer):
    """Every sigma holds what photograph and facts do not agree in."""
    if answer.audit is None and task.can_look:
        answer.audit, answer.judged = looked(task, answer.explained)
    if answer.climb is None and answer.audit is not None:
        answer.audit.doubt(answer.problem, answer.result, answer.judged)
    answer.result.warnings[:] = dict.fromkeys(answer.result.warnings)
    answer.sigma_scale = contradictions.doubt_told(answer, task.transfer)


def _solved(task: Task, report: Report) -> Answer:
    """Whether edges were found, causes of the whole picture, what is wrong with the facts; then lamps and materials."""
    trace = lambda iteration, image_rmse, state: report.trace(
        iteration=iteration, image_rmse=image_rmse, gamma=state.gamma
    )
    options = {"trace": trace, **task.options}
    edges = task.edges if task.can_look and task.causes != [] else None
    may_refine = task.may_refine and edges is not None
    if may_refine and edges.is_lost:
        # whatever else the photograph might tell would only bend to this
        answer = answered(search.as_given(task.problem, gamma=task.gamma, **options))
        if answer.result.in_doubt:
            return replace(answer, why=edges.why)
    scope, first = _scope(task), _begun(task, edges, trace)
    if task.around is not None and isinstance(first, Candidate) and glow.may_come_in(*task.lambertian, first):
        task = replace(task.around(), asked=task.asked)
        unsure = functools.cache(functools.partial(glow.unsure, task.view(), task.factors, task.found))
        scope, first = _scope(task), glow.in_the_dark(first, task.problem, unsure)
    may_move = may_refine and "lamp_place" in task.allowed and not edges.why
    if task.can_look and (answer := told_first.at_once(task, first, scope, may_move, edges)):
        return answer
    explained = search.with_causes(first, scope, **options)
    if not task.can_look:
        answer = answered(explained.kept(**options))
        answer.why = disagreements.reasons(task, answer, edges)
        return answer
    if wrong := told_first.told_wrong(task, explained):
        return told_first.named(task, explained.kept(**options), wrong)
    seen = answered(explained, *looked(task, explained))
    things = disagreements.things_in_doubt(task, seen)
    if why := disagreements.something_missing(task, seen, edges, things) or disagreements.another_material(task, seen):
        return replace(seen, why=why)
    lamps = _lamps(task, explained, things, scope, may_move, options)
    if lamps.lobed is None:
        return _moved(explained, lamps.elsewhere)
    return _materials(task, seen, lamps, edges, scope, report, options)


@dataclass(frozen=True)
class _Lamps:
    """What the lamps may be beside what they are told to be."""

    elsewhere: object  # Refinement, the model with a lamp where its light has it; or None
    beside: object  # the same, where mirrors may throw what tells of it
    lobed: Explained | None  # with lobes, if any explain more; None where a lamp elsewhere does


def _lamps(task, explained, things, scope, may_move, options) -> _Lamps:
    # no lamp throws light with an outline
    may_throw = scope.lobes is not None and scope.lobes.asked
    is_patch = not may_throw and any(thing.is_sharp and thing.on_plain for thing in things)
    may_move = may_move and not is_patch and bool(explained.taken or explained.result.in_doubt)
    elsewhere = told_first.by_light(task, explained) if may_move else None
    if elsewhere is not None:
        uneven = explain.lobes_may_explain(explained, scope, elsewhere.nats)
        return _Lamps(elsewhere, None, explain.with_lobes(explained, scope, **options) if uneven else None)
    # where the lamps stand right, lines are no shadows' either
    is_patch |= not may_throw and any(thing.outlined and thing.on_plain for thing in things)
    beside = told_first.by_light(task, explained, beside_mirrors=True) if may_move else None
    no_lobe = is_patch or beside is not None and not explain.lobes_may_explain(explained, scope, beside.nats)
    return _Lamps(None, beside, explained if no_lobe else explain.with_lobes(explained, scope, **options))


def _materials(task, seen: Answer, lamps: _Lamps, edges, scope, report, options) -> Answer:
    """The ladder under what explains the picture as a whole, or lamps in its place where they explain more."""
    explained, lobed = seen.explained.kept(**options), lamps.lobed
    plain, in_lobes = task, task.in_lobes(lobed.lobes)
    outdone = lamps.elsewhere is not None and not scope.lobes.asked and lamps.elsewhere.nats > lobed.best.evidence.nats
    if lobed.lobes and not outdone and (scope.lobes.asked or _suffices(task, explained, in_lobes, lobed)):
        task, explained = in_lobes, lobed
    is_seen = explained is seen.explained
    audit, judged = (seen.audit, seen.judged) if is_seen else looked(task, explained)
    ladder = _summary(task, explained.problem, judged)
    if lamps.elsewhere is not None and task is plain:
        return _moved(explained, lamps.elsewhere, ladder)
    beside = lamps.beside
    wrong, answer = explain.lamps_told_wrong(explained, scope, **options), None
    if _outdoes(beside, explained, wrong):
        wrong = []
    if not wrong or audit.flagged(explained.problem, judged) or audit.stands_out(explained, judged):
        answer = materials(task, explained, audit, judged, report, scope)
    if wrong and not (answer and _mirrors_suffice(answer)):  # what mirrors throw may look like other lamps
        answer = answered(explained, audit, judged, ladder=ladder)
        answer.why = disagreements.joined(wrong, disagreements.missing(task, explained, audit))
        return answer
    ladder |= answer.ladder
    may_stand_elsewhere = beside is not None and not (lobed.lobes and beside.nats <= lobed.best.evidence.nats)
    if may_stand_elsewhere and not answer.result.fits:
        return _moved(explained, beside, ladder)
    if lobed.lobes and task is plain and not answer.result.fits:
        task, answer = in_lobes, _nearest(lobed, answer, *looked(in_lobes, lobed))
    answer.ladder = ladder
    answer.warnings += [
        Note(f"lamp {lamp!r}: no lobe fits the photograph better than an even lamp")
        for lamp in sorted(task.lobes_unknown - answer.explained.lobes.keys())
    ]
    answer.explained = replace(answer.explained, rivals=disagreements.rivals(answer))
    answer.why = disagreements.reasons(task, answer, edges)
    if may_stand_elsewhere and _outdoes(beside, explained, answer.why):
        return _moved(explained, beside, ladder)
    if answer.why and answer.climb and not audit.given and not _all_mirrors(answer.climb):
        answer.ascent, found = None, answer.explained
        answer.problem, answer.result, answer.scale = found.problem, found.result, found.scale
    if not answer.why:
        _doubt_facts(task, answer)
    return answer


def _moved(explained, refined, ladder=()) -> Answer:
    """All is to be made again with a lamp where its light has it."""
    return answered(explained, refined=refined, why=refined.why, ladder=dict(ladder))


def _doubt_facts(task, answer: Answer):
    """Widen every sigma by what else may be as well of what is told."""
    told_transfer.doubt_told(answer.problem, answer.result, task.transfer)
    told_reference.doubt_references(answer.problem, answer.result)
    if not answer.climb:
        told_lamps.doubt_srgb(answer.explained.given, answer.explained.best, answer.result)


def _outdoes(beside, explained, why) -> bool:
    """A lamp elsewhere explains more than others that lamps might be, which is all that is said. beside : Refinement"""
    of_lamps = bool(why) and all(w.cause.startswith("lamp_") for w in why)
    gain = lambda: beside.nats - explained.best.evidence.nats
    return of_lamps and beside is not None and gain() > sum(w.evidence_nats or 0 for w in why)


def _nearest(lobed, plain: Answer, audit, judged) -> Answer:
    """Nothing suffices, and lobes of lamps come nearest. They fit no better than what they do not explain, either."""
    audit.doubt(lobed.problem, lobed.result, judged)
    lobed.result.correlated = max(lobed.result.correlated, plain.result.correlated)
    return answered(lobed, audit, judged)


def _scope(task) -> Scope:
    return Scope.of(task.camera, task.found, task.transfer, task.causes, task.lamp_lobes, task.asked)


def _begun(task, edges, trace) -> Candidate | Problem:
    """The rough fit under the given facts."""
    problem = task.problem if edges is None else replace(task.problem, unsure=_unsure(task, edges))
    return search.started(problem, _scope(task), task.gamma, trace)


def _mirrors_suffice(answer) -> bool:
    """Mirrors and lobes have climbed, and leave nothing to explain that other lamps might."""
    climbed = answer.climb is not None and _all_mirrors(answer.climb)
    return climbed and answer.result.fits and not told_lamps.lamps(answer.problem, answer.result)


def _all_mirrors(climb) -> bool:
    """Mirrors and lobes climbed, no textures: what is not in the model looks like one, and mirrors show it."""
    return bool(climb.on(*SPECULAR)) and not climb.on("textured")


def _suffices(task, explained, in_lobes, lobed) -> bool:
    """Lobes of lamps leave nothing to explain: what mirrors and lobes of surfaces throw may look like them."""
    if not lobed.result.fits:
        return False
    return disagreements.energy(task, explained).is_explained_by(disagreements.energy(in_lobes, lobed))


def _summary(task, problem, judged):
    excess = {problem.groups[g]: m.excess for g, m in judged.items() if m.judged}
    return {"threshold": task.threshold, "diffuse": excess, "rays": {}, "rounds": 0}


def _unsure(task, edges) -> tuple:
    """By what the lamps' light is unsure, since things stand no more surely than the edges tell."""
    from lib.analysis.answer import refine

    return tuple(refine.unsure(task.view(), task.factors, task.found, task.refined, edges.covariances))


def write_ladder(answer: Answer, folder, specular=None, mirror=None) -> dict:
    """Files that only some scenes have, see ascent.write_files; {group: Textured}."""
    if answer.ascent is None:
        return {}
    from lib.analysis.materials import ascent

    return ascent.write_files(answer.ascent, Path(folder), specular, mirror)
