#!/usr/bin/env python3
"""A new scene's folder: make new-scene NAME=x MODEL=f PHOTO=f [CAMERA=f] [IMAGE=name] [PICKS=f] [MEGAPIXELS=n]

    $ stages/new_scene.py --data data --name attic --model attic.ply --photo IMG_1.jpeg --camera attic.fspy

writes  data/attic/     left.*, model.obj or .glb, scene.yaml with comments, left.posed.cameramodel or left.cameramodel:
                        whole, or not at all. Says what is missing, and what looks like another unit or axis

CAMERA: mrcal, COLMAP (its folder, text or binary), fSpy, Blender (docs/blender_camera.py), OpenCV and ROS (YAML, JSON,
XML), nerfstudio, Kalibr, EuRoC, ORB-SLAM, VINS; others are refused by name.  IMAGE names the photograph in COLMAP's or
nerfstudio's reconstruction, or the camera of several (left, cam0).  PICKS: corners of the model picked in the
photograph, x_px,y_px,X,Y,Z (pose.csv); X, Y, Z may be the model file's own numbers, or as Blender shows them.
MEGAPIXELS: that the photograph keeps at most (4); a larger one is made smaller, with its camera and picks.
MODEL: OBJ, GLB, glTF, PLY, STL, Mitsuba's XML.
"""

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default="data")
    for name in ("name", "model", "photo", "camera", "image", "picks", "megapixels"):
        parser.add_argument(f"--{name}", default="")
    return parser


def main(opt):
    from lib.buffers.opengl import NoGraphics
    from lib.given import new_scene
    from lib.planning.plan import TARGETS
    from lib.planning.rules import NAME

    missing = [name.upper() for name in ("name", "model", "photo") if not getattr(opt, name)]
    if missing:
        how = "make new-scene NAME=attic MODEL=attic.obj PHOTO=attic.jpg [CAMERA=attic.fspy] [PICKS=points.csv]"
        raise stage.BadInput(f"{', '.join(missing)}: missing: {how}")
    if not NAME.fullmatch(opt.name) or opt.name in TARGETS:
        raise stage.BadInput(f"NAME: {opt.name}: letters, digits, _ and - alone, and no target of the Makefile")
    try:
        megapixels = float(opt.megapixels) if opt.megapixels else None
    except ValueError:
        megapixels = 0.0
    if megapixels is not None and not 1e-4 <= megapixels <= 1000:
        raise stage.BadInput(f"MEGAPIXELS: {opt.megapixels}: is no number from 0.0001 to 1000")
    folder = Path(opt.data) / opt.name
    if folder.exists():
        raise stage.BadInput(f"NAME: {folder}: is there already")
    files = {"MODEL": opt.model, "PHOTO": opt.photo, "CAMERA": opt.camera, "PICKS": opt.picks}
    absent = [
        f"{key}: {path}: there is no such file" for key, path in files.items() if path and not Path(path).exists()
    ]
    if absent:
        raise stage.BadInput(*absent)

    def seen(*view):
        from lib.vision.registration.mistakes import seen_best

        try:
            return seen_best(*view)
        except (ImportError, NoGraphics):
            return None

    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".new-") as partial:
        made = Path(partial) / opt.name
        made.mkdir()
        try:
            said = new_scene.make(
                made, opt.model, opt.photo, opt.camera or None, opt.image or None, opt.picks or None, megapixels, seen
            )
        except stage.BadInput as bad:
            raise stage.BadInput(*(line.replace(f"{made}/", "") for line in bad.problems)) from None
        shutil.move(made, folder)
    print(*said, sep="\n")
    print(f"{folder}: look at scene.yaml, then: make {opt.name}/check")


if __name__ == "__main__":
    stage.run(main, options())
