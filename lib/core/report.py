"""Every run of a stage leaves <stage>.report.json: status, times, memory, versions, inputs, errors and a trace.

    with Report.of(opt) as report:
        with report.excluded("imports"):
            import numpy as np
        with report.timing("solve"):
            ...
        report.trace(iteration=1, image_rms=0.02)
        report.error("light_balance", 1e-9, unit="1", against="eq. 3.2")

`cpu_s` is the processor time of all threads and of finished child processes, `wall_s` the time on the clock.  Both run
since the report began, without what `excluded` took.  That is listed apart, in CPU seconds as `imports_s`, `compile_s`
and so on, on the clock as `imports_wall_s`, `compile_wall_s` and so on.  Imports include what ran before the report
began: the interpreter and the modules at the top of the stage.  Kernels that are compiled or read from their cache, and
heavy packages that are imported where they are first needed, list themselves (lib/core/apart.py).

`waited_s` is what a user waits: the clock since the process began.  It is `wall_s` and all that is listed apart.
"""

import contextlib
import hashlib
import os
import resource
import sys
import time
from pathlib import Path
from typing import NamedTuple

from lib.core import apart, artefact, stage
from lib.core.stage import BadInput

# modules -> packages; those that a stage really loaded are listed in its report
PACKAGES = {
    "numpy": "numpy",
    "scipy": "scipy",
    "numba": "numba",
    "cv2": "opencv-contrib-python-headless",
    "open3d": "open3d",
    "moderngl": "moderngl",
    "OpenEXR": "OpenEXR",
    "colour": "colour-science",
    "jinja2": "Jinja2",
    "yaml": "PyYAML",
    "trimesh": "trimesh",
    "mapbox_earcut": "mapbox_earcut",
    "matplotlib": "matplotlib",
    "mitsuba": "mitsuba",
    "pycolmap": "pycolmap",
}


class Clocks(NamedTuple):
    """Two clocks, in seconds; the zero of a difference does not matter."""

    cpu: float  # of all threads, and of child processes that have ended
    wall: float

    @classmethod
    def now(cls):
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return cls(time.process_time() + children.ru_utime + children.ru_stime, time.perf_counter())

    def since(self, begin):
        return Clocks(self.cpu - begin.cpu, self.wall - begin.wall)

    def plus(self, other):
        return Clocks(self.cpu + other.cpu, self.wall + other.wall)


def age_s() -> float:
    """Seconds since this process began, from /proc, to 10 ms; 0 where that cannot be read."""
    try:
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])  # since the system's start
        return max(0.0, time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK"))
    except (OSError, ValueError, IndexError, AttributeError):
        return 0.0


def peak_mb() -> float:
    """The most memory that this process, or one of its children, has held, MiB."""
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(kind).ru_maxrss for kind in kinds) / 1024  # Linux counts in KiB


def sha256(path) -> str:
    """Hash of a file's content."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Python's version, and those of the packages that were loaded.

    As the packages say themselves: importlib.metadata takes 0.06 s to import and to search.
    """
    loaded = {package: sys.modules[module] for module, package in PACKAGES.items() if module in sys.modules}
    found = {package: getattr(module, "__version__", None) for package, module in loaded.items()}
    return {"python": ".".join(map(str, sys.version_info[:3]))} | {p: str(v) for p, v in found.items() if v}


class Note(str):
    """A line that asks for nothing, among lines that are warnings: `Report.warning` puts it among the notes.

    >>> [isinstance(line, Note) for line in (Note("3 were dropped"), Note("3 were dropped").of("a.obj"), "mend it")]
    [True, True, False]
    """

    def of(self, path):
        """The same of a file."""
        return Note(f"{path}: {self}")


