"""Rooms that nobody tuned on: every seed is another closed room, furnished, painted, lit and photographed at random.

    recipe = random_room(101)            # the same every time; seeds are numbers or words
    recipe = random_room(201, size=(400, 300))

All that stands in a room is a closed solid.  It touches the floor, a wall or what it stands on, and is clear of all
else.  A draw that would not do (something overlaps, a thing on the floor is hardly seen) is thrown away, and the same
generator draws again.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from lib.synthetic.geometry import box, lamp, prism, regular, room, upright
from lib.synthetic.geometry import moved as displaced
from lib.synthetic.optics import look, pinhole
from lib.synthetic.recipe import Recipe, Surface, exposed, scaled
from lib.synthetic.sight import coarse_view
from lib.synthetic.textured import over, picture_image, planks_image

FREE_PX = 2000  # so many pixels show each free-standing thing of a picture of 640 x 480
GROUP_PX = 1000  # and so many most groups
MOST = 0.75  # of the groups
GROUPS = (10, 16)  # the lamps' included
ALWAYS = ("floor", "ceiling", "wall")  # groups that every picture shows
MIRROR = 0.02  # of the picture shows the mirror, at least
PICTURE = 0.01  # of the picture shows the printed one, at least
CLEAR_M = 0.14  # between a free-standing thing and all else
BRIGHTEST = 0.8  # the radiosity that 2 % of the picture exceed
STEP = 5  # px between the rays that look whether a draw will do


def random_room(seed, *, size=(640, 480)) -> Recipe:
    """The room of a seed: a number or a word; "101" is 101."""
    random = np.random.default_rng(list(str(seed).encode()))
    while True:
        recipe = _photographed(seed, size, _furnished(random), random)
        if recipe:
            return recipe


def white_room(which, *, size=(400, 300)) -> Recipe:
    """A white room with a narrow gap: a board before a wall, or boards above each other.

    which : "<gap in mm>-<seed>", or "shelves-<seed>": four boards 20 mm apart
    """
    random = np.random.default_rng(list(f"white-{which}".encode()))
    gap = which.partition("-")[0]
    while True:
        recipe = _photographed(which, size, _with_gap(random, gap), random, _whites)
        if recipe:
            return recipe


def lobed_room(seed, *, size=(400, 300)) -> Recipe:
    """A random room whose lamps throw their light in lobes, downwards and aside; its scene.yaml does not say so."""
    random = np.random.default_rng(list(f"lobed-{seed}".encode()))
    recipe = random_room(f"lobed-{seed}", size=size)
    lobes, lamps = {}, {}
    for group, E in recipe.lamps.items():
        aim = np.array([*random.uniform(-0.6, 0.6, 2), -1.0])
        exponent = round(float(random.uniform(0.5, 4)), 2)
        lobes[group] = tuple((aim / np.linalg.norm(aim)).tolist()), exponent
        lamps[group] = scaled(1 + 0.35 * exponent, E)  # about as much light in all
    return replace(recipe, lamps=lamps, lobes=lobes)


def mirrored_room(seed, *, size=(400, 300)) -> Recipe:
    """A random room with a mirror on a wall, perfect or of a colour; its scene.yaml does not say so."""
    random = np.random.default_rng(list(f"mirrored-{seed}".encode()))
    recipe = _with_plate(random, "mirrored", size, "mirror", MIRROR)
    tint = random.uniform(0.7, 0.95) * random.uniform(0.9, 1, 3) if random.random() < 0.5 else np.ones(3)
    kind = "mirror" if (tint == 1).all() else "coloured_mirror"
    return replace(
        recipe,
        materials=recipe.materials | {"mirror": (0.0, 0.0, 0.0)},
        surfaces={"mirror": Surface(kind, tuple(map(float, np.round(tint, 3))))},
    )


def textured_room(seed, *, size=(400, 300)) -> Recipe:
    """A random room with a printed picture on a wall, over a floor of planks; its scene.yaml does not say so."""
    random = np.random.default_rng(list(f"textured-{seed}".encode()))
    recipe = _with_plate(random, "textured", size, "picture", PICTURE)
    hung = recipe.polygons
    picture, floor = (next(p.points for p in hung if p.group == group) for group in ("picture", "floor"))
    textures = {
        "picture": over(picture, picture_image(random), upright=True),
        "floor": over(floor, planks_image(*np.linalg.norm(floor[[3, 1]] - floor[0], axis=1), random)),
    }
    return replace(
        recipe,
        materials=recipe.materials | {group: texture.mean() for group, texture in textures.items()},
        surfaces={group: Surface("textured", texture=texture) for group, texture in textures.items()},
    )


def _with_plate(random, kind, size, group, least) -> Recipe:
    """A random room whose picture shows the front of its largest plate, of a group of its own, by such a share."""
    while True:
        recipe = random_room(f"{kind}-{random.integers(1 << 30)}", size=size)
        polygons = _with_front(recipe.polygons, group)
        number, _ = coarse_view(polygons, recipe.K, size, recipe.T_cam_world, STEP)
        if np.mean([n >= 0 and polygons[n].group == group for n in number]) > least:
            return replace(recipe, polygons=polygons)


def _with_front(polygons, group) -> tuple:
    """The front of the largest plate in a group of its own, its edges as they were."""
    plates = [p for p in polygons if p.object.startswith("plate")]
    middle = np.mean([p.points.mean(axis=0) for p in polygons if p.object.startswith("floor")], axis=0)
    largest = max(p.area() for p in plates)
    fronts = [p for p in plates if p.area() > 0.99 * largest]
    front = max(fronts, key=lambda p: p.normal() @ (middle - p.points.mean(axis=0)))
    return tuple(replace(p, group=group) if p is front else p for p in polygons)


# ---- furniture ----


class _NoPlace(Exception):
    """A thing found no place."""


@dataclass
class _Room:
    """A room while it is furnished; walls y = 0, x = X, y = Y, x = 0, the camera's corner near (0, 0)."""

    X: float
    Y: float
    Z: float
    random: np.random.Generator
    polygons: list = field(default_factory=list)
    taken: list = field(default_factory=list)  # (low, high) m of what stands, one pair of corners each
    free: list = field(default_factory=list)  # names of free-standing objects

    def number(self, low, high) -> float:
        """A random number of whole millimetres."""
        return round(float(self.random.uniform(low, high)), 3)

    def chance(self, p) -> bool:
        return bool(self.random.random() < p)

    def take(self, low, high, clear) -> bool:
        """Whether the place between two corners is free with so much air around; it is taken then."""
        low, high = np.asarray(low, float), np.asarray(high, float)
        if any((low - clear < b).all() and (high + clear > a).all() for a, b in self.taken):
            return False
        self.taken.append((low, high))
        return True

    def at_wall(self, wall, width, depth, z, clear=0.03) -> tuple:
        """(low, high) of a free place along a wall, "x" (x = X) or "y" (y = Y)."""
        length = self.Y if wall == "x" else self.X
        for _ in range(40):
            a = self.number(0.8, max(0.81, length - width - 0.1))
            if wall == "x":
                low, high = (self.X - depth, a, z[0]), (self.X, a + width, z[1])
            else:
                low, high = (a, self.Y - depth, z[0]), (a + width, self.Y, z[1])
            if (np.array(high) <= (self.X, self.Y, self.Z)).all() and self.take(low, high, clear):
                return low, high
        raise _NoPlace

    def on_floor(self, outline, height) -> np.ndarray:
        """The outline (n, 2) about (0, 0), moved to a free place away from all walls."""
        low, high = outline.min(0), outline.max(0)
        for _ in range(60):
            at = np.array([self.number(1.0, self.X - 0.3), self.number(1.0, self.Y - 0.3)])
            a, b = at + low, at + high
            if (b + 0.2 < (self.X, self.Y)).all() and self.take((*a, 0), (*b, height), CLEAR_M):
                return outline + at
        raise _NoPlace


