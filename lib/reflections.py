"""What mirrors and glossy surfaces add to a picture (sections 3.3 and 4.5): recursive ray tracing, anti-aliased.

A pixel that shows a mirror shows another place in the end. Those places make a *virtual picture*, which is lit exactly as the
real one is (exact lamps, soft shadows, gathered light); only pixels whose neighbours show another facet or came another way are
mixed from sub-pixels, each of which takes the colour of the pixel beside it that shows the same thing. A glossy pixel, seen at
once or in a mirror, adds the light in its lobe, by rays that look at the same textures as gathering rays do.
"""
from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from lib import illumination, specular
from lib.form_factors import CHUNK

SUB = 4              # sub-pixels across a mixed pixel of the virtual picture


@dataclass
class Reflections:
    """linear : (H, W, C) what specular surfaces add;  facet : (H, W) int32 in the virtual picture, -1;  chain : (H, W)
    indirect : (H, W, C) irradiance that lamps do not send at once, at the places of the virtual picture"""
    linear: np.ndarray
    facet: np.ndarray
    chain: np.ndarray
    indirect: np.ndarray = None
    facts: dict = field(default_factory=dict)


def _rays(scene, x, y):
    """Unit rays through the places (x, y) of the picture: origin and direction in local coordinates, (n, 6) float32."""
    v = scene.camera.rays(np.stack([x, y], axis=-1).astype(float))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return np.hstack([np.broadcast_to(scene.surface.local.points(scene.camera.centre), v.shape), v]).astype(np.float32)


