"""A photograph, its camera and its picks a whole number of times smaller: k x k pixels become their mean.

Materials want few pixels: tiles of thousands of them are compared. Memory and time want fewer.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

MEGAPIXELS = 4.0  # that a photograph keeps at most: 2.7 GB of memory


def times(size, megapixels=MEGAPIXELS) -> int:
    """How many times smaller, so that at most so many are left. size : (width, height) px

    >>> times((6000, 4000)), times((4000, 3000)), times((1280, 960))
    (3, 2, 1)
    """
    return max(1, math.ceil(math.sqrt(size[0] * size[1] / 1e6 / megapixels) - 1e-9))


def picture(values, k) -> np.ndarray:
    """(H // k, W // k, C) means of (H, W, C); what is left over at the right and below is cut off.

    >>> picture(np.arange(10.0).reshape(2, 5, 1), 2)[..., 0]
    array([[3., 5.]])
    """
    height, width = (n // k for n in values.shape[:2])
    return values[: k * height, : k * width].reshape(height, k, width, k, -1).mean(axis=(1, 3))


def photograph(taken, k):
    """image.Photograph k times smaller; itself where k is 1."""
    if k == 1:
        return taken
    return replace(taken, values=picture(taken.values, k), blocks=taken.blocks and taken.blocks.smaller(k))


def place(q, k):
    """Where pixel coordinates lie then: centres of pixels are whole numbers before and after.

    >>> float(place(0.5, 2)), float(place(1.0, 3))
    (0.0, 0.0)
    """
    return (np.asarray(q, float) + 0.5) / k - 0.5


def pinhole(camera, k):
    """cameras.Camera of the smaller photograph."""
    return replace(camera, K=whole(camera.K, 1 / k), width=camera.width // k, height=camera.height // k)


def whole(K, k):
    """The matrix K (3, 3) of a smaller photograph in the pixels of the whole one."""
    K = K * [[k], [k], [1]]
    K[:2, 2] += (k - 1) / 2
    return K


def camera(found, k):
    """foreign_cameras.Found of the smaller photograph: of every lens the first four numbers are fx, fy, cx, cy."""
    numbers = np.array(found.intrinsics, float)
    numbers[:2], numbers[2:4] = numbers[:2] / k, place(numbers[2:4], k)
    return replace(found, intrinsics=numbers, width=found.width // k, height=found.height // k)