def _furnished(random) -> _Room:
    """A room with all that stands in it; drawn until everything has a place."""
    while True:
        X, Y = random.uniform(3.7, 6.0), random.uniform(3.2, 5.0)
        r = _Room(round(X, 2), round(Y, 2), round(random.uniform(2.5, 3.2), 2), random)
        r.polygons += room(r.X, r.Y, r.Z, walls=_walls(r))
        r.taken.append((np.zeros(3), np.array([0.9, 0.9, r.Z])))  # where the camera is
        furniture = [_cabinet, _table, _shelf, _plate, *(_extra(r) for _ in range(random.integers(0, 3)))]
        try:
            for number in range(1, random.integers(1, 4) + 1):
                _free_standing(r, number)
            for number, add in enumerate(furniture):
                add(r, number)
            _lamps(r)
        except _NoPlace:
            continue
        groups = len({p.group for p in r.polygons})
        if GROUPS[0] <= groups <= GROUPS[1]:
            return r


def _with_gap(random, gap) -> _Room:
    """A room with a box, a lamp, and boards that leave a narrow gap at the far wall."""
    while True:
        X, Y = random.uniform(3.2, 4.5), random.uniform(3.0, 4.0)
        r = _Room(round(X, 2), round(Y, 2), round(random.uniform(2.4, 2.8), 2), random)
        r.polygons += room(r.X, r.Y, r.Z)
        r.taken.append((np.zeros(3), np.array([0.9, 0.9, r.Z])))
        a, w, z = r.number(0.9, 1.4), r.number(1.0, 1.6), r.number(0.7, 1.0)
        if gap == "shelves":
            for k in range(4):
                low = (a, r.Y - 0.3, z + 0.035 * k)
                r.polygons += box(f"board-{k}", "board", low, (a + w, r.Y, low[2] + 0.015))
        else:
            front = r.Y - 1e-3 * float(gap)
            r.polygons += box("board", "board", (a, front - 0.02, z), (a + w, front, z + r.number(0.6, 0.9)))
        try:
            _free_standing(r, 1)
            _lamps(r)
        except _NoPlace:
            continue
        return r


