"""Recipes of the synthetic scenes: geometry, materials, lamp, camera and film, by code.

    recipe = recipes.make("office-2")      # the same every time
    recipe.write_model(folder)             # model.obj, model.mtl
    recipe.cameramodel()                   # text of left.posed.cameramodel

A recipe knows the truth; `stages/synthesise.py` renders it.  A recipe with a `pair` is a stereo scene: two lenses, their chessboards, and a model of
several rooms of which one is seen.  Rooms are made of single polygons that face inwards
(one object each, so that no room is mistaken for a solid), furniture of closed boxes and prisms that stand on the
floor and touch the walls.  z is up; metres.
"""
from dataclasses import dataclass, field
from pathlib import Path
import functools
import json

import numpy as np

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Polygon:
    """A convex planar polygon, counter-clockwise seen from its front."""
    object: str
    group: str
    points: np.ndarray            # (n, 3) m


@dataclass(frozen=True)
class Lens:
    """mrcal's LENSMODEL_OPENCV8: with r2 = x^2 + y^2 of a point (x, y, 1), radial = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3),
    x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2), y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y, and u = fx x' + cx, v = fy y' + cy."""
    core: tuple                   # fx, fy, cx, cy px
    k: tuple = (0,) * 8           # k1 k2 p1 p2 k3 k4 k5 k6

    @property
    def K(self) -> np.ndarray:
        fx, fy, cx, cy = self.core
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    def project(self, p_cam) -> np.ndarray:
        """(N, 3) m in the camera's frame, before it -> (N, 2) px."""
        fx, fy, cx, cy = self.core
        radial, dx, dy = self._terms(p_cam[:, 0] / p_cam[:, 2], p_cam[:, 1] / p_cam[:, 2])
        return np.c_[fx * (p_cam[:, 0] / p_cam[:, 2] * radial + dx) + cx, fy * (p_cam[:, 1] / p_cam[:, 2] * radial + dy) + cy]

    def unproject(self, u, v) -> tuple:
        """Pixels -> (x, y) of the ray (x, y, 1), for arrays of NumPy or Dr.Jit in double precision.  The fixed point of
        x = (x' - tangential) / radial: each step gains a digit or more for lenses as mild as ours, so 24 reach rounding."""
        fx, fy, cx, cy = self.core
        xd, yd = (u - cx) / fx, (v - cy) / fy
        x, y = xd, yd
        if any(self.k):
            for _ in range(24):
                radial, dx, dy = self._terms(x, y)
                x, y = (xd - dx) / radial, (yd - dy) / radial
        return x, y

    def _terms(self, x, y):
        k1, k2, p1, p2, k3, k4, k5, k6 = self.k
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return radial, 2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


@dataclass(frozen=True)
class Board:
    """A flat chessboard and where it was held.  Inner corner (i, j) lies at (i, j, 0) square_m of its frame; z points away from the camera."""
    corners: tuple                # inner corners across, down
    square_m: float
    T_left_board: tuple           # of (4, 4)

    def points(self) -> np.ndarray:
        """(across * down, 3) m, row by row."""
        x, y = np.meshgrid(np.arange(self.corners[0]), np.arange(self.corners[1]))
        return np.stack([x, y, 0 * x], -1).reshape(-1, 3) * self.square_m

    def outline(self, margin) -> np.ndarray:
        """(4, 3) m: the corners of the squares' rectangle and `margin` squares around it."""
        (x0, y0), (x1, y1) = (-1 - margin, -1 - margin), (self.corners[0] + margin, self.corners[1] + margin)
        return np.array([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)]) * self.square_m

    def polygons(self, T) -> list:
        """Black and white squares and a white margin, one square wide, in the frame that T (4, 4) leads to."""
        def piece(group, x0, y0, x1, y1):           # the front sees the camera, at -z
            p = np.array([(x0, y0, 0), (x0, y1, 0), (x1, y1, 0), (x1, y0, 0)]) * self.square_m
            return Polygon("board", group, p @ T[:3, :3].T + T[:3, 3])
        nx, ny = self.corners
        out = [piece(("black", "white")[(i + j) % 2], i, j, i + 1, j + 1) for j in range(-1, ny) for i in range(-1, nx)]
        return out + [piece("white", -2, -2, nx + 1, -1), piece("white", -2, ny, nx + 1, ny + 1),
                      piece("white", -2, -1, -1, ny), piece("white", nx, -1, nx + 1, ny)]


@dataclass(frozen=True)
class Pair:
    """What makes a recipe a stereo scene.  Its K and T_cam_world are the left camera's, without the lens's distortion."""
    lenses: tuple                 # left, right
    T_right_left: np.ndarray      # (4, 4)
    room: str                     # objects of the room that is seen begin with this; no light comes from the others
    noise: float                  # of a displayed value in [0, 1], before it is rounded
    board: Board | None = None    # None: the cameras are given
    T_left_ref: np.ndarray = field(default_factory=lambda: np.eye(4))        # the frame of given cameras


@dataclass(frozen=True, eq=False)
class Texture:
    """Reflectances over a parallelogram: bilinear between the pixels' centres, constant beyond the outermost of them, so that the area mean is the image's."""
    image: np.ndarray             # (h, w, 3) linear
    origin: np.ndarray            # (3,) m: the outer corner of pixel [0, 0]
    u: np.ndarray                 # (3,) m: from there along the columns of row 0, to its end
    v: np.ndarray                 # (3,) m: along the rows of column 0, to its end

    def mean(self) -> tuple:
        return tuple(float(x) for x in self.image.mean((0, 1)))


@dataclass(frozen=True)
class Surface:
    """What a group's reflection has beside rho_d (of a textured one `materials` has the area mean): data/SCENE.md, sections 3 and 4."""
    kind: str = "diffuse"         # mirror, coloured_mirror, glossy, textured
    rho_s: tuple = (0, 0, 0)
    alpha: tuple | None = None    # glossy: alpha_x >= alpha_y
    tangent: tuple | None = None  # unit direction of alpha_x, model's frame; None where they are equal
    texture: Texture | None = None


@dataclass(frozen=True)
class Recipe:
    name: str
    polygons: tuple               # of Polygon
    materials: dict               # group -> rho_d (3,); lamps are not in it
    lamps: dict                   # group -> emittance (3,), camera-referred
    gamma: float | None           # None: linear, an EXR
    K: np.ndarray                 # (3, 3) px
    size: tuple                   # width, height px
    T_cam_world: np.ndarray       # (4, 4)
    reference: dict = field(default_factory=dict)   # lamp group -> rho_d of its surface
    channels: int = 3
    about: str = ""
    pair: Pair | None = None
    surfaces: dict = field(default_factory=dict)    # group -> Surface, of those that are more than diffuse

    @property
    def groups(self) -> tuple:
        """Every group, lamps too, in the order in which the model names them."""
        return tuple(dict.fromkeys(p.group for p in self.polygons))

    @property
    def objects(self) -> tuple:
        return tuple(dict.fromkeys(p.object for p in self.polygons))

    def rho_d(self, group) -> tuple:
        """Diffuse reflectance per channel; a lamp reflects only what `reference` says."""
        return tuple(self.materials.get(group, self.reference.get(group, (0.0, 0.0, 0.0))))

    def surface(self, group) -> Surface:
        return self.surfaces.get(group, Surface())

    def mirrors(self) -> list:
        """The polygons that reflect perfectly, one per group of that kind."""
        out = [p for p in self.polygons if self.surface(p.group).kind in ("mirror", "coloured_mirror")]
        if len({p.group for p in out}) < len(out):
            raise ValueError("a group of mirrors must be one polygon")
        return out

    def project(self, p_world) -> np.ndarray:
        """(N, 3) m -> (N, 2) px; (0, 0) is the centre of the top-left pixel."""
        p_cam = np.asarray(p_world) @ self.T_cam_world[:3, :3].T + self.T_cam_world[:3, 3]
        q = p_cam @ self.K.T
        return q[:, :2] / q[:, 2:]

    def model(self) -> tuple:
        """(text of model.obj, text of model.mtl)."""
        lines, vertices, usemtl = [f"# {self.name}: made by stages/synthesise.py; metres, z up", "mtllib model.mtl"], {}, None
        for name in self.objects:
            lines.append(f"o {name}")
            usemtl = None
            for polygon in (p for p in self.polygons if p.object == name):
                corners = [tuple(f"{x:.6f}".replace("-0.000000", "0.000000") for x in p) for p in polygon.points]
                for corner in corners:
                    if corner not in vertices:
                        vertices[corner] = len(vertices) + 1
                        lines.append("v " + " ".join(corner))
                if polygon.group != usemtl:
                    usemtl = polygon.group
                    lines.append(f"usemtl {usemtl}")
                lines.append("f " + " ".join(str(vertices[c]) for c in corners))
        # The .mtl names the groups and gives each a colour to look at; it is not the truth.
        mtl = []
        for i, group in enumerate(self.groups):
            hue = np.array([0.0, 2.1, 4.2]) + 2.4 * i
            kd = np.ones(3) if group in self.lamps else 0.6 + 0.25 * np.cos(hue)
            mtl += [f"newmtl {group}", "Kd " + " ".join(f"{x:.3f}" for x in kd)]
        return "\n".join(lines) + "\n", "\n".join(mtl) + "\n"

    def cameramodel(self) -> str:
        """The left camera as a pinhole, extrinsics relative to the model's frame."""
        return cameramodel((self.K[0, 0], self.K[1, 1], self.K[0, 2], self.K[1, 2]), self.T_cam_world, self.size)

    def views(self) -> dict:
        """{"left": (lens, T_cam_world), "right": ...} of a stereo scene."""
        return {"left": (self.pair.lenses[0], self.T_cam_world), "right": (self.pair.lenses[1], self.pair.T_right_left @ self.T_cam_world)}

    def pair_files(self) -> dict:
        """{path: text} of a stereo scene's camera models: those that are given, and the true ones."""
        T_refs = self.pair.T_left_ref, self.pair.T_right_left @ self.pair.T_left_ref
        out = {}
        for (side, (lens, T)), T_ref in zip(self.views().items(), T_refs):
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
        return "\n".join(lines) + "\n"


