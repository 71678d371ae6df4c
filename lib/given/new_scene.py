"""A scene's folder from a photograph, a model and perhaps a camera of any tool; and what is missing.

Nothing is turned or scaled: a unit or an axis that seems to be another is said, with the line to write.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import (
    foreign_cameras,
    foreign_models,
    image,
    lenses,
    mitsuba_camera,
    picks_frame,
    reduced,
    sight,
    strangers_files,
)
from lib.given import model as models
from lib.given import picks as picks_
from lib.given.cameras import Camera

# Whole words of a group's name that mean a lamp, and those after which a light, a window or a spot is none
LAMPS = "lamp lamps light lights bulb bulbs lightbulb luminaire luminaires emitter emitters emission emissive neon tube"
LAMPS += " tubes spot spots spotlight spotlights downlight downlights ceilinglight ceilinglamp skylight lightsource sky"
LAMPS += " window windows lampe lampen leuchte leuchten licht fenster himmel led leds"
NO_LAMPS = "grey gray blue green red brown yellow beige pink orange white black wood oak pine metal steel concrete tone"
NO_LAMPS += " stone frame frames sill switch stand base pole shade cord cable holder"
LAMPS, NO_LAMPS = frozenset(LAMPS.split()), frozenset(NO_LAMPS.split())
SUFFIX = {".png": ".png", ".jpg": ".jpg", ".jpeg": ".jpg", ".tif": ".tif", ".tiff": ".tif", ".exr": ".exr"}
ROOM_M = 60.0  # the longest side of a model that is likely in metres;
LIKELY_M = 20.0  # and of one in cm: a room of 5000 is 5 m of mm sooner than 50 m of cm
# Letters that YAML takes for the end of a line, or does not take at all
UNPRINTED = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")
LONGEST_KEY = 1000  # letters: YAML looks for the colon of a plain key in 1024
DIAGONAL_35 = 43.267  # mm, of the film that EXIF's equivalent focal length is for


def make(folder, model, photograph, camera=None, picture=None, points=None, megapixels=None, seen=None) -> list[str]:
    """Fill an empty folder; returns lines to say, what is missing last.  BadInput: what cannot be used

    picture : the photograph's name in COLMAP's reconstruction
    points : a file as pose.csv, whose X, Y, Z may be in the model's own unit, or as Blender shows them
    megapixels : that the photograph keeps at most; None: reduced.MEGAPIXELS
    seen : (model, [Camera], Photograph) -> the one whose edges the photograph clearly has, or None
    """
    suffix = SUFFIX.get(Path(photograph).suffix.lower())
    if suffix is None:
        raise BadInput(f"PHOTO: {photograph}: is none of {', '.join(SUFFIX)}: convert it to PNG, or RAW to 16-bit TIFF")
    said = []
    size, k, lines = _photograph(folder / f"left{suffix}", photograph, megapixels or reduced.MEGAPIXELS)
    said += lines
    files, lines = foreign_models.convert(model)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    said += [f"model: {line}" for line in lines]
    world = models.load(next(folder / name for name in files if name.startswith("model.")))
    said.append(f"model: {len(world.groups)} groups: {_listed(world.groups)}")
    said += [f"model: {line}" for line in (*world.notes, *world.warnings)]
    lamps, lines = _lamps(world.groups, foreign_models.emitters(files))
    said += lines
    if camera:
        found = foreign_cameras.read(camera, size, picture, image.orientation(photograph))
    else:
        found, lines = _of_the_model(model, size, bool(points))
        said += [f"camera: {line}" for line in lines]
    unit = _unit(world)
    if found and found.other and found.T is not None and seen:
        found = _as_seen(found, world.scaled(unit.metres if unit else 1.0), photograph, seen)
    facts, hints = [], [unit.line] if unit else []
    if found:
        found = reduced.camera(found, k)
        found.write(folder / found.name)
        said.append(f"camera: of {found.kind}, {found.lens}, fx = {found.intrinsics[0]:.1f} px -> {found.name}")
        said += [f"camera: {line}" for line in found.said]
        if found.T is not None:
            lens = lenses.Lens(found.lens, found.intrinsics, found.width, found.height, found.T, str(camera))
            guesses = filter(None, [sight.unseen(lens, world), sight.lying(lens, world)])
            said += [f"camera: {line}" for line in guesses]
            hints += _up(found.T)
    if points:
        applied, lines = _points(folder / "pose.csv", points, world, unit, k)
        said += lines
        if applied:
            facts, hints = hints, []
    hfov = _exif_angle(photograph, size)
    (folder / "scene.yaml").write_text(_yaml(folder.name, world, lamps, facts, hints, hfov), encoding="utf-8")
    said += [f"written: {fact}" for fact in facts]
    said += [f"perhaps write {hint}" for hint in hints]
    return said + _missing(lamps, bool(points) or bool(found and found.T is not None), bool(found), hfov)


def _as_seen(found, world, photograph, seen):
    """The camera, or the same in the other pixels, where the photograph's edges say so."""
    both = [Camera(_matrix(one.intrinsics), one.width, one.height, one.T) for one in (found, found.other)]
    if seen(world, both, image.read_photograph(photograph)) != 1:
        return found
    return found.other.saying("so say the photograph's edges: it is taken as it is")


