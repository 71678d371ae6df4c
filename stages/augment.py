#!/usr/bin/env python3
"""Figure 4.12: the recovered scene changed: another viewpoint, object, material or lamp (SCENE.md, `augment`).

    $ stages/augment.py --model model.obj --camera left.posed.cameramodel --photograph left.png --facet facet.png \
          --formfactors formfactors.npz --materials materials.json --coverage coverage.npz \
          --entry '{"name": "red-desk", "change": {"desktop": {"rho_d": [0.6, 0.1, 0.1]}}}' \
          --picture augmented.red-desk.png --exr augmented.red-desk.exr --report augment.red-desk.report.json

reads   model, camera, photograph, facet, formfactors, materials, coverage      as render
        entry         JSON: an entry of `augment`, its files as paths
writes  picture       without a camera of its own: the photograph + (with - without) through T; else the rendering
        exr           the same before T: linear
        preview       of a sequence, instead: MP4, beside its frames in the folder `frames`, 0001.png and so on
"""

import os
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import packages, stage


def options():
    parser = stage.parser(
        __doc__,
        reads="model camera photograph facet formfactors materials coverage",
        may_lack="specular",
        may_write="picture exr preview frames",
        refined="camera model",
    )
    parser.add_argument("--entry", type=stage.json_option, required=True, help="JSON: an entry of `augment`")
    parser.add_argument("--rays", type=stage.whole(1), default=256, help="gathering rays at each place")
    parser.add_argument("--shadow-rays", type=stage.whole(1), default=64, help="per pixel and lamp in a penumbra")
    parser.add_argument("--contact", type=stage.real(0), default=0.35, help="see render")
    parser.add_argument("--tolerance", type=stage.real(0), default=0.01, help="see render")
    parser.add_argument("--lobe-rays", type=stage.whole(1), default=128, help="per pixel of a glossy surface")
    parser.add_argument("--patch-rays", type=stage.whole(1), default=512, help="of each new patch")
    return parser


def main(opt):
    from lib.core.report import Report
    from lib.planning import augment

    augment.check(opt.entry)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # sums in one order, however many threads there are
    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  these where lib/ imports late
            import OpenEXR  # noqa: F401
            import scipy.sparse.csgraph  # noqa: F401

            from lib.light.balance import unsolved
            from lib.picture import augmented, differential
            from lib.picture import subject as subjects

            packages.open3d()
        names = "model camera photograph facet formfactors materials coverage specular"
        files = {name: getattr(opt, name) for name in names.split()}
        quality = subjects.Quality(opt.rays, opt.shadow_rays, opt.contact, opt.tolerance, opt.lobe_rays)
        with report.timing("read"):
            scene = augmented.read(opt.entry, files, n_rays=opt.patch_rays)
        how = {"timing": report.timing}
        if "cameras" in opt.entry:
            facts = augmented.sequence(scene, quality, opt.frames, opt.preview, stage.Bar("frames"), **how)
        else:
            made = augmented.picture(scene, quality, **how)
            facts = made.facts
            with report.timing("write"):
                augmented.write(made, opt.picture, opt.exr)
        for key, value in facts.items():
            report[key] = value
        if line := unsolved(facts["residual"]):
            report.status = "not converged"
            report.warning(line)
        if noisy := differential.mottled(facts.get("noise", {})):
            report["noisy"] = noisy
            most = facts["noise"][noisy[0]]
            report.warning(
                f"the light on {', '.join(noisy)} is noisy, {most:.2g} of display on {noisy[0]}: "
                f"more rays than {opt.rays} make it less (params: augment: rays)"
            )
        for text in scene.warnings:
            report.warning(text)


if __name__ == "__main__":
    stage.run(main, options())
