"""Stereo pairs with known answers.

A model drawn in two pinhole views, each facet with its own shaded colour, blurred by the pixel's area, noisy.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lib.buffers import index_buffer
from lib.given import cameras
from lib.given import model as models
from lib.given.cameras import Camera

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, eq=False)
class Pair:
    """left, right : Camera; values : two (H, W, 3) in [0, 1] without noise.

    facet : two (H, W), -1 = nothing
    labels : two (H, W) int32, the true regions: 4-connected parts of one facet
    facet_of : two (N + 1,), the facet of each label
    """

    model: object
    left: Camera
    right: Camera
    values: tuple
    facet: tuple
    labels: tuple
    facet_of: tuple

    def noisy(self, sigma, rng, bits=8):
        """The photographs as a camera gives them."""
        steps = 2**bits - 1
        return [
            np.ascontiguousarray(np.round(np.clip(v + rng.normal(0, sigma, v.shape), 0, 1) * steps) / steps)
            for v in self.values
        ]

    def plane(self, label):
        """(3,) m of the facet of a left label in the left frame, m . x = 1."""
        f = self.facet_of[0][label]
        R, t = self.left.T_cam_world[:3, :3], self.left.T_cam_world[:3, 3]
        n = R @ self.model.facet_normal[f]
        return n / (self.model.facet_offset[f] + n @ t)


def components(facet):
    """(H, W) int32 labels from 1 of the 4-connected parts of equal facet (-1: label 0), and the facet of each label."""
    import cv2

    labels = np.zeros(facet.shape, np.int32)
    of = [-1]
    for f in np.unique(facet[facet >= 0]):
        n, part = cv2.connectedComponents((facet == f).astype(np.uint8), connectivity=4)
        labels[part > 0] = part[part > 0] + len(of) - 1
        of += [int(f)] * (n - 1)
    return labels, np.array(of)


def turned(left, angle_deg, distance, twist_deg=0.0):
    """The right camera: moved to its right so that both axes meet at `distance` under the angle."""
    a = np.radians(angle_deg)
    R, c = left.T_cam_world[:3, :3], left.centre
    target = c + distance * R[2]
    half = 2 * distance * np.sin(a / 2)
    centre = c + half * (np.cos(a / 2) * R[0] + np.sin(a / 2) * R[2])
    z = (target - centre) / np.linalg.norm(target - centre)
    x = np.cross(R[1], z)
    x /= np.linalg.norm(x)
    R2 = np.stack([x, np.cross(z, x), z])
    s = np.radians(twist_deg)
    R2 = np.array([[np.cos(s), -np.sin(s), 0], [np.sin(s), np.cos(s), 0], [0, 0, 1]]) @ R2
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R2, -R2 @ centre
    return Camera(left.K, left.width, left.height, T)


def draw(model, camera, colour, shade, samples=32):
    """(H, W, 3) area-averaged colours, (H, W) facet at the pixels' centres.

    The shading moves with the surface: the same in every view.

    The samples of a pixel form a Hammersley set: no two share a row or a column, so upright edges are as exact as
    slanted ones.
    """
    k = np.arange(samples)
    halves = sum(((k >> bit) & 1) / 2.0 ** (bit + 1) for bit in range(samples.bit_length() - 1))
    origin = np.einsum("ij,ij->i", model.vertices[model.triangles[:, 0]], shade[model.triangle_facet])
    values = np.zeros((camera.height, camera.width, 3))
    for dx, dy in zip((k + 0.5) / samples - 0.5, halves + 0.5 / samples - 0.5, strict=True):
        K = camera.K.copy()
        K[:2, 2] -= dx, dy
        moved = Camera(K, camera.width, camera.height, camera.T_cam_world)
        index = index_buffer.reference(model, moved)
        p = camera.centre + (moved.directions(moved.pixels()) * index.depth[..., None]) @ camera.T_cam_world[:3, :3]
        light = 1 + np.einsum("...i,...i", p, shade[index.facet]) - origin[index.triangle]
        values += np.where(index.facet[..., None] >= 0, colour[index.facet] * light[..., None], 0).clip(0, 1) / samples
    return values, index_buffer.reference(model, camera).facet


def office(
    angle_deg=7.0, seed=0, focal=600.0, size=(640, 480), shading=0.03, samples=32, path=ROOT / "data" / "office"
):
    """The office in two views.

    Colours and shading of each facet by the seed, and a slightly moved camera unless it is 0.
    """
    rng = np.random.default_rng([11, seed])
    model = models.load(path / "model.obj")
    left = cameras.read_cameramodel(path / "left.posed.cameramodel")
    K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    T = left.T_cam_world
    if seed:
        T = cameras.matrix_from_rt([*rng.normal(0, 0.02, 3), *rng.normal(0, 0.05, 3)]) @ T
    left = Camera(K, *size, T)
    right = turned(left, angle_deg, 3.5, twist_deg=0.5)
    base = rng.uniform(0.15, 0.85, (len(model.groups), 3))[model.facet_group]
    colour = (base * rng.uniform(0.6, 1.0, (model.n_facets, 1))).clip(0.05, 0.9)
    shade = rng.normal(0, shading, (model.n_facets, 3))
    drawn = [draw(model, c, colour, shade, samples) for c in (left, right)]
    parts = [components(f) for _, f in drawn]
    return Pair(
        model,
        left,
        right,
        tuple(d[0] for d in drawn),
        tuple(d[1] for d in drawn),
        tuple(p[0] for p in parts),
        tuple(p[1] for p in parts),
    )


# -- quadrilaterals in the air before a wall: exact planes, exact borders, a new scene for each seed, in milliseconds


@dataclass(frozen=True, eq=False)
class Quads:
    """As Pair, without a model: label k + 1 is quadrilateral k, the wall is the last label; m : (N + 1, 3) by label."""

    left: Camera
    right: Camera
    values: tuple
    labels: tuple
    m: np.ndarray
    noisy = Pair.noisy


def half_plane(q, n, d):
    """Share of the unit square round each q (..., 2) on which n . x <= d."""
    a, b = np.abs(n) + 1e-12
    t = d - q @ n + (a + b) / 2
    square = lambda x: np.maximum(x, 0) ** 2
    return ((square(t) - square(t - a) - square(t - b) + square(t - a - b)) / (2 * a * b)).clip(0, 1)


def quads(seed=0, angle_deg=7.0, size=(480, 360), focal=450.0, columns=3, rows=2, grey=False, baseline=None, tilt=0.8):
    """columns x rows quadrilaterals of random shape, plane and colour, 2 to 4 m away.

    baseline : m, instead of the angle: parallel cameras.
    """
    rng = np.random.default_rng([5, seed])
    K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    left = Camera(K, *size, np.eye(4))
    right = turned(left, angle_deg, 3.0, twist_deg=rng.uniform(-1, 1))
    if baseline is not None:
        T = np.eye(4)
        T[0, 3] = -baseline
        right = Camera(K, *size, T)
    wall = np.array([0, 0, 1 / 5.0])
    m, corners, colours = [wall], [], []
    cell = np.array(size) / [columns, rows]
    base = rng.uniform(0.3, 0.7, 3)
    for k in range(columns * rows):
        middle = (np.array([k % columns, k // columns]) + 0.5) * cell
        q = middle + cell * 0.34 * rng.uniform(0.75, 1.0, (4, 2)) * [[-1, -1], [1, -1], [1, 1], [-1, 1]]
        n = rng.normal(0, tilt / 2, 3).clip(-tilt, tilt) * [1, 1, 0] + [0, 0, 1]
        v = left.directions(middle[None])[0]
        m.append(n / (n @ v) / rng.uniform(2.2, 3.8))
        corners.append(q)
        colour = rng.uniform(0.05, 0.95, 3)
        while np.abs(colour - base).max() < 0.25 or abs((colour - base).mean()) < 0.1:
            colour = rng.uniform(0.05, 0.95, 3)
        colours.append(colour)
    m = np.array(m[1:] + m[:1])
    values, labels = [], []
    for camera in (left, right):
        q = camera.pixels()
        picture, label = (
            np.broadcast_to(base, (*q.shape[:2], 3)).copy(),
            np.full(q.shape[:2], columns * rows + 1, np.int32),
        )
        for k, (ring, colour) in enumerate(zip(corners, colours, strict=True)):
            v = left.directions(ring)
            ring = camera.project(v / (v @ m[k])[:, None])
            cover, inside = np.ones(q.shape[:2]), np.ones(q.shape[:2], bool)
            for a, b in zip(ring, np.roll(ring, -1, 0), strict=True):
                n = np.array([b[1] - a[1], a[0] - b[0]]) / np.linalg.norm(b - a)
                cover *= half_plane(q, n, n @ a)
                inside &= q @ n <= n @ a
            picture += cover[..., None] * (colour - base)
            label[inside] = k + 1
        values.append(picture.clip(0, 1).mean(axis=2, keepdims=True) if grey else picture.clip(0, 1))
        labels.append(label)
    return Quads(left, right, tuple(values), tuple(labels), np.vstack([np.zeros(3), m]))


def textured(seed=0, angle_deg=7.0, size=(320, 240), focal=300.0, contrast=0.15):
    """One plane with a soft random texture.

    Label 1 is a rectangle on it, whose border has no contrast, label 2 the rest.
    """
    rng = np.random.default_rng([6, seed])
    K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    left = Camera(K, *size, np.eye(4))
    right = turned(left, angle_deg, 3.0, twist_deg=rng.uniform(-1, 1))
    n = np.array([*rng.uniform(-0.5, 0.5, 2), 1.0])
    m = n / 3.0 / rng.uniform(0.8, 1.2)
    waves = rng.normal(0, 1, (40, 2)) * focal / 3.0 / 8 * 2 * np.pi / 2  # rad / m: periods of 8 pixels and more, mostly
    phase, size_of = rng.uniform(0, 2 * np.pi, (40, 3)), contrast / np.sqrt(20)
    values, labels = [], []
    for camera in (left, right):
        v = camera.directions(camera.pixels()) @ camera.T_cam_world[:3, :3]  # left frame, from the camera's centre
        p = camera.centre + v * ((1 - m @ camera.centre) / (v @ m))[..., None]
        values.append((0.5 + size_of * np.cos(p[..., :2] @ waves.T)[..., None] * np.cos(phase)).sum(axis=-2) - 0.5 * 39)
        labels.append(np.where((np.abs(p[..., 0]) < 0.8) & (np.abs(p[..., 1]) < 0.6), 1, 2).astype(np.int32))
    return Quads(left, right, tuple(x.clip(0, 1) for x in values), tuple(labels), np.array([np.zeros(3), m, m]))


def parallel(width, height, focal, baseline):
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    T = np.eye(4)
    T[0, 3] = -baseline
    return Camera(K, width, height, np.eye(4)), Camera(K, width, height, T)
