"""The comparison of what came out with what is true: every kind of error, in the order of the pipeline's photometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.verdict import index_errors, material_errors, vision_errors
from lib.verdict.answers import Answers
from lib.verdict.comparison import Comparison, ErrorAgainst


def compare(found: Answers, true: Answers, reports, albedo=None) -> Comparison:
    """Errors and details from what there is; what is missing on either side is left out.

    reports : {stage: StageReport};  albedo : of `texture_errors.albedos`, or None
    """
    errors, details = [], Comparison()
    if found.materials and true.materials:
        fit = reports.get("fit")
        given = material_errors.what_was_given(found.materials, fit.arguments if fit else {})
        pixels = _pixels_of_groups(found, true)
        errors, details = material_errors.compare(found.materials, true.materials, pixels, given, albedo)
    errors = [*errors, *_index(found, true), *_against_the_photograph(found.scores)]
    for stage, name, value, unit in vision_errors.against_truth(found, true):
        errors.append(ErrorAgainst(stage, name, value, unit, "truth"))
    return replace(details, errors=errors)


def _pixels_of_groups(found: Answers, true: Answers):
    """{group: pixels}, in truth's group image where there is one."""
    legend = true.legend or found.legend
    if true.group is not None and legend:
        return index_errors.count_pixels(true.group, legend.groups)
    if found.group is not None and found.legend:
        return index_errors.count_pixels(found.group, found.legend.groups)
    return {}


def _index(found: Answers, true: Answers):
    legend, true_legend = found.legend, true.legend or found.legend
    errors = []
    for kind, name in (("group", "index"), ("object", "object")):
        ours, theirs = getattr(found, kind), getattr(true, kind)
        if legend and _same_size(ours, theirs) and true_legend.names(kind):
            inner, every = index_errors.differ(ours, legend.names(kind), theirs, true_legend.names(kind))
            errors += [(f"{name}.differ", inner), (f"{name}.differ_all", every)]
    errors += _mirror(found, true, legend, true_legend)
    if _same_size(found.depth, true.depth):
        errors.append(("depth.median_relative", index_errors.depth_error(found.depth, true.depth)))
    return [ErrorAgainst("index", name, value, "1", "truth") for name, value in errors if value is not None]


def _mirror(found: Answers, true: Answers, legend, true_legend):
    """What mirrors show; where none was found they show nothing."""
    if true.mirror is None or not (found.materials and legend and true_legend.names("group")):
        return []
    ours = np.zeros_like(true.mirror) if found.mirror is None else found.mirror
    if not _same_size(ours, true.mirror):
        return []
    seen = (ours > 0) | (true.mirror > 0)
    inner, every = index_errors.differ(ours, legend.names("group"), true.mirror, true_legend.names("group"), seen)
    return [("mirror.differ", inner), ("mirror.differ_all", every)]


def _same_size(ours, theirs):
    return ours is not None and theirs is not None and ours.shape == theirs.shape


def _against_the_photograph(scores):
    """The re-rendering, from rendered.json."""
    errors = [("rmse", "1", scores.rmse), ("ciede2000", "CIEDE2000", scores.ciede2000)] if scores else []
    return [
        ErrorAgainst("render", f"render.{name}", value, unit, "photograph")
        for name, unit, value in errors
        if value is not None
    ]
