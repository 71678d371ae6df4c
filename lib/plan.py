#!/usr/bin/env python3
"""Walk back from what is wished for through pipeline.yaml, and write build/<scene>/plan.mk.

    $ python -m lib.plan --data data --build build office            # the scene, up to its goals
    $ python -m lib.plan --data data --build build office/index      # up to and including one stage
    $ python -m lib.plan --data data --build build --show office     # what runs and what is left out, and why

Three rules: a file in the scene's folder is given; a stage runs only if one of its files is needed; a `may_read`
file is passed on when it is there and pulls nothing in.  A stage depends on its inputs, its script, the modules
the script imports, and its own command line, which is a file that changes only when its content does.
"""
import argparse
import ast
import os
import re
import shlex
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

from lib import artefact, scene as scenes, stage as stages_
from lib.stage import BadInput

ROOT = Path(__file__).resolve().parents[1]
TARGETS = ("all", "plan", "test", "bench", "scenes", "doctor", "help", "clean", "setup", "demo")     # of the Makefile
CLOSING = ("scorecard.csv",)                     # a goal of every scene, whatever it says
REPORTS = "*.report.json"                        # of the planned stages above
FACTS = ("board", "lens", "lamps", "lamp_groups", "reference", "transfer", "surfaces", "augment", "scene")
ENTRY = ("script", "reads", "may_read", "writes", "facts", "params", "sweep", "needs")


@dataclass(frozen=True)
class Stage:
    name: str
    script: str                                     # as the command line names it
    reads: dict = field(default_factory=dict)       # option -> file
    may_read: dict = field(default_factory=dict)
    writes: dict = field(default_factory=dict)
    facts: dict = field(default_factory=dict)       # option -> key of scene.yaml
    params: dict = field(default_factory=dict)      # name -> default
    sweep: dict = field(default_factory=dict)
    needs: dict = field(default_factory=dict)       # what of the system -> the given file without which it is not needed, or None

    @property
    def report(self):
        return f"{self.name}.report.json"

    @property
    def outputs(self):
        return [*self.writes.values(), self.report]

    @property
    def built(self):
        return Path(self.script).is_file()

    def within(self, scene):
        """This stage in one scene: <left> and so on are files; where there is no right photograph and the stage can do
        without, what it would write of it falls away."""
        views = scene.views
        reads, may_read, writes = ({option: views.get(file, file) for option, file in files.items()} for files in (self.reads, self.may_read, self.writes))
        if "photograph_right" in may_read and reads:
            if scene.given("right.png|jpg|tif|exr"):
                reads["photograph_right"] = may_read.pop("photograph_right")
            else:
                writes = {option: file for option, file in writes.items() if not option.endswith("_right")}
        return replace(self, reads=reads, may_read=may_read, writes=writes)


@dataclass
class Plan:
    scene: object
    stages: dict                    # every stage of the pipeline, in order
    build: Path                     # build/<scene>
    planned: list                   # names, in order
    goals: list                     # files
    passed_over: dict               # stage -> its output that was needed but is given

    def find(self, file):
        """Where the reader of file finds it: given, or made by a planned stage; else None."""
        made = [name for stage in self.stages.values() if stage.name in self.planned for name in scenes.alternatives(file) if name in stage.outputs]
        return self.scene.given(file) or (self.build / made[0] if made else None)

    def destination(self, stage, file):
        """A given file is never overwritten: what the stage makes of it goes to a scratch folder."""
        return self.build / "scratch" / stage.name / file if self.scene.given(file) else self.build / file


def read_pipeline(path):
    """The stages of pipeline.yaml, in order.  BadInput where it contradicts itself."""
    path = Path(path)
    stages, problems, written = {}, [], {}
    for name, entry in (scenes.read_yaml(path) or {}).items():
        unknown = entry.keys() - set(ENTRY)
        problems += [f"{path}: {name}.{key}: unknown key; known are {', '.join(ENTRY)}" for key in sorted(unknown)]
        script = str(_here(path.resolve().parent / "stages" / f"{entry.get('script', name)}.py"))
        known = {key: value for key, value in entry.items() if key not in unknown and key != "script"}
        stage = Stage(name, script, **known)
        stages[name] = stage
        problems += [f"{path}: {name}.facts.{option}: {key} is no fact" for option, key in stage.facts.items() if key not in FACTS]
        problems += [f"{path}: {name}.sweep.{key}: no such parameter" for key in stage.sweep if key not in stage.params]
        options = [*stage.reads, *stage.may_read, *stage.writes, *stage.facts, *stage.params]
        problems += [f"{path}: {name}: the option {o} stands there twice" for o in sorted({o for o in options if options.count(o) > 1})]
        for file in stage.writes.values():
            if file in written:
                problems.append(f"{path}: {name}.writes: {file} is written by {written[file]} too")
            written[file] = name
    order = list(stages)
    for name, stage in stages.items():
        for file in [*stage.reads.values(), *stage.may_read.values()]:
            if file in written and order.index(written[file]) >= order.index(name):
                problems.append(f"{path}: {name} reads {file}, which {written[file]} writes only later")
    if problems:
        raise BadInput(*problems)
    return stages


