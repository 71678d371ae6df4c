"""Recipes of diffuse rooms: offices, a white gallery, the Cornell box, a grey room, a loft."""

import json
from pathlib import Path

import numpy as np

from lib.synthetic.geometry import Polygon, box, lamp, prism, rectangle, regular, room
from lib.synthetic.optics import look, pinhole
from lib.synthetic.recipe import Recipe, exposed, lit_room, repainted, scaled

ROOT = Path(__file__).resolve().parents[2]

_OFFICE = {
    "wall": (0.72, 0.69, 0.62),
    "floor": (0.38, 0.30, 0.23),
    "ceiling": (0.80, 0.80, 0.77),
    "board": (0.08, 0.17, 0.12),
    "frame": (0.52, 0.36, 0.18),
    "desktop": (0.58, 0.42, 0.26),
    "deskpanel": (0.30, 0.34, 0.42),
    "cabinet": (0.47, 0.50, 0.52),
    "door": (0.55, 0.22, 0.16),
    "chair": (0.16, 0.22, 0.46),
    "monitor": (0.09, 0.10, 0.14),
    "partition": (0.36, 0.56, 0.50),
    "carton": (0.60, 0.45, 0.28),
    "bin": (0.62, 0.60, 0.20),
    "book": (0.60, 0.12, 0.10),
    "poster": (0.66, 0.62, 0.34),
}


def office(seed=0) -> Recipe:
    """The paper's kind of room, 5 x 4 x 2.8 m, seen from its near corner.

    The partition is one polygon whose near side faces away from the lamp, so only indirect light reaches what the
    camera sees of it.  Seeds 1-3 change materials, gamma, camera and lamp, and keep the furniture.
    """
    random = np.random.default_rng([7, seed])
    materials = dict(_OFFICE)
    lamp_at, lamp_size, tint, gamma = (2.95, 2.05), (1.2, 0.7), (1.0, 0.96, 0.88), 2.0
    eye, target, focal, shift = np.array([0.40, 1.0, 1.55]), np.array([4.0, 2.68, 1.28]), 400.0, (0.0, 0.0)
    level = 0.24
    if seed:
        materials = repainted(
            materials, random, lighter=0.14, tinted=0.10, dark=("board", "monitor"), usual=(0.08, 0.72)
        )
        gamma = (None, 1.6, 2.6, 2.23)[seed]
        lamp_at = (random.uniform(2.7, 3.3), random.uniform(1.7, 2.4))
        lamp_size = (random.uniform(0.5, 1.5), random.uniform(0.4, 1.0))
        tint = tuple(np.round((1.0, random.uniform(0.85, 1.0), random.uniform(0.7, 1.0)), 3))
        eye = eye + random.uniform(-0.18, 0.18, 3)
        target = target + random.uniform(-0.2, 0.2, 3) * (1, 1, 0.6)
        focal = random.uniform(385, 425)
        shift = ((0, 0), (7.3, -4.6), (0, 0), (-11.2, 5.4))[seed]
        level = random.uniform(0.18, 0.26)

    p = office_furnished()
    p += [lamp("lamp", "lamp", lamp_at, *lamp_size, 2.75)]

    params = {}
    if seed == 2:  # its gamma hangs on light in dark corners: docs/verify.md, What the draws are
        params = {"formfactors": {"contrast": 0.003}, "gather": {"rays_per_tile": 1024, "rays_per_facet": 65536}}
    about = (
        "An office: the paper's kind of room" + (f", seed {seed}" if seed else "") + "; the lamp's emittance is known"
    )
    return lit_room(
        f"office-{seed}" if seed else "office",
        p,
        materials,
        tint=tint,
        level=level,
        gamma=gamma,
        K=pinhole(640, 480, focal, shift),
        T_cam_world=look(eye, target),
        about=about,
        params=params,
    )


