"""The camera's transfer function: from linear radiosity B to the displayed value I = T(B) (section 4.3-4.4).

Convention: T(B) = clip(B, 0, 1) ** (1 / gamma). The paper prints B ** (1 / gamma) in 4.4, but B ** gamma in 4.1 and
4.2. With one convention eq. 4.3 agrees and eq. 4.2 gains the factor -1 / gamma^2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from lib.given import tone_curve

TINY = 1e-8  # radiosity below which a slope is not followed: B ** (1 / gamma) is vertical at 0
GAMMA_RANGE = 0.2, 8.0  # of an unknown gamma
SLOPE_RANGE = 0.2, 25.0  # of the log-log slope of an unknown curve
SRGB_KNEE = 0.0031308  # linear value below which sRGB is a straight line


def srgb_from_linear(B) -> np.ndarray:
    """sRGB's display value of B >= 0, not clipped at 1 (IEC 61966-2-1)."""
    return np.where(B <= SRGB_KNEE, 12.92 * B, 1.055 * np.maximum(B, SRGB_KNEE) ** (1 / 2.4) - 0.055)


def linear_from_srgb(I) -> np.ndarray:
    """The inverse of `srgb_from_linear`."""
    return np.where(I <= 0.04045, I / 12.92, ((np.maximum(I, 0.04045) + 0.055) / 1.055) ** 2.4)


def srgb_slope(B) -> np.ndarray:
    """d `srgb_from_linear` / d B."""
    return np.where(B <= SRGB_KNEE, 12.92, 1.055 / 2.4 * np.maximum(B, SRGB_KNEE) ** (1 / 2.4 - 1))


class Curve(NamedTuple):
    """A transfer function without a parameter, of arrays >= 0 of any shape. Nothing is clipped: above 1 it goes on."""

    display: Callable  # of linear values
    linear: Callable  # of display values: the inverse
    slope: Callable  # d display / d linear


CURVES = {"srgb": Curve(srgb_from_linear, linear_from_srgb, srgb_slope)}  # their names: transfer_kinds.CURVES


def display_of_linear(B) -> np.ndarray:
    """Display values of linear light where no transfer function is known: clip(B, 0, 1)^(1 / 2.2), as SCENE.md says."""
    return np.clip(B, 0, 1) ** (1 / 2.2)


def _joined(x, y, at):
    """y at `at`, straight between the samples (n,) of x and y; beyond the last one it goes on as it ended."""
    beyond = np.maximum(np.asarray(at) - x[-1], 0) * (y[-1] - y[-2]) / (x[-1] - x[-2])
    return np.interp(at, x, y) + beyond


def _rise(linear, display, B):
    k = np.clip(np.searchsorted(linear, B, side="right"), 1, len(linear) - 1)
    return (display[k] - display[k - 1]) / (linear[k] - linear[k - 1])


