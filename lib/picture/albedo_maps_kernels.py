"""Compiled: albedos resampled from the photograph into texels."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange

REACH = 5  # pixels: so far from its pixels a texture is continued


class Grid(NamedTuple):
    """The texels of a facet, and where they are in the window of the photograph that is used."""

    H: np.ndarray  # (3, 3) of (u, v, 1), local lengths, to pixels
    nu: int
    nv: int
    du: float  # width of a texel, local
    dv: float
    x0: int  # the window's first pixel
    y0: int


class Samples(NamedTuple):
    """Albedos of the window's pixels."""

    a: np.ndarray  # (h, w, C)
    variance: np.ndarray  # (h, w, C) of its noise, inf: unknown
    near: np.ndarray  # (h, w) px to the next known pixel


class Prior(NamedTuple):
    """What is known of the texture before a pixel is looked at."""

    constant: np.ndarray  # (C,) mean
    tau2: np.ndarray  # (C,) variance
    correlation: np.ndarray  # (C, REACH + 2) at distances of 0, 1, ... pixels


@njit(parallel=True)
def resample(grid: Grid, samples: Samples, prior: Prior):
    """albedo (nu, nv, C), known (nu, nv) and the variance that is left (nu, nv), see lib/picture/albedo_maps.py."""
    constant, tau2, correlation = prior
    nu, nv, C = grid.nu, grid.nv, samples.a.shape[2]
    albedo = np.empty((nu, nv, C), np.float32)
    known, left = np.zeros((nu, nv), np.float32), np.zeros((nu, nv), np.float32)
    for i in prange(nu):
        value, told = np.empty(C), np.empty(C)
        for j in range(nv):
            value[:], told[:] = 0.0, 0.0
            texel(grid, i, j, samples, prior, value, told)
            for c in range(C):
                albedo[i, j, c] = constant[c] + value[c]
                told[c] *= 0.5 * (1 + correlation[c, 1])
                known[i, j] += told[c] / C
                left[i, j] += tau2[c] * max(0.0, 1 - told[c]) / C
    return albedo, known, left


@njit()
def texel(grid: Grid, i, j, samples: Samples, prior: Prior, value, told):
    """Write into value (C,) the albedo of a texel less the constant, and into told (C,) the share that pixels tell."""
    H, u, v = grid.H, (i + 0.5) * grid.du, (j + 0.5) * grid.dv
    z = H[2, 0] * u + H[2, 1] * v + H[2, 2]
    if not z > 0:
        return
    x, y = (H[0, 0] * u + H[0, 1] * v + H[0, 2]) / z, (H[1, 0] * u + H[1, 1] * v + H[1, 2]) / z
    rx = max(1.0, np.hypot((H[0, 0] - x * H[2, 0]) * grid.du, (H[0, 1] - x * H[2, 1]) * grid.dv) / z)
    ry = max(1.0, np.hypot((H[1, 0] - y * H[2, 0]) * grid.du, (H[1, 1] - y * H[2, 1]) * grid.dv) / z)
    x, y = x - grid.x0, y - grid.y0
    h, w = samples.near.shape
    if not (-0.5 <= x < w - 0.5 and -0.5 <= y < h - 0.5):
        return
    if samples.near[int(y + 0.5), int(x + 0.5)] <= REACH + rx + ry:
        share = np.zeros(len(value))
        under_tent(x, y, rx, ry, samples, prior, share, value, told)
        if (share < 1 - 1e-6).any():
            from_afar(x, y, samples, prior, share, value, told)


@njit()
def under_tent(x, y, rx, ry, samples: Samples, prior: Prior, share, value, told):
    """Add to value and told (C,) what the known pixels under the tent about (x, y) say.

    rx, ry : half widths of the tent, px;  share : (C,) how much of the tent stands on known pixels, written
    """
    a, variance, _ = samples
    constant, tau2, _ = prior
    h, w, C = a.shape
    total, mean, noise = np.zeros(C), np.zeros(C), np.zeros(C)
    for b in range(max(0, int(np.ceil(y - ry))), min(h - 1, int(np.floor(y + ry))) + 1):
        for d in range(max(0, int(np.ceil(x - rx))), min(w - 1, int(np.floor(x + rx))) + 1):
            tent = (1 - abs(d - x) / rx) * (1 - abs(b - y) / ry)
            for c in range(C):
                if variance[b, d, c] < np.inf:
                    share[c] += tent
                    add(tent, a[b, d, c], variance[b, d, c], tau2[c], total, mean, noise, c)
    whole = tent_sum(x, rx) * tent_sum(y, ry)
    for c in range(C):
        share[c] = min(1.0, share[c] / whole)
        if total[c] > 0:
            k = trust(total[c], noise[c], tau2[c]) * share[c]
            value[c], told[c] = k * (mean[c] / total[c] - constant[c]), k


