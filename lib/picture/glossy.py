"""The light in the lobes of glossy surfaces, by rays that look at the same light map as gathering rays do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.light import specular
from lib.light.chains import DIFFUSE, GLOSSY, Finish
from lib.light.form_factors import CHUNK
from lib.light.surface import Surface
from lib.picture import ray_light


def kinds(subject, facet):
    """DIFFUSE, MIRROR or GLOSSY of each facet number, of any shape; facets below 0 are diffuse.

    What lib/picture/curved.py shows is diffuse here: it has its lobes from there.
    """
    finish: Finish = subject.appearance.finish
    if finish is None:
        return np.full(np.shape(facet), DIFFUSE)
    of, _ = finish.facets(subject.surface)
    kind = np.where(facet >= 0, np.append(finish.kind, DIFFUSE)[of[np.maximum(facet, 0)]], DIFFUSE)
    return kind if subject.curved is None else np.where(subject.curved.has(facet), DIFFUSE, kind)


def add(subject, lit, view, n_rays, B):
    """Adds to B (n, C) what rays through mirrors, a MirrorView, see in lobes."""
    at = np.flatnonzero((view.facet >= 0) & (kinds(subject, view.facet) == GLOSSY))
    if len(at):
        B[at] += lobes(lit, view.p[at], view.facet[at], view.direction[at], view.chain[at], n_rays)


def lobes(lit, p, facet, direction, chain, n_rays, *, normal=None, seed=19):
    """(n, C) light in the lobes of places on glossy facets.

    p : (n, 3) local, on the facets (n,);  direction : (n, 3) unit, along which they are seen by way of chains (n,)
    normal : (n, 3) unit, of a smooth surface that the facets stand for, on which the places are; else the facets' own
    """
    total = np.zeros((len(p), lit.appearance.channels))
    step = max(1, CHUNK // n_rays)
    for a in range(0, len(p), step):
        b = min(len(p), a + step)
        m = b - a
        some = slice(a, b)
        surface, own = lit.surface, facet[some]
        if normal is not None:
            surface, own = _with_facets(surface, own, normal[some])
        begin = specular.from_views(
            surface, np.arange(m + 1) * n_rays, np.arange(m + 1), p[some], own, direction[some], chain[some]
        )
        start, _ = begin(0, m)
        element = np.repeat(np.arange(m), n_rays)
        total[a:b] = ray_light.beyond(surface, lit.shown, start, element, m, seed=seed) / n_rays
    return total


def _with_facets(surface: Surface, facet, normal) -> tuple:
    """The surface with a facet more for each place, which no ray meets, and their numbers (n,).

    Each is as `facet` (n,), but for its normal (n, 3): a ray of the view begins there.
    """
    F, n = len(surface.normal), len(facet)
    own = (F + np.arange(n)).astype(surface.facet.dtype)
    more = lambda values, rows: np.concatenate([values, rows.astype(values.dtype)])
    made = replace(
        surface,
        facet=more(surface.facet, own),
        corners=more(surface.corners, np.repeat(surface.corners[:1], n, axis=0)),
        normal=more(surface.normal, normal),
        group=more(surface.group, surface.group[facet]),
        object=more(surface.object, surface.object[facet]),
        origin=more(surface.origin, surface.origin[facet]),
        axes=more(surface.axes, surface.axes[facet]),
        size=more(surface.size, surface.size[facet]),
        inside=more(surface.inside, np.zeros(2 * n, bool)),
        overlap=more(surface.overlap, surface.overlap[facet]),
    )
    return made, own
