#!/usr/bin/env python3
"""§2.4 Which part of the model the facets show, from where; the pose is then refined on the edges of both photographs.

    $ stages/recognise.py --facets facets.json --model model.obj --photograph left.png --photograph-right right.png \
          --surfaces left.surfaces.png --surfaces-right right.surfaces.png \
          --camera left.cameramodel --camera-right right.cameramodel \
          --posed left.posed.cameramodel --posed-right right.posed.cameramodel --pose pose.json \
          --report recognise.report.json

reads   facets, model; photographs, their surfaces and their pinhole cameras in the pair's frame
        orientation      the pair has no scale: the model gives it
        calibration      how well the cameras' projections are known
        movable          objects of the model that may be elsewhere, or nowhere: the pose is that of the others
writes  posed, posed-right   the cameras in the model's frame
        pose            rt_cam_world; its covariance (6, 6) of (omega, tau): T = exp(omega, tau) T_hat along the left
                        camera's axes, rad and m; matches, trace; status: unique, ambiguous or symmetric, with the
                        other poses in ambiguous
"""

import sys
import time
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="facets model photograph photograph_right surfaces surfaces_right camera camera_right",
        may_read="orientation calibration",
        writes="posed posed_right pose",
    )
    parser.add_argument(
        "--method",
        choices=("edges", "paper"),
        default="edges",
        help="of the refinement: edges at sub-pixel by a trust region, or the paper's gradient on vertices",
    )
    parser.add_argument("--movable", type=stage.json_option, default=[], help="names of objects that are left out")
    parser.add_argument(
        "--lens-px",
        default="auto",
        help="how well the cameras' own projections are known, px: it goes into the covariance; "
        "auto: by the calibration, else 0.1",
    )
    return parser


LENS_PX = 0.1  # one sigma of a projected pixel where nobody says it


def known_px(word, calibration):
    """One sigma of a projected pixel: the number given, or what calibration.json (or None) says of it."""
    if word != "auto":
        try:
            return float(word)
        except ValueError:
            raise stage.BadInput(f"--lens-px: {word!r} is neither a number nor auto") from None
    if not calibration:
        return LENS_PX
    from_focal = [c["sigma"] / c["fx"] * max(c["size"]) / 2 for c in calibration["cameras"].values() if c.get("sigma")]
    return max([calibration.get("good_to_px") or LENS_PX, *from_focal])


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late

            from lib.core import artefact
            from lib.given import model as models
            from lib.given.model import parts
            from lib.vision import facets_file
            from lib.vision.corners import answer
            from lib.vision.refinement import rig
        with report.timing("read"):
            model = models.load(opt.model)
            scene = facets_file.read_scene(opt.facets)
            sides = [
                rig.Side.read(opt.camera, opt.photograph, opt.surfaces),
                rig.Side.read(opt.camera_right, opt.photograph_right, opt.surfaces_right),
            ]
            calibration = artefact.read_json(opt.calibration) if opt.calibration else None
        if opt.movable:
            if not set(model.objects) - set(opt.movable):
                raise stage.BadInput(f"{opt.model}: objects: all are movable, and nothing is left to tell the pose")
            model = parts.without(model, opt.movable)
        if (scene.unit == "baseline") != bool(opt.orientation):
            raise stage.BadInput(
                f"{opt.facets}: unit: {scene.unit!r}, but an orientation is "
                f"{'given' if opt.orientation else 'missing'}: the cameras and the facets disagree about the scale"
            )
        lens_px = known_px(opt.lens_px, calibration)

        zero = [
            now - past for now, past in zip((time.process_time(), time.perf_counter()), report.clocks(), strict=True)
        ]
        found, result, denied, why = answer.answer(
            scene, model, sides, timing=report.timing, method=opt.method, lens_px=lens_px
        )
        report["search"], report["evidence_nats"] = found.counts, [pose.score for pose in found.poses]
        report["facets_denied"] = list(denied)
        if why:
            raise stage.BadInput(f"{opt.facets}: facets: {why}")
        tell(report, opt, found, result, zero)
        write(opt, scene, found, result)


def tell(report, opt, found, result, zero):
    """Trace, errors, warnings and status. zero : [CPU s, wall s] of the process's clocks where the report's are 0"""
    from lib.vision.refinement import words

    report.status = result.status
    for step in result.trace:
        point = {key: value for key, value in step.items() if key != "rt_cam_world"}
        report.trace(**point | {"cpu_s": step["cpu_s"] - zero[0], "wall_s": step["wall_s"] - zero[1]})
    report.error("edges", result.rms_px, unit="px", against="sub-pixel edges of the photographs")
    report["edges_found"], report["edges_found_by_chance"] = result.support, result.chance
    for name, text in words.warnings(found, result):
        report.warning(f"{getattr(opt, name)}: {text}")


def write(opt, scene, found, result):
    """The posed cameras, and pose.json."""
    from lib.core import artefact
    from lib.given import cameras

    clocks = ("cpu_s", "wall_s")
    content = {
        "status": result.status,
        "rt_cam_world": cameras.rt_from_matrix(result.cameras[0].T_cam_world),
        "scale": result.scale if scene.unit == "baseline" else None,
        "covariance": result.covariance,
        "perturbation": "T = exp(omega, tau) T_hat, left camera's axes, rad and m",
        "matches": [
            {"left_label": int(scene.labels[i, 0]), "facet": int(f)} for i, f in found.poses[result.chosen].matches
        ],
        "trace": [{key: value for key, value in step.items() if key not in clocks} for step in result.trace],
        "ambiguous": result.ambiguous,
    }
    with artefact.writing_all(opt.posed, opt.posed_right, opt.pose) as (*posed, pose):
        for path, camera in zip(posed, result.cameras, strict=True):
            cameras.write_cameramodel(path, camera)
        artefact.write_json(pose, content)


if __name__ == "__main__":
    stage.run(main, options())
