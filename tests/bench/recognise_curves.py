"""Error against CPU time of recognise: the refinement's methods, the search against the size of the model, corners.

$ python -m tests.bench.recognise_curves OUT/          recognise.csv, recognise.png
"""

import csv
import os
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
HEAD = ("curve", "scene", "method", "setting", "iteration", "cpu_s", "turn_deg", "move_mm", "share")


def refinement_curves(log):
    """The office's pair drawn from the index buffer, four starts 1.5 degrees and 5 cm away.

    The regions are exactly the facets, better than any segmentation: the paper's method needs their corners.
    """
    from lib.given import cameras
    from lib.given import model as models
    from lib.given.cameras import Camera
    from lib.vision.recognition import closed_form
    from lib.vision.refinement import pose as refinement
    from lib.vision.refinement import rig
    from tests.helpers import facet_trials as trials

    model = models.load(ROOT / "data" / "office" / "model.obj")
    left = cameras.read_cameramodel(ROOT / "data" / "office" / "left.posed.cameramodel")
    T_right_left = cameras.matrix_from_rt([0.01, 0.12, 0.005, -0.4, 0.01, 0.03])
    sides, facets = [], None
    for D in (np.eye(4), T_right_left):
        posed = Camera(left.K, left.width, left.height, D @ left.T_cam_world)
        shown = trials.draw(model, posed).facet
        facets = np.unique(shown[shown >= 0]) if facets is None else facets
        sides.append(
            rig.Side(
                Camera(left.K, left.width, left.height, D),
                trials.photograph(np.random.default_rng(0), model, posed),
                shown + 1,
            )
        )
    large = np.array([f for f in facets if (sides[0].surfaces == f + 1).sum() > 1500])
    matches, labels = np.column_stack([np.arange(len(large)), large]), np.column_stack([large + 1, large + 1])
    rows = []
    for method in ("edges", "paper"):
        for seed in range(4):
            random = np.random.default_rng(seed)
            step = np.concatenate([random.normal(size=3) * np.radians(1.5), random.normal(size=3) * 0.05])
            T0 = closed_form.moved(left.T_cam_world, step)
            C = np.diag([np.radians(1.5) ** 2] * 3 + [0.05**2] * 3)
            found = SimpleNamespace(poses=(closed_form.Pose(T0, 1.0, C, matches, 0, 0, 0, T0),), status="unique")
            begin = time.process_time()
            result = refinement.refine(model, sides, found, labels, method=method)
            for point in result.trace:
                turn, move = trials.pose_error(cameras.matrix_from_rt(point["rt_cam_world"]), left)
                rows.append(
                    (
                        "refine",
                        "office",
                        method,
                        seed,
                        point["iteration"],
                        point["cpu_s"] - begin,
                        turn,
                        1000 * move,
                        "",
                    )
                )
            log(*rows[-1])
    return rows


def search_curves(log, seeds=8):
    """Rooms in a row, one of them seen, half of the facets spurious: share answered, none of it wrong, CPU seconds."""
    from lib.vision.recognition import recognise as recognition
    from tests.helpers import facet_trials as trials

    recognition.warm_up()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for unit, sizes in (("m", (1, 3, 10, 30)), ("baseline", (1, 3))):
            for rooms in sizes:
                spent, answered, errors = [], 0, []
                for seed in range(seeds if unit == "m" else 3):
                    random, _, model, camera = trials.room_trial(seed, Path(folder), rooms)
                    facets, _ = trials.facets_seen(random, model, camera, unit=unit)
                    begin = time.process_time()
                    found = recognition.recognise(facets, model, camera)
                    spent.append(time.process_time() - begin)
                    if found.status == "unique":
                        answered += 1
                        errors.append(trials.pose_error(found.poses[0].T, camera))
                turn, move = np.mean(errors, axis=0)
                rows.append(
                    (
                        "search",
                        f"{rooms} rooms",
                        unit,
                        model.n_facets,
                        "",
                        float(np.mean(spent)),
                        turn,
                        1000 * move,
                        answered / len(spent),
                    )
                )
                log(*rows[-1])
    return rows


