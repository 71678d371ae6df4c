"""materials.json: what the surfaces, the lamps and the camera's transfer function were found to be.

    found = materials.read("materials.json")
    found.groups["wall"].rho_d              # (r, g, b), or None: not identified
    materials.write("materials.json", found)

One type that `fit` writes, `render` reads, `compare` compares and the page shows. Names and meaning: data/SCENE.md,
section 4.
Every field but `groups` may be missing in a file that somebody wrote by hand; it is then None or empty, never a guess.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lib.core import artefact, record
from lib.core.record import Wrong, flag, items, number, numbers, part, plain, table_of, told, word
from lib.given import transfer_kinds
from lib.given.kinds import KINDS, LOBES, MIRRORS

STATUSES = ("converged", "not converged", "nothing seen")  # of a fit; truth says "truth"
SCALES = ("lamps", "reference", "interreflection", "convention")


def _textures(value):
    for facet, file in record.table(value).items():
        if not facet.isdecimal() or not isinstance(file, str):
            raise Wrong(f"has {facet}: {file!r}, which is not a facet's number and a file")
    return {int(facet): file for facet, file in value.items()}


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
class Lamp:
    """sigma : None where the emittance was given;  rho_d : of a lamp that is a reference, too"""

    emittance: tuple | None = told(numbers(3, 0))
    sigma: tuple | None = told(numbers(3, 0))
    rho_d: tuple | None = told(numbers(3, 0, 1), absent=True)


@dataclass(frozen=True)
class FoundTransfer:
    """gamma, sigma : of kind `gamma` alone; sigma is None where gamma was given"""

    kind: str | None = told(word(*transfer_kinds.KINDS))
    gamma: float | None = told(number(0))
    sigma: float | None = told(number(0))

    def written(self):
        """The fields that a file shows."""
        return ("kind", "gamma", "sigma") if self.kind == "gamma" else ("kind",)


@dataclass(frozen=True)
class Fit:
    """rmse : display RMSE over the photograph's tiles"""

    rmse: float | None = told(number(0))
    iterations: int | None = told(number(0))


@dataclass(frozen=True)
class Materials:
    """The whole file. scale : what fixed the scale of the light, of SCALES"""

    status: str | None = told(word())
    groups: dict = table_of(Group, needed="a table of groups")
    lamps: dict = table_of(Lamp)
    transfer: FoundTransfer = part(FoundTransfer)
    scale: str | None = told(word(*SCALES))
    image: Fit = part(Fit)

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


def write(path, materials: Materials):
    """Whole or absent. ValueError: a value that is not finite."""
    artefact.write_json(path, plain(materials))
