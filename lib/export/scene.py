"""What every export writes: the camera, surfaces as triangles, how they look, and the light.

    scene = read(model="model.obj", camera="left.posed.cameramodel", photograph="left.png", materials="materials.json")
    scene.pieces[0].look.rho_d                 # (3,)

Light is camera-referred, as in data/SCENE.md: linear image value = pi x radiance.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lib.core.report import Note
from lib.core.stage import BadInput
from lib.export import microfacet
from lib.given import materials
from lib.given.cameras import Camera
from lib.given.model import Model
from lib.given.view import View
from lib.light import surface as surfaces
from lib.picture import appearance
from lib.picture.albedo_maps import AlbedoMap

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}


@dataclass(frozen=True, eq=False)
class Look:
    """How one group looks, on both sides. A lamp's front emits, and reflects nothing unless rho_d says so.

    kind : of materials.json, or `lamp`;  rho_d, rho_s : (3,);  alpha : (2,) Ward's, of a lobe, else None
    tangent : (3,) unit, direction of the larger alpha, world, or None;  emittance : (3,) of a lamp, else None
    throw : (4,) unit aim, world, and exponent of a lamp that is not lambertian, else None
    """

    name: str
    kind: str
    rho_d: np.ndarray
    rho_s: np.ndarray
    alpha: np.ndarray | None = None
    tangent: np.ndarray | None = None
    emittance: np.ndarray | None = None
    throw: np.ndarray | None = None

    @property
    def is_mirror(self):
        return self.rho_s.any() and self.alpha is None

    @property
    def beckmann(self):
        """(3,) rho_s of a mirror, or of Beckmann's lobe of the same alphas."""
        return self.rho_s if self.alpha is None else self.rho_s * microfacet.weight(self.alpha)

    @property
    def anisotropic(self):
        return self.alpha is not None and self.tangent is not None and self.alpha[0] != self.alpha[1]

    @property
    def exact(self) -> dict:
        """The values as JSON has them: what formats keep beside their own approximation."""
        names = ("rho_d", "rho_s", "alpha", "tangent", "emittance", "throw")
        listed = {name: getattr(self, name) for name in names}
        return {"kind": self.kind} | {n: v.tolist() for n, v in listed.items() if v is not None}


@dataclass(frozen=True, eq=False)
class Piece:
    """The triangles of one object and one look; a textured facet is a piece of its own.

    name : no two are the same;  corners : (T, 3, 3) m, world;  normal : (T, 3) unit, front
    uv : (T, 3, 2) place in the texture, from its lower left corner, seen from the front; else along the tangent and
        across it, m;  facet : (T,) number in the model;  texture : of the one facet, or None
    """

    name: str
    object: str
    look: Look
    corners: np.ndarray
    normal: np.ndarray
    uv: np.ndarray
    facet: np.ndarray
    texture: AlbedoMap | None = None

    @property
    def tangents(self):
        """(T, 3) unit: the direction of u on each triangle."""
        return _along(self.look.tangent, self.normal)


@dataclass(frozen=True, eq=False)
class Scene:
    """up : of AXES;  glow : (3,) even radiosity that comes in where the model is open, zeros where none was found"""

    camera: Camera
    model: Model
    pieces: list
    looks: dict
    up: str
    glow: np.ndarray
    photograph: Path
    transfer: materials.FoundTransfer
    warnings: list = field(default_factory=list)

    def turn(self, to) -> np.ndarray:
        """(3, 3) rotation that takes the scene's up to the axis `to`."""
        return rotation(AXES[self.up], AXES[to])


