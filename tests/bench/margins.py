"""How near is each decision to the next room? Read from the rows of tests/bench/strangers, nothing is run.

    $ python -m tests.bench.strangers --rooms ... --kinds exact vignetting colours lamp_power usemtl --out /tmp/sweep
    $ python -m tests.bench.margins /tmp/sweep/rows.jsonl

Of each question that the search asks of the fit under the given facts: the room in which it is what is wrong and that
shows it least, and the room in which it is not and that shows it most.  `promised` is in units of the nats that are
asked for, so that a decision is right where the first is above 1 and the second below; z is nats over their standard
error over groups.  A threshold whose two rooms come near each other is about to fail.
"""

import argparse
import json
from pathlib import Path

# kind of lib/synthetic/deviations.py: the questions of which it is the right answer; a kind that is not here is none's
ANSWERS = {
    "vignetting": {"vignetting"},
    "colours": {"matrix"},
    "srgb": {"response"},
    "tone": {"response"},
    "lamp_power": {"lamps"},
    "neutral_lamp": {"lamps"},
    "usemtl": {"object"},
    "open_room": {"glow"},
}
HEAD = "question      as       wrong rooms: least  in                          right rooms: most  in"


def asked_first(row):
    """{cause: question} of the fit under the given facts, before anything was taken."""
    found = {}
    for question in row.get("questions", []):
        if not question["beside"] and question["promised"] is not None:
            found.setdefault(question["cause"], question)
    return found


def measures(question):
    """{name: value} by which a question may be decided; None where it was not found."""
    promised, dse, nats = (question[key] for key in ("promised", "dse", "nats"))
    told = promised if nats is None else nats
    return {
        "promised": promised / question["least"] if question["least"] else None,
        "z": told / dse if dse else None,
    }


def margins(rows):
    """[(cause, measure, (value, room) or None, (value, room) or None)]: where it is wrong, and where it is right."""
    found = {}
    for row in rows:
        room = f"{row['room']} {row['kind']} {row['draw']}"
        for cause, question in asked_first(row).items():
            is_wrong = cause in ANSWERS.get(row["kind"], ())
            for measure, value in measures(question).items():
                if value is not None:
                    found.setdefault((cause, measure), ([], []))[not is_wrong].append((value, room))
    for (cause, measure), (wrong, right) in sorted(found.items()):
        yield cause, measure, min(wrong, default=None), max(right, default=None)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", type=Path, nargs="+")
    opt = parser.parse_args()
    rows = [json.loads(line) for path in opt.rows for line in path.read_text().splitlines()]
    print(HEAD)
    shown = lambda pair: f"{pair[0]:18.3g}  {pair[1]:28s}" if pair else f"{'':18s}  {'none was drawn':28s}"
    for cause, measure, wrong, right in margins(rows):
        print(f"{cause:12s}  {measure:8s}{shown(wrong)}{shown(right)}".rstrip())


if __name__ == "__main__":
    main()
