"""Files of pictures before they are decoded: how large they say they are, and whether they are whole.

The decoders fill in what is missing or damaged, and only grumble.
"""

import contextlib
import io
import os
import re
import struct
import sys
import tempfile
import threading
import warnings
import zlib
from dataclasses import replace

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import colour_profiles, jpeg_files, tiff
from lib.given.described import Described, colours_of, exif_of
from lib.given.formats import Format, LeftOut

FORMAT = Format(
    "PNG",
    read=(
        "1 to 16 bits, grey, R, G, B or a palette, interlaced or not; alpha that is opaque; orientation in eXIf",
        "cICP, iCCP, sRGB, gAMA with cHRM, in this order",
    ),
    refused=(
        ("transparent pixels", "flatten it"),
        ("HDR (PQ, HLG in cICP)", "save the SDR picture, or an EXR"),
        ("chunks that must be understood and are not (CgBI of iOS)", "save it as a plain PNG"),
    ),
    left_out=("further pictures of an animation",),
)
MARKS = {b"\x89PNG\r\n\x1a\n": "PNG", b"\xff\xd8": "JPEG"}  # first bytes
MARKS |= {b"II*\0": "TIFF", b"MM\0*": "TIFF", b"II+\0": "TIFF", b"MM\0+": "TIFF"}
OTHERS = {  # formats that are not read, or not under such a name, and that Pillow may not know
    rb".{4}ftyp(hei[cxms]|hev[cx]|mif1|msf1)": "HEIC",
    rb"\0\0\0\x0cJXL |\xff\x0a": "JPEG XL",
    rb"\x76\x2f\x31\x01": "EXR",
}
DAMAGE = re.compile(
    r"^(Corrupt|Premature end of|Invalid .*) JPEG|^Inconsistent prog|Exception raised reading pixel|EXR_ERR_|Decode: "
)


def format_of(content) -> str | None:
    """PNG, JPEG or TIFF by the first bytes; None of anything else."""
    return next((format for mark, format in MARKS.items() if content.startswith(mark)), None)


def other_format_of(content) -> str | None:
    """The name of another format by the first bytes; None of one that is not known by them.

    >>> other_format_of(b"\\0\\0\\0\\x18ftypheic")
    'HEIC'
    """
    return next((format for mark, format in OTHERS.items() if re.match(mark, content, re.S)), None)


def describe(path, content) -> tuple[Described, tiff.Tiff | None] | None:
    """What a PNG, a JPEG or a TIFF says of itself; None where it is none of them.

    BadInput: too large, truncated, damaged, or with what is on no short list. A JPEG and most TIFFs have no checksum.
    """
    format = format_of(content)
    if format == "PNG":
        return _png_described(path, *_check_png(path, content)), None
    if format == "JPEG":
        found = jpeg_files.described(path, content)
        bounded.check_picture(path, *found.size, len(content))
        return found, None
    if format == "TIFF":
        found = tiff.described(path, content, lambda *size: bounded.check_picture(path, *size, len(content)))
        _check_packed(path, content, found.page.tags)
        return found.described, found
    return None


def check_labels(path, content):
    """(width, height) px of a PNG or TIFF of whole numbers, which may be as even as can be; None where it is neither.

    BadInput: too large, truncated or damaged, as far as can be told
    """
    format = format_of(content)
    if format == "PNG":
        _check_png(path, content, of_labels=True)
    return _announced(path, content, format) if format in ("PNG", "TIFF") else None


@contextlib.contextmanager
def opened(source):
    """Pillow's image of a path or a file: its header has been read, and no pixel. It raises whatever it raises."""
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with Image.open(source) as picture:
            yield picture


_HEARING = threading.Lock()


@contextlib.contextmanager
def heard():
    """Yields a list of what decoders say to the terminal meanwhile about damage, which some say nowhere else.

    Nothing of it comes to the terminal.
    """
    found, words = [], io.StringIO()
    with _HEARING, tempfile.TemporaryFile() as file:
        sys.stdout.flush(), sys.stderr.flush()
        kept = os.dup(1), os.dup(2)
        try:
            os.dup2(file.fileno(), 1), os.dup2(file.fileno(), 2)
            with contextlib.redirect_stdout(words):
                yield found
        finally:
            sys.stderr.flush()
            for number, own in zip((1, 2), kept, strict=True):
                os.dup2(own, number), os.close(own)
            file.seek(0)
            lines = (file.read().decode("utf-8", "replace") + words.getvalue()).splitlines()
            found += [" ".join(line.split()) for line in lines if DAMAGE.search(line)]


