"""What mirrors and glossy surfaces add to a picture (§3.3, §4.5): recursive ray tracing, anti-aliased.

A pixel that shows a mirror shows another place in the end. Those places make a *virtual picture*, which is lit exactly
as the real one is: exact lamps, soft shadows, gathered light. Only pixels whose neighbours show another facet, or came
another way, are mixed from sub-pixels. Each sub-pixel takes the light of the pixel beside it that shows the same thing.
A glossy pixel, seen at once or in a mirror, adds the light in its lobe, by rays that look at the same light map as
gathering rays do.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from lib.light.chains import GLOSSY, MIRROR
from lib.light.mirror_view import MirrorView, through_mirrors
from lib.light.surface import backproject
from lib.picture import indirect, pixel_light
from lib.picture import reflections_kernels as kernels
from lib.picture.curved import outside, shade
from lib.picture.glossy import kinds, lobes
from lib.picture.leaves import interpolated
from lib.picture.lighting import Lighting
from lib.picture.pixels import pixels
from lib.picture.subject import Quality, Subject

SUB = 4  # sub-pixels across a mixed pixel of the virtual picture
FRAGMENT_LOBE_RAYS = 32  # of each fragment of a glossy surface


@dataclass(eq=False)
class Reflections:
    """linear : (H, W, C) what specular surfaces add;  facet : (H, W) int32 in the virtual picture, -1;  chain : (H, W)
    indirect : (H, W, C) irradiance that lamps do not send at once, at the places of the virtual picture"""

    linear: np.ndarray
    facet: np.ndarray
    chain: np.ndarray
    indirect: np.ndarray
    facts: dict = field(default_factory=dict)

    @property
    def label(self):
        """(H, W) int: what a pixel shows in mirrors, and by which way; -2 where nothing."""
        return np.where(self.facet >= 0, _label(self.facet, self.chain), -2)


class GlossyPlaces(NamedTuple):
    """Places on glossy surfaces (n,): flat pixels, p (n, 3), facet, unit direction of the view (n, 3), chain."""

    pixel: np.ndarray
    p: np.ndarray
    facet: np.ndarray
    direction: np.ndarray
    chain: np.ndarray


def picture(subject: Subject, lit: Lighting, quality: Quality, light=None) -> Reflections:
    """What mirrors and glossy surfaces add to the pixels that show them at once.

    light : Pixels of the virtual picture -> their irradiance (M, C) by lamps, and by other surfaces; by default found
        here
    """
    H, W = subject.facet.shape
    C = subject.channels
    kind = kinds(subject, subject.facet).reshape(-1)
    out = Reflections(
        np.zeros((H, W, C)), np.full((H, W), -1, np.int32), np.zeros((H, W), np.int32), np.zeros((H, W, C))
    )
    mirror, glossy = mirrors(subject), np.flatnonzero(kind == GLOSSY)
    places = []
    if len(mirror):
        view = mirror_view(subject, lit, mirror)
        _light_virtual_picture(subject, lit, quality, out, mirror, view, light)
        at = np.flatnonzero((view.facet >= 0) & (kinds(subject, view.facet) == GLOSSY))
        places.append(GlossyPlaces(mirror[at], view.p[at], view.facet[at], view.direction[at], view.chain[at]))
        out.facts["mirror_pixels"] = len(mirror)
    if len(glossy):
        f = subject.facet.reshape(-1)[glossy]
        p, _ = backproject(subject.surface, subject.view.camera, f, glossy)
        direction = _rays(subject, glossy % W, glossy // W)[:, 3:].astype(float)
        places.append(GlossyPlaces(glossy, p, f, direction, np.zeros(len(glossy), np.int32)))
    for at in places:
        light = lobes(lit, at.p, at.facet, at.direction, at.chain, quality.lobe_rays)
        out.linear.reshape(H * W, C)[at.pixel] += light
        out.facts["glossy_pixels"] = out.facts.get("glossy_pixels", 0) + len(at.pixel)
    if len(mirror):
        _smooth_edges(subject, lit, out, mirror, quality.steady)
    return out


def mirrors(subject: Subject):
    """(n,) flat pixels that show a mirror at once."""
    return np.flatnonzero(kinds(subject, subject.facet).reshape(-1) == MIRROR)


def _rays(subject, x, y):
    """Unit rays through the places (x, y) of the picture: origin and direction in local coordinates, (n, 6) float32."""
    camera, local = subject.view.camera, subject.surface.local
    v = camera.rays(np.stack([x, y], axis=-1).astype(float))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return np.hstack([np.broadcast_to(local.points(camera.centre), v.shape), v]).astype(np.float32)


def mirror_view(subject: Subject, lit: Lighting, mirror) -> MirrorView:
    """What the pixels `mirror` show in the end: as the fit has found it, or traced now."""
    if subject.traced is not None and np.array_equal(subject.traced.pixel, mirror):
        return subject.traced.view
    W = subject.facet.shape[1]
    rays = _rays(subject, mirror % W, mirror // W)
    return through_mirrors(subject.surface, subject.appearance.finish, lit.ways.chains, rays)


def virtual_pixels(subject: Subject, mirror, view: MirrorView, which=None):
    """The Pixels of the virtual picture. which : (n,) bool, those of `mirror` that are wanted"""
    H, W = subject.facet.shape
    p, side, facet = np.zeros((H * W, 3)), np.zeros(H * W, np.int32), np.full(H * W, -1, np.int32)
    p[mirror], side[mirror] = view.p, view.side
    facet[mirror] = view.facet if which is None else np.where(which, view.facet, -1)
    return pixels(subject.surface, None, facet.reshape(H, W), (p.reshape(H, W, 3), side.reshape(H, W)))


def _light(subject, lit, quality, virtual):
    """Irradiance (M, C) of the virtual picture's pixels, by lamps and by other surfaces."""
    factor, _ = pixel_light.direct(subject.surface, lit.lamps, len(lit.E), virtual, None, many=quality.shadow_rays)
    by_lamps = factor @ lit.E
    leaves = indirect.gather(
        subject.surface,
        lit.shown,
        lit.lamps,
        lit.E,
        virtual,
        by_lamps,
        n_rays=quality.n_rays,
        contact=quality.contact,
        tolerance=quality.tolerance,
    )
    return by_lamps, interpolated(leaves, virtual)


