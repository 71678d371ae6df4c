"""§3.3 The light balance B = E + rho F B (eq. 3.2) and its solvers.

    solution = solve(E, rho, F)                       # GMRES: what everything else uses
    solution = solve(E, rho, F, method="progressive", area=area, callback=show)     # figure 3.9

Every method reports the same *residual*, max |E + rho F B - B|, and from it a bound of the error. A residual is
not an error: where little light is lost at a bounce, a small residual still allows a large error. The inverse of
I - rho F has no negative entry, so any w > 0 with w - rho F w > 0 bounds it (w = 1 does while rho F 1 < 1):

    max |B - B*| <= residual * max(w) / min(w - rho F w)          = residual / (1 - max rho)  at w = 1, rows of sum 1

The methods, from the paper's list: `jacobi` and `gauss_seidel` gather, `southwell` and `progressive` shoot,
`krylov` minimises the residual over all bounces so far, `direct` eliminates. `make bench` draws their curves.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from lib.light import radiosity_kernels as kernels
from lib.light.radiosity_kernels import Elements, Receivers, Shooting

METHODS = ("krylov", "direct", "gauss_seidel", "jacobi", "southwell", "progressive")


class Step(NamedTuple):
    """A point of the trace: seconds since the solve began, without the callback's; shots tell their unshot light."""

    iteration: int
    cpu_s: float
    wall_s: float
    residual: float


@dataclass(frozen=True)
class Solution:
    """B : (N,) or (N, C), as E and rho      radiosity of each patch
    residual : max |E + rho F B - B|
    bound : max |B - B*| is at most this; inf where it cannot be told
    iterations : sweeps, products with F, or shots, whichever the method counts
    converged : bool
    trace : [Step] of the iterations
    """

    B: np.ndarray
    residual: float
    bound: float
    iterations: int
    converged: bool
    method: str
    trace: list = field(default_factory=list, repr=False)


def solve(
    E,
    rho,
    F,
    *,
    method="krylov",
    tolerance=1e-6,
    max_iterations=10_000,
    x0=None,
    callback=None,
    every=1,
    area=None,
    patch=None,
    ambient=False,
    overshoot=False,
) -> Solution:
    """Solve the light balance B = E + rho F B (eq. 3.2).

    E : (N,) or (N, C)      emittance of each patch, any unit; B has the same
    rho : (N,) or (N, C)    diffuse reflectivity, in [0, 1]
    F : (N, N)              array or scipy.sparse; F[i, j] leaves i and reaches j; rows sum to at most 1
    tolerance               of the residual, as a part of the brightest emittance of the channel
    x0                      a first guess: the answer for slightly different rho (krylov, jacobi, gauss_seidel)
    callback, every         called as callback(iteration, B) after each iteration, or after so many shots; its time is
                            not counted
    area : (N,)             progressive: patches shoot by power; default: all equal
    patch : (N,) int        progressive: the patch to which each element belongs. Patches shoot, with the mean
                            radiosity of their elements, and elements receive; default: each its own patch
    ambient, overshoot      progressive: add the light not yet shot as an even glow to B; shoot in advance the
                            part of that glow which the patch will reflect (only ever in advance, never back)

    rho = 1 is allowed as long as light can leave: an open scene, or an absorbing patch that it can reach.

    Raises ValueError, in one line, where rho or E is not a number or rho is outside [0, 1], where a row of F
    sums to more than 1, and where no balance exists: lit patches between which light is never lost.

    Iterations grow like log(tolerance) / log(max rho) for the sweeps, and with the square root of 1 / (1 - rho)
    at most for krylov, which in a room of a few bright groups needs about ten.

    >>> solve(np.array([1., 0.]), np.array([0., .5]), np.array([[0., 1.], [1., 0.]]), tolerance=1e-12).B
    array([1. , 0.5])
    """
    if method not in METHODS:
        raise ValueError(f"method = {method!r} is not one of {', '.join(METHODS)}")
    one = np.ndim(E) == 1 and np.ndim(rho) == 1
    E = np.asarray(E, float)
    rho = np.asarray(rho, float)
    E, rho = np.broadcast_arrays(E[:, None] if E.ndim == 1 else E, rho[:, None] if rho.ndim == 1 else rho)
    E, rho = np.ascontiguousarray(E), np.ascontiguousarray(rho)
    F = F if isinstance(F, Factors) else Factors(F)
    rho = _checked(E, rho, F)
    peak = np.abs(E).max(axis=0, initial=0.0)
    target = tolerance * np.where(peak > 0, peak, 1.0)
    watch = _Watch(callback, one)
    if x0 is not None:
        x0 = np.array(x0, float).reshape(E.shape)
    if method == "krylov":
        B, n, done = _krylov(E, rho, F, target, max_iterations, x0, watch)
    elif method == "direct":
        B, n, done = _direct(E, rho, F, target, watch)
    elif method in ("gauss_seidel", "jacobi"):
        B, n, done = _sweeps(E, rho, F, target, max_iterations, x0, watch, method == "gauss_seidel")
    else:
        B, n, done = _shots(E, rho, F, target, max_iterations, watch, method, area, patch, ambient, overshoot, every)
    r = E + rho * F.times(B) - B
    residual = float(np.abs(r).max(initial=0.0))
    return Solution(B[:, 0] if one else B, residual, _bound(rho, F, residual), n, bool(done), method, watch.steps)


