"""The photograph's noise on what is inserted, which a rendering has not.

How much noise pixels of each brightness have is told by the photograph less its rendering: second differences along
rows, from which shading is gone.
"""

from __future__ import annotations

import numpy as np

from lib.picture.differential import Pair, shown

BINS = 16  # of brightness
ENOUGH = 200  # pixels of a bin
OF_SECOND = np.sqrt(6.0)  # deviation of a second difference, of that of a pixel
SEED = 1


def noise_curve(values, rendered, known):
    """(BINS,) standard deviation of display values about the middles of the bins from 0 to 1; None: none is told.

    values, rendered : (H, W, C) display values;  known : (H, W) bool, pixels whose rendering is that of the photograph
    """
    rest = values - rendered
    second = rest[:, :-2] - 2 * rest[:, 1:-1] + rest[:, 2:]
    good = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    middle = values[:, 1:-1]
    inside = good[..., None] & (middle > 0) & (middle < 1)
    number = np.minimum((middle * BINS).astype(int), BINS - 1)
    sigma = np.full(BINS, np.nan)
    for k in range(BINS):
        some = np.abs(second[inside & (number == k)])
        if len(some) >= ENOUGH:
            sigma[k] = np.median(some) / 0.6745 / OF_SECOND
    told = np.flatnonzero(np.isfinite(sigma))
    return np.interp(np.arange(BINS), told, sigma[told]) if len(told) else None


def added(linear, pair: Pair, photograph, transfer):
    """The picture (H, W, C), linear, with noise on the share of each pixel that is new; as it is where none is told.

    An EXR has no curve of noise by display values: its picture is left as it is.
    """
    if photograph.linear:
        return linear
    new = pair.new[..., 0]
    curve = noise_curve(photograph.values, shown(pair.before, transfer), new == 0)
    if curve is None:
        return linear
    display = shown(linear, transfer)
    sigma = np.interp(display * BINS - 0.5, np.arange(BINS), curve)
    # what is left of the photograph has its own noise
    share = np.sqrt(1 - (1 - pair.new) ** 2)
    noisy = display + share * sigma * np.random.default_rng(SEED).standard_normal(display.shape)
    return np.where(pair.new > 0, np.maximum(transfer.linear(np.clip(noisy, 0, 1)), 0), linear)
