"""The sections about light: difference, materials, lamps, transfer functions; and what each pixel shows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lib.given import transfer_kinds
from lib.given.materials import Group, LampSigma, Materials
from lib.verdict.comparison import Deviation, GroupComparison, LampComparison
from lib.verdict.page import ladder
from lib.verdict.page.html import css, finite, fixed, number, percent, plain, pm, render
from lib.verdict.page.parts import Parts
from lib.verdict.page.pictures import (
    DIFFERENCE_COLOURS,
    bytes8,
    colours,
    difference,
    display_function,
    diverging,
    labels_uri,
    photo_uri,
    smaller,
    three_channels,
    uri,
)
from lib.verdict.page.plots import Band, Series, plot
from lib.verdict.page.summary import without_sigma

WORST = 6  # groups of the largest difference that are listed
MOST_NAMES = 40  # groups in the key of the index buffer

MODEL_WORDS = {
    "gamma": "gamma",
    **transfer_kinds.CURVES,
    "linear": "linear",
    "linear_per_group": "linear, per group",
    "histogram": "histogram",
    "histogram_per_group": "histogram, per group",
}
SCALE_WORDS = {
    None: "",
    "lamps": "The lamps’ given emittance fixes the scale of all reflectances.",
    "reference": "The reference groups fix the scale of all reflectances.",
    "interreflection": "No lamp and no reference was given: only the light between the surfaces fixes the scale, and"
    " the standard deviations contain that.",
    "convention": "No lamp and no reference was given, and nothing in the picture fixes the scale: by convention the"
    " emittance of the lamp that gives most light is 1. Reflectances and other lamps are relative.",
    "contradicted": "The photograph contradicts what is told of the light (see above): ratios between reflectances"
    " hold, the factor that all have in common need not.",
}


# ---- the difference ----


def difference_section(parts: Parts, width):
    """Re-rendering minus photograph, in colours."""
    a, b = parts.photograph, parts.rendered
    if a is None or b is None or a.shape[:2] != b.shape[:2]:
        return ""
    if a.shape[2] != b.shape[2]:
        a, b = three_channels(a), three_channels(b)
    signed, half = difference(a, b)
    scores = parts.scores.groups.items() if parts.scores else ()
    worst = sorted(((name, score.rmse) for name, score in scores if finite(score.rmse)), key=lambda row: -row[1])
    return render(
        "difference.html",
        picture=uri(smaller(diverging(signed, half), width)),
        stops=[css(colour) for colour in DIFFERENCE_COLOURS],
        half=half,
        quantiles=[float(np.percentile(np.abs(signed), q)) for q in (50, 95, 99)],
        worst=[row for row in worst[:WORST] if worst[0][1] > 0],
    )


# ---- materials ----


class Cell(NamedTuple):
    """One channel of a group's rho_d.

    own : found, not assumed;  sigma : None where there is none to show;  off, mark : the deviation from the truth in
    words and its CSS class
    """

    value: float | None
    own: bool
    sigma: float | None
    truth: float | None
    off: str
    mark: str


class MaterialRow(NamedTuple):
    """A group's row. swatch : CSS background or None;  pill : a warning or "";  dots : `_dots`"""

    name: str
    swatch: str | None
    words: str
    pill: str
    cells: list
    dots: list
    pixels: int | None
    error: float | None


class Dot(NamedTuple):
    """One channel on a line from 0 to 1, in px. bar : ends of 3 sigma or None;  truth : or None"""

    kind: str
    x: float
    y: float
    bar: tuple | None
    truth: float | None


def materials_section(parts: Parts):
    """Every group's diffuse reflectance."""
    if not parts.groups:
        return ""
    channels = (0,) if _is_grey(parts.materials) else (0, 1, 2)
    truths = parts.compared.groups or {}
    groups = sorted(parts.groups.items(), key=lambda item: -(item[1].pixels or 0))
    display = display_function(parts.transfer, parts.linear)
    rows = [_row(name, g, truths.get(name, GroupComparison()), channels, display) for name, g in groups]
    has_truth = any(truth.rho_d and truth.rho_d.truth for truth in truths.values())
    return render(
        "materials.html",
        rows=rows,
        heads=["ρ"] if len(channels) == 1 else [f"ρ {ladder.CHANNELS[c]}" for c in channels],
        height=ROW_PX * len(channels) + 2,
        shiny=bool(ladder.counts(parts.materials)),
        judged=has_truth and any(group.identified for group in parts.groups.values()),
        off=sum(cell.mark == "off" for row in rows for cell in row.cells),
    )


