"""Small scenes by hand for the tests of mirrors, gloss and the ladder.

Surfaces of a few polygons, and elements that look into them.
"""

from types import SimpleNamespace

import numpy as np

from lib.given.model.lids import Lids
from lib.given.transfer import Transfer
from lib.light import chains as chains_
from lib.light import factors_file, form_factors, specular
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from tests.helpers import rooms, stages


def rectangle(at, a, b):
    """The corners of a parallelogram; its front is where a x b points."""
    at, a, b = (np.array(x, float) for x in (at, a, b))
    return [at, at + a, at + a + b, at + b]


def closed_room(x=4.0, y=3.0, z=2.5):
    """[(group, corners)] of six walls seen from inside: bottom, top, west, east, south, north."""
    return list(rooms.box(0, 0, 0, x, y, z, inward=True).items())


def surface(polygons, lamps=(), scale=1.0, offset=(0.0, 0.0, 0.0)):
    """polygons : [(group, corners)], convex, each a facet of its own with two sides, none part of a solid."""
    groups = tuple(dict.fromkeys(group for group, _ in polygons))
    vertices, triangles, facet, normal = [], [], [], []
    for k, (_, corners) in enumerate(polygons):
        p = np.array(corners, float)
        triangles += [(len(vertices), len(vertices) + i, len(vertices) + i + 1) for i in range(1, len(p) - 1)]
        facet += [k] * (len(p) - 2)
        vertices += list(p)
        n = np.cross(p[1] - p[0], p[2] - p[0])
        normal.append(n / np.linalg.norm(n))
    model = SimpleNamespace(
        vertices=scale * np.array(vertices) + offset,
        triangles=np.array(triangles),
        triangle_facet=np.array(facet, np.int32),
        facet_normal=np.array(normal),
        facet_group=np.array([groups.index(g) for g, _ in polygons], np.int32),
        facet_object=np.zeros(len(polygons), np.int32),
        groups=groups,
        solid_objects=lambda: np.array([False]),
        lids=Lids(),
    )
    return surfaces.surface(model, list(lamps))


def finish(surface, **kinds):
    """Of the groups named: "mirror", an alpha, (alpha_x, alpha_y) or (alpha_x, alpha_y, tangent)."""
    groups = tuple(surface.groups.index(name) for name in kinds)
    kind = np.array([chains_.MIRROR if how == "mirror" else chains_.GLOSSY for how in kinds.values()])
    alpha, tangent = np.zeros((len(kinds), 2)), np.zeros((len(kinds), 3))
    for m, how in enumerate(kinds.values()):
        if how != "mirror":
            alpha[m] = how[:2] if isinstance(how, tuple) else how
            tangent[m] = how[2] if isinstance(how, tuple) and len(how) > 2 else 0
    return chains_.Finish(groups, kind, alpha, tangent)


def side_of(surface, group, back=False):
    """Number of the side of the one facet of a group."""
    (f,) = np.flatnonzero(surface.group == surface.groups.index(group))
    return np.int32(2 * f + back)


def elements(surface, mesh, finish, lamps, p, side, n_rays, **options):
    """The specular rows of points p (R, 3) metres on sides (R,): lib.light.specular.ChainRows and the chains."""
    p = surface.local.points(np.atleast_2d(p))
    side = np.broadcast_to(np.asarray(side, np.int32), len(p))
    chains = options.pop("chains", None) or chains_.Chains(len(finish))
    ray_start, make = form_factors.from_points(
        surface, p, np.arange(len(p) + 1), side, np.full(len(p), n_rays), seed=options.pop("rays_seed", 3)
    )
    rows = specular.rows(
        surface,
        mesh,
        finish,
        chains,
        lamps,
        1 + max((e.lamp for e in lamps), default=0),
        ray_start,
        specular.from_rays(surface, mesh, make),
        **options,
    )
    return rows, chains


def views(surface, mesh, finish, lamps, p, facet, direction, n_rays, **options):
    """The rows of points p (R, 3) metres on glossy facets (R,), seen along directions (R, 3)."""
    p = surface.local.points(np.atleast_2d(p))
    n = len(p)
    chains = options.pop("chains", None) or chains_.Chains(len(finish))
    direction = np.broadcast_to(direction, (n, 3)) / np.linalg.norm(direction, axis=-1, keepdims=True)
    ray_start = np.arange(n + 1) * n_rays
    begin = specular.from_views(
        surface, ray_start, np.arange(n + 1), p, np.broadcast_to(facet, n), direction, np.zeros(n, int)
    )
    return specular.rows(
        surface, mesh, finish, chains, lamps, 1 + max((e.lamp for e in lamps), default=0), ray_start, begin, **options
    ), chains


