"""Light by way of mirrors and glossy surfaces: extended form factors, mirrored lamps (§3.3, §4.5).

A ray that meets a specular facet goes on: by Descartes' law at a mirror, into a sampled direction of the Ward lobe at a
glossy one. What it then finds reaches its start times rho_s of each group on the way. So light is a polynomial in the
rho_s, with k how often each specular group was met,

    F = F_0 + sum_k rho_s ** k F_k,     D = D_0 + sum_k rho_s ** k D_k

and derivatives with respect to rho_s are exact. Sillion and Puech 1989 traced F by such rays; the sum over k is ours.
Lamps in mirrors and in lobes are found apart: see specular_lamps.py.

Nothing here is imported where no group has climbed to a specular rung of the ladder.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from lib.given.rays import shifts, sobol
from lib.light import form_factors, glints
from lib.light import lamps as lamps_
from lib.light.cells import Mesh
from lib.light.cells_kernels import patch_points
from lib.light.chains import Chains, Finish
from lib.light.form_factors import chunks, located
from lib.light.form_factors_kernels import DROPPED, ESCAPED
from lib.light.paths import DEPTH, Met, first_met, follow
from lib.light.specular_lamps import add_lamps, lamp_found, lobe_light, mirrored_lamps
from lib.light.surface import Surface, side_normals

POINTS = 32  # of each patch, by which lamps are sought

# ---- extended rows of form factors ----


@dataclass
class ChainRows:
    """Light by specular ways: for each chain k >= 1 a matrix F_k (R, N) and lamp factors D_k (R, L), R elements.

    F_spread, D_spread : where asked for, half the difference of the same from the first and the last rays, which is as
    large as their sampling error
    """

    F: dict = field(default_factory=dict)  # chain -> csr float32
    D: dict = field(default_factory=dict)  # chain -> (R, L)
    F_spread: dict = field(default_factory=dict)
    D_spread: dict = field(default_factory=dict)
    rays: int = 0
    lost: float = 0.0  # share of the elements' light that was still on its way when the count ran out


class _Entries:
    """Entries of matrices, one matrix for each chain, as rays find them."""

    def __init__(self):
        self.by_chain = {}

    def add(self, chain, row, column, value):
        """All (n,)."""
        for k in np.flatnonzero(np.bincount(chain)):
            mine = np.flatnonzero(chain == k)
            self.by_chain.setdefault(int(k), []).append((row[mine], column[mine], value[mine]))

    def matrices(self, shape):
        """Yields (chain, csr float32 of this shape), entries of one place summed."""
        from scipy.sparse import csr_array

        for k, pieces in self.by_chain.items():
            row, column, value = (np.concatenate(x) for x in zip(*pieces, strict=True))
            matrix = csr_array((value.astype(np.float32), (row, column)), shape=shape)
            matrix.sum_duplicates()
            yield k, matrix


class Places(NamedTuple):
    """Where the elements lie that rays come from. start : (R + 1,) into p (M, 3) local;  normal : (R, 3)"""

    start: np.ndarray
    p: np.ndarray
    normal: np.ndarray


class _Tally:
    """What the rays of some elements bring, written into entries of F and D.

    row : (n,) of each ray;  share : (n,) its part of its element's light
    """

    def __init__(self, lamps, outside, factors: _Entries, light: _Entries, row, share):
        self.lamp, self.outside = np.array([lamp.lamp for lamp in lamps], int), outside
        self.factors, self.light, self.row, self.share = factors, light, row, share

    def from_lobes(self, met: Met, each):
        """each : (n, lamps) of lobe_light"""
        each = each * self.share[met.source][:, None]
        for j, lamp in enumerate(self.lamp):
            self.light.add(met.chain, self.row[met.source], np.full(len(met), lamp), each[:, j])

    def from_patches(self, met: Met, patch, finer):
        """patch : (n,), below 0 where there is none;  finer : rays -> what the light there is of its patch's"""
        good = np.flatnonzero(patch >= 0)
        value = (met.weight * self.share[met.source])[good] * finer(good)
        self.factors.add(met.chain[good], self.row[met.source[good]], patch[good], value)

    def from_outside(self, met: Met, patch):
        """patch : (n,) ESCAPED of rays that leave the model"""
        if self.outside is None:
            return
        gone = np.flatnonzero(patch == ESCAPED)
        value = met.weight[gone] * self.share[met.source[gone]]
        for k, seen in enumerate(self.outside.seen(met.rays[gone]).T, self.outside.first):
            self.light.add(met.chain[gone], self.row[met.source[gone]], np.full(len(gone), k), value * seen)

    def from_glints(self, row, k, chain, value):
        """row, value : (n,) by way of the chain from emitter k"""
        self.light.add(np.full(len(row), chain), row, np.full(len(row), self.lamp[k]), value)

    def from_lamps(self, met: Met, which, weight):
        """which, weight : (n,) of lamp_found"""
        on = np.flatnonzero(which >= 0)
        value = weight[on] * self.share[met.source[on]]
        self.light.add(met.chain[on], self.row[met.source[on]], self.lamp[which[on]], value)


