"""Reflectances, lamps and gamma together, by Gauss-Newton (docs/decisions/gamma-valley.md)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.fit.equations import Equations, Layout, Unknowns
from lib.analysis.fit.problem import Problem, Result, huber, rmse, scale, variance, weights
from lib.analysis.fit.start import initialise
from lib.analysis.fit.transport import TileLight
from lib.analysis.fit.uncertainty import NormalEquations, uncertainty

TRIES = 12  # at a damping ten times larger each, until a step lowers the cost
UNBIASED_STEPS = 8
PARALLEL = 0.9  # cosine between two steps, from which the second goes on farther;  and this much of the first's length
LASTING = 0.5
DOUBLINGS = 6
FAR = 0.1  # display, rms: from a start that is farther away reflectances come nearer before gamma moves,
CLOSER = 0.5  # as long as each step leaves less than so much of the distance

LOOSE = 0.5  # of itself: a sigma of the lamps' light beyond that leaves the scale to a convention


def gauss_newton(
    problem: Problem, *, gamma=None, max_iterations=30, tolerance=1e-5, trace=None, start=None, finish=True
) -> Result:
    """Levenberg-Marquardt with bounds and Huber weights, then a few steps that take away a bias.

    The sampling noise of the tiles' own light is noise in the regressors, which biases least squares, gamma worst of
    all. The two halves of each tile's rays err independently, so the Jacobian of one half against the residual of the
    other has no such bias (docs/decisions/instruments.md).

    gamma : where an unknown one begins, else at the problem's
    start : Unknowns to begin with instead of eq. 4.3, as specular problems must; bends begin at 0
    finish : False: neither the last steps nor the uncertainty (on the way to a better problem)
    trace : called after each iteration with iteration, image_rmse, state
    """
    layout, light = Layout.of(problem), TileLight(problem)
    if start is None:
        begins = gamma is not None and problem.fit_transfer and problem.transfer.kind == "gamma"
        transfer = problem.transfer.moved([gamma]) if begins else problem.transfer
        start = Unknowns(*initialise(problem, transfer), transfer)
    at = Equations.begun(problem, light, layout, _begun(problem, layout, start))
    solvable = layout.size > 0 and len(problem.tile_group) > 0
    at, converged, iteration = _least_squares(problem, at, max_iterations if solvable else 0, tolerance, trace)
    converged = converged or layout.size == 0
    if finish and problem.halves and converged and solvable:
        at, steps = _unbiased(problem, at, tolerance)
        iteration += steps
        if trace:
            trace(iteration=iteration, image_rmse=rmse(problem, at.residual), state=at.state)
    error = rmse(problem, at.residual)
    result = Result(at.state, converged, iteration, error, tile_residual=at.residual, residual=light.residual, at=at)
    if finish and solvable:
        uncertainty(problem, at, result)
    return result


def _begun(problem, layout, start: Unknowns) -> Unknowns:
    transfer = start.transfer if problem.fit_transfer else problem.transfer
    bend = None if start.rho_s is None else np.zeros(len(layout.bend))
    return start._replace(transfer=transfer, bend=bend, cause=np.zeros(layout.cause) if layout.cause else None)


def _least_squares(problem, at: Equations, max_iterations, tolerance, trace):
    """Equations at the least squares, whether the last step was small enough, and the number of iterations."""
    bounds = at.layout.bounds(at.state.transfer)
    damping, converged, iteration, last, before = 1e-3, False, 0, None, np.inf
    while True:
        error = rmse(problem, at.residual)
        if trace:
            trace(iteration=iteration, image_rmse=error, state=at.state)
        if converged or iteration >= max_iterations:
            return at, converged, iteration
        iteration += 1
        weight = weights(problem, at.residual)
        J = at.jacobian
        gradient, prior = at.prior()
        H = J.T @ (weight.reshape(-1, 1) * J) + prior
        g = J.T @ (weight * at.residual).reshape(-1) + gradient
        theta, cost = at.layout.pack(at.state), at.cost(weight)
        comes_near = problem.cause is None and FAR < error < CLOSER * before
        still, before = at.layout.responding if comes_near else slice(0, 0), error
        for tried in range(TRIES):
            step = _bounded_step(H, g, theta, *bounds, damping, still)
            trial = at.moved(theta + step)
            if trial.cost(weight) <= cost * (1 + 1e-9) + 1e-12:
                damping = damping if tried else max(damping / 10, 1e-9)
                break
            damping = max(damping, 1e-6) * 10
        else:
            return at, bool(_relative(step, theta) < 100 * tolerance), iteration
        base = step
        if problem.cause is None and _goes_on(last, step, theta):  # causes are lines near where they stand
            step, trial = _farther(problem, at, step, trial, bounds)
        converged = bool(_relative(step, theta) < tolerance) and not comes_near
        at, last = trial, base


def _goes_on(last, step, theta):
    """Two steps have much the same direction and length: so it will go on, as where Huber's weights follow slowly."""
    if last is None:
        return False
    a, b = (s / np.maximum(np.abs(theta), 0.05) for s in (last, step))
    length = np.linalg.norm(a)
    return bool(a @ b > PARALLEL * length * np.linalg.norm(b) and np.linalg.norm(b) > LASTING * length)


