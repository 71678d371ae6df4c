#!/usr/bin/env python3
"""One page to look at: report.html, self-contained.

    $ stages/report.py --scene office --photograph left.png --rendered rendered.png --materials materials.json \
          --reports build/office/*.report.json --page report.html --report report.report.json

reads   photograph, rendered, group, object, facet, hidden, trusted, depth, legend, materials, scores, comparison,
        reports; posed: the camera in the model's frame; of a pair: photograph, regions, surfaces, camera (of the
        pair's frame) and those of the right side;
        matches, facets, pose, calibration, orientation, model; poses, photos: of further photographs; what was
        exported. Each may be missing, and so is its section then. Also the textures that materials.json names, and
        plan.mk beside the page: what was left out, and why
writes  page          HTML with everything in it, below 6 MB
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage

FILES = (
    "photograph group object facet legend depth trusted hidden materials rendered difference scores scorecard "
    "comparison posed photograph_right regions regions_right surfaces surfaces_right camera camera_right matches "
    "facets calibration orientation model poses photos gltf mitsuba radiance usd colmap blender"
)


def options():
    parser = stage.parser(__doc__, may_read=FILES, may_lack="pose", writes="page", refined="camera model")
    parser.add_argument("--scene", default="scene", help="its name")
    parser.add_argument("--transfer", type=stage.json_option, help="what scene.yaml says of it")
    parser.add_argument("--reports", nargs="*", default=[])
    parser.add_argument("--changed", nargs="*", default=[], help="augmented.<name>.png, or .mp4 of a sequence")
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt, [*opt.reports, *opt.changed]) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late
            import jinja2  # noqa: F401

            from lib.core import artefact
            from lib.verdict.page import build, exports, parts

        with report.timing("parts"):
            content = parts.read(vars(opt), opt.scene, opt.reports, opt.page, opt.changed)
        with report.timing("textures"):
            content.thumbnails = thumbnails(opt, report, content.materials)
        if opt.gltf:
            with report.timing("view"):
                content.view = exports.viewer(opt.gltf)
        with report.timing("page"):
            text = build.page(content)
        report["bytes"] = len(text.encode())
        with artefact.writing(opt.page) as partial:
            Path(partial).write_text(text, encoding="utf-8")


def thumbnails(opt, report, materials):
    """{group: {facet: Thumbnail}} of the textures that materials.json names."""
    files = materials.texture_files(opt.materials) if materials else {}
    if not files:
        return {}
    with report.excluded("imports"):
        from lib.picture import albedo_maps
        from lib.verdict.page import ladder
    report.inputs += [str(path) for of_group in files.values() for path in of_group.values()]
    return {
        group: {facet: ladder.thumbnail(albedo_maps.read(path)) for facet, path in of_group.items()}
        for group, of_group in files.items()
    }


if __name__ == "__main__":
    stage.run(main, options())
