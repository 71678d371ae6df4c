"""§2.2 Region matching: which region of the right photograph shows the same planar facet as a region of the left one.

    pair = stereo(camera_left, camera_right)
    matches = match(pair, labels_left, labels_right, values_left, values_right)

Global features and the epipolar constraint, as in the paper. Everything is measured in *rectified* coordinates, where
the two cameras look the same way, x along the baseline: there an epipolar line is a row, v is the same in both
pictures, and the disparity of a planar facet is a linear function of the place,

    u_left - u_right = a u + b v + c      (pixels of f_px; (a, b, c / f_px) = baseline * m, with m . x = 1 on the plane)

so the foreshortening between the two views is exact, not approximated: the rows a region spans agree (its top and
bottom tangents are epipolar lines), the ends of its rows give (a, b, c) by a robust fit, and with it left covers right.
"""

from dataclasses import dataclass

import numpy as np

from lib.core import artefact
from lib.core.stage import BadInput
from lib.vision import matching_kernels as kernels

SAME_CENTRE = 1e-9  # data/SCENE.md, section 2: cameras nearer than this have no baseline
STEEP = 0.2  # cosine: directions nearer to the baseline's than this cannot be rectified


@dataclass(frozen=True, eq=False)
class Stereo:
    """Two pinhole cameras and the frame in which they look the same way.

    left, right : Camera
    R_rect_left, R_rect_right : (3, 3)      camera axes to rectified axes: x towards the right camera's centre
    t_right_left : (3,)                     p_right = R_right_left p_left + t_right_left; m or baselines
    baseline : float > 0                    the cameras' distance, in the unit of their extrinsics
    f_px : float                            the focal length of rectified pixels
    """

    left: object
    right: object
    R_rect_left: np.ndarray
    R_rect_right: np.ndarray
    R_right_left: np.ndarray
    t_right_left: np.ndarray
    baseline: float
    f_px: float

    def rectified(self, q, side):
        """(N, 2) px of the photograph -> (N, 2) px rectified; nan where the direction is too near the baseline's.

        side : "left" or "right"
        """
        camera, R = (self.left, self.R_rect_left) if side == "left" else (self.right, self.R_rect_right)
        v = camera.directions(q) @ R.T
        z = np.where(v[..., 2] > STEEP * np.linalg.norm(v, axis=-1), v[..., 2], np.nan)
        return self.f_px * v[..., :2] / z[..., None]

    def photograph(self, uv, side):
        """(..., 2) px rectified -> (..., 2) px of the photograph: the inverse of `rectified`."""
        camera, R = (self.left, self.R_rect_left) if side == "left" else (self.right, self.R_rect_right)
        p = np.concatenate([uv / self.f_px, np.ones((*uv.shape[:-1], 1))], axis=-1) @ R @ camera.K.T
        return p[..., :2] / p[..., 2:]


def stereo(left, right) -> Stereo:
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


@dataclass(frozen=True, eq=False)
class Regions:
    """One photograph's regions, in rectified pixels. N = the largest label; index 0 is label 1.

    pixels : (N,)                       area in the photograph
    mean : (N, C)                       colour
    centre : (N, 2)                     mean (u, v); nan where a pixel cannot be rectified
    low, high : (N,)                    first and last row
    cut : (N,) bool                     touches the picture's border
    row_start : (N + 1,)                row r of region i is row_start[i] + r - low[i]
    ends : (rows, 2)                    least and greatest u in each row; nan where it has no pixel
    whole : (rows, 2) bool              that end is not at the picture's border
    order, first : (pixels,), (N + 1,)  the pixels of region i are order[first[i]:first[i + 1]]
    """

    pixels: np.ndarray
    mean: np.ndarray
    centre: np.ndarray
    low: np.ndarray
    high: np.ndarray
    cut: np.ndarray
    row_start: np.ndarray
    ends: np.ndarray
    whole: np.ndarray
    order: np.ndarray
    first: np.ndarray


