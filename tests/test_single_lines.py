"""Laws of single lines, which a small wrong change of the code broke without a test's notice (docs/verify.md)."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lib.analysis.answer.task import Task
from lib.analysis.causes import told_lamps
from lib.analysis.fit import facts, misfits
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.misfits import Misfit
from lib.analysis.fit.uncertainty import NormalEquations
from lib.analysis.materials.climbing import Place
from lib.analysis.materials.site import Site
from lib.analysis.seen import gather, places
from lib.core.stage import BadInput
from lib.light.chains import GLOSSY, Finish
from lib.light.factors_file import FormFactors
from lib.light.surface import side_normals
from tests.helpers.made_problems import COLOURS, made


def test_each_facet_has_two_sides():
    normal = np.array([[0.0, 0, 1], [1, 0, 0]])
    sides = [normal[0], -normal[0], normal[1], -normal[1]]
    np.testing.assert_array_equal(side_normals(SimpleNamespace(normal=normal)), sides)


def test_a_group_is_off_by_the_sum_of_its_pixels_squares():
    assert Misfit(excess=0.1, rms=0.1, noise=0.0, tiles=9, share=0.3).energy == pytest.approx(0.003)


def test_a_grey_photograph_takes_grey_facts_alone():
    np.testing.assert_array_equal(facts._channels([0.3, 0.3, 0.3], 1, "reference.a"), [0.3])
    np.testing.assert_array_equal(facts._channels([0.3, 0.4, 0.5], 3, "reference.a"), [0.3, 0.4, 0.5])
    with pytest.raises(BadInput, match="reference.a: .* is coloured, but the photograph has one channel"):
        facts._channels([0.3, 0.4, 0.3], 1, "reference.a")


def test_black_pixels_of_a_linear_photograph_are_not_pure():
    values = np.ones((9, 9, 3))
    values[4, 4, 1] = 0
    pure = gather.pure(SimpleNamespace(values=values, linear=True), np.zeros((9, 9), int))
    assert not pure[4, 4] and pure[4, 2] and pure[2, 4]


def test_a_tangent_turns_about_the_largest_facet():
    surface = SimpleNamespace(group=np.array([0, 1, 1, 1]), size=np.array([[9, 9], [1, 1], [2, 2], [1, 3.0]]))
    assert Site.main_facet(SimpleNamespace(surface=surface), 1) == 2


def test_finishes_are_equal_to_the_last_bit_or_not():
    one = Finish((3,), np.array([GLOSSY]), np.array([[0.1, 0.1]]), np.array([[1.0, 0, 0]]))
    assert one.equals(replace(one)) and not one.equals(None)
    assert not one.equals(replace(one, alpha=np.array([[0.1, 0.1 + 1e-12]]))) and not one.equals(
        replace(one, groups=(4,))
    )


def test_what_stands_elsewhere_is_listed_by_its_evidence(monkeypatch):
    seen = SimpleNamespace(found=0.95, is_surely_lost=False)
    found = SimpleNamespace(
        **{"seen": seen, "pose": np.full(6, 0.01), "covariance": np.eye(6), "objects": {}, "rivals": {}},
        **{"centre_px": (0.5, 0.1), "centre_covariance": np.eye(2), "before_px": 1.0, "after_px": 0.1},
        nats={"pose": 5.0, "principal_point": 50.0},
    )
    monkeypatch.setattr(places, "register", lambda *_: found)
    listed = places.by_edges(SimpleNamespace(model=None, camera=None, photograph=None), [])
    assert [c.cause for c in listed.causes] == ["principal_point", "pose"] == [w.cause for w in listed.why]


def test_what_follows_a_cause_goes_where_least_squares_puts_it():
    """A group is left out: the cause's number moves by a step, and all others with it, as the whole picture has it."""
    random = np.random.default_rng(3)
    J, residual, group = random.normal(size=(40, 3)), random.normal(size=40), np.repeat([0, 1], 20)
    normal = NormalEquations(J, residual, np.ones(40))
    expected = np.zeros((3, 3))
    for g in (0, 1):
        kept = group != g
        moved = np.linalg.solve(J[kept].T @ J[kept], J[group == g].T @ residual[group == g])[2]
        rest = np.linalg.lstsq(J[:, :2], -J[:, 2] * moved, rcond=None)[0]
        change = np.array([*rest, moved])
        expected += np.outer(change, change)
    np.testing.assert_allclose(normal.without_each_group(group, slice(2, 3)), expected, rtol=1e-9)


@pytest.mark.parametrize("factor, alone", [(1.3, True), (1.0, False)])
def test_a_wrong_lamp_is_all_that_is_wrong_where_another_leaves_nothing(factor, alone):
    problem, _, _ = made(COLOURS, noise=0.01)
    told = replace(problem, emittance=problem.emittance * factor)
    why, settled = told_lamps.lamps_told(told, gauss_newton(told))
    assert bool(why) == settled == alone


@pytest.mark.parametrize("surfaces, open_", [({}, True), ({"floor": "diffuse"}, True), ({"floor": "mirror"}, False)])
def test_lobes_of_lamps_are_not_sought_where_mirrors_are_told(surfaces, open_):
    task = SimpleNamespace(
        **{"surfaces": surfaces, "causes": None, "lobes_unknown": set(), "lobes": {}, "can_look": True},
        **{"factors": SimpleNamespace(own_lamps=("lamp",)), "view": None, "found": None},
    )
    assert (Task.lamp_lobes.fget(task) is not None) == open_


@pytest.mark.parametrize("size", [1.0, 1e-4])
def test_the_subcell_correction_leaves_even_light_as_it_is(size):
    """Whatever the patches' areas are in square metres."""
    factors = SimpleNamespace(area=size * np.array([1.0, 2, 3, 1]), mesh=SimpleNamespace(parent=np.array([0, 0, 0, 1])))
    even = FormFactors._subcell(factors, np.full(4, 0.25)) @ np.ones(4)
    np.testing.assert_allclose(even, 1, rtol=1e-6)


@pytest.mark.parametrize(
    "off, apart", [((0.001, 0.001, 0.004), 2), ((0.001, 0.002, 0.004), None), ((0, 0, 0.002), None)]
)
def test_one_group_stands_apart(off, apart):
    """By three times what the others usually are off by, and by enough; one reference is nobody's material."""
    group = np.repeat([0, 1, 2, 3], 20)
    problem = SimpleNamespace(
        groups=["a", "b", "c", "known"],
        known_groups={3},
        tile_group=group,
        n_pixels=np.full(80, 9),
        tile_noise=np.full((80, 1), 1e-6),
    )
    square = np.array([*off, 0.1])[group] ** 2 + 1e-6
    residual = np.sqrt(square)[:, None] * np.ones((1, 3))
    assert misfits.apart(problem, SimpleNamespace(tile_residual=residual)) == apart


@pytest.mark.parametrize(
    "rung, excess, was", [("diffuse", 0.0136, True), ("diffuse", 0.04, False), ("glossy", 0.01, False)]
)
def test_what_a_lobe_explained_that_was_taken_back_is_no_diffuse_surface(rung, excess, was):
    tried = [{"rung": "glossy", "excess": excess, "diffuse": 0.0447}]
    assert Place(rung, tried=tried).was_explained == was
