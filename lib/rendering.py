"""§3.3 The picture: what the camera sees of the balanced light (eq. 3.2), and eq. 3.1 to compare it with.

    scene = read(model, camera, ...)              # files, checked against each other
    picture = render(scene)                       # linear, anti-aliased
    local, *_ = phong_picture(scene, picture)     # eq. 3.1

The patches' balance is one small linear solve; lib.illumination takes its light to the pixels; mixed pixels are the mean
of their fragments by area (the A-buffer). Colours are channels C (1 or 3); a radiosity is camera-referred.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lib import form_factors, illumination, radiosity
from lib.illumination import Fragments, Pixels
from lib.mesh import Surface
from lib.rays import OFFSET


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


def balance(F, D, side_group, area, exposed, rho, E, lamp_groups, front, *, tolerance=1e-6, reach=None, mirrored=None) -> Light:
    """b = rho (D E + F b), and where the light of the lamps ends.

    F : (N, N), or one for each channel;  D : (N, L) lamp factors, or one for each;  side_group : (N,) group of each patch;  area : (N,)
    exposed : (N,) share of each patch outside solids;  rho : (G, C);  E : (L, C);  lamp_groups : (L,)
    front : (N,) bool, the patch lies on the front of its facet
    reach : (N,) share of each patch's light that meets something at once, if F goes on behind mirrors;  mirrored : (G, C) rho_s

    The flux is closed over rays alone: what leaves a patch and meets nothing, by the sums of its rays, has escaped.
    A closed scene keeps everything, and the lamps' factors, reciprocity and the solve are all in what is left over.
    """
    by_channel = isinstance(F, list)
    times = (lambda A, X: np.stack([A[c] @ X[:, c] for c in range(X.shape[1])], axis=1)) if by_channel else lambda A, X: A @ X
    direct = times(D, E)
    r = rho[side_group]
    source = (r * direct).astype(np.float32)
    scale = r.astype(np.float32)
    b, residual, iterations = radiosity.gmres(lambda X: X - scale * times(F, X), source, tolerance=tolerance)
    indirect = times(F, b)
    emittance = np.zeros_like(b, dtype=float)
    for lamp, group in enumerate(lamp_groups):
        emittance[(side_group == group) & front] += E[lamp]
    size = (area * exposed)[:, None]
    reach = np.asarray(F @ np.ones(F.shape[1], np.float32))[:, None] if reach is None else np.asarray(reach)[:, None]
    emitted = (size * emittance).sum(axis=0)
    absorbed = (size * (1 - r - (0 if mirrored is None else mirrored[side_group])) * (direct + indirect)).sum(axis=0)
    escaped = (size * (emittance + b) * (1 - reach)).sum(axis=0)
    return Light(np.asarray(b, float), np.asarray(indirect, float), emitted, absorbed, escaped, residual, iterations)


# -- the picture

def radiosities(irradiance, surface: Surface, facet, side, rho, E, lamp_groups, p=None, textures=None):
    """(M, C): what places on facets reflect, and what the front of a lamp emits. p : (M, 3), needed where there are textures"""
    group = surface.group[facet]
    B = rho[group] * irradiance
    for f, texture in (textures or {}).items():
        from lib.textures import lookup
        at = np.flatnonzero(facet == f)
        if len(at):
            B[at] = lookup(texture, surface, p[at]) * irradiance[at]
    for lamp, lamp_group in enumerate(lamp_groups):
        B[(group == lamp_group) & (side & 1 == 0)] += E[lamp]
    return B


def compose(shape, pixels: Pixels, B, fragments: Fragments, B_fragment):
    """(H, W, C): pixels of one facet show its radiosity, mixed ones the mean of their fragments by area, in linear light."""
    picture = np.zeros((*shape, B.shape[1]))
    picture[pixels.y, pixels.x] = B
    mixed = np.zeros((len(fragments.pixel), B.shape[1]))
    np.add.at(mixed, np.repeat(np.arange(len(fragments.pixel)), np.diff(fragments.start)), B_fragment * fragments.share[:, None])
    picture.reshape(-1, B.shape[1])[fragments.pixel] = mixed
    return picture


# -- local illumination, for comparison

def phong(surface: Surface, lamps, p, side, E):
    """(M, C) light by eq. 3.1 as the paper means it as a contrast: from the middle of each lamp's facets, (N.L) / d^2, no shadows,
    no interreflection; k_s = 0 because every surface here is diffuse. The ambient term is the caller's."""
    normal = form_factors.side_normals(surface)[side]
    lit = np.zeros((len(p), E.shape[1]))
    for lamp in lamps:
        area = 0.5 * np.linalg.norm(np.cross(lamp.corners[:, 1] - lamp.corners[:, 0], lamp.corners[:, 2] - lamp.corners[:, 0]), axis=1)
        to = (lamp.corners.mean(axis=1) * area[:, None]).sum(axis=0) / area.sum() - p
        d2 = np.maximum((to ** 2).sum(axis=1), OFFSET ** 2)
        lit += (np.maximum(np.einsum("ij,ij->i", to, normal), 0) / d2 ** 1.5 * area.sum())[:, None] * E[lamp.lamp] / np.pi
    return lit


