"""The reflectance ladder (section 4.5): each group climbs only as far as its error demands.

    diffuse -> perfect mirror -> coloured mirror -> glossy (Ward) -> anisotropic -> textured

`climb` starts from the fit in which everything is diffuse and asks, group by group, whether the photograph agrees with it
to the threshold or the noise. Of the groups that do not, each is tried on the next rungs in the light found so far: as a
mirror by what its virtual viewpoint shows, as a glossy surface by the light in its lobe. The group whose error a rung
explains best climbs; then everything is fitted anew, all reflectances, lobes, lamps and gamma together, with the light
that now goes by way of that surface, and the question is asked again: a bright patch on the floor was perhaps only the
mirror's. What no rung explains is a texture.

A rung must be worth its parameters: among those that explain about equally well the lowest is taken, and one that leaves
half of the error beyond noise and its chance is not taken at all: noise never makes a wall glossy.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lib import receivers, reflectance, rungs

RUNGS = ("diffuse", "mirror", "coloured_mirror", "glossy", "anisotropic", "textured")
THRESHOLD = 0.0125           # display RMSE beyond noise that a rung may leave: about what shadows' edges leave of diffuse groups
SHARP = 0.2                  # alphas below which a lobe resolves the light within patches


@dataclass
class Place:
    """Where a group stands. rung : of RUNGS;  why : for the report;  tried : [{rung, excess}] at the step that led here"""
    rung: str = "diffuse"
    rho_d: np.ndarray = None
    rho_s: np.ndarray = None
    alpha: np.ndarray = field(default_factory=lambda: np.zeros(2))
    tangent: np.ndarray = field(default_factory=lambda: np.zeros(3))
    why: str = ""
    tried: list = field(default_factory=list)
    given: bool = False


@dataclass
class Climb:
    """The end of a climb. places : {group: Place};  misfits : {group: Misfit};  sigma_shape : {group: {shape: sigma}}
    patterns : {group: Misfit} of textured groups, as if they were of one colour"""
    problem: reflectance.Problem
    result: reflectance.Result
    scale: str
    places: dict
    misfits: dict
    diffuse: dict
    finish: object
    tiles: receivers.Receivers
    rounds: int = 0
    sigma_shape: dict = field(default_factory=dict)
    patterns: dict = field(default_factory=dict)


def tolerance(misfit, threshold):
    """The error that a group may keep: the threshold of a small group, which shadows in corners may cover, and down to less than half of
    it for a group of many pixels, where they do not."""
    return threshold * float(np.clip(np.sqrt(2500 / max(misfit.pixels, 1)), 0.45, 1))


def flagged(problem, misfits, given, threshold) -> list:
    """The groups that a diffuse surface does not explain, and those that are said to be no diffuse ones."""
    known = {g for g in range(len(problem.groups)) if not np.isnan(problem.rho[g]).any()}
    return sorted({g for g, m in misfits.items() if g not in known and m.judged and m.excess > tolerance(m, threshold) and given.get(g) != "diffuse"}
                  | {g for g, kind in given.items() if kind != "diffuse"})


def doubt(problem, result, misfits, threshold, given, places=None):
    """Diffuse groups that differ from the photograph by more than they may are less sure of their reflectance than pixels and rays
    make them: as if all of that error were one of their brightness, or of anything where too few tiles are left to judge
    them by. Widens result.sigma_rho and says so in result.warnings."""
    known = {g for g in range(len(problem.groups)) if not np.isnan(problem.rho[g]).any()}
    B, seen = (reflectance.group_mean(problem, values) for values in (result.state.B, np.ones((len(problem.tile_group), 1))))
    for g, m in sorted(misfits.items()):
        if g in known or result.sigma_rho is None or not m.excess > tolerance(m, threshold) or not np.isfinite(seen[g]).all() or places and places[g].rung != "diffuse":
            continue
        rho, said = result.state.rho[g], f"group {problem.groups[g]!r}: the photograph differs by {m.excess:.1%} of full scale beyond noise from a diffuse surface"
        if m.judged:
            slope = reflectance.metric_of(problem, result.state.gamma).slope(B[g:g + 1])[0]
            wide = np.minimum(m.excess / np.maximum(slope * B[g], 1e-9), 1) * rho
            why = "which scene.yaml says it is" if given.get(g) == "diffuse" else "and no rung explains it"
            result.warnings.append(f"{said}, {why}; its sigma is widened")
        else:
            wide = np.maximum(rho, 0.02)
            result.warnings.append(f"{said}, and what is left of it ({m.tiles} tile{'s' * (m.tiles != 1)}) cannot tell what it is: its reflectance may be anything")
        result.sigma_rho[g] = np.maximum(result.sigma_rho[g], wide)


def climb(site, result, scale, *, given=None, threshold=THRESHOLD, trace=None, options=None, max_rounds=12) -> Climb:
    """From the diffuse fit to every group's rung.

    given : {group number: kind} from scene.yaml;  threshold : display RMSE beyond noise that a group may keep
    trace : called after each fit with round, result, places;  options : of reflectance.gauss_newton
    """
    given, options = dict(given or {}), dict(options or {})
    base = site.base
    misfits, _ = rungs.audit(site.subcell, base, result, site.base_tiles)
    here = Climb(base, result, scale, {int(g): Place() for g in np.unique(site.surface.group)}, misfits, dict(misfits), None, site.base_tiles)
    known = {g for g in range(len(base.groups)) if not np.isnan(base.rho[g]).any()}       # lamps and references
    settled = set(known)
    for g, kind in given.items():
        here.places[g].given = True
        if kind == "diffuse":
            settled.add(g)
        elif kind == "textured":
            here.places[g] = Place("textured", why="given in scene.yaml", given=True)
            settled.add(g)
    if "textured" in given.values():
        here = _refit(site, here, options)
    wanted = {g: kind for g, kind in given.items() if kind in ("mirror", "coloured_mirror", "glossy")}
    for here.rounds in range(1, max_rounds + 1):
        energy = lambda g: here.misfits[g].excess ** 2 * here.misfits[g].pixels if g in here.misfits else np.inf
        over = {g for g, m in here.misfits.items() if g not in settled and m.judged and m.excess > tolerance(m, threshold)}
        flagged = sorted({*over, *wanted}, key=energy, reverse=True)
        trials, explained = {}, 0.0
        for g in flagged:
            if energy(g) < 0.03 * explained and g not in wanted:        # its error may be the other one's light: it is asked again
                continue
            trials[g] = _tried(site, here, g, wanted.get(g), threshold)
            explained = max([explained] + [energy(g) for t in trials[g] if t.explained > 0.8])
        # the greatest error first: what no rung explains may be what a mirror shows, or throw gamma off; but not before a rung that
        # explains its group wholly, whose light may be that error
        sure = any(t.explained > 0.8 and t.misfit.excess <= 0.5 * threshold for tried in trials.values() for t in tried)
        greatest = max((g for g in trials if g not in wanted and not any(t.explained > 0.5 for t in trials[g])), key=energy, default=None)
        others = max((energy(g) * t.explained for g in trials for t in trials[g]), default=0.0)
        taken = [] if greatest is not None and energy(greatest) > 4 * others and not sure else _taken(here, trials, threshold, wanted, settled)
        if not taken and greatest is not None:
            taken = _textured(here, [greatest], trials, threshold, settled)
        if not taken:
            taken = _taken(here, trials, threshold, wanted, settled)
        if not taken:
            break
        here = _refit(site, here, options)
        if _back(here, threshold):
            here = _refit(site, here, options)
        if trace:
            trace(here)
        wanted, settled = {}, settled | set(given)
    return here


def _tried(site, here, g, wanted, threshold):
    """The rungs above the group's own, tried one after the other in the present light, until one explains the group."""
    from lib import specular
    state, M = here.result.state, 0 if here.finish is None else len(here.finish)
    keep = [m for m in range(M) if here.finish.groups[m] != g]
    finish = here.finish.only(keep) if M else specular.Finish((), np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 3)))
    rho_s = state.rho_s[keep] if M else np.zeros((0, here.problem.channels))
    own = RUNGS.index(here.places[g].rung)
    trials = []
    if wanted in (None, "mirror", "coloured_mirror") and own < RUNGS.index("coloured_mirror"):
        trials += rungs.as_mirror(site, here.problem, state, finish, rho_s, g, rungs.plain(site, here, g),
                                  [h for h, p in here.places.items() if p.rung == "textured"])
        if wanted:
            return [t for t in trials if t.rung == wanted]
        if any(t.misfit.excess <= threshold or t.explained > 0.7 for t in trials):      # if the rest is more than the light's, it climbs on
            return [t for t in trials if RUNGS.index(t.rung) > own]
    trials += rungs.as_glossy(site, here.problem, state, finish, rho_s, g, threshold)
    return [t for t in trials if RUNGS.index(t.rung) > own]


