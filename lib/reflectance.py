"""Reflectances, lamps and gamma from one photograph (sections 4.4 and 4.5).

The scene's light is linear in the lamps and, at given reflectances, one small linear solve:

    b = rho (D E + F b)        reflected radiosity of the patches (eq. 3.2; D: lamp factors)
    B_t = rho_g (D_t E + G_t b)     radiosity of tile t of the photograph, which lies on group g

so a re-rendering of all tiles after a change of reflectance costs milliseconds, and derivatives are exact:
    db/drho_h = (I - rho F)^-1 1_h (D E + F b),      db/dE_l = (I - rho F)^-1 rho D_l.

`gauss_newton` adjusts all reflectances, unknown lamps and gamma together (they share a valley: DESIGN 7, trap 1).
`paper` is the printed alternation (eq. 4.3, 4.4-4.6, then 4.1-4.2); `damped` is the same with the common factor
damped, which also converges in bright rooms (DESIGN 3).
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from lib import radiosity
from lib.transfer import Metric, Tiles, Transfer

MISFIT = 4.0            # residuals so many times what noise explains: something told to the fit is wrong
DENSE_LIMIT = 6000      # patches up to which F is kept dense: BLAS is then faster than sparse products


@dataclass
class Problem:
    """What the photograph says and what geometry knows. C channels, N patches, T tiles, G groups, L lamps."""
    F: object                    # (N, N) array or CSR
    D: np.ndarray                # (N, L)
    patch_group: np.ndarray      # (N,) int
    area: np.ndarray             # (N,)
    G: object                    # (T, N) CSR, with the sub-cell correction of the sources, as F
    G_plain: object              # (T, N) CSR, without
    D_tile: np.ndarray           # (T, L)
    tile_group: np.ndarray       # (T,) int
    tile_object: np.ndarray      # (T,) int
    start: np.ndarray            # (T + 1,) into pixels
    pixels: np.ndarray           # (M, C) display
    groups: tuple
    lamps: tuple
    emittance: np.ndarray        # (L, C); NaN where unknown
    rho: np.ndarray              # (G, C); NaN where unknown, 0 for lamps, the given value for references
    metric: Metric
    fit_gamma: bool
    halves: tuple = ()           # (G0, G1, F0, F1): the same from disjoint rays
    group_area: np.ndarray = None
    specular: "Specular" = None  # light by way of mirrors and glossy surfaces; None where every group is diffuse
    variance: np.ndarray = None  # (T, 1) display, of what is known not to be explained (a texture); None: nothing

    def __post_init__(self):
        self.photograph = Tiles(self.pixels, self.start)
        self.pixel_noise = _pixel_noise(self)

    @property
    def channels(self):
        return self.pixels.shape[1]

    @property
    def n_pixels(self):
        return np.diff(self.start)


@dataclass
class Specular:
    """What lib.specular traced for M specular groups: light is a polynomial in their rho_s, chain by chain (K of them).

    A tile shows its group as seen by way of `tile_chain` (0: at once, else through mirrors), and a glossy one its lobe besides:
        B_t = power_t rho_g (D_t E + G_t b) + sum_k power_k (V_k E + W_k b)_t,      power_k = prod_m rho_s[m] ** k_m
    and likewise F, D, G, D_t are sums over the chains of the light's ways. `bend` holds the derivatives of (W, V) with respect to
    alpha_x, alpha_y and the angle of the tangent: shapes are adjusted linearly here, and traced again outside.
    """
    groups: tuple                # (M,) numbers of the groups
    chains: object               # lib.specular.Chains
    F: dict                      # chain -> (N, N) CSR
    D: dict                      # chain -> (N, L)
    G: dict                      # chain -> (T, N) CSR
    D_tile: dict                 # chain -> (T, L)
    tile_chain: np.ndarray       # (T,) int
    W: dict                      # chain -> (T, N) CSR
    V: dict                      # chain -> (T, L)
    rho_s: np.ndarray            # (M, C); NaN where unknown
    bend: list = field(default_factory=list)      # of (m, name, W, V, low, high): bounds of the step in that shape
    doubts: list = field(default_factory=list)    # of (cause, W, V): changes of the lobes as large as one standard deviation
    halves: tuple = ()           # ((W, V), (W, V)) from disjoint rays
    spread: tuple = ()           # (G, D_tile) by chain, as large as the sampling error of these
    _mixtures: dict = field(default_factory=dict, repr=False)

    def mixture(self, name, base):
        """The sum over the chains of the part `name` and of base, ready for any rho_s."""
        key = name, id(base)
        if key not in self._mixtures:
            self._mixtures[key] = _Mixture(base, getattr(self, name)), base      # base is kept, so that its id stays its own
        return self._mixtures[key][0]


@dataclass(frozen=True)
class State:
    rho: np.ndarray              # (G, C)
    E: np.ndarray                # (L, C)
    gamma: float
    B: np.ndarray                # (T, C) tile radiosities
    b: np.ndarray                # (N, C) reflected radiosity of the patches
    rho_s: np.ndarray = None     # (M, C) of the specular groups
    bend: np.ndarray = None      # (n,) steps in the shapes of the lobes


@dataclass
class Result:
    state: State
    converged: bool
    iterations: int
    rmse: float
    sigma_rho: np.ndarray = None
    sigma_E: np.ndarray = None
    sigma_gamma: float = None
    sigma_rho_s: np.ndarray = None
    sigma_bend: np.ndarray = None
    tile_residual: np.ndarray = None     # (T, C) display, synthesis minus photograph
    residual: float = None               # of the light balance
    misfit: float = 0.0                  # typical tile residual over what pixel noise and sampling explain
    shares: dict = field(default_factory=dict)   # median relative sigma by cause
    warnings: list = field(default_factory=list)


class Ways:
    """The matrices of light at given rho_s: lists of one, or of one for each channel where rho_s is coloured. Made when asked for."""

    def __init__(self, problem, rho_s=None, F=None, G=None):
        self.p, self.spec, self.rho_s = problem, problem.specular, rho_s
        self.base = {"F": problem.F if F is None else F, "G": problem.G if G is None else G, "D": problem.D, "D_tile": problem.D_tile, "W": None, "V": None}
        if self.spec is not None:
            power = self.spec.chains.power(rho_s)
            self.power = power[:, :1] if (power == power[:, :1]).all() else power

    def _mixed(self, name):
        if self.spec is None:
            return None if self.base[name] is None else [self.base[name]]
        if self.base[name] is None and not getattr(self.spec, name):
            return None
        return [self.spec.mixture(name, self.base[name]).at(self.power[:, c]) for c in range(self.power.shape[1])]

    @cached_property
    def F(self):
        # in single precision, which the sampling error of F dwarfs
        return [A.toarray() if hasattr(A, "toarray") and A.shape[0] <= DENSE_LIMIT else A for A in self._mixed("F")]

    def __getattr__(self, name):
        """G, D, D_tile, W, V, when first asked for."""
        if name not in ("G", "D", "D_tile", "W", "V"):
            raise AttributeError(name)
        self.__dict__[name] = self._mixed(name)
        return self.__dict__[name]

    @cached_property
    def seen(self):
        return np.ones((1, 1)) if self.spec is None else self.power[self.spec.tile_chain]

    def slopes(self, m, c):
        """Derivatives with respect to rho_s[m, c]: of F, D, G, D_tile, W, V, each a matrix or 0, and of `seen`, (T,)."""
        spec = self.spec
        slope = spec.chains.slope(self.rho_s, m)[:, c]
        return [spec.mixture(name, None).at(slope) for name in ("F", "D", "G", "D_tile", "W", "V")] + [slope[spec.tile_chain]]


class _Mixture:
    """base + sum_k power_k parts_k for many powers: where the entries of sparse parts go is found once.

    base None: nothing; 0 where there is nothing at all"""

    def __init__(self, base, parts):
        self.base, self.parts = base, parts
        self.sparse = any(hasattr(A, "tocsr") for A in parts.values())
        if not self.sparse:
            return
        every = list(parts.values())
        self.shape, self.kind = every[0].shape, type(every[0])
        columns = np.int64(self.shape[1])
        keys_of = lambda A: np.repeat(np.arange(A.shape[0], dtype=np.int64), np.diff(A.indptr)) * columns + A.indices
        keys = np.sort(np.concatenate([keys_of(A) for A in every]))
        keys = keys[np.flatnonzero(np.diff(keys, prepend=-1))]
        self.indices = (keys % columns).astype(np.int32)
        self.indptr = np.concatenate([[0], np.cumsum(np.bincount(keys // columns, minlength=self.shape[0]))])
        self.places = {k: np.searchsorted(keys, keys_of(A)) for k, A in parts.items()}

    def at(self, power):
        if not self.sparse:
            total = self.base
            for k, part in self.parts.items():
                total = part * power[k] if total is None else total + part * power[k]
            return 0 if total is None else total
        data = np.zeros(len(self.indices), np.float32)
        for k, part in self.parts.items():
            if power[k] != 0:
                data[self.places[k]] += np.float32(power[k]) * part.data       # no entry of a part stands there twice
        total = self.kind((data, self.indices, self.indptr), shape=self.shape)
        return total if self.base is None else (self.base + total).tocsr()


def _times(matrices, X, channel=None):
    """Each column of X (n, K) times the matrix of its channel (K,); of nothing 0."""
    if matrices is None:
        return 0
    if len(matrices) == 1:
        return matrices[0] @ X if not isinstance(matrices[0], int) else 0
    channel = np.arange(X.shape[1]) if channel is None else channel
    parts = [(channel == c, A) for c, A in enumerate(matrices)]
    size = next((A.shape[0] for A in matrices if not isinstance(A, int)), 0)
    out = np.zeros((size, X.shape[1]), np.result_type(X, np.float32))
    for mine, A in parts:
        if mine.any() and not isinstance(A, int):
            out[:, mine] = A @ X[:, mine]
    return out


class Light:
    """Solves the balance and renders the tiles at given rho_s of the specular groups."""

    def __init__(self, problem: Problem, F=None, G=None, rho_s=None):
        self.p, self.given = problem, (F, G)
        self.derivative = None       # of the last linearisation: where the next block solve starts
        self.residual = None
        self.ways = None
        if problem.specular is None:
            self.at(None)
        elif rho_s is not None:
            self.at(rho_s)

    def at(self, rho_s):
        """The matrices at these rho_s, made anew only where they have changed."""
        if self.ways is None or (rho_s is not None and not np.array_equal(self.ways.rho_s, rho_s)):
            self.ways = Ways(self.p, None if rho_s is None else rho_s.copy(), *self.given)
        return self

    @property
    def G(self):
        return self.ways.G

    def _apply(self, scale, channel=None):
        """scale : (N, K) rho of each patch in each column."""
        return lambda X: X - scale * _times(self.ways.F, X, channel)

    def solve(self, rho, E, x0=None, tolerance=1e-5):
        """Reflected radiosity of the patches, (N, C), and irradiance D E + F b of the patches, (N, C)."""
        direct = _times(self.ways.D, E)
        scale = rho[self.p.patch_group].astype(np.float32)
        b, residual, _ = radiosity.gmres(self._apply(scale), (scale * direct).astype(np.float32), tolerance=tolerance, x0=x0)
        self.residual = residual
        return b, direct + _times(self.ways.F, b)

    def tiles(self, rho, E, b):
        """Irradiance of the tiles, (T, C)."""
        return _times(self.ways.D_tile, E) + _times(self.ways.G, b)

    @cached_property
    def halves(self):
        """Two of the same with disjoint halves of the rays of tiles and lobes; only to look at the tiles with."""
        found = []
        for k in (0, 1):
            spec = self.p.specular
            if spec is not None and spec.halves:
                W, V = spec.halves[k]
                spec = replace(spec, W=W, V=V, _mixtures={})
            found.append(Light(replace(self.p, G=self.p.halves[k], specular=spec)))
        return found

    def lobes(self, E, b, bend=()):
        """What lobes add to the tiles, (T, C) or 0."""
        if self.ways.W is None and self.ways.V is None:
            return 0
        total = _times(self.ways.V, E) + _times(self.ways.W, b)
        for step, (_, _, W, V, _, _) in zip(bend, self.p.specular.bend):
            if step:
                total = total + step * self.bent(W, V, E, b)
        return total

    def bent(self, W, V, E, b):
        """What such changes of the lobes or of the ways (by chain, (T, N) and (T, L)) change in the tiles' light, (T, C)."""
        return self.p.specular.chains.total(self.ways.rho_s, W, V, b, E) + np.zeros((len(self.p.tile_group), self.p.channels))

    def shown(self, rho, E, b, bend=()):
        """Radiosity of the tiles, (T, C)."""
        return self.ways.seen * rho[self.p.tile_group] * self.tiles(rho, E, b) + self.lobes(E, b, bend)

    def render(self, rho, E, gamma, x0=None) -> State:
        b, _ = self.solve(rho, E, x0)
        return State(rho, E, gamma, self.shown(rho, E, b), b)