def _matrix(intrinsics):
    """K (3, 3) px, without the lens's distortion."""
    fx, fy, cx, cy = intrinsics[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def _photograph(path, photograph, megapixels):
    """((width, height) of the photograph, how many times smaller the copy is, lines to say).

    The copy is the file as it is: each stage converts its colours when it reads them, so a file that was put into a
    scene's folder by hand is read alike, and no 16-bit copy takes the place of a JPEG and of its tables.
    """
    try:
        path.write_bytes(bounded.content(photograph))
    except BadInput as bad:
        raise BadInput(*(f"PHOTO: {problem}" for problem in bad.problems)) from None
    if line := image.format_problem(path, Path(photograph).stem):
        raise BadInput(f"PHOTO: {line.replace(str(path), str(photograph))}")
    try:
        content = image.read_photograph(path)
    except BadInput as bad:
        raise BadInput(*(f"PHOTO: {p.replace(str(path), str(photograph))}" for p in bad.problems)) from None
    height, width = content.values.shape[:2]
    k, said = reduced.times((width, height), megapixels), f"photograph: {width} x {height} px"
    if k > 1:
        path, said = _smaller(path, content, k), f"{said}, means of {k} x {k} pixels"
        said += f" for memory and time (MEGAPIXELS={math.ceil(width * height / 1e6)} keeps all)"
    lines = [f"photograph: {line}" for line in (*content.notes, *content.doubts)]
    return (width, height), k, [f"{said} -> {path.name}", *lines]


def _smaller(path, content, k):
    """Writes it beside, in the place of the copy; its path."""
    path.unlink()
    path = path.with_suffix(".exr" if content.linear else ".png")
    image.write_photograph(path, reduced.photograph(content, k))
    return path


def _lamps(groups, emitters):
    """(groups that emit by their material; without any, those whose name says lamp, lines to say)"""
    told = [g for g in groups if g in emitters]
    guessed = [] if told else [g for g in groups if _says_lamp(g)]
    return told or guessed, [f"lamps: guessed by their names: {_listed(guessed)}"] if guessed else []


def _says_lamp(name):
    """By whole words, which _ - . blanks, digits and capitals part.

    >>> [_says_lamp(name) for name in ("CeilingLamp1", "led_strip", "BrushedAluminium", "light_oak", "Clamp")]
    [True, True, False, False, False]
    >>> _says_lamp("007")
    False
    """
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[^\W\d_A-Z]+", name)
    words = [word.lower() for word in words]
    return any(word in LAMPS and after not in NO_LAMPS for word, after in zip(words, [*words[1:], ""], strict=False))


def _of_the_model(path, size, picked):
    """(camera that the model's file tells, lines to say); its lens alone where the pose was picked."""
    content = bounded.content(path)
    if strangers_files.kind_of(content) != "a Mitsuba scene":
        return None, []
    found, lines = mitsuba_camera.read(Path(path), content, size)
    if found and picked:
        found, lines = replace(found, T=None), [*lines, "its lens alone: PICKS tell the pose"]
    return found, lines


def _points(path, points, model, unit, k):
    """Write pose.csv in metres of the model's frame. (Is the model's likely unit written, too?, lines to say)

    unit : _Unit or None;  k : how many times smaller the photograph was made
    """
    told, commented = picks_.read(points).p, picks_.commented(points)
    left = [f"picks: {commented} rows begin with #: not read"] if commented else []
    found = picks_frame.reading(told, model.scaled(unit.metres if unit else 1.0))
    if found is None or (len(told) and found.corners == 0):
        picks_.write_with(path, points, told, k)
        return False, [f"picks: {len(told)} -> pose.csv as they are: few of them are corners of the model", *left]
    picks_.write_with(path, points, found.metres(told), k)
    said = "" if found[:2] == ("m", "X,Y,Z") else f", read as {found.words}, and written in metres of the model's frame"
    line = f"picks: {len(told)}, {found.corners} of them corners of the model{said} -> pose.csv"
    return unit is not None, [line, *left]


class _Unit(NamedTuple):
    """The unit in which a model is likely drawn. line : of scene.yaml"""

    metres: float
    line: str


def _unit(model):
    """_Unit, None where metres are likely."""
    longest = float(np.ptp(model.vertices[np.unique(model.triangles)], axis=0).max())
    if longest <= ROOM_M:
        return None
    unit, factor = next((u, f) for u, f in (("cm", 0.01), ("mm", 0.001)) if longest * f <= LIKELY_M or u == "mm")
    why = f"it is {longest:.4g} long, which would be {longest * factor:.3g} m; the camera is read in metres"
    return _Unit(factor, f"model: {{unit: {unit}}}    # {why}")


def _up(T):
    upwards = -T[1, :3]
    axis = int(np.abs(upwards).argmax())
    up = ("-" if upwards[axis] < 0 else "") + "xyz"[axis]
    return [] if up == "z" else [f"model: {{up: {up}}}    # {up} points up in the photograph"]


def _exif_angle(photograph, size):
    """Degrees across, by EXIF's focal length; None where it tells none."""
    from PIL import Image

    try:
        with Image.open(photograph) as picture:
            focal = float(picture.getexif().get_ifd(0x8769).get(41989) or 0)
    except Exception:  # no EXIF, or one that cannot be read
        return None
    return (
        float(np.degrees(2 * np.arctan(size[0] / 2 / (focal / DIAGONAL_35 * np.hypot(*size))))) if focal > 0 else None
    )


def _word(name):
    """A name as YAML reads it again: quoted where it would be no word, or would end the line that it stands in.

    >>> _word("wall"), _word("1.0"), _word("a\\u2028b")
    ('wall', '"1.0"', '"a\\\\u2028b"')
    """
    plain = re.fullmatch(r"[A-Za-z_][\w-]*", name, re.A) and name.lower() not in ("null", "true", "false")
    return name if plain else UNPRINTED.sub(lambda c: f"\\u{ord(c[0]):04x}", json.dumps(name, ensure_ascii=False))


def _key(name):
    """The same as a key of a mapping in braces; a long one needs a mark of its own."""
    return f"? {_word(name)} " if len(_word(name)) > LONGEST_KEY else _word(name)


def _yaml(name, model, lamps, facts, hints, hfov):
    values = ", ".join(f"{_key(g)}: unknown" for g in lamps)
    told = next((g for g in model.groups if g not in lamps), "wall")
    lines = [
        f"# {name}, by make new-scene. Every key: data/SCENE.md, section 3",
        f"# Groups of the model: {', '.join(map(_word, model.groups))}",
        "",
        "# The groups that emit. `unknown` is estimated; [r, g, b] where you know it, 1.0 = white in the photograph",
        f"lamps: {{{values}}}" if lamps else f"# lamps: {{{_key(model.groups[0])}: unknown}}",
        "# A group whose reflectance you know, of 0 to 1, fixes the scale; without, light between surfaces has to",
        f"# reference: {{{_key(told)}: [0.8, 0.8, 0.8]}}",
        "# The camera's curve; auto takes the simplest of gamma, srgb, curve that fits",
        "# transfer: auto",
        *facts,
        *hints,
        "# Without another pose: where the camera stands and looks, in the model's metres",
        f"# camera: {{eye: [0, 0, 1.6], at: [1, 0, 1.2], up: [0, 0, 1], hfov_deg: {hfov or 65:.0f}}}",
    ]
    return "\n".join(f"# {line}" if line in hints else line for line in lines) + "\n"


def _missing(lamps, posed, lens, hfov):
    """posed, lens : is the pose told; is there a file of the lens"""
    lines = []
    if not lamps:
        lines.append("missing: lamps: write in scene.yaml which groups emit")
    if not posed:
        what = ": the file tells the lens alone" if lens else ""
        lines.append(
            f"missing: the pose of the photograph{what}: pick eight or more corners of the model, in several "
            "depths, as PICKS=points.csv or pose.csv (x_px,y_px,X,Y,Z), or write camera: in scene.yaml"
        )
        if hfov:
            lines.append(f"EXIF says {hfov:.0f} degrees across: a start for hfov_deg")
    return lines


def _listed(names, most=12):
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
