"""Motions that bring a model onto itself, wholly or nearly: poses that look alike.

    for motion in motions(model):
        motion.T, motion.share, motion.is_exact

A motion takes each facet onto one of the same size and shape of placement. The largest facet and the largest that is
not parallel to it may go to any pair that stands to each other as they do; each such pair fixes a motion.
"""

from typing import NamedTuple

import numpy as np

NEARLY = 0.5  # of the area, the least that goes onto itself
ALIKE, ALIKE_RAD = 1e-3, 1e-3  # of the model's size, and of areas; of normals
MOST_TWINS = 1000  # of the largest facet: a sphere of small ones has as many motions as facets, and none is looked at
NEAR = 8  # facets at one place that are compared


class Motion(NamedTuple):
    """T : (4, 4) world to world;  share : of the area that goes onto itself;  is_exact : all of it, group by group"""

    T: np.ndarray
    share: float
    is_exact: bool


def motions(model) -> list[Motion]:
    """The turns and moves, other than none, that bring at least half of the model's area onto itself; no mirroring.

    model : lib.given.model.Model
    """
    area, middle, normal = model.facet_area(), _middles(model), model.facet_normal
    size = np.linalg.norm(np.ptp(model.vertices[np.unique(model.triangles)], axis=0))
    first = int(area.argmax())
    aside = np.linalg.norm(np.cross(normal, normal[first]), axis=1) > 0.3
    if not aside.any():
        return []
    second = int(np.where(aside, area, 0).argmax())
    like = lambda f: np.flatnonzero(np.abs(area - area[f]) <= ALIKE * area[f])
    apart, angle = np.linalg.norm(middle[first] - middle[second]), normal[first] @ normal[second]
    frame, found = _frame(normal[first], normal[second]), []
    firsts, seconds = like(first), like(second)
    if len(firsts) > MOST_TWINS:
        return []
    for a in firsts:
        angles, aparts = normal[seconds] @ normal[a], np.linalg.norm(middle[seconds] - middle[a], axis=1)
        for b in seconds[(np.abs(angles - angle) <= ALIKE_RAD) & (np.abs(aparts - apart) <= ALIKE * size)]:
            R = _frame(normal[a], normal[b]).T @ frame
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = R, middle[a] - R @ middle[first]
            there = middle[second] @ R.T + T[:3, 3]
            if np.linalg.norm(there - middle[b]) > ALIKE * size or np.allclose(T, np.eye(4), atol=ALIKE):
                continue
            share, exact = _onto_itself(model, T, area, middle, size)
            if share >= NEARLY:
                found.append(Motion(T, share, exact))
    return found


def _middles(model):
    """(F, 3) m: of each facet's area."""
    area = model.triangle_normals()[1]
    weighted = area[:, None] * model.corners().mean(axis=1)
    total = np.stack([np.bincount(model.triangle_facet, w, model.n_facets) for w in weighted.T], axis=1)
    return total / np.maximum(model.facet_area(), 1e-300)[:, None]


def _frame(n, m):
    """(3, 3) rows: n, across both, across these."""
    across = np.cross(n, m)
    across /= np.linalg.norm(across)
    return np.stack([n, across, np.cross(n, across)])


def _onto_itself(model, T, area, middle, size):
    """(share of the area whose facets go onto others, whether all of the model does with its groups)."""
    from scipy.spatial import cKDTree

    R, t, normal, group = T[:3, :3], T[:3, 3], model.facet_normal, model.facet_group
    far, near = cKDTree(middle).query(middle @ R.T + t, k=range(1, min(NEAR, model.n_facets) + 1))  # (F, k)
    alike = (far <= ALIKE * size) & (np.abs(area[:, None] - area[near]) <= ALIKE * area[:, None])
    alike &= np.einsum("fi,fki->fk", normal @ R.T, normal[near]) > 1 - ALIKE_RAD
    same = (alike & (group[:, None] == group[near])).any(axis=1)
    used = model.vertices[np.unique(model.triangles)]
    moved = cKDTree(used).query(used @ R.T + t)[0].max()
    return float(area[alike.any(axis=1)].sum() / area.sum()), bool(same.all() and moved <= ALIKE * size)