@njit()
def tent_sum(x, r):
    """Sum of the tent of half width r >= 1 about x over all whole numbers; 1 for r = 1."""
    s = 0.0
    for k in range(int(np.ceil(x - r)), int(np.floor(x + r)) + 1):
        s += 1 - abs(k - x) / r
    return s


@njit()
def add(weight, a, variance, tau2, total, mean, noise, c):
    """Count a pixel by its distance, and less where its noise is large against the texture's variance.

    Next to a good pixel a noisy one then does no harm.  total, mean, noise : (C,), in place
    """
    weight *= tau2 / (tau2 + variance) if variance > 0 else 1.0
    total[c] += weight
    mean[c] += weight * a
    noise[c] += weight * weight * variance


@njit()
def trust(total, noise, tau2):
    """The best weight k of a mean, from its weights' sum and the noise in it."""
    s2 = noise / (total * total)
    return tau2 / (tau2 + s2) if tau2 > 0 else 0.0


@njit()
def from_afar(x, y, samples: Samples, prior: Prior, share, value, told):
    """Add to value and told (C,) what the known pixels within REACH say of (x, y).

    share : (C,) of the tent that stands on known pixels; the rest of it takes its value from afar
    """
    a, variance, _ = samples
    constant, tau2, correlation = prior
    h, w, C = a.shape
    total, mean, noise, nearest = np.zeros(C), np.zeros(C), np.zeros(C), np.full(C, np.inf)
    for b in range(max(0, int(np.ceil(y - REACH - 1))), min(h - 1, int(np.floor(y + REACH + 1))) + 1):
        for d in range(max(0, int(np.ceil(x - REACH - 1))), min(w - 1, int(np.floor(x + REACH + 1))) + 1):
            r = np.hypot(d - x, b - y)
            if r < REACH + 1:
                for c in range(C):
                    if variance[b, d, c] < np.inf:
                        nearest[c] = min(nearest[c], r)
                        add(
                            (1 - r / (REACH + 1)) ** 2 / (r * r + 0.1),
                            a[b, d, c],
                            variance[b, d, c],
                            tau2[c],
                            total,
                            mean,
                            noise,
                            c,
                        )
    for c in range(C):
        if total[c] > 0 and share[c] < 1:
            step = int(nearest[c])
            t = nearest[c] - step
            alike = ((1 - t) * correlation[c, step] + t * correlation[c, step + 1]) * min(1.0, REACH + 1 - nearest[c])
            k = trust(total[c], noise[c], tau2[c]) * (1 - share[c])
            value[c] += k * alike * (mean[c] / total[c] - constant[c])
            told[c] += k * alike * alike


@njit()
def inside_share(uv, nu, nv):
    """(nu, nv) float32: the share of each texel's 4 x 4 points that lie in a triangle.

    uv : (T, 3, 2) the triangles, in parts of the rectangle
    """
    count = np.zeros((4 * nu, 4 * nv), np.bool_)
    for t in range(len(uv)):
        px, py = uv[t, :, 0] * 4 * nu - 0.5, uv[t, :, 1] * 4 * nv - 0.5
        turn = (px[1] - px[0]) * (py[2] - py[0]) - (px[2] - px[0]) * (py[1] - py[0])
        for i in range(max(0, int(np.ceil(px.min()))), min(4 * nu - 1, int(np.floor(px.max()))) + 1):
            for j in range(max(0, int(np.ceil(py.min()))), min(4 * nv - 1, int(np.floor(py.max()))) + 1):
                within = True
                for e in range(3):
                    n = (e + 1) % 3
                    within &= ((px[n] - px[e]) * (j - py[e]) - (i - px[e]) * (py[n] - py[e])) * turn >= 0
                count[i, j] |= within
    result = np.zeros((nu, nv), np.float32)
    for i in range(4 * nu):
        for j in range(4 * nv):
            result[i // 4, j // 4] += count[i, j] / 16
    return result


@njit()
def bilinear_many(albedo, uv):
    """(M, C) `bilinear` at uv (M, 2)."""
    result = np.empty((len(uv), albedo.shape[2]))
    for m in range(len(uv)):
        bilinear(albedo, uv[m, 0], uv[m, 1], result[m])
    return result


@njit()
def bilinear(albedo, u, v, result):
    """Writes into result (C,) the albedo (nu, nv, C) at u, v in parts of the rectangle, for kernels to call."""
    nu, nv, C = albedo.shape
    s, t = min(max(u * nu - 0.5, 0.0), nu - 1.0), min(max(v * nv - 0.5, 0.0), nv - 1.0)
    i, j = min(int(s), max(nu - 2, 0)), min(int(t), max(nv - 2, 0))
    k, n = min(i + 1, nu - 1), min(j + 1, nv - 1)
    s, t = s - i, t - j
    for c in range(C):
        result[c] = (1 - s) * ((1 - t) * albedo[i, j, c] + t * albedo[i, n, c]) + s * (
            (1 - t) * albedo[k, j, c] + t * albedo[k, n, c]
        )
