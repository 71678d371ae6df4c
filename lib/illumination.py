"""The light that a camera's pixels receive from a balanced scene (section 3.3): direct, indirect, and in mixed pixels.

*Direct*: the exact factor of the lamp's polygon times its visible share, by shadow rays from all over the pixel: few
everywhere, many where neighbouring pixels disagree (penumbra). *Indirect*: smooth, so it is gathered by many rays at few
places, the leaves of one quadtree over the picture per facet (finer near contacts and where neighbours cannot foretell
it), and spread over the facet's pixels by local linear fits. A gathering ray does not look at patches, which would show as
blotches near corners, but at a *texture* of every facet: direct light evaluated again at each texel, indirect light fitted
through the patches and gathered once more by rays. *Mixed pixels* (the A-buffer's fragments) are lit where they are seen.

Colours are channels C (1 or 3); geometry is local (see lib.rays); a radiosity is camera-referred.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit, prange

from lib import form_factors
from lib.form_factors import CHUNK
from lib.mesh import Mesh, Surface
from lib.rays import OFFSET, shifts, sobol

TEXELS = 30_000         # about so many texels in a scene
NEAR = 3.0              # texels: what a gathering ray meets within so many is lit by itself
MANY = 16               # triangles of a lamp above which its light is interpolated between pixels
FAR = 10.0              # local coordinates are smaller: facets this far apart do not mix in a search


# -- what a gathering ray sees: a texture of every side

@dataclass(frozen=True)
class Texture:
    """A grid of texels over each side's bounding rectangle, values at their centres.

    start : (2 F,) int64 into value, -1: nothing reflects there      shape : (2 F, 2) int32      value : (K, C) float32
    irradiance : (K, C)  the same before reflection                good : (K,) bool, in the facet and outside solids
    direct : (K, C) the part of `value` that comes from the lamps at once        between : (K, C) irradiance from others
    open : (K, emitters) float32 factor to each emitter if nothing stood in between        step : local, about the width of a texel
    rho : (F, C)
    """
    start: np.ndarray
    shape: np.ndarray
    value: np.ndarray
    irradiance: np.ndarray
    good: np.ndarray
    direct: np.ndarray
    between: np.ndarray
    open: np.ndarray
    step: float
    rho: np.ndarray
    ways: object = None             # lib.specular.Ways where rays go on at mirrors and glossy surfaces


def texture(surface: Surface, mesh: Mesh, lamps, E, indirect, exposed, rho_facet, *, texels=TEXELS, samples=32, n_rays=64, ways=None) -> Texture:
    """Reflected radiosity of every side that has patches, direct light from the lamps and not from the patches.

    lamps : from form_factors.emitters;  E : (L, C);  indirect : (N, C) what others send to the patches
    exposed : (N,) share of each patch outside solids;  rho_facet : (F, C)
    """
    sides = np.unique(mesh.side)
    size = surface.size[sides // 2]
    step = np.sqrt(max(size.prod(axis=1).sum(), 1e-300) / texels)
    count = np.clip(np.ceil(size / step), 3, 4096).astype(np.int64)       # of a rim half inside a solid at least one lies outside
    n = count.prod(axis=1)
    start = np.full(2 * len(surface.normal), -1, np.int64)
    start[sides] = np.concatenate([[0], np.cumsum(n)[:-1]])
    shape = np.ones((2 * len(surface.normal), 2), np.int32)
    shape[sides] = count

    side = np.repeat(sides, n).astype(np.int32)
    f = side // 2
    index = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    columns = shape[side, 1]
    uv = (np.stack([index // columns, index % columns], axis=1) + 0.5) * surface.size[f] / shape[side]
    p = surface.origin[f] + uv[:, :1] * surface.axes[f, 0] + uv[:, 1:] * surface.axes[f, 1]
    normals = form_factors.side_normals(surface)

    good = _within(p, f, *_triangles(surface), normals[2 * f])
    good &= ~_buried(surface, p, side, normals)
    at, fill = np.flatnonzero(good), _nearest(good, start[sides], count)        # texels outside the facet or inside a solid take another's value
    irradiance = np.zeros((len(p), E.shape[1]), np.float32)
    whole = np.zeros((len(p), len(lamps)), np.float32)
    for k, lamp in enumerate(lamps):
        one = [replace(lamp, lamp=0)]
        whole[at, k] = form_factors.direct(surface, one, p[at], normals, side[at], 1, n_samples=1, shadows=False)[:, 0]
        seen = form_factors.direct(surface, one, p[at], normals, side[at], 1, n_samples=samples, seed=71 + k) if surface.n_occluders or lamp.mirrors else whole[at, k:k + 1]
        irradiance[at] += seen * E[lamp.lamp]
    lit = np.flatnonzero(exposed > 0)
    place, places = np.hstack([p[at], FAR * side[at, None]]), np.hstack([mesh.centre[lit], FAR * mesh.side[lit, None]])
    between = np.zeros((len(p), E.shape[1]), np.float32)
    rest, patch = indirect, _patch_at(mesh, side[at], index[at], shape, mesh.table_shape[side[at]])
    number = np.maximum(np.bincount(np.maximum(patch, 0), patch >= 0, len(mesh)), 1)[:, None]
    for _ in range(3):
        # a fit through hollow or domed light lies above or below it: what a patch lacks on average is added until it agrees
        between[at] += spread(places, rest[lit], place, surface.axes[f[at]])
        found = np.stack([np.bincount(np.maximum(patch, 0), np.where(patch >= 0, between[at, c], 0), len(mesh)) for c in range(E.shape[1])], axis=1) / number
        rest = np.where((np.bincount(np.maximum(patch, 0), patch >= 0, len(mesh)) > 0)[:, None], indirect - found, 0)
    between = np.maximum(between, 0)
    irradiance, whole = irradiance[fill], whole[fill]
    rho = rho_facet.astype(np.float32)
    first = irradiance * rho[f]
    if n_rays:
        # once more by rays: the light that the patches pass on is then as sharp as the texels, not as the patches
        once = Texture(start, shape, first + between[fill] * rho[f], irradiance, good, first, between, whole, float(step), rho, ways)
        ones = np.arange(len(at))
        between[at] = _sent(surface, once, lamps, E, p[at], ones, ones + 1, side[at], n_rays, 650)[0]
    between = between[fill]
    return Texture(start, shape, first + between * rho[f], irradiance + between, good, first, between, whole, float(step), rho, ways)


def _patch_at(mesh, side, index, shape, cells):
    """The patch under each texel's centre, -1 outside."""
    columns = shape[side, 1]
    a = ((index // columns + 0.5) * cells[:, 0] / shape[side, 0]).astype(np.int64)
    b = ((index % columns + 0.5) * cells[:, 1] / columns).astype(np.int64)
    return mesh.leaf[mesh.table_start[side] + a * cells[:, 1] + b]


def spread(known, value, wanted, axes, neighbours=9):
    """Values at scattered points of planes, by a local linear fit through the nearest known ones.

    known : (N, 4), wanted : (M, 4)  local position, and FAR times a number of the plane: planes do not mix
    value : (N, C);  axes : (M, 2, 3) of the wanted point's plane
    """
    from scipy.spatial import cKDTree
    if len(known) == 0 or len(wanted) == 0:
        return np.zeros((len(wanted), value.shape[1]))
    distance, near = cKDTree(known).query(wanted, k=min(neighbours, len(known)))
    distance, near = distance.reshape(len(wanted), -1), near.reshape(len(wanted), -1)
    return _fit(known[:, :3], value, wanted[:, :3], np.ascontiguousarray(axes), near, distance)


@njit(cache=True, parallel=True)
def _fit(known, value, wanted, axes, near, distance):
    m, k = near.shape
    C = value.shape[1]
    out = np.zeros((m, C))
    for i in prange(m):
        n = 0
        while n < k and distance[i, n] < 0.5 * FAR:
            n += 1
        if n == 0:
            continue
        radius = max(1.05 * distance[i, n - 1], 1e-12)
        s0, su, sv, suu, suv, svv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        t = np.zeros((3, C))
        low, high = np.full(C, np.inf), np.full(C, -np.inf)
        for j in range(n):
            q = near[i, j]
            w = 1 - (distance[i, j] / radius) ** 2
            w *= w
            u, v = 0.0, 0.0
            for d in range(3):
                x = (known[q, d] - wanted[i, d]) / radius
                u += x * axes[i, 0, d]
                v += x * axes[i, 1, d]
            s0 += w
            su += w * u
            sv += w * v
            suu += w * u * u
            suv += w * u * v
            svv += w * v * v
            for c in range(C):
                t[0, c] += w * value[q, c]
                t[1, c] += w * u * value[q, c]
                t[2, c] += w * v * value[q, c]
                low[c] = min(low[c], value[q, c])
                high[c] = max(high[c], value[q, c])
        _linear(s0, su, sv, suu, suv, svv, t, 0.02)
        for c in range(C):                     # beyond the outermost points no more than half the range is continued
            room = 0.5 * (high[c] - low[c])
            out[i, c] = min(max(t[0, c], low[c] - room), high[c] + room)
    return out


@njit(cache=True, inline="always")
def _linear(s0, su, sv, suu, suv, svv, t, ridge):
    """Solve the weighted normal equations of value = t0 + t1 u + t2 v in place; slopes shrink by `ridge` of the weight."""
    mu, mv = su / s0, sv / s0
    a, b, c = suu - su * mu + ridge * s0, suv - su * mv, svv - sv * mv + ridge * s0
    det = a * c - b * b
    for k in range(t.shape[1]):
        mean = t[0, k] / s0
        x, y = t[1, k] - su * mean, t[2, k] - sv * mean
        gu, gv = (c * x - b * y) / det, (a * y - b * x) / det
        t[0, k] = mean - gu * mu - gv * mv
        t[1, k] = gu
        t[2, k] = gv


@njit(cache=True, parallel=True)
def _within(p, facet, corners, start, normal):
    """(M,) bool: the point lies in one of its facet's triangles."""
    out = np.zeros(len(p), np.bool_)
    for i in prange(len(p)):
        out[i] = _holds(p[i], corners, start[facet[i]], start[facet[i] + 1], normal[i])
    return out


def _buried(surface, p, side, normals):
    """(M,) bool: the point lies inside a solid: straight above it the first thing is a solid's inner side."""
    if not surface.inside.any():
        return np.zeros(len(p), bool)
    n = normals[side]
    triangle, _ = surface.caster.closest(np.hstack([p + OFFSET * n, n]).astype(np.float32))
    f = surface.facet[triangle]
    back = np.einsum("ij,ij->i", n, surface.normal[f]) > 0
    return (triangle >= 0) & surface.inside[2 * f + back]


@njit(cache=True)
def _nearest(good, start, count):
    """(K,) for each texel a good one of its side as few steps away as any (itself where it is good, or where none is)."""
    source = np.arange(len(good))
    queue = np.empty(len(good), np.int64)
    for s in range(len(start)):
        nu, nv = count[s]
        reached = good[start[s]:start[s] + nu * nv].copy()
        head, tail = 0, 0
        for i in range(nu * nv):
            if reached[i]:
                queue[tail] = i
                tail += 1
        while head < tail:
            i = queue[head]
            head += 1
            for step in range(4):
                a = i // nv + (1 if step == 0 else -1 if step == 1 else 0)
                b = i % nv + (1 if step == 2 else -1 if step == 3 else 0)
                j = a * nv + b
                if 0 <= a < nu and 0 <= b < nv and not reached[j]:
                    reached[j] = True
                    source[start[s] + j] = source[start[s] + i]
                    queue[tail] = j
                    tail += 1
    return source


# -- direct light, per pixel

@dataclass(frozen=True)
class Pixels:
    """The pixels that show something, in Morton's order facet by facet: a block of a facet is a range.

    x, y, facet, side : (M,);  p : (M, 3) local;  key : (M,) facet and Morton code;  number : (H, W) place in this order, -1
    """
    x: np.ndarray
    y: np.ndarray
    facet: np.ndarray
    side: np.ndarray
    p: np.ndarray
    key: np.ndarray
    bits: int
    number: np.ndarray

    def __len__(self):
        return len(self.x)


def _morton(v):
    v = v.astype(np.uint64)
    for shift, mask in ((16, 0x0000FFFF0000FFFF), (8, 0x00FF00FF00FF00FF), (4, 0x0F0F0F0F0F0F0F0F), (2, 0x3333333333333333), (1, 0x5555555555555555)):
        v = (v | (v << np.uint64(shift))) & np.uint64(mask)
    return v


def pixels(surface: Surface, camera, facet, at=None) -> Pixels:
    """facet : (H, W) int, -1 = nothing;  at : (H, W, 3) local and (H, W) side, of what mirrors show; else where the camera sees it."""
    from lib.gather import backproject
    y, x = np.nonzero(facet >= 0)
    bits = max(1, int(max(facet.shape) - 1).bit_length())
    key = (facet[y, x].astype(np.uint64) << np.uint64(2 * bits)) | _morton(x) | (_morton(y) << np.uint64(1))
    order = np.argsort(key)
    x, y, key = x[order].astype(np.int32), y[order].astype(np.int32), key[order].astype(np.int64)
    number = np.full(facet.shape, -1, np.int64)
    number[y, x] = np.arange(len(x))
    f = facet[y, x].astype(np.int32)
    p, side = backproject(surface, camera, f, y.astype(np.int64) * camera.width + x) if at is None else (at[0][y, x], at[1][y, x])
    _pull_in(p, f, *_triangles(surface), surface.normal)
    return Pixels(x, y, f, side, p, key, bits, number)


def _triangles(surface):
    """The corners of all triangles facet by facet (T, 3, 3), and where each facet's begin (F + 1,)."""
    order = np.argsort(surface.facet, kind="stable").astype(np.int64)
    return surface.corners[order], np.searchsorted(surface.facet[order], np.arange(len(surface.normal) + 1)).astype(np.int64)


@njit(cache=True, parallel=True)
def _pull_in(p, facet, corners, first, normal):
    """A pixel on the rim of a facet may lie a hair outside it, behind the next wall: it moves to the nearest place inside."""
    for i in prange(len(p)):
        f = facet[i]
        if _holds(p[i], corners, first[f], first[f + 1], normal[f]):
            continue
        best = np.inf
        nearest = p[i].copy()
        for t in range(first[f], first[f + 1]):
            middle = (corners[t, 0] + corners[t, 1] + corners[t, 2]) / 3
            for e in range(3):
                a, b = corners[t, e], corners[t, (e + 1) % 3]
                d = b - a
                along = min(max(np.dot(p[i] - a, d) / max(np.dot(d, d), 1e-300), 0.0), 1.0)
                q = a + along * d
                distance = np.dot(p[i] - q, p[i] - q)
                if distance < best:
                    best = distance
                    inward = middle - q
                    nearest = q + inward * min(1.0, 4 * OFFSET / max(np.sqrt(np.dot(inward, inward)), 1e-300))
        p[i] = nearest


def direct(surface: Surface, lamps, n_lamps, pixels: Pixels, camera, *, few=4, many=64) -> tuple:
    """Factor of each pixel to each lamp with soft shadows, (M, L), and how many pixels lay in a penumbra.

    The exact factor of the lamp's polygon at the pixel's centre times its visible share, from shadow rays that begin
    all over the pixel: a shadow narrower than a pixel darkens it in proportion.
    few : shadow rays per pixel and emitter everywhere;  many : where the pixels of a 5 x 5 neighbourhood disagree
    """
    factor = np.zeros((len(pixels), n_lamps))
    normals = form_factors.side_normals(surface)
    view = _view(surface, camera)
    uncertain = 0
    for number, lamp in enumerate(lamps):
        whole = _whole(surface, lamp, pixels, normals)
        if surface.n_occluders == 0 and not lamp.mirrors:
            factor[:, lamp.lamp] += whole
            continue
        lit = np.flatnonzero(whole > 0)
        visible = np.zeros(len(pixels))
        visible[lit] = _visible(surface, lamp, pixels, lit, view, few, number)
        penumbra = np.flatnonzero(_disagree(visible, whole > 0, pixels.number, pixels.facet, pixels.x, pixels.y))
        uncertain += len(penumbra)
        if len(penumbra):
            visible[penumbra] = _visible(surface, lamp, pixels, penumbra, view, many, number + 500)
            visible[penumbra] = _smoothed(visible, penumbra, pixels.number, pixels.facet, pixels.x, pixels.y, 0.7 / many ** 0.75)
        factor[:, lamp.lamp] += whole * visible
    return factor, uncertain


def _whole(surface, lamp, pixels, normals):
    """Factor of each pixel to a lamp if nothing stood in between, (M,): exact; for a lamp of many triangles exact at the middles of
    blocks of 4 x 4 pixels and interpolated between."""
    one = [replace(lamp, lamp=0)]
    if len(lamp.corners) <= MANY or not len(pixels):
        return form_factors.direct(surface, one, pixels.p, normals, pixels.side, 1, n_samples=1, shadows=False)[:, 0]
    first, last = _blocks(pixels, np.zeros(1, np.int64), np.array([len(pixels)]), 2)
    p = np.stack([_means(pixels.p[:, d], first, last) for d in range(3)], axis=1)
    factor = form_factors.direct(surface, one, p, normals, pixels.side[first], 1, n_samples=1, shadows=False)
    q = np.stack([_means(v.astype(float), first, last) for v in (pixels.x, pixels.y)], axis=1)
    nothing = np.zeros(len(first))
    return interpolated(Leaves(first, last, np.full(len(first), 2), q, nothing, factor, nothing, nothing, nothing), pixels)[:, 0]


def _view(surface, camera):
    """What turns a place in the picture into a ray, in local coordinates: centre (3,), and (3, 3) with v = M (x, y, 1).
    Without a camera (pixels that mirrors show) no place but a pixel's own is known: M = 0."""
    if camera is None:
        return np.zeros(3), np.zeros((3, 3)), *_triangles(surface)
    M = camera.T_cam_world[:3, :3].T @ np.linalg.inv(camera.K)
    return surface.local.points(camera.centre), M, *_triangles(surface)


def _visible(surface, lamp, pixels, which, view, n, seed):
    """Share of the lamp's light that reaches each pixel of `which`, from n shadow rays."""
    sequence = sobol(n)
    share = np.zeros(len(which))
    step = max(1, CHUNK // n)
    for a in range(0, len(which), step):
        some = which[a:a + step]
        rays, weight = _shadow_rays(some, n, sequence, shifts(len(some), n, seed), pixels.x, pixels.y, pixels.side, pixels.p, *view,
                                    surface.origin, surface.normal, lamp.corners, lamp.normal, lamp.cdf)
        share[a:a + step] = _share(weight, ~form_factors.reached(surface, lamp, rays))
    return share


@njit(cache=True, parallel=True)
def _share(weight, occluded):
    m, n = weight.shape
    out = np.zeros(m)
    for i in prange(m):
        total, seen = 0.0, 0.0
        for k in range(n):
            total += weight[i, k]
            if not occluded[i * n + k]:
                seen += weight[i, k]
        out[i] = seen / total if total > 0 else 0.0
    return out


@njit(cache=True, parallel=True)
def _shadow_rays(which, n, sequence, shift, px, py, side, centres, eye, M, corners, first, origin, normal, lamp, front, cdf):
    rays = np.empty((len(which) * n, 6), np.float32)
    weight = np.empty((len(which), n), np.float32)
    for j in prange(len(which)):
        i = which[j]
        f = side[i] >> 1
        sign = 1.0 - 2.0 * (side[i] & 1)
        height = 0.0
        for d in range(3):
            height += (origin[f, d] - eye[d]) * normal[f, d]
        p = np.empty(3)
        for k in range(n):
            x = px[i] + ((sequence[k, 2] ^ shift[j, 2]) + 0.5) / 4294967296.0 - 0.5
            y = py[i] + ((sequence[k, 3] ^ shift[j, 3]) + 0.5) / 4294967296.0 - 0.5
            along = 0.0
            for d in range(3):
                p[d] = M[d, 0] * x + M[d, 1] * y + M[d, 2]
                along += p[d] * normal[f, d]
            scale = height / along if abs(along) > 1e-12 else -1.0
            for d in range(3):
                p[d] = eye[d] + scale * p[d]
            if scale <= 0 or not _holds(p, corners, first[f], first[f + 1], normal[f]):
                for d in range(3):                        # off the facet: its centre, which is on it
                    p[d] = centres[i, d]
            u = ((sequence[k, 0] ^ shift[j, 0]) + 0.5) / 4294967296.0
            v = ((sequence[k, 1] ^ shift[j, 1]) + 0.5) / 4294967296.0
            weight[j, k] = _aim(p, normal[f], sign, u, v, lamp, front, cdf, rays, j * n + k)
    return rays, weight


@njit(cache=True, inline="always")
def _holds(p, corners, a, b, normal):
    """Whether one of the triangles a to b of a facet holds the point of its plane."""
    for t in range(a, b):
        inside = True
        for e in range(3):
            o, q = corners[t, e], corners[t, (e + 1) % 3]
            x0, x1, x2 = q[0] - o[0], q[1] - o[1], q[2] - o[2]
            y0, y1, y2 = p[0] - o[0], p[1] - o[1], p[2] - o[2]
            if (x1 * y2 - x2 * y1) * normal[0] + (x2 * y0 - x0 * y2) * normal[1] + (x0 * y1 - x1 * y0) * normal[2] < 0:
                inside = False
                break
        if inside:
            return True
    return False


@njit(cache=True, parallel=True)
def _disagree(visible, lit, number, facet, x, y):
    """(M,) bool: partly visible, or unlike a pixel of the same facet within two."""
    H, W = number.shape
    out = np.zeros(len(visible), np.bool_)
    for i in prange(len(visible)):
        if not lit[i]:
            continue
        v = visible[i]
        uneven = v > 1e-3 and v < 1 - 1e-3
        for b in range(max(y[i] - 2, 0), min(y[i] + 2, H - 1) + 1):
            for a in range(max(x[i] - 2, 0), min(x[i] + 2, W - 1) + 1):
                j = number[b, a]
                if j >= 0 and facet[j] == facet[i] and lit[j] and abs(visible[j] - v) > 1e-3:
                    uneven = True
        out[i] = uneven
    return out


@njit(cache=True, parallel=True)
def _smoothed(visible, which, number, facet, x, y, sigma):
    """Mean of the 3 x 3 pixels of the same facet that differ by no more than the sampling does."""
    H, W = number.shape
    out = np.empty(len(which))
    for k in prange(len(which)):
        i = which[k]
        total, weight = visible[i], 1.0
        for b in range(max(y[i] - 1, 0), min(y[i] + 1, H - 1) + 1):
            for a in range(max(x[i] - 1, 0), min(x[i] + 1, W - 1) + 1):
                j = number[b, a]
                if j < 0 or j == i or facet[j] != facet[i]:
                    continue
                w = np.exp(-0.5 * ((visible[j] - visible[i]) / (2 * sigma)) ** 2)
                total += w * visible[j]
                weight += w
        out[k] = total / weight
    return out


# -- indirect light, gathered at the leaves of quadtrees

@dataclass
class Leaves:
    """Blocks of pixels of one facet: pixels first to last in Morton's order; the block is 2^level wide.

    q : (K, 2) px, mean position;  extent : (K,) local, the block's largest width;  irradiance : (K, C)
    distance : (K,) local, harmonic mean distance of what is seen;  noise : (K,) of the irradiance;  rays : (K,) that it took
    """
    first: np.ndarray
    last: np.ndarray
    level: np.ndarray
    q: np.ndarray
    extent: np.ndarray
    irradiance: np.ndarray
    distance: np.ndarray
    noise: np.ndarray
    rays: np.ndarray

    def __len__(self):
        return len(self.first)

    def __getitem__(self, keep):
        return Leaves(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))

    @staticmethod
    def joined(*parts):
        return Leaves(*(np.concatenate([getattr(part, name) for part in parts]) for name in Leaves.__dataclass_fields__))


def _blocks(pixels: Pixels, first, last, level):
    """Cut ranges of pixels into blocks 2^level wide -> first, last."""
    code = pixels.key >> (2 * level)
    inside = np.repeat(np.arange(len(first)), last - first)
    member = np.arange(len(inside)) - np.repeat(np.cumsum(last - first) - (last - first), last - first) + first[inside]
    new = np.ones(len(member), bool)
    new[1:] = (code[member[1:]] != code[member[:-1]]) | (inside[1:] != inside[:-1])
    begin = np.flatnonzero(new)
    length = np.diff(np.append(begin, len(member)))
    return member[begin], member[begin] + length


def gather(surface: Surface, shown: Texture, lamps, E, pixels: Pixels, total_direct, *, n_rays=256, contact=0.35, tolerance=0.01,
           trace=None) -> Leaves:
    """Indirect light at the leaves, refined from blocks of a 15th of the picture down to 2 px.

    total_direct : (M, C) direct irradiance of the pixels, the scale of what an error means
    n_rays : rays in the end at a leaf an eighth as wide as the largest; twice as many at one twice as wide, because the
        noise of a wide leaf is a blotch, that of a narrow one is not seen and averages out
    contact : a leaf wider than this times the harmonic mean distance of what it sees is split
    tolerance : and one whose light its neighbours do not foretell to this share of its total light
    """
    smallest, largest = 1, max(2, round(np.log2(max(min(pixels.number.shape) / 15, 1))))
    brightness = total_direct.mean(axis=1)
    first, last = _blocks(pixels, np.zeros(1, np.int64), np.array([len(pixels)]), largest)
    done = None
    for level in range(largest, smallest - 1, -1):
        fresh = _gathered(surface, shown, lamps, E, pixels, first, last, level, max(16, n_rays // 2))
        everything = fresh if done is None else Leaves.joined(done, fresh)
        weight = everything.last - everything.first
        _, foretold = _neighbourhoods(everything, pixels.facet[everything.first])
        total = _means(brightness, everything.first, everything.last) + everything.irradiance.mean(axis=1)
        floor = 0.05 * np.average(total, weights=weight) if len(weight) else 0.0
        error = np.abs(foretold - everything.irradiance).mean(axis=1) / np.maximum(total + floor, 1e-300)
        if trace and len(weight):
            trace(places=len(everything), foretold_error=float(np.sqrt(np.average(error ** 2, weights=weight))))
        split = everything.extent > contact * everything.distance
        split |= error > np.maximum(tolerance, 3 * everything.noise / np.maximum(total + floor, 1e-300))
        split &= (everything.level == level) & (weight > 4) & (level > smallest)
        done = everything[~split]
        if not split.any():
            break
        first, last = _blocks(pixels, everything.first[split], everything.last[split], level - 1)
    while len(done):                                       # no leaf beside one a quarter as wide or less: the fits would lean
        split = _lowest_beside(done.first, done.last, done.level, pixels.number, pixels.facet, pixels.x, pixels.y) < done.level - 1
        if not split.any():
            break
        fresh = [_gathered(surface, shown, lamps, E, pixels, *_blocks(pixels, done.first[now], done.last[now], level - 1), level - 1, max(16, n_rays // 2))
                 for level in np.unique(done.level[split]) for now in [split & (done.level == level)]]
        done = Leaves.joined(done[~split], *fresh)
    _finish(surface, shown, lamps, E, pixels, done, brightness, n_rays, largest)
    return done


@njit(cache=True)
def _lowest_beside(first, last, level, number, facet, x, y):
    """The lowest level among the leaves that touch each leaf on its facet."""
    H, W = number.shape
    of = np.empty(len(x), np.int64)
    for i in range(len(first)):
        of[first[i]:last[i]] = level[i]
    lowest = level.copy()
    for i in range(len(first)):
        for j in range(first[i], last[i]):
            for step in range(4):
                a = x[j] + (1 if step == 0 else -1 if step == 1 else 0)
                b = y[j] + (1 if step == 2 else -1 if step == 3 else 0)
                if 0 <= a < W and 0 <= b < H and number[b, a] >= 0 and facet[number[b, a]] == facet[j]:
                    lowest[i] = min(lowest[i], of[number[b, a]])
    return lowest


def _finish(surface, shown, lamps, E, pixels, leaves, brightness, n_rays, largest):
    """The final rays, in place. Facets whose light comes from few directions (dark ones before a bright gap) get more, up to
    four times as many, those of even light fewer; those that reflect nothing next to none."""
    if not len(leaves):
        return
    facet, weight = pixels.facet[leaves.first], (leaves.last - leaves.first).astype(float)
    total = _means(brightness, leaves.first, leaves.last) + leaves.irradiance.mean(axis=1)
    noise = (leaves.noise / np.maximum(total, 1e-300)) ** 2
    mean = np.bincount(facet, weight * noise) / np.maximum(np.bincount(facet, weight), 1)
    share = np.clip((np.sqrt(mean) / 0.015) ** (4 / 3), 0.5, 4.0)          # an error falls as rays ** -0.75
    share = np.where(shown.rho[:len(share)].max(axis=1) > 0, share, 0)[facet]
    wanted = n_rays * 2.0 ** (leaves.level - largest + 3) * share
    leaves.rays[:] = 2 ** np.clip(np.round(np.log2(np.maximum(wanted, 16))), 4, 16).astype(int)
    for n in np.unique(leaves.rays):
        mine = np.flatnonzero(leaves.rays == n)
        first, last = leaves.first[mine], leaves.last[mine]
        leaves.irradiance[mine] = _sent(surface, shown, lamps, E, pixels.p, first, last, pixels.side[first], int(n), 950 + int(n))[0]


def _means(values, first, last):
    """Mean of values over ranges."""
    cumulated = np.concatenate([[0.0], np.cumsum(values)])
    return (cumulated[last] - cumulated[first]) / (last - first)


def _gathered(surface, shown, lamps, E, pixels, first, last, level, n_rays) -> Leaves:
    total, half, distance = _sent(surface, shown, lamps, E, pixels.p, first, last, pixels.side[first], n_rays, 900 + level)
    q = np.stack([_means(pixels.x.astype(float), first, last), _means(pixels.y.astype(float), first, last)], axis=1)
    low, high = _bounds(pixels.p, first, last)
    extent = np.linalg.norm(high - low, axis=1)
    noise = np.abs(half).mean(axis=1)
    return Leaves(first, last, np.full(len(first), level), q, extent, total, distance, noise, np.full(len(first), n_rays))


def _sent(surface, shown, lamps, E, p, first, last, side, n_rays, seed):
    """Rays from places that own the points first to last of p: mean radiosity they meet (K, C), half the difference of the
    two halves of the rays (K, C), harmonic mean distance (K,)."""
    m, C = len(first), shown.value.shape[1]
    sequence, shift = sobol(n_rays), shifts(m, n_rays, seed)
    total, half, distance = np.zeros((m, C)), np.zeros((m, C)), np.zeros(m)
    step = max(1, CHUNK // n_rays)
    for a in range(0, m, step):
        b = min(m, a + step)
        rays = _rays(a, b, n_rays, sequence, shift, first, last, p, side, surface.axes, surface.normal)
        triangle, t = surface.caster.closest(rays)
        near, close = _close(surface, shown, lamps, E, rays, triangle, t)
        _look(rays, triangle, t, n_rays, surface.facet, surface.normal, surface.origin, surface.axes, surface.size, surface.inside,
              shown.start, shown.shape, shown.value, shown.direct, near, close, total[a:b], half[a:b], distance[a:b])
        if shown.ways is not None:
            total[a:b] += _by_ways(surface, shown, rays, triangle, t, b - a, n_rays)
    return total, half, distance


def _by_ways(surface, shown, rays, triangle, t, m, n_rays):
    """What m places receive from their rays after mirrors and glossy surfaces, (m, C)."""
    from lib import specular
    f = np.where(triangle >= 0, surface.facet[triangle], 0)
    back = np.einsum("ij,ij->i", rays[:, 3:], surface.normal[f]) > 0
    counts = ~((triangle >= 0) & surface.inside[2 * f + back])
    element = np.repeat(np.arange(m), n_rays)
    start = specular.first_met(rays, np.where(counts, triangle, -1), t)
    return beyond(surface, shown, start, element, m) / np.maximum(np.bincount(element, counts, m), 1)[:, None]


def beyond(surface: Surface, shown: Texture, start, element, m, *, seed=11):
    """Sums (m, C) over the rays of each element of what they find after the specular surfaces that they have met.

    start : lib.specular.Met;  element : (n,) of each ray
    """
    from lib import specular
    ways = shown.ways
    C = shown.value.shape[1]
    total = np.zeros((m, C))

    def add(met, light):
        light = light * ways.chains.power(ways.rho_s)[met.chain]
        for c in range(C):
            total[:, c] += np.bincount(element[met.source], light[:, c], m)

    def at_lobe(p, facet, sign, met, group, axes, step):
        add(met, specular.lobe_light(surface, ways.finish, ways.lamps, p, facet, sign, met, group, axes, step, seed=seed) @ ways.E[[lamp.lamp for lamp in ways.lamps]])

    for met in specular.follow(surface, ways.finish, ways.chains, start, seed=seed, at_lobe=at_lobe):
        light = reflected_at(surface, shown, met.rays, met.triangle, met.t) * met.weight[:, None]
        which, share = specular.lamp_found(surface, ways.lamps, met, ways.chains, ways.complete)
        on = np.flatnonzero(which >= 0)
        light[on] += share[on, None] * ways.E[np.array([lamp.lamp for lamp in ways.lamps])[which[on]]]
        add(met, light)
    return total


def reflected_at(surface: Surface, shown: Texture, rays, triangle, t):
    """What the ends of rays reflect diffusely towards them, (n, C); nothing inside solids. Ends within three texels are lit by themselves."""
    look = lambda which, value: _reflected_at(rays[which], triangle[which], t[which], surface.facet, surface.normal, surface.origin, surface.axes, surface.size,
                                              surface.inside, shown.start, shown.shape, value)
    light = look(slice(None), shown.value)
    if shown.ways is not None:
        near, close = _close(surface, shown, shown.ways.every, shown.ways.E_every, rays, triangle, t)
        near = np.flatnonzero(near >= 0)
        light[near] += np.where(light[near].any(axis=1, keepdims=True), close - look(near, shown.direct), 0)
    return light


@njit(cache=True, parallel=True)
def _reflected_at(rays, triangle, t, facet, normal, origin, axes, size, inside, start, shape, value):
    C = value.shape[1]
    out = np.zeros((len(rays), C))
    for i in prange(len(rays)):
        if triangle[i] < 0:
            continue
        f = facet[triangle[i]]
        along = rays[i, 3] * normal[f, 0] + rays[i, 4] * normal[f, 1] + rays[i, 5] * normal[f, 2]
        s = 2 * f + (1 if along > 0 else 0)
        if inside[s] or start[s] < 0:
            continue
        p = np.empty(3)
        for d in range(3):
            p[d] = rays[i, d] + t[i] * rays[i, 3 + d]
        here, du, dv, u, v = _texel(p, f, s, origin, axes, size, start, shape)
        for c in range(C):
            out[i, c] = (1 - u) * ((1 - v) * value[here, c] + v * value[here + dv, c]) + u * ((1 - v) * value[here + du, c] + v * value[here + du + dv, c])
    return out

def _close(surface, shown, lamps, E, rays, triangle, t):
    """Where a ray ends within three texels its target is too near for a texture: a shadow in the corner matters. The number of
    each such ray (n,), -1 for the others, and the radiosity there by direct light, from one shadow ray to each emitter (m, C)."""
    near = np.full(len(rays), -1, np.int32)
    rows = np.flatnonzero(t < NEAR * shown.step) if surface.n_occluders else np.zeros(0, np.int64)
    near[rows] = np.arange(len(rows))
    light = np.zeros((len(rows), E.shape[1]), np.float32)
    for k, lamp in enumerate(lamps):
        shadow, factor = _close_rays(rows, rays, triangle, t, k, surface.facet, surface.normal, surface.origin, surface.axes, surface.size,
                                     shown.start, shown.shape, shown.open, lamp.corners, lamp.normal, lamp.cdf)
        lit = np.flatnonzero(factor > 0)
        factor[lit[~form_factors.reached(surface, lamp, shadow[lit])]] = 0
        light += factor[:, None] * E[lamp.lamp].astype(np.float32)
    return near, light * shown.rho[surface.facet[triangle[rows]]]


@njit(cache=True, parallel=True)
def _close_rays(rows, rays, triangle, t, k, facet, normal, origin, axes, size, start, shape, whole, lamp, front, cdf):
    out = np.zeros((len(rows), 6), np.float32)
    factor = np.zeros(len(rows), np.float32)
    for j in prange(len(rows)):
        row = rows[j]
        f = facet[triangle[row]]
        along = rays[row, 3] * normal[f, 0] + rays[row, 4] * normal[f, 1] + rays[row, 5] * normal[f, 2]
        s = 2 * f + (1 if along > 0 else 0)
        if start[s] < 0:
            continue
        p = np.empty(3)
        for d in range(3):
            p[d] = rays[row, d] + t[row] * rays[row, 3 + d]
        here, du, dv, u, v = _texel(p, f, s, origin, axes, size, start, shape)
        factor[j] = (1 - u) * ((1 - v) * whole[here, k] + v * whole[here + dv, k]) + u * ((1 - v) * whole[here + du, k] + v * whole[here + du + dv, k])
        if factor[j] > 0:                    # the places on the lamp follow Roberts' sequence
            _aim(p, normal[f], 1.0 - 2.0 * (s & 1), (0.5 + 0.7548776662466927 * row) % 1.0, (0.5 + 0.5698402909980532 * row) % 1.0,
                 lamp, front, cdf, out, j)
    return out, factor


@njit(cache=True, inline="always")
def _texel(p, f, s, origin, axes, size, start, shape):
    """For bilinear interpolation at p: the lower texel, steps to its neighbours, and the weights of those."""
    u, v = 0.0, 0.0
    for d in range(3):
        x = p[d] - origin[f, d]
        u += x * axes[f, 0, d]
        v += x * axes[f, 1, d]
    nu, nv = shape[s, 0], shape[s, 1]
    u = min(max(u / size[f, 0] * nu - 0.5, 0.0), nu - 1.0)
    v = min(max(v / size[f, 1] * nv - 0.5, 0.0), nv - 1.0)
    a, b = min(int(u), max(nu - 2, 0)), min(int(v), max(nv - 2, 0))
    return start[s] + a * nv + b, nv if nu > 1 else 0, 1 if nv > 1 else 0, u - a, v - b


@njit(cache=True)
def _bounds(p, first, last):
    low, high = np.empty((len(first), 3)), np.empty((len(first), 3))
    for i in range(len(first)):
        for d in range(3):
            low[i, d], high[i, d] = p[first[i], d], p[first[i], d]
            for k in range(first[i], last[i]):
                low[i, d] = min(low[i, d], p[k, d])
                high[i, d] = max(high[i, d], p[k, d])
    return low, high


@njit(cache=True, parallel=True)
def _rays(a, b, n, sequence, shift, first, last, p, side, axes, normal):
    """Cosine-distributed rays from the pixels of leaves a to b; points and directions are one low-discrepancy set."""
    out = np.empty(((b - a) * n, 6), np.float32)
    for i in prange(a, b):
        f = side[i] >> 1
        sign = 1.0 - 2.0 * (side[i] & 1)
        for k in range(n):
            place = ((sequence[k, 0] ^ shift[i, 0]) + 0.5) / 4294967296.0
            q = first[i] + min(last[i] - first[i] - 1, int(place * (last[i] - first[i])))
            u = ((sequence[k, 2] ^ shift[i, 2]) + 0.5) / 4294967296.0
            phi = 2 * np.pi * ((sequence[k, 3] ^ shift[i, 3]) + 0.5) / 4294967296.0
            r = np.sqrt(u)
            x, y, z = r * np.cos(phi), r * np.sin(phi), np.sqrt(max(0.0, 1 - u)) * sign
            row = (i - a) * n + k
            for d in range(3):
                out[row, d] = p[q, d] + OFFSET * sign * normal[f, d]
                out[row, 3 + d] = x * axes[f, 0, d] + y * axes[f, 1, d] + z * normal[f, d]
    return out


@njit(cache=True, parallel=True)
def _look(rays, triangle, t, n, facet, normal, origin, axes, size, inside, start, shape, value, direct, near, close, total, half, distance):
    """Mean radiosity that the rays of each leaf meet, half the difference of its two halves, harmonic mean distance.

    A ray that meets the inner side of a solid, or a side that no light reaches, began in the wrong place and is dropped.
    """
    C = value.shape[1]
    for i in prange(len(total)):
        valid = np.zeros(2)
        sums = np.zeros((2, C))
        hits, inverse = 0, 0.0
        for k in range(n):
            row = i * n + k
            part = 0 if 2 * k < n else 1
            if triangle[row] < 0:
                valid[part] += 1
                continue
            f = facet[triangle[row]]
            along = rays[row, 3] * normal[f, 0] + rays[row, 4] * normal[f, 1] + rays[row, 5] * normal[f, 2]
            s = 2 * f + (1 if along > 0 else 0)
            if inside[s] or start[s] < 0:
                continue
            valid[part] += 1
            hits += 1
            inverse += 1 / max(t[row], OFFSET)
            p = np.empty(3)
            for d in range(3):
                p[d] = rays[row, d] + t[row] * rays[row, 3 + d]
            here, du, dv, u, v = _texel(p, f, s, origin, axes, size, start, shape)
            for c in range(C):
                sums[part, c] += (1 - u) * ((1 - v) * value[here, c] + v * value[here + dv, c]) \
                    + u * ((1 - v) * value[here + du, c] + v * value[here + du + dv, c])
            m = near[row]
            if m >= 0:
                for c in range(C):
                    sums[part, c] += close[m, c] - (1 - u) * ((1 - v) * direct[here, c] + v * direct[here + dv, c]) \
                        - u * ((1 - v) * direct[here + du, c] + v * direct[here + du + dv, c])
        for c in range(C):
            total[i, c] = (sums[0, c] + sums[1, c]) / max(valid[0] + valid[1], 1.0)
            half[i, c] = 0.5 * (sums[0, c] / max(valid[0], 1.0) - sums[1, c] / max(valid[1], 1.0))
        distance[i] = hits / inverse if hits > 0 else np.inf


def _neighbourhoods(leaves: Leaves, facet, neighbours=12):
    """Local linear fits through the leaves around each: coefficients (K, 3, C) of value, d/dx, d/dy at the leaf, and what
    the neighbours without it foretell, (K, C)."""
    from scipy.spatial import cKDTree
    if not len(leaves):
        return np.zeros((0, 3, leaves.irradiance.shape[1])), leaves.irradiance
    where = np.column_stack([leaves.q, 1e6 * facet.astype(float)])        # facets do not mix: far apart in the third coordinate
    distance, near = cKDTree(where).query(where, k=min(neighbours, len(where)))
    distance, near = distance.reshape(len(where), -1), near.reshape(len(where), -1)
    return _local_fits(leaves.q, leaves.irradiance, near, distance)


@njit(cache=True, parallel=True)
def _local_fits(q, value, near, distance):
    m, k = near.shape
    C = value.shape[1]
    fits = np.zeros((m, 3, C))
    foretold = np.zeros((m, C))
    for i in prange(m):
        n = 0
        while n < k and distance[i, n] < 5e5:
            n += 1
        radius = max(1.05 * distance[i, n - 1], 1e-9) if n > 1 else 1.0
        for own in range(2):
            s0, su, sv, suu, suv, svv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            t = np.zeros((3, C))
            for j in range(n):
                g = near[i, j]
                if g == i and own == 0:
                    continue
                w = 1 - (distance[i, j] / radius) ** 2
                w *= w
                u, v = (q[g, 0] - q[i, 0]) / radius, (q[g, 1] - q[i, 1]) / radius
                s0 += w
                su += w * u
                sv += w * v
                suu += w * u * u
                suv += w * u * v
                svv += w * v * v
                for c in range(C):
                    t[0, c] += w * value[g, c]
                    t[1, c] += w * u * value[g, c]
                    t[2, c] += w * v * value[g, c]
            if s0 <= 0:                                    # alone on its facet
                for c in range(C):
                    foretold[i, c] = value[i, c]
                continue
            _linear(s0, su, sv, suu, suv, svv, t, 0.01)
            for c in range(C):
                if own == 0:
                    foretold[i, c] = t[0, c]
                else:
                    fits[i, 0, c] = t[0, c]
                    fits[i, 1, c] = t[1, c] / radius
                    fits[i, 2, c] = t[2, c] / radius
    return fits, foretold


def interpolated(leaves: Leaves, pixels: Pixels):
    """(M, C) irradiance of every pixel: the local fits of the leaves around it, blended smoothly (never across facets)."""
    facet = pixels.facet[leaves.first]
    total = np.zeros((len(pixels), leaves.irradiance.shape[1]))
    rest = leaves
    for _ in range(2):
        # linear fits smooth hollows and domes away; what each leaf then lacks on average is fitted and added
        fits, _ = _neighbourhoods(rest, facet)
        total += _splat(leaves.q, leaves.level, fits, facet, leaves.first, leaves.last, pixels.number, pixels.facet, pixels.x, pixels.y)
        means = np.stack([_means(total[:, c], leaves.first, leaves.last) for c in range(total.shape[1])], axis=1)
        rest = replace(leaves, irradiance=leaves.irradiance - means)
    return np.maximum(total, 0)


@njit(cache=True)
def _splat(q, level, fits, leaf_facet, first, last, number, facet, x, y):
    H, W = number.shape
    m, _, C = fits.shape
    total = np.zeros((len(x), C))
    weight = np.zeros(len(x))
    for i in range(m):
        radius = 1.5 * (1 << level[i])
        x0, x1 = max(int(np.ceil(q[i, 0] - radius)), 0), min(int(q[i, 0] + radius), W - 1)
        y0, y1 = max(int(np.ceil(q[i, 1] - radius)), 0), min(int(q[i, 1] + radius), H - 1)
        for b in range(y0, y1 + 1):
            for a in range(x0, x1 + 1):
                j = number[b, a]
                if j < 0 or facet[j] != leaf_facet[i]:
                    continue
                du, dv = a - q[i, 0], b - q[i, 1]
                w = 1 - (du * du + dv * dv) / (radius * radius)
                if w <= 0:
                    continue
                w *= w / (radius * radius)                 # the finer leaf knows better
                weight[j] += w
                for c in range(C):
                    total[j, c] += w * (fits[i, 0, c] + fits[i, 1, c] * du + fits[i, 2, c] * dv)
    for j in range(len(x)):
        if weight[j] > 0:
            for c in range(C):
                total[j, c] /= weight[j]
    for i in range(m):
        for j in range(first[i], last[i]):
            if weight[j] <= 0:
                total[j] = fits[i, 0]
    return total


# -- mixed pixels

@dataclass(frozen=True)
class Fragments:
    """The A-buffer: what pixels show that hold more than one facet.

    pixel : (P,) flat index;  start : (P + 1,) into the fragments;  facet, side : (S,);  share : (S,) of the pixel
    p : (S, 3) local, the middle of what is seen of it;  owner : (S * 64,) the fragment of each sub-pixel, -1;  at : (S * 64, 3)
    """
    pixel: np.ndarray
    start: np.ndarray
    facet: np.ndarray
    side: np.ndarray
    share: np.ndarray
    p: np.ndarray
    owner: np.ndarray
    at: np.ndarray
    seen: np.ndarray


def fragments(surface: Surface, camera, coverage) -> Fragments:
    """Where the camera sees each fragment: rays through the 8 x 8 sub-pixels.  coverage : pixel, start, facet, count of 64."""
    from lib.gather import backproject
    pixel, start = np.asarray(coverage["pixel"], np.int64), np.asarray(coverage["start"], np.int64)
    facet = np.asarray(coverage["facet"], np.int32)
    p, side = backproject(surface, camera, facet, np.repeat(pixel, np.diff(start)))
    owner, at = np.full(64 * len(pixel), -1, np.int32), np.zeros((64 * len(pixel), 3))
    eye, M = _view(surface, camera)[:2]
    for a in range(0, len(owner), CHUNK):
        rays = _sub_rays(a, min(len(owner), a + CHUNK), pixel, camera.width, eye, M)
        triangle, _ = surface.caster.closest(rays)
        _sort_out(a, rays, triangle, eye, M, pixel, camera.width, start, facet, surface.facet, surface.normal, surface.origin, owner, at)
    mine = owner >= 0
    number = np.bincount(owner[mine], minlength=len(facet))
    for d in range(3):
        p[:, d] = np.where(number > 0, np.bincount(owner[mine], at[mine, d], len(facet)) / np.maximum(number, 1), p[:, d])
    return Fragments(pixel, start, facet, side, np.asarray(coverage["count"], float) / 64, p, owner, at, number > 0)


@njit(cache=True, inline="always")
def _sub_direction(k, pixel, width, M, v):
    """Direction through sub-pixel k of 64 to a pixel, not normalised, into v."""
    i = k // 64
    x = pixel[i] % width + (k % 8 + 0.5) / 8 - 0.5
    y = pixel[i] // width + (k % 64 // 8 + 0.5) / 8 - 0.5
    for d in range(3):
        v[d] = M[d, 0] * x + M[d, 1] * y + M[d, 2]


@njit(cache=True, parallel=True)
def _sub_rays(a, b, pixel, width, eye, M):
    rays = np.empty((b - a, 6), np.float32)
    for k in prange(a, b):
        v = np.empty(3)
        _sub_direction(k, pixel, width, M, v)
        length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        for d in range(3):
            rays[k - a, d] = eye[d]
            rays[k - a, 3 + d] = v[d] / length
    return rays


@njit(cache=True, parallel=True)
def _sort_out(base, rays, triangle, eye, M, pixel, width, start, facet, facet_of, normal, origin, owner, at):
    for k in prange(base, base + len(rays)):
        if triangle[k - base] < 0:
            continue
        i, f = k // 64, facet_of[triangle[k - base]]
        for j in range(start[i], start[i + 1]):
            if facet[j] == f:
                v = np.empty(3)
                _sub_direction(k, pixel, width, M, v)
                height, along = 0.0, 0.0
                for d in range(3):
                    height += (origin[f, d] - eye[d]) * normal[f, d]
                    along += v[d] * normal[f, d]
                owner[k] = j
                for d in range(3):
                    at[k, d] = eye[d] + v[d] * height / (along if abs(along) > 1e-12 else 1e-12)


def fragment_direct(surface: Surface, lamps, n_lamps, fragments: Fragments, rays_each=2):
    """Factor of each fragment to each lamp (S, L), shadow rays from each sub-pixel: a shadow in the corner beside a thin
    board is darker in the pixel where it lies than anywhere else."""
    factor = np.zeros((len(fragments.facet), n_lamps))
    normals = form_factors.side_normals(surface)
    # the sub-pixels of a fragment, in an order of no direction, take one point after the other of one good set
    which = np.flatnonzero(fragments.owner >= 0)
    which = which[np.lexsort((which * 37 % 64, fragments.owner[which]))]
    rank = np.arange(len(which)) - np.searchsorted(fragments.owner[which], fragments.owner[which])
    sequence, shift = sobol(64 * rays_each), shifts(len(fragments.facet), 64 * rays_each, 77)
    which, rank = np.repeat(which, rays_each), np.repeat(rank * rays_each, rays_each) + np.tile(np.arange(rays_each), len(which))
    for number, lamp in enumerate(lamps):
        whole = form_factors.direct(surface, [replace(lamp, lamp=0)], fragments.p, normals, fragments.side, 1, n_samples=1, shadows=False)[:, 0]
        if (surface.n_occluders or lamp.mirrors) and len(which):
            total, seen = np.zeros(len(whole)), np.zeros(len(whole))
            for a in range(0, len(which), CHUNK):
                some = which[a:a + CHUNK]
                rays, weight = _fragment_rays(some, rank[a:a + CHUNK], sequence, shift, fragments.owner, fragments.side, fragments.at, surface.normal,
                                              lamp.corners, lamp.normal, lamp.cdf)
                visible = form_factors.reached(surface, lamp, rays)
                owner = fragments.owner[some]
                total += np.bincount(owner, weight, len(whole))
                seen += np.bincount(owner, weight * visible, len(whole))
            whole = whole * np.divide(seen, total, out=np.zeros_like(seen), where=total > 0)
        factor[:, lamp.lamp] += whole
    return factor


@njit(cache=True, parallel=True)
def _fragment_rays(which, rank, sequence, shift, owner, side, at, normal, lamp, front, cdf):
    rays = np.empty((len(which), 6), np.float32)
    weight = np.empty(len(which), np.float32)
    for j in prange(len(which)):
        i = which[j]
        k, s = rank[j], side[owner[i]]
        u = ((sequence[k, 0] ^ shift[owner[i], 0]) + 0.5) / 4294967296.0
        v = ((sequence[k, 1] ^ shift[owner[i], 1]) + 0.5) / 4294967296.0
        weight[j] = _aim(at[i], normal[s >> 1], 1.0 - 2.0 * (s & 1), u, v, lamp, front, cdf, rays, j)
    return rays, weight


@njit(cache=True, inline="always")
def _aim(p, normal, sign, u, v, lamp, front, cdf, rays, row):
    """Write the shadow ray from p to the point (u, v) of a lamp; returns the light that takes this way, up to a factor."""
    t = 0
    while t < len(cdf) - 1 and cdf[t] <= u:
        t += 1
    low = cdf[t - 1] if t > 0 else 0.0
    r = np.sqrt(min(max((u - low) / (cdf[t] - low), 0.0), 1.0))
    squared, here, there = 0.0, 0.0, 0.0
    for d in range(3):
        target = (1 - r) * lamp[t, 0, d] + r * (1 - v) * lamp[t, 1, d] + r * v * lamp[t, 2, d]
        start = p[d] + OFFSET * sign * normal[d]
        x = target + OFFSET * front[t, d] - start
        rays[row, d] = start
        rays[row, 3 + d] = x
        squared += x * x
        here += x * sign * normal[d]
        there -= x * front[t, d]
    return max(here, 0.0) * max(there, 0.0) / max(squared * squared, 1e-30)


def beside(values, facet, fragments: Fragments):
    """For each fragment the mean of `values` (H, W, C) over the nearest pixels of its facet, within three, and whether there are any."""
    return _beside(values, facet, fragments.pixel, fragments.start, fragments.facet)


@njit(cache=True)
def _beside(picture, facet, pixel, start, fragment):
    H, W, C = picture.shape
    value = np.zeros((len(fragment), C))
    found = np.zeros(len(fragment), np.bool_)
    for i in range(len(pixel)):
        y, x = pixel[i] // W, pixel[i] % W
        for k in range(start[i], start[i + 1]):
            if facet[y, x] == fragment[k]:
                value[k] = picture[y, x]
                found[k] = True
                continue
            for ring in range(1, 4):
                nearest = 1 << 30
                n = 0
                for b in range(max(y - ring, 0), min(y + ring, H - 1) + 1):
                    for a in range(max(x - ring, 0), min(x + ring, W - 1) + 1):
                        if facet[b, a] != fragment[k]:
                            continue
                        d = (a - x) ** 2 + (b - y) ** 2
                        if d < nearest:
                            nearest, n = d, 0
                            value[k] = 0
                        if d == nearest:
                            value[k] += picture[b, a]
                            n += 1
                if n > 0:
                    value[k] /= n
                    found[k] = True
                    break
    return value, found


def looked_up(values, shown: Texture, surface: Surface, p, side):
    """Nearest texels of `values` (K, C) for places on sides; 0 where a side has none."""
    f = side // 2
    uv = np.einsum("ij,iaj->ia", p - surface.origin[f], surface.axes[f]) / np.maximum(surface.size[f], 1e-300)
    n = shown.shape[side]
    cell = np.clip(np.nan_to_num(uv * n), 0, n - 1).astype(np.int64)
    start = shown.start[side]
    if not len(values):
        return np.zeros((len(p), values.shape[1]))
    return values[np.maximum(start, 0) + (cell[:, 0] * n[:, 1] + cell[:, 1]) * (start >= 0)] * (start >= 0)[:, None]
