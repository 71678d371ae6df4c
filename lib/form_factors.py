"""Form factors (eq. 3.3): the fraction F[i, j] of the light leaving patch i that reaches patch j.

Rows by rays: points spread over the patch and cosine-distributed directions together form one
four-dimensional low-discrepancy set, so a row's sum is 1 in a closed scene before any normalisation and an
error in one factor is compensated in its neighbour. Lamps are small and bright and therefore treated apart:
the exact factor of the lamp's polygon from a point (Lambert's contour formula) times its visible share.

A ray that starts inside a solid (it meets the solid's inner side first) is dropped, and the row is divided by
the rays that remain: a wall behind a cabinet is not darkened by the inside of the cabinet (DESIGN 7, trap 3).
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from lib.mesh import Mesh, Surface
from lib.rays import OFFSET, shifts, sobol

CHUNK = 1 << 20      # rays in flight
ESCAPED, DROPPED, LOST = -1, -2, -3


@dataclass(frozen=True)
class Rows:
    """Sparse rows of F from rays: F[i, indices[k]] = count[k] / valid[i] for indptr[i] <= k < indptr[i + 1].

    `half` counts the first half of the rays alone: the two halves differ by the sampling error.
    """
    indptr: np.ndarray       # (M + 1,) int64
    indices: np.ndarray      # (nnz,) int32
    count: np.ndarray        # (nnz,) float32
    half: np.ndarray         # (nnz,) float32
    valid: np.ndarray        # (M,) float32, rays that start outside solids
    valid_half: np.ndarray   # (M,) float32
    shot: np.ndarray         # (M,) int64
    lost: np.ndarray         # (M,) float32, rays whose hit lies on no patch (counted as black)
    columns: int

    def matrix(self, half=None):
        """(M, N) scipy.sparse CSR float32; half 0 or 1: from the first or the second half of the rays alone."""
        from scipy.sparse import csr_array
        count = self.count if half is None else self.half if half == 0 else self.count - self.half
        valid = self.valid if half is None else self.valid_half if half == 0 else self.valid - self.valid_half
        scale = np.repeat(1 / np.maximum(valid, 1), np.diff(self.indptr))
        return csr_array(((count * scale).astype(np.float32), self.indices, self.indptr), shape=(len(self.valid), self.columns))

    @classmethod
    def dense(cls, F) -> "Rows":
        """Rows of a matrix (N, N) that did not come from rays."""
        row, column = np.nonzero(F)
        value = F[row, column].astype(np.float32)
        one = np.ones(len(F), np.float32)
        return cls(np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(F)))]), column.astype(np.int32), value, value / 2,
                   one, one / 2, np.ones(len(F), np.int64), np.zeros(len(F), np.float32), F.shape[1])

    @property
    def row_sums(self):
        """(M,) before any normalisation: 1 in a closed scene, 0 for a patch wholly inside a solid."""
        total = np.zeros(len(self.valid))
        np.add.at(total, np.repeat(np.arange(len(self.valid)), np.diff(self.indptr)), self.count)
        return total / np.maximum(self.valid, 1)

    @property
    def exposed(self):
        """(M,) share of the patch that lies outside solids."""
        return self.valid / np.maximum(self.shot, 1)


# -- ray generation

@njit(cache=True, inline="always")
def _cosine(u, v, n, x, y, out, k):
    r = np.sqrt(u)
    phi = 2 * np.pi * v
    a, b, c = r * np.cos(phi), r * np.sin(phi), np.sqrt(max(0.0, 1 - u))
    for d in range(3):
        out[k, 3 + d] = a * x[d] + b * y[d] + c * n[d]


@njit(cache=True, inline="always")
def _in_patch(i, u, v, tri_start, tri_uv, tri_cdf):
    """A point of patch i, in facet coordinates, uniform for uniform (u, v)."""
    a, b = tri_start[i], tri_start[i + 1]
    s = a
    while s < b - 1 and tri_cdf[s] <= u:
        s += 1
    low = tri_cdf[s - 1] if s > a else 0.0
    u = min(max((u - low) / (tri_cdf[s] - low), 0.0), 1.0)
    r = np.sqrt(u)
    w0, w1, w2 = 1 - r, r * (1 - v), r * v
    t = tri_uv[s]
    return w0 * t[0, 0] + w1 * t[1, 0] + w2 * t[2, 0], w0 * t[0, 1] + w1 * t[1, 1] + w2 * t[2, 1]


@njit(cache=True, parallel=True)
def _patch_rays(first, last, n, points, shift, side, tri_start, tri_uv, tri_cdf, origin, axes, normal):
    out = np.empty(((last - first) * n, 6), np.float32)
    for i in prange(first, last):
        f = side[i] >> 1
        sign = 1.0 - 2.0 * (side[i] & 1)
        nrm = normal[f] * sign
        h0, h1, h2, h3 = shift[i]
        for k in range(n):
            u, v = _in_patch(i, ((points[k, 0] ^ h0) + 0.5) / 4294967296.0, ((points[k, 1] ^ h1) + 0.5) / 4294967296.0,
                             tri_start, tri_uv, tri_cdf)
            row = (i - first) * n + k
            for d in range(3):
                out[row, d] = origin[f, d] + u * axes[f, 0, d] + v * axes[f, 1, d] + OFFSET * nrm[d]
            _cosine(((points[k, 2] ^ h2) + 0.5) / 4294967296.0, ((points[k, 3] ^ h3) + 0.5) / 4294967296.0,
                    nrm, axes[f, 0], axes[f, 1], out, row)
    return out


@njit(cache=True, parallel=True)
def _point_rays(ray_start, first, last, points, shift, other, point_start, p, side, axes, normal):
    """Rays of the elements first..last; element i owns the points p[point_start[i]:point_start[i + 1]] (M, 3)."""
    base = ray_start[first]
    out = np.empty((ray_start[last] - base, 6), np.float32)
    for i in prange(first, last):
        f = side[i] >> 1
        nrm = normal[f] * (1.0 - 2.0 * (side[i] & 1))
        m = point_start[i + 1] - point_start[i]
        n = ray_start[i + 1] - ray_start[i]
        for j in range(n):
            # the halves are scrambled independently: their errors are, too (reflectance.py corrects with them)
            k = j if j < (n + 1) // 2 else j - (n + 1) // 2
            h0, _, h2, h3 = shift[i] if j < (n + 1) // 2 else other[i]
            q = point_start[i] + min(m - 1, int(((points[k, 0] ^ h0) + 0.5) / 4294967296.0 * m))
            row = ray_start[i] - base + j
            for d in range(3):
                out[row, d] = p[q, d] + OFFSET * nrm[d]
            _cosine(((points[k, 2] ^ h2) + 0.5) / 4294967296.0, ((points[k, 3] ^ h3) + 0.5) / 4294967296.0,
                    nrm, axes[f, 0], axes[f, 1], out, row)
    return out


# -- binning

@njit(cache=True, parallel=True)
def _locate(rays, triangle, distance, facet, normal, origin, axes, size, inside, table_start, table_shape, leaf):
    """The patch each ray arrives at, (n,) int32, or ESCAPED, DROPPED, LOST."""
    n = len(rays)
    out = np.empty(n, np.int32)
    for k in prange(n):
        if triangle[k] < 0:
            out[k] = ESCAPED
            continue
        f = facet[triangle[k]]
        along = rays[k, 3] * normal[f, 0] + rays[k, 4] * normal[f, 1] + rays[k, 5] * normal[f, 2]
        s = 2 * f + (1 if along > 0 else 0)
        if inside[s]:
            out[k] = DROPPED
            continue
        if table_start[s] < 0:              # a side that sees nothing: the ray starts in the crack of a contact
            out[k] = DROPPED
            continue
        u = 0.0
        v = 0.0
        for d in range(3):
            x = rays[k, d] + distance[k] * rays[k, 3 + d] - origin[f, d]
            u += x * axes[f, 0, d]
            v += x * axes[f, 1, d]
        nu, nv = table_shape[s, 0], table_shape[s, 1]
        a = min(max(int(u / size[f, 0] * nu), 0), nu - 1)
        b = min(max(int(v / size[f, 1] * nv), 0), nv - 1)
        patch = leaf[table_start[s] + a * nv + b]
        if patch < 0:                       # beyond a slanted border by rounding: the next cell inside
            for da in range(-1, 2):
                for db in range(-1, 2):
                    if patch < 0 and 0 <= a + da < nu and 0 <= b + db < nv:
                        patch = leaf[table_start[s] + (a + da) * nv + b + db]
        out[k] = patch if patch >= 0 else LOST
    return out


@njit(cache=True, parallel=True)
def _compress(hit, ray_start, first, last):
    """Count equal hits per element: entries per row, valid, valid in the first half, lost; hit is sorted in place by (patch, half)."""
    m = last - first
    base = ray_start[first]
    entries = np.zeros(m, np.int64)
    valid = np.zeros(m, np.float32)
    valid_half = np.zeros(m, np.float32)
    lost = np.zeros(m, np.float32)
    keys = np.empty(len(hit), np.int64)
    for i in prange(m):
        a, b = ray_start[first + i] - base, ray_start[first + i + 1] - base
        middle = a + (b - a + 1) // 2
        for k in range(a, b):
            h = hit[k]
            keys[k] = 2 * np.int64(h) + (1 if k >= middle else 0)
            if h != DROPPED:
                valid[i] += 1
                if k < middle:
                    valid_half[i] += 1
            if h == LOST:
                lost[i] += 1
        keys[a:b].sort()
        previous = np.int64(-1)
        for k in range(a, b):
            patch = keys[k] >> 1
            if patch >= 0 and patch != previous:
                entries[i] += 1
                previous = patch
    return keys, entries, valid, valid_half, lost


@njit(cache=True, parallel=True)
def _fill(keys, ray_start, first, last, indptr):
    base = ray_start[first]
    n = indptr[-1]
    indices = np.empty(n, np.int32)
    count = np.zeros(n, np.float32)
    half = np.zeros(n, np.float32)
    for i in prange(last - first):
        a, b = ray_start[first + i] - base, ray_start[first + i + 1] - base
        out = indptr[i] - 1
        previous = np.int64(-1)
        for k in range(a, b):
            patch = keys[k] >> 1
            if patch < 0:
                continue
            if patch != previous:
                out += 1
                indices[out] = patch
                previous = patch
            count[out] += 1
            if keys[k] & 1 == 0:
                half[out] += 1
    return indices, count, half


def _trace(surface: Surface, mesh: Mesh, rays):
    triangle, distance = surface.caster.closest(rays)
    hit = _locate(rays, triangle, distance, surface.facet, surface.normal, surface.origin, surface.axes, surface.size,
                  surface.inside, mesh.table_start, mesh.table_shape, mesh.leaf)
    hit[buried(surface, rays, triangle)] = DROPPED
    return hit, distance


def buried(surface: Surface, rays, triangle):
    """(k,) int: rays that start in a solid and yet meet an outer side first, that of another solid which overlaps the first."""
    if not surface.overlap.any():
        return np.zeros(0, int)
    doubtful = np.flatnonzero((triangle >= 0) & (surface.overlap[surface.facet[triangle]] != 0))
    if not len(doubtful):                        # open3d crashes where it has no ray to follow
        return doubtful
    return doubtful[surface.caster.winding(rays[doubtful], surface.overlap, surface.facet, surface.normal) > 0]


def _rows(surface, mesh, ray_start, make, progress=None) -> Rows:
    """Rows of all elements, in chunks: make(first, last) -> rays of the elements first..last-1."""
    m = len(ray_start) - 1
    if m == 0:
        return _count(np.zeros(0, np.int32), np.zeros(1, np.int64), 0, 0, len(mesh))
    parts = []
    first = 0
    while first < m:
        last = max(first + 1, int(np.searchsorted(ray_start, ray_start[first] + CHUNK, "right")) - 1)
        parts.append(_count(_trace(surface, mesh, make(first, last))[0], ray_start, first, last, len(mesh)))
        if progress is not None:
            progress(last / m)
        first = last
    if len(parts) == 1:
        return parts[0]
    join = {name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("indices", "count", "half", "valid", "valid_half", "shot", "lost")}
    return Rows(indptr=np.concatenate([[0], np.cumsum(np.concatenate([np.diff(part.indptr) for part in parts]))]), columns=len(mesh), **join)


def _count(hit, ray_start, first, last, columns) -> Rows:
    """Rows of the elements first..last-1 from the patch that each of their rays met."""
    keys, entries, valid, valid_half, lost = _compress(hit, ray_start, first, last)
    indptr = np.concatenate([[0], np.cumsum(entries)])
    indices, count, half = _fill(keys, ray_start, first, last, indptr)
    return Rows(indptr, indices, count, half, valid, valid_half, np.diff(ray_start[first:last + 1]), lost, columns)


def rays(surface: Surface, mesh: Mesh, *, n_rays, seed=0, progress=None) -> Rows:
    """F between all patches from `n_rays` rays per patch (a power of two spreads best). Error about 0.5 / n_rays^0.75
    of a row's irradiance, measured by `make bench`."""
    return _rows(surface, mesh, *from_patches(surface, mesh, n_rays, seed), progress)


