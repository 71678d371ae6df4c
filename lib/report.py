"""Every run of a stage leaves <stage>.report.json: status, times, memory, versions, inputs, errors and a trace.

    with Report(opt.report, inputs=[opt.model], arguments=vars(opt)) as report:
        with report.excluded("imports"):
            import numpy as np
        with report.timing("solve"):
            ...
        report.trace(iteration=1, image_rms=0.02)
        report.error("light_balance", 1e-9, unit="1", against="eq. 3.2")

`cpu_s` is the processor time of all threads and of finished child processes, `wall_s` the time on the clock; both since the
report began and both without what `excluded` took.  That is listed apart: `imports_s` (with whatever ran before the report
began: the interpreter and imports) and `compile_s`, in CPU seconds, and `imports_wall_s`, `compile_wall_s`.
"""
import contextlib
import hashlib
import os
import resource
import sys
import time
from pathlib import Path

from lib import artefact
from lib.stage import BadInput

# module -> its name among packages; those that a stage really loaded are listed in its report
PACKAGES = {"numpy": "numpy", "scipy": "scipy", "numba": "numba", "cv2": "opencv-contrib-python-headless",
            "open3d": "open3d", "moderngl": "moderngl", "OpenEXR": "OpenEXR", "colour": "colour-science",
            "yaml": "PyYAML", "trimesh": "trimesh", "mapbox_earcut": "mapbox_earcut", "matplotlib": "matplotlib",
            "mitsuba": "mitsuba", "pycolmap": "pycolmap"}


def _cpu_s():
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _age_s():
    """Seconds since this process began, from /proc; 0 where that cannot be read."""
    try:
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        up = float(Path("/proc/uptime").read_text().split()[0])
        return max(0.0, up - ticks / os.sysconf("SC_CLK_TCK"))
    except (OSError, ValueError, IndexError):
        return 0.0


def peak_mb():
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(kind).ru_maxrss for kind in kinds) / 1024      # Linux counts in KiB


def sha256(path):
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def versions():
    from importlib import metadata
    found = {"python": ".".join(map(str, sys.version_info[:3]))}
    for module, package in PACKAGES.items():
        if module in sys.modules:
            with contextlib.suppress(metadata.PackageNotFoundError):
                found[package] = metadata.version(package)
    return found


class Report:
    """A context manager; the file appears whole when the block ends well, and not at all when it raises."""

    def __init__(self, path, inputs=(), arguments=None):
        self.path, self.arguments = path, dict(arguments or {})
        self.inputs = [os.fspath(p) for p in inputs if p]
        self.status = "complete"
        self.warnings, self.errors, self._trace = [], [], []
        self._timings, self._more = {}, {}
        self._apart = {}                    # label -> [cpu, wall] excluded
        self._inside = None                 # the clocks at the start of an `excluded` that is still open

    def __enter__(self):
        missing = [p for p in self.inputs if not os.path.exists(p)]
        if missing:
            raise BadInput(*(f"{p}: there is no such file" for p in missing))
        self._begin = (_cpu_s(), time.perf_counter())
        self._apart["imports"] = [self._begin[0], _age_s()]
        self._before = tuple(self._apart["imports"])
        return self

    def clocks(self):
        """(cpu_s, wall_s) since the report began, less what was excluded; both stand still inside `excluded`."""
        cpu, wall = self._inside or (_cpu_s(), time.perf_counter())
        cpu_apart = sum(a[0] for a in self._apart.values()) - self._before[0]
        wall_apart = sum(a[1] for a in self._apart.values()) - self._before[1]
        return cpu - self._begin[0] - cpu_apart, wall - self._begin[1] - wall_apart

    @contextlib.contextmanager
    def excluded(self, label):
        """Time that is listed as <label>_s and counts neither in cpu_s nor in a timing; within another `excluded` it is that one's."""
        if self._inside:
            yield
            return
        self._inside = (_cpu_s(), time.perf_counter())
        try:
            yield
        finally:
            cpu, wall = _cpu_s() - self._inside[0], time.perf_counter() - self._inside[1]
            apart = self._apart.setdefault(label, [0.0, 0.0])
            apart[0] += cpu
            apart[1] += wall
            self._inside = None

    @contextlib.contextmanager
    def timing(self, label):
        """Cumulates under "timings": {label: {cpu_s, wall_s, calls}}."""
        cpu, wall = self.clocks()
        try:
            yield
        finally:
            cpu_end, wall_end = self.clocks()
            total = self._timings.setdefault(label, {"cpu_s": 0.0, "wall_s": 0.0, "calls": 0})
            total["cpu_s"] += cpu_end - cpu
            total["wall_s"] += wall_end - wall
            total["calls"] += 1

    def trace(self, **values):
        """One point of the curve of error against time; `iteration` counts from 0 unless given."""
        cpu, wall = self.clocks()
        self._trace.append({"cpu_s": cpu, "wall_s": wall, "iteration": len(self._trace), **values})

    def error(self, name, value, *, unit=None, against=None):
        self.errors.append({"name": name, "value": value, "unit": unit, "against": against})

    def warning(self, text):
        """Goes into the report and, at once, to stderr; the same text once only."""
        text = " ".join(str(text).split())
        if text not in self.warnings:
            self.warnings.append(text)
            print(f"{os.path.basename(sys.argv[0]) or 'python'}: warning: {text}", file=sys.stderr)

    def __setitem__(self, key, value):
        self._more[key] = value

    def __getitem__(self, key):
        return self._more[key]

    def __exit__(self, kind, value, traceback):
        if kind is not None:
            return False
        cpu, wall = self.clocks()
        fields = {"status": self.status, "wall_s": wall, "cpu_s": cpu, "peak_mb": peak_mb()}
        for label, (cpu_apart, wall_apart) in self._apart.items():
            fields[f"{label}_s"], fields[f"{label}_wall_s"] = cpu_apart, wall_apart
        fields |= {"timings": self._timings, "warnings": self.warnings, "errors": self.errors, "trace": self._trace,
                   **self._more, "arguments": self.arguments, "versions": versions(),
                   "inputs": {p: sha256(p) for p in self.inputs if os.path.isfile(p)}}
        if self.path:
            artefact.write_json(self.path, fields)
        return False
