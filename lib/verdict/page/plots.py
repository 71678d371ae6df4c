"""Plots as inline SVG: the geometry here, the marks in templates/plot.html."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from lib.verdict.page.html import finite, fixed, number, render

LEFT, RIGHT, TOP, BOTTOM = 66, 14, 12, 46  # px around the axes


class Series(NamedTuple):
    """kind : its CSS class"""

    name: str
    xs: object
    ys: object
    kind: str


class Band(NamedTuple):
    """The area between two curves."""

    xs: object
    lows: object
    highs: object


class Tick(NamedTuple):
    """at : px;  label : text"""

    at: float
    label: str


class Line(NamedTuple):
    """points : [(x, y)] px"""

    name: str
    points: list
    kind: str


class Axis(NamedTuple):
    """A line from `low` to `high`, in the data's unit or its decimal logarithm, drawn from px `start` to px `end`."""

    low: float
    high: float
    log: bool
    start: float
    end: float

    def place(self, value):
        """Of a value, px."""
        v = math.log10(value) if self.log else float(value)
        return self.start + (v - self.low) / (self.high - self.low) * (self.end - self.start)

    def ticks(self):
        """[Tick]"""
        length = self.end - self.start
        return [
            Tick(self.start + (v - self.low) / (self.high - self.low) * length, label)
            for v, label in ticks(self.low, self.high, self.log)
        ]


def ticks(low, high, log):
    """[(value, label)] between low and high, about four to seven; of a log axis all three are decimal exponents."""
    if not log:
        span = high - low
        step = 10.0 ** math.floor(math.log10(span / 4))
        step *= next((m for m in (1, 2, 5, 10) if span / (m * step) <= 6), 10)
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        return [(v, fixed(v, decimals)) for v in step * np.arange(first, last + 1)]
    span = high - low
    if span < 0.5:
        return [(math.log10(v), label) for v, label in ticks(10**low, 10**high, False) if v > 0]
    factors = (1, 2, 5) if span < 1.6 else (1, 3) if span < 2.5 else (1,)
    step = max(1, math.ceil(span / 7))
    exponents = [e for e in range(math.floor(low) - 1, math.ceil(high) + 1) if e % step == 0 or span < 2.5]
    found = [factor * 10.0**e for e in exponents for factor in factors]
    return [(math.log10(v), number(v, 2)) for v in found if low - 1e-9 <= math.log10(v) <= high + 1e-9]


def plot(
    series, *, x, y, title, logx=False, logy=False, xlim=None, ylim=None, bands=(), dots=True, width=460, height=300
):
    """Inline SVG with a key under it where there are several series; "" where no point is left.

    series : [Series]; a log axis leaves out points at or below 0;  bands : [Band];  dots : a mark at each point
    """
    found = [(s, _points(s, logx, logy)) for s in series]
    found = [(s, points) for s, points in found if points]
    if not found:
        return ""
    every = [point for _, points in found for point in points]
    across = Axis(*(xlim or _limits([p[0] for p in every], logx)), logx, LEFT, width - RIGHT)
    up = Axis(*(ylim or _limits([p[1] for p in every], logy)), logy, height - BOTTOM, TOP)

    def placed(points):
        return [(across.place(a), up.place(b)) for a, b in points]

    return render(
        "plot.html",
        title=title,
        x=x,
        y=y,
        width=width,
        height=height,
        box=(LEFT, TOP, width - RIGHT, height - BOTTOM),
        x_ticks=across.ticks(),
        y_ticks=up.ticks(),
        bands=[
            placed(zip(band.xs, band.lows, strict=True)) + placed(zip(band.xs, band.highs, strict=True))[::-1]
            for band in bands
        ],
        lines=[Line(s.name, placed(points), s.kind) for s, points in found],
        dots=dots,
    )


def _points(series, logx, logy):
    """Those that can be drawn."""
    return [
        (float(a), float(b))
        for a, b in zip(series.xs, series.ys, strict=True)
        if finite(a) and finite(b) and (a > 0 or not logx) and (b > 0 or not logy)
    ]


def _limits(values, log):
    """The ends of an axis, with some room."""
    if log:
        values = [math.log10(v) for v in values]
    low, high = min(values), max(values)
    pad = max(0.06 * (high - low), 0.15 if log else 1e-3 * max(abs(high), abs(low), 1e-6))
    return low - pad, high + pad
