"""Where the compiled kernels of a module are kept, and whether they are there: without numba, for the plan asks too.

Each module of kernels has a folder of its own, named by a hash of its source, of the kernel modules that it imports, at
any depth, and of numba's version (lib/core/compiled.py says why).
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
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# from lib.a import b, c        from lib.a import (b, c), over several lines        import lib.a
IMPORT = re.compile(r"^(?:from (lib[.\w]*) import (\([^)]*\)|[^\n]*)|import (lib[.\w]*))", re.M)
KEPT = 2  # folders of one module: the last edits can be taken back without compiling


def folder(path):
    """Where the kernels of the module at path are kept, made if it is not there; None where nothing can be written.

    path : of a module below ROOT
    """
    name = _name(path)
    for base, place in _places(path):
        if place.is_dir() and os.access(place, os.W_OK):
            return place
        with contextlib.suppress(OSError):
            place.mkdir(parents=True, exist_ok=True)
            _forget(base, name)
            return place
    return None


def is_compiled(path) -> bool:
    """Was any kernel of the module at path compiled as it is now? A folder is made at the import, an index by numba."""
    return any(next(place.rglob("*.nbi"), None) is not None for _, place in _places(path) if place.is_dir())


def fingerprint(path) -> str:
    """Hash of a module's source, of all modules of lib/ that it imports, and of what compiles it.

    path : of a module below ROOT
    """
    digest = hashlib.sha256(f"{_numba()} {sys.version_info[:2]}".encode())
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
def _numba():
    """numba's version, by the folder that says it beside the package: to import numba takes a second."""
    spec = importlib.util.find_spec("numba")
    beside = Path(spec.origin).parents[1].glob("numba-*.dist-info") if spec else ()
    return next((place.name.removesuffix(".dist-info").removeprefix("numba-") for place in beside), None)


def _name(path):
    return ".".join(Path(path).resolve().relative_to(ROOT).with_suffix("").parts)


def _places(path):
    """(base, folder) in the order in which they are tried."""
    name = f"{_name(path)}-{fingerprint(path)}"
    temporary = Path(tempfile.gettempdir()) / f"anasyn-{os.getuid()}"
    for base in (ROOT / ".kernels", Path.home() / ".cache" / "anasyn", temporary):
        yield base, base / name


def _forget(base, name):
    """Remove the folders of earlier versions of a module but for the newest."""
    versions = sorted(base.glob(f"{name}-*"), key=lambda folder: folder.stat().st_mtime, reverse=True)
    for version in versions[KEPT:]:
        shutil.rmtree(version, ignore_errors=True)
