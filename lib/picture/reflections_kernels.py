"""Compiled: light of neighbouring pixels that show the same thing in a mirror."""

import numpy as np

from lib.core.compiled import njit


@njit()
def beside(values, label, wanted, y, x):
    """The mean of the 3 x 3 pixels' values that bear the wanted label, and whether there is one."""
    H, W, C = values.shape
    out = np.zeros((len(y), C))
    found = np.zeros(len(y), np.bool_)
    for i in range(len(y)):
        n = 0
        for b in range(max(y[i] - 1, 0), min(y[i] + 1, H - 1) + 1):
            for a in range(max(x[i] - 1, 0), min(x[i] + 1, W - 1) + 1):
                if label[b, a] == wanted[i]:
                    n += 1
                    for c in range(C):
                        out[i, c] += values[b, a, c]
        if n > 0:
            found[i] = True
            for c in range(C):
                out[i, c] /= n
    return out, found