def from_patches(surface: Surface, mesh: Mesh, n_rays, seed=0):
    """Where each patch's rays begin, (N + 1,), and make(first, last) -> rays of the patches first..last-1, (n, 6)."""
    points, shift = sobol(n_rays), shifts(len(mesh), n_rays, seed)
    return np.arange(len(mesh) + 1, dtype=np.int64) * n_rays, lambda a, b: _patch_rays(
        a, b, n_rays, points, shift, mesh.side, mesh.tri_start, mesh.tri_uv, mesh.tri_cdf, surface.origin, surface.axes, surface.normal)


def gather(surface: Surface, mesh: Mesh, points, point_start, side, n_rays, *, seed=0, progress=None) -> Rows:
    """F from sets of points (pixels) to all patches.

    points : (M, 3) local;  point_start : (K + 1,) the points of each set;  side : (K,) side of the facet they lie on
    n_rays : (K,) rays of each set, spread over its points
    """
    return _rows(surface, mesh, *from_points(surface, points, point_start, side, n_rays, seed), progress)


def from_points(surface: Surface, points, point_start, side, n_rays, seed=0):
    """The same of sets of points: see `gather`."""
    ray_start = np.concatenate([[0], np.cumsum(n_rays)]).astype(np.int64)
    most = int(np.max(n_rays, initial=1))
    sequence, shift, other = sobol(most), shifts(len(side), most, seed), shifts(len(side), most, seed + 1)
    points, point_start, side = np.asarray(points, float), np.asarray(point_start, np.int64), np.asarray(side, np.int32)
    return ray_start, lambda a, b: _point_rays(ray_start, a, b, sequence, shift, other, point_start, points, side, surface.axes, surface.normal)


