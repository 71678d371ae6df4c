"""§2.4 The non-linear refinement: the pose that puts the model's visible edges on the edges of both photographs.

    result = refine(model, sides, found)            # found : recognition.Recognition

From a pose the index buffer says which edges each camera sees. Samples along them search the photograph along
their normals for the greatest change, at sub-pixel; the pose (six numbers: the pair's relative pose is
fixed; seven where its scale is unknown) that brings the samples onto what they found comes from
Levenberg-Marquardt steps with a robust loss. From coarse pictures to fine ones, with new visibility at every step.

The paper moves the corners of facets onto the corners of their regions by plain gradient descent: method "paper".
"""

import math
from dataclasses import dataclass

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
    trace : list of dict              iteration, step, error_px, rt_cam_world, ...
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


@dataclass(frozen=True, eq=False)
class _Level:
    """A photograph reduced `factor` times: smoothed, in approximately linear light. noise : of the difference over one pixel"""

    picture: np.ndarray
    factor: int
    noise: float


def _pyramid(photograph, coarsest):
    """{factor: _Level} for 1, 2, 4, ... coarsest. Light adds up within a pixel, display values do not: an edge of display values would be found up to 0.1 px aside."""
    import cv2

    values = photograph.values
    if photograph.linear:
        values = np.clip(values / max(float(np.percentile(values, 99)), 1e-12), 0, 2)
    else:
        values = values ** 2.2
    levels, factor = {}, 1
    picture = np.ascontiguousarray(values, np.float32)
    while True:
        smooth = cv2.GaussianBlur(picture, (0, 0), SMOOTH_PX)
        smooth = smooth.reshape(*picture.shape[:2], -1)
        # the square root makes dark edges count: it changes places of edges little once they are smooth
        difference = smooth[:, 2:] - smooth[:, :-2]
        noise = float(np.median(np.linalg.norm(difference, axis=2))) if difference.size else 0.0
        levels[factor] = _Level(smooth, factor, max(noise, 1e-4))
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
    facet = _draw(model, small).facet
    a, b = camera.points(edges.a), camera.points(edges.b)
    # the part before the camera and inside the picture: five half-spaces, linear along the edge
    W, H = small.width, small.height
    near = 1e-3 * max(np.abs(a).max(), 1e-12)
    begin, end = np.zeros(len(a)), np.ones(len(a))
    for plane in (np.array([*(K[0] + [0, 0, 0.5]), 0]), np.array([*([0, 0, W - 0.5] - K[0]), 0]), np.array([*(K[1] + [0, 0, 0.5]), 0]),
                  np.array([*([0, 0, H - 0.5] - K[1]), 0]), np.array([0, 0, 1, -near])):
        fa, fb = a @ plane[:3] + plane[3], b @ plane[:3] + plane[3]
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = fa / (fa - fb)
        begin = np.where((fa < 0) & (fb >= 0), np.maximum(begin, cut), begin)
        end = np.where((fa >= 0) & (fb < 0), np.minimum(end, cut), end)
        end = np.where((fa < 0) & (fb < 0), -1, end)
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
    seen = (shown[0] != shown[1]) & (mine[0] | mine[1]) & (clear >= 1)
    return Samples(p[seen], q[seen], normal[seen], e[owner][seen], clear[seen])


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
    peak = np.zeros_like(M, bool)
    peak[:, 1:-1] = (M[:, 1:-1] >= M[:, :-2]) & (M[:, 1:-1] > M[:, 2:]) & (M[:, 1:-1] > 5 * level.noise)
    merit = np.where(peak, np.sqrt(M) * np.exp(-0.5 * (inner / (0.6 * reach + 0.5)) ** 2), 0)
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
    return offset, np.where(won > 0, M[i, best], 0), np.where(won > 0, other / np.where(won > 0, won, 1), 1)


# Levenberg-Marquardt on one set of correspondences.

@dataclass(frozen=True, eq=False)
class _Rig:
    """The pair, fixed: K and T_side_left of each side (the translation in units of the facets)."""

    sides: tuple
    relative: tuple

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


def _solve(rig, T, scale, found, sigma, free, prior=None, iterations=6):
    """LM on correspondences: found = [(p, q, normal, offset, weight)] per side; Geman-McClure loss of width 2 sigma. prior : (H, T0, scale0) or None.

    Returns T, scale, and per side residuals and robust weights, and the normal matrix."""
    size = 7 if free else 6
    width = 2.5 * sigma

    def linearise(T, scale, jacobian):
        H, b, cost, parts = np.zeros((size, size)), np.zeros(size), 0.0, []
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

