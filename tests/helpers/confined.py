"""Calls in a child process of little memory and time: what became of each, and what it cost."""

import ctypes
import gc
import os
import pickle
import resource
import select
import signal
import time
import traceback
from typing import NamedTuple

from lib.core.stage import BadInput

MEMORY_MB, CPU_S = 1024, 5.0  # beyond what the process holds before the call
SLACK_S = 60  # of clock: a loaded machine is slow, and a call that waits for nothing ends all the same


class Outcome(NamedTuple):
    """end : "accepted", "refused", "traceback", "hang", "memory" or "crash"
    lines : of the refusal, or of the traceback;  value : what the call returned
    """

    end: str
    lines: tuple
    cpu_s: float
    peak_mb: float
    value: object = None


def call(function, *arguments, cpu_s=CPU_S) -> Outcome:
    """One call in a child of its own."""
    return next(iter(calls([(function, *arguments)], cpu_s=cpu_s)))


def calls(jobs, keep=True, cpu_s=CPU_S):
    """Yields an Outcome for each (function, argument, ...), in order; a child goes on until one breaks it.

    keep : whether what the calls return comes back, too;  cpu_s : from which a call hangs
    """
    jobs = list(jobs)
    done = 0
    while done < len(jobs):
        for outcome in _batch(jobs[done:], keep, cpu_s):
            done += 1
            yield outcome


def _batch(jobs, keep, cpu_s):
    """The outcomes of the jobs up to the first that ends its child."""
    reader, writer = os.pipe()
    gc.collect()
    if (child := os.fork()) == 0:
        os.close(reader)
        _child(jobs, keep, cpu_s, writer)
    os.close(writer)
    got, open_end = 0, True
    with os.fdopen(reader, "rb") as answers:
        while open_end and got < len(jobs):
            ready = select.select([answers], [], [], SLACK_S)[0]
            try:
                outcome = pickle.load(answers) if ready else None
            except EOFError:
                outcome = None
            open_end = outcome is not None
            if open_end:
                got += 1
                yield outcome
                if outcome.end in ("hang", "memory"):
                    break
        if not open_end:
            os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    if not open_end:
        ended = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        hung = not ready or ended == signal.SIGXCPU
        yield Outcome("hang" if hung else "crash", (f"signal {ended}",), cpu_s, _peak_mb())


class _Hang(BaseException):
    pass


def _child(jobs, keep, cpu_s, writer):
    """Never returns."""
    status = 1
    try:
        with open(os.devnull, "w") as nothing:
            os.dup2(nothing.fileno(), 1), os.dup2(nothing.fileno(), 2)
        _confine()
        gc.freeze()  # what is loaded need not be looked at again and again
        with os.fdopen(writer, "wb", buffering=0) as answers:
            for job in jobs:
                outcome = _outcome(job, keep, cpu_s)
                answers.write(pickle.dumps(outcome))
                if outcome.end in ("hang", "memory"):
                    break
        status = 0
    finally:
        os._exit(status)


def _confine():
    with open("/proc/self/statm") as file:
        held = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (held + (MEMORY_MB << 20),) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)

    def late(*_):
        raise _Hang

    signal.signal(signal.SIGPROF, late)


def _outcome(job, keep, cpu_s):
    function, *arguments = job
    _limit_cpu(cpu_s)
    _forget_peak()
    before, begin = _peak_mb(), time.process_time()
    value, lines = None, ()
    try:
        signal.setitimer(signal.ITIMER_PROF, cpu_s)
        value = function(*arguments)
        end = "accepted"
    except BadInput as bad:
        end, lines = "refused", bad.problems
    except _Hang:
        end = "hang"
    except MemoryError:
        end, lines = "memory", tuple(traceback.format_exc(limit=-3).splitlines())
    except BaseException as error:
        end, lines = "traceback", tuple(traceback.format_exc(limit=-4).splitlines()[-9:])
        if isinstance(error, SystemExit):
            end, lines = "refused" if error.code == 2 else "traceback", (str(error.code),)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    cost = time.process_time() - begin, max(0.0, _peak_mb() - before)
    return Outcome(end, lines, *cost, value if keep else None)


def _limit_cpu(cpu_s):
    """Code that never looks at signals is ended by the system, a little later."""
    used = int(time.process_time()) + 1
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_CPU, (used + int(cpu_s) + 2, hard))


def _forget_peak():
    """Give free memory back, and count the most that is held from here on."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    with open("/proc/self/clear_refs", "w") as file:
        file.write("5")


def _peak_mb():
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) / 1024 for line in file if line.startswith("VmHWM"))
