"""What the camera receives, as tiles of pixels, and the light that comes to them and from them: at once, by way of mirrors, out of lobes.

`Site` holds what a climb of the ladder (lib.ladder) leaves as it is. For given finishes `tiles_of` cuts the photograph into tiles: pixels
of a mirror become tiles of what it shows, those of a glossy surface show its lobe. `light` and `lobes` trace the ways of the light
(lib.specular), `bends` how a lobe's shape changes it, and `assemble` makes the inverse problem of all that.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lib import form_factors, gather
from lib.reflectance import Problem, Specular

LOWEST, HIGHEST = 0.004, 1.0     # alphas that are looked for


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
        direction = directions(camera, t.pixel)
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


def directions(camera, pixel):
    v = camera.rays(np.stack([pixel % camera.width, pixel // camera.width], axis=1).astype(float))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def shown(site, finish, chains, pixel):
    """What these pixels show in the end: lib.specular.View, and which of them are pure there too: all neighbours show the same
    facet by the same way."""
    from lib import specular
    from lib.index_buffer import boundary
    H, W = site.facet.shape
    origin = np.broadcast_to(site.surface.local.points(site.camera.centre), (len(pixel), 3))
    rays = np.hstack([origin, directions(site.camera, pixel)]).astype(np.float32)
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


def new_tiles(site, pixel, facet, side, p, direction, chain, lobe, *, rays, largest, smallest, per_facet, seed) -> Receivers:
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

def tiles_of(site, finish, chains, textured, *, rays=512):
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
                parts.append(new_tiles(site, pixel[mine], view.facet[mine], view.side[mine], view.p[mine], view.direction[mine], view.chain[mine],
                                       np.where(np.isin(g, glossy), number[g], -1), rays=rays, seed=31, **block))
    if glossy:
        pixel = np.flatnonzero(site.pure.reshape(-1) & np.isin(surface.group[site.facet.reshape(-1)], glossy))
        if len(pixel):
            f = site.facet.reshape(-1)[pixel].astype(np.int32)
            p, side = gather.backproject(surface, site.camera, f, pixel)
            parts.append(new_tiles(site, pixel, f, side, p, directions(site.camera, pixel), np.zeros(len(pixel), np.int32), number[surface.group[f]],
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
        start, some = few(tiles.start, 32)
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
    """Irradiance of tiles by way of the surfaces of `finish` (M), and its sampling error, (T, C) each, or 0 where there are none; rho_s : (M, C)"""
    from lib import specular
    if not len(finish):
        return 0.0, 0.0
    chains = specular.Chains(len(finish))
    G, D, G_spread, D_spread = ways(site, finish, chains, tiles)
    return chains.total(rho_s, G, D, state.b, state.E), chains.total(rho_s, G_spread, D_spread, state.b, state.E)


def few(start, most):
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
