"""materials.json: what the surfaces, the lamps and the camera's transfer function were found to be.

    found = materials.read("materials.json")
    found.groups["wall"].rho_d              # (r, g, b), or None: not identified
    materials.write("materials.json", found)

One type that `fit` writes, `render` reads, `compare` compares and the page shows. Names and meaning: data/SCENE.md,
section 4.
Every field but `groups` may be missing in a file that somebody wrote by hand; it is then None or empty, never a guess.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lib.core import artefact, bounded, record
from lib.core.record import (
    Wrong,
    flag,
    items,
    list_of,
    matrix,
    number,
    numbers,
    part,
    plain,
    table,
    table_of,
    table_with,
    told,
    word,
)
from lib.core.stage import BadInput
from lib.core.words import about
from lib.given import transfer_kinds
from lib.given.kinds import KINDS, LOBES, MIRRORS
from lib.given.transfer import Transfer

# of a fit; truth says "truth"
STATUSES = ("converged", "approximate", "not converged", "does not fit", "nothing seen")
WORST_CONDITION = 100.0  # of a colour matrix: cameras' have 2 to 5
SCALES = ("lamps", "reference", "interreflection", "convention", "contradicted")


def _textures(value):
    for facet, file in record.table(value).items():
        if not (re.fullmatch("[0-9]{1,9}", facet) and isinstance(file, str)):
            raise Wrong(f"has {facet}: {file!r}, which is not a facet's number and a file")
        if bounded.lies_outside(file):
            raise Wrong(f"has {facet}: {file!r}, which lies outside the folder of the file")
    return {int(facet): file for facet, file in value.items()}


def _rising(value):
    """Samples of a curve: at least 64 numbers that rise from 0 to 1."""
    good = isinstance(value, list) and len(value) >= 64 and all(isinstance(v, int | float) for v in value)
    if not good or value[0] != 0 or value[-1] != 1 or any(b <= a for a, b in itertools.pairwise(value)):
        raise Wrong("is not at least 64 numbers that rise from 0 to 1")
    return tuple(map(float, value))


def _rising_or_three(value):
    """The same, or such a list for each of three channels."""
    if isinstance(value, list) and len(value) == 3 and all(isinstance(v, list) for v in value):
        return tuple(map(_rising, value))
    return _rising(value)


def _direction(value):
    """Three numbers that are not all 0."""
    if not any(aim := numbers(3)(value)):
        raise Wrong("has no direction")
    return aim


def _sigma_of_transfer(value):
    if isinstance(value, list):
        return matrix(1, unknown=True)([value])[0]
    return number(0)(value)


# ---- what the file holds ----


@dataclass(frozen=True)
class Sigma:
    """Standard deviations of a group's values; None where the value is no finding."""

    rho_d: tuple | None = told(numbers(3, 0))
    rho_s: tuple | None = told(numbers(3, 0), absent=True)
    alpha: tuple | None = told(numbers(2, 0), absent=True)
    tangent_rad: float | None = told(number(0), absent=True)


@dataclass(frozen=True)
class Rung:
    """How a group came to its kind.

    tried : [{rung, excess, ...}] at the steps that led there; excess is the display RMSE beyond noise
    """

    rung: str | None = told(word())
    why: str | None = told(word())
    tried: list | None = told(items)


@dataclass(frozen=True)
class Group:
    """One group: how its surfaces reflect, per channel (r, g, b). `data/SCENE.md` has the conventions (Ward's lobe).

    assumed : the diffuse reflectance that the balance takes where none was found
    texture : {facet number: file}, seen from the folder of materials.json
    error : display RMSE;  pixels : that show it, trusted or not
    """

    kind: str | None = told(word(*KINDS))
    rho_d: tuple | None = told(numbers(3, 0, 1))
    rho_s: tuple | None = told(numbers(3, 0, 1))
    alpha: tuple | None = told(numbers(2, 1e-4, 2))
    tangent: tuple | None = told(numbers(3, -1, 1))
    texture: dict | None = told(_textures)
    assumed: tuple | None = told(numbers(3, 0, 1))
    sigma: Sigma = part(Sigma)
    pixels: int | None = told(number(0))
    error: float | None = told(number(0))
    identified: bool | None = told(flag)
    ladder: Rung | None = part(Rung, absent=True)

    @property
    def is_mirror(self):
        return self.kind in MIRRORS

    @property
    def has_lobe(self):
        return self.kind in LOBES

    @property
    def is_specular(self):
        return self.is_mirror or self.has_lobe

    @property
    def in_balance(self):
        """The diffuse reflectance that the light balance takes, (3,) or None: found, else assumed."""
        return self.rho_d if self.rho_d is not None else self.assumed


