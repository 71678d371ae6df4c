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
        may_read="audit model camera photograph facet",
        writes="materials",
        may_write="specular mirror",
    )
    parser.add_argument("--lamps", type=stage.json_option, required=True)
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

            from lib.analysis import agreement, describe, explain, facts, gather, paper
            from lib.analysis.problem import scale as scale_of
            from lib.given import materials
            from lib.light import factors_file
        with report.timing("read"):
            factors = factors_file.read(opt.formfactors)
            found = gather.read(opt.gather)
            problem = facts.problem_of(factors, found, lamps=opt.lamps, reference=opt.reference, transfer=opt.transfer)
        trace = lambda iteration, image_rmse, state: report.trace(
            iteration=iteration, image_rmse=image_rmse, gamma=state.gamma
        )
        options = {"max_iterations": opt.max_iterations, "tolerance": opt.tolerance}
        climb, textures = None, {}
        with report.timing("fit"):
            if opt.method == "gauss-newton":
                leave = leave_of(opt, found)
                explained = explain.explain(problem, leave, gamma=opt.gamma, trace=trace, **options)
                ascent, explained = climbed(opt, report, explained, factors, found, options)
                problem, result, scale = explained.problem, explained.result, explained.scale
                if ascent:
                    climb, textures = ascent
                    problem, result, scale = climb.problem, climb.result, climb.scale
            else:
                result = paper.paper(problem, gamma=opt.gamma, damped=opt.method == "damped", trace=trace)
                scale = scale_of(problem)
                explained = explain.Explained(problem, result, scale)
            why = agreement.disagreements(problem, result, found, factors, opt.transfer, explained.rivals)
            why = agreement.joined(why, displaced(opt, result))
        described = describe.describe(
            problem,
            result,
            found,
            scale=scale,
            transfer=opt.transfer,
            explained=explained,
            why=why,
            climb=climb,
            textures=textures,
        )
        report.status = described.status
        report["scale"], report["iterations"] = scale, result.iterations
        report["uncertainty"], report["misfit"] = result.shares, result.misfit
        for warning in result.warnings + describe.warnings(problem, result, described, found):
            report.warning(warning)
        report.error("image.rmse", described.image.rmse, unit="display", against="the photograph's tiles")
        report.error("balance.residual", result.residual, unit="1", against="eq. 3.2")
        materials.write(opt.materials, described)


def displaced(opt, result):
    """What stands elsewhere, by the photograph's edges, where the light leaves a doubt."""
    from lib.analysis import places

    if result.correlated < places.LOOK or opt.explain == [] or not (opt.camera and opt.model and opt.photograph):
        return []
    from lib.given.view import View

    view = View.read(camera=opt.camera, model=opt.model, photograph=opt.photograph)
    return places.displaced(view, opt.lamps)


def leave_of(opt, found):
    """What may be explained, as far as the camera is known."""
    from lib.analysis import agreement, explain
    from lib.given import cameras
    from lib.given.falloff import Lens

    lens = None
    if opt.camera:
        camera = cameras.read_cameramodel(opt.camera)
        lens = Lens((camera.K[0, 2], camera.K[1, 2]), (camera.width, camera.height))
    causes = tuple(explain.CAUSES if opt.explain is None else opt.explain)
    causes = () if agreement.out_of_range(found) else causes  # nothing can be learnt from such values
    free = opt.transfer in (None, "auto") and "curve" in causes
    return explain.Leave(free, causes, lens, found.tiles.pixel)


def climbed(opt, report, explained, factors, found, options):
    """The ladder: (Climb, {group: Textured}), or None, after an audit alone, where every group is diffuse.

    And what is explained by causes: not by weak ones, where the ladder may explain more.
    """
    from lib.analysis import agreement, gather, misfits, vignetting
    from lib.analysis.receivers import unplaced

    problem, result, scale = explained.problem, explained.result, explained.scale
    files = {name: getattr(opt, name) for name in ("camera", "model", "photograph", "facet")}
    if not opt.audit or not all(files.values()) or not len(problem.tile_group) or agreement.out_of_range(found):
        return None, explained
    audit, lens = gather.read(opt.audit), explained.values.get("vignetting")
    where = leave_of(opt, found).lens
    if lens:
        audit = vignetting.corrected(audit, where, lens["k"], result.state.transfer)
    held = len(audit.visible), audit.tiles.rows.columns
    if held != (len(problem.groups), len(problem.area)):
        raise stage.BadInput(f"{opt.audit}: groups, patches: {held[0]}, {held[1]} are not those of {opt.formfactors}")
    given = {problem.groups.index(name): kind for name, kind in opt.surfaces.items()}
    judged, _ = misfits.audit(factors.subcell(), problem, result, unplaced(audit))
    excess = {problem.groups[g]: m.excess for g, m in judged.items() if m.judged}
    report["ladder"] = summary = {"threshold": opt.threshold, "diffuse": excess, "rays": {}, "rounds": 0}
    if not misfits.flagged(problem, judged, given, opt.threshold):
        misfits.doubt(problem, result, judged, opt.threshold, given)
        return None, explained
    if not explained.is_sure:
        return climbed(opt, report, explained.without_causes(**options), factors, found, options)
    with report.excluded("compile"):
        from lib.analysis import ascent
        from lib.given.view import View
        from lib.light import factors_file

        ascent.warm_up()
    view = View.read(**files)
    if lens:
        problem, result, scale, found = ascent.flattened(problem, result, found, where, lens["k"], options)
        view = vignetting.without(view, where, lens["k"], result.state.transfer)
    factors_file.check(factors, opt.formfactors, view.model, opt.model)
    done = ascent.ascend(
        view,
        factors,
        problem,
        result,
        scale,
        found,
        audit,
        lobe_rays=opt.lobe_rays,
        given=given,
        threshold=opt.threshold,
        trace=lambda round, step, fitted: report.trace(
            round=round, step=step, image_rmse=fitted.rmse, gamma=fitted.state.gamma
        ),
        options=options,
    )
    climb = done.climb
    if not agreement.fits(climb.result) and not given:
        return None, explained  # what is wrong is not one material: nothing is made up from it
    for warning in ascent.warnings(done):
        report.warning(warning)
    misfits.doubt(climb.problem, climb.result, climb.misfits, opt.threshold, given, climb.places)
    textures = ascent.write_files(done, Path(opt.materials).parent, opt.specular, opt.mirror)
    summary |= ascent.summary(done)
    return (climb, textures), explained


if __name__ == "__main__":
    stage.run(main, options())