def _taken(here, trials, threshold, wanted, settled):
    """Give the groups that a rung explains that rung; returns them. Those explained nearly wholly at once, else the best alone."""
    choice = {}
    for g, kind in wanted.items():
        if not trials.get(g) and "mirror" in kind:                 # no pixel can judge it, yet its light goes on
            one = np.ones(here.problem.channels)
            here.places[g] = Place(kind, 0 * one, one, why="given in scene.yaml; no pixel shows what it reflects", given=True)
    blind = [g for g, kind in wanted.items() if not trials.get(g) and "mirror" in kind]
    for g, tried in trials.items():
        if not tried:
            continue
        best = min(t.misfit.excess for t in tried)
        now = here.misfits[g].excess if g in here.misfits else np.inf
        enough = max(threshold, 2 * best)                          # the light is not yet that of the end: about as good is good
        trial = next(t for t in sorted(tried, key=lambda t: RUNGS.index(t.rung)) if t.misfit.excess <= enough)
        diffuse = here.places[g].rung == "diffuse"
        gain = trial.explained if diffuse else 1 - (trial.misfit.excess / max(now, 1e-12)) ** 2
        if g in wanted or gain > 0.5 and (trial.rung not in ("glossy", "anisotropic") or trial.rho_s.max() > 0.002):
            choice[g] = (gain * trial.diffuse.excess ** 2 * trial.diffuse.pixels, gain, trial, tried)
    if not choice:
        return blind
    best = max(choice, key=lambda g: choice[g][0])
    taken = [g for g, (_, gain, _, _) in choice.items() if g == best or g in wanted or gain > 0.8]
    for g in taken:
        _, gain, trial, tried = choice[g]
        said = ", ".join(f"{t.rung} {t.misfit.excess:.4f}" for t in tried)
        old = here.places[g]
        why = f"off by {trial.diffuse.excess:.4f} beyond noise as diffuse; {said}" if not old.given else f"given in scene.yaml; {said}"
        here.places[g] = Place(trial.rung, trial.rho_d, trial.rho_s, trial.alpha, trial.tangent, why,
                               old.tried + [{"rung": t.rung, "excess": t.misfit.excess, "diffuse": t.diffuse.excess} for t in tried], old.given)
    return taken + blind


