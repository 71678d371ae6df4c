"""Files that a model names: looked for beside it alone, under the name as other systems write it."""

from __future__ import annotations

import unicodedata
from pathlib import Path

from lib.core import bounded


def find(folder, name) -> Path | None:
    """The file in the folder (or below it) that a name means; None where it lies outside or is not there.

    A backslash parts folders, too; capitals and composed letters may differ, as they may on Windows and macOS.
    """
    for words in dict.fromkeys((name, name.replace("\\", "/"))):
        if not words.strip() or "\0" in words or words.startswith("/") or bounded.lies_outside(words):
            continue
        try:
            if (found := _below(Path(folder), words)) is not None:
                return found
        except OSError:  # a name too long, a folder that may not be read
            continue
    return None


def _below(folder, words):
    path = folder / words
    if path.is_file():
        return path
    at = folder
    for part in path.relative_to(folder).parts:
        if part == ".." or not at.is_dir():
            return None
        alike = sorted(p for p in at.iterdir() if _plain(p.name) == _plain(part))
        if not alike:
            return None
        at = alike[0]
    return at if at.is_file() else None


def _plain(name):
    return unicodedata.normalize("NFC", name).casefold()
