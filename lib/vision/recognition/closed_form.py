"""The pose of given correspondences between facets and planes of the model, in closed form, and refined."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from lib.given.cameras import matrix_from_rt
from lib.vision.recognition.rotations import kabsch

GATE = 21.1  # chi-square of 3 degrees of freedom, 99.99 %
DISTINCT_RAD = 0.05  # poses that differ by more than this, or by DISTINCT of the scene's depth, are different answers
DISTINCT = 0.05


# Results.


@dataclass(frozen=True, eq=False)
class Pose:
    """A displacement of the model, and how well it explains the facets.

    T : (4, 4)                  T_cam_world, metres
    scale : m per unit of the facets
    covariance : (6, 6) or (7, 7)   of (omega, tau[, ln scale]): T = exp(omega, tau) T_hat, camera axes, rad and m
                                until recognise.py inverts it: the normal matrix
    matches : (n, 2) int        scene facet, model facet
    score : evidence in nats: what the matches' chance would have been
    chi2 : of the matches, 3 for each expected
    vertex_m : root mean square distance of the outlines' corners to the nearest corner of their facets, metres
    """

    T: np.ndarray
    scale: float
    covariance: np.ndarray
    matches: np.ndarray
    score: float
    chi2: float
    vertex_m: float
    linear: np.ndarray = field(default=None, repr=False)  # T after the closed form


# From a place to a pose.


def closed_form(m, covariance, n_world, offset, g, scale_free=False):
    """Pose from planes in closed form: (T_cam_world, scale). The paper's linear step.

    m, covariance, g : of the scene's planes and a point on each;  n_world, offset : of the model's, facing the camera.
    Rotation by Kabsch on the normals. Then translation (and scale) by weighted linear least squares on the points'
    heights: n . (q R^T g + c) = offset, with c the camera's centre.
    """
    d = 1 / np.linalg.norm(m, axis=1)
    n = -m * d[:, None]
    P = np.eye(3) - n[:, :, None] * n[:, None, :]
    angle2 = d**2 * np.linalg.eigvalsh(P @ covariance @ P)[:, -1]
    R = kabsch(n_world, n, 1 / angle2)
    height = d * np.sqrt(np.einsum("ni,nij,nj->n", g, covariance, g))
    M = np.column_stack([n_world, np.einsum("ni,ni->n", n_world, g @ R)]) / height[:, None]
    if scale_free:
        x = np.linalg.lstsq(M, offset / height, rcond=1e-9)[0]
        c, q = x[:3], float(x[3])
    else:
        c, q = np.linalg.lstsq(M[:, :3], offset / height - M[:, 3], rcond=1e-9)[0], 1.0
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -R @ c
    return T, q


def _fit(seen, db, T, q, scene_idx, facet_idx, scale_free, iterations=8):
    """Gauss-Newton on the planes' m = n q / d under their covariances.

    Returns T, q, the normal matrix (6, 6) or (7, 7), and chi2 (n,) of the matches.
    """
    n_w, o = db.axes[facet_idx, 0], db.low[facet_idx, 0]
    L = np.linalg.inv(np.linalg.cholesky(seen.covariance[scene_idx]))
    m = seen.m[scene_idx]
    size = 7 if scale_free else 6

    def residual(T, q):
        n = n_w @ T[:3, :3].T
        d = o + n @ T[:3, 3]
        d = np.where(np.abs(d) < 1e-9, 1e-9, d)
        return n, d, np.einsum("nij,nj->ni", L, m - n * (q / d)[:, None])

    n, d, r = residual(T, q)
    damping = 0.0
    for _ in range(iterations):
        J = np.zeros((len(m), 3, size))
        p = n * (q / d)[:, None]
        for k in range(3):
            w = np.zeros(3)
            w[k] = 1
            J[:, :, k] = -np.cross(w, n) * (q / d)[:, None]
            J[:, :, 3 + k] = p * (n[:, k] / d)[:, None]
        if scale_free:
            J[:, :, 6] = -p
        J = np.einsum("nij,njk->nik", L, J).reshape(-1, size)
        H, b = J.T @ J, J.T @ r.ravel()
        step = -np.linalg.lstsq(H + damping * np.diag(np.diag(H)), b, rcond=1e-12)[0]
        if not np.isfinite(step).all():
            break
        T_new, q_new = moved(T, step), q * math.exp(min(max(step[6], -1), 1)) if scale_free else q
        n_new, d_new, r_new = residual(T_new, q_new)
        if (r_new**2).sum() > (r**2).sum():
            damping = max(10 * damping, 1e-3)
            continue
        small = (r**2).sum() - (r_new**2).sum() < 1e-6 * max((r**2).sum(), 1e-12)
        T, q, n, d, r, damping = T_new, q_new, n_new, d_new, r_new, damping / 10
        if small:
            break
    return T, q, H, (r**2).sum(axis=1)


def moved(T, step):
    """exp(omega, tau) T: a pose turned by omega (rad) about the camera's axes, then moved by tau (m) along them."""
    return matrix_from_rt(np.asarray(step[:6], float)) @ T


