"""Records: dataclasses that a JSON file holds, each field with the rule that its value must keep.

    @dataclass(frozen=True)
    class Lamp:
        emittance: tuple | None = told(numbers(3, 0))     # null, or three numbers of at least 0

    @dataclass(frozen=True)
    class Light:
        lamps: dict = table_of(Lamp)                      # other records, by name

    light = record.read("light.json", Light)
    artefact.write_json("light.json", record.plain(light))

A field may be missing unless it is `needed`. It is then None or empty, never a guess. Other keys are ignored.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field, fields

from lib.core import artefact
from lib.core.stage import BadInput

LARGEST = 1e15  # of any number
NUMERALS = {2: "two", 3: "three", 6: "six"}


class Wrong(Exception):
    """What is wrong with one value; the reader names the file and the field."""


# ---- rules: each takes what JSON holds and returns what the dataclass holds, or raises Wrong ----


def _is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


def number(low=-math.inf, high=math.inf):
    """A number from low to high, as it is."""

    def rule(value):
        if not _is_number(value):
            raise Wrong("is neither null nor a number")
        _inside([value], low, high)
        return value

    return rule


def numbers(count, low=-math.inf, high=math.inf):
    """So many numbers from low to high, as a tuple of floats."""

    def rule(value):
        if not (isinstance(value, list) and len(value) == count and all(map(_is_number, value))):
            raise Wrong(f"is neither null nor {NUMERALS.get(count, count)} numbers")
        _inside(value, low, high)
        return tuple(map(float, value))

    return rule


def matrix(rows=None, columns=None, unknown=False):
    """A list of lists of equal length, as a tuple of tuples of floats. unknown : null may stand for a number"""

    def rule(value):
        good = isinstance(value, list) and all(isinstance(row, list) for row in value)
        good = good and rows in (None, len(value)) and len({*map(len, value)} | ({columns} if columns else set())) <= 1
        if not (good and all(_is_number(v) or (unknown and v is None) for row in value for v in row)):
            size = f"{rows or 'n'} x {columns or 'm'}"
            raise Wrong(f"is neither null nor {size} numbers in lists of one length")
        _inside([v for row in value for v in row if v is not None], -LARGEST, LARGEST)
        return tuple(tuple(v if v is None else float(v) for v in row) for row in value)

    return rule


def _inside(values, low, high):
    if max(map(abs, values), default=0) > LARGEST:
        raise Wrong(f"is larger than {LARGEST:g}")
    if any(value < low or value > high for value in values):
        raise Wrong("is negative" if (low, high) == (0, math.inf) else f"is outside [{low:g}, {high:g}]")


def word(*known):
    """Text; one of these where there are any."""

    def rule(value):
        if not isinstance(value, str):
            raise Wrong("is neither null nor a word")
        if known and value not in known:
            raise Wrong(f"is none of {', '.join(known)}")
        return value

    return rule


def flag(value):
    """true or false."""
    if not isinstance(value, bool):
        raise Wrong("is neither true nor false")
    return value


def table(value):
    """Any table."""
    if not isinstance(value, dict):
        raise Wrong("is neither null nor a table")
    return value


def items(value):
    """Any list."""
    if not isinstance(value, list):
        raise Wrong("is neither null nor a list")
    return value


def list_with(rule: Callable, what):
    """A list of values that all keep a rule. what : "names", for the message"""

    def all_of(value):
        try:
            return [rule(v) for v in items(value)]
        except Wrong:
            raise Wrong(f"is not a list of {what}") from None

    return all_of


def table_with(rule: Callable, what):
    """A table of values that all keep a rule."""

    def all_of(value):
        try:
            return {name: rule(v) for name, v in table(value).items()}
        except Wrong:
            raise Wrong(f"is not a table of {what}") from None

    return all_of


# ---- fields of a dataclass ----


def told(rule: Callable, default=None, *, absent=False, needed=""):
    """A field whose value keeps a rule, `default` where nothing is said.

    absent : where it is None it is left out of the file;  needed : it must be there; what it is, in words
    """

    def take(value, where, problems):
        return rule(value)

    return _field(take, default, absent, needed)


def part(cls, *, absent=False, null=False):
    """A field that is another record, empty where nothing is said.

    absent : None then, and left out of the file;  null : None, and null in the file
    """

    def take(value, where, problems):
        return made(cls, table(value), f"{where}.", problems)

    return _field(take, None if absent or null else cls(), absent, "")


def table_of(cls, *, absent=False, needed=""):
    """A field that is a table of records of one class, by name; empty where nothing is said."""

    def take(value, where, problems):
        return _records(cls, table(value).items(), where, problems)

    return _field(take, None if absent else dict, absent, needed)


def list_of(cls, *, needed=""):
    """A field that is a list of records of one class; empty where nothing is said."""

    def take(value, where, problems):
        return list(_records(cls, enumerate(items(value)), where, problems).values())

    return _field(take, list, False, needed)


def _field(take, default, absent, needed):
    metadata = {"take": take, "absent": absent, "needed": needed}
    if default in (dict, list):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def _records(cls, entries, where, problems):
    found = {}
    for key, entry in entries:
        if isinstance(entry, dict):
            found[key] = made(cls, entry, f"{where}.{key}.", problems)
        else:
            problems.append(f"{where}.{key} = {entry!r} is not a table")
    return found


# ---- reading and writing ----


def read(path, cls):
    """The record in a JSON file. BadInput: one line for each value that breaks its rule, with file, field and value."""
    return of(artefact.read_json(path), path, cls)


def of(content, path, cls):
    """The same of JSON that was read from path."""
    problems = []
    result = made(cls, content if isinstance(content, dict) else {}, f"{path}: ", problems)
    if not isinstance(content, dict) and not problems:
        problems.append(f"{path}: {content!r:.60} is not a table")
    if problems:
        raise BadInput(*problems)
    return result


def made(cls, content: dict, where, problems):
    """An object of cls from a table of JSON; what is wrong goes to problems, one line each, which `where` begins."""
    values = {}
    for f in fields(cls):
        take, needed = f.metadata.get("take"), f.metadata.get("needed")
        value = content.get(f.name)
        if not take or (value is None and not needed):
            continue
        try:
            values[f.name] = take(value, f"{where}{f.name}", problems)
        except Wrong as wrong:
            problems.append(
                f"{where}{f.name}: missing, or not {needed}" if needed else f"{where}{f.name} = {value!r} {wrong}"
            )
    return cls(**values)


def plain(thing):
    """As JSON has it: the fields in order, those that may be absent only where they say something.

    A record with a method `written()` names itself the fields that the file shows.
    """
    if hasattr(thing, "__dataclass_fields__"):
        shown = thing.written() if hasattr(thing, "written") else [f.name for f in fields(thing) if _said(thing, f)]
        return {name: plain(getattr(thing, name)) for name in shown}
    if isinstance(thing, dict):
        return {str(key): plain(value) for key, value in thing.items()}
    return [plain(value) for value in thing] if isinstance(thing, tuple | list) else thing


def _said(thing, f):
    return not (f.metadata.get("absent") and getattr(thing, f.name) is None)
