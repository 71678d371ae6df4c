"""Light straight from lamps.

Lamps are small and bright and therefore treated apart: the exact factor of the lamp's polygon from a point (Lambert's
contour formula) times its visible share, by shadow rays.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lib.given.rays import shifts, sobol
from lib.given.rays_kernels import OFFSET
from lib.light import lamps_kernels as kernels
from lib.light.cells import Mesh
from lib.light.cells_kernels import patch_points, sides_of_points
from lib.light.form_factors import CHUNK
from lib.light.lamps_kernels import LampArrays
from lib.light.surface import Surface, covered, on_hand, side_normals, triangle_areas

LAMBERTIAN = np.array([0.0, 0.0, 1.0, -1.0])  # no lobe


@dataclass(frozen=True)
class Emitter:
    """Triangles of one lamp that are sampled together."""

    lamp: int  # index into the lamp groups
    corners: np.ndarray  # (K, 3, 3) local
    normal: np.ndarray  # (K, 3) front
    cdf: np.ndarray  # (K,) cumulated share of the area
    facets: tuple = ()  # their facets, where nothing mirrors them
    # Facets of the plane mirrors that show it, the one nearest to the receiver first. Corners and normals are then
    # those of the mirror image.
    mirrors: tuple = ()
    lobe: np.ndarray = field(default_factory=lambda: LAMBERTIAN)  # (4,) unit aim and exponent

    @property
    def arrays(self) -> LampArrays:
        """For kernels."""
        return LampArrays(self.corners, self.normal, self.cdf, self.lobe)

    @property
    def has_lobe(self):
        return self.lobe[3] >= 0

    def thrown(self, along):
        """(n,) radiance along directions (n, 3) over that along the aim."""
        return thrown(self.lobe, along)


def thrown(lobe, along):
    """max(0, cos)^exponent of directions (..., 3) of any length, 1 of a lambertian lamp. lobe : (4,)"""
    if lobe[3] < 0:
        return np.ones(np.shape(along)[:-1])
    cosine = along @ lobe[:3] / np.maximum(np.linalg.norm(along, axis=-1), 1e-300)
    return np.where(cosine > 0, np.maximum(cosine, 1e-300) ** lobe[3], 0.0)


def emitters(surface: Surface, lamps, lobes=None) -> list[Emitter]:
    """The lamps' facets: each by itself while they are few, together where a lamp is a mesh of many.

    lamps : names of the groups that emit, in the order of the columns of the factors; the outside has no facets
    lobes : {name: (4,)} of those that throw their light in lobes
    """
    result = []
    area = triangle_areas(surface.corners)
    for lamp, name in enumerate(lamps):
        if name not in surface.groups:
            continue
        facets = np.intersect1d(np.flatnonzero(surface.group == surface.groups.index(name)), surface.facet)
        if not len(facets):
            continue  # of an object that is not there
        facets = facets[np.argsort(surface.place[facets])]
        sets = [[f] for f in facets] if len(facets) <= 8 else [facets]
        for chosen in sets:
            t = np.flatnonzero(np.isin(surface.facet, chosen))
            t = t[np.lexsort((surface.triangle_place[t], surface.place[surface.facet[t]]))]
            cdf = np.cumsum(area[t]) / area[t].sum()
            facets_of_it = tuple(int(f) for f in chosen)
            lobe = (lobes or {}).get(name, LAMBERTIAN)
            normal = surface.normal[surface.facet[t]]
            result.append(
                Emitter(lamp, on_hand(surface.corners[t], surface.hand), normal, cdf, facets_of_it, lobe=lobe)
            )
    return result


def reached(surface: Surface, lamp: Emitter, rays):
    """(n,) bool: nothing stands on the way to the points of the lamp at which rays (n, 6), origin and vector, aim.

    To a mirrored lamp the way leads through its mirrors: it must meet each of them first, and nothing after the last.
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


