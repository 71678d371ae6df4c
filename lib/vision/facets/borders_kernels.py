"""Compiled: border points of regions, located along rows and columns."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit

REACH = 3  # px: a border's profile reaches so far to either side
WORST = 1.5  # px: the area under a profile that locates a border no better does not locate it
SURE = 1.0  # px: points better than this are held against each other, worse ones only weighed
# Where the sides of a border are no two colours it lies at its steepest place: within NEAR px, steeper than the profile
# ENDS px to either side, and than noise, by these factors. STEEPEST (px): what lies beside an edge moves that place.
ENDS, NEAR, STEEP_ENDS, STEEP_NOISE, STEEPEST = 4, 2, 2.5, 3.0, 0.25
# Pixels on a border between two colours lie so near the line between them, as a part of the contrast; gamma bends it.
MIXED = 0.1


class Picture(NamedTuple):
    """What a border is located in."""

    values: np.ndarray  # (H, W, C) in [0, 1]
    labels: np.ndarray  # (H, W) int
    noise: float  # standard deviation


class Crossing(NamedTuple):
    """From the pixel (x, y) a step (dx, dy) along a row or a column leads across a border."""

    y: int
    x: int
    dy: int
    dx: int


class BorderPoints(NamedTuple):
    """Points of the borders of regions."""

    q: np.ndarray  # (n, 2) px (x, y)
    normal: np.ndarray  # (n, 2) outward, coarse
    sigma: np.ndarray  # (n,) px along the normal
    owner: np.ndarray  # (n,) label


@njit()
def borders(picture, wanted):
    """BorderPoints of the labels that are wanted: (n + 1,) bool.

    A border between two pixels is located along the row or the column, whichever crosses it more steeply, from the area
    under the profile: exact for straight edges however the lens and the pixels blur them, as long as they blur evenly.
    """
    labels = picture.labels
    height, width, channels = picture.values.shape
    most = count_crossings(labels, wanted)
    points = BorderPoints(np.empty((most, 2)), np.empty((most, 2)), np.empty(most), np.empty(most, np.int64))
    inner, outer = np.empty(channels), np.empty(channels)
    n = 0
    for y in range(height):
        for x in range(width):
            if not wanted[labels[y, x]]:
                continue
            for k in range(4):
                at = Crossing(y, x, (0, 0, 1, -1)[k], (1, -1, 0, 0)[k])
                if not crosses(labels, at):
                    continue
                gx, gy = outward_normal(labels, at)
                steep = gx * at.dx + gy * at.dy
                if steep < 0.6 or notched(labels, at):  # the other axis crosses it more steeply
                    continue
                t, sigma = locate(picture, at, inner, outer)
                if sigma == np.inf:
                    continue
                points.q[n, 0], points.q[n, 1] = x + t * at.dx, y + t * at.dy
                points.normal[n, 0], points.normal[n, 1] = gx, gy
                points.sigma[n], points.owner[n] = sigma * steep, labels[y, x]
                n += 1
    return BorderPoints(points.q[:n], points.normal[:n], points.sigma[:n], points.owner[:n])


@njit()
def crosses(labels, at):
    """Is there a pixel of another label one step away?"""
    height, width = labels.shape
    y, x = at.y + at.dy, at.x + at.dx
    return 0 <= y < height and 0 <= x < width and labels[y, x] != labels[at.y, at.x]


@njit()
def count_crossings(labels, wanted):
    height, width = labels.shape
    n = 0
    for y in range(height):
        for x in range(width):
            if wanted[labels[y, x]]:
                for k in range(4):
                    n += crosses(labels, Crossing(y, x, (0, 0, 1, -1)[k], (1, -1, 0, 0)[k]))
    return n


@njit()
def outward_normal(labels, at):
    """(x, y) from the region's share of a 7 x 7 window around either pixel; (0, 0) where it has none."""
    height, width = labels.shape
    label = labels[at.y, at.x]
    gx = gy = 0.0
    for j in range(-3, 4):
        for i in range(-3, 4):
            for step in range(2):
                y, x = at.y + step * at.dy + j, at.x + step * at.dx + i
                if 0 <= y < height and 0 <= x < width and labels[y, x] == label:
                    gx -= i
                    gy -= j
    length = np.sqrt(gx * gx + gy * gy)
    if length == 0:
        return 0.0, 0.0
    return gx / length, gy / length


