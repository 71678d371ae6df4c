"""The standard deviations of a fit.

Tile residuals (pixel noise, texture, the tiles' own sampling) enter by the sandwich formula. Then, each as a change of
all tiles pushed through the same normal equations: the patches' discretisation (half of what the sub-cell correction
changes), the sampling of the form factors (two disjoint halves of the rays), and what is open in the lobes. Groups
never seen enter through their prior.
"""

from __future__ import annotations

import numpy as np

from lib.analysis.fit.equations import Equations
from lib.analysis.fit.evidence import steady
from lib.analysis.fit.folds import FOLDS, folds
from lib.analysis.fit.problem import MISFIT, CauseTerms, Problem, Result, weights
from lib.analysis.fit.transport import TileLight
from lib.light.balance import reflected

SQUARED_MEDIAN = 0.455  # of a normal variable's square: median(x^2) / 0.455 is a robust variance
BLED = 0.1  # of JPEG's rounding beside edges that a whole group has in common: its neighbours' colours
RESPONSE = "response"  # name of the doubt about the transfer function
OTHER = -1.0  # its number where the other one of gamma and sRGB is the camera's: the residual is what that has less
# Display, rms: light is not known to less. Curves of cameras change tiles by .0016 and more in 30 rooms; one that bent
# to the light between shelves in a white room did by .0006, and brought 90 nats and reflectances 3 % off.
RESOLVED = 0.001
EITHER = 0.5  # mean square of a number that is 0 or 1, as likely as not
STEEP = 4  # how fast it is known beyond that: at 1.5 times to .2 of that, at 2.5 to .025
NEAR = 0.05  # display: functions that differ by more are told apart, 480 nats and more in white rooms, 40 where by less
LOBES_KNOWN_TO = 0.005  # of alpha: what lobes' rays leave, which no tile tells of; without it 75 % of 57 intervals held
LITTLE = 1e-6  # of what is known of a number beforehand: tiles may tell nothing at all
LEAST = 0.02  # smaller values are as unsure as this one, relative to it
WIDE = 10.0  # times itself: how far a parameter may be off that nothing determines


def uncertainty(problem: Problem, at: Equations, result: Result):
    """Write sigma of all parameters, their shares by cause and the misfit into result, found at `at`."""
    normal = NormalEquations.of(problem, at)
    cov = normal.sandwich()
    independent, common = _tile_errors(problem, at, result), _common_errors(problem, at, normal)
    for error in independent:
        cov = cov + normal.spread(error)
    for cause, delta in common.items():
        size, typical = _at_least_typical(delta, normal.theta, at, problem)
        common = np.diag((size * np.maximum(np.abs(normal.theta), LEAST)) ** 2)
        own = at.layout.responding
        common[own, own] = np.outer(delta[own], delta[own])  # the points of a curve move together
        cov = cov + common
        result.shares[cause] = typical
    function, causes = doubts(problem.doubted)
    for cause in causes:
        # a camera that mixes colours is doubted only where it promises something, and odds of six numbers hide a little
        cov = cov + normal.perhaps(cause, problem.tile_group, surely=len(cause.names) > 1)
    if function is not None:  # the tiles' scatter holds what a bend of the function leaves there: the larger counts
        is_near = np.abs(function.columns).max(initial=0.0) < NEAR
        cov = _at_least(cov, normal.perhaps(function, problem.tile_group, OTHER, RESOLVED if is_near else 0.0))
    own = at.layout.responding  # each part of a curve may hang on one group, as causes do
    hangs = slice(own.start if at.state.transfer.kind == "curve" else own.stop, None)
    if hangs.start < at.layout.size:
        cov = cov + normal.without_each_group(problem.tile_group, hangs)
    if result.misfit > MISFIT:
        cov = cov * result.misfit**2  # what noise does not explain may be anything: every value is as uncertain
    sigma = np.maximum(np.sqrt(np.maximum(np.diag(cov), 0)), normal.loose)
    _share_out(sigma, at, result)
    size = np.sqrt(np.maximum(np.diag(cov), 0))
    grown = np.divide(sigma, size, out=np.ones_like(sigma), where=size > 0)
    cov, own = cov * np.outer(grown, grown), at.layout.responding
    if at.layout.transfer:
        result.cov_transfer = cov[own, own]
    if at.layout.cause:
        result.cov_cause = cov[own.stop :, own.stop :]


