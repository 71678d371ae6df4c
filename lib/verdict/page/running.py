"""The sections about the run: convergence, times, warnings, and how everything was made."""

from __future__ import annotations

import json
from typing import NamedTuple

from lib.verdict.page.html import finite, plain, render
from lib.verdict.page.parts import Parts
from lib.verdict.page.plots import Series, plot

KINDS = "abcdef"  # CSS classes of the lines of a plot
CAUSES = {  # as people name them
    "response": "another response",
    "curve": "a response curve",
    "matrix": "a camera that mixes colours",
    "glow": "light from outside",
    "lamps": "lamps other than told",
    "object": "one object of another material",
    "lamp_lobe": "lamps that throw lobes",
}
CLOCKS = ("cpu_s", "wall_s", "iteration")  # of a point of a trace: what is no error


# ---- convergence ----


def convergence_section(parts: Parts):
    """What each stage can see of its error, against time."""
    plots = [drawn for stage, report in parts.reports.items() for drawn in _plots(stage, report.trace)]
    asked = [_asked(question) for question in parts.reports["fit"].questions] if "fit" in parts.reports else []
    return render("convergence.html", plots=plots, asked=asked) if plots or asked else ""


def _asked(question):
    """(cause, beside, promised, brought, standard error, decision), as the table of questions shows them."""
    number = lambda value: f"{round(value):d}" if finite(value) else ""
    named = lambda cause: CAUSES.get(cause, plain(cause or ""))
    beside = ", ".join(map(named, question.beside))
    numbers = (number(value) for value in (question.promised, question.nats, question.dse))
    return named(question.cause), beside, *numbers, question.decision or ""


def _plots(stage, trace):
    """[(title, plot)]: all errors of a stage in one plot, each gamma in one of its own."""
    trace = [point for point in trace if finite(point.get("cpu_s"))]
    if len(trace) < 2:
        return
    keys = [key for key in dict.fromkeys(key for point in trace for key in point) if key not in CLOCKS]
    # whole numbers are counts (places, patches), not errors
    keys = [key for key in keys if any(isinstance(point.get(key), float) for point in trace)]
    errors = [key for key in keys if "gamma" not in key]
    series = [series for key in errors for series in _series(trace, key)][: len(KINDS)]
    y = plain(errors[0]) if len(errors) == 1 else "error"
    yield from _plot(stage, f"{stage}: error against CPU time", series, y, logy=True)
    for key in keys:
        if "gamma" in key and len({point.get(key) for point in trace}) > 1:
            title = f"{stage}: {plain(key)}"
            yield from _plot(title, f"{title} against CPU time", _series(trace, key), plain(key), logy=False)


def _series(trace, key):
    """[(name, seconds, values)] of one error; one for each side where a stage works on the photographs in turn."""
    first = min((point["cpu_s"] for point in trace if point["cpu_s"] > 0), default=1e-3)
    for side in dict.fromkeys(point.get("side") for point in trace):
        some = [point for point in trace if point.get("side") == side]
        seconds = [max(point["cpu_s"], first) for point in some]
        values = [point.get(key) for point in some]
        if any(map(finite, values)):
            yield f"{plain(key)}, {side}" if side else plain(key), seconds, values


def _plot(title, label, series, y, logy):
    series = [Series(*s, kind) for s, kind in zip(series, KINDS, strict=False)]
    drawn = plot(series, x="CPU seconds", y=y, title=label, logx=True, logy=logy)
    if drawn:
        yield title, drawn


# ---- times ----


class TimeRow(NamedTuple):
    """Seconds of a stage, or of all; None where its report does not say.

    apart : in the order of the labels;  share : of the longest stage's CPU time;  kind : CSS class of the status
    """

    stage: str
    cpu_s: float | None
    apart: list
    waited_s: float
    peak_mb: float | None = None
    share: float = 0
    status: str = ""
    kind: str = ""


def times_section(parts: Parts):
    """Counted CPU time, what is listed apart, and all that a user waits."""
    reports = parts.reports
    if not reports:
        return ""
    labels = list(dict.fromkeys(["imports", "compile", *(label for r in reports.values() for label in r.apart or {})]))
    longest = max(report.cpu_s or 0 for report in reports.values()) or 1
    rows = [_time_row(stage, report, labels, longest) for stage, report in reports.items()]
    total = TimeRow(
        stage="all",
        cpu_s=sum(row.cpu_s or 0 for row in rows),
        apart=[sum(row.apart[i] or 0 for row in rows) for i in range(len(labels))],
        waited_s=sum(row.waited_s for row in rows),
    )
    heads = {"compile": "compilation"}
    return render("times.html", rows=rows, total=total, labels=[heads.get(label, plain(label)) for label in labels])


def _time_row(stage, report, labels, longest):
    apart = report.apart or {}
    return TimeRow(
        stage=stage,
        cpu_s=report.cpu_s,
        apart=[apart[label].cpu if label in apart else None for label in labels],
        waited_s=report.waited_s,
        peak_mb=round(report.peak_mb) if finite(report.peak_mb) else None,
        share=(report.cpu_s or 0) / longest,
        status=report.status or "–",
        kind={"converged": "good", "unique": "good", "good": "good", "complete": "plain", "refined": "plain"}.get(
            report.status, "warn"
        ),
    )


# ---- warnings, and how it was made ----


def warnings_section(parts: Parts):
    """What the stages warned of."""
    warnings = [(stage, text) for stage, report in parts.reports.items() for text in report.warnings]
    return render("warnings.html", warnings=warnings) if warnings else ""


def notes_section(parts: Parts):
    """What asks for nothing, apart from the warnings."""
    notes = [(stage, text) for stage, report in parts.reports.items() for text in report.notes]
    return render("notes.html", notes=notes) if notes else ""


def made_section(parts: Parts):
    """All errors with their yardsticks; arguments, versions and inputs of every stage; what was left out."""
    if not parts.reports and not parts.plan and not parts.compared.errors:
        return ""
    errors = [(stage, error) for stage, report in parts.reports.items() for error in report.errors]
    said = {(stage, error.name) for stage, error in errors}  # what a stage said itself is not said again
    errors += [(e.stage or "", e) for e in parts.compared.errors if (e.stage or "", e.name) not in said]
    return render("made.html", errors=errors, stages=_stages(parts), left_out=parts.plan)


class StageFacts(NamedTuple):
    """arguments, inputs : {name: text}"""

    name: str
    arguments: dict
    inputs: dict
    versions: dict


def _stages(parts: Parts):
    return [
        StageFacts(
            name,
            {key: _text(value) for key, value in report.arguments.items() if value is not None},
            report.inputs,
            report.versions,
        )
        for name, report in parts.reports.items()
    ]


def _text(value):
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
