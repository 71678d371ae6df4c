"""Compiled: the texel at a place, and a linear fit."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit


class LightMapArrays(NamedTuple):
    """What kernels need of a LightMap; see there."""

    start: np.ndarray  # (2 F,) int64
    shape: np.ndarray  # (2 F, 2) int32
    value: np.ndarray  # (K, C) float32
    direct: np.ndarray  # (K, C) float32
    open: np.ndarray  # (K, emitters) float32


@njit(inline="always")
def linear(s0, su, sv, suu, suv, svv, t, ridge):
    """Solve the weighted normal equations of value = t0 + t1 u + t2 v; slopes shrink by `ridge` of the weight.

    t : (3, C) the right-hand sides; the solution, in place
    """
    mu, mv = su / s0, sv / s0
    a, b, c = suu - su * mu + ridge * s0, suv - su * mv, svv - sv * mv + ridge * s0
    det = a * c - b * b
    for k in range(t.shape[1]):
        mean = t[0, k] / s0
        x, y = t[1, k] - su * mean, t[2, k] - sv * mean
        gu, gv = (c * x - b * y) / det, (a * y - b * x) / det
        t[0, k] = mean - gu * mu - gv * mv
        t[1, k] = gu
        t[2, k] = gv


@njit(inline="always")
def texel(p, f, s, origin, axes, size, start, shape):
    """For bilinear interpolation at p (3,) on side s of facet f: a texel, steps to its neighbours, and their weights.

    start, shape : of a LightMapArrays
    """
    u, v = 0.0, 0.0
    for d in range(3):
        x = p[d] - origin[f, d]
        u += x * axes[f, 0, d]
        v += x * axes[f, 1, d]
    nu, nv = shape[s, 0], shape[s, 1]
    u = min(max(u / size[f, 0] * nu - 0.5, 0.0), nu - 1.0)
    v = min(max(v / size[f, 1] * nv - 0.5, 0.0), nv - 1.0)
    a, b = min(int(u), max(nu - 2, 0)), min(int(v), max(nv - 2, 0))
    return start[s] + a * nv + b, nv if nu > 1 else 0, 1 if nv > 1 else 0, u - a, v - b


@njit(inline="always")
def blend(value, c, here, du, dv, u, v):
    """Column c of value (K, C), bilinear between the texels that `texel` found."""
    return (1 - u) * ((1 - v) * value[here, c] + v * value[here + dv, c]) + u * (
        (1 - v) * value[here + du, c] + v * value[here + du + dv, c]
    )