def metric_of(problem, gamma):
    if problem.metric.transfer.kind == "gamma":
        return Metric(Transfer("gamma", gamma))
    return problem.metric


def observe(problem, gamma):
    return problem.photograph.linear(metric_of(problem, gamma).transfer)


def group_mean(problem, values, weights=None):
    """Pixel-weighted mean over each group's tiles, (G, C); NaN for a group never seen."""
    w = problem.n_pixels.astype(float)
    total = np.zeros((len(problem.groups), values.shape[1]))
    np.add.at(total, problem.tile_group, values * w[:, None])
    count = np.bincount(problem.tile_group, w, minlength=len(problem.groups))[:, None]
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def initialise(problem, gamma):
    """eq. 4.3: rho_i is the mean of P ** gamma over the pixels of group i; a group never seen starts at the seen
    groups' mean by area; an unknown lamp at the brightest group mean."""
    seen, _ = observe(problem, gamma)
    mean = group_mean(problem, seen)
    rho = np.where(np.isnan(problem.rho), np.clip(mean, 0.02, 0.9), problem.rho)
    prior, _ = _prior(problem, rho)
    rho = np.where(np.isnan(rho), prior, rho)
    E = np.where(np.isnan(problem.emittance), 1.0, problem.emittance)
    unknown = np.isnan(problem.emittance)
    if unknown.any():
        # one power for all unknown lamps so that the picture's mean is right at rho = 0.5
        level = (problem.D_tile @ E).mean(axis=0)
        E = np.where(unknown, np.maximum(2 * seen.mean(axis=0) / np.maximum(level, 1e-12), 1e-6), E)
    return rho, E


