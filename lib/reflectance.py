"""Reflectances, lamps and gamma from one photograph (sections 4.4 and 4.5).

The scene's light is linear in the lamps and, at given reflectances, one small linear solve:

    b = rho (D E + F b)        reflected radiosity of the patches (eq. 3.2; D: lamp factors)
    B_t = rho_g (D_t E + G_t b)     radiosity of tile t of the photograph, which lies on group g

so a re-rendering of all tiles after a change of reflectance costs milliseconds, and derivatives are exact:
    db/drho_h = (I - rho F)^-1 1_h (D E + F b),      db/dE_l = (I - rho F)^-1 rho D_l.

`gauss_newton` adjusts all reflectances, unknown lamps and gamma together (they share a valley: DESIGN 7, trap 1).
`paper` is the printed alternation (eq. 4.3, 4.4-4.6, then 4.1-4.2); `damped` is the same with the common factor
damped, which also converges in bright rooms (DESIGN 3).
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lib import radiosity
from lib.transfer import Metric, Tiles, Transfer

DENSE_LIMIT = 6000      # patches up to which F is kept dense: BLAS is then faster than sparse products


@dataclass
class Problem:
    """What the photograph says and what geometry knows. C channels, N patches, T tiles, G groups, L lamps."""
    F: object                    # (N, N) array or CSR
    D: np.ndarray                # (N, L)
    patch_group: np.ndarray      # (N,) int
    area: np.ndarray             # (N,)
    G: object                    # (T, N) CSR, with the sub-cell correction of the sources, as F
    G_plain: object              # (T, N) CSR, without
    D_tile: np.ndarray           # (T, L)
    tile_group: np.ndarray       # (T,) int
    tile_object: np.ndarray      # (T,) int
    start: np.ndarray            # (T + 1,) into pixels
    pixels: np.ndarray           # (M, C) display
    groups: tuple
    lamps: tuple
    emittance: np.ndarray        # (L, C); NaN where unknown
    rho: np.ndarray              # (G, C); NaN where unknown, 0 for lamps, the given value for references
    metric: Metric
    fit_gamma: bool
    halves: tuple = ()           # (G0, G1, F0, F1): the same from disjoint rays
    group_area: np.ndarray = None

    def __post_init__(self):
        self.photograph = Tiles(self.pixels, self.start)

    @property
    def channels(self):
        return self.pixels.shape[1]

    @property
    def n_pixels(self):
        return np.diff(self.start)


@dataclass(frozen=True)
class State:
    rho: np.ndarray              # (G, C)
    E: np.ndarray                # (L, C)
    gamma: float
    B: np.ndarray                # (T, C) tile radiosities
    b: np.ndarray                # (N, C) reflected radiosity of the patches
    seen: np.ndarray = None      # (T, C) photograph, linear mean of the tile
    seen_slope: np.ndarray = None


@dataclass
class Result:
    state: State
    converged: bool
    iterations: int
    rmse: float
    sigma_rho: np.ndarray = None
    sigma_E: np.ndarray = None
    sigma_gamma: float = None
    tile_residual: np.ndarray = None     # (T, C) display, synthesis minus photograph
    residual: float = None               # of the light balance
    shares: dict = field(default_factory=dict)   # median relative sigma by cause
    warnings: list = field(default_factory=list)


class Light:
    """Solves the balance and renders the tiles; keeps F in single precision, which its sampling error dwarfs."""

    def __init__(self, problem: Problem, F=None, G=None):
        self.p = problem
        F = problem.F if F is None else F
        self.G = problem.G if G is None else G
        self.F = F.toarray() if hasattr(F, "toarray") and F.shape[0] <= DENSE_LIMIT else F
        self.derivative = None       # of the last linearisation: where the next block solve starts

    def _apply(self, scale):
        """scale : (N, K) rho of each patch in each column."""
        return lambda X: X - scale * (self.F @ X)

    def solve(self, rho, E, x0=None, tolerance=1e-6):
        """Reflected radiosity of the patches, (N, C), and irradiance D E + F b of the patches, (N, C)."""
        direct = self.p.D @ E
        scale = rho[self.p.patch_group].astype(np.float32)
        b, residual, _ = radiosity.gmres(self._apply(scale), (scale * direct).astype(np.float32), tolerance=tolerance, x0=x0)
        self.residual = residual
        return b, direct + self.F @ b

    def tiles(self, rho, E, b):
        """Tile irradiance (T, C): B_t = rho_g times this."""
        return self.p.D_tile @ E + self.G @ b

    def render(self, rho, E, gamma, x0=None) -> State:
        b, _ = self.solve(rho, E, x0)
        return State(rho, E, gamma, rho[self.p.tile_group] * self.tiles(rho, E, b), b)


def _metric(problem, gamma):
    if problem.metric.transfer.kind == "gamma":
        return Metric(Transfer("gamma", gamma))
    return problem.metric


def _observe(problem, gamma):
    return problem.photograph.linear(_metric(problem, gamma).transfer)


def _group_mean(problem, values, weights=None):
    """Pixel-weighted mean over each group's tiles, (G, C); NaN for a group never seen."""
    w = problem.n_pixels.astype(float)
    total = np.zeros((len(problem.groups), values.shape[1]))
    np.add.at(total, problem.tile_group, values * w[:, None])
    count = np.bincount(problem.tile_group, w, minlength=len(problem.groups))[:, None]
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def initialise(problem, gamma):
    """eq. 4.3: rho_i is the mean of P ** gamma over the pixels of group i; a group never seen starts at the seen
    groups' mean by area; an unknown lamp at the brightest group mean."""
    seen, _ = _observe(problem, gamma)
    mean = _group_mean(problem, seen)
    rho = np.where(np.isnan(problem.rho), np.clip(mean, 0.02, 0.9), problem.rho)
    prior, _ = _prior(problem, rho)
    rho = np.where(np.isnan(rho), prior, rho)
    E = np.where(np.isnan(problem.emittance), 1.0, problem.emittance)
    unknown = np.isnan(problem.emittance)
    if unknown.any():
        # one power for all unknown lamps so that the picture's mean is right at rho = 0.5
        level = Light(problem).tiles(rho, E, np.zeros((len(problem.area), problem.channels), np.float32)).mean(axis=0)
        E = np.where(unknown, np.maximum(2 * seen.mean(axis=0) / np.maximum(level, 1e-12), 1e-6), E)
    return rho, E


