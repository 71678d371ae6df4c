"""Compiled: a plane from the borders of a pair of regions."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit
from lib.vision import matching_kernels as kernels
from lib.vision.facets.borders_kernels import SURE

# px: no border point is better than this, for pixels are not ideal windows and light does not mix in display values.
FLOOR = 0.03
# Of the residuals over sigma: even without any noise a picture tells no more than this.
LEAST_SCALE = 0.05

# The columns of a table of border points: what the plane's equations are made of. 0 to 2 are the coefficients of
# (a, b, c) over sigma.
RESIDUAL = 3  # over sigma
WEIGHT = 4  # Tukey's
NORMAL_U = 5  # of the right border
PART = 6  # side of the outline
SIGMA = 7  # px
U, V = 8, 9  # rectified px of the left point
NORMAL_V = 10  # of the right border
COLUMNS = 11


class Border(NamedTuple):
    """The border points of one region, sorted by v."""

    uv: np.ndarray  # (n, 2) rectified px
    normal: np.ndarray  # (n, 2) outward
    sigma: np.ndarray  # (n,) px along the normal
    bend: np.ndarray  # (n,) px: how far its neighbours are off a line


@njit()
def contour_rows(plane, centre, reach, scale, left, part, right, rows):
    """Compare the left border, moved by the plane (a, b, c at the centre), with the right one, along its normal.

    centre : (u, v);  part : (n,) side of the outline of each left point
    reach : px, of Tukey's weight;  scale : of the sigma of well located points
    rows : (n, COLUMNS), out: of each point that has a partner. Returns their number.
    """
    u0, v0 = centre
    luv, lnormal, lsigma, lbend = left
    ruv, rnormal, rsigma, rbend = right
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
        if abs(du * nv - dv * nu) > 1.5:  # beyond the border's end
            continue
        sigma = np.sqrt(lsigma[k] ** 2 + rsigma[at] ** 2 + 2 * FLOOR**2)
        if sigma < SURE:
            sigma *= scale
        r = nu * du + nv * dv
        cut = max(reach, 4.7 * sigma)
        rows[n, 0], rows[n, 1], rows[n, 2] = -nu * du0 / sigma, -nu * dv0 / sigma, -nu / sigma
        rows[n, RESIDUAL] = r / sigma
        rows[n, WEIGHT] = (1 - (r / cut) ** 2) ** 2 if abs(r) < cut else 0.0
        rows[n, NORMAL_U], rows[n, NORMAL_V], rows[n, PART] = nu, nv, part[k]
        rows[n, SIGMA], rows[n, U], rows[n, V] = sigma, luv[k, 0], v
        n += 1
    return n


@njit()
def fit_contours(plane, centre, size, reach, iterations, left, part, right, rows):
    """Iterate to the plane; rows as above at the last step, sigma as the residuals show it. Returns the plane and n.

    size : px, of the region;  iterations : at most
    """
    plane = plane.copy()
    A, b = np.zeros((3, 3)), np.zeros(3)
    scale, n = 1.0, 0
    for iteration in range(iterations + 1):
        n = contour_rows(plane, centre, reach, scale, left, part, right, rows)
        if n < 4 or iteration == iterations:
            break
        # What the borders do not say stays as it is.
        A[:] = 0
        b[:] = 0
        A[0, 0], A[1, 1], A[2, 2] = 1e-2 * size**2, 1e-2 * size**2, 1e-2
        for k in range(n):
            for p in range(3):
                for q in range(3):
                    A[p, q] += rows[k, WEIGHT] * rows[k, p] * rows[k, q]
                b[p] -= rows[k, WEIGHT] * rows[k, p] * rows[k, RESIDUAL]
        s0, s1, s2 = kernels.solve3(A, b)
        plane[0] += s0
        plane[1] += s1
        plane[2] += s2
        strong = rows[:n, RESIDUAL][rows[:n, SIGMA] < SURE * scale]
        if len(strong) >= 20:  # what the residuals say of sigma, unless they are too few
            scale = max(scale * max(1.4826 * np.median(np.abs(strong)), 0.1), LEAST_SCALE)
        small = abs(s0) * size + abs(s1) * size + abs(s2) < 1e-4
        if reach == 0 and small:
            break
        reach = 0.6 * reach if reach > 0.3 else 0.0
    return plane, n
