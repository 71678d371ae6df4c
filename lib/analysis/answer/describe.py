"""From the solution of the inverse problem to materials.json (SCENE.md 4), and to warnings in words."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lib.analysis.causes import colour_mixing, lamp_lobe
from lib.analysis.causes.cause import believed
from lib.analysis.fit.problem import MISFIT, Problem, Result, group_rmse
from lib.analysis.materials.climbing import SPECULAR, Climb, Place
from lib.analysis.seen.gather import Gathered
from lib.core.report import Note
from lib.given.kinds import RUNGS
from lib.given.materials import Cause, Fit, FoundTransfer, Group, Lamp, LampSigma, Lobe, Materials, Rival, Rung, Sigma
from lib.given.transfer import GAMMA_RANGE, Metric
from lib.given.transfer_kinds import OF_PICTURE

if TYPE_CHECKING:
    from lib.analysis.causes.explained import Explained
    from lib.analysis.materials.textures import Textured

NONE = (0.0, 0.0, 0.0)
CURVE_SAMPLES = 256
MOST_OF_LAMP = 10.0  # standard deviation of an emittance, over it, that tells nothing
# What is told wrongly, so that no residual and no other fit says how far values are off.
BEYOND_SIGMA = {"lamp_flipped", "range", "units", "up_axis", "camera"}
MEANS_NOTHING = 0.3  # median of sigma / rho above which an answer is none (SCENE.md 4)
# Where model and photograph disagree, a value is a finding if its sigma is at most so much of it, or so small.
KNOWN_TO, DARK = 0.5, 0.02


def describe(
    problem: Problem,
    result: Result,
    found: Gathered,
    *,
    scale,
    transfer,
    explained: Explained,
    refined=(),
    why=(),
    sigma_scale=None,
    unexplained=(),
    curve=None,
    lobes=None,
    climb: Climb | None = None,
    textures: dict[int, Textured] | None = None,
) -> Materials:
    """What materials.json says. One-channel results stand three times.

    refined : [Cause] for which camera or model are not as given
    lobes : {lamp: (4,)} as scene.yaml has them
    curve : that scene.yaml tells, of three channels
    transfer : as scene.yaml has it, or None;  why : [Why] where photograph and given facts do not agree
    sigma_scale : (C,) of contradictions.doubt_told, or None;  unexplained : groups that are no finding, of Answer
    climb : where a group is not diffuse;  textures : by group
    """
    errors = group_rmse(problem, result.tile_residual)
    specular = () if climb is None or climb.finish is None else climb.finish.groups
    accused = {w.subject for w in why if w.cause == "group_wrong"} | set(unexplained)
    # beside lobes another function is fitted to the light of lobes that were found under the told one
    beyond = BEYOND_SIGMA | ({"transfer"} if specular else set())
    wrong = any(w.cause in beyond for w in why)
    groups, told = {}, set()
    for g, name in enumerate(problem.groups):
        if name in problem.lamps or g >= len(found.visible):
            continue  # beyond those of the model: what was set aside
        group = _diffuse(problem, result, g, g in specular, errors[g], int(found.visible[g]))
        if climb is not None:
            group = _of_rung(group, climb, g, (textures or {}).get(g))
        known = g in problem.known_groups and g not in specular and name not in accused
        told |= {name} if known else set()
        if group.sigma.rho_d is not None and believed(group.sigma.rho_d, 1.0) is None:
            group = replace(group, identified=False, sigma=replace(group.sigma, rho_d=None))
        if why and not known:
            own = group.identified and name not in accused and _is_known(group)
            group = replace(group, identified=own, sigma=Sigma() if wrong else group.sigma)
        groups[name] = group
    nothing = len(problem.tile_group) == 0
    to = known_to(groups, {problem.groups[g] for g in problem.known_groups}) if why else None
    meaningless = wrong or bool(why) and (to is None or to > MEANS_NOTHING)
    if meaningless:
        groups = {name: group if name in told else replace(group, identified=False) for name, group in groups.items()}
    status = "nothing seen" if nothing else "converged" if result.converged and result.balanced else "not converged"
    if why and not nothing and (meaningless or status == "converged"):
        status = "does not fit" if meaningless else "approximate"
    rmse = None if nothing or not np.isfinite(result.rmse) else float(result.rmse)
    moved = {cause.subject: cause for cause in refined if cause.cause == "lamp_place"}
    lamps = {}
    for k in np.flatnonzero(problem.own_lamps):
        name = problem.lamps[k]
        lamp = _lamp(problem, result, k, scale, explained, lobes or {}, moved)
        if meaningless and lamp.identified:
            lamp = replace(lamp, identified=False, sigma=None if wrong else lamp.sigma)
        lamps[name] = lamp
    function = _transfer(problem, result, transfer, explained.rivals, curve)
    function = replace(function, sigma=None) if wrong else function
    fit = Fit(rmse, int(result.iterations))
    causes = sorted([*refined, *_causes(explained, problem, result)], key=lambda cause: -(cause.evidence_nats or 0))
    scale = scale if sigma_scale is None else "contradicted"
    sigma_scale = None if sigma_scale is None else _three(sigma_scale)
    return Materials(status, groups, lamps, function, to, scale, sigma_scale, fit, causes, list(why))


def _is_known(group: Group) -> bool:
    """Its values are findings by their own sigma, in every channel."""
    values, sigma = _reflects(group)
    return sigma is not None and all(s <= max(KNOWN_TO * v, DARK) for v, s in zip(values, sigma, strict=True))


def _reflects(group: Group):
    """(its reflectance, standard deviations of it): a mirror's rho_s, else rho_d; either may be None."""
    return (group.rho_s, group.sigma.rho_s) if group.is_mirror else (group.rho_d, group.sigma.rho_d)


