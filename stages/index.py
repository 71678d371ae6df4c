#!/usr/bin/env python3
"""§3.2, §4.5 Index buffers: what each pixel of the photograph shows, and which pixels the analysis may use.

    $ stages/index.py --model model.obj --camera left.posed.cameramodel --photograph left.png \
          --group group.png --facet facet.png --legend legend.json --trusted trusted.png --report index.report.json

reads   model         triangles, facets, objects, groups
        camera        a pinhole, posed in the model's frame
        photograph    of the camera's size; for its edges, and its black and saturated pixels
writes  group, object, facet     16-bit index + 1, 0 = nothing there (only the files that are asked for)
        legend        {"groups": [name], "objects": [name], "facets": [[object, group]]}, indices from 0
        depth         metres along z, 0 = nothing there
        hidden        the hidden-surface buffer: 255 where a visible edge of a facet runs
        trusted       255 where a pixel is used in the analysis
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import packages, stage


def options():
    parser = stage.parser(
        __doc__,
        reads="model camera photograph",
        may_write="group object facet legend depth hidden trusted",
        refined="camera model",
    )
    parser.add_argument(
        "--method", choices=("opengl", "rays"), default="opengl", help="opengl turns to rays where there is no EGL"
    )
    parser.add_argument(
        "--margin-px",
        type=stage.whole(0),
        default=2,
        help="left out on each side of an edge, beyond the pixels it mixes",
    )
    parser.add_argument(
        "--keep",
        type=stage.real(0, 1, open_low=True, open_high=False),
        default=0.5,
        help="part of a facet's pixels kept, the nearest to a planar approximation",
    )
    return parser


def main(opt):
    from lib.core.report import Note, Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  here, where it counts as an import; lib/ imports it late
            import numpy as np
            import scipy.sparse.csgraph  # noqa: F401  the same

            from lib.buffers import first_look, index_buffer, model_checks, opengl  # noqa: F401  they count as imports here; `draw` names them
            from lib.buffers.edges import visible_edges
            from lib.buffers.trust import trusted
            from lib.core import artefact
            from lib.given import image, jpeg
            from lib.given.view import View

        with report.timing("read"):
            view = View.read(camera=opt.camera, model=opt.model, photograph=opt.photograph)
            model, camera = view.model, view.camera
        if model.n_facets > 65535:
            raise stage.BadInput(
                f"{opt.model}: facets: {model.n_facets} are more than the 65535 that facet.png can hold"
            )
        with report.timing("draw"):
            index = draw(model, camera, opt.method, report)
        with report.timing("check"):
            report.about(opt.photograph, [*map(Note, view.photograph.notes), *view.photograph.doubts])
            if view.photograph.lost_tables:
                report.warning(f"{opt.photograph}: {jpeg.NO_TABLES}")
            findings = model_checks.findings(model, camera, index.facet)
            report.about(opt.model, [*model.warnings, *map(Note, model.notes), *findings])
            if (cost := first_look.cost(view.photograph.values.shape)).doubt:
                report.warning(f"{opt.photograph}: {cost.text}")
        with report.timing("edges"):
            hidden = visible_edges(model, camera, index.facet, index.depth)
        with report.timing("trust"):
            choice = {"margin_px": opt.margin_px, "keep": opt.keep}
            trust = trusted(view.photograph, index.facet, hidden, model.facet_group, **choice)

        group, thing = (np.append(of_facet + 1, 0)[index.facet] for of_facet in (model.facet_group, model.facet_object))
        count = lambda where: np.bincount(group[where], minlength=len(model.groups) + 1)[1:].tolist()
        seen, used = count(group > 0), count(trust.mask)
        report["method"] = index.method
        report["pixels"] = trust.left
        report["groups"] = {
            name: {"seen": s, "trusted": t} for name, s, t in zip(model.groups, seen, used, strict=True)
        }
        if not any(seen):
            report.status = "nothing seen"
            report.warning(f"{opt.camera}: no pixel shows the model")

        legend = {
            "groups": model.groups,
            "objects": model.objects,
            "facets": np.column_stack([model.facet_object, model.facet_group]),
        }
        write = {
            "group": lambda path: image.write_png16(path, group),
            "object": lambda path: image.write_png16(path, thing),
            "facet": lambda path: image.write_png16(path, index.facet + 1),
            "legend": lambda path: artefact.write_json(path, legend),
            "depth": lambda path: image.write_exr(path, index.depth, name="Z"),
            "hidden": lambda path: image.write_png8(path, hidden),
            "trusted": lambda path: image.write_png8(path, trust.mask),
        }
        wanted = {name: getattr(opt, name) for name in write if getattr(opt, name)}
        with report.timing("write"), artefact.writing_all(*wanted.values()) as partials:
            for name, partial in zip(wanted, partials, strict=True):
                write[name](partial)


def draw(model, camera, method, report):
    """The index buffer, by rays where there is no OpenGL."""
    from lib.buffers import index_buffer, opengl

    if method == "opengl":
        try:
            with report.excluded("imports"):
                import moderngl  # noqa: F401  here, where it counts as an import
            return index_buffer.draw(model, camera)
        except (ImportError, opengl.NoGraphics) as error:
            report.note(f"no OpenGL ({error}): rays instead")
    with report.excluded("imports"):
        packages.open3d()  # the same
    return index_buffer.reference(model, camera)


if __name__ == "__main__":
    stage.run(main, options())
