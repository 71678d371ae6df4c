"""What can be told of a scene before anything runs: where the camera stands, units, lamps, openings, the photograph.

Every finding is one line; a doubt also names the way out. Nothing is changed.
"""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from lib.given import jpeg
from lib.given.edges_file import Edges
from lib.planning import progress

RAYS = 400  # from the camera all around
TRIES = 8_000_000  # pairs of rays and triangles that a second allows
NEAR_M = 0.05  # a lamp whose front looks at something nearer than that shines into it
LARGE_M, SMALL_M = 100.0, 0.3  # sizes of a model that is hardly in metres
LOW_M = 1.5  # least side of a box that a camera stands in, below which it is hardly a room
TINY_PX = 500  # pixels of a group below which its values are loose
CLIPPED = 0.01  # share of pixels worth a word
FLAT = 0.25  # of the range that a photograph should use
FEW_LAMPS, FEW_FACETS = 1, 200  # of a room of boxes; beyond them each lamp and each facet costs, in CPU s:
S_PER_LAMP, S_PER_FACET = 6.0, 0.008
GB_BASE, GB_PER_MP, MUCH_GB = 0.7, 0.5, 4.0  # peak of render; what is worth a word


class Finding(NamedTuple):
    """doubt : something to look at before a long run"""

    about: str
    text: str
    doubt: bool = False


def findings(model, camera, photograph, facet, lamps=(), up="z", turned=1) -> list[Finding]:
    """In the order in which one would look.

    facet : (H, W) int32 of the index buffer, -1 = nothing;  lamps : names of groups;  up : as in scene.yaml
    turned : EXIF's orientation of the photograph
    """
    return [
        *_size(model, camera),
        *_camera(model, camera),
        *_up(camera, up),
        *_sight(model, facet, lamps),
        *_lamps(model, lamps),
        *_openings(model, camera),
        *of_photograph(photograph, turned, _lamp_pixels(model, facet, lamps)),
        cost(photograph.values.shape, facets=model.n_facets, lamps=len(lamps)),
    ]


def _size(model, camera):
    low, size = _box(model)
    within = ((camera.centre >= low) & (camera.centre <= low + size)).all()
    text = f"the model is {' x '.join(f'{s:.3g}' for s in size)} m, {model.n_facets} facets, {len(model.groups)} groups"
    longest = size.max()
    if longest > LARGE_M:
        unit = "mm" if longest > 1000 else "cm"
        yield Finding("units", f"{text}: if that is too large, write model: {{unit: {unit}}} in scene.yaml", True)
    elif longest < SMALL_M:
        yield Finding("units", f"{text}: if that is too small, write model: {{unit: ft}} or what it was drawn in", True)
    elif within and size.min() < LOW_M:
        yield Finding(
            "units", f"{text}: if nobody could stand in it, write model: {{unit: in}} or what it was drawn in", True
        )
    else:
        yield Finding("units", text)


def _box(model):
    """Least corner and size of the model's box, m."""
    p = model.vertices[np.unique(model.triangles)]
    return p.min(axis=0), np.ptp(p, axis=0)


def _camera(model, camera):
    low, size = _box(model)
    inside = ((camera.centre >= low) & (camera.centre <= low + size)).all()
    where = "inside" if inside else "outside"
    hfov = 2 * np.degrees(np.arctan(camera.width / 2 / camera.K[0, 0]))
    place = ", ".join(f"{x:.2f}" for x in camera.centre)
    yield Finding("camera", f"it stands at ({place}) m, {where} the model's box, and sees {hfov:.0f} degrees across")
    if not 15 < hfov < 120:
        yield Finding("camera", f"{hfov:.0f} degrees across is rare for a photograph: is the focal length in px?", True)


def _up(camera, up):
    """Which axis of the model points up in the picture."""
    upwards = -camera.T_cam_world[1, :3]
    axis = int(np.abs(upwards).argmax())
    found = ("-" if upwards[axis] < 0 else "") + "xyz"[axis]
    angle = np.degrees(np.arccos(min(1.0, abs(upwards[axis]))))
    text = f"{found} of the model is up in the picture, {angle:.0f} degrees off"
    if found != up:
        yield Finding("up axis", f"{text}: write model: {{up: {found}}} in scene.yaml if that is right", True)
    else:
        yield Finding("up axis", text)


