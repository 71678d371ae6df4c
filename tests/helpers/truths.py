"""Answers known in closed form or from other programs, for tests and `make verify` (docs/decisions/closed-forms.md)."""

import csv
from pathlib import Path

import numpy as np

from lib.light import ward_kernels

ROOT = Path(__file__).resolve().parents[2]
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])


# ---- form factors ----


def facing(size, distance):
    """Two parallel squares that look at each other."""
    return SQUARE * size, (SQUARE * size)[::-1] + [0, 0, distance]


def corner(height, width, length):
    """A floor, width x length, and a wall on its edge of the given length."""
    floor = SQUARE * [length, width, 0]
    return floor, np.array([[0, 0, 0], [0, 0, height], [length, 0, height], [length, 0, 0.0]])


def disk(n, z=0.0, up=True):
    """A regular n-gon of the area of the unit disk."""
    a = np.arange(n) * 2 * np.pi / n
    radius = np.sqrt(np.pi / (n / 2 * np.sin(2 * np.pi / n)))
    p = np.column_stack([radius * np.cos(a), radius * np.sin(a), np.full(n, z)])
    return p if up else p[::-1]


PARALLEL, BESIDE = 0.19982489569838746, 0.20004377607540316  # faces of a cube
CLOSED = [
    (*facing(1, 1), PARALLEL),
    (*facing(1, 0.5), 0.41525328357714675),
    (*facing(1, 2), 0.0685895888185526),
    (*facing(10, 1), 0.8269945223972565),
    (*corner(1, 1, 1), BESIDE),
    (*corner(1, 2, 1), 0.11642630139768095),
    (*corner(2, 1, 1), 0.2328526027953619),
]
DISKS = (3 - np.sqrt(5)) / 2  # coaxial unit disks at distance 1
UNDER_A_SQUARE = 0.23945647046077354  # an element under the centre of a unit square, distance 1
BESIDE_A_SQUARE = 0.05573419700255351  # at the origin, normal z, of the square 0 <= x, z <= 1 in the plane y = 1
OCCLUDED = {0.25: 0.169474204911787, 0.5: 0.099506294598985, 0.75: 0.029483544914760}  # side of what is half way


def view3d(name):
    """(areas (n,), factors (n, n)) that View3D prints, see data/formfactor-numbers."""
    lines = (ROOT / "data/formfactor-numbers" / f"{name}.txt").read_text().splitlines()
    areas, *rows, _ = [[float(x) for x in line.split()] for line in lines[1:] if line.strip()]
    return np.array(areas), np.array(rows)


def l_shaped_room():
    """The polygons of View3D's L-shaped room, in its order."""
    L = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3.0]])
    lift = lambda p, z: np.column_stack([p, np.full(len(p), float(z))])
    ends = zip(L, np.roll(L, -1, axis=0), strict=True)
    walls = [np.array([[*b, 0], [*a, 0], [*a, 3], [*b, 3.0]]) for a, b in ends]  # seen from inside
    return [*walls, lift(L, 0), lift(L, 3)[::-1]]


# ---- light ----


def closed_box(n, seed=0, area=False):
    """F of n patches that see only each other, reciprocal, of unlike areas, rows of sum 1."""
    rng = np.random.default_rng(seed)
    S = rng.random((n, n)) ** 3
    S = S + S.T
    np.fill_diagonal(S, 0 if n > 1 else 1)
    A = S.sum(axis=1)  # A_i F_ij = S_ij
    return (S / A[:, None], A) if area else S / A[:, None]


CUBE = np.full((6, 6), BESIDE)
CUBE[range(6), range(6)] = 0
CUBE[[0, 1, 2, 3, 4, 5], [1, 0, 3, 2, 5, 4]] = PARALLEL
CUBES = [  # rho, and the light of a cube of one patch a face, one of which has E = 1
    (np.full(6, 0.5), [1.0909091, 0.18174583, 0.18183627, 0.18183627, 0.18183627, 0.18183627]),
    (np.array([0, 0.8, 0.6, 0.6, 0.3, 0.5]), [1, 0.2756062, 0.21418054, 0.21418054, 0.11315525, 0.18173964]),
]


# ---- Ward ----

ANGLES = (0, 45, 75, 89)
ALBEDOS = [  # alpha, form, albedo at ANGLES for rho_s = 1
    (0.05, ward_kernels.WARD, (0.993, 0.702, 0.259, 0.052)),
    (0.05, ward_kernels.DUER, (0.995, 0.995, 0.995, 1.373)),
    (0.05, ward_kernels.BOUNDED, (0.998, 0.996, 0.979, 0.825)),
    (0.30, ward_kernels.WARD, (0.794, 0.571, 0.280, 0.360)),
    (0.30, ward_kernels.DUER, (0.856, 0.846, 0.838, 4.295)),
    (0.30, ward_kernels.BOUNDED, (0.910, 0.864, 0.778, 0.917)),
]


def direction(theta, phi):
    """Degrees -> (..., 3)"""
    theta, phi = np.radians(theta), np.radians(phi)
    return np.stack(
        np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1
    )


def radiance_rows():
    """[(rho, alpha, i (3,), o (3,), Radiance's value, Ward's of 1992, the bounded form's)]."""
    with open(ROOT / "data/brdf-ward-radiance/ward_brdf_radiance.csv", newline="") as file:
        rows = [[float(x) for x in list(row.values())[1:]] for row in csv.DictReader(file)]
    return [(r[0], r[1], direction(r[2], 0), direction(r[3], r[4]), *r[5:]) for r in rows]
