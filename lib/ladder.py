"""The reflectance ladder (section 4.5): each group climbs only as far as its error demands.

    diffuse -> perfect mirror -> coloured mirror -> glossy (Ward) -> anisotropic -> textured

`climb` starts from the fit in which everything is diffuse and asks, group by group, whether the photograph agrees with it
to the threshold or the noise. Of the groups that do not, each is tried on the next rungs in the light found so far: as a
mirror by what its virtual viewpoint shows, as a glossy surface by the light in its lobe. The group whose error a rung
explains best climbs; then everything is fitted anew, all reflectances, lobes, lamps and gamma together, with the light
that now goes by way of that surface, and the question is asked again: a bright patch on the floor was perhaps only the
mirror's. What no rung explains is a texture.

A rung must be worth its parameters: among those that explain about equally well the lowest is taken, and one that gains
less than an information criterion asks for is not taken at all: noise never makes a wall glossy.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lib import form_factors, gather, reflectance
from lib.reflectance import Problem, Specular
from lib.transfer import Tiles as Pixels

RUNGS = ("diffuse", "mirror", "coloured_mirror", "glossy", "anisotropic", "textured")
THRESHOLD = 0.006            # display RMSE beyond noise that a rung may leave: about what shadows' edges leave of diffuse groups
ENOUGH = 12                  # tiles of a group without which it is not judged
ALPHAS = (0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.32, 0.5)
LOWEST, HIGHEST = 0.004, 1.0     # alphas that are looked for
SHARP = 0.2                  # alphas below which a lobe resolves the light within patches
TURNS = 6                    # directions that the search for an anisotropic lobe begins with


# -- what the camera receives, as tiles

@dataclass
class Receivers:
    """Tiles of the photograph (T) with their pixels (M), where those lie, and the light that reaches them.

    facet, group, object, chain : (T,) of the diffuse facet that is shown in the end, and the mirrors on the way
    start : (T + 1,);  pixel : (M,) flat;  values : (M, C) display;  p : (M, 3) local;  side : (M,);  direction : (M, 3) of the view
    direct : (T, L);  rows : form_factors.Rows;  lobe : (T,) specular group whose lobe it shows, -1;  fit : (T,) used by the fit
    """
    facet: np.ndarray
    group: np.ndarray
    object: np.ndarray
    chain: np.ndarray
    start: np.ndarray
    pixel: np.ndarray
    values: np.ndarray
    p: np.ndarray
    side: np.ndarray
    direction: np.ndarray
    direct: np.ndarray
    rows: form_factors.Rows
    lobe: np.ndarray
    fit: np.ndarray

    def __len__(self):
        return len(self.facet)

    @property
    def n_pixels(self):
        return np.diff(self.start)

    def take(self, which):
        """The tiles numbered `which`."""
        n = self.n_pixels[which]
        at = np.repeat(self.start[which] - np.concatenate([[0], np.cumsum(n)[:-1]]), n) + np.arange(int(n.sum()))
        return Receivers(*(getattr(self, name)[which] for name in ("facet", "group", "object", "chain")), np.concatenate([[0], np.cumsum(n)]),
                         *(getattr(self, name)[at] for name in ("pixel", "values", "p", "side", "direction")), self.direct[which], _rows_of(self.rows, which),
                         self.lobe[which], self.fit[which])

    @staticmethod
    def joined(parts):
        parts = [part for part in parts if len(part)]
        cat = lambda name: np.concatenate([getattr(part, name) for part in parts])
        start = np.concatenate([[0], np.cumsum(np.concatenate([part.n_pixels for part in parts]))])
        rows = [part.rows for part in parts]
        names = ("indices", "count", "half", "valid", "valid_half", "shot", "lost")
        joined = form_factors.Rows(indptr=np.concatenate([[0], np.cumsum(np.concatenate([np.diff(r.indptr) for r in rows]))]), columns=rows[0].columns,
                                   **{name: np.concatenate([getattr(r, name) for r in rows]) for name in names})
        return Receivers(cat("facet"), cat("group"), cat("object"), cat("chain"), start, cat("pixel"), cat("values"), cat("p"), cat("side"), cat("direction"),
                         cat("direct"), joined, cat("lobe"), cat("fit"))


def _rows_of(rows, which):
    n = np.diff(rows.indptr)[which]
    at = np.repeat(rows.indptr[which] - np.concatenate([[0], np.cumsum(n)[:-1]]), n) + np.arange(int(n.sum()))
    return form_factors.Rows(np.concatenate([[0], np.cumsum(n)]), rows.indices[at], rows.count[at], rows.half[at], rows.valid[which], rows.valid_half[which],
                             rows.shot[which], rows.lost[which], rows.columns)


@dataclass
class Site:
    """What stays the same while the ladder is climbed: geometry, camera, photograph, and the light of the diffuse fit."""
    surface: object
    factors: form_factors.Factors
    camera: object
    photograph: object
    facet: np.ndarray            # (H, W) int, -1 = nothing
    base: Problem                # everything diffuse
    base_tiles: Receivers        # trusted ones and those for the audit
    lobe_rays: int = 256         # of each tile that shows a lobe
    detail: object = None        # of light within patches, see lib.specular.rows; what sharp lobes show
    lost: float = 0.0            # share of the light that mirrors threw to and fro beyond lib.specular.DEPTH
    spent: dict = field(default_factory=dict)        # rays by what they were for

    @property
    def mesh(self):
        return self.factors.mesh

    @property
    def n_lamps(self):
        return len(self.factors.lamps)

    def __post_init__(self):
        self.lamps = form_factors.emitters(self.surface, self.factors.lamps)
        self.subcell = self.factors.subcell()
        self.normals = form_factors.side_normals(self.surface)
        self.pure = gather.pure(self.photograph, self.facet)
        self._patches = {}

    def note(self, what, number):
        self.spent[what] = self.spent.get(what, 0) + int(number)


def site(surface, factors, camera, photograph, facet, problem, gathered, audit, **options) -> Site:
    """gathered, audit : gather.Gathered of the trusted pixels and of all;  options : further fields of Site"""
    parts = []
    for g, fit in ((gathered, True), (audit, False)):
        t = g.tiles
        p, side = gather.backproject(surface, camera, np.repeat(t.facet, np.diff(t.start)), t.pixel)
        direction = _directions(camera, t.pixel)
        parts.append(Receivers(t.facet, g.group, g.object, np.zeros(len(t), np.int32), t.start, t.pixel, g.pixels, p, side, direction, t.direct, t.rows,
                               np.full(len(t), -1, np.int32), np.full(len(t), fit)))
    return Site(surface, factors, camera, photograph, facet, problem, Receivers.joined(parts), **options)


def read_site(files, formfactors, factors, problem, gathered, audit, **options) -> Site:
    """`site` from files = {model, camera, photograph, facet: path}; BadInput where one does not fit the others. formfactors : its path"""
    from lib import cameras, image, mesh, model as models
    from lib.stage import BadInput
    model, camera = models.load(files["model"]), cameras.read_cameramodel(files["camera"])
    photograph, facet = image.read_photograph(files["photograph"]), image.read_labels(files["facet"]) - 1
    for name, shape in (("photograph", photograph.values.shape[:2]), ("facet", facet.shape)):
        if shape != (camera.height, camera.width):
            raise BadInput(f"{files[name]}: size: {shape[1]} x {shape[0]} is not the camera's {camera.width} x {camera.height} ({files['camera']})")
    if tuple(model.groups) != tuple(factors.groups) or facet.max(initial=-1) >= model.n_facets:
        raise BadInput(f"{files['model']}: groups, facets: not those of {formfactors} or {files['facet']}")
    return site(mesh.surface(model, factors.lamps), factors, camera, photograph, facet, problem, gathered, audit, **options)


def unplaced(gathered, fit=False) -> Receivers:
    """Gathered tiles without the places of their pixels: enough for an audit of diffuse groups."""
    t, none = gathered.tiles, np.zeros((0, 3))
    return Receivers(t.facet, gathered.group, gathered.object, np.zeros(len(t), np.int32), t.start, t.pixel, gathered.pixels, none, np.zeros(0, np.int32), none,
                     t.direct, t.rows, np.full(len(t), -1, np.int32), np.full(len(t), fit))


def _directions(camera, pixel):
    v = camera.rays(np.stack([pixel % camera.width, pixel // camera.width], axis=1).astype(float))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def shown(site, finish, chains, pixel):
    """What these pixels show in the end: lib.specular.View, and which of them are pure there too: all neighbours show the same
    facet by the same way."""
    from lib import specular
    from lib.index_buffer import boundary
    H, W = site.facet.shape
    origin = np.broadcast_to(site.surface.local.points(site.camera.centre), (len(pixel), 3))
    rays = np.hstack([origin, _directions(site.camera, pixel)]).astype(np.float32)
    view = specular.through_mirrors(site.surface, finish, chains, rays)
    site.note("camera rays to mirrors", len(pixel))
    label = np.full(H * W, -1, np.int64)
    label[pixel] = np.where(view.facet >= 0, view.facet + view.chain.astype(np.int64) * len(site.surface.normal), -1)
    dense = np.unique(label, return_inverse=True)[1].reshape(H, W)
    pure = ~boundary(dense).reshape(-1)[pixel] & (view.facet >= 0) & site.pure.reshape(-1)[pixel]
    return view, pure


def pixels_of(site, groups):
    """Flat index of the pixels that show these groups at once."""
    return np.flatnonzero((site.facet >= 0).reshape(-1) & np.isin(site.surface.group[site.facet.reshape(-1)], groups))


def receivers(site, pixel, facet, side, p, direction, chain, lobe, *, rays, largest, smallest, per_facet, seed) -> Receivers:
    """New tiles of these pixels (n,), of one facet and chain each; lobe : (n,) specular group, -1."""
    H, W = site.facet.shape
    label = np.full(H * W, -1, np.int64)
    names, label[pixel] = np.unique(facet + chain.astype(np.int64) * len(site.surface.normal), return_inverse=True)
    used = np.zeros(H * W, bool)
    used[pixel] = True
    tile, start, at = gather.blocks(label.reshape(H, W), used.reshape(H, W), largest=largest, smallest=smallest, tiles_per_facet=per_facet)
    where = np.empty(H * W, np.int64)
    where[pixel] = np.arange(len(pixel))
    i = where[at]
    first = i[start[:-1]]
    p, side, direction = p[i], side[i].astype(np.int32), direction[i]
    direct = form_factors.direct(site.surface, site.lamps, p, site.normals, side, site.n_lamps, n_samples=4, start=start, seed=seed)
    n_rays = np.full(len(first), rays)
    rows = form_factors.gather(site.surface, site.mesh, p, start, side[start[:-1]], n_rays, seed=seed)
    site.note("gathering rays", n_rays.sum())
    f = facet[first].astype(np.int32)
    values = site.photograph.values.reshape(H * W, -1)[at]
    return Receivers(f, site.surface.group[f], site.surface.object[f], chain[first].astype(np.int32), start, at, values, p, side, direction, direct, rows,
                     lobe[first].astype(np.int32), np.ones(len(f), bool))


# -- the problem at given finishes

def _tiles_of(site, finish, chains, textured, *, rays=512):
    """All tiles where the groups of `finish` are specular: those of other groups stay, theirs are made anew."""
    from lib import specular
    surface = site.surface
    base = site.base_tiles
    swap = np.isin(base.group, textured)                           # of a texture not its flattest pixels count but all
    base = replace(base, fit=base.fit ^ swap)
    if finish is None:
        return base
    mirrors = [g for g, k in zip(finish.groups, finish.kind) if k == specular.MIRROR]
    glossy = [g for g, k in zip(finish.groups, finish.kind) if k == specular.GLOSSY]
    number = np.full(len(surface.groups), -1, np.int32)
    number[list(finish.groups)] = np.arange(len(finish))
    parts = [base.take(np.flatnonzero(~np.isin(base.group, finish.groups)))]
    lamp = np.isin(surface.group, [surface.groups.index(name) for name in site.factors.lamps])
    if mirrors:
        pixel = pixels_of(site, mirrors)
        view, pure = shown(site, finish, chains, pixel)
        good = np.flatnonzero(pure & ~lamp[view.facet])
        is_glossy = np.isin(surface.group[view.facet[good]], glossy)
        for mine, block in ((good[~is_glossy], dict(largest=20, smallest=4, per_facet=24)), (good[is_glossy], dict(largest=12, smallest=3, per_facet=300))):
            if len(mine):
                g = surface.group[view.facet[mine]]
                parts.append(receivers(site, pixel[mine], view.facet[mine], view.side[mine], view.p[mine], view.direction[mine], view.chain[mine],
                                       np.where(np.isin(g, glossy), number[g], -1), rays=rays, seed=31, **block))
    if glossy:
        pixel = np.flatnonzero(site.pure.reshape(-1) & np.isin(surface.group[site.facet.reshape(-1)], glossy))
        if len(pixel):
            f = site.facet.reshape(-1)[pixel].astype(np.int32)
            p, side = gather.backproject(surface, site.camera, f, pixel)
            parts.append(receivers(site, pixel, f, side, p, _directions(site.camera, pixel), np.zeros(len(pixel), np.int32), number[surface.group[f]],
                                   rays=rays, seed=41, largest=12, smallest=3, per_facet=400))
    return Receivers.joined(parts)


def lobes(site, finish, chains, tiles, *, rays=None, seed=7):
    """Rows of the tiles that show a lobe: specular.Rows over all T tiles."""
    from lib import specular
    which = np.flatnonzero(tiles.lobe >= 0)
    if not len(which):
        return specular.Rows()
    some = tiles.take(which)
    n = np.full(len(some), rays or site.lobe_rays)
    ray_start = np.concatenate([[0], np.cumsum(n)]).astype(np.int64)
    begin = specular.from_views(site.surface, ray_start, some.start, some.p, np.repeat(some.facet, some.n_pixels), some.direction, np.repeat(some.chain, some.n_pixels))
    rows = specular.rows(site.surface, site.mesh, finish, chains, site.lamps, site.n_lamps, ray_start, begin, seed=seed, detail=site.detail)
    site.note("rays in lobes", rows.rays)
    from scipy.sparse import csr_array
    spread = csr_array((np.ones(len(which), np.float32), (which, np.arange(len(which)))), shape=(len(tiles), len(which)))
    return specular.Rows({k: (spread @ F).tocsr() for k, F in rows.F.items()}, {k: spread @ D for k, D in rows.D.items()}, rows.rays, rows.lost)


def light(site, finish, chains, tiles):
    """The specular ways of the light to the patches and to the tiles: F, D, G, D_tile by chain, as reflectance.Specular has them,
    and of the last two what their rays leave open."""
    from lib import specular
    surface, mesh = site.surface, site.mesh
    to_patches = specular.transport(surface, mesh, finish, chains, site.lamps, site.n_lamps, n_rays=max(int(site.factors.rows.shot.max(initial=1)), 512))
    site.note("rays by specular ways", to_patches.rays)
    site.lost = to_patches.lost
    to_tiles = ways(site, finish, chains, tiles, (to_patches.mirrored, to_patches.way, to_patches.complete))
    return {k: (A @ site.subcell).tocsr() for k, A in to_patches.F.items()}, to_patches.D, *to_tiles


def ways(site, finish, chains, tiles, mirrored=None):
    """The specular ways of the light to tiles: G, D_tile by chain, and of both half the difference of two sets of samples.
    mirrored : of specular.mirrored_lamps"""
    from lib import specular
    surface = site.surface
    mirrored, way, complete = mirrored or specular.mirrored_lamps(surface, finish, chains, site.lamps)
    n = np.maximum(np.minimum(tiles.rows.shot, 1024), 64)
    ray_start, make = form_factors.from_points(surface, tiles.p, tiles.start, tiles.side[tiles.start[:-1]], n, seed=5)
    rows = specular.rows(surface, site.mesh, finish, chains, site.lamps, site.n_lamps, ray_start, specular.from_rays(surface, site.mesh, make), seed=5,
                         complete=complete, spread=True)
    site.note("rays by specular ways", rows.rays)
    site.lost = max(rows.lost, site.lost)
    if mirrored:                                                   # mirrors throw light with hard edges: every other point apart shows where
        one = [replace(lamp, lamp=k) for k, lamp in enumerate(mirrored)]
        start, some = _spread(tiles.start, 32)
        halves = []
        for odd in (0, 1):
            n = np.diff(start)
            mine = np.flatnonzero(((np.arange(len(some)) - np.repeat(start[:-1], n)) % 2 == odd) | (np.repeat(n, n) == 1))
            part = some[mine]
            begin = np.concatenate([[0], np.cumsum(np.where(n == 1, 1, (n + 1 - odd) // 2))])
            halves.append(form_factors.direct(surface, one, tiles.p[part], site.normals, tiles.side[part], len(one), n_samples=8, start=begin, seed=odd))
        specular.add_lamps(rows.D, mirrored, way, 0.5 * (halves[0] + halves[1]), site.n_lamps)
        specular.add_lamps(rows.D_spread, mirrored, way, 0.5 * (halves[0] - halves[1]), site.n_lamps)
        site.note("mirrored lamps", len(one))
    corrected = lambda F: {k: (A @ site.subcell).tocsr() for k, A in F.items()}
    return corrected(rows.F), rows.D, corrected(rows.F_spread), rows.D_spread


def by_ways(site, finish, rho_s, state, tiles):
    """Irradiance of tiles by way of the surfaces of `finish` (M), and its sampling error, (T, C) each; rho_s : (M, C)"""
    from lib import specular
    chains = specular.Chains(len(finish))
    nothing = np.zeros((len(tiles), state.E.shape[1]))
    if not len(finish):
        return nothing, nothing
    G, D, G_spread, D_spread = ways(site, finish, chains, tiles)
    power = chains.power(rho_s)
    total = lambda G, D: sum((power[k] * (A @ X) for parts, X in ((G, state.b), (D, state.E)) for k, A in parts.items()), nothing)
    return total(G, D), total(G_spread, D_spread)


def _spread(start, most):
    """At most so many elements of each set, evenly: the new start and the numbers of those taken."""
    n = np.minimum(np.diff(start), most)
    k = np.arange(int(n.sum())) - np.repeat(np.cumsum(n) - n, n)
    return np.concatenate([[0], np.cumsum(n)]), np.repeat(start[:-1], n) + k * np.repeat(np.diff(start), n) // np.repeat(n, n)


SHAPES = {"alpha": (1, 1, 0), "alpha_x": (1, 0, 0), "alpha_y": (0, 1, 0), "turn": (0, 0, 1)}     # of ln alpha_x, ln alpha_y and the angle of the tangent
# Half the difference over which a shape's derivative is taken. The noise of few rays falls as fast as this grows: on 30 tiles of 256
# rays 0.03 made of a true derivative of 0.0014 (beyond rho_d and rho_s) one of 0.0084, 36 times too much that alpha seemed to be known by
STEP = {"alpha": 0.2, "alpha_x": 0.2, "alpha_y": 0.2, "turn": 0.1}


def bent(finish, m, name, step, normal):
    """The finish with one shape of group m changed by `step` (of ln alpha, or rad about the normal)."""
    x, y, turn = SHAPES[name]
    alpha, tangent = np.array(finish.alpha, float), np.array(finish.tangent, float)
    alpha[m] = np.clip(alpha[m] * np.exp(np.array([x, y]) * step), LOWEST / 4, 2 * HIGHEST)
    if turn:
        t = tangent[m] - (tangent[m] @ normal) * normal
        t /= np.linalg.norm(t)
        tangent[m] = np.cos(step) * t + np.sin(step) * np.cross(normal, t)
    return replace(finish, alpha=alpha, tangent=tangent)


def bends(site, finish, chains, tiles, shapes, *, rays=None):
    """Derivatives of the lobes with respect to shapes [(m, name)], by central differences over the same random numbers; not those
    of the lobes themselves, or their noise would be taken for a shape's."""
    result = []
    for m, name in shapes:
        some = np.flatnonzero(tiles.lobe == m)
        if not len(some):
            continue
        normal = main_normal(site.surface, finish.groups[m])
        mine, step = replace(tiles, lobe=np.where(tiles.lobe == m, m, -1)), STEP[name]
        there, back = (lobes(site, bent(finish, m, name, sign * step, normal), chains, mine, rays=rays, seed=9) for sign in (1, -1))
        half = 0.5 / step
        result.append((m, name, _combined(there.F, back.F, half, -half), _combined(there.D, back.D, half, -half), -0.35, 0.35))
    return result


