"""Smooth surfaces and mirrors of many facets, as the eye sees them, at once or in other mirrors.

Light spreads over flat facets. Where the eye looks at an ellipsoid, the place and the normal are those of the ellipsoid
itself: a mirror's ray goes on from there, a lobe is about that normal, and a diffuse surface has no edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.given.rays_kernels import OFFSET
from lib.light import lamps
from lib.light.chains import Chains, Finish
from lib.light.mirror_view import MirrorView, through_mirrors
from lib.light.surface import Surface, side_normals
from lib.picture import glossy, light_map
from lib.picture.glossy import lobes

DEPTH = 8  # curved mirrors in a row that a ray of the eye follows
SUB = 4  # sub-pixels across a pixel of one facet
LOBE_RAYS = 8  # at each place on a smooth surface, and of each ray that meets a glossy one by way of a mirror
SHADOW_RAYS = 16  # at each place of a smooth surface
NOTHING = Finish((), np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 3)))  # no mirrors


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """facets : their numbers;  centre : (3,) m;  M : (3, 3) per metre, norm(M (p - centre)) = 1 on it"""

    facets: np.ndarray
    centre: np.ndarray
    M: np.ndarray


@dataclass(frozen=True, eq=False)
class Curved:
    """F facets, Q ellipsoids.

    mirror : (F,) bool;  rho_s : (F, C), 0 where it is none;  smooth : (F,) number of the ellipsoid, -1: flat facets
    centre : (Q, 3) local;  M : (Q, 3, 3) per local length
    """

    mirror: np.ndarray
    rho_s: np.ndarray
    smooth: np.ndarray
    centre: np.ndarray
    M: np.ndarray

    @classmethod
    def of(cls, surface: Surface, mirrors, ellipsoids, channels) -> Curved | None:
        """mirrors : {group: rho_s (3,)};  ellipsoids : [Ellipsoid];  None where there is neither"""
        if not mirrors and not ellipsoids:
            return None
        F = len(surface.normal)
        mirror, rho_s, smooth = np.zeros(F, bool), np.zeros((F, channels)), np.full(F, -1)
        for name, rho in mirrors.items():
            mine = surface.group == surface.groups.index(name)
            mirror[mine], rho_s[mine] = True, rho[:channels]
        for number, one in enumerate(ellipsoids):
            smooth[one.facets] = number
        local = surface.local
        centre = np.array([local.points(one.centre) for one in ellipsoids]).reshape(-1, 3)
        M = np.array([one.M * local.diagonal for one in ellipsoids]).reshape(-1, 3, 3)
        return cls(mirror, rho_s, smooth, centre, M)

    def has(self, facet):
        """Bool of facet numbers of any shape, -1 is nothing."""
        return (facet >= 0) & (self.mirror | (self.smooth >= 0))[np.maximum(facet, 0)]

    def place(self, surface: Surface, facet, p, direction):
        """(n, 3) places, and unit normals (n, 3) towards the eye, of rays along `direction` that meet facets at p."""
        n = surface.normal[facet] * -np.sign(np.einsum("ij,ij->i", surface.normal[facet], direction))[:, None]
        p = np.array(p, float)
        at = np.flatnonzero(self.smooth[facet] >= 0)
        q = self.smooth[facet[at]]
        # the ray in the coordinates in which the ellipsoid is the unit sphere; its corners lie on it, so it is met
        o = np.einsum("nij,nj->ni", self.M[q], p[at] - self.centre[q])
        v = np.einsum("nij,nj->ni", self.M[q], direction[at])
        a, b, c = (v * v).sum(1), (o * v).sum(1), (o * o).sum(1) - 1
        t = (-b - np.sqrt(np.maximum(b * b - a * c, 0))) / a
        o += t[:, None] * v
        p[at] += t[:, None] * direction[at]
        normal = np.einsum("nji,nj->ni", self.M[q], o)
        n[at] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        return p, n

    def light(self, subject, lit, facet, p, direction, depth=0, *, lobe_rays=LOBE_RAYS):
        """(n, C) what leaves facets (n,) that this has towards the eye, whose rays meet them at p (n, 3).

        direction : (n, 3) unit, of the rays
        subject : Subject;  lit : Lighting
        """
        p, n = self.place(subject.surface, facet, p, direction)
        out = np.zeros((len(facet), subject.channels))
        at = np.flatnonzero(self.mirror[facet])
        if len(at) and depth < DEPTH:
            along = direction[at] - 2 * np.einsum("ij,ij->i", direction[at], n[at])[:, None] * n[at]
            # a facet of a mesh may turn the ray into the mesh's inside, where nothing is
            rays = np.hstack([p[at] + OFFSET * n[at], along]).astype(np.float32)
            ways = lit.ways
            finish, chains = (NOTHING, Chains(0)) if ways is None else (ways.finish, ways.chains)
            view = through_mirrors(subject.surface, finish, chains, rays)
            out[at] = self.rho_s[facet[at]] * shade(subject, lit, view, depth=depth + 1)
        at = np.flatnonzero(~self.mirror[facet])
        if len(at):
            out[at] = self._diffuse(subject, lit, facet[at], p[at], n[at], direction[at])
            finish = subject.appearance.finish
            if finish is not None:
                at = at[np.isin(subject.surface.group[facet[at]], finish.groups)]
                at_once = np.zeros(len(at), np.int32)
                along = np.asarray(direction[at], float)
                out[at] += lobes(lit, p[at], facet[at], along, at_once, lobe_rays, normal=n[at])
        return out

    def _diffuse(self, subject, lit, facet, p, n, direction):
        """What smooth surfaces that are no mirrors reflect diffusely."""
        surface = subject.surface
        each = np.arange(len(p))
        factor = lamps.direct(surface, lit.lamps, p, n, each, len(lit.E), n_samples=SHADOW_RAYS)
        light = factor @ lit.E + self._between(surface, lit, facet, n)
        return lit.radiosities(light, facet, 2 * facet, p, direction)

    def _between(self, surface, lit, facet, n):
        """(m, C) indirect irradiance at normals n (m, 3): that of the facets turned most nearly so, fitted linearly."""
        from scipy.spatial import cKDTree

        out = np.zeros((len(facet), lit.E.shape[1]))
        for q in np.unique(self.smooth[facet]):
            own = np.flatnonzero(self.smooth == q)
            first, size = lit.shown.start[2 * own], lit.shown.shape[2 * own].prod(axis=1)
            lit_ones = first >= 0
            own, first, size = own[lit_ones], first[lit_ones], size[lit_ones]
            mean = np.array([lit.shown.between[a : a + k].mean(axis=0) for a, k in zip(first, size, strict=True)])
            at = np.flatnonzero(self.smooth[facet] == q)
            distance, near = cKDTree(surface.normal[own]).query(n[at], k=min(12, len(own)))
            weight = np.maximum(1 - (distance / (1.05 * distance[:, -1:] + 1e-12)) ** 2, 1e-6) ** 2
            out[at] = (weight[:, :, None] * mean[near]).sum(axis=1) / weight.sum(axis=1)[:, None]
        return out


def outside(lit, view: MirrorView):
    """Rays that leave the model after a mirror (n,), and what they show, (n, C)."""
    if lit.shown.glow is None:
        return np.zeros(0, np.int64), np.zeros((0, lit.appearance.channels))
    gone = np.flatnonzero((view.facet < 0) & ((view.chain > 0) | (lit.ways is None)))
    light = lit.shown.glow.light(np.hstack([view.p, view.direction])[gone])
    return gone, light * _power(lit)[view.chain[gone]]


def _power(lit):
    return np.ones((1, lit.appearance.channels)) if lit.ways is None else lit.ways.chains.power(lit.ways.rho_s)


def shade(subject, lit, view: MirrorView, near=None, *, depth=0, numbers=None):
    """(n, C) what rays through mirrors show.

    Lamps by few shadow rays each; other light from the light map, and in lobes by few rays.
    near : numbers of rays (m,) -> (m, C) other light, where it is known better, and (m,) bool where it is
    numbers : (n,) of the rays, see lamps.direct
    """
    surface, power = subject.surface, _power(lit)
    there = np.flatnonzero(view.facet >= 0)
    B = np.zeros((len(view.facet), subject.channels))
    p, side = view.p[there], view.side[there].astype(np.int32)
    normals = side_normals(surface)
    numbers = None if numbers is None else numbers[there]
    factor = lamps.direct(surface, lit.lamps, p, normals, side, len(lit.E), n_samples=4, numbers=numbers)
    by_lamps = factor @ lit.E
    between, found = (np.zeros_like(by_lamps), np.zeros(len(there), bool)) if near is None else near(there)
    lost = np.flatnonzero(~found)
    between[lost] = light_map.looked_up(lit.shown.between, lit.shown, surface, p[lost], side[lost])
    B[there] = (
        lit.radiosities(by_lamps + between, view.facet[there], side, p, view.direction[there])
        * power[view.chain[there]]
    )
    gone, light = outside(lit, view)
    B[gone] = light
    glossy.add(subject, lit, view, LOBE_RAYS, B)
    if subject.curved is not None:
        at = np.flatnonzero(subject.curved.has(view.facet))
        own = subject.curved.light(subject, lit, view.facet[at], view.p[at], view.direction[at], depth)
        B[at] = own * power[view.chain[at]]
    return B


# ---- in the picture ----


def of_pixels(subject, lit, seen, B):
    """B (M, C) of pixels of one facet, with the light of curved facets in its place, from SUB x SUB rays each."""
    at = np.flatnonzero(subject.curved.has(seen.facet))
    if not len(at):
        return B
    offset = (np.arange(SUB) + 0.5) / SUB - 0.5
    dy, dx = (d.ravel() for d in np.meshgrid(offset, offset, indexing="ij"))
    q = np.stack([(seen.x[at][:, None] + dx).ravel(), (seen.y[at][:, None] + dy).ravel()], axis=1)
    light, met = _through(subject, lit, q)
    n = np.maximum(met.reshape(len(at), -1).sum(axis=1), 1)
    B = B.copy()
    B[at] = light.reshape(len(at), SUB * SUB, -1).sum(axis=1) / n[:, None]
    return B


def of_fragments(subject, lit, pieces, B):
    """B (S, C) of the fragments of mixed pixels, with the light of curved facets in its place."""
    curved = subject.curved.has(pieces.facet)
    sub = np.flatnonzero((pieces.owner >= 0) & curved[np.maximum(pieces.owner, 0)])
    if not len(sub):
        return B
    W = subject.facet.shape[1]
    pixel, k = pieces.pixel[sub // 64], sub % 64
    q = np.stack([pixel % W + (k % 8 + 0.5) / 8 - 0.5, pixel // W + (k // 8 + 0.5) / 8 - 0.5], axis=1)
    light, met = _through(subject, lit, q)
    owner = pieces.owner[sub]
    n = np.bincount(owner, met, len(B))
    B = B.copy()
    for c in range(B.shape[1]):
        mean = np.bincount(owner, light[:, c], len(B)) / np.maximum(n, 1)
        B[:, c] = np.where(n > 0, mean, B[:, c])
    return B


def _through(subject, lit, q):
    """(n, C) light of curved facets through places q (n, 2) of the picture, 0 where another is met; (n,) bool it is."""
    camera, surface = subject.view.camera, subject.surface
    v = camera.rays(q)
    eye = np.broadcast_to(surface.local.points(camera.centre), v.shape)
    rays = np.hstack([eye, v]).astype(np.float32)
    triangle, t = surface.caster.closest(rays)
    facet = np.where(triangle >= 0, surface.facet[triangle], -1)
    met = subject.curved.has(np.where(facet < len(subject.curved.mirror), facet, -1))
    at = np.flatnonzero(met)
    light = np.zeros((len(q), subject.channels))
    p = eye[at] + t[at, None].astype(float) * v[at]
    light[at] = subject.curved.light(subject, lit, facet[at], p, v[at])
    return light, met
