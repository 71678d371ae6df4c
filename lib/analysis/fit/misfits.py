"""How far groups are from the photograph beyond noise and sampling: the question at each step of the ladder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.analysis.fit.problem import Problem, Result, group_mean, observe
from lib.analysis.seen.receivers import Receivers, Ways
from lib.analysis.seen.tile_pixels import TilePixels
from lib.given.transfer import Metric, Transfer

ENOUGH = 12  # tiles of a group without which it is not judged
CHANCE = 3.0  # standard errors of a mean square, up to which noise and sampling explain it
OTHER = 0.1  # relative difference of an object's reflectance from its group's that is worth a word
UNLIKE = 0.25  # the same of an object that only its untrusted pixels tell of
# Of what a texture is off by as one colour, that objects of one colour each explain: more, and they are several
# materials. One room had .97; textures of one object have none.
BY_OBJECTS = 0.5
THRESHOLD = 0.0125  # display RMSE beyond noise that a rung may leave: about what shadows' edges leave of diffuse groups
# what of the threshold a group may keep, by its share of the picture: up to .8 % of it shadows' edges may cover all,
# and beyond they cover less of it the wider it is, down to what light is known to anywhere
SMALL, LARGE = 0.00814, 0.45
LEAST = LARGE * THRESHOLD  # that a group is off by which stands out
APART, APART_LEAST = 3.0, 0.0025  # the same of trusted tiles: exact rooms have up to 2.4, one of 30 more
STANDS_OUT = 5.0  # times what groups usually are off by: exact rooms have up to 4.6, once 7


@dataclass(frozen=True)
class Misfit:
    """How far tiles are from the photograph, in display values.

    excess : rms beyond noise and its chance;  rms, noise;  tiles : how many;  share : of the picture, that they cover
    """

    excess: float
    rms: float
    noise: float
    tiles: int
    share: float

    @property
    def judged(self):
        return self.tiles >= ENOUGH

    @property
    def energy(self):
        """What the whole group is off by: squares summed over its share of the picture."""
        return self.excess**2 * self.share


def misfit(problem: Problem, transfer: Transfer, B, seen, n_pixels, spread=0.0) -> Misfit:
    """B, seen : (t, C) linear;  n_pixels : (t,);  spread : (t, C) display, of B's own sampling"""
    metric = Metric(transfer)
    residual = metric.value(B) - metric.value(seen)
    w = n_pixels / max(n_pixels.sum(), 1)
    square = float((w[:, None] * residual**2).sum() / residual.shape[1])
    each = problem.noise_variance(n_pixels) + np.broadcast_to(np.asarray(spread) ** 2, residual.shape)
    variance = float((w[:, None] * each).sum() / residual.shape[1])
    chance = 1 + CHANCE * np.sqrt(2 / max(residual.size, 1))  # a mean square of n errors has 2 / n of its own square
    excess = float(np.sqrt(max(square - chance * variance, 0)))
    share = problem.share(n_pixels.sum())
    return Misfit(excess, float(np.sqrt(square)), float(np.sqrt(variance)), len(n_pixels), float(share))


def audit(
    subcell, problem: Problem, result: Result, tiles: Receivers, traced: Ways | None = None, textured=(), among=None
):
    """{group: Misfit} of every group that is seen, and of textured ones as if they were of one reflectance.

    Groups are judged by all their pixels, specular ones by the tiles of their fit, textured ones by their flattest.

    traced : light by specular ways;  among : (T,) bool, the tiles that count, or None
    """
    among = np.ones(len(tiles), bool) if among is None else among
    shown = _Shown(subcell, problem, result, tiles, traced)
    specular = () if problem.specular is None else problem.specular.groups
    found = {g: shown.misfit(g, fit=False, among=among) for g in map(int, np.unique(tiles.group)) if g not in specular}
    patterns = {int(g): shown.misfit(g, fit=True, among=among) for g in textured if g not in specular}
    if problem.specular is not None:
        found |= _specular_misfits(problem, result, tiles, textured)
    return ({g: m for g, m in part.items() if m is not None} for part in (found, patterns))


def shown(subcell, problem: Problem, result: Result, tiles: Receivers):
    """(T, C) linear: the tiles as the diffuse surfaces of a fit show them."""
    return _Shown(subcell, problem, result, tiles, None).B