def widen(problem: Problem, result: Result, terms: CauseTerms):
    """Every sigma that a fit found holds what numbers leave that are not fitted, too."""
    at, normal = result.at, NormalEquations.of(problem, result.at)
    size = np.sqrt(np.maximum(np.diag(normal.beside(terms)), 0))
    ends = (0, *at.layout.ends)
    for k, name in enumerate(("rho", "E", "rho_s")):
        sigma, where = getattr(result, f"sigma_{name}"), tuple(getattr(at.layout, name).T)
        if sigma is not None:
            sigma[where] = np.hypot(sigma[where], size[ends[k] : ends[k + 1]])
    if result.sigma_bend is not None:
        result.sigma_bend = np.hypot(result.sigma_bend, size[ends[3] : ends[4]])


def doubt(result: Result, other, share=1.0):
    """Sigma of the values that were found holds a share of what another explanation's State has for them."""
    for name in ("rho", "E", "rho_s", "bend"):
        sigma, values = getattr(result, f"sigma_{name}"), getattr(result.state, name)
        if sigma is not None and values is not None:
            off = share * (getattr(other, name) - values)
            setattr(result, f"sigma_{name}", np.where(sigma > 0, np.hypot(sigma, off), sigma))


def doubts(terms):
    """(terms of the transfer function or None, [those of each other cause])"""
    if terms is None:
        return None, []
    each = {name: terms.without(tuple({*terms.names} - {name})) for name in dict.fromkeys(terms.names)}
    return each.pop(RESPONSE, None), list(each.values())


def _at_least(cov, other):
    """The covariance, wider where another one's variances are larger."""
    size = np.sqrt(np.maximum(np.diag(cov), 1e-300))
    wider = np.maximum(np.sqrt(np.maximum(np.diag(other), 0)) / size, 1)
    return cov * np.outer(wider, wider)


