"""Compiled: rows of regions, outline planes, overlap, and the candidates of each region."""

import numpy as np

from lib.core.compiled import njit


@njit()
def rows(labels, u, v, low, row_start, ends, whole):
    height, width = labels.shape
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            if label == 0 or not v[y, x] == v[y, x]:
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
TILT = 0.3  # a and b of a facet are of this order: the weak prior of narrow regions
MOST = 1500  # pixels looked at per region for its overlap


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
def fit(low, high, l_low, l_start, l_ends, l_whole, r_low, r_start, r_ends, r_whole, work):
    """Robust (a, b, c) from the ends of the rows low..high that both regions have, and the share of the ends that agree with it."""
    n = 0
    for row in range(low, high + 1):
        for end in range(2):
            i, j = l_start + row - l_low, r_start + row - r_low
            d = l_ends[i, end] - r_ends[j, end]
            if d == d and l_whole[i, end] and r_whole[j, end]:
                work[n, 0], work[n, 1], work[n, 2] = l_ends[i, end], row + 0.5, d
                n += 1
    if n < 3:
        return 0.0, 0.0, 0.0, 0.0, n
    u0, v0 = work[:n, 0].mean(), work[:n, 1].mean()
    a, b, c = 0.0, 0.0, np.median(work[:n, 2])
    scale = 16.0
    A, g = np.zeros((3, 3)), np.zeros(3)
    for iteration in range(12):
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
    return a, b, c - a * u0 - b * v0, agree / n, n


@njit()
def overlap(i, j, a, b, c, f, R, K, u, v, order, first, labels, values_from, values_to, sign):
    """Of the pixels of region i that the plane takes into the other picture: the share that lands in region j, the mean
    difference of colour of those that do, and the share that could be seen there."""
    height, width = labels.shape
    step = max(1, (first[i + 1] - first[i]) // MOST)
    seen = inside = total = 0
    difference = 0.0
    for k in range(first[i], first[i + 1], step):
        p = order[k]
        y, x = p // u.shape[1], p % u.shape[1]
        total += 1
        if sign > 0:
            u2 = u[y, x] - (a * u[y, x] + b * v[y, x] + c)
        else:
            u2 = (u[y, x] + b * v[y, x] + c) / (1 - a)
        d0, d1, d2 = u2 / f, v[y, x] / f, 1.0
        z = R[0, 2] * d0 + R[1, 2] * d1 + R[2, 2] * d2
        if z <= 0:
            continue
        qx = K[0, 0] * (R[0, 0] * d0 + R[1, 0] * d1 + R[2, 0] * d2) / z + K[0, 2]
        qy = K[1, 1] * (R[0, 1] * d0 + R[1, 1] * d1 + R[2, 1] * d2) / z + K[1, 2]
        ix, iy = int(np.floor(qx + 0.5)), int(np.floor(qy + 0.5))
        if ix < 0 or iy < 0 or ix >= width or iy >= height:
            continue
        seen += 1
        if labels[iy, ix] == j + 1:
            inside += 1
            for ch in range(values_from.shape[2]):
                difference += abs(values_from[y, x, ch] - values_to[iy, ix, ch])
    return inside / max(seen, 1), difference / max(inside * values_from.shape[2], 1), seen / total


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


@njit()
def candidates(
    smallest,
    colour,
    by_row,
    l_pixels,
    l_mean,
    l_centre,
    l_low,
    l_high,
    l_cut,
    l_start,
    l_ends,
    l_whole,
    l_order,
    l_first,
    l_u,
    l_v,
    l_labels,
    l_values,
    l_R,
    l_K,
    r_pixels,
    r_mean,
    r_centre,
    r_low,
    r_high,
    r_cut,
    r_start,
    r_ends,
    r_whole,
    r_order,
    r_first,
    r_u,
    r_v,
    r_labels,
    r_values,
    r_R,
    r_K,
    f,
):
    """Every pair of regions that may match: (n, 2) indices, (n,) similarity, (n, 3) plane; and how far each left region came."""
    found_i, found_j, found_s, found_p = [0], [0], [0.0], [(0.0, 0.0, 0.0)]
    far = np.full(len(l_pixels), SMALL)
    far_right = np.full(len(r_pixels), SMALL)
    tallest = 0
    for j in range(len(r_pixels)):
        if r_pixels[j] >= smallest:
            far_right[j] = BAND
            tallest = max(tallest, r_high[j] - r_low[j])
    lows = r_low[by_row]
    rows = 0
    for i in range(len(l_pixels)):
        rows = max(rows, l_high[i] - l_low[i])
    work = np.empty((2 * (2 + rows), 3))
    for i in range(len(l_pixels)):
        if l_pixels[i] < smallest:
            continue
        if not l_centre[i, 0] == l_centre[i, 0]:
            far[i] = ALONG
            continue
        far[i] = BAND
        extent = l_high[i] - l_low[i] + 1
        slack = 2 + int(0.1 * extent)
        reach = extent if l_cut[i] else slack
        k = np.searchsorted(lows, l_low[i] - max(reach, 2 + tallest // 2))
        while k < len(by_row) and lows[k] <= l_high[i]:
            j = by_row[k]
            k += 1
            if not r_centre[j, 0] == r_centre[j, 0]:
                far_right[j] = ALONG
                continue
            cut = l_cut[i] or r_cut[j]
            low, high = max(l_low[i], r_low[j]), min(l_high[i], r_high[j])
            union = max(l_high[i], r_high[j]) - min(l_low[i], r_low[j]) + 1
            if cut:
                if high - low + 1 < 0.5 * union:
                    continue
            elif abs(l_low[i] - r_low[j]) > slack or abs(l_high[i] - r_high[j]) > slack:
                continue
            stage = COLOUR
            worst = 0.0
            for ch in range(l_mean.shape[1]):
                worst = max(worst, abs(l_mean[i, ch] - r_mean[j, ch]))
            if worst <= colour:
                stage = SIZE
                ratio = l_pixels[i] / r_pixels[j]
                most = 4.0 if cut else 2.0
                if ratio < most and ratio * most > 1 and (l_centre[i, 0] > r_centre[j, 0] or cut):
                    stage = OUTLINE
                    a, b, c, agree, n = fit(
                        low, high, l_low[i], l_start[i], l_ends, l_whole, r_low[j], r_start[j], r_ends, r_whole, work
                    )
                    if n >= 6 and agree >= 0.5:
                        stage = BEHIND
                        if a < 0.9 and a * l_centre[i, 0] + b * l_centre[i, 1] + c > 0:
                            stage = COVER
                            there, off, seen = overlap(
                                i, j, a, b, c, f, r_R, r_K, l_u, l_v, l_order, l_first, r_labels, l_values, r_values, 1
                            )
                            back, off2, seen2 = overlap(
                                j, i, a, b, c, f, l_R, l_K, r_u, r_v, r_order, r_first, l_labels, r_values, l_values, -1
                            )
                            least = min(there, back)
                            if least >= 0.5 and min(seen, seen2) >= 0.25:
                                stage = ALIKE
                                cover = (
                                    there * back / (there + back - there * back)
                                )  # of two shares: the intersection over the union
                                found_i.append(i)
                                found_j.append(j)
                                found_s.append(
                                    cover * np.sqrt(agree) * np.exp(-0.5 * (0.5 * (off + off2) / colour) ** 2)
                                )
                                found_p.append((a, b, c))
            far[i] = max(far[i], stage)
            far_right[j] = max(far_right[j], stage)
    return np.array(found_i)[1:], np.array(found_j)[1:], np.array(found_s)[1:], np.array(found_p)[1:], far, far_right
