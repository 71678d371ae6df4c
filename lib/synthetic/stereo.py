"""Recipes of stereo scenes: three rooms in one model, a pair of cameras in one of them."""

from dataclasses import dataclass, field

import numpy as np

from lib.synthetic.chessboard import Board, shots
from lib.synthetic.geometry import Polygon, box, lamp, moved, room, upright
from lib.synthetic.optics import Lens, look
from lib.synthetic.recipe import Pair, Recipe, exposed, repainted, scaled

_BUREAU = {
    "wall": (0.70, 0.68, 0.61),
    "floor": (0.35, 0.29, 0.23),
    "ceiling": (0.79, 0.79, 0.77),
    "blackboard": (0.08, 0.17, 0.12),
    "frame": (0.50, 0.34, 0.17),
    "cabinet": (0.44, 0.47, 0.50),
    "shutter": (0.17, 0.27, 0.46),
    "poster": (0.66, 0.58, 0.22),
    "door": (0.50, 0.21, 0.15),
    "desktop": (0.60, 0.43, 0.26),
    "desk": (0.27, 0.31, 0.38),
    "monitor": (0.07, 0.08, 0.11),
    "stool": (0.14, 0.33, 0.20),
    "carton": (0.57, 0.41, 0.24),
    "rug": (0.46, 0.12, 0.14),
    "shelf": (0.55, 0.53, 0.46),
    "curtain": (0.30, 0.16, 0.38),
}


# ---- one room ----


def drawn_places(random, x, y) -> dict:
    """{piece: (place, size)} of the furniture of a room of x by y m.

    All are drawn, in this order, so that leaving one out moves no other.
    """
    near = lambda *middle_spread: tuple(m + s * random.uniform(-1, 1) for m, s in middle_spread)
    return {
        # x of its middle, z; width, height
        "blackboard": (near((x - 2.75, 0.15), (1.42, 0.12)), near((1.35, 0.2), (0.95, 0.12))),
        # x of its middle; width, depth, height
        "cabinet": (near((x - 0.72, 0.10)), near((0.80, 0.12), (0.48, 0.06), (1.55, 0.16))),
        # y of its middle, z; width, height
        "poster": (near((y - 0.95, 0.08), (1.50, 0.10)), near((0.42, 0.07), (0.60, 0.08))),
        # y of its middle; width, height
        "door": (near((1.0, 0.06)), near((0.76, 0.05), (1.95, 0.06))),
        # y of its middle; length, depth, height
        "desk": (near((y - 1.75, 0.08)), near((1.25, 0.14), (0.75, 0.08), (0.73, 0.03))),
        # from the wall, off the desk's middle, turn; width, height
        "monitor": (near((0.42, 0.05), (0.12, 0.12), (0.25, 0.25)), near((0.55, 0.06), (0.36, 0.04))),
        # x, y, turn; width, height
        "stool": (near((x - 1.32, 0.10), (y - 2.15, 0.12), (0.3, 0.5)), near((0.40, 0.05), (0.45, 0.04))),
        # x, y, turn; lengths
        "carton": (
            near((x - 2.85, 0.12), (y - 1.05, 0.12), (0.4, 0.4)),
            near((0.50, 0.07), (0.36, 0.06), (0.40, 0.08)),
        ),
        # x, y, turn; lengths
        "rug": (near((x - 2.30, 0.08), (y - 1.85, 0.08), (0, 0.12)), near((1.10, 0.12), (0.75, 0.08))),
        # at y = 0: x, and a number that nothing uses; lengths
        "shelf": (near((x - 2.9, 0.3), (0.9, 0.2)), near((1.2, 0.2), (0.30, 0.05), (0.9, 0.2))),
        # at x = 0: y of its middle; width, height
        "curtain": (near((1.4, 0.2)), near((1.1, 0.1), (1.9, 0.1))),
    }


def _between(name, group, *spans, **other) -> list[Polygon]:
    """A box between (low, high) in x, y and z."""
    return box(name, group, tuple(low for low, _ in spans), tuple(high for _, high in spans), **other)


def _around(middle, length):
    return middle - length / 2, middle + length / 2


