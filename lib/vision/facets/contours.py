"""Planes from borders: where a region's outline lies in both pictures says what its disparity is there."""

from dataclasses import dataclass, replace

import numpy as np

from lib.vision.facets import borders_kernels as kernels
from lib.vision.facets import contours_kernels


def parts(labels, label, q):
    """For each border point (n, 2) of a region the side of its outline, outer or of a hole, on which it lies: straight to 1.5 px."""
    import cv2

    y, x = np.nonzero(labels == label)
    y0, x0 = y.min() - 1, x.min() - 1
    mask = np.zeros((y.max() - y0 + 2, x.max() - x0 + 2), np.uint8)
    mask[y - y0, x - x0] = 1
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    rings = [cv2.approxPolyDP(c, 1.5, True)[:, 0] + [x0, y0] for c in contours]
    start = np.concatenate(rings).astype(float)
    end = np.concatenate([np.roll(r, -1, 0) for r in rings]).astype(float)
    along = end - start
    length2 = np.maximum((along**2).sum(axis=1), 1e-12)
    part = np.empty(len(q), np.int64)
    for first in range(0, len(q), 2000):
        to = q[first : first + 2000, None] - start
        t = np.clip((to * along).sum(axis=2) / length2, 0, 1)
        part[first : first + 2000] = ((to - t[..., None] * along) ** 2).sum(axis=2).argmin(axis=1)
    return part


AGREE = 0.35  # px: a part of the border that lies so far from where the plane puts it is not the facet's own
PARTS = 12  # parts tried as the ones that are


def _own_parts(rows, n_parts, size):
    """Which parts of the border are the facet's own, and the step (a, b, c) they ask for.

    A border belongs to the nearer of the two surfaces that meet there. What hides part of the facet lies in front of it, so each part
    either agrees with the facet's plane or has *more* disparity; no border can lie behind. Every two and three parts propose a plane; the
    one wins with which most of the border, as seen across the epipolar lines, agrees, less what would lie behind.
    """
    strong = rows[:, 7] < kernels.WEAK
    part = rows[:, 6].astype(int)
    J = rows[:, :3] * rows[:, 7:8] / [size, size, 1]
    r, nu = rows[:, 3] * rows[:, 7], rows[:, 5]
    weight = strong.astype(float)
    sums = lambda x: np.bincount(part, weight * x, n_parts)
    n = sums(1.0)
    info = sums(nu**2)
    A = np.array([[sums(J[:, p] * J[:, q]) for p in range(3)] for q in range(3)]).transpose(2, 0, 1)
    b, c = np.stack([sums(J[:, p] * r) for p in range(3)], axis=1), sums(r * r)
    mean = np.stack([sums(nu * J[:, p]) for p in range(3)], axis=1), sums(nu * r)
    noise = sums(rows[:, 7] ** 2)
    top = [p for p in np.argsort(-info, kind="stable")[:PARTS] if info[p] >= 2]
    sets = [(p, q, s) for i, p in enumerate(top) for j, q in enumerate(top[i:], i) for s in top[j:]]
    if not sets:
        return None
    some = np.array(sets)
    member = np.zeros((len(sets), n_parts))
    np.put_along_axis(member, some, 1.0, axis=1)
    prior = np.diag([0.02, 0.02, 1e-6]) * 1.0  # px^-2: what few parts do not say stays near
    x = -np.linalg.solve(np.einsum("hp,pij->hij", member, A) + prior, np.einsum("hp,pi->hi", member, b)[..., None])[
        ..., 0
    ]
    square = np.einsum("hi,pij,hj->hp", x, A, x) + 2 * x @ b.T + c
    with np.errstate(invalid="ignore", divide="ignore"):
        rms2 = np.where(n > 0, np.maximum(square - noise, 0) / n, np.inf)
        ahead = np.where(info > 0, (x @ mean[0].T + mean[1]) / info, 0)  # disparity beyond the plane's
    agree = np.maximum(1 - rms2 / AGREE**2, 0)
    score = (info * agree).sum(axis=1) - (info * ((agree == 0) & (ahead < -2 * AGREE))).sum(axis=1)
    h = int(score.argmax())
    return agree[h] > 0, x[h] / [size, size, 1], score[h] / max(info.sum(), 1e-12)


LEAST_POINTS = 12  # of the border or of the texture


@dataclass(frozen=True, eq=False)
class Measured:
    """What the borders of a pair say: sums of normal equations by side of the outline, at a plane (a, b, c at uv0).

    A : (3, 3), b : (3,)                    over all points, in units of (size, size, 1), divided by scale^2
    B : (P, 3), C, D : (P,)                 the same of a common offset of each side, px: with the plane, with itself, with the residual
    square : of the residuals               points : their number          rms_px : weighted
    """

    plane: np.ndarray
    uv0: np.ndarray
    size: float
    A: np.ndarray
    b: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    square: float
    points: int
    rms_px: float
    rows: np.ndarray
    texture: tuple = None  # (plane, A) of the intensities, or None

    def widened(self, factor):
        """The borders' variances times `factor`, and the texture added."""
        A, b = self.A / factor, self.b / factor
        if self.texture is not None:
            A, b = (
                A + self.texture[1],
                b + self.texture[1] @ ((self.plane - self.texture[0]) * [self.size, self.size, 1]),
            )
        return replace(
            self, A=A, b=b, B=self.B / factor, C=self.C / factor, D=self.D / factor, square=self.square / factor
        )


def away(shape, pixels, q):
    """Those of the pixels (indices) that are at least 4 px from all q (n, 2)."""
    import cv2

    near = np.zeros(shape, np.uint8)
    i = np.round(q).astype(int)
    near[i[:, 1].clip(0, shape[0] - 1), i[:, 0].clip(0, shape[1] - 1)] = 1
    near = cv2.dilate(near, np.ones((7, 7), np.uint8))
    return pixels[near.ravel()[pixels] == 0]


def contour_plane(plane, uv0, size, mine, other, part, reach, iterations):
    """_Measured from the borders alone; None where they do not meet."""
    rows = np.empty((len(mine[0]), 10))
    n_parts = int(part.max()) + 1
    plane, n = contours_kernels.fit_contours(plane, *uv0, size, reach, iterations, (*mine, part), other, rows)
    for reach in (6.0, 3.0, 1.5):
        n = contours_kernels.contour_rows(plane, *uv0, reach, 1.0, *mine, part, *other, rows)
        own = _own_parts(rows[:n], n_parts, size)
        if own is None:
            return None
        plane = plane + own[1]
    keep = own[0][part]
    mine, part = tuple(np.ascontiguousarray(x[keep]) for x in mine), part[keep]
    plane, n = contours_kernels.fit_contours(plane, *uv0, size, 1.0, iterations, (*mine, part), other, rows)
    rows = rows[:n][rows[:n, 4] > 0.1]
    if len(rows) < LEAST_POINTS:
        return None
    J, e, w = rows[:, :3] / [size, size, 1], rows[:, 3], rows[:, 4]
    part, one = rows[:, 6].astype(int), 1 / rows[:, 7]
    sums = lambda x: np.bincount(part, w * x, n_parts)
    return Measured(
        plane,
        np.array(uv0),
        size,
        (J * w[:, None]).T @ J,
        J.T @ (w * e),
        np.stack([sums(J[:, p] * one) for p in range(3)], axis=1),
        sums(one * one),
        sums(one * e),
        float((w * e * e).sum()),
        len(rows),
        float(np.sqrt((w * (rows[:, 3] * rows[:, 7]) ** 2).sum() / w.sum())),
        rows,
    )
