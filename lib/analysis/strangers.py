"""What the photograph shows and the model has not: things that stand before surfaces, or another material on a thing.

A thing that is not modelled covers parts of several surfaces, with a sharp outline that is no edge of the model. What
is wrong with the light changes softly, and what is wrong with a material ends where the surface does.
"""

from __future__ import annotations

import numpy as np

from lib.analysis import misfits
from lib.analysis.agreement import fits
from lib.analysis.audit import Audit
from lib.analysis.candidates import enough
from lib.analysis.evidence import evidence, promised
from lib.analysis.explain import Explained
from lib.analysis.misfits import OTHER, shown
from lib.analysis.problem import Problem, Result
from lib.given.materials import Why
from lib.given.transfer import Metric
from lib.given.view import View
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.factors_file import FormFactors

STRANGE = 0.03  # display, from which a pixel may show something else;  and so many times what is usual on its facet
TIMES = 6
LARGE = 0.002  # part of the picture that a thing covers at least
SHARP = 0.4  # of the step at a thing's outline that lies within two pixels
HALF, ALL_AROUND = 0.5, 0.95  # of the outline that is so sharp
OUTLINE = 20  # pixels of it that must be seen
WHOLE = 0.6  # of a facet: a thing covers less
SAMPLES = 16  # of each lamp, from a pixel
ELSEWHERE = 0.1  # part of a thing that lies on other facets than most of it
LOOKED_AT = 4  # things whose own reflectance is tried


def things_missing(view: View, factors: FormFactors, explained: Explained, audit: Audit, climbed=()) -> list[Why]:
    """A line for each thing that the model has not, the largest first. climbed : {group: rung}, of those not diffuse"""
    picture = _Picture(view, explained, audit, climbed)
    if not picture.spots():
        return []
    picture.look_closely(factors)
    found, several = [], not fits(explained.result)
    for area, mine, middle in picture.spots():
        if picture.is_thing(mine, several):
            x, y = middle
            text = (
                f"something at pixel ({x:.0f}, {y:.0f}), {area} pixels large, is not in the model: it stands before"
                f" {picture.named(mine)}"
            )
            found.append((area, Why("object_missing", None, text, None)))
    return [why for _, why in sorted(found, key=lambda pair: -pair[0])]


class _Picture:
    """The photograph's pixels that show one facet each, and how far they are from what diffuse surfaces show."""

    def __init__(self, view, explained, audit, climbed):
        problem, result, tiles = explained.problem, explained.result, audit.tiles
        self.view, self.groups, self.state, self.climbed = view, problem.groups, result.state, dict(climbed)
        self.by_lamps = np.where(problem.own_lamps[:, None], result.state.E, 0)  # (L, C) emittances
        self.metric, self.pixel = Metric(result.state.transfer), tiles.pixel
        self.tiles, self.which = tiles, np.repeat(np.arange(len(tiles)), np.diff(tiles.start))
        self.B = shown(audit.subcell, problem, result, tiles)
        self.seen = self.metric.value(self.metric.transfer.linear(tiles.values))
        self.facet, self.group = tiles.facet[self.which], tiles.group[self.which]
        specular = [g for g, rung in self.climbed.items() if rung != "textured"]
        off = np.abs(self.seen - self.metric.value(self.B)[self.which]).max(axis=1)
        self.least = np.maximum(STRANGE, TIMES * _usual(off, self.facet))
        self.strange = (off > self.least) & ~np.isin(self.group, specular)
        self.owner, self.of_group = self._drawn(self.facet, -1), self._drawn(self.group, -1)

    def _drawn(self, values, empty):
        """(H, W, ...) of values (M, ...) of the pixels."""
        picture = np.full((self.view.shape[0] * self.view.shape[1], *values.shape[1:]), empty, values.dtype)
        picture[self.pixel] = values
        return picture.reshape(*self.view.shape, *values.shape[1:])

    def spots(self):
        """[(pixels, (H, W) bool, (x, y))] of strange places that are large enough."""
        import cv2

        mask, square = self._drawn(self.strange.astype(np.uint8), 0), np.ones((5, 5), np.uint8)
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, square)  # edges of the model run through it
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, square)
        number, label, stats, middle = cv2.connectedComponentsWithStats(mask, connectivity=8)
        area = stats[:, cv2.CC_STAT_AREA]
        large = [k for k in range(1, number) if area[k] >= LARGE * mask.size]
        return [(int(area[k]), label == k, middle[k]) for k in large]

    def look_closely(self, factors):
        """(M, C), (M, C): of what lamps do not send at once, the least and the most on the facet's tiles nearby."""
        surface = surfaces.surface(self.view.model, factors.lamps)
        some = np.flatnonzero(self.strange)
        p, side = surfaces.backproject(surface, self.view.camera, self.facet[some], self.pixel[some])
        normals = surfaces.side_normals(surface)
        emitters = lamps_.emitters(surface, factors.lamps, factors.lobes)
        direct = lamps_.direct(surface, emitters, p, normals, side, len(factors.lamps), n_samples=SAMPLES)
        lamps = self.state.rho[self.group[some]] * (direct @ self.by_lamps)
        low, high = (self.metric.value(lamps + light[some]) for light in self._indirect_nearby())
        off = np.maximum(low - self.seen[some], self.seen[some] - high).max(axis=1)
        self.strange[some] = off > self.least[some]

    def _indirect_nearby(self):
        """(M, C), (M, C): the least and the most of what the lamps do not send at once, on the facet's tiles nearby."""
        import cv2

        state, tiles = self.state, self.tiles
        light = np.maximum(self.B - state.rho[tiles.group] * (tiles.direct @ self.by_lamps), 0)
        side = np.sqrt(np.diff(tiles.start))
        low, high = light[self.which], light[self.which]
        picture = self._drawn(light[self.which].astype(np.float32), 0)
        for f in np.unique(self.facet[self.strange]):
            mine = self.facet == f
            reach = np.ones((2 * int(np.ceil(side[tiles.facet == f].max())) + 1,) * 2, np.uint8)
            own = (self.owner == f)[..., None]
            least = cv2.erode(np.where(own, picture, np.float32(np.inf)), reach)
            most = cv2.dilate(np.where(own, picture, np.float32(-np.inf)), reach)
            low[mine], high[mine] = (p.reshape(-1, light.shape[1])[self.pixel[mine]] for p in (least, most))
        return low, high

    def is_thing(self, mine, several):
        """Whether such pixels (H, W) bool show a thing.

        several : one that stands before several surfaces, or has a sharp outline nearly all around
        """
        import cv2

        facets, count = np.unique(self.owner[mine & (self.owner >= 0)], return_counts=True)
        if not len(facets):
            return False
        most = facets[count.argmax()]
        on_most = self.owner == most
        alone = 1 - count.max() / count.sum() < ELSEWHERE
        if alone and self.of_group[on_most][0] in self.climbed:
            return False
        if count.max() > WHOLE * np.count_nonzero(on_most):
            return False  # most of a surface is as strange: its material, or its light
        spot, small, wide = mine.astype(np.uint8), np.ones((3, 3), np.uint8), np.ones((9, 9), np.uint8)
        rim = (cv2.dilate(spot, small) > 0) & ~(cv2.erode(spot, small) > 0)
        rim &= cv2.erode(on_most.astype(np.uint8), wide) > 0
        if np.count_nonzero(rim) < OUTLINE:
            return False
        seen = self._drawn(self.seen, 0.0)
        near, far = (_step(seen, px)[rim] for px in (2, 6))
        sharp = np.mean(near > SHARP * np.maximum(far, STRANGE))
        return bool(sharp > (ALL_AROUND if alone and several else HALF))

    def named(self, mine):
        """The groups before which it stands."""
        names, count = np.unique(self.of_group[mine & (self.owner >= 0)], return_counts=True)
        return " and ".join(repr(self.groups[g]) for g in names[np.argsort(-count)][:2])