def _edges_method(model, edges, rig, pyramids, T, scale, free, start_px, trace, step, fine=True):
    """From coarse to fine; appends to trace; returns T, scale and the last _Fit."""
    factor = 1
    while 8 * factor < start_px and 2 * factor in pyramids[0]:
        factor *= 2
    schedule = []
    while factor > 1:
        schedule += [(factor, 8.0), (factor, 5.0)]
        factor //= 2
    schedule += [(1, 8.0), (1, 5.0), (1, 3.0)]
    if fine:
        schedule += [(1, 2.0)] * 2
    last = None
    for number, (factor, reach) in enumerate(schedule):
        most = 12 if number == len(schedule) - 1 else 5
        drawn = None
        for iteration in range(most):
            cameras = rig.cameras(T, scale)
            if drawn is None or _moved_px(rig, drawn, T, scale) > 0.3 * factor:
                samples = [visible_samples(model, edges, camera, factor, step_px=3.0, reach=int(reach) + 1) for camera in cameras]
                drawn = (T, scale)
            found, at = [], []
            for side, (camera, s) in enumerate(zip(cameras, samples)):
                level = pyramids[side][factor]
                q_full = _project(rig, side, T, scale, s.p)
                q = (q_full + 0.5) / factor - 0.5
                offset, strength, doubt = _find(level, q, s.normal, reach)
                limit = np.minimum(reach, np.maximum(s.clear, 1.5)) if factor == 1 and reach <= 3 else reach
                good = (strength > 0) & (np.abs(offset) < limit) & (doubt < 0.9)
                weight = (1 - doubt ** 2) * np.minimum(s.clear / 3, 1)
                found.append((s.p[good], q_full[good], s.normal[good], factor * offset[good], weight[good]))
                at.append((s.edge[good], len(s.q)))
            r = np.concatenate([f[3] for f in found])
            if len(r) < 20:
                return T, scale, last
            sigma = max(1.4826 * float(np.median(np.abs(r))), 0.08 * factor)
            before = T
            T, scale, H, parts = _solve(rig, T, scale, found, sigma, free)
            last = _Fit(H, parts, at, sigma, sum(n for _, n in at))
            trace.append({"iteration": len(trace), "step": step, "error_px": _rms(parts), "factor": factor, "samples": len(r), "rt_cam_world": rt_from_matrix(T)})
            if _moved_px(rig, (before, scale), T, scale) < (0.02 if number == len(schedule) - 1 else 0.1) * factor:
                break
    return T, scale, last


@dataclass(frozen=True, eq=False)
class _Fit:
    H: np.ndarray
    parts: list
    at: list
    sigma: float
    predicted: int


def _rms(parts):
    total = sum((w * r ** 2).sum() for _, r, w in parts)
    return float(math.sqrt(total / max(sum(w.sum() for _, _, w in parts), 1e-12)))


def _moved_px(rig, old, T, scale):
    """How far the picture's corners and middle, at the scene's depth, move between two poses, px (largest)."""
    T0, scale0 = old
    camera = rig.sides[0].camera
    depth = max(np.linalg.norm(T[:3, 3] - T0[:3, 3]), 1.0) * 3
    q = np.array([[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height], [camera.width / 2, camera.height / 2]], float)
    x = camera.directions(q) * depth
    p = (x - T0[:3, 3]) @ T0[:3, :3]
    return float(np.abs(_project(rig, 0, T, scale, p) - q).max())


def _covariance(fit):
    """Of the step, by clusters: errors along one edge go together, whatever their cause (lens, light, the model), so each edge is one witness.

    The sandwich H^-1 (sum over edges g g^T) H^-1 with g the edge's gradient (Liang and Zeger 1986), times E / (E - p).
    """
    size = len(fit.H)
    g = {}
    for (J, r, w), (edge, _) in zip(fit.parts, fit.at):
        for e in np.unique(edge):
            mine = edge == e
            g[e] = g.get(e, np.zeros(size)) + (w[mine] * r[mine]) @ J[mine]
    G = np.array(list(g.values()))
    inverse = np.linalg.pinv(fit.H, rcond=1e-14)
    E = len(G)
    return inverse @ (G.T @ G) @ inverse * (E / max(E - size, 1))


