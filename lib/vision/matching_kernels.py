"""Compiled: rows of regions, outline planes, overlap, and the candidates of each region."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit


class RegionArrays(NamedTuple):
    """One photograph's regions, in rectified pixels. N = the largest label; index 0 is label 1."""

    pixels: np.ndarray  # (N,) area in the photograph
    mean: np.ndarray  # (N, C) colour
    centre: np.ndarray  # (N, 2) mean (u, v); nan where a pixel cannot be rectified
    low: np.ndarray  # (N,) first row
    high: np.ndarray  # (N,) last row
    cut: np.ndarray  # (N,) bool: touches the picture's border
    row_start: np.ndarray  # (N + 1,): row r of region i is row_start[i] + r - low[i]
    ends: np.ndarray  # (rows, 2) least and greatest u in each row; nan where it has no pixel
    whole: np.ndarray  # (rows, 2) bool: that end is not at the picture's border
    order: np.ndarray  # (H W,) flat pixels, region by region
    first: np.ndarray  # (N + 1,): the pixels of region i are order[first[i]:first[i + 1]]


class ViewArrays(NamedTuple):
    """One photograph, its labels and where its pixels lie in the rectified frame."""

    u: np.ndarray  # (H, W) rectified px
    v: np.ndarray  # (H, W) rectified px
    labels: np.ndarray  # (H, W) int, 0 = nothing
    values: np.ndarray  # (H, W, C) in [0, 1]
    R: np.ndarray  # (3, 3) camera axes to rectified axes
    K: np.ndarray  # (3, 3)


@njit()
def rows(labels, u, v, low, row_start, ends, whole):
    """Fills ends and whole of RegionArrays."""
    height, width = labels.shape
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            if label == 0 or np.isnan(v[y, x]):
                continue
            i = label - 1
            row = row_start[i] + int(np.floor(v[y, x])) - low[i]
            inside = 0 < x < width - 1 and 0 < y < height - 1
            if not ends[row, 0] <= u[y, x]:
                ends[row, 0], whole[row, 0] = u[y, x], inside
            if not ends[row, 1] >= u[y, x]:
                ends[row, 1], whole[row, 1] = u[y, x], inside


# -- one pair of regions

TOLERANCE_PX = 1.5  # ends of rows nearer than this agree: the regions are whole pixels
FAR_PX = 2.0  # those farther off do not
TILT = 0.3  # a and b of a facet are of this order: the weak prior of narrow regions
OUTLINED = 0.5  # of the ends of rows must agree, or HIDDEN of them if they are ROWS: most ends of a floor are things
HIDDEN, ROWS = 0.2, 20  # that stand on it
MOST = 1500  # pixels looked at per region for its overlap
ON_LINE_PX, LEAST_APART, TRIED = 2.0, 3.0, 24  # of ends on a line, through two of those tried


