"""scorecard.csv: every stage's errors beside its times, and the two-sided bounds that a scene's errors must keep."""

from __future__ import annotations

import csv
import math

from lib.core.stage import BadInput

COLUMNS = ("scene", "stage", "error", "value", "unit", "against", "wall_s", "cpu_s", "peak_mb", "status")
OF_A_REPORT = ("wall_s", "cpu_s", "peak_mb", "status")


def rows(scene, reports, errors):
    """Rows of the scorecard, {column: value}: per stage its own errors and those against truth.

    A stage without errors has one row. The last rows are the CPU time of all stages up to the fit, and of all.

    reports : {stage: StageReport};  errors : [ErrorAgainst]
    """
    result = []
    stages = list(dict.fromkeys([*reports, *(error.stage for error in errors)]))
    for stage in stages:
        report = reports.get(stage)
        times = {column: getattr(report, column, None) for column in OF_A_REPORT}
        mine = [*(report.errors if report else ()), *(error for error in errors if error.stage == stage)]
        for error in mine or [None]:
            result.append({"scene": scene, "stage": stage, **_of_error(error), **times})
    until_fit = stages[: stages.index("fit") + 1] if "fit" in reports else []
    for name, some in (("time.until_fit", until_fit), ("time.all", stages)):
        if part := [reports[stage] for stage in some if stage in reports]:
            result.append({"scene": scene, "stage": "total", "error": name, **_total(part)})
    return result


def _of_error(error):
    """Its columns; empty ones where a stage has no error."""
    if error is None:
        return {}
    return {"error": error.name, "value": error.value, "unit": error.unit, "against": error.against}


def _total(reports):
    cpu_s, wall_s = (sum(getattr(report, key) or 0 for report in reports) for key in ("cpu_s", "wall_s"))
    peak_mb = max(report.peak_mb or 0 for report in reports)
    return {"value": cpu_s, "unit": "s", "wall_s": wall_s, "cpu_s": cpu_s, "peak_mb": peak_mb}


def _text(value):
    """
    >>> _text(0.1 + 0.2), _text(None), _text(True), _text("a")
    ('0.3', '', '1', 'a')
    """
    if value is None:
        return ""
    return format(value, ".9g") if isinstance(value, int | float) else str(value)


def write(path, rows):
    """To a path as it is (the caller sees to it that the file is whole or absent)."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([_text(row.get(column)) for column in COLUMNS] for row in rows)


def read_table(path, columns):
    """The rows of a CSV file with these columns, as dicts. BadInput names file, line and column."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            reader = csv.DictReader((line for line in file if not line.startswith("#")), strict=True)
            result = list(reader)
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such file") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not a readable CSV file: {error}") from None
    missing = [c for c in columns if c not in (reader.fieldnames or ())]
    if missing:
        raise BadInput(*(f"{path}: {c}: the column is missing" for c in missing))
    return result


# ---- bounds ----


def check(scorecard, expected):
    """The bounds that a scorecard breaks, one line each; empty if it keeps them all.

    scorecard : path of scorecard.csv          expected : path of a CSV file `error,low,high`

    An error is named as in the scorecard, or as `stage/error` where several stages have one of that name; else every
    row of that name must keep the bounds. Both ends belong to the range, and both must be there: too good usually
    means that somebody stopped looking. An error that is missing or has no value breaks its bounds too.
    """
    rows = read_table(scorecard, COLUMNS)
    violations = []
    for bound in read_table(expected, ("error", "low", "high")):
        name = (bound["error"] or "").strip()
        low, high = _number(bound["low"]), _number(bound["high"])
        if not -math.inf < low <= high < math.inf:
            violations.append(f"{expected}: {name}: low = {bound['low']}, high = {bound['high']}: is not a range")
            continue
        found = [row for row in rows if name in (row["error"], f"{row['stage']}/{row['error']}")]
        if not found:
            violations.append(f"{scorecard}: {name}: missing; it must lie in [{low:g}, {high:g}]")
        for row in found:
            value = _number(row["value"])
            if not low <= value <= high:
                how = "is above" if value > high else "is below (too good?)" if value < low else "is not in"
                said = f"{row['stage']}/{row['error']} = {row['value'] or 'nothing'}"
                violations.append(f"{scorecard}: {said} {how} [{low:g}, {high:g}]")
    return violations


def _number(text):
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan
