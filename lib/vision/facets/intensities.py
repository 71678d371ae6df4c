"""Planes from texture: the picture inside a region, left against right, with a gain and an offset per channel."""

from dataclasses import dataclass

import numpy as np

from lib.vision.facets import intensities_kernels as kernels

# -- intensities

SMOOTH_PX = (2.0, 0.8)  # coarse to fine: the last one measures, the first ones bring the start near
TEXTURE = 4.5  # times the noise of a gradient: what is less says nothing, and would pretend to
ALIKE = 0.6  # of the left photograph's slopes the right one must show: texture gives 1, noise 0
MOST_PIXELS = 20000


@dataclass(frozen=True, eq=False)
class _Level:
    """Both photographs, smoothed, and the left one's slope along the epipolar lines: (H, W, C) each; noise of a slope."""

    left: np.ndarray
    slope: np.ndarray
    right: np.ndarray
    slope_noise: float


def smoothed_levels(pair, values, sigma):
    import cv2

    uv = pair.rectified(pair.left.pixels(), "left")
    step = pair.photograph(uv + [0.5, 0], "left") - pair.photograph(uv - [0.5, 0], "left")  # d pixel / d u
    levels = []
    for smooth in SMOOTH_PX:
        left, right = (
            cv2.GaussianBlur(v, (0, 0), smooth, borderType=cv2.BORDER_REPLICATE).reshape(v.shape) for v in values
        )
        gy, gx = np.gradient(left, axis=(0, 1))
        slope = gx * step[..., :1] + gy * step[..., 1:]
        impulse = np.zeros((33, 33))
        impulse[16, 16] = 1
        gain = np.sqrt((np.gradient(cv2.GaussianBlur(impulse, (0, 0), smooth))[1] ** 2).sum())
        levels.append(_Level(left, np.nan_to_num(slope), right, gain * sigma))
    return levels


def texture_plane(pair, level, split, labels, l, r, pixels, plane, uv0, size, iterations):
    """(plane, A, b = 0) from the intensities at `pixels` (indices) of the left region, at one level; None where they say too little.

    A : (3, 3) as _Measured.A, divided by the residuals' variance and by how much neighbours err together.
    """
    channels = level.left.shape[2]
    pixels = np.ascontiguousarray(pixels[:: max(1, len(pixels) * channels // MOST_PIXELS)])
    rows = np.empty((len(pixels) * channels, 8))
    gain, offset = np.ones(channels), np.zeros(channels)
    R = np.ascontiguousarray(pair.R_rect_right)
    plane, unit = plane.copy(), np.array([size, size, 1.0])
    for iteration in range(iterations):
        n = kernels.texture_rows(
            plane,
            *uv0,
            pixels,
            *split[0],
            level.left,
            level.slope,
            level.right,
            labels[1],
            r,
            TEXTURE * level.slope_noise,
            pair.f_px,
            R,
            pair.right.K,
            gain,
            offset,
            rows,
        )
        if n < 60:
            return None
        x = rows[:n]
        scale = 1.4826 * np.median(np.abs(x[:, 5])) + 1e-9
        w = np.maximum(1 - (x[:, 5] / (4.7 * scale)) ** 2, 0) ** 2
        channel = x[:, 4].astype(int)
        J = np.zeros((n, 3 + 2 * channels))
        J[:, :3] = x[:, :3] / unit
        J[np.arange(n), 3 + channel], J[np.arange(n), 3 + channels + channel] = -x[:, 3], -1
        A = (J * w[:, None]).T @ J
        A[np.diag_indices_from(A)] += (
            np.r_[np.full(3, 1e-9 * A[:3, :3].trace()), np.full(2 * channels, 1e-4 * w.sum())] + 1e-12
        )
        step = -np.linalg.solve(A, J.T @ (w * x[:, 5]))
        limit = min(1.0, 2.0 / (np.abs(step[:3]).sum() + 1e-12))
        plane = plane + limit * step[:3] / unit
        gain, offset = gain + limit * step[3 : 3 + channels], offset + limit * step[3 + channels :]
        if plane[0] > 0.9:
            return None
        if np.abs(step[:3]).sum() < 1e-3:
            break
    # Is it texture? Then the right photograph has the left one's slopes. Noise has not, however steep.
    sides = []
    for shift in (-0.5, 0.5):
        more = np.empty_like(rows)
        k = kernels.texture_rows(
            plane + [0, 0, shift],
            *uv0,
            pixels,
            *split[0],
            level.left,
            level.slope,
            level.right,
            labels[1],
            r,
            TEXTURE * level.slope_noise,
            pair.f_px,
            R,
            pair.right.K,
            gain,
            offset,
            more,
        )
        more = more[:k]
        sides.append((((more[:, 7] * labels[0].shape[1] + more[:, 6]) * channels + more[:, 4]).astype(np.int64), more))
    _, before, after = np.intersect1d(sides[0][0], sides[1][0], return_indices=True)
    mine, theirs = sides[0][1][before, 2], sides[1][1][after, 5] - sides[0][1][before, 5]
    if len(mine) < 60 or not mine @ theirs > ALIKE * (mine @ mine):
        return None
    e = x[:, 5] + J @ step
    s = 1.4826 * np.median(np.abs(e - np.median(e))) + 1e-9
    mix = np.linalg.solve(A[3:, 3:], A[3:, :3])  # what gain and offset take away
    P = J[:, :3] - J[:, 3:] @ mix
    information = (P * w[:, None]).T @ P
    # Neighbours err together (smoothing, interpolation, what the plane does not explain): sums over tiles show how much, but for what
    # reaches across the tiles' edges; and Tukey's weights make the minimum flatter than the weighted squares are.
    for side in (16, 8):
        tile = np.unique((x[:, 7] // side) * 1e5 + x[:, 6] // side, return_inverse=True)[1]
        if tile.max() >= 24:
            break
    if tile.max() < 6:
        return None
    z2 = np.minimum((e / (4.7 * scale)) ** 2, 1)
    steep = (P**2).sum(axis=1)
    flat = max(float(((1 - z2) * (1 - 5 * z2)) @ steep / (w @ steep)), 0.3)
    scores = np.stack([np.bincount(tile, w * e * P[:, k]) for k in range(3)], axis=1)
    together = (
        np.einsum("ti,ij,tj", scores, np.linalg.pinv(information), scores)
        / 3
        * len(scores)
        / (len(scores) - 3)
        * (1 + 0.9 / side) ** 2
    )
    return plane, information * flat**2 / max(together, s * s)
