"""Compiled: the equations that texture gives for a plane."""

import numpy as np

from lib.core.compiled import njit


@njit()
def texture_rows(plane, u0, v0, pixels, u, v, left, slope, right, labels, wanted, least, f, R, K, gain, offset, rows):
    """Per pixel and channel with a slope of at least `least`: coefficients of (a, b, c); left value; channel; residual; x, y. Their number.

    residual = right(where the plane takes the pixel) - gain left - offset; its slope is taken from the left photograph, whose noise
    is not the right one's: a slope and a residual with noise in common would agree by themselves.
    """
    height, width, channels = right.shape
    n = 0
    for k in range(len(pixels)):
        y, x = pixels[k] // u.shape[1], pixels[k] % u.shape[1]
        du, dv = u[y, x] - u0, v[y, x] - v0
        d0, d1 = (u[y, x] - (plane[0] * du + plane[1] * dv + plane[2])) / f, v[y, x] / f
        z = R[0, 2] * d0 + R[1, 2] * d1 + R[2, 2]
        if z <= 0:
            continue
        qx = K[0, 0] * (R[0, 0] * d0 + R[1, 0] * d1 + R[2, 0]) / z + K[0, 2]
        qy = K[1, 1] * (R[0, 1] * d0 + R[1, 1] * d1 + R[2, 1]) / z + K[1, 2]
        ix, iy = int(np.floor(qx)), int(np.floor(qy))
        if ix < 1 or iy < 1 or ix >= width - 2 or iy >= height - 2:
            continue
        fx, fy = qx - ix, qy - iy
        if labels[iy + (fy > 0.5), ix + (fx > 0.5)] != wanted:
            continue
        for c in range(channels):
            if abs(slope[y, x, c]) < least:
                continue
            value = 0.0
            for j in range(4):  # Catmull and Rom's cubic
                wy = (
                    0.5 * fy * (-1 + fy * (2 - fy)),
                    1 + fy * fy * (1.5 * fy - 2.5),
                    0.5 * fy * (1 + fy * (4 - 3 * fy)),
                    0.5 * fy * fy * (fy - 1),
                )[j]
                for i in range(4):
                    wx = (
                        0.5 * fx * (-1 + fx * (2 - fx)),
                        1 + fx * fx * (1.5 * fx - 2.5),
                        0.5 * fx * (1 + fx * (4 - 3 * fx)),
                        0.5 * fx * fx * (fx - 1),
                    )[i]
                    value += wy * wx * right[iy - 1 + j, ix - 1 + i, c]
            s = -gain[c] * slope[y, x, c] / (1 - plane[0])
            rows[n, 0], rows[n, 1], rows[n, 2] = s * du, s * dv, s
            rows[n, 3], rows[n, 4] = left[y, x, c], c
            rows[n, 5], rows[n, 6], rows[n, 7] = value - gain[c] * left[y, x, c] - offset[c], x, y
            n += 1
    return n
