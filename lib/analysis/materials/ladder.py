"""The reflectance ladder (section 4.5): each group climbs only as far as its error demands.

    diffuse -> perfect mirror -> coloured mirror -> glossy (Ward) -> anisotropic -> textured

`climb` starts from the fit in which everything is diffuse and asks, group by group, whether the photograph agrees with
it to the threshold or the noise. Of the groups that do not, each is tried on the next rungs in the light found so far:
as a mirror by what its virtual viewpoint shows, as a glossy surface by the light in its lobe. The group whose error a
rung explains best climbs. Then everything is fitted anew, all reflectances, lobes, lamps and gamma together, with the
light that now goes by way of that surface. And the question is asked again: a bright patch on the floor was perhaps
only the mirror's. What no rung explains is a texture.

A rung must be worth its parameters: among those that explain about equally well the lowest is taken, and one that
leaves half of the error beyond noise and its chance is not taken at all: noise never makes a wall glossy.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lib.analysis.causes import one_object
from lib.analysis.causes.candidates import enough
from lib.analysis.fit import misfits
from lib.analysis.fit.misfits import is_over, tolerance
from lib.analysis.fit.problem import Result
from lib.analysis.materials import rungs
from lib.analysis.materials.climbing import Climb, Place
from lib.analysis.materials.refit import refit
from lib.analysis.materials.rungs import LightSoFar, Trial
from lib.analysis.materials.site import Site
from lib.given.kinds import LOBES, MIRRORS, ORDER, RUNGS
from lib.light.chains import Finish

MOST_ROUNDS = 12
EDGE = 0.0125  # of the picture's width: so near to edges shows an object that is some centimetres off
# where the whole picture disagrees: so many groups are tried; a rung must explain such a share of a group's error, and
# leave so much of what neighbouring tiles have in common at most
FEW, SURE, PROGRESS = 3, 0.8, 0.7
SHARPEST, DARK = 0.01, 0.02  # alpha, rho_d: a lobe below both may be a mirror


def climb(
    site: Site,
    result: Result,
    scale,
    *,
    given=None,
    things=(),
    threshold=misfits.THRESHOLD,
    small=True,
    only=None,
    rounds=MOST_ROUNDS,
    trace=None,
    options=None,
) -> Climb:
    """From the diffuse fit to every group's rung.

    given : {group number: kind} from scene.yaml;  things : that may stand before groups, of strangers.things
    threshold : display RMSE beyond noise that a group may keep
    small : where the picture disagrees, small things are asked that may be what is wrong with all others
    only : the group that may climb, None: all;  rounds : at most
    trace : called with the round (0 before the first trial), the name of the step and the Result after each fit
    options : of gauss_newton.gauss_newton
    """
    given, options = dict(given or {}), dict(options or {})
    fitted = lambda here: refit(site, here, options, trace and (lambda step, result: trace(here.rounds, step, result)))
    here = _at_the_foot(site, result, scale, given)
    settled = site.base.known_groups | {g for g, kind in given.items() if kind in ("diffuse", "textured")}
    if only is not None:
        settled |= here.places.keys() - {only}
    if "textured" in given.values():
        here = fitted(here)
    wanted = {g: kind for g, kind in given.items() if kind in (*MIRRORS, *LOBES)}
    for here.rounds in range(1, rounds + 1):
        step = _Step(site, here, wanted, settled, threshold, things, sure_only=not here.result.fits, small=small)
        taken = step.taken()
        if not taken:
            break
        before, is_mirror = here.result.correlated, any(here.places[g].rung in MIRRORS for g in taken)
        here = fitted(here)
        if mirrors := _mirrors_after_all(here):
            other = fitted(replace(here, places=here.places | mirrors))
            here = other if other.result.correlated < here.result.correlated else here
        if step.sure_only and not (wanted or is_mirror) and here.result.correlated > PROGRESS * before:
            break  # a mirror's picture is no chance, and there may be more of them
        if back := _back(here, threshold) + _at_border(here):
            here, settled = fitted(here), settled | set(back)
        wanted, settled = {}, settled | set(given)
    return here


def _at_the_foot(site, result, scale, given) -> Climb:
    """Everything diffuse, but for textures that scene.yaml names."""
    found, _ = misfits.audit(site.subcell, site.base, result, site.tiles)
    places = {g: Place() for g in range(len(site.surface.groups))}
    for g, kind in given.items():
        places[g].given = True
        if kind == "textured":
            places[g] = Place("textured", why="given in scene.yaml", given=True)
    return Climb(site.base, result, scale, places, found, dict(found), None, site.tiles)


class _Choice(NamedTuple):
    """A rung that may be taken. worth : energy that it explains;  gain : share of the group's error"""

    worth: float
    gain: float
    trial: Trial
    tried: list