def corner_curves(log, seeds=12, most=(30, 100, 300, 1000, 3000, 37_000)):
    """Objects before texture of which three facets are known: share where the best pose by lines is the true one.

    The knob is how many poses are ranked. Times are those of the hypotheses alone; errors are medians of right poses.
    """
    from unittest.mock import patch

    from lib.vision.corners import hypotheses
    from lib.vision.facets_file import SceneFacets
    from tests.helpers import facet_trials as trials
    from tests.helpers import objects

    hypotheses.warm_up()
    pairs, rows = [], []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(seeds):
            pair = objects.object_pair(300 + seed, Path(folder))
            random = np.random.default_rng(seed)
            facets, truth = trials.facets_seen(random, pair.full, pair.posed, spurious=0.3, partial=False)
            own = [i for i, f in enumerate(truth) if f >= 0 and pair.full.facet_object[f] < len(pair.given.objects)][:3]
            polygons = [facets.polygons[i] for i in own]
            pairs.append((SceneFacets(facets.m[own], facets.covariance[own], polygons, facets.labels[own]), pair))
    for number in most:
        spent, errors = [], []
        for scene, pair in pairs:
            begin = time.process_time()
            with patch.object(hypotheses, "MOST", number):
                found = hypotheses.hypotheses(scene, pair.given, pair.sides)
            spent.append(time.process_time() - begin)
            if len(found.T):
                turn, move = trials.pose_error(found.T[0], pair.posed, 1.0)
                if turn < 3 and move < 0.1:
                    errors.append((turn, move))
        turn, move = np.median(errors, axis=0) if errors else (np.nan, np.nan)
        share = len(errors) / len(pairs)
        rows.append(("corners", "objects", "lines", number, "", float(np.mean(spent)), turn, 1000 * move, share))
        log(*rows[-1])
    return rows


def plot(rows, axes):
    """Left: the refinement; middle: the search; right: corners."""
    style = {"edges": "C0", "paper": "C3"}
    for method, colour in style.items():
        for seed in sorted({r[3] for r in rows if r[0] == "refine"}):
            points = [r for r in rows if r[0] == "refine" and r[2] == method and r[3] == seed]
            axes[0].loglog(
                [max(r[5], 1e-2) for r in points],
                [r[6] for r in points],
                "-o",
                color=colour,
                ms=3,
                label=method if seed == 0 else None,
            )
    axes[0].axhline(0.1, color="0.6", lw=0.8)
    axes[0].set(title="refinement, pair of 640 x 480 px", xlabel="CPU s", ylabel="error of the pose, degrees")
    for unit, line in (("m", "-o"), ("baseline", "--s")):
        points = [r for r in rows if r[0] == "search" and r[2] == unit]
        axes[1].loglog([r[3] for r in points], [r[5] for r in points], line, label=f"unit: {unit}")
    axes[1].set(title="search, half of the facets spurious", xlabel="facets of the model", ylabel="CPU s")
    points = [r for r in rows if r[0] == "corners"]
    axes[2].semilogx([r[5] for r in points], [r[8] for r in points], "-o", label="30 to 37,000 poses ranked")
    axes[2].set(title="corners, three facets of an object", xlabel="CPU s", ylabel="share with the true pose first")


def curves(out_folder, log=print):
    """Writes recognise.csv and recognise.png."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = refinement_curves(log) + search_curves(log) + corner_curves(log)
    out = Path(out_folder)
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "recognise.csv", "w", newline="") as file:
        csv.writer(file).writerows([HEAD, *rows])
    figure, axes = plt.subplots(1, 3, figsize=(16, 4.2))
    plot(rows, axes)
    for ax in axes:
        ax.grid(True, which="both", lw=0.3)
        ax.legend()
    figure.tight_layout()
    figure.savefig(out / "recognise.png", dpi=110)
    return rows


if __name__ == "__main__":
    curves(sys.argv[1])
