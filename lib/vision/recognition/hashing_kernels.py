"""Compiled: which scene facet may lie on which side of the model, and what that asks of the displacement."""

from typing import NamedTuple

import numpy as np

from lib.core.compiled import njit


class SceneSide(NamedTuple):
    """N scene facets turned into the model's frame at one rotation, places from the pivot."""

    n: np.ndarray  # (N, 3) normals
    gate: np.ndarray  # (N,) cosine from which on a normal of the model may be the same
    outline: np.ndarray  # (P, 3) corners of all outlines
    start: np.ndarray  # (N + 1,) the outline of facet i has the corners from start[i] to start[i + 1]
    g: np.ndarray  # (N, 3) a point on each plane
    tall: np.ndarray  # (N,) tolerance along the normal
    wide: np.ndarray  # (N,) tolerance within the plane


class ModelSide(NamedTuple):
    """L facets of the model."""

    axes: np.ndarray  # (L, 3, 3) normal, two in-plane
    low: np.ndarray  # (L, 3) extents along the axes
    high: np.ndarray  # (L, 3)
    twosided: np.ndarray  # (L,) bool: the back can be seen


class Correspondences(NamedTuple):
    """K times a scene facet on a model facet.

    For each axis a of the model's facet: low <= A c + q P1 and A c + q P2 <= high. c is the pivot's place in the model,
    q the scale; P1 and P2 hold the outline's reach and the tolerance.
    """

    scene: np.ndarray  # (K,)
    facet: np.ndarray  # (K,)
    A: np.ndarray  # (K, 3, 3)
    P1: np.ndarray  # (K, 3)
    P2: np.ndarray  # (K, 3)
    low: np.ndarray  # (K, 3)
    high: np.ndarray  # (K, 3)


@njit()
def fill(scene, model, size_ok):
    """The Correspondences of a SceneSide and a ModelSide. size_ok : (N, L) bool: the model's facet is large enough"""
    n, gate, axes, twosided = scene.n, scene.gate, model.axes, model.twosided
    most = 0
    for k in range(len(n)):
        for f in range(len(axes)):
            most += size_ok[k, f] and may_face(n, k, gate[k], axes, f, twosided[f])
    i, facet = np.empty(most, np.int64), np.empty(most, np.int64)
    A, P1, P2 = np.empty((most, 3, 3)), np.empty((most, 3)), np.empty((most, 3))
    low, high = np.empty((most, 3)), np.empty((most, 3))
    g, tall, wide = scene.g, scene.tall, scene.wide
    c = 0
    for k in range(len(n)):
        first, last = scene.start[k], scene.start[k + 1]
        for f in range(len(axes)):
            if not (size_ok[k, f] and may_face(n, k, gate[k], axes, f, twosided[f])):
                continue
            i[c], facet[c], A[c], low[c], high[c] = k, f, axes[f], model.low[f], model.high[f]
            h = A[c, 0, 0] * g[k, 0] + A[c, 0, 1] * g[k, 1] + A[c, 0, 2] * g[k, 2]
            P1[c, 0], P2[c, 0] = h + tall[k], h - tall[k]
            for a in (1, 2):
                least, largest = extent(scene.outline, first, last, A, c, a)
                slack = wide[k] + 0.03 * (largest - least)
                P1[c, a], P2[c, a] = least + slack, largest - slack
            c += 1
    return Correspondences(i, facet, A, P1, P2, low, high)


@njit()
def may_face(n, k, gate, axes, f, twosided):
    """Does the normal n[k] agree with axes[f, 0], or with its opposite if the facet is two-sided? gate : a cosine"""
    cosine = n[k, 0] * axes[f, 0, 0] + n[k, 1] * axes[f, 0, 1] + n[k, 2] * axes[f, 0, 2]
    return cosine > gate or (cosine < -gate and twosided)


@njit()
def extent(outline, first, last, A, c, a):
    """(least, largest) of the corners outline[first:last] along the axis A[c, a]."""
    least, largest = np.inf, -np.inf
    for p in range(first, last):
        x = A[c, a, 0] * outline[p, 0] + A[c, a, 1] * outline[p, 1] + A[c, a, 2] * outline[p, 2]
        least, largest = min(least, x), max(largest, x)
    return least, largest
