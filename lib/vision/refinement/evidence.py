"""What the photographs' edges say for and against a pose, in nats."""

import math

import numpy as np

from lib.vision.refinement.edges import find, visible_samples


def witnesses_of(model, edges, rig, pyramids, T, scale):
    """Per side the predicted visible edges every 5 px: (q, normal, hit, beside).

    q, normal : (N, 2) px; hit : (N,) bool, an edge is found within 1.5 px; beside : (N,), how often 9 px beside
    """
    sides = []
    for side, camera in enumerate(rig.cameras(T, scale)):
        s = visible_samples(model, edges, camera, 1, step_px=5.0, reach=4)
        hit = []
        for shift in (0.0, 9.0, -9.0):
            offset, strength, _ = find(pyramids[side][1], s.q + shift * s.normal, s.normal, 1.5)
            hit.append((strength > 0) & (np.abs(offset) < 1.5))
        sides.append((s.q, s.normal, hit[0], (hit[1].astype(float) + hit[2]) / 2))
    return sides


SUPPORTS = np.arange(0.5, 0.96, 0.05)  # shares of its edges that a right pose may show, all as likely
APART = 5  # samples that are one witness: one for every 25 px of edge


def nats_of(hits, number, chance):
    """What so many hits are worth against chance, where a right pose shows an unknown share of its edges."""
    each = hits * np.log(SUPPORTS / chance) + (number - hits) * np.log((1 - SUPPORTS) / (1 - chance))
    return float(np.logaddexp.reduce(each / APART) - math.log(len(SUPPORTS)))


def _nats_at_least(hits, number, chance, support=0.6):
    """The same for a share that is known; low, so that a few edges that are missing refute nothing."""
    return (hits * math.log(support / chance) + (number - hits) * math.log((1 - support) / (1 - chance))) / APART


def evidence_of(model, edges, rig, pyramids, T, scale):
    """(support, chance, nats): the share of predicted edges found, the share found beside them, what that is worth."""
    sides = witnesses_of(model, edges, rig, pyramids, T, scale)
    number = sum(len(q) for q, _, _, _ in sides)
    hits = sum(int(hit.sum()) for _, _, hit, _ in sides)
    beside = sum(float(beside.sum()) for _, _, _, beside in sides)
    if number == 0:
        return 0.0, 0.0, 0.0
    chance = min(max(beside / number, 0.02), 0.5)
    return hits / number, chance, nats_of(hits, number, chance)


def refuted(best, rival, support, chance, certain):
    """Do the photographs refute the rival, by the edges that only one of two poses predicts?

    best, rival : of `witnesses_of`; support : share of the best pose's edges that are found; chance : share found
    anywhere; certain : nats. An edge is a pose's own if the other has none of its direction within 4 px.

    The gap must be worth `certain` nats, and the best pose's own edges must be found nearly as often as the rest of its
    edges are. Only where it has next to no own edges may the rival fall by its own alone. So a poster that shares two
    edges with the photographed one makes its room no better than a room without, nor than one with another poster.
    """
    from scipy.spatial import cKDTree

    def alone(mine, others):
        hits = number = 0
        for (q, normal, hit, _), (q_other, normal_other, _, _) in zip(mine, others, strict=True):
            if not len(q):
                continue
            only = np.ones(len(q), bool)
            if len(q_other):
                for i, near in enumerate(cKDTree(q_other).query_ball_point(q, 4.0)):
                    only[i] = not near or np.abs(normal_other[near] @ normal[i]).max() < 0.9
            hits, number = hits + int(hit[only].sum()), number + int(only.sum())
        return hits, number

    (hits, number), (hits_rival, number_rival) = alone(best, rival), alone(rival, best)
    for_best, for_rival = _nats_at_least(hits, number, chance), _nats_at_least(hits_rival, number_rival, chance)
    return for_best - for_rival >= certain and (
        hits >= 0.75 * support * number if number >= 20 else for_rival <= -certain
    )
