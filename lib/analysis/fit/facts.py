"""What scene.yaml says and what was gathered, as one inverse problem."""

from __future__ import annotations

import numpy as np

from lib.analysis.fit.problem import Halves, Problem
from lib.analysis.seen.gather import Gathered
from lib.core.stage import BadInput
from lib.given.transfer import CURVES, Transfer
from lib.given.transfer_kinds import OF_PICTURE
from lib.light import outside
from lib.light.corrected import Corrected
from lib.light.factors_file import OUTSIDE, FormFactors

USUAL_GAMMA = 2.2


def transfer_of(transfer, linear_photograph) -> Transfer:
    """The transfer function that scene.yaml names, with gamma's usual start where it is to be found.

    transfer : as in scene.yaml, None, or the Transfer that its file holds
    """
    if transfer in (None, "auto"):
        transfer = "linear" if linear_photograph else "gamma"
    if isinstance(transfer, Transfer):
        return transfer
    if isinstance(transfer, dict):
        return Transfer("gamma", float(transfer["gamma"]))
    if transfer == "gamma":
        return Transfer("gamma", USUAL_GAMMA)
    if transfer == "linear" or transfer in OF_PICTURE:
        return Transfer("linear")
    if transfer == "curve":
        return Transfer("gamma", USUAL_GAMMA).as_curve()
    if transfer in CURVES:
        return Transfer(transfer)
    raise BadInput(f"transfer: {transfer!r} is not built yet")


def problem_of(factors: FormFactors, found: Gathered, *, lamps, reference, transfer) -> Problem:
    """Facts and light as one inverse problem; what lies outside is dark.

    lamps : {name: [E per channel] or "unknown"};  reference : {group: rho};  transfer : as in scene.yaml, or None
    BadInput: names that the model has not, colours in a grey photograph, lamps that are all dark.
    """
    _check_names(factors, lamps, reference)
    tiles, channels = found.tiles, found.pixels.shape[1]
    model = transfer_of(transfer, found.linear)
    subcell = factors.subcell
    seen_by = lambda rows, half=None: Corrected(rows.matrix(half), subcell)
    return Problem(
        F=seen_by(factors.rows),
        D=factors.lamp_factor,
        patch_group=factors.patch_group,
        area=factors.area,
        G=seen_by(tiles.rows),
        G_plain=tiles.rows.matrix(),
        D_tile=tiles.direct,
        tile_group=found.group,
        tile_object=found.object,
        start=tiles.start,
        pixels=found.pixels,
        block_noise=found.block_noise,
        colour_noise=found.colour_noise if found.colour_noise.any() else None,
        noisy=found.noisy,
        edge_noise=found.edge_noise if found.edge_noise.any() else None,
        groups=factors.groups,
        lamps=factors.lamps,
        emittance=_emittances(factors.lamps, lamps, channels),
        rho=_known_reflectances(factors, reference, channels),
        transfer=model,
        fit_transfer=len(model.parameters) > 0 and not isinstance(transfer, dict),
        halves=Halves(
            *(seen_by(tiles.rows, k) for k in (0, 1)),
            *(seen_by(factors.rows, k) for k in (0, 1)),
            outside.halves(factors, tiles.direct, tiles.rows),
        ),
        group_area=factors.group_area_m2,
        shown=int(found.visible.sum()),
    )


def _check_names(factors, lamps, reference):
    problems = [f"reference: group {name!r} is not in the model" for name in reference if name not in factors.groups]
    problems += [
        f"lamps: {name!r}: formfactors.npz has no factors for it" for name in lamps if name not in factors.lamps
    ]
    problems += [
        f"lamps: {name!r} has factors in formfactors.npz but no emittance"
        for name in factors.own_lamps
        if name not in lamps
    ]
    if problems:
        raise BadInput(*problems)


def _emittances(names, lamps, channels):
    """(L, C), NaN where unknown."""
    E = np.full((len(names), channels), np.nan)
    for k, name in enumerate(names):
        if name in OUTSIDE:
            E[k] = 0
        elif not isinstance(lamps[name], str):
            E[k] = _channels(lamps[name], channels, f"lamps.{name}")
    if not np.isnan(E).any() and not E.any():
        raise BadInput(f"lamps: {', '.join(lamps)}: every emittance is 0: there is no light to explain the photograph")
    return E


def _known_reflectances(factors, reference, channels):
    """(G, C): 0 for lamps, the given values for references, NaN else."""
    rho = np.full((len(factors.groups), channels), np.nan)
    for name in factors.own_lamps:
        rho[factors.groups.index(name)] = 0
    for name, value in reference.items():
        rho[factors.groups.index(name)] = _channels(value, channels, f"reference.{name}")
    return rho


def _channels(value, channels, name):
    value = np.atleast_1d(np.asarray(value, float))
    if channels == 1 and len(value) == 3:
        if np.ptp(value) > 1e-6 * max(1e-12, abs(value).max()):
            raise BadInput(f"{name}: {value.tolist()} is coloured, but the photograph has one channel")
        value = value[:1]
    if len(value) not in (1, channels):
        raise BadInput(f"{name}: {value.tolist()} has not one value per channel")
    return np.broadcast_to(value, channels)
