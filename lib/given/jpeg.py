"""What JPEG's rounding does to a photograph: noise that neighbouring pixels share."""

from __future__ import annotations

import numpy as np

SHARED_PX = 16  # side of the block that shares its error, where chroma is halved
TO_RGB = (1.402**2 + 0.344**2 + 0.714**2 + 1.772**2) / 3  # mean square of Cb and Cr in R, G, B


def block_noise(data: bytes) -> float:
    """Standard deviation (display) of what pixels of one block share, from the file's quantisation tables; else 0.

    Each coefficient is rounded to a multiple of its step q, an error of q / sqrt(12); the constant one and the two
    slowest waves, q / 8 of a level each, are alike all over a small block.
    """
    tables = dict(_tables(data))
    if not tables:
        return 0.0
    luma = tables[min(tables)]
    chroma = tables[max(tables)] if len(tables) > 1 else np.zeros(3)
    square = ((luma**2).sum() + TO_RGB * (chroma**2).sum()) / 64 / 12
    return float(np.sqrt(square) / 255)


def _tables(data):
    """(number, first three steps in zigzag order) of each table before the picture's data."""
    at = 2
    while data[:2] == b"\xff\xd8" and at + 4 <= len(data) and data[at] == 0xFF:
        marker, size = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if marker == 0xDA:
            return
        if marker == 0xDB:
            yield from _of_segment(data[at + 4 : at + 2 + size])
        at += 2 + size


def _of_segment(segment):
    while len(segment) >= 65:
        wide, number = segment[0] >> 4, segment[0] & 15
        step = 2 if wide else 1
        values = [int.from_bytes(segment[1 + k * step : 1 + (k + 1) * step], "big") for k in range(3)]
        yield number, np.array(values, float)
        segment = segment[1 + 64 * step :]
