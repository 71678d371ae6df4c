"""The lamps' light wherever lamps and objects are put, without gathering anything anew.

It reaches patches and tiles by D and D_tile alone; how light goes on between the patches stays as it was.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lib.analysis.seen.gather import Gathered, Sampling
from lib.given.cameras import matrix_from_rt
from lib.given.view import View
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.factors_file import FormFactors
from lib.vision.registration.motions import corrected_model

POINTS, PIXELS = 8, 12  # of a patch, and of a tile, at which light is looked at twice
DRAWN = Sampling()


@dataclass(frozen=True, eq=False)
class DirectLight:
    """What the lamps of a scene send to its patches and tiles."""

    view: View
    factors: FormFactors
    found: Gathered
    _given: dict = field(default_factory=dict, repr=False)

    def moved(self, thing, twist):
        """The model with an object, by its number, turned and moved: (6,) Rodrigues vector and m, world."""
        return corrected_model(self.view.model, {thing: matrix_from_rt(twist)})

    def of(self, model, lamp=None):
        """D (N, L), D_tile (T, L) of a model with the same parts: as they were, and what it changes.

        lamp : the only one whose light is another, or None
        """
        (here, tiles_here), (there, tiles_there) = self._light(self.view.model, lamp), self._light(model, lamp)
        D = np.maximum(self.factors.lamp_factor + there - here, 0)
        return D, np.maximum(self.found.tiles.direct + tiles_there - tiles_here, 0)

    def _light(self, model, lamp):
        """The light of one lamp, or of all, at some points of each patch and at some pixels of each tile."""
        if model is self.view.model and lamp in self._given:
            return self._given[lamp]
        names = self.factors.lamps
        surface = self.surface if model is self.view.model else surfaces.surface(model, names, self.surface)
        emitters, tiles = lamps_.emitters(surface, names, self.factors.lobes), self.found.tiles
        emitters = [emitter for emitter in emitters if lamp in (None, names[emitter.lamp])]
        D = lamps_.patch_direct(surface, self.factors.mesh, emitters, len(names), n_points=POINTS)
        start, pixel = self._some_pixels
        p, side = surfaces.backproject(surface, self.view.camera, np.repeat(tiles.facet, np.diff(start)), pixel)
        D_tile = lamps_.direct(
            surface,
            emitters,
            p,
            surfaces.side_normals(surface),
            side,
            len(names),
            n_samples=DRAWN.lamp_samples,
            start=start,
        )
        if model is self.view.model:
            self._given[lamp] = D, D_tile
        return D, D_tile

    @cached_property
    def _some_pixels(self):
        """start (T + 1,), pixel: at most PIXELS of each tile, evenly."""
        start = self.found.tiles.start
        n = np.diff(start)
        step = np.maximum(-(-n // PIXELS), 1)
        place = np.arange(start[-1]) - np.repeat(start[:-1], n)
        some = np.flatnonzero(place % np.repeat(step, n) == 0)
        return np.concatenate([[0], np.cumsum(-(-n // step))]), self.found.tiles.pixel[some]

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
        return lamps_.emitters(self.surface, self.factors.lamps, self.factors.lobes)
