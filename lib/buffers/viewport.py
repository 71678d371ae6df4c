"""A camera and a model, scaled so that single precision suffices: where both ways of drawing index buffers begin."""

from dataclasses import dataclass

import numpy as np

NEAR = 1e-6  # of the distance of the furthest vertex; nothing nearer is seen
TIE = 4e-7  # float32's rounding, and a little, in 1 / z


@dataclass(frozen=True, eq=False)
class Viewport:
    """The N triangles that can be seen, in drawing order: of two at the same depth the later one wins."""

    p: np.ndarray  # (N, 3, 3) camera frame, the furthest at 1
    slope: np.ndarray  # (N, 3): 1/z = slope . (x, y, 1) on the plane
    low: np.ndarray  # (N,) least 1/z on the triangle
    high: np.ndarray  # (N,) largest 1/z
    triangle: np.ndarray  # (N,) int, into the model
    unit: float  # m, the length that became 1


def viewport_of(model, camera) -> Viewport:
    """The triangles of a model before a camera; those seen exactly edge-on are left out."""
    p = camera.points(model.vertices)[model.triangles]
    unit = np.abs(p).max() if p.size else 1.0
    p = p / unit
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    height = np.einsum("ij,ij->i", normal, p.mean(axis=1))  # < 0: its front faces the camera
    length = np.linalg.norm(normal, axis=1)
    keep = np.flatnonzero((np.abs(height) > 1e-14 * length) & (p[..., 2].max(axis=1) > NEAR))
    order = np.lexsort((model.triangle_facet[keep], height[keep] < 0))
    triangle = keep[order]
    p, z = p[triangle], p[triangle][..., 2]
    low = 1 / z.max(axis=1)
    high = 1 / np.maximum(z.min(axis=1), NEAR)
    return Viewport(p, normal[triangle] / height[triangle, None], low, high, triangle, unit)
