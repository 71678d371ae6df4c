#!/usr/bin/env python3
"""One page to look at: report.html, self-contained.

    $ stages/report.py --scene office --photograph left.png --rendered rendered.png --materials materials.json \
          --reports build/office/*.report.json --page report.html --report report.report.json

reads   photograph, rendered, group, object, facet, hidden, trusted, depth, legend, materials, scores, comparison, reports;
        of a pair: photograph, regions, camera (of the pair's frame) and those of the right side; matches, facets, pose, calibration,
        orientation, model; each may be missing, and so is its section then.  Also the textures that materials.json names, and plan.mk
        beside the page: what was left out, and why
writes  page          HTML with everything in it, below 6 MB
"""
import argparse
import re
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
from lib import stage

FILES = ("photograph", "group", "object", "facet", "legend", "depth", "trusted", "hidden", "materials", "rendered", "difference", "scores", "scorecard", "comparison",
         "photograph_right", "regions", "regions_right", "camera", "camera_right", "matches", "facets", "pose", "calibration", "orientation", "model")


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="scene", help="its name")
    parser.add_argument("--transfer", type=stage.json_option, help="what scene.yaml says of it")
    for name in FILES:
        parser.add_argument(f"--{name.replace('_', '-')}")
    parser.add_argument("--reports", nargs="*", default=[])
    parser.add_argument("--page", required=True)
    parser.add_argument("--report")
    return parser


def left_out(plan):
    """[(stage, why)] from the head of plan.mk."""
    if not plan.is_file():
        return []
    head = plan.read_text(encoding="utf-8", errors="replace").partition("\n\n")[0]
    return re.findall(r"^#   without ([\w-]+): (.*)$", head, re.MULTILINE)


def see(opt, read, shown):
    """What there is of the vision half: vision_page.Vision, or None."""
    from lib import artefact, cameras, image, model, vision_page

    if not any(getattr(opt, name) for name in ("regions", "facets", "pose", "calibration")):
        return None

    def pair(name, reader):
        return {side: read(option, reader) for side, option in zip(vision_page.SIDES, (name, f"{name}_right")) if getattr(opt, option)}

    files = {name: read(name, artefact.read_json) for name in ("facets", "pose", "calibration", "orientation")}
    return vision_page.see(photographs=pair("photograph", lambda path: shown(image.read_photograph(path))), regions=pair("regions", image.read_labels),
                           cameras=pair("camera", cameras.read_cameramodel), matches=read("matches", artefact.read_matches),
                           model=read("model", model.load) if opt.pose else None, **files)


def albums(opt, report, materials):
    """{group: {facet: thumbnail}} of the textures that materials.json names."""
    from lib import comparing, ladder_page

    files = comparing.texture_files(opt.materials, materials) if materials else {}
    if not files:
        return None
    with report.excluded("imports"):
        from lib import textures
    report.inputs += [str(path) for some in files.values() for path in some.values()]
    return {group: {facet: ladder_page.thumbnail(textures.read(path)) for facet, path in some.items()} for group, some in files.items()}


def main(opt):
    from lib.report import Report

    inputs = [getattr(opt, name) for name in FILES] + opt.reports
    with Report(opt.report, inputs=inputs, arguments=vars(opt)) as report:
        with report.excluded("imports"):
            import cv2                                             # noqa: F401  where lib/ imports late
            from lib import artefact, comparing, image, page

        def read(name, reader):
            return reader(getattr(opt, name)) if getattr(opt, name) else None

        def shown(picture):
            return picture.values.clip(0, 1) ** (1 / 2.2) if picture.linear else picture.values

        photograph = read("photograph", image.read_photograph)
        values = None if photograph is None else shown(photograph)
        rendered = read("rendered", image.read_photograph)
        trusted, hidden = (read(name, image.read_labels) for name in ("trusted", "hidden"))
        materials = read("materials", comparing.read_materials)
        text = page.build(page.Parts(
            scene=opt.scene, photograph=values, linear=bool(photograph and photograph.linear), rendered=rendered and rendered.values,
            **{name: read(name, image.read_labels) for name in ("group", "object", "facet")}, depth=read("depth", image.read_exr),
            trusted=None if trusted is None else trusted > 0, hidden=None if hidden is None else hidden > 0,
            legend=read("legend", comparing.read_legend), materials=materials, textures=albums(opt, report, materials),
            scores=read("scores", artefact.read_json), comparison=read("comparison", artefact.read_json),
            reports=comparing.read_reports(opt.reports), plan=left_out(Path(opt.page).parent / "plan.mk"), vision=see(opt, read, shown)))
        report["bytes"] = len(text.encode())
        with artefact.writing(opt.page) as partial:
            Path(partial).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    stage.run(main, options())
