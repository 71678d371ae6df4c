"""How well an explanation predicts what it has not seen: log-likelihood of held-out tiles.

Explanations compete on tiles that their parameters were not fitted to: each group's tiles are cut into FOLDS runs of
neighbours, and each run is predicted from the others. The fit is not repeated: one Gauss-Newton step from the fit of
all tiles leaves a run out, since the equations are nearly linear there.

Residuals follow Student's t with 4 degrees of freedom: groups that a diffuse surface does not explain (a mirror, a
texture) shall not decide which transfer function the camera has. Its width is the noise of pixels and rays and one
discrepancy besides, whichever makes the residuals most likely: an explanation is better as far as it leaves less. The
channels of a tile count as one observation, since shadows and rays move them together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lib.analysis.fit.equations import Equations
from lib.analysis.fit.folds import folds
from lib.analysis.fit.problem import Problem, weights

FREEDOM = 4  # of Student's t
DISCREPANCIES = np.concatenate([[0.0], np.geomspace(1e-4, 0.1, 40)])  # display
NORMAL_MEDIAN = 0.455  # median of the square of a normal variable


@dataclass(frozen=True)
class Evidence:
    """nats : log-likelihood of the held-out tiles;  discrepancy : display, beyond noise, that makes them most likely

    each : (T,) nats of each tile;  residual, variance : (T, C), (T, 1) or (T, C) display, of the held-out tiles
    """

    nats: float
    discrepancy: float
    each: np.ndarray
    residual: np.ndarray
    variance: np.ndarray

    def on(self, tiles) -> Evidence:
        """Of some tiles alone."""
        return likelihood(self.residual[tiles], self.variance[tiles])


def held_out(problem: Problem, residual, J, gradient, H) -> np.ndarray:
    """Residuals (T, C) of the tiles as the other folds predict them.

    residual : (T, C) at the fit of all tiles;  J : (T C, n) its derivatives;  gradient, H : (n,), (n, n) of the prior
    """
    weight, r = weights(problem, residual).reshape(-1), residual.reshape(-1)
    fold = np.repeat(folds(problem), problem.channels)
    weighted = weight[:, None] * J
    runs = [fold == k for k in np.unique(fold)]
    parts = [(J[run].T @ weighted[run], weighted[run].T @ r[run]) for run in runs]
    total = H + sum(part[0] for part in parts), gradient + sum(part[1] for part in parts)
    found = r.copy()
    for run, part in zip(runs, parts, strict=True):
        found[run] += J[run] @ steady(total[0] - part[0], part[1] - total[1], total[0])
    return found.reshape(residual.shape)


def steady(A, b, whole=None) -> np.ndarray:
    """x of A x = b, (n,) or (n, k), A positive semidefinite; a direction that nothing tells of is not moved.

    whole : (n, n) that A is what is left of: by its size, a difference of equals is nothing, of either sign
    """
    size = np.sqrt(np.maximum(np.diag(A if whole is None else whole), 1e-300))
    return (np.linalg.lstsq(A / np.outer(size, size), (b.T / size).T, rcond=1e-12)[0].T / size).T


def likelihood(residual, variance) -> Evidence:
    """Of residuals (T, C) with the noise's variance, (T, C) or (T, 1), and the discrepancy that suits them best."""
    from scipy.special import gammaln

    nu, best = FREEDOM, None
    constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * np.log(np.pi * nu)
    square = residual**2
    for discrepancy in DISCREPANCIES:
        width = variance + discrepancy**2
        each = constant - 0.5 * np.log(width) - (nu + 1) / 2 * np.log1p(square / (nu * width))
        each = each.mean(axis=1)
        nats = float(each.sum())
        if best is None or nats > best.nats:
            best = Evidence(nats, float(discrepancy), each, residual, variance)
    return best


def gain(problem: Problem, after: Evidence, before: Evidence) -> tuple[float, float]:
    """Nats that one explanation has more than another: on all tiles, and on those outside the group that gains most."""
    most = np.bincount(problem.tile_group, after.each - before.each).argmax()
    others = problem.tile_group != most
    return after.nats - before.nats, after.on(others).nats - before.on(others).nats


class Difference(NamedTuple):
    """nats : that one explanation has more than another;  dse : standard error of that, over groups"""

    nats: float
    dse: float

    @property
    def z(self) -> float:
        return self.nats / max(self.dse, 1e-9)


def difference(problem: Problem, after: Evidence, before: Evidence) -> Difference:
    """By how much one explanation is better, and how far that hangs on single groups.

    What is of the whole picture shows in every group; what one group's light or material does, in that one. As arviz's
    `compare` has `dse` over observations, here over groups: tiles of one group err together.
    """
    by_group = np.bincount(problem.tile_group, after.each - before.each, minlength=len(problem.groups))
    by_group = by_group[problem.seen_groups]
    n = len(by_group)
    dse = float(np.sqrt(n * by_group.var(ddof=1))) if n > 1 else np.inf
    return Difference(after.nats - before.nats, dse)


def noise_variance(problem: Problem, at: Equations) -> np.ndarray:
    """(T, 1) display: of pixels, patterns, and the tiles' own rays as their two halves tell it on the whole."""
    variance = problem.tile_noise if problem.variance is None else problem.tile_noise + problem.variance
    if problem.halves is None or not len(variance):
        return variance
    shown = at.displayed(at.shown_share * problem.halves.difference(at.state.E, at.state.b))
    return variance + float(np.median(shown**2)) / NORMAL_MEDIAN


def evidence(problem: Problem, at: Equations) -> Evidence:
    """Of the fit that ended at these equations."""
    gradient, H = at.prior()
    predicted = held_out(problem, at.residual, at.jacobian, gradient, H)
    return likelihood(predicted, noise_variance(problem, at))


def promised(problem: Problem, at: Equations, columns, own=slice(0, 0), prior=None) -> Evidence:
    """What more parameters would bring, without fitting them: one step from the fit without them.

    columns : (T, C, k) derivatives of the display residual by the new parameters;  own : parameters of the fit that
    they replace;  prior : (k, k) Hessian of the new ones
    """
    keep = np.ones(at.layout.size, bool)
    keep[own] = False
    k = columns.shape[-1]
    J = np.concatenate([at.jacobian[:, keep], columns.reshape(-1, k)], axis=1)
    gradient, H = at.prior()
    wider = np.zeros((J.shape[1],) * 2)
    wider[:-k, :-k] = H[np.ix_(keep, keep)]
    wider[-k:, -k:] = np.zeros((k, k)) if prior is None else prior
    predicted = held_out(problem, at.residual, J, np.append(gradient[keep], np.zeros(k)), wider)
    return likelihood(predicted, noise_variance(problem, at))


def as_others_have_it(problem: Problem, at: Equations, own, tiles) -> Evidence:
    """Of some tiles (T,) bool, where the parameters `own` (k,) are what all other tiles make them."""
    J, r, (gradient, H) = at.jacobian, at.residual.reshape(-1), at.prior()
    weight = np.where(tiles[:, None], 0, weights(problem, at.residual)).reshape(-1)
    step = steady(J.T @ (weight[:, None] * J) + H, -(J.T @ (weight * r) + gradient))[own]
    rest = np.setdiff1d(np.arange(J.shape[1]), own)
    there = at.residual + (J[:, own] @ step).reshape(at.residual.shape)
    predicted = held_out(problem, there, J[:, rest], gradient[rest], H[np.ix_(rest, rest)])
    return likelihood(predicted[tiles], noise_variance(problem, at)[tiles])
