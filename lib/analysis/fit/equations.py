"""The inverse problem linearised: residuals of the tiles and their exact derivatives.

Derivatives of the patches' light:
    db/drho_h = (I - rho F)^-1 1_h (D E + F b),      db/dE_l = (I - rho F)^-1 rho D_l.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lib.analysis.fit.problem import Problem, State, display_residual
from lib.analysis.fit.start import unseen_prior
from lib.analysis.fit.transport import TileLight, product
from lib.given.transfer import Transfer
from lib.light.balance import reflected, times

# a curve's log slope may change so much from knot to knot, and so much beside what it did before: sRGB's changes by .37
# and .28, those of films and picture styles by 1 near white
STEP, BENT = 1.0, 0.5


class Unknowns(NamedTuple):
    """Values of everything that may be free.

    rho : (G, C);  E : (L, C);  rho_s : (M, C) or None;  bend : (n,) or None;  cause : (k,) or None
    near : Equations at such values, from whose light the balance is solved soonest, or None
    """

    rho: np.ndarray
    E: np.ndarray
    transfer: Transfer
    rho_s: np.ndarray | None = None
    bend: np.ndarray | None = None
    cause: np.ndarray | None = None
    near: Equations | None = None


@dataclass(frozen=True, eq=False)
class Layout:
    """Which parameters are free, in this order: reflectances, lamps, specular reflectances, shapes of lobes, transfer,
    cause.

    rho : (n_rho, 2) group, channel;  E : (n_E, 2) lamp, channel;  rho_s : (n_s, 2) specular group, channel
    bend : bounds (low, high) of each shape's step;  transfer, cause : how many numbers of them are free
    spread_E : (n_E,) of Problem
    """

    rho: np.ndarray
    E: np.ndarray
    rho_s: np.ndarray
    bend: tuple
    transfer: int
    cause: int = 0
    spread_E: object = None

    @classmethod
    def of(cls, problem: Problem) -> Layout:
        """What the problem leaves open; of groups only those that a tile or a patch has."""
        used = np.isin(np.arange(len(problem.groups)), np.concatenate([problem.tile_group, problem.patch_group]))
        rho = np.argwhere(np.isnan(problem.rho) & used[:, None])
        E = np.argwhere(np.isnan(problem.emittance))
        spread = np.full(len(E), np.inf) if problem.spread_E is None else problem.spread_E[tuple(E.T)]
        terms, n = problem.specular, problem.fit_transfer * len(problem.transfer.parameters)
        k = 0 if problem.cause is None else len(problem.cause.spread)
        if terms is None:
            return cls(rho, E, np.zeros((0, 2), int), (), n, k, spread)
        bend = tuple((shape.low, shape.high) for shape in terms.bend)
        return cls(rho, E, np.argwhere(np.isnan(terms.rho_s)), bend, n, k, spread)

    def lights_alike(self, other: Layout) -> bool:
        """The same parameters change the patches' light."""
        return all(np.array_equal(getattr(self, part), getattr(other, part)) for part in ("rho", "E", "rho_s"))

    @property
    def ends(self):
        """Where each kind of parameter ends: of rho, E, rho_s, bend."""
        return np.cumsum([len(self.rho), len(self.E), len(self.rho_s), len(self.bend)])

    @property
    def responding(self):
        """Where the transfer function's parameters are."""
        return slice(int(self.ends[-1]), int(self.ends[-1]) + self.transfer)

    @property
    def size(self):
        return self.responding.stop + self.cause

    @property
    def channel(self):
        """Of the parameters that change the patches' light, (n,)."""
        return np.concatenate([self.rho[:, 1], self.E[:, 1], self.rho_s[:, 1]]).astype(int)

    def pack(self, state: State):
        """(n,) parameters of a state."""
        parts = [state.rho[tuple(self.rho.T)], state.E[tuple(self.E.T)]]
        if len(self.rho_s) or self.bend:
            parts += [state.rho_s[tuple(self.rho_s.T)], state.bend]
        return np.concatenate(
            parts
            + [state.transfer.parameters[: self.transfer], np.zeros(self.cause) if state.cause is None else state.cause]
        )

    def unpack(self, theta, state: State) -> Unknowns:
        """The unknowns at parameters theta (n,); what is not free stays as in the state."""
        rho, E = state.rho.copy(), state.E.copy()
        rho_s, bend = None if state.rho_s is None else state.rho_s.copy(), state.bend
        n, m, k, j = self.ends
        rho[tuple(self.rho.T)] = theta[:n]
        E[tuple(self.E.T)] = theta[n:m]
        if k > m:
            rho_s[tuple(self.rho_s.T)] = theta[m:k]
        if j > k:
            bend = theta[k:j].copy()
        transfer = state.transfer.moved(theta[self.responding]) if self.transfer else state.transfer
        cause = theta[self.responding.stop :].copy() if self.cause else None
        return Unknowns(rho, E, transfer, rho_s, bend, cause)

    def bounds(self, transfer: Transfer):
        """(n,), (n,): between which the parameters stay."""
        n, m, s = len(self.rho), len(self.E), len(self.rho_s)
        low, high = (np.array([b[i] for b in self.bend], float).reshape(-1) for i in (0, 1))
        low_E = np.where(np.isfinite(self.spread_E), -np.inf, 0.0)
        return (
            np.concatenate(
                [
                    np.zeros(n),
                    low_E,
                    np.zeros(s),
                    low,
                    [transfer.bounds[0]] * self.transfer,
                    np.full(self.cause, -np.inf),
                ]
            ),
            np.concatenate(
                [
                    np.ones(n),
                    np.full(m, np.inf),
                    np.ones(s),
                    high,
                    [transfer.bounds[1]] * self.transfer,
                    np.full(self.cause, np.inf),
                ]
            ),
        )


