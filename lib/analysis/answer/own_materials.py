"""The groups' own materials, after the causes of the whole picture: the ladder, and what is asked again in its light.

Mirrors and lobes throw light that the diffuse fit does not know. What it took for the camera's doing under that light
is asked again once they have climbed.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lib.analysis.answer.answers import Answer, answered, looked, things_of
from lib.analysis.answer.audit import ALMOST_ALL
from lib.analysis.causes import response, search
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.colour_mixing import ColourMixing
from lib.analysis.causes.explained import Taken, surely
from lib.analysis.causes.table import causes_of
from lib.analysis.causes.vignetting import Vignetting
from lib.analysis.fit import misfits
from lib.analysis.fit.evidence import evidence, steady
from lib.analysis.fit.gauss_newton import fit
from lib.analysis.materials.climbing import SPECULAR

if TYPE_CHECKING:
    from lib.analysis.materials.ascent import Ascent

# Where the picture does not fit, a group stands out at so much of the usual bound: something is wrong there anyway.
KEENER_BY = 0.6
EVERYWHERE, SEVERAL = 0.75, 3  # No material is looked for if such a share and number of groups differ.
# Causes did not bend to a lobe if the median tile is off by so many times as much without them. One that bent left
# 1.8 times, right ones 13 to 16.
NO_LOBE_FROM = 3.0
RIGHT_ABOUT_MOST = 0.5  # A climb is right about most if it leaves at most so much of what groups were off by.
# One group that climbed may leave so much of what neighbouring tiles have in common. Right ones left .56, false ones
# .7.
LEFT_BY_ONE = 0.65
JUST_BELOW = 0.99  # The threshold at which one group alone climbs, in what it is off by.


def materials(task, explained, audit, judged, report, scope) -> Answer:
    """What is left is the groups' own, where that explains as much as the causes that were taken."""
    of_groups = functools.partial(_of_groups, report=report, scope=scope)
    climbed = lambda explained, *looked, **how: _asked_again(
        task, of_groups(task, explained, *looked, **how), report, scope
    )
    flagged = audit.flagged(explained.problem, judged)
    times = misfits.STANDS_OUT * (1.0 if explained.result.fits else KEENER_BY)
    if not flagged and not explained.taken and (keen := misfits.keener(judged, task.threshold, times)):
        keener = replace(audit, threshold=keen)
        answer = of_groups(replace(task, threshold=keen), explained, keener, judged)
        if _has_mirrors(answer) and not answer.climb.on("textured"):
            return _asked_again(task, answer, report, scope)
        if answer.climb:
            keener.doubt(explained.problem, explained.result, judged)
        return answered(explained, audit, judged)
    if not flagged and (answer := _one_apart(task, explained, audit, judged, of_groups)):
        return _asked_again(task, answer, report, scope)
    if not flagged or not explained.taken or explained.lobes:
        return climbed(explained, audit, judged)
    caused, how = None, {}
    if explained.is_sure and not audit.given:
        caused = climbed(explained, audit, judged)
        climb = caused.climb or caused.dropped
        if climb is None or not climb.on(*SPECULAR) or _keeps_causes(caused):
            return caused
        # what needs more to climb than beside the causes does not explain it more simply
        how = {"rounds": climb.rounds + 1}
    bare = explained.without_causes(**task.options)
    answer = climbed(bare, *looked(task, bare), small=False, **how)
    if not explained.is_sure:
        return answer  # what told mirrors throw looks like many a cause
    caused = caused or climbed(explained, audit, judged)
    if caused.dropped:
        return answer if _has_mirrors(answer) else caused  # causes that bent to a mirror hide it
    return caused if caused.nats >= answer.nats + enough(bare.problem) else answer


def _one_apart(task, explained, audit, judged, of_groups) -> Answer | None:
    """Where one group alone is off, by less than any may be: the answer in which it is a mirror or has a lobe, that
    explains all that was left. Causes that were taken may have been what it throws.
    """
    if misfits.apart(explained.problem, explained.result) is None:
        return None
    ways = [(explained, audit, judged)]
    is_near = explained.given.typical < NO_LOBE_FROM * explained.best.typical  # else all is off without the causes
    if explained.taken and not explained.lobes and is_near:
        bare = explained.without_causes(**task.options)
        ways.insert(0, (bare, *looked(task, bare)))
    for found, audit, judged in ways:
        group = misfits.apart(found.problem, found.result)
        off = judged[group] if group in judged and audit.given.get(group) is None else None
        if off is None or not off.judged or not off.excess:
            continue
        keen = min(JUST_BELOW * off.excess / misfits.tolerance(off, 1.0), task.threshold)
        answer = of_groups(replace(task, threshold=keen), found, audit, judged, only=group)
        left = answer.result.correlated
        if _has_mirrors(answer) and left <= LEFT_BY_ONE * found.result.correlated and answer.result.fits:
            return answer
    return None


