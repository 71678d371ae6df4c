"""matches.csv: pairs of regions, left and right, that show the same facet."""

import csv
import math
from pathlib import Path

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput

COLUMNS = ("left_label", "right_label", "similarity")


def read_matches(path) -> list[tuple[int, int, float]]:
    """[(left label, right label, similarity)] of matches.csv, best first.  BadInput names line, column and value."""
    try:
        rows = list(csv.reader(bounded.text(path).splitlines(), strict=True))
    except csv.Error as error:
        raise BadInput(f"{path}: not a readable CSV file: {error}") from None
    if not rows or tuple(rows[0]) != COLUMNS:
        raise BadInput(f"{path}: header: {','.join(rows[0]) if rows else 'nothing'!r} is not {','.join(COLUMNS)!r}")
    matches, seen = [], (set(), set())
    for line, row in enumerate(rows[1:], 2):
        try:
            match = int(row[0]), int(row[1]), float(row[2])
            if len(row) != 3 or not math.isfinite(match[2]) or max(match[:2]) >= 1 << 31 or min(match[:2]) < 0:
                raise ValueError
        except (ValueError, IndexError):
            raise BadInput(f"{path}: line {line}: {','.join(row)!r} is not two labels and a number") from None
        for name, label, known in zip(COLUMNS, match, seen, strict=False):
            if label in known:
                raise BadInput(f"{path}: line {line}: {name}: {label} stands there twice")
            known.add(label)
        matches.append(match)
    return matches


def read_matched_labels(path, labels_left, labels_right) -> tuple[np.ndarray, np.ndarray]:
    """(M,) left and right labels of matches.csv; BadInput where one is not in its picture (H, W)."""
    pairs = np.array([match[:2] for match in read_matches(path)], int).reshape(-1, 2)
    for side, labels in enumerate((labels_left, labels_right)):
        missing = np.flatnonzero(~np.isin(pairs[:, side], labels) | (pairs[:, side] == 0))
        if len(missing):
            line, label = missing[0] + 2, pairs[missing[0], side]
            raise BadInput(f"{path}: line {line}: {COLUMNS[side]}: {label} is not in the label image")
    return pairs[:, 0], pairs[:, 1]


def write_matches(path, matches):
    """To a path as it is; matches : [(left label, right label, similarity)]."""
    lines = [",".join(COLUMNS), *(f"{left},{right},{similarity:.6f}" for left, right, similarity in matches)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
