"""For given rotations, the translations that explain most: branch and bound over boxes."""

import math

import numpy as np

from lib.vision.recognition import search_kernels as kernels
from lib.vision.recognition.hashing import correspondences
from lib.vision.recognition.hashing_kernels import Correspondences

SCALE_STEP = 0.08  # ln; the scales are searched in steps
MOST_NODES = 2_000_000  # some seconds
MOST = 150  # places that are looked at
LARGEST = 50  # times as large as the scene the model may be where the scale is unknown


def candidates(seen, db, rotations, weight, size_ok, scale_free, margin, counts):
    """[(T, scale, matches (n, 2))]: the displacements whose bound comes within margin of the best, best first.

    seen : hashing.Seen; db : hashing.Database; rotations : of rotations.candidate_rotations; weight : (N,) nats;
    size_ok : (N, F) bool; margin : nats. Fills in counts: correspondences, nodes, candidates, complete, and chance: so
    much evidence is found by chance, as so many displacements can be told apart. Three facets put a scene anywhere.
    """
    extent = float(np.linalg.norm(db.size))
    spread = _spread(seen)
    pairs, problems, number = _problems(seen, db, rotations, size_ok, _scales(extent / spread, scale_free))
    counts["correspondences"], counts["chance"] = len(problems.member) if problems else 0, 0.0
    if not problems:
        return []
    thin = 3 * np.median(seen.height) * (0.3 * extent / spread if scale_free else 1.0)
    counts["chance"] = round(float(np.log(len(number)) + np.log(np.maximum(db.size / (2 * thin), 1)).sum()), 1)
    resolution = 0.4 * problems.scale * np.median(pairs.P1[:, 0] - pairs.P2[:, 0]) / 2
    problems = problems._replace(resolution=np.maximum(resolution, 1e-6 * extent))
    limits = kernels.Limits(db.size / 2 + 0.25 * extent, spread, margin, MOST_NODES)
    rows = np.concatenate([pairs.A, np.stack([pairs.P1, pairs.P2, pairs.low, pairs.high], axis=-1)], axis=-1)
    places, counts["nodes"] = kernels.search(kernels.Conditions(pairs.scene, rows), problems, weight, limits)
    counts["complete"] = bool(counts["nodes"] < MOST_NODES)
    found = []
    best_first = np.argsort(-places.score, kind="stable")
    for k in [k for k in best_first if places.score[k] >= places.score.max() - margin][:MOST]:
        problem, c, q = places.problem[k], places.place[k, :3], places.place[k, 3]
        mine = problems.member[problems.start[problem] : problems.start[problem + 1]]
        matches = _matches(pairs, mine, c, q, problems.resolution[problem])
        if len(matches) >= 3:
            R = rotations[number[problem]][0]
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = R, q * seen.pivot - R @ c
            found.append((T, q, matches))
    counts["candidates"] = len(found)
    return found


def _spread(seen):
    """How far the scene's facets reach from the pivot."""
    return max(float(np.linalg.norm(seen.g - seen.pivot, axis=1).max()), 1e-12)


def _scales(ratio, scale_free):
    """[(scale, reach)] to search: at most `ratio`, where the scene is as large as the model, at least a fiftieth."""
    if not scale_free:
        return [(1.0, 0.0)]
    scales = ratio * np.exp(-np.arange(SCALE_STEP, math.log(LARGEST), SCALE_STEP))
    return list(zip(scales, (math.exp(SCALE_STEP / 2) - 1) * scales, strict=True))