def walk(scene, stages, build, wishes=(None,)):
    """The plan for the wishes: None for the scene's goals, else a stage's name.  BadInput lists every problem, the scene's too.

    "Up to one stage" takes in what that stage may read if the scene's goals have it made: its command line, and so its
    answer, are those of the whole scene.
    """
    stages = {name: stage.within(scene) for name, stage in stages.items()}
    closing = [goal for goal in CLOSING if any(goal in s.writes.values() for s in stages.values())]
    whole = _Walk(scene, stages)
    for goal in [*scene.goals, *closing]:
        whole.need(goal, goal)
    walks, goals, problems = [], [], list(scene.problems)
    for wish in wishes:
        if wish is None:
            walks.append(whole)
            goals += [*scene.goals, *closing]
        elif wish in stages:
            walks.append(_Walk(scene, stages, whole.planned))
            walks[-1].plan(stages[wish], f"{scene.name}/{wish}")
            goals += [file for file in stages[wish].outputs if not scene.given(file)]
        else:
            problems.append(f"{scene.name}/{wish}: there is no such stage; stages are {', '.join(stages)}")
    planned = [name for name in stages if any(name in walk.planned for walk in walks)]
    passed_over = {name: file for walk in walks for name, file in walk.passed_over.items()}
    plan = Plan(scene, stages, Path(build) / scene.name, planned, list(dict.fromkeys(goals)), passed_over)
    problems += [problem for walk in walks for problem in walk.problems] + _facts(plan) + _system(plan)
    if problems:
        raise BadInput(*dict.fromkeys(problems))
    return plan


class _Walk:
    """Back from files that are needed; `optional`: stages whose files are worth passing on, though only if may-read."""

    def __init__(self, scene, stages, optional=frozenset()):
        self.scene, self.stages, self.optional = scene, stages, optional
        self.writer = {file: stage for stage in stages.values() for file in stage.outputs}
        self.planned, self.passed_over, self.problems, self.seen = set(), {}, [], set()

    def refuse(self, problem):
        self.problems.append(f"{self.scene.folder / 'scene.yaml'}: goals: {problem}")

    def maker(self, file):
        return next((self.writer[name] for name in scenes.alternatives(file) if name in self.writer), None)

    def need(self, file, goal, reader=None):
        if file in self.seen:
            return
        self.seen.add(file)
        maker = self.maker(file)
        if given := self.scene.given(file):
            if maker:
                self.passed_over[maker.name] = given.name
        elif maker:
            self.plan(maker, goal, file)
        elif reader:
            names = " or ".join(scenes.alternatives(file))
            self.refuse(f"{goal} needs {names}, which is not in the scene's folder (stage {reader.name})")
        else:
            self.refuse(f"{goal} is neither made by a stage nor given")

    def plan(self, stage, goal, file=None):
        if stage.name in self.planned:
            return
        self.planned.add(stage.name)
        if not stage.built:
            what = ":" if file in (None, goal) else f" needs {' or '.join(scenes.alternatives(file))}, which is not given:"
            self.refuse(f"{goal}{what} the stage {stage.name} is not built yet")
            return
        for read in stage.reads.values():
            self.need(read, goal, stage)
        for read in stage.may_read.values():
            before = list(self.stages)[:list(self.stages).index(stage.name)]
            makers = before if read == REPORTS else [self.maker(read).name] if self.maker(read) and not self.scene.given(read) else []
            for name in makers:
                if name in self.optional:
                    self.plan(self.stages[name], goal)


