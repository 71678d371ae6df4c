"""From one photograph's facts and light to its materials: causes of the whole picture, then geometry, then the ladder.

    answer = solve(task, report)

What explains least comes first, and what is not needed is not computed. Where camera or model should have been others
the answer says so (`refined`), and is good for nothing else: all is to be made again from them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from lib.analysis import agreement, explain, glow, lamp_lobe
from lib.analysis.agreement import in_doubt
from lib.analysis.audit import LEFT, Audit
from lib.analysis.climbing import Climb
from lib.analysis.explain import Explained, Leave
from lib.analysis.gather import Gathered
from lib.analysis.lamp_lobe import LampLobes
from lib.analysis.problem import Problem, Result
from lib.core.report import Report
from lib.given.cameras import Camera
from lib.given.causes import GEOMETRIC
from lib.given.kinds import LOBES, MIRRORS
from lib.given.view import View
from lib.light.factors_file import FormFactors

EVERYWHERE, SEVERAL = 0.75, 3  # share and number of groups that differ, from which no material is looked for


@dataclass(frozen=True, eq=False)
class Task:
    """What is given.

    view : reads photograph, model, camera and facet.png, which only some scenes need; None where they are not there
    audit : the light of all pixels, or None
    lamps, place_sigma_m, surfaces, transfer, causes : as scene.yaml has them (causes: `explain`, or None)
    lobes : {lamp: (4,)} that scene.yaml tells, which factors, found and audit know;  lobes_unknown : {lamp} to be found
    lambertian : (factors, found) that do not know them
    gamma : where it starts
    may_refine : camera and model are as given, and others may be asked for;  refined : [Cause] that were, else
    options : of gauss_newton.gauss_newton
    """

    problem: Problem
    found: Gathered
    factors: FormFactors
    camera: Camera | None
    view: Callable[[], View] | None
    audit: Gathered | None
    lamps: dict
    place_sigma_m: dict
    lobes: dict
    lambertian: tuple
    lobes_unknown: set
    surfaces: dict
    transfer: object
    causes: list | None
    gamma: float
    threshold: float
    lobe_rays: int
    may_refine: bool
    refined: list
    options: dict

    def in_lobes(self, lobes) -> Task:
        """The same with the light of lamps that throw it in lobes {lamp: (4,)}."""
        if not lobes:
            return self
        factors, found, audit = lamp_lobe.in_lobes(self.view(), self.factors, lobes, self.found, self.audit)
        return replace(self, factors=factors, found=found, audit=audit)

    @property
    def lamp_lobes(self) -> LampLobes | None:
        """Of the lamps whose lobe scene.yaml leaves open."""
        told = any(kind in (*MIRRORS, *LOBES) for kind in self.surfaces.values())  # their light looks like a lobe's
        may = not told and (self.causes is None or lamp_lobe.NAME in self.causes)
        open_ = self.factors.own_lamps if may else self.lobes_unknown
        wanted = [lamp for lamp in self.factors.own_lamps if lamp in open_ and lamp not in self.lobes]
        if not wanted or not self.can_look:
            return None
        return LampLobes(self.view, self.factors, self.found, tuple(wanted), bool(self.lobes_unknown))

    @property
    def allowed(self):
        """The geometric causes that may be taken."""
        return set(GEOMETRIC if self.causes is None else self.causes)

    @property
    def can_look(self):
        """Whether pixels and edges of the photograph can be looked at, and are worth it."""
        seen = self.view is not None and len(self.problem.tile_group) > 0
        return seen and not agreement.out_of_range(self.found)


@dataclass
class Answer:
    """What was found. problem, result, scale : in the end;  refined : a Refinement, or None

    audit, judged : of all pixels and `explained`, its misfits; None where they were not looked at
    ascent : of the ladder, None where all is diffuse;  why : [Why] photograph and facts do not agree
    """

    explained: Explained
    problem: Problem
    result: Result
    scale: str
    audit: Audit | None = None
    judged: dict | None = None
    ascent: object = None
    refined: object = None
    why: list = field(default_factory=list)
    warnings: list = field(default_factory=list)

    @property
    def climb(self) -> Climb | None:
        return self.ascent.climb if self.ascent else None


def solve(task: Task, report: Report) -> Answer:
    """report : gets the trace, and what the ladder did"""
    trace = lambda iteration, image_rmse, state: report.trace(
        iteration=iteration, image_rmse=image_rmse, gamma=state.gamma
    )
    options = {"trace": trace, **task.options}
    edges = _edges(task) if task.can_look and task.causes != [] else None
    may_refine = task.may_refine and edges is not None
    if may_refine and (edges.is_lost or edges.allowed(task.allowed)):
        # whatever else the photograph might tell would only bend to this
        answer = _answer(explain.explain(task.problem, Leave(False, ()), gamma=task.gamma, **options))
        answer.refined, answer.why = None if edges.is_lost else _by_edges(task, edges), edges.why
        if answer.refined is not None or edges.is_lost and in_doubt(answer.result):
            return answer
    problem = task.problem if edges is None else replace(task.problem, unsure=_unsure(task, edges))
    leave = Leave.of(task.camera, task.found, task.transfer, task.causes, task.lamp_lobes)
    explained = explain.without_lobes(problem, leave, gamma=task.gamma, **options)
    if task.can_look and (wrong := _told_wrong(task, explained)):
        answer = _answer(explained.kept(**options))
        answer.why = agreement.joined(wrong, _missing(task, answer.explained, _audit(task, answer.explained)))
        return answer
    lobed = explain.with_lobes(explained, leave, **options)
    explained = explained.kept(**options)
    if not task.can_look:
        answer = _answer(explained)
        answer.why = _why(task, answer, edges)
        return answer
    plain, in_lobes = task, task.in_lobes(lobed.lobes)
    if lobed.lobes and (leave.lobes.asked or _suffices(task, explained, in_lobes, lobed)):
        task, explained = in_lobes, lobed
    audit = _audit(task, explained)
    judged = audit.misfits(explained.problem, explained.result)
    report["ladder"] = _summary(task, explained.problem, judged)
    if may_refine and "lamp_place" in task.allowed and not edges.why and in_doubt(explained.result):
        refined = _by_light(plain, explained, audit if task is plain else _audit(plain, explained))
        if refined is not None:
            return _answer(explained, refined=refined, why=refined.why)
    if wrong := explain.lamps_told_wrong(explained, leave, **options):
        answer = _answer(explained, audit, judged)
        answer.why = agreement.joined(wrong, _missing(task, explained, audit))
        return answer
    answer = _materials(task, explained, audit, judged, report)
    if lobed.lobes and task is plain and not agreement.fits(answer.result):
        task, audit = in_lobes, _audit(in_lobes, lobed)  # nothing suffices, lobes come nearest
        answer = _answer(lobed, audit, audit.misfits(lobed.problem, lobed.result))
    answer.warnings += [
        f"lamp {lamp!r}: no lobe fits the photograph better than an even lamp"
        for lamp in sorted(task.lobes_unknown - answer.explained.lobes.keys())
    ]
    answer.why = _why(task, answer, edges)
    return answer


def _suffices(task, explained, in_lobes, lobed) -> bool:
    """Lobes of lamps leave nothing to explain: what mirrors and lobes of surfaces throw may look like them."""
    if not agreement.fits(lobed.result):
        return False
    left = [_audit(t, e).energy(e.problem, e.result) for t, e in ((in_lobes, lobed), (task, explained))]
    return left[0] <= LEFT * left[1]


def _told_wrong(task, explained) -> list:
    """[Why] of lamps that scene.yaml or the model has wrong, where that is all that is wrong."""
    if agreement.fits(explained.result):
        return []
    if task.lobes:
        lobes = LampLobes(task.view, *task.lambertian, tuple(task.lobes))
        why, settled = lamp_lobe.told_wrong(explained.given, lobes, task.lobes)
        if settled:
            return why
    why, settled = agreement.lamps_told(explained.problem, explained.result)
    if settled or explained.given.typical < explain.HOPELESS:
        return why if settled else []
    from lib.analysis import refine

    return refine.flipped(task.view(), task.factors, task.found, explained)


def _missing(task, explained, audit) -> list:
    """[Why] of things that the model has not: light that they take may pass for a lamp's."""
    from lib.analysis import strangers

    return strangers.things_missing(task.view(), task.factors, explained, audit)