def _problems(seen, db, rotations, size_ok, scales):
    """(Correspondences of all rotations, kernels.Problems without resolution, (n,) which rotation), or all None."""
    large = np.flatnonzero(size_ok.any(axis=0))
    size_ok = np.ascontiguousarray(size_ok[:, large])
    parts, member, start, which, total = [], [], [0], [], 0
    for number, (R, sigma, _) in enumerate(rotations):
        made = correspondences(seen, db, R, sigma, large, size_ok)
        if made is None:
            continue
        parts.append(made)
        for q, e in scales:
            # what is seen is not larger
            fits = np.flatnonzero(((q - e) * (made.P2 - made.P1) <= made.high - made.low).all(axis=1))
            if len(fits):
                member.append(fits + total)
                start.append(start[-1] + len(fits))
                which.append((number, q, e))
        total += len(made.scene)
    if not which:
        return None, None, None
    pairs = Correspondences(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    number, scale, reach = (np.array(values) for values in zip(*which, strict=True))
    return pairs, kernels.Problems(np.concatenate(member), np.array(start), scale, reach, None), number


def _matches(pairs, mine, c, q, resolution):
    """(n, 2) scene facet, model facet: of the correspondences `mine` that hold at a place c, to its resolution, and
    scale q: facets that are surer than most hold somewhere in the box, hardly in its middle.

    Of several on one scene facet the one whose plane lies nearest.
    """
    P1, P2, low, high = pairs.P1[mine], pairs.P2[mine], pairs.low[mine], pairs.high[mine]
    scene, facet = pairs.scene[mine], pairs.facet[mine]
    x = np.einsum("cad,d->ca", pairs.A[mine], c)
    slack = 0.4 * (P1[:, :1] - P2[:, :1]).clip(0) * q + resolution * np.abs(pairs.A[mine]).sum(axis=2)
    holds = ((x + q * P1 - low >= -slack) & (high - x - q * P2 >= -slack)).all(axis=1)
    gap = np.abs(x[:, 0] + q * (P1[:, 0] + P2[:, 0]) / 2 - low[:, 0])
    nearest = {}
    for k in np.flatnonzero(holds):
        if scene[k] not in nearest or gap[k] < gap[nearest[scene[k]]]:
            nearest[scene[k]] = k
    return np.array([(s, facet[k]) for s, k in sorted(nearest.items())]).reshape(-1, 2)


def weights(seen, db, scale_free):
    """Evidence of each scene facet in nats (N,), and which facets of the model are large enough for it (N, F) bool.

    The evidence is -ln of the chance that a displacement drawn at random (its rotation right) explains the facet: the
    share of the model's box that its boxes fill. Facets in one plane share one evidence.
    """
    extent = np.sort(db.high[:, 1:] - db.low[:, 1:], axis=1)  # (F, 2) short, long
    q = 0.3 * np.linalg.norm(db.size) / _spread(seen) if scale_free else 1.0
    slack = 3 * seen.slide[:, None] + 0.06 * seen.extent
    diagonal = np.linalg.norm(extent, axis=1)
    need = np.maximum(seen.extent - 2 * slack, 0)
    size_ok = np.ones((len(seen.n), len(extent)), bool)
    if not scale_free:
        size_ok = (need[:, None, 1] <= diagonal) & (need[:, None, 0] <= extent[None, :, 0] * 1.42)
    # the box of facet f for scene facet i: thin, and as wide as the outline may slide
    wide = np.maximum(extent[None] - q * need[:, None], 0) + q * 2 * slack[:, None]
    volume = 2 * 3 * q * seen.height[:, None] * wide.prod(axis=2)
    share = np.where(size_ok, volume, 0).sum(axis=1) / np.prod(np.maximum(db.size, 0.05 * db.size.max())) / 3
    weight = np.clip(-np.log(np.maximum(share, 1e-12)), 0.3, 8.0)
    height = np.abs(np.einsum("ni,mi->nm", seen.m, seen.g) - 1) / np.sqrt(
        np.einsum("mi,nij,mj->nm", seen.g, seen.covariance, seen.g)
    )
    coplanar = (height < 3) & (height.T < 3) & (seen.n @ seen.n.T > 0.99)
    return weight / np.sqrt(np.maximum(coplanar.sum(axis=1), 1)), size_ok
