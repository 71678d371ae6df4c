"""Sums of sparse matrices weighted by powers of rho_s, for many rho_s: where their entries go is found once."""

from __future__ import annotations

import numpy as np


class Mixture:
    """base + sum_k power_k parts_k, for many powers.

    base : a matrix, or None for nothing;  parts : {k: matrix}, sparse ones or dense ones
    """

    def __init__(self, base, parts):
        self.base, self.parts = base.tocsr() if hasattr(base, "tocsr") else base, parts
        self.sparse = any(hasattr(A, "tocsr") for A in parts.values())
        if not self.sparse:
            return
        every = [*parts.values(), *([] if base is None else [self.base])]
        self.shape, self.kind = every[0].shape, type(every[0])
        keys = np.sort(np.concatenate([_keys(A) for A in every]))
        keys = keys[np.flatnonzero(np.diff(keys, prepend=-1))]
        columns = np.int64(self.shape[1])
        self.indices = (keys % columns).astype(np.int32)
        indptr = np.concatenate([[0], np.cumsum(np.bincount(keys // columns, minlength=self.shape[0]))])
        self.indptr = indptr.astype(np.int32 if len(keys) < np.iinfo(np.int32).max else np.int64)
        self.places = {k: np.searchsorted(keys, _keys(A)) for k, A in parts.items()}
        self.start = np.zeros(len(keys), np.float32 if base is None else self.base.dtype)
        if base is not None:
            self.start[np.searchsorted(keys, _keys(self.base))] = self.base.data

    def at(self, power):
        """The sum at powers (K,): a matrix, or 0 where there is nothing at all."""
        if not self.sparse:
            total = self.base
            for k, part in self.parts.items():
                total = part * power[k] if total is None else total + part * power[k]
            return 0 if total is None else total
        data = np.zeros(len(self.indices), np.float32)
        for k, part in self.parts.items():
            if power[k] != 0:
                data[self.places[k]] += np.float32(power[k]) * part.data  # no entry of a part stands there twice
        return self.kind((data + self.start, self.indices, self.indptr), shape=self.shape)


def _keys(A):
    """Row by row the place of each entry of a CSR matrix, as one number."""
    return np.repeat(np.arange(A.shape[0], dtype=np.int64), np.diff(A.indptr)) * np.int64(A.shape[1]) + A.indices