def explained(seen, db, T, q, share=0.55):
    """What the camera would see: (matches (n, 2), fraction (N,)).

    A scene facet is explained where the rays through its region meet the model at the depth that its plane has, within
    3.5 sigma; the facet met most often is its match.
    """
    rays = _looked(seen, db, T, q)
    fraction = rays.share_of(rays.agrees)
    matches = []
    for i in np.flatnonzero(fraction >= share):
        matches.append((i, np.bincount(rays.facet[(rays.owner == i) & rays.agrees]).argmax()))
    return np.array(matches, int).reshape(-1, 2), fraction


def contradicted(seen, db, T, q, share=0.55):
    """(N,) bool: which scene facets lie where they cannot lie if the model is all there is.

    Through most of its region the model is met, but elsewhere: before or behind the facet by more than 3.5 sigma, and
    by more than a fiftieth of the depth. What lies beside the model contradicts nothing.
    """
    rays = _looked(seen, db, T, q)
    return rays.share_of(rays.denies) >= share


class _Looked(NamedTuple):
    """What R rays through the scene's facets meet: whose each is, the facet of the model, the verdicts."""

    number: np.ndarray  # (N,) rays of each scene facet
    owner: np.ndarray
    facet: np.ndarray
    agrees: np.ndarray
    denies: np.ndarray

    def share_of(self, which):
        """(N,) share of each scene facet's rays."""
        return np.bincount(self.owner, which, len(self.number)) / np.maximum(self.number, 1)


def _looked(seen, db, T, q) -> _Looked:
    """The rays through all regions, as the camera at T (4, 4) would look along them."""
    R, centre = T[:3, :3], -T[:3, :3].T @ T[:3, 3]
    count = np.array([len(v) for v in seen.v], int)
    if count.sum() == 0:
        none = np.zeros(0, int)
        return _Looked(count, none, none, none.astype(bool), none.astype(bool))
    v = np.concatenate(seen.v)
    v_world = v @ R
    length = np.linalg.norm(v_world, axis=1)
    rays = np.empty((len(v), 6), np.float32)
    rays[:, :3] = (centre + db.centre - db.local.centre) / db.local.diagonal
    rays[:, 3:] = v_world / length[:, None]
    triangle, distance = db.caster.closest(rays)
    hit = triangle >= 0
    facet = np.where(hit, db.model.triangle_facet[triangle], -1)
    inverse = (
        np.where(hit, length / np.maximum(np.where(hit, distance, 1) * db.local.diagonal, 1e-12), 0) * q
    )  # 1/z in units of the facets
    expected, sigma = np.concatenate(seen.inverse), np.concatenate(seen.sigma)
    turned = np.einsum("ij,ij->i", db.axes[facet, 0], v_world) < 0
    owner = np.repeat(np.arange(len(count)), count)
    cosine = np.abs(np.einsum("ij,ij->i", db.axes[facet, 0], seen.n[owner] @ R))
    aligned = cosine > np.cos(np.minimum(3.5 * seen.angle + 0.02, 0.7))[owner]
    off = np.abs(inverse - expected)
    agrees = hit & (off < 3.5 * sigma + 0.002 * expected) & (turned | db.twosided[facet]) & aligned
    return _Looked(count, owner, facet, agrees, hit & (off > 3.5 * sigma + 0.02 * expected))


