"""The camera's transfer function: from linear radiosity B to the displayed value I = T(B) (section 4.3-4.4).

Convention: T(B) = clip(B, 0, 1) ** (1 / gamma). The paper prints B ** (1 / gamma) in 4.4, but B ** gamma in 4.1 and
4.2. With one convention eq. 4.3 agrees and eq. 4.2 gains the factor -1 / gamma^2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

TINY = 1e-8  # radiosity below which a slope is not followed: B ** (1 / gamma) is vertical at 0
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


@dataclass(frozen=True)
class Transfer:
    """kind : of transfer_kinds.OF_LIGHT (those of OF_PICTURE are linear until the picture is displayed)"""

    kind: str
    gamma: float = 1.0

    def display(self, B) -> np.ndarray:
        """Linear -> display, same shape. A linear image is not clipped: above 1 is light."""
        if self.kind == "linear":
            return np.asarray(B, float)
        B = np.clip(B, 0, 1)
        return CURVES[self.kind].display(B) if self.kind in CURVES else B ** (1 / self.gamma)

    def linear(self, I) -> np.ndarray:
        """Display -> linear, the inverse of `display` on [0, 1]."""
        if self.kind == "linear":
            return np.asarray(I, float)
        if self.kind in CURVES:
            return CURVES[self.kind].linear(I)
        return np.asarray(I, float) ** self.gamma


@dataclass(frozen=True)
class Metric:
    """Where photograph and synthesis are compared: display values, so that dark and light count as the eye sees them.

    A linear image is compared under the power 1 / 2.2, unclipped.
    """

    transfer: Transfer

    @property
    def _curve(self) -> Curve | None:
        return CURVES.get(self.transfer.kind)

    @property
    def exponent(self) -> float:
        """Of B, where the metric is a power."""
        return 1 / (self.transfer.gamma if self.transfer.kind == "gamma" else 2.2)

    def value(self, B) -> np.ndarray:
        """Unclipped display value of B >= 0."""
        B = np.maximum(B, 0)
        return self._curve.display(B) if self._curve else B**self.exponent

    def slope(self, B) -> np.ndarray:
        """d value / d B."""
        B = np.maximum(B, TINY)
        if self._curve:
            return self._curve.slope(B)
        return self.exponent * B ** (self.exponent - 1)
