"""materials.json: from stored light and facts to the inverse problem, and from its solution to the file (SCENE.md 4)."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib import reflectance
from lib.stage import BadInput
from lib.transfer import Metric, Transfer

FITTED_AS_LINEAR = ("linear_per_group", "histogram", "histogram_per_group")     # the transfer is the finished picture's


def transfer_of(transfer, linear_photograph) -> Transfer:
    """The transfer function that scene.yaml names, with gamma's usual start where it is to be found."""
    if transfer is None:
        transfer = "linear" if linear_photograph else "gamma"
    if isinstance(transfer, dict):
        return Transfer("gamma", float(transfer["gamma"]))
    if transfer == "gamma":
        return Transfer("gamma", 2.2)
    if transfer == "linear" or transfer in FITTED_AS_LINEAR:
        return Transfer("linear")
    if transfer == "srgb":
        return Transfer("srgb")
    raise BadInput(f"transfer: {transfer!r} is not built yet")


def _channels(value, channels, name):
    value = np.atleast_1d(np.asarray(value, float))
    if channels == 1 and len(value) == 3:
        if np.ptp(value) > 1e-6 * max(1e-12, abs(value).max()):
            raise BadInput(f"{name}: {value.tolist()} is coloured, but the photograph has one channel")
        value = value[:1]
    if len(value) not in (1, channels):
        raise BadInput(f"{name}: {value.tolist()} has not one value per channel")
    return np.broadcast_to(value, channels)


def problem(factors, gathered, *, lamps, reference, transfer) -> reflectance.Problem:
    """Facts and light as one inverse problem. lamps : {name: [E per channel] or "unknown"}; reference : {group: rho}."""
    groups, channels = factors.groups, gathered.pixels.shape[1]
    missing = [f"reference: group {name!r} is not in the model" for name in reference if name not in groups]
    missing += [f"lamps: {name!r}: formfactors.npz has no factors for it" for name in lamps if name not in factors.lamps]
    missing += [f"lamps: {name!r} has factors in formfactors.npz but no emittance" for name in factors.lamps if name not in lamps]
    if missing:
        raise BadInput(*missing)
    E = np.full((len(factors.lamps), channels), np.nan)
    for k, name in enumerate(factors.lamps):
        value = lamps[name]
        if isinstance(value, str):
            continue
        E[k] = _channels(value, channels, f"lamps.{name}")
    if not np.isnan(E).any() and not E.any():
        raise BadInput(f"lamps: {', '.join(lamps)}: every emittance is 0: there is no light to explain the photograph")
    rho = np.full((len(groups), channels), np.nan)
    for name in factors.lamps:
        rho[groups.index(name)] = 0
    for name, value in reference.items():
        rho[groups.index(name)] = _channels(value, channels, f"reference.{name}")
    tiles = gathered.tiles
    model = transfer_of(transfer, gathered.linear)
    fit_gamma = model.kind == "gamma" and not isinstance(transfer, dict)
    subcell = factors.subcell()
    seen_by = lambda rows, half=None: (rows.matrix(half) @ subcell).tocsr()
    return reflectance.Problem(
        F=seen_by(factors.rows), D=factors.lamp_factor, patch_group=factors.patch_group, area=factors.area,
        G=seen_by(tiles.rows), G_plain=tiles.rows.matrix(), D_tile=tiles.direct, tile_group=gathered.group, tile_object=gathered.object, start=tiles.start,
        pixels=gathered.pixels, groups=groups, lamps=factors.lamps, emittance=E, rho=rho, metric=Metric(model), fit_gamma=fit_gamma,
        halves=(*(seen_by(tiles.rows, k) for k in (0, 1)), *(seen_by(factors.rows, k) for k in (0, 1))), group_area=factors.group_area_m2)


def _three(values):
    return [float(v) for v in np.broadcast_to(values, 3)]


@dataclass(frozen=True)
class Textured:
    """The albedo maps of a group. files : {facet number: file beside materials.json};  mean : (C,) over the facets' areas"""
    files: dict
    mean: np.ndarray


