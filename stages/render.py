#!/usr/bin/env python3
"""§3.3 The photograph rendered again: the light balance B = E + rho F B (eq. 3.2), seen through T().

    $ stages/render.py --model model.obj --camera left.posed.cameramodel --photograph left.png --facet facet.png \
          --formfactors formfactors.npz --materials materials.json --coverage coverage.npz \
          --rendered rendered.png --exr rendered.exr --difference difference.png --scores rendered.json \
          --report render.report.json

reads   model, camera, photograph
        facet         the index buffer: index + 1, 0 = nothing there
        formfactors   patches, F, lamp factors
        materials     per group: rho_d (or what was assumed); per lamp: its emittance; the transfer function
        coverage      the A-buffer: what mixed pixels show
writes  rendered      display values, channels and depth of the photograph (8 bits for an EXR)
        exr           the same before T(): linear
        difference    0.5 + gain (rendered - photograph), the gain in `scores`
        scores        {"rmse", "ciede2000", "groups": {name: {"rmse", "ciede2000"}}} of display values in [0, 1]
The report's trace has two measures. `foretold_error`, while light is gathered: by how much neighbouring places fail to
foretell each other's light, as a share of it. `rmse`, once at the end: of the picture against the photograph.
"""

import os
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import packages, stage

GAIN = 5.0  # of the difference picture


def options():
    parser = stage.parser(
        __doc__,
        reads="model camera photograph facet formfactors materials coverage",
        may_lack="specular",
        writes="rendered exr difference scores",
        refined="camera model",
    )
    parser.add_argument("--rays", type=stage.whole(1), default=256, help="gathering rays at each place")
    parser.add_argument("--shadow-rays", type=stage.whole(1), default=64, help="per pixel and lamp in a penumbra")
    parser.add_argument(
        "--contact", type=stage.real(0), default=0.35, help="distance between places, in distances of what they see"
    )
    parser.add_argument(
        "--tolerance",
        type=stage.real(0),
        default=0.01,
        help="of the interpolated light, as a share of a place's total light",
    )
    parser.add_argument("--lobe-rays", type=stage.whole(1), default=128, help="per pixel of a glossy surface")
    return parser


def main(opt):
    from lib.core.report import Report

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # sums in one order, however many threads there are
    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  these where lib/ imports late
            import numpy as np
            import OpenEXR  # noqa: F401

            from lib.light.balance import unsolved
            from lib.picture import display, phong, rendering
            from lib.picture import subject as subjects

            packages.open3d()
            packages.colour()
        files = "model camera photograph facet formfactors materials coverage specular"
        subject = subjects.read(**{name: getattr(opt, name) for name in files.split()})
        for text in subject.warnings:
            report.warning(text)

        quality = subjects.Quality(opt.rays, opt.shadow_rays, opt.contact, opt.tolerance, opt.lobe_rays)
        picture = rendering.render(subject, quality, timing=report.timing, trace=report.trace)
        if line := unsolved(picture.light.residual):
            report.status = "not converged"
            report.warning(line)
        report.error("flux", picture.light.imbalance, unit="1", against="emitted = absorbed + escaped, patches")
        with report.timing("scores"):
            shown, wanted = subject.show(subject.through_lens(picture.linear)), subject.wanted
            values, depth = subject.quantised(shown)
            scores = display.scores(values, wanted, subject.group, subject.groups)
            scores |= {"difference_gain": GAIN, "difference_zero": 0.5}
            names = np.array([*subject.groups, None], object)[subject.group]
            for text in display.unlike(values, wanted, names, subject.counted, subject.fitted):
                report.warning(text)
                report.status = "not converged"
        report.trace(rmse=scores["rmse"])
        with report.timing("comparisons"):
            local, ambient, power = phong.phong_picture(subject, picture)
            against = "photograph; eq. 3.1, ambient and power fitted"
            report.error(
                "phong.rmse",
                display.rmse(subject.show(subject.through_lens(local)), wanted),
                unit="display",
                against=against,
            )
            report["phong"] = {"ambient": ambient, "power": power}
            if not subject.view.photograph.linear:
                T = subject.transfer
                report["transfer_models"] = display.transfer_models(
                    subject.through_lens(picture.linear), wanted, subject.group, subject.pure, T, subject.counted
                )
        report.error("rmse", scores["rmse"], unit="display", against="photograph")
        report.error("ciede2000", scores["ciede2000"], unit="CIEDE2000", against="photograph, values read as sRGB")
        for key, value in picture.facts.items():
            report[key] = value

        with report.timing("write"):
            write(opt, subject, picture.linear, values, depth, scores)


def write(opt, subject, linear, values, depth, scores):
    """The stage's files, all or none.  values : (H, W, C) display;  depth : their largest number in the file"""
    from lib.core import artefact
    from lib.given import image

    difference_of_display = (0.5 + GAIN * (values - subject.wanted)).clip(0, 1)
    write_png = image.write_png16 if depth == 65535 else image.write_png8
    of_file = subject.channels_of_file
    names = (opt.rendered, opt.exr, opt.difference, opt.scores)
    with artefact.writing_all(*names) as (rendered, exr, difference, table):
        write_png(rendered, of_file((values * depth).round().astype(int)))
        image.write_exr(exr, of_file(linear))
        image.write_png8(difference, of_file((difference_of_display * 255).round().astype(int)))
        artefact.write_json(table, scores)


if __name__ == "__main__":
    stage.run(main, options())