def _combined(a, b, x, y):
    """x a + y b of two dictionaries of matrices."""
    return {k: x * a[k] + y * b[k] if k in a and k in b else x * a[k] if k in a else y * b[k] for k in {*a, *b}}


def detailed(site, finish, state):
    """What the light at the ends of rays is of that of their patches, as textures of the scene show it (lib.illumination)."""
    import contextlib
    from lib import illumination, rendering
    lamp_groups = np.array([site.surface.groups.index(name) for name in site.factors.lamps], int)
    lit = rendering.lighting(site.surface, site.factors, finish, state.rho_s, state.rho, state.E, lamp_groups, lambda label: contextlib.nullcontext())
    mean = np.asarray(lit.light.reflected).mean(axis=1)

    def detail(rays, triangle, t, patch):
        there = illumination.reflected_at(site.surface, lit.shown, rays, triangle, t).mean(axis=1)
        return np.clip(np.divide(there, mean[patch], out=np.ones(len(patch)), where=mean[patch] > 1e-9), 0, 10)
    return detail


def main_normal(surface, group):
    """Of the group's largest facet: about it the tangent turns."""
    f = np.flatnonzero(surface.group == group)
    return surface.normal[f[np.argmax(surface.size[f].prod(axis=1))]]


def assemble(site, finish, chains, tiles, transport, rho_s, shapes=(), variance=None, final=False, rays=None) -> Problem:
    """The inverse problem of the tiles that take part in the fit; finish None: nothing is specular.

    rho_s : (M, C), NaN where free;  variance : (G,) display, of what a group's tiles are known to differ by
    final : trace the lobes twice, and without light within patches: what that changes is their uncertainty; and their shapes' derivatives with twice the rays
    """
    from lib import specular
    base, some = site.base, np.flatnonzero(tiles.fit)
    t = tiles.take(some)
    spec = None
    if finish is not None:
        F, D, G, D_tile, G_spread, D_spread = transport
        rows, doubts, halves = lobes(site, finish, chains, t, rays=rays), [], ()
        if final and rows.F:
            again = lobes(site, finish, chains, t, seed=8)
            doubts.append(("lobes' rays", _combined(rows.F, again.F, 0.5, -0.5), _combined(rows.D, again.D, 0.5, -0.5)))
            if site.detail is not None:
                detail, site.detail = site.detail, None
                plain = lobes(site, finish, chains, t)
                site.detail = detail
                # a third of what a finer look changed may still be missing (the same reasoning as form_factors.Factors.subcell)
                doubts.append(("lobes' light", _combined(rows.F, plain.F, 1 / 3, -1 / 3), {}))
            halves = (rows.F, rows.D), (again.F, again.D)
            rows = specular.Rows(_combined(rows.F, again.F, 0.5, 0.5), _combined(rows.D, again.D, 0.5, 0.5), rows.rays)
        spec = Specular(finish.groups, chains, F, D, {k: A[some] for k, A in G.items()}, {k: A[some] for k, A in D_tile.items()}, t.chain, rows.F, rows.D,
                        rho_s, bends(site, finish, chains, t, shapes, rays=2 * site.lobe_rays if final else rays), doubts, halves, tuple({k: A[some] for k, A in x.items()} for x in (G_spread, D_spread)))
    seen = lambda half=None: (t.rows.matrix(half) @ site.subcell).tocsr()
    return replace(base, G=seen(), G_plain=t.rows.matrix(), D_tile=t.direct, tile_group=t.group, tile_object=t.object, start=t.start, pixels=t.values,
                   halves=(seen(0), seen(1), *base.halves[2:]) if base.halves else (), specular=spec, variance=None if variance is None else variance[t.group][:, None])


