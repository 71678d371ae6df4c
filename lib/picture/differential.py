"""A photograph with a change: photograph + (with - without), in linear light (Debevec 1998, differential rendering).

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

from lib.picture import indirect, pixel_light, rendering
from lib.picture.lighting import lighting
from lib.picture.leaves import interpolated
from lib.picture.pixels import Pixels, pixels
from lib.picture.ray_light import gathered_light
from lib.picture.subject import Quality, Subject

SLIGHT = 0.03  # change of light, as a share, below which what lies beside it does not matter
MORE = 4  # times the rays of other light, for the difference: it is small, and its places are few
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
    # light by lamps and other light, as pictures, before and after
    shape = (*same.shape, recovered.channels)
    direct, between = [np.zeros(shape), np.zeros(shape)], [np.zeros(shape), np.zeros(shape)]
    altered = _altered(recovered, changed)
    places = 0
    for which, difference in ((same & ~altered, True), (same & altered, False)):
        seen = pixels(changed.surface, camera, np.where(which, changed.facet, -1))
        with timing("direct"):
            by_lamps = [_direct(s, of, seen, quality) for s, of in zip(subjects, lit, strict=True)]
        with timing("indirect"):
            leaves = _both(subjects, lit, seen, by_lamps, quality, difference)
            light = np.split(interpolated(leaves, seen), 2, axis=1)
        places += len(leaves)
        for k in range(2):
            direct[k][seen.y, seen.x], between[k][seen.y, seen.x] = by_lamps[k], light[k]
    # what is seen only before, in pixels that still show some of it, and only after
    new = new_share(recovered, changed)
    there = (np.where(same | (new < 1), recovered.facet, -1), changed.facet)
    own = {"n_rays": quality.n_rays, "contact": quality.contact, "tolerance": quality.tolerance}
    for k, (subject, of) in enumerate(zip(subjects, lit, strict=True)):
        seen = pixels(subject.surface, camera, np.where(same, -1, there[k]))
        with timing("direct"):
            by_lamps = _direct(subject, of, seen, quality)
        with timing("indirect"):
            leaves = indirect.gather(subject.surface, of.shown, of.lamps, of.E, seen, by_lamps, **own)
            direct[k][seen.y, seen.x], between[k][seen.y, seen.x] = by_lamps, interpolated(leaves, seen)
        places += len(leaves)
    pictures = []
    for k, subject in enumerate(subjects):
        subject = replace(subject, view=replace(subject.view, facet=there[k]))
        seen = pixels(subject.surface, camera, there[k])
        at = seen.y, seen.x
        made = rendering.finished(subject, lit[k], quality, seen, direct[k][at], between[k][at], timing=timing)
        pictures.append(subject.through_lens(made.linear))
    facts = {"places": places, "pixels_of_another_facet": int((~same).sum())}
    return Pair(*pictures, new[..., None], facts)


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
    a, b = recovered.appearance, changed.appearance
    shown = np.unique(recovered.facet[recovered.facet >= 0])
    groups = recovered.surface.group[shown]
    differs = (a.rho[groups] != b.rho[groups]).any(axis=1)
    kinds = [_finishes(look) for look in (a, b)]
    differs |= np.array([kinds[0].get(g) != kinds[1].get(g) for g in groups], bool)
    differs |= np.array([a.maps.get(f) is not b.maps.get(f) for f in shown], bool)
    if changed.curved is not None:
        differs |= changed.curved.has(shown)
    return np.isin(recovered.facet, shown[differs])


def _finishes(look):
    """{group: how it reflects beyond rho}."""
    if look.finish is None:
        return {}
    f = look.finish
    rows = zip(f.groups, f.kind, f.alpha.tolist(), f.tangent.tolist(), look.rho_s.tolist(), strict=True)
    return {g: (kind, alpha, tangent, rho) for g, kind, alpha, tangent, rho in rows}


def _direct(subject, lit, seen: Pixels, quality):
    """(M, C) irradiance by the lamps."""
    how = {"many": quality.shadow_rays, "steady": True}
    factor, _ = pixel_light.direct(subject.surface, lit.lamps, len(lit.E), seen, subject.view.camera, **how)
    return factor @ lit.E


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
    how = {"n_rays": rays, "contact": quality.contact, "tolerance": quality.tolerance}
    if difference:
        how |= {"tolerance": FINE * quality.tolerance, "judged": lambda both: both[:, C:] - both[:, :C]}
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
    """(H, W) share of each pixel that shows another facet than before."""
    before, after = (shares(s) for s in (recovered, changed))
    new = 1 - np.asarray(before.minimum(after).sum(axis=1)).ravel()
    return np.where(new > 1e-9, np.minimum(new, 1), 0).reshape(recovered.facet.shape)


def shares(subject: Subject):
    """(H W, F + 1) sparse: the share of each pixel that shows each facet, the last nothing."""
    from scipy.sparse import csr_array

    pieces, facet = subject.coverage, subject.facet.reshape(-1)
    pixel = np.asarray(pieces["pixel"], np.int64)
    number = np.diff(pieces["start"])
    pure = np.ones(len(facet), bool)
    pure[pixel] = False
    last = 1 << 30
    count = np.asarray(pieces["count"], float) / 64
    covered = np.bincount(np.repeat(np.arange(len(pixel)), number), count, len(pixel))
    rows = np.concatenate([np.flatnonzero(pure), np.repeat(pixel, number), pixel])
    columns = np.concatenate([np.where(facet[pure] < 0, last, facet[pure]), pieces["facet"], np.full(len(pixel), last)])
    values = np.concatenate([np.ones(pure.sum()), count, 1 - covered])
    return csr_array((values, (rows, columns)), shape=(len(facet), last + 1))


# ---- with the photograph ----


def composed(photograph, pair: Pair, transfer):
    """The photograph with the change: (H, W, C) linear, and (H, W) bool, where nothing is to be seen of a change.

    photograph : lib.given.image.Photograph;  transfer : Transfer of the light alone
    Where the photograph is saturated its light is the rendering's, if that exceeds 1. What T takes to less than half a
    step of the photograph is no change.
    """
    values = photograph.values
    light = values if photograph.linear else _light_of(values, pair.before, transfer)
    out = np.maximum(pair.after + (1 - pair.new) * (light - pair.before), 0)
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
