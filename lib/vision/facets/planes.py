"""§2.3 Reconstruction: the plane of each matched pair of regions, with its covariance.

    found = reconstruct(pair, labels, values, left_label, right_label)

A facet is a plane m . x = 1 in the left camera's frame (m = n / d), three unknowns. In rectified pixels (lib/matching.py)
its disparity is f_px baseline m . x_rect = a u + b v + c: whatever is measured, a border or a texture, says what the
disparity is at a place, and that is *linear* in m. So one weighted least-squares system per facet collects

    contours      where the region's border lies, to a part of a pixel, in both pictures, along its normal
    intensities   the texture inside, left against right, with a gain and an offset per channel

each weighed by its own noise, and its inverse is the covariance.
"""

from dataclasses import dataclass, replace

import numpy as np

from lib.vision import matching
from lib.vision import matching_kernels as kernels
from lib.vision.facets.borders import borders, noise, of
from lib.vision.facets.contours import LEAST_POINTS, Measured, away, contour_plane, parts
from lib.vision.facets.facets_file import outline
from lib.vision.facets.intensities import smoothed_levels, texture_plane

# -- from measurements to facets


@dataclass(frozen=True, eq=False)
class Facet:
    """One plane, left camera's axes.

    m : (3,)            m . x = 1 on the plane, 1 / unit               covariance : (3, 3) of m
    polygon : (P, 3)    the left region's outline on the plane         overlap : intersection over union of left, taken over, and right
    rms_px : px         how far the borders lie apart, along their normals
    """

    left_label: int
    right_label: int
    m: np.ndarray
    covariance: np.ndarray
    polygon: np.ndarray
    overlap: float
    rms_px: float

    @property
    def plane(self):
        """(n, d): n . x = d, n unit and towards the camera, so d < 0."""
        d = -1 / np.linalg.norm(self.m)
        return self.m * d, d


@dataclass(frozen=True, eq=False)
class Refused:
    left_label: int
    right_label: int
    why: str


LEAST_OVERLAP = 0.6
THIN = 5.0  # px: of thinner regions both borders lie in one blur
MOST_TILT = 0.2  # rad: the normal must be known better than this, and the distance better than this part of it


def reconstruct(pair, labels, values, left, right, *, iterations=30, intensities=True, progress=None):
    """Facets and Refused of the pairs (left[k], right[k]), and how far sides of outlines were found to be off (px).

    labels, values : of the left and the right photograph
    iterations : of the contours, at most; intensities : also measure the texture inside (both for the curves of error against time)
    """
    regions = [matching.regions(pair, *x) for x in zip(labels, values, ("left", "right"))]
    sigma = [noise(v, x) for v, x in zip(values, labels)]
    edges = [
        borders(pair, x, v, wanted, side, s)
        for x, v, wanted, side, s in zip(labels, values, (left, right), ("left", "right"), sigma)
    ]
    uv = [pair.rectified(c.pixels(), side) for c, side in ((pair.left, "left"), (pair.right, "right"))]
    split = [tuple(np.ascontiguousarray(x[..., k]) for k in (0, 1)) for x in uv]
    levels = smoothed_levels(pair, values, sigma[0]) if intensities else []
    measured = []
    for done, (l, r) in enumerate(zip(left, right), 1):
        measured.append(_measure(pair, labels, regions, edges, levels, split, int(l), int(r), iterations))
        if progress:
            progress(done / len(left))
    together = _together([x for x in measured if not isinstance(x, str)])
    measured = [x if isinstance(x, str) else x.widened(together) for x in measured]
    sigma_side = _side_sigma([x for x in measured if not isinstance(x, str)])
    ordinary = _ordinary_rms([x for x in measured if not isinstance(x, str)])
    found, refused = [], []
    for l, r, x in zip(left, right, measured):
        answer = (
            x
            if isinstance(x, str)
            else _facet(
                pair, labels, values, regions, edges, split, int(l), int(r), x, _own_side_sigma(x, sigma_side, ordinary)
            )
        )
        (found.append(answer) if isinstance(answer, Facet) else refused.append(Refused(int(l), int(r), answer)))
    return found, refused, sigma_side


