"""The section about the reflectance ladder: how each surface reflects, and what its error asked for.

Groups that climbed get a row each. Those that stayed diffuse get a bar each, which ends at the threshold.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lib.given.kinds import KINDS, LOBES, MIRRORS, RUNGS
from lib.given.materials import Group, Materials
from lib.verdict.comparison import Deviation, GroupComparison, TextureComparison, Turn
from lib.verdict.page.html import coordinate, css, finite, fixed, percent, plain, render, sentence
from lib.verdict.page.pictures import SRGB, bytes8, display_function, uri
from lib.verdict.stage_reports import LadderSummary, StageReport

CHANNELS = ("R", "G", "B")
MOST = 6  # textures shown of a group
BELOW_ALL = 1e-12  # errors below are drawn at the left end


def word(rung):
    """A rung for people."""
    return RUNGS[rung].words if rung in RUNGS else plain(rung)


def mark(in_sigmas):
    """The CSS class of a deviation."""
    return "muted" if not finite(in_sigmas) else "off" if abs(in_sigmas) > 3 else "ok"


def counts(materials: Materials | None):
    """Of the groups that are not diffuse how many are what; "" where all are.

    >>> kinds = {"a": "mirror", "b": "glossy", "c": "glossy", "d": "diffuse"}
    >>> counts(Materials(groups={name: Group(kind=kind) for name, kind in kinds.items()}))
    '1 mirror, 2 glossy'
    """
    kinds = [group.kind for group in materials.groups.values()] if materials else []
    found = [(kinds.count(k), plain(k) + "s" * (k in MIRRORS and kinds.count(k) > 1)) for k in KINDS[1:]]
    return ", ".join(f"{n} {what}" for n, what in found if n)


def sheen(group: Group):
    """CSS background that tells a surface from a diffuse one, its own colour apart; None for a diffuse one."""
    if group.is_mirror:
        rho_s = [min(max(v, 0), 1) if finite(v) else 0 for v in group.rho_s or (0, 0, 0)]
        tint = css(bytes8(np.array(rho_s) ** 0.45))
        return f"linear-gradient(135deg, #7d8790 0 18%, {tint} 40%, #aab3ba 52%, {tint} 66%, #6f7880 90%)"
    if not group.has_lobe:
        return None
    alpha = group.alpha or (0.1, 0.1)
    wide, high = (coordinate(100 * min(max(3 * a, 0.12), 0.9)) if finite(a) else "40" for a in alpha)
    return f"radial-gradient(ellipse {wide}% {high}% at 40% 36%, rgba(255,255,255,.95), rgba(255,255,255,0))"


# ---- textures ----


class Thumbnail(NamedTuple):
    """A texture as the page shows it.

    picture : (h, w, 3) uint8 in the proportions of the facet;  known : share that the photograph tells
    """

    picture: np.ndarray
    size_m: tuple
    known: float


def thumbnail(texture, largest=240) -> Thumbnail:
    """Of a lib.picture.albedo_maps.AlbedoMap, as the facet is seen from its front."""
    import cv2

    a, b, c = texture.corners
    size = float(np.linalg.norm(b - a)), float(np.linalg.norm(c - a))
    shape = np.maximum(1, np.round(largest * np.array(size) / max(*size, 1e-12))).astype(int)
    seen = np.ascontiguousarray(np.swapaxes(texture.albedo, 0, 1)[::-1], np.float32)
    seen = np.ascontiguousarray(np.broadcast_to(seen, (*seen.shape[:2], 3)))
    small = cv2.resize(seen, tuple(int(n) for n in shape), interpolation=cv2.INTER_AREA)
    known = float((texture.known * texture.inside).sum() / max(texture.inside.sum(), 1e-12))
    return Thumbnail(bytes8(SRGB(small.reshape(*shape[::-1], 3))), size, known)


def _largest(thumbnails):
    """[(facet, Thumbnail)], the largest facets first."""
    return sorted(thumbnails.items(), key=lambda item: -math.prod(item[1].size_m))


# ---- the row of a group that climbed ----


class Track(NamedTuple):
    """An error on a logarithmic line, px: as diffuse, in the end, and the threshold; each may be None."""

    before: float | None
    after: float | None
    limit: float | None


class Value(NamedTuple):
    """One number with what is known of it.

    label : "" or the channel;  off : its deviation in words;  mark : CSS class of that
    """

    label: str
    value: float
    sigma: float | None
    truth: float | None
    off: str
    mark: str


class Direction(NamedTuple):
    """Of a lobe's alpha_x. sigma_deg, truth, off_deg : None where not known;  mark : CSS class of the deviation"""

    value: tuple
    sigma_deg: float | None
    truth: tuple | None
    off_deg: float | None
    mark: str


