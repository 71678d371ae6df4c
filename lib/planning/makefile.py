"""build/<scene>/plan.mk: a plan as plain Make.

A stage depends on its inputs, its script, the modules that the script imports, and its own command line.  The command
line is a file, build/<scene>/commands/<stage>, that changes only when its content does.
"""

import re
import shlex
from dataclasses import dataclass, replace
from pathlib import Path

from lib.core import artefact
from lib.core.stage import BadInput
from lib.planning import compiling, folder, health, progress
from lib.planning.clean import PLAN, WRITTEN
from lib.planning.command import command, imports
from lib.planning.files import OBJECTS, PHOTOGRAPH, PHOTOS, PICKED, further_files, here, object_files, pixels
from lib.planning.walk import explain

ROOT = Path(__file__).resolve().parents[2]
HEAD = """
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.SUFFIXES:
MAKEFLAGS += --no-builtin-rules --no-print-directory
.PHONY: done
# V=1 shows the command lines; they also lie in commands/
Q := $(if $(filter 1,$(value V)),,@)
BEGAN := $(shell date +%s)
"""
CHECK = (
    '\t@for file in {}; do [ -e "$$file" ]'
    ' || {{ echo "$$file: its stage ended well but did not write it" >&2; exit 1; }}; done'
)


def write(plan, python, root=ROOT, title=None):
    """Write plan.mk and the command files, each only where its content changes; given files are opened first."""
    checked = inspect(plan)
    health.mend(plan)
    text, commands = makefile(plan, python, root, title)
    commands |= checked
    plan.build.mkdir(parents=True, exist_ok=True)
    for place in (plan.build, plan.build / "commands"):
        artefact.remove_partials(place)
    for path, content in commands.items():
        _write(path, content)
    commands_of = plan.build / "commands"
    for stamp in [path for path in commands_of.rglob("*") if path.is_file()]:
        name = stamp.relative_to(commands_of).as_posix()
        goal = name.removeprefix("copy.")
        if goal != name and not plan.scene.given(goal):  # it was given and is no more: its copy must not pass for made
            (plan.build / goal).unlink(missing_ok=True)
            stamp.unlink()
    _write(plan.build / PLAN, text)
    _expect(plan)


def _expect(plan):
    """commands/seconds: of each stage, how long it and all after it will take; in place, nothing waits for it."""
    left = "".join(f"LEFT_{name} := {words}\n" for name, words in _left(plan).items())
    path = plan.build / "commands" / "seconds"
    if not _holds(path, left):
        path.write_text(left, encoding="utf-8")


def inspect(plan) -> dict[Path, str]:
    """{commands/checked: which given files were opened and found good}.

    They are not opened again until one changes.  Raises BadInput with a line for each that cannot be used.
    """
    needed = {file for name in plan.planned for file in plan.stages[name].reads.values()}
    needed |= {OBJECTS for name in plan.planned if OBJECTS in plan.stages[name].may_read.values()}
    needed |= {file for file in PICKED if any(file in plan.stages[n].may_read.values() for n in plan.planned)}
    files = {file for file in (*needed, plan.scene.views["<curve>"]) if plan.scene.given(file)}
    paths = [path for file in sorted(files) if (path := plan.scene.given(file)).is_file()]
    paths += [path for path in folder.given_results(plan.scene) if path not in paths]
    names = {key: sorted(getattr(plan.scene, key)) for key in ("lamps", "reference", "surfaces")}
    if OBJECTS in files:
        paths += object_files(plan.scene.given(OBJECTS))
    if PHOTOS in files:
        paths += further_files(plan.scene.given(PHOTOS))
    if plan.scene.movable:
        names["movable"] = sorted(plan.scene.movable)
    entries = [plan.stages[name].entry for name in plan.planned if plan.stages[name].entry]
    if entries:
        names["augment"] = plan.scene.augment
        paths += [path for entry in entries for path in plan.scene.entry_files(entry)]
    content = "\n".join([artefact.dumps_json(names), *map(_stamp, paths)]) + "\n"
    checked = plan.build / "commands" / "checked"
    if not _holds(checked, content) and (problems := folder.inspect(plan.scene, files)):
        raise BadInput(*problems)
    return {checked: content}


def makefile(plan, python, root=ROOT, title=None) -> tuple[str, dict[Path, str]]:
    """(text of plan.mk, {path: content of the command files})."""
    commands, rules = {}, []
    for goal in plan.goals:
        if plan.scene.given(goal):
            rules.append(_copying(plan, goal, commands))
    for name in plan.planned:
        if name in plan.again:
            rules.append(_running(plan.draft, plan.stages[name], python, root, commands))
        rules.append(_running(plan, plan.stages[name], python, root, commands))
    return _head(plan, python, title or plan.scene.name) + "\n" + "\n".join(rules), commands


# ---- parts of plan.mk ----