def _audit(task, explained) -> Audit:
    return Audit.of(task.audit, explained, task.factors, task.surfaces, task.threshold)


def _answer(explained: Explained, audit=None, judged=None, **more) -> Answer:
    return Answer(explained, explained.problem, explained.result, explained.scale, audit, judged, **more)


def _summary(task, problem, judged):
    excess = {problem.groups[g]: m.excess for g, m in judged.items() if m.judged}
    return {"threshold": task.threshold, "diffuse": excess, "rays": {}, "rounds": 0}


def _edges(task):
    """What the photograph's edges say of camera, objects and lamps."""
    from lib.analysis import places

    return places.by_edges(task.view(), task.lamps)


def _unsure(task, edges):
    """By what the lamps' light is unsure, since things stand no more surely than the edges tell."""
    from lib.analysis import refine

    loose = edges.registration.loose if edges.registration else {}
    lamps = refine.unsure(task.view(), task.factors, task.found, task.refined, loose)
    return (*lamps, *glow.unsure(task.view(), task.factors, task.found))


def _by_edges(task, edges):
    """Camera and model as the photograph's edges have them; None where the model could not keep its numbers."""
    from lib.analysis import refine

    refined = refine.by_edges(task.view(), edges)
    return refined if refined.keeps_parts else None