class Picture(NamedTuple):
    """A facet's texture."""

    facet: int
    data: str
    size_m: tuple
    known: float


class Climbed(NamedTuple):
    """A row of a group that climbed.

    ball : a data URI, or None where a CSS `background` stands for it;  true_kind : None where it is the found one
    before, after : display RMSE beyond noise, as a diffuse surface and in the end;  over : `after` is too large
    perfect : rho_s is 1 by the word `mirror`;  hidden : number of textures that are not shown
    """

    name: str
    word: str
    ball: str | None
    background: str
    true_kind: str | None
    stairs: list
    track: Track
    before: float | None
    after: float | None
    over: bool
    perfect: bool
    rho_s: list
    alpha: list
    direction: Direction | None
    why: str
    pictures: list
    hidden: int
    texture: TextureComparison


TRACK_PX, TRACK_END = 190, 7


def _scale(errors):
    """(low, high): decimal exponents that hold all errors, at least two apart and at most five."""
    logs = [math.log10(v) for v in errors if finite(v) and v > BELOW_ALL]
    low, high = (math.floor(min(logs)), math.ceil(max(logs) + 1e-9)) if logs else (-3, -1)
    return max(low, high - 5), max(high, low + 2)


def _track(before, after, threshold, scale):
    low, high = scale

    def x(v):
        at = min(max(math.log10(max(v, BELOW_ALL)), low), high) - low
        return TRACK_END + at / (high - low) * (TRACK_PX - 2 * TRACK_END)

    return Track(
        before=x(before) if finite(before) else None,
        after=x(after) if finite(after) else None,
        limit=x(threshold) if finite(threshold) and threshold > 0 else None,
    )


def _stairs(rung, group: Group):
    """The CSS class of each step: reached, tried and left, or passed (never tried)."""
    tried = {"diffuse"}
    if group.ladder:
        tried |= {str(step.get("rung")) for step in group.ladder.tried or () if isinstance(step, dict)}
    if rung == "textured" and "given" not in _why(group):  # a texture is what no mirror and no lobe explains
        tried |= {*MIRRORS, *LOBES}
    return ["reached" if name == rung else "tried" if name in tried else "passed" for name in RUNGS]


def _why(group: Group):
    return (group.ladder and group.ladder.why) or ""


def _reason(group: Group):
    """The line for people in materials.json, its errors (they have four decimals) in per cent."""
    why = re.sub(r"\b\d\.\d{4}\b", lambda found: percent(float(found[0])), _why(group))
    return sentence(why.replace("rho_s", "ρₛ").replace("_", " "))


def _values(values, sigma, deviation: Deviation | None, names=CHANNELS):
    """[Value]: one where all channels are equal; none where a value is missing."""
    if not values or not all(map(finite, values)):
        return []
    deviation = deviation or Deviation()
    truths = deviation.truth or ()
    once = len({*map(str, values)}) == 1 and len({*map(str, truths or (0,))}) == 1
    return [
        _value("" if once else names[i], v, sigma[i] if sigma else None, deviation, i)
        for i, v in enumerate(values[:1] if once else values)
    ]