def make(name) -> Recipe:
    """The recipe of one scene.  Raises KeyError for a name that is in none of `NAMES`, `STEREO_NAMES` and `KIND_NAMES`."""
    return (_RECIPES | _STEREO | _KINDS)[name]()


# ---- geometry ----------------------------------------------------------------------------------------------

def rectangle(object, group, corner, u, v) -> Polygon:
    """The parallelogram corner, corner + u, corner + u + v, corner + v; its front is where u x v points."""
    c, u, v = (np.asarray(x, float) for x in (corner, u, v))
    return Polygon(object, group, np.array([c, c + u, c + u + v, c + v]))


def prism(object, group, outline, z0, z1, *, top=None, sides=None) -> list:
    """A closed prism over a convex outline (n, 2), counter-clockwise seen from above.

    `top` and `sides[i]` (the side that starts at corner i) may belong to other groups."""
    xy, n, sides = np.asarray(outline, float), len(outline), sides or {}
    low, high = np.c_[xy, np.full(n, z0)], np.c_[xy, np.full(n, z1)]
    faces = [Polygon(object, group, low[::-1]), Polygon(object, top or group, high)]
    for i in range(n):
        j = (i + 1) % n
        faces.append(Polygon(object, sides.get(i, group), np.array([low[i], low[j], high[j], high[i]])))
    return faces


def box(object, group, low, high, *, turn=0.0, **groups) -> list:
    """A closed box between two corners, turned about its own vertical axis by `turn` radians.

    Other groups: `top=`, or `sides={i: group}` with i = 0 the side at -y, 1 at +x, 2 at +y, 3 at -x."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    outline = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
    if turn:
        c, s, middle = np.cos(turn), np.sin(turn), outline.mean(0)
        outline = (outline - middle) @ np.array([[c, s], [-s, c]]) + middle
    return prism(object, group, outline, z0, z1, **groups)


def regular(centre, radius, n, start=0.0) -> np.ndarray:
    """Corners of a regular polygon, counter-clockwise: (n, 2)."""
    a = start + 2 * np.pi * np.arange(n) / n
    return np.asarray(centre) + radius * np.c_[np.cos(a), np.sin(a)]


def room(x, y, z, walls=("wall",) * 4) -> list:
    """Floor, ceiling and four walls (at y = 0, x = x, y = y, x = 0) as single polygons that face inwards."""
    return [
        rectangle("floor", "floor", (0, 0, 0), (x, 0, 0), (0, y, 0)),
        rectangle("ceiling", "ceiling", (0, 0, z), (0, y, 0), (x, 0, 0)),
        rectangle("walls", walls[0], (0, 0, 0), (0, 0, z), (x, 0, 0)),
        rectangle("walls", walls[1], (x, 0, 0), (0, 0, z), (0, y, 0)),
        rectangle("walls", walls[2], (x, y, 0), (0, 0, z), (-x, 0, 0)),
        rectangle("walls", walls[3], (0, y, 0), (0, 0, z), (0, -y, 0)),
    ]


def lamp(object, group, centre, size_x, size_y, z) -> Polygon:
    """A panel that shines downwards."""
    x, y = centre[0] - size_x / 2, centre[1] - size_y / 2
    return rectangle(object, group, (x, y, z), (0, size_y, 0), (size_x, 0, 0))


# ---- camera ------------------------------------------------------------------------------------------------

def look(eye, target, up=(0, 0, 1)) -> np.ndarray:
    """T_cam_world (4, 4) of a camera at `eye`: x right, y down, z towards `target`."""
    eye, target, up = (np.asarray(v, float) for v in (eye, target, up))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = right, np.cross(forward, right), forward
    T[:3, 3] = -T[:3, :3] @ eye
    return T


def pinhole(width, height, focal_px, shift=(0.0, 0.0)) -> np.ndarray:
    """K with square pixels; the principal point `shift` px from the image's centre."""
    return np.array([[focal_px, 0, (width - 1) / 2 + shift[0]], [0, focal_px, (height - 1) / 2 + shift[1]], [0, 0, 1.0]])


def cameramodel(intrinsics, T_cam_ref, size) -> str:
    """mrcal's text format; four intrinsics are a pinhole's, twelve LENSMODEL_OPENCV8's."""
    model, names, frame = {4: ("PINHOLE", "fx,fy,cx,cy", "rt_cam_world"), 12: ("OPENCV8", "fx,fy,cx,cy,k1,k2,p1,p2,k3,k4,k5,k6", "rt_cam_ref")}[len(intrinsics)]
    numbers = lambda xs: ", ".join(f"{x:.15g}" for x in xs)
    return ("{\n"
            f"    'lensmodel':  'LENSMODEL_{model}',\n\n"
            f"    # intrinsics are {names}\n"
            f"    'intrinsics': [ {numbers(intrinsics)} ],\n\n"
            f"    # {frame}: a Rodrigues vector, then a translation in metres\n"
            f"    'extrinsics': [ {numbers([*rodrigues(T_cam_ref[:3, :3]), *T_cam_ref[:3, 3]])} ],\n\n"
            f"    'imagersize': [ {size[0]}, {size[1]} ],\n"
            "}\n")


def rodrigues(R) -> np.ndarray:
    """Rotation matrix -> axis * angle (3,); angles below pi."""
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = np.linalg.norm(axis) / 2, (np.trace(R) - 1) / 2
    if sine < 1e-9:                       # none of our cameras is turned by pi
        return axis / 2
    return axis / (2 * sine) * np.arctan2(sine, cosine)


def exposed(polygons, materials, lamps, level) -> float:
    """The factor on `lamps` that puts the mean radiosity of the room near `level`: the flux balance
    mean B = rho Phi / (S (1 - rho)) with area means (DESIGN: flux balance).  Rounded to two digits: an exposure, no more."""
    def area(p):
        e = p.points - p.points[0]
        return np.linalg.norm(np.cross(e[1:-1], e[2:]).sum(0)) / 2
    S = sum(area(p) for p in polygons if p.group in materials)
    rho = sum(area(p) * np.mean(materials[p.group]) for p in polygons if p.group in materials) / S
    flux = sum(area(p) * np.mean(lamps[p.group]) for p in polygons if p.group in lamps)
    return float(f"{level * S * (1 - rho) / (rho * flux):.2g}")


def scaled(E, tint) -> tuple:
    return tuple(round(float(E * t), 4) for t in tint)


# ---- scenes ------------------------------------------------------------------------------------------------

_OFFICE = {
    "wall": (.72, .69, .62), "floor": (.38, .30, .23), "ceiling": (.80, .80, .77), "board": (.08, .17, .12),
    "frame": (.52, .36, .18), "desktop": (.58, .42, .26), "deskpanel": (.30, .34, .42), "cabinet": (.47, .50, .52),
    "door": (.55, .22, .16), "chair": (.16, .22, .46), "monitor": (.09, .10, .14),
    "partition": (.36, .56, .50), "carton": (.60, .45, .28), "bin": (.62, .60, .20), "book": (.60, .12, .10),
    "poster": (.66, .62, .34),
}


