"""The model over the one photograph, from its pose: the best check of a pose that a person told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lib.buffers import edges, index_buffer
from lib.given.cameras import Camera
from lib.verdict import records
from lib.verdict.page.html import finite, number, render
from lib.verdict.page.vision import overlay, pose_sigma


@dataclass(frozen=True, eq=False)
class Placed:
    """segments : (S, 2, 2) px, the visible edges of the model;  pose : of picked points, None of any other"""

    camera: Camera
    segments: np.ndarray
    pose: records.Pose | None


class Pick(NamedTuple):
    """px : from where the camera sees it"""

    name: str
    px: str
    outlier: bool


def place(camera, model, pose) -> Placed:
    """The model as a camera in its frame sees it."""
    buffer = index_buffer.reference(model, camera)
    return Placed(camera, edges.wireframe(model, camera, buffer.facet, buffer.depth), pose)


def placed_section(placed: Placed | None, photograph, width):
    """The wireframe over the photograph, and what each picked place is off."""
    if placed is None or photograph is None or photograph.shape[:2] != (placed.camera.height, placed.camera.width):
        return ""
    sigma = pose_sigma(placed.pose)
    picks = [Pick(r.name, number(r.px, 2) if finite(r.px) else "behind", r.outlier) for r in residuals(placed.pose)]
    return render(
        "placed.html",
        drawn=overlay(photograph, "The photograph with the model’s visible edges", placed.segments, width),
        known=sigma and (number(sigma.degrees, 2), number(sigma.mm, 2)),
        picks=picks,
    )


def residuals(pose: records.Pose | None):
    """Of picked places."""
    return pose.residuals if pose else []
