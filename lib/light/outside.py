"""What lies around an open model: black, or a glow where a wall or a window was left out.

The glow comes in wherever rays leave the model. It is even, or changes along three axes as a polynomial of the second
degree: one lamp, and nine more whose emittances may be negative. Their factors at a place are sums over the place's
rays that leave. Where no glow was found they stand among the lamps at an emittance of 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lib.light.factors_file import OUTSIDE, FormFactors
from lib.light.form_factors import FormFactorRows, chunks, from_patches, from_points
from lib.light.surface import Surface

MARGIN = 1e-3  # local, around the model
LEAST = 0.03  # share of some patch's light that leaves an open model: more than rays that pass between two facets
RAYS = 256  # of each patch, that tell where they leave


@dataclass(frozen=True, eq=False)
class Outside:
    """A box around the model, through which rays leave.

    first : number of its first lamp;  low, high : (3,) local;  middle : (3,) where most light leaves, from -1 to 1
    """

    first: int
    low: np.ndarray
    high: np.ndarray
    middle: np.ndarray

    def at(self, rays):
        """(n, 3) where rays (n, 6) leave the box, from -1 to 1 along its sides."""
        p, along = rays[:, :3].astype(float), rays[:, 3:].astype(float)
        along = np.where(np.abs(along) < 1e-9, 1e-9, along)
        t = (np.where(along > 0, self.high, self.low) - p) / along
        q = p + along * t.min(axis=1, keepdims=True)
        return (q - (self.low + self.high) / 2) / ((self.high - self.low) / 2)

    def seen(self, rays):
        """(n, 10) of each of its lamps, what rays (n, 6) that leave find at an emittance of 1."""
        return np.column_stack([np.ones(len(rays)), self.uneven(self.at(rays))])

    def uneven(self, q):
        """(n, 9) of its lamps but the even one, where rays leave it at q (n, 3)."""
        x, y, z = (q - self.middle).T
        return np.column_stack([x, y, z, x * x, y * y, z * z, x * y, y * z, z * x])

    def beyond(self, q):
        """(n, 9) how far from the middle rays leave at q (n, 3), by products of three axes: what its lamps do not
        know."""
        q = (q - self.middle).T
        return np.column_stack([a * a * b for a in q for b in q])


@dataclass(frozen=True, eq=False)
class Leaving:
    """The rays of R places that leave an open model.

    place : (n,) of each;  q : (n, 3) where, of Outside.at;  share : (n,) of its place's rays;  n_places : R
    """

    place: np.ndarray
    q: np.ndarray
    share: np.ndarray
    n_places: int

    @classmethod
    def of(cls, surface: Surface, box: Outside, ray_start, make) -> Leaving:
        """ray_start, make : of form_factors.from_patches, from_points"""
        place, q, n_rays = [np.zeros(0, int)], [np.zeros((0, 3))], np.diff(ray_start)
        for first, last in chunks(ray_start):
            rays = make(first, last)
            gone = np.flatnonzero(surface.caster.closest(rays)[0] < 0)
            place.append(np.repeat(np.arange(first, last), n_rays[first:last])[gone])
            q.append(box.at(rays[gone]))
        place = np.concatenate(place)
        return cls(place, np.concatenate(q), 1 / n_rays[place], len(n_rays))

    def sums(self, values):
        """(R, k) over the rays of each place, of values (n, k)."""
        return np.stack([np.bincount(self.place, v * self.share, self.n_places) for v in values.T], axis=1)


def openings(rows: FormFactorRows, half=None) -> np.ndarray:
    """(M,) share of the light of each place that leaves the model; 0 inside solids. half : of FormFactorRows.matrix"""
    met = np.asarray(rows.matrix(half).sum(axis=1)).ravel()
    share = 1 - met - rows.lost / np.maximum(rows.valid, 1)
    return np.where(rows.valid > 0, np.clip(share, 0, 1), 0.0)


def halves(factors: FormFactors, direct, rows: FormFactorRows) -> tuple:
    """By how much factors to the lamps (T, L) are others by the first and the last half of the rays; () where none are.

    direct : (T, L) by all;  rows : of the tiles
    """
    if factors.outside is None:
        return ()
    found = np.zeros_like(direct), np.zeros_like(direct)
    for half in (0, 1):
        found[half][:, factors.outside.first] = openings(rows, half) - openings(rows)
    return found


def openings_to_light(factors: FormFactors) -> np.ndarray:
    """(N,) the same of the patches, 0 where no light of the lamps comes.

    Outside a closed room there may be patches, too: the backs of walls that see another room.
    """
    from scipy.sparse.csgraph import connected_components

    part = connected_components(factors.rows.matrix(), directed=False)[1]
    lit = np.isin(part, part[factors.lamp_factor.any(axis=1)])
    return np.where(lit, openings(factors.rows), 0.0)


def is_open(share) -> bool:
    """Enough light leaves some patch. share : (N,) of `openings_to_light`"""
    return bool(share.max(initial=0.0) >= LEAST)


def with_outside(factors: FormFactors, surface) -> FormFactors:
    """The factors with the outside as the last of the lamps, where the model is open. surface : () -> Surface"""
    share = openings_to_light(factors)
    if not is_open(share):
        return factors
    surface = surface()
    corners = surface.corners.reshape(-1, 3)
    box = Outside(len(factors.lamps), corners.min(axis=0) - MARGIN, corners.max(axis=0) + MARGIN, np.zeros(3))
    ways = from_patches(surface, factors.mesh, RAYS, seed=3)
    lit, area = share > 0, factors.area
    leaving = Leaving.of(surface, box, *ways)
    where = leaving.sums(leaving.q)
    box = replace(box, middle=(area * lit) @ where / max(float((area * share).sum()), 1e-300))
    D = np.column_stack([openings(factors.rows), leaving.sums(box.uneven(leaving.q))])
    D = np.where(lit[:, None], D, 0.0)
    return replace(
        factors, lamps=(*factors.lamps, *OUTSIDE), lamp_factor=np.hstack([factors.lamp_factor, D]), outside=box
    )


def of_points(factors: FormFactors, surface: Surface, points, start, side, rows: FormFactorRows):
    """(T, 10) factors to the outside of sets of points, or (T, 0) where it is not among the lamps.

    points : (M, 3) local;  start : (T + 1,) of each set;  side : (T,);  rows : of the sets
    """
    if factors.outside is None:
        return np.zeros((len(side), 0))
    around, ways = factors.outside, from_points(surface, points, start, side, 2 * rows.shot, seed=15)
    leaving = Leaving.of(surface, around, *ways)
    return np.column_stack([openings(rows), leaving.sums(around.uneven(leaving.q))])


def without_outside(E, lamps):
    """Emittances (L, C) of the lamps alone."""
    return np.where(np.array([name in OUTSIDE for name in lamps])[:, None], 0.0, E)


@dataclass(frozen=True, eq=False)
class Glow:
    """What rays find that leave an open model. E : (10, C) emittances of the outside's lamps"""

    outside: Outside
    E: np.ndarray

    @classmethod
    def of(cls, factors: FormFactors, E) -> Glow | None:
        """E : (L, C) of all lamps; None where nothing comes in."""
        around = factors.outside
        own = None if around is None else E[around.first : around.first + len(OUTSIDE)]
        return None if own is None or not own.any() else cls(around, own)

    def light(self, rays):
        """(n, C) radiosities that rays (n, 6) find."""
        return np.maximum(self.outside.seen(rays) @ self.E, 0)
