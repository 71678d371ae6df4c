"""What came out against what is true: the scorecard, and its two-sided bounds.

`against_truth` needs no file of another stage; whatever is missing is left out.  A residual is not an error: a re-rendering may
agree with the photograph to 0.5 % while its reflectances are 17 % off (gamma and rho share a valley), so both are listed.

Names of errors are stable (tests/expected/<scene>.csv refers to them):

    reflectance.mean_relative     mean |rho / rho* - 1| over channels of the counted groups
    reflectance.max_relative, reflectance.max_absolute
    reflectance.within_3_sigma    share of the channels with |rho - rho*| <= 3 sigma; a channel without sigma is outside
    reflectance.median_sigma
    reflectance.unidentified      counted groups without a value of their own
    reflectance.groups            counted groups
    small.<...>                   the same over groups too small to be counted
    gamma.absolute, gamma.in_sigmas          lamp.mean_relative, lamp.max_relative (lamps that were unknown)
    index.differ, index.differ_all           share of pixels of another group: away from edges, and of all
    object.differ, object.differ_all         depth.median_relative
    render.rmse, render.ciede2000            against the photograph, from rendered.json

Counted is a group with at least 500 pixels in truth's group image that is neither a lamp nor given as a reference.
"""
from __future__ import annotations

import csv
import math
from pathlib import Path

from lib import artefact
from lib.stage import BadInput

ENOUGH_PX = 500
COLUMNS = ("scene", "stage", "error", "value", "unit", "against", "wall_s", "cpu_s", "peak_mb", "status")
CHANNELS = ("rho_d", "rho_s")


# ---- what is read ----

def read_materials(path):
    """materials.json or truth's.  BadInput names file, group, field and value."""
    materials = artefact.read_json(path)
    problems = []

    def number(value):
        return isinstance(value, (int, float)) and not isinstance(value, bool)

    def triple(where, value):
        if value is not None and not (isinstance(value, list) and len(value) == 3 and all(map(number, value))):
            problems.append(f"{path}: {where} = {value!r} is neither null nor three numbers")

    if not isinstance(materials, dict) or not isinstance(materials.get("groups"), dict):
        raise BadInput(f"{path}: groups: missing, or not a table of groups")
    for field in ("groups", "lamps"):
        for name, entry in (materials.get(field) or {}).items():
            if not isinstance(entry, dict):
                problems.append(f"{path}: {field}.{name} = {entry!r} is not a table")
                continue
            for key in (*CHANNELS, "emittance"):
                triple(f"{field}.{name}.{key}", entry.get(key))
            sigma = entry.get("sigma")
            if field == "lamps":
                triple(f"{field}.{name}.sigma", sigma)
            elif sigma is not None and not isinstance(sigma, dict):
                problems.append(f"{path}: {field}.{name}.sigma = {sigma!r} is not a table")
            else:
                for key in CHANNELS:
                    triple(f"{field}.{name}.sigma.{key}", (sigma or {}).get(key))
    if problems:
        raise BadInput(*problems)
    return materials


def read_reports(paths):
    """{stage: report}, in the given order; the stage is the file's name without `.report.json`."""
    return {Path(path).name.removesuffix(".report.json"): artefact.read_json(path) for path in paths}


def read_legend(path):
    legend = artefact.read_json(path)
    for key in ("groups", "objects"):
        if not (isinstance(legend, dict) and isinstance(legend.get(key), list) and all(isinstance(n, str) for n in legend[key])):
            raise BadInput(f"{path}: {key}: missing, or not a list of names")
    return legend


# ---- reflectances ----

def given(materials, reports):
    """(reference groups, given lamps): what the fit was told, so that it is no finding.

    The fit's report says what it was told.  Without it, a sigma of zero or none marks what was given.
    """
    told = ((reports.get("fit") or {}).get("arguments") or {})
    reference = set(told["reference"] or ()) if isinstance(told.get("reference"), dict) else {
        name for name, g in materials["groups"].items()
        if g.get("rho_d") is not None and (g.get("sigma") or {}).get("rho_d") == [0, 0, 0]}
    lamps = told.get("lamps")
    known = {name for name, lamp in (materials.get("lamps") or {}).items()
             if (lamps.get(name) != "unknown" if isinstance(lamps, dict) else not lamp.get("sigma"))}
    return reference, known