@dataclass(frozen=True)
class Lobe:
    """How a lamp throws its light: pi x radiance = emittance x max(0, cos(direction, aim))^exponent."""

    aim: tuple | None = told(_direction, needed="a direction, three numbers")
    exponent: float | None = told(number(0), needed="a number from 0")

    @property
    def array(self):
        """(4,) unit aim and exponent."""
        aim = np.asarray(self.aim, float)
        return np.append(aim / np.linalg.norm(aim), self.exponent)


@dataclass(frozen=True)
class LampSigma:
    """Standard deviations of what was estimated of a lamp; of its aim the angle, of its place along the axes."""

    emittance: tuple | None = told(numbers(3, 0), absent=True)
    aim_deg: float | None = told(number(0), absent=True)
    exponent: float | None = told(number(0), absent=True)
    offset_m: tuple | None = told(numbers(3, 0), absent=True)


@dataclass(frozen=True)
class Lamp:
    """lobe : None where the lamp is lambertian;  offset_m : from its place in the model, None where it stands there
    sigma, identified : None where all was given;  rho_d : of a lamp that is a reference, too
    """

    emittance: tuple | None = told(numbers(3, 0))
    lobe: Lobe | None = part(Lobe, null=True)
    offset_m: tuple | None = told(numbers(3))
    sigma: LampSigma | None = part(LampSigma, null=True)
    identified: bool | None = told(flag)
    rho_d: tuple | None = told(numbers(3, 0, 1), absent=True)


@dataclass(frozen=True)
class FoundTransfer:
    """gamma : of kind `gamma`;  sigma : of gamma, or of each display value of a curve; None where it was given

    linear, display : (n,) samples of a `curve`, rising from 0 to 1, or three such tuples
    matrix : of a curve, camera-linear = matrix x scene, (3, 3) or None
    asked : what scene.yaml asks for;  rivals : {kind: nats by which held-out tiles prefer it to this one}
    """

    kind: str | None = told(word(*transfer_kinds.KINDS))
    gamma: float | None = told(number(0))
    linear: tuple | None = told(_rising_or_three)
    display: tuple | None = told(_rising_or_three)
    sigma: float | tuple | None = told(_sigma_of_transfer)
    matrix: tuple | None = told(matrix(3, 3))
    asked: str | None = told(word(), absent=True)
    rivals: dict | None = told(table_with(number(), "numbers"), absent=True)

    def written(self):
        """The fields that a file shows."""
        own = {"gamma": ("gamma", "sigma"), "curve": ("linear", "display", "matrix", "sigma")}
        return ("kind", *own.get(self.kind, ()), "asked", "rivals")

    @property
    def function(self) -> Transfer:
        """What takes light to display values."""
        if self.kind != "curve":
            return Transfer(self.kind, self.gamma or 1.0)
        own = [Transfer("curve", samples=pair) for pair in self.channels]
        whole = own[0] if len(own) == 1 else Transfer("curve", channels=tuple(own))
        return replace(whole, matrix=self.matrix or ())

    @property
    def channels(self) -> list:
        """[(linear, display)] samples of a curve, one pair or three."""
        several = [isinstance(values[0], tuple) for values in (self.linear, self.display)]
        if not any(several):
            return [(self.linear, self.display)]
        linear, display = (v if own else (v,) * 3 for v, own in zip((self.linear, self.display), several, strict=True))
        return list(zip(linear, display, strict=True))


@dataclass(frozen=True)
class Rival:
    """Another explanation. evidence_nats : by which held-out tiles prefer it to the one before"""

    cause: str | None = told(word())
    evidence_nats: float | None = told(number())


@dataclass(frozen=True)
class Cause:
    """What was not as given, and was taken into the fit. values : by name, data/SCENE.md; sigma : likewise"""

    cause: str | None = told(word())
    subject: str | None = told(word())
    values: dict | None = told(table)
    sigma: dict | None = told(table)
    evidence_nats: float | None = told(number())
    rivals: list = list_of(Rival)