def _facts(plan):
    """What only matters once it is known which stages run."""
    scene, yaml = plan.scene, plan.scene.folder / "scene.yaml"
    problems = []
    photometry = [n for n in plan.planned if {"lamps", "lamp_groups"} & set(plan.stages[n].facts.values())]
    if photometry and not scene.lamps and not any(p.startswith(f"{yaml}: lamps") for p in scene.problems):
        problems.append(f"{yaml}: lamps: missing, and {photometry[0]} needs to know which groups emit")
    calibrators = [n for n in plan.planned if "board" in plan.stages[n].facts.values()]
    if calibrators and scene.given("boards/") and scene.board is None and not any(p.startswith(f"{yaml}: board") for p in scene.problems):
        problems.append(f"{yaml}: board: missing, and {calibrators[0]} needs to know the corners and squares of {scene.given('boards/')}/")
    lone = [side for side in scenes.SIDES if scene.given(f"{side}.cameramodel")]
    if calibrators and not scene.given("boards/") and len(lone) == 1:
        problems.append(f"{scene.folder / lone[0]}.cameramodel: is given, but not that of the other photograph: give both, or none")
    return problems


def _system(plan):
    needs = {need: n for n in plan.planned if plan.stages[n].built for need, file in plan.stages[n].needs.items() if file is None or plan.scene.given(file)}
    if not needs:
        return []
    from lib import doctor
    return [problem for need, name in needs.items() for problem in doctor.refusals(need, name)]


def explain(plan):
    """The chain, and a reason for every stage that is left out; and for what stages leave out as long as no error asks for it.

    furnace: index -> formfactors -> fit -> render
      without segment: no goal needs it
      without recognise: its output is given
      without mirror buffers, lobes and textures: fit and render make them only where ...
    """
    lines = [f"{plan.scene.name}: {' -> '.join(plan.planned) or 'nothing to run'}"]
    copied = [goal for goal in plan.goals if plan.scene.given(goal)]
    lines += [f"  copied: {goal} is given" for goal in copied]
    for name, stage in plan.stages.items():
        kept = [file for file in stage.writes.values() if plan.scene.given(file)]
        if name in plan.planned:
            lines += [f"  {name} leaves {file} as it is given" for file in kept]
        elif name in plan.passed_over:
            lines.append(f"  without {name}: its output is given ({', '.join(kept)})")
        else:
            lines.append(f"  without {name}: no goal needs it")
    if climbs := [name for name in plan.planned if "surfaces" in plan.stages[name].facts.values()]:
        makers = " and ".join([*climbs, *(name for name in ("render",) if name in plan.planned)])
        lines.append(f"  without mirror buffers, lobes and textures: {makers} make{'' if ' and ' in makers else 's'} them only where a group's error,"
                     " or `surfaces`, demands it; never for groups named diffuse")
    return "\n".join(lines)


# ---- the command line of a stage, and what it depends on ----

def _option(name):
    return "--" + name.replace("_", "-")


def _value(value):
    return value if isinstance(value, str) else artefact.dumps_json(value)


def command(plan, stage, python):
    """(argv, files read): what Make prints can be pasted."""
    argv, inputs = [python, stage.script], []
    for option, file in [*stage.reads.items(), *stage.may_read.items()]:
        if file == REPORTS:
            order = list(plan.stages)
            paths = [plan.build / plan.stages[n].report for n in plan.planned if order.index(n) < order.index(stage.name)]
        elif file.endswith("/"):
            folder = plan.scene.given(file)
            paths = sorted(p for p in folder.rglob("*") if p.is_file()) if folder else []
            inputs += paths
            if folder:
                argv += [_option(option), os.path.join(folder, "")]
            continue
        else:
            path = plan.find(file)
            paths = [path] if path else []
        if paths:
            argv += [_option(option), *map(str, paths)]
        inputs += paths
        inputs += [mtl for path in paths if path.suffix == ".obj" for mtl in sorted(path.parent.glob("*.mtl"))]
    for option, key in stage.facts.items():
        fact = plan.scene.fact(key)
        if fact is not None:
            argv += [_option(option), fact if key == "scene" else artefact.dumps_json(fact)]
    for option, file in stage.writes.items():
        argv += [_option(option), str(plan.destination(stage, file))]
    argv += ["--report", str(plan.build / stage.report)]
    settings = {**stage.params, **plan.scene.params.get(stage.name, {})}
    for name, value in settings.items():
        if value is not None:
            argv += [_option(name), _value(value)]
    return argv, list(dict.fromkeys(inputs))


_imports = {}