def _head(plan, python, title):
    """What comes first: the plan in words, and the target `done`, which says how it went."""
    paths = {goal: plan.build / goal for goal in plan.goals}
    waits_for = {goal: path if plan.scene.given(goal) else plan.certain(goal) for goal, path in paths.items()}
    sure = [path for goal, path in paths.items() if waits_for[goal] == path]
    sure.sort(key=lambda path: path.name != "check.png")  # the first thing to look at
    page = next((path for path in sure if path.name == "report.html"), None)
    lines = [f"done: {' '.join(map(_make, dict.fromkeys(waits_for.values())))}"]
    if sure:
        lines.append(CHECK.format(_shell(sure)))
    for goal in (goal for goal, path in paths.items() if path not in sure):  # which a stage need not write
        missing = _shell([f"{goal}: not written: the scene has none"])
        lines.append(f"\t@[ -e {_shell([paths[goal]])} ] || echo {missing}")
    for name in plan.planned:
        report = _shell([plan.build / plan.stages[name].report])
        said = _shell([f"{title}: {name}: not converged"])
        lines.append(f'\t@if grep -qs \'"status": "not converged"\' {report}; then echo {said}; fi')
        said = _shell([f"{title}: {name}: does not fit: see the warnings above, and why in materials.json"])
        lines.append(f'\t@if grep -qs \'"status": "does not fit"\' {report}; then echo {said}; fi')
    said = ["--title", title, "--page", page or " ".join(map(str, sure)), "--stages", *plan.planned]
    lines.append(
        "\t@" + _shell([python, "-m", "lib.planning.progress", plan.build]) + " --began $(BEGAN) " + _shell(said)
    )
    words = f"{WRITTEN}; do not edit.\n# " + explain(plan).replace("\n", "\n# ") + "\n"
    words += f"# again: {_same_again(plan)}\n"
    seconds = f"-include {_make(plan.build / 'commands' / 'seconds')}\n"
    return words + HEAD + seconds + "\n".join(lines) + "\n"


def _same_again(plan):
    """The command that runs the scene, as lib/planning/next_steps.py reads it."""
    told = {"DATA": (plan.scene.folder.parent, "data"), "BUILD": (plan.build.parent, "build")}
    where = [f"{key}={shlex.quote(str(path))}" for key, (path, usual) in told.items() if str(path) != usual]
    return " ".join(["make", *where, plan.scene.name])


def _copying(plan, goal, commands):
    """The rule of a goal that is given."""
    given, target = plan.scene.given(goal), plan.build / goal
    stamp, partial = plan.build / "commands" / f"copy.{goal}", plan.build / "scratch" / "copy" / goal
    commands[stamp] = _stamp(given) + "\n"
    return (
        f"{_make(target)}: {'' if health.is_late(given) else _make(given)} {_make(stamp)}\n"
        f"\t@mkdir -p -- {_shell([partial.parent, target.parent])}\n"
        f"\t{_shell(['cp', '--', given, partial])} && {_shell(['mv', '--', partial, target])}\n"
    )


def _left(plan) -> dict[str, str]:
    """Of each planned stage: how long it and all after it will take, as far as is known, and compiling apart."""
    photograph = plan.scene.given(PHOTOGRAPH)
    size = min(pixels(photograph) or 0, 1e6 * plan.scene.megapixels) if photograph else None
    took = [progress.seconds(plan.stages[n].kind, plan.build / plan.stages[n].report, size) for n in plan.planned]
    kinds = [plan.stages[name].kind for name in plan.planned]
    compiles = compiling.seconds(kinds)
    left = {}
    for k, name in enumerate(plan.planned):
        first_time = compiling.words(sum(compiles[kind] for kind in dict.fromkeys(kinds[k:])))
        left[name] = f"{max(1, round(sum(took[k:])))} s left{first_time}"
    return left


def _begins(plan, stage):
    """A line of shell: which stage begins, the seconds so far, and those that are left."""
    place = f"[{plan.planned.index(stage.name) + 1}/{len(plan.planned)}]"
    return f'echo "{place} {stage.name}  $$(( $$(date +%s) - $(BEGAN) )) s, about $(LEFT_{stage.name})"'


def _running(plan, stage, python, root, commands):
    """The rule of a stage."""
    rule = _rule(plan, stage, python, root, commands)
    first = stage.name not in plan.again or plan.is_draft
    rule = replace(rule, recipe=[f"\t@{_begins(plan, stage)}", *rule.recipe]) if first else rule
    if stage.name in plan.again and not plan.is_draft:
        rule = replace(rule, inputs=[*rule.inputs, *_of_draft(plan, stage)], recipe=_again(plan, stage, rule))
    prerequisites = [*rule.inputs, stage.script, *(here(path) for path in imports(stage.script, root)), rule.stamp]
    late = [path for path in map(Path, prerequisites) if health.is_late(path)]
    commands[rule.stamp] += "".join(f"{_stamp(path)}\n" for path in late if path not in rule.inputs)
    prerequisites = [path for path in prerequisites if Path(path) not in late]
    head = f"{' '.join(map(_make, rule.targets))} &: \\\n  {' '.join(map(_make, dict.fromkeys(prerequisites)))}"
    return "\n".join([head, *rule.recipe]) + "\n"


