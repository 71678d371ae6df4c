"""Necks: surfaces of one colour that touch at a corner or through a gap in what parts them hang together by few pixels.

Two black squares of a chessboard meet in the blur of a corner: in one photograph they are one region, in the other two.
A part of a surface that is narrower than the blur of two borders shows no plane, so nothing is lost where it is cut.
"""

import numpy as np

from lib.vision import surfaces_kernels as kernels
from lib.vision.segmentation_kernels import components

NECK_PX = 5  # narrower: both borders of a neck lie in one blur
WIDE_PX = 11  # both parts, at their widest: less is a spur, not a part


def cut(labels) -> np.ndarray:
    """(H, W) int32: surfaces cut through their necks. Their largest part keeps its label, others have new ones.

    labels : (H, W) of its surfaces, from 1
    """
    import cv2

    labels = np.array(labels, np.int32)
    at_border = np.zeros(labels.shape, bool)
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        other = labels[a] != labels[b]
        at_border[a] |= other
        at_border[b] |= other
    if not at_border.any():
        return labels
    inside = cv2.distanceTransform((~at_border).astype(np.uint8), cv2.DIST_L2, 5)  # 0 on a surface's outermost pixels
    wide = 2 * inside + 1 >= NECK_PX
    core, n = components(np.where(wide, labels, 0))
    widest = np.zeros(n)
    np.maximum.at(widest, core.ravel(), inside.ravel())
    chosen = np.zeros(n, bool)
    chosen[core[wide & (2 * widest[core] + 1 >= WIDE_PX)]] = True
    of_core = np.zeros(n, np.int64)
    of_core[core.ravel()] = labels.ravel()
    several = np.bincount(of_core[chosen], minlength=labels.max() + 1) > 1
    if not several.any():
        return labels
    part = np.where(several[labels] & chosen[core], core, -1).astype(np.int64)
    kernels.grow(labels, part)  # the parts of such surfaces, each pixel with the part that is nearest inside
    pixels = np.bincount(part[part >= 0], minlength=n)
    last = labels.max()
    for k in np.flatnonzero(several):
        mine = np.flatnonzero(chosen & (of_core == k))
        for c in mine[np.argsort(-pixels[mine], kind="stable")][1:]:
            last += 1
            labels[part == c] = last
    return labels
