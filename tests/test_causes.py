"""A cause is a file and a line of a table: a new one is found, taken and reported by the search as it is."""

from dataclasses import replace

import numpy as np
import pytest

from lib.analysis.causes import explain, table
from lib.analysis.causes.cause import Cause
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.evidence import Evidence, difference
from lib.analysis.fit.problem import CauseTerms
from tests.bench import margins
from tests.helpers.made_problems import COLOURS, made


class Haze(Cause):
    """Light that falls on the sensor everywhere alike, (3,) linear."""

    name = "haze"
    free = 3

    @classmethod
    def of(cls, scope):
        return cls()

    def none(self):
        return np.zeros(3)

    def terms(self, problem, at, values):
        columns = np.zeros((*at.state.B.shape, 3))
        columns[:, np.arange(3), np.arange(3)] = at.slope
        return CauseTerms((self.name,) * 3, columns, np.full(3, 0.1), -values)

    def moved(self, values, step):
        return values + step

    def standing(self, problem, values):
        clear = np.maximum(problem.transfer.linear(self.hazy) - values, 0)
        return replace(problem, pixels=problem.transfer.display(clear))

    def may(self, found):
        self.hazy = found.problem.pixels if self.name not in found.taken else self.hazy
        return True


def photographed(haze):
    problem, rho, _ = made(COLOURS, gamma=2.0, noise=0.01)
    known = replace(problem.transfer, gamma=2.0)
    light = known.linear(problem.pixels) + haze
    return replace(problem, pixels=known.display(light), transfer=known, fit_transfer=False), rho


def test_a_new_cause_is_one_class_and_one_line(monkeypatch):
    monkeypatch.setattr(table, "CAUSES", [*table.CAUSES, Haze])
    haze = np.array([0.02, 0.0, 0.05])
    problem, rho = photographed(haze)
    scope = Scope(response=False, allowed=())
    found = explain.explain(problem, scope, max_iterations=40)
    assert [taken.cause for taken in found.taken] == ["haze"]
    assert found.values["haze"] == pytest.approx(haze, abs=2e-3)
    off = np.abs(found.result.state.rho - rho)[1:]
    assert (off < 4 * found.result.sigma_rho[1:] + 1e-3).all()
    taken = [question for question in scope.asked if question.decision == "taken"]
    assert [(q.cause, q.nats > 10, q.nats / q.dse > 2) for q in taken] == [("haze", True, True)]


def test_a_cause_that_is_not_there_is_asked_for_and_not_fitted(monkeypatch):
    monkeypatch.setattr(table, "CAUSES", [*table.CAUSES, Haze])
    problem, _ = photographed(np.zeros(3))
    scope = Scope(response=False, allowed=())
    assert explain.explain(problem, scope, max_iterations=40).taken == []
    rows = {question.cause: question for question in scope.asked}
    assert rows["haze"].decision == "promises too little" and rows["haze"].nats is None
    assert rows["haze"].row()["least"] > rows["haze"].promised


def test_what_hangs_on_one_group_has_a_large_standard_error():
    """The same nats: of all groups alike, and of one."""
    problem, _ = photographed(np.zeros(3))
    none = np.zeros(len(problem.tile_group))
    told = lambda each: Evidence(float(each.sum()), 0.0, each, None, None)
    every = np.full(len(none), 0.1)
    one = np.where(problem.tile_group == 2, every.sum() / (problem.tile_group == 2).sum(), 0)
    alike, alone = (difference(problem, told(each), told(none)) for each in (every, one))
    assert alike.nats == pytest.approx(alone.nats) and alike.z > 100
    assert alone.z == pytest.approx(1.0)  # whatever it brings: the standard error of a sum that one term makes


def test_margins_name_the_nearest_rooms():
    question = {"cause": "vignetting", "beside": [], "nats": None, "dse": 2.0, "least": 10.0, "decision": ""}
    rows = [
        {"room": "a", "kind": "vignetting", "draw": 1, "questions": [question | {"promised": 80.0}]},
        {"room": "b", "kind": "vignetting", "draw": 1, "questions": [question | {"promised": 30.0}]},
        {"room": "c", "kind": "exact", "draw": 1, "questions": [question | {"promised": 2.0}]},
        {"room": "d", "kind": "lamp", "draw": 2, "questions": [question | {"promised": 4.0}]},
    ]
    found = {measure: (wrong, right) for _, measure, wrong, right in margins.margins(rows)}
    assert found["promised"] == ((3.0, "b vignetting 1"), (0.4, "d lamp 2"))
    assert found["z"] == ((15.0, "b vignetting 1"), (2.0, "d lamp 2"))