@njit()
def solve3(A, b):
    """Cholesky of a 3 x 3 system that is positive definite."""
    l00 = np.sqrt(A[0, 0])
    l10, l20 = A[1, 0] / l00, A[2, 0] / l00
    l11 = np.sqrt(A[1, 1] - l10 * l10)
    l21 = (A[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(A[2, 2] - l20 * l20 - l21 * l21)
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    x2 = y2 / l22
    x1 = (y1 - l21 * x2) / l11
    return (y0 - l10 * x1 - l20 * x2) / l00, x1, x2


@njit()
def row_ends(left, right, i, j, work):
    """(u, v, disparity) of the ends of the rows that left region i and right region j both have, and their number."""
    n = 0
    for row in range(max(left.low[i], right.low[j]), min(left.high[i], right.high[j]) + 1):
        k, l = left.row_start[i] + row - left.low[i], right.row_start[j] + row - right.low[j]
        for end in range(2):
            d = left.ends[k, end] - right.ends[l, end]
            if d == d and left.whole[k, end] and right.whole[l, end]:
                work[n, 0], work[n, 1], work[n, 2] = left.ends[k, end], row + 0.5, d
                n += 1
    return n


@njit()
def outline_plane(left, right, i, j, work):
    """The disparity a u + b v + c that takes the row ends of left region i to those of right region j.

    A robust fit. Returns (a, b, c), the share of the ends that agree with it, and their number.

    work : (n, 3), two for each row that both have
    """
    return plane_of(work, row_ends(left, right, i, j, work))


@njit()
def plane_of(work, n):
    """The disparity that the first n of work (u, v, disparity) have, as outline_plane's."""
    if n < 3:
        return (0.0, 0.0, 0.0), 0.0, n
    u0, v0 = work[:n, 0].mean(), work[:n, 1].mean()
    a, b, c = 0.0, 0.0, np.median(work[:n, 2])
    scale = 16.0
    A, g = np.zeros((3, 3)), np.zeros(3)
    for _ in range(12):
        A[:] = 0
        g[:] = 0
        A[0, 0] = A[1, 1] = 1 / TILT**2
        for k in range(n):
            u, v, d = work[k, 0] - u0, work[k, 1] - v0, work[k, 2]
            e = (d - a * u - b * v - c) / scale
            w = 1 / (1 + e * e) ** 2
            A[0, 0] += w * u * u
            A[1, 0] += w * u * v
            A[1, 1] += w * v * v
            A[2, 0] += w * u
            A[2, 1] += w * v
            A[2, 2] += w
            g[0] += w * u * d
            g[1] += w * v * d
            g[2] += w * d
        A[2, 2] += 1e-9
        a, b, c = solve3(A, g)
        scale = max(0.6 * scale, TOLERANCE_PX)
    agree = 0
    for k in range(n):
        if abs(work[k, 2] - a * (work[k, 0] - u0) - b * (work[k, 1] - v0) - c) <= TOLERANCE_PX:
            agree += 1
    return (a, b, c - a * u0 - b * v0), agree / n, n


@njit()
def another_plane(left, right, i, j, plane, work):
    """The share of the row ends that are off a plane (a, b, c), agree with one other plane and lie on no one line.

    The upright side of what hides a region is a line: through it goes a plane whatever it is.
    """
    n = row_ends(left, right, i, j, work)
    off = agree = 0
    for k in range(n):
        if abs(work[k, 2] - plane[0] * work[k, 0] - plane[1] * work[k, 1] - plane[2]) > FAR_PX:
            work[off] = work[k]
            off += 1
    (a, b, c), _, _ = plane_of(work, off)
    for k in range(off):
        if abs(work[k, 2] - a * work[k, 0] - b * work[k, 1] - c) <= TOLERANCE_PX:
            work[agree] = work[k]
            agree += 1
    return (agree - on_one_line(work, agree)) / max(n, 1)


@njit()
def on_one_line(ends, n):
    """How many of the first n of ends (u, v, disparity) lie on the line in (u, v) that holds most of them."""
    most, step = min(n, 1), max(1, n // TRIED)
    for p in range(0, n, step):
        for q in range(p + step, n, step):
            du, dv = ends[q, 0] - ends[p, 0], ends[q, 1] - ends[p, 1]
            length = np.sqrt(du * du + dv * dv)
            if length < LEAST_APART:
                continue
            held = 0
            for k in range(n):
                held += abs((ends[k, 0] - ends[p, 0]) * dv - (ends[k, 1] - ends[p, 1]) * du) <= ON_LINE_PX * length
            most = max(most, held)
    return most


@njit()
def overlap(regions, there, here, i, j, plane, f_px, sign):
    """How region i, taken into the other picture by the plane (a, b, c), fares there.

    regions, here : of the picture that region i is in;  there : the other picture, which has region j
    sign : 1 from left to right, -1 from right to left

    Of the pixels of i that are seen in the other picture: the share that lands in region j; the mean difference of
    colour of those that do; and the share that is seen of all.
    """
    a, b, c = plane
    u, v, R, K = here.u, here.v, there.R, there.K
    order, first = regions.order, regions.first
    height, width = there.labels.shape
    channels = here.values.shape[2]
    step = max(1, (first[i + 1] - first[i]) // MOST)
    seen = inside = total = 0
    difference = 0.0
    for k in range(first[i], first[i + 1], step):
        p = order[k]
        y, x = p // u.shape[1], p % u.shape[1]
        total += 1
        on_right = u[y, x] - (a * u[y, x] + b * v[y, x] + c)
        on_left = (u[y, x] + b * v[y, x] + c) / (1 - a)
        u2 = on_right if sign > 0 else on_left
        d0, d1, d2 = u2 / f_px, v[y, x] / f_px, 1.0
        z = R[0, 2] * d0 + R[1, 2] * d1 + R[2, 2] * d2
        if z <= 0:
            continue
        qx = K[0, 0] * (R[0, 0] * d0 + R[1, 0] * d1 + R[2, 0] * d2) / z + K[0, 2]
        qy = K[1, 1] * (R[0, 1] * d0 + R[1, 1] * d1 + R[2, 1] * d2) / z + K[1, 2]
        ix, iy = int(np.floor(qx + 0.5)), int(np.floor(qy + 0.5))
        if ix < 0 or iy < 0 or ix >= width or iy >= height:
            continue
        seen += 1
        if there.labels[iy, ix] == j + 1:
            inside += 1
            for ch in range(channels):
                difference += abs(here.values[y, x, ch] - there.values[iy, ix, ch])
    return inside / max(seen, 1), difference / max(inside * channels, 1), seen / total


# Why a region has no partner, in the order in which it is asked.
REASONS = (
    "too small",
    "along the baseline",
    "nothing in the epipolar band",
    "no such colour",
    "other size or place",
    "no plane in front of both cameras",
    "other outline",
    "left does not cover right",
    "too little alike",
    "not mutual",
    "ambiguous",
)
(SMALL, ALONG, BAND, COLOUR, SIZE, BEHIND, OUTLINE, COVER, ALIKE, MUTUAL, AMBIGUOUS) = range(len(REASONS))


class Candidates(NamedTuple):
    """Every pair of regions that may match, and how far each region came (an index into REASONS)."""

    left: np.ndarray  # (n,) index of the left region
    right: np.ndarray  # (n,)
    similarity: np.ndarray  # (n,) in [0, 1]
    plane: np.ndarray  # (n, 3) disparity a u + b v + c
    left_reason: np.ndarray  # (N_left,)
    right_reason: np.ndarray  # (N_right,)


@njit()
def candidates(left, right, left_view, right_view, by_row, f_px, smallest, colour):
    """Candidates of all left regions.

    by_row : right regions of at least `smallest` pixels, by their first row
    colour : the largest difference of the means of a channel
    """
    found_i, found_j, found_s, found_p = [0], [0], [0.0], [(0.0, 0.0, 0.0)]
    far, far_right = np.full(len(left.pixels), SMALL), np.full(len(right.pixels), SMALL)
    tallest = 0
    for j in by_row:
        far_right[j] = BAND
        tallest = max(tallest, right.high[j] - right.low[j])
    lows = right.low[by_row]
    work = np.empty((2 * (2 + most_rows(left)), 3))
    for i in range(len(left.pixels)):
        if left.pixels[i] < smallest:
            continue
        if np.isnan(left.centre[i, 0]):
            far[i] = ALONG
            continue
        far[i] = BAND
        extent = left.high[i] - left.low[i] + 1
        slack = 2 + int(0.1 * extent)
        reach = extent if left.cut[i] else slack
        k = np.searchsorted(lows, left.low[i] - max(reach, 2 + tallest // 2))
        while k < len(by_row) and lows[k] <= left.high[i]:
            j = by_row[k]
            k += 1
            if np.isnan(right.centre[j, 0]):
                far_right[j] = ALONG
                continue
            if not rows_agree(left, right, i, j, slack):
                continue
            reason, similarity, plane = compare(left, right, left_view, right_view, i, j, f_px, colour, work)
            if reason == ALIKE:
                found_i.append(i)
                found_j.append(j)
                found_s.append(similarity)
                found_p.append(plane)
            far[i] = max(far[i], reason)
            far_right[j] = max(far_right[j], reason)
    return Candidates(
        np.array(found_i)[1:], np.array(found_j)[1:], np.array(found_s)[1:], np.array(found_p)[1:], far, far_right
    )


@njit()
def most_rows(regions):
    most = 0
    for i in range(len(regions.low)):
        most = max(most, regions.high[i] - regions.low[i])
    return most


@njit()
def rows_agree(left, right, i, j, slack):
    """Do both regions span the same rows, to `slack`? Where the picture's border cuts one, half of them is enough."""
    if left.cut[i] or right.cut[j]:
        common = min(left.high[i], right.high[j]) - max(left.low[i], right.low[j]) + 1
        union = max(left.high[i], right.high[j]) - min(left.low[i], right.low[j]) + 1
        return common >= 0.5 * union
    return abs(left.low[i] - right.low[j]) <= slack and abs(left.high[i] - right.high[j]) <= slack


@njit()
def largest_difference(a, b):
    worst = 0.0
    for c in range(len(a)):
        worst = max(worst, abs(a[c] - b[c]))
    return worst


@njit()
def compare(left, right, left_view, right_view, i, j, f_px, colour, work):
    """How far the pair comes (an index into REASONS; ALIKE: all the way), its similarity and its plane."""
    none = (0.0, 0.0, 0.0)
    if not largest_difference(left.mean[i], right.mean[j]) <= colour:
        return COLOUR, 0.0, none
    cut = left.cut[i] or right.cut[j]
    ratio = left.pixels[i] / right.pixels[j]
    most = 4.0 if cut else 2.0
    if not (ratio < most and ratio * most > 1 and (left.centre[i, 0] > right.centre[j, 0] or cut)):
        return SIZE, 0.0, none
    plane, agree, n = outline_plane(left, right, i, j, work)
    if not (n >= 6 and (agree >= OUTLINED or (agree >= HIDDEN and agree * n >= ROWS))):
        return OUTLINE, 0.0, none
    a, b, c = plane
    if not (a < 0.9 and a * left.centre[i, 0] + b * left.centre[i, 1] + c > 0):
        return BEHIND, 0.0, none
    there, off, seen = overlap(left, right_view, left_view, i, j, plane, f_px, 1)
    back, off2, seen2 = overlap(right, left_view, right_view, j, i, plane, f_px, -1)
    if not (min(there, back) >= 0.5 and min(seen, seen2) >= 0.25):
        return COVER, 0.0, none
    cover = intersection_over_union(there, back)
    return ALIKE, cover * np.sqrt(max(agree, OUTLINED)) * np.exp(-0.5 * (0.5 * (off + off2) / colour) ** 2), plane


@njit()
def intersection_over_union(there, back):
    """Of two regions, from the share of each that lies in the other."""
    return there * back / (there + back - there * back)
