"""By scene: every shipped scene runs through make and keeps its two-sided bounds in tests/expected/<scene>.csv.

An error may become twice that of the run that the bounds were written from, and no better than a quarter of it:
`python -m tests.bench.bounds` writes them, and says the rule. office-1 to office-3 were never tuned on. A second make
does nothing.

The scenes are built into build/tests and stay there: Make remakes what an edit touches.
"""

import os
import subprocess
from pathlib import Path

import pytest

from lib.verdict import scorecard

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build/tests"
SCENES = sorted(path.stem for path in (ROOT / "tests/expected").glob("*.csv"))


def make(*words, build):
    clean = {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k not in ("MFLAGS", "BUILD", "DATA")}
    return subprocess.run(["make", f"BUILD={build}", *words], cwd=ROOT, env=clean, capture_output=True, text=True)


@pytest.mark.scene
@pytest.mark.parametrize("scene", SCENES)
def test_scene_keeps_its_bounds(scene):
    run = make(scene, build=BUILD)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    assert (BUILD / scene / "report.html").exists()
    assert scorecard.check(BUILD / scene / "scorecard.csv", ROOT / f"tests/expected/{scene}.csv") == []
    before = {p: p.stat().st_mtime_ns for p in (BUILD / scene).iterdir()}
    again = make(scene, build=BUILD)
    assert again.returncode == 0 and "stages/" not in again.stdout, again.stdout
    assert {p: p.stat().st_mtime_ns for p in (BUILD / scene).iterdir() if p in before} == before


def test_every_scene_with_truth_is_watched():
    assert (
        sorted(p.parent.name for p in (ROOT / "data").glob("*/truth") if (p.parent / "scene.yaml").is_file()) == SCENES
    )