def _farther(problem, at: Equations, step, trial: Equations, bounds):
    """(step, Equations): twice as far in the same direction, and twice again, while Huber's own cost falls."""
    theta, spread = at.layout.pack(at.state), variance(problem, at.residual)
    cost = trial.cost_of(huber(spread, trial.residual))
    low, high = bounds
    for _ in range(DOUBLINGS):
        far = theta + 2 * step
        if (far < low).any() or (far > high).any():
            break
        other = trial.moved(far)
        there = other.cost_of(huber(spread, other.residual))
        if there >= cost:
            break
        step, trial, cost = 2 * step, other, there
    return step, trial


def _relative(step, theta):
    return float(np.max(np.abs(step) / np.maximum(np.abs(theta), 0.05), initial=0.0))


def _unbiased(problem, start: Equations, tolerance):
    """From the least squares to the root of  J0' W r1 + J1' W r0 + prior = 0  (halves as instruments for each other).

    Returns the equations there and the steps taken. Where the steps do not die away, the least squares stand, with 0
    steps.
    """
    at, last = start, np.inf
    weight = weights(problem, at.residual).reshape(-1)
    low, high = at.layout.bounds(at.state.transfer)
    for steps in range(1, UNBIASED_STEPS + 1):
        (r0, J0), (r1, J1) = at.half(0), at.half(1)
        gradient, prior = at.prior()
        cross = J0.T @ (weight[:, None] * J1)
        H = (cross + cross.T) / 2 + prior
        g = (J0.T @ (weight * r1) + J1.T @ (weight * r0)) / 2 + gradient
        if not _positive_definite(H):
            break
        theta = at.layout.pack(at.state)
        step = _bounded_step(H, g, theta, low, high, 0.0)
        size = _relative(step, theta)
        if size > 0.9 * last:
            break
        last = size
        at = at.moved(theta + step)
        if size < 10 * tolerance:
            return at, steps
    return start, 0


def _positive_definite(H):
    diagonal = np.diag(H)
    return bool((diagonal > 0).all() and np.linalg.eigvalsh(H / np.sqrt(np.outer(diagonal, diagonal)))[0] > 1e-9)


def _bounded_step(H, g, theta, low, high, damping, still=slice(0, 0)):
    """Levenberg-Marquardt step within bounds. still : parameters that do not move

    A step towards a bound covers at most 0.9 of the way: clipping would bend its direction. A parameter that sits at
    its bound and is pushed outward is held.
    """
    held = ((theta <= low + 1e-9) & (g > 0)) | ((theta >= high - 1e-9) & (g < 0))
    held[still] = True
    free = np.flatnonzero(~held)
    step = np.zeros(len(theta))
    if len(free):
        A = H[np.ix_(free, free)]
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        A = A / np.outer(size, size)
        step[free] = np.linalg.lstsq(A + damping * np.eye(len(free)), -g[free] / size, rcond=1e-13)[0] / size
    room = np.where(step > 0, high - theta, theta - low)
    limit = np.where(np.abs(step) > 0, np.where(room > 1e-4, 0.9 * room, room) / np.maximum(np.abs(step), 1e-12), 1.0)
    most = np.abs(step) * np.minimum(limit, 1)
    return np.clip(step, -most, most)


def fit(problem: Problem, **options):
    """`gauss_newton`, and what fixed the scale.

    Interreflection alone may have to fix it. Where it cannot (the sigma of the lamps' light together is half of that
    light or more), the lamp that gives most of it is set to 1 by convention, and the rest is fitted again: ratios
    between lamps stand. A lamp that is loose beside others that are not keeps its own sigma.
    """
    fixed_by = scale(problem)
    result = gauss_newton(problem, **options)
    if fixed_by != "interreflection" or len(problem.tile_group) == 0:
        return result, fixed_by
    light, sigma = _light_of_lamps(problem, result)
    total = light.sum(axis=0)
    if ((total > 0) & (sigma <= LOOSE * total)).all():
        return result, fixed_by
    most = np.flatnonzero(problem.own_lamps)[light.sum(axis=1)[problem.own_lamps].argmax()]
    emittance = problem.emittance.copy()
    emittance[most] = 1.0
    result = gauss_newton(replace(problem, emittance=emittance), **options)
    result.warnings.append(
        f"interreflection is too weak here to fix the scale: the emittance of {problem.lamps[most]!r} is taken as 1, "
        "and all else is right up to one factor: give an emittance, or a reference"
    )
    return result, "convention"


def _light_of_lamps(problem, result):
    """(L, C) what each unknown lamp adds to the picture, and (C,) the sigma of their sum, both in display."""
    at, own = result.at, result.at.layout.E  # (k, 2) lamp and channel
    normal = NormalEquations.of(problem, at)
    first, last = at.layout.ends[:2]
    share = normal.J[:, first:last].mean(axis=0)  # of one of emittance
    light, sigma = np.zeros(result.state.E.shape), np.zeros(problem.channels)
    light[tuple(own.T)] = share * result.state.E[tuple(own.T)]
    together = normal.correlation()[first:last, first:last]
    each = share * result.sigma_E[tuple(own.T)]
    for c in range(problem.channels):
        of = own[:, 1] == c
        sigma[c] = np.sqrt(max(each[of] @ together[np.ix_(of, of)] @ each[of], 0.0))
    return light, sigma
