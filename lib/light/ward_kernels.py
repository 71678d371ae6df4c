"""Compiled: Ward's BRDF in its three forms, per unit rho_s."""

import numpy as np

from lib.core.compiled import njit

BOUNDED, WARD, DUER = 0, 1, 2

HORIZON = 1e-9
DARK = 700.0  # exp(-e) of a larger e is as good as 0


@njit()
def value(form, ax, ay, ix, iy, iz, ox, oy, oz):
    """f / rho_s in 1/sr; 0 where i or o lies below the horizon.

    >>> round(value(BOUNDED, 0.15, 0.15, 0., 0., 1., 0., 0., 1.), 5)        # 1 / (4 pi alpha^2), any form
    3.53678
    """
    if not (iz > HORIZON and oz > HORIZON):
        return 0.0
    hz = iz + oz
    p, q = (ix + ox) / hz, (iy + oy) / hz
    e = (p / ax) ** 2 + (q / ay) ** 2
    if not e < DARK:
        return 0.0
    lobe = np.exp(-e) / (np.pi * ax * ay)
    if form == BOUNDED:
        return lobe * (1.0 + p * p + q * q) / (hz * hz)
    if form == WARD:
        return lobe / (4.0 * np.sqrt(iz * oz))
    return lobe / (4.0 * iz * oz)


@njit()
def sample(ax, ay, ox, oy, oz, u, v):
    """The direction i into which o is mirrored by a half vector h of density exp(-e) / (pi ax ay cos^3 h).

    u, v : uniform in [0, 1)

    Ward's tan^2 = -ln(u) / (cos^2 phi / ax^2 + sin^2 phi / ay^2) means that the slopes of h are normal deviates:
    r = sqrt(-ln u), (p, q) = r (ax cos 2 pi v, ay sin 2 pi v). No arc tangent is needed whose quadrant could be missed.
    i may lie below the horizon: nothing is reflected there, and the sample counts with weight 0.
    """
    r = np.sqrt(-np.log(min(max(u, 1e-300), 1.0)))
    p, q = ax * r * np.cos(2 * np.pi * v), ay * r * np.sin(2 * np.pi * v)
    twice = 2.0 * (ox * p + oy * q + oz) / (1.0 + p * p + q * q)
    return twice * p - ox, twice * q - oy, twice - oz


@njit()
def pdf(ax, ay, ix, iy, iz, ox, oy, oz):
    """Density of `sample` in i per solid angle: (h.h) / |h.z|^3 exp(-e) / (2 pi ax ay).

    Its integral over the whole sphere is one. Above the horizon it is bounded. Below, where i nears -o, it is not, as h
    turns in the plane across o; 0 stands for it there.
    """
    hz = abs(iz + oz)
    if not hz > HORIZON:
        return 0.0
    p, q = (ix + ox) / hz, (iy + oy) / hz
    e = (p / ax) ** 2 + (q / ay) ** 2
    if not e < DARK:
        return 0.0
    return np.exp(-e) * (1.0 + p * p + q * q) / (2.0 * np.pi * ax * ay * hz)


@njit()
def weight(form, ax, ay, ix, iy, iz, ox, oy, oz):
    """f cos_i / pdf: what a sample of light from i counts, per rho_s.

    The lobe cancels, so that the weight neither depends on alpha nor underflows:
    bounded 2 / (1 + cos_o / cos_i), never above 2
    ward    sqrt(cos_i / cos_o) h.z^3 / (2 h.h)
    duer    h.z^3 / (2 cos_o h.h)
    """
    if not (iz > HORIZON and oz > HORIZON):
        return 0.0
    hz = iz + oz
    if form == BOUNDED:
        return 2.0 * iz / hz
    p, q = (ix + ox) / hz, (iy + oy) / hz
    steep = hz / (2.0 * (1.0 + p * p + q * q))
    if form == WARD:
        return np.sqrt(iz / oz) * steep
    return steep / oz


@njit()
def d_log_value(form, ax, ay, ix, iy, iz, ox, oy, oz):
    """(d ln f / d ax, d ln f / d ay, d ln f / d phi); phi turns the tangent about the normal, x towards y.

    0 below the horizon.
    The same for every form. For ax = ay the last is 0: the fit must not be asked for a direction there.
    """
    if not (iz > HORIZON and oz > HORIZON):
        return 0.0, 0.0, 0.0
    hz = iz + oz
    p, q = (ix + ox) / hz, (iy + oy) / hz
    return (2.0 * (p / ax) ** 2 - 1.0) / ax, (2.0 * (q / ay) ** 2 - 1.0) / ay, 2.0 * p * q * (1.0 / ay**2 - 1.0 / ax**2)


