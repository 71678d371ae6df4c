#!/usr/bin/env python3
"""§4.4-4.5 Reflectances, unknown lamps and the transfer function from one photograph (eq. 4.1-4.6).

    $ stages/fit.py --gather gather.npz --formfactors formfactors.npz --lamps '{"lamp": [28, 27, 25]}' \
          --transfer '"gamma"' --materials materials.json --report fit.report.json

reads   gather        the light of each tile of trusted pixels
        formfactors   the balance between the patches
        lamps         emittance per channel, or "unknown"; reference: known reflectances
        audit         the light of all pixels: whether a group is diffuse
        model, camera, photograph, facet: read only if one is not
        edges         what the photograph's edges say of camera and objects: how surely they stand, and what to say
writes  materials     per group: its kind, rho_d, rho_s, alpha, tangent with sigma; lamps; transfer function;
                      beside it textures/ if a group has one
        specular      how light goes past mirrors and glossy surfaces, only if there are any
        mirror        what the pixels of mirrors show, only if there is one
        model-out, causes-out: the model and why, only if its light puts a lamp elsewhere; all is to be made again from
                      it then, and the materials are rough
"""

import os
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="gather formfactors",
        may_read="audit model camera photograph facet edges curve",
        may_lack="refined_causes",
        refined="camera model",
        writes="materials",
        may_write="specular mirror model_out causes_out",
    )
    parser.add_argument("--lamps", type=stage.json_option, required=True)
    parser.add_argument("--lobes", type=stage.json_option, default={}, help="of lamps: {aim, exponent} or unknown")
    parser.add_argument("--place-sigma-m", type=stage.json_option, default={}, help="of lamps; default: .1")
    parser.add_argument("--reference", type=stage.json_option, default={})
    parser.add_argument("--transfer", type=stage.json_option, default=None, help="default: auto, linear for EXR")
    parser.add_argument("--surfaces", type=stage.json_option, default={})
    parser.add_argument("--explain", type=stage.json_option, help="causes that may be taken; default: all")
    parser.add_argument("--method", choices=["gauss-newton", "paper", "damped"], default="gauss-newton")
    parser.add_argument("--gamma", type=float, default=2.2, help="where an unknown gamma starts")
    parser.add_argument(
        "--threshold",
        type=stage.real(0, open_low=True),
        default=0.0125,
        help="display RMSE beyond noise that a group may keep before it climbs the ladder",
    )
    parser.add_argument(
        "--lobe-rays", type=stage.whole(1), default=256, help="in the lobe of each tile of a glossy surface"
    )
    parser.add_argument("--max-iterations", type=stage.whole(0), default=40)
    parser.add_argument(
        "--tolerance", type=float, default=1e-5, help="largest relative change of a value in the last step"
    )
    return parser


def main(opt):
    from lib.core.report import Report

    # products with F are short: a second BLAS thread mostly waits (office: 0.47 s of CPU against 1.65 s, the same wall
    # time)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with Report.of(opt) as report:
        with report.excluded("imports"):
            import scipy.sparse.csgraph  # noqa: F401  where lib/ imports late

            from lib.analysis.answer import describe, inversion
            from lib.analysis.answer.task import Task
            from lib.given import materials
        with report.timing("read"):
            task = Task.read(opt)
        with report.timing("fit"):
            answer = inversion.solve(task, report) if opt.method == "gauss-newton" else by_the_paper(opt, task, report)
        result = answer.result
        textures = inversion.write_ladder(answer, Path(opt.materials).parent, opt.specular, opt.mirror)
        described = describe.describe(
            answer.problem,
            result,
            task.found,
            scale=answer.scale,
            transfer=opt.transfer,
            curve=task.curve,
            explained=answer.explained,
            lobes=task.lobes,
            refined=task.refined,
            why=answer.why,
            sigma_scale=answer.sigma_scale,
            unexplained=answer.unexplained | answer.accused,
            climb=answer.climb,
            textures=textures,
        )
        report.status = described.status
        report["scale"], report["iterations"] = described.scale, result.iterations
        report["to"] = described.to
        report["uncertainty"], report["misfit"] = result.shares, result.misfit
        report["correlated"] = result.correlated
        more = describe.warnings(answer.problem, result, described, task.found)
        for warning in [*answer.warnings, *result.warnings, *more]:
            report.warning(warning)
        report.error("image.rmse", described.image.rmse, unit="display", against="the photograph's tiles")
        report.error("balance.residual", result.residual, unit="1", against="eq. 3.2")
        if answer.refined is not None:
            answer.refined.write(opt.model_out, opt.causes_out)
        materials.write(opt.materials, described)


def by_the_paper(opt, task, report):
    """The printed alternation, which knows no causes and no ladder."""
    from lib.analysis.answer import disagreements
    from lib.analysis.answer.answers import Answer
    from lib.analysis.causes.explained import Explained
    from lib.analysis.fit import paper
    from lib.analysis.fit.problem import scale

    trace = lambda iteration, image_rmse, state: report.trace(
        iteration=iteration, image_rmse=image_rmse, gamma=state.gamma
    )
    problem = task.problem
    if problem.fit_transfer and problem.transfer.kind != "gamma":
        raise stage.BadInput(f"--method {opt.method}: transfer: the printed alternation fits gamma alone")
    result = paper.paper(problem, gamma=opt.gamma, damped=opt.method == "damped", trace=trace)
    answer = Answer(Explained(problem, result, scale(problem)), problem, result, scale(problem))
    answer.why = disagreements.disagreements(problem, result, task.found, opt.transfer, {})
    return answer


if __name__ == "__main__":
    stage.run(main, options())