def rows(
    surface: Surface,
    mesh: Mesh,
    finish: Finish,
    chains: Chains,
    lamps,
    n_lamps,
    ray_start,
    begin,
    *,
    outside=None,
    seed=0,
    complete=DEPTH,
    detail=None,
    spread=False,
    places=None,
) -> ChainRows:
    """The specular part of the rows of elements.

    lamps : not mirrored ones;  outside : of FormFactors
    ray_start : (R + 1,) rays of each element
    begin : (first, last) -> Met of the rays of the elements first..last-1, and (n,) bool, which of them count
    complete : by how many mirrors lamps are mirrored; rays find those that are further
    detail : (rays, triangle, t, patch) -> (n,) what the light there is of its patch's; None: patches are of one light
    spread : two sets of rays apart, for F_spread and D_spread
    places : Places of the elements, where lamps in glossy planes are sought from the lamps as well
    """
    R = len(ray_start) - 1
    factors, light, result = _Entries(), _Entries(), ChainRows()
    for first, last in chunks(ray_start):
        start, counts = begin(first, last)
        element = np.repeat(np.arange(first, last), np.diff(ray_start[first : last + 1]))
        each = 1 / np.maximum(np.bincount(element - first, counts, last - first), 1)
        share, row = each[element - first], element
        if spread:  # its first rays and its last: each half of a Sobol' sequence is spread as evenly as the whole
            middle = (ray_start[:-1] + ray_start[1:]) // 2
            row = element + R * (np.arange(ray_start[first], ray_start[last]) >= middle[element])
        start = replace(start, triangle=np.where(counts, start.triangle, -1))
        result.rays += len(start)
        tally = _Tally(lamps, outside, factors, light, row, share)
        shot = np.diff(ray_start[first : last + 1])
        of = None if places is None else glints.glints(surface, finish, places.normal[first:last], shot)
        left = _follow(surface, mesh, finish, chains, lamps, start, tally, seed, complete, detail, of)
        if of is not None:
            some = places.start[first:last], places.start[first + 1 : last + 1], places.p
            blocks = np.arange(first, last)
            for at, k, chain, value in glints.light(
                surface, finish, chains, lamps, of, some, places.normal[first:last], shot, blocks, seed + 17
            ):
                here = at // 2
                tally.from_glints(first + here + R * spread * (at % 2), k, chain, value * each[here])
        result.lost += sum(float((weight * share[source]).sum()) for source, weight in left) / R
    shares = (1 + spread) * R
    for k, matrix in factors.matrices((shares, len(mesh))):
        result.F[k] = _joined(matrix, R, spread, result.F_spread, k)
    for k, matrix in light.matrices((shares, n_lamps)):
        result.D[k] = _joined(matrix.toarray().astype(float), R, spread, result.D_spread, k)
    return result


def _follow(surface, mesh, finish, chains, lamps, start, tally, seed, complete, detail, sought):
    """Follow rays to their ends and count what they find; returns those that would still go on, see `follow`."""

    arrays = None if sought is None else sought.arrays
    also = None if sought is None else (arrays, finish, start)

    def at_lobe(at):
        tally.from_lobes(at.met, lobe_light(surface, lamps, at, seed=seed, glints=arrays))

    left = []
    for met in follow(surface, finish, chains, start, seed=seed, at_lobe=at_lobe, left=left):
        patch = located(surface, mesh, met.rays, met.triangle, met.t)

        def finer(good, met=met, patch=patch):
            return 1 if detail is None else detail(met.rays[good], met.triangle[good], met.t[good], patch[good])

        tally.from_patches(met, patch, finer)
        tally.from_outside(met, patch)
        tally.from_lamps(met, *lamp_found(surface, lamps, met, chains, complete, sought=also))
    return left


