"""compare.json: how far everything is from the truth. One type that `compare` writes and the page reads.

comparison = record.read("compare.json", Comparison)
comparison.groups["wall"].rho_d.in_sigmas          # (r, g, b)
artefact.write_json("compare.json", record.plain(comparison))
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lib.core.record import Wrong, flag, items, list_of, number, part, table_of, told, word
from lib.given.materials import FoundTransfer

ENOUGH_PX = 500  # of a group that is counted


def _values(value):
    """A list of numbers, each of which may be null."""
    if not all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in items(value)):
        raise Wrong("holds what is neither null nor a number")
    return tuple(value)


def _two_kinds(value):
    if len(items(value)) != 2 or not all(isinstance(v, str) for v in value):
        raise Wrong("is not two kinds: the found and the true one")
    return tuple(value)


def _wrong_kinds(value):
    return {name: _two_kinds(pair) for name, pair in value.items()} if isinstance(value, dict) else items(value)


@dataclass(frozen=True)
class Deviation:
    """Some numbers of a group, in truth and as found; only `truth` where they were not found.

    relative : None where the truth is 0;  in_sigmas : None where there is no sigma
    """

    truth: tuple | None = told(_values)
    value: tuple | None = told(_values)
    sigma: tuple | None = told(_values)
    absolute: tuple | None = told(_values)
    relative: tuple | None = told(_values)
    in_sigmas: tuple | None = told(_values)

    @classmethod
    def of(cls, value, truth, sigma):
        """value : None where nothing was found;  sigma : None where it is not known"""
        if value is None:
            return cls(truth)
        absolute = tuple(a - b for a, b in zip(value, truth, strict=True))
        relative = tuple(d / t if t else None for d, t in zip(absolute, truth, strict=True))
        known = sigma or (None,) * len(truth)
        in_sigmas = tuple(d / s if s else (0.0 if d == 0 else None) for d, s in zip(absolute, known, strict=True))
        return cls(truth, value, sigma, absolute, relative, in_sigmas)

    def written(self):
        """The fields that a file shows."""
        return ("truth",) if self.value is None else tuple(self.__dataclass_fields__)


@dataclass(frozen=True)
class Turn:
    """A direction, in truth and as found, up to its sign. degrees : (1,) the angle between them;  sigma : degrees"""

    truth: tuple | None = told(_values)
    value: tuple | None = told(_values)
    degrees: tuple | None = told(_values)
    sigma: float | None = told(number())
    in_sigmas: tuple | None = told(_values)

    @classmethod
    def of(cls, value, truth, sigma_rad):
        """Either direction may be of any length.

        >>> Turn.of([0, -1, 0], [0, 1, 0], None).degrees
        (0.0,)
        >>> round(Turn.of([1, 1, 0], [1, 0, 0], math.radians(15)).in_sigmas[0], 9)
        3.0
        """
        if not value or not any(value):
            return cls(truth)
        (x, y, z), (u, v, w) = value, truth
        cross = math.hypot(y * w - z * v, z * u - x * w, x * v - y * u)
        degrees = math.degrees(math.atan2(cross, abs(x * u + y * v + z * w)))
        sigma = None if sigma_rad is None else math.degrees(sigma_rad)
        return cls(truth, value, (degrees,), sigma, (degrees / sigma if sigma else None,))

    written = Deviation.written


@dataclass(frozen=True)
class GroupComparison:
    """One group of truth that is no lamp.

    given : scene.yaml told its reflectance;  counted : it takes part in reflectance.* (a diffuse group of ENOUGH_PX)
    kind : the found and the true one
    """

    pixels: int | None = told(number())
    given: bool | None = told(flag)
    identified: bool | None = told(flag)
    counted: bool | None = told(flag)
    kind: tuple | None = told(_two_kinds)
    rho_d: Deviation | None = part(Deviation, absent=True)
    rho_s: Deviation | None = part(Deviation, absent=True)
    alpha: Deviation | None = part(Deviation, absent=True)
    tangent: Turn | None = part(Turn, absent=True)

    @property
    def is_judged(self):
        """It has a value that the photograph gave."""
        return self.identified and not self.given


@dataclass(frozen=True)
class TextureComparison:
    """rmse : of the albedo over so many pixels"""

    rmse: float | None = told(number())
    pixels: int | None = told(number())


@dataclass(frozen=True)
class TransferComparison:
    """The camera's transfer function."""

    value: FoundTransfer = part(FoundTransfer)
    truth: FoundTransfer = part(FoundTransfer)


@dataclass(frozen=True)
class LampComparison:
    """Emittances. given : scene.yaml told it;  relative : only where both are known"""

    given: bool | None = told(flag)
    value: tuple | None = told(_values)
    truth: tuple | None = told(_values)
    sigma: tuple | None = told(_values)
    relative: tuple | None = told(_values, absent=True)


@dataclass(frozen=True)
class ErrorAgainst:
    """An error of a stage's result, with its unit and its yardstick."""

    stage: str | None = told(word())
    name: str | None = told(word())
    value: float | None = told(number())
    unit: str | None = told(word())
    against: str | None = told(word())


@dataclass(frozen=True)
class Comparison:
    """The whole file; what there is no truth of is None. truth : there was any

    kinds : {group: (found, true)} of those that are found to be what they are not
    """

    scene: str | None = told(word())
    truth: bool | None = told(flag)
    enough_px: int = told(number(), ENOUGH_PX)
    errors: list = list_of(ErrorAgainst)
    groups: dict | None = table_of(GroupComparison, absent=True)
    kinds: dict | None = told(_wrong_kinds, absent=True)
    textures: dict | None = table_of(TextureComparison, absent=True)
    transfer: TransferComparison | None = part(TransferComparison, absent=True)
    lamps: dict | None = table_of(LampComparison, absent=True)

    def error(self, name):
        """The value of an error, or None."""
        return next((e.value for e in self.errors if e.name == name), None)
