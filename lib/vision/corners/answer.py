"""§2.4 The answer, or why there is none: by planes first, by corners where planes prove nothing.

    found, result, denied, why = answer(scene, model, sides)

Both ways end with the photographs (lib/vision/refinement): they must show the edges of the pose. And facets must not
lie where the model shows something else. An empty corner of another room of the same height shows 79 % of its edges;
the furniture before it denies it. Corners are tried only where the planes' answer is refused.
"""

import math
from contextlib import nullcontext
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lib.vision.corners.hypotheses import hypotheses
from lib.vision.recognition.closed_form import Pose, contradicted, explained
from lib.vision.recognition.hashing import database, seen_facets
from lib.vision.recognition.recognise import Recognition, recognise
from lib.vision.refinement import words
from lib.vision.refinement.pose import Refined, refine

REFUSED = "not recognised"
MOST_DENIED, MOST_DENIED_PROVED = (
    0.34,
    0.5,
)  # of the facets that say yes or no; right poses: up to .22 in 71 random pairs
PLACED = 0.006  # rad, and parts of the depth: one sigma of a pose by corners
RIVALS = 1  # poses by planes that are judged beside those by corners
JUDGED = 4  # poses by corners that the photographs judge


class Judged(NamedTuple):
    """found, result : by planes or by corners; result is None where there was no pose to judge

    denied : scene facets that lie where the model shows something else, and those that say yes or no: (2,) int
    why : "" where there is an answer, else all figures in words
    """

    found: Recognition
    result: Refined | None
    denied: tuple
    why: str


def answer(scene, model, sides, *, timing=lambda name: nullcontext(), **how) -> Judged:
    """The answer by planes, or by corners where there is none.

    scene : SceneFacets;  sides : rig.Side, left and right;  timing : of a report;  how : for refine
    """
    with timing("recognise"):
        db = database(model)
        found = recognise(scene, model, sides[0].camera, db)
    by_planes = _judged(scene, model, sides, db, found, timing, how)
    if not by_planes.why or scene.unit != "m":
        return by_planes
    with timing("corners"):
        found = recognised_by_corners(scene, model, sides, db, found)
    by_corners = _judged(scene, model, sides, db, found, timing, how)
    if not by_corners.why:
        return by_corners
    return by_planes._replace(why=f"{by_planes.why}; {by_corners.why}")


def _judged(scene, model, sides, db, found, timing, how) -> Judged:
    """What the photographs say of the poses, and then the facets of the best."""
    if not found.poses:
        return Judged(found, None, (0, 0), found.why)
    with timing("refine"):
        result = refine(model, sides, found, scene.labels, ln_hypotheses=found.counts["chance"], **how)
    denied = _denied(scene, sides, db, result)
    most = MOST_DENIED if found.status == "unproved" else MOST_DENIED_PROVED
    if denied[0] > most * denied[1]:
        result = replace(result, status=REFUSED)
    return Judged(found, result, denied, words.refusal(found, result, denied, most) if result.status == REFUSED else "")


def _denied(scene, sides, db, result) -> tuple:
    """(facets that lie where the model shows something else, those that say yes or no).

    None of a pair whose relative pose was estimated: its facets are off by as much as that, which their sigma has not.
    """
    if not len(scene) or scene.unit == "baseline":
        return 0, 0
    seen, T = seen_facets(scene, sides[0].camera), result.cameras[0].T_cam_world.copy()
    T[:3, 3] += T[:3, :3] @ db.centre
    no = int(contradicted(seen, db, T, result.scale).sum())
    return no, no + len(explained(seen, db, T, result.scale)[0])


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