def imports(script, root):
    """The files under root that script imports, at any depth, also inside functions: what an edit of them reruns."""
    found, todo = set(), [Path(script).resolve()]
    while todo:
        path = todo.pop()
        if path in found:
            continue
        found.add(path)
        if path not in _imports:
            names = set()
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
                if isinstance(node, ast.Import):
                    names |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    base = node.module or ""
                    if node.level:
                        package = path.relative_to(root).parent.parts[:len(path.relative_to(root).parent.parts) - node.level + 1]
                        base = ".".join([*package, base] if base else package)
                    names |= {base} | {f"{base}.{alias.name}" for alias in node.names}
            _imports[path] = names
        for name in _imports[path]:
            parts = name.split(".")
            for depth in range(1, len(parts) + 1):
                stem = root.joinpath(*parts[:depth])
                todo += [p for p in (stem.with_suffix(".py"), stem / "__init__.py") if p.is_file()]
    return sorted(found - {Path(script).resolve()})


# ---- plan.mk ----

def _make(path):
    """A path as a target or prerequisite."""
    text = str(path)
    if re.search(r"[\n\t;:=*?\[\]%|&<>\"'`\\~]", text):
        raise BadInput(f"{text}: Make cannot handle a file of this name")
    return text.replace("$", "$$").replace("#", r"\#").replace(" ", r"\ ")


def _shell(words):
    return " ".join(shlex.quote(str(word)) for word in words).replace("$", "$$")


def _lines(argv, width=118):
    """The command line over several lines, broken before options; one that does not fit on a line, before words."""
    groups = []
    for word in argv:
        if not groups or word.startswith("--") or len(_shell([*groups[-1], word])) > width - 4:
            groups.append([])
        groups[-1].append(word)
    lines, line = [], ""
    for text in map(_shell, groups):
        if line and len(line) + len(text) > width:
            lines.append(line)
            line = "   "
        line += (" " if line else "") + text
    return " \\\n\t".join([*lines, line])


def _write(path, text):
    """Written only when it changes, and whole."""
    if path.is_file() and path.read_text(encoding="utf-8") == text:
        return
    with artefact.writing(path) as partial:
        Path(partial).write_text(text, encoding="utf-8")


