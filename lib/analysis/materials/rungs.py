"""One group on one rung of the ladder: what a mirror or a lobe would explain of its error, in the light found so far.

lib/analysis/materials/ladder.py decides which rung is taken, and has everything fitted anew.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from lib.analysis.fit.misfits import ENOUGH, Misfit, misfit
from lib.analysis.fit.problem import Problem, State
from lib.analysis.materials.lobes import HIGHEST, LOWEST, lobes
from lib.analysis.materials.site import Site
from lib.analysis.materials.specular_ways import PLAIN, SHEEN, irradiance_past
from lib.analysis.seen.receivers import Receivers, few
from lib.analysis.seen.tile_pixels import TilePixels
from lib.given.kinds import RUNGS
from lib.given.transfer import Metric
from lib.light import lamps, specular_lamps
from lib.light.chains import GLOSSY, MIRROR, Chains, Finish

ALPHAS = (0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.32, 0.5)
RAYS, FEW_RAYS = 128, 32  # of each tile: to compare rungs, and to find a shape
DULL = 0.04  # alpha, from which the picture of a lamp in a lobe has no sharp outline
LEAST_EXPLAINED = 0.2  # of a group's error by a round lobe: less is not worth a search for a long one
TURNS = 6  # directions that the search for an anisotropic lobe begins with
ALL, BROAD = 0.995, 0.3  # rho_s, and alpha, beyond which no surface has such a lobe
LOBE_TILES = 260  # that a search over shapes looks at


@dataclass(frozen=True, eq=False)
class Trial:
    """One rung tried for one group. misfit, diffuse : with it and without, on the same tiles

    rho_d, rho_s : (C,);  alpha : (2,);  tangent : (3,);  kept : excess that the group may keep, which asks for no rung
    """

    rung: str
    group: int
    misfit: Misfit
    diffuse: Misfit
    rho_d: np.ndarray
    rho_s: np.ndarray
    alpha: np.ndarray = field(default_factory=lambda: np.zeros(2))
    tangent: np.ndarray = field(default_factory=lambda: np.zeros(3))
    kept: float = 0.0

    @property
    def explained(self):
        """Share that this rung takes away of the diffuse error's square, or of what may be kept if that is more."""
        whole = max(self.diffuse.excess, self.kept, 1e-12)
        return (self.diffuse.excess**2 - self.misfit.excess**2) / whole**2

    @property
    def is_at_border(self):
        """Its lobe is as bright, as wide or as sharp as any may be."""
        return bool(RUNGS[self.rung].lobe and at_border(self.rho_s, self.alpha))


def at_border(rho_s, alpha):
    """Whether a lobe's shape is one at which searches end: what bends to it is no lobe.

    A sharp one may reflect all light, as metal does.
    """
    is_resolved = np.min(alpha) > LOWEST and np.max(alpha) < HIGHEST
    return not is_resolved or bool(np.max(rho_s) >= ALL and np.min(alpha) > BROAD)


class LightSoFar(NamedTuple):
    """The light found so far. finish, rho_s (M, C) : of the other specular groups than the one that is tried"""

    problem: Problem
    state: State
    finish: Finish
    rho_s: np.ndarray

    @property
    def metric(self):
        return Metric(self.state.transfer)

    def irradiance(self, site: Site, t: Receivers):
        """(T, C) of tiles, without what comes by specular ways."""
        return t.direct @ self.state.E + (t.rows.matrix() @ site.subcell) @ self.state.b

    def misfit(self, B, seen, n_pixels, spread=0.0) -> Misfit:
        return misfit(self.problem, self.state.transfer, B, seen, n_pixels, spread)


def _with(finish: Finish, group, kind) -> Finish:
    """The finish with one more specular group."""
    return replace(
        finish,
        groups=(*finish.groups, group),
        kind=np.append(finish.kind, kind),
        alpha=np.vstack([finish.alpha, np.zeros((1, 2))]),
        tangent=np.vstack([finish.tangent, np.zeros((1, 3))]),
    )