@njit()
def notched(labels, at):
    """Does the region come again behind the border? A ragged border counts once per line, at its outermost pixel."""
    height, width = labels.shape
    for t in range(2, REACH + 1):
        y, x = at.y + t * at.dy, at.x + t * at.dx
        if 0 <= y < height and 0 <= x < width and labels[y, x] == labels[at.y, at.x]:
            return True
    return False


@njit()
def steps_outside(labels, at):
    """Steps to the first label that lasts: thin slivers on the edge belong to the transition. 0: none lasts."""
    height, width = labels.shape
    for t in range(1, REACH + 1):
        y, x = at.y + t * at.dy, at.x + t * at.dx
        y2, x2 = y + at.dy, x + at.dx
        if not (0 <= y2 < height and 0 <= x2 < width) or labels[y, x] == labels[at.y, at.x]:
            return 0
        if labels[y, x] == labels[y2, x2]:
            return t
    return 0


@njit()
def locate(picture, at, inner, outer):
    """Where the border lies, steps from the pixel, and its sigma, steps: inf where nothing locates it."""
    start = steps_outside(picture.labels, at)
    t, sigma = by_area(picture, at, start, inner, outer) if start else (0.5, np.inf)
    if start == 1 and sigma < np.inf:
        return t, sigma
    # a sliver on the edge may be the blur between two colours or a surface of its own
    steep, sigma_steep = steepest(picture, at)
    return (t if sigma < np.inf and abs(t - steep) < 0.5 else steep), sigma_steep


@njit()
def by_area(picture, at, start, inner, outer):
    """Where the border between two colours lies, from the area under the profile; sigma as in locate."""
    labels = picture.labels
    other = labels[at.y + start * at.dy, at.x + start * at.dx]
    n_in = level(picture, labels[at.y, at.x], Crossing(at.y, at.x, -at.dy, -at.dx), 1, inner)
    n_out = level(picture, other, at, start + 1, outer)
    contrast = 0.0
    for c in range(len(inner)):
        contrast += (inner[c] - outer[c]) ** 2
    if n_in < 2 or n_out < 2 or not contrast > 0:
        return 0.5, np.inf
    area, count = area_under_profile(picture, at, start, inner, outer, contrast)
    if not count:
        return 0.5, np.inf
    located = 0.5 - REACH + area
    spread = picture.noise * np.sqrt((count + REACH**2 * (1 / n_in + 1 / n_out)) / contrast)
    return (located, spread) if spread < WORST and abs(located - 0.5 * start) < 2 else (0.5, np.inf)


@njit()
def steepest(picture, at):
    """Where the picture changes most steeply near a border: the innermost such place. Returns as locate.

    For borders whose two sides are not two colours: the edge of a board, or a contact shadow, lies between.
    """
    values = picture.values
    height, width, channels = values.shape
    g = np.zeros(2 * ENDS + 1)
    for k in range(-ENDS, ENDS + 1):
        for c in range(channels):
            d = 0.0
            for line in range(-1, 2):
                y, x = at.y + k * at.dy + line * at.dx, at.x + k * at.dx + line * at.dy
                y2, x2 = y + at.dy, x + at.dx
                if min(y, x, y2, x2) < 0 or max(y, y2) >= height or max(x, x2) >= width:
                    return 0.5, np.inf
                d += values[y2, x2, c] - values[y, x, c]
            g[k + ENDS] += (d / 3) ** 2
    g = np.sqrt(g)
    least = max(STEEP_ENDS * 0.5 * (g[0] + g[-1]), STEEP_NOISE * picture.noise)
    for k in range(-NEAR, NEAR + 1):
        i = k + ENDS
        if g[i] > least and g[i] >= g[i - 1] and g[i] > g[i + 1]:
            total = g[i - 1] + g[i] + g[i + 1]
            spread = 1.15 * picture.noise / total  # of four independent means of three pixels
            return k + 0.5 + (g[i + 1] - g[i - 1]) / total, np.sqrt(spread**2 + STEEPEST**2)
    return 0.5, np.inf


