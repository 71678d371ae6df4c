"""Groups whose tiles scatter as no light makes them: textures, as a rule, or what mirrors show.

Light that is not as it was taken for changes smoothly over a surface, or at edges. A pattern is everywhere on it. So a
group is patterned where most of its tiles are off by much beside polynomials of the second degree, each through some
neighbours. What it is has to be found out later; until then its tiles scatter by so much, and others tell what the
camera is, and whether lamps and model are right.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.causes.candidates import Candidate
from lib.analysis.fit.problem import Problem

LEAST_SCATTER = 0.006  # Display. A pattern scatters by more.
TIMES_OTHERS = 3.0  # A pattern scatters so many times as much as the plainest third of all other tiles.
THIRD = 0.431  # a third of normal numbers are smaller: shadows' edges may cross the cells of the others
TILES_OF_A_CELL = 24  # Tiles of one object, at least, through whose residuals a polynomial is laid.


def beside(found: Candidate, pixel, width) -> Candidate:
    """The fit in which groups with a pattern say less. pixel : (M,) flat, of the tiles, in a picture of that width"""
    spread = variance(found.problem, found.result.tile_residual, pixel, width)
    return found if spread is None else Candidate.of(replace(found.problem, variance=spread), start=found.start)


def still(found: Candidate, pixel, lens) -> np.ndarray | None:
    """(T, 1) variance of what is a pattern still: less may be one beside causes that were not known before.

    lens : Lens, None where nothing was looked for
    """
    if lens is None or found.problem.variance is None:
        return found.problem.variance
    return variance(found.problem, found.result.tile_residual, pixel, lens.size[0])


def variance(problem: Problem, residual, pixel, width) -> np.ndarray | None:
    """(T, 1) display variance of the tiles' patterns, None where no group has one.

    residual : (T, C) display, of a fit
    """
    place = np.stack([pixel % width, pixel // width], axis=1)
    scatter = _scatter(problem, residual, np.add.reduceat(place, problem.start[:-1]) / problem.n_pixels[:, None])
    each = scatter[problem.tile_group]
    others = [each[~np.isnan(each) & (problem.tile_group != g)] for g in range(len(scatter))]
    usual = np.array([np.quantile(values, 1 / 3) if len(values) else np.inf for values in others])
    own = scatter >= np.maximum(LEAST_SCATTER, TIMES_OTHERS * usual)
    return np.where(own, scatter, 0)[problem.tile_group][:, None] ** 2 if own.any() else None


def _scatter(problem, residual, place):
    """(G,) robust scatter of the groups' tiles beside polynomials; NaN where too few tell. place : (T, 2) px"""
    left = np.full(residual.shape, np.nan)
    for g, o in np.unique(np.stack([problem.tile_group, problem.tile_object], axis=1), axis=0):
        for cell in _cells(place, np.flatnonzero((problem.tile_group == g) & (problem.tile_object == o))):
            x, y = (place[cell] - place[cell].mean(axis=0)).T / max(np.ptp(place[cell]), 1)
            A = np.column_stack([np.ones(len(cell)), x, y, x * x, x * y, y * y])
            bent = A @ np.linalg.lstsq(A, residual[cell], rcond=None)[0]
            left[cell] = (residual[cell] - bent) * np.sqrt(len(cell) / (len(cell) - A.shape[1]))
    found, told = np.full(len(problem.groups), np.nan), ~np.isnan(left[:, 0])
    for g in np.unique(problem.tile_group[told]):
        found[g] = np.quantile(np.abs(left[told & (problem.tile_group == g)]), 1 / 3) / THIRD
    return found


def _cells(place, tiles):
    """Neighbours, TILES_OF_A_CELL or more, split at the middle of the longer side; none where there are fewer."""
    if len(tiles) < 2 * TILES_OF_A_CELL:
        return [tiles] if len(tiles) >= TILES_OF_A_CELL else []
    along = place[tiles, np.ptp(place[tiles], axis=0).argmax()]
    order = tiles[np.argsort(along, kind="stable")]
    return [cell for half in np.array_split(order, 2) for cell in _cells(place, half)]