class Report:
    """A context manager; the file appears whole when the block ends well, and not at all when it raises."""

    def __init__(self, path, inputs=(), arguments=None, outputs=()):
        self.path, self.arguments, self.outputs = path, dict(arguments or {}), outputs
        self.inputs = [os.fspath(p) for p in inputs if p]
        self.status = "complete"
        self.warnings, self.notes, self.errors, self._trace = [], [], [], []
        self._timings, self._more = {}, {}
        self._apart = {}  # label -> Clocks: what was excluded
        self._inside = None  # the clocks at the start of an `excluded` that is still open

    @classmethod
    def of(cls, opt, more_inputs=()):
        """The report of a stage whose options are those of `stage.parser`."""
        return cls(opt.report, [*stage.inputs(opt), *more_inputs], stage.arguments(opt), stage.outputs(opt))

    def __enter__(self):
        missing = [p for p in self.inputs if not os.path.exists(p)]
        if missing:
            raise BadInput(*(f"{p}: there is no such file" for p in missing))
        self._begin = Clocks.now()
        self._before = self._apart["imports"] = Clocks(self._begin.cpu, age_s())
        apart.opened.append(self)
        return self

    def clocks(self) -> Clocks:
        """Time since the report began, less what was excluded; both clocks stand still inside `excluded`."""
        elapsed = (self._inside or Clocks.now()).since(self._begin)
        cpu = sum(each.cpu for each in self._apart.values()) - self._before.cpu
        wall = sum(each.wall for each in self._apart.values()) - self._before.wall
        return elapsed.since(Clocks(cpu, wall))

    @contextlib.contextmanager
    def excluded(self, label):
        """Time that is listed as <label>_s and <label>_wall_s, and counts neither in cpu_s nor in a timing.

        Within another `excluded` it is that one's.
        """
        if self._inside:
            yield
            return
        self._inside = Clocks.now()
        try:
            yield
        finally:
            self._apart[label] = self._apart.get(label, Clocks(0.0, 0.0)).plus(Clocks.now().since(self._inside))
            self._inside = None

    @contextlib.contextmanager
    def timing(self, label):
        """Cumulates under "timings": {label: {cpu_s, wall_s, calls}}."""
        begin = self.clocks()
        try:
            yield
        finally:
            took = self.clocks().since(begin)
            total = self._timings.setdefault(label, {"cpu_s": 0.0, "wall_s": 0.0, "calls": 0})
            total["cpu_s"] += took.cpu
            total["wall_s"] += took.wall
            total["calls"] += 1

    def trace(self, **values):
        """One point of the curve of error against time; `iteration` counts from 0 unless given."""
        cpu, wall = self.clocks()
        self._trace.append({"cpu_s": cpu, "wall_s": wall, "iteration": len(self._trace), **values})

    def error(self, name, value, *, unit=None, against=None):
        """An error that the stage can see, with its yardstick."""
        self.errors.append({"name": name, "value": value, "unit": unit, "against": against})

    def warning(self, text):
        """Something to do, or to beware of. Goes into the report and, at once, to stderr; the same text once only.

        A `Note` goes where notes go, so that lists may hold both.
        """
        if isinstance(text, Note):
            self.note(text)
        else:
            self._say("warning", text, self.warnings)

    def note(self, text):
        """What is good to know and asks for nothing: what was put right, left out or taken over."""
        self._say("note", text, self.notes)

    def about(self, path, lines):
        """Warnings and notes on a file."""
        for line in lines:
            self.warning(line.of(path) if isinstance(line, Note) else f"{path}: {line}")

    @staticmethod
    def _say(kind, text, said):
        text = " ".join(str(text).split())
        if text not in said:
            said.append(text)
            print(f"{os.path.basename(sys.argv[0]) or 'python'}: {kind}: {text}", file=sys.stderr)

    def __setitem__(self, key, value):
        self._more[key] = value

    def __getitem__(self, key):
        return self._more[key]

    def __exit__(self, kind, value, traceback):
        apart.opened.remove(self)
        if kind is not None:
            return False
        with self.excluded("hashing"):
            described = {
                "arguments": self.arguments,
                "versions": versions(),
                "inputs": {p: sha256(p) for p in self.inputs if os.path.isfile(p)},
            }
        if self.path:
            here = os.path.dirname(self.path) or "."
            there = [path for path in self.outputs if os.path.isfile(path)]
            described["output_bytes"] = {os.path.relpath(path, here): os.path.getsize(path) for path in there}
        cpu, wall = self.clocks()
        waited = wall + sum(each.wall for each in self._apart.values())
        fields = {"status": self.status, "wall_s": wall, "cpu_s": cpu, "waited_s": waited, "peak_mb": peak_mb()}
        for label, took in self._apart.items():
            fields[f"{label}_s"], fields[f"{label}_wall_s"] = took.cpu, took.wall
        fields |= {
            "timings": self._timings,
            "warnings": self.warnings,
            "notes": self.notes,
            "errors": self.errors,
            "trace": self._trace,
            **self._more,
            **described,
        }
        if self.path:
            artefact.write_json(self.path, fields)
        return False
