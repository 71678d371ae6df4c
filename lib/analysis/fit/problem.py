"""Reflectances, lamps and gamma from one photograph (sections 4.4 and 4.5): the inverse problem.

The scene's light is linear in the lamps and, at given reflectances, one small linear solve:

    b = rho (D E + F b)        reflected radiosity of the patches (eq. 3.2; D: lamp factors)
    B_t = rho_g (D_t E + G_t b)     radiosity of tile t of the photograph, which lies on group g

so a re-rendering of all tiles after a change of reflectance costs milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from lib.analysis.fit.mixture import Mixture
from lib.analysis.seen.tile_pixels import TilePixels
from lib.given.jpeg import SHARED_PX
from lib.given.transfer import Metric, Transfer
from lib.light.balance import BALANCED
from lib.light.factors_file import OUTSIDE

# The error that neighbouring tiles have in common, in what noise explains. A fit is one up to FITS: exact scenes have
# .2 to .45, a pose 2 px off 1.3 to 2.6, a lamp 12 cm off 4 to 8. From DOUBT it is worth while to look further.
FITS = 1.2
USUAL_PIXELS = 640 * 480  # smaller pictures are judged as parts of such a one
DOUBT = 0.4
MISFIT = 4.0  # residuals so many times what noise explains: something told to the fit is wrong
# of the variance of a pixel beside an edge that tiles have, over their pixels: twice what tiles of 4 to 30 pixels were
# off by in JPEGs of quality 80
EDGE_SHARE = 1 / 8
FAR_OUT = 2.5  # standard deviations of a tile, beyond which its residual costs what it is, not its square
OF_MEDIAN = 1.5  # variance of the median of noise over that of its mean


class Halves(NamedTuple):
    """G and F from the first and from the last half of their rays: their errors are independent.

    D_tile : (one, other) by how much it is another then, () where no rays tell of the lamps' light
    """

    G0: Any
    G1: Any
    F0: Any
    F1: Any
    D_tile: tuple = ()

    def difference(self, E, b):
        """(T, C) half of what the two differ by in the light of the tiles."""
        found = 0.5 * (self.G0 @ b - self.G1 @ b)
        return found + 0.5 * ((self.D_tile[0] - self.D_tile[1]) @ E) if self.D_tile else found


class ShapeStep(NamedTuple):
    """How a step in one shape of a lobe changes its light: W, V by chain per unit step.

    m : specular group;  name : alpha, alpha_x, alpha_y or turn;  low, high : bounds of the step (of ln alpha, or rad)
    """

    m: int
    name: str
    W: dict
    V: dict
    low: float = -0.35
    high: float = 0.35


class Doubt(NamedTuple):
    """A change of the lobes' light as large as one standard deviation of what its cause leaves open: W, V by chain."""

    cause: str
    W: dict
    V: dict


@dataclass(eq=False)
class SpecularTerms:
    """What was traced for M specular groups: light is a polynomial in their rho_s, chain by chain (K of them).

    A tile shows its group as seen by way of `tile_chain` (0: at once, else through mirrors), and a glossy one its lobe
    besides:
        B_t = power_t rho_g (D_t E + G_t b) + sum_k power_k (V_k E + W_k b)_t,      power_k = prod_m rho_s[m] ** k_m
    and likewise F, D, G, D_t are sums over the chains of the light's ways. `bend` says how shapes of lobes change W and
    V: shapes are adjusted linearly here, and traced again outside.

    groups : (M,) numbers;  chains : lib.light.chains.Chains;  rho_s : (M, C), NaN where unknown;  tile_chain : (T,) int
    F, D : chain -> (N, N) CSR, (N, L);  G, D_tile : chain -> (T, N) CSR, (T, L);  W, V : likewise, of the lobes
    halves : ((W, V), (W, V)) from disjoint rays;  spread : (G, D_tile) by chain, as large as their sampling error
    """

    groups: tuple
    chains: Any
    F: dict
    D: dict
    G: dict
    D_tile: dict
    tile_chain: np.ndarray
    W: dict
    V: dict
    rho_s: np.ndarray
    bend: list = field(default_factory=list)
    doubts: list = field(default_factory=list)
    halves: tuple = ()
    spread: tuple = ()
    _mixtures: dict = field(default_factory=dict, repr=False)

    def mixture(self, name, base):
        """The sum over the chains of the part `name` and of base, ready for any rho_s."""
        key = name, id(base)
        if key not in self._mixtures:
            # base is kept, so that its id stays its own
            self._mixtures[key] = Mixture(base, getattr(self, name)), base
        return self._mixtures[key][0]


