"""Compiled: form factors of polygons by contour integrals."""

import numpy as np

from lib.core.compiled import njit, prange

FLAT = 1e-9  # of a polygon's size: nearer to the other's plane is on it


# ---- quadrature on [0, 1] ----


def _gauss(n):
    x, w = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, w / 2


def _tanh_sinh(step=0.125, reach=3.25):
    """Distance from the nearer end (which keeps its digits next to it), whether that is the upper end, and weight."""
    t = np.arange(-round(reach / step), round(reach / step) + 1) * step
    q = np.exp(-np.pi * np.sinh(np.abs(t)))
    return q / (1 + q), t > 0, step * np.pi * np.cosh(t) * q / (1 + q) ** 2


_X6, _W6 = _gauss(6)
_X10, _W10 = _gauss(10)
_X22, _W22 = _gauss(22)
_XT, _UP, _WT = _tanh_sinh()


@njit(inline="always")
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit()
def inner(px, py, pz, c, v, length, scale):
    """Integral of ln(r / scale) along the edge c + t v, 0 <= t <= length, from the point p."""
    x, y, z = px - c[0], py - c[1], pz - c[2]
    along = x * v[0] + y * v[1] + z * v[2]
    # the distance from the line by the cross product: a difference of squares would lose half the digits
    e0, e1, e2 = y * v[2] - z * v[1], z * v[0] - x * v[2], x * v[1] - y * v[0]
    d2 = e0 * e0 + e1 * e1 + e2 * e2
    d = np.sqrt(d2)
    t1, t0 = length - along, -along
    total = -length
    r2 = (t1 * t1 + d2) / (scale * scale)
    if r2 > 0:
        total += 0.5 * t1 * np.log(r2)
    r2 = (t0 * t0 + d2) / (scale * scale)
    if r2 > 0:
        total -= 0.5 * t0 * np.log(r2)
    if d > 0:
        total += d * np.arctan2(d * length, d2 + t1 * t0)  # the angle that the edge subtends
    return total


@njit()
def parallel(x, h2, scale2):
    """Second antiderivative of ln(sqrt(x^2 + h^2) / scale)."""
    r2 = x * x + h2
    if r2 <= 0:
        return 0.0
    h = np.sqrt(h2)
    return 0.25 * (x * x - h2) * np.log(r2 / scale2) - 0.75 * x * x + h * x * np.arctan2(x, h)


@njit()
def edges(a, b, c, d, scale):
    """(u . v) times the double integral of ln(r / scale) along a-b and c-d."""
    u, v = b - a, d - c
    lu, lv = np.sqrt(dot(u, u)), np.sqrt(dot(v, v))
    if lu <= 0 or lv <= 0:
        return 0.0
    if lu > lv:  # along the shorter edge numerically
        a, b, c, d, u, v, lu, lv = c, d, a, b, v, u, lv, lu
    u = u / lu
    v = v / lv
    cosine = dot(u, v)
    if abs(cosine) < 1e-15:
        return 0.0
    w = c - a
    cross0, cross1, cross2 = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    sine2 = cross0 * cross0 + cross1 * cross1 + cross2 * cross2
    if sine2 < 1e-24:
        along = dot(w, u)
        h0, h1, h2 = w[0] - along * u[0], w[1] - along * u[1], w[2] - along * u[2]
        h = h0 * h0 + h1 * h1 + h2 * h2
        s2 = scale * scale
        x0, x1 = along, along + (lv if cosine > 0 else -lv)
        # d2/dsdt of the antiderivative of x = t - s has a minus
        value = parallel(x1, h, s2) - parallel(x0, h, s2) - parallel(x1 - lu, h, s2) + parallel(x0 - lu, h, s2)
        return abs(cosine) * value  # dt runs backwards where the cosine is negative
    middle = (a + b - c - d) / 2
    apart = 2 * (np.sqrt(dot(middle, middle)) - (lu + lv) / 2) / lu
    total = 0.0
    if apart > 0.7:
        if apart > 5:
            X, W = _X6, _W6
        elif apart > 2:
            X, W = _X10, _W10
        else:
            X, W = _X22, _W22
        for k in range(len(X)):
            s = X[k] * lu
            total += W[k] * inner(a[0] + s * u[0], a[1] + s * u[1], a[2] + s * u[2], c, v, lv, scale)
        return cosine * lu * total
    # near the ends of the other edge and where the lines come closest the integrand has logarithms and kinks
    cuts = np.empty(5)
    cuts[0], cuts[4] = 0.0, lu
    cuts[1] = min(max(dot(w, u), 0.0), lu)
    cuts[2] = min(max(dot(d - a, u), 0.0), lu)
    cuts[3] = min(max((dot(w, u) - dot(w, v) * cosine) / sine2, 0.0), lu)
    cuts.sort()
    for i in range(4):
        low, high = cuts[i], cuts[i + 1]
        if high - low <= 1e-15 * lu:
            continue
        part = 0.0
        for k in range(len(_XT)):
            s = high - (high - low) * _XT[k] if _UP[k] else low + (high - low) * _XT[k]
            part += _WT[k] * inner(a[0] + s * u[0], a[1] + s * u[1], a[2] + s * u[2], c, v, lv, scale)
        total += part * (high - low)
    return cosine * total


