#!/usr/bin/env python3
"""§2.1 Segmentation: the regions of one or two photographs that minimise equation 2.1.

    $ stages/segment.py --photograph left.png --photograph-right right.png --lambda 0.05 \\
          --regions left.regions.png --regions-right right.regions.png --report segment.report.json

reads   photograph, photograph_right
writes  regions, regions_right      labels from 1, each one 4-connected region; 16 bits
"""
import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
from lib import stage


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photograph", required=True)
    parser.add_argument("--photograph-right")
    parser.add_argument("--regions", required=True)
    parser.add_argument("--regions-right")
    parser.add_argument("--report")
    parser.add_argument("--lambda", dest="weight", default="auto", help="cost of one differing neighbour pair, image in [0, 1]; auto: from the noise")
    return parser


def main(opt):
    from lib.report import Report

    if (opt.photograph_right is None) != (opt.regions_right is None):
        raise stage.BadInput("--photograph-right: and --regions-right belong together")
    with Report(opt.report, inputs=[opt.photograph, opt.photograph_right], arguments=vars(opt)) as report:
        with report.excluded("imports"):
            import cv2                                             # noqa: F401  where lib/ imports late
            import numpy as np
            from lib import artefact, image, segmentation

        paths = {"left": (opt.photograph, opt.regions), "right": (opt.photograph_right, opt.regions_right)}
        paths = {side: pair for side, pair in paths.items() if pair[0]}
        pictures = {side: np.minimum(image.read_photograph(photograph).values, 1) for side, (photograph, _) in paths.items()}
        if opt.weight == "auto":
            sigma = max(segmentation.noise(p) for p in pictures.values())
            weight = max(0.05, 20 * sigma ** 2)
        else:
            try:
                weight = float(opt.weight)
                assert weight >= 0
            except (ValueError, AssertionError):
                raise stage.BadInput(f"--lambda: {opt.weight} is neither auto nor a number from 0") from None
        with report.excluded("compile"):
            segmentation.segment(pictures["left"][:4, :4].copy(), 0.01)
        regions = {}
        for side, picture in pictures.items():
            with report.timing("segment"):
                regions[side] = segmentation.segment(picture, weight)
        report["lambda"] = weight
        report["energy"] = {side: segmentation.energy(pictures[side], regions[side] - 1, weight) for side in regions}
        report["regions"] = {side: int(labels.max()) for side, labels in regions.items()}
        with artefact.writing_all(*(paths[side][1] for side in regions)) as partials:
            for partial, labels in zip(partials, regions.values()):
                image.write_png16(partial, labels)


if __name__ == "__main__":
    stage.run(main, options())
