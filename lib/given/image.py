"""Image files: photographs, label images, pictures of light.  The only module that knows codecs.

Arrays are indexed [y, x] or [y, x, channel], channels in the order R, G, B.
"""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import colour_profiles, exr, jpeg, picture_files, strangers_files, tiff, white_level
from lib.given.described import UNTURNED
from lib.given.transfer import display_of_linear

MAY_CLIP = 0.25  # share of a noisy surface's pixels that may be clipped: its median is not
NOISY = 0.01  # display, standard deviation of a pixel, from which a photograph may be called noisy
SKEWED, OUTLIER = 0.1, 4.0  # mean cube of second differences in sigmas; held down to so many
ENOUGH = 300_000  # pixels that tell of the noise
_OF_SECOND = 6.0
FORMATS = {".png": "PNG", ".jpg": "JPEG", ".tif": "TIFF", ".exr": "EXR"}  # as Pillow names them
RANGE_KEY = "anasyn range"  # of a text in a PNG of our own: 65535 is white
JPEG_KEY = "anasyn jpeg"  # of a text in a PNG: the JPEG that it was made of
read_exr, write_exr = exr.read, exr.write  # pictures of light and depth that are no photographs
BLACK = 2 / 255 + 1e-9  # display


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph as a stage reads it.

    values : (H, W, C) float64, C = 1 or 3; display-referred in [0, 1], or linear light (EXR) that may exceed 1
    bits : 8, 16, or 0 for EXR          linear : True for EXR
    channels_in_file : 1 or 3.  Three equal channels become C = 1; alpha is dropped
    blocks : of a JPEG, or of one that this was made of, else None
    notes : what was left out or converted, no doubt;  doubts : to look at
    """

    values: np.ndarray
    bits: int
    linear: bool
    channels_in_file: int
    blocks: jpeg.Blocks | None = None
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def display(self) -> np.ndarray:
        """(H, W, C) display values in [0, 1]."""
        return display_of_linear(self.values) if self.linear else self.values

    @property
    def ringing(self) -> float:
        """Standard deviation of what JPEG adds to a pixel at an edge (display); 0 of other files."""
        return self.blocks.edge_noise if self.blocks else 0.0

    @cached_property
    def lost_tables(self) -> bool:
        """Was it a JPEG, of which nobody knows the tables any more?"""
        return self.blocks is None and not self.linear and jpeg.shows_blocks(self.values)

    @property
    def black(self) -> np.ndarray:
        """(H, W) bool: no light, or so little that a displayed value says nothing of it."""
        return (self.values <= (0 if self.linear else BLACK)).all(axis=2)

    @cached_property
    def noisy(self) -> bool:
        """Noise has its say in what clips, and in the means of what lies behind a transfer function.

        That is noise whose median is that of its cause: of the displayed values, or of a sensor. A path tracer's few
        bright samples among many dark ones are known by their skewness: only the mean of their light is right.
        """
        if self.linear:
            return False
        second = _second_differences(self.values, max(1, self.values[..., 0].size // ENOUGH))
        sigma = float(np.median(np.abs(second))) / 0.6745 if second.size else 0.0
        if sigma <= NOISY * _OF_SECOND:
            return False
        cubes = np.clip(second / sigma, -OUTLIER, OUTLIER) ** 3
        return float(cubes.mean()) < SKEWED

    @property
    def spoilt_share(self) -> float:
        """A place shows a saturated or black surface where more than this share of its pixels are clipped.

        Without noise any clipped pixel says so. Noise alone clips pixels of surfaces far from the ends of the range,
        and to leave out the surroundings of each would choose places by their noise.
        """
        return MAY_CLIP if self.noisy else 0.0


def _second_differences(values, step):
    """(n, W - 2, C) across and along every step-th row: shading is gone, noise is left, _OF_SECOND times as large."""
    across = values[:-2:step] - 2 * values[1:-1:step] + values[2::step]
    return across[:, :-2] - 2 * across[:, 1:-1] + across[:, 2:]


def format_problem(path, stem=None) -> str | None:
    """What the file's first bytes say against it as a photograph: another format than its name.

    stem : of the name that the user knows it by
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            head = file.read(16)
        format = picture_files.format_of(head) or picture_files.other_format_of(head)
        if format is None:
            with picture_files.opened(path) as picture:
                format = picture.format
    except Exception:  # decoding says what is wrong
        return None
    wanted = FORMATS.get(path.suffix)
    if not wanted or format == wanted:
        return None
    if format in FORMATS.values():
        suffix = next(suffix for suffix, name in FORMATS.items() if name == format)
        return f"{path}: format: {format}: rename it to {stem or path.stem}{suffix}"
    return f"{path}: format: {format} under the name of {wanted}: convert it to PNG"


