"""Where a pixel is: our coordinates, COLMAP's and OpenGL's.

We count as OpenCV and mrcal do: (0, 0) is the *centre* of the top-left pixel, x right, y down.  COLMAP counts from the
top-left corner, so that this centre is at (0.5, 0.5).  OpenGL counts from the bottom-left corner, y up, and looks
along -z.

A camera's matrix changes with the origin of its pixels; a size never does.
"""

import numpy as np


def colmap_from_ours(q) -> np.ndarray:
    """(..., 2) px, ours -> COLMAP.

    >>> colmap_from_ours(np.array([0.0, 0.0]))
    array([0.5, 0.5])
    """
    return np.asarray(q, float) + 0.5


def ours_from_colmap(q) -> np.ndarray:
    """(..., 2) px, COLMAP -> ours: the inverse of colmap_from_ours."""
    return np.asarray(q, float) - 0.5


def opengl_from_ours(q, height) -> np.ndarray:
    """(..., 2) px, ours -> OpenGL's window coordinates of an image `height` px high.

    >>> opengl_from_ours(np.array([0.0, 0.0]), 480)
    array([  0.5, 479.5])
    """
    q = np.asarray(q, float)
    return np.stack([q[..., 0] + 0.5, height - 0.5 - q[..., 1]], axis=-1)


def ours_from_opengl(q, height) -> np.ndarray:
    """(..., 2) px, OpenGL's window coordinates -> ours: the inverse of opengl_from_ours."""
    q = np.asarray(q, float)
    return np.stack([q[..., 0] - 0.5, height - 0.5 - q[..., 1]], axis=-1)


def K_colmap_from_ours(K) -> np.ndarray:
    """(3, 3) px: the same camera for pixels counted from the corner."""
    K = np.array(K, float)
    K[:2, 2] += 0.5
    return K


def K_ours_from_colmap(K) -> np.ndarray:
    """(3, 3) px: the inverse of K_colmap_from_ours."""
    K = np.array(K, float)
    K[:2, 2] -= 0.5
    return K


def clip_from_camera(K, width, height) -> np.ndarray:
    """(4, 4): our camera coordinates (x right, y down, z forward) to OpenGL's clip coordinates, w = z.

    Row 2 gives clip z = -near, that is, a depth that is linear in 1/z: with a near plane at 1, ndc z = 1 - 2/z.  There
    is no far plane; scale the scene so that nothing visible lies nearer than 1.  The picture comes out with its rows in
    *our* order: row 0, the top, is OpenGL's row 0, its bottom.  So an image that is read back needs no flip, and what
    was counter-clockwise is clockwise.

    >>> M = clip_from_camera(np.array([[100.0, 0, 31.5], [0, 100, 23.5], [0, 0, 1]]), 64, 48)
    >>> x, y, z, w = M @ [0, 0, 5, 1]
    >>> float(x / w), float(y / w)             # the middle of a 64 x 48 image, our pixel (31.5, 23.5)
    (0.0, 0.0)
    """
    M = np.zeros((4, 4))
    M[0, :3] = 2 * K[0] / width
    M[1, :3] = 2 * K[1] / height
    M[0, 2] += (1 - width) / width  # ndc x = 2 (u + 0.5) / width - 1
    M[1, 2] += (1 - height) / height
    M[2, 2], M[2, 3] = 1, -2
    M[3, 2] = 1
    return M
