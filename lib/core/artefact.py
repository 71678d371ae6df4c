"""Files under build/ are whole or absent; each kind has one reader and one writer, and the reader checks.

`writing` hands out a temporary name and renames it at the end.  A killed stage leaves at most a temporary
file behind; its name begins with a dot and holds `.partial-<pid>`, nothing reads it, and the next run
removes it (`remove_partials`, called by lib/planning/plan.py).
"""

import contextlib
import json
import lzma
import math
import os
import re
import shutil
import tokenize
import zipfile
import zlib
from pathlib import Path

from lib.core import bounded
from lib.core.stage import BadInput

PARTIAL = re.compile(r"^\..*\.partial-(\d+)(\.[^.]*)?$")


def _partial(path):
    """The temporary name of path: same folder (so the rename is atomic), same extension (writers look at it)."""
    path = Path(path)
    return path.with_name(f".{path.stem}.partial-{os.getpid()}{path.suffix}")


@contextlib.contextmanager
def writing_all(*paths):
    """Several outputs that appear together: yields their temporary names, renames all of them at the very end.

    RuntimeError if one was not written.
    """
    partials = [_partial(path) for path in paths]
    for path in paths:
        os.makedirs(Path(path).parent, exist_ok=True)
    try:
        yield tuple(str(p) for p in partials)
        for partial, path in zip(partials, paths, strict=True):
            if not partial.exists():
                raise RuntimeError(f"{path} was promised but not written")
        for partial, path in zip(partials, paths, strict=True):
            os.replace(partial, path)
    except OSError as error:
        if error.filename is None:  # a full disk does not say of which file
            error.filename = os.fspath(paths[0])
        raise
    finally:
        for partial in partials:
            with contextlib.suppress(FileNotFoundError):
                partial.unlink()


@contextlib.contextmanager
def writing(path):
    """One output: `with writing("b.npz") as partial: np.savez(partial, B=B)`."""
    with writing_all(path) as (partial,):
        yield partial


@contextlib.contextmanager
def writing_folders(*paths):
    """Folders that appear together, each in the place of one of that name: yields their temporary names."""
    partials = [_partial(path) for path in paths]
    for partial in partials:
        remove_partials(partial.parent)
        partial.mkdir(parents=True)
    try:
        yield tuple(map(str, partials))
        for partial, path in zip(partials, paths, strict=True):
            shutil.rmtree(path, ignore_errors=True)
            os.replace(partial, path)
    finally:
        for partial in partials:
            shutil.rmtree(partial, ignore_errors=True)


def _alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        pass
    return True


def remove_partials(folder):
    """Remove what stages that were killed left in folder; what running stages write stays."""
    for entry in sorted(Path(folder).glob(".*.partial-*")):
        match = PARTIAL.match(entry.name)
        if not match or _alive(int(match[1])):
            continue
        if entry.is_dir():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)


def _plain(value):
    """NumPy's arrays and scalars, paths and tuples as JSON has them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (set, frozenset)):
        return sorted(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")


def dumps_json(value) -> str:
    """JSON on one line; NaN and infinity are a ValueError, for JSON has neither."""
    return json.dumps(value, default=_plain, allow_nan=False, ensure_ascii=False)


def write_json(path, value):
    """Whole or absent; short lists stay on one line.  A NaN or an infinity is a ValueError, and nothing is written."""
    dumps_json(value)  # fails before the file is touched
    text = json.dumps(value, indent=1, default=_plain, allow_nan=False, ensure_ascii=False)
    text = re.sub(r"\[\s+([^\[\]{}\"]*?)\s+\]", lambda m: "[" + re.sub(r"\s+", " ", m[1]) + "]", text)
    with writing(path) as partial, open(partial, "w", encoding="utf-8") as file:
        file.write(text + "\n")


def read_json(path):
    """Any JSON value.  BadInput: not there, not UTF-8, not JSON, a NaN or infinity, a name used twice, too deep."""
    return bounded.json_of(path, bounded.content(path, bounded.LARGEST_TEXT))


def write_npz(path, **arrays):
    """Arrays by name, whole or absent."""
    import numpy as np

    with writing(path) as partial, open(partial, "wb") as file:
        np.savez(file, **arrays)


def read_npz(path, *keys) -> dict:
    """The arrays of a .npz as a dict, all of them read; those named in `keys` must be there."""
    arrays = {}
    try:
        with bounded.opened(path) as file, zipfile.ZipFile(file) as archive:
            size = os.fstat(file.fileno()).st_size
            bounded.check_unpacked(path, "arrays", size, sum(entry.file_size for entry in archive.infolist()))
            for entry in archive.infolist():
                name = entry.filename.removesuffix(".npy")
                if name == entry.filename or name in arrays:
                    raise ValueError(f"{entry.filename:.80} is no array, or stands there twice")
                with archive.open(entry) as member:
                    arrays[name] = _array(name, member, entry.file_size)
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such file") from None
    except UNREADABLE as error:
        raise BadInput(f"{path}: not a readable .npz file: {error}") from None
    missing = [key for key in keys if key not in arrays]
    if missing:
        raise BadInput(*(f"{path}: {key}: the array is missing" for key in missing))
    return arrays


# What zipfile and NumPy raise of a damaged archive: also of a method that is not known, or of an encrypted one
UNREADABLE = (
    *(ValueError, TypeError, OverflowError, EOFError, OSError, NotImplementedError, RuntimeError, SyntaxError),
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, tokenize.TokenError),
)


def _array(name, member, size):
    """One array of `size` bytes, header included. ValueError: its header promises another size, or objects."""
    import numpy as np

    version = np.lib.format.read_magic(member)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"{name}: version {version} of NumPy's format")
    shape, by_columns, kind = read(member)
    count = math.prod(shape)
    if kind.hasobject or kind.itemsize == 0 or kind.names or min(shape, default=0) < 0:
        raise ValueError(f"{name}: {kind} {shape} is no plain array")
    if count * kind.itemsize != size - member.tell():
        raise ValueError(f"{name}: {shape} {kind} does not fit {size - member.tell()} bytes")
    flat = np.frombuffer(bytearray(member.read()), kind)
    return flat.reshape(shape, order="F" if by_columns else "C")