def read_photograph(path, as_stored=False) -> Photograph:
    """Read an 8- or 16-bit PNG, JPEG or TIFF, or an EXR. Truncated or damaged files are refused.

    The orientation that a file's EXIF (or a TIFF's tag) notes is honoured, as viewers do: [0, 0] is the upper left
    corner of what they show, and the camera's pixels are those.  as_stored : not, the sensor's own pixels are wanted.
    Colours of another space (Display P3, Adobe RGB) are brought to sRGB's primaries, with the file's own curve.
    """
    path = os.fspath(path)
    if path.lower().endswith(".exr"):
        return _of_light(path)
    content = _content(path)
    described, stored = _decode(path, content)
    turn = UNTURNED if as_stored else described.turn
    if described.clear is not None and (stored == described.clear).any():
        raise BadInput(f"{path}: alpha: the photograph is transparent in places: save it without alpha, flattened")
    stored = _turned(_without_alpha(path, stored), turn)
    own = described.format == "PNG" and picture_files.text_of_png(content, RANGE_KEY)
    white = white_level.White(np.iinfo(stored.dtype).max) if own else white_level.of(stored, described.white)
    values = stored[..., ::-1] / float(white.level)  # OpenCV's BGR
    in_file, notes, doubts = values.shape[2], described.notes, (*described.doubts, *white.doubts)
    if in_file == 3 and (values[..., :1] == values).all():
        values = values[..., :1]
    if described.space is not None and values.shape[2] == 3:
        values, outside = colour_profiles.in_srgb(described.space, values)
        noted, doubted = colour_profiles.said(described.space, outside, values[..., 0].size)
        notes, doubts = (*noted, *notes), (*doubted, *doubts)
    blocks = None
    if described.format == "JPEG":
        blocks = jpeg.blocks(content, None if described.space is None else described.space.matrix)
        if blocks is not None:
            blocks = blocks._replace(first=_first_block(values.shape, blocks.px, turn))
    elif described.format == "PNG":
        blocks = jpeg.of_text(picture_files.text_of_png(content, JPEG_KEY))
    bits = 8 * stored.dtype.itemsize
    return Photograph(np.ascontiguousarray(values), bits, False, in_file, blocks, notes, doubts)


def _of_light(path):
    """Of an EXR. BadInput: a pixel that is not finite"""
    light = exr.photograph(path)
    values = light.values if light.values.ndim == 3 else light.values[..., None]
    if not np.isfinite(values).all():
        y, x, channel = np.argwhere(~np.isfinite(values))[0]
        raise BadInput(f"{path}: pixel ({x}, {y}): channel {channel} = {values[y, x, channel]} is not finite")
    in_file = values.shape[2]
    if in_file == 3 and (values[..., :1] == values).all():
        values = values[..., :1]
    return Photograph(np.ascontiguousarray(values), 0, True, in_file, None, light.notes, light.doubts)


def write_photograph(path, photograph):
    """As a 16-bit PNG that keeps what is known of the JPEG it was made of, or as an EXR where it is linear."""
    values = photograph.values
    if photograph.linear:
        write_exr(path, np.maximum(values, 0))
        return
    stored = np.rint(np.clip(values, 0, 1) * 65535).astype(np.uint16)
    write_png16(path, stored)
    texts = {JPEG_KEY: photograph.blocks.text} if photograph.blocks else {}
    if white_level.of(stored).doubts:  # what is dark here is known to be
        texts[RANGE_KEY] = "full"
    for key, text in texts.items():
        Path(path).write_bytes(picture_files.with_text(Path(path).read_bytes(), key, text))


# EXIF's orientations: axes swapped, then rows, then columns reversed
TURNS = {
    1: (False, False, False),
    2: (False, False, True),
    3: (False, True, True),
    4: (False, True, False),
    5: (True, False, False),
    6: (True, False, True),
    7: (True, True, True),
    8: (True, True, False),
}


def orientation(path) -> int:
    """1 to 8, as EXIF or a TIFF's tag has it; 1 where a file tells nothing sensible, and of an EXR."""
    try:
        found = picture_files.describe(os.fspath(path), bounded.content(path))
    except BadInput:  # decoding says what is wrong
        return UNTURNED
    return found[0].turn if found else UNTURNED


def _turned(values, turn):
    """(H, W, ...) as stored -> as shown."""
    swapped, rows, columns = TURNS[turn]
    values = values.swapaxes(0, 1) if swapped else values
    return values[:: -1 if rows else 1, :: -1 if columns else 1]


def _first_block(shape, px, turn):
    """(y, x) where the first whole block of a turned JPEG begins: blocks are counted from the corner stored first."""
    _, rows, columns = TURNS[turn]
    return shape[0] % px if rows else 0, shape[1] % px if columns else 0


def _without_alpha(path, stored):
    """(H, W, 1 or 3) uint8 or uint16 as stored, without alpha."""
    if stored.dtype not in (np.uint8, np.uint16):
        raise BadInput(f"{path}: samples: {stored.dtype} instead of 8 or 16 bits")
    if stored.ndim == 2:
        stored = stored[..., None]
    if stored.shape[2] in (2, 4):
        if (stored[..., -1] != np.iinfo(stored.dtype).max).any():
            raise BadInput(f"{path}: alpha: the photograph is transparent in places: save it without alpha, flattened")
        stored = stored[..., :-1]
    if stored.shape[2] not in (1, 3):
        raise BadInput(f"{path}: channels: {stored.shape[2]} instead of 1 or 3")
    return stored


