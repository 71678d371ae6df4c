"""What JPEG's rounding does to a photograph: noise that neighbouring pixels share."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np

SHARED_PX = 16  # side of the block that shares its error, where chroma is halved
OF_CHROMA = np.array([[0, 1.402], [-0.344, -0.714], [1.772, 0]])  # of Cb and Cr in R, G, B
SMOOTH, STEPS, SURE = 0.03, 0.06, 4.0  # steps that are no edge; how much larger they are between blocks; in sigmas
LONGEST_TEXT = 500  # characters
NO_TABLES = (
    "its pixels come in blocks of 8, as those of a JPEG that was stored anew: give the JPEG itself, whose tables say "
    "how its colours were rounded; standard deviations lack that"
)


class Blocks(NamedTuple):
    """Squares of pixels that are coded together.

    px : side, not whole in a smaller photograph;  first : (y, x) corner of the first whole one; None: they lie anyhow
    noise : standard deviation (display) of what rounding adds to all pixels of one
    edge_noise : of what it adds to a pixel where an edge runs through its block: ringing, and colours that run over
    colour : (C,) of what all blocks of one colour have in common
    """

    px: float
    noise: float
    edge_noise: float
    colour: np.ndarray
    first: tuple | None = (0, 0)

    def smaller(self, k) -> Blocks:
        """Of the photograph whose pixels are means of k x k: what all pixels of a block share stays."""
        ringing = np.sqrt(self.noise**2 + (self.edge_noise**2 - self.noise**2) / k**2)
        first = self.first and tuple(n / k for n in self.first)
        return self._replace(px=max(1.0, self.px / k), edge_noise=float(ringing), first=first)

    @property
    def text(self) -> str:
        """What `of_text` reads: a PNG made of a JPEG carries it."""
        first = [] if self.first is None else list(self.first)
        return json.dumps([self.px, self.noise, self.edge_noise, *self.colour, *first, len(first)])


def blocks(data: bytes, matrix=None) -> Blocks | None:
    """Of a file, from its quantisation tables; None where it is no JPEG.

    matrix : (3, 3) to sRGB's primaries, where the file has others: what is rounded in its Cb and Cr grows by it, 1.6
    times in red from Adobe RGB

    Each coefficient is rounded to a multiple of its step q, an error of q / sqrt(12). The constant one and the two
    slowest waves, q / 8 of a level each, are alike all over a small block. The fast ones are 0 where the picture is
    smooth, and rounded where an edge runs through the block.

    The constant ones of Cb and Cr are rounded alike all over a surface of one colour, to multiples of q and then to
    whole levels, and so is what R, G and B are made of them: no number of pixels takes that away.
    """
    tables = dict(_tables(data))
    if not tables:
        return None
    to_rgb = np.linalg.norm(OF_CHROMA if matrix is None else matrix @ OF_CHROMA, axis=1)
    luma, chroma = tables[min(tables)], tables[max(tables)] if len(tables) > 1 else np.zeros(64)
    size = lambda luma, chroma: (luma**2).sum() + (to_rgb**2).mean() * (chroma**2).sum()
    noise = lambda *steps: float(np.sqrt(size(*steps) / 64 / 12) / 255)
    rounded = np.hypot(chroma[0] / 8, 1) * to_rgb
    colour = np.sqrt((rounded**2 + 1) / 12) / 255 if len(tables) > 1 else np.zeros(1)
    return Blocks(_side(data), noise(luma[:3], chroma[:3]), noise(luma, chroma), colour)


def shows_blocks(values) -> bool:
    """Whether neighbours differ more where blocks of 8 px meet, along both axes: a JPEG, whatever the file is now.

    values : (H, W, C) display.  Eleven photographs: never where it was no JPEG, always at quality 75 and 90, ten at 95
    """
    grey = values.mean(axis=2)
    return all(_steps_at_blocks(across) for across in (grey, grey.T))


def _steps_at_blocks(grey):
    step = np.abs(np.diff(grey, axis=1))
    smooth = step < SMOOTH
    mean = (step * smooth).sum(axis=0) / np.maximum(smooth.sum(axis=0), 1)
    mean = mean[: len(mean) // 8 * 8].reshape(-1, 8)
    if len(mean) < 8:
        return False
    mean = mean / np.maximum(mean.mean(axis=1, keepdims=True), 1e-12)
    by_phase, sigma = mean.mean(axis=0), mean.std(axis=0) / np.sqrt(len(mean))
    k = int(by_phase.argmax())
    more = by_phase[k] - np.delete(by_phase, k).mean()
    return bool(more > STEPS and more > SURE * np.hypot(sigma[k], np.delete(sigma, k).mean()))


def of_text(text) -> Blocks | None:
    """Of what `Blocks.text` wrote; None where these are not such numbers."""
    if len(text) > LONGEST_TEXT:
        return None
    try:
        *numbers, at = map(float, json.loads(text))
        px, noise, edge_noise, *colour = numbers[: len(numbers) - int(at)]
        first = tuple(numbers[len(numbers) - 2 :]) if at else None
    except (ValueError, TypeError, OverflowError):
        return None
    sound = all(0 <= n < 1 for n in (noise, edge_noise, *colour)) and 1 <= px <= 64 and at in (0, 2)
    sound &= first is None or all(0 <= n <= px for n in first)
    return Blocks(px, noise, edge_noise, np.array(colour), first) if sound and len(colour) in (1, 3) else None


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
