#!/usr/bin/env python3
"""The errors against truth, and what every stage says of itself, in one scorecard.

    $ stages/compare.py --scene office --reports build/office/*.report.json --materials build/office/materials.json \
          --truth data/office/truth/ --scorecard scorecard.csv --comparison compare.json --report compare.report.json

reads   reports       <stage>.report.json, in the order of the pipeline
        materials, scores (rendered.json), group, object, depth, legend      what came out; each may be missing
        lens, camera, posed, lens_right, camera_right, calibration, regions, facets, pose, model      of the vision half, likewise
        truth         a folder: materials.json group.png object.png depth.exr legend.json left.cameramodel right.cameramodel
                      left.posed.cameramodel calibration.json disparity.png textures.json, each as it may be there.  No other stage reads it
        and the textures that materials and truth name
writes  scorecard     scene,stage,error,value,unit,against,wall_s,cpu_s,peak_mb,status
        comparison    the same errors, and per group and channel the value, the truth, their difference in sigmas
"""
import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
from lib import stage


VISION = ("model", "calibration", "lens", "lens_right", "camera", "camera_right", "posed", "regions", "facets", "pose")


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="scene", help="its name")
    parser.add_argument("--reports", nargs="*", default=[])
    for name in ("group", "object", "facet", "legend", "depth", "materials", "rendered", "exr", "scores", "truth", *VISION):
        parser.add_argument(f"--{name.replace('_', '-')}")
    for name in ("scorecard", "comparison"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--report")
    return parser


def seen(opt, true, images):
    """(found, true) of the vision half, for vision_errors; nothing is read where truth has nothing to say of it."""
    from lib import artefact, cameras, image, lenses, model
    import numpy as np

    truths = {"lens": "left.cameramodel", "lens_right": "right.cameramodel", "posed": "left.posed.cameramodel", "calibration": "calibration.json"}
    readers = {"model": model.load, "calibration": artefact.read_json, "facets": artefact.read_json, "pose": artefact.read_json, "regions": image.read_labels,
               "lens": lenses.read, "lens_right": lenses.read, **dict.fromkeys(("camera", "camera_right", "posed"), cameras.read_cameramodel)}
    known = {name: readers[name](true[file]) for name, file in truths.items() if file in true}
    if "disparity" in true:
        scale = artefact.read_json(true["disparity.json"])
        grey = image.read_labels(true["disparity"])
        known["disparity"] = np.where(grey == scale["unknown"], np.nan, grey * scale["px_per_grey"])
    if not known:
        return {}, {}
    return {**images, **{name: readers[name](getattr(opt, name)) for name in VISION if getattr(opt, name)}}, known


def albedos(opt, true, report, materials, facet):
    """Ours and the true ones of textured groups, for comparing; None where there is no truth of them, or no geometry to look it up with."""
    if not (materials and facet is not None and opt.model and opt.posed and "textures.json" in true):
        return None
    with report.excluded("imports"):
        from lib import cameras, comparing, model, textures
    ours = {f: path for files in comparing.texture_files(opt.materials, materials).values() for f, path in files.items()}
    report.inputs += map(str, ours.values())
    return comparing.albedos(model.load(opt.model), cameras.read_cameramodel(opt.posed), facet, materials, {f: textures.read(path) for f, path in ours.items()},
                             comparing.read_textures(true["textures.json"]))


def main(opt):
    from lib import artefact, comparing
    from lib.report import Report

    truth = Path(opt.truth) if opt.truth else None
    if truth and not truth.is_dir():
        raise stage.BadInput(f"{truth}: there is no such folder")
    true = {p.stem if p.suffix in (".png", ".exr") else p.name: p for p in sorted(truth.iterdir()) if p.is_file()} if truth else {}
    used = [opt.group, opt.object, opt.depth, opt.legend, opt.materials, opt.scores, *opt.reports,
            *(getattr(opt, name) for name in VISION),
            *true.values()]
    with Report(opt.report, inputs=[p for p in used if p], arguments=vars(opt)) as report:
        with report.excluded("imports"):
            from lib import image, vision_errors

        def read(path, reader):
            return reader(path) if path else None

        def images(paths):
            readers = {"group": image.read_labels, "object": image.read_labels, "depth": image.read_exr}
            return {name: readers[name](path) for name, path in paths.items() if name in readers and path}

        reports = comparing.read_reports(opt.reports)
        ours, theirs = images(vars(opt)), images(true)
        legend, true_legend = read(opt.legend, comparing.read_legend), read(true.get("legend.json"), comparing.read_legend)
        for name, names, picture, where in [("group", legend, ours, opt.group), ("group", true_legend, theirs, true.get("group")),
                                            ("object", legend, ours, opt.object), ("object", true_legend, theirs, true.get("object"))]:
            if names and name in picture and picture[name].max() > len(names[name + "s"]):
                raise stage.BadInput(f"{where}: index: {picture[name].max()} is more than the {len(names[name + 's'])} {name}s of the legend")
        for name in ours.keys() & theirs.keys():
            if ours[name].shape != theirs[name].shape:
                report.warning(f"{true[name]}: {theirs[name].shape[1]} x {theirs[name].shape[0]} is not the size of {getattr(opt, name)}: not compared")
        materials, facet = read(opt.materials, comparing.read_materials), read(opt.facet, image.read_labels)
        errors, details = comparing.against_truth(
            materials=materials, truth=read(true.get("materials.json"), comparing.read_materials), reports=reports, images=ours, true_images=theirs,
            legend=legend, true_legend=true_legend, scores=read(opt.scores, artefact.read_json), albedo=albedos(opt, true, report, materials, facet))
        for name, (found, is_) in details.get("kinds", {}).items():
            report.warning(f"group {name!r} is found {found.replace('_', ' ')}; in truth it is {is_.replace('_', ' ')}")
        for place, name, value, unit in vision_errors.against_truth(*seen(opt, true, {**ours, "facet": facet})):
            errors.append({"stage": place, "name": name, "value": value, "unit": unit, "against": "truth"})
        for error in errors:
            report.error(error["name"], error["value"], unit=error["unit"], against=error["against"])
        rows = comparing.scorecard(opt.scene, reports, errors)
        with artefact.writing_all(opt.scorecard, opt.comparison) as (scorecard, comparison):
            comparing.write_scorecard(scorecard, rows)
            artefact.write_json(comparison, {"scene": opt.scene, "truth": bool(true), "enough_px": comparing.ENOUGH_PX, "errors": errors, **details})


if __name__ == "__main__":
    stage.run(main, options())
