"""Whether photograph and given facts agree, and what is likeliest wrong where they do not.

A fit of some hundred numbers converges on anything. What it finds means something only if the light it rests on
explains the photograph to its noise, and if no fact that scene.yaml tells would better be another.
"""

from __future__ import annotations

import numpy as np

from lib.analysis.causes import glow, told_lamps, told_reference, told_transfer
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.fit.evidence import evidence
from lib.analysis.fit.problem import Problem, Result
from lib.analysis.seen.gather import Gathered, out_of_range
from lib.given import jpeg
from lib.given.materials import Why

ON_BOUNDS = 1 / 3  # share of the groups whose reflectance is 0 or 1, from which nothing found is believed


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