def reflectances(materials, truth, pixels, reference=(), enough_px=ENOUGH_PX):
    """{group: comparison} for every group of truth that is no lamp.

    pixels : {group: pixels in truth's group image}

    >>> wall = {"rho_d": [0.5, 0.5, 0.4], "sigma": {"rho_d": [0.01, 0.001, 0.01]}, "identified": True}
    >>> true = {"rho_d": [0.5, 0.51, 0.4]}
    >>> c = reflectances({"groups": {"wall": wall}}, {"groups": {"wall": true}}, {"wall": 900})["wall"]
    >>> c["counted"], [round(r, 4) for r in c["rho_d"]["relative"]], [round(s) for s in c["rho_d"]["in_sigmas"]]
    (True, [0.0, -0.0196, 0.0], [0, -10, 0])
    """
    lamps = set(truth.get("lamps") or ()) | set(materials.get("lamps") or ())
    result = {}
    for name, true in truth["groups"].items():
        if name in lamps or true.get("rho_d") is None:
            continue
        found = materials["groups"].get(name) or {}
        n = int(pixels.get(name, 0))
        entry = {"pixels": n, "given": name in reference, "identified": bool(found.get("identified", True)) and found.get("rho_d") is not None,
                 "counted": n >= enough_px and name not in reference}
        for key in CHANNELS:
            value, true_value = found.get(key), true.get(key)
            if true_value is None or (key != "rho_d" and not any(true_value) and not any(value or ())):
                continue
            entry[key] = {"truth": true_value}
            if value is not None:
                sigma = (found.get("sigma") or {}).get(key)
                absolute = [a - b for a, b in zip(value, true_value)]
                entry[key] |= {"value": value, "sigma": sigma, "absolute": absolute,
                               "relative": [d / t if t else None for d, t in zip(absolute, true_value)],
                               "in_sigmas": [d / s if s else (0.0 if d == 0 else None) for d, s in zip(absolute, sigma or (None,) * 3)]}
        result[name] = entry
    return result


def _summary(groups, prefix):
    """Errors over the groups of `reflectances` that take part."""
    known = [g[key] for g in groups for key in CHANNELS if "value" in g.get(key, ()) and g["identified"]]
    absolute = [abs(d) for c in known for d in c["absolute"]]
    relative = [abs(r) for c in known for r in c["relative"] if r is not None]
    z = [s for c in known for s in c["in_sigmas"]]
    sigma = [s for c in known for s in c["sigma"] or ()]
    errors = []
    if relative:
        errors += [("mean_relative", sum(relative) / len(relative)), ("max_relative", max(relative))]
    if absolute:
        errors += [("max_absolute", max(absolute)), ("within_3_sigma", sum(s is not None and abs(s) <= 3 + 1e-9 for s in z) / len(z))]
    if sigma:
        errors.append(("median_sigma", median(sigma)))
    errors += [("unidentified", sum(not g["identified"] for g in groups)), ("groups", len(groups))]
    return [(f"{prefix}.{name}", value, "groups" if name in ("unidentified", "groups") else "1") for name, value in errors]


def median(values):
    """
    >>> median([3, 1, 2]), median([1, 2])
    (2, 1.5)
    """
    values = sorted(values)
    middle = len(values) // 2
    return values[middle] if len(values) % 2 else (values[middle - 1] + values[middle]) / 2


# ---- index buffers ----

def count_pixels(labels, names):
    """{name: pixels} of an image of index + 1."""
    import numpy as np

    counts = np.bincount(labels.ravel(), minlength=len(names) + 1)
    return {name: int(counts[i + 1]) for i, name in enumerate(names)}


