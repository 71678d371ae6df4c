"""A photograph with a change: photograph + (with - without), in linear light (Debevec 1998, differential rendering).

What the photograph has beyond its rendering (grain, a stain, an edge half a pixel aside) is paint that the light falls
on: where the light becomes less, that becomes less with it. Where it becomes more it stays, since noise would grow.

    pair = renderings(recovered, changed, quality)
    linear, copied = composed(photograph, pair, transfer)

Both scenes are rendered with the same rays at the same pixels, so that what does not change cancels to the last bit.
Where both show the same facet of the same reflectance, only the difference of their light is sought, on leaves as wide
as it allows. Where a pixel shows something else than before, the rendering itself stands for the photograph.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np

from lib.picture import indirect, pixel_light, reflections, rendering
from lib.picture.leaves import interpolated
from lib.picture.lighting import lighting
from lib.picture.pixels import Pixels, pixels
from lib.picture.ray_light import gathered_light
from lib.picture.subject import Quality, Subject

NEAR = 1e-5  # local: two places that mirrors show are the same
SLIGHT = 0.03  # change of light, as a share, below which what lies beside it does not matter
MUCH = 0.03  # change of all light, as a share, from which on a difference is no less than the light itself
MORE = 4  # times the rays of other light, for the difference: it is small, and its places are few
VISIBLE = 0.003  # noise of a group's display values, rms, from which on its blotches are seen
FINE = 0.3  # of the tolerance of other light: that of the difference


@dataclass(frozen=True, eq=False)
class Pair:
    """before, after : (H, W, C) linear, through the lens;  new : (H, W, 1) share of the pixel that shows something else
    before is of no meaning where new is 1
    """

    before: np.ndarray
    after: np.ndarray
    new: np.ndarray
    facts: dict


def renderings(recovered: Subject, changed: Subject, quality: Quality, *, timing=None) -> Pair:
    """Of one camera."""
    timing = timing or (lambda label: contextlib.nullcontext())
    quality, changed = replace(quality, steady=True), as_drawn(recovered, changed)
    lit = [_light(recovered, quality, timing)]
    lit.append(_light(changed, replace(quality, step=lit[0].shown.step), timing))
    subjects = (recovered, changed)
    camera = recovered.view.camera
    same = _same(recovered.facet, changed.facet)
    new = np.where(_other_lamps(recovered, changed), 1, new_share(recovered, changed))
    # what is seen only before counts in pixels that still show some of it
    there = (np.where(same | (new < 1), recovered.facet, -1), changed.facet)
    subjects = [replace(s, view=replace(s.view, facet=facet)) for s, facet in zip(subjects, there, strict=True)]
    seen = [lambda which, s=s: pixels(s.surface, camera, np.where(which, s.facet, -1)) for s in subjects]
    makers = _Makers(subjects, lit, quality, timing)
    lights = makers.lights(seen, same, _altered(recovered, changed))
    virtual = makers.of_mirrors() if all(len(reflections.mirrors(s)) for s in subjects) else (None, None)
    pictures = []
    for subject, of, light, mirrored, whole in zip(subjects, lit, lights, virtual, seen, strict=True):
        every = whole(np.ones(same.shape, bool))
        made = rendering.finished(subject, of, quality, every, *light(every), timing=timing, virtual=mirrored)
        pictures.append(subject.through_lens(made.linear))
    facts = {"places": makers.places, "pixels_of_another_facet": int((~same).sum())}
    facts["noise"] = makers.noisy(pictures[1])
    facts["residual"] = max(of.light.residual for of in lit)
    return Pair(*pictures, new[..., None], facts)


class _Makers:
    """The irradiance of the pixels of both scenes, by the same rays where they show the same.

    places : at which other light was gathered
    """

    def __init__(self, subjects, lit, quality, timing):
        self.subjects, self.lit, self.quality, self.timing = subjects, lit, quality, timing
        self.shape = (*subjects[0].facet.shape, subjects[0].channels)
        self.places = 0
        self.noise = np.zeros(self.shape[:2])
        self.slight = _change(*lit) < MUCH

    def lights(self, seen, same, altered, mirrored=False):
        """For each scene: Pixels -> irradiance (M, C) by lamps, and by other surfaces.

        seen : for each scene, (H, W) bool -> the Pixels of these pixels;  same, altered : (H, W) bool
        mirrored : the pixels are those of a virtual picture
        """
        direct, between = ([np.zeros(self.shape), np.zeros(self.shape)] for _ in range(2))
        for which, difference in ((same & ~altered, True), (same & altered, False)):
            those = seen[1](which)
            with self.timing("direct"):
                by_lamps = self._direct_of_both(those, mirrored)
            with self.timing("indirect"):
                leaves = _both(self.subjects, self.lit, those, by_lamps, self.quality, difference and self.slight)
                light = np.split(interpolated(leaves, those), 2, axis=1)
            self._count(leaves, those, mirrored)
            for k in range(2):
                direct[k][those.y, those.x], between[k][those.y, those.x] = by_lamps[k], light[k]
        own = {"n_rays": self.quality.n_rays, "contact": self.quality.contact, "tolerance": self.quality.tolerance}
        for k, (subject, of) in enumerate(zip(self.subjects, self.lit, strict=True)):
            those = seen[k](~same)
            with self.timing("direct"):
                by_lamps = self._factors(k, those, mirrored) @ of.E
            with self.timing("indirect"):
                leaves = indirect.gather(subject.surface, of.shown, of.lamps, of.E, those, by_lamps, **own)
                direct[k][those.y, those.x], between[k][those.y, those.x] = by_lamps, interpolated(leaves, those)
            self._count(leaves, those, mirrored or k == 0)
        at = lambda k: lambda those: (direct[k][those.y, those.x], between[k][those.y, those.x])
        return at(0), at(1)

    def _count(self, leaves, seen: Pixels, elsewhere):
        """The leaves, and their noise in the picture unless it is not seen there."""
        self.places += len(leaves)
        if not elsewhere:
            number = leaves.last - leaves.first
            at = np.repeat(leaves.first, number) + _counting(number)
            self.noise[seen.y[at], seen.x[at]] = np.repeat(leaves.noise, number)

    def noisy(self, after):
        """{group: rms of the display values' noise by other surfaces' light, over its pixels}. after : (H, W, C)"""
        subject, facet = self.subjects[1], self.subjects[1].facet
        rho = np.append(self.lit[1].shown.rho.mean(axis=1), 0)[np.maximum(facet, -1)]
        light = after.mean(axis=2)
        more = [subject.show((light + sign * rho * self.noise)[..., None]) for sign in (-1, 1)]
        error = (more[1] - more[0])[..., 0] / 2
        group = np.where(facet >= 0, subject.surface.group[facet], len(subject.groups))
        squares = np.bincount(group.ravel(), (error**2).ravel(), len(subject.groups) + 1)
        number = np.bincount(group.ravel(), minlength=len(squares))
        noise = np.sqrt(squares / np.maximum(number, 1))
        return {name: float(noise[g]) for g, name in enumerate(subject.groups) if number[g]}

    def of_mirrors(self):
        """The same of what mirrors show."""
        mirror = [reflections.mirrors(s) for s in self.subjects]
        views = [reflections.mirror_view(*each) for each in zip(self.subjects, self.lit, mirror, strict=True)]
        pictures = [_virtual(self.shape, *each) for each in zip(mirror, views, strict=True)]
        (facet, p), (facet_too, p_too) = pictures
        same = (facet == facet_too) & (facet >= 0) & (np.abs(p - p_too).max(axis=2) < NEAR)
        altered = np.isin(facet, np.flatnonzero(_differs(*self.subjects)))

        def those(k):
            subject = self.subjects[k]
            return lambda which: reflections.virtual_pixels(subject, mirror[k], views[k], which.reshape(-1)[mirror[k]])

        return self.lights([those(0), those(1)], same, altered, mirrored=True)

    def _direct_of_both(self, seen: Pixels, mirrored):
        """For each scene (M, C) irradiance by the lamps. Where neither they nor what casts shadows has changed, the
        factors are the same."""
        before, after = self.lit
        factor = self._factors(0, seen, mirrored)
        unmoved = self.subjects[0].surface is self.subjects[1].surface
        alike = unmoved and before.ways is None and after.ways is None and np.array_equal(before.lobes, after.lobes)
        return [factor @ before.E, (factor if alike else self._factors(1, seen, mirrored)) @ after.E]

    def _factors(self, k, seen: Pixels, mirrored):
        """(M, L) factors to the lamps of one scene."""
        subject, of = self.subjects[k], self.lit[k]
        camera = None if mirrored else subject.view.camera
        how = {"many": self.quality.shadow_rays, "steady": True}
        return pixel_light.direct(subject.surface, of.lamps, len(of.E), seen, camera, **how)[0]


def _change(before, after):
    """By which share the light changes, the mean over the places that rays see before the change."""
    light = before.shown.irradiance.sum(axis=1)
    now = after.shown.irradiance[: len(light)].sum(axis=1)
    return float(np.abs(now - light).sum() / max(light.sum(), 1e-300))


def _virtual(shape, mirror, view):
    """(H, W) facets that mirrors show, -1, and (H, W, 3) where, local."""
    facet, p = np.full(shape[:2], -1), np.zeros((*shape[:2], 3))
    facet.reshape(-1)[mirror], p.reshape(-1, 3)[mirror] = view.facet, view.p
    return facet, p


def _same(before, after):
    """(H, W) bool: pixels whose centre shows the same facet."""
    return (before == after) & (before >= 0)


def _light(subject, quality, timing):
    transport = subject.traced and subject.traced.transport
    how = {"n_texels": quality.n_texels, "step": quality.step or _step(subject, quality), "timing": timing}
    return lighting(subject.surface, subject.factors, subject.appearance, transport=transport, **how)


def _step(subject, quality):
    """The width of a texel where there are n_texels of them; as of texels.light_map."""
    size = subject.surface.size[np.unique(subject.factors.mesh.side) // 2]
    return float(np.sqrt(max(size.prod(axis=1).sum(), 1e-300) / quality.n_texels))


def _altered(recovered, changed):
    """(H, W) bool: pixels of facets that reflect otherwise than before."""
    return np.isin(recovered.facet, np.flatnonzero(_differs(recovered, changed)))


def _differs(recovered, changed):
    """(F,) bool: facets of the model as it was that reflect otherwise than before."""
    a, b = recovered.appearance, changed.appearance
    groups = recovered.surface.group[: recovered.view.model.n_facets]
    return (a.rho[groups] != b.rho[groups]).any(axis=1) | _looks_other(recovered, changed)


def _looks_other(recovered, changed):
    """(F,) bool: facets of the model as it was that have another finish or texture than before.

    What the photograph has beyond the rendering of a mirror or of a texture says nothing of what took its place.
    """
    a, b = recovered.appearance, changed.appearance
    shown = np.arange(recovered.view.model.n_facets)
    kinds = [_finishes(look) for look in (a, b)]
    differs = np.array([kinds[0].get(g) != kinds[1].get(g) for g in recovered.surface.group[shown]], bool)
    differs |= np.array([a.maps.get(f) is not b.maps.get(f) for f in shown], bool)
    return differs if changed.curved is None else differs | changed.curved.has(shown)


def _finishes(look):
    """{group: how it reflects beyond rho}."""
    if look.finish is None:
        return {}
    f = look.finish
    rows = zip(f.groups, f.kind, f.alpha.tolist(), f.tangent.tolist(), look.rho_s.tolist(), strict=True)
    return {g: (kind, alpha, tangent, rho) for g, kind, alpha, tangent, rho in rows}


def _both(subjects, lit, seen: Pixels, by_lamps, quality, difference):
    """Leaves with the light of both scenes, (K, 2 C), by the same rays.

    difference : only what is different must be foretold
    """
    C = subjects[0].channels

    def look(first, last, n_rays, seed):
        side = seen.side[first]
        found = [
            gathered_light(s.surface, of.shown, of.lamps, of.E, seen.p, first, last, side, n_rays, seed)
            for s, of in zip(subjects, lit, strict=True)
        ]
        (light, half, distance), (light_too, half_too, distance_too) = found
        distance = np.minimum(distance, distance_too)
        if difference:
            half, half_too = half_too - half, np.zeros_like(half)
            change = np.abs(light_too - light).max(axis=1)
            distance = np.where(change > SLIGHT * light.max(axis=1), distance, np.inf)
        return np.hstack([light, light_too]), np.hstack([half, half_too]), distance

    rho = np.maximum(*(of.shown.rho[: len(subjects[0].surface.normal)] for of in lit))
    brightness = np.mean([values.mean(axis=1) for values in by_lamps], axis=0)
    rays = MORE * quality.n_rays if difference else quality.n_rays
    apart = lambda both: both[:, C:] - both[:, :C]
    how = {"n_rays": rays, "contact": quality.contact, "tolerance": quality.tolerance, "told": apart}
    if difference:
        how |= {"tolerance": FINE * quality.tolerance, "judged": apart}
    return indirect.gather_by(look, rho, seen, brightness, **how)


def as_drawn(recovered: Subject, changed: Subject) -> Subject:
    """The changed scene, drawn as before where it shows nothing else.

    A place that an edge just touches may go to either side of it when a scene is drawn with more in it.
    """
    if changed.surface is recovered.surface:
        return changed
    subjects = (recovered, changed)
    there = [np.unique(s.surface.facet[s.surface.group[s.surface.facet] >= 0]) for s in subjects]
    touched = np.zeros(recovered.facet.size, bool)
    for s, other in zip(subjects, there[::-1], strict=True):
        strange = np.append(~np.isin(np.arange(s.view.model.n_facets), other), False)  # the last is nothing
        touched |= strange[s.facet.reshape(-1)]
        pixel = np.repeat(np.asarray(s.coverage["pixel"], np.int64), np.diff(s.coverage["start"]))
        touched[pixel[strange[s.coverage["facet"]]]] = True
    facet = np.where(touched.reshape(recovered.facet.shape), changed.facet, recovered.facet)
    pieces = [_only(s.coverage, touched if s is changed else ~touched) for s in subjects]
    pixel = np.concatenate([p["pixel"] for p in pieces])
    order = np.argsort(pixel, kind="stable")
    number = np.concatenate([np.diff(p["start"]) for p in pieces])
    first = np.cumsum(number) - number
    of = np.repeat(first[order], number[order]) + _counting(number[order])
    whole = {key: np.concatenate([p[key] for p in pieces])[of] for key in ("facet", "count")}
    whole |= {"pixel": pixel[order], "start": np.append(0, np.cumsum(number[order])).astype(np.int32)}
    return replace(changed, view=replace(changed.view, facet=facet), coverage=whole)


def _counting(number):
    """0 ... n - 1 for each n of `number`, one after the other."""
    return np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)


def _only(pieces, which):
    """The A-buffer of the pixels of which `which` (H W,) is set."""
    keep = which[np.asarray(pieces["pixel"], np.int64)]
    number = np.diff(pieces["start"])
    of = np.repeat(keep, number)
    start = np.append(0, np.cumsum(number[keep])).astype(np.int32)
    whole = {key: np.asarray(pieces[key])[of] for key in ("facet", "count")}
    return whole | {"pixel": np.asarray(pieces["pixel"])[keep], "start": start}


def new_share(recovered: Subject, changed: Subject):
    """(H, W) share of each pixel that shows another facet than before, or one of another finish or texture."""
    n = max(s.view.model.n_facets for s in (recovered, changed))
    before, after = (shares(s, n) for s in (recovered, changed))
    both = before.minimum(after)
    other = np.flatnonzero(_looks_other(recovered, changed))
    new = 1 - np.asarray(both.sum(axis=1)).ravel() + np.asarray(both[:, other].sum(axis=1)).ravel()
    return np.where(new > 1e-9, np.minimum(new, 1), 0).reshape(recovered.facet.shape)


def _other_lamps(recovered: Subject, changed: Subject):
    """(H, W) bool: pixels that show, or touch some that show, a lamp which emits otherwise now, or is gone.

    How much of the lamp they show is known to a 64th, and it is brighter than all else: what the photograph has beyond
    the rendering is that error times the emittance, no light of the scene.
    """
    from scipy.ndimage import binary_dilation

    before, after = (_emitted(s, len(recovered.surface.group)) for s in (recovered, changed))
    other = np.flatnonzero((before != after).any(axis=1))
    if not len(other):
        return np.zeros(recovered.facet.shape, bool)
    some = (shares(recovered, recovered.view.model.n_facets)[:, other].sum(axis=1) > 0).reshape(recovered.facet.shape)
    return binary_dilation(some, np.ones((3, 3)))


def _emitted(subject: Subject, n):
    """(n, C) emittances of the first n facets, 0 of those that are not there."""
    surface, out = subject.surface, np.zeros((n, subject.channels))
    there = np.isin(np.arange(n), surface.facet)
    for k, name in enumerate(subject.factors.lamps):
        if name in surface.groups:
            out[there & (surface.group[:n] == surface.groups.index(name))] = subject.appearance.E[k]
    return out


def shares(subject: Subject, last):
    """(H W, last + 1) sparse: the share of each pixel that shows each facet; the column `last`: nothing.

    No wider than it must be: to pick some columns costs memory for all of them.
    """
    from scipy.sparse import csr_array

    pieces, facet = subject.coverage, subject.facet.reshape(-1)
    pixel = np.asarray(pieces["pixel"], np.int64)
    number = np.diff(pieces["start"])
    pure = np.ones(len(facet), bool)
    pure[pixel] = False
    count = np.asarray(pieces["count"], float) / 64
    covered = np.bincount(np.repeat(np.arange(len(pixel)), number), count, len(pixel))
    rows = np.concatenate([np.flatnonzero(pure), np.repeat(pixel, number), pixel])
    columns = np.concatenate([np.where(facet[pure] < 0, last, facet[pure]), pieces["facet"], np.full(len(pixel), last)])
    values = np.concatenate([np.ones(pure.sum()), count, 1 - covered])
    return csr_array((values, (rows, columns)), shape=(len(facet), last + 1))


def mottled(noise):
    """The groups whose noise is to be seen, the worst first. noise : {group: rms of display values}

    >>> mottled({"wall": 0.01, "floor": 0.001, "door": 0.02})
    ['door', 'wall']
    """
    return sorted((g for g, value in noise.items() if value > VISIBLE), key=lambda g: -noise[g])


# ---- with the photograph ----


def composed(photograph, pair: Pair, transfer):
    """The photograph with the change: (H, W, C) linear, and (H, W) bool, where nothing is to be seen of a change.

    photograph : lib.given.image.Photograph;  transfer : Transfer of the light alone
    Where the photograph is saturated its light is the rendering's, if that exceeds 1. What T takes to less than half a
    step of the photograph is no change.
    """
    values = photograph.values
    light = values if photograph.linear else _light_of(values, pair.before, transfer)
    kept = np.where(pair.after < pair.before, pair.after / np.maximum(pair.before, 1e-300), 1)
    out = np.maximum(pair.after + (1 - pair.new) * kept * (light - pair.before), 0)
    if photograph.linear:
        return out, (out == light).all(axis=2)
    step = 1 / (65535 if photograph.bits == 16 else 255)
    still = (np.abs(shown(out, transfer) - shown(light, transfer)) < step / 2).all(axis=2)
    return np.where(still[..., None], light, out), still


def _light_of(values, rendered, transfer):
    """T^-1 of display values; the rendering's light where they are saturated and it exceeds that."""
    light = transfer.linear(values)
    return np.where(values >= 1, np.maximum(light, rendered), light)


def shown(light, transfer):
    """T of linear light, in [0, 1]."""
    return np.clip(transfer.display(light), 0, 1)