@dataclass(frozen=True)
class _Rule:
    """targets, inputs : paths;  stamp : the path of the command's file;  recipe : lines"""

    targets: list
    inputs: list
    stamp: Path
    recipe: list


def _rule(plan, stage, python, root, commands):
    """What a stage's rule is made of."""
    scene, build = plan.scene, plan.build
    argv, inputs = command(plan, stage, python)
    stamp = build / "commands" / ("draft." * plan.is_draft + stage.name)
    given = [path for path in inputs if not path.is_relative_to(build)]
    commands[stamp] = "\n".join([shlex.join(argv), *map(_stamp, given)]) + "\n"
    folder = plan.folder(stage)
    targets = [folder / file for file in stage.outputs if not scene.given(file)]
    stale = [folder / file for file in stage.may_write.values() if not scene.given(file)]
    if plan.is_draft and stage.refines:
        of_all = [file for one in plan.refiners for file in one.refines.values()]
        stale += [plan.refines_in(stage) / file for file in dict.fromkeys(of_all)]
    scratch = build / "scratch" / stage.name if any(scene.given(file) for file in stage.written.values()) else None
    recipe = [f"\t@mkdir -p -- {_shell([folder])}"] if plan.is_draft else []
    if stale:
        recipe.append(f"\t@rm -f -- {_shell(stale)}")
    if scratch:
        recipe.append(f"\t@rm -rf -- {_shell([scratch])}; mkdir -p {_shell([scratch])}")
    recipe.append("\t$(Q)" + _broken(argv))
    if scratch:
        recipe.append(f"\t@rm -rf -- {_shell([scratch])}")
    return _Rule(targets, inputs, stamp, recipe)


def _of_draft(plan, stage):
    """What the second run waits for: what the first has written, and whether its last stage refined the model."""
    draft = plan.draft
    waits = [draft.folder(stage) / file for file in stage.outputs]
    if plan.refiner.name in plan.planned:
        waits.append(draft.folder(plan.refiner) / plan.refiner.report)
    return waits


def _again(plan, stage, rule):
    """The recipe of a second run: the files of the first are good where its last stage refined nothing."""
    refined = " || ".join(f"[ -e {_shell([plan.build / file])} ]" for file in plan.told_again)
    files = [*stage.written.values(), stage.report, *stage.beside]
    files += stage.refines.values() if stage is not plan.refiner else ()
    build, draft = plan.build, plan.draft.folder(stage)
    copy = draft / f".{stage.name}"
    run = " && \\\n\t".join(line.removeprefix("\t").removeprefix("@").removeprefix("$(Q)") for line in rule.recipe)
    lines = [
        f"@if {refined}; then",
        f"echo {_shell([f'{stage.name}: again, with the refined model'])};",
        f"{run};",
        f"else rm -rf -- {_shell([copy])} && mkdir -p -- {_shell([copy])} && for file in {_shell(files)}; do",
        f'rm -rf -- {_shell([build])}/"$$file"; [ ! -e {_shell([draft])}/"$$file" ] ||',
        f'{{ cp -R -- {_shell([draft])}/"$$file" {_shell([copy])}/ &&',
        f'mv -- {_shell([copy])}/"$$file" {_shell([build])}/; }} || exit 1;',
        f"done; rm -rf -- {_shell([copy])}; fi",
    ]
    return ["\t" + " \\\n\t".join(lines)]


# ---- words of Make and of the shell ----


def _make(path):
    """A path as a target or prerequisite."""
    text = str(path)
    if re.search(r"[\n\t;:=*?\[\]%|&<>\"'`\\~]", text):
        raise BadInput(f"{text}: Make cannot handle a file of this name")
    return text.replace("$", "$$").replace("#", r"\#").replace(" ", r"\ ")


def _shell(words):
    return " ".join(shlex.quote(str(word)) for word in words).replace("$", "$$")


def _broken(argv, width=118):
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


# ---- files that change only when their content does ----


def _holds(path, text):
    return path.is_file() and path.read_text(encoding="utf-8") == text


def _write(path, text):
    """Written only when it changes, and whole."""
    if not _holds(path, text):
        with artefact.writing(path) as partial:
            Path(partial).write_text(text, encoding="utf-8")


def _stamp(path):
    """Tells a given file from another put in its place, an older one too, which Make alone would not notice."""
    status = path.stat()
    return f"{path} {status.st_size} {status.st_mtime_ns}"