class Factors:
    """F, with products in double precision for whatever it is stored in, rows and columns, and its row sums.

    Hand it to `solve` in place of F where one F serves many solves.
    """

    def __init__(self, F):
        self.sparse = hasattr(F, "tocsr")
        F = F.tocsr() if self.sparse else np.asarray(F)
        if F.ndim != 2 or F.shape[0] != F.shape[1]:
            raise ValueError(f"F has the shape {F.shape}, not that of a square")
        if F.dtype not in (np.float32, np.float64):
            F = F.astype(float)
        self.F = F if self.sparse else np.ascontiguousarray(F)
        self.n = F.shape[0]
        self._columns = None
        self.sums = self.times(np.ones((self.n, 1)))[:, 0]
        lowest = float((F.data if self.sparse else F).min(initial=0.0))
        if not np.isfinite(self.sums).all() or not lowest >= 0:
            raise ValueError("F has an entry that is negative or not a number")
        self.slack = 1e-5 if F.dtype == np.float32 else 1e-9
        if self.n and self.sums.max() > 1 + 1e-3:
            i = int(self.sums.argmax())
            raise ValueError(f"row {i} of F sums to {self.sums[i]:.6g}: more light leaves the patch than it has")

    def times(self, X):
        """F X in double precision, (N, C)."""
        X = np.ascontiguousarray(X, float)
        if self.sparse:
            return kernels.sparse_times(self.F.indptr, self.F.indices, self.F.data, X)
        return kernels.dense_times(self.F, X) if self.F.dtype == np.float32 else self.F @ X

    def columns(self):
        """The transpose of F, stored by rows: who receives what a patch shoots."""
        if self._columns is None:
            self._columns = self.F.T.tocsr() if self.sparse else np.ascontiguousarray(self.F.T)
        return self._columns

    def dense(self):
        """(N, N) array."""
        return self.F.toarray() if self.sparse else self.F


# ---- does a balance exist, and how far can the answer be off ----


def _checked(E, rho, F):
    """rho as it is used: less where rounding carries a row of F beyond 1, 0 for patches in the dark at rho = 1."""
    if len(E) != F.n or len(rho) != F.n:
        raise ValueError(f"E and rho are for {len(E)} patches, F for {F.n}")
    if not np.isfinite(E).all():
        raise ValueError(f"E of patch {np.argwhere(~np.isfinite(E))[0][0]} is not finite")
    bad = ~((rho >= 0) & (rho <= 1))
    if bad.any():
        i = tuple(np.argwhere(bad)[0])
        raise ValueError(f"rho = {rho[i]:.9g} of patch {i[0]} is outside [0, 1]")
    full = rho.max(initial=0.0) >= 1
    rho = rho / np.maximum(F.sums, 1)[:, None]
    if full:
        # light is lost at a patch that absorbs or looks outside; follow back who can reach one
        for c in range(rho.shape[1]):
            escapes = (rho[:, c] * np.maximum(F.sums, 1) < 1) | (F.sums < 1 - F.slack)
            while True:
                more = escapes | (F.times(escapes[:, None].astype(float))[:, 0] > 0)
                if (more == escapes).all():
                    break
                escapes = more
            if (E[~escapes, c] != 0).any():
                i = int(np.flatnonzero(~escapes & (E[:, c] != 0))[0])
                raise ValueError(
                    f"no balance exists: patch {i} emits, and between the {int((~escapes).sum())} patches "
                    f"it reaches, all of rho = 1, light is never lost"
                )
            rho[~escapes, c] = 0  # dark, and stays dark
    return np.ascontiguousarray(rho)