class Equations:
    """The problem linearised at a state: residual and Jacobian in display values, per half of the rays, too.

    slope : (T, C) of the display values by the light that the camera has mixed
    """

    def __init__(self, problem: Problem, light: TileLight, layout: Layout, at: Unknowns, x0=None):
        self.problem, self.light, self.layout = problem, light.at(at.rho_s), layout
        b, self.irradiance = light.solve(at.rho, at.E, x0)
        B = light.shown(at.rho, at.E, b, () if at.bend is None else at.bend)
        self.state = State(at.rho, at.E, at.transfer, B, b, at.rho_s, at.bend, at.cause)
        self.residual, self.slope, self.by_transfer = display_residual(problem, B, at.transfer)
        self.residual = self.residual + self._caused()

    @classmethod
    def begun(cls, problem: Problem, light: TileLight, layout: Layout, start: Unknowns) -> Equations:
        """At `start`, solved from where the light near by stands."""
        near = start.near
        if near is None or near.state.b.shape != (len(problem.area), problem.channels):
            return cls(problem, light, layout, start)
        if layout.lights_alike(near.layout):
            light.derivative = near.light.derivative
        return cls(problem, light, layout, start, x0=near.state.b)

    def _caused(self):
        """What the cause adds to the residual, (T, C) or 0."""
        return 0 if self.state.cause is None else self.problem.cause.columns @ self.state.cause

    def moved(self, theta) -> Equations:
        """The same at other parameters (n,)."""
        at = self.layout.unpack(theta, self.state)
        return Equations(self.problem, self.light, self.layout, at, x0=self.state.b)

    def displayed(self, dB):
        """Change of the display values that a change of the tiles' light causes, (T, C) or (T, C, k) as that is."""
        return self._shown(self.slope, dB)

    def _shown(self, slope, dB):
        M = self.state.transfer.matrix
        mixed = np.einsum("cd,td...->tc...", M, dB) if M else dB
        return slope.reshape(*slope.shape, *[1] * (dB.ndim - 2)) * mixed

    @property
    def shown_share(self):
        """(T, C) what tiles show of their irradiance."""
        return self.light.at(self.state.rho_s).matrices.seen * self.state.rho[self.problem.tile_group]

    @cached_property
    def patch_derivative(self):
        """db/dtheta of the patches, (N, n) without the transfer and shapes, by one block solve."""
        solution = self._patch_derivative(self.layout, self.light.derivative)
        self.light.derivative = solution
        return solution

    def by_told_lamps(self):
        """(T, C, k) derivatives of the display residual by the emittances that are told, for all lamps' channels."""
        told = np.argwhere(self.problem.own_lamps[:, None] & ~np.isnan(self.problem.emittance))
        none = np.zeros((0, 2), int)
        layout = Layout(none, told, none, (), 0, 0, np.full(len(told), np.inf))
        self.light.at(self.state.rho_s)
        db = self._patch_derivative(layout)
        return self.displayed(_tile_derivative(self.problem, self.light, layout, self.state, db))

    def _patch_derivative(self, layout, x0=None):
        """db/dtheta (N, n) of the parameters of a layout."""
        state, matrices = self.state, self.light.matrices
        n, m = len(layout.rho), len(layout.rho) + len(layout.E)
        channel = layout.channel
        scale = state.rho[self.problem.patch_group].astype(np.float32)
        rhs = np.zeros((len(self.problem.area), len(channel)), np.float32)
        for k, (g, c) in enumerate(layout.rho):
            rhs[:, k] = np.where(self.problem.patch_group == g, self.irradiance[:, c], 0)
        for k, (lamp, c) in enumerate(layout.E):
            rhs[:, n + k] = scale[:, c] * matrices.of("D", c)[:, lamp]
        for k, (s, c) in enumerate(layout.rho_s):
            slope, _ = matrices.slopes(s, c)
            rhs[:, m + k] = scale[:, c] * (product(slope["D"], state.E[:, c]) + product(slope["F"], state.b[:, c]))
        # the exact residual decides where the iteration ends; its derivative only how fast
        return reflected(matrices.F, scale[:, channel], rhs, tolerance=3e-3, x0=x0, channel=channel).b

    @cached_property
    def jacobian(self):
        """(T C, n) of the residual, with all rays of the tiles."""
        return self._jacobian(self.light, self.slope, self.by_transfer)

    def _jacobian(self, light: TileLight, slope, by_transfer):
        """The same with the rays of a light, and its slopes of the display values."""
        self.light.at(self.state.rho_s)
        J = _tile_derivative(self.problem, light, self.layout, self.state, self.patch_derivative)
        J = self._shown(slope, J)
        if self.layout.transfer:
            J[:, :, self.layout.responding] = by_transfer
        if self.layout.cause:
            J[:, :, self.layout.responding.stop :] = self.problem.cause.columns
        return J.reshape(-1, self.layout.size)

    def half(self, k):
        """Residual (T C,) and Jacobian (T C, n) as half k of the rays of tiles and lobes see them."""
        s = self.state
        light = self.light.halves[k].at(s.rho_s)
        B = light.shown(s.rho, s.E, s.b, () if s.bend is None else s.bend)
        residual, slope, by_transfer = display_residual(self.problem, B, s.transfer)
        residual = residual + self._caused()
        return residual.reshape(-1), self._jacobian(light, slope, by_transfer)

    def prior(self):
        """Of the groups never seen, and of a curve's bends: gradient (n,) and Hessian (n, n)."""
        target, H = np.zeros(self.layout.size), np.zeros((self.layout.size,) * 2)
        mean, spread = unseen_prior(self.problem, self.state.rho)
        for k in np.flatnonzero(~np.isin(self.layout.rho[:, 0], self.problem.tile_group)):
            g, c = self.layout.rho[k]
            H[k, k] = 1 / spread[g, c] ** 2
            target[k] = mean[g, c]
        for k in np.flatnonzero(np.isfinite(self.layout.spread_E)):
            H[len(self.layout.rho) + k, len(self.layout.rho) + k] = 1 / self.layout.spread_E[k] ** 2
        if self.layout.transfer > 1:
            H[self.layout.responding, self.layout.responding] = smooth(self.layout.transfer)
        if self.layout.cause:
            k = np.arange(self.layout.responding.stop, self.layout.size)
            H[k, k] = 1 / self.problem.cause.spread**2
            target[k] = self.problem.cause.means
        return H @ (self.layout.pack(self.state) - target), H

    def cost(self, weight):
        """Weighted sum of squares, (T, C) weights, and the prior's share."""
        return self.cost_of(weight * self.residual**2)

    def cost_of(self, misfit):
        """Sum of what the tiles' residuals (T, C) cost, and the prior's share."""
        gradient, H = self.prior()
        return float(misfit.sum() + gradient @ np.linalg.lstsq(H, gradient, rcond=1e-12)[0])


