"""Ward's bounded lobe as a microfacet lobe, which most programs know instead.

With h = i + o, the half vector's density D of Beckmann with the same alphas, and G the light that microfacets keep from
each other:

    Ward, bounded    f = D / (4 (i.h)^2), h of unit length         (lib/light/ward.py)
    microfacet       f = D G / (4 cos_i cos_o)

In the mirror direction i.h = cos_i = cos_o, and the two differ by G alone. So the alphas are kept. At a glancing angle
Ward's lobe loses more light, nearly the same share at all: `weight` makes up for it, .98 at alpha .1, .89 at .3. GGX,
which has longer tails, has the same peak with the same alphas. How far either is off for one lobe says `residual`.
"""

from __future__ import annotations

import numpy as np

from lib.light import ward

VIEWS_DEG = (0, 15, 30, 45, 60, 75)  # from the normal, each counts alike


def value(distribution, ax, ay, wi, wo):
    """f per unit reflectance of directions (..., 3) in the facet's frame. No Fresnel factor; Smith's G, uncorrelated.

    distribution : `beckmann` or `ggx`
    """
    h = wi + wo
    h = h / np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
    cos = np.maximum(h[..., 2], 1e-6)
    slope2 = ((h[..., 0] / ax) ** 2 + (h[..., 1] / ay) ** 2) / cos**2
    if distribution == "beckmann":
        D = np.exp(-slope2) / (np.pi * ax * ay * cos**4)
    else:
        D = 1 / (np.pi * ax * ay * cos**4 * (1 + slope2) ** 2)
    G = _smith(distribution, ax, ay, wi) * _smith(distribution, ax, ay, wo)
    return D * G / np.maximum(4 * wi[..., 2] * wo[..., 2], 1e-9)


def _smith(distribution, ax, ay, v):
    """Share of the microfacets that v sees."""
    tan = np.sqrt((ax * v[..., 0]) ** 2 + (ay * v[..., 1]) ** 2) / np.maximum(v[..., 2], 1e-9)
    if distribution == "ggx":
        return 2 / (1 + np.sqrt(1 + tan**2))
    a = 1 / np.maximum(tan, 1e-9)
    return np.where(a < 1.6, (3.535 * a + 2.181 * a**2) / (1 + 2.276 * a + 2.577 * a**2), 1.0)


def weight(alpha) -> float:
    """By which Beckmann's lobe reflects as much as Ward's of the same alphas (2,), over VIEWS_DEG weighted by cos."""
    wards, microfacets = 0.0, 0.0
    for wi, wo, area in _pairs(alpha):
        light = area * wi[..., 2] * wo[2]
        wards += (light * ward.values(ward.BOUNDED, *alpha, wi, wo)).sum()
        microfacets += (light * value("beckmann", *alpha, wi, wo)).sum()
    return float(wards / microfacets)


def residual(distribution, alpha) -> float:
    """RMS difference of a microfacet lobe from Ward's of the same alphas (2,), as a share of that lobe's own RMS.

    Beckmann's is weighted, see `weight`. Of f cos_i, the light that an eye receives from an even sky piece by piece,
    over the half vectors that Ward's lobe has (three widths), from VIEWS_DEG off the normal, along the tangent and
    across it.
    """
    scale = weight(alpha) if distribution == "beckmann" else 1.0
    shares = []
    for wi, wo, area in _pairs(alpha):
        w = ward.values(ward.BOUNDED, *alpha, wi, wo) * wi[..., 2]
        m = scale * value(distribution, *alpha, wi, wo) * wi[..., 2]
        shares.append((area * (m - w) ** 2).sum() / (area * w * w).sum())
    return float(np.sqrt(np.mean(shares)))


def _pairs(alpha, n=64):
    """Yields (wi (n, n, 3), wo (3,), weight (n, n)): half vectors over three widths of the lobe, for each view."""
    ax, ay = alpha
    r = (np.arange(n) + 0.5) / n * 3
    psi = (np.arange(n) + 0.5) / n * 2 * np.pi
    r, psi = np.meshgrid(r, psi)
    h = np.stack([ax * r * np.cos(psi), ay * r * np.sin(psi), np.ones_like(r)], axis=-1)
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    for view in np.radians(VIEWS_DEG):
        for turn in (0, np.pi / 2):
            wo = np.array([np.sin(view) * np.cos(turn), np.sin(view) * np.sin(turn), np.cos(view)])
            cos = h @ wo
            wi = 2 * cos[..., None] * h - wo
            above = (wi[..., 2] > 1e-3) & (cos > 0)
            # solid angle of wi for one of (r, psi): 4 (o.h) dw_h, dw_h = ax ay r cos_h^3
            yield wi[above], wo, (4 * cos * r * h[..., 2] ** 3)[above]
