"""lib/picture/gouraud.py and stages/radiosity.py: figure 3.9."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "data" / "flat-grey"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """flat-grey's index and form factors, coarse, and its materials from truth (a test may read it)."""
    out = tmp_path_factory.mktemp("flat-grey")
    run = lambda *words: subprocess.run([sys.executable, *map(str, words)], cwd=ROOT, check=True, capture_output=True)
    run(
        "stages/index.py",
        "--model",
        SCENE / "model.obj",
        "--camera",
        SCENE / "left.posed.cameramodel",
        "--photograph",
        SCENE / "left.png",
        "--facet",
        out / "facet.png",
    )
    run(
        "stages/formfactors.py",
        "--model",
        SCENE / "model.obj",
        "--lamps",
        json.dumps(["lamp"]),
        "--formfactors",
        out / "f.npz",
        "--patches",
        100,
        "--contrast",
        0.1,
        "--rays",
        64,
        "--report",
        out / "f.report.json",
    )
    return out


def spread(made, name, *more):
    out = made / f"{name}.png"
    words = [
        "stages/radiosity.py",
        "--model",
        SCENE / "model.obj",
        "--camera",
        SCENE / "left.posed.cameramodel",
        "--photograph",
        SCENE / "left.png",
        "--facet",
        made / "facet.png",
        "--formfactors",
        made / "f.npz",
        "--materials",
        SCENE / "truth" / "materials.json",
        "--pictures",
        out,
        "--report",
        made / f"{name}.json",
        *more,
    ]
    done = subprocess.run([sys.executable, *map(str, words)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out, json.loads((made / f"{name}.json").read_text())


@pytest.mark.scene
def test_every_solver_draws_the_same_end(made):
    from lib.light import factors_file
    from lib.picture import appearance, gouraud

    factors = factors_file.read(made / "f.npz")
    found, _, _ = appearance.read(str(SCENE / "truth" / "materials.json"), factors.groups, factors.lamps, 1, 0)
    rho, lamps = found.rho, found.E
    exact = gouraud.solve(factors, rho, lamps, method="direct", tolerance=1e-9).B
    for method in ("krylov", "gauss_seidel", "jacobi", "southwell"):
        B = gouraud.solve(factors, rho, lamps, method=method, tolerance=1e-6).B
        np.testing.assert_allclose(B, exact, atol=1e-5 * exact.max(), err_msg=method)
    # patches shoot as wholes: the light of each patch arrives, not each element's own share of it
    shot = gouraud.solve(factors, rho, lamps, method="progressive", tolerance=1e-6).B
    assert abs((factors.area @ shot) / (factors.area @ exact) - 1).max() < 0.01


@pytest.fixture(scope="module")
def sheet(made):
    return spread(made, "progressive", "--method", "progressive")


@pytest.mark.scene
def test_the_stage_writes_its_sheet(sheet):
    import cv2

    picture, report = sheet
    assert report["status"] == "converged" and report["pictures"] > 5
    image = cv2.imread(str(picture))
    rows = -(-report["pictures"] // 4)
    assert image.shape == (rows * 180, 4 * 240, 3)
    first, last = image[:180, :240], image[-180:][:, (report["pictures"] - 1) % 4 * 240 :][:, :240]
    assert last.mean() > first.mean() > 10  # light arrives
    residual = [point["residual"] for point in report["trace"]]
    assert residual[-1] < 0.01 * residual[0]


def test_the_trace_has_both_clocks_since_the_stage_began(sheet):
    """As SCENE.md says of every report. A fixed bug left wall_s out and began at the solve."""
    _, report = sheet
    trace = report["trace"]
    assert all({"cpu_s", "wall_s", "iteration", "residual"} == set(point) for point in trace) and len(trace) > 2
    for clock in ("cpu_s", "wall_s"):
        times = [point[clock] for point in trace]
        before = report["timings"]["canvas"][clock]
        assert before < times[0] and times == sorted(times) and times[-1] <= report[clock]
    assert [point["iteration"] for point in trace] == sorted(point["iteration"] for point in trace)


def test_form_factors_leave_a_trace(made):
    """One point for each level of the mesh; patches of constant light lose less and less. A fixed bug left no trace."""
    report = json.loads((made / "f.report.json").read_text())
    trace = report["trace"]
    assert len(trace) > 2 and all({"cpu_s", "wall_s", "iteration", "patches", "unevenness"} == set(p) for p in trace)
    patches, unevenness = ([point[key] for point in trace] for key in ("patches", "unevenness"))
    assert patches == sorted(patches) and patches[0] >= 50 and patches[-1] <= report["patches"]
    assert 0 < unevenness[-1] < 0.7 * unevenness[0] < 0.7
    assert [point["cpu_s"] for point in trace] == sorted(point["cpu_s"] for point in trace)


def test_a_constant_radiosity_is_drawn_constant(made):
    from lib.given import cameras, image, model
    from lib.light import factors_file
    from lib.light import surface as surfaces
    from lib.picture import gouraud

    factors = factors_file.read(made / "f.npz")
    facet = image.read_labels(made / "facet.png") - 1
    surface = surfaces.surface(model.load(SCENE / "model.obj"), factors.lamps)
    canvas = gouraud.Canvas(surface, factors.mesh, cameras.read_cameramodel(SCENE / "left.posed.cameramodel"), facet)
    drawn = canvas.draw(np.full((len(factors.mesh), 1), 0.7))[facet >= 0]
    assert np.mean(np.abs(drawn - 0.7) < 1e-9) > 0.99  # all but the cracks of contacts