def known_to(groups, given=()) -> float | None:
    """Median of sigma / rho over the groups that are seen, {name: Group}; None where no sigma is known.

    given : groups whose reflectance is told
    """
    shares = []
    for name, group in groups.items():
        values, sigma = _reflects(group)
        if values is None or name in given or group.error is None:
            continue
        shares.append(np.inf if sigma is None else np.mean(sigma) / max(np.mean(values), 1e-9))
    found = float(np.median(shares)) if shares else np.inf
    return found if np.isfinite(found) else None


def _causes(explained: Explained, problem, result) -> list[Cause]:
    """The causes that were taken, those first that explain most."""
    causes = []
    for taken in sorted(explained.taken, key=lambda t: -t.nats):
        if taken.cause == "response" and result.state.transfer.kind != "curve":
            continue  # sRGB in place of gamma is no deviation
        rivals = [Rival(cause, float(nats)) for cause, nats in taken.rivals.items()]
        for subject, values, sigma in explained.says(taken.cause, problem, result):
            causes.append(Cause(taken.name, subject, values, sigma, float(taken.nats), rivals))
    return causes


def _three(values):
    return tuple(float(v) for v in np.broadcast_to(values, 3))


def _diffuse(problem, result, g, is_specular, error, visible) -> Group:
    """The group as a diffuse one. is_specular : a mirror or a lobe shows it, if no tile does"""
    seen = bool(problem.seen_groups[g]) or is_specular
    known = g in problem.known_groups and not is_specular
    identified = known or seen
    reached = bool((problem.patch_group == g).any())
    rho = result.state.rho[g]
    sigma = None if result.sigma_rho is None or not identified else _three(result.sigma_rho[g])
    return Group(
        kind="diffuse",
        rho_d=_three(rho) if identified else None,
        rho_s=NONE if identified else None,
        assumed=_three(np.clip(rho, 0, 1)) if not identified and reached else None,
        sigma=Sigma(rho_d=sigma),
        pixels=visible,
        error=float(error) if seen and np.isfinite(error) else None,
        identified=identified,
    )