def _announced(path, content, format):
    """(width, height) px of labels by the header, None where it cannot be read; BadInput where they are too many.

    A TIFF is decoded as well, where Pillow can: its decoder in OpenCV is silent about damage.
    """
    from PIL import UnidentifiedImageError

    try:
        with heard(), opened(io.BytesIO(content)) as picture:
            size = picture.size
            bounded.check_picture(path, *size, None)
            if format == "TIFF":
                _check_deflate(path, content, {TIFF_NAMES[n]: v for n, v in picture.tag_v2.items() if n in TIFF_NAMES})
                picture.load()
    except UnidentifiedImageError:
        size = tiff.size_of(content) if format == "TIFF" else None
        if size:
            bounded.check_picture(path, *size, None)
    except OSError as error:
        raise BadInput(f"{path}: damaged: {' '.join(str(error).split()):.80}") from None
    except BadInput:
        raise
    except Exception:  # whatever a damaged header makes of it
        return None
    return size


def _check_packed(path, content, tags):
    """What unpacking tells of damage to a TIFF's strips: OpenCV's decoder is silent about it."""
    _check_deflate(path, content, tags)
    if tags.get("compression", (1,))[0] in (5, 7, 32773):
        try:
            with heard(), opened(io.BytesIO(content)) as picture:
                picture.load()
        except OSError as error:
            if "cannot identify" not in str(error):
                raise BadInput(f"{path}: damaged: {' '.join(str(error).split()):.80}") from None
        except Exception:  # what Pillow has no mode for
            return


TIFF_NAMES = {259: "compression", 273: "strips", 279: "strip_bytes", 324: "tiles", 325: "tile_bytes"}


def _check_deflate(path, content, tags):
    """Strips and tiles that are deflated end with their checksum; OpenCV's decoder does not look at it."""
    packed = tags.get("compression", (1,))
    if (packed[0] if isinstance(packed, tuple) else packed) in (8, 32946):
        for starts, counts in (("strips", "strip_bytes"), ("tiles", "tile_bytes")):
            for start, count in zip(tags.get(starts, ()), tags.get(counts, ()), strict=False):
                _unpacked(path, [content[start : start + count]], bounded.LARGEST_FILE)


def _check_png(path, content, of_labels=False):
    """(header, {kind: data} of what is told of colours, bytes up to its end).

    BadInput: a chunk that is not whole, a wrong checksum, no IEND, or not as much data as the header says.
    """
    at, packed, header, told = 8, [], None, {}
    while True:
        if at + 12 > len(content):
            raise BadInput(f"{path}: truncated: the PNG ends at byte {len(content)} before its last chunk")
        length, kind = struct.unpack(">I4s", content[at : at + 8])
        chunk = f"chunk {kind.decode('ascii', 'replace')!r:.20} at byte {at}"
        if at + 12 + length > len(content):
            left = len(content) - at - 12
            raise BadInput(f"{path}: truncated: {chunk} needs {length} bytes, {left} are there")
        data = content[at + 8 : at + 8 + length]
        (check,) = struct.unpack(">I", content[at + 8 + length : at + 12 + length])
        if zlib.crc32(data, zlib.crc32(kind)) != check:
            raise BadInput(f"{path}: damaged: {chunk} has a wrong checksum")
        at += 12 + length
        if kind == b"IHDR" and length == 13 and header is None:
            header = struct.unpack(">IIBBBBB", data)
            bounded.check_picture(path, *header[:2], None if of_labels else len(content))
        elif kind == b"IDAT":
            packed.append(data)
        elif kind in TOLD:
            told.setdefault(kind, data)
        elif kind == b"IEND":
            break
        elif kind not in CRITICAL and not kind[0] & 0x20:  # a capital: it must be understood
            way_out = "undo it: pngcrush -revert-iphone-optimizations" if kind == b"CgBI" else "save it as a plain PNG"
            raise BadInput(f"{path}: {chunk} is not known, and must be: {way_out}")
    if header is None:
        raise BadInput(f"{path}: damaged: the PNG has no header")
    _check_deflated(path, packed, header)
    return header, told, at


CRITICAL = (b"IHDR", b"PLTE", b"IDAT", b"IEND")
OF_ANIMATIONS = (b"acTL", b"fcTL", b"fdAT")
TOLD = (b"tRNS", b"cICP", b"iCCP", b"sRGB", b"gAMA", b"cHRM", b"eXIf", b"acTL")


