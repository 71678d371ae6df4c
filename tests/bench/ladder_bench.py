"""The reflectance ladder: which rung each group reaches under noise, and error against CPU time (for tests/bench).

    $ python -m tests.bench.ladder_bench OUT/ [seeds]          ladder.csv, ladder_time.csv, ladder.png

Confusion: sensor noise of 0.7 % of full scale is added to each scene's photograph, seed after seed, which is rounded to
8 bits again.  Then index, gather and fit run as a user runs them, from `surfaces: {}`.  No stage reads truth.
Time: the whole of `fit` at several numbers of rays in each lobe.
"""

import csv
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DIFFUSE = ("cornell", "office", "gallery-white")
SPECULAR = ("office-mirror", "office-coloured-mirror", "desk-glossy", "desk-brushed", "poster", "two-mirrors")
NOISE = 0.007
KINDS = ("diffuse", "mirror", "coloured_mirror", "glossy", "anisotropic", "textured")
ENOUGH = 200  # px of a group whose kind is compared


def stage(name, *options):
    done = subprocess.run(
        [sys.executable, ROOT / "stages" / f"{name}.py", *map(str, options)], capture_output=True, text=True, cwd=ROOT
    )
    if done.returncode:
        raise RuntimeError(f"{name}: {done.stderr}")


def facts(scene):
    import yaml

    return yaml.safe_load((ROOT / "data" / scene / "scene.yaml").read_text())


def noisy(scene, seed, path):
    """The photograph with noise, as an 8-bit PNG; seed None: as it is."""
    from lib.given import image

    values = image.read_photograph(ROOT / "data" / scene / "left.png").values
    if seed is not None:
        values = values + np.random.default_rng([11, seed]).normal(0, NOISE, values.shape)
    image.write_png8(path, np.round(255 * np.clip(values, 0, 1)).astype(np.uint8))


def prepare(scene, folder):
    stage(
        "formfactors",
        "--model",
        ROOT / "data" / scene / "model.obj",
        "--lamps",
        json.dumps(list(facts(scene)["lamps"])),
        "--formfactors",
        folder / "formfactors.npz",
    )


def climbed(scene, made, folder, seed, *options):
    """materials.json and the report of fit for one photograph."""
    given = ROOT / "data" / scene
    photograph = folder / "left.png"
    noisy(scene, seed, photograph)
    common = ["--model", given / "model.obj", "--camera", given / "left.posed.cameramodel", "--photograph", photograph]
    stage("index", *common, "--facet", folder / "facet.png", "--trusted", folder / "trusted.png")
    stage(
        "gather",
        *common,
        "--facet",
        folder / "facet.png",
        "--trusted",
        folder / "trusted.png",
        "--formfactors",
        made / "formfactors.npz",
        "--gather",
        folder / "gather.npz",
        "--audit",
        folder / "audit.npz",
    )
    stage(
        "fit",
        *common,
        "--facet",
        folder / "facet.png",
        "--gather",
        folder / "gather.npz",
        "--audit",
        folder / "audit.npz",
        "--formfactors",
        made / "formfactors.npz",
        "--lamps",
        json.dumps(facts(scene)["lamps"]),
        "--materials",
        folder / "materials.json",
        "--report",
        folder / "fit.report.json",
        *options,
    )
    return json.loads((folder / "materials.json").read_text()), json.loads((folder / "fit.report.json").read_text())


def kind_of(entry):
    """The rung: glossy surfaces with a direction apart."""
    if entry["kind"] == "glossy" and entry["alpha"] and entry["alpha"][0] > 1.15 * entry["alpha"][1]:
        return "anisotropic"
    return entry["kind"]


def errors(found, truth):
    """Errors by name.

    rho_s : largest absolute;  alpha : largest relative;  tangent : degrees;  the diffuse groups that 500 px show, or a
    mirror alone: mean relative
    """
    result = {"rho_s": 0.0, "alpha": 0.0, "tangent": 0.0}
    relative = []
    for name, true in truth["groups"].items():
        entry = found["groups"][name]
        if true["kind"] in ("mirror", "coloured_mirror", "glossy") and entry["rho_s"] is not None:
            result["rho_s"] = max(result["rho_s"], np.abs(np.subtract(entry["rho_s"], true["rho_s"])).max())
        if true["kind"] == "glossy" and entry["alpha"]:
            result["alpha"] = max(result["alpha"], np.abs(np.divide(entry["alpha"], true["alpha"]) - 1).max())
            if true["tangent"] and entry["tangent"] and true["alpha"][0] > 1.15 * true["alpha"][1]:
                result["tangent"] = max(
                    result["tangent"], np.degrees(np.arccos(min(1, abs(np.dot(entry["tangent"], true["tangent"])))))
                )
        if (
            true["kind"] == entry["kind"] == "diffuse"
            and entry["identified"]
            and (true["pixels"] >= 500 or true["pixels"] == 0)
        ):
            relative.append(np.abs(np.divide(entry["rho_d"], true["rho_d"]) - 1).mean())
    return result | {"diffuse": float(np.mean(relative)) if relative else 0.0}


