#!/usr/bin/env python3
"""§2.4 Where further photographs of the scene were taken from: by what posed ones show, and by the model's edges.

    $ stages/locate.py --model model.obj --camera left.posed.cameramodel --photograph left.png --photos photos/ \
          --poses photos.json --report locate.report.json

reads   model; camera, photograph     of the left side, posed; and of the right one, where there is one
        photos     a folder: <x>.png (.jpg .tif .exr), and of each <x>.posed.cameramodel in the model's frame, or
                   <x>.cameramodel, its lens, or nothing: its focal length is then found, too
        said       {x: {exposure, lamps}} of scene.yaml
writes  poses      {"photographs": {x: status, rt_cam_world, covariance, ...}}, see data/FORMATS.md
        photos/    beside it: <x>.posed.cameramodel of each that was found, a pinhole; <x>.pinhole.png where its given
                   lens is none
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="model camera photograph photos",
        may_read="photograph_right camera_right",
        writes="poses",
    )
    parser.add_argument("--said", type=stage.json_option, default={}, help="photos of scene.yaml")
    return parser


def main(opt):
    from lib.core.report import Report
    from lib.planning.files import further, further_files

    photos = further(Path(opt.photos)) if Path(opt.photos).is_dir() else []
    with Report.of(opt, further_files(Path(opt.photos)) if photos else ()) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late
            import pycolmap  # noqa: F401

            from lib.given import model as models
            from lib.vision.location import files, session
            from lib.vision.refinement import rig
        if not photos:
            raise stage.BadInput(f"{opt.photos}: there are no photographs in it")
        with report.timing("read"):
            model = models.load(opt.model)
            given = (opt.camera, opt.photograph), (opt.camera_right, opt.photograph_right)
            sides = [rig.Side.read(*side) for side in given if all(side)]
            pictures = [files.read(one) for one in photos]
        known = [
            session.known(model, name, side.camera, side.photograph, files.grey(side.photograph))
            for name, side in zip(("left", "right"), sides, strict=False)
        ]
        with report.timing("given"):
            posed = [p for p in pictures if p.is_posed]
            shown = {p.name: session.shown(model, p.camera, p.photograph) for p in posed}
            believed = [p for p in posed if shown[p.name].is_believed]
            known += [session.known(model, p.name, p.camera, p.photograph, p.grey) for p in believed]
        with report.timing("locate"):
            taken = [files.taken(p, opt.said, sides[0].camera) for p in pictures if not p.is_posed]
            places = session.locate_all(model, known, taken, report.trace)
        tell(report, pictures, places, shown)
        with report.timing("write"):
            files.write(opt.poses, pictures, places, shown)


def tell(report, pictures, places, shown):
    """Warnings, errors and status."""
    from lib.vision.location import words

    for picture in pictures:
        for text in words.warnings(picture, places.get(picture.name), shown.get(picture.name)):
            report.warning(text)
    for name, place in places.items():
        if place.camera is not None:
            report.error(f"edges.{name}", place.rms_px, unit="px", against="sub-pixel edges of the photograph")
    report["found"] = sum(place.camera is not None for place in places.values())
    report["sought"] = len(places)


if __name__ == "__main__":
    stage.run(main, options())
