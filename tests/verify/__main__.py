"""Checks laws and truths, and says which hold:  make verify

    $ python -m tests.verify                       three places of each walk
    $ python -m tests.verify --long                all places
    $ python -m tests.verify balance mirrors       parts of it, by the beginnings of their names

Everything goes into a table on the terminal and into a page with curves. Exit status 1 where a law is broken.
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]


def options():
    parser = argparse.ArgumentParser(
        prog="python -m tests.verify", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", help="by the beginnings of their names")
    parser.add_argument("--long", action="store_true", help="all places of all walks")
    parser.add_argument("--page", type=Path, default=ROOT / "build/verify/report.html")
    return parser


def main(opt):
    from tests.verify import page
    from tests.verify.walks import cpu_s, every

    walks = [w for w in every() if not opt.parts or any(w.part.startswith(part) for part in opt.parts)]
    if not walks:
        print(f"verify: no part begins with {' or '.join(opt.parts)}", file=sys.stderr)
        return 2
    began, results, broken, count, part = cpu_s(), [], 0, 0, None
    for walk in walks:
        places = walk.places(opt.long)
        if not places:
            continue
        if walk.part != part:
            part = walk.part
            print(f"\n{part}", flush=True)
        points = []
        for place in places:
            point = walk.point(place)
            points.append(point)
            print(line(walk, point), flush=True)
        results.append((walk, points))
        count += len(points)
        broken += sum(not p.found.holds for p in points)
    spent = cpu_s() - began
    opt.page.parent.mkdir(parents=True, exist_ok=True)
    page.write(opt.page, results, spent)
    held = f"{count - broken} of {count} hold" if broken else f"all {count} hold"
    print(f"\nverify: {held}, {spent:.0f} CPU s: file://{opt.page.resolve()}")
    return 1 if broken else 0


def line(walk, point):
    """One row of the table."""
    f = point.found
    number = lambda x: "" if x is None else f"{x:.7g}"
    place = f"{point.place:g}" if isinstance(point.place, float) else str(point.place)
    words = f"  {'ok    ' if f.holds else 'BROKEN'} {walk.name}, {place}"
    numbers = f"{number(f.value):>13} {number(f.truth):>13} {f.error:9.1e} <= {f.bound:7.1e}"
    steps = "" if f.iterations is None else f.iterations
    return f"{words:<62.62}{numbers} {steps:>5} {point.cpu_s:6.2f} s  {f.note}".rstrip()


if __name__ == "__main__":
    sys.exit(main(options().parse_args()))
