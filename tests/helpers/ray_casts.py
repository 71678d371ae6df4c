"""What a ray meets first among a few faces, by brute force: to compare parts of a model with a renderer's answers."""

import numpy as np


def hits(parts, rays):
    """[(point (3,), unit normal (3,)) or None] for each (origin, direction).  parts : [(_, _, points, convex faces)]"""
    rows = [(p[f[0]], p[f[k]], p[f[k + 1]]) for _, _, p, faces in parts for f in faces for k in range(1, len(f) - 1)]
    a, b, c = np.array(rows, float).transpose(1, 0, 2)
    found = []
    for origin, direction in np.array(rays, float):
        cross = np.cross(direction, c - a)
        with np.errstate(all="ignore"):
            det = ((b - a) * cross).sum(1)
            u = ((origin - a) * cross).sum(1) / det
            q = np.cross(origin - a, b - a)
            v, t = (q @ direction) / det, (q * (c - a)).sum(1) / det
            inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 1e-6)
        if not inside.any():
            found.append(None)
            continue
        k = np.flatnonzero(inside)[t[inside].argmin()]
        normal = np.cross(b[k] - a[k], c[k] - a[k])
        found.append((origin + t[k] * direction, normal / np.linalg.norm(normal)))
    return found