def _prior(problem, rho):
    """Mean of the seen groups by area and their spread, per channel (SCENE.md 3)."""
    free = np.isnan(problem.rho).any(axis=1)
    has = np.isin(np.arange(len(problem.groups)), problem.tile_group)
    use = has & free if (has & free).any() else has
    if not use.any():
        return np.full(problem.channels, 0.5), np.full(problem.channels, 0.3)
    w = problem.group_area[use][:, None]
    mean = (rho[use] * w).sum(axis=0) / w.sum()
    spread = np.sqrt(((rho[use] - mean) ** 2 * w).sum(axis=0) / w.sum())
    return mean, np.maximum(spread, 0.05)


# -- Gauss-Newton

@dataclass(frozen=True)
class _Layout:
    """Which parameters are free: reflectance (g, c), lamp (l, c), specular reflectance (m, c), shapes of lobes, gamma."""
    rho: np.ndarray      # (n_rho, 2)
    E: np.ndarray        # (n_E, 2)
    rho_s: np.ndarray    # (n_s, 2)
    bend: tuple          # bounds (low, high) of each shape's step
    gamma: bool

    @property
    def ends(self):
        """Where each kind of parameter ends."""
        return np.cumsum([len(self.rho), len(self.E), len(self.rho_s), len(self.bend)])

    @property
    def size(self):
        return int(self.ends[-1]) + self.gamma

    @property
    def channel(self):
        """Of the parameters that change the patches' light, (n,)."""
        return np.concatenate([self.rho[:, 1], self.E[:, 1], self.rho_s[:, 1]]).astype(int)

    def pack(self, state):
        parts = [state.rho[tuple(self.rho.T)], state.E[tuple(self.E.T)]]
        if len(self.rho_s) or self.bend:
            parts += [state.rho_s[tuple(self.rho_s.T)], state.bend]
        return np.concatenate(parts + [[state.gamma] * self.gamma])

    def unpack(self, theta, state):
        """rho, E, gamma, rho_s, bend."""
        rho, E = state.rho.copy(), state.E.copy()
        rho_s, bend = None if state.rho_s is None else state.rho_s.copy(), state.bend
        n, m, k, j = self.ends
        rho[tuple(self.rho.T)] = theta[:n]
        E[tuple(self.E.T)] = theta[n:m]
        if k > m:
            rho_s[tuple(self.rho_s.T)] = theta[m:k]
        if j > k:
            bend = theta[k:j].copy()
        return rho, E, float(theta[-1]) if self.gamma else state.gamma, rho_s, bend

    def bounds(self):
        n, m, s = len(self.rho), len(self.E), len(self.rho_s)
        low, high = (np.array([b[i] for b in self.bend], float).reshape(-1) for i in (0, 1))
        return (np.concatenate([np.zeros(n + m + s), low, [0.2] * self.gamma]), np.concatenate([np.ones(n), np.full(m, np.inf), np.ones(s), high, [8.0] * self.gamma]))


