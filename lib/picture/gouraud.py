"""Radiosity as it spreads (figure 3.9): the balance by any solver, and its picture after each so many iterations.

As in the paper's pseudo-algorithm: radiosities are rescaled by the brightest element, a vertex has the mean of the
elements that meet there, and the picture interpolates linearly between vertices (Gouraud). Vertices are those of the
finest cells of each side's quadtree. Quick, and only as good as the elements: the picture proper is rendering.py's.
"""

from __future__ import annotations

import numpy as np

from lib.light import radiosity
from lib.light import surface as surfaces


def emittance(factors, side_is_front, lamps):
    """(N, C): what the lamps' front patches emit. lamps : (L, C)"""
    E = np.zeros((len(factors.mesh), lamps.shape[1]))
    for k, group in enumerate(factors.lamp_groups):
        E[(factors.patch_group == group) & side_is_front] += lamps[k]
    return E


def solve(factors, rho, lamps, *, method, tolerance, ambient=False, overshoot=False, callback=None, every=1):
    """The radiosity.Solution of the *reflected* light (N, C): the balance whose emittance is rho D lamps.

    The lamps' direct light has their exact factors D, and so their first shot is drawn at once. What the iteration
    shows is how reflected light spreads.
    rho : (G, C);  lamps : (L, C);  the others : see radiosity.solve
    """
    r = rho[factors.patch_group]
    source = r * (factors.lamp_factor @ lamps)
    more = {}
    if method == "progressive":
        area = np.maximum(factors.area, 1e-12 * factors.area.max())
        more = {"area": area, "patch": factors.mesh.parent, "ambient": ambient, "overshoot": overshoot}
    F = factors.rows.matrix()
    return radiosity.solve(source, r, F, method=method, tolerance=tolerance, callback=callback, every=every, **more)


class Canvas:
    """Draws patch radiosities from the photograph's camera; the geometry is found once."""

    def __init__(self, surface, mesh, camera, facet):
        """facet : (H, W) int, -1 = nothing"""
        self.shape = facet.shape
        self.pixel = np.flatnonzero(facet.ravel() >= 0)
        f = facet.ravel()[self.pixel]
        p, side = surfaces.backproject(surface, camera, f, self.pixel)
        d = p - surface.origin[f]
        shape = mesh.table_shape[side]
        flat = [np.einsum("ij,ij->i", d, surface.axes[f, a]) / np.maximum(surface.size[f, a], 1e-30) for a in (0, 1)]
        cell = np.clip(np.stack([flat[a] * shape[:, a] for a in (0, 1)], axis=1), 0, shape - 1e-9)
        low = np.minimum(cell.astype(np.int64), shape - 1)
        self.share = cell - low
        quadrants = [(du, dv) for du in (0, 1) for dv in (0, 1)]
        self.corner = [self._around(mesh, side, low + np.array(quadrant)) for quadrant in quadrants]

    @staticmethod
    def _around(mesh, side, vertex):
        """(n, 4) patches of the cells around each vertex (n, 2) of the finest grid, -1 where there is none."""
        around = []
        shape, start = mesh.table_shape[side], mesh.table_start[side]
        for au in (-1, 0):
            for av in (-1, 0):
                u, v = vertex[:, 0] + au, vertex[:, 1] + av
                inside = (u >= 0) & (v >= 0) & (u < shape[:, 0]) & (v < shape[:, 1]) & (start >= 0)
                at = np.where(inside, start + u * shape[:, 1] + v, 0)
                around.append(np.where(inside, mesh.leaf[at], -1))
        return np.stack(around, axis=1)

    def draw(self, B):
        """(H, W, C) from B (N, C); pixels of no patch are 0.

        A vertex has the mean of the up to four cells around it; those without a patch are left out.
        """
        B = np.vstack([B, np.zeros(B.shape[1])])  # -1 reads the zero row
        value = 0
        for k, around in enumerate(self.corner):
            count = np.maximum((around >= 0).sum(axis=1), 1)[:, None]
            u, v = self.share.T
            weight = (u if k >= 2 else 1 - u) * (v if k % 2 else 1 - v)
            value = value + weight[:, None] * (B[around].sum(axis=1) / count)
        picture = np.zeros((self.shape[0] * self.shape[1], B.shape[1]))
        picture[self.pixel] = value
        return picture.reshape(*self.shape, -1)


def sheet(pictures, columns, shrink=2):
    """Pictures (H, W, C) side by side, each averaged over shrink x shrink pixels; the last row is filled with black."""
    small = []
    for p in pictures:
        h, w = (n // shrink * shrink for n in p.shape[:2])
        small.append(p[:h, :w].reshape(h // shrink, shrink, w // shrink, shrink, -1).mean(axis=(1, 3)))
    while len(small) % columns:
        small.append(np.zeros_like(small[0]))
    return np.vstack([np.hstack(small[i : i + columns]) for i in range(0, len(small), columns)])