def _value(label, value, sigma, deviation: Deviation, i):
    truth, off, z = (
        numbers[i] if numbers and i < len(numbers) else None
        for numbers in (deviation.truth, deviation.absolute, deviation.in_sigmas)
    )
    said = f"{fixed(abs(z), 1)} σ" if finite(z) else fixed(off, 4, True) if finite(off) else ""
    sigma = sigma if finite(sigma) and sigma > 0 else None
    return Value(label, value, sigma, truth if finite(truth) else None, said, mark(z))


def _direction(group: Group, turn: Turn | None):
    if not group.tangent or not all(map(finite, group.tangent)):
        return None
    turn = turn or Turn()
    off, z = (values[0] if values else None for values in (turn.degrees, turn.in_sigmas))
    sigma = math.degrees(group.sigma.tangent_rad) if finite(group.sigma.tangent_rad) else None
    known = turn.truth is not None and finite(off)
    return Direction(
        value=group.tangent,
        sigma_deg=sigma if sigma and sigma > 0 else None,
        truth=turn.truth if known else None,
        off_deg=off,
        mark="off" if mark(z) == "off" else "ok",
    )


@dataclass(frozen=True)
class Ladder:
    """What the section is about. groups : those that are no lamps;  rungs : {group: where it stands}

    summary : of the fit's report, empty where it did not ask;  asked : it did
    """

    groups: dict
    rungs: dict
    summary: LadderSummary
    asked: bool
    named: dict
    references: dict

    @classmethod
    def of(cls, parts):
        """From page.parts.Parts."""
        fit = parts.reports.get("fit") or StageReport()
        summary = fit.ladder or LadderSummary()
        rungs = {name: _rung(group) for name, group in parts.groups.items()}
        rungs |= {name: rung for name, rung in summary.rungs.items() if name in parts.groups}
        named, references = (fit.arguments.get(key) or {} for key in ("surfaces", "reference"))
        return cls(parts.groups, rungs, summary, fit.ladder is not None, named, references)

    @property
    def climbed(self):
        """Names, those that most pixels show first."""
        names = [name for name, rung in self.rungs.items() if rung != "diffuse" and self.groups[name].identified]
        return sorted(names, key=lambda name: -(self.groups[name].pixels or 0))

    @property
    def staying(self):
        """[Stayed] of the groups that were judged and stayed diffuse."""
        diffuse = self.summary.diffuse
        names = [name for name in self.groups if name in diffuse and name not in self.climbed]
        return [self._stayed(name) for name in names if finite(diffuse[name])]

    def _stayed(self, name):
        before, after = self.summary.diffuse[name], self.summary.end.get(name)
        return Stayed(name, before, after if finite(after) else None, self.summary.threshold, self._remark(name))

    def _remark(self, name):
        """Why a group stayed diffuse whose error is beyond the threshold; "" where it is not."""
        if not self.is_over(self.summary.end.get(name, self.summary.diffuse[name])):
            return ""
        if self.named.get(name) == "diffuse":
            return "named diffuse in scene.yaml"
        return "given as a reference" if name in self.references else "no rung explains it"

    def is_over(self, error):
        """Beyond the threshold."""
        return finite(error) and finite(self.summary.threshold) and error > self.summary.threshold

    def not_judged(self, seen):
        """Names of identified groups that were not judged: those with pixels of their own, or those without."""
        judged = {*self.summary.diffuse, *self.climbed}
        return [n for n, g in self.groups.items() if n not in judged and g.identified and bool(g.pixels) == seen]

    @property
    def rays_spent(self):
        """Of all purposes."""
        return sum(n for purpose, n in self.summary.rays.items() if "ray" in purpose and finite(n))


def _rung(group: Group):
    if group.ladder and group.ladder.rung:
        return group.ladder.rung
    return "anisotropic" if group.kind == "glossy" and group.tangent else group.kind or "diffuse"


