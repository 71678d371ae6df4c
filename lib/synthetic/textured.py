"""The recipe with textures: a printed poster and a woven rug."""

import functools

import numpy as np

from lib.synthetic.geometry import box, lamp, on_wall, prism, regular, room
from lib.synthetic.optics import look, pinhole
from lib.synthetic.recipe import Recipe, Surface, Texture, lit_room

_GLYPHS = {  # rows of five, from the top
    "R": "11110 10001 10001 11110 10100 10010 10001",
    "A": "01110 10001 10001 11111 10001 10001 10001",
    "D": "11110 10001 10001 10001 10001 10001 11110",
    "I": "01110 00100 00100 00100 00100 00100 01110",
    "O": "01110 10001 10001 10001 10001 10001 01110",
    "S": "01111 10000 10000 01110 00001 00001 11110",
    "T": "11111 00100 00100 00100 00100 00100 00100",
    "Y": "10001 10001 01010 00100 00100 00100 00100",
}


def _canvas(width, height, fine, colour):
    """((height fine, width fine, 3) of one colour, x, y): x and y in px of the finished picture."""
    y, x = np.mgrid[: height * fine, : width * fine] + 0.5
    x, y = x / fine, y / fine
    return np.array(colour) + np.zeros((*x.shape, 3)), x, y


def _averaged(canvas, fine):
    """The finished picture: means over fine x fine, exactly as the EXR's half floats hold them."""
    height, width, _ = canvas.shape
    mean = canvas.reshape(height // fine, fine, width // fine, fine, 3).mean((1, 3))
    return mean.astype(np.float16).astype(float)


@functools.cache
def poster_image(width=420, height=300, fine=4) -> np.ndarray:
    """(height, width, 3) reflectances of a printed poster: a soft photograph, letters, figures, stripes.

    It is drawn `fine` times as large, then averaged.
    """
    random = np.random.default_rng(23)
    out, x, y = _canvas(width, height, fine, [0.34, 0.40, 0.46])
    for _ in range(9):  # the photograph: soft blobs of colour
        at = random.uniform((0, 0), (width, height))
        size, colour = random.uniform(40, 110), random.uniform(-0.26, 0.30, 3)
        out += np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * size**2))[..., None] * colour
    margin = (x < 12) | (x > width - 12) | (y < 12) | (y > height - 12)
    out[(y > 20) & (y < 86) & ~margin] = (0.78, 0.76, 0.70)  # a pale bar with the title
    for k, letter in enumerate("RADIOSITY"):
        for i, row in enumerate(_GLYPHS[letter].split()):
            for j, on in enumerate(row):
                if on == "1":
                    x0, y0 = 31 + 41 * k + 7 * j, 28 + 7.2 * i
                    out[(x >= x0) & (x < x0 + 7) & (y >= y0) & (y < y0 + 7.2)] = (0.06, 0.07, 0.12)
    out[(x - 92) ** 2 + (y - 196) ** 2 < 52**2] = (0.62, 0.12, 0.09)  # a disc in a ring
    out[(x - 92) ** 2 + (y - 196) ** 2 < 31**2] = (0.80, 0.62, 0.16)
    out[(y > 150) & (np.abs(x - 196) < (y - 150) * 0.46) & (y < 244)] = (0.10, 0.34, 0.26)  # a triangle
    columns = (x > 268) & (x < 388)
    upright = columns & (y > 150) & (y < 196) & (np.floor(x / 3) % 2 == 0)  # stripes of 3 px
    slanting = columns & (y > 204) & (y < 248) & (np.floor((x + y) / 6) % 2 == 0)
    out[upright], out[slanting], out[margin] = (0.08, 0.08, 0.09), (0.74, 0.72, 0.66), (0.84, 0.83, 0.80)
    return _averaged(np.clip(out, 0.04, 0.86), fine)


@functools.cache
def rug_image(width=288, height=192, fine=4) -> np.ndarray:
    """(height, width, 3) of a woven rug: borders, diamonds, bands."""
    out, x, y = _canvas(width, height, fine, [0.40, 0.10, 0.10])
    edge = np.minimum(np.minimum(x, width - x), np.minimum(y, height - y))
    out[np.floor(y / 12) % 4 == 1] = (0.46, 0.15, 0.12)
    for k in range(4):
        distance = np.abs(x - 54 - 60 * k) / 26 + np.abs(y - height / 2) / 58
        out[distance < 1] = (0.10, 0.16, 0.34)
        out[distance < 0.62] = (0.68, 0.58, 0.36)
        out[distance < 0.28] = (0.14, 0.30, 0.20)
    out[edge < 24] = (0.12, 0.14, 0.30)
    out[(edge < 18) & (edge > 12)] = (0.66, 0.56, 0.34)
    out[edge < 6] = (0.56, 0.50, 0.40)
    return _averaged(out, fine)


def picture_image(random, width=280, height=200, fine=2) -> np.ndarray:
    """(height, width, 3) of another printed picture: a soft photograph, bars and discs in a pale margin."""
    out, x, y = _canvas(width, height, fine, random.uniform(0.2, 0.5, 3))
    for _ in range(8):
        at, size = random.uniform((0, 0), (width, height)), random.uniform(25, 80)
        out += np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * size**2))[..., None] * random.uniform(-0.25, 0.3, 3)
    for _ in range(random.integers(2, 6)):
        at, size = random.uniform((20, 20), (width - 20, height - 20)), random.uniform(6, 35, 2)
        inside = (np.abs(x - at[0]) < size[0]) & (np.abs(y - at[1]) < size[1])
        if random.random() < 0.5:
            inside = (x - at[0]) ** 2 + (y - at[1]) ** 2 < size[0] ** 2
        out[inside] = random.uniform(0.05, 0.8, 3)
    out[(np.minimum(x, width - x) < 9) | (np.minimum(y, height - y) < 9)] = random.uniform(0.6, 0.85)
    return _averaged(np.clip(out, 0.04, 0.86), fine)