def picture(scene, lit, emitted, *, n_rays, shadow_rays, contact, tolerance, lobe_rays) -> Reflections:
    """scene : rendering.Scene;  lit : rendering.Lighting;  emitted : (irradiance, facet, side, p) -> radiosity"""
    surface, finish, ways = scene.surface, scene.finish, lit.ways
    H, W = scene.facet.shape
    C = scene.channels
    of, _ = finish.facets(surface)
    kind = np.where(scene.facet >= 0, np.append(finish.kind, 0)[of[np.maximum(scene.facet, 0)]], 0)
    out = Reflections(np.zeros((H, W, C)), np.full((H, W), -1, np.int32), np.zeros((H, W), np.int32))
    places = []                                   # of glossy surfaces: pixel, p, facet, direction, chain
    mirror = np.flatnonzero((kind == specular.MIRROR).reshape(-1))
    if len(mirror):
        view = specular.through_mirrors(surface, finish, ways.chains, _rays(scene, mirror % W, mirror // W))
        power = ways.chains.power(ways.rho_s)
        at, side, chain = np.zeros((H, W, 3)), np.zeros((H, W), np.int32), out.chain
        flat = lambda array: array.reshape(H * W, *array.shape[2:])
        flat(out.facet)[mirror], flat(at)[mirror], flat(side)[mirror], flat(chain)[mirror] = view.facet, view.p, view.side, view.chain
        virtual = illumination.pixels(surface, None, out.facet, (at, side))
        factor, _ = illumination.direct(surface, lit.lamps, len(lit.E), virtual, None, many=shadow_rays)
        irradiance = factor @ lit.E
        leaves = illumination.gather(surface, lit.shown, lit.lamps, lit.E, virtual, irradiance, n_rays=n_rays, contact=contact, tolerance=tolerance)
        indirect = illumination.interpolated(leaves, virtual)
        B = emitted(irradiance + indirect, virtual.facet, virtual.side, virtual.p)
        out.linear[virtual.y, virtual.x] = B * power[chain[virtual.y, virtual.x]]
        out.indirect = np.zeros((H, W, C))
        out.indirect[virtual.y, virtual.x] = indirect
        glossy = np.flatnonzero((view.facet >= 0) & (np.append(finish.kind, 0)[of[np.maximum(view.facet, 0)]] == specular.GLOSSY))
        places.append((mirror[glossy], view.p[glossy], view.facet[glossy], view.direction[glossy], view.chain[glossy]))
        out.facts["mirror_pixels"] = len(mirror)
    glossy = np.flatnonzero((kind == specular.GLOSSY).reshape(-1))
    if len(glossy):
        from lib.gather import backproject
        f = scene.facet.reshape(-1)[glossy]
        p, _ = backproject(surface, scene.camera, f, glossy)
        places.append((glossy, p, f, _rays(scene, glossy % W, glossy // W)[:, 3:].astype(float), np.zeros(len(glossy), np.int32)))
    for pixel, p, f, direction, chain in places:
        out.linear.reshape(H * W, C)[pixel] += lobes(scene, lit, p, f, direction, chain, lobe_rays)
        out.facts["glossy_pixels"] = out.facts.get("glossy_pixels", 0) + len(pixel)
    if len(mirror):
        _smooth_edges(scene, lit, out, emitted, mirror)
    return out


def lobes(scene, lit, p, facet, direction, chain, n_rays, *, seed=19):
    """(n, C) light in the lobes of places p (n, 3) on glossy facets, seen along unit directions (n, 3) by way of chains (n,)."""
    total = np.zeros((len(p), scene.channels))
    step = max(1, CHUNK // n_rays)
    for a in range(0, len(p), step):
        b = min(len(p), a + step)
        m = b - a
        begin = specular.from_views(scene.surface, np.arange(m + 1) * n_rays, np.arange(m + 1), p[a:b], facet[a:b], direction[a:b], chain[a:b])
        start, _ = begin(0, m)
        total[a:b] = illumination.beyond(scene.surface, lit.shown, start, np.repeat(np.arange(m), n_rays), m, seed=seed) / n_rays
    return total


def _label(facet, chain):
    return facet.astype(np.int64) + chain.astype(np.int64) * (1 << 32)


def _smooth_edges(scene, lit, out, emitted, mirror):
    """Render anew, in place, from SUB x SUB places each, the mirror's pixels that lie beside an edge of the virtual picture: they are mixed,
    or a shadow in the corner there falls on a part of them."""
    H, W = scene.facet.shape
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
    view = specular.through_mirrors(scene.surface, scene.finish, lit.ways.chains, _rays(scene, (x[:, None] + dx).ravel(), (y[:, None] + dy).ravel()))
    B = shade(scene, lit, out, view, emitted, np.repeat(y, SUB * SUB), np.repeat(x, SUB * SUB))
    out.linear[y, x] = B.reshape(len(y), SUB * SUB, -1).mean(axis=1)
    out.facts["mixed_pixels"] = len(y)


def shade(scene, lit, out, view, emitted, y, x):
    """(n, C) what rays through mirrors show: lamps with few shadow rays each, other light from the pixels about (y, x) that show the
    same, and from the texture where there are none."""
    from lib import form_factors
    power = lit.ways.chains.power(lit.ways.rho_s)
    there = np.flatnonzero(view.facet >= 0)
    B = np.zeros((len(view.facet), scene.channels))
    p, side = view.p[there], view.side[there].astype(np.int32)
    irradiance = form_factors.direct(scene.surface, lit.lamps, p, form_factors.side_normals(scene.surface), side, len(lit.E), n_samples=4) @ lit.E
    near, found = _beside(out.indirect, np.where(out.facet >= 0, _label(out.facet, out.chain), -2), _label(view.facet, view.chain)[there], y[there], x[there])
    lost = np.flatnonzero(~found)
    near[lost] = illumination.looked_up(lit.shown.between, lit.shown, scene.surface, p[lost], side[lost])
    B[there] = emitted(irradiance + near, view.facet[there], side, p) * power[view.chain[there]]
    glossy = there[np.isin(scene.surface.group[view.facet[there]], [g for g, k in zip(scene.finish.groups, scene.finish.kind) if k == specular.GLOSSY])]
    if len(glossy):
        B[glossy] += lobes(scene, lit, view.p[glossy], view.facet[glossy], view.direction[glossy], view.chain[glossy], 8)
    return B


@njit(cache=True)
def _beside(values, label, wanted, y, x):
    """The mean of the 3 x 3 pixels' values that bear the wanted label, and whether there is one."""
    H, W, C = values.shape
    out = np.zeros((len(y), C))
    found = np.zeros(len(y), np.bool_)
    for i in range(len(y)):
        n = 0
        for b in range(max(y[i] - 1, 0), min(y[i] + 1, H - 1) + 1):
            for a in range(max(x[i] - 1, 0), min(x[i] + 1, W - 1) + 1):
                if label[b, a] == wanted[i]:
                    n += 1
                    for c in range(C):
                        out[i, c] += values[b, a, c]
        if n > 0:
            found[i] = True
            for c in range(C):
                out[i, c] /= n
    return out, found


def of_fragments(scene, lit, pieces, reflections):
    """(S, C): what specular surfaces add to the fragments of the mixed pixels of the real picture: of mirrors, the rays through each
    one's sub-pixels; of glossy ones, the lobe at its middle."""
    surface, finish = scene.surface, scene.finish
    of, _ = finish.facets(surface)
    kind = np.append(finish.kind, 0)[of[pieces.facet]]
    total = np.zeros((len(pieces.facet), scene.channels))
    W = scene.facet.shape[1]
    sub = np.flatnonzero((pieces.owner >= 0) & (kind[np.maximum(pieces.owner, 0)] == specular.MIRROR))
    if len(sub):
        if reflections.indirect is None:
            reflections.indirect = np.zeros((*scene.facet.shape, scene.channels))
        owner = pieces.owner[sub]
        pixel = pieces.pixel[sub // 64]
        k = sub % 64
        rays = _rays(scene, pixel % W + (k % 8 + 0.5) / 8 - 0.5, pixel // W + (k // 8 + 0.5) / 8 - 0.5)
        view = specular.through_mirrors(surface, finish, lit.ways.chains, rays)
        B = shade(scene, lit, reflections, view, lambda irradiance, facet, side, p: _emitted(scene, irradiance, facet, side, p), pixel // W, pixel % W)
        n = np.maximum(np.bincount(owner, minlength=len(total)), 1)
        for c in range(scene.channels):
            total[:, c] += np.bincount(owner, B[:, c], len(total)) / n
    glossy = np.flatnonzero(kind == specular.GLOSSY)
    if len(glossy):
        pixel = np.repeat(pieces.pixel, np.diff(pieces.start))[glossy]
        direction = pieces.p[glossy] - surface.local.points(scene.camera.centre)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        total[glossy] += lobes(scene, lit, pieces.p[glossy], pieces.facet[glossy], direction, np.zeros(len(glossy), np.int32), 32)
    return total


def _emitted(scene, irradiance, facet, side, p):
    from lib.rendering import radiosities
    return radiosities(irradiance, scene.surface, facet, side, scene.rho, scene.E, scene.lamp_groups, p, scene.textures)