class CauseTerms(NamedTuple):
    """What may be wrong with the picture as a whole, linearised: k numbers that are 0 where the problem stands.

    names : (k,) of the cause that each number belongs to
    columns : (T, C, k) derivatives of the display residual
    spread, usual : standard deviations (k,) of the prior, or inf, and its means, (k,) or one for all
    """

    names: tuple
    columns: np.ndarray
    spread: np.ndarray
    usual: np.ndarray | float = 0.0

    @property
    def means(self):
        """(k,) of the prior."""
        return np.broadcast_to(self.usual, len(self.names))

    def of(self, cause):
        """(k,) bool: the numbers of one cause."""
        return np.array([name == cause for name in self.names], bool)

    def without(self, names) -> CauseTerms | None:
        """What is left without these causes."""
        kept = ~np.isin(self.names, names)
        names = tuple(np.array(self.names)[kept])
        return CauseTerms(names, self.columns[..., kept], self.spread[kept], self.means[kept]) if names else None

    def beside(self, others: CauseTerms | None) -> CauseTerms:
        """Both, these last and in place of what the others have of the same causes."""
        others = others and others.without(self.names)
        if others is None:
            return self
        return CauseTerms(
            (*others.names, *self.names),
            np.concatenate([others.columns, self.columns], axis=-1),
            np.concatenate([others.spread, self.spread]),
            np.concatenate([others.means, self.means]),
        )


@dataclass(eq=False)
class Problem:
    """What the photograph says and what geometry knows. C channels, N patches, T tiles, G groups, L lamps.

    F : (N, N) array, CSR or Corrected;  D : (N, L);  patch_group : (N,) int;  area : (N,)
    G : (T, N) CSR or Corrected, with the sub-cell correction of the sources, as F has it;  G_plain : without it
    D_tile : (T, L)
    tile_group, tile_object : (T,) int;  start : (T + 1,) into pixels;  pixels : (M, C) display
    transfer : as given, or where its search begins;  fit_transfer : its parameters are free
    lamps : names, of an open model the outside last, see lib/light/outside.py
    emittance : (L, C), NaN where unknown;  rho : (G, C), NaN where unknown, 0 for lamps, the given value for references
    halves : None where only one set of rays is known;  group_area : (G,)
    specular : light by way of mirrors and glossy surfaces, None where every group is diffuse
    variance : (T, 1) display, of what is known not to be explained (a texture), or None
    cause : fitted with the rest, or None;  doubted : not fitted, but sigma knows that it may be so, or None
    shown : pixels that show the model, used or not;  0: those of the tiles
    gain : (T, 1) of the lens, by which the photograph is divided, or None
    block_noise : display, of blocks of pixels (JPEG);  edge_noise : (T,) of a pixel of each tile, beside edges, or None
    colour_noise : (C,) display, that all tiles of one colour have in common, or None
    unsure : ((dD, dD_tile), ...) changes of the lamps' light by one standard deviation of where things stand
    unsure_outside : () -> the same, of what comes in from outside an open model; asked only where something does
    spread_E : (L, C) standard deviation of emittances before anything is seen, which may be negative then; inf: any
    noisy : tiles are medians, see Photograph.noisy
    black : (G,) bool, groups that are black where light falls on them, or None
    photograph : TilePixels of pixels, start and noisy, made where it is not theirs
    """

    F: Any
    D: np.ndarray
    patch_group: np.ndarray
    area: np.ndarray
    G: Any
    G_plain: Any
    D_tile: np.ndarray
    tile_group: np.ndarray
    tile_object: np.ndarray
    start: np.ndarray
    pixels: np.ndarray
    groups: tuple
    lamps: tuple
    emittance: np.ndarray
    rho: np.ndarray
    transfer: Transfer
    fit_transfer: bool
    halves: Halves | None = None
    group_area: np.ndarray | None = None
    specular: SpecularTerms | None = None
    variance: np.ndarray | None = None
    cause: CauseTerms | None = None
    doubted: CauseTerms | None = None
    gain: np.ndarray | None = None
    block_noise: float = 0.0
    edge_noise: np.ndarray | None = None
    colour_noise: np.ndarray | None = None
    unsure: tuple = ()
    unsure_outside: Any = None
    spread_E: np.ndarray | None = None
    noisy: bool = False
    black: np.ndarray | None = None
    shown: int = 0
    photograph: TilePixels | None = None

    def __post_init__(self):
        if self.photograph is None or not self.photograph.is_of(self.pixels, self.start, self.noisy):
            self.photograph = TilePixels(self.pixels, self.start, self.noisy)

    @property
    def channels(self):
        return self.pixels.shape[1]

    @property
    def pixel_noise(self):
        """Display noise of one pixel."""
        return self.photograph.noise

    @property
    def n_pixels(self):
        return np.diff(self.start)

    def share(self, n_pixels) -> float:
        """What so many pixels are of the picture, of one of 640 x 480 where it is smaller."""
        return n_pixels / max(self.shown or len(self.pixels), USUAL_PIXELS)

    def noise_variance(self, n_pixels):
        """(T, 1) display variance of means over so many pixels (T,): of each pixel, and of blocks that share it."""
        n = np.asarray(n_pixels, float)[:, None]
        of_tile = OF_MEDIAN if self.noisy else 1.0
        return of_tile * self.pixel_noise**2 / n + self.block_noise**2 / np.maximum(n / SHARED_PX**2, 1)

    @property
    def tile_noise(self):
        """(T, 1) display variance of the tiles' means."""
        variance = self.noise_variance(self.n_pixels)
        if self.edge_noise is None:
            return variance
        return variance + (EDGE_SHARE * self.edge_noise**2 / np.maximum(self.n_pixels, 1))[:, None]

    @property
    def plain(self):
        """(T,) bool: the tile shows nothing that is known not to be explained; all where every one does."""
        if self.variance is None or (self.variance > 0).all():
            return np.ones(len(self.tile_group), bool)
        return self.variance[:, 0] == 0

    @property
    def group_variance(self):
        """(G,) display variance of what is known not to be explained."""
        found = np.zeros(len(self.groups))
        if self.variance is not None:
            np.maximum.at(found, self.tile_group, self.variance[:, 0])
        return found

    @property
    def known_groups(self):
        """Numbers of the groups whose reflectance is given: lamps and references."""
        return {int(g) for g in np.flatnonzero(~np.isnan(self.rho).any(axis=1))}

    @property
    def own_lamps(self):
        """(L,) bool: the lamp is in the model."""
        return np.array([name not in OUTSIDE for name in self.lamps], bool)

    @property
    def seen_groups(self):
        """(G,) bool: a tile shows the group."""
        return np.isin(np.arange(len(self.groups)), self.tile_group)