class _Shown:
    """The tiles as diffuse surfaces of the fit show them: B, seen (T, C) linear, spread (T, C) display."""

    def __init__(self, subcell, problem, result, tiles, traced):
        self.problem, self.tiles, state = problem, tiles, result.state
        self.transfer = state.transfer
        metric = Metric(state.transfer)
        rows, terms = tiles.rows, problem.specular
        self.seen = TilePixels(tiles.values, tiles.start, problem.noisy).linear(metric.transfer)[0]
        G = (rows.matrix() @ subcell).tocsr()
        half = 0.5 * (((rows.matrix(0) - rows.matrix(1)) @ subcell) @ state.b)
        irradiance = tiles.direct @ state.E + G @ state.b
        power = np.ones((len(tiles), 1))
        if terms is not None:
            total = terms.chains.total
            irradiance = irradiance + total(state.rho_s, traced.G, traced.D, state.b, state.E)
            half = np.hypot(half, total(state.rho_s, traced.G_spread, traced.D_spread, state.b, state.E))
            power = terms.chains.power(state.rho_s)[tiles.chain]
        rho = power * state.rho[tiles.group]
        self.B = rho * irradiance
        self.spread = metric.slope(self.B) * np.abs(rho * half)

    def misfit(self, g, fit, among) -> Misfit | None:
        """Of the group's tiles that are seen at once, or in mirrors where those are too few; None where there are none.

        fit : by the tiles of the fit, or by those of the audit
        """
        t = self.tiles
        at_once = np.flatnonzero(among & (t.group == g) & (t.fit == fit) & (t.chain == 0))
        mirrored = np.flatnonzero(among & (t.group == g) & (t.chain > 0))
        mine = mirrored if len(at_once) < ENOUGH <= len(mirrored) else at_once
        if not len(mine):
            return None
        return misfit(self.problem, self.transfer, self.B[mine], self.seen[mine], t.n_pixels[mine], self.spread[mine])


def _specular_misfits(problem, result, tiles, textured):
    """{group: Misfit} of mirrors and glossy groups, by the tiles that show their lobes, or what they mirror."""
    terms, state = problem.specular, result.state
    t = tiles.take(np.flatnonzero(tiles.fit))
    target = observe(problem, state.transfer)[0]
    met = terms.chains.counts[t.chain] > 0
    found = {}
    for m, g in enumerate(terms.groups):
        through = met[:, m] & (t.lobe < 0) & ~np.isin(t.group, textured)
        mine = np.flatnonzero((t.lobe == m) & (t.chain == 0) if (t.lobe == m).any() else through)
        if len(mine):
            found[int(g)] = misfit(problem, state.transfer, state.B[mine], target[mine], t.n_pixels[mine])
    return found


@dataclass(frozen=True)
class Parts:
    """How the objects of one group differ from what its reflectance shows.

    ratio : {object: (C,)} of their own reflectances to the group's;  explained : share of the error that these explain
    """

    ratio: dict
    explained: float

    @property
    def unlike(self) -> dict:
        """Ratios of the objects that have another reflectance, where others have the group's."""
        far = {thing: float(np.abs(r - 1).max()) for thing, r in self.ratio.items()}
        usual = any(d < OTHER for d in far.values())
        return {thing: r for thing, r in self.ratio.items() if far[thing] > UNLIKE} if usual else {}

    @property
    def painted_apart(self) -> dict:
        """The one most unlike its group, where objects of one colour each explain most of what passes for a texture.

        A texture is within objects. A forgotten `usemtl` in a room with a mirror was green as one.
        """
        far = {thing: float(np.abs(r - 1).max()) for thing, r in self.ratio.items()}
        thing = max(far, key=far.get)
        return {thing: self.ratio[thing]} if self.explained > BY_OBJECTS and far[thing] > UNLIKE else {}


def parts(subcell, problem: Problem, result: Result, tiles: Receivers, groups) -> dict[int, Parts]:
    """{group: Parts} of those of the groups (numbers) that have several objects, by the audit's tiles."""
    at_once = ~tiles.fit & (tiles.chain == 0)
    several = [g for g in groups if len(np.unique(tiles.object[at_once & (tiles.group == g)])) > 1]
    if not several:
        return {}
    seen_as, metric, found = _Shown(subcell, problem, result, tiles, None), Metric(result.state.transfer), {}
    for g in several:
        ratio, before, after = {}, 0.0, 0.0
        for thing in np.unique(tiles.object[at_once & (tiles.group == g)]):
            mine = at_once & (tiles.group == g) & (tiles.object == thing)
            B, seen, n = seen_as.B[mine], seen_as.seen[mine], tiles.n_pixels[mine, None]
            ratio[int(thing)] = own = _own_ratio(B, seen)
            before += float((n * (metric.value(seen) - metric.value(B)) ** 2).sum())
            after += float((n * (metric.value(seen) - metric.value(own * B)) ** 2).sum())
        found[g] = Parts(ratio, 1 - after / max(before, 1e-300))
    return found


def ratio_of(subcell, problem: Problem, result: Result, tiles: Receivers, group) -> np.ndarray:
    """(C,) reflectance of a group (number), as the audit's tiles show it, to the fit's."""
    seen_as = _Shown(subcell, problem, result, tiles, None)
    mine = ~tiles.fit & (tiles.chain == 0) & (tiles.group == group)
    return _own_ratio(seen_as.B[mine], seen_as.seen[mine])


def _own_ratio(B, seen):
    return np.median(seen / np.maximum(B, 1e-9), axis=0)


# -- what follows from a misfit