def smooth(n):
    """Hessian (n, n) that keeps the bends of a curve's log slopes at n knots within BENT, its steps within STEP."""
    steps = np.diff(np.eye(n), axis=0)
    bends = np.diff(steps, axis=0)
    return bends.T @ bends / BENT**2 + steps.T @ steps / STEP**2


def _tile_derivative(problem: Problem, light: TileLight, layout: Layout, state: State, db):
    """dB/dtheta of the tiles, (T, C, n), zero for transfer and cause. db : (N, n) of the patches"""
    n_rho, n_E, n_s, n_bend = layout.ends
    matrices, channel, tile_group = light.matrices, layout.channel, problem.tile_group
    bent = _Bent(problem, light, state)
    reaching = times(matrices.G, db, channel)  # (T, n)
    glossed = bent.plus(times(matrices.W, db, channel), db, channel)
    rho_tile = matrices.seen * state.rho[tile_group]
    irradiance = light.tiles(state.E, state.b)
    J = np.zeros((len(tile_group), problem.channels, layout.size))
    for k, c in enumerate(channel):
        J[:, c, k] = rho_tile[:, c] * reaching[:, k] + (0 if matrices.W is None else glossed[:, k])
        if k < n_rho:
            mine = tile_group == layout.rho[k, 0]
            J[mine, c, k] += (irradiance * matrices.seen)[mine, c]
        elif k < n_E:
            lamp = layout.E[k - n_rho, 0]
            J[:, c, k] += rho_tile[:, c] * matrices.of("D_tile", c)[:, lamp]
            V = matrices.of("V", c)
            if not isinstance(V, int):
                J[:, c, k] += V[:, lamp]
            J[:, c, k] += bent.by_lamp(lamp, c)
        else:
            m = layout.rho_s[k - n_E, 0]
            slope, dseen = matrices.slopes(m, c)
            b, E = state.b[:, c], state.E[:, c]
            J[:, c, k] += (
                rho_tile[:, c] * (product(slope["D_tile"], E) + product(slope["G"], b))
                + product(slope["V"], E)
                + product(slope["W"], b)
                + dseen * state.rho[tile_group, c] * irradiance[:, c]
            )
            J[:, c, k] += bent.by_rho_s(m, c, b, E)
    for k in range(n_s, n_bend):
        shape = problem.specular.bend[k - n_s]
        J[:, :, k] = light.bent(shape.W, shape.V, state.E, state.b)
    return J


