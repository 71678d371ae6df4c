"""Planes where a surface is textured: dense stereo (semi-global matching), then a robust plane through each region.

In a plain room semi-global matching invents disparities between the borders. So it is asked only where a region shows
more than noise and the light's own slope, and only planes that most of such pixels agree with are believed.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lib.vision.facets.intensities_kernels import LevelArrays
from lib.vision.matching import Stereo

TEXTURED = 0.25  # of a region's pixels must have a slope beyond noise: plain rooms have up to .16
AGREE_PX = 0.75  # between a pixel's disparity and the plane's
LEAST_INLIERS = 0.7  # of the textured pixels must agree
LEAST_PIXELS = 60  # that are textured and have a disparity
TRIED = 100  # planes through three pixels
JUDGES = 1000  # pixels that judge them
STEPS = 5  # of reweighted least squares
LOCKED_PX = 0.1  # disparities are drawn to whole pixels: sigma that is common to a region
TILE = 16  # px: neighbours err together
LEAST_TILES = 7
WINDOW_PX = 5  # semi-global matching compares windows of this edge
SUBPIXELS = 16  # OpenCV's unit of disparity
MOST_SHARE = 0.3  # of the picture's width that disparities may span
FLAT_PIXELS, FLAT_STEPS = 2000, 6  # of the robust cubic
TUKEY = 4.7  # standard deviations at which a residual has no weight


def textured(level: LevelArrays, pixels) -> np.ndarray:
    """Those of a region's flat pixels that show texture; none where they are too small a part of it.

    The slope of the light is none: what a robust cubic through the region explains.
    """
    width, channels = level.left.shape[1:]
    slope = level.slope.reshape(-1, channels)[pixels]
    steep = lambda s: pixels[(np.abs(s) > level.least).any(axis=1)]
    enough = lambda found: len(found) >= max(LEAST_PIXELS, TEXTURED * len(pixels))
    if not enough(steep(slope)):
        return pixels[:0]
    found = steep(slope - _slope_of_light(level.left.reshape(-1, channels)[pixels], pixels % width, pixels // width))
    return found if enough(found) else pixels[:0]


def _slope_of_light(values, x, y):
    """(n, C) slope along x of a robust cubic through values (n, C) at x, y (n,)."""
    size = max(np.ptp(x), np.ptp(y), 1) / 2
    X, Y, one, none = (x - x.mean()) / size, (y - y.mean()) / size, np.ones(len(x)), np.zeros(len(x))
    terms = np.stack([one, X, Y, X * X, X * Y, Y * Y, X**3, X * X * Y, X * Y * Y, Y**3], axis=1)
    slopes = np.stack([none, one, none, 2 * X, Y, none, 3 * X * X, 2 * X * Y, Y * Y, none], axis=1) / size
    some = slice(None, None, max(1, len(x) // FLAT_PIXELS))
    result = np.empty_like(values)
    for c in range(values.shape[1]):
        w = np.ones(len(x[some]))
        for _ in range(FLAT_STEPS):
            root = np.sqrt(w)
            found = np.linalg.lstsq(terms[some] * root[:, None], values[some, c] * root, rcond=1e-9)[0]
            e = values[some, c] - terms[some] @ found
            w = np.maximum(1 - (e / (TUKEY * (1.4826 * np.median(np.abs(e)) + 1e-6))) ** 2, 0) ** 2 + 1e-9
        result[:, c] = slopes @ found
    return result


class DensePlane(NamedTuple):
    """plane : (a, b, c) at uv0;  A : (3, 3) of it in units of (size, size, 1), as contours.Measured.A

    places : (n, 3) (u - u0, v - v0, 1) of the pixels that agree;  share : which they are of the textured ones
    """

    plane: np.ndarray
    A: np.ndarray
    places: np.ndarray
    share: float

    def apart(self, plane) -> float:
        """px, rms: how far another plane (a, b, c) at uv0 lies from it, at its pixels."""
        return float(np.sqrt(((self.places @ (plane - self.plane)) ** 2).mean()))


@dataclass(frozen=True, eq=False)
class Disparities:
    """(H, W) of the left photograph: disparity in rectified px, nan where there is none; u, v as matching's views."""

    u: np.ndarray
    v: np.ndarray
    disparity: np.ndarray

    def plane(self, pixels, uv0, size: float, rng) -> DensePlane | None:
        """Through a region's textured pixels (n,), flat; None where too few have a disparity or agree.

        uv0, size : px, of the region;  rng : chooses three pixels at a time
        """
        d = self.disparity.ravel()[pixels]
        known = np.isfinite(d)
        if known.sum() < max(LEAST_PIXELS, LEAST_INLIERS * len(pixels)):
            return None
        pixels, d = pixels[known], d[known]
        x = self._places(pixels, uv0) / [size, size, 1]
        three = rng.integers(0, len(d), (TRIED, 3))
        three = three[np.abs(np.linalg.det(x[three])) > 1e-2]
        if len(three) == 0:
            return None
        planes = np.linalg.solve(x[three], d[three][..., None])[..., 0]
        judges = slice(None, None, max(1, len(d) // JUDGES))
        best = planes[(np.abs(x[judges] @ planes.T - d[judges, None]) < AGREE_PX).sum(axis=0).argmax()]
        for _ in range(STEPS):
            w = np.maximum(1 - ((x @ best - d) / (2 * AGREE_PX)) ** 2, 0) ** 2
            best = np.linalg.lstsq(x * np.sqrt(w)[:, None], d * np.sqrt(w), rcond=1e-9)[0]
        e = x @ best - d
        agree = np.abs(e) < AGREE_PX
        if agree.mean() < LEAST_INLIERS:
            return None
        A = self._information(x[agree], e[agree], pixels[agree])
        return (
            None
            if A is None
            else DensePlane(best / [size, size, 1], A, x[agree] * [size, size, 1], float(agree.mean()))
        )

    def _information(self, x, e, pixels):
        """(3, 3); None where the pixels lie in too few tiles to tell how much they err together."""
        width = self.u.shape[1]
        tile = np.unique(pixels // width // TILE * width + pixels % width // TILE, return_inverse=True)[1]
        if tile.max() + 1 < LEAST_TILES:
            return None
        A = x.T @ x
        inverse = np.linalg.pinv(A)
        scores = np.stack([np.bincount(tile, e * x[:, k]) for k in range(3)], axis=1)
        n = len(scores)
        together = np.einsum("ti,ij,tj", scores, inverse, scores) / 3 * n / (n - 3)
        return np.linalg.inv(inverse * max(together, e.var()) + np.diag([1e-12, 1e-12, LOCKED_PX**2]))

    def _places(self, pixels, uv0):
        """(n, 3) (u - u0, v - v0, 1)."""
        u, v = self.u.ravel()[pixels], self.v.ravel()[pixels]
        return np.column_stack([u - uv0[0], v - uv0[1], np.ones(len(u))])


def disparities(pair: Stereo, views, values, span) -> Disparities:
    """Of the whole left photograph.

    views : matching's, left and right;  values : two (H, W, C) in [0, 1];  span : least and greatest disparity, px
    """
    import cv2

    u, v = views[0].u, views[0].v
    height, width = u.shape
    u_low, v_low = np.nanmin(u), np.nanmin(v)
    wide, high = int(np.ceil(np.nanmax(u) - u_low)) + 1, int(np.ceil(np.nanmax(v) - v_low)) + 1
    low = int(np.floor(span[0]))
    number = int(np.ceil((min(span[1], low + MOST_SHARE * width) - low) / 16)) * 16
    grid = np.stack(np.meshgrid(np.arange(wide) + u_low, np.arange(high) + v_low), axis=-1)
    rectified = []
    for side, picture in zip(("left", "right"), values, strict=True):
        q = pair.photograph(grid, side).astype(np.float32)
        grey = (255 * picture.mean(axis=2)).astype(np.float32)
        drawn = cv2.remap(grey, q, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        rectified.append(np.clip(np.round(drawn), 0, 255).astype(np.uint8))
    matcher = cv2.StereoSGBM_create(
        minDisparity=low,
        numDisparities=number,
        blockSize=WINDOW_PX,
        P1=8 * WINDOW_PX**2,
        P2=32 * WINDOW_PX**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=50,
        speckleRange=1,
    )
    found = matcher.compute(*rectified).astype(np.float32)
    found[found < SUBPIXELS * low] = np.nan
    q = np.stack([u - u_low, v - v_low], axis=-1).astype(np.float32)
    here = cv2.remap(found / SUBPIXELS, q, None, cv2.INTER_NEAREST, borderValue=np.nan)
    return Disparities(u, v, here)
