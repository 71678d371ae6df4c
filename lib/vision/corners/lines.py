"""Straight lines in space that a pair of photographs shows, and the corners that two of them make.

Two sources. The sides of a facet's outline lie on its plane. Straight edges of the left photograph (LSD: Grompone von
Gioi et al. 2010) lie where the planes through edges of the right one, and its camera, cut the rays through their ends.
Several edges of the right photograph may fit one of the left: all are kept, and what is false is sorted out by the
model (hypotheses.py).
"""

from typing import NamedTuple

import numpy as np

LEAST_PX = 14.0  # of a side or edge in the left photograph
LEAST_CROSSING = 0.2  # sine between an edge and the epipolar line at its middle: along it nothing tells the depth
LOCATED_PX = 0.5  # one sigma of an edge, across it
SAME_COLOUR = 0.08  # display value, root mean square over channels, on the side that looks more alike
SHARED = 0.6  # of the shorter edge, that both photographs show
PARTNERS = 3  # for one edge, at most
LEAST_RAD, MOST_RAD = 0.45, np.pi - 0.45  # between the lines of a corner


class Lines(NamedTuple):
    """n lines in the left camera's frame, m.

    a, b : (n, 3) ends;  sigma : (n,) m, of a point on them;  normal : (n, 3) of the facet, towards the camera, or 0
    px : (n,) how long the left photograph shows them
    """

    a: np.ndarray
    b: np.ndarray
    sigma: np.ndarray
    normal: np.ndarray
    px: np.ndarray


class Corners(NamedTuple):
    """k corners: the apex (k, 3) m; u, v : (k, 3) unit, along both lines; reach : (k, 2) m, how far they go at least.

    angle : (k,) rad, between them;  sigma : (k,) rad, of it;  normal : (k, 3) of the facet that has both, or 0
    """

    apex: np.ndarray
    u: np.ndarray
    v: np.ndarray
    reach: np.ndarray
    angle: np.ndarray
    sigma: np.ndarray
    normal: np.ndarray


