"""The white level of a picture of whole numbers: where its clipped pixels stand.

A RAW developed without scaling to white ends at 16383 of 65535 (14 bits), and an industrial camera's 12 bits, moved up,
at 65520. Its clipped pixels are then no 1.0, and would count as light.

Two cases are told apart. Where many samples share exactly the largest value, and that is the largest of 8, 10, 12 or 14
bits (moved up or not), or one that the file itself calls its largest, then chance is out of the question: it is taken
for white, and said. Where it is another number (16383 less a black level, say) it may as well be a lamp of even
brightness in a rendering without noise: nothing is changed, and it is said.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FEWEST, SHARE = 24, 2e-5  # samples that share the largest value: so many, and this share
PEAK, SURE_PEAK = 8.0, 2.0  # times as many as have one of the values just below it; where its bits are known
BELOW = 64  # values below it that are looked at
DEPTHS = (8, 9, 10, 11, 12, 13, 14, 15)  # bits of a sensor, or of a picture, that is stored in 16
TWELVE_BITS = 4095 / 65535  # largest value of 12-bit data that stand in 16 bits
FULL = 0.98  # of the range: white of 16 bits is above it, whatever is clipped there

WAY_OUT = "scale it to the full range with your RAW developer"


class White(NamedTuple):
    """level : the value that is 1.0;  doubts : lines"""

    level: int
    doubts: tuple = ()


def is_twelve_bits(values, linear) -> bool:
    """No displayed value is beyond 12 bits of 16: the photograph must be meant for another range."""
    return not linear and values.size > 0 and bool(values.max() <= TWELVE_BITS + 1e-9)


def of(stored, told=None) -> White:
    """stored : uint8 or uint16 samples of any shape;  told : the largest value by the file, or None"""
    full = int(np.iinfo(stored.dtype).max)
    if full == 255 or stored.size == 0:
        return White(full)
    largest = int(stored.max())
    bits = next((k for k in DEPTHS for shift in (0, 16 - k) if largest == ((1 << k) - 1) << shift), None)
    if largest >= FULL * full and bits is None or largest == full:
        return White(full)
    counts = _counts(stored, largest)
    count, before = int(counts[-1]), int(counts[:-1].max(initial=0))
    known = bits is not None or told == largest
    shared = count >= max(FEWEST, SHARE * stored.size) and count > (SURE_PEAK if known else PEAK) * max(1, before)
    share = f"nothing is brighter than {largest} of {full}, and {count} samples share exactly that value"
    if shared and known:
        why = f"{bits} bits in 16" if bits else "the file says so too"
        return White(largest, (f"white level: {share} ({why}): it is taken for white, 1.0. If it is not, {WAY_OUT}",))
    if shared and largest < FULL * full:
        return White(full, (f"white level: {share}: if they are clipped they count as light here: {WAY_OUT}",))
    if largest < 1 << 14:
        line = f"white level: nothing is brighter than {largest} of {full}: where a sensor of 10, 12 or 14 bits was not"
        return White(full, (f"{line} scaled to 16, {WAY_OUT}",))
    return White(full)


def _counts(stored, largest):
    """(BELOW + 1,) how many samples have each of the values up to the largest one.

    Values of 12 bits that were moved up leave gaps: then those just below are the next ones that there are.
    """
    near = stored[stored >= largest - min(largest, BELOW * 64)].astype(np.int64)
    values, counts = np.unique(near, return_counts=True)
    return counts[-BELOW - 1 :]
