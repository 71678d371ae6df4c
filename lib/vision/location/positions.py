"""Where a camera of known rotation stands: places all over the room are compared by the straight edges.

    room = Room.of(model, edges, cameras)          # places, and which edges each of them sees
    for start in search(room, photograph, segments, camera, turns): ...

The room is what the posed cameras see, and the places lie on a grid in it. At each the model's visible edges are laid
on the photograph's segments of the same direction; what lies there beyond chance counts. The best are compared on finer
and finer grids.
"""

from typing import NamedTuple

import numpy as np

from lib.given.rays import Caster, Local
from lib.vision.location import positions_kernels as kernels
from lib.vision.location.features import Start

PLACES = 4000
SAMPLES = 600
BINS = 12  # of directions
SHRINK = 4  # px of the photograph to one of a field
REACH_PX = (16.0, 8.0, 4.0)  # within which an edge lies on a segment: on the first grid, and on finer ones
BEST, KEPT = 48, 12  # that are compared on finer grids, that remain
FINER = np.stack(np.meshgrid(*3 * [np.arange(-2, 3)], indexing="ij"), axis=-1).reshape(-1, 3) / 4


class Room(NamedTuple):
    """Samples of edges, and what is seen of them from the places of a grid.

    p, along : (s, 3) m, unit;  weight : (s,) m;  places : (c, 3) m;  cell : (3,) m between them;  visible : (c, s) bool
    caster, local : of the model
    """

    p: np.ndarray
    along: np.ndarray
    weight: np.ndarray
    places: np.ndarray
    cell: np.ndarray
    visible: np.ndarray
    caster: Caster
    local: Local

    @classmethod
    def of(cls, model, edges, shown):
        """shown : (n, 3) m, places of the model that the posed photographs show, and their cameras' centres"""
        low, high = shown.min(axis=0), shown.max(axis=0)
        p, along, weight = _samples(edges, low, high)
        size = np.maximum(high - low, 1e-6)
        step = (np.prod(size) / PLACES) ** (1 / 3)
        count = np.maximum(1, np.ceil(size / step)).astype(int)
        cell = size / count
        grid = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in count), indexing="ij"), axis=-1).reshape(-1, 3)
        local = Local.of(model)
        caster = Caster(local.points(model.corners()))
        places = low + grid * cell
        return cls(p, along, weight, places, cell, seen_from(caster, local, places, p), caster, local)

    def sees(self, places):
        """(c, s) bool: which samples are seen from other places (c, 3) m."""
        return seen_from(self.caster, self.local, places, self.p)


def _samples(edges, low, high):
    """Points along the edges inside a box, about SAMPLES of them, with their share of the length."""
    inside = ((np.minimum(edges.a, edges.b) < high) & (np.maximum(edges.a, edges.b) > low)).all(axis=1)
    a, b = edges.a[inside], edges.b[inside]
    length = np.linalg.norm(b - a, axis=1)
    step = max(length.sum() / SAMPLES, 1e-9)
    count = np.maximum(1, np.rint(length / step)).astype(int)
    edge = np.repeat(np.arange(len(count)), count)
    s = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[edge]
    along = (b - a) / np.maximum(length, 1e-12)[:, None]
    return a[edge] + s[:, None] * (b - a)[edge], along[edge], (length / count)[edge]


def seen_from(caster, local, places, p):
    """(c, s) bool: from each place, the samples before which nothing stands."""
    o, target = local.points(places), local.points(p)
    out = np.zeros((len(o), len(p)), bool)
    for part in np.array_split(np.arange(len(o)), len(o) * len(p) // 2_000_000 + 1):
        way = target[None] - o[part, None]
        rays = np.concatenate([np.broadcast_to(o[part, None], way.shape), way], axis=2)
        hidden = caster.occluded(rays.reshape(-1, 6).astype(np.float32), 0.995)
        out[part] = ~hidden.reshape(len(part), -1)
    return out


def field_of(segments, width, height, reach_px) -> kernels.Field:
    """The straight edges of a photograph, by direction.  segments : (n, 2, 2) px"""
    import cv2

    h, w = -(-height // SHRINK), -(-width // SHRINK)
    way = segments[:, 1] - segments[:, 0]
    angle = np.arctan2(way[:, 1], way[:, 0]) / np.pi % 1 * BINS
    near = np.zeros((BINS, h, w), np.float32)
    for b in range(BINS):
        off = np.abs((angle - b + BINS / 2) % BINS - BINS / 2)
        drawn = np.full((h, w), 255, np.uint8)
        for one in segments[off < 1.0]:
            ends = np.rint(16 * ((one + 0.5) / SHRINK - 0.5)).astype(int)
            cv2.line(drawn, tuple(map(int, ends[0])), tuple(map(int, ends[1])), 0, 1, cv2.LINE_8, 4)
        if drawn.min() == 0:
            far = cv2.distanceTransform(drawn, cv2.DIST_L2, 3) * SHRINK / reach_px
            near[b] = np.maximum(1 - far**2, 0)
    return kernels.Field(near, near.mean(axis=(1, 2)).astype(np.float64), float(SHRINK))


def search(room, segments, camera, turns) -> list[Start]:
    """The best places for each of some rotations, best first.  camera : Camera, of which K and the size count"""
    fields = [field_of(segments, camera.width, camera.height, reach) for reach in REACH_PX]
    found = []
    for turn in turns:
        score = kernels.scores(fields[0], camera.K, turn.R, room.places, room.p, room.along, room.weight, room.visible)
        best = np.argsort(-score)[:BEST]
        found += [(float(score[k]), turn.R, room.places[k]) for k in best]
    found = sorted(found, key=lambda f: -f[0])[:BEST]
    cell = room.cell
    for field in fields[1:]:
        finer = []
        for _, R, place in found:
            around = place + FINER * cell
            score = kernels.scores(field, camera.K, R, around, room.p, room.along, room.weight, room.sees(around))
            k = int(score.argmax())
            finer.append((float(score[k]), R, around[k]))
        cell = cell / 4
        found = _different(sorted(finer, key=lambda f: -f[0]), room.cell)
    starts = []
    for score, R, place in found[:KEPT]:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, -R @ place
        starts.append(Start(T, float(camera.K[0, 0]), score))
    return starts


def _different(found, cell):
    """Without those that a better one is near to."""
    kept = []
    for one in found:
        if all(np.linalg.norm(one[1] - R) > 0.05 or (np.abs(one[2] - c) > 0.5 * cell).any() for _, R, c in kept):
            kept.append(one)
    return kept
