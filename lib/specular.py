"""Light by way of mirrors and glossy surfaces: extended form factors, mirrored lamps, what a mirror shows (sections 3.3 and 4.5).

A ray that meets a specular facet goes on: by Descartes' law at a mirror, into a sampled direction of the Ward lobe at a
glossy one. What it then finds reaches its start times rho_s of each group on the way, so light is a polynomial in the rho_s:

    F = F_0 + sum_k rho_s ** k F_k,     D = D_0 + sum_k rho_s ** k D_k        k: how often each specular group was met

and derivatives with respect to rho_s are exact (Sillion and Puech 1989 traced F by such rays; the sum over k is ours).
Lamps in plane mirrors are *mirrored lamps*: the exact factor of the mirrored polygon times the share of it that is seen
through the mirror, which has none of the noise of rays that find a small lamp by chance. Lamps in a lobe are found both by
rays to the lamp and by rays of the lobe, weighted by the balance heuristic (Veach and Guibas 1995).

Nothing here is imported where no group has climbed to a specular rung of the ladder.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit, prange

from lib import form_factors, ward
from lib.form_factors import CHUNK, Emitter
from lib.mesh import Mesh, Surface
from lib.rays import OFFSET

DEPTH = 32               # specular surfaces in a row that a ray of the light follows
LOBES = 4                # glossy ones among them
MIRRORED_LAMPS = 64      # facets of lamps in plane mirrors; beyond, lamps in mirrors are left to the rays
DIFFUSE, MIRROR, GLOSSY = 0, 1, 2


@dataclass(frozen=True)
class Finish:
    """How facets reflect beyond rho_d. M specular groups.

    groups : (M,) numbers of the groups;  kind : (M,) MIRROR or GLOSSY;  alpha : (M, 2);  tangent : (M, 3) of alpha_x, model's frame
    """
    groups: tuple
    kind: np.ndarray
    alpha: np.ndarray
    tangent: np.ndarray
    form: int = ward.BOUNDED

    def __len__(self):
        return len(self.groups)

    def only(self, which):
        """The finish of the specular groups numbered `which` alone."""
        return replace(self, groups=tuple(self.groups[m] for m in which), kind=self.kind[which], alpha=self.alpha[which], tangent=self.tangent[which])

    def facets(self, surface: Surface):
        """Per facet: number of its specular group, -1 (F,) int32, and the tangent frame in its plane (F, 2, 3)."""
        number = np.full(len(surface.groups), -1, np.int32)
        number[list(self.groups)] = np.arange(len(self.groups))
        of = number[surface.group]
        axes = np.array(surface.axes)
        for f in np.flatnonzero(of >= 0):
            if self.kind[of[f]] == GLOSSY:
                axes[f] = ward.frame(surface.normal[f], self.tangent[of[f]])
        return of, axes


class Chains:
    """The numbered ways by which light comes: how often it met each specular group. Number 0: not at all."""

    def __init__(self, n_groups):
        self.count = [(0,) * n_groups]
        self._number = {self.count[0]: 0}

    def __len__(self):
        return len(self.count)

    def then(self, chain, group):
        """Numbers (n,) of the chains `chain` (n,) with one more meeting of `group` (n,)."""
        M = len(self.count[0])
        pair = np.asarray(chain, np.int64) * M + group
        table = np.zeros(len(self) * M, np.int32)
        for both in np.flatnonzero(np.bincount(pair, minlength=len(table))):
            k, g = divmod(int(both), M)
            table[both] = self.number(tuple(c + (m == g) for m, c in enumerate(self.count[k])))
        return table[pair]

    def number(self, count):
        if count not in self._number:
            self._number[count] = len(self.count)
            self.count.append(count)
        return self._number[count]

    def joined(self, a, b):
        """Number of the chain that is a and then b."""
        return self.number(tuple(x + y for x, y in zip(self.count[a], self.count[b])))

    @property
    def counts(self):
        """(K, M) int."""
        return np.array(self.count, int).reshape(len(self.count), -1)

    def power(self, rho_s):
        """(K, C): the product of rho_s (M, C) along each chain."""
        return np.prod(rho_s[None] ** self.counts[:, :, None], axis=1)

    def total(self, rho_s, F, D, b, E):
        """What ways by chain, F (R, N) and D (R, L), bring of the light b (N, C) and E (L, C): (R, C), or 0 where there are none."""
        power = self.power(rho_s)
        return sum(power[k] * (A @ light) for parts, light in ((F, b), (D, E)) for k, A in parts.items())

    def slope(self, rho_s, m):
        """(K, C): derivative of `power` with respect to rho_s[m]."""
        n = self.counts
        lower = n.copy()
        lower[:, m] = np.maximum(lower[:, m] - 1, 0)
        return n[:, m, None] * np.prod(rho_s[None] ** lower[:, :, None], axis=1)


# -- rays that go on

@dataclass
class Met:
    """What rays have met after a specular surface.

    rays : (n, 6) float32, of this last piece of the way;  triangle, t : its end;  source : (n,) the ray that began the way
    chain : (n,) int32;  weight : (n,) without the rho_s;  lobe : (n,) density of the lobe that chose this direction, inf at mirrors
    glossy : (n,) int, glossy surfaces on the way
    """
    rays: np.ndarray
    triangle: np.ndarray
    t: np.ndarray
    source: np.ndarray
    chain: np.ndarray
    weight: np.ndarray
    lobe: np.ndarray
    glossy: np.ndarray

    def __len__(self):
        return len(self.source)


def first_met(rays, triangle, t) -> Met:
    """The ends of rays that have met nothing specular yet."""
    n = len(rays)
    return Met(rays, triangle, t, np.arange(n), np.zeros(n, np.int32), np.ones(n), np.full(n, np.inf), np.zeros(n, np.int32))


def follow(surface: Surface, finish: Finish, chains: Chains, start: Met, *, depth=DEPTH, seed=0, at_lobe=None, left=None):
    """Yields Met after each specular surface, until no ray goes on; rays that meet no specular facet end.

    left : list that receives the sources and weights of the rays that would still go on after `depth` surfaces
    at_lobe : called with (p, facet, sign, Met of those that are at a glossy surface, number of the specular group, tangent frames, step)
    """
    of, axes = finish.facets(surface)
    met = start
    for step in range(depth):
        f = np.where(met.triangle >= 0, surface.facet[met.triangle], 0)
        at = np.flatnonzero((met.triangle >= 0) & (of[f] >= 0))
        if len(at):
            f = f[at]
            glossy = np.asarray(finish.kind)[of[f]] == GLOSSY
            keep = (met.glossy[at] < LOBES) | ~glossy
            at, f, glossy = at[keep], f[keep], glossy[keep]
        if not len(at):
            return
        group = of[f]
        rays, weight, lobe, p, sign = _bounced(met.rays, met.t, at, f, group, glossy, surface.normal, surface.inside, axes, np.asarray(finish.alpha, float),
                                               finish.form, met.source[at], step, seed)
        if at_lobe is not None and glossy.any():
            g = np.flatnonzero(glossy & (sign != 0))
            here = Met(met.rays[at[g]], met.triangle[at[g]], met.t[at[g]], met.source[at[g]], chains.then(met.chain[at[g]], group[g]),
                       met.weight[at[g]], met.lobe[at[g]], met.glossy[at[g]])
            at_lobe(p[g], f[g], sign[g], here, group[g], axes, step)
        live = np.flatnonzero(weight > 0)
        if not len(live):
            return
        triangle, t = surface.caster.closest(rays[live])
        met = Met(rays[live], triangle, t, met.source[at[live]], chains.then(met.chain[at[live]], group[live]), met.weight[at[live]] * weight[live],
                  lobe[live], met.glossy[at[live]] + glossy[live])
        yield met
    if left is not None:
        on = (met.triangle >= 0) & (of[surface.facet[np.maximum(met.triangle, 0)]] >= 0)
        left.append((met.source[on], met.weight[on]))


@njit(cache=True, inline="always")
def _mixed(x):
    """A 64-bit number with its bits well mixed (splitmix64)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(cache=True, inline="always")
