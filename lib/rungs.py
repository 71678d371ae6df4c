"""One group on one rung of the ladder: how far it is from the photograph, and what a mirror, a lobe or a texture would explain of that.

All in the light found so far; lib.ladder decides what is taken, and fits everything anew.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lib import form_factors, gather, receivers, reflectance
from lib.receivers import HIGHEST, LOWEST
from lib.transfer import Tiles as Pixels

ENOUGH = 12                  # tiles of a group without which it is not judged
ALPHAS = (0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.32, 0.5)
TURNS = 6                    # directions that the search for an anisotropic lobe begins with


# -- errors

@dataclass(frozen=True)
class Misfit:
    """How far tiles are from the photograph, in display values. excess : rms beyond noise and its chance;  tiles, pixels : how many"""
    excess: float
    rms: float
    noise: float
    tiles: int
    pixels: int

    @property
    def judged(self):
        return self.tiles >= ENOUGH


def misfit(problem, gamma, B, seen, n_pixels, spread=0.0) -> Misfit:
    """B, seen : (t, C) linear;  n_pixels : (t,);  spread : (t, C) display, of B's own sampling"""
    metric = reflectance.metric_of(problem, gamma)
    residual = metric.value(B) - metric.value(seen)
    w = n_pixels / max(n_pixels.sum(), 1)
    square = float((w[:, None] * residual ** 2).sum() / residual.shape[1])
    variance = float((w[:, None] * (problem.pixel_noise ** 2 / n_pixels[:, None] + np.broadcast_to(np.asarray(spread) ** 2, residual.shape))).sum() / residual.shape[1])
    chance = 1 + 3 * np.sqrt(2 / max(residual.size, 1))           # so far three standard errors of a mean square of noise reach
    return Misfit(float(np.sqrt(max(square - chance * variance, 0))), float(np.sqrt(square)), float(np.sqrt(variance)), len(n_pixels), int(n_pixels.sum()))


def audit(subcell, problem, result, tiles, transport=None, textured=()):
    """{group: Misfit} of every group that is seen, all pixels taken together; specular groups are judged by the tiles of their fit,
    textured ones by their flattest. And {group: Misfit} of the textured ones by all their pixels, as if they had one reflectance."""
    state, gamma = result.state, result.state.gamma
    found, patterns = {}, {}
    spec = problem.specular
    rows = tiles.rows
    metric = reflectance.metric_of(problem, gamma)
    seen = Pixels(tiles.values, tiles.start).linear(metric.transfer)[0]
    G = (rows.matrix() @ subcell).tocsr()
    half = 0.5 * (((rows.matrix(0) - rows.matrix(1)) @ subcell) @ state.b)
    irradiance = tiles.direct @ state.E + G @ state.b
    power = np.ones((len(tiles), 1))
    if spec is not None:
        _, _, G_k, D_k, G_spread, D_spread = transport
        irradiance = irradiance + spec.chains.total(state.rho_s, G_k, D_k, state.b, state.E)
        half = np.hypot(half, spec.chains.total(state.rho_s, G_spread, D_spread, state.b, state.E))
        power = spec.chains.power(state.rho_s)[tiles.chain]
    B = power * state.rho[tiles.group] * irradiance
    spread = metric.slope(B) * np.abs(power * state.rho[tiles.group] * half)
    for store, groups, fit in ((found, np.unique(tiles.group), False), (patterns, textured, True)):
        for g in groups:
            if spec is not None and g in spec.groups:
                continue
            at_once = np.flatnonzero((tiles.group == g) & (tiles.fit == fit) & (tiles.chain == 0))
            mirrored = np.flatnonzero((tiles.group == g) & (tiles.chain > 0))
            mine = mirrored if len(at_once) < ENOUGH <= len(mirrored) else at_once
            if len(mine):
                store[int(g)] = misfit(problem, gamma, B[mine], seen[mine], tiles.n_pixels[mine], spread[mine])
    if spec is not None:
        t = tiles.take(np.flatnonzero(tiles.fit))
        target = reflectance.observe(problem, gamma)[0]
        for m, g in enumerate(spec.groups):
            through = (spec.chains.counts[t.chain][:, m] > 0) & (t.lobe < 0) & ~np.isin(t.group, textured)
            mine = np.flatnonzero((t.lobe == m) & (t.chain == 0) if (t.lobe == m).any() else through)
            if len(mine):
                found[int(g)] = misfit(problem, gamma, state.B[mine], target[mine], t.n_pixels[mine])
    return found, patterns


