"""The contract of every reader of strangers' files: what it does not understand is never passed over in silence.

Each reader's module declares a `FORMAT`. What a file *requires* and the reader does not understand is refused, by name
and with the way out (`BadInput`). What is optional and left out is counted and said in one line (`LeftOut`).
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple


class Format(NamedTuple):
    """What one reader understands, in words for users: docs/readers.md is made of these.

    read : what is understood;  refused : (what, the way out);  left_out : what is optional, counted in a line
    """

    name: str
    read: tuple[str, ...]
    refused: tuple[tuple[str, str], ...] = ()
    left_out: tuple[str, ...] = ()


class LeftOut:
    """Counts what a reader leaves out.

    >>> left = LeftOut()
    >>> left.add("free-form surface", 2); left.add("point light"); left.line()
    '2 free-form surfaces, 1 point light: not read'
    """

    def __init__(self):
        self.counts = Counter()

    def add(self, what, count=1):
        """what : in the singular; its plural takes an s."""
        self.counts[what] += count

    def line(self) -> str | None:
        """One line for all of it; None where nothing was left out."""
        parts = [f"{count} {what}{'s' if count > 1 else ''}" for what, count in self.counts.items() if count]
        return f"{', '.join(parts)}: not read" if parts else None
