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

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="gather formfactors",
        may_read="audit model camera photograph facet",
        may_lack="refined_causes",
        refined="camera model",
        writes="materials",
        may_write="specular mirror camera_out model_out causes_out",
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
            from lib.given import cameras, materials
            from lib.light import factors_file
        with report.timing("read"):
            factors = factors_file.read(opt.formfactors)
            found = gather.read(opt.gather)
            problem = facts.problem_of(factors, found, lamps=opt.lamps, reference=opt.reference, transfer=opt.transfer)
            camera = cameras.read_cameramodel(opt.camera) if opt.camera else None
        trace = lambda iteration, image_rmse, state: report.trace(
            iteration=iteration, image_rmse=image_rmse, gamma=state.gamma
        )
        options = {"max_iterations": opt.max_iterations, "tolerance": opt.tolerance}
        climb, textures, edges = None, {}, None
        with report.timing("fit"):
            if opt.method == "gauss-newton":
                leave = explain.Leave.of(camera, found, opt.transfer, opt.explain)
                explained = explain.explain(problem, leave, gamma=opt.gamma, trace=trace, **options)
                audited = audit(opt, report, explained, factors, found)
                refined, edges = (False, None) if audited is None else refine(opt, explained, factors, found, audited)
                if audited and audited.flagged and not refined:
                    if not explained.is_sure:
                        explained = explained.without_causes(**options)
                        audited = audit(opt, report, explained, factors, found)
                    climb, textures = climbed(opt, report, explained, factors, found, audited, options)
                problem, result, scale = explained.problem, explained.result, explained.scale
                if climb:
                    problem, result, scale = climb.problem, climb.result, climb.scale
            else:
                result = paper.paper(problem, gamma=opt.gamma, damped=opt.method == "damped", trace=trace)
                scale = scale_of(problem)
                explained = explain.Explained(problem, result, scale)
            if opt.refined_causes and not climb:
                problem = unsure(opt, problem, result, factors, found)
            why = agreement.disagreements(problem, result, found, factors, opt.transfer, explained.rivals)
            if agreement.in_doubt(result) and opt.method == "gauss-newton" and opt.explain != []:
                edges = edges or looked(opt)
                why = agreement.joined(why, edges.why if edges else [])
        described = describe.describe(
            problem,
            result,
            found,
            scale=scale,
            transfer=opt.transfer,
            explained=explained,
            refined=materials.read_causes(opt.refined_causes) if opt.refined_causes else [],
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


class Audited(NamedTuple):
    """gathered : the audit's tiles, without the lens's shadow;  flagged : a group may be more than diffuse
    given : {group number: kind}, of scene.yaml"""

    gathered: object
    flagged: bool
    given: dict


def files(opt):
    """What shows the photograph with its camera and model."""
    return {name: getattr(opt, name) for name in ("camera", "model", "photograph", "facet")}


def audit(opt, report, explained, factors, found):
    """Whether diffuse surfaces explain every group; None where that cannot be told."""
    from lib.analysis import agreement, gather, misfits
    from lib.analysis.receivers import unplaced

    problem, result = explained.problem, explained.result
    if not opt.audit or not all(files(opt).values()) or not len(problem.tile_group) or agreement.out_of_range(found):
        return None
    gathered = explained.evened(gather.read(opt.audit))
    held = len(gathered.visible), gathered.tiles.rows.columns
    if held != (len(problem.groups), len(problem.area)):
        raise stage.BadInput(f"{opt.audit}: groups, patches: {held[0]}, {held[1]} are not those of {opt.formfactors}")
    given = {problem.groups.index(name): kind for name, kind in opt.surfaces.items()}
    judged, _ = misfits.audit(factors.subcell(), problem, result, unplaced(gathered))
    excess = {problem.groups[g]: m.excess for g, m in judged.items() if m.judged}
    report["ladder"] = {"threshold": opt.threshold, "diffuse": excess, "rays": {}, "rounds": 0}
    flagged = bool(misfits.flagged(problem, judged, given, opt.threshold))
    if not flagged:
        misfits.doubt(problem, result, judged, opt.threshold, given)
    return Audited(gathered, flagged, given)


def refine(opt, explained, factors, found, audited):
    """(whether camera and model as they should be were written, what the photograph's edges say or None)."""
    from lib.analysis import agreement

    causes = {"pose", "objects", "lamp_place"} if opt.explain is None else set(opt.explain)
    if not opt.causes_out or not agreement.in_doubt(explained.result):
        return False, None
    from lib.analysis import refine
    from lib.given.view import View

    view = View.read(**files(opt))
    edges, refined = looked(opt), None
    if edges.allowed(causes):
        refined = refine.by_edges(view, edges)
    elif not edges.causes and "lamp_place" in causes:
        refined = refine.by_light(view, factors, found, explained, sure=not audited.flagged)
    return refined is not None and refined.write(opt.camera_out, opt.model_out, opt.causes_out), edges


def unsure(opt, problem, result, factors, found):
    """The problem with what is unsure of where things stand, which the sigmas of the result then hold as well."""
    from lib.analysis import refine
    from lib.analysis.uncertainty import uncertainty
    from lib.given import materials
    from lib.given.view import View

    moves = refine.unsure(View.read(**files(opt)), factors, found, materials.read_causes(opt.refined_causes))
    problem = replace(problem, unsure=tuple(moves))
    if moves and result.at is not None:
        uncertainty(problem, result.at, result)
    return problem


def looked(opt):
    """What the photograph's edges say of camera, objects and lamps; None where a file is not there."""
    if not (opt.camera and opt.model and opt.photograph):
        return None
    from lib.analysis import places
    from lib.given.view import View

    view = View.read(camera=opt.camera, model=opt.model, photograph=opt.photograph)
    return places.by_edges(view, opt.lamps)


def climbed(opt, report, explained, factors, found, audited, options):
    """The ladder: (Climb or None where what is wrong is not one material, {group: Textured})."""
    from lib.analysis import agreement, misfits

    with report.excluded("compile"):
        from lib.analysis import ascent
        from lib.given.view import View
        from lib.light import factors_file

        ascent.warm_up()
    view = View.read(**files(opt))
    factors_file.check(factors, opt.formfactors, view.model, opt.model)
    done = ascent.ascend(
        view,
        factors,
        explained,
        found,
        audited.gathered,
        lobe_rays=opt.lobe_rays,
        given=audited.given,
        threshold=opt.threshold,
        trace=lambda round, step, fitted: report.trace(
            round=round, step=step, image_rmse=fitted.rmse, gamma=fitted.state.gamma
        ),
        options=options,
    )
    climb = done.climb
    if not agreement.fits(climb.result) and not audited.given:
        return None, {}  # nothing is made up from it
    for warning in ascent.warnings(done):
        report.warning(warning)
    misfits.doubt(climb.problem, climb.result, climb.misfits, opt.threshold, audited.given, climb.places)
    textures = ascent.write_files(done, Path(opt.materials).parent, opt.specular, opt.mirror)
    report["ladder"] |= ascent.summary(done)
    return climb, textures


if __name__ == "__main__":
    stage.run(main, options())