class _Bent:
    """What steps in the shapes of lobes, away from where they were traced, add to the derivatives of W and V."""

    def __init__(self, problem, light, state):
        shapes = problem.specular.bend if problem.specular else ()
        steps = () if state.bend is None else state.bend
        self.steps = [(step, shape) for step, shape in zip(steps, shapes, strict=False) if step]
        if self.steps:
            self.chains, self.rho_s = problem.specular.chains, light.matrices.rho_s
            self.power = self.chains.power(self.rho_s)

    def plus(self, glossed, db, channel):
        """glossed (T, n), what the lobes show of a change db (N, n) of the patches, with the steps' share."""
        for step, shape in self.steps:
            glossed = glossed + sum(step * self.power[k][channel] * (A @ db) for k, A in shape.W.items())
        return glossed

    def by_lamp(self, lamp, c):
        """Derivative by the lamp's emittance in channel c."""
        return sum(step * self.power[k, c] * A[:, lamp] for step, shape in self.steps for k, A in shape.V.items())

    def by_rho_s(self, m, c, b, E):
        """Derivative by rho_s[m, c]; b : (N,), E : (L,) of that channel."""
        if not self.steps:
            return 0
        slope = self.chains.slope(self.rho_s, m)[:, c]
        return sum(
            step * slope[k] * (A @ x)
            for step, shape in self.steps
            for parts, x in ((shape.W, b), (shape.V, E))
            for k, A in parts.items()
        )
