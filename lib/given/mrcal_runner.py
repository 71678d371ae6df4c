"""mrcal at arm's length: Debian's cannot be imported beside NumPy 2, so its own interpreter runs it.

process("judge", "request.json", "answer.json", of="boards")    # mrcal_process.py, for mrcal's Python functions
run([COMMAND, ...], folder)                                     # one of mrcal's own commands
"""

import os
import shutil
import subprocess
from pathlib import Path

from lib.core.stage import BadInput

COMMAND = "mrcal-calibrate-cameras"


def require_mrcal(what="calibration from boards"):
    """BadInput where mrcal is not installed. what : what needs it, for the message"""
    if shutil.which(COMMAND) is None:
        raise BadInput(f"mrcal: not installed, and {what} needs it: apt-get install mrcal python3-mrcal")


def interpreter():
    """The Python that mrcal was built for: the one its own commands name in their first line."""
    with open(shutil.which(COMMAND), "rb") as file:
        first = file.readline().decode(errors="replace")
    return first[2:].split() if first.startswith("#!") else ["/usr/bin/python3"]


def process(*arguments, of=None):
    """Run lib/given/mrcal_process.py under mrcal's interpreter; BadInput with its last line where it fails.

    of : what of the user's files it is about, for the message; by itself the first file
    """
    script = Path(__file__).with_name("mrcal_process.py")
    run = subprocess.run(
        [*interpreter(), script, *map(str, arguments)], capture_output=True, text=True, env=environment()
    )
    if run.returncode:
        raise BadInput(f"{of or arguments[1]}: mrcal: {last_line(run.stderr)}")


def run(argv, folder, told=None):
    """What one of mrcal's commands writes to stderr, run in a folder. RuntimeError with its last line where it fails.

    told : called with each line as it comes, and with the CPU time of the process until then, s
    """
    lines = []
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(argv, cwd=folder, env=environment(), **streams) as child:
        for line in child.stderr:
            lines.append(line)
            if told:
                told(line.strip(), cpu_s(child.pid))
    said = "".join(lines)
    if child.returncode:
        raise RuntimeError(last_line(said.replace(f"{folder}{os.sep}", "")))
    return said


def cpu_s(pid):
    """CPU time of a process that runs or was not yet waited for, s, from /proc; 0 where that cannot be read."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return 0.0


def environment():
    """Ours without our virtual environment's packages, which belong to another interpreter; one thread for BLAS."""
    return {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")} | {
        "OMP_NUM_THREADS": "1"
    }


def last_line(text):
    """
    >>> last_line("Traceback:\\n  ...\\nValueError: no corners\\n")
    'ValueError: no corners'
    """
    lines = [line.strip() for line in text.strip().splitlines()] or ["no message"]
    return lines[-1]