@dataclass(frozen=True)
class Causes:
    """refined.json: why the camera or the model are not as given."""

    causes: list = list_of(Cause)


@dataclass(frozen=True)
class Why:
    """What is likeliest wrong where photograph and given facts do not agree."""

    cause: str | None = told(word())
    subject: str | None = told(word())
    text: str | None = told(word())
    evidence_nats: float | None = told(number())


@dataclass(frozen=True)
class Fit:
    """rmse : display RMSE over the photograph's tiles"""

    rmse: float | None = told(number(0))
    iterations: int | None = told(number(0))


@dataclass(frozen=True)
class Materials:
    """The whole file. scale : what fixed the scale of the light, of SCALES

    to : how well values are known where the status is `approximate` or worse, median of sigma / rho of seen groups
    sigma_scale : of what all values have in common, relatively and by channel, where the scale is contradicted
    explained : causes that were taken, best first
    why : what is likeliest wrong, where the status is `approximate` or `does not fit`
    """

    status: str | None = told(word())
    groups: dict = table_of(Group, needed="a table of groups")
    lamps: dict = table_of(Lamp)
    transfer: FoundTransfer = part(FoundTransfer)
    to: float | None = told(number(0), absent=True)
    scale: str | None = told(word(*SCALES))
    sigma_scale: tuple | None = told(numbers(3, 0), absent=True)
    image: Fit = part(Fit)
    explained: list = list_of(Cause)
    why: list = list_of(Why)

    @property
    def cautions(self) -> list[str]:
        """What is to be said of all that is made from these materials, lines."""
        if self.status not in ("approximate", "does not fit"):
            return []
        why = self.why[0].text if self.why and self.why[0].text else "photograph and given facts disagree"
        if self.status == "does not fit":
            return [f"the scene does not fit its photograph, and what is made from it is off as well: {why}"]
        known = "roughly" if self.to is None else about(self.to)
        return [f"the scene fits its photograph {known}, and what is made from it is as good: {why}"]

    @property
    def lobes(self):
        """{lamp: (4,) unit aim and exponent} of those that are not lambertian."""
        return {name: lamp.lobe.array for name, lamp in self.lamps.items() if lamp.lobe is not None}

    @property
    def outside(self):
        """(10, 3) the glow that comes in where the model is open, and its changes, see lib/light/outside.py."""
        values = next((cause.values for cause in self.explained if cause.cause == "glow"), {})
        parts = (("radiosity", 1), ("gradient", 3), ("curvature", 6))
        return np.vstack([np.reshape(values.get(name) or np.zeros((n, 3)), (n, 3)) for name, n in parts])

    def texture_files(self, path):
        """{group: {facet: file}}, the files as seen from where materials.json at `path` lies."""
        folder = Path(path).parent
        return {
            name: {facet: folder / file for facet, file in group.texture.items()}
            for name, group in self.groups.items()
            if group.texture
        }


def read(path) -> Materials:
    """materials.json, found or true. BadInput: one line for each value that breaks its rule: file, field, value."""
    return record.read(path, Materials)


def read_curve(path) -> Transfer:
    """A measured response: what stands under `transfer` in materials.json, of the kind curve, in a file of its own.

    BadInput: it is no curve, or its colour matrix cannot be undone.
    """
    found = record.read(path, FoundTransfer)
    if found.kind != "curve" or found.linear is None or found.display is None:
        raise BadInput(f"{path}: kind: {found.kind!r} with linear and display is not a curve")
    for linear, display in found.channels:
        if len(linear) != len(display):
            raise BadInput(f"{path}: display: {len(display)} values are not as many as linear's {len(linear)}")
    if found.matrix is not None and not np.linalg.cond(found.matrix) < WORST_CONDITION:
        raise BadInput(f"{path}: matrix: {found.matrix} cannot be undone")
    return found.function


def lobe(value):
    """(4,) unit aim and exponent of scene.yaml's {aim, exponent}."""
    return Lobe(tuple(map(float, value["aim"])), float(value["exponent"])).array


def read_causes(path) -> list[Cause]:
    """refined.json."""
    return record.read(path, Causes).causes


def write_causes(path, causes: Causes):
    """Whole or absent."""
    artefact.write_json(path, plain(causes))


def write(path, materials: Materials):
    """Whole or absent. ValueError: a value that is not finite."""
    shown = plain(materials)
    artefact.write_json(path, shown | {"why": shown["why"] or None})
