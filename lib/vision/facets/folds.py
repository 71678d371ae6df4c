"""Is a region two planes that meet inside it?

Where light leaves no trace of the edge between two walls of one paint, or two sides of a box, a region spans both, and
so does its partner. No residual shows it: the plane of one wall takes the other's borders for things before it, and
the plane through a box's upright edges passes the level ones within what agrees. But the borders tell both planes. At
a room's corner the nearer of the two is seen everywhere, at a box's edge the farther. So a fold, two planes and which
of them is seen, says where each side of the outline is and what of the region the other picture shows. Where it says
both better than one plane does, the region is not one plane.
"""

import numpy as np

from lib.vision import matching_kernels
from lib.vision.facets.sides import Lines

BEST = 40  # planes of two sides that are tried in pairs, those with which most of the outline agrees
FEW = 5  # of these, tried beside all others
BOTH = 0.1  # of the region on either plane, at least
MORE_AGREE = 0.1  # of the straight sides, than with any one plane
MORE_COVERED = 0.003  # of both regions
SAMPLED = 2000  # pixels of each region


def folded(sight, l: int, r: int, plane, uv0, size: float, lines: Lines | None) -> bool:
    """Two planes that meet explain regions l and r better than the plane (a, b, c) at uv0 does.

    sight : with pair, views, regions;  size : px, of the region;  lines : what its sides may be, at uv0
    """
    if lines is None:
        return False
    planes = np.vstack([plane, lines.planes(size)])
    score = lines.score(planes)
    first, second = _pairs(score)
    left = _places(sight, l, "left", uv0)
    two = np.stack([planes[first], planes[second]], axis=1)
    nearer = _disparity(planes, left).T
    share = (nearer[first] > nearer[second]).mean(axis=1)
    two = two[np.minimum(share, 1 - share) > BOTH]
    if not len(two):
        return False
    at = lines.at(two.reshape(-1, 3)).reshape(*two.shape[:2], *lines.disparity.shape)
    folds = [(lines.score_at(seen(at, axis=1)), seen) for seen in (np.max, np.min)]
    agree, seen = max(folds, key=lambda fold: fold[0].max())
    if not agree.max() > score.max() + MORE_AGREE:
        return False
    right = _places(sight, r, "right", uv0)
    covered = lambda planes, seen: _covered(sight, l, r, uv0, left, right, planes, seen)
    return covered(two[agree.argmax()], seen) > covered(plane[None], np.max) + MORE_COVERED


def _pairs(score):
    """Two times (h,) which planes are tried together, of n with a score (n,), the first of them the region's own.

    Every two of the BEST, and every one beside the FEW best: of two walls one may hold most of the sides.
    """
    order = np.append(0, 1 + np.argsort(-score[1:], kind="stable"))
    first, second = np.triu_indices(len(order), 1)
    tried = (second < BEST) | (first < FEW)
    return order[first[tried]], order[second[tried]]


def _places(sight, label, side, uv0):
    """(n, 2) of a region's pixels, at most twice SAMPLED of them: rectified px from uv0."""
    k = 0 if side == "left" else 1
    regions, view = sight.regions[k], sight.views[k]
    pixels = regions.order[regions.first[label - 1] : regions.first[label]]
    pixels = pixels[:: max(1, len(pixels) // SAMPLED)]
    return np.column_stack([view.u.ravel()[pixels], view.v.ravel()[pixels]]) - uv0


def _disparity(planes, places):
    """(n, h) of planes (h, 3) at places (n, 2) of the left picture."""
    return places @ planes[:, :2].T + planes[:, 2]


def _covered(sight, l, r, uv0, left, right, planes, seen):
    """Intersection over union of both regions, each taken into the other picture by what is seen of the planes (h, 3).

    seen : np.max of the disparities where the nearest is, np.min where the farthest is
    """
    there, back = left + uv0, right + uv0
    there[:, 0] -= seen(_disparity(planes, left), axis=1)
    u = (right[:, :1] + right[:, 1:] * planes[:, 1] + planes[:, 2]) / (1 - planes[:, 0])  # by each plane, in the left
    back[:, 0] = seen(u, axis=1) + uv0[0]
    shares = _inside(sight, r, there, "right"), _inside(sight, l, back, "left")
    return matching_kernels.intersection_over_union(*shares) if min(shares) > 0 else 0.0


def _inside(sight, label, uv, side):
    """Share of the places uv (n, 2), of those in the picture, that lie in a region."""
    labels = sight.views[0 if side == "left" else 1].labels
    x, y = np.rint(sight.pair.photograph(uv, side)).T
    here = (x >= 0) & (y >= 0) & (x < labels.shape[1]) & (y < labels.shape[0])
    return float((labels[y[here].astype(int), x[here].astype(int)] == label).mean()) if here.any() else 0.0
