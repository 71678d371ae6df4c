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

from lib.core import bounded
from lib.core.stage import BadInput

MARKS = {b"\x89PNG\r\n\x1a\n": "PNG", b"\xff\xd8": "JPEG", b"II*\0": "TIFF", b"MM\0*": "TIFF"}  # first bytes
DAMAGE = re.compile(
    r"^(Corrupt|Premature end of|Invalid .*) JPEG|^Inconsistent prog|Exception raised reading pixel|EXR_ERR_|Decode: "
)


def check(path, content, of_labels=False):
    """(width, height) px of a PNG, a JPEG or a TIFF, None where it is none of them, or not readable.

    of_labels : a picture of whole numbers, which may be as even as can be
    BadInput: too large, truncated or damaged, as far as can be told. A JPEG and most TIFFs have no checksum.
    """
    format = next((format for mark, format in MARKS.items() if content.startswith(mark)), None)
    if format == "PNG":
        _check_png(path, content, of_labels)
    elif format == "JPEG" and b"\xff\xd9" not in content[-1024:]:
        raise BadInput(f"{path}: truncated: {len(content)} bytes without the end of a JPEG")
    return _announced(path, content, format, of_labels) if format else None


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


def _announced(path, content, format, of_labels):
    """(width, height) px by the header, None where it cannot be read; BadInput where they are too many.

    A TIFF is decoded as well, where Pillow can: its decoder in OpenCV is silent about damage.
    """
    from PIL import UnidentifiedImageError

    try:
        with heard(), opened(io.BytesIO(content)) as picture:
            size = picture.size
            bounded.check_picture(path, *size, None if of_labels else len(content))
            if format == "TIFF":
                _check_strips(path, content, picture.tag_v2)
                picture.load()
    except UnidentifiedImageError:
        size = _tiff_size(content) if format == "TIFF" else None
        if size:
            bounded.check_picture(path, *size, None if of_labels else len(content))
    except OSError as error:
        raise BadInput(f"{path}: damaged: {' '.join(str(error).split()):.80}") from None
    except BadInput:
        raise
    except Exception:  # whatever a damaged header makes of it
        return None
    return size


def _check_strips(path, content, tags):
    """Strips and tiles that are deflated end with their checksum; OpenCV's decoder does not look at it."""
    if tags.get(259) in (8, 32946):
        for starts, counts in ((273, 279), (324, 325)):
            for start, count in zip(tags.get(starts, ()), tags.get(counts, ()), strict=False):
                _unpacked(path, [content[start : start + count]], bounded.LARGEST_FILE)


def _tiff_size(content):
    """The same of a TIFF whose samples Pillow does not know."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tags, file = ImageFileDirectory_v2(content[:8]), io.BytesIO(content)
            file.seek(tags.next)
            tags.load(file)
            return int(tags[256]), int(tags[257])
    except Exception:  # whatever a damaged header makes of it
        return None


def _check_png(path, content, of_labels=False):
    """Every chunk whole, its checksum right, the last one IEND; the picture's data as long as its header says."""
    at, packed, header = 8, [], None
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
        elif kind == b"IEND":
            break
    if header is None:
        raise BadInput(f"{path}: damaged: the PNG has no header")
    _check_deflated(path, packed, header)


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