class Stayed(NamedTuple):
    """A group that stayed diffuse: its error as such, and in the end where something else climbed."""

    name: str
    before: float
    after: float | None
    threshold: float | None
    remark: str

    @property
    def now(self):
        """Its error, in the end."""
        return self.before if self.after is None else self.after

    @property
    def over(self):
        """Beyond the threshold."""
        return finite(self.threshold) and self.now > self.threshold

    @property
    def came_back(self):
        """It was beyond the threshold until the light of those that climbed was in the balance."""
        return self.after is not None and finite(self.threshold) and self.before > self.threshold >= self.after

    @property
    def share(self):
        """Of the threshold, at most 1."""
        return min(1.0, self.now / self.threshold) if finite(self.threshold) and self.threshold > 0 else 0


def _climbed(parts, ladder: Ladder, name, scale):
    group, rung, summary = ladder.groups[name], ladder.rungs[name], ladder.summary
    before, after = summary.diffuse.get(name), summary.end.get(name)
    known = (parts.compared.groups or {}).get(name, GroupComparison())
    found, true_kind = known.kind or (None, None)
    thumbnails = _largest(parts.thumbnails.get(name, {}))
    perfect = group.kind == "mirror" and group.rho_s == (1.0, 1.0, 1.0)
    return Climbed(
        name=name,
        word=word(rung),
        ball=uri(thumbnails[0][1].picture, photo=True) if thumbnails else None,
        background=_background(group, parts),
        true_kind=plain(true_kind) if found != true_kind else None,
        stairs=_stairs(rung, group),
        track=_track(before, after, summary.threshold, scale),
        before=before,
        after=after,
        over=ladder.is_over(after),
        perfect=perfect,
        rho_s=_values(group.rho_s, group.sigma.rho_s, known.rho_s) if group.is_specular and not perfect else [],
        alpha=_values(group.alpha, group.sigma.alpha, known.alpha, ("x", "y")),
        direction=_direction(group, known.tangent),
        why=_reason(group),
        pictures=[Picture(f, uri(t.picture, photo=True), t.size_m, t.known) for f, t in thumbnails[:MOST]],
        hidden=max(0, len(thumbnails) - MOST),
        texture=(parts.compared.textures or {}).get(name, TextureComparison()),
    )


def _background(group: Group, parts):
    rho, shine = group.rho_d, sheen(group)
    shown = display_function(parts.transfer, parts.linear)
    base = css(bytes8(shown(np.array(rho, float)))) if rho and all(map(finite, rho)) else "var(--plain-bg)"
    return f"{shine}, {base}" if shine else base


# ---- the section ----


def ladder_section(parts):
    """How each surface reflects; "" where no ladder was climbed or left standing. parts : page.parts.Parts"""
    ladder = Ladder.of(parts)
    names = ladder.climbed
    if not ladder.groups or not (ladder.asked or names):
        return ""
    summary, staying = ladder.summary, ladder.staying
    scale = _scale(
        [summary.threshold, *(errors.get(name) for name in names for errors in (summary.diffuse, summary.end))]
    )
    return render(
        "ladder.html",
        threshold=summary.threshold if finite(summary.threshold) else None,
        climbed=[_climbed(parts, ladder, name, scale) for name in names],
        groups=len(ladder.groups),
        helped=[stayed.name for stayed in staying if stayed.came_back] if names else [],
        all_right=parts.compared.error("kinds.right") == 1,
        beyond=[stayed.name for stayed in staying if stayed.remark],
        staying=sorted(staying, key=lambda stayed: -stayed.now),
        mirrored=ladder.not_judged(seen=False) if names else [],
        few=ladder.not_judged(seen=True) if summary.diffuse else [],
        spent=ladder.rays_spent,
        rays=_rays(summary.rays),
    )


class Rays(NamedTuple):
    """What was spent. share : of the largest, None of what is no rays"""

    purpose: str
    count: int
    share: float | None


def _rays(rays):
    rays = {purpose: n for purpose, n in rays.items() if finite(n) and n > 0}
    most = max((n for purpose, n in rays.items() if "ray" in purpose), default=1)
    rows = sorted(rays.items(), key=lambda item: -item[1])
    return [Rays(plain(purpose), int(n), n / most if "ray" in purpose else None) for purpose, n in rows]
