#!/usr/bin/env python3
"""§4.5 The light that each part of the photograph receives: form factors of tiles of trusted pixels.

    $ stages/gather.py --model model.obj --camera left.posed.cameramodel --photograph left.png --facet facet.png \
          --trusted trusted.png --formfactors formfactors.npz --gather gather.npz --report gather.report.json

reads   model, camera, photograph, facet, trusted (only pixels of value 255 are used), formfactors
writes  gather        tiles: pixels, lamp factors with shadows, rows of form factors to the patches
        audit         the same, coarser, of every pixel that shows one facet; its error tells if a surface is diffuse
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="model camera photograph facet trusted formfactors",
        writes="gather",
        may_write="audit",
        refined="camera model",
    )
    parser.add_argument(
        "--rays-per-tile", type=stage.whole(1), default=512, help="at least so many rays from each tile"
    )
    parser.add_argument("--rays-per-facet", type=stage.whole(1), default=32768, help="and so many from each facet")
    parser.add_argument(
        "--lamp-samples", type=stage.whole(1), default=4, help="shadow rays per lamp in a pixel of 640 x 480"
    )
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late

            from lib.analysis.seen import gather
            from lib.given.view import View
            from lib.light import factors_file
            from lib.light import surface as surfaces
        with report.timing("read"):
            files = "camera model photograph facet trusted"
            view = View.read(**{name: getattr(opt, name) for name in files.split()})
            factors = factors_file.read(opt.formfactors, view.model, opt.model)
        with report.timing("surface"):
            surface = surfaces.surface(view.model, factors.lamps)
        with report.timing("gather"):
            sampling = gather.Sampling(opt.rays_per_tile, opt.rays_per_facet, opt.lamp_samples)
            found = gather.gathered(view, surface, factors, view.trusted, sampling)
        tiles = found.tiles
        report["tiles"], report["pixels"], report["rays"] = len(tiles), len(tiles.pixel), int(tiles.rows.shot.sum())
        report["in_gaps"] = int(gather.usable(view, surface, factors, view.trusted).sum()) - len(tiles.pixel)
        if report["in_gaps"]:
            report.note(
                f"{report['in_gaps']} trusted pixels lie in a gap narrower than its patches and are left out: how light"
                " fades in there is not known"
            )
        if len(tiles) == 0:
            report.status = "nothing seen"
            report.warning(f"{opt.trusted}: no trusted pixel shows the model: nothing can be fitted")
        if opt.audit:
            with report.timing("audit"):
                audit = gather.gathered(view, surface, factors, gather.pure(view.photograph, view.facet), gather.AUDIT)
            report["audited"] = len(audit.tiles.pixel)
            gather.write(opt.audit, audit)
        gather.write(opt.gather, found)


if __name__ == "__main__":
    stage.run(main, options())
