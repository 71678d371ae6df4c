"""A small room in which every kind of surface stands once: for exports.

A mirror, a coloured mirror, a glossy box, a brushed plate, a picture, a table top that lies in the plane of another
face, and a lamp.
"""

from pathlib import Path

import numpy as np

from lib.given import cameras, image, materials
from lib.given import model as models
from lib.given.materials import FoundTransfer, Group, Lamp, Lobe, Materials
from lib.picture import albedo_maps
from lib.picture.albedo_maps import AlbedoMap
from tests.helpers.views import look

W, H, F = 160, 120, 120.0
QUADS = {  # object, group: corners, counter-clockwise seen from the front
    ("room", "floor"): [(0, 0, 0), (3, 0, 0), (3, 3, 0), (0, 3, 0)],
    ("room", "wall"): [(0, 3, 0), (3, 3, 0), (3, 3, 2.5), (0, 3, 2.5)],
    ("room", "side"): [(0, 0, 0), (0, 3, 0), (0, 3, 2.5), (0, 0, 2.5)],
    ("looking glass", "glass"): [(2.99, 2.5, 0.8), (2.99, 1.5, 0.8), (2.99, 1.5, 1.8), (2.99, 2.5, 1.8)],
    ("tray", "gold"): [(0.4, 1.0, 0.4), (0.9, 1.0, 0.4), (0.9, 1.5, 0.4), (0.4, 1.5, 0.4)],
    ("desk", "varnish"): [(1, 1.2, 0.7), (2.2, 1.2, 0.7), (2.2, 2.2, 0.7), (1, 2.2, 0.7)],
    ("plate", "steel"): [(1.2, 1.4, 0.7), (1.7, 1.4, 0.7), (1.7, 1.8, 0.7), (1.2, 1.8, 0.7)],
    ("picture", "print"): [(1, 2.98, 1.1), (2, 2.98, 1.1), (2, 2.98, 1.9), (1, 2.98, 1.9)],
    ("lamp", "lamp"): [(1.2, 1.2, 2.4), (1.2, 1.8, 2.4), (1.8, 1.8, 2.4), (1.8, 1.2, 2.4)],
}
TANGENT = (0.8, 0.6, 0.0)
GROUPS = {
    "floor": ("diffuse", (0.4, 0.35, 0.3), None, None),
    "wall": ("diffuse", (0.7, 0.68, 0.61), None, None),
    "side": ("diffuse", (0.2, 0.5, 0.6), None, None),
    "glass": ("mirror", (0, 0, 0), (0.9, 0.9, 0.9), None),
    "gold": ("coloured_mirror", (0, 0, 0), (0.9, 0.7, 0.3), None),
    "varnish": ("glossy", (0.3, 0.2, 0.1), (0.1, 0.1, 0.1), (0.15, 0.15)),
    "steel": ("glossy", (0.05, 0.05, 0.05), (0.6, 0.58, 0.5), (0.3, 0.1)),
    "print": ("textured", (0.4, 0.4, 0.4), None, None),
}


def write(folder, *, throw=None, shift_px=(6.0, -4.0)):
    """The options of stages/export.py for files written into a folder. throw : of the lamp, (aim, exponent)"""
    folder.mkdir(parents=True, exist_ok=True)
    lines, count = [], 0
    for (thing, group), corners in QUADS.items():
        lines += [f"o {thing}", *(f"v {x} {y} {z}" for x, y, z in corners), f"usemtl {group}"]
        lines += ["f " + " ".join(str(count + i) for i in range(1, 5))]
        count += 4
    (folder / "model.obj").write_text("\n".join(lines) + "\n")
    centre = ((W - 1) / 2 + shift_px[0], (H - 1) / 2 + shift_px[1])
    camera = look((1.6, -0.6, 1.6), (1.5, 2.2, 0.9), (W, H), F, centre)
    cameras.write_cameramodel(folder / "left.posed.cameramodel", camera)
    image.write_png8(folder / "left.png", np.full((H, W, 3), (90, 80, 70), np.uint8))
    facet = models.load(folder / "model.obj").groups.index("print")  # a facet of its own, in the file's order
    texture = albedo_maps.write(folder / "textures", picture(facet))
    groups = {
        name: Group(
            kind=kind,
            rho_d=rho_d,
            rho_s=rho_s or (0, 0, 0),
            alpha=alpha,
            tangent=TANGENT if alpha and alpha[0] != alpha[1] else None,
            texture={facet: f"textures/{Path(texture).name}"} if kind == "textured" else None,
        )
        for name, (kind, rho_d, rho_s, alpha) in GROUPS.items()
    }
    lobe = Lobe(*throw) if throw else None
    found = Materials(
        status="converged",
        groups=groups,
        lamps={"lamp": Lamp(emittance=(12.0, 11.0, 9.0), lobe=lobe)},
        transfer=FoundTransfer(kind="gamma", gamma=2.2),
        scale="lamps",
    )
    materials.write(folder / "materials.json", found)
    names = ("model.obj", "left.posed.cameramodel", "left.png", "materials.json")
    options = ("--model", "--camera", "--photograph", "--materials")
    return [word for option, name in zip(options, names, strict=True) for word in (option, folder / name)]


def picture(facet):
    """Its lower left quarter is red, its upper right one green, the rest grey."""
    albedo = np.full((40, 32, 3), 0.5, np.float32)  # along the rectangle's axes
    albedo[:20, :16], albedo[20:, 16:] = (0.8, 0.1, 0.1), (0.1, 0.7, 0.1)
    even = np.ones((40, 32), np.float32)
    corners = np.array([(1, 2.98, 1.1), (2, 2.98, 1.1), (1, 2.98, 1.9)])
    return AlbedoMap(facet, albedo, even, 0 * even, even, np.full(3, 0.4), corners, 0)
