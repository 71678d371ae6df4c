"""The light in the lobes that tiles show, and how the shapes of lobes change it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.fit.problem import ShapeStep
from lib.analysis.materials.site import Site
from lib.analysis.seen.receivers import Receivers
from lib.light import specular
from lib.light.chains import Chains, Finish
from lib.light.specular import ChainRows, Transport
from lib.picture import ray_light
from lib.picture.appearance import Appearance
from lib.picture.lighting import lighting

LOWEST, HIGHEST = 0.004, 1.0  # alphas that are looked for
SHAPES = {  # of ln alpha_x, ln alpha_y and the angle of the tangent
    "alpha": (1, 1, 0),
    "alpha_x": (1, 0, 0),
    "alpha_y": (0, 1, 0),
    "turn": (0, 0, 1),
}
# Half the difference over which a shape's derivative is taken. The noise of few rays falls as fast as this grows: on 30
# tiles of 256 rays, steps of 0.03 turned a slope of 0.0014 into 0.0084 and overstated the information on alpha
# 36-fold.
STEP = {"alpha": 0.2, "alpha_x": 0.2, "alpha_y": 0.2, "turn": 0.1}


def lobes(site: Site, finish: Finish, chains: Chains, tiles: Receivers, *, rays=None, seed=7, detail=None) -> ChainRows:
    """Rows of the tiles that show a lobe, over all T tiles.

    rays : of each tile, by default the site's;  detail : of light within patches, see specular.rows
    """
    which = np.flatnonzero(tiles.lobe >= 0)
    if not len(which):
        return ChainRows()
    some = tiles.take(which)
    ray_start = np.concatenate([[0], np.cumsum(np.full(len(some), rays or site.lobe_rays))]).astype(np.int64)
    begin = specular.from_views(
        site.surface,
        ray_start,
        some.start,
        some.p,
        np.repeat(some.facet, some.n_pixels),
        some.direction,
        np.repeat(some.chain, some.n_pixels),
    )
    rows = specular.rows(
        site.surface,
        site.mesh,
        finish,
        chains,
        site.lamps,
        site.n_lamps,
        ray_start,
        begin,
        outside=site.outside,
        seed=seed,
        detail=detail,
    )
    site.effort.note("rays in lobes", rows.rays)
    from scipy.sparse import csr_array

    spread = csr_array(
        (np.ones(len(which), np.float32), (which, np.arange(len(which)))), shape=(len(tiles), len(which))
    )
    return ChainRows(
        {k: (spread @ F).tocsr() for k, F in rows.F.items()},
        {k: spread @ D for k, D in rows.D.items()},
        rays=rows.rays,
        lost=rows.lost,
    )


def bent(finish: Finish, m, name, step, normal) -> Finish:
    """The finish with one shape of group m changed by `step` (of ln alpha, or rad about the normal)."""
    x, y, turn = SHAPES[name]
    alpha, tangent = np.array(finish.alpha, float), np.array(finish.tangent, float)
    alpha[m] = np.clip(alpha[m] * np.exp(np.array([x, y]) * step), LOWEST / 4, 2 * HIGHEST)
    if turn:
        t = tangent[m] - (tangent[m] @ normal) * normal
        t /= np.linalg.norm(t)
        tangent[m] = np.cos(step) * t + np.sin(step) * np.cross(normal, t)
    return replace(finish, alpha=alpha, tangent=tangent)


def shape_steps(site: Site, finish: Finish, chains: Chains, tiles: Receivers, shapes, *, rays=None, detail=None):
    """Derivatives of the lobes with respect to shapes [(m, name)]: a list of ShapeStep.

    Central differences over the same random numbers; not those of the lobes themselves, or their noise would be taken
    for a shape's.
    """
    result = []
    for m, name in shapes:
        some = np.flatnonzero(tiles.lobe == m)
        if not len(some):
            continue
        normal = site.main_normal(finish.groups[m])
        mine, step = replace(tiles, lobe=np.where(tiles.lobe == m, m, -1)), STEP[name]
        there, back = (
            lobes(site, bent(finish, m, name, sign * step, normal), chains, mine, rays=rays, seed=9, detail=detail)
            for sign in (1, -1)
        )
        half = 0.5 / step
        result.append(
            ShapeStep(m, name, combined(there.F, back.F, half, -half), combined(there.D, back.D, half, -half))
        )
    return result


def combined(a, b, x, y):
    """x a + y b of two dictionaries of matrices."""
    return {k: x * a[k] + y * b[k] if k in a and k in b else x * a[k] if k in a else y * b[k] for k in {*a, *b}}


def detail_of(site: Site, finish: Finish, state, transport: Transport | None):
    """What the light at the ends of rays is of that of their patches, as the light map shows it: for `lobes`.

    transport : the ways of light at this finish, where they are traced already
    """
    look = Appearance(state.rho, state.E, finish, state.rho_s)
    lit = lighting(site.surface, site.factors, look, transport=transport)
    mean = np.asarray(lit.light.reflected).mean(axis=1)

    def detail(rays, triangle, t, patch):
        there = ray_light.reflected_at(site.surface, lit.shown, rays, triangle, t).mean(axis=1)
        return np.clip(np.divide(there, mean[patch], out=np.ones(len(patch)), where=mean[patch] > 1e-9), 0, 10)

    return detail
