"""Surfaces: regions whose common border is no border of anything.

Equation 2.1 has regions of one colour, so it cuts a wall along levels of its shading, and elsewhere in the left and in
the right photograph. Such a border has no step: beside it both sides are one ramp. In windows along each border the
pixels of both sides are fitted by a common gradient and a step between them (least squares). Neighbours merge, those
with the fewest steps first, while less than a quarter of their border shows one, or less than half of it and none on
average: a border lies where the noise happens to step, so some of its windows pass.

Borders lie where the noise steps most, and the more so the more of it neighbours share, as JPEG's do. So steps of a
JPEG are measured on a grid that knows nothing of the picture too: what those spread is noise, and a small step counts
only far above it. (In pictures without JPEG that joins walls that meet in a faint edge: docs/decisions/jpeg.md.)

A region that spans two planes draws them together. At the lambda of noise alone (segmentation.auto_lambda) there are
fewest of those, and merging takes away what it cuts too much: tests/bench, surfaces.
"""

import heapq

import numpy as np

from lib.vision import surfaces_kernels as kernels
from lib.vision.segmentation import noise

WINDOW = 14  # px along a border
SURE = 4.0  # standard deviations of a step that counts
SURE_SMALL, CLEAR = 8.0, 0.04  # in a JPEG, of one below so much (display), in those of steps that are noise
CELL = 20  # px: side of the grid's squares
FEWEST = 30  # windows that tell of it
NOTHING = 1e-9  # display: the sums' rounding
TIMES_RAMP, TIMES_NOISE, LEAST = 2.5, 0.6, 0.006  # and its size: change per px of the ramp, noise, display
SHARE = 0.25  # of a border that may show a step where the neighbours merge
SHORTEST = 8  # px of a border that says anything
UNSEEN = 2  # px with a step that every border is given: long borders without one go before short ones


def surfaces(picture, labels, compressed=False) -> np.ndarray:
    """(H, W) int32: each pixel's surface, by the smallest label of its regions (data/SCENE.md, section 4).

    picture : (H, W, C) in [0, 1];  labels : (H, W) of its regions, from 1;  compressed : it was a JPEG
    """
    f = np.ascontiguousarray(picture, np.float64)
    labels = np.ascontiguousarray(labels, np.int64)
    return _merged(_borders(f, labels, compressed), int(labels.max()))[labels]


def _borders(f, labels, compressed):
    """{(a, b): (2 + 2 C,)} of the border between neighbours a < b: its px, those with a step, and the sums over px of
    the steps from a to b and of what would count as one."""
    rows, first, count = _windows(labels)
    step, sigma, ramp = kernels.steps(f, labels, rows, first, count).transpose(1, 0, 2)
    least = np.maximum(np.maximum(TIMES_RAMP * ramp, TIMES_NOISE * noise(f)), LEAST)
    sure = SURE * sigma
    if compressed:
        sure = np.maximum(sure, np.minimum(SURE_SMALL * noise_of_steps(f) * sigma, CLEAR))
    known = np.isfinite(step).all(axis=1)[:, None]
    is_step = ~known[:, 0] | ((np.abs(step) > sure) & (np.abs(step) > least)).any(axis=1)
    sums = np.column_stack([np.ones(len(step)), is_step, np.where(known, step, 0), np.where(known, least, 0)])
    sums *= count[:, None]
    found = {}
    for (a, b), window in zip(rows[first, :2].tolist(), sums, strict=True):
        found[a, b] = found.get((a, b), 0) + window
    return found


def _windows(labels):
    """(rows, first, count) for kernels.steps: the pairs of pixels of all borders, and where each window's begin."""
    rows = kernels.borders(labels, WINDOW)
    rows = rows[np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))]
    first = np.flatnonzero((np.diff(rows[:, :3], axis=0, prepend=-1) != 0).any(axis=1))
    return rows, first, np.diff(np.append(first, len(rows)))


def noise_of_steps(f) -> np.ndarray:
    """(C,) spread of steps that are noise, in the standard deviations that white noise would give them: at least 1.

    Their borders are the sides of a grid's squares, so few meet an edge. White noise spreads them 1.0 to 1.1, JPEG 1.2
    (quality 100), 1.3 (95), 1.6 (90) to 2.5 (75).
    """
    y, x = np.indices(f.shape[:2]) // CELL
    grid = (1 + y * (x.max() + 1) + x).astype(np.int64)
    step, sigma, _ = kernels.steps(f, grid, *_windows(grid)).transpose(1, 0, 2)
    told = np.isfinite(sigma).all(axis=1)
    if told.sum() < FEWEST:
        return np.ones(f.shape[2])
    step, sigma = np.abs(step[told]), sigma[told]
    in_sigma = np.divide(step, sigma, out=np.zeros_like(step), where=sigma > NOTHING)  # one value, black or white
    return np.maximum(np.median(in_sigma, axis=0) / 0.6745, 1)


def _share(border) -> float:
    """Share of a border, of _borders(), that shows a step: higher while few px tell, half where none is on average."""
    step, least = np.split(np.abs(border[2:]), 2)
    share = (border[1] + UNSEEN) / (border[0] + UNSEEN)
    return share / 2 if (step < least).all() else share


def _merged(borders, n):
    """(n + 1,) int32 smallest label of the regions that each is merged with."""
    toward = np.ones(len(next(iter(borders.values()), ())))
    toward[2 : 1 + len(toward) // 2] = -1  # steps have a sign
    around = [{} for _ in range(n + 1)]  # label -> their border, from here to there
    for (a, b), border in borders.items():
        around[a][b], around[b][a] = border, toward * border
    queue = [(_share(border), a, b) for (a, b), border in borders.items() if border[0] >= SHORTEST]
    heapq.heapify(queue)
    into = np.arange(n + 1)
    while queue and queue[0][0] < SHARE:
        told, a, b = heapq.heappop(queue)
        if b not in around[a] or told != _share(around[a][b]):
            continue  # merged meanwhile, or another border by now
        if len(around[a]) < len(around[b]):
            a, b = b, a
        into[b] = a
        del around[a][b], around[b][a]
        for c, border in around[b].items():
            del around[c][b]
            joint = around[a].get(c, 0) + border
            around[a][c], around[c][a] = joint, toward * joint
            if joint[0] >= SHORTEST:
                heapq.heappush(queue, (_share(joint), min(a, c), max(a, c)))
        around[b] = {}
    for k in range(n + 1):
        while into[k] != into[into[k]]:
            into[k] = into[into[k]]
    smallest = np.full(n + 1, n, np.int32)
    np.minimum.at(smallest, into, np.arange(n + 1, dtype=np.int32))
    return smallest[into]


def warm_up():
    """Compile, or load, the kernels."""
    kernels.grow(np.ones((2, 2), np.int32), np.array([[0, -1], [1, -1]]))
    picture = np.linspace(0, 1, 24 * 24).reshape(24, 24, 1)
    surfaces(picture, 1 + (np.arange(24) >= 12) * np.ones((24, 1), np.int64))
