"""Where an object may be: its edges laid on the photographs' at many places of its support."""

from dataclasses import dataclass

import numpy as np

from lib.given.cameras import matrix_from_rt
from lib.vision.refinement.edges import draw, model_edges, visible_samples

BINS = 8  # of directions, half a turn
NEAR_PX = 1.2  # of the reduced picture: how well an edge must be met
KNOWN = 0.6  # so much less an edge is worth that the scene without the object explains
SEEN = 0.4  # of an object's edges, at least so much must lie in the pictures, before all else
SAMPLE_PX = 4.0  # between samples of an edge, of the reduced picture
WIDEST_PX = 480  # of the reduced picture


@dataclass(frozen=True, eq=False)
class Field:
    """One photograph, reduced.

    K : (3, 3) px; T_cam_world : (4, 4); score : (BINS, h, w) in [0, 1]; depth : (h, w) m
    """

    K: np.ndarray
    T_cam_world: np.ndarray
    score: np.ndarray
    depth: np.ndarray


def fields(scenery, photographs) -> list[Field]:
    """How well an edge of each direction would be met at each pixel, where the scene without the object is known."""
    model = scenery.posed()
    edges = model_edges(model)
    out = []
    for camera, levels in zip(photographs.cameras(), photographs.pyramids, strict=True):
        factor = min((f for f in levels if camera.width / f <= WIDEST_PX), default=max(levels))
        level = levels[factor]
        s = visible_samples(model, edges, camera, factor, step_px=1.5, reach=3)
        K = np.array([[1 / factor, 0, 0.5 / factor - 0.5], [0, 1 / factor, 0.5 / factor - 0.5], [0, 0, 1]]) @ camera.K
        h, w = level.picture.shape[:2]
        at = np.clip(np.rint(s.q).astype(int), 0, [w - 1, h - 1])
        known = np.zeros((BINS, h, w), bool)
        known[_bin(s.normal), at[:, 1], at[:, 0]] = True
        small = type(camera)(K, w, h, camera.T_cam_world)
        depth = draw(model, small).depth
        score = _nearness(_edges(level)) * (1 - KNOWN * _nearness(known))
        out.append(Field(K, camera.T_cam_world, score.astype(np.float32), np.where(depth > 0, depth, np.inf)))
    return out


def _bin(normal):
    """(N,) of directions (N, 2), up to their sign."""
    angle = np.arctan2(normal[..., 1], normal[..., 0]) % np.pi
    return np.rint(angle / np.pi * BINS).astype(int) % BINS


def _edges(level):
    """(BINS, h, w) bool: thin edges by the direction of their normal."""
    import cv2

    picture = level.picture
    gx, gy = (cv2.Sobel(picture, cv2.CV_32F, *d, ksize=3, scale=0.25).reshape(picture.shape) for d in ((1, 0), (0, 1)))
    best = np.hypot(gx, gy).argmax(axis=2)[..., None]
    gx, gy = (np.take_along_axis(g, best, axis=2)[..., 0] for g in (gx, gy))
    size = np.hypot(gx, gy)
    h, w = size.shape
    x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    ux, uy = gx / np.maximum(size, 1e-12), gy / np.maximum(size, 1e-12)
    beside = [cv2.remap(size, x + k * ux, y + k * uy, cv2.INTER_LINEAR) for k in (-1, 1)]
    light = np.linalg.norm(picture, axis=2) + level.dark
    thin = (size >= beside[0]) & (size > beside[1]) & (size > 4 * level.noise * light)
    out = np.zeros((BINS, h, w), bool)
    rows, columns = np.nonzero(thin)
    out[_bin(np.stack([gx, gy], axis=-1)[rows, columns]), rows, columns] = True
    return out


def _nearness(edges):
    """(BINS, h, w) in [0, 1]: 1 on an edge of about this direction, falling off beside it."""
    import cv2

    out = np.zeros(edges.shape, np.float32)
    for k in range(BINS):
        near = edges[k] | edges[k - 1] | edges[(k + 1) % BINS]
        if near.any():
            d = cv2.distanceTransform((~near).astype(np.uint8), cv2.DIST_L2, 3)
            out[k] = np.exp(-0.5 * (d / NEAR_PX) ** 2)
    return out


@dataclass(frozen=True, eq=False)
class Wire:
    """The edges of an object in its own frame.

    a, b : (E, 3) m; facets : (E, 4), -1 for none; normal : (F, 3), offset : (F,) m, of the facets
    """

    a: np.ndarray
    b: np.ndarray
    facets: np.ndarray
    normal: np.ndarray
    offset: np.ndarray


