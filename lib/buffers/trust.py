"""§4.5 Trust: the pixels that the analysis may use, away from edges and nearest to a planar approximation."""

import itertools
from dataclasses import dataclass

import numpy as np

from lib.buffers.edges import boundary, shifted

BLOCK_PX = 4  # noise of demosaicing and of a lens' blur reaches less far


@dataclass(frozen=True, eq=False)
class Trust:
    """Which pixels can be trusted."""

    mask: np.ndarray  # (H, W) bool: pixels to be used in the analysis
    edges: np.ndarray  # (H, W) bool: Canny's edges of the photograph
    left: dict  # of int: how many pixels each step left


def trusted(
    photograph, facet, hidden, facet_group, *, margin_px=2, keep=0.5, edge_noise=12.0, enough=400, window_px=7
) -> Trust:
    """Which pixels can be trusted (§4.5): away from edges, neither saturated nor black, and as flat as their facet.

    photograph : Photograph             facet : (H, W) int32, -1 for nothing
    hidden : (H, W) bool                visible edges of facets
    facet_group : (F,) int              index into the groups
    margin_px                           pixels left out on each side of an edge, beyond those that mix two facets
    keep                                the part of each facet's pixels kept: those nearest to a planar approximation
    edge_noise                          an edge of the photograph rises above the noise this many times
    enough                              a group with fewer pixels gives up its margins, then the choice, step by step

    A pixel is judged by the mean of its surroundings on the same facet (window_px wide), never by its own value: noise
    has a long tail on one side, and to choose pixels by their noise would bias their mean. In a noisy photograph the
    pixel's own block of BLOCK_PX has no say, either: what noise has lowered where light peaks would seem the flattest.
    """
    labels = facet + 1
    display, black, white = _display(photograph)
    mixed = boundary(facet) | hidden | (facet < 0)
    left = {"seen": int((facet >= 0).sum())}

    inner = np.where(mixed, 0, labels)
    window = range(1, window_px // 2 + 1)
    black, white = _local_mean([black, white], inner, window)
    judge = _mean_of_others if photograph.noisy else _local_mean
    mean = np.stack(judge(np.moveaxis(display, 2, 0), inner, window), axis=2)
    clipped = (black > photograph.spoilt_share) | (white > photograph.spoilt_share)
    if not photograph.linear:
        clipped |= (mean > 0.97).any(axis=2)
    usable = ~mixed & ~clipped
    left["not clipped"] = int((~clipped & (facet >= 0)).sum())
    edges = _canny(display, inner, edge_noise) & ~mixed

    near = _margins(mixed | edges, margin_px, photograph.blocks)
    mask = _away_from_edges(facet, usable, near, facet_group, enough)
    left["away from edges"] = int(mask.sum())

    mask = _flattest(mean, facet, mask, len(facet_group), keep, enough // 2)
    left["trusted"] = int(mask.sum())
    return Trust(mask, edges, left)


def _margins(edges, margin_px, blocks):
    """[(H, W) bool]: what lies at edges, ever more of it; last, whole blocks of JPEG that hold one."""
    import cv2

    near = [edges]
    for margin in range(1, margin_px + 1):
        near.append(cv2.dilate(edges.astype(np.uint8), np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)) > 0)
    if blocks:
        near.append(near[-1] | in_blocks(edges, blocks))
    return near


def in_blocks(edges, blocks):
    """(H, W) bool: the block of pixels holds an edge, or may hold one where nobody knows how blocks lie.

    blocks : jpeg.Blocks
    """
    if blocks.first is None:
        import cv2

        reach = 2 * int(np.ceil(blocks.px)) - 1
        return cv2.dilate(edges.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
    starts = [
        np.unique([0, *np.rint(np.arange(first, n - 0.5, blocks.px)).astype(int)])
        for first, n in zip(blocks.first, edges.shape, strict=True)
    ]
    held = np.logical_or.reduceat(np.logical_or.reduceat(edges, starts[0], axis=0), starts[1], axis=1)
    for axis, start in enumerate(starts):
        held = held.repeat(np.diff(start, append=edges.shape[axis]), axis=axis)
    return held


def _away_from_edges(facet, usable, near, facet_group, enough):
    """(H, W) bool: usable pixels away from edges, by the widest margin that a group can afford. near : of `_margins`"""
    n_facets, widest = len(facet_group), len(near) - 1
    at_margin = [usable & ~grown for grown in near]
    count = [np.bincount(facet[mask], minlength=n_facets) for mask in at_margin]
    margin = np.full(n_facets, widest)
    for narrower in range(widest - 1, -1, -1):
        group_count = np.bincount(facet_group, count[narrower + 1], int(facet_group.max()) + 1)
        poor = (margin == narrower + 1) & (count[narrower + 1] < enough) & (group_count[facet_group] < 2 * enough)
        margin[poor] = narrower
    mask = np.zeros(facet.shape, bool)
    for m, candidates in enumerate(at_margin):
        mask |= candidates & (margin[facet] == m) & (facet >= 0)
    return mask


def _display(photograph):
    """Values as a screen shows them (H, W, C), black (H, W) and saturated (H, W) pixels."""
    values = photograph.values
    if photograph.linear:
        bright = np.percentile(values, 99) if values.size else 1.0
        display = np.clip(values / max(bright, 1e-300), 0, 4) ** (1 / 2.2)
        return display, photograph.black, np.zeros(values.shape[:2], bool)
    return values, photograph.black, (values >= 250 / 255 - 1e-9).any(axis=2)


def _local_mean(planes, labels, steps):
    """[(H, W)]: each plane averaged over pixels of the same label at these steps along rows, then along columns."""
    same = {
        (axis, step): (labels[shifted(axis, step)[0]] == labels[shifted(axis, step)[1]]).astype(np.float32)
        for axis in (1, 0)
        for step in steps
        if step < labels.shape[axis]
    }
    total = [np.ones(labels.shape, np.float32), *(np.asarray(plane, np.float32) for plane in planes)]
    for axis in (1, 0):
        for i, source in enumerate(total):
            total[i] = source.copy()
            for step in steps:
                if step < labels.shape[axis]:
                    here, there = shifted(axis, step)
                    total[i][here] += source[there] * same[axis, step]
                    total[i][there] += source[here] * same[axis, step]
    return [plane / total[0] for plane in total[1:]]


def _mean_of_others(planes, labels, steps):
    """As _local_mean, but of blocks of the other colour of a chessboard; of all where none of those is near."""
    y, x = np.indices(labels.shape, sparse=True)
    light = ((y // BLOCK_PX + x // BLOCK_PX) % 2 == 0).astype(np.float32)
    of_light = _local_mean([light, *(plane * light for plane in planes)], labels, steps)
    of_all = _local_mean(planes, labels, steps)
    share = np.where(light > 0, 1 - of_light[0], of_light[0])
    alone = share < 1e-3
    share[alone] = 1
    for k, (everywhere, lit) in enumerate(zip(of_all, of_light[1:], strict=True)):
        of_all[k] = np.where(alone, everywhere, np.where(light > 0, everywhere - lit, lit) / share)
    return of_all


def _canny(display, labels, edge_noise):
    """(H, W) bool: Canny's edges of the photograph inside the facets; between facets the index buffer has them.

    Everything is measured on one facet at a time: the gradient of the smoothed picture less its mean in the
    surroundings, in standard deviations of the facet's noise. Shading changes over many pixels, an edge within few. The
    noise is the median of the second difference, which shading leaves alone.
    """
    import cv2

    planes = [np.ascontiguousarray(plane, np.float32) for plane in np.moveaxis(display, 2, 0)]
    smooth = _local_mean(_local_mean(planes, labels, (1, 2)), labels, (1,))
    strongest = None
    for gradient in _gradients_in_noise(planes, smooth, labels):
        around = _local_mean([np.clip(g, -4 * edge_noise, 4 * edge_noise) for g in gradient], labels, (3, 6))
        gradient = [g - mean for g, mean in zip(gradient, around, strict=True)]
        size = gradient[0] ** 2 + gradient[1] ** 2
        if strongest is None:
            strongest, best = gradient, size
        else:
            strongest = [np.where(size > best, g, old) for g, old in zip(gradient, strongest, strict=True)]
            best = np.maximum(best, size)
    gx, gy = (np.clip(16 * g, -30000, 30000).astype(np.int16) for g in strongest)
    return cv2.Canny(gx, gy, 8 * edge_noise, 16 * edge_noise, L2gradient=True) > 0


def _gradients_in_noise(planes, smooth, labels):
    """Yields [d/dx, d/dy] of each smoothed plane, (H, W), in standard deviations of the facet's noise.

    0 across edges between facets.
    """
    import cv2

    order = np.argsort(labels[1:-1, 1:-1], axis=None, kind="stable")
    sorted_labels = labels[1:-1, 1:-1].ravel()[order]
    ends = np.flatnonzero(np.diff(sorted_labels, prepend=-1, append=-1))
    after = 0.06  # standard deviation of the gradient below for white noise of 1
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    for plane, soft in zip(planes, smooth, strict=True):
        second = np.abs(cv2.filter2D(plane, cv2.CV_32F, kernel)[1:-1, 1:-1].ravel()[order])
        sigma = np.full(int(labels.max()) + 1, 1 / 255, np.float32)  # a step of an 8-bit picture
        for a, b in itertools.pairwise(ends):
            sigma[sorted_labels[a]] = max(sigma[sorted_labels[a]], np.median(second[a:b]) / 0.6745)
        gradient = []
        for axis in (1, 0):
            here, there = shifted(axis, 2)
            middle = tuple(slice(1, -1) if k == axis else slice(None) for k in (0, 1))
            g = np.zeros_like(soft)
            inside = (labels[here] == labels[there]) & (labels[here] == labels[middle])
            g[middle] = np.where(inside, (soft[there] - soft[here]) / 2, 0) if soft.shape[axis] > 2 else 0
            gradient.append(g / (after * sigma[labels]))
        yield gradient


def _flattest(mean, facet, mask, n_facets, keep, least):
    """Of each facet's pixels in mask, the part `keep` (but at least `least`) nearest to I = a + b x + c y.

    All channels count together.
    """
    y, x = np.nonzero(mask)
    owner = facet[y, x]
    number = np.bincount(owner, minlength=n_facets)
    safe = np.maximum(number, 1)
    average = lambda v: np.bincount(owner, v, n_facets) / safe
    u, v = x - average(x)[owner], y - average(y)[owner]
    uu, uv, vv = average(u * u), average(u * v), average(v * v)
    ridge = 1e-9 * (uu + vv) + 1e-9  # one pixel, one line: no slope across it
    uu, vv = uu + ridge, vv + ridge
    determinant = uu * vv - uv * uv
    error = np.zeros(len(y))
    for channel in range(mean.shape[2]):
        value = mean[y, x, channel].astype(float)
        value -= average(value)[owner]
        p, q = average(u * value), average(v * value)
        b, c = (p * vv - q * uv) / determinant, (q * uu - p * uv) / determinant
        error += (value - b[owner] * u - c[owner] * v) ** 2
    order = np.lexsort((error, owner))
    place = np.arange(len(y)) - np.repeat(np.cumsum(number) - number, number)
    wanted = np.minimum(number, np.maximum(np.ceil(keep * number), least)).astype(int)
    chosen = order[place < wanted[owner[order]]]
    result = np.zeros(mask.shape, bool)
    result[y[chosen], x[chosen]] = True
    return result
