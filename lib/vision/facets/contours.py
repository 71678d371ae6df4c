"""Planes from borders: where a region's outline lies in both pictures says what its disparity is there."""

from dataclasses import dataclass, replace

import numpy as np

from lib.vision.facets import contours_kernels as kernels
from lib.vision.facets.borders_kernels import SURE
from lib.vision.facets.contours_kernels import NORMAL_U, PART, RESIDUAL, SIGMA, WEIGHT, Border

AGREE = 0.25  # px: a part of the border that lies so far from where the plane puts it is not the facet's own
PARTS = 12  # parts tried as the ones that are
LEAST_POINTS = 12  # of the border or of the texture
BEYOND_PX = 3.0  # from a side, where it is asked what lies there: sides are straight to 1.5 px


def parts(labels, label: int, q) -> np.ndarray:
    """(n,) index of the side of the region's outline, outer or of a hole, on which each border point q (n, 2) lies.

    Sides are straight to 1.5 px.
    """
    rings = _rings(labels, label)
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


def in_holes(labels, label: int) -> np.ndarray:
    """(P,) bool of the sides that `parts` counts: of what is enclosed, and so most likely stands before the region.

    Enclosed by the region, or by it and one edge of the picture, which cuts many a lamp under a ceiling in two.
    """
    import cv2

    n, beyond = cv2.connectedComponents((labels != label).astype(np.uint8), connectivity=4)
    edges = [np.setdiff1d(edge, 0) for edge in (beyond[0], beyond[-1], beyond[:, 0], beyond[:, -1])]
    touched = np.bincount(np.concatenate(edges), minlength=n)  # edges of the picture that each piece touches
    touched[beyond[[0, 0, -1, -1], [0, -1, 0, -1]]] = len(edges)
    found = []
    for ring in _rings(labels, label):
        along = np.roll(ring, -1, 0) - ring
        aside = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True).clip(1)
        either = ring + along / 2 + BEYOND_PX * np.array([[[-1]], [[1]]]) * aside  # one of the two lies outside
        x, y = np.moveaxis(np.rint(either).astype(int), 2, 0)
        there = beyond[y.clip(0, labels.shape[0] - 1), x.clip(0, labels.shape[1] - 1)].max(axis=0)
        found.append((there > 0) & (touched[there] < 2))
    return np.concatenate(found)


def _rings(labels, label):
    """[(k, 2) corners, px] of the region's outline and of its holes."""
    import cv2

    y, x = np.nonzero(labels == label)
    y0, x0 = y.min() - 1, x.min() - 1
    mask = np.zeros((y.max() - y0 + 2, x.max() - x0 + 2), np.uint8)
    mask[y - y0, x - x0] = 1
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    return [cv2.approxPolyDP(c, 1.5, True)[:, 0] + [x0, y0] for c in contours]


def _own_parts(rows, n_parts, size):
    """Which parts of the border are the facet's own, (n_parts,) bool, and the step (a, b, c) they ask for; or None.

    A border belongs to the nearer of the two surfaces that meet there. What hides part of the facet lies in front of
    it, so each part either agrees with the facet's plane or has *more* disparity; no border can lie behind. Every two
    and three parts propose a plane. That one wins with which most of the border agrees, less what would lie behind:
    all of the border, not only what crosses the epipolar lines, or the upright sides of what hides a floor outvote it.
    """
    strong = rows[:, SIGMA] < 2 * SURE
    part = rows[:, PART].astype(int)
    J = rows[:, :3] * rows[:, SIGMA : SIGMA + 1] / [size, size, 1]
    r, nu = rows[:, RESIDUAL] * rows[:, SIGMA], rows[:, NORMAL_U]
    weight = strong.astype(float)
    sums = lambda x: np.bincount(part, weight * x, n_parts)
    n = sums(1.0)
    info = sums(nu**2)
    A = np.array([[sums(J[:, p] * J[:, q]) for p in range(3)] for q in range(3)]).transpose(2, 0, 1)
    b, c = np.stack([sums(J[:, p] * r) for p in range(3)], axis=1), sums(r * r)
    mean = np.stack([sums(nu * J[:, p]) for p in range(3)], axis=1), sums(nu * r)
    noise = sums(rows[:, SIGMA] ** 2)
    top = [p for p in np.argsort(-info, kind="stable")[:PARTS] if info[p] >= 2]
    sets = [(p, q, s) for i, p in enumerate(top) for j, q in enumerate(top[i:], i) for s in top[j:]]
    if not sets:
        return None
    some = np.array(sets)
    member = np.zeros((len(sets), n_parts))
    np.put_along_axis(member, some, 1.0, axis=1)
    prior = np.diag([0.02, 0.02, 1e-6])  # px^-2: what few parts do not say stays near
    A_of, b_of = np.einsum("hp,pij->hij", member, A) + prior, np.einsum("hp,pi->hi", member, b)
    x = -np.linalg.solve(A_of, b_of[..., None])[..., 0]
    square = np.einsum("hi,pij,hj->hp", x, A, x) + 2 * x @ b.T + c
    with np.errstate(invalid="ignore", divide="ignore"):
        rms2 = np.where(n > 0, np.maximum(square - noise, 0) / n, np.inf)
        ahead = np.where(info > 0, (x @ mean[0].T + mean[1]) / info, 0)  # disparity beyond the plane's
    agree = np.maximum(1 - rms2 / AGREE**2, 0)
    score = (n * agree).sum(axis=1) - (n * ((agree == 0) & (ahead < -2 * AGREE))).sum(axis=1)
    h = int(score.argmax())
    return agree[h] > 0, x[h] / [size, size, 1]