def _scaled(metric, B, seen, weight, rounds=8):
    """(C,) s >= 0: the least squares of metric(s B) - metric(seen)."""
    s = np.maximum((weight * B * seen).sum(axis=0) / np.maximum((weight * B * B).sum(axis=0), 1e-300), 1e-6)
    for _ in range(rounds):
        r, slope = metric.value(s * B) - metric.value(seen), metric.slope(s * B) * B
        step = (weight * r * slope).sum(axis=0) / np.maximum((weight * slope**2).sum(axis=0), 1e-300)
        s = np.clip(s - step, s / 3, 3 * s)
    return s


# -- diffuse


def plain(site: Site, light: LightSoFar, tiles: Receivers, whole_rho_s, chains: Chains | None, g) -> Misfit:
    """The group as diffuse with its best rho_d, on the tiles of the audit, or those of mirrors where only they show it.

    tiles : of the last fit;  whole_rho_s, chains : of all specular groups in it
    """
    mine = np.flatnonzero((tiles.group == g) & ~tiles.fit & (tiles.chain == 0))
    if len(mine) < ENOUGH:  # a specular group's tiles are those of its fit: back to the first audit
        first = np.flatnonzero((site.tiles.group == g) & ~site.tiles.fit)
        if len(first) >= ENOUGH:
            tiles, mine = site.tiles, first
        else:
            mine = np.flatnonzero((tiles.group == g) & (tiles.chain > 0))
    t = tiles.take(mine)
    seen = TilePixels(t.values, t.start, light.problem.noisy).linear(light.metric.transfer)[0]
    irradiance, spread = light.irradiance(site, t), 0.0
    if chains is not None:
        more, spread = irradiance_past(site, light.finish, light.rho_s, light.state, t)
        power = chains.power(whole_rho_s)[t.chain]
        irradiance, spread = power * (irradiance + more), power * spread
    s = _scaled(light.metric, irradiance, seen, t.n_pixels[:, None] * np.ones(site.channels))
    B = s * irradiance
    return light.misfit(B, seen, t.n_pixels, light.metric.slope(B) * s * spread)


# -- mirrors


def as_mirror(site: Site, light: LightSoFar, g, diffuse: Misfit, textured=()):
    """Trials of group g as a perfect and as a coloured mirror, or [] where its picture cannot be judged.

    A mirror is tried by what its virtual viewpoint shows, under the light found so far. Groups that only this mirror
    shows are free: one factor each.
    """
    wider = _with(light.finish, g, MIRROR)
    chains = Chains(len(wider))
    t = _mirror_tiles(site, light, wider, chains, g, textured)
    if t is None:
        return []
    seen = TilePixels(t.values, t.start, light.problem.noisy).linear(light.metric.transfer)[0]
    C = site.channels
    irradiance = light.irradiance(site, t) + _by_mirrored_lamps(site, light, wider, chains, t)
    power = chains.power(np.vstack([light.rho_s, np.ones((1, C))]))[t.chain]
    weight = t.n_pixels[:, None] * np.ones(C)
    rho = light.state.rho.copy()
    rho[g] = 0  # seen in another mirror in this one: as that one would be
    known = np.isin(t.group, np.setdiff1d(light.problem.tile_group, [g]))

    def tinted(s):
        """The picture of a mirror of this rho_s; what it alone shows has the reflectance that suits it best."""
        fitted = rho.copy()
        for other in np.unique(t.group[~known & (t.group != g)]):
            mine = t.group == other
            best = _scaled(light.metric, (s * power * irradiance)[mine], seen[mine], weight[mine])
            fitted[other] = np.clip(best, 0, 1)
        return s * power * fitted[t.group] * irradiance

    one = np.ones(C)
    trials = [Trial("mirror", g, light.misfit(tinted(one), seen, t.n_pixels), diffuse, np.zeros(C), one)]
    if known.any():  # else rho_s and what it shows cannot be told apart
        B = (power * rho[t.group] * irradiance)[known]
        s = np.clip(_scaled(light.metric, B, seen[known], weight[known]), 0, 1)
        trials.append(Trial("coloured_mirror", g, light.misfit(tinted(s), seen, t.n_pixels), diffuse, np.zeros(C), s))
    return trials


