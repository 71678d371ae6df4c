"""Compiled: how far two regions cover each other, carried into each other's picture by a plane, and its maximum."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit
from lib.vision import matching_kernels as kernels

LEAST_SEEN = 0.25  # of a region's pixels must be carried into the other picture, or nothing is said
FLAT_PX = 0.01  # a simplex that is no larger has converged


class Carried(NamedTuple):
    """One region's pixels and the picture into which the plane carries them."""

    du: np.ndarray  # (n,) rectified px from the centre
    dv: np.ndarray  # (n,)
    there: np.ndarray  # (H, W) labels of the other picture
    wanted: int  # label of the other region
    R: np.ndarray  # (3, 3) the other camera's axes to rectified axes
    K: np.ndarray  # (3, 3)


@njit()
def share_inside(region, plane, centre, f_px, sign):
    """Of the pixels that the plane carries into the other picture, the share that lands in the other region.

    Between pixels the other region is interpolated (bilinear), so the share is a continuous function of the plane.
    Returns it and the share of the pixels that land in the picture.
    """
    a, b, c = plane
    R, K = region.R, region.K
    height, width = region.there.shape
    inside, seen = 0.0, 0
    for k in range(len(region.du)):
        du, dv = region.du[k], region.dv[k]
        du = du - (a * du + b * dv + c) if sign > 0 else (du + b * dv + c) / (1 - a)
        d0, d1 = (du + centre[0]) / f_px, (dv + centre[1]) / f_px
        z = R[0, 2] * d0 + R[1, 2] * d1 + R[2, 2]
        if z <= 0:
            continue
        qx = K[0, 0] * (R[0, 0] * d0 + R[1, 0] * d1 + R[2, 0]) / z + K[0, 2]
        qy = K[1, 1] * (R[0, 1] * d0 + R[1, 1] * d1 + R[2, 1]) / z + K[1, 2]
        if not (0 <= qx < width - 1 and 0 <= qy < height - 1):
            continue
        ix, iy = int(qx), int(qy)
        fx, fy = qx - ix, qy - iy
        seen += 1
        inside += (1 - fy) * (
            (1 - fx) * (region.there[iy, ix] == region.wanted) + fx * (region.there[iy, ix + 1] == region.wanted)
        )
        inside += fy * (
            (1 - fx) * (region.there[iy + 1, ix] == region.wanted)
            + fx * (region.there[iy + 1, ix + 1] == region.wanted)
        )
    return inside / max(seen, 1), seen / max(len(region.du), 1)


@njit()
def mutual_overlap(plane, centre, left, right, f_px):
    """Intersection over union of both regions under the plane (a, b, c at the centre): 0 to 1."""
    if plane[0] >= 0.9:  # at 1 it goes through the right camera's centre
        return 0.0
    there, seen = share_inside(left, plane, centre, f_px, 1)
    back, seen_back = share_inside(right, plane, centre, f_px, -1)
    if min(seen, seen_back) < LEAST_SEEN or there * back <= 0:
        return 0.0
    return kernels.intersection_over_union(there, back)


@njit()
def maximise(plane, centre, size, reach, steps, left, right, f_px):
    """The plane of maximal mutual overlap near a plane, and that overlap: a simplex (Nelder and Mead 1965).

    The overlap has kinks where borders meet, and no slope that would tell its maximum.

    size : px, of the region: one unit of a and b moves a border as far as one of c
    reach : px, of the first simplex;  steps : at most
    """
    unit = np.array([size, size, 1.0])
    x = np.empty((4, 3))
    value = np.empty(4)
    for k in range(4):
        x[k] = plane * unit
        if k > 0:
            x[k, k - 1] += reach
        value[k] = mutual_overlap(x[k] / unit, centre, left, right, f_px)
    for _ in range(steps):
        order = np.argsort(-value)
        x, value = x[order], value[order]
        if np.abs(x[1:] - x[0]).max() < FLAT_PX:
            break
        middle = (x[0] + x[1] + x[2]) / 3
        away = middle - x[3]
        tried = middle + away
        v = mutual_overlap(tried / unit, centre, left, right, f_px)
        if v > value[0]:
            farther = middle + 2 * away
            w = mutual_overlap(farther / unit, centre, left, right, f_px)
            if w > v:
                tried, v = farther, w
        elif v <= value[2]:
            tried = middle + (0.5 * away if v > value[3] else -0.5 * away)
            w = mutual_overlap(tried / unit, centre, left, right, f_px)
            if w <= max(v, value[3]):
                for k in range(1, 4):
                    x[k] = 0.5 * (x[0] + x[k])
                    value[k] = mutual_overlap(x[k] / unit, centre, left, right, f_px)
                continue
            v = w
        x[3], value[3] = tried, v
    best = np.argmax(value)
    return x[best] / unit, value[best]
