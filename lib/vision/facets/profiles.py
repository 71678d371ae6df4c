"""Do both photographs show the same thing at a side of an outline?

A side is located by the change of colour across it. Where one photograph shows a narrow face beyond it (a board's edge,
a box's flank), or another border close behind, and the other shows less of it, the two places are not of one line in
space, and no residual tells. But the change of colour is then not the same in both.
"""

import numpy as np

from lib.vision.facets.contours import Measured
from lib.vision.facets.contours_kernels import NORMAL_U, NORMAL_V, PART, RESIDUAL, SIGMA, U, V
from lib.vision.matching import Stereo

ACROSS = np.arange(-4.5, 4.75, 0.5)  # px along the outward normal
LEVEL = 2.5  # px from the side, where either colour is taken
COMPARED = 3.0  # px to either side
SAMPLE = 1.4  # variance of a share at a place, over that of one pixel's noise: between pixels, and the levels' own
ALIKE = 0.03  # rms of the differences of exact pairs, wide baselines too: they are seen from two places
# px that a side may be off, one sigma, where the shares differ by 1 (rms). A strip of w px that one photograph shows
# there, of a colour c of the way from the outer to the inner one, moves the side by c w.
OFF = 6.0


def unlike(pair: Stereo, values, noise, x: Measured) -> np.ndarray:
    """(P,) px, one sigma, by which each side may be off as a whole, for the two photographs show it differently.

    values : two (H, W, C) in [0, 1];  noise : of each, standard deviation

    The share of the inner colour at places across the side, median along it, left against right, rms, less what noise
    makes of it.
    """
    off = np.zeros(len(x.C))
    if len(x.rows) == 0:
        return off
    normal = x.rows[:, [NORMAL_U, NORMAL_V]]
    left = x.rows[:, [U, V]]
    right = left - (x.rows[:, RESIDUAL] * x.rows[:, SIGMA])[:, None] * normal
    right[:, 0] -= (left - x.uv0) @ x.plane[:2] + x.plane[2]
    seen = [_across(pair, v, uv, normal, s) for v, uv, s in zip(values, (left, right), ("left", "right"), strict=True)]
    part = x.rows[:, PART].astype(int)
    near = np.abs(ACROSS) <= COMPARED
    for p in np.unique(part):
        mine = part == p
        share, contrast = zip(*(_share(colours[mine]) for colours in seen), strict=True)
        if not min(contrast) > 0:
            continue
        chance = SAMPLE / mine.sum() * sum((s / c) ** 2 for s, c in zip(noise, contrast, strict=True))
        off[p] = OFF * np.sqrt(max(np.mean((share[0] - share[1])[near] ** 2) - chance - ALIKE**2, 0))
    return off


def _across(pair, values, uv, normal, side):
    """(n, len(ACROSS), C) colours across the border at each point uv (n, 2), rectified px."""
    import cv2

    q = pair.photograph(uv[:, None] + ACROSS[:, None] * normal[:, None], side).astype(np.float32)
    colours = cv2.remap(
        values.astype(np.float32), q[..., 0], q[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return colours.reshape(*q.shape[:2], -1)


def _share(colours):
    """(len(ACROSS),) share of the inner colour, median along the side, and the contrast of the two colours."""
    mean = np.median(colours, axis=0)
    inner, outer = mean[ACROSS <= -LEVEL].mean(axis=0), mean[ACROSS >= LEVEL].mean(axis=0)
    contrast2 = float(((inner - outer) ** 2).sum())
    return (mean - outer) @ (inner - outer) / max(contrast2, 1e-12), np.sqrt(contrast2)