def office(seed=0) -> Recipe:
    """The paper's kind of room, 5 x 4 x 2.8 m, seen from its near corner.

    The partition is one polygon whose near side faces away from the lamp, so only indirect light reaches what the
    camera sees of it.  Seeds 1-3 change materials, gamma, camera and lamp, and keep the furniture."""
    random = np.random.default_rng([7, seed])
    materials = dict(_OFFICE)
    lamp_at, lamp_size, tint, gamma = (2.95, 2.05), (1.2, 0.7), (1.0, .96, .88), 2.0
    eye, target, focal, shift, level = np.array([.40, 1.0, 1.55]), np.array([4.0, 2.68, 1.28]), 400.0, (0.0, 0.0), .24
    if seed:
        for group, rho in materials.items():       # each channel moves by itself, so colours change too
            low, high = (.04, .22) if group in ("board", "monitor") else (.55, .85) if group in ("wall", "ceiling") else (.08, .72)
            mixed = np.array(rho) + random.uniform(-.14, .14) + random.uniform(-.10, .10, 3)
            materials[group] = tuple(np.round(np.clip(mixed, low, high), 3))
        gamma = (None, 1.6, 2.6, 2.23)[seed]
        lamp_at = (random.uniform(2.7, 3.3), random.uniform(1.7, 2.4))
        lamp_size = (random.uniform(.5, 1.5), random.uniform(.4, 1.0))
        tint = tuple(np.round((1.0, random.uniform(.85, 1.0), random.uniform(.7, 1.0)), 3))
        eye = eye + random.uniform(-.18, .18, 3)
        target = target + random.uniform(-.2, .2, 3) * (1, 1, .6)
        focal = random.uniform(385, 425)
        shift = ((0, 0), (7.3, -4.6), (0, 0), (-11.2, 5.4))[seed]
        level = random.uniform(.18, .26)

    x, y, z = 5.0, 4.0, 2.8
    p = room(x, y, z)
    # the blackboard touches the wall; its frame is four bars around it, a little thicker
    p += box("board", "board", (2.15, 3.97, .95), (3.55, 4.0, 1.95))
    p += box("frame", "frame", (2.09, 3.955, .89), (3.61, 4.0, .95))
    p += box("frame-top", "frame", (2.09, 3.955, 1.95), (3.61, 4.0, 2.01))
    p += box("frame-left", "frame", (2.09, 3.955, .95), (2.15, 4.0, 1.95))
    p += box("frame-right", "frame", (3.55, 3.955, .95), (3.61, 4.0, 1.95))
    # cabinet against the wall; its door is a plate on the front
    p += box("cabinet", "cabinet", (3.95, 3.5, 0), (4.8, 4.0, 1.6))
    p += box("door", "door", (3.99, 3.47, .08), (4.76, 3.5, 1.52))
    # desk against the wall x = 5
    p += box("desktop", "desktop", (4.0, 1.25, .72), (5.0, 2.95, .76))
    p += box("desk-left", "deskpanel", (4.1, 2.85, 0), (5.0, 2.9, .72))
    p += box("desk-right", "deskpanel", (4.1, 1.3, 0), (5.0, 1.35, .72))
    p += box("desk-back", "deskpanel", (4.9, 1.35, .25), (4.95, 2.85, .72))
    p += box("monitor", "monitor", (4.55, 1.75, .80), (4.62, 2.45, 1.25))
    p += box("stand", "monitor", (4.48, 1.98, .76), (4.7, 2.22, .80))
    p += box("book", "book", (4.1, 2.44, .76), (4.4, 2.84, .92), turn=.2)
    # chair: a seat, a back and two runners
    p += box("seat", "chair", (3.45, 1.75, .43), (3.95, 2.25, .48))
    p += box("chair-back", "chair", (3.45, 1.78, .48), (3.49, 2.22, .95))
    p += box("runner-left", "chair", (3.45, 2.19, 0), (3.95, 2.24, .43))
    p += box("runner-right", "chair", (3.45, 1.76, 0), (3.95, 1.81, .43))
    # things on the floor
    p += box("carton", "carton", (2.35, 2.55, 0), (2.85, 2.95, .36), turn=.5)
    p += box("carton-2", "carton", (2.45, 2.6, .36), (2.75, 2.85, .56), turn=-.2)
    p += prism("bin", "bin", regular((4.45, .85), .15, 6, .2), 0, .36)
    p += box("poster", "poster", (4.985, 3.05, 1.2), (5.0, 3.45, 1.75))
    p += [rectangle("partition", "partition", (1.9, 0, 0), (0, .78, 0), (0, 0, 1.35))]
    p += [lamp("lamp", "lamp", lamp_at, *lamp_size, z - .05)]

    E = exposed(p, materials, {"lamp": tint}, level)
    about = "An office: the paper's kind of room" + (f", seed {seed}" if seed else "") + "; the lamp's emittance is known"
    return Recipe(f"office-{seed}" if seed else "office", tuple(p), materials, {"lamp": scaled(E, tint)}, gamma,
                  pinhole(640, 480, focal, shift), (640, 480), look(eye, target), about=about)


def gallery_white() -> Recipe:
    """An exhibition room where everything reflects 0.70 to 0.90: the printed update diverges here."""
    materials = {"floor": (.76, .73, .70), "ceiling": (.90, .90, .89), "wall": (.86, .86, .85), "panel": (.88, .84, .80),
                 "stele": (.80, .84, .88), "plinth": (.84, .80, .78), "bench": (.78, .72, .70), "divider": (.82, .86, .80)}
    x, y, z = 7.0, 5.5, 3.4
    p = room(x, y, z)
    p += box("panel-1", "panel", (2.6, 5.46, 1.0), (3.9, 5.5, 2.1))
    p += box("panel-2", "panel", (4.6, 5.46, 1.0), (5.9, 5.5, 2.1))
    p += box("panel-3", "panel", (6.96, 2.2, .9), (7.0, 3.6, 2.2))
    p += box("plinth-1", "plinth", (3.1, 3.3, 0), (3.6, 3.8, 1.05))
    p += prism("stele", "stele", regular((5.2, 3.9), .35, 6, .1), 0, 1.5)
    p += box("plinth-2", "plinth", (4.6, 1.4, 0), (5.2, 2.0, .7), turn=.35)
    p += box("bench", "bench", (2.3, 2.1, .38), (3.9, 2.55, .46))
    p += box("bench-leg-1", "bench", (2.4, 2.15, 0), (2.5, 2.5, .38))
    p += box("bench-leg-2", "bench", (3.7, 2.15, 0), (3.8, 2.5, .38))
    p += box("divider", "divider", (5.9, 0, 0), (6.05, 1.5, 2.4))
    p += [lamp("lamp-1", "lamp", (2.6, 2.7), 1.6, .5, z - .06), lamp("lamp-2", "lamp", (4.8, 2.7), 1.6, .5, z - .06)]
    E = exposed(p, materials, {"lamp": (1, 1, 1)}, .40)
    return Recipe("gallery-white", tuple(p), materials, {"lamp": (E, E, E)}, 2.2, pinhole(640, 480, 405), (640, 480),
                  look((.5, .8, 1.6), (4.6, 3.1, 1.45)), about="An exhibition room, everything nearly white; the lamps' emittance is known")


# Measured spectra seen by a camera: see `cornell_channels`; rounded.
CORNELL = {"white": (.7376, .7366, .7433), "green": (.1683, .3231, .2051), "red": (.3781, .1020, .0666)}
CORNELL_LAMP = (.9092, 1.0, .9934)


def cornell_channels() -> dict:
    """The Cornell box's measured spectra as three linear channels, with colour-science (only this function needs it).

    A channel is what the Nikon D5100 (sensitivities by NPL, in colour-science) sees under the box's own lamp:
    rho_c = sum(s_c e rho) / sum(s_c e) over 400, 404 ... 700 nm, s_c the sensitivity, e the emission (linear between its
    four samples).  The camera is balanced for illuminant A, and the lamp's green is 1: lamp_c = sum(s_c e) / sum(s_c A)."""
    import colour
    data = ROOT / "data" / "cornell-box-measured"
    shape = colour.SpectralShape(400, 700, 4)
    paint = np.genfromtxt(data / "reflectance_400_700_4nm.csv", delimiter=",", names=True)
    light = np.genfromtxt(data / "light_emission.csv", delimiter=",", names=True)
    e = colour.SpectralDistribution(light["emission_relative"], light["nm"])
    e = e.interpolate(shape, interpolator=colour.LinearInterpolator).values
    s = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"].copy().align(shape).values
    A = colour.SDS_ILLUMINANTS["A"].copy().align(shape).values
    seen = s * e[:, None]
    channels = {g: (seen * paint[g][:, None]).sum(0) / seen.sum(0) for g in CORNELL}
    balanced = seen.sum(0) / (s * A[:, None]).sum(0)
    return {**channels, "light": balanced / balanced[1]}