def _prior(problem, rho):
    """Mean of the seen groups by area and their spread, per channel (SCENE.md 3)."""
    free = np.isnan(problem.rho).any(axis=1)
    has = np.isin(np.arange(len(problem.groups)), problem.tile_group)
    use = has & free if (has & free).any() else has
    if not use.any():
        return np.full(problem.channels, 0.5), np.full(problem.channels, 0.3)
    w = problem.group_area[use][:, None]
    mean = (rho[use] * w).sum(axis=0) / w.sum()
    spread = np.sqrt(((rho[use] - mean) ** 2 * w).sum(axis=0) / w.sum())
    return mean, np.maximum(spread, 0.05)


# -- Gauss-Newton

@dataclass(frozen=True)
class _Layout:
    """Which parameters are free: reflectance (g, c), lamp (l, c), gamma."""
    rho: np.ndarray      # (n_rho, 2)
    E: np.ndarray        # (n_E, 2)
    gamma: bool

    @property
    def size(self):
        return len(self.rho) + len(self.E) + self.gamma


def _layout(problem):
    used = np.isin(np.arange(len(problem.groups)), np.concatenate([problem.tile_group, problem.patch_group]))
    rho = np.argwhere(np.isnan(problem.rho) & used[:, None])
    return _Layout(rho, np.argwhere(np.isnan(problem.emittance)), problem.fit_gamma)


