"""What renderers make of the exported scenes, against our own picture and CPU time (for tests/bench).

Each scene is built by make, every kind exported; Mitsuba, Radiance (by paths) and Blender's Cycles render it with more
and more samples a pixel. `rmse` is of display values through the found transfer function, noise included; `diffuse` and
`other` are the largest relative differences of a group's mean (of at least 500 px).
"""

import csv
import os
import resource
import subprocess
from pathlib import Path

import numpy as np

from tests.helpers import consumers

ROOT = Path(__file__).resolve().parents[2]
SCENES = ("office", "desk-glossy")
SAMPLES = (1, 4, 16, 64)
ENOUGH = 500  # px of a group whose mean is compared
HEAD = ("scene", "kind", "samples", "cpu_s", "rmse", "diffuse", "other")


def cpu_of_children():
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def built(scene, build):
    """The folder of a scene's outputs with its exports."""
    words = ["make", f"BUILD={build}", scene, f"{scene}/export"]
    clean = {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k not in ("MFLAGS", "BUILD", "DATA")}
    done = subprocess.run(words, cwd=ROOT, env=clean, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return build / scene


def differences(folder, picture):
    """(RMSE of display values, largest difference of a diffuse group's mean, of another's)"""
    from lib.core import artefact
    from lib.given import image, materials

    found = materials.read(folder / "materials.json")
    ours = image.read_exr(folder / "rendered.exr")
    group, names = image.read_labels(folder / "group.png"), artefact.read_json(folder / "legend.json")["groups"]
    T = found.transfer.function
    rmse = float(np.sqrt(((T.display(np.clip(picture, 0, 1)) - T.display(np.clip(ours, 0, 1))) ** 2).mean()))
    worst = {True: 0.0, False: 0.0}
    for number, name in enumerate(names, 1):
        shown = group == number
        if shown.sum() >= ENOUGH and name in found.groups:
            off = np.abs(picture[shown].mean(axis=0) / ours[shown].mean(axis=0) - 1).max()
            kind = found.groups[name].kind in ("diffuse", "textured")
            worst[kind] = max(worst[kind], float(off))
    return rmse, worst[True], worst[False]


def measure(build, log):
    """Rows of HEAD."""
    from lib.given import cameras

    rows = []
    kinds = [kind for kind, package in consumers.RENDERERS.items() if not consumers.absent(package)]
    for scene in SCENES if kinds else ():
        folder = built(scene, build)
        camera = cameras.read_cameramodel(ROOT / "data" / scene / "left.posed.cameramodel")
        for kind in kinds:
            for samples in SAMPLES:
                began = cpu_of_children()
                picture = consumers.ask(kind, folder / "exports" / kind, camera.width, camera.height, samples)
                rows.append((scene, kind, samples, cpu_of_children() - began, *differences(folder, picture)))
                log(*rows[-1])
    return rows


def curves(output):
    """exports.csv and exports.png"""
    import matplotlib.pyplot as plt

    show = lambda *row: print("   ", *(f"{x:.4g}" if isinstance(x, float) else x for x in row), flush=True)
    rows = measure(output / "exports", show)
    if not rows:
        print("    none of the renderers is installed: make .venv-exports/ready")
        return
    with open(output / "exports.csv", "w", newline="") as file:
        csv.writer(file).writerows([HEAD, *rows])
    figure, axes = plt.subplots(1, len(SCENES), figsize=(6 * len(SCENES), 4.6), squeeze=False)
    for ax, scene in zip(axes[0], SCENES, strict=True):
        for kind in dict.fromkeys(row[1] for row in rows):
            mine = [row for row in rows if row[:2] == (scene, kind)]
            ax.loglog([row[3] for row in mine], [row[4] for row in mine], "o-", label=f"{kind}: RMSE")
            ax.loglog([row[3] for row in mine], [row[5] for row in mine], "x:", label=f"{kind}: worst diffuse group")
        ax.set(title=f"{scene}, exported", xlabel="CPU s", ylabel="against our own picture")
        ax.grid(True, which="both", color="0.92")
        ax.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(output / "exports.png", dpi=110)
    plt.close(figure)