# -- errors

@dataclass(frozen=True)
class Misfit:
    """How far tiles are from the photograph, in display values. excess : rms beyond noise and its chance;  tiles, pixels : how many"""
    excess: float
    rms: float
    noise: float
    tiles: int
    pixels: int

    @property
    def judged(self):
        return self.tiles >= ENOUGH


def misfit(problem, gamma, B, seen, n_pixels, spread=0.0) -> Misfit:
    """B, seen : (t, C) linear;  n_pixels : (t,);  spread : (t, C) display, of B's own sampling"""
    metric = reflectance._metric(problem, gamma)
    residual = metric.value(B) - metric.value(seen)
    w = n_pixels / max(n_pixels.sum(), 1)
    square = float((w[:, None] * residual ** 2).sum() / residual.shape[1])
    variance = float((w[:, None] * (problem.pixel_noise ** 2 / n_pixels[:, None] + np.broadcast_to(np.asarray(spread) ** 2, residual.shape))).sum() / residual.shape[1])
    chance = 1 + 3 * np.sqrt(2 / max(residual.size, 1))           # so far three standard errors of a mean square of noise reach
    return Misfit(float(np.sqrt(max(square - chance * variance, 0))), float(np.sqrt(square)), float(np.sqrt(variance)), len(n_pixels), int(n_pixels.sum()))


