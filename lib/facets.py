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
from numba import njit

from lib import matching

# -- borders of regions to a part of a pixel

REACH = 3                         # px: a border's profile reaches so far to either side
WEAK = 2.0                        # px: a border that the picture does not locate to 3/4 of this is taken from the labels, whose errors
                                  # of up to half a pixel are the same along a whole stretch: so little is one of its points worth
MIXED = 0.1                       # of the contrast: pixels on a border between two colours lie so near the line between them (gamma bends it)


@njit(cache=True)
def _level(values, labels, label, y, x, dy, dx, start, out):
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
            if (yy > 0 and labels[yy - 1, xx] != label) or (yy + 1 < height and labels[yy + 1, xx] != label) or \
                    (xx > 0 and labels[yy, xx - 1] != label) or (xx + 1 < width and labels[yy, xx + 1] != label):
                continue
            for c in range(channels):
                out[c] += values[yy, xx, c]
            n += 1
    for c in range(channels):
        out[c] /= max(n, 1)
    return n


@njit(cache=True)
def _borders(labels, values, wanted, noise):
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
    point, normal, sigma, owner, beyond = np.empty((most, 2)), np.empty((most, 2)), np.empty(most), np.empty(most, np.int64), np.empty(most, np.int64)
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
                        if 0 <= y + dy + j < height and 0 <= x + dx + i < width and labels[y + dy + j, x + dx + i] == label:
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
                if along < 0.6:                                       # the other axis crosses it more steeply
                    continue
                # Outside: the first label that lasts; thin slivers on the edge belong to the transition.
                start, notch = 0, False
                for t in range(2, REACH + 1):
                    yy, xx = y + t * dy, x + t * dx
                    notch |= 0 <= yy < height and 0 <= xx < width and labels[yy, xx] == label
                if notch:                                             # a ragged border counts once per line, at its outermost pixel
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
                    n_in = _level(values, labels, label, y, x, -dy, -dx, 1, inner)
                    n_out = _level(values, labels, other, y, x, dy, dx, start + 1, outer)
                    contrast = 0.0
                    for c in range(channels):
                        contrast += (inner[c] - outer[c]) ** 2
                    if n_in >= 2 and n_out >= 2 and contrast > 0:
                        area, count, whole = 0.0, 0, True
                        for t in range(1 - REACH, start + REACH):
                            yy, xx = y + t * dy, x + t * dx
                            if not (0 <= yy < height and 0 <= xx < width) or (labels[yy, xx] != label and labels[yy, xx] != other and not 0 < t < start):
                                whole = False
                                break
                            f = 0.0
                            for c in range(channels):
                                f += (values[yy, xx, c] - outer[c]) * (inner[c] - outer[c])
                            f /= contrast
                            aside = 0.0                               # off the line between the two colours: there is a third one
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
                            spread = noise * np.sqrt((count + REACH ** 2 * (1 / n_in + 1 / n_out)) / contrast)
                            if spread < 0.75 * WEAK and abs(located - 0.5 * start) < 2:
                                at, error = located, spread if start == 1 else max(spread, 0.5 * WEAK)     # a sliver may be a surface of its own
                point[n, 0], point[n, 1] = x + at * dx, y + at * dy
                normal[n, 0], normal[n, 1] = gx, gy
                sigma[n], owner[n], beyond[n] = error * along, label, other
                n += 1
    return point[:n], normal[:n], sigma[:n], owner[:n], beyond[:n]


@njit(cache=True)
def _straighten(uv, normal, first):
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
            suu, suv, svv = suu / n - (su / n) ** 2, suv / n - su * sv / n ** 2, svv / n - (sv / n) ** 2
            mean, half = 0.5 * (suu + svv), np.sqrt(0.25 * (suu - svv) ** 2 + suv ** 2)
            if mean + half < 1.0:                                     # neighbours on one spot
                continue
            off[k] = np.sqrt(max(mean - half, 0.0))
            angle = 0.5 * np.arctan2(2 * suv, suu - svv)
            nu, nv = -np.sin(angle), np.cos(angle)
            if nu * normal[k, 0] + nv * normal[k, 1] < 0:
                nu, nv = -nu, -nv
            better[k, 0], better[k, 1] = nu, nv
    return better, off


@dataclass(frozen=True, eq=False)
class Borders:
    """Points of the borders of some regions, grouped by region, in each by v.

    q : (n, 2) px          in the photograph            uv : (n, 2)      rectified pixels
    normal : (n, 2)        outward, rectified           sigma : (n,) px  along the normal, from the picture's noise
    bend : (n,) px         how far its neighbours are off a line: borders turn there, or are ragged
    beyond : (n,)          the label on the other side
    first : (N + 2,)       those of label l are first[l]:first[l + 1]
    """

    q: np.ndarray
    uv: np.ndarray
    normal: np.ndarray
    sigma: np.ndarray
    bend: np.ndarray
    beyond: np.ndarray
    first: np.ndarray


