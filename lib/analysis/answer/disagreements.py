"""Whether photograph and given facts agree, and what is likeliest wrong where they do not.

A fit of some hundred numbers converges on anything. What it finds means something only if the light it rests on
explains the photograph to its noise, and if no fact that scene.yaml tells would better be another.
"""

from __future__ import annotations

import numpy as np

from lib.analysis.answer.answers import Answer, audit_of, things_of
from lib.analysis.causes import colour_mixing, glow, response, told_lamps, told_reference, told_transfer
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.colour_mixing import ColourMixing
from lib.analysis.fit.evidence import evidence
from lib.analysis.fit.problem import Problem, Result
from lib.analysis.seen.gather import Gathered, out_of_range
from lib.given import jpeg
from lib.given.materials import Why

ON_BOUNDS = 1 / 3  # Nothing found is believed if so many of the groups' reflectances are 0 or 1.
# Lamps of another colour are not named if a camera that mixes colours promises so much of what free lamps do. Cameras
# that mix promised .5 to 2.7 of it, lamps of another colour .01 to .32.
MIXES_FROM = 0.4
# Beside lobes, another transfer function must change so many times the error that it leaves. A false one changed 1.2
# times; where it leaves no error, anything is more.
DISTINCT_FROM = 2.0
NOTHING_BELOW = 0.0015  # Display. No thing stands before a group that is off by less: the least would leave .002.
# What looked like a thing was mirrors' light if that leaves less than so much of what the group was off by.
THROWN_BELOW = 0.3


def disagreements(problem: Problem, result: Result, found: Gathered, asked, rivals) -> list[Why]:
    """What is likeliest wrong with the given facts, the likeliest first; [] where photograph and facts agree.

    asked : transfer, as in scene.yaml;  rivals : {kind: nats} of other transfer functions
    """
    if not len(problem.tile_group) or result.at is None:
        return []
    if why := _range(found):
        return why  # all else that might be wrong would only bend to it
    why = told_transfer.transfer_told(problem, asked, rivals) or told_transfer.another_gamma(problem, result, asked)
    why += told_lamps.lamps(problem, result)
    why += told_reference.references(problem, result)
    if problem.specular is None and not result.fits:
        why += _open_model(problem, result)
    why.sort(key=lambda w: -(w.evidence_nats or np.inf))
    if not why and not result.fits:
        text = (
            f"the re-rendering differs from the photograph by {result.correlated:.1f} times what noise explains, alike"
            " over whole surfaces: the pose, the place of a lamp or of an object, or a material is not as given, or the"
            " picture's contrast was changed from place to place (HDR, clarity)"
        )
        why = [Why("unknown", None, text, None)]
    return why or _on_bounds(problem, result)


def left_over(answer: Answer) -> list[Why]:
    """[Why] a group differs by more than any may keep, and nothing explains it: no answer that holds such a group is
    exact, and what is wrong there throws light on others."""
    judged = answer.climb.misfits if answer.climb else answer.judged
    if answer.refined is not None or judged is None:
        return []
    number = answer.problem.groups.index
    off = {name: judged[number(name)].excess for name in answer.unexplained if number(name) in judged}
    worst = max(off, key=off.get, default=None)
    if worst is None or off[worst] < answer.audit.threshold:
        return []
    text = (
        f"group {worst!r} differs by {off[worst]:.1%} of full scale from what the model has there, and no material"
        " explains it: an object is elsewhere, too many or missing, or has another shape"
    )
    return [Why("unknown", None, text, None)]


def accused_groups(task, why) -> set:
    """Names of the groups of which `why` names an object: which of their objects are as the rest is open."""
    named = {w.subject for w in why if w.cause == "group_wrong"}
    if not named:
        return set()
    model = task.view().model
    accused = np.isin(model.facet_object, [k for k, name in enumerate(model.objects) if name in named])
    return {model.groups[g] for g in np.unique(np.asarray(model.facet_group)[accused])}


def joined(why, displaced) -> list[Why]:
    """Both lists, the likeliest first; what is displaced tells what was unknown."""
    why = [w for w in why if w.cause != "unknown" or not displaced]
    return sorted([*why, *displaced], key=lambda w: -(w.evidence_nats or np.inf))


def of_the_file(why, photograph) -> list[Why]:
    """With what was done to the photograph, where its pixels tell.

    It stands behind what the light proves, and before what is only seen: blocks of a JPEG look like things.
    """
    if not why or not photograph.lost_tables:
        return why
    text = f"the photograph was a JPEG, and its blocks may be all that is wrong: {jpeg.NO_TABLES}"
    proved = [w for w in why if w.evidence_nats is not None]
    seen = [w for w in why if w.evidence_nats is None and w.cause != "unknown"]
    return [*proved, Why("noise", None, text, None), *seen]


def _range(found: Gathered):
    if not out_of_range(found):
        return []
    largest = found.pixels.max()
    text = (
        f"the photograph uses {largest:.1%} of its range at most: 12-bit data in a 16-bit file must be multiplied by 16"
    )
    return [Why("range", None, text, None)]


def _open_model(problem, result):
    """Light that comes back through the openings of the model, evenly."""
    if not glow.is_dark(problem):
        return []
    gain = glow.promise(Candidate(problem, result, evidence(problem, result.at)))
    if gain < enough(problem):
        return []
    opening = problem.D[:, ~problem.own_lamps].max()
    text = (
        f"the model is open ({opening:.0%} of the light of a patch leaves it), and light from outside would"
        f" explain the photograph better by {gain:.0f} nats: a wall or a window is missing"
    )
    return [Why("open_model", None, text, float(gain))]


