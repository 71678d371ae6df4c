#!/usr/bin/env python3
"""§4.4-4.5 Reflectances, unknown lamps and the transfer function from one photograph (eq. 4.1-4.6).

    $ stages/fit.py --gather gather.npz --formfactors formfactors.npz --lamps '{"lamp": [28, 27, 25]}' \
          --transfer '"gamma"' --materials materials.json --report fit.report.json

reads   gather        the light of each tile of trusted pixels
        formfactors   the balance between the patches
        lamps         emittance per channel, or "unknown"; reference: known reflectances
writes  materials     per group: rho_d with sigma; lamps; transfer function
"""
import argparse
import os
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
from lib import stage


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("gather", "formfactors", "materials"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--report")
    parser.add_argument("--lamps", type=stage.json_option, required=True)
    parser.add_argument("--reference", type=stage.json_option, default={})
    parser.add_argument("--transfer", type=stage.json_option, default=None, help="default: gamma, linear for EXR")
    parser.add_argument("--surfaces", type=stage.json_option, default={})
    parser.add_argument("--method", choices=["gauss-newton", "paper", "damped"], default="gauss-newton")
    parser.add_argument("--gamma", type=float, default=2.2, help="where an unknown gamma starts")
    parser.add_argument("--max-iterations", type=int, default=40)
    parser.add_argument("--tolerance", type=float, default=1e-5, help="largest relative change of a value in the last step")
    return parser


def main(opt):
    from lib.report import Report

    # products with F are short: a second BLAS thread mostly waits (office: 0.47 s of CPU against 1.65 s, the same wall time)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with Report(opt.report, inputs=[opt.gather, opt.formfactors], arguments=vars(opt)) as report:
        with report.excluded("imports"):
            from lib import artefact, form_factors, gather, materials, reflectance
            import scipy.sparse                                    # noqa: F401
        with report.timing("read"):
            factors = form_factors.read(opt.formfactors)
            gathered = gather.read(opt.gather)
            problem = materials.problem(factors, gathered, lamps=opt.lamps, reference=opt.reference, transfer=opt.transfer)
        trace = lambda iteration, image_rmse, state: report.trace(iteration=iteration, image_rmse=image_rmse, gamma=state.gamma)
        with report.timing("fit"):
            if opt.method == "gauss-newton":
                result, scale = reflectance.fit(problem, gamma=opt.gamma, max_iterations=opt.max_iterations, tolerance=opt.tolerance, trace=trace)
            else:
                result = reflectance.paper(problem, gamma=opt.gamma, damped=opt.method == "damped", trace=trace)
                scale = reflectance.scale(problem)
        found = materials.describe(problem, result, gathered, scale=scale, transfer=opt.transfer)
        report.status = found["status"]
        report["scale"], report["iterations"] = scale, result.iterations
        report["uncertainty"], report["misfit"] = result.shares, result.misfit
        for warning in result.warnings + materials.warnings(problem, result, found, gathered):
            report.warning(warning)
        report.error("image.rmse", found["image"]["rmse"], unit="display", against="the photograph's tiles")
        report.error("balance.residual", result.residual, unit="1", against="eq. 3.2")
        artefact.write_json(opt.materials, found)


if __name__ == "__main__":
    stage.run(main, options())
