"""Error of reconstructed planes against CPU time: what overlap, borders and intensities add (for tests/bench).

    $ tests/bench/facet_curves.py build/bench

Scenes: exact quadrilaterals with 1 % noise, and a textured plane whose region has no visible border. Methods: `outline`
is the whole-pixel plane of the row ends that matching uses, `overlap` the paper's maximal mutual overlap, `contours`
borders to a part of a pixel, `all` adds the intensities inside. Each with up to so many iterations.
"""

import csv
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":
    sys.path[0] = str(ROOT)

import numpy as np  # noqa: E402  after the number of threads and the path

HEAD = ("scene", "method", "iterations", "cpu_s_per_facet", "median_error", "p90_error", "planes")
METHODS = (("outline", 0), *((method, i) for method in ("overlap", "contours", "all") for i in (1, 2, 4, 8, 16, 30)))
SEEDS = 12


def _outline(pair, labels, values, both):
    """{label: m} of the row ends alone."""
    from lib.vision import matching

    regions = [matching.regions(view) for view in matching.views(pair, labels, values)]
    planes = {}
    for label in both:
        (a, b, c), _, n = matching.outline_plane(*regions, label - 1, label - 1)
        if n >= 6:
            planes[label] = np.array([a, b, c / pair.f_px]) / pair.baseline @ pair.R_rect_left
    return planes


def _planes(method, iterations, pair, labels, values, wanted):
    """{label: m}"""
    from lib.vision.facets import planes as facets

    if method == "outline":
        return _outline(pair, labels, values, wanted)
    way = "overlap" if method == "overlap" else "least-squares"
    found = facets.reconstruct(
        pair, labels, values, wanted, wanted, method=way, iterations=iterations, intensities=method == "all"
    ).facets
    return {x.left_label: x.m for x in found}


def measure(log):
    """Rows of HEAD. The error is |m - m*| / |m*|: of the distance and, in radians, of the direction together."""
    from lib.vision import matching
    from lib.vision.facets import planes as facets
    from tests.helpers import pairs

    facets.warm_up()
    rows = []
    for scene, make, wanted in (("quads", pairs.quads, np.arange(1, 7)), ("textured", pairs.textured, np.array([1]))):
        cases = []
        for seed in range(SEEDS):
            Q = make(seed)
            cases.append((Q, matching.stereo(Q.left, Q.right), Q.noisy(0.01, np.random.default_rng(seed))))
        for method, iterations in METHODS:
            errors, spent, asked = [], 0.0, 0
            for Q, pair, values in cases:
                begin = time.process_time()
                planes = _planes(method, iterations, pair, Q.labels, values, wanted)
                spent += time.process_time() - begin
                asked += len(wanted)
                errors += [np.linalg.norm(m - Q.m[label]) / np.linalg.norm(Q.m[label]) for label, m in planes.items()]
            if errors:
                median, p90 = float(np.median(errors)), float(np.percentile(errors, 90))
                rows.append((scene, method, iterations, spent / asked, median, p90, len(errors)))
                log(*rows[-1])
    return HEAD, rows


def plot(rows, axes):
    for ax, scene in zip(axes, ("quads", "textured"), strict=True):
        for method, style in (("outline", "ks"), ("overlap", "C2-o"), ("contours", "C1-o"), ("all", "C0-o")):
            mine = [r for r in rows if r[0] == scene and r[1] == method]
            if mine:
                ax.loglog([r[3] for r in mine], [r[4] for r in mine], style, ms=4, label=method)
        ax.set(title=scene, xlabel="CPU s per facet, imports and compilation apart", ylabel="median |m - m*| / |m*|")
        ax.legend()


def curves(out_folder):
    """facets.csv and facets.png into out_folder."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    out = Path(out_folder)
    out.mkdir(parents=True, exist_ok=True)
    head, rows = measure(print)
    with open(out / "facets.csv", "w", newline="") as file:
        csv.writer(file).writerows([head, *rows])
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    plot(rows, axes)
    figure.savefig(out / "facets.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    curves(sys.argv[1] if len(sys.argv) > 1 else ROOT / "build" / "bench")