def _numbers(i, step, seed):
    """Two numbers in (0, 1) for the i-th ray: at its first specular surface the points of Roberts' sequence, which are spread
    evenly; further on independent of those, as they must be (the same points again would favour some ways over others)."""
    if step == 0:
        u = (0.5 + 0.7548776662466927 * i + 0.6180339887498949 * seed) % 1.0
        v = (0.5 + 0.5698402909980532 * i + 0.3247179572447461 * seed) % 1.0
    else:
        x = _mixed(np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(step * 7919 + 1) * np.uint64(0xD1B54A32D192ED03) + np.uint64(int(seed * 1000)))
        u = float(x >> np.uint64(32)) / 4294967296.0
        v = float(x & np.uint64(0xFFFFFFFF)) / 4294967296.0
    return min(max(u, 1e-9), 1 - 1e-9), v


@njit(cache=True, parallel=True)
def _bounced(rays, t, at, facet, group, glossy, normal, inside, axes, alpha, form, source, step, seed):
    """The next pieces of the ways: rays (m, 6), weight (m,) 0 where a way ends, density (m,), where they begin (m, 3), and the
    side (m,): 1 front, -1 back, 0 where the ray came out of a solid."""
    m = len(at)
    out = np.zeros((m, 6), np.float32)
    weight, lobe = np.zeros(m), np.full(m, np.inf)
    p = np.empty((m, 3))
    sign = np.zeros(m)
    for j in prange(m):
        i, f = at[j], facet[j]
        along = 0.0
        for d in range(3):
            along += rays[i, 3 + d] * normal[f, d]
        side = 1.0 if along < 0 else -1.0
        for d in range(3):
            p[j, d] = rays[i, d] + t[i] * rays[i, 3 + d]
        if inside[2 * f + (1 if along > 0 else 0)]:
            continue
        sign[j] = side
        cosine = max(-along * side, 1e-9)
        dx, dy, dz = 0.0, 0.0, 0.0
        if glossy[j]:
            ox, oy = 0.0, 0.0
            for d in range(3):
                ox -= rays[i, 3 + d] * axes[f, 0, d]
                oy -= rays[i, 3 + d] * axes[f, 1, d]
            ax, ay = alpha[group[j], 0], alpha[group[j], 1]
            u, v = _numbers(source[j], step, seed)
            ix, iy, iz = ward.sample(ax, ay, ox, oy, cosine, u, v)
            if iz <= 1e-6:
                continue
            weight[j] = ward.weight(form, ax, ay, ix, iy, iz, ox, oy, cosine)
            lobe[j] = ward.pdf(ax, ay, ix, iy, iz, ox, oy, cosine)
            for d in range(3):
                out[j, 3 + d] = ix * axes[f, 0, d] + iy * axes[f, 1, d] + iz * side * normal[f, d]
        else:
            weight[j] = 1.0
            for d in range(3):
                out[j, 3 + d] = rays[i, 3 + d] - 2 * along * normal[f, d]
        for d in range(3):
            out[j, d] = p[j, d] + OFFSET * side * normal[f, d]
    return out, weight, lobe, p, sign


