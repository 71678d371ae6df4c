"""What is told and wrong, asked before causes are: lamps, transfer, references, one object, a lamp's place."""

from __future__ import annotations

import functools
from dataclasses import replace

from lib.analysis.answer import disagreements
from lib.analysis.answer.answers import Answer, answered, audit_of, looked
from lib.analysis.causes import (
    gammas,
    lamp_lobe,
    one_object,
    response,
    search,
    told_lamps,
    told_reference,
    told_transfer,
)
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.colour_mixing import ColourMixing
from lib.analysis.causes.explained import Explained
from lib.analysis.causes.lamp_lobe import LampLobe
from lib.analysis.causes.questions import Question

FACES_AWAY_FROM = 0.005  # Display, median of the tiles. Lamps that face away were .0145 off and more.
# question: what `why` names it
NAMED = {told_lamps.NAME: ("lamp_power", "lamp_colour", "lamp_flipped"), one_object.NAME: ("group_wrong",)}


def at_once(task, first, scope, may_move, edges) -> Answer | None:
    """The answer in which something told is wrong, None where that is none of these.

    first : Candidate under the given facts, or the problem where nothing can be learnt from one
    """
    if not isinstance(first, Candidate):
        return None
    answer = _at_once(task, first, scope, may_move, edges)
    for name, causes in NAMED.items():
        if name in first.asked:
            is_named = answer is not None and any(w.cause in causes for w in answer.why)
            decision = "named" if is_named else "not named"
            task.asked.append(Question.of(name, first, first.asked[name], None, decision, enough(first.problem)))
    return answer


def _at_once(task, first, scope, may_move, edges) -> Answer | None:
    """Where told lamps or a told transfer function that are wrong, one object's material or a lamp's place explain more
    than anything else might, no cause is looked for. A thing that the model has not takes light, too, and is asked for
    before a lamp is moved."""
    rough = Explained(first.problem, first.result, "", given=first, scope=scope)
    given = functools.cache(lambda: rough.without_causes(**task.options))
    seen = functools.cache(lambda: answered(given(), *looked(task, given())))
    if why := told_transfer.of_a_picture(first, task.transfer):
        return answered(given(), why=why)
    hopeless = first.typical >= gammas.HOPELESS_FROM
    if hopeless and (why := _flipped(task, rough)):
        return named(task, given(), why)
    promised = search.promises(first, scope)
    most = max(promised.values())
    may_face_away = not hopeless and first.typical >= FACES_AWAY_FROM and promised.get(told_lamps.NAME) == most
    if may_face_away and (why := _flipped(task, rough)):
        return named(task, given(), why)
    if why := _references_told_wrong(task, first, scope, most):
        return named(task, given(), why)
    if most < enough(first.problem) or promised[one_object.NAME] == most:
        return None
    may_have_lobe = lambda: seen().audit.stands_out(given(), seen().judged)
    if (why := _transfer_told_wrong(task, first, scope, promised, given)) and not may_have_lobe():
        return answered(given(), why=why)
    if _one_object_promises(task, first, rough, most) and (why := disagreements.another_material(task, seen())):
        return replace(seen(), why=why)
    if may_move and _lamp_in_doubt(task, rough, most):
        if why := disagreements.something_missing(task, seen(), edges, disagreements.things_in_doubt(task, seen())):
            return replace(seen(), why=why)
        if refined := by_light(task, rough, above=most):
            return answered(given(), refined=refined, why=refined.why)
    why = _lamps_told_wrong(task, first, scope, promised, given)
    return named(task, given(), why) if why and not may_have_lobe() else None


def _one_object_promises(task, first, rough, most) -> bool:
    """One object's own reflectance brings more than any cause, or might: few of its pixels, or none, are trusted."""
    from lib.analysis.answer import strangers

    if one_object.promise(first.problem, first.result, slightly=True) > most:
        return True
    return strangers.unlike_in_audit(rough, audit_of(task, rough)) is not None


def _transfer_told_wrong(task, first, scope, promised, given) -> list:
    """[Why] of a transfer function that is told, where another leaves nothing to explain."""
    other = told_transfer.other_transfer(first, promised, scope.response)
    why = other and told_transfer.transfer_told(first.problem, task.transfer, other[1])
    return why if why and _suffices_alone(task, given(), _alone(task, other[0])) else []


def _references_told_wrong(task, first, scope, most) -> list:
    """[Why] of reflectances that are told, where others bring more than any cause promises and leave nothing else."""
    told = told_reference.references_told(first.problem)
    if not told or most < enough(first.problem):
        return []
    free = told_reference.with_references_freed(first)
    if scope.response and first.kind == "gamma":
        free = max(free, response.under_srgb(free), key=lambda c: c.evidence.nats)
    gain, numbers = free.evidence.nats - first.evidence.nats, len(told) * first.result.state.rho.shape[1]
    if gain < max(most, enough(first.problem, numbers)):
        return []
    other = _alone(task, free)
    return told_reference.references_of(first.problem, other.result, gain) if other.result.fits else []


def _lamps_told_wrong(task, first, scope, promised, given) -> list:
    """[Why] of lamps that are told, where others leave nothing to explain."""
    free = None if task.lobes else told_lamps.lamps_alone(first, promised, scope.response)
    if free is None:
        return []
    other = _alone(task, free)
    why = told_lamps.lamps_of(first.problem, other.result, free.evidence.nats - first.evidence.nats)
    if (
        any(w.cause == "lamp_colour" for w in why)
        and promised.get(ColourMixing.name, 0) > disagreements.MIXES_FROM * promised[told_lamps.NAME]
    ):
        return []  # the camera may mix colours: told lamps are not wrong for that
    return why if why and _suffices_alone(task, given(), other) else []


def _alone(task, candidate) -> Explained:
    """The fit that a rough one leads to."""
    return Explained(candidate.problem, candidate.result, "", given=candidate).without_causes(**task.options)


def _suffices_alone(task, given, other) -> bool:
    """What differs from the given facts leaves nothing to explain."""
    return other.result.fits and disagreements.energy(task, given).is_explained_by(disagreements.energy(task, other))


def named(task, explained, why) -> Answer:
    """With what is wrong with the lamps, and things that are missing besides."""
    return answered(
        explained, why=disagreements.joined(why, disagreements.missing(task, explained, audit_of(task, explained)))
    )


def _flipped(task, explained) -> list:
    from lib.analysis.answer import refine

    return refine.flipped(task.view(), task.factors, task.found, explained)


def told_wrong(task, explained) -> list:
    """[Why] of lamps that scene.yaml or the model has wrong, where that is all that is wrong."""
    if explained.result.fits:
        return []
    if task.lobes:
        lobes = LampLobe(task.view, *task.lambertian, tuple(task.lobes))
        why, settled = lamp_lobe.told_wrong(explained.given, lobes, task.lobes)
        if settled:
            return why
    why, settled = told_lamps.lamps_told(explained.problem, explained.result)
    return why if settled else []


def _lamp_in_doubt(task, explained, above) -> bool:
    from lib.analysis.answer import refine

    return refine.lamp_in_doubt(task.view(), task.factors, task.found, explained, task.place_sigma_m, above)


def by_light(task, explained, above=0.0, beside_mirrors=False):
    """The model with the lamp where its light has it, or None. above, beside_mirrors : of refine.by_light"""
    from lib.analysis.answer import refine

    audit = functools.partial(audit_of, task)
    refined = refine.by_light(
        task.view(), task.factors, task.found, explained, audit, task.place_sigma_m, above, beside_mirrors
    )
    return refined if refined is not None and refined.keeps_parts else None
