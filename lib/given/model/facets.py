"""Facets: maximal flat pieces of one object and one group, joined from neighbouring polygons."""

from typing import NamedTuple

import numpy as np

from lib.given.model.polygons import FLAT, following

CROWD = 16  # polygons at one edge of an object; where there are more, only those next to each other are compared


class Edges(NamedTuple):
    """The sides of all polygons, sorted by position, then by object."""

    polygon: np.ndarray  # (n,) int
    length: np.ndarray  # (n,) m
    run: np.ndarray  # (n,) int: equal for sides at one place and of one object


class Neighbours(NamedTuple):
    """Pairs of polygons that may be one facet."""

    left: np.ndarray  # (N,) int
    right: np.ndarray  # (N,) int
    bend: np.ndarray  # (N,): how far the smaller one rises from the other's plane, as a part of their size


def joined(vertices, position, pieces, n_objects) -> tuple[np.ndarray, np.ndarray]:
    """Which facet each polygon belongs to (P,), and which objects are closed (n_objects,).

    Neighbours join when they are of one object and group, face the same way, and the smaller one rises from the
    other's plane by at most FLAT of their size, both measured across the shared edge.  A chain of such steps can bend
    (a finely cut cylinder): a facet that is not flat as a whole is parted again with a tenth of the tolerance.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = _edges(vertices, position, pieces)
    count = len(pieces.object)
    area = np.linalg.norm(pieces.area_vector, axis=1)
    n = pieces.area_vector / area[:, None]
    left, right, bend = _neighbours(edges, pieces, n, area)
    tolerance = np.full(count, FLAT)
    while True:
        join = bend <= np.minimum(tolerance[left], tolerance[right])
        graph = coo_matrix((np.ones(join.sum(), bool), (left[join], right[join])), shape=(count, count))
        n_facets, facet = connected_components(graph, directed=False)
        again = _bent(vertices, pieces, n, facet, n_facets)[facet]
        if not again.any():
            return facet, _closed(edges, pieces, n_objects)
        tolerance[again] = np.where(tolerance[again] > 1e-12, tolerance[again] / 10, -1.0)


def _edges(vertices, position, pieces):
    owner = np.repeat(np.arange(len(pieces.object)), pieces.size)
    after = pieces.corners[following(pieces.starts)]
    ends = np.sort(np.stack([position[pieces.corners], position[after]], axis=1), axis=1)
    order = np.lexsort((pieces.object[owner], ends[:, 1], ends[:, 0]))
    ends, polygon = ends[order], owner[order]
    length = np.linalg.norm(vertices[pieces.corners[order]] - vertices[after[order]], axis=1)
    thing = pieces.object[polygon]
    new = np.ones(len(ends), bool)
    new[1:] = (ends[1:] != ends[:-1]).any(axis=1) | (thing[1:] != thing[:-1])
    return Edges(polygon, length, np.cumsum(new) - 1)


def _closed(edges, pieces, n_objects):
    """(n_objects,) bool: within the object, each edge stands there an even number of times."""
    first = np.unique(edges.run, return_index=True)[1]
    odd = np.bincount(edges.run) % 2
    return np.bincount(pieces.object[edges.polygon[first]], odd, n_objects) == 0


def _neighbours(edges, pieces, n, area):
    """Polygons of one object that share an edge, are of one group, and face the same way.

    Of the many at a crowded edge each is compared with those next to it as they turn round the edge: all with all would
    be as many pairs as the square of their number.
    """
    crowded = np.bincount(edges.run)[edges.run] > CROWD if len(edges.run) else np.zeros(0, bool)
    left, right, length = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
    for step in range(1, CROWD):
        i = np.flatnonzero((edges.run[step:] == edges.run[:-step]) & ~crowded[step:])
        if len(i) == 0:
            break
        left.append(edges.polygon[i]), right.append(edges.polygon[i + step]), length.append(edges.length[i])
    if crowded.any():
        a, b = _around(edges, n, np.flatnonzero(crowded))
        left.append(edges.polygon[a]), right.append(edges.polygon[b]), length.append(edges.length[a])
    left, right, length = np.concatenate(left), np.concatenate(right), np.concatenate(length)
    alike = (pieces.group[left] == pieces.group[right]) & (left != right)
    alike &= np.einsum("ij,ij->i", n[left], n[right]) > 0.99
    left, right, length = left[alike], right[alike], length[alike]
    sine = np.linalg.norm(np.cross(n[left], n[right]), axis=1)
    width = np.stack([area[left], area[right]]) / length
    bend = np.where(sine < 0.05, sine * width.min(axis=0) / width.max(axis=0), np.inf)
    return Neighbours(left, right, bend)


def _around(edges, n, crowded):
    """Pairs of crowded sides, (indices, indices), whose polygons follow each other round their edge, in a ring."""
    run = edges.run[crowded]
    first = n[edges.polygon[crowded[np.searchsorted(run, run)]]]  # of the first polygon at the same edge
    own = n[edges.polygon[crowded]]
    across = np.cross(first, own)
    side = np.einsum("ij,ij->i", across, across[_farthest(run, across)])
    turn = np.arctan2(np.copysign(np.linalg.norm(across, axis=1), side), np.einsum("ij,ij->i", first, own))
    order = crowded[np.lexsort((turn, run))]
    run = edges.run[order]
    start = np.searchsorted(run, run)
    last = np.append(run[1:] != run[:-1], True)
    after = np.where(last, start, np.arange(len(order)) + 1)
    return order, order[after]


def _farthest(run, across):
    """(n,) for each side the one at the same edge that turns farthest from the first: it tells the sense of turning."""
    length = np.linalg.norm(across, axis=1)
    order = np.lexsort((length, run))
    return order[np.searchsorted(run[order], run, side="right") - 1]


def _bent(vertices, pieces, n, facet, n_facets):
    """(n_facets,) bool: facets of several polygons that are not flat as a whole."""
    of_corner = np.repeat(facet, pieces.size)
    total = np.stack([np.bincount(facet, pieces.area_vector[:, k], n_facets) for k in range(3)], axis=1)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    corners = vertices[pieces.corners]
    origin = np.zeros((n_facets, 3))
    origin[of_corner[::-1]] = corners[::-1]  # the first corner of each
    p = corners - origin[of_corner]
    height = np.einsum("ij,ij->i", p, total[of_corner])
    low, high = np.full((n_facets, 4), np.inf), np.full((n_facets, 4), -np.inf)
    np.minimum.at(low, of_corner, np.column_stack([p, height]))
    np.maximum.at(high, of_corner, np.column_stack([p, height]))
    extent = high - low
    bent = extent[:, 3] > FLAT * np.linalg.norm(extent[:, :3], axis=1)
    steep = np.einsum("ij,ij->i", n, total[facet]) < 0.998
    bent[facet[steep]] = True
    return bent & (np.bincount(facet, minlength=n_facets) > 1)