# -- trying a rung in the light found so far

@dataclass(frozen=True)
class Trial:
    """One rung tried for one group. rho_d, rho_s : (C,);  alpha : (2,);  tangent : (3,);  misfit, diffuse : with it and without, on the same tiles"""
    rung: str
    group: int
    misfit: Misfit
    diffuse: Misfit
    rho_d: np.ndarray
    rho_s: np.ndarray
    alpha: np.ndarray = field(default_factory=lambda: np.zeros(2))
    tangent: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def explained(self):
        """Share of the diffuse error's square that this rung takes away."""
        return 1 - (self.misfit.excess / max(self.diffuse.excess, 1e-12)) ** 2


def _scaled(metric, B, seen, weight, rounds=8):
    """(C,) s >= 0: the least squares of metric(s B) - metric(seen)."""
    s = np.maximum((weight * B * seen).sum(axis=0) / np.maximum((weight * B * B).sum(axis=0), 1e-300), 1e-6)
    for _ in range(rounds):
        r, slope = metric.value(s * B) - metric.value(seen), metric.slope(s * B) * B
        s = np.clip(s - (weight * r * slope).sum(axis=0) / np.maximum((weight * slope ** 2).sum(axis=0), 1e-300), s / 3, 3 * s)
    return s


def as_mirror(site, problem, state, finish, rho_s, g, plain, textured=()):
    """Trials of group g as a perfect and as a coloured mirror, or [] where its picture cannot be judged: what the virtual
    viewpoint shows, under the light found so far. Groups that only this mirror shows are free: one factor each."""
    from lib import specular
    M = len(finish)
    wider = replace(finish, groups=(*finish.groups, g), kind=np.append(finish.kind, specular.MIRROR), alpha=np.vstack([finish.alpha, np.zeros((1, 2))]),
                    tangent=np.vstack([finish.tangent, np.zeros((1, 3))]))
    chains = specular.Chains(M + 1)
    pixel = np.concatenate([receivers.pixels_of(site, [g]), _in_mirrors(site, finish, g)[0]])
    view, pure = receivers.shown(site, wider, chains, pixel)
    lamp = np.isin(site.surface.group, [site.surface.groups.index(name) for name in site.factors.lamps])
    good = np.flatnonzero(pure & ~lamp[view.facet])
    sure = good[~np.isin(site.surface.group[view.facet[good]], textured)]         # a texture's pattern would count as the mirror's error
    good = sure if len(sure) >= 200 else good
    if len(good) < 40:
        return []
    t = receivers.new_tiles(site, pixel[good], view.facet[good], view.side[good], view.p[good], view.direction[good], view.chain[good], np.full(len(good), -1, np.int32),
                  rays=128, largest=20, smallest=4, per_facet=24, seed=131)
    if len(t) < ENOUGH:
        return []
    metric = reflectance.metric_of(problem, state.gamma)
    seen = Pixels(t.values, t.start).linear(metric.transfer)[0]
    C = problem.channels
    irradiance = t.direct @ state.E + (t.rows.matrix() @ site.subcell) @ state.b
    mirrored, way, _ = specular.mirrored_lamps(site.surface, wider, chains, site.lamps, depth=2)
    power = chains.power(np.vstack([rho_s, np.ones((1, C))]))
    if mirrored:                                                   # what the mirror would light itself it also shows
        one = [replace(lamp, lamp=k) for k, lamp in enumerate(mirrored)]
        start, some = receivers.few(t.start, 16)
        factor = form_factors.direct(site.surface, one, t.p[some], site.normals, t.side[some], len(one), n_samples=4, start=start)
        irradiance = irradiance + factor @ np.array([state.E[lamp.lamp] * power[k] for lamp, k in zip(mirrored, way)])
    power = power[t.chain]
    weight = t.n_pixels[:, None] * np.ones(C)
    rho = state.rho.copy()
    rho[g] = 0                                                     # seen in another mirror in this one: as that one would be
    known = np.isin(t.group, np.setdiff1d(problem.tile_group, [g]))

    def tinted(s):
        """The picture of a mirror of this rho_s; what it alone shows has the reflectance that suits it best."""
        fitted = rho.copy()
        for other in np.unique(t.group[~known & (t.group != g)]):
            mine = t.group == other
            fitted[other] = np.clip(_scaled(metric, (s * power * irradiance)[mine], seen[mine], weight[mine]), 0, 1)
        return s * power * fitted[t.group] * irradiance

    one = np.ones(C)
    trials = [Trial("mirror", g, misfit(problem, state.gamma, tinted(one), seen, t.n_pixels), plain, np.zeros(C), one)]
    if known.any():                                                # else rho_s and what it shows cannot be told apart
        s = np.clip(_scaled(metric, (power * rho[t.group] * irradiance)[known], seen[known], weight[known]), 0, 1)
        trials.append(Trial("coloured_mirror", g, misfit(problem, state.gamma, tinted(s), seen, t.n_pixels), plain, np.zeros(C), s))
    return trials