def audit(subcell, problem, result, tiles, transport=None, textured=(), patterns=False) -> dict:
    """{group: Misfit} of every group that is seen, all pixels taken together. Specular groups are judged by the tiles of their fit.

    patterns : instead, of the `textured` groups alone, all their pixels as if they had one reflectance
    """
    state, gamma = result.state, result.state.gamma
    found = {}
    spec = problem.specular
    rows = tiles.rows
    seen = Pixels(tiles.values, tiles.start).linear(reflectance._metric(problem, gamma).transfer)[0]
    metric = reflectance._metric(problem, gamma)
    G = (rows.matrix() @ subcell).tocsr()
    half = 0.5 * (((rows.matrix(0) - rows.matrix(1)) @ subcell) @ state.b)
    irradiance = tiles.direct @ state.E + G @ state.b
    power = np.ones((len(tiles), 1))
    if spec is not None:
        _, _, G_k, D_k, G_spread, D_spread = transport
        weight = spec.chains.power(state.rho_s)
        by_ways = lambda G, D: sum((weight[k] * (A @ X) for parts, X in ((G, state.b), (D, state.E)) for k, A in parts.items()), np.zeros_like(irradiance))
        irradiance = irradiance + by_ways(G_k, D_k)
        half = np.hypot(half, by_ways(G_spread, D_spread))
        power = weight[tiles.chain]
    B = power * state.rho[tiles.group] * irradiance
    spread = metric.slope(B) * np.abs(power * state.rho[tiles.group] * half)
    for g in textured if patterns else np.unique(tiles.group):
        if spec is not None and g in spec.groups:
            continue
        at_once = np.flatnonzero((tiles.group == g) & (tiles.fit == patterns) & (tiles.chain == 0))
        mirrored = np.flatnonzero((tiles.group == g) & (tiles.chain > 0))
        mine = mirrored if len(at_once) < ENOUGH <= len(mirrored) else at_once
        if len(mine):
            found[int(g)] = misfit(problem, gamma, B[mine], seen[mine], tiles.n_pixels[mine], spread[mine])
    if spec is not None and not patterns:
        t = tiles.take(np.flatnonzero(tiles.fit))
        target = reflectance._observe(problem, gamma)[0]
        for m, g in enumerate(spec.groups):
            through = (spec.chains.counts[t.chain][:, m] > 0) & (t.lobe < 0) & ~np.isin(t.group, textured)
            mine = np.flatnonzero((t.lobe == m) & (t.chain == 0) if (t.lobe == m).any() else through)
            if len(mine):
                found[int(g)] = misfit(problem, gamma, state.B[mine], target[mine], t.n_pixels[mine])
    return found


# -- trying a rung in the light found so far

@dataclass(frozen=True)
class Trial:
    """One rung tried for one group. rho_d, rho_s : (C,);  alpha : (2,);  tangent : (3,);  misfit, diffuse : with it and without, on the same tiles"""
    rung: str
    group: int
    misfit: Misfit
    diffuse: Misfit
    rho_d: np.ndarray
    rho_s: np.ndarray
    alpha: np.ndarray = field(default_factory=lambda: np.zeros(2))
    tangent: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def explained(self):
        """Share of the diffuse error's square that this rung takes away."""
        return 1 - (self.misfit.excess / max(self.diffuse.excess, 1e-12)) ** 2


def _scaled(metric, B, seen, weight, rounds=8):
    """(C,) s >= 0: the least squares of metric(s B) - metric(seen)."""
    s = np.maximum((weight * B * seen).sum(axis=0) / np.maximum((weight * B * B).sum(axis=0), 1e-300), 1e-6)
    for _ in range(rounds):
        r, slope = metric.value(s * B) - metric.value(seen), metric.slope(s * B) * B
        s = np.clip(s - (weight * r * slope).sum(axis=0) / np.maximum((weight * slope ** 2).sum(axis=0), 1e-300), s / 3, 3 * s)
    return s


def as_mirror(site, problem, state, finish, rho_s, g, plain, textured=()):
    """Trials of group g as a perfect and as a coloured mirror, or [] where its picture cannot be judged: what the virtual
    viewpoint shows, under the light found so far. Groups that only this mirror shows are free: one factor each."""
    from lib import specular
    M = len(finish)
    wider = replace(finish, groups=(*finish.groups, g), kind=np.append(finish.kind, specular.MIRROR), alpha=np.vstack([finish.alpha, np.zeros((1, 2))]),
                    tangent=np.vstack([finish.tangent, np.zeros((1, 3))]))
    chains = specular.Chains(M + 1)
    pixel = np.concatenate([pixels_of(site, [g]), _in_mirrors(site, finish, g)[0]])
    view, pure = shown(site, wider, chains, pixel)
    lamp = np.isin(site.surface.group, [site.surface.groups.index(name) for name in site.factors.lamps])
    good = np.flatnonzero(pure & ~lamp[view.facet])
    sure = good[~np.isin(site.surface.group[view.facet[good]], textured)]         # a texture's pattern would count as the mirror's error
    good = sure if len(sure) >= 200 else good
    if len(good) < 40:
        return []
    t = receivers(site, pixel[good], view.facet[good], view.side[good], view.p[good], view.direction[good], view.chain[good], np.full(len(good), -1, np.int32),
                  rays=128, largest=20, smallest=4, per_facet=24, seed=131)
    if len(t) < ENOUGH:
        return []
    metric = reflectance._metric(problem, state.gamma)
    seen = Pixels(t.values, t.start).linear(metric.transfer)[0]
    C = problem.channels
    irradiance = t.direct @ state.E + (t.rows.matrix() @ site.subcell) @ state.b
    mirrored, way, _ = specular.mirrored_lamps(site.surface, wider, chains, site.lamps, depth=2)
    power = chains.power(np.vstack([rho_s, np.ones((1, C))]))
    if mirrored:                                                   # what the mirror would light itself it also shows
        one = [replace(lamp, lamp=k) for k, lamp in enumerate(mirrored)]
        start, some = _spread(t.start, 16)
        factor = form_factors.direct(site.surface, one, t.p[some], site.normals, t.side[some], len(one), n_samples=4, start=start)
        irradiance = irradiance + factor @ np.array([state.E[lamp.lamp] * power[k] for lamp, k in zip(mirrored, way)])
    power = power[t.chain]
    weight = t.n_pixels[:, None] * np.ones(C)
    rho = state.rho.copy()
    rho[g] = 0                                                     # seen in another mirror in this one: as that one would be
    known = np.isin(t.group, np.setdiff1d(problem.tile_group, [g]))

    def tinted(s):
        """The picture of a mirror of this rho_s; what it alone shows has the reflectance that suits it best."""
        fitted = rho.copy()
        for other in np.unique(t.group[~known & (t.group != g)]):
            mine = t.group == other
            fitted[other] = np.clip(_scaled(metric, (s * power * irradiance)[mine], seen[mine], weight[mine]), 0, 1)
        return s * power * fitted[t.group] * irradiance

    one = np.ones(C)
    trials = [Trial("mirror", g, misfit(problem, state.gamma, tinted(one), seen, t.n_pixels), plain, np.zeros(C), one)]
    if known.any():                                                # else rho_s and what it shows cannot be told apart
        s = np.clip(_scaled(metric, (power * rho[t.group] * irradiance)[known], seen[known], weight[known]), 0, 1)
        trials.append(Trial("coloured_mirror", g, misfit(problem, state.gamma, tinted(s), seen, t.n_pixels), plain, np.zeros(C), s))
    return trials