def _on_bounds(problem, result):
    free = problem.seen_groups & np.isnan(problem.rho).any(axis=1)
    if problem.specular is not None:
        free[list(problem.specular.groups)] = False
    at = free & ((result.state.rho > 0.9995) | (result.state.rho < 1e-6)).any(axis=1)
    if at.sum() <= max(ON_BOUNDS * free.sum(), 1):
        return []
    text = (
        f"the reflectances of {at.sum()} of {free.sum()} groups lie on their bounds: the lamps or the scale are not so"
    )
    return [Why("unknown", None, text, None)]


def reasons(task, answer: Answer, edges, things=None):
    """[Why] photograph and facts do not agree, the likeliest first. things : of strangers.things, where known"""
    result = answer.result
    why = disagreements(answer.problem, result, task.found, task.transfer, answer.explained.rivals)
    if answer.climb and task.transfer in (None, "auto") and result.fits:
        why = [w for w in why if w.cause != "lamp_colour" or not _mixes_colours(answer, w.evidence_nats)]
    if edges is not None and result.in_doubt:
        why = joined(why, edges.why)
    if not why and answer.climb and task.transfer in (None, "auto"):
        why = told_lamps.lamps_behind_curve(answer.problem, result, answer.explained.given)
    if answer.audit is None or any(w.cause == "transfer" for w in why):
        return why  # under another function than the camera's, shadows look like things
    return joined(why, _strange(task, answer, bool(why), things))


def _mixes_colours(answer, nats) -> bool:
    """In the light of what has climbed the camera explains much of what lamps of another colour do: sigma has both."""
    return colour_mixing.may(answer.candidate) and ColourMixing().promise(answer.candidate) > MIXES_FROM * nats


def rivals(answer) -> dict:
    """{kind: nats} of other transfer functions, asked again in the light of what has climbed.

    It may leave a curve as much to bring as it must: the diffuse fit was right. Else they are fitted anew, and those
    count that change more than that light is off. None where a curve promises nothing any more.
    """
    rivals = answer.explained.rivals
    if not rivals or answer.climb is None:
        return rivals
    found = answer.candidate
    promised = response.promise(found)
    if promised >= enough(found.problem):
        return rivals
    others = response.fitted(found) if promised > 0 else []
    tells = [c for c in others if c.off(found) > DISTINCT_FROM * c.evidence.discrepancy]
    return {c.kind: c.evidence.nats - found.evidence.nats for c in tells}


def _strange(task, answer, is_wrong, things):
    """What the photograph shows and the model has not, in words. is_wrong : photograph and facts disagree anyway"""
    from lib.analysis.answer import strangers

    explained, climb = answer.explained, answer.climb
    climbed = {} if climb is None else {g: place.rung for g, place in climb.places.items() if place.rung != "diffuse"}
    # where the picture disagrees all the same, a texture is no explanation
    doubtful = is_wrong or climb and climb.result.in_doubt
    objects = lambda: task.view().model.objects
    sure = {g: rung for g, rung in climbed.items() if not doubtful or rung != "textured"}
    if things is None and sure:
        things = strangers.things(task.view(), task.factors, explained, answer.audit, sure)
    elif things is None:
        things = things_of(task, explained, answer.audit)
    if not is_wrong:
        things = [t for t in things if not (t.is_of_print and climbed.get(t.behind[0]) == "textured")]
    if climb is not None and climb.result.fits:
        things = [t for t in things if not is_thrown(t, answer)]
    return [
        *strangers.said(things, explained.problem.groups),
        *(
            strangers.groups_wrong(explained.problem, explained.result, objects, climbed)
            or strangers.things_unlike(explained, answer.audit, answer.judged, objects, climbed)
        ),
    ]


def is_thrown(thing, answer) -> bool:
    """It is light that mirrors or lobes throw: under it nothing is left of what the groups behind were off by."""
    before, now = answer.judged, answer.climb.misfits
    left = lambda g: now[g].excess if g in now else np.inf
    return all(g in before and left(g) < max(THROWN_BELOW * before[g].excess, NOTHING_BELOW) for g in thing.behind[:2])


def things_in_doubt(task, answer) -> list:
    """What stands before surfaces that the model has not, the largest first, where that is most of what is off."""
    found = answer.explained
    flagged = answer.audit.flagged(found.problem, answer.judged)
    if not flagged and not found.result.in_doubt:
        return []
    things = things_of(task, found, answer.audit)
    behind = {g for thing in things for g in thing.behind}
    energy = lambda groups: sum(answer.judged[g].energy for g in groups if g in answer.judged)
    return things if energy(behind) >= energy(set(flagged) - behind) else []


def something_missing(task, answer, edges, things) -> list:
    """[Why], where something stands before several groups that the model has not: no more is looked for then, since all
    that could be learnt would bend to it."""
    if all(thing.alone for thing in things):
        return []  # a mirror may throw such light
    why = reasons(task, answer, edges, things)
    return why if any(w.cause == "object_missing" for w in why) else []


def another_material(task, answer) -> list:
    """[Why] of one object whose own reflectance leaves nothing to explain.

    Before lobes, places and the ladder are tried, which would only bend to it.
    """
    found = answer.explained
    if answer.audit.given or not found.result.in_doubt:
        return []
    from lib.analysis.answer import strangers

    model = task.view().model
    owner = lambda: np.asarray(model.facet_object)[task.factors.mesh.side // 2]
    return strangers.alone_unlike(found, answer.audit, owner, lambda: model.objects, **task.options)


def missing(task, explained, audit) -> list:
    """[Why] of things that the model has not: light that they take may pass for a lamp's."""
    from lib.analysis.answer import strangers

    return strangers.said(things_of(task, explained, audit), explained.problem.groups)


def energy(task, explained):
    return audit_of(task, explained).energy(explained.problem, explained.result)
