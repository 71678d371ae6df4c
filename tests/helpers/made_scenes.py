"""The committed synthetic scenes and their recipes: what several tests read of them."""

import functools
import json
from pathlib import Path

import numpy as np

from lib.synthetic import recipes

DATA = Path(__file__).resolve().parents[2] / "data"
made = functools.cache(recipes.make)


def truth(name, file):
    return json.loads((DATA / name / "truth" / file).read_text())


def same_text(a, b):
    """Equal; numbers of 15 digits (camera models) may differ in the last, which depends on the processor."""
    words = lambda text: text.replace(",", " ").split()
    number = lambda word: word.lstrip("-").replace(".", "", 1).replace("e-", "", 1).isdigit()
    return (
        a == b
        or len(words(a)) == len(words(b))
        and all(
            x == y or number(x) and number(y) and "." in x and abs(float(x) - float(y)) < 1e-12
            for x, y in zip(words(a), words(b), strict=True)
        )
    )


def wrong_labels(recipe, labels, count):
    """At how many of `count` pixels drawn by chance a group picture is wrong.

    The border of a group may go either way.
    """
    W, H = recipe.size
    random, wrong, polygons = np.random.default_rng(3), 0, planes(recipe)
    for x, y in zip(random.integers(1, W - 1, count), random.integers(1, H - 1, count), strict=True):
        here = labels[y - 1 : y + 2, x - 1 : x + 2]
        if (here == here[1, 1]).all():
            wrong += seen(recipe, polygons, (x, y)) != here[1, 1]
    return wrong


def planes(recipe):
    """[(corners (n, 3), edges (n, 3), normal (3,), group index + 1)] of its polygons."""
    found = []
    for p in recipe.polygons:
        edges = np.roll(p.points, -1, 0) - p.points
        normal = np.cross(edges, np.roll(edges, -1, 0)).sum(0)
        found.append((p.points, edges, normal, recipe.groups.index(p.group) + 1))
    return found


def seen(recipe, polygons, q):
    """Group index + 1 of the nearest of its polygons (`planes`) at pixel q, or 0: the slow clear way."""
    R, t = recipe.T_cam_world[:3, :3], recipe.T_cam_world[:3, 3]
    eye, d = -R.T @ t, R.T @ np.linalg.solve(recipe.K, [*q, 1.0])
    best, nearest = np.inf, 0
    for points, edges, n, group in polygons:
        if n @ d == 0:
            continue
        s = n @ (points[0] - eye) / (n @ d)
        if 1e-9 < s < best and (np.cross(edges, eye + s * d - points) @ n >= 0).all():
            best, nearest = s, group
    return nearest
