"""The paper's own alternation (section 4.5, eq. 4.3-4.6), as printed and damped: methods to compare with."""

from __future__ import annotations

import numpy as np

from lib.analysis.fit.problem import Problem, Result, State, observe, rmse
from lib.analysis.fit.start import initialise, unseen_prior
from lib.analysis.fit.transport import TileLight
from lib.given.transfer import GAMMA_RANGE, Metric, Transfer

MOST_GAMMAS = 30
RUNAWAY = 1e3, 1.5  # relative change, largest reflectance: beyond, the iteration diverges
EXPOSED = 10.0  # the printed form lets a reflectance grow so far


def paper(problem: Problem, *, gamma=2.2, damped=False, exponent=1.0, threshold=1e-3, most=60, trace=None) -> Result:
    """Section 4.5 as printed: eq. 4.3; eq. 4.4-4.6 to the threshold; gamma on eq. 4.1; repeated.

    damped : the correction's common factor m is damped, rho_i *= (q_i / m) m ** (1 - mean rho), on ratios of
        radiosities and symmetrised on |ln epsilon|; the printed form diverges in bright rooms
        (docs/decisions/printed-update.md)
    most : corrections of the reflectances at one gamma
    exponent : power on the ratio of pixel means; 1 as in eq. 4.4, gamma for the ratio of radiosities of the line below
        it
    """
    at = _Alternation(problem, damped, exponent, threshold, most, trace)
    transfer = problem.transfer if not problem.fit_transfer else problem.transfer.moved([gamma])
    rho, E = initialise(problem, transfer)
    converged = False
    for _ in range(MOST_GAMMAS):
        rho, settled, diverged = at.corrected(rho, E, transfer)
        if diverged is not None:
            return at.result(diverged, False)
        if not problem.fit_transfer:
            converged = settled
            break
        last, better = transfer.gamma, _best_gamma(problem, at.light.render(rho, E, transfer, at.b).B, transfer.gamma)
        converged = settled and abs(better - last) < threshold
        transfer = transfer.moved([better])
        if abs(better - last) < threshold:
            break
    return at.result(at.light.render(rho, E, transfer, at.b), converged)