# -- lamps in mirrors, lamps in lobes

def mirrored_lamps(surface: Surface, finish: Finish, chains: Chains, lamps, *, depth=4, limit=MIRRORED_LAMPS):
    """The lamps as plane mirrors show them: Emitters that know their mirrors, and their chains (n,).

    A lamp in a mirror in a mirror is there too, `depth` deep or as deep as makes no more than `limit`: they are complete for
    ways by so many mirrors (the third value); what comes by more is left to the rays.
    """
    of, _ = finish.facets(surface)
    mirrors = [f for f in np.flatnonzero(of >= 0) if finish.kind[of[f]] == MIRROR and not (surface.inside[2 * f] and surface.inside[2 * f + 1])]
    if not mirrors:
        return [], np.zeros(0, int), DEPTH
    box = {f: surface.corners[surface.facet == f].reshape(-1, 3) for f in mirrors}
    found, number = [], []
    last = [(lamp, 0) for lamp in lamps]
    for level in range(depth):
        fresh = []
        for lamp, chain in last:
            for f in mirrors:
                n, o = surface.normal[f], surface.origin[f]
                before = lamp.mirrors[0] if lamp.mirrors else -1
                if f == before:
                    continue
                height = (lamp.corners - o) @ n
                seen = box[before] if before >= 0 else lamp.corners.reshape(-1, 3)
                over = (seen - o) @ n                       # of what lights the mirror: on which sides of it
                for sign in (1, -1):
                    if surface.inside[2 * f + (sign < 0)] or (sign * over).max() <= 4 * OFFSET or (sign * height).max() <= 4 * OFFSET:
                        continue
                    # the mirror must lie before the front of the (mirrored) lamp
                    if not ((box[f][:, None] - lamp.corners[None, :, 0]) * lamp.normal[None]).sum(axis=-1).max() > 1e-9:
                        continue
                    corners = lamp.corners - 2 * height[..., None] * n
                    front = lamp.normal - 2 * (lamp.normal @ n)[:, None] * n
                    fresh.append((Emitter(lamp.lamp, corners, front, lamp.cdf, mirrors=(f, *lamp.mirrors)),
                                  int(chains.then(np.array([chain]), np.array([of[f]]))[0])))
                    break                                    # the other side of a plane shows the same image: the rays know which
        if len(found) + len(fresh) > limit:
            return found, np.array(number, int), level
        found += [lamp for lamp, _ in fresh]
        number += [chain for _, chain in fresh]
        last = fresh
    return found, np.array(number, int), depth


