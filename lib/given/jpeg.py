"""What JPEG's rounding does to a photograph: noise that neighbouring pixels share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

SHARED_PX = 16  # side of the block that shares its error, where chroma is halved
OF_CHROMA = np.array([1.402, np.hypot(0.344, 0.714), 1.772])  # Cb and Cr in R, G, B
TO_RGB = float((OF_CHROMA**2).mean())


class Blocks(NamedTuple):
    """Squares of pixels that are coded together.

    px : side;  first : (y, x) corner of the first whole one
    noise : standard deviation (display) of what rounding adds to all pixels of one
    edge_noise : of what it adds to a pixel where an edge runs through its block: ringing, and colours that run over
    colour : (C,) of what all blocks of one colour have in common
    """

    px: int
    noise: float
    edge_noise: float
    colour: np.ndarray
    first: tuple = (0, 0)


def blocks(data: bytes) -> Blocks | None:
    """Of a file, from its quantisation tables; None where it is no JPEG.

    Each coefficient is rounded to a multiple of its step q, an error of q / sqrt(12). The constant one and the two
    slowest waves, q / 8 of a level each, are alike all over a small block. The fast ones are 0 where the picture is
    smooth, and rounded where an edge runs through the block.

    The constant ones of Cb and Cr are rounded alike all over a surface of one colour, to multiples of q and then to
    whole levels, and so is what R, G and B are made of them: no number of pixels takes that away.
    """
    tables = dict(_tables(data))
    if not tables:
        return None
    luma, chroma = tables[min(tables)], tables[max(tables)] if len(tables) > 1 else np.zeros(64)
    noise = lambda luma, chroma: float(np.sqrt(((luma**2).sum() + TO_RGB * (chroma**2).sum()) / 64 / 12) / 255)
    rounded = np.hypot(chroma[0] / 8, 1) * OF_CHROMA
    colour = np.sqrt((rounded**2 + 1) / 12) / 255 if len(tables) > 1 else np.zeros(1)
    return Blocks(_side(data), noise(luma[:3], chroma[:3]), noise(luma, chroma), colour)


def _side(data):
    """8, or 16 where chroma is halved."""
    for marker, segment in _segments(data):
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC) and len(segment) > 5:
            sampling = segment[7 : 6 + 3 * segment[5] : 3]
            return 8 * max((max(s >> 4, s & 15) for s in sampling), default=1)
    return 8


def _segments(data):
    """(marker, content) of each segment before the picture's data."""
    at = 2
    while data[:2] == b"\xff\xd8" and at + 4 <= len(data) and data[at] == 0xFF:
        marker, size = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if marker == 0xDA:
            return
        yield marker, data[at + 4 : at + 2 + size]
        at += 2 + size


def _tables(data):
    """(number, steps (64,) in zigzag order) of each table before the picture's data."""
    for marker, segment in _segments(data):
        if marker == 0xDB:
            yield from _of_segment(segment)


def _of_segment(segment):
    while len(segment) >= 65:
        wide, number = segment[0] >> 4, segment[0] & 15
        step = 2 if wide else 1
        values = [int.from_bytes(segment[1 + k * step : 1 + (k + 1) * step], "big") for k in range(64)]
        yield number, np.array(values, float)
        segment = segment[1 + 64 * step :]