def describe(problem, result, gathered, *, scale, transfer, climb=None, textures=None) -> dict:
    """The content of materials.json. One-channel results stand three times.

    climb : ladder.Climb where a group is not diffuse;  textures : {group: Textured}
    """
    state = result.state
    specular = {} if climb is None or climb.finish is None else {g: m for m, g in enumerate(climb.finish.groups)}
    seen = np.isin(np.arange(len(problem.groups)), [*problem.tile_group, *specular])
    reached = np.isin(np.arange(len(problem.groups)), problem.patch_group)
    errors = reflectance.group_rmse(problem, result.tile_residual)
    groups = {}
    for g, name in enumerate(problem.groups):
        if name in problem.lamps:
            continue
        known = not np.isnan(problem.rho[g]).any() and g not in specular
        identified = bool(known or seen[g])
        sigma = None if result.sigma_rho is None or not (seen[g] or known) else _three(result.sigma_rho[g])
        groups[name] = {
            "kind": "diffuse",
            "rho_d": _three(state.rho[g]) if identified else None, "rho_s": [0, 0, 0] if identified else None,
            "alpha": None, "tangent": None, "texture": None,
            "assumed": _three(np.clip(state.rho[g], 0, 1)) if not identified and reached[g] else None,
            "sigma": {"rho_d": sigma},
            "pixels": int(gathered.visible[g]),
            "error": float(errors[g]) if seen[g] and np.isfinite(errors[g]) else None,
            "identified": identified}
        if climb is not None:
            groups[name] |= _of_rung(climb, g, specular.get(g), (textures or {}).get(g), groups[name]["sigma"])
    lamps = {name: {"emittance": _three(state.E[k]),
                    "sigma": None if not np.isnan(problem.emittance[k]).any() or result.sigma_E is None or scale == "convention" else _three(result.sigma_E[k])}
             for k, name in enumerate(problem.lamps)}
    for name, entry in lamps.items():
        reflects = problem.rho[problem.groups.index(name)]
        if reflects.any():                     # a lamp named under `reference`
            entry["rho_d"] = _three(reflects)
    kind = transfer if isinstance(transfer, str) else problem.metric.transfer.kind
    function = {"kind": kind}
    if kind == "gamma":
        function |= {"gamma": float(state.gamma), "sigma": result.sigma_gamma}
    status = "nothing seen" if len(problem.tile_group) == 0 else "converged" if result.converged else "not converged"
    return {"status": status, "groups": groups, "lamps": lamps, "transfer": function, "scale": scale,
            "image": {"rmse": float(result.rmse) if np.isfinite(result.rmse) and len(problem.tile_group) else None, "iterations": int(result.iterations)}}


def _of_rung(climb, g, m, textures, sigma):
    """What a group's rung adds to its entry: g its number, m that among the specular groups, or None."""
    place, state = climb.places[g], climb.result.state
    entry = {"ladder": {"rung": place.rung, "why": place.why, "tried": place.tried}} if place.why else {}
    if g in climb.misfits and (m is not None or place.rung == "textured"):
        entry["error"] = climb.misfits[g].rms
    if place.rung == "textured":
        return entry | {"kind": "textured"} | ({"texture": textures.files, "rho_d": _three(textures.mean)} if textures else {})
    if m is None:
        return entry
    known = climb.problem.specular.rho_s[m]
    entry |= {"kind": "glossy" if place.rung == "anisotropic" else place.rung, "rho_s": _three(state.rho_s[m]),
              "rho_d": _three(np.minimum(state.rho[g], 1 - state.rho_s[m]))}                     # no surface gives back more than it gets
    sigma = sigma | {"rho_s": _three(climb.result.sigma_rho_s[m]) if np.isnan(known).any() else [0.0, 0.0, 0.0]}
    if "mirror" in place.rung:
        sigma["rho_d"] = [0.0, 0.0, 0.0]                              # a mirror has none by what the word means
    else:
        shape = climb.sigma_shape.get(g, {})
        entry |= {"alpha": [float(a) for a in place.alpha], "tangent": [float(x) for x in place.tangent] if place.rung == "anisotropic" else None}
        relative = [shape.get(name, shape.get("alpha", 0.0)) for name in ("alpha_x", "alpha_y")]
        sigma |= {"alpha": [float(a * r) for a, r in zip(place.alpha, relative)]}
        if place.rung == "anisotropic":
            sigma["tangent_rad"] = shape.get("turn")
    return entry | {"sigma": sigma}


def warnings(problem, result, found, gathered):
    """What the user should know of the values, one line each."""
    lines = []
    for g, name in enumerate(problem.groups):
        entry = found["groups"].get(name)
        if entry and not entry["identified"]:
            why = "no pixel shows it" if gathered.visible[g] == 0 else f"none of its {gathered.visible[g]} pixels can be trusted"
            lines.append(f"group {name!r} is not identified: {why}" + ("; the balance takes `assumed`, from the seen groups and the light it gives" if entry["assumed"] else ""))
    if result.misfit > reflectance.MISFIT:
        lines.append(f"the re-rendering differs from the photograph by {result.rmse:.3f} (display), {result.misfit:.0f} times what noise explains: "
                     "a lamp, the model, the pose or the transfer function is not as given; every sigma is widened by as much")
    state = result.state
    if problem.fit_gamma and not len(problem.tile_group):
        lines.append(f"gamma is not determined by any pixel: {state.gamma} is only where the search would have started")
    if problem.fit_gamma and not 0.21 < state.gamma < 7.9:
        lines.append(f"gamma = {state.gamma:.2f} lies on its bound: the lamps' power or the transfer function is not as given")
    seen = np.isin(np.arange(len(problem.groups)), problem.tile_group) & np.isnan(problem.rho).any(axis=1)
    seen[list(problem.specular.groups) if problem.specular is not None else []] = False      # a lobe over black is nothing strange
    for g in np.flatnonzero(seen & ((state.rho > 0.9995) | (state.rho < 1e-6)).any(axis=1)):
        lines.append(f"group {problem.groups[g]!r}: a reflectance lies on its bound ({', '.join(f'{v:.4g}' for v in state.rho[g])}): a lamp may be weaker or stronger than given")
    if found["status"] == "not converged":
        lines.append("the fit has not converged")
    return lines