def _mirror_tiles(site, light, wider, chains, g, textured) -> Receivers | None:
    """Tiles of what group g would show as a mirror, at once and in known mirrors; None where they are too few."""
    pixel = np.concatenate([site.pixels_of([g]), _in_known_mirrors(site, light.finish, g)[0]])
    shown, pure = site.in_mirrors(wider, chains, pixel)
    good = np.flatnonzero(pure & ~site.is_lamp[shown.facet])
    # a texture's pattern would count as the mirror's error
    sure = good[~np.isin(site.surface.group[shown.facet[good]], textured)]
    for some in (sure, good):
        none = np.full(len(some), -1, np.int32)
        t = site.new_tiles(pixel[some], shown.of(some), none, rays=128, seed=131, **PLAIN) if len(some) else ()
        if len(t) >= ENOUGH:
            return t
        if len(some) == len(good):
            return None


def _by_mirrored_lamps(site, light, wider, chains, t):
    """(T, C) light that the mirror would send by itself to what it also shows; 0 where it mirrors no lamp."""
    mirrored, way, _ = specular_lamps.mirrored_lamps(site.surface, wider, chains, site.lamps, depth=2)
    if not mirrored:
        return 0
    power = chains.power(np.vstack([light.rho_s, np.ones((1, site.channels))]))
    one = [replace(lamp, lamp=k) for k, lamp in enumerate(mirrored)]
    start, some = few(t.start, 16)
    factor = lamps.direct(site.surface, one, t.p[some], site.normals, t.side[some], len(one), n_samples=4, start=start)
    return factor @ np.array([light.state.E[lamp.lamp] * power[k] for lamp, k in zip(mirrored, way, strict=True)])


def _in_known_mirrors(site: Site, finish: Finish, g):
    """The pure pixels (n,) that show group g in known mirrors, what they show, and the chains of its ways."""
    mirrors = [m for m, k in zip(finish.groups, finish.kind, strict=True) if k == MIRROR]
    pixel = site.pixels_of(mirrors) if mirrors else np.zeros(0, int)
    chains = Chains(len(finish))
    if not len(pixel):
        return pixel, None, chains
    shown, pure = site.in_mirrors(finish, chains, pixel)
    keep = np.flatnonzero(pure & (site.surface.group[shown.facet] == g))
    return pixel[keep], shown.of(keep), chains


# -- lobes


class LobeFit(NamedTuple):
    """The best non-negative combination of diffuse and lobe. chi2 : weighted sum of squares;  rho_d, rho_s : (C,)"""

    misfit: Misfit
    chi2: float
    rho_d: np.ndarray
    rho_s: np.ndarray


