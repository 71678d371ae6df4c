"""Nothing depends on the picture's size: the same scenes 320 to 2560 px wide, exact and with one thing wrong.

    $ DRJIT_LIBLLVM_PATH=... python -m tests.bench.sizes --out /tmp/sizes
    $ python -m tests.bench.sizes --out /tmp/sizes --scenes poster --kinds exact --widths 320 640

Needs Mitsuba (`make scenes` installs it) with `llvm_ad_rgb`, and its LLVM, to trace each scene once, as wide as it is
wanted widest; that is kept in OUT/finest. A diffuse room is 2560 px wide, what is more than diffuse 1280, for that is
slow to trace: 15 CPU minutes in all. Smaller pictures are area means of its light, so the path tracer's noise halves
with the width as a sensor's does; NOISE is added to each by itself before it is rounded to 8 bits. What is wrong
(lib/synthetic/deviations.py) is drawn once, 640 px wide, and the same at all sizes. Each run is made up to its
materials by `make`: 20 CPU minutes in all.

OUT/NAME.jsonl has a line for each run, and is gone on with; the table on the terminal is of all its lines. `mean` and
`worst` are |rho / rho* - 1| and |rho - rho*| / sigma over groups that COUNTED_PX pixels show 640 px wide, where nothing
is wrong; `apart` is the most that a reflectance is off what was found 640 px wide, in the two sigmas together. Truth is
read to score, and by nothing else.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
MITSUBA = ROOT / ".venv-scenes" / "bin" / "python"
USUAL = 640  # px, the width that the recipes have
NOISE = 0.004  # display
COUNTED_PX = 1000
TRACED = ("--linear", "--more", "0", "--variant", "llvm_ad_rgb")
SCENES = {  # how many times wider each is traced, how, and what is wrong in another run
    "room-601": (4, ("--gather", "--spp", "8", "--passes", "2", "--variant", "llvm_ad_rgb"), "missing_object"),
    "poster": (2, ("--spp", "4", "--passes", "16", *TRACED), "usemtl"),
    "office-mirror": (2, ("--spp", "4", "--passes", "8", *TRACED), "lamp"),
    "desk-glossy": (2, ("--spp", "4", "--passes", "8", *TRACED), "missing_object"),
}
STAGES = ("index", "gather", "fit")
HEAD = (
    "scene          kind            width  status        mean %  worst  apart, of      CPU s: index, gather, fit, all"
    "  peak MB  causes; why; rungs"
)


def finest(scene, out):
    """The folder of a scene as it is traced, made if it is not there."""
    folder = out / "finest" / scene
    if not (folder / "truth" / "materials.json").exists():
        finer, settings, _ = SCENES[scene]
        command = [MITSUBA, ROOT / "stages" / "synthesise.py", "--scene", scene, "--out", folder, "--finer", finer]
        subprocess.run([*map(str, command), *settings], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    return folder


def sized(source, folder, width, seed):
    """The folder of the same scene `width` px wide."""
    from lib.given import cameras, image
    from lib.vision.registration.register import reduced

    light = image.read_exr(source / "truth" / "linear.exr")
    factor = light.shape[1] // width
    H, W, C = light.shape
    light = light.reshape(H // factor, factor, W // factor, factor, C).mean(axis=(1, 3))
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "truth").mkdir(parents=True)
    for name in ("model.obj", "model.mtl", "scene.yaml", "truth/materials.json"):
        shutil.copy(source / name, folder / name)
    camera = cameras.read_cameramodel(source / "left.posed.cameramodel")
    cameras.write_cameramodel(folder / "left.posed.cameramodel", reduced(camera, factor))
    image.write_exr(folder / "truth" / "linear.exr", light)
    gamma = json.loads((source / "truth" / "materials.json").read_text())["transfer"]["gamma"]
    noise = np.random.default_rng([width, seed]).normal(0, NOISE, light.shape)
    display = np.clip(np.clip(light, 0, 1) ** (1 / gamma) + noise, 0, 1)
    image.write_png8(folder / "left.png", np.round(255 * display).astype(np.uint8))


def given(scene, kind, width, out):
    """The folder of a run, written."""
    from lib.synthetic import deviations

    source, folder = finest(scene, out), out / "scenes" / f"{scene}-{kind}-{width}"
    sized(source, folder, width, seed=1)
    if kind != "exact":
        usual = out / "usual" / scene
        if not usual.exists():
            sized(source, usual, USUAL, seed=1)
        wrong = out / "wrong" / f"{scene}-{kind}"
        shutil.rmtree(wrong, ignore_errors=True)
        print(scene, deviations.deviate(usual, wrong, kind, 1), file=sys.stderr)
        for name in ("model.obj", "scene.yaml"):
            shutil.copy(wrong / name, folder / name)
    with open(folder / "scene.yaml", "a") as facts:
        facts.write('goals: ["materials.json"]\n')
    return folder


def measured(scene, kind, width, out, build):
    """One run: a row as a dict."""
    folder = given(scene, kind, width, out)
    made = build / folder.name
    shutil.rmtree(made, ignore_errors=True)
    command = ["make", f"DATA={folder.parent}", f"BUILD={build}", folder.name]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    row = {"scene": scene, "kind": kind, "width": width}
    if not (made / "materials.json").exists():
        return row | {"status": "refused", "said": run.stderr.strip().splitlines()[-1:]}
    found = json.loads((made / "materials.json").read_text())
    reports = {path.name.split(".")[0]: json.loads(path.read_text()) for path in made.glob("*.report.json")}
    return row | {
        "status": found["status"],
        "causes": [e["cause"] for e in found.get("explained") or []],
        "why": [w["cause"] for w in found.get("why") or []],
        "groups": {
            name: {key: group.get(key) for key in ("kind", "rho_d", "rho_s", "alpha", "sigma", "identified")}
            for name, group in found["groups"].items()
        },
        "cpu_s": {name: report["cpu_s"] for name, report in reports.items()},
        "peak_mb": max(report.get("peak_mb", 0) for report in reports.values()),
    }


def values(group):
    """[(value, sigma)] of a group: of rho_d, or of a mirror's rho_s."""
    what = "rho_s" if "mirror" in group["kind"] else "rho_d"
    sigma = (group["sigma"] or {}).get(what) or 3 * [None]
    least = 0.002 if what == "rho_s" else 0  # a mirror that is called perfect
    rho = group[what] or []  # none of a textured group
    return [(value, s or least or np.inf) for value, s in zip(rho, sigma, strict=False)]