@dataclass(frozen=True, eq=False)
class Measured:
    """What a pair of regions says of its plane: sums of normal equations by side of the outline, at the plane.

    plane : (a, b, c) of the disparity at uv0, (2,) rectified px;  size : px, of the region
    A : (3, 3), b : (3,)      over all points, in units of (size, size, 1), divided by scale^2
    B : (P, 3), C, D : (P,)   the same of an offset of each side, px: with the plane, with itself, with the residual
    square                    sum of the squared residuals
    points, rms_px            number of border points, how far borders lie apart (weighted)
    rows                      (points, kernels.COLUMNS)
    texture                   (plane, A) of the intensities, or None
    planar                    dense stereo shows one plane all over the region
    unlike : (P,)             px by which each side may be off as a whole, where the photographs differ: profiles.py
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
    texture: tuple | None = None
    planar: bool = False
    unlike: np.ndarray | float = 0.0

    @classmethod
    def nothing(cls, plane, uv0, size: float):
        """Of a region whose borders say nothing."""
        return cls(
            plane=plane,
            uv0=np.array(uv0),
            size=size,
            A=np.zeros((3, 3)),
            b=np.zeros(3),
            B=np.zeros((1, 3)),
            C=np.zeros(1),
            D=np.zeros(1),
            square=0.0,
            points=0,
            rms_px=0.0,
            rows=np.empty((0, kernels.COLUMNS)),
        )

    def widened(self, factor: float):
        """The borders' variances times `factor`, and the texture added."""
        A, b = self.A / factor, self.b / factor
        if self.texture is not None:
            plane, information = self.texture
            A, b = A + information, b + information @ ((self.plane - plane) * [self.size, self.size, 1])
        return replace(
            self, A=A, b=b, B=self.B / factor, C=self.C / factor, D=self.D / factor, square=self.square / factor
        )


def away(shape, pixels, q, px: int) -> np.ndarray:
    """Those of the flat pixels that are more than `px` from all q (n, 2)."""
    import cv2

    near = np.zeros(shape, np.uint8)
    i = np.round(q).astype(int)
    near[i[:, 1].clip(0, shape[0] - 1), i[:, 0].clip(0, shape[1] - 1)] = 1
    near = cv2.dilate(near, np.ones((2 * px + 1, 2 * px + 1), np.uint8))
    return pixels[near.ravel()[pixels] == 0]


def contour_plane(plane, uv0, size, left: Border, right: Border, part, iterations: int, own=None) -> Measured | None:
    """From the borders alone; None where they do not meet.

    plane : (a, b, c) at uv0 to start from;  part : of the left points, see `parts`;  iterations : at most, of each fit
    own : (parts,) which of them are the facet's; found where None
    """
    rows = np.empty((len(left.uv), kernels.COLUMNS))
    n_parts = int(part.max()) + 1
    if own is None:
        plane, n = kernels.fit_contours(plane, uv0, size, 4.0, iterations, left, part, right, rows)
    for reach in (6.0, 3.0, 1.5) if own is None else ():
        n = kernels.contour_rows(plane, uv0, reach, 1.0, left, part, right, rows)
        own = _own_parts(rows[:n], n_parts, size)
        if own is None:
            return None
        own, step = own
        plane = plane + step
    keep = own[part]
    left, part = Border(*(np.ascontiguousarray(x[keep]) for x in left)), part[keep]
    plane, n = kernels.fit_contours(plane, uv0, size, 1.0, iterations, left, part, right, rows)
    rows = rows[:n][rows[:n, WEIGHT] > 0.1]
    return measured_at(plane, uv0, size, rows, n_parts) if len(rows) >= LEAST_POINTS else None


def measured_at(plane, uv0, size, rows, n_parts) -> Measured:
    """The normal equations of a table of border points (n, kernels.COLUMNS) at a plane."""
    J, e, w = rows[:, :3] / [size, size, 1], rows[:, RESIDUAL], rows[:, WEIGHT]
    part, one = rows[:, PART].astype(int), 1 / rows[:, SIGMA]
    sums = lambda x: np.bincount(part, w * x, n_parts)
    return Measured(
        plane=plane,
        uv0=np.array(uv0),
        size=size,
        A=(J * w[:, None]).T @ J,
        b=J.T @ (w * e),
        B=np.stack([sums(J[:, p] * one) for p in range(3)], axis=1),
        C=sums(one * one),
        D=sums(one * e),
        square=float((w * e * e).sum()),
        points=len(rows),
        rms_px=float(np.sqrt((w * (rows[:, RESIDUAL] * rows[:, SIGMA]) ** 2).sum() / w.sum())),
        rows=rows,
    )


def borders_apart(plane, uv0, left: Border, right: Border) -> float:
    """How far the right border lies from the left one that the plane moves: px along its normal, the points' median.

    Within 4 px: what is farther is another border. nan where no two points meet.
    """
    rows, part = np.empty((len(left.uv), kernels.COLUMNS)), np.zeros(len(left.uv), np.int64)
    n = kernels.contour_rows(plane, uv0, 4.0, 1.0, left, part, right, rows)
    return float(np.median(np.abs(rows[:n, RESIDUAL] * rows[:n, SIGMA]))) if n else np.nan