def _walls(r):
    """The groups of the four walls: one of the far ones may have a colour of its own."""
    accent = r.random.integers(0, 4)
    return tuple("accent" if wall == accent else "wall" for wall in range(4)) if accent in (1, 2) else ("wall",) * 4


def _free_standing(r, number):
    """A thing away from all walls: a box, turned, or a prism."""
    name = ("crate", "stool", "case")[number - 1]
    if r.chance(0.6):
        w, d, height = r.number(0.3, 0.7), r.number(0.3, 0.6), r.number(0.3, 0.9)
        T = upright(r.number(-0.8, 0.8), (0, 0, 0))[:2, :2]
        outline = np.array([[-w, -d], [w, -d], [w, d], [-w, d]]) / 2 @ T.T
    else:
        height, corners = r.number(0.4, 0.9), int(r.random.integers(5, 9))
        outline = regular((0, 0), r.number(0.2, 0.32), corners, r.number(0, 1))
    top = {"top": f"{name}-top"} if r.chance(0.3) else {}
    r.polygons += prism(name, name, r.on_floor(outline, height), 0, height, **top)
    r.free.append(name)


def _cabinet(r, number):
    """A cabinet at a far wall, perhaps with a door on its front, perhaps with a carton on top."""
    name, wall = f"cabinet-{number}", "xy"[r.random.integers(2)]
    low, high = r.at_wall(wall, r.number(0.6, 1.2), r.number(0.35, 0.6), (0, r.number(0.8, 1.9)))
    r.polygons += box(name, name, low, high)
    if high[2] < 1.5 and r.chance(0.5):
        _on_top(r, f"carton-{number}", low, high, r.number(0.15, 0.35))
    if r.chance(0.4):
        (x0, y0, z0), (x1, y1, z1) = low, high
        thick, rim = r.number(0.015, 0.03), 0.04
        front = ((x0 - thick, y0 + rim, z0 + rim), (x0, y1 - rim, z1 - rim))
        if wall == "y":
            front = ((x0 + rim, y0 - thick, z0 + rim), (x1 - rim, y0, z1 - rim))
        r.polygons += box(f"leaf-{number}", f"leaf-{number}", *front)


def _table(r, number):
    """A table of boxes at a far wall, and something on it."""
    wall, height = "xy"[r.random.integers(2)], r.number(0.65, 0.8)
    low, high = r.at_wall(wall, r.number(0.9, 1.5), r.number(0.55, 0.8), (0, height))
    top, thick, inset = r.number(0.03, 0.05), r.number(0.03, 0.06), r.number(0.03, 0.1)
    (x0, y0, _), (x1, y1, z1) = low, high
    r.polygons += box(f"table-{number}", f"table-{number}", (x0, y0, z1 - top), high)
    along = 1 if wall == "x" else 0
    for end, at in (("left", low[along] + inset), ("right", high[along] - inset - thick)):
        a, b = [x0 + 0.05, y0 + 0.05, 0], [x1, y1, z1 - top]
        a[along], b[along] = at, at + thick
        r.polygons += box(f"table-{number}-{end}", f"panel-{number}", a, b)
    _on_top(r, f"thing-{number}", low, high, r.number(0.15, 0.45))


def _on_top(r, name, low, high, height):
    """A turned box or a prism on a thing's top face."""
    (x0, y0, _), (x1, y1, z) = low, high
    half = r.number(0.3, 0.42) * min(x1 - x0, y1 - y0)
    at = (r.number(x0 + half, x1 - half), r.number(y0 + half, y1 - half))
    outline = regular(at, half, int(r.random.integers(4, 8)), r.number(0, 1.5))
    if not r.take((*outline.min(0), z + 0.001), (*outline.max(0), z + height), 0):
        raise _NoPlace
    r.polygons += prism(name, name, outline, z, z + height)