def regions(pair, labels, values, side) -> Regions:
    """labels : (H, W) int, 0 = nothing; values : (H, W, C)."""
    height, width = labels.shape
    n = int(labels.max(initial=0))
    flat = labels.ravel()
    order = np.argsort(flat, kind="stable")
    first = np.searchsorted(flat[order], np.arange(1, n + 2))
    pixels = np.diff(first)
    count = np.maximum(pixels, 1)
    mean = (
        np.stack([np.bincount(flat, values[..., c].ravel(), n + 1)[1:] for c in range(values.shape[2])], axis=1)
        / count[:, None]
    )
    uv = pair.rectified((pair.left if side == "left" else pair.right).pixels(), side)
    u, v = np.ascontiguousarray(uv[..., 0]), np.ascontiguousarray(uv[..., 1])
    centre = np.stack([np.bincount(flat, c.ravel(), n + 1)[1:] for c in (u, v)], axis=1) / count[:, None]
    low, high = np.full(n + 1, np.iinfo(np.int64).max), np.full(n + 1, np.iinfo(np.int64).min)
    known = np.isfinite(v).ravel()
    row = np.floor(v.ravel()[known]).astype(np.int64)
    np.minimum.at(low, flat[known], row)
    np.maximum.at(high, flat[known], row)
    low, high = low[1:], high[1:]
    high = np.where(high < low, low - 1, high)
    row_start = np.concatenate([[0], np.cumsum(high - low + 1)])
    ends = np.full((row_start[-1], 2), np.nan)
    whole = np.zeros(ends.shape, bool)
    kernels.rows(labels, u, v, low, row_start, ends, whole)
    cut = np.zeros(n + 1, bool)
    for side_of in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        cut[side_of] = True
    return Regions(pixels, mean, centre, low, high, cut[1:], row_start, ends, whole, order, first)


def outline_plane(l, r, i, j):
    """(a, b, c) of the disparity that takes the row ends of region i (index, left) to those of region j, the share of ends that agree, their number."""
    low, high = max(l.low[i], r.low[j]), min(l.high[i], r.high[j])
    work = np.empty((2 * max(high - low + 1, 1), 3))
    a, b, c, agree, n = kernels.fit(
        low, high, l.low[i], l.row_start[i], l.ends, l.whole, r.low[j], r.row_start[j], r.ends, r.whole, work
    )
    return np.array([a, b, c]), agree, n


@dataclass(frozen=True, eq=False)
class Matches:
    """left, right : (M,) labels, one to one, best first       similarity : (M,) in [0, 1]
    plane : (M, 3)                          m of the plane that took left onto right, left frame, m . x = 1 (whole-pixel accuracy)
    refused_left, refused_right : dict      why each other region has no partner -> its labels
    """

    left: np.ndarray
    right: np.ndarray
    similarity: np.ndarray
    plane: np.ndarray
    refused_left: dict
    refused_right: dict


def match(
    pair, labels_left, labels_right, values_left, values_right, *, similarity=0.6, margin=0.9, smallest=40, colour=0.1
) -> Matches:
    """One to one, strict, best first: each the other's best, alike by at least `similarity`, and the next best below `margin` of it.

    labels_* : (H, W) int, from 1; values_* : (H, W, C), display-referred in [0, 1], both of C channels
    smallest : px     regions of fewer pixels say too little        colour : largest difference of the means of a channel
    """
    l, r = regions(pair, labels_left, values_left, "left"), regions(pair, labels_right, values_right, "right")
    uv_l, uv_r = pair.rectified(pair.left.pixels(), "left"), pair.rectified(pair.right.pixels(), "right")
    by_row = np.flatnonzero(r.pixels >= smallest)
    by_row = by_row[np.argsort(r.low[by_row], kind="stable")]
    split = lambda uv: (np.ascontiguousarray(uv[..., 0]), np.ascontiguousarray(uv[..., 1]))
    side = lambda x, uv, labels, values, R, camera: (
        x.pixels,
        x.mean,
        x.centre,
        x.low,
        x.high,
        x.cut,
        x.row_start,
        x.ends,
        x.whole,
        x.order,
        x.first,
        *split(uv),
        labels,
        values,
        np.ascontiguousarray(R),
        camera.K,
    )
    i, j, s, plane, far_l, far_r = kernels.candidates(
        smallest,
        colour,
        by_row,
        *side(l, uv_l, labels_left, values_left, pair.R_rect_left, pair.left),
        *side(r, uv_r, labels_right, values_right, pair.R_rect_right, pair.right),
        pair.f_px,
    )
    best = np.lexsort((j, i, -s))
    i, j, s, plane = i[best].astype(int), j[best].astype(int), s[best], plane[best].reshape(-1, 3)
    n_l, n_r = len(l.pixels), len(r.pixels)

    def first_and_second(index, n):
        top, second, at = np.zeros(n), np.zeros(n), np.full(n, -1)
        for k, x in enumerate(index):
            if at[x] < 0:
                at[x], top[x] = k, s[k]
            elif second[x] == 0:
                second[x] = s[k]
        return at, top, second

    at_l, top_l, second_l = first_and_second(i, n_l)
    at_r, top_r, second_r = first_and_second(j, n_r)
    k = np.arange(len(i))
    alike, mutual = s >= similarity, (at_l[i] == k) & (at_r[j] == k)
    clear = np.maximum(second_l[i], second_r[j]) <= margin * s
    for far, index, at in ((far_l, i, at_l), (far_r, j, at_r)):
        for x in np.flatnonzero(at >= 0):
            far[x] = kernels.ALIKE if not alike[at[x]] else kernels.MUTUAL if not mutual[at[x]] else kernels.AMBIGUOUS
    keep = alike & mutual & clear
    left, right, s = i[keep] + 1, j[keep] + 1, s[keep]
    m_rect = plane[keep] / pair.baseline / np.array([1, 1, pair.f_px])
    return Matches(
        left, right, s, m_rect @ pair.R_rect_left, _refused(far_l, left, l.pixels), _refused(far_r, right, r.pixels)
    )


