"""What a picture's file says of its colours: ICC profiles, cICP, gAMA and cHRM of PNG, EXIF's colour space.

    space = of_icc(profile)                 # Space, or ValueError that says what is not understood
    values, outside = in_srgb(space, stored)

Display P3, Adobe RGB or ProPhoto is brought to sRGB's primaries: stored values are made linear by the file's own
curve, mixed by a matrix, and shown by the same curve again. So a grey keeps its value to the last bit, and the
photograph stays display-referred, and `transfer: auto` finds its response. A response that is not the file's curve
costs little: pixels of sRGB's curve, mixed by a gamma of 2.2, are off by 0.06 % of their light (median; 0.3 % at most
in 99 of 100).  Own code, for LittleCMS, as Pillow offers it, has 8 bits for a sample, and is not made for files of
strangers.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from lib.given.formats import Format
from lib.given.transfer import linear_from_srgb

FORMAT = Format(
    "colours of a photograph",
    read=(
        "ICC profiles of R, G, B with primaries and curves (Display P3, Adobe RGB, ProPhoto, Rec. 2020, sRGB)",
        "PNG: cICP, iCCP, sRGB, cHRM with gAMA;  TIFF: WhitePoint with PrimaryChromaticities;  EXR: chromaticities",
        "EXIF: Adobe RGB by its interoperability index R03, or ColorSpace 2, where there is no profile",
    ),
    refused=(("HDR curves (PQ, HLG)", "save the SDR picture, or linear light as an EXR"),),
    left_out=("profiles of tables (LUT), of CMYK or of grey: a doubt names the profile, and nothing is converted",),
)
LARGEST = 16 << 20  # bytes of a profile
MOST_TAGS, MOST_SAMPLES = 100, 65_536
NAMED = 60  # characters of a name
SAME = 0.004  # entries of a matrix that differ by less from the identity are sRGB's own, rounded
WHITE_OFF = 0.03  # of a row's sum from 1: white of the profile is not white
MANY = 0.02  # share of pixels that lie outside of sRGB, from which on that is a doubt
BARELY = 1 / 255 / 12.92  # linear value beyond [0, 1] that rounding to 8 bits may make

D65, D50_XYZ = (0.3127, 0.3290), np.array([0.9642, 1.0, 0.8249])
PRIMARIES = {  # (x, y) of red, green, blue, white
    "sRGB": ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060), D65),
    "Display P3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060), D65),
    "DCI-P3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060), (0.314, 0.351)),
    "Adobe RGB (1998)": ((0.640, 0.330), (0.210, 0.710), (0.150, 0.060), D65),
    "Rec. 2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), D65),
    "Rec. 601, 625 lines": ((0.640, 0.330), (0.290, 0.600), (0.150, 0.060), D65),
    "Rec. 601, 525 lines": ((0.630, 0.340), (0.310, 0.595), (0.155, 0.070), D65),
    "ACES AP0": ((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.0770), (0.32168, 0.33767)),
    "ACES AP1": ((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), (0.32168, 0.33767)),
}
OF_CICP = {1: "sRGB", 5: "Rec. 601, 625 lines", 6: "Rec. 601, 525 lines", 7: "Rec. 601, 525 lines", 9: "Rec. 2020"}
OF_CICP |= {11: "DCI-P3", 12: "Display P3"}
HDR = {16: "PQ", 18: "HLG"}
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
ADOBE_GAMMA = 2.19921875


class Refused(ValueError):
    """The file requires what is not understood: (field, why and the way out)."""


class Space(NamedTuple):
    """name : for messages
    matrix : (3, 3) linear sRGB of its linear R, G, B; rows add up to 1
    curves : one, or one for R, G and B: (n,) linear values at display values evenly from 0 to 1
    by : who says so, for messages
    """

    name: str
    matrix: np.ndarray
    curves: tuple = ()
    by: str = "the file's own profile"

    @property
    def is_srgb(self) -> bool:
        """Its primaries are sRGB's, and its channels have one curve: values stay as they are, whatever the curve."""
        return len(self.curves) <= 1 and bool((np.abs(self.matrix - np.eye(3)) < SAME).all())


# ---- primaries and curves ----


def _xyz(primaries):
    """(3, 3) CIE XYZ, D50, of linear R, G, B. primaries : (x, y) of red, green, blue, white"""
    x, y = np.array(primaries, float).T
    if (np.abs(y) < 1e-6).any() or not np.isfinite([x, y]).all():
        raise ValueError("its primaries are none")
    columns = np.stack([x / y, np.ones(4), (1 - x - y) / y])
    rgb, white = columns[:, :3], columns[:, 3]
    if abs(np.linalg.det(rgb)) < 1e-9:
        raise ValueError("its primaries lie on a line")
    adapt = np.linalg.inv(BRADFORD) @ np.diag((BRADFORD @ D50_XYZ) / (BRADFORD @ white)) @ BRADFORD
    return adapt @ (rgb * np.linalg.solve(rgb, white))


FROM_XYZ = np.linalg.inv(_xyz(PRIMARIES["sRGB"]))
GRID = np.linspace(0, 1, MOST_SAMPLES)
SRGB_CURVE = linear_from_srgb(GRID)