def _layout(problem):
    used = np.isin(np.arange(len(problem.groups)), np.concatenate([problem.tile_group, problem.patch_group]))
    rho = np.argwhere(np.isnan(problem.rho) & used[:, None])
    spec = problem.specular
    rho_s = np.argwhere(np.isnan(spec.rho_s)) if spec is not None else np.zeros((0, 2), int)
    bend = tuple((low, high) for *_, low, high in spec.bend) if spec is not None else ()
    return _Layout(rho, np.argwhere(np.isnan(problem.emittance)), rho_s, bend, problem.fit_gamma)


def _patch_derivative(problem, light, layout, state, irradiance):
    """db/dtheta of the patches, (N, n) without gamma and shapes, by one block solve."""
    n, m = len(layout.rho), len(layout.rho) + len(layout.E)
    channel = layout.channel
    scale = state.rho[problem.patch_group].astype(np.float32)
    rhs = np.zeros((len(problem.area), len(channel)), np.float32)
    for k, (g, c) in enumerate(layout.rho):
        rhs[:, k] = np.where(problem.patch_group == g, irradiance[:, c], 0)
    for k, (lamp, c) in enumerate(layout.E):
        D = light.ways.D
        rhs[:, n + k] = scale[:, c] * D[c if len(D) > 1 else 0][:, lamp]
    for k, (s, c) in enumerate(layout.rho_s):
        dF, dD = light.ways.slopes(s, c)[:2]
        rhs[:, m + k] = scale[:, c] * (_dot(dD, state.E[:, c]) + _dot(dF, state.b[:, c]))
    # the exact residual decides where the iteration ends; its derivative only how fast
    light.derivative, _, _ = radiosity.gmres(light._apply(scale[:, channel], channel), rhs, tolerance=3e-3, x0=light.derivative)
    return light.derivative


def _dot(A, x):
    return 0 if isinstance(A, int) else A @ x


def _jacobian(problem, light, layout, state, db):
    """dB/dtheta of the tiles, (T, C, n), zero for gamma."""
    n_rho, n_E, n_s, n_bend = layout.ends
    ways, channel = light.ways, layout.channel
    reaching = _times(ways.G, db, channel)                                                                   # (T, n)
    glossed = _times(ways.W, db, channel)
    # lobes that are bent by a step: what that adds to W and V, part by part
    bent = [(step, bend[2], bend[3]) for step, bend in zip(() if state.bend is None else state.bend, problem.specular.bend if problem.specular else ()) if step]
    power = problem.specular.chains.power(ways.rho_s) if bent else None
    for step, W, _ in bent:
        glossed = glossed + sum(step * power[k][channel] * (A @ db) for k, A in W.items())
    rho_tile = ways.seen * state.rho[problem.tile_group]
    irradiance = light.tiles(state.rho, state.E, state.b)
    J = np.zeros((len(problem.tile_group), problem.channels, layout.size))
    of = lambda matrices, c: matrices[c if len(matrices) > 1 else 0]
    for k, c in enumerate(channel):
        J[:, c, k] = rho_tile[:, c] * reaching[:, k] + (0 if ways.W is None else glossed[:, k])
        if k < n_rho:
            mine = problem.tile_group == layout.rho[k, 0]
            J[mine, c, k] += (irradiance * ways.seen)[mine, c]
        elif k < n_E:
            lamp = layout.E[k - n_rho, 0]
            J[:, c, k] += rho_tile[:, c] * of(ways.D_tile, c)[:, lamp]
            if ways.V is not None and not isinstance(of(ways.V, c), int):
                J[:, c, k] += of(ways.V, c)[:, lamp]
            J[:, c, k] += sum(step * power[n, c] * A[:, lamp] for step, _, V in bent for n, A in V.items())
        else:
            _, _, dG, dD, dW, dV, dseen = ways.slopes(layout.rho_s[k - n_E, 0], c)
            b, E = state.b[:, c], state.E[:, c]
            J[:, c, k] += rho_tile[:, c] * (_dot(dD, E) + _dot(dG, b)) + _dot(dV, E) + _dot(dW, b) \
                + dseen * state.rho[problem.tile_group, c] * irradiance[:, c]
            if bent:
                slope = problem.specular.chains.slope(ways.rho_s, layout.rho_s[k - n_E, 0])[:, c]
                J[:, c, k] += sum(step * slope[n] * (A @ x) for step, W, V in bent for parts, x in ((W, b), (V, E)) for n, A in parts.items())
    for k in range(n_s, n_bend):
        _, _, W, V, _, _ = problem.specular.bend[k - n_s]
        J[:, :, k] = light.bent(W, V, state.E, state.b)
    return J