def furniture(piece, places, x, y) -> list[Polygon]:
    """One piece of `drawn_places`, in a room whose far walls are at x and y."""
    at, size = places[piece]
    a = at[0]
    match piece:
        case "blackboard":
            spans = _around(a, size[0]), (y - 0.07, y), _around(at[1], size[1])
            return _between(piece, "frame", *spans, sides={0: "blackboard"})
        case "cabinet":
            spans = _around(a, size[0]), (y - size[1], y), (0, size[2])
            return _between(piece, "cabinet", *spans, sides={0: "shutter"})
        case "poster":
            return _between(piece, "poster", (x - 0.012, x), _around(a, size[0]), _around(at[1], size[1]))
        case "door":
            return _between(piece, "door", (x - 0.04, x), _around(a, size[0]), (0, size[1]))
        case "desk":
            return _between(piece, "desk", (x - size[1], x), _around(a, size[0]), (0, size[2]), top="desktop")
        case "monitor":
            (desk_at, *_), (_, _, top) = places["desk"]
            spans = (x - a - 0.03, x - a + 0.03), _around(desk_at + at[1], size[0]), (top, top + size[1])
            return _between(piece, "monitor", *spans, turn=at[2])
        case "stool":
            return _between(piece, "stool", _around(a, size[0]), _around(at[1], size[0]), (0, size[1]), turn=at[2])
        case "carton" | "rug":
            height = size[2] if piece == "carton" else 0.012
            return _between(piece, piece, _around(a, size[0]), _around(at[1], size[1]), (0, height), turn=at[2])
        case "shelf":
            return _between(piece, "shelf", _around(a, size[0]), (0, size[1]), (0, size[2]))
        case "curtain":
            return _between(piece, "curtain", (0, 0.05), _around(a, size[0]), (0.2, 0.2 + size[1]))
    raise ValueError(piece)


def bureau(name, random, *, leave_out=(), **fixed) -> list[Polygon]:
    """One room of the kind of `office`, about 5 x 4 x 2.8 m, its corner at the origin.

    Furniture stands at the walls y = max and x = max.  Every piece has its own size and place, drawn by `random`;
    `fixed` overrides some of `drawn_places`.  Pieces stand on the floor, on each other or at a wall; all but the shell
    and the lamp are closed boxes.
    """
    x, y, z = (m + s * random.uniform(-1, 1) for m, s in ((5.0, 0.35), (4.0, 0.3), (2.8, 0.1)))
    places = drawn_places(random, x, y) | fixed
    p = room(x, y, z)
    for piece in places:
        if piece not in leave_out:
            p += furniture(piece, places, x, y)
    p += [lamp("lamp", "lamp", (x / 2 + 0.1, y / 2), 1.2, 0.6, z - 0.05)]
    return [Polygon(f"{name}-{q.object}", q.group, q.points) for q in p]


# ---- three rooms and a pair of cameras ----


@dataclass(frozen=True)
class Building:
    """What a stereo scene's seed decides."""

    name: str
    lenses: tuple[Lens, Lens]
    tint: tuple  # of the lamps
    gamma: float
    noise: float  # of the sensor
    level: float  # mean radiosity, see `exposed`
    rooms: tuple  # names, along x
    seen: str  # the room that the cameras see
    T_world_building: np.ndarray
    T_right_left: np.ndarray
    eye: tuple = (0.45, 0.66, 1.60)  # of the left camera, in its room, m
    target: tuple = (3.75, 2.72, 0.93)  # what it looks at
    furniture: dict = field(default_factory=dict)  # of the seen room: what replaces drawn places
    mirrored: bool = False  # in x, so that no turn makes it the building of another seed
    pinholes: bool = False  # given; else the lenses distort, and there are chessboards


BUILDINGS = (
    Building(
        name="office-stereo",
        lenses=(
            Lens((461.3, 460.7, 322.6, 237.1), (-0.182, 0.061, 0.0007, -0.0005, 0.004, 0.021, -0.006, 0.002)),
            Lens((458.9, 459.4, 316.2, 242.8), (-0.171, 0.049, -0.0004, 0.0006, 0.007, 0.018, -0.004, 0.003)),
        ),
        tint=(1.0, 0.95, 0.86),
        gamma=2.1,
        noise=0.007,
        level=0.25,
        rooms=("east", "middle", "west"),
        seen="middle",
        T_world_building=upright(0.35, (12.4, -3.1, 0.6)),
        T_right_left=look((0.385, 0.012, 0.018), (0.015, -0.02, 3.05), (0.007, -1, 0)),
    ),
    Building(
        name="office-stereo-1",
        lenses=(
            Lens((488.2, 488.9, 314.8, 243.5), (-0.142, 0.038, -0.0006, 0.0004, -0.002, 0.011, 0.003, -0.001)),
            Lens((491.7, 491.1, 323.9, 235.2), (-0.128, 0.031, 0.0005, 0.0007, 0.001, 0.014, 0.002, -0.001)),
        ),
        tint=(1.0, 0.91, 0.78),
        gamma=1.9,
        noise=0.006,
        level=0.23,
        rooms=("c", "b", "a"),
        seen="a",
        T_world_building=upright(-1.1, (-7.2, 21.5, 3.4)),
        T_right_left=look((0.30, -0.009, 0.004), (-0.02, 0.01, 2.9), (-0.005, -1, 0)),
        eye=(0.42, 0.58, 1.66),
        target=(3.75, 2.75, 0.93),
        furniture={"blackboard": ((2.8, 1.45), (1.25, 0.90)), "rug": ((2.9, 2.3, -0.25), (0.85, 1.15))},
        mirrored=True,
    ),
    Building(
        name="office-stereo-grey",
        lenses=(Lens((438.0, 438.0, 321.0, 238.5)), Lens((441.0, 441.0, 318.5, 241.0))),
        tint=(1.0, 1.0, 1.0),
        gamma=2.2,
        noise=0.005,
        level=0.24,
        rooms=("left", "centre", "right"),
        seen="left",
        T_world_building=upright(2.2, (3.0, 8.0, 0)),
        T_right_left=look((0.45, 0, 0.03), (0.02, 0.015, 3.1), (0.003, -1, 0)),
        pinholes=True,
    ),
)


