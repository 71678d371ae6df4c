"""Error against CPU time, as CSV and as plots:  make bench

    $ python -m tests.bench                         all of them, into build/bench/
    $ python -m tests.bench solvers meshes          some of them

form_factors   rays, hemicube and analytic factors: an empty box against analytic, `office` against 16,384 rays a patch
solvers        the light balance of `office` at rho 0.5, 0.9, 0.99 against elimination
meshes         uniform and adapted patches, `office`, against a fine mesh
fit            paper, damped and Gauss-Newton, and the whole chain, on `office` and `gallery-white` against truth/
causes         what is put right before materials: a camera 2 px off, vignetting, a film curve, noise
segment        the energy of eq. 2.1 beside plain merging and Pottslab (where it is installed: pip install pottslab)
surfaces       how much of a plane is one surface, and how many span two, against the shipped rooms' true planes
facets         planes of true regions by borders, intensities and both, against truth
recognise      the pose by the paper's gradient and by the trust region; seeded trials of the search
place          movable objects that stand elsewhere, by the photographs' pixels
picked         the pose from eight picked corners, and what the photograph's edges make of it
exports        what Mitsuba, Radiance and Cycles make of exported scenes (make .venv-exports/ready)
augment        changed photographs of `office` by the number of rays, against many
ladder         which rung each group reaches under 20 seeds of noise, and the error of mirrors and lobes (an hour)

CPU seconds of one process, all threads, after a warm-up that loads or compiles every kernel.  Short runs are repeated,
and the median counts.  A number means nothing while other work runs beside it.
"""

import argparse
import contextlib
import csv
import importlib
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]