def factor(p, normal, corners, n=1500):
    """Form factor of a whole convex polygon from p (Lambert's contour), everything before its horizon.

    Independent of lib.
    """
    a = np.array(corners, float) - p
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    b = np.roll(a, -1, axis=0)
    c = np.cross(a, b)
    length = np.linalg.norm(c, axis=1)
    return abs((np.arctan2(length, (a * b).sum(axis=1)) * (c @ normal) / np.maximum(length, 1e-300)).sum()) / (
        2 * np.pi
    )


def midpoints(corners, n):
    """(n^2, 3) points of a parallelogram and the area of each cell."""
    o, a, b = np.array(corners[0], float), np.subtract(corners[1], corners[0]), np.subtract(corners[3], corners[0])
    u, v = (x.ravel()[:, None] for x in np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n, indexing="ij"))
    return o + u * a + v * b, np.linalg.norm(np.cross(a, b)) / n**2


# -- photographs of small rooms, made by our own renderer


def linear_picture(subject, shadow_rays=32, fine=False, **quality):
    """The subject rendered with a coarse texture of what rays see.

    Half the time, and within 0.3 % or so of a better one (fine).
    """
    from lib.picture import rendering, texels
    from lib.picture.subject import Quality

    if fine:
        return rendering.render(subject, Quality(shadow_rays=128, **quality)).linear
    whole = texels.light_map
    texels.light_map = lambda *words, **named: whole(*words, **{**named, "texels": 8000, "samples": 16})
    try:
        return rendering.render(subject, Quality(shadow_rays=shadow_rays, **quality)).linear
    finally:
        texels.light_map = whole


def photograph(linear, *, gamma=2.2, noise=0.004, bits=8, seed=1, srgb=False):
    """lib.given.image.Photograph of linear light: noise in display values, quantised.

    srgb : in place of gamma;  bits : 0 is linear as an EXR, with noise relative to the light
    """
    from lib.given import image

    rng = np.random.default_rng(seed)
    C = linear.shape[2]
    if bits == 0:
        return image.Photograph(np.maximum(linear * (1 + noise * rng.standard_normal(linear.shape)), 0), 0, True, C)
    shown = Transfer("srgb").display(np.clip(linear, 0, 1)) if srgb else np.clip(linear, 0, 1) ** (1 / gamma)
    shown = shown + noise * rng.standard_normal(linear.shape)
    depth = 2**bits - 1
    return image.Photograph(np.round(np.clip(shown, 0, 1) * depth) / depth, bits, False, C)


