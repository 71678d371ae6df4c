"""Whether the camera, an object or a lamp stands elsewhere than given: then all that rests on it is made again.

Looked at only where the light leaves a doubt. The photograph's edges are asked first. Where they agree with the given
files, a lamp that the photograph does not show may still throw its light from elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.analysis import lamp_place
from lib.analysis.agreement import fits
from lib.analysis.candidates import enough
from lib.analysis.direct_light import DirectLight
from lib.analysis.explain import SURE_PER_TILE, Explained
from lib.analysis.gather import Gathered
from lib.analysis.gauss_newton import fit
from lib.analysis.places import TWIST, Places, object_of
from lib.given import cameras
from lib.given.cameras import Camera
from lib.given.materials import Cause, Causes, Rival, write_causes
from lib.given.model.glb_writer import keeps_parts, write_glb
from lib.given.model.mesh import Model
from lib.given.view import View
from lib.light.factors_file import FormFactors

LAMP_PLACE_M = 0.1  # standard deviation of a lamp's place


@dataclass(frozen=True, eq=False)
class Refinement:
    """camera, model : None where they are as given;  causes : [Cause] that moved them"""

    camera: Camera | None
    model: Model | None
    causes: list

    def write(self, camera, model, causes):
        """The files, causes last. Nothing where the model's parts would not keep their numbers: whether it was done"""
        if self.model is not None and not keeps_parts(self.model):
            return False
        if self.camera is not None:
            cameras.write_cameramodel(camera, self.camera)
        if self.model is not None:
            write_glb(model, self.model)
        write_causes(causes, Causes(self.causes))
        return True


def by_edges(view: View, places: Places) -> Refinement:
    """Camera and objects where the photograph's edges have them."""
    found = places.registration
    moved = found.pose is not None or found.centre_px is not None
    return Refinement(
        found.camera(view.camera) if moved else None,
        found.model(view.model) if found.objects else None,
        places.causes,
    )


def by_light(view: View, factors: FormFactors, found: Gathered, explained: Explained, sure=True) -> Refinement | None:
    """The lamp that its light puts elsewhere; None where the picture does not come to fit by that.

    sure : False: other things may be wrong with single groups, and the lamp must explain more than they could
    """
    given = explained.given
    if given is None or given.problem.specular is not None:
        return None
    lamps = lamp_place.Lamps.of(DirectLight(view, factors, found))
    least = enough(given.problem) + (0 if sure else SURE_PER_TILE * len(given.problem.tile_group))
    least = max(least, sum(taken.nats for taken in explained.taken))
    promises = {lamp: lamp_place.promise(given, lamps, lamp, LAMP_PLACE_M) for lamp in lamps.things}
    lamp = max(promises, key=promises.get, default=None)
    if lamp is None or promises[lamp] < enough(given.problem):
        return None
    best = lamp_place.fitted(given, lamps, lamp, LAMP_PLACE_M)
    nats = best.evidence.nats - given.evidence.nats
    if nats < least:
        return None
    result, _ = fit(best.problem, start=best.start)
    if not fits(result):
        return None
    axes, offset = lamps.things[lamp][1], best.taken["lamp_place"][lamp]
    covariance = axes.T @ result.cov_cause @ axes
    twist = np.zeros((6, 6))
    twist[3:, 3:] = covariance
    sigma = {"offset_m": np.sqrt(np.diag(covariance)).tolist(), TWIST: twist.tolist()}
    rivals = [Rival(taken.cause, float(taken.nats)) for taken in explained.taken]
    cause = Cause("lamp_place", lamp, {"offset_m": offset.tolist()}, sigma, float(nats), rivals)
    return Refinement(None, lamps.moved(lamp, offset), [cause])


def unsure(view: View, factors: FormFactors, found: Gathered, causes) -> list:
    """[(dD, dD_tile)] by which the lamps' light is unsure, since objects and lamps were moved no better than that.

    view : with the refined model;  causes : [Cause], of refined.json
    """
    light, moves = DirectLight(view, factors, found), []
    for cause in causes:
        covariance = (cause.sigma or {}).get(TWIST)
        if covariance is not None:
            moves += light.spread(object_of(view.model, cause), np.array(covariance))
    return moves
