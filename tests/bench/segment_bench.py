"""Equation 2.1's energy against time: ours from quick to careful, merging alone, and Pottslab (for tests/bench).

The picture is the 512 x 512 astronaut and its 2 x 2 means. Compilation is apart. Wall seconds stand beside CPU seconds,
since all methods use several cores. Pottslab (pip install pottslab) is no dependency of the project. Where it is not
installed its measured energies stand for it, without times.
"""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

HEAD = ("size", "lambda", "method", "setting", "wall_s", "cpu_s", "energy", "against_pottslab", "regions")
POTTSLAB = {
    256: {0.05: 1110.5, 0.2: 2478.7, 1.0: 5956.4},
    512: {0.05: 3298.6, 0.2: 7286.1, 1.0: 16938.4},
}  # pottslab 1.0.1, 4 neighbours
STEPS = (6.0, 4.0, 3.0, 2.0, 1.5, 1.25)


def picture(side):
    """(side, side, 3) in [0, 1]; side 512 or 256."""
    from lib.given import image

    values = image.read_photograph(Path(__file__).resolve().parent.parent / "data" / "astronaut.png").values
    return values if side == 512 else values.reshape(256, 2, 256, 2, 3).mean((1, 3))


def _timed(work, *arguments, **options):
    """(result, wall s, CPU s)"""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work(*arguments, **options)
    return result, time.perf_counter() - wall, time.process_time() - cpu


def _areas(u):
    """Labels of the areas where neighbours are equal: what a piecewise constant picture says the regions are."""
    from lib.vision import segmentation

    return segmentation.segment(np.ascontiguousarray(u, float), 0)


def measure(log):
    """Rows of HEAD."""
    from lib.vision import segmentation

    try:
        import pottslab
    except ImportError:
        pottslab = None
        log("pottslab is not installed: its energies as measured before, no times")
    segmentation.segment(picture(256)[:16, :16], 0.01)  # loads or compiles
    list(segmentation.merging(picture(256)[:16, :16], [0.1]))
    rows = []
    for side, peers in POTTSLAB.items():
        values = picture(side)
        for run in _runs(values, peers, pottslab):
            energy = segmentation.energy(values, run.labels, run.weight)
            against = energy / peers[run.weight]
            rows.append(
                (side, run.weight, run.method, run.setting, run.wall, run.cpu, energy, against, int(run.labels.max()))
            )
            log(*rows[-1])
    return HEAD, rows


class Run(NamedTuple):
    """One method's labels and its times, s."""

    weight: float
    method: str
    setting: object
    wall: float
    cpu: float
    labels: np.ndarray


def _runs(values, weights, pottslab):
    """Runs of all methods on one picture; pottslab : the module, or None."""
    from lib.vision import segmentation

    path = segmentation.merging(values, list(weights))
    wall = cpu = 0.0
    for weight in weights:
        labels, more_wall, more_cpu = _timed(next, path)
        wall, cpu = wall + more_wall, cpu + more_cpu
        yield Run(weight, "merging", "path", wall, cpu, labels)
    for weight in weights:
        if pottslab:
            u, wall, cpu = _timed(pottslab.min_l2_potts_2d, values, weight, isotropic=False)
            yield Run(weight, "pottslab", "default", wall, cpu, _areas(u))
        for step in STEPS:
            labels, wall, cpu = _timed(segmentation.segment, values, weight, step=step)
            yield Run(weight, "ours", step, wall, cpu, labels)


def plot(rows, axes):
    """One panel for each size: energy over Pottslab's against wall time."""
    for ax, side in zip(axes, POTTSLAB, strict=True):
        for colour, weight in zip(("C0", "C1", "C2"), POTTSLAB[side], strict=True):
            for method, mark in (("ours", "-o"), ("merging", "x"), ("pottslab", "s")):
                some = [r for r in rows if r[:3] == (side, weight, method)]
                if some:
                    ax.semilogx(
                        [r[4] for r in some],
                        [r[7] for r in some],
                        mark,
                        color=colour,
                        ms=4,
                        label=f"{method}, lambda {weight:g}",
                    )
        ax.axhline(1, color="0.6", lw=0.8)
        ax.set(title=f"{side} x {side}", xlabel="wall s, compilation apart", ylabel="energy / Pottslab's")


def curves(out_folder):
    """segment.csv and segment.png in out_folder."""
    import csv

    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder = Path(out_folder)
    folder.mkdir(parents=True, exist_ok=True)
    head, rows = measure(
        lambda *row: print("   ", *(f"{x:.4g}" if isinstance(x, float) else x for x in row), flush=True)
    )
    with open(folder / "segment.csv", "w", newline="") as file:
        csv.writer(file).writerows([head, *([f"{x:.6g}" if isinstance(x, float) else x for x in row] for row in rows)])
    figure, axes = plt.subplots(1, 2, figsize=(12, 4.6))
    plot(rows, axes)
    for ax in axes:
        ax.grid(True, which="both", color="0.92")
        ax.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(folder / "segment.png", dpi=110)
    plt.close(figure)
