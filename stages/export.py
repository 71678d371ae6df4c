#!/usr/bin/env python3
"""The recovered scene for other programs: a folder for each kind, with all that it needs.

    $ stages/export.py --model model.obj --camera left.posed.cameramodel --photograph left.png \
          --materials materials.json --up '"z"' --gltf exports/gltf/scene.glb --report export.report.json

reads   model, camera, photograph, materials (and the textures that it names)
writes  gltf, mitsuba, radiance (and radiance_view), usd, colmap_cameras (_images, _points), blender: those whose
        option is given; the rest of the kind lies beside. A folder is written anew, and all of them or none
The report says what each kind loses.
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage

FILES = "gltf mitsuba radiance radiance_view usd colmap_cameras colmap_images colmap_points blender"


def options():
    parser = stage.parser(__doc__, reads="model camera photograph materials", may_write=FILES, refined="camera model")
    parser.add_argument("--up", type=stage.json_option, default='"z"', help="the model's axis that points up")
    parser.add_argument(
        "--watt-per-unit",
        type=stage.real(0, open_low=True),
        default=1.0,
        help="W/m2 that an emittance of 1.0 stands for, of Blender's lamps",
    )
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late

            from lib.core import artefact
            from lib.export import kinds
            from lib.export import scene as scenes

        files = {name: path for name in FILES.split() if (path := getattr(opt, name))}
        asked = kinds.asked(files)
        with report.timing("read"):
            scene = scenes.read(
                model=opt.model, camera=opt.camera, photograph=opt.photograph, materials=opt.materials, up=opt.up
            )
        for text in scene.warnings:
            report.warning(text)
        with artefact.writing_folders(*asked.values()) as folders:
            for kind, folder in zip(asked, folders, strict=True):
                with report.timing(kind):
                    kinds.KINDS[kind].write(Path(folder), scene, opt.watt_per_unit)
        report["losses"] = {kind: kinds.losses(kind, scene) for kind in asked}
        for name, share in kinds.lobe_errors(asked, scene).items():
            report.error(name, share, unit="1", against="Ward's lobe of the same alphas, RMS")


if __name__ == "__main__":
    stage.run(main, options())
