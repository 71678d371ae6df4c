"""Stereo pairs of rooms in which things do not stand where the model has them, and one of them is not there.

    case = displaced_pair(7, 0.03)       # the same every time
    left, right = photographs(case)      # our own rays: direct light with soft shadows, and an even glow

For numbers by the dozen, where a path tracer takes too long.  What edges need is there: sharp borders, shading,
shadows, and the sensor's noise.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lib.core import artefact
from lib.given import image
from lib.given.cameras import rt_from_matrix
from lib.given.rays import Caster
from lib.synthetic.geometry import box, prism, regular
from lib.synthetic.optics import Lens, rotation
from lib.synthetic.random_pairs import random_pair
from lib.synthetic.recipe import Recipe, obj_text
from lib.synthetic.sight import coarse_view

ROOM = ("floor", "ceiling", "walls")
LEAST_PX, FURTHEST_M = 100, 3.0  # across, in both photographs; from the left camera
CLEAR_M = 0.01
STEP = 16  # px between the rays that look what is seen
DRAWN = 4  # times smaller is the picture for which a room is drawn: that is quicker
SIDE = 3  # samples along each side of a pixel
TURN = np.radians(15)  # at most


@dataclass(frozen=True, eq=False)
class Displaced:
    """recipe : the world that is photographed;  model : polygons as given

    moves : {object: T_true_drawn (4, 4)};  absent : objects of the model that are not there
    taller : {object: m by which it is higher in the world than in the model}
    """

    recipe: Recipe
    model: tuple
    moves: dict
    absent: tuple
    taller: dict


def displaced_pair(seed, off_m, *, size=(1280, 960), number=2, taller_m=0.0) -> Displaced:
    """`number` free-standing things moved by off_m and turned, and one that is gone; or, with taller_m, one thing of
    another height and nothing else.  Draws rooms of the seed until one has them."""
    for attempt in range(100):
        recipe = _enlarged(random_pair(f"{seed}-{attempt}", size=tuple(n // DRAWN for n in size)))
        random = np.random.default_rng(list(f"displaced-{seed}-{attempt}".encode()))
        recipe = _with_more(recipe, number + 1, random)
        things = [str(name) for name in random.permutation(_in_sight(recipe))]
        if len(things) <= number:
            continue
        if taller_m:
            name, by = things[0], taller_m * random.choice((-1, 1))
            polygons = tuple(_stretched(p, by) if p.object == name else p for p in recipe.polygons)
            return Displaced(replace(recipe, polygons=polygons), recipe.polygons, {}, (), {name: by})
        gone = things[number]
        world = replace(recipe, polygons=tuple(p for p in recipe.polygons if p.object != gone))
        if moved := _moved(world, things[:number], off_m, random):
            return Displaced(replace(world, polygons=moved[0]), recipe.polygons, moved[1], (gone,), {})
    raise ValueError(f"{seed}: no room has {number + 1} such things")


def _with_more(recipe, number, random) -> Recipe:
    """With further boxes and prisms on the floor, until so many things are in sight; where there is room."""
    low, high = span(recipe.polygons, "walls")
    for k in range(max(0, number - len(_in_sight(recipe)))):
        name = f"more-{k}"
        for _ in range(400):
            (x, y), (w, d, h) = random.uniform(low[:2] + 0.3, high[:2] - 0.7), random.uniform(0.2, 0.5, 3)
            if random.random() < 0.5:
                new = box(name, name, (x, y, low[2]), (x + w, y + d, low[2] + h), turn=random.uniform(0, 1.5))
            else:
                outline = regular(int(random.integers(3, 7)), w / 2, random.uniform(0, 1)) + (x, y)
                new = prism(name, name, outline, low[2], low[2] + h)
            more = replace(recipe, polygons=(*recipe.polygons, *new))
            if _is_clear(more.polygons, name, 0.12) and _in_sight(more, [name]):
                rho = tuple(map(float, random.uniform(0.08, 0.75, 3)))
                recipe = replace(more, materials={**recipe.materials, name: rho})
                break
    return recipe


def _enlarged(recipe) -> Recipe:
    """The pair with DRAWN times as many pixels each way."""
    grow = lambda f, c: (DRAWN * f, DRAWN * (c + 0.5) - 0.5)
    cores = []
    for lens in recipe.pair.lenses:
        (fx, cx), (fy, cy) = grow(lens.core[0], lens.core[2]), grow(lens.core[1], lens.core[3])
        cores.append(Lens((fx, fy, cx, cy)))
    pair = replace(recipe.pair, lenses=tuple(cores))
    return replace(recipe, K=cores[0].K, size=tuple(DRAWN * n for n in recipe.size), pair=pair)


def span(polygons, name):
    """(low, high) m of an object's corners."""
    points = np.concatenate([p.points for p in polygons if p.object == name])
    return points.min(0), points.max(0)


