"""Compiled: a plane from the borders of a pair of regions."""

import numpy as np

from lib.core.compiled import njit
from lib.vision import matching_kernels as kernels
from lib.vision.facets.borders_kernels import WEAK

# -- contours

FLOOR = 0.03  # px: pixels are not ideal windows, light does not mix in display values: no border point is better

LEAST_SCALE = 0.05  # of the residuals over sigma: pictures without any noise are still no better known than this


@njit()
def contour_rows(plane, u0, v0, reach, scale, luv, lnormal, lsigma, lbend, lpart, ruv, rnormal, rsigma, rbend, rows):
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
        if abs(du * nv - dv * nu) > 1.5:  # beyond the border's end
            continue
        sigma = np.sqrt(lsigma[k] ** 2 + rsigma[at] ** 2 + 2 * FLOOR**2)
        if sigma < 0.5 * WEAK:
            sigma *= scale
        r = nu * du + nv * dv
        cut = max(reach, 4.7 * sigma)
        rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = -nu * du0 / sigma, -nu * dv0 / sigma, -nu / sigma, r / sigma
        rows[n, 4] = (1 - (r / cut) ** 2) ** 2 if abs(r) < cut else 0.0
        rows[n, 5], rows[n, 6], rows[n, 7], rows[n, 8], rows[n, 9] = nu, lpart[k], sigma, luv[k, 0], v
        n += 1
    return n


@njit()
def fit_contours(plane, u0, v0, size, reach, iterations, left, right, rows):
    """Iterate to the plane; rows as above at the last step, sigma as the residuals show it. Returns the plane and n."""
    plane = plane.copy()
    A, b = np.zeros((3, 3)), np.zeros(3)
    scale, n = 1.0, 0
    for iteration in range(iterations + 1):
        n = contour_rows(plane, u0, v0, reach, scale, *left, *right, rows)
        if n < 4 or iteration == iterations:
            break
        # What the borders do not say stays as it is.
        A[:] = 0
        b[:] = 0
        A[0, 0], A[1, 1], A[2, 2] = 1e-2 * size**2, 1e-2 * size**2, 1e-2
        for k in range(n):
            for p in range(3):
                for q in range(3):
                    A[p, q] += rows[k, 4] * rows[k, p] * rows[k, q]
                b[p] -= rows[k, 4] * rows[k, p] * rows[k, 3]
        s0, s1, s2 = kernels.solve3(A, b)
        plane[0] += s0
        plane[1] += s1
        plane[2] += s2
        strong = rows[:n, 3][rows[:n, 7] < 0.5 * WEAK * scale]
        if len(strong) >= 20:  # what the residuals say of sigma, unless they are too few
            scale = max(scale * max(1.4826 * np.median(np.abs(strong)), 0.1), LEAST_SCALE)
        small = abs(s0) * size + abs(s1) * size + abs(s2) < 1e-4
        if reach == 0 and small:
            break
        reach = 0.6 * reach if reach > 0.3 else 0.0
    return plane, n