@njit()
def frame(normal, tangent):
    """Two unit axes in the plane across a unit normal, as tuples: x along the tangent's projection, y = normal cross x.

    normal, tangent : (3,); the tangent of any length. Where it is null, not a number, or within 1e-6 of the normal's
    direction, the coordinate axis that is farthest from the normal takes its place.

    >>> frame(np.array([0., 0., 1.]), np.array([0., 2., 5.]))
    ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
    """
    nx, ny, nz = normal[0], normal[1], normal[2]
    tx, ty, tz = tangent[0], tangent[1], tangent[2]
    for _ in range(2):
        largest = max(abs(tx), abs(ty), abs(tz))
        if 0.0 < largest < np.inf:
            tx, ty, tz = tx / largest, ty / largest, tz / largest
            along = nx * tx + ny * ty + nz * tz
            x, y, z = tx - along * nx, ty - along * ny, tz - along * nz
            length = np.sqrt(x * x + y * y + z * z)
            if length > 1e-6:
                x, y, z = x / length, y / length, z / length
                return (x, y, z), (ny * z - nz * y, nz * x - nx * z, nx * y - ny * x)
        least = min(abs(nx), abs(ny), abs(nz))
        tx, ty, tz = 0.0, 0.0, 0.0
        if abs(nx) == least:
            tx = 1.0
        elif abs(ny) == least:
            ty = 1.0
        else:
            tz = 1.0
    return (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)  # a normal that is none


@njit()
def albedo_integral(form, ax, ay, theta, phi, node, share):
    """See `albedo` of lib/light/ward.py.  node, share : of a quadrature on [0, 1]"""
    ox, oy, oz = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    if not oz > HORIZON:
        return 0.0
    level = np.arctan2(oy * ay, ox * ax) + np.pi / 2  # here h leans neither to nor from o, and again half a turn on
    total = 0.0
    for j in range(2 * len(node)):
        psi = level + np.pi * (node[j % len(node)] + j // len(node))
        a, b = ax * np.cos(psi), ay * np.sin(psi)
        k, m = ox * a + oy * b, a * a + b * b  # above the horizon where oz m r^2 - 2 k r - oz < 0
        root = np.sqrt(k * k + oz * oz * m)
        end = min(6.1, (k + root) / (oz * m) if k > 0 else oz / (root - k))
        for i in range(len(node)):
            r = end * node[i]
            p, q = a * r, b * r
            twice = 2.0 * (k * r + oz) / (1.0 + p * p + q * q)
            total += (
                weight(form, ax, ay, twice * p - ox, twice * q - oy, twice - oz, ox, oy, oz)
                * r
                * np.exp(-r * r)
                * end
                * share[i]
                * share[j % len(node)]
            )
    return total  # density 2 r exp(-r^2) dr dpsi / (2 pi), panels of pi


@njit()
def value_each(form, ax, ay, i, o):
    """`value` of directions i, o (n, 3) -> (n,)"""
    result = np.empty(len(i))
    for k in range(len(i)):
        result[k] = value(form, ax, ay, i[k, 0], i[k, 1], i[k, 2], o[k, 0], o[k, 1], o[k, 2])
    return result


@njit()
def pdf_each(ax, ay, i, o):
    """`pdf` of directions i, o (n, 3) -> (n,)"""
    result = np.empty(len(i))
    for k in range(len(i)):
        result[k] = pdf(ax, ay, i[k, 0], i[k, 1], i[k, 2], o[k, 0], o[k, 1], o[k, 2])
    return result


@njit()
def weight_each(form, ax, ay, i, o):
    """`weight` of directions i, o (n, 3) -> (n,)"""
    result = np.empty(len(i))
    for k in range(len(i)):
        result[k] = weight(form, ax, ay, i[k, 0], i[k, 1], i[k, 2], o[k, 0], o[k, 1], o[k, 2])
    return result


@njit()
def d_log_value_each(form, ax, ay, i, o):
    """`d_log_value` of directions i, o (n, 3) -> (n, 3)"""
    result = np.empty((len(i), 3))
    for k in range(len(i)):
        result[k] = d_log_value(form, ax, ay, i[k, 0], i[k, 1], i[k, 2], o[k, 0], o[k, 1], o[k, 2])
    return result


@njit()
def sample_each(ax, ay, o, u, v):
    """`sample` from o (3,) for u, v (n,) -> (n, 3)"""
    result = np.empty((len(u), 3))
    for k in range(len(u)):
        result[k] = sample(ax, ay, o[0], o[1], o[2], u[k], v[k])
    return result