def _textured(here, flagged, trials, threshold, settled):
    """What no rung explains is a texture, if it is clearly more than shadows' edges leave. One at a time: the others may be well after it."""
    taken = [g for g in flagged if g in here.misfits and here.misfits[g].excess > 1.5 * threshold and here.places[g].rung == "diffuse"]
    for g in taken:
        here.places[g].rung = "textured"
        here.places[g].tried = [{"rung": t.rung, "excess": t.misfit.excess, "diffuse": t.diffuse.excess} for t in trials.get(g, [])]
        here.places[g].why = f"off by {here.misfits[g].excess:.4f} beyond noise as diffuse, and no mirror or lobe explains half of that"
        settled.add(g)
    return taken


def _back(here, threshold) -> list:
    """Textures that were none: the light of a rung taken later explains them. They are diffuse again, and stay so."""
    back = [g for g, m in here.patterns.items() if not here.places[g].given and m.excess <= tolerance(m, threshold)]
    for g in back:
        why = here.places[g].why.split(",")[0]
        here.places[g] = Place(why=f"{why}; {here.patterns[g].excess:.4f} in the light by way of what climbed after it", tried=here.places[g].tried)
    return back


def _finish(places):
    from lib import specular
    groups = [g for g, p in sorted(places.items()) if p.rung in ("mirror", "coloured_mirror", "glossy", "anisotropic")]
    kind = np.array([specular.MIRROR if "mirror" in places[g].rung else specular.GLOSSY for g in groups], int)
    return specular.Finish(tuple(groups), kind, np.array([places[g].alpha for g in groups]).reshape(-1, 2), np.array([places[g].tangent for g in groups]).reshape(-1, 3))