def differ(labels, names, true_labels, true_names):
    """(share of pixels of another name away from truth's edges, share of all pixels).

    An edge is where a pixel and one of its eight neighbours differ in truth; both of them lie at it.
    The first is None where every pixel lies at an edge.
    """
    import numpy as np

    ids = {name: i for i, name in enumerate(dict.fromkeys([*names, *true_names]), start=1)}
    ours, true = (np.array([0, *(ids[n] for n in which)])[image] for which, image in ((names, labels), (true_names, true_labels)))
    edge = np.zeros(true.shape, bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, true.shape[0] - dy), slice(max(0, -dx), true.shape[1] - max(0, dx)))
        b = (slice(dy, None), slice(max(0, dx), true.shape[1] + min(0, dx)))
        step = true[a] != true[b]
        edge[a] |= step
        edge[b] |= step
    other = ours != true
    inside = ~edge
    return (float(other[inside].mean()) if inside.any() else None), float(other.mean())


# ---- all of it ----

def against_truth(*, materials=None, reports=None, truth=None, images=None, true_images=None, legend=None, true_legend=None, scores=None):
    """(errors [{stage, name, value, unit, against}], details for compare.json) from what there is.

    images, true_images : {"group", "object": (H, W) int; "depth": (H, W) float}
    """
    reports, images, true_images = reports or {}, images or {}, true_images or {}
    errors, details = [], {}

    def add(stage, name, value, unit="1", against="truth"):
        if value is not None:
            errors.append({"stage": stage, "name": name, "value": value, "unit": unit, "against": against})

    true_names = true_legend or legend
    pixels = {}
    if "group" in true_images and true_names:
        pixels = count_pixels(true_images["group"], true_names["groups"])
    elif "group" in images and legend:
        pixels = count_pixels(images["group"], legend["groups"])
    if materials and truth:
        reference, known_lamps = given(materials, reports)
        groups = details["groups"] = reflectances(materials, truth, pixels, reference)
        for prefix, members in (("reflectance", [g for g in groups.values() if g["counted"]]),
                                ("small", [g for g in groups.values() if not g["counted"] and not g["given"] and g["pixels"] > 0])):
            if members:
                for name, value, unit in _summary(members, prefix):
                    add("fit", name, value, unit)
        _transfer(materials, truth, add, details)
        _lamps(materials, truth, known_lamps, add, details)
    if legend and true_names:
        for kind, error in (("group", "index"), ("object", "object")):
            if kind in images and kind in true_images and set(true_names[kind + "s"]) and images[kind].shape == true_images[kind].shape:
                inner, every = differ(images[kind], legend[kind + "s"], true_images[kind], true_names[kind + "s"])
                add("index", f"{error}.differ", inner)
                add("index", f"{error}.differ_all", every)
    if "depth" in images and "depth" in true_images and images["depth"].shape == true_images["depth"].shape:
        a, b = images["depth"], true_images["depth"]
        both = (a > 0) & (b > 0)
        if both.any():
            add("index", "depth.median_relative", median(list(abs(a[both] / b[both] - 1))))
    for key, unit in (("rmse", "1"), ("ciede2000", "CIEDE2000")):
        if isinstance((scores or {}).get(key), (int, float)):
            add("render", f"render.{key}", scores[key], unit, "photograph")
    return errors, details


def _transfer(materials, truth, add, details):
    found, true = (m.get("transfer") or {} for m in (materials, truth))
    if true.get("kind"):
        details["transfer"] = {"value": found, "truth": true}
    if found.get("kind") == true.get("kind") == "gamma":
        error = found["gamma"] - true["gamma"]
        add("fit", "gamma.absolute", abs(error))
        if found.get("sigma"):
            add("fit", "gamma.in_sigmas", abs(error) / found["sigma"], "sigma")


def _lamps(materials, truth, known, add, details):
    entries, relative = {}, []
    for name, true in (truth.get("lamps") or {}).items():
        found = (materials.get("lamps") or {}).get(name) or {}
        value, true_value = found.get("emittance"), true.get("emittance")
        entries[name] = {"given": name in known, "value": value, "truth": true_value, "sigma": found.get("sigma")}
        if value and true_value:
            entries[name]["relative"] = [v / t - 1 if t else None for v, t in zip(value, true_value)]
            if name not in known:
                relative += [abs(r) for r in entries[name]["relative"] if r is not None]
    if entries:
        details["lamps"] = entries
    if relative:
        add("fit", "lamp.mean_relative", sum(relative) / len(relative))
        add("fit", "lamp.max_relative", max(relative))