def _bound(rho, F, residual):
    """residual * max(w) / min(w - rho F w), w > 0: an upper bound of the norm of the inverse, whatever w is."""
    q = float((rho * F.sums[:, None]).max(initial=0.0))
    if q < 1:
        return residual / (1 - q)
    # somewhere nothing is lost: the balance of E = 1 is the tightest w, and need not be exact
    w, _, _ = _krylov(np.ones_like(rho), rho, F, np.full(rho.shape[1], 1e-2), 2000, None, _Watch(None, False))
    least = (w - rho * F.times(w)).min(axis=0)
    if least.min() <= 0 or w.min() <= 0:
        return float("inf")
    return float(residual * (w.max(axis=0) / least).max())


class _Watch:
    """The trace of the iterations, without the time of the caller's callback."""

    def __init__(self, callback, one):
        self.callback, self.one = callback, one
        self.steps = []
        self.cpu, self.wall = time.process_time(), time.perf_counter()  # the solve began; later by what callbacks took

    def __call__(self, iteration, residual, B):
        cpu, wall = time.process_time(), time.perf_counter()
        self.steps.append(Step(int(iteration), cpu - self.cpu, wall - self.wall, float(residual)))
        if self.callback is not None:
            B = B() if callable(B) else B
            self.callback(int(iteration), (B[:, 0] if self.one else B).copy())
            self.cpu += time.process_time() - cpu
            self.wall += time.perf_counter() - wall


# ---- direct and Krylov ----


def _direct(E, rho, F, target, watch):
    from scipy.linalg import lu_factor, lu_solve

    B = np.zeros_like(E)
    D = F.dense().astype(float)
    same, channel = np.unique(rho, axis=1, return_inverse=True)
    for k in range(same.shape[1]):
        mine = np.flatnonzero(channel.ravel() == k)
        M = D * -same[:, k, None]
        M[np.diag_indices(len(M))] += 1
        B[:, mine] = lu_solve(lu_factor(M, overwrite_a=True, check_finite=False), E[:, mine], check_finite=False)
    r = np.abs(E + rho * F.times(B) - B).max(axis=0, initial=0.0)
    watch(1, r.max(initial=0.0), B)
    return B, 1, (r <= np.maximum(target, 1e-9 * np.abs(B).max(axis=0, initial=0.0))).all()


def _krylov(E, rho, F, target, max_iterations, x0, watch):
    """GMRES until no patch has a residual above the target."""
    B = np.zeros_like(E) if x0 is None else x0
    total, last = 0, np.inf
    while True:
        r = E + rho * F.times(B) - B if total or x0 is not None else E.copy()
        worst = np.abs(r).max(axis=0, initial=0.0)
        watch(total, worst.max(initial=0.0), B)
        ratio = float((worst / target).max(initial=0.0))
        if ratio <= 1 or total >= max_iterations or ratio > 0.7 * last:  # the last: rounding allows no more
            return B, total, ratio <= 1
        last = ratio
        # the largest of the residuals is at most their norm, and usually well below
        norm = np.maximum(np.linalg.norm(r, axis=0), 1e-300)
        wanted = float(np.clip(3 * (target / norm).min(), 1e-14, 0.5))

        def step(used, left, x, B=B, norm=norm, total=total):
            if watch.callback is not None:  # the norm of the residual, not less than its largest entry
                watch(total + used, (left * norm).max(), lambda: B + norm * x())

        x, _, used = gmres(
            lambda X: X - rho * F.times(X),
            r / norm,
            tolerance=wanted,
            max_iterations=max_iterations - total,
            progress=step,
        )
        B = B + norm * x
        total += max(used, 1)


