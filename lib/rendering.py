"""§3.3 The picture: what the camera sees of the balanced light (eq. 3.2), and eq. 3.1 to compare it with.

    light = balance(factors, rho, E)              # patches: small linear solve
    picture = draw(surface, camera, facet, ...)   # pixels, linear
    picture = blend(...)                          # mixed pixels, by the A-buffer's coverage

The light that a pixel receives has two parts. *Direct*: the exact factor of the lamp's polygon times its visible
share, by shadow rays: few everywhere, many where neighbouring pixels disagree (penumbra). *Indirect*: smooth, so it
is gathered by many rays at few places, the leaves of one quadtree over the picture per facet (finer near contacts
and where neighbours cannot foretell it), and spread over the facet's pixels by local linear fits. A gathering ray
does not look at patches, which would show as blotches near corners, but at a texture of every facet: direct light
evaluated again at each texel, indirect light fitted through the patches around it.

Colours are channels C (1 or 3); geometry is local (see lib.rays); a radiosity is camera-referred.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit, prange

from lib import form_factors, radiosity
from lib.form_factors import CHUNK
from lib.mesh import Mesh, Surface
from lib.rays import OFFSET, shifts, sobol

TEXELS = 30_000         # about so many texels in a scene
NEAR = 3.0              # texels: what a gathering ray meets within so many is lit by itself
FAR = 10.0              # local coordinates are smaller: facets this far apart do not mix in a search


# -- the balance of the patches

@dataclass(frozen=True)
class Light:
    """reflected : (N, C)  radiosity of the patches without emission       indirect : (N, C)  F b, what others reflect to them
    flux : emitted, absorbed, escaped (C,)                                residual, iterations : of the solve
    """
    reflected: np.ndarray
    indirect: np.ndarray
    emitted: np.ndarray
    absorbed: np.ndarray
    escaped: np.ndarray
    residual: float
    iterations: int

    @property
    def imbalance(self):
        """|emitted - absorbed - escaped| / emitted over all channels; 0 in the dark."""
        lost = np.abs(self.emitted - self.absorbed - self.escaped).sum()
        return float(lost / self.emitted.sum()) if self.emitted.sum() > 0 else 0.0


def balance(F, D, side_group, area, exposed, rho, E, lamp_groups, front, *, tolerance=1e-6) -> Light:
    """b = rho (D E + F b), and where the light of the lamps ends.

    F : (N, N);  D : (N, L) lamp factors;  side_group : (N,) group of each patch;  area : (N,)
    exposed : (N,) share of each patch outside solids;  rho : (G, C);  E : (L, C);  lamp_groups : (L,)
    front : (N,) bool, the patch lies on the front of its facet

    The flux is closed over rays alone: what leaves a patch and meets nothing, by the sums of its rays, has escaped.
    A closed scene keeps everything, and the lamps' factors, reciprocity and the solve are all in what is left over.
    """
    direct = D @ E
    r = rho[side_group]
    source = (r * direct).astype(np.float32)
    scale = r.astype(np.float32)
    b, residual, iterations = radiosity.gmres(lambda X: X - scale * (F @ X), source, tolerance=tolerance)
    indirect = F @ b
    emittance = np.zeros_like(b, dtype=float)
    for lamp, group in enumerate(lamp_groups):
        emittance[(side_group == group) & front] += E[lamp]
    size = (area * exposed)[:, None]
    reach = np.asarray(F @ np.ones(F.shape[1], np.float32))[:, None]
    emitted = (size * emittance).sum(axis=0)
    absorbed = (size * (1 - r) * (direct + indirect)).sum(axis=0)
    escaped = (size * (emittance + b) * (1 - reach)).sum(axis=0)
    return Light(np.asarray(b, float), np.asarray(indirect, float), emitted, absorbed, escaped, residual, iterations)


# -- what a gathering ray sees: a texture of every side

@dataclass(frozen=True)
class Texture:
    """A grid of texels over each side's bounding rectangle, values at their centres.

    start : (2 F,) int64 into value, -1: nothing reflects there      shape : (2 F, 2) int32      value : (K, C) float32
    irradiance : (K, C)  the same before reflection                good : (K,) bool, in the facet and outside solids
    direct : (K, C) the part of `value` that comes from the lamps at once        step : local, about the width of a texel
    rho : (F, C)
    """
    start: np.ndarray
    shape: np.ndarray
    value: np.ndarray
    irradiance: np.ndarray
    good: np.ndarray
    direct: np.ndarray
    step: float
    rho: np.ndarray


def texture(surface: Surface, mesh: Mesh, lamps, E, light: Light, exposed, rho_facet, *, texels=TEXELS, samples=32, n_rays=64) -> Texture:
    """Reflected radiosity of every side that has patches, direct light from the lamps and not from the patches.

    lamps : from form_factors.emitters;  E : (L, C);  exposed : (N,);  rho_facet : (F, C)
    """
    sides = np.unique(mesh.side)
    size = surface.size[sides // 2]
    step = np.sqrt(max(size.prod(axis=1).sum(), 1e-300) / texels)
    count = np.clip(np.ceil(size / step), 1, 4096).astype(np.int64)
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

    order = np.argsort(surface.facet, kind="stable").astype(np.int64)
    first = np.searchsorted(surface.facet[order], np.arange(len(surface.normal) + 1)).astype(np.int64)
    good = _within(p, f, surface.corners[order], first, normals[2 * f])
    good &= ~_buried(surface, p, side, normals)
    at = np.flatnonzero(good)
    irradiance = np.zeros((len(p), E.shape[1]), np.float32)
    irradiance[at] = form_factors.direct(surface, lamps, p[at], normals, side[at], len(E), n_samples=samples, seed=71) @ E
    lit = np.flatnonzero(exposed > 0)
    place, places = np.hstack([p[at], FAR * side[at, None]]), np.hstack([mesh.centre[lit], FAR * mesh.side[lit, None]])
    between = np.zeros((len(p), E.shape[1]), np.float32)
    rest, patch = light.indirect, _patch_at(mesh, side[at], index[at], shape, mesh.table_shape[side[at]])
    number = np.maximum(np.bincount(np.maximum(patch, 0), patch >= 0, len(mesh)), 1)[:, None]
    for _ in range(3):
        # a fit through hollow or domed light lies above or below it: what a patch lacks on average is added until it agrees
        between[at] += spread(places, rest[lit], place, surface.axes[f[at]])
        found = np.stack([np.bincount(np.maximum(patch, 0), np.where(patch >= 0, between[at, c], 0), len(mesh)) for c in range(E.shape[1])], axis=1) / number
        rest = np.where((np.bincount(np.maximum(patch, 0), patch >= 0, len(mesh)) > 0)[:, None], light.indirect - found, 0)
    between = np.maximum(between, 0)
    _fill(irradiance, good, start[sides], count)
    rho = rho_facet.astype(np.float32)
    first = irradiance * rho[f]
    if n_rays:
        # once more by rays: the light that the patches pass on is then as sharp as the texels, not as the patches
        _fill(between, good, start[sides], count)
        once = Texture(start, shape, first + between * rho[f], irradiance, good, first, float(step), rho)
        ones = np.arange(len(at))
        between[at] = _sent(surface, once, lamps, E, p[at], ones, ones + 1, side[at], n_rays, 650)[0]
    _fill(between, good, start[sides], count)
    return Texture(start, shape, first + between * rho[f], irradiance + between, good, first, float(step), rho)


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
        for t in range(start[facet[i]], start[facet[i] + 1]):
            inside = True
            for e in range(3):
                a, b = corners[t, e], corners[t, (e + 1) % 3]
                x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
                y0, y1, y2 = p[i, 0] - a[0], p[i, 1] - a[1], p[i, 2] - a[2]
                if (x1 * y2 - x2 * y1) * normal[i, 0] + (x2 * y0 - x0 * y2) * normal[i, 1] + (x0 * y1 - x1 * y0) * normal[i, 2] < 0:
                    inside = False
                    break
            if inside:
                out[i] = True
                break
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
def _fill(value, good, start, count):
    """Texels outside the facet or inside a solid take the nearest good one of their side."""
    for s in range(len(start)):
        nu, nv = count[s]
        for a in range(nu):
            for b in range(nv):
                here = start[s] + a * nv + b
                if good[here]:
                    continue
                best, found, ring = 1 << 60, -1, 1
                while ring * ring <= best and ring <= max(nu, nv):
                    for i in range(max(a - ring, 0), min(a + ring, nu - 1) + 1):
                        rim = abs(i - a) == ring
                        j = max(b - ring, 0)
                        while j <= min(b + ring, nv - 1):
                            if (rim or abs(j - b) == ring) and good[start[s] + i * nv + j]:
                                d = (i - a) ** 2 + (j - b) ** 2
                                if d < best:
                                    best, found = d, start[s] + i * nv + j
                            j += 1
                    ring += 1
                if found >= 0:
                    value[here] = value[found]


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


def pixels(surface: Surface, camera, facet) -> Pixels:
    """facet : (H, W) int, -1 = nothing."""
    from lib.gather import backproject
    y, x = np.nonzero(facet >= 0)
    bits = max(1, int(max(facet.shape) - 1).bit_length())
    key = (facet[y, x].astype(np.uint64) << np.uint64(2 * bits)) | _morton(x) | (_morton(y) << np.uint64(1))
    order = np.argsort(key)
    x, y, key = x[order].astype(np.int32), y[order].astype(np.int32), key[order].astype(np.int64)
    number = np.full(facet.shape, -1, np.int64)
    number[y, x] = np.arange(len(x))
    f = facet[y, x].astype(np.int32)
    p, side = backproject(surface, camera, f, y.astype(np.int64) * camera.width + x)
    return Pixels(x, y, f, side, p, key, bits, number)


def direct(surface: Surface, lamps, n_lamps, pixels: Pixels, *, few=4, many=64) -> tuple:
    """Factor of each pixel to each lamp with soft shadows, (M, L), and how many pixels lay in a penumbra.

    few : shadow rays per pixel and emitter everywhere;  many : where the pixels of a 5 x 5 neighbourhood disagree
    """
    factor = np.zeros((len(pixels), n_lamps))
    normals = form_factors.side_normals(surface)
    unshadowed = replace(surface, n_occluders=0)
    uncertain = 0
    for number, lamp in enumerate(lamps):
        one = [replace(lamp, lamp=0)]

        def factors(where, scene, n, seed=0):
            return form_factors.direct(scene, one, pixels.p[where], normals, pixels.side[where], 1, n_samples=n, seed=seed)[:, 0]

        whole = factors(slice(None), unshadowed, 1)
        if surface.n_occluders == 0:
            factor[:, lamp.lamp] += whole
            continue
        lit = np.flatnonzero(whole > 0)
        visible = np.zeros(len(pixels))
        visible[lit] = factors(lit, surface, few, seed=number) / whole[lit]
        penumbra = np.flatnonzero(_disagree(visible, whole > 0, pixels.number, pixels.facet, pixels.x, pixels.y))
        uncertain += len(penumbra)
        if len(penumbra):
            visible[penumbra] = factors(penumbra, surface, many, seed=number + 500) / whole[penumbra]
            visible[penumbra] = _smoothed(visible, penumbra, pixels.number, pixels.facet, pixels.x, pixels.y, 0.7 / many ** 0.75)
        factor[:, lamp.lamp] += whole * visible
    return factor, uncertain


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

    q : (K, 2) px, mean position;  irradiance : (K, C);  sigma : (K,) sampling error relative to the total light
    distance : (K,) local, harmonic mean distance of what is seen;  extent : (K,) local, the block's largest width
    """
    first: np.ndarray
    last: np.ndarray
    level: np.ndarray
    q: np.ndarray
    extent: np.ndarray
    irradiance: np.ndarray
    distance: np.ndarray
    noise: np.ndarray

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