def _in_mirrors(site, finish, g):
    """The pixels that show group g in known mirrors (n,), and by which ways, lib.specular.View (of M chains); pure ones only."""
    from lib import specular
    mirrors = [m for m, k in zip(finish.groups, finish.kind) if k == specular.MIRROR]
    pixel = pixels_of(site, mirrors) if mirrors else np.zeros(0, int)
    chains = specular.Chains(len(finish))
    if not len(pixel):
        return pixel, None, chains
    view, pure = shown(site, finish, chains, pixel)
    keep = np.flatnonzero(pure & (site.surface.group[view.facet] == g))
    return pixel[keep], specular.View(*(getattr(view, name)[keep] for name in ("facet", "side", "p", "chain", "direction"))), chains


def _plain(site, here, g) -> Misfit:
    """The group as diffuse with its best rho_d, on the tiles of the audit, or those of mirrors where only they show it."""
    t = here.tiles
    mine = np.flatnonzero((t.group == g) & ~t.fit & (t.chain == 0))
    if len(mine) < ENOUGH:                                         # a specular group's tiles are those of its fit: back to the first audit
        t = site.base_tiles
        mine = np.flatnonzero((t.group == g) & ~t.fit)
    if len(mine) < ENOUGH:
        t = here.tiles
        mine = np.flatnonzero((t.group == g) & (t.chain > 0))
    t, state = t.take(mine), here.result.state
    metric = reflectance._metric(here.problem, state.gamma)
    seen = Pixels(t.values, t.start).linear(metric.transfer)[0]
    irradiance, spread = t.direct @ state.E + (t.rows.matrix() @ site.subcell) @ state.b, 0.0
    if here.finish is not None:
        keep = [m for m, other in enumerate(here.finish.groups) if other != g]
        more, spread = by_ways(site, _kept(here.finish, keep), state.rho_s[keep], state, t)
        power = here.problem.specular.chains.power(state.rho_s)[t.chain]
        irradiance, spread = power * (irradiance + more), power * spread
    s = _scaled(metric, irradiance, seen, t.n_pixels[:, None] * np.ones(here.problem.channels))
    B = s * irradiance
    return misfit(here.problem, state.gamma, B, seen, t.n_pixels, metric.slope(B) * s * spread)


class Lobe:
    """A group's pixels, ready to be compared with lobes of any shape: `fit(alpha, tangent)` adjusts rho_d and rho_s alone."""

    def __init__(self, site, problem, state, finish, rho_s, g, most=260):
        from lib import specular
        self.site, self.problem, self.state, self.g = site, problem, state, g
        M = len(finish)
        self.wider = replace(finish, groups=(*finish.groups, g), kind=np.append(finish.kind, specular.GLOSSY), alpha=np.vstack([finish.alpha, np.zeros((1, 2))]),
                             tangent=np.vstack([finish.tangent, np.zeros((1, 3))]))
        self.rho_s = np.vstack([rho_s, np.ones((1, problem.channels))])
        H, W = site.facet.shape
        pixel = np.flatnonzero(site.pure.reshape(-1) & (site.surface.group[np.maximum(site.facet.reshape(-1), 0)] == g))
        self.tiles = None
        f = site.facet.reshape(-1)[pixel].astype(np.int32)
        p, side = gather.backproject(site.surface, site.camera, f, pixel)
        self.power, self.known = np.ones((1, problem.channels)), None
        direction, chain = _directions(site.camera, pixel), np.zeros(len(pixel), np.int32)
        if len(pixel) < 20:                                        # what only mirrors show
            pixel, view, chains = _in_mirrors(site, finish, g)
            if len(pixel) < 20:
                return
            f, side, p, direction, chain = view.facet, view.side, view.p, view.direction, view.chain
            self.power, self.known = chains.power(rho_s), chains
        t = receivers(site, pixel, f, side, p, direction, chain, np.full(len(pixel), M, np.int32),
                      rays=256, largest=12, smallest=3, per_facet=400, seed=141)
        if len(t) < ENOUGH:
            return
        self.metric = reflectance._metric(problem, state.gamma)
        if len(t) > most:
            t = t.take(np.unique(np.linspace(0, len(t) - 1, most).astype(int)))
        self.tiles, self.n = t, t.n_pixels
        self.seen = Pixels(t.values, t.start).linear(self.metric.transfer)[0]
        more, spread = by_ways(site, finish, rho_s, state, t)
        self.irradiance = (t.direct @ state.E + (t.rows.matrix() @ site.subcell) @ state.b + more) * self.power[t.chain]
        self.spread = spread * self.power[t.chain]
        self.weight = self.metric.slope(self.seen) ** 2 / (problem.pixel_noise ** 2 / self.n[:, None] + 0.004 ** 2)
        self.plain = self.fit(None)[0]

    def fit(self, alpha, tangent=None):
        """Misfit, chi2, rho_d, rho_s of the best non-negative combination; alpha None: diffuse."""
        from lib import specular
        if alpha is None:
            lobe = np.zeros_like(self.irradiance)
        else:
            wider = replace(self.wider, alpha=np.vstack([self.wider.alpha[:-1], np.atleast_2d(alpha)]),
                            tangent=np.vstack([self.wider.tangent[:-1], np.zeros((1, 3)) if tangent is None else np.atleast_2d(tangent)]))
            chains = specular.Chains(len(wider))
            tiles = self.tiles
            if self.known is not None:                             # the ways by which mirrors show it, in the numbers of one group more
                number = np.array([chains.number((*count, 0)) for count in self.known.count], np.int32)
                tiles = replace(tiles, chain=number[tiles.chain])
            rows = lobes(self.site, wider, chains, tiles, rays=128)
            power = chains.power(self.rho_s)
            lobe = sum((power[k] * (A @ self.state.b) for k, A in rows.F.items()), np.zeros_like(self.irradiance)) \
                + sum((power[k] * (A @ self.state.E) for k, A in rows.D.items()), np.zeros_like(self.irradiance))
        C = self.irradiance.shape[1]
        rho_d, rho_s = np.zeros(C), np.zeros(C)
        for c in range(C):
            rho_d[c], rho_s[c] = _two(self.irradiance[:, c], lobe[:, c], self.seen[:, c], self.weight[:, c])
        B = rho_d * self.irradiance + rho_s * lobe
        chi2 = float((self.weight * (B - self.seen) ** 2).sum())
        return misfit(self.problem, self.state.gamma, B, self.seen, self.n, self.metric.slope(B) * rho_d * self.spread), chi2, rho_d, rho_s


