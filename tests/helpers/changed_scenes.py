"""Shipped scenes with something changed, run as a user runs them."""

import json
import os
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def clean():
    """The environment of a make that no other make has called."""
    return {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k not in ("MFLAGS", "BUILD", "DATA")}


def deviated(tmp_path, change, name="flat-grey"):
    """(build folder, materials.json, largest error in sigma) of a scene after change(folder)."""
    folder = tmp_path / "data" / name
    shutil.copytree(ROOT / "data" / name, folder)
    change(folder)
    words = ["make", f"DATA={tmp_path}/data", f"BUILD={tmp_path}/build", name]
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
