"""Stages without a new interpreter: each start with NumPy and numba costs a CPU second or more."""

import contextlib
import functools
import importlib.util
import io
import os
import signal
import sys
from pathlib import Path
from subprocess import CompletedProcess

from lib.core import stage

ROOT = Path(__file__).resolve().parents[2]


@functools.cache
def module(name):
    """stages/<name>.py as a module."""
    spec = importlib.util.spec_from_file_location(f"stages_{name}", ROOT / f"stages/{name}.py")
    loaded, before = importlib.util.module_from_spec(spec), sys.path[:]
    spec.loader.exec_module(loaded)
    sys.path[:] = before
    return loaded


def call(name, *words):
    """CompletedProcess of stages/<name>.py: what it says, and its exit status; a bug is raised."""
    loaded, said, problems, status = module(name), io.StringIO(), io.StringIO(), 0
    argv, handlers = sys.argv, [(asked, signal.getsignal(asked)) for asked in stage.STOPPED]
    sys.argv = [f"stages/{name}.py"]
    try:
        with contextlib.chdir(ROOT), contextlib.redirect_stdout(said), contextlib.redirect_stderr(problems):
            stage.run(loaded.main, loaded.options(), [os.fspath(w) if isinstance(w, Path) else str(w) for w in words])
    except SystemExit as end:
        status = end.code
    finally:
        sys.argv = argv
        for asked, handler in handlers:
            signal.signal(asked, handler)
    return CompletedProcess([name, *words], status, said.getvalue(), problems.getvalue())