@dataclass(frozen=True, eq=False)
class State:
    """rho : (G, C);  E : (L, C);  B : (T, C) radiosity of the tiles;  b : (N, C) reflected radiosity of the patches
    rho_s : (M, C) of the specular groups;  bend : (n,) steps in the shapes of the lobes;  cause : (k,) its numbers"""

    rho: np.ndarray
    E: np.ndarray
    transfer: Transfer
    B: np.ndarray
    b: np.ndarray
    rho_s: np.ndarray | None = None
    bend: np.ndarray | None = None
    cause: np.ndarray | None = None

    @property
    def gamma(self):
        return self.transfer.gamma


@dataclass(eq=False)
class Result:
    """A fit. sigma_* : standard deviations, shaped as the values, None where none were found.

    tile_residual : (T, C) display, synthesis minus photograph;  residual : of the light balance
    cov_cause : (k, k) of the numbers of a cause
    cov_transfer : (P, P) of its parameters, None where none is fitted;  at : the equations at the end
    correlated : the share of that misfit which neighbouring tiles have in common: no noise
    misfit : typical tile residual over what pixel noise and sampling explain;  shares : median relative sigma by cause
    asked : {question: its answer}, of `once`
    """

    state: State
    converged: bool
    iterations: int
    rmse: float
    sigma_rho: np.ndarray | None = None
    sigma_E: np.ndarray | None = None
    cov_transfer: np.ndarray | None = None
    sigma_rho_s: np.ndarray | None = None
    sigma_bend: np.ndarray | None = None
    tile_residual: np.ndarray | None = None
    residual: float | None = None
    misfit: float = 0.0
    correlated: float = 0.0
    shares: dict = field(default_factory=dict)
    at: Any = field(default=None, repr=False)
    cov_cause: np.ndarray | None = None
    warnings: list = field(default_factory=list)
    asked: dict = field(default_factory=dict, repr=False)

    def once(self, question, ask):
        """The answer of ask(), which is asked only once: what costs a fit is needed in several places."""
        if question not in self.asked:
            self.asked[question] = ask()
        return self.asked[question]

    @property
    def sigma_gamma(self):
        """Of gamma, None where it is not fitted."""
        fitted = self.cov_transfer is not None and self.state.transfer.kind == "gamma"
        return float(np.sqrt(self.cov_transfer[0, 0])) if fitted else None

    @property
    def fits(self) -> bool:
        """What is left is noise: neighbouring tiles have little of it in common."""
        return self.correlated <= FITS

    @property
    def in_doubt(self) -> bool:
        """The geometry may not be as given."""
        return self.correlated >= DOUBT

    @property
    def balanced(self):
        """The light that everything rests on is the solution of its equations."""
        return self.residual is None or self.residual <= BALANCED