class NormalEquations:
    """The normal equations of a least-squares problem at its end.

    J : (T C, n) derivatives of the tiles' residuals;  residual, weight : (T C,), a weight is one over a variance
    channels : C;  prior : (n, n) of the parameters;  theta : (n,) what they are
    """

    def __init__(self, J, residual, weight, channels=1, prior=None, theta=None):
        self.J, self.residual, self.weight, self.channels, self.n = J, residual, weight, channels, J.shape[1]
        self.prior = np.zeros((self.n, self.n)) if prior is None else prior
        self.H = J.T @ (weight[:, None] * J) + self.prior
        self.theta = np.zeros(self.n) if theta is None else theta
        self.inverse, self.loose = _inverse(self.H, self.theta)
        self.at = self.pixel = None  # of a fit: what its sandwich and pushes need beyond the matrices

    @classmethod
    def of(cls, problem, at):
        """Those of a fit."""
        residual, weight = at.residual.reshape(-1), weights(problem, at.residual).reshape(-1)
        normal = cls(at.jacobian, residual, weight, problem.channels, at.prior()[1], at.layout.pack(at.state))
        normal.at, normal.pixel = at, np.repeat(problem.tile_noise, problem.channels)
        return normal

    def _by_tile(self, rows):
        """(T C, n) -> (T, n): the channels of one tile go together."""
        return rows.reshape(-1, self.channels, self.n).sum(axis=1)

    def sandwich(self):
        """Covariance (n, n) from the tiles' own residuals and their pixel noise."""
        score = self._by_tile((self.weight * self.residual)[:, None] * self.J)
        if len(score):  # neighbours err together where it is the model that errs: runs of them, not tiles
            run = self.at.problem.tile_group * FOLDS + folds(self.at.problem)
            order = np.argsort(run, kind="stable")
            first = np.flatnonzero(np.diff(run[order], prepend=-1))
            score = np.add.reduceat(score[order], first, axis=0)
        noise = self.J.T @ ((self.weight**2 * self.pixel)[:, None] * self.J)
        return self.inverse @ (score.T @ score + noise + self.prior) @ self.inverse

    def correlation(self):
        """(n, n) how the parameters err together, also in what nothing determines; each is known to WIDE of itself."""
        size = WIDE * np.maximum(np.abs(self.theta), LEAST)
        covariance = np.linalg.inv(np.eye(self.n) + self.H * np.outer(size, size))
        spread = np.sqrt(np.diag(covariance))
        return covariance / np.outer(spread, spread)

    def spread(self, error):
        """Covariance (n, n) that errors (T, C) of the tiles' display values leave, independent from tile to tile."""
        each = self._by_tile((self.weight * error.reshape(-1))[:, None] * self.J)
        return self.inverse @ (each.T @ each) @ self.inverse

    def beside(self, terms):
        """Second moments (n, n) of what numbers leave that are not fitted: how far they may be off, and how far they
        are if the tiles are right."""
        along, left, weighted = self._followed(terms)
        known = left.T @ weighted + along.T @ self.prior @ along + np.diag(1 / terms.spread**2)
        number = np.linalg.solve(known, weighted.T @ self.residual)
        return along @ (np.linalg.inv(known) + np.outer(number, number)) @ along.T

    def perhaps(self, terms, group, instead=0.0, resolved=0.0, surely=False):
        """The same of a cause that is there or not, as likely as not beforehand: weighed by its odds once the tiles are
        seen (a spike at 0 beside a slab as wide as the prior; Mitchell and Beauchamp 1988).

        What is wrong with a group's light is common to its tiles, so they tell as much as groups agree: the Godambe
        information I B^-1 I, B the scatter of the groups' pulls that the jackknife gives, and no smaller than noise's.

        group : (T,) of each tile;  surely : it is there;  instead : a value that is as likely as 0, or 0
        resolved : display, rms: what changes the tiles by less, once all parameters follow, tells nothing of a number
        """
        from scipy.linalg import eigh
        from scipy.special import softmax

        along, left, weighted = self._followed(terms)
        told, prior = left.T @ weighted + along.T @ self.prior @ along, np.diag(1 / terms.spread**2)
        pull, known = weighted * self.residual[:, None], told + prior
        number, scatter = np.linalg.solve(known, pull.sum(axis=0)), np.zeros_like(known)
        for rows in (np.repeat(group == g, self.channels) for g in np.unique(group)):
            without = np.linalg.solve(known - left[rows].T @ weighted[rows], pull[~rows].sum(axis=0))
            moved = known @ (without - number)
            scatter += np.outer(moved, moved)
        beyond_noise, axes = eigh(scatter, told + LITTLE * prior)
        agreed = told @ (axes / np.maximum(beyond_noise, 1)) @ axes.T
        known = agreed @ told + prior
        pulled, value = agreed @ pull.sum(axis=0), np.full(len(known), instead)
        number = np.linalg.solve(known, pulled)
        nats = (number @ known @ number - np.linalg.slogdet(known @ np.diag(terms.spread**2))[1]) / 2
        nats_instead = value @ pulled - value @ agreed @ told @ value / 2 if instead else -np.inf
        _, there, other = (0.0, 1.0, 0.0) if surely else softmax([0, nats, nats_instead])
        size = there * (np.linalg.inv(known) + np.outer(number, number)) + other * np.outer(value, value)
        if resolved:
            unknown = EITHER * terms.spread**2 / (1 + ((left**2).mean(axis=0) / resolved**2) ** STEEP)
            size = size + np.diag(np.maximum(unknown - np.diag(size), 0))
        return along @ size @ along.T

    def _followed(self, terms):
        """How all parameters (n, k) follow numbers that are not fitted, what is left of their columns (T C, k), and
        that weighted.

        In a valley the fit need not have come to its very floor: that is not of the numbers.
        """
        C = terms.columns.reshape(-1, len(terms.names))
        along = self.inverse @ (self.J.T @ (self.weight[:, None] * C))
        left = C - self.J @ along
        return along, left, self.weight[:, None] * left

    def without_each_group(self, group, own):
        """Second moments (n, n) of what the parameters `own` do, and all others with them, where one group after
        another is left out: what is wrong with a group's light is common to its tiles, and a cause of the whole picture
        may hang on that (the jackknife).

        group : (T,) of each tile;  own : slice
        """
        rest = np.delete(np.arange(self.n), own)
        follow = np.eye(self.n)[:, own]
        follow[rest] = -steady(self.H[np.ix_(rest, rest)], self.H[rest, own])
        moved = []
        for tiles in (group == g for g in np.unique(group)):
            rows = np.repeat(tiles, self.channels)
            J, weighted = self.J[rows], self.weight[rows, None] * self.J[rows]
            step = steady(self.H - J.T @ weighted, weighted.T @ self.residual[rows], self.H)
            moved.append(follow @ step[own])
        return np.transpose(moved) @ np.array(moved)

    def push(self, dB):
        """(n,) change of the parameters that a change dB (T, C) of the synthesis causes."""
        return self.push_shown(self.at.displayed(dB))

    def push_shown(self, off):
        """The same of a change (T, C) of display values."""
        return -self.inverse @ (self.J.T @ (self.weight * off.reshape(-1)))


