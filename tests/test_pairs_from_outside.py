"""Pairs as a stranger would give them, through make: what cannot be known is refused in one line and leaves no goal."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from lib.given import cameras, image

ROOT = Path(__file__).resolve().parents[1]


def make(folder, *words):
    clean = {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k not in ("MFLAGS", "BUILD", "DATA")}
    return subprocess.run(
        ["make", f"DATA={folder / 'data'}", f"BUILD={folder / 'build'}", *words],
        cwd=ROOT,
        env=clean,
        capture_output=True,
        text=True,
    )


@pytest.fixture
def attic(tmp_path):
    """The office's model, a calibrated pair of 160 x 120 photographs of nothing."""
    folder = tmp_path / "data/attic"
    folder.mkdir(parents=True)
    for name in ("model.obj", "model.mtl"):
        shutil.copyfile(ROOT / "data/office" / name, folder / name)
    K = np.array([[130.0, 0, 79.5], [0, 130.0, 59.5], [0, 0, 1]])
    for side, rt in (("left", [0.0] * 6), ("right", [0, 0.1, 0, -0.4, 0, 0])):
        image.write_png8(folder / f"{side}.png", np.full((120, 160, 3), 90))
        cameras.write_cameramodel(
            folder / f"{side}.cameramodel", cameras.Camera(K, 160, 120, cameras.matrix_from_rt(rt))
        )
    (folder / "scene.yaml").write_text("goals: [pose.json]\n")
    return tmp_path


def refused(run, folder):
    lines = [
        line
        for line in run.stderr.splitlines()
        if not (": warning: " in line or ": note: " in line) and not line.startswith("make")
    ]
    assert run.returncode == 2 and len(lines) == 1 and "Traceback" not in run.stderr, run.stderr
    assert not list((folder / "build/attic").glob("*pose*")) and not list((folder / "build/attic").glob("*posed*"))
    return lines[0]


@pytest.mark.outside
def test_photographs_of_nothing(attic):
    assert "0 facets cannot fix a pose" in refused(make(attic, "attic"), attic)


@pytest.mark.slow
@pytest.mark.outside
def test_photographs_of_noise(attic):
    rng = np.random.default_rng(0)
    for side in ("left", "right"):
        image.write_png8(attic / f"data/attic/{side}.png", rng.integers(60, 120, (120, 160, 3)))
    refused(make(attic, "attic"), attic)


@pytest.mark.outside
def test_one_centre_and_nothing_to_see(attic):
    """Two lenses alone: the relative pose would have to come from photographs that show nothing."""
    shutil.copyfile(attic / "data/attic/left.cameramodel", attic / "data/attic/right.cameramodel")
    assert refused(make(attic, "attic"), attic).startswith("orient.py: ")


def test_the_left_photograph_alone(attic):
    folder = attic / "data/attic"
    (folder / "right.png").unlink()
    (folder / "scene.yaml").write_text("goals: [left.regions.png]\nparams: {segment: {lambda: 0}}\n")
    rng = np.random.default_rng(0)
    values = rng.integers(0, 250, (120, 160, 3))
    image.write_png8(folder / "left.png", values)
    run = make(attic, "attic")
    assert run.returncode == 0, run.stderr
    labels = image.read_labels(attic / "build/attic/left.regions.png")
    assert (
        labels.max() > 19_000 and not (attic / "build/attic/right.regions.png").exists()
    )  # nearly every pixel is its own region