def _measure(pair, labels, regions, edges, levels, split, l, r, iterations):
    """_Measured, or why not."""
    start, agree, n = matching.outline_plane(*regions, l - 1, r - 1)
    if n < 6:
        return "no rows in common"
    mine, other = of(edges[0], l), of(edges[1], r)
    if len(mine[0]) < LEAST_POINTS or len(other[0]) < LEAST_POINTS:
        return "no border inside the picture"
    u0, v0 = mine[0].mean(axis=0)
    size = float(max(np.sqrt(mine[0].var(axis=0).sum()), 1.0))
    if min(2 * x.pixels[k - 1] / max(e.first[k + 1] - e.first[k], 1) for x, e, k in zip(regions, edges, (l, r))) < THIN:
        return "condition: too thin"
    q = edges[0].q[edges[0].first[l] : edges[0].first[l + 1]]
    part = parts(labels[0], l, q)
    start = start + [0, 0, start[0] * u0 + start[1] * v0]
    contours = contour_plane(start, (u0, v0), size, mine, other, part, 4.0, iterations)

    # Texture: wherever no well located border is near, for that is measured already.
    located = contours.rows if contours else np.empty((0, 10))
    pixels = regions[0].order[regions[0].first[l - 1] : regions[0].first[l]]
    pixels = away(labels[0].shape, pixels, q[mine[3] < np.maximum(0.5, 3 * mine[2])])
    plane = contours.plane if contours else start
    texture = None
    for level in levels:
        texture = texture_plane(pair, level, split, labels, l, r, pixels, plane, (u0, v0), size, 15)
        if texture is None:
            break
        plane = texture[0]
    if contours is None and texture is None:
        return "borders do not meet"
    x = contours or Measured(
        plane,
        np.array([u0, v0]),
        size,
        np.zeros((3, 3)),
        np.zeros(3),
        np.zeros((1, 3)),
        np.zeros(1),
        np.zeros(1),
        0.0,
        0,
        0.0,
        located,
    )
    return replace(x, texture=texture)


def _with_sides(x, sigma_side):
    """Normal matrix, right-hand side (at x.plane), residual square and log determinant where each side of the outline is off by
    sigma_side px as a whole."""
    if sigma_side == 0:
        return x.A, x.b, x.square, 0.0
    k = 1 / (x.C + 1 / sigma_side**2)
    return (
        x.A - np.einsum("p,pi,pj->ij", k, x.B, x.B),
        x.b - (k * x.D) @ x.B,
        x.square - float((k * x.D**2).sum()),
        float(np.log1p(sigma_side**2 * x.C).sum()),
    )


