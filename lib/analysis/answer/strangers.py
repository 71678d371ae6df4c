"""What the photograph shows and the model has not: things that stand before surfaces, or another material on a thing.

A thing that is not modelled covers parts of several surfaces, with a sharp outline that is no edge of the model. What
is wrong with the light changes softly, and what is wrong with a material ends where the surface does.
"""

from __future__ import annotations

import functools
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lib.analysis.answer.audit import Audit
from lib.analysis.causes import one_object
from lib.analysis.causes.candidates import enough
from lib.analysis.causes.explained import Explained
from lib.analysis.fit import misfits
from lib.analysis.fit.equations import Unknowns
from lib.analysis.fit.evidence import evidence
from lib.analysis.fit.gauss_newton import fit
from lib.analysis.fit.misfits import shown
from lib.analysis.fit.problem import DOUBT, Problem, Result
from lib.given.materials import Why
from lib.given.transfer import Metric
from lib.given.view import View
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.factors_file import FormFactors

STRANGE = 0.03  # display, from which a pixel may show something else;  and so many times what is usual on its facet
TIMES = 6
TINT = 0.015  # the same of colour alone
LEVELS = 1, 2, 4  # of strangeness: the shadow at a thing's foot is soft, and less strange than the thing
PLAIN = 0.05  # of a facet: less is strange besides a thing before it
LARGE = 0.002  # part of the picture that a thing covers at least
SHARP = 0.4  # of the step at a thing's outline that lies within NEAR
HALF, ALL_AROUND = 0.5, 0.95  # of the outline that is so sharp
# Lengths, in diagonals of the picture: a shadow's edge is as wide as its angle. A thing's is blurred by lens and
# sensor, by BLUR_PX to either side: that is NEAR in a picture of 640 x 480, the smallest that tells the two apart.
BLUR_PX = 2
NEAR, FAR = 1 / 400, 3 / 400  # to either side of a line
OUTLINE = 1 / 40  # of a thing, that must be seen
BESIDE = 1 / 125  # lines so near to an edge of the model may be that edge
LINE = 3 / 160  # of lines 2 NEAR wide that must hang together
WHOLE = 0.6  # of a facet: a thing covers less
SAMPLES = 16  # of each lamp, from a pixel
CLEAR = 0.7  # of a step over 2 FAR that a line has within 2 NEAR, which no edge of the model explains
NOISY = 4  # so many times what is usual on its facet, it must be
BY_SHADOW = 0.5  # of a line's step, from which the lamps explain it
WHITE = 0.98  # reflectance that a thing without trusted pixels may have at most
BY_FAR = 10  # times what a cause must bring
LEFT = 0.2  # of the error that tiles have in common, where one object's own reflectance is all that is wrong
ELSEWHERE = 0.1  # part of a thing that lies on other facets than most of it


class Thing(NamedTuple):
    """What stands before surfaces.

    middle : x, y px;  behind : numbers of the groups, the most covered first;  sharp : share of the outline that is
    alone : it stands before one group, whose mirror or texture may show it
    on_plain : before one facet, which is plain besides: one photograph does not tell it from a texture
    outlined : only its outline tells of it
    """

    pixels: int
    middle: tuple
    behind: list
    sharp: float
    alone: bool
    on_plain: bool
    outlined: bool = False

    @property
    def is_of_print(self):
        """It may be: what it stands before has a pattern besides, and nothing but its outline is strange there."""
        return self.alone and self.outlined and not self.on_plain

    @property
    def is_sharp(self):
        """All around: no picture of anything in a dull lobe is."""
        return self.sharp >= ALL_AROUND


def things(view: View, factors: FormFactors, explained: Explained, audit: Audit, climbed=()) -> list[Thing]:
    """The things that the model has not, the largest first. climbed : {group: rung}, of those not diffuse"""
    picture, wrong = _Picture(view, explained, audit, climbed), not explained.result.fits
    found = _found(picture, factors, wrong)
    if wrong and not found:
        found = _found(picture.tinted(), None, wrong)
    if not found:
        found = _outlined(picture, factors, anywhere=wrong)
    return sorted((thing for _, thing in found), key=lambda thing: -thing.pixels)


