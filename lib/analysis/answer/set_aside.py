"""The photograph without the objects that are named: what is left of it is asked again.

An object of another material, or one that the model has too many, bends all that a fit finds, and hides what else there
is: no cause of the whole picture is taken while one object explains more. Once it is named, it is a group of its own,
whose tiles tell how bright it looks and no more. The search goes on from what was found, not anew: from far away a
small room fell into another valley of gamma.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.answer import disagreements
from lib.analysis.answer.answers import Answer, answered
from lib.analysis.answer.describe import BEYOND_SIGMA
from lib.analysis.causes import one_object, search
from lib.analysis.causes.candidates import Candidate
from lib.analysis.fit.equations import Unknowns
from lib.analysis.fit.facts import USUAL_GAMMA
from lib.analysis.fit.folds import FOLDS
from lib.analysis.fit.problem import EDGE_SHARE
from lib.analysis.fit.uncertainty import LEAST

NAMED = "group_wrong"  # of the causes the one whose subject is an object
# What is seen in pixels and in the file stands, whatever explains the rest: the rest is not asked for it again.
STANDS = (NAMED, "object_missing", "noise")
# Of the pixels that are fitted: as much as one fold of those that judge a fit. Of less of a picture anything is true.
MOST = 1 / FOLDS
HARDLY = 0.05  # display: the noise of a tile that tells how bright a thing looks, but not what else is so
# Cameras' gammas differ by less. A fit of a wrong model that finds another has bent to the model.
UNUSUAL_FROM = 1.4


def of_the_rest(task, answer: Answer, scope, **options) -> Answer | None:
    """The answer in which the objects that are named are apart, where the rest fits better and is known better.

    None where no object is named, or too much is, or something is wrong with all.
    scope : of the search;  options : of gauss_newton.gauss_newton
    """
    objects = apart(task, answer)
    if not objects:
        return None
    found = search.with_causes(_begun(task, answer, objects), scope, **options).kept(**options)
    again = answered(found)
    if not _is_better(again, answer):
        return None
    more = disagreements.disagreements(again.problem, again.result, task.found, task.transfer, found.rivals)
    stands = [w for w in answer.why if w.cause in STANDS]
    again.why = disagreements.joined(stands, [w for w in more if w.cause != "unknown"])
    return again


def apart(task, answer) -> list:
    """Numbers of the objects that are named, the smaller ones first, as long as they are no more than MOST.

    Where two of a group are named, one is what the other is not.
    """
    accused = [w for w in answer.why if w.cause == NAMED]
    given = answer.explained.given
    is_plain = answer.climb is None and not answer.explained.lobes and answer.refined is None
    if not accused or not is_plain or {w.cause for w in answer.why} & BEYOND_SIGMA or not isinstance(given, Candidate):
        return []
    if given.problem.tile_group.shape != task.found.object.shape:
        return []  # of the model with what lies outside it
    proved = [w for w in accused if w.evidence_nats is not None]  # the others are only seen, and may follow from these
    names = {w.subject for w in proved or accused}
    objects = [k for k, name in enumerate(task.view().model.objects) if name in names]
    pixels = given.problem.n_pixels
    of = {k: pixels[task.found.object == k].sum() for k in objects}
    some = []
    for one in sorted(objects, key=of.get):
        some += [one] if sum(of[k] for k in (*some, one)) <= MOST * pixels.sum() else []
    return some


def _begun(task, answer, objects) -> Candidate:
    """The rough fit under the given facts from where the answer stands; the objects are groups of their own."""
    given = answer.explained.given
    rest, state = given.problem, answer.result.state
    alike = state.transfer.kind == rest.transfer.kind and not state.transfer.channels
    state = state if alike else given.result.state
    rho, known = state.rho, rest.known_groups
    patch_object = np.asarray(task.view().model.facet_object)[task.factors.mesh.side // 2]
    for one in objects:
        for g in set(rest.tile_group[rest.tile_object == one]) - known:
            rest = one_object.with_its_own(rest, one_object.Unlike(g, one, 1.0, 0.0), patch_object)
            rho = np.vstack([rho, rho[g]])
    noise = 0 if rest.edge_noise is None else rest.edge_noise
    hardly = HARDLY * np.sqrt(rest.n_pixels / EDGE_SHARE)
    rest = replace(rest, edge_noise=np.where(np.isin(rest.tile_object, objects), hardly, noise))
    return Candidate.of(rest, start=Unknowns(rho, state.E, state.transfer, state.rho_s))


def _is_better(again: Answer, answer: Answer) -> bool:
    """It fits better, its values are known better, and its camera is one."""
    result, transfer = again.result, again.result.state.transfer
    is_usual = transfer.kind != "gamma" or not again.problem.fit_transfer
    is_usual |= abs(np.log(transfer.gamma / USUAL_GAMMA)) < np.log(UNUSUAL_FROM)
    fits = result.converged and result.correlated < answer.result.correlated
    return bool(fits and is_usual and _known_to(again) < _known_to(answer))


def _known_to(answer) -> float:
    """Median of sigma over reflectance of the groups that tiles show."""
    problem, result = answer.problem, answer.result
    if result.sigma_rho is None:
        return np.inf
    seen = problem.seen_groups & np.isnan(problem.rho).any(axis=1)
    share = result.sigma_rho[seen] / np.maximum(result.state.rho[seen], LEAST)
    return float(np.median(share)) if share.size else np.inf