def office_furnished() -> list[Polygon]:
    """The office's room, 5 x 4 x 2.8 m, and what stands in it; no lamp."""
    p = room(5.0, 4.0, 2.8)
    # the blackboard touches the wall; its frame is four bars around it, a little thicker
    p += box("board", "board", (2.15, 3.97, 0.95), (3.55, 4.0, 1.95))
    p += box("frame", "frame", (2.09, 3.955, 0.89), (3.61, 4.0, 0.95))
    p += box("frame-top", "frame", (2.09, 3.955, 1.95), (3.61, 4.0, 2.01))
    p += box("frame-left", "frame", (2.09, 3.955, 0.95), (2.15, 4.0, 1.95))
    p += box("frame-right", "frame", (3.55, 3.955, 0.95), (3.61, 4.0, 1.95))
    # cabinet against the wall; its door is a plate on the front
    p += box("cabinet", "cabinet", (3.95, 3.5, 0), (4.8, 4.0, 1.6))
    p += box("door", "door", (3.99, 3.47, 0.08), (4.76, 3.5, 1.52))
    # desk against the wall x = 5
    p += box("desktop", "desktop", (4.0, 1.25, 0.72), (5.0, 2.95, 0.76))
    p += box("desk-left", "deskpanel", (4.1, 2.85, 0), (5.0, 2.9, 0.72))
    p += box("desk-right", "deskpanel", (4.1, 1.3, 0), (5.0, 1.35, 0.72))
    p += box("desk-back", "deskpanel", (4.9, 1.35, 0.25), (4.95, 2.85, 0.72))
    p += box("monitor", "monitor", (4.55, 1.75, 0.80), (4.62, 2.45, 1.25))
    p += box("stand", "monitor", (4.48, 1.98, 0.76), (4.7, 2.22, 0.80))
    p += box("book", "book", (4.1, 2.44, 0.76), (4.4, 2.84, 0.92), turn=0.2)
    # chair: a seat, a back and two runners
    p += box("seat", "chair", (3.45, 1.75, 0.43), (3.95, 2.25, 0.48))
    p += box("chair-back", "chair", (3.45, 1.78, 0.48), (3.49, 2.22, 0.95))
    p += box("runner-left", "chair", (3.45, 2.19, 0), (3.95, 2.24, 0.43))
    p += box("runner-right", "chair", (3.45, 1.76, 0), (3.95, 1.81, 0.43))
    # things on the floor
    p += box("carton", "carton", (2.35, 2.55, 0), (2.85, 2.95, 0.36), turn=0.5)
    p += box("carton-2", "carton", (2.45, 2.6, 0.36), (2.75, 2.85, 0.56), turn=-0.2)
    p += prism("bin", "bin", regular((4.45, 0.85), 0.15, 6, 0.2), 0, 0.36)
    p += box("poster", "poster", (4.985, 3.05, 1.2), (5.0, 3.45, 1.75))
    p += [rectangle("partition", "partition", (1.9, 0, 0), (0, 0.78, 0), (0, 0, 1.35))]
    return p


def gallery_white() -> Recipe:
    """An exhibition room where everything reflects 0.70 to 0.90: the printed update diverges here."""
    materials = {
        "floor": (0.76, 0.73, 0.70),
        "ceiling": (0.90, 0.90, 0.89),
        "wall": (0.86, 0.86, 0.85),
        "panel": (0.88, 0.84, 0.80),
        "stele": (0.80, 0.84, 0.88),
        "plinth": (0.84, 0.80, 0.78),
        "bench": (0.78, 0.72, 0.70),
        "divider": (0.82, 0.86, 0.80),
    }
    x, y, z = 7.0, 5.5, 3.4
    p = room(x, y, z)
    p += box("panel-1", "panel", (2.6, 5.46, 1.0), (3.9, 5.5, 2.1))
    p += box("panel-2", "panel", (4.6, 5.46, 1.0), (5.9, 5.5, 2.1))
    p += box("panel-3", "panel", (6.96, 2.2, 0.9), (7.0, 3.6, 2.2))
    p += box("plinth-1", "plinth", (3.1, 3.3, 0), (3.6, 3.8, 1.05))
    p += prism("stele", "stele", regular((5.2, 3.9), 0.35, 6, 0.1), 0, 1.5)
    p += box("plinth-2", "plinth", (4.6, 1.4, 0), (5.2, 2.0, 0.7), turn=0.35)
    p += box("bench", "bench", (2.3, 2.1, 0.38), (3.9, 2.55, 0.46))
    p += box("bench-leg-1", "bench", (2.4, 2.15, 0), (2.5, 2.5, 0.38))
    p += box("bench-leg-2", "bench", (3.7, 2.15, 0), (3.8, 2.5, 0.38))
    p += box("divider", "divider", (5.9, 0, 0), (6.05, 1.5, 2.4))
    p += [
        lamp("lamp-1", "lamp", (2.6, 2.7), 1.6, 0.5, z - 0.06),
        lamp("lamp-2", "lamp", (4.8, 2.7), 1.6, 0.5, z - 0.06),
    ]
    return lit_room(
        "gallery-white",
        p,
        materials,
        tint=(1, 1, 1),
        level=0.40,
        gamma=2.2,
        K=pinhole(640, 480, 405),
        T_cam_world=look((0.5, 0.8, 1.6), (4.6, 3.1, 1.45)),
        about="An exhibition room, everything nearly white; the lamps' emittance is known",
    )


