"""Compiled: places on a glossy plane by which a lamp lights a place."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit, prange
from lib.given.rays_kernels import OFFSET
from lib.light import ward_kernels as ward
from lib.light.lamps_kernels import LampArrays, on_lamp, thrown
from lib.light.paths_kernels import Lobes
from lib.light.sampling_kernels import scrambled
from lib.light.surface_kernels import SurfaceArrays

FLAT = 1e-7  # local: what lies nearer to a plane is in it


class GlintArrays(NamedTuple):
    """How often the ways of a place by each facet are sought from the lamp, and where they begin."""

    ways: np.ndarray  # (F,) such ways of each place, 0: none
    shot: np.ndarray  # (n,) gathering rays of the place that each ray came from
    normal: np.ndarray  # (n, 3) of the side of that place


@njit(inline="always")
def geometry(p, x, f, surface: SurfaceArrays, axes):
    """Where the plane of facet f mirrors x to p, and how half vectors lean around there.

    axes : (F, 2, 3) tangent frames
    Returns whether it does, the place's two coordinates from p's foot, the unit direction (2) of the plane of
    incidence, and by how much a step along it and one across it lean the half vector: s = lean_along * step.
    """
    a, b, u, v = 0.0, 0.0, 0.0, 0.0
    for d in range(3):
        a += (x[d] - surface.origin[f, d]) * surface.normal[f, d]
        b += (p[d] - surface.origin[f, d]) * surface.normal[f, d]
        u += (x[d] - p[d]) * axes[f, 0, d]
        v += (x[d] - p[d]) * axes[f, 1, d]
    if not a * b > FLAT * FLAT:
        return False, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0
    a, b = abs(a), abs(b)
    D = np.sqrt(u * u + v * v)
    R = np.sqrt(D * D + (a + b) ** 2)
    cosine = (a + b) / R
    k = (a + b) ** 2 / (R * a * b)  # 1 / r1 + 1 / r2
    at = b / (a + b)
    eu, ev = (u / D, v / D) if D > 1e-12 else (1.0, 0.0)
    return True, at * u, at * v, eu, ev, 0.5 * k * cosine, 0.5 * k / cosine


@njit(inline="always")
def chance(p, y, x, f, ax, ay, surface: SurfaceArrays, axes):
    """Density at y, per local area, of the places on facet f that `found` draws for p and the lamp's place x."""
    does, u, v, eu, ev, along, across = geometry(p, x, f, surface, axes)
    if not does:
        return 0.0
    for d in range(3):
        u -= (y[d] - p[d]) * axes[f, 0, d]
        v -= (y[d] - p[d]) * axes[f, 1, d]
    s, t = along * (u * eu + v * ev), across * (v * eu - u * ev)
    e = ((s * eu - t * ev) / ax) ** 2 + ((s * ev + t * eu) / ay) ** 2
    return np.exp(-e) / (np.pi * ax * ay) * along * across if e < ward.DARK else 0.0


@njit(inline="always")
def often(p, n, y, x, f, ax, ay, ratio, surface: SurfaceArrays, axes):
    """How often y is drawn from the lamp's place x, over how often gathering rays from p find it.

    n : (3,) of the side on which p lies
    """
    if ratio == 0.0:
        return 0.0
    squared, here, there = 0.0, 0.0, 0.0
    for d in range(3):
        w = y[d] - p[d]
        squared += w * w
        here += w * n[d]
        there += w * surface.normal[f, d]
    gathered = abs(here * there) / (np.pi * max(squared, 1e-300) ** 2)
    return ratio * chance(p, y, x, f, ax, ay, surface, axes) / max(gathered, 1e-300)


@njit(parallel=True)
def often_each(which, rays, y, x, facet, group, glints: GlintArrays, lobes: Lobes, surface: SurfaceArrays):
    """`often` of ways (n,) that begin with the rays (n, 6) and go by y to x (n, 3). group : (n,) specular ones

    which : (n,) rows of glints.shot and glints.normal
    """
    result = np.empty(len(which))
    for j in prange(len(which)):
        f = facet[j]
        ax, ay = lobes.alpha[group[j], 0], lobes.alpha[group[j], 1]
        p = np.empty(3)
        for d in range(3):
            p[d] = rays[j, d]
        n = glints.normal[which[j]]
        ratio = glints.ways[f] / glints.shot[which[j]]
        result[j] = often(p, n, y[j], x[j], f, ax, ay, ratio, surface, lobes.axes)
    return result