def _in_mirrors(site, finish, g):
    """The pixels that show group g in known mirrors (n,), and by which ways, lib.specular.View (of M chains); pure ones only."""
    from lib import specular
    mirrors = [m for m, k in zip(finish.groups, finish.kind) if k == specular.MIRROR]
    pixel = receivers.pixels_of(site, mirrors) if mirrors else np.zeros(0, int)
    chains = specular.Chains(len(finish))
    if not len(pixel):
        return pixel, None, chains
    view, pure = receivers.shown(site, finish, chains, pixel)
    keep = np.flatnonzero(pure & (site.surface.group[view.facet] == g))
    return pixel[keep], specular.View(*(getattr(view, name)[keep] for name in ("facet", "side", "p", "chain", "direction"))), chains


def plain(site, here, g) -> Misfit:
    """The group as diffuse with its best rho_d, on the tiles of the audit, or those of mirrors where only they show it."""
    t = here.tiles
    mine = np.flatnonzero((t.group == g) & ~t.fit & (t.chain == 0))
    if len(mine) < ENOUGH:                                         # a specular group's tiles are those of its fit: back to the first audit
        t = site.base_tiles
        mine = np.flatnonzero((t.group == g) & ~t.fit)
    if len(mine) < ENOUGH:
        t = here.tiles
        mine = np.flatnonzero((t.group == g) & (t.chain > 0))
    t, state = t.take(mine), here.result.state
    metric = reflectance.metric_of(here.problem, state.gamma)
    seen = Pixels(t.values, t.start).linear(metric.transfer)[0]
    irradiance, spread = t.direct @ state.E + (t.rows.matrix() @ site.subcell) @ state.b, 0.0
    if here.finish is not None:
        keep = [m for m, other in enumerate(here.finish.groups) if other != g]
        more, spread = receivers.by_ways(site, here.finish.only(keep), state.rho_s[keep], state, t)
        power = here.problem.specular.chains.power(state.rho_s)[t.chain]
        irradiance, spread = power * (irradiance + more), power * spread
    s = _scaled(metric, irradiance, seen, t.n_pixels[:, None] * np.ones(here.problem.channels))
    B = s * irradiance
    return misfit(here.problem, state.gamma, B, seen, t.n_pixels, metric.slope(B) * s * spread)


