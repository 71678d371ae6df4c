"""The inverse problem where some groups are mirrors, glossy or textured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lib.analysis.fit.problem import Doubt, Halves, Problem, SpecularTerms
from lib.analysis.materials.lobes import combined, lobes, shape_steps
from lib.analysis.materials.site import Site
from lib.analysis.materials.specular_ways import Traced
from lib.analysis.seen.receivers import Receivers, Ways
from lib.light import outside
from lib.light.chains import Finish
from lib.light.corrected import Corrected
from lib.light.specular import ChainRows

MISSING = 1 / 3  # of what a finer look at light changed may still be missing (docs/decisions/sub-cell-correction.md)


@dataclass(frozen=True, eq=False)
class Unknown:
    """What is to be found of M specular groups. rho : (G, C), rho_s : (M, C), NaN where free;  shapes : [(m, name)]
    variance : (G,) display, of what a group's tiles are known to differ by"""

    rho: np.ndarray
    rho_s: np.ndarray | None
    shapes: list
    variance: np.ndarray


def assemble(
    site: Site,
    finish: Finish | None,
    tiles: Receivers,
    traced: Traced | None,
    unknown: Unknown,
    *,
    rays=None,
    detail=None,
    final=False,
) -> Problem:
    """The inverse problem of the tiles that take part in the fit; finish None: nothing is specular.

    rays : in the lobe of each tile;  detail : of light within patches, see lobes.detail_of
    final : trace the lobes twice, and without light within patches: what that changes is their uncertainty; and their
        shapes' derivatives with twice the rays
    """
    some = np.flatnonzero(tiles.fit)
    t = tiles.take(some)
    terms = None
    if finish is not None:
        terms = _terms(site, finish, t, some, traced, unknown, rays, detail, final)
    seen = lambda half=None: Corrected(t.rows.matrix(half), site.subcell)
    base, apart = site.base, outside.halves(site.factors, t.direct, t.rows)
    return replace(
        base,
        rho=unknown.rho,
        G=seen(),
        G_plain=t.rows.matrix(),
        D_tile=t.direct,
        tile_group=t.group,
        tile_object=t.object,
        start=t.start,
        pixels=t.values,
        halves=Halves(seen(0), seen(1), base.halves.F0, base.halves.F1, apart) if base.halves else None,
        specular=terms,
        variance=unknown.variance[t.group][:, None],
        edge_noise=None,
        unsure=(),
        unsure_outside=None,
        doubted=None,
    )


def _terms(site, finish, tiles, some, traced: Traced, unknown, rays, detail, final) -> SpecularTerms:
    chains = traced.transport.chains
    rows, doubts, halves = lobes(site, finish, chains, tiles, rays=rays, detail=detail), [], ()
    if final and rows.F:
        again = lobes(site, finish, chains, tiles, seed=8, detail=detail)
        doubts.append(Doubt("lobes' rays", combined(rows.F, again.F, 0.5, -0.5), combined(rows.D, again.D, 0.5, -0.5)))
        if detail is not None:
            plain = lobes(site, finish, chains, tiles)
            doubts.append(Doubt("lobes' light", combined(rows.F, plain.F, MISSING, -MISSING), {}))
        halves = (rows.F, rows.D), (again.F, again.D)
        rows = ChainRows(combined(rows.F, again.F, 0.5, 0.5), combined(rows.D, again.D, 0.5, 0.5), rays=rows.rays)
    mine = Ways(*({k: A[some] for k, A in part.items()} for part in traced.tiles))
    bend = shape_steps(
        site,
        finish,
        chains,
        tiles,
        unknown.shapes,
        rays=2 * site.lobe_rays if final else rays,
        detail=detail,
    )
    return SpecularTerms(
        finish.groups,
        chains,
        traced.F,
        traced.transport.D,
        mine.G,
        mine.D,
        tiles.chain,
        rows.F,
        rows.D,
        unknown.rho_s,
        bend,
        doubts,
        halves,
        (mine.G_spread, mine.D_spread),
    )