# -- what is seen, and how far a synthesis is from it


def observe(problem: Problem, transfer: Transfer):
    """Linear means of the tiles (T, C), and their derivatives by the parameters of the transfer function, (T, C, P)."""
    mean, slope = problem.photograph.linear(transfer)
    if problem.gain is None:
        return mean, slope
    return mean / problem.gain, slope / problem.gain[..., None]


def display_residual(problem: Problem, B, transfer: Transfer):
    """Synthesis minus photograph in display values, and its derivatives: by the light (T, C) that the camera has mixed,
    and by the transfer's parameters, (T, C, P)."""
    metric, B = Metric(transfer), transfer.mixed(B)
    seen, seen_slope = observe(problem, transfer.bare)
    residual = metric.value(B) - metric.value(seen)
    slope = metric.slope(B)
    if not problem.fit_transfer:
        return residual, slope, np.zeros((*B.shape, 0))
    by = metric.by_parameters
    return residual, slope, by(B) - by(seen) - metric.slope(seen)[..., None] * seen_slope


def weights(problem: Problem, residual):
    """(T, C) weights of the tiles: one over their variance.

    Residuals far out (a texture, a reflection that the model does not know) are held down (Huber).
    """
    spread = variance(problem, residual)
    return np.minimum(1, FAR_OUT * np.sqrt(spread) / np.maximum(np.abs(residual), 1e-12)) / spread


def variance(problem: Problem, residual):
    """(T, C) of the tiles. Pixel noise falls with the tile's size; what the model lacks does not."""
    typical = 1.4826 * float(np.median(np.abs(residual[problem.plain]))) if residual.size else 0.0
    found = problem.tile_noise + min(max(typical, 5e-4), 0.05) ** 2
    return found if problem.variance is None else found + problem.variance


def huber(spread, residual):
    """(T, C) chi2 of residuals of such a variance; far out it grows by their size alone."""
    z = np.abs(residual) / np.sqrt(spread)
    return np.where(z <= FAR_OUT, z**2, FAR_OUT * (2 * z - FAR_OUT))


def group_mean(problem: Problem, values):
    """Pixel-weighted mean of values (T, K) over each group's tiles, (G, K); NaN for a group never seen."""
    w = problem.n_pixels.astype(float)
    total = np.zeros((len(problem.groups), values.shape[1]))
    np.add.at(total, problem.tile_group, values * w[:, None])
    count = np.bincount(problem.tile_group, w, minlength=len(problem.groups))[:, None]
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def group_rmse(problem: Problem, residual):
    """Display RMSE of each group's tiles, (G,); NaN where the group is not seen."""
    return np.sqrt(group_mean(problem, (residual**2).mean(axis=1, keepdims=True))[:, 0])


def rmse(problem: Problem, residual):
    """Display RMSE over all pixels of the tiles."""
    w = np.broadcast_to(problem.n_pixels[:, None], residual.shape)
    return float(np.sqrt((w * residual**2).sum() / max(w.sum(), 1)))


def scale(problem: Problem) -> str:
    """What fixes the scale of the light (SCENE.md 4)."""
    if not np.isnan(problem.emittance[problem.own_lamps]).all():
        return "lamps"
    specular = () if problem.specular is None else problem.specular.groups  # whose diffuse part is known to be none
    named = [g for g in problem.known_groups if problem.groups[g] not in problem.lamps and g not in specular]
    return "reference" if named else "interreflection"