class Lobe:
    """A group's tiles, ready to be compared with lobes of any shape.

    `fit(alpha, tangent)` adjusts rho_d and rho_s alone.

    tiles : None where the group is seen by too few
    """

    def __init__(self, site: Site, light: LightSoFar, g):
        self.site, self.light, self.tiles, self.known = site, light, None, None
        self.wider = _with(light.finish, g, GLOSSY)
        self.rho_s = np.vstack([light.rho_s, np.ones((1, site.channels))])
        power = np.ones((1, site.channels))
        pixel = site.pure_pixels_of([g])
        t = self._tiles(pixel, site.at_once(pixel))
        if len(t) < ENOUGH:  # what only mirrors show
            pixel, shown, self.known = _in_known_mirrors(site, light.finish, g)
            t = self._tiles(pixel, shown)
            if len(t) < ENOUGH:
                return
            power = self.known.power(light.rho_s)
        if len(t) > LOBE_TILES:
            t = t.take(np.unique(np.linspace(0, len(t) - 1, LOBE_TILES).astype(int)))
        self.tiles = t
        self.seen = TilePixels(t.values, t.start, light.problem.noisy).linear(light.metric.transfer)[0]
        more, spread = irradiance_past(site, light.finish, light.rho_s, light.state, t)
        self.irradiance = (light.irradiance(site, t) + more) * power[t.chain]
        self.spread = spread * power[t.chain]
        noise = light.problem.noise_variance(t.n_pixels) + 0.004**2
        self.weight = light.metric.slope(self.seen) ** 2 / noise
        self.diffuse = self._best(np.zeros_like(self.irradiance)).misfit

    def _tiles(self, pixel, shown):
        """Of pixels (n,) that show the lobe. shown : what they show"""
        lobe = np.full(len(pixel), len(self.light.finish), np.int32)
        options = {"rays": 256, "seed": 141, "per_facet": 400, **SHEEN}
        return self.site.new_tiles(pixel, shown, lobe, **options) if len(pixel) else ()

    def fit(self, alpha, tangent, rays=RAYS) -> LobeFit:
        """With a lobe of this shape; tangent None: isotropic;  rays : of each tile"""
        tangent = np.zeros(3) if tangent is None else tangent
        wider = replace(
            self.wider,
            alpha=np.vstack([self.wider.alpha[:-1], np.atleast_2d(alpha)]),
            tangent=np.vstack([self.wider.tangent[:-1], np.atleast_2d(tangent)]),
        )
        chains, tiles = Chains(len(wider)), self.tiles
        if self.known is not None:  # the ways by which mirrors show it, in the numbers of one group more
            number = np.array([chains.number((*count, 0)) for count in self.known.count], np.int32)
            tiles = replace(tiles, chain=number[tiles.chain])
        rows = lobes(self.site, wider, chains, tiles, rays=rays)
        state = self.light.state
        return self._best(np.zeros_like(self.irradiance) + chains.total(self.rho_s, rows.F, rows.D, state.b, state.E))

    def _best(self, lobe) -> LobeFit:
        C = self.irradiance.shape[1]
        rho_d, rho_s = np.zeros(C), np.zeros(C)
        for c in range(C):
            rho_d[c], rho_s[c] = _two(self.irradiance[:, c], lobe[:, c], self.seen[:, c], self.weight[:, c])
        B = rho_d * self.irradiance + rho_s * lobe
        chi2 = float((self.weight * (B - self.seen) ** 2).sum())
        spread = self.light.metric.slope(B) * rho_d * self.spread
        return LobeFit(self.light.misfit(B, self.seen, self.tiles.n_pixels, spread), chi2, rho_d, rho_s)


