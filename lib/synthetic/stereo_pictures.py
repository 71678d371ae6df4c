"""A stereo pair and its chessboards through any lens: our own rays, traced by Mitsuba."""

from typing import NamedTuple

import numpy as np

from lib.synthetic.geometry import Polygon
from lib.synthetic.mitsuba_scene import MAX_DEPTH, mesh, mitsuba_scene
from lib.synthetic.pictures import Passes, group_picture

SIDES = ("left", "right")
BOARD_PAINTS = {"white": 0.78, "black": 0.045, "wall": 0.36}


class PairPictures(NamedTuple):
    """What the path tracer saw of a pair."""

    passes: dict  # side -> Passes
    labels: np.ndarray  # (H, W) groups of the left view without distortion, index + 1
    seeds: int  # how many were used


def through_lens(mi, scene, integrator, lens, T_cam_world, size, spp, seed) -> np.ndarray:
    """One pass: (H, W, 3) pi x mean radiance over each pixel's square, `spp` jittered places in it."""
    import drjit

    (W, H), side = size, int(round(spp**0.5))
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, wavefront_size=W * H * spp)
    i = drjit.arange(mi.UInt32, W * H * spp)
    pixel, stratum = i // spp, i % spp
    jitter = sampler.next_2d()
    u = mi.Float64(pixel % W) - 0.5 + (mi.Float64(stratum % side) + mi.Float64(jitter.x)) / side
    v = mi.Float64(pixel // W) - 0.5 + (mi.Float64(stratum // side) + mi.Float64(jitter.y)) / side
    x, y = lens.unproject(u, v)
    R, t = T_cam_world[:3, :3].tolist(), T_cam_world[:3, 3]
    length = drjit.sqrt(x * x + y * y + 1)
    d = [mi.Float((R[0][k] * x + R[1][k] * y + R[2][k]) / length) for k in range(3)]
    eye = mi.Point3f(*map(float, -T_cam_world[:3, :3].T @ t))
    L = integrator.sample(scene, sampler, mi.RayDifferential3f(eye, drjit.normalize(mi.Vector3f(*d))))[0]
    return np.stack([np.array(L[k]) for k in range(3)], -1).reshape(H, W, spp, 3).mean(2, dtype=float) * np.pi


def photographed(recipe, B, rng) -> np.ndarray:
    """What the sensor gives: displayed values with its noise, rounded; (H, W, 3), or (H, W) of a grey scene, uint8."""
    B = B if recipe.channels == 3 else B.mean(-1)
    values = np.clip(B, 0, 1) ** (1 / recipe.gamma) + rng.normal(0, recipe.pair.noise, B.shape)
    return np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)


def pair_of_photographs(mi, recipe, folder, opt) -> PairPictures:
    """`opt.passes` passes of both views."""
    scene = mitsuba_scene(mi, recipe, folder, opt.roulette)
    integrator = mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "rr_depth": opt.roulette})
    labels = group_picture(mi, scene, recipe)
    passes, seed = {}, opt.seed
    for side, (lens, T) in recipe.views().items():
        passes[side] = Passes((recipe.size[1], recipe.size[0], 3), np.zeros_like(labels), 0)
        for _ in range(opt.passes):
            passes[side].add(through_lens(mi, scene, integrator, lens, T, recipe.size, opt.spp, seed))
            seed += 1
    return PairPictures(passes, labels, seed - opt.seed)


def board_shots(mi, recipe, folder, spp, seed):
    """Yields (side, number, (H, W) linear values) of each place of the chessboard.

    Boards are held before a grey wall and lit by one small lamp beside the cameras; each shot is exposed for itself.
    """
    pair, size = recipe.pair, recipe.size
    integrator = mi.load_dict({"type": "path", "max_depth": 2})
    T_cam_left = dict(zip(SIDES, (np.eye(4), pair.T_right_left), strict=True))
    lenses = dict(zip(SIDES, pair.lenses, strict=True))
    for n, T_left_board in enumerate(pair.board.T_left_board):
        scene = _board_scene(mi, pair.board, n, folder)
        views, white = {}, []
        for k, side in enumerate(SIDES):
            V = T_cam_left[side]
            views[side] = through_lens(mi, scene, integrator, lenses[side], V, size, spp, seed + 2 * n + k)[..., 0]
            mask = board_mask(pair.board, lenses[side], V @ T_left_board, size)
            if mask.any():
                white.append(np.percentile(views[side][mask], 90))
        gain = 0.65 / max(white)  # the white of the board at about 0.65 of full scale
        for side, B in views.items():
            yield side, n, B * gain


def _board_scene(mi, board, n, folder):
    """Place number n of the board, a wall 4 m away, and a lamp that is elsewhere for each of five shots."""
    scene = {
        "type": "scene",
        "lamp": {
            "type": "point",
            "position": [0.1 + 0.06 * (n % 5), -0.45, -0.2],
            "intensity": {"type": "rgb", "value": 10.0},
        },
    }
    wall = Polygon("wall", "wall", np.array([[-9, -9, 4], [-9, 9, 4], [9, 9, 4], [9, -9, 4]], float))
    polygons = [*board.polygons(board.T_left_board[n]), wall]
    for group, rho in BOARD_PAINTS.items():
        bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": rho}}
        own = [p for p in polygons if p.group == group]
        scene[group] = mesh(folder / f"{group}.ply", own, {"type": "twosided", "bsdf": bsdf})
    return mi.load_dict(scene, optimize=False)


def board_mask(board, lens, T_cam_board, size) -> np.ndarray:
    """(H, W) bool: where the squares of the board are, roughly: the outline's corners joined by straight lines."""
    import cv2

    p = board.outline(0) @ T_cam_board[:3, :3].T + T_cam_board[:3, 3]
    mask = np.zeros(size[::-1], np.uint8)
    if p[:, 2].min() > 0.2:
        cv2.fillConvexPoly(mask, np.round(lens.project(p)).astype(np.int32), 1)
    return mask > 0
