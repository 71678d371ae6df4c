"""What a mirror shows: the virtual index buffer (§4.5)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from lib.light.chains import MIRROR, Chains, Finish
from lib.light.paths import first_met, follow
from lib.light.surface import Surface


@dataclass(frozen=True)
class MirrorView:
    """What rays of the camera show after all mirrors.

    facet : (n,) int32, -1 nothing, or still in mirrors when the count ran out;  side : (n,) int32
    p : (n, 3) local, where there is nothing the last mirror's
    chain : (n,) int32;  direction : (n, 3) unit, of the last piece of the way
    """

    facet: np.ndarray
    side: np.ndarray
    p: np.ndarray
    chain: np.ndarray
    direction: np.ndarray

    def of(self, which) -> MirrorView:
        """The rays numbered `which`."""
        return MirrorView(*(getattr(self, f.name)[which] for f in fields(self)))


def through_mirrors(surface: Surface, finish: Finish, chains: Chains, rays, *, depth=64) -> MirrorView:
    """The first facet that is no mirror on the way of each ray (n, 6)."""
    numbers = np.flatnonzero(np.asarray(finish.kind) == MIRROR)  # of the mirrors among the specular groups
    plain = finish.only(numbers)
    own = Chains(len(plain))
    of, _ = plain.facets(surface)
    n = len(rays)
    triangle, t = surface.caster.closest(rays)
    out = MirrorView(
        np.full(n, -1, np.int32),
        np.zeros(n, np.int32),
        np.zeros((n, 3)),
        np.zeros(n, np.int32),
        np.array(rays[:, 3:], float),
    )

    def note(met):
        f = np.where(met.triangle >= 0, surface.facet[met.triangle], 0)
        ends = (met.triangle >= 0) & (of[f] < 0)
        i = met.source
        out.facet[i] = np.where(ends, f, -1)
        along = np.einsum("ij,ij->i", met.rays[:, 3:].astype(float), surface.normal[f])
        out.side[i] = 2 * f + (along > 0)
        t = np.where(met.triangle >= 0, met.t, 0).astype(float)
        out.p[i] = met.rays[:, :3] + t[:, None] * met.rays[:, 3:]
        out.chain[i] = met.chain
        out.direction[i] = met.rays[:, 3:]

    start = first_met(rays, triangle, t)
    note(start)
    for met in follow(surface, plain, own, start, depth=depth):
        note(met)
    # the chains of this view, in the numbers of all specular groups
    count = np.zeros((len(own), len(finish)), int)
    count[:, numbers] = own.counts
    table = np.array([chains.number(tuple(map(int, row))) for row in count], np.int32)
    return replace(out, chain=table[out.chain])
