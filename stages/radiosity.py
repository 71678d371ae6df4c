#!/usr/bin/env python3
"""§3.3, figure 3.9 Radiosity by refinement: how the light spreads, iteration by iteration, by any of the solvers.

    $ stages/radiosity.py --model model.obj --camera left.posed.cameramodel --photograph left.png --facet facet.png \
          --formfactors formfactors.npz --materials materials.json --pictures radiosity.png \
          --report radiosity.report.json --method progressive

reads   model, camera, photograph (its channels), facet, formfactors, materials
writes  pictures      a sheet: the picture after 0, 1, 2, 4, 8, ... iterations and at the end, Gouraud-shaded, shown
                      through T() of a scene whose brightest reflecting element is white
The report has the residual against time. Only made where it is among a scene's goals: the picture proper is render's.
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="model camera photograph facet formfactors materials",
        writes="pictures",
        refined="camera model",
    )
    parser.add_argument(
        "--method",
        choices=["progressive", "southwell", "gauss_seidel", "jacobi", "krylov", "direct"],
        default="progressive",
    )
    parser.add_argument(
        "--tolerance",
        type=stage.real(0, 1, open_low=True),
        default=1e-3,
        help="of the residual, as a part of the brightest direct light",
    )
    parser.add_argument(
        "--ambient", type=int, choices=[0, 1], default=0, help="progressive: show what is unshot as an even glow"
    )
    parser.add_argument(
        "--overshoot", type=int, choices=[0, 1], default=0, help="progressive: shoot in advance what will be reflected"
    )
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late
            import numpy as np

            from lib.core import artefact
            from lib.given import image
            from lib.given.view import View
            from lib.light import factors_file, outside, throws
            from lib.light import surface as surfaces
            from lib.picture import appearance, gouraud
        view = View.read(camera=opt.camera, model=opt.model, photograph=opt.photograph, facet=opt.facet)
        factors = factors_file.read(opt.formfactors, view.model, opt.model)
        surface = surfaces.surface(view.model, factors.lamps)
        factors = outside.with_outside(factors, lambda: surface)
        channels = view.photograph.values.shape[2]
        look, found, _ = appearance.read(opt.materials, factors.groups, factors.lamps, channels, view.model.n_facets)
        rho, lamps = look.rho, look.E
        if look.finish is not None:
            report.note(
                f"{opt.materials}: mirrors and glossy surfaces are left out: this stage shows how diffuse light spreads"
            )
        factors = throws.in_lobes(factors, surface, found.lobes)
        with report.timing("canvas"):
            canvas = gouraud.Canvas(surface, factors.mesh, view.camera, view.facet)
        emitted = gouraud.emittance(factors, factors.mesh.side % 2 == 0, lamps)
        pictures = [rho[factors.patch_group] * (factors.lamp_factor @ lamps)]
        due = 1

        def keep(iteration, b):
            nonlocal due
            if iteration >= due:
                pictures.append(b)
                due *= 2

        begin = report.clocks()
        with report.timing("solve"):
            solution = gouraud.solve(
                factors,
                rho,
                lamps,
                method=opt.method,
                tolerance=opt.tolerance,
                ambient=opt.ambient == 1,
                overshoot=opt.overshoot == 1,
                callback=keep,
            )
        pictures.append(solution.B)
        report.status = "converged" if solution.converged else "not converged"
        for step in solution.trace[:: max(1, len(solution.trace) // 200)]:
            cpu_s, wall_s = begin.cpu + step.cpu_s, begin.wall + step.wall_s  # since the stage began, not the solve
            report.trace(iteration=step.iteration, residual=step.residual, cpu_s=cpu_s, wall_s=wall_s)
        report["iterations"], report["pictures"] = solution.iterations, len(pictures)
        report.error("residual", solution.residual, unit="camera-referred", against="eq. 3.2")
        if np.isfinite(solution.bound):
            report.error("bound", solution.bound, unit="camera-referred", against="the exact solution of these factors")
        white = max(float(np.max(solution.B)), 1e-12)  # the rescaling of figure 3.9
        exponent = 1 / (found.transfer.gamma or 2.2)
        drawn = [np.clip(canvas.draw(emitted + b) / white, 0, 1) ** exponent for b in pictures]
        with artefact.writing(opt.pictures) as partial:
            sheet = gouraud.sheet(drawn, columns=4)
            image.write_png8(partial, (255 * np.repeat(sheet, 3 // sheet.shape[2], axis=2)).round().astype(int))


if __name__ == "__main__":
    stage.run(main, options())