def _in_sight(recipe, wanted=None) -> list:
    """Free-standing things that both cameras see large enough and whole.  wanted : names, or None for all"""
    polygons, out = recipe.polygons, []
    names = [name for name in recipe.objects if name not in ROOM]
    spans = {name: span(polygons, name) for name in names}
    floor = span(polygons, "floor")[0][2]
    eye = np.linalg.inv(recipe.T_cam_world)[:3, 3]
    for name in names if wanted is None else wanted:
        low, high = spans[name]
        others = [spans[other] for other in names if other != name]
        near = any((low - 0.1 < b).all() and (high + 0.1 > a).all() for a, b in others)
        points = np.concatenate([p.points for p in polygons if p.object == name])
        if near or abs(low[2] - floor) > 1e-6 or np.linalg.norm((low + high) / 2 - eye) > FURTHEST_M:
            continue
        across = []
        for lens, T in recipe.views().values():
            x = points @ T[:3, :3].T + T[:3, 3]
            q = lens.project(np.maximum(x, [-1e9, -1e9, 0.1]))
            inside = (q >= 0).all() and (q < recipe.size).all()
            across.append(np.ptp(q, axis=0).max() if inside else 0)
        if min(across) >= LEAST_PX:
            out.append(name)
    if out:
        shown = []
        for lens, T in recipe.views().values():
            number, _ = coarse_view(polygons, lens.K, recipe.size, T, STEP)
            count = np.bincount(number[number >= 0], minlength=len(polygons))
            shown.append({n: sum(c for c, p in zip(count, polygons, strict=True) if p.object == n) for n in out})
        out = [name for name in out if min(side[name] for side in shown) * STEP**2 > 0.25 * LEAST_PX**2]
    return out


def _stretched(polygon, by):
    """Higher by so much: what is not on the floor goes up."""
    low = 1e-6
    return replace(polygon, points=polygon.points + [0, 0, by] * (polygon.points[:, 2:] > low))


def _moved(recipe, names, off_m, random):
    """(polygons, {object: T}) with things moved along the floor, clear of all else; None where there is no room."""
    polygons, moves = recipe.polygons, {}
    for name in map(str, names):
        low, high = span(polygons, name)
        middle = (low + high) / 2 * [1, 1, 0]
        for _ in range(100):
            a, turn = random.uniform(0, 2 * np.pi), random.uniform(-TURN, TURN)
            T = np.eye(4)
            T[:3, :3] = rotation(np.array([0, 0, turn]))
            T[:3, 3] = middle + off_m * np.array([np.cos(a), np.sin(a), 0]) - T[:3, :3] @ middle
            there = tuple(_by(p, T) if p.object == name else p for p in polygons)
            if _is_clear(there, name):
                polygons, moves[name] = there, T
                break
        else:
            return None
    return polygons, moves


def _by(polygon, T):
    return replace(polygon, points=polygon.points @ T[:3, :3].T + T[:3, 3])


def _is_clear(polygons, name, clear=CLEAR_M):
    low, high = span(polygons, name)
    room = span(polygons, "walls")
    if (low[:2] - clear < room[0][:2]).any() or (high[:2] + clear > room[1][:2]).any():
        return False
    names = {p.object for p in polygons} - {name, *ROOM}
    spans = [span(polygons, other) for other in names]
    return not any((low - clear < b).all() and (high + clear > a).all() for a, b in spans)


# ---- pictures ----


def photographs(case, seed=0) -> tuple:
    """(left, right): (H, W, 3) uint8, the sensor's noise added before rounding."""
    recipe, random = case.recipe, np.random.default_rng([seed, 5])
    out = []
    for lens, T in recipe.views().values():
        B = radiosity(recipe, lens, T, random)
        values = np.clip(B, 0, 1) ** (1 / recipe.gamma) + random.normal(0, recipe.pair.noise, B.shape)
        out.append(np.round(255 * np.clip(values, 0, 1)).astype(np.uint8))
    return tuple(out)


