"""Faults while real stages run, counted: python -m tests.bench.faults [trials] [seed]

After each fault the next `make` must leave the same bytes as a make that nothing disturbed, and no `.partial`. Apart
stay times, memory and what shows them: reports, the page, the columns of the scorecard.

killed, interrupted   SIGKILL and SIGINT to make and all that it started, at a random moment
disk full             the build folder in a RAM disk that is too small (root only): one line for a stage, exit status 1
read-only             a build folder that may not be written: one line
two at once           two makes of the same scene
future, clock back    inputs whose time lies in the future; a build whose time does
changed in mid-run    another photograph while stages run
truncated             each artefact cut to half
"""

import csv
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2

from tests.helpers import mistakes

ROOT = Path(__file__).resolve().parents[2]
SCENE = """
lamps: {lamp: [3, 3, 3]}
explain: []
goals: [materials.json, rendered.png, report.html]
params:
  index: {method: rays, margin_px: 0}
  coverage: {method: rays}
  formfactors: {patches: 40, max_level: 1, rays: 64}
  gather: {rays_per_tile: 16, rays_per_facet: 256}
  render: {rays: 16, shadow_rays: 4}
"""
TIMES = ("wall_s", "cpu_s", "peak_mb")
SHOWN = ("plan.mk", "report.html", "commands/seconds")
LINES = 12  # of stderr at the most: one for each stage that refuses, and Make's own


