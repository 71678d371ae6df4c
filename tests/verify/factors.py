"""Form factors, eq. 3.3: closed forms, View3D, gaps, slivers, sizes and places."""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from lib.light import exact_factors, form_factors
from lib.light import lamps as lamps_
from tests.helpers import rooms, truths
from tests.verify.walks import at_most, near, refused, walk

PART = "form factors"


def model(objects, lamps=("lamp",), **placed):
    """Surface of a model {object: [(group, corners)]}."""
    with tempfile.TemporaryDirectory() as folder:
        return rooms.surface(Path(folder) / "model.obj", objects, lamps, **placed)


def between(surface, mesh, rows):
    """Factors between the fronts of facets (F, F)."""
    A, side = mesh.area * rows.exposed, mesh.side
    n = len(surface.normal)
    AF = np.zeros((2 * n, 2 * n))
    coo = rows.matrix().tocoo()
    np.add.at(AF, (side[coo.row], side[coo.col]), A[coo.row] * coo.data)
    whole = np.bincount(side, A, 2 * n)
    return (AF / np.maximum(whole, 1e-300)[:, None])[::2, ::2]


NAMES = ("1 at 1", "1 at 0.5", "1 at 2", "10 at 1", "corner", "2 x 1 to 1 x 1", "1 x 1 to 2 x 1")


@walk(PART, "polygons, analytic", law="closed forms of parallel and adjoining rectangles", at=NAMES)
def polygons(name):
    P, Q, truth = truths.CLOSED[NAMES.index(name)]
    return near(exact_factors.polygon_to_polygon(P, Q), truth, 1e-12)


@walk(PART, "polygons, by rays", law="the same, 60 patches, 1024 rays each", at=NAMES)
def polygons_by_rays(name):
    P, Q, truth = truths.CLOSED[NAMES.index(name)]
    s = model({"a": [("a", P)], "b": [("b", Q)]})
    m = rooms.patches(s, 60)
    F = between(s, m, form_factors.rays(s, m, n_rays=1024))
    return near([F[0, 1], F[1, 0] * m.area[m.side == 2].sum() / m.area[m.side == 0].sum()], truth, 1e-3)


@walk(PART, "coaxial disks", law="(3 - sqrt 5) / 2, from n-gons of equal area", axis="corners", at=[64, 128, 256])
def disks(n):
    return near(
        exact_factors.polygon_to_polygon(truths.disk(n), truths.disk(n, 1, up=False)),
        truths.DISKS,
        1e-7 * (64 / n) ** 3,
    )


@walk(PART, "elements", law="under a square, and beside one", at=["under", "beside"])
def elements(which):
    if which == "under":
        return near(
            exact_factors.point_to_polygon([0, 0, 0], [0, 0, 1], truths.SQUARE + [-0.5, -0.5, 1]),
            truths.UNDER_A_SQUARE,
            1e-14,
        )
    beside = np.array([[0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1.0]])
    return near(exact_factors.point_to_polygon([0, 0, 0], [0, 0, 1], beside), truths.BESIDE_A_SQUARE, 1e-14)


@walk(PART, "something half way", law="closed form of a centred opaque square", axis="its side", at=truths.OCCLUDED)
def occluded(side):
    low, high = 0.5 - side / 2, 0.5 + side / 2
    P, Q = truths.facing(1, 1)
    screen = rooms.panel("c", (low, low, 0.5), (high, low, 0.5), (high, high, 0.5), (low, high, 0.5))
    s = model({"a": [("a", P)], "b": [("b", Q)], **screen})
    m = rooms.patches(s, 1200)
    F = between(s, m, form_factors.rays(s, m, n_rays=1024))
    return near([F[0, 1], F[1, 0]], truths.OCCLUDED[side], 1e-3)


@walk(PART, "View3D", law="what another program prints", at=["cube", "L-shaped room", "square half way, in a corner"])
def view3d(name):
    """The cube analytically, to the six digits that are printed; what hides something by rays."""
    if name == "cube":
        faces = rooms.box(0, 0, 0, 1, 1, 1, inward=True)
        P = [faces[k] for k in ("bottom", "south", "east", "top", "north", "west")]
        F = np.array([[exact_factors.polygon_to_polygon(a, b) if a is not b else 0.0 for b in P] for a in P])
        return near(F, truths.view3d("cube")[1], 6e-7)
    if name == "L-shaped room":
        P, printed = truths.l_shaped_room(), truths.view3d("pinney-bean-test-4-f3a")[1]
    else:
        (a, b), printed = truths.facing(1, 1), truths.view3d("square-obstruction")[1]
        P = [a, b, truths.SQUARE * 0.5 + [0, 0, 0.5]]
    s = model({f"o{k}": [(f"g{k}", p)] for k, p in enumerate(P)})
    m = rooms.patches(s, 900)
    F = between(s, m, form_factors.rays(s, m, n_rays=1024))
    if name != "L-shaped room":  # the back of what is half way is lit, too, and View3D has none
        F[0, 2] = 0.0
    return near(F, printed, 1e-3)


def parallel_squares(gap):
    """F of unit squares at a distance (Siegel and Howell's C-11)."""
    X = 1 / gap
    a = np.sqrt(1 + X * X)
    return 2 / (np.pi * X * X) * (
        0.5 * np.log((1 + X * X) ** 2 / (1 + 2 * X * X)) + 2 * X * a * np.arctan(X / a)
    ) - 4 / (np.pi * X) * np.arctan(X)


GAPS = [10.0, 1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 0.0]


