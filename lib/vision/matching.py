"""§2.2 Region matching: which region of the right photograph shows the same facet as a region of the left one.

    pair = stereo(camera_left, camera_right)
    matches = match(pair, labels_left, labels_right, values_left, values_right)

Global features and the epipolar constraint, as in the paper. Everything is measured in *rectified* coordinates, where
the two cameras look the same way, x along the baseline. There an epipolar line is a row, v is the same in both
pictures, and the disparity of a planar facet is a linear function of the place,

    u_left - u_right = a u + b v + c      (pixels of f_px; (a, b, c / f_px) = baseline * m, with m . x = 1 on the plane)

So the foreshortening between the two views is exact, not approximated. The rows that a region spans agree, for its top
and bottom tangents are epipolar lines. The ends of its rows give (a, b, c) by a robust fit, and with it left covers
right.
"""

from dataclasses import dataclass

import numpy as np

from lib.core.stage import BadInput
from lib.given import cameras, image
from lib.given.cameras import Camera
from lib.given.view import size_problem
from lib.vision import matching_kernels as kernels
from lib.vision.matching_groups import contested, weights
from lib.vision.matching_kernels import RegionArrays, ViewArrays

SAME_CENTRE = 1e-9  # data/SCENE.md, section 2: cameras nearer than this have no baseline
LEAST_MATCHES = 8  # that tell how differently the two photographs are exposed
LEAST_GAIN = 0.02  # a difference of exposure worth matching again
STEEP = 0.2  # cosine: directions nearer to the baseline's than this cannot be rectified


@dataclass(frozen=True, eq=False)
class Stereo:
    """Two pinhole cameras and the frame in which they look the same way.

    R_rect_left, R_rect_right : (3, 3)      camera axes to rectified axes: x towards the right camera's centre
    t_right_left : (3,)                     p_right = R_right_left p_left + t_right_left; m or baselines
    baseline : float > 0                    the cameras' distance, in the unit of their extrinsics
    f_px : float                            the focal length of rectified pixels
    """

    left: Camera
    right: Camera
    R_rect_left: np.ndarray
    R_rect_right: np.ndarray
    R_right_left: np.ndarray
    t_right_left: np.ndarray
    baseline: float
    f_px: float

    def rectified(self, q, side: str) -> np.ndarray:
        """(N, 2) px of the photograph -> (N, 2) px rectified; nan where the direction is too near the baseline's.

        side : "left" or "right"
        """
        camera, R = (self.left, self.R_rect_left) if side == "left" else (self.right, self.R_rect_right)
        v = camera.directions(q) @ R.T
        z = np.where(v[..., 2] > STEEP * np.linalg.norm(v, axis=-1), v[..., 2], np.nan)
        return self.f_px * v[..., :2] / z[..., None]

    def photograph(self, uv, side: str) -> np.ndarray:
        """(..., 2) px rectified -> (..., 2) px of the photograph: the inverse of `rectified`."""
        camera, R = (self.left, self.R_rect_left) if side == "left" else (self.right, self.R_rect_right)
        p = np.concatenate([uv / self.f_px, np.ones((*uv.shape[:-1], 1))], axis=-1) @ R @ camera.K.T
        return p[..., :2] / p[..., 2:]


def stereo(left: Camera, right: Camera) -> Stereo:
    """The pair's geometry. ValueError where the two cameras have the same centre: nothing can be known of depth."""
    T = right.T_cam_world @ np.linalg.inv(left.T_cam_world)
    R, t = T[:3, :3], T[:3, 3]
    to_right = left.T_cam_world[:3, :3] @ (right.centre - left.centre)
    baseline = float(np.linalg.norm(to_right))
    if not baseline > SAME_CENTRE:
        raise ValueError("the two cameras have the same centre")
    x = to_right / baseline
    ahead = np.array([0, 0, 1.0]) + R[2]  # the mean of the two optical axes, left frame
    z = ahead - (ahead @ x) * x
    if np.linalg.norm(z) < 1e-6:  # along the baseline: any direction across it
        z = np.cross(x, np.array([0, 1.0, 0]))
    z /= np.linalg.norm(z)
    R_rect_left = np.stack([x, np.cross(z, x), z])
    f_px = float(np.sqrt(np.abs([left.K[0, 0] * left.K[1, 1], right.K[0, 0] * right.K[1, 1]])).mean())
    return Stereo(left, right, R_rect_left, R_rect_left @ R.T, R, t, baseline, f_px)


