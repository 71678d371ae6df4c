"""What stays the same while the ladder is climbed: geometry, camera, photograph, and the light of the diffuse fit."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lib.analysis.fit.problem import Problem
from lib.analysis.seen import gather
from lib.analysis.seen.gather import Gathered
from lib.analysis.seen.receivers import Receivers, directions, placed
from lib.buffers.edges import boundary
from lib.given.view import View
from lib.light import form_factors, lamps, outside
from lib.light import surface as surfaces
from lib.light.chains import Chains, Finish
from lib.light.factors_file import FormFactors
from lib.light.mirror_view import MirrorView, through_mirrors
from lib.light.surface import Surface, side_normals


@dataclass
class Effort:
    """What a climb costs.

    rays : {what they were for: how many};  lost : share of the light that mirrors threw to and fro beyond paths.DEPTH
    """

    rays: dict = field(default_factory=dict)
    lost: float = 0.0

    def note(self, what, number):
        self.rays[what] = self.rays.get(what, 0) + int(number)


@dataclass(frozen=True, eq=False)
class Site:
    """base : the problem with everything diffuse;  tiles : trusted ones, which the fit uses, and those for the audit
    lobe_rays : of each tile that shows a lobe;  effort : what is spent, for the report"""

    view: View
    surface: Surface
    factors: FormFactors
    base: Problem
    tiles: Receivers
    lobe_rays: int = 256
    effort: Effort = field(default_factory=Effort)

    @cached_property
    def lamps(self):
        """The lamps' Emitters."""
        return lamps.emitters(self.surface, self.factors.lamps, self.factors.lobes)

    @property
    def subcell(self):
        """(N, N), see FormFactors.subcell."""
        return self.factors.subcell

    @cached_property
    def normals(self):
        """(2 F, 3) of the sides."""
        return side_normals(self.surface)

    @cached_property
    def pure(self):
        """(H, W) bool, see gather.pure."""
        return gather.pure(self.view.photograph, self.view.facet)

    @cached_property
    def from_edge(self):
        """(H, W) px to the nearest pixel that does not show the same facet alone."""
        import cv2

        return cv2.distanceTransform((~boundary(self.view.facet)).astype(np.uint8), cv2.DIST_L2, 5)

    def inside(self, tiles: Receivers, px):
        """(T,) bool: all pixels of the tile are so far from the edges of their facet."""
        far = self.from_edge.reshape(-1)[tiles.pixel]
        return np.minimum.reduceat(far, tiles.start[:-1]) >= px if len(tiles) else np.zeros(0, bool)

    @cached_property
    def is_lamp(self):
        """(F,) bool: the facet emits."""
        return np.isin(self.surface.group, self.factors.lamp_groups)

    @property
    def mesh(self):
        return self.factors.mesh

    @property
    def n_lamps(self):
        return len(self.factors.lamps)

    @property
    def outside(self):
        """What lies around an open model, see lib/light/outside.py."""
        return self.factors.outside

    @property
    def channels(self):
        return self.base.channels

    def pixels_of(self, groups):
        """Flat index of the pixels that show these groups at once."""
        facet = self.view.facet.reshape(-1)
        return np.flatnonzero((facet >= 0) & np.isin(self.surface.group[facet], groups))

    def pure_pixels_of(self, groups):
        """The same of pixels that mix with nothing and are neither black nor saturated."""
        pixel = self.pixels_of(groups)
        return pixel[self.pure.reshape(-1)[pixel]]

    def in_mirrors(self, finish: Finish, chains: Chains, pixel) -> tuple[MirrorView, np.ndarray]:
        """What these pixels (n,) show in the end, and which of them are pure there too, (n,) bool.

        Pure: all neighbours show the same facet by the same way.
        """
        H, W = self.view.shape
        origin = np.broadcast_to(self.surface.local.points(self.view.camera.centre), (len(pixel), 3))
        rays = np.hstack([origin, directions(self.view.camera, pixel)]).astype(np.float32)
        shown = through_mirrors(self.surface, finish, chains, rays)
        self.effort.note("camera rays to mirrors", len(pixel))
        label = np.full(H * W, -1, np.int64)
        label[pixel] = np.where(
            shown.facet >= 0, shown.facet + shown.chain.astype(np.int64) * len(self.surface.normal), -1
        )
        dense = np.unique(label, return_inverse=True)[1].reshape(H, W)
        pure = ~boundary(dense).reshape(-1)[pixel] & (shown.facet >= 0) & self.pure.reshape(-1)[pixel]
        return shown, pure

    def new_tiles(self, pixel, shown: MirrorView, lobe, *, rays, largest, smallest, per_facet, seed) -> Receivers:
        """New tiles of pixels (n,), of one facet and chain each.

        shown : what the pixels show;  lobe : (n,) specular group whose lobe it is, -1
        """
        H, W = self.view.shape
        label = np.full(H * W, -1, np.int64)
        _, label[pixel] = np.unique(
            self.surface.place[shown.facet] + shown.chain.astype(np.int64) * len(self.surface.normal),
            return_inverse=True,
        )
        used = np.zeros(H * W, bool)
        used[pixel] = True
        _, start, at = gather.blocks(
            label.reshape(H, W),
            used.reshape(H, W),
            hand=self.surface.hand,
            largest=largest,
            smallest=smallest,
            tiles_per_facet=per_facet,
        )
        where = np.empty(H * W, np.int64)
        where[pixel] = np.arange(len(pixel))
        i = where[at]
        first = i[start[:-1]]
        p, side = shown.p[i], shown.side[i].astype(np.int32)
        samples = gather.samples_per_pixel(gather.Sampling.lamp_samples, (H, W))
        direct = lamps.direct(
            self.surface, self.lamps, p, self.normals, side, self.n_lamps, n_samples=samples, start=start, seed=seed
        )
        n_rays = np.full(len(first), rays)
        rows = form_factors.gather(self.surface, self.mesh, p, start, side[start[:-1]], n_rays, seed=seed)
        around = outside.of_points(self.factors, self.surface, p, start, side[start[:-1]], rows)
        direct[:, self.n_lamps - around.shape[1] :] = around
        self.effort.note("gathering rays", n_rays.sum())
        f = shown.facet[first].astype(np.int32)
        return Receivers(
            f,
            self.surface.group[f],
            self.surface.object[f],
            shown.chain[first].astype(np.int32),
            start,
            at,
            self.view.pixels(at),
            p,
            side,
            shown.direction[i],
            direct,
            rows,
            lobe[first].astype(np.int32),
            fit=np.ones(len(f), bool),
        )

    def at_once(self, pixel) -> MirrorView:
        """What pixels (n,) show without any mirror, in the same terms as `in_mirrors`."""
        f = self.view.facet.reshape(-1)[pixel].astype(np.int32)
        p, side = surfaces.backproject(self.surface, self.view.camera, f, pixel)
        return MirrorView(f, side, p, np.zeros(len(pixel), np.int32), directions(self.view.camera, pixel))

    def main_facet(self, group):
        """Number of the group's largest facet: about its normal the tangent turns."""
        f = np.flatnonzero(self.surface.group == group)
        return f[np.argmax(self.surface.size[f].prod(axis=1))]

    def main_normal(self, group):
        """The same facet's normal."""
        return self.surface.normal[self.main_facet(group)]


def site_of(
    view: View, surface: Surface, factors: FormFactors, problem: Problem, found: Gathered, audit: Gathered, **options
) -> Site:
    """found, audit : of the trusted pixels and of all;  options : further fields of Site"""
    parts = [placed(found, surface, view.camera, True), placed(audit, surface, view.camera, False)]
    return Site(view, surface, factors, problem, Receivers.joined(parts), **options)