def _residual(problem, B, gamma):
    """Display value of synthesis minus photograph per tile, (T, C), and its derivative in B and in gamma."""
    metric = metric_of(problem, gamma)
    seen, seen_slope = observe(problem, gamma)
    residual = metric.value(B) - metric.value(seen)
    slope = metric.slope(B)
    by_gamma = np.zeros_like(residual)
    if problem.fit_gamma:
        def fixed(B):            # d (B ** (1 / gamma)) / d gamma at fixed B: the factor -1 / gamma^2 missing in eq. 4.2
            B = np.maximum(B, 1e-12)
            return -metric.value(B) * np.log(B) / gamma ** 2
        by_gamma = fixed(B) - fixed(seen) - metric.slope(seen) * seen_slope
    return residual, slope, by_gamma


def _variance(problem, residual):
    """Variance of each tile, (T, 1): pixel noise falls with the tile's size, what the model lacks does not."""
    typical = 1.4826 * float(np.median(np.abs(residual))) if residual.size else 0.0
    variance = problem.pixel_noise ** 2 / problem.n_pixels[:, None] + min(max(typical, 5e-4), 0.05) ** 2
    return variance if problem.variance is None else variance + problem.variance


def _weights(problem, residual):
    """(T, C): residuals far out (a texture, a reflection the model does not know) are held down (Huber at 2.5)."""
    variance = _variance(problem, residual)
    return np.minimum(1, 2.5 * np.sqrt(variance) / np.maximum(np.abs(residual), 1e-12)) / variance


def _pixel_noise(problem):
    """Robust display noise of one pixel from differences of neighbours inside tiles."""
    step = np.diff(problem.pixels, axis=0)
    inner = np.ones(len(step), bool)
    inner[problem.start[1:-1] - 1] = False
    return max(1.4826 * float(np.median(np.abs(step[inner]))) / np.sqrt(2), 0.3 / 255) if inner.any() else 0.01


class _Equations:
    """The problem linearised at a state: residual r and Jacobian J in display values, per half of the tiles' rays too."""

    def __init__(self, problem, light, layout, rho, E, gamma, rho_s=None, bend=None, x0=None):
        self.p, self.light, self.layout = problem, light.at(rho_s), layout
        b, self.irradiance = light.solve(rho, E, x0)
        self.state = State(rho, E, gamma, light.shown(rho, E, b, () if bend is None else bend), b, rho_s, bend)
        self.residual, self.slope, self.by_gamma = _residual(problem, self.state.B, gamma)

    def jacobian(self, light=None, slope=None, by_gamma=None):
        """(T C, n) with all rays of the tiles or with those of another light."""
        self.light.at(self.state.rho_s)
        if not hasattr(self, "db"):
            self.db = _patch_derivative(self.p, self.light, self.layout, self.state, self.irradiance)
        J = (self.slope if slope is None else slope)[:, :, None] * _jacobian(self.p, light or self.light, self.layout, self.state, self.db)
        if self.layout.gamma:
            J[:, :, -1] = self.by_gamma if by_gamma is None else by_gamma
        return J.reshape(-1, self.layout.size)

    def half(self, k):
        """Residual (T C,) and Jacobian (T C, n) as half k of the rays of tiles and lobes see them."""
        s = self.state
        light = self.light.halves[k].at(s.rho_s)
        B = light.shown(s.rho, s.E, s.b, () if s.bend is None else s.bend)
        residual, slope, by_gamma = _residual(self.p, B, s.gamma)
        return residual.reshape(-1), self.jacobian(light, slope, by_gamma)

    def prior(self):
        """Of the groups never seen: gradient (n,) and Hessian diagonal (n,)."""
        gradient, diagonal = np.zeros(self.layout.size), np.zeros(self.layout.size)
        mean, spread = _prior(self.p, self.state.rho)
        for k in np.flatnonzero(~np.isin(self.layout.rho[:, 0], self.p.tile_group)):
            g, c = self.layout.rho[k]
            diagonal[k] = 1 / spread[c] ** 2
            gradient[k] = (self.state.rho[g, c] - mean[c]) * diagonal[k]
        return gradient, diagonal

    def cost(self, weight):
        gradient, diagonal = self.prior()
        return float((weight * self.residual ** 2).sum() + (gradient ** 2 / np.where(diagonal > 0, diagonal, 1)).sum())


def gauss_newton(problem: Problem, *, gamma=2.2, max_iterations=30, tolerance=1e-5, trace=None, start=None, finish=True) -> Result:
    """All unknown reflectances, lamps and gamma together: Levenberg-Marquardt with bounds and Huber weights, then a
    few steps that take away the bias which the sampling noise of the tiles' own light leaves in least squares
    (errors in the regressors): the two halves of each tile's rays err independently, so J of one half against the
    residual of the other has no such bias.

    start : (rho, E, gamma, rho_s) to begin with instead of eq. 4.3, as specular problems must; bends begin at 0
    finish : False: neither the last steps nor the uncertainty (on the way to a better problem)
    """
    layout = _layout(problem)
    light = Light(problem)
    if start is None:
        start = (*initialise(problem, gamma), gamma, None)
    rho, E, gamma, rho_s = start
    gamma = gamma if problem.fit_gamma else problem.metric.transfer.gamma
    low, high = layout.bounds()
    damping, converged, iteration = 1e-3, False, 0
    at = _Equations(problem, light, layout, rho, E, gamma, rho_s, None if rho_s is None else np.zeros(len(layout.bend)))
    while True:
        if trace:
            trace(iteration=iteration, image_rmse=_rmse(problem, at.residual), state=at.state)
        if converged or iteration >= max_iterations or layout.size == 0 or len(problem.tile_group) == 0:
            break
        iteration += 1
        weight = _weights(problem, at.residual)
        J = at.jacobian()
        gradient, diagonal = at.prior()
        H = J.T @ (weight.reshape(-1, 1) * J) + np.diag(diagonal)
        g = J.T @ (weight * at.residual).reshape(-1) + gradient
        theta, cost = layout.pack(at.state), at.cost(weight)
        for _ in range(12):
            step = _bounded_step(H, g, theta, low, high, damping)
            trial = _Equations(problem, light, layout, *layout.unpack(theta + step, at.state), x0=at.state.b)
            if trial.cost(weight) <= cost * (1 + 1e-9) + 1e-12:
                damping = max(damping / 10, 1e-9)
                break
            damping = max(damping, 1e-6) * 10
        else:
            converged = bool(_relative(step, theta) < 100 * tolerance)
            break
        at = trial
        converged = bool(_relative(step, theta) < tolerance)
    converged = converged or layout.size == 0
    if finish and problem.halves and converged and layout.size and len(problem.tile_group):
        at, steps = _unbiased(problem, layout, at, tolerance)
        iteration += steps
        if trace:
            trace(iteration=iteration, image_rmse=_rmse(problem, at.residual), state=at.state)
    result = Result(at.state, converged, iteration, _rmse(problem, at.residual), tile_residual=at.residual, residual=light.residual)
    if finish and layout.size and len(problem.tile_group):
        _uncertainty(problem, layout, at, result)
    return result


