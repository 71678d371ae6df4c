"""The light balance B = E + rho F B (eq. 3.2) and its solvers."""
from __future__ import annotations

import numpy as np


def gmres(apply, b, *, tolerance, max_iterations=200, x0=None):
    """Solve (I - rho F) x = b for many right-hand sides at once, each with its own Krylov space.

    apply : X (N, K) -> (I - rho F) X;  b : (N, K).  Returns x, the largest relative residual, iterations.
    One product with F serves all columns: the cost of a solve is the number of passes over F.
    """
    x = np.zeros_like(b) if x0 is None else x0.copy()
    norm = np.maximum(np.linalg.norm(b, axis=0), 1e-300)
    iterations = 0
    restart = min(30, max_iterations)
    while True:
        r = b - apply(x) if (iterations or x0 is not None) else b.copy()
        beta = np.linalg.norm(r, axis=0)
        residual = float((beta / norm).max(initial=0.0))
        if residual <= tolerance or iterations >= max_iterations:
            return x, residual, iterations
        k = b.shape[1]
        V = np.zeros((restart + 1, *b.shape), b.dtype)
        H = np.zeros((k, restart + 1, restart))
        V[0] = r / np.maximum(beta, 1e-300)
        target = np.zeros((k, restart + 1))
        target[:, 0] = beta
        used = 0
        for j in range(restart):
            w = apply(V[j])
            for _ in range(2):                               # twice is enough
                h = np.einsum("jnk,nk->kj", V[:j + 1], w)
                w -= np.einsum("jnk,kj->nk", V[:j + 1], h.astype(b.dtype))
                H[:, :j + 1, j] += h
            H[:, j + 1, j] = np.linalg.norm(w, axis=0)
            V[j + 1] = w / np.maximum(H[:, j + 1, j], 1e-300)
            used = j + 1
            iterations += 1
            y = _least_squares(H[:, :used + 1, :used], target[:, :used + 1])
            left = np.linalg.norm(target[:, :used + 1] - np.einsum("kij,kj->ki", H[:, :used + 1, :used], y), axis=1)
            if (left / norm).max() <= tolerance or iterations >= max_iterations:
                break
        x += np.einsum("jnk,kj->nk", V[:used], y.astype(b.dtype))


def _least_squares(H, g):
    """Small dense least squares per column; a column already solved has a zero block and stays at zero."""
    return np.einsum("kij,kj->ki", np.linalg.pinv(H), g)