def _shelf(r, number):
    """One or two boards on a far wall, the lower one with a book on it."""
    wall, width, depth = "xy"[r.random.integers(2)], r.number(0.7, 1.4), r.number(0.2, 0.32)
    z, boards, gap = r.number(1.15, 1.5), int(r.random.integers(1, 3)), r.number(0.35, 0.5)
    low, high = r.at_wall(wall, width, depth, (z, z + 0.04 + (boards - 1) * gap + 0.3))
    for k in range(boards):
        z0 = z + k * gap
        r.polygons += box(f"shelf-{number}-{k}", f"shelf-{number}", (*low[:2], z0), (*high[:2], z0 + 0.04))
    if boards == 1 or r.chance(0.5):
        half = 0.4 * depth
        at = [r.number(low[i] + half, high[i] - half) for i in (0, 1)]
        corners = (at[0] - half, at[1] - half, z + 0.04), (at[0] + half, at[1] + half, z + 0.04 + r.number(0.15, 0.28))
        r.polygons += box(f"book-{number}", f"book-{number}", *corners)


def _plate(r, number):
    """A board on a far wall."""
    wall, z = "xy"[r.random.integers(2)], r.number(0.9, 1.2)
    size = r.number(0.7, 1.5), r.number(0.015, 0.04)
    low, high = r.at_wall(wall, *size, (z, z + r.number(0.5, 1.0)))
    r.polygons += box(f"plate-{number}", f"plate-{number}", low, high)


def _door(r, number):
    """A door leaf on a far wall."""
    low, high = r.at_wall(
        "xy"[r.random.integers(2)], r.number(0.7, 0.95), r.number(0.03, 0.05), (0, r.number(1.9, 2.1))
    )
    r.polygons += box(f"door-{number}", f"door-{number}", low, high)


def _extra(r):
    """One more thing at a wall."""
    return (_cabinet, _plate, _door, _shelf)[r.random.integers(4)]


def _lamps(r):
    """One or two panels that shine down, just below the ceiling or hanging, clear of the walls."""
    number = int(r.random.integers(1, 3))
    drop = r.number(0.03, 0.08) if r.chance(0.6) else r.number(0.2, max(0.21, r.Z - 2.2))
    for k in range(number):
        w, d = r.number(0.3, 1.2), r.number(0.3, 1.0)
        x, y = r.number(0.35 * r.X, 0.75 * r.X), r.number(0.3 * r.Y, 0.75 * r.Y)
        low, high = (x - w / 2, y - d / 2, r.Z - drop - 0.02), (x + w / 2, y + d / 2, r.Z - drop)
        clear = min(low[0], low[1], r.X - high[0], r.Y - high[1]) > 0.4
        if not (clear and r.take(low, high, 0.15)):
            raise _NoPlace
        group = f"lamp-{k + 1}" if number > 1 else "lamp"
        r.polygons.append(lamp(group, group, (x, y), w, d, r.Z - drop))


# ---- paint, light, camera ----


def _paints(groups, random) -> dict:
    """group -> rho_d: a brightness, and for most groups a colour."""
    usual = {"wall": (0.5, 0.82), "ceiling": (0.6, 0.85), "floor": (0.15, 0.6), "accent": (0.2, 0.7)}
    out = {}
    for group in groups:
        mean = random.uniform(*usual.get(group, (0.07, 0.75)))
        tint = 0.05 if group in ("wall", "ceiling") or random.random() < 0.3 else 0.55
        out[group] = tuple(map(float, np.round(np.clip(mean * random.uniform(1 - tint, 1 + tint, 3), 0.05, 0.85), 3)))
    return out


def _whites(groups, random) -> dict:
    """group -> rho_d: the white of a wall for all of them."""
    return {group: (round(float(random.uniform(0.8, 0.88)), 3),) * 3 for group in groups}


