"""Compiled kernels: numba's njit, with a cache on disk that notices changes in *other* files.

    from lib.core.compiled import njit, prange      # in a *_kernels.py, the only place for compiled functions

numba keys its cache by the file that a function stands in. A kernel that calls another file's kernel, or uses its
constants, would go on running with the old ones after an edit there. So each module of kernels gets a folder of its
own. The folder is named by a hash of the module's source, of the kernel modules that it imports, at any depth, and of
numba's version.

A kernel is compiled, or read from the cache, when it is first called: an open report lists that apart, as `compile_s`.
"""

import contextlib
import functools
import hashlib
import importlib.util
import os
import re
import shutil
import sys
import tempfile
import threading
import types
from pathlib import Path

import numba
from numba import prange
from numba.core import event

from lib.core.apart import apart

__all__ = ["njit", "prange"]

ROOT = Path(__file__).resolve().parents[2]
# from lib.a import b, c        from lib.a import (b, c), over several lines        import lib.a
IMPORT = re.compile(r"^(?:from (lib[.\w]*) import (\([^)]*\)|[^\n]*)|import (lib[.\w]*))", re.M)
KEPT = 2  # folders of one module: the last edits can be taken back without compiling


def _load_blas():
    """Import scipy.linalg.cython_blas, where numba finds np.dot, without the rest of scipy.linalg, 0.2 s of CPU."""
    if "scipy.linalg" in sys.modules:
        return
    stub = types.ModuleType("scipy.linalg")
    stub.__path__ = list(importlib.util.find_spec("scipy.linalg").submodule_search_locations)
    sys.modules["scipy.linalg"] = stub
    try:
        importlib.import_module("scipy.linalg.cython_blas")
    finally:
        del sys.modules["scipy.linalg"]  # who asks for it later gets it


_load_blas()


class _Apart(event.Listener):
    """Lists apart in the open report while numba's lock is held: by what is compiled, or read from the cache."""

    def __init__(self):
        self._held = threading.local()

    def on_start(self, event):
        kept = contextlib.ExitStack()
        kept.enter_context(apart("compile"))
        self._held.all = [*getattr(self._held, "all", ()), kept]

    def on_end(self, event):
        self._held.all.pop().close()


event.register("numba:compiler_lock", _Apart())


def njit(**options):
    """numba.njit(cache=True, **options) for a function of a *_kernels.py."""

    def compile_when_called(function):
        folder = _folder(function.__code__.co_filename)
        with _cache_in(folder):
            return numba.njit(cache=folder is not None, **options)(function)

    return compile_when_called


def fingerprint(path) -> str:
    """Hash of a module's source, of all modules of lib/ that it imports, and of what compiles it.

    path : of a module below ROOT
    """
    digest = hashlib.sha256(f"{numba.__version__} {sys.version_info[:2]}".encode())
    found, todo = set(), [Path(path).resolve()]
    while todo:
        file = todo.pop()
        if file not in found:
            found.add(file)
            todo += imported(file)
    for file in sorted(found):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


@functools.cache
def imported(path):
    """Files below ROOT that the module at path imports at its top."""
    files = []
    for package, names, module in IMPORT.findall(path.read_text(encoding="utf-8")):
        dotted = [module] if module else [package, *(f"{package}.{name}" for name in re.findall(r"\w+", names))]
        stems = [ROOT.joinpath(*name.split(".")) for name in dotted]
        files += [file for stem in stems for file in (stem.with_suffix(".py"), stem / "__init__.py") if file.is_file()]
    return files


@functools.cache
def _folder(path):
    """Where the kernels of the module at path are kept, or None where nothing can be written."""
    name = ".".join(Path(path).resolve().relative_to(ROOT).with_suffix("").parts)
    temporary = Path(tempfile.gettempdir()) / f"anasyn-{os.getuid()}"
    for base in (ROOT / ".kernels", Path.home() / ".cache" / "anasyn", temporary):
        folder = base / f"{name}-{fingerprint(path)}"
        if folder.is_dir() and os.access(folder, os.W_OK):
            return folder
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            _forget(base, name)
            return folder
    return None


def _forget(base, name):
    """Remove the folders of earlier versions of a module but for the newest."""
    versions = sorted(base.glob(f"{name}-*"), key=lambda folder: folder.stat().st_mtime, reverse=True)
    for folder in versions[KEPT:]:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _cache_in(folder):
    """numba reads the folder of its cache when a function is decorated."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder or before)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before