def lamp_areas(lamps):
    """(n,) local areas of the emitters."""
    return np.array([0.5 * np.linalg.norm(np.cross(e.corners[:, 1] - e.corners[:, 0], e.corners[:, 2] - e.corners[:, 0]), axis=1).sum() for e in lamps])


def lobe_light(surface: Surface, finish: Finish, lamps, p, facet, sign, met: Met, group, axes, step, *, seed=0):
    """What the lamps send straight into lobes, by one ray to each emitter: (n, lamps) of the balance heuristic's share, without rho_s."""
    light = np.zeros((len(p), len(lamps)))
    for k, lamp in enumerate(lamps):
        rays, value = _to_lamp(p, facet, sign, met.rays, met.source, group, surface.normal, axes, np.asarray(finish.alpha, float), finish.form, lamp.corners,
                               lamp.normal, lamp.cdf, lamp_areas([lamp])[0], step, seed + k + 0.37)
        lit = np.flatnonzero(value > 0)
        if surface.n_occluders:
            value[lit[surface.shadows.occluded(rays[lit], 1 - 1e-4)]] = 0
        light[:, k] = value * met.weight
    return light


@njit(cache=True, parallel=True)
def _to_lamp(p, facet, sign, view, source, group, normal, axes, alpha, form, corners, front, cdf, area, step, seed):
    n = len(p)
    rays = np.zeros((n, 6), np.float32)
    value = np.zeros(n)
    for j in prange(n):
        f = facet[j]
        u, v = _numbers(source[j], step, seed)
        k = 0
        while k < len(cdf) - 1 and cdf[k] <= u:
            k += 1
        low = cdf[k - 1] if k > 0 else 0.0
        r = np.sqrt(min(max((u - low) / (cdf[k] - low), 0.0), 1.0))
        squared, ix, iy, iz, there, ox, oy, oz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for d in range(3):
            target = (1 - r) * corners[k, 0, d] + r * (1 - v) * corners[k, 1, d] + r * v * corners[k, 2, d]
            begin = p[j, d] + OFFSET * sign[j] * normal[f, d]
            x = target + OFFSET * front[k, d] - begin
            rays[j, d] = begin
            rays[j, 3 + d] = x
            squared += x * x
            ix += x * axes[f, 0, d]
            iy += x * axes[f, 1, d]
            iz += x * sign[j] * normal[f, d]
            there -= x * front[k, d]
            ox -= view[j, 3 + d] * axes[f, 0, d]
            oy -= view[j, 3 + d] * axes[f, 1, d]
            oz -= view[j, 3 + d] * sign[j] * normal[f, d]
        if iz <= 0 or there <= 0 or oz <= 0:
            continue
        length = np.sqrt(squared)
        ix, iy, iz, there = ix / length, iy / length, iz / length, there / length
        ax, ay = alpha[group[j], 0], alpha[group[j], 1]
        density = squared / (there * area)
        value[j] = ward.value(form, ax, ay, ix, iy, iz, ox, oy, oz) * iz / (density + ward.pdf(ax, ay, ix, iy, iz, ox, oy, oz))
    return rays, value