def gather(surface: Surface, shown: Texture, lamps, E, pixels: Pixels, total_direct, *, n_rays=256, largest=5, smallest=1,
           contact=0.35, tolerance=0.01, trace=None) -> Leaves:
    """Indirect light at the leaves, refined from blocks 2^largest px wide down to 2^smallest.

    total_direct : (M, C) direct irradiance of the pixels, the scale of what an error means
    contact : a leaf wider than this times the harmonic mean distance of what it sees is split
    tolerance : and one whose light its neighbours do not foretell to this share of its total light
    """
    first, last = _blocks(pixels, np.zeros(1, np.int64), np.array([len(pixels)]), largest)
    done, fresh = None, None
    brightness = total_direct.mean(axis=1)
    for level in range(largest, smallest - 1, -1):
        fresh = _gathered(surface, shown, lamps, E, pixels, first, last, level, n_rays)
        everything = fresh if done is None else Leaves.joined(done, fresh)
        if level == smallest:
            done = everything
            break
        facet = pixels.facet[everything.first]
        _, foretold = _neighbourhoods(everything, facet)
        total = _means(brightness, everything.first, everything.last) + everything.irradiance.mean(axis=1)
        floor = 0.05 * np.average(total, weights=everything.last - everything.first)
        error = np.abs(foretold - everything.irradiance).mean(axis=1) / (total + floor)
        wide = everything.extent > contact * everything.distance
        split = (wide | (error > np.maximum(tolerance, 3 * everything.noise / (total + floor))))
        split &= (everything.level == level) & (everything.last - everything.first > 4)
        if trace:
            trace(places=len(everything), indirect_error=float(np.sqrt(np.average(error ** 2, weights=everything.last - everything.first))))
        done = everything[~split]
        if not split.any():
            break
        first, last = _blocks(pixels, everything.first[split], everything.last[split], level - 1)
    return done


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
    return Leaves(first, last, np.full(len(first), level), q, extent, total, distance, noise)


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
    return total, half, distance


