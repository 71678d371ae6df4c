#!/usr/bin/env python3
"""§2 The relative pose of the pair, up to scale, from the photographs and their lenses: the baseline has length 1.

    $ stages/orient.py --photograph left.png --photograph-right right.png \
          --lens-camera left.cameramodel --lens-camera-right right.cameramodel \
          --camera left.oriented.cameramodel --camera-right right.oriented.cameramodel --orientation orientation.json

reads   photograph, photograph_right, lens_camera, lens_camera_right    pinholes; their own poses are not looked at
writes  camera, camera_right    the left one at the origin
        orientation   "unit": "baseline", rt_right_left, covariance, inliers, matches, rms_px, angle_deg, planar, other
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    return stage.parser(
        __doc__,
        reads="photograph photograph_right lens_camera lens_camera_right",
        writes="camera camera_right orientation",
    )


def main(opt):
    from lib.core.report import Report

    photographs, lenses = (opt.photograph, opt.photograph_right), (opt.lens_camera, opt.lens_camera_right)
    with Report.of(opt) as report:
        with report.excluded("imports"):
            import dataclasses

            import cv2  # noqa: F401  where lib/ imports late
            import numpy as np
            import pycolmap  # noqa: F401

            from lib.core import artefact
            from lib.given import cameras, view
            from lib.vision import boards, orientation

        pair = [dataclasses.replace(cameras.read_cameramodel(path), T_cam_world=np.eye(4)) for path in lenses]
        greys = [boards.grey8(path) for path in photographs]
        for problem in map(view.size_problem, photographs, greys, pair, lenses):
            if problem:
                raise stage.BadInput(problem)
        with report.timing("match"):
            q = orientation.match(*greys)
        with report.timing("pose"):
            pose = orientation.relative_pose(*pair, *q, names=" and ".join(photographs), trace=report.trace)
        tell(report, pose)
        pair[1] = dataclasses.replace(pair[1], T_cam_world=cameras.matrix_from_rt(pose.rt_right_left))
        with artefact.writing_all(opt.camera, opt.camera_right, opt.orientation) as (left, right, text):
            cameras.write_cameramodel(left, pair[0])
            cameras.write_cameramodel(right, pair[1])
            artefact.write_json(
                text,
                {
                    "unit": "baseline",
                    "rt_right_left": pose.rt_right_left,
                    "covariance": pose.covariance,
                    "inliers": int(pose.inlier.sum()),
                    "matches": len(pose.inlier),
                    "rms_px": pose.rms_px,
                    "parallax_px": pose.parallax_px,
                    "angle_deg": pose.angle_deg,
                    "planar": pose.planar,
                    "other": pose.other,
                },
            )


def tell(report, pose):
    """Warnings and errors of a RelativePose."""
    import numpy as np

    if pose.planar:
        more = ": two poses explain them, and the other is listed in orientation.json"
        report.warning("the matches lie on one plane" + (more if pose.other is not None else ""))
    if pose.inlier.mean() < 0.5:  # a pattern that repeats: the wrong pose may agree with itself
        agree = f"{pose.inlier.sum()} of {len(pose.inlier)} matches"
        report.warning(f"only {agree} agree with the pose: it may be another one")
    spread = lambda block: float(np.degrees(np.sqrt(np.trace(block))))
    turn, direction = spread(pose.covariance[:3, :3]), spread(pose.covariance[3:, 3:])
    report.error("rms", pose.rms_px, unit="px", against="the epipolar constraint")
    report.error("sigma_rotation", turn, unit="degree", against="the matches' noise")
    report.error("sigma_baseline_direction", direction, unit="degree", against="the matches' noise")


if __name__ == "__main__":
    stage.run(main, options())