def _found(picture, factors, several):
    """[(pixels (H, W) bool, Thing)]. factors : where shadows may be what is strange"""
    if not picture.spots():
        return []
    if factors is not None:
        picture.look_closely(factors)
    found = []
    for level in LEVELS:
        for pixels, mine, middle in picture.spots(level):
            known = any((mine & other).any() for other, _ in found)
            if not known and picture.is_thing(mine, several):
                found.append((mine, picture.thing(mine, pixels, middle)))
    return found


def _outlined(picture, factors, anywhere):
    """The same by sharp lines, of the strange spots that they lie in. anywhere : also where nothing is strange"""
    spots, found = picture.spots(), []
    if not anywhere and not spots:
        return []
    outlines = [outline for outline in picture.outlined(factors) if picture.may_be_thing(outline[0], outlined=True)]
    for pixels, spot, middle in spots:
        within = [(spot & mine).sum() > HALF * size for mine, size, *_ in outlines]
        if any(within) and picture.may_be_thing(spot, outlined=True):
            sharp = max(outline[-1] for outline, inside in zip(outlines, within, strict=True) if inside)
            found.append((spot, picture.thing(spot, pixels, middle, sharp)))
            outlines = [outline for outline, inside in zip(outlines, within, strict=True) if not inside]
    return found + [(mine, picture.thing(mine, *more)) for mine, *more in outlines if anywhere]


def said(things: list[Thing], groups) -> list[Why]:
    """A line for each. groups : their names"""
    lines = []
    for thing in things:
        x, y = thing.middle
        where = f"something at pixel ({x:.0f}, {y:.0f}), {thing.pixels} pixels large, is not in the model"
        before = " and ".join(repr(groups[g]) for g in thing.behind[:2])
        lines.append(Why("object_missing", None, f"{where}: it stands before {before}", None))
    return lines


