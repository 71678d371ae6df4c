"""Edges of the model that a camera sees, and where the photograph has them."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from lib.buffers import edges as edges_
from lib.buffers import index_buffer, opengl
from lib.given.cameras import Camera

# The photographs, as the search needs them.

SMOOTH_PX = 0.8
STEP_PX, CREASE_PX = 0.1, 0.7  # what places of edges are worth at best: steps, and corners where only shading changes


@dataclass(frozen=True, eq=False)
class Level:
    """A photograph reduced `factor` times: smoothed, in approximately linear light.

    noise : of the contrast between pixels two apart; dark : light below which contrasts fade; white : light that is
    clipped
    """

    picture: np.ndarray
    factor: int
    noise: float
    dark: float
    white: float

    def flipped(self, axes) -> Level:
        """Mirrored from left to right (axis 1), from top to bottom (0), or both."""
        return replace(self, picture=np.ascontiguousarray(np.flip(self.picture, axes)))


def pyramid(photograph, coarsest):
    """{factor: Level} for 1, 2, 4, ... coarsest, of an image.Photograph.

    Light adds up within a pixel, display values do not: an edge of display values would be found up to 0.1 px aside.
    """
    import cv2

    values = photograph.values
    if photograph.linear:
        values, white = values / max(float(np.percentile(values, 99)), 1e-12), math.inf
    else:
        values, white = values**2.2, 0.95  # beside what is clipped an edge looks moved
    levels, factor = {}, 1
    picture = np.ascontiguousarray(values, np.float32)
    dark = 0.05 * float(picture.mean()) + 1e-6  # contrasts are measured against light, and this
    while True:
        smooth = cv2.GaussianBlur(picture, (0, 0), SMOOTH_PX).reshape(*picture.shape[:2], -1)
        contrast = np.linalg.norm(smooth[:, 2:] - smooth[:, :-2], axis=2) / (
            np.linalg.norm(smooth[:, 1:-1], axis=2) + dark
        )
        noise = float(np.median(contrast)) if contrast.size else 0.0
        levels[factor] = Level(smooth, factor, max(noise, 1e-3), dark, white)
        factor *= 2
        if factor > coarsest or min(picture.shape[:2]) < 80:
            return levels
        picture = cv2.resize(picture, (picture.shape[1] // 2, picture.shape[0] // 2), interpolation=cv2.INTER_AREA)


# What the model predicts.


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of facets, one for each place. a, b : (E, 3) m, world; facets : (E, 4) that end there, -1 for none"""

    a: np.ndarray
    b: np.ndarray
    facets: np.ndarray


def model_edges(model) -> Edges:
    """The edges of the model's facets, those at one place once."""
    ends = edges_.facet_edges(model)
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
    return Edges(model.vertices[ends[first, 0]], model.vertices[ends[first, 1]], facets)


@dataclass(frozen=True, eq=False)
class Samples:
    """Points of visible edges.

    p : (N, 3) m, world; q, normal : (N, 2) px; edge : (N,); clear : (N,) px, so far nothing else begins on both sides
    sides : (N, 2) facets that the model shows against the normal and along it, -1 for none
    """

    p: np.ndarray
    q: np.ndarray
    normal: np.ndarray
    edge: np.ndarray
    clear: np.ndarray
    sides: np.ndarray


def draw(model, camera):
    """The index buffer, by OpenGL where there is one."""
    try:
        return index_buffer.draw(model, camera)
    except opengl.NoGraphics:
        return index_buffer.reference(model, camera)


