"""Further photographs of the scene: the model over each from where it was taken, and how well that is known."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.buffers import edges, index_buffer
from lib.core import record
from lib.given import cameras, image, lenses
from lib.planning import files as given
from lib.verdict import records
from lib.verdict.page.html import number, percent, render
from lib.verdict.page.vision import overlay, pose_sigma


class Shown(NamedTuple):
    """A photograph of photos/: what photos.json says; (H, W, C) display values; the model's visible edges, or None."""

    name: str
    said: records.FurtherPhotograph
    photograph: np.ndarray
    wire: list | None


def read(poses, photos, model) -> list[Shown]:
    """poses : path of photos.json;  photos : the folder in the scene's;  model : Model, or None"""
    content = record.read(poses, records.FurtherPhotographs)
    made, shown = Path(poses).parent / "photos", []
    for one in given.further(Path(photos)):
        said = content.photographs.get(one.name)
        if said is None:
            continue
        flat = [path for path in (made / f"{one.name}.pinhole.{end}" for end in ("png", "exr")) if path.is_file()]
        photograph = image.read_photograph(flat[0] if flat else one.picture).display
        path = made / f"{one.name}.posed.cameramodel"
        wire = None
        if model is not None and said.rt_cam_world:
            wire = _wire(model, cameras.read_cameramodel(path) if path.is_file() else lenses.pinhole_of(one.posed))
        shown.append(Shown(one.name, said, photograph, wire))
    return shown


def _wire(model, camera):
    buffer = index_buffer.reference(model, camera)
    return edges.wireframe(model, camera, buffer.facet, buffer.depth)


def further_section(shown: list[Shown], width):
    """The section, "" where there are no further photographs."""
    if not shown:
        return ""
    cards = []
    for one in shown:
        alt = f"The photograph {one.name}" + (" with the model\u2019s visible edges" if one.wire is not None else "")
        cards.append(
            (
                one.name,
                words(one.said),
                overlay(one.photograph, alt, [] if one.wire is None else one.wire, min(width, 720)),
            )
        )
    return render("further.html", cards=cards)


def words(said: records.FurtherPhotograph) -> str:
    """What is known of one.

    >>> words(records.FurtherPhotograph("given", edges_found=0.9))
    'pose given; 90 % of the model\u2019s edges are there'
    >>> words(records.FurtherPhotograph("not found", why="it shows another room"))
    'not found: it shows another room'
    """
    if said.status == "not found":
        return f"not found: {said.why}"
    there = [] if said.edges_found is None else [f"{percent(said.edges_found)} of the model\u2019s edges are there"]
    if said.status == "given":
        return "; ".join(["pose given", *there])
    sigma = pose_sigma(said)
    out = ["found" + (f" to {number(sigma.degrees, 2)}° and {number(sigma.mm, 2)} mm (1 σ)" if sigma else ""), *there]
    if said.rms_px is not None:
        out.append(f"{number(said.rms_px, 2)} px from them")
    if said.focal_sigma_px is not None:
        out.append(f"focal length {number(said.focal_px, 4)} ± {number(said.focal_sigma_px, 2)} px")
    return "; ".join(out)