@dataclass(frozen=True)
class Transfer:
    """kind : of transfer_kinds.OF_LIGHT (those of OF_PICTURE are linear until the picture is displayed)

    gamma : of the kind gamma;  shape : of the kind curve, (K,) as in lib/given/tone_curve.py
    samples : of a curve without a shape, linear and display values that rise from 0 to 1
    channels : of a curve that is not the same for R, G and B, three of them without a matrix
    matrix : (3, 3) rows, camera-linear = matrix x scene, before the function; (): colours are not mixed
    """

    kind: str
    gamma: float = 1.0
    shape: tuple = ()
    samples: tuple = ()
    channels: tuple = ()
    matrix: tuple = ()

    @property
    def bare(self) -> Transfer:
        """The same without the matrix: a function of one channel."""
        return replace(self, matrix=())

    def of_channel(self, c) -> Transfer:
        """The function of one channel, without the matrix."""
        return self.channels[c] if self.channels else self.bare

    @property
    def common(self) -> Transfer:
        """One function for all channels: the green one's."""
        return replace(self.channels[1], matrix=self.matrix) if self.channels else self

    def in_common(self, I) -> np.ndarray:
        """(..., 3) display values under the function that all channels have in common, of the same light."""
        if not self.channels:
            return I
        return np.clip(self.common.bare.curve.display(self.bare.linear(I)), 0, 1)

    def mixed(self, light) -> np.ndarray:
        """Camera-linear values of the scene's light (..., C)."""
        return np.asarray(light, float) @ np.transpose(self.matrix) if self.matrix else light

    def unmixed(self, light) -> np.ndarray:
        """The scene's light (..., C) of camera-linear values."""
        return light @ np.linalg.inv(self.matrix).T if self.matrix else light

    def display(self, B) -> np.ndarray:
        """Linear -> display, same shape (..., C with a matrix or channels). A linear image's light may exceed 1."""
        B = self.mixed(B)
        if self.channels:
            return np.stack([own.display(B[..., c]) for c, own in enumerate(self.channels)], axis=-1)
        if self.kind == "linear":
            return np.asarray(B, float)
        B = np.clip(B, 0, 1)
        return self.curve.display(B) if self.curve else B ** (1 / self.gamma)

    def linear(self, I) -> np.ndarray:
        """Display -> linear, the inverse of `display` on [0, 1]."""
        if self.channels:
            return self.unmixed(np.stack([own.linear(I[..., c]) for c, own in enumerate(self.channels)], axis=-1))
        if self.kind == "linear":
            return self.unmixed(np.asarray(I, float))
        return self.unmixed(self.curve.linear(I) if self.curve else np.asarray(I, float) ** self.gamma)

    @property
    def curve(self) -> Curve | None:
        """The three functions of a kind that has no formula with gamma; None of gamma and linear."""
        if self.kind != "curve":
            return CURVES.get(self.kind)
        if self.samples:
            x, y = (np.array(values) for values in self.samples)
            return Curve(partial(_joined, x, y), partial(_joined, y, x), partial(_rise, x, y))
        return Curve(*(partial(f, c=self.shape) for f in (tone_curve.display, tone_curve.linear, tone_curve.slope)))

    # ---- parameters: what a fit may change

    @property
    def parameters(self) -> np.ndarray:
        """(P,): gamma, or the shape of a curve; none of other kinds."""
        values = {"gamma": (self.gamma,), "curve": self.shape}.get(self.kind, ())
        return np.array(values, float)

    def moved(self, parameters) -> Transfer:
        """The same kind with other parameters (P,)."""
        if self.kind == "gamma":
            return replace(self, gamma=float(parameters[0]))
        return replace(self, shape=tuple(map(float, parameters))) if self.kind == "curve" else self

    @property
    def bounds(self) -> tuple[float, float]:
        """Between which each parameter stays."""
        return (np.log(SLOPE_RANGE[0]), np.log(SLOPE_RANGE[1])) if self.kind == "curve" else GAMMA_RANGE

    def linear_by_parameters(self, I) -> np.ndarray:
        """d linear / d parameters at display values I, (..., P), before colours are unmixed."""
        if self.kind == "curve" and self.shape:
            return tone_curve.linear_by_c(I, self.shape)
        if self.kind == "gamma":
            return (self.bare.linear(I) * np.log(np.maximum(I, 1e-30)))[..., None]
        return np.zeros((*np.shape(I), 0))

    def as_curve(self) -> Transfer:
        """The curve of the same display values, as near as a curve's knots allow."""
        if self.kind == "curve" and self.shape:
            return self
        knots = np.array(tone_curve.KNOTS)
        step = 0.01 if self.samples else 1e-4  # samples have corners between them
        linear = self.bare.linear
        slope = np.log(linear(knots) / linear(knots * (1 - step))) / -np.log1p(-step)
        return Transfer("curve", shape=tuple(map(float, np.log(slope))), matrix=self.matrix)


@dataclass(frozen=True)
class Metric:
    """Where photograph and synthesis are compared: display values, so that dark and light count as the eye sees them.

    A linear image is compared under the power 1 / 2.2, unclipped.
    """

    transfer: Transfer

    @property
    def exponent(self) -> float:
        """Of B, where the metric is a power."""
        return 1 / (self.transfer.gamma if self.transfer.kind == "gamma" else 2.2)

    def value(self, B) -> np.ndarray:
        """Unclipped display value of B >= 0."""
        B = np.maximum(B, 0)
        curve = self.transfer.curve
        return curve.display(B) if curve else B**self.exponent

    def slope(self, B) -> np.ndarray:
        """d value / d B."""
        B = np.maximum(B, TINY)
        if curve := self.transfer.curve:
            return curve.slope(B)
        return self.exponent * B ** (self.exponent - 1)

    def by_parameters(self, B) -> np.ndarray:
        """d value / d parameters of the transfer function at fixed B, (..., P).

        Of gamma it has the factor -1 / gamma^2 that eq. 4.2 lacks.
        """
        B = np.maximum(B, 1e-12)
        if self.transfer.kind == "gamma":
            return (-self.value(B) * np.log(B) / self.transfer.gamma**2)[..., None]
        if self.transfer.shape:
            return tone_curve.display_by_c(B, self.transfer.shape)
        return np.zeros((*np.shape(B), 0))
