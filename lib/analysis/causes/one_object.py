"""Objects that have not the reflectance of their group: a material forgotten on one of them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lib.analysis.fit.evidence import evidence, promised
from lib.analysis.fit.misfits import OTHER, THRESHOLD
from lib.analysis.fit.problem import Problem, Result

NAME = "object"
LOOKED_AT = 4  # Objects whose own reflectance is tried.
SLIGHT_SHOWN, SLIGHT_RELATIVE = (
    0.002,
    0.01,
)  # Display, and relative. So much counts where nothing else is known to be wrong.


class Unlike(NamedTuple):
    """An object with a reflectance of its own. ratio : (C,) to its group's;  nats : that one step towards it brings"""

    group: int
    thing: int
    ratio: np.ndarray
    nats: float


def objects(problem: Problem, result: Result, climbed=(), slightly=False) -> list[Unlike]:
    """The objects that differ most from their groups, and by more display than light in dark corners is off by.

    climbed : groups that are left out;  slightly : by less, too
    """
    least_shown, least = (SLIGHT_SHOWN, SLIGHT_RELATIVE) if slightly else (THRESHOLD, OTHER)
    at, state = result.at, result.state
    brightness, tried = np.maximum(np.abs(at.displayed(state.B)), 1e-9), []
    for g in np.unique(problem.tile_group):
        things = np.unique(problem.tile_object[problem.tile_group == g])
        if len(things) < 2 or g in climbed or g in problem.known_groups:
            continue
        for thing in things:
            mine = (problem.tile_group == g) & (problem.tile_object == thing)
            mean = lambda values, mine=mine: np.average(values[mine], axis=0, weights=problem.n_pixels[mine])
            ratio, shown = mean(-at.residual / brightness), mean(-at.residual)
            if np.abs(shown).max() >= least_shown:
                tried.append((float(np.abs(ratio).max()), int(g), int(thing), mine, ratio))
    tried = sorted((row for row in tried if row[0] >= least), key=lambda row: -row[0])[:LOOKED_AT]
    if not tried:
        return []
    own, C, found = evidence(problem, at).nats, problem.channels, []
    for _, g, thing, mine, ratio in tried:
        each = np.zeros((len(mine), C, C))
        each[:, np.arange(C), np.arange(C)] = np.where(mine[:, None], state.B, 0)
        nats = promised(problem, at, at.displayed(each)).nats - own
        found.append(Unlike(g, thing, 1 + ratio, float(nats)))
    return found


def with_its_own(problem: Problem, one: Unlike, patch_object) -> Problem:
    """The same where the object is a group of its own, the last. patch_object : (N,) numbers"""
    patches = (problem.patch_group == one.group) & (patch_object == one.thing)
    tiles = (problem.tile_group == one.group) & (problem.tile_object == one.thing)
    number, area = len(problem.groups), problem.area[patches].sum()
    group_area = problem.group_area - area * (np.arange(number) == one.group)
    return replace(
        problem,
        groups=(*problem.groups, f"{problem.groups[one.group]} of one object"),
        patch_group=np.where(patches, number, problem.patch_group),
        tile_group=np.where(tiles, number, problem.tile_group),
        rho=np.vstack([problem.rho, np.full((1, problem.channels), np.nan)]),
        group_area=np.append(group_area, area),
        black=None if problem.black is None else np.append(problem.black, False),
    )


def promise(problem: Problem, result: Result, slightly=False) -> float:
    """Nats that the reflectance of one object alone would bring. slightly : of `objects`"""
    return max((one.nats for one in objects(problem, result, slightly=slightly)), default=0.0)
