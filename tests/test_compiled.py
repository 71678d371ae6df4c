"""The cache of compiled kernels notices an edit in another file, and a story's edit compiles nothing again."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lib.core import kernel_cache

ROOT = Path(__file__).resolve().parents[1]
CONSTANTS = """
from lib.core.compiled import njit

OFFSET = 1.0


@njit()
def twice(x):
    return 2.0 * x
"""
KERNELS = """
from lib.core.compiled import njit
{imported}


@njit()
def moved(x):
    return twice(x) + OFFSET
"""
STORY = """
import sys

from lib import moved_kernels


def main():
    print(moved_kernels.moved(float(sys.argv[1])), sum(moved_kernels.moved.stats.cache_hits.values()))


main()
"""
IMPORTED = {
    "one line": "from lib.constants_kernels import OFFSET, twice",
    "several lines": "from lib.constants_kernels import (\n    OFFSET,  # m\n    twice,\n)",
    "the module": "import lib.constants_kernels as constants\nOFFSET, twice = constants.OFFSET, constants.twice",
    "its package": "from lib import constants_kernels as constants\nOFFSET, twice = constants.OFFSET, constants.twice",
}


class Project:
    """A lib/ of two modules of kernels and a story, run in a process of its own each time."""

    def __init__(self, folder, imported):
        self.folder = folder
        for name, text in {
            "core/__init__.py": "",
            "constants_kernels.py": CONSTANTS,
            "moved_kernels.py": KERNELS.format(imported=imported),
            "story.py": STORY,
            "__init__.py": "",
        }.items():
            path = folder / "lib" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        for name in ("apart.py", "compiled.py", "kernel_cache.py"):
            shutil.copy(ROOT / "lib/core" / name, folder / "lib/core" / name)

    def edit(self, name, before, after):
        """The edited file keeps its time: only its content tells."""
        path = self.folder / "lib" / name
        text, times = path.read_text(), path.stat()
        assert before in text
        path.write_text(text.replace(before, after))
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))

    def run(self, x=3.0):
        """(the kernel's answer, whether it was loaded from the cache)."""
        words = [sys.executable, "-B", "-m", "lib.story", str(x)]  # Python's own .pyc goes by time and size alone
        done = subprocess.run(words, cwd=self.folder, capture_output=True, text=True, check=True)
        answer, hits = done.stdout.split()
        return float(answer), int(hits) > 0

    def folders(self):
        """How many versions of the kernels are kept."""
        return len(list((self.folder / ".kernels").glob("lib.moved_kernels-*")))


@pytest.mark.parametrize("imported", IMPORTED.values(), ids=IMPORTED)
def test_the_fingerprint_sees_an_edit_in_another_file(tmp_path, monkeypatch, imported):
    """However the import is written; an edit of a file that is not imported changes nothing."""
    project = Project(tmp_path, imported)
    monkeypatch.setattr(kernel_cache, "ROOT", tmp_path)

    def fingerprint():
        kernel_cache.imported.cache_clear()
        return kernel_cache.fingerprint(tmp_path / "lib/moved_kernels.py")

    try:
        before = fingerprint()
        project.edit("story.py", "def main", "def  main")
        assert fingerprint() == before
        project.edit("constants_kernels.py", "OFFSET = 1.0", "OFFSET = 5.0")
        assert fingerprint() != before
    finally:
        kernel_cache.imported.cache_clear()


@pytest.mark.scene
def test_what_an_edit_compiles_again(tmp_path):
    """An edit in another file is noticed: numba itself would go on with the old constant and the old function.

    Taken back, nothing is compiled; nor after an edit of the story.
    """
    project = Project(tmp_path, IMPORTED["several lines"])
    assert project.run() == (7.0, False)
    project.edit("constants_kernels.py", "OFFSET = 1.0", "OFFSET = 5.0")
    assert project.run() == (11.0, False)
    project.edit("constants_kernels.py", "OFFSET = 5.0", "OFFSET = 1.0")
    project.edit("story.py", "def main():", "def main():  # edited\n    # at length")
    assert project.run() == (7.0, True)
    project.edit("constants_kernels.py", "2.0 * x", "4.0 * x")
    assert project.run() == (13.0, False)
    assert project.folders() == 2
