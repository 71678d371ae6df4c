"""formfactors.npz: patches, the factors between them, and those to the lamps."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from lib.core import arrays, artefact
from lib.core.arrays import Real, Size, Starts, Text, Whole
from lib.core.stage import BadInput
from lib.light.balance import spectral_radius
from lib.light.cells import Mesh
from lib.light.form_factors import FormFactorRows
from lib.light.lamps import LAMBERTIAN

SHARE = 1 / 3  # of what the step to the next coarser cell would lose that is lost inside a cell
# names among lamps of what lies around an open model, by powers of three axes (lib/light/outside.py): no groups'
OUTSIDE = ("", " x", " y", " z", " xx", " yy", " zz", " xy", " yz", " zx")
NEAR = 0.4  # of their light that patches exchange across a gap narrower than they are, at least
CONTRACTS = 1e-3  # a spectral radius may exceed the largest row sum by so much: single precision, and the search


@dataclass(frozen=True)
class FormFactors:
    """What formfactors.npz holds: the patches, the factors between them, and those to the lamps."""

    mesh: Mesh
    rows: FormFactorRows
    lamp_factor: np.ndarray  # (N, L)
    lamps: tuple  # names, in the order of the columns
    patch_group: np.ndarray  # (N,) int32, numbers of `groups`
    groups: tuple
    group_area_m2: np.ndarray  # (G,)
    diagonal_m: float
    # {name: (4,)} of lamps whose lobes lamp_factor knows; the file's are lambertian, throws.in_lobes
    lobes: dict = field(default_factory=dict)
    outside: Any = None  # lib.light.outside.Outside, where the last of the lamps are around the model; not in the file

    @property
    def own_lamps(self):
        """Names of the lamps that are in the model."""
        return tuple(name for name in self.lamps if name not in OUTSIDE)

    @property
    def uneven(self):
        """Numbers of the lamps whose flux is not that of an even emitter's area: lobes, and what comes from outside."""
        return [k for k, name in enumerate(self.lamps) if name in self.lobes or name in OUTSIDE]

    @property
    def lamp_groups(self):
        """(L,) numbers of the groups that emit, -1 for the outside."""
        return np.array([-1 if name in OUTSIDE else self.groups.index(name) for name in self.lamps], int)

    @property
    def lobe_of_lamps(self):
        """(L, 4) unit aims and exponents."""
        return np.array([self.lobes.get(name, LAMBERTIAN) for name in self.lamps]).reshape(-1, 4)

    @property
    def area(self):
        """(N,) local, the part of each patch outside solids."""
        return self.mesh.area * self.rows.exposed

    @cached_property
    def subcell(self):
        """(N, N) CSR: b -> b + SHARE * (b - mean of b over the patch and its siblings), for the *sources* of a balance.

        A patch of constant radiosity shows its bright and its dark part alike to those who see only one of them. What
        is lost that way inside a cell is a fixed share of what the step to the next coarser cell would lose:
        (h^2 / 12) / (h^2 / 4) = 1/3 where light varies linearly, 1 across a random edge. Row by row this is
        Richardson's extrapolation in the size of the patches. It is linear, and each parent keeps its light
        (docs/decisions/sub-cell-correction.md).

        It must not make the light balance expansive: where it does, patches `beside_gaps` are left as they are.
        """
        everywhere = self._subcell(np.full(len(self.area), SHARE))
        gaps = self.beside_gaps
        F = self.rows.matrix()
        if not gaps.any() or spectral_radius(F @ everywhere) <= F.sum(axis=1).max() + CONTRACTS:
            return everywhere
        return self._subcell(np.where(gaps, 0.0, SHARE))

    def _subcell(self, share):
        """The same with a share (N,) for each patch."""
        from scipy.sparse import csr_array, diags_array

        n = len(self.area)
        total = np.bincount(self.mesh.parent, self.area)[self.mesh.parent]
        siblings = csr_array((np.ones(n), (np.arange(n), self.mesh.parent)), shape=(n, int(self.mesh.parent.max()) + 1))
        weight = diags_array(np.divide(self.area, total, out=np.zeros(n), where=total > 0))
        mean = siblings @ (siblings.T @ weight)
        return (diags_array(1 + share) - diags_array(share) @ mean).astype(np.float32).tocsr()

    @cached_property
    def beside_gaps(self):
        """(N,) bool: the patch, or a sibling of it, shares a gap with another that is narrower than they are.

        Two patches as near as that exchange more than NEAR of their light, sqrt(F_ij F_ji) = F_ij sqrt(A_i / A_j).
        Light that differs between siblings returns from there all but undiminished, and the correction raises it at
        each pass: the spectral radius comes to 1.2 (docs/decisions/sub-cell-correction.md).
        """
        F = self.rows.matrix().tocoo()
        i, j = F.coords
        size = np.sqrt(np.maximum(self.area, 1e-300))
        near = (F.data * size[i] > NEAR * size[j]) & (self.area[i] > 0) & (self.area[j] > 0)
        parent = self.mesh.parent
        beside = np.zeros(int(parent.max()) + 1, bool)
        beside[parent[i[near]]] = beside[parent[j[near]]] = True
        return beside[parent]


