"""Straight sides of a region's outline that both pictures show: lines in space, and the planes through two of them.

The plane of a region's row ends is a poor start where most of the outline is what hides the region: a floor's rows end
at the furniture. A straight side crosses the rows of both rectified pictures, so a side on the left and one on the
right that face the same way tell the disparity along both, whatever the plane. Every two such lines propose a plane.
That one is best with which most of the outline agrees, less what would lie behind it (see contours).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lib.vision.facets.contours_kernels import Border

AGREE = 0.25  # px along the normal, between a line and a plane that holds it
LOCATED = 0.5  # px: sigma of the points of a side
LEAST_POINTS = 6
LEAST_CROSSING = 0.03  # of its normal along u: what lies along the epipolar lines tells nothing
SAME_WAY = 0.8  # cosine between the normals of two sides that may be one
SHARED_ROWS = 0.3  # of the rows of the shorter one
LINES = 40  # that propose planes, the longest
MOST_SLOPE = 0.95  # of the disparity along u: at 1 the plane goes through the right camera's centre


class Sides(NamedTuple):
    """Straight sides of one outline, rectified px.

    part : (n,) its number;  middle, normal : (n, 2);  rows : (n, 2) first and last v;  points : (n,) of the border
    """

    part: np.ndarray
    middle: np.ndarray
    normal: np.ndarray
    rows: np.ndarray
    points: np.ndarray

    def u(self, k, v):
        """Where side k crosses row v, px."""
        return self.middle[k, 0] - self.normal[k, 1] / self.normal[k, 0] * (v - self.middle[k, 1])


def sides(border: Border, part) -> Sides:
    """Lines through the points of each part that is straight.  part : (n,) of each point, see contours.parts"""
    located = (border.bend <= np.maximum(0.5, 3 * border.sigma)) & (border.sigma < LOCATED)
    found = []
    for k in np.unique(part[located]):
        mine = located & (part == k)
        if mine.sum() < LEAST_POINTS:
            continue
        uv, keep = border.uv[mine], np.ones(mine.sum(), bool)
        for _ in range(3):
            middle = uv[keep].mean(axis=0)
            normal = np.linalg.eigh(np.cov((uv[keep] - middle).T))[1][:, 0]
            off = np.abs((uv - middle) @ normal)
            keep = off < 3 * max(1.4826 * np.median(off[keep]), 0.05)
        normal *= np.sign(normal @ border.normal[mine].mean(axis=0))
        if keep.sum() >= LEAST_POINTS and abs(normal[0]) >= LEAST_CROSSING:
            found.append((k, *middle, *normal, uv[keep, 1].min(), uv[keep, 1].max(), mine.sum()))
    k, middle, normal, rows, points = np.split(np.array(found).reshape(-1, 8), [1, 3, 5, 7], axis=1)
    return Sides(k[:, 0].astype(int), middle, normal, rows, points[:, 0])


@dataclass(frozen=True, eq=False)
class Lines:
    """What the sides of a region may be in space: each side of the left outline with each of the right one that fits.

    uv0 : (2,) where planes (a, b, c) have their c
    part, points : (P,) of each left side;  side : (m,) the left side of each line
    ends : (m, 2, 3) (u - u0, v - v0, 1), and disparity : (m, 2), of the line's ends
    crossing : (m,) how much a px of disparity is along the normal;  length : (m,) points that the rows in common have
    """

    uv0: np.ndarray
    part: np.ndarray
    points: np.ndarray
    side: np.ndarray
    ends: np.ndarray
    disparity: np.ndarray
    crossing: np.ndarray
    length: np.ndarray

    @classmethod
    def of(cls, left: Sides, right: Sides, uv0) -> "Lines | None":
        """None where no side meets another."""
        l, r = (x.ravel() for x in np.mgrid[: len(left.points), : len(right.points)])
        low = np.maximum(left.rows[l, 0], right.rows[r, 0])
        high = np.minimum(left.rows[l, 1], right.rows[r, 1])
        height = lambda s, k: s.rows[k, 1] - s.rows[k, 0]
        fits = (left.normal[l] * right.normal[r]).sum(axis=1) >= SAME_WAY
        fits &= high - low >= np.maximum(1, SHARED_ROWS * np.minimum(height(left, l), height(right, r)))
        v = np.stack([low, high], axis=1)
        u = left.u(l[:, None], v)
        disparity = u - right.u(r[:, None], v)
        fits &= (disparity > 0).all(axis=1)
        if not fits.any():
            return None
        l, r, u, v, disparity = (x[fits] for x in (l, r, u, v, disparity))
        return cls(
            uv0=np.array(uv0),
            part=left.part,
            points=left.points,
            side=l,
            ends=np.stack([u - uv0[0], v - uv0[1], np.ones_like(u)], axis=2),
            disparity=disparity,
            crossing=np.minimum(np.abs(left.normal[l, 0]), np.abs(right.normal[r, 0])),
            length=left.points[l] * np.minimum(1, (v[:, 1] - v[:, 0]) / np.maximum(height(left, l), 1e-9)),
        )

    def score(self, planes) -> np.ndarray:
        """(h,) share of the sides, by points, that agree with each plane (h, 3), less that of those all behind it."""
        return self.score_at(self.at(planes))

    def score_at(self, disparity) -> np.ndarray:
        """The same of each surface that has disparities (h, m, 2) at the lines' ends."""
        agree, behind = self._compared(disparity)
        return (agree - behind) @ self.points / self.points.sum()

    def at(self, planes) -> np.ndarray:
        """(h, m, 2) disparity of planes (h, 3) at the lines' ends."""
        return np.einsum("mej,hj->hme", self.ends, planes)

    def own(self, plane, n: int) -> np.ndarray:
        """(n,) which parts of the outline are sides that agree with a plane (3,)."""
        agree, _ = self._compared(self.at(plane[None]))
        own = np.zeros(n, bool)
        own[self.part[agree[0] > 0]] = True
        return own

    def _compared(self, disparity):
        """(h, P) how well the best line of each side agrees with each surface, and whether they all lie behind it."""
        ahead = disparity - self.disparity  # the surface before the line
        agree = np.clip(1 - ((self.crossing[:, None] * ahead) ** 2).mean(axis=2) / AGREE**2, 0, 1)
        ahead = ahead.mean(axis=2)
        behind = (agree == 0) & (ahead > 2 * AGREE) & (self.crossing * ahead > AGREE)
        best, all_behind = np.zeros((2, len(disparity), len(self.points)))
        all_behind[:, self.side] = 1
        for k, side in enumerate(self.side):
            best[:, side] = np.maximum(best[:, side], agree[:, k])
            all_behind[:, side] *= behind[:, k]
        return best, all_behind

    def planes(self, size: float) -> np.ndarray:
        """(h, 3) planes (a, b, c) that hold two lines of two sides.  size : px, of the region"""
        first = np.argsort(-self.length * np.minimum(self.crossing, 0.3), kind="stable")[:LINES]
        i, j = (first[x] for x in np.triu_indices(len(first), 1))
        apart = self.side[i] != self.side[j]
        both = np.stack([i[apart], j[apart]], axis=1)
        unit = np.array([size, size, 1.0])
        w = np.repeat(self.crossing[both], 2, axis=1)
        J = self.ends[both].reshape(len(both), 4, 3) / unit * w[..., None]
        d = self.disparity[both].reshape(len(both), 4) * w
        A = np.einsum("hki,hkj->hij", J, J) + 1e-6 * np.eye(3)
        x = np.linalg.solve(A, np.einsum("hki,hk->hi", J, d)[..., None])[..., 0]
        coplanar = np.abs(np.einsum("hki,hi->hk", J, x) - d).max(axis=1, initial=0) < 2 * AGREE
        x = x[coplanar] / unit
        return x[x[:, 0] < MOST_SLOPE]

    def starts(self, plane, left: Border, size: float) -> list[np.ndarray]:
        """The plane (3,), and that of two lines with the highest score where it is higher.

        left : the border at which it must lie in front of the cameras;  size : px, of the region
        """
        planes = self.planes(size)
        outline = np.column_stack([left.uv - self.uv0, np.ones(len(left.uv))])
        planes = np.vstack([plane, planes[(outline @ planes.T > 0).all(axis=0)]])
        best = int(self.score(planes).argmax())
        return [plane] if best == 0 else [plane, planes[best]]


def lines(left: Border, right: Border, part_left, part_right, uv0) -> Lines | None:
    """Lines of the sides of both outlines; None where no two are one."""
    return Lines.of(sides(left, part_left), sides(right, part_right), uv0)
