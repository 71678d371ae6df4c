"""The tiles rendered again: the light balance at given reflectances, and what takes its light to the tiles."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from lib.analysis.fit.problem import Problem, State
from lib.light.balance import reflected, stored, times

PARTS = ("F", "D", "G", "D_tile", "W", "V")
SPARSE = ("F", "G", "W")  # of patches: most of the light comes past no mirror, alike in all channels


class Matrices:
    """The matrices of light at given rho_s: each a list of one, or of one for each channel where rho_s is coloured.

    F, D : to the patches;  G, D_tile : to the tiles;  W, V : by lobes to the tiles; from patches and lamps. Made when
        asked for.
    """

    def __init__(self, problem: Problem, rho_s=None, F=None, G=None):
        """F, G : in place of the problem's own"""
        self.terms, self.rho_s = problem.specular, rho_s
        self.base = {
            "F": problem.F if F is None else F,
            "G": problem.G if G is None else G,
            "D": problem.D,
            "D_tile": problem.D_tile,
            "W": None,
            "V": None,
        }
        if self.terms is not None:
            power = self.terms.chains.power(rho_s)
            self.power = power[:, :1] if (power == power[:, :1]).all() else power

    def _mixed(self, name):
        base = self.base[name]
        if self.terms is None:
            return None if base is None else [base]
        parts = getattr(self.terms, name)
        if base is None and not parts:
            return None
        if name in SPARSE and self.power.shape[1] > 1:
            return ByChain(base, parts, self.power)
        mixture = self.terms.mixture(name, base)
        return [mixture.at(self.power[:, c]) for c in range(self.power.shape[1])]

    @cached_property
    def F(self):
        mixed = self._mixed("F")
        return mixed if isinstance(mixed, ByChain) else [stored(A) for A in mixed]

    def __getattr__(self, name):
        """G, D, D_tile, W, V, when first asked for."""
        if name not in PARTS:
            raise AttributeError(name)
        self.__dict__[name] = self._mixed(name)
        return self.__dict__[name]

    def of(self, name, c):
        """The matrix of channel c, or 0."""
        matrices = getattr(self, name)
        return 0 if matrices is None else matrices[c if len(matrices) > 1 else 0]

    @cached_property
    def seen(self):
        """(T, 1) or (T, C): the share of its light that a tile shows by way of mirrors."""
        return np.ones((1, 1)) if self.terms is None else self.power[self.terms.tile_chain]

    def slopes(self, m, c):
        """Derivatives with respect to rho_s[m, c]: {part: a matrix or 0}, and that of `seen`, (T,)."""
        slope = self.terms.chains.slope(self.rho_s, m)[:, c]
        return {name: self.terms.mixture(name, None).at(slope) for name in PARTS}, slope[self.terms.tile_chain]


class ByChain:
    """base + sum_k power_k parts_k, another sum in each channel, as what multiplies light: the base once for all.

    base : as it multiplies, or None;  parts : {k: CSR};  power : (K, C)
    """

    def __init__(self, base, parts, power):
        self.base, self.parts, self.power = base, parts, power

    def times(self, X, channel):
        """As of lib.light.balance.times."""
        total = 0 if self.base is None else times([self.base], X)
        for k, A in self.parts.items():
            power = self.power[k][channel].astype(X.dtype)
            if power.any():
                total = total + times([A], X * power)
        return total


class TileLight:
    """Solves the balance and renders the tiles at given rho_s of the specular groups."""

    def __init__(self, problem: Problem, F=None, G=None, rho_s=None):
        """F, G : in place of the problem's own"""
        self.problem, self.given = problem, (F, G)
        self.derivative = None  # of the last linearisation: where the next block solve starts
        self.residual = None
        self.matrices = None
        if problem.specular is None:
            self.at(None)
        elif rho_s is not None:
            self.at(rho_s)

    def at(self, rho_s) -> TileLight:
        """Itself, with the matrices at these rho_s, which are made anew only where they have changed."""
        if self.matrices is None or (rho_s is not None and not np.array_equal(self.matrices.rho_s, rho_s)):
            self.matrices = Matrices(self.problem, None if rho_s is None else rho_s.copy(), *self.given)
        return self

    def solve(self, rho, E, x0=None, tolerance=1e-5):
        """Reflected radiosity b of the patches, (N, C), and their irradiance D E + F b, (N, C)."""
        direct = times(self.matrices.D, E)
        scale = rho[self.problem.patch_group].astype(np.float32)
        solution = reflected(self.matrices.F, scale, scale * direct, tolerance=tolerance, x0=x0)
        self.residual = solution.residual
        return solution.b, direct + times(self.matrices.F, solution.b)

    def tiles(self, E, b):
        """Irradiance of the tiles, (T, C)."""
        return times(self.matrices.D_tile, E) + times(self.matrices.G, b)

    @cached_property
    def halves(self):
        """Two of the same with disjoint halves of the rays of tiles and lobes; only to look at the tiles with."""
        found = []
        apart = self.problem.halves
        for k, G in enumerate((apart.G0, apart.G1)):
            terms = self.problem.specular
            if terms is not None and terms.halves:
                W, V = terms.halves[k]
                terms = replace(terms, W=W, V=V, _mixtures={})
            D_tile = self.problem.D_tile + (apart.D_tile[k] if apart.D_tile else 0)
            found.append(TileLight(replace(self.problem, G=G, D_tile=D_tile, specular=terms)))
        return found

    def lobes(self, E, b, bend=()):
        """What lobes add to the tiles, (T, C) or 0. bend : (n,) steps in their shapes"""
        if self.matrices.W is None and self.matrices.V is None:
            return 0
        total = times(self.matrices.V, E) + times(self.matrices.W, b)
        for step, shape in zip(bend, self.problem.specular.bend, strict=False):
            if step:
                total = total + step * self.bent(shape.W, shape.V, E, b)
        return total

    def bent(self, W, V, E, b):
        """What such changes of the lobes or of the ways change in the tiles' light, (T, C).

        W, V : by chain, (T, N) and (T, L)
        """
        changed = self.problem.specular.chains.total(self.matrices.rho_s, W, V, b, E)
        return changed + np.zeros((len(self.problem.tile_group), self.problem.channels))

    def shown(self, rho, E, b, bend=()):
        """Radiosity of the tiles, (T, C)."""
        return self.matrices.seen * rho[self.problem.tile_group] * self.tiles(E, b) + self.lobes(E, b, bend)

    def render(self, rho, E, transfer, x0=None) -> State:
        """The tiles at these reflectances and lamps."""
        b, _ = self.solve(rho, E, x0)
        return State(rho, E, transfer, self.shown(rho, E, b), b)


def product(A, x):
    """A x, where A may be 0 for a matrix of nothing."""
    return 0 if isinstance(A, int) else A @ x
