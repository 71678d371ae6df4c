"""The lamps' light wherever lamps and objects are put, without gathering anything anew.

It reaches patches and tiles by D and D_tile alone; how light goes on between the patches stays as it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lib.analysis.gather import Gathered, Sampling
from lib.given.cameras import matrix_from_rt
from lib.given.view import View
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.factors_file import FormFactors
from lib.vision.registration.motions import corrected_model

POINTS = 32  # of a patch
DRAWN = Sampling()


@dataclass(frozen=True, eq=False)
class DirectLight:
    """What the lamps of a scene send to its patches and tiles."""

    view: View
    factors: FormFactors
    found: Gathered

    def moved(self, thing, twist):
        """The model with an object, by its number, turned and moved: (6,) Rodrigues vector and m, world."""
        return corrected_model(self.view.model, {thing: matrix_from_rt(twist)})

    def of(self, model, lamp=None):
        """D (N, L), D_tile (T, L) of a model with the same parts; drawn as stages/formfactors.py and gather.py do.

        lamp : the only one whose light is another, or None
        """
        surface, names = surfaces.surface(model, self.factors.lamps), self.factors.lamps
        emitters, tiles = lamps_.emitters(surface, names), self.found.tiles
        mine = np.array([lamp in (None, name) for name in names])
        emitters = [emitter for emitter in emitters if mine[emitter.lamp]]
        D = lamps_.patch_direct(surface, self.factors.mesh, emitters, len(names), n_points=POINTS)
        facet = np.repeat(tiles.facet, np.diff(tiles.start))
        p, side = surfaces.backproject(surface, self.view.camera, facet, tiles.pixel)
        how = {"n_samples": DRAWN.lamp_samples, "start": tiles.start, "seed": DRAWN.seed - 5}
        D_tile = lamps_.direct(surface, emitters, p, surfaces.side_normals(surface), side, len(names), **how)
        return np.where(mine, D, self.factors.lamp_factor), np.where(mine, D_tile, tiles.direct)

    def spread(self, thing, covariance):
        """[(dD, dD_tile)] of moves of an object by one standard deviation, which are independent of each other.

        covariance : (6, 6) of its turn and move, world
        """
        D, D_tile = self.of(self.view.model)
        value, vector = np.linalg.eigh(covariance)
        some = value > 1e-6 * value.max(initial=0.0)
        moves = [self.of(self.moved(thing, np.sqrt(value[k]) * vector[:, k])) for k in np.flatnonzero(some)]
        return [(there - D, tiles - D_tile) for there, tiles in moves]

    def own_spread(self, thing, covariance):
        """The same for the object's own tiles alone, each as bright as its middle, and without its shadows' moves."""
        tiles, lamp_names = self.found.tiles, self.factors.lamps
        mine = np.flatnonzero(self.found.object == thing)
        value, vector = np.linalg.eigh(covariance)
        some = np.flatnonzero(value > 1e-6 * value.max(initial=0.0))
        if not len(mine) or not len(some):
            return []
        surface = self.surface
        middle = tiles.pixel[(tiles.start[:-1] + np.diff(tiles.start) // 2)[mine]]
        p, side = surfaces.backproject(surface, self.view.camera, tiles.facet[mine], middle)
        normals, size = surfaces.side_normals(surface), self.factors.diagonal_m
        free = lambda q: lamps_.direct(
            surface, self.emitters, q, normals, side, len(lamp_names), n_samples=1, shadows=False
        )
        here, moves = free(p), []
        for k in some:
            there = free(p + np.sqrt(value[k]) * vector[3:, k] / size)
            dD_tile = np.zeros_like(tiles.direct)
            dD_tile[mine] = tiles.direct[mine] * np.divide(there - here, here, out=np.zeros_like(here), where=here > 0)
            moves.append((None, dD_tile))
        return moves

    @cached_property
    def surface(self):
        """Of the model as it is."""
        return surfaces.surface(self.view.model, self.factors.lamps)

    @cached_property
    def emitters(self):
        """Of the lamps as they are."""
        return lamps_.emitters(self.surface, self.factors.lamps)