def _two(x, y, wanted, weight):
    """a, b in [0, 1] of the least squares of a x + b y."""
    xx, xy, yy = (weight * x * x).sum(), (weight * x * y).sum(), (weight * y * y).sum()
    xz, yz = (weight * x * wanted).sum(), (weight * y * wanted).sum()
    det = xx * yy - xy * xy
    if det > 1e-9 * xx * yy:
        a, b = (yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det
        if a >= 0 and b >= 0:
            return min(a, 1.0), min(b, 1.0)
        if a < 0 and yy > 0:
            return 0.0, float(np.clip(yz / yy, 0, 1))
    return float(np.clip(xz / max(xx, 1e-300), 0, 1)), 0.0


def as_glossy(site, problem, state, finish, rho_s, g, threshold):
    """Trials of group g as an isotropic and as an anisotropic lobe."""
    from scipy.optimize import minimize, minimize_scalar
    lobe = Lobe(site, problem, state, finish, rho_s, g)
    if lobe.tiles is None:
        return []
    cost = {}

    def at(alpha, tangent=None):
        key = (*np.round(np.log(np.clip(alpha, LOWEST, HIGHEST)), 6), *(() if tangent is None else np.round(tangent, 6)))
        if key not in cost:
            cost[key] = lobe.fit(np.clip(alpha, LOWEST, HIGHEST), tangent)
        return cost[key]

    values = [at((a, a))[1] for a in ALPHAS]
    k = int(np.argmin(values))
    low, high = ALPHAS[max(k - 1, 0)], ALPHAS[min(k + 1, len(ALPHAS) - 1)]
    best = minimize_scalar(lambda x: at((np.exp(x),) * 2)[1], bounds=(np.log(low if k else LOWEST), np.log(high if k < len(ALPHAS) - 1 else HIGHEST)),
                           method="bounded", options={"maxiter": 7})
    a = float(np.exp(best.x)) if best.fun < values[k] else ALPHAS[k]
    fit, chi2, rho_d, s = at((a, a))
    trials = [Trial("glossy", g, fit, lobe.plain, rho_d, s, np.array([a, a]))]
    if fit.excess <= threshold or trials[0].explained < 0.2:       # what no round lobe explains in the least, no long one will
        return trials
    normal = main_normal(site.surface, g)
    x = site.surface.axes[np.flatnonzero(site.surface.group == g)[0], 0]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    turned = lambda angle: np.cos(angle) * x + np.sin(angle) * np.cross(normal, x)
    starts = [(at((1.7 * a, a / 1.7), turned(angle))[1], angle) for angle in np.pi * np.arange(TURNS) / TURNS]
    _, angle = min(starts)
    start = np.array([np.log(1.7 * a), np.log(a / 1.7), angle])
    simplex = np.vstack([start, start + [0.4, 0, 0], start + [0, 0.4, 0], start + [0, 0, 0.25]])
    best = minimize(lambda v: at(np.exp(v[:2]), turned(v[2]))[1], start, method="Nelder-Mead", options={"maxfev": 45, "initial_simplex": simplex})
    alpha, tangent = np.clip(np.exp(best.x[:2]), LOWEST, HIGHEST), turned(best.x[2])
    fit, chi2_long, rho_d, s = at(alpha, tangent)
    if alpha[0] < alpha[1]:
        alpha, tangent = alpha[::-1], np.cross(normal, tangent)
    trials.append(Trial("anisotropic", g, fit, lobe.plain, rho_d, s, alpha, tangent))
    return trials


# -- textures

def albedo_maps(site, climb) -> dict:
    """{group: {facet: lib.textures.Texture}} of the textured groups: the photograph over the light of each pixel."""
    import contextlib
    from lib import illumination, rendering, textures
    groups = [g for g, p in climb.places.items() if p.rung == "textured"]
    if not groups:
        return {}
    surface, state = site.surface, climb.result.state
    lamp_groups = np.array([surface.groups.index(name) for name in site.factors.lamps], int)
    lit = rendering.lighting(surface, site.factors, climb.finish, state.rho_s, state.rho, state.E, lamp_groups, lambda label: contextlib.nullcontext())
    facet = np.where(np.isin(surface.group[np.maximum(site.facet, 0)], groups), site.facet, -1)
    seen = illumination.pixels(surface, site.camera, facet)
    factor, _ = illumination.direct(surface, lit.lamps, len(lit.E), seen, site.camera)
    direct = factor @ lit.E
    leaves = illumination.gather(surface, lit.shown, lit.lamps, lit.E, seen, direct)
    C = site.base.channels
    irradiance = np.zeros((*facet.shape, C))
    irradiance[seen.y, seen.x] = direct + illumination.interpolated(leaves, seen)
    metric = reflectance._metric(climb.problem, state.gamma)
    linear = metric.transfer.linear(site.photograph.values)
    level = np.median(linear[facet >= 0], axis=0) if (facet >= 0).any() else np.ones(C)
    noise = float(np.mean(climb.problem.pixel_noise / metric.slope(level)))       # one for all: noise by pixel would weigh dark ones more
    found = {}
    for g in groups:
        wanted = [int(f) for f in np.unique(facet[facet >= 0]) if surface.group[f] == g]
        usable = site.pure & np.isin(facet, wanted)
        found[g] = textures.albedo_maps(surface, site.camera, facet, usable, linear, irradiance, noise, state.rho[g], wanted)
        mine = np.flatnonzero(usable[seen.y, seen.x])
        if len(mine):                                              # what is left of the error with the texture
            y, x = seen.y[mine], seen.x[mine]
            B = np.zeros((len(mine), C))
            for f, texture in found[g].items():
                at = np.flatnonzero(seen.facet[mine] == f)
                B[at] = textures.lookup(texture, surface, seen.p[mine[at]]) * irradiance[y[at], x[at]]
            climb.misfits[g] = misfit(climb.problem, state.gamma, B, linear[y, x], np.ones(len(mine)))
    site.note("textured pixels", len(seen))
    return found


def write_textures(site, climb, folder) -> dict:
    """{group: lib.materials.Textured} of the textured groups that a pixel shows, their maps written to folder/textures."""
    from lib import materials, mesh, textures
    written = {}
    for g, maps in albedo_maps(site, climb).items():
        if not maps:                                               # said to be textured, and no pixel shows it
            continue
        (folder / "textures").mkdir(exist_ok=True)
        area = mesh.facet_areas(site.surface)[list(maps)]
        names = {str(f): f"textures/{Path(textures.write(folder / 'textures', texture)).name}" for f, texture in maps.items()}
        written[g] = materials.Textured(names, sum(a * textures.mean(texture) for a, texture in zip(area, maps.values())) / area.sum())
    return written


# -- the climb

@dataclass
class Place:
    """Where a group stands. rung : of RUNGS;  why : for the report;  tried : [{rung, excess}] at the step that led here"""
    rung: str = "diffuse"
    rho_d: np.ndarray = None
    rho_s: np.ndarray = None
    alpha: np.ndarray = field(default_factory=lambda: np.zeros(2))
    tangent: np.ndarray = field(default_factory=lambda: np.zeros(3))
    why: str = ""
    tried: list = field(default_factory=list)
    given: bool = False


@dataclass
class Climb:
    """The end of a climb. places : {group: Place};  misfits : {group: Misfit};  sigma_shape : {group: {shape: sigma}}
    patterns : {group: Misfit} of textured groups, as if they were of one colour"""
    problem: Problem
    result: reflectance.Result
    scale: str
    places: dict
    misfits: dict
    diffuse: dict
    finish: object
    tiles: Receivers
    rounds: int = 0
    sigma_shape: dict = field(default_factory=dict)
    patterns: dict = field(default_factory=dict)


def tolerance(misfit, threshold):
    """The error that a group may keep: the threshold of a small group, which shadows in corners may cover, and down to less than half of
    it for a group of many pixels, where they do not."""
    return threshold * float(np.clip(np.sqrt(2500 / max(misfit.pixels, 1)), 0.45, 1))


def flagged(problem, misfits, given, threshold) -> list:
    """The groups that a diffuse surface does not explain, and those that are said to be no diffuse ones."""
    known = {g for g in range(len(problem.groups)) if not np.isnan(problem.rho[g]).any()}
    return sorted({g for g, m in misfits.items() if g not in known and m.judged and m.excess > tolerance(m, threshold) and given.get(g) != "diffuse"}
                  | {g for g, kind in given.items() if kind != "diffuse"})


def doubt(problem, result, misfits, threshold, places=None):
    """Diffuse groups that differ from the photograph by more than they may are less sure of their reflectance than pixels and rays
    make them: as if all of that error were one of their brightness, or of anything where too few tiles are left to judge
    them by. Widens result.sigma_rho and says so in result.warnings."""
    known = {g for g in range(len(problem.groups)) if not np.isnan(problem.rho[g]).any()}
    B, seen = (reflectance.group_mean(problem, values) for values in (result.state.B, np.ones((len(problem.tile_group), 1))))
    for g, m in sorted(misfits.items()):
        if g in known or result.sigma_rho is None or not m.excess > tolerance(m, threshold) or not np.isfinite(seen[g]).all() or places and places[g].rung != "diffuse":
            continue
        rho, said = result.state.rho[g], f"group {problem.groups[g]!r}: the photograph differs by {m.excess:.1%} of full scale beyond noise from a diffuse surface"
        if m.judged:
            slope = reflectance._metric(problem, result.state.gamma).slope(B[g:g + 1])[0]
            wide = np.minimum(m.excess / np.maximum(slope * B[g], 1e-9), 1) * rho
            result.warnings.append(f"{said}, and no rung explains it; its sigma is widened")
        else:
            wide = np.maximum(rho, 0.02)
            result.warnings.append(f"{said}, and what is left of it ({m.tiles} tile{'s' * (m.tiles != 1)}) cannot tell what it is: its reflectance may be anything")
        result.sigma_rho[g] = np.maximum(result.sigma_rho[g], wide)


def climb(site, result, scale, *, given=None, threshold=THRESHOLD, trace=None, options=None, max_rounds=12) -> Climb:
    """From the diffuse fit to every group's rung.

    given : {group number: kind} from scene.yaml;  threshold : display RMSE beyond noise that a group may keep
    trace : called after each fit with round, result, places;  options : of reflectance.gauss_newton
    """
    given, options = dict(given or {}), dict(options or {})
    base = site.base
    misfits = audit(site.subcell, base, result, site.base_tiles)
    here = Climb(base, result, scale, {int(g): Place() for g in np.unique(site.surface.group)}, misfits, dict(misfits), None, site.base_tiles)
    known = {g for g in range(len(base.groups)) if not np.isnan(base.rho[g]).any()}       # lamps and references
    settled = set(known)
    for g, kind in given.items():
        here.places[g].given = True
        if kind == "diffuse":
            settled.add(g)
        elif kind == "textured":
            here.places[g] = Place("textured", why="given in scene.yaml", given=True)
            settled.add(g)
    if "textured" in given.values():
        here = _refit(site, here, options)
    wanted = {g: kind for g, kind in given.items() if kind in ("mirror", "coloured_mirror", "glossy")}
    for here.rounds in range(1, max_rounds + 1):
        energy = lambda g: here.misfits[g].excess ** 2 * here.misfits[g].pixels if g in here.misfits else np.inf
        over = {g for g, m in here.misfits.items() if g not in settled and m.judged and m.excess > tolerance(m, threshold)}
        flagged = sorted({*over, *wanted}, key=energy, reverse=True)
        trials, explained = {}, 0.0
        for g in flagged:
            if energy(g) < 0.03 * explained and g not in wanted:        # its error may be the other one's light: it is asked again
                continue
            trials[g] = _tried(site, here, g, wanted.get(g), threshold)
            explained = max([explained] + [energy(g) for t in trials[g] if t.explained > 0.8])
        # the greatest error first: what no rung explains may be what a mirror shows, or throw gamma off; but not before a rung that
        # explains its group wholly, whose light may be that error
        sure = any(t.explained > 0.8 and t.misfit.excess <= 0.5 * threshold for tried in trials.values() for t in tried)
        greatest = max((g for g in trials if g not in wanted and not any(t.explained > 0.5 for t in trials[g])), key=energy, default=None)
        others = max((energy(g) * t.explained for g in trials for t in trials[g]), default=0.0)
        taken = [] if greatest is not None and energy(greatest) > 4 * others and not sure else _taken(here, trials, threshold, wanted, settled)
        if not taken and greatest is not None:
            taken = _textured(here, [greatest], trials, threshold, settled)
        if not taken:
            taken = _taken(here, trials, threshold, wanted, settled)
        if not taken:
            break
        here = _refit(site, here, options)
        if _back(here, threshold):
            here = _refit(site, here, options)
        if trace:
            trace(here)
        wanted, settled = {}, settled | set(given)
    return here


def _tried(site, here, g, wanted, threshold):
    """The rungs above the group's own, tried one after the other in the present light, until one explains the group."""
    from lib import specular
    state, M = here.result.state, 0 if here.finish is None else len(here.finish)
    keep = [m for m in range(M) if here.finish.groups[m] != g]
    finish = _kept(here.finish, keep) if M else specular.Finish((), np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 3)))
    rho_s = state.rho_s[keep] if M else np.zeros((0, here.problem.channels))
    own = RUNGS.index(here.places[g].rung)
    trials = []
    if wanted in (None, "mirror", "coloured_mirror") and own < RUNGS.index("coloured_mirror"):
        trials += as_mirror(site, here.problem, state, finish, rho_s, g, _plain(site, here, g),
                            [h for h, p in here.places.items() if p.rung == "textured"])
        if wanted:
            return [t for t in trials if t.rung == wanted]
        if any(t.misfit.excess <= threshold or t.explained > 0.7 for t in trials):      # if the rest is more than the light's, it climbs on
            return [t for t in trials if RUNGS.index(t.rung) > own]
    trials += as_glossy(site, here.problem, state, finish, rho_s, g, threshold)
    return [t for t in trials if RUNGS.index(t.rung) > own]