def gmres(apply, b, *, tolerance, max_iterations=200, x0=None, progress=None):
    """Solve (I - rho F) x = b for many right-hand sides at once, each with its own Krylov space.

    apply : X (N, K) -> (I - rho F) X;  b : (N, K).  Returns x, the largest relative residual, iterations.
    One product with F serves all columns: the cost of a solve is the number of passes over F.
    A column that has reached its tolerance stands still while the others go on.
    """
    K = b.shape[1]
    # Squares of light of 1e-23 vanish in float32. Powers of two round nothing.
    unit = np.ldexp(b.dtype.type(1), np.frexp(np.abs(b).max(axis=0, initial=0.0))[1])
    b = b / unit
    x = np.zeros_like(b) if x0 is None else (x0 / unit).astype(b.dtype)
    norm = np.maximum(np.linalg.norm(b, axis=0).astype(float), 1e-300)
    iterations = 0
    restart = min(30, max_iterations)
    least = np.inf
    while True:
        r = b - apply(x) if (iterations or x0 is not None) else b.copy()
        beta = np.linalg.norm(r, axis=0).astype(float)
        residual = float((beta / norm).max(initial=0.0))
        if residual <= tolerance or iterations >= max_iterations or not residual < 0.9 * least:
            return x * unit, residual, iterations
        least = residual if iterations else np.inf
        # Arnoldi with a QR of the small matrix by rotations, for all columns side by side
        V = np.empty((K, restart + 1, len(b)), b.dtype)
        R = np.zeros((K, restart, restart))
        turn = np.zeros((restart, 2, K))
        g = np.zeros((K, restart + 1))
        V[:, 0] = (r / np.where(beta > 0, beta, 1)).T
        g[:, 0] = beta
        size = np.zeros(K, int)  # steps that each column takes
        for j in range(restart):
            h = _next_vector(np.ascontiguousarray(apply(V[:, j].T).T), V, j)
            iterations += 1
            c, s = _rotate(h, turn, j)
            R[:, : j + 1, j] = h[:, : j + 1]
            moving = np.abs(g[:, j]) > 0.1 * tolerance * norm
            size[moving] = j + 1
            g[:, j], g[:, j + 1] = c * g[:, j], -s * g[:, j]
            if progress is not None:
                so_far = partial(_combined, x, V, R, g, size)
                progress(iterations, np.abs(g[:, j + 1]) * unit, lambda so_far=so_far: so_far() * unit)
            if (np.abs(g[:, j + 1]) <= tolerance * norm).all() or iterations >= max_iterations:
                break
        x = _combined(x, V, R, g, size)


def _next_vector(w, V, j):
    """Make w (K, N) orthogonal to V[:, : j + 1] and write it, of length 1, into V[:, j + 1]; returns h (K, j + 2)."""
    h = np.zeros((len(V), j + 2))
    for _ in range(2):  # twice is enough
        part = np.matmul(V[:, : j + 1], w[:, :, None])[:, :, 0]
        w -= np.matmul(part[:, None, :], V[:, : j + 1])[:, 0]
        h[:, : j + 1] += part
    h[:, j + 1] = np.linalg.norm(w, axis=1)
    V[:, j + 1] = w / np.where(h[:, j + 1] > 1e-30, h[:, j + 1], 1)[:, None].astype(V.dtype)
    return h


def _rotate(h, turn, j):
    """Apply the rotations so far to column j of the Hessenberg matrix, in place, and add the one that ends it."""
    for i in range(j):
        c, s = turn[i]
        h[:, i], h[:, i + 1] = c * h[:, i] + s * h[:, i + 1], c * h[:, i + 1] - s * h[:, i]
    length = np.maximum(np.hypot(h[:, j], h[:, j + 1]), 1e-300)
    turn[j] = h[:, j] / length, h[:, j + 1] / length
    h[:, j] = length
    return turn[j]


def _combined(x, V, R, g, size):
    """x + V y with R y = g, of each column as many steps as it took."""
    used = int(size.max(initial=0))
    y = np.zeros((len(V), used))
    for i in reversed(range(used)):
        left = g[:, i] - np.einsum("kj,kj->k", R[:, i, i + 1 : used], y[:, i + 1 :])
        y[:, i] = np.where(i < size, left / np.maximum(np.abs(R[:, i, i]), 1e-300), 0)
    return x + np.matmul(y[:, None, :].astype(V.dtype), V[:, :used])[:, 0].T


# ---- gathering, sweep by sweep ----