def probe(surface: Surface, mesh: Mesh, *, n_rays, seed=0):
    """Share of each patch's rays that meet the lit side of something, (N,)."""
    points, shift = sobol(n_rays), shifts(len(mesh), n_rays, seed + 1000)
    seen = np.zeros(len(mesh))
    step = max(1, CHUNK // n_rays)
    for a in range(0, len(mesh), step):
        b = min(len(mesh), a + step)
        r = _patch_rays(a, b, n_rays, points, shift, mesh.side, mesh.tri_start, mesh.tri_uv, mesh.tri_cdf,
                        surface.origin, surface.axes, surface.normal)
        triangle, _ = surface.caster.closest(r)
        f = surface.facet[triangle]
        back = np.einsum("ij,ij->i", r[:, 3:], surface.normal[f]) > 0
        seen[a:b] = ((triangle >= 0) & ~surface.inside[2 * f + back]).reshape(-1, n_rays).mean(axis=1)
    return seen


# -- lamps

@dataclass(frozen=True)
class Emitter:
    """Triangles of one lamp that are sampled together."""
    lamp: int                # index into the lamp groups
    corners: np.ndarray      # (K, 3, 3) local
    normal: np.ndarray       # (K, 3) front
    cdf: np.ndarray          # (K,) cumulated share of the area
    facets: tuple = ()       # their facets, where nothing mirrors them
    mirrors: tuple = ()      # facets of plane mirrors that show it, the one nearest to the receiver first: the rest is its mirror image


def emitters(surface: Surface, lamps) -> list[Emitter]:
    """The lamps' facets: each by itself while they are few, together where a lamp is a mesh of many.

    lamps : names of the groups that emit, in the order of the columns of the factors
    """
    result = []
    area = np.linalg.norm(np.cross(surface.corners[:, 1] - surface.corners[:, 0], surface.corners[:, 2] - surface.corners[:, 0]), axis=1)
    for lamp, name in enumerate(lamps):
        facets = np.flatnonzero(surface.group == surface.groups.index(name))
        sets = [[f] for f in facets] if len(facets) <= 8 else [facets]
        for chosen in sets:
            t = np.flatnonzero(np.isin(surface.facet, chosen))
            result.append(Emitter(lamp, surface.corners[t], surface.normal[surface.facet[t]], np.cumsum(area[t]) / area[t].sum(), tuple(int(f) for f in chosen)))
    return result


def reached(surface: Surface, lamp: Emitter, rays):
    """(n,) bool: nothing stands on the way to the points of the lamp that rays (n, 6), origin and vector, aim at.

    Of a mirrored lamp the way leads through its mirrors: it must meet each of them first, and nothing after the last.
    """
    if not lamp.mirrors:
        return ~surface.shadows.occluded(rays, 1 - 1e-4)
    open_ = np.ones(len(rays), bool)
    o, v = rays[:, :3].astype(float), rays[:, 3:].astype(float)
    for f in lamp.mirrors:
        i = np.flatnonzero(open_)
        n = surface.normal[f]
        along = v[i] @ n
        share = np.divide((surface.origin[f] - o[i]) @ n, along, out=np.full(len(i), -1.0), where=np.abs(along) > 1e-12)
        crosses = (share > 0) & (share < 1)
        length = np.linalg.norm(v[i], axis=1, keepdims=True)
        triangle, t = surface.caster.closest(np.hstack([o[i], v[i] / np.maximum(length, 1e-300)]).astype(np.float32))
        meets = crosses & (triangle >= 0) & (surface.facet[triangle] == f)
        open_[i[~meets]] = False
        i, share, along = i[meets], share[meets], along[meets]
        o[i] = o[i] + share[:, None] * v[i] - np.sign(along)[:, None] * OFFSET * n
        v[i] = (1 - share)[:, None] * (v[i] - 2 * along[:, None] * n)
    i = np.flatnonzero(open_)
    open_[i] = ~surface.shadows.occluded(np.hstack([o[i], v[i]]).astype(np.float32), 1 - 1e-4)
    return open_


@njit(cache=True)
def polygon_factor(p, n, corners, m, work):
    """Form factor from the element at p with normal n to a polygon, everything in front of it visible.

    Lambert's contour formula, the polygon first clipped at the element's horizon. corners : (>= m, 3)
    """
    k = 0
    for i in range(m):
        a = corners[i] - p
        b = corners[(i + 1) % m] - p
        da, db = np.dot(a, n), np.dot(b, n)
        if da >= 0:
            work[k] = a
            k += 1
        if (da > 0 and db < 0) or (da < 0 and db > 0):
            work[k] = a + (b - a) * (da / (da - db))
            k += 1
    total = 0.0
    for i in range(k):
        a = work[i]
        b = work[(i + 1) % k]
        c0 = a[1] * b[2] - a[2] * b[1]
        c1 = a[2] * b[0] - a[0] * b[2]
        c2 = a[0] * b[1] - a[1] * b[0]
        length = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
        if length > 0:
            total += np.arctan2(length, np.dot(a, b)) * (c0 * n[0] + c1 * n[1] + c2 * n[2]) / length
    return total / (2 * np.pi)


@njit(cache=True, parallel=True)
def _factors(p, normal_idx, normals, corners, front):
    """Sum over triangles of the factor from each point, of those whose front faces it."""
    out = np.zeros(len(p))
    for i in prange(len(p)):
        work = np.empty((8, 3))
        n = normals[normal_idx[i]]
        for t in range(len(corners)):
            if np.dot(p[i] - corners[t, 0], front[t]) > 1e-12:
                out[i] += abs(polygon_factor(p[i], n, corners[t], 3, work))
    return out


@njit(cache=True, parallel=True)
def _shadow_rays(p, normal_idx, normals, which, n, points, shift, corners, front, cdf):
    rays = np.empty((len(which) * n, 6), np.float32)
    weight = np.empty(len(which) * n, np.float32)
    for j in prange(len(which)):
        i = which[j]
        nrm = normals[normal_idx[i]]
        h0, h1 = shift[j, 0], shift[j, 1]
        for k in range(n):
            u = ((points[k, 0] ^ h0) + 0.5) / 4294967296.0
            v = ((points[k, 1] ^ h1) + 0.5) / 4294967296.0
            t = 0
            while t < len(cdf) - 1 and cdf[t] <= u:
                t += 1
            low = cdf[t - 1] if t > 0 else 0.0
            r = np.sqrt(min(max((u - low) / (cdf[t] - low), 0.0), 1.0))
            row = j * n + k
            squared, cos_here, cos_there = 0.0, 0.0, 0.0
            for d in range(3):
                target = (1 - r) * corners[t, 0, d] + r * (1 - v) * corners[t, 1, d] + r * v * corners[t, 2, d]
                start = p[i, d] + OFFSET * nrm[d]
                x = target + OFFSET * front[t, d] - start
                rays[row, d] = start
                rays[row, 3 + d] = x
                squared += x * x
                cos_here += x * nrm[d]
                cos_there -= x * front[t, d]
            weight[row] = max(cos_here, 0.0) * max(cos_there, 0.0) / max(squared * squared, 1e-30)
    return rays, weight


def direct(surface: Surface, lamps, points, normals, normal_idx, n_lamps, *, n_samples, seed=0, start=None, weight=None, shadows=True) -> np.ndarray:
    """Factor from each point to each lamp, shadows included, (M, n_lamps); with `start`, the mean over each set of points.

    The exact unoccluded factor times the visible share, estimated from `n_samples` points of the lamp weighted
    with the light they would send; without an occluder in the scene no ray is cast and the result is exact. The
    share is a ratio of sums and biased by about 1 / samples: where a mean is wanted (`start`), the sums run over
    the whole set, which takes the bias away (4 samples per pixel and a ratio per pixel cost 0.6 % on `office`).

    points : (M, 3) local, on their facets;  normals : (K, 3);  normal_idx : (M,) the normal of each point
    start : (S + 1,) sets of consecutive points -> (S, n_lamps);  weight : (M,) of the points in their set
    shadows : False: as if nothing stood in between (and mirrors showed all of a mirrored lamp)
    """
    weight = np.ones(len(points)) if weight is None else np.asarray(weight, float)
    first = np.arange(len(points)) if start is None else np.asarray(start[:-1])
    sets = len(first)
    mass = np.maximum(np.add.reduceat(weight, first), 1e-300) if sets else np.zeros(0)
    factor = np.zeros((sets, n_lamps))
    sequence = sobol(n_samples)
    for number, lamp in enumerate(lamps):
        share = _factors(points, normal_idx, normals, lamp.corners, lamp.normal) * weight
        total = (np.add.reduceat(share, first) if sets else share) / mass
        if shadows and (surface.n_occluders or lamp.mirrors):
            lit = np.flatnonzero(share > 0)
            seen, sent = np.zeros(len(points)), np.zeros(len(points))
            for a in range(0, len(lit), max(1, CHUNK // n_samples)):
                which = lit[a:a + max(1, CHUNK // n_samples)]
                shift = shifts(len(which), n_samples, seed + 31 * number)
                r, light = _shadow_rays(points, normal_idx, normals, which, n_samples, sequence, shift, lamp.corners, lamp.normal, lamp.cdf)
                visible = reached(surface, lamp, r)
                sent[which] = light.reshape(-1, n_samples).sum(axis=1)
                seen[which] = (light * visible).reshape(-1, n_samples).sum(axis=1)
            if start is not None:
                seen, sent = np.add.reduceat(seen * weight, first), np.add.reduceat(sent * weight, first)
            total = total * np.divide(seen, sent, out=np.zeros_like(seen), where=sent > 0)
        factor[:, lamp.lamp] += total
    return factor


@njit(cache=True, parallel=True)
def _patch_points(n, points, shift, side, tri_start, tri_uv, tri_cdf, origin, axes):
    out = np.empty((len(side) * n, 3))
    for i in prange(len(side)):
        f = side[i] >> 1
        h0, h1 = shift[i, 0], shift[i, 1]
        for k in range(n):
            u, v = _in_patch(i, ((points[k, 0] ^ h0) + 0.5) / 4294967296.0, ((points[k, 1] ^ h1) + 0.5) / 4294967296.0,
                             tri_start, tri_uv, tri_cdf)
            for d in range(3):
                out[i * n + k, d] = origin[f, d] + u * axes[f, 0, d] + v * axes[f, 1, d]
    return out


def side_normals(surface) -> np.ndarray:
    """(2 F, 3): the normal of each side."""
    return np.stack([surface.normal, -surface.normal], axis=1).reshape(-1, 3)


def patch_direct(surface: Surface, mesh: Mesh, lamps, n_lamps, *, n_points, n_samples=4, seed=0) -> np.ndarray:
    """Mean factor of each patch to each lamp, (N, n_lamps), over its points outside solids: a patch half under a
    cabinet has the light of its other half (DESIGN 7, trap 3)."""
    p = _patch_points(n_points, sobol(n_points), shifts(len(mesh), n_points, seed + 2000), mesh.side, mesh.tri_start, mesh.tri_uv, mesh.tri_cdf,
                      surface.origin, surface.axes)
    normals = side_normals(surface)
    normal_idx = np.repeat(mesh.side, n_points)
    is_open = np.ones(len(p), bool)
    if surface.inside.any():
        n = normals[normal_idx]
        up = np.hstack([p + OFFSET * n, n]).astype(np.float32)
        triangle, _ = surface.caster.closest(up)
        f = surface.facet[triangle]
        back = np.einsum("ij,ij->i", n, surface.normal[f]) > 0
        is_open = (triangle < 0) | ~surface.inside[2 * f + back]
        is_open[buried(surface, up, triangle)] = False
    return direct(surface, lamps, p, normals, normal_idx, n_lamps, n_samples=n_samples, seed=seed,
                  start=np.arange(len(mesh) + 1) * n_points, weight=is_open)


@njit(cache=True, parallel=True)
def _quadrants(rays, n, hit, light, side, middle, origin, axes, out, noise):
    """Mean light arriving at each quadrant of each patch from its rays, (N, 4) NaN where no ray starts, and the
    variance of that mean. middle : (N, 2) of the cell, facet coordinates; light : (N,) radiosity."""
    for i in prange(len(side)):
        f = side[i] >> 1
        total, square, count = np.zeros(4), np.zeros(4), np.zeros(4)
        for k in range(i * n, (i + 1) * n):
            if hit[k] == DROPPED:
                continue
            u, v = 0.0, 0.0
            for d in range(3):
                x = rays[k, d] - origin[f, d]
                u += x * axes[f, 0, d]
                v += x * axes[f, 1, d]
            q = 2 * (u > middle[i, 0]) + (v > middle[i, 1])
            value = light[hit[k]] if hit[k] >= 0 else 0.0
            total[q] += value
            square[q] += value * value
            count[q] += 1
        for q in range(4):
            if count[q] > 0:
                out[i, q] = total[q] / count[q]
                noise[i, q] = max(square[q] / count[q] - out[i, q] ** 2, 0.0) / count[q]


def light_spread(surface: Surface, mesh: Mesh, middle, lamps, *, n_rays, seed=0):
    """How unevenly each patch is lit: mean irradiance (N,) and the standard deviation between the means of its four
    quadrants (N,), sampling noise taken off, in a scene of reflectance 0.5 with all lamps at equal power.

    middle : (N, 2) where the cells would be split, facet coordinates
    """
    from lib import radiosity
    n_lamps = 1 + max(lamp.lamp for lamp in lamps)
    n_points = min(16, n_rays)
    ray_start = np.arange(len(mesh) + 1, dtype=np.int64) * n_rays
    points, shift = sobol(n_rays), shifts(len(mesh), n_rays, seed)
    rays_, hits = [], []
    step = max(1, CHUNK // n_rays)
    for a in range(0, len(mesh), step):
        r = _patch_rays(a, min(len(mesh), a + step), n_rays, points, shift, mesh.side, mesh.tri_start, mesh.tri_uv, mesh.tri_cdf,
                        surface.origin, surface.axes, surface.normal)
        rays_.append(r)
        hits.append(_trace(surface, mesh, r)[0])
    r, hit = np.concatenate(rays_), np.concatenate(hits)
    rows = _count(hit, ray_start, 0, len(mesh), len(mesh))
    # direct light at the starts of the first rays of each patch
    first = (np.arange(len(mesh))[:, None] * n_rays + np.arange(n_points)).ravel()
    factor = direct(surface, lamps, r[first, :3].astype(float), side_normals(surface), np.repeat(mesh.side, n_points), n_lamps,
                    n_samples=4, seed=seed).sum(axis=1)
    is_open = hit[first] != DROPPED
    D = np.bincount(np.repeat(np.arange(len(mesh)), n_points), factor * is_open, minlength=len(mesh)) \
        / np.maximum(is_open.reshape(-1, n_points).sum(axis=1), 1)
    F = rows.matrix()
    b, _, _ = radiosity.gmres(lambda X: X - np.float32(0.5) * (F @ X), (0.5 * D[:, None]).astype(np.float32), tolerance=1e-3)
    mean = np.full((len(mesh), 4), np.nan)
    noise = np.full((len(mesh), 4), np.nan)
    _quadrants(r, n_rays, hit, b[:, 0].astype(float), mesh.side, middle, surface.origin, surface.axes, mean, noise)
    relative = r[first, :3] - surface.origin[mesh.side // 2].repeat(n_points, axis=0)
    axes = surface.axes[mesh.side // 2].repeat(n_points, axis=0)
    at = np.einsum("nd,nad->na", relative, axes) > middle.repeat(n_points, axis=0)
    cell = 4 * np.repeat(np.arange(len(mesh)), n_points) + 2 * at[:, 0] + at[:, 1]
    count = np.bincount(cell, is_open, minlength=4 * len(mesh)).reshape(-1, 4)
    total = np.bincount(cell, factor * is_open, minlength=4 * len(mesh)).reshape(-1, 4)
    mean += np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    known = np.isfinite(mean)
    several = known.sum(axis=1) >= 2
    middle_value = np.where(known, mean, 0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    spread = (np.where(known, mean - middle_value[:, None], 0) ** 2 - np.where(known, noise, 0)).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return D + F @ b[:, 0], np.where(several, np.sqrt(np.maximum(spread, 0)), 0)


# -- formfactors.npz

@dataclass(frozen=True)
class Factors:
    """What formfactors.npz holds: the patches, the factors between them, and those to the lamps."""
    mesh: Mesh
    rows: Rows
    lamp_factor: np.ndarray      # (N, L)
    lamps: tuple                 # names, in the order of the columns
    patch_group: np.ndarray      # (N,) int32, numbers of `groups`
    groups: tuple
    group_area_m2: np.ndarray    # (G,)
    diagonal_m: float

    @property
    def area(self):
        """(N,) local, the part of each patch outside solids."""
        return self.mesh.area * self.rows.exposed

    def subcell(self, share=1 / 3):
        """(N, N) CSR: b -> b + share * (b - mean of b over the patch and its siblings), for the *sources* of a balance.

        A patch of constant radiosity lets its bright and its dark part be seen alike by those who see only one of
        them. What is lost that way inside a cell is a fixed share of what the step to the next coarser cell would
        lose: (h^2 / 12) / (h^2 / 4) = 1/3 where light varies linearly, 1 across a random edge. Row by row this is
        Richardson's extrapolation in the size of the patches, linear and conserving the light of each parent; on
        the shipped scenes it halves the error three times over (0.43 % -> 0.13 % for `office`, 1.06 % -> 0.12 %
        for `gallery-white` together with a finer mesh) at no cost.
        """
        from scipy.sparse import csr_array, diags_array, eye_array
        n = len(self.area)
        total = np.bincount(self.mesh.parent, self.area)[self.mesh.parent]
        siblings = csr_array((np.ones(n), (np.arange(n), self.mesh.parent)), shape=(n, int(self.mesh.parent.max()) + 1))
        weight = diags_array(np.divide(self.area, total, out=np.zeros(n), where=total > 0))
        return ((1 + share) * eye_array(n) - share * (siblings @ (siblings.T @ weight))).astype(np.float32).tocsr()


def write(path, factors: Factors):
    from dataclasses import fields
    from lib import artefact
    arrays = {f"mesh_{f.name}": getattr(factors.mesh, f.name) for f in fields(Mesh)}
    arrays |= {f"rows_{f.name}": getattr(factors.rows, f.name) for f in fields(Rows)}
    artefact.write_npz(path, **arrays, lamp_factor=factors.lamp_factor, lamps=np.array(factors.lamps, str), groups=np.array(factors.groups, str),
                       patch_group=factors.patch_group, group_area_m2=factors.group_area_m2, diagonal_m=factors.diagonal_m)


def read(path) -> Factors:
    """BadInput where an array is missing or holds a NaN."""
    from dataclasses import fields
    from lib import artefact
    from lib.stage import BadInput
    names = [f"mesh_{f.name}" for f in fields(Mesh)] + [f"rows_{f.name}" for f in fields(Rows)]
    a = artefact.read_npz(path, *names, "lamp_factor", "lamps", "groups", "patch_group", "group_area_m2", "diagonal_m")
    for name, array in a.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise BadInput(f"{path}: {name}: holds a value that is not finite")
    rows = {f.name: a[f"rows_{f.name}"] for f in fields(Rows)}
    rows["columns"] = int(rows["columns"])
    return Factors(Mesh(**{f.name: a[f"mesh_{f.name}"] for f in fields(Mesh)}), Rows(**rows), a["lamp_factor"],
                   tuple(map(str, a["lamps"])), a["patch_group"], tuple(map(str, a["groups"])), a["group_area_m2"], float(a["diagonal_m"]))


def warm_up():
    """Load or compile every kernel on a box with a lamp, a table and a mat, so that a stage's times are those of its work."""
    from types import SimpleNamespace
    from lib import mesh as meshes
    quads = [((0, 0, 0), (1, 0, 0), (0, 1, 0)), ((0, 0, 1), (0, 1, 0), (1, 0, 0)), ((0, 0, 0), (0, 1, 0), (0, 0, 1)),
             ((1, 0, 0), (0, 0, 1), (0, 1, 0)), ((.3, .3, .9), (0, .3, 0), (.3, 0, 0)), ((.3, .3, .5), (.3, 0, 0), (0, .3, 0)),
             ((.6, .6, 0), (.2, 0, 0), (0, .2, 0))]
    vertices, triangles, normal = [], [], []
    for k, (o, a, b) in enumerate(np.array(q, float) for q in quads):
        vertices += [o, o + a, o + a + b, o + b]
        triangles += [[4 * k, 4 * k + 1, 4 * k + 2], [4 * k, 4 * k + 2, 4 * k + 3]]
        n = np.cross(a, b)
        normal.append(n / np.linalg.norm(n))
    group = np.array([0, 0, 0, 0, 1, 0, 0], np.int32)
    model = SimpleNamespace(vertices=np.array(vertices), triangles=np.array(triangles), triangle_facet=np.repeat(np.arange(7), 2).astype(np.int32),
                            facet_normal=np.array(normal), facet_group=group, facet_object=np.zeros(7, np.int32), groups=("wall", "lamp"),
                            solid_objects=lambda: np.array([False]))
    surface = meshes.surface(model, ["lamp"])
    lamps = emitters(surface, ["lamp"])
    mesh = meshes.build(surface, patches=20, max_level=1, contrast=0.1, emitters=lamps)
    rays(surface, mesh, n_rays=16)
    patch_direct(surface, mesh, lamps, 1, n_points=4)
    gather(surface, mesh, mesh.centre, np.arange(len(mesh) + 1), mesh.side, np.full(len(mesh), 16))
