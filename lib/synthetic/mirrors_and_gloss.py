"""Recipes with mirrors and gloss."""

import numpy as np

from lib.synthetic.geometry import box, framed, lamp, prism, regular, room
from lib.synthetic.optics import look, pinhole
from lib.synthetic.recipe import Recipe, Surface, lit_room

_HALL = {
    "wall": (0.70, 0.68, 0.63),
    "floor": (0.36, 0.29, 0.23),
    "ceiling": (0.79, 0.79, 0.77),
    "frame": (0.44, 0.29, 0.16),
    "desktop": (0.56, 0.42, 0.27),
    "deskpanel": (0.28, 0.32, 0.40),
    "monitor": (0.08, 0.09, 0.12),
    "book": (0.58, 0.13, 0.11),
    "chair": (0.17, 0.24, 0.44),
    "cabinet": (0.46, 0.49, 0.51),
    "door": (0.53, 0.24, 0.17),
    "carton": (0.59, 0.45, 0.29),
    "bin": (0.60, 0.58, 0.21),
    "rug": (0.44, 0.16, 0.17),
    "poster": (0.64, 0.60, 0.33),
    "curtain": (0.24, 0.42, 0.30),
    "bookcase": (0.40, 0.22, 0.10),
    "books": (0.62, 0.52, 0.18),
}


def office_mirror() -> Recipe:
    """An office with a perfect mirror over the desk.  Curtain, bookcase and books are seen in it alone."""
    materials = dict(_HALL) | {"mirror": (0.0, 0.0, 0.0)}
    surfaces = {"mirror": Surface("mirror", (1.0, 1.0, 1.0))}
    x, y, z = 5.0, 4.0, 2.8
    p = room(x, y, z)
    p += framed("mirror", "mirror", "frame", ("x", x, -1), (1.74, 3.08), (1.08, 2.01), 0.03)
    p += box("desktop", "desktop", (4.25, 1.25, 0.72), (5.0, 2.95, 0.76))
    p += box("desk-left", "deskpanel", (4.3, 2.85, 0), (5.0, 2.9, 0.72))
    p += box("desk-right", "deskpanel", (4.3, 1.3, 0), (5.0, 1.35, 0.72))
    p += box("desk-back", "deskpanel", (4.9, 1.35, 0.25), (4.95, 2.85, 0.72))
    p += box("monitor", "monitor", (4.62, 1.30, 0.80), (4.69, 1.84, 1.16), turn=-0.15)
    p += box("stand", "monitor", (4.55, 1.46, 0.76), (4.76, 1.68, 0.80))
    p += box("book", "book", (4.35, 2.45, 0.76), (4.6, 2.83, 0.92), turn=0.25)
    p += box("seat", "chair", (3.62, 1.95, 0.43), (4.1, 2.43, 0.48))
    p += box("chair-back", "chair", (3.62, 1.98, 0.48), (3.66, 2.40, 0.95))
    p += box("runner-left", "chair", (3.62, 2.37, 0), (4.1, 2.42, 0.43))
    p += box("runner-right", "chair", (3.62, 1.96, 0), (4.1, 2.01, 0.43))
    p += box("cabinet", "cabinet", (4.05, 3.5, 0), (4.85, 4.0, 1.6))
    p += box("door", "door", (4.09, 3.47, 0.08), (4.81, 3.5, 1.52))
    p += box("carton", "carton", (3.2, 2.85, 0), (3.65, 3.22, 0.34), turn=0.5)
    p += prism("bin", "bin", regular((4.55, 0.9), 0.15, 6, 0.2), 0, 0.36)
    p += box("rug", "rug", (3.35, 1.0, 0), (4.15, 1.7, 0.012), turn=0.1)
    p += box("poster", "poster", (4.985, 0.45, 1.2), (5.0, 0.85, 1.75))
    p += box("curtain", "curtain", (0, 2.35, 0.15), (0.06, 3.75, 2.4))  # from here on: behind the camera
    p += box("bookcase", "bookcase", (1.0, 3.68, 0), (1.95, 4.0, 1.9), sides={0: "books"})
    p += [lamp("lamp", "lamp", (2.35, 2.05), 1.2, 0.7, z - 0.05)]
    return lit_room(
        "office-mirror",
        p,
        materials,
        tint=(1.0, 0.96, 0.88),
        level=0.24,
        gamma=2.15,
        K=pinhole(640, 480, 415),
        T_cam_world=look((1.72, 1.17, 1.58), (5.0, 2.27, 1.12)),
        surfaces=surfaces,
        about="An office with a mirror over the desk; the lamp's emittance is known",
    )


