"""What arrives of a lamp's light where it is thrown in a lobe and not evenly (data/SCENE.md, `lobe`).

Factors to lambertian lamps stand for as long as the geometry does. A lobe takes a share of them at each place, which
is smooth: few rays tell it, and its derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lib.given.rays import shifts, sobol
from lib.light import lamps as lamps_
from lib.light.cells_kernels import patch_points
from lib.light.factors_file import FormFactors
from lib.light.surface import Surface, side_normals, triangle_areas

PLACES = 4  # of a receiver
PARTS, SINGLY = 8, 24  # triangles that a lamp is cut into at least, and from which each has one place
MOST = 64  # triangles of a lamp that are looked at
INNER = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6  # places in a triangle, good to the second degree
NEAREST = 1e-4  # of the scene's diagonal


@dataclass(frozen=True, eq=False)
class Throws:
    """The ways from one lamp to R receivers.

    along : (R, K, 3) unit;  weight : (R, K) what each carries of a lambertian lamp's light, rows sum to 1, or to 0
    """

    along: np.ndarray
    weight: np.ndarray

    def share(self, lobe):
        """(R,) what arrives, over what arrives of a lambertian lamp of the same emittance. lobe : (4,)"""
        return (self.weight * lamps_.thrown(lobe, self.along)).sum(axis=1)

    def moments(self):
        """(R, 3) the mean direction: what arrives where the light is 1 + a . direction, beside what is even."""
        return np.einsum("rk,rkd->rd", self.weight, self.along)

    def slopes(self, lobe, axes):
        """(R, 3) derivatives of `share`: turning the aim towards axes (2, 3), rad, and by the exponent's logarithm."""
        cosine = np.maximum(self.along @ lobe[:3], 1e-6)
        thrown = self.weight * np.where(cosine > 1e-6, cosine ** lobe[3], 0)
        turned = [(thrown * lobe[3] * (self.along @ axis) / cosine).sum(axis=1) for axis in axes]
        return np.stack([*turned, (thrown * lobe[3] * np.log(cosine)).sum(axis=1)], axis=1)


def throws(surface: Surface, lamp, p, normal) -> Throws:
    """From the lamp of one group to places of R receivers.

    lamp : name;  p : (R, n, 3) local;  normal : (R, 3) of the receivers' sides
    """
    t = np.flatnonzero(surface.group[surface.facet] == surface.groups.index(lamp))
    corners, front = surface.corners[t], surface.normal[surface.facet[t]]
    some = slice(None, None, -(-len(corners) // MOST) or 1)
    corners, front = corners[some], front[some]
    while 0 < len(corners) < PARTS:
        corners, front = _in_four(corners), np.repeat(front, 4, axis=0)
    rule = INNER if len(corners) <= SINGLY else np.full((1, 3), 1 / 3)
    at = np.einsum("qc,tcd->tqd", rule, corners).reshape(-1, 3)
    front, area = (np.repeat(v, len(rule), axis=0) for v in (front, triangle_areas(corners)))
    way = p[:, :, None, :] - at  # (R, n, K, 3)
    length = np.maximum(np.linalg.norm(way, axis=-1), NEAREST)
    way /= length[..., None]
    here = np.maximum(-np.einsum("rnkd,rd->rnk", way, normal), 0)
    weight = here * np.maximum(np.einsum("rnkd,kd->rnk", way, front), 0) * area / length**2
    weight = weight.reshape(len(p), -1)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    return Throws(way.reshape(len(p), -1, 3).astype(np.float32), weight.astype(np.float32))


def _in_four(corners):
    """(4 K, 3, 3) of triangles (K, 3, 3), each halved along its sides."""
    a, b, c = (corners[:, i] for i in range(3))
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)


def to_patches(surface: Surface, factors: FormFactors, lamp) -> Throws:
    """To the patches."""
    n, mesh = len(factors.mesh), factors.mesh
    p = patch_points(PLACES, sobol(PLACES), shifts(n, PLACES, 2000), mesh.pieces, surface.arrays)
    return throws(surface, lamp, p.reshape(n, PLACES, 3), side_normals(surface)[mesh.side])


def in_lobes(factors: FormFactors, surface: Surface, lobes) -> FormFactors:
    """The factors of lamps that throw their light in lobes. lobes : {name: (4,)}"""
    if not lobes:
        return factors
    D = factors.lamp_factor.copy()
    for name, lobe in lobes.items():
        D[:, factors.lamps.index(name)] *= to_patches(surface, factors, name).share(lobe)
    return replace(factors, lamp_factor=D, lobes=factors.lobes | lobes)