# -- what a region is


def views(pair: Stereo, labels, values) -> tuple[ViewArrays, ViewArrays]:
    """The left and the right picture as the kernels take them.

    labels : two (H, W) int, 0 = nothing;  values : two (H, W, C) in [0, 1], both of C channels
    """
    return _view(pair, "left", labels[0], values[0]), _view(pair, "right", labels[1], values[1])


def _view(pair, side, labels, values):
    camera, R = (pair.left, pair.R_rect_left) if side == "left" else (pair.right, pair.R_rect_right)
    uv = pair.rectified(camera.pixels(), side)
    u, v = np.ascontiguousarray(uv[..., 0]), np.ascontiguousarray(uv[..., 1])
    return ViewArrays(u, v, labels, values, np.ascontiguousarray(R), camera.K)


def regions(view: ViewArrays) -> RegionArrays:
    """The regions of one picture, measured in the rectified frame."""
    labels, values = view.labels, view.values
    n = int(labels.max(initial=0))
    flat = labels.ravel()
    order = np.argsort(flat, kind="stable")
    first = np.searchsorted(flat[order], np.arange(1, n + 2))
    pixels = np.diff(first)
    mean_of = lambda x: np.bincount(flat, x.ravel(), n + 1)[1:]
    count = np.maximum(pixels, 1)[:, None]
    mean = np.stack([mean_of(values[..., c]) for c in range(values.shape[2])], axis=1) / count
    centre = np.stack([mean_of(view.u), mean_of(view.v)], axis=1) / count
    low, high = _row_range(flat, view.v.ravel(), n)
    row_start = np.concatenate([[0], np.cumsum(high - low + 1)])
    ends = np.full((row_start[-1], 2), np.nan)
    whole = np.zeros(ends.shape, bool)
    kernels.rows(labels, view.u, view.v, low, row_start, ends, whole)
    cut = np.zeros(n + 1, bool)
    for border in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        cut[border] = True
    return RegionArrays(pixels, mean, centre, low, high, cut[1:], row_start, ends, whole, order, first)


def _row_range(flat, v, n):
    """(N,) first and last rectified row of each label; the last lies before the first where no pixel is known."""
    low, high = np.full(n + 1, np.iinfo(np.int64).max), np.full(n + 1, np.iinfo(np.int64).min)
    known = np.isfinite(v)
    row = np.floor(v[known]).astype(np.int64)
    np.minimum.at(low, flat[known], row)
    np.maximum.at(high, flat[known], row)
    low, high = low[1:], high[1:]
    return low, np.where(high < low, low - 1, high)


def outline_plane(left: RegionArrays, right: RegionArrays, i: int, j: int):
    """The plane of the row ends of region i (index, left) and region j: whole-pixel accuracy.

    Returns (a, b, c) of the disparity, the share of the row ends that agree with it, and their number.
    """
    rows = min(left.high[i], right.high[j]) - max(left.low[i], right.low[j]) + 1
    plane, agree, n = kernels.outline_plane(left, right, i, j, np.empty((2 * max(rows, 1), 3)))
    return np.array(plane), agree, n


def another_plane(left: RegionArrays, right: RegionArrays, i: int, j: int, plane) -> float:
    """The share of the row ends that are off the plane (a, b, c), agree with one other, and lie on no one line."""
    rows = min(left.high[i], right.high[j]) - max(left.low[i], right.low[j]) + 1
    return kernels.another_plane(left, right, i, j, tuple(map(float, plane)), np.empty((2 * max(rows, 1), 3)))


