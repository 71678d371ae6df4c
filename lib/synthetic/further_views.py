"""Random rooms that are photographed more than twice: cameras all over the room, some with another lens.

    case = further_views(7)                        # the same every time
    left, *others = photographs(case)              # our own rays: direct light with soft shadows, and an even glow

The first camera is the room's own and is given. The others look at about the same place, from wherever they stand.
"""

from dataclasses import dataclass, replace

import numpy as np

from lib.synthetic.displaced_pairs import radiosity, span
from lib.synthetic.optics import Lens, cameramodel, look, pinhole
from lib.synthetic.random_rooms import random_room
from lib.synthetic.recipe import Recipe
from lib.synthetic.sight import coarse_view, first_polygon

NEAREST_M = 0.35  # that a camera sees
NEAR_WALL_M = 0.25
FURTHEST_M = 2.5  # from the first camera
SHARED = 0.35  # of what a camera sees, the first one sees too, at least
STEP = 24  # px between the rays that look what is seen


@dataclass(frozen=True, eq=False)
class Views:
    """A room and its further cameras: a Lens and T_cam_world (4, 4) each;  noise : of a displayed value"""

    recipe: Recipe
    lenses: tuple
    poses: tuple
    noise: float


def further_views(seed, *, size=(640, 480), number=4) -> Views:
    """`number` further cameras in the random room of a seed; every other one has a lens of its own."""
    random = np.random.default_rng(list(f"views-{seed}".encode()))
    small = random_room(f"views-{seed}", size=(320, 240))
    factor = size[0] / 320
    core = (factor * small.K[0, 0], factor * small.K[1, 1], (size[0] - 1) / 2, (size[1] - 1) / 2)
    recipe = replace(small, K=Lens(core).K, size=tuple(size), name=f"views-{seed}")
    lenses, poses = [], []
    while len(poses) < number:
        focal = core[0] if len(poses) % 2 == 0 else core[0] * random.uniform(0.8, 1.4)
        K = pinhole(*size, round(float(focal), 2))
        if (T := _pose(recipe, K, random)) is not None:
            lenses.append(Lens((K[0, 0], K[1, 1], K[0, 2], K[1, 2])))
            poses.append(T)
    return Views(recipe, tuple(lenses), tuple(poses), float(random.uniform(0.002, 0.01)))


def _pose(recipe, K, random):
    """T_cam_world (4, 4) of one draw; None where it will not do."""
    low, high = span(recipe.polygons, "walls")
    T = recipe.T_cam_world
    first = -T[:3, :3].T @ T[:3, 3]
    _, p = coarse_view(recipe.polygons, recipe.K, recipe.size, T, STEP)
    eye = first + random.uniform(-1, 1, 3) * [FURTHEST_M, FURTHEST_M, 0.5]
    if (eye[:2] < low[:2] + NEAR_WALL_M).any() or (eye[:2] > high[:2] - NEAR_WALL_M).any():
        return None
    if np.linalg.norm(eye - first) > FURTHEST_M:
        return None
    target = p[random.integers(len(p))] * [1, 1, 0] + [0, 0, random.uniform(0.6, 1.3)]
    if np.linalg.norm(target - eye) < 1:
        return None
    T_new = look(eye, target, (random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05), 1))
    _, seen = coarse_view(recipe.polygons, K, recipe.size, T_new, STEP)
    number, _ = coarse_view(recipe.polygons, K, recipe.size, T_new, STEP)
    normal = np.array([polygon.normal() for polygon in recipe.polygons])[number]
    x = seen @ T_new[:3, :3].T + T_new[:3, 3]
    fronts = ((seen - eye) * normal).sum(axis=1) < 0
    if x[:, 2].min() < NEAREST_M or not fronts.all():
        return None
    return T_new if shared(recipe, seen) >= SHARED else None


def shared(recipe, seen) -> float:
    """The share of places `seen` (n, 3) that the first camera sees, too."""
    T, polygons = recipe.T_cam_world, recipe.polygons
    x = seen @ T[:3, :3].T + T[:3, 3]
    q = (x @ recipe.K.T)[:, :2] / np.maximum(x[:, 2:], 1e-9)
    inside = (x[:, 2] > 0) & (q >= 0).all(axis=1) & (q < recipe.size).all(axis=1)
    eye = -T[:3, :3].T @ T[:3, 3]
    far, _ = first_polygon(polygons, eye, seen - eye)
    return float((inside & (far > 1 - 1e-4)).mean())


def photographs(case, seed=0) -> list:
    """[(H, W, 3) uint8] of the first camera and the others, the sensor's noise added before rounding."""
    recipe, random = case.recipe, np.random.default_rng([seed, 7])
    K = recipe.K
    first = Lens((K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    out = []
    for lens, T in zip((first, *case.lenses), (recipe.T_cam_world, *case.poses), strict=True):
        B = radiosity(recipe, lens, T, random)
        values = np.clip(B, 0, 1) ** (1 / recipe.gamma) + random.normal(0, case.noise, B.shape)
        out.append(np.round(255 * np.clip(values, 0, 1)).astype(np.uint8))
    return out


def camera_text(lens, T, size) -> str:
    """The .cameramodel of a camera."""
    return cameramodel(lens.core, T, size)
