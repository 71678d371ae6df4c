"""The photograph without what is known to be wrong in it: the rest is asked again.

An object of another material, one that the model has too many, or something that it has not bends all that a fit
finds, and hides what else there is: no cause of the whole picture is taken while one object explains more. It is named,
and its pixels need not be explained. What it throws on others is that of a surface as bright as it looks.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from lib.analysis.answer.answers import Answer, audit_of, things_of
from lib.analysis.answer.describe import BEYOND_SIGMA
from lib.analysis.answer.task import Task
from lib.analysis.fit import misfits
from lib.analysis.fit.folds import FOLDS

OBJECT, THING = "group_wrong", "object_missing"  # causes that name what can be set aside
# Of the pixels that are fitted: as much as one fold of those that judge a fit. A model of another room disagrees with
# more, and what is left of a picture that does not fit always fits.
MOST = 1 / FOLDS
RIM_PX = 2  # beside a thing: its edge is blurred
LITTLE = 0.1  # of a tile's pixels, that may show a thing
LEAST = 0.02  # smaller reflectances are as unsure as this one
WHITE = 0.98  # reflectance that an object may have at most


def without_accused(task: Task, answer: Answer) -> tuple[Task | None, list]:
    """(What is left of the photograph without the pixels of what `why` names, [Why] of that); None where it names
    nothing, too much, or what is wrong with all."""
    causes = {w.cause for w in answer.why}
    if task.changed is None or causes & BEYOND_SIGMA or not causes & {OBJECT, THING}:
        return None, []
    pixels = _pixels(task, answer)
    objects = _few(task.found, _objects(task, answer), pixels)
    if objects is None:
        return None, []
    apart = _looks(task, answer, objects) if answer.scale == "lamps" else {}  # else it would be a reference
    names = [task.view().model.objects[one] for one in objects]
    said = [w for w in answer.why if w.cause == THING or w.cause == OBJECT and w.subject in names]
    return task.changed(functools.partial(_rest, objects, pixels, apart)), said


def accused_groups(task: Task, answer: Answer) -> set:
    """Names of the groups of which `why` names an object: which of its objects are as the rest is open."""
    objects = _objects(task, answer)
    if not objects:
        return set()
    model = task.view().model
    group = np.asarray(model.facet_group)[np.isin(model.facet_object, objects)]
    return {model.groups[g] for g in np.unique(group)}


def joined(answer: Answer, again: Answer, named) -> Answer:
    """The answer of the rest, which says what was set aside. named : [Why]"""
    more = [w for w in again.why if w.cause != "unknown" and w not in named]
    return replace(again, why=[*named, *more], accused=again.accused | answer.accused)


def is_better(again: Answer, answer: Answer) -> bool:
    """The rest of the photograph fits better, and its values are known better. Or all is to be made again anyway."""
    if again.refined is not None:
        return True
    fits = again.result.converged and again.result.correlated < answer.result.correlated
    return fits and _known_to(again) < _known_to(answer)


def _known_to(answer) -> float:
    """Median of sigma over reflectance of the groups that tiles show."""
    problem, result = answer.problem, answer.result
    if result.sigma_rho is None:
        return np.inf
    seen = problem.seen_groups & np.isnan(problem.rho).any(axis=1)
    share = result.sigma_rho[seen] / np.maximum(result.state.rho[seen], LEAST)
    return float(np.median(share)) if share.size else np.inf


def _objects(task, answer) -> list:
    """Numbers of the objects that are named."""
    accused = [w for w in answer.why if w.cause == OBJECT]
    proved = [w for w in accused if w.evidence_nats is not None]  # the others are only seen, and may follow from these
    named = [w.subject for w in proved or accused]
    names = task.view().model.objects if named else ()
    return [names.index(name) for name in named if name in names]


def _pixels(task, answer) -> np.ndarray:
    """(H W,) bool: where things are that the model has not."""
    import cv2

    covered = np.zeros(task.view().shape, np.uint8)
    if answer.audit is not None and any(w.cause == THING for w in answer.why):
        for thing in things_of(task, answer.explained, answer.audit):
            covered |= thing.covers
    return cv2.dilate(covered, np.ones((2 * RIM_PX + 1,) * 2, np.uint8)).reshape(-1) > 0


def _few(found, objects, pixels) -> list | None:
    """Numbers of the objects that can be set aside beside the pixels (H W,) without losing more than MOST; None: what
    they are is too much, or nothing.

    The smaller ones: where two of a group are named, one is what the other is not.
    """
    n = np.diff(found.tiles.start)
    share = lambda objects: n[_shows(found, objects, pixels)].sum() / max(n.sum(), 1)
    if share([]) > MOST:
        return None
    some = []
    for one in sorted(objects, key=lambda one: n[found.object == one].sum()):
        some += [one] if share([*some, one]) <= MOST else []
    return some if some or share([]) else None


def _shows(found, objects, pixels) -> np.ndarray:
    """(T,) bool: tiles of one of the objects, or of the pixels (H W,)."""
    tiles = found.tiles
    covered = np.diff(np.append(0, np.cumsum(pixels[tiles.pixel]))[tiles.start])
    return np.isin(found.object, objects) | (covered > LITTLE * np.diff(tiles.start))


def _looks(task, answer, objects) -> dict:
    """{(object, group): rho (C,)} as the audit's pixels show them."""
    found, looks = answer.explained, {}
    audit, result = answer.audit or audit_of(task, found), found.result
    tiles = audit.tiles
    for thing in objects:
        for g in np.unique(tiles.group[tiles.object == thing]):
            ratio = misfits.ratio_of(audit.subcell, found.problem, result, tiles, g, thing)
            looks[thing, int(g)] = np.clip(ratio * result.state.rho[g], 0, WHITE)
    return looks


def _rest(objects, pixels, looks, view, factors, found, audit):
    """Arguments of Task.changed: the tiles of the rest; objects that look otherwise are groups of their own."""
    found, audit = (each.take(np.flatnonzero(~_shows(each, objects, pixels))) for each in (found, audit))
    if not looks:
        return view, factors, found, audit, None
    model, known = view().model, {}
    facet_group, area = np.array(model.facet_group), list(factors.group_area_m2)
    for (thing, g), rho in looks.items():
        mine = (model.facet_object == thing) & (np.asarray(model.facet_group) == g)
        facet_group[mine] = len(model.groups) + len(known)
        known[f"{model.groups[g]} of {model.objects[thing]}"] = rho
        area.append(float(model.facet_area()[mine].sum()))
    groups = (*model.groups, *known)
    regrouped = functools.cache(
        lambda: replace(view(), model=replace(view().model, facet_group=facet_group, groups=groups))
    )
    patch_group = facet_group[factors.mesh.side // 2].astype(factors.patch_group.dtype)
    factors = replace(factors, groups=groups, patch_group=patch_group, group_area_m2=np.array(area))
    seen = lambda each: replace(each, visible=np.append(each.visible, np.zeros(len(known), each.visible.dtype)))
    return regrouped, factors, seen(found), seen(audit), known
