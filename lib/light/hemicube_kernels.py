"""Compiled: what the pixels of hemicubes show, summed patch by patch."""

import numpy as np

from lib.core.compiled import njit, prange


@njit(parallel=True)
def binned(
    shown,
    eye,
    frames,
    points,
    directions,
    delta,
    normal,
    origin,
    axes,
    size,
    inside,
    table_start,
    table_shape,
    leaf,
    columns,
):
    """Sum of the delta factors per patch (k, N), and of what starts inside a solid and what meets no patch (k,): the mean of
    `points` hemicubes for each row."""
    m = len(eye) // points
    out = np.zeros((m, columns))
    dropped = np.zeros(m)
    lost = np.zeros(m)
    for row in prange(m):
        for i in range(row * points, (row + 1) * points):
            x, y, n = frames[i, 0], frames[i, 1], frames[i, 2]
            for k in range(len(delta)):
                if shown[i, k] < 0:
                    continue
                f = int(shown[i, k])
                facing, height = 0.0, 0.0
                d = np.empty(3)
                for c in range(3):
                    d[c] = directions[k, 0] * x[c] + directions[k, 1] * y[c] + directions[k, 2] * n[c]
                    facing += d[c] * normal[f, c]
                    height += (origin[f, c] - eye[i, c]) * normal[f, c]
                s = 2 * f + (1 if height > 0 else 0)
                if inside[s]:
                    dropped[row] += delta[k] / points
                    continue
                if table_start[s] < 0:
                    lost[row] += delta[k] / points
                    continue
                t = height / facing if facing != 0 else 0.0
                u, v = 0.0, 0.0
                for c in range(3):
                    p = eye[i, c] + t * d[c] - origin[f, c]
                    u += p * axes[f, 0, c]
                    v += p * axes[f, 1, c]
                nu, nv = table_shape[s, 0], table_shape[s, 1]
                a = min(max(int(u / size[f, 0] * nu), 0), nu - 1)
                b = min(max(int(v / size[f, 1] * nv), 0), nv - 1)
                patch = leaf[table_start[s] + a * nv + b]
                for da in range(-1, 2):  # a pixel on a slanted border: the next cell inside
                    for db in range(-1, 2):
                        if patch < 0 and 0 <= a + da < nu and 0 <= b + db < nv:
                            patch = leaf[table_start[s] + (a + da) * nv + b + db]
                if patch >= 0:
                    out[row, patch] += delta[k] / points
                else:
                    lost[row] += delta[k] / points
    return out, dropped, lost
