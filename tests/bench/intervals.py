"""Are the standard deviations true?  Spread under noise, and how often intervals hold.

    $ python -m tests.bench.intervals noise [seeds]                  six kinds of scene, 200 seeds of noise
    $ python -m tests.bench.intervals rooms OUT [rooms] [first]      random small rooms, one seed of noise each
    $ python -m tests.bench.intervals shiny OUT [rooms] [first]      the same, one group a mirror or glossy

noise   One scene, its light fixed, photographed again and again.  The standard deviation of a value over the seeds,
        divided by the part of sigma that noise alone makes (the formula stands here, apart from lib/), is 1 if that
        part is true: .85 to 1.15 are wanted.  `within` is how many means lie within 2 sigma of the truth, all parts
        counted.
rooms   A room, a lamp, boxes, paints, a camera and a gamma of each seed's own, rendered with four times as many patches
        as the fit has, and then index, gather and fit as `make` runs them.  OUT/rooms.jsonl has a line for each room,
        and is gone on with; the table is of all its lines.  Rooms are resampled whole for the interval of the coverage.
shiny   The same with a wall, the floor or a box that is a mirror or glossy, into OUT/shiny.jsonl.
"""

import contextlib
import importlib.util
import io
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.helpers import rooms, small_scenes
from tests.helpers.boxes import look

ROOT = Path(__file__).resolve().parents[2]
PAINTS = {"bottom": 0.45, "top": 0.8, "west": 0.6, "east": 0.3, "north": 0.7, "south": 0.5, "box": 0.25, "lamp": 0.0}
WHITE = {"bottom": 0.85, "top": 0.95, "west": 0.9, "east": 0.88, "north": 0.92, "south": 0.9, "box": 0.8, "lamp": 0.0}
# a grey picture has no colours for JPEG to round, and may be read as one channel
COLOURED = {name: rho * np.random.default_rng(len(name)).uniform(0.85, 1.15, 3) for name, rho in PAINTS.items()}
TINT = np.ones(3)  # of a coloured lamp the fit goes slowly along the valley of gamma and rho
KINDS = {  # paints, exposure, patches of the fit, bits or quality, the lamp is told
    "normal": (PAINTS, 1.0, 300, 8, True),
    "white": (WHITE, 0.3, 300, 8, True),
    "dark": (PAINTS, 0.1, 300, 8, True),
    "JPEG": (COLOURED, 1.0, 300, "jpeg", True),
    "coarse mesh": (PAINTS, 1.0, 40, 8, True),
    "unknown lamp": (PAINTS, 1.0, 300, 8, False),
}
POWER, GAMMA, NOISE = 6.0, 2.2, 0.006
FINE = {"patches": 1200, "rays": 1024}
WIDTH, HEIGHT = 320, 240


def studio(folder, objects, camera, **fineness):
    with contextlib.redirect_stderr(io.StringIO()):
        return small_scenes.Studio(folder, objects, camera, **fineness)


# ---- the noise part of sigma


def noise_sigma(problem, result):
    """(n,) what the pixels' noise alone makes of a value's error: (J'WJ + P)^-1 J'W V W J (J'WJ + P)^-1, on the
    diagonal; V of the tiles' means. What JPEG rounds nobody knows before: there V is what the tiles scatter by, the
    channels of one together, as lib/analysis/fit/uncertainty.py has it; they err together, since JPEG rounds light and
    not channels."""
    from lib.analysis.fit.problem import weights

    at = result.at
    weight = weights(problem, at.residual).reshape(-1, 1)
    inverse = np.linalg.inv(at.jacobian.T @ (weight * at.jacobian) + at.prior()[1])
    gain = inverse @ (weight * at.jacobian).T
    if problem.block_noise:
        each = (gain * at.residual.reshape(-1)).reshape(len(gain), -1, problem.channels).sum(axis=2)
        return np.sqrt((each**2).sum(axis=1))
    return np.sqrt((gain**2) @ np.repeat(problem.tile_noise, problem.channels))


def photographs(linear, how, seeds):
    """A Photograph for each seed of noise."""
    import cv2

    from lib.given import image

    for seed in range(seeds):
        shot = small_scenes.photograph(linear, gamma=GAMMA, noise=NOISE, seed=seed)
        if how == "jpeg":
            with tempfile.TemporaryDirectory() as folder:
                values = np.round(255 * shot.values[:, :, ::-1]).astype(np.uint8)
                cv2.imwrite(f"{folder}/left.jpg", values, [cv2.IMWRITE_JPEG_QUALITY, 90])
                shot = image.read_photograph(Path(folder) / "left.jpg")
        yield shot


