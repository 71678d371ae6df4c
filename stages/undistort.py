#!/usr/bin/env python3
"""§2 A photograph made pinhole: the same pose, 16 bit, without the lens's distortion; a large one smaller.

    $ stages/undistort.py --photograph left.png --lens-camera left.cameramodel \
          --pinhole left.pinhole.png --camera left.pinhole.cameramodel --report undistort.report.json

reads   photograph    of any kind
        lens_camera   its camera, any lens of mrcal
writes  pinhole       .png, 16 bit, display values; .exr, light, where the photograph is. Of more megapixels than told
                      k x k pixels become their mean, k as small as will do
        camera        the pinhole: the lens's own focal lengths, or longer so that no pixel is without data
"""

import math
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(__doc__, reads="photograph lens_camera", writes="pinhole camera")
    parser.add_argument("--megapixels", type=stage.real(0), default=6.0, help="that are kept at most")
    return parser


def main(opt):
    from lib.core.report import Note, Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late
            import scipy.ndimage  # noqa: F401

            from lib.core import artefact
            from lib.given import cameras, image, lenses, reduced, view

        photograph, lens = image.read_photograph(opt.photograph), lenses.read(opt.lens_camera)
        if problem := view.size_problem(opt.photograph, photograph.values, lens, opt.lens_camera):
            raise stage.BadInput(problem)
        report.about(opt.photograph, [*map(Note, photograph.notes), *photograph.doubts])
        with report.timing("camera"):
            camera, share = lenses.pinhole(lens)
        if (k := reduced.times((lens.width, lens.height), opt.megapixels)) > 1:
            photograph, whole, camera = reduced.photograph(photograph, k), camera, reduced.pinhole(camera, k)
            all_of_it = f"{{undistort: {{megapixels: {math.ceil(whole.width * whole.height / 1e6)}}}}}"
            report.note(
                f"{opt.photograph}: {whole.width} x {whole.height} px are analysed and rendered at {camera.width} x "
                f"{camera.height}, for memory and time (params: {all_of_it} keeps all: half a GB for each)"
            )
        if lens.model != "LENSMODEL_PINHOLE":
            with report.timing("resample"):
                photograph = lenses.straightened(photograph, lens, camera, k)
        report["focal_factor"] = k * camera.K[0, 0] / lens.intrinsics[0]
        report["share_kept"] = share
        if share < 0.5:
            report.note(
                f"{opt.photograph}: the pinhole picture shows {100 * share:.0f} % of the photograph: {lens.model} sees "
                "too wide for more"
            )
        with artefact.writing_all(opt.pinhole, opt.camera) as (pinhole, model):
            image.write_photograph(pinhole, photograph)
            cameras.write_cameramodel(model, camera)


if __name__ == "__main__":
    stage.run(main, options())
