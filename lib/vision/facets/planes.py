"""§2.3 Reconstruction: the plane of each matched pair of regions, with its covariance.

    found = reconstruct(pair, labels, values, left_label, right_label)

A facet is a plane m . x = 1 in the left camera's frame (m = n / d), three unknowns. In rectified pixels
(lib/vision/matching.py) its disparity is f_px baseline m . x_rect = a u + b v + c. Whatever is measured, a border or a
texture, says what the disparity is at a place, and that is *linear* in m (docs/decisions/stereo.md). So one weighted
least-squares system per facet collects

    contours      where the region's border lies, to a part of a pixel, in both pictures, along its normal
    intensities   the texture inside, left against right, with a gain and an offset per channel

Each is weighed by its own noise, and the inverse of the system is the covariance. The paper's own way, the plane of
maximal mutual overlap, is kept beside it (`method`, see overlap.py).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lib.vision import matching
from lib.vision.facets import folds, junctions, overlap, profiles, uncertainty
from lib.vision.facets.borders import Borders, borders, noise, noise_without_texture
from lib.vision.facets.contours import LEAST_POINTS, Measured, away, borders_apart, contour_plane, in_holes, parts
from lib.vision.facets.dense import DensePlane, disparities, textured
from lib.vision.facets.intensities import alike, smoothed_levels, texture_plane
from lib.vision.facets.outlines import outline
from lib.vision.facets.sides import MOST_SLOPE, lines

METHODS = ("least-squares", "overlap")
LEAST_OVERLAP = 0.6
COVERS = 0.92  # mutual overlap from which both regions are one thing
LEAST_ROWS = 6  # ends of rows, for a plane to start from
LEAST_SIDES = 0.1  # share of its straight sides that must agree with a plane, less those behind it
THIN = 5.0  # px: of thinner regions both borders lie in one blur
COARSE = 0.02  # of white: what JPEG may add at edges until facets' sigmas are too small
LOOSE = np.radians(4)  # sigma of the tilt from which a facet is marked: it says where a plane is, hardly how it lies
NEAR_PX, BLURRED_PX = 3, 6  # of borders: nearer, texture is not measured, and the borders' blur is taken for texture
ALIKE = 0.8, 1.25  # of the left photograph's slopes the right one must show under a dense plane
MOST_TILT = 0.2  # rad: the normal must be known better than this, and the distance better than this part of it
SIMPLEX = 5  # steps of the overlap's search for each iteration of a fit
APART_PX = 1.0  # rms: a plane so far from dense stereo's is another's
PLANAR = 0.85  # of the textured pixels on the dense plane: then ends of rows on another are what hides the region
DISPARITY = 1.5, 8.0  # times the starts', and px more: how far dense stereo looks
TWO = "borders of two planes"
TWO_PLANES = 0.14  # of the ends of rows may lie on one other plane, not counting its longest line


@dataclass(frozen=True, eq=False)
class Facet:
    """One plane, left camera's axes.

    m : (3,)            m . x = 1 on the plane, 1 / unit
    covariance : (3, 3) of m
    polygon : (P, 3)    the left region's outline on the plane
    overlap             intersection over union of the right region and the left one, taken over by the plane
    rms_px              how far the borders lie apart, along their normals
    by                  what told it: "contour", "texture" or "both"
    """

    left_label: int
    right_label: int
    m: np.ndarray
    covariance: np.ndarray
    polygon: np.ndarray
    overlap: float
    rms_px: float
    by: str

    @property
    def loose(self) -> bool:
        """The normal's standard deviation, in its worst direction, exceeds LOOSE."""
        length = np.linalg.norm(self.m)
        n = self.m / length
        across = np.eye(3) - np.outer(n, n)
        return bool(np.linalg.eigvalsh(across @ self.covariance @ across)[-1] > (LOOSE * length) ** 2)

    @property
    def plane(self) -> tuple[np.ndarray, float]:
        """(n, d): n . x = d, n unit and towards the camera, so d < 0."""
        d = -1 / np.linalg.norm(self.m)
        return self.m * d, d


@dataclass(frozen=True, eq=False)
class Refused:
    """A pair of regions that gives no facet, and why."""

    left_label: int
    right_label: int
    why: str


class Reconstruction(NamedTuple):
    """facets, refused : of each pair one or the other, in the pairs' order
    side_sigma_px : how far level sides of outlines were found to be off as a whole, px; upright ones 1.8 times as far
    """

    facets: list[Facet]
    refused: list[Refused]
    side_sigma_px: float


