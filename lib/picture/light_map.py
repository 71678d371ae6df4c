"""What a gathering ray looks at: the radiosity of every side in texels.

Patches would show as blotches near corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.light.outside import Glow
from lib.light.specular import SpecularLight
from lib.light.surface import Surface
from lib.picture.light_map_kernels import LightMapArrays


@dataclass(frozen=True)
class LightMap:
    """A grid of texels over each side's bounding rectangle, values at their centres.

    start : (2 F,) int64 into value, -1: nothing reflects there;  shape : (2 F, 2) int32;  value : (K, C) float32
    irradiance : (K, C) the same before reflection;  good : (K,) bool, in the facet and outside solids
    direct : (K, C) the part of `value` that comes straight from the lamps;  between : (K, C) irradiance from others
    open : (K, emitters) float32 factor to each emitter if nothing stood in between
    step : local, about the width of a texel;  rho : (F, C)
    ways : where rays go on at mirrors and glossy surfaces;  glow : what rays find that leave the model, None: nothing
    """

    start: np.ndarray
    shape: np.ndarray
    value: np.ndarray
    irradiance: np.ndarray
    good: np.ndarray
    direct: np.ndarray
    between: np.ndarray
    open: np.ndarray
    step: float
    rho: np.ndarray
    ways: SpecularLight | None = None
    glow: Glow | None = None

    @property
    def arrays(self) -> LightMapArrays:
        """For kernels."""
        return LightMapArrays(self.start, self.shape, self.value, self.direct, self.open)


def looked_up(values, shown: LightMap, surface: Surface, p, side):
    """(M, C) nearest texels of `values` (K, C) for places p (M, 3) on sides (M,); 0 where a side has none."""
    f = side // 2
    uv = np.einsum("ij,iaj->ia", p - surface.origin[f], surface.axes[f]) / np.maximum(surface.size[f], 1e-300)
    n = shown.shape[side]
    cell = np.clip(np.nan_to_num(uv * n), 0, n - 1).astype(np.int64)
    start = shown.start[side]
    if not len(values):
        return np.zeros((len(p), values.shape[1]))
    return values[np.maximum(start, 0) + (cell[:, 0] * n[:, 1] + cell[:, 1]) * (start >= 0)] * (start >= 0)[:, None]
