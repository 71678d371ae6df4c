#!/usr/bin/env python3
"""The errors against truth, and what every stage says of itself, in one scorecard.

    $ stages/compare.py --scene office --reports build/office/*.report.json --materials build/office/materials.json \
          --truth data/office/truth/ --scorecard scorecard.csv --comparison compare.json --report compare.report.json

reads   reports       <stage>.report.json, in the order of the pipeline
        materials, scores (rendered.json), group, object, depth, legend, mirror    what came out; each may be missing
        lens, camera, posed, lens_right, camera_right, calibration, surfaces, facets, pose, model     likewise
        poses         photos.json, likewise
        truth         a folder: materials.json group.png object.png mirror.png depth.exr legend.json left.cameramodel
                      right.cameramodel left.posed.cameramodel calibration.json disparity.png textures.json photos.json
                      (rt_cam_world, null where none is right), each of which may be there. No other stage reads it
        and the textures that materials and truth name
writes  scorecard     scene,stage,error,value,unit,against,wall_s,cpu_s,peak_mb,status
        comparison    the same errors, and per group and channel the value, the truth, their difference in sigmas
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage

FILES = "group object facet legend depth materials rendered exr scores truth"
VISION = "model calibration lens lens_right camera camera_right posed surfaces facets poses"


def options():
    parser = stage.parser(
        __doc__, may_read=f"{FILES} {VISION}", may_lack="mirror pose", writes="scorecard comparison", refined="model"
    )
    parser.add_argument("--scene", default="scene", help="its name")
    parser.add_argument("--reports", nargs="*", default=[])
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt, opt.reports) as report:
        with report.excluded("imports"):
            from dataclasses import replace

            from lib.core import artefact, record
            from lib.verdict import answers, comparing, scorecard, stage_reports

        reports = stage_reports.read_all(opt.reports)
        files = answers.truth_files(opt.truth)
        report.inputs += map(str, files.values())
        true = answers.read_truth(files)
        found = answers.read_found(vars(opt), true)
        for name in answers.of_another_size(found, true):
            (H, W), path = getattr(true, name).shape[:2], Path(opt.truth, answers.TRUE_FILES[name])
            report.warning(f"{path}: {W} x {H} is not the size of {getattr(opt, name)}: not compared")
        comparison = comparing.compare(found, true, reports, true_and_found_albedo(opt, report, found, files))
        for name, (kind, true_kind) in (comparison.kinds or {}).items():
            words = (kind.replace("_", " "), true_kind.replace("_", " "))
            report.warning(f"group {name!r} is found {words[0]}; in truth it is {words[1]}")
        for error in comparison.errors:
            report.error(error.name, error.value, unit=error.unit, against=error.against)
        with artefact.writing_all(opt.scorecard, opt.comparison) as (table, details):
            scorecard.write(table, scorecard.rows(opt.scene, reports, comparison.errors))
            artefact.write_json(details, record.plain(replace(comparison, scene=opt.scene, truth=bool(files))))


def true_and_found_albedo(opt, report, found, files):
    """Of the textured groups, by pixel; None where truth has none, or where no camera and model tell its place."""
    if not (found.materials and found.facet is not None and opt.model and opt.posed and "textures.json" in files):
        return None
    with report.excluded("imports"):
        from lib.verdict import texture_errors
    maps = found.materials.texture_files(opt.materials)
    report.inputs += [str(path) for of_group in maps.values() for path in of_group.values()]
    return texture_errors.read_albedos(opt.model, opt.posed, found, maps, files["textures.json"])


if __name__ == "__main__":
    stage.run(main, options())
