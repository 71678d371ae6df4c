"""Patches: the leaves of a quadtree over the bounding rectangle of each lit side of each facet (section 3.3).

A facet has two *sides*, side = 2 * facet + (0 front, 1 back), each with its own radiosity. A side is meshed only if
light can reach it: not the inside of a solid, and not a side from which nothing at all is seen. Leaves are clipped by
the facet, so areas are exact for any polygon. One look into the side's table of finest cells locates a hit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.core.rows import distinct
from lib.light import cells_kernels as kernels
from lib.light import clusters
from lib.light.cells_kernels import PatchPieces, PatchTable
from lib.light.surface import Surface, on_hand


@dataclass(frozen=True)
class Mesh:
    """Patches; areas and lengths are local (see rays.Local)."""

    side: np.ndarray  # (N,) int32; of a cluster that of its largest part
    area: np.ndarray  # (N,) local
    centre: np.ndarray  # (N, 3) local
    tri_start: np.ndarray  # (N + 1,) int32 into tri_uv, tri_cdf
    tri_uv: np.ndarray  # (K, 3, 2) float64, pieces of the patches in facet coordinates
    tri_cdf: np.ndarray  # (K,) cumulated share of the patch's area
    tri_side: np.ndarray  # (K,) int32, the side that each piece lies on: a cluster has pieces of several facets
    table_start: np.ndarray  # (2 F,) int64 into leaf; -1: the side has no patches
    table_shape: np.ndarray  # (2 F, 2) int32 finest cells along the two axes
    leaf: np.ndarray  # (...,) int32 patch of each finest cell, -1 outside the facet
    parent: np.ndarray  # (N,) int32, numbers the cells one level up: what a coarser mesh would not tell apart

    def __len__(self):
        return len(self.side)

    @property
    def is_cluster(self) -> np.ndarray:
        """(N,) bool: patches with pieces on several sides."""
        owner = np.repeat(np.arange(len(self)), np.diff(self.tri_start))
        return np.bincount(owner, self.tri_side != self.side[owner], len(self)) > 0

    @property
    def table(self) -> PatchTable:
        """For kernels: which patch is where."""
        return PatchTable(self.table_start, self.table_shape, self.leaf)

    @property
    def pieces(self) -> PatchPieces:
        """For kernels: the triangles of each patch."""
        return PatchPieces(self.tri_side, self.tri_start, self.tri_uv, self.tri_cdf)


class Tree:
    """Leaves under construction: side, level, integer cell position at that level, and the root grid per side.

    Leaves may belong to clusters, each of which is one patch (lib/light/clusters.py).
    """

    def __init__(self, surface: Surface, sides, coarse, *, clustered=False):
        """sides : (n,) int, those that are cut;  coarse : local, a root cell is no wider
        clustered : facets that are smaller than a root cell begin in clusters
        """
        self.surface, self.coarse = surface, coarse
        corners, facet = on_hand(surface.corners, surface.hand), surface.facet
        relative = corners - surface.origin[facet][:, None, :]
        self.uv = np.stack([np.einsum("tij,tj->ti", relative, surface.axes[facet, a]) for a in (0, 1)], axis=-1)
        self.order = np.lexsort((surface.triangle_place, facet)).astype(np.int64)
        self.start = np.searchsorted(facet[self.order], np.arange(len(surface.normal) + 1)).astype(np.int64)
        root = np.maximum(1, np.ceil(surface.size / coarse - 1e-9)).astype(np.int64)  # (F, 2)
        self.root = np.repeat(root, 2, axis=0)  # per side
        side = np.repeat(sides, self.root[sides].prod(axis=1))
        each = [np.arange(n) for n in self.root[sides].prod(axis=1)]
        index = np.concatenate(each) if each else np.zeros(0, int)
        nv = self.root[side, 1]
        self.leaves = np.stack([side, np.zeros_like(side), index // nv, index % nv], axis=1)  # side, level, iu, iv
        self._prune()
        small = self.root[self.leaves[:, 0]].prod(axis=1) == 1
        self.clusters = np.where(small & clustered, 0, clusters.NONE)  # (n,) level of each leaf's cluster
        self.sort()

    @property
    def element(self):
        """(n,) int: the patch that each leaf is, or belongs to."""
        if (self.clusters == clusters.NONE).all():
            return np.arange(len(self.leaves))
        return clusters.elements(self.surface, self.leaves[:, 0], self.clusters, self.coarse)

    def cells(self, leaves=None):
        """(n, 5) facet, u0, v0, u1, v1 of leaves (n, 4), by default the tree's."""
        leaves = self.leaves if leaves is None else leaves
        side, level, iu, iv = leaves.T
        count = self.root[side] * (1 << level)[:, None]
        step = self.surface.size[side // 2] / count
        return np.stack(
            [side // 2, iu * step[:, 0], iv * step[:, 1], (iu + 1) * step[:, 0], (iv + 1) * step[:, 1]], axis=1
        )

    def cut(self, leaves=None):
        """See `cut_cells`."""
        return kernels.cut_cells(self.cells(leaves), self.uv, self.start, self.order, 1e-9)

    def _prune(self):
        start = self.cut()[0]
        self.leaves = self.leaves[np.diff(start) > 0]

    def split(self, flags):
        """Replace leaves by their four quadrants, and clusters by smaller ones.  flags : (n,) bool"""
        element = self.element
        falls_apart = flags & (self.clusters != clusters.NONE) & (np.bincount(element)[element] > 1)
        self.clusters[falls_apart] += 1
        flags = flags & ~falls_apart
        side, level, iu, iv = self.leaves[flags].T
        quadrants = [(du, dv) for du in (0, 1) for dv in (0, 1)]
        children = np.concatenate(
            [np.stack([side, level + 1, 2 * iu + du, 2 * iv + dv], axis=1) for du, dv in quadrants]
        )
        children = children[np.diff(self.cut(children)[0]) > 0]
        self.leaves = np.concatenate([self.leaves[~flags], children])
        self.clusters = np.concatenate([self.clusters[~flags], np.full(len(children), clusters.NONE)])

    def sort(self):
        """By the place of the facet, side, level and place on it."""
        side, level, iu, iv = self.leaves.T
        order = np.lexsort((iv, iu, level, side % 2, self.surface.place[side // 2]))
        self.leaves, self.clusters = self.leaves[order], self.clusters[order]

    def middles(self, mesh) -> np.ndarray:
        """(N, 2) where each patch of the mesh would be cut, coordinates on its own facet."""
        cells = self.cells()
        if len(mesh) == len(cells):
            return (cells[:, 1:3] + cells[:, 3:5]) / 2
        f = mesh.side // 2
        result = np.einsum("nd,nad->na", mesh.centre - self.surface.origin[f], self.surface.axes[f])
        alone = self.clusters == clusters.NONE
        result[self.element[alone]] = ((cells[:, 1:3] + cells[:, 3:5]) / 2)[alone]
        return result

    def mesh(self) -> Mesh:
        """The leaves as patches, in their order, and the clusters where their first leaves are."""
        surface, leaves = self.surface, self.leaves
        start, pieces, cdf, area = self.cut(leaves)
        side, level = leaves[:, 0], leaves[:, 1]
        finest = np.zeros(len(self.root), np.int64)
        np.maximum.at(finest, side, level)
        shape = self.root * (1 << finest)[:, None]
        used = np.zeros(len(self.root), bool)
        used[side] = True
        count = np.where(used, shape.prod(axis=1), 0)
        table = np.where(used, np.concatenate([[0], np.cumsum(count)[:-1]]), -1)
        leaf = kernels.leaf_table(leaves, finest, shape, table, int(count.sum()))
        f = side // 2
        weight = np.diff(cdf, prepend=0.0)
        weight[start[:-1]] = cdf[start[:-1]]
        middle = np.add.reduceat(pieces.mean(axis=1) * weight[:, None], start[:-1], axis=0)
        centre = surface.origin[f] + middle[:, :1] * surface.axes[f, 0] + middle[:, 1:] * surface.axes[f, 1]
        above = np.stack([side, level, leaves[:, 2] >> 1, leaves[:, 3] >> 1], axis=1)
        parent = distinct(above)[1]
        sides = 2 * np.count_nonzero(surface.group >= 0)  # lids have no patches, and stand behind the facets
        mesh = Mesh(
            side.astype(np.int32),
            area,
            centre,
            start,
            pieces,
            cdf,
            np.repeat(side, np.diff(start)).astype(np.int32),
            table[:sides],
            shape[:sides].astype(np.int32),
            leaf,
            parent.astype(np.int32),
        )
        element = self.element
        return mesh if element.max(initial=-1) + 1 == len(mesh) else clusters.merged(mesh, element, self.clusters)
