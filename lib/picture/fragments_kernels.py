"""Compiled: what the sub-pixels of mixed pixels show."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.light.lamps_kernels import LampArrays, aim
from lib.light.sampling_kernels import scrambled
from lib.light.surface_kernels import SurfaceArrays
from lib.picture.pixels_kernels import Viewer


class MixedPixels(NamedTuple):
    """The A-buffer; see Fragments."""

    pixel: np.ndarray  # (P,)
    start: np.ndarray  # (P + 1,) into facet
    facet: np.ndarray  # (S,)
    width: int  # of the picture


class SubPixels(NamedTuple):
    """Which fragment each sub-pixel shows, and where; see Fragments."""

    owner: np.ndarray  # (64 P,)
    at: np.ndarray  # (64 P, 3)
    side: np.ndarray  # (S,) of each fragment


@njit(inline="always")
def sub_direction(k, pixel, width, M, v):
    """Direction through sub-pixel k of 64 to a pixel, not normalised, into v."""
    i = k // 64
    x = pixel[i] % width + (k % 8 + 0.5) / 8 - 0.5
    y = pixel[i] // width + (k % 64 // 8 + 0.5) / 8 - 0.5
    for d in range(3):
        v[d] = M[d, 0] * x + M[d, 1] * y + M[d, 2]


@njit(parallel=True)
def sub_rays(a, b, mixed: MixedPixels, viewer: Viewer):
    """Rays (b - a, 6) of the camera through the sub-pixels a..b-1."""
    pixel, width = mixed.pixel, mixed.width
    eye, M = viewer
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
def sort_out(base, triangle, mixed: MixedPixels, viewer: Viewer, surface: SurfaceArrays, owner, at):
    """Write into owner (64 P,) and at (64 P, 3) what the sub-pixels from `base` on show.

    triangle : (n,) that they meet, -1
    """
    pixel, start, facet, width = mixed
    eye, M = viewer
    facet_of, normal, origin = surface.facet, surface.normal, surface.origin
    for k in prange(base, base + len(triangle)):
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
def fragment_rays(which, rank, sequence, shift, places: SubPixels, surface: SurfaceArrays, lamp: LampArrays):
    """A shadow ray (n, 6) from each of the sub-pixels `which` (n,) to a lamp, and the light that takes it (n,).

    rank : (n,) place in the sequence;  shift : (S, 4)
    """
    owner, at, side = places
    normal = surface.normal
    rays = np.empty((len(which), 6), np.float32)
    weight = np.empty(len(which), np.float32)
    for j in prange(len(which)):
        i = which[j]
        k, s = rank[j], side[owner[i]]
        u = scrambled(sequence[k, 0], shift[owner[i], 0])
        v = scrambled(sequence[k, 1], shift[owner[i], 1])
        weight[j] = aim(at[i], normal[s >> 1], 1.0 - 2.0 * (s & 1), u, v, lamp, rays, j)
    return rays, weight


@njit()
def beside(picture, facet, mixed: MixedPixels):
    """For each fragment the mean of picture (H, W, C) over the nearest pixels of its facet, and whether there are any.

    facet : (H, W), -1;  pixels are looked for up to three away
    """
    pixel, start, fragment, _ = mixed
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
