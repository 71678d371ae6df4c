#!/usr/bin/env python3
"""What this machine has of what the stages need, and what to do about what is missing.

    $ make doctor

`NEEDS` are the names that pipeline.yaml uses under `needs`; lib/planning/walk.py asks `refusals` for those that a
plan needs.
"""

import argparse
import ctypes
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from lib.core import stage
from lib.core.stage import BadInput

ROOT = Path(__file__).resolve().parents[2]
MESA = "apt-get install libegl1 libgl1 libgl1-mesa-dri"


class Need(NamedTuple):
    """Something of the system."""

    there: Callable[[], bool]  # cheap: no graphics context is made
    remedy: str
    without: str | None  # what happens without; None: the stage is refused


def _has_egl():
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    return True


def _has_mrcal():
    return shutil.which("mrcal-calibrate-cameras") is not None


NEEDS = {
    "egl": Need(_has_egl, MESA, "rays are cast instead, which gives the same answer"),
    "mrcal": Need(_has_mrcal, "apt-get install mrcal python3-mrcal", None),
}


def refusals(need, stage_name) -> list[str]:
    """Problems that stop a plan whose stage needs something; a need with a way round only warns."""
    if need not in NEEDS:
        raise BadInput(f"pipeline.yaml: {stage_name}.needs: {need} is none of {', '.join(NEEDS)}")
    there, remedy, without = NEEDS[need]
    if there():
        return []
    if without:
        print(f"plan.py: warning: {stage_name} finds no {need}: {without} ({remedy})", file=sys.stderr)
        return []
    return [f"{need}: not installed, and the stage {stage_name} needs it: {remedy}"]


# ---- each check yields (mark, what, what to do): "ok", "--" for what only some scenes need, "!!" ----


def _mark(good):
    return "ok" if good else "!!"


def check_python():
    """3.11 or newer."""
    yield (
        _mark(sys.version_info >= (3, 11)),
        f"Python {sys.version.split()[0]} ({sys.executable})",
        "Python 3.11 or newer: apt-get install python3 python3-venv",
    )


def check_make():
    """GNU Make 4.3 or newer."""
    try:
        first = subprocess.run(["make", "--version"], capture_output=True, text=True).stdout.split("\n")[0]
    except OSError:
        yield "!!", "GNU Make: not found", "apt-get install make"
        return
    number = re.search(r"(\d+)\.(\d+)", first)
    good = "GNU" in first and number and tuple(map(int, number.groups())) >= (4, 3)
    yield _mark(good), first, "GNU Make 4.3 or newer (grouped targets): apt-get install make"


def check_packages():
    """Those of requirements.lock."""
    locked = re.findall(r"^([A-Za-z0-9_.-]+)==([^\s\\;]+)", (ROOT / "requirements.lock").read_text(), re.M)
    wrong = 0
    for name, version in locked:
        try:
            found = metadata.version(name)
        except metadata.PackageNotFoundError:
            found = None
        if found != version:
            wrong += 1
            yield "!!", f"{name} {found or 'is missing'}, locked {version}", "rm -rf .venv; make setup"
    if not wrong:
        yield "ok", f"{len(locked)} Python packages, all of the versions in requirements.lock", ""


def check_egl():
    """OpenGL without a screen."""
    try:
        import moderngl

        context = moderngl.create_context(standalone=True, backend="egl")
        info = context.info
        context.release()
        yield "ok", f"EGL: OpenGL {info['GL_VERSION']}, {info['GL_RENDERER']}", ""
    except Exception as error:  # whatever the driver throws: the point here is to say so
        yield "!!", f"EGL: no OpenGL context ({' '.join(str(error).split())}); the index is cast by rays instead", MESA


def check_embree():
    """One ray on one triangle."""
    try:
        import numpy as np
        import open3d as o3d

        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], np.float32), np.array([[0, 1, 2]], np.uint32))
        hit = scene.cast_rays(np.array([[0.2, 0.2, 0, 0, 0, 1]], np.float32))["t_hit"].numpy()[0]
        yield (
            _mark(abs(hit - 1) < 1e-6),
            f"Embree through open3d {o3d.__version__}: a ray meets a triangle at {hit:.6f} (1)",
            "rm -rf .venv; make setup",
        )
    except Exception as error:
        yield (
            "!!",
            f"Embree through open3d: {' '.join(str(error).split())}",
            "apt-get install libgl1 libgomp1 libx11-6 libusb-1.0-0, then rm -rf .venv; make setup",
        )


def check_mrcal():
    """Only scenes with boards/ need it."""
    need = NEEDS["mrcal"]
    if need.there():
        yield "ok", "mrcal", need.remedy
    else:
        yield "--", "mrcal: not installed; only scenes with boards/ need it", need.remedy


def check_fonts():
    """Nothing needs them."""
    remedy, families = "apt-get install fontconfig fonts-dejavu-core", set()
    if shutil.which("fc-list"):
        listed = subprocess.run(["fc-list", ":", "family"], capture_output=True, text=True).stdout
        families = set(listed.split("\n")) - {""}
    if families:
        yield "ok", f"fonts: {len(families)} families on this system", remedy
    else:
        yield "--", "fonts: none found here; the report uses the reader's, its plots matplotlib's own", remedy


def check_machine():
    """2 GiB of memory or more."""
    kib = re.search(r"MemAvailable:\s+(\d+)", Path("/proc/meminfo").read_text())
    gib = int(kib[1]) / 2**20 if kib else 0
    free = shutil.disk_usage(ROOT).free / 2**30
    yield (
        _mark(gib > 2),
        f"{len(os.sched_getaffinity(0))} cores, {gib:.1f} GiB memory free, {free:.0f} GiB disk free",
        "2 GiB of memory or more",
    )


CHECKS = (check_python, check_make, check_packages, check_egl, check_embree, check_mrcal, check_fonts, check_machine)


def main(opt):
    bad = 0
    for check in CHECKS:
        for mark, what, remedy in check():
            print(f"{mark}  {what}" + (f"\n      -> {remedy}" if mark != "ok" and remedy else ""))
            bad += mark == "!!"
    print("everything is there" if not bad else f"{bad} to mend")
    if bad and opt.strict:
        sys.exit(1)


def options():
    parser = argparse.ArgumentParser(prog="doctor.py", description=__doc__.split("\n")[0])
    parser.add_argument("--strict", action="store_true", help="exit status 1 if something is to mend")
    return parser


if __name__ == "__main__":
    stage.run(main, options())
