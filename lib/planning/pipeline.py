"""pipeline.yaml as stages: what each reads and writes, its facts, numbers and needs."""

import runpy
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

from lib.core.stage import BadInput
from lib.core.yaml_file import read_yaml
from lib.planning.files import NO_FILE, export_kind, here

REPORTS = "*.report.json"  # of the planned stages above
CHANGED = "augmented.*"  # what those of them write that make entries of scene.yaml: a picture each, or a sequence
FACTS = (
    "board",
    "lens",
    "camera",
    "lamps",
    "lamp_groups",
    "place_sigma_m",
    "lobes",
    "reference",
    "transfer",
    "surfaces",
    "explain",
    "refine",
    "movable",
    "photos",
    "unit",
    "up",
    "entry",
    "scene",
)
FILES = ("reads", "may_read", "writes", "may_write")
ENTRY = ("script", "asked_by", "each", *FILES, "beside", "refines", "facts", "params", "sweep", "needs")


@dataclass(frozen=True)
class Stage:
    """An entry of pipeline.yaml; files are named by option."""

    name: str
    script: str  # as the command line names it
    asked_by: list = field(default_factory=list)  # only scenes that have such a key, file or folder know the stage
    each: str = ""  # key of scene.yaml, a list of named entries: a stage of its own for each of them
    entry: str = ""  # the name of its entry
    reads: dict = field(default_factory=dict)  # option -> file
    may_read: dict = field(default_factory=dict)
    writes: dict = field(default_factory=dict)
    may_write: dict = field(default_factory=dict)  # written only where a scene has it
    beside: list = field(default_factory=list)  # folders that it may write beside them
    refines: dict = field(default_factory=dict)  # camera and model as they should have been
    facts: dict = field(default_factory=dict)  # option -> key of scene.yaml
    params: dict = field(default_factory=dict)  # name -> default
    sweep: dict = field(default_factory=dict)
    needs: dict = field(default_factory=dict)  # what of the system -> the given file that calls for it; None: always

    @property
    def kind(self) -> str:
        """The stage's name in pipeline.yaml."""
        return self.name.removesuffix(f".{self.entry}") if self.entry else self.name

    def of_entries(self, scene) -> list["Stage"]:
        """This stage, or one for each entry of its list in scene.yaml, `<name>` in its files the entry's name.

        An entry that asks for a sequence has the files of `may_write`, one that does not those of `writes`.
        """
        if not self.each:
            return [self]
        stages = []
        for value in getattr(scene, self.each):
            name = value["name"]
            named = lambda files, name=name: {k: f.replace("<name>", name) for k, f in files.items()}
            writes, beside = (self.may_write, self.beside) if "cameras" in value else (self.writes, [])
            stages.append(
                replace(
                    self,
                    name=f"{self.name}.{name}",
                    entry=name,
                    writes=named(writes),
                    may_write={},
                    beside=[folder.replace("<name>", name) for folder in beside],
                )
            )
        return stages

    @property
    def report(self) -> str:
        return f"{self.name}.report.json"

    @property
    def written(self) -> dict:
        """option -> file, of all that the stage writes or may write, but the report."""
        return {**self.writes, **self.may_write}

    @property
    def outputs(self) -> list[str]:
        """The files that are there when the stage has ended well."""
        return [*self.writes.values(), self.report]

    @property
    def files(self) -> list[str]:
        """The files that may be there when the stage has ended well."""
        return [*self.written.values(), *self.refines.values(), self.report]

    @property
    def built(self) -> bool:
        return Path(self.script).is_file()

    def parser(self):
        """The stage's own options, or None where its script has none to show; stages import nothing heavy on top."""
        path = Path(self.script)
        if not path.is_file() or "\ndef options(" not in path.read_text(encoding="utf-8", errors="replace"):
            return None
        kept = list(sys.path)
        try:
            return runpy.run_path(str(path), run_name="planning")["options"]()
        finally:
            sys.path[:] = kept

    def within(self, scene) -> "Stage":
        """This stage in one scene: <left> and so on are files; of exports those that are asked for.

        Where the scene has no right photograph and the stage can do without, what it would write of it falls away.
        """
        views = scene.views
        reads, may_read, writes, may_write = (
            {option: views.get(file, file) for option, file in getattr(self, key).items()} for key in FILES
        )
        if "photograph_right" in may_read and reads:
            unposed = scene.lone_pose and "<right posed>" in self.may_read.values()
            if scene.given("right.png|jpg|tif|exr") and not unposed:
                reads |= {option: may_read.pop(option) for option in tuple(may_read) if option.endswith("_right")}
            else:
                may_read = _without_right(may_read)
                writes, may_write = _without_right(writes), _without_right(may_write)
        reads = {option: file for option, file in reads.items() if file != NO_FILE}
        kinds = scene.exported or None  # None: asked for by name alone, which means all
        writes = {o: file for o, file in writes.items() if not kinds or export_kind(file) in (None, *kinds)}
        return replace(self, reads=reads, may_read=may_read, writes=writes, may_write=may_write)


def _without_right(files):
    return {option: file for option, file in files.items() if not option.endswith("_right")}


def read_pipeline(path) -> dict[str, Stage]:
    """The stages of pipeline.yaml by name, in order.  BadInput where it contradicts itself."""
    path = Path(path)
    entries = read_yaml(path) or {}
    stages = {name: _stage(path, name, entry) for name, entry in entries.items()}
    writers = {}  # file -> the first stage that writes it
    problems = []
    for name, stage in stages.items():
        problems += [f"{path}: {problem}" for problem in _entry_problems(stage, entries[name])]
        for file in [*stage.written.values(), *stage.refines.values()]:
            first = writers.setdefault(file, stage)
            both_refine = file in first.refines.values() and file in stage.refines.values()
            if first is not stage and not both_refine:
                problems.append(f"{path}: {name}.writes: {file} is written by {first.name} too")
    problems += [f"{path}: {problem}" for problem in _reading_problems(stages, writers)]
    if problems:
        raise BadInput(*problems)
    return stages


def _stage(path, name, entry):
    script = path.resolve().parent / "stages" / f"{entry.get('script', name)}.py"
    known = {key: value for key, value in entry.items() if key in ENTRY and key != "script"}
    return Stage(name, str(here(script)), **known)


def _entry_problems(stage, entry):
    """What is wrong with one entry, whatever the others are."""
    name = stage.name
    for key in sorted(entry.keys() - set(ENTRY)):
        yield f"{name}.{key}: unknown key; known are {', '.join(ENTRY)}"
    for option, key in stage.facts.items():
        if key not in FACTS:
            yield f"{name}.facts.{option}: {key} is no fact"
    for key in stage.sweep:
        if key not in stage.params:
            yield f"{name}.sweep.{key}: no such parameter"
    options = [option for key in (*FILES, "refines", "facts", "params") for option in getattr(stage, key)]
    for option in sorted({o for o in options if options.count(o) > 1}):
        yield f"{name}: the option {option} stands there twice"


def _reading_problems(stages, writers):
    """Files that are read before they are written, or that are counted on though they may be missing."""
    order = list(stages)
    for name, stage in stages.items():
        for file in [*stage.reads.values(), *stage.may_read.values()]:
            late = file in writers and order.index(writers[file].name) >= order.index(name)
            if late and file not in writers[file].refines.values():
                yield f"{name} reads {file}, which {writers[file].name} writes only later"
        for option, file in stage.reads.items():
            if file in writers and file not in writers[file].outputs:
                yield f"{name}.reads.{option}: {writers[file].name} need not write {file}: list it under may_read"