def mutual_overlap(regions, views, i: int, j: int, plane, f_px: float) -> float:
    """Intersection over union of left region i and right region j, each taken into the other picture by the plane.

    regions, views : of the left and of the right picture
    plane : (a, b, c) of the disparity
    """
    plane = tuple(map(float, plane))
    there, _, _ = kernels.overlap(regions[0], views[1], views[0], i, j, plane, f_px, 1)
    back, _, _ = kernels.overlap(regions[1], views[0], views[1], j, i, plane, f_px, -1)
    return kernels.intersection_over_union(there, back) if there * back > 0 else 0.0


# -- pairs of regions


@dataclass(frozen=True, eq=False)
class Matches:
    """left, right : (M,) labels, one to one, best first
    similarity : (M,) in [0, 1]
    plane : (M, 3)  m of the plane that took left onto right, left frame, m . x = 1 (whole-pixel accuracy)
    refused_left, refused_right : {reason: labels} of the regions without a partner
    """

    left: np.ndarray
    right: np.ndarray
    similarity: np.ndarray
    plane: np.ndarray
    refused_left: dict[str, list[int]]
    refused_right: dict[str, list[int]]


def match(
    pair: Stereo,
    labels_left,
    labels_right,
    values_left,
    values_right,
    *,
    similarity: float = 0.6,
    margin: float = 0.9,
    smallest: int = 40,
    colour: float = 0.1,
) -> Matches:
    """One to one, strict, best first.

    Two regions match when each is the other's best, they are alike by at least `similarity`, and the next best is below
    `margin` of that. What is best is judged together with the neighbours (matching_groups): a square of a chessboard is
    like every second one, but its neighbours' disparities go on only with one of them.

    labels_* : (H, W) int, from 1;  values_* : (H, W, C), display-referred in [0, 1], both of C channels
    smallest : px, regions of fewer pixels say too little
    colour : the largest difference of the means of a channel
    """
    left_view, right_view = views(pair, (labels_left, labels_right), (values_left, values_right))
    l, r = regions(left_view), regions(right_view)
    by_row = np.flatnonzero(r.pixels >= smallest)
    by_row = by_row[np.argsort(r.low[by_row], kind="stable")]

    def chosen(gain):
        """Candidates with the left photograph's values times gain (C,), and which of them are matches."""
        lit, seen = l._replace(mean=l.mean * gain), left_view._replace(values=left_view.values * gain)
        found = kernels.candidates(lit, r, seen, right_view, by_row, pair.f_px, smallest, colour)
        return found, _choice(pair, found, (labels_left, labels_right), (lit, r), similarity, margin, colour)

    found, best = chosen(np.ones(values_left.shape[2]))
    gain = _gain(l.mean[found.left[best]], r.mean[found.right[best]])
    if np.abs(gain - 1).max() > LEAST_GAIN:
        found, best = chosen(gain)
    left, right, s = found.left[best] + 1, found.right[best] + 1, found.similarity[best]
    m_rect = found.plane.reshape(-1, 3)[best] / pair.baseline / np.array([1, 1, pair.f_px])
    return Matches(
        left=left,
        right=right,
        similarity=s,
        plane=m_rect @ pair.R_rect_left,
        refused_left=_refused(found.left_reason, left, l.pixels),
        refused_right=_refused(found.right_reason, right, r.pixels),
    )


def _choice(pair, found, labels, of, similarity, margin, colour):
    """Which candidates are matches, best first. Sets the reasons of those that are none.  labels, of : left, right"""
    l, r = of
    i, j, s = found.left, found.right, found.similarity
    plane = found.plane.reshape(-1, 3)
    w = np.where(s >= similarity, weights(labels, i, j, np.where(s >= similarity, s, 0), plane, l.centre), s)
    best = np.lexsort((j, i, -w))
    at_l, second_l = _first_and_second(i, w, best, len(l.pixels))
    at_r, second_r = _first_and_second(j, w, best, len(r.pixels))
    k = np.arange(len(i))
    alike, mutual = s >= similarity, (at_l[i] == k) & (at_r[j] == k)
    clear = np.maximum(second_l[i], second_r[j]) <= margin * w
    for reason, at in ((found.left_reason, at_l), (found.right_reason, at_r)):
        for x in np.flatnonzero(at >= 0):
            reason[x] = (
                kernels.ALIKE if not alike[at[x]] else kernels.MUTUAL if not mutual[at[x]] else kernels.AMBIGUOUS
            )
    keep = np.flatnonzero(alike & mutual & clear)
    i_kept, j_kept, plane_kept = i[keep], j[keep], plane[keep]
    alone = weights(labels, i_kept, j_kept, s[keep], plane_kept, l.centre)  # without what lost against others
    keep = keep[~contested(pair, labels, of, alone, i_kept, j_kept, plane_kept, colour)]
    return keep[np.lexsort((j[keep], i[keep], -s[keep]))]


