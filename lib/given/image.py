"""Image files: photographs, label images, pictures of light.  The only module that knows codecs.

Arrays are indexed [y, x] or [y, x, channel], channels in the order R, G, B.
"""

import errno
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import jpeg, picture_files, strangers_files
from lib.given.transfer import display_of_linear

MAY_CLIP = 0.25  # share of a noisy surface's pixels that may be clipped: its median is not
NOISY = 0.01  # display, standard deviation of a pixel, from which a photograph may be called noisy
SKEWED, OUTLIER = 0.1, 4.0  # mean cube of second differences in sigmas; held down to so many
ENOUGH = 300_000  # pixels that tell of the noise
_OF_SECOND = 6.0
FORMATS = {".png": "PNG", ".jpg": "JPEG", ".tif": "TIFF"}  # as Pillow names them
MOST_CHANNELS = 8  # of an EXR
JPEG_KEY = "anasyn jpeg"  # of a text in a PNG: the JPEG that it was made of
OTHER_COLOURS = ("CMYK", "LAB", "YCbCr", "HSV")  # modes of Pillow that are no R, G, B. A JPEG's YCbCr comes as RGB


BLACK = 2 / 255 + 1e-9  # display


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph as a stage reads it.

    values : (H, W, C) float64, C = 1 or 3; display-referred in [0, 1], or linear light (EXR) that may exceed 1
    bits : 8, 16, or 0 for EXR          linear : True for EXR
    channels_in_file : 1 or 3.  Three equal channels become C = 1; alpha is dropped
    blocks : of a JPEG, or of one that this was made of, else None
    """

    values: np.ndarray
    bits: int
    linear: bool
    channels_in_file: int
    blocks: jpeg.Blocks | None = None

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


def format_problem(path) -> str | None:
    """What the file's header says against it as a photograph: another format than its name, colours that are no RGB."""
    path = Path(path)
    if path.suffix == ".exr":
        return None
    try:
        with picture_files.opened(path) as picture:
            format, mode = picture.format, picture.mode
    except Exception:  # decoding says what is wrong
        return None
    wanted = FORMATS.get(path.suffix)
    if format in FORMATS.values() and wanted and format != wanted:
        suffix = next(suffix for suffix, name in FORMATS.items() if name == format)
        return f"{path}: format: {format}: rename it to {path.stem}{suffix}"
    if wanted and format != wanted and format != "MPO":
        return f"{path}: format: {format} under the name of {wanted}: convert it to PNG"
    if mode in OTHER_COLOURS:
        return f"{path}: colours: {mode}: convert the photograph to RGB (sRGB)"
    return None


def read_photograph(path, as_stored=False) -> Photograph:
    """Read an 8- or 16-bit PNG, JPEG or TIFF, or an EXR. Truncated or damaged files are refused.

    The orientation that a file's EXIF notes is honoured, as viewers do: [0, 0] is the upper left corner of what they
    show, and the camera's pixels are those. as_stored : not honoured, the pixels are the sensor's
    """
    path, turn = os.fspath(path), 1
    if path.lower().endswith(".exr"):
        values, bits = _linear_values(path), 0
    else:
        turn = 1 if as_stored else orientation(path)
        stored = _turned(_display_values(path), turn)
        # OpenCV's BGR
        values, bits = stored[..., ::-1] / float(np.iinfo(stored.dtype).max), 8 * stored.dtype.itemsize
    in_file = values.shape[2]
    if in_file == 3 and (values[..., :1] == values).all():
        values = values[..., :1]
    blocks = None
    if path.lower().endswith((".jpg", ".jpeg")):
        blocks = jpeg.blocks(bounded.content(path))
        if blocks is not None:
            blocks = blocks._replace(first=_first_block(values.shape, blocks.px, turn))
    elif path.lower().endswith(".png"):
        blocks = jpeg.of_text(picture_files.text_of_png(bounded.content(path), JPEG_KEY))
    return Photograph(np.ascontiguousarray(values), bits, bits == 0, in_file, blocks)


def write_photograph(path, photograph):
    """As a 16-bit PNG that keeps what is known of the JPEG it was made of, or as an EXR where it is linear."""
    values = photograph.values
    if photograph.linear:
        write_exr(path, np.maximum(values, 0))
        return
    write_png16(path, np.rint(np.clip(values, 0, 1) * 65535).astype(np.uint16))
    if photograph.blocks:
        content = Path(path).read_bytes()
        Path(path).write_bytes(picture_files.with_text(content, JPEG_KEY, photograph.blocks.text))


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
    """1 to 8, as EXIF has it; 1 where a file tells nothing sensible."""
    try:
        with picture_files.opened(path) as picture:
            turn = picture.getexif().get(274)
    except Exception:  # whatever is wrong with the file or its EXIF: decoding says what matters
        return 1
    return turn if turn in TURNS else 1


def _turned(values, turn):
    """(H, W, ...) as stored -> as shown."""
    swapped, rows, columns = TURNS[turn]
    values = values.swapaxes(0, 1) if swapped else values
    return values[:: -1 if rows else 1, :: -1 if columns else 1]


def _first_block(shape, px, turn):
    """(y, x) where the first whole block of a turned JPEG begins: blocks are counted from the corner stored first."""
    _, rows, columns = TURNS[turn]
    return shape[0] % px if rows else 0, shape[1] % px if columns else 0


def _linear_values(path):
    """(H, W, C) of an EXR, all finite."""
    values = read_exr(path)
    if values.ndim == 2:
        values = values[..., None]
    if not np.isfinite(values).all():
        y, x, channel = np.argwhere(~np.isfinite(values))[0]
        raise BadInput(f"{path}: pixel ({x}, {y}): channel {channel} = {values[y, x, channel]} is not finite")
    return values