def _is_grey(materials: Materials):
    values = [group.assumed or group.rho_d for group in materials.groups.values()]
    return bool(values) and all(v is None or v[0] == v[1] == v[2] for v in values)


def _row(name, group: Group, truth: GroupComparison, channels, display):
    value, own = group.in_balance, group.rho_d is not None
    sigma = group.sigma.rho_d if own else None
    against = truth.rho_d or Deviation()
    cells = [_cell(value, own, sigma, against, c) for c in channels]
    pill, words = _status_words(group)
    kind = plain(group.kind or "kind unknown")
    colour = css(bytes8(display(np.array(value, float)))) if value else None
    shine = ladder.sheen(group)
    return MaterialRow(
        name=name,
        swatch=f"{shine}, {colour}" if colour and shine else colour,
        words=f"{kind}, {words}" if words else kind,
        pill=pill,
        cells=cells,
        dots=_dots(value, sigma, against.truth, channels) if own else [],
        pixels=group.pixels,
        error=group.error,
    )


def _cell(value, own, sigma, against: Deviation, c):
    truth, z, relative, absolute = (
        values[c] if values else None
        for values in (against.truth, against.in_sigmas, against.relative, against.absolute)
    )
    off, mark = "", ""
    if finite(truth) and own and absolute is not None:
        off = percent(relative, 2 if abs(relative) < 0.1 else 1, True) if finite(relative) else fixed(absolute, 4, True)
        off += f", {fixed(abs(z), 1)} σ" if finite(z) else ""
        mark = ladder.mark(z)
    return Cell(
        value=value[c] if value else None,
        own=own,
        sigma=sigma[c] if sigma and finite(sigma[c]) and sigma[c] > 0 else None,
        truth=truth if finite(truth) else None,
        off=off,
        mark=mark,
    )


def _status_words(group: Group):
    """(a warning or "", remark after the kind)."""
    if group.identified:
        sigma = group.sigma.rho_d
        given = sigma and not any(sigma) and not group.is_mirror
        return "", "given as a reference" if given else "identified"
    if group.rho_d:
        return "no finding: the photograph does not fit it", ""
    why = f"none of its {number(group.pixels)} pixels can be trusted" if group.pixels else "never seen"
    return f"{why}; {'assumed from the other groups' if group.assumed else 'no value'}", ""


DOTS_PX, ROW_PX = 112, 12  # width of a line from 0 to 1, height of a channel


def _dots(value, sigma, truth, channels):
    """[Dot]: a group's reflectance with a bar of 3 sigma and a tick at the truth."""

    def x(v):
        return 5 + min(max(v, 0), 1) * (DOTS_PX - 10)

    return [
        Dot(
            kind="grey" if len(channels) == 1 else "rgb"[c],
            x=x(value[c]),
            y=ROW_PX * (i + 0.5) + 1,
            bar=(x(value[c] - 3 * sigma[c]), x(value[c] + 3 * sigma[c])) if sigma and finite(sigma[c]) else None,
            truth=x(truth[c]) if truth and finite(truth[c]) else None,
        )
        for i, c in enumerate(channels)
    ]


# ---- lamps and the transfer function ----


class LampCell(NamedTuple):
    """One channel of an emittance. mark : CSS class of the deviation"""

    value: float | None
    sigma: float | None
    truth: float | None
    relative: float | None
    mark: str