def _jacobian(problem, light, layout, state, irradiance):
    """dB/dtheta, (T, C, n) without gamma; derivatives of the patches by one block solve."""
    n_rho, n_E = len(layout.rho), len(layout.E)
    channel = np.concatenate([layout.rho[:, 1], layout.E[:, 1]]).astype(int)
    scale = state.rho[problem.patch_group].astype(np.float32)
    rhs = np.zeros((len(problem.area), n_rho + n_E), np.float32)
    for k, (g, c) in enumerate(layout.rho):
        rhs[:, k] = np.where(problem.patch_group == g, irradiance[:, c], 0)
    for k, (lamp, c) in enumerate(layout.E):
        rhs[:, n_rho + k] = scale[:, c] * problem.D[:, lamp]
    # the exact residual decides where the iteration ends; its derivative only how fast
    db, _, _ = radiosity.gmres(light._apply(scale[:, channel]), rhs, tolerance=3e-3, x0=light.derivative)
    light.derivative = db
    reaching = light.G @ db                                                             # (T, n)
    rho_tile = state.rho[problem.tile_group]
    tile_irradiance = light.tiles(state.rho, state.E, state.b)
    J = np.zeros((len(problem.tile_group), problem.channels, layout.size))
    for k, c in enumerate(channel):
        J[:, c, k] = rho_tile[:, c] * reaching[:, k]
        if k < n_rho:
            mine = problem.tile_group == layout.rho[k, 0]
            J[mine, c, k] += tile_irradiance[mine, c]
        else:
            J[:, c, k] += rho_tile[:, c] * problem.D_tile[:, layout.E[k - n_rho, 0]]
    return J


def _residual(problem, state, gamma):
    """Display value of synthesis minus photograph per tile, (T, C), and its derivative in B and in gamma."""
    metric = _metric(problem, gamma)
    seen, seen_slope = _observe(problem, gamma)
    residual = metric.value(state.B) - metric.value(seen)
    slope = metric.slope(state.B)
    by_gamma = np.zeros_like(residual)
    if problem.fit_gamma:
        def fixed(B):            # d (B ** (1 / gamma)) / d gamma at fixed B: the factor -1 / gamma^2 missing in eq. 4.2
            B = np.maximum(B, 1e-12)
            return -metric.value(B) * np.log(B) / gamma ** 2
        by_gamma = fixed(state.B) - fixed(seen) - metric.slope(seen) * seen_slope
    return residual, slope, by_gamma


def _weights(problem, residual, noise):
    """Weight of each tile and channel: pixel noise falls with the tile's size, model error does not; residuals far
    out (a texture, a reflection the model does not know) are held down (Huber at 2.5)."""
    n = problem.n_pixels[:, None]
    floor = noise[1]
    variance = noise[0] ** 2 / n + floor ** 2
    z = np.abs(residual) / np.sqrt(variance)
    return np.minimum(1, 2.5 / np.maximum(z, 1e-12)) / variance


def _pixel_noise(problem):
    """Robust display noise of one pixel from differences of neighbours inside tiles."""
    step = np.diff(problem.pixels, axis=0)
    inner = np.ones(len(step), bool)
    inner[problem.start[1:-1] - 1] = False
    return max(1.4826 * float(np.median(np.abs(step[inner]))) / np.sqrt(2), 0.3 / 255) if inner.any() else 0.01