def _light_virtual_picture(subject, lit, quality, out: Reflections, mirror, view: MirrorView, light):
    """Light what mirrors show as the real picture is lit: into out.linear, facet, chain and indirect."""
    H, W = subject.facet.shape
    out.facet.reshape(-1)[mirror], out.chain.reshape(-1)[mirror] = view.facet, view.chain
    virtual = virtual_pixels(subject, mirror, view)
    by_lamps, between = _light(subject, lit, quality, virtual) if light is None else light(virtual)
    along = np.zeros((H * W, 3))
    along[mirror] = view.direction
    along = along[virtual.y * W + virtual.x]
    B = lit.radiosities(by_lamps + between, virtual.facet, virtual.side, virtual.p, along)
    power = lit.ways.chains.power(lit.ways.rho_s)
    out.linear[virtual.y, virtual.x] = B * power[out.chain[virtual.y, virtual.x]]
    out.indirect[virtual.y, virtual.x] = between
    gone, beyond = outside(lit, view)
    out.linear.reshape(H * W, -1)[mirror[gone]] = beyond
    _with_curved(subject, lit, out, mirror, view, quality.lobe_rays)


def _with_curved(subject, lit, out: Reflections, mirror, view: MirrorView, lobe_rays):
    """Smooth surfaces and curved mirrors that mirrors show, into out.linear."""
    if subject.curved is None:
        return
    at = np.flatnonzero(subject.curved.has(view.facet))
    light = subject.curved.light(subject, lit, view.facet[at], view.p[at], view.direction[at], lobe_rays=lobe_rays)
    C = light.shape[1]
    out.linear.reshape(-1, C)[mirror[at]] = light * lit.ways.chains.power(lit.ways.rho_s)[view.chain[at]]


