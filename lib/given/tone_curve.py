"""A camera's own tone curve: smooth, rising, of few numbers; gamma is its simplest case.

The logarithm of the linear light B is integrated along that of the display value I, from white (B = I = 1) downwards:

    ln B(I) = - integral from I to 1 of s(J) d ln J,        s(I) = exp(sum_k c_k hat_k(I)) > 0

s is the slope in a log-log plot: the same everywhere for a gamma, from 1 to 2.3 for sRGB, more near white where a film
or a camera's picture style has a shoulder. The hats are piecewise linear in ln I between KNOTS, so c = (ln 2.2, ...)
is gamma 2.2. Whatever the c, the curve rises and has an inverse.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

KNOTS = (0.015, 0.04, 0.09, 0.17, 0.28, 0.42, 0.58, 0.75, 0.9, 1.0)  # display values
LOWEST = 1e-4  # display value below which the slope stays
STEPS = 2000  # of the tables, along ln I


class Tables(NamedTuple):
    """Along ln I, from LOWEST to 1: ln I (n,), ln B (n,), s (n,), and d ln B / d c (n, K)."""

    log_I: np.ndarray
    log_B: np.ndarray
    s: np.ndarray
    by_c: np.ndarray


def _hats(log_I):
    """(n, K) value of each hat; constant beyond the outermost knots."""
    knots = np.log(KNOTS)
    return np.stack([np.interp(log_I, knots, row) for row in np.eye(len(KNOTS))], axis=1)


_LOG_I = np.linspace(np.log(LOWEST), 0, STEPS + 1)
_HATS = _hats(_LOG_I)


@lru_cache(maxsize=64)
def tables(c: tuple) -> Tables:
    """What all values of a curve are looked up in. c : (K,) logarithms of the slope at KNOTS"""
    s = np.exp(_HATS @ np.asarray(c, float))
    step = _LOG_I[1] - _LOG_I[0]

    def below_white(rate):
        """Minus the integral of rate (n, ...) from each place to white."""
        pieces = (rate[1:] + rate[:-1]) * (step / 2)
        return -np.concatenate([np.cumsum(pieces[::-1], axis=0)[::-1], np.zeros((1, *rate.shape[1:]))])

    return Tables(_LOG_I, below_white(s), s, below_white(s[:, None] * _HATS))


def linear(I, c) -> np.ndarray:
    """Linear light of display values I >= 0, same shape. Beyond black and white the slope of the end goes on."""
    t = tables(c)
    x = np.log(np.maximum(I, 1e-30))
    return np.where(np.asarray(I) > 0, np.exp(_reached(x, t.log_I, t.log_B, t.s)), 0.0)


def display(B, c) -> np.ndarray:
    """Display values of linear light B >= 0: the inverse of `linear`, not clipped at 1."""
    t = tables(c)
    x = np.log(np.maximum(B, 1e-30))
    return np.where(np.asarray(B) > 0, np.exp(_reached(x, t.log_B, t.log_I, 1 / t.s)), 0.0)


def _reached(x, at, value, slope):
    """Interpolation, with the slopes of the ends beyond them."""
    inside = np.interp(x, at, value)
    return inside + np.minimum(x - at[0], 0) * slope[0] + np.maximum(x - at[-1], 0) * slope[-1]


def slope(B, c) -> np.ndarray:
    """d display / d linear at B > 0."""
    t = tables(c)
    I = display(B, c)
    return I / (B * np.interp(np.log(I), t.log_I, t.s))


def linear_by_c(I, c) -> np.ndarray:
    """d linear / d c at display values I, (..., K)."""
    t = tables(c)
    x = (np.log(np.maximum(I, LOWEST)) - t.log_I[0]) / (t.log_I[1] - t.log_I[0])
    k = np.minimum(x, STEPS - 1).astype(int)
    part = np.minimum(x - k, 1.0)[..., None]
    return linear(I, c)[..., None] * ((1 - part) * t.by_c[k] + part * t.by_c[k + 1])


def display_by_c(B, c) -> np.ndarray:
    """d display / d c at fixed linear light B, (..., K): what stays the same is B(I(B, c), c)."""
    return -slope(B, c)[..., None] * linear_by_c(display(B, c), c)
