"""A walk: a law, and the places at which it is asked, often towards a point where it must break or be refused.

    @walk("balance", "rho towards 1", law="B = E / (1 - rho)", axis="1 - rho", at=[0.5, 1e-2, 1e-6], short=[0, 2])
    def furnace(x):
        ...
        return near(B, 1 / x, bound, iterations=n)

`at` are numbers, which are the curve's axis, or names. Three of them at most are `short`, by their position.
"""

import math
import os
import traceback
from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Found(NamedTuple):
    """What one place of a walk gave. It holds where error <= bound, both of the same unit."""

    value: float | None
    truth: float | None
    error: float
    bound: float
    iterations: int | None = None
    note: str = ""

    @property
    def holds(self):
        return math.isfinite(self.error) and self.error <= self.bound


def near(value, truth, bound, *, relative=False, iterations=None, note=""):
    """The largest error of values against truths, both numbers or arrays, and one value that has it."""
    value, truth = np.broadcast_arrays(np.asarray(value, float), np.asarray(truth, float))
    error = np.abs(value - truth)
    if relative:
        error = error / np.maximum(np.abs(truth), 1e-300)
    error = np.where(np.isfinite(value), error, np.inf)
    k = np.unravel_index(int(error.argmax()), error.shape) if error.size else None
    worst = (0.0, 0.0, 0.0) if k is None else (float(value[k]), float(truth[k]), float(error[k]))
    return Found(*worst, float(bound), None if iterations is None else int(iterations), note)


def at_most(value, bound, *, iterations=None, note=""):
    """A measure that must be 0 and may be so much."""
    return near(value, 0.0, bound, iterations=iterations, note=note)


def refused(work: Callable, words: str, kinds=(ValueError,)):
    """The law is a refusal: work must raise one line that has these words."""
    try:
        work()
    except kinds as error:
        text = str(error)
        said = words in text and "\n" not in text
        return Found(None, None, 0.0 if said else 1.0, 0.0, None, f"refused: {text[:100]}")
    return Found(None, None, 1.0, 0.0, None, "not refused")


def cpu_s():
    """Of this process and of those that it has waited for."""
    return sum(os.times()[:4])


class Point(NamedTuple):
    """A place of a walk, and what was found there."""

    place: object
    found: Found
    cpu_s: float


class Walk(NamedTuple):
    """part, name, law : for people;  axis : of numbers, else "";  at : places;  short : positions of the first asked"""

    part: str
    name: str
    law: str
    axis: str
    at: tuple
    short: tuple
    ask: Callable

    def places(self, whole):
        return [self.at[k] for k in (range(len(self.at)) if whole else self.short)]

    def point(self, place) -> Point:
        """An error of the code is a law that is broken."""
        began = cpu_s()
        try:
            found = self.ask(place)
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            note = f"{type(error).__name__}: {str(error).splitlines()[0][:120] if str(error) else ''} ({where.name})"
            found = Found(None, None, math.inf, 0.0, None, note)
        return Point(place, found, cpu_s() - began)


WALKS: list[Walk] = []


def walk(part, name, *, law, at, short=None, axis=""):
    """The function below is asked at each of `at`; short: by default the first, the middle one and the last."""
    at = tuple(at)
    if short is None:
        short = sorted({0, len(at) // 2, len(at) - 1})

    def kept(ask):
        WALKS.append(Walk(part, name, law, axis, at, tuple(k % len(at) for k in short), ask))
        return ask

    return kept


def every():
    """All walks, part by part."""
    from tests.verify import factors, balance, gloss, photometry, vision, told_otherwise  # noqa: F401, I001  in this order

    return WALKS