def _here(path):
    """Paths below the working directory without it: what Make prints stays short, and a project can move."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _stamp(path):
    """Tells a given file from another put in its place, an older one too, which Make alone would not notice."""
    status = path.stat()
    return f"{path} {status.st_size} {status.st_mtime_ns}"


def makefile(plan, python, root=ROOT, title=None):
    """(text of plan.mk, {path: content of the command files})."""
    scene, build = plan.scene, plan.build
    goals = [build / goal for goal in plan.goals]
    commands, rules, reports = {}, [], []
    for goal in plan.goals:
        if given := scene.given(goal):
            stamp, target, partial = build / "commands" / f"copy.{goal}", build / goal, build / "scratch" / "copy" / goal
            commands[stamp] = _stamp(given) + "\n"
            rules.append(f"{_make(target)}: {_make(given)} {_make(stamp)}\n"
                         f"\t@mkdir -p -- {_shell([partial.parent, target.parent])}\n"
                         f"\t{_shell(['cp', '--', given, partial])} && {_shell(['mv', '--', partial, target])}\n")
    for name in plan.planned:
        stage = plan.stages[name]
        argv, inputs = command(plan, stage, python)
        stamp = build / "commands" / name
        given = [path for path in inputs if not path.is_relative_to(build)]
        commands[stamp] = "\n".join([shlex.join(argv), *map(_stamp, given)]) + "\n"
        modules = [_here(path) for path in imports(stage.script, root)]
        targets = [build / file for file in stage.outputs if not scene.given(file)]
        scratch = build / "scratch" / name if any(scene.given(f) for f in stage.writes.values()) else None
        lines = [f"{' '.join(map(_make, targets))} &: \\\n  {' '.join(map(_make, [*inputs, stage.script, *modules, stamp]))}"]
        if scratch:
            lines.append(f"\t@rm -rf -- {_shell([scratch])}; mkdir -p {_shell([scratch])}")
        lines.append("\t" + _lines(argv))
        if scratch:
            lines.append(f"\t@rm -rf -- {_shell([scratch])}")
        rules.append("\n".join(lines) + "\n")
        reports.append((name, build / stage.report))
    title = title or scene.name
    say = next((goal for goal in goals if goal.name == "report.html"), None) or " ".join(map(str, goals))
    check = [f"\t@for file in {_shell(goals)}; do [ -e \"$$file\" ] || {{ echo \"$$file: its stage ended well but did not write it\" >&2; exit 1; }}; done"] if goals else []
    check += [f"\t@if grep -qs '\"status\": \"not converged\"' {_shell([path])}; then echo {_shell([f'{title}: {name}: not converged'])}; fi" for name, path in reports]
    head = (f"# Written by lib/plan.py; do not edit.\n# " + explain(plan).replace("\n", "\n# ") + "\n\n"
            "SHELL := bash\n.SHELLFLAGS := -eu -o pipefail -c\n.DELETE_ON_ERROR:\n.SUFFIXES:\nMAKEFLAGS += --no-builtin-rules --no-print-directory\n"
            f".PHONY: done\ndone: {' '.join(map(_make, goals))}\n" + "\n".join([*check, f"\t@echo {_shell([f'{title}: {say}'])}"]) + "\n")
    return head + "\n" + "\n".join(rules), commands


def inspect(plan):
    """The content of commands/checked: which given files were opened and found good; they are not opened again until one changes."""
    files = {file for name in plan.planned for file in plan.stages[name].reads.values() if plan.scene.given(file)}
    paths = [path for file in sorted(files) if (path := plan.scene.given(file)).is_file()]
    names = {key: sorted(getattr(plan.scene, key)) for key in ("lamps", "reference", "surfaces")}
    content = "\n".join([artefact.dumps_json(names), *map(_stamp, paths)]) + "\n"
    checked = plan.build / "commands" / "checked"
    if not (checked.is_file() and checked.read_text(encoding="utf-8") == content):
        if problems := scenes.inspect(plan.scene, files):
            raise BadInput(*problems)
    return {checked: content}


def write(plan, python, root=ROOT, title=None):
    checked = inspect(plan)
    text, commands = makefile(plan, python, root, title)
    commands |= checked
    plan.build.mkdir(parents=True, exist_ok=True)
    for folder in (plan.build, plan.build / "commands"):
        artefact.remove_partials(folder)
    for path, content in commands.items():
        _write(path, content)
    for stamp in (plan.build / "commands").glob("copy.*"):
        goal = stamp.name.removeprefix("copy.")
        if not plan.scene.given(goal):              # it was given and is no more: its copy must not pass for made
            (plan.build / goal).unlink(missing_ok=True)
            stamp.unlink()
    _write(plan.build / "plan.mk", text)


# ---- the command ----

def check_name(data, name):
    folder = Path(data) / name
    if not scenes.NAME.fullmatch(name):
        raise BadInput(f"{name}: is not a scene's name: letters, digits, _ and - only")
    if name in TARGETS:
        raise BadInput(f"{folder}: a scene cannot be called {name}: that is a target of the Makefile")
    if not folder.is_dir():
        there = list_scenes(data)
        raise BadInput(f"{folder}: there is no such scene; {data} has {', '.join(there) or 'none'}")
    return folder


def list_scenes(data):
    return sorted(path.parent.name for path in Path(data).glob("*/scene.yaml"))


def main(opt):
    stages = read_pipeline(opt.pipeline)
    root = Path(opt.pipeline).resolve().parent
    wishes = {}
    for wish in opt.wishes or (list_scenes(opt.data) if opt.show else []):
        name, slash, stage = wish.partition("/")
        wishes.setdefault(name, []).append(stage if slash else None)
    problems = []
    for name, wished in wishes.items():
        try:
            folder = check_name(opt.data, name)
            if (Path(opt.build) / name).resolve() == folder.resolve():
                raise BadInput(f"BUILD: {opt.build}: the outputs would lie in the scene's folder")
            plan = walk(scenes.read(folder, stages), stages, opt.build, wished)
            if opt.show:
                print(explain(plan))
            else:
                write(plan, opt.python, root, title=opt.wishes[0] if len(opt.wishes) == 1 else name)
        except BadInput as bad:
            problems += bad.problems
            if opt.show:
                print(f"{name}: cannot be planned")
    if problems:
        raise BadInput(*problems)


parser = argparse.ArgumentParser(prog="plan.py", description=__doc__.split("\n")[0])
parser.add_argument("wishes", nargs="*", metavar="SCENE[/STAGE]")
parser.add_argument("--data", default="data")
parser.add_argument("--build", default="build")
parser.add_argument("--pipeline", default="pipeline.yaml")
parser.add_argument("--python", default=sys.executable, help="the interpreter that the stages run under")
parser.add_argument("--show", action="store_true", help="say what runs and what is left out, and why; without names: every scene")

if __name__ == "__main__":
    stages_.run(main, parser)