def _tile_errors(problem, at, result):
    """Errors (T, C) in display values that are independent from tile to tile; sets the misfit beside them."""
    state, rho_tile, found = at.state, at.shown_share, []
    if problem.specular is not None and problem.specular.spread:
        found.append(at.displayed(rho_tile * at.light.bent(*problem.specular.spread, state.E, state.b)))
    if problem.halves:
        sampling = at.displayed(rho_tile * problem.halves.difference(state.E, state.b))
        found.append(sampling)
        noise = problem.tile_noise
        expected = float(np.sqrt(np.median((sampling**2 / SQUARED_MEDIAN + noise)[problem.plain])))
        typical = float(np.sqrt(np.median(at.residual[problem.plain] ** 2) / SQUARED_MEDIAN))
        result.misfit = typical / max(expected, 1e-3)
        result.correlated = _in_common(problem, at.residual) / max(expected, 1e-3)
    return found


def _in_common(problem, residual):
    """Typical size of the error that neighbouring plain tiles of one object and group have in common, display."""
    same = (np.diff(problem.tile_group) == 0) & (np.diff(problem.tile_object) == 0) & problem.plain[1:]
    a, b = residual[1:][same], residual[:-1][same]
    if not a.size:
        return 0.0
    square = (np.median((a + b) ** 2) - np.median((a - b) ** 2)) / (4 * SQUARED_MEDIAN)
    return float(np.sqrt(max(square, 0)))


def _common_errors(problem, at, normal):
    """{cause: change (n,) of the parameters, one standard deviation}: causes that move all tiles together."""
    state, rho_tile = at.state, at.shown_share
    found = {"discretisation": 0.5 * normal.push(rho_tile * (problem.G @ state.b - problem.G_plain @ state.b))}
    for doubt in problem.specular.doubts if problem.specular is not None else ():
        found[doubt.cause] = normal.push(at.light.bent(doubt.W, doubt.V, state.E, state.b))
    if problem.edge_noise is not None:
        for g in np.unique(problem.tile_group[problem.edge_noise > 0]):
            off = np.where(problem.tile_group == g, BLED * problem.edge_noise, 0)[:, None]
            off = np.repeat(off, problem.channels, axis=1)
            found[f"blocks {problem.groups[g]}"] = normal.push_shown(off)
    for name, off in colours(problem):
        found[name] = normal.push_shown(off)
    comes_in = problem.unsure_outside is not None and state.E[~problem.own_lamps].any()
    for k, (dD, dD_tile) in enumerate([*problem.unsure, *(problem.unsure_outside() if comes_in else ())]):
        dB = dD_tile @ state.E
        if dD is not None:
            rho = state.rho[problem.patch_group]
            dB = dB + problem.G @ reflected(at.light.matrices.F, rho, rho * (dD @ state.E), tolerance=1e-3).b
        found[f"place {k}"] = normal.push(rho_tile * dB)
    if problem.halves:
        b0, b1 = (
            TileLight(problem, F, problem.G, state.rho_s).solve(state.rho, state.E, state.b)[0]
            for F in (problem.halves.F0, problem.halves.F1)
        )
        found["form factors"] = 0.5 * normal.push(rho_tile * (problem.G @ (b0 - b1)))
    return found


