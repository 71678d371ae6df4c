"""Boxes that hold points, and rows that are alike: as brute force tells, and near-linear."""

import numpy as np
import pytest

from lib.core.rows import distinct
from lib.given.model.boxes import Boxes
from lib.given.model.lying import covered


@pytest.mark.parametrize("seed", range(20))
def test_boxes_hold_what_brute_force_says(seed):
    """Boxes of all sizes, flat ones among them, anywhere; points on their borders and far outside."""
    rng = np.random.default_rng(seed)
    far = rng.choice([0.0, 1e6])
    low = far + rng.uniform(-1, 1, (300, 3))
    size = 10.0 ** rng.uniform(-7, 0.3, (300, 1)) * rng.uniform(0, 1, (300, 3)) * (rng.random((300, 3)) < 0.8)
    points = np.concatenate([low, low + size, low + size / 2, far + rng.uniform(-3, 3, (200, 3))])
    boxes = Boxes(low, low + size)
    inside = ((low <= points[:, None]) & (points[:, None] <= low + size)).all(axis=2)
    assert np.array_equal(np.stack(boxes.holding(points)), np.stack(np.nonzero(inside)))
    assert len(boxes.holding(points[:0])[0]) == len(Boxes(low[:0], low[:0]).holding(points)[0]) == 0


@pytest.mark.parametrize("seed", range(5))
def test_distinct_is_unique(seed):
    rng = np.random.default_rng(seed)
    rows = rng.integers(-2, 3, (500, 3)) * rng.choice([1.0, -0.0, 0.25])
    first, kind = distinct(rows)
    values, index, inverse = np.unique(rows + 0.0, axis=0, return_index=True, return_inverse=True)
    assert np.array_equal(rows[first] + 0.0, values)
    assert np.array_equal(first, index) and np.array_equal(kind, inverse.reshape(-1))


def test_what_lies_beyond_the_tip_of_a_sliver_does_not_lie_on_it():
    """`near` is a distance: the strips along the two long sides meet ten times as far out."""
    sliver = np.array([[[0.0, 0, 0], [1, 0.1, 0], [1, -0.1, 0]]])
    p = np.array([[-0.005, 0, 0], [-0.05, 0, 0], [0.5, 0.059, 0], [0.5, 0.07, 0], [0.9, 0, 0.009], [0.9, 0, 0.011]])
    assert covered(sliver, p, 0.01).tolist() == [True, False, True, False, True, False]
