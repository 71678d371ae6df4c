"""What lies in build/<scene>/ before a run: times that lie in the future, and files that are no longer whole.

Make believes in times. A clock that was put back, or files from a machine whose clock is ahead, would make it run
everything each time, or nothing.

* A file that is given, a script or a module from the future is no prerequisite: its size and time stand in the command
  file of the stage, which changes when they do.
* Files of build/<scene>/ from the future get the time of now, in their order.
* A file that has not the size that its stage's report says is removed, and so is a report that cannot be read: the
  stage runs again.
"""

import functools
import os
import sys
import time

from lib.core import artefact
from lib.core.stage import BadInput


def mend(plan):
    """Before the plan is written; a line on stderr for each kind of thing that was found."""
    if plan.build.is_dir():
        _to_the_past(plan.build)
        for name in plan.planned:
            for one in (plan, plan.draft):
                _whole(one.folder(plan.stages[name]), plan.stages[name].report)


@functools.cache
def is_late(path) -> bool:
    """Whether the time of a file lies in the future; said once."""
    try:
        late = os.stat(path).st_mtime_ns > time.time_ns()
    except OSError:
        return False
    if late:
        _say(f"{path}: its time lies in the future: it is taken as it is")
    return late


def _to_the_past(build):
    times = {path: path.stat().st_mtime_ns for path in build.rglob("*") if path.is_file()}
    now = time.time_ns()
    late = sorted((path for path, when in times.items() if when > now), key=times.get)
    for before, path in enumerate(reversed(late)):
        os.utime(path, ns=(now - 1000 * before,) * 2)
    if late:
        _say(f"{build}: times of {len(late)} files lie in the future: they were put back to now, in their order")


def _whole(folder, report):
    try:
        sizes = artefact.read_json(folder / report).get("output_bytes", {}) if (folder / report).exists() else {}
    except (BadInput, AttributeError):
        _say(f"{folder / report}: cannot be read: its stage runs again")
        (folder / report).unlink()
        return
    for name, size in sizes.items():
        path = folder / name
        if path.is_file() and path.stat().st_size != size:
            _say(f"{path}: {path.stat().st_size} bytes instead of {size}: it is made again")
            path.unlink()


def _say(text):
    print(f"plan.py: {text}", file=sys.stderr)
