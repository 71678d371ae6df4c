"""<stage>.report.json as a record: what a stage says of itself, and what the page shows of a stage's own fields."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from lib.core import artefact, record
from lib.core.record import list_of, list_with, number, part, table, table_with, told, word
from lib.core.stage import BadInput


@dataclass(frozen=True)
class Error:
    """An error that the stage sees itself, with its unit and its yardstick."""

    name: str | None = told(word())
    value: float | None = told(number())
    unit: str | None = told(word())
    against: str | None = told(word())


@dataclass(frozen=True)
class LadderSummary:
    """What `fit` says of the reflectance ladder. Of each judged group the display RMSE beyond noise:

    diffuse : as a diffuse surface;  end : in the end, only where something climbed
    rungs : of those that climbed;  rays : what was spent, by purpose
    """

    threshold: float | None = told(number())
    diffuse: dict = told(table_with(number(), "numbers"), dict)
    end: dict = told(table_with(number(), "numbers"), dict)
    rungs: dict = told(table_with(word(), "words"), dict)
    rays: dict = told(table_with(number(), "numbers"), dict)


@dataclass(frozen=True)
class TransferModel:
    """A row of `render`: what one transfer function leaves (lib/picture/display.transfer_models).

    rmse : of the same light shown through it;  rmse_refitted : after each group's reflectance was fitted again under it
    """

    kind: str | None = told(word())
    rmse: float | None = told(number())
    rmse_refitted: float | None = told(number())
    note: str | None = told(word())


@dataclass(frozen=True)
class Question:
    """A row of `fit`: whether a cause explains the picture better (lib/analysis/causes/questions.py).

    promised : nats of held-out tiles, by one step;  nats : of the fit;  dse : standard error of either, over groups
    """

    cause: str | None = told(word())
    beside: list = told(list_with(word(), "words"), list)
    promised: float | None = told(number())
    nats: float | None = told(number())
    dse: float | None = told(number())
    least: float | None = told(number())
    decision: str | None = told(word())


class Seconds(NamedTuple):
    """Of the processor and on the clock; None where the report does not say."""

    cpu: float | None
    wall: float | None


@dataclass(frozen=True)
class StageReport:
    """cpu_s, wall_s : counted, that is without what is in `apart`: {"imports", "compile", ...: Seconds}"""

    status: str | None = told(word())
    cpu_s: float | None = told(number())
    wall_s: float | None = told(number())
    peak_mb: float | None = told(number())
    warnings: list = told(list_with(word(), "words"), list)
    notes: list = told(list_with(word(), "words"), list)
    errors: list = list_of(Error)
    trace: list = told(list_with(table, "tables"), list)
    arguments: dict = told(table, dict)
    versions: dict = told(table, dict)
    inputs: dict = told(table, dict)
    ladder: LadderSummary | None = part(LadderSummary, absent=True)
    misfit: float | None = told(number())
    transfer_models: list = list_of(TransferModel)
    questions: list = list_of(Question)
    losses: dict = told(table, dict)
    apart: dict | None = None

    @property
    def waited_s(self):
        """Seconds on the clock from the start of the interpreter to the report: all that a user waits."""
        return sum(seconds or 0 for seconds in (self.wall_s, *(s.wall for s in (self.apart or {}).values())))


def read(path) -> StageReport:
    """Of a stage that ran again with a refined model: with the time of its first run, in draft/ beside it.

    BadInput names file, field and value.
    """
    report, first = of(artefact.read_json(path), path), Path(path).parent / "draft" / Path(path).name
    refined = [value for name, value in report.arguments.items() if name.startswith("refined_") and value]
    again = any(Path(str(path)).parent.name != first.parent.name for path in refined)
    return _together(report, of(artefact.read_json(first), first)) if again and first.exists() else report


def _together(report, first):
    """The report of two runs: what the second says, and the time of both."""
    added = lambda a, b: (a or 0) + (b or 0)
    apart = dict(first.apart)
    for label, seconds in report.apart.items():
        before = apart.get(label, Seconds(0, 0))
        apart[label] = Seconds(added(seconds.cpu, before.cpu), added(seconds.wall, before.wall))
    time = {key: added(getattr(report, key), getattr(first, key)) for key in ("cpu_s", "wall_s")}
    return replace(report, **time, peak_mb=max(report.peak_mb or 0, first.peak_mb or 0), apart=apart)


def of(content, path) -> StageReport:
    """The same of JSON that was read from path."""
    return replace(record.of(content, path, StageReport), apart=_apart(content, path))


def _apart(content, path):
    """{label: Seconds} of the pairs <label>_s, <label>_wall_s."""
    labels = [key.removesuffix("_wall_s") for key in content if key.endswith("_wall_s")]
    found = {label: Seconds(content.get(f"{label}_s"), content[f"{label}_wall_s"]) for label in labels}
    for label, seconds in found.items():
        if not all(isinstance(s, int | float) for s in seconds):
            raise BadInput(f"{path}: {label}_s, {label}_wall_s = {seconds.cpu!r}, {seconds.wall!r} are not numbers")
    return found


def read_all(paths) -> dict:
    """{stage: StageReport}, in the given order; the stage is the file's name without `.report.json`."""
    return {Path(path).name.removesuffix(".report.json"): read(path) for path in paths}
