#!/usr/bin/env python3
"""§2.3 Reconstruction: the plane of each matched pair of surfaces, with its covariance, and the surface's outline.

    $ stages/reconstruct.py --photograph left.png --photograph-right right.png \\
          --surfaces left.surfaces.png --surfaces-right right.surfaces.png --camera left.cameramodel \\
          --camera-right right.cameramodel --matches matches.csv --facets facets.json --mesh facets.ply

reads   photographs, surfaces, cameras (pinholes, extrinsics in one frame), matches
        orientation    where the pair has no scale
writes  facets         planes, polygons, covariances in the left camera's frame, and what was refused, and why
        mesh           the same to look at
The report's trace holds after each step how far borders are apart: the median over the pairs, px.
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="photograph photograph_right surfaces surfaces_right camera camera_right matches",
        may_read="orientation",
        writes="facets mesh",
    )
    parser.add_argument(
        "--method",
        choices=("least-squares", "overlap"),
        default="least-squares",
        help="borders to a part of a pixel and texture, or the paper's maximal mutual overlap of the two regions",
    )
    return parser


def main(opt):
    from lib.core.report import Note, Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late
            import mapbox_earcut  # noqa: F401

            from lib.core import artefact
            from lib.given import jpeg
            from lib.vision import facets_file, matching
            from lib.vision.facets import outlines
            from lib.vision.facets import planes as facets
            from lib.vision.matches import read_matched_labels
        with report.timing("read"):
            pair, taken, labels = matching.read_pair(
                (opt.camera, opt.camera_right),
                (opt.photograph, opt.photograph_right),
                (opt.surfaces, opt.surfaces_right),
            )
            values = matching.photographs(*taken)
            left, right = read_matched_labels(opt.matches, *labels)
            unit = facets_file.unit_of(opt.orientation)

        def trace(step, planes, apart):
            with report.excluded("measuring"):
                apart_px = apart()
            report.trace(step=step, planes=planes, borders_apart_px=apart_px)

        with report.timing("reconstruct"):
            found, refused, side_sigma_px = facets.reconstruct(
                pair,
                labels,
                values,
                left,
                right,
                ringing=[photograph.ringing for photograph in taken],
                method=opt.method,
                progress=stage.Bar("facets"),
                trace=trace,
            )

        for path, photograph in zip((opt.photograph, opt.photograph_right), taken, strict=True):
            if photograph.ringing > facets.COARSE:
                report.warning(
                    f"{path}: JPEG's steps add {100 * photograph.ringing:.1f} % of white at edges, sigmas hold up to "
                    f"{100 * facets.COARSE:.0f} % (quality 93): facets may be further off than they say"
                )
            report.about(path, [*map(Note, photograph.notes), *photograph.doubts])
            if photograph.lost_tables:
                report.warning(f"{path}: {jpeg.NO_TABLES}")
        report["facets"], report["refused"] = len(found), outlines.reasons(refused)
        report["loose"] = sum(x.loose for x in found)
        report["side_sigma_px"] = side_sigma_px
        report["covered"] = matching.share(labels[0], [x.left_label for x in found])
        report["unit"] = unit
        if not found:
            report.status = "nothing reconstructed"
            why = "; ".join(f"{n} x {reason}" for reason, n in outlines.reasons(refused).items())
            report.warning(
                f"{opt.matches}: none of its {len(left)} pairs gives a plane: {why}"
                if len(left)
                else f"{opt.matches}: no matched regions, so no planes"
            )
        else:
            report.error("border_rms", outlines.median_rms(found), unit="px", against="right borders")
            report.error("distance_sigma", outlines.median_sigma(found), unit="1", against="its own covariance")
        with artefact.writing_all(opt.facets, opt.mesh) as (partial, mesh):
            artefact.write_json(partial, facets_file.describe(found, refused, unit))
            outlines.write_ply(mesh, found, outlines.colours(labels[0], values[0], found))


if __name__ == "__main__":
    stage.run(main, options())
