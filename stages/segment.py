#!/usr/bin/env python3
"""§2.1 Segmentation: regions of one or two photographs that make equation 2.1 small.

    $ stages/segment.py --photograph left.png --photograph-right right.png --lambda auto \\
          --regions left.regions.png --regions-right right.regions.png --report segment.report.json

reads   photograph, photograph_right   8 or 16 bits as stored; linear light (EXR) as clip(B, 0, 1)^(1/2.2)
writes  regions, regions_right         labels from 1, each one 4-connected region; 16 bits.
                                       More than 65,535 regions: 32 bits under the same name but .tif, and the .png is
                                       a link to it, for Make and the stages below
The report holds lambda, one for both photographs, and each side's energy and number of regions.
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def cost(text):
    """auto, or a number from 0; argparse names the option."""
    if text == "auto":
        return text
    value = float(text)
    if not value >= 0:
        raise ValueError(text)
    return min(value, sys.float_info.max)  # .inf: as large as JSON has it


cost.__name__ = "auto or a number from 0"


def options():
    parser = stage.parser(
        __doc__, reads="photograph", may_read="photograph_right", writes="regions", may_write="regions_right"
    )
    parser.add_argument(
        "--lambda",
        dest="weight",
        type=cost,
        default="auto",
        metavar="LAMBDA",
        help="cost of one differing neighbour pair, image in [0, 1]; auto: from noise and texture of the image",
    )
    return parser


def main(opt):
    from lib.core.report import Report

    if (opt.photograph_right is None) != (opt.regions_right is None):
        raise stage.BadInput("--photograph-right: comes with --regions-right, and only with it")
    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late

            from lib.given import image
            from lib.vision import label_files, segmentation

        sides = {"left": (opt.photograph, opt.regions), "right": (opt.photograph_right, opt.regions_right)}
        sides = {side: paths for side, paths in sides.items() if paths[0]}
        pictures = {side: image.read_photograph(path).display for side, (path, _) in sides.items()}
        weight = segmentation.auto_lambda(*pictures.values()) if opt.weight == "auto" else opt.weight
        report["lambda"] = weight
        regions = {}
        for side, picture in pictures.items():

            def trace(step, labels, side=side, picture=picture):
                with report.excluded("measuring"):
                    energy = segmentation.energy(picture, labels, weight)
                report.trace(side=side, step=step, energy=energy, regions=int(labels.max()) + 1)

            with report.timing("segment"):
                regions[side] = segmentation.segment(picture, weight, trace=trace)
        report["regions"] = {side: int(labels.max()) for side, labels in regions.items()}
        report["energy"] = {
            side: segmentation.energy(pictures[side], labels, weight) for side, labels in regions.items()
        }
        report["noise"] = {side: segmentation.noise(picture) for side, picture in pictures.items()}
        label_files.write({sides[side][1]: labels for side, labels in regions.items()})


if __name__ == "__main__":
    stage.run(main, options())
