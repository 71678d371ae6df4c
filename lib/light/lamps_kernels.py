"""Compiled: exact factors of polygons, and shadow rays to lamps."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light.sampling_kernels import scrambled


class LampArrays(NamedTuple):
    """What kernels need of an Emitter; see there."""

    corners: np.ndarray  # (K, 3, 3) local
    normal: np.ndarray  # (K, 3)
    cdf: np.ndarray  # (K,)
    lobe: np.ndarray  # (4,) unit aim and exponent, below 0 where it is lambertian


@njit(inline="always")
def thrown(lobe, x, y, z):
    """Radiance that a lamp throws along (x, y, z), of any length, over that along its aim: max(0, cos)^exponent."""
    if lobe[3] < 0:
        return 1.0
    along = x * lobe[0] + y * lobe[1] + z * lobe[2]
    if along <= 0:
        return 0.0
    return (along / np.sqrt(x * x + y * y + z * z)) ** lobe[3]


@njit()
def polygon_factor(p, n, corners, m, work):
    """Form factor from the element at p with normal n to a polygon, everything in front of it visible.

    Lambert's contour formula, the polygon first clipped at the element's horizon.
    corners : (>= m, 3), the first m are the polygon's;  work : (>= 2 m + 2, 3), room for the clipped polygon
    """
    k = 0
    for i in range(m):
        a = corners[i] - p
        b = corners[(i + 1) % m] - p
        da, db = np.dot(a, n), np.dot(b, n)
        if da >= 0:
            work[k] = a
            k += 1
        if (da > 0 and db < 0) or (da < 0 and db > 0):
            work[k] = a + (b - a) * (da / (da - db))
            k += 1
    total = 0.0
    for i in range(k):
        a = work[i]
        b = work[(i + 1) % k]
        c0 = a[1] * b[2] - a[2] * b[1]
        c1 = a[2] * b[0] - a[0] * b[2]
        c2 = a[0] * b[1] - a[1] * b[0]
        length = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
        if length > 0:
            total += np.arctan2(length, np.dot(a, b)) * (c0 * n[0] + c1 * n[1] + c2 * n[2]) / length
    return total / (2 * np.pi)


NARROW = 0.5  # of its distance: over a part of a lamp so large a lobe of exponent 3 is a polynomial
DEEPEST = 5  # times that a triangle of a lamp is halved
# a triangle's places (weights of its corners) and their weights, good to the fifth degree (Radon 1948)
A1, B1, A2, B2 = 0.059715871789770, 0.470142064105115, 0.797426985353087, 0.101286507323456
PLACES = np.array(
    [[1 / 3, 1 / 3, 1 / 3], [A1, B1, B1], [B1, A1, B1], [B1, B1, A1], [A2, B2, B2], [B2, A2, B2], [B2, B2, A2]]
)
WEIGHTS = np.array([0.225, *3 * [0.132394152788506], *3 * [0.125939180544827]])


@njit()
def share_of_lobe(p, n, corners, front, lobe):
    """What p with normal n receives of a triangle's light in a lobe, over what it would of lambertian light."""
    sent, whole = 0.0, 0.0
    for q in range(len(WEIGHTS)):
        x = p[0] - (PLACES[q, 0] * corners[0, 0] + PLACES[q, 1] * corners[1, 0] + PLACES[q, 2] * corners[2, 0])
        y = p[1] - (PLACES[q, 0] * corners[0, 1] + PLACES[q, 1] * corners[1, 1] + PLACES[q, 2] * corners[2, 1])
        z = p[2] - (PLACES[q, 0] * corners[0, 2] + PLACES[q, 1] * corners[1, 2] + PLACES[q, 2] * corners[2, 2])
        here = -(x * n[0] + y * n[1] + z * n[2])
        there = x * front[0] + y * front[1] + z * front[2]
        if here > 0 and there > 0:
            light = WEIGHTS[q] * here * there / (x * x + y * y + z * z) ** 2
            whole += light
            sent += light * thrown(lobe, x, y, z)
    return sent / whole if whole > 0 else 0.0


