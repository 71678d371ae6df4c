"""TIFFs: what they say of their pixels, and how these are decoded.

A TIFF may hold nearly anything. What is not on the short list of `FORMAT` is refused. OpenCV's decoder (libtiff) turns
pictures, reads planes that lie apart as if they lay together, and leaves MinIsWhite as it is; so it is given the same
strips under a directory of our own, which has nothing in it but what was understood.
"""

from __future__ import annotations

import io
import logging
import struct
from typing import NamedTuple

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import colour_profiles
from lib.given.described import UNTURNED, Described, colours_of
from lib.given.described import Exif as ExifOf
from lib.given.formats import Format, LeftOut

FORMAT = Format(
    "TIFF",
    read=(
        "8 and 16 bits, grey, R, G, B or a palette; either byte order; BigTIFF; strips or tiles; planes together or "
        "apart; not compressed, LZW, Deflate, PackBits or JPEG; Orientation; alpha that is opaque",
        "of several pages the first that is no thumbnail",
    ),
    refused=(
        ("floats", "they are linear light: save an EXR"),
        ("1, 2, 4, 10, 12, 14 or 32 bits, signed samples", "save it with 8 or 16 bits"),
        ("CMYK, Lab, LogLuv, RAW of a camera", "convert it to R, G, B (sRGB)"),
        ("a later page that is larger", "save the photograph alone"),
        ("R, G and B as three grey pages (ImageJ, OME)", "save one page of RGB"),
        ("ZSTD, LZMA, JPEG 2000, LERC, WebP", "save it with LZW, Deflate (ZIP) or none"),
    ),
    left_out=("further pages, thumbnails, masks, layers",),
)
KINDS = {1: "B", 2: "B", 3: "H", 4: "I", 5: "II", 6: "b", 7: "B", 8: "h", 9: "i", 10: "ii", 11: "f", 12: "d"}
KINDS |= {13: "I", 16: "Q", 17: "q", 18: "Q"}
SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
WHOLE, RATIOS = (1, 3, 4, 6, 8, 9, 13, 16, 17, 18), (5,)  # kinds of numbers
AS_BYTES, AS_RATIOS = ("icc", "jpeg_tables"), ("white_point", "primaries")  # tags; all others are whole numbers
MOST_PAGES, MOST_BYTES = 200, 32 << 20  # directories that are looked at; of one tag
TAGS = {
    **{254: "subfile", 256: "width", 257: "height", 258: "bits", 259: "compression", 262: "photometric"},
    **{266: "fill", 273: "strips", 274: "turn", 277: "samples", 278: "rows", 279: "strip_bytes", 281: "white"},
    **{284: "planar", 301: "transfer", 317: "predictor", 318: "white_point", 319: "primaries", 320: "palette"},
    **{322: "tile_width", 323: "tile_height", 324: "tiles", 325: "tile_bytes", 330: "sub", 338: "extra"},
    **{339: "sample_format", 347: "jpeg_tables", 530: "subsampling", 531: "positioning"},
    **{34665: "exif", 34675: "icc", 50706: "dng"},
}
COMPRESSIONS = {1: "none", 5: "LZW", 7: "JPEG", 8: "Deflate", 32946: "Deflate", 32773: "PackBits"}
OTHER_COMPRESSIONS = {2: "CCITT", 3: "CCITT", 4: "CCITT", 6: "JPEG of TIFF 6.0", 34712: "JPEG 2000", 34887: "LERC"}
OTHER_COMPRESSIONS |= {50000: "ZSTD", 34925: "LZMA", 50001: "WebP", 50002: "JPEG XL", 52546: "JPEG XL"}
OF_TIFFFILE = (1, 8, 32946)  # compressions that tifffile has without more packages
WHITE, BLACK, RGB, PALETTE, YCBCR = 0, 1, 2, 3, 6
OTHER_COLOURS = {4: "a mask", 5: "CMYK", 8: "LAB", 9: "LAB", 10: "LAB", 32803: "RAW", 34892: "RAW"}
OTHER_COLOURS |= {32844: "LogL", 32845: "LogLuv"}
REDUCED, MASK = 1, 4  # bits of NewSubfileType


