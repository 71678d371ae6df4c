"""What every stage shares: bad input, the run of `main`, options that are JSON, a progress bar.

Only the standard library is imported here, so that `stages/x.py --help` needs nothing installed.
A stage begins

    import sys
    from pathlib import Path
    sys.path[0] = str(Path(__file__).resolve().parents[1])     # not stages/: its names would hide packages
    from lib import stage

and ends

    if __name__ == "__main__":
        stage.run(main, parser)
"""
import argparse
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


def _terminate(*_):
    sys.exit(128 + signal.SIGTERM)     # an exception, so that `artefact.writing` removes its temporary files


def run(main, parser, argv=None):
    """Parse argv and call main(opt).  Bad input: one line per problem on stderr, exit status 2; a bug keeps its traceback."""
    name = os.path.basename(parser.prog)
    parser.error = lambda message: parser.exit(2, f"{name}: {message} (--help lists the options)\n")     # one line, no usage
    opt = parser.parse_args(argv)
    signal.signal(signal.SIGTERM, _terminate)
    try:
        main(opt)
    except BadInput as bad:
        problems = bad.problems
    except OSError as error:           # a file that cannot be opened is the user's to mend; anything else is a bug
        if error.filename is None or not isinstance(error, (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError)):
            raise
        problems = (f"{os.fsdecode(error.filename)}: {error.strerror}",)
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    else:
        return
    for problem in problems:
        print(f"{name}: {problem}", file=sys.stderr)
    sys.exit(2)


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


def progress(iterable_or_total, label):
    """Iterate with a bar and the time left on stderr; silent unless stderr is a terminal.

    >>> list(progress(3, "rays"))
    [0, 1, 2]
    """
    items = range(iterable_or_total) if isinstance(iterable_or_total, int) else iterable_or_total
    total = len(items) if hasattr(items, "__len__") else None
    if not sys.stderr.isatty():
        yield from items
        return
    begin = shown = time.monotonic()
    try:
        for done, item in enumerate(items):
            now = time.monotonic()
            if now - shown > 0.1:
                shown = now
                if total:
                    left = (now - begin) / max(done, 1) * (total - done)
                    bar = "#" * (30 * done // total)
                    sys.stderr.write(f"\r{label} [{bar:30}] {done}/{total}, {left:.0f} s left \033[K")
                else:
                    sys.stderr.write(f"\r{label} {done}, {now - begin:.0f} s \033[K")
                sys.stderr.flush()
            yield item
    finally:
        if shown != begin:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()


class Bar:
    """The same bar for work that reports the share it has done: bar(0.25); it goes away at 1."""

    def __init__(self, label):
        self.label, self.begin, self.shown = label, time.monotonic(), None

    def __call__(self, share):
        if not sys.stderr.isatty():
            return
        now = time.monotonic()
        if share >= 1:
            if self.shown:
                sys.stderr.write("\r\033[K")
                sys.stderr.flush()
        elif now - (self.shown or self.begin) > 0.1:
            self.shown = now
            left = (now - self.begin) / max(share, 1e-9) * (1 - share)
            sys.stderr.write(f"\r{self.label} [{'#' * int(30 * share):30}] {100 * share:.0f} %, {left:.0f} s left \033[K")
            sys.stderr.flush()
