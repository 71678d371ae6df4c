"""The shipped scenes, built once for all tests that ask for them.

They are built into build/tests and stay there: Make remakes what an edit touches.
"""

import contextlib
import fcntl
import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build/tests"


def make(*words):
    clean = {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k not in ("MFLAGS", "BUILD", "DATA")}
    return subprocess.run(["make", f"BUILD={BUILD}", *words], cwd=ROOT, env=clean, capture_output=True, text=True)


@contextlib.contextmanager
def built(scene, until=None):
    """The build folder of a scene, made up to a stage; no other test makes it meanwhile."""
    BUILD.mkdir(parents=True, exist_ok=True)
    with open(BUILD / f".{scene}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = make(f"{scene}/{until}" if until else scene)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        yield BUILD / scene
