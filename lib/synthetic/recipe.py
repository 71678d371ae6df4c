"""A recipe: all that is known of a synthetic scene, and the texts of its files."""

from dataclasses import dataclass, field, replace

import numpy as np

from lib.synthetic.chessboard import Board
from lib.synthetic.optics import cameramodel


@dataclass(frozen=True)
class Pair:
    """What makes a recipe a stereo scene.  The recipe's K and T_cam_world are the left camera's, without distortion."""

    lenses: tuple  # left, right
    T_right_left: np.ndarray  # (4, 4)
    room: str  # objects of the room that is seen begin with this; no light comes from the others
    noise: float  # of a displayed value in [0, 1], before it is rounded
    board: Board | None = None  # None: the cameras are given
    T_left_ref: np.ndarray = field(default_factory=lambda: np.eye(4))  # the frame of given cameras


@dataclass(frozen=True, eq=False)
class Texture:
    """Reflectances over a parallelogram.

    They are bilinear between the pixels' centres and constant beyond the outermost of them, so that the area mean is
    the image's mean.
    """

    image: np.ndarray  # (h, w, 3) linear
    origin: np.ndarray  # (3,) m: the outer corner of pixel [0, 0]
    u: np.ndarray  # (3,) m: from there along the columns of row 0, to its end
    v: np.ndarray  # (3,) m: along the rows of column 0, to its end

    def mean(self) -> tuple:
        """rho_d of the whole, one number per channel."""
        return tuple(float(x) for x in self.image.mean((0, 1)))


@dataclass(frozen=True)
class Surface:
    """What a group's reflection has beside rho_d: data/SCENE.md, sections 3 and 4.

    The rho_d of a textured group, in `Recipe.materials`, is its area mean.
    """

    kind: str = "diffuse"  # mirror, coloured_mirror, glossy, textured
    rho_s: tuple = (0, 0, 0)
    alpha: tuple | None = None  # glossy: alpha_x >= alpha_y
    tangent: tuple | None = None  # unit direction of alpha_x, model's frame; None where they are equal
    texture: Texture | None = None


@dataclass(frozen=True)
class Recipe:
    """A synthetic scene, with its truth."""

    name: str
    polygons: tuple  # of Polygon
    materials: dict  # group -> rho_d (3,); lamps are not in it
    lamps: dict  # group -> emittance (3,), camera-referred
    gamma: float | None  # None: linear, an EXR
    K: np.ndarray  # (3, 3) px
    size: tuple  # width, height px
    T_cam_world: np.ndarray  # (4, 4)
    reference: dict = field(default_factory=dict)  # lamp group -> rho_d of its surface
    channels: int = 3
    about: str = ""
    pair: Pair | None = None
    surfaces: dict = field(default_factory=dict)  # group -> Surface, of those that are more than diffuse
    lobes: dict = field(default_factory=dict)  # lamp group -> (aim (3,) unit, exponent), of those not lambertian
    params: dict = field(default_factory=dict)  # stage -> {name: value} that scene.yaml asks for

    @property
    def groups(self) -> tuple[str, ...]:
        """Every group, lamps too, in the order in which the model names them."""
        return tuple(dict.fromkeys(p.group for p in self.polygons))

    @property
    def objects(self) -> tuple[str, ...]:
        """Every object, in the order in which the model names them."""
        return tuple(dict.fromkeys(p.object for p in self.polygons))

    def rho_d(self, group) -> tuple:
        """Diffuse reflectance per channel; a lamp reflects only what `reference` says."""
        return tuple(self.materials.get(group, self.reference.get(group, (0.0, 0.0, 0.0))))

    def surface(self, group) -> Surface:
        """How the group reflects; diffuse where the recipe says nothing."""
        return self.surfaces.get(group, Surface())

    def textures(self) -> dict[str, Texture]:
        """group -> texture, of the textured groups."""
        return {group: surface.texture for group, surface in self.surfaces.items() if surface.texture}

    def mirrors(self) -> list:
        """The polygons that reflect perfectly, one per group of that kind."""
        out = [p for p in self.polygons if self.surface(p.group).kind in ("mirror", "coloured_mirror")]
        if len({p.group for p in out}) < len(out):
            raise ValueError("a group of mirrors must be one polygon")
        return out

    def finer(self, n) -> "Recipe":
        """The same view, n x n pixels in place of each; the picture's corners stay where they are."""
        K = self.K * [[n], [n], [1]]
        K[:2, 2] += (n - 1) / 2
        return self if n == 1 else replace(self, K=K, size=tuple(n * side for side in self.size))

    def project(self, p_world) -> np.ndarray:
        """(N, 3) m -> (N, 2) px; (0, 0) is the centre of the top-left pixel."""
        p_cam = np.asarray(p_world) @ self.T_cam_world[:3, :3].T + self.T_cam_world[:3, 3]
        q = p_cam @ self.K.T
        return q[:, :2] / q[:, 2:]

    def model(self) -> tuple[str, str]:
        """(text of model.obj, text of model.mtl)."""
        ordered = [p for name in self.objects for p in self.polygons if p.object == name]
        return obj_text(f"{self.name}: made by stages/synthesise.py; metres, z up", ordered), self._mtl()

    def _mtl(self):
        """The groups' names, each with a colour to look at; the colours are not the truth."""
        lines = []
        for i, group in enumerate(self.groups):
            hue = np.array([0.0, 2.1, 4.2]) + 2.4 * i
            kd = np.ones(3) if group in self.lamps else 0.6 + 0.25 * np.cos(hue)
            lines += [f"newmtl {group}", "Kd " + " ".join(f"{x:.3f}" for x in kd)]
        return "\n".join(lines) + "\n"

    def cameramodel(self) -> str:
        """The left camera as a pinhole, extrinsics relative to the model's frame."""
        return cameramodel((self.K[0, 0], self.K[1, 1], self.K[0, 2], self.K[1, 2]), self.T_cam_world, self.size)

    def views(self) -> dict:
        """{"left": (lens, T_cam_world), "right": ...} of a stereo scene."""
        return {
            "left": (self.pair.lenses[0], self.T_cam_world),
            "right": (self.pair.lenses[1], self.pair.T_right_left @ self.T_cam_world),
        }

    def pair_files(self) -> dict[str, str]:
        """{path: text} of a stereo scene's camera models: those that are given, and the true ones."""
        T_refs = self.pair.T_left_ref, self.pair.T_right_left @ self.pair.T_left_ref
        out = {}
        for (side, (lens, T)), T_ref in zip(self.views().items(), T_refs, strict=True):
            own = cameramodel(lens.core + lens.k if any(lens.k) else lens.core, T_ref, self.size)
            out[f"truth/{side}.cameramodel"] = own
            if self.pair.board is None:
                out[f"{side}.cameramodel"] = own
            out[f"truth/{side}.posed.cameramodel"] = cameramodel(lens.core, T, self.size)
        return out

    def scene_yaml(self) -> str:
        """What a photographer would know: the lamps, and what reflects a known amount.  Not the transfer."""
        triple = lambda xs: "[" + ", ".join(f"{x:.6g}" for x in xs) + "]"
        lines = [f"# {self.about}"]
        lines.append("lamps: {" + ", ".join(f"{g}: {triple(E)}" for g, E in self.lamps.items()) + "}")
        if self.pair and self.pair.board:
            lines.append(f"board: {{corners: {list(self.pair.board.corners)}, square_m: {self.pair.board.square_m}}}")
        if self.reference:
            lines.append("reference: {" + ", ".join(f"{g}: {triple(r)}" for g, r in self.reference.items()) + "}")
        if self.params:
            flow = lambda values: "{" + ", ".join(f"{k}: {v}" for k, v in values.items()) + "}"
            lines.append("params: " + flow({stage: flow(values) for stage, values in self.params.items()}))
        return "\n".join(lines) + "\n"


