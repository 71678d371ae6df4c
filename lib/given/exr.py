"""EXRs: photographs of linear light, and the project's own pictures of light and depth.

    light = photograph("left.exr")       # Light: the part and the layer with R, G, B, whatever lies beside it
    values = read("depth.exr")           # one part with nothing but R, G, B, or Y, or Z

Arrays are indexed [y, x] or [y, x, channel], channels in the order R, G, B.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
from typing import NamedTuple

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import colour_profiles, picture_files
from lib.given.formats import Format, LeftOut

FORMAT = Format(
    "EXR",
    read=(
        "R, G, B or Y, half or float, scan lines or tiles; of several parts, layers and views the one with R, G, B",
        "chromaticities, colorInteropID: converted to sRGB's primaries;  overscan: cut off",
    ),
    refused=(
        ("a depth (Z) alone", "give the picture with R, G, B"),
        ("several layers or parts of which none is the main one", "save the photograph alone"),
        ("layers and parts of normals, positions, vectors, albedo", "give the picture with R, G, B"),
        ("a panorama (envmap)", "give a picture of one view"),
        ("luminance and chroma, X Y Z, channels of another resolution, deep pixels, whole numbers", "save R, G, B"),
        ("a picture that is only a crop of its display window", "save the whole picture"),
    ),
    left_out=("further parts, layers and channels",),
)
MOST_CHANNELS = 8  # of a picture of our own
MOST_SAMPLES = 250_000_000  # of all parts and channels of a file: all are decoded together
MOST_PARTS = 100
MAIN = ("rgba", "rgb", "beauty", "combined", "color", "colour", "image", "composite", "main", "c")  # layers' names
DEPTHS = ("z", "depth", "zback", "distance")
# Words in names of layers and parts that hold numbers or a surface's own colours, no light
DATA = ("normal", "normals", "n", "position", "pos", "p", "uv", "st", "vector", "motion", "velocity", "albedo", "id")
DATA += ("diffcol", "glosscol", "transcol", "indexob", "indexma", "cryptomatte", *DEPTHS)
VIEWS = ("left", "right", "l", "r")
SQUARE = 1e-3  # that the sides of a pixel may differ by
WAY_OUT = "save the photograph alone, as R, G, B"
SPACES = {"acescg": "ACES AP1", "aces2065-1": "ACES AP0", "lin_ap1": "ACES AP1", "lin_ap0": "ACES AP0"}
SPACES |= {"lin_rec2020": "Rec. 2020", "lin_p3d65": "Display P3", "lin_adobergb": "Adobe RGB (1998)"}
PLAIN = ("lin_rec709", "lin_srgb", "linear", "scene_linear", "raw", "data")  # beginnings of names


class Light(NamedTuple):
    """values : (H, W) or (H, W, 3) float64;  notes : what is left out, no doubt;  doubts : to look at"""

    values: np.ndarray
    notes: tuple
    doubts: tuple


class Choice(NamedTuple):
    """part : its number;  names : of its channels, ("Y",) or R, G, B with their layer;  windows : data, display
    notes : see Light
    """

    part: int
    names: tuple
    windows: tuple
    notes: tuple


# ---- photographs ----


def photograph(path) -> Light:
    """The light of a photograph.  BadInput: what is not on the short list of `FORMAT`"""
    content = _content(path)
    chosen = []

    def look(file):
        chosen.append(_chosen(path, file.parts, len(content)))

    with _decoded(path, look) as file:
        choice = chosen[0]
        part = file.parts[choice.part]
        names = choice.names
        if any(part.channels[name].pixels.dtype.kind != "f" for name in names):
            raise BadInput(f"{path}: channels: {', '.join(names)}: whole numbers are no light: {WAY_OUT}")
        values = np.stack([np.array(part.channels[name].pixels, float) for name in names], axis=-1)
        layer = names[0].rpartition(".")[0]
        alpha = part.channels.get(f"{layer}.A" if layer else "A")
        seen = 0.0 if alpha is None else float((np.array(alpha.pixels, float) < 1 - 1e-3).mean())
        header = dict(file.parts[0].header) | dict(part.header)  # colours are those of all parts
    doubts = (f"alpha: {seen:.1%} of the pixels are transparent: they are read over black",) if seen else ()
    if abs((aspect := float(header.get("pixelAspectRatio", 1))) - 1) > SQUARE:
        doubts += (f"pixelAspectRatio: {aspect:g}: pixels are read as they are stored: fx and fy must differ so",)
    values, notes = _displayed(path, values, choice)
    values, more, less = _in_srgb(path, values, header)
    return Light(values[..., 0] if len(names) == 1 else values, (*choice.notes, *notes, *more), (*doubts, *less))


def size(path) -> tuple[int, int]:
    """(width, height) px of a photograph by its header. BadInput: none that can be read"""
    import OpenEXR

    try:
        with OpenEXR.File(os.fspath(path), header_only=True) as file:
            _, (x0, y0, x1, y1) = _chosen(path, file.parts, os.path.getsize(path)).windows
    except BadInput:
        raise
    except Exception as error:  # the package raises plain RuntimeError, TypeError, ...
        raise BadInput(f"{path}: not a readable EXR: {' '.join(str(error).split())}") from None
    return x1 - x0 + 1, y1 - y0 + 1


def _chosen(path, parts, length) -> Choice:
    """The part and the channels of the photograph, by the headers alone."""
    if len(parts) > MOST_PARTS:
        raise BadInput(f"{path}: parts: {len(parts)}: {WAY_OUT}")
    channels = [{channel.name: channel for channel in part.header["channels"]} for part in parts]
    windows = [_windows(part.header) for part in parts]
    samples = 0
    for names, (data, _) in zip(channels, windows, strict=True):
        width, height = data[2] - data[0] + 1, data[3] - data[1] + 1
        bounded.check_picture(path, width, height, length)
        samples += len(names) * width * height
    found = [(number, layer) for number, names in enumerate(channels) for layer in _layers(names)]
    if not found:
        _refuse(path, channels)
    flat = [k for k, part in enumerate(parts) if "deep" not in str(part.type())]
    found = [one for one in found if one[0] in flat]
    if not found:
        raise BadInput(f"{path}: type: deep pixels: flatten it: {WAY_OUT}")
    number, layer = _main(path, parts, found)
    if any("envmap" in parts[k].header for k in {0, number}):
        raise BadInput(f"{path}: envmap: is a panorama, which no lens shows: give a picture of one view")
    if samples > MOST_SAMPLES:
        count = sum(map(len, channels))
        raise BadInput(f"{path}: channels: {count} with {samples} samples: at most {MOST_SAMPLES}: {WAY_OUT}")
    names = tuple(f"{layer}{c}" for c in ("RGB" if f"{layer}R" in channels[number] else "Y"))
    for name in names:
        channel = channels[number][name]
        if (channel.xSampling, channel.ySampling) != (1, 1):
            raise BadInput(f"{path}: channels: {name} has fewer pixels than the picture: {WAY_OUT}")
    left = LeftOut()
    left.add("further part", len(parts) - 1)
    left.add("further layer", sum(one[0] == number for one in found) - 1)
    mine = {*names, f"{layer}A", f"{layer}Y"} | {
        f"{other}{c}" for part, other in found if part == number for c in "RGBAY"
    }
    left.add("further channel", len(set(channels[number]) - mine))
    line = left.line()
    if (line and (layer or len(parts) > 1)) or (layer and _last_word(layer.rstrip(".")) not in MAIN):
        where = f"part {parts[number].name()!r}" if len(parts) > 1 else f"layer {layer.rstrip('.')!r}"
        line = "; ".join(filter(None, [f"{where} is the photograph", line]))
    return Choice(number, names, windows[number], (line,) if line else ())


def _layers(names):
    """The beginnings of layers that have R, G, B, or Y without chroma: "" or "beauty."."""
    starts = [name.rpartition(".")[0] for name in names]
    for start in dict.fromkeys(f"{start}." if start else "" for start in starts):
        others = {f"{start}{c}" for c in ("RY", "BY", "X", "Z", "R", "G", "B")} & set(names)
        if all(f"{start}{c}" in names for c in "RGB") or (f"{start}Y" in names and not others):
            yield start


def _main(path, parts, found):
    """(part, layer) of the photograph: the only one with light, that without a name, or one whose name says so.

    A layer without a name of its own has that of its part, where there are several parts.
    """
    coloured = [(k, layer) for k, layer in found if f"{layer}R" in {c.name for c in parts[k].header["channels"]}]
    names = {(k, layer): (layer.rstrip(".") or _name_of_part(parts, k)) for k, layer in coloured or found}
    words = {one: [word for word in re.split(r"[.\s_-]+", name.lower()) if word] for one, name in names.items()}
    lit = [one for one in names if not set(words[one]) & set(DATA)]
    listed = ", ".join(list(names.values())[:6])
    if not lit:
        raise BadInput(f"{path}: layers: {listed}: are no photograph: give the picture with R, G, B")
    if len(lit) == 1 or not names[lit[0]]:
        return lit[0]
    for one in lit:
        if not names[one]:
            return one
    for word in MAIN:
        for one in _by_view(parts, lit):
            if _last_word(names[one]) == word:
                return one
    raise BadInput(f"{path}: layers: {listed}: which of them is the photograph? {WAY_OUT}")


def _name_of_part(parts, number):
    return str(parts[number].name() or "") if len(parts) > 1 else ""


def _by_view(parts, found):
    """Those of the first view before all others, which is the left one where the file does not say."""
    views = [str(view) for view in parts[0].header.get("multiView", ())]
    first = (views or ["left"])[0].lower()
    of = lambda one: str(parts[one[0]].header.get("view", first)).lower() != first
    return sorted(found, key=of)


def _last_word(name):
    """Of a layer's name, without its view: "ViewLayer.Combined.left" is Combined."""
    words = [word for word in name.lower().split(".") if word not in VIEWS]
    return words[-1] if words else ""