def borders(pair, labels, values, wanted, side, noise) -> Borders:
    """The borders of the regions in `wanted` (labels). A picture's own border is none."""
    n = int(labels.max(initial=0))
    chosen = np.zeros(n + 1, bool)
    chosen[wanted] = True
    q, normal, sigma, owner, beyond = _borders(labels, values, chosen, noise)
    uv = pair.rectified(q, side)
    tip = pair.rectified(q + 0.5 * np.column_stack([-normal[:, 1], normal[:, 0]]), side) - uv          # the tangent, rectified
    normal = np.column_stack([tip[:, 1], -tip[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    keep = np.isfinite(normal).all(axis=1)
    q, uv, normal, sigma, owner, beyond = (x[keep] for x in (q, uv, normal, sigma, owner, beyond))
    order = np.lexsort((uv[:, 1], owner))
    q, uv, normal, sigma, owner, beyond = (np.ascontiguousarray(x[order]) for x in (q, uv, normal, sigma, owner, beyond))
    first = np.searchsorted(owner, np.arange(n + 2))
    normal, bend = _straighten(uv, normal, first)
    return Borders(q, uv, normal, sigma, bend, beyond, first)


def noise(values, labels):
    """Standard deviation of the picture's noise, from differences of pixels 3 apart in one region; at least an 8-bit rounding.

    Not from neighbours: resampled and compressed pictures have noise that neighbours share.
    """
    pairs = [(values[:, 3:] - values[:, :-3])[labels[:, 3:] == labels[:, :-3]], (values[3:] - values[:-3])[labels[3:] == labels[:-3]]]
    difference = np.abs(np.concatenate(pairs))
    least = 1 / 255 / np.sqrt(12)
    return float(max(1.4826 * np.median(difference) / np.sqrt(2), least)) if len(difference) > 100 else 1 / 255


# -- contours

FLOOR = 0.03                      # px: pixels are not ideal windows, light does not mix in display values: no border point is better

LEAST_SCALE = 0.05                # of the residuals over sigma: pictures without any noise are still no better known than this


@njit(cache=True)
def _contour_rows(plane, u0, v0, reach, scale, luv, lnormal, lsigma, lbend, lpart, ruv, rnormal, rsigma, rbend, rows):
    """Compare the left border, moved by the plane (a, b, c at (u0, v0)), with the right one, along the right one's normal.

    rows : out, per point used: coefficients of (a, b, c) and the residual, all over sigma; Tukey's weight; the right normal's u; part;
    sigma, px; u; v. Returns their number.
    """
    n, lo = 0, 0
    for k in range(len(luv)):
        du0, dv0 = luv[k, 0] - u0, luv[k, 1] - v0
        u, v = luv[k, 0] - (plane[0] * du0 + plane[1] * dv0 + plane[2]), luv[k, 1]
        while lo < len(ruv) and ruv[lo, 1] < v - 3:
            lo += 1
        best, at = (2 + reach) ** 2, -1
        j = lo
        while j < len(ruv) and ruv[j, 1] <= v + 3:
            d = (ruv[j, 0] - u) ** 2 + (ruv[j, 1] - v) ** 2
            if d < best and rnormal[j, 0] * lnormal[k, 0] + rnormal[j, 1] * lnormal[k, 1] > 0.9:
                best, at = d, j
            j += 1
        if at < 0 or lbend[k] > max(0.5, 3 * lsigma[k]) or rbend[at] > max(0.5, 3 * rsigma[at]):
            continue
        nu, nv = rnormal[at, 0], rnormal[at, 1]
        du, dv = u - ruv[at, 0], v - ruv[at, 1]
        if abs(du * nv - dv * nu) > 1.5:                              # beyond the border's end
            continue
        sigma = np.sqrt(lsigma[k] ** 2 + rsigma[at] ** 2 + 2 * FLOOR ** 2)
        if sigma < 0.5 * WEAK:
            sigma *= scale
        r = nu * du + nv * dv
        cut = max(reach, 4.7 * sigma)
        rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = -nu * du0 / sigma, -nu * dv0 / sigma, -nu / sigma, r / sigma
        rows[n, 4] = (1 - (r / cut) ** 2) ** 2 if abs(r) < cut else 0.0
        rows[n, 5], rows[n, 6], rows[n, 7], rows[n, 8], rows[n, 9] = nu, lpart[k], sigma, luv[k, 0], v
        n += 1
    return n


@njit(cache=True)
def _fit_contours(plane, u0, v0, size, reach, iterations, left, right, rows):
    """Iterate to the plane; rows as above at the last step, sigma as the residuals show it. Returns the plane and n."""
    plane = plane.copy()
    A, b = np.zeros((3, 3)), np.zeros(3)
    scale, n = 1.0, 0
    for iteration in range(iterations + 1):
        n = _contour_rows(plane, u0, v0, reach, scale, *left, *right, rows)
        if n < 4 or iteration == iterations:
            break
        # What the borders do not say stays as it is.
        A[:] = 0
        b[:] = 0
        A[0, 0], A[1, 1], A[2, 2] = 1e-2 * size ** 2, 1e-2 * size ** 2, 1e-2
        for k in range(n):
            for p in range(3):
                for q in range(3):
                    A[p, q] += rows[k, 4] * rows[k, p] * rows[k, q]
                b[p] -= rows[k, 4] * rows[k, p] * rows[k, 3]
        s0, s1, s2 = matching._solve3(A, b)
        plane[0] += s0
        plane[1] += s1
        plane[2] += s2
        strong = rows[:n, 3][rows[:n, 7] < 0.5 * WEAK * scale]
        if len(strong) >= 20:                                         # what the residuals say of sigma, unless they are too few
            scale = max(scale * max(1.4826 * np.median(np.abs(strong)), 0.1), LEAST_SCALE)
        small = abs(s0) * size + abs(s1) * size + abs(s2) < 1e-4
        if reach == 0 and small:
            break
        reach = 0.6 * reach if reach > 0.3 else 0.0
    return plane, n


def _parts(labels, label, q):
    """For each border point (n, 2) of a region the side of its outline, outer or of a hole, on which it lies: straight to 1.5 px."""
    import cv2

    y, x = np.nonzero(labels == label)
    y0, x0 = y.min() - 1, x.min() - 1
    mask = np.zeros((y.max() - y0 + 2, x.max() - x0 + 2), np.uint8)
    mask[y - y0, x - x0] = 1
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    rings = [cv2.approxPolyDP(c, 1.5, True)[:, 0] + [x0, y0] for c in contours]
    start = np.concatenate(rings).astype(float)
    end = np.concatenate([np.roll(r, -1, 0) for r in rings]).astype(float)
    along = end - start
    length2 = np.maximum((along ** 2).sum(axis=1), 1e-12)
    part = np.empty(len(q), np.int64)
    for first in range(0, len(q), 2000):
        to = q[first:first + 2000, None] - start
        t = np.clip((to * along).sum(axis=2) / length2, 0, 1)
        part[first:first + 2000] = ((to - t[..., None] * along) ** 2).sum(axis=2).argmin(axis=1)
    return part


AGREE = 0.35                      # px: a part of the border that lies so far from where the plane puts it is not the facet's own
PARTS = 12                        # parts tried as the ones that are


def _own_parts(rows, n_parts, size):
    """Which parts of the border are the facet's own, and the step (a, b, c) they ask for.

    A border belongs to the nearer of the two surfaces that meet there. What hides part of the facet lies in front of it, so each part
    either agrees with the facet's plane or has *more* disparity; no border can lie behind. Every two and three parts propose a plane; the
    one wins with which most of the border, as seen across the epipolar lines, agrees, less what would lie behind.
    """
    strong = rows[:, 7] < WEAK
    part = rows[:, 6].astype(int)
    J = rows[:, :3] * rows[:, 7:8] / [size, size, 1]
    r, nu = rows[:, 3] * rows[:, 7], rows[:, 5]
    weight = strong.astype(float)
    sums = lambda x: np.bincount(part, weight * x, n_parts)
    n = sums(1.0)
    info = sums(nu ** 2)
    A = np.array([[sums(J[:, p] * J[:, q]) for p in range(3)] for q in range(3)]).transpose(2, 0, 1)
    b, c = np.stack([sums(J[:, p] * r) for p in range(3)], axis=1), sums(r * r)
    mean = np.stack([sums(nu * J[:, p]) for p in range(3)], axis=1), sums(nu * r)
    noise = sums(rows[:, 7] ** 2)
    top = [p for p in np.argsort(-info, kind="stable")[:PARTS] if info[p] >= 2]
    sets = [(p, q, s) for i, p in enumerate(top) for j, q in enumerate(top[i:], i) for s in top[j:]]
    if not sets:
        return None
    some = np.array(sets)
    member = np.zeros((len(sets), n_parts))
    np.put_along_axis(member, some, 1.0, axis=1)
    prior = np.diag([0.02, 0.02, 1e-6]) * 1.0                           # px^-2: what few parts do not say stays near
    x = -np.linalg.solve(np.einsum("hp,pij->hij", member, A) + prior, np.einsum("hp,pi->hi", member, b)[..., None])[..., 0]
    square = np.einsum("hi,pij,hj->hp", x, A, x) + 2 * x @ b.T + c
    with np.errstate(invalid="ignore", divide="ignore"):
        rms2 = np.where(n > 0, np.maximum(square - noise, 0) / n, np.inf)
        ahead = np.where(info > 0, (x @ mean[0].T + mean[1]) / info, 0)  # disparity beyond the plane's
    agree = np.maximum(1 - rms2 / AGREE ** 2, 0)
    score = (info * agree).sum(axis=1) - (info * ((agree == 0) & (ahead < -2 * AGREE))).sum(axis=1)
    h = int(score.argmax())
    return agree[h] > 0, x[h] / [size, size, 1], score[h] / max(info.sum(), 1e-12)


# -- intensities

SMOOTH_PX = (2.0, 0.8)            # coarse to fine: the last one measures, the first ones bring the start near
TEXTURE = 4.5                     # times the noise of a gradient: what is less says nothing, and would pretend to
ALIKE = 0.6                       # of the left photograph's slopes the right one must show: texture gives 1, noise 0
MOST_PIXELS = 20000


@dataclass(frozen=True, eq=False)
class _Level:
    """Both photographs, smoothed, and the left one's slope along the epipolar lines: (H, W, C) each; noise of a slope."""

    left: np.ndarray
    slope: np.ndarray
    right: np.ndarray
    slope_noise: float


def _levels(pair, values, sigma):
    import cv2

    uv = pair.rectified(pair.left.pixels(), "left")
    step = pair.photograph(uv + [0.5, 0], "left") - pair.photograph(uv - [0.5, 0], "left")            # d pixel / d u
    levels = []
    for smooth in SMOOTH_PX:
        left, right = (cv2.GaussianBlur(v, (0, 0), smooth, borderType=cv2.BORDER_REPLICATE).reshape(v.shape) for v in values)
        gy, gx = np.gradient(left, axis=(0, 1))
        slope = gx * step[..., :1] + gy * step[..., 1:]
        impulse = np.zeros((33, 33))
        impulse[16, 16] = 1
        gain = np.sqrt((np.gradient(cv2.GaussianBlur(impulse, (0, 0), smooth))[1] ** 2).sum())
        levels.append(_Level(left, np.nan_to_num(slope), right, gain * sigma))
    return levels


@njit(cache=True)
def _texture_rows(plane, u0, v0, pixels, u, v, left, slope, right, labels, wanted, least, f, R, K, gain, offset, rows):
    """Per pixel and channel with a slope of at least `least`: coefficients of (a, b, c); left value; channel; residual; x, y. Their number.

    residual = right(where the plane takes the pixel) - gain left - offset; its slope is taken from the left photograph, whose noise
    is not the right one's: a slope and a residual with noise in common would agree by themselves.
    """
    height, width, channels = right.shape
    n = 0
    for k in range(len(pixels)):
        y, x = pixels[k] // u.shape[1], pixels[k] % u.shape[1]
        du, dv = u[y, x] - u0, v[y, x] - v0
        d0, d1 = (u[y, x] - (plane[0] * du + plane[1] * dv + plane[2])) / f, v[y, x] / f
        z = R[0, 2] * d0 + R[1, 2] * d1 + R[2, 2]
        if z <= 0:
            continue
        qx = K[0, 0] * (R[0, 0] * d0 + R[1, 0] * d1 + R[2, 0]) / z + K[0, 2]
        qy = K[1, 1] * (R[0, 1] * d0 + R[1, 1] * d1 + R[2, 1]) / z + K[1, 2]
        ix, iy = int(np.floor(qx)), int(np.floor(qy))
        if ix < 1 or iy < 1 or ix >= width - 2 or iy >= height - 2:
            continue
        fx, fy = qx - ix, qy - iy
        if labels[iy + (fy > 0.5), ix + (fx > 0.5)] != wanted:
            continue
        for c in range(channels):
            if abs(slope[y, x, c]) < least:
                continue
            value = 0.0
            for j in range(4):                                        # Catmull and Rom's cubic
                wy = (0.5 * fy * (-1 + fy * (2 - fy)), 1 + fy * fy * (1.5 * fy - 2.5), 0.5 * fy * (1 + fy * (4 - 3 * fy)), 0.5 * fy * fy * (fy - 1))[j]
                for i in range(4):
                    wx = (0.5 * fx * (-1 + fx * (2 - fx)), 1 + fx * fx * (1.5 * fx - 2.5), 0.5 * fx * (1 + fx * (4 - 3 * fx)), 0.5 * fx * fx * (fx - 1))[i]
                    value += wy * wx * right[iy - 1 + j, ix - 1 + i, c]
            s = -gain[c] * slope[y, x, c] / (1 - plane[0])
            rows[n, 0], rows[n, 1], rows[n, 2] = s * du, s * dv, s
            rows[n, 3], rows[n, 4] = left[y, x, c], c
            rows[n, 5], rows[n, 6], rows[n, 7] = value - gain[c] * left[y, x, c] - offset[c], x, y
            n += 1
    return n


def _texture(pair, level, split, labels, l, r, pixels, plane, uv0, size, iterations):
    """(plane, A, b = 0) from the intensities at `pixels` (indices) of the left region, at one level; None where they say too little.

    A : (3, 3) as _Measured.A, divided by the residuals' variance and by how much neighbours err together.
    """
    channels = level.left.shape[2]
    pixels = np.ascontiguousarray(pixels[::max(1, len(pixels) * channels // MOST_PIXELS)])
    rows = np.empty((len(pixels) * channels, 8))
    gain, offset = np.ones(channels), np.zeros(channels)
    R = np.ascontiguousarray(pair.R_rect_right)
    plane, unit = plane.copy(), np.array([size, size, 1.0])
    for iteration in range(iterations):
        n = _texture_rows(plane, *uv0, pixels, *split[0], level.left, level.slope, level.right, labels[1], r, TEXTURE * level.slope_noise,
                          pair.f_px, R, pair.right.K, gain, offset, rows)
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
        A[np.diag_indices_from(A)] += np.r_[np.full(3, 1e-9 * A[:3, :3].trace()), np.full(2 * channels, 1e-4 * w.sum())] + 1e-12
        step = -np.linalg.solve(A, J.T @ (w * x[:, 5]))
        limit = min(1.0, 2.0 / (np.abs(step[:3]).sum() + 1e-12))
        plane = plane + limit * step[:3] / unit
        gain, offset = gain + limit * step[3:3 + channels], offset + limit * step[3 + channels:]
        if plane[0] > 0.9:
            return None
        if np.abs(step[:3]).sum() < 1e-3:
            break
    # Is it texture? Then the right photograph has the left one's slopes. Noise has not, however steep.
    sides = []
    for shift in (-0.5, 0.5):
        more = np.empty_like(rows)
        k = _texture_rows(plane + [0, 0, shift], *uv0, pixels, *split[0], level.left, level.slope, level.right, labels[1], r,
                          TEXTURE * level.slope_noise, pair.f_px, R, pair.right.K, gain, offset, more)
        more = more[:k]
        sides.append((((more[:, 7] * labels[0].shape[1] + more[:, 6]) * channels + more[:, 4]).astype(np.int64), more))
    _, before, after = np.intersect1d(sides[0][0], sides[1][0], return_indices=True)
    mine, theirs = sides[0][1][before, 2], sides[1][1][after, 5] - sides[0][1][before, 5]
    if len(mine) < 60 or not mine @ theirs > ALIKE * (mine @ mine):
        return None
    e = x[:, 5] + J @ step
    s = 1.4826 * np.median(np.abs(e - np.median(e))) + 1e-9
    mix = np.linalg.solve(A[3:, 3:], A[3:, :3])                       # what gain and offset take away
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
    steep = (P ** 2).sum(axis=1)
    flat = max(float(((1 - z2) * (1 - 5 * z2)) @ steep / (w @ steep)), 0.3)
    scores = np.stack([np.bincount(tile, w * e * P[:, k]) for k in range(3)], axis=1)
    together = np.einsum("ti,ij,tj", scores, np.linalg.pinv(information), scores) / 3 * len(scores) / (len(scores) - 3) * (1 + 0.9 / side) ** 2
    return plane, information * flat ** 2 / max(together, s * s)


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
THIN = 5.0                        # px: of thinner regions both borders lie in one blur
LEAST_POINTS = 12                 # of the border or of the texture
MOST_TILT = 0.2                   # rad: the normal must be known better than this, and the distance better than this part of it


def reconstruct(pair, labels, values, left, right, *, iterations=30, intensities=True, progress=None):
    """Facets and Refused of the pairs (left[k], right[k]), and how far sides of outlines were found to be off (px).

    labels, values : of the left and the right photograph
    iterations : of the contours, at most; intensities : also measure the texture inside (both for the curves of error against time)
    """
    regions = [matching.regions(pair, *x) for x in zip(labels, values, ("left", "right"))]
    sigma = [noise(v, x) for v, x in zip(values, labels)]
    edges = [borders(pair, x, v, wanted, side, s) for x, v, wanted, side, s in zip(labels, values, (left, right), ("left", "right"), sigma)]
    uv = [pair.rectified(c.pixels(), side) for c, side in ((pair.left, "left"), (pair.right, "right"))]
    split = [tuple(np.ascontiguousarray(x[..., k]) for k in (0, 1)) for x in uv]
    levels = _levels(pair, values, sigma[0]) if intensities else []
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
        answer = x if isinstance(x, str) else _facet(pair, labels, values, regions, edges, split, int(l), int(r), x, _own_side_sigma(x, sigma_side, ordinary))
        (found.append(answer) if isinstance(answer, Facet) else refused.append(Refused(int(l), int(r), answer)))
    return found, refused, sigma_side


def _of(borders, label):
    part = slice(borders.first[label], borders.first[label + 1])
    return borders.uv[part], borders.normal[part], borders.sigma[part], borders.bend[part]


@dataclass(frozen=True, eq=False)
class _Measured:
    """What the borders of a pair say: sums of normal equations by side of the outline, at a plane (a, b, c at uv0).

    A : (3, 3), b : (3,)                    over all points, in units of (size, size, 1), divided by scale^2
    B : (P, 3), C, D : (P,)                 the same of a common offset of each side, px: with the plane, with itself, with the residual
    square : of the residuals               points : their number          rms_px : weighted
    """

    plane: np.ndarray
    uv0: np.ndarray
    size: float
    A: np.ndarray
    b: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    square: float
    points: int
    rms_px: float
    rows: np.ndarray
    texture: tuple = None             # (plane, A) of the intensities, or None

    def widened(self, factor):
        """The borders' variances times `factor`, and the texture added."""
        A, b = self.A / factor, self.b / factor
        if self.texture is not None:
            A, b = A + self.texture[1], b + self.texture[1] @ ((self.plane - self.texture[0]) * [self.size, self.size, 1])
        return replace(self, A=A, b=b, B=self.B / factor, C=self.C / factor, D=self.D / factor, square=self.square / factor)


def _measure(pair, labels, regions, edges, levels, split, l, r, iterations):
    """_Measured, or why not."""
    start, agree, n = matching.outline_plane(*regions, l - 1, r - 1)
    if n < 6:
        return "no rows in common"
    mine, other = _of(edges[0], l), _of(edges[1], r)
    if len(mine[0]) < LEAST_POINTS or len(other[0]) < LEAST_POINTS:
        return "no border inside the picture"
    u0, v0 = mine[0].mean(axis=0)
    size = float(max(np.sqrt(mine[0].var(axis=0).sum()), 1.0))
    if min(2 * x.pixels[k - 1] / max(e.first[k + 1] - e.first[k], 1) for x, e, k in zip(regions, edges, (l, r))) < THIN:
        return "condition: too thin"
    q = edges[0].q[edges[0].first[l]:edges[0].first[l + 1]]
    part = _parts(labels[0], l, q)
    start = start + [0, 0, start[0] * u0 + start[1] * v0]
    contours = _contours(start, (u0, v0), size, mine, other, part, 4.0, iterations)

    # Texture: wherever no well located border is near, for that is measured already.
    located = contours.rows if contours else np.empty((0, 10))
    pixels = regions[0].order[regions[0].first[l - 1]:regions[0].first[l]]
    pixels = _away(labels[0].shape, pixels, q[mine[3] < np.maximum(0.5, 3 * mine[2])])
    plane = contours.plane if contours else start
    texture = None
    for level in levels:
        texture = _texture(pair, level, split, labels, l, r, pixels, plane, (u0, v0), size, 15)
        if texture is None:
            break
        plane = texture[0]
    if contours is None and texture is None:
        return "borders do not meet"
    x = contours or _Measured(plane, np.array([u0, v0]), size, np.zeros((3, 3)), np.zeros(3), np.zeros((1, 3)), np.zeros(1), np.zeros(1), 0.0, 0, 0.0, located)
    return replace(x, texture=texture)


def _away(shape, pixels, q):
    """Those of the pixels (indices) that are at least 4 px from all q (n, 2)."""
    import cv2

    near = np.zeros(shape, np.uint8)
    i = np.round(q).astype(int)
    near[i[:, 1].clip(0, shape[0] - 1), i[:, 0].clip(0, shape[1] - 1)] = 1
    near = cv2.dilate(near, np.ones((7, 7), np.uint8))
    return pixels[near.ravel()[pixels] == 0]


def _contours(plane, uv0, size, mine, other, part, reach, iterations):
    """_Measured from the borders alone; None where they do not meet."""
    rows = np.empty((len(mine[0]), 10))
    n_parts = int(part.max()) + 1
    plane, n = _fit_contours(plane, *uv0, size, reach, iterations, (*mine, part), other, rows)
    for reach in (6.0, 3.0, 1.5):
        n = _contour_rows(plane, *uv0, reach, 1.0, *mine, part, *other, rows)
        own = _own_parts(rows[:n], n_parts, size)
        if own is None:
            return None
        plane = plane + own[1]
    keep = own[0][part]
    mine, part = tuple(np.ascontiguousarray(x[keep]) for x in mine), part[keep]
    plane, n = _fit_contours(plane, *uv0, size, 1.0, iterations, (*mine, part), other, rows)
    rows = rows[:n][rows[:n, 4] > 0.1]
    if len(rows) < LEAST_POINTS:
        return None
    J, e, w = rows[:, :3] / [size, size, 1], rows[:, 3], rows[:, 4]
    part, one = rows[:, 6].astype(int), 1 / rows[:, 7]
    sums = lambda x: np.bincount(part, w * x, n_parts)
    return _Measured(plane, np.array(uv0), size, (J * w[:, None]).T @ J, J.T @ (w * e), np.stack([sums(J[:, p] * one) for p in range(3)], axis=1),
                     sums(one * one), sums(one * e), float((w * e * e).sum()), len(rows),
                     float(np.sqrt((w * (rows[:, 3] * rows[:, 7]) ** 2).sum() / w.sum())), rows)


def _with_sides(x, sigma_side):
    """Normal matrix, right-hand side (at x.plane), residual square and log determinant where each side of the outline is off by
    sigma_side px as a whole."""
    if sigma_side == 0:
        return x.A, x.b, x.square, 0.0
    k = 1 / (x.C + 1 / sigma_side ** 2)
    return x.A - np.einsum("p,pi,pj->ij", k, x.B, x.B), x.b - (k * x.D) @ x.B, x.square - float((k * x.D ** 2).sum()), float(np.log1p(sigma_side ** 2 * x.C).sum())


def _together(measured):
    """How much more (or less) the scores of neighbouring border points add up than independent ones would: their variance over 16 px of
    a side against the sum of their variances, mean over the pair's facets."""
    ratios = []
    for x in measured:
        if len(x.rows) == 0:
            continue
        cell = np.unique((x.rows[:, 6] * 4096 + x.rows[:, 8] // 16 % 64) * 64 + x.rows[:, 9] // 16 % 64, return_inverse=True)[1]
        if cell.max() < 7:
            continue
        J = x.rows[:, :3] / [x.size, x.size, 1]
        w = x.rows[:, 4]
        scores = np.stack([np.bincount(cell, w * x.rows[:, 3] * J[:, k]) for k in range(3)], axis=1)
        own = np.stack([[np.bincount(cell, w * J[:, p] * J[:, q]) for p in range(3)] for q in range(3)]).transpose(2, 0, 1)
        inverse = np.linalg.pinv(own.sum(axis=0))
        fitted = np.einsum("cij,cji", inverse @ own, inverse @ own)   # what the fit has taken out of the residuals
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


MISFIT = 1.5                      # times the ordinary rms of the pair's borders: what lies farther apart is not one plane's


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
    to_m = pair.R_rect_left.T @ np.diag([1, 1, 1 / pair.f_px]) @ np.array([[1, 0, 0], [0, 1, 0], [-u0, -v0, 1]]) / pair.baseline
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
    there, _, _ = matching._overlap(l - 1, r - 1, a, b, c, pair.f_px, R[1], pair.right.K, lu, lv, regions[0].order, regions[0].first, labels[1], *values, 1)
    back, _, _ = matching._overlap(r - 1, l - 1, a, b, c, pair.f_px, R[0], pair.left.K, ru, rv, regions[1].order, regions[1].first, labels[0], *values[::-1], -1)
    return there * back / (there + back - there * back) if there * back > 0 else 0.0


def outline(labels, label, camera, m, q, sigma):
    """(P, 3) the outer outline of a region on the plane m . x = 1; None where part of it lies behind the camera.

    q, sigma : the region's border points (n, 2) px and how well each is located. Each straight side of the outline is the line through
    its points, its corners are where the lines meet; a side without points is the pixels' outer edge.
    """
    import cv2

    y, x = np.nonzero(labels == label)
    y0, x0 = y.min() - 1, x.min() - 1
    mask = np.zeros((y.max() - y0 + 2, x.max() - x0 + 2), np.uint8)
    mask[y - y0, x - x0] = 1
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    ring = cv2.approxPolyDP(max(contours, key=len), 1.5, True)[:, 0].astype(float) + [x0, y0]
    if len(ring) < 3:
        return None
    along = np.roll(ring, -1, 0) - ring
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = along / length
    turn = np.sign((ring[:, 0] * np.roll(ring[:, 1], -1) - ring[:, 1] * np.roll(ring[:, 0], -1)).sum())
    outward = turn * np.column_stack([along[:, 1], -along[:, 0]])
    base, direction = ring + 0.5 * outward, along.copy()
    q = q[sigma < 0.5 * WEAK]
    for k in range(len(ring)):
        t, off = (q - ring[k]) @ along[k], (q - ring[k]) @ outward[k]
        near = q[(t > 1.5) & (t < length[k] - 1.5) & (np.abs(off - 0.5) < 1.5)]
        if len(near) >= 4 and np.ptp((near - ring[k]) @ along[k]) > 3:
            base[k] = near.mean(axis=0)
            v = np.linalg.svd(near - base[k], full_matrices=False)[2][0]
            if abs(v @ along[k]) > 0.97:
                direction[k] = v * np.sign(v @ along[k])
    before, back = np.roll(base, 1, 0), np.roll(direction, 1, 0)
    cross = back[:, 0] * direction[:, 1] - back[:, 1] * direction[:, 0]
    corner = ring + 0.5 * (outward + np.roll(outward, 1, 0))
    sharp = np.abs(cross) > 0.2
    d = base - before
    s = (d[:, 0] * direction[:, 1] - d[:, 1] * direction[:, 0]) / np.where(sharp, cross, 1)
    meet = before + s[:, None] * back
    sharp &= np.linalg.norm(meet - ring, axis=1) < 3
    corner[sharp] = meet[sharp]
    v = camera.directions(np.clip(corner, -0.5, np.array(labels.shape[::-1]) - 0.5))
    height = v @ m
    if not (height > 1e-6 * np.linalg.norm(m)).all():
        return None
    return v / height[:, None]


# -- files

def describe(found, refused, unit):
    """The content of facets.json."""
    facets = []
    for x in found:
        n, d = x.plane
        facets.append({"left_label": x.left_label, "right_label": x.right_label, "plane": {"n": n, "d": d}, "polygon": x.polygon, "overlap": x.overlap,
                       "covariance": x.covariance, "rms_px": x.rms_px})
    return {"frame": "left", "unit": unit, "facets": facets,
            "refused": [{"left_label": x.left_label, "right_label": x.right_label, "why": x.why} for x in refused]}


def write_ply(path, found, colours):
    """The polygons, triangulated and coloured: ASCII, for MeshLab. colours : (M, 3) in [0, 1]."""
    import mapbox_earcut

    points, faces = [], []
    for x, colour in zip(found, colours):
        n = x.plane[0]
        u = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
        u /= np.linalg.norm(u)
        flat = np.column_stack([x.polygon @ u, x.polygon @ np.cross(n, u)])
        t = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], np.uint32)).reshape(-1, 3).astype(int)
        faces += (t + len(points)).tolist()
        rgb = np.round(255 * np.clip(np.broadcast_to(colour, 3), 0, 1)).astype(int)
        points += ["%.9g %.9g %.9g %d %d %d" % (*p, *rgb) for p in x.polygon]
    with open(path, "w", encoding="ascii") as file:
        file.write(f"ply\nformat ascii 1.0\ncomment left camera: x right, y down, z forward\nelement vertex {len(points)}\n"
                   "property double x\nproperty double y\nproperty double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
                   f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
        file.write("".join(p + "\n" for p in points) + "".join("3 %d %d %d\n" % tuple(t) for t in faces))


def warm_up():
    """Compile, or load, the kernels."""
    matching.warm_up()
    pair, labels, values = matching.toy()
    reconstruct(pair, labels, values, np.array([2]), np.array([2]))


def unit_of(orientation):
    """"m", or "baseline" where orientation.json (path or None) says so."""
    from lib import artefact
    from lib.stage import BadInput

    if orientation is None:
        return "m"
    content = artefact.read_json(orientation)
    unit = content.get("unit", "m") if isinstance(content, dict) else None
    if unit not in ("m", "baseline"):
        raise BadInput(f"{orientation}: unit: {unit!r} is neither 'm' nor 'baseline'")
    return unit


def reasons(refused):
    """Counts by reason."""
    counts = {}
    for x in refused:
        counts[x.why] = counts.get(x.why, 0) + 1
    return counts


def median_rms(found):
    return float(np.median([x.rms_px for x in found]))


def median_sigma(found):
    """Of the relative standard deviations of the distances of the planes."""
    return float(np.median([np.sqrt(x.m @ x.covariance @ x.m) / (x.m @ x.m) for x in found]))


def colours(labels, values, found):
    """(M, 3) mean colour of each facet's left region."""
    count = np.maximum(np.bincount(labels.ravel()), 1)
    mean = np.stack([np.bincount(labels.ravel(), values[..., c].ravel()) for c in range(values.shape[2])], axis=1) / count[:, None]
    return [mean[x.left_label] if mean.shape[1] == 3 else np.repeat(mean[x.left_label], 3) for x in found]
