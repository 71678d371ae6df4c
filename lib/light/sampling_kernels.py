"""Compiled: what all kernels of rays share: scrambled numbers, and directions over a hemisphere."""

import numpy as np

from lib.core.compiled import njit


@njit(inline="always")
def scrambled(word, shift):
    """A number in (0, 1) from a word of the sequence and an element's digital shift, both uint32."""
    return ((word ^ shift) + 0.5) / 4294967296.0


@njit(inline="always")
def cosine(u, v, n, x, y, out, k):
    """Write into row k of out (m, 6) a direction about the normal n, cosine-distributed for uniform (u, v)."""
    r = np.sqrt(u)
    phi = 2 * np.pi * v
    a, b, c = r * np.cos(phi), r * np.sin(phi), np.sqrt(max(0.0, 1 - u))
    for d in range(3):
        out[k, 3 + d] = a * x[d] + b * y[d] + c * n[d]
