"""Creases: where two planes of one colour meet, the light has no step but a kink, and a surface spans both.

Across a crease the light goes on with another slope, so its second derivative is a ridge, as sharp as the smoothing. A
Laplacian of Gaussians at two scales shows it and cancels what is merely curved. Straight ridges are found by a Hough
transform, and a surface is cut along one that runs through it, from outline to outline, and leads to a corner of the
outline or goes on along one of its sides: where two walls meet, their edges with the ceiling do, too. The edges of
light from a lamp have kinks as well, and run into the middle of a side.
"""

import numpy as np

FINE, COARSE = 3.0, 9.0  # px, standard deviations of the two Gaussians
RIDGE = 4.0  # standard deviations of the second derivative: a ridge, of which half is seen at LOW
LOW = 2.0
LEAST_KINK = 0.001  # display per px, change of slope
SHOWN = 0.6  # of a crease must show
LEAST_LENGTH = 40  # px
LARGE = 0.01  # of the picture: a surface worth cutting
WIDE = 0.025  # half width of both parts, in sides of the picture: thinner ones are edges of light
CORNER_PX, ARM_PX, TURN = 6.0, 15.0, np.radians(8)  # distance to a corner; its sides' length; their angle
ALONG_PX, SIDE_PX = 3.0, 30.0  # distance to a side that it goes on along; that side's length
MOST_TRIED = 20  # lines of a surface, the longest


def cut(picture, labels) -> np.ndarray:
    """(H, W) int32: surfaces cut along the creases inside. Their largest part keeps its label, others have new ones.

    picture : (H, W, C) in [0, 1];  labels : (H, W) of its surfaces, from 1
    """
    light = np.asarray(picture, np.float32).mean(axis=2)
    labels = np.array(labels, np.int32)
    last, large = labels.max(), LARGE * labels.size
    for k in np.flatnonzero(np.bincount(labels.ravel()) >= large):
        parts, waiting = [], [labels == k]
        while waiting:
            mask = waiting.pop()
            halves = _halves(light, mask) if mask.sum() >= large else None
            if halves is None:
                parts.append(mask)
            else:
                waiting += halves
        for part in sorted(parts, key=np.count_nonzero)[:-1]:
            last += 1
            labels[part] = last
    return labels


def _halves(light, mask):
    """The two parts of a surface (H, W) beside its clearest crease, or None."""
    H, W = mask.shape
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    inside, origin, least = mask[box], np.array([columns[0], rows[0]]), WIDE * np.sqrt(H * W)
    z, seen = _ridges(light[box], inside)
    corners, sides = None, None
    for sign, start, end in _candidates(z):
        line = _refined(sign * z, start, end)
        for ends in _ends(inside, *line) if line else ():
            if not _shows(sign * z, seen, *ends):
                continue
            if corners is None:
                corners, sides = _outline(inside, origin, (W, H))
            if not _leads_on(ends, line, corners, sides):
                continue
            halves = _divided(inside, *line, ends)
            if halves is not None and min(map(_half_width, halves)) >= least:
                out = np.zeros((2, H, W), bool)
                out[:, *box] = halves
                return list(out)
    return None