def light_section(parts: Parts):
    """The lamps, and the camera's transfer function."""
    materials = parts.materials
    if not materials or not (materials.lamps or materials.transfer.kind):
        return ""
    known = [lamp.emittance for lamp in materials.lamps.values() if lamp.emittance]
    grey = all(len(set(emittance)) == 1 for emittance in known)
    truths = parts.compared.lamps or {}
    rows = []
    for name, lamp in materials.lamps.items():
        cells = [_lamp_cell(lamp, truths.get(name, LampComparison()), c) for c in ((0,) if grey else (0, 1, 2))]
        rows.append((name, cells, _emittance_words(lamp, materials.scale), _lobe_in_words(lamp)))
    return render(
        "light.html",
        rows=rows,
        heads=["E"] if grey else [f"E {c}" for c in ladder.CHANNELS],
        scale=SCALE_WORDS[materials.scale] + _off_by(materials.sigma_scale),
        transfer=_transfer(parts),
    )


def _off_by(sigma_scale) -> str:
    """What is said besides of a scale that is contradicted."""
    return "" if sigma_scale is None else f" Its standard deviation is {100 * max(sigma_scale):.0f} %."


def _emittance_words(lamp, scale):
    if lamp.identified is False:
        return "no finding"
    return "estimated" if emittance_sigma(lamp) else "by convention" if scale == "convention" else "given"


def _lobe_in_words(lamp):
    if lamp.lobe is None:
        return ""
    sigma = lamp.sigma or LampSigma()
    aim = ", ".join(f"{v:.3f}" for v in lamp.lobe.aim)
    turn = f" within {sigma.aim_deg:.2f}°" if sigma.aim_deg else ""
    return f"cos^{pm(lamp.lobe.exponent, sigma.exponent, 2)} about ({aim}){turn}"


def emittance_sigma(lamp):
    """(3,) or None, where the emittance was given."""
    return lamp.sigma and lamp.sigma.emittance


def _lamp_cell(lamp, against: LampComparison, c):
    value, sigma, relative, truth = (
        values[c] if values else None
        for values in (lamp.emittance, emittance_sigma(lamp), against.relative, against.truth)
    )
    compared = emittance_sigma(lamp) is not None and finite(relative)
    out = compared and finite(sigma) and sigma > 0 and abs(value - truth) > 3 * sigma
    return LampCell(
        value=value,
        sigma=sigma if finite(sigma) else None,
        truth=truth if compared else None,
        relative=relative,
        mark="off" if out else "ok",
    )


class TransferPlot(NamedTuple):
    """plot : "" where there is nothing to find;  gamma, truth : None unless of that kind"""

    plot: str
    words: str
    gamma: str | None
    remark: str
    truth: float | None
    band: bool


def _shown(name, transfer, B, kinds):
    """[Series] of what a function shows, one of each channel where they differ. kinds : of Series"""
    if not (transfer.kind == "curve" and transfer.function.channels):
        return [Series(name, B, display_function(transfer)(B), kinds[0])]
    values = display_function(transfer)(np.repeat(B[:, None], 3, axis=1))
    named = enumerate(zip(("red", "green", "blue"), kinds, strict=True))
    return [Series(f"{name}, {colour}", B, values[:, c], kind) for c, (colour, kind) in named]


def _transfer(parts: Parts):
    """The curve that was found, beside the true one; None where none was asked for."""
    transfer = parts.transfer
    if not transfer.kind:
        return None
    truth = parts.compared.transfer.truth if parts.compared.transfer else None
    if transfer.kind == "linear" and (truth or transfer).kind == "linear":
        return TransferPlot("", "", None, "", None, False)
    B = np.linspace(0, 1, 81)
    series, bands = [Series("no transfer", [0, 1], [0, 1], "faint")], []
    gamma, remark = None, ""
    if transfer.kind == "gamma" and finite(transfer.gamma):
        g, sigma = transfer.gamma, transfer.sigma
        gamma, remark = pm(g, sigma, 3), "" if sigma else without_sigma(parts)
        if finite(sigma) and 0 < 3 * sigma < g:
            bands.append(Band(B, B ** (1 / (g - 3 * sigma)), B ** (1 / (g + 3 * sigma))))
    series += _shown("found", transfer, B, ("a", "c", "d"))
    if truth and truth.kind in transfer_kinds.OF_LIGHT:
        series += _shown("truth", truth, B, ("dash",) * 3)
    return TransferPlot(
        plot=plot(
            series,
            x="light at the sensor",
            y="displayed value",
            title="The camera's transfer function",
            xlim=(0, 1),
            ylim=(0, 1),
            bands=bands,
            dots=False,
            height=320,
        ),
        words=plain(transfer.kind),
        gamma=gamma,
        remark=remark,
        truth=truth.gamma if gamma and truth and finite(truth.gamma) else None,
        band=bool(bands),
    )


