#!/usr/bin/env python3
"""Remove what anasyn made in a folder of outputs, and nothing else: make clean, make BUILD=folder clean.

    $ python -m lib.planning.clean build

A scene's outputs are a folder that holds a plan.mk of ours; beside them lies index.html. What else is there stays, and
is said. Only the standard library is imported: .venv need not be there.
"""

import argparse
import shutil
from pathlib import Path

from lib.core import stage
from lib.core.stage import BadInput
from lib.planning import gallery

PLAN = "plan.mk"
WRITTEN = "# Written by lib/planning/plan.py"  # how a plan.mk of ours begins
SHOWN = 5  # names of what stays, in one line


def clean(build) -> list[str]:
    """Remove the outputs of scenes from a folder, and the folder if nothing is left. Returns lines to say."""
    build = Path(build)
    if not build.exists() and not build.is_symlink():
        return [f"{build}: is not there: nothing to remove"]
    if not build.is_dir():
        raise BadInput(f"BUILD: {build}: is no folder")
    removed, stays = [], []
    for path in sorted(build.iterdir()):
        if is_outputs(path):
            shutil.rmtree(path)
            removed.append(path.name)
        elif path.name == gallery.INDEX and gallery.is_ours(path):
            path.unlink()
            removed.append(path.name)
        else:
            stays.append(path.name)
    said = [f"{build}: removed: {', '.join(removed)}"] if removed else []
    if stays:
        more = f" and {len(stays) - SHOWN} more" if len(stays) > SHOWN else ""
        said.append(f"{build}: stays, for no scene's outputs lie in it: {', '.join(stays[:SHOWN])}{more}")
    elif not build.is_symlink() and build.resolve() != Path.cwd():
        build.rmdir()
    return said or [f"{build}: is empty: nothing to remove"]


def is_outputs(folder) -> bool:
    """Does a folder, which is no link to another, hold the outputs of a scene?"""
    try:
        with open(folder / PLAN, encoding="utf-8", errors="replace") as file:
            return not folder.is_symlink() and file.readline().startswith(WRITTEN)
    except OSError:
        return False


def main(opt):
    print(*clean(opt.build), sep="\n")


def options():
    parser = argparse.ArgumentParser(prog="clean", description=__doc__.split("\n")[0])
    parser.add_argument("build", metavar="FOLDER")
    return parser


if __name__ == "__main__":
    stage.run(main, options())
