"""The page of `make verify`: every place of every walk as a table, and curves of error and bound. Self-contained."""

from __future__ import annotations

from html import escape
from pathlib import Path

from lib.core import artefact
from lib.verdict.page import html, plots

STYLE = """
main { max-width: 1080px; margin: 0 auto; padding: 1rem }
.walk { display: flex; flex-wrap: wrap; gap: 1.5rem; align-items: flex-start; margin-bottom: 1.5rem }
.walk > * { max-width: 100%; overflow-x: auto } .walk > div { flex: 1 1 480px } .walk > div + div { flex: 0 1 420px }
td, th { padding: .1rem .6rem; text-align: right }
td:first-child, td:last-child { text-align: left }
.broken td { background: #c0392b; color: white } .law { opacity: .75 } h2 { margin-top: 2rem } h3, .law { margin: 0 }
"""
COLUMNS = ("place", "value", "truth", "error", "bound", "iterations", "CPU s", "said")


def write(path, results, cpu_s):
    """results : [(Walk, [Point])]"""
    count = sum(len(points) for _, points in results)
    broken = sum(not p.found.holds for _, points in results for p in points)
    said = f"{count - broken} of {count} hold" if broken else f"All {count} hold"
    parts, last = [], None
    for walk, points in results:
        if walk.part != last:
            last = walk.part
            parts.append(f"<h2>{escape(html.sentence(last))}</h2>")
        parts.append(_walk(walk, points))
    page = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>anasyn: verify</title><style>{html.asset('page.css')}{STYLE}</style><main><h1>Laws and truths</h1>"
        f"<p><b>{said}.</b> {cpu_s:.0f} CPU s. Error and bound have the same unit: that of the value, or relative. "
        "A place holds where its error is no larger than its bound. docs/verify.md says where the truths come from.</p>"
        f"{''.join(parts)}</main></html>"
    )
    with artefact.writing(path) as partial:
        Path(partial).write_text(page, encoding="utf-8")


def _walk(walk, points):
    head = "".join(f"<th>{name}</th>" for name in COLUMNS)
    rows = "".join(_row(point) for point in points)
    law = f'<h3>{escape(html.sentence(walk.name))}</h3><p class="law">{escape(html.sentence(walk.law))}</p>'
    table = f'<div tabindex="0"><table><tr>{head}</tr>{rows}</table></div>'
    return f'{law}<div class="walk">{table}{_curve(walk, points)}</div>'


def _row(point):
    f = point.found
    cells = (
        html.number(point.place) if isinstance(point.place, int | float) else str(point.place),
        html.number(f.value, 7),
        html.number(f.truth, 7),
        html.number(f.error, 2) if html.finite(f.error) else "no number",
        html.number(f.bound, 2),
        "" if f.iterations is None else str(f.iterations),
        f"{point.cpu_s:.2f}",
        f.note,
    )
    return f"<tr{'' if f.holds else ' class=broken'}>" + "".join(f"<td>{escape(c)}</td>" for c in cells) + "</tr>"


def _curve(walk, points):
    """Error and bound along a numerical axis; nothing where there are too few numbers."""
    points = [p for p in points if isinstance(p.place, int | float)]
    if len(points) < 3:
        return ""
    x = [float(p.place) for p in points]
    positive = [v for v in x if v > 0]
    wide = len(positive) > 2 and max(positive) / min(positive) > 30
    series = [
        plots.Series("error", x, [p.found.error for p in points], "a"),
        plots.Series("bound", x, [p.found.bound for p in points], "b"),
    ]
    curve = plots.plot(series, x=walk.axis, y="error", title=walk.name, logx=wide, logy=True, width=420, height=260)
    return f"<div>{curve}</div>"
