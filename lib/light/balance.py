"""The light balance b = rho (D E + F b) (eq. 3.2): the one place where it is solved, and where its light ends.

F is a list of matrices: one for all channels, or one for each where mirrors or lobes are coloured. b is the radiosity
that patches reflect, without what they emit. Everything is in single precision, which the sampling error of F dwarfs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lib.light import radiosity
from lib.light.corrected import product

BALANCED = 1e-4  # largest relative residual of a light balance that counts as solved; it is solved to 1e-5 or better
DENSE_LIMIT = 6000  # patches up to which F is kept dense where much of it is filled
FILLED = 0.25  # share of entries from which BLAS is faster than sparse products
_kept = []  # [(sparse, dense)]


def stored(F):
    """F as it multiplies fastest: dense where it is small and filled, else sparse.

    The last is kept: several fits ask for the same.
    """
    if not hasattr(F, "toarray") or F.shape[0] > DENSE_LIMIT or F.nnz < FILLED * F.shape[0] * F.shape[1]:
        return F
    if not _kept or _kept[0][0] is not F:
        _kept[:] = [(F, F.toarray())]
    return _kept[0][1]


def times(matrices, X, channel=None):
    """Each column of X (n, K) times the matrix of its channel: (rows, K), or the number 0 where there is no matrix.

    matrices : [one for all channels], or one for each, 0 for nothing; or None; or what has such a method
    channel : (K,), by default 0 ... K - 1
    """
    if matrices is None:
        return 0
    if hasattr(matrices, "times"):
        return matrices.times(X, np.arange(X.shape[1]) if channel is None else channel)
    if len(matrices) == 1:
        return product(matrices[0], X) if not isinstance(matrices[0], int) else 0
    channel = np.arange(X.shape[1]) if channel is None else channel
    size = next((A.shape[0] for A in matrices if not isinstance(A, int)), 0)
    out = np.zeros((size, X.shape[1]), np.result_type(X, np.float32))
    for c, A in enumerate(matrices):
        mine = channel == c
        if mine.any() and not isinstance(A, int):
            out[:, mine] = product(A, X[:, mine])
    return out


def spectral_radius(A) -> float:
    """Largest absolute eigenvalue of a sparse matrix (N, N), to 1e-4; infinite where Arnoldi's iteration finds none."""
    from scipy.sparse.linalg import ArpackError, eigs

    if A.shape[0] < 4:
        return float(np.abs(np.linalg.eigvals(A.toarray())).max(initial=0.0))
    try:
        start = np.ones(A.shape[0])
        return float(np.abs(eigs(A.astype(float), k=1, v0=start, tol=1e-4, return_eigenvectors=False)).max())
    except ArpackError:
        return np.inf


class Reflected(NamedTuple):
    """b : (N, K) float32, what the patches reflect;  residual : relative, the largest of all columns"""

    b: np.ndarray
    residual: float
    iterations: int


def reflected(F, rho, source, *, tolerance, x0=None, channel=None) -> Reflected:
    """The solution of b = source + rho F b, for all columns at once.

    F : see `times`;  rho : (N, K) or a number, of each patch;  source : (N, K) light reflected once
    channel : (K,) of the columns;  tolerance : of the residual, relative to the source
    """
    scale = np.asarray(rho, np.float32)
    return Reflected(
        *radiosity.gmres(
            lambda X: X - scale * times(F, X, channel),
            source.astype(np.float32, copy=False),
            tolerance=tolerance,
            x0=x0,
        )
    )


def unsolved(residual) -> str | None:
    """A warning where a balance has a larger residual than counts as solved: a picture of it is not converged.

    >>> unsolved(1e-5)
    >>> unsolved(8e-3)
    'the light balance is not solved: 0.8 % of the light is left over'
    """
    return (
        None
        if residual <= BALANCED
        else f"the light balance is not solved: {100 * residual:.2g} % of the light is left over"
    )


@dataclass(frozen=True)
class Balance:
    """The light of a scene, and where it ends. N patches, C channels.

    reflected : (N, C) radiosity without emission;  indirect : (N, C) F b, what others reflect to the patch
    emitted, absorbed, escaped : (C,) flux;  residual, iterations : of the solve
    """

    reflected: np.ndarray
    indirect: np.ndarray
    emitted: np.ndarray
    absorbed: np.ndarray
    escaped: np.ndarray
    residual: float
    iterations: int

    @property
    def imbalance(self):
        """|emitted - absorbed - escaped| / emitted over all channels; 0 in the dark."""
        lost = np.abs(self.emitted - self.absorbed - self.escaped).sum()
        return float(lost / self.emitted.sum()) if self.emitted.sum() > 0 else 0.0


@dataclass(frozen=True)
class Patches:
    """What the balance must know of the patches, all (N,).

    group : numbers;  area : local;  exposed : share outside solids;  front : bool, on the front of the facet
    reach : share of the patch's light that meets something at once
    """

    group: np.ndarray
    area: np.ndarray
    exposed: np.ndarray
    front: np.ndarray
    reach: np.ndarray


def balance(
    F, D, patches: Patches, rho, E, lamp_groups, *, tolerance=1e-6, mirrored=None, leaving=0.0, uneven=()
) -> Balance:
    """The light balance and its flux.

    F, D : (N, N), (N, L), see `times`;  rho : (G, C);  E : (L, C)
    lamp_groups : (L,) numbers of the lamps' groups, -1 for none
    mirrored : (G, C) rho_s of mirrors and lobes, which absorb that much less
    leaving : (N, C) share of a patch's light that leaves by way of those
    uneven : numbers of the lamps that throw their light in lobes or from outside: of them counts what arrives

    The flux is closed over rays alone: what leaves a patch and meets nothing, by the sums of its rays, has escaped. A
    closed scene keeps everything. The lamps' factors, reciprocity and the solve are all in what is left over.
    """
    direct = times(D, E)
    r = rho[patches.group]
    solution = reflected(F, r, r * direct, tolerance=tolerance)
    b, indirect = solution.b, times(F, solution.b)
    emittance = np.zeros_like(b, dtype=float)
    for lamp, group in enumerate(lamp_groups):
        if lamp not in uneven:
            emittance[(patches.group == group) & patches.front] += E[lamp]
    size = (patches.area * patches.exposed)[:, None]
    arriving = times(D, np.where(np.isin(np.arange(len(E)), list(uneven))[:, None], E, 0)) if len(uneven) else 0.0
    passed_on = 0.0 if mirrored is None else mirrored[patches.group]
    kept = 1 - r - passed_on
    return Balance(
        np.asarray(b, float),
        np.asarray(indirect, float),
        emitted=(size * (emittance + arriving * (1 - passed_on))).sum(axis=0),
        absorbed=(size * kept * (direct + indirect)).sum(axis=0),
        escaped=(size * (emittance + b) * (1 - patches.reach[:, None] + leaving)).sum(axis=0),
        residual=solution.residual,
        iterations=solution.iterations,
    )