def _together(measured):
    """How much more (or less) the scores of neighbouring border points add up than independent ones would: their variance over 16 px of
    a side against the sum of their variances, mean over the pair's facets."""
    ratios = []
    for x in measured:
        if len(x.rows) == 0:
            continue
        cell = np.unique(
            (x.rows[:, 6] * 4096 + x.rows[:, 8] // 16 % 64) * 64 + x.rows[:, 9] // 16 % 64, return_inverse=True
        )[1]
        if cell.max() < 7:
            continue
        J = x.rows[:, :3] / [x.size, x.size, 1]
        w = x.rows[:, 4]
        scores = np.stack([np.bincount(cell, w * x.rows[:, 3] * J[:, k]) for k in range(3)], axis=1)
        own = np.stack([[np.bincount(cell, w * J[:, p] * J[:, q]) for p in range(3)] for q in range(3)]).transpose(
            2, 0, 1
        )
        inverse = np.linalg.pinv(own.sum(axis=0))
        fitted = np.einsum("cij,cji", inverse @ own, inverse @ own)  # what the fit has taken out of the residuals
        if fitted < 2:
            alone = (w * x.rows[:, 3]) ** 2 @ np.einsum("ki,ij,kj->k", J, inverse, J)
            if alone > 0:
                ratios.append(np.einsum("ci,ij,cj", scores, inverse, scores) / alone * 3 / (3 - fitted))
    return float(np.clip(np.mean(ratios), 0.5, 16)) if ratios else 1.0


def _side_sigma(measured):
    """How far sides of outlines are off as a whole (slivers too thin to see, blur that differs from left to right): px.

    One number for the pair, by restricted maximum likelihood: what is common to a side's points cannot be told from the facet's own
    disparity in one facet, but over all facets it can, for a facet has more sides than unknowns.
    """
    grid = np.array([0, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.065, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3])
    cost = np.zeros((len(measured), len(grid)))
    for i, x in enumerate(measured):
        for k, s in enumerate(grid):
            A, b, square, volume = _with_sides(x, s)
            A = A + 1e-9 * np.eye(3)
            cost[i, k] = square - b @ np.linalg.solve(A, b) + volume + np.linalg.slogdet(A)[1]
    return float(grid[cost.sum(axis=0).argmin()]) if len(measured) else 0.0


MISFIT = 1.5  # times the ordinary rms of the pair's borders: what lies farther apart is not one plane's


def _ordinary_rms(measured):
    """How far borders lie apart (px, rms) on facets that are what they seem: the lower quartile of the pair, for in some pairs
    most regions are not."""
    rms = [x.rms_px for x in measured if x.points]
    return float(np.quantile(rms, 0.25)) if rms else 0.0


def _own_side_sigma(x, sigma_side, ordinary):
    """How far this facet's sides may be off as a whole, px.

    A region that is not one plane, or that ends at a shadow, an isophote of shading or an occluder, has sides that move with
    disparities of their own. The fit spends three unknowns on few sides, so what the plane leaves over is all that shows it; and it
    errs along whole sides, not point by point: more points do not average it away. So a facet whose borders lie farther apart than
    the pair's do, beyond what chance makes of a dozen points, carries all of that distance as an error of each side."""
    return float(np.hypot(sigma_side, x.rms_px)) if x.points and x.rms_px > MISFIT * ordinary else sigma_side


def _disagreement(x, A, b):
    """Where borders and texture contradict each other beyond 95 % of chance, how much wider the covariance must be: >= 1.

    A, b : of both. With x = -A^-1 b, and the same of the texture alone, the step between them has the covariance T^-1 - A^-1."""
    if x.texture is None or x.points == 0:
        return 1.0
    T = x.texture[1]
    step = np.linalg.pinv(T) @ (T @ ((x.plane - x.texture[0]) * [x.size, x.size, 1])) - np.linalg.pinv(A) @ b
    spread = np.linalg.pinv(T) - np.linalg.pinv(A)
    return max(1.0, float(step @ np.linalg.pinv(spread, rcond=1e-6, hermitian=True) @ step) / 7.81)


def _facet(pair, labels, values, regions, edges, split, l, r, x, sigma_side):
    """Facet, or why not."""
    (u0, v0), unit = x.uv0, np.array([x.size, x.size, 1])
    A, b, square, _ = _with_sides(x, sigma_side)
    w, V = np.linalg.eigh(A)
    if not w[0] > 1e-9 * w[2]:
        return "condition: its borders run along the epipolar lines, or in one line"
    inverse = (V / w) @ V.T
    plane = x.plane - inverse @ b / unit
    # (a, b, c at the centre) to m, left frame: linear.
    to_m = (
        pair.R_rect_left.T
        @ np.diag([1, 1, 1 / pair.f_px])
        @ np.array([[1, 0, 0], [0, 1, 0], [-u0, -v0, 1]])
        / pair.baseline
    )
    covariance = to_m @ (inverse / unit / unit[:, None]) @ to_m.T * _disagreement(x, A, b)
    m = to_m @ plane
    if not (m @ _middle(pair, (u0, v0)) > 0):
        return "not in front of the cameras"
    if np.sqrt(np.linalg.eigvalsh(covariance)[-1]) > MOST_TILT * np.linalg.norm(m):
        return "condition: distance or direction not known"
    a, b, c = plane - [0, 0, plane[0] * u0 + plane[1] * v0]
    own = slice(edges[0].first[l], edges[0].first[l + 1])
    polygon = outline(labels[0], l, pair.left, m, edges[0].q[own], edges[0].sigma[own])
    if a >= 0.95 or polygon is None:
        return "through a camera's centre"
    overlap = _mutual(pair, labels, values, regions, split, l, r, a, b, c)
    if overlap < LEAST_OVERLAP:
        return "overlap: left does not cover right"
    return Facet(l, r, m, covariance, polygon, overlap, x.rms_px)


def _middle(pair, uv0):
    """The direction, left frame, of a place in rectified pixels."""
    return pair.R_rect_left.T @ np.array([uv0[0] / pair.f_px, uv0[1] / pair.f_px, 1.0])


def _mutual(pair, labels, values, regions, split, l, r, a, b, c):
    (lu, lv), (ru, rv) = split
    R = [np.ascontiguousarray(x) for x in (pair.R_rect_left, pair.R_rect_right)]
    there, _, _ = kernels.overlap(
        l - 1,
        r - 1,
        a,
        b,
        c,
        pair.f_px,
        R[1],
        pair.right.K,
        lu,
        lv,
        regions[0].order,
        regions[0].first,
        labels[1],
        *values,
        1,
    )
    back, _, _ = kernels.overlap(
        r - 1,
        l - 1,
        a,
        b,
        c,
        pair.f_px,
        R[0],
        pair.left.K,
        ru,
        rv,
        regions[1].order,
        regions[1].first,
        labels[0],
        *values[::-1],
        -1,
    )
    return there * back / (there + back - there * back) if there * back > 0 else 0.0


def warm_up():
    """Compile, or load, the kernels."""
    matching.warm_up()
    pair, labels, values = matching.toy()
    reconstruct(pair, labels, values, np.array([2]), np.array([2]))