def _two(x, y, wanted, weight):
    """a, b in [0, 1] of the least squares of a x + b y."""
    xx, xy, yy = (weight * x * x).sum(), (weight * x * y).sum(), (weight * y * y).sum()
    xz, yz = (weight * x * wanted).sum(), (weight * y * wanted).sum()
    det = xx * yy - xy * xy
    if det > 1e-9 * xx * yy:
        a, b = (yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det
        if a >= 0 and b >= 0:
            return min(a, 1.0), min(b, 1.0)
        if a < 0 and yy > 0:
            return 0.0, float(np.clip(yz / yy, 0, 1))
    return float(np.clip(xz / max(xx, 1e-300), 0, 1)), 0.0


def as_glossy(site: Site, light: LightSoFar, g, threshold, kept=0.0, sharp=False):
    """Trials of group g as an isotropic and as an anisotropic lobe; [] where its picture cannot be judged.

    kept : of Trial;  sharp : it shows a patch with a sharp outline, which only a sharp lobe explains
    """
    lobe = Lobe(site, light, g)
    if lobe.tiles is None:
        return []
    search = _ShapeSearch(site, lobe, g, kept)
    rough = search.roughly()
    if rough.explained < LEAST_EXPLAINED / 2:
        return [rough]
    if sharp and rough.alpha[0] > DULL:
        return []
    isotropic = search.isotropic(rough.alpha[0])
    if isotropic.misfit.excess <= threshold or isotropic.explained < LEAST_EXPLAINED:
        return [isotropic]  # what no round lobe explains in the least, no long one will
    return [isotropic, search.anisotropic(isotropic.alpha[0])]


class _ShapeSearch:
    """The shape of a group's lobe by chi2; every shape is traced once.

    Few rays find the way: they tell 0.60 to 0.96 of a lobe's error from at most 0.03 where there is none. What is
    tried in the end is traced by more.
    """

    def __init__(self, site, lobe, g, kept):
        self.lobe, self.group, self.kept, self.found = lobe, g, kept, {}
        facet = site.main_facet(g)
        self.normal, (self.x, self.y) = site.surface.normal[facet], site.surface.axes[facet]

    def at(self, alpha, tangent=None, rays=RAYS) -> LobeFit:
        alpha = np.clip(alpha, LOWEST, HIGHEST)
        key = (rays, *np.round(np.log(alpha), 6), *(() if tangent is None else np.round(tangent, 6)))
        if key not in self.found:
            self.found[key] = self.lobe.fit(alpha, tangent, rays)
        return self.found[key]

    def trial(self, alphas, tangent=None, rays=RAYS) -> Trial:
        found, rung = self.at(alphas, tangent, rays), "glossy" if tangent is None else "anisotropic"
        shape = (np.array(alphas),) if tangent is None else (alphas, tangent)
        return Trial(
            rung, self.group, found.misfit, self.lobe.diffuse, found.rho_d, found.rho_s, *shape, kept=self.kept
        )

    def roughly(self) -> Trial:
        """The best of ALPHAS, by few rays."""
        alpha = min(ALPHAS, key=lambda a: self.at((a, a), None, FEW_RAYS).chi2)
        return self.trial((alpha, alpha), None, FEW_RAYS)

    def turned(self, angle):
        """The tangent turned about the normal of the group's largest facet."""
        return np.cos(angle) * self.x + np.sin(angle) * self.y

    def isotropic(self, rough) -> Trial:
        """Bounded minimisation around a rough alpha, one of ALPHAS."""
        from scipy.optimize import minimize_scalar

        k = ALPHAS.index(rough)
        low, high = (*ALPHAS, HIGHEST)[k - 1] if k else LOWEST, (*ALPHAS, HIGHEST)[k + 1]
        chi2 = lambda a: self.at((a, a)).chi2
        best = minimize_scalar(
            lambda x: chi2(np.exp(x)), bounds=(np.log(low), np.log(high)), method="bounded", options={"maxiter": 7}
        )
        alpha = min(float(np.exp(best.x)), rough, key=chi2)
        return self.trial((alpha, alpha))

    def anisotropic(self, alpha) -> Trial:
        """From the best isotropic alpha to two, the larger first, with the larger one's tangent."""
        from scipy.optimize import minimize

        chi2 = lambda alphas, angle: self.at(alphas, self.turned(angle), FEW_RAYS).chi2
        angle = min(np.pi * np.arange(TURNS) / TURNS, key=lambda a: chi2((1.7 * alpha, alpha / 1.7), a))
        start = np.array([np.log(1.7 * alpha), np.log(alpha / 1.7), angle])
        simplex = np.vstack([start, start + [0.4, 0, 0], start + [0, 0.4, 0], start + [0, 0, 0.25]])
        best = minimize(
            lambda v: chi2(np.exp(v[:2]), v[2]),
            start,
            method="Nelder-Mead",
            options={"maxfev": 45, "initial_simplex": simplex},
        )
        alphas, tangent = np.clip(np.exp(best.x[:2]), LOWEST, HIGHEST), self.turned(best.x[2])
        if alphas[0] < alphas[1]:
            alphas, tangent = alphas[::-1], np.cross(self.normal, tangent)
        return self.trial(alphas, tangent)
