#!/usr/bin/env python3
"""§2 A photograph made pinhole: the same size and pose, 16 bit, without the lens's distortion.

    $ stages/undistort.py --photograph left.png --lens-camera left.cameramodel \
          --pinhole left.pinhole.png --camera left.pinhole.cameramodel --report undistort.report.json

reads   photograph    of any kind
        lens_camera   its camera, any lens of mrcal
writes  pinhole       .png, 16 bit, display values; .exr, light, where the photograph is
        camera        the pinhole: the lens's own focal lengths, or longer so that no pixel is without data
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    return stage.parser(__doc__, reads="photograph lens_camera", writes="pinhole camera")


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late
            import numpy as np
            import scipy.ndimage  # noqa: F401

            from lib.core import artefact
            from lib.given import cameras, image, lenses, view

        photograph = image.read_photograph(opt.photograph)
        lens = lenses.read(opt.lens_camera)
        if problem := view.size_problem(opt.photograph, photograph.values, lens, opt.lens_camera):
            raise stage.BadInput(problem)
        with report.timing("camera"):
            camera, share = lenses.pinhole(lens)
        with report.timing("resample"):
            values = lenses.resample(photograph.values, lens, camera)
        report["focal_factor"] = camera.K[0, 0] / lens.intrinsics[0]
        report["share_kept"] = share
        if share < 0.5:
            report.warning(
                f"{opt.photograph}: the pinhole picture shows {100 * share:.0f} % of the photograph: {lens.model} sees "
                "too wide for more"
            )
        with artefact.writing_all(opt.pinhole, opt.camera) as (pinhole, model):
            if photograph.linear:
                image.write_exr(pinhole, np.maximum(values, 0))
            else:
                image.write_png16(pinhole, np.rint(np.clip(values, 0, 1) * 65535).astype(np.uint16))
            cameras.write_cameramodel(model, camera)


if __name__ == "__main__":
    stage.run(main, options())