def _close(surface, shown, lamps, E, rays, triangle, t):
    """Where a ray ends within three texels its target is too near for a texture: a shadow in the corner matters. The number of
    each such ray (n,), -1 for the others, and the radiosity there by direct light, from one shadow ray (m, C)."""
    near = np.full(len(rays), -1, np.int32)
    rows = np.flatnonzero(t < NEAR * shown.step)
    facet = surface.facet[triangle[rows]]
    side = 2 * facet + (np.einsum("ij,ij->i", rays[rows, 3:], surface.normal[facet]) > 0)
    lit = shown.start[side] >= 0
    rows, facet, side = rows[lit], facet[lit], side[lit]
    near[rows] = np.arange(len(rows))
    p = rays[rows, :3] + t[rows, None].astype(float) * rays[rows, 3:]
    factor = form_factors.direct(surface, lamps, p, form_factors.side_normals(surface), side, len(E), n_samples=1, seed=33)
    return near, (factor @ E).astype(np.float32) * shown.rho[facet]


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
        inverse = 0.0
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
            inverse += 1 / max(t[row], OFFSET)
            u, v = 0.0, 0.0
            for d in range(3):
                x = rays[row, d] + t[row] * rays[row, 3 + d] - origin[f, d]
                u += x * axes[f, 0, d]
                v += x * axes[f, 1, d]
            nu, nv = shape[s, 0], shape[s, 1]
            u = min(max(u / size[f, 0] * nu - 0.5, 0.0), nu - 1.0)
            v = min(max(v / size[f, 1] * nv - 0.5, 0.0), nv - 1.0)
            a, b = min(int(u), max(nu - 2, 0)), min(int(v), max(nv - 2, 0))
            u -= a
            v -= b
            here = start[s] + a * nv + b
            du = nv if nu > 1 else 0
            dv = 1 if nv > 1 else 0
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
        distance[i] = (valid[0] + valid[1]) / inverse if inverse > 0 else np.inf


