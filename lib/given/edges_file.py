"""edges.json: where the photograph's edges put camera, principal point and objects. For `fit` and `check`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.core import artefact, record
from lib.core.record import flag, list_of, matrix, number, part, told, word
from lib.given.materials import Cause, Why


@dataclass(frozen=True)
class Loose:
    """An object that stays where it is, and how surely: covariance (6, 6) of its turn (rad) and move (m), world."""

    object: str | None = told(word(), needed="the name of an object")
    covariance: tuple = told(matrix(6, 6), needed="6 x 6 numbers")


@dataclass(frozen=True)
class Found:
    """What the edges say of one camera and one model.

    looked : the model could be drawn, and the photograph is in its range
    is_lost : the photograph does not show the model as it is given
    causes, why : what stands elsewhere, the likeliest first, as materials.json has it
    loose : what stays, in the order of which sigma is made
    before_px, after_px : median distance of the edges from the photograph's, as they are and with the causes
    edges : straight ones that were found;  shown, chance : share of the edges that the photograph has, and that it has
        by chance
    """

    looked: bool = told(flag, False)
    is_lost: bool = told(flag, False)
    causes: list = list_of(Cause)
    why: list = list_of(Why)
    loose: list = list_of(Loose)
    before_px: float | None = told(number(0))
    after_px: float | None = told(number(0))
    edges: int | None = told(number(0))
    shown: float | None = told(number(0, 1))
    chance: float | None = told(number(0, 1))

    @property
    def covariances(self) -> dict:
        """{object: (6, 6)} of what stays."""
        return {one.object: np.array(one.covariance) for one in self.loose}


@dataclass(frozen=True)
class Edges:
    """given : of the files as they are;  refined : of those that were written in their place, None where none were"""

    given: Found = part(Found)
    refined: Found | None = part(Found, null=True)

    @property
    def taken(self) -> list[Cause]:
        """For which the camera or the model of all that follows is not as given."""
        return self.given.causes if self.refined is not None else []

    @property
    def status(self) -> str:
        """In a word or two."""
        if self.given.is_lost:
            return "lost"
        if self.given.causes:
            return "elsewhere" if self.refined is None else "refined"
        return "good" if self.given.looked else "not looked"

    @property
    def now(self) -> Found:
        """Of the camera and the model that all that follows uses."""
        return self.given if self.refined is None else self.refined


def read(path) -> Edges:
    """BadInput: one line for each value that breaks its rule, with file, field and value."""
    return record.read(path, Edges)


def write(path, edges: Edges):
    """Whole or absent."""
    artefact.write_json(path, record.plain(edges))
