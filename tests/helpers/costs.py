"""A plugin of pytest (-p tests.helpers.costs): the CPU time of each test and of the processes that it started.

build/tests/cpu.csv lists all tests, the dearest first; the end of a run names the dearest files. Wall time would tell
what else the machine did.
"""

import csv
import resource
from collections import Counter
from pathlib import Path

import pytest

TABLE = Path(__file__).resolve().parents[2] / "build/tests/cpu.csv"
LISTED = 15
_began = pytest.StashKey()
_cpu_s = {}  # of this run's tests, by their names


def _now():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    item.stash[_began] = _now()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item):
    try:
        return (yield)
    finally:
        item.user_properties.append(("cpu_s", _now() - item.stash[_began]))


def pytest_runtest_logreport(report):
    for name, value in report.user_properties:
        if name == "cpu_s" and report.when == "teardown":
            _cpu_s[report.nodeid] = value


def pytest_terminal_summary(terminalreporter, config):
    if hasattr(config, "workerinput") or not _cpu_s:
        return
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    with open(TABLE, "w", newline="") as file:
        csv.writer(file).writerows(
            [("cpu_s", "test"), *((f"{v:.2f}", k) for k, v in sorted(_cpu_s.items(), key=lambda pair: -pair[1]))]
        )
    files = Counter()
    for name, value in _cpu_s.items():
        files[name.partition("::")[0]] += value
    terminalreporter.write_sep("=", f"{sum(_cpu_s.values()):.0f} CPU s in tests, the dearest files")
    for name, value in files.most_common(LISTED):
        terminalreporter.write_line(f"{value:8.1f} {name}")
