"""Rotations that turn pairs of facets onto pairs of the model's directions."""

import math

import numpy as np

from lib.vision.recognition import rotations_kernels as kernels

# Rotations.


def directions(db, most=60):
    """(D, 3) distinct directions that facets face, both sides of those that have two, the largest areas first."""
    area = db.model.facet_area()
    n = np.concatenate([db.axes[:, 0], -db.axes[db.twosided, 0]])
    area = np.concatenate([area, area[db.twosided]])
    order = np.argsort(-area, kind="stable")
    n, found = n[order], []
    while len(n) and len(found) < most:
        found.append(n[0])
        n = n[n @ n[0] < math.cos(0.005)]
    return np.array(found)


def candidate_rotations(seen, directions, most=200, tried=20000):
    """Rotations, world to camera, that bring normals together: [(R, sigma rad, evidence)], the most evidence first.

    seen : hashing.Seen; directions : (D, 3); most : that are returned; tried : pairs of pairs
    The evidence of a normal that meets one of the model's directions is -ln of the chance that any normal does.
    """
    gate = np.minimum(3 * seen.angle + 0.03, 0.6)
    evidence = np.maximum(-np.log(len(directions) * (1 - np.cos(gate)) / 2), 0)
    R = _of_pairs(seen, directions, tried)
    if len(R) == 0:
        return []
    score = kernels.support(R, seen.n, directions, np.cos(gate), evidence)
    R = R[np.argsort(-score, kind="stable")]
    found = [
        (refined, sigma, float(evidence[fits].sum())) for refined, sigma, fits in _distinct(R, seen, directions, most)
    ]
    return sorted(found, key=lambda f: -f[2])


def _of_pairs(seen, directions, tried):
    """(n, 3, 3): rotations that turn two facets onto two directions with the same angle between, sure pairs first."""
    i, j = np.triu_indices(len(seen.n), 1)
    cosine = np.einsum("ij,ij->i", seen.n[i], seen.n[j])
    tolerance = 3 * np.hypot(seen.angle[i], seen.angle[j]) + 0.005
    use = (np.abs(cosine) < math.cos(0.3)) & (tolerance < 0.35)
    i, j, cosine, tolerance = i[use], j[use], cosine[use], tolerance[use]
    model_angle = np.arccos(np.clip(directions @ directions.T, -1, 1))
    pairs, number = [], 0
    for k in np.argsort(tolerance, kind="stable"):
        a, b = np.nonzero((np.abs(model_angle - math.acos(cosine[k])) < tolerance[k]) & (np.sin(model_angle) > 0.15))
        pairs.append(np.stack([np.full(len(a), k), a, b]))
        number += len(a)
        if number > tried:
            break
    if number == 0:
        return np.zeros((0, 3, 3))
    k, a, b = np.concatenate(pairs, axis=1)
    return _frames(seen.n[i[k]], seen.n[j[k]]) @ _frames(directions[a], directions[b]).transpose(0, 2, 1)


def _distinct(R, seen, directions, most):
    """(R, sigma, fits) of at most so many rotations (n, 3, 3), refined, one of those that are alike."""
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(R).as_quat()
    left = np.ones(len(R), bool)
    kept = np.zeros((0, 3, 3))
    for k in range(len(R)):
        if not left[k]:
            continue
        left &= np.abs(quaternion @ quaternion[k]) < math.cos(0.04 / 2)
        refined, sigma, fits = kernels.aligned(R[k], seen.n, seen.angle, directions)
        if not sigma < 0.2:
            continue
        if (np.einsum("ij,kij->k", refined, kept) > 1 + 2 * math.cos(0.02)).any():
            continue
        kept = np.concatenate([kept, refined[None]])
        yield refined, sigma, fits
        if len(kept) == most:
            break


def _frames(a, b):
    """(..., 3, 3): orthonormal frames, as columns, from two directions each; both share the error of the angle."""
    c = np.cross(a, b)
    c = c / np.linalg.norm(c, axis=-1, keepdims=True)
    s = a / np.linalg.norm(a, axis=-1, keepdims=True) + b / np.linalg.norm(b, axis=-1, keepdims=True)
    s = s / np.linalg.norm(s, axis=-1, keepdims=True)
    return np.stack([s, c, np.cross(s, c)], axis=-1)


def kabsch(a, b, weight):
    """The rotation R (det +1: never a reflection) that minimises sum weight |b - R a|^2. Kabsch 1976, Horn 1987.

    a, b : (n, 3)

    >>> R = kabsch(np.eye(3), np.eye(3)[[1, 2, 0]], np.ones(3))
    >>> (R @ np.eye(3)[0]).round(9) + 0.0
    array([0., 1., 0.])
    """
    u, _, vt = np.linalg.svd((weight[:, None] * b).T @ a)
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
