"""Pairs in random rooms (lib/synthetic/random_pairs.py) by our own rays: light of the lamps without shadows, noise.

A hundred of them take minutes. What makes facets hard, shadows and light from wall to wall, Mitsuba's pairs have.
"""

from typing import NamedTuple

import numpy as np

from lib.given import model as models
from lib.given.cameras import Camera
from lib.given.image import Photograph
from lib.synthetic.random_pairs import random_pair
from lib.vision.refinement.rig import Side
from tests.helpers import facet_trials as trials

FINER = 3
SIZES = ((320, 240), (480, 360), (640, 480))
AMBIENT = 0.35  # of the brightest place's light, everywhere


class RoomPair(NamedTuple):
    """model;  sides : rig.Side of both;  posed : the left Camera, true"""

    model: object
    sides: list
    posed: Camera


def room_pair(seed, folder) -> RoomPair:
    """The pair of a seed; `folder` gets its model."""
    random = np.random.default_rng([78, seed])
    width, height = SIZES[random.integers(len(SIZES))]
    recipe = random_pair(f"cast-{seed}", size=(width, height))
    path = folder / "room.obj"
    path.write_text(recipe.model()[0])
    model, sides, lit = models.load(path), [], []
    for lens, T in zip(recipe.pair.lenses, (np.eye(4), recipe.pair.T_right_left), strict=True):
        sides.append(Camera(lens.K, width, height, T))
        lit.append(_light(model, Camera(lens.K, width, height, T @ recipe.T_cam_world), recipe))
    top = np.percentile(lit[0], 98)
    for k, light in enumerate(lit):
        shown = np.clip(0.8 * light / top, 0, 1) ** (1 / (recipe.gamma or 2.2))
        shown += random.normal(0, recipe.pair.noise, light.shape)
        sides[k] = Side(sides[k], Photograph(np.round(255 * np.clip(shown, 0, 1)) / 255, 8, False, 3))
    return RoomPair(model, sides, Camera(sides[0].camera.K, width, height, recipe.T_cam_world))


def _light(model, camera, recipe):
    """(H, W, 3) radiosity of paint under the lamps, each a point that shines down its normal."""
    import cv2

    K = np.array([[FINER, 0, (FINER - 1) / 2], [0, FINER, (FINER - 1) / 2], [0, 0, 1]]) @ camera.K
    fine = Camera(K, FINER * camera.width, FINER * camera.height, camera.T_cam_world)
    index = trials.draw(model, fine)
    R, t = fine.T_cam_world[:3, :3], fine.T_cam_world[:3, 3]
    p = (fine.directions(fine.pixels()) * index.depth[..., None] - t) @ R
    n = model.facet_normal[index.facet]
    n = n * np.sign(np.einsum("hwi,hwi->hw", n, -R.T @ t - p))[..., None]
    light = np.zeros(p.shape[:2])
    for lamp in (q for q in recipe.polygons if q.group in recipe.lamps):
        d = lamp.points.mean(axis=0) - p
        r2 = (d**2).sum(axis=2) + 0.05
        light += np.maximum((n * d).sum(axis=2), 0) * np.maximum(-(d @ lamp.normal()), 0) / r2**2
    light += AMBIENT * np.percentile(light, 95)
    rho = np.array([recipe.materials.get(group, (1, 1, 1)) for group in model.groups])[model.facet_group][index.facet]
    lit = np.where(index.facet[..., None] >= 0, rho * light[..., None], 0)
    return cv2.resize(lit, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