def read_labels(path) -> np.ndarray:
    """(H, W) int32 of an 8- or 16-bit PNG or a 32-bit TIFF; 0 is nothing."""
    path = os.fspath(path)
    content = _content(path)
    size = picture_files.check_labels(path, content)
    stored = _whole(path, content, size, *_of_opencv(content) if size else (None, ()))
    if stored.ndim != 2 or stored.dtype.kind not in "iu":
        raise BadInput(f"{path}: labels: one channel of integers is needed, got {stored.shape} {stored.dtype}")
    return stored.astype(np.int32)


def write_png8(path, values):
    """Of (H, W) or (H, W, 3), uint8 or bool (True is 255)."""
    values = np.asarray(values)
    _write_png(path, values.astype(np.uint8) * np.uint8(255) if values.dtype == bool else values, np.uint8)


def write_png16(path, values):
    """Of (H, W) or (H, W, 3), whole numbers 0 to 65535."""
    _write_png(path, values, np.uint16)


def write_labels(path, labels):
    """(H, W) whole numbers from 0, as read_labels reads them: a 16-bit PNG, or a 32-bit TIFF if path ends in .tif."""
    if os.fspath(path).endswith(".tif"):
        _encode(path, "TIFF", ".tif", np.asarray(labels, np.int32))
    else:
        write_png16(path, labels)


def _write_png(path, values, kind):
    values = np.asarray(values)
    limit = np.iinfo(kind).max
    if values.dtype != kind:
        if values.dtype.kind not in "iu" or (values.size and (values.min() < 0 or values.max() > limit)):
            raise ValueError(f"{path}: whole numbers from 0 to {limit} are needed")
        values = values.astype(kind)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    if values.ndim == 3:
        values = values[..., ::-1]
    _encode(path, "PNG", ".png", values)


def _encode(path, name, extension, values):
    import cv2

    level = [cv2.IMWRITE_PNG_COMPRESSION, 3] if name == "PNG" else []
    ok, code = cv2.imencode(extension, np.ascontiguousarray(values), level)
    if not ok:
        raise OSError(f"{path}: cannot be written as {name}")
    with open(path, "wb") as file:
        file.write(code.tobytes())


def announced(path) -> tuple[int, int]:
    """(width, height) px of a photograph by its header; nothing else is read.  BadInput: none that can be read."""
    if os.fspath(path).endswith(".exr"):
        return exr.size(path)
    content = bounded.content(path) if os.fspath(path).endswith(".tif") else b""
    if size := picture_files.format_of(content) == "TIFF" and tiff.size_of(content):
        return size
    try:
        with picture_files.opened(path) as picture:
            return picture.size
    except Exception as error:  # whatever a damaged header makes of it
        raise BadInput(f"{path}: not a readable image: {' '.join(str(error).split())}") from None


def _content(path):
    """The file's bytes; BadInput where there are none."""
    content = bounded.content(path)
    if not content:
        raise BadInput(f"{path}: the file is empty")
    return content


def _decode(path, content):
    """(Described, pixels as stored, channels in OpenCV's order); BadInput where nothing is read, or damaged."""
    found = picture_files.describe(path, content)
    if found is None:
        return _whole(path, content, None, None, ())
    described, of_tiff = found
    if of_tiff:
        image, said = tiff.pixels(path, content, of_tiff, _of_opencv), ()
    else:
        content = content[: described.end]
        image, said = _of_opencv(picture_files.without_animation(content) if described.format == "PNG" else content)
    return described, _whole(path, content, described.size, image, said)


def _whole(path, content, size, image, said):
    """The pixels; BadInput where there are none, the decoder spoke of damage, or they are not as announced."""
    if said:
        raise BadInput(f"{path}: damaged: {said[0]}")
    if image is None or image.size == 0:
        kind = strangers_files.kind_of(content)
        what = f"is {kind}: " if kind else ""
        if kind == "a pointer of Git LFS":
            raise BadInput(f"{path}: {what}git lfs pull fetches the picture")
        raise BadInput(f"{path}: {what}not a readable image ({len(content)} bytes)")
    if image.shape[1::-1] != tuple(size):
        shown = f"{image.shape[1]} x {image.shape[0]}"
        raise BadInput(f"{path}: damaged: {shown} px are there, {size[0]} x {size[1]} are announced")
    return image


def _of_opencv(content):
    """(pixels or None, what the decoder says of damage)"""
    import cv2

    level = cv2.utils.logging.getLogLevel() if hasattr(cv2.utils, "logging") else None
    with picture_files.heard() as said:
        try:
            if level is not None:
                cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            image = None
        finally:
            if level is not None:
                cv2.utils.logging.setLogLevel(level)
    return image, said