class Page(NamedTuple):
    """A directory: {name of TAGS: tuple of numbers, or bytes}."""

    tags: dict

    def one(self, name, default=None):
        value = self.tags.get(name)
        return value[0] if value else default

    @property
    def size(self):
        return int(self.one("width", 0)), int(self.one("height", 0))

    @property
    def reduced(self):
        return bool(self.one("subfile", 0) & REDUCED)


class Tiff(NamedTuple):
    """order : "<" or ">";  page : the photograph's;  described : of it"""

    order: str
    page: Page
    described: Described


# ---- directories ----


def pages(path, content) -> tuple[str, list[Page]]:
    """(byte order, the directories of the chain).  BadInput: there is none, or it cannot be read"""
    order = "<" if content[:2] == b"II" else ">"
    try:
        (version,) = struct.unpack_from(order + "H", content, 2)
        big = version == 43
        (at,) = struct.unpack_from(order + ("Q" if big else "I"), content, 8 if big else 4)
        found, seen = [], set()
        while at and at not in seen and len(found) < MOST_PAGES:
            seen.add(at)
            try:
                page, at = _directory(path, content, at, order, big)
            except struct.error:
                if found:
                    break  # a chain that is cut off behind the picture
                raise
            found.append(page)
    except struct.error:
        raise BadInput(f"{path}: truncated: {len(content)} bytes without the directory of a TIFF") from None
    if not found:
        raise BadInput(f"{path}: not a readable image: a TIFF without a picture")
    return order, found


def _directory(path, content, at, order, big):
    """(Page, offset of the next)"""
    head, entry, inline = ("Q", "HHQ", 8) if big else ("H", "HHI", 4)
    (count,) = struct.unpack_from(order + head, content, at)
    at += 8 if big else 2
    step = 12 + (8 if big else 0)
    if count * step > len(content):
        raise struct.error
    tags = {}
    for k in range(count):
        tag, kind, number = struct.unpack_from(order + entry, content, at + k * step)
        if tag not in TAGS or kind not in KINDS:
            continue
        size, value = number * SIZES[kind], at + k * step + step - inline
        if size > MOST_BYTES:
            raise BadInput(f"{path}: {TAGS[tag]}: {size} bytes are more than a TIFF of a photograph needs")
        if size > inline:
            (value,) = struct.unpack_from(order + ("Q" if big else "I"), content, value)
        if value + size > len(content):
            raise BadInput(f"{path}: truncated: its tag {tag} ends at byte {value + size}, {len(content)} are there")
        data = content[value : value + size]
        name, letter = TAGS[tag], KINDS[kind]
        if name in AS_BYTES and SIZES[kind] == 1:
            tags[name] = data
        elif name not in AS_BYTES and (kind in RATIOS) == (name in AS_RATIOS) and kind in (*WHOLE, *RATIOS):
            tags[name] = struct.unpack(f"{order}{number * len(letter)}{letter[-1]}", data)
    (following,) = struct.unpack_from(order + ("Q" if big else "I"), content, at + count * step)
    return Page(tags), following


def size_of(content):
    """(width, height) px of the page that is read, None where there is none that can be."""
    try:
        return _photograph_of("", pages("", content)[1])[0].size
    except BadInput:
        return None


def described(path, content, check_size) -> Tiff:
    """BadInput: what is not on the short list. check_size(width, height) : raises where they are too many"""
    order, chain = pages(path, content)
    page, notes, doubts = _photograph_of(path, chain)
    check_size(*page.size)
    if "dng" in page.tags:
        raise BadInput(f"{path}: colours: RAW: is a DNG: develop it to a 16-bit TIFF or PNG (sRGB)")
    samples = int(page.one("samples", 1))
    alpha = _check_samples(path, page, samples)
    _check_places(path, page, samples, len(content))
    bits = int(page.one("bits", 1))
    coloured = 1 if page.one("photometric") in (WHITE, BLACK) else 3
    try:
        exif = _exif(path, content, order, page)
    except BadInput:
        exif = ExifOf()
    space, more, doubt = colours_of(path, page.tags.get("icc"), coloured, exif, _own(page))
    if "transfer" in page.tags and not page.tags.get("icc"):
        more += ("TransferFunction: not read, the curve is found",)
    turn = page.one("turn", UNTURNED)
    white = page.one("white")
    return Tiff(
        order,
        page,
        Described(
            "TIFF",
            page.size,
            samples - alpha,
            bits,
            len(content),
            turn if turn in range(1, 9) else UNTURNED,
            space,
            int(white) if white and 0 < white < (1 << bits) - 1 else None,
            notes=(*notes, *more),
            doubts=(*doubts, *doubt),
        ),
    )