def obj_text(title, polygons, decimals=6) -> str:
    """The text of model.obj; the polygons of an object stand one after the other."""
    lines, vertices, name, usemtl = [f"# {title}", "mtllib model.mtl"], {}, None, None
    for polygon in polygons:
        if polygon.object != name:
            name, usemtl = polygon.object, None
            lines.append(f"o {name}")
        zero = f"{0:.{decimals}f}"
        corners = [tuple(f"{x:.{decimals}f}".replace(f"-{zero}", zero) for x in p) for p in polygon.points]
        for corner in corners:
            if corner not in vertices:
                vertices[corner] = len(vertices) + 1
                lines.append("v " + " ".join(corner))
        if polygon.group != usemtl:
            usemtl = polygon.group
            lines.append(f"usemtl {usemtl}")
        lines.append("f " + " ".join(str(vertices[c]) for c in corners))
    return "\n".join(lines) + "\n"


def exposed(polygons, materials, lamps, level) -> float:
    """The factor on `lamps` that puts the mean radiosity of the room near `level`, rounded to two digits.

    By the flux balance of a closed room, mean B = rho Phi / (S (1 - rho)), with area means for rho.  An exposure is
    wanted, so no more digits are needed.
    """
    S = sum(p.area() for p in polygons if p.group in materials)
    rho = sum(p.area() * np.mean(materials[p.group]) for p in polygons if p.group in materials) / S
    flux = sum(p.area() * np.mean(lamps[p.group]) for p in polygons if p.group in lamps)
    return float(f"{level * S * (1 - rho) / (rho * flux):.2g}")


def lit_room(name, polygons, materials, *, tint, level, surfaces=None, size=(640, 480), **more) -> Recipe:
    """The recipe of a room with one group of lamps, `lamp`.

    tint : of the lamps, per channel        level : what mean radiosity is wanted, see `exposed`
    more : the other fields of a recipe
    """
    surfaces = surfaces or {}
    E = exposed(polygons, brightness(materials, surfaces), {"lamp": tint}, level)
    lamps = {"lamp": scaled(E, tint)}
    return Recipe(name, tuple(polygons), materials, lamps, size=size, surfaces=surfaces, **more)


def scaled(E, tint) -> tuple:
    """The emittance E in each channel, rounded to what scene.yaml says."""
    return tuple(round(float(E * t), 4) for t in tint)


def brightness(materials, surfaces) -> dict:
    """group -> rho_d + rho_s: all that is reflected, for `exposed`."""
    return {g: np.add(rho, surfaces[g].rho_s if g in surfaces else 0) for g, rho in materials.items()}


def repainted(materials, random, *, lighter, tinted, dark, usual) -> dict:
    """Other paints for the same groups: `random` moves each channel by itself, so colours change too.

    lighter : largest change of all channels together        tinted : of each channel alone
    dark : groups that stay between 0.04 and 0.22; walls and ceilings stay between 0.55 and 0.85
    usual : (low, high) of the others
    """
    out = {}
    for group, rho in materials.items():
        low, high = (0.04, 0.22) if group in dark else (0.55, 0.85) if group in ("wall", "ceiling") else usual
        mixed = np.array(rho) + random.uniform(-lighter, lighter) + random.uniform(-tinted, tinted, 3)
        out[group] = tuple(np.round(np.clip(mixed, low, high), 3))
    return out
