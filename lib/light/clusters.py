"""Face clusters: small facets of one thing that lie together and look one way hold one radiosity between them.

Rays start on the true triangles and meet the true triangles; a cluster is a patch whose pieces lie on several facets
(Willmott, Heckbert, Garland 1999). Where its light is uneven it falls apart into clusters half as wide, whose normals
are closer, as a patch is cut into quadrants. What an artist draws of ten thousand facets then has as many patches as
its light asks for, and not one for each facet. Rooms of boxes have no clusters (docs/decisions/clusters.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.core.rows import distinct

MANY = 2000  # sides of facets that are lit: a model of fewer has a patch for each, at least
NONE = -1  # the level of a patch that is no part of a cluster


def elements(surface, sides, levels, width) -> np.ndarray:
    """(n,) int: which patch each leaf is or belongs to, patches in the order of their first leaf.

    sides : (n,) of the leaves;  levels : (n,) of their clusters, NONE of leaves by themselves
    width : local, of the clusters of level 0
    """
    f = sides // 2
    middle = surface.origin[f] + 0.5 * (surface.size[f, :, None] * surface.axes[f]).sum(axis=1) - surface.middle
    normal = surface.normal[f] * (1 - 2 * (sides & 1))[:, None]
    fine = 2.0 ** np.maximum(levels, 0)[:, None]
    cell = np.floor(middle * fine / width)
    key = np.column_stack([levels, surface.object[f], surface.group[f], cell, _towards(normal, 2 * fine)])
    alone = levels == NONE
    key[alone, 1:] = 0
    key[alone, 1] = np.flatnonzero(alone)
    first, kind = distinct(key)
    return np.argsort(np.argsort(first))[kind]


def _towards(normal, parts):
    """(n, 3) numbers of the face of a cube that unit normals (n, 3) point at, and of the part of it, of parts^2."""
    axis = np.abs(normal).argmax(axis=1)
    largest = np.take_along_axis(normal, axis[:, None], axis=1)
    others = np.take_along_axis(normal, (axis[:, None] + [1, 2]) % 3, axis=1) / np.abs(largest)
    part = np.clip(np.floor((others + 1) / 2 * parts), 0, parts - 1)
    return np.column_stack([axis + 3 * (largest[:, 0] < 0), part])


def merged(mesh, element, levels):
    """The Mesh whose patches are of one leaf each with those of one element as one patch.

    element : (n,) as `elements` tells;  levels : (n,) see there
    """
    n = int(element.max()) + 1
    area = np.bincount(element, mesh.area)
    owner = np.repeat(np.arange(len(mesh)), np.diff(mesh.tri_start))
    weight = np.diff(mesh.tri_cdf, prepend=0.0)
    weight[mesh.tri_start[:-1]] = mesh.tri_cdf[mesh.tri_start[:-1]]
    order = np.argsort(element[owner], kind="stable")
    start = np.searchsorted(element[owner[order]], np.arange(n + 1))
    total = np.cumsum((weight * mesh.area[owner])[order])
    before = np.concatenate([[0.0], total])[start[:-1]]
    cdf = (total - np.repeat(before, np.diff(start))) / np.repeat(area, np.diff(start))
    cdf[start[1:] - 1] = 1.0
    by_size = np.lexsort((-mesh.area, element))
    largest = by_size[np.searchsorted(element[by_size], np.arange(n))]
    centre = np.stack([np.bincount(element, mesh.area * mesh.centre[:, k]) for k in range(3)], axis=1) / area[:, None]
    alone = levels[largest] == NONE  # clusters have no siblings
    parent = distinct(np.column_stack([alone, np.where(alone, mesh.parent[largest], np.arange(n))]))[1]
    return replace(
        mesh,
        side=mesh.side[largest],
        area=area,
        centre=centre,
        tri_start=start.astype(mesh.tri_start.dtype),
        tri_uv=mesh.tri_uv[order],
        tri_cdf=cdf,
        tri_side=mesh.tri_side[order],
        leaf=np.where(mesh.leaf >= 0, element[mesh.leaf], -1).astype(np.int32),
        parent=parent.astype(np.int32),
    )
