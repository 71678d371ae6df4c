#!/usr/bin/env python3
"""§2 Lenses and relative pose of the pair by mrcal from chessboards; without boards the lenses from the photographs.

    $ stages/calibrate.py --boards boards/ --board '{"corners": [9, 6], "square_m": 0.025}' \
          --lens '"LENSMODEL_OPENCV8"' --camera left.cameramodel --camera-right right.cameramodel \
          --corners corners.vnl --calibration calibration.json

reads   boards        folder of left-*, right-* images of the board, or of corners.vnl, which spares the detection
        photograph, photograph_right    the pair: with boards it tells the scene's distance, without it is all there is
writes  camera, camera_right    with boards: mrcal's models, in the left camera's frame, metres
                      without: pinholes of one centre
        corners       mrcal's corners, of what was found (empty without boards)
        calibration   how far they can be trusted: uncertainty, cross-validation, verdict (data/FORMATS.md)
"""

import sys
import tempfile
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__, may_read="photograph photograph_right", writes="camera camera_right corners calibration"
    )
    parser.add_argument("--boards", help="a folder")
    parser.add_argument("--board", type=stage.json_option, help="its inner corners across and down, and its squares")
    parser.add_argument("--lens", type=stage.json_option, default='"LENSMODEL_OPENCV8"', help="what mrcal fits")
    return parser


def main(opt):
    from lib.core.report import Report

    files = sorted(p for p in Path(opt.boards).iterdir() if p.is_file()) if opt.boards else []
    with Report.of(opt, files) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late

            from lib.core import artefact
            from lib.vision import calibration

        photographs = (opt.photograph, opt.photograph_right) if opt.photograph and opt.photograph_right else None
        with tempfile.TemporaryDirectory(prefix="calibrate-") as scratch:
            if opt.boards:
                result = calibration.from_boards(opt.boards, opt.board, opt.lens, photographs, report, scratch)
            else:
                result = calibration.from_pair(photographs, report)
        report["calibration"] = result.answer["verdict"]
        for name, value, unit, against in result.errors():
            report.error(name, value, unit=unit, against=against)
        for reason in result.answer["reasons"]:
            report.warning(reason)
        with artefact.writing_all(opt.camera, opt.camera_right, opt.corners, opt.calibration) as partials:
            result.write(*partials)


if __name__ == "__main__":
    stage.run(main, options())
