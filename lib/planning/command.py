"""The command line of a stage, and the files that an edit of reruns it."""

import ast
import functools
import os
from pathlib import Path
from typing import NamedTuple

from lib.core import artefact
from lib.core.stage import option_of
from lib.planning.pipeline import CHANGED, REPORTS


class Command(NamedTuple):
    """How a stage is run in one scene."""

    argv: list[str]  # what Make prints can be pasted
    inputs: list[Path]  # given files and outputs of stages, which the stage depends on


def command(plan, stage, python) -> Command:
    """The command line of a planned stage."""
    argv, inputs = [python, stage.script], []
    for option, file in [*stage.reads.items(), *stage.may_read.items()]:
        words, files = _reading(plan, stage, file)
        if words:
            argv += [option_of(option), *words]
        inputs += files
    for option, key in stage.facts.items():
        fact = plan.scene.entry(stage.entry) if key == "entry" else plan.scene.fact(key)
        if fact is not None:
            argv += [option_of(option), fact if key == "scene" else artefact.dumps_json(fact)]
    refines = {option: plan.refines_in(stage) / file for option, file in stage.refines.items()} if plan.is_draft else {}
    written = {option: plan.destination(stage, file) for option, file in stage.written.items()} | refines
    for option, path in written.items():
        argv += [option_of(option), str(path)]
    argv += ["--report", str(plan.folder(stage) / stage.report)]
    argv += [word for folder in stage.beside if stage.entry for word in ("--frames", str(plan.folder(stage) / folder))]
    inputs += plan.scene.entry_files(stage.entry) if stage.entry else []
    for name, value in {**stage.params, **plan.scene.params.get(stage.kind, {})}.items():
        if value is not None:
            argv += [option_of(name), value if isinstance(value, str) else artefact.dumps_json(value)]
    return Command(argv, list(dict.fromkeys(inputs)))


def _reading(plan, stage, file):
    """(words after the option, files to depend on) of one file that a stage reads, or may read."""
    if file == REPORTS:
        reports = [plan.folder(plan.stages[name]) / plan.stages[name].report for name in plan.before(stage)]
        return [str(path) for path in reports], reports
    if file == CHANGED:
        stages = [plan.stages[name] for name in plan.before(stage) if plan.stages[name].entry]
        changed = [plan.folder(other) / next(iter(other.writes.values())) for other in stages]
        return [str(path) for path in changed], changed
    if file.endswith("/"):
        folder = plan.scene.given(file)
        if not folder:
            return [], []
        return [os.path.join(folder, "")], sorted(p for p in folder.rglob("*") if p.is_file())
    path = plan.find(file)
    own = file in stage.refines.values()  # of the first of its two runs, which the second waits for
    if not path or own and plan.is_draft and stage.name == plan.refiners[0].name:
        return [], []
    if own:
        return [str(path)], []
    materials = sorted(path.parent.glob("*.mtl")) if path.suffix == ".obj" else []
    waits = plan.certain(file)
    return [str(path)], [*([waits] if waits else []), *materials]


# ---- imports ----


ASSETS = (".html", ".css", ".js")  # of a package, beside its modules


def imports(script, root) -> list[Path]:
    """The files under root that script imports, at any depth, also inside functions: what an edit of them reruns.

    A package's templates count as well.
    """
    found, todo = set(), [Path(script).resolve()]
    while todo:
        path = todo.pop()
        if path in found:
            continue
        found.add(path)
        if path.name == "__init__.py":
            beside = [*path.parent.glob("*"), *path.parent.glob("templates/*")]
            found |= {file for file in beside if file.suffix in ASSETS}
        for name in _imported_names(path, root):
            parts = name.split(".")
            for depth in range(1, len(parts) + 1):
                stem = root.joinpath(*parts[:depth])
                todo += [p for p in (stem.with_suffix(".py"), stem / "__init__.py") if p.is_file()]
    return sorted(found - {Path(script).resolve()})


@functools.cache
def _imported_names(path, root):
    """Dotted names of modules, and of what may be modules, that the file at path imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:  # relative
                package = path.relative_to(root).parent.parts
                package = package[: len(package) - node.level + 1]
                base = ".".join([*package, base] if base else package)
            names |= {base} | {f"{base}.{alias.name}" for alias in node.names}
    return names
