"""Runs of neighbouring tiles, within which errors of the model go together."""

from __future__ import annotations

import numpy as np

from lib.analysis.fit.problem import Problem

FOLDS = 4


def folds(problem: Problem) -> np.ndarray:
    """(T,) number of each tile's fold: FOLDS runs of each group's tiles, which stand facet by facet."""
    group = problem.tile_group
    order = np.argsort(group, kind="stable")
    count = np.bincount(group, minlength=len(problem.groups))
    rank = np.empty(len(group), int)
    rank[order] = np.concatenate([np.arange(n) for n in count]) if len(group) else order
    return rank * FOLDS // np.maximum(count[group], 1)