@njit()
def clip(corners, n, origin, tolerance, out):
    """The part in front of a plane (Sutherland and Hodgman); returns how many corners."""
    count = len(corners)
    m = 0
    for i in range(count):
        a, b = corners[i], corners[(i + 1) % count]
        da, db = dot(a - origin, n), dot(b - origin, n)
        if abs(da) <= tolerance:
            da = 0.0
        if abs(db) <= tolerance:
            db = 0.0
        if da >= 0:
            out[m] = a
            m += 1
        if (da > 0 and db < 0) or (da < 0 and db > 0):
            out[m] = a + (b - a) * (da / (da - db))
            m += 1
    return m


@njit()
def contours(P, n_p, o_p, Q, n_q, o_q, size):
    """A_1 F_12 of two planar loops with unit normals n through o."""
    tolerance = FLAT * size
    front = False
    for i in range(len(Q)):
        front |= dot(Q[i] - o_p, n_p) > tolerance
    if not front:
        return 0.0
    front = False
    for i in range(len(P)):
        front |= dot(P[i] - o_q, n_q) > tolerance
    if not front:
        return 0.0
    p, q = np.empty((2 * len(P) + 2, 3)), np.empty((2 * len(Q) + 2, 3))
    kp, kq = clip(P, n_q, o_q, tolerance, p), clip(Q, n_p, o_p, tolerance, q)
    total = 0.0
    for i in range(kp):
        for j in range(kq):
            total += edges(p[i], p[(i + 1) % kp], q[j], q[(j + 1) % kq], size)
    return total / (2 * np.pi)


@njit(parallel=True)
def all_pairs(corners, loop_start, patch_start, normal, origin, area, centre, radius):
    """(N, N) factors between all patches.

    corners : (K, 3);  loop_start : (L + 1,) into corners;  patch_start : (N + 1,) into the loops
    normal, origin, centre : (N, 3);  area, radius : (N,), radius of the sphere about the centre that holds the patch
    """
    n = len(area)
    AF = np.zeros((n, n))
    for k in prange(n):
        i = k // 2 if k % 2 == 0 else n - 1 - k // 2  # long rows and short rows in turn
        for j in range(i + 1, n):
            ni, nj = normal[i], normal[j]
            if dot(centre[j] - origin[i], ni) < -radius[j] or dot(centre[i] - origin[j], nj) < -radius[i]:
                continue
            gap = centre[i] - centre[j]
            size = max(max(radius[i], radius[j]), np.sqrt(dot(gap, gap)))
            total = 0.0
            for p in range(patch_start[i], patch_start[i + 1]):
                P = corners[loop_start[p] : loop_start[p + 1]]
                for q in range(patch_start[j], patch_start[j + 1]):
                    total += contours(P, ni, origin[i], corners[loop_start[q] : loop_start[q + 1]], nj, origin[j], size)
            AF[i, j] = AF[j, i] = max(total, 0.0)
    return AF / area.reshape(-1, 1)
