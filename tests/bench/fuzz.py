"""Spoilt files for every reader: python -m tests.bench.fuzz [count] [seed] [kind ...]

Tracebacks, hangs, crashes and what takes more than 1 GB are kept in build/fuzz, with what was said.
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.helpers import fuzz

KEPT = Path("build/fuzz")
BAD = {"traceback": "tracebacks", "hang": "hangs", "memory": "> 1 GB", "crash": "crashes"}
HEADS = ("inputs", "accepted", "refused", *BAD.values(), "CPU s", "MB")


def line(name, values):
    return f"{name:21}" + "".join(f"{value:>11}" for value in values)


def main(count=1000, seed=1, *kinds):
    fuzz.load()
    total, most_s, most_mb = Counter(), 0.0, 0.0
    print(line("", HEADS))
    for name in kinds or fuzz.KINDS:
        with tempfile.TemporaryDirectory() as folder:
            found = fuzz.run(fuzz.KINDS[name], folder, int(count), seed)
        ends = Counter(outcome.end for _, outcome in found)
        worst = max(o.cpu_s for _, o in found), max(o.peak_mb for _, o in found)
        counts = [len(found), *(ends[end] for end in ("accepted", "refused", *BAD))]
        print(line(name, [*counts, f"{worst[0]:.2f}", f"{worst[1]:.0f}"]), flush=True)
        total, most_s, most_mb = total + ends, max(most_s, worst[0]), max(most_mb, worst[1])
        seen = set()
        for k, (content, outcome) in enumerate(found):
            if outcome.end in BAD and outcome.lines[-1:] + outcome.lines[-4:-3] not in seen:
                seen.add(outcome.lines[-1:] + outcome.lines[-4:-3])
                KEPT.mkdir(parents=True, exist_ok=True)
                (KEPT / f"{name}-{k}".replace("/", "-")).write_bytes(content)
                print(f"    {k}: {outcome.end}: " + " | ".join(line.strip()[:110] for line in outcome.lines[-5:]))
    print(f"{sum(total.values())} inputs: {dict(total)}; at most {most_s:.2f} CPU s, {most_mb:.0f} MB")
    return sum(total[end] for end in BAD)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]) != 0)
