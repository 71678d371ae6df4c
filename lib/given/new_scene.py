"""A scene's folder from a photograph, a model and perhaps a camera of any tool; and what is missing.

Nothing is turned or scaled: a unit or an axis that seems to be another is said, with the line to write.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import foreign_cameras, foreign_models, image, lenses, sight
from lib.given import model as models

LAMP = re.compile(r"lamp|light|bulb|lumin|leucht|lampe|emit|neon|tube|spot|window|fenster|sky", re.I)
SUFFIX = {".png": ".png", ".jpg": ".jpg", ".jpeg": ".jpg", ".tif": ".tif", ".tiff": ".tif", ".exr": ".exr"}
ROOM_M = 60.0  # the longest side of a model that is likely in metres
DIAGONAL_35 = 43.267  # mm, of the film that EXIF's equivalent focal length is for


def make(folder, model, photograph, camera=None, picture=None) -> list[str]:
    """Fill an empty folder; returns lines to say, what is missing last.  BadInput: what cannot be used

    picture : the photograph's name in COLMAP's reconstruction
    """
    suffix = SUFFIX.get(Path(photograph).suffix.lower())
    if suffix is None:
        raise BadInput(f"PHOTO: {photograph}: is none of {', '.join(SUFFIX)}: convert it to PNG, or RAW to 16-bit TIFF")
    said = []
    size = _photograph(folder / f"left{suffix}", photograph)
    said.append(f"photograph: {size[0]} x {size[1]} px -> left{suffix}")
    files, lines = foreign_models.convert(model)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    said += [f"model: {line}" for line in lines]
    world = models.load(next(folder / name for name in files if name.startswith("model.")))
    said.append(f"model: {len(world.groups)} groups: {_listed(world.groups)}")
    said += [f"model: {warning}" for warning in world.warnings]
    lamps = _lamps(world.groups, foreign_models.emitters(files))
    found = foreign_cameras.read(camera, size, picture) if camera else None
    hints = _unit(world)
    if found:
        found.write(folder / found.name)
        said.append(f"camera: of {found.kind}, {found.lens}, fx = {found.intrinsics[0]:.1f} px -> {found.name}")
        if found.T is not None:
            lens = lenses.Lens(found.lens, found.intrinsics, found.width, found.height, found.T, str(camera))
            if line := sight.unseen(lens, world):
                said.append(f"camera: {line}")
            hints += _up(found.T)
    hfov = _exif_angle(photograph, size)
    (folder / "scene.yaml").write_text(_yaml(folder.name, world, lamps, hints, hfov), encoding="utf-8")
    said += [f"perhaps write {hint}" for hint in hints]
    return said + _missing(lamps, found, hfov)


def _photograph(path, photograph):
    """(width, height) of the copy."""
    try:
        path.write_bytes(bounded.content(photograph))
    except BadInput as bad:
        raise BadInput(*(f"PHOTO: {problem}" for problem in bad.problems)) from None
    if line := image.format_problem(path):
        raise BadInput(f"PHOTO: {line.replace(str(path), str(photograph))}")
    try:
        height, width = image.read_photograph(path).values.shape[:2]
    except BadInput as bad:
        raise BadInput(*(f"PHOTO: {p.replace(str(path), str(photograph))}" for p in bad.problems)) from None
    return width, height


def _lamps(groups, emitters):
    """Groups that emit by their material; without any, those whose name sounds like a lamp."""
    return [g for g in groups if g in emitters] or [g for g in groups if LAMP.search(g)]


def _unit(model):
    longest = float(np.ptp(model.vertices[np.unique(model.triangles)], axis=0).max())
    if longest <= ROOM_M:
        return []
    unit, factor = next((u, f) for u, f in (("cm", 0.01), ("mm", 0.001)) if longest * f <= ROOM_M or u == "mm")
    why = f"it is {longest:.4g} long, which would be {longest * factor:.3g} m; the camera is read in metres"
    return [f"model: {{unit: {unit}}}    # {why}"]


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
    plain = re.fullmatch(r"[A-Za-z_][\w-]*", name) and name.lower() not in ("null", "true", "false")
    return name if plain else json.dumps(name, ensure_ascii=False)


def _yaml(name, model, lamps, hints, hfov):
    values = ", ".join(f"{_word(g)}: unknown" for g in lamps)
    told = next((g for g in model.groups if g not in lamps), "wall")
    lines = [
        f"# {name}, by make new-scene. Every key: data/SCENE.md, section 3",
        f"# Groups of the model: {', '.join(map(_word, model.groups))}",
        "",
        "# The groups that emit. `unknown` is estimated; [r, g, b] where you know it, 1.0 = white in the photograph",
        f"lamps: {{{values}}}" if lamps else f"# lamps: {{{_word(model.groups[0])}: unknown}}",
        "# A group whose reflectance you know, of 0 to 1, fixes the scale; without, light between surfaces has to",
        f"# reference: {{{_word(told)}: [0.8, 0.8, 0.8]}}",
        "# The camera's curve; auto takes the simplest of gamma, srgb, curve that fits",
        "# transfer: auto",
        *hints,
        "# Without another pose: where the camera stands and looks, in the model's metres",
        f"# camera: {{eye: [0, 0, 1.6], at: [1, 0, 1.2], up: [0, 0, 1], hfov_deg: {hfov or 65:.0f}}}",
    ]
    return "\n".join(f"# {line}" if line in hints else line for line in lines) + "\n"


def _missing(lamps, found, hfov):
    lines = []
    if not lamps:
        lines.append("missing: lamps: write in scene.yaml which groups emit")
    if found is None or found.T is None:
        what = "" if found is None else ": the file tells the lens alone"
        lines.append(
            f"missing: the pose of the photograph{what}: pick six or more points, in several depths, as pose.csv "
            "(x_px,y_px,X,Y,Z), or write camera: in scene.yaml"
        )
        if hfov:
            lines.append(f"EXIF says {hfov:.0f} degrees across: a start for hfov_deg")
    return lines


def _listed(names, most=12):
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
