"""What lies in build/<scene>/ before a run: times that lie in the future, and files that are no longer whole.

Make believes in times. A clock that was put back, or files from a machine whose clock is ahead, would make it run
everything each time, or nothing.

* A file that is given, a script or a module from the future is no prerequisite: its size and time stand in the command
  file of the stage, which changes when they do.
* Files of build/<scene>/ from the future get the time of now, in their order.
* A stage runs again that wrote a file which has not the size that its report says, or whose report cannot be read.
"""

import functools
import os
import sys
import time

from lib.core import artefact
from lib.core.stage import BadInput

ELSEWHERE = ("../", "scratch/")  # what a report tells of that does not stay beside it


def mend(plan):
    """Before the plan is written; a line on stderr for each kind of thing that was found."""
    if plan.build.is_dir():
        _to_the_past(plan.build)
        for name in plan.planned:
            for one in (plan, plan.draft):
                _whole(one, plan.stages[name])


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


def _whole(plan, stage):
    """All files of a stage go where one is not as its report says: Make would remake that one, and miss the others."""
    folder = plan.folder(stage)
    if not (folder / stage.report).exists():
        return
    try:
        sizes = artefact.read_json(folder / stage.report).get("output_bytes", {})
        there = {name: (folder / name).stat().st_size if (folder / name).is_file() else 0 for name in sizes}
        wrong = [name for name in sizes if there[name] != sizes[name] and not name.startswith(ELSEWHERE)]
        why = f"{folder / wrong[0]}: {there[wrong[0]]} bytes instead of {sizes[wrong[0]]}" if wrong else None
    except (BadInput, AttributeError, TypeError):
        why = f"{folder / stage.report}: cannot be read"
    if why:
        _say(f"{why}: {stage.name} runs again")
        for file in stage.outputs:
            if not plan.scene.given(file):
                (folder / file).unlink(missing_ok=True)


def _say(text):
    print(f"plan.py: {text}", file=sys.stderr)
