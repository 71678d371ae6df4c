"""Rooms that nobody tuned on, each with one thing that is not as it was photographed: how often is the answer right?

    $ python -m tests.bench.strangers --rooms room-601 small-601 --kinds exact pose lamp --draws 1 2 --out /tmp/sweep

Needs Mitsuba (`make scenes` installs it) with `llvm_ad_rgb`.  Rooms are made once and kept in OUT/rooms; each run is
deviated (lib/synthetic/deviations.py) and run by `make` up to its materials in OUT/build.  OUT/rows.jsonl has a line
for each run, and is gone on with; the table on the terminal is of all its lines.

The error of a run is the mean of |rho / rho* - 1| over groups of at least 1,000 px and channels that are `identified`.
An answer is a run called `converged` or `approximate`; it is wrong with a value more than six sigma off.  `sharp` is
the median sigma over the median error.  Truth is read to score, and by nothing else.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
COUNTED_PX = 1000
MITSUBA = ROOT / ".venv-scenes" / "bin" / "python"
HEAD = (
    "kind             runs conv about median  90 %   worst  unid kinds   95 %   3 s.  worst sharp wrong>6  CPU s   most"
)
ANSWERS = ("converged", "approximate")
TRACED_SETTINGS = ("--linear", "--spp", "64", "--passes", "10", "--variant", "llvm_ad_rgb")
EXACT_SETTINGS = ("--gather", "--spp", "256", "--passes", "6", "--variant", "llvm_ad_rgb")


def room(name, out):
    """The folder of an exact room, made if it is not there."""
    folder = out / "rooms" / name
    if not (folder / "truth" / "materials.json").exists():
        settings = TRACED_SETTINGS if name.startswith(("mirrored", "textured")) else EXACT_SETTINGS
        command = [MITSUBA, ROOT / "stages" / "synthesise.py", "--scene", name, "--out", folder, *settings]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    return folder


def measured(name, kind, draw, out):
    """One run: a row as a dict."""
    from lib.synthetic import deviations

    scene = f"{name}-{kind}-{draw}"
    folder = out / "scenes" / scene
    shutil.rmtree(folder, ignore_errors=True)
    row = {"room": name, "kind": kind, "draw": draw}
    try:
        row["said"] = deviations.deviate(room(name, out), folder, kind, draw)
    except (ValueError, IndexError) as error:
        return row | {"status": "not drawn", "why": str(error)}
    with open(folder / "scene.yaml", "a") as facts:
        facts.write('goals: ["materials.json", "scorecard.csv"]\n')
    command = ["make", f"DATA={out / 'scenes'}", f"BUILD={out / 'build'}", scene]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    build = out / "build" / scene
    if not (build / "materials.json").exists():
        return row | {"status": "refused", "why": run.stderr.strip().splitlines()[-1:]}
    row |= scored(build, folder)
    if os.environ.get("KEEP") is None:
        shutil.rmtree(build)
    return row


def scored(build, folder):
    """Status, causes, errors and time of a finished run."""
    found = json.loads((build / "materials.json").read_text())
    truth = json.loads((folder / "truth" / "materials.json").read_text())
    score = [line.split(",") for line in (build / "scorecard.csv").read_text().splitlines()]
    cpu_s = next(float(line[3]) for line in score if line[2] == "time.until_fit")
    relative, in_sigmas, known_to, unidentified, wrong_kinds = [], [], [], 0, []
    for group, true in truth["groups"].items():
        if true.get("pixels", 0) < COUNTED_PX or group in truth["lamps"]:
            continue
        got = found["groups"].get(group, {})
        if not got.get("identified") or got.get("rho_d") is None:
            unidentified += 1
            continue
        if got["kind"] != true.get("kind", "diffuse"):
            wrong_kinds.append([group, got["kind"]])
        what = "rho_s" if "mirror" in true.get("kind", "diffuse") else "rho_d"
        sigma = (got.get("sigma") or {}).get(what) or [None] * 3
        for value, wanted, s in zip(got[what], true[what], sigma, strict=True):
            s = s or (0.002 if what == "rho_s" else None)  # a mirror that is called perfect
            relative.append(abs(value / wanted - 1))
            in_sigmas.append(abs(value - wanted) / s if s else 1e9)
            known_to.append((s or 0.0) / wanted)
    said = json.loads((folder / "truth" / "deviation.json").read_text())
    return {
        "curve_rmse": curve_rmse(found["transfer"], said.get("transfer"), build, folder),
        "status": found["status"],
        "causes": [e["cause"] for e in found.get("explained") or []],
        "rivals": [
            r["cause"]
            for e in (found.get("explained") or [])[:1]
            for r in e.get("rivals") or []
            if (r.get("evidence_nats") or 0) >= (e.get("evidence_nats") or 0) - 5
        ],
        "why": [w["cause"] for w in found.get("why") or []],
        "transfer": found["transfer"].get("kind"),
        "mean": sum(relative) / len(relative) if relative else None,
        "in_sigmas": in_sigmas,
        "relative": relative,
        "sigma": known_to,
        "unidentified": unidentified,
        "kinds": wrong_kinds,
        "cpu_s": cpu_s,
        "questions": json.loads((build / "fit.report.json").read_text()).get("questions", []),
    }


def curve_rmse(found, true, build, folder):
    """RMSE of a curve, display, over the 1st to 99th percentile of the true light of trusted pixels; None of others."""
    from lib.given import image

    if not true or true.get("kind") != "curve":
        return None
    light = image.read_photograph(folder / "truth" / "linear.exr").values
    trusted = image.read_labels(build / "trusted.png") == 255
    x = np.linspace(*np.quantile(light[trusted], (0.01, 0.99)), 200)
    shown = {
        "gamma": lambda: x ** (1 / found["gamma"]),
        "curve": lambda: np.interp(x, found["linear"], found["display"]),
    }
    if found["kind"] not in shown:
        return None
    return float(np.sqrt(np.mean((shown[found["kind"]]() - np.interp(x, true["linear"], true["display"])) ** 2)))


def table(rows):
    """Lines of text, one for each kind."""
    by_kind = defaultdict(list)
    for row in rows:
        if row["status"] != "not drawn":
            by_kind[row["kind"]].append(row)
    yield HEAD
    for kind, all_of in by_kind.items():
        green = [r for r in all_of if r["status"] in ANSWERS]
        errors = sorted(100 * r["mean"] for r in green if r["mean"] is not None)
        sigmas = np.array([s for r in green for s in r["in_sigmas"]])
        within = lambda z, sigmas=sigmas: 100 * np.mean(sigmas <= z) if len(sigmas) else np.nan
        typical = lambda name, green=green: float(np.median([v for r in green for v in r.get(name, ())] or [np.nan]))
        sharp = typical("sigma") / max(typical("relative"), 1e-9)
        times = sorted(r["cpu_s"] for r in all_of if "cpu_s" in r)
        shown = [
            f"{kind:16s} {len(all_of):4d} {sum(r['status'] == 'converged' for r in green):4d}",
            f"{sum(r['status'] == 'approximate' for r in green):5d}",
            *(f"{_quantile(errors, q):7.2f}" for q in (0.5, 0.9, 1)),
            f"{sum(r['unidentified'] for r in green):4d} {sum(len(r['kinds']) for r in green):5d}",
            f"{within(1.96):6.0f} {within(3):6.0f} {max(sigmas, default=np.nan):6.1f} {sharp:5.1f}",
            f"{sum(max(r['in_sigmas'], default=0) > 6 for r in green):7d}",
            f"{_quantile(times, 0.5):6.1f} {_quantile(times, 1):6.1f}",
        ]
        yield " ".join(shown)
        if curves := sorted(r["curve_rmse"] for r in all_of if r.get("curve_rmse") is not None):
            yield f"{'':20s} RMSE of the curve, display: {_quantile(curves, 0.5):.4f}, at most {curves[-1]:.4f}"
        said = Counter(_in_words(r) for r in all_of)
        yield from (f"{'':20s} {number:3d} {words}" for words, number in said.most_common())


def _quantile(values, q):
    return values[min(len(values) - 1, int(q * len(values)))] if values else np.nan


def _in_words(row):
    why = " why " + "+".join(row["why"]) if row.get("why") else ""
    return f"{row['status']}: {'+'.join(row.get('causes', [])) or '-'}{why}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", nargs="+", default=[])
    parser.add_argument("--kinds", nargs="+", default=["exact"])
    parser.add_argument("--draws", nargs="+", type=int, default=[1])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2, help="runs side by side; times count with 1 alone")
    opt = parser.parse_args()
    out = opt.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    log = out / "rows.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    done = {(r["room"], r["kind"], r["draw"]) for r in rows}
    todo = [(r, k, d) for r in opt.rooms for k in opt.kinds for d in (opt.draws if k != "exact" else [1])]
    for name in opt.rooms:
        room(name, out)
    with ThreadPoolExecutor(opt.jobs) as pool:
        for row in pool.map(lambda x: measured(*x, out), [x for x in todo if x not in done]):
            with open(log, "a") as file:
                file.write(json.dumps(row) + "\n")
            rows.append(row)
            error = f"{100 * row['mean']:.2f} %" if row.get("mean") is not None else ""
            worst = f"{max(row.get('in_sigmas', ()), default=0):.1f} sigma"
            told = row["room"], row["kind"], row["draw"], _in_words(row), error, worst, f"{row.get('cpu_s', 0):.1f} s"
            print(*told, file=sys.stderr)
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
