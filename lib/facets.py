"""§2.3 Reconstruction: the plane of each matched pair of regions, with its covariance.

    found = reconstruct(pair, labels, values, left_label, right_label)

A facet is a plane m . x = 1 in the left camera's frame (m = n / d), three unknowns. In rectified pixels (lib/matching.py)
its disparity is f_px baseline m . x_rect = a u + b v + c: whatever is measured, a border or a texture, says what the
disparity is at a place, and that is *linear* in m. So one weighted least-squares system per facet collects

    contours      where the region's border lies, to a part of a pixel, in both pictures, along its normal
    intensities   the texture inside, left against right, with a gain and an offset per channel

each weighed by its own noise, and its inverse is the covariance.
"""

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from lib import matching

# -- borders of regions to a part of a pixel

REACH = 3                         # px: a border's profile reaches so far to either side
WEAK = 0.5                        # px: a border that the picture does not locate better is taken from the labels


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
                start = 0
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
                            if not (0 <= yy < height and 0 <= xx < width) or (t < 0 and labels[yy, xx] != label) or (t >= start and labels[yy, xx] != other):
                                whole = False
                                break
                            f = 0.0
                            for c in range(channels):
                                f += (values[yy, xx, c] - outer[c]) * (inner[c] - outer[c])
                            area += f / contrast
                            count += 1
                        if whole:
                            located = 0.5 - REACH + area
                            spread = noise * np.sqrt((count + REACH ** 2 * (1 / n_in + 1 / n_out)) / contrast)
                            if spread < WEAK and -1.5 < located - 0.5 * (1 + start) + 0.5 < 1.5:
                                at, error = located, spread
                point[n, 0], point[n, 1] = x + at * dx, y + at * dy
                normal[n, 0], normal[n, 1] = gx, gy
                sigma[n], owner[n], beyond[n] = error * along, label, other
                n += 1
    return point[:n], normal[:n], sigma[:n], owner[:n], beyond[:n]


@njit(cache=True)
def _straighten(uv, normal, first):
    """Normals from the line through each point's neighbours within 4 px, and how far those lie off it (px, rms)."""
    off = np.full(len(uv), np.inf)
    better = normal.copy()
    for i in range(len(first) - 1):
        for k in range(first[i], first[i + 1]):
            n, su, sv, suu, suv, svv = 0, 0.0, 0.0, 0.0, 0.0, 0.0
            j = k
            while j > first[i] and uv[j - 1, 1] > uv[k, 1] - 4:
                j -= 1
            while j < first[i + 1] and uv[j, 1] < uv[k, 1] + 4:
                du, dv = uv[j, 0] - uv[k, 0], uv[j, 1] - uv[k, 1]
                if du * du + dv * dv < 16 and normal[j, 0] * normal[k, 0] + normal[j, 1] * normal[k, 1] > 0.7:
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
    """Standard deviation of the picture's noise, from second differences inside the regions; at least an 8-bit rounding."""
    flat = np.ones(labels.shape, bool)
    flat[:, 1:] &= labels[:, 1:] == labels[:, :-1]
    flat[1:] &= labels[1:] == labels[:-1]
    flat[:, :-1] &= flat[:, 1:]
    flat[:-1] &= flat[1:]
    second = lambda x: x[:-2] - 2 * x[1:-1] + x[2:]
    cross = second(np.moveaxis(second(values), 1, 0))                 # [1 -2 1] in both directions: variance 36
    cross = np.moveaxis(cross, 1, 0)[flat[1:-1, 1:-1]]
    if len(cross) < 100:
        return 1 / 255
    return float(max(1.4826 * np.median(np.abs(cross)) / 6, 1 / 255 / np.sqrt(12)))


# -- contours

FLOOR = 0.03                      # px: pixels are not ideal windows, light does not mix in display values: no border point is better