def _evidence(model, edges, rig, pyramids, T, scale):
    """(support, chance, nats): the share of predicted edges found within 1.5 px, the share found beside them, and what that is worth.

    One witness for every 25 px of edge; right poses show at least 0.6 of their edges, beside edges only chance does.
    """
    hit, anywhere, number = 0, 0, 0
    for side, camera in enumerate(rig.cameras(T, scale)):
        s = visible_samples(model, edges, camera, 1, step_px=5.0, reach=4)
        for shift in (0.0, 9.0, -9.0):
            offset, strength, _ = _find(pyramids[side][1], s.q + shift * s.normal, s.normal, 1.5)
            there = int(((strength > 0) & (np.abs(offset) < 1.5)).sum())
            if shift:
                anywhere += there / 2
            else:
                hit += there
        number += len(s.q)
    if number == 0:
        return 0.0, 0.0, 0.0
    f, f0 = hit / number, min(max(anywhere / number, 0.02), 0.5)
    return f, f0, number / 5 * (f * math.log(0.6 / f0) + (1 - f) * math.log(0.4 / (1 - f0))) if f0 < 0.6 else 0.0


def refine(model, sides, found, *, method="edges", certain=8.0) -> Refined:
    """The recognised poses refined and judged by the photographs.

    sides : Side of the left photograph, and of the right one if there is one
    found : recognition.Recognition, "unique" or "ambiguous"; each of its poses is refined
    certain : nats by which the photographs must prefer a pose to call the others wrong
    """
    rig = _rig(sides)
    free = found.poses[0].covariance.shape == (7, 7)
    edges = model_edges(model)
    results = []
    for pose in found.poses[:6]:
        results.append(_refine_one(model, edges, rig, sides, pose, free, method))
    order = sorted(range(len(results)), key=lambda k: -results[k].evidence)
    best = results[order[0]]
    others = [k for k in order[1:] if results[k].evidence > best.evidence - certain and not _near(results[k].cameras[0], best.cameras[0], found.poses[order[0]])]
    ambiguous = [{"rt_cam_world": rt_from_matrix(results[k].cameras[0].T_cam_world), "support": results[k].support, "error_px": results[k].rms_px} for k in others]
    from dataclasses import replace
    return replace(best, status="ambiguous" if ambiguous else "unique", chosen=order[0], ambiguous=ambiguous)


def _near(a, b, pose):
    """Did two starts end at the same pose?"""
    turn = np.linalg.norm(a.T_cam_world[:3, :3] - b.T_cam_world[:3, :3])
    return turn < 0.02 and np.linalg.norm(a.centre - b.centre) < 0.02 * np.linalg.norm(pose.T[:3, 3])


def _rig(sides):
    inverse = np.linalg.inv(sides[0].camera.T_cam_world)
    return _Rig(tuple(sides), tuple(side.camera.T_cam_world @ inverse for side in sides))


def _refine_one(model, edges, rig, sides, pose, free, method):
    T, scale = pose.T, pose.scale
    start_px = _start_px(rig, pose)
    pyramids = [_pyramid(side.photograph, 16) for side in sides]
    trace = [{"iteration": 0, "step": "linear", "error_px": None, "rt_cam_world": rt_from_matrix(pose.linear)}]
    T, scale, fit = _edges_method(model, edges, rig, pyramids, T, scale, free, start_px, trace, "refined")
    support, chance, evidence = _evidence(model, edges, rig, pyramids, T, scale)
    covariance = _covariance(fit)[:6, :6] if fit is not None else pose.covariance[:6, :6]
    return Refined(rig.cameras(T, scale), covariance, scale, _rms(fit.parts) if fit else float("nan"), support, chance, evidence, trace)


def _start_px(rig, pose):
    """3 sigma of where the pose puts points of the picture at the scene's depth, px."""
    camera = rig.sides[0].camera
    depth = 3.0
    q = np.array([[0.0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]])
    x = camera.directions(q) * depth
    p = (x - pose.T[:3, 3]) @ pose.T[:3, :3]
    _, J = _project(rig, 0, pose.T, pose.scale, p, True)
    C = J @ pose.covariance[:6, :6] @ J.transpose(0, 2, 1)
    return 3 * float(np.sqrt(np.median(np.trace(C, axis1=1, axis2=2))))
