"""Everything fitted anew with the light that goes by way of the groups that have climbed.

Lobes are traced and fitted in turn until their shapes stay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.fit import misfits
from lib.analysis.fit.equations import Unknowns
from lib.analysis.fit.gauss_newton import fit, gauss_newton
from lib.analysis.fit.problem import Problem, Result
from lib.analysis.materials.climbing import SPECULAR, Climb
from lib.analysis.materials.lobes import bent, detail_of
from lib.analysis.materials.site import Site
from lib.analysis.materials.specular_problem import Unknown, assemble
from lib.analysis.materials.specular_ways import tiles_of, traced
from lib.given.kinds import RUNGS
from lib.light.chains import GLOSSY, MIRROR, Chains, Finish

SHARP = 0.2  # alphas below which a lobe resolves the light within patches
TURNS = 12  # of tracing and fitting at most
ROUGH, FINE = 0.01, 0.004  # largest step of a shape that ends the rough turns, and the fine ones
RETRACE = 0.25  # change of ln alpha after which the light by way of the lobes is traced anew
NEARLY_PERFECT = 0.004  # a mirror that is so near to 1, or within 3 sigma, is perfect
GIVEN_SPREAD = 0.05  # display RMSE of a textured group that no audit has judged


def refit(site: Site, here: Climb, options, trace=None) -> Climb:
    """The climb with everything fitted anew at the places where its groups stand.

    options : of gauss_newton.gauss_newton
    trace : called with the name of the step ("shapes", "last") and the Result after each fit
    """
    trace = trace or (lambda step, result: None)
    textured = here.on("textured")
    climbed = [g for g, place in here.places.items() if place.rung != "diffuse"]
    variance = site.base.group_variance
    variance[climbed] = 0
    variance[textured] = [here.misfits[g].excess ** 2 if g in here.misfits else GIVEN_SPREAD**2 for g in textured]
    if here.on(*SPECULAR):
        return _SpecularFit(site, here, options, trace, textured, variance).climb()
    state, tiles = here.result.state, tiles_of(site, None, Chains(0), textured)
    problem = assemble(site, None, tiles, None, Unknown(site.base.rho, None, [], variance))
    result, scale = fit(problem, start=Unknowns(state.rho, state.E, state.transfer), **options)
    trace("last", result)
    found, patterns = misfits.audit(site.subcell, problem, result, tiles, None, textured)
    # groups that have come back leave no mirror behind
    light = {"finish": None, "traced": None}
    return replace(
        here, problem=problem, result=result, scale=scale, tiles=tiles, misfits=found, patterns=patterns, **light
    )


class _SpecularFit:
    """One fit with mirrors and lobes: start values, shapes that settle, mirrors set free, the last fit."""

    def __init__(self, site: Site, here: Climb, options, trace, textured, variance):
        self.site, self.here, self.options, self.trace = site, here, options, trace
        self.textured, self.variance = textured, variance
        self.places = here.places
        self.finish = _finish_of(self.places)
        self.chains = Chains(len(self.finish))
        self.tiles = tiles_of(site, self.finish, self.chains, textured)
        self.traced = traced(site, self.finish, self.chains, self.tiles)
        self.detail = None

    def climb(self) -> Climb:
        rho, self.free, start = self._start_values()
        self.rho = rho
        start = self._settle_shapes(start)
        problem, result, scale = self._free_mirrors(start)
        sigma_shape = self._last_bends(problem, result)
        for m, g in enumerate(self.finish.groups):
            self.places[g] = replace(
                self.places[g], rho_d=None, rho_s=None, alpha=self.finish.alpha[m], tangent=self.finish.tangent[m]
            )
        found, patterns = misfits.audit(
            self.site.subcell, problem, result, self.tiles, self.traced.tiles, self.textured
        )
        return replace(
            self.here,
            problem=problem,
            result=result,
            scale=scale,
            finish=self.finish,
            tiles=self.tiles,
            traced=self.traced,
            sigma_shape=sigma_shape,
            misfits=found,
            patterns=patterns,
        )

    @property
    def shapes(self):
        """[(m, name)] of the lobes' shapes that are fitted."""
        return [(m, name) for m, g in enumerate(self.finish.groups) for name in RUNGS[self.places[g].rung].shapes]

    def _normal(self, m):
        return self.site.main_normal(self.finish.groups[m])

    def _start_values(self):
        """What is known of rho (G, C), of rho_s (M, C), both NaN where free, and where the search begins."""
        here, finish, state, C = self.here, self.finish, self.here.result.state, self.site.channels
        known, rho = self.site.base.rho.copy(), state.rho.copy()
        free, rho_s = np.full((len(finish), C), np.nan), np.ones((len(finish), C))
        before = {g: m for m, g in enumerate(here.finish.groups)} if here.finish is not None else {}
        for m, g in enumerate(finish.groups):
            place = self.places[g]
            if finish.kind[m] == MIRROR:
                known[g] = rho[g] = 0
            elif place.rho_d is not None:
                rho[g] = place.rho_d
            if g in before and place.rho_s is None:
                rho_s[m] = state.rho_s[before[g]]
            else:
                rho_s[m] = np.clip(place.rho_s, 1e-3, 1)
            if place.rung == "mirror":
                rho_s[m], free[m] = 1, 1
        return known, free, Unknowns(rho, state.E, state.transfer, rho_s)

    def _assembled(self, **more) -> Problem:
        unknown = Unknown(self.rho, self.free, self.shapes, self.variance)
        return assemble(self.site, self.finish, self.tiles, self.traced, unknown, detail=self.detail, **more)

    def _settle_shapes(self, start: Unknowns) -> Unknowns:
        """Trace and fit in turn until the shapes stay: first roughly, by half the rays, then by all of them."""
        options = {**self.options, "max_iterations": 12, "tolerance": 1e-3}
        traced_alpha = np.array(self.finish.alpha)
        rough = bool((self.finish.kind == GLOSSY).any())
        for _ in range(TURNS):
            problem = self._assembled(rays=max(self.site.lobe_rays // 2, 16) if rough else None)
            result = gauss_newton(problem, start=start, finish=False, **options)
            self.trace("shapes", result)
            state = result.state
            start = Unknowns(state.rho, state.E, state.transfer, state.rho_s)
            self._bend(problem, state.bend)
            change = np.abs(np.log(np.maximum(self.finish.alpha, 1e-6) / np.maximum(traced_alpha, 1e-6)))
            if np.max(change, initial=0) > RETRACE:
                self.traced = traced(self.site, self.finish, self.chains, self.tiles)
                traced_alpha = np.array(self.finish.alpha)
            largest = np.max(np.abs(state.bend), initial=0)
            if rough and largest < ROUGH:
                rough = False
                if (np.asarray(self.finish.alpha)[self.finish.kind == GLOSSY] < SHARP).any():
                    self.detail = self._detail(state)  # sharp lobes see more than patches
            elif not rough and largest < FINE:
                break
        return start

    def _bend(self, problem, steps):
        """Take steps in the shapes of the lobes, the larger alpha first."""
        for shape, step in zip(problem.specular.bend, steps, strict=True):
            self.finish = bent(self.finish, shape.m, shape.name, step, self._normal(shape.m))
        for m in range(len(self.finish)):
            self.finish = _ordered(self.finish, m, self._normal(m))

    def _detail(self, state):
        transport = self.traced.transport
        return detail_of(self.site, self.finish, state, transport if transport.finish.equals(self.finish) else None)

    def _free_mirrors(self, start: Unknowns) -> tuple[Problem, Result, str]:
        """The last fit: every mirror may have any rho_s; one that is 1 within its uncertainty is perfect."""
        places, groups = self.places, self.finish.groups
        mirrors = [m for m, g in enumerate(groups) if places[g].is_mirror and not places[g].given]
        self.free[mirrors] = np.nan
        problem = self._assembled(final=True)
        inside = np.where(np.isnan(self.free), np.minimum(start.rho_s, 0.999), start.rho_s)
        result, scale = fit(problem, start=start._replace(rho_s=inside), **self.options)
        self.trace("last", result)
        for m in mirrors:
            place, rho_s = places[groups[m]], result.state.rho_s[m]
            away = (np.abs(rho_s - 1) > np.maximum(3 * result.sigma_rho_s[m], NEARLY_PERFECT)).any()
            if away and place.rung == "mirror":
                place.why += f"; rho_s = {', '.join(f'{v:.3f}' for v in rho_s)} is not 1"
            place.rung = "coloured_mirror" if away else "mirror"
            self.free[m] = np.nan if away else 1
        if not np.isnan(self.free[mirrors]).all():
            problem = replace(problem, specular=replace(problem.specular, rho_s=self.free, _mixtures={}))
            state = result.state
            rho_s = np.where(np.isnan(self.free), state.rho_s, self.free)
            result, scale = fit(problem, start=Unknowns(state.rho, state.E, state.transfer, rho_s), **self.options)
            self.trace("last", result)
        return problem, result, scale

    def _last_bends(self, problem, result):
        """Take the last step of the instruments in the shapes too; {group: {shape: sigma}}."""
        sigma = {}
        for i, shape in enumerate(problem.specular.bend):
            step = result.state.bend[i]
            self.finish = bent(self.finish, shape.m, shape.name, step, self._normal(shape.m))
            if result.sigma_bend is not None:
                group = self.finish.groups[shape.m]
                sigma.setdefault(group, {})[shape.name] = float(result.sigma_bend[i])
        return sigma


def _finish_of(places) -> Finish:
    groups = [g for g, place in sorted(places.items()) if place.rung in SPECULAR]
    return Finish(
        tuple(groups),
        np.array([MIRROR if places[g].is_mirror else GLOSSY for g in groups], int),
        np.array([places[g].alpha for g in groups]).reshape(-1, 2),
        np.array([places[g].tangent for g in groups]).reshape(-1, 3),
    )


def _ordered(finish: Finish, m, normal) -> Finish:
    """alpha_x >= alpha_y: else the tangent is turned by a right angle."""
    if finish.alpha[m, 0] >= finish.alpha[m, 1]:
        return finish
    alpha, tangent = np.array(finish.alpha, float), np.array(finish.tangent, float)
    alpha[m] = alpha[m, ::-1]
    tangent[m] = np.cross(normal, tangent[m])
    return replace(finish, alpha=alpha, tangent=tangent)
