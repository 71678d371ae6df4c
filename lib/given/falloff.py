"""A lens that is darker towards the corners: V(r) = 1 + k_1 r^2 + k_2 r^4 + k_3 r^6.

r is the distance from the principal point, 1 at the farthest corner of the picture, as DNG has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST = 0.05  # of V


@dataclass(frozen=True, eq=False)
class Lens:
    """Where pixels lie in the picture. centre : (2,) px;  size : width, height px"""

    centre: tuple
    size: tuple

    def radius2(self, pixel) -> np.ndarray:
        """r^2 of flat pixel indices (M,)."""
        x, y = pixel % self.size[0] - self.centre[0], pixel // self.size[0] - self.centre[1]
        far = [max(c, n - 1 - c) for c, n in zip(self.centre, self.size, strict=True)]
        return (x**2 + y**2) / (far[0] ** 2 + far[1] ** 2)

    def gain(self, pixel, k) -> np.ndarray:
        """V at flat pixel indices, (M,)."""
        r2 = self.radius2(pixel)
        return np.maximum(1 + sum(value * r2 ** (j + 1) for j, value in enumerate(k)), LEAST)

    @property
    def pixels(self) -> np.ndarray:
        """Flat indices of the whole picture."""
        return np.arange(self.size[0] * self.size[1])