def of_pair(scene, sides) -> Lines:
    """All lines of a pair.  scene : SceneFacets in metres;  sides : rig.Side of the left and right photograph"""
    parts = of_facets(scene, sides[0].camera), of_edges(sides)
    return Lines(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def of_facets(scene, camera) -> Lines:
    """The sides of the facets' outlines."""
    found = []
    for polygon, C, n in zip(scene.polygons, scene.covariance, scene.normal, strict=True):
        after = np.roll(polygon, -1, axis=0)
        z = np.minimum(polygon[:, 2], after[:, 2])
        q, q_after = ((p @ camera.K.T)[:, :2] / p[:, 2:] for p in (polygon, after))
        length = np.linalg.norm(q_after - q, axis=1)
        on_rim = np.minimum(_beyond(camera, q), _beyond(camera, q_after)) > 0  # the picture's, not the facet's
        middle = (polygon + after) / 2
        v = middle / middle[:, 2:]
        along = middle[:, 2] ** 2 * np.sqrt(np.einsum("ki,ij,kj->k", v, C, v))
        sigma = np.hypot(along, middle[:, 2] / camera.K[0, 0])
        for k in np.flatnonzero((length >= LEAST_PX) & (z > 0) & ~on_rim):
            found.append((*polygon[k], *after[k], sigma[k], *n, length[k]))
    return _lines(found)


def _beyond(camera, q):
    """(n,) px: how far places lie beyond the picture's outermost pixels but one."""
    low, high = 1.0 - q, q - [camera.width - 2.0, camera.height - 2.0]
    return np.maximum(low, high).max(axis=1)


def _lines(rows) -> Lines:
    a, b, sigma, normal, px = np.split(np.array(rows, float).reshape(-1, 11), [3, 6, 7, 10], axis=1)
    return Lines(a, b, sigma[:, 0], normal, px[:, 0])


def of_edges(sides) -> Lines:
    """Straight edges of the left photograph where those of the right one put them."""
    left, right = (segments(side.photograph) for side in sides)
    cameras = [side.camera for side in sides]
    if len(left) == 0 or len(right) == 0:
        return _lines([])
    D = cameras[1].T_cam_world @ np.linalg.inv(cameras[0].T_cam_world)
    R, t = D[:3, :3], D[:3, 3]
    v = np.stack([cameras[0].directions(left[:, k]) for k in (0, 1)], axis=1)  # (l, 2, 3)
    w = np.stack([cameras[1].directions(right[:, k]) for k in (0, 1)], axis=1)
    plane = np.cross(w[:, 0], w[:, 1])
    plane /= np.linalg.norm(plane, axis=1, keepdims=True)
    slope = np.einsum("ri,ij,lej->lre", plane, R, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = -(plane @ t)[None, :, None] / slope  # (l, r, 2) depth of both ends
        far = np.linalg.norm(t) * cameras[0].K[0, 0] / (2 * LOCATED_PX)
        fits = np.isfinite(z).all(axis=2) & (z > 0).all(axis=2) & (z < far).all(axis=2)
    colour_left, colour_right = _beside(sides[0].photograph, left), _beside(sides[1].photograph, right)
    apart = np.sqrt(((colour_left[:, None] - colour_right[None]) ** 2).mean(axis=3)).min(axis=2)
    fits &= apart < SAME_COLOUR
    l, r = np.nonzero(fits)
    x = z[l, r][:, :, None] * v[l]
    y = x @ R.T + t
    q = (y @ cameras[1].K.T)[..., :2] / np.where(np.abs(y[..., 2:]) < 1e-9, 1e-9, y[..., 2:])
    along = right[r, 1] - right[r, 0]
    length = np.linalg.norm(along, axis=1)
    s = np.einsum(
        "nei,ni->ne", q - right[r, :1], along / length[:, None]
    )  # where the ends come to lie on the right edge
    shared = np.minimum(s.max(axis=1), length) - np.maximum(s.min(axis=1), 0)
    share = shared / np.maximum(np.minimum(length, np.ptp(s, axis=1)), 1e-9)
    # how the place in the right photograph moves with the depth, along the edge's normal and in all
    w, middle = ((v[l, 0] + v[l, 1]) / 2) @ R.T, y.mean(axis=1)
    flow = cameras[1].K[0, 0] * (w * middle[:, 2:] - middle * w[:, 2:])[:, :2] / np.maximum(middle[:, 2:], 1e-9) ** 2
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
    across = np.abs(np.einsum("ni,ni->n", flow, normal))
    crossing = across / np.maximum(np.linalg.norm(flow, axis=1), 1e-12)
    sigma = 1.5 * LOCATED_PX / np.maximum(across, 1e-9)
    good = (y[..., 2] > 0).all(axis=1) & (share > SHARED) & (crossing > LEAST_CROSSING)
    px = np.linalg.norm(left[:, 1] - left[:, 0], axis=1)
    rows = []
    for k in np.unique(l[good]):
        mine = np.flatnonzero(good & (l == k))
        for i in mine[np.argsort(apart[l[mine], r[mine]] - 0.05 * share[mine], kind="stable")][:PARTNERS]:
            rows.append((*x[i, 0], *x[i, 1], sigma[i], 0, 0, 0, px[k]))
    return _lines(rows)


def segments(photograph) -> np.ndarray:
    """(n, 2, 2) px: ends of the photograph's straight edges, the darker side always on the same hand."""
    import cv2

    grey = np.clip(photograph.display.reshape(*photograph.values.shape[:2], -1).mean(axis=2), 0, 1)
    found = cv2.createLineSegmentDetector().detect(np.round(255 * grey).astype(np.uint8))[0]
    if found is None:
        return np.zeros((0, 2, 2))
    found = found.reshape(-1, 2, 2).astype(float) - 0.5  # its pixels' corners count from 0
    return found[np.linalg.norm(found[:, 1] - found[:, 0], axis=1) >= LEAST_PX]


def _beside(photograph, edges, off_px=3.0, places=5):
    """(n, 2, C) mean display values on both sides of edges (n, 2, 2) px."""
    import cv2

    t = (np.arange(places) + 0.5) / places
    along = edges[:, 1] - edges[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    base = edges[:, 0, None] + t[None, :, None] * along[:, None]  # (n, places, 2)
    q = np.stack([base - off_px * normal[:, None], base + off_px * normal[:, None]], axis=1).astype(np.float32)
    picture = np.ascontiguousarray(photograph.display, np.float32)
    flat = q.reshape(len(edges), -1, 2)
    values = np.concatenate(
        [
            cv2.remap(picture, part[..., 0], part[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).reshape(
                len(part), flat.shape[1], -1
            )
            for part in np.array_split(flat, len(flat) // 8000 + 1)
        ]
    )
    return values.reshape(len(edges), 2, places, -1).mean(axis=2)


# Corners.


def corners(lines: Lines, most=150) -> Corners:
    """Every two lines that meet, or would if they went on: the longest and best located first, at most so many."""
    a, d = lines.a, lines.b - lines.a
    length = np.linalg.norm(d, axis=1)
    d = d / np.maximum(length, 1e-12)[:, None]
    i, j = np.triu_indices(len(a), 1)
    cosine = np.einsum("ni,ni->n", d[i], d[j])
    across = 1 - cosine**2
    w = a[j] - a[i]
    wi, wj = np.einsum("ni,ni->n", w, d[i]), np.einsum("ni,ni->n", w, d[j])
    safe = np.maximum(across, 1e-9)
    s, t = (wi - cosine * wj) / safe, (cosine * wi - wj) / safe  # where the lines are nearest
    p, q = a[i] + s[:, None] * d[i], a[j] + t[:, None] * d[j]
    gap = np.linalg.norm(p - q, axis=1)
    apex = (p + q) / 2
    beyond = lambda s, length: np.maximum(np.maximum(-s, s - length), 0)  # past the nearer end
    within = lambda s, length: np.maximum(np.minimum(s, length - s), 0)  # before it
    off = [np.maximum(beyond(x, length[k]), within(x, length[k])) for x, k in ((s, i), (t, j))]
    sigma = np.hypot(lines.sigma[i], lines.sigma[j])
    slack = 0.005 * np.abs(apex[:, 2]) + 3 * sigma
    ok = (across > np.sin(LEAST_RAD) ** 2) & (gap < slack) & (apex[:, 2] > 0)
    ok &= (off[0] < 0.7 * length[i] + slack) & (off[1] < 0.7 * length[j] + slack)
    ok &= (within(s, length[i]) < 0.25 * length[i]) & (within(t, length[j]) < 0.25 * length[j])
    px = np.minimum(lines.px[i], lines.px[j])
    tilt = np.hypot(lines.sigma[i] / np.maximum(length[i], 1e-9), lines.sigma[j] / np.maximum(length[j], 1e-9))
    worth = np.where(ok, px * np.sqrt(across) / (1 + 20 * tilt) / (1 + (off[0] + off[1]) / (length[i] + length[j])), 0)
    k = np.argsort(-worth, kind="stable")[:most]
    k = k[worth[k] > 0]
    i, j, apex, s, t, sigma = i[k], j[k], apex[k], s[k], t[k], sigma[k]
    away = lambda s, line: np.where(s < length[line] / 2, 1.0, -1.0)
    u, v = d[i] * away(s, i)[:, None], d[j] * away(t, j)[:, None]
    reach = np.stack(
        [np.maximum(np.abs(s), np.abs(length[i] - s)), np.maximum(np.abs(t), np.abs(length[j] - t))], axis=1
    )
    one = (lines.normal[i] == lines.normal[j]).all(axis=1)
    angle = np.arccos(np.clip(np.einsum("ni,ni->n", u, v), -1, 1))
    return Corners(apex, u, v, reach, angle, tilt[k], np.where(one[:, None], lines.normal[i], 0))
