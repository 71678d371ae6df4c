"""mrcal at arm's length: Debian's mrcal cannot be imported beside NumPy 2, so its own interpreter runs mrcal_process.py."""

import os
import shutil
import subprocess
from pathlib import Path

from lib.core.stage import BadInput

COMMAND = "mrcal-calibrate-cameras"


def require_mrcal(what="calibration from boards"):
    if shutil.which(COMMAND) is None:
        raise BadInput(f"mrcal: not installed, and {what} needs it: apt-get install mrcal python3-mrcal")


def interpreter():
    """The Python that mrcal was built for: the one its own commands name in their first line."""
    with open(shutil.which(COMMAND), "rb") as file:
        first = file.readline().decode(errors="replace")
    return first[2:].split() if first.startswith("#!") else ["/usr/bin/python3"]


def process(*arguments):
    """Run lib/given/mrcal_process.py under mrcal's interpreter; RuntimeError with its last line where it fails."""
    script = Path(__file__).with_name("mrcal_process.py")
    run = subprocess.run(
        [*interpreter(), script, *map(str, arguments)], capture_output=True, text=True, env=environment()
    )
    if run.returncode:
        raise RuntimeError(f"mrcal: {last_line(run.stderr)}")


def environment():
    """Without our virtual environment's packages, which belong to another interpreter."""
    return {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")} | {
        "OMP_NUM_THREADS": "1"
    }


def last_line(text):
    lines = [line.strip() for line in text.strip().splitlines()] or ["no message"]
    return lines[-1]