def under_noise(kind, seeds):
    """Rows (quantity, values, spread / noise sigma pooled, least, largest, share of means within 2 sigma)."""
    from lib.analysis.causes import explain
    from lib.analysis.causes.scope import Scope
    from lib.analysis.fit import facts
    from lib.analysis.seen import gather
    from lib.buffers import trust
    from lib.given.view import View

    paints, exposure, patches, how, told = KINDS[kind]
    E = POWER * TINT
    objects = rooms.room() | rooms.LAMP | rooms.solid("box", 1.2, 1.6, 0, 2.1, 2.4, 0.8)
    camera = look((0.3, 0.3, 1.6), (2.4, 2.2, 0.9), width=WIDTH, height=HEIGHT, K=K(220.0))
    with tempfile.TemporaryDirectory() as folder:
        (fine, coarse) = (Path(folder) / "fine", Path(folder) / "coarse")
        fine.mkdir(), coarse.mkdir()
        linear = exposure * studio(fine, objects, camera, **FINE).picture(paints, (E,))
        made = studio(coarse, objects, camera, patches=patches)
    first = next(photographs(linear, how, 1))
    s = made.surface
    used = trust.trusted(first, made.facet, made.hidden, s.group).mask
    found = gather.gathered(
        View(camera, made.world, first, made.facet), s, made.factors, used, gather.Sampling(256, 8192)
    )
    lamps = {"lamp": (exposure * E).tolist() if told else "unknown"}
    reference = {} if told else {"bottom": [paints["bottom"]] * 3}
    values, noise, total = [], [], []
    for shot in photographs(linear, how, seeds):
        seen = replace(found, pixels=shot.values.reshape(-1, shot.values.shape[2])[found.tiles.pixel])
        problem = facts.problem_of(made.factors, seen, lamps=lamps, reference=reference, transfer=None)
        scope = Scope(response=False, allowed=())  # one explanation: others have other numbers
        result = explain.explain(problem, scope, gamma=GAMMA, max_iterations=100).result
        layout = result.at.layout
        names = [("rho", g, c) for g, c in layout.rho] + [("lamp", k, c) for k, c in layout.E] + [("gamma", 0, 0)]
        values.append(layout.pack(result.state))
        noise.append(noise_sigma(problem, result))
        own = [result.sigma_rho[g, c] for g, c in layout.rho] + [result.sigma_E[k, c] for k, c in layout.E]
        total.append([*own, np.sqrt(result.cov_transfer[0, 0])])
    values, noise, total = np.array(values), np.sqrt(np.mean(np.square(noise), axis=0)), np.mean(total, axis=0)
    true = np.array(
        [
            {"rho": (paints.get(made.groups[g], 0) * np.ones(3))[c], "lamp": exposure * E[c], "gamma": GAMMA}[q]
            for q, g, c in names
        ]
    )
    seen = np.isin([g if q == "rho" else -1 for q, g, _ in names], [-1, *np.unique(found.group)])
    for quantity in ("rho", "lamp", "gamma"):
        mine = np.array([q == quantity for q, *_ in names]) & seen
        if mine.any():
            ratio = values.std(axis=0, ddof=1)[mine] / noise[mine]
            off = np.abs(values.mean(axis=0) - true)[mine]
            pooled = float(np.sqrt(np.mean(ratio**2)))
            yield quantity, int(mine.sum()), pooled, ratio.min(), ratio.max(), float((off <= 2 * total[mine]).mean())


# ---- total sigma, over rooms


def K(f):
    return np.array([[f, 0, WIDTH / 2 - 0.5], [0, f, HEIGHT / 2 - 0.5], [0, 0, 1]])


