#!/usr/bin/env python3
"""§2.4 Local recognition: movable objects each with a pose of their own, and a model improved from the photographs.

    $ stages/place.py --model model.obj --camera left.posed.cameramodel --photograph left.png \
          --photograph-right right.png --camera-right right.posed.cameramodel --camera-pose pose.camera.json \
          --movable '["chair"]' --posed-model model.posed.glb --pose pose.json --report place.report.json

reads   model         every object at its drawn place
        camera, photograph            of the left side, posed; and of the right one, where there is one
        camera-pose   pose of the cameras, as `recognise` wrote it; without it the pose counts as exact
        objects       a folder of movable objects that are not in the model
writes  posed-model   .glb: the model with movable and refined objects at their places, absent ones left out; facets,
                      objects and groups keep their numbers, those of objects/ come last
        pose          as camera-pose, and `objects`: {name: {rt_world_object, covariance, found}}; found: true, false
                      (absent) or null (the photographs cannot tell); covariance (6, 6) of (omega, tau):
                      T = exp(omega, tau) T_hat along the world's axes, rad and m
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="model camera photograph",
        may_read="photograph_right camera_right objects",
        may_lack="camera_pose",
        writes="posed_model pose",
    )
    parser.add_argument("--movable", type=stage.json_option, default=[], help="names of objects of the model")
    parser.add_argument(
        "--refine", type=stage.json_option, default=[], help='["objects"]: the others may be moved, too'
    )
    parser.add_argument("--lamps", type=stage.json_option, default=[], help="groups that emit: never moved by --refine")
    parser.add_argument(
        "--within-m",
        type=stage.real(0),
        default=1.0,
        help="along its support, from where it is drawn, that a movable object is sought",
    )
    return parser


def main(opt):
    from lib.core.report import Note, Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late

            from lib.core import artefact
            from lib.given import cameras
            from lib.given import model as models
            from lib.given.model.glb_writer import write_glb
            from lib.vision.objects import words
            from lib.vision.objects.place import place
            from lib.vision.refinement import rig
        with report.timing("read"):
            files = (opt.camera, opt.photograph), (opt.camera_right, opt.photograph_right)
            sides = [rig.Side.read(*side) for side in files if all(side)]
            model = models.load(opt.model)
            check_names(opt, model)
            things = read_objects(opt, model)
            pose = artefact.read_json(opt.camera_pose) if opt.camera_pose else None
        with report.timing("place"):
            result = place(
                model,
                sides,
                opt.movable,
                things,
                refine="objects" in opt.refine,
                fixed=opt.lamps,
                camera_covariance=pose["covariance"] if pose else None,
                within_m=opt.within_m,
            )
        report.about(opt.model, [*model.warnings, *map(Note, model.notes), *words.warnings(result)])
        report["objects"] = words.facts(result)
        content = dict(pose) if pose else given_pose(cameras, sides[0].camera)
        content["objects"] = {p.name: p.entry() for p in result.placed}
        content["objects_perturbation"] = "T = exp(omega, tau) T_hat, the world's axes, rad and m"
        with artefact.writing_all(opt.posed_model, opt.pose) as (posed_model, pose_file):
            write_glb(posed_model, result.model)
            artefact.write_json(pose_file, content)


def given_pose(cameras, camera):
    """The pose of a camera that was given: nothing is said of how well it is known."""
    return {"status": "given", "rt_cam_world": cameras.rt_from_matrix(camera.T_cam_world), "covariance": None}


def check_names(opt, model):
    for name in opt.movable:
        if name not in model.objects:
            has = ", ".join(sorted(model.objects))
            raise stage.BadInput(f"{opt.model}: movable: {name!r} names no object, the model has {has}")
    if set(opt.refine) - {"objects"}:
        raise stage.BadInput(f"--refine: {opt.refine!r}: only objects can be refined")


def read_objects(opt, model):
    """{name: Model} of the folder objects/."""
    from lib.given import model as models
    from lib.planning.files import object_files

    things = {}
    for path in object_files(Path(opt.objects)) if opt.objects else ():
        if path.stem in model.objects:
            raise stage.BadInput(f"{path}: {path.stem}: is an object of {opt.model} too")
        things[path.stem] = models.load(path)
    return things


if __name__ == "__main__":
    stage.run(main, options())
