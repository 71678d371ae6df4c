"""A project of stub stages in a folder of its own, run by the real Makefile and lib/planning."""

import sys
from pathlib import Path

from lib.planning import scene as scenes
from lib.planning.pipeline import read_pipeline
from lib.planning.walk import walk

ROOT = Path(__file__).resolve().parents[2]
PIPELINE = """
see:
  reads:    {photograph: left.png|jpg}
  writes:   {regions: regions.txt, depth: depth.txt}
  params: {lambda: 0.5, wrong: 0}
pose:   {reads: {regions: regions.txt}, writes: {camera: camera.txt}}
mask:   {reads: {camera: camera.txt}, writes: {mask: mask.txt}}
fit:
  reads:    {camera: camera.txt, photograph: left.png|jpg}
  may_read: {depth: depth.txt, mask: mask.txt}
  facts: {lamps: lamps}
  writes:   {materials: materials.json, trace: trace.txt}
  params:   {method: newton}
later:  {reads: {materials: materials.json}, writes: {later: later.txt}}
compare:
  may_read: {reports: "*.report.json", materials: materials.json, truth: truth/}
  facts:    {scene: scene}
  writes:   {scorecard: scorecard.csv}
"""
STUB = """
import json, os, signal, sys
sys.path[:0] = [{root!r}, {toy!r}]
from lib.core import artefact
from toy import {module}
def main(argv):
    options, key = {{}}, None
    for word in argv:
        if word.startswith("--"): key = word[2:]; options[key] = []
        else: options[key].append(word)
    with open({toy!r} + "/ran", "a") as log: log.write({name!r} + "\\n")
    writes = {writes!r}
    made = [k for k in {may_write!r} if os.path.exists({toy!r} + "/has-" + k)]
    read = [p for k, v in options.items() if k not in writes + {may_write!r} and k != "report" for p in v]
    text = {name!r} + "(" + ", ".join(open(p).read().strip() for p in read if os.path.isfile(p)) + ")"
    if os.path.exists({toy!r} + "/refuse-" + {name!r}):
        print({name!r} + ".py: left.png: size: 0 is nothing", file=sys.stderr)
        sys.exit(2)
    with artefact.writing_all(*(options[k][0] for k in writes + made)) as partials:
        for p in partials:
            open(p, "w").write(text)
            if os.path.exists({toy!r} + "/kill-" + {name!r}): os.kill(os.getpid(), signal.SIGKILL)
    here = os.path.dirname(options["report"][0])
    sizes = {{os.path.relpath(p, here): os.path.getsize(p) for k in writes + made for p in options[k]}}
    artefact.write_json(options["report"][0], {{"status": "converged", "argv": argv, "output_bytes": sizes}})
main(sys.argv[1:])
"""


class Toy:
    """A project of its own in a folder: the real Makefile and lib/, a pipeline of stubs, one scene `room`."""

    def __init__(self, folder, run):
        self.folder, self.run, self.room, self.out = folder, run, folder / "data/room", folder / "build/room"
        for name in ("Makefile", "lib", "requirements.lock"):
            (folder / name).symlink_to(ROOT / name)
        for name in (".venv", "stages", "toy", "data/room"):
            (folder / name).mkdir(parents=True)
        (folder / ".venv/ready").touch()
        (folder / "toy/common.py").touch()
        self.pipeline(PIPELINE)
        self.give(**{"left.png": "photo"})
        self.scene("goals: [materials.json]\nlamps: {lamp: [1, 1, 1]}")

    def pipeline(self, text):
        """Write pipeline.yaml, and a stub for each of its stages."""
        path = self.folder / "pipeline.yaml"
        path.write_text(text)
        for name, stage in read_pipeline(path).items():
            (self.folder / f"toy/{name}.py").write_text("from toy import common\n")
            words = {"name": name, "module": name, "writes": list(stage.writes), "may_write": list(stage.may_write)}
            stub = STUB.format(root=str(ROOT), toy=str(self.folder), **words)
            (self.folder / f"stages/{name}.py").write_text(stub)

    def give(self, **files):
        for name, text in files.items():
            path = self.room / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)

    def scene(self, text):
        (self.room / "scene.yaml").write_text(text)

    def make(self, *words):
        """Exit status, the stages that ran in their order, and what was said."""
        (self.folder / "ran").unlink(missing_ok=True)
        result = self.run("make", f"PYTHON={sys.executable}", *words, cwd=self.folder)
        ran = (self.folder / "ran").read_text().split() if (self.folder / "ran").exists() else []
        return result.returncode, ran, result.stdout + result.stderr

    def plan(self, *wishes):
        stages = read_pipeline(self.folder / "pipeline.yaml")
        return walk(scenes.read(self.room, stages), stages, self.folder / "build", wishes or (None,))

    def read(self, name):
        return (self.out / name).read_text()