def _keeps_causes(answer) -> bool:
    """The camera's causes, fitted anew beside what mirrors throw, bring what nothing else does: no climb without them
    does as well."""
    explained, problem, result = answer.explained, answer.problem, answer.result
    causes = {t.cause for t in explained.taken}
    if not causes or not result.fits:
        return False
    if causes == {Vignetting.name} and result.cov_cause is not None:
        numbers = result.state.cause - problem.cause.means  # from where there is no shadow
        brings = float(numbers @ steady(result.cov_cause, numbers)) / 2
    elif causes <= {response.Response.name, ColourMixing.name}:
        given = explained.given.problem
        told = replace(problem, transfer=given.transfer, fit_transfer=given.fit_transfer, cause=None, doubted=None)
        start = answer.candidate.start._replace(transfer=given.transfer, near=None)
        brings = answer.nats - Candidate.of(told, start=start).evidence.nats
    else:
        return False
    return brings >= surely(problem)


def _asked_again(task, answer, report, scope) -> Answer:
    if not scope.response or not _has_mirrors(answer):
        return answer
    return _in_mixed_colours(task, _under_another_response(task, answer, report, scope), scope)


def _in_mixed_colours(task, answer, scope) -> Answer:
    """The last fit with a camera that mixes colours, where it explains enough more: the diffuse fit saw the colours of
    what mirrors throw, too, and took neither for the camera's."""
    before = answer.candidate
    mixing = ColourMixing()
    if not mixing.may(before) or mixing.promise(before) < enough(answer.problem, mixing.free):
        return answer
    mixed = mixing.fitted(before)
    if not mixed.beats(before) or not mixing.is_physical(mixed, before):
        return answer
    problem = replace(mixed.problem, doubted=search.doubted(mixed, scope))
    result, scale = fit(problem, start=mixed.start._replace(near=None), **task.options)
    taken = Taken(mixing.name, mixed.evidence.nats - before.evidence.nats, {})
    climb = replace(answer.climb, problem=problem, result=result, scale=scale)
    answer.audit.doubt(problem, result, climb.misfits, climb.places)
    explained = replace(answer.explained, taken=[*answer.explained.taken, taken])
    return replace(
        answer,
        explained=explained,
        problem=problem,
        result=result,
        scale=scale,
        ascent=answer.ascent._replace(climb=climb),
    )


def _has_mirrors(answer) -> bool:
    """Mirrors or lobes have climbed."""
    return answer.climb is not None and bool(answer.climb.on(*SPECULAR))


def _under_another_response(task, answer, report, scope) -> Answer:
    """The transfer function asked again in the light by way of mirrors and lobes, which hid it from the diffuse fit.

    All is begun anew under the one that is found, and kept if it explains enough more.
    """
    before = answer.candidate
    promised = response.promise(before)
    if promised < enough(answer.problem):
        return answer
    functions = (before, *response.fitted(before, promised))
    best = response.simplest(functions)
    if best is before:
        return answer
    explained, function = answer.explained, best.result.state.transfer
    told = replace(explained.problem, transfer=function, fit_transfer=best.problem.fit_transfer, doubted=None)
    first = Candidate.of(told, explained.best.taken)
    result, scale = fit(told, start=first.start, **task.options)
    taken = Taken("response", best.evidence.nats - before.evidence.nats, {})
    rivals = {c.kind: c.evidence.nats - best.evidence.nats for c in functions if c is not best}
    explained = replace(
        explained,
        problem=told,
        result=result,
        scale=scale,
        best=first,
        rivals=rivals,
        taken=[*(t for t in explained.taken if t.cause != "response"), taken],
    )
    other = _of_groups(task, explained, *looked(task, explained), report, scope)
    return other if other.climb and other.nats >= answer.nats + enough(answer.problem) else answer