def _gain(left, right):
    """(C,) of the right photograph over the left one, from the mean colours (M, C) of matches; 1 where they are few.

    The weighted median of the ratios: two exposures of one gamma differ by a factor, and a wrong match has any.
    """
    if len(left) < LEAST_MATCHES:
        return np.ones(left.shape[1])
    gain = np.ones(left.shape[1])
    for c in range(len(gain)):
        ratio = right[:, c] / np.maximum(left[:, c], 1e-6)
        order = np.argsort(ratio, kind="stable")
        total = np.cumsum(left[order, c])
        gain[c] = ratio[order[np.searchsorted(total, total[-1] / 2)]]
    return gain


def _first_and_second(index, weight, best, n):
    """Of each of n regions: its best candidate or -1, and the weight of its second or 0.  best : order of candidates"""
    second, at = np.zeros(n), np.full(n, -1)
    for k in best:
        x = index[k]
        if at[x] < 0:
            at[x] = k
        elif second[x] == 0:
            second[x] = weight[k]
    return at, second


def _refused(reason, matched, pixels):
    """{reason: labels} of the regions that are there and have no partner."""
    reason = np.where(pixels > 0, reason, -1)
    reason[matched - 1] = -1
    return {name: (np.flatnonzero(reason == k) + 1).tolist() for k, name in enumerate(kernels.REASONS) if k in reason}


# -- from files


def photographs(left: image.Photograph, right: image.Photograph) -> list[np.ndarray]:
    """(H, W, C) of two photographs as they are compared: display-referred in [0, 1], of equally many channels."""
    values = [photograph.display for photograph in (left, right)]
    if values[0].shape[2] != values[1].shape[2]:
        values = [v.mean(axis=2, keepdims=True) for v in values]
    return [np.ascontiguousarray(v) for v in values]


def read_pair(camera_paths, photograph_paths, label_paths):
    """(Stereo, two Photographs, two label images (H, W)) of a stage's options, left and right.

    BadInput where the sizes disagree or there is no baseline.
    """
    both = [cameras.read_cameramodel(path) for path in camera_paths]
    photograph = [image.read_photograph(path) for path in photograph_paths]
    labels = [image.read_labels(path) for path in label_paths]
    for paths, pictures in ((photograph_paths, [p.values for p in photograph]), (label_paths, labels)):
        for path, picture, camera, of in zip(paths, pictures, both, camera_paths, strict=True):
            if problem := size_problem(path, picture, camera, of):
                raise BadInput(problem)
    try:
        pair = stereo(*both)
    except ValueError as error:
        left, right = camera_paths
        raise BadInput(
            f"{right}: extrinsics: {error} as in {left}: without a baseline nothing can be known of depth"
        ) from None
    return pair, photograph, labels


def share(labels, chosen) -> float:
    """The share of the picture that the chosen labels cover."""
    return float(np.isin(labels, chosen).mean())


def toy():
    """A small pair with one square, to try things on: (Stereo, labels, values)."""
    T = np.eye(4)
    T[0, 3] = -0.1
    K = np.array([[40.0, 0, 15.5], [0, 40, 15.5], [0, 0, 1]])
    labels = np.ones((32, 32), np.int32)
    labels[8:24, 12:26] = 2
    labels = [labels, np.roll(labels, -4, 1)]
    values = [np.ascontiguousarray(x[..., None] / 2.0) for x in labels]
    return stereo(Camera(K, 32, 32, np.eye(4)), Camera(K, 32, 32, T)), labels, values


def warm_up():
    """Compile, or load, the kernels."""
    pair, labels, values = toy()
    match(pair, *labels, *values)