def of_primaries(primaries, name, curve=SRGB_CURVE, by="the file's own profile") -> Space:
    """primaries : (x, y) of red, green, blue, white, or a key of PRIMARIES. ValueError: they span nothing"""
    return _space(name, _xyz(PRIMARIES[primaries] if isinstance(primaries, str) else primaries), (curve,), by)


def power(gamma) -> np.ndarray:
    """The curve of a pure gamma. ValueError: it is none."""
    if not 0.2 <= gamma <= 8:
        raise ValueError(f"gamma {gamma:.3g} is none")
    return GRID**gamma


def adobe(by) -> Space:
    return of_primaries("Adobe RGB (1998)", "Adobe RGB (1998)", power(ADOBE_GAMMA), by)


def _space(name, xyz, curves, by="the file's own profile"):
    matrix = FROM_XYZ @ xyz
    sums = matrix.sum(axis=1)
    if not np.isfinite(matrix).all() or (np.abs(sums - 1) > WHITE_OFF).any() or abs(np.linalg.det(matrix)) < 0.01:
        raise ValueError("its primaries do not add up to white")
    matrix = matrix / sums[:, None]  # greys stay grey: the file's numbers are rounded
    same = all(np.abs(curve - curves[0]).max() < 1e-4 for curve in curves[1:])
    return Space(name, matrix, curves[:1] if same else curves, by)


def of_cicp(data) -> Space | None:
    """Of PNG's chunk cICP, or of the tag of that name in a profile: four bytes.

    None: it says sRGB.  Refused: HDR, or values that do not fill the range.  ValueError: not understood
    """
    if len(data) < 4:
        raise ValueError("it has no four bytes")
    primaries, curve, matrix, full = data[:4]
    if curve in HDR:
        raise Refused("cICP", f"{HDR[curve]}: is HDR: save the SDR picture (sRGB), or linear light as an EXR")
    if matrix != 0 or full != 1:
        raise Refused("cICP", f"matrix {matrix}, range {full}: is no R, G, B of full range: convert it to sRGB")
    if primaries not in OF_CICP or curve not in (1, 4, 5, 6, 8, 13, 14, 15):
        raise ValueError(f"primaries {primaries} with curve {curve} are not known")
    gamma = {4: 2.2, 5: 2.8, 8: 1.0}.get(curve)
    name = OF_CICP[primaries]
    linear = power(gamma) if gamma else SRGB_CURVE if curve == 13 else _rec709()
    return None if name == "sRGB" else of_primaries(name, name, linear, "the file's own cICP")


def _rec709():
    return np.where(GRID < 0.081, GRID / 4.5, ((GRID + 0.099) / 1.099) ** (1 / 0.45))


# ---- ICC ----


def name_of_icc(data) -> str:
    """What a profile calls itself, for messages."""
    try:
        tags = _tags(data)
        return _text(tags[b"desc"]) or "without a name"
    except (ValueError, KeyError, struct.error):
        return "without a name"


def of_icc(data) -> Space:
    """The space of a profile with primaries and curves.  Refused: HDR.  ValueError: what is not understood"""
    if not 132 <= len(data) <= LARGEST or data[36:40] != b"acsp":
        raise ValueError("is damaged")
    colours, pcs = data[16:20], data[20:24]
    try:
        tags = _tags(data)
        cicp = tags.get(b"cicp", b"")
        if len(cicp) >= 12 and cicp[9] in HDR:
            raise Refused("ICC profile", f"{HDR[cicp[9]]}: is HDR: save the SDR picture, or linear light as an EXR")
        if colours != b"RGB ":
            raise ValueError(f"is for {colours.decode('latin-1').strip()!r:.12}, not for R, G, B")
        if pcs != b"XYZ " or not {b"rXYZ", b"gXYZ", b"bXYZ", b"rTRC", b"gTRC", b"bTRC"} <= set(tags):
            raise ValueError("has tables (LUT) instead of primaries and curves")
        xyz = np.array([_xyz_of(tags[c + b"XYZ"]) for c in (b"r", b"g", b"b")]).T
        curves = tuple(_curve(tags[c + b"TRC"]) for c in (b"r", b"g", b"b"))
    except struct.error:
        raise ValueError("is damaged") from None
    return _space(_text(tags.get(b"desc", b"")) or "a profile without a name", xyz, curves)


def _tags(data):
    """{signature: data} of a profile."""
    (count,) = struct.unpack_from(">I", data, 128)
    if count > MOST_TAGS:
        raise ValueError("is damaged")
    tags = {}
    for k in range(count):
        name, at, size = struct.unpack_from(">4sII", data, 132 + 12 * k)
        if at + size > len(data):
            raise ValueError("is damaged")
        tags[name] = data[at : at + size]
    return tags


def _xyz_of(tag):
    return np.array(struct.unpack_from(">3i", tag, 8)) / 65536


