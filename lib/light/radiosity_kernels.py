"""Compiled: sweeps and shots of the solvers, and products with stored factors."""

import numpy as np

from lib.core.compiled import njit


@njit()
def sparse_times(indptr, indices, data, X):
    """Four columns at a time: one pass over F serves them all, and its entries stay in registers. On one core: these
    products last a millisecond, and to wake another costs as much."""
    out = np.empty_like(X)
    zero = X.dtype.type(0)
    for i in range(len(indptr) - 1):
        for c in range(0, X.shape[1], 4):
            left = X.shape[1] - c
            s0, s1, s2, s3 = zero, zero, zero, zero
            if left >= 4:
                for k in range(indptr[i], indptr[i + 1]):
                    f, j = data[k], indices[k]
                    s0 += f * X[j, c]
                    s1 += f * X[j, c + 1]
                    s2 += f * X[j, c + 2]
                    s3 += f * X[j, c + 3]
                out[i, c + 3] = s3
            elif left == 3:
                for k in range(indptr[i], indptr[i + 1]):
                    f, j = data[k], indices[k]
                    s0 += f * X[j, c]
                    s1 += f * X[j, c + 1]
                    s2 += f * X[j, c + 2]
            else:
                d = c + left - 1
                for k in range(indptr[i], indptr[i + 1]):
                    f, j = data[k], indices[k]
                    s0 += f * X[j, c]
                    s1 += f * X[j, d]
            out[i, c] = s0
            if left > 1:
                out[i, c + 1] = s1
            if left > 2:
                out[i, c + 2] = s2
    return out


@njit(fastmath={"reassoc", "contract"})
def dot(f, x):
    total = 0.0
    for j in range(len(f)):
        total += f[j] * x[j]
    return total


@njit()
def dense_times(F, X):
    out = np.empty(X.shape)
    Y = np.ascontiguousarray(X.T)
    for i in range(len(F)):
        for c in range(len(Y)):
            out[i, c] = dot(F[i], Y[c])
    return out


@njit()
def gauss_seidel_dense(F, rho, E, B):
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


@njit()
def shoot(
    limit,
    table,
    start,
    index,
    value,
    sparse,
    rho,
    own,
    patch_rho,
    patch,
    share,
    patch_area,
    by_power,
    overshoot,
    leaving,
    target,
    B,
    dB,
):
    """Up to `limit` shots; returns how many, and the largest unshot radiosity before the last."""
    C = B.shape[1]
    s = np.zeros(C)
    total = patch_area.sum()
    unshot = np.zeros(C)  # of all patches, in the mean over the scene
    for p in range(len(dB)):
        for c in range(C):
            unshot[c] += patch_area[p] / total * dB[p, c]
    total = patch_area.sum()
    largest = 0.0
    for shot in range(limit):
        best, most, done, largest = 0, -1.0, True, 0.0
        for p in range(len(dB)):  # find patch i with the largest dB_i A_i
            size = 0.0
            for c in range(C):
                x = abs(dB[p, c])
                largest = max(largest, x)
                done &= x <= target[c]
                size += abs(
                    dB[p, c] + ahead(overshoot, dB[p, c], unshot[c], patch_area[p] / total, leaving[c], patch_rho[p, c])
                )
            size *= patch_area[p] if by_power else 1.0
            if size > most:
                best, most = p, size
        if done:
            return shot, largest
        for c in range(C):
            s[c] = dB[best, c] / (1 - own[best, c])
            s[c] += ahead(overshoot, dB[best, c], unshot[c], patch_area[best] / total, leaving[c], patch_rho[best, c])
            dB[best, c] -= s[c]
            unshot[c] -= patch_area[best] / total * s[c]
        if sparse:
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