# Measured spectra as a camera sees them, rounded: see `cornell_channels`.
CORNELL = {"white": (0.7376, 0.7366, 0.7433), "green": (0.1683, 0.3231, 0.2051), "red": (0.3781, 0.1020, 0.0666)}
CORNELL_LAMP = (0.9092, 1.0, 0.9934)


def cornell_channels() -> dict:
    """The Cornell box's measured spectra as three linear channels, with colour-science (only this function needs it).

    A channel is what the Nikon D5100 (sensitivities by NPL, in colour-science) sees under the box's own lamp:
    rho_c = sum(s_c e rho) / sum(s_c e) over 400, 404 ... 700 nm, where s_c is the sensitivity and e the emission
    (linear between its four samples).  The camera is balanced for illuminant A, and the lamp's green is 1:
    lamp_c = sum(s_c e) / sum(s_c A).
    """
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

    The lamp lies in the plane of the ceiling, and the ceiling is four quads around it.  The measured red wall is 3 mm
    off its plane, so it is two triangles.  The open front is black.
    """
    numbers = json.loads((ROOT / "data" / "cornell-box-measured" / "geometry_camera.json").read_text())
    metres = lambda points: np.array([(-x, z, y) for x, y, z in np.asarray(points, float)]) / 1000

    def towards(object, group, points, inside):
        """The polygon, turned so that its front sees the point `inside`."""
        n = np.cross(points[1] - points[0], points[2] - points[0])
        return Polygon(object, group, points if n @ (inside - points[0]) > 0 else points[::-1])

    centre = metres([[278, 274, 280]])[0]
    wall = lambda name, group, key: towards(name, group, metres(numbers[key]), centre)
    hole, outer = metres(numbers["light"]["quad"]), metres(numbers["ceiling"])
    p = [wall("floor", "white", "floor"), wall("back", "white", "back"), wall("right", "green", "right_green")]
    red = metres(numbers["left_red"])
    p += [towards("left", "red", red[[0, 1, 2]], centre), towards("left", "red", red[[0, 2, 3]], centre)]
    # Around the hole: pair each corner of the lamp with the ceiling's nearest corner.
    nearest = [int(np.argmin(np.linalg.norm(outer - h, axis=1))) for h in hole]
    for i in range(4):
        j = (i + 1) % 4
        quad = np.array([outer[nearest[i]], outer[nearest[j]], hole[j], hole[i]])
        p.append(towards("ceiling", "white", quad, centre))
    for name in ("short_block", "tall_block"):
        top = metres(numbers[name + "_top"])
        turned = np.cross(top[1] - top[0], top[2] - top[0])[2] > 0
        p += prism(name.replace("_", "-"), "white", (top if turned else top[::-1])[:, :2], 0, top[0, 2])
    p.append(towards("light", "light", hole, centre))
    # Their camera: film 0.025 at focal length 0.035, seen from 0.8 m before the box.
    width = height = 400
    eye = metres([numbers["camera"]["position"]])[0]
    E = scaled(45.0, CORNELL_LAMP)
    return Recipe(
        "cornell",
        tuple(p),
        dict(CORNELL),
        {"light": E},
        gamma=2.2,
        K=pinhole(width, height, width * 0.035 / 0.025),
        size=(width, height),
        T_cam_world=look(eye, eye + (0, 1, 0)),
        reference={"light": (0.78, 0.78, 0.78)},
        about="The measured Cornell box; its lamp's emittance and reflectance are known",
        params={"formfactors": {"patches": 1800}},  # its gamma hangs on them: docs/verify.md, What the draws are
    )


def flat_grey() -> Recipe:
    """A small grey room, one channel."""
    grey = {"wall": 0.62, "floor": 0.33, "ceiling": 0.78, "shelf": 0.48, "crate": 0.22, "pillar": 0.70, "plate": 0.12}
    materials = {g: (v, v, v) for g, v in grey.items()}
    x, y, z = 4.0, 3.2, 2.5
    p = room(x, y, z)
    p += box("shelf", "shelf", (2.0, 2.85, 1.05), (3.3, 3.2, 1.12))
    p += box("shelf-2", "shelf", (2.0, 2.85, 0.5), (3.3, 3.2, 0.57))
    p += box("crate", "crate", (2.4, 1.5, 0), (2.95, 2.0, 0.5), turn=0.4)
    p += prism("pillar", "pillar", regular((3.4, 1.0), 0.2, 8), 0, 2.5)
    p += box("plate", "plate", (3.96, 1.6, 0.8), (4.0, 2.7, 1.6))
    p += [lamp("lamp", "lamp", (2.2, 1.5), 0.8, 0.8, z - 0.04)]
    return lit_room(
        "flat-grey",
        p,
        materials,
        tint=(1, 1, 1),
        level=0.22,
        gamma=2.2,
        K=pinhole(480, 360, 300),
        size=(480, 360),
        T_cam_world=look((0.35, 0.45, 1.45), (3.2, 2.2, 1.2)),
        channels=1,
        about="A grey room, one channel; the lamp's emittance is known",
    )


def linear() -> Recipe:
    """A loft with a sloping ceiling: a linear photograph in which the lamps are brighter than white."""
    materials = {
        "wall": (0.64, 0.62, 0.58),
        "brick": (0.46, 0.24, 0.17),
        "floor": (0.42, 0.34, 0.26),
        "ceiling": (0.78, 0.77, 0.74),
        "beam": (0.30, 0.20, 0.12),
        "bench": (0.24, 0.38, 0.30),
        "chest": (0.20, 0.26, 0.42),
        "door": (0.62, 0.55, 0.40),
        "rug": (0.48, 0.14, 0.16),
    }
    x, y, low, high = 6.0, 3.4, 2.1, 3.1  # the ceiling rises from y = 0 to y = y
    a, b, c, d = (0, 0), (x, 0), (x, y), (0, y)
    P = lambda *points: np.array(points, float)
    p = [
        Polygon("floor", "floor", P((*a, 0), (*b, 0), (*c, 0), (*d, 0))),
        Polygon("ceiling", "ceiling", P((*a, low), (*d, high), (*c, high), (*b, low))),
        Polygon("walls", "wall", P((*a, 0), (*a, low), (*b, low), (*b, 0))),
        Polygon("walls", "brick", P((*b, 0), (*b, low), (*c, high), (*c, 0))),
        Polygon("walls", "wall", P((*c, 0), (*c, high), (*d, high), (*d, 0))),
        Polygon("walls", "wall", P((*d, 0), (*d, high), (*a, low), (*a, 0))),
    ]
    p += box("post-1", "beam", (2.3, 2.5, 0), (2.45, 2.65, 2.75))  # posts end below the ceiling, under a beam
    p += box("post-2", "beam", (4.3, 2.5, 0), (4.45, 2.65, 2.6))
    p += box("beam", "beam", (0, 0.9, 2.15), (6, 1.05, 2.3))
    p += box("bench", "bench", (3.0, 3.0, 0), (4.6, 3.4, 0.45))
    p += box("chest", "chest", (4.9, 0.3, 0), (5.5, 1.0, 0.55), turn=-0.25)
    p += box("door", "door", (5.96, 1.5, 0), (6.0, 2.4, 2.0))
    p += box("rug", "rug", (2.7, 1.1, 0), (4.4, 2.2, 0.015))
    p += [lamp("lamp-1", "lamp", (2.6, 1.9), 0.5, 0.3, 2.5), lamp("lamp-2", "spot", (4.8, 2.0), 0.35, 0.35, 2.5)]
    E = exposed(p, materials, {"lamp": (1.0, 0.93, 0.80), "spot": (1.2, 1.2, 1.3)}, 0.20)
    lamps = {"lamp": scaled(E, (1.0, 0.93, 0.80)), "spot": scaled(E, (1.2, 1.2, 1.3))}
    return Recipe(
        "linear",
        tuple(p),
        materials,
        lamps,
        gamma=None,
        K=pinhole(640, 480, 410),
        size=(640, 480),
        T_cam_world=look((0.35, 0.75, 1.6), (4.6, 2.1, 1.2)),
        about="A loft photographed linearly; two lamps of known emittance",
    )