def _sight(model, facet, lamps):
    """Groups that few pixels show, or none."""
    shown = facet[facet >= 0]
    group = np.bincount(model.facet_group[shown], minlength=len(model.groups))
    covered = shown.size / facet.size
    yield Finding("picture", f"{covered:.0%} of the pixels show the model", covered < 0.5)
    tiny = [f"{name} ({n} px)" for name, n in zip(model.groups, group, strict=True) if 0 < n < TINY_PX]
    if tiny:
        yield Finding("groups", f"small in the picture, their values will be loose: {_listed(tiny)}", True)
    unseen = [name for name, n in zip(model.groups, group, strict=True) if n == 0 and name not in lamps]
    if unseen:
        yield Finding("groups", f"not in the picture, their reflectances are assumed: {_listed(unseen)}")


def _lamps(model, lamps):
    there = [name for name in lamps if name in model.groups]
    for name in there:
        yield from _lamp(model, name, max(1, TRIES // (2 * len(model.triangles) * len(there))))


def _lamp(model, name, most):
    """most : facets of the lamp that are looked at, the largest of many"""
    largest = model.largest_triangles(np.flatnonzero(model.facet_group == model.groups.index(name)))
    facets, area = model.triangle_facet[largest], model.facet_area()
    text = f"{name}: {len(facets)} facets, {area[facets].sum():.3g} m2"
    chosen = np.sort(np.argsort(-area[facets], kind="stable")[:most])
    middles = model.corners()[largest[chosen]].mean(axis=1)
    blocked = total = 0.0
    met = set()
    for facet, middle in zip(facets[chosen], middles, strict=True):
        n = model.facet_normal[facet]
        front, back = (_first(model, middle, side * n, facet) for side in (1, -1))
        total += area[facet]
        if front[0] < NEAR_M and back[0] > 2 * front[0]:
            blocked += area[facet]
            met.add(model.groups[model.facet_group[front[1]]])
    if blocked > 0.5 * total:
        why = f"its front looks at {_listed(sorted(met))} within {100 * NEAR_M:.0f} cm: turn its faces round"
        yield Finding("lamps", f"{text}: {why}", True)
    else:
        yield Finding("lamps", f"{text}, its front is free")


def _openings(model, camera):
    """How much of what is around the camera the model leaves open: there it is black."""
    n = min(RAYS, TRIES // max(1, len(model.triangles)))
    if n < 50:
        return
    k = np.arange(n) + 0.5
    z, angle = 1 - 2 * k / n, np.pi * (1 + 5**0.5) * k
    v = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], 1)
    lost = np.array([not np.isfinite(_first(model, camera.centre, ray)[0]) for ray in v])
    share = lost.mean()
    if share == 0:
        yield Finding("openings", "the model closes around the camera")
        return
    mean = v[lost].mean(axis=0)
    axis = int(np.abs(mean).argmax())
    where = ("-" if mean[axis] < 0 else "+") + "xyz"[axis]
    text = (
        f"{share:.0%} of the directions around the camera leave the model, most towards {where}: black in the analysis"
    )
    low, size = _box(model)
    away = float(np.linalg.norm(camera.centre - np.clip(camera.centre, low, low + size)))
    way = ": draw the walls, floor and ceiling behind the camera too"
    if away > np.linalg.norm(size):
        way = f": it stands {away:.3g} m away from a model of {size.max():.3g} m, so unit, up or pose are not as told"
    yield Finding("openings", text + (way if share > 0.1 else ""), share > 0.1)


def _first(model, origin, direction, but=-1):
    """(distance, facet) of the first triangle that a ray meets, (inf, -1) where it meets none; not of facet `but`."""
    p = model.corners() - origin
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("ti,ti->t", n, p[:, 0]) / (n @ direction)
    kept = np.flatnonzero((t > 0) & np.isfinite(t) & (model.triangle_facet != but))
    hit, slack = t[kept, None] * direction, 1e-9 * np.abs(p).max(initial=0.0)
    meets = ((p[kept].min(axis=1) <= hit + slack) & (hit - slack <= p[kept].max(axis=1))).all(axis=1)  # its box
    kept, hit = kept[meets], hit[meets]
    p, n, t = p[kept], n[kept], t[kept]
    sides = [np.einsum("ti,ti->t", np.cross(p[:, (k + 1) % 3] - p[:, k], hit - p[:, k]), n) for k in range(3)]
    t = np.where(np.min(sides, axis=0) >= 0, t, np.inf)
    if not np.isfinite(t).any():
        return np.inf, -1
    return float(t.min()), int(model.triangle_facet[kept[t.argmin()]])


def _lamp_pixels(model, facet, lamps):
    """(H, W) bool: pixels that show a lamp, and may be white."""
    of = np.array([group in lamps for group in model.groups])[model.facet_group]
    return (facet >= 0) & of[facet]


def of_photograph(photograph, turned, lamp):
    values = photograph.display
    height, width, channels = values.shape
    brightest = values.max(axis=2)
    low, high = np.percentile(brightest[:: max(1, height // 400)], [1, 99])
    clipped, black = float(((brightest >= 1) & ~lamp).mean()), float((brightest <= 0).mean())
    kind = "linear" if photograph.linear else f"{photograph.bits} bits"
    size = f"{width} x {height} px, {channels} channel{'s' * (channels > 1)}, {kind}"
    text = f"{size}, uses {low:.2f} to {high:.2f} of its range"
    dark = high - low < FLAT
    yield Finding("photograph", text + (": expose longer, or light the room more evenly" if dark else ""), dark)
    yield from (Finding("photograph", line) for line in photograph.notes)
    yield from (Finding("photograph", line, True) for line in photograph.doubts)
    if photograph.lost_tables:
        yield Finding("photograph", jpeg.NO_TABLES, True)
    if clipped > CLIPPED:
        yield Finding(
            "photograph",
            f"{clipped:.1%} of the pixels beside lamps are white: they are left out; expose less",
            clipped > 0.1,
        )
    if black > CLIPPED:
        yield Finding("photograph", f"{black:.1%} of the pixels are black: they are left out", black > 0.1)
    if turned != 1:
        text = "EXIF says that the camera was turned: the pixels of camera and picks are those of the turned picture"
        yield Finding("photograph", text, True)


def of_edges(edges: Edges):
    """Findings of what the photograph's edges say of camera and objects, none where they were not looked at."""
    given = edges.given
    if edges.status == "good":
        yield Finding(
            "edges", f"{given.shown:.0%} of the model's are there, {given.before_px:.2f} px off in the median"
        )
    for why in given.why:
        if edges.status == "refined":
            yield Finding("edges", f"{why.text}: it is put right")
        elif edges.status == "lost":
            yield Finding("edges", why.text, True)
        else:
            yield Finding("edges", f"{why.text}: put it right, or let `explain` in scene.yaml name {why.cause}", True)


def cost(shape, has=None, facets=0, lamps=1) -> Finding:
    """Memory and time to expect. A doubt where they are much.

    shape : (H, W, ...) of the photograph;  has : GB of memory, those of this machine where none are told
    facets : of the model;  lamps : how many emit
    """
    megapixels = shape[0] * shape[1] / 1e6
    memory, seconds = GB_BASE + GB_PER_MP * megapixels, progress.typical(progress.PHOTOMETRY, shape[0] * shape[1])
    seconds += max(lamps - FEW_LAMPS, 0) * S_PER_LAMP + max(facets - FEW_FACETS, 0) * S_PER_FACET
    time = f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} minutes"
    has = has or _memory_gb()
    text = f"about {memory:.1f} GB of memory and {time} for {megapixels:.1f} megapixels, more where surfaces shine"
    text += f"; this machine has {has:.1f} GB" if has and memory > 0.8 * has else ""
    if memory > MUCH_GB or has and memory > 0.8 * has:
        return Finding("cost", f"{text}: make new-scene makes the photograph smaller, with its camera and picks", True)
    return Finding("cost", text)


def _memory_gb():
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    except (ValueError, OSError):
        return None


def _listed(names, most=6):
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


# ---- the picture ----


def over(photograph, segments) -> np.ndarray:
    """(H, W, 3) uint8: the photograph, a little darker, with the visible edges of the model over it.

    segments : (S, 2, 2) px
    """
    import cv2

    values = photograph.display
    values = np.repeat(values, 3, axis=2) if values.shape[2] == 1 else values
    picture = np.ascontiguousarray(np.round(255 * (0.15 + 0.7 * values)).astype(np.uint8))
    width = max(1, round(max(values.shape[:2]) / 1200))
    lines = np.round(16 * (segments + 0.0)).astype(np.int32)
    for colour, extra in (((0, 0, 0), 1), ((255, 170, 0), 0)):  # dark rims, so that it shows on any ground
        cv2.polylines(picture, list(lines), False, colour, width + extra, cv2.LINE_AA, 4)
    return picture
