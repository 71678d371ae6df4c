"""What every stage shares: its options, bad input, the run of `main`, a progress bar.

Only the standard library is imported here, so that `stages/x.py --help` needs nothing installed.
A stage begins

    import sys
    from pathlib import Path
    sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
    from lib.core import stage

and ends

    if __name__ == "__main__":
        stage.run(main, options())
"""

import argparse
import errno
import json
import os
import signal
import sys
import time


class BadInput(Exception):
    """What the user gave cannot be used.  Each problem is one line `FILE: FIELD: value ...`.

    >>> BadInput("m.json: group 'wall': rho_d = 1.2 is outside [0, 1]").problems
    ("m.json: group 'wall': rho_d = 1.2 is outside [0, 1]",)
    """

    def __init__(self, *problems):
        self.problems = tuple(" ".join(str(p).split("\n")) for p in problems)
        super().__init__("\n".join(self.problems))


MENDABLE = (
    FileNotFoundError,
    PermissionError,
    IsADirectoryError,
    NotADirectoryError,
)  # by the user, if they name a file
STOPPED = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
_asked = []  # the signals that stopped this process
_waits = False  # a stop for code that may be interrupted
_asked_at = 0.0  # on the monotonic clock, the last one
PATIENCE_S = 2.0  # within which a second signal changes nothing: files are being tidied up
DEAF = ("importlib", "llvmlite")  # in whose code no exception may be raised from without
LATER_S = 0.05  # after which a stage that was in such code is asked again to stop
LACKS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.ENOMEM, errno.EMFILE)  # of the machine


def run(main, parser, argv=None):
    """Parse argv and call main(opt).

    Bad input: one line per problem on stderr, exit status 2.  What the machine lacks, room or memory: one line, exit
    status 1.  A bug keeps its traceback.  Without argv this is the process's own command, and the process ends here:
    from the end of main on it hears no signal, so that what it says is said once.
    """
    name = os.path.basename(parser.prog)
    own = argv is None
    if own:
        sys.unraisablehook = _unraised
    try:
        for asked in STOPPED:
            signal.signal(asked, _stop)
        status, problems = _outcome(main, parser, argv)
        if own:
            _deafen()
    except KeyboardInterrupt:
        while own:
            try:
                _deafen()
                break
            except KeyboardInterrupt:  # another, before it was deaf
                continue
        status, problems = _told(_asked[0] if _asked else signal.SIGINT)
    for problem in problems:
        print(f"{name}: {problem}", file=sys.stderr)
    if own:
        _end_at_once(status)
    if status:
        sys.exit(status)


def _outcome(main, parser, argv):
    """(exit status, what is wrong) of main, run on argv."""
    # one line, no usage
    parser.error = lambda message: parser.exit(
        2, f"{os.path.basename(parser.prog)}: {message} (--help lists the options)\n"
    )
    opt = parser.parse_args(argv)
    _forget_missing(opt)
    try:
        _unless_stopped(main, opt)
    except BadInput as bad:
        return 2, bad.problems
    except MENDABLE as error:
        if error.filename is None:
            raise
        return 2, (f"{os.fsdecode(error.filename)}: {error.strerror}",)
    except MemoryError:
        return 1, ("there is not enough memory: nothing of it was written",)
    except BrokenPipeError:  # who read what is printed has gone: `make plan | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE, ()
    except OSError as error:
        if error.errno not in LACKS or error.filename is None:
            raise
        return 1, (f"{os.fsdecode(error.filename)}: {error.strerror}: nothing of it was written",)
    return 0, ()


def _told(asked):
    """(exit status, what is said) of a process that stops."""
    return 128 + asked, (f"{STOPPED[asked]}: nothing of it was written",)


def _deafen():
    """Nothing stops the process from here on, nor an alarm that a stop has set.

    By a handler that does nothing: under SIG_IGN Python prints a traceback of a signal that came just before.
    """
    sys.unraisablehook = sys.__unraisablehook__
    for asked in (*STOPPED, signal.SIGALRM):
        signal.signal(asked, lambda *_: None)
    signal.setitimer(signal.ITIMER_REAL, 0)


def listen(name):
    """Until `run`, while a program still imports: where it is asked to stop it ends at once, in one line."""

    def at_once(asked, _):
        if not _asked:  # another one waits until the line is out
            _asked.append(asked)
            status, (said,) = _told(asked)
            print(f"{name}: {said}", file=sys.stderr, flush=True)
            os._exit(status)

    for asked in STOPPED:
        signal.signal(asked, at_once)


def _stop(asked, frame):
    """By an exception, so that `artefact.writing` removes its temporary files.

    Not within an import, which would make an ImportError of it as where a package is missing, nor where a compiler
    calls back, which would forget it: a little later. A second signal that comes soon is not heard; one that comes when
    a library has swallowed the exception is.
    """
    global _waits
    if _waits or _asked and time.monotonic() - _asked_at < PATIENCE_S:
        return
    _waits = True  # before anything else: signals may come faster than they are looked at
    _stop_now_or_later(asked, frame)


def _stop_now_or_later(asked, frame):
    global _waits, _asked_at
    while frame is not None:
        if any(name in frame.f_code.co_filename for name in DEAF):
            _stop_later(asked)
            return
        frame = frame.f_back
    _asked.append(asked)
    _asked_at, _waits = time.monotonic(), False
    raise KeyboardInterrupt


