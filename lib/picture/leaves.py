"""Leaves of a quadtree over the picture, one tree per facet.

Light that is known at the leaves is spread over the pixels by local linear fits.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from lib.picture import leaves_kernels as kernels
from lib.picture.leaves_kernels import LeafArrays
from lib.picture.pixels import Pixels


@dataclass
class Leaves:
    """Blocks of pixels of one facet: pixels first to last - 1 in Morton's order; a block is 2^level wide.

    q : (K, 2) px, mean position;  extent : (K,) local, the block's largest width;  irradiance : (K, C)
    distance : (K,) local, harmonic mean distance of what is seen;  noise : (K,) of the irradiance
    rays : (K,) that it took
    """

    first: np.ndarray
    last: np.ndarray
    level: np.ndarray
    q: np.ndarray
    extent: np.ndarray
    irradiance: np.ndarray
    distance: np.ndarray
    noise: np.ndarray
    rays: np.ndarray

    def __len__(self):
        return len(self.first)

    def __getitem__(self, keep):
        return Leaves(*(getattr(self, f.name)[keep] for f in fields(self)))

    @property
    def arrays(self) -> LeafArrays:
        """For kernels."""
        return LeafArrays(self.first, self.last, self.level, self.q)

    @staticmethod
    def joined(*parts) -> Leaves:
        """One after the other."""
        return Leaves(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Leaves)))


def pixel_blocks(pixels: Pixels, first, last, level):
    """Cut ranges of pixels into blocks 2^level wide -> first, last."""
    code = pixels.key >> (2 * level)
    inside = np.repeat(np.arange(len(first)), last - first)
    member = np.arange(len(inside)) - np.repeat(np.cumsum(last - first) - (last - first), last - first) + first[inside]
    new = np.ones(len(member), bool)
    new[1:] = (code[member[1:]] != code[member[:-1]]) | (inside[1:] != inside[:-1])
    begin = np.flatnonzero(new)
    length = np.diff(np.append(begin, len(member)))
    return member[begin], member[begin] + length


def block_means(values, first, last):
    """(K,) mean of values (M,) over ranges."""
    cumulated = np.concatenate([[0.0], np.cumsum(values)])
    return (cumulated[last] - cumulated[first]) / (last - first)


def neighbourhoods(leaves: Leaves, facet, neighbours=12):
    """Local linear fits of the irradiance through the leaves around each.

    facet : (K,) of the leaves
    Returns (K, 3, C) value, d/dx and d/dy at the leaf, and (K, C) what its neighbours foretell without it.
    """
    from scipy.spatial import cKDTree

    if not len(leaves):
        return np.zeros((0, 3, leaves.irradiance.shape[1])), leaves.irradiance
    # facets do not mix: they are far apart in the third coordinate
    where = np.column_stack([leaves.q, 1e6 * facet.astype(float)])
    distance, near = cKDTree(where).query(where, k=min(neighbours, len(where)))
    distance, near = distance.reshape(len(where), -1), near.reshape(len(where), -1)
    return kernels.local_fits(leaves.q, leaves.irradiance, near, distance)


def interpolated(leaves: Leaves, pixels: Pixels):
    """(M, C) irradiance of every pixel: local fits of the leaves around it, blended smoothly, never across facets."""
    facet = pixels.facet[leaves.first]
    total = np.zeros((len(pixels), leaves.irradiance.shape[1]))
    rest = leaves
    for _ in range(2):
        # linear fits smooth hollows and domes away; what each leaf then lacks on average is fitted and added
        fits, _ = neighbourhoods(rest, facet)
        total += kernels.splat(leaves.arrays, fits, pixels.arrays)
        means = np.stack([block_means(total[:, c], leaves.first, leaves.last) for c in range(total.shape[1])], axis=1)
        rest = replace(leaves, irradiance=leaves.irradiance - means)
    return np.maximum(total, 0)