def confusion(seeds, log, scenes=DIFFUSE + SPECULAR, workers=2):
    """Rows of (scene, seed, group, pixels, true, found, cpu_s)."""
    rows = []
    with tempfile.TemporaryDirectory() as temporary:

        def one(job):
            scene, seed = job
            folder = Path(temporary) / f"{scene}-{seed}"
            folder.mkdir()
            found, report = climbed(scene, Path(temporary) / scene, folder, seed)
            truth = json.loads((ROOT / "data" / scene / "truth" / "materials.json").read_text())
            wrong = []
            for name, true in truth["groups"].items():
                entry = found["groups"][name]
                if true["pixels"] >= ENOUGH and entry["identified"]:
                    rows.append((scene, seed, name, true["pixels"], kind_of(true), kind_of(entry), report["cpu_s"]))
                    wrong += [name] if rows[-1][4] != rows[-1][5] else []
            log(
                scene,
                seed,
                "wrong:",
                ", ".join(wrong) or "none",
                *(f"{k} {v:.4f}" for k, v in errors(found, truth).items()),
                f"{report['cpu_s']:.1f} s",
            )

        scenes = [scene for scene in scenes if (ROOT / "data" / scene).is_dir()]
        for scene in scenes:
            (Path(temporary) / scene).mkdir()
            prepare(scene, Path(temporary) / scene)
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(one, [(scene, seed) for seed in range(seeds) for scene in scenes]))
    return sorted(rows)


def times(log, settings=(32, 64, 128, 256, 512)):
    """Rows of (scene, lobe_rays, cpu_s, rho_s, alpha, tangent_deg, diffuse)."""
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        for scene in SPECULAR:
            if not (ROOT / "data" / scene).is_dir():
                continue
            folder = Path(temporary) / scene
            folder.mkdir()
            prepare(scene, folder)
            truth = json.loads((ROOT / "data" / scene / "truth" / "materials.json").read_text())
            for rays in settings if scene.startswith("desk") else (256,):
                found, report = climbed(scene, folder, folder, None, "--lobe-rays", rays)
                e = errors(found, truth)
                rows.append((scene, rays, report["cpu_s"], e["rho_s"], e["alpha"], e["tangent"], e["diffuse"]))
                log(*rows[-1])
    return rows


def plot(rows, by_time, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(14, 4.8), width_ratios=(1, 1.5))
    table = np.zeros((len(KINDS), len(KINDS)), int)
    for *_, true, found, _ in rows:
        table[KINDS.index(true), KINDS.index(found)] += 1
    left.imshow(table / np.maximum(table.sum(axis=1, keepdims=True), 1), cmap="Greens", vmin=0, vmax=1)
    for i, row in enumerate(table):
        for j, n in enumerate(row):
            if n:
                left.text(j, i, n, ha="center", va="center", color="white" if n > row.sum() / 2 else "black")
    left.set_xticks(range(len(KINDS)), KINDS, rotation=30, ha="right")
    left.set_yticks(range(len(KINDS)), KINDS)
    left.set_xlabel("found")
    left.set_ylabel("true")
    left.set_title(
        f"groups of at least {ENOUGH} px, {len({seed for _, seed, *_ in rows})} seeds of {100 * NOISE:g} % noise"
    )
    signs = ("rho_s, absolute", "o-", 2), ("alpha, relative", "s--", 3), ("diffuse groups, mean relative", "^:", 5)
    for colour, scene in enumerate(dict.fromkeys(row[0] for row in by_time)):
        mine = np.array([row[1:] for row in by_time if row[0] == scene], float)
        for what, style, column in signs:
            if mine[:, column].any():
                right.loglog(
                    mine[:, 1], mine[:, column], style, color=f"C{colour}", label=f"{scene}: {what}", ms=5, lw=1
                )
        if len(mine) > 1:
            for rays, seconds, *_, error in mine:
                right.annotate(
                    f"{rays:.0f}",
                    (seconds, error),
                    fontsize=7,
                    xytext=(4, 3),
                    textcoords="offset points",
                    color=f"C{colour}",
                )
    right.set_xlabel("CPU s of fit, the whole ladder")
    right.set_ylabel("error against truth")
    right.grid(True, which="both", color="0.92")
    right.set_title("numbers: rays in each lobe; perfect mirrors have no error of rho_s", fontsize=9)
    right.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.01, 0.5))
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def curves(output, seeds=20):
    output = Path(output)
    output.mkdir(parents=True, exist_ok=True)
    log = lambda *row: print("   ", *(f"{x:.4g}" if isinstance(x, float) else x for x in row), flush=True)
    by_time = times(log)
    rows = confusion(seeds, log)
    for name, head, content in (
        ("ladder", ("scene", "seed", "group", "pixels", "true", "found", "cpu_s"), rows),
        ("ladder_time", ("scene", "lobe_rays", "cpu_s", "rho_s", "alpha", "tangent_deg", "diffuse"), by_time),
    ):
        with open(output / f"{name}.csv", "w", newline="") as file:
            csv.writer(file).writerows([head, *content])
    plot(rows, by_time, output / "ladder.png")


if __name__ == "__main__":
    sys.path[0] = str(ROOT)
    curves(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 20)
