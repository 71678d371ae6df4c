"""Where an object that is drawn nowhere may stand: on what faces upwards and is in sight."""

import numpy as np

from lib.given.cameras import Camera, matrix_from_rt
from lib.vision.refinement.edges import draw

LEVEL = 0.99  # cosine between a support's normal and the upward axis
REDUCED = 8  # the index buffer that says what is in sight


def upwards(camera) -> np.ndarray:
    """(3,): the axis of the model that points up in the picture."""
    up = -camera.T_cam_world[1, :3]
    k = int(np.abs(up).argmax())
    return np.sign(up[k]) * np.eye(3)[k]


def orientations(camera) -> list[np.ndarray]:
    """(3, 3) each: an object stands as its file has it, or the file has y up (glTF) or z up and the model has not."""
    up = upwards(camera)
    out = [np.eye(3)]
    for own in (np.eye(3)[2], np.eye(3)[1]):
        if not np.allclose(own, up):
            axis = np.cross(own, up)
            turn = np.pi / 2 if np.linalg.norm(axis) > 0.5 else np.pi
            axis = axis if np.linalg.norm(axis) > 0.5 else np.eye(3)[0]
            out.append(matrix_from_rt([*(turn * axis), 0, 0, 0])[:3, :3])
    return out


def places(scenery, points, way, camera, spacing, turn) -> np.ndarray:
    """(H, 4, 4) T_world_object: all over the supports in sight, all around.

    points : (N, 3) m, the object in its own frame; way : (3, 3) how it stands; spacing : m; turn : rad, about
    """
    up, model = upwards(camera), scenery.posed()
    shrink = np.diag([1 / REDUCED, 1 / REDUCED, 1])
    small = Camera(shrink @ camera.K, camera.width // REDUCED, camera.height // REDUCED, camera.T_cam_world)
    index = draw(model, small)
    level = np.append(model.facet_normal @ up > LEVEL, False)
    y, x = np.nonzero(level[index.facet] & (index.facet >= 0))
    if len(x) == 0:
        return np.zeros((0, 4, 4))
    v = small.directions(np.column_stack([x, y])) * index.depth[y, x, None]
    at = v @ small.T_cam_world[:3, :3] + small.centre
    # far away pixels are coarser than the grid: good enough, as the refinement reaches further
    at = at[np.unique(np.rint(at / spacing), axis=0, return_index=True)[1]]
    p = points @ way.T
    middle = (p.min(axis=0) + p.max(axis=0)) / 2
    foot = middle - up * (middle @ up - (p @ up).min())
    out = []
    turns = int(np.ceil(2 * np.pi / turn))
    for k in range(turns):
        R = matrix_from_rt([*(2 * np.pi * k / turns * up), 0, 0, 0])[:3, :3]
        T = np.tile(np.eye(4), (len(at), 1, 1))
        T[:, :3, :3] = R @ way
        T[:, :3, 3] = at - R @ foot
        out.append(T)
    return np.concatenate(out)
