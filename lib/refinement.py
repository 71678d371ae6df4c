"""§2.4 The non-linear refinement: the pose that puts the model's visible edges on the edges of both photographs.

    result = refine(model, sides, found)            # found : recognition.Recognition

From a pose the index buffer says which edges each camera sees. Samples along them search the photograph along
their normals for the greatest change, at sub-pixel; the pose (six numbers: the pair's relative pose is
fixed; seven where its scale is unknown) that brings the samples onto what they found comes from
Levenberg-Marquardt steps with a robust loss. From coarse pictures to fine ones, with new visibility at every step.

The paper moves the corners of facets onto the corners of their regions by plain gradient descent: method "paper".
"""

import functools
import math
import time
from dataclasses import dataclass, replace

import numpy as np

from lib import index_buffer
from lib.cameras import Camera, rt_from_matrix
from lib.recognition import moved


@dataclass(frozen=True, eq=False)
class Side:
    """One photograph of the pair. camera : in the pair's frame; photograph : image.Photograph; regions : (H, W) int labels, or None"""

    camera: Camera
    photograph: object
    regions: np.ndarray = None


@dataclass(frozen=True, eq=False)
class Refined:
    """cameras : tuple of Camera          posed in the model's frame
    covariance : (6, 6)              of (omega, tau) of the left camera: T = exp(omega, tau) T_hat, its axes, rad and m
    scale : m per unit of the pair's baseline; 1 where that is the metre
    rms_px : of the residuals, robust
    support : share of the predicted edges that the photographs show; chance : share that would be found anywhere
    evidence : nats, from support against chance
    trace : list of dict              iteration, step, error_px, rt_cam_world, ...; cpu_s, wall_s by the process's clocks
    status, chosen, ambiguous         see refine
    """

    cameras: tuple
    covariance: np.ndarray
    scale: float
    rms_px: float
    support: float
    chance: float
    evidence: float
    trace: list
    status: str = "unique"
    chosen: int = 0
    ambiguous: tuple = ()


# The photographs, as the search needs them.

SMOOTH_PX = 0.8
STEP_PX, CREASE_PX = 0.1, 0.7           # what places of edges are worth at best: steps, and corners where only shading changes


@dataclass(frozen=True, eq=False)
class _Level:
    """A photograph reduced `factor` times: smoothed, in approximately linear light. noise : of the contrast between pixels two apart;
    dark : light below which contrasts fade; white : light that is clipped"""

    picture: np.ndarray
    factor: int
    noise: float
    dark: float
    white: float


