"""From one photograph's facts and light to its materials: causes of the whole picture, then geometry, then the ladder.

    answer = solve(task, report)

What explains least comes first, and what is not needed is not computed. Where the model should have been another
the answer says so (`refined`), and is good for nothing else: all is to be made again from it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lib.analysis.answer import blackness
from lib.analysis.answer.answers import Answer, answered, audit_of, looked, things_of
from lib.analysis.answer.own_materials import materials
from lib.analysis.answer.task import Task
from lib.analysis.causes import agreement, explain, glow, lamp_lobe, matrix, responses, unlike
from lib.analysis.causes.agreement import in_doubt
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.explain import Leave
from lib.analysis.causes.explained import Explained
from lib.analysis.causes.lamp_lobe import LampLobes
from lib.analysis.fit.problem import Problem
from lib.analysis.materials.climbing import SPECULAR
from lib.core.report import Note, Report

# of what free lamps promise: cameras that mix colours promised .5 to 2.7, lamps of another colour .01 to .32
MIXES = 0.4
# times the error that another transfer function leaves beside lobes: so much it must change. A false one changed 1.2;
# where it leaves no error, anything it changes is more
DISTINCT = 2.0
FACES_AWAY = 0.005  # display, median of tiles: lamps that face away were .0145 off and more
NOTHING = 0.0015  # display, that a group is off by where no thing stands before it: the least would leave .002
THROWN = 0.3  # of what a group was off by, that mirrors' light leaves where that is all that looked like a thing


def solve(task: Task, report: Report) -> Answer:
    """report : gets the trace, and what the ladder did"""
    once = lambda task: _solved(task, report)
    dark = blackness.groups(task)
    answer = blackness.solved(task, dark, once) if dark else once(task)
    answer.why = agreement.of_the_file(answer.why, task.view().photograph) if task.can_look else answer.why
    if answer.ladder:
        report["ladder"] = answer.ladder
    return answer


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
        answer = answered(explain.as_given(task.problem, gamma=task.gamma, **options))
        if in_doubt(answer.result):
            return replace(answer, why=edges.why)
    leave, first = _leave(task), _begun(task, edges, trace)
    if task.around is not None and isinstance(first, Candidate) and glow.may_come_in(*task.lambertian, first):
        task = task.around()
        unsure = functools.cache(functools.partial(glow.unsure, task.view(), task.factors, task.found))
        leave, first = _leave(task), glow.in_the_dark(first, task.problem, unsure)
    may_move = may_refine and "lamp_place" in task.allowed and not edges.why
    if task.can_look and (answer := _at_once(task, first, leave, may_move, edges)):
        return answer
    explained = explain.without_lobes(first, leave, **options)
    if not task.can_look:
        answer = answered(explained.kept(**options))
        answer.why = _why(task, answer, edges)
        return answer
    if wrong := _told_wrong(task, explained):
        return _named(task, explained.kept(**options), wrong)
    seen = answered(explained, *looked(task, explained))
    things = _things_in_doubt(task, seen)
    if why := _something_missing(task, seen, edges, things) or _another_material(task, seen):
        return replace(seen, why=why)
    lamps = _lamps(task, explained, things, leave, may_move, options)
    if lamps.lobed is None:
        return _moved(explained, lamps.elsewhere)
    return _materials(task, seen, lamps, edges, leave, report, options)


@dataclass(frozen=True)
class _Lamps:
    """What the lamps may be beside what they are told to be."""

    elsewhere: object  # Refinement, the model with a lamp where its light has it; or None
    beside: object  # the same, where mirrors may throw what tells of it
    lobed: Explained | None  # with lobes, if any explain more; None where a lamp elsewhere does


def _lamps(task, explained, things, leave, may_move, options) -> _Lamps:
    # no lamp throws light with an outline
    may_throw = leave.lobes is not None and leave.lobes.asked
    is_patch = not may_throw and any(thing.is_sharp and thing.on_plain for thing in things)
    may_move = may_move and not is_patch and bool(explained.taken or in_doubt(explained.result))
    elsewhere = _by_light(task, explained) if may_move else None
    if elsewhere is not None:
        uneven = explain.lobes_may_explain(explained, leave, elsewhere.nats)
        return _Lamps(elsewhere, None, explain.with_lobes(explained, leave, **options) if uneven else None)
    # where the lamps stand right, lines are no shadows' either
    is_patch |= not may_throw and any(thing.outlined and thing.on_plain for thing in things)
    beside = _by_light(task, explained, beside_mirrors=True) if may_move else None
    no_lobe = is_patch or beside is not None and not explain.lobes_may_explain(explained, leave, beside.nats)
    return _Lamps(None, beside, explained if no_lobe else explain.with_lobes(explained, leave, **options))


def _materials(task, seen: Answer, lamps: _Lamps, edges, leave, report, options) -> Answer:
    """The ladder under what explains the picture as a whole, or lamps in its place where they explain more."""
    explained, lobed = seen.explained.kept(**options), lamps.lobed
    plain, in_lobes = task, task.in_lobes(lobed.lobes)
    outdone = lamps.elsewhere is not None and not leave.lobes.asked and lamps.elsewhere.nats > lobed.best.evidence.nats
    if lobed.lobes and not outdone and (leave.lobes.asked or _suffices(task, explained, in_lobes, lobed)):
        task, explained = in_lobes, lobed
    is_seen = explained is seen.explained
    audit, judged = (seen.audit, seen.judged) if is_seen else looked(task, explained)
    ladder = _summary(task, explained.problem, judged)
    if lamps.elsewhere is not None and task is plain:
        return _moved(explained, lamps.elsewhere, ladder)
    beside = lamps.beside
    wrong, answer = explain.lamps_told_wrong(explained, leave, **options), None
    if _outdoes(beside, explained, wrong):
        wrong = []
    if not wrong or audit.flagged(explained.problem, judged) or audit.stands_out(explained, judged):
        answer = materials(task, explained, audit, judged, report, leave)
    if wrong and not (answer and _mirrors_suffice(answer)):  # what mirrors throw may look like other lamps
        answer = answered(explained, audit, judged, ladder=ladder)
        answer.why = agreement.joined(wrong, _missing(task, explained, audit))
        return answer
    ladder |= answer.ladder
    may_stand_elsewhere = beside is not None and not (lobed.lobes and beside.nats <= lobed.best.evidence.nats)
    if may_stand_elsewhere and not agreement.fits(answer.result):
        return _moved(explained, beside, ladder)
    if lobed.lobes and task is plain and not agreement.fits(answer.result):
        task, answer = in_lobes, _nearest(lobed, answer, *looked(in_lobes, lobed))
    answer.ladder = ladder
    answer.warnings += [
        Note(f"lamp {lamp!r}: no lobe fits the photograph better than an even lamp")
        for lamp in sorted(task.lobes_unknown - answer.explained.lobes.keys())
    ]
    answer.explained = replace(answer.explained, rivals=_rivals(answer))
    answer.why = _why(task, answer, edges)
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
    agreement.doubt_told(answer.problem, answer.result, task.transfer)
    agreement.doubt_references(answer.problem, answer.result)
    if not answer.climb:
        agreement.doubt_srgb(answer.explained.given, answer.explained.best, answer.result)


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


def _leave(task) -> Leave:
    return Leave.of(task.camera, task.found, task.transfer, task.causes, task.lamp_lobes)


def _begun(task, edges, trace) -> Candidate | Problem:
    """The rough fit under the given facts."""
    problem = task.problem if edges is None else replace(task.problem, unsure=_unsure(task, edges))
    return explain.started(problem, _leave(task), task.gamma, trace)


def _mirrors_suffice(answer) -> bool:
    """Mirrors and lobes have climbed, and leave nothing to explain that other lamps might."""
    climbed = answer.climb is not None and _all_mirrors(answer.climb)
    return climbed and agreement.fits(answer.result) and not agreement.lamps(answer.problem, answer.result)


def _all_mirrors(climb) -> bool:
    """Mirrors and lobes climbed, no textures: what is not in the model looks like one, and mirrors show it."""
    return bool(climb.on(*SPECULAR)) and not climb.on("textured")


def _suffices(task, explained, in_lobes, lobed) -> bool:
    """Lobes of lamps leave nothing to explain: what mirrors and lobes of surfaces throw may look like them."""
    if not agreement.fits(lobed.result):
        return False
    return _energy(task, explained).is_explained_by(_energy(in_lobes, lobed))


def _energy(task, explained):
    return audit_of(task, explained).energy(explained.problem, explained.result)


def _at_once(task, first, leave, may_move, edges) -> Answer | None:
    """Where told lamps or a told transfer function that are wrong, one object's material or a lamp's place explain more
    than anything else might, no cause is looked for. A thing that the model has not takes light, too, and is asked for
    before a lamp is moved."""
    if not isinstance(first, Candidate):
        return None
    rough = Explained(first.problem, first.result, "", given=first)
    given = functools.cache(lambda: rough.without_causes(**task.options))
    seen = functools.cache(lambda: answered(given(), *looked(task, given())))
    hopeless = first.typical >= explain.HOPELESS
    if hopeless and (why := _flipped(task, rough)):
        return _named(task, given(), why)
    promised = explain.promises(first, leave)
    most = max(promised.values())
    may_face_away = not hopeless and first.typical >= FACES_AWAY and promised.get(explain.LAMPS) == most
    if may_face_away and (why := _flipped(task, rough)):
        return _named(task, given(), why)
    if why := _references_told_wrong(task, first, leave, most):
        return _named(task, given(), why)
    if most < enough(first.problem) or promised[explain.OBJECT] == most:
        return None
    may_have_lobe = lambda: seen().audit.stands_out(given(), seen().judged)
    if (why := _transfer_told_wrong(task, first, leave, promised, given)) and not may_have_lobe():
        return answered(given(), why=why)
    if _one_object_promises(task, first, rough, most) and (why := _another_material(task, seen())):
        return replace(seen(), why=why)
    if may_move and _lamp_in_doubt(task, rough, most):
        if why := _something_missing(task, seen(), edges, _things_in_doubt(task, seen())):
            return replace(seen(), why=why)
        if refined := _by_light(task, rough, above=most):
            return answered(given(), refined=refined, why=refined.why)
    why = _lamps_told_wrong(task, first, leave, promised, given)
    return _named(task, given(), why) if why and not may_have_lobe() else None


def _one_object_promises(task, first, rough, most) -> bool:
    """One object's own reflectance brings more than any cause, or might: few of its pixels, or none, are trusted."""
    from lib.analysis.answer import strangers

    if unlike.promise(first.problem, first.result, slightly=True) > most:
        return True
    return strangers.unlike_in_audit(rough, audit_of(task, rough)) is not None


