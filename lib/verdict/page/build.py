"""The page put together: all sections in their order, and pictures as large as the size of the page allows."""

from __future__ import annotations

import re

from lib.verdict.page import changed, exports, further, ladder, photometry, placed, running, summary, vision
from lib.verdict.page.html import asset, render, sentence
from lib.verdict.page.parts import Parts

LIMIT_BYTES = 6_000_000
TITLE = re.compile(r'<section id="([^"]+)"><h2>(.*?)</h2>')
WIDTHS_PX = (1600, 1280, 960, 720, 480, 320)  # of the pictures; tried in this order until the page is small enough


def page(parts: Parts, limit_bytes=LIMIT_BYTES) -> str:
    """The page as text, of at most limit_bytes (as far as the smallest pictures allow it)."""
    for width in WIDTHS_PX:
        text = _page(parts, width)
        if len(text.encode()) <= limit_bytes:
            break
    return text


def _page(parts: Parts, width):
    about = summary.about(parts)
    sections = [
        running.warnings_section(parts),
        changed.changed_section(parts, width),
        photometry.difference_section(parts, width),
        photometry.materials_section(parts),
        ladder.ladder_section(parts),
        photometry.light_section(parts),
        photometry.models_section(parts),
        *(vision.sections(parts.vision, width) if parts.vision else ()),
        placed.placed_section(parts.placed, parts.photograph, min(width, 960)),
        further.further_section(parts.further, width),
        photometry.buffers_section(parts, width),
        exports.exports_section(parts),
        running.notes_section(parts),
        running.convergence_section(parts),
        running.times_section(parts),
        running.made_section(parts),
    ]
    return render(
        "page.html",
        scene=parts.scene,
        framed=parts.view is not None,
        about=about,
        About=sentence(about),
        verdict=summary.verdict(parts),
        steps=parts.steps,
        hero=summary.hero(parts, width),
        warnings=sum(len(report.warnings) for report in parts.reports.values()),
        contents=[found for section in sections for found in TITLE.findall(section)],
        sections=sections,
        style=asset("page.css"),
        script=asset("page.js"),
    )