def _relative(step, theta):
    return float(np.max(np.abs(step) / np.maximum(np.abs(theta), 0.05), initial=0.0))


def _unbiased(problem, layout, at, tolerance, max_steps=8):
    """From the least-squares solution to the root of  J0' W r1 + J1' W r0 + prior = 0  (halves as instruments for each
    other). Kept only if its steps die away; otherwise the least-squares solution stands."""
    start = at
    weight = _weights(problem, at.residual).reshape(-1)
    low, high = layout.bounds()
    last = np.inf
    for steps in range(1, max_steps + 1):
        (r0, J0), (r1, J1) = at.half(0), at.half(1)
        gradient, diagonal = at.prior()
        cross = J0.T @ (weight[:, None] * J1)
        H = (cross + cross.T) / 2 + np.diag(diagonal)
        g = (J0.T @ (weight * r1) + J1.T @ (weight * r0)) / 2 + gradient
        if np.linalg.eigvalsh(H / np.sqrt(np.outer(np.diag(H), np.diag(H))))[0] <= 1e-9 if (np.diag(H) > 0).all() else True:
            return start, 0
        theta = layout.pack(at.state)
        step = _bounded_step(H, g, theta, low, high, 0.0)
        size = _relative(step, theta)
        if size > 0.9 * last:
            return start, 0
        last = size
        at = _Equations(problem, at.light, layout, *layout.unpack(theta + step, at.state), x0=at.state.b)
        if size < 10 * tolerance:
            return at, steps
    return start, 0


def _bounded_step(H, g, theta, low, high, damping):
    """Levenberg-Marquardt step; a step towards a bound covers at most 0.9 of the way (clipping would bend its
    direction), and a parameter that sits at its bound and is pushed outward is held."""
    free = np.ones(len(theta), bool)
    free &= ~((theta <= low + 1e-9) & (g > 0)) & ~((theta >= high - 1e-9) & (g < 0))
    step = np.zeros(len(theta))
    for _ in range(len(theta) + 1):
        idx = np.flatnonzero(free)
        if len(idx) == 0:
            break
        A = H[np.ix_(idx, idx)]
        scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
        A = A / np.outer(scale, scale)
        step[:] = 0
        step[idx] = np.linalg.lstsq(A + damping * np.eye(len(idx)), -g[idx] / scale, rcond=1e-13)[0] / scale
        break
    room = np.where(step > 0, high - theta, theta - low)
    limit = np.where(np.abs(step) > 0, np.where(room > 1e-4, 0.9 * room, room) / np.maximum(np.abs(step), 1e-12), 1.0)
    return np.clip(step * 1.0, -np.abs(step) * np.minimum(limit, 1), np.abs(step) * np.minimum(limit, 1))


def _rmse(problem, residual):
    w = np.broadcast_to(problem.n_pixels[:, None], residual.shape)
    return float(np.sqrt((w * residual ** 2).sum() / max(w.sum(), 1)))


def group_rmse(problem, residual):
    """Display RMSE of each group's tiles, (G,); NaN where the group is not seen."""
    return np.sqrt(group_mean(problem, (residual ** 2).mean(axis=1, keepdims=True))[:, 0])


