"""The camera's transfer function: from linear radiosity B to the displayed value I = T(B) (section 4.3-4.4).

Convention: T(B) = clip(B, 0, 1) ** (1 / gamma). The paper prints B ** (1 / gamma) in 4.4 but B ** gamma in 4.1
and 4.2; with one convention eq. 4.3 agrees and eq. 4.2 gains the factor -1 / gamma^2.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TINY = 1e-8          # radiosity below which a slope is not followed: B ** (1 / gamma) is vertical at 0


@dataclass(frozen=True)
class Transfer:
    """kind: gamma, linear or srgb (the per-group and histogram kinds are linear until the picture is finished)."""
    kind: str
    gamma: float = 1.0

    def display(self, B):
        """Linear -> display, same shape. A linear image is not clipped: above 1 is light."""
        if self.kind == "linear":
            return np.asarray(B, float)
        B = np.clip(B, 0, 1)
        if self.kind == "srgb":
            return np.where(B <= 0.0031308, 12.92 * B, 1.055 * np.maximum(B, 0.0031308) ** (1 / 2.4) - 0.055)
        return B ** (1 / self.gamma)

    def linear(self, I):
        """Display -> linear, the inverse of `display` on [0, 1]."""
        if self.kind == "linear":
            return np.asarray(I, float)
        if self.kind == "srgb":
            return np.where(I <= 0.04045, I / 12.92, ((np.maximum(I, 0.04045) + 0.055) / 1.055) ** 2.4)
        return np.asarray(I, float) ** self.gamma


@dataclass(frozen=True)
class Metric:
    """Where photograph and synthesis are compared: display values, so that dark and light count as the eye sees
    them. A linear image is compared under the power 1 / 2.2, unclipped."""
    transfer: Transfer

    @property
    def _srgb(self):
        return self.transfer.kind == "srgb"

    @property
    def exponent(self):
        return 1 / (self.transfer.gamma if self.transfer.kind == "gamma" else 2.2)

    def value(self, B):
        """Unclipped display value of B >= 0."""
        B = np.maximum(B, 0)
        if self._srgb:
            return np.where(B <= 0.0031308, 12.92 * B, 1.055 * np.maximum(B, 0.0031308) ** (1 / 2.4) - 0.055)
        return B ** self.exponent

    def slope(self, B):
        """d value / d B."""
        B = np.maximum(B, TINY)
        if self._srgb:
            return np.where(B <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(B, 0.0031308) ** (1 / 2.4 - 1))
        return self.exponent * B ** (self.exponent - 1)


class Tiles:
    """The photograph's pixels tile by tile; asked for linear means at many gammas, so its levels are found once.

    pixels : (M, C) display;  start : (T + 1,)
    """

    def __init__(self, pixels, start):
        self.count = np.diff(start)[:, None]
        self.start = start
        self.pixels = pixels
        scaled = pixels * 65535
        if len(pixels) and np.array_equal(scaled, np.round(scaled)):
            self._levels = np.arange(65536) / 65535
            self._index = scaled.astype(np.uint16)
        else:
            self._levels = None

    def _mean(self, values):
        if len(self.pixels) == 0:
            return np.zeros((0, self.pixels.shape[1]))
        return np.add.reduceat(values, self.start[:-1], axis=0) / self.count

    def linear(self, transfer: Transfer):
        """Linear mean of each tile: mean(T^-1(I)), never T^-1(mean(I)) (Jensen; DESIGN 7, trap 2), and its
        derivative with respect to gamma. -> (T, C), (T, C)."""
        if transfer.kind != "gamma":
            mean = self._mean(transfer.linear(self.pixels))
            return mean, np.zeros_like(mean)
        levels = self.pixels if self._levels is None else self._levels
        power = levels ** transfer.gamma
        slope = power * np.log(np.maximum(levels, 1e-30))
        if self._levels is not None:
            power, slope = power[self._index], slope[self._index]
        return self._mean(power), self._mean(slope)

    def display(self):
        """Mean display value of each tile, (T, C)."""
        return self._mean(self.pixels)
