"""Whether a lamp stands elsewhere than given: then all that rests on it is made again.

The photograph's edges were asked before (stage `edges`). Where they agree with the given files and the light does not,
a lamp that the photograph does not show may throw its light from elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lib.analysis.answer.audit import Audit, looking_at
from lib.analysis.causes import lamp_place
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.causes.cause import settled
from lib.analysis.causes.explained import Explained
from lib.analysis.causes.lamp_place import LampPlace
from lib.analysis.causes.table import causes_of
from lib.analysis.fit.gauss_newton import fit
from lib.analysis.seen.direct_light import DirectLight
from lib.analysis.seen.gather import Gathered
from lib.analysis.seen.places import TWIST, object_of
from lib.given.materials import Cause, Causes, Rival, Why, write_causes
from lib.given.model.glb_writer import keeps_parts, write_glb
from lib.given.model.mesh import Model
from lib.given.view import View
from lib.light.factors_file import FormFactors

LAMP_PLACE_M = 0.1  # Standard deviation of a lamp's place.
# A lamp stands elsewhere if it ends so many sigma from where it is drawn. What a tone curve left brought 39 nats for
# a lamp at 1.5.
LEAST_SIGMAS = 3.0
MOST_OF_PROMISE = (
    4  # A lamp's place brings at most so many times what one step promises. Displaced ones brought .8 to 1.3 times.
)


@dataclass(frozen=True, eq=False)
class Refinement:
    """model : with the lamp elsewhere;  causes : [Cause] that moved it;  why : [Why], the same, said

    nats : of held-out tiles, by which their light told
    """

    model: Model
    causes: list
    why: list
    nats: float

    @property
    def keeps_parts(self) -> bool:
        """The model's facets, groups and objects keep their numbers in a file."""
        return keeps_parts(self.model)

    def write(self, model, causes):
        """The files, causes last."""
        write_glb(model, self.model)
        write_causes(causes, Causes(self.causes))


def by_light(
    view: View,
    factors: FormFactors,
    found: Gathered,
    explained: Explained,
    audit: Callable[[Explained], Audit],
    sigma_m,
    above=0.0,
    beside_mirrors=False,
):
    """Refinement by the lamp that its light puts elsewhere; None where not all comes to fit by that.

    In place of the causes that were taken, or beside them.

    audit : makes it;  sigma_m : {lamp: how surely it stands where it is drawn}, LAMP_PLACE_M where nothing is said
    above : nats that something else promises, which a lamp's place must outdo

    What a mirror or a lobe throws may look like a lamp that was moved. But then their own pixels still do not fit.
    beside_mirrors : they need not, nor what a single group may throw
    """
    lamps = _lamps(view, factors, found, explained)
    if lamps is None:
        return None
    search = lambda base, least=0.0, above=0.0: _elsewhere(
        explained, base, lamps, audit, sigma_m, least, above, beside_mirrors
    )
    best = search(explained.given, max(above, sum(taken.nats for taken in explained.taken)), above)
    base = explained.given
    if best is None and explained.taken:
        base = explained.best
        best = search(base)
    if best is None:
        return None
    lamp, offset, covariance, nats = best
    twist = np.zeros((6, 6))
    twist[3:, 3:] = covariance
    sigma = {"offset_m": np.sqrt(np.diag(covariance)).tolist(), TWIST: twist.tolist()}
    rivals = [Rival(taken.cause, float(taken.nats)) for taken in explained.taken]
    cause = Cause("lamp_place", lamp, {"offset_m": offset.tolist()}, sigma, float(nats), rivals)
    far = 1000 * np.linalg.norm(offset)
    text = f"lamp {lamp!r} stands {far:.0f} mm from where the model has it, says its light by {nats:.0f} nats"
    why = Why("lamp_place", lamp, text, float(nats))
    return Refinement(lamps.moved(lamp, offset), [cause], [why], base.evidence.nats + nats)


def lamp_in_doubt(view: View, factors: FormFactors, found: Gathered, explained: Explained, sigma_m, above) -> bool:
    """One step of a lamp from where it is drawn promises more than `above` nats. The rest as of by_light."""
    lamps = _lamps(view, factors, found, explained)
    return lamps is not None and _most_promising(explained.given, lamps, sigma_m, 0.0, above) is not None


def _lamps(view, factors, found, explained) -> lamp_place.Lamps | None:
    """The lamps that may be moved; None where nothing can be learnt of them."""
    given = explained.given
    if given is None or given.problem.specular is not None:
        return None
    return given.once(
        "lamps_that_move", lambda _: lamp_place.Lamps.of(DirectLight(view, factors, found), given.start.E)
    )


def _most_promising(base: Candidate, lamps, sigma_m, least, above):
    """The lamp whose place promises most by one step, None where that is too little. least, above : of _elsewhere"""
    prior = lambda lamp: sigma_m.get(lamp, LAMP_PLACE_M)
    promise = lambda base: {lamp: LampPlace(lamps, lamp, prior(lamp)).promise(base) for lamp in lamps.things}
    promises = base.once(LampPlace.name, promise)
    lamp = max(promises, key=promises.get, default=None)
    too_little = lamp is None or promises[lamp] < max(enough(base.problem), above, least / MOST_OF_PROMISE)
    return None if too_little else lamp