def _kept(finish, which):
    """The finish of the specular groups numbered `which` alone."""
    return replace(finish, groups=tuple(finish.groups[m] for m in which), kind=finish.kind[which], alpha=finish.alpha[which], tangent=finish.tangent[which])


def _taken(here, trials, threshold, wanted, settled):
    """Give the groups that a rung explains that rung; returns them. Those explained nearly wholly at once, else the best alone."""
    choice = {}
    for g, kind in wanted.items():
        if not trials.get(g) and "mirror" in kind:                 # no pixel can judge it, yet its light goes on
            one = np.ones(here.problem.channels)
            here.places[g] = Place(kind, 0 * one, one, why="given in scene.yaml; no pixel shows what it reflects", given=True)
    blind = [g for g, kind in wanted.items() if not trials.get(g) and "mirror" in kind]
    for g, tried in trials.items():
        if not tried:
            continue
        best = min(t.misfit.excess for t in tried)
        now = here.misfits[g].excess if g in here.misfits else np.inf
        enough = max(threshold, 2 * best)                          # the light is not yet that of the end: about as good is good
        trial = next(t for t in sorted(tried, key=lambda t: RUNGS.index(t.rung)) if t.misfit.excess <= enough)
        diffuse = here.places[g].rung == "diffuse"
        gain = trial.explained if diffuse else 1 - (trial.misfit.excess / max(now, 1e-12)) ** 2
        if g in wanted or gain > 0.5 and (trial.rung not in ("glossy", "anisotropic") or trial.rho_s.max() > 0.002):
            choice[g] = (gain * trial.diffuse.excess ** 2 * trial.diffuse.pixels, gain, trial, tried)
    if not choice:
        return blind
    best = max(choice, key=lambda g: choice[g][0])
    taken = [g for g, (_, gain, _, _) in choice.items() if g == best or g in wanted or gain > 0.8]
    for g in taken:
        _, gain, trial, tried = choice[g]
        said = ", ".join(f"{t.rung} {t.misfit.excess:.4f}" for t in tried)
        old = here.places[g]
        why = f"off by {trial.diffuse.excess:.4f} beyond noise as diffuse; {said}" if not old.given else f"given in scene.yaml; {said}"
        here.places[g] = Place(trial.rung, trial.rho_d, trial.rho_s, trial.alpha, trial.tangent, why,
                               old.tried + [{"rung": t.rung, "excess": t.misfit.excess, "diffuse": t.diffuse.excess} for t in tried], old.given)
    return taken + blind