class _Step:
    """One round of the climb: which groups are over, what rungs would explain of them, and which are taken."""

    def __init__(self, site: Site, here: Climb, wanted, settled, threshold, things=(), sure_only=False, small=True):
        """wanted : {group: kind} that scene.yaml names and that is still to be given;  settled : groups that stay

        things : that may stand before groups. Some show a sharp patch, which no dull lobe explains (`covered`), some
            are plain but for a thing, of which no texture is made (`hidden`)
        sure_only : the picture as a whole disagrees: only what explains nearly all of a group's error is a material
        """
        self.sure_only = sure_only
        self.covered = {g for thing in things if thing.is_sharp for g in thing.behind[:2]}
        self.hidden = {thing.behind[0] for thing in things if thing.on_plain}
        self.site, self.here, self.wanted, self.settled, self.threshold = site, here, wanted, settled, threshold
        over = {g for g, m in here.misfits.items() if g not in settled and is_over(m, threshold)}
        over -= self._of_several_materials(over)
        self.trials, explained = {}, 0.0
        ordered = sorted({*over, *wanted}, key=self.energy, reverse=True)
        for g in self._few(ordered, small) if sure_only else ordered:
            if g not in over and g not in wanted and explained:
                break
            if self.energy(g) < 0.03 * explained and g not in wanted:
                continue  # its error may be the other one's light: it is asked again
            tried = self._tried(g)
            if g not in wanted and self._by_objects(g) > max([SURE] + [t.explained for t in tried]):
                continue  # a reflectance for each of its objects explains more than any material of the whole group
            self.trials[g] = tried
            explained = max([explained] + [self.energy(g) for t in self.trials[g] if t.explained > 0.8])

    def _few(self, ordered, small) -> list:
        """Of groups, those that differ most: the greatest errors, and the one of the others that is off by most, where
        these explain nothing: a small thing may throw light over a whole wall, whose error is a hundred times its own.
        """
        few = ordered[: max(FEW, len(self.wanted))]
        if not small:
            return few
        rest = {g: m.excess for g, m in self.here.misfits.items() if g not in {*few, *self.settled} and m.judged}
        most = max(rest, key=rest.get, default=None)
        return few if most is None or rest[most] < misfits.LEAST else [*few, most]

    def _of_several_materials(self, over) -> set:
        """The groups whose objects have a reflectance each: no material of the whole group explains them."""
        if self.here.finish is not None:
            return set()
        here, site = self.here, self.site
        found = misfits.parts(
            site.subcell, here.problem, here.result, here.tiles, [g for g in over if g not in self.wanted]
        )
        return {g for g, parts in found.items() if parts.unlike and parts.explained > SURE}

    def _by_objects(self, g) -> float:
        """Share of a group's error that a reflectance for each of its objects explains, where one stands out by far."""
        here, site = self.here, self.site
        if here.finish is not None or g not in self._unlike:
            return 0.0
        found = misfits.parts(site.subcell, here.problem, here.result, here.tiles, [g])
        return found[g].explained if g in found else 0.0

    @functools.cached_property
    def _unlike(self) -> set:
        """The groups of objects that have not their group's reflectance."""
        here = self.here
        found = one_object.objects(here.problem, here.result)
        return {one.group for one in found if one.nats >= enough(here.problem)}

    def energy(self, g):
        """What the group is off by as a whole; without bound where no pixel tells."""
        return self.here.misfits[g].energy if g in self.here.misfits else np.inf

    def taken(self) -> list:
        """The groups that have climbed, their places changed.

        The greatest error comes first: what no rung explains may be what a mirror shows, or throw gamma off. But it
        does not come before a rung that explains its group wholly, whose light may be that error.
        """
        if self.sure_only:
            return self._climb()
        unexplained = [
            g for g, tried in self.trials.items() if g not in self.wanted and not any(t.explained > 0.5 for t in tried)
        ]
        unexplained.sort(key=self.energy, reverse=True)
        greatest = unexplained[0] if unexplained else None
        others = max((self.energy(g) * t.explained for g, tried in self.trials.items() for t in tried), default=0.0)
        sure = any(
            t.explained > 0.8 and t.misfit.excess <= 0.5 * self.threshold
            for tried in self.trials.values()
            for t in tried
        )
        comes_first = greatest is not None and self.energy(greatest) > 4 * others and not sure
        if comes_first and (taken := self._texture(greatest)):
            return taken
        return self._climb() or next((taken for g in unexplained if (taken := self._texture(g))), [])

    def _tried(self, g) -> list:
        """The rungs above the group's own, tried in the present light, until one explains the group."""
        light, own = self._light_without(g), ORDER.index(self.here.places[g].rung)
        wanted, above = self.wanted.get(g), lambda trials: [t for t in trials if ORDER.index(t.rung) > own]
        trials = []
        if wanted in (None, *MIRRORS) and own < ORDER.index("coloured_mirror"):
            textured = [h for h, place in self.here.places.items() if place.rung == "textured"]
            chains = None if self.here.finish is None else self.here.problem.specular.chains
            diffuse = rungs.plain(self.site, light, self.here.tiles, self.here.result.state.rho_s, chains, g)
            trials += rungs.as_mirror(self.site, light, g, diffuse, textured)
            if wanted:
                return [t for t in trials if t.rung == wanted]
            if any(t.misfit.excess <= self.threshold or t.explained > 0.7 for t in trials):
                return above(trials)  # if the rest is more than the light's, it climbs on
        kept = 0.0 if g in self.wanted else tolerance(self.here.misfits[g], self.threshold)
        sharp = g in self.covered and g not in self.wanted
        lobes = rungs.as_glossy(self.site, light, g, self.threshold, kept, sharp)
        return above(trials + [t for t in lobes if wanted in (None, RUNGS[t.rung].kind)])

    def _light_without(self, g) -> LightSoFar:
        """The light found so far, with the specular groups but g."""
        here, state = self.here, self.here.result.state
        if here.finish is None:
            none = Finish((), np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 3)))
            return LightSoFar(here.problem, state, none, np.zeros((0, self.site.channels)))
        keep = [m for m, other in enumerate(here.finish.groups) if other != g]
        return LightSoFar(here.problem, state, here.finish.only(keep), state.rho_s[keep])

    def _climb(self) -> list:
        """Let groups climb that a rung explains: all that are explained nearly wholly, else the best alone."""
        blind = self._blind_mirrors()
        choices = {g: choice for g in self.trials if (choice := self._choice(g)) is not None}
        if not choices:
            return blind
        best = max(choices, key=lambda g: choices[g].worth)
        taken = [g for g, choice in choices.items() if g == best or g in self.wanted or choice.gain > 0.8]
        for g in taken:
            self._put(g, choices[g])
        return taken + blind

    def _blind_mirrors(self) -> list:
        """Mirrors that scene.yaml names and that no pixel can judge: their light goes on all the same."""
        blind = [g for g, kind in self.wanted.items() if not self.trials.get(g) and kind in MIRRORS]
        one = np.ones(self.site.channels)
        for g in blind:
            why = "given in scene.yaml; no pixel shows what it reflects"
            self.here.places[g] = Place(self.wanted[g], 0 * one, one, why=why, given=True)
        return blind

    def _choice(self, g) -> _Choice | None:
        """The lowest of the rungs that explain the group about as well as the best; None if that is not enough."""
        tried = [t for t in self.trials[g] if g in self.wanted or not t.is_at_border]
        if not tried:
            return None
        # the light is not yet that of the end: about as good is good
        enough = max(self.threshold, 2 * min(t.misfit.excess for t in tried))
        trial = next(t for t in sorted(tried, key=lambda t: ORDER.index(t.rung)) if t.misfit.excess <= enough)
        gain = trial.explained
        if self.here.places[g].rung != "diffuse":
            now = self.here.misfits[g].excess if g in self.here.misfits else np.inf
            gain = 1 - (trial.misfit.excess / max(now, 1e-12)) ** 2
        dull = RUNGS[trial.rung].lobe and trial.rho_s.max() <= 0.002
        if g in self.wanted or (gain > (SURE if self.sure_only else 0.5) and not dull):
            return _Choice(gain * trial.diffuse.energy, gain, trial, tried)
        return None

    def _put(self, g, choice: _Choice):
        trial, old = choice.trial, self.here.places[g]
        said = ", ".join(f"{t.rung} {t.misfit.excess:.4f}" for t in choice.tried)
        first = "given in scene.yaml" if old.given else f"off by {trial.diffuse.excess:.4f} beyond noise as diffuse"
        self.here.places[g] = Place(
            trial.rung,
            trial.rho_d,
            trial.rho_s,
            trial.alpha,
            trial.tangent,
            f"{first}; {said}",
            old.tried + _told(choice.tried),
            old.given,
        )

    def _texture(self, g) -> list:
        """What no rung explains is a texture, if it is clearly more than shadows' edges leave, or a pattern."""
        place = self.here.places[g]
        if g not in self.here.misfits or place.rung != "diffuse":
            return []
        excess = self.here.misfits[g].excess
        if excess <= 1.5 * self.threshold and not self.site.base.group_variance[g]:
            return []
        if g in self.hidden:
            place.why = f"off by {excess:.4f} beyond noise, but only where something may stand before it"
            return []
        if not self._is_off_inside(g):
            place.why = f"off by {excess:.4f} beyond noise, but only near its edges: it may stand elsewhere"
            return []
        place.rung, place.tried = "textured", _told(self.trials.get(g, []))
        place.why = f"off by {excess:.4f} beyond noise as diffuse, and no mirror or lobe explains half of that"
        self.settled.add(g)
        return [g]

    def _is_off_inside(self, g):
        """A pattern of the surface is also far from its edges; an object or a pose that is off shows at edges only."""
        here = self.here
        traced = None if here.traced is None else here.traced.tiles
        inside = self.site.inside(here.tiles, EDGE * max(self.site.view.shape))
        found, _ = misfits.audit(self.site.subcell, here.problem, here.result, here.tiles, traced, among=inside)
        return g in found and found[g].judged and is_over(found[g], self.threshold)