@njit()
def lobed_factor(p, n, corners, front, lobe, part, work):
    """The factor of a triangle that throws its light in a lobe, part by part.

    part : (3, 3), work : (8, 3), room for the parts and for clipping
    """
    size, distance = 0.0, 0.0
    for d in range(3):
        size = max(size, max(abs(corners[1, d] - corners[0, d]), abs(corners[2, d] - corners[0, d])))
        distance += (p[d] - (corners[0, d] + corners[1, d] + corners[2, d]) / 3) ** 2
    cuts, distance = 1, np.sqrt(distance) / np.sqrt(max(lobe[3] / 3, 1.0))
    while size > cuts * NARROW * distance and cuts < 1 << DEEPEST:
        cuts *= 2
    total = 0.0
    for i in range(cuts):
        for j in range(cuts - i):
            for upper in range(2 if i + j < cuts - 1 else 1):
                for k in range(3):  # (i, j), (i + 1, j), (i, j + 1) of the grid; the upper ones turned over
                    a, b = i + (k == 1), j + (k == 2)
                    if upper:
                        a, b = i + 1 - (k == 1), j + 1 - (k == 2)
                    for d in range(3):
                        part[k, d] = (
                            corners[0, d]
                            + (corners[1, d] - corners[0, d]) * a / cuts
                            + (corners[2, d] - corners[0, d]) * b / cuts
                        )
                share = share_of_lobe(p, n, part, front, lobe)
                if share > 0:
                    total += share * abs(polygon_factor(p, n, part, 3, work))
    return total


@njit(parallel=True)
def factors(p, normal_idx, normals, lamp: LampArrays):
    """(M,) sum over the lamp's triangles of the factor from each point, of those whose front faces it.

    What is thrown in a lobe counts by its share of what is thrown along the aim.
    p : (M, 3);  normals : (K, 3);  normal_idx : (M,)
    """
    corners, front, lobe = lamp.corners, lamp.normal, lamp.lobe
    out = np.zeros(len(p))
    for i in prange(len(p)):
        work, part = np.empty((8, 3)), np.empty((3, 3))
        n = normals[normal_idx[i]]
        for t in range(len(corners)):
            if np.dot(p[i] - corners[t, 0], front[t]) > 1e-12:
                if lobe[3] < 0:
                    out[i] += abs(polygon_factor(p[i], n, corners[t], 3, work))
                else:
                    out[i] += lobed_factor(p[i], n, corners[t], front[t], lobe, part, work)
    return out


# ---- shadow rays ----


@njit(inline="always")
def on_lamp(u, v, cdf):
    """A triangle of a lamp and the weights of its corners, of a place uniform over the lamp for uniform (u, v)."""
    t = 0
    while t < len(cdf) - 1 and cdf[t] <= u:
        t += 1
    low = cdf[t - 1] if t > 0 else 0.0
    r = np.sqrt(min(max((u - low) / (cdf[t] - low), 0.0), 1.0))
    return t, 1 - r, r * (1 - v), r * v


@njit(inline="always")
def aim(p, normal, sign, u, v, lamp: LampArrays, rays, row):
    """Write the shadow ray from p (3,) to the place (u, v) of a lamp; returns the light that takes it, up to a factor.

    normal : (3,) of the facet, times sign (1 or -1) that of the side;  rays : (n, 6), origin and vector
    """
    corners, front = lamp.corners, lamp.normal
    t, w0, w1, w2 = on_lamp(u, v, lamp.cdf)
    squared, here, there = 0.0, 0.0, 0.0
    for d in range(3):
        target = w0 * corners[t, 0, d] + w1 * corners[t, 1, d] + w2 * corners[t, 2, d]
        start = p[d] + OFFSET * sign * normal[d]
        x = target + OFFSET * front[t, d] - start
        rays[row, d] = start
        rays[row, 3 + d] = x
        squared += x * x
        here += x * sign * normal[d]
        there -= x * front[t, d]
    share = thrown(lamp.lobe, -rays[row, 3], -rays[row, 4], -rays[row, 5])
    return share * max(here, 0.0) * max(there, 0.0) / max(squared * squared, 1e-30)


@njit(parallel=True)
def shadow_rays(p, normal_idx, normals, which, points, shift, lamp: LampArrays):
    """Rays (m * n, 6) from the points p[which] to a lamp, n each, and the light that takes each way, up to a factor.

    points : (n, 4), shift : (m, 4) uint32
    """
    n = len(points)
    rays = np.empty((len(which) * n, 6), np.float32)
    weight = np.empty(len(which) * n, np.float32)
    for j in prange(len(which)):
        i = which[j]
        for k in range(n):
            u, v = scrambled(points[k, 0], shift[j, 0]), scrambled(points[k, 1], shift[j, 1])
            row = j * n + k
            weight[row] = aim(p[i], normals[normal_idx[i]], 1.0, u, v, lamp, rays, row)
    return rays, weight
