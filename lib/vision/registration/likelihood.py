"""How well a motion explains the edges: each piece lies at one of its peaks, or at none.

    p(x) = none / (2 reach) + sum_j share_j t((x - offset_j) / sigma) / sigma          t : Student's, 4 degrees

x is where the motion puts the piece, px along its normal. All motions are judged by the same peaks, so none is
judged by an association that another has made.
"""

import numpy as np

from lib.vision.registration.pieces import REACH_PX

FREEDOM = 4.0
NARROWING = (4.0, 2.0, 1.0, 0.5)  # px, the widths of a fit from far to near
FOLDS = 4
CLEAR_PX = 0.2  # blur of a clear step, at most


def _densities(x, pieces, sigma):
    """Of x (M,) or (M, G) px: share_j t_j and (x - offset_j) / width, and width, all (..., PEAKS)."""
    offset, share, blur = pieces.offset, pieces.share, pieces.blur
    if x.ndim > 1:
        offset, share, blur = (array[:, None] for array in (offset, share, blur))
    width = np.hypot(sigma, blur)
    e = (x[..., None] - offset) / width
    return share * (0.375 / width) * (1 + e * e / FREEDOM) ** (-(FREEDOM + 1) / 2), e, width


def log_likelihood(x, pieces, sigma):
    """(M,) or (M, G) nats: each piece's, by its weight."""
    floor = pieces.none / (2 * REACH_PX)
    weight = pieces.weight
    if x.ndim > 1:
        floor, weight = floor[:, None], weight[:, None]
    return weight * np.log(floor + _densities(x, pieces, sigma)[0].sum(axis=-1))


def fit(pieces, J, x, prior, sigma, start=None, widths=NARROWING, mean=None):
    """(n,) numbers that bring pieces at x + J numbers onto their peaks: expectation maximisation, narrowing.

    J : (M, n) px        x : (M,) px, where they are at 0        prior : (n,) sigma about `mean` (n,), 0 by default
    """
    numbers = np.zeros(J.shape[1]) if start is None else np.asarray(start, float)
    ridge = np.diag(1 / prior**2)
    mean = np.zeros(J.shape[1]) if mean is None else mean
    floor = pieces.none / (2 * REACH_PX)
    for width in (*[w for w in widths if w > sigma], sigma):
        for _ in range(12):
            d, e, wide = _densities(x + J @ numbers, pieces, width)
            responsible = d / (floor + d.sum(axis=1))[:, None]
            u = pieces.weight[:, None] * responsible * (FREEDOM + 1) / (FREEDOM + e * e) / wide**2
            w = u.sum(axis=1)
            H = (w[:, None] * J).T @ J + ridge
            b = J.T @ (-(u * e * wide).sum(axis=1)) - ridge @ (numbers - mean)
            step = np.linalg.solve(H, b)
            numbers = numbers + step
            if np.abs(J @ step).max(initial=0) < 0.02 * width:
                break
    return numbers


def curvature(pieces, J, x, sigma):
    """(n, n) of -log p by the numbers, at x.  J : (M, n)"""
    d, e, wide = _densities(x, pieces, sigma)
    responsible = d / (pieces.none / (2 * REACH_PX) + d.sum(axis=1))[:, None]
    u = pieces.weight[:, None] * responsible * (FREEDOM + 1) / (FREEDOM + e * e) / wide**2
    return (u.sum(axis=1)[:, None] * J).T @ J


def scatter(pieces, x, low=0.2, high=1.5):
    """px: how far edges lie from their nearest peaks, robust.

    By the third that is nearest, for the others may belong elsewhere; and by clear steps, if there are some.
    """
    gap = np.where(pieces.share > 0, np.abs(x[:, None] - pieces.offset), np.inf)
    clear = np.where(pieces.blur < CLEAR_PX, gap, np.inf).min(axis=1)
    near = clear if np.count_nonzero(clear < 3) >= 15 else gap.min(axis=1)
    near = near[near < 3]
    return float(np.clip(np.quantile(near, 1 / 3) / 0.4307, low, high)) if len(near) >= 5 else high


def folds(pieces):
    """(M,) int: whole edges, those of one object dealt in turn, the longest first."""
    edge, first, which = np.unique(pieces.edge, return_index=True, return_inverse=True)
    px = np.bincount(which.reshape(-1), pieces.px)
    owner = pieces.owner[first]
    order = np.lexsort((-px, owner))
    rank = np.empty(len(edge), int)
    rank[order] = np.arange(len(edge))
    return rank[which.reshape(-1)] % FOLDS