class Lobe:
    """A group's pixels, ready to be compared with lobes of any shape: `fit(alpha, tangent)` adjusts rho_d and rho_s alone."""

    def __init__(self, site, problem, state, finish, rho_s, g, most=260):
        from lib import specular
        self.site, self.problem, self.state, self.g = site, problem, state, g
        M = len(finish)
        self.wider = replace(finish, groups=(*finish.groups, g), kind=np.append(finish.kind, specular.GLOSSY), alpha=np.vstack([finish.alpha, np.zeros((1, 2))]),
                             tangent=np.vstack([finish.tangent, np.zeros((1, 3))]))
        self.rho_s = np.vstack([rho_s, np.ones((1, problem.channels))])
        H, W = site.facet.shape
        pixel = np.flatnonzero(site.pure.reshape(-1) & (site.surface.group[np.maximum(site.facet.reshape(-1), 0)] == g))
        self.tiles = None
        f = site.facet.reshape(-1)[pixel].astype(np.int32)
        p, side = gather.backproject(site.surface, site.camera, f, pixel)
        self.power, self.known = np.ones((1, problem.channels)), None
        direction, chain = receivers.directions(site.camera, pixel), np.zeros(len(pixel), np.int32)
        if len(pixel) < 20:                                        # what only mirrors show
            pixel, view, chains = _in_mirrors(site, finish, g)
            if len(pixel) < 20:
                return
            f, side, p, direction, chain = view.facet, view.side, view.p, view.direction, view.chain
            self.power, self.known = chains.power(rho_s), chains
        t = receivers.new_tiles(site, pixel, f, side, p, direction, chain, np.full(len(pixel), M, np.int32),
                      rays=256, largest=12, smallest=3, per_facet=400, seed=141)
        if len(t) < ENOUGH:
            return
        self.metric = reflectance.metric_of(problem, state.gamma)
        if len(t) > most:
            t = t.take(np.unique(np.linspace(0, len(t) - 1, most).astype(int)))
        self.tiles, self.n = t, t.n_pixels
        self.seen = Pixels(t.values, t.start).linear(self.metric.transfer)[0]
        more, spread = receivers.by_ways(site, finish, rho_s, state, t)
        self.irradiance = (t.direct @ state.E + (t.rows.matrix() @ site.subcell) @ state.b + more) * self.power[t.chain]
        self.spread = spread * self.power[t.chain]
        self.weight = self.metric.slope(self.seen) ** 2 / (problem.pixel_noise ** 2 / self.n[:, None] + 0.004 ** 2)
        self.plain = self.fit(None)[0]

    def fit(self, alpha, tangent=None):
        """Misfit, chi2, rho_d, rho_s of the best non-negative combination; alpha None: diffuse."""
        from lib import specular
        if alpha is None:
            lobe = np.zeros_like(self.irradiance)
        else:
            wider = replace(self.wider, alpha=np.vstack([self.wider.alpha[:-1], np.atleast_2d(alpha)]),
                            tangent=np.vstack([self.wider.tangent[:-1], np.zeros((1, 3)) if tangent is None else np.atleast_2d(tangent)]))
            chains = specular.Chains(len(wider))
            tiles = self.tiles
            if self.known is not None:                             # the ways by which mirrors show it, in the numbers of one group more
                number = np.array([chains.number((*count, 0)) for count in self.known.count], np.int32)
                tiles = replace(tiles, chain=number[tiles.chain])
            rows = receivers.lobes(self.site, wider, chains, tiles, rays=128)
            lobe = np.zeros_like(self.irradiance) + chains.total(self.rho_s, rows.F, rows.D, self.state.b, self.state.E)
        C = self.irradiance.shape[1]
        rho_d, rho_s = np.zeros(C), np.zeros(C)
        for c in range(C):
            rho_d[c], rho_s[c] = _two(self.irradiance[:, c], lobe[:, c], self.seen[:, c], self.weight[:, c])
        B = rho_d * self.irradiance + rho_s * lobe
        chi2 = float((self.weight * (B - self.seen) ** 2).sum())
        return misfit(self.problem, self.state.gamma, B, self.seen, self.n, self.metric.slope(B) * rho_d * self.spread), chi2, rho_d, rho_s


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


def as_glossy(site, problem, state, finish, rho_s, g, threshold):
    """Trials of group g as an isotropic and as an anisotropic lobe."""
    from scipy.optimize import minimize, minimize_scalar
    lobe = Lobe(site, problem, state, finish, rho_s, g)
    if lobe.tiles is None:
        return []
    cost = {}

    def at(alpha, tangent=None):
        key = (*np.round(np.log(np.clip(alpha, LOWEST, HIGHEST)), 6), *(() if tangent is None else np.round(tangent, 6)))
        if key not in cost:
            cost[key] = lobe.fit(np.clip(alpha, LOWEST, HIGHEST), tangent)
        return cost[key]

    values = [at((a, a))[1] for a in ALPHAS]
    k = int(np.argmin(values))
    low, high = ALPHAS[max(k - 1, 0)], ALPHAS[min(k + 1, len(ALPHAS) - 1)]
    best = minimize_scalar(lambda x: at((np.exp(x),) * 2)[1], bounds=(np.log(low if k else LOWEST), np.log(high if k < len(ALPHAS) - 1 else HIGHEST)),
                           method="bounded", options={"maxiter": 7})
    a = float(np.exp(best.x)) if best.fun < values[k] else ALPHAS[k]
    fit, chi2, rho_d, s = at((a, a))
    trials = [Trial("glossy", g, fit, lobe.plain, rho_d, s, np.array([a, a]))]
    if fit.excess <= threshold or trials[0].explained < 0.2:       # what no round lobe explains in the least, no long one will
        return trials
    normal = receivers.main_normal(site.surface, g)
    x = site.surface.axes[np.flatnonzero(site.surface.group == g)[0], 0]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    turned = lambda angle: np.cos(angle) * x + np.sin(angle) * np.cross(normal, x)
    starts = [(at((1.7 * a, a / 1.7), turned(angle))[1], angle) for angle in np.pi * np.arange(TURNS) / TURNS]
    _, angle = min(starts)
    start = np.array([np.log(1.7 * a), np.log(a / 1.7), angle])
    simplex = np.vstack([start, start + [0.4, 0, 0], start + [0, 0.4, 0], start + [0, 0, 0.25]])
    best = minimize(lambda v: at(np.exp(v[:2]), turned(v[2]))[1], start, method="Nelder-Mead", options={"maxfev": 45, "initial_simplex": simplex})
    alpha, tangent = np.clip(np.exp(best.x[:2]), LOWEST, HIGHEST), turned(best.x[2])
    fit, chi2_long, rho_d, s = at(alpha, tangent)
    if alpha[0] < alpha[1]:
        alpha, tangent = alpha[::-1], np.cross(normal, tangent)
    trials.append(Trial("anisotropic", g, fit, lobe.plain, rho_d, s, alpha, tangent))
    return trials


