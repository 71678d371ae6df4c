"""New pictures of a recovered scene: entries of `augment` (data/SCENE.md), from files to files.

scene = read(entry, files)
made = picture(scene, quality)                  # the photograph with the change, or a view of its own
sequence(scene, quality, folder, preview, bar)
"""

from __future__ import annotations

import contextlib
import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lib.buffers import coverage, index_buffer, opengl
from lib.core import artefact
from lib.core.stage import BadInput
from lib.given import image, lenses, materials, motion
from lib.given.cameras import Camera
from lib.given.lenses import Lens
from lib.given.view import View
from lib.light import factors_file
from lib.light.surface import start_inside
from lib.picture import changes, differential, grain, rendering
from lib.picture import subject as subjects
from lib.picture.lighting import Lighting, lighting
from lib.picture.subject import Quality, Subject

PINHOLE = "LENSMODEL_PINHOLE"
FINER = 1.5  # pixels of the pinhole picture, to the side, for one of a lens that is none
WIDEST = 5.0  # tangent of the angle from the axis that a pinhole picture still holds
PER_SECOND = 24  # frames of a preview


@dataclass(frozen=True, eq=False)
class Scene:
    """The recovered scene, and the changed one as its own camera sees it. warnings : lines"""

    entry: dict
    recovered: Subject
    changed: Subject
    warnings: list


@dataclass(frozen=True, eq=False)
class Made:
    """linear : (H, W, C);  values : (H, W, channels of the file) whole numbers;  bits : 8 or 16"""

    linear: np.ndarray
    values: np.ndarray
    bits: int
    facts: dict


def read(entry, files, *, n_rays=512) -> Scene:
    """entry : its files as paths;  files : {option: path} of `subject.read`;  n_rays : of each new patch

    BadInput: what does not fit, names that the scene has not, a transfer function that looks at the photograph.
    """
    recovered = subjects.read(**files)
    if not recovered.simple:
        kind = recovered.transfer.kind
        raise BadInput(f"{files['materials']}: transfer: kind: {kind} cannot be undone, which changes need")
    model = recovered.view.model
    stored = factors_file.read(files["formfactors"], model, files["model"])
    found = materials.read(files["materials"])
    change = changes.apply(entry, files["materials"], found, model, stored.lamps, recovered.channels)
    view, pieces = recovered.view, recovered.coverage
    if change.model is not model:
        view, pieces = seen(change.model, view.camera, photograph=view.photograph)
    changed = changes.subject(change, recovered, stored, view, pieces, files["materials"], n_rays=n_rays)
    if "camera" in entry:
        pinhole, _ = _pinhole(lenses.read(entry["camera"]))
        _in_the_open(changed, model.n_facets, pinhole, f"{entry['camera']}: the camera")
    elif "cameras" not in entry and changed.surface is not recovered.surface:
        _in_the_open(changed, model.n_facets, view.camera, "entry: the photograph's camera")
    return Scene(entry, recovered, changed, [*recovered.warnings, *found.cautions])


def _in_the_open(subject: Subject, n_before, camera: Camera, what):
    """BadInput: a camera that stands inside a solid which was added or moved, where no light is.

    n_before : facets of the model as it was. A room without its lamp is closed too, and dark; that is its picture.
    """
    surface = subject.surface
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, 5), np.linspace(0, camera.height - 1, 5))
    v = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
    rays = np.hstack([np.broadcast_to(surface.local.points(camera.centre), v.shape), v]).astype(np.float32)
    triangle = surface.caster.closest(rays)[0]
    met = triangle >= 0
    new = met & (surface.facet[triangle] >= n_before) & (surface.group[surface.facet[triangle]] >= 0)
    if new.any() and start_inside(surface, rays[met], triangle[met]).all():
        name = subject.view.model.objects[surface.object[surface.facet[triangle[new][0]]]]
        raise BadInput(f"{what} stands inside the object {name!r}, a solid: no light is there")


def seen(model, camera: Camera, photograph=None) -> tuple:
    """(View, A-buffer) of a model."""
    try:
        opengl.require_graphics()
        drawn, method = index_buffer.draw(model, camera), "opengl"
    except opengl.NoGraphics:
        drawn, method = index_buffer.reference(model, camera), "rays"
    pieces = coverage.coverage(model, camera, drawn.facet, method)
    return View(camera, model, photograph, drawn.facet), pieces


# ---- one picture ----


def picture(scene: Scene, quality: Quality, *, timing=None) -> Made:
    """What the entry asks for, where it is no sequence."""
    timing = timing or (lambda label: contextlib.nullcontext())
    if "camera" in scene.entry:
        lit = _light(scene.changed, quality, timing)
        linear = through(lenses.read(scene.entry["camera"]), scene.changed, lit, quality, timing=timing)
        return replace(_made(scene.changed, linear, 8), facts={"residual": lit.light.residual})
    pair = differential.renderings(scene.recovered, scene.changed, quality, timing=timing)
    photograph, T = scene.recovered.view.photograph, scene.recovered.transfer
    with timing("compose"):
        linear, still = differential.composed(photograph, pair, T)
        if scene.entry.get("grain"):
            linear = grain.added(linear, pair, photograph, T)
    made = _made(scene.changed, linear, 16 if photograph.bits == 16 else 8)
    if not photograph.linear:  # to the last bit, whatever T and its inverse round
        largest = 65535 if photograph.bits == 16 else 255
        own = scene.changed.channels_of_file(np.round(photograph.values * largest).astype(int))
        made = replace(made, values=np.where(still[..., None], own, made.values))
    return replace(made, facts=pair.facts | {"changed_pixels": int((~still).sum())})