class Room:
    """A small scene, its build folder, and what an undisturbed make leaves there."""

    def __init__(self, folder):
        self.data, self.build = Path(folder) / "data", Path(folder) / "build"
        self.scene = mistakes.scene(self.data / "room")
        surfaces = ", ".join(f"{group}: diffuse" for group in ("bottom", "top", "north", "east", "south", "west"))
        (self.scene / "scene.yaml").write_text(f"{SCENE}surfaces: {{{surfaces}}}\n")
        self.out = self.build / "room"

    def begin(self, build=None):
        words = ["make", "-j2", f"PYTHON={sys.executable}", f"DATA={self.data}", f"BUILD={build or self.build}", "room"]
        environment = {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k != "MFLAGS"}
        environment |= {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        return subprocess.Popen(
            words,
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def make(self, build=None):
        """(exit status, lines of stdout, lines of stderr, seconds)"""
        begin = time.monotonic()
        process = self.begin(build)
        out, err = process.communicate()
        return process.returncode, out.splitlines(), err.splitlines(), time.monotonic() - begin

    def content(self):
        """{file: hash} of what must not differ."""
        found = {}
        for path in sorted(self.out.rglob("*")):
            name = path.relative_to(self.out).as_posix()
            if path.is_dir() or name in SHOWN or name.endswith(".report.json"):
                continue
            data = path.read_bytes()
            if path.name == "scorecard.csv":
                rows = [row for row in csv.DictReader(data.decode().splitlines()) if row["unit"] != "s"]
                data = "\n".join(str({k: v for k, v in row.items() if k not in TIMES}) for row in rows).encode()
            found[name] = hashlib.sha256(data).hexdigest()
        return found

    def partials(self):
        return [p for p in self.build.rglob("*") if ".partial" in p.name]

    def scratch(self):
        shutil.rmtree(self.build, ignore_errors=True)


class Count:
    """Faults and what they left."""

    def __init__(self):
        self.rows = {}

    def add(self, kind, good, why=""):
        injected, survived = self.rows.get(kind, (0, 0))
        self.rows[kind] = injected + 1, survived + bool(good)
        if not good:
            print(f"    {kind}: {why}", flush=True)

    def show(self):
        for kind, (injected, survived) in self.rows.items():
            print(f"{kind:32}{injected:6} injected{survived:6} survived")


def same(room, before):
    """ "" where the next make leaves the bytes of before, else what differs."""
    status, _, err, _ = room.make()
    if status:
        return f"exit {status}: {err[-2:]}"
    after = room.content()
    differs = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    left = room.partials()
    if differs or left:
        return f"differ: {differs[:4]}; left: {left[:2]}"
    status, out, _, _ = room.make()
    return "the make after it runs stages again" if any(line.startswith("[") for line in out) else ""


def stopped(room, count, before, seconds, kind, sign, rng):
    room.scratch()
    process = room.begin()
    time.sleep(rng.uniform(0.3, 1.0 * seconds))
    if process.poll() is None:
        os.killpg(process.pid, sign)
    err = process.communicate()[1]
    ours = "Traceback" in err and "Fatal Python error: init_" not in err  # Python's own start has not read our code yet
    why = "Traceback" if ours else same(room, before)
    count.add(kind, not why, why)


def disk_full(room, count, rng, needed):
    """A RAM disk of a random size that is too small."""
    disk = room.build.with_name("disk")
    disk.mkdir(exist_ok=True)
    size = rng.randrange(16, max(17, int(0.9 * needed)))
    if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", disk], capture_output=True).returncode:
        print("disk full: no RAM disk can be mounted here: not tried")
        return
    try:
        status, _, err, _ = room.make(disk)
        said = [line for line in err if not line.startswith("make")]
        left = [p for p in disk.rglob("*") if ".partial" in p.name]
        bad = "Traceback" in "\n".join(err) or status == 0 or len(said) > LINES or left
        bad = bad or not any("No space left on device" in line for line in said)
        count.add("disk full", not bad, f"{size} kB: exit {status}, left {left[:2]}: {err[-6:]}")
    finally:
        subprocess.run(["umount", disk], check=True)


def read_only(room, count):
    disk = room.build.with_name("disk")
    disk.mkdir(exist_ok=True)
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", disk], capture_output=True).returncode:
        print("read-only: nothing can be mounted here: not tried")
        return
    try:
        status, _, err, _ = room.make(disk)
        said = [line for line in err if not line.startswith("make")]
        good = status and len(said) == 1 and "Traceback" not in said[0]
        count.add("read-only build folder", good, f"exit {status}: {err}")
    finally:
        subprocess.run(["umount", disk], check=True)


def two_at_once(room, count, before):
    room.scratch()
    both = [room.begin() for _ in range(2)]
    ends = [(process.communicate()[1], process.returncode) for process in both]
    why = "" if all(status == 0 for _, status in ends) else f"{[(status, err[-200:]) for err, status in ends]}"
    count.add("two makes at once", not (why := why or same(room, before)), why)


def later(path, seconds):
    when = time.time() + seconds
    os.utime(path, (when, when))


def clocks(room, count, before):
    for kind, paths in (("inputs from the future", room.scene), ("a build from the future", room.out)):
        for path in sorted(paths.rglob("*"), key=lambda p: p.stat().st_mtime):
            later(path, 86_400)
        why = _quiet(room, before)
        count.add(kind, not why, why)


def _quiet(room, before):
    """ "" where the second make from now does nothing and the bytes are the same."""
    status, _, err, _ = room.make()
    said = [line for line in err if "future" in line]
    if status or any("Clock skew" in line for line in err) or len(said) != len(set(said)):
        return f"exit {status}: {err}"
    ran = [line for line in room.make()[1] if line.startswith("[")]
    after = {name: value for name, value in room.content().items() if not name.startswith("commands/")}
    kept = {name: value for name, value in before.items() if not name.startswith("commands/")}
    return f"it ran again: {ran}" if ran else "" if after == kept else "the bytes differ"


def changed(room, count, seconds, rng):
    """Another photograph in mid-run: the next make must leave what it would have made from the start."""
    one = (room.scene / "left.png").read_bytes()
    other = cv2.imencode(".png", 255 - cv2.imread(str(room.scene / "left.png")))[1].tobytes()
    room.scratch()
    process = room.begin()
    time.sleep(rng.uniform(0.5, 0.9 * seconds))
    (room.scene / "left.png").write_bytes(other)
    process.communicate()
    status = room.make()[0]
    found = {k: v for k, v in room.content().items() if not k.startswith("commands/")}
    room.scratch()
    room.make()
    right = {k: v for k, v in room.content().items() if not k.startswith("commands/")}
    differs = sorted(k for k in found.keys() | right.keys() if found.get(k) != right.get(k))
    count.add("changed in mid-run", status == 0 and not differs, f"exit {status}, differ: {differs[:5]}")
    (room.scene / "left.png").write_bytes(one)


def truncated(room, count, before):
    """Each artefact in turn."""
    room.scratch()
    room.make()
    for path in sorted(p for p in room.out.iterdir() if p.is_file() and p.name != "plan.mk"):
        data = path.read_bytes()
        path.write_bytes(data[: len(data) // 2])
        why = same(room, before)
        count.add("truncated", not why, f"{path.name}: {why}")


def main(trials=6, seed=1):
    rng, count = random.Random(int(seed)), Count()
    with tempfile.TemporaryDirectory() as folder:
        room = Room(folder)
        status, _, err, seconds = room.make()
        assert status == 0, err
        room.scratch()
        seconds = room.make()[3]
        before, needed = room.content(), sum(p.stat().st_size for p in room.out.rglob("*") if p.is_file()) // 1024
        print(f"undisturbed: {seconds:.0f} s, {len(before)} files, {needed} kB", flush=True)
        for _ in range(int(trials)):
            stopped(room, count, before, seconds, "SIGKILL", signal.SIGKILL, rng)
            stopped(room, count, before, seconds, "SIGINT", signal.SIGINT, rng)
            disk_full(room, count, rng, needed)
        read_only(room, count)
        two_at_once(room, count, before)
        truncated(room, count, before)
        clocks(room, count, before)
        for _ in range(max(1, int(trials) // 3)):
            changed(room, count, seconds, rng)
        count.show()
    return sum(injected - survived for injected, survived in count.rows.values())


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]) != 0)
