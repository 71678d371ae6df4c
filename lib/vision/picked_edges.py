"""A pose of picked places, refined on the edges of its photograph: a click is a pixel off, an edge a tenth of one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.given import reduced
from lib.vision.picked import Found, residuals_px
from lib.vision.recognition.closed_form import Pose
from lib.vision.recognition.recognise import Recognition
from lib.vision.refinement.pose import refine
from lib.vision.refinement.rig import Side, gap_to_prior

MEGAPIXELS = 6.0  # in which edges are sought: those of larger photographs are many pixels wide
LENS_PX, CENTRE_PART = 0.1, 0.005  # what is known of a given lens; of the principal point of another, of the width
DOUBTFUL = (
    22.5,
    24.3,
)  # squared sigmas from what was picked, of 6 and 7 numbers: one right pose in 1,000 is so far off


def refined(found: Found, picks, model, photograph, focal_known) -> tuple[Found, list, str]:
    """(the pose by edges, its trace, ""), or (as it was picked, [], why): edges that prove nothing, or deny the picks.

    photograph : image.Photograph of a pinhole;  model : in metres
    """
    size = 6 if focal_known else 7
    T, C = found.camera.T_cam_world, found.joint[:size, :size]
    start = Pose(T, 1.0, C, np.zeros((0, 2), int), 0.0, 0.0, 0.0, T)
    told = Recognition((start,), "unique", "picked places", np.zeros(0), {})
    k = reduced.times((found.camera.width, found.camera.height), MEGAPIXELS)
    small = reduced.pinhole(found.camera, k)
    seen = reduced.photograph(photograph, k)
    lens_px = LENS_PX if focal_known else CENTRE_PART * small.width
    result = refine(model, [Side(small, seen)], told, lens_px=lens_px, is_zoom=not focal_known)
    camera = replace(found.camera, K=reduced.whole(result.cameras[0].K, k), T_cam_world=result.cameras[0].T_cam_world)
    if result.rms_px is None or result.support < result.least or result.evidence < result.needed:
        return found, [], f"the photograph has {result.support:.0%} of the model's edges there: not refined on them"
    gap = gap_to_prior((None, T, 1.0), camera.T_cam_world, result.scale, size)
    far = float(gap @ np.linalg.solve(C, gap))
    if far > DOUBTFUL[size - 6]:
        return (
            found,
            [],
            f"the photograph's edges ask for a pose {far**0.5:.0f} sigma from the picks: not refined on them",
        )
    focal_sigma = None if focal_known else result.focal_sigma * camera.K[0, 0]
    better = replace(
        found,
        camera=camera,
        covariance=result.covariance,
        focal_sigma_px=focal_sigma,
        residual_px=residuals_px(picks, camera),
    )
    return better, result.trace, ""