def _png_described(path, header, told, end):
    width, height, bits, kind = header[:4]
    exif, coloured = exif_of(told.get(b"eXIf", b"")), 1 if kind in (0, 4) else 3
    profile, doubts = b"", ()
    others = tuple(of for of in (_of_cicp(told), _of_chrm(told)) if of)
    if b"cICP" not in told and b"iCCP" in told:
        profile, doubts = _icc_of_png(told[b"iCCP"])
    elif b"sRGB" in told and b"cICP" not in told:
        others = (lambda: None,)
    space, notes, more = colours_of(path, profile, coloured, exif, others)
    left = LeftOut()
    left.add("further frame", max(0, int.from_bytes(told.get(b"acTL", b"")[:4], "big") - 1))
    notes += tuple(filter(None, [left.line()]))
    samples = {0: 1, 2: 3, 3: 3, 4: 1, 6: 3}.get(kind, 0)
    found = Described(
        "PNG", (width, height), samples, bits, end, exif.turn, space, notes=notes, doubts=(*doubts, *more)
    )
    if kind == 0 and len(told.get(b"tRNS", b"")) == 2:  # OpenCV makes alpha of it beside colours, and not beside grey
        clear = int.from_bytes(told[b"tRNS"], "big")
        return replace(found, clear=clear * 255 // ((1 << bits) - 1) if bits < 8 else clear)
    return found


def without_animation(content) -> bytes:
    """A PNG that has been checked, with its own picture alone: OpenCV would show the first frame in its place."""
    if content.find(b"acTL", 0, max(0, content.find(b"IDAT"))) < 0:
        return content
    at, kept = 8, [content[:8]]
    while at + 12 <= len(content):
        end = at + 12 + int.from_bytes(content[at : at + 4], "big")
        if content[at + 4 : at + 8] not in OF_ANIMATIONS:
            kept.append(content[at:end])
        at = end
    return b"".join(kept)


def _of_cicp(told):
    return (lambda: colour_profiles.of_cicp(told[b"cICP"])) if b"cICP" in told else None


def _of_chrm(told):
    """Primaries of cHRM with the curve of gAMA, where it is another than about sRGB's."""
    if b"cICP" in told or len(told.get(b"cHRM", b"")) < 32:
        return None
    gamma = int.from_bytes(told.get(b"gAMA", b"")[:4], "big") / 1e5

    def of():
        white, *rgb = np.array(struct.unpack(">8I", told[b"cHRM"][:32])).reshape(4, 2) / 1e5
        curve = colour_profiles.power(1 / gamma) if gamma and abs(gamma - 1 / 2.2) > 0.01 else None
        curve = colour_profiles.SRGB_CURVE if curve is None else curve
        return colour_profiles.of_primaries((*rgb, white), "its own primaries", curve, "the file's own cHRM")

    return of


def _icc_of_png(data):
    """(profile, doubts)"""
    name, _, packed = data.partition(b"\0")
    try:
        return zlib.decompressobj().decompress(packed[1:], colour_profiles.LARGEST), ()
    except zlib.error:
        return b"", (f"ICC profile {name.decode('latin-1')!r:.60}: is damaged: nothing is converted",)


SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # of a PNG's colour types
PASSES = (
    (0, 0, 8, 8),
    (0, 4, 8, 8),
    (4, 0, 8, 4),
    (0, 2, 4, 4),
    (2, 0, 4, 2),
    (0, 1, 2, 2),
    (1, 0, 2, 1),
)  # interlaced


def _check_deflated(path, packed, header):
    """The data of a PNG unpack to its rows, to the byte."""
    width, height, bits, colours, _, _, interlaced = header
    parts = PASSES if interlaced else ((0, 0, 1, 1),)
    sides = [(len(range(y, height, dy)), len(range(x, width, dx))) for y, x, dy, dx in parts]
    row = lambda count: 1 + (count * SAMPLES.get(colours, 1) * bits + 7) // 8
    needed = sum(rows * row(columns) for rows, columns in sides if rows and columns)
    there = _unpacked(path, packed, needed)
    if there != needed:
        more = " or more" if there > needed else ""
        raise BadInput(f"{path}: damaged: its rows have {needed} bytes, {there}{more} are there")


def _unpacked(path, packed, most):
    """How many bytes deflated data unpack to; no more are unpacked when there are more than `most`.

    BadInput: they are damaged, or end before their checksum.
    """
    unpacker, there = zlib.decompressobj(), 0
    try:
        for data in packed:
            while data and there <= most:
                there += len(unpacker.decompress(data, 1 << 20))
                data = unpacker.unconsumed_tail
    except zlib.error as error:
        raise BadInput(f"{path}: damaged: {error}") from None
    if there <= most and not unpacker.eof:
        raise BadInput(f"{path}: damaged: the data end before their checksum")
    return there


# ---- texts in a PNG ----


def with_text(content, key, text) -> bytes:
    """A PNG with one more text, behind its header of 33 bytes."""
    data = b"tEXt" + key.encode("latin-1") + b"\0" + text.encode("latin-1")
    return content[:33] + struct.pack(">I", len(data) - 4) + data + struct.pack(">I", zlib.crc32(data)) + content[33:]


def text_of_png(content, key) -> str:
    """The text under a key, where it stands before the pixels; else ""."""
    at, wanted = 8, key.encode("latin-1") + b"\0"
    while at + 12 <= len(content) and content[at + 4 : at + 8] != b"IDAT":
        (length,) = struct.unpack(">I", content[at : at + 4])
        data = content[at + 8 : at + 8 + length]
        if content[at + 4 : at + 8] == b"tEXt" and data.startswith(wanted):
            return data[len(wanted) :].decode("latin-1")
        at += 12 + length
    return ""