def _photographed(seed, size, r, random, paints=_paints) -> Recipe | None:
    """The recipe of a furnished room; None where its camera does not see enough."""
    T_room, polygons = _in_place(r, random)
    eye = np.array([random.uniform(0.3, 0.6), random.uniform(0.3, 0.6), random.uniform(1.35, 1.85)])
    target = np.array([random.uniform(0.65, 0.9) * r.X, random.uniform(0.6, 0.85) * r.Y, random.uniform(0.7, 1.2)])
    T = look(T_room[:3, :3] @ eye + T_room[:3, 3], T_room[:3, :3] @ target + T_room[:3, 3])
    K = pinhole(*size, round(random.uniform(375, 430) * size[0] / 640, 1))
    number, p_world = coarse_view(polygons, K, size, T, STEP)
    groups = dict.fromkeys(p.group for p in polygons)
    lamps = [g for g in groups if g.startswith("lamp")]
    if not _seen(polygons, number, r.free, [g for g in groups if g not in lamps], size):
        return None
    materials = paints([g for g in groups if g not in lamps], random)
    tints = {g: (1.0, random.uniform(0.85, 1.0), random.uniform(0.65, 1.0)) for g in lamps}
    tints = {g: tuple(np.round(random.uniform(0.6, 1.4) * np.array(t), 3)) for g, t in tints.items()}
    E = _exposure(polygons, materials, tints, number, p_world, random)
    return Recipe(
        f"room-{seed}",
        tuple(polygons),
        materials,
        {g: scaled(E, tint) for g, tint in tints.items()},
        gamma=round(float(random.uniform(1.6, 2.6)), 2),
        K=K,
        size=size,
        T_cam_world=T,
        about=f"Random room {seed}, that nobody tuned on; the emittance of its lamps is known",
    )


def _in_place(r, random) -> tuple:
    """(T (4, 4), polygons): the room turned by quarters, so that any corner may be the camera's."""
    quarters = int(random.integers(4))
    T = upright(0, (0, 0, 0))
    for _ in range(quarters):
        T = np.round(upright(np.pi / 2, (0, 0, 0))) @ T
    corners = np.array([[0, 0, 0], [r.X, r.Y, 0]]) @ T[:3, :3].T
    T[:3, 3] = -corners.min(0)
    return T, displaced(r.polygons, T)


def _seen(polygons, number, free, groups, size) -> bool:
    """Whether the camera sees every free-standing thing, most groups, and the room's inside everywhere."""
    scale = size[0] * size[1] / (640 * 480)
    count = np.bincount(number[number >= 0], minlength=len(polygons)) * STEP**2
    pixels = lambda of: sum(count[i] for i, p in enumerate(polygons) if of(p))
    things = [pixels(lambda p, name=name: p.object == name) for name in free]
    shares = [pixels(lambda p, group=group: p.group == group) for group in groups]
    most = np.mean([n >= 1.1 * GROUP_PX * scale for n in shares])
    large = all(n >= GROUP_PX * scale for n, group in zip(shares, groups, strict=True) if group in ALWAYS)
    return bool(min(things) >= 1.1 * FREE_PX * scale and most >= MOST and large and (number >= 0).all())


def _exposure(polygons, materials, tints, number, p_world, random) -> float:
    """The factor on the lamps: mean radiosity as in other rooms, but not so much that bright places saturate."""
    level = exposed(polygons, materials, tints, random.uniform(0.15, 0.28))
    B = np.zeros((len(number), 3))
    for p in (p for p in polygons if p.group in tints):
        B += _direct(polygons, materials, p, tints[p.group], number, p_world)
    B += _level_of_the_rest(polygons, materials, tints)
    return float(f"{min(level, BRIGHTEST / np.quantile(B.max(-1), 0.98)):.3g}")


def _direct(polygons, materials, lamp, tint, number, p_world):
    """(n, 3) radiosity that a lamp gives to points, shadows apart; the lamp as 9 points."""
    n = np.array([p.normal() for p in polygons])[number]
    rho = np.array([materials.get(p.group, (0, 0, 0)) for p in polygons])[number]
    (a, b, _, d), total = lamp.points, np.zeros(len(number))
    for s in (1 / 6, 1 / 2, 5 / 6):
        for t in (1 / 6, 1 / 2, 5 / 6):
            v = a + s * (b - a) + t * (d - a) - p_world
            distance = np.maximum(np.linalg.norm(v, axis=-1), 0.2)
            cosines = np.abs((v * n).sum(-1)) * np.maximum(v[:, 2], 0) / distance**2
            total += cosines / (np.pi * distance**2) * lamp.area() / 9
    return rho * total[:, None] * np.asarray(tint)


def _level_of_the_rest(polygons, materials, tints) -> float:
    """Mean radiosity of light that was reflected twice or more: by the flux balance of a closed room."""
    S = sum(p.area() for p in polygons if p.group in materials)
    rho = sum(p.area() * np.mean(materials[p.group]) for p in polygons if p.group in materials) / S
    flux = sum(p.area() * np.mean(tints[p.group]) for p in polygons if p.group in tints)
    return float(rho * rho * flux / (S * (1 - rho)))