def gauss_newton(problem: Problem, *, gamma=2.2, max_iterations=30, tolerance=1e-5, trace=None) -> Result:
    """All unknown reflectances, lamps and gamma together, damped Gauss-Newton with bounds (Levenberg-Marquardt)."""
    layout = _layout(problem)
    light = Light(problem)
    rho, E = initialise(problem, gamma)
    gamma = gamma if problem.fit_gamma else problem.metric.transfer.gamma
    n_rho, n_E = len(layout.rho), len(layout.E)
    noise = (_pixel_noise(problem), 0.004)
    unseen = ~np.isin(layout.rho[:, 0], problem.tile_group)
    damping, converged, iteration = 1e-3, False, 0

    def evaluate(rho, E, gamma, x0=None):
        b, irradiance = light.solve(rho, E, x0)
        state = State(rho, E, gamma, rho[problem.tile_group] * light.tiles(rho, E, b), b)
        return state, irradiance, *_residual(problem, state, gamma)

    def cost_of(residual, rho, weight):
        prior, spread = _prior(problem, rho)
        c = layout.rho[unseen, 1]
        return float((weight * residual ** 2).sum() + (((rho[layout.rho[unseen, 0], c] - prior[c]) / spread[c]) ** 2).sum())

    state, irradiance, residual, slope, by_gamma = evaluate(rho, E, gamma)
    while True:
        rmse = _rmse(problem, residual)
        if trace:
            trace(iteration=iteration, image_rmse=rmse, state=state)
        if iteration >= max_iterations or converged or layout.size == 0:
            converged = converged or layout.size == 0
            break
        iteration += 1
        typical = 1.4826 * float(np.median(np.abs(residual))) if len(residual) else 0.0
        noise = (noise[0], min(max(typical, 5e-4), 0.05))
        weight = _weights(problem, residual, noise)
        J = slope[:, :, None] * _jacobian(problem, light, layout, state, irradiance)
        if layout.gamma:
            J[:, :, -1] = by_gamma
        J = J.reshape(-1, layout.size)
        H = J.T @ (weight.reshape(-1, 1) * J)
        g = J.T @ (weight * residual).reshape(-1)
        prior, spread = _prior(problem, state.rho)
        for k in np.flatnonzero(unseen):
            group, c = layout.rho[k]
            H[k, k] += 1 / spread[c] ** 2
            g[k] += (state.rho[group, c] - prior[c]) / spread[c] ** 2
        theta = np.concatenate([state.rho[tuple(layout.rho.T)], state.E[tuple(layout.E.T)], [state.gamma] * layout.gamma])
        low = np.concatenate([np.zeros(n_rho + n_E), [0.2] * layout.gamma])
        high = np.concatenate([np.ones(n_rho), np.full(n_E, np.inf), [8.0] * layout.gamma])
        cost = cost_of(residual, state.rho, weight)
        accepted = False
        for _ in range(12):
            step = _bounded_step(H, g, theta, low, high, damping)
            new = theta + step
            rho, E = state.rho.copy(), state.E.copy()
            rho[tuple(layout.rho.T)] = new[:n_rho]
            E[tuple(layout.E.T)] = new[n_rho:n_rho + n_E]
            trial = evaluate(rho, E, float(new[-1]) if layout.gamma else state.gamma, state.b)
            if cost_of(trial[2], rho, weight) <= cost * (1 + 1e-9) + 1e-12:
                accepted, damping = True, max(damping / 10, 1e-9)
                break
            damping = max(damping, 1e-6) * 10
        if not accepted:
            converged = np.max(np.abs(step) / np.maximum(np.abs(theta), 0.01)) < 100 * tolerance
            break
        state, irradiance, residual, slope, by_gamma = trial
        converged = bool(np.max(np.abs(step) / np.maximum(np.abs(theta), 0.05)) < tolerance)
    result = Result(state, converged, iteration, rmse, tile_residual=residual, residual=light.residual)
    _uncertainty(problem, light, layout, result, residual, slope, by_gamma, irradiance, noise)
    return result