def _of_rung(group: Group, climb: Climb, g, textured: Textured | None) -> Group:
    """What a group's rung adds to it."""
    place = climb.places[g]
    if place.why:
        group = replace(group, ladder=Rung(place.rung, place.why, place.tried))
    if g in climb.misfits and place.rung in (*SPECULAR, "textured"):
        group = replace(group, error=climb.misfits[g].rms)
    if place.rung == "textured":
        group = replace(group, kind="textured")
        if textured is None:
            return group
        if group.sigma.rho_d is not None:
            group = replace(group, sigma=Sigma(rho_d=_three(np.hypot(group.sigma.rho_d, textured.unseen))))
        return replace(group, texture=textured.files, rho_d=_three(textured.mean))
    if climb.finish is None or g not in climb.finish.groups:
        return group
    return _specular(group, climb, g, climb.finish.groups.index(g), place)


def _specular(group: Group, climb: Climb, g, m, place: Place) -> Group:
    """A mirror or a glossy group; m : its number among the specular groups"""
    result, state = climb.result, climb.result.state
    fitted = np.isnan(climb.problem.specular.rho_s[m]).any()
    sigma_s = _three(result.sigma_rho_s[m]) if fitted else NONE
    group = replace(
        group,
        kind=RUNGS[place.rung].kind,
        rho_s=_three(state.rho_s[m]),
        rho_d=_three(np.minimum(state.rho[g], 1 - state.rho_s[m])),  # no surface gives back more than it gets
    )
    if place.blind:
        return replace(group, sigma=Sigma(rho_s=sigma_s), identified=False)
    if place.is_mirror:  # it has no rho_d by what the word means
        return replace(group, sigma=Sigma(rho_d=NONE, rho_s=sigma_s))
    shape = climb.sigma_shape.get(g, {})
    relative = [shape.get(name, shape.get("alpha", 0.0)) for name in ("alpha_x", "alpha_y")]
    anisotropic = place.rung == "anisotropic"
    return replace(
        group,
        alpha=tuple(map(float, place.alpha)),
        tangent=tuple(map(float, place.tangent)) if anisotropic else None,
        sigma=Sigma(
            group.sigma.rho_d,
            sigma_s,
            tuple(float(a * r) for a, r in zip(place.alpha, relative, strict=True)),
            shape.get("turn") if anisotropic else None,
        ),
    )


def _lamp(problem, result, k, scale, explained: Explained, told, moved) -> Lamp:
    """told : {lamp: (4,)} lobes of scene.yaml;  moved : {lamp: Cause} that stand elsewhere"""
    name = problem.lamps[k]
    known = not np.isnan(problem.emittance[k]).any()
    reflects = problem.rho[problem.groups.index(name)]
    sigma = {}
    fixed = scale == "convention" and (
        result.sigma_E is None or not result.sigma_E[k].any()
    )  # others are relative to it
    if not known and result.sigma_E is not None and not fixed:
        sigma["emittance"] = believed(_three(result.sigma_E[k]), MOST_OF_LAMP * np.abs(result.state.E[k]).max())
    if name in explained.lobes:
        sigma |= lamp_lobe.sigma_of(name, explained.lobes, explained.problem, explained.result) or {}
    if name in moved:
        sigma["offset_m"] = _three(moved[name].sigma["offset_m"])
    lobe = {**told, **explained.lobes}.get(name)
    return Lamp(
        _three(result.state.E[k]),
        None if lobe is None else _lobe(lobe),
        _three(moved[name].values["offset_m"]) if name in moved else None,
        LampSigma(**sigma) if any(v is not None for v in sigma.values()) else None,
        None not in sigma.values() if sigma else None,
        _three(reflects) if reflects.any() else None,  # a lamp named under `reference`
    )


def _lobe(lobe) -> Lobe:
    return Lobe(tuple(map(float, lobe[:3])), float(lobe[3]))


