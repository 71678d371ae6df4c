"""Albedo maps of textured groups, the last rung: the photograph over the light of each pixel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.analysis.fit.misfits import misfit
from lib.analysis.materials.climbing import Climb
from lib.analysis.materials.site import Site
from lib.given.transfer import Metric
from lib.light.surface import facet_areas
from lib.picture import albedo_maps, indirect, pixel_light
from lib.picture.appearance import Appearance
from lib.picture.leaves import interpolated
from lib.picture.lighting import lighting
from lib.picture.pixels import pixels

FOLDER = "textures"  # beside materials.json


@dataclass(frozen=True, eq=False)
class Textured:
    """The albedo maps of a group.

    files : {facet number: file beside materials.json};  mean : (C,) over the facets' areas
    unseen : (C,) its standard deviation, by what no pixel shows of them
    """

    files: dict
    mean: np.ndarray
    unseen: np.ndarray


def albedo_maps_of(site: Site, climb: Climb) -> dict:
    """{group: {facet: AlbedoMap}} of the textured groups. Their misfits become those that are left with the maps."""
    groups = climb.on("textured")
    if not groups:
        return {}
    surface, state, view = site.surface, climb.result.state, site.view
    transport = climb.traced.transport if climb.traced else None
    if transport is not None and not transport.finish.equals(climb.finish):
        transport = None
    look = Appearance(state.rho, state.E, climb.finish, state.rho_s)
    lit = lighting(surface, site.factors, look, transport=transport)
    facet = np.where(np.isin(surface.group[np.maximum(view.facet, 0)], groups), view.facet, -1)
    seen = pixels(surface, view.camera, facet)
    factor, _ = pixel_light.direct(surface, lit.lamps, len(lit.E), seen, view.camera)
    by_lamps = factor @ lit.E
    leaves = indirect.gather(surface, lit.shown, lit.lamps, lit.E, seen, by_lamps)
    irradiance = np.zeros((*facet.shape, site.channels))
    irradiance[seen.y, seen.x] = by_lamps + interpolated(leaves, seen)
    metric = Metric(state.transfer)
    linear = metric.transfer.linear(view.photograph.values)
    level = np.median(linear[facet >= 0], axis=0) if (facet >= 0).any() else np.ones(site.channels)
    # one noise for all: noise by pixel would weigh dark ones more
    noise = float(np.mean(climb.problem.pixel_noise / metric.slope(level)))
    found = {}
    for g in groups:
        wanted = [int(f) for f in np.unique(facet[facet >= 0]) if surface.group[f] == g]
        usable = site.pure & np.isin(facet, wanted)
        found[g] = albedo_maps.albedo_maps(
            surface, view.camera, facet, usable, linear, irradiance, noise, state.rho[g], wanted
        )
        mine = np.flatnonzero(usable[seen.y, seen.x])
        if len(mine):
            y, x = seen.y[mine], seen.x[mine]
            B = np.zeros((len(mine), site.channels))
            for f, texture in found[g].items():
                at = np.flatnonzero(seen.facet[mine] == f)
                B[at] = albedo_maps.lookup(texture, surface, seen.p[mine[at]]) * irradiance[y[at], x[at]]
            climb.misfits[g] = misfit(climb.problem, state.transfer, B, linear[y, x], np.ones(len(mine)))
    site.effort.note("textured pixels", len(seen))
    return found


def write_textures(site: Site, climb: Climb, folder) -> dict:
    """{group: Textured} of the textured groups that a pixel shows, their maps written to folder/textures."""
    written = {}
    for g, maps in albedo_maps_of(site, climb).items():
        if not maps:  # said to be textured, and no pixel shows it
            continue
        (Path(folder) / FOLDER).mkdir(exist_ok=True)
        area = facet_areas(site.surface)[list(maps)]
        files = {
            f: f"{FOLDER}/{Path(albedo_maps.write(Path(folder) / FOLDER, texture)).name}" for f, texture in maps.items()
        }
        share = area / area.sum()
        mean = share @ [albedo_maps.mean(texture) for texture in maps.values()]
        written[g] = Textured(files, mean, share @ [albedo_maps.unseen(texture) for texture in maps.values()])
    return written
