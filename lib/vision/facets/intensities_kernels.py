"""Compiled: the equations that texture gives for a plane."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit

# The columns of a table of pixels' equations. 0 to 2 are the coefficients of (a, b, c).
LEFT = 3  # value in the left photograph
CHANNEL = 4
RESIDUAL = 5
X, Y = 6, 7  # px, of the left photograph
COLUMNS = 8


class LevelArrays(NamedTuple):
    """Both photographs, smoothed: (H, W, C)."""

    left: np.ndarray
    slope: np.ndarray  # of the left one, along the epipolar lines, per rectified px
    right: np.ndarray
    least: float  # slopes below it say nothing

    def quieter(self, factor):
        """With a noise that is `factor` times as large."""
        return self._replace(least=factor * self.least)


@njit()
def texture_rows(plane, centre, pixels, level, left_view, right_view, wanted, f_px, light, rows):
    """The equations of each pixel and channel with a slope of at least level.least; returns their number.

    residual = right(where the plane takes the pixel) - gain left - offset. Its slope is taken from the left photograph,
    whose noise is not the right one's: a slope and a residual with noise in common would agree by themselves.

    plane : (a, b, c) at the centre (u, v);  pixels : (n,) flat
    left_view, right_view : matching's ViewArrays;  wanted : label in the right one
    light : gain (C,), offset (C,)
    rows : (n C, COLUMNS), out
    """
    u0, v0 = centre
    u, v, R, K = left_view.u, left_view.v, right_view.R, right_view.K
    left, slope, right = level.left, level.slope, level.right
    gain, offset = light
    height, width, channels = right.shape
    n = 0
    for k in range(len(pixels)):
        y, x = pixels[k] // u.shape[1], pixels[k] % u.shape[1]
        du, dv = u[y, x] - u0, v[y, x] - v0
        d0, d1 = (u[y, x] - (plane[0] * du + plane[1] * dv + plane[2])) / f_px, v[y, x] / f_px
        z = R[0, 2] * d0 + R[1, 2] * d1 + R[2, 2]
        if z <= 0:
            continue
        qx = K[0, 0] * (R[0, 0] * d0 + R[1, 0] * d1 + R[2, 0]) / z + K[0, 2]
        qy = K[1, 1] * (R[0, 1] * d0 + R[1, 1] * d1 + R[2, 1]) / z + K[1, 2]
        ix, iy = int(np.floor(qx)), int(np.floor(qy))
        if ix < 1 or iy < 1 or ix >= width - 2 or iy >= height - 2:
            continue
        fx, fy = qx - ix, qy - iy
        if right_view.labels[iy + (fy > 0.5), ix + (fx > 0.5)] != wanted:
            continue
        for c in range(channels):
            if abs(slope[y, x, c]) < level.least:
                continue
            value = cubic(right, ix, iy, fx, fy, c)
            s = -gain[c] * slope[y, x, c] / (1 - plane[0])
            rows[n, 0], rows[n, 1], rows[n, 2] = s * du, s * dv, s
            rows[n, LEFT], rows[n, CHANNEL] = left[y, x, c], c
            rows[n, RESIDUAL] = value - gain[c] * left[y, x, c] - offset[c]
            rows[n, X], rows[n, Y] = x, y
            n += 1
    return n


@njit()
def cubic_weights(t):
    """Catmull and Rom's, of the four pixels around a place t in [0, 1) after the second."""
    return (
        0.5 * t * (-1 + t * (2 - t)),
        1 + t * t * (1.5 * t - 2.5),
        0.5 * t * (1 + t * (4 - 3 * t)),
        0.5 * t * t * (t - 1),
    )


@njit()
def cubic(picture, ix, iy, fx, fy, c):
    """The picture's channel c at (ix + fx, iy + fy), interpolated over 4 x 4 pixels."""
    wx, wy = cubic_weights(fx), cubic_weights(fy)
    value = 0.0
    for j in range(4):
        for i in range(4):
            value += wy[j] * wx[i] * picture[iy - 1 + j, ix - 1 + i, c]
    return value