class _Alternation:
    """Corrections of the reflectances at given gamma. Objects are pairs (group, object) that tiles show."""

    def __init__(self, problem: Problem, damped, exponent, threshold, most, trace):
        self.problem, self.light = problem, TileLight(problem)
        self.damped, self.exponent, self.threshold, self.most, self.trace = damped, exponent, threshold, most, trace
        both = np.stack([problem.tile_group, problem.tile_object], axis=1)
        self.pairs, self.tile_pair = np.unique(both, axis=0, return_inverse=True)
        self.tile_pixels = problem.n_pixels.astype(float)
        self.pair_pixels = np.bincount(self.tile_pair, self.tile_pixels)[:, None]
        self.free = np.isnan(problem.rho)
        self.seen = problem.seen_groups[:, None]
        self.iteration, self.b = 0, None

    def corrected(self, rho, E, transfer: Transfer):
        """rho after eq. 4.4-4.6 at this transfer, whether it has settled, and the State where it diverged, or None."""
        for _ in range(self.most):
            state = self.light.render(rho, E, transfer, self.b)
            self.b = state.b
            metric = Metric(transfer)
            seen, _ = observe(self.problem, transfer)
            if self.trace:
                residual = metric.value(state.B) - metric.value(seen)
                self.trace(iteration=self.iteration, image_rmse=rmse(self.problem, residual), state=state)
            self.iteration += 1
            if not np.isfinite(state.B).all():
                return rho, False, state
            new = self._updated(rho, self._correction(rho, seen, state.B, metric))
            change = np.max(np.abs(new - rho) / np.maximum(rho, 1e-6))
            rho = new
            if change > RUNAWAY[0] or rho.max() > RUNAWAY[1]:
                return rho, False, self.light.render(np.clip(rho, 0, 0.999), E, transfer)
            if change < self.threshold:
                return rho, True, None
        return rho, False, None

    def _correction(self, rho, seen, B, metric):
        """q : (G, C) factors of the reflectances (eq. 4.4-4.6)."""
        if self.damped:
            epsilon = self._object_mean(seen) / np.maximum(self._object_mean(B), 1e-12)
        else:
            shown = (lambda x: x) if metric.transfer.kind == "linear" else metric.value
            ratio = self._object_mean(shown(seen)) / np.maximum(self._object_mean(shown(B)), 1e-12)
            epsilon = ratio**self.exponent
        q = np.ones_like(rho)
        for g in np.unique(self.pairs[:, 0]):
            mine = self.pairs[:, 0] == g
            for c in range(self.problem.channels):
                q[g, c] = group_correction(epsilon[mine, c], self.pair_pixels[mine, 0], symmetric=self.damped)
        if not self.damped:
            return q
        area = self.problem.group_area[:, None]
        w = np.where(self.seen & self.free, area, 0)
        m = np.exp((w * np.log(np.maximum(q, 1e-12))).sum(axis=0) / np.maximum(w.sum(axis=0), 1e-300))
        mean_rho = (area * rho).sum(axis=0) / self.problem.group_area.sum()
        return q / m * m ** (1 - mean_rho)

    def _updated(self, rho, q):
        new = np.where(self.free, np.clip(rho * q, 0, 1 if self.damped else EXPOSED), rho)
        prior, _ = unseen_prior(self.problem, new)
        return np.where(self.free & ~self.seen, prior, new)

    def _object_mean(self, values):
        total = np.zeros((len(self.pairs), values.shape[1]))
        np.add.at(total, self.tile_pair, values * self.tile_pixels[:, None])
        return total / self.pair_pixels

    def result(self, state: State, converged) -> Result:
        """The end of the alternation."""
        metric = Metric(state.transfer)
        residual = metric.value(state.B) - metric.value(observe(self.problem, state.transfer)[0])
        error = rmse(self.problem, residual)
        return Result(state, converged, self.iteration, error, tile_residual=residual, residual=self.light.residual)


def group_correction(epsilon, pixels, symmetric):
    """eq. 4.5 with the weights f of eq. 4.6 over the objects of one group.

    As printed the legend says K_j where the formula has epsilon_j, and f is one-sided: epsilon is a ratio, so one
    object in shadow ({.3, 1, 1}) throws out both good ones. `symmetric` judges |ln epsilon - its median| instead.
    """
    if symmetric:
        logs = np.log(np.maximum(epsilon, 1e-12))
        distance = np.exp(np.abs(logs - np.median(logs)))
        low, high = distance.min(), distance.max()
        keep = distance < 2 * low * (1 + (high - low) / (high + low))
        keep |= distance <= low
    else:
        low, high = epsilon.min(), epsilon.max()
        keep = epsilon < 2 * low * (1 + (high - low) / max(high + low, 1e-300))
        keep |= epsilon <= low
    return float((epsilon * pixels)[keep].sum() / pixels[keep].sum())


def _best_gamma(problem, B, gamma):
    """Gradient search on eq. 4.1 over gamma with B fixed; the photograph's tile means are in display values."""
    count = problem.n_pixels[:, None]
    display = problem.photograph.display()
    B = np.clip(B, 1e-9, 1)
    logB = np.log(B)
    for _ in range(100):
        value = B ** (1 / gamma)
        d = -value * logB / gamma**2  # eq. 4.2 with its missing factor -1 / gamma^2
        gradient = (count * (value - display) * d).sum()
        curvature = (count * d**2).sum()
        step = -gradient / max(curvature, 1e-300)
        gamma_new = float(np.clip(gamma + np.clip(step, -0.5, 0.5), *GAMMA_RANGE))
        if abs(gamma_new - gamma) < 1e-7:
            return gamma_new
        gamma = gamma_new
    return gamma
