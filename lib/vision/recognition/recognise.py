"""§2.4 Recognition: which part of the model do the reconstructed facets show, and from where?

    scene = facets_file.read_scene("facets.json")
    found = recognise(scene, model, camera)         # Recognition: poses, best first, and their matches

The frame of the facets is the left camera's; a pose takes the model's frame ("world", metres) to it. The scale q is
the metres per unit of the facets: 1, or unknown where the unit is the pair's baseline.

Method. Normals alone give a few rotations: pairs of scene facets are laid on pairs of the model's directions that
stand at the same angle (all of them, no hash table: a model has few directions). At each rotation a scene facet may lie
on a facet of the model that is not smaller. The positions where it does fill a flat box: thin along the normal (the
covariance), as wide as the part that is seen may slide on what is there. The largest set of matches that one
displacement allows is the deepest point of those boxes. Branch and bound finds it, so that nothing is missed. The best
candidates are fitted to the planes in closed form, then by least squares under the covariances. Rays say what the
camera would see there: only a facet that would show where the region lies counts.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lib.vision.recognition import hashing_kernels, search_kernels
from lib.vision.recognition import rotations_kernels as kernels
from lib.vision.recognition.closed_form import DISTINCT, DISTINCT_RAD, polish
from lib.vision.recognition.hashing import database, distinct_planes, seen_facets
from lib.vision.recognition.rotations import candidate_rotations, directions
from lib.vision.recognition.search import candidates, weights

PROVEN_SHARE = 0.33  # of all evidence; half of the facets may be spurious
HELD = 0.15  # rad, or parts of the depth: a looser pose is not held by the facets


@dataclass(frozen=True, eq=False)
class Recognition:
    """The answer.

    poses : tuple of Pose          best first; those behind the first explain the facets as well ("ambiguous")
    status : "unique"; "ambiguous"; "unproved": the photographs must decide, for there is no more evidence than the
             search finds by chance, or for a small part of the facets only, or the facets hardly hold the pose;
             "not recognised": nothing to decide about
    why : str                     in plain words, where it is not recognised
    weight : (N,)                 evidence in nats of each scene facet
    counts : dict                 rotations, correspondences, nodes, candidates; complete: the search was;
                                  chance: nats found by chance, ln of how many displacements were told apart
    """

    poses: tuple
    status: str
    why: str
    weight: np.ndarray
    counts: dict


# The whole.


def recognise(scene, model, camera, db=None, *, certain=5.0) -> Recognition:
    """The displacements of the model that explain the facets, best first.

    camera : gives the focal length (what a pixel is worth), no more
    certain : nats; a pose whose evidence falls short of the best's by less is another answer

    "not recognised": fewer than 3 facets that fix six degrees of freedom (seven with the scale), or nothing that
    explains enough of them.
    """
    scale_free = scene.unit == "baseline"
    db = db or database(model)
    counts = {"facets": len(scene), "rotations": 0, "correspondences": 0, "nodes": 0, "candidates": 0, "complete": True}
    nothing = lambda why: Recognition((), "not recognised", why, np.zeros(len(scene)), counts)
    if len(scene) < 3:
        return nothing(f"{len(scene)} facets cannot fix a pose: at least 3 are needed")
    seen = seen_facets(scene, camera)
    rank = np.linalg.svd(seen.n, compute_uv=False)
    if rank[-1] < 0.05 * rank[0]:
        return nothing(f"the {len(scene)} facets face less than 3 independent directions: the pose can slide")
    weight, size_ok = weights(seen, db, scale_free)
    rotations = candidate_rotations(seen, directions(db))
    counts["rotations"] = len(rotations)
    poses = []
    for T, q, pairs in candidates(seen, db, rotations, weight, size_ok, scale_free, certain + 2.0, counts):
        pose = polish(seen, db, weight, T, q, pairs, scale_free)
        if pose is not None and not any(_same(pose, other, seen) and other.score >= pose.score for other in poses):
            poses = [other for other in poses if not _same(pose, other, seen)] + [pose]
    return _judge(seen, db, weight, poses, certain, scale_free, counts)


def _same(a, b, seen):
    """Do two poses put the scene at the same place?"""
    turn = np.linalg.norm(a.T[:3, :3] - b.T[:3, :3]) / math.sqrt(2)
    ca, cb = (p.T[:3, :3].T @ (p.scale * seen.pivot - p.T[:3, 3]) for p in (a, b))
    reach = DISTINCT * seen.radius * max(a.scale, b.scale)
    return turn < DISTINCT_RAD and np.linalg.norm(ca - cb) < reach and abs(math.log(a.scale / b.scale)) < DISTINCT


def _judge(seen, db, weight, poses, certain, scale_free, counts):
    """Order, status, covariances, and back to the model's own frame."""
    if not poses:
        return Recognition(
            (), "not recognised", "no displacement of the model explains three of the facets", weight, counts
        )
    # Ties within the evidence's resolution go to the least mean square error between corners (the paper's rule).
    poses = sorted(poses, key=lambda p: (-round(p.score, 1), p.vertex_m))
    best = poses[0]
    size = 7 if scale_free else 6
    information = np.linalg.eigvalsh(best.covariance / _unit(seen, best.scale, size))
    loosest = 1 / math.sqrt(max(information[0], 1e-12))  # rad, or parts of the depth
    planes = (
        f"only {distinct_planes(db, best.matches[:, 1])} distinct planes explain {len(best.matches)} of {len(weight)} "
        "facets: the pose cannot be known"
    )
    if len(best.matches) < 3 or loosest > 1:
        return Recognition((), "not recognised", planes, weight, counts)
    rivals = [p for p in poses[1:] if p.score > best.score - certain]
    final = tuple(_in_the_world(p, seen, db, size) for p in (best, *rivals))
    why = _unproved(best, planes if loosest > HELD else "", weight, counts)
    status = "unproved" if why else "ambiguous" if len(final) > 1 else "unique"
    return Recognition(final, status, why, weight, counts)


