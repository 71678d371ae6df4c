#!/usr/bin/env python3
"""§4.4-4.5 Reflectances, unknown lamps and the transfer function from one photograph (eq. 4.1-4.6).

    $ stages/fit.py --gather gather.npz --formfactors formfactors.npz --lamps '{"lamp": [28, 27, 25]}' \
          --transfer '"gamma"' --materials materials.json --report fit.report.json

reads   gather        the light of each tile of trusted pixels
        formfactors   the balance between the patches
        lamps         emittance per channel, or "unknown"; reference: known reflectances
        audit         the light of all pixels: whether a group is diffuse; and model, camera, photograph, facet, read only if one is not
writes  materials     per group: its kind, rho_d, rho_s, alpha, tangent with sigma; lamps; transfer function; beside it textures/ if a group has one
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
    for name in ("audit", "model", "camera", "photograph", "facet"):
        parser.add_argument(f"--{name}", help="of all five; without them every group is diffuse" if name == "audit" else None)
    parser.add_argument("--report")
    parser.add_argument("--lamps", type=stage.json_option, required=True)
    parser.add_argument("--reference", type=stage.json_option, default={})
    parser.add_argument("--transfer", type=stage.json_option, default=None, help="default: gamma, linear for EXR")
    parser.add_argument("--surfaces", type=stage.json_option, default={})
    parser.add_argument("--method", choices=["gauss-newton", "paper", "damped"], default="gauss-newton")
    parser.add_argument("--gamma", type=float, default=2.2, help="where an unknown gamma starts")
    parser.add_argument("--threshold", type=float, default=0.0125, help="display RMSE beyond noise that a group may keep before it climbs the ladder")
    parser.add_argument("--lobe-rays", type=int, default=256, help="rays in the lobe of each tile of a glossy surface")
    parser.add_argument("--max-iterations", type=int, default=40)
    parser.add_argument("--tolerance", type=float, default=1e-5, help="largest relative change of a value in the last step")
    return parser


def main(opt):
    from lib.report import Report

    if not opt.threshold > 0 or not opt.threshold < float("inf"):
        raise stage.BadInput(f"--threshold: {opt.threshold} is not a positive number")
    if opt.lobe_rays < 1:
        raise stage.BadInput(f"--lobe-rays: {opt.lobe_rays} is less than 1")
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
        climb = textures = None
        trace = lambda iteration, image_rmse, state: report.trace(iteration=iteration, image_rmse=image_rmse, gamma=state.gamma)
        with report.timing("fit"):
            if opt.method == "gauss-newton":
                result, scale = reflectance.fit(problem, gamma=opt.gamma, max_iterations=opt.max_iterations, tolerance=opt.tolerance, trace=trace)
                problem, result, scale, climb, textures = climbed(opt, report, problem, result, scale, factors, gathered)
            else:
                result = reflectance.paper(problem, gamma=opt.gamma, damped=opt.method == "damped", trace=trace)
                scale = reflectance.scale(problem)
        found = materials.describe(problem, result, gathered, scale=scale, transfer=opt.transfer, climb=climb, textures=textures)
        report.status = found["status"]
        report["scale"], report["iterations"] = scale, result.iterations
        report["uncertainty"], report["misfit"] = result.shares, result.misfit
        for warning in result.warnings + materials.warnings(problem, result, found, gathered):
            report.warning(warning)
        report.error("image.rmse", found["image"]["rmse"], unit="display", against="the photograph's tiles")
        report.error("balance.residual", result.residual, unit="1", against="eq. 3.2")
        artefact.write_json(opt.materials, found)


def climbed(opt, report, problem, result, scale, factors, gathered):
    """The ladder: nothing but an audit where every group is diffuse. -> problem, result, scale, ladder.Climb, textures"""
    from lib import form_factors, gather, ladder, receivers, rungs
    files = {name: getattr(opt, name) for name in ("audit", "model", "camera", "photograph", "facet")}
    if not all(files.values()) or len(problem.tile_group) == 0:
        return problem, result, scale, None, None
    audit = gather.read(opt.audit)
    if len(audit.visible) != len(problem.groups) or audit.tiles.rows.columns != len(problem.area):
        raise stage.BadInput(f"{opt.audit}: groups, patches: {len(audit.visible)}, {audit.tiles.rows.columns} are not those of {opt.formfactors}")
    given = {problem.groups.index(name): kind for name, kind in opt.surfaces.items()}
    misfits, _ = rungs.audit(factors.subcell(), problem, result, receivers.unplaced(audit))
    named = lambda found: {problem.groups[g]: value for g, value in found.items()}
    report["ladder"] = summary = {"threshold": opt.threshold, "diffuse": named({g: m.excess for g, m in misfits.items() if m.judged}), "rays": {}, "rounds": 0}
    if not ladder.flagged(problem, misfits, given, opt.threshold):
        ladder.doubt(problem, result, misfits, opt.threshold, given)
        return problem, result, scale, None, None
    with report.excluded("compile"):
        from lib import specular
        form_factors.warm_up()
        specular.warm_up()
    site = receivers.read_site(files, opt.formfactors, factors, problem, gathered, audit, lobe_rays=opt.lobe_rays)
    climb = ladder.climb(site, result, scale, given=given, threshold=opt.threshold,
                         trace=lambda c: report.trace(round=c.rounds, image_rmse=c.result.rmse, gamma=c.result.state.gamma),
                         options={"max_iterations": opt.max_iterations, "tolerance": opt.tolerance})
    if site.lost > 0.01:
        report.warning(f"{site.lost:.0%} of the light is still between mirrors after {specular.DEPTH} of them: rooms of mirrors are too dark")
    ladder.doubt(climb.problem, climb.result, climb.misfits, opt.threshold, given, climb.places)
    textures = rungs.write_textures(site, climb, Path(opt.materials).parent)
    summary |= {"rays": site.spent, "rounds": climb.rounds, "end": named({g: m.excess for g, m in climb.misfits.items() if m.judged}),
                "rungs": named({g: p.rung for g, p in climb.places.items() if p.rung != "diffuse"})}
    return climb.problem, climb.result, climb.scale, climb, textures


if __name__ == "__main__":
    stage.run(main, options())