def _shapes(places, finish):
    return [(m, name) for m, g in enumerate(finish.groups)
            for name in {"glossy": ("alpha",), "anisotropic": ("alpha_x", "alpha_y", "turn")}.get(places[g].rung, ())]


def _refit(site, here, options) -> Climb:
    """Everything anew with the light that goes by way of the specular groups; lobes are traced again until their shapes stay."""
    from lib import specular
    places, state = here.places, here.result.state
    finish = _finish(places)
    chains = specular.Chains(len(finish))
    C = site.base.channels
    textured = [g for g, p in places.items() if p.rung == "textured"]
    variance = np.zeros(len(site.base.groups))
    variance[textured] = [here.misfits[g].excess ** 2 if g in here.misfits else 0.05 ** 2 for g in textured]
    if not len(finish):
        tiles = receivers.tiles_of(site, None, chains, textured)
        problem = receivers.assemble(site, None, chains, tiles, None, None, variance=variance)
        result, scale = reflectance.fit(problem, start=(state.rho, state.E, state.gamma, None), **options)
        misfits, patterns = rungs.audit(site.subcell, problem, result, tiles, None, textured)
        return replace(here, problem=problem, result=result, scale=scale, tiles=tiles, misfits=misfits, patterns=patterns)
    tiles = receivers.tiles_of(site, finish, chains, textured)
    transport = receivers.light(site, finish, chains, tiles)
    traced = np.array(finish.alpha)
    fixed = site.base.rho.copy()
    rho, free = state.rho.copy(), np.full((len(finish), C), np.nan)
    rho_s = np.ones((len(finish), C))
    old = {g: m for m, g in enumerate(here.finish.groups)} if here.finish is not None else {}
    for m, g in enumerate(finish.groups):
        if finish.kind[m] == specular.MIRROR:
            fixed[g] = rho[g] = 0
        elif places[g].rho_d is not None:
            rho[g] = places[g].rho_d
        rho_s[m] = state.rho_s[old[g]] if g in old and places[g].rho_s is None else np.clip(places[g].rho_s, 1e-3, 1)
        if places[g].rung == "mirror":
            rho_s[m], free[m] = 1, 1
    base, site.base = site.base, replace(site.base, rho=fixed)
    try:
        start = (rho, state.E, state.gamma, rho_s)
        rough = bool(_shapes(places, finish))
        for turn in range(12):
            shapes = _shapes(places, finish)
            # half the rays on the way
            problem = receivers.assemble(site, finish, chains, tiles, transport, free, shapes, variance, rays=max(site.lobe_rays // 2, 16) if rough else None)
            result = reflectance.gauss_newton(problem, start=start, finish=False, **{**options, "max_iterations": 12, "tolerance": 1e-3})
            start = (result.state.rho, result.state.E, result.state.gamma, result.state.rho_s)
            steps = result.state.bend
            for (m, name, *_), step in zip(problem.specular.bend, steps):
                finish = receivers.bent(finish, m, name, step, receivers.main_normal(site.surface, finish.groups[m]))
            for m in range(len(finish)):
                finish = _ordered(site, finish, m)
            if np.max(np.abs(np.log(np.maximum(finish.alpha, 1e-6) / np.maximum(traced, 1e-6))), initial=0) > 0.25:
                transport, traced = receivers.light(site, finish, chains, tiles), np.array(finish.alpha)
            largest = np.max(np.abs(steps), initial=0)
            if rough and largest < 0.01:
                rough = False
                if (np.asarray(finish.alpha)[finish.kind == specular.GLOSSY] < SHARP).any():
                    site.detail = receivers.detailed(site, finish, result.state)     # sharp lobes see more than patches
            elif not rough and largest < 0.004:
                break
        # every mirror may have any rho_s; one that is 1 within its uncertainty is perfect
        mirrors = [m for m, g in enumerate(finish.groups) if "mirror" in places[g].rung and not places[g].given]
        free[mirrors] = np.nan
        problem = receivers.assemble(site, finish, chains, tiles, transport, free, _shapes(places, finish), variance, final=True)
        result, scale = reflectance.fit(problem, start=(*start[:3], np.where(np.isnan(free), np.minimum(start[3], 0.999), start[3])), **options)
        for m in mirrors:
            place, rho_s = places[finish.groups[m]], result.state.rho_s[m]
            away = (np.abs(rho_s - 1) > np.maximum(3 * result.sigma_rho_s[m], 0.004)).any()
            if away and place.rung == "mirror":
                place.why += f"; rho_s = {', '.join(f'{v:.3f}' for v in rho_s)} is not 1"
            place.rung = "coloured_mirror" if away else "mirror"
            free[m] = np.nan if away else 1
        if not np.isnan(free[mirrors]).all():
            problem = replace(problem, specular=replace(problem.specular, rho_s=free, _mixtures={}))
            result, scale = reflectance.fit(problem, start=(*(getattr(result.state, name) for name in ("rho", "E", "gamma")),
                                                            np.where(np.isnan(free), result.state.rho_s, free)), **options)
    finally:
        site.base, site.detail = base, None
    sigma_shape = {}
    for i, (m, name, *_) in enumerate(problem.specular.bend):
        finish = receivers.bent(finish, m, name, result.state.bend[i], receivers.main_normal(site.surface, finish.groups[m]))      # the last step of the instruments
        if result.sigma_bend is not None:
            sigma_shape.setdefault(finish.groups[m], {})[name] = float(result.sigma_bend[i])
    for m, g in enumerate(finish.groups):
        places[g] = replace(places[g], rho_d=None, rho_s=None, alpha=finish.alpha[m], tangent=finish.tangent[m])
    misfits, patterns = rungs.audit(site.subcell, problem, result, tiles, transport, textured)
    return replace(here, problem=problem, result=result, scale=scale, finish=finish, tiles=tiles, sigma_shape=sigma_shape, misfits=misfits, patterns=patterns)


def _ordered(site, finish, m):
    """alpha_x >= alpha_y: else the tangent is turned by a right angle."""
    if finish.alpha[m, 0] >= finish.alpha[m, 1]:
        return finish
    alpha, tangent = np.array(finish.alpha, float), np.array(finish.tangent, float)
    alpha[m] = alpha[m, ::-1]
    tangent[m] = np.cross(receivers.main_normal(site.surface, finish.groups[m]), tangent[m])
    return replace(finish, alpha=alpha, tangent=tangent)
