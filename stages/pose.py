#!/usr/bin/env python3
"""The pose of one photograph as a person tells it: by picked points and lines, or by where the camera stands and looks.

    $ stages/pose.py --photograph left.png --points pose.csv --posed left.posed.cameramodel --pose pose.json \
          --report pose.report.json
    $ stages/pose.py --photograph left.png --camera '{"eye": [4, 1, 1.6], "at": [1, 3, 1], "hfov_deg": 60}' \
          --posed left.posed.cameramodel --report pose.report.json

reads   photograph      for its size
        points, lines   pose.csv, pose-lines.csv: what was picked, in the photograph as it was taken
        lens, pinhole   the camera as given, any lens, and as a pinhole; without: square pixels, the principal point in
                        the middle, the focal length unknown
        fspy, fspy_json a project of fSpy's, or its export
        model           in metres: a pose of picked places is then refined on the photograph's edges
        camera          eye, at, up, hfov_deg
writes  posed           the camera in the model's frame
        pose            of picks alone: rt_cam_world; its covariance (6, 6) of (omega, tau), T = exp(omega, tau) T_hat
                        along the camera's axes, rad and m; focal_px, focal_sigma_px; residuals: name, px, outlier;
                        status: unique, or ambiguous with the other poses
"""

import math
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="photograph",
        may_read="points lines lens pinhole fspy fspy_json model",
        writes="posed",
        may_write="pose",
    )
    parser.add_argument("--camera", type=stage.json_option, help="eye, at, up, hfov_deg, as in scene.yaml")
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            from lib.given import cameras, image

        photograph = image.read_photograph(opt.photograph)
        height, width = photograph.values.shape[:2]
        if opt.camera:
            camera = cameras.look_at(width=width, height=height, **opt.camera)
            cameras.write_cameramodel(opt.posed, camera)
        elif project := opt.fspy or opt.fspy_json:
            from lib.given import foreign_cameras

            found = foreign_cameras.read(project, (width, height), turn=image.orientation(opt.photograph))
            for line in found.said:
                report.warning(f"{project}: {line}")
            found.write(opt.posed)
        else:
            from_picks(opt, report, photograph)


def from_picks(opt, report, photograph):
    """The camera that sees the picked places, and the model's edges, where the photograph has them."""
    from lib.core import artefact
    from lib.given import cameras, lenses, model, picks
    from lib.vision import picked

    where, (height, width) = opt.points or opt.lines, photograph.values.shape[:2]
    with report.timing("read"):
        told = picks.read(opt.points, opt.lines)
        middle = cameras.Camera(cameras.intrinsics(1.2 * max(width, height), width, height), width, height, None)
        camera = cameras.read_cameramodel(opt.pinhole) if opt.pinhole else middle
        if opt.lens:
            told = told.straightened(lenses.read(opt.lens), camera)
    with report.timing("solve"):
        try:
            found = picked.solve(told, camera, focal_known=bool(opt.pinhole))
        except stage.BadInput as bad:
            raise stage.BadInput(f"{where}: {bad}") from None
    for text in picked.warnings(found, [*told.names, *told.line_names], focal_known=bool(opt.pinhole)):
        report.warning(f"{where}: {text}")
    if line := picked.misread(told, camera, bool(opt.pinhole), than=found):
        report.warning(f"{where}: {line}")
    trace = []
    if opt.model:
        with report.excluded("imports"):
            from lib.vision import picked_edges
        with report.timing("edges"):
            found, trace, why = picked_edges.refined(found, told, model.load(opt.model), photograph, bool(opt.pinhole))
        zero = (trace[0]["cpu_s"], trace[0]["wall_s"]) if trace else ()
        for step in trace:
            clocks = {"cpu_s": step.pop("cpu_s") - zero[0], "wall_s": step.pop("wall_s") - zero[1]}
            report.trace(**clocks, error_px=step["error_px"])
        if why:
            report.warning(f"{where}: {why}")
    names = [*told.names, *told.line_names]
    residuals = [
        {"name": name, "px": float(px) if math.isfinite(px) else None, "outlier": bool(out)}
        for name, px, out in zip(names, found.residual_px, found.outlier, strict=True)
    ]
    report.error("picks", found.rms_px, unit="px", against="the picked places, without outliers")
    content = {
        "status": "ambiguous" if found.rivals else "unique",
        "rt_cam_world": cameras.rt_from_matrix(found.camera.T_cam_world),
        "scale": None,
        "covariance": found.covariance,
        "perturbation": "T = exp(omega, tau) T_hat, the camera's axes, rad and m",
        "focal_px": float(found.camera.K[0, 0]),
        "focal_sigma_px": found.focal_sigma_px,
        "residuals": residuals,
        "matches": [],
        "trace": trace,
        "ambiguous": [{"rt_cam_world": cameras.rt_from_matrix(T)} for T in found.rivals],
    }
    report.status = content["status"]
    with artefact.writing_all(opt.posed, opt.pose) as (posed, pose):
        cameras.write_cameramodel(posed, found.camera)
        artefact.write_json(pose, content)


if __name__ == "__main__":
    stage.run(main, options())