def _light(subject, quality, timing) -> Lighting:
    transport = subject.traced and subject.traced.transport
    how = {"n_texels": quality.n_texels, "timing": timing}
    return lighting(subject.surface, subject.factors, subject.appearance, transport=transport, **how)


def _made(subject: Subject, linear, bits) -> Made:
    depth = 65535 if bits == 16 else 255
    values = subject.channels_of_file(np.round(subject.show(linear) * depth).astype(int))
    return Made(subject.channels_of_file(linear), values, bits, {})


def write(made: Made, picture_path, exr_path):
    """Both files, or none."""
    with artefact.writing_all(picture_path, exr_path) as (picture, exr):
        (image.write_png16 if made.bits == 16 else image.write_png8)(picture, made.values)
        image.write_exr(exr, made.linear)


# ---- other cameras ----


def through(lens: Lens, subject: Subject, lit: Lighting, quality: Quality, *, timing=None):
    """(H, W, C) linear: the lit scene through a lens posed in the model's frame.

    A lens that is no pinhole shows a pinhole picture resampled.
    BadInput: a lens that sees too wide for one.
    """
    timing = timing or (lambda label: contextlib.nullcontext())
    camera, where = _pinhole(lens)
    with timing("index"):
        view, pieces = seen(subject.view.model, camera)
    # what mirrors show was traced for another camera
    own = replace(subject, view=view, coverage=pieces, traced=None, falloff=None)
    linear = rendering.of_lit(own, lit, quality, timing=timing).linear
    return linear if where is None else _resampled(linear, where)


def _pinhole(lens: Lens) -> tuple:
    """(Camera, None), or a Camera whose picture holds all that the lens shows, and (H, W, 2) px there of its pixels."""
    T = lens.T_cam_ref
    if lens.model == PINHOLE:
        return Camera(lens.K, lens.width, lens.height, T), None
    y, x = np.mgrid[: lens.height, : lens.width].astype(float)
    v = lens.unproject(np.stack([x, y], axis=-1))
    z = v[..., 2]
    wide = ~(np.isfinite(v).all(axis=2) & (np.hypot(v[..., 0], v[..., 1]) < WIDEST * z))
    if wide.any():
        row, column = np.argwhere(wide)[0]
        raise BadInput(
            f"{lens.path}: pixel ({column}, {row}): looks too far to the side for a picture made from a pinhole's"
        )
    tangent = v[..., :2] / z[..., None]
    low, high = tangent.min(axis=(0, 1)), tangent.max(axis=(0, 1))
    focal = FINER * lens.intrinsics[:2]
    size = np.ceil((high - low) * focal).astype(int) + 5
    K = np.diag([*focal, 1.0])
    K[:2, 2] = 2 - low * focal
    return Camera(K, int(size[0]), int(size[1]), T), tangent * focal + K[:2, 2]


def _resampled(linear, where):
    import cv2

    x, y = (np.ascontiguousarray(where[..., k], np.float32) for k in range(2))
    out = cv2.remap(np.ascontiguousarray(linear, np.float32), x, y, cv2.INTER_LINEAR)
    return out.reshape(*where.shape[:2], -1).astype(float)


# ---- sequences ----


def cameras(entry, camera: Camera) -> list[Lens]:
    """The cameras of a sequence. camera : the photograph's, whose lens those of a csv file have"""
    named, frames = entry["cameras"], entry.get("frames")
    if isinstance(named, list):
        return motion.between(motion.read_cameras(named), frames)
    four = np.array([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]])
    lens = Lens(PINHOLE, four, camera.width, camera.height, np.eye(4), named)
    return motion.between([replace(lens, T_cam_ref=T) for T in motion.read_csv(named)], frames)


def sequence(scene: Scene, quality: Quality, folder, preview, bar, *, timing=None) -> dict:
    """Writes the frames, folder/0001.png and so on, and the preview; all or none. The light is balanced once.

    Returns facts for the report.  bar : called with the share done
    """
    timing = timing or (lambda label: contextlib.nullcontext())
    way = cameras(scene.entry, scene.recovered.view.camera)
    lit = _light(scene.changed, quality, timing)
    folder = Path(folder)
    partial = folder.with_name(f".{folder.name}.frames-{os.getpid()}")
    try:
        partial.mkdir(parents=True)
        with artefact.writing(preview) as film:
            writer = _film(film, way[0])
            for k, lens in enumerate(way):
                linear = through(lens, scene.changed, lit, quality, timing=timing)
                values = _made(scene.changed, linear, 8).values
                with timing("write"):
                    image.write_png8(partial / f"{k + 1:04d}.png", values)
                    writer.write(
                        np.ascontiguousarray(np.broadcast_to(values, (*values.shape[:2], 3))[..., ::-1], np.uint8)
                    )
                bar((k + 1) / len(way))
            writer.release()
            shutil.rmtree(folder, ignore_errors=True)
            partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {"frames": len(way), "residual": lit.light.residual}


def _film(path, lens):
    import cv2

    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"mp4v"), PER_SECOND, (lens.width, lens.height))
    if not writer.isOpened():
        raise RuntimeError(f"{path}: OpenCV has no encoder for MP4")
    return writer