def write(path, factors: FormFactors):
    """Whole or absent."""
    artefact.write_npz(
        path,
        **{f"mesh_{f.name}": getattr(factors.mesh, f.name) for f in fields(Mesh)},
        **{f"rows_{f.name}": getattr(factors.rows, f.name) for f in fields(FormFactorRows)},
        lamp_factor=factors.lamp_factor,
        lamps=np.array(factors.lamps, str),
        groups=np.array(factors.groups, str),
        patch_group=factors.patch_group,
        group_area_m2=factors.group_area_m2,
        diagonal_m=factors.diagonal_m,
    )


ROWS = {
    "columns": Size("N"),
    "indptr": Starts("R+1", into="K"),
    "indices": Whole("K", below="N"),
    **dict.fromkeys(("count", "half"), Real("K", low=0)),
    **dict.fromkeys(("valid", "valid_half", "shot", "lost"), Real("R", low=0)),
}  # of R receivers, FormFactorRows
MESH = {
    "side": Whole("N", below="S"),
    "table_start": Whole("S", low=-1),
    "table_shape": Whole("S", 2, low=1),
    "leaf": Whole("Q", low=-1, below="N"),
    "area": Real("N", low=0),
    "centre": Real("N", 3),
    "tri_start": Starts("N+1", into="P"),
    "tri_uv": Real("P", 3, 2),
    "tri_cdf": Real("P", low=0),
    "tri_side": Whole("P", below="S"),
    "parent": Whole("N", below="N"),
}
OTHERS = {
    "lamps": Text("L"),
    "groups": Text("G"),
    "lamp_factor": Real("N", "L"),
    "patch_group": Whole("N", below="G"),
    "group_area_m2": Real("G", low=0),
    "diagonal_m": Real(low=0),
}


def _checked(path, a):
    """BadInput: an array of another kind, shape or range than its use asks for."""
    sizes = arrays.check(path, a, MESH, prefix="mesh_")
    arrays.check(path, a, ROWS, {"N": sizes["N"], "R": sizes["N"]}, "rows_")
    arrays.check(path, a, OTHERS, {"N": sizes["N"]})
    start, cells = a["mesh_table_start"].astype(float), a["mesh_table_shape"].astype(float).prod(axis=1)
    if (start + cells)[start >= 0].max(initial=0) > sizes["Q"]:
        raise BadInput(f"{path}: mesh_table_shape: value: a side's cells end beyond mesh_leaf's {sizes['Q']}")


def read(path, model=None, model_path=None) -> FormFactors:
    """BadInput: an array is missing or cannot be what it is for, or the factors are not those of the model."""
    names = [f"mesh_{f.name}" for f in fields(Mesh)] + [f"rows_{f.name}" for f in fields(FormFactorRows)]
    a = artefact.read_npz(path, *names, *OTHERS)
    _checked(path, a)
    rows = {f.name: a[f"rows_{f.name}"] for f in fields(FormFactorRows)}
    rows["columns"] = int(rows["columns"])
    factors = FormFactors(
        Mesh(**{f.name: a[f"mesh_{f.name}"] for f in fields(Mesh)}),
        FormFactorRows(**rows),
        a["lamp_factor"],
        tuple(map(str, a["lamps"])),
        a["patch_group"],
        tuple(map(str, a["groups"])),
        a["group_area_m2"],
        float(a["diagonal_m"]),
    )
    if model is not None:
        check(factors, path, model, model_path)
    return factors


def check(factors: FormFactors, path, model, model_path):
    """BadInput where the factors are not those of the model."""
    n_facets = len(factors.mesh.table_start) // 2
    if factors.groups != tuple(model.groups) or n_facets != model.n_facets:
        raise BadInput(
            f"{path}: groups, facets: {', '.join(factors.groups)}, {n_facets} are not those of {model_path}:"
            f" {', '.join(model.groups)}, {model.n_facets}"
        )