def _label(facet, chain):
    return facet.astype(np.int64) + chain.astype(np.int64) * (1 << 32)


def _smooth_edges(subject, lit, out: Reflections, mirror, steady):
    """Render anew, in place, the mirror's pixels beside an edge of the virtual picture, from SUB x SUB places each.

    Such pixels are mixed, or a shadow in the corner there falls on a part of them.
    """
    H, W = subject.facet.shape
    inside = np.zeros((H, W), bool)
    inside.reshape(-1)[mirror] = True
    label = np.where(inside, _label(out.facet, out.chain), -2)
    edge = np.zeros((H, W), bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)):
        a = (slice(dy, None), slice(max(dx, 0), W + min(dx, 0)))
        b = (slice(None, H - dy), slice(max(-dx, 0), W - max(dx, 0)))
        differs = (label[a] != label[b]) & inside[a] & inside[b]
        edge[a] |= differs
        edge[b] |= differs
    y, x = np.nonzero(edge)
    if not len(y):
        return
    offset = (np.arange(SUB) + 0.5) / SUB - 0.5
    dy, dx = (d.ravel() for d in np.meshgrid(offset, offset, indexing="ij"))
    rays = _rays(subject, (x[:, None] + dx).ravel(), (y[:, None] + dy).ravel())
    view = through_mirrors(subject.surface, subject.appearance.finish, lit.ways.chains, rays)
    number = (np.repeat((y * W + x) * SUB * SUB, SUB * SUB) + np.tile(np.arange(SUB * SUB), len(y))) if steady else None
    B = _shade(subject, lit, out, view, np.repeat(y, SUB * SUB), np.repeat(x, SUB * SUB), number)
    out.linear[y, x] = B.reshape(len(y), SUB * SUB, -1).mean(axis=1)
    out.facts["mixed_pixels"] = len(y)


def _beside(out: Reflections, view: MirrorView, y, x):
    """For `curved.shade`: light of the pixels about (y, x) that show the same."""

    def near(there):
        label = _label(view.facet, view.chain)[there]
        return kernels.beside(out.indirect, out.label, label, y[there], x[there])

    return near


def _shade(subject, lit, out: Reflections, view: MirrorView, y, x, numbers):
    """(n, C) what rays through mirrors show, whose indirect light is known beside (y, x). numbers : of `shade`"""
    return shade(subject, lit, view, _beside(out, view, y, x), numbers=numbers)


def of_fragments(subject: Subject, lit: Lighting, pieces, mirrored: Reflections, *, steady=False):
    """(S, C): what specular surfaces add to the fragments of the mixed pixels of the real picture.

    Of mirrors it is the mean of the rays through each fragment's sub-pixels, of glossy surfaces the lobe at the
    fragment's middle.
    """
    kind = kinds(subject, pieces.facet)
    total = np.zeros((len(pieces.facet), subject.channels))
    W = subject.facet.shape[1]
    sub = np.flatnonzero((pieces.owner >= 0) & (kind[np.maximum(pieces.owner, 0)] == MIRROR))
    if len(sub):
        owner, pixel, k = pieces.owner[sub], pieces.pixel[sub // 64], sub % 64
        rays = _rays(subject, pixel % W + (k % 8 + 0.5) / 8 - 0.5, pixel // W + (k // 8 + 0.5) / 8 - 0.5)
        view = through_mirrors(subject.surface, subject.appearance.finish, lit.ways.chains, rays)
        B = _shade(subject, lit, mirrored, view, pixel // W, pixel % W, 64 * pixel + k if steady else None)
        n = np.maximum(np.bincount(owner, minlength=len(total)), 1)
        for c in range(subject.channels):
            total[:, c] += np.bincount(owner, B[:, c], len(total)) / n
    glossy = np.flatnonzero(kind == GLOSSY)
    if len(glossy):
        direction = pieces.p[glossy] - subject.surface.local.points(subject.view.camera.centre)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        at_once = np.zeros(len(glossy), np.int32)
        total[glossy] += lobes(lit, pieces.p[glossy], pieces.facet[glossy], direction, at_once, FRAGMENT_LOBE_RAYS)
    return total