def random_room(seed):
    """(objects, camera, paints, power, gamma, told) of a seed: a closed room, one to three boxes on its floor."""
    random = np.random.default_rng([7, seed])
    x, y, z = random.uniform([3, 2.5, 2.2], [6, 5, 3.2])
    objects = rooms.room(x, y, z)
    w, d = random.uniform(0.4, 1.2, 2)
    cx, cy = random.uniform([0.3 * x, 0.3 * y], [0.7 * x, 0.7 * y])
    h = z - random.uniform(0.02, 0.3)
    corners = [(cx - w / 2, cy - d / 2), (cx - w / 2, cy + d / 2), (cx + w / 2, cy + d / 2), (cx + w / 2, cy - d / 2)]
    objects |= rooms.panel("lamp", *((a, b, h) for a, b in corners))
    placed = []
    for k in range(random.integers(1, 4)):
        for _ in range(50):
            low = random.uniform([0.35 * x, 0.35 * y], [0.8 * x, 0.8 * y])
            high = low + random.uniform(0.3, 0.9, 2)
            clear = all((low > other[1] + 0.1).any() or (high < other[0] - 0.1).any() for other in placed)
            if clear and (high < [x - 0.05, y - 0.05]).all():
                placed.append((low, high))
                objects |= rooms.solid(f"box{k}", *low, 0, *high, random.uniform(0.3, 1.2))
                break
    camera = look(
        (0.2, 0.2, random.uniform(1.2, 1.8)), (0.65 * x, 0.7 * y, 0.8), width=WIDTH, height=HEIGHT, K=K(190.0)
    )
    groups = list(dict.fromkeys(group for polygons in objects.values() for group, _ in polygons))
    paints = {g: 0.0 if g == "lamp" else float(random.uniform(0.08, 0.85)) for g in groups}
    return objects, camera, paints, float(random.uniform(1.8, 2.6)), seed % 3 != 0


def shiny(seed, paints, told):
    """The paints with one group a mirror or glossy: ("mirror", rho_s) or (alpha, rho_d, rho_s).

    told : the lamp is; else the floor is the reference
    """
    random = np.random.default_rng([8, seed])
    group = str(random.choice(["north", "box0", "bottom"][: 3 if told else 2]))
    if random.random() < 0.4:
        return paints | {group: ("mirror", float(random.uniform(0.3, 0.95)))}
    alpha = float(np.exp(random.uniform(np.log(0.04), np.log(0.25))))
    return paints | {group: (alpha, float(random.uniform(0.05, 0.5)), float(random.uniform(0.05, 0.4)))}


