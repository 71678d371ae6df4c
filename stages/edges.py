#!/usr/bin/env python3
"""§2.4 The photograph's edges before the light: camera, principal point and objects where they stand elsewhere.

    $ stages/edges.py --model model.obj --camera left.posed.cameramodel --photograph left.png --lamps '["lamp"]' \
          --edges edges.json --camera-out refined.cameramodel --model-out refined.glb --report edges.report.json

reads   model, camera, photograph
        lamps           groups that emit: an object with one is a lamp that stands elsewhere
        explain         causes that may be taken;  curve: of the camera, where scene.yaml tells one
writes  edges           what stands elsewhere and how surely, how surely the rest stands, and how far edges were off
        camera-out, model-out: with what was found, only as far as they are not as given, and only if all of it may be
                        taken; all that follows uses these. Without both options nothing is taken
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__,
        reads="model camera photograph",
        may_read="curve",
        refined="camera model",
        writes="edges",
        may_write="camera_out model_out",
    )
    parser.add_argument("--lamps", type=stage.json_option, default=[], help="groups that emit")
    parser.add_argument("--explain", type=stage.json_option, help="causes that may be taken; default: all")
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            from lib.analysis.seen import places  # noqa: F401  it takes most of the time
            from lib.given import edges_file
        with report.timing("read"):
            view = read(opt.camera, opt.model, opt)
        with report.timing("register"):
            found = looked(view, opt.lamps)
            better = found.refined(view, opt.explain) if opt.camera_out and opt.model_out else None
        refined = None
        if better is not None:  # asked again from the files: they have what all that follows reads
            better.write(opt.camera_out, opt.model_out)
            with report.timing("register again"):
                paths = ((better.camera, opt.camera_out, opt.camera), (better.model, opt.model_out, opt.model))
                again = read(*(given if made is None else out for made, out, given in paths), opt)
                refined = looked(again, opt.lamps).told
        edges = edges_file.Edges(found.told, refined)
        report.status = edges.status
        for why in edges.given.why if refined is not None else ():
            report.note(f"put right: {why.text}")
        edges_file.write(opt.edges, edges)


def read(camera, model, opt):
    """The photograph with a camera and a model, under the curve that scene.yaml tells."""
    from lib.given import materials
    from lib.given.view import View

    view = View.read(camera=camera, model=model, photograph=opt.photograph)
    return view.under_one_curve(materials.read_curve(opt.curve)) if opt.curve else view


def looked(view, lamps):
    """What the edges say. Values of 12 bits in a file of 16 are not looked at: the user is told to scale them."""
    from lib.analysis.seen.places import Places, by_edges
    from lib.given.white_level import is_twelve_bits

    shown = view.photograph
    return Places(None, [], []) if is_twelve_bits(shown.values, shown.linear) else by_edges(view, lamps)


if __name__ == "__main__":
    stage.run(main, options())
