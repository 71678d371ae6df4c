"""Shipped scenes with something changed, run as a user runs them."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]


def clean():
    """The environment of a make that no other make has called."""
    return {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k not in ("MFLAGS", "BUILD", "DATA")}


def deviated(tmp_path, change, name="flat-grey", until="fit"):
    """(build folder, materials.json, largest error in sigma) of a scene after change(folder).

    until : the last stage that is asked for: rendering costs as much as all that stands before it
    """
    folder = tmp_path / "data" / name
    shutil.copytree(ROOT / "data" / name, folder)
    change(folder)
    words = ["make", f"DATA={tmp_path}/data", f"BUILD={tmp_path}/build", f"{name}/{until}"]
    run = subprocess.run(words, cwd=ROOT, env=clean(), capture_output=True, text=True)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    build = tmp_path / "build" / name
    found = json.loads((build / "materials.json").read_text())
    truth = json.loads((folder / "truth/materials.json").read_text())
    off = [
        abs(a - b) / s
        for group, true in truth["groups"].items()
        if (mine := found["groups"].get(group)) and mine["identified"] and mine["pixels"] > 1000 and true["rho_d"]
        for a, b, s in zip(mine["rho_d"], true["rho_d"], mine["sigma"]["rho_d"], strict=True)
        if s  # mirrors have none
    ]
    return build, found, max(off, default=0)


def obj(folder, change):
    """model.obj with each line, and the object that it belongs to, changed; None drops it."""
    path, thing, lines = folder / "model.obj", "", []
    for line in path.read_text().splitlines():
        thing = line.removeprefix("o ") if line.startswith("o ") else thing
        lines.append(change(line, thing))
    path.write_text("\n".join(line for line in lines if line is not None) + "\n")


def vignetted(folder):
    """cos^4 with 37 degrees at the corner, seen through gamma 2.2."""
    path = str(folder / "left.png")
    values = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    H, W = values.shape[:2]
    y, x = np.indices((H, W))
    tangent = np.hypot(x - (W - 1) / 2, y - (H - 1) / 2) / np.hypot((W - 1) / 2, (H - 1) / 2) * np.tan(np.radians(37))
    V = np.cos(np.arctan(tangent)) ** 4
    darker = np.round(values * V[..., None] ** (1 / 2.2)).astype(values.dtype)
    cv2.imwrite(path, np.where(values == 255, values, darker))  # what shines stays white