def _uncertainty(problem, layout, at, result):
    """Standard deviations of all parameters, from four causes.

    Tile residuals (pixel noise, texture, the tiles' own sampling) by the sandwich formula; then, each as a change of
    all tiles pushed through the same normal equations: the patches' discretisation (half of what the sub-cell
    correction changes) and the sampling of the form factors (two disjoint halves of the rays). Groups never seen
    enter through their prior.
    """
    n, state = layout.size, at.state
    J = at.jacobian()
    weight = _weights(problem, at.residual).reshape(-1)
    prior = np.diag(at.prior()[1])
    H = J.T @ (weight[:, None] * J) + prior
    inverse, loose = _inverse(H, layout.pack(state))
    by_tile = lambda rows: rows.reshape(-1, problem.channels, n).sum(axis=1)      # channels of one tile go together
    score = by_tile((weight * at.residual.reshape(-1))[:, None] * J)
    pixel = np.repeat(problem.pixel_noise ** 2 / problem.n_pixels, problem.channels)
    cov = inverse @ (score.T @ score + J.T @ ((weight ** 2 * pixel)[:, None] * J) + prior) @ inverse

    def push(dB):
        """(n,) change of the parameters that a change dB (T, C) of the synthesis causes."""
        return -inverse @ (J.T @ (weight * (at.slope * dB).reshape(-1)))

    rho_tile = state.rho[problem.tile_group]
    at.light.at(state.rho_s)
    rho_tile = at.light.ways.seen * rho_tile
    independent = []                                               # of each tile, (T, C) display
    if problem.specular is not None and problem.specular.spread:
        independent.append(at.slope * rho_tile * at.light.bent(*problem.specular.spread, state.E, state.b))
    terms = {"discretisation": 0.5 * push(rho_tile * ((problem.G - problem.G_plain) @ state.b))}
    for name, W, V in problem.specular.doubts if problem.specular is not None else ():
        terms[name] = push(at.light.bent(W, V, state.E, state.b))
    if problem.halves:
        G0, G1, F0, F1 = problem.halves
        b0, b1 = (Light(problem, F, problem.G, state.rho_s).solve(state.rho, state.E, state.b)[0] for F in (F0, F1))
        terms["form factors"] = 0.5 * push(rho_tile * (problem.G @ (b0 - b1)))
        sampling = at.slope * 0.5 * rho_tile * ((G0 - G1) @ state.b)
        independent.append(sampling)
        expected = float(np.sqrt(np.median(sampling ** 2 / 0.455 + problem.pixel_noise ** 2 / problem.n_pixels[:, None])))
        result.misfit = float(np.sqrt(np.median(at.residual ** 2) / 0.455)) / max(expected, 1e-3)
    for error in independent:
        each = by_tile((weight * error.reshape(-1))[:, None] * J)
        cov = cov + inverse @ (each.T @ each) @ inverse
    theta = layout.pack(state)
    n_rho, n_E, n_s, n_bend = layout.ends
    seen = np.append(np.isin(layout.rho[:, 0], problem.tile_group), np.ones(n - n_rho, bool))
    for name, delta in terms.items():
        # one realisation can vanish by chance: no reflectance below the median of them all, relative to its value
        size = np.abs(delta) / np.maximum(np.abs(theta), 0.02)
        common = float(np.median(size[:n_rho][seen[:n_rho]])) if seen[:n_rho].any() else 0.0
        size[:n_rho] = np.where(seen[:n_rho], np.maximum(size[:n_rho], common), size[:n_rho])
        cov = cov + np.diag((size * np.maximum(np.abs(theta), 0.02)) ** 2)
        result.shares[name] = common
    if result.misfit > MISFIT:
        cov = cov * result.misfit ** 2          # what noise does not explain may be anything: every value is as uncertain
    sigma = np.maximum(np.sqrt(np.maximum(np.diag(cov), 0)), loose)
    result.sigma_rho, result.sigma_E = np.zeros(state.rho.shape), np.zeros(state.E.shape)
    result.sigma_rho[tuple(layout.rho.T)] = sigma[:n_rho]
    result.sigma_E[tuple(layout.E.T)] = sigma[n_rho:n_E]
    if problem.specular is not None:
        result.sigma_rho_s = np.zeros(state.rho_s.shape)
        result.sigma_rho_s[tuple(layout.rho_s.T)] = sigma[n_E:n_s]
        result.sigma_bend = sigma[n_s:n_bend]
    result.sigma_gamma = float(sigma[-1]) if layout.gamma else None


def _inverse(H, theta):
    """Inverse of the normal matrix without its null directions, and for each parameter the standard deviation (n,) that
    those leave: a direction in which nothing changes the picture is as unsure as the values themselves."""
    diagonal = np.diag(H)
    alive = diagonal > 1e-14 * max(float(diagonal.max(initial=0.0)), 1e-300)
    scale = np.where(alive, 1 / np.sqrt(np.where(alive, diagonal, 1.0)), 0.0)
    value, vector = np.linalg.eigh(H * np.outer(scale, scale))
    size = np.maximum(np.abs(theta), 0.02)
    loose = np.where(alive, 0.0, size)
    weak = value < 1e-8 * max(float(value.max(initial=0.0)), 1e-300)
    for v in vector[:, weak].T:
        relative = np.abs(scale * v) / size
        if relative.max() > 0:
            loose = np.maximum(loose, size * relative / relative.max())
    good = vector[:, ~weak] / np.sqrt(value[~weak])
    good = scale[:, None] * good
    return good @ good.T, loose


def scale(problem) -> str:
    """What fixes the scale of the light (SCENE.md 4)."""
    if not np.isnan(problem.emittance).all():
        return "lamps"
    given = ~np.isnan(problem.rho).any(axis=1)
    named = [g for g in np.flatnonzero(given) if problem.groups[g] not in problem.lamps]
    return "reference" if named else "interreflection"


def fit(problem: Problem, **options):
    """`gauss_newton`, and what fixed the scale. Where interreflection alone would have to and cannot (the lamps'
    sigma is half their value or more), the lamps are set to 1 by convention and the rest is fitted again."""
    fixed_by = scale(problem)
    result = gauss_newton(problem, **options)
    if fixed_by == "interreflection" and len(problem.tile_group) and (result.sigma_E > 0.5 * result.state.E).any():
        result = gauss_newton(replace(problem, emittance=np.ones_like(problem.emittance)), **options)
        result.warnings.append("interreflection is too weak here to fix the scale: emittance 1 by convention")
        fixed_by = "convention"
    return result, fixed_by


# -- the paper's alternation

