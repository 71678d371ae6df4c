"""The walk back from what is wished for: which stages run, and why the others do not.

Three rules: a file in the scene's folder is given; a stage runs only if one of its files is needed; a `may_read` file
is passed on when it is there and pulls nothing in.
"""

import textwrap
from dataclasses import dataclass, replace
from pathlib import Path

from lib.core.stage import BadInput
from lib.given.causes import GEOMETRIC
from lib.planning import doctor, near_misses
from lib.planning.files import MODEL, PHOTOGRAPH, SIDES, alternatives, export_kind, photograph_of
from lib.planning.pipeline import CHANGED, REPORTS, Stage
from lib.planning.scene import Scene

BY_NAME = "by name"  # in `asked_by`: a scene that does not ask for the stage may have it by `make <scene>/<stage>`
PAIRED = (photograph_of("right"), "right.cameramodel", "boards/", "right.posed.cameramodel")  # with one it is a pair
CLOSING = ("scorecard.csv", "photos.json")  # goals of every scene that knows their stages, whatever it says


@dataclass
class Plan:
    """What runs for one scene."""

    scene: Scene
    stages: dict[str, Stage]  # every stage of the pipeline, in order
    build: Path  # build/<scene>
    planned: list[str]  # names, in order
    goals: list[str]  # files
    passed_over: dict[str, str]  # stage -> its output that was needed but is given
    again: tuple[str, ...] = ()  # stages that run first in draft/, and again where the last one refines what they read
    is_draft: bool = False  # it tells of the first of these runs

    @property
    def draft(self) -> "Plan":
        """What runs first."""
        return replace(self, is_draft=True)

    @property
    def refiners(self) -> list[Stage]:
        """The stages that may refine camera and model, in order: all read what the first writes. [] without any."""
        return [stage for stage in map(self.stages.get, self.again) if stage.refines]

    @property
    def refiner(self) -> Stage | None:
        """The last of them, after which those above run again; None where nothing is refined."""
        return self.stages[self.again[-1]] if self.again else None

    @property
    def told_again(self) -> list[str]:
        """The files that only the last of them writes: where one is there, those above run again."""
        before = {file for stage in self.refiners[:-1] for file in stage.refines.values()}
        return [file for file in self.refiner.refines.values() if file not in before]

    def folder(self, stage) -> Path:
        """Where a stage writes."""
        return self.build / "draft" if self.is_draft and stage.name in self.again else self.build

    def refines_in(self, stage) -> Path:
        """Where a stage writes a camera and a model: what the last one writes is of no draft."""
        return self.build if stage is self.refiner else self.folder(stage)

    def before(self, stage) -> list[str]:
        """The planned stages above one."""
        order = list(self.stages)
        return [name for name in self.planned if order.index(name) < order.index(stage.name)]

    def writer(self, file) -> tuple[Stage, str] | None:
        """The planned stage that writes file or may write it, and which of the alternatives; None where none does."""
        for stage in map(self.stages.get, self.planned):
            for name in alternatives(file):
                if name in stage.files and name not in stage.refines.values():
                    return stage, name
        return None

    def refined(self, file) -> bool:
        """Whether the file may be there, written by a stage that refines and has run."""
        done = self.refiners[:-1] if self.is_draft else self.refiners
        return any(file in stage.refines.values() for stage in done)

    def find(self, file) -> Path | None:
        """Where the reader of file looks for it: given, or made by a planned stage; else None."""
        if given := self.scene.given(file):
            return given
        if self.refined(file):
            return (self.build / "draft" if self.is_draft else self.build) / file
        made = self.writer(file)
        return self.folder(made[0]) / made[1] if made else None

    def certain(self, file) -> Path | None:
        """What Make can wait for: `find`, or the writer's report where a planned stage need not write the file.

        None where there is nothing to wait for.
        """
        made = None if self.scene.given(file) else self.writer(file)
        if made and made[1] not in made[0].outputs:
            return self.folder(made[0]) / made[0].report
        if self.refined(file) and not self.scene.given(file):
            first = self.refiners[0]  # its second run waits for the others
            runs = self.draft if first is self.refiner else self
            # else what lies there is taken, or nothing
            return runs.folder(first) / first.report if first.name in self.planned else None
        return self.find(file)

    def destination(self, stage, file) -> Path:
        """A given file is never overwritten: what the stage makes of it goes to a scratch folder."""
        return self.build / "scratch" / stage.name / file if self.scene.given(file) else self.folder(stage) / file