def lamp_found(surface: Surface, lamps, met: Met, chains: Chains, complete):
    """Which emitter the ends of rays lie on (n,), -1: none, and the share (n,) that the balance heuristic gives them.
    Rays that reached a lamp by no more than `complete` mirrors alone are not counted: mirrored lamps are."""
    if not lamps:
        return np.full(len(met), -1), np.zeros(len(met))
    of = np.full(len(surface.normal), -1, np.int32)
    for k, lamp in enumerate(lamps):
        of[list(lamp.facets)] = k
    f = np.where(met.triangle >= 0, surface.facet[met.triangle], 0)
    counted = (met.glossy > 0) | (chains.counts.sum(axis=1)[met.chain] > complete)
    which = np.where((met.triangle >= 0) & counted, of[f], -1)
    along = -np.einsum("ij,ij->i", met.rays[:, 3:], surface.normal[f])
    which[along <= 0] = -1                                        # the back of a lamp is dark
    density = np.where(which >= 0, met.t.astype(float), 0) ** 2 / np.maximum(along * lamp_areas(lamps)[which], 1e-300)
    share = 1 / (1 + np.where(np.isfinite(met.lobe), density / np.maximum(met.lobe, 1e-300), 0))
    return which, np.where(which >= 0, share, 0) * met.weight


# -- extended rows of form factors

@dataclass
class Rows:
    """Light by specular ways: for each chain k >= 1 a matrix F_k (R, N) and lamp factors D_k (R, L), R elements.

    F_spread, D_spread : half the difference of the same from the first and the last rays, as large as their sampling error; where asked for
    """
    F: dict = field(default_factory=dict)        # chain -> csr float32
    D: dict = field(default_factory=dict)        # chain -> (R, L)
    F_spread: dict = field(default_factory=dict)
    D_spread: dict = field(default_factory=dict)
    rays: int = 0
    lost: float = 0.0                            # share of the elements' light that was still on its way when the count ran out