def _display_values(path):
    """(H, W, 1 or 3) uint8 or uint16 as stored, without alpha."""
    stored = _decode(path)
    if stored.dtype not in (np.uint8, np.uint16):
        raise BadInput(f"{path}: samples: {stored.dtype} instead of 8 or 16 bits")
    if stored.ndim == 2:
        stored = stored[..., None]
    if stored.shape[2] in (2, 4):
        if (stored[..., -1] != np.iinfo(stored.dtype).max).any():
            raise BadInput(f"{path}: alpha: the photograph is transparent in places")
        stored = stored[..., :-1]
    if stored.shape[2] not in (1, 3):
        raise BadInput(f"{path}: channels: {stored.shape[2]} instead of 1 or 3")
    return stored


def read_labels(path) -> np.ndarray:
    """(H, W) int32 of an 8- or 16-bit PNG or a 32-bit TIFF; 0 is nothing."""
    stored = _decode(os.fspath(path), of_labels=True)
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


def read_exr(path) -> np.ndarray:
    """(H, W) float64 for one channel (Y or Z), (H, W, 3) for R, G, B; an A beside them is dropped."""
    import OpenEXR

    path = os.fspath(path)
    content, said = _content(path), []
    try:
        with picture_files.heard() as said:
            window = _check_exr(path, len(content))
            with OpenEXR.File(path, separate_channels=True) as file:
                pixels = {name: np.array(channel.pixels, float) for name, channel in file.channels().items()}
    except BadInput:
        raise
    except Exception as error:  # the package raises plain RuntimeError, TypeError, ...
        if not said:
            why = " ".join(str(error).split()) or type(error).__name__
            raise BadInput(f"{path}: not a readable EXR: {why}") from None
    if said:
        raise BadInput(f"{path}: damaged: {said[0].removeprefix(f'{path}: ')}")
    if window[0] != window[1]:
        raise BadInput(f"{path}: dataWindow: {window[0]} is not the whole picture {window[1]}")
    names = set(pixels) - {"A"}
    if names == {"R", "G", "B"} and len({pixels[name].shape for name in names}) == 1:
        return np.stack([pixels[name] for name in "RGB"], axis=-1)
    if len(names) == 1 and names <= {"Y", "Z"}:
        return pixels[names.pop()]
    raise BadInput(f"{path}: channels: {', '.join(sorted(pixels))} instead of R, G, B or Y or Z")


def announced(path) -> tuple[int, int]:
    """(width, height) px of a photograph by its header; nothing else is read.  BadInput: none that can be read."""
    if os.fspath(path).endswith(".exr"):
        try:
            x0, y0, x1, y1 = _check_exr(os.fspath(path), os.path.getsize(path))[0]
        except BadInput:
            raise
        except Exception as error:  # the package raises plain RuntimeError, TypeError, ...
            raise BadInput(f"{path}: not a readable EXR: {' '.join(str(error).split())}") from None
        return x1 - x0 + 1, y1 - y0 + 1
    try:
        with picture_files.opened(path) as picture:
            return picture.size
    except Exception as error:  # whatever a damaged header makes of it
        raise BadInput(f"{path}: not a readable image: {' '.join(str(error).split())}") from None


def _check_exr(path, size):
    """The data window and the display window, (x0, y0, x1, y1) px each. BadInput: too large, or other channels."""
    import OpenEXR

    with OpenEXR.File(path, header_only=True) as file:
        header = file.header()
        windows = [tuple(int(v) for v in np.ravel(header[name])) for name in ("dataWindow", "displayWindow")]
        count = len(header["channels"])
    x0, y0, x1, y1 = windows[0]
    bounded.check_picture(path, x1 - x0 + 1, y1 - y0 + 1, size)
    if count > MOST_CHANNELS:
        raise BadInput(f"{path}: channels: {count} instead of R, G, B or Y or Z")
    return windows


def write_exr(path, values, name="Y"):
    """(H, W, 3) as R, G, B, or (H, W) as the one channel `name`; 32-bit floats, lossless."""
    import OpenEXR

    values = np.asarray(values)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    planes = {name: values} if values.ndim == 2 else {c: values[..., i] for i, c in enumerate("RGB")}
    channels = {c: np.ascontiguousarray(plane, np.float32) for c, plane in planes.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(os.fspath(path))
    except RuntimeError as error:  # a full disk
        raise OSError(errno.EIO, " ".join(str(error).rpartition('". ')[2].split()).rstrip(".")) from None


def _content(path):
    """The file's bytes; BadInput where there are none."""
    content = bounded.content(path)
    if not content:
        raise BadInput(f"{path}: the file is empty")
    return content


def _decode(path, of_labels=False):
    """What OpenCV reads of a PNG, a JPEG or a TIFF; BadInput where it reads nothing, or the file is damaged."""
    content = _content(path)
    size = picture_files.check(path, content, of_labels)
    image, said = _of_opencv(content) if size else (None, [])
    if said:
        raise BadInput(f"{path}: damaged: {said[0]}")
    if image is None or image.size == 0:
        kind = strangers_files.kind_of(content)
        what = f"is {kind}: " if kind else ""
        if kind == "a pointer of Git LFS":
            raise BadInput(f"{path}: {what}git lfs pull fetches the picture")
        raise BadInput(f"{path}: {what}not a readable image ({len(content)} bytes)")
    if image.shape[1::-1] != size:
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