_PARLOUR = {
    "wall": (0.66, 0.70, 0.68),
    "floor": (0.42, 0.31, 0.20),
    "ceiling": (0.82, 0.81, 0.78),
    "frame": (0.20, 0.15, 0.12),
    "sideboard": (0.36, 0.22, 0.13),
    "drawer": (0.50, 0.34, 0.20),
    "vase": (0.20, 0.36, 0.52),
    "sofa": (0.50, 0.20, 0.16),
    "cushion": (0.66, 0.56, 0.24),
    "table": (0.46, 0.36, 0.25),
    "tray": (0.14, 0.30, 0.20),
    "shelf": (0.58, 0.56, 0.52),
    "picture": (0.30, 0.22, 0.40),
    "rug": (0.26, 0.30, 0.44),
    "pot": (0.55, 0.33, 0.22),
    "wardrobe": (0.22, 0.32, 0.26),
    "curtain": (0.62, 0.28, 0.30),
}


def office_coloured_mirror() -> Recipe:
    """A parlour with a gold-coloured mirror over the sideboard.  Wardrobe and curtain are seen in it alone."""
    gold = (0.88, 0.72, 0.50)
    materials = dict(_PARLOUR) | {"mirror": (0.0, 0.0, 0.0)}
    surfaces = {"mirror": Surface("coloured_mirror", gold)}
    x, y, z = 4.6, 4.2, 2.7
    p = room(x, y, z)
    p += framed("mirror", "mirror", "frame", ("y", y, -1), (2.42, 3.42), (0.92, 2.18), 0.03)
    p += box("sideboard", "sideboard", (2.25, 3.78, 0), (3.65, 4.2, 0.70))
    p += box("drawer-1", "drawer", (2.30, 3.755, 0.38), (2.92, 3.78, 0.64))
    p += box("drawer-2", "drawer", (2.98, 3.755, 0.38), (3.60, 3.78, 0.64))
    p += prism("vase", "vase", regular((2.42, 3.98), 0.09, 8, 0.2), 0.70, 1.02)
    p += box("sofa", "sofa", (0.25, 2.55, 0), (1.95, 3.3, 0.40))
    p += box("sofa-back", "sofa", (0.25, 3.3, 0), (1.95, 3.5, 0.85))
    p += box("cushion", "cushion", (1.30, 2.85, 0.40), (1.72, 3.28, 0.54), turn=0.3)
    p += box("table", "table", (2.28, 2.35, 0.38), (3.12, 2.85, 0.42), turn=0.12)
    p += box("table-leg-1", "table", (2.36, 2.42, 0), (2.42, 2.72, 0.38), turn=0.12)
    p += box("table-leg-2", "table", (2.98, 2.48, 0), (3.04, 2.78, 0.38), turn=0.12)
    p += box("tray", "tray", (2.55, 2.5, 0.42), (2.85, 2.72, 0.45), turn=0.5)
    p += box("shelf", "shelf", (4.22, 3.1, 0), (4.6, 4.0, 1.45))
    p += box("picture", "picture", (1.0, 4.17, 1.35), (1.65, 4.2, 1.85))
    p += box("rug", "rug", (1.9, 1.75, 0), (3.5, 3.05, 0.012), turn=-0.06)
    p += prism("pot", "pot", regular((3.92, 2.75), 0.16, 8, 0.1), 0, 0.42)
    p += box("wardrobe", "wardrobe", (2.95, 0, 0), (3.85, 0.55, 2.0))  # from here on: behind the camera
    p += box("curtain", "curtain", (4.54, 0.62, 0.1), (4.6, 1.5, 2.35))
    p += [lamp("lamp", "lamp", (2.35, 2.1), 1.2, 0.8, z - 0.05)]
    return lit_room(
        "office-coloured-mirror",
        p,
        materials,
        tint=(1.0, 0.95, 0.86),
        level=0.20,
        gamma=1.85,
        K=pinhole(640, 480, 410),
        T_cam_world=look((2.05, 0.98, 1.52), (2.72, 4.2, 1.08)),
        surfaces=surfaces,
        about="A parlour with a gold-coloured mirror; the lamp's emittance is known",
    )


