"""§3.3 The picture: what the camera sees of the balanced light (eq. 3.2).

    subject = read(camera=..., model=..., ...)    # lib/picture/subject.py: files, checked against each other
    picture = render(subject)                     # linear, anti-aliased

The patches' balance is one small linear solve; the modules beside this one take its light to the pixels. Mixed pixels
are the mean of their fragments by area (the A-buffer). Colours are channels C (1 or 3); a radiosity is camera-referred.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np

from lib.given.cameras import Camera
from lib.given.image import Photograph
from lib.given.transfer import Transfer
from lib.given.view import View
from lib.light import adapt, form_factors, lamps
from lib.light.balance import Balance
from lib.light.chains import GLOSSY, MIRROR, Finish
from lib.light.factors_file import FormFactors
from lib.light.small_room import small_room
from lib.light.surface import side_normals
from lib.picture import curved, fragments, indirect, light_map, pixel_light, reflections
from lib.picture.appearance import Appearance
from lib.picture.fragments import Fragments
from lib.picture.leaves import interpolated
from lib.picture.lighting import Lighting, lighting
from lib.picture.pixels import Pixels, pixels
from lib.picture.subject import STANDARD, Quality, Subject


@dataclass(frozen=True, eq=False)
class Picture:
    """linear : (H, W, C), anti-aliased;  facts : for the report"""

    linear: np.ndarray
    light: Balance
    pixels: Pixels
    fragments: Fragments
    facts: dict


def render(subject: Subject, quality: Quality = STANDARD, *, timing=None, trace=None) -> Picture:
    """The linear picture of the subject.

    timing : context manager by label;  trace : called with the state of each refinement
    """
    timing = timing or (lambda label: contextlib.nullcontext())
    lit = lighting(
        subject.surface,
        subject.factors,
        subject.appearance,
        transport=subject.traced and subject.traced.transport,
        n_texels=quality.n_texels,
        step=quality.step,
        timing=timing,
    )
    return of_lit(subject, lit, quality, timing=timing, trace=trace)


def of_lit(subject: Subject, lit: Lighting, quality: Quality, *, timing, trace=None) -> Picture:
    """The same where the light is known already: it does not depend on the camera."""
    surface, camera = subject.surface, subject.view.camera
    with timing("direct"):
        seen = pixels(surface, camera, subject.facet)
        factor, penumbra = pixel_light.direct(surface, lit.lamps, len(lit.E), seen, camera, many=quality.shadow_rays)
        by_lamps = factor @ lit.E
    with timing("indirect"):
        leaves = indirect.gather(
            surface,
            lit.shown,
            lit.lamps,
            lit.E,
            seen,
            by_lamps,
            n_rays=quality.n_rays,
            contact=quality.contact,
            tolerance=quality.tolerance,
            trace=trace,
        )
        between = interpolated(leaves, seen)
    picture = finished(subject, lit, quality, seen, by_lamps, between, timing=timing)
    return replace(picture, facts=_facts(lit, penumbra, leaves) | picture.facts)


def finished(
    subject: Subject, lit: Lighting, quality: Quality, seen: Pixels, by_lamps, between, *, timing, virtual=None
) -> Picture:
    """The picture where the pixels of one facet are lit: what they reflect, what mirrors add, and mixed pixels.

    by_lamps, between : (M, C) irradiance of `seen`, by lamps and by other surfaces
    virtual : the same of what mirrors show, see reflections.picture
    """
    surface, camera = subject.surface, subject.view.camera
    eye = surface.local.points(camera.centre)
    B = lit.radiosities(by_lamps + between, seen.facet, seen.side, seen.p, seen.p - eye)
    mirrored = None
    if subject.appearance.finish is not None:
        with timing("reflections"):
            mirrored = reflections.picture(subject, lit, quality, virtual)
            B += mirrored.linear[seen.y, seen.x]
    if subject.curved is not None:
        with timing("curved"):
            B = curved.of_pixels(subject, lit, seen, B)
    with timing("antialias"):
        pieces = fragments.fragments(surface, camera, subject.coverage)
        B_there = _of_fragments(subject, lit, seen, by_lamps, between, pieces, quality.steady)
        if mirrored is not None:
            B_there += reflections.of_fragments(subject, lit, pieces, mirrored, steady=quality.steady)
        if subject.curved is not None:
            B_there = curved.of_fragments(subject, lit, pieces, B_there)
        linear = compose(subject.facet.shape, seen, B, pieces, B_there)
    facts = {} if mirrored is None else {"reflections": mirrored.facts}
    return Picture(linear, lit.light, seen, pieces, facts)


def _facts(lit, penumbra, leaves):
    """For the report."""
    light = lit.light
    return {
        "iterations": light.iterations,
        "residual": light.residual,
        "penumbra_pixels": penumbra,
        "places": len(leaves),
        "gathering_rays": leaves.rays.sum(),
        "texels": len(lit.shown.value),
        "flux": {"emitted": light.emitted, "absorbed": light.absorbed, "escaped": light.escaped},
    }


def _of_fragments(subject, lit, seen, by_lamps, between, pieces, steady):
    """(S, C) radiosity of the fragments of mixed pixels: lamps exactly, other light from pure pixels beside them."""
    size = (*subject.facet.shape, subject.channels)
    direct_picture, indirect_picture = np.zeros(size), np.zeros(size)
    direct_picture[seen.y, seen.x], indirect_picture[seen.y, seen.x] = by_lamps, between
    direct = fragments.fragment_direct(subject.surface, lit.lamps, len(lit.E), pieces, steady=steady) @ lit.E
    unseen = np.flatnonzero(~pieces.seen)
    direct[unseen] = fragments.beside(direct_picture, subject.facet, pieces)[0][unseen]
    others, found = fragments.beside(indirect_picture, subject.facet, pieces)
    thin = np.flatnonzero(~found)
    p, side = pieces.p[thin], pieces.side[thin]
    others[thin] = light_map.looked_up(lit.shown.between, lit.shown, subject.surface, p, side)
    eye = subject.surface.local.points(subject.view.camera.centre)
    return lit.radiosities(direct + others, pieces.facet, pieces.side, pieces.p, pieces.p - eye)


def compose(shape, seen: Pixels, B, pieces: Fragments, B_fragment):
    """(H, W, C) linear: pixels of one facet show its radiosity, mixed ones their fragments' mean by area.

    B : (M, C) of the pixels seen;  B_fragment : (S, C)
    """
    picture = np.zeros((*shape, B.shape[1]))
    picture[seen.y, seen.x] = B
    mixed = np.zeros((len(pieces.pixel), B.shape[1]))
    owner = np.repeat(np.arange(len(pieces.pixel)), np.diff(pieces.start))
    np.add.at(mixed, owner, B_fragment * pieces.share[:, None])
    picture.reshape(-1, B.shape[1])[pieces.pixel] = mixed
    return picture


def warm_up(channels, shiny=False):
    """Load or compile every kernel of a rendering.

    shiny : those of mirrors and lobes, too
    """
    surface = small_room("wall", *(("mirror", "gloss") if shiny else ("wall", "wall")), "wall", "lamp", "wall")
    emitters = lamps.emitters(surface, ["lamp"])
    mesh = adapt.build(surface, patches=20, max_level=0, contrast=1.0, emitters=emitters)
    factor = lamps.direct(surface, emitters, mesh.centre, side_normals(surface), mesh.side, 1, n_samples=4)
    rows, groups = form_factors.rays(surface, mesh, n_rays=16), surface.groups
    area = np.ones(len(groups))
    factors = FormFactors(mesh, rows, factor, ("lamp",), surface.group[mesh.side // 2], groups, area, 1.0)
    T = np.array([[1, 0, 0, -0.5], [0, 0, -1, 0.5], [0, 1, 0, 1.0], [0, 0, 0, 1]])
    camera = Camera(np.array([[6.0, 0, 3], [0, 6, 3], [0, 0, 1]]), 7, 7, T)
    origin = np.broadcast_to(surface.local.points(camera.centre), (49, 3))
    rays = np.hstack([origin, camera.rays(camera.pixels().reshape(-1, 2))]).astype(np.float32)
    triangle, _ = surface.caster.closest(rays)
    facet = np.where(triangle >= 0, surface.facet[triangle], -1).reshape(7, 7).astype(np.int32)
    coverage = {
        "pixel": np.arange(1, dtype=np.int32),
        "start": np.array([0, 1], np.int32),
        "facet": facet[0, :1],
        "count": np.array([64], np.uint8),
    }
    photograph = Photograph(np.full((7, 7, channels), 0.5), 8, False, channels)
    look = Appearance(np.full((len(groups), channels), 0.5), np.ones((1, channels)))
    if shiny:
        alpha, tangent = np.array([[0, 0], [0.2, 0.1]]), np.array([[0, 0, 0], [0, 0, 1.0]])
        finish = Finish((1, 2), np.array([MIRROR, GLOSSY]), alpha, tangent)
        look = Appearance(look.rho, look.E, finish, np.full((2, channels), 0.5))
    view = View(camera, photograph=photograph, facet=facet)
    render(
        Subject(view, surface, factors, coverage, look, Transfer("linear")),
        Quality(n_rays=16, lobe_rays=4, n_texels=200),
    )