def _by_light(task, explained, audit):
    """The model with the lamp where its light has it, or None."""
    from lib.analysis import refine

    refined = refine.by_light(task.view(), task.factors, task.found, explained, audit, task.place_sigma_m)
    return refined if refined is not None and refined.keeps_parts else None


def _materials(task, explained, audit, judged, report) -> Answer:
    """What is left is the groups' own: the ladder where a diffuse surface does not explain them."""
    if not audit.flagged(explained.problem, judged):
        audit.doubt(explained.problem, explained.result, judged)
        return _answer(explained, audit, judged)
    if not (explained.is_sure or explained.lobes):  # a material may bring as much as the causes that were taken
        explained = explained.without_causes(**task.options)
        audit = _audit(task, explained)
        judged = audit.misfits(explained.problem, explained.result)
        if not audit.flagged(explained.problem, judged):
            audit.doubt(explained.problem, explained.result, judged)
            return _answer(explained, audit, judged)
    if _is_wrong_everywhere(explained, audit, judged):
        return _answer(explained, audit, judged)
    with report.excluded("compile"):
        from lib.analysis import ascent

        ascent.warm_up()
    done = ascent.ascend(
        task.view(),
        task.factors,
        explained,
        task.found,
        audit.gathered,
        lobe_rays=task.lobe_rays,
        given=audit.given,
        threshold=task.threshold,
        trace=lambda round, step, fitted: report.trace(
            round=round, step=step, image_rmse=fitted.rmse, gamma=fitted.state.gamma
        ),
        options=task.options,
    )
    climb, answer = done.climb, _answer(explained, audit, judged)
    if not agreement.fits(climb.result) and not audit.given:
        return answer  # what is wrong is not one material: nothing is made up from it
    report["ladder"] |= ascent.summary(done)
    answer.warnings = ascent.warnings(done)
    if all(place.rung == "diffuse" for place in climb.places.values()):
        # the same light, but with what its causes leave unsure, which the ladder takes as they are
        audit.doubt(explained.problem, explained.result, judged)
        return answer
    audit.doubt(climb.problem, climb.result, climb.misfits, climb.places)
    answer.problem, answer.result, answer.scale, answer.ascent = climb.problem, climb.result, climb.scale, done
    return answer


def _is_wrong_everywhere(explained, audit, judged):
    """Nearly every group differs: no material of one of them can be what is wrong."""
    n_judged = sum(m.judged for m in judged.values())
    flagged = audit.flagged(explained.problem, judged)
    everywhere = len(flagged) >= max(SEVERAL, EVERYWHERE * n_judged)
    return everywhere and not agreement.fits(explained.result) and not audit.given


def _why(task, answer: Answer, edges):
    """[Why] photograph and facts do not agree, the likeliest first."""
    result, explained = answer.result, answer.explained
    why = agreement.disagreements(answer.problem, result, task.found, task.transfer, explained.rivals)
    if edges is not None and in_doubt(result):
        why = agreement.joined(why, edges.why)
    if answer.audit is None:
        return why
    return agreement.joined(why, _strange(task, answer, bool(why)))


def _strange(task, answer, is_wrong):
    """What the photograph shows and the model has not, in words. is_wrong : photograph and facts disagree anyway"""
    from lib.analysis import strangers

    explained, climb = answer.explained, answer.climb
    climbed = {} if climb is None else {g: place.rung for g, place in climb.places.items() if place.rung != "diffuse"}
    # where the picture disagrees all the same, a texture is no explanation
    doubtful = is_wrong or climb and in_doubt(climb.result)
    objects = lambda: task.view().model.objects
    sure = {g: rung for g, rung in climbed.items() if not doubtful or rung != "textured"}
    return [
        *strangers.things_missing(task.view(), task.factors, explained, answer.audit, sure),
        *(
            strangers.groups_wrong(explained.problem, explained.result, objects, climbed)
            or strangers.things_unlike(explained, answer.audit, answer.judged, objects, climbed)
        ),
    ]


def write_ladder(answer: Answer, folder, specular=None, mirror=None) -> dict:
    """Files that only some scenes have, see ascent.write_files; {group: Textured}."""
    if answer.ascent is None:
        return {}
    from lib.analysis import ascent

    return ascent.write_files(answer.ascent, Path(folder), specular, mirror)
