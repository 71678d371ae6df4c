"""ICC profiles and photographs in other colour spaces, made apart from lib/given/colour_profiles.py.

The primaries and the adaptation of white are colour-science's; a file is told by LittleCMS to be a profile.
"""

import struct

import numpy as np

NAMES = {"Display P3": "Display P3", "Adobe RGB": "Adobe RGB (1998)", "ProPhoto": "ROMM RGB", "sRGB": "sRGB"}
GAMMAS = {"Display P3": None, "Adobe RGB": 563 / 256, "ProPhoto": 1.8, "sRGB": None}  # None: sRGB's curve
D50 = (0.9642, 1.0, 0.8249)


def to_xyz(space):
    """(3, 3) CIE XYZ, adapted to D50, of linear R, G, B."""
    import colour

    found = colour.RGB_COLOURSPACES[NAMES[space]]
    white = colour.xy_to_XYZ(found.whitepoint)
    return colour.adaptation.matrix_chromatic_adaptation_VonKries(white, D50, "Bradford") @ found.matrix_RGB_to_XYZ


def shown(linear, space):
    """Display values of linear ones."""
    if GAMMAS[space]:
        return linear ** (1 / GAMMAS[space])
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def light(display, space):
    if GAMMAS[space]:
        return display ** GAMMAS[space]
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def other(display, space, before="sRGB"):
    """(H, W, 3) display values of one space in another, clipped."""
    linear = light(display, before) @ (np.linalg.inv(to_xyz(space)) @ to_xyz(before)).T
    return shown(np.clip(linear, 0, 1), space)


def icc(space, *, name=None, curve=None, colours=b"RGB ", tags=None):
    """A profile of version 2, or of what is told otherwise. curve : the bytes of rTRC, gTRC and bTRC"""
    fixed = lambda *values: struct.pack(f">{len(values)}i", *(round(65536 * v) for v in values))
    if curve is None and GAMMAS[space]:
        curve = b"curv" + bytes(4) + struct.pack(">IH", 1, round(256 * GAMMAS[space]))
    elif curve is None:
        curve = b"para" + bytes(4) + struct.pack(">HH", 3, 0) + fixed(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    text = (name or space).encode() + b"\0"
    own = {b"desc": b"desc" + bytes(4) + struct.pack(">I", len(text)) + text + bytes(78)}
    own |= {b"wtpt": b"XYZ " + bytes(4) + fixed(*D50), b"cprt": b"text" + bytes(4) + b"CC0\0"}
    for letter, column in zip("rgb", to_xyz(space).T, strict=True):
        own[f"{letter}XYZ".encode()] = b"XYZ " + bytes(4) + fixed(*column)
        own[f"{letter}TRC".encode()] = curve
    own = {key: value for key, value in (own | (tags or {})).items() if value is not None}
    at, table, data = 132 + 12 * len(own), b"", b""
    for key, value in own.items():
        value += b"\0" * (-len(value) % 4)
        table += struct.pack(">4sII", key, at + len(data), len(value))
        data += value
    head = struct.pack(">I4sI4s4s4s", at + len(data), b"lcms", 0x02400000, b"mntr", colours, b"XYZ ")
    head += struct.pack(">6H", 2026, 1, 1, 0, 0, 0) + b"acsp" + bytes(28) + fixed(*D50)
    return head.ljust(128, b"\0") + struct.pack(">I", len(own)) + table + data


def png16(path, stored, chunks=()):
    """A 16-bit PNG (H, W, 3), with (kind, data) chunks before its pixels."""
    import zlib

    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    height, width = stored.shape[:2]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in stored)
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)), *chunks]
    parts += [(b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts))


def iccp(profile):
    import zlib

    return b"iCCP", b"x\0\0" + zlib.compress(profile)