def _refused(far, matched, pixels):
    far = np.where(pixels > 0, far, -1)
    far[matched - 1] = -1
    return {name: (np.flatnonzero(far == k) + 1).tolist() for k, name in enumerate(kernels.REASONS) if (far == k).any()}


def photographs(left, right):
    """(H, W, C) of two photographs as they are compared: display-referred in [0, 1], of equally many channels."""
    values = [np.clip(p.values, 0, 1) ** (1 / 2.2) if p.linear else p.values for p in (left, right)]
    if values[0].shape[2] != values[1].shape[2]:
        values = [v.mean(axis=2, keepdims=True) for v in values]
    return [np.ascontiguousarray(v) for v in values]


def read_pair(left_path, right_path, photograph_paths, label_paths):
    """(Stereo, photographs, labels) of a stage's options; BadInput where their sizes disagree or there is no baseline."""
    from lib.given import cameras, image

    camera = [cameras.read_cameramodel(path) for path in (left_path, right_path)]
    photograph = [image.read_photograph(path) for path in photograph_paths]
    labels = [image.read_labels(path) for path in label_paths]
    for path, shape, c, of in [
        (p, x.values.shape[:2], c, of)
        for p, x, c, of in zip(photograph_paths, photograph, camera, (left_path, right_path))
    ] + [(p, x.shape, c, of) for p, x, c, of in zip(label_paths, labels, camera, (left_path, right_path))]:
        if shape != (c.height, c.width):
            raise BadInput(f"{path}: size: {shape[1]} x {shape[0]} is not the camera's {c.width} x {c.height} ({of})")
    try:
        pair = stereo(*camera)
    except ValueError as error:
        raise BadInput(
            f"{right_path}: extrinsics: {error} as in {left_path}: without a baseline nothing can be known of depth"
        ) from None
    return pair, photographs(*photograph), labels


def read(path, labels_left, labels_right):
    """(M,) left and right labels of matches.csv; each must be in its picture."""
    pairs = np.array([match[:2] for match in artefact.read_matches(path)], int).reshape(-1, 2)
    for side, labels in enumerate((labels_left, labels_right)):
        missing = np.flatnonzero(~np.isin(pairs[:, side], labels) | (pairs[:, side] == 0))
        if len(missing):
            raise BadInput(
                f"{path}: line {missing[0] + 2}: {artefact.MATCHES[side]}: {pairs[missing[0], side]} is not in the label image"
            )
    return pairs[:, 0], pairs[:, 1]


def share(labels, chosen):
    """The share of the picture that the chosen labels cover."""
    return float(np.isin(labels, chosen).mean())


def toy():
    """A small pair with one square, to try things on: (Stereo, labels, values)."""
    from lib.given.cameras import Camera

    T = np.eye(4)
    T[0, 3] = -0.1
    K = np.array([[40.0, 0, 15.5], [0, 40, 15.5], [0, 0, 1]])
    labels = np.ones((32, 32), np.int32)
    labels[8:24, 12:26] = 2
    labels = [labels, np.roll(labels, -4, 1)]
    return (
        stereo(Camera(K, 32, 32, np.eye(4)), Camera(K, 32, 32, T)),
        labels,
        [np.ascontiguousarray(x[..., None] / 2.0) for x in labels],
    )


def warm_up():
    """Compile, or load, the kernels."""
    pair, labels, values = toy()
    match(pair, *labels, *values)