def _curve(tag):
    """(MOST_SAMPLES,) linear values of a `curv` or a `para`."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return GRID
        if count == 1:
            return power(struct.unpack_from(">H", tag, 12)[0] / 256)
        if count > MOST_SAMPLES or len(tag) < 12 + 2 * count:
            raise ValueError("is damaged")
        curve = np.interp(GRID, np.linspace(0, 1, count), np.frombuffer(tag, ">u2", count, 12) / 65535)
    elif tag[:4] == b"para":
        curve = _parametric(tag)
    else:
        raise ValueError(f"has a curve of the kind {tag[:4].decode('latin-1')!r:.12}")
    if not np.isfinite(curve).all() or (np.diff(curve) < 0).any() or curve[0] > 0.1 or abs(curve[-1] - 1) > 0.02:
        raise ValueError("has a curve that does not rise from 0 to 1")
    return curve


OF_KIND = {0: "g", 1: "gab", 2: "gabc", 3: "gabcd", 4: "gabcdef"}


def _parametric(tag):
    """ICC.1:2010, table 65: (a x + b)^g + c above d, and c x + f below."""
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind not in OF_KIND:
        raise ValueError(f"has a curve of the kind {kind}")
    p = dict.fromkeys("abcdef", 0.0) | {"a": 1.0}
    p |= dict(zip(OF_KIND[kind], np.array(struct.unpack_from(f">{len(OF_KIND[kind])}i", tag, 12)) / 65536, strict=True))
    if not 0.2 <= p["g"] <= 8 or abs(p["a"]) < 1e-3:
        raise ValueError("has a curve that does not rise from 0 to 1")
    if kind in (1, 2):
        knee, slope, below, above = -p["b"] / p["a"], 0.0, p["c"], p["c"]
    else:
        knee, slope, below, above = p["d"], p["c"], p["f"], p["e"]
    power = np.maximum(p["a"] * GRID + p["b"], 0) ** p["g"] + above
    return power if kind == 0 else np.where(knee <= GRID, power, slope * GRID + below)


def _text(tag):
    """Of a `desc` (version 2) or a `mluc` (version 4), printable and short."""
    try:
        if tag[:4] == b"desc":
            (size,) = struct.unpack_from(">I", tag, 8)
            words = tag[12 : 12 + min(size, 4 * NAMED)].decode("latin-1")
        elif tag[:4] == b"mluc":
            size, at = struct.unpack_from(">II", tag, 20)
            words = tag[at : at + min(size, 8 * NAMED)].decode("utf-16-be", "replace")
        else:
            return ""
    except struct.error:
        return ""
    return " ".join("".join(c if c.isprintable() else " " for c in words.split("\0")[0]).split())[:NAMED]


# ---- pixels ----


def said(space, outside, pixels) -> tuple[tuple, tuple]:
    """(notes, doubts): one line that the colours were converted; a doubt where many pixels are clipped by it."""
    count = f"{outside} pixel lies" if outside == 1 else f"{outside} pixels lie"
    line = f"{space.name}: converted to sRGB primaries by {space.by}; {count} outside"
    return ((), (line,)) if outside > MANY * pixels else ((line,), ())


def in_srgb(space, values) -> tuple[np.ndarray, int]:
    """Display values with sRGB's primaries, and how many pixels lie outside of what these can show.

    values : (H, W, 3) display in [0, 1] of `space`.  What lies outside is clipped. A pixel of which a channel was
    saturated stays saturated: it has a 1. Channels of one curve are shown by it again, others by sRGB's
    """
    rows = max(1, 2_000_000 // max(1, values.shape[1]))  # at a time: what lies between takes little memory
    out, outside = np.empty(values.shape), 0
    own = len(space.curves) == 1
    curves, shown = space.curves * (3 if own else 1), _inverse(space.curves[0] if own else SRGB_CURVE)
    for start in range(0, len(values), rows):
        part = values[start : start + rows]
        places = np.rint(part * (MOST_SAMPLES - 1)).astype(np.uint16)
        linear = np.stack([curve[places[..., c]] for c, curve in enumerate(curves)], axis=-1) @ space.matrix.T
        full = part >= 1
        saturated = full.any(axis=2)
        beyond = (linear < -BARELY).any(axis=2) | ((linear > 1 + BARELY).any(axis=2) & ~saturated)
        outside += int(beyond.sum())
        made = shown[np.rint(np.clip(linear, 0, 1) * (len(shown) - 1)).astype(np.int32)]
        lost = saturated & ~(made >= 1).any(axis=2)
        made[lost] = np.where(full[lost], 1.0, made[lost])
        if own:
            grey = (part[..., :1] == part).all(axis=2)
            made[grey] = part[grey]
        out[start : start + rows] = made
    return out, outside


def _inverse(curve):
    """(2^20 + 1,) display values at linear values evenly from 0 to 1."""
    return np.interp(np.linspace(0, 1, (1 << 20) + 1), curve, GRID)


def light_in_srgb(space, light) -> tuple[np.ndarray, int]:
    """The same of linear light (H, W, 3) of an EXR, which may exceed 1; what is below 0 is set to 0."""
    made = light @ space.matrix.T
    outside = int((made < -1e-4 * np.maximum(1e-6, np.abs(light).max(axis=2, keepdims=True))).any(axis=2).sum())
    return np.maximum(made, np.minimum(light, 0)), outside