def _joined(matrix, R, spread, apart, k):
    """The sum of the two sets of rays, whose difference goes into apart[k]: shares are those of all rays."""
    if not spread:
        return matrix
    apart[k] = matrix[:R] - matrix[R:]
    return matrix[:R] + matrix[R:]


def from_rays(surface: Surface, mesh: Mesh, make):
    """`begin` for `rows`, of rays that leave diffuse elements; those that begin inside a solid do not count.

    make : (first, last) -> (n, 6)
    """

    def begin(first, last):
        rays = make(first, last)
        triangle, t = surface.caster.closest(rays)
        return first_met(rays, triangle, t), located(surface, mesh, rays, triangle, t) != DROPPED

    return begin


def from_views(surface: Surface, ray_start, start, p, facet, direction, chain):
    """`begin` for `rows`, of elements that are glossy themselves: rays of the view that end on their own points.

    p : (M, 3) local, on the facets (M,);  direction : (M, 3) unit, along which they are seen, by way of chains (M,)
    start : (R + 1,) the points of each element, among which its rays go round
    """
    triangle_of = np.zeros(len(surface.normal), np.int32)
    triangle_of[surface.facet] = np.arange(len(surface.facet))
    back = 1e-3

    def begin(first, last):
        n = np.diff(ray_start[first : last + 1])
        size = np.diff(start[first : last + 1])
        k = np.arange(int(n.sum())) - np.repeat(np.cumsum(n) - n, n)
        at = np.repeat(start[first:last], n) + k % np.repeat(size, n)
        rays = np.hstack([p[at] - back * direction[at], direction[at]]).astype(np.float32)
        met = first_met(rays, triangle_of[facet[at]], np.full(len(at), back, np.float32))
        met.chain = chain[at].astype(np.int32)
        return met, np.ones(len(at), bool)

    return begin


@dataclass(frozen=True)
class Transport:
    """The ways of a scene's light past mirrors and glossy surfaces of one finish, to its patches.

    F, D : by chain, see ChainRows;  mirrored : Emitters, lamps in plane mirrors, with their chains `way` (n,)
    D_mirrored : (N, n) factors of the patches to them, already part of D;  complete : see MirroredLamps
    rays : that were traced;  lost : see ChainRows
    """

    finish: Finish
    chains: Chains
    F: dict
    D: dict
    mirrored: list
    way: np.ndarray
    D_mirrored: np.ndarray
    complete: int
    rays: int
    lost: float


def transport(
    surface: Surface, mesh: Mesh, finish: Finish, chains: Chains, lamps, n_lamps, *, outside=None, n_rays=512
) -> Transport:
    """From the lamps and the patches to the patches by way of mirrors and glossy surfaces.

    n_lamps : groups that emit;  outside : see `rows`;  n_rays : of each patch
    """
    mirrored, way, complete = mirrored_lamps(surface, finish, chains, lamps)
    ray_start, make = form_factors.from_patches(surface, mesh, n_rays)
    begin = from_rays(surface, mesh, make)
    shift = shifts(len(mesh), POINTS, 3000)
    p = patch_points(POINTS, sobol(POINTS), shift, mesh.pieces, surface.arrays)
    places = Places(np.arange(len(mesh) + 1) * POINTS, p, side_normals(surface)[mesh.side])
    result = rows(
        surface,
        mesh,
        finish,
        chains,
        lamps,
        n_lamps,
        ray_start,
        begin,
        outside=outside,
        seed=3,
        complete=complete,
        places=places,
    )
    one = [replace(lamp, lamp=k) for k, lamp in enumerate(mirrored)]
    factor = lamps_.patch_direct(surface, mesh, one, len(one), n_points=32) if one else np.zeros((len(mesh), 0))
    add_lamps(result.D, mirrored, way, factor, n_lamps)
    return Transport(finish, chains, result.F, result.D, mirrored, way, factor, complete, result.rays, result.lost)


@dataclass(frozen=True)
class SpecularLight:
    """What rays need to go on in a picture.

    rho_s : (M, C);  lamps : plain ones;  E : (L, C);  every, E_every : mirrored ones, too;  complete : see Transport
    """

    finish: Finish
    chains: Chains
    rho_s: np.ndarray
    lamps: list
    E: np.ndarray
    every: list
    E_every: np.ndarray
    complete: int
