"""Error of movable objects against CPU time: photographs of more or fewer pixels (for tests/bench).

    $ tests/bench/place_curves.py build/bench

Rooms of lib/synthetic/displaced_pairs.py, the cameras' poses given: two objects 3 cm from where they are drawn, and one
that is gone. The same photographs whole, and with 2 x 2 and 4 x 4 pixels in one.
"""

import csv
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":
    sys.path[0] = str(ROOT)

import numpy as np  # noqa: E402  after the number of threads and the path

HEAD = ("seed", "width_px", "cpu_s", "there", "found", "median_mm", "worst_mm", "worst_sigmas", "absent_said")
SEEDS = range(41, 47)
OFF_M = 0.03
BINNED = (4, 2, 1)


def _sides(case, pictures, binned):
    """rig.Side of both, posed, with so many pixels each way in one."""
    from lib.given.cameras import Camera
    from lib.given.image import Photograph
    from lib.vision.refinement.rig import Side

    to_coarse = np.array([[1 / binned, 0, 0.5 / binned - 0.5], [0, 1 / binned, 0.5 / binned - 0.5], [0, 0, 1]])
    (W, H), sides = (n // binned for n in case.recipe.size), []
    for picture, (lens, T) in zip(pictures, case.recipe.views().values(), strict=True):
        values = picture.reshape(H, binned, W, binned, 3).mean(axis=(1, 3)) / 255
        sides.append(Side(Camera(to_coarse @ lens.K, W, H, T), Photograph(values, 8, False, 3)))
    return sides


def measure(log):
    """Rows of HEAD."""
    from lib.given import model as models
    from lib.given.model import parts
    from lib.synthetic import displaced_pairs
    from lib.verdict.vision_errors import object_error
    from lib.vision.objects.place import place

    rows = []
    for seed in SEEDS:
        case = displaced_pairs.displaced_pair(f"place-{seed}", OFF_M)
        pictures = displaced_pairs.photographs(case)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.obj"
            path.write_text(displaced_pairs.given_model(case))
            model = models.load(path)
        movable = [*case.moves, *case.absent]
        if not rows:
            place(model, _sides(case, pictures, BINNED[0]), movable)  # compiles
        for binned in BINNED:
            sides = _sides(case, pictures, binned)
            begin = time.process_time()
            placed = {p.name: p for p in place(model, sides, movable).placed}
            spent = time.process_time() - begin
            found = [placed[name] for name in case.moves if placed[name].found]
            errors = [object_error(p.T, case.moves[p.name], p.covariance, parts.only(model, [p.name])) for p in found]
            mm, _, sigmas = np.array(errors).reshape(-1, 3).T
            said = sum(placed[name].found is False for name in case.absent)
            of = lambda of_all, x: float(of_all(x)) if len(x) else ""
            row = (of(np.median, mm), of(np.max, mm), of(np.max, sigmas), said)
            rows.append((seed, case.recipe.size[0] // binned, spent, len(case.moves), len(found), *row))
            log(*rows[-1])
    return HEAD, rows


def plot(rows, ax):
    for seed in dict.fromkeys(r[0] for r in rows):
        mine = [r for r in rows if r[0] == seed and r[5] != ""]
        ax.loglog([r[2] for r in mine], [r[5] for r in mine], "o-", ms=4, label=f"room {seed}")
    ax.set(
        title="two objects 3 cm aside, one gone; 320, 640, 1280 px", xlabel="CPU s of place", ylabel="median error, mm"
    )
    ax.legend(fontsize=7)


def curves(out_folder):
    """place.csv and place.png into out_folder."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    out = Path(out_folder)
    out.mkdir(parents=True, exist_ok=True)
    head, rows = measure(
        lambda *row: print("   ", *(f"{x:.4g}" if isinstance(x, float) else x for x in row), flush=True)
    )
    with open(out / "place.csv", "w", newline="") as file:
        csv.writer(file).writerows([head, *rows])
    figure, ax = plt.subplots(figsize=(6, 4.6), layout="constrained")
    plot(rows, ax)
    figure.savefig(out / "place.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    curves(sys.argv[1] if len(sys.argv) > 1 else ROOT / "build" / "bench")