def _bounded_step(H, g, theta, low, high, damping):
    """Levenberg-Marquardt step; a step towards a bound covers at most 0.9 of the way (clipping would bend its
    direction), and a parameter that sits at its bound and is pushed outward is held."""
    free = np.ones(len(theta), bool)
    free &= ~((theta <= low + 1e-9) & (g > 0)) & ~((theta >= high - 1e-9) & (g < 0))
    step = np.zeros(len(theta))
    for _ in range(len(theta) + 1):
        idx = np.flatnonzero(free)
        if len(idx) == 0:
            break
        A = H[np.ix_(idx, idx)]
        scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
        A = A / np.outer(scale, scale)
        step[:] = 0
        step[idx] = np.linalg.lstsq(A + damping * np.eye(len(idx)), -g[idx] / scale, rcond=1e-13)[0] / scale
        break
    room = np.where(step > 0, high - theta, theta - low)
    limit = np.where(np.abs(step) > 0, np.where(room > 1e-4, 0.9 * room, room) / np.maximum(np.abs(step), 1e-300), 1.0)
    return np.clip(step * 1.0, -np.abs(step) * np.minimum(limit, 1), np.abs(step) * np.minimum(limit, 1))


def _rmse(problem, residual):
    w = np.broadcast_to(problem.n_pixels[:, None], residual.shape)
    return float(np.sqrt((w * residual ** 2).sum() / max(w.sum(), 1)))


def group_rmse(problem, residual):
    """Display RMSE of each group's tiles, (G,); NaN where the group is not seen."""
    return np.sqrt(_group_mean(problem, (residual ** 2).mean(axis=1, keepdims=True))[:, 0])


def _uncertainty(problem, light, layout, result, residual, slope, by_gamma, irradiance, noise):
    """Covariance of the parameters (see the module's README section): tile residuals (pixel noise, texture, tile
    sampling) by the sandwich formula; then, each as a perturbation of all tiles pushed through the same normal
    equations: the patches' discretisation (half of the sub-cell correction), and the sampling of the form
    factors (two disjoint halves of the rays). Groups never seen enter through their prior."""
    n = layout.size
    if n == 0:
        return
    state = result.state
    J = slope[:, :, None] * _jacobian(problem, light, layout, state, irradiance)
    if layout.gamma:
        J[:, :, -1] = by_gamma
    J = J.reshape(-1, n)
    weight = _weights(problem, residual, noise).reshape(-1)
    H = J.T @ (weight[:, None] * J)
    unseen = ~np.isin(layout.rho[:, 0], problem.tile_group)
    _, spread = _prior(problem, state.rho)
    prior = np.zeros((n, n))
    for k in np.flatnonzero(unseen):
        prior[k, k] = 1 / spread[layout.rho[k, 1]] ** 2
    scale = 1 / np.sqrt(np.maximum(np.diag(H + prior), 1e-300))
    inverse = scale[:, None] * np.linalg.pinv((H + prior) * np.outer(scale, scale), rcond=1e-12, hermitian=True) * scale
    score = (weight * residual.reshape(-1))[:, None] * J
    # residuals of one tile in different channels go together
    score = score.reshape(len(residual), -1, n).sum(axis=1)
    model_noise = J.T @ ((weight ** 2 * np.repeat(noise[0] ** 2 / problem.n_pixels, problem.channels))[:, None] * J)
    cov = inverse @ (score.T @ score + model_noise + prior) @ inverse

    def push(dB):
        """(n,) change of the parameters that a change dB (T, C) of the synthesis causes."""
        return -inverse @ (J.T @ (weight * (slope * dB).reshape(-1)))

    rho_tile = state.rho[problem.tile_group]
    terms = {}
    # discretisation: half of what the sub-cell correction changed
    terms["discretisation"] = 0.5 * push(rho_tile * (light.G @ state.b - problem.G_plain @ state.b))
    if problem.halves:
        G0, G1, F0, F1 = problem.halves
        solved = [Light(problem, F, problem.G) for F in (F0, F1)]
        b0, b1 = (s.solve(state.rho, state.E, state.b)[0] for s in solved)
        terms["form factors"] = 0.5 * push(rho_tile * (problem.G @ (b0 - b1)))
        # rays of the tiles: independent from tile to tile
        dB = 0.5 * rho_tile * ((G0 - G1) @ state.b)
        each = (J * weight[:, None]).reshape(len(dB), problem.channels, n) * (slope * dB)[:, :, None]
        each = each.sum(axis=1)
        cov = cov + inverse @ (each.T @ each) @ inverse
    relative = np.zeros(n)
    for name, delta in terms.items():
        # one realisation can vanish by chance: not below the root mean square of the group's kind, relative to the value
        theta = np.concatenate([state.rho[tuple(layout.rho.T)], state.E[tuple(layout.E.T)], [state.gamma] * layout.gamma])
        ratio = delta / np.maximum(np.abs(theta), 0.02)
        kind = np.concatenate([np.zeros(len(layout.rho)), np.ones(len(layout.E)), np.full(int(layout.gamma), 2)])
        for value in np.unique(kind):
            mine = (kind == value) & np.concatenate([~unseen, np.ones(n - len(unseen), bool)])
            if mine.any():
                floor = np.median(np.abs(ratio[mine])) if value == 0 else 0.0
                relative[mine] = np.maximum(np.abs(ratio[mine]), floor)
        sigma = relative * np.maximum(np.abs(theta), 0.02)
        cov = cov + np.diag(sigma ** 2)
        result.shares[name] = float(np.median(relative[:len(layout.rho)])) if len(layout.rho) else 0.0
    sigma = np.sqrt(np.maximum(np.diag(cov), 0))
    shape = state.rho.shape
    result.sigma_rho = np.zeros(shape)
    result.sigma_rho[tuple(layout.rho.T)] = sigma[:len(layout.rho)]
    result.sigma_E = np.zeros(state.E.shape)
    result.sigma_E[tuple(layout.E.T)] = sigma[len(layout.rho):len(layout.rho) + len(layout.E)]
    result.sigma_gamma = float(sigma[-1]) if layout.gamma else None


