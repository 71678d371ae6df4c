"""In which unit and axes picked points are told: a person reads them off another program than wrote the model.

Blender shows metres with z up, and exports centimetres with y up: the same corner has other numbers there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lib.given.units import METRES

TURNS = {
    "X,Y,Z": np.eye(3),
    "X,Z,-Y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),  # told with z up, of a model with y up
    "X,-Z,Y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),  # told with y up, of a model with z up
}
AT_CORNER = 2e-3  # of the model's diagonal: so near lies a point that was read off a corner
MOST, FEW = 0.75, 0.5  # of the points: so many corners prove a reading;  fewer than that, and it is none
LEAST = 4
MOST_PAIRS = 2e7  # points times corners that are compared


class Reading(NamedTuple):
    """unit : of the numbers;  axes : X, Y, Z of the model's frame, of the numbers' own

    corners : how many of them the points are
    """

    unit: str
    axes: str
    corners: int

    def metres(self, p) -> np.ndarray:
        """(n, 3) m, world, of numbers that were told so."""
        return METRES[self.unit] * np.asarray(p, float) @ TURNS[self.axes].T

    @property
    def words(self) -> str:
        turned = {"X,Y,Z": "", "X,Z,-Y": ", z up", "X,-Z,Y": ", y up"}[self.axes]
        return f"{self.unit}{turned}"


def reading(p, model) -> Reading | None:
    """How numbers are to be read so that most are corners of the model; None where no reading is proved.

    p : (n, 3) as told;  model : in metres.  As they stand, where that makes at least half of them corners
    """
    corners = model.vertices[np.unique(model.triangles)]
    if len(p) < LEAST or len(p) * len(corners) > MOST_PAIRS:
        return None
    as_told = Reading("m", "X,Y,Z", _corners(p, corners))
    if as_told.corners >= FEW * len(p):
        return as_told
    others = [Reading(unit, axes, 0) for unit in METRES for axes in TURNS if unit != "km"]
    best = max((r._replace(corners=_corners(r.metres(p), corners)) for r in others), key=lambda r: r.corners)
    return best if best.corners >= max(LEAST, MOST * len(p)) else None


def otherwise(p, model) -> str | None:
    """One line where the points are corners of the model in another unit or with other axes alone."""
    found = reading(p, model)
    if found is None or found[:2] == ("m", "X,Y,Z"):
        return None
    first = ",".join(f"{x:.6g}" for x in found.metres(p)[0])
    return (
        f"X,Y,Z: as metres of the model's frame few are corners of the model; {found.corners} of {len(p)} are if they "
        f"are in {found.words}: write metres and the model's axes (the first is {first}), or let make new-scene "
        "PICKS=... do it"
    )


def _corners(p, corners):
    """How many corners the points are: nearer than AT_CORNER of the diagonal. What shrinks into one counts once."""
    reach = AT_CORNER * np.linalg.norm(np.ptp(corners, axis=0))
    far = [np.abs(corners - point).max(axis=1) for point in np.asarray(p, float)]
    return len({tuple(corners[d.argmin()]) for d in far if d.min() < reach})