def cornell() -> Recipe:
    """The measured Cornell box, mm -> m and turned so that z is up: (x, y, z) -> (-x, z, y).

    The lamp lies in the plane of the ceiling, and the ceiling is four quads around it.  The measured red wall is 3 mm from
    planar: two triangles.  The open front is black."""
    numbers = json.loads((ROOT / "data" / "cornell-box-measured" / "geometry_camera.json").read_text())
    metres = lambda points: np.array([(-x, z, y) for x, y, z in np.asarray(points, float)]) / 1000

    def towards(object, group, points, inside):
        """The polygon, turned so that its front sees the point `inside`."""
        n = np.cross(points[1] - points[0], points[2] - points[0])
        return Polygon(object, group, points if n @ (inside - points[0]) > 0 else points[::-1])

    centre = metres([[278, 274, 280]])[0]
    wall = lambda name, group, key: towards(name, group, metres(numbers[key]), centre)
    hole, outer = metres(numbers["light"]["quad"]), metres(numbers["ceiling"])
    p = [wall("floor", "white", "floor"), wall("back", "white", "back"),
         wall("right", "green", "right_green")]
    red = metres(numbers["left_red"])
    p += [towards("left", "red", red[[0, 1, 2]], centre), towards("left", "red", red[[0, 2, 3]], centre)]
    # Around the hole: pair each corner of the lamp with the ceiling's nearest corner.
    nearest = [int(np.argmin(np.linalg.norm(outer - h, axis=1))) for h in hole]
    for i in range(4):
        j = (i + 1) % 4
        p.append(towards("ceiling", "white", np.array([outer[nearest[i]], outer[nearest[j]], hole[j], hole[i]]), centre))
    for name in ("short_block", "tall_block"):
        top = metres(numbers[name + "_top"])
        turned = np.cross(top[1] - top[0], top[2] - top[0])[2] > 0
        p += prism(name.replace("_", "-"), "white", (top if turned else top[::-1])[:, :2], 0, top[0, 2])
    p.append(towards("light", "light", hole, centre))
    # Their camera: film 0.025 at focal length 0.035, seen from 0.8 m before the box.
    width = height = 400
    eye = metres([numbers["camera"]["position"]])[0]
    E = scaled(45.0, CORNELL_LAMP)
    return Recipe("cornell", tuple(p), dict(CORNELL), {"light": E}, 2.2, pinhole(width, height, width * .035 / .025), (width, height),
                  look(eye, eye + (0, 1, 0)), reference={"light": (.78, .78, .78)},
                  about="The measured Cornell box; its lamp's emittance and reflectance are known")


def flat_grey() -> Recipe:
    """A small grey room, one channel."""
    grey = {"wall": .62, "floor": .33, "ceiling": .78, "shelf": .48, "crate": .22, "pillar": .70, "plate": .12}
    materials = {g: (v, v, v) for g, v in grey.items()}
    x, y, z = 4.0, 3.2, 2.5
    p = room(x, y, z)
    p += box("shelf", "shelf", (2.0, 2.85, 1.05), (3.3, 3.2, 1.12))
    p += box("shelf-2", "shelf", (2.0, 2.85, .5), (3.3, 3.2, .57))
    p += box("crate", "crate", (2.4, 1.5, 0), (2.95, 2.0, .5), turn=.4)
    p += prism("pillar", "pillar", regular((3.4, 1.0), .2, 8), 0, 2.5)
    p += box("plate", "plate", (3.96, 1.6, .8), (4.0, 2.7, 1.6))
    p += [lamp("lamp", "lamp", (2.2, 1.5), .8, .8, z - .04)]
    E = exposed(p, materials, {"lamp": (1, 1, 1)}, .22)
    return Recipe("flat-grey", tuple(p), materials, {"lamp": (E, E, E)}, 2.2, pinhole(480, 360, 300), (480, 360),
                  look((.35, .45, 1.45), (3.2, 2.2, 1.2)), channels=1, about="A grey room, one channel; the lamp's emittance is known")


def linear() -> Recipe:
    """A loft with a sloping ceiling: a linear photograph in which the lamps are brighter than white."""
    materials = {"wall": (.64, .62, .58), "brick": (.46, .24, .17), "floor": (.42, .34, .26), "ceiling": (.78, .77, .74), "beam": (.30, .20, .12),
                 "bench": (.24, .38, .30), "chest": (.20, .26, .42), "door": (.62, .55, .40), "rug": (.48, .14, .16)}
    x, y, low, high = 6.0, 3.4, 2.1, 3.1           # the ceiling rises from y = 0 to y = y
    a, b, c, d = (0, 0), (x, 0), (x, y), (0, y)
    P = lambda *points: np.array(points, float)
    p = [Polygon("floor", "floor", P((*a, 0), (*b, 0), (*c, 0), (*d, 0))),
         Polygon("ceiling", "ceiling", P((*a, low), (*d, high), (*c, high), (*b, low))),
         Polygon("walls", "wall", P((*a, 0), (*a, low), (*b, low), (*b, 0))),
         Polygon("walls", "brick", P((*b, 0), (*b, low), (*c, high), (*c, 0))),
         Polygon("walls", "wall", P((*c, 0), (*c, high), (*d, high), (*d, 0))),
         Polygon("walls", "wall", P((*d, 0), (*d, high), (*a, low), (*a, 0)))]
    p += box("post-1", "beam", (2.3, 2.5, 0), (2.45, 2.65, 2.75))       # posts end below the ceiling, under a beam
    p += box("post-2", "beam", (4.3, 2.5, 0), (4.45, 2.65, 2.6))
    p += box("beam", "beam", (0, .9, 2.15), (6, 1.05, 2.3))
    p += box("bench", "bench", (3.0, 3.0, 0), (4.6, 3.4, .45))
    p += box("chest", "chest", (4.9, .3, 0), (5.5, 1.0, .55), turn=-.25)
    p += box("door", "door", (5.96, 1.5, 0), (6.0, 2.4, 2.0))
    p += box("rug", "rug", (2.7, 1.1, 0), (4.4, 2.2, .015))
    p += [lamp("lamp-1", "lamp", (2.6, 1.9), .5, .3, 2.5), lamp("lamp-2", "spot", (4.8, 2.0), .35, .35, 2.5)]
    E = exposed(p, materials, {"lamp": (1.0, .93, .80), "spot": (1.2, 1.2, 1.3)}, .20)
    lamps = {"lamp": scaled(E, (1.0, .93, .80)), "spot": scaled(E, (1.2, 1.2, 1.3))}
    return Recipe("linear", tuple(p), materials, lamps, None, pinhole(640, 480, 410), (640, 480), look((.35, .75, 1.6), (4.6, 2.1, 1.2)),
                  about="A loft photographed linearly; two lamps of known emittance")


# ---- scenes that are more than diffuse ---------------------------------------------------------------------

def on_wall(object, front, edge, wall, along, z, thickness) -> list:
    """A flat closed box that hangs on a wall: its front face is one group, its sides and back another.

    wall: ("x", 5.0, -1) is the plane x = 5, whose room lies towards -x; along, z: (low, high) m."""
    axis, at, side = wall
    a, b = sorted((at, at + side * thickness))
    low, high = ((a, along[0], z[0]), (b, along[1], z[1])) if axis == "x" else ((along[0], a, z[0]), (along[1], b, z[1]))
    return box(object, edge, low, high, sides={{("x", -1): 3, ("x", 1): 1, ("y", -1): 0, ("y", 1): 2}[axis, side]: front})


def framed(object, front, edge, wall, along, z, thickness, width=.05) -> list:
    """The same within a frame of four bars, half as thick again."""
    (a, b), (c, d), thick = along, z, 1.5 * thickness
    bars = (("bottom", (a - width, b + width), (c - width, c)), ("top", (a - width, b + width), (d, d + width)), ("left", (a - width, a), z), ("right", (b, b + width), z))
    out = on_wall(object, front, edge, wall, along, z, thickness)
    for name, *span in bars:
        out += on_wall(f"{object}-{name}", edge, edge, wall, *span, thick)
    return out


def brightness(materials, surfaces) -> dict:
    """group -> rho_d + rho_s: all that is reflected, for `exposed`."""
    return {g: np.add(rho, surfaces[g].rho_s if g in surfaces else 0) for g, rho in materials.items()}


_HALL = {
    "wall": (.70, .68, .63), "floor": (.36, .29, .23), "ceiling": (.79, .79, .77), "frame": (.44, .29, .16), "desktop": (.56, .42, .27),
    "deskpanel": (.28, .32, .40), "monitor": (.08, .09, .12), "book": (.58, .13, .11), "chair": (.17, .24, .44), "cabinet": (.46, .49, .51),
    "door": (.53, .24, .17), "carton": (.59, .45, .29), "bin": (.60, .58, .21), "rug": (.44, .16, .17), "poster": (.64, .60, .33),
    "curtain": (.24, .42, .30), "bookcase": (.40, .22, .10), "books": (.62, .52, .18),
}