class _Picture:
    """The photograph's pixels that show one facet each, and how far they are from what diffuse surfaces show."""

    def __init__(self, view, explained, audit, climbed):
        problem, result, tiles = explained.problem, explained.result, audit.tiles
        self.view, self.groups, self.state = view, problem.groups, result.state
        self.climbed, self.given, self.has_pattern = dict(climbed), audit.given, problem.group_variance > 0
        self.by_lamps = np.where(problem.own_lamps[:, None], result.state.E, 0)  # (L, C) emittances
        self.metric, self.pixel = Metric(result.state.transfer), tiles.pixel
        self.tiles, self.which = tiles, np.repeat(np.arange(len(tiles)), np.diff(tiles.start))
        self.B = shown(audit.subcell, problem, result, tiles)
        self.seen = self.metric.value(self.metric.transfer.linear(tiles.values))
        self.facet, self.group = tiles.facet[self.which], tiles.group[self.which]
        specular = [g for g, rung in self.climbed.items() if rung != "textured"]
        self.off = np.abs(self.seen - self.metric.value(self.B)[self.which]).max(axis=1)
        self.least = np.maximum(STRANGE, TIMES * _usual(self.off, self.facet))
        self.off[np.isin(self.group, specular)] = 0
        self.owner, self.of_group = self._drawn(self.facet, -1), self._drawn(self.group, -1)

    def tinted(self):
        """The same of colours alone, which no shadow changes: things of the brightness of what they stand before."""
        light, B = self.metric.transfer.linear(self.tiles.values), self.B[self.which]
        ratio = np.log(np.maximum(light, 1e-4) / np.maximum(B, 1e-4))
        ratio -= ratio.mean(axis=1, keepdims=True)
        off = np.abs(ratio * self.metric.slope(B) * B).max(axis=1)
        other = copy(self)
        other.off, other.least = np.where(self.off > 0, off, 0), np.maximum(TINT, TIMES * _usual(off, self.facet))
        return other

    def _drawn(self, values, empty):
        """(H, W, ...) of values (M, ...) of the pixels."""
        picture = np.full((self.view.shape[0] * self.view.shape[1], *values.shape[1:]), empty, values.dtype)
        picture[self.pixel] = values
        return picture.reshape(*self.view.shape, *values.shape[1:])

    def spots(self, level=1.0):
        """[(pixels, (H, W) bool, (x, y))] of strange places that are large enough. level : how much stranger"""
        import cv2

        mask, square = self._drawn(self._strange(level).astype(np.uint8), 0), _square(self._px(NEAR))
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, square)  # edges of the model run through it
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, square)
        number, label, stats, middle = cv2.connectedComponentsWithStats(mask, connectivity=8)
        area = stats[:, cv2.CC_STAT_AREA]
        large = [k for k in range(1, number) if area[k] >= LARGE * mask.size]
        return [(int(area[k]), label == k, middle[k]) for k in large]

    def _strange(self, level=1.0):
        """(M,) bool"""
        return self.off > level * self.least

    def look_closely(self, factors):
        """What is off, anew where it is strange: with each pixel's own light of the lamps."""
        some = np.flatnonzero(self._strange())
        lamps = self._by_lamps(some, self.pixel[some], factors)
        low, high = (self.metric.value(lamps + light[some]) for light in self._indirect_nearby())
        self.off[some] = np.maximum(low - self.seen[some], self.seen[some] - high).max(axis=1)

    def _by_lamps(self, some, pixel, factors):
        """(n, C) linear: what pixels (n,) on the facets of the pixels `some` (n,) show of the lamps' own light."""
        surface = surfaces.surface(self.view.model, factors.lamps)
        p, side = surfaces.backproject(surface, self.view.camera, self.facet[some], pixel)
        emitters, normals = lamps_.emitters(surface, factors.lamps, factors.lobes), surfaces.side_normals(surface)
        direct = lamps_.direct(surface, emitters, p, normals, side, len(factors.lamps), n_samples=SAMPLES)
        return self.state.rho[self.group[some]] * (direct @ self.by_lamps)

    def _indirect_nearby(self):
        """(M, C), (M, C): the least and the most of what the lamps do not send at once, on the facet's tiles nearby."""
        import cv2

        state, tiles = self.state, self.tiles
        light = np.maximum(self.B - state.rho[tiles.group] * (tiles.direct @ self.by_lamps), 0)
        side = np.sqrt(np.diff(tiles.start))
        low, high = light[self.which], light[self.which]
        picture = self._drawn(light[self.which].astype(np.float32), 0)
        for f in np.unique(self.facet[self._strange()]):
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
        least = ALL_AROUND if several and not self.is_before_several(mine, self.owner) else HALF
        return self.may_be_thing(mine) and self.sharpness(mine) > least

    def may_be_thing(self, mine, outlined=False):
        """Neither what a mirror or a texture shows, nor most of a surface: that is its material, or its light."""
        count = np.bincount(self.owner[mine & (self.owner >= 0)], minlength=1)
        if not count.any():
            return False
        most, alone = int(count.argmax()), _is_of_one(self.owner[mine])
        rung = self.climbed.get(self._group_of(most))
        if alone and rung and not (rung == "textured" and self._is_plain_but_for(mine, most, outlined)):
            return False
        return bool(count.max() <= WHOLE * np.count_nonzero(self.owner == most))

    def is_before_several(self, mine, owner):
        """More than a little of it lies elsewhere than before one owner, or its sharp outline goes on over another.

        owner : (H, W), of the facets or of the groups
        """
        if not _is_of_one(owner[mine]):
            return True
        most = np.bincount(owner[mine & (owner >= 0)]).argmax()
        others = np.unique(self.owner[mine & (owner >= 0) & (owner != most)])
        return any(self.sharpness(mine, facet) >= ALL_AROUND for facet in others)

    def sharpness(self, mine, facet=None):
        """Share of the outline that is sharp, where it runs over a facet; 0 where none does.

        facet : by default the one that is covered most
        """
        import cv2

        if facet is None:
            facet = np.bincount(self.owner[mine & (self.owner >= 0)]).argmax()
        spot, beside = mine.astype(np.uint8), _square(1)
        rim = (cv2.dilate(spot, beside) > 0) & ~(cv2.erode(spot, beside) > 0)
        rim &= cv2.erode((self.owner == facet).astype(np.uint8), _square(2 * self._px(NEAR))) > 0
        if np.count_nonzero(rim) < self._px(OUTLINE):
            return 0.0
        near, far = (step[rim] for step in self.steps)
        return float(np.mean(near > SHARP * np.maximum(far, STRANGE)))

    def _px(self, share) -> int:
        """A length in pixels. share : of the picture's diagonal, which is at least one that NEAR needs"""
        return round(share * max(float(np.hypot(*self.view.shape)), BLUR_PX / NEAR))

    @functools.cached_property
    def steps(self):
        """(H, W), (H, W) display: how much the photograph changes within NEAR pixels to a side, and within FAR."""
        seen = self._drawn(self.seen, 0.0)
        return _step(seen, self._px(NEAR)), _step(seen, self._px(FAR))

    def outlined(self, factors):
        """[((H, W) bool, number of pixels, (x, y), closed)] of what sharp lines enclose that the model has not.

        A thing that is about as bright as what it stands before, brighter above and darker below, has no other mark.
        closed : share of the outline along such lines
        """
        import cv2

        lines, found = self._lines(factors).astype(np.uint8), []
        wide = cv2.dilate(lines, _square(self._px(FAR) // 2))
        number, label = cv2.connectedComponents(wide, connectivity=8)
        for k in range(1, number):
            points = np.argwhere((label == k) & (lines > 0))[:, ::-1]
            if len(points) < self._px(LINE) * 2 * self._px(NEAR):
                continue
            hull = cv2.fillConvexPoly(np.zeros_like(lines), cv2.convexHull(points.astype(np.int32)), 1)
            rim = (hull - cv2.erode(hull, _square(1)) > 0) & self.away
            closed = float(np.mean(wide[rim] > 0)) if rim.any() else 0.0
            mine = cv2.erode(hull, _square(self._px(NEAR)))  # lines are as wide
            if mine.sum() >= LARGE * mine.size and closed > HALF:
                found.append((mine > 0, int(mine.sum()), points.mean(axis=0), closed))
        return found

    def _lines(self, factors):
        """(H, W) bool: sharp lines of the photograph on one facet that neither edges nearby nor lamps explain."""
        near, far = self.steps
        usual = self._drawn(_usual(self._of_pixels(near), self.facet), 0.0)
        lines = (near > CLEAR * far) & (near > np.maximum(STRANGE, NOISY * usual)) & self.away
        some = np.flatnonzero(self._of_pixels(lines))
        lines[np.divmod(self.pixel[some], lines.shape[1])] = ~self._are_shadows(some, far, factors)
        return lines

    @functools.cached_property
    def away(self):
        """(H, W) bool: pixels on a facet, away from where it ends."""
        import cv2

        change = np.zeros(self.owner.shape, np.uint8)
        change[:, 1:] |= self.owner[:, 1:] != self.owner[:, :-1]
        change[1:] |= self.owner[1:] != self.owner[:-1]
        reach = self._px(max(FAR, BESIDE))
        return (cv2.dilate(change, _square(reach)) == 0) & (self.owner >= 0)

    def _are_shadows(self, some, far, factors):
        """(n,) bool: across these pixels the lamps' own light changes as the photograph does. far : (H, W)"""
        tile, most = self.which[some], np.zeros(len(some))
        own = self.state.rho[self.group[some]] * (self.tiles.direct[tile] @ self.by_lamps)
        rest = np.maximum(self.B[tile] - own, 0)
        for step in self._px(FAR) * np.array([1, self.owner.shape[1]]):  # `away` leaves so much of the facet all around
            ends = [rest + self._by_lamps(some, self.pixel[some] + sign * step, factors) for sign in (-1, 1)]
            most = np.maximum(most, np.abs(np.subtract(*map(self.metric.value, ends))).max(axis=1))
        return most > BY_SHADOW * self._of_pixels(far)[some]

    def _of_pixels(self, picture):
        """(M, ...) what a picture (H, W, ...) has at the pixels."""
        return picture.reshape(-1, *picture.shape[2:])[self.pixel]

    def _group_of(self, facet):
        return self.of_group[self.owner == facet][0]

    def thing(self, mine, pixels, middle, sharp=None) -> Thing:
        """sharp : share of its outline that is, where only that tells of it"""
        owner = self.owner[mine]
        most = np.bincount(owner[owner >= 0]).argmax()
        outlined = sharp is not None
        on_plain = _is_of_one(owner) and self._is_plain_but_for(mine, most, outlined)
        behind, alone = self.behind(mine), not self.is_before_several(mine, self.of_group)
        sharp = sharp if outlined else self.sharpness(mine)
        return Thing(pixels, tuple(middle), behind, sharp, alone, on_plain, outlined)

    def _is_plain_but_for(self, mine, facet, outlined):
        """A texture that is one patch on a plain facet may be a thing before it: one photograph does not tell.

        outlined : only its outline tells of it, as of a disc in a print: what is less strange than things counts, too
        """
        on_facet, group = self.owner == facet, self._group_of(facet)
        if self.given.get(group) or self.has_pattern[group]:
            return False
        strange = self.off > STRANGE if outlined else self._strange()
        rest = self._drawn(strange, False) & on_facet & ~mine
        return np.count_nonzero(rest) < PLAIN * np.count_nonzero(on_facet)

    def behind(self, mine):
        """The groups before which it stands."""
        groups, count = np.unique(self.of_group[mine & (self.owner >= 0)], return_counts=True)
        return groups[np.argsort(-count)].tolist()


def _is_of_one(owner):
    """Nearly all of the pixels (n,) have the same owner; -1: they have none."""
    count = np.bincount(owner[owner >= 0], minlength=1)
    return bool(count.sum() - count.max() < ELSEWHERE * count.sum())


def _square(reach):
    """What reaches so many pixels to each side."""
    return np.ones((2 * reach + 1,) * 2, np.uint8)


def _step(light, px):
    """(H, W) display: the greatest difference to a pixel of the picture so far away."""
    (H, W), steps = light.shape[:2], []
    wide = np.pad(light, ((px, px), (px, px), (0, 0)), mode="edge")
    for x, y in ((0, px), (2 * px, px), (px, 0), (px, 2 * px)):
        steps.append(np.abs(light - wide[y : y + H, x : x + W]).max(axis=2))
    return np.max(steps, axis=0)


def _usual(size, facet):
    """(M,) the median on each pixel's facet."""
    order = np.argsort(facet, kind="stable")
    ends = np.flatnonzero(np.diff(facet[order], prepend=-1, append=-1))
    usual = np.empty(len(size))
    for a, b in zip(ends[:-1], ends[1:], strict=True):
        usual[order[a:b]] = np.median(size[order[a:b]])
    return usual


def things_unlike(explained: Explained, audit: Audit, judged, names, climbed) -> list[Why]:
    """A line for each object that is unlike the rest of a group which a diffuse surface does not explain.

    By all its pixels: small things have hardly a trusted one.  judged : of Audit.misfits;  names() : of the objects
    climbed : {group: rung}, of no diffuse ones
    """
    problem = explained.problem
    textured = {g for g, rung in climbed.items() if rung == "textured"} - audit.given.keys()
    doubtful = [g for g in audit.flagged(problem, judged) if g not in climbed or g in textured]
    parts = misfits.parts(audit.subcell, problem, explained.result, audit.tiles, doubtful)
    return [
        _another_material(names()[thing], ratio, problem.groups[g], None)
        for g, of_group in parts.items()
        for thing, ratio in (of_group.painted_apart if g in textured else of_group.unlike).items()
    ]


def _another_material(name, ratio, group, nats):
    shown_ratio = ", ".join(f"{max(v, 0):.2f}" for v in ratio)
    text = f"object {name!r} reflects {shown_ratio} times what the rest of group {group!r}: another material"
    return Why("group_wrong", name, text, nats)


def groups_wrong(problem: Problem, result: Result, names, climbed=()) -> list[Why]:
    """A line for each object that has not its group's reflectance. names() : of the objects"""
    return [
        _another_material(names()[one.thing], one.ratio, problem.groups[one.group], one.nats)
        for one in one_object.objects(problem, result, climbed)
        if one.nats >= enough(problem)
    ]


def unlike_in_audit(found: Explained, audit: Audit) -> one_object.Unlike | None:
    """The object most unlike the rest of its group by its own pixels: few of them, or none, may be trusted, but what it
    throws on others bends the whole fit."""
    problem = found.problem
    among = [g for g in range(len(problem.groups)) if g not in problem.known_groups and g not in audit.given]
    parts = misfits.parts(audit.subcell, problem, found.result, audit.tiles, among)
    seen = [
        one_object.Unlike(g, thing, ratio, 0.0)
        for g, of_group in parts.items()
        for thing, ratio in of_group.unlike.items()
    ]
    return max(seen, key=lambda one: np.abs(one.ratio - 1).max(), default=None)


def alone_unlike(found: Explained, audit: Audit, patch_object, names, **options) -> list[Why]:
    """A line for the object whose own reflectance, however near to its group's, leaves nothing to explain: neither in
    the fit nor, of diffuse surfaces, in the audit.

    patch_object : () -> (N,) numbers;  names() : of the objects;  options : of gauss_newton.gauss_newton
    """
    problem, result = found.problem, found.result
    one = max(one_object.objects(problem, result, slightly=True), key=lambda one: one.nats, default=None)
    if one is not None and one.nats >= BY_FAR * enough(problem):
        return _alone(found, audit, one, patch_object, names, **options)
    one = unlike_in_audit(found, audit)
    if one is None:
        return []
    is_fitted = bool(((problem.tile_group == one.group) & (problem.tile_object == one.thing)).any())
    return _alone(found, audit, one, patch_object, names, is_fitted, **options)


def _alone(found, audit, one, patch_object, names, is_fitted=True, **options) -> list[Why]:
    """is_fitted : the fit finds the reflectance; else it is as the audit's pixels show it"""
    problem, state = found.problem, found.result.state
    own, number = one_object.with_its_own(problem, one, patch_object()), len(problem.groups)
    audit = audit.with_group(one.group, one.thing, number)
    start = Unknowns(np.vstack([state.rho, one.ratio * state.rho[one.group]]), state.E, state.transfer)
    if is_fitted:
        other, _ = fit(own, start=start, **options)
    else:
        own, other = _as_shown(own, start, audit, **options)
    left = found.result.correlated * LEFT
    if not other.fits or other.correlated > max(DOUBT, left) or audit.flagged(own, audit.misfits(own, other)):
        return []
    ratio = other.state.rho[number] / np.maximum(other.state.rho[one.group], 1e-9)
    gain = evidence(own, other.at).nats - evidence(problem, found.result.at).nats
    return [_another_material(names()[one.thing], ratio, problem.groups[one.group], float(gain))]


def _as_shown(problem, start, audit, **options):
    """(problem, Result) where the last group has no trusted tile, and the reflectance that the audit's pixels show.

    The second time with the light that the first found.
    """
    rho = start.rho
    for _ in range(2):
        rho[-1] = np.clip(rho[-1], 0, WHITE)
        known = replace(problem, rho=np.vstack([problem.rho[:-1], rho[-1:]]))
        found, _ = fit(known, start=Unknowns(rho, start.E, start.transfer), **options)
        start = found.state
        rho = start.rho.copy()
        rho[-1] *= misfits.ratio_of(audit.subcell, known, found, audit.tiles, len(problem.groups) - 1)
    return known, found