def timed(work, enough=0.3, most=5):
    """Result and CPU seconds: the median of as many runs as fit into `enough` seconds, at most `most`."""
    spent = []
    while len(spent) < most and (not spent or sum(spent) < enough):
        began = time.process_time()
        result = work()
        spent.append(time.process_time() - began)
    return result, sorted(spent)[len(spent) // 2]


def rms(x, w):
    import numpy as np

    return float(np.sqrt((w * x**2).sum() / w.sum()))


# -- form factors


def form_factor_curves(log):
    """Rows of (scene, patches, method, setting, cpu_s, patch_error, group_error).

    The irradiance by one bounce of a first balance at rho 0.5, relative to its mean: root mean square over the patches,
    and the largest error of a group's mean.
    """
    import tempfile

    import numpy as np

    from lib.buffers import opengl
    from lib.light import exact_factors, form_factors, hemicube, radiosity
    from lib.light import lamps as lamps_
    from tests.helpers import rooms

    with tempfile.TemporaryDirectory() as folder:
        box = rooms.surface(Path(folder) / "box.obj", rooms.room(), lamps=("top",))
    office = surface_of("office")
    result = []
    for scene, surface, lamps, patches in (("box", box, ["top"], 900), ("office", office, ["lamp"], 1200)):
        mesh = rooms.patches(surface, patches)
        if scene == "box":
            exact_factors.factors(surface, rooms.patches(surface, 20))
            reference, cpu = timed(lambda: exact_factors.rows(surface, mesh))
            result.append((scene, len(mesh), "analytic", "", cpu, 0.0, 0.0))
        else:
            reference = form_factors.rays(surface, mesh, n_rays=16384, seed=77)
        D = lamps_.patch_direct(surface, mesh, lamps_.emitters(surface, lamps), 1, n_points=64)[:, 0]
        b = radiosity.solve(0.5 * D, np.full(len(mesh), 0.5), reference.matrix(), tolerance=1e-5).B
        whole = reference.exposed > 0.5
        w = mesh.area * whole
        right = reference.matrix() @ b
        mean = (w * right).sum() / w.sum()
        group = surface.group[mesh.side // 2]

        def errors(rows):
            off = rows.matrix() @ b - right
            of_group = np.bincount(group, w * off) / np.maximum(np.bincount(group, w), 1e-300)
            return rms(off, w) / mean, float(np.abs(of_group).max() / mean)

        with contextlib.suppress(opengl.NoGraphics):
            hemicube.rows(surface, rooms.patches(surface, 20), resolution=8)  # warm-up
        methods = [("rays", n, lambda n=n: form_factors.rays(surface, mesh, n_rays=n)) for n in (64, 256, 1024, 4096)]
        methods += [("hemicube", n, lambda n=n: hemicube.rows(surface, mesh, resolution=n)) for n in (16, 32, 64, 128)]
        methods += [
            ("hemicube x 4", n, lambda n=n: hemicube.rows(surface, mesh, resolution=n, points=4))
            for n in (8, 16, 32, 64)
        ]
        for method, setting, work in methods:
            try:
                rows, cpu = timed(work)
            except opengl.NoGraphics as error:
                print(f"left out: {error}", file=sys.stderr)
                break
            result.append((scene, len(mesh), method, setting, cpu, *errors(rows)))
            log(*result[-1])
    return ("scene", "patches", "method", "setting", "cpu_s", "patch_error", "group_error"), result


def plot_form_factors(rows, axes):
    for ax, scene in zip(axes, ("box", "office"), strict=True):
        for method, colour in (("rays", "C0"), ("hemicube", "C1"), ("hemicube x 4", "C3")):
            mine = [r for r in rows if r[0] == scene and r[2] == method]
            ax.plot([r[4] for r in mine], [r[5] for r in mine], "o-", color=colour, label=f"{method}: each patch")
            ax.plot(
                [r[4] for r in mine], [r[6] for r in mine], "o--", color=colour, mfc="w", label=f"{method}: worst group"
            )
            for r in mine:
                ax.annotate(r[3], (r[4], r[5]), textcoords="offset points", xytext=(4, 5), fontsize=7)
        for r in rows:
            if r[0] == scene and r[2] == "analytic":
                ax.axvline(r[4], color="C2", label=f"analytic: exact, {r[4]:.2g} s")
        ax.set(
            xscale="log",
            yscale="log",
            xlabel="CPU s",
            ylabel="error of the irradiance / its mean",
            title={"box": "empty box, against analytic", "office": "office, against 16,384 rays"}[scene]
            + f" ({next(r[1] for r in rows if r[0] == scene)} patches)",
        )


# -- solvers


def solver_curves(log):
    """Rows of (rho, method, iteration, cpu_s, error).

    Largest error of a patch over the mean radiosity, from the lamp alone on.
    """
    import numpy as np

    from lib.light import form_factors, radiosity
    from tests.helpers import rooms

    surface = surface_of("office")
    mesh = rooms.patches(surface, 1200)
    F = form_factors.rays(surface, mesh, n_rays=256).matrix()
    lamp = (surface.group[mesh.side // 2] == surface.groups.index("lamp")) & (mesh.side % 2 == 0)
    E = lamp.astype(float)
    ways = [
        ("krylov", {}),
        ("gauss_seidel", {}),
        ("jacobi", {}),
        ("southwell", {}),
        ("progressive", {}),
        ("progressive", {"ambient": True}),
        ("progressive", {"overshoot": True}),
    ]
    factors = radiosity.Factors(F)
    factors.columns()
    result = []
    for rho in (0.5, 0.9, 0.99):
        reflects = np.where(lamp, 0, rho)
        for method, more in [("direct", {})] + ways:
            radiosity.solve(E, reflects, factors, method=method, max_iterations=3, area=mesh.area, **more)  # warm-up
        exact = radiosity.solve(E, reflects, factors, method="direct")
        mean = (mesh.area * exact.B).sum() / mesh.area.sum()
        result.append((rho, "direct", 1, exact.trace[-1].cpu_s, 1e-15 * exact.B.max() / mean))
        for method, more in ways:
            name = "+".join([method, *more])
            seen = []
            sweeps = method not in ("southwell", "progressive")
            s = radiosity.solve(
                E,
                reflects,
                factors,
                method=method,
                tolerance=1e-7,
                area=mesh.area,
                max_iterations=1500 if sweeps else 60 * len(mesh),
                callback=lambda k, B: seen.append(float(np.abs(B - exact.B).max() / mean)),
                every=len(mesh) // 8,
                **more,
            )
            result += [(rho, name, step.iteration, step.cpu_s, e) for step, e in zip(s.trace, seen, strict=False)]
            log(*result[-1])
    return ("rho", "method", "iteration", "cpu_s", "error"), result


def plot_solvers(rows, axes):
    names = list(dict.fromkeys(r[1] for r in rows))
    for ax, rho in zip(axes, (0.5, 0.9, 0.99), strict=True):
        for i, name in enumerate(names):
            mine = [r for r in rows if r[0] == rho and r[1] == name]
            if name == "direct":
                ax.axvline(mine[0][3], color="0.4", label=f"direct: {mine[0][3] * 1e3:.0f} ms")
            else:
                ax.plot(
                    [max(r[3], 1e-4) for r in mine],
                    [max(r[4], 1e-9) for r in mine],
                    ".-",
                    ms=3,
                    lw=1,
                    color=f"C{i}",
                    label=name,
                )
        ax.set(
            xscale="log",
            yscale="log",
            xlabel="CPU s",
            ylabel="largest error / mean radiosity",
            title=f"light balance, office, rho = {rho}",
            ylim=(1e-8, None),
        )


# -- meshes


def mesh_curves(log):
    """Rows of (kind, setting, patches, cpu_s, error).

    Patch-constant light against a fine mesh, root mean square over the area.
    """
    from lib.light import adapt
    from lib.light import lamps as lamps_
    from tests.helpers import rooms

    surface = surface_of("office")
    lamps = lamps_.emitters(surface, ["lamp"])
    fine = rooms.patches(surface, 14_000)
    reference, exposed = rooms.light_of(surface, fine, lamps, 256)
    ways = [("uniform", n, lambda n=n: rooms.patches(surface, n)) for n in (300, 700, 1500, 3000, 6000)]
    ways += [
        ("adapted", c, lambda c=c: adapt.build(surface, patches=300, max_level=5, contrast=c, emitters=lamps))
        for c in (0.2, 0.1, 0.05, 0.025, 0.0125)
    ]
    ways[-1][2]()
    result = []
    for kind, setting, work in ways:

        def all_of_it(work=work):
            mesh = work()
            rooms.light_of(surface, mesh, lamps, 256)
            return mesh

        mesh, cpu = timed(all_of_it)
        light, _ = rooms.light_of(surface, mesh, lamps, 1024)  # the mesh is judged, not its noise
        result.append(
            (kind, setting, len(mesh), cpu, rooms.constant_light_error(surface, mesh, light, fine, reference, exposed))
        )
        log(*result[-1])
    return ("kind", "setting", "patches", "cpu_s", "error"), result


def plot_meshes(rows, axes):
    for ax, column, label in ((axes[0], 2, "patches"), (axes[1], 3, "CPU s: patches, 256 rays each, balance")):
        for kind in ("uniform", "adapted"):
            mine = [r for r in rows if r[0] == kind]
            ax.plot([r[column] for r in mine], [r[4] for r in mine], "o-", label=kind)
            for r in mine:
                ax.annotate(r[1], (r[column], r[4]), textcoords="offset points", xytext=(4, 5), fontsize=7)
        ax.set(
            xscale="log",
            yscale="log",
            xlabel=label,
            ylabel="rms error of the irradiance / its mean",
            title="patches, office",
        )


# -- inversion


def fit_curves(log):
    """See tests/fit_curves.py."""
    from tests.bench import fit_curves as fit

    return fit.measure(log)


def plot_fit(rows, axes):
    from tests.bench import fit_curves as fit

    fit.plot(rows, axes)


def cause_curves(log):
    """See tests/bench/cause_curves.py."""
    from tests.bench import cause_curves as causes

    return causes.measure(log)


def plot_causes(rows, axes):
    from tests.bench import cause_curves as causes

    causes.plot(rows, axes)


# -- all together

CURVES = {
    "form_factors": (form_factor_curves, plot_form_factors, 2),
    "solvers": (solver_curves, plot_solvers, 3),
    "meshes": (mesh_curves, plot_meshes, 2),
    "fit": (fit_curves, plot_fit, 2),
    "causes": (cause_curves, plot_causes, 2),
}

ALONE = {
    "segment": "segment_bench",
    "surfaces": "surface_bench",
    "facets": "facet_curves",
    "recognise": "recognise_curves",
    "place": "place_curves",
    "picked": "picked_curves",
    "exports": "export_curves",
    "augment": "augment_bench",
    "ladder": "ladder_bench",
}  # modules that measure and draw by themselves


def surface_of(scene):
    from lib.given import model
    from lib.light import surface as surfaces

    return surfaces.surface(model.load(ROOT / "data" / scene / "model.obj"), ["lamp"])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "curves", nargs="*", choices=[*CURVES, *ALONE, []], help=f"of {', '.join([*CURVES, *ALONE])}; none: all"
    )
    parser.add_argument("--output", type=Path, default=ROOT / "build" / "bench")
    opt = parser.parse_args()
    import matplotlib

    from lib.light import small_room

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    small_room.warm_up()
    opt.output.mkdir(parents=True, exist_ok=True)
    for name in opt.curves or [*CURVES, *ALONE]:
        began = time.time()
        print(f"{name}:", flush=True)
        if name in ALONE:
            importlib.import_module(f"tests.bench.{ALONE[name]}").curves(opt.output)
            print(f"    {opt.output} ({time.time() - began:.0f} s)")
            continue
        measure, plot, columns = CURVES[name]
        head, rows = measure(
            lambda *row: print("   ", *(f"{x:.4g}" if isinstance(x, float) else x for x in row), flush=True)
        )
        if not rows:
            print("    nothing measured")
            continue
        with open(opt.output / f"{name}.csv", "w", newline="") as file:
            csv.writer(file).writerows(
                [head, *([f"{x:.6g}" if isinstance(x, float) else x for x in row] for row in rows)]
            )
        figure, axes = plt.subplots(1, columns, figsize=(6 * columns, 4.6), squeeze=False)
        plot(rows, axes[0])
        for ax in axes[0]:
            ax.grid(True, which="both", color="0.92")
            ax.set_axisbelow(True)
            ax.legend(fontsize=7)
        figure.tight_layout()
        figure.savefig(opt.output / f"{name}.png", dpi=110)
        plt.close(figure)
        print(f"    {opt.output / name}.csv, .png ({time.time() - began:.0f} s)")


if __name__ == "__main__":
    main()
