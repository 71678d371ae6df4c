"""The climb of a photograph that diffuse surfaces do not explain, from its files to the files that it leaves."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.analysis.causes.explained import Explained
from lib.analysis.materials.climbing import Climb
from lib.analysis.materials.ladder import climb
from lib.analysis.materials.site import Site, site_of
from lib.analysis.materials.textures import write_textures
from lib.analysis.seen.gather import Gathered
from lib.core import artefact
from lib.given import image
from lib.given.view import View
from lib.light import specular, specular_file
from lib.light import surface as surfaces
from lib.light.chains import MIRROR
from lib.light.factors_file import FormFactors
from lib.light.paths import DEPTH
from lib.light.specular_file import Traced

NOTEWORTHY = 0.01  # share of the light between mirrors


class Ascent(NamedTuple):
    """The end of a climb, and where it took place."""

    site: Site
    climb: Climb


def ascend(
    view: View,
    factors: FormFactors,
    explained: Explained,
    found: Gathered,
    audit: Gathered,
    *,
    lobe_rays,
    options,
    **climbing,
) -> Ascent:
    """From the diffuse fit to every group's rung. options : of gauss_newton.gauss_newton;  climbing : of ladder.climb

    audit : without the lens's shadow
    """
    explained, view, found = explained.flattened(view, found, **options)
    surface = surfaces.surface(view.model, factors.lamps)
    site = site_of(view, surface, factors, explained.problem, found, audit, lobe_rays=lobe_rays)
    return Ascent(site, climb(site, explained.result, explained.scale, options=options, **climbing))


def warnings(ascent: Ascent) -> list:
    """What the user should know of the light."""
    lost = ascent.site.effort.lost
    if lost <= NOTEWORTHY:
        return []
    return [f"{lost:.0%} of the light is still between mirrors after {DEPTH} of them: rooms of mirrors are too dark"]


def summary(ascent: Ascent) -> dict:
    """For the report: rays by purpose, rounds, excess of each judged group at the end, rungs of those that climbed."""
    names, climb = ascent.site.base.groups, ascent.climb
    return {
        "rays": ascent.site.effort.rays,
        "rounds": climb.rounds,
        "end": {names[g]: m.excess for g, m in climb.misfits.items() if m.judged},
        "rungs": {names[g]: place.rung for g, place in climb.places.items() if place.rung != "diffuse"},
    }


def write_files(ascent: Ascent, folder, specular_path=None, mirror_path=None) -> dict:
    """Albedo maps into folder/textures; specular.npz and mirror.png where there is something to write.

    Returns {group: Textured} of the textured groups.
    """
    textures = write_textures(ascent.site, ascent.climb, Path(folder))
    if ascent.climb.finish is not None and (specular_path or mirror_path):
        traced = _traced(ascent)
        if specular_path:
            specular_file.write(specular_path, traced)
        if mirror_path and len(traced.pixel):
            picture = specular_file.mirror_picture(traced, ascent.site.surface.group, ascent.site.view.shape)
            with artefact.writing(mirror_path) as partial:
                image.write_png16(partial, picture)
    return textures


def _traced(ascent: Ascent) -> Traced:
    """The ways of light at the shapes that lobes have in the end, and what the pixels of mirrors show."""
    site, finish = ascent.site, ascent.climb.finish
    transport = ascent.climb.traced.transport
    if not transport.finish.equals(finish):
        transport = specular.transport(
            site.surface, site.mesh, finish, transport.chains, site.lamps, site.n_lamps, outside=site.outside
        )
    mirrors = np.array(finish.groups)[np.asarray(finish.kind) == MIRROR]
    pixel = site.pixels_of(mirrors)
    view = site.in_mirrors(finish, transport.chains, pixel)[0]
    return Traced(transport, pixel, view, site.factors.lobe_of_lamps)
