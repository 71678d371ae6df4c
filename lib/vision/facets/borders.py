"""Borders of regions to a part of a pixel."""

from dataclasses import dataclass

import numpy as np

from lib.vision.facets import borders_kernels as kernels
from lib.vision.facets.contours_kernels import Border
from lib.vision.matching import Stereo


@dataclass(frozen=True, eq=False)
class Borders:
    """Points of the borders of some regions, grouped by region, in each by v.

    q : (n, 2) px          in the photograph            uv : (n, 2)      rectified pixels
    normal : (n, 2)        outward, rectified           sigma : (n,) px  along the normal, from the picture's noise
    bend : (n,) px         how far its neighbours are off a line; large where borders turn or are ragged
    first : (N + 2,)       those of label l are first[l]:first[l + 1]
    """

    q: np.ndarray
    uv: np.ndarray
    normal: np.ndarray
    sigma: np.ndarray
    bend: np.ndarray
    first: np.ndarray

    def of(self, label: int) -> Border:
        """Those of one region, for the kernels."""
        part = slice(self.first[label], self.first[label + 1])
        return Border(self.uv[part], self.normal[part], self.sigma[part], self.bend[part])

    def number(self, label: int) -> int:
        """How many points one region has."""
        return self.first[label + 1] - self.first[label]

    def of_photograph(self, label: int):
        """(n, 2) px of one region's points in the photograph, and (n,) their sigma."""
        part = slice(self.first[label], self.first[label + 1])
        return self.q[part], self.sigma[part]


def borders(pair: Stereo, labels, values, wanted, side: str, noise: float) -> Borders:
    """The borders of the regions in `wanted` (labels). A picture's own border is none.

    labels : (H, W) int;  values : (H, W, C) in [0, 1];  noise : its standard deviation
    side : "left" or "right", which picture of the pair that is
    """
    n = int(labels.max(initial=0))
    chosen = np.zeros(n + 1, bool)
    chosen[wanted] = True
    q, normal, sigma, owner = kernels.borders(kernels.Picture(values, labels, noise), chosen)
    uv = pair.rectified(q, side)
    tip = pair.rectified(q + 0.5 * np.column_stack([-normal[:, 1], normal[:, 0]]), side) - uv  # the tangent, rectified
    normal = np.column_stack([tip[:, 1], -tip[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    keep = np.isfinite(normal).all(axis=1)
    q, uv, normal, sigma, owner = (x[keep] for x in (q, uv, normal, sigma, owner))
    order = np.lexsort((uv[:, 1], owner))
    q, uv, normal, sigma, owner = (np.ascontiguousarray(x[order]) for x in (q, uv, normal, sigma, owner))
    first = np.searchsorted(owner, np.arange(n + 2))
    normal, bend = kernels.straighten(uv, normal, first)
    return Borders(q, uv, normal, sigma, bend, first)


def noise(values, labels) -> float:
    """Standard deviation of the picture's noise, at least that of rounding to 8 bits.

    From differences of pixels 3 apart in one region, not of neighbours: resampled and compressed pictures have noise
    that neighbours share.
    """
    pairs = [
        (values[:, 3:] - values[:, :-3])[labels[:, 3:] == labels[:, :-3]],
        (values[3:] - values[:-3])[labels[3:] == labels[:-3]],
    ]
    difference = np.abs(np.concatenate(pairs))
    least = 1 / 255 / np.sqrt(12)
    return float(max(1.4826 * np.median(difference) / np.sqrt(2), least)) if len(difference) > 100 else 1 / 255


TILE = 16  # px
LEAST_PAIRS = 200  # of pixels and channels in a tile
PLAIN = 0.1  # share of the tiles that show nothing but noise


def noise_without_texture(values, labels, noise: float) -> float:
    """The noise where the picture is plainest, at most `noise`, at least that of rounding to 8 bits.

    In a picture that is textured nearly everywhere `noise` is mostly texture. Tiles that are dark or white all over say
    nothing: there a camera has no noise.
    """
    height, width = (n // TILE * TILE for n in labels.shape)
    values, labels = values[:height, :width], labels[:height, :width]
    tiles = lambda x: x.reshape(height // TILE, TILE, width // TILE, TILE).sum(axis=(1, 3))
    total, pairs = 0.0, 0.0
    for axis in (0, 1):
        a, b = (slice(3, None), slice(None)), (slice(None, -3), slice(None))
        a, b = (a, b) if axis == 0 else (a[::-1], b[::-1])
        same = np.zeros(labels.shape)
        same[b] = labels[a] == labels[b]
        difference = np.zeros(labels.shape)
        difference[b] = np.abs(values[a] - values[b]).sum(axis=2)
        total, pairs = total + tiles(difference * same), pairs + tiles(same) * values.shape[2]
    usable = tiles(((values < 0.01) | (values > 0.99)).any(axis=2).astype(float)) == 0
    usable &= pairs >= LEAST_PAIRS
    if usable.sum() < 1 / PLAIN:
        return noise
    plainest = np.quantile(total[usable] / pairs[usable], PLAIN) * np.sqrt(np.pi) / 2
    return float(np.clip(plainest, 1 / 255 / np.sqrt(12), noise))
