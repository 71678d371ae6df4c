"""How surfaces and lamps look, as arrays that a rendering multiplies: materials.json for the groups of one model."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lib.core.stage import BadInput
from lib.given import materials as materials_file
from lib.light.chains import GLOSSY, MIRROR, Finish
from lib.light.factors_file import OUTSIDE
from lib.picture import albedo_maps


@dataclass(frozen=True, eq=False)
class Appearance:
    """G groups, L lamps, C channels, M groups that are mirrors or glossy.

    rho : (G, C) diffuse reflectance;  E : (L, C) emittance
    finish, rho_s : of the M groups, (M, C); None where there are none;  maps : {facet: AlbedoMap}, which stand for rho
    """

    rho: np.ndarray
    E: np.ndarray
    finish: Finish | None = None
    rho_s: np.ndarray | None = None
    maps: dict = field(default_factory=dict)

    @property
    def channels(self):
        return self.rho.shape[1]


def read(path, groups, lamps, channels, n_facets):
    """(Appearance, materials.Materials, warnings) of materials.json.

    groups : names of the model's groups;  lamps : names of those that emit, with the outside or without
    channels : of the photograph

    A group never seen takes the value that was `assumed`. One without any value is black, with a warning.
    BadInput: what cannot be rendered, one line for each value.
    """
    found = materials_file.read(path)
    look, warnings = of(found, path, groups, lamps, channels, n_facets)
    return look, found, warnings


def of(found, path, groups, lamps, channels, n_facets):
    """(Appearance, warnings) of what `path` held."""
    problems = [f"{path}: {problem}" for problem in _problems(found, groups, lamps)]
    if problems:
        raise BadInput(*problems)
    rho, E = np.zeros((len(groups), channels)), np.zeros((len(lamps), channels))
    specular, warnings = [], []
    for g, name in enumerate(groups):
        if name in lamps:
            continue
        group = found.groups[name]
        if group.is_specular:
            specular.append((g, group))
        if group.in_balance is None:
            warnings.append(f"group {name!r} has no reflectance, measured or assumed: it is rendered black")
        else:
            rho[g] = group.in_balance[:channels]
    for k, name in enumerate(lamps):
        if name in OUTSIDE:
            E[k] = found.outside[OUTSIDE.index(name)][:channels]
            continue
        lamp = found.lamps[name]
        E[k] = lamp.emittance[:channels]
        if lamp.rho_d is not None:  # a lamp that is a reference too reflects that much
            rho[groups.index(name)] = lamp.rho_d[:channels]
    finish, rho_s = _finish(specular, channels)
    return Appearance(rho, E, finish, rho_s, _maps(path, found, n_facets, channels)), warnings


def _problems(found, groups, lamps):
    """Yields what is missing for a rendering, "field: what"."""
    for name in groups:
        group = found.groups.get(name)
        if name in lamps:
            continue
        if group is None:
            yield f"group {name!r}: missing"
        elif group.is_specular:
            needed = ("rho_s",) if group.is_mirror else ("rho_s", "alpha")
            missing = [key for key in needed if getattr(group, key) is None]
            yield from (f"group {name!r}: {key} = None: a {group.kind} group needs it" for key in missing)
    for name in lamps:
        if name in OUTSIDE:
            continue
        lamp = found.lamps.get(name)
        if lamp is None or lamp.emittance is None:
            yield f"lamp {name!r}: {'missing' if lamp is None else 'emittance = None'}"
    transfer = found.transfer
    needed = {None: "kind", "gamma": "gamma", "curve": "linear"}.get(transfer.kind)
    if needed and not getattr(transfer, needed):
        yield f"transfer: {needed}: missing"


def _finish(specular, channels):
    """Finish and rho_s (M, C) of [(number, materials.Group)], or None, None."""
    if not specular:
        return None, None
    numbers, groups = zip(*specular, strict=True)
    finish = Finish(
        numbers,
        np.array([MIRROR if group.is_mirror else GLOSSY for group in groups]),
        np.array([group.alpha or (0.0, 0.0) for group in groups]),
        np.array([group.tangent or (0.0, 0.0, 0.0) for group in groups]),
    )
    return finish, np.array([group.rho_s[:channels] for group in groups])


def _maps(path, found, n_facets, channels):
    """{facet: AlbedoMap} of the files that materials.json names, relative to its folder."""
    maps = {}
    for files in found.texture_files(path).values():
        for facet, file in files.items():
            if facet >= n_facets:
                raise BadInput(f"{path}: texture: facet {facet} is not in the model, which has {n_facets}")
            if not file.is_file():
                raise BadInput(f"{path}: texture: facet {facet}: {file} is not there")
            maps[facet] = albedo_maps.read(file)
            if maps[facet].albedo.shape[2] != channels:
                held = maps[facet].albedo.shape[2]
                raise BadInput(f"{file}: channels: {held} are not the photograph's {channels}")
    return maps
