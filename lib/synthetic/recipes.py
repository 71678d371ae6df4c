"""The synthetic scenes by name.

    recipe = recipes.make("office-2")      # the same every time
    recipe.model()                         # (text of model.obj, text of model.mtl)
    recipe.cameramodel()                   # text of left.posed.cameramodel
    recipes.make("room-101")               # a random room of 640 x 480; small-101: of 400 x 300

A recipe knows the truth; `stages/synthesise.py` renders it.  Rooms are made of single polygons that face inwards (one
object each, so that no room is mistaken for a solid).  Furniture is made of closed boxes and prisms that stand on the
floor and touch the walls.
"""

from dataclasses import replace

from lib.synthetic import mirrors_and_gloss, offices, stereo, textured
from lib.synthetic.random_pairs import random_pair
from lib.synthetic.random_rooms import lobed_room, mirrored_room, random_room, textured_room, white_room
from lib.synthetic.recipe import Recipe

_DIFFUSE = {
    "office": offices.office,
    "office-1": lambda: offices.office(1),
    "office-2": lambda: offices.office(2),
    "office-3": lambda: offices.office(3),
    "gallery-white": offices.gallery_white,
    "cornell": offices.cornell,
    "flat-grey": offices.flat_grey,
    "linear": offices.linear,
}
NAMES = tuple(_DIFFUSE)
_STEREO = {
    "office-stereo": stereo.office_stereo,
    "office-stereo-1": lambda: stereo.office_stereo(1),
    "office-stereo-grey": lambda: stereo.office_stereo(2),
}
STEREO_NAMES = tuple(_STEREO)
_KINDS = {
    "office-mirror": mirrors_and_gloss.office_mirror,
    "office-coloured-mirror": mirrors_and_gloss.office_coloured_mirror,
    "desk-glossy": mirrors_and_gloss.desk_glossy,
    "desk-brushed": mirrors_and_gloss.desk_brushed,
    "poster": textured.poster,
    "two-mirrors": mirrors_and_gloss.two_mirrors,
}
KIND_NAMES = tuple(_KINDS)  # mirrors, gloss, textures
_RECIPES = _DIFFUSE | _STEREO | _KINDS
ALL_NAMES = tuple(_RECIPES)
_SMALL = 400, 300
RANDOM = {  # by what stands before the seed
    "room": lambda seed: random_room(seed, size=(640, 480)),
    "small": lambda seed: random_room(seed, size=_SMALL),
    "white": lambda seed: white_room(seed, size=_SMALL),  # <gap in mm>-<seed> and shelves-<seed>: with a narrow gap
    "lobed": lambda seed: lobed_room(seed, size=_SMALL),  # its lamps throw their light in lobes
    "mirrored": lambda seed: mirrored_room(seed, size=_SMALL),  # a mirror hangs on a wall
    "textured": lambda seed: textured_room(seed, size=_SMALL),  # a picture hangs on a wall, the floor is of planks
    "pair": random_pair,  # stereo, of a size of its own
}


def make(name) -> Recipe:
    """The recipe of one scene.  Raises KeyError for a name that is neither in `ALL_NAMES` nor a random room's."""
    kind, _, seed = name.partition("-")
    if kind in RANDOM and seed:
        return replace(RANDOM[kind](seed), name=name)
    return _RECIPES[name]()