def _photograph_of(path, chain):
    """(the page, notes, doubts)"""
    if chain[0].reduced and "sub" in chain[0].tags and all(page.reduced for page in chain):
        raise BadInput(
            f"{path}: pages: the first is a thumbnail, and the picture lies in a SubIFD, as in RAW files: save "
            "the photograph as a TIFF of its own"
        )
    whole = [page for page in chain if not page.reduced and not page.one("subfile", 0) & MASK]
    page, rest = (whole[0], whole[1:]) if whole else (chain[0], [])
    pixels = lambda page: page.size[0] * page.size[1]
    if larger := next((other for other in rest if pixels(other) > pixels(page)), None):
        raise BadInput(
            f"{path}: pages: {len(chain)}: the first has {page.size[0]} x {page.size[1]} px, a later one "
            f"{larger.size[0]} x {larger.size[1]}: save the photograph alone"
        )
    grey = [other for other in whole if other.one("photometric") in (WHITE, BLACK) and other.one("samples", 1) == 1]
    if len(whole) in (3, 4) and len(grey) == len(whole) and len({other.size for other in whole}) == 1:
        raise BadInput(
            f"{path}: pages: {len(whole)} grey ones of one size: are they R, G and B (ImageJ, OME)? save the "
            "photograph as one page of RGB"
        )
    left = LeftOut()
    left.add("thumbnail", sum(page.reduced for page in chain) - page.reduced)
    left.add("mask", sum(bool(page.one("subfile", 0) & MASK) and not page.reduced for page in chain))
    left.add("smaller page", sum(pixels(other) < pixels(page) for other in rest))
    alike = sum(pixels(other) == pixels(page) for other in rest)
    doubts = (f"{alike + 1} pages of one size: the first is read; save the photograph alone",) if alike else ()
    return page, tuple(filter(None, [left.line()])), doubts


def _check_samples(path, page, samples):
    """How many channels are alpha. BadInput: what is not 8 or 16 bits of grey, R, G, B or a palette"""
    photometric, compression = page.one("photometric"), page.one("compression", 1)
    bits, forms = set(page.tags.get("bits", (1,))), set(page.tags.get("sample_format", (1,)))
    if photometric in OTHER_COLOURS or photometric not in (WHITE, BLACK, RGB, PALETTE, YCBCR):
        kind = OTHER_COLOURS.get(photometric, f"photometric {photometric}")
        raise BadInput(f"{path}: colours: {kind}: convert the photograph to RGB (sRGB)")
    if compression not in COMPRESSIONS:
        kind = OTHER_COMPRESSIONS.get(compression, compression)
        raise BadInput(f"{path}: compression: {kind}: save it with LZW, Deflate (ZIP) or none")
    if forms & {3}:
        kind = f"float{max(bits)}"
        raise BadInput(f"{path}: samples: {kind} are linear light: save it as an EXR, or with 16 bits for display")
    if not forms <= {1, 4}:
        raise BadInput(f"{path}: samples: signed or complex: save it with 8 or 16 bits, not signed")
    if len(bits) != 1 or not bits <= {8, 16}:
        listed = ", ".join(map(str, sorted(bits)))
        raise BadInput(f"{path}: samples: {listed} bits instead of 8 or 16: save it with 8 or 16 bits")
    if photometric == YCBCR and compression != 7:
        raise BadInput(f"{path}: colours: YCbCr: convert the photograph to RGB (sRGB)")
    needed = 3 if photometric in (RGB, YCBCR) else 1
    if not needed <= samples <= needed + 1 or photometric == PALETTE and samples != 1:
        raise BadInput(f"{path}: channels: {samples} instead of {needed} and an alpha: save it without the others")
    return samples - needed