def models_section(parts: Parts):
    """Figures 4.4 to 4.6: the same light shown through each transfer function of the paper."""
    rows = next((r.transfer_models for s in ("render", "fit") if (r := parts.reports.get(s)) and r.transfer_models), [])
    refitted = any(finite(row.rmse_refitted) for row in rows)
    return render("models.html", rows=rows, words=MODEL_WORDS, refitted=refitted) if rows else ""


# ---- index buffers ----


class Buffer(NamedTuple):
    """A picture with its caption: the part in bold, and the rest."""

    picture: str
    name: str
    words: str
    alt: str


def buffers_section(parts: Parts, width):
    """The model drawn from the camera's place."""
    width = min(width, 960)
    large = [*_groups(parts, width), *_trusted(parts, width)]
    small = [*_things(parts, width), *_hidden(parts, width), *_depth(parts, width)]
    return render("buffers.html", large=large, small=small, names=_names(parts)) if large or small else ""


def _groups(parts: Parts, width):
    if parts.group is not None:
        picture = labels_uri(parts.group, width)
        yield Buffer(picture, "Groups", ": what shares one material", "Group index buffer")


def _names(parts: Parts):
    """[(colour, name, share of the picture)] of the groups that are seen, the largest first."""
    names = parts.legend.groups if parts.legend else []
    if parts.group is None or not names:
        return []
    count = np.bincount(parts.group.ravel(), minlength=len(names) + 1)[1:]
    palette = colours(len(count))
    seen = [i for i in np.argsort(-count, kind="stable") if count[i] > 0][:MOST_NAMES]
    return [(css(palette[i]), names[i] if i < len(names) else i + 1, count[i] / parts.group.size) for i in seen]


def _things(parts: Parts, width):
    for labels, name, words in (
        (parts.object, "Objects", "things of the model"),
        (parts.facet, "Facets", "flat parts; light varies smoothly within one"),
    ):
        if labels is not None:
            seen = f": {len(np.unique(labels[labels > 0])):,} seen; {words}"
            yield Buffer(labels_uri(labels, width), name, seen, f"{name} index buffer")


def _hidden(parts: Parts, width):
    if parts.hidden is not None:
        lines = smaller((~parts.hidden.astype(bool)).astype(np.uint8) * 255, width)
        words = ": the edges that remain visible"
        yield Buffer(uri(lines), "Hidden surfaces removed", words, "Visible edges of the model")


def _trusted(parts: Parts, width):
    """The trusted pixels, over the photograph where it has their size."""
    trusted, photograph = parts.trusted, parts.photograph
    if trusted is None:
        return
    words = f": {percent(float(np.mean(trusted)))} of the picture"
    if photograph is None or photograph.shape[:2] != trusted.shape:
        white = uri(smaller(trusted.astype(np.uint8) * 255, width, nearest=True))
        yield Buffer(white, "Trusted pixels", words, "Trusted pixels")
        return
    base = three_channels(photograph)
    grey = base.mean(axis=2, keepdims=True)
    tint = base * 0.72 + np.array([0.0, 0.28, 0.20])
    over = np.where(trusted.astype(bool)[..., None], tint, grey * 0.38 + 0.06)
    words += ", tinted; the others do not take part"
    yield Buffer(photo_uri(over, width), "Trusted pixels", words, "Trusted pixels over the photograph")


def _depth(parts: Parts, width):
    depth = parts.depth
    if depth is None:
        return
    some = (depth > 0) & np.isfinite(depth)
    if not some.any():
        return
    near, far = float(depth[some].min()), float(depth[some].max())
    shade = np.where(some, 1 - 0.9 * (np.where(some, depth, near) - near) / max(far - near, 1e-12), 0)
    words = f": {number(near)} m (bright) to {number(far)} m"
    yield Buffer(photo_uri(shade, width), "Depth", words, "Depth")