def _ridges(light, inside):
    """(h, w) second derivative of the light, in its standard deviations, 0 at outlines; and where it is known."""
    import cv2

    # Beyond the outline goes on what is nearest, so that what lies there does not show.
    nearest = cv2.distanceTransformWithLabels(
        (~inside).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    at = np.zeros(nearest[1].max() + 1, np.int64)
    at[nearest[1][inside]] = np.flatnonzero(inside)
    filled = light.ravel()[at[nearest[1]]]
    bent = lambda sigma: cv2.Laplacian(cv2.GaussianBlur(filled, (0, 0), sigma), cv2.CV_32F)
    second = bent(FINE) - bent(COARSE)
    seen = cv2.distanceTransform(np.pad(inside, 1, constant_values=True).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    seen = seen > 2 * FINE
    peak = (1 / FINE - 1 / COARSE) / np.sqrt(2 * np.pi)  # of a kink of 1 per px
    sigma = 1.4826 * np.median(np.abs(second[seen])) if seen.any() else 0.0
    return np.where(seen, second / max(sigma, LEAST_KINK * peak / RIDGE), 0.0), seen


def _candidates(z):
    """[(sign, start, end)] of straight ridges, the longest first; px (x, y)."""
    import cv2

    found = []
    around = cv2.dilate(np.abs(z).astype(np.float32), np.ones((31, 31), np.uint8))  # a ridge has valleys beside it
    for sign in (1, -1):
        ridge = np.where(sign * z > np.maximum(RIDGE, around / 2), 255, 0).astype(np.uint8)
        lines = cv2.HoughLinesP(ridge, 1, np.pi / 360, 25, minLineLength=LEAST_LENGTH, maxLineGap=15)
        if lines is not None:
            found += [(sign, line[:2], line[2:]) for line in lines.reshape(-1, 4).astype(float)]
    return sorted(found, key=lambda x: -np.hypot(*(x[2] - x[1])))[:MOST_TRIED]


def _refined(z, start, end):
    """(point, direction) of the line through the ridge near a segment; None where there is none."""
    point, along = (start + end) / 2, (end - start) / np.hypot(*(end - start))
    reach = np.hypot(*(end - start)) / 2 + 5
    y, x = np.nonzero(z > RIDGE - 1)
    ridge = np.column_stack([x, y]).astype(float)
    for _ in range(2):
        off = (ridge - point) @ [-along[1], along[0]]
        near = (np.abs(off) < 4) & (np.abs((ridge - point) @ along) < reach)
        if near.sum() < 10:
            return None
        weight = z[y[near], x[near]]
        point = np.average(ridge[near], axis=0, weights=weight)
        spread = (ridge[near] - point).T * weight @ (ridge[near] - point)
        along = np.linalg.eigh(spread)[1][:, 1]
    return point, along


def _ends(inside, point, along):
    """[(start, end)] where the line leaves the surface: for good, and first; px (x, y)."""
    h, w = inside.shape
    last, first = [], []
    for way in (along, -along):
        at = point + np.arange(0, h + w, 0.5)[:, None] * way
        x, y = np.round(at).astype(int).T
        within = (x >= 0) & (x < w) & (y >= 0) & (y < h)
        within[within] = inside[y[within], x[within]]
        if not within[0]:
            return []
        last.append(at[np.flatnonzero(within)[-1]])
        first.append(at[np.flatnonzero(~np.append(within, False))[0] - 1])
    return [last, first]


def _shows(z, seen, start, end):
    """Whether the ridge is seen along enough of the line."""
    import cv2

    length = np.hypot(*(end - start))
    along = (end - start) / max(length, 1e-9)
    at = start + np.arange(0, length)[:, None] * along
    offsets = np.linspace(-1.5, 1.5, 5)[:, None] * [-along[1], along[0]]
    x, y = (at[:, None] + offsets).astype(np.float32).transpose(2, 0, 1)
    ridge = cv2.remap(z.astype(np.float32), x, y, cv2.INTER_LINEAR).max(axis=1)
    known = cv2.remap(seen.astype(np.float32), x[:, 2:3], y[:, 2:3], cv2.INTER_LINEAR)[:, 0] > 0.99
    ridge = ridge[known]
    return len(ridge) >= LEAST_LENGTH and (ridge > LOW).mean() >= SHOWN and ridge.mean() > 0.75 * RIDGE


def _outline(inside, origin, size):
    """(n, 2) corners of the outline between two straight sides, and (m, 2, 2) long sides; not the picture's own border.

    origin : (2,) of the box in the picture;  size : (W, H) of the picture
    """
    import cv2

    contours, _ = cv2.findContours(np.pad(inside, 1).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    corners, sides = [np.empty((0, 2))], [np.empty((0, 2, 2))]
    last = np.array(size) - 1
    for contour in contours:
        ring = cv2.approxPolyDP(contour, 2.0, True).reshape(-1, 2) - 1.0
        if len(ring) < 3:
            continue
        following = np.roll(ring, -1, axis=0)
        after, before = following - ring, ring - np.roll(ring, 1, axis=0)
        turned = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        turn = np.abs(np.arctan2(turned, (before * after).sum(axis=1)))
        arms = np.minimum(np.hypot(*after.T), np.hypot(*before.T))
        to_border = lambda x: np.minimum(x + origin, last - x - origin)
        corners.append(ring[(turn > TURN) & (arms > ARM_PX) & (to_border(ring).min(axis=1) > 3)])
        at_border = (np.maximum(to_border(ring), to_border(following)) < 2).any(axis=1)
        long = (np.hypot(*after.T) > SIDE_PX) & ~at_border
        sides.append(np.stack([ring[long], following[long]], axis=1))
    return np.concatenate(corners), np.concatenate(sides)


def _leads_on(ends, line, corners, sides):
    """Whether the line ends at a corner or goes on along a side."""
    point, along = line
    at_corner = any((np.hypot(*(corners - end).T) < CORNER_PX).any() for end in ends)
    return at_corner or bool((np.abs((sides - point) @ [-along[1], along[0]]) < ALONG_PX).all(axis=1).any())


def _divided(inside, point, along, ends):
    """(2, h, w) the largest part that the line cuts off, and the rest; None where it cuts nothing off."""
    import cv2

    y, x = np.mgrid[: inside.shape[0], : inside.shape[1]]
    off = (x - point[0]) * -along[1] + (y - point[1]) * along[0]
    at = (x - point[0]) * along[0] + (y - point[1]) * along[1]
    low, high = sorted((end - point) @ along for end in ends)
    barrier = inside & (np.abs(off) <= 1.0) & (at >= low - 3) & (at <= high + 3)
    _, part, stats, _ = cv2.connectedComponentsWithStats((inside & ~barrier).astype(np.uint8), connectivity=4)
    if len(stats) < 3:
        return None
    largest = 1 + stats[1:, cv2.CC_STAT_AREA].argmax()
    main = part == largest
    beside = np.median(off[main & (np.abs(off) < 10) & (at >= low) & (at <= high)]) if main.any() else np.nan
    if not np.isfinite(beside):
        return None
    main |= barrier & (off * beside > 0)
    return np.stack([main, inside & ~main])


def _half_width(mask):
    """px, of the widest place."""
    import cv2

    return float(cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 5).max())
