"""Does a side of an outline go on beyond the region's corner? Then it is of what lies on its other side.

A leg of a table hides part of a wall, and further down part of the floor: its edge is a straight line past the corner
at which the wall ends, with the leg's colour to one side all along and another colour to the other side. Such a
T-junction says that what goes on lies in front of both things that end at it (Guzman 1968). So the side is not the
wall's, whatever plane agrees with it.

A region may also end at its own shadow, in the same colour but darker. So greys before greys, and photographs of one
channel, tell no junctions.
"""

import numpy as np

from lib.vision.facets.contours_kernels import NORMAL_U, NORMAL_V, PART, U, V

BESIDE = 3.0  # px to either side, where the colours are taken
BEYOND = 3, 15  # px past the corner, at most as far as half of the side is long
LEAST_PX = 6  # shortest side, and the least that is looked at beyond it
SAME = 0.35  # of the contrast: colours that differ by less are the same
CONTRAST = 0.3, 5.0  # an edge beyond the corner: times the contrast of the side, times the noise
ON_LINE = 1.3  # px, the steepest place beyond the corner from the side's line
ACROSS = np.arange(-4, 4.5, 0.5)  # px, where that place is sought
GAMMA = 2.2  # of display values, roughly: only ratios of colours are asked
HUE = 0.02  # of itself: colours that differ by less, but for their brightness, are one in more or less light
INSIDE = 0.4  # of the places beyond the corner in the region itself: it does not end there


def go_on(pair, labels, values, label: int, noise: float, rows, borders) -> np.ndarray:
    """(4,) bool: the longest side in each border of a region goes on beyond one of its ends.

    labels : (H, W);  values : (H, W, C) float32 in [0, 1], of the left photograph;  noise : its standard deviation
    rows : (n, COLUMNS) border points that tell the plane;  borders : (n,) which of four borders each is in
    """
    found = np.zeros(4, bool)
    for border in np.unique(borders):
        part = rows[:, PART].astype(int)
        side = rows[(borders == border) & (part == np.bincount(part[borders == border]).argmax())]
        if len(side) >= LEAST_PX:
            at, out = (
                pair.photograph(side[:, [U, V]] + d * side[:, [NORMAL_U, NORMAL_V]], "left") for d in (0, BESIDE)
            )
            found[border] = any(_goes_on(labels, values, label, noise, at, out, end) for end in (-1, 1))
    return found


def _goes_on(labels, values, label, noise, at, out, end):
    """The line through places at (n, 2), px, with places beside them outside the region, goes on past one end."""
    middle = at.mean(axis=0)
    normal, along = np.linalg.eigh(np.cov((at - middle).T))[1].T
    outward = normal * np.sign(normal @ (out - at).mean(axis=0))
    t = (at - middle) @ along * end
    reach = np.arange(BEYOND[0], min(BEYOND[1], max(LEAST_PX, np.ptp(t) / 2)))[:, None]
    tip, ahead = middle + along * end * t.max(), along * end
    before, beyond = tip - reach * ahead, tip + reach * ahead
    inside, outside = (_colour(values, before + d * outward) for d in (-BESIDE, BESIDE))
    here, there = beyond - BESIDE * outward, beyond + BESIDE * outward
    if not (_in_picture(labels, here) and _in_picture(labels, there)):
        return False
    if max(_share(labels, label, here), _share(labels, label, there)) > INSIDE:
        return False
    contrast = np.linalg.norm(inside - outside)
    beside, colour = _colour(values, here), _colour(values, there)
    if _is_shade(beside, inside):
        return False
    step = np.linalg.norm(beside - colour)
    if np.linalg.norm(colour - outside) > SAME * max(contrast, step):
        return False
    if step < max(CONTRAST[0] * contrast, CONTRAST[1] * noise):
        return False
    profile = np.stack([_colour(values, beyond + a * outward) for a in ACROSS])
    steepest = np.linalg.norm(np.diff(profile, axis=0), axis=1).argmax()
    return abs(ACROSS[steepest] + ACROSS[steepest + 1]) / 2 <= ON_LINE


def _is_shade(colour, other):
    """One colour is the other in more or less light, to HUE of itself."""
    a, b = colour**GAMMA, other**GAMMA
    return bool(np.linalg.norm(a - b * (a @ b) / max(b @ b, 1e-12)) < HUE * np.linalg.norm(a))


def _colour(values, q):
    """(C,) the median colour at places q (n, 2), px."""
    import cv2

    x, y = q.astype(np.float32).T
    seen = cv2.remap(values, x[None], y[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.median(seen.reshape(len(q), -1), axis=0)


def _in_picture(labels, q):
    return bool(((q >= 0) & (q <= np.array(labels.shape[::-1]) - 1)).all())


def _share(labels, label, q):
    """Of the places q (n, 2) in a region."""
    x, y = np.rint(q).astype(int).T
    return (labels[y, x] == label).mean()
