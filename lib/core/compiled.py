"""Compiled kernels: numba's njit, with a cache on disk that notices changes in *other* files.

    from lib.core.compiled import njit, prange      # in a *_kernels.py, the only place for compiled functions

numba keys its cache by the file that a function stands in. A kernel that calls another file's kernel, or uses its
constants, would go on running with the old ones after an edit there. So each module of kernels gets a folder of its
own (lib/core/kernel_cache.py).

A kernel is compiled, or read from the cache, when it is first called: an open report lists that apart, as `compile_s`.
"""

import contextlib
import functools
import importlib.util
import sys
import threading
import types

import numba
from numba import prange
from numba.core import event

from lib.core import kernel_cache
from lib.core.apart import apart

__all__ = ["njit", "prange"]


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


_folder = functools.cache(kernel_cache.folder)


def njit(**options):
    """numba.njit(cache=True, **options) for a function of a *_kernels.py."""

    def compile_when_called(function):
        folder = _folder(function.__code__.co_filename)
        with _cache_in(folder):
            return numba.njit(cache=folder is not None, **options)(function)

    return compile_when_called


@contextlib.contextmanager
def _cache_in(folder):
    """numba reads the folder of its cache when a function is decorated."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder or before)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before
