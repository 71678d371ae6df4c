"""Models in USD (usda, usdc, usdz) as an OBJ with its materials, where USD's own package, usd-core, is installed.

A process of its own reads the file (usd_process.py): what crashes USD, or takes too much, is one line here.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from lib.core.stage import BadInput
from lib.given.formats import Format

FLAT = "flatten it: usdcat --flatten -o flat.usdc"
FORMAT = Format(
    "USD (usda, usdc, usdz)",
    read=(
        "meshes; cubes and planes; spheres, cylinders, cones and capsules as facets; what is in the purposes render "
        "and default, at the earliest time code",
        "sublayers, references, payloads, variants, inherits and instances, of files in the model's folder",
        "point instancers; skinned meshes in their pose, in instances too",
        "bound materials and subsets of the family materialBind",
    ),
    refused=(
        ("a file outside the model's folder, or one that is not there", FLAT),
        ("value clips, asset paths with expressions, packages in packages", FLAT),
        ("composition to far more prims than the file holds", "load fewer instances"),
        ("NURBS patches and tetrahedra", "make meshes of them"),
    ),
    left_out=(
        "proxies and guides, invisible and inactive prims, holes",
        "lights without faces, cameras, curves, points, volumes, prims of unknown types, pictures of materials",
        "subdivision: the control cage is read",
    ),
)
WITHOUT = (
    "is a USD file, and its package is not installed: .venv/bin/python -m pip install usd-core, or export OBJ or GLB"
)
ROOT = Path(__file__).resolve().parents[2]
MODULE = ("-m", "lib.given.usd_process")
WALL_S = 300  # after which a process that waits for nothing is ended; its CPU time ends far earlier
SETTINGS = {
    "PXR_WORK_THREAD_LIMIT": "1",  # threads' stacks count as memory
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_ARENA_MAX": "1",
    "USD_SHADE_MATERIAL_BINDING_API_CHECK": "allowMissingAPI",  # bindings as tools wrote them before 2022
}


def read(path) -> tuple[list, dict, list]:
    """([(object, group, points (V, 3) m, faces)], {group: emits}, lines to say) of the meshes that are shown.

    Points stand in the stage's own axes, in metres by its metersPerUnit. A group is the material that is bound to a
    mesh or to a subset of its faces; lights of USD's own, which have no faces, are named in a line.
    BadInput: no package, a file that it cannot open, shapes that are no meshes, no faces; see FORMAT
    """
    try:
        importlib.import_module("pxr")
    except ImportError:
        raise BadInput(f"{path}: {WITHOUT}") from None
    # nothing is found by its bare name: neither in the current folder, nor along USD's search path
    env = {key: value for key, value in os.environ.items() if not key.startswith(("PXR_", "USD_"))}
    env |= {**SETTINGS, "PYTHONPATH": str(ROOT)}
    with tempfile.TemporaryDirectory() as scratch:
        answer, empty = f"{scratch}/answer", Path(scratch) / "empty"
        empty.mkdir()
        argv = [sys.executable, *MODULE, str(path), Path(path).absolute(), answer]
        try:
            done = subprocess.run(
                argv, cwd=empty, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=WALL_S
            )
        except subprocess.TimeoutExpired:
            raise BadInput(f"{path}: USD's package came to no end within {WALL_S} s: {FLAT}") from None
        return answered(path, answer, done.returncode)


def answered(path, answer, status):
    """What `read` returns or raises, of what usd_process wrote and how it ended."""
    if Path(f"{answer}.npz").is_file():
        with np.load(f"{answer}.npz", allow_pickle=False) as arrays:
            return _parts(arrays)
    if Path(f"{answer}.json").is_file():
        told = json.loads(Path(f"{answer}.json").read_text(encoding="utf-8"))
        if "problems" in told:
            raise BadInput(*told["problems"])
        raise RuntimeError(f"usd_process: {told['traceback']}")
    raise BadInput(f"{path}: {_ended(status)}")


def _ended(status):
    """Words for how the process ended that left no answer."""
    if -status in (signal.SIGXCPU, signal.SIGKILL):
        return f"takes USD's package too long: it is damaged, or composes far more than it holds; {FLAT}"
    name = signal.Signals(-status).name if -status in set(signal.Signals) else f"status {status}"
    return f"USD's package broke off ({name}): it is damaged, or takes more memory than a file of its size should"


def _parts(arrays):
    """What usd_process.write wrote."""
    told = json.loads(arrays["told"].tobytes())
    points, counts, corners = arrays["points"], arrays["counts"], arrays["corners"]
    parts, at = [], [0, 0, 0]
    for thing, group, *sizes in told["parts"]:
        p, n, c = (slice(start, start + size) for start, size in zip(at, sizes, strict=True))
        faces = np.split(corners[c], np.cumsum(counts[n])[:-1])
        parts.append((thing, group, points[p], [tuple(face.tolist()) for face in faces]))
        at = [p.stop, n.stop, c.stop]
    return parts, told["emits"], told["said"]
