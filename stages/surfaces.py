#!/usr/bin/env python3
"""§2.1 Surfaces: regions of one or two photographs, joined where only shading parted them, cut at creases and necks.

    $ stages/surfaces.py --photograph left.png --photograph-right right.png \\
          --regions left.regions.png --regions-right right.regions.png \\
          --surfaces left.surfaces.png --surfaces-right right.surfaces.png --report surfaces.report.json

reads   photographs, regions
writes  surfaces, surfaces_right       as regions; a surface bears the smallest label of its regions, what a crease or
                                       a neck cut off one above them
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    return stage.parser(
        __doc__,
        reads="photograph regions",
        may_read="photograph_right regions_right",
        writes="surfaces",
        may_write="surfaces_right",
    )


def main(opt):
    from lib.core.report import Report

    of_right = [opt.photograph_right, opt.regions_right, opt.surfaces_right]
    if any(path is None for path in of_right) and any(of_right):
        raise stage.BadInput("--photograph-right, --regions-right and --surfaces-right: all of them, or none")
    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late
            import numpy as np

            from lib.vision import creases, label_files, necks, surfaces
        sides = {"left": (opt.photograph, opt.regions, opt.surfaces)}
        if opt.photograph_right:
            sides["right"] = of_right
        found = {}
        for side, (photograph, regions, _) in sides.items():
            taken, labels = label_files.read_beside(photograph, regions)
            picture = taken.display
            with report.timing("surfaces"):
                joined = surfaces.surfaces(picture, labels, compressed=taken.blocks is not None)
            with report.timing("creases"):
                bent = creases.cut(picture, joined)
            with report.timing("necks"):
                found[side] = necks.cut(bent)
        report["surfaces"] = {side: len(np.unique(labels)) for side, labels in found.items()}
        label_files.write({sides[side][2]: labels for side, labels in found.items()})


if __name__ == "__main__":
    stage.run(main, options())