@njit(parallel=True)
def found(n, places, normal, f, group, ratio, lamp: LampArrays, area, lobes: Lobes, surface: SurfaceArrays, words):
    """n ways from each of K places by facet f to the lamp: what they bring for E = 1 and rho_s = 1, per gathering ray.

    places : first, last (K,), p (M, 3);  normal : (K, 3) of their sides;  ratio : (K,) such ways over gathering rays
    area : of the lamp
    words : sequence (n, 4), shift (K, 4) uint32 of places on the lamp and slopes
    Returns rays (K n, 6) to the facet, rays (K n, 6) on to the lamp, and value (K n,), 0 where nothing comes.
    The value is the balance heuristic's, see lib/light/specular_lamps.py; whether something stands on the way is not
    asked, nor whether the place lies on the facet and not only in its rectangle.
    """
    first, last, points = places
    sequence, shift = words
    ax, ay = lobes.alpha[group, 0], lobes.alpha[group, 1]
    axes, side_normal = lobes.axes, surface.normal[f]
    K = len(first)
    to, on = np.zeros((K * n, 6), np.float32), np.zeros((K * n, 6), np.float32)
    value = np.zeros(K * n)
    for i in prange(K):
        p, x, y = np.empty(3), np.empty(3), np.empty(3)
        for j in range(n):
            row = i * n + j
            w0, w1 = scrambled(sequence[j, 0], shift[i, 0]), scrambled(sequence[j, 1], shift[i, 1])
            w2, w3 = scrambled(sequence[j, 2], shift[i, 2]), scrambled(sequence[j, 3], shift[i, 3])
            spot = (w0 + 0.6180339887498949 * (j + 0.5)) % 1.0
            q = first[i] + min(last[i] - first[i] - 1, int(spot * (last[i] - first[i])))
            k, c0, c1, c2 = on_lamp(w0, w1, lamp.cdf)
            height = 0.0
            for d in range(3):
                p[d] = points[q, d] + OFFSET * normal[i, d]
                x[d] = c0 * lamp.corners[k, 0, d] + c1 * lamp.corners[k, 1, d] + c2 * lamp.corners[k, 2, d]
                x[d] += OFFSET * lamp.normal[k, d]
                height += (p[d] - surface.origin[f, d]) * side_normal[d]
            does, u, v, eu, ev, along, across = geometry(p, x, f, surface, axes)
            sign = 1.0 if height > 0 else -1.0
            if not does or surface.inside[2 * f + (0 if height > 0 else 1)]:
                continue
            r = np.sqrt(-np.log(w2))
            s, t = ax * r * np.cos(2 * np.pi * w3), ay * r * np.sin(2 * np.pi * w3)
            step, aside = (s * eu + t * ev) / along, (t * eu - s * ev) / across
            u += step * eu - aside * ev
            v += step * ev + aside * eu
            here, a, b = 0.0, 0.0, 0.0
            for d in range(3):
                y[d] = p[d] - height * side_normal[d] + u * axes[f, 0, d] + v * axes[f, 1, d]
                here += (y[d] - p[d]) * normal[i, d]
                a += (y[d] - surface.origin[f, d]) * surface.axes[f, 0, d]
                b += (y[d] - surface.origin[f, d]) * surface.axes[f, 1, d]
            if here <= 0 or not (0 <= a <= surface.size[f, 0] and 0 <= b <= surface.size[f, 1]):
                continue
            near, far, there = 0.0, 0.0, 0.0
            ix, iy, iz, ox, oy, oz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for d in range(3):
                begin = y[d] + OFFSET * sign * side_normal[d]
                c, e = x[d] - begin, p[d] - y[d]
                to[row, d], to[row, 3 + d] = p[d], -e
                on[row, d], on[row, 3 + d] = begin, c
                near += e * e
                far += c * c
                there -= c * lamp.normal[k, d]
                ix += c * axes[f, 0, d]
                iy += c * axes[f, 1, d]
                iz += c * sign * side_normal[d]
                ox += e * axes[f, 0, d]
                oy += e * axes[f, 1, d]
                oz += e * sign * side_normal[d]
            if iz <= 0 or there <= 0 or oz <= 0:
                continue
            near, far = np.sqrt(near), np.sqrt(far)
            for d in range(3):
                to[row, 3 + d] /= near
            ix, iy, iz, there = ix / far, iy / far, iz / far, there / far
            ox, oy, oz = ox / near, oy / near, oz / near
            density = far * far / (there * area)
            more = often(p, normal[i], y, x, f, ax, ay, ratio[i], surface, axes)
            reflected = ward.value(lobes.form, ax, ay, ix, iy, iz, ox, oy, oz)
            reflected *= thrown(lamp.lobe, -on[row, 3], -on[row, 4], -on[row, 5])
            value[row] = reflected * iz / (density * (1 + more) + ward.pdf(ax, ay, ix, iy, iz, ox, oy, oz))
    return to, on, value