def _refuse(path, channels):
    names = sorted({name for names in channels for name in names})
    last = {name.rpartition(".")[2] for name in names}
    if {name.lower() for name in last} <= set(DEPTHS) and names:
        raise BadInput(f"{path}: channels: {names[0]}: Z is a depth, no photograph: give the picture with R, G, B")
    if {"RY", "BY"} & last:
        raise BadInput(f"{path}: channels: {', '.join(names[:8])}: luminance and chroma: {WAY_OUT}")
    raise BadInput(f"{path}: channels: {', '.join(names[:8])} instead of R, G, B or Y: {WAY_OUT}")


def _displayed(path, values, choice):
    """(the values of the display window, notes)"""
    data, display = choice.windows
    if data == display:
        return values, ()
    if data[0] > display[0] or data[1] > display[1] or data[2] < display[2] or data[3] < display[3]:
        raise BadInput(f"{path}: dataWindow: {data} is not the whole picture {display}: save the whole picture")
    rows = slice(display[1] - data[1], display[3] - data[1] + 1)
    columns = slice(display[0] - data[0], display[2] - data[0] + 1)
    return values[rows, columns], ("overscan: cut off",)


def _in_srgb(path, values, header):
    """(values with sRGB's primaries, notes, doubts)"""
    said = header.get("chromaticities")
    named = str(header.get("colorInteropID") or header.get("oiio:ColorSpace") or "").strip()
    if values.shape[-1] == 1 or (said is None and not named) or said is None and named.lower().startswith(PLAIN):
        return values, (), ()
    way_out = "nothing is converted: reflectances are those of its own R, G, B, not of sRGB's. Convert it to Rec. 709"
    try:
        if said is not None:
            places = np.array(said, float).reshape(4, 2)
            space = colour_profiles.of_primaries(places, _name_of(places), by="the file's own chromaticities")
        elif key := next((key for key in SPACES if named.lower().startswith(key)), None):
            space = colour_profiles.of_primaries(SPACES[key], SPACES[key], by="the file's own colour space")
        else:
            return values, (), (f"colour space {named:.60}: is not known: {way_out}",)
    except ValueError as error:
        return values, (), (f"chromaticities: {error}: {way_out}",)
    if space.is_srgb:
        return values, (), ()
    values, outside = colour_profiles.light_in_srgb(space, values)
    return values, *colour_profiles.said(space, outside, values[..., 0].size)