def _told(trials):
    """Trials as the report has them."""
    return [{"rung": t.rung, "excess": t.misfit.excess, "diffuse": t.diffuse.excess} for t in trials]


def _back(here: Climb, threshold) -> list:
    """Textures that were none: the light of a rung taken later explains them. They are diffuse again, and stay so."""
    back = [g for g, m in here.patterns.items() if not here.places[g].given and m.excess <= tolerance(m, threshold)]
    for g in back:
        why = here.places[g].why.split(",")[0]
        now = here.patterns[g].excess
        here.places[g] = Place(
            why=f"{why}; {now:.4f} in the light by way of what climbed after it", tried=here.places[g].tried
        )
    return back


def _mirrors_after_all(here: Climb) -> dict:
    """{group: Place} of lobes that no pixel tells from a mirror, and that reflect nothing else.

    In the light of a diffuse fit a floor that mirrors all looked duller than it is.
    """
    found = {}
    for m, g in enumerate(here.finish.groups if here.finish is not None else ()):
        place, state = here.places[g], here.result.state
        sharp = RUNGS[place.rung].lobe and not place.given and place.alpha.max() < SHARPEST
        if sharp and state.rho[g].max() < DARK:
            rho_s = np.clip(state.rho_s[m], 1e-3, 1)
            found[g] = Place(
                "coloured_mirror", 0 * rho_s, rho_s, why=f"{place.why}; its lobe is a mirror's", tried=place.tried
            )
    return found


def _at_border(here: Climb) -> list:
    """Lobes that bent to a shape at which searches end: they are none. They are diffuse again, and stay so."""
    found = []
    for m, g in enumerate(here.finish.groups if here.finish is not None else ()):
        place, rho_s = here.places[g], here.result.state.rho_s[m]
        if RUNGS[place.rung].lobe and not place.given and rungs.at_border(rho_s, place.alpha):
            shape = f"rho_s up to {rho_s.max():.3f}, alpha {place.alpha.max():.3f}"
            here.places[g] = Place(why=f"{place.why}; the lobe bent to what no surface has: {shape}", tried=place.tried)
            found.append(g)
    return found
