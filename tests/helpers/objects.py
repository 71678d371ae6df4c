"""Objects of 10 to 40 facets before a textured background that no model has: the pictures of a pair of cameras.

Shared by the tests of corners and their curves. The pictures are our own: index buffers, light of two bulbs without
shadows. What is seen through is the model with its background; what is given is the object alone.
"""

from typing import NamedTuple

import numpy as np

from lib.given import model as models
from lib.given.cameras import Camera
from lib.given.image import Photograph
from lib.synthetic import geometry, optics
from lib.synthetic.recipe import obj_text
from lib.vision.refinement.rig import Side
from tests.helpers import facet_trials as trials

FINER = 3


class ObjectPair(NamedTuple):
    """given, full : Model without and with the background;  sides : rig.Side of both;  posed : the left Camera, true"""

    given: object
    full: object
    sides: list
    posed: Camera


def solid(random):
    """[Polygon]: boxes and prisms that stand on each other, each face of one of six paints."""
    while True:
        paint = lambda: f"paint{random.integers(6)}"
        base = random.uniform((0.5, 0.35, 0.08), (0.9, 0.7, 0.3))
        out = geometry.box("base", paint(), (0, 0, 0), base, top=paint(), sides={i: paint() for i in range(4)})
        tops, taken = [(np.zeros(2), base[:2], base[2])], []
        for k in range(int(random.integers(1, 5))):
            low, high, z = tops[random.integers(len(tops))]
            w = (high - low) * random.uniform(0.25, 0.7, 2)
            at = low + random.uniform(0.02, 0.98, 2) * (high - low - w)
            if any(z == q and (at < b).all() and (at + w > a).all() for a, b, q in taken):
                continue
            taken.append((at, at + w, z))
            n, top = int(random.integers(3, 7)), z + random.uniform(0.08, 0.4)
            outline = np.array([at, [at[0] + w[0], at[1]], at + w, [at[0], at[1] + w[1]]])
            if random.random() > 0.65:
                outline = geometry.regular(at + w / 2, w.min() / 2, n, random.uniform(0, 6))
            sides = {i: paint() for i in range(len(outline))}
            out += geometry.prism(f"part{k}", paint(), outline, z, top, top=paint(), sides=sides)
            tops.append((at, at + w, top))
        if 10 <= len(out) <= 40:
            return out


def texture(random, n=512):
    """(n, n, 3) in [0, 1]: clouds of four sizes, patches and discs."""
    import cv2

    image = sum(
        cv2.GaussianBlur(random.normal(size=(n, n, 3)), (0, 0), s) * s * random.uniform(0.05, 0.35)
        for s in (64, 24, 8, 3)
    )
    image = np.ascontiguousarray(np.clip(0.45 + 0.45 * image / np.abs(image).max(), 0.05, 0.9))
    for _ in range(int(random.integers(10, 60))):
        colour, p = random.uniform(0.05, 0.85, 3).tolist(), random.integers(0, n, 2)
        if random.random() < 0.5:
            corners = (p + random.integers(-90, 90, (4, 2))).astype(np.int32)
            cv2.fillConvexPoly(image, cv2.convexHull(corners), colour)
        else:
            cv2.circle(image, p.tolist(), int(random.integers(3, 40)), colour, -1)
    return image.astype(np.float32)


def load(folder, name, polygons):
    """The Model of polygons, through a file."""
    objects = list(dict.fromkeys(p.object for p in polygons))
    path = folder / f"{name}.obj"
    path.write_text(obj_text(name, [p for o in objects for p in polygons if p.object == o]))
    return models.load(path)