# -- textures

def albedo_maps(site, climb) -> dict:
    """{group: {facet: lib.textures.Texture}} of the textured groups: the photograph over the light of each pixel."""
    import contextlib
    from lib import illumination, rendering, textures
    groups = [g for g, p in climb.places.items() if p.rung == "textured"]
    if not groups:
        return {}
    surface, state = site.surface, climb.result.state
    lamp_groups = np.array([surface.groups.index(name) for name in site.factors.lamps], int)
    lit = rendering.lighting(surface, site.factors, climb.finish, state.rho_s, state.rho, state.E, lamp_groups, lambda label: contextlib.nullcontext())
    facet = np.where(np.isin(surface.group[np.maximum(site.facet, 0)], groups), site.facet, -1)
    seen = illumination.pixels(surface, site.camera, facet)
    factor, _ = illumination.direct(surface, lit.lamps, len(lit.E), seen, site.camera)
    direct = factor @ lit.E
    leaves = illumination.gather(surface, lit.shown, lit.lamps, lit.E, seen, direct)
    C = site.base.channels
    irradiance = np.zeros((*facet.shape, C))
    irradiance[seen.y, seen.x] = direct + illumination.interpolated(leaves, seen)
    metric = reflectance.metric_of(climb.problem, state.gamma)
    linear = metric.transfer.linear(site.photograph.values)
    level = np.median(linear[facet >= 0], axis=0) if (facet >= 0).any() else np.ones(C)
    noise = float(np.mean(climb.problem.pixel_noise / metric.slope(level)))       # one for all: noise by pixel would weigh dark ones more
    found = {}
    for g in groups:
        wanted = [int(f) for f in np.unique(facet[facet >= 0]) if surface.group[f] == g]
        usable = site.pure & np.isin(facet, wanted)
        found[g] = textures.albedo_maps(surface, site.camera, facet, usable, linear, irradiance, noise, state.rho[g], wanted)
        mine = np.flatnonzero(usable[seen.y, seen.x])
        if len(mine):                                              # what is left of the error with the texture
            y, x = seen.y[mine], seen.x[mine]
            B = np.zeros((len(mine), C))
            for f, texture in found[g].items():
                at = np.flatnonzero(seen.facet[mine] == f)
                B[at] = textures.lookup(texture, surface, seen.p[mine[at]]) * irradiance[y[at], x[at]]
            climb.misfits[g] = misfit(climb.problem, state.gamma, B, linear[y, x], np.ones(len(mine)))
    site.note("textured pixels", len(seen))
    return found


def write_textures(site, climb, folder) -> dict:
    """{group: lib.materials.Textured} of the textured groups that a pixel shows, their maps written to folder/textures."""
    from lib import materials, mesh, textures
    written = {}
    for g, maps in albedo_maps(site, climb).items():
        if not maps:                                               # said to be textured, and no pixel shows it
            continue
        (folder / "textures").mkdir(exist_ok=True)
        area = mesh.facet_areas(site.surface)[list(maps)]
        names = {str(f): f"textures/{Path(textures.write(folder / 'textures', texture)).name}" for f, texture in maps.items()}
        written[g] = materials.Textured(names, sum(a * textures.mean(texture) for a, texture in zip(area, maps.values())) / area.sum())
    return written
