"""Compiled: sweeps and shots of the solvers, and products with stored factors."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit


@njit()
def sparse_times(indptr, indices, data, X):
    """F X (N, C) of a sparse F, each sum in one order.

    On one core: these products last a millisecond, and to wake another costs as much. SciPy's, compiled for any
    processor, and BLAS, which is slow on three columns, take 2 to 4 times as long where a tenth of F is filled.
    """
    out = np.empty((len(indptr) - 1, X.shape[1]), X.dtype)
    if X.shape[1] <= 3:
        _times_colours(indptr, indices, data, X, out)
    else:
        _times_many(indptr, indices, data, X, out)
    return out


@njit()
def _times_colours(indptr, indices, data, X, out):
    """At most three columns. Two sums for each, since a sum waits for its last addition.

    Unsigned numbers cannot count from an end, for which the compiler would look at each.
    """
    one = np.uint64(1)
    c1, c2 = min(1, X.shape[1] - 1), min(2, X.shape[1] - 1)  # of fewer columns some are summed again
    zero = X.dtype.type(0)
    for i in range(len(indptr) - 1):
        k, end = np.uint64(indptr[i]), np.uint64(indptr[i + 1])
        s0, s1, s2, t0, t1, t2 = zero, zero, zero, zero, zero, zero
        while k + one < end:
            f, j = data[k], np.uint64(indices[k])
            s0 += f * X[j, 0]
            s1 += f * X[j, c1]
            s2 += f * X[j, c2]
            f, j = data[k + one], np.uint64(indices[k + one])
            t0 += f * X[j, 0]
            t1 += f * X[j, c1]
            t2 += f * X[j, c2]
            k += one + one
        if k < end:
            f, j = data[k], np.uint64(indices[k])
            s0 += f * X[j, 0]
            s1 += f * X[j, c1]
            s2 += f * X[j, c2]
        out[i, 0], out[i, c1], out[i, c2] = s0 + t0, s1 + t1, s2 + t2


@njit()
def _times_many(indptr, indices, data, X, out):
    """Of each entry all columns side by side."""
    total = np.empty(X.shape[1], X.dtype)
    for i in range(len(indptr) - 1):
        total[:] = 0
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
            f, row = data[k], X[np.uint64(indices[k])]
            for c in range(np.uint64(X.shape[1])):
                total[c] += f * row[c]
        out[i] = total


@njit(fastmath={"reassoc", "contract"})
def dot(f, x):
    """Of two vectors, in double precision; the compiler may add in any order."""
    total = 0.0
    for j in range(len(f)):
        total += f[j] * x[j]
    return total


@njit()
def dense_times(F, X):
    """F X (N, C), in double precision whatever F is stored in."""
    out = np.empty(X.shape)
    Y = np.ascontiguousarray(X.T)
    for i in range(len(F)):
        for c in range(len(Y)):
            out[i, c] = dot(F[i], Y[c])
    return out


@njit()
def gauss_seidel_dense(F, rho, E, B):
    """One sweep over B (C, N), in place; returns the largest change of each channel.  rho, E : (C, N)"""
    change = np.zeros(len(B))
    for c in range(len(B)):
        for i in range(len(F)):
            own = rho[c, i] * F[i, i]
            new = (E[c, i] + rho[c, i] * dot(F[i], B[c]) - own * B[c, i]) / (1 - own)
            change[c] = max(change[c], abs(new - B[c, i]))
            B[c, i] = new
    return change


@njit()
def gauss_seidel_sparse(indptr, indices, data, diagonal, rho, E, B):
    """`gauss_seidel_dense` of a sparse F.  diagonal : (N,) of F"""
    change = np.zeros(len(B))
    for c in range(len(B)):
        for i in range(len(indptr) - 1):
            a, b = indptr[i], indptr[i + 1]
            own = rho[c, i] * diagonal[i]
            new = (E[c, i] + rho[c, i] * sparse_dot(data[a:b], indices[a:b], B[c]) - own * B[c, i]) / (1 - own)
            change[c] = max(change[c], abs(new - B[c, i]))
            B[c, i] = new
    return change


@njit()
def sparse_dot(f, index, x):
    """Four sums side by side, so that none waits for the last addition."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    n = len(f) // 4 * 4
    for k in range(0, n, 4):
        s0 += f[k] * x[index[k]]
        s1 += f[k + 1] * x[index[k + 1]]
        s2 += f[k + 2] * x[index[k + 2]]
        s3 += f[k + 3] * x[index[k + 3]]
    for k in range(n, len(f)):
        s0 += f[k] * x[index[k]]
    return (s0 + s1) + (s2 + s3)