@walk(
    PART, "a gap that closes, analytic", law="C-11 down to 1e-8; nearer it is one plane: 0", axis="gap / side", at=GAPS
)
def gap(d):
    truth = parallel_squares(d) if d > 1e-8 else 0.0
    F = exact_factors.polygon_to_polygon(*truths.facing(1, d))
    if 1e-9 <= d <= 1e-8:  # either is right
        return near(F, min((0.0, parallel_squares(d)), key=lambda t: abs(t - F)), 1e-6)
    return near(F, truth, 1e-9)


@walk(
    PART,
    "a gap that closes, by rays",
    law="C-11 within counting; refused within two ray offsets",
    axis="gap / side",
    at=GAPS[:8],
)
def gap_by_rays(d):
    P, Q = truths.facing(1, d)
    s = model({"a": [("a", P)], "b": [("b", Q)]})
    if d < 2e-5:  # within two ray offsets they are one plane
        return refused(lambda: rooms.patches(s, 60), "no facet sees another")
    m = rooms.patches(s, 60)
    return near(between(s, m, form_factors.rays(s, m, n_rays=1024))[0, 1], parallel_squares(d), 1.5e-3)


@walk(
    PART,
    "slivers",
    law="F / width tends to a constant, and reciprocity keeps its digits",
    axis="width",
    at=[1e-2, 1e-4, 1e-6, 1e-9, 1e-12],
)
def slivers(width):
    sliver = (truths.SQUARE * [1, width, 1])[::-1] + [0, 0.5, 1]
    there, back = (
        exact_factors.polygon_to_polygon(*pair) for pair in ((truths.SQUARE, sliver), (sliver, truths.SQUARE))
    )
    return near(there / width, back, 1e-3 * width + 1e-15 / width + 1e-11, relative=True)


NOTHING = {
    "coplanar": truths.SQUARE + [2, 0, 0],
    "back to back": truths.SQUARE[::-1],
    "its back": truths.SQUARE + [0, 0, 1],
    "behind": truths.SQUARE[::-1] - [0, 0, 1],
    "without area": np.array([[0, 0, 1], [1, 0, 1], [0.5, 0, 1.0]]),
}


@walk(PART, "what sees nothing", law="0, exactly", at=NOTHING)
def nothing(name):
    return at_most(exact_factors.polygon_to_polygon(truths.SQUARE, NOTHING[name]), 0.0)


# ---- closed rooms ----

IN_A_ROOM = {
    "a table on the floor": rooms.solid("a", 1, 1, 0, 2, 2, 0.7),
    "solids that overlap": rooms.solid("a", 1, 1, 0, 2, 2, 0.7) | rooms.solid("b", 1.5, 1.5, 0, 2.5, 2.3, 1),
    "sheets back to back": rooms.panel("p", (1, 1, 1), (2, 1, 1), (2, 2, 1), (1, 2, 1))
    | rooms.panel("q", (1, 1, 1), (1, 2, 1), (2, 2, 1), (2, 1, 1)),
    "a sheet on the wall": rooms.panel("p", (1, 3, 1), (2, 3, 1), (2, 3, 2), (1, 3, 2)),
    "a sliver of 1e-6 m": rooms.panel("p", (1, 1, 1), (2, 1, 1), (2, 1 + 1e-6, 1)),
    "polygons without area": rooms.panel("p", (1, 1, 1), (2, 1, 1), (3, 1, 1)),
}


@cache
def furnished(name):
    s = model(rooms.room() | rooms.LAMP | IN_A_ROOM[name])
    m = rooms.patches(s, 300)
    return s, m, form_factors.rays(s, m, n_rays=512)


@walk(PART, "rows of closed rooms", law="sum to 1 before any normalisation", at=IN_A_ROOM)
def row_sums(name):
    _, _, rows = furnished(name)
    return near(rows.row_sums[rows.exposed > 0], 1.0, 1e-3)


@walk(PART, "the lamp's light arrives", law="sum of area x factor = the lamp's area", at=IN_A_ROOM)
def lamp_arrives(name):
    s, m, rows = furnished(name)
    D = lamps_.patch_direct(s, m, lamps_.emitters(s, ["lamp"]), 1, n_points=64, n_samples=16)[:, 0]
    return near((m.area * rows.exposed * D).sum() * s.local.diagonal**2, 1.0, 2.5e-3)


SIZES = [1e-3, 1e-2, 1.0, 1e2, 1e4]


@walk(PART, "a room of another size", law="the same patches and the same counts", axis="size, m", at=SIZES)
def sized(size):
    s0, m0, rows0 = furnished("a table on the floor")
    s = model(rooms.room() | rooms.LAMP | IN_A_ROOM["a table on the floor"], scale=size / 4)
    m = rooms.patches(s, 300)
    return at_most(abs(form_factors.rays(s, m, n_rays=512).matrix() - rows0.matrix()).max(), 1e-6)


@walk(
    PART,
    "a room elsewhere",
    law="the same patches; a ray in 10,000 may round",
    axis="m from the origin",
    at=[1.0, 1e3, 1e6],
)
def elsewhere(metres):
    s0, m0, rows0 = furnished("a table on the floor")
    objects = rooms.room() | rooms.LAMP | IN_A_ROOM["a table on the floor"]
    s = model(objects, offset=(metres, -metres, metres / 2))
    m = rooms.patches(s, 300)
    difference = abs(form_factors.rays(s, m, n_rays=512).matrix() - rows0.matrix())
    return at_most(difference.sum() / len(m), 1e-4)
