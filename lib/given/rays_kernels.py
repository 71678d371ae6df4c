"""Compiled: points of Sobol's sequence."""

import numpy as np

from lib.core.compiled import njit

OFFSET = 1e-5  # how far a ray starts above its facet, in diagonals of the model; float32 resolves 6e-8


@njit()
def points(at, V):
    points = np.zeros((len(at), 4), np.uint32)
    for i in range(len(at)):
        left, bit = at[i], 0
        while left and bit < 32:
            if left & np.uint64(1):
                for d in range(4):
                    points[i, d] ^= V[d, bit]
            left >>= np.uint64(1)
            bit += 1
    return points