def office_mirror() -> Recipe:
    """An office with a perfect mirror over the desk.  Curtain, bookcase and books are seen in it alone."""
    materials = dict(_HALL) | {"mirror": (0., 0., 0.)}
    surfaces = {"mirror": Surface("mirror", (1., 1., 1.))}
    x, y, z = 5.0, 4.0, 2.8
    p = room(x, y, z)
    p += framed("mirror", "mirror", "frame", ("x", x, -1), (1.74, 3.08), (1.08, 2.01), .03)
    p += box("desktop", "desktop", (4.25, 1.25, .72), (5.0, 2.95, .76))
    p += box("desk-left", "deskpanel", (4.3, 2.85, 0), (5.0, 2.9, .72))
    p += box("desk-right", "deskpanel", (4.3, 1.3, 0), (5.0, 1.35, .72))
    p += box("desk-back", "deskpanel", (4.9, 1.35, .25), (4.95, 2.85, .72))
    p += box("monitor", "monitor", (4.62, 1.30, .80), (4.69, 1.84, 1.16), turn=-.15)
    p += box("stand", "monitor", (4.55, 1.46, .76), (4.76, 1.68, .80))
    p += box("book", "book", (4.35, 2.45, .76), (4.6, 2.83, .92), turn=.25)
    p += box("seat", "chair", (3.62, 1.95, .43), (4.1, 2.43, .48))
    p += box("chair-back", "chair", (3.62, 1.98, .48), (3.66, 2.40, .95))
    p += box("runner-left", "chair", (3.62, 2.37, 0), (4.1, 2.42, .43))
    p += box("runner-right", "chair", (3.62, 1.96, 0), (4.1, 2.01, .43))
    p += box("cabinet", "cabinet", (4.05, 3.5, 0), (4.85, 4.0, 1.6))
    p += box("door", "door", (4.09, 3.47, .08), (4.81, 3.5, 1.52))
    p += box("carton", "carton", (3.2, 2.85, 0), (3.65, 3.22, .34), turn=.5)
    p += prism("bin", "bin", regular((4.55, .9), .15, 6, .2), 0, .36)
    p += box("rug", "rug", (3.35, 1.0, 0), (4.15, 1.7, .012), turn=.1)
    p += box("poster", "poster", (4.985, .45, 1.2), (5.0, .85, 1.75))
    p += box("curtain", "curtain", (0, 2.35, .15), (.06, 3.75, 2.4))                     # from here on: behind the camera
    p += box("bookcase", "bookcase", (1.0, 3.68, 0), (1.95, 4.0, 1.9), sides={0: "books"})
    p += [lamp("lamp", "lamp", (2.35, 2.05), 1.2, .7, z - .05)]
    tint = (1.0, .96, .88)
    E = exposed(p, brightness(materials, surfaces), {"lamp": tint}, .24)
    return Recipe("office-mirror", tuple(p), materials, {"lamp": scaled(E, tint)}, 2.15, pinhole(640, 480, 415), (640, 480),
                  look((1.72, 1.17, 1.58), (5.0, 2.27, 1.12)), surfaces=surfaces, about="An office with a mirror over the desk; the lamp's emittance is known")


_PARLOUR = {
    "wall": (.66, .70, .68), "floor": (.42, .31, .20), "ceiling": (.82, .81, .78), "frame": (.20, .15, .12), "sideboard": (.36, .22, .13), "drawer": (.50, .34, .20),
    "vase": (.20, .36, .52), "sofa": (.50, .20, .16), "cushion": (.66, .56, .24), "table": (.46, .36, .25), "tray": (.14, .30, .20), "shelf": (.58, .56, .52),
    "picture": (.30, .22, .40), "rug": (.26, .30, .44), "pot": (.55, .33, .22), "wardrobe": (.22, .32, .26), "curtain": (.62, .28, .30),
}


def office_coloured_mirror() -> Recipe:
    """A parlour with a gold-coloured mirror over the sideboard.  Wardrobe and curtain are seen in it alone."""
    gold = (.88, .72, .50)
    materials = dict(_PARLOUR) | {"mirror": (0., 0., 0.)}
    surfaces = {"mirror": Surface("coloured_mirror", gold)}
    x, y, z = 4.6, 4.2, 2.7
    p = room(x, y, z)
    p += framed("mirror", "mirror", "frame", ("y", y, -1), (2.42, 3.42), (.92, 2.18), .03)
    p += box("sideboard", "sideboard", (2.25, 3.78, 0), (3.65, 4.2, .70))
    p += box("drawer-1", "drawer", (2.30, 3.755, .38), (2.92, 3.78, .64))
    p += box("drawer-2", "drawer", (2.98, 3.755, .38), (3.60, 3.78, .64))
    p += prism("vase", "vase", regular((2.42, 3.98), .09, 8, .2), .70, 1.02)
    p += box("sofa", "sofa", (.25, 2.55, 0), (1.95, 3.3, .40))
    p += box("sofa-back", "sofa", (.25, 3.3, 0), (1.95, 3.5, .85))
    p += box("cushion", "cushion", (1.30, 2.85, .40), (1.72, 3.28, .54), turn=.3)
    p += box("table", "table", (2.28, 2.35, .38), (3.12, 2.85, .42), turn=.12)
    p += box("table-leg-1", "table", (2.36, 2.42, 0), (2.42, 2.72, .38), turn=.12)
    p += box("table-leg-2", "table", (2.98, 2.48, 0), (3.04, 2.78, .38), turn=.12)
    p += box("tray", "tray", (2.55, 2.5, .42), (2.85, 2.72, .45), turn=.5)
    p += box("shelf", "shelf", (4.22, 3.1, 0), (4.6, 4.0, 1.45))
    p += box("picture", "picture", (1.0, 4.17, 1.35), (1.65, 4.2, 1.85))
    p += box("rug", "rug", (1.9, 1.75, 0), (3.5, 3.05, .012), turn=-.06)
    p += prism("pot", "pot", regular((3.92, 2.75), .16, 8, .1), 0, .42)
    p += box("wardrobe", "wardrobe", (2.95, 0, 0), (3.85, .55, 2.0))                     # from here on: behind the camera
    p += box("curtain", "curtain", (4.54, .62, .1), (4.6, 1.5, 2.35))
    p += [lamp("lamp", "lamp", (2.35, 2.1), 1.2, .8, z - .05)]
    tint = (1.0, .95, .86)
    E = exposed(p, brightness(materials, surfaces), {"lamp": tint}, .20)
    return Recipe("office-coloured-mirror", tuple(p), materials, {"lamp": scaled(E, tint)}, 1.85, pinhole(640, 480, 410), (640, 480),
                  look((2.05, .98, 1.52), (2.72, 4.2, 1.08)), surfaces=surfaces, about="A parlour with a gold-coloured mirror; the lamp's emittance is known")


_DESK = {
    "wall": (.62, .60, .55), "panel": (.28, .38, .50), "floor": (.46, .40, .34), "ceiling": (.78, .78, .76), "desktop": (.25, .14, .08), "apron": (.34, .20, .11),
    "book": (.60, .14, .11), "book-2": (.16, .34, .24), "pot": (.62, .46, .20), "screen": (.09, .10, .13), "paper": (.74, .73, .70), "shelf": (.52, .40, .25),
    "carton": (.20, .28, .50),
}


def study() -> list:
    """A desk at the end of a small room, its top at z = .74, and what stands on it."""
    x, y, z = 5.0, 3.6, 2.7
    p = room(x, y, z)
    p += box("desk", "apron", (2.70, .8, .64), (3.70, 2.7, .74), top="desktop")
    p += box("desk-foot-1", "apron", (2.95, .9, 0), (3.6, .98, .64))
    p += box("desk-foot-2", "apron", (2.95, 2.52, 0), (3.6, 2.6, .64))
    p += box("panel", "panel", (4.97, .35, .25), (5.0, 1.55, 1.45))
    p += box("shelf", "shelf", (4.65, 1.85, .86), (5.0, 3.4, .9))
    p += box("shelf-carton", "carton", (4.7, 2.6, .9), (4.97, 3.05, 1.1))
    p += box("screen", "screen", (3.50, 1.08, .78), (3.55, 1.66, 1.12), turn=-.22)
    p += box("screen-foot", "screen", (3.43, 1.29, .74), (3.61, 1.45, .78), turn=-.22)
    p += box("book", "book", (3.26, 2.30, .74), (3.54, 2.64, .80), turn=.3)
    p += box("book-2", "book-2", (3.31, 2.34, .80), (3.50, 2.60, .86), turn=.12)
    return p


