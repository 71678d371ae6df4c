"""Pictures of the page as data URIs: photographs, label images in colours, differences."""

from __future__ import annotations

import base64
import math

import numpy as np

from lib.given.materials import FoundTransfer
from lib.given.transfer import CURVES, Transfer, display_of_linear
from lib.verdict.page.html import finite

SRGB = Transfer("srgb").display
# re-rendered darker: blue; brighter: orange; the middle is grey, so that it shows on dark and on light
DIFFERENCE_COLOURS = np.array(
    [[20, 60, 140], [66, 133, 204], [150, 190, 222], [236, 236, 233], [240, 189, 140], [214, 120, 44], [140, 58, 10]],
    float,
)


def bytes8(values):
    """Display values in [0, 1] as bytes; what is not a number is black."""
    return (np.clip(np.nan_to_num(values), 0, 1) * 255 + 0.5).astype(np.uint8)


def smaller(values, width, nearest=False):
    """A picture of at most `width` pixels to its longer side. nearest : labels, which have no mean"""
    import cv2

    scale = width / max(values.shape[:2])
    if scale >= 1:
        return values
    size = tuple(max(1, round(n * scale)) for n in values.shape[1::-1])
    return cv2.resize(values, size, interpolation=cv2.INTER_NEAREST if nearest else cv2.INTER_AREA)


def uri(values, *, photo=False):
    """A data URI of an 8-bit picture (H, W) or (H, W, 3): JPEG for photographs, PNG for flat colours."""
    import cv2

    if values.ndim == 3:
        values = values[..., 0] if values.shape[2] == 1 else values[..., ::-1]
    kind, options = ("jpeg", [cv2.IMWRITE_JPEG_QUALITY, 90]) if photo else ("png", [cv2.IMWRITE_PNG_COMPRESSION, 9])
    ok, code = cv2.imencode(f".{kind}", np.ascontiguousarray(values), options)
    if not ok:
        raise OSError("a picture of the page cannot be encoded")
    return f"data:image/{kind};base64,{base64.b64encode(code.tobytes()).decode()}"


def photo_uri(values, width):
    """Of display values (H, W, C), at most so wide or high."""
    return uri(smaller(bytes8(values), width), photo=True)


def labels_uri(labels, width):
    """Of a label image, every label in a colour of its own."""
    return uri(smaller(paint(labels), width, nearest=True))


def three_channels(values):
    """(H, W, 3), also of one channel."""
    return np.broadcast_to(values, (*values.shape[:2], 3)) if values.shape[2] == 1 else values


# ---- colours ----


def colours(n):
    """n quiet colours, neighbours in the list far apart: (n, 3) uint8.

    Hues lie a golden angle apart, at three lightnesses in turn (Oklab).
    """
    i = np.arange(n)
    hue, L, C = 2.3999632 * i + 4.1, np.array([0.70, 0.56, 0.83])[i % 3], np.array([0.105, 0.11, 0.085])[i % 3]
    lab = np.stack([L, C * np.cos(hue), C * np.sin(hue)])
    lms = (
        np.array(
            [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.2914855480]]
        )
        @ lab
    ) ** 3
    linear = (
        np.array(
            [
                [4.0767416621, -3.3077115913, 0.2309699292],
                [-1.2684380046, 2.6097574011, -0.3413193965],
                [-0.0041960863, -0.7034186147, 1.7076147010],
            ]
        )
        @ lms
    )
    return bytes8(SRGB(linear).T)


def paint(labels):
    """Labels (index + 1) in colours; nothing is white."""
    n = int(labels.max(initial=0))
    return np.concatenate([np.full((1, 3), 255, np.uint8), colours(n)])[labels]


def on_scale(at, stops):
    """Colours (..., 3) uint8 at places in [0, 1] of a scale with stops (n, 3) at equal distances."""
    at = at * (len(stops) - 1)
    low = np.minimum(at.astype(int), len(stops) - 2)
    t = (at - low)[..., None]
    return stops[low] * (1 - t) + stops[low + 1] * t


def difference(photograph, rendered):
    """(signed deviation (H, W) of the channel that differs most, half the width of its scale).

    The scale is 1, 2 or 5 times a power of ten.
    """
    delta = np.nan_to_num(rendered - photograph, posinf=1, neginf=-1)
    signed = np.take_along_axis(delta, np.abs(delta).argmax(axis=2)[..., None], axis=2)[..., 0]
    typical = max(float(np.percentile(np.abs(signed), 98)), 1e-3)
    power = 10.0 ** math.floor(math.log10(typical))
    return signed, next((m * power for m in (1, 2, 5, 10) if m * power >= typical * (1 - 1e-9)), 10 * power)


def diverging(values, half):
    """Signed values as colours, from -half to half."""
    at = (np.clip(values / half, -1, 1) + 1) / 2
    return (on_scale(at, DIFFERENCE_COLOURS) + 0.5).astype(np.uint8)


# ---- transfer functions ----


def display_function(transfer: FoundTransfer, linear_photograph=False):
    """T as a function of arrays; gamma 2.2 where no one gamma is found."""
    if transfer.kind in (*CURVES, "curve"):
        return transfer.function.bare.display
    if transfer.kind == "linear" and not linear_photograph:
        return lambda B: np.clip(B, 0, 1)
    found = transfer.kind == "gamma" and finite(transfer.gamma) and transfer.gamma > 0
    return Transfer("gamma", transfer.gamma).display if found else display_of_linear
