"""The shipped office at a quarter of its size, run through make as a user would: what real stages write, in seconds.

It is built into build/tests and stays there: Make remakes what an edit touches.
"""

import os
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from lib.given import cameras, image

ROOT = Path(__file__).resolve().parents[2]
OFFICE = ROOT / "data/office"
FOLDER = ROOT / "build/tests/small"
SMALLER = 4


def write(folder):
    """The scene's folder, with its truth."""
    (folder / "truth").mkdir(parents=True)
    for name in ("model.obj", "model.mtl", "truth/materials.json", "truth/legend.json"):
        shutil.copyfile(OFFICE / name, folder / name)
    photograph = cv2.imread(str(OFFICE / "left.png"))
    camera = cameras.read_cameramodel(OFFICE / "left.posed.cameramodel")
    W, H = camera.width // SMALLER, camera.height // SMALLER
    K = camera.K.copy()
    K[:2] /= SMALLER
    K[:2, 2] += 0.5 / SMALLER - 0.5  # (0, 0) is a pixel's centre
    cv2.imwrite(str(folder / "left.png"), cv2.resize(photograph, (W, H), interpolation=cv2.INTER_AREA))
    cameras.write_cameramodel(folder / "left.posed.cameramodel", replace(camera, K=K, width=W, height=H))
    group = image.read_labels(OFFICE / "truth/group.png")
    image.write_png16(
        folder / "truth/group.png", np.ascontiguousarray(group[SMALLER // 2 :: SMALLER, SMALLER // 2 :: SMALLER])
    )
    scene = (OFFICE / "scene.yaml").read_text().partition("goals:")[0]
    (folder / "scene.yaml").write_text(scene + "\ngoals: [materials.json, rendered.png, scorecard.csv, report.html]\n")


def run():
    """The folder of everything that make left."""
    with tempfile.TemporaryDirectory() as new:
        write(Path(new) / "office")
        replace_what_differs(Path(new), FOLDER / "data")
    clean = {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k not in ("MFLAGS", "BUILD", "DATA")}
    words = ["make", f"DATA={FOLDER / 'data'}", f"BUILD={FOLDER / 'build'}", "office"]
    result = subprocess.run(words, cwd=ROOT, env=clean, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return FOLDER / "build/office"


def replace_what_differs(new, old):
    """Copies the files under `new` to `old`, but for those of the same content, which keep their times."""
    for path in (p for p in new.rglob("*") if p.is_file()):
        target = old / path.relative_to(new)
        if not target.is_file() or target.read_bytes() != path.read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
