#!/usr/bin/env python3
"""The model in metres, where scene.yaml says that it was drawn in another unit. Never turned.

    $ stages/units.py --model model.obj --unit '"mm"' --metres model.metres.glb --report units.report.json

reads   model     .obj or .glb
writes  metres    .glb: the same objects and groups; its facets are numbered anew, and count from here on
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage
from lib.given.units import METRES


def options():
    parser = stage.parser(__doc__, reads="model", writes="metres")
    parser.add_argument("--unit", type=stage.json_option, required=True, help=", ".join(METRES))
    return parser


def main(opt):
    from lib.core.report import Note, Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            from lib.given import model as models
            from lib.given.model.glb_writer import write_glb

        if opt.unit not in METRES:
            raise stage.BadInput(f"--unit: {opt.unit!r} is none of {', '.join(METRES)}")
        model = models.load(opt.model, metres=METRES[opt.unit])
        report.about(opt.model, [*model.warnings, *map(Note, model.notes)])
        report["size_m"] = (model.vertices.max(axis=0) - model.vertices.min(axis=0)).tolist()
        write_glb(opt.metres, model)


if __name__ == "__main__":
    stage.run(main, options())