def colours(problem):
    """(name, (T, C) display) of what JPEG's rounding of colours does to a group's tiles alike, channel by channel.

    A group that shows many colours has them rounded up and down.
    """
    if problem.colour_noise is None:
        return
    levels = 255 * problem.photograph.display()
    colour = levels - levels.mean(axis=1, keepdims=True)
    for g in np.unique(problem.tile_group):
        own = problem.tile_group == g
        off = problem.colour_noise / (1 + colour[own].var(axis=0))
        for c, size in enumerate(off):
            pattern = np.zeros(levels.shape)
            pattern[own, c] = size
            yield f"colour {problem.groups[g]} {c}", pattern


def _at_least_typical(delta, theta, at, problem):
    """Relative size (n,) of a change, and its median over the reflectances of seen groups.

    One realisation can vanish by chance: no reflectance's is below the median of them all.
    """
    n = len(at.layout.rho)
    seen = np.isin(at.layout.rho[:, 0], problem.tile_group)
    size = np.abs(delta) / np.maximum(np.abs(theta), LEAST)
    typical = float(np.median(size[:n][seen])) if seen.any() else 0.0
    size[:n] = np.where(seen, np.maximum(size[:n], typical), size[:n])
    return size, typical


def _share_out(sigma, at, result):
    """The vector of all parameters' sigma (n,) into the arrays of the result."""
    state, layout = at.state, at.layout
    n_rho, n_E, n_s, n_bend = layout.ends
    result.sigma_rho, result.sigma_E = np.zeros(state.rho.shape), np.zeros(state.E.shape)
    result.sigma_rho[tuple(layout.rho.T)] = sigma[:n_rho]
    result.sigma_E[tuple(layout.E.T)] = sigma[n_rho:n_E]
    if state.rho_s is not None:
        result.sigma_rho_s = np.zeros(state.rho_s.shape)
        result.sigma_rho_s[tuple(layout.rho_s.T)] = sigma[n_E:n_s]
        of_alpha = np.array([step.name != "turn" for step in at.problem.specular.bend], float)
        result.sigma_bend = np.hypot(sigma[n_s:n_bend], LOBES_KNOWN_TO * of_alpha)


def _inverse(H, theta):
    """Inverse of the normal matrix without its null directions, and the standard deviations (n,) that those leave.

    A direction in which nothing changes the picture is as unsure as the values themselves.
    """
    diagonal = np.diag(H)
    alive = diagonal > 1e-14 * max(float(diagonal.max(initial=0.0)), 1e-300)
    scale = np.where(alive, 1 / np.sqrt(np.where(alive, diagonal, 1.0)), 0.0)
    value, vector = np.linalg.eigh(H * np.outer(scale, scale))
    size = np.maximum(np.abs(theta), LEAST)
    loose = np.where(alive, 0.0, size)
    weak = value < 1e-8 * max(float(value.max(initial=0.0)), 1e-300)
    for v in vector[:, weak].T:
        relative = np.abs(scale * v) / size
        if relative.max() > 0:
            loose = np.maximum(loose, size * relative / relative.max())
    good = vector[:, ~weak] / np.sqrt(value[~weak])
    good = scale[:, None] * good
    return good @ good.T, loose
