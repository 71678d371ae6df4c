#!/usr/bin/env python3
"""§2.2 Region matching: pairs of surfaces, left and right, that show the same planar facet.

    $ stages/match.py --photograph left.png --photograph-right right.png \\
          --surfaces left.surfaces.png --surfaces-right right.surfaces.png \\
          --camera left.cameramodel --camera-right right.cameramodel --matches matches.csv --report match.report.json

reads   photographs, surfaces, cameras (pinholes, extrinsics in one frame)
writes  matches        left_label,right_label,similarity: one to one, best first; what has no partner is left out
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = stage.parser(
        __doc__, reads="photograph photograph_right surfaces surfaces_right camera camera_right", writes="matches"
    )
    parser.add_argument(
        "--similarity", type=stage.real(0, 1, open_low=True), default=0.6, help="least similarity of a pair"
    )
    parser.add_argument(
        "--smallest", type=stage.whole(1), default=40, help="px: surfaces of fewer pixels are not matched"
    )
    return parser


def main(opt):
    from lib.core.report import Report

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import cv2  # noqa: F401  where lib/ imports late
            import numpy as np

            from lib.core import artefact
            from lib.vision import matching
            from lib.vision.matches import write_matches
        with report.timing("read"):
            pair, taken, labels = matching.read_pair(
                (opt.camera, opt.camera_right),
                (opt.photograph, opt.photograph_right),
                (opt.surfaces, opt.surfaces_right),
            )
            values = matching.photographs(*taken)
        with report.timing("match"):
            matches = matching.match(pair, *labels, *values, similarity=opt.similarity, smallest=opt.smallest)

        labels = {"left": labels[0], "right": labels[1]}
        matched = {"left": matches.left, "right": matches.right}
        refused = {"left": matches.refused_left, "right": matches.refused_right}
        report["matched"] = len(matches.left)
        report["surfaces"] = {side: int(np.count_nonzero(np.unique(x))) for side, x in labels.items()}
        report["covered"] = {side: matching.share(x, matched[side]) for side, x in labels.items()}
        report["refused"] = {side: {why: len(which) for why, which in of.items()} for side, of in refused.items()}
        report["refused_labels"] = refused
        if len(matches.left) == 0:
            report.status = "nothing matched"
            report.warning(f"{opt.surfaces}: none of its surfaces has a partner in {opt.surfaces_right}")
        with artefact.writing(opt.matches) as partial:
            write_matches(partial, zip(matches.left, matches.right, matches.similarity, strict=True))


if __name__ == "__main__":
    stage.run(main, options())