def two_mirrors() -> Recipe:
    """Two perfect mirrors on opposite walls.

    The camera stands between them.  It sees one of them, in it the other, and so on.
    """
    materials = {
        "wall": (0.64, 0.60, 0.52),
        "floor": (0.32, 0.26, 0.22),
        "ceiling": (0.78, 0.78, 0.76),
        "frame": (0.46, 0.32, 0.14),
        "frame-2": (0.16, 0.18, 0.24),
        "chest": (0.30, 0.42, 0.44),
        "vase": (0.58, 0.16, 0.12),
        "stool": (0.56, 0.46, 0.22),
        "bench": (0.22, 0.16, 0.34),
        "screen": (0.40, 0.54, 0.30),
        "mirror": (0.0, 0.0, 0.0),
        "mirror-2": (0.0, 0.0, 0.0),
    }
    surfaces = {g: Surface("mirror", (1.0, 1.0, 1.0)) for g in ("mirror", "mirror-2")}
    x, y, z = 4.4, 3.4, 2.6
    p = room(x, y, z)
    p += framed("mirror", "mirror", "frame", ("y", y, -1), (1.30, 3.10), (0.85, 1.95), 0.03)
    p += framed("mirror-2", "mirror-2", "frame-2", ("y", 0.0, 1), (1.15, 2.75), (0.75, 2.05), 0.03)
    p += box("chest", "chest", (1.2, 3.0, 0), (2.1, 3.4, 0.55))
    p += prism("vase", "vase", regular((1.5, 3.18), 0.09, 8, 0.2), 0.55, 0.92)
    p += prism("stool", "stool", regular((2.85, 2.45), 0.2, 6, 0.3), 0, 0.5)
    p += box("bench", "bench", (2.4, 0.12, 0), (3.3, 0.5, 0.45))
    p += box("screen", "screen", (3.55, 2.2, 0), (3.62, 3.2, 1.6), turn=0.3)
    p += [lamp("lamp", "lamp", (2.3, 1.75), 1.2, 0.8, z - 0.05)]
    return lit_room(
        "two-mirrors",
        p,
        materials,
        tint=(1.0, 0.96, 0.90),
        level=0.22,
        gamma=2.2,
        K=pinhole(640, 480, 390),
        T_cam_world=look((1.72, 0.92, 1.52), (2.35, 3.4, 1.16)),
        surfaces=surfaces,
        about="Two mirrors that face each other; the lamp's emittance is known",
    )


_DESK = {
    "wall": (0.62, 0.60, 0.55),
    "panel": (0.28, 0.38, 0.50),
    "floor": (0.46, 0.40, 0.34),
    "ceiling": (0.78, 0.78, 0.76),
    "desktop": (0.25, 0.14, 0.08),
    "apron": (0.34, 0.20, 0.11),
    "book": (0.60, 0.14, 0.11),
    "book-2": (0.16, 0.34, 0.24),
    "pot": (0.62, 0.46, 0.20),
    "screen": (0.09, 0.10, 0.13),
    "paper": (0.74, 0.73, 0.70),
    "shelf": (0.52, 0.40, 0.25),
    "carton": (0.20, 0.28, 0.50),
}


