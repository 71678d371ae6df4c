"""Form factors (eq. 3.3): the fraction F[i, j] of the light leaving patch i that reaches patch j.

Rows by rays: points spread over the patch and cosine-distributed directions together form one four-dimensional
low-discrepancy set. So a row's sum is 1 in a closed scene before any normalisation, and an error in one factor is
compensated in its neighbour. Lamps are small and bright: lamps.py treats them apart.

A ray that starts inside a solid is dropped, and the row is divided by the rays that remain: a wall behind a cabinet is
not darkened by the inside of the cabinet (docs/decisions/solids.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.given.rays import shifts, sobol
from lib.light import form_factors_kernels as kernels
from lib.light.cells import Mesh
from lib.light.surface import Surface, buried

CHUNK = 1 << 20  # rays in flight


@dataclass(frozen=True)
class FormFactorRows:
    """Sparse rows of F from rays: F[i, indices[k]] = count[k] / valid[i] for indptr[i] <= k < indptr[i + 1].

    `half` counts the first half of the rays alone: the two halves differ by the sampling error.
    """

    indptr: np.ndarray  # (M + 1,) int64
    indices: np.ndarray  # (nnz,) int32
    count: np.ndarray  # (nnz,) float32
    half: np.ndarray  # (nnz,) float32
    valid: np.ndarray  # (M,) float32, rays that start outside solids
    valid_half: np.ndarray  # (M,) float32
    shot: np.ndarray  # (M,) int64
    lost: np.ndarray  # (M,) float32, rays whose hit lies on no patch (counted as black)
    columns: int

    def matrix(self, half=None):
        """(M, N) scipy.sparse CSR float32; half 0 or 1: from the first or the second half of the rays alone."""
        from scipy.sparse import csr_array

        count = self.count if half is None else self.half if half == 0 else self.count - self.half
        valid = self.valid if half is None else self.valid_half if half == 0 else self.valid - self.valid_half
        scale = np.repeat(1 / np.maximum(valid, 1), np.diff(self.indptr))
        return csr_array(
            ((count * scale).astype(np.float32), self.indices, self.indptr), shape=(len(self.valid), self.columns)
        )

    @classmethod
    def dense(cls, F) -> FormFactorRows:
        """Rows of a matrix (N, N) that did not come from rays."""
        row, column = np.nonzero(F)
        value = F[row, column].astype(np.float32)
        one = np.ones(len(F), np.float32)
        return cls(
            np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(F)))]),
            column.astype(np.int32),
            value,
            value / 2,
            one,
            one / 2,
            np.ones(len(F), np.int64),
            np.zeros(len(F), np.float32),
            F.shape[1],
        )

    @property
    def row_sums(self):
        """(M,) before any normalisation: 1 in a closed scene, 0 for a patch wholly inside a solid."""
        total = np.zeros(len(self.valid))
        np.add.at(total, np.repeat(np.arange(len(self.valid)), np.diff(self.indptr)), self.count)
        return total / np.maximum(self.valid, 1)

    def take(self, which) -> FormFactorRows:
        """The rows numbered `which`."""
        at = elements(self.indptr, which)
        return FormFactorRows(
            np.concatenate([[0], np.cumsum(np.diff(self.indptr)[which])]),
            self.indices[at],
            self.count[at],
            self.half[at],
            self.valid[which],
            self.valid_half[which],
            self.shot[which],
            self.lost[which],
            self.columns,
        )

    @property
    def exposed(self):
        """(M,) share of the patch that lies outside solids."""
        return self.valid / np.maximum(self.shot, 1)


def elements(start, which):
    """Indices of the elements of the sets numbered `which`.  start : (n + 1,), where each set begins"""
    n = np.diff(start)[which]
    return np.repeat(start[which] - np.concatenate([[0], np.cumsum(n)[:-1]]), n) + np.arange(int(n.sum()))


def trace(surface: Surface, mesh: Mesh, rays):
    """The patch that each ray (n, 6) arrives at, (n,) int32, see `located`."""
    return located(surface, mesh, rays, *surface.caster.closest(rays))


def located(surface: Surface, mesh: Mesh, rays, triangle, distance):
    """(n,) int32: the patch on which each ray ends, or kernels.ESCAPED, DROPPED (it starts in a solid) or LOST.

    rays : (n, 6) float32;  triangle, distance : (n,) their ends, as Caster.closest tells them
    """
    hit = kernels.locate(rays, triangle, distance, surface.arrays, mesh.table)
    hit[buried(surface, rays, triangle)] = kernels.DROPPED
    return hit


def chunks(ray_start):
    """Ranges (first, last) of elements with about CHUNK rays in each; at least one element.  ray_start : (M + 1,)"""
    first, m = 0, len(ray_start) - 1
    while first < m:
        last = max(first + 1, int(np.searchsorted(ray_start, ray_start[first] + CHUNK, "right")) - 1)
        yield first, last
        first = last


def _rows(surface, mesh, ray_start, make, progress=None) -> FormFactorRows:
    """Rows of all elements, in chunks: make(first, last) -> rays of the elements first..last-1."""
    m = len(ray_start) - 1
    if m == 0:
        return counted(np.zeros(0, np.int32), np.zeros(1, np.int64), 0, 0, len(mesh))
    parts = []
    for first, last in chunks(ray_start):
        parts.append(counted(trace(surface, mesh, make(first, last)), ray_start, first, last, len(mesh)))
        if progress is not None:
            progress(last / m)
    if len(parts) == 1:
        return parts[0]
    join = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("indices", "count", "half", "valid", "valid_half", "shot", "lost")
    }
    return FormFactorRows(
        indptr=np.concatenate([[0], np.cumsum(np.concatenate([np.diff(part.indptr) for part in parts]))]),
        columns=len(mesh),
        **join,
    )


def counted(hit, ray_start, first, last, columns) -> FormFactorRows:
    """Rows of the elements first..last-1 from the patch that each of their rays met.

    hit : int32, of these elements' rays;  ray_start : (M + 1,) of all elements;  columns : N
    """
    keys, entries, valid, valid_half, lost = kernels.compress(hit, ray_start, first, last)
    indptr = np.concatenate([[0], np.cumsum(entries)])
    indices, count, half = kernels.fill(keys, ray_start, first, last, indptr)
    return FormFactorRows(
        indptr, indices, count, half, valid, valid_half, np.diff(ray_start[first : last + 1]), lost, columns
    )


def rays(surface: Surface, mesh: Mesh, *, n_rays, seed=0, progress=None, begin=0) -> FormFactorRows:
    """F between all patches from `n_rays` rays per patch (a power of two spreads best).

    Error about 0.5 / n_rays^0.75 of a row's irradiance, measured by `make bench`.
    progress : called with the share done;  begin : the rows of the patches from this number on alone
    """
    ray_start, make = from_patches(surface, mesh, n_rays, seed)
    later = lambda first, last: make(begin + first, begin + last)
    return _rows(surface, mesh, ray_start[begin:] - ray_start[begin], later, progress)


def from_patches(surface: Surface, mesh: Mesh, n_rays, seed=0):
    """Where each patch's rays begin, (N + 1,), and make(first, last) -> rays of the patches first..last-1, (n, 6)."""
    points, shift = sobol(n_rays), shifts(len(mesh), n_rays, seed)
    pieces, arrays = mesh.pieces, surface.arrays
    make = lambda first, last: kernels.patch_rays(first, last, n_rays, points, shift, pieces, arrays)
    return np.arange(len(mesh) + 1, dtype=np.int64) * n_rays, make


def gather(surface: Surface, mesh: Mesh, points, point_start, side, n_rays, *, seed=0, progress=None) -> FormFactorRows:
    """F from sets of points (pixels) to all patches.

    points : (M, 3) local;  point_start : (K + 1,) the points of each set;  side : (K,) side of the facet they lie on
    n_rays : (K,) rays of each set, spread over its points;  progress : called with the share done
    """
    return _rows(surface, mesh, *from_points(surface, points, point_start, side, n_rays, seed), progress)


def from_points(surface: Surface, points, point_start, side, n_rays, seed=0):
    """`from_patches` for sets of points: see `gather`."""
    ray_start = np.concatenate([[0], np.cumsum(n_rays)]).astype(np.int64)
    most = int(np.max(n_rays, initial=1))
    sequence, shift, other = sobol(most), shifts(len(side), most, seed), shifts(len(side), most, seed + 1)
    sets = kernels.PointSets(
        ray_start, np.asarray(point_start, np.int64), np.asarray(points, float), np.asarray(side, np.int32)
    )
    arrays = surface.arrays
    return ray_start, lambda first, last: kernels.point_rays(first, last, sets, sequence, shift, other, arrays)
