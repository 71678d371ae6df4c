"""Planes from texture: the picture inside a region, left against right, with a gain and an offset per channel."""

from typing import NamedTuple

import numpy as np

from lib.vision.facets import intensities_kernels as kernels
from lib.vision.facets.intensities_kernels import CHANNEL, LEFT, RESIDUAL, LevelArrays, X, Y
from lib.vision.matching import Stereo, ViewArrays

SMOOTH_PX = (2.0, 0.8)  # coarse to fine: the last one measures, the first ones bring the start near
TEXTURE = 4.5  # times the noise of a gradient: what is less says nothing, and would pretend to
ALIKE = 0.6  # of the left photograph's slopes the right one must show: texture gives 1, noise 0
MOST_PIXELS = 20000
LEAST_EQUATIONS = 60
ITERATIONS = 15
TUKEY = 4.7  # standard deviations at which a residual has no weight
MOST_SLOPE = 0.9  # of the disparity along u; at 1 the plane goes through the right camera's centre


def smoothed_levels(pair: Stereo, values, sigma: float) -> list[LevelArrays]:
    """Both photographs as they are compared, coarse to fine.

    values : two (H, W, C) in [0, 1];  sigma : standard deviation of the left one's noise
    """
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
        levels.append(LevelArrays(left, np.nan_to_num(slope), right, TEXTURE * (gain * sigma)))
    return levels


