"""Which of many boxes hold a point: near-linear, however many there are, and however long and thin they are."""

import numpy as np

FAN = 4  # boxes in a node, and nodes in the one above
BITS = 16  # of a place along each axis, when boxes are put in an order in which neighbours are near each other
SPREAD = (  # how 16 bits come to stand three apart
    (16, 0x0000FF0000FF),
    (8, 0x00F00F00F00F),
    (4, 0x0C30C30C30C3),
    (2, 0x249249249249),
)


class Boxes:
    """A tree of boxes: along a space-filling curve (Morton's) each FAN are one node, and so on up."""

    def __init__(self, low, high):
        """low, high : (N, 3)"""
        self.low, self.high = low, high
        if len(low) == 0:
            return
        self._order = np.argsort(_along_curve((low + high) / 2), kind="stable")
        self._levels = [(low[self._order], high[self._order])]  # the boxes, then nodes of them, then nodes of nodes
        while len(self._levels[-1][0]) > 2 * FAN:
            below, above = self._levels[-1]
            start = np.arange(0, len(below), FAN)
            self._levels.append((np.minimum.reduceat(below, start), np.maximum.reduceat(above, start)))

    def holding(self, p) -> tuple[np.ndarray, np.ndarray]:
        """Points p (n, 3) and the boxes that hold them: pairs, (k,) numbers of points and (k,) of boxes, sorted."""
        if len(self.low) == 0 or len(p) == 0:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        top = len(self._levels[-1][0])
        point, node = np.repeat(np.arange(len(p)), top), np.tile(np.arange(top), len(p))
        for level, (low, high) in reversed(list(enumerate(self._levels))):
            q = p[point]
            held = ((low[node] <= q) & (q <= high[node])).all(axis=1)
            point, node = point[held], node[held]
            if level:
                point, node = np.repeat(point, FAN), (FAN * node[:, None] + np.arange(FAN)).ravel()
                there = node < len(self._levels[level - 1][0])
                point, node = point[there], node[there]
        box = self._order[node]
        order = np.lexsort((box, point))
        return point[order], box[order]


def _along_curve(p):
    """(n,) places of points (n, 3) along Morton's curve."""
    low, size = p.min(axis=0), np.ptp(p, axis=0).max()
    cell = ((p - low) * ((2**BITS - 1) / max(float(size), 1e-300))).astype(np.int64)
    for shift, mask in SPREAD:
        cell = (cell | cell << shift) & mask
    return cell[:, 0] | cell[:, 1] << 1 | cell[:, 2] << 2
