#!/usr/bin/env python3
"""A first look at a scene, a second long: does the model lie over the photograph, and what is doubtful?

    $ stages/check.py --model model.obj --camera left.posed.cameramodel --photograph left.png --lamps '["lamp"]' \
          --findings check.json --picture check.png --report check.report.json

reads   model, camera, photograph
        edges           what the photograph's edges say of them
        lamps           groups that emit;  up: which axis of the model is up
writes  findings        status: good, or doubtful; findings: about, text, doubt
        picture         the edges of the model over the photograph: the best check of a pose
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(__doc__, reads="model camera photograph", may_read="edges", writes="findings picture")
    parser.add_argument("--lamps", type=stage.json_option, default=[], help="groups that emit")
    parser.add_argument("--up", type=stage.json_option, default='"z"', help="x, y, z, -x, -y or -z")
    return parser


def main(opt):
    from lib.core.report import Note, Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            from lib.buffers import edges, first_look, index_buffer, model_checks, opengl
            from lib.core import artefact, packages
            from lib.given import edges_file, image
            from lib.given.view import View
            from lib.planning import compiling

        with report.timing("read"):
            view = View.read(camera=opt.camera, model=opt.model, photograph=opt.photograph)
            of_edges = first_look.of_edges(edges_file.read(opt.edges)) if opt.edges else []
        with report.timing("draw"):
            try:
                index = index_buffer.draw(view.model, view.camera)
            except (ImportError, opengl.NoGraphics):
                packages.open3d()
                index = index_buffer.reference(view.model, view.camera)
        with report.timing("look"):
            found = first_look.findings(
                view.model,
                view.camera,
                view.photograph,
                index.facet,
                opt.lamps,
                opt.up,
                image.orientation(opt.photograph),
            )
            if more := compiling.of_photometry():
                found[-1] = found[-1]._replace(text=f"{found[-1].text}, {more}")  # the cost
            found += of_edges
            lines = (*view.model.warnings, *model_checks.findings(view.model, view.camera, index.facet))
            found += [first_look.Finding("model", line, False) for line in view.model.notes]
            found += [first_look.Finding("model", line, not isinstance(line, Note)) for line in lines]
            segments = edges.wireframe(view.model, view.camera, index.facet, index.depth)
        print(f"  look first: {opt.picture}")
        doubts = sum(finding.doubt for finding in found)
        report.status = "doubtful" if doubts else "good"
        for finding in found:
            print(f"{'!' if finding.doubt else ' '} {finding.about}: {finding.text}")
        content = {"status": report.status, "findings": [finding._asdict() for finding in found]}
        with artefact.writing_all(opt.findings, opt.picture) as (findings, picture):
            artefact.write_json(findings, content)
            image.write_png8(picture, first_look.over(view.photograph, segments))


if __name__ == "__main__":
    stage.run(main, options())
