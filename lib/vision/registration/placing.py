"""The last part of a registration: edges placed at sub-pixel, the fit to them, and its covariance."""

from dataclasses import dataclass

import numpy as np

from lib.vision.refinement.edges import STEP_PX, locate
from lib.vision.registration.pieces import CLIPPED_BLUR_PX

SIGMA_PX = 1.0  # samples placed worse than this are left out
ALONE_PX = 6.0  # what has another edge nearer than this is pulled by it
LEAST_PX = 0.05  # scatter of edges, at least


@dataclass(frozen=True, eq=False)
class Placed:
    """Samples that the photograph has.

    offset : (n,) px along the normals        weight : (n,)        chosen : (n,) of samples        coarse : (n,) bool
    """

    offset: np.ndarray
    weight: np.ndarray
    chosen: np.ndarray
    coarse: np.ndarray


def place(level, samples, q, pieces, x) -> Placed:
    """Where the photograph has the samples that are now at q (N, 2) px.

    pieces : Pieces of the samples        x : (M,) px, where the pieces are now

    Beside what is clipped the nearest peak of the piece has to do.
    """
    offset, sigma, strength = locate(level, q, samples.normal, samples.clear)
    gap = np.where(pieces.share > 0, pieces.offset - x[:, None], np.inf)
    nearest = np.take_along_axis(gap, np.abs(gap).argmin(axis=1)[:, None], axis=1)[:, 0]
    coarse = (pieces.clipped & (np.abs(nearest) < 2))[samples.piece]
    offset = np.where(coarse, nearest[samples.piece], offset)
    sigma = np.where(coarse, CLIPPED_BLUR_PX, sigma)
    strength = np.where(coarse, 1.0, strength)
    chosen = np.flatnonzero((strength > 0) & (sigma < SIGMA_PX))
    # Every line has the weight of at most 100 px: long ones are no surer than the model.
    edge = samples.edge[chosen]
    weight = STEP_PX**2 / (STEP_PX**2 + sigma[chosen] ** 2) * np.clip(samples.clear[chosen] / ALONE_PX, 0, 1) ** 2
    count = np.bincount(edge, weight, minlength=int(edge.max(initial=0)) + 1)
    weight = weight / np.maximum(1, count[edge] / 33)
    return Placed(offset[chosen], weight, chosen, coarse[chosen])


def solve(J, r, weight, prior, iterations=20):
    """(numbers (n,), normal matrix, (n,) the prior's part of it, robust weights): Geman-McClure about J numbers = r.

    prior : (n,) sigma of the numbers
    """
    numbers = np.zeros(J.shape[1])
    for _ in range(iterations):
        e = r - J @ numbers
        width = 3 * max(1.4826 * float(np.median(np.abs(e))), LEAST_PX)
        w = weight / (1 + (e / width) ** 2) ** 2
        ridge = (width / 3 / prior) ** 2
        H = (w[:, None] * J).T @ J + np.diag(ridge)
        step = np.linalg.solve(H, (w * e) @ J)
        numbers = numbers + step
        if np.abs(J @ step).max(initial=0) < 1e-3:
            break
    return numbers, H, ridge, w


def covariance(J, e, w, H, edge, ridge, prior):
    """(n, n): errors along one straight line go together, whatever their cause, so lines are what is counted.

    J : (N, n); e : (N,) px residuals; w : (N,) robust weights; H : normal matrix; edge : (N,) the line of each
    ridge : (n,), what the prior adds to H        prior : (n,) its sigma

    Three parts. The jackknife over lines, as the refinement of poses has it: it knows outliers and long lines. The
    scatter of all lines at each: an object has few lines, and two lines always agree with two numbers. And the prior's:
    what only it holds is as uncertain as it says.
    """
    unit = 1 / np.sqrt(np.diag(H))
    inverse = np.linalg.inv(H * np.outer(unit, unit)) * np.outer(unit, unit)
    moves, common, offsets = [], [], []
    for line in np.unique(edge):
        mine = edge == line
        A, g = (w[mine, None] * J[mine]).T @ J[mine], (w[mine] * e[mine]) @ J[mine]
        moves.append(unit * np.linalg.lstsq((H - A) * np.outer(unit, unit), g * unit, rcond=1e-6)[0])
        common.append(inverse @ (w[mine] @ J[mine]))
        offsets.append(np.average(e[mine], weights=w[mine] + 1e-12))
    moves, common = np.array(moves), np.array(common)
    scatter = max(1.4826 * float(np.median(np.abs(offsets))), LEAST_PX)
    held = inverse * (ridge * prior)
    return moves.T @ moves + scatter**2 * common.T @ common + held @ held.T
