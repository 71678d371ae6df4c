#!/usr/bin/env python3
"""What this machine has of what the stages need, and what to do about what is missing.

    $ make doctor

`NEEDS` are the names that pipeline.yaml uses under `needs`; lib/plan.py asks `refusals` for those that a plan needs.
"""
import argparse
import ctypes
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from lib import stage
from lib.stage import BadInput

ROOT = Path(__file__).resolve().parents[1]
MESA = "apt-get install libegl1 libgl1 libgl1-mesa-dri"


def _loads(*names):
    for name in names:
        try:
            ctypes.CDLL(name)
        except OSError:
            return False
    return True


# name -> (is it there? cheap, no context made; what to do; what happens without, or None: the stage is refused)
NEEDS = {
    "egl": (lambda: _loads("libEGL.so.1"), MESA, "rays are cast instead, which gives the same answer"),
    "mrcal": (lambda: shutil.which("mrcal-calibrate-cameras") is not None, "apt-get install mrcal python3-mrcal", None),
}


def refusals(need, stage_name):
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

def check_python():
    good = sys.version_info >= (3, 11)
    yield "ok" if good else "!!", f"Python {sys.version.split()[0]} ({sys.executable})", "Python 3.11 or newer: apt-get install python3 python3-venv"


def check_make():
    try:
        first = subprocess.run(["make", "--version"], capture_output=True, text=True).stdout.split("\n")[0]
    except OSError:
        yield "!!", "GNU Make: not found", "apt-get install make"
        return
    number = re.search(r"(\d+)\.(\d+)", first)
    good = "GNU" in first and number and tuple(map(int, number.groups())) >= (4, 3)
    yield "ok" if good else "!!", first, "GNU Make 4.3 or newer (grouped targets): apt-get install make"


def check_packages():
    from importlib import metadata
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
    try:
        import moderngl
        context = moderngl.create_context(standalone=True, backend="egl")
        info = context.info
        context.release()
        yield "ok", f"EGL: OpenGL {info['GL_VERSION']}, {info['GL_RENDERER']}", ""
    except Exception as error:         # whatever the driver throws: the point here is to say so
        yield "!!", f"EGL: no OpenGL context ({' '.join(str(error).split())}); the index is cast by rays instead", MESA


def check_embree():
    try:
        import numpy as np
        import open3d as o3d
        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], np.float32), np.array([[0, 1, 2]], np.uint32))
        hit = scene.cast_rays(np.array([[.2, .2, 0, 0, 0, 1]], np.float32))["t_hit"].numpy()[0]
        yield "ok" if abs(hit - 1) < 1e-6 else "!!", f"Embree through open3d {o3d.__version__}: a ray meets a triangle at {hit:.6f} (1)", "rm -rf .venv; make setup"
    except Exception as error:
        yield "!!", f"Embree through open3d: {' '.join(str(error).split())}", "apt-get install libgl1 libgomp1 libx11-6 libusb-1.0-0, then rm -rf .venv; make setup"


def check_mrcal():
    there, remedy, _ = NEEDS["mrcal"]
    yield "ok" if there() else "--", "mrcal" if there() else "mrcal: not installed; only scenes with boards/ need it", remedy


def check_fonts():
    families = set()
    if shutil.which("fc-list"):
        families = set(subprocess.run(["fc-list", ":", "family"], capture_output=True, text=True).stdout.split("\n")) - {""}
    yield "ok" if families else "--", f"fonts: {len(families)} families on this system" if families else \
        "fonts: none found here; the report uses the reader's, its plots matplotlib's own", "apt-get install fontconfig fonts-dejavu-core"


def check_machine():
    kib = re.search(r"MemAvailable:\s+(\d+)", Path("/proc/meminfo").read_text())
    gib = int(kib[1]) / 2**20 if kib else 0
    free = shutil.disk_usage(ROOT).free / 2**30
    yield "ok" if gib > 2 else "!!", f"{len(os.sched_getaffinity(0))} cores, {gib:.1f} GiB memory free, {free:.0f} GiB disk free", "2 GiB of memory or more"


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


parser = argparse.ArgumentParser(prog="doctor.py", description=__doc__.split("\n")[0])
parser.add_argument("--strict", action="store_true", help="exit status 1 if something is to mend")

if __name__ == "__main__":
    stage.run(main, parser)