def _neighbourhoods(leaves: Leaves, facet, neighbours=12):
    """Local linear fits through the leaves around each: coefficients (K, 3, C) of value, d/dx, d/dy at the leaf, and what
    the neighbours without it foretell, (K, C)."""
    from scipy.spatial import cKDTree
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
                    fits[i, 0, c] = max(t[0, c], 0.0)
                    fits[i, 1, c] = t[1, c] / radius
                    fits[i, 2, c] = t[2, c] / radius
    return fits, foretold


def interpolated(leaves: Leaves, pixels: Pixels):
    """(M, C) irradiance of every pixel: the local fits of the leaves around it, blended smoothly (never across facets)."""
    fits, _ = _neighbourhoods(leaves, pixels.facet[leaves.first])
    return _splat(leaves.q, leaves.level, fits, pixels.facet[leaves.first], leaves.first, leaves.last,
                  pixels.number, pixels.facet, pixels.x, pixels.y)


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
                total[j, c] = max(total[j, c] / weight[j], 0.0)
    for i in range(m):
        for j in range(first[i], last[i]):
            if weight[j] <= 0:
                total[j] = fits[i, 0]
    return total


# -- the picture

def radiosities(pixels: Pixels, irradiance, surface: Surface, rho, E, lamp_groups, shape):
    """(H, W, C) linear picture at the pixels' centres: what each reflects, and what the front of a lamp emits."""
    group = surface.group[pixels.facet]
    B = rho[group] * irradiance
    for lamp, lamp_group in enumerate(lamp_groups):
        B[(group == lamp_group) & (pixels.side & 1 == 0)] += E[lamp]
    picture = np.zeros((*shape, rho.shape[1]))
    picture[pixels.y, pixels.x] = B
    return picture


