"""A scene's balanced light, ready to be looked at from anywhere."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np

from lib.light import lamps, outside, specular
from lib.light.balance import Balance, Patches, balance, stored, times
from lib.light.chains import Chains
from lib.light.factors_file import FormFactors
from lib.light.specular import SpecularLight, Transport
from lib.light.surface import Surface
from lib.picture import albedo_maps, texels
from lib.picture.appearance import Appearance
from lib.picture.light_map import LightMap


@dataclass(frozen=True, eq=False)
class Lighting:
    """lamp_groups : (L,) numbers of the groups that emit, -1 for the outside;  light : of the patches
    lamps : plain and mirrored Emitters, of emittances E (their number, C);  shown : what rays see
    lobes : (L, 4) of the lamp groups
    ways : where rays go on at mirrors and glossy surfaces, None where there are none
    """

    surface: Surface
    appearance: Appearance
    lamp_groups: np.ndarray
    lobes: np.ndarray
    light: Balance
    lamps: list
    E: np.ndarray
    shown: LightMap
    ways: SpecularLight | None = None

    def radiosities(self, irradiance, facet, side, p, seen_along):
        """(M, C): what places p (M, 3) on facets reflect of their irradiance, and what the front of a lamp emits.

        seen_along : (M, 3) directions of view, of any length
        """
        of_lamps = zip(self.lamp_groups, self.lobes, strict=True)
        return radiosities(self.surface, self.appearance, of_lamps, irradiance, facet, side, p, seen_along)


def radiosities(surface: Surface, appearance: Appearance, of_lamps, irradiance, facet, side, p, seen_along):
    """See `Lighting.radiosities`; any irradiance, for example that of eq. 3.1. of_lamps : (group, lobe) of each"""
    group = surface.group[facet]
    B = appearance.rho[group] * irradiance
    for f, texture in appearance.maps.items():
        at = np.flatnonzero(facet == f)
        if len(at):
            B[at] = albedo_maps.lookup(texture, surface, p[at]) * irradiance[at]
    for lamp, (lamp_group, lobe) in enumerate(of_lamps):
        at = (group == lamp_group) & (side & 1 == 0)
        B[at] += appearance.E[lamp] * lamps.thrown(lobe, -seen_along[at])[:, None]
    return B


def lighting(
    surface: Surface,
    factors: FormFactors,
    appearance: Appearance,
    *,
    transport: Transport | None = None,
    n_texels=texels.TEXELS,
    step=None,
    timing=None,
) -> Lighting:
    """The balance of the patches, and the light map that rays see.

    transport : the ways of light past mirrors and glossy surfaces; traced here if there are such and it is not given
    n_texels : about so many in the light map;  step : see texels.light_map
    timing : context manager by label
    """
    timing = timing or (lambda label: contextlib.nullcontext())
    plain = lamps.emitters(surface, factors.lamps, factors.lobes)
    numbers = factors.lamp_groups
    with timing("balance"):
        subcell = factors.subcell
        F = (factors.rows.matrix() @ subcell).tocsr()
        F = stored(F) if appearance.finish is None else F
        patches = Patches(
            factors.patch_group,
            factors.mesh.area,
            factors.rows.exposed,
            factors.mesh.side % 2 == 0,
            np.asarray(F @ np.ones(F.shape[1], np.float32)),
        )
        if appearance.finish is None:
            light = balance(
                [F], [factors.lamp_factor], patches, appearance.rho, appearance.E, numbers, uneven=factors.uneven
            )
            E_lamps = outside.without_outside(appearance.E, factors.lamps)
            coming_in = factors.lamp_factor @ (appearance.E - E_lamps)
            every, E, indirect, ways = plain, appearance.E, light.indirect + coming_in, None
        else:
            if transport is None:
                chains = Chains(len(appearance.finish))
                transport = specular.transport(
                    surface, factors.mesh, appearance.finish, chains, plain, len(appearance.E), outside=factors.outside
                )
            light, indirect, ways = _past_mirrors(F, subcell, factors, patches, appearance, numbers, plain, transport)
            every, E = ways.every, ways.E_every
    with timing("texture"):
        rho_facet = appearance.rho[surface.group]
        exposed = factors.rows.exposed
        glow = outside.Glow.of(factors, appearance.E)
        how = {"glow": glow, "texels": n_texels, "ways": ways, "step": step}
        shown = texels.light_map(surface, factors.mesh, every, E, indirect, exposed, rho_facet, **how)
    return Lighting(surface, appearance, numbers, factors.lobe_of_lamps, light, every, E, shown, ways)


def _past_mirrors(F, subcell, factors, patches, appearance, lamp_groups, plain, transport: Transport):
    """Balance, indirect light of the patches (N, C), SpecularLight: where light goes on at specular surfaces."""
    E, C = appearance.E, appearance.channels
    power = transport.chains.power(appearance.rho_s)
    parts = {k: A @ subcell for k, A in transport.F.items()}
    Fs = [stored(sum((A * power[k, c] for k, A in parts.items()), F).tocsr()) for c in range(C)]
    Ds = [sum((D * power[k, c] for k, D in transport.D.items()), factors.lamp_factor) for c in range(C)]
    mirrored = np.zeros_like(appearance.rho)
    mirrored[list(appearance.finish.groups)] = appearance.rho_s
    around = factors.outside
    leaving = sum((power[k] * D[:, [around.first]] for k, D in transport.D.items()), 0.0) if around else 0.0
    light = balance(
        Fs, Ds, patches, appearance.rho, E, lamp_groups, mirrored=mirrored, leaving=leaving, uneven=factors.uneven
    )
    # mirrored lamps are lamps of their own in the picture; what lobes bring of the lamps is indirect light, and what
    # comes from outside
    E_mirrored = np.array(
        [E[lamp.lamp] * power[k] for lamp, k in zip(transport.mirrored, transport.way, strict=True)]
    ).reshape(-1, C)
    every = plain + [replace(lamp, lamp=len(E) + k) for k, lamp in enumerate(transport.mirrored)]
    direct = factors.lamp_factor @ outside.without_outside(E, factors.lamps) + transport.D_mirrored @ E_mirrored
    whole = times(Ds, E) + times(Fs, light.reflected)
    ways = SpecularLight(
        appearance.finish,
        transport.chains,
        appearance.rho_s,
        plain,
        E,
        every,
        np.vstack([E, E_mirrored]),
        transport.complete,
    )
    return light, whole - direct, ways
