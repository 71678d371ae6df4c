"""§2.1 Segmentation: a partition of the picture that makes equation 2.1 small.

    E(L) = sum over regions of |Z_s - mean|^2, summed over channels, + lambda x the number of neighbour pairs <s, t>
    with L_s != L_t

over the four neighbours, each pair once, Z in [0, 1].  (As printed the equals sign is missing.)  To find the least
energy is NP-hard.  What we do, and why:

1. A start: on one row, or one column, equation 2.1 is solved exactly by dynamic programming.  Rows and columns
   alternate and are drawn together by ADMM (Storath and Weinmann, SIAM J. Imaging Sci. 2014), until they nearly agree.
   Frontiers then lie where the whole picture wants them.  Merging from pixels alone ends 4 to 10 % higher, and no
   polish makes up for it (docs/decisions/segmentation.md).
2. Neighbouring regions merge, the pair first for which the smallest lambda is enough (Koepfler, Lopez and Morel,
   SIAM J. Numer. Anal. 1994).
3. Pixels on frontiers move to a neighbour's region where that lowers E, means kept exact.  Then whole rows and columns
   move at once, each pixel to the best of the labels around it, by dynamic programming with the means held.  (A
   straight frontier moves in one piece or not at all: pixels cannot move it.)  Then regions merge again, until E falls
   by less than 1e-4 of itself.

Every step of 2 and 3 lowers E.  Labels count from 0 inside this module and from 1 in what `segment` returns.
Arrays: picture f (H, W, C) float64, C = 1 or 3; labels (H, W) int32.  In the code lambda is called weight.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np

from lib.vision import frontiers_kernels as frontiers
from lib.vision import merging_kernels as merges
from lib.vision import potts_kernels as potts
from lib.vision import segmentation_kernels as kernels

STEP = 2.0  # growth of ADMM's coupling per iteration: smaller is slower and better (tests/bench/segment_bench.py)
COUPLING = 0.1  # where the coupling starts
AGREED = 1e-5  # |rows - columns|^2 / |f|^2 that ends ADMM; the polish takes the rest
SETTLED = 1e-4  # relative fall of E that ends the polish
APART = 3  # px: noise that resampling has spread does not reach so far
ROUNDING = 1 / 255 / math.sqrt(12)  # standard deviation of what 8 bits leave
SMALLEST = 1 / 24  # side of the smallest facet worth a plane, in sides of the picture


def segment(picture, weight: float, *, step: float = STEP, trace: Callable | None = None) -> np.ndarray:
    """(H, W) int32 labels from 1, each one 4-connected region, of the (H, W, C) picture in [0, 1] at lambda = `weight`.

    step : growth of ADMM's coupling per iteration
    trace : called with (what, labels from 0) after each step

    The result is never worse than one region, nor than every constant area by itself.  Of a picture of one row or one
    column it is the exact minimum.
    """
    f = np.ascontiguousarray(picture, np.float64)
    weight = float(weight)
    trace = trace or (lambda what, labels: None)
    constant, _ = kernels.joined(f, f, np.inf)
    one = np.zeros(f.shape[:2], np.int32)
    if weight == 0 or 1 in f.shape[:2]:
        labels = constant if weight == 0 else _single_line(f, weight)
        return labels + np.int32(1)
    # A second region has at least two frontier pairs.
    if kernels.energy(f, one, weight) <= 2 * weight:
        return one + np.int32(1)
    labels, n = kernels.joined(*_rows_and_columns(f, weight, step), 0.05 * math.sqrt(weight))
    trace("start", labels)
    labels, n = merges.merge(f, labels, n, weight)
    trace("merged", labels)
    turned = np.ascontiguousarray(f.transpose(1, 0, 2))
    E, before = kernels.energy(f, labels, weight), np.inf
    while (1 - SETTLED) * before > E:
        labels, n = _moved(f, turned, labels, n, weight)
        labels, n = merges.merge(f, labels, n, weight)
        trace("moved", labels)
        E, before = kernels.energy(f, labels, weight), E
    best = min((labels, one, constant), key=lambda each: kernels.energy(f, each, weight))
    return best + np.int32(1)


def energy(picture, labels, weight: float) -> float:
    """Equation 2.1, summed afresh from the labels (any numbers from 0)."""
    return kernels.energy(
        np.ascontiguousarray(picture, np.float64), np.ascontiguousarray(labels, np.int32), float(weight)
    )


def merging(picture, weights) -> Iterator[np.ndarray]:
    """Merging alone, from pixels: yields labels from 1 for each of the rising `weights`, in one run."""
    f = np.ascontiguousarray(picture, np.float64)
    labels, n = kernels.joined(f, f, np.inf)
    for weight in weights:
        labels, n = merges.merge(f, labels, n, float(weight))
        yield labels + np.int32(1)


def noise(picture, step=1) -> float:
    """Standard deviation of white noise, root mean square over channels.

    It is the median of |second differences along x and y|: the mask (1 -2 1)^T (1 -2 1) annihilates every bilinear
    shading (Immerkaer 1996), and the median forgives edges. Rounding that hides the noise gives 0.

    step : px between the pixels of the mask; noise that neighbours share, as in resampled pictures, is seen from APART
    """
    f = np.asarray(picture, float)
    if min(f.shape[:2]) < 2 * step + 1:
        return 0.0
    second = lambda g: g[2 * step :] - 2 * g[step:-step] + g[: -2 * step]
    d = np.abs(second(second(f).swapaxes(0, 1))).reshape(-1, f.shape[2])
    return float(np.sqrt(np.mean((np.median(d, axis=0) / (0.6745 * 6)) ** 2)))


def auto_lambda(*pictures) -> float:
    """The lambda at which noise as strong as the pictures' stays one region, with probability 0.95.

    Texture that fills the picture stays one region too. Shading does not: its levels are cut, and joined again by what
    lies beside their borders (surfaces.py). A larger lambda leaves less to join, but draws planes together that meet
    in a faint edge, and nothing takes them apart again (docs/decisions/surfaces.md).

    A pixel alone saves |Z - mean|^2 = sigma^2 chi^2_C and costs 4 lambda. Among N pixels chi^2_C stays below
    C + 2 sqrt(C t) + 2 t, t = ln N + 3 (Laurent and Massart 2000). Larger shapes are more numerous, about 2.64^p of
    perimeter p at a place, yet cost p lambda: above 2 sigma^2 they ask for less than pixels do.

    The same holds for blocks of s x s pixels, whose means have the noise sigma_s: they save s^2 sigma_s^2 chi^2_C and
    cost 4 s lambda. White noise asks s times less there, texture more. The largest blocks have the side of the
    smallest facet. Noise counts at least as what rounding to 8 bits leaves, and with what neighbours share of it.
    """
    asked = [0.0]
    for f in pictures:
        H, W, C = f.shape
        s = 1
        while s == 1 or s <= SMALLEST * math.sqrt(H * W):
            h, w = H // s, W // s
            means = f[: h * s, : w * s].reshape(h, s, w, s, C).mean((1, 3))
            sigma = noise(means) if s > 1 else max(noise(f), noise(f, APART), ROUNDING)
            t = math.log(h * w) + 3
            asked.append(s * sigma**2 * (C + 2 * math.sqrt(C * t) + 2 * t) / 4)
            s *= 2
    return max(asked)


def _moved(f, turned, labels, n, weight):
    """(labels, their number) after pixels, whole rows and whole columns have moved. turned : f transposed."""
    frontiers.relabel(f, labels, n, weight)
    labels, n = kernels.components(labels)
    frontiers.move_rows(f, labels, n, weight)
    labels, n = kernels.components(np.ascontiguousarray(labels.T))
    frontiers.move_rows(turned, labels, n, weight)
    return kernels.components(np.ascontiguousarray(labels.T))


def _rows_and_columns(f, weight, step):
    """(u, v): the picture piecewise constant along rows and along columns, nearly equal."""
    u, v, dual, mu = np.empty_like(f), f.copy(), np.zeros_like(f), COUPLING
    enough = AGREED * np.vdot(f, f)
    for _ in range(200):
        potts.rows(f, v, dual, mu, weight, u)
        if potts.columns(f, u, dual, mu, weight, v) <= enough:
            break
        mu *= step
    return u, v


def _single_line(f, weight):
    """The exact labels of a picture of one row or one column."""
    z = np.ascontiguousarray(f.reshape(-1, f.shape[2]).T)
    n = z.shape[1]
    first, work = np.empty(n + 1, np.int32), np.empty((6, n + 1))
    potts.potts(z, len(z), n, weight, first, work, work[5].view(np.int64))
    starts, r = np.zeros(n, np.int32), n
    while r:
        r = first[r]
        starts[r] = r > 0
    return np.cumsum(starts, dtype=np.int32).reshape(f.shape[:2])