def blend(picture, facet, coverage, surface: Surface, shown: Texture, camera, rho, E, lamp_groups):
    """The A-buffer: mixed pixels become the mean of what their fragments show, weighted with their area (linear light).

    A fragment of the pixel's own facet has the pixel's radiosity, any other that of its facet's pixels next to
    it; a facet too thin to own a pixel nearby is looked up in its texture.
    coverage : dict pixel (P,), start (P + 1,), facet (S,), count (S,) of 64
    """
    from lib.gather import backproject
    pixel, start = np.asarray(coverage["pixel"], np.int64), np.asarray(coverage["start"], np.int64)
    fragment, count = np.asarray(coverage["facet"], np.int64), np.asarray(coverage["count"], float)
    value, found = _beside(picture, facet, pixel, start, fragment)
    thin = np.flatnonzero(~found)
    if len(thin):
        owner = np.repeat(pixel, np.diff(start))[thin]
        f = fragment[thin]
        p, side = backproject(surface, camera, f, owner)
        relative = p - surface.origin[f]
        uv = np.einsum("ij,iaj->ia", relative, surface.axes[f]) / np.maximum(surface.size[f], 1e-300)
        n = shown.shape[side]
        cell = np.clip(np.nan_to_num(uv * n), 0, n - 1).astype(np.int64)
        at = shown.start[side]
        group = surface.group[f]
        irradiance = shown.irradiance[np.maximum(at, 0) + cell[:, 0] * n[:, 1] + cell[:, 1]] * (at >= 0)[:, None] if len(shown.irradiance) else 0
        value[thin] = rho[group] * irradiance
        for lamp, lamp_group in enumerate(lamp_groups):
            value[thin[(group == lamp_group) & (side & 1 == 0)]] += E[lamp]
    mixed = np.zeros((len(pixel), picture.shape[2]))
    np.add.at(mixed, np.repeat(np.arange(len(pixel)), np.diff(start)), value * (count / 64)[:, None])
    result = picture.copy()
    result.reshape(-1, picture.shape[2])[pixel] = mixed
    return result


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


# -- local illumination, for comparison