def energy(found) -> float:
    """What all groups that can be judged are off by. found : {group: Misfit}"""
    return sum(m.energy for m in found.values() if m.judged)


def tolerance(misfit: Misfit, threshold):
    """The error that a group may keep.

    A small group may keep the threshold, since shadows in corners may cover it. They reach into a wider one by an angle
    that does not grow with it, so that what they cover falls as one over its width: its error may be less, down to what
    no light is known better than. How many pixels show the group has no say, but in what noise explains.
    """
    return threshold * float(np.clip(np.sqrt(SMALL / max(misfit.share, 1e-12)), LARGE, 1))


def keener(found, threshold, times=STANDS_OUT):
    """A lower threshold where one group is off by less than it may and by far more than the others, or None.

    What a small box mirrors dully may be: one was .008 off beside 0 to .0004, and 34 sigma as a diffuse one.
    found : {group: Misfit};  times : what groups usually are off by, from which one stands out
    """
    judged = [m for m in found.values() if m.judged]
    least = max(LEAST, times * float(np.median([m.excess for m in judged]))) if judged else threshold
    stands_out = any(m.excess > max(tolerance(m, least), LEAST) for m in judged)
    return least if stands_out and least < threshold else None


def apart(problem: Problem, result: Result) -> int | None:
    """The group whose trusted tiles are off by far more than those of others usually are, or None.

    No threshold tells of it: no shadow's edge lies in trusted tiles, and hardly anything of that light is off. So were
    boxes with dull lobes that were 10 to 14 % and up to 22 sigma off as diffuse ones.
    """
    of_group = lambda values: group_mean(problem, values)[:, 0]
    noise = of_group(problem.tile_noise)
    square = of_group((result.tile_residual**2).mean(axis=1, keepdims=True))
    enough = np.bincount(problem.tile_group, minlength=len(problem.groups)) >= ENOUGH
    judged = [g for g in np.flatnonzero(enough) if g not in problem.known_groups]
    if len(judged) < 2:
        return None
    excess = np.sqrt(np.maximum(square - noise, 0))
    g = max(judged, key=lambda g: excess[g])
    usual = float(np.median([excess[h] for h in judged if h != g]))
    return int(g) if excess[g] > max(APART_LEAST, APART * usual) else None


def is_over(misfit: Misfit, threshold):
    """Whether the group is off by more than it may, and enough of it is seen to judge that."""
    return misfit.judged and misfit.excess > tolerance(misfit, threshold)


def flagged(problem: Problem, found, given, threshold) -> list:
    """The groups that a diffuse surface does not explain, and those that are said to be no diffuse ones.

    found : {group: Misfit};  given : {group: kind}
    """
    over = {
        g
        for g, m in found.items()
        if g not in problem.known_groups and is_over(m, threshold) and given.get(g) != "diffuse"
    }
    return sorted(over | {g for g, kind in given.items() if kind != "diffuse"})


def doubt(problem: Problem, result: Result, found, threshold, given, places=None):
    """Widen sigma of diffuse groups that differ from the photograph by more than they may, and say so.

    They are less sure of their reflectance than pixels and rays make them: as if all of that error were one of their
    brightness, or of anything where too few tiles are left to judge them by. Nothing is known of one that a rung
    explained which was taken back: it is no diffuse surface. Writes result.sigma_rho and result.warnings.

    places : {group: Place} of the climb, if there was one
    """
    if result.sigma_rho is None:
        return
    B, seen = (group_mean(problem, values) for values in (result.state.B, np.ones((len(problem.tile_group), 1))))
    slope = Metric(result.state.transfer).slope
    for g, m in sorted(found.items()):
        climbed = places and places[g].rung != "diffuse"
        if (
            g in problem.known_groups
            or climbed
            or m.excess <= tolerance(m, threshold)
            or not np.isfinite(seen[g]).all()
        ):
            continue
        rho = result.state.rho[g]
        said = (
            f"group {problem.groups[g]!r}: the photograph differs by {m.excess:.1%} of full scale beyond noise"
            " from a diffuse surface"
        )
        if m.judged and places and places[g].was_explained:
            wide = np.inf
            result.warnings.append(f"{said}, and what it is instead is not known: {places[g].why}")
        elif m.judged:
            brightness = np.maximum(slope(B[g : g + 1])[0] * B[g], 1e-9)
            wide = np.minimum(m.excess / brightness, 1) * rho
            why = (
                "which scene.yaml says it is"
                if given.get(g) == "diffuse"
                else "and no mirror, lobe or texture explains it"
            )
            result.warnings.append(f"{said}, {why}; its sigma is widened")
        else:
            wide = np.maximum(rho, 0.02)
            left = f"{m.tiles} tile{'s' * (m.tiles != 1)}"
            result.warnings.append(
                f"{said}, and what is left of it ({left}) cannot tell what it is: its reflectance may be anything"
            )
        result.sigma_rho[g] = np.maximum(result.sigma_rho[g], wide)
