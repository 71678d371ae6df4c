"""Global causes before materials: what may be wrong with the picture as a whole, judged before any group climbs.

The fit under the given facts comes first. From there one step towards each cause tells what it would bring to held-out
tiles: next to nothing where the facts suffice, and then nothing more is computed. Causes that promise enough are
fitted, the best is taken if it keeps its promise, and the question is asked again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from lib.analysis import responses, vignetting
from lib.analysis.agreement import fits, out_of_range
from lib.analysis.candidates import NATS, Candidate, enough
from lib.analysis.equations import Unknowns
from lib.analysis.facts import USUAL_GAMMA
from lib.analysis.gather import Gathered
from lib.analysis.gauss_newton import fit
from lib.analysis.problem import Problem, Result
from lib.given.causes import BUILT
from lib.given.falloff import Lens
from lib.given.view import View

STARTS = (1.2, 1.8, 3.0)  # other gammas to begin at
HOPELESS = 0.015  # display, median of the tiles: no other start of gamma explains what is so far off
SURE_PER_TILE = 0.1  # nats that causes must bring where a mirror or a lobe may be what is wrong


@dataclass(frozen=True)
class Explained:
    """A fit, and the causes that it took.

    scale : what fixed the scale of the light;  rivals : {kind: nats} of other transfer functions
    taken : [Taken], in the order in which they were taken;  values : {cause: what it found}
    given : the rough fit under the given facts;  lens : None where nothing is known of it
    """

    problem: Problem
    result: Result
    scale: str
    rivals: dict = field(default_factory=dict)
    taken: list = field(default_factory=list)
    values: dict = field(default_factory=dict)
    given: Candidate | None = None
    lens: Lens | None = None

    @property
    def is_sure(self):
        """No material could bring as much: the causes are taken even where groups are no diffuse ones."""
        nats = sum(taken.nats for taken in self.taken)
        return not self.taken or nats >= NATS + SURE_PER_TILE * len(self.problem.tile_group)

    def without_causes(self, **options) -> Explained:
        """The fit under the given facts. options : of gauss_newton.gauss_newton"""
        result, scale = fit(self.given.problem, start=self.given.start, **options)
        return Explained(self.given.problem, result, scale, given=self.given, lens=self.lens)

    @property
    def falloff(self):
        """k of the lens, None where it is as bright in the corners."""
        found = self.values.get("vignetting")
        return None if found is None else found["k"]

    def evened(self, gathered: Gathered) -> Gathered:
        """Tiles as they would be without the lens's shadow."""
        if self.falloff is None:
            return gathered
        return vignetting.corrected(gathered, self.lens, self.falloff, self.result.state.transfer)

    def flattened(self, view: View, found: Gathered, **options):
        """(self, view, found) of the photograph without the lens's shadow, as if it had been taken so."""
        if self.falloff is None:
            return self, view, found
        state, found = self.result.state, self.evened(found)
        problem = replace(self.problem, pixels=found.pixels, gain=None, cause=None)
        result, scale = fit(problem, start=Unknowns(state.rho, state.E, state.transfer), **options)
        view = vignetting.without(view, self.lens, self.falloff, state.transfer)
        return replace(self, problem=problem, result=result, scale=scale), view, found


@dataclass(frozen=True)
class Taken:
    """A cause that was taken. nats : by which it beats what was there before;  rivals : {cause: nats} of the others"""

    cause: str
    nats: float
    rivals: dict


@dataclass(frozen=True, eq=False)
class Leave:
    """What may be explained. response : the transfer function is free;  causes : that may be taken

    lens, pixel : where the pixels (M,) of the tiles lie; None: nothing is known of the lens
    """

    response: bool = True
    causes: tuple = BUILT
    lens: Lens | None = None
    pixel: object = None

    @classmethod
    def of(cls, camera, found: Gathered, transfer, causes) -> Leave:
        """camera : Camera or None;  transfer, causes : of scene.yaml, None: all that is left open"""
        lens = None if camera is None else Lens((camera.K[0, 2], camera.K[1, 2]), (camera.width, camera.height))
        causes = tuple(BUILT if causes is None else causes)
        causes = () if out_of_range(found) else causes  # nothing can be learnt from such values
        return cls(transfer in (None, "auto") and "curve" in causes, causes, lens, found.tiles.pixel)