def _transfer(problem, result, asked, rivals, curve) -> FoundTransfer:
    """asked : as in scene.yaml, or None;  rivals : {kind: nats};  curve : told, of three channels, or None"""
    transfer = result.state.transfer
    kind = asked if asked in OF_PICTURE else transfer.kind
    told = {"asked": asked if isinstance(asked, str) else None, "rivals": rivals or None}
    if transfer.matrix:
        kind = "curve"  # which alone has a matrix in the file
        told["matrix"] = colour_mixing.found_in(problem, result)
    if kind == "gamma":
        return FoundTransfer(kind, float(transfer.gamma), sigma=result.sigma_gamma, **told)
    if kind != "curve":
        return FoundTransfer(kind, **told)
    I = np.linspace(0, 1, CURVE_SAMPLES)
    own = curve.channels if curve else (transfer.bare,)
    linear = np.array([function.linear(I) for function in own])
    linear[:, 0], linear[:, -1] = 0, 1
    linear = tuple(map(tuple, linear.tolist()))
    return FoundTransfer(
        kind,
        linear=linear if curve else linear[0],
        display=tuple(I.tolist()),
        sigma=_curve_sigma(problem, result, I),
        **told,
    )


def _curve_sigma(problem, result, I):
    """Standard deviation of each display value, None where no trusted pixel tells of it."""
    if result.cov_transfer is None:
        return None
    low, high = np.quantile(problem.photograph.display(), (0.005, 0.995))
    by = Metric(result.state.transfer).by_parameters(result.state.transfer.bare.linear(I))
    sigma = np.sqrt(np.maximum(np.einsum("nk,kl,nl->n", by, result.cov_transfer, by), 0))
    return tuple(float(s) if low <= at <= high else None for s, at in zip(sigma, I, strict=True))


# -- in words


def warnings(problem: Problem, result: Result, described: Materials, found: Gathered) -> list:
    """What the user should know of the values, one line each."""
    lines = [
        _not_identified(name, group, int(found.visible[problem.groups.index(name)]))
        for name, group in described.groups.items()
        if group.rho_d is None
    ]
    lines += [f"{w.text}" for w in described.why]
    if result.misfit > MISFIT:
        lines.append(
            f"the re-rendering differs from the photograph by {result.rmse:.3f} (display), {result.misfit:.0f} times"
            " what noise explains: a lamp, the model, the pose or the transfer function is not as given;"
            " every sigma is widened by as much"
        )
    gamma = result.state.gamma
    if problem.fit_transfer and not len(problem.tile_group):
        lines.append(f"gamma is not determined by any pixel: {gamma} is only where the search would have started")
    if result.sigma_gamma is not None and not GAMMA_RANGE[0] + 0.01 < gamma < GAMMA_RANGE[1] - 0.1:
        lines.append(
            f"gamma = {gamma:.2f} lies on its bound: the lamps' power or the transfer function is not as given"
        )
    lines += _on_bounds(problem, result.state.rho)
    if not result.balanced:
        lines.append(
            f"the light balance is solved to {result.residual:.1g} of its light only: what is found rests on light that"
            " is not the scene's"
        )
    elif described.status == "not converged":
        lines.append("the fit has not converged")
    return lines


def _not_identified(name, group, visible):
    """A note where no pixel shows it: nothing is to be done about it."""
    kind = Note if visible == 0 else str
    why = "no pixel shows it" if visible == 0 else f"none of its {visible} pixels can be trusted"
    taken = "; the balance takes `assumed`, from the seen groups and the light it gives" if group.assumed else ""
    return kind(f"group {name!r} is not identified: {why}{taken}")


def _on_bounds(problem, rho):
    """A line for each group that is seen and fitted and whose reflectance is 0 or 1."""
    judged = problem.seen_groups & np.isnan(problem.rho).any(axis=1)
    if problem.specular is not None:
        judged[list(problem.specular.groups)] = False  # a lobe over black is nothing strange
    on_bound = judged & ((rho > 0.9995) | (rho < 1e-6)).any(axis=1)
    return [
        f"group {problem.groups[g]!r}: a reflectance lies on its bound ({', '.join(f'{v:.4g}' for v in rho[g])}):"
        " a lamp may be weaker or stronger than given"
        for g in np.flatnonzero(on_bound)
    ]
