"""What each reader of strangers' files understands, refuses and leaves out, as Markdown, from the readers themselves.

$ python -m tests.bench.reader_table > docs/readers.md
"""

import importlib
import pkgutil

import lib.given
from lib.given.formats import Format

HEAD = """# What is read, what is refused, what is left out

Every reader of strangers' files keeps one contract. What a file *requires* and the reader does not understand is
refused, by name and with the way out: one line, exit status 2, nothing written. What is optional and left out is
counted and said in one line by `make new-scene` and `make <scene>/check`. Nothing is passed over in silence.

A reader declares what it understands as `FORMAT` (`lib/given/formats.py`); `python -m tests.bench.reader_table` makes
this page of these, and a test compares them.

"""


def formats() -> list[Format]:
    """Of all readers, by the name of their modules."""
    names = sorted(module.name for module in pkgutil.walk_packages(lib.given.__path__, "lib.given."))
    kept = [name for name in names if not name.endswith("mrcal_process")]  # runs under mrcal's own interpreter
    found = [getattr(importlib.import_module(name), "FORMAT", None) for name in kept]
    return [each for each in found if isinstance(each, Format)]


def page() -> str:
    """docs/readers.md"""
    return HEAD + "\n".join(map(_section, formats()))


def _section(of: Format):
    lines = [f"## {of.name}", "", f"Read: {'; '.join(of.read)}.", ""]
    if of.refused:
        lines += [
            "| refused | the way out |",
            "| --- | --- |",
            *(f"| {what} | {way} |" for what, way in of.refused),
            "",
        ]
    if of.left_out:
        lines += [f"Left out, and counted: {'; '.join(of.left_out)}.", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    print(page(), end="")