def study() -> list:
    """A desk at the end of a small room, its top at z = 0.74, and what stands on it."""
    x, y, z = 5.0, 3.6, 2.7
    p = room(x, y, z)
    p += box("desk", "apron", (2.70, 0.8, 0.64), (3.70, 2.7, 0.74), top="desktop")
    p += box("desk-foot-1", "apron", (2.95, 0.9, 0), (3.6, 0.98, 0.64))
    p += box("desk-foot-2", "apron", (2.95, 2.52, 0), (3.6, 2.6, 0.64))
    p += box("panel", "panel", (4.97, 0.35, 0.25), (5.0, 1.55, 1.45))
    p += box("shelf", "shelf", (4.65, 1.85, 0.86), (5.0, 3.4, 0.9))
    p += box("shelf-carton", "carton", (4.7, 2.6, 0.9), (4.97, 3.05, 1.1))
    p += box("screen", "screen", (3.50, 1.08, 0.78), (3.55, 1.66, 1.12), turn=-0.22)
    p += box("screen-foot", "screen", (3.43, 1.29, 0.74), (3.61, 1.45, 0.78), turn=-0.22)
    p += box("book", "book", (3.26, 2.30, 0.74), (3.54, 2.64, 0.80), turn=0.3)
    p += box("book-2", "book-2", (3.31, 2.34, 0.80), (3.50, 2.60, 0.86), turn=0.12)
    return p


def desk_glossy() -> Recipe:
    """A varnished desk top, and a tin of narrower gloss.

    The desk top shows the lamp as a broad highlight, and what stands on it as a blur.
    """
    materials = dict(_DESK) | {"tin": (0.10, 0.10, 0.10)}
    surfaces = {
        "desktop": Surface("glossy", (0.12, 0.12, 0.12), (0.10, 0.10)),
        "tin": Surface("glossy", (0.35, 0.35, 0.35), (0.05, 0.05)),
    }
    p = study()
    p += prism("pot", "pot", regular((3.40, 1.98), 0.08, 8, 0.15), 0.74, 0.94)
    p += box("paper", "paper", (2.86, 1.02, 0.74), (3.07, 1.32, 0.744), turn=0.3)
    p += box("tin", "tin", (2.78, 1.66, 0.74), (2.98, 1.96, 0.82), turn=-0.35)
    p += [lamp("lamp", "lamp", (4.15, 1.85), 1.2, 0.9, 2.6)]
    return lit_room(
        "desk-glossy",
        p,
        materials,
        tint=(1.0, 0.95, 0.87),
        level=0.17,
        gamma=2.3,
        K=pinhole(640, 480, 500),
        T_cam_world=look((1.93, 1.42, 1.66), (3.30, 1.80, 0.72)),
        surfaces=surfaces,
        about="A glossy desk top and a tin; the lamp's emittance is known",
    )


def desk_brushed() -> Recipe:
    """A plate of brushed metal on the desk.

    Its highlight is drawn out across the brushing, which runs at 25 degrees to the desk's edge.
    """
    a = np.radians(25)
    materials = dict(_DESK) | {"plate": (0.08, 0.08, 0.08), "desktop": (0.50, 0.38, 0.24)}
    surfaces = {"plate": Surface("glossy", (0.45, 0.43, 0.40), (0.28, 0.07), (float(np.cos(a)), float(np.sin(a)), 0.0))}
    p = study()
    p += box("plate", "apron", (2.78, 1.12, 0.74), (3.36, 2.02, 0.752), top="plate")
    p += prism("pot", "pot", regular((3.24, 1.78), 0.07, 8, 0.15), 0.752, 0.93)
    p += box("paper", "paper", (2.86, 2.18, 0.74), (3.07, 2.48, 0.744), turn=0.3)
    p += [lamp("lamp", "lamp", (4.05, 1.95), 1.3, 1.1, 2.6)]
    return lit_room(
        "desk-brushed",
        p,
        materials,
        tint=(1.0, 0.97, 0.92),
        level=0.085,
        gamma=2.0,
        K=pinhole(640, 480, 500),
        T_cam_world=look((1.93, 1.36, 1.66), (3.30, 1.74, 0.72)),
        surfaces=surfaces,
        about="A plate of brushed metal on a desk; the lamp's emittance is known",
        params={"formfactors": {"rays": 1024}},  # the plate throws light to and fro: docs/verify.md
    )