def planks_image(length, width, random, fine=2) -> np.ndarray:
    """(h, w, 3) of a floor of length x width m, 1 px is 1 cm: planks of wood, no two alike, with joints and grain."""
    out, x, y = _canvas(int(100 * length), int(100 * width), fine, random.uniform(0.25, 0.5) * np.array([1, 0.8, 0.6]))
    broad, long = random.uniform(9, 18), random.uniform(80, 180)
    row = np.floor(y / broad).astype(int)
    along = x + random.uniform(0, long, row.max() + 1)[row]
    plank = row * 1000 + np.floor(along / long).astype(int)
    tone = random.uniform(0.75, 1.25, plank.max() + 1)[plank]
    grain = 1 + 0.06 * np.sin(2 * np.pi * (y / random.uniform(1.5, 4) + 0.8 * np.sin(x / random.uniform(15, 60))))
    joint = (y % broad < 0.5) | (along % long < 0.5)
    out *= (tone * grain * np.where(joint, 0.5, 1))[..., None]
    return _averaged(np.clip(out, 0.03, 0.9), fine)


def over(corners, image, upright=False) -> Texture:
    """An image over a rectangle, corners (4, 3) counter-clockwise from the front. upright : its last row is lowest"""
    first = int(np.argmax(corners[:, 2] - 1e-3 * np.arange(4))) if upright else 0
    corners = np.roll(corners, -first, axis=0)
    if upright and np.linalg.norm(corners[1, :2] - corners[0, :2]) > 1e-6:  # the right one of the upper corners
        corners = np.roll(corners, -1, axis=0)
    return Texture(image, corners[0], corners[3] - corners[0], corners[1] - corners[0])


def poster() -> Recipe:
    """A room with a printed poster on the wall and a woven rug on the floor, both textured.

    Everything else has one reflectance each.
    """
    x, y, z = 4.6, 3.8, 2.6
    turn = np.array([np.cos(0.12), np.sin(0.12), 0])
    across = np.array([-turn[1], turn[0], 0])  # along the rug's long side
    rug_at = np.array([2.98, 1.22, 0.012])  # its corner
    textures = {
        "poster": Texture(
            poster_image(),
            origin=np.array([x - 0.02, 2.72, 1.95]),
            u=np.array([0, -1.40, 0.0]),
            v=np.array([0, 0, -1.00]),
        ),
        "rug": Texture(rug_image(), rug_at + 1.35 * across + 0.90 * turn, -1.35 * across, -0.90 * turn),
    }
    surfaces = {g: Surface("textured", texture=t) for g, t in textures.items()}
    materials = {
        "wall": (0.68, 0.66, 0.60),
        "floor": (0.44, 0.35, 0.26),
        "ceiling": (0.80, 0.80, 0.78),
        "edge": (0.30, 0.26, 0.22),
        "fringe": (0.50, 0.44, 0.36),
        "bench": (0.34, 0.22, 0.14),
        "crate": (0.24, 0.36, 0.52),
        "stool": (0.58, 0.40, 0.16),
        "cupboard": (0.48, 0.52, 0.46),
        "ball": (0.60, 0.18, 0.14),
    } | {g: t.mean() for g, t in textures.items()}
    p = room(x, y, z)
    p += on_wall("poster", "poster", "edge", ("x", x, -1), (1.32, 2.72), (0.95, 1.95), 0.02)
    corners = np.array([rug_at, rug_at + 0.90 * turn, rug_at + 0.90 * turn + 1.35 * across, rug_at + 1.35 * across])
    p += prism("rug", "fringe", corners[:, :2], 0, 0.012, top="rug")
    p += box("bench", "bench", (4.15, 1.25, 0.38), (4.55, 2.55, 0.44))
    p += box("bench-leg-1", "bench", (4.2, 1.35, 0), (4.5, 1.41, 0.38))
    p += box("bench-leg-2", "bench", (4.2, 2.39, 0), (4.5, 2.45, 0.38))
    p += box("crate", "crate", (4.18, 1.42, 0.44), (4.46, 1.78, 0.68), turn=0.25)
    p += prism("stool", "stool", regular((3.62, 0.70), 0.2, 8, 0.2), 0, 0.46)
    p += box("cupboard", "cupboard", (3.3, 3.35, 0), (4.3, 3.8, 1.5))
    p += prism("ball", "ball", regular((3.45, 3.0), 0.14, 6, 0.5), 0, 0.22)
    p += [lamp("lamp", "lamp", (2.55, 1.75), 1.1, 0.7, z - 0.05)]
    return lit_room(
        "poster",
        p,
        materials,
        tint=(1.0, 0.97, 0.91),
        level=0.24,
        gamma=2.1,
        K=pinhole(640, 480, 405, (3.2, -2.7)),
        T_cam_world=look((1.30, 1.55, 1.62), (4.6, 2.12, 0.98)),
        surfaces=surfaces,
        about="A room with a printed poster and a woven rug; the lamp's emittance is known",
    )