@njit(cache=True)
def _contour_system(plane, u0, v0, reach, scale, luv, lnormal, lsigma, lbend, ruv, rnormal, rsigma, rbend, rows):
    """Compare the left border, moved by the plane (a, b, c at (u0, v0)), with the right one, along the right one's normal.

    rows : out, per point used: coefficients of (a, b, c) and the residual, all over sigma; Tukey's weight; u; v; sigma, px. Returns their number.
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
        if at < 0 or max(lbend[k], rbend[at]) > 0.5:
            continue
        nu, nv = rnormal[at, 0], rnormal[at, 1]
        du, dv = u - ruv[at, 0], v - ruv[at, 1]
        if abs(du * nv - dv * nu) > 1.5:                              # beyond the border's end
            continue
        sigma = np.sqrt(lsigma[k] ** 2 + rsigma[at] ** 2 + 2 * FLOOR ** 2)
        r = nu * du + nv * dv
        cut = max(reach, 4.7 * scale * sigma)
        rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = -nu * du0 / sigma, -nu * dv0 / sigma, -nu / sigma, r / sigma
        rows[n, 4] = (1 - (r / cut) ** 2) ** 2 if abs(r) < cut else 0.0
        rows[n, 5], rows[n, 6], rows[n, 7] = luv[k, 0], v, sigma
        n += 1
    return n


@njit(cache=True)
def _normal_equations(rows, n, A, b):
    A[:] = 0
    b[:] = 0
    for k in range(n):
        for p in range(3):
            for q in range(3):
                A[p, q] += rows[k, 4] * rows[k, p] * rows[k, q]
            b[p] -= rows[k, 4] * rows[k, p] * rows[k, 3]


@njit(cache=True)
def _fit_contours(plane, u0, v0, size, iterations, luv, lnormal, lsigma, lbend, ruv, rnormal, rsigma, rbend, rows):
    """Iterate to the plane; rows as above at the last step. Returns the plane, the scale of the residuals over sigma, and n."""
    plane = plane.copy()
    A, b = np.zeros((3, 3)), np.zeros(3)
    reach, scale, n = 4.0, 1.0, 0
    for iteration in range(iterations + 1):
        n = _contour_system(plane, u0, v0, reach, scale, luv, lnormal, lsigma, lbend, ruv, rnormal, rsigma, rbend, rows)
        if n < 4 or iteration == iterations:
            break
        _normal_equations(rows, n, A, b)
        # What the borders do not say stays as it is.
        A[0, 0] += 1e-2 * size ** 2
        A[1, 1] += 1e-2 * size ** 2
        A[2, 2] += 1e-2
        s0, s1, s2 = matching._solve3(A, b)
        plane[0] += s0
        plane[1] += s1
        plane[2] += s2
        scale = max(1.4826 * np.median(np.abs(rows[:n, 3])), 1.0)
        reach = 0.6 * reach if reach > 0.3 else 0.0
        if reach == 0 and abs(s0) * size + abs(s1) * size + abs(s2) < 1e-4:
            n = _contour_system(plane, u0, v0, reach, scale, luv, lnormal, lsigma, lbend, ruv, rnormal, rsigma, rbend, rows)
            break
    return plane, scale, n


@njit(cache=True)
def _clusters(rows, n, whiten, cell):
    """Sum over cells of the squared, whitened sum of scores: 3 scale^2 where neighbours are independent. rows : as above; whiten : (3, 3)."""
    done = np.zeros(n, np.bool_)
    total = 0.0
    g = np.empty(3)
    for k in range(n):
        if done[k]:
            continue
        ku, kv = np.floor(rows[k, 5] / cell), np.floor(rows[k, 6] / cell)
        g[:] = 0
        j = k
        while j < n and np.floor(rows[j, 6] / cell) <= kv:
            if not done[j] and np.floor(rows[j, 5] / cell) == ku and np.floor(rows[j, 6] / cell) == kv:
                done[j] = True
                for p in range(3):
                    g[p] += rows[j, 4] * rows[j, p] * rows[j, 3]
            j += 1
        for p in range(3):
            s = 0.0
            for q in range(3):
                s += whiten[p, q] * g[q]
            total += s * s
    return total


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
LEAST_POINTS = 12                 # of the border or of the texture
MOST_TILT = 0.3                   # rad: the normal must be known better than this, and the distance better than this part of it


def reconstruct(pair, labels, values, left, right, *, iterations=30, progress=None):
    """Facets and Refused of the pairs (left[k], right[k]). labels, values : of the left and the right photograph."""
    regions = [matching.regions(pair, *x) for x in zip(labels, values, ("left", "right"))]
    edges = [borders(pair, x, v, wanted, side, noise(v, x)) for x, v, wanted, side in zip(labels, values, (left, right), ("left", "right"))]
    uv = [pair.rectified(c.pixels(), side) for c, side in ((pair.left, "left"), (pair.right, "right"))]
    split = [tuple(np.ascontiguousarray(x[..., k]) for k in (0, 1)) for x in uv]
    found, refused = [], []
    for done, (l, r) in enumerate(zip(left, right), 1):
        answer = _one(pair, labels, values, regions, edges, split, int(l), int(r), iterations)
        (refused if isinstance(answer, Refused) else found).append(answer)
        if progress:
            progress(done / len(left))
    return found, refused


def _of(borders, label):
    part = slice(borders.first[label], borders.first[label + 1])
    return borders.uv[part], borders.normal[part], borders.sigma[part], borders.bend[part]


def _one(pair, labels, values, regions, edges, split, l, r, iterations):
    f, baseline = pair.f_px, pair.baseline
    start, agree, n = matching.outline_plane(*regions, l - 1, r - 1)
    if n < 6:
        return Refused(l, r, "no rows in common")
    mine, other = _of(edges[0], l), _of(edges[1], r)
    if len(mine[0]) < LEAST_POINTS or len(other[0]) < LEAST_POINTS:
        return Refused(l, r, "no border inside the picture")
    u0, v0 = mine[0].mean(axis=0)
    size = float(max(np.sqrt(mine[0].var(axis=0).sum()), 1.0))
    rows = np.empty((len(mine[0]), 8))
    plane, scale, n = _fit_contours(start + [0, 0, start[0] * u0 + start[1] * v0], u0, v0, size, iterations, *mine, *other, rows)
    rows = rows[:n]
    used = rows[rows[:, 4] > 0.1]
    if len(used) < LEAST_POINTS:
        return Refused(l, r, "borders do not meet")
    A = (used[:, :3] * used[:, 4:5]).T @ used[:, :3]
    # (a, b, c at the centre) to m, left frame: linear.
    to_m = pair.R_rect_left.T @ np.diag([1, 1, 1 / f]) @ np.array([[1, 0, 0], [0, 1, 0], [-u0, -v0, 1]]) / baseline
    unit = np.array([size, size, 1])
    w, V = np.linalg.eigh(A / unit / unit[:, None])
    if not w[0] > 1e-9 * w[2]:
        return Refused(l, r, "condition: its borders run along the epipolar lines, or in one line")
    covariance = to_m @ ((V / w) @ V.T / unit / unit[:, None]) @ to_m.T * scale ** 2
    m = to_m @ plane
    length = np.linalg.norm(m)
    if not (m @ _middle(pair, (u0, v0)) > 0):
        return Refused(l, r, "not in front of the cameras")
    if np.sqrt(np.linalg.eigvalsh(covariance)[-1]) > MOST_TILT * length:
        return Refused(l, r, "condition: distance or direction not known")
    a, b, c = plane - [0, 0, plane[0] * u0 + plane[1] * v0]
    if a >= 0.95:
        return Refused(l, r, "through a camera's centre")
    overlap = _mutual(pair, labels, values, regions, split, l, r, a, b, c)
    if overlap < LEAST_OVERLAP:
        return Refused(l, r, "overlap: left does not cover right")
    polygon = outline(labels[0], l, pair.left, m)
    if polygon is None:
        return Refused(l, r, "through a camera's centre")
    rms = float(np.sqrt((used[:, 4] * (used[:, 3] * used[:, 7]) ** 2).sum() / used[:, 4].sum()))
    return Facet(l, r, m, covariance, polygon, overlap, rms)


def _middle(pair, uv0):
    """The direction, left frame, of a place in rectified pixels."""
    return pair.R_rect_left.T @ np.array([uv0[0] / pair.f_px, uv0[1] / pair.f_px, 1.0])


def _mutual(pair, labels, values, regions, split, l, r, a, b, c):
    (lu, lv), (ru, rv) = split
    R = [np.ascontiguousarray(x) for x in (pair.R_rect_left, pair.R_rect_right)]
    there, _, _ = matching._overlap(l - 1, r - 1, a, b, c, pair.f_px, R[1], pair.right.K, lu, lv, regions[0].order, regions[0].first, labels[1], *values, 1)
    back, _, _ = matching._overlap(r - 1, l - 1, a, b, c, pair.f_px, R[0], pair.left.K, ru, rv, regions[1].order, regions[1].first, labels[0], *values[::-1], -1)
    return there * back / (there + back - there * back) if there * back > 0 else 0.0


def outline(labels, label, camera, m):
    """(P, 3) the outer outline of a region on the plane m . x = 1; None where part of it lies behind the camera."""
    import cv2

    y, x = np.nonzero(labels == label)
    y0, x0 = y.min(), x.min()
    mask = np.zeros((y.max() - y0 + 3, x.max() - x0 + 3), np.uint8)
    mask[y - y0 + 1, x - x0 + 1] = 1
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    ring = max(contours, key=len)
    q = cv2.approxPolyDP(ring, 1.5, True)[:, 0].astype(float) + [x0 - 1, y0 - 1]
    v = camera.directions(q)
    height = v @ m
    if len(q) < 3 or not (height > 1e-6 * np.linalg.norm(m)).all():
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