def _transfer_told_wrong(task, first, leave, promised, given) -> list:
    """[Why] of a transfer function that is told, where another leaves nothing to explain."""
    other = explain.other_transfer(first, promised, leave)
    why = other and agreement.transfer_told(first.problem, task.transfer, other[1])
    return why if why and _suffices_alone(task, given(), _alone(task, other[0])) else []


def _references_told_wrong(task, first, leave, most) -> list:
    """[Why] of reflectances that are told, where others bring more than any cause promises and leave nothing else."""
    told = agreement.references_told(first.problem)
    if not told or most < enough(first.problem):
        return []
    free = agreement.with_references_freed(first)
    if leave.response and first.kind == "gamma":
        free = max(free, responses.under_srgb(free), key=lambda c: c.evidence.nats)
    gain, numbers = free.evidence.nats - first.evidence.nats, len(told) * first.result.state.rho.shape[1]
    if gain < max(most, enough(first.problem, numbers)):
        return []
    other = _alone(task, free)
    return agreement.references_of(first.problem, other.result, gain) if agreement.fits(other.result) else []


def _lamps_told_wrong(task, first, leave, promised, given) -> list:
    """[Why] of lamps that are told, where others leave nothing to explain."""
    free = None if task.lobes else explain.lamps_alone(first, promised, leave)
    if free is None:
        return []
    other = _alone(task, free)
    why = agreement.lamps_of(first.problem, other.result, free.evidence.nats - first.evidence.nats)
    if any(w.cause == "lamp_colour" for w in why) and promised.get(matrix.NAME, 0) > MIXES * promised[explain.LAMPS]:
        return []  # the camera may mix colours: told lamps are not wrong for that
    return why if why and _suffices_alone(task, given(), other) else []


