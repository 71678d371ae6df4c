"""§2.4 The answer, or why there is none: by planes first, by corners where planes prove nothing.

    found, result, why = answer(scene, model, sides, db)

Both ways end with the photographs (lib/vision/refinement). Corners are tried only where the planes' answer is refused.
"""

import math
from contextlib import nullcontext

import numpy as np

from lib.vision.corners.hypotheses import hypotheses
from lib.vision.recognition.closed_form import Pose, explained
from lib.vision.recognition.hashing import database, seen_facets
from lib.vision.recognition.recognise import Recognition, recognise
from lib.vision.refinement import words
from lib.vision.refinement.pose import refine

REFUSED = "not recognised"
PLACED = 0.006  # rad, and parts of the depth: one sigma of a pose by corners
RIVALS = 2  # poses by planes that are judged beside those by corners
JUDGED = 6  # poses by corners that the photographs judge


def answer(scene, model, sides, *, timing=lambda name: nullcontext(), **how):
    """(Recognition, Refined or None, why): why is "" where there is an answer, else all figures in words.

    scene : SceneFacets;  sides : rig.Side, left and right;  timing : of a report;  how : for refine
    """
    with timing("recognise"):
        db = database(model)
        found = recognise(scene, model, sides[0].camera, db)
    result, why = _judged(scene, model, sides, found, timing, how)
    if not why or scene.unit != "m":
        return found, result, why
    with timing("corners"):
        by_corners = recognised_by_corners(scene, model, sides, db, found)
    if not by_corners.poses:
        return found, result, f"{why}; {by_corners.why}"
    result_by_corners, why_not = _judged(scene, model, sides, by_corners, timing, how)
    if why_not and result is not None and result.evidence > result_by_corners.evidence:
        return found, result, f"{why}; {why_not}"
    return by_corners, result_by_corners, why_not and f"{why}; {why_not}"


def _judged(scene, model, sides, found, timing, how):
    """(Refined or None, why there is no answer, or "")."""
    if not found.poses:
        return None, found.why
    with timing("refine"):
        result = refine(model, sides, found, scene.labels, ln_hypotheses=found.counts["chance"], **how)
    return result, words.refusal(found, result) if result.status == REFUSED else ""


def recognised_by_corners(scene, model, sides, db, found) -> Recognition:
    """The poses that corners propose, best first, those that planes proposed behind them; the photographs must decide.

    found : the Recognition by planes; what it counted is counted on
    """
    tried = hypotheses(scene, model, sides)
    counts = found.counts | {
        "lines": tried.lines,
        "corners": tried.corners,
        "hypotheses": tried.tried,
        "chance": round(math.log(max(tried.tried, 1)), 1),
    }
    if not tried.tried:
        why = f"{tried.corners} corners of {tried.lines} lines lie on none of the model's"
        return Recognition((), REFUSED, why, found.weight, counts)
    seen = seen_facets(scene, sides[0].camera) if len(scene) else None
    covariance = np.diag([PLACED**2] * 3 + [(PLACED * tried.depth) ** 2] * 3)
    poses = []
    for T, nats in zip(tried.T[:JUDGED], tried.nats, strict=False):
        about = T.copy()
        about[:3, 3] += T[:3, :3] @ db.centre
        matches = explained(seen, db, about, 1.0)[0] if seen else np.zeros((0, 2), int)
        poses.append(Pose(T, 1.0, covariance, matches, float(nats), 0.0, 0.0, T))
    why = f"{tried.tried} poses by corners were compared, {len(poses)} of them with the photographs"
    return Recognition((*poses, *found.poses[:RIVALS]), "unproved", why, found.weight, counts)
