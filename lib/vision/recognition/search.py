"""For one rotation, the translations that explain most: branch and bound over boxes."""

import math

import numpy as np

from lib.vision.recognition import search_kernels as kernels
from lib.vision.recognition.hashing import correspondences

SCALE_STEP = 0.08  # ln; the scales are searched in steps
MOST_NODES = 2_000_000  # some seconds


def candidates(seen, db, rotations, weight, size_ok, scale_free, margin, counts):
    """The displacements (T, scale, matches (n, 2)) whose bound comes within margin of the best, best first. Fills in counts.

    counts["chance"] : so many displacements could have been told apart, so much evidence is found by chance: three facets put a scene anywhere.
    """
    extent = float(np.linalg.norm(db.size))
    spread = max(float(np.linalg.norm(seen.g - seen.pivot, axis=1).max()), 1e-12)
    # the scale: the scene is at most as large as the model, and at least a fiftieth of it
    scales = extent / spread * np.exp(-np.arange(SCALE_STEP, math.log(50), SCALE_STEP)) if scale_free else np.ones(1)
    reach = (math.exp(SCALE_STEP / 2) - 1 if scale_free else 0.0) * scales
    large = np.flatnonzero(size_ok.any(axis=0))
    size_ok = np.ascontiguousarray(size_ok[:, large])
    parts, member, start, which, total = [], [], [0], [], 0
    for number, (R, sigma, _) in enumerate(rotations):
        made = correspondences(seen, db, R, sigma, large, size_ok)
        if made is None:
            continue
        i, f, A, P1, P2, low, high = made
        parts.append(made)
        for q, e in zip(scales, reach):
            fits = np.flatnonzero(((q - e) * (P2 - P1) <= high - low).all(axis=1))  # what is seen is not larger
            if len(fits):
                member.append(fits + total)
                start.append(start[-1] + len(fits))
                which.append((number, q, e))
        total += len(i)
    counts["correspondences"], counts["chance"] = start[-1], 0.0
    if not which:
        return []
    i, f, A, P1, P2, low, high = (np.concatenate(arrays) for arrays in zip(*parts))
    which = np.array(which)
    thin = 3 * np.median(seen.height) * (0.3 * extent / spread if scale_free else 1.0)
    counts["chance"] = round(float(np.log(len(which)) + np.log(np.maximum(db.size / (2 * thin), 1)).sum()), 1)
    resolution = np.maximum(0.4 * which[:, 1] * np.median(P1[:, 0] - P2[:, 0]) / 2, 1e-6 * extent)
    problem, places, scores, counts["nodes"] = kernels.search(
        i,
        A,
        P1,
        P2,
        low,
        high,
        np.concatenate(member),
        np.array(start),
        which[:, 1].copy(),
        which[:, 2].copy(),
        weight,
        db.size / 2 + 0.25 * extent,
        spread,
        resolution,
        margin,
        MOST_NODES,
    )
    counts["complete"] = bool(counts["nodes"] < MOST_NODES)
    found = []
    for k in [k for k in np.argsort(-scores, kind="stable") if scores[k] >= scores.max() - margin][:150]:
        R, place, q, mine = rotations[int(which[problem[k], 0])][0], places[k], places[k, 3], member[problem[k]]
        x = np.einsum("cad,d->ca", A[mine], place[:3])
        slack = 0.4 * (P1[mine, :1] - P2[mine, :1]).clip(0) * q
        holds = ((x + q * P1[mine] - low[mine] >= -slack) & (high[mine] - x - q * P2[mine] >= -slack)).all(axis=1)
        gap = np.abs(x[:, 0] + q * (P1[mine, 0] + P2[mine, 0]) / 2 - low[mine, 0])
        nearest = {}
        for c in np.flatnonzero(holds):
            if i[mine[c]] not in nearest or gap[c] < gap[nearest[i[mine[c]]]]:
                nearest[i[mine[c]]] = c
        if len(nearest) >= 3:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = R, q * seen.pivot - R @ place[:3]
            found.append((T, q, np.array([(s, f[mine[c]]) for s, c in sorted(nearest.items())])))
    counts["candidates"] = len(found)
    return found


def weights(seen, db, scale_free):
    """Evidence of each scene facet in nats, and which model facets are large enough for it (N, F).

    -ln of the chance that a displacement drawn at random (its rotation right) explains the facet: the share of the model's box
    that its boxes fill. Facets in one plane share one evidence.
    """
    extent = np.sort(db.high[:, 1:] - db.low[:, 1:], axis=1)  # (F, 2) short, long
    spread = max(float(np.linalg.norm(seen.g - seen.pivot, axis=1).max()), 1e-12)
    q = 0.3 * np.linalg.norm(db.size) / spread if scale_free else 1.0
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