def _alone(task, candidate) -> Explained:
    """The fit that a rough one leads to."""
    return Explained(candidate.problem, candidate.result, "", given=candidate).without_causes(**task.options)


def _suffices_alone(task, given, other) -> bool:
    """What differs from the given facts leaves nothing to explain."""
    return agreement.fits(other.result) and _energy(task, given).is_explained_by(_energy(task, other))


def _named(task, explained, why) -> Answer:
    """With what is wrong with the lamps, and things that are missing besides."""
    return answered(explained, why=agreement.joined(why, _missing(task, explained, audit_of(task, explained))))


def _flipped(task, explained) -> list:
    from lib.analysis.answer import refine

    return refine.flipped(task.view(), task.factors, task.found, explained)


def _told_wrong(task, explained) -> list:
    """[Why] of lamps that scene.yaml or the model has wrong, where that is all that is wrong."""
    if agreement.fits(explained.result):
        return []
    if task.lobes:
        lobes = LampLobes(task.view, *task.lambertian, tuple(task.lobes))
        why, settled = lamp_lobe.told_wrong(explained.given, lobes, task.lobes)
        if settled:
            return why
    why, settled = agreement.lamps_told(explained.problem, explained.result)
    return why if settled else []


def _things_in_doubt(task, answer) -> list:
    """What stands before surfaces that the model has not, the largest first, where that is most of what is off."""
    found = answer.explained
    flagged = answer.audit.flagged(found.problem, answer.judged)
    if not flagged and not in_doubt(found.result):
        return []
    things = things_of(task, found, answer.audit)
    behind = {g for thing in things for g in thing.behind}
    energy = lambda groups: sum(answer.judged[g].energy for g in groups if g in answer.judged)
    return things if energy(behind) >= energy(set(flagged) - behind) else []