@njit()
def level(picture, label, at, start, out):
    """Mean colour of the pixels of one label beside a border, into out; returns their number.

    They lie start .. start + REACH - 1 steps away, on two lines to either side, and none is next to another label.
    """
    values, labels = picture.values, picture.labels
    height, width, channels = values.shape
    n = 0
    out[:] = 0
    for step in range(start, start + REACH):
        for line in range(-2, 3):
            y, x = at.y + step * at.dy + line * at.dx, at.x + step * at.dx + line * at.dy
            if y < 0 or x < 0 or y >= height or x >= width or labels[y, x] != label:
                continue
            if beside_another(labels, y, x):
                continue
            for c in range(channels):
                out[c] += values[y, x, c]
            n += 1
    for c in range(channels):
        out[c] /= max(n, 1)
    return n


@njit()
def beside_another(labels, y, x):
    """Is one of the four neighbours of another label?"""
    height, width = labels.shape
    label = labels[y, x]
    return (
        (y > 0 and labels[y - 1, x] != label)
        or (y + 1 < height and labels[y + 1, x] != label)
        or (x > 0 and labels[y, x - 1] != label)
        or (x + 1 < width and labels[y, x + 1] != label)
    )


@njit()
def area_under_profile(picture, at, start, inner, outer, contrast):
    """Sum over REACH pixels to either side of their share of the inner colour, and their number.

    (0, 0) where a pixel shows a third colour, or belongs to a third region that is no sliver on the edge.
    """
    values, labels, noise = picture.values, picture.labels, picture.noise
    height, width, channels = values.shape
    label, other = labels[at.y, at.x], labels[at.y + start * at.dy, at.x + start * at.dx]
    mixed = np.sqrt(contrast)
    area, count = 0.0, 0
    for t in range(1 - REACH, start + REACH):
        y, x = at.y + t * at.dy, at.x + t * at.dx
        if not (0 <= y < height and 0 <= x < width):
            return 0.0, 0
        if labels[y, x] != label and labels[y, x] != other and not 0 < t < start:
            return 0.0, 0
        share = 0.0
        for c in range(channels):
            share += (values[y, x, c] - outer[c]) * (inner[c] - outer[c])
        share /= contrast
        aside = 0.0  # how far off the line between the two colours
        for c in range(channels):
            aside = max(aside, abs(values[y, x, c] - outer[c] - share * (inner[c] - outer[c])))
        if aside > 4.5 * noise + MIXED * mixed or abs(share - 0.5) > 0.5 + MIXED + 4.5 * noise / mixed:
            return 0.0, 0
        area += share
        count += 1
    return area, count


@njit()
def straighten(uv, normal, first):
    """Normals from the line through each point's neighbours within 5 px, and how far those lie off it (px, rms).

    uv, normal : (n, 2), grouped by label and sorted by v;  first : the points of label l are first[l]:first[l + 1]
    """
    off = np.full(len(uv), np.inf)
    better = normal.copy()
    for i in range(len(first) - 1):
        for k in range(first[i], first[i + 1]):
            n, su, sv, suu, suv, svv = 0, 0.0, 0.0, 0.0, 0.0, 0.0
            j = k
            while j > first[i] and uv[j - 1, 1] > uv[k, 1] - 5:
                j -= 1
            while j < first[i + 1] and uv[j, 1] < uv[k, 1] + 5:
                du, dv = uv[j, 0] - uv[k, 0], uv[j, 1] - uv[k, 1]
                if du * du + dv * dv < 25 and normal[j, 0] * normal[k, 0] + normal[j, 1] * normal[k, 1] > 0.7:
                    n += 1
                    su += du
                    sv += dv
                    suu += du * du
                    suv += du * dv
                    svv += dv * dv
                j += 1
            if n < 4:
                continue
            suu, suv, svv = suu / n - (su / n) ** 2, suv / n - su * sv / n**2, svv / n - (sv / n) ** 2
            mean, half = 0.5 * (suu + svv), np.sqrt(0.25 * (suu - svv) ** 2 + suv**2)
            if mean + half < 1.0:  # neighbours on one spot
                continue
            off[k] = np.sqrt(max(mean - half, 0.0))
            angle = 0.5 * np.arctan2(2 * suv, suu - svv)
            nu, nv = -np.sin(angle), np.cos(angle)
            if nu * normal[k, 0] + nv * normal[k, 1] < 0:
                nu, nv = -nu, -nv
            better[k, 0], better[k, 1] = nu, nv
    return better, off
