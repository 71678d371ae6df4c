"""Arrays of a .npz, looked at before anything counts on them: their kinds, their shapes and their ranges.

A table has a line for each array:

    {"indptr": Starts("M+1", into="K"), "indices": Whole("K", below="N"), "valid": Real("M", low=0), "names": Text("G")}

Sizes are named; the first array that has a size tells it, and all others must agree.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from lib.core.stage import BadInput


class Array(NamedTuple):
    """kinds : of NumPy's dtypes;  shape : names of sizes, "N", "N+1", "2N", or numbers
    low : the least value;  below : a size that all values lie below;  into : what the values are starts in, from 0 on
    is_size : its one value is the size of this name
    """

    kinds: str
    words: str
    shape: tuple
    low: float | None = None
    below: str | None = None
    into: str | None = None
    is_size: str | None = None


def Real(*shape, low=None):
    """Finite numbers."""
    return Array("fiu", "numbers", shape, low)


def Whole(*shape, low=0, below=None):
    return Array("iu", "whole numbers", shape, low, below)


def Starts(size, into):
    """Where each of a row of runs begins, and at last the end of the last one."""
    return Array("iu", "whole numbers", (size,), into=into)


def Size(name):
    """One number, which is a size."""
    return Array("iu", "whole numbers", (), 0, is_size=name)


def Flag(*shape):
    return Array("b", "true or false", shape)


def Text(*shape):
    return Array("U", "texts", shape)


def check(path, arrays, table, sizes=None, prefix=""):
    """BadInput names the file, the array and what is wrong with it. Returns {name: size} of all that was told.

    arrays : {name: array}, all that the table names are there;  sizes : {name: size} that are known before
    """
    sizes = dict(sizes or {})
    for name, array in table.items():
        _check_shape(f"{path}: {prefix}{name}", arrays[prefix + name], array, sizes)
    for name, array in table.items():
        if problem := _wrong_value(arrays[prefix + name], array, sizes):
            raise BadInput(f"{path}: {prefix}{name}: {problem}")
    return sizes


def _check_shape(where, found, wanted, sizes):
    if found.dtype.kind not in wanted.kinds:
        raise BadInput(f"{where}: type: {found.dtype} where {wanted.words} should be")
    fits = found.ndim == len(wanted.shape)
    if fits:
        for length, size in zip(found.shape, wanted.shape, strict=True):
            fits &= length == size if isinstance(size, int) else _agrees(length, size, sizes)
    if not fits:
        named = [str(size) for size in wanted.shape]
        known = ", ".join(f"{n} = {k}" for n, k in sizes.items() if any(n in size for size in named))
        shape = ", ".join(named) + "," * (len(named) == 1)
        raise BadInput(f"{where}: shape: {found.shape} is not ({shape})" + f" with {known}" * bool(known))
    if wanted.is_size:
        value = int(found)
        if sizes.setdefault(wanted.is_size, value) != value:
            raise BadInput(f"{where}: value: {value} is not {wanted.is_size} = {sizes[wanted.is_size]}")


def _agrees(length, size, sizes):
    """Whether a length is that of a size "N", "N+1" or "2N", which it tells if nothing did before."""
    times, name, more = re.fullmatch(r"(\d*)([A-Za-z]+)(?:\+(\d+))?", size).groups()
    n, rest = divmod(length - int(more or 0), int(times or 1))
    return rest == 0 and n >= 0 and sizes.setdefault(name, n) == n


def _wrong_value(found, wanted, sizes):
    """What is wrong with the values, or None."""
    if found.size == 0 or found.dtype.kind not in "fiu":
        return None if wanted.into is None or found.size else "shape: (0,) has no end"
    if found.dtype.kind == "f" and not np.isfinite(found).all():
        return "holds a value that is not finite"
    if wanted.low is not None and found.min() < wanted.low:
        return f"value: {found.min()} is less than {wanted.low:g}"
    if wanted.below and found.max() >= sizes[wanted.below]:
        return f"value: {found.max()} is not below {wanted.below} = {sizes[wanted.below]}"
    if wanted.into:
        if found[0] != 0 or (np.diff(found) < 0).any():
            return "value: starts do not rise from 0"
        if found[-1] != sizes.setdefault(wanted.into, int(found[-1])):
            return f"value: the last start, {found[-1]}, is not {wanted.into} = {sizes[wanted.into]}"
    return None