def _something_missing(task, answer, edges, things) -> list:
    """[Why], where something stands before several groups that the model has not: no more is looked for then, since all
    that could be learnt would bend to it."""
    if all(thing.alone for thing in things):
        return []  # a mirror may throw such light
    why = _why(task, answer, edges, things)
    return why if any(w.cause == "object_missing" for w in why) else []


def _another_material(task, answer) -> list:
    """[Why] of one object whose own reflectance leaves nothing to explain.

    Before lobes, places and the ladder are tried, which would only bend to it.
    """
    found = answer.explained
    if answer.audit.given or not in_doubt(found.result):
        return []
    from lib.analysis.answer import strangers

    model = task.view().model
    owner = lambda: np.asarray(model.facet_object)[task.factors.mesh.side // 2]
    return strangers.alone_unlike(found, answer.audit, owner, lambda: model.objects, **task.options)


def _missing(task, explained, audit) -> list:
    """[Why] of things that the model has not: light that they take may pass for a lamp's."""
    from lib.analysis.answer import strangers

    return strangers.said(things_of(task, explained, audit), explained.problem.groups)


def _summary(task, problem, judged):
    excess = {problem.groups[g]: m.excess for g, m in judged.items() if m.judged}
    return {"threshold": task.threshold, "diffuse": excess, "rays": {}, "rounds": 0}


def _unsure(task, edges) -> tuple:
    """By what the lamps' light is unsure, since things stand no more surely than the edges tell."""
    from lib.analysis.answer import refine

    return tuple(refine.unsure(task.view(), task.factors, task.found, task.refined, edges.covariances))


def _lamp_in_doubt(task, explained, above) -> bool:
    from lib.analysis.answer import refine

    return refine.lamp_in_doubt(task.view(), task.factors, task.found, explained, task.place_sigma_m, above)


def _by_light(task, explained, above=0.0, beside_mirrors=False):
    """The model with the lamp where its light has it, or None. above, beside_mirrors : of refine.by_light"""
    from lib.analysis.answer import refine

    audit = functools.partial(audit_of, task)
    refined = refine.by_light(
        task.view(), task.factors, task.found, explained, audit, task.place_sigma_m, above, beside_mirrors
    )
    return refined if refined is not None and refined.keeps_parts else None


def _why(task, answer: Answer, edges, things=None):
    """[Why] photograph and facts do not agree, the likeliest first. things : of strangers.things, where known"""
    result = answer.result
    why = agreement.disagreements(answer.problem, result, task.found, task.transfer, answer.explained.rivals)
    if answer.climb and task.transfer in (None, "auto") and agreement.fits(result):
        why = [w for w in why if w.cause != "lamp_colour" or not _mixes_colours(answer, w.evidence_nats)]
    if edges is not None and in_doubt(result):
        why = agreement.joined(why, edges.why)
    if not why and answer.climb and task.transfer in (None, "auto"):
        why = agreement.lamps_behind_curve(answer.problem, result, answer.explained.given)
    if answer.audit is None or any(w.cause == "transfer" for w in why):
        return why  # under another function than the camera's, shadows look like things
    return agreement.joined(why, _strange(task, answer, bool(why), things))


def _mixes_colours(answer, nats) -> bool:
    """In the light of what has climbed the camera explains much of what lamps of another colour do: sigma has both."""
    return matrix.may(answer.candidate) and matrix.promise(answer.candidate) > MIXES * nats


def _rivals(answer) -> dict:
    """{kind: nats} of other transfer functions, asked again in the light of what has climbed.

    It may leave a curve as much to bring as it must: the diffuse fit was right. Else they are fitted anew, and those
    count that change more than that light is off. None where a curve promises nothing any more.
    """
    rivals = answer.explained.rivals
    if not rivals or answer.climb is None:
        return rivals
    found = answer.candidate
    promised = responses.promise(found)
    if promised >= enough(found.problem):
        return rivals
    others = responses.fitted(found) if promised > 0 else []
    tells = [c for c in others if c.off(found) > DISTINCT * c.evidence.discrepancy]
    return {c.kind: c.evidence.nats - found.evidence.nats for c in tells}


def _strange(task, answer, is_wrong, things):
    """What the photograph shows and the model has not, in words. is_wrong : photograph and facts disagree anyway"""
    from lib.analysis.answer import strangers

    explained, climb = answer.explained, answer.climb
    climbed = {} if climb is None else {g: place.rung for g, place in climb.places.items() if place.rung != "diffuse"}
    # where the picture disagrees all the same, a texture is no explanation
    doubtful = is_wrong or climb and in_doubt(climb.result)
    objects = lambda: task.view().model.objects
    sure = {g: rung for g, rung in climbed.items() if not doubtful or rung != "textured"}
    if things is None and sure:
        things = strangers.things(task.view(), task.factors, explained, answer.audit, sure)
    elif things is None:
        things = things_of(task, explained, answer.audit)
    if not is_wrong:
        things = [t for t in things if not (t.is_of_print and climbed.get(t.behind[0]) == "textured")]
    if climb is not None and agreement.fits(climb.result):
        things = [t for t in things if not _is_thrown(t, answer)]
    return [
        *strangers.said(things, explained.problem.groups),
        *(
            strangers.groups_wrong(explained.problem, explained.result, objects, climbed)
            or strangers.things_unlike(explained, answer.audit, answer.judged, objects, climbed)
        ),
    ]


def _is_thrown(thing, answer) -> bool:
    """It is light that mirrors or lobes throw: under it nothing is left of what the groups behind were off by."""
    before, now = answer.judged, answer.climb.misfits
    left = lambda g: now[g].excess if g in now else np.inf
    return all(g in before and left(g) < max(THROWN * before[g].excess, NOTHING) for g in thing.behind[:2])


def write_ladder(answer: Answer, folder, specular=None, mirror=None) -> dict:
    """Files that only some scenes have, see ascent.write_files; {group: Textured}."""
    if answer.ascent is None:
        return {}
    from lib.analysis.materials import ascent

    return ascent.write_files(answer.ascent, Path(folder), specular, mirror)
