"""The photograph's pixels tile by tile: their linear means under any transfer function, and their noise."""

from __future__ import annotations

import functools

import numpy as np

from lib.given.transfer import Transfer

LEAST_NOISE = 0.3 / 255  # display, of one pixel: what rounding to 8 bits leaves
MOST_LEVELS = 2**18  # display values so many 65535ths large are told apart, beyond white where a lens was evened


class TilePixels:
    """The pixels of tiles; asked for linear means under many functions, so their levels are counted once.

    A tile of a noisy photograph is its median. Noise may have come to the sensor's light or to the displayed values,
    and be cut off at black or white: a mean is right for one of these only, the median for all, since T keeps order.

    pixels : (M, C) display;  start : (T + 1,);  noisy : of Photograph, medians are taken
    """

    def __init__(self, pixels, start, noisy=False):
        self.count = np.diff(start)[:, None]
        self.start, self.pixels, self.noisy = start, pixels, noisy
        self._medians = _medians(pixels, start) if noisy else None
        scaled = pixels * 65535
        in_range = len(pixels) > 0 and scaled.min() >= 0 and scaled.max() < MOST_LEVELS
        self._has_levels = in_range and np.array_equal(scaled, np.round(scaled))

    def is_of(self, pixels, start, noisy):
        """It was made of these very arrays."""
        return self.pixels is pixels and self.start is start and self.noisy == noisy

    @functools.cached_property
    def noise(self):
        """Display noise of one pixel."""
        return _pixel_noise(self.pixels, self.start)

    @functools.cached_property
    def _histograms(self):
        """(levels (L,), (T C, L) CSR): what the pixels are, and how many of each tile and channel are that."""
        from scipy import sparse

        level = np.round(self.pixels * 65535).astype(np.int32)
        present = np.bincount(level.ravel()) > 0
        column = (np.cumsum(present) - 1)[level.T.ravel()]
        M, C = self.pixels.shape
        first = np.concatenate([*(self.start[:-1] + c * M for c in range(C)), [C * M]])
        found = sparse.csr_matrix((np.ones(C * M), column, first), (len(first) - 1, int(present.sum())))
        found.sum_duplicates()
        return np.flatnonzero(present) / 65535, found

    def _mean(self, values):
        """(T, C, ...) means of each tile. values : of the pixels (M, C, ...), or of the levels (L, ...)"""
        if not self._has_levels:
            if len(self.pixels) == 0:
                return np.zeros((0, *values.shape[1:]))
            return np.add.reduceat(values, self.start[:-1], axis=0) / self.count.reshape(-1, *[1] * (values.ndim - 1))
        T, C = len(self.count), self.pixels.shape[1]
        total = (self._histograms[1] @ values.reshape(len(values), -1)).reshape(C, T, *values.shape[1:])
        return np.moveaxis(total, 0, 1) / self.count.reshape(-1, *[1] * values.ndim)

    def linear(self, transfer: Transfer):
        """Linear mean of each tile, (T, C), and its derivatives by the transfer function's parameters, (T, C, P).

        It is mean(T^-1(I)), never T^-1(mean(I)): docs/decisions/averaging.md. Derivatives are of the camera's light.
        """
        bare = transfer.bare
        if self._medians is not None and transfer.kind != "linear":
            return transfer.linear(self._medians), transfer.linear_by_parameters(self._medians)
        levels = self._histograms[0] if self._has_levels else self.pixels
        return transfer.unmixed(self._mean(bare.linear(levels))), self._mean(transfer.linear_by_parameters(levels))

    def display(self):
        """Mean display value of each tile, (T, C)."""
        return self._mean(self._histograms[0] if self._has_levels else self.pixels)


def _pixel_noise(pixels, start):
    """Robust display noise of one pixel from differences of neighbours inside tiles."""
    step = np.diff(pixels, axis=0)
    inner = np.ones(len(step), bool)
    inner[start[1:-1] - 1] = False
    if not inner.any():
        return 0.01
    return max(1.4826 * _median_of_rounded(np.abs(step[inner]).ravel()) / np.sqrt(2), LEAST_NOISE)


def _median_of_rounded(values):
    """Median of values >= 0 (n,) that were rounded to levels: each stands for all that is nearer to it than to others.
    Of noise of a level or two the plain median is a level itself: noise by it was .67 to 1.8 times what it is."""
    level, count = np.unique(np.round(values, 9), return_counts=True)
    edges = np.concatenate([[0.0], (level[1:] + level[:-1]) / 2, level[-1:]])
    up_to, half = np.cumsum(count), len(values) / 2
    k = int(np.searchsorted(up_to, half))
    share = (half - (up_to[k] - count[k])) / count[k]
    return float(edges[k] + share * (edges[k + 1] - edges[k]))


def _medians(pixels, start):
    """(T, C) medians of each tile of pixels (M, C): means of the middle fifth, which lie between levels of 8 bits."""
    count = np.diff(start)
    tile = np.repeat(np.arange(len(count)), count)
    low, high = start[:-1] + (2 * (count - 1)) // 5, start[:-1] + count - (2 * (count - 1)) // 5
    middle = np.zeros((len(count), pixels.shape[1]))
    for c, values in enumerate(pixels.T):
        total = np.concatenate([[0.0], np.cumsum(values[np.lexsort((values, tile))])])
        middle[:, c] = (total[high] - total[low]) / (high - low)
    return middle
