"""What rays meet first, polygon by polygon in NumPy: slow, clear, and independent of all other ray casters."""

import numpy as np

from lib.synthetic.optics import directions


def first_polygon(polygons, eye, d) -> tuple:
    """What rays from eye (N, 3) along d (N, 3) meet first: (distance in |d|, number of the polygon or -1).

    Polygons are convex, and both their sides count.
    """
    nearest, number = np.full(len(d), np.inf), np.full(len(d), -1)
    eye = np.broadcast_to(np.asarray(eye, float), d.shape)
    for i, polygon in enumerate(polygons):
        corners, n = polygon.points, polygon.normal()
        with np.errstate(divide="ignore", invalid="ignore"):
            s = ((corners[0] - eye) @ n) / (d @ n)
        ray = np.flatnonzero((s > 1e-7) & (s < nearest))
        at = eye[ray] + s[ray, None] * d[ray]
        inside = np.ones(len(ray), bool)
        for corner, edge in zip(corners, np.roll(corners, -1, 0) - corners, strict=True):
            inside &= (at - corner) @ np.cross(n, edge) >= 0
        nearest[ray[inside]], number[ray[inside]] = s[ray[inside]], i
    return nearest, number


def coarse_view(polygons, K, size, T_cam_world, step) -> tuple:
    """(numbers of the polygons, points (n, 3) m) that every `step`-th pixel of every `step`-th row shows."""
    d = directions(K, size, T_cam_world)[step // 2 :: step, step // 2 :: step].reshape(-1, 3)
    eye = np.linalg.inv(T_cam_world)[:3, 3]
    distance, number = first_polygon(polygons, eye, d)
    return number, eye + np.where(number >= 0, distance, 0)[:, None] * d