def office_stereo(seed=0) -> Recipe:
    """Three such rooms in one model, shut off from each other; a pair of cameras sees one of them.

    Seed 1 is another building, mirrored, with other paints, lenses, angle and lamp.  Seed 2 is another one in grey,
    seen through pinholes that are given.
    """
    building, random = BUILDINGS[seed], np.random.default_rng([11, seed])
    materials = _paints(seed, random)
    polygons, T_left = _built(building, random)
    seen = [q for q in polygons if q.object.startswith(building.seen + "-")]
    E = exposed(seen, materials, {"lamp": building.tint}, building.level)
    return Recipe(
        building.name,
        tuple(polygons),
        materials,
        {"lamp": scaled(E, building.tint)},
        gamma=building.gamma,
        K=building.lenses[0].K,
        size=(640, 480),
        T_cam_world=T_left,
        channels=1 if building.pinholes else 3,
        about="An office among three in one model, seen by a stereo pair"
        + ("; grey, pinholes" if building.pinholes else " with distorting lenses")
        + (f", seed {seed}" if seed else "")
        + "; the lamps' emittance is known",
        pair=_pair(building, seed),
    )


def _paints(seed, random):
    """group -> rho_d."""
    materials = dict(_BUREAU)
    if seed:
        dark = ("blackboard", "monitor")
        materials = repainted(materials, random, lighter=0.06, tinted=0.08, dark=dark, usual=(0.07, 0.70))
    if seed == 2:
        materials = {g: (round(float(np.mean(rho)), 3),) * 3 for g, rho in materials.items()}
        materials |= {"carton": (0.58,) * 3, "desk": (0.20,) * 3, "shutter": (0.15,) * 3}  # else they match the floor
    return materials


def _built(building, random):
    """(polygons of all rooms, T_left_world).  The seen room is furnished in full, the others lack this and that."""
    lacking = (("carton", "stool"), ("rug", "monitor"), ("poster", "carton"))
    side = -1 if building.mirrored else 1
    polygons, x0 = [], 0.0
    for name, missing in zip(building.rooms, lacking, strict=True):
        if name == building.seen:
            furnished = bureau(name, random, leave_out=("shelf", "curtain"), **building.furniture)
        else:
            furnished = bureau(name, random, leave_out=missing)
        T_room = building.T_world_building @ upright(0, (side * x0, 0, 0))
        polygons += moved(furnished, T_room, mirror=building.mirrored)
        if name == building.seen:
            eye, target = (
                T_room[:3, :3] @ (np.array([side, 1, 1]) * q) + T_room[:3, 3] for q in (building.eye, building.target)
            )
            T_left = look(eye, target)
        x0 += max(q.points[:, 0].max() for q in furnished) + 0.2  # walls of 0.2 m
    return polygons, T_left


def _pair(building, seed) -> Pair:
    """The cameras.  Given pinholes have a common frame that is neither's own; other lenses have a chessboard."""
    T_left_ref, board = np.eye(4), None
    if building.pinholes:
        T_left_ref = np.linalg.inv(look((0.2, 0.02, -0.01), (0.2, 0.1, 3.0), (0, -1, 0)))
    else:
        board = _held_board(building, seed)
    return Pair(building.lenses, building.T_right_left, building.seen + "-", building.noise, board, T_left_ref)


def _held_board(building, seed) -> Board:
    random = np.random.default_rng([12, seed])
    return shots((10, 7), 0.04, building.lenses, building.T_right_left, (640, 480), random)
