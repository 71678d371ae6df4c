"""Straight edges of one photograph, also those that noise breaks and those between colours that are equally bright."""

import numpy as np

from lib.vision.corners.lines import segments

FACTOR = 2  # the smaller picture's
LEAST_PX = 12.0  # of a segment of the smaller picture
STRETCHED = 1.0, 99.0  # percentiles that become black and white
SAME_PX = 4.0  # two segments on one edge
FAINT = 0.02  # display value; a component of colours whose range is smaller shows noise


def straight_edges(photograph) -> np.ndarray:
    """(n, 2, 2) px: ends of straight edges (LSD), of the photograph and of its colours' components at half the size.

    An edge may be there several times.
    """
    import cv2

    values = np.clip(photograph.display, 0, 1).reshape(*photograph.values.shape[:2], -1)
    found = [segments(photograph)]
    h, w = values.shape[0] // FACTOR, values.shape[1] // FACTOR
    if min(h, w) < 40:
        return found[0]
    # INTER_AREA averages FACTOR x FACTOR pixels: a pixel's middle moves by (FACTOR - 1) / 2
    small = cv2.resize(values[: FACTOR * h, : FACTOR * w].astype(np.float32), (w, h), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 0.8).reshape(h * w, -1)
    colours = small - small.mean(axis=0)
    axes = np.linalg.eigh(colours.T @ colours)[1]
    for component in (colours @ axes).T:
        low, high = np.percentile(component, STRETCHED)
        if high - low < FAINT:
            continue
        picture = np.rint(255 * np.clip((component - low) / (high - low), 0, 1)).astype(np.uint8).reshape(h, w)
        lines = cv2.createLineSegmentDetector().detect(picture)[0]
        if lines is not None:
            lines = lines.reshape(-1, 2, 2).astype(float)
            long = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) >= LEAST_PX
            found.append(FACTOR * lines[long] - 0.5)
    return _once(np.concatenate(found))


def _once(lines):
    """Without segments that lie on longer ones."""
    along = lines[:, 1] - lines[:, 0]
    length = np.linalg.norm(along, axis=1)
    along = along / np.maximum(length, 1e-12)[:, None]
    alive, kept = np.ones(len(lines), bool), []
    for k in np.argsort(-length, kind="stable"):
        if not alive[k]:
            continue
        kept.append(k)
        off = lines - lines[k, 0]
        s, across = off @ along[k], np.abs(off[..., 0] * along[k, 1] - off[..., 1] * along[k, 0])
        alive &= ~((across.max(axis=1) < SAME_PX) & (s.max(axis=1) > -1) & (s.min(axis=1) < length[k] + 1))
    return lines[kept]
