#!/usr/bin/env python3
"""§3.3 The photograph rendered again: the light balance B = E + rho F B (eq. 3.2), seen by the camera, shown through T().

    $ stages/render.py --model model.obj --camera left.posed.cameramodel --photograph left.png --facet facet.png \
          --formfactors formfactors.npz --materials materials.json --coverage coverage.npz \
          --rendered rendered.png --exr rendered.exr --difference difference.png --scores rendered.json --report render.report.json

reads   model, camera, photograph
        facet         the index buffer: index + 1, 0 = nothing there
        formfactors   patches, F, lamp factors
        materials     per group: rho_d (or what was assumed); per lamp: its emittance; the transfer function
        coverage      the A-buffer: what mixed pixels show
writes  rendered      display values, channels and depth of the photograph (8 bits for an EXR)
        exr           the same before T(): linear
        difference    0.5 + gain (rendered - photograph), the gain in `scores`
        scores        {"rmse", "ciede2000", "groups": {name: {"rmse", "ciede2000"}}} of display values in [0, 1]
"""
import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
from lib import stage


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("model", "camera", "photograph", "facet", "formfactors", "materials", "coverage", "rendered", "exr", "difference", "scores"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--report")
    parser.add_argument("--rays", type=int, default=256, help="gathering rays at each place")
    parser.add_argument("--shadow-rays", type=int, default=64, help="per pixel and lamp in a penumbra")
    parser.add_argument("--contact", type=float, default=0.35, help="distance between places, in distances of what they see")
    parser.add_argument("--tolerance", type=float, default=0.01, help="of the interpolated light, as a share of a place's total light")
    parser.add_argument("--lobe-rays", type=int, default=128, help="per pixel of a glossy surface")
    return parser


def main(opt):
    from lib.report import Report

    for name, low in (("rays", 1), ("shadow_rays", 1), ("contact", 0), ("tolerance", 0), ("lobe_rays", 1)):
        if not low <= getattr(opt, name) < float("inf"):
            raise stage.BadInput(f"--{name.replace('_', '-')}: {getattr(opt, name)} is outside [{low}, inf)")
    inputs = [opt.model, opt.camera, opt.photograph, opt.facet, opt.formfactors, opt.materials, opt.coverage]
    with Report(opt.report, inputs=inputs, arguments=vars(opt)) as report:
        with report.excluded("imports"):
            from lib import artefact, display, image, rendering
            rendering.imports()
        scene = rendering.read(opt.model, opt.camera, opt.photograph, opt.facet, opt.formfactors, opt.materials, opt.coverage)
        for text in scene.warnings:
            report.warning(text)
        with report.excluded("compile"):
            rendering.warm_up(scene.channels)

        picture = rendering.render(scene, n_rays=opt.rays, shadow_rays=opt.shadow_rays, contact=opt.contact, tolerance=opt.tolerance, lobe_rays=opt.lobe_rays,
                                   timing=report.timing, trace=report.trace)
        report.error("flux", picture.light.imbalance, unit="1", against="emitted = absorbed + escaped, patches")
        with report.timing("scores"):
            shown, wanted = scene.show(picture.linear), scene.wanted
            values, depth = scene.quantised(shown)
            scores = display.scores(values, wanted, scene.group, scene.groups) | {"difference_gain": 5.0, "difference_zero": 0.5}
        report.trace(places=picture.facts["places"], rmse=scores["rmse"])
        with report.timing("comparisons"):
            local, ambient, power = rendering.phong_picture(scene, picture)
            report.error("phong.rmse", display.rmse(scene.show(local), wanted), unit="display", against="photograph; eq. 3.1, ambient and power fitted")
            report["phong"] = {"ambient": ambient, "power": power}
            if not scene.photograph.linear:
                report["transfer_models"] = display.transfer_models(picture.linear, wanted, scene.group, scene.pure, scene.kind, scene.gamma, scene.counted)
        report.error("rmse", scores["rmse"], unit="display", against="photograph")
        report.error("ciede2000", scores["ciede2000"], unit="CIEDE2000", against="photograph, values read as sRGB")
        for key, value in picture.facts.items():
            report[key] = value

        with report.timing("write"), artefact.writing_all(opt.rendered, opt.exr, opt.difference, opt.scores) as (rendered, exr, difference, table):
            (image.write_png16 if depth == 65535 else image.write_png8)(rendered, scene.channels_of_file((values * depth).round().astype(int)))
            image.write_exr(exr, scene.channels_of_file(picture.linear))
            image.write_png8(difference, scene.channels_of_file(((0.5 + 5.0 * (values - wanted)).clip(0, 1) * 255).round().astype(int)))
            artefact.write_json(table, scores)


if __name__ == "__main__":
    stage.run(main, options())
