"""Reflectance error against CPU time: the fit's methods, and the whole chain from coarse to fine (for tests/bench)."""

import json
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as stages/fit.py does

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[2]
HEAD = ("curve", "scene", "method", "setting", "iteration", "cpu_s", "reflectance_error", "gamma_error")
SETTINGS = [
    (75, 0.16, 64, 64, 4096),
    (150, 0.08, 128, 128, 8192),
    (300, 0.04, 128, 128, 8192),
    (300, 0.02, 256, 256, 16384),
    (300, 0.01, 512, 512, 32768),
    (600, 0.005, 1024, 1024, 65536),
]  # patches, contrast, rays; rays per tile, per facet


class Case:
    """A shipped scene: index buffers once, the rest at any setting. Truth is read to score, and by nothing else."""

    def __init__(self, name, folder=None):
        """folder : of another scene with the same truth, by default data/<name>"""
        from lib.buffers import edges, index_buffer, opengl, trust
        from lib.given import cameras, image, model

        folder = folder or ROOT / "data" / name
        self.name = name
        self.facts = yaml.safe_load((folder / "scene.yaml").read_text())
        self.model = model.load(folder / "model.obj")
        self.camera = cameras.read_cameramodel(folder / "left.posed.cameramodel")
        self.photograph = image.read_photograph(
            next(p for p in sorted(folder.glob("left.*")) if p.suffix in (".png", ".exr"))
        )
        begin = time.process_time()
        try:
            index = index_buffer.draw(self.model, self.camera)
        except opengl.NoGraphics:
            index = index_buffer.reference(self.model, self.camera)
        hidden = edges.visible_edges(self.model, self.camera, index.facet, index.depth)
        self.trusted = (
            trust.trusted(self.photograph, index.facet, hidden, self.model.facet_group, margin_px=2, keep=0.5).mask > 0
        )
        self.index_s = time.process_time() - begin
        self.facet = index.facet
        truth = json.loads((folder / "truth" / "materials.json").read_text())
        shown = np.bincount(image.read_labels(folder / "truth" / "group.png").ravel())[1:]
        legend = json.loads((folder / "truth" / "legend.json").read_text())["groups"]
        enough = (
            {g for g, n in zip(legend, shown, strict=False) if n >= 500}
            - set(self.facts["lamps"])
            - set(self.facts.get("reference", {}))
        )
        self.scored = [(self.model.groups.index(g), np.array(truth["groups"][g]["rho_d"])) for g in sorted(enough)]
        self.gamma = truth["transfer"].get("gamma", 1.0)

    def problem(self, patches, contrast, rays, per_tile, per_facet):
        """The inverse problem, and the CPU seconds until it stands (index included)."""
        from lib.analysis.fit import facts
        from lib.analysis.seen import gather
        from lib.given.view import View
        from lib.light import adapt, factors_file, form_factors
        from lib.light import lamps as lamps_
        from lib.light import surface as surfaces

        begin = time.process_time()
        lamps = list(self.facts["lamps"])
        surface = surfaces.surface(self.model, lamps)
        emitters = lamps_.emitters(surface, lamps)
        mesh = adapt.build(surface, patches=patches, max_level=5, contrast=contrast, emitters=emitters)
        rows = form_factors.rays(surface, mesh, n_rays=rays)
        factor = lamps_.patch_direct(surface, mesh, emitters, len(lamps), n_points=32)
        area = surfaces.group_areas(surface)
        factors = factors_file.FormFactors(
            mesh,
            rows,
            factor,
            tuple(lamps),
            surface.group[mesh.side // 2],
            self.model.groups,
            area,
            surface.local.diagonal,
        )
        view = View(self.camera, self.model, self.photograph, self.facet)
        sampling = gather.Sampling(rays_per_tile=per_tile, rays_per_facet=per_facet)
        self.view, self.factors = view, factors
        self.found = found = gather.gathered(view, surface, factors, self.trusted, sampling)
        made = facts.problem_of(
            factors, found, lamps=self.facts["lamps"], reference=self.facts.get("reference", {}), transfer=None
        )
        return made, self.index_s + time.process_time() - begin

    def errors(self, state):
        error = np.concatenate([np.abs(state.rho[g] / rho[: state.rho.shape[1]] - 1) for g, rho in self.scored])
        return float(error.mean()), float(abs(state.gamma - self.gamma))


def measure(log):
    """Rows of HEAD for `office` and `gallery-white`."""
    from lib.analysis.fit import gauss_newton, paper

    methods = {
        "paper": lambda p, t: paper.paper(p, trace=t),
        "damped": lambda p, t: paper.paper(p, damped=True, trace=t),
        "gauss-newton": lambda p, t: gauss_newton.gauss_newton(p, trace=t),
    }
    rows = []
    for scene in ("office", "gallery-white"):
        case = Case(scene)
        case.problem(*SETTINGS[0])  # warm-up
        for number, setting in enumerate(SETTINGS):
            problem, cpu_s = case.problem(*setting)
            begin = time.process_time()
            result = gauss_newton.gauss_newton(problem)
            rows.append(
                (
                    "chain",
                    scene,
                    "gauss-newton",
                    number,
                    result.iterations,
                    cpu_s + time.process_time() - begin,
                    *case.errors(result.state),
                )
            )
            log(*rows[-1])
            if number != 4:
                continue
            for method, run in methods.items():
                spent, mark = [0.0], [time.process_time()]

                def trace(iteration, image_rmse, state):
                    spent[0] += time.process_time() - mark[0]
                    rows.append(("fit", scene, method, number, iteration, spent[0], *case.errors(state)))
                    mark[0] = time.process_time()  # measuring is not timed

                run(problem, trace)
                log(*rows[-1])
    return HEAD, rows


def plot(rows, axes):
    """Left: the chain; right: the methods at the default setting."""
    style = {"paper": "C3", "damped": "C1", "gauss-newton": "C0"}
    for scene, line in (("office", "-o"), ("gallery-white", "--s")):
        chain = [r for r in rows if r[0] == "chain" and r[1] == scene]
        axes[0].loglog([r[5] for r in chain], [r[6] for r in chain], line, label=scene)
        for method, colour in style.items():
            fit = [r for r in rows if r[0] == "fit" and r[1] == scene and r[2] == method]
            axes[1].loglog(
                [max(r[5], 1e-3) for r in fit],
                [r[6] for r in fit],
                line,
                color=colour,
                ms=3,
                label=f"{method}, {scene}",
            )
    axes[0].axhline(0.005, color="0.6", lw=0.8)
    axes[0].set(title="whole chain, coarse to fine", xlabel="CPU s until the fit's end, imports and compilation apart")
    axes[1].set(title="methods of the fit, stored light", xlabel="CPU s of the fit")
    for ax in axes[:2]:
        ax.set_ylabel("mean relative reflectance error")