def visible_samples(model, edges, camera, factor=1, step_px=4.0, reach=8) -> Samples:
    """Samples every step_px along the edges that the camera sees, in pixels of the picture reduced `factor` times.

    Rays look at what the model shows beside each sample: a picture of it costs ten times as much.
    """
    K = np.array([[1 / factor, 0, 0.5 / factor - 0.5], [0, 1 / factor, 0.5 / factor - 0.5], [0, 0, 1]]) @ camera.K
    small = Camera(K, camera.width // factor, camera.height // factor, camera.T_cam_world)
    a, b = camera.points(edges.a), camera.points(edges.b)
    begin, end = edges_.clip_to_picture(small, a, b, 1e-3 * max(np.abs(a).max(), 1e-12))
    e = np.flatnonzero(begin < end)
    if len(e) == 0:
        none = np.zeros((0, 2))
        return Samples(np.zeros((0, 3)), none, none, np.zeros(0, int), np.zeros(0), none.astype(int))
    za, zb = (a[e] + s[e, None] * (b[e] - a[e]) for s in (begin, end))
    qa, qb = ((z @ K.T)[:, :2] / z[:, 2:] for z in (za, zb))
    length = np.linalg.norm(qb - qa, axis=1)
    keep = length > 3
    e, za, zb, qa, qb, length = (array[keep] for array in (e, za, zb, qa, qb, length))
    count = np.maximum(1, (length / step_px).astype(int))
    owner = np.repeat(np.arange(len(e)), count)
    t = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[owner]  # in the picture
    q = qa[owner] + t[:, None] * (qb - qa)[owner]
    # along the edge: 1/z is linear in the picture
    s = t * za[owner, 2] / ((1 - t) * zb[owner, 2] + t * za[owner, 2])
    s = begin[e][owner] + s * (end - begin)[e][owner]
    p = edges.a[e][owner] + s[:, None] * (edges.b - edges.a)[e][owner]
    direction = ((qb - qa) / np.maximum(length, 1e-12)[:, None])[owner]
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    probe, own = index_buffer.Probe(model, small), edges.facets[e][owner]
    sides = np.stack([-normal, normal])
    shown, depth = (x.reshape(2, -1) for x in probe.at((q + 1.25 * sides).reshape(-1, 2)))
    mine = [(own == side[:, None]).any(axis=1) & (side >= 0) for side in shown]
    z = 1 / np.maximum(_inverse(t, za, zb, owner), 1e-300)
    clear = _alone(q, normal, owner, z, depth.max(axis=0), reach)
    seen = np.flatnonzero((shown[0] != shown[1]) & (mine[0] | mine[1]) & (clear >= 1))
    clear = np.minimum(clear[seen], _unchanged(probe, small, q[seen], sides[:, seen], shown[:, seen], reach))
    seen, clear = seen[clear >= 1], clear[clear >= 1]
    return Samples(p[seen], q[seen], normal[seen], e[owner][seen], clear, shown[:, seen].T)


def _unchanged(probe, camera, q, sides, shown, reach):
    """(N,) whole px, at most `reach`: how far on both sides nothing else begins, and the picture does not end.

    q : (N, 2) px;  sides : (2, N, 2) unit, away from the edge;  shown : (2, N) facets beside it
    """
    clear = np.full(len(q), float(reach))
    ends = [camera.width - 0.5, camera.height - 0.5]
    for side, facet in zip(sides, shown, strict=True):
        at = q + (np.arange(1, reach + 1)[:, None, None] + 0.25) * side
        same = probe.at(at[1:].reshape(-1, 2))[0].reshape(reach - 1, -1) == facet
        same = np.concatenate([np.ones((1, len(q)), bool), same])
        same &= ((at >= -0.5) & (at < ends)).all(axis=2)
        clear = np.minimum(clear, np.where(same.all(axis=0), reach, (~same).argmax(axis=0)))
    return clear


def _inverse(t, za, zb, owner):
    """1/z along the edges: linear in the picture."""
    return (1 - t) / za[owner, 2] + t / zb[owner, 2]


def _alone(q, normal, edge, z, furthest, reach):
    """(N,) px: how far each sample is from another edge that may be seen, across its own.

    z, furthest : (N,) m, of the sample and of what is seen beside it

    Slivers between places that were looked at have edges too. Edges on one line count as one.
    """
    from scipy.spatial import cKDTree

    front = np.flatnonzero(z <= furthest * 1.02)
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


def profiles(level, at):
    """(N, L, C) of the picture at (N, L, 2) px, between pixels linearly."""
    import cv2

    if len(at) == 0:
        return np.zeros((0, at.shape[1], 1))
    parts = np.array_split(at.astype(np.float32), len(at) // 8000 + 1)  # OpenCV takes at most 32767 rows
    return np.concatenate(
        [
            cv2.remap(
                level.picture, part[..., 0], part[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            ).reshape(len(part), at.shape[1], -1)
            for part in parts
        ]
    )


def find(level, q, normal, reach):
    """Along each normal, within `reach` px: (offset, strength, doubt), strength 0 where nothing rises above the noise.

    The greatest change of colour, near ones favoured, its place by a parabola. doubt : in [0, 1], how nearly another
    one would have won. level : Level; q, normal : (N, 2) px; reach : px
    """
    step = 0.5
    half = int(math.ceil(reach / step))
    o = step * np.arange(-half - 2, half + 3)
    at = q[:, None] + o[None, :, None] * normal[:, None]
    profile = profiles(level, at)
    change = profile[:, 4:] - profile[:, :-4]  # over two pixels, at o[2:-2]
    M = np.linalg.norm(change, axis=2)  # (N, 2 half + 1)
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


def locate(level, q, normal, clear, ramp=1.0):
    """Along each normal, within 2 px: (offset, sigma px, strength), strength 0 where there is no edge to be placed.

    level : Level; q, normal : (N, 2) px; clear : (N,) px, how far the edge is alone; ramp : px, blur of the picture

    The profile is compared with every step and crease: a + b x + c S(x - x0) + d R(x - x0), S a step and R a ramp as
    blurred as the picture. A step alone would not do: where two walls meet, light falls off towards both, and the
    greatest change lies a pixel beside the corner. Least squares over all channels, x0 by a parabola, sigma from the
    curvature. The window is as wide as the edge is alone.
    """
    N = len(q)
    offset, sigma, strength = np.zeros(N), np.full(N, np.inf), np.zeros(N)
    if N == 0:
        return offset, sigma, strength
    step = 0.5
    o = step * np.arange(-8, 9)
    at = q[:, None] + o[None, :, None] * normal[:, None]
    profile = profiles(level, at)
    profile = profile.transpose(0, 2, 1).astype(float)  # (N, C, L)
    for width, low, high in ((4, 4, math.inf), (3, 3, 4), (2, 1.8, 3)):
        mine = np.flatnonzero((clear >= low) & (clear < high))
        if len(mine) == 0:
            continue
        inside = np.abs(o) <= width
        Q, x0 = _templates(width, ramp, step)
        y = profile[mine][:, :, inside]
        light = np.linalg.norm(y.mean(axis=2), axis=1) + level.dark
        y = y / light[:, None, None]
        whole = (y**2).sum(axis=(1, 2))
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
        noise = np.maximum((whole - b) / freedom, 1e-7) * 4  # neighbours share their noise: interpolation, smoothing
        good = (
            (best == k)
            & (bend < 0)
            & (b - straight > 30 * noise)
            & (profile[mine][:, :, inside].max(axis=(1, 2)) < level.white)
        )
        bend = np.where(good, bend, -1)
        offset[mine] = x0[k] + np.where(good, np.clip(0.5 * (a - c) / bend, -1, 1) * d, 0)
        # A step is where it is; a crease is what light makes of it, and light curves.
        crease = 1 - np.clip(parts[i, k, 3] / np.maximum(b - straight, 1e-12), 0, 1)
        sigma[mine] = np.where(good, np.sqrt(2 * noise / (-bend / d**2) + (CREASE_PX * crease) ** 2), np.inf)
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
