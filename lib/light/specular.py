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

from lib.light import adapt, form_factors, mirror_view
from lib.light import form_factors_kernels as kernels
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.cells import Mesh
from lib.light.chains import GLOSSY, MIRROR, Chains, Finish
from lib.light.form_factors import CHUNK
from lib.light.paths import DEPTH, Met, first_met, follow
from lib.light.small_room import small_room
from lib.light.specular_lamps import add_lamps, lamp_found, lobe_light, mirrored_lamps
from lib.light.surface import Surface

# -- extended rows of form factors


@dataclass
class ChainRows:
    """Light by specular ways: for each chain k >= 1 a matrix F_k (R, N) and lamp factors D_k (R, L), R elements.

    F_spread, D_spread : half the difference of the same from the first and the last rays, as large as their sampling error; where asked for
    """

    F: dict = field(default_factory=dict)  # chain -> csr float32
    D: dict = field(default_factory=dict)  # chain -> (R, L)
    F_spread: dict = field(default_factory=dict)
    D_spread: dict = field(default_factory=dict)
    rays: int = 0
    lost: float = 0.0  # share of the elements' light that was still on its way when the count ran out


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
    seed=0,
    complete=DEPTH,
    detail=None,
    spread=False,
    progress=None,
) -> ChainRows:
    """The specular part of the rows of elements.

    ray_start : (R + 1,) rays of each element;  begin(first, last) -> Met of the rays of the elements first..last-1, and which of them count
    lamps : not mirrored ones;  complete : by how many mirrors lamps are mirrored (rays find those that are further)
    detail : (rays, triangle, t, patch) -> what the light there is of its patch's, (n,); None: patches are of one light
    spread : two sets of rays apart, for F_spread and D_spread
    """
    from scipy.sparse import csr_array

    R, N = len(ray_start) - 1, len(mesh)
    factors, light, result = {}, {}, ChainRows()
    first = 0
    while first < R:
        last = max(first + 1, int(np.searchsorted(ray_start, ray_start[first] + CHUNK, "right")) - 1)
        start, counts = begin(first, last)
        element = np.repeat(np.arange(first, last), np.diff(ray_start[first : last + 1]))
        share = 1 / np.maximum(np.bincount(element - first, counts, last - first), 1)[element - first]
        row = element
        if spread:  # its first rays and its last: each half of a Sobol' sequence is spread as evenly as the whole
            row = element + R * (
                np.arange(ray_start[first], ray_start[last]) >= ((ray_start[:-1] + ray_start[1:]) // 2)[element]
            )
        start = replace(start, triangle=np.where(counts, start.triangle, -1))
        result.rays += len(start)

        def keep(store, chain, row, column, value):
            for k in np.flatnonzero(np.bincount(chain)):
                mine = np.flatnonzero(chain == k)
                store.setdefault(int(k), []).append((row[mine], column[mine], value[mine]))

        def at_lobe(p, facet, sign, met, group, axes, step):
            each = (
                lobe_light(surface, finish, lamps, p, facet, sign, met, group, axes, step, seed=seed)
                * share[met.source][:, None]
            )
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
            keep(
                light,
                met.chain[on],
                row[met.source[on]],
                np.array([lamps[k].lamp for k in which[on]], int),
                weight[on] * share[met.source[on]],
            )
        result.lost += sum(float((weight * share[source]).sum()) for source, weight in left) / R
        if progress is not None:
            progress(last / R)
        first = last
    for store, target, apart, columns in (
        (factors, result.F, result.F_spread, N),
        (light, result.D, result.D_spread, n_lamps),
    ):
        for k, pieces in store.items():
            row, column, value = (np.concatenate(x) for x in zip(*pieces))
            matrix = csr_array((value.astype(np.float32), (row, column)), shape=((1 + spread) * R, columns))
            matrix.sum_duplicates()
            if target is result.D:
                matrix = matrix.toarray().astype(float)
            if spread:  # shares are those of all rays: each set gives half
                matrix, apart[k] = matrix[:R] + matrix[R:], matrix[:R] - matrix[R:]
            target[k] = matrix
    return result


def from_rays(surface: Surface, mesh: Mesh, make):
    """`begin` for `rows`: make(first, last) -> rays (n, 6) that leave diffuse elements; those that begin inside a solid do not count."""

    def begin(first, last):
        rays = make(first, last)
        triangle, t = surface.caster.closest(rays)
        return first_met(rays, triangle, t), _located(surface, mesh, rays, triangle, t) != kernels.DROPPED

    return begin


def from_views(surface: Surface, ray_start, start, p, facet, direction, chain):
    """`begin` for `rows`: the elements' own points (M, 3) on glossy facets (M,), seen along unit directions (M, 3) by way of chains (M,);
    start : (R + 1,) the points of each element, among which its rays go round."""
    triangle_of = np.zeros(len(surface.normal), np.int32)
    triangle_of[surface.facet] = np.arange(len(surface.facet))
    back = 1e-3

    def begin(first, last):
        n = np.diff(ray_start[first : last + 1])
        size = np.diff(start[first : last + 1])
        k = np.arange(int(n.sum())) - np.repeat(np.cumsum(n) - n, n)
        at = np.repeat(start[first:last], n) + k % np.repeat(size, n)
        rays = np.hstack([p[at] - back * direction[at], direction[at]]).astype(np.float32)
        many = len(at)
        source = np.arange(many)
        return Met(
            rays,
            triangle_of[facet[at]],
            np.full(many, back, np.float32),
            source,
            chain[at].astype(np.int32),
            np.ones(many),
            np.full(many, np.inf),
            np.zeros(many, np.int32),
        ), np.ones(many, bool)

    return begin


def _located(surface, mesh, rays, triangle, t):
    hit = kernels.locate(
        rays,
        triangle,
        t,
        surface.facet,
        surface.normal,
        surface.origin,
        surface.axes,
        surface.size,
        surface.inside,
        mesh.table_start,
        mesh.table_shape,
        mesh.leaf,
    )
    hit[surfaces.buried(surface, rays, triangle)] = kernels.DROPPED
    return hit


@dataclass(frozen=True)
class Transport:
    """The ways of a scene's light past mirrors and glossy surfaces of one finish, to its patches.

    F, D : by chain, see ChainRows;  mirrored : Emitters, lamps in plane mirrors, with their chains `way` (n,)
    D_mirrored : (N, n) factors of the patches to them, already part of D;  complete : see mirrored_lamps
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


def transport(surface: Surface, mesh: Mesh, finish: Finish, chains: Chains, lamps, n_lamps, *, n_rays=512) -> Transport:
    """From the lamps and the patches to the patches by way of mirrors and glossy surfaces."""
    mirrored, way, complete = mirrored_lamps(surface, finish, chains, lamps)
    ray_start, make = form_factors.from_patches(surface, mesh, n_rays)
    result = rows(
        surface,
        mesh,
        finish,
        chains,
        lamps,
        n_lamps,
        ray_start,
        from_rays(surface, mesh, make),
        seed=3,
        complete=complete,
    )
    one = [replace(lamp, lamp=k) for k, lamp in enumerate(mirrored)]
    factor = lamps_.patch_direct(surface, mesh, one, len(one), n_points=32) if one else np.zeros((len(mesh), 0))
    add_lamps(result.D, mirrored, way, factor, n_lamps)
    return Transport(finish, chains, result.F, result.D, mirrored, way, factor, complete, result.rays, result.lost)


@dataclass(frozen=True)
class SpecularLight:
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


def warm_up():
    """Load or compile every kernel, in a room with a mirror and a glossy wall."""
    surface = small_room("wall", "mirror", "gloss", "wall", "lamp", "wall")
    lamps = lamps_.emitters(surface, ["lamp"])
    mesh = adapt.build(surface, patches=20, max_level=0, contrast=1.0, emitters=lamps)
    finish = Finish(
        (1, 2), np.array([MIRROR, GLOSSY]), np.array([[0, 0], [0.2, 0.1]]), np.array([[0, 0, 0], [0, 0, 1.0]])
    )
    chains = Chains(2)
    transport(surface, mesh, finish, chains, lamps, 1, n_rays=16)
    views = np.array([[0, 0, 0, 0, 0, -1], [0, 0, 0, -0.6, 0, -0.8]], np.float32)
    mirror_view.through_mirrors(surface, finish, chains, views)
    begin = from_views(
        surface,
        np.array([0, 8]),
        np.array([0, 1]),
        surface.origin[2:3] + 0.1 * surface.axes[2].sum(axis=0),
        np.array([2], np.int32),
        -surface.normal[2:3],
        np.zeros(1, np.int32),
    )
    rows(surface, mesh, finish, chains, lamps, 1, np.array([0, 8]), begin)
