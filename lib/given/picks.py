"""pose.csv and pose-lines.csv: where points and straight lines of the model were picked in the photograph."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, replace

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import reduced

POINT = ("x_px", "y_px", "X", "Y", "Z")
LINE = ("x1_px", "y1_px", "x2_px", "y2_px", "X1", "Y1", "Z1", "X2", "Y2", "Z2")
FURTHER = ("sigma_px", "name")
LARGEST = 1e9  # px or m: what is larger is no picked place
LEAST = 4  # places that tell a pose
SPREADSHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")  # first bytes: .xlsx and .ods, .xls


@dataclass(frozen=True, eq=False)
class Picks:
    """Points and lines that were picked.

    q : (n, 2) px;  p : (n, 3) m, world;  sigma : (n,) px;  names : n of them, of the file or its lines' numbers
    ends : (m, 2, 2) px of lines, which need not be those of p_ends : (m, 2, 3) m;  sigma_ends : (m,);  line_names
    """

    q: np.ndarray
    p: np.ndarray
    sigma: np.ndarray
    names: tuple
    ends: np.ndarray
    p_ends: np.ndarray
    sigma_ends: np.ndarray
    line_names: tuple

    def straightened(self, lens, camera) -> Picks:
        """As a pinhole camera would have shown the same. lens : lenses.Lens;  BadInput: beyond what the lens shows"""
        bare = replace(camera, T_cam_world=np.eye(4))
        q, ends = (bare.project(lens.unproject(places)) for places in (self.q, self.ends.reshape(-1, 2)))
        for name, place in zip((*self.names, *np.repeat(self.line_names, 2)), (*q, *ends), strict=True):
            if not np.isfinite(place).all():
                raise BadInput(f"{name}: lies where no light comes through the lens of {lens.path}")
        return replace(self, q=q, ends=ends.reshape(-1, 2, 2))


def read(points=None, lines=None) -> Picks:
    """points, lines : paths of pose.csv and pose-lines.csv, or None.  BadInput names line, column and value."""
    q, sigma, names = _table(points, POINT) if points else (np.zeros((0, 5)), np.zeros(0), ())
    e, sigma_ends, line_names = _table(lines, LINE) if lines else (np.zeros((0, 10)), np.zeros(0), ())
    ends, p_ends = e[:, :4].reshape(-1, 2, 2), e[:, 4:].reshape(-1, 2, 3)
    for where, values, of in (("the picture", ends, line_names), ("the model", p_ends, line_names)):
        for name, (a, b) in zip(of, values, strict=True):
            if (a == b).all():
                raise BadInput(f"{lines}: {name}: both ends are the same point of {where}")
    return Picks(q[:, :2], q[:, 2:], sigma, names, ends, p_ends, sigma_ends, line_names)


def write_with(path, points, p, k=1):
    """The points of a file as another one, with other X, Y, Z, in a photograph k times smaller. p : (n, 3) m"""
    header, rows = _rows(points)
    for (_, row), place in zip(rows, p, strict=True):
        cell = dict(zip(header, row, strict=True))
        new = dict(zip(POINT[2:], place, strict=True))
        if k > 1:
            new |= {name: reduced.place(float(cell[name]), k) for name in POINT[:2]}
            new |= {"sigma_px": float(cell["sigma_px"]) / k} if "sigma_px" in cell else {}
        for name, value in new.items():
            row[header.index(name)] = f"{value:.9g}"
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *(row for _, row in rows)])


def _table(path, columns):
    """(values (n, k), sigma (n,), names) of a file with these columns, in any order, and perhaps more."""
    header, rows = _rows(path)
    if len(header) == 1 and "\t" in header[0]:
        raise BadInput(f"{path}: header: {header[0]!r} is parted by tabs: use commas, and a point for decimals")
    if len(header) == 1 and ";" in header[0]:
        raise BadInput(f"{path}: header: {header[0]!r} is parted by semicolons: use commas, and a point for decimals")
    unknown = [name for name in header if name not in (*columns, *FURTHER)]
    missing = [name for name in columns if name not in header]
    if unknown or missing or len(set(header)) < len(header):
        wanted = f"{','.join(columns)}, perhaps with {' and '.join(FURTHER)}"
        raise BadInput(f"{path}: header: {','.join(header)!r} is not {wanted}")
    values, sigma, names = [], [], []
    for line, row in rows:
        where = f"{path}: line {line}"
        if len(row) != len(header):
            raise BadInput(f"{where}: {','.join(row)!r} has {len(row)} values, the header has {len(header)}")
        cell = dict(zip(header, row, strict=True))
        values.append([_number(where, name, cell[name]) for name in columns])
        sigma.append(_number(where, "sigma_px", cell.get("sigma_px", "1")))
        if not sigma[-1] > 0:
            raise BadInput(f"{where}: sigma_px: {cell['sigma_px']!r} is not positive")
        names.append(cell.get("name") or f"line {line}")
    # several corners of one thing may bear its name
    names = [name if names.count(name) == 1 else f"{name}, line {k}" for name, (k, _) in zip(names, rows, strict=True)]
    return np.array(values, float).reshape(-1, len(columns)), np.array(sigma), tuple(names)


def commented(path) -> int:
    """How many lines begin with # and have as many values as the header: rows that are left out, perhaps unmeant."""
    header, _ = _rows(path)
    lines = [line.lstrip() for line in bounded.text(path).splitlines()]
    return sum(line.startswith("#") and line.count(",") == len(header) - 1 for line in lines)


def _rows(path):
    """(header, [(number of the line, cells)]), without comments, empty lines, and columns without any name or value."""
    content = bounded.content(path, bounded.LARGEST_TEXT)
    if content.startswith(SPREADSHEETS):
        raise BadInput(f"{path}: is a spreadsheet: save it as CSV with commas, and a point for decimals")
    lines = bounded.text_of(path, content).splitlines()
    kept = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    try:
        cells = [[cell.strip() for cell in next(csv.reader([line], strict=True))] for _, line in kept]
    except csv.Error as error:
        raise BadInput(f"{path}: not a readable CSV file: {error}") from None
    if not cells:
        raise BadInput(f"{path}: holds nothing: the first line is to be the header")
    while cells[0] and not any(row[len(cells[0]) - 1 :] != [""] for row in cells if any(row)):  # of a spreadsheet
        cells = [row[: len(cells[0]) - 1] for row in cells]
    return cells[0], [(k, row) for (k, _), row in zip(kept[1:], cells[1:], strict=True) if any(row)]


def _number(where, name, text):
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < LARGEST:
        raise BadInput(f"{where}: {name}: {text!r:.80} is not a number of at most {LARGEST:g}")
    return value