# ---- the scorecard ----

def _text(value):
    """
    >>> _text(0.1 + 0.2), _text(None), _text(True), _text("a")
    ('0.3', '', '1', 'a')
    """
    if value is None:
        return ""
    return format(value, ".9g") if isinstance(value, (int, float)) else str(value)


def scorecard(scene, reports, errors):
    """Rows of scorecard.csv: per stage, its own errors and those against truth beside its times; one row where it has none.

    Ends with the CPU time of all stages up to the fit, and of all.
    """
    rows = []
    stages = list(dict.fromkeys([*reports, *(e["stage"] for e in errors)]))
    for stage in stages:
        report = reports.get(stage) or {}
        mine = [*(report.get("errors") or []), *(e for e in errors if e["stage"] == stage)]
        for error in mine or [{}]:
            rows.append({"scene": scene, "stage": stage, "error": error.get("name"), "value": error.get("value"), "unit": error.get("unit"),
                         "against": error.get("against"), **{k: report.get(k) for k in ("wall_s", "cpu_s", "peak_mb", "status")}})
    for name, until in (("time.until_fit", "fit"), ("time.all", None)):
        if until is None or until in reports:
            part = [reports[s] for s in (stages[:stages.index(until) + 1] if until else stages) if s in reports]
            if part:
                total = {k: sum(p.get(k) or 0 for p in part) for k in ("wall_s", "cpu_s")}
                rows.append({"scene": scene, "stage": "total", "error": name, "value": total["cpu_s"], "unit": "s", "against": None,
                             **total, "peak_mb": max(p.get("peak_mb") or 0 for p in part), "status": None})
    return rows


def write_scorecard(path, rows):
    """To a path as it is (the caller sees to it that the file is whole or absent)."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([_text(row.get(column)) for column in COLUMNS] for row in rows)


def read_table(path, columns):
    """The rows of a CSV file with these columns, as dicts.  BadInput names file, line and column."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            reader = csv.DictReader((line for line in file if not line.startswith("#")), strict=True)
            rows = list(reader)
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such file") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not a readable CSV file: {error}") from None
    missing = [c for c in columns if c not in (reader.fieldnames or ())]
    if missing:
        raise BadInput(*(f"{path}: {c}: the column is missing" for c in missing))
    return rows


def check(scorecard, expected):
    """The bounds that a scorecard breaks, one line each; empty if it keeps them all.

    scorecard : path of scorecard.csv          expected : path of a CSV file `error,low,high`

    An error is named as in the scorecard, or as `stage/error` where several stages have one of that name; else every row of that
    name must keep the bounds.  Both bounds belong to the range, both must be there: too good usually means that somebody stopped
    looking.  An error that is missing or has no value breaks them too.
    """
    rows = read_table(scorecard, COLUMNS)
    violations = []
    for bound in read_table(expected, ("error", "low", "high")):
        name = (bound["error"] or "").strip()
        try:
            low, high = float(bound["low"]), float(bound["high"])
        except (TypeError, ValueError):
            low = high = math.nan
        if not low <= high or not (math.isfinite(low) and math.isfinite(high)):
            violations.append(f"{expected}: {name}: low = {bound['low']}, high = {bound['high']}: is not a range")
            continue
        found = [row for row in rows if name in (row["error"], f"{row['stage']}/{row['error']}")]
        if not found:
            violations.append(f"{scorecard}: {name}: missing; it must lie in [{low:g}, {high:g}]")
        for row in found:
            try:
                value = float(row["value"])
            except ValueError:
                value = math.nan
            if not low <= value <= high:
                how = "is above" if value > high else "is below (too good?)" if value < low else "is not in"
                violations.append(f"{scorecard}: {row['stage']}/{row['error']} = {row['value'] or 'nothing'} {how} [{low:g}, {high:g}]")
    return violations
