"""Local illumination (eq. 3.1), for comparison."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.given.rays_kernels import OFFSET
from lib.light import lamps
from lib.light.surface import Surface, side_normals, triangle_areas
from lib.picture.lighting import radiosities
from lib.picture.rendering import Picture, compose
from lib.picture.subject import Subject


def phong(surface: Surface, emitters, p, side, E):
    """(M, C) light by eq. 3.1, as the paper means it as a contrast.

    From the middle of each lamp's facets, (N.L) / d^2, no shadows, no interreflection; k_s = 0, because every surface
    here is diffuse. The ambient term is the caller's.
    p : (M, 3) local;  side : (M,);  E : (L, C)
    """
    normal = side_normals(surface)[side]
    lit = np.zeros((len(p), E.shape[1]))
    for lamp in emitters:
        area = triangle_areas(lamp.corners)
        to = (lamp.corners.mean(axis=1) * area[:, None]).sum(axis=0) / area.sum() - p
        d2 = np.maximum((to**2).sum(axis=1), OFFSET**2)
        lit += (np.maximum(np.einsum("ij,ij->i", to, normal), 0) / d2**1.5 * area.sum())[:, None] * E[lamp.lamp] / np.pi
    return lit


def ambient_and_power(r, lit, wanted, show):
    """The two free numbers of eq. 3.1 in each channel, ambient intensity and lamp power (C,).

    The non-negative ones of the least squares of show(c, r (ambient + power lit)) against `wanted`, all (M, C).
    """
    from scipy.optimize import least_squares

    some = slice(None, None, max(1, len(r) // 5000))
    ambient, power = np.zeros(r.shape[1]), np.ones(r.shape[1])
    for c in range(r.shape[1]):
        x, l, want = r[some, c], lit[some, c], wanted[some, c]
        if not x.any():
            continue
        level = max(float((x * l).mean()), 1e-12)
        start = np.array([0.3 * level / float(x.mean()), 1.0])

        def error(t, c=c, x=x, l=l, want=want):
            return show(c, x * (t[0] + t[1] * l)) - want

        ambient[c], power[c] = least_squares(error, start, bounds=([0, 0], [np.inf, np.inf]), x_scale=start).x
    return ambient, power


def phong_picture(subject: Subject, picture: Picture):
    """The same view by eq. 3.1, anti-aliased alike.

    Returns the linear picture, the ambient intensity (C,) and the lamps' power relative to the true one (C,).
    """
    surface, look = subject.surface, replace(subject.appearance, maps={})
    emitters, eye = lamps.emitters(surface, subject.factors.lamps), surface.local.points(subject.view.camera.centre)
    seen, pieces = picture.pixels, picture.fragments
    lit = phong(surface, emitters, seen.p, seen.side, look.E)
    use = np.flatnonzero(subject.counted[seen.y, seen.x])
    of_channel = lambda c, B: replace(subject, transfer=subject.transfer.of_channel(c)).show(B)  # with its own power
    ambient, power = ambient_and_power(
        look.rho[surface.group[seen.facet[use]]],
        lit[use],
        subject.wanted[seen.y[use], seen.x[use]],
        of_channel if subject.simple else lambda c, B: np.clip(B, 0, 1),
    )

    def shown(places, light):
        return radiosities(
            surface,
            look,
            [*zip(subject.lamp_groups, subject.factors.lobe_of_lamps, strict=True)],
            ambient + power * light,
            places.facet,
            places.side,
            places.p,
            places.p - eye,
        )

    there = phong(surface, emitters, pieces.p, pieces.side, look.E)
    return compose(subject.facet.shape, seen, shown(seen, lit), pieces, shown(pieces, there)), ambient, power
