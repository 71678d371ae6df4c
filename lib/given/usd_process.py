"""Reads a USD file within limits of memory and CPU time. Runs as a process of its own; usd_models.py calls it.

    $ python -m lib.given.usd_process  name-in-messages  /absolute/path.usda  answer

Writes answer.npz: points, counts, corners, and the rest as JSON; or answer.json: the problems, or a traceback.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import sys
import time
import traceback
from pathlib import Path

import numpy as np

from lib.core.stage import BadInput
from lib.given import usd_layers, usd_stage

MEMORY = 900 << 20  # bytes beyond what is held when the file is opened
MEMORY_TIMES = 20  # of the bytes of the layers: what is allowed on top of it
CPU_S = 3  # for a small file
CPU_S_MB = 1.0  # more of it for each MB of the layers
CPU_S_PRIM = 2e-3  # more of it for each prim, once they are counted


class Limits:
    """The memory and the CPU time of this process, which grow with what the file is known to hold."""

    def __init__(self):
        self.held, self.used, self.prims = _held(), int(time.process_time()) + 1, 0

    def allow(self, size, prims=0):
        """size : bytes of all layers known so far;  prims : that composition makes, as counted"""
        memory = self.held + MEMORY + MEMORY_TIMES * size
        cpu = self.used + CPU_S + CPU_S_MB * size / 1e6 + CPU_S_PRIM * prims
        for kind, most in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, cpu)):
            hard = resource.getrlimit(kind)[1]
            soft = int(most) if hard == resource.RLIM_INFINITY else min(int(most), hard)
            with contextlib.suppress(OSError, ValueError):  # a system without such a limit
                resource.setrlimit(kind, (soft, hard))


def _held():
    """Bytes of address space in use."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 1 << 30


def main(name, path, answer):
    from pxr import Tf

    usd_stage.load()
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limits = Limits()
    try:
        limits.allow(0)
        found = usd_layers.look(name, path, limits.allow)
        limits.allow(found.size, found.prims)
        write(answer, *usd_stage.read(name, found, limits.allow))
        return
    except BadInput as bad:
        told = {"problems": bad.problems}
    except UnicodeDecodeError as error:
        byte = f"{error.object[error.start]:#04x}"
        told = {"problems": [f"{name}: a name in it is no text (byte {byte}): is the file damaged?"]}
    except MemoryError:
        told = {"problems": [f"{name}: takes more memory than a file of its size should: it is damaged, or too large"]}
    except Tf.ErrorException as error:
        told = {"problems": [f"{name}: not readable: {' '.join(str(error).split())[-300:]}"]}
    except BaseException:
        told = {"traceback": traceback.format_exc()}
    Path(f"{answer}.json").write_text(json.dumps(told), encoding="utf-8")


def write(answer, parts, emits, said):
    """parts : [(object, group, points (V, 3), counts (F,), corners (C,))]"""
    some = lambda column, kind, shape: np.concatenate([np.empty(shape, kind), *(part[column] for part in parts)])
    told = {"parts": [[*part[:2], *map(len, part[2:])] for part in parts], "emits": emits, "said": said}
    with open(f"{answer}.part", "wb") as file:
        np.savez(
            file,
            points=some(2, float, (0, 3)),
            counts=some(3, np.int64, 0),
            corners=some(4, np.int64, 0),
            told=np.frombuffer(json.dumps(told).encode(), np.uint8),
        )
    os.replace(f"{answer}.part", f"{answer}.npz")


if __name__ == "__main__":
    main(*sys.argv[1:])