def scored(row, truth):
    """(mean of relative errors, most sigmas off the truth) of a run's groups; NaN where none counts."""
    relative, off = [], []
    for name, true in truth["groups"].items():
        got = row["groups"].get(name)
        if (
            true["pixels"] < COUNTED_PX * SCENES[row["scene"]][0] ** 2
            or not got
            or not got["identified"]
            or got["kind"] != true["kind"]
        ):
            continue
        wanted = true["rho_s" if "mirror" in true["kind"] else "rho_d"]
        for (value, sigma), right in zip(values(got), wanted, strict=False):
            relative.append(abs(value / right - 1))
            off.append(abs(value - right) / sigma)
    return float(np.mean(relative)) if relative else np.nan, max(off, default=np.nan)


def apart(row, usual):
    """(most sigmas, by which group) that two runs' reflectances differ by."""
    most, by = 0.0, ""
    for name, group in row["groups"].items():
        other = usual["groups"].get(name)
        if not other or not (group["identified"] and other["identified"]) or group["kind"] != other["kind"]:
            continue
        for (a, s), (b, t) in zip(values(group), values(other), strict=False):
            if abs(a - b) > most * np.hypot(s, t):
                most, by = abs(a - b) / np.hypot(s, t), name
    return most, by


def table(rows, out):
    """Lines of text, one for each run."""
    yield HEAD
    usual = {(r["scene"], r["kind"]): r for r in rows if r["width"] == USUAL and "groups" in r}
    for r in sorted(rows, key=lambda r: (r["scene"], r["kind"], r["width"])):
        head = f"{r['scene']:14s} {r['kind']:14s} {r['width']:6d}  {r['status']:13s}"
        if "groups" not in r:
            yield f"{head} {r['said']}"
            continue
        truth = json.loads((out / "finest" / r["scene"] / "truth" / "materials.json").read_text())
        mean, worst = scored(r, truth) if r["kind"] == "exact" else (np.nan, np.nan)
        most, by = apart(r, usual[r["scene"], r["kind"]]) if (r["scene"], r["kind"]) in usual else (np.nan, "")
        rungs = ", ".join(f"{name} {g['kind']}" for name, g in sorted(r["groups"].items()) if g["kind"] != "diffuse")
        cpu = " ".join(f"{r['cpu_s'].get(stage, np.nan):6.1f}" for stage in STAGES)
        said = f"{'+'.join(r['causes']) or '-'}; {'+'.join(r['why']) or '-'}; {rungs or '-'}"
        shown = f"{100 * mean:6.2f} {worst:6.1f} {most:6.1f} {by:12s} {cpu} {sum(r['cpu_s'].values()):6.1f}"
        yield f"{head} {shown} {r['peak_mb']:5.0f}  {said}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--kinds", nargs="+", help="exact, or of lib/synthetic/deviations.py; default: exact and one")
    parser.add_argument("--widths", nargs="+", type=int, default=[320, 640, 1280, 2560])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--name", default="rows", help="of OUT/NAME.jsonl and OUT/build-NAME, to compare two versions")
    opt = parser.parse_args()
    out = opt.out.resolve()
    log = out / f"{opt.name}.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    done = {(r["scene"], r["kind"], r["width"]) for r in rows}
    kinds_of = lambda scene: opt.kinds or ["exact", SCENES[scene][2]]
    runs = [(s, k, w) for w in opt.widths for s in opt.scenes for k in kinds_of(s) if w <= SCENES[s][0] * USUAL]
    for run in runs:
        if run not in done:
            rows.append(measured(*run, out, out / f"build-{opt.name}"))
            with open(log, "a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print("\n".join(table(rows, out)))


if __name__ == "__main__":
    main()