def walk(scene, stages, build, wishes=(None,)) -> Plan:
    """The plan for the wishes: None for the scene's goals, else a stage's name.

    "Up to one stage" takes in what that stage may read if the scene's goals have it made: its command line, and so its
    answer, are those of the whole scene.

    Raises BadInput that lists every problem, the scene's too.
    """
    wished = lambda stage: BY_NAME in stage.asked_by and stage.name in wishes
    asked = lambda stage: not stage.asked_by or wished(stage) or any(map(scene.asks, stage.asked_by))
    every = [one for stage in stages.values() if asked(stage) for one in stage.of_entries(scene)]
    stages = {stage.name: stage.within(scene) for stage in every}
    entries = [file for stage in stages.values() if stage.entry for file in stage.written.values()]
    closing = [goal for goal in CLOSING if any(goal in s.files for s in stages.values())]
    files = [file for stage in stages.values() for file in stage.outputs]
    closing += [file for file in files if export_kind(file) in scene.exported]
    whole = _Walk(scene, stages)
    for goal in [*scene.goals, *entries, *closing]:
        whole.need(goal, goal)
    walks, goals, problems = [], [], list(scene.problems)
    for wish in wishes:
        if wish is None:
            walks.append(whole)
            goals += [*scene.goals, *entries, *closing]
        elif meant := [stage for stage in stages.values() if wish in (stage.name, stage.kind)]:
            walks.append(_Walk(scene, stages, whole.planned))
            for stage in meant:
                walks[-1].plan(stage, f"{scene.name}/{wish}")
                goals += [file for file in stage.outputs if not scene.given(file)]
        else:
            problems.append(f"{scene.name}/{wish}: there is no such stage; stages are {', '.join(stages)}")
    planned = [name for name in stages if any(name in way.planned for way in walks)]
    passed_over = {name: file for way in walks for name, file in way.passed_over.items()}
    again = _again(scene, stages, whole.planned)
    plan = Plan(scene, stages, Path(build) / scene.name, planned, list(dict.fromkeys(goals)), passed_over, again)
    problems += [problem for way in walks for problem in way.problems]
    problems += [*_missing_facts(plan), *_missing_of_the_system(plan)]
    if problems:
        raise BadInput(*dict.fromkeys(problems))
    return plan


def _again(scene, stages, planned) -> tuple[str, ...]:
    """The stages that run again where one of them refines camera or model, that one last; () where none may."""
    refiners = [stages[name] for name in stages if name in planned and stages[name].refines]
    if not refiners or scene.explain is not None and not set(scene.explain) & set(GEOMETRIC):
        return ()
    last = refiners[-1]
    before = list(stages)[: list(stages).index(last.name)]
    reads = lambda stage: set(stage.may_read.values()) & set(last.refines.values())
    again = (*(name for name in before if name in planned and reads(stages[name])), last.name)
    if any(scene.given(file) for name in again for file in stages[name].files):
        return ()  # what is given stays, and would not be that of another camera
    return again


class _Walk:
    """Back from files that are needed; `optional`: stages whose files are worth passing on, though only if may-read."""

    def __init__(self, scene, stages, optional=frozenset()):
        self.scene, self.stages, self.optional = scene, stages, optional
        self.writer = {file: stage for stage in stages.values() for file in stage.files}
        self.planned, self.passed_over, self.problems, self.seen = set(), {}, [], set()

    def refuse(self, problem):
        self.problems.append(f"{self.scene.folder / 'scene.yaml'}: goals: {problem}")

    def maker(self, file):
        """The stage that makes file, or None."""
        return next((self.writer[name] for name in alternatives(file) if name in self.writer), None)

    def need(self, file, goal, reader=None):
        """File must be there, for the sake of goal."""
        if file in self.seen:
            return
        self.seen.add(file)
        maker = self.maker(file)
        if given := self.scene.given(file):
            if maker:
                self.passed_over[maker.name] = given.name
        elif maker:
            self.plan(maker, goal, file)
        elif reader and (near := self.near_misses(file)):
            self.problems += near
        elif reader:
            names = " or ".join(alternatives(file))
            self.refuse(f"{goal} needs {names}, which is not in the scene's folder (stage {reader.name})")
        else:
            self.refuse(f"{goal} is neither made by a stage nor given")

    def near_misses(self, file) -> list[str]:
        """Lines about files that may be meant, where `file` can only be given and is not."""
        folder, made = self.scene.folder, [name for stage in self.stages.values() for name in stage.files]
        if file == PHOTOGRAPH:
            return near_misses.photograph(folder, "left", made)
        if file == MODEL:
            return near_misses.model(folder)
        if file.startswith("right.") and not any(map(self.scene.given, PAIRED)):
            near = near_misses.photograph(folder, "right")
            told = self.scene.given("left.posed.cameramodel") or self.scene.is_told
            return near or (near_misses.pose(folder) if self.scene.given(PHOTOGRAPH) and not told else [])
        return []

    def plan(self, stage, goal, file=None):
        """Stage must run, for the sake of goal, because of file."""
        if stage.name in self.planned:
            return
        self.planned.add(stage.name)
        if not stage.built:
            wanted = "" if file in (None, goal) else f" needs {' or '.join(alternatives(file))}, which is not given"
            self.refuse(f"{goal}{wanted}: the stage {stage.name} is not built yet")
            return
        for read in stage.reads.values():
            self.need(read, goal, stage)
        for read in stage.may_read.values():
            for name in self.optional_makers(read, stage):
                self.plan(self.stages[name], goal)

    def optional_makers(self, file, reader):
        """The stages that make what reader may read, if they are worth it."""
        if refiners := [stage.name for stage in self.stages.values() if file in stage.refines.values()]:
            order = list(self.stages)  # what those below it write comes of itself, with the first of two runs
            makers = [name for name in refiners if order.index(name) < order.index(reader.name)]
        elif file in (REPORTS, CHANGED):
            makers = list(self.stages)[: list(self.stages).index(reader.name)]
        else:
            maker = None if self.scene.given(file) else self.maker(file)
            makers = [maker.name] if maker else []
        return [name for name in makers if name in self.optional]


