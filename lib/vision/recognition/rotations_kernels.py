"""Compiled: how much of the scene a rotation explains."""

import math

import numpy as np

from lib.core.compiled import njit


@njit()
def aligned(R, n, angle, directions):
    """R improved on all normals near a direction: (R, sigma rad of its worst turn, (N,) bool which normals).

    R : (3, 3) world to camera; n : (N, 3), angle : (N,) rad of the scene; directions : (D, 3) of the model
    sigma is infinite where nothing holds the rotation.
    """
    fits, sigma = np.zeros(len(n), np.bool_), 0.03
    for _ in range(3):
        M, information = np.zeros((3, 3)), np.zeros((3, 3))
        for i in range(len(n)):
            best, a = -2.0, 0
            for d in range(len(directions)):
                cosine = 0.0
                for x in range(3):
                    for y in range(3):
                        cosine += n[i, x] * R[x, y] * directions[d, y]
                if cosine > best:
                    best, a = cosine, d
            fits[i] = best > math.cos(min(3 * math.sqrt(angle[i] ** 2 + sigma**2) + 0.005, 0.6))
            if fits[i]:
                w = 1 / (angle[i] ** 2 + 1e-6)
                for x in range(3):
                    information[x, x] += w
                    for y in range(3):
                        M[x, y] += w * n[i, x] * directions[a, y]
                        information[x, y] -= w * n[i, x] * n[i, y]
        if fits.sum() < 2:
            return R, np.inf, fits
        u, _, vt = np.linalg.svd(M)  # Kabsch, as in rotations.py
        turn = np.eye(3)
        turn[2, 2] = np.linalg.det(u @ vt)
        R = u @ turn @ vt
        least = np.linalg.eigvalsh(information)[0]
        sigma = 1 / math.sqrt(least) if least > 0 else np.inf
    return R, sigma, fits


@njit()
def support(R, n, directions, gate, evidence):
    """(len(R),) nats: the evidence of the normals that a rotation brings near a direction.

    R : (k, 3, 3) world to camera; n : (N, 3) of the scene; directions : (D, 3) of the model; gate : (N,) cosine from
    which on a normal is near; evidence : (N,) nats
    """
    score = np.zeros(len(R))
    for k in range(len(R)):
        for i in range(len(n)):
            x = R[k, 0, 0] * n[i, 0] + R[k, 1, 0] * n[i, 1] + R[k, 2, 0] * n[i, 2]
            y = R[k, 0, 1] * n[i, 0] + R[k, 1, 1] * n[i, 1] + R[k, 2, 1] * n[i, 2]
            z = R[k, 0, 2] * n[i, 0] + R[k, 1, 2] * n[i, 1] + R[k, 2, 2] * n[i, 2]
            for d in range(len(directions)):
                if x * directions[d, 0] + y * directions[d, 1] + z * directions[d, 2] > gate[i]:
                    score[k] += evidence[i]
                    break
    return score
