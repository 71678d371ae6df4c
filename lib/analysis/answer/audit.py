"""All pixels that show one surface, looked at for what the trusted ones do not show."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from lib.analysis.causes.explained import Explained
from lib.analysis.fit import misfits
from lib.analysis.fit.problem import Problem, Result
from lib.analysis.seen.gather import Gathered
from lib.analysis.seen.receivers import Receivers, unplaced
from lib.light.form_factors import FormFactorRows

LOOKS_AT = 0.05  # A tile looks at a lamp if so much of its light, by form factors, comes from there.
LEFT_BY_LAMP = 0.25  # A lamp was what was wrong if at most so much of the energy of all groups that differed is left.
ALMOST_ALL = 0.7  # A group with so much of the energy of all may be what is wrong with the others, too.


class Energy(NamedTuple):
    """What groups are off by, squares summed over pixels: those that no diffuse surface explains, all, and the most of
    one."""

    flagged: float
    all: float
    most: float = 0.0

    @property
    def is_of_one(self) -> bool:
        """One group has nearly all of it."""
        return self.most >= ALMOST_ALL * self.all

    def is_explained_by(self, other: Energy) -> bool:
        """Another explanation leaves few of the flagged groups' errors, or less than what it takes from all groups.

        Where the light of a mirror was taken for a lamp's, the mirror's own pixels still differ by far more.
        """
        return other.flagged <= max(LEFT_BY_LAMP * self.flagged, self.all - other.all)


@dataclass(frozen=True, eq=False)
class Audit:
    """Tiles of all pixels, and what a group may differ by.

    gathered : without the lens's shadow;  subcell : of FormFactors;  given : {group number: kind}, of scene.yaml
    asked : {question: its answer}, of `once`
    """

    gathered: Gathered
    subcell: object
    given: dict
    threshold: float
    asked: dict = field(default_factory=dict)

    @classmethod
    def of(cls, gathered: Gathered, explained: Explained, factors, surfaces, threshold) -> Audit:
        """surfaces : {group: kind}, of scene.yaml"""
        given = {explained.problem.groups.index(name): kind for name, kind in surfaces.items()}
        return cls(explained.evened(gathered), factors.subcell, given, threshold)

    @property
    def tiles(self) -> Receivers:
        return unplaced(self.gathered)

    def with_group(self, group, thing, number) -> Audit:
        """The same where the tiles of one object of a group are of another. number : of that"""
        found = self.gathered
        mine = (found.group == group) & (found.object == thing)
        return replace(self, gathered=replace(found, group=np.where(mine, number, found.group)), asked={})

    def once(self, question, ask):
        """The answer of ask(), which is asked only once."""
        if question not in self.asked:
            self.asked[question] = ask()
        return self.asked[question]

    def misfits(self, problem: Problem, result: Result, direct=None, among=None) -> dict:
        """{group: Misfit} of diffuse surfaces.

        direct : (T, L) of the audit's tiles, in place of their own;  among : (T,) bool, those that count, or None
        """
        tiles = self.tiles if direct is None else replace(self.tiles, direct=direct)
        found, _ = misfits.audit(self.subcell, problem, result, tiles, among=among)
        return found

    def flagged(self, problem: Problem, judged) -> list:
        """The groups that a diffuse surface does not explain. judged : of `misfits`"""
        return misfits.flagged(problem, judged, self.given, self.threshold)

    def stands_out(self, explained, judged) -> bool:
        """One group is off by far more than others: its lobe may be what looks like another lamp or camera."""
        apart = misfits.apart(explained.problem, explained.result)
        return apart is not None or misfits.keener(judged, self.threshold) is not None

    def energy(self, problem: Problem, result: Result, direct=None, among=None) -> Energy:
        """direct, among : of `misfits`"""
        judged = self.misfits(problem, result, direct, among)
        flagged = sum(judged[g].energy for g in self.flagged(problem, judged) if g in judged)
        return Energy(flagged, misfits.energy(judged), max((m.energy for m in judged.values()), default=0.0))

    def doubt(self, problem: Problem, result: Result, judged, places=None):
        """Widen sigma of groups that differ all the same, and say so."""
        misfits.doubt(problem, result, judged, self.threshold, self.given, places)


def looking_at(rows: FormFactorRows, group, patch_group) -> np.ndarray:
    """(T,) bool: much of what these tiles look at is the group (number). patch_group : (N,), of FormFactors"""
    return rows.matrix()[:, patch_group == group].sum(axis=1) > LOOKS_AT
