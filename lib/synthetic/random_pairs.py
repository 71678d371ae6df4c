"""Stereo pairs that nobody tuned on: random rooms, seen by two cameras whose sizes, lenses and distance are drawn.

    recipe = random_pair(7)              # the same every time

Both cameras are pinholes and given.  The right one stands aside by .05 to .26 of the distance to what is seen, and is
turned towards the same place, more or less.
"""

from dataclasses import replace

import numpy as np

from lib.synthetic.optics import Lens, look, pinhole
from lib.synthetic.random_rooms import random_room
from lib.synthetic.recipe import Pair, Recipe
from lib.synthetic.sight import coarse_view

SIZES = ((320, 240), (480, 360), (640, 480), (800, 600), (960, 720), (1280, 960))
BASELINE = 0.05, 0.26  # over the median distance of what is seen
NEAREST_M = 0.2  # that either camera sees
STEP = 20  # px between the rays that measure it


def random_pair(seed, *, size=None) -> Recipe:
    """The pair of a seed: a number or a word.  size : width, height px; drawn where it is not given"""
    random = np.random.default_rng(list(f"pair-{seed}".encode()))
    size = size or SIZES[random.integers(len(SIZES))]
    recipe = random_room(f"pair-{seed}", size=size)
    T, K = recipe.T_cam_world, recipe.K
    while True:
        T_right_left = _beside(random, _depths(recipe.polygons, K, size, T))
        seen = _depths(recipe.polygons, K, size, T_right_left @ T)
        if seen.min() > NEAREST_M:  # else a wall is between the cameras, or next to one
            break
    K_right = pinhole(
        *size, round(K[0, 0] * random.uniform(0.97, 1.03), 1), tuple(random.uniform(-0.02, 0.02, 2) * size)
    )
    lenses = tuple(Lens((A[0, 0], A[1, 1], A[0, 2], A[1, 2])) for A in (K, K_right))
    pair = Pair(lenses, T_right_left, "", noise=float(random.uniform(0.002, 0.01)))
    about = f"Random room {seed}, seen by a pair of given pinholes; the emittance of its lamps is known"
    return replace(recipe, name=f"pair-{seed}", pair=pair, about=about)


def _depths(polygons, K, size, T):
    """(n,) m before the camera of what it sees; 0 where it sees nothing, or a surface from behind."""
    number, p = coarse_view(polygons, K, size, T, STEP)
    normals = np.array([polygon.normal() for polygon in polygons])[number]
    towards = ((p + T[:3, :3].T @ T[:3, 3]) * normals).sum(axis=1) < 0
    return np.where((number >= 0) & towards, (p @ T[:3, :3].T + T[:3, 3])[:, 2], 0)


def _beside(random, depth) -> np.ndarray:
    """T_right_left (4, 4)."""
    distance = float(np.median(depth))
    aside = np.array([1, *random.uniform(-0.15, 0.15, 2)])
    eye = random.uniform(*BASELINE) * distance * aside / np.linalg.norm(aside)
    target = random.uniform(0, 1) * eye * [1, 0, 0] + [0, 0, distance * random.uniform(0.8, 1.5)]
    return look(eye, target, (random.uniform(-0.03, 0.03), -1, 0))
