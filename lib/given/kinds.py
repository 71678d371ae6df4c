"""How surfaces may reflect: the rungs of the reflectance ladder, lowest first, and the kinds that files name.

One table for scene.yaml, materials.json, the climb and the page. Planning reads it too, without NumPy.
"""

from typing import NamedTuple


class Reflects(NamedTuple):
    """How a rung reflects.

    kind : in materials.json and under `surfaces`;  words : for people
    mirror, lobe : what it has beside rho_d, at most one of them;  shapes : of the lobe, those that are fitted
    """

    kind: str
    words: str
    mirror: bool = False
    lobe: bool = False
    shapes: tuple = ()

    @property
    def specular(self):
        return self.mirror or self.lobe


RUNGS = {
    "diffuse": Reflects("diffuse", "diffuse"),
    "mirror": Reflects("mirror", "perfect mirror", mirror=True),
    "coloured_mirror": Reflects("coloured_mirror", "coloured mirror", mirror=True),
    "glossy": Reflects("glossy", "glossy", lobe=True, shapes=("alpha",)),
    "anisotropic": Reflects("glossy", "glossy, anisotropic", lobe=True, shapes=("alpha_x", "alpha_y", "turn")),
    "textured": Reflects("textured", "textured"),
}
ORDER = tuple(RUNGS)
KINDS = tuple(dict.fromkeys(rung.kind for rung in RUNGS.values()))
MIRRORS = tuple(dict.fromkeys(rung.kind for rung in RUNGS.values() if rung.mirror))
LOBES = tuple(dict.fromkeys(rung.kind for rung in RUNGS.values() if rung.lobe))

# the group of an added file's faces that have no material of their own, where the entry has one for all
NAMELESS = "surface"
