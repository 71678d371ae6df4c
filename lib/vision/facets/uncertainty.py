"""How well planes are known, beyond the noise of independent points.

Six things add to it. Neighbouring points err together (`together`). Sides of outlines are off as a whole
(`side_sigma`, `own_side_sigma`). One side may not be the facet's: others may show it (`held_by_sides`) or not
(`unchecked`, `turned_about_the_rest`). Borders and texture may contradict each other (`disagreement`).
"""

from typing import NamedTuple

import numpy as np

from lib.vision.facets.contours import AGREE, Measured
from lib.vision.facets.contours_kernels import NORMAL_U, PART, RESIDUAL, SIGMA, WEIGHT, U, V

MISFIT = 1.2  # times the ordinary rms of the pair's borders: what lies farther apart is not one plane's
CHI2_95 = 7.81  # of 3 degrees of freedom
SIDE_SIGMAS = np.array([0, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.065, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3])  # px, tried
ASIDE = 1.5  # times farther off, along the epipolar lines, than level sides are: a whole upright one, see `asides`
UPRIGHT = 0.6  # of its normal along u: a side to the left or right of the region, else above or below it
LINE = 1.5  # px, standard deviation of border points across the line that they lie in
RESTS = 5.0  # times less certain without the sides of holes: the plane rests on them
TAIL = 6.0  # times the variance of a side: what the few that are far off add to it, where no other side shows it
EXACT = 0.006  # px: sides of exact pairs, of which none is far off
ALONE = 8  # power of a side's share in what is known
ESSENTIAL = 0.9  # share of what is known in some direction that is one side's, at most: the plane rests on it


class NormalEquations(NamedTuple):
    """Of a plane's correction x, in units of (size, size, 1): square + 2 b x + x A x."""

    A: np.ndarray  # (3, 3)
    b: np.ndarray  # (3,)
    square: float
    log_determinant: float  # of the variance that the sides add


def with_sides(x: Measured, sigma_side) -> NormalEquations:
    """At x.plane, where each side of the outline is off by sigma_side px as a whole: one number, or (P,) of each."""
    if not np.any(sigma_side):
        return NormalEquations(x.A, x.b, x.square, 0.0)
    k = sigma_side**2 / (1 + x.C * sigma_side**2)
    return NormalEquations(
        x.A - np.einsum("p,pi,pj->ij", k, x.B, x.B),
        x.b - (k * x.D) @ x.B,
        x.square - float((k * x.D**2).sum()),
        float(np.log1p(sigma_side**2 * x.C).sum()),
    )


def together(measured: list[Measured]) -> float:
    """How much more (or less) the scores of neighbouring border points add up than independent ones would.

    Their variance over 16 px of a side against the sum of their variances, mean over the pair's facets.
    """
    ratios = [ratio for ratio in map(_of_neighbours, measured) if ratio is not None]
    return float(np.clip(np.mean(ratios), 0.5, 16)) if ratios else 1.0