def object_pair(seed, folder, polygons=None, width=480, height=360, noise=0.006) -> ObjectPair:
    """The pair of a seed.  polygons : of the object; drawn where they are not given"""
    random = np.random.default_rng([77, seed])
    polygons = solid(random) if polygons is None else polygons
    p = np.concatenate([q.points for q in polygons])
    middle, size = (p.min(axis=0) + p.max(axis=0)) / 2, np.linalg.norm(np.ptp(p, axis=0))
    focal, around, up = width * random.uniform(0.9, 1.3), random.uniform(0, 2 * np.pi), random.uniform(0.25, 0.9)
    distance = size * focal / width * random.uniform(1.2, 1.8)
    eye = middle + distance * np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
    T = optics.look(eye, middle + random.uniform(-0.1, 0.1, 3) * size)
    x, y, z = T[:3, :3]
    tilt, S = random.uniform(-0.4, 0.4, 2), 2.5 * distance
    u, v, far = S * (x + tilt[0] * z), S * (y + tilt[1] * z), middle + z * size * random.uniform(0.8, 1.4)
    wall = geometry.Polygon("zwall", "zwall", np.array([far - u - v, far - u + v, far + u + v, far + u - v]))
    full = load(folder, f"full-{seed}", [*polygons, wall])
    aside = np.array([1, *random.uniform(-0.12, 0.12, 2)])
    aside *= random.uniform(0.06, 0.22) * distance / np.linalg.norm(aside)
    D = optics.look(aside, [random.uniform(0, 0.3) * aside[0], 0, distance * random.uniform(0.8, 1.3)], (0, -1, 0))
    bulbs = middle + random.uniform((-1, -1, 0.8), (1, 1, 2), (2, 3)) * distance
    paint = random.uniform(0.08, 0.8, (len(full.groups), 3))[full.facet_group]
    picture, K = texture(random), optics.pinhole(width, height, focal)
    light = [
        _light(full, Camera(K, width, height, A @ T), paint, bulbs, (picture, far - u - v, 2 * u, 2 * v))
        for A in (np.eye(4), D)
    ]
    top = np.percentile(light, 98)
    sides = []
    for A, L in zip((np.eye(4), D), light, strict=True):
        shown = np.clip(0.8 * L / top, 0, 1) ** (1 / 2.2) + random.normal(0, noise, L.shape)
        photograph = Photograph(np.round(255 * np.clip(shown, 0, 1)) / 255, 8, False, 3)
        sides.append(Side(Camera(K, width, height, A), photograph))
    return ObjectPair(load(folder, f"given-{seed}", polygons), full, sides, Camera(K, width, height, T))


def _light(model, camera, paint, bulbs, background):
    """(H, W, 3) radiosity: painted facets under bulbs, the last facet bears the texture (image, corner, u, v)."""
    import cv2

    K = np.array([[FINER, 0, (FINER - 1) / 2], [0, FINER, (FINER - 1) / 2], [0, 0, 1]]) @ camera.K
    fine = Camera(K, FINER * camera.width, FINER * camera.height, camera.T_cam_world)
    index = trials.draw(model, fine)
    R, t = fine.T_cam_world[:3, :3], fine.T_cam_world[:3, 3]
    p = (fine.directions(fine.pixels()) * index.depth[..., None] - t) @ R
    n = model.facet_normal[index.facet]
    n = n * np.sign(np.einsum("hwi,hwi->hw", n, -R.T @ t - p))[..., None]
    light = np.full(p.shape[:2], 0.35)
    for bulb in bulbs:
        d = bulb - p
        r = np.linalg.norm(d, axis=2)
        light += 1.2 * np.linalg.norm(bulb - p.mean(axis=(0, 1))) ** 2 * np.maximum((n * d).sum(axis=2), 0) / r**3
    rho = paint[index.facet]
    image, corner, u, v = background
    at = [((p - corner) @ a / (a @ a) * (len(image) - 1)).astype(np.float32) for a in (u, v)]
    seen = cv2.remap(image, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    wall = model.facet_object[index.facet] == model.objects.index("zwall")
    light = np.where(wall[..., None], seen, rho) * light[..., None]
    return cv2.resize(light, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