def _pyramid(photograph, coarsest):
    """{factor: _Level} for 1, 2, 4, ... coarsest. Light adds up within a pixel, display values do not: an edge of display values would be found up to 0.1 px aside."""
    import cv2

    values = photograph.values
    if photograph.linear:
        values, white = values / max(float(np.percentile(values, 99)), 1e-12), math.inf
    else:
        values, white = values ** 2.2, 0.95                                     # beside what is clipped an edge looks moved
    levels, factor = {}, 1
    picture = np.ascontiguousarray(values, np.float32)
    dark = 0.05 * float(picture.mean()) + 1e-6                                  # contrasts are measured against light, and this
    while True:
        smooth = cv2.GaussianBlur(picture, (0, 0), SMOOTH_PX).reshape(*picture.shape[:2], -1)
        contrast = np.linalg.norm(smooth[:, 2:] - smooth[:, :-2], axis=2) / (np.linalg.norm(smooth[:, 1:-1], axis=2) + dark)
        noise = float(np.median(contrast)) if contrast.size else 0.0
        levels[factor] = _Level(smooth, factor, max(noise, 1e-3), dark, white)
        factor *= 2
        if factor > coarsest or min(picture.shape[:2]) < 80:
            return levels
        picture = cv2.resize(picture, (picture.shape[1] // 2, picture.shape[0] // 2), interpolation=cv2.INTER_AREA)


# What the model predicts.

@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges of facets, one for each place. a, b : (E, 3) m, world; facets : (E, 4) that end there, -1 for none"""

    a: np.ndarray
    b: np.ndarray
    facets: np.ndarray


def model_edges(model) -> _Edges:
    ends = index_buffer.facet_edges(model)
    t = model.triangles
    position = np.unique(model.vertices + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    half = np.sort(position[np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])], axis=1)
    facet = np.tile(model.triangle_facet, 3)
    key = np.sort(position[ends], axis=1)
    places, first, which = np.unique(key, axis=0, return_index=True, return_inverse=True)
    which = which.reshape(-1)
    base = int(position.max()) + 1
    code = places[:, 0].astype(np.int64) * base + places[:, 1]
    at = np.searchsorted(code, half[:, 0].astype(np.int64) * base + half[:, 1])
    at = np.minimum(at, len(code) - 1)
    mine = code[at] == half[:, 0].astype(np.int64) * base + half[:, 1]
    pairs = np.unique(np.column_stack([at[mine], facet[mine]]), axis=0)
    facets = np.full((len(places), 4), -1)
    slot = np.arange(len(pairs)) - np.searchsorted(pairs[:, 0], pairs[:, 0])
    few = slot < 4
    facets[pairs[few, 0], slot[few]] = pairs[few, 1]
    return _Edges(model.vertices[ends[first, 0]], model.vertices[ends[first, 1]], facets)


@dataclass(frozen=True, eq=False)
class Samples:
    """Points of visible edges. p : (N, 3) m, world; q, normal : (N, 2) px; edge : (N,); clear : (N,) px, on both sides nothing else begins"""

    p: np.ndarray
    q: np.ndarray
    normal: np.ndarray
    edge: np.ndarray
    clear: np.ndarray


def _draw(model, camera):
    try:
        return index_buffer.draw(model, camera)
    except index_buffer.NoGraphics:
        return index_buffer.reference(model, camera)


def visible_samples(model, edges, camera, factor=1, step_px=4.0, reach=8) -> Samples:
    """Samples every step_px along the edges that the camera sees, in pixels of the picture reduced `factor` times."""
    K = np.array([[1 / factor, 0, 0.5 / factor - 0.5], [0, 1 / factor, 0.5 / factor - 0.5], [0, 0, 1]]) @ camera.K
    small = Camera(K, camera.width // factor, camera.height // factor, camera.T_cam_world)
    index = _draw(model, small)
    facet = index.facet
    a, b = camera.points(edges.a), camera.points(edges.b)
    W, H = small.width, small.height
    begin, end = index_buffer.clip_to_picture(small, a, b, 1e-3 * max(np.abs(a).max(), 1e-12))
    e = np.flatnonzero(begin < end)
    if len(e) == 0:
        return Samples(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, int), np.zeros(0))
    za, zb = (a[e] + s[e, None] * (b[e] - a[e]) for s in (begin, end))
    qa, qb = ((z @ K.T)[:, :2] / z[:, 2:] for z in (za, zb))
    length = np.linalg.norm(qb - qa, axis=1)
    keep = length > 3
    e, za, zb, qa, qb, length = (array[keep] for array in (e, za, zb, qa, qb, length))
    count = np.maximum(1, (length / step_px).astype(int))
    owner = np.repeat(np.arange(len(e)), count)
    t = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[owner]      # in the picture
    q = qa[owner] + t[:, None] * (qb - qa)[owner]
    # along the edge: 1/z is linear in the picture
    s = t * za[owner, 2] / ((1 - t) * zb[owner, 2] + t * za[owner, 2])
    s = begin[e][owner] + s * (end - begin)[e][owner]
    p = edges.a[e][owner] + s[:, None] * (edges.b - edges.a)[e][owner]
    direction = ((qb - qa) / np.maximum(length, 1e-12)[:, None])[owner]
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    # what the index buffer shows on either side, pixel by pixel away from the edge
    clear = np.full(len(q), float(reach))
    shown = []
    for side in (-1, 1):
        first = None
        for k in range(1, reach + 1):
            at = np.rint(q + side * (k + 0.25) * normal).astype(int)
            inside = (at[:, 0] >= 0) & (at[:, 0] < W) & (at[:, 1] >= 0) & (at[:, 1] < H)
            here = np.where(inside, facet[np.clip(at[:, 1], 0, H - 1), np.clip(at[:, 0], 0, W - 1)], -2)
            first = here if first is None else first
            clear = np.where((here != first) | ~inside, np.minimum(clear, k - 1), clear)
        shown.append(first)
    own = edges.facets[e][owner]
    mine = [(own == side[:, None]).any(axis=1) & (side >= 0) for side in shown]
    clear = np.minimum(clear, _alone(q, normal, owner, 1 / np.maximum(_inverse(t, za, zb, owner), 1e-300), index.depth, reach))
    seen = (shown[0] != shown[1]) & (mine[0] | mine[1]) & (clear >= 1)
    return Samples(p[seen], q[seen], normal[seen], e[owner][seen], clear[seen])


def _inverse(t, za, zb, owner):
    """1/z along the edges: linear in the picture."""
    return (1 - t) / za[owner, 2] + t / zb[owner, 2]


def _alone(q, normal, edge, z, depth, reach):
    """(N,) px: how far from another edge that may be seen, across; slivers too thin for the index buffer have edges too. Edges on one line count as one."""
    import cv2
    from scipy.spatial import cKDTree

    H, W = depth.shape
    furthest = cv2.dilate(np.where(depth > 0, depth, np.inf), np.ones((3, 3), np.uint8))
    at = np.clip(np.rint(q).astype(int), 0, [W - 1, H - 1])
    front = np.flatnonzero(z <= furthest[at[:, 1], at[:, 0]] * 1.02)
    alone = np.full(len(q), float(reach))
    if len(front) == 0:
        return alone
    pairs = cKDTree(q[front]).query_pairs(min(reach, 6.0), output_type="ndarray")
    i, j = front[pairs[:, 0]], front[pairs[:, 1]]
    other = edge[i] != edge[j]
    i, j = i[other], j[other]
    for a, b in ((i, j), (j, i)):
        gap = q[b] - q[a]
        across = np.abs(np.einsum("ij,ij->i", gap, normal[a]))
        along = np.abs(gap[:, 0] * normal[a, 1] - gap[:, 1] * normal[a, 0])
        near = (across > 0.3) & (along < 3)
        np.minimum.at(alone, a[near], across[near])
    return alone


# What the photograph shows.

def _find(level, q, normal, reach):
    """Along each normal, within `reach` px: (offset, strength, doubt), strength 0 where nothing rises above the noise.

    The greatest change of colour, near ones favoured, its place by a parabola; doubt is how nearly another one would have won.
    """
    import cv2

    step = 0.5
    half = int(math.ceil(reach / step))
    o = step * np.arange(-half - 2, half + 3)
    at = q[:, None] + o[None, :, None] * normal[:, None]
    profile = np.concatenate([cv2.remap(level.picture, part[..., 0].astype(np.float32), part[..., 1].astype(np.float32), cv2.INTER_LINEAR,
                                        borderMode=cv2.BORDER_REPLICATE).reshape(len(part), len(o), -1)
                              for part in np.array_split(at, max(1, len(at) // 8000 + 1)) if len(part)]) if len(at) else np.zeros((0, len(o), 1))
    change = profile[:, 4:] - profile[:, :-4]                                   # over two pixels, at o[2:-2]
    M = np.linalg.norm(change, axis=2)                                          # (N, 2 half + 1)
    inner = o[2:-2]
    contrast = M / (np.linalg.norm(profile[:, 2:-2], axis=2) + level.dark)
    peak = np.zeros_like(M, bool)
    peak[:, 1:-1] = (M[:, 1:-1] >= M[:, :-2]) & (M[:, 1:-1] > M[:, 2:]) & (contrast[:, 1:-1] > 4 * level.noise)
    merit = np.where(peak, np.sqrt(contrast) * np.exp(-0.5 * (inner / (0.6 * reach + 0.5)) ** 2), 0)
    if len(M) == 0:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    best = merit.argmax(axis=1)
    i = np.arange(len(M))
    won = merit[i, best]
    k = np.clip(best, 1, M.shape[1] - 2)
    left, middle, right = M[i, k - 1], M[i, k], M[i, k + 1]
    bend = left - 2 * middle + right
    offset = inner[k] + step * np.where(bend < 0, 0.5 * (left - right) / np.where(bend < 0, bend, -1), 0)
    other = np.where(np.abs(inner[None] - inner[best][:, None]) > 1.5, merit, 0).max(axis=1)
    return offset, np.where(won > 0, contrast[i, best], 0), np.where(won > 0, other / np.where(won > 0, won, 1), 1)


def _locate(level, q, normal, clear, ramp=1.0):
    """Along each normal, within 2 px: (offset, sigma px, strength), strength 0 where there is no edge to be placed.

    The profile is compared with every step and crease: a + b x + c S(x - x0) + d R(x - x0), S a step and R a ramp as blurred as the
    picture; where two walls meet light falls off towards both, and the greatest change lies a pixel beside the corner. Least squares
    over all channels, x0 by a parabola; sigma from the curvature. The window is as wide as the edge is alone.
    """
    import cv2

    N = len(q)
    offset, sigma, strength = np.zeros(N), np.full(N, np.inf), np.zeros(N)
    if N == 0:
        return offset, sigma, strength
    step = 0.5
    o = step * np.arange(-8, 9)
    at = q[:, None] + o[None, :, None] * normal[:, None]
    profile = np.concatenate([cv2.remap(level.picture, part[..., 0].astype(np.float32), part[..., 1].astype(np.float32), cv2.INTER_LINEAR,
                                        borderMode=cv2.BORDER_REPLICATE).reshape(len(part), len(o), -1) for part in np.array_split(at, N // 8000 + 1)])
    profile = profile.transpose(0, 2, 1).astype(float)                          # (N, C, L)
    for width, low, high in ((4, 4, math.inf), (3, 3, 4), (2, 1.8, 3)):
        mine = np.flatnonzero((clear >= low) & (clear < high))
        if len(mine) == 0:
            continue
        inside = np.abs(o) <= width
        Q, x0 = _templates(width, ramp, step)
        y = profile[mine][:, :, inside]
        light = np.linalg.norm(y.mean(axis=2), axis=1) + level.dark
        y = y / light[:, None, None]
        whole = (y ** 2).sum(axis=(1, 2))
        plain = np.linalg.qr(np.column_stack([np.ones(inside.sum()), o[inside]]))[0]
        straight = ((y @ plain) ** 2).sum(axis=(1, 2))
        parts = ((y.reshape(-1, y.shape[2]) @ Q).reshape(len(mine), y.shape[1], len(x0), 4) ** 2).sum(axis=1)
        explained = parts.sum(axis=2)
        best = explained.argmax(axis=1)
        k = np.clip(best, 1, len(x0) - 2)
        i = np.arange(len(mine))
        a, b, c = explained[i, k - 1], explained[i, k], explained[i, k + 1]
        bend = a - 2 * b + c
        d = x0[1] - x0[0]
        freedom = y.shape[1] * (inside.sum() - 5)
        noise = np.maximum((whole - b) / freedom, 1e-7) * 4                     # neighbours share their noise: interpolation, smoothing
        good = (best == k) & (bend < 0) & (b - straight > 30 * noise) & (profile[mine][:, :, inside].max(axis=(1, 2)) < level.white)
        bend = np.where(good, bend, -1)
        offset[mine] = x0[k] + np.where(good, np.clip(0.5 * (a - c) / bend, -1, 1) * d, 0)
        # A step is where it is; a crease is what light makes of it, and light curves.
        crease = 1 - np.clip(parts[i, k, 3] / np.maximum(b - straight, 1e-12), 0, 1)
        sigma[mine] = np.where(good, np.sqrt(2 * noise / (-bend / d ** 2) + (CREASE_PX * crease) ** 2), np.inf)
        strength[mine] = np.where(good, np.sqrt(np.maximum(b - straight, 0)), 0)
    return offset, sigma, strength


@functools.lru_cache(maxsize=8)
def _templates(width, ramp, step):
    """(L, 4 K) orthonormal bases for the K places x0, and the places."""
    from scipy.special import ndtr

    o = step * np.arange(-2 * width, 2 * width + 1)
    x0 = 0.25 * np.arange(-4 * min(width - 1, 2), 4 * min(width - 1, 2) + 1)
    bases = []
    for place in x0:
        x = o - place
        S = ndtr(x / ramp)
        R = x * S + ramp * np.exp(-0.5 * (x / ramp) ** 2) / math.sqrt(2 * math.pi)
        bases.append(np.linalg.qr(np.column_stack([np.ones_like(x), x, R, S]))[0])
    return np.concatenate(bases, axis=1), x0


# Levenberg-Marquardt on one set of correspondences.

@dataclass(frozen=True, eq=False)
class _Rig:
    """The pair, fixed: its sides, T_side_left of each (the translation in units of the facets), and how far away the model is seen, m."""

    sides: tuple
    relative: tuple
    depth: float

    def cameras(self, T, scale):
        made = []
        for side, D in zip(self.sides, self.relative):
            D = D.copy()
            D[:3, 3] *= scale
            made.append(Camera(side.camera.K, side.camera.width, side.camera.height, D @ T))
        return tuple(made)


def _project(rig, side, T, scale, p, jacobian=False, free=False):
    """Pixels (N, 2) of world points and, wanted, their derivatives (N, 2, 6 or 7)."""
    K, D = rig.sides[side].camera.K, rig.relative[side]
    centre = -T[:3, :3].T @ T[:3, 3]
    x_left = (p - centre) @ T[:3, :3].T
    x = x_left @ D[:3, :3].T + scale * D[:3, 3]
    z = np.where(x[:, 2] > 1e-9, x[:, 2], 1e-9)
    q = (x / z[:, None]) @ K.T
    if not jacobian:
        return q[:, :2]
    dq = np.zeros((len(p), 2, 3))
    dq[:, 0, 0], dq[:, 1, 1] = K[0, 0] / z, K[1, 1] / z
    dq[:, 0, 2], dq[:, 1, 2] = -K[0, 0] * x[:, 0] / z ** 2, -K[1, 1] * x[:, 1] / z ** 2
    dx = np.zeros((len(p), 3, 7 if free else 6))
    cross = np.zeros((len(p), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = x_left[:, 2], -x_left[:, 1], x_left[:, 0]
    cross -= cross.transpose(0, 2, 1)
    dx[:, :, :3] = D[:3, :3] @ cross
    dx[:, :, 3:6] = D[:3, :3]
    if free:
        dx[:, :, 6] = scale * D[:3, 3]
    return q[:, :2], dq @ dx


def _step(T, scale, delta):
    return moved(T, delta), scale * math.exp(min(max(delta[6], -0.5), 0.5)) if len(delta) == 7 else scale


WITNESS = 10           # samples that share their error, about


def _gap(prior, T, scale, size):
    """(size,): the step from the prior's pose to this one."""
    _, T0, scale0 = prior
    D = T @ np.linalg.inv(T0)
    gap = rt_from_matrix(D)
    return np.append(gap, math.log(scale / scale0)) if size == 7 else gap


def _solve(rig, T, scale, found, sigma, free, prior, iterations=6):
    """LM on correspondences: found = [(p, q, normal, offset, weight)] per side; Geman-McClure loss of width 2 sigma. prior : (H, T0, scale0) or None.

    Returns T, scale, and per side residuals and robust weights, and the normal matrix."""
    size = 7 if free else 6
    width = 2.5 * sigma

    def linearise(T, scale, jacobian):
        H, b, cost, parts = np.zeros((size, size)), np.zeros(size), 0.0, []
        if prior is not None:
            gap = _gap(prior, T, scale, size)
            H, b, cost = WITNESS * sigma ** 2 * prior[0], WITNESS * sigma ** 2 * prior[0] @ gap, WITNESS * sigma ** 2 * gap @ prior[0] @ gap
        for side, (p, q, normal, offset, weight) in enumerate(found):
            if jacobian:
                now, dq = _project(rig, side, T, scale, p, True, free)
            else:
                now = _project(rig, side, T, scale, p)
            r = np.einsum("ij,ij->i", normal, now - q) - offset
            u = (r / width) ** 2
            cost += (weight * width ** 2 * u / (1 + u)).sum()
            robust = weight / (1 + u) ** 2
            if jacobian:
                J = np.einsum("ni,nik->nk", normal, dq)
                H += (robust[:, None] * J).T @ J
                b += (robust * r) @ J
                parts.append((J, r, robust))
        return H, b, cost, parts

    damping = 1e-4
    H, b, cost, parts = linearise(T, scale, True)
    for _ in range(iterations):
        A = H + damping * np.diag(np.diag(H) + 1e-12)
        delta = -np.linalg.lstsq(A, b, rcond=1e-14)[0]
        T_new, scale_new = _step(T, scale, delta)
        new_cost = linearise(T_new, scale_new, False)[2]
        if new_cost > cost:
            damping = max(10 * damping, 1e-3)
            if damping > 1e6:
                break
            continue
        gain = cost - new_cost
        T, scale, damping = T_new, scale_new, damping / 10
        H, b, cost, parts = linearise(T, scale, True)
        if gain < 1e-7 * max(cost, 1e-12):
            break
    return T, scale, H, parts


# The method.

def _edges_method(model, edges, rig, pyramids, T, scale, free, schedule, trace, prior=None):
    """Runs a schedule of (factor, reach): appends to trace; returns T, scale and the last _Fit, or None where there were too few samples."""
    last, before = None, None
    for number, (factor, reach) in enumerate(schedule):
        final = number == len(schedule) - 1
        samples, drawn = None, None
        for _ in range(12 if final else 4):
            cameras = rig.cameras(T, scale)
            if drawn is None or _moved_px(rig, drawn, T, scale) > 0.3 * factor:
                samples = [visible_samples(model, edges, camera, factor, step_px=3.0, reach=max(int(reach) + 1, 5)) for camera in cameras]
                drawn = (T, scale)
            found, at = [], []
            for side, s in enumerate(samples):
                q_full = _project(rig, side, T, scale, s.p)
                if reach > 2:
                    offset, strength, doubt = _find(pyramids[side][factor], (q_full + 0.5) / factor - 0.5, s.normal, reach)
                    good = (strength > 0) & (np.abs(offset) < reach) & (doubt < 0.9)
                    weight = (1 - doubt ** 2) * np.minimum(s.clear / 3, 1)
                else:
                    offset, spread, strength = _locate(pyramids[side][1], q_full, s.normal, s.clear)
                    good = (strength > 0) & (spread < 1)
                    weight = STEP_PX ** 2 / (STEP_PX ** 2 + spread ** 2)
                found.append((s.p[good], q_full[good], s.normal[good], factor * offset[good], weight[good]))
                at.append((s.edge[good], len(s.q)))
            r = np.concatenate([f[3] for f in found])
            if len(r) < 20:
                return T, scale, None
            if trace[-1]["error_px"] is None:                                   # the start: what the first search sees
                trace[-1]["error_px"] = float(np.sqrt(np.mean(r ** 2)))
            sigma = max(1.4826 * float(np.median(np.abs(r))), 0.08 * factor)
            before = (T, scale)
            T, scale, H, parts = _solve(rig, T, scale, found, sigma, free, prior if factor > 1 or reach > 5 else None)
            last = _Fit(H, parts, at, [(f[0], f[2]) for f in found])
            trace.append(_point(trace, T, _rms(parts), factor=factor, samples=len(r)))
            if _moved_px(rig, before, T, scale) < (0.01 if final else 0.1) * factor:
                break
    return T, scale, last


def _point(trace, T, error_px, step="refined", **more):
    """One entry of the trace; the clocks are the process's."""
    return {"iteration": len(trace), "step": step, "error_px": error_px, **more, "rt_cam_world": rt_from_matrix(T),
            "cpu_s": time.process_time(), "wall_s": time.perf_counter()}


@dataclass(frozen=True, eq=False)
class _Fit:
    H: np.ndarray
    parts: list
    at: list
    where: list


def _rms(parts):
    total = sum((w * r ** 2).sum() for _, r, w in parts)
    return float(math.sqrt(total / max(sum(w.sum() for _, _, w in parts), 1e-12)))


def _view(rig):
    """(5, 2) px, (5, 3) m: corners and middle of the left picture, and points there at the scene's depth, left camera's axes."""
    camera = rig.sides[0].camera
    W, H = camera.width - 1, camera.height - 1
    q = np.array([[0, 0], [W, 0], [0, H], [W, H], [W / 2, H / 2]], float)
    return q, camera.directions(q) * rig.depth


def _moved_px(rig, old, T, scale):
    """How far corners and middle of the picture move between two poses, px (largest)."""
    q, x = _view(rig)
    T0 = old[0]
    return float(np.abs(_project(rig, 0, T, scale, (x - T0[:3, 3]) @ T0[:3, :3]) - q).max())


def _paper_method(model, rig, T, scale, matches, labels, trace, iterations=400):
    """The paper's: corners of the facets that were recognised onto the corners of their regions, by plain gradient descent.

    Each corner that a camera sees goes with the nearest corner of its region's outline. The step is the longest that cannot diverge;
    it is taken again and again until the error stops falling. Simplest, least accurate: regions end where colours do.
    """
    import cv2

    targets = []                                                                # per side and match: model corners, region corners
    for side, s in enumerate(rig.sides):
        for (i, f) in matches:
            label = labels[i, side]
            mask = (s.regions == label).astype(np.uint8) if s.regions is not None and label > 0 else np.zeros((1, 1), np.uint8)
            contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
            if contours:
                outline = cv2.approxPolyDP(max(contours, key=cv2.contourArea), 2.0, True)[:, 0].astype(float)
                p = model.vertices[np.unique(model.triangles[model.triangle_facet == f])]
                targets.append((side, f, p, outline))
    before = math.inf
    for iteration in range(iterations):
        if iteration % 20 == 0:                                                 # who sees what, who goes with whom
            cameras, pairs = rig.cameras(T, scale), []
            drawn = [_draw(model, camera).facet for camera in cameras]
            for side, f, p, outline in targets:
                q, camera = cameras[side].project(p), cameras[side]
                inside = (q > -0.5).all(axis=1) & (q < np.array([camera.width, camera.height]) - 0.5).all(axis=1)
                p, q = p[inside], q[inside]
                at = np.rint(q).astype(int)
                shown = np.array([(drawn[side][max(y - 2, 0):y + 3, max(x - 2, 0):x + 3] == f).any() for x, y in at], bool)
                p, q = p[shown], q[shown]
                if len(p):
                    gap = np.linalg.norm(q[:, None] - outline[None], axis=2)
                    near = gap.min(axis=1) < 0.3 * max(np.ptp(outline, axis=0).max(), 10)
                    pairs.append((side, p[near], outline[gap.argmin(axis=1)[near]]))
        H, g, cost, number = np.zeros((6, 6)), np.zeros(6), 0.0, 0
        for side, p, wanted in pairs:
            q, J = _project(rig, side, T, scale, p, True)
            r = q - wanted
            H += np.einsum("nik,nil->kl", J, J)
            g += np.einsum("nik,ni->k", J, r)
            cost, number = cost + (r ** 2).sum(), number + len(p)
        if number < 3:
            break
        error = math.sqrt(cost / number)
        trace[0]["error_px"] = trace[0]["error_px"] or error
        trace.append(_point(trace, T, error, samples=number))
        if iteration % 20 == 19 and error > before * (1 - 1e-3):
            break
        before = error if iteration % 20 == 19 else before
        T = moved(T, -g / np.linalg.eigvalsh(H)[-1])
    return T, trace[-1]["error_px"]


def _covariance(fit):
    """Of the step, by clusters: errors along one edge go together, whatever their cause (lens, light, the model), so each edge is one witness.

    The jackknife over edges: leaving edge e out moves the solution by (H - A_e)^-1 g_e, with A_e and g_e the edge's share of the normal
    matrix and its gradient; the covariance is the sum of the squares (CR3; Bell and McCaffrey 2002). It knows that a long edge bends the
    solution towards itself.
    """
    size = len(fit.H)
    A, g = {}, {}
    for (J, r, w), (edge, _) in zip(fit.parts, fit.at):
        order = np.argsort(edge, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(edge[order])) + 1):
            if len(part):
                e = edge[part[0]]
                A[e] = A.get(e, np.zeros((size, size))) + (w[part, None] * J[part]).T @ J[part]
                g[e] = g.get(e, np.zeros(size)) + (w[part] * r[part]) @ J[part]
    unit = np.sqrt(np.maximum(np.diag(fit.H), 1e-300))
    scaled = np.outer(unit, unit)
    moves = np.array([np.linalg.lstsq((fit.H - A[e]) / scaled, g[e] / unit, rcond=1e-9)[0] for e in g])
    return moves.T @ moves / scaled


def _lens_covariance(fit, rig, T, scale, lens_px):
    """What the cameras' own error adds: principal points known to lens_px, focal lengths so that the corners are, each camera by itself."""
    inverse, total = np.linalg.pinv(fit.H), 0.0
    for side, (s, (J, r, w), (p, normal)) in enumerate(zip(rig.sides, fit.parts, fit.where)):
        q = _project(rig, side, T, scale, p)
        K = s.camera.K
        for change in (np.array([1.0, 0]), np.array([0, 1.0]), (q - K[:2, 2]) / np.hypot(K[0, 2], K[1, 2])):
            move = inverse @ ((w * (normal * change).sum(axis=1)) @ J) * lens_px
            total = total + np.outer(move, move)
    return total


def _witnesses(model, edges, rig, pyramids, T, scale):
    """Per side (q, normal, hit, beside): the predicted visible edges every 5 px, whether an edge is found within 1.5 px, and how often 9 px beside."""
    sides = []
    for side, camera in enumerate(rig.cameras(T, scale)):
        s = visible_samples(model, edges, camera, 1, step_px=5.0, reach=4)
        hit = []
        for shift in (0.0, 9.0, -9.0):
            offset, strength, _ = _find(pyramids[side][1], s.q + shift * s.normal, s.normal, 1.5)
            hit.append((strength > 0) & (np.abs(offset) < 1.5))
        sides.append((s.q, s.normal, hit[0], (hit[1].astype(float) + hit[2]) / 2))
    return sides


def _nats(hits, number, chance):
    """What so many hits are worth against chance: one witness for every 25 px of edge; right poses show at least 0.6 of their edges."""
    return (hits * math.log(0.6 / chance) + (number - hits) * math.log(0.4 / (1 - chance))) / 5


def _evidence(model, edges, rig, pyramids, T, scale):
    """(support, chance, nats): the share of predicted edges found, the share found beside them, and what that is worth."""
    sides = _witnesses(model, edges, rig, pyramids, T, scale)
    number, hits, beside = (sum(f(s) for s in sides) for f in (lambda s: len(s[0]), lambda s: int(s[2].sum()), lambda s: float(s[3].sum())))
    if number == 0:
        return 0.0, 0.0, 0.0
    chance = min(max(beside / number, 0.02), 0.5)
    return hits / number, chance, _nats(hits, number, chance)


def _refuted(best, rival, support, chance, certain):
    """Do the photographs tell two poses apart?  By the edges that only one of them predicts (4 px from any of the other's of its direction).

    The gap must be worth `certain` nats, and what the best pose has of its own must be there as the rest of it is; only where it has next to nothing
    of its own may the rival fall by its own parts alone. A poster that shares two edges with the photographed one makes its room no better
    than a room without, nor than one with yet another poster.
    best, rival : of _witnesses
    """
    from scipy.spatial import cKDTree

    def alone(mine, others):
        hits = number = 0
        for (q, normal, hit, _), (q_other, normal_other, _, _) in zip(mine, others):
            if not len(q):
                continue
            only = np.ones(len(q), bool)
            if len(q_other):
                for i, near in enumerate(cKDTree(q_other).query_ball_point(q, 4.0)):
                    only[i] = not near or np.abs(normal_other[near] @ normal[i]).max() < 0.9
            hits, number = hits + int(hit[only].sum()), number + int(only.sum())
        return hits, number
    (hits, number), (hits_rival, number_rival) = alone(best, rival), alone(rival, best)
    for_best, for_rival = _nats(hits, number, chance), _nats(hits_rival, number_rival, chance)
    return for_best - for_rival >= certain and (hits >= 0.75 * support * number if number >= 20 else for_rival <= -certain)


def refine(model, sides, found, labels=None, *, method="edges", lens_px=0.1, certain=8.0) -> Refined:
    """The recognised poses refined and judged by the photographs.

    sides : Side of the left photograph, and of the right one if there is one
    found : recognition.Recognition, "unique" or "ambiguous"; each of its poses is refined
    labels : (N, 2) of the scene facets' regions, for method "paper"
    lens_px : how well the cameras' own projections are known: it goes into the covariance
    certain : nats by which the photographs must prefer a pose to call the others wrong
    """
    rig = _rig(sides, _depth(model, Camera(sides[0].camera.K, sides[0].camera.width, sides[0].camera.height, found.poses[0].T)))
    free = found.poses[0].covariance.shape == (7, 7)
    edges = model_edges(model)
    pyramids = [_pyramid(side.photograph, 16) for side in sides]
    results = [_refine_one(model, edges, rig, pyramids, pose, free, method, labels, lens_px) for pose in found.poses[:MOST]]
    order = sorted(range(len(results)), key=lambda k: -results[k].evidence)
    best = results[order[0]]
    of = (lambda r: _witnesses(model, edges, _posed(rig, r), pyramids, r.cameras[0].T_cam_world, 1.0)) if len(results) > 1 else None
    witnesses = of(best) if of else None
    others = [results[k] for k in order[1:] if not _refuted(witnesses, of(results[k]), best.support, max(best.chance, 0.02), certain)]
    others = [r for i, r in enumerate(others) if not any(_near(r.cameras[0], s.cameras[0], rig.depth) for s in (best, *others[:i]))]
    status = "ambiguous" if others else "unique"
    if found.status == "unproved" and (others or best.evidence < PROOF or best.support < 0.5):
        status = "not recognised"
    ambiguous = tuple({"rt_cam_world": rt_from_matrix(r.cameras[0].T_cam_world), "support": r.support, "error_px": r.rms_px} for r in others)
    return replace(best, status=status, chosen=order[0], ambiguous=ambiguous)


MOST = 8               # poses that are refined and listed
PROOF = 50.0           # nats of the photographs alone; wrong poses reach 20


def _posed(rig, result):
    """The rig of a result, its lengths in metres."""
    inverse = np.linalg.inv(result.cameras[0].T_cam_world)
    return replace(rig, relative=tuple(camera.T_cam_world @ inverse for camera in result.cameras))


def _near(a, b, depth):
    """Did two starts end at the same pose?"""
    turn = np.linalg.norm(a.T_cam_world[:3, :3] - b.T_cam_world[:3, :3])
    return turn < 0.02 and np.linalg.norm(a.centre - b.centre) < 0.02 * depth


def _rig(sides, depth):
    inverse = np.linalg.inv(sides[0].camera.T_cam_world)
    return _Rig(tuple(sides), tuple(side.camera.T_cam_world @ inverse for side in sides), depth)


def _depth(model, camera):
    """m: the median depth of what the camera would see."""
    small = Camera(np.diag([0.125, 0.125, 1]) @ camera.K, max(camera.width // 8, 1), max(camera.height // 8, 1), camera.T_cam_world)
    depth = _draw(model, small).depth
    return float(np.median(depth[depth > 0])) if (depth > 0).any() else float(np.ptp(model.vertices, axis=0).max())


def _refine_one(model, edges, rig, pyramids, pose, free, method, labels, lens_px):
    """The pose refined, from the finest start to coarser ones until the photographs support one without doubt; else that which they support most."""
    start = _point([], pose.linear, None, step="linear")
    prior = (np.linalg.inv(9 * pose.covariance), pose.T, pose.scale)
    if method == "paper":
        trace = [start]
        T, error = _paper_method(model, rig, pose.T, pose.scale, pose.matches, labels, trace)
        support, chance, evidence = _evidence(model, edges, rig, pyramids, T, pose.scale)
        return Refined(rig.cameras(T, pose.scale), pose.covariance[:6, :6], pose.scale, error, support, chance, evidence, trace)
    wanted, factor, tried = _start_px(rig, pose), 1, []
    while True:
        schedule = [(f, reach) for f in (16, 8, 4, 2, 1) if f <= factor for reach in (8.0, 5.0)]
        trace = [dict(start)]
        T, scale, fit = _edges_method(model, edges, rig, pyramids, pose.T, pose.scale, free, schedule, trace, prior)
        support, _, evidence = _evidence(model, edges, rig, pyramids, T, scale)
        tried.append((evidence, T, scale, trace))
        factor *= 2
        if (support > 0.7 and evidence > PROOF) or factor not in pyramids[0] or 4 * factor > wanted:
            break
    _, T, scale, trace = max(tried, key=lambda t: t[0])
    final = [(1, 3.0), (1, 2.0)]
    if free:
        T, scale, _ = _edges_method(model, edges, rig, pyramids, T, scale, free, final[:1], trace)
        rig, T, scale, fit, held = _each_alone(model, edges, rig, pyramids, T, scale, final, trace)
    else:
        T, scale, fit = _edges_method(model, edges, rig, pyramids, T, scale, free, final, trace)
        held = rig
    support, chance, evidence = _evidence(model, edges, rig, pyramids, T, scale)
    covariance = pose.covariance[:6, :6] if fit is None else (_covariance(fit) + _lens_covariance(fit, held, T, scale, lens_px))[:6, :6]
    return Refined(rig.cameras(T, scale), covariance, scale, _rms(fit.parts) if fit else None, support, chance, evidence, trace)


def _each_alone(model, edges, rig, pyramids, T, scale, schedule, trace):
    """Where the relative pose was estimated from the photographs, up to scale, the model knows it better: each camera goes to its own edges.

    Returns the rig as it was found, the left pose, the scale (m per baseline), the left camera's fit and the rig of that fit.
    """
    poses, fits, rigs = [], [], []
    for side, camera in enumerate(rig.cameras(T, scale)):
        alone = _Rig((rig.sides[side],), (np.eye(4),), rig.depth)
        pose, _, fit = _edges_method(model, edges, alone, pyramids[side:side + 1], camera.T_cam_world, 1.0, False, schedule, trace if side == 0 else trace[:1])
        poses.append(pose), fits.append(fit), rigs.append(alone)
    relative = [pose @ np.linalg.inv(poses[0]) for pose in poses]
    if len(poses) > 1:
        scale = float(np.linalg.norm(relative[1][:3, 3]))
        relative[1][:3, 3] /= scale
    return _Rig(rig.sides, tuple(relative), rig.depth), poses[0], scale, fits[0], rigs[0]


def _start_px(rig, pose):
    """3 sigma of where the pose puts corners and middle of the picture, px."""
    _, x = _view(rig)
    _, J = _project(rig, 0, pose.T, pose.scale, (x - pose.T[:3, 3]) @ pose.T[:3, :3], True)
    C = J @ pose.covariance[:6, :6] @ J.transpose(0, 2, 1)
    return 3 * float(np.sqrt(np.median(np.trace(C, axis1=1, axis2=2))))