def _stop_later(asked):
    global _waits
    _waits = True
    signal.signal(signal.SIGALRM, lambda _, frame: _stop_now_or_later(asked, frame))
    signal.setitimer(signal.ITIMER_REAL, LATER_S)


def _unraised(ignored):
    """Python's hook for an exception that nothing can catch: where it is a stop, that was raised while a library called
    back or an object was freed, the process is asked again; anything else is printed as by Python."""
    if _asked and isinstance(ignored.exc_value, KeyboardInterrupt):
        _stop_later(_asked[-1])
    else:
        sys.__unraisablehook__(ignored)


def _unless_stopped(main, opt):
    """main(opt). Libraries make exceptions of their own of one that comes while they call back: numpy, comparing rows,
    a TypeError. Whatever comes once the process was asked to stop is that it stops."""
    try:
        main(opt)
    except Exception:
        if _asked:
            raise KeyboardInterrupt from None
        raise


def _end_at_once(status):
    """End the process without taking the interpreter down: files are written, and the system frees the rest.

    Freeing it object by object takes 0.1 s, and 0.4 s where numba's kernels are loaded.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


# ---- options ----


def parser(doc, *, reads="", may_read="", may_lack="", writes="", may_write="", refined="") -> argparse.ArgumentParser:
    """A stage's parser: its docstring as --help, a file for each name, and --report.

    reads, writes : names of files that must be given, as words;  may_read, may_write : those that need not
    may_lack : files that another stage may write (pipeline.yaml, may_write).  The option names where such a file would
        be; `run` makes it None where the file is not there
    refined : names of files for which another may stand (pipeline.yaml, refines): `--refined-camera` for `--camera`;
        `run` puts it in its place where it is there
    """
    result = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    may_lack = " ".join([may_lack, *(f"refined_{name}" for name in refined.split())])
    for names, required in ((reads, True), (f"{may_read} {may_lack}", False), (writes, True), (may_write, False)):
        for name in names.split():
            result.add_argument(option_of(name), required=required)
    result.add_argument("--report")
    inputs = [*reads.split(), *may_read.split(), *may_lack.split()]
    result.set_defaults(_outputs=[*writes.split(), *may_write.split()])
    result.set_defaults(_inputs=inputs, _may_lack=may_lack.split(), _refined=refined.split())
    return result


def _forget_missing(opt):
    for name in getattr(opt, "_may_lack", ()):
        path = getattr(opt, name)
        if path and not os.path.exists(path):
            setattr(opt, name, None)
    for name in getattr(opt, "_refined", ()):
        setattr(opt, name, getattr(opt, f"refined_{name}") or getattr(opt, name))


def inputs(opt) -> list[str]:
    """The files that a stage was given to read."""
    return list(dict.fromkeys(path for name in opt._inputs if (path := getattr(opt, name))))


def outputs(opt) -> list[str]:
    """The files that a stage was told to write."""
    return list(dict.fromkeys(path for name in opt._outputs if (path := getattr(opt, name))))


def arguments(opt) -> dict:
    """All options as the report shows them."""
    return {name: value for name, value in vars(opt).items() if not name.startswith("_")}


def option_of(name) -> str:
    """The option for a name.

    >>> option_of("photograph_right")
    '--photograph-right'
    """
    return "--" + name.replace("_", "-")


def whole(low, high=None):
    """The type of an option that is a whole number of at least `low` (and at most `high`).

    >>> whole(1)("7")
    7
    """
    return _ranged(int, "a whole number", low, high)


def real(low, high=float("inf"), *, open_low=False, open_high=True):
    """The type of an option that is a number from `low` to `high`; an open end is left out.

    >>> real(0, 1)("0.5")
    0.5
    """
    return _ranged(float, "a number", low, high, open_low, open_high)


def _ranged(kind, what, low, high, open_low=False, open_high=False):
    def parsed(text):
        try:
            value = kind(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}") from None
        over_low = value > low if open_low else value >= low
        under_high = high is None or (value < high if open_high else value <= high)
        if over_low and under_high:
            return value
        if high is None:
            raise argparse.ArgumentTypeError(f"{text} is less than {low}")
        opening, closing = "(" if open_low else "[", ")" if open_high else "]"
        raise argparse.ArgumentTypeError(f"{text} is outside {opening}{low}, {high}{closing}")

    parsed.bounds = kind, low, high, open_low, open_high  # for the schema of scene.yaml
    return parsed


def json_option(text):
    """An option that carries facts: `type=stage.json_option`.

    >>> json_option('{"lamp": [4, 4, 4]}')
    {'lamp': [4, 4, 4]}
    """

    def refuse(word):
        raise ValueError(word)

    try:
        return json.loads(text, parse_constant=refuse)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not JSON") from None


# ---- what a user sees meanwhile ----


class Bar:
    """A bar on stderr for work that reports the share it has done: bar(0.25); it goes away at 1.

    Silent unless stderr is a terminal.
    """

    def __init__(self, label):
        self.label, self.begin, self.shown = label, time.monotonic(), None

    def __call__(self, share):
        if not sys.stderr.isatty():
            return
        now = time.monotonic()
        if share >= 1:
            if self.shown:
                self._show("")
        elif now - (self.shown or self.begin) > 0.1:
            self.shown = now
            left = (now - self.begin) / max(share, 1e-9) * (1 - share)
            self._show(f"{self.label} [{'#' * int(30 * share):30}] {100 * share:.0f} %, {left:.0f} s left ")

    @staticmethod
    def _show(text):
        sys.stderr.write(f"\r{text}\033[K")
        sys.stderr.flush()