def ambient_and_power(r, lit, wanted, show):
    """The two free numbers of eq. 3.1 per channel, ambient intensity and lamp power (C,): the non-negative ones of the least squares
    of show(r (ambient + power lit)) against `wanted`, all (M, C)."""
    from scipy.optimize import least_squares
    some = slice(None, None, max(1, len(r) // 5000))
    ambient, power = np.zeros(r.shape[1]), np.ones(r.shape[1])
    for c in range(r.shape[1]):
        x, l, want = r[some, c], lit[some, c], wanted[some, c]
        if not x.any():
            continue
        level = max(float((x * l).mean()), 1e-12)
        start = np.array([0.3 * level / float(x.mean()), 1.0])
        best = least_squares(lambda t: show(x * (t[0] + t[1] * l)) - want, start, bounds=([0, 0], [np.inf, np.inf]), x_scale=start)
        ambient[c], power[c] = best.x
    return ambient, power


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
    finish: object = None            # lib.specular.Finish of the mirrors and glossy groups; None: there are none
    rho_s: np.ndarray = None         # (M, C)
    textures: dict = field(default_factory=dict)     # facet -> lib.textures.Texture

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

    @property
    def simple(self):
        """Whether T() is a function of the radiosity alone."""
        return self.photograph.linear or self.kind in ("gamma", "linear", "srgb")

    def show(self, B):
        """Linear -> display values in [0, 1], any shape for gamma, linear and srgb, whole pictures for the others."""
        from lib import display
        if self.photograph.linear:
            return np.clip(B, 0, 1) ** (1 / 2.2)
        if self.simple:
            return display.finished(B, self.kind, None, None, None, self.gamma)
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
    light: Light
    pixels: Pixels
    fragments: Fragments
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
    found = read_materials(materials, factors.groups, factors.lamps, photograph.values.shape[2])
    textures = read_textures(materials, found.textures, world.n_facets, photograph.values.shape[2])
    return Scene(mesh.surface(world, factors.lamps), camera, photograph, facet, factors, coverage, found.rho, found.E, found.kind, found.gamma, factors.groups,
                 found.warnings, found.finish, found.rho_s, textures)


@dataclass
class Materials:
    """What materials.json says. rho : (G, C);  E : (L, C);  finish, rho_s : of M specular groups, None;  textures : {facet: file}"""
    rho: np.ndarray
    E: np.ndarray
    kind: str
    gamma: float
    warnings: list
    finish: object
    rho_s: np.ndarray
    textures: dict


def read_materials(path, groups, lamps, channels) -> Materials:
    """materials.json, every value checked.

    A group never seen takes the value that was `assumed`; one without any value is black, with a warning.
    """
    from lib import artefact
    from lib.display import KINDS
    from lib.stage import BadInput
    content = artefact.read_json(path)
    problems, warnings, textures = [], [], {}
    specular = []                    # (group, mirror or not, rho_s, alpha, tangent)

    def table(value, name):
        if isinstance(value, dict):
            return value
        problems.append(f"{path}: {name}: {value!r} is not a table")
        return {}

    def numbers(value, name, low, high, n=3):
        if not isinstance(value, list) or len(value) != n or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in value):
            problems.append(f"{path}: {name} = {value!r} is not {'three' if n == 3 else 'two'} numbers")
            return np.ones(n)
        if min(value) < low or max(value) > high:
            inside = f"[{low:g}, {high:g}]"
            problems.append(f"{path}: {name} = {value} is outside {inside}" if high < np.inf else f"{path}: {name} = {value} is negative")
        return np.array(value, float)

    content = table(content, "content")
    entries, lit = table(content.get("groups"), "groups"), table(content.get("lamps"), "lamps")
    rho, E = np.zeros((len(groups), channels)), np.zeros((len(lamps), channels))
    for g, name in enumerate(groups):
        if name not in entries:
            if name not in lamps:
                problems.append(f"{path}: group {name!r}: missing")
            continue
        entry = table(entries[name], f"group {name!r}")
        kind = entry.get("kind")
        if kind not in ("diffuse", "mirror", "coloured_mirror", "glossy", "textured", None):
            problems.append(f"{path}: group {name!r}: kind = {kind!r} cannot be rendered")
        if kind in ("mirror", "coloured_mirror", "glossy"):
            s = numbers(entry.get("rho_s"), f"group {name!r}: rho_s", 0, 1)
            alpha = numbers(entry.get("alpha"), f"group {name!r}: alpha", 1e-4, 2, 2) if kind == "glossy" else np.zeros(2)
            tangent = numbers(entry["tangent"], f"group {name!r}: tangent", -1, 1) if kind == "glossy" and entry.get("tangent") is not None else np.zeros(3)
            specular.append((g, kind != "glossy", s[:channels], alpha, tangent))
        if kind == "textured" and entry.get("texture") is not None:
            textures |= table(entry["texture"], f"group {name!r}: texture")
        key = "rho_d" if entry.get("rho_d") is not None else "assumed"
        value = entry.get(key)
        if isinstance(value, dict):
            value = value.get("rho_d")
        if value is None:
            if name not in lamps:
                warnings.append(f"group {name!r} has no reflectance, measured or assumed: it is rendered black")
            continue
        rho[g] = numbers(value, f"group {name!r}: {key}", 0, 1)[:channels]
    for k, name in enumerate(lamps):
        if name not in lit:
            problems.append(f"{path}: lamp {name!r}: missing")
            continue
        lamp = table(lit[name], f"lamp {name!r}")
        E[k] = numbers(lamp.get("emittance"), f"lamp {name!r}: emittance", 0, np.inf)[:channels]
        if lamp.get("rho_d") is not None:                  # a lamp that is a reference too reflects that much
            rho[groups.index(name)] = numbers(lamp["rho_d"], f"lamp {name!r}: rho_d", 0, 1)[:channels]
    transfer = table(content.get("transfer"), "transfer")
    kind, gamma = transfer.get("kind"), transfer.get("gamma", 1.0)
    if kind not in KINDS:
        problems.append(f"{path}: transfer: kind = {kind!r} cannot be rendered (known: {', '.join(KINDS)})")
    elif kind == "gamma" and (isinstance(gamma, bool) or not isinstance(gamma, (int, float)) or gamma <= 0):
        problems.append(f"{path}: transfer: gamma = {gamma!r} is not a positive number")
    if problems:
        raise BadInput(*problems)
    finish = rho_s = None
    if specular:
        from lib.specular import GLOSSY, MIRROR, Finish
        group, mirror, rho_s, alpha, tangent = zip(*specular)
        finish = Finish(group, np.where(mirror, MIRROR, GLOSSY), np.array(alpha), np.array(tangent))
        rho_s = np.array(rho_s)
    return Materials(rho, E, kind, float(gamma) if kind == "gamma" else 1.0, warnings, finish, rho_s, textures)


def read_textures(materials, files, n_facets, channels) -> dict:
    """{facet: lib.textures.Texture} of the files that materials.json names, relative to its folder."""
    if not files:
        return {}
    from pathlib import Path
    from lib import textures
    from lib.stage import BadInput
    found = {}
    for facet, file in files.items():
        path = Path(materials).parent / str(file)
        if not facet.isdigit() or int(facet) >= n_facets:
            raise BadInput(f"{materials}: texture: facet {facet!r} is not in the model, which has {n_facets}")
        if not path.is_file():
            raise BadInput(f"{materials}: texture: facet {facet}: {path} is not there")
        texture = textures.read(path)
        if texture.albedo.shape[2] != channels:
            raise BadInput(f"{path}: channels: {texture.albedo.shape[2]} are not the photograph's {channels}")
        found[int(facet)] = texture
    return found


@dataclass
class Lighting:
    """A scene's balanced light, ready to be looked at from anywhere. lamps : plain and mirrored Emitters;  E : (their number, C)
    shown : illumination.Texture;  chains, ways : of lib.specular, None where nothing is specular"""
    light: Light
    lamps: list
    E: np.ndarray
    shown: illumination.Texture
    ways: object = None


def lighting(surface, factors, finish, rho_s, rho, E, lamp_groups, timing) -> Lighting:
    """The balance of the patches and the texture of what rays see; with the light's specular ways where there are any."""
    mesh, exposed = factors.mesh, factors.rows.exposed
    lamps = form_factors.emitters(surface, factors.lamps)
    front = mesh.side % 2 == 0
    with timing("balance"):
        sub = factors.subcell()
        F = (factors.rows.matrix() @ sub).tocsr()
        dense = lambda A: A.toarray() if len(mesh) <= 6000 else A
        if finish is None:
            light = balance(dense(F), factors.lamp_factor, factors.patch_group, mesh.area, exposed, rho, E, lamp_groups, front)
            indirect, ways, every, E_every = light.indirect, None, lamps, E
        else:
            from lib import specular
            chains = specular.Chains(len(finish))
            way = specular.transport(surface, mesh, finish, chains, lamps, len(E))
            power = chains.power(rho_s)
            C = E.shape[1]
            parts = {k: A @ sub for k, A in way.F.items()}
            Fs = [dense(sum((A * power[k, c] for k, A in parts.items()), F).tocsr()) for c in range(C)]
            Ds = [sum((D * power[k, c] for k, D in way.D.items()), factors.lamp_factor) for c in range(C)]
            mirrored = np.zeros_like(rho)
            mirrored[list(finish.groups)] = rho_s
            light = balance(Fs, Ds, factors.patch_group, mesh.area, exposed, rho, E, lamp_groups, front, reach=F @ np.ones(F.shape[1], np.float32), mirrored=mirrored)
            # mirrored lamps are lamps of their own in the picture; what lobes bring of the lamps is indirect light
            E_mirrored = np.array([E[lamp.lamp] * power[k] for lamp, k in zip(way.mirrored, way.way)]).reshape(-1, C)
            every = lamps + [replace(lamp, lamp=len(E) + k) for k, lamp in enumerate(way.mirrored)]
            E_every = np.vstack([E, E_mirrored])
            direct = factors.lamp_factor @ E + way.D_mirrored @ E_mirrored
            whole = np.stack([Ds[c] @ E[:, c] + Fs[c] @ light.reflected[:, c] for c in range(C)], axis=1)
            indirect = whole - direct
            ways = specular.Ways(finish, chains, rho_s, lamps, E, every, E_every, way.complete)
    with timing("texture"):
        shown = illumination.texture(surface, mesh, every, E_every, indirect, exposed, rho[surface.group], ways=ways)
    return Lighting(light, every, E_every, shown, ways)


def render(scene: Scene, *, n_rays=256, shadow_rays=64, contact=0.35, tolerance=0.01, lobe_rays=64, timing=None, trace=None) -> Picture:
    """The linear picture of the scene.

    n_rays : gathering rays at each place;  shadow_rays : per pixel and lamp in a penumbra;  contact, tolerance : see `gather`
    lobe_rays : per pixel of a glossy surface;  timing : context manager by label;  trace : called with the state of each refinement
    """
    import contextlib
    timing = timing or (lambda label: contextlib.nullcontext())
    surface, lamp_groups = scene.surface, scene.lamp_groups
    rho, E, size = scene.rho, scene.E, scene.facet.shape
    lit = lighting(surface, scene.factors, scene.finish, scene.rho_s, rho, E, lamp_groups, timing)
    light, lamps, shown = lit.light, lit.lamps, lit.shown
    emitted = lambda irradiance, facet, side, p: radiosities(irradiance, surface, facet, side, rho, E, lamp_groups, p, scene.textures)
    with timing("direct"):
        seen = illumination.pixels(surface, scene.camera, scene.facet)
        factor, penumbra = illumination.direct(surface, lamps, len(lit.E), seen, scene.camera, many=shadow_rays)
        irradiance = factor @ lit.E
    with timing("indirect"):
        leaves = illumination.gather(surface, shown, lamps, lit.E, seen, irradiance, n_rays=n_rays, contact=contact, tolerance=tolerance, trace=trace)
        indirect = illumination.interpolated(leaves, seen)
    B = emitted(irradiance + indirect, seen.facet, seen.side, seen.p)
    reflections = None
    if scene.finish is not None:
        from lib import reflections as reflected
        with timing("reflections"):
            reflections = reflected.picture(scene, lit, emitted, n_rays=n_rays, shadow_rays=shadow_rays, contact=contact, tolerance=tolerance, lobe_rays=lobe_rays)
            B += reflections.linear[seen.y, seen.x]
    with timing("antialias"):
        pieces = illumination.fragments(surface, scene.camera, scene.coverage)
        by_lamps, between = np.zeros((*size, scene.channels)), np.zeros((*size, scene.channels))
        by_lamps[seen.y, seen.x], between[seen.y, seen.x] = irradiance, indirect
        direct_there = illumination.fragment_direct(surface, lamps, len(lit.E), pieces) @ lit.E
        unseen = np.flatnonzero(~pieces.seen)
        direct_there[unseen] = illumination.beside(by_lamps, scene.facet, pieces)[0][unseen]
        indirect_there, found = illumination.beside(between, scene.facet, pieces)
        thin = np.flatnonzero(~found)
        indirect_there[thin] = illumination.looked_up(shown.between, shown, surface, pieces.p[thin], pieces.side[thin])
        B_there = emitted(direct_there + indirect_there, pieces.facet, pieces.side, pieces.p)
        if reflections is not None:
            B_there += reflected.of_fragments(scene, lit, pieces, reflections)
        linear = compose(size, seen, B, pieces, B_there)
    facts = {"iterations": light.iterations, "residual": light.residual, "penumbra_pixels": penumbra, "places": len(leaves),
             "gathering_rays": leaves.rays.sum(), "texels": len(shown.value),
             "flux": {"emitted": light.emitted, "absorbed": light.absorbed, "escaped": light.escaped}}
    if reflections is not None:
        facts["reflections"] = reflections.facts
    return Picture(linear, light, seen, pieces, facts)


def phong_picture(scene: Scene, picture: Picture):
    """The same view by eq. 3.1, anti-aliased alike: linear picture, ambient intensity (C,), lamp power relative to the true one (C,)."""
    surface, E, lamp_groups = scene.surface, scene.E, scene.lamp_groups
    lamps = form_factors.emitters(surface, scene.factors.lamps)
    seen, pieces = picture.pixels, picture.fragments
    lit = phong(surface, lamps, seen.p, seen.side, E)
    use = np.flatnonzero(scene.counted[seen.y, seen.x])
    ambient, power = ambient_and_power(scene.rho[surface.group[seen.facet[use]]], lit[use], scene.wanted[seen.y[use], seen.x[use]],
                                       scene.show if scene.simple else lambda B: np.clip(B, 0, 1))
    local = compose(scene.facet.shape, seen, radiosities(ambient + power * lit, surface, seen.facet, seen.side, scene.rho, E, lamp_groups), pieces,
                    radiosities(ambient + power * phong(surface, lamps, pieces.p, pieces.side, E), surface, pieces.facet, pieces.side, scene.rho, E, lamp_groups))
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
    facet_of = np.repeat(np.arange(6), 2).astype(np.int32)
    for array in (normal, facet_of):
        array.setflags(write=False)                    # as a model that was read has them: kernels are compiled for either kind
    model = SimpleNamespace(vertices=vertices, triangles=triangles, triangle_facet=facet_of, facet_normal=normal,
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
    coverage = {"pixel": np.arange(1, dtype=np.int32), "start": np.array([0, 1], np.int32), "facet": facet[0, :1], "count": np.array([64], np.uint8)}
    photograph = Photograph(np.full((21, 21, channels), 0.5), 8, False, channels)
    render(Scene(surface, camera, photograph, facet, factors, coverage, np.full((2, channels), 0.5), np.ones((1, channels)), "linear", 1.0, factors.groups), n_rays=16)