def desk_glossy() -> Recipe:
    """A varnished desk top, which shows the lamp as a broad highlight and what stands on it as a blur; a tin of narrower gloss."""
    materials = dict(_DESK) | {"tin": (.10, .10, .10)}
    surfaces = {"desktop": Surface("glossy", (.12, .12, .12), (.10, .10)), "tin": Surface("glossy", (.35, .35, .35), (.05, .05))}
    p = study()
    p += prism("pot", "pot", regular((3.40, 1.98), .08, 8, .15), .74, .94)
    p += box("paper", "paper", (2.86, 1.02, .74), (3.07, 1.32, .744), turn=.3)
    p += box("tin", "tin", (2.78, 1.66, .74), (2.98, 1.96, .82), turn=-.35)
    p += [lamp("lamp", "lamp", (4.15, 1.85), 1.2, .9, 2.6)]
    tint = (1.0, .95, .87)
    E = exposed(p, brightness(materials, surfaces), {"lamp": tint}, .17)
    return Recipe("desk-glossy", tuple(p), materials, {"lamp": scaled(E, tint)}, 2.3, pinhole(640, 480, 500), (640, 480),
                  look((1.93, 1.42, 1.66), (3.30, 1.80, .72)), surfaces=surfaces, about="A glossy desk top and a tin; the lamp's emittance is known")


def desk_brushed() -> Recipe:
    """A plate of brushed metal on the desk: its highlight is drawn out across the brushing, at 25 degrees to the desk's edge."""
    a = np.radians(25)
    materials = dict(_DESK) | {"plate": (.08, .08, .08), "desktop": (.50, .38, .24)}
    surfaces = {"plate": Surface("glossy", (.45, .43, .40), (.28, .07), (float(np.cos(a)), float(np.sin(a)), 0.0))}
    p = study()
    p += box("plate", "apron", (2.78, 1.12, .74), (3.36, 2.02, .752), top="plate")
    p += prism("pot", "pot", regular((3.24, 1.78), .07, 8, .15), .752, .93)
    p += box("paper", "paper", (2.86, 2.18, .74), (3.07, 2.48, .744), turn=.3)
    p += [lamp("lamp", "lamp", (4.05, 1.95), 1.3, 1.1, 2.6)]
    tint = (1.0, .97, .92)
    E = exposed(p, brightness(materials, surfaces), {"lamp": tint}, .085)
    return Recipe("desk-brushed", tuple(p), materials, {"lamp": scaled(E, tint)}, 2.0, pinhole(640, 480, 500), (640, 480),
                  look((1.93, 1.36, 1.66), (3.30, 1.74, .72)), surfaces=surfaces, about="A plate of brushed metal on a desk; the lamp's emittance is known")


_GLYPHS = {           # rows of five, from the top
    "R": "11110 10001 10001 11110 10100 10010 10001", "A": "01110 10001 10001 11111 10001 10001 10001", "D": "11110 10001 10001 10001 10001 10001 11110",
    "I": "01110 00100 00100 00100 00100 00100 01110", "O": "01110 10001 10001 10001 10001 10001 01110", "S": "01111 10000 10000 01110 00001 00001 11110",
    "T": "11111 00100 00100 00100 00100 00100 00100", "Y": "10001 10001 01010 00100 00100 00100 00100",
}


@functools.cache
def poster_image(width=420, height=300, fine=4) -> np.ndarray:
    """(height, width, 3) reflectances of a printed poster: a soft photograph, letters, figures, stripes.  Drawn `fine` times as large, then averaged."""
    random = np.random.default_rng(23)
    y, x = np.mgrid[:height * fine, :width * fine] + .5
    x, y = x / fine, y / fine                                     # px
    out = np.array([.34, .40, .46]) + np.zeros((*x.shape, 3))
    for _ in range(9):                                            # the photograph: soft blobs of colour
        at, size, colour = random.uniform((0, 0), (width, height)), random.uniform(40, 110), random.uniform(-.26, .30, 3)
        out += np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * size ** 2))[..., None] * colour
    paint = lambda where, colour: out.__setitem__(where, colour)
    margin = (x < 12) | (x > width - 12) | (y < 12) | (y > height - 12)
    paint((y > 20) & (y < 86) & ~margin, (.78, .76, .70))         # a pale bar with the title
    for k, letter in enumerate("RADIOSITY"):
        for i, row in enumerate(_GLYPHS[letter].split()):
            for j, on in enumerate(row):
                if on == "1":
                    x0, y0 = 31 + 41 * k + 7 * j, 28 + 7.2 * i
                    paint((x >= x0) & (x < x0 + 7) & (y >= y0) & (y < y0 + 7.2), (.06, .07, .12))
    paint((x - 92) ** 2 + (y - 196) ** 2 < 52 ** 2, (.62, .12, .09))                               # a disc in a ring
    paint((x - 92) ** 2 + (y - 196) ** 2 < 31 ** 2, (.80, .62, .16))
    paint((y > 150) & (np.abs(x - 196) < (y - 150) * .46) & (y < 244), (.10, .34, .26))            # a triangle
    paint((x > 268) & (x < 388) & (y > 150) & (y < 196) & (np.floor(x / 3) % 2 == 0), (.08, .08, .09))       # upright stripes, 3 px
    paint((x > 268) & (x < 388) & (y > 204) & (y < 248) & (np.floor((x + y) / 6) % 2 == 0), (.74, .72, .66))           # slanting ones
    paint(margin, (.84, .83, .80))
    out = np.clip(out, .04, .86).reshape(height, fine, width, fine, 3).mean((1, 3))
    return out.astype(np.float16).astype(float)                   # exactly what the EXR holds


@functools.cache
def rug_image(width=288, height=192, fine=4) -> np.ndarray:
    """(height, width, 3) of a woven rug: borders, diamonds, bands."""
    y, x = np.mgrid[:height * fine, :width * fine] + .5
    x, y = x / fine, y / fine
    out = np.array([.40, .10, .10]) + np.zeros((*x.shape, 3))
    edge = np.minimum(np.minimum(x, width - x), np.minimum(y, height - y))
    out[np.floor(y / 12) % 4 == 1] = (.46, .15, .12)
    for k in range(4):
        distance = np.abs(x - 54 - 60 * k) / 26 + np.abs(y - height / 2) / 58
        out[distance < 1] = (.10, .16, .34)
        out[distance < .62] = (.68, .58, .36)
        out[distance < .28] = (.14, .30, .20)
    out[edge < 24] = (.12, .14, .30)
    out[(edge < 18) & (edge > 12)] = (.66, .56, .34)
    out[edge < 6] = (.56, .50, .40)
    out = out.reshape(height, fine, width, fine, 3).mean((1, 3))
    return out.astype(np.float16).astype(float)


def poster() -> Recipe:
    """A room with a printed poster on the wall and a woven rug on the floor, both textured; the rest is of one reflectance each."""
    x, y, z = 4.6, 3.8, 2.6
    turn = np.array([np.cos(.12), np.sin(.12), 0])
    rug_at, across = np.array([2.98, 1.22, .012]), np.array([-turn[1], turn[0], 0])           # its corner; its long side is `across`
    textures = {"poster": Texture(poster_image(), np.array([x - .02, 2.72, 1.95]), np.array([0, -1.40, 0.]), np.array([0, 0, -1.00])),
                "rug": Texture(rug_image(), rug_at + 1.35 * across + .90 * turn, -1.35 * across, -.90 * turn)}
    surfaces = {g: Surface("textured", texture=t) for g, t in textures.items()}
    materials = {"wall": (.68, .66, .60), "floor": (.44, .35, .26), "ceiling": (.80, .80, .78), "edge": (.30, .26, .22), "fringe": (.50, .44, .36), "bench": (.34, .22, .14),
                 "crate": (.24, .36, .52), "stool": (.58, .40, .16), "cupboard": (.48, .52, .46), "ball": (.60, .18, .14)} | {g: t.mean() for g, t in textures.items()}
    p = room(x, y, z)
    p += on_wall("poster", "poster", "edge", ("x", x, -1), (1.32, 2.72), (.95, 1.95), .02)
    corners = np.array([rug_at, rug_at + .90 * turn, rug_at + .90 * turn + 1.35 * across, rug_at + 1.35 * across])[:, :2]
    p += prism("rug", "fringe", corners, 0, .012, top="rug")
    p += box("bench", "bench", (4.15, 1.25, .38), (4.55, 2.55, .44))
    p += box("bench-leg-1", "bench", (4.2, 1.35, 0), (4.5, 1.41, .38))
    p += box("bench-leg-2", "bench", (4.2, 2.39, 0), (4.5, 2.45, .38))
    p += box("crate", "crate", (4.18, 1.42, .44), (4.46, 1.78, .68), turn=.25)
    p += prism("stool", "stool", regular((3.62, .70), .2, 8, .2), 0, .46)
    p += box("cupboard", "cupboard", (3.3, 3.35, 0), (4.3, 3.8, 1.5))
    p += prism("ball", "ball", regular((3.45, 3.0), .14, 6, .5), 0, .22)
    p += [lamp("lamp", "lamp", (2.55, 1.75), 1.1, .7, z - .05)]
    tint = (1.0, .97, .91)
    E = exposed(p, materials, {"lamp": tint}, .24)
    return Recipe("poster", tuple(p), materials, {"lamp": scaled(E, tint)}, 2.1, pinhole(640, 480, 405, (3.2, -2.7)), (640, 480),
                  look((1.30, 1.55, 1.62), (4.6, 2.12, .98)), surfaces=surfaces, about="A room with a printed poster and a woven rug; the lamp's emittance is known")


