#!/usr/bin/env python3
"""§4.4-4.5 Reflectances, unknown lamps and the transfer function from one photograph (eq. 4.1-4.6).

    $ stages/fit.py --gather gather.npz --formfactors formfactors.npz --lamps '{"lamp": [28, 27, 25]}' \
          --transfer '"gamma"' --materials materials.json --report fit.report.json

reads   gather        the light of each tile of trusted pixels
        formfactors   the balance between the patches
        lamps         emittance per channel, or "unknown"; reference: known reflectances
        audit         the light of all pixels: whether a group is diffuse
        model, camera, photograph, facet: read only if one is not
writes  materials     per group: its kind, rho_d, rho_s, alpha, tangent with sigma; lamps; transfer function;
                      beside it textures/ if a group has one
        specular      how light goes past mirrors and glossy surfaces, only if there are any
        mirror        what the pixels of mirrors show, only if there is one
        camera-out, model-out, causes-out: the camera, the model and why, only if the photograph puts one elsewhere;
                      all is to be made again from them then, and the materials are rough
"""

import functools
import os
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="gather formfactors",
        may_read="audit model camera photograph facet curve",
        may_lack="refined_causes",
        refined="camera model",
        writes="materials",
        may_write="specular mirror camera_out model_out causes_out",
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
            import scipy.sparse  # noqa: F401  where lib/ imports late

            from lib.analysis import describe, inversion
            from lib.given import materials
        with report.timing("read"):
            task = task_of(opt)
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
            explained=answer.explained,
            lobes=task.lobes,
            refined=task.refined,
            why=answer.why,
            climb=answer.climb,
            textures=textures,
        )
        report.status = described.status
        report["scale"], report["iterations"] = answer.scale, result.iterations
        report["uncertainty"], report["misfit"] = result.shares, result.misfit
        report["correlated"] = result.correlated
        more = describe.warnings(answer.problem, result, described, task.found)
        for warning in [*answer.warnings, *result.warnings, *more]:
            report.warning(warning)
        report.error("image.rmse", described.image.rmse, unit="display", against="the photograph's tiles")
        report.error("balance.residual", result.residual, unit="1", against="eq. 3.2")
        if answer.refined is not None:
            answer.refined.write(opt.camera_out, opt.model_out, opt.causes_out)
        materials.write(opt.materials, described)


def task_of(opt):
    """What the files and the options give."""
    from lib.analysis import facts, gather, lamp_lobe
    from lib.analysis.inversion import Task
    from lib.given import cameras, materials
    from lib.light import factors_file

    factors, found = factors_file.read(opt.formfactors), gather.read(opt.gather)
    audit = gather.read(opt.audit) if opt.audit else None
    held = None if audit is None else (len(audit.visible), audit.tiles.rows.columns)
    if held not in (None, (len(factors.groups), len(factors.area))):
        raise stage.BadInput(f"{opt.audit}: groups, patches: {held[0]}, {held[1]} are not those of {opt.formfactors}")
    transfer = opt.transfer
    if isinstance(transfer, dict) and "curve" in transfer:
        if not opt.curve:
            raise stage.BadInput("--curve: missing, and --transfer names one")
        transfer = materials.read_curve(opt.curve)
    shown = opt.audit and opt.camera and opt.model and opt.photograph and opt.facet
    view = functools.cache(lambda: view_of(opt, factors))
    if shown:
        factors, found, audit = gather.with_outside(view, factors, found, audit)
    lobes = {lamp: materials.lobe(value) for lamp, value in opt.lobes.items() if value != "unknown"}
    if opt.lobes and not shown:
        raise stage.BadInput("--lobes: without --audit, --camera, --model, --photograph and --facet")
    lambertian = factors, found
    if lobes:
        factors, found, audit = lamp_lobe.in_lobes(view(), factors, lobes, found, audit)
    return Task(
        problem=facts.problem_of(factors, found, lamps=opt.lamps, reference=opt.reference, transfer=transfer),
        found=found,
        factors=factors,
        camera=cameras.read_cameramodel(opt.camera) if opt.camera else None,
        view=view if shown else None,
        audit=audit,
        lamps=opt.lamps,
        place_sigma_m=opt.place_sigma_m,
        lobes=lobes,
        lambertian=lambertian,
        lobes_unknown=opt.lobes.keys() - lobes.keys(),
        surfaces=opt.surfaces,
        transfer=opt.transfer,
        causes=opt.explain,
        gamma=opt.gamma,
        threshold=opt.threshold,
        lobe_rays=opt.lobe_rays,
        may_refine=bool(opt.causes_out),
        refined=materials.read_causes(opt.refined_causes) if opt.refined_causes else [],
        options={"max_iterations": opt.max_iterations, "tolerance": opt.tolerance},
    )


def view_of(opt, factors):
    """The photograph with its camera and the model that the factors are of."""
    from lib.given.view import View
    from lib.light import factors_file

    view = View.read(camera=opt.camera, model=opt.model, photograph=opt.photograph, facet=opt.facet)
    factors_file.check(factors, opt.formfactors, view.model, opt.model)
    return view


def by_the_paper(opt, task, report):
    """The printed alternation, which knows no causes and no ladder."""
    from lib.analysis import agreement, paper
    from lib.analysis.explain import Explained
    from lib.analysis.inversion import Answer
    from lib.analysis.problem import scale

    trace = lambda iteration, image_rmse, state: report.trace(
        iteration=iteration, image_rmse=image_rmse, gamma=state.gamma
    )
    problem = task.problem
    if problem.fit_transfer and problem.transfer.kind != "gamma":
        raise stage.BadInput(f"--method {opt.method}: transfer: the printed alternation fits gamma alone")
    result = paper.paper(problem, gamma=opt.gamma, damped=opt.method == "damped", trace=trace)
    answer = Answer(Explained(problem, result, scale(problem)), problem, result, scale(problem))
    answer.why = agreement.disagreements(problem, result, task.found, opt.transfer, {})
    return answer


if __name__ == "__main__":
    stage.run(main, options())
