"""How whole surfaces are, and how many span two planes, against CPU time (for tests/bench).

Photographs of the shipped rooms; truth: the planes of the model that their true cameras see. `regions` are those of
equation 2.1 at a lambda, `surfaces` the same after borders without a step were taken away.
"""

import csv
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
SCENES = ("office", "office-1", "office-2", "office-3", "gallery-white", "cornell")
HEAD = ("scene", "lambda", "what", "cpu_s", "spanning", "whole", "number")
PURE, LARGE = 0.95, 0.005  # share of a surface that lies on one plane; of the picture, from which a plane counts
SHADING, SMALLEST = 0.06, 1 / 24  # contrast of light that stays whole on the smallest facet: what auto once was
WEIGHTS = {"shading": 1, "shading / 8": 1 / 8, "shading / 20": 1 / 20, "auto": None}


def planes_seen(scene):
    """(H, W) number of the plane that each pixel shows, 0: none."""
    from lib.buffers import index_buffer
    from lib.given import cameras, model

    folder = ROOT / "data" / scene
    world = model.load(folder / "model.obj")
    facet = index_buffer.reference(world, cameras.read_cameramodel(folder / "left.posed.cameramodel")).facet
    number, planes = np.zeros(len(world.facet_normal) + 1, int), []
    for k, (n, d) in enumerate(zip(world.facet_normal, world.facet_offset, strict=True)):
        same = (j for j, (m, e) in enumerate(planes) if abs(m @ n) > 0.9999 and abs(abs(d) - abs(e)) < 0.01)
        number[k + 1] = next(same, len(planes)) + 1
        if number[k + 1] > len(planes):
            planes.append((n, d))
    return number[facet]


def scores(labels, planes):
    """(share of the picture in surfaces that span two planes, median over planes of their largest surface's share)"""
    count = np.zeros((labels.max() + 1, planes.max() + 1))
    np.add.at(count, (labels.ravel(), planes.ravel()), 1)
    size = count.sum(axis=1)
    pure = count.max(axis=1) >= PURE * np.maximum(size, 1)
    seen = [j for j in range(1, count.shape[1]) if count[:, j].sum() > LARGE * labels.size]
    whole = [count[pure, j].max(initial=0) / count[:, j].sum() for j in seen]
    return float(size[~pure].sum() / labels.size), float(np.median(whole))


def whole_shading(picture):
    """The lambda that leaves the light of the smallest facet whole."""
    height, width, channels = picture.shape
    return channels * SMALLEST * (height * width) ** 0.5 * SHADING**2 / 4


def measure(log):
    """Rows of HEAD."""
    from lib.given import image
    from lib.vision import segmentation
    from lib.vision.surfaces import surfaces

    rows, small = [], np.random.default_rng(0).uniform(size=(16, 16, 3))
    surfaces(small, segmentation.segment(small, 0.01))  # loads or compiles
    for scene in SCENES:
        picture, planes = image.read_photograph(ROOT / "data" / scene / "left.png").display, planes_seen(scene)
        for name, share in WEIGHTS.items():
            weight = segmentation.auto_lambda(picture) if share is None else share * whole_shading(picture)
            began = time.process_time()
            regions = segmentation.segment(picture, weight)
            between = time.process_time()
            found = surfaces(picture, regions)
            for what, labels, ended in (("regions", regions, between), ("surfaces", found, time.process_time())):
                rows.append((scene, name, what, ended - began, *scores(labels, planes), int(labels.max())))
                log(*rows[-1])
    return rows


def curves(out_folder):
    """surfaces.csv and surfaces.png in out_folder."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder = Path(out_folder)
    rows = measure(lambda *row: print("   ", *(f"{x:.3g}" if isinstance(x, float) else x for x in row), flush=True))
    with open(folder / "surfaces.csv", "w", newline="") as file:
        csv.writer(file).writerows([HEAD, *([f"{x:.6g}" if isinstance(x, float) else x for x in row] for row in rows)])
    figure, axes = plt.subplots(1, 2, figsize=(12, 4.6))
    for ax, column, title in zip(
        axes, (4, 5), ("share that spans two planes", "of a plane in one surface"), strict=True
    ):
        for name, mark in zip(WEIGHTS, "osv^", strict=True):
            for what, colour in (("regions", "C0"), ("surfaces", "C1")):
                some = [r for r in rows if r[1:3] == (name, what)]
                ax.semilogx(
                    [r[3] for r in some], [r[column] for r in some], mark, color=colour, label=f"{what}, lambda {name}"
                )
        ax.set(xlabel="CPU s, compilation apart", ylabel=title)
        ax.grid(True, which="both", color="0.92")
        ax.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(folder / "surfaces.png", dpi=110)
    plt.close(figure)
