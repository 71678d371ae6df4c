#!/usr/bin/env python3
"""§3.3 Form factors (eq. 3.3) between adaptive patches, and from the patches to the lamps.

    $ stages/formfactors.py --model model.obj --lamps '["lamp"]' --formfactors formfactors.npz \
          --report formfactors.report.json

reads   model         triangles, facets, groups
        lamps         the names of the groups that emit
writes  formfactors   patches, sparse rows of F, lamp factors: good for as long as the geometry stands
The report's trace has the `unevenness` of the mesh at each level: what patches of constant light lose.
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(__doc__, reads="model", writes="formfactors", refined="model")
    parser.add_argument("--lamps", type=stage.json_option, required=True, help="JSON list of group names")
    parser.add_argument("--method", choices=["rays", "hemicube", "analytic"], default="rays")
    parser.add_argument("--patches", type=stage.whole(1), default=300, help="root cells, if all had equal area")
    parser.add_argument("--max-level", type=stage.whole(0, 10), default=5, help="times a root cell may be halved")
    parser.add_argument(
        "--contrast", type=stage.real(0, open_low=True), default=0.01, help="unevenness of light that splits a cell"
    )
    parser.add_argument("--rays", type=stage.whole(1), default=512, help="per patch")
    parser.add_argument("--hemicube-px", type=stage.whole(1), default=128, help="edge of the hemicube")
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import scipy.sparse.csgraph  # noqa: F401  here, where it counts as an import; `opening_to_light` uses it

            from lib.given import model as models
            from lib.light import adapt, factors_file
            from lib.light import lamps as lamps_
            from lib.light import surface as surfaces
        model = models.load(opt.model)
        absent = [name for name in opt.lamps if name not in model.groups]
        if absent:
            has = f"is not in the model (it has {', '.join(model.groups)})"
            raise stage.BadInput(*(f"{opt.model}: lamps: group {name!r} {has}" for name in absent))

        with report.timing("patches"):
            surface = surfaces.surface(model, opt.lamps)
            lamps = lamps_.emitters(surface, opt.lamps)
            try:
                size = {"patches": opt.patches, "max_level": opt.max_level, "contrast": opt.contrast}
                mesh = adapt.build(surface, **size, emitters=lamps, trace=report.trace)
            except ValueError as error:
                raise stage.BadInput(f"{opt.model}: facets: {error}") from None
        with report.timing("factors"):
            rows = rows_by(opt, surface, mesh)
        with report.timing("lamps"):
            factor = lamps_.patch_direct(surface, mesh, lamps, len(opt.lamps), n_points=32)

        group = surface.group[mesh.side // 2]
        diagonal = surface.local.diagonal
        area = surfaces.group_areas(surface) * diagonal**2
        factors = factors_file.FormFactors(mesh, rows, factor, tuple(opt.lamps), group, model.groups, area, diagonal)
        describe(report, factors, surface, model)
        factors_file.write(opt.formfactors, factors)


def rows_by(opt, surface, mesh):
    """FormFactorRows between the patches, by opt.method."""
    from lib.light import form_factors

    try:
        if opt.method == "hemicube":
            from lib.light import hemicube

            return hemicube.rows(surface, mesh, resolution=opt.hemicube_px)
        if opt.method == "analytic":
            from lib.light import exact_factors

            return exact_factors.rows(surface, mesh)
    except (ValueError, RuntimeError) as error:
        raise stage.BadInput(f"{opt.model}: --method {opt.method}: {error}") from None
    return form_factors.rays(surface, mesh, n_rays=opt.rays, progress=stage.Bar("form factors"))


def describe(report, factors, surface, model):
    """What the user should know of the factors."""
    import numpy as np

    from lib.light import outside
    from lib.light import surface as surfaces
    from lib.light.balance import spectral_radius

    rows = factors.rows
    report["patches"] = len(factors.mesh)
    report["occluders"] = surface.n_occluders
    report["solids"] = int(np.unique(surface.object[np.flatnonzero(surface.inside) // 2]).size)
    lids = surfaces.lids(surface)
    report["lids"] = {"count": len(lids), "objects": [model.objects[thing] for thing in np.unique(lids)]}
    report["rays"] = int(rows.shot.sum())
    sums = rows.row_sums
    report["patches_that_see_nothing"] = int((sums == 0).sum())  # in a solid, or lying on another facet
    sums = sums[sums > 0]
    closed = "1 in a closed scene, before any normalisation"
    report.error("row_sum.max_excess", float(max(sums.max() - 1, 0)), unit="1", against=closed)
    report.error("row_sum.largest_opening", float(max(1 - sums.min(), 0)), unit="1", against="0 in a closed scene")
    if (opening := outside.openings_to_light(factors).max(initial=0.0)) > outside.LEAST:
        report.warning(
            f"the model is open: {100 * opening:.0f} % of the light of the most open patch leaves; what is not "
            "modelled behind the camera is missing, but for an even glow where the photograph tells of one"
        )
    radius = spectral_radius(rows.matrix() @ factors.subcell)
    report.error("balance.spectral_radius", radius, unit="1", against="the largest row sum, so that light dies away")
    report.error("rays.lost", float(rows.lost.sum() / max(rows.shot.sum(), 1)), unit="1", against="0")
    report.error("reciprocity.rms", reciprocity(factors), unit="sigma of the sampling", against="A_i F_ij = A_j F_ji")


def reciprocity(factors):
    """Root mean square of A_i F_ij - A_j F_ji over the standard deviation that ray counts allow."""
    import numpy as np

    A = factors.area
    F = factors.rows.matrix()
    n = np.maximum(factors.rows.valid, 1)
    K = F.multiply(A[:, None]).tocsr()
    S = (K + K.T).tocsr()
    row = np.repeat(np.arange(len(A)), np.diff(S.indptr))
    column = S.indices
    difference = np.asarray((K - K.T).tocsr()[row, column]).ravel()
    p = S.data / 2
    variance = p * (A[row] / n[row] + A[column] / n[column])  # of counts: A_i^2 F_ij / n_i
    return float(np.sqrt(np.mean(difference**2 / np.maximum(variance, 1e-300)))) if len(p) else 0.0


if __name__ == "__main__":
    stage.run(main, options())
