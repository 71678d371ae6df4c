"""Compiled: what the sub-pixels of mixed pixels show."""

import numpy as np

from lib.core.compiled import njit, prange
from lib.picture.pixel_light_kernels import aim


@njit(inline="always")
def sub_direction(k, pixel, width, M, v):
    """Direction through sub-pixel k of 64 to a pixel, not normalised, into v."""
    i = k // 64
    x = pixel[i] % width + (k % 8 + 0.5) / 8 - 0.5
    y = pixel[i] // width + (k % 64 // 8 + 0.5) / 8 - 0.5
    for d in range(3):
        v[d] = M[d, 0] * x + M[d, 1] * y + M[d, 2]


@njit(parallel=True)
def sub_rays(a, b, pixel, width, eye, M):
    rays = np.empty((b - a, 6), np.float32)
    for k in prange(a, b):
        v = np.empty(3)
        sub_direction(k, pixel, width, M, v)
        length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        for d in range(3):
            rays[k - a, d] = eye[d]
            rays[k - a, 3 + d] = v[d] / length
    return rays


@njit(parallel=True)
def sort_out(base, rays, triangle, eye, M, pixel, width, start, facet, facet_of, normal, origin, owner, at):
    for k in prange(base, base + len(rays)):
        if triangle[k - base] < 0:
            continue
        i, f = k // 64, facet_of[triangle[k - base]]
        for j in range(start[i], start[i + 1]):
            if facet[j] == f:
                v = np.empty(3)
                sub_direction(k, pixel, width, M, v)
                height, along = 0.0, 0.0
                for d in range(3):
                    height += (origin[f, d] - eye[d]) * normal[f, d]
                    along += v[d] * normal[f, d]
                owner[k] = j
                for d in range(3):
                    at[k, d] = eye[d] + v[d] * height / (along if abs(along) > 1e-12 else 1e-12)


@njit(parallel=True)
def fragment_rays(which, rank, sequence, shift, owner, side, at, normal, lamp, front, cdf):
    rays = np.empty((len(which), 6), np.float32)
    weight = np.empty(len(which), np.float32)
    for j in prange(len(which)):
        i = which[j]
        k, s = rank[j], side[owner[i]]
        u = ((sequence[k, 0] ^ shift[owner[i], 0]) + 0.5) / 4294967296.0
        v = ((sequence[k, 1] ^ shift[owner[i], 1]) + 0.5) / 4294967296.0
        weight[j] = aim(at[i], normal[s >> 1], 1.0 - 2.0 * (s & 1), u, v, lamp, front, cdf, rays, j)
    return rays, weight


@njit()
def beside(picture, facet, pixel, start, fragment):
    H, W, C = picture.shape
    value = np.zeros((len(fragment), C))
    found = np.zeros(len(fragment), np.bool_)
    for i in range(len(pixel)):
        y, x = pixel[i] // W, pixel[i] % W
        for k in range(start[i], start[i + 1]):
            if facet[y, x] == fragment[k]:
                value[k] = picture[y, x]
                found[k] = True
                continue
            for ring in range(1, 4):
                nearest = 1 << 30
                n = 0
                for b in range(max(y - ring, 0), min(y + ring, H - 1) + 1):
                    for a in range(max(x - ring, 0), min(x + ring, W - 1) + 1):
                        if facet[b, a] != fragment[k]:
                            continue
                        d = (a - x) ** 2 + (b - y) ** 2
                        if d < nearest:
                            nearest, n = d, 0
                            value[k] = 0
                        if d == nearest:
                            value[k] += picture[b, a]
                            n += 1
                if n > 0:
                    value[k] /= n
                    found[k] = True
                    break
    return value, found