class Studio:
    """A room, a camera, and what depends on them alone, done once.

    Photographs of any materials in it, and what stages/fit.py finds in them.

    fine : light in photographs by far more patches and rays than the fit's, and tiles' by as many as are usual
    """

    def __init__(self, folder, objects, camera, lamps=("lamp",), patches=160, rays=512, fine=False):
        from lib.buffers import coverage, edges, index_buffer
        from lib.given import cameras, image, model

        self.folder, self.camera, self.lamps, self.fine = folder, camera, tuple(lamps), fine
        world = model.load(rooms.write(folder / "model.obj", objects))
        self.surface = s = surfaces.surface(world, lamps)
        self.groups = s.groups
        self.factors = self.light = self._factors(patches, rays)
        if fine:
            self.light = self._factors(1500, 4096, seed=1)
        index = index_buffer.reference(world, camera)
        self.facet, self.world = index.facet, world
        self.coverage = coverage.coverage(world, camera, index.facet, "rays")
        self.hidden = edges.visible_edges(world, camera, index.facet, index.depth)
        factors_file.write(folder / "formfactors.npz", self.factors)
        cameras.write_cameramodel(folder / "camera.cameramodel", camera)
        image.write_png16(folder / "facet.png", index.facet + 1)

    def _factors(self, patches, rays, seed=0):
        s = self.surface
        m = rooms.patches(s, patches)
        factor = lamps_.patch_direct(s, m, lamps_.emitters(s, self.lamps), len(self.lamps), n_points=32, seed=seed)
        area = np.bincount(s.group, surfaces.facet_areas(s), minlength=len(s.groups)) * s.local.diagonal**2
        rows, group = form_factors.rays(s, m, n_rays=rays, seed=seed), s.group[m.side // 2]
        return factors_file.FormFactors(m, rows, factor, self.lamps, group, s.groups, area, s.local.diagonal)

    def pixels(self, group):
        """(H, W) bool: those that show a group."""
        return (self.facet >= 0) & (self.surface.group[self.facet] == self.groups.index(group))

    def picture(self, materials, E, **options):
        """(H, W, C) linear.

        materials : {group: rho_d, ("mirror", rho_s) or (alpha, rho_d, rho_s)};  E : (L, C) or (L,)
        """
        from lib.given import image
        from lib.given.transfer import Transfer
        from lib.given.view import View
        from lib.picture.appearance import Appearance
        from lib.picture.subject import Subject

        E = np.array(E, float)
        E = E[:, None] if E.ndim == 1 else E
        C = E.shape[1]
        rho, kinds, rho_s = np.zeros((len(self.groups), C)), {}, []
        for name, what in materials.items():
            rho[self.groups.index(name)] = (
                what if not isinstance(what, tuple) else 0 if what[0] == "mirror" else what[1]
            )
            if isinstance(what, tuple):
                kinds[name] = what[0]
                rho_s.append(np.broadcast_to(what[-1], C))
        blank = image.Photograph(np.full((*self.facet.shape, C), 0.5), 8, False, C)
        view = View(self.camera, self.world, blank, self.facet)
        look = Appearance(rho, E)
        if kinds:
            look = Appearance(rho, E, finish(self.surface, **kinds), np.array(rho_s).reshape(-1, C))
        subject = Subject(view, self.surface, self.light, self.coverage, look, Transfer("linear"))
        return linear_picture(subject, fine=self.fine, **options)

    def write(self, photograph, folder=None):
        """left.png or .exr, gather.npz, audit.npz and edges.json of a photograph, as the stages before the fit do.

        Returns the folder.
        """
        from lib.analysis.seen import gather, places
        from lib.buffers import trust
        from lib.given import edges_file, image
        from lib.given.view import View

        folder = folder or self.folder
        s, facet = self.surface, self.facet
        depth = 2**photograph.bits - 1
        if photograph.linear:
            image.write_exr(folder / "left.exr", photograph.values)
        else:
            image.write_png8(folder / "left.png", np.round(photograph.values * depth).astype(np.uint8))
        trusted = trust.trusted(photograph, facet, self.hidden, s.group).mask
        view = View(self.camera, self.world, photograph, facet)
        for name, used, sampling in (
            ("gather", trusted, gather.Sampling(256 << self.fine, 8192 << self.fine)),
            ("audit", gather.pure(photograph, facet), gather.AUDIT),
        ):
            gather.write(folder / f"{name}.npz", gather.gathered(view, s, self.factors, used, sampling))
        given = {"camera": self.folder / "camera.cameramodel", "model": self.folder / "model.obj"}
        seen = View.read(**given, photograph=folder / ("left.exr" if photograph.linear else "left.png"))
        edges_file.write(folder / "edges.json", edges_file.Edges(places.by_edges(seen, list(self.lamps)).told))
        return folder

    def words(self, linear=False, lamps=None, transfer=None, reference=None, surfaces=None, **options):
        """The command line of stages/fit.py in this studio's folder."""
        import json

        files = dict(
            gather="gather.npz",
            audit="audit.npz",
            formfactors="formfactors.npz",
            model="model.obj",
            camera="camera.cameramodel",
            photograph="left.exr" if linear else "left.png",
            facet="facet.png",
            edges="edges.json",
            materials="materials.json",
            report="fit.report.json",
        )
        files = {name: self.folder / file for name, file in files.items()}
        facts = {"lamps": lamps, "reference": reference or {}, "surfaces": surfaces or {}, "transfer": transfer}
        return [
            str(word)
            for name, value in [*files.items(), *((k, json.dumps(v)) for k, v in facts.items()), *options.items()]
            for word in (f"--{name.replace('_', '-')}", value)
        ]

    def fit(self, photograph, E, **facts):
        """materials.json and fit.report.json of a photograph, the lamps known to be of emittance E."""
        import json

        self.write(photograph)
        lamps = {name: [float(x) for x in np.atleast_1d(e)] for name, e in zip(self.lamps, E, strict=True)}
        stage = stages.module("fit")
        stage.main(stage.options().parse_args(self.words(photograph.linear, lamps=lamps, **facts)))
        return tuple(json.loads((self.folder / name).read_text()) for name in ("materials.json", "fit.report.json"))