def explain(problem: Problem, leave: Leave, **options) -> Explained:
    """The fit with the causes that the photograph supports.

    options : of gauss_newton.gauss_newton
    """
    if not len(problem.tile_group):
        return Explained(problem, *fit(problem, **options), lens=leave.lens)
    first = _begun(problem, options.pop("gamma", None), options.get("trace"))
    best, taken, functions = _climbed(first, leave)
    result, scale = fit(best.problem, start=best.start, **options)
    result.iterations += best.result.iterations
    rivals = {c.kind: c.evidence.nats - best.evidence.nats for c in functions if c is not best}
    explained = Explained(best.problem, result, scale, rivals, taken, best.taken, first, leave.lens)
    # where they do not suffice, what is wrong may be none of these causes: they would only bend to it
    return explained if not taken or fits(result) or explained.is_sure else explained.without_causes(**options)


def _begun(problem: Problem, gamma, trace) -> Candidate:
    """The rough fit under the given facts, from other gammas as well where it leaves something to explain.

    gamma and the reflectances share a valley: dark photographs have another minimum beyond gamma 4.
    """
    first = Candidate.of(problem, trace=trace, gamma=gamma)
    if not _searches_gamma(first) or responses.promise(first) < enough(problem):
        return first
    others = [Candidate.of(problem, gamma=start) for start in STARTS]
    return max([first, *others], key=lambda c: c.evidence.nats)


def _climbed(best: Candidate, leave: Leave):
    """The best candidate, [Taken] on the way to it, and the candidates with other transfer functions."""
    taken, functions, tried = [], (), set()
    while wanted := _promising(best, leave, tried):
        tried |= wanted.keys()
        candidates = {}
        if "response" in wanted:
            functions = (best, *responses.fitted(best))
            candidates["response"] = responses.simplest(functions) if leave.response else best
        if "vignetting" in wanted:
            shadow = _vignetted(best, leave)
            candidates |= {"vignetting": shadow} if vignetting.is_shadow(shadow) else {}
        better = {cause: c for cause, c in candidates.items() if c is not best and c.beats(best)}
        if not better:
            break
        cause = max(better, key=lambda cause: better[cause].evidence.nats)
        gain = {name: c.evidence.nats - best.evidence.nats for name, c in candidates.items()}
        taken.append(Taken(cause, gain.pop(cause), gain))
        best, tried = better[cause], {t.cause for t in taken}
        functions = functions if cause == "response" else ()
    return best, taken, functions


def _vignetted(best: Candidate, leave: Leave) -> Candidate:
    """The fit with a vignetted lens, from other gammas as well where the first leaves something to explain."""
    first = vignetting.fitted(best, leave.lens, leave.pixel)
    if not _searches_gamma(first) or responses.promise(first) < enough(first.problem):
        return first
    other = vignetting.fitted_from(best, (*STARTS, USUAL_GAMMA), leave.lens, leave.pixel)
    return max(first, other, key=lambda c: c.evidence.nats)


def _searches_gamma(found: Candidate) -> bool:
    """Another start may find another gamma."""
    return found.problem.fit_transfer and found.kind == "gamma" and found.typical < HOPELESS


def _promising(found: Candidate, leave: Leave, tried) -> dict:
    """{cause: nats} of the causes that one step promises enough of."""
    promises = {}
    if found.problem.transfer.kind != "linear" and "response" not in tried:
        promises["response"] = responses.promise(found)
    if leave.lens is not None and "vignetting" in leave.causes and "vignetting" not in tried:
        promises["vignetting"] = vignetting.promise(found, leave.lens, leave.pixel)
    least = enough(found.problem)
    return {cause: nats for cause, nats in promises.items() if nats >= least}
