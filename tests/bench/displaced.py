"""Movable objects that stand 1, 3 and 10 cm elsewhere, and one that is gone: errors of whole runs of the vision stages.

    $ python -m tests.bench.displaced build/displaced 1 2 3           # rooms 1, 2 and 3, each at 1, 3 and 10 cm
    $ python -m tests.bench.displaced build/displaced --known 1 2 3   # the cameras' poses are given: `place` alone
    $ python -m tests.bench.displaced build/displaced --traced 1 2    # path-traced, 640 x 480; needs Mitsuba

Rooms, pictures and truth: lib/synthetic/displaced_pairs.py.  Each line of displaced.csv is one object.
"""

import csv
import json
import pickle
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from lib.given import model as models
from lib.given.cameras import matrix_from_rt, rt_from_matrix
from lib.given.model import parts
from lib.synthetic import displaced_pairs
from lib.vision.recognition import symmetry

ROOT = Path(__file__).resolve().parents[2]
HEAD = ("seed", "off_m", "object", "is_there", "found", "mm", "deg", "chi2", "cpu_s")
OFF_M = (0.01, 0.03, 0.10)
MITSUBA = ROOT / ".venv-scenes" / "bin" / "python"
SIZE = (640, 480)  # of path-traced pairs


def traced(seed, off_m):
    """(case, (left, right)), path-traced."""
    case = displaced_pairs.displaced_pair(seed, off_m, size=SIZE)
    with tempfile.TemporaryDirectory() as folder:
        recipe, pair = Path(folder) / "recipe.pickle", Path(folder) / "pair.npz"
        recipe.write_bytes(pickle.dumps(case.recipe))
        subprocess.run([MITSUBA, "-m", "tests.bench.trace_pair", recipe, pair], check=True, cwd=ROOT)
        with np.load(pair) as pictures:
            return case, (pictures["left"], pictures["right"])


def error(entry, T_true, thing):
    """(mm of the middle, degrees, chi2 of the six numbers), up to what brings the object onto itself."""
    T, C = matrix_from_rt(entry["rt_world_object"]), np.array(entry["covariance"])
    p, best = (thing.vertices.min(axis=0) + thing.vertices.max(axis=0)) / 2, None
    for motion in [np.eye(4), *(m.T for m in symmetry.motions(thing) if m.is_exact)]:
        X = T_true @ motion
        e = rt_from_matrix(X @ np.linalg.inv(T))
        mm = 1000 * np.linalg.norm((X - T) @ np.append(p, 1))
        now = (float(np.degrees(np.linalg.norm(e[:3]))), float(mm), float(e @ np.linalg.solve(C, e)))
        best = min(best or now, now)
    return best[1], best[0], best[2]


def one(seed, off_m, out, known, by_tracing=False):
    """Rows of HEAD."""
    name = f"displaced-{seed}-{round(1000 * off_m)}"
    if by_tracing:
        case, pictures = traced(seed, off_m)
    else:
        case = displaced_pairs.displaced_pair(seed, off_m)
        pictures = displaced_pairs.photographs(case)
    folder = out / "data" / name
    facts = {"movable": [*case.moves, *case.absent], "goals": ["pose.json"]}
    displaced_pairs.write(case, folder, pictures, facts)
    for side in ("left", "right") if known else ():
        shutil.copy(folder / "truth" / f"{side}.posed.cameramodel", folder)
    command = ["make", "-s", f"DATA={out / 'data'}", f"BUILD={out / 'build'}", name]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        print(name, done.stderr.splitlines()[-2:], flush=True)
        return [(seed, off_m, thing, True, "refused", "", "", "", "") for thing in case.moves]
    pose = json.loads((out / "build" / name / "pose.json").read_text())
    cpu = json.loads((out / "build" / name / "place.report.json").read_text())["cpu_s"]
    model, rows = models.load(folder / "model.obj"), []
    for thing, entry in pose["objects"].items():
        there = thing in case.moves
        errors = ("", "", "")
        if there and entry["found"]:
            errors = error(entry, case.moves[thing], parts.only(model, [thing]))
        rows.append((seed, off_m, thing, there, entry["found"], *errors, cpu))
    for unused in (folder, out / "build" / name):
        shutil.rmtree(unused)
    return rows


def summary(rows):
    """Lines of text: the distribution for each offset, and of all."""
    for off_m in (*OFF_M, None):
        some = [r for r in rows if off_m in (None, r[1])]
        there, gone = [r for r in some if r[3]], [r for r in some if not r[3]]
        good = [r for r in there if r[4] is True]
        if not good:
            continue
        of = lambda k, good=good: np.array([r[k] for r in good], float)
        inside = np.mean(of(7) <= 12.59)
        said, wrong = (sum(r[4] is word for r in gone) for word in (False, True))
        yield (
            f"{'all' if off_m is None else f'{100 * off_m:.0f} cm'}: found {len(good)} of {len(there)}; mm "
            f"{np.median(of(5)):.2f} median, {np.percentile(of(5), 90):.2f} at 90 %, {of(5).max():.2f} at most; deg "
            f"{np.median(of(6)):.3f}, {np.percentile(of(6), 90):.3f}, {of(6).max():.3f}; {100 * inside:.0f} % in the "
            f"95 % ellipsoid; absent: {said} of {len(gone)} said, {wrong} found; place: {np.median(of(8)):.1f} CPU s"
        )


def main(argv):
    known, by_tracing = "--known" in argv, "--traced" in argv
    out, *seeds = [word for word in argv if not word.startswith("--")]
    out, rows = Path(out).resolve(), []
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "displaced.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(HEAD)
        for seed in seeds:
            for off_m in OFF_M:
                new = one(seed, off_m, out, known, by_tracing)
                rows += new
                table.writerows(new)
                file.flush()
                for row in new:
                    print(*row, flush=True)
    for line in summary(rows):
        print(line)


if __name__ == "__main__":
    main(sys.argv[1:])