def _of_neighbours(x):
    """That of one facet; None where it has too few points to tell."""
    if len(x.rows) == 0:
        return None
    cell = (x.rows[:, PART] * 4096 + x.rows[:, U] // 16 % 64) * 64 + x.rows[:, V] // 16 % 64
    cell = np.unique(cell, return_inverse=True)[1]
    if cell.max() < 7:
        return None
    J = x.rows[:, :3] / [x.size, x.size, 1]
    w = x.rows[:, WEIGHT]
    scores = np.stack([np.bincount(cell, w * x.rows[:, RESIDUAL] * J[:, k]) for k in range(3)], axis=1)
    own = np.stack([[np.bincount(cell, w * J[:, p] * J[:, q]) for p in range(3)] for q in range(3)]).transpose(2, 0, 1)
    inverse = np.linalg.pinv(own.sum(axis=0))
    fitted = np.einsum("cij,cji", inverse @ own, inverse @ own)  # what the fit has taken out of the residuals
    if not fitted < 2:
        return None
    alone = (w * x.rows[:, RESIDUAL]) ** 2 @ np.einsum("ki,ij,kj->k", J, inverse, J)
    if not alone > 0:
        return None
    return np.einsum("ci,ij,cj", scores, inverse, scores) / alone * 3 / (3 - fitted)


def asides(x: Measured) -> np.ndarray:
    """(P,) how much farther each side may be off than a level one.

    What lies behind an upright side is not the same in both photographs, and moves the place where each of them shows
    the side. Above and below a region both show the same. On nine path-traced pairs 50 level sides were off by .014 px
    in the median (their noise: .016), 99 upright ones by .041 (.019). More than ASIDE is not taken: exact pairs do not
    have it, and few facets hardly tell which kind of pair it is.
    """
    part = x.rows[:, PART].astype(int)
    number = np.maximum(np.bincount(part, minlength=len(x.C)), 1)
    return np.sqrt(1 + ASIDE**2 * np.bincount(part, x.rows[:, NORMAL_U] ** 2, len(x.C)) / number)


def side_sigma(measured: list[Measured], shapes: list[np.ndarray]) -> float:
    """How far sides of outlines are off as a whole (slivers too thin to see, blur that differs left from right): px.

    shapes : of each facet, (P,) how much farther than the answer each of its sides may be, besides what it is unlike

    One number for the pair, by restricted likelihood. In one facet, what is common to a side's points cannot be told
    from the facet's own disparity. Over all facets it can, for a facet has more sides than unknowns. It is the rms
    under the likelihood, not its maximum: that is 0 in half of the pairs, for few facets say little.
    """
    if not measured:
        return 0.0
    cost = np.zeros((len(measured), len(SIDE_SIGMAS)))
    for i, (x, shape) in enumerate(zip(measured, shapes, strict=True)):
        for k, s in enumerate(SIDE_SIGMAS):
            A, b, square, volume = with_sides(x, np.hypot(s * shape, x.unlike))
            A = A + 1e-9 * np.eye(3)
            cost[i, k] = square - b @ np.linalg.solve(A, b) + volume + np.linalg.slogdet(A)[1]
    cost = cost.sum(axis=0)
    weight = np.exp(-0.5 * (cost - cost.min())) * np.gradient(SIDE_SIGMAS)
    return float(np.sqrt(weight @ SIDE_SIGMAS**2 / weight.sum()))


def ordinary_rms(measured: list[Measured]) -> float:
    """How far borders lie apart (px, rms) on facets that are what they seem.

    The lower quartile of the pair, for in some pairs most regions are not.
    """
    rms = [x.rms_px for x in measured if x.points]
    return float(np.quantile(rms, 0.25)) if rms else 0.0


def own_side_sigma(x: Measured, sigma_side, ordinary: float):
    """How far this facet's sides may be off as a whole, px: (P,), as sigma_side is, what the pair's may.

    A region that is not one plane, or that ends at a shadow, an isophote of shading or an occluder, has sides that move
    with disparities of their own. The fit spends three unknowns on few sides, so only what the plane leaves over shows
    it. And it errs along whole sides, not point by point: more points do not average it away. So a facet whose borders
    lie farther apart than the pair's do, beyond what chance makes of a dozen points, carries all of that distance as an
    error of each side.
    """
    return np.hypot(sigma_side, x.rms_px) if x.points and x.rms_px > MISFIT * ordinary else sigma_side


def held_by_sides(x: Measured, sigma_side, covariance, step) -> np.ndarray:
    """The covariance (3, 3) of a plane's correction (3,), wider where its sides pull at it by more than they should.

    A side that is not the facet's (what hides the facet ends there, or a shadow) draws the plane to it. The pulls of
    the sides add up to none; their squares, each over what the fit has left of it, are another estimate of the
    covariance, which errors of whole sides are in (HC2: MacKinnon and White 1985).
    """
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(values) @ axes.T
    spread = np.zeros((3, 3))
    for own, pull in _of_each_side(x, sigma_side, step):
        share, way = np.linalg.eigh(root @ own @ root)
        kept = way / np.sqrt(np.maximum(1 - share, 1 - ESSENTIAL)) @ way.T @ (root @ pull)
        spread += np.outer(kept, kept)
    wider, axes = np.linalg.eigh(spread)
    return root @ (axes * np.maximum(wider, 1)) @ axes.T @ root


def unchecked(x: Measured, sigma_side) -> np.ndarray:
    """(3, 3) to add to the covariance of a plane's correction: what comes of sides that no others check.

    A few sides in a hundred are off by many times the pair's sigma: a strip too thin to see, a shadow's edge. Where
    other sides contradict such a one, its pull shows it (`held_by_sides`). Where none could, its variance must hold
    the chance of it: TAIL times as much, by its share in what is known (docs/decisions/facet-sigma.md).
    """
    if len(x.rows) == 0:
        return np.zeros((3, 3))
    covariance = np.linalg.inv(with_sides(x, sigma_side).A)
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(values) @ axes.T
    share = np.zeros(len(x.C))
    parts = np.unique(x.rows[:, PART].astype(int))
    for p, (own, _) in zip(parts, _of_each_side(x, sigma_side, np.zeros(3)), strict=True):
        share[p] = np.clip(np.linalg.eigvalsh(root @ own @ root)[-1], 0, 1)
    wider = np.sqrt(sigma_side**2 + TAIL * share**ALONE * np.maximum(sigma_side**2 - EXACT**2, 0))
    return np.linalg.inv(with_sides(x, wider).A) - covariance


def borders(x: Measured) -> np.ndarray:
    """(n,) of each border point: 0 left of the region, 1 right of it, 2 above, 3 below."""
    nu, below = x.rows[:, NORMAL_U], x.rows[:, V] > x.uv0[1]
    return np.where(nu < -UPRIGHT, 0, np.where(nu > UPRIGHT, 1, 2 + below))


def turned_about_the_rest(x: Measured, plane, doubted) -> np.ndarray:
    """(3, 3) to add to the covariance of a plane's correction: it may be turned about what tells it without one border.

    Two lines give a plane whatever they are, so a facet that rests on what borders it to the left, say, agrees with
    that border even where it belongs to a thing before it. The plane about the other borders is then not known: it may
    be any, and one sigma is the turn up to where it faces the cameras.

    plane : (a, b, c) at x.uv0;  doubted : (4,) bool, which of the borders may be of other things
    """
    added = np.zeros((3, 3))
    if x.texture is not None or len(x.rows) == 0 or not np.any(doubted):
        return added
    border = borders(x)
    J, w = x.rows[:, :3] / [x.size, x.size, 1], x.rows[:, WEIGHT]
    for side in np.flatnonzero(doubted):
        rest = border != side
        if rest.all():
            continue
        values, axes = np.linalg.eigh((J[rest] * w[rest, None]).T @ J[rest] + 1e-9 * np.eye(3))
        if values[0] * AGREE**2 < 1:  # without the border the plane is not known well enough to deny it
            axis = axes[:, 0]
            turn = axis * (plane[:2] @ axis[:2]) * x.size / max(axis[:2] @ axis[:2], 1e-12)
            added += np.outer(turn, turn)
    return added


def in_one_line(x: Measured) -> bool:
    """The border points that tell the plane lie in one line, and nothing else tells it: it may turn about that."""
    if x.texture is not None or len(x.rows) < 3:
        return x.texture is None
    across = np.linalg.eigvalsh(np.cov(x.rows[:, [U, V]].T))[0]
    return bool(across < LINE**2)


def rests_on_holes(x: Measured, hole) -> bool:
    """The plane hangs on the sides of holes, which are of what stands before the region: a lamp before a ceiling.

    hole : (P,) bool of the sides, see contours.in_holes
    """
    of_hole = hole[x.rows[:, PART].astype(int)]
    if not of_hole.any():
        return False
    J, w = x.rows[:, :3] / [x.size, x.size, 1], x.rows[:, WEIGHT]
    least = 1e-9 * np.eye(3) + (x.texture[1] if x.texture is not None else 0)
    unsure = lambda some: np.linalg.eigvalsh((J[some] * w[some, None]).T @ J[some] + least)[0] ** -0.5
    return bool(unsure(~of_hole) > RESTS * unsure(np.ones(len(w), bool)))


def _of_each_side(x: Measured, sigma_side: float, step):
    """(3, 3) what each side knows of the plane, and (3,) how it pulls at the plane after the step."""
    k = np.broadcast_to(sigma_side, x.C.shape) ** 2 / (1 + x.C * sigma_side**2)
    part, w = x.rows[:, PART].astype(int), x.rows[:, WEIGHT]
    J, e = x.rows[:, :3] / [x.size, x.size, 1], x.rows[:, RESIDUAL]
    for p in np.unique(part):
        mine = part == p
        factor = x.C[p] / (w[mine] / x.rows[mine, SIGMA] ** 2).sum()  # as the sums were widened
        own = factor * (J[mine] * w[mine, None]).T @ J[mine] - k[p] * np.outer(x.B[p], x.B[p])
        yield own, factor * J[mine].T @ (w[mine] * e[mine]) - k[p] * x.D[p] * x.B[p] + own @ step


def disagreement(x: Measured, A, b) -> float:
    """How much wider the covariance must be where borders and texture contradict each other beyond chance (95 %): >= 1.

    A, b : of both. With x = -A^-1 b, and the same of the texture alone, the step between them has the covariance
    T^-1 - A^-1.
    """
    if x.texture is None or x.points == 0:
        return 1.0
    plane, T = x.texture
    step = np.linalg.pinv(T) @ (T @ ((x.plane - plane) * [x.size, x.size, 1])) - np.linalg.pinv(A) @ b
    spread = np.linalg.pinv(T) - np.linalg.pinv(A)
    return max(1.0, float(step @ np.linalg.pinv(spread, rcond=1e-6, hermitian=True) @ step) / CHI2_95)