def _step(light, px):
    """(H, W) display: the greatest difference to a pixel so far away."""
    steps = [np.abs(light - np.roll(light, way, axis)).max(axis=2) for axis in (0, 1) for way in (px, -px)]
    return np.max(steps, axis=0)


def _usual(size, facet):
    """(M,) the median on each pixel's facet."""
    order = np.argsort(facet, kind="stable")
    ends = np.flatnonzero(np.diff(facet[order], prepend=-1, append=-1))
    usual = np.empty(len(size))
    for a, b in zip(ends[:-1], ends[1:], strict=True):
        usual[order[a:b]] = np.median(size[order[a:b]])
    return usual


def things_unlike(explained: Explained, audit: Audit, judged, names, climbed=()) -> list[Why]:
    """A line for each object that is unlike the rest of a group which a diffuse surface does not explain.

    By all its pixels: small things have hardly a trusted one.  judged : of Audit.misfits;  names() : of the objects
    """
    problem = explained.problem
    doubtful = [g for g in audit.flagged(problem, judged) if g not in climbed]
    parts = misfits.parts(audit.subcell, problem, explained.result, audit.tiles, doubtful)
    return [
        _another_material(names()[thing], ratio, problem.groups[g], None)
        for g, of_group in parts.items()
        for thing, ratio in of_group.unlike.items()
    ]


def _another_material(name, ratio, group, nats):
    shown_ratio = ", ".join(f"{v:.2f}" for v in ratio)
    text = f"object {name!r} reflects {shown_ratio} times what the rest of group {group!r}: another material"
    return Why("group_wrong", name, text, nats)


def groups_wrong(problem: Problem, result: Result, names, climbed=()) -> list[Why]:
    """A line for each object that has not its group's reflectance. names() : of the objects"""
    at, state = result.at, result.state
    rows = []
    for g in np.unique(problem.tile_group):
        things = np.unique(problem.tile_object[problem.tile_group == g])
        if len(things) > 1 and g not in climbed and g not in problem.known_groups:
            rows += [(g, thing) for thing in things]
    brightness = np.maximum(np.abs(at.displayed(state.B)), 1e-9)
    tried = []
    for g, thing in rows:
        mine = (problem.tile_group == g) & (problem.tile_object == thing)
        ratio = np.average(-at.residual[mine] / brightness[mine], axis=0, weights=problem.n_pixels[mine])
        tried.append((float(np.abs(ratio).max()), g, thing, mine, ratio))
    tried.sort(key=lambda row: -row[0])
    own, found = None, []
    for size, g, thing, mine, ratio in tried[:LOOKED_AT]:
        if size < OTHER:
            break
        own = evidence(problem, at).nats if own is None else own
        C = problem.channels
        each = np.zeros((len(mine), C, C))
        each[:, np.arange(C), np.arange(C)] = np.where(mine[:, None], state.B, 0)
        gain = promised(problem, at, at.displayed(each)).nats - own
        if gain >= enough(problem):
            found.append(_another_material(names()[thing], 1 + ratio, problem.groups[g], float(gain)))
    return found