def phong(pixels: Pixels, surface: Surface, lamps, rho, E, lamp_groups, shape, wanted, counted, show):
    """(H, W, C) linear picture by eq. 3.1 as the paper means it as a contrast: ambient light plus, from the middle of each
    lamp's facets, (N.L) / d^2; no shadows, no interreflection, and k_s = 0 because every surface here is diffuse.

    Its two free numbers per channel, ambient intensity and lamp power, are those that suit the photograph best:
    least squares of show(B) against `wanted` (H, W, C) over the pixels `counted` (H, W).
    Returns the picture, ambient (C,), power (C,).
    """
    from scipy.optimize import least_squares
    group = surface.group[pixels.facet]
    normal = form_factors.side_normals(surface)[pixels.side]
    lit = np.zeros((len(pixels), E.shape[1]))
    for lamp in lamps:
        area = 0.5 * np.linalg.norm(np.cross(lamp.corners[:, 1] - lamp.corners[:, 0], lamp.corners[:, 2] - lamp.corners[:, 0]), axis=1)
        centre = (lamp.corners.mean(axis=1) * area[:, None]).sum(axis=0) / area.sum()
        to = centre - pixels.p
        d2 = np.maximum((to ** 2).sum(axis=1), OFFSET ** 2)
        lit += (np.maximum(np.einsum("ij,ij->i", to, normal), 0) / d2 ** 1.5 * area.sum())[:, None] * E[lamp.lamp] / np.pi
    use = np.flatnonzero(counted[pixels.y, pixels.x])
    use = use[::max(1, len(use) // 20000)]
    C = E.shape[1]
    ambient, power = np.zeros(C), np.zeros(C)
    for c in range(C):
        r, l, want = rho[group[use], c], lit[use, c], wanted[pixels.y[use], pixels.x[use], c]
        level = max(float((r * l).mean()), 1e-12)
        if not len(use) or not r.any():
            continue
        start = [0.3 * level / max(float(r.mean()), 1e-12), 1.0]
        best = least_squares(lambda t: show(r * (t[0] + t[1] * l)) - want, start, bounds=([0, 0], [np.inf, np.inf]), x_scale=start)
        ambient[c], power[c] = best.x
    return radiosities(pixels, ambient + power * lit, surface, rho, E, lamp_groups, shape), ambient, power


# -- the whole of it

@dataclass
class Scene:
    """What a rendering needs. C channels: one where the photograph is grey."""
    surface: Surface
    camera: object
    photograph: object               # lib.image.Photograph
    facet: np.ndarray                # (H, W) int32, -1 = nothing
    factors: form_factors.Factors
    coverage: dict
    rho: np.ndarray                  # (G, C)
    E: np.ndarray                    # (L, C)
    kind: str                        # of the transfer
    gamma: float
    groups: tuple
    warnings: list = field(default_factory=list)

    @property
    def channels(self):
        return self.photograph.values.shape[2]

    @property
    def lamp_groups(self):
        return np.array([self.groups.index(name) for name in self.factors.lamps], int)

    @property
    def group(self):
        """(H, W) int, -1 = nothing."""
        return np.where(self.facet >= 0, self.surface.group[self.facet], -1)

    @property
    def pure(self):
        """(H, W) bool: the pixel shows one facet."""
        result = self.facet >= 0
        result.reshape(-1)[np.asarray(self.coverage["pixel"], np.int64)] = False
        return result

    @property
    def counted(self):
        """(H, W) bool: the pixels that say something of the light: of the model, no lamp, neither black nor saturated."""
        values = self.photograph.values
        usable = (values > 2 / 255).all(axis=2) & ((values < 250 / 255).all(axis=2) | self.photograph.linear)
        return self.pure & usable & ~np.isin(self.group, self.lamp_groups)

    @property
    def wanted(self):
        """(H, W, C) the photograph in display values; a linear one under the power 1 / 2.2."""
        values = self.photograph.values
        return np.clip(values, 0, 1) ** (1 / 2.2) if self.photograph.linear else values

    def show(self, B):
        """Linear -> display values in [0, 1], any shape for gamma, linear and srgb, whole pictures for the others."""
        from lib import display
        if self.photograph.linear:
            return np.clip(B, 0, 1) ** (1 / 2.2)
        return display.finished(B, self.kind, self.wanted, self.group, self.pure, self.gamma)

    def quantised(self, shown):
        """What the file will say, and its largest number; an EXR is compared as it is and shown in 8 bits."""
        depth = 65535 if self.photograph.bits == 16 else 255
        return (shown if self.photograph.linear else np.round(shown * depth) / depth), depth

    def channels_of_file(self, values):
        """(H, W, C) with as many channels as the photograph's file."""
        return np.repeat(values, self.photograph.channels_in_file // values.shape[2], axis=2)


@dataclass(frozen=True)
class Picture:
    linear: np.ndarray               # (H, W, C), anti-aliased
    centres: np.ndarray              # (H, W, C), at the pixels' centres
    light: Light
    pixels: Pixels
    shown: Texture
    facts: dict


def imports():
    """What is imported late elsewhere, so that a stage's times are those of its work."""
    import warnings

    import cv2                                                     # noqa: F401
    import open3d                                                  # noqa: F401
    import OpenEXR                                                 # noqa: F401
    import scipy.optimize, scipy.sparse.csgraph, scipy.spatial     # noqa: F401, E401
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour                                              # noqa: F401


def read(model, camera, photograph, facet, formfactors, materials, coverage) -> Scene:
    """All files of a rendering, each checked against the others; BadInput names what does not fit."""
    from lib import artefact, cameras, image, mesh, model as models
    from lib.stage import BadInput
    paths = dict(model=model, photograph=photograph, facet=facet, formfactors=formfactors, materials=materials, coverage=coverage)
    world = models.load(model)
    camera_path, camera = camera, cameras.read_cameramodel(camera)
    photograph = image.read_photograph(photograph)
    facet = image.read_labels(facet) - 1
    for name, array in (("photograph", photograph.values), ("facet", facet)):
        if array.shape[:2] != (camera.height, camera.width):
            raise BadInput(f"{paths[name]}: size: {array.shape[1]} x {array.shape[0]} is not the camera's {camera.width} x {camera.height} ({camera_path})")
    if facet.max(initial=-1) >= world.n_facets:
        raise BadInput(f"{paths['facet']}: value: {facet.max() + 1} is beyond the model's {world.n_facets} facets ({model})")
    factors = form_factors.read(formfactors)
    if factors.groups != tuple(world.groups):
        raise BadInput(f"{formfactors}: groups: {', '.join(factors.groups)} are not the model's {', '.join(world.groups)} ({model})")
    coverage = artefact.read_npz(coverage, "pixel", "start", "facet", "count")
    if coverage["pixel"].max(initial=-1) >= facet.size or coverage["facet"].max(initial=-1) >= world.n_facets:
        raise BadInput(f"{paths['coverage']}: pixel, facet: beyond the picture or the model's {world.n_facets} facets ({model})")
    rho, E, kind, gamma, warnings = read_materials(materials, factors.groups, factors.lamps, photograph.values.shape[2])
    return Scene(mesh.surface(world, factors.lamps), camera, photograph, facet, factors, coverage, rho, E, kind, gamma, factors.groups, warnings)


def read_materials(path, groups, lamps, channels):
    """materials.json -> rho (G, C), E (L, C), kind and gamma of the transfer, warnings.

    A group never seen takes the value that was `assumed`; one without any value is black, with a warning.
    """
    from lib import artefact
    from lib.display import KINDS
    from lib.stage import BadInput
    content = artefact.read_json(path)
    problems, warnings = [], []

    def table(value, name):
        if isinstance(value, dict):
            return value
        problems.append(f"{path}: {name}: {value!r} is not a table")
        return {}

    def numbers(value, name, high):
        if not isinstance(value, list) or len(value) != 3 or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in value):
            problems.append(f"{path}: {name} = {value!r} is not three numbers")
            return np.zeros(channels)
        if min(value) < 0 or max(value) > high:
            problems.append(f"{path}: {name} = {value} is outside [0, {high:g}]" if high < np.inf else f"{path}: {name} = {value} is negative")
        return np.array(value[:channels], float)

    content = table(content, "content")
    entries, lit = table(content.get("groups"), "groups"), table(content.get("lamps"), "lamps")
    rho, E = np.zeros((len(groups), channels)), np.zeros((len(lamps), channels))
    for g, name in enumerate(groups):
        if name not in entries:
            if name not in lamps:
                problems.append(f"{path}: group {name!r}: missing")
            continue
        entry = table(entries[name], f"group {name!r}")
        if entry.get("kind") not in ("diffuse", None):
            problems.append(f"{path}: group {name!r}: kind = {entry['kind']!r} cannot be rendered yet")
        key = "rho_d" if entry.get("rho_d") is not None else "assumed"
        value = entry.get(key)
        if isinstance(value, dict):
            value = value.get("rho_d")
        if value is None:
            if name not in lamps:
                warnings.append(f"group {name!r} has no reflectance, measured or assumed: it is rendered black")
            continue
        rho[g] = numbers(value, f"group {name!r}: {key}", 1)
    for k, name in enumerate(lamps):
        if name not in lit:
            problems.append(f"{path}: lamp {name!r}: missing")
        else:
            E[k] = numbers(table(lit[name], f"lamp {name!r}").get("emittance"), f"lamp {name!r}: emittance", np.inf)
    transfer = table(content.get("transfer"), "transfer")
    kind, gamma = transfer.get("kind"), transfer.get("gamma", 1.0)
    if kind not in KINDS:
        problems.append(f"{path}: transfer: kind = {kind!r} cannot be rendered (known: {', '.join(KINDS)})")
    elif kind == "gamma" and (isinstance(gamma, bool) or not isinstance(gamma, (int, float)) or gamma <= 0):
        problems.append(f"{path}: transfer: gamma = {gamma!r} is not a positive number")
    if problems:
        raise BadInput(*problems)
    return rho, E, kind, float(gamma) if kind == "gamma" else 1.0, warnings


def render(scene: Scene, *, n_rays=256, shadow_rays=64, contact=0.35, tolerance=0.01, timing=None, trace=None) -> Picture:
    """The linear picture of the scene.

    n_rays : gathering rays at each place;  shadow_rays : per pixel and lamp in a penumbra;  contact, tolerance : see `gather`
    timing : context manager by label;  trace : called with the state of each refinement
    """
    import contextlib
    timing = timing or (lambda label: contextlib.nullcontext())
    surface, factors = scene.surface, scene.factors
    mesh, lamp_groups, exposed = factors.mesh, scene.lamp_groups, factors.rows.exposed
    rho, E = scene.rho, scene.E
    with timing("balance"):
        F = factors.rows.matrix()
        F = F.toarray() if len(mesh) <= 6000 else F
        light = balance(F, factors.lamp_factor, factors.patch_group, mesh.area, exposed, rho, E, lamp_groups, mesh.side % 2 == 0)
    with timing("texture"):
        lamps = form_factors.emitters(surface, factors.lamps)
        shown = texture(surface, mesh, lamps, E, light, exposed, rho[surface.group])
    with timing("direct"):
        seen = pixels(surface, scene.camera, scene.facet)
        factor, penumbra = direct(surface, lamps, len(E), seen, many=shadow_rays)
        irradiance = factor @ E
    with timing("indirect"):
        leaves = gather(surface, shown, lamps, E, seen, irradiance, n_rays=n_rays, contact=contact, tolerance=tolerance, trace=trace)
        irradiance += interpolated(leaves, seen)
    with timing("antialias"):
        centres = radiosities(seen, irradiance, surface, rho, E, lamp_groups, scene.facet.shape)
        linear = blend(centres, scene.facet, scene.coverage, surface, shown, scene.camera, rho, E, lamp_groups)
    facts = {"iterations": light.iterations, "residual": light.residual, "penumbra_pixels": penumbra, "places": len(leaves),
             "gathering_rays": len(leaves) * n_rays, "texels": len(shown.value),
             "flux": {"emitted": light.emitted, "absorbed": light.absorbed, "escaped": light.escaped}}
    return Picture(linear, centres, light, seen, shown, facts)


def phong_picture(scene: Scene, picture: Picture):
    """The same view by eq. 3.1, anti-aliased alike: linear picture, ambient intensity (C,), lamp power relative to the true one (C,)."""
    lamps = form_factors.emitters(scene.surface, scene.factors.lamps)
    simple = scene.kind in ("gamma", "linear", "srgb") or scene.photograph.linear
    show = scene.show if simple else lambda B: np.clip(B, 0, 1)
    local, ambient, power = phong(picture.pixels, scene.surface, lamps, scene.rho, scene.E, scene.lamp_groups, scene.facet.shape,
                                  scene.wanted, scene.counted, show)
    local = blend(local, scene.facet, scene.coverage, scene.surface, picture.shown, scene.camera, scene.rho, scene.E, scene.lamp_groups)
    return local, ambient, power


def warm_up(channels):
    """Load or compile every kernel on a box with a lamp and a table, so that a stage's times are those of its work."""
    from types import SimpleNamespace
    from lib import mesh as meshes
    from lib.cameras import Camera
    from lib.image import Photograph
    quads = np.array([((0, 0, 0), (1, 0, 0), (0, 1, 0)), ((0, 0, 1), (0, 1, 0), (1, 0, 0)), ((0, 0, 0), (0, 1, 0), (0, 0, 1)),
                      ((1, 0, 0), (0, 0, 1), (0, 1, 0)), ((.3, .3, .9), (0, .3, 0), (.3, 0, 0)), ((.3, .3, .5), (.3, 0, 0), (0, .3, 0))], float)
    o, a, b = quads[:, 0], quads[:, 1], quads[:, 2]
    normal = np.cross(a, b) / np.linalg.norm(np.cross(a, b), axis=1)[:, None]
    vertices = np.stack([o, o + a, o + a + b, o + b], axis=1).reshape(-1, 3)
    triangles = (4 * np.arange(6)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    model = SimpleNamespace(vertices=vertices, triangles=triangles, triangle_facet=np.repeat(np.arange(6), 2).astype(np.int32), facet_normal=normal,
                            facet_group=np.array([0, 0, 0, 0, 1, 0], np.int32), facet_object=np.zeros(6, np.int32), groups=("wall", "lamp"),
                            solid_objects=lambda: np.array([False]))
    surface = meshes.surface(model, ["lamp"])
    lamps = form_factors.emitters(surface, ["lamp"])
    mesh = meshes.build(surface, patches=20, max_level=0, contrast=1.0, emitters=lamps)
    factor = form_factors.direct(surface, lamps, mesh.centre, form_factors.side_normals(surface), mesh.side, 1, n_samples=4)
    group = surface.group[mesh.side // 2]
    factors = form_factors.Factors(mesh, form_factors.rays(surface, mesh, n_rays=16), factor, ("lamp",), group, ("wall", "lamp"), np.ones(2), 1.0)
    T = np.array([[1, 0, 0, -.5], [0, 0, -1, .5], [0, 1, 0, 1.0], [0, 0, 0, 1]])
    camera = Camera(np.array([[20.0, 0, 10], [0, 20, 10], [0, 0, 1]]), 21, 21, T)
    origin = np.broadcast_to(surface.local.points(camera.centre), (441, 3))
    triangle, _ = surface.caster.closest(np.hstack([origin, camera.rays(camera.pixels().reshape(-1, 2))]).astype(np.float32))
    facet = np.where(triangle >= 0, surface.facet[triangle], -1).reshape(21, 21).astype(np.int32)
    coverage = {"pixel": np.arange(1, dtype=np.int32), "start": np.array([0, 1], np.int32), "facet": np.zeros(1, np.int32), "count": np.array([64], np.uint8)}
    photograph = Photograph(np.full((21, 21, channels), 0.5), 8, False, channels)
    render(Scene(surface, camera, photograph, facet, factors, coverage, np.full((2, channels), 0.5), np.ones((1, channels)), "linear", 1.0, factors.groups), n_rays=16)