def two_mirrors() -> Recipe:
    """Two perfect mirrors on opposite walls; the camera, between them, sees one of them and in it the other, and so on."""
    materials = {"wall": (.64, .60, .52), "floor": (.32, .26, .22), "ceiling": (.78, .78, .76), "frame": (.46, .32, .14), "frame-2": (.16, .18, .24), "chest": (.30, .42, .44),
                 "vase": (.58, .16, .12), "stool": (.56, .46, .22), "bench": (.22, .16, .34), "screen": (.40, .54, .30), "mirror": (0., 0., 0.), "mirror-2": (0., 0., 0.)}
    surfaces = {g: Surface("mirror", (1., 1., 1.)) for g in ("mirror", "mirror-2")}
    x, y, z = 4.4, 3.4, 2.6
    p = room(x, y, z)
    p += framed("mirror", "mirror", "frame", ("y", y, -1), (1.30, 3.10), (.85, 1.95), .03)
    p += framed("mirror-2", "mirror-2", "frame-2", ("y", 0., 1), (1.15, 2.75), (.75, 2.05), .03)
    p += box("chest", "chest", (1.2, 3.0, 0), (2.1, 3.4, .55))
    p += prism("vase", "vase", regular((1.5, 3.18), .09, 8, .2), .55, .92)
    p += prism("stool", "stool", regular((2.85, 2.45), .2, 6, .3), 0, .5)
    p += box("bench", "bench", (2.4, .12, 0), (3.3, .5, .45))
    p += box("screen", "screen", (3.55, 2.2, 0), (3.62, 3.2, 1.6), turn=.3)
    p += [lamp("lamp", "lamp", (2.3, 1.75), 1.2, .8, z - .05)]
    tint = (1.0, .96, .90)
    E = exposed(p, brightness(materials, surfaces), {"lamp": tint}, .22)
    return Recipe("two-mirrors", tuple(p), materials, {"lamp": scaled(E, tint)}, 2.2, pinhole(640, 480, 390), (640, 480),
                  look((1.72, .92, 1.52), (2.35, 3.4, 1.16)), surfaces=surfaces, about="Two mirrors that face each other; the lamp's emittance is known")


# ---- stereo scenes -----------------------------------------------------------------------------------------

_BUREAU = {
    "wall": (.70, .68, .61), "floor": (.35, .29, .23), "ceiling": (.79, .79, .77), "blackboard": (.08, .17, .12), "frame": (.50, .34, .17),
    "cabinet": (.44, .47, .50), "shutter": (.17, .27, .46), "poster": (.66, .58, .22), "door": (.50, .21, .15), "desktop": (.60, .43, .26),
    "desk": (.27, .31, .38), "monitor": (.07, .08, .11), "stool": (.14, .33, .20), "carton": (.57, .41, .24), "rug": (.46, .12, .14),
    "shelf": (.55, .53, .46), "curtain": (.30, .16, .38),
}


def bureau(name, random, *, leave_out=(), **fixed) -> list:
    """One room of the kind of `office`, about 5 x 4 x 2.8 m, its corner at the origin and its furniture at the walls y = max and x = max.

    Every piece has its own size and place, drawn by `random`; `fixed` overrides some: {piece: (place, size)}, each as the piece's line below has it.
    Pieces stand on the floor, on each other or at a wall; all but the shell and the lamp are closed boxes."""
    near = lambda *middle_spread: tuple(m + s * random.uniform(-1, 1) for m, s in middle_spread)
    x, y, z = near((5.0, .35), (4.0, .3), (2.8, .1))
    place = {                    # where, how large; drawn for every piece, so that leaving one out moves no other
        "blackboard": (near((x - 2.75, .15), (1.42, .12)), near((1.35, .2), (.95, .12))),        # x of its middle, z; width, height
        "cabinet": (near((x - .72, .10)), near((.80, .12), (.48, .06), (1.55, .16))),            # x of its middle; width, depth, height
        "poster": (near((y - .95, .08), (1.50, .10)), near((.42, .07), (.60, .08))),             # y of its middle, z; width, height
        "door": (near((1.0, .06)), near((.76, .05), (1.95, .06))),                               # y of its middle; width, height
        "desk": (near((y - 1.75, .08)), near((1.25, .14), (.75, .08), (.73, .03))),              # y of its middle; length, depth, height
        "monitor": (near((.42, .05), (.12, .12), (.25, .25)), near((.55, .06), (.36, .04))),     # from the wall, off the desk's middle, turn; width, height
        "stool": (near((x - 1.32, .10), (y - 2.15, .12), (.3, .5)), near((.40, .05), (.45, .04))),        # x, y, turn; width, height
        "carton": (near((x - 2.85, .12), (y - 1.05, .12), (.4, .4)), near((.50, .07), (.36, .06), (.40, .08))),      # x, y, turn; lengths
        "rug": (near((x - 2.30, .08), (y - 1.85, .08), (0, .12)), near((1.10, .12), (.75, .08))),         # x, y, turn; lengths
        "shelf": (near((x - 2.9, .3), (.9, .2)), near((1.2, .2), (.30, .05), (.9, .2))),                   # at y = 0: x, unused; lengths
        "curtain": (near((1.4, .2)), near((1.1, .1), (1.9, .1))),                                         # at x = 0: y of its middle; width, height
    } | fixed
    p = room(x, y, z)
    for piece, (at, size) in place.items():
        if piece in leave_out:
            continue
        a, b = at[:2] if len(at) > 1 else (at[0], 0)
        if piece == "blackboard":
            p += box(piece, "frame", (a - size[0] / 2, y - .07, b - size[1] / 2), (a + size[0] / 2, y, b + size[1] / 2), sides={0: "blackboard"})
        elif piece == "cabinet":
            p += box(piece, "cabinet", (a - size[0] / 2, y - size[1], 0), (a + size[0] / 2, y, size[2]), sides={0: "shutter"})
        elif piece == "poster":
            p += box(piece, "poster", (x - .012, a - size[0] / 2, b - size[1] / 2), (x, a + size[0] / 2, b + size[1] / 2))
        elif piece == "door":
            p += box(piece, "door", (x - .04, a - size[0] / 2, 0), (x, a + size[0] / 2, size[1]))
        elif piece == "desk":
            p += box(piece, "desk", (x - size[1], a - size[0] / 2, 0), (x, a + size[0] / 2, size[2]), top="desktop")
        elif piece == "monitor":
            middle, (length, depth, top) = place["desk"][0][0] + b, place["desk"][1]
            p += box(piece, "monitor", (x - a - .03, middle - size[0] / 2, top), (x - a + .03, middle + size[0] / 2, top + size[1]), turn=at[2])
        elif piece == "stool":
            p += box(piece, "stool", (a - size[0] / 2, b - size[0] / 2, 0), (a + size[0] / 2, b + size[0] / 2, size[1]), turn=at[2])
        elif piece in ("carton", "rug"):
            p += box(piece, piece, (a - size[0] / 2, b - size[1] / 2, 0), (a + size[0] / 2, b + size[1] / 2, size[2] if piece == "carton" else .012), turn=at[2])
        elif piece == "shelf":
            p += box(piece, "shelf", (a - size[0] / 2, 0, 0), (a + size[0] / 2, size[1], size[2]))
        elif piece == "curtain":
            p += box(piece, "curtain", (0, a - size[0] / 2, .2), (.05, a + size[0] / 2, .2 + size[1]))
    p += [lamp("lamp", "lamp", (x / 2 + .1, y / 2), 1.2, .6, z - .05)]
    return [Polygon(f"{name}-{q.object}", q.group, q.points) for q in p]


def moved(polygons, T, mirror=False) -> list:
    """The polygons displaced by T (4, 4), before that perhaps mirrored in x (and their corners reversed, so that fronts stay fronts)."""
    turn = (lambda p: (p * (-1, 1, 1))[::-1]) if mirror else (lambda p: p)
    return [Polygon(q.object, q.group, turn(q.points) @ T[:3, :3].T + T[:3, 3]) for q in polygons]


def upright(yaw, translation) -> np.ndarray:
    """(4, 4): a turn about z by `yaw` radians, then a translation."""
    T, c, s = np.eye(4), np.cos(yaw), np.sin(yaw)
    T[:2, :2], T[:3, 3] = [[c, -s], [s, c]], translation
    return T


