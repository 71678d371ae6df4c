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
import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
from lib import stage


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("model", "camera", "photograph"):
        parser.add_argument(f"--{name}", required=True)
    for name in ("group", "object", "facet", "legend", "depth", "hidden", "trusted", "report"):
        parser.add_argument(f"--{name}")
    parser.add_argument("--method", choices=("opengl", "rays"), default="opengl", help="opengl turns to rays where there is no EGL")
    parser.add_argument("--margin-px", type=int, default=2, help="left out on each side of an edge, beyond the pixels it mixes")
    parser.add_argument("--keep", type=float, default=0.5, help="part of a facet's pixels kept, the nearest to a planar approximation")
    return parser


def main(opt):
    from lib.report import Report

    if opt.margin_px < 0:
        raise stage.BadInput(f"--margin-px: {opt.margin_px} is negative")
    if not 0 < opt.keep <= 1:
        raise stage.BadInput(f"--keep: {opt.keep} is outside (0, 1]")
    with Report(opt.report, inputs=[opt.model, opt.camera, opt.photograph], arguments=vars(opt)) as report:
        with report.excluded("imports"):
            import cv2                                             # noqa: F401  where lib/ imports late
            import numpy as np
            import scipy.sparse.csgraph                            # noqa: F401
            from lib import artefact, cameras, image, index_buffer, model as models

        with report.timing("read"):
            model = models.load(opt.model)
            camera = cameras.read_cameramodel(opt.camera)
            photograph = image.read_photograph(opt.photograph)
        size = photograph.values.shape[1::-1]
        if size != (camera.width, camera.height):
            raise stage.BadInput(f"{opt.photograph}: size: {size[0]} x {size[1]} is not the camera's {camera.width} x {camera.height} ({opt.camera})")
        if model.n_facets > 65535:
            raise stage.BadInput(f"{opt.model}: facets: {model.n_facets} are more than the 65535 that facet.png can hold")
        for warning in model.warnings:
            report.warning(f"{opt.model}: {warning}")

        with report.timing("draw"):
            index = draw(model, camera, opt.method, report)
        with report.timing("edges"):
            hidden = index_buffer.visible_edges(model, camera, index.facet, index.depth)
        with report.timing("trust"):
            trust = index_buffer.trusted(photograph, index.facet, hidden, model.facet_group, margin_px=opt.margin_px, keep=opt.keep)

        group, thing = (np.append(of_facet + 1, 0)[index.facet] for of_facet in (model.facet_group, model.facet_object))
        seen, used = (np.bincount(group[where], minlength=len(model.groups) + 1)[1:] for where in (group > 0, trust.mask))
        report["method"] = index.method
        report["pixels"] = trust.left
        report["groups"] = {name: {"seen": int(s), "trusted": int(u)} for name, s, u in zip(model.groups, seen, used)}
        if not seen.any():
            report.status = "nothing seen"
            report.warning(f"{opt.camera}: no pixel shows the model")

        legend = {"groups": model.groups, "objects": model.objects,
                  "facets": np.column_stack([model.facet_object, model.facet_group])}
        write = {"group": lambda path: image.write_png16(path, group), "object": lambda path: image.write_png16(path, thing),
                 "facet": lambda path: image.write_png16(path, index.facet + 1), "legend": lambda path: artefact.write_json(path, legend),
                 "depth": lambda path: image.write_exr(path, index.depth, name="Z"),
                 "hidden": lambda path: image.write_png8(path, hidden), "trusted": lambda path: image.write_png8(path, trust.mask)}
        wanted = {name: getattr(opt, name) for name in write if getattr(opt, name)}
        with report.timing("write"), artefact.writing_all(*wanted.values()) as partials:
            for name, partial in zip(wanted, partials):
                write[name](partial)


def draw(model, camera, method, report):
    from lib import index_buffer

    if method == "opengl":
        try:
            with report.excluded("imports"):
                import moderngl                                    # noqa: F401
            return index_buffer.draw(model, camera)
        except (ImportError, index_buffer.NoGraphics) as error:
            report.warning(f"no OpenGL ({error}): rays instead")
    with report.excluded("imports"):
        import open3d                                              # noqa: F401
    return index_buffer.reference(model, camera)


if __name__ == "__main__":
    stage.run(main, options())
