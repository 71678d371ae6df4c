"""Pieces of the model's visible edges, and where the photograph may have each of them.

A piece is at most 21 px of one edge. The photograph is averaged along it, and every peak of its change across is a
place where the edge may be. Which peak it is depends on the rest of the picture: see likelihood.py.
"""

from dataclasses import dataclass

import numpy as np

from lib.vision.refinement.edges import profiles, visible_samples

STEP_PX, PIECE_PX = 3.0, 21.0
CLAIM_PX, CLAIMED = 1.0, 0.1  # a peak so near to where another object has an edge counts so much less
ALONE_PX = 4.0  # an edge that has another nearer than this may show the other's peak
CREASE_PX, SIDE_PX = 0.4, 4.0
MOST = 3.0  # pieces that one straight edge counts as
REACH_PX = 16.0
GRAIN_PX = 0.5  # of the profile
PEAKS = 6  # at most, of one piece
CONTRAST = 4.0  # times the noise
SMOOTH = np.cos(np.radians(50))  # facets of one group and object that bend by less stand for a curved surface
CLIPPED_PX, CLIPPED_BLUR_PX = 0.5, 0.4  # a pixel that shows a thirtieth of a lamp may be white: the lamp looks larger


@dataclass(frozen=True, eq=False)
class Samples:
    """Points of visible edges.

    p : (N, 3) m, in the given model        q, normal : (N, 2) px        edge, owner, piece : (N,) int
    clear : (N,) px, how far the edge is alone        silhouette : (N,) bool, what lies behind is another object
    smooth : (N,) bool, both sides are of one curved surface: no photograph shows such an edge
    """

    p: np.ndarray
    q: np.ndarray
    normal: np.ndarray
    edge: np.ndarray
    owner: np.ndarray
    piece: np.ndarray
    clear: np.ndarray
    silhouette: np.ndarray
    smooth: np.ndarray


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of edges and the peaks across them.

    edge, owner : (M,) int        px : (M,) length        weight : (M,), at most MOST for all pieces of one edge
    offset : (M, PEAKS) px, along the normal        share : (M, PEAKS), how strong, 0 where there is none
    none : (M,), how likely the edge is at none of them; shares and this add up to 1
    blur : (M, PEAKS) px, how far a peak may lie beside its edge: by what is clipped, by another edge, by shading
    clipped, smooth : (M,) bool
    """

    edge: np.ndarray
    owner: np.ndarray
    px: np.ndarray
    weight: np.ndarray
    offset: np.ndarray
    share: np.ndarray
    none: np.ndarray
    blur: np.ndarray
    clipped: np.ndarray
    smooth: np.ndarray

    def part(self, chosen):
        return Pieces(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def edge_owner(model, edges, span):
    """(E,) the object that an edge moves with: the smallest of those that end there, for it stands on the others."""
    thing = np.append(model.facet_object, -1)[edges.facets]
    size = np.append(span, np.inf)[thing]
    return thing[np.arange(len(thing)), size.argmin(axis=1)]


def lines(edges, owner, near):
    """(E,) the straight line that an edge lies on, by its owner: pieces of one line are one witness."""
    d = edges.b - edges.a
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-300)
    first = np.take_along_axis(d, np.abs(d).argmax(axis=1)[:, None], axis=1)
    d *= np.sign(first)
    foot = edges.a - np.einsum("ij,ij->i", edges.a, d)[:, None] * d
    key = np.column_stack([owner, np.rint(d * 200), np.rint(foot / near)])
    return np.unique(key + 0.0, axis=0, return_inverse=True)[1].reshape(-1)


def samples_of(world, state, model, edges, owner, line) -> Samples:
    """The visible edges of the state's model in its camera.

    model, edges : where the state has them        owner, line : (E,) of the edges
    """
    s = visible_samples(model, edges, world.camera_at(state), 1, step_px=STEP_PX, reach=8)
    mine = owner[s.edge]
    p = s.p.copy()
    for thing, T in state.objects.items():
        there = mine == thing
        p[there] = (p[there] - T[:3, 3]) @ T[:3, :3]
    begins = np.diff(s.edge, prepend=-1) != 0  # samples come edge by edge, in order along each
    number = np.cumsum(begins) - 1
    place = np.arange(len(number)) - np.flatnonzero(begins)[number]
    each = int(PIECE_PX / STEP_PX)
    piece = np.unique(np.column_stack([number, place // each]), axis=0, return_inverse=True)[1].reshape(-1)
    thing = np.append(model.facet_object, -1)[np.maximum(s.sides, -1)]
    behind = (thing[:, 0] != thing[:, 1]) & (s.sides >= -1).all(axis=1)
    return Samples(p, s.q, s.normal, line[s.edge], mine, piece, s.clear, behind, _smooth(model, s.sides))


def _smooth(model, sides):
    """(N,) bool: both facets are of one object and group, and bend little."""
    a, b = np.maximum(sides, 0).T
    alike = (model.facet_object[a] == model.facet_object[b]) & (model.facet_group[a] == model.facet_group[b])
    bend = np.einsum("ni,ni->n", model.facet_normal[a], model.facet_normal[b])
    return (sides >= 0).all(axis=1) & alike & (bend > SMOOTH)


def mean_by(piece, values, count=None):
    """Mean of values (N, ...) by piece."""
    n = int(piece.max()) + 1 if len(piece) else 0
    count = np.bincount(piece, minlength=n) if count is None else count
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    order = np.argsort(piece, kind="stable")
    starts = np.searchsorted(piece[order], np.arange(n))
    total = np.add.reduceat(flat[order], starts, axis=0) if n else flat[:0]
    return (total / count[:, None]).reshape(n, *values.shape[1:])


def pieces_of(samples, level, reach=REACH_PX) -> Pieces:
    """The pieces of samples and what the photograph has around them, within `reach` px."""
    o = GRAIN_PX * np.arange(-int(reach / GRAIN_PX) - 3, int(reach / GRAIN_PX) + 4)
    count = np.bincount(samples.piece)
    first = np.unique(samples.piece, return_index=True)[1]
    edge, owner = samples.edge[first], samples.owner[first]
    profile = profiles(level, samples.q[:, None] + o[None, :, None] * samples.normal[:, None])
    profile = mean_by(samples.piece, profile, count)
    change = np.linalg.norm(profile[:, 4:] - profile[:, :-4], axis=2)  # over two pixels, at o[2:-2]
    light = np.linalg.norm(profile, axis=2)
    light = (light[:, 4:] + light[:, :-4]) / 2 + level.dark
    offset, strength = _peaks(change, light, o[2:-2], CONTRAST * level.noise)
    px = STEP_PX * count
    of_edge = np.bincount(edge, px)[edge] / PIECE_PX
    weight = np.minimum(1, px / PIECE_PX) * np.minimum(1, MOST / np.maximum(of_edge, 1e-9))
    clipped = profile.max(axis=(1, 2)) >= level.white
    bright = light[:, -1] - light[:, 0]
    crowded = np.maximum(ALONE_PX - mean_by(samples.piece, samples.clear, count), 0)
    blur = np.hypot(np.where(clipped, CLIPPED_BLUR_PX, 0.0), crowded / 2)
    blur = np.hypot(blur[:, None], CREASE_PX * _no_step(profile, change, o, offset))
    offset = offset + (clipped * CLIPPED_PX * np.sign(bright))[:, None]
    merit = np.sqrt(strength)
    least = 2 * np.sqrt(CONTRAST * level.noise)
    total = merit.sum(axis=1) + least
    merit = np.where(_claimed(samples, count, owner, offset), CLAIMED * merit, merit)
    share = merit / total[:, None]
    return Pieces(edge, owner, px, weight, offset, share, 1 - share.sum(axis=1), blur, clipped, samples.smooth[first])


def _no_step(profile, change, o, offset):
    """(M, PEAKS) in [0, 1]: 0 where the light at both sides of a peak differs as it changes at the peak.

    Where two walls meet, light falls off towards both, and the greatest change lies beside the corner. A thin dark line
    is no step either.
    """
    at = np.clip(np.rint((offset - o[0]) / GRAIN_PX).astype(int), 2, len(o) - 3)
    row = np.arange(len(offset))[:, None]
    far = int(SIDE_PX / GRAIN_PX)
    left, right = np.maximum(at - far, 0), np.minimum(at + far, len(o) - 1)
    step = np.linalg.norm(profile[row, right] - profile[row, left], axis=2)
    ratio = step / np.maximum(1.25 * change[row, at - 2], 1e-12)  # of a step as blurred as the picture: 1
    return np.clip(np.abs(np.log(np.maximum(ratio, 1e-3))), 0, 1)


def _claimed(samples, count, owner, offset):
    """(M, PEAKS) bool: where an edge of another object is expected already, parallel and nearer than one's own."""
    from scipy.spatial import cKDTree

    if len(owner) == 0:
        return np.zeros(offset.shape, bool)
    middle, normal = mean_by(samples.piece, samples.q, count), mean_by(samples.piece, samples.normal, count)
    near = np.abs(offset) <= CLAIM_PX / 2
    at = np.where(near[..., None], np.inf, middle[:, None] + offset[..., None] * normal[:, None])
    far, which = np.nonzero(~near)
    gap, other = cKDTree(samples.q).query(at[far, which], k=4, distance_upper_bound=np.hypot(CLAIM_PX, STEP_PX))
    found = np.isfinite(gap)
    other = np.where(found, other, 0)
    across = np.einsum("nki,nki->nk", samples.q[other] - at[far, which][:, None], samples.normal[other])
    parallel = np.abs(np.einsum("nki,ni->nk", samples.normal[other], normal[far])) > 0.97
    nearer = np.abs(across) < np.minimum(CLAIM_PX, np.abs(offset[far, which]) / 2)[:, None]
    taken = found & parallel & nearer & (samples.owner[other] != owner[far][:, None])
    claimed = np.zeros(offset.shape, bool)
    claimed[far, which] = taken.any(axis=1)
    return claimed


def _peaks(change, light, o, least):
    """((M, PEAKS) px, (M, PEAKS) contrast, 0 for none): the strongest peaks of each row, between grains by parabola.

    Peaks are those of the light's change. Those of the contrast would lie beside a lamp, on its dark side.
    """
    left, middle, right = change[:, :-2], change[:, 1:-1], change[:, 2:]
    contrast = middle / light[:, 1:-1]
    peak = np.where((middle >= left) & (middle > right) & (contrast > least), contrast, 0)
    best = np.argsort(-peak, axis=1)[:, :PEAKS]
    row = np.arange(len(peak))[:, None]
    bend = left[row, best] - 2 * middle[row, best] + right[row, best]
    shift = np.where(bend < 0, 0.5 * (left - right)[row, best] / np.where(bend < 0, bend, -1), 0)
    return o[1:-1][best] + GRAIN_PX * np.clip(shift, -1, 1), peak[row, best]
