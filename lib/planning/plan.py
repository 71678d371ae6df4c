#!/usr/bin/env python3
"""Walk back from what is wished for through pipeline.yaml, and write build/<scene>/plan.mk.

    $ python -m lib.planning.plan --data data --build build office            # the scene, up to its goals
    $ python -m lib.planning.plan --data data --build build office/index      # up to and including one stage
    $ python -m lib.planning.plan --data data --build build --show office     # what runs, what is left out, and why

The walk is in walk.py, the command lines in command.py, the text of plan.mk in makefile.py.
"""

import argparse
import re
import sys
from pathlib import Path

from lib.core import stage

if __name__ == "__main__":
    stage.listen("plan.py")  # what follows takes a while to import
from lib.core.stage import BadInput
from lib.planning import makefile, scene
from lib.planning.near_misses import alike
from lib.planning.pipeline import read_pipeline
from lib.planning.rules import NAME
from lib.planning.walk import explain, overview, walk

ROOT = Path(__file__).resolve().parents[2]
# What the Makefile makes beside scenes, as it lists them there
TARGETS = tuple(re.search(r"^TARGETS := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)[1].split())


def check_name(data, name) -> Path:
    """The folder of a scene.  BadInput where there is none, or where Make would take its name for a target."""
    folder = Path(data) / name
    if not NAME.fullmatch(name):
        raise BadInput(f"{name}: is not a scene's name: letters, digits, _ and - only")
    if name in TARGETS:
        raise BadInput(f"{folder}: a scene cannot be called {name}: that is a target of the Makefile")
    if not folder.is_dir():
        there = list_scenes(data)
        raise BadInput(f"{folder}: there is no such scene{alike(name, there)}; {data} has {', '.join(there) or 'none'}")
    return folder


def list_scenes(data) -> list[str]:
    """The names of the scenes in a folder."""
    return sorted(path.parent.name for path in Path(data).glob("*/scene.yaml"))


def main(opt):
    stages = read_pipeline(opt.pipeline)
    root = Path(opt.pipeline).resolve().parent
    wishes = {}
    for wish in opt.wishes or (list_scenes(opt.data) if opt.show else []):
        name, slash, stage_name = wish.partition("/")
        wishes.setdefault(name, []).append(stage_name if slash else None)
    problems, plans = [], []
    for name, wished in wishes.items():
        try:
            folder = check_name(opt.data, name)
            if (Path(opt.build) / name).resolve() == folder.resolve():
                raise BadInput(f"BUILD: {opt.build}: the outputs would lie in the scene's folder")
            plan = walk(scene.read(folder, stages), stages, opt.build, wished)
            if opt.show:
                plans.append(plan)
            else:
                makefile.write(plan, opt.python, root, title=opt.wishes[0] if len(opt.wishes) == 1 else name)
        except BadInput as bad:
            problems += bad.problems
            if opt.show:
                print(f"{name}: cannot be planned")
    if plans:
        print("\n".join(map(explain, plans)) if opt.wishes else overview(plans))
    if problems:
        raise BadInput(*problems)


def options():
    parser = argparse.ArgumentParser(prog="plan.py", description=__doc__.split("\n")[0])
    parser.add_argument("wishes", nargs="*", metavar="SCENE[/STAGE]")
    parser.add_argument("--data", default="data")
    parser.add_argument("--build", default="build")
    parser.add_argument("--pipeline", default="pipeline.yaml")
    parser.add_argument("--python", default=sys.executable, help="the interpreter that the stages run under")
    parser.add_argument(
        "--show", action="store_true", help="say what runs and what is left out, and why; without names: every scene"
    )
    return parser


if __name__ == "__main__":
    stage.run(main, options())