def shots(corners, square_m, lenses, T_right_left, size, random, both=12, single=2) -> Board:
    """A board held before a pair: `both` times seen wholly by both cameras, and `single` times each, close, by one of them alone.

    Of 60 places drawn for each shot the one is taken that covers most cells of the two pictures, those seen seldom before counting more."""
    W, H = size
    seen = np.zeros((2, 9, 12))
    out, board = [], Board(corners, square_m, ())
    middle = board.points().mean(0)
    for kind in ["both"] * both + [0] * single + [1] * single:
        best, tries = None, 0
        while tries < 60:
            z = random.uniform(.70, 1.8) if kind == "both" else random.uniform(.50, .75)
            side = 0 if kind == "both" else kind
            u, v = random.uniform(.05 * W, .95 * W), random.uniform(.05 * H, .95 * H)
            x, y = lenses[side].unproject(u, v)
            axis = random.uniform(0, 2 * np.pi)
            tilt, roll = random.uniform(.25, .85), random.uniform(-.5, .5)
            R = _rotation((np.cos(axis) * tilt, np.sin(axis) * tilt, 0)) @ _rotation((0, 0, roll))
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = R, np.array([x, y, 1]) * z - R @ middle
            if side == 1:
                T = np.linalg.inv(T_right_left) @ T
            views = []
            for s, (lens, V) in enumerate(zip(lenses, (np.eye(4), T_right_left))):
                views.append(_seen(board, lens, V @ T, size))
                if (views[s] == "hidden") != (kind not in ("both", s)) or views[s] == "partly":
                    break
            else:
                tries += 1
                cells = [(s, cell) for s, cell in enumerate(views) if cell != "hidden"]
                gain = sum((1 / (1 + seen[s][cell]) ** 2).sum() for s, cell in cells)
                if best is None or gain > best[0]:
                    best = gain, T, cells
        out.append(best[1])
        for s, cell in best[2]:
            seen[s][cell] += 1
    return Board(corners, square_m, tuple(out))


def _seen(board, lens, T, size):
    """The cells (of 9 x 12, two index arrays) in which a board at T (4, 4) shows corners if all of it is seen, at 60 degrees from its normal at most;
    "hidden" if at least 10 corners are outside; "partly" otherwise."""
    W, H = size
    edge, p = (x @ T[:3, :3].T + T[:3, 3] for x in (board.outline(.6), board.points()))
    if edge[:, 2].min() < .3:
        return "hidden"
    edge = lens.project(edge)
    if (edge > 3).all() and (edge < (W - 4, H - 4)).all() and T[:3, 2] @ p.mean(0) > .5 * np.linalg.norm(p.mean(0)):
        q = lens.project(p)
        return tuple(np.unique((np.clip(q[:, 1] / H * 9, 0, 8).astype(int), np.clip(q[:, 0] / W * 12, 0, 11).astype(int)), axis=1))
    q = lens.project(p)
    return "hidden" if ((q < 0) | (q > (W - 1, H - 1))).any(1).sum() >= 10 else "partly"


def _rotation(r) -> np.ndarray:
    """Rodrigues vector -> (3, 3)."""
    a = np.linalg.norm(r)
    x, y, z = np.asarray(r) / max(a, 1e-300)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K


def office_stereo(seed=0) -> Recipe:
    """Three such rooms in one model, shut off from each other; a pair of cameras sees one of them.

    Seed 1 is another building, mirrored, with other paints, lenses, angle and lamp; seed 2 another one in grey, through pinholes that are given."""
    random = np.random.default_rng([11, seed])
    materials = dict(_BUREAU)
    lenses = (Lens((461.3, 460.7, 322.6, 237.1), (-.182, .061, .0007, -.0005, .004, .021, -.006, .002)),
              Lens((458.9, 459.4, 316.2, 242.8), (-.171, .049, -.0004, .0006, .007, .018, -.004, .003)))
    tint, gamma, noise, level = (1.0, .95, .86), 2.1, .007, .25
    rooms, seen, building = ("east", "middle", "west"), "middle", upright(.35, (12.4, -3.1, .6))
    eye, target, other = (.45, .66, 1.60), (3.75, 2.72, .93), {}
    right = look((.385, .012, .018), (.015, -.02, 3.05), (.007, -1, 0))
    if seed:
        for group, rho in materials.items():
            low, high = (.04, .22) if group in ("blackboard", "monitor") else (.55, .85) if group in ("wall", "ceiling") else (.07, .70)
            materials[group] = tuple(np.round(np.clip(np.array(rho) + random.uniform(-.06, .06) + random.uniform(-.08, .08, 3), low, high), 3))
    if seed == 1:
        lenses = (Lens((488.2, 488.9, 314.8, 243.5), (-.142, .038, -.0006, .0004, -.002, .011, .003, -.001)),
                  Lens((491.7, 491.1, 323.9, 235.2), (-.128, .031, .0005, .0007, .001, .014, .002, -.001)))
        tint, gamma, noise, level = (1.0, .91, .78), 1.9, .006, .23
        rooms, seen, building = ("c", "b", "a"), "a", upright(-1.1, (-7.2, 21.5, 3.4))
        eye, target, other = (.42, .58, 1.66), (3.75, 2.75, .93), {"blackboard": ((2.8, 1.45), (1.25, .90)), "rug": ((2.9, 2.3, -.25), (.85, 1.15))}
        right = look((.30, -.009, .004), (-.02, .01, 2.9), (-.005, -1, 0))
    elif seed == 2:
        materials = {g: (round(float(np.mean(rho)), 3),) * 3 for g, rho in materials.items()}
        materials |= {"carton": (.58,) * 3, "desk": (.20,) * 3, "shutter": (.15,) * 3}          # grey as the floor otherwise
        lenses = (Lens((438.0, 438.0, 321.0, 238.5)), Lens((441.0, 441.0, 318.5, 241.0)))
        tint, gamma, noise, level = (1.0, 1.0, 1.0), 2.2, .005, .24
        rooms, seen, building = ("left", "centre", "right"), "left", upright(2.2, (3.0, 8.0, 0))
        right = look((.45, 0, .03), (.02, .015, 3.1), (.003, -1, 0))

    p, x0 = [], 0.0
    for name in rooms:                            # the seen one is furnished in full, the others lack this and that
        left_out = {rooms[0]: ("carton", "stool"), rooms[1]: ("rug", "monitor"), rooms[2]: ("poster", "carton")}[name]
        out = bureau(name, random, leave_out=("shelf", "curtain"), **other) if name == seen else bureau(name, random, leave_out=left_out)
        width = max(q.points[:, 0].max() for q in out)
        T_room = building @ upright(0, (-x0 if seed == 1 else x0, 0, 0))
        p += moved(out, T_room, mirror=seed == 1)
        if name == seen:
            at = lambda q: T_room[:3, :3] @ (np.array([-1 if seed == 1 else 1, 1, 1]) * q) + T_room[:3, 3]
            T_left = look(at(eye), at(target))
        x0 += width + .2                          # walls of 0.2 m
    E = exposed([q for q in p if q.object.startswith(seen + "-")], materials, {"lamp": tint}, level)
    lens, size = lenses[0], (640, 480)
    board = None if seed == 2 else shots((10, 7), .04, lenses, right, size, np.random.default_rng([12, seed]))
    rig = look((.2, .02, -.01), (.2, .1, 3.0), (0, -1, 0)) if seed == 2 else np.eye(4)           # the given cameras' common frame is neither's own
    about = ("An office among three in one model, seen by a stereo pair" + ("; grey, pinholes" if seed == 2 else " with distorting lenses")
             + (f", seed {seed}" if seed else "") + "; the lamps' emittance is known")
    return Recipe("office-stereo" + ("", "-1", "-grey")[seed], tuple(p), materials, {"lamp": scaled(E, tint)}, gamma, lens.K, size, T_left,
                  channels=1 if seed == 2 else 3, about=about, pair=Pair(lenses, right, seen + "-", noise, board, np.linalg.inv(rig)))


_RECIPES = {"office": office, "office-1": lambda: office(1), "office-2": lambda: office(2), "office-3": lambda: office(3),
            "gallery-white": gallery_white, "cornell": cornell, "flat-grey": flat_grey, "linear": linear}
NAMES = tuple(_RECIPES)
_STEREO = {"office-stereo": office_stereo, "office-stereo-1": lambda: office_stereo(1), "office-stereo-grey": lambda: office_stereo(2)}
STEREO_NAMES = tuple(_STEREO)
_KINDS = {"office-mirror": office_mirror, "office-coloured-mirror": office_coloured_mirror, "desk-glossy": desk_glossy, "desk-brushed": desk_brushed,
          "poster": poster, "two-mirrors": two_mirrors}
KIND_NAMES = tuple(_KINDS)
