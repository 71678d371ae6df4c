"""Radiosity as it spreads (figure 3.9): the balance by any solver, and its picture after each so many iterations.

As in the paper's pseudo-algorithm: radiosities are rescaled by the brightest element, a vertex has the mean of the elements
that meet there, and the picture interpolates linearly between vertices (Gouraud). Vertices are those of the finest cells of
each side's quadtree. Quick, and only as good as the elements: the picture proper is lib/rendering.py's.
"""

from __future__ import annotations

import numpy as np

from lib.light import radiosity
from lib.light import surface as surfaces


def emittance(factors, side_is_front, lamps):
    """(N, C): what the lamps' front patches emit. lamps : (L, C)"""
    E = np.zeros((len(factors.mesh), lamps.shape[1]))
    for k, name in enumerate(factors.lamps):
        E[(factors.patch_group == factors.groups.index(name)) & side_is_front] += lamps[k]
    return E


def solve(factors, rho, lamps, *, method, tolerance, ambient=False, overshoot=False, callback=None, every=1):
    """B = E + rho F B with the lamps' direct light by their exact factors: emittance E + rho D lamps, then only reflections.

    The lamps' first shot is thus drawn at once; what the iteration shows is how reflected light spreads.
    rho : (G, C);  lamps : (L, C) -> radiosity.Solution of the *reflected* light, (N, C)
    """
    r = rho[factors.patch_group]
    source = r * (factors.lamp_factor @ lamps)
    area = np.maximum(factors.area, 1e-12 * factors.area.max())
    more = (
        dict(area=area, patch=factors.mesh.parent, ambient=ambient, overshoot=overshoot)
        if method == "progressive"
        else {}
    )
    return radiosity.solve(
        source, r, factors.rows.matrix(), method=method, tolerance=tolerance, callback=callback, every=every, **more
    )


class Canvas:
    """Draws patch radiosities from the photograph's camera; the geometry is found once."""

    def __init__(self, surface, mesh, camera, facet):
        self.shape = facet.shape
        self.pixel = np.flatnonzero(facet.ravel() >= 0)
        f = facet.ravel()[self.pixel]
        p, side = surfaces.backproject(surface, camera, f, self.pixel)
        d = p - surface.origin[f]
        shape = mesh.table_shape[side]
        cell = np.stack(
            [
                np.einsum("ij,ij->i", d, surface.axes[f, a]) / np.maximum(surface.size[f, a], 1e-30) * shape[:, a]
                for a in (0, 1)
            ],
            axis=1,
        )
        cell = np.clip(cell, 0, shape - 1e-9)
        # a vertex of the finest grid: the mean of the up to four cells around it, those without a patch left out
        low = np.minimum(cell.astype(np.int64), shape - 1)
        self.share = cell - low
        self.corner = []
        for du in (0, 1):
            for dv in (0, 1):
                around = []
                for au in (-1, 0):
                    for av in (-1, 0):
                        u, v = low[:, 0] + du + au, low[:, 1] + dv + av
                        inside = (
                            (u >= 0) & (v >= 0) & (u < shape[:, 0]) & (v < shape[:, 1]) & (mesh.table_start[side] >= 0)
                        )
                        at = np.where(inside, mesh.table_start[side] + u * shape[:, 1] + v, 0)
                        around.append(np.where(inside, mesh.leaf[at], -1))
                self.corner.append(np.stack(around, axis=1))

    def draw(self, B):
        """(H, W, C) from B (N, C); pixels of no patch are 0."""
        B = np.vstack([B, np.zeros(B.shape[1])])  # -1 reads the zero row
        value = 0
        for k, around in enumerate(self.corner):
            count = np.maximum((around >= 0).sum(axis=1), 1)[:, None]
            weight = (self.share[:, 0] if k >= 2 else 1 - self.share[:, 0]) * (
                self.share[:, 1] if k % 2 else 1 - self.share[:, 1]
            )
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