def reconstruct(
    pair: matching.Stereo,
    labels,
    values,
    left,
    right,
    *,
    ringing=(0.0, 0.0),
    method: str = "least-squares",
    iterations: int = 30,
    intensities: bool = True,
    progress: Callable | None = None,
    trace: Callable | None = None,
) -> Reconstruction:
    """The planes of the pairs of regions (left[k], right[k]).

    labels : two (H, W) int;  values : two (H, W, C) in [0, 1]
    ringing : standard deviation of what JPEG adds to the two photographs' pixels at edges (image.Photograph.ringing)
    method : of METHODS; "overlap" looks at the regions' whole pixels alone
    iterations : of the contours' fits, at most;  intensities : also measure the texture inside
    progress : called with the share of the work that is done
    trace : called with (step, number of pairs that have a plane, apart) after each step: outline, contours (or
        overlap), texture (once for each level, coarse to fine), sides. apart() measures how far the borders are apart:
        the median over the pairs, px, None where there is none. It takes time that is not the reconstruction's.
    """
    progress = progress or (lambda share: None)
    trace = trace or (lambda step, planes, apart: None)
    sight = _look(pair, labels, values, left, right, ringing)
    fits = [_start(sight, int(l), int(r)) for l, r in zip(left, right, strict=True)]
    _trace_fits(trace, "outline", sight, fits)
    borders_alone = not intensities or method == "overlap"
    levels = [] if borders_alone else smoothed_levels(pair, values, sight.noise[0])
    of_borders = _fit_overlap if method == "overlap" else _fit_contours
    steps = [("overlap" if method == "overlap" else "contours", lambda fit: of_borders(sight, fit, iterations))]
    steps += [("texture", lambda fit, level=level: _fit_texture(sight, fit, level)) for level in levels]
    for s, (name, step) in enumerate(steps):
        if s == 1:  # of the intensities
            fits = _with_dense(sight, fits, values, labels[0], levels[0])
        for k, fit in enumerate(fits):
            fits[k] = fit if isinstance(fit, str) else step(fit)
            progress((s + (k + 1) / len(fits)) / len(steps))
        _trace_fits(trace, name, sight, fits)

    least = overlap.WHOLE_PX if method == "overlap" else 0.0
    measured = [fit if isinstance(fit, str) else fit.measured() for fit in fits]
    measured, side_sigma = _with_uncertainty(sight, values, measured, least)
    _trace_measured(trace, sight, left, right, measured)
    found, refused = [], []
    for l, r, x in zip(left, right, measured, strict=True):
        answer = x if isinstance(x, str) else _facet(sight, int(l), int(r), *x)
        if isinstance(answer, Facet):
            found.append(answer)
        else:
            refused.append(Refused(int(l), int(r), answer))
    return Reconstruction(found, refused, side_sigma)


def _with_uncertainty(sight, values, measured, least):
    """[(Measured, (P,) sigma of its sides) or why not], and the sigma of the pair's sides, at least `least`; px."""
    is_known = lambda x: isinstance(x, Measured)
    factor = max(uncertainty.together([x for x in measured if is_known(x)]), 1.0 if least else 0.0)
    measured = [x.widened(factor) if is_known(x) else x for x in measured]
    if not least:  # whole pixels are off either way
        differ = lambda x: replace(x, unlike=profiles.unlike(sight.pair, values, sight.noise, x))
        measured = [differ(x) if is_known(x) else x for x in measured]
    known = [x for x in measured if is_known(x)]
    shape = lambda x: np.ones(len(x.C)) if least else uncertainty.asides(x)
    sigma = max(uncertainty.side_sigma(known, [shape(x) for x in known]), least)
    ordinary = uncertainty.ordinary_rms(known)
    own = lambda x: uncertainty.own_side_sigma(x, np.hypot(sigma * shape(x), x.unlike), ordinary)
    return [(x, own(x)) if is_known(x) else x for x in measured], sigma


# -- what is measured of each pair of regions


@dataclass(frozen=True, eq=False)
class _Sight:
    """The pair as all its regions see it; tuples are (left, right)."""

    pair: matching.Stereo
    views: tuple[matching.ViewArrays, matching.ViewArrays]
    regions: tuple[matching.RegionArrays, matching.RegionArrays]
    edges: tuple[Borders, Borders]
    noise: tuple[float, float]  # standard deviation of the photographs' noise
    colours: np.ndarray  # (H, W, C) float32 in [0, 1], of the left photograph