@njit(inline="always")
def ahead(overshoot, own, unshot, share, leaving, rho):
    """What a patch will reflect of the light that the others have still to send (Feda and Purgathofer 1992).

    As printed that may be any number of times what the patch itself has to send; the method then circles for ever in
    bright rooms. Below twice, as in any over-relaxation, each shot brings the solution nearer.
    """
    return min(rho * max((unshot - share * own) / leaving, 0.0), 0.8 * max(own, 0.0)) if overshoot else 0.0


class Receivers(NamedTuple):
    """Who receives what a patch shoots: F's columns, each as a row, dense or sparse (the other is empty)."""

    sparse: bool
    table: np.ndarray  # (P, N)
    start: np.ndarray  # (P + 1,) int64 into index, value
    index: np.ndarray
    value: np.ndarray


class Elements(NamedTuple):
    """N elements receive; P patches, the elements' owners, shoot."""

    rho: np.ndarray  # (N, C)
    patch: np.ndarray  # (N,) int, of each element
    share: np.ndarray  # (N,) of the patch's area
    patch_rho: np.ndarray  # (P, C)
    patch_area: np.ndarray  # (P,)
    own: np.ndarray  # (P, C) what comes straight back to a patch that sees itself


class Shooting(NamedTuple):
    """Which patch shoots next, how much, and until when."""

    by_power: bool  # radiosity times area decides, else radiosity
    overshoot: bool
    leaving: np.ndarray  # (C,) share of the light that is lost at a bounce
    target: np.ndarray  # (C,) unshot radiosity that is small enough


@njit()
def shoot(limit, receivers: Receivers, elements: Elements, rules: Shooting, B, dB):
    """Up to `limit` shots, in place; returns how many, and the largest unshot radiosity before the last.

    B : (N, C) radiosity;  dB : (P, C) what is still unshot of it
    """
    table, start, index, value = receivers.table, receivers.start, receivers.index, receivers.value
    rho, patch, share, patch_area = elements.rho, elements.patch, elements.share, elements.patch_area
    C = B.shape[1]
    s = np.zeros(C)
    total = patch_area.sum()
    unshot = np.zeros(C)  # of all patches, in the mean over the scene
    for p in range(len(dB)):
        for c in range(C):
            unshot[c] += patch_area[p] / total * dB[p, c]
    largest = 0.0
    for shot in range(limit):
        best, done, largest = next_patch(elements, rules, dB, unshot, total)
        if done:
            return shot, largest
        for c in range(C):
            part = patch_area[best] / total
            s[c] = dB[best, c] / (1 - elements.own[best, c])
            s[c] += ahead(rules.overshoot, dB[best, c], unshot[c], part, rules.leaving[c], elements.patch_rho[best, c])
            dB[best, c] -= s[c]
            unshot[c] -= part * s[c]
        if receivers.sparse:
            for k in range(start[best], start[best + 1]):
                j = index[k]
                for c in range(C):
                    d = s[c] * rho[j, c] * value[k]
                    B[j, c] += d
                    dB[patch[j], c] += d * share[j]
                    unshot[c] += d * share[j] * patch_area[patch[j]] / total
        else:
            for j in range(len(B)):
                f = table[best, j]
                if f != 0:
                    for c in range(C):
                        d = s[c] * rho[j, c] * f
                        B[j, c] += d
                        dB[patch[j], c] += d * share[j]
                        unshot[c] += d * share[j] * patch_area[patch[j]] / total
    return limit, largest


@njit()
def next_patch(elements: Elements, rules: Shooting, dB, unshot, total):
    """The patch with the largest dB_i A_i (figure 3.9), whether all is small enough, and the largest of dB."""
    patch_area, patch_rho = elements.patch_area, elements.patch_rho
    overshoot, leaving, target = rules.overshoot, rules.leaving, rules.target
    best, most, done, largest = 0, -1.0, True, 0.0
    for p in range(len(dB)):
        size = 0.0
        for c in range(dB.shape[1]):
            x = abs(dB[p, c])
            largest = max(largest, x)
            done &= x <= target[c]
            size += abs(
                dB[p, c] + ahead(overshoot, dB[p, c], unshot[c], patch_area[p] / total, leaving[c], patch_rho[p, c])
            )
        size *= patch_area[p] if rules.by_power else 1.0
        if size > most:
            best, most = p, size
    return best, done, largest