def _of_groups(task, explained, audit, judged, report, scope, only=None, **how) -> Answer:
    """The ladder where a diffuse surface does not explain the groups. only, how : of ladder.climb"""
    if only is None and not audit.flagged(explained.problem, judged):
        audit.doubt(explained.problem, explained.result, judged)
        return answered(explained, audit, judged)
    if only is None and _is_wrong_everywhere(explained, audit, judged):
        return answered(explained, audit, judged)
    with report.excluded("imports"):
        from lib.analysis.materials import ascent

    done = ascent.ascend(
        task.view(),
        task.factors,
        explained,
        task.found,
        audit.gathered,
        lobe_rays=task.lobe_rays,
        given=audit.given,
        threshold=task.threshold,
        only=only,
        **how,
        things=things_of(task, explained, audit),
        trace=lambda round, step, fitted: report.trace(
            round=round, step=step, image_rmse=fitted.rmse, gamma=fitted.state.gamma
        ),
        options=task.options,
    )
    climb, answer = done.climb, answered(explained, audit, judged)
    if not climb.result.fits and not audit.given:
        answer.dropped = climb
        if explained.result.fits:
            audit.doubt(explained.problem, explained.result, judged)
            if climb.on(*SPECULAR) and misfits.energy(climb.misfits) < RIGHT_ABOUT_MOST * misfits.energy(judged):
                # a mirror explains most, and then something else is seen to be wrong: the diffuse fit fits no better
                explained.result.correlated = climb.result.correlated
        return answer  # what is wrong is not one material: nothing is made up from it
    answer.ladder = ascent.summary(done)
    answer.warnings = ascent.warnings(done)
    if all(place.rung == "diffuse" for place in climb.places.values()):
        # the same light, but with what its causes leave unsure, which the ladder takes as they are
        audit.doubt(explained.problem, explained.result, judged, climb.places)
        return answer
    done = _with_causes(task, explained, done, scope)
    climb = done.climb
    audit.doubt(climb.problem, climb.result, climb.misfits, climb.places)
    answer.problem, answer.result, answer.scale, answer.ascent = climb.problem, climb.result, climb.scale, done
    return answer


def _with_causes(task, explained, done, scope) -> Ascent:
    """The climb with the causes of the camera fitted beside its groups, which climbed with those standing fast, and
    with what camera, lamps and edges leave open in every sigma.

    A diffuse fit takes mirrors' light and textures for the lens's doing, or a part of that for theirs. Albedo maps are
    made of the photograph without the shadow that is found in the end.
    """
    site, climb = done.site, done.climb
    problem, at = climb.problem, climb.result.at
    found = Candidate(problem, climb.result, evidence(problem, at))
    tiles = climb.tiles.take(np.flatnonzero(climb.tiles.fit))
    before, cause = explained.problem.cause, None
    of_camera = [c for c in causes_of(replace(scope, pixel=tiles.pixel)).values() if c.is_of_camera]
    alone = before is not None and set(before.names) <= {c.name for c in of_camera}
    open_ = [c for c in of_camera if c.name in before.names] if alone else []
    for c in open_:
        cause = c.left_open(problem, at, explained.values[c.name]).beside(cause)
    doubted = search.doubted(found, scope)
    problem = replace(problem, cause=cause, doubted=doubted, **_known_of(explained.problem, task.found.tiles, tiles))
    result, scale = fit(problem, start=found.start._replace(near=None), **task.options)
    view = task.view()
    for c in open_:
        values = c.moved(explained.values[c.name], result.state.cause[cause.of(c.name)])
        view = c.undone(view, values, result.state.transfer)
    site = replace(site, view=view) if open_ else site
    return done._replace(site=site, climb=replace(climb, problem=problem, result=result, scale=scale))


def _known_of(before, gathered, tiles) -> dict:
    """How unsure light and edges are, of the tiles of a climb: as of the gathered ones that they are."""
    first = {int(p): k for k, p in enumerate(gathered.pixel[gathered.start[:-1]])}
    seen_at_once = (tiles.chain == 0) & (tiles.lobe < 0)
    own = np.array([first.get(int(p), -1) for p in tiles.pixel[tiles.start[:-1]]], int)
    own[~seen_at_once] = -1
    taken = lambda values: np.where((own >= 0).reshape(-1, *[1] * (values.ndim - 1)), values[own], 0)
    edges = None if before.edge_noise is None else taken(before.edge_noise)
    return {"unsure": tuple((dD, taken(dD_tile)) for dD, dD_tile in before.unsure), "edge_noise": edges}


def _is_wrong_everywhere(explained, audit, judged):
    """Nearly every group differs, and none by far the most: no material of one of them can be what is wrong."""
    n_judged = sum(m.judged for m in judged.values())
    flagged = audit.flagged(explained.problem, judged)
    everywhere = len(flagged) >= max(SEVERAL, EVERYWHERE * n_judged)
    if not everywhere or explained.result.fits or audit.given:
        return False
    energy = [judged[g].energy for g in flagged if g in judged]
    return max(energy) < ALMOST_ALL * sum(energy)
