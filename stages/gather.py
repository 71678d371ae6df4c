#!/usr/bin/env python3
"""§4.5 The light that each part of the photograph receives: direct and indirect form factors of tiles of trusted pixels.

    $ stages/gather.py --model model.obj --camera left.posed.cameramodel --photograph left.png --facet facet.png \
          --trusted trusted.png --formfactors formfactors.npz --gather gather.npz --report gather.report.json

reads   model, camera, photograph, facet, trusted (only pixels of value 255 are used), formfactors
writes  gather        tiles: pixels, lamp factors with shadows, rows of form factors to the patches
        audit         the same, coarser, of every pixel that shows one facet: where the error tells whether a surface is diffuse
"""
import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
from lib import stage


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("model", "camera", "photograph", "facet", "trusted", "formfactors", "gather"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--audit")
    parser.add_argument("--report")
    parser.add_argument("--rays-per-tile", type=int, default=512, help="at least so many rays from each tile")
    parser.add_argument("--rays-per-facet", type=int, default=32768, help="and so many from each facet")
    parser.add_argument("--lamp-samples", type=int, default=4, help="shadow rays per pixel and lamp")
    return parser


def main(opt):
    from lib.report import Report

    for name in ("rays_per_tile", "rays_per_facet", "lamp_samples"):
        if getattr(opt, name) < 1:
            raise stage.BadInput(f"--{name.replace('_', '-')}: {getattr(opt, name)} is less than 1")
    with Report(opt.report, inputs=[opt.model, opt.camera, opt.photograph, opt.facet, opt.trusted, opt.formfactors], arguments=vars(opt)) as report:
        with report.excluded("imports"):
            import numpy as np
            from lib import cameras, form_factors, gather, image, mesh as meshes, model as models
            import cv2                                             # noqa: F401  where lib/ imports late
        with report.excluded("compile"):
            form_factors.warm_up()
        with report.timing("read"):
            model = models.load(opt.model)
            camera = cameras.read_cameramodel(opt.camera)
            photograph = image.read_photograph(opt.photograph)
            facet = image.read_labels(opt.facet) - 1
            trusted = image.read_labels(opt.trusted) == 255
            factors = form_factors.read(opt.formfactors)
        size = (camera.height, camera.width)
        for path, shape in ((opt.photograph, photograph.values.shape[:2]), (opt.facet, facet.shape), (opt.trusted, trusted.shape)):
            if shape != size:
                raise stage.BadInput(f"{path}: size: {shape[1]} x {shape[0]} is not the camera's {camera.width} x {camera.height} ({opt.camera})")
        if factors.groups != tuple(model.groups) or len(factors.mesh.table_start) != 2 * model.n_facets:
            raise stage.BadInput(f"{opt.formfactors}: groups, facets: {len(factors.groups)}, {len(factors.mesh.table_start) // 2} are not those of {opt.model}")
        if facet.max() >= model.n_facets:
            raise stage.BadInput(f"{opt.facet}: facet {facet.max()} is not in {opt.model}, which has {model.n_facets}")

        with report.timing("surface"):
            surface = meshes.surface(model, factors.lamps)
            lamps = form_factors.emitters(surface, factors.lamps)
        lamp = np.isin(surface.group, [model.groups.index(name) for name in factors.lamps])
        shown = facet >= 0
        used = trusted & shown & ~lamp[facet]                      # what a lamp shows is its emittance
        with report.timing("gather"):
            tiles = gather.build(surface, factors.mesh, camera, facet, used, lamps, len(factors.lamps),
                                 rays_per_tile=opt.rays_per_tile, rays_per_facet=opt.rays_per_facet, lamp_samples=opt.lamp_samples)
        visible = np.bincount(surface.group[facet[shown]], minlength=len(model.groups))
        report["tiles"], report["pixels"], report["rays"] = len(tiles), len(tiles.pixel), int(tiles.rows.shot.sum())
        if len(tiles) == 0:
            report.status = "nothing seen"
            report.warning(f"{opt.trusted}: no trusted pixel shows the model: nothing can be fitted")
        def gathered(tiles):
            values = photograph.values.reshape(-1, photograph.values.shape[2])[tiles.pixel]
            return gather.Gathered(tiles, values, surface.group[tiles.facet], surface.object[tiles.facet], visible, photograph.linear, photograph.channels_in_file)

        if opt.audit:
            with report.timing("audit"):
                pure = gather.pure(photograph, facet) & ~lamp[facet]
                audit = gather.build(surface, factors.mesh, camera, facet, pure, lamps, len(factors.lamps), rays_per_tile=128, rays_per_facet=0,
                                     lamp_samples=1, tiles_per_facet=60, seed=77)
            report["audited"] = len(audit.pixel)
            gather.write(opt.audit, gathered(audit))
        gather.write(opt.gather, gathered(tiles))


if __name__ == "__main__":
    stage.run(main, options())