def _sweeps(E, rho, F, target, max_iterations, x0, watch, in_place):
    """Jacobi: all patches gather from the last sweep. Gauss-Seidel: each from the newest values."""
    B = E.copy() if x0 is None else x0
    if in_place:
        rho_rows, E_rows, rows = (np.ascontiguousarray(x.T) for x in (rho, E, B))
        B, diagonal = rows.T, F.F.diagonal()
    for iteration in range(1, max_iterations + 1):
        if not in_place:
            new = E + rho * F.times(B)
            change = np.abs(new - B).max(axis=0, initial=0.0)  # the residual of B, before this sweep
            B = new
        elif F.sparse:
            change = kernels.gauss_seidel_sparse(F.F.indptr, F.F.indices, F.F.data, diagonal, rho_rows, E_rows, rows)
        else:
            change = kernels.gauss_seidel_dense(F.F, rho_rows, E_rows, rows)
        watch(iteration, change.max(initial=0.0), B)
        # the changes of a sweep are not quite the residual after it: look, once they are small
        if (change <= target).all() and (np.abs(E + rho * F.times(B) - B) <= target).all():
            return np.ascontiguousarray(B), iteration, True
    return np.ascontiguousarray(B), max_iterations, False


# ---- shooting, patch by patch (figure 3.9) ----


def _shots(E, rho, F, target, max_iterations, watch, method, area, patch, ambient, overshoot, every):
    """Southwell and progressive refinement: patches shoot, elements receive; B and dB as in figure 3.9.

    dB, what a patch has received and not yet sent, is the residual of what has been sent so far. Southwell takes the
    patch of the largest residual and counts what was sent; progressive refinement takes the patch of the largest
    unshot *power*, dB A, and counts what was received: a bounce further for nothing.

    The paper finds who receives from the row of the patch that shoots, by A_i F_ij = A_j F_ji. Here the columns of
    F are at hand; factors from rays keep reciprocity only to their noise, and all methods share one answer this way.
    """
    n = len(E)
    progressive = method == "progressive"
    area = np.ones(n) if area is None or not progressive else np.asarray(area, float)
    if len(area) != n or not (area > 0).all():
        raise ValueError("area: one positive number per element is needed")
    if patch is None or not progressive:
        patch, columns, own = np.arange(n), F.columns(), rho * F.F.diagonal()[:, None]
    else:
        patch, columns = _by_patch(F, patch)
        own = np.zeros((columns.shape[0], E.shape[1]))
    patch_area = np.bincount(patch, area)
    share = area / patch_area[patch]
    mean = lambda X: np.stack([np.bincount(patch, share * x) for x in X.T], axis=1)
    elements = Elements(rho, patch, share, mean(rho), patch_area, own)
    # the ambient term (Cohen et al. 1988): what is unshot, spread over the scene with all its bounces to come
    total = area.sum()
    leaving = np.maximum(1 - (area[:, None] * rho * F.sums[:, None]).sum(axis=0) / total, 1e-9)
    rules = Shooting(progressive, overshoot and progressive, leaving, target)
    receivers = _receivers(columns, F.sparse)
    B, dB = E.copy(), mean(E)

    def shown():
        if not progressive:
            return B - dB
        glow = np.maximum((patch_area[:, None] * dB).sum(axis=0) / total, 0) / leaving
        return B + rho * F.sums[:, None] * glow if ambient else B

    shots = 0
    every = max(1, every) if watch.callback is not None else max(64, n // 4)
    while True:
        k, left = kernels.shoot(min(every, max_iterations - shots), receivers, elements, rules, B, dB)
        shots += k
        if k:
            watch(shots, left, shown)
        if k == 0 or shots >= max_iterations:
            break
    return shown(), shots, (np.abs(dB) <= target).all()


def _by_patch(F, patch):
    """Number of each element's patch, without gaps (N,), and what each element receives from a patch whose elements
    all send alike (P, N)."""
    from scipy.sparse import csr_array

    n = F.n
    number = np.unique(np.asarray(patch), return_inverse=True)[1].reshape(-1)
    if len(number) != n:
        raise ValueError(f"patch: {len(number)} numbers for {n} elements")
    owner = csr_array((np.ones(n), (number, np.arange(n))), shape=(int(number.max(initial=-1)) + 1, n))
    columns = owner @ F.columns()
    return number, columns.tocsr() if F.sparse else np.ascontiguousarray(columns)


def _receivers(columns, sparse) -> Receivers:
    """columns : (P, N), dense or CSR"""
    if not sparse:
        none = np.zeros(0, np.int64)
        return Receivers(False, columns, np.zeros(1, np.int64), none, np.zeros(0))
    start, index = columns.indptr.astype(np.int64), columns.indices.astype(np.int64)
    return Receivers(True, np.zeros((0, 0)), start, index, columns.data)