def wire(model) -> Wire:
    """model : of the object alone"""
    edges = model_edges(model)
    return Wire(edges.a, edges.b, edges.facets, model.facet_normal, model.facet_offset)


def scores(wire, fields, poses) -> np.ndarray:
    """(H,) in [0, 1]: how much of the object's visible edges is met.  poses : (H, 4, 4) T_world_object"""
    out = []
    each = max(1, 400_000 // max(len(wire.a) * 12, 1))
    for part in np.array_split(poses, len(poses) // each + 1):
        met, seen, whole = np.zeros(len(part)), np.zeros(len(part)), np.zeros(len(part))
        for field in fields:
            for total, value in zip((met, seen, whole), _scores(wire, field, part), strict=True):
                total += value
        out.append(np.where(seen > SEEN * whole, met / np.maximum(seen, 1e-9), 0))
    return np.concatenate(out) if out else np.zeros(0)


def _scores(wire, field, poses):
    """Px of edges (met, seen, that face the camera) by pose."""
    T = field.T_cam_world @ poses
    R, t = T[:, :3, :3], T[:, :3, 3]
    eye = -np.einsum("hji,hj->hi", R, t)
    front = np.concatenate([eye @ wire.normal.T > wire.offset, np.zeros((len(T), 1), bool)], axis=1)
    turned = front[:, wire.facets].any(axis=2)  # (H, E)
    a, b = (np.einsum("hij,ej->hei", R, end) + t[:, None] for end in (wire.a, wire.b))
    ahead = (a[..., 2] > 0.05) & (b[..., 2] > 0.05)
    qa, qb = (_pixels(field.K, end) for end in (a, b))
    along = qb - qa
    length = np.linalg.norm(along, axis=2) * (ahead & turned)
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    bins = _bin(normal)
    h, w = field.depth.shape
    samples = int(np.clip(np.percentile(length[length > 0], 90) / SAMPLE_PX if (length > 0).any() else 1, 2, 24))
    met, seen, whole = (np.zeros(len(T)) for _ in range(3))
    for s in (np.arange(samples) + 0.5) / samples:
        x = (1 - s) * a + s * b
        q = np.rint(_pixels(field.K, x))
        inside = (q[..., 0] >= 0) & (q[..., 0] < w) & (q[..., 1] >= 0) & (q[..., 1] < h)
        q = np.where(inside[..., None], q, 0).astype(int)
        free = inside & (x[..., 2] < 1.03 * field.depth[q[..., 1], q[..., 0]])
        weight = length / samples
        met += (weight * free * field.score[bins, q[..., 1], q[..., 0]]).sum(axis=1)
        seen += (weight * free).sum(axis=1)
        whole += np.where(ahead & turned, np.linalg.norm(along, axis=2), 0).sum(axis=1) / samples
    return met, seen, whole


def _pixels(K, x):
    z = np.maximum(x[..., 2], 0.05)
    return np.stack([K[0, 0] * x[..., 0] / z + K[0, 2], K[1, 1] * x[..., 1] / z + K[1, 2]], axis=-1)


def grid(T, centre, normal, spacing, reach, turn, turns) -> np.ndarray:
    """(H, 4, 4): T and poses around it, slid along the support and turned about its normal.

    centre : (3,) m, the object's middle under T; spacing, reach : m; turn : rad between turns, `turns` each way
    """
    a = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(normal, a) / np.linalg.norm(np.cross(normal, a))
    v = np.cross(normal, u)
    n = int(np.ceil(reach / spacing))
    i, j = (k.ravel() for k in np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1)))
    inside = np.hypot(i, j) <= n + 0.5
    slides = spacing * (i[inside, None] * u + j[inside, None] * v)
    out = []
    for k in range(-turns, turns + 1):
        M = matrix_from_rt([*(k * turn * normal), 0, 0, 0])
        M[:3, 3] = centre - M[:3, :3] @ centre
        some = np.repeat((M @ T)[None], len(slides), axis=0)
        some[:, :3, 3] += slides
        out.append(some)
    return np.concatenate(out)


def best_apart(poses, score, points, spacing, most) -> list:
    """Indices of the best poses, none within two spacings of a better one.  points : (N, 3) m of the object"""
    chosen = []
    some = points[:: max(1, len(points) // 8)]
    for k in np.argsort(-score)[: 60 * most]:
        here = some @ poses[k][:3, :3].T + poses[k][:3, 3]
        apart = lambda j, here=here: np.abs(some @ poses[j][:3, :3].T + poses[j][:3, 3] - here).max() > 2.5 * spacing
        if score[k] > 0 and all(apart(j) for j in chosen):
            chosen.append(k)
            if len(chosen) == most:
                break
    return chosen