def rotation(a, b) -> np.ndarray:
    """(3, 3): the shortest turn that takes the axis a to the axis b; half a turn goes about another axis.

    >>> rotation((0, 0, 1), (0, 1, 0)) @ (0, 0, 1)
    array([0., 1., 0.])
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a @ b < 0:  # by way of a third axis
        c = np.roll(np.abs(a), 1)
        return rotation(c, b) @ rotation(a, c)
    v = np.cross(a, b)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + a @ b)


def read(*, model, camera, photograph, materials, up="z") -> Scene:
    """From files, each checked against the others. BadInput: what render would refuse, too."""
    if up not in AXES:
        raise BadInput(f"--up: {up!r} is none of {', '.join(AXES)}")
    view = View.read(camera=camera, model=model, photograph=photograph)
    looks, maps, found, warnings = _looks(materials, view)
    warnings += found.cautions
    surface = surfaces.surface(view.model, [name for name, look in looks.items() if look.emittance is not None])
    pieces = _pieces(view.model, surface, looks, maps)
    glow = found.outside
    if glow[1:].any():
        warnings.append(Note("the glow that comes in where the model is open is exported as even: no gradient"))
    return Scene(view.camera, view.model, pieces, looks, up, glow[0], Path(photograph), found.transfer, warnings)


def _looks(path, view):
    """({group: Look}, {facet: AlbedoMap}, Materials, warnings)."""
    groups = view.model.groups
    lamps = [name for name in materials.read(path).lamps if name in groups]
    channels = view.photograph.values.shape[2]
    look, found, warnings = appearance.read(path, groups, lamps, channels, view.model.n_facets)
    three = lambda values: np.broadcast_to(values, 3).astype(float)
    finish = look.finish
    specular = {} if finish is None else {int(g): m for m, g in enumerate(finish.groups)}
    looks = {}
    for g, name in enumerate(groups):
        more = {}
        if name in lamps:
            lobe = found.lamps[name].lobe
            more = {"emittance": three(look.E[lamps.index(name)]), "throw": None if lobe is None else lobe.array}
            kind = "lamp"
        else:
            kind = found.groups[name].kind or "diffuse"
        m = specular.get(g)
        if m is not None and not found.groups[name].is_mirror:
            tangent = np.asarray(finish.tangent[m], float)
            length = np.linalg.norm(tangent)
            more = {"alpha": np.asarray(finish.alpha[m], float), "tangent": tangent / length if length else None}
        rho_s = np.zeros(3) if m is None else three(look.rho_s[m])
        looks[name] = Look(name, kind, three(look.rho[g]), rho_s, **more)
    return looks, look.maps, found, warnings


def _pieces(model, surface, looks, maps):
    """[Piece] in the order of the model's triangles.

    The corners are those that the light balance has: facets that lie in one plane with others are a hair apart, or
    other renderers would show either of them by chance.
    """
    T = len(model.triangles)
    corners = surface.corners[:T] * surface.local.diagonal + surface.local.centre
    facet = model.triangle_facet
    textured = np.where(np.isin(facet, list(maps)), facet, -1)
    key = np.column_stack([model.facet_object[facet], model.facet_group[facet], textured])
    rows, owner = np.unique(key, axis=0, return_inverse=True)
    pieces, names = [], set()
    for k, (thing, group, of) in enumerate(rows):
        mine = np.flatnonzero(owner.reshape(-1) == k)
        look, normal = looks[model.groups[group]], model.facet_normal[facet[mine]]
        texture = maps[of] if of >= 0 else None
        p = corners[mine]
        uv = _in_rectangle(texture, p) if texture is not None else _along_surface(look.tangent, normal, p)
        name = f"{model.objects[thing]} {look.name}" + (f" {of}" if of >= 0 else "")
        if name in names:
            name = f"{name} {k}"
        names.add(name)
        pieces.append(Piece(name, model.objects[thing], look, p, normal, uv, facet[mine], texture))
    return pieces


def _in_rectangle(texture, p):
    """(T, 3, 2) of corners (T, 3, 3): 0 to 1 over the texture's rectangle."""
    origin, right, top = texture.corners
    frame = np.linalg.pinv(np.column_stack([right - origin, top - origin]))
    return (p - origin) @ frame.T


def _along(tangent, normal):
    """(T, 3) unit: a direction laid on triangles of these normals (T, 3); any other where it has none there."""
    wanted = np.zeros(3) if tangent is None else tangent
    t = wanted - normal * (normal @ wanted)[:, None]
    length = np.linalg.norm(t, axis=1, keepdims=True)
    other = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    return np.where(length > 1e-9, t / np.maximum(length, 1e-9), other)


def _along_surface(tangent, normal, p):
    t = _along(tangent, normal)
    axes = np.stack([t, np.cross(normal, t)], axis=1)  # (T, 2, 3)
    return np.einsum("tcj,taj->tca", p, axes)


def rows_from_top(texture) -> np.ndarray:
    """(H, W, 3) linear albedo as a picture file has it: its first row is the upper edge, seen from the front."""
    picture = texture.albedo.swapaxes(0, 1)[::-1]
    return np.repeat(picture, 3 // picture.shape[2], axis=2)