def radiosity(recipe, lens, T, random):
    """(H, W, 3) mean over SIDE x SIDE jittered samples of each pixel."""
    triangles, owner = [], []
    for i, polygon in enumerate(recipe.polygons):
        p = polygon.points
        triangles += [(p[0], p[k], p[k + 1]) for k in range(1, len(p) - 1)]
        owner += [i] * (len(p) - 2)
    owner, caster = np.array(owner), Caster(np.array(triangles))
    normals = np.array([p.normal() for p in recipe.polygons])
    rho = np.array([recipe.rho_d(p.group) for p in recipe.polygons])
    glow = np.array([recipe.lamps.get(p.group, (0, 0, 0)) for p in recipe.polygons])
    lamps = [p for p in recipe.polygons if p.group in recipe.lamps]
    area = sum(p.area() for p in recipe.polygons)
    even = sum(np.array(recipe.lamps[p.group]) * p.area() for p in lamps) * 0.5 / area
    (W, H), eye = recipe.size, -T[:3, :3].T @ T[:3, 3]
    out = np.zeros((H, W, 3))
    for k in range(SIDE * SIDE):
        u, v = np.meshgrid(np.arange(W, dtype=float), np.arange(H, dtype=float))
        u = (u + (k % SIDE + random.random(u.shape)) / SIDE - 0.5).ravel()
        v = (v + (k // SIDE + random.random(v.shape)) / SIDE - 0.5).ravel()
        x, y = lens.unproject(u, v)
        d = np.stack([x, y, np.ones_like(x)], axis=1)
        d = d / np.linalg.norm(d, axis=1, keepdims=True) @ T[:3, :3]
        rays = np.concatenate([np.broadcast_to(eye, d.shape), d], axis=1).astype(np.float32)
        triangle, t = caster.closest(rays)
        hit = triangle >= 0
        which = np.where(hit, owner[np.maximum(triangle, 0)], 0)
        p = eye + np.where(hit, t, 0)[:, None] * d
        n = normals[which] * -np.sign((normals[which] * d).sum(1))[:, None]
        light = np.broadcast_to(even, p.shape).copy()
        for lamp in lamps:
            s, r = random.random((2, len(p), 1))
            c = lamp.points
            at = c[0] + s * (c[1] - c[0]) + r * (c[3] - c[0])
            way = at - p
            far2 = (way**2).sum(1)
            cosines = np.maximum((way * n).sum(1), 0) * np.maximum(-(way @ lamp.normal()), 0) / far2
            start = p + 1e-4 * n
            dark = caster.occluded(np.concatenate([start, at - start], axis=1).astype(np.float32), 0.999)
            form = np.where(dark, 0, cosines / (np.pi * far2)) * lamp.area()
            light += np.minimum(form, 1)[:, None] * np.array(recipe.lamps[lamp.group])
        B = rho[which] * light + glow[which] * ((normals[which] * d).sum(1) < 0)[:, None]
        out += np.where(hit[:, None], B, 0).reshape(H, W, 3)
    return out / SIDE**2


def given_model(case) -> str:
    """The text of model.obj as given."""
    names = dict.fromkeys(p.object for p in case.model)
    return obj_text("not as the world is", [p for name in names for p in case.model if p.object == name], 9)


def write(case, folder, pictures, facts=None):
    """The scene's folder as it is given, and truth/.  pictures : of `photographs`; facts : what scene.yaml says more"""
    folder = Path(folder)
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    facts = {"movable": [*case.moves, *case.absent]} if facts is None else facts
    more = "".join(f"{key}: {json.dumps(value)}\n" for key, value in facts.items())
    (folder / "scene.yaml").write_text(case.recipe.scene_yaml() + more)
    (folder / "model.obj").write_text(given_model(case))
    for path, text in case.recipe.pair_files().items():
        (folder / path).write_text(text)
    for side, picture in zip(("left", "right"), pictures, strict=True):
        image.write_png8(folder / f"{side}.png", picture)
    objects = {name: {"rt_world_object": rt_from_matrix(T), "found": True} for name, T in case.moves.items()}
    objects |= {name: {"rt_world_object": None, "found": False} for name in case.absent}
    pose = {"rt_cam_world": rt_from_matrix(case.recipe.T_cam_world), "objects": objects}
    artefact.write_json(folder / "truth" / "pose.json", pose)