def _elsewhere(explained: Explained, base: Candidate, lamps, audit, sigma_m, least, above, beside_mirrors):
    """(lamp, offset (3,), its covariance, nats) of the lamp that explains most elsewhere; None where not all fits then.

    base : of `explained`, without its causes or with them;  least : nats that it must bring
    above : that one step must promise, too;  beside_mirrors : of by_light
    """
    least = max(least, enough(base.problem))
    lamp = _most_promising(base, lamps, sigma_m, least, above)
    if lamp is None:
        return None
    prior = sigma_m.get(lamp, LAMP_PLACE_M)
    best = base.once((LampPlace.name, lamp), lambda base: _moved(explained, base, lamps, lamp, prior))
    if best is None:
        return None
    nats = best.evidence.nats - base.evidence.nats
    if nats < least:
        return None
    result = best.once("fit", lambda best: fit(best.problem, start=best.start)[0])
    if result.cov_cause is None or not (result.fits or beside_mirrors):
        return None
    axes, offset = lamps.things[lamp][1], best.taken[LampPlace.name]
    own = best.problem.cause.of(LampPlace.name)
    covariance = result.cov_cause[np.ix_(own, own)]
    if not is_elsewhere(axes @ offset, covariance):
        return None
    with_causes = lambda c: replace(explained, problem=c.problem, result=c.result, values=c.taken)
    before, after = audit(with_causes(base)), audit(with_causes(best))
    light = DirectLight(lamps.light.view, lamps.light.factors, after.gathered).of(lamps.moved(lamp, offset), lamp)[1]
    # what stands beside it looks at its old place still: only its own light is that of the new one
    group, patch_group = base.problem.groups.index(lamp), base.problem.patch_group
    apart = [~looking_at(audited.tiles.rows, group, patch_group) for audited in (before, after)]
    energy = after.energy(best.problem, result, light, apart[1])
    is_all = before.energy(base.problem, base.result, among=apart[0]).is_explained_by(energy)
    if not (is_all or beside_mirrors and (result.fits or energy.is_of_one)):
        return None
    return lamp, offset, axes.T @ covariance @ axes, nats


def is_elsewhere(step, covariance) -> bool:
    """A step (n,) of this covariance is one, not what is left of something else. Evidence alone does not tell: where
    much is left, a step within its sigma brings nats, too."""
    return bool(step @ np.linalg.solve(covariance, step) >= LEAST_SIGMAS**2)


def _moved(explained: Explained, base: Candidate, lamps, lamp, prior_m) -> Candidate | None:
    """The fit with the lamp elsewhere, and the lens's shadow as it is then; None where that brings nothing."""
    best = LampPlace(lamps, lamp, prior_m).fitted(base)
    causes = causes_of(explained.scope).values() if explained.scope is not None else ()
    return best and settled(best, base, causes)


def flipped(view: View, factors: FormFactors, found: Gathered, explained: Explained) -> list[Why]:
    """A line where the lamps would explain the photograph if their facets were turned to the other side."""
    given = explained.given
    if given is None or given.problem.specular is not None:
        return []
    D, D_tile = DirectLight(view, factors, found).of(turned_over(view.model, factors.own_lamps))
    if not D_tile[:, given.problem.own_lamps].any():
        return []
    other = Candidate.of(replace(given.problem, D=D, D_tile=D_tile))
    nats = other.evidence.nats - given.evidence.nats
    if nats < enough(given.problem) or other.typical > given.typical / 2:
        return []
    names = ", ".join(map(repr, factors.own_lamps))
    text = f"the lamps ({names}) face the other way: turned over they fit better by {nats:.0f} nats"
    return [Why("lamp_flipped", factors.lamps[0], text, float(nats))]


def turned_over(model: Model, lamps) -> Model:
    """The model with the facets of lamps seen from behind."""
    facets = np.isin(model.facet_group, [model.groups.index(name) for name in lamps])
    triangles = model.triangles.copy()
    mine = facets[model.triangle_facet]
    triangles[mine] = triangles[mine][:, ::-1]
    way = np.where(facets, -1.0, 1.0)
    normal, offset = model.facet_normal * way[:, None], model.facet_offset * way
    return replace(model, triangles=triangles, facet_normal=normal, facet_offset=offset)


def unsure(view: View, factors: FormFactors, found: Gathered, causes, loose) -> list:
    """[(dD or None, dD_tile)] by which the lamps' light is unsure, since things stand no more surely than that.

    view : with the refined model;  causes : [Cause], of refined.json;  loose : {object: (6, 6)}, of Registration
    """
    light, moves = DirectLight(view, factors, found), []
    moved = {object_of(view.model, cause): cause.sigma[TWIST] for cause in causes if TWIST in (cause.sigma or {})}
    for thing, covariance in moved.items():
        moves += light.spread(thing, np.array(covariance))
    for name, covariance in loose.items():
        if (thing := view.model.objects.index(name)) not in moved:
            moves += light.own_spread(thing, covariance)
    return moves