# ---- what only matters once it is known which stages run ----


def _missing_facts(plan):
    """Lamps, a board, or the other camera that a planned stage needs to know."""
    scene, yaml = plan.scene, plan.scene.folder / "scene.yaml"
    said = lambda key: any(problem.startswith(f"{yaml}: {key}") for problem in scene.problems)
    photometry = [n for n in plan.planned if {"lamps", "lamp_groups"} & set(plan.stages[n].facts.values())]
    if photometry and not scene.lamps and not said("lamps"):
        way = "write `lamps: {lamp: unknown}`, by the names of the model's groups"
        yield f"{yaml}: lamps: missing, and {photometry[0]} needs to know which groups emit: {way}"
    calibrators = [n for n in plan.planned if "board" in plan.stages[n].facts.values()]
    if not calibrators:
        return
    boards = scene.given("boards/")
    if boards and scene.board is None and not said("board"):
        yield f"{yaml}: board: missing, and {calibrators[0]} needs to know the corners and squares of {boards}/"
    lone = [side for side in SIDES if scene.given(f"{side}.cameramodel")]
    if not boards and len(lone) == 1 and any(map(scene.given, PAIRED)):
        camera = scene.folder / f"{lone[0]}.cameramodel"
        yield f"{camera}: is given, but not that of the other photograph: give both, or none"


def _missing_of_the_system(plan):
    """What planned stages need to be installed."""
    needs = {
        need: name
        for name in plan.planned
        if plan.stages[name].built
        for need, file in plan.stages[name].needs.items()
        if file is None or plan.scene.given(file)
    }
    return [problem for need, name in needs.items() for problem in doctor.refusals(need, name)]


# ---- in words ----


def explain(plan) -> str:
    """The chain, and a reason for every stage that is left out.

    Also what stages leave out as long as no error asks for it.

    furnace: index -> formfactors -> fit -> render
      without segment: no goal needs it
      without recognise: its output is given
      without mirror buffers, lobes and textures: fit and render make them only where ...
    """
    lines = [f"{plan.scene.name}: {' -> '.join(plan.planned) or 'nothing to run'}"]
    lines += [f"  copied: {goal} is given" for goal in plan.goals if plan.scene.given(goal)]
    for name, stage in plan.stages.items():
        kept = [file for file in stage.written.values() if plan.scene.given(file)]
        if name in plan.planned:
            lines += [f"  {name} leaves {file} as it is given" for file in kept]
        elif name in plan.passed_over:
            lines.append(f"  without {name}: its output is given ({', '.join(kept)})")
        else:
            lines.append(f"  without {name}: no goal needs it")
    if climbs := [name for name in plan.planned if "surfaces" in plan.stages[name].facts.values()]:
        makers = [*climbs, *(name for name in ("render",) if name in plan.planned)]
        make = "make" if len(makers) > 1 else "makes"
        lines.append(
            f"  without mirror buffers, lobes and textures: {' and '.join(makers)} {make} them only where a group's "
            "error, or `surfaces`, demands it; never for groups named diffuse"
        )
    if plan.again:
        lines.append(f"  without a second run of {', '.join(plan.again)}: only where its light puts a lamp elsewhere")
    return "\n".join(lines)


def overview(plans) -> str:
    """Scenes of the same chain together, on one screen: the chain, whose it is, and what is left out of all chains."""
    chains = {}
    for plan in plans:
        chains.setdefault(tuple(plan.planned), []).append(plan)
    lines = []
    for chain, same in chains.items():
        lines += _wrapped(" -> ".join(chain) or "nothing to run", "")
        lines += _wrapped(", ".join(plan.scene.name for plan in same), "    ")
    given, unasked = {}, set.intersection(*(set(plan.stages) - set(plan.planned) for plan in plans))
    for plan in plans:
        for name in plan.passed_over.keys() - set(plan.planned):
            given.setdefault(name, []).append(plan.scene.name)
    many = lambda names: f"{len(names)} scenes" if len(names) > 3 else ", ".join(names)
    lines += [f"left out, for its output is given: {name} ({many(names)})" for name, names in given.items()]
    unasked -= given.keys()
    if unasked:
        order = [name for name in plans[0].stages if name in unasked]
        lines += _wrapped(f"left out of all, for no goal needs it: {', '.join(order)}", "")
    return "\n".join([*lines, "of one scene, with reasons: make plan SCENE=<scene>"])


def _wrapped(text, indent):
    return textwrap.wrap(text, 118, initial_indent=indent, subsequent_indent=indent + "    ")