def stage(name, folder, *words):
    """The stage's work in this process, with the options that `make` gives it."""
    spec = importlib.util.spec_from_file_location(f"stages_{name}", ROOT / "stages" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    before = sys.path[:]
    spec.loader.exec_module(module)
    sys.path[:] = before
    words = [str(folder / w) if "." in w and not w.startswith("{") else w for w in words]
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        module.main(module.options().parse_args(words))


def measured(seed, what):
    """A row of one room: status, and (quantity, value, truth, sigma) of all that is claimed."""
    from lib.given import image

    objects, camera, paints, gamma, told = random_room(seed)
    paints = shiny(seed, paints, told) if what == "shiny" else paints
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = studio(folder, objects, camera, **FINE)
        linear = made.picture(paints, (POWER,))
        exposure = 0.8 / np.quantile(linear[made.facet >= 0], 0.98)
        shot = small_scenes.photograph(exposure * linear, gamma=gamma, noise=0.004, seed=seed)
        image.write_png8(folder / "left.png", np.round(shot.values * 255).astype(np.uint8))
        power = exposure * POWER
        lamps = {"lamp": [power] if told else "unknown"}
        reference = {} if told else {"bottom": [paints["bottom"]]}
        model = ("--model", "model.obj")
        seen = (*model, "--camera", "camera.cameramodel", "--photograph", "left.png", "--facet", "facet.png")
        stage("edges", folder, *seen[:6], "--lamps", '["lamp"]', "--edges", "edges.json")
        stage("formfactors", folder, *model, "--lamps", '["lamp"]', "--formfactors", "formfactors.npz")
        stage("index", folder, *seen, "--trusted", "trusted.png", "--method", "rays")
        light = ("--formfactors", "formfactors.npz", "--gather", "gather.npz", "--audit", "audit.npz")
        stage("gather", folder, *seen, "--trusted", "trusted.png", *light)
        facts = ("--lamps", json.dumps(lamps), "--reference", json.dumps(reference))
        out = ("--materials", "materials.json", "--specular", "specular.npz", "--mirror", "mirror.png")
        stage("fit", folder, *seen, *light, "--edges", "edges.json", *facts, *out)
        found = json.loads((folder / "materials.json").read_text())
    claims, kinds = [], {}
    for group, got in found["groups"].items():
        if not got["identified"] or not got["sigma"] or group == "lamp" or group in reference:
            continue
        paint, sigma = paints[group], got["sigma"]
        if not isinstance(paint, tuple):
            paint = (None, paint, None)
        alpha, rho_d, rho_s = ("mirror", 0.0, paint[1]) if paint[0] == "mirror" else paint
        kinds[group] = [
            got["kind"],
            "diffuse" if alpha is None else "coloured_mirror" if alpha == "mirror" else "glossy",
        ]
        if got["rho_d"] and rho_d and sigma.get("rho_d"):
            claims.append(("rho", got["rho_d"][0], rho_d, sigma["rho_d"][0]))
        if rho_s is not None and got.get("rho_s") and sigma.get("rho_s"):
            claims.append(("rho_s", got["rho_s"][0], rho_s, sigma["rho_s"][0]))
        if isinstance(alpha, float) and got.get("alpha") and sigma.get("alpha"):
            claims.append(("alpha", got["alpha"][0], alpha, np.max(sigma["alpha"])))
    claims = [claim for claim in claims if claim[3] is not None]
    lamp, transfer = found["lamps"]["lamp"], found["transfer"]
    if not told and lamp["identified"] and lamp["sigma"]:
        claims.append(("lamp", lamp["emittance"][0], power, lamp["sigma"]["emittance"][0]))
    if transfer["kind"] == "gamma":
        claims.append(("gamma", transfer["gamma"], gamma, transfer["sigma"]))
    wrong = {group: pair for group, pair in kinds.items() if pair[0] != pair[1]}
    why = [w["cause"] for w in found["why"] or []]
    causes = [cause["cause"] for cause in found["explained"] or []]
    row = {"seed": seed, "status": found["status"], "told": told, "claims": claims, "wrong": wrong}
    return row | {"why": why, "causes": causes}


def table(rows):
    """Lines of text: of each quantity how many of the 95 % intervals hold, and the interval of that."""
    green = [r for r in rows if r["status"] == "converged"]
    others = [(r["seed"], r["status"], *r.get("why", ())) for r in rows if r not in green]
    yield f"{len(rows)} rooms, {len(green)} converged; others: {others}"
    if wrong := {r["seed"]: r["wrong"] for r in green if r.get("wrong")}:
        yield f"other kinds than they are: {wrong}"
    yield f"causes that were taken, none is there: {[(r['seed'], *r['causes']) for r in green if r.get('causes')]}"
    yield "quantity      n  held %   (95 % of it)   rms sigma   worst   median sigma / value"
    for quantity in ("rho", "gamma", "lamp", "rho_s", "alpha"):
        by_room = [[(v, t, s) for q, v, t, s in r["claims"] if q == quantity] for r in green]
        by_room = [np.array(c) for c in by_room if c]
        if not by_room:
            continue
        z = [np.abs(c[:, 0] - c[:, 1]) / c[:, 2] for c in by_room]
        random, drawn = np.random.default_rng(1), []
        for _ in range(2000):
            some = np.concatenate([z[k] for k in random.integers(0, len(z), len(z))])
            drawn.append((some <= 1.96).mean())
        of_all, claims = np.concatenate(z), np.concatenate(by_room)
        low, high = 100 * np.quantile(drawn, [0.025, 0.975])
        relative = np.median(claims[:, 2] / np.abs(claims[:, 1]))
        yield (
            f"{quantity:8s} {len(of_all):6d} {100 * (of_all <= 1.96).mean():7.1f} ({low:6.1f} {high:6.1f})"
            f" {np.sqrt(np.mean(of_all**2)):11.2f} {of_all.max():7.1f} {relative:10.4f}"
        )


def main(what, *words):
    if what == "noise":
        seeds = int(words[0]) if words else 200
        print(f"{seeds} seeds          values  spread / sigma  least largest   within 2 sigma %", flush=True)
        for kind in words[1:] or KINDS:
            for quantity, n, pooled, least, largest, within in under_noise(kind, seeds):
                print(
                    f"{kind:13s} {quantity:6s} {n:4d} {pooled:13.2f} {least:9.2f} {largest:6.2f} {100 * within:12.0f}",
                    flush=True,
                )
        return
    out = Path(words[0])
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{what}.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    count, first = (int(w) for w in (*words[1:], *("100", "1")[len(words) - 1 :]))
    for seed in range(first, first + count):
        if seed not in {r["seed"] for r in rows}:
            rows.append(measured(seed, what))
            with open(path, "a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print(*table(rows), sep="\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