def _textured(here, flagged, trials, threshold, settled):
    """What no rung explains is a texture, if it is clearly more than shadows' edges leave. One at a time: the others may be well after it."""
    taken = [g for g in flagged if g in here.misfits and here.misfits[g].excess > 1.5 * threshold and here.places[g].rung == "diffuse"]
    for g in taken:
        here.places[g].rung = "textured"
        here.places[g].tried = [{"rung": t.rung, "excess": t.misfit.excess, "diffuse": t.diffuse.excess} for t in trials.get(g, [])]
        here.places[g].why = f"off by {here.misfits[g].excess:.4f} beyond noise as diffuse, and no mirror or lobe explains half of that"
        settled.add(g)
    return taken


def _back(here, threshold) -> list:
    """Textures that were none: the light of a rung taken later explains them. They are diffuse again, and stay so."""
    back = [g for g, m in here.patterns.items() if not here.places[g].given and m.excess <= tolerance(m, threshold)]
    for g in back:
        why = here.places[g].why.split(",")[0]
        here.places[g] = Place(why=f"{why}; {here.patterns[g].excess:.4f} in the light by way of what climbed after it", tried=here.places[g].tried)
    return back


def _finish(places):
    from lib import specular
    groups = [g for g, p in sorted(places.items()) if p.rung in ("mirror", "coloured_mirror", "glossy", "anisotropic")]
    kind = np.array([specular.MIRROR if "mirror" in places[g].rung else specular.GLOSSY for g in groups], int)
    return specular.Finish(tuple(groups), kind, np.array([places[g].alpha for g in groups]).reshape(-1, 2), np.array([places[g].tangent for g in groups]).reshape(-1, 3))


def _shapes(places, finish):
    return [(m, name) for m, g in enumerate(finish.groups)
            for name in {"glossy": ("alpha",), "anisotropic": ("alpha_x", "alpha_y", "turn")}.get(places[g].rung, ())]


def _refit(site, here, options) -> Climb:
    """Everything anew with the light that goes by way of the specular groups; lobes are traced again until their shapes stay."""
    from lib import specular
    places, state = here.places, here.result.state
    finish = _finish(places)
    chains = specular.Chains(len(finish))
    C = site.base.channels
    textured = [g for g, p in places.items() if p.rung == "textured"]
    variance = np.zeros(len(site.base.groups))
    variance[textured] = [here.misfits[g].excess ** 2 if g in here.misfits else 0.05 ** 2 for g in textured]
    if not len(finish):
        tiles = _tiles_of(site, None, chains, textured)
        problem = assemble(site, None, chains, tiles, None, None, variance=variance)
        result, scale = reflectance.fit(problem, start=(state.rho, state.E, state.gamma, None), **options)
        return replace(here, problem=problem, result=result, scale=scale, tiles=tiles, misfits=audit(site.subcell, problem, result, tiles),
                       patterns=audit(site.subcell, problem, result, tiles, None, textured, patterns=True))
    tiles = _tiles_of(site, finish, chains, textured)
    transport = light(site, finish, chains, tiles)
    traced = np.array(finish.alpha)
    fixed = site.base.rho.copy()
    rho, free = state.rho.copy(), np.full((len(finish), C), np.nan)
    rho_s = np.ones((len(finish), C))
    old = {g: m for m, g in enumerate(here.finish.groups)} if here.finish is not None else {}
    for m, g in enumerate(finish.groups):
        if finish.kind[m] == specular.MIRROR:
            fixed[g] = rho[g] = 0
        elif places[g].rho_d is not None:
            rho[g] = places[g].rho_d
        rho_s[m] = state.rho_s[old[g]] if g in old and places[g].rho_s is None else np.clip(places[g].rho_s, 1e-3, 1)
        if places[g].rung == "mirror":
            rho_s[m], free[m] = 1, 1
    base, site.base = site.base, replace(site.base, rho=fixed)
    try:
        start = (rho, state.E, state.gamma, rho_s)
        rough = bool(_shapes(places, finish))
        for turn in range(12):
            shapes = _shapes(places, finish)
            # half the rays on the way
            problem = assemble(site, finish, chains, tiles, transport, free, shapes, variance, rays=max(site.lobe_rays // 2, 16) if rough else None)
            result = reflectance.gauss_newton(problem, start=start, finish=False, **{**options, "max_iterations": 12, "tolerance": 1e-3})
            start = (result.state.rho, result.state.E, result.state.gamma, result.state.rho_s)
            steps = result.state.bend
            for (m, name, *_), step in zip(problem.specular.bend, steps):
                finish = bent(finish, m, name, step, main_normal(site.surface, finish.groups[m]))
            for m in range(len(finish)):
                finish = _ordered(site, finish, m)
            if np.max(np.abs(np.log(np.maximum(finish.alpha, 1e-6) / np.maximum(traced, 1e-6))), initial=0) > 0.25:
                transport, traced = light(site, finish, chains, tiles), np.array(finish.alpha)
            largest = np.max(np.abs(steps), initial=0)
            if rough and largest < 0.01:
                rough = False
                if (np.asarray(finish.alpha)[finish.kind == specular.GLOSSY] < SHARP).any():
                    site.detail = detailed(site, finish, result.state)     # sharp lobes see more than patches
            elif not rough and largest < 0.004:
                break
        # every mirror may have any rho_s; one that is 1 within its uncertainty is perfect
        mirrors = [m for m, g in enumerate(finish.groups) if "mirror" in places[g].rung and not places[g].given]
        free[mirrors] = np.nan
        problem = assemble(site, finish, chains, tiles, transport, free, _shapes(places, finish), variance, final=True)
        result, scale = reflectance.fit(problem, start=(*start[:3], np.where(np.isnan(free), np.minimum(start[3], 0.999), start[3])), **options)
        for m in mirrors:
            place, rho_s = places[finish.groups[m]], result.state.rho_s[m]
            away = (np.abs(rho_s - 1) > np.maximum(3 * result.sigma_rho_s[m], 0.004)).any()
            if away and place.rung == "mirror":
                place.why += f"; rho_s = {', '.join(f'{v:.3f}' for v in rho_s)} is not 1"
            place.rung = "coloured_mirror" if away else "mirror"
            free[m] = np.nan if away else 1
        if not np.isnan(free[mirrors]).all():
            problem = replace(problem, specular=replace(problem.specular, rho_s=free, _mixtures={}))
            result, scale = reflectance.fit(problem, start=(*(getattr(result.state, name) for name in ("rho", "E", "gamma")),
                                                            np.where(np.isnan(free), result.state.rho_s, free)), **options)
    finally:
        site.base, site.detail = base, None
    sigma_shape = {}
    for i, (m, name, *_) in enumerate(problem.specular.bend):
        finish = bent(finish, m, name, result.state.bend[i], main_normal(site.surface, finish.groups[m]))      # the last step of the instruments
        if result.sigma_bend is not None:
            sigma_shape.setdefault(finish.groups[m], {})[name] = float(result.sigma_bend[i])
    for m, g in enumerate(finish.groups):
        places[g] = replace(places[g], rho_d=None, rho_s=None, alpha=finish.alpha[m], tangent=finish.tangent[m])
    new = replace(here, problem=problem, result=result, scale=scale, finish=finish, tiles=tiles, sigma_shape=sigma_shape)
    new.misfits = audit(site.subcell, problem, result, tiles, transport, textured)
    new.patterns = audit(site.subcell, problem, result, tiles, transport, textured, patterns=True)
    return new


def _ordered(site, finish, m):
    """alpha_x >= alpha_y: else the tangent is turned by a right angle."""
    if finish.alpha[m, 0] >= finish.alpha[m, 1]:
        return finish
    alpha, tangent = np.array(finish.alpha, float), np.array(finish.tangent, float)
    alpha[m] = alpha[m, ::-1]
    tangent[m] = np.cross(main_normal(site.surface, finish.groups[m]), tangent[m])
    return replace(finish, alpha=alpha, tangent=tangent)
