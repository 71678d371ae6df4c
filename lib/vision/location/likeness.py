"""How alike a posed photograph and another one are at the places of the model that both would show.

A diffuse surface is as bright from everywhere. So a pose may be judged by what it makes of the two photographs without
any feature: the light at places of the model, as one camera has it, against the other. Exposure may differ, and so may
lamps: it ranks poses and parts those that the model's edges cannot part, and refuses none alone.
"""

import numpy as np

from lib.buffers.index_buffer import Probe

ACROSS = 64  # places across the picture
LEAST = 100  # places that both show
FLOOR = 0.02  # display value below which darkness is alike


class Known:
    """A posed photograph: camera, photograph, and what it shows where."""

    def __init__(self, model, camera, photograph):
        self.camera, self.photograph = camera, photograph
        self.probe = Probe(model, camera)
        self.blurred = _blurred(photograph)

    def colours(self, p):
        """((n, C) log light at world places p (n, 3), (n,) bool: seen there)."""
        q = self.camera.project(p)
        inside = np.isfinite(q).all(axis=1)
        inside &= (q >= 0).all(axis=1) & (q <= [self.camera.width - 1, self.camera.height - 1]).all(axis=1)
        out = np.zeros((len(p), self.blurred.shape[2]))
        k = np.flatnonzero(inside)
        _, depth = self.probe.at(q[k])
        z = self.camera.points(p[k])[:, 2]
        inside[k] = np.abs(depth - z) < 0.01 * z
        k = np.flatnonzero(inside)
        at = np.rint(q[k]).astype(int)
        out[k] = self.blurred[at[:, 1], at[:, 0]]
        return out, inside


def _blurred(photograph):
    """(H, W, C) log of display values, smoothed over what a place of a coarse picture covers."""
    import cv2

    values = np.ascontiguousarray(np.clip(photograph.display, 0, 1), np.float32)
    sigma = values.shape[1] / ACROSS / 3
    soft = cv2.GaussianBlur(values, (0, 0), sigma).reshape(*values.shape[:2], -1)
    return np.log(soft + FLOOR)


def likeness(model, known, photograph_blurred, camera) -> float:
    """In [-1, 1], the correlation of both at shared places, the mean over photographs; 0 where too few are shared.

    known : list of Known;  photograph_blurred : of `_blurred`;  camera : the pose that is judged
    """
    step = camera.width / ACROSS
    x, y = np.meshgrid(np.arange(step / 2, camera.width - 1, step), np.arange(step / 2, camera.height - 1, step))
    q = np.column_stack([x.ravel(), y.ravel()])
    facet, depth = Probe(model, camera).at(q)
    met = (facet >= 0) & np.isfinite(depth)
    v = depth[met, None] * camera.directions(q[met])
    p = (v - camera.T_cam_world[:3, 3]) @ camera.T_cam_world[:3, :3]
    at = np.rint(q[met]).astype(int)
    own = photograph_blurred[at[:, 1], at[:, 0]]
    total = count = 0.0
    for one in known:
        theirs, seen = one.colours(p)
        if seen.sum() < LEAST:
            continue
        a, b = own[seen], theirs[seen]
        channels = min(a.shape[1], b.shape[1])
        if channels < max(a.shape[1], b.shape[1]):
            a, b = a.mean(axis=1, keepdims=True), b.mean(axis=1, keepdims=True)
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        total += len(a) * float((a * b).sum() / max(np.sqrt((a**2).sum() * (b**2).sum()), 1e-12))
        count += len(a)
    return total / count if count else 0.0


def blurred(photograph):
    """The photograph as `likeness` needs it."""
    return _blurred(photograph)
