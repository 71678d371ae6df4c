"""Where groups stand on the reflectance ladder, and a climb as far as it has come."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from lib.given.kinds import RUNGS

if TYPE_CHECKING:
    from lib.analysis.fit.problem import Problem, Result
    from lib.analysis.materials.specular_ways import Traced
    from lib.analysis.seen.receivers import Receivers
    from lib.light.chains import Finish

SPECULAR = tuple(name for name, rung in RUNGS.items() if rung.specular)


@dataclass
class Place:
    """Where a group stands.

    rung : of kinds.RUNGS;  why : for the report;  tried : [{rung, excess, diffuse}] at the steps that led here
    blind : a mirror that no pixel shows: others tell of it by what it throws on them
    rho_d, rho_s : (C,), where the fit is to begin, else None;  alpha : (2,);  tangent : (3,)
    """

    rung: str = "diffuse"
    rho_d: np.ndarray | None = None
    rho_s: np.ndarray | None = None
    alpha: np.ndarray = field(default_factory=lambda: np.zeros(2))
    tangent: np.ndarray = field(default_factory=lambda: np.zeros(3))
    why: str = ""
    tried: list = field(default_factory=list)
    given: bool = False
    blind: bool = False

    @property
    def is_mirror(self):
        return RUNGS[self.rung].mirror

    @property
    def was_explained(self) -> bool:
        """By a higher rung than it stands on, which was taken back: of what it was off by as a diffuse surface, by most
        of its energy."""
        return self.rung == "diffuse" and any(t["excess"] ** 2 < t["diffuse"] ** 2 / 2 for t in self.tried)


@dataclass(eq=False)
class Climb:
    """A climb as far as it has come, everything fitted to it.

    places : {group: Place};  misfits : {group: Misfit};  diffuse : of the first audit, with everything diffuse
    finish : of the specular groups, None where there are none;  tiles : of the last fit;  traced : the light by
        specular ways
    sigma_shape : {group: {shape: sigma}};  patterns : {group: Misfit} of textured groups, as if they were of one colour
    """

    problem: Problem
    result: Result
    scale: str
    places: dict
    misfits: dict
    diffuse: dict
    finish: Finish | None
    tiles: Receivers
    traced: Traced | None = None
    rounds: int = 0
    sigma_shape: dict = field(default_factory=dict)
    patterns: dict = field(default_factory=dict)

    def on(self, *rungs) -> list:
        """The groups on these rungs, in the order of their places."""
        return [g for g, place in self.places.items() if place.rung in rungs]