def _look(pair, labels, values, left, right, ringing):
    views = matching.views(pair, labels, values)
    sigma = [noise(v, x) for v, x in zip(values, labels, strict=True)]
    at_edges = np.hypot(sigma, ringing)
    edges = (
        borders(pair, labels[0], values[0], left, "left", at_edges[0]),
        borders(pair, labels[1], values[1], right, "right", at_edges[1]),
    )
    return _Sight(
        pair,
        views,
        (matching.regions(views[0]), matching.regions(views[1])),
        edges,
        tuple(sigma),
        np.float32(values[0]),
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """One pair of regions on the way to its plane (a, b, c) at uv0, rectified px.

    size : px, of the region
    contours : what the borders say, or None;  folded : they say two planes that meet inside
    dense : the plane of dense stereo, or None
    texture : (plane, A) of the finest level so far, or None
    textured : no level has yet said too little
    quieter : the noise where it is textured, over that of the whole photograph, which there is texture, too
    pixels : flat, of the left region, for the texture;  inner : those that no border's blur reaches
    """

    l: int
    r: int
    plane: np.ndarray
    uv0: tuple[float, float]
    size: float
    contours: Measured | None = None
    folded: bool = False
    dense: DensePlane | None = None
    texture: tuple | None = None
    textured: bool = True
    quieter: float = 1.0
    pixels: np.ndarray | None = None
    inner: np.ndarray | None = None

    def measured(self):
        """Measured, or why not. Where contour and texture contradict each other, dense stereo decides."""
        texture = self.texture
        if self.dense and (texture is None or self.dense.apart(texture[0]) > APART_PX):
            texture = self.dense.plane, self.dense.A
        if self.contours is None and texture is None:
            return "borders do not meet"
        if self.folded and texture is None:
            return TWO
        nothing = Measured.nothing(self.plane, self.uv0, self.size)
        x = replace(self.contours or nothing, texture=texture, planar=bool(self.dense) and self.dense.share > PLANAR)
        if self.dense and self.contours:
            both = uncertainty.with_sides(x.widened(1.0), 0.0)
            if uncertainty.disagreement(x, both.A, both.b) > 1:
                return replace(nothing, texture=texture, planar=x.planar)
        return x

    def best_plane(self):
        """(a, b, c) at uv0 of all that has been measured so far."""
        x = self.measured()
        if isinstance(x, str):
            return self.plane
        return _best_plane(x, uncertainty.with_sides(x.widened(1.0), 0.0))


def _start(sight, l, r):
    """_Fit with the plane of the row ends, or why there is none."""
    plane, _, n = matching.outline_plane(*sight.regions, l - 1, r - 1)
    if n < LEAST_ROWS:
        return "no rows in common"
    left = sight.edges[0].of(l)
    if min(sight.edges[0].number(l), sight.edges[1].number(r)) < LEAST_POINTS:
        return "no border inside the picture"
    u0, v0 = left.uv.mean(axis=0)
    size = float(max(np.sqrt(left.uv.var(axis=0).sum()), 1.0))
    of_both = zip(sight.regions, sight.edges, (l, r), strict=True)
    if min(2 * regions.pixels[k - 1] / max(edges.number(k), 1) for regions, edges, k in of_both) < THIN:
        return "condition: too thin"
    return _Fit(l, r, plane + [0, 0, plane[0] * u0 + plane[1] * v0], (u0, v0), size)


def _starts(sight, fit):
    """Sides of the left outline, the lines they are in space (or None), and the planes to start from."""
    left, right = sight.edges[0].of(fit.l), sight.edges[1].of(fit.r)
    (q, _), (q_right, _) = sight.edges[0].of_photograph(fit.l), sight.edges[1].of_photograph(fit.r)
    part = parts(sight.views[0].labels, fit.l, q)
    found = lines(left, right, part, parts(sight.views[1].labels, fit.r, q_right), fit.uv0)
    return part, found, [fit.plane] if found is None else found.starts(fit.plane, left, fit.size)


def _fit_overlap(sight, fit, iterations):
    """The plane of maximal mutual overlap, from the same starts."""
    part, found, starts = _starts(sight, fit)
    steps = SIMPLEX * iterations
    plane, _ = overlap.overlap_plane(
        sight.regions, sight.views, fit.l, fit.r, starts, fit.uv0, sight.pair.f_px, fit.size, steps
    )
    edges = sight.edges[0].of(fit.l), sight.edges[1].of(fit.r)
    contours = overlap.measured(plane, fit.uv0, fit.size, *edges, part)
    if found and found.score(plane[None])[0] < LEAST_SIDES:
        contours = None
    return replace(fit, contours=contours, plane=plane)


def _fit_contours(sight, fit, iterations):
    """The borders' plane, and the pixels where the texture is to be measured."""
    left, right = sight.edges[0].of(fit.l), sight.edges[1].of(fit.r)
    q, _ = sight.edges[0].of_photograph(fit.l)
    labels = sight.views[0].labels
    part, found, starts = _starts(sight, fit)
    fitted = lambda start, own=None: contour_plane(start, fit.uv0, fit.size, left, right, part, iterations, own)
    tried = [fitted(start) for start in starts]
    tried += [fitted(start, found.own(start, part.max() + 1)) for start in starts[1:]]
    tried = [x for x in tried if x is not None]
    contours = max(tried, key=lambda x: found.score(x.plane[None])[0]) if len(tried) > 1 else next(iter(tried), None)
    if contours and found and found.score(contours.plane[None])[0] < LEAST_SIDES:
        contours = None
    folded = bool(contours) and folds.folded(sight, fit.l, fit.r, contours.plane, fit.uv0, fit.size, found)
    # Texture: wherever no well located border is near, for that is measured already.
    regions = sight.regions[0]
    pixels = regions.order[regions.first[fit.l - 1] : regions.first[fit.l]]
    located = q[left.bend < np.maximum(0.5, 3 * left.sigma)]
    pixels = away(labels.shape, pixels, located, NEAR_PX)
    inner = away(labels.shape, pixels, located, BLURRED_PX)
    plane = contours.plane if contours else fit.plane
    return replace(fit, contours=contours, folded=folded, plane=plane, pixels=pixels, inner=inner)


def _with_dense(sight, fits, values, labels, level):
    """The fits with planes of dense stereo, where regions are textured. A contour's plane far from it is not theirs.

    Elsewhere the intensities are not asked either: what they see there are penumbras and the blur of borders, and their
    planes are off by four sigma in the median, however few pixels they take.
    """
    quieter = noise_without_texture(values[0], labels, sight.noise[0]) / sight.noise[0]
    level = level.quieter(quieter)
    of = {k: textured(level, fit.inner) for k, fit in enumerate(fits) if not isinstance(fit, str)}
    of = {k: pixels for k, pixels in of.items() if len(pixels)}
    fits = [fit if isinstance(fit, str) else replace(fit, textured=k in of) for k, fit in enumerate(fits)]
    if not of:
        return fits
    starts = [fit.plane[2] for fit in fits if not isinstance(fit, str)]
    dense = disparities(sight.pair, sight.views, values, (0, DISPARITY[0] * np.quantile(starts, 0.9) + DISPARITY[1]))
    rng = np.random.default_rng(0)
    for k, pixels in of.items():
        fit = fits[k]
        found = dense.plane(pixels, fit.uv0, fit.size, rng)
        if found is None:
            continue
        shown = alike(sight.views, sight.pair.f_px, level, fit.r, pixels, found.plane, fit.uv0)
        if not ALIKE[0] < shown < ALIKE[1]:
            continue
        if fit.contours is None or found.apart(fit.plane) > APART_PX:
            fit = replace(fit, contours=None, plane=found.plane)
        fits[k] = replace(fit, dense=found, quieter=quieter)
    return fits


def _fit_texture(sight, fit, level):
    """The plane of the intensities at one level, from that of the level before. One that says too little ends it."""
    if not fit.textured:
        return fit
    level = level.quieter(fit.quieter)
    found = texture_plane(sight.views, sight.pair.f_px, level, fit.r, fit.pixels, fit.plane, fit.uv0, fit.size)
    return replace(fit, textured=False, texture=None) if found is None else replace(fit, texture=found, plane=found[0])


# -- from measurements to facets


def _facet(sight, l, r, x, sigma_side):
    """Facet, or why not."""
    pair, (u0, v0), unit = sight.pair, x.uv0, np.array([x.size, x.size, 1])
    if uncertainty.in_one_line(x):
        return "condition: its borders run in one line"
    if uncertainty.rests_on_holes(x, in_holes(sight.views[0].labels, l)):
        return "condition: held by what stands before it alone"
    equations = uncertainty.with_sides(x, sigma_side)
    A, b = equations.A, equations.b
    w, V = np.linalg.eigh(A)
    if not w[0] > 1e-9 * w[2]:
        return "condition: its borders run along the epipolar lines"
    inverse = (V / w) @ V.T
    step = -inverse @ b
    plane = x.plane + step / unit
    inverse = uncertainty.held_by_sides(x, sigma_side, inverse, step)
    to_m = _m_from_disparity(pair, (u0, v0))
    of_m = lambda C: to_m @ (C / unit / unit[:, None]) @ to_m.T
    covariance = of_m(inverse) * uncertainty.disagreement(x, A, b)
    m = to_m @ plane
    if not (m @ _middle(pair, (u0, v0)) > 0):
        return "not in front of the cameras"
    if np.sqrt(np.linalg.eigvalsh(covariance)[-1]) > MOST_TILT * np.linalg.norm(m):
        return "condition: distance or direction not known"
    here, plane = plane, plane - [0, 0, plane[0] * u0 + plane[1] * v0]  # at (u0, v0), (0, 0)
    polygon = outline(sight.views[0].labels, l, pair.left, m, *sight.edges[0].of_photograph(l))
    if plane[0] >= MOST_SLOPE or polygon is None:
        return "through a camera's centre"
    if not x.planar and matching.another_plane(*sight.regions, l - 1, r - 1, plane) > TWO_PLANES:
        return TWO
    covered = matching.mutual_overlap(sight.regions, sight.views, l - 1, r - 1, plane, pair.f_px)
    if covered < LEAST_OVERLAP:
        return "overlap: left does not cover right"
    doubted = covered < COVERS or junctions.go_on(
        pair, sight.views[0].labels, sight.colours, l, sight.noise[0], x.rows, uncertainty.borders(x)
    )
    turned = uncertainty.turned_about_the_rest(x, here, np.broadcast_to(doubted, 4))
    covariance += of_m(uncertainty.unchecked(x, sigma_side) + turned)
    by = "contour" if x.texture is None else "both" if x.points else "texture"
    return Facet(l, r, m, covariance, polygon, covered, x.rms_px, by)


def _m_from_disparity(pair, uv0):
    """(3, 3): m, left frame, of the disparity (a, b, c) at uv0. It is linear."""
    u0, v0 = uv0
    to_origin = np.array([[1, 0, 0], [0, 1, 0], [-u0, -v0, 1]])
    return pair.R_rect_left.T @ np.diag([1, 1, 1 / pair.f_px]) @ to_origin / pair.baseline


def _middle(pair, uv0):
    """The direction, left frame, of a place in rectified pixels."""
    return pair.R_rect_left.T @ np.array([uv0[0] / pair.f_px, uv0[1] / pair.f_px, 1.0])


# -- the trace


def _trace_fits(trace, step, sight, fits):
    """Those that have a plane so far."""
    fits = [fit for fit in fits if not isinstance(fit, str)]
    trace(step, len(fits), lambda: _apart(sight, [(fit.l, fit.r, fit.best_plane(), fit.uv0) for fit in fits]))


def _trace_measured(trace, sight, left, right, measured):
    """After the sides' errors are known."""
    placed = []
    for l, r, found in zip(left, right, measured, strict=True):
        if not isinstance(found, str):
            x, sigma = found
            placed.append((l, r, _best_plane(x, uncertainty.with_sides(x, sigma)), x.uv0))
    trace("sides", len(placed), lambda: _apart(sight, placed))


def _best_plane(x, equations):
    """(a, b, c) at x.uv0; what the equations do not say stays as it is."""
    return x.plane - np.linalg.pinv(equations.A) @ equations.b / [x.size, x.size, 1]


def _apart(sight, placed):
    """px, the median over pairs of regions of how far their borders are apart; None where none meet.

    placed : [(left label, right label, (a, b, c) at uv0, uv0)]
    """
    apart = [borders_apart(plane, uv0, sight.edges[0].of(l), sight.edges[1].of(r)) for l, r, plane, uv0 in placed]
    apart = [x for x in apart if np.isfinite(x)]
    return float(np.median(apart)) if apart else None


def warm_up():
    """Compile, or load, the kernels."""
    matching.warm_up()
    pair, labels, values = matching.toy()
    reconstruct(pair, labels, values, np.array([2]), np.array([2]))
