"""Cubes, spheres, cylinders, cones and the like as facets, for formats that name them.

All are closed under +z as their axis and look outwards. Round ones have `SIDES` facets around: their corners lie on the
shape, so that the facets lie inside it by at most `SAGITTA` of the radius.
"""

from __future__ import annotations

import numpy as np

SIDES = 32  # around; half as many from pole to pole
SAGITTA = 1 - np.cos(np.pi / SIDES)  # of the radius: how far a facet's middle lies inside: 0.5 %
SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
CUBE_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
WORDS = f"round shapes became {SIDES} facets around, which lie inside by up to {SAGITTA:.2%} of the radius"


def disk(radius=1.0):
    """(points (V, 3), faces), one polygon at z = 0 that looks up."""
    return _ring(radius, 0.0), [tuple(range(SIDES))]


def turned(profile):
    """A profile of (radius, z), from the bottom up, turned around z; a radius of 0 is a point. (points, faces)

    Open where the profile's ends are: a cylinder without lids has two rows.
    """
    rows, points, faces = [], [], []
    for radius, z in profile:
        row = _ring(radius, z) if radius > 0 else np.array([(0.0, 0.0, z)])
        rows.append(range(sum(map(len, points)), sum(map(len, points)) + len(row)))
        points.append(row)
    for low, high in zip(rows, rows[1:], strict=False):
        for k in range(SIDES):
            face = (_at(low, k), _at(low, k + 1), _at(high, k + 1), _at(high, k))
            face = tuple(dict.fromkeys(face))  # at a pole two corners are one
            faces += [face] if len(face) > 2 else []
    return np.concatenate(points), faces


def sphere(radius=1.0):
    angles = np.linspace(-np.pi / 2, np.pi / 2, SIDES // 2 + 1)
    return turned(_arc(radius, angles, 0.0))


def tube(bottom, top, low, high):
    """A cylinder or a cone without lids: radii at two heights."""
    return turned([(bottom, low), (top, high)])


def closed_tube(bottom, top, low, high):
    """The same with its lids."""
    points, faces = tube(bottom, top, low, high)
    if bottom > 0:
        faces.append(tuple(range(SIDES))[::-1])
    if top > 0:
        faces.append(tuple(range(len(points) - SIDES, len(points))))
    return points, faces


def capsule(radius, low, high):
    """A cylinder with half a sphere at each end."""
    below, above = np.linspace(-np.pi / 2, 0, SIDES // 4 + 1), np.linspace(0, np.pi / 2, SIDES // 4 + 1)
    return turned([*_arc(radius, below, low), *_arc(radius, above, high)])


def _arc(radius, angles, z):
    pole = np.isclose(np.abs(angles), np.pi / 2)
    return [(0.0 if p else radius * np.cos(a), z + radius * np.sin(a)) for a, p in zip(angles, pole, strict=True)]


def _ring(radius, z):
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(SIDES, float(z))], axis=1)


def _at(row, k):
    return row[k % len(row)]