def _name_of(places):
    near = lambda known: np.abs(np.array(known) - places).max() < 2e-3
    return next((name for name, known in colour_profiles.PRIMARIES.items() if near(known)), "its own primaries")


# ---- pictures of our own ----


def read(path) -> np.ndarray:
    """(H, W) float64 for one channel (Y or Z), (H, W, 3) for R, G, B; an A beside them is dropped."""
    path = os.fspath(path)
    content, windows = _content(path), []

    def look(file):
        header = file.header()
        windows.extend(_windows(header))
        x0, y0, x1, y1 = windows[0]
        bounded.check_picture(path, x1 - x0 + 1, y1 - y0 + 1, len(content))
        if len(header["channels"]) > MOST_CHANNELS:
            raise BadInput(f"{path}: channels: {len(header['channels'])} instead of R, G, B or Y or Z")

    with _decoded(path, look) as file:
        pixels = {name: np.array(channel.pixels, float) for name, channel in file.channels().items()}
    if windows[0] != windows[1]:
        raise BadInput(f"{path}: dataWindow: {windows[0]} is not the whole picture {windows[1]}")
    names = set(pixels) - {"A"}
    if names == {"R", "G", "B"} and len({pixels[name].shape for name in names}) == 1:
        return np.stack([pixels[name] for name in "RGB"], axis=-1)
    if len(names) == 1 and names <= {"Y", "Z"}:
        return pixels[names.pop()]
    raise BadInput(f"{path}: channels: {', '.join(sorted(pixels))} instead of R, G, B or Y or Z")


def write(path, values, name="Y"):
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


# ---- both ----


@contextlib.contextmanager
def _decoded(path, look):
    """The file, decoded. look(file) : is shown its headers before, and refuses.  BadInput: not readable, or damaged"""
    import OpenEXR

    path, said, file = os.fspath(path), [], None
    try:
        with picture_files.heard() as said:
            with OpenEXR.File(path, header_only=True) as header:
                look(header)
            file = OpenEXR.File(path, separate_channels=True)
    except BadInput:
        raise
    except Exception as error:  # the package raises plain RuntimeError, TypeError, ...
        if not said:
            why = " ".join(str(error).split()) or type(error).__name__
            raise BadInput(f"{path}: not a readable EXR: {why}") from None
    if said:
        raise BadInput(f"{path}: damaged: {said[0].removeprefix(f'{path}: ')}")
    with file:
        yield file


def _windows(header):
    """The data window and the display window, (x0, y0, x1, y1) px each."""
    return tuple(tuple(int(v) for v in np.ravel(header[name])) for name in ("dataWindow", "displayWindow"))


def _content(path):
    content = bounded.content(path)
    if not content:
        raise BadInput(f"{path}: the file is empty")
    return content
