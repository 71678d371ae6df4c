"""The table of mistakes with the line that each gets and the CPU seconds until it comes, as Markdown.

    $ python -m tests.bench.mistake_table > docs/mistakes.md

Each is `make room` of its own, from the command to its end.
"""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.helpers.mistakes import MISTAKES, scene

ROOT = Path(__file__).resolve().parents[2]
HEAD = """# Mistakes, and what is said

Each row is a scene that is sound but for one thing, and the first line that `make` ends in, with exit status 2,
nothing written: {n} of them, {median:.1f} CPU s in the median, {most:.1f} at most.
`python -m tests.bench.mistake_table` makes this page; `tests/test_mistakes.py` asks each.

| wrong | said | CPU s |
| --- | --- | --- |
"""


def spent():
    """CPU seconds of all children that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return children.ru_utime + children.ru_stime


def told(name, folder):
    """(first line, CPU seconds) of one mistake: other programs beside it count little."""
    data, build = folder / "data", folder / "build"
    MISTAKES[name][0](scene(data / "room"))
    began = spent()
    words = ["make", f"PYTHON={sys.executable}", f"DATA={data}", f"BUILD={build}", "room"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    took = spent() - began
    lines = [line for line in done.stderr.splitlines() if not line.startswith("make")]
    assert done.returncode == 2 and lines and not build.exists(), (name, done)
    said = lines[0].removeprefix("plan.py: ")
    return said.replace(f"{data}/room/", "").replace(f"{data}/", ""), took


def main():
    rows = []
    for name in MISTAKES:
        with tempfile.TemporaryDirectory() as folder:
            rows.append((name, *told(name, Path(folder))))
    seconds = sorted(took for *_, took in rows)
    print(HEAD.format(n=len(rows), median=seconds[len(rows) // 2], most=seconds[-1]), end="")
    for name, line, took in rows:
        print(f"| {name} | `{line.replace('`', '').replace('|', '/')}` | {took:.1f} |")


if __name__ == "__main__":
    main()
