"""A fit of the whole picture with the causes that it took."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from lib.analysis.causes import lamp_lobe
from lib.analysis.causes.candidates import NATS, Candidate
from lib.analysis.causes.scope import Scope
from lib.analysis.causes.table import causes_of
from lib.analysis.fit.equations import Unknowns
from lib.analysis.fit.gauss_newton import fit
from lib.analysis.fit.problem import Problem, Result
from lib.analysis.seen.gather import Gathered
from lib.given.view import View

SURE_PER_TILE = 0.1  # Nats per tile that causes must bring where a mirror or a lobe may be what is wrong.


@dataclass(frozen=True)
class Explained:
    """A fit, and the causes that it took.

    scale : what fixed the scale of the light;  rivals : {kind: nats} of other transfer functions
    taken : [Taken], in the order in which they were taken;  values : {cause: what it found}
    given, best : the rough fits under the given facts and with the causes;  scope : None where nothing was looked for
    """

    problem: Problem
    result: Result
    scale: str
    rivals: dict = field(default_factory=dict)
    taken: list = field(default_factory=list)
    values: dict = field(default_factory=dict)
    given: Candidate | None = None
    best: Candidate | None = None
    scope: Scope | None = None

    @property
    def is_sure(self):
        """No material could bring as much: the causes are taken even where groups are no diffuse ones."""
        return not self.taken or sum(taken.nats for taken in self.taken) >= surely(self.problem)

    def without_causes(self, **options) -> Explained:
        """The fit under the given facts. options : of gauss_newton.gauss_newton"""
        result, scale = fit(self.given.problem, start=self.given.start, **options)
        return Explained(self.given.problem, result, scale, given=self.given, best=self.given, scope=self.scope)

    def kept(self, **options) -> Explained:
        """Without the causes where they do not suffice: what is wrong may be none of them, and they only bend to it."""
        suffices = not self.taken or self.result.fits or self.is_sure
        return self if suffices else self.without_causes(**options)

    @property
    def lobes(self):
        """{lamp: (4,) unit aim and exponent} that were found."""
        return lamp_lobe.found_in(self.values.get(lamp_lobe.LampLobe.name, {}), self.problem, self.result)

    def says(self, name, problem, result):
        """[(subject, values, sigma)] of a cause that was taken. problem, result : of the last fit"""
        return causes_of(self.scope)[name].says(self.values.get(name), problem, result)

    @property
    def _found(self):
        """[(cause, its values)] of those that have values."""
        causes = causes_of(self.scope).values() if self.values else ()
        return [(cause, self.values[cause.name]) for cause in causes if cause.name in self.values]

    def evened(self, gathered: Gathered) -> Gathered:
        """Tiles as they would be without the causes, where pixels can be put right."""
        for cause, values in self._found:
            gathered = cause.evened(gathered, values, self.result.state.transfer)
        return gathered

    def flattened(self, view: View, found: Gathered, **options):
        """(self, view, found) where all causes stand fast; of the photograph without them, as far as it can be."""
        if self.problem.cause is None:
            return self, view, found
        state, found = self.result.state, self.evened(found)
        problem = replace(self.problem, pixels=found.pixels, gain=None, cause=None)
        result, scale = fit(problem, start=Unknowns(state.rho, state.E, state.transfer), **options)
        for cause, values in self._found:
            view = cause.undone(view, values, state.transfer)
        return replace(self, problem=problem, result=result, scale=scale), view, found


@dataclass(frozen=True)
class Taken:
    """A cause that was taken. nats : by which it beats what was there before;  rivals : {cause: nats} of the others"""

    cause: str
    nats: float
    rivals: dict

    @property
    def name(self):
        """As materials.json has it."""
        return "curve" if self.cause == "response" else self.cause


def surely(problem: Problem) -> float:
    """Nats that nothing brings which only bends to a thing, a mirror or a lobe."""
    return NATS + SURE_PER_TILE * len(problem.tile_group)
