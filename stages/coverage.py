#!/usr/bin/env python3
"""§3.2 The A-buffer: how much of each pixel every facet covers, from 8 x 8 sub-pixels.

    $ stages/coverage.py --model model.obj --camera left.posed.cameramodel --facet facet.png \
          --coverage coverage.npz --report coverage.report.json

reads   model, camera
        facet         the index buffer: index + 1, 0 = nothing there
writes  coverage      for the P pixels that are not wholly of their own facet: pixel (P,) = y width + x,
                      start (P + 1,); facet (S,) from 0 and count (S,): pixel i shows count[k] / 64 of facet[k] for
                      start[i] <= k < start[i + 1]; what is missing from 64 shows nothing
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import packages, stage


def options():
    parser = stage.parser(__doc__, reads="model camera facet", writes="coverage", refined="camera model")
    parser.add_argument(
        "--method", choices=("opengl", "rays"), default="opengl", help="opengl turns to rays where there is no EGL"
    )
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  here, where it counts as an import; lib/ imports it late
            import scipy.sparse.csgraph  # noqa: F401  the same

            from lib.buffers import coverage, opengl
            from lib.core import artefact
            from lib.given.view import View

        view = View.read(camera=opt.camera, model=opt.model, facet=opt.facet)
        method = opt.method
        if method == "opengl":
            try:
                with report.excluded("imports"):
                    import moderngl  # noqa: F401  the same
                opengl.require_graphics()
            except (ImportError, opengl.NoGraphics) as error:
                report.note(f"no OpenGL ({error}): rays instead")
                method = "rays"
        if method == "rays":
            with report.excluded("imports"):
                packages.open3d()  # the same
        with report.timing("coverage"):
            arrays = coverage.coverage(view.model, view.camera, view.facet, method)
        report["method"] = method
        report["mixed_pixels"] = len(arrays["pixel"])
        artefact.write_npz(opt.coverage, **arrays)


if __name__ == "__main__":
    stage.run(main, options())
