"""Compiled: equations of the planes that may correspond."""

import numpy as np

from lib.core.compiled import njit


@njit()
def fill(n, gate, outline, start, g, tall, wide, axes, twosided, size_ok):
    """The arrays of _correspondences, all directions in the model's frame; outline, g : from the pivot."""
    most = 0
    for k in range(len(n)):
        for f in range(len(axes)):
            cosine = n[k, 0] * axes[f, 0, 0] + n[k, 1] * axes[f, 0, 1] + n[k, 2] * axes[f, 0, 2]
            most += size_ok[k, f] and (cosine > gate[k] or (cosine < -gate[k] and twosided[f]))
    scene, facet = np.empty(most, np.int64), np.empty(most, np.int64)
    A, P1, P2 = np.empty((most, 3, 3)), np.empty((most, 3)), np.empty((most, 3))
    c = 0
    for k in range(len(n)):
        for f in range(len(axes)):
            cosine = n[k, 0] * axes[f, 0, 0] + n[k, 1] * axes[f, 0, 1] + n[k, 2] * axes[f, 0, 2]
            if not (size_ok[k, f] and (cosine > gate[k] or (cosine < -gate[k] and twosided[f]))):
                continue
            scene[c], facet[c], A[c] = k, f, axes[f]
            h = A[c, 0, 0] * g[k, 0] + A[c, 0, 1] * g[k, 1] + A[c, 0, 2] * g[k, 2]
            P1[c, 0], P2[c, 0] = h + tall[k], h - tall[k]
            for a in (1, 2):
                least, largest = np.inf, -np.inf
                for p in range(start[k], start[k + 1]):
                    x = A[c, a, 0] * outline[p, 0] + A[c, a, 1] * outline[p, 1] + A[c, a, 2] * outline[p, 2]
                    least, largest = min(least, x), max(largest, x)
                slack = wide[k] + 0.03 * (largest - least)
                P1[c, a], P2[c, a] = least + slack, largest - slack
            c += 1
    return scene, facet, A, P1, P2