def paper(problem: Problem, *, gamma=2.2, damped=False, exponent=1.0, threshold=1e-3, max_inner=60, max_outer=30,
          trace=None) -> Result:
    """Section 4.5 as printed: eq. 4.3; eq. 4.4-4.6 to the threshold; gamma on eq. 4.1; repeated.

    damped : the correction's common factor m is damped, rho_i *= (q_i / m) m ** (1 - mean rho), on ratios of
        radiosities and symmetrised on |ln epsilon|; the printed form diverges in bright rooms (DESIGN 3)
    exponent : power on the ratio of pixel means; 1 as in eq. 4.4, gamma for the ratio of radiosities of the line below it
    """
    light = Light(problem)
    rho, E = initialise(problem, gamma)
    gamma = gamma if problem.fit_gamma else problem.metric.transfer.gamma
    pairs, tile_pair = np.unique(np.stack([problem.tile_group, problem.tile_object], axis=1), axis=0, return_inverse=True)
    n = problem.n_pixels.astype(float)
    m_pair = np.bincount(tile_pair, n)[:, None]
    free = np.isnan(problem.rho)
    iteration, converged, x0 = 0, False, None

    def object_mean(values):
        total = np.zeros((len(pairs), values.shape[1]))
        np.add.at(total, tile_pair, values * n[:, None])
        return total / m_pair

    def finish(state, converged):
        metric = metric_of(problem, state.gamma)
        residual = metric.value(state.B) - metric.value(observe(problem, state.gamma)[0])
        return Result(state, converged, iteration, _rmse(problem, residual), tile_residual=residual, residual=light.residual)

    for outer in range(max_outer):
        settled = False
        for inner in range(max_inner):
            state = light.render(rho, E, gamma, x0)
            x0 = state.b
            metric = metric_of(problem, gamma)
            seen, _ = observe(problem, gamma)
            residual = metric.value(state.B) - metric.value(seen)
            if trace:
                trace(iteration=iteration, image_rmse=_rmse(problem, residual), state=state)
            iteration += 1
            if not np.isfinite(state.B).all():
                return finish(state, False)
            if damped:
                epsilon = object_mean(seen) / np.maximum(object_mean(state.B), 1e-12)
            else:
                shown = (lambda B: B) if metric.transfer.kind == "linear" else metric.value
                epsilon = (object_mean(shown(seen)) / np.maximum(object_mean(shown(state.B)), 1e-12)) ** exponent
            q = np.ones_like(rho)
            for g in np.unique(pairs[:, 0]):
                mine = pairs[:, 0] == g
                for c in range(problem.channels):
                    q[g, c] = _group_correction(epsilon[mine, c], m_pair[mine, 0], symmetric=damped)
            if damped:
                use = np.isin(np.arange(len(rho)), problem.tile_group)[:, None] & free
                w = np.where(use, problem.group_area[:, None], 0)
                m = np.exp((w * np.log(np.maximum(q, 1e-12))).sum(axis=0) / np.maximum(w.sum(axis=0), 1e-300))
                mean_rho = (problem.group_area[:, None] * rho).sum(axis=0) / problem.group_area.sum()
                q = q / m * m ** (1 - mean_rho)
            new = np.where(free, np.clip(rho * q, 0, 1 if damped else 10.0), rho)
            prior, _ = _prior(problem, new)
            new = np.where(free & ~np.isin(np.arange(len(rho)), problem.tile_group)[:, None], prior, new)
            change = np.max(np.abs(new - rho) / np.maximum(rho, 1e-6))
            rho = new
            if change > 1e3 or rho.max() > 1.5:
                return finish(light.render(np.clip(rho, 0, 0.999), E, gamma), False)
            if change < threshold:
                settled = True
                break
        if not problem.fit_gamma:
            converged = settled
            break
        state = light.render(rho, E, gamma, x0)
        better = _best_gamma(problem, state.B, gamma)
        if abs(better - gamma) < threshold:
            converged = settled
            gamma = better
            break
        gamma = better
    return finish(light.render(rho, E, gamma, x0), converged)


def _group_correction(epsilon, pixels, symmetric):
    """eq. 4.5 with the weights f of eq. 4.6 over the objects of one group.

    As printed the legend says K_j where the formula has epsilon_j, and f is one-sided: epsilon is a ratio, so one
    object in shadow ({.3, 1, 1}) throws out both good ones. `symmetric` judges |ln epsilon - its median| instead.
    """
    if symmetric:
        distance = np.exp(np.abs(np.log(np.maximum(epsilon, 1e-12)) - np.median(np.log(np.maximum(epsilon, 1e-12)))))
        low, high = distance.min(), distance.max()
        keep = distance < 2 * low * (1 + (high - low) / (high + low))
        keep |= distance <= low
    else:
        low, high = epsilon.min(), epsilon.max()
        keep = epsilon < 2 * low * (1 + (high - low) / max(high + low, 1e-300))
        keep |= epsilon <= low
    return float((epsilon * pixels)[keep].sum() / pixels[keep].sum())


def _best_gamma(problem, B, gamma):
    """Gradient search on eq. 4.1 over gamma with B fixed; the photograph's tile means are in display values."""
    count = problem.n_pixels[:, None]
    display = problem.photograph.display()
    B = np.clip(B, 1e-9, 1)
    logB = np.log(B)
    for _ in range(100):
        value = B ** (1 / gamma)
        d = -value * logB / gamma ** 2                       # eq. 4.2 with its missing factor -1 / gamma^2
        gradient = (count * (value - display) * d).sum()
        curvature = (count * d ** 2).sum()
        step = -gradient / max(curvature, 1e-300)
        gamma_new = float(np.clip(gamma + np.clip(step, -0.5, 0.5), 0.2, 8))
        if abs(gamma_new - gamma) < 1e-7:
            return gamma_new
        gamma = gamma_new
    return gamma