class _Comparison:
    """The pixels of one left region against one right region, at one level."""

    def __init__(self, views, f_px, level, wanted, pixels, uv0):
        self.channels = level.left.shape[2]
        self.width = level.left.shape[1]
        pixels = np.ascontiguousarray(pixels[:: max(1, len(pixels) * self.channels // MOST_PIXELS)])
        self.given = uv0, pixels, level, *views, wanted, f_px
        self.most = len(pixels) * self.channels

    def rows(self, plane, light):
        """(n, kernels.COLUMNS) equations at a plane (a, b, c), gain and offset."""
        rows = np.empty((self.most, kernels.COLUMNS))
        return rows[: kernels.texture_rows(plane, *self.given, light, rows)]


class _Solution(NamedTuple):
    """The last step of the iteration to a plane. The unknowns are (a, b, c), gains, offsets."""

    plane: np.ndarray  # (3,) after the step
    light: tuple  # gain (C,), offset (C,), after the step
    rows: np.ndarray  # (n, kernels.COLUMNS), before it
    J: np.ndarray  # (n, 3 + 2 C)
    A: np.ndarray  # (3 + 2 C, 3 + 2 C)
    w: np.ndarray  # (n,) Tukey's weights
    scale: float  # of the residuals
    step: np.ndarray  # (3 + 2 C,)


def texture_plane(views: tuple[ViewArrays, ViewArrays], f_px: float, level, r: int, pixels, plane, uv0, size: float):
    """(plane, A) from the intensities at flat `pixels` of a left region, at one level; None where they say too little.

    r : the right region's label;  plane : (a, b, c) at uv0 to start from;  size : px, of the region
    A : (3, 3) as contours.Measured.A, divided by the residuals' variance and by how much neighbours err together
    """
    comparison = _Comparison(views, f_px, level, r, pixels, uv0)
    found = _solve(comparison, plane, size)
    if found is None or not _is_texture(comparison, found):
        return None
    information = _information(found)
    return None if information is None else (found.plane, information)


def _solve(comparison, plane, size):
    """_Solution; None where too few pixels say anything or the plane goes through the right camera's centre."""
    channels = comparison.channels
    gain, offset = np.ones(channels), np.zeros(channels)
    plane, unit = plane.copy(), np.array([size, size, 1.0])
    for _ in range(ITERATIONS):
        x = comparison.rows(plane, (gain, offset))
        n = len(x)
        if n < LEAST_EQUATIONS:
            return None
        scale = 1.4826 * np.median(np.abs(x[:, RESIDUAL])) + 1e-9
        w = np.maximum(1 - (x[:, RESIDUAL] / (TUKEY * scale)) ** 2, 0) ** 2
        channel = x[:, CHANNEL].astype(int)
        J = np.zeros((n, 3 + 2 * channels))
        J[:, :3] = x[:, :3] / unit
        J[np.arange(n), 3 + channel], J[np.arange(n), 3 + channels + channel] = -x[:, LEFT], -1
        A = (J * w[:, None]).T @ J
        A[np.diag_indices_from(A)] += (
            np.r_[np.full(3, 1e-9 * A[:3, :3].trace()), np.full(2 * channels, 1e-4 * w.sum())] + 1e-12
        )
        step = -np.linalg.solve(A, J.T @ (w * x[:, RESIDUAL]))
        limit = min(1.0, 2.0 / (np.abs(step[:3]).sum() + 1e-12))
        plane = plane + limit * step[:3] / unit
        gain, offset = gain + limit * step[3 : 3 + channels], offset + limit * step[3 + channels :]
        if plane[0] > MOST_SLOPE:
            return None
        if np.abs(step[:3]).sum() < 1e-3:
            break
    return _Solution(plane, (gain, offset), x, J, A, w, scale, step)


def _is_texture(comparison, found):
    """Does the right photograph have the left one's slopes? Noise has not, however steep."""
    return _alike(comparison, found.plane, found.light) > ALIKE


def alike(views: tuple[ViewArrays, ViewArrays], f_px: float, level, r: int, pixels, plane, uv0) -> float:
    """How much of the left photograph's slopes the right one shows under a plane (a, b, c) at uv0: texture 1, noise 0.

    As texture_plane takes them; 0 where too few pixels say anything
    """
    comparison = _Comparison(views, f_px, level, r, pixels, uv0)
    one = np.ones(comparison.channels)
    return _alike(comparison, plane, (one, 0 * one))


def _alike(comparison, plane, light):
    before, after = (comparison.rows(plane + [0, 0, shift], light) for shift in (-0.5, 0.5))
    keys = [
        ((x[:, Y] * comparison.width + x[:, X]) * comparison.channels + x[:, CHANNEL]).astype(np.int64)
        for x in (before, after)
    ]
    _, i, j = np.intersect1d(*keys, return_indices=True)
    mine, theirs = before[i, 2], after[j, RESIDUAL] - before[i, RESIDUAL]
    return float(mine @ theirs / (mine @ mine)) if len(mine) >= LEAST_EQUATIONS else 0.0


def _information(found):
    """(3, 3) of (a, b, c) in units of (size, size, 1); None where the pixels lie in too few tiles to tell.

    Neighbours err together (smoothing, interpolation, what the plane does not explain). Sums over tiles show how much,
    but for what reaches across the tiles' edges. And Tukey's weights make the minimum flatter than the weighted squares
    are.
    """
    x, J, A, w = found.rows, found.J, found.A, found.w
    e = x[:, RESIDUAL] + J @ found.step
    s = 1.4826 * np.median(np.abs(e - np.median(e))) + 1e-9
    mix = np.linalg.solve(A[3:, 3:], A[3:, :3])  # what gain and offset take away
    P = J[:, :3] - J[:, 3:] @ mix
    information = (P * w[:, None]).T @ P
    side, tile = _tiles(x)
    if tile.max() < 6:
        return None
    z2 = np.minimum((e / (TUKEY * found.scale)) ** 2, 1)
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
    return information * flat**2 / max(together, s * s)


def _tiles(x):
    """Side of square tiles, px, and each equation's tile: 16 px where that gives 25 tiles, else 8 px."""
    number = lambda side: np.unique((x[:, Y] // side) * 1e5 + x[:, X] // side, return_inverse=True)[1]
    tile = number(16)
    return (16, tile) if tile.max() >= 24 else (8, number(8))
