"""JPEGs: where the picture ends, and what its markers say of its pixels.

Behind the end a phone or a camera puts what is no part of the picture: a film (motion photos), further pictures (MPO),
a gain map (Ultra HDR).  The end is found by walking the markers and scans, so that a film's bytes, or a small picture
in EXIF, are never taken for it.
"""

from __future__ import annotations

import re
import struct
from typing import NamedTuple

from lib.core.stage import BadInput
from lib.given.described import Described, colours_of, exif_of
from lib.given.formats import Format, LeftOut

FORMAT = Format(
    "JPEG",
    read=(
        "8 bits, grey, YCbCr or R, G, B; baseline, progressive or arithmetic; EXIF's orientation",
        "the picture alone of a motion photo, an MPO or an Ultra HDR file: that of standard range",
    ),
    refused=(
        ("12 bits, lossless, hierarchical, JPEG-LS", "save it with 8 bits, or as a 16-bit PNG"),
        ("CMYK, YCCK", "convert it to R, G, B (sRGB)"),
        ("a panorama (ProjectionType of GPano)", "give a picture of one view"),
    ),
    left_out=("films, further pictures and gain maps behind the end", "XMP: an orientation there is not EXIF's"),
)
IN_A_SCAN = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")  # the next marker that is no restart
FRAMES = {0xC0: "", 0xC1: "", 0xC2: "", 0xC9: "", 0xCA: "", 0xC3: "lossless", 0xCB: "lossless", 0xF7: "JPEG-LS"}
FRAMES |= {n: "hierarchical" for n in (0xC5, 0xC6, 0xC7, 0xCD, 0xCE, 0xCF)}
BARE = (0x01, *range(0xD0, 0xD9))  # markers without a segment
MOST_SEGMENTS = 100_000
ICC, EXIF, MPF = b"ICC_PROFILE\0", b"Exif\0\0", b"MPF\0"
PANORAMA = re.compile(rb"GPano:ProjectionType\W{1,9}(equirectangular|cylindrical|fisheye|cubic|sphere)", re.I)  # in XMP
GAIN_MAP = (b"hdrgm:", b"HDRGainMap", b"urn:iso:std:iso:ts:21496:-1")


class Parts(NamedTuple):
    """end : bytes up to the picture's own end, None where there is none;  frame : (marker, SOF's content) or None
    segments : [(marker, content)] of APP0 to APP15
    """

    end: int | None
    frame: tuple | None
    segments: list


def parts(content) -> Parts:
    """Walked from the first marker to the picture's own end, in a time like its length."""
    at, frame, found, count = 2, None, [], 0
    while at + 2 <= len(content) and count < MOST_SEGMENTS:
        count += 1
        if content[at] != 0xFF:  # libjpeg skips what lies between segments
            at = content.find(b"\xff", at)
            if at < 0:
                break
            continue
        marker = content[at + 1]
        if marker in (0xFF, 0x00) or marker in BARE:
            at += 1 if marker == 0xFF else 2
            continue
        if marker == 0xD9:
            return Parts(at + 2, frame, found)
        if at + 4 > len(content):
            break
        size = int.from_bytes(content[at + 2 : at + 4], "big")
        segment = content[at + 4 : at + 2 + size]
        if marker in FRAMES and frame is None:
            frame = marker, segment
        elif 0xE0 <= marker <= 0xEF:
            found.append((marker, segment))
        at += 2 + max(2, size)
        if marker == 0xDA:
            scan = IN_A_SCAN.search(content, at)
            if scan is None:
                break
            at = scan.start()
    return Parts(None, frame, found)


def described(path, content) -> Described:
    """BadInput: truncated, or what is not on the short list."""
    end, frame, segments = parts(content)
    if end is None:
        raise BadInput(f"{path}: truncated: {len(content)} bytes without the end of a JPEG")
    if frame is None or len(frame[1]) < 6:
        raise BadInput(f"{path}: damaged: a JPEG without a frame")
    bits, height, width, samples = struct.unpack(">BHHB", frame[1][:6])
    if FRAMES[frame[0]]:
        raise BadInput(f"{path}: coding: {FRAMES[frame[0]]}: save it as a baseline JPEG, or as a PNG")
    if bits != 8:
        raise BadInput(f"{path}: samples: {bits} bits instead of 8: save it with 8 bits, or as a 16-bit PNG")
    if samples == 4:
        raise BadInput(f"{path}: colours: CMYK: convert the photograph to RGB (sRGB)")
    if samples not in (1, 3):
        raise BadInput(f"{path}: channels: {samples} instead of 1 or 3")
    for marker, data in segments:
        if marker == 0xE1 and (kind := PANORAMA.search(data)):
            kind = kind[1].decode("ascii").lower()
            raise BadInput(f"{path}: XMP: {kind}: is a panorama, which no lens shows: give a picture of one view")
    exif = exif_of(next((data for marker, data in segments if marker == 0xE1 and data.startswith(EXIF)), b""))
    profile, doubt = _profile(segments)
    space, notes, doubts = colours_of(path, profile, samples, exif)
    line = _left_out(content, end, segments)
    return Described(
        *("JPEG", (width, height), samples, bits, end, exif.turn, space),
        notes=(*notes, *line),
        doubts=(*doubts, *doubt),
    )


def _profile(segments):
    """(ICC profile put together, or b"", doubts)"""
    pieces = {}
    for marker, data in segments:
        if marker == 0xE2 and data.startswith(ICC) and len(data) > 14:
            pieces.setdefault(data[12], (data[13], data[14:]))
    if not pieces:
        return b"", ()
    count = next(iter(pieces.values()))[0]
    if len(pieces) != count:  # they are counted from 1, but Blender counts its only one as 0
        return b"", (f"ICC profile: {len(pieces)} of {count} pieces are there: it is not read. Convert it to sRGB",)
    return b"".join(pieces[k][1] for k in sorted(pieces)), ()


def _left_out(content, end, segments):
    """A line, or none, of what is there beside the picture."""
    left, more = LeftOut(), content[end:]
    gain = any(mark in data for marker, data in segments if marker in (0xE1, 0xE2) for mark in GAIN_MAP)
    left.add("HDR gain map", gain)
    film = more.find(b"ftyp", 0, 1 << 20) >= 0 or b"MotionPhoto_Data" in more
    left.add("motion photo film", film)
    several = any(marker == 0xE2 and data.startswith(MPF) for marker, data in segments)
    if several and not gain:
        left.add("further MPO picture", max(1, _pictures(segments) - 1))
    if more.strip(b"\0\xff") and not (gain or film or several):
        left.add("byte", len(more))
        return (f"{left.line()}: behind the end of the JPEG",)
    return tuple(filter(None, [left.line()]))


def _pictures(segments):
    """How many pictures the index of an MPO says there are; 2 where it cannot be read."""
    data = next(data for marker, data in segments if marker == 0xE2 and data.startswith(MPF))[4:]
    try:
        order = "<" if data[:2] == b"II" else ">"
        (at,) = struct.unpack_from(order + "I", data, 4)
        (count,) = struct.unpack_from(order + "H", data, at)
        for k in range(min(count, 20)):
            tag, _, _, value = struct.unpack_from(order + "HHII", data, at + 2 + 12 * k)
            if tag == 0xB001:
                return min(int(value), 1000)
    except struct.error:
        pass
    return 2
