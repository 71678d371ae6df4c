#!/usr/bin/env python3
"""§3.3, figure 3.9 Radiosity by refinement: how the light spreads, iteration by iteration, by any of the solvers.

    $ stages/radiosity.py --model model.obj --camera left.posed.cameramodel --photograph left.png --facet facet.png --formfactors formfactors.npz \
          --materials materials.json --pictures radiosity.png --report radiosity.report.json --method progressive

reads   model, camera, photograph (its channels), facet, formfactors, materials
writes  pictures      a sheet: the picture after 0, 1, 2, 4, 8, ... iterations and at the end, Gouraud-shaded, shown through T()
                      of a scene whose brightest reflecting element is white
The report has the residual against time. Only made where it is among a scene's goals: the picture proper is render's.
"""
import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
from lib import stage


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("model", "camera", "photograph", "facet", "formfactors", "materials", "pictures"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--report")
    parser.add_argument("--method", choices=["progressive", "southwell", "gauss_seidel", "jacobi", "krylov", "direct"], default="progressive")
    parser.add_argument("--tolerance", type=float, default=1e-3, help="of the residual, as a part of the brightest direct light")
    parser.add_argument("--ambient", type=int, choices=[0, 1], default=0, help="progressive: show what is unshot as an even glow")
    parser.add_argument("--overshoot", type=int, choices=[0, 1], default=0, help="progressive: shoot in advance what will be reflected")
    return parser


def main(opt):
    from lib.report import Report

    if not 0 < opt.tolerance < 1:
        raise stage.BadInput(f"--tolerance: {opt.tolerance} is outside (0, 1)")
    inputs = [opt.model, opt.camera, opt.photograph, opt.facet, opt.formfactors, opt.materials]
    with Report(opt.report, inputs=inputs, arguments=vars(opt)) as report:
        with report.excluded("imports"):
            import numpy as np
            from lib import artefact, cameras, form_factors, gouraud, image, mesh, model as models, rendering
            import cv2, open3d, scipy.sparse                       # noqa: F401, E401  where lib/ imports late
        with report.excluded("compile"):
            form_factors.warm_up()
        model, camera = models.load(opt.model), cameras.read_cameramodel(opt.camera)
        facet, factors = image.read_labels(opt.facet) - 1, form_factors.read(opt.formfactors)
        channels = image.read_photograph(opt.photograph).values.shape[2]
        if facet.shape != (camera.height, camera.width):
            raise stage.BadInput(f"{opt.facet}: size: {facet.shape[1]} x {facet.shape[0]} is not the camera's {camera.width} x {camera.height} ({opt.camera})")
        found = rendering.read_materials(opt.materials, factors.groups, factors.lamps, channels)
        rho, lamps, kind, gamma = found.rho, found.E, found.kind, found.gamma
        if found.finish is not None:
            report.warning(f"{opt.materials}: mirrors and glossy surfaces are left out: this stage shows how diffuse light spreads")
        surface = mesh.surface(model, factors.lamps)
        with report.timing("canvas"):
            canvas = gouraud.Canvas(surface, factors.mesh, camera, facet)
        emitted = gouraud.emittance(factors, factors.mesh.side % 2 == 0, lamps)
        stages, due = [rho[factors.patch_group] * (factors.lamp_factor @ lamps)], [1]

        def keep(iteration, b):
            if iteration >= due[0]:
                stages.append(b)
                due[0] *= 2
        with report.timing("solve"):
            solution = gouraud.solve(factors, rho, lamps, method=opt.method, tolerance=opt.tolerance, ambient=opt.ambient == 1,
                                     overshoot=opt.overshoot == 1, callback=keep)
        stages.append(solution.B)
        report.status = "converged" if solution.converged else "not converged"
        report["trace"] = [{"cpu_s": t, "iteration": i, "residual": r} for i, t, r in solution.trace[:: max(1, len(solution.trace) // 200)]]
        report["iterations"], report["pictures"] = solution.iterations, len(stages)
        report.error("residual", solution.residual, unit="camera-referred", against="eq. 3.2")
        if np.isfinite(solution.bound):
            report.error("bound", solution.bound, unit="camera-referred", against="the exact solution of these factors")
        white = max(float(np.max(solution.B)), 1e-12)                # the rescaling of figure 3.9
        exponent = 1 / gamma if kind == "gamma" else 1 / 2.2
        drawn = [np.clip(canvas.draw(emitted + b) / white, 0, 1) ** exponent for b in stages]
        with artefact.writing(opt.pictures) as partial:
            sheet = gouraud.sheet(drawn, columns=4)
            image.write_png8(partial, (255 * np.repeat(sheet, 3 // sheet.shape[2], axis=2)).round().astype(int))


if __name__ == "__main__":
    stage.run(main, options())
