"""Compiled: border points of regions, located along rows and columns."""

import numpy as np

from lib.core.compiled import njit

# -- borders of regions to a part of a pixel

REACH = 3  # px: a border's profile reaches so far to either side
WEAK = 2.0  # px: a border that the picture does not locate to 3/4 of this is taken from the labels, whose errors
# of up to half a pixel are the same along a whole stretch: so little is one of its points worth
MIXED = (
    0.1  # of the contrast: pixels on a border between two colours lie so near the line between them (gamma bends it)
)


@njit()
def level(values, labels, label, y, x, dy, dx, start, out):
    """Mean colour of the pixels of one label beside a border: start .. start + REACH steps along (dy, dx), two lines to either
    side, none of them next to another label. Returns their number."""
    height, width, channels = values.shape
    n = 0
    out[:] = 0
    for step in range(start, start + REACH):
        for line in range(-2, 3):
            yy, xx = y + step * dy + line * dx, x + step * dx + line * dy
            if yy < 0 or xx < 0 or yy >= height or xx >= width or labels[yy, xx] != label:
                continue
            if (
                (yy > 0 and labels[yy - 1, xx] != label)
                or (yy + 1 < height and labels[yy + 1, xx] != label)
                or (xx > 0 and labels[yy, xx - 1] != label)
                or (xx + 1 < width and labels[yy, xx + 1] != label)
            ):
                continue
            for c in range(channels):
                out[c] += values[yy, xx, c]
            n += 1
    for c in range(channels):
        out[c] /= max(n, 1)
    return n


@njit()
def borders(labels, values, wanted, noise):
    """Points of the borders of the wanted labels: (n, 2) px (x, y), (n, 2) outward normal (coarse), (n,) sigma px, (n,) label.

    A border between two pixels is located along the row or the column, whichever crosses it more steeply, from the area
    under the profile: exact for straight edges however the lens and the pixels blur them, as long as they blur evenly.
    """
    height, width, channels = values.shape
    most = 0
    for y in range(height):
        for x in range(width):
            if wanted[labels[y, x]]:
                for k in range(4):
                    dy, dx = (0, 0, 1, -1)[k], (1, -1, 0, 0)[k]
                    if 0 <= y + dy < height and 0 <= x + dx < width and labels[y + dy, x + dx] != labels[y, x]:
                        most += 1
    point, normal, sigma, owner, beyond = (
        np.empty((most, 2)),
        np.empty((most, 2)),
        np.empty(most),
        np.empty(most, np.int64),
        np.empty(most, np.int64),
    )
    inner, outer = np.empty(channels), np.empty(channels)
    n = 0
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            if not wanted[label]:
                continue
            for k in range(4):
                dy, dx = (0, 0, 1, -1)[k], (1, -1, 0, 0)[k]
                if not (0 <= y + dy < height and 0 <= x + dx < width) or labels[y + dy, x + dx] == label:
                    continue
                # The outward normal, from the region's share of a 7 x 7 window.
                gx = gy = 0.0
                for j in range(-3, 4):
                    for i in range(-3, 4):
                        if (
                            0 <= y + dy + j < height
                            and 0 <= x + dx + i < width
                            and labels[y + dy + j, x + dx + i] == label
                        ):
                            gx -= i
                            gy -= j
                        if 0 <= y + j < height and 0 <= x + i < width and labels[y + j, x + i] == label:
                            gx -= i
                            gy -= j
                length = np.sqrt(gx * gx + gy * gy)
                if length == 0:
                    continue
                gx /= length
                gy /= length
                along = gx * dx + gy * dy
                if along < 0.6:  # the other axis crosses it more steeply
                    continue
                # Outside: the first label that lasts; thin slivers on the edge belong to the transition.
                start, notch = 0, False
                for t in range(2, REACH + 1):
                    yy, xx = y + t * dy, x + t * dx
                    notch |= 0 <= yy < height and 0 <= xx < width and labels[yy, xx] == label
                if notch:  # a ragged border counts once per line, at its outermost pixel
                    continue
                for t in range(1, REACH + 1):
                    yy, xx = y + t * dy, x + t * dx
                    y2, x2 = yy + dy, xx + dx
                    if not (0 <= y2 < height and 0 <= x2 < width):
                        break
                    if labels[yy, xx] == label:
                        break
                    if labels[yy, xx] == labels[y2, x2]:
                        start = t
                        break
                other = labels[y + dy, x + dx]
                at, error = 0.5, WEAK
                if start:
                    other = labels[y + start * dy, x + start * dx]
                    n_in = level(values, labels, label, y, x, -dy, -dx, 1, inner)
                    n_out = level(values, labels, other, y, x, dy, dx, start + 1, outer)
                    contrast = 0.0
                    for c in range(channels):
                        contrast += (inner[c] - outer[c]) ** 2
                    if n_in >= 2 and n_out >= 2 and contrast > 0:
                        area, count, whole = 0.0, 0, True
                        for t in range(1 - REACH, start + REACH):
                            yy, xx = y + t * dy, x + t * dx
                            if not (0 <= yy < height and 0 <= xx < width) or (
                                labels[yy, xx] != label and labels[yy, xx] != other and not 0 < t < start
                            ):
                                whole = False
                                break
                            f = 0.0
                            for c in range(channels):
                                f += (values[yy, xx, c] - outer[c]) * (inner[c] - outer[c])
                            f /= contrast
                            aside = 0.0  # off the line between the two colours: there is a third one
                            for c in range(channels):
                                aside = max(aside, abs(values[yy, xx, c] - outer[c] - f * (inner[c] - outer[c])))
                            mixed = np.sqrt(contrast)
                            if aside > 4.5 * noise + MIXED * mixed or abs(f - 0.5) > 0.5 + MIXED + 4.5 * noise / mixed:
                                whole = False
                                break
                            area += f
                            count += 1
                        if whole:
                            located = 0.5 - REACH + area
                            spread = noise * np.sqrt((count + REACH**2 * (1 / n_in + 1 / n_out)) / contrast)
                            if spread < 0.75 * WEAK and abs(located - 0.5 * start) < 2:
                                at, error = (
                                    located,
                                    spread if start == 1 else max(spread, 0.5 * WEAK),
                                )  # a sliver may be a surface of its own
                point[n, 0], point[n, 1] = x + at * dx, y + at * dy
                normal[n, 0], normal[n, 1] = gx, gy
                sigma[n], owner[n], beyond[n] = error * along, label, other
                n += 1
    return point[:n], normal[:n], sigma[:n], owner[:n], beyond[:n]


@njit()
def straighten(uv, normal, first):
    """Normals from the line through each point's neighbours within 5 px, and how far those lie off it (px, rms)."""
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