def scale(problem) -> str:
    """What fixes the scale of the light (SCENE.md 4)."""
    if not np.isnan(problem.emittance).all():
        return "lamps"
    given = ~np.isnan(problem.rho).any(axis=1)
    named = [g for g in np.flatnonzero(given) if problem.groups[g] not in problem.lamps]
    return "reference" if named else "interreflection"


def fit(problem: Problem, **options):
    """`gauss_newton`, and what fixed the scale. Where interreflection alone would have to and cannot (the lamps'
    sigma is half their value or more), the lamps are set to 1 by convention and the rest is fitted again."""
    fixed_by = scale(problem)
    result = gauss_newton(problem, **options)
    if fixed_by == "interreflection" and len(problem.tile_group) and (result.sigma_E > 0.5 * result.state.E).any():
        result = gauss_newton(replace(problem, emittance=np.ones_like(problem.emittance)), **options)
        result.warnings.append("interreflection is too weak here to fix the scale: emittance 1 by convention")
        fixed_by = "convention"
    return result, fixed_by


# -- the paper's alternation

def paper(problem: Problem, *, gamma=2.2, damped=False, exponent=None, threshold=1e-3, max_inner=60, max_outer=30,
          trace=None) -> Result:
    """Section 4.5 as printed: eq. 4.3; eq. 4.4-4.6 to the threshold; gamma on eq. 4.1; repeated.

    damped : the correction's common factor m is damped, rho_i *= (q_i / m) m ** (1 - mean rho), on ratios of
        radiosities and symmetrised on |ln epsilon|; the printed form diverges in bright rooms (DESIGN 3)
    exponent : power on the ratio of pixel means (eq. 4.4 as printed: 1)
    """
    light = Light(problem)
    rho, E = initialise(problem, gamma)
    gamma = gamma if problem.fit_gamma else problem.metric.transfer.gamma
    pairs, tile_pair = np.unique(np.stack([problem.tile_group, problem.tile_object], axis=1), axis=0, return_inverse=True)
    n = problem.n_pixels.astype(float)
    m_pair = np.bincount(tile_pair, n)[:, None]
    free = np.isnan(problem.rho)
    iteration, converged, x0 = 0, False, None

    def object_mean(values):
        total = np.zeros((len(pairs), values.shape[1]))
        np.add.at(total, tile_pair, values * n[:, None])
        return total / m_pair

    def finish(state, converged):
        metric = _metric(problem, state.gamma)
        residual = metric.value(state.B) - metric.value(_observe(problem, state.gamma)[0])
        return Result(state, converged, iteration, _rmse(problem, residual), tile_residual=residual, residual=light.residual)

    for outer in range(max_outer):
        settled = False
        for inner in range(max_inner):
            state = light.render(rho, E, gamma, x0)
            x0 = state.b
            metric = _metric(problem, gamma)
            seen, _ = _observe(problem, gamma)
            residual = metric.value(state.B) - metric.value(seen)
            if trace:
                trace(iteration=iteration, image_rmse=_rmse(problem, residual), state=state)
            iteration += 1
            if not np.isfinite(state.B).all():
                return finish(state, False)
            if damped:
                epsilon = object_mean(seen) / np.maximum(object_mean(state.B), 1e-12)
            else:
                epsilon = (object_mean(metric.value(seen)) / np.maximum(object_mean(metric.value(state.B)), 1e-12)) ** (exponent or 1)
            q = np.ones_like(rho)
            for g in np.unique(pairs[:, 0]):
                mine = pairs[:, 0] == g
                for c in range(problem.channels):
                    q[g, c] = _group_correction(epsilon[mine, c], m_pair[mine, 0], symmetric=damped)
            if damped:
                use = np.isin(np.arange(len(rho)), problem.tile_group)[:, None] & free
                w = np.where(use, problem.group_area[:, None], 0)
                m = np.exp((w * np.log(np.maximum(q, 1e-12))).sum(axis=0) / np.maximum(w.sum(axis=0), 1e-300))
                mean_rho = (problem.group_area[:, None] * rho).sum(axis=0) / problem.group_area.sum()
                q = q / m * m ** (1 - mean_rho)
            new = np.where(free, np.clip(rho * q, 0, 1 if damped else 10.0), rho)
            prior, _ = _prior(problem, new)
            new = np.where(free & ~np.isin(np.arange(len(rho)), problem.tile_group)[:, None], prior, new)
            change = np.max(np.abs(new - rho) / np.maximum(rho, 1e-6))
            rho = new
            if change > 1e3 or rho.max() > 1.5:
                return finish(light.render(np.clip(rho, 0, 0.999), E, gamma), False)
            if change < threshold:
                settled = True
                break
        if not problem.fit_gamma:
            converged = settled
            break
        state = light.render(rho, E, gamma, x0)
        better = _best_gamma(problem, state.B, gamma)
        if abs(better - gamma) < threshold:
            converged = settled
            gamma = better
            break
        gamma = better
    return finish(light.render(rho, E, gamma, x0), converged)


def _group_correction(epsilon, pixels, symmetric):
    """eq. 4.5 with the weights f of eq. 4.6 over the objects of one group.

    As printed the legend says K_j where the formula has epsilon_j, and f is one-sided: epsilon is a ratio, so one
    object in shadow ({.3, 1, 1}) throws out both good ones. `symmetric` judges |ln epsilon - its median| instead.
    """
    if symmetric:
        distance = np.exp(np.abs(np.log(np.maximum(epsilon, 1e-12)) - np.median(np.log(np.maximum(epsilon, 1e-12)))))
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
        d = -value * logB / gamma ** 2                       # eq. 4.2 with its missing factor -1 / gamma^2
        gradient = (count * (value - display) * d).sum()
        curvature = (count * d ** 2).sum()
        step = -gradient / max(curvature, 1e-300)
        gamma_new = float(np.clip(gamma + np.clip(step, -0.5, 0.5), 0.2, 8))
        if abs(gamma_new - gamma) < 1e-7:
            return gamma_new
        gamma = gamma_new
    return gamma