def rows(surface: Surface, mesh: Mesh, finish: Finish, chains: Chains, lamps, n_lamps, ray_start, begin, *, seed=0, complete=DEPTH, detail=None, spread=False, progress=None) -> Rows:
    """The specular part of the rows of elements.

    ray_start : (R + 1,) rays of each element;  begin(first, last) -> Met of the rays of the elements first..last-1, and which of them count
    lamps : not mirrored ones;  complete : by how many mirrors lamps are mirrored (rays find those that are further)
    detail : (rays, triangle, t, patch) -> what the light there is of its patch's, (n,); None: patches are of one light
    spread : two sets of rays apart, for F_spread and D_spread
    """
    from scipy.sparse import csr_array
    R, N = len(ray_start) - 1, len(mesh)
    factors, light, result = {}, {}, Rows()
    first = 0
    while first < R:
        last = max(first + 1, int(np.searchsorted(ray_start, ray_start[first] + CHUNK, "right")) - 1)
        start, counts = begin(first, last)
        element = np.repeat(np.arange(first, last), np.diff(ray_start[first:last + 1]))
        share = 1 / np.maximum(np.bincount(element - first, counts, last - first), 1)[element - first]
        row = element
        if spread:                                                 # its first rays and its last: each half of a Sobol' sequence is spread as evenly as the whole
            row = element + R * (np.arange(ray_start[first], ray_start[last]) >= ((ray_start[:-1] + ray_start[1:]) // 2)[element])
        start = replace(start, triangle=np.where(counts, start.triangle, -1))
        result.rays += len(start)

        def keep(store, chain, row, column, value):
            for k in np.flatnonzero(np.bincount(chain)):
                mine = np.flatnonzero(chain == k)
                store.setdefault(int(k), []).append((row[mine], column[mine], value[mine]))

        def at_lobe(p, facet, sign, met, group, axes, step):
            each = lobe_light(surface, finish, lamps, p, facet, sign, met, group, axes, step, seed=seed) * share[met.source][:, None]
            for j, lamp in enumerate(lamps):
                keep(light, met.chain, row[met.source], np.full(len(met), lamp.lamp), each[:, j])

        left = []
        for met in follow(surface, finish, chains, start, seed=seed, at_lobe=at_lobe, left=left):
            value = met.weight * share[met.source]
            hit = _located(surface, mesh, met.rays, met.triangle, met.t)
            good = np.flatnonzero(hit >= 0)
            finer = 1 if detail is None else detail(met.rays[good], met.triangle[good], met.t[good], hit[good])
            keep(factors, met.chain[good], row[met.source[good]], hit[good], value[good] * finer)
            which, weight = lamp_found(surface, lamps, met, chains, complete)
            on = np.flatnonzero(which >= 0)
            keep(light, met.chain[on], row[met.source[on]], np.array([lamps[k].lamp for k in which[on]], int), weight[on] * share[met.source[on]])
        result.lost += sum(float((weight * share[source]).sum()) for source, weight in left) / R
        if progress is not None:
            progress(last / R)
        first = last
    for store, target, apart, columns in ((factors, result.F, result.F_spread, N), (light, result.D, result.D_spread, n_lamps)):
        for k, pieces in store.items():
            row, column, value = (np.concatenate(x) for x in zip(*pieces))
            matrix = csr_array((value.astype(np.float32), (row, column)), shape=((1 + spread) * R, columns))
            matrix.sum_duplicates()
            if target is result.D:
                matrix = matrix.toarray().astype(float)
            if spread:                                             # shares are those of all rays: each set gives half
                matrix, apart[k] = matrix[:R] + matrix[R:], matrix[:R] - matrix[R:]
            target[k] = matrix
    return result


def from_rays(surface: Surface, mesh: Mesh, make):
    """`begin` for `rows`: make(first, last) -> rays (n, 6) that leave diffuse elements; those that begin inside a solid do not count."""
    def begin(first, last):
        rays = make(first, last)
        triangle, t = surface.caster.closest(rays)
        return first_met(rays, triangle, t), _located(surface, mesh, rays, triangle, t) != form_factors.DROPPED
    return begin


def from_views(surface: Surface, ray_start, start, p, facet, direction, chain):
    """`begin` for `rows`: the elements' own points (M, 3) on glossy facets (M,), seen along unit directions (M, 3) by way of chains (M,);
    start : (R + 1,) the points of each element, among which its rays go round."""
    triangle_of = np.zeros(len(surface.normal), np.int32)
    triangle_of[surface.facet] = np.arange(len(surface.facet))
    back = 1e-3

    def begin(first, last):
        n = np.diff(ray_start[first:last + 1])
        size = np.diff(start[first:last + 1])
        k = np.arange(int(n.sum())) - np.repeat(np.cumsum(n) - n, n)
        at = np.repeat(start[first:last], n) + k % np.repeat(size, n)
        rays = np.hstack([p[at] - back * direction[at], direction[at]]).astype(np.float32)
        many = len(at)
        source = np.arange(many)
        return Met(rays, triangle_of[facet[at]], np.full(many, back, np.float32), source, chain[at].astype(np.int32), np.ones(many), np.full(many, np.inf),
                   np.zeros(many, np.int32)), np.ones(many, bool)
    return begin


def _located(surface, mesh, rays, triangle, t):
    hit = form_factors._locate(rays, triangle, t, surface.facet, surface.normal, surface.origin, surface.axes, surface.size, surface.inside,
                               mesh.table_start, mesh.table_shape, mesh.leaf)
    hit[form_factors.buried(surface, rays, triangle)] = form_factors.DROPPED
    return hit


@dataclass(frozen=True)
class Transport:
    """The specular ways of a scene's light. F, D : to the patches, by chain, as Rows;  mirrored : Emitters, with their chains `way` (n,)
    D_mirrored : (N, n) factors of the patches to them, already part of D;  complete : see mirrored_lamps;  lost : see Rows"""
    F: dict
    D: dict
    mirrored: list
    way: np.ndarray
    D_mirrored: np.ndarray
    complete: int
    rays: int
    lost: float


def transport(surface: Surface, mesh: Mesh, finish: Finish, chains: Chains, lamps, n_lamps, *, n_rays=512) -> Transport:
    """From the lamps and the patches to the patches by way of mirrors and glossy surfaces."""
    mirrored, way, complete = mirrored_lamps(surface, finish, chains, lamps)
    ray_start, make = form_factors.from_patches(surface, mesh, n_rays)
    result = rows(surface, mesh, finish, chains, lamps, n_lamps, ray_start, from_rays(surface, mesh, make), seed=3, complete=complete)
    one = [replace(lamp, lamp=k) for k, lamp in enumerate(mirrored)]
    factor = form_factors.patch_direct(surface, mesh, one, len(one), n_points=32) if one else np.zeros((len(mesh), 0))
    add_lamps(result.D, mirrored, way, factor, n_lamps)
    return Transport(result.F, result.D, mirrored, way, factor, complete, result.rays, result.lost)


def add_lamps(D, mirrored, way, factor, n_lamps):
    """Add the factors (R, n) of mirrored lamps to D, chain -> (R, L)."""
    for k, lamp in enumerate(mirrored):
        D.setdefault(int(way[k]), np.zeros((len(factor), n_lamps)))[:, lamp.lamp] += factor[:, k]


@dataclass(frozen=True)
class Ways:
    """What rays need to go on in a picture. rho_s : (M, C);  lamps : plain ones;  E : (L, C);  every, E_every : mirrored ones, too
    complete : see Transport"""
    finish: Finish
    chains: Chains
    rho_s: np.ndarray
    lamps: list
    E: np.ndarray
    every: list
    E_every: np.ndarray
    complete: int


# -- what a mirror shows: the virtual index buffer (section 4.5)

@dataclass(frozen=True)
class View:
    """What rays of the camera show after all mirrors.

    facet : (n,) int32, -1 nothing, or still in mirrors when the count ran out;  side : (n,);  p : (n, 3) local;  chain : (n,) int32
    direction : (n, 3) unit, of the last piece of the way
    """
    facet: np.ndarray
    side: np.ndarray
    p: np.ndarray
    chain: np.ndarray
    direction: np.ndarray


def through_mirrors(surface: Surface, finish: Finish, chains: Chains, rays, *, depth=64) -> View:
    """The first facet that is no mirror on the way of each ray (n, 6)."""
    plain = Finish(tuple(g for g, k in zip(finish.groups, finish.kind) if k == MIRROR), np.full(int((np.asarray(finish.kind) == MIRROR).sum()), MIRROR),
                   np.zeros((len(finish), 2)), np.zeros((len(finish), 3)))
    numbers = [m for m, k in enumerate(finish.kind) if k == MIRROR]        # of the mirrors among the specular groups
    own = Chains(len(plain))
    of, _ = plain.facets(surface)
    n = len(rays)
    triangle, t = surface.caster.closest(rays)
    out = View(np.full(n, -1, np.int32), np.zeros(n, np.int32), np.zeros((n, 3)), np.zeros(n, np.int32), np.array(rays[:, 3:], float))

    def note(met):
        f = np.where(met.triangle >= 0, surface.facet[met.triangle], 0)
        ends = (met.triangle >= 0) & (of[f] < 0)
        i = met.source
        out.facet[i] = np.where(ends, f, -1)
        along = np.einsum("ij,ij->i", met.rays[:, 3:].astype(float), surface.normal[f])
        out.side[i] = 2 * f + (along > 0)
        out.p[i] = met.rays[:, :3] + met.t[:, None].astype(float) * met.rays[:, 3:] if len(met) else out.p[i]
        out.p[i[~np.isfinite(out.p[i]).all(axis=1)]] = 0
        out.chain[i] = met.chain
        out.direction[i] = met.rays[:, 3:]

    with np.errstate(invalid="ignore"):
        start = first_met(rays, triangle, t)
        note(start)
        for met in follow(surface, plain, own, start, depth=depth):
            note(met)
    # the ways of this view, in the numbers of all specular groups
    table = np.array([chains.number(tuple(own.count[k][numbers.index(m)] if m in numbers else 0 for m in range(len(finish)))) for k in range(len(own))], np.int32)
    return replace(out, chain=table[out.chain])


def warm_up():
    """Load or compile every kernel on a box with a lamp, a mirror and a glossy wall, so that a stage's times are those of its work."""
    from lib import mesh as meshes
    surface = boxed()
    lamps = form_factors.emitters(surface, ["lamp"])
    mesh = meshes.build(surface, patches=20, max_level=0, contrast=1.0, emitters=lamps)
    finish = Finish((1, 2), np.array([MIRROR, GLOSSY]), np.array([[0, 0], [0.2, 0.1]]), np.array([[0, 0, 0], [0, 0, 1.0]]))
    chains = Chains(2)
    transport(surface, mesh, finish, chains, lamps, 1, n_rays=16)
    rays = np.array([[0, 0, 0, 0, 0, -1], [0, 0, 0, -0.6, 0, -0.8]], np.float32)
    through_mirrors(surface, finish, chains, rays)
    begin = from_views(surface, np.array([0, 8]), np.array([0, 1]), surface.origin[2:3] + 0.1 * surface.axes[2].sum(axis=0), np.array([2], np.int32),
                       -surface.normal[2:3], np.zeros(1, np.int32))
    rows(surface, mesh, finish, chains, lamps, 1, np.array([0, 8]), begin)


def boxed():
    """A room of 1 m with a ceiling that is a mirror (group 1), a glossy wall (2) and a lamp: for warm_up."""
    from types import SimpleNamespace
    from lib import mesh as meshes
    quads = np.array([((0, 0, 0), (1, 0, 0), (0, 1, 0)), ((0, 0, 1), (0, 1, 0), (1, 0, 0)), ((0, 0, 0), (0, 1, 0), (0, 0, 1)),
                      ((1, 0, 0), (0, 0, 1), (0, 1, 0)), ((.3, .3, .9), (0, .3, 0), (.3, 0, 0)), ((.3, .3, .5), (.3, 0, 0), (0, .3, 0))], float)
    o, a, b = quads[:, 0], quads[:, 1], quads[:, 2]
    normal = np.cross(a, b) / np.linalg.norm(np.cross(a, b), axis=1)[:, None]
    model = SimpleNamespace(vertices=np.stack([o, o + a, o + a + b, o + b], axis=1).reshape(-1, 3),
                            triangles=(4 * np.arange(6)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
                            triangle_facet=np.repeat(np.arange(6), 2).astype(np.int32), facet_normal=normal, facet_group=np.array([0, 1, 2, 0, 3, 0], np.int32),
                            facet_object=np.zeros(6, np.int32), groups=("wall", "mirror", "gloss", "lamp"), solid_objects=lambda: np.array([False]))
    return meshes.surface(model, ["lamp"])
