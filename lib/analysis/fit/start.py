"""Where the search for reflectances and lamps begins, and what stands in for groups that no tile shows."""

from __future__ import annotations

import numpy as np

from lib.analysis.fit.problem import Problem, group_mean, observe
from lib.given.transfer import Transfer

UNSEEN_MEAN, UNSEEN_SPREAD = 0.5, 0.3  # of groups never seen, where no group is seen
LEAST_SPREAD = 0.05  # of the prior of a group never seen
BLACK = 0.01  # reflectance, and its spread, of what is black where light falls on it


def initialise(problem: Problem, transfer: Transfer):
    """Reflectances (G, C) and lamps (L, C) by eq. 4.3: rho_i is the mean of P ** gamma over the pixels of group i.

    A group never seen starts at the seen groups' mean by area, an unknown lamp at the power that suits the picture's
    mean.
    """
    seen, _ = observe(problem, transfer)
    mean = group_mean(problem, seen)
    rho = np.where(np.isnan(problem.rho), np.clip(mean, 0.02, 0.9), problem.rho)
    prior, _ = unseen_prior(problem, rho)
    rho = np.where(np.isnan(rho), prior, rho)
    E = np.where(np.isnan(problem.emittance), 1.0, problem.emittance)
    unknown = np.isnan(problem.emittance)
    E[~problem.own_lamps] = np.nan_to_num(problem.emittance[~problem.own_lamps])
    unknown[~problem.own_lamps] = False
    if unknown.any():
        # one power for all unknown lamps so that the picture's mean is right at rho = 0.5
        level = (problem.D_tile @ E).mean(axis=0)
        E = np.where(unknown, np.maximum(2 * seen.mean(axis=0) / np.maximum(level, 1e-12), 1e-6), E)
    return rho, E


def unseen_prior(problem: Problem, rho):
    """Mean and spread (G, C) of groups without a tile (SCENE.md 3): those of the seen groups by area, or black."""
    free = np.isnan(problem.rho).any(axis=1)
    has = problem.seen_groups
    use = has & free if (has & free).any() else has
    mean, spread = np.full(rho.shape, UNSEEN_MEAN), np.full(rho.shape, UNSEEN_SPREAD)
    if use.any():
        w = problem.group_area[use][:, None]
        mean[:] = (rho[use] * w).sum(axis=0) / w.sum()
        spread[:] = np.maximum(np.sqrt(((rho[use] - mean[0]) ** 2 * w).sum(axis=0) / w.sum()), LEAST_SPREAD)
    if problem.black is not None:
        mean[problem.black] = spread[problem.black] = BLACK
    return mean, spread