def _facing(db, T, facets):
    """+1 where the front faces the camera at T, else -1: (n,)."""
    centre = -T[:3, :3].T @ T[:3, 3]
    return np.where(db.low[facets, 0] - db.axes[facets, 0] @ centre < 0, 1.0, -1.0)


def polish(seen, db, weight, T, q, pairs, scale_free):
    """From a candidate to a Pose, in coordinates about db.centre, or None where it does not hold.

    seen : hashing.Seen; db : hashing.Database; weight : (N,) nats; T, q : (4, 4), scale; pairs : (n, 2) its matches
    """
    facets = pairs[:, 1]
    turn = _facing(db, T, facets)
    linear, q_linear = closed_form(
        seen.m[pairs[:, 0]],
        seen.covariance[pairs[:, 0]],
        turn[:, None] * db.axes[facets, 0],
        turn * db.low[facets, 0],
        seen.g[pairs[:, 0]],
        scale_free,
    )
    if not (np.isfinite(linear).all() and q_linear > 0):
        return None
    # The closed form is the start unless it is worse posed than the search's own place (two facets, say).
    T, q = (linear, q_linear) if _well_posed(db, pairs) else (T, q)
    for _ in range(3):
        T, q, _, _ = _fit(seen, db, T, q, pairs[:, 0], pairs[:, 1], scale_free)
        matches, fraction = explained(seen, db, T, q)
        if len(matches) < 2:
            return None
        same = len(matches) == len(pairs) and (matches == pairs).all()
        pairs = matches
        if same:
            break
    T, q, H, chi2 = _fit(seen, db, T, q, pairs[:, 0], pairs[:, 1], scale_free)
    good = chi2 < GATE
    if good.sum() < 2:
        return None
    if not good.all():
        pairs = pairs[good]
        T, q, H, chi2 = _fit(seen, db, T, q, pairs[:, 0], pairs[:, 1], scale_free)
        fraction = explained(seen, db, T, q)[1]
        keep = (chi2 < GATE) & (fraction[pairs[:, 0]] >= 0.5)
        pairs, chi2 = pairs[keep], chi2[keep]
        if len(pairs) < 2:
            return None
    evidence = weight[pairs[:, 0]] * np.minimum(1, fraction[pairs[:, 0]] / 0.9) - np.maximum(chi2 - 3, 0) / 2
    distance = [_corner_distance(seen.outline[i], db.corners(f), T, q) for i, f in pairs]
    return Pose(
        T,
        q,
        H,
        pairs,
        float(np.maximum(evidence, 0).sum()),
        float(chi2.sum()),
        float(np.sqrt(np.mean(np.square(distance)))),
        linear,
    )


def _well_posed(db, pairs):
    """Do the normals of these matches span space?"""
    return np.linalg.svd(db.axes[pairs[:, 1], 0], compute_uv=False)[-1] > 0.1 if len(pairs) >= 3 else False


def _corner_distance(outline, corners, T, q):
    """Root mean square m of the outline's corners (k, 3) to the nearest of the facet's (n, 3), world."""
    if len(corners) == 0:
        return 0.0
    p = corners @ T[:3, :3].T + T[:3, 3]
    gap = np.linalg.norm(q * outline[:, None] - p[None], axis=2)
    return np.sqrt(np.mean(np.minimum(gap.min(axis=1), np.ptp(p, axis=0).max()) ** 2))
