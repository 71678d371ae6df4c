#!/usr/bin/env python3
"""§3.2 The A-buffer: how much of each pixel every facet covers, from 8 x 8 sub-pixels.

    $ stages/coverage.py --model model.obj --camera left.posed.cameramodel --facet facet.png \
          --coverage coverage.npz --report coverage.report.json

reads   model, camera
        facet         the index buffer: index + 1, 0 = nothing there
writes  coverage      for the P pixels that are not wholly of their own facet: pixel (P,) = y width + x, start (P + 1,);
                      facet (S,) from 0 and count (S,): pixel i shows count[k] / 64 of facet[k], start[i] <= k < start[i + 1];
                      what is missing from 64 shows nothing
"""
import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
from lib import stage


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("model", "camera", "facet", "coverage"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--report")
    parser.add_argument("--method", choices=("opengl", "rays"), default="opengl",
                        help="the whole picture drawn 8 times as fine, or rays at its edges; the same but for rounding")
    return parser


def main(opt):
    from lib.report import Report

    with Report(opt.report, inputs=[opt.model, opt.camera, opt.facet], arguments=vars(opt)) as report:
        with report.excluded("imports"):
            import cv2                                             # noqa: F401  where lib/ imports late
            import numpy as np
            import scipy.sparse.csgraph                            # noqa: F401
            from lib import artefact, cameras, image, index_buffer, model as models

        model = models.load(opt.model)
        camera = cameras.read_cameramodel(opt.camera)
        facet = image.read_labels(opt.facet) - 1
        if facet.shape != (camera.height, camera.width):
            raise stage.BadInput(f"{opt.facet}: size: {facet.shape[1]} x {facet.shape[0]} is not the camera's {camera.width} x {camera.height} ({opt.camera})")
        if facet.max() >= model.n_facets:
            raise stage.BadInput(f"{opt.facet}: value: {facet.max() + 1} is beyond the model's {model.n_facets} facets ({opt.model})")

        method = opt.method
        if method == "opengl":
            try:
                with report.excluded("imports"):
                    import moderngl                                # noqa: F401
                index_buffer.require_graphics()
            except (ImportError, index_buffer.NoGraphics) as error:
                report.warning(f"no OpenGL ({error}): rays instead")
                method = "rays"
        if method == "rays":
            with report.excluded("imports"):
                import open3d                                      # noqa: F401
        with report.timing("coverage"):
            arrays = index_buffer.coverage(model, camera, facet, method)
        report["method"] = method
        report["mixed_pixels"] = len(arrays["pixel"])
        artefact.write_npz(opt.coverage, **arrays)


if __name__ == "__main__":
    stage.run(main, options())