def _in_the_world(pose, seen, db, size):
    """A Pose in the model's own frame, its covariance in place of the normal matrix."""

    def moved(T):
        T = T.copy()
        T[:3, 3] = T[:3, 3] - T[:3, :3] @ db.centre
        return T

    covariance = np.linalg.inv(pose.covariance + 1e-2 * _unit(seen, pose.scale, size) * np.eye(size))
    return replace(pose, T=moved(pose.T), covariance=covariance, linear=moved(pose.linear))


def _unproved(best, loose, weight, counts):
    """Why the photographs must decide, in words, or "". loose : what is said of a pose that the facets hardly hold"""
    if not counts["complete"]:
        return f"the search gave up after {counts['nodes']} cells: other displacements may explain the facets as well"
    if loose:
        return loose
    share = best.score / max(float(weight.sum()), 1e-12)
    explains = f"the best displacement explains {len(best.matches)} of {len(weight)} facets"
    if best.score < counts["chance"] + 1:
        return f"{explains}, no more than a displacement that is wrong explains by chance"
    return f"{explains}, {100 * share:.0f} % of what they say" if share < PROVEN_SHARE else ""


def _unit(seen, scale, size):
    """Outer product that makes a normal matrix dimensionless: radians, and translations as parts of the depth."""
    u = np.ones(size)
    u[3:6] = 1 / (seen.radius * scale)
    return np.outer(u, u)


def warm_up():
    """Compiles, or reads from the cache, what is compiled."""
    one, zero, eye = np.zeros((1, 3)), np.zeros(1, np.int64), np.eye(3)
    kernels.support(eye[None], eye, eye, np.ones(3), np.ones(3))
    kernels.aligned(eye, eye, np.ones(3), eye)
    scene = hashing_kernels.SceneSide(one, np.ones(1), eye, np.array([0, 3]), one, np.ones(1), np.ones(1))
    model = hashing_kernels.ModelSide(eye[None], one - 1, one + 1, np.ones(1, bool))
    hashing_kernels.fill(scene, model, np.ones((1, 1), bool))
    pairs = search_kernels.Conditions(zero, np.zeros((1, 3, 7)))
    problems = search_kernels.Problems(zero, np.array([0, 1]), np.ones(1), np.zeros(1), np.ones(1))
    search_kernels.search(pairs, problems, np.ones(1), search_kernels.Limits(np.ones(3), 1.0, 1.0, 100))