def _check_places(path, page, samples, length):
    """BadInput: strips or tiles are missing, or end beyond the file."""
    width, height = page.size
    planes = samples if page.one("planar", 1) == 2 else 1
    tiled = "tiles" in page.tags
    starts = page.tags.get("tiles" if tiled else "strips", ())
    counts = page.tags.get("tile_bytes" if tiled else "strip_bytes", ())
    if tiled:
        side = page.one("tile_width", 0), page.one("tile_height", 0)
        if not 0 < min(side) <= max(side) <= bounded.WIDEST_PX + 65:
            raise BadInput(f"{path}: tiles: {side[0]} x {side[1]} px: are none")
        bounded.check_picture(path, *side, None)
        needed = -(-width // side[0]) * -(-height // side[1])
    else:
        needed = -(-height // max(1, min(page.one("rows", height) or height, height)))
    what = "tiles" if tiled else "strips"
    if len(starts) < needed * planes or len(counts) != len(starts):
        raise BadInput(f"{path}: damaged: {len(starts)} {what} with {len(counts)} sizes, {needed * planes} are needed")
    for start, count in zip(starts, counts, strict=True):
        if start < 8 or start + count > length:
            raise BadInput(f"{path}: truncated: a strip or tile ends at byte {start + count}, {length} are there")
    if page.one("compression", 1) == 1:
        each = page.one("bits") // 8 * (samples // planes)
        whole = sum(counts[: needed * planes])
        pixels = needed * planes * side[0] * side[1] if tiled else width * height * planes
        if whole < pixels * each:
            raise BadInput(f"{path}: truncated: its {what} have {whole} bytes, {pixels * each} are needed")


def _exif(path, content, order, page):
    """Of EXIF's directory only ColorSpace and the index of interoperability are asked for."""
    at = page.one("exif")
    if not at or content[2:4] not in (b"*\0", b"\0*"):
        return ExifOf()

    def numbers(at):
        (count,) = struct.unpack_from(order + "H", content, at)
        entries = [struct.unpack_from(order + "HHI4s", content, at + 2 + 12 * k) for k in range(min(count, 200))]
        return {tag: value for tag, _, _, value in entries}

    try:
        found = numbers(at)
        colours = struct.unpack(order + "H", found[0xA001][:2])[0] if 0xA001 in found else None
        interop = ""
        if 0xA005 in found:
            interop = numbers(struct.unpack(order + "I", found[0xA005])[0]).get(1, b"").decode("latin-1").strip("\0 ")
        return ExifOf(UNTURNED, colours, interop)
    except struct.error:
        return ExifOf()


def _own(page):
    """TIFF's own tags of primaries and white, where both are there."""
    white, primaries = page.tags.get("white_point", ()), page.tags.get("primaries", ())
    if len(white) != 4 or len(primaries) != 12:
        return ()

    def own():
        x, y = (np.array([*primaries[k::4], white[k]], float) for k in (0, 2))
        below = [np.array([*primaries[k::4], white[k]], float) for k in (1, 3)]
        if any((b == 0).any() for b in below):
            raise ValueError("its primaries are none")
        places = np.stack([x / below[0], y / below[1]], axis=1)
        return colour_profiles.of_primaries(places, "its own primaries", by="the file's own PrimaryChromaticities")

    return (own,)


# ---- pixels ----


def pixels(path, content, tiff, decode):
    """(H, W) or (H, W, C) uint8 or uint16, channels in OpenCV's order, unturned.

    decode : bytes -> (pixels or None, what is said of damage): OpenCV
    """
    page = tiff.page
    samples, planar = int(page.one("samples", 1)), page.one("planar", 1) == 2
    image = None
    if planar and samples > 1:
        planes = [_of_opencv(path, content, tiff, decode, plane, samples) for plane in range(samples)]
        if all(plane is not None and plane.ndim == 2 for plane in planes):
            image = np.stack(planes[2::-1] + planes[3:] if samples > 2 else planes, axis=-1)
    elif samples != 2:
        image = _of_opencv(path, content, tiff, decode)
    if image is None and page.one("compression", 1) in OF_TIFFFILE and page.one("photometric") != PALETTE:
        image = _of_tifffile(path, content, tiff)
    if image is None and samples == 2:
        kind = COMPRESSIONS[page.one("compression", 1)]
        raise BadInput(f"{path}: channels: grey and alpha, {kind}: save it without alpha, or as a PNG")
    if image is None:
        return None
    if page.one("photometric") == WHITE:
        image = image.copy()
        grey = image if image.ndim == 2 else image[..., 0]
        grey[...] = np.iinfo(image.dtype).max - grey
    return image


def _of_opencv(path, content, tiff, decode, plane=None, planes=1):
    image, said = decode(_alone(content, tiff, plane, planes))
    if said:
        raise BadInput(f"{path}: damaged: {said[0]}")
    bits = tiff.page.one("bits")
    wanted = np.uint8 if bits == 8 or tiff.page.one("photometric") == PALETTE else np.uint16
    return image if image is not None and image.dtype == wanted else None


def _of_tifffile(path, content, tiff):
    """What OpenCV does not decode: alpha beside grey, small tiles."""
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            page = next(
                p
                for p in file.pages
                if p.tags.get(256)
                and (p.imagewidth, p.imagelength) == tiff.page.size
                and tuple(p.dataoffsets) == tuple(tiff.page.tags.get("tiles") or tiff.page.tags["strips"])
            )
            values = page.asarray(maxworkers=1)
    except Exception as error:  # whatever a damaged file makes of it
        raise BadInput(f"{path}: damaged: {' '.join(str(error).split()):.80}") from None
    if tiff.page.one("planar", 1) == 2 and values.ndim == 3:
        values = np.moveaxis(values, 0, -1)
    if values.ndim == 3 and values.shape[2] >= 3:
        values = np.concatenate([values[..., 2::-1], values[..., 3:]], axis=-1)
    return np.ascontiguousarray(values)


KEPT = {
    **{"width": (256, 4), "height": (257, 4), "compression": (259, 3), "fill": (266, 3), "rows": (278, 4)},
    **{"predictor": (317, 3), "palette": (320, 3), "tile_width": (322, 4), "tile_height": (323, 4)},
    **{"jpeg_tables": (347, 7), "subsampling": (530, 3), "positioning": (531, 3)},
}


def _alone(content, tiff, plane=None, planes=1) -> bytes:
    """The file with a directory that has the one picture in it, or one of its planes as a grey picture."""
    tags = tiff.page.tags
    samples = 1 if plane is not None else int(tiff.page.one("samples", 1))
    photometric = tiff.page.one("photometric")
    photometric = BLACK if plane is not None or photometric == WHITE else photometric
    part = lambda values: values if plane is None else values[len(values) // planes * plane :][: len(values) // planes]
    own = {number: (kind, tags[name]) for name, (number, kind) in KEPT.items() if name in tags}
    own |= {258: (3, (tiff.page.one("bits"),) * samples), 262: (3, (photometric,)), 277: (3, (samples,))}
    own |= {284: (3, (1,))}
    if samples in (2, 4):
        own[338] = (3, (2,))
    tiled = "tiles" in tags
    for number, name in ((324, "tiles"), (325, "tile_bytes")) if tiled else ((273, "strips"), (279, "strip_bytes")):
        own[number] = (4, part(tags[name]))
    return _with_directory(content, tiff.order, own)


def _with_directory(content, order, entries):
    """A TIFF of the same bytes whose one directory, at its end, has these entries {tag: (kind, values)}."""
    start = len(content) + len(content) % 2
    at = start + 2 + 12 * len(entries) + 4
    head, tail = [struct.pack(order + "H", len(entries))], []
    for tag, (kind, values) in sorted(entries.items()):
        data = values if isinstance(values, bytes) else struct.pack(f"{order}{len(values)}{KINDS[kind]}", *values)
        head.append(struct.pack(order + "HHI", tag, kind, len(values)))
        if len(data) <= 4:
            head.append(data.ljust(4, b"\0"))
        else:
            head.append(struct.pack(order + "I", at))
            tail.append(data + b"\0" * (len(data) % 2))
            at += len(tail[-1])
    mark = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", start)
    return b"".join([mark, content[8:], b"\0" * (len(content) % 2), *head, b"\0\0\0\0", *tail])