def direct(
    surface: Surface,
    lamps,
    points,
    normals,
    normal_idx,
    n_lamps,
    *,
    n_samples,
    seed=0,
    start=None,
    weight=None,
    shadows=True,
    numbers=None,
) -> np.ndarray:
    """Factor from each point to each lamp, shadows included, (M, n_lamps); with `start` the mean of each set of points.

    The exact unoccluded factor times the visible share. The share comes from `n_samples` points of the lamp, weighted
    with the light that they would send. Without an occluder in the scene no ray is cast and the result is exact.

    The share is a ratio of sums and biased by about 1 / samples. Where a mean is wanted (`start`), the sums run over
    the whole set, which takes the bias away: 4 samples per pixel and a ratio per pixel cost 0.6 % on `office`.

    points : (M, 3) local, on their facets;  normals : (K, 3);  normal_idx : (M,) the normal of each point
    start : (S + 1,) sets of consecutive points -> (S, n_lamps);  weight : (M,) of the points in their set
    shadows : False: as if nothing stood in between (and mirrors showed all of a mirrored lamp)
    numbers : (M,) of the points: their shadow rays follow these, and not what points there are beside them. By default
        that in `points`, or by `numbered` of `start`
    """
    numbers = numbered(len(points), start) if numbers is None else numbers
    weight = np.ones(len(points)) if weight is None else np.asarray(weight, float)
    first = np.arange(len(points)) if start is None else np.asarray(start[:-1])
    sets = len(first)
    mass = np.maximum(np.add.reduceat(weight, first), 1e-300) if sets else np.zeros(0)
    factor = np.zeros((sets, n_lamps))
    sequence = sobol(n_samples)
    for number, lamp in enumerate(lamps):
        share = kernels.factors(points, normal_idx, normals, lamp.arrays) * weight
        total = (np.add.reduceat(share, first) if sets else share) / mass
        if shadows and (surface.n_occluders or lamp.mirrors):
            lit = np.flatnonzero(share > 0)
            seen, sent = np.zeros(len(points)), np.zeros(len(points))
            for a in range(0, len(lit), max(1, CHUNK // n_samples)):
                which = lit[a : a + max(1, CHUNK // n_samples)]
                shift = shifts(numbers[which], n_samples, seed + 31 * number)
                r, light = kernels.shadow_rays(points, normal_idx, normals, which, sequence, shift, lamp.arrays)
                visible = reached(surface, lamp, r)
                sent[which] = light.reshape(-1, n_samples).sum(axis=1)
                seen[which] = (light * visible).reshape(-1, n_samples).sum(axis=1)
            if start is not None:
                seen, sent = np.add.reduceat(seen * weight, first), np.add.reduceat(sent * weight, first)
            total = total * np.divide(seen, sent, out=np.zeros_like(seen), where=sent > 0)
        factor[:, lamp.lamp] += total
    return factor


def numbered(n, start=None):
    """(n,) int: numbers of points. Each set of them begins at a number that no set before it can move, however many
    points it has; so a pixel more in one tile is no other light in all that follow.  start : (S + 1,) or None
    """
    if start is None:
        return np.arange(n)
    count = np.diff(start)
    block = 1 << int(count.max(initial=1) - 1).bit_length()
    return np.arange(n) + np.repeat(block * np.arange(len(count)) - start[:-1], count)


def patch_direct(surface: Surface, mesh: Mesh, lamps, n_lamps, *, n_points, n_samples=4, seed=0) -> np.ndarray:
    """Mean factor of each patch to each lamp, (N, n_lamps), over its points outside solids.

    So a patch half under a cabinet has the light of its other half (docs/decisions/solids.md).
    """
    shift = shifts(len(mesh), n_points, seed + 2000)
    p = patch_points(n_points, sobol(n_points), shift, mesh.pieces, surface.arrays)
    normals = side_normals(surface)
    normal_idx = sides_of_points(n_points, sobol(n_points), shift, mesh.pieces)
    return direct(
        surface,
        lamps,
        p,
        normals,
        normal_idx,
        n_lamps,
        n_samples=n_samples,
        seed=seed,
        start=np.arange(len(mesh) + 1) * n_points,
        weight=~covered(surface, p, normals[normal_idx]),
    )
