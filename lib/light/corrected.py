"""Sparse matrices of light, and their products with columns of it."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from lib.light import radiosity_kernels as kernels


def product(A, X):
    """A X of an array or a sparse matrix A (M, N), X (N,) or (N, K)."""
    if X.ndim == 1 or getattr(A, "format", None) != "csr" or X.dtype != A.dtype:
        return A @ X
    return kernels.sparse_times(A.indptr, A.indices, A.data, np.ascontiguousarray(X))


class Corrected:
    """Rows (M, N) times a correction of their sources (N, N), as one matrix.

    Rays hit a tenth of the patches of a room, and the correction (FormFactors.subcell) joins each patch to its
    siblings: multiplied out there are twice as many entries, so the two are kept apart.
    """

    def __init__(self, rows, correction):
        self.rows, self.correction = rows, correction
        self.shape, self.dtype, self.nnz = rows.shape, rows.dtype, rows.nnz + correction.nnz

    def __matmul__(self, X):
        return product(self.rows, product(self.correction, X))

    @cached_property
    def _explicit(self):
        return (self.rows @ self.correction).tocsr()

    def tocsr(self):
        """Multiplied out."""
        return self._explicit

    def toarray(self):
        """(M, N), multiplied out."""
        return self._explicit.toarray()
