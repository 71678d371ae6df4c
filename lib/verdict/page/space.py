"""Figure 2.5: the reconstructed facets against the model, in space, as pictures without a network or WebGL.

Seen from the left camera a facet looks right wherever along the rays it lies: its error is along the camera's axis. So
the views are parallel projections across that axis, from above and from the side, and one from behind the camera.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lib.buffers import edges
from lib.given.cameras import matrix_from_rt
from lib.verdict.page.pictures import uri

BACKGROUND, MODEL, SEEN = (20, 24, 28), (66, 72, 78), (225, 228, 230)  # RGB
MATCHED, OTHER, CAMERA = (70, 205, 110), (240, 160, 60), (255, 225, 77)
FILL = 0.3  # opacity of facets
MARGIN = 0.08  # of the picture, around what it shows
CAMERA_SIZE = 0.12  # of the distance to the facets
FRACTION_BITS = 4  # OpenCV draws to parts of a pixel


class SpaceView(NamedTuple):
    """One picture. words : where it is seen from;  picture : data URI"""

    words: str
    picture: str


class Scene(NamedTuple):
    """What is drawn, in the left camera's frame, m: x right, y down, z forward.

    model, seen : (E, 2, 3) edges, those of facets that no photograph shows and those of the others
    facets : [(k, 3)], matched : [bool]: is it recognised as one of the model's?
    cameras : [(4, 4)] T_left_camera
    """

    model: np.ndarray
    seen: np.ndarray
    facets: list
    matched: list
    cameras: list


def scene(model, facets, pose, cameras, seen_facets) -> Scene:
    """Of the model and facets.json, by the pose. cameras : {side: Camera} in the pair's frame

    seen_facets : numbers of the model's facets that the photographs show
    """
    scale = pose.scale or 1.0  # metres per unit of the pair
    T = matrix_from_rt(pose.rt_cam_world)
    vertices = model.vertices @ T[:3, :3].T + T[:3, 3]
    ends = edges.facet_edges(model)
    owner = np.zeros(len(vertices), int)
    owner[model.triangles] = model.triangle_facet[:, None]
    seen = np.isin(owner[ends[:, 0]], seen_facets)
    segments = vertices[ends]
    found = {match.left_label for match in pose.matches}
    left = cameras["left"].T_cam_world
    places = [left @ np.linalg.inv(camera.T_cam_world) for camera in cameras.values()]
    for place in places:
        place[:3, 3] *= scale
    return Scene(
        segments[~seen],
        segments[seen],
        [scale * np.asarray(f.polygon, float) for f in facets],
        [f.left_label in found for f in facets],
        places,
    )


# Rows: right, down and away in the picture, along the left camera's axes.
ABOVE = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
SIDE = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], float)


def _oblique(turn_deg=32, down_deg=28):
    """From behind the camera, to its right and above it."""
    a, b = np.radians([-turn_deg, down_deg])
    turn = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    return np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]) @ turn


VIEWS = (
    ("from above: the cameras look up the picture", ABOVE),
    ("from the cameras’ left: they look to the left", SIDE),
    ("from behind the cameras, to their right", _oblique()),
)


def views(of: Scene, width) -> list[SpaceView]:
    """The pictures, at most `width` wide; [] without facets."""
    if not of.facets:
        return []
    return [SpaceView(words, uri(drawn(of, axes, width))) for words, axes in VIEWS]


def drawn(of: Scene, axes, width) -> np.ndarray:
    """(H, W, 3) uint8: a parallel projection. axes : (3, 3) rows right, down, away"""
    import cv2

    far = np.median([np.linalg.norm(f, axis=1).mean() for f in of.facets])
    frusta = [frustum @ T[:3, :3].T + T[:3, 3] for T in of.cameras for frustum in [_frustum(CAMERA_SIZE * far)]]
    shown = np.concatenate([*of.facets, *(f.reshape(-1, 3) for f in frusta)]) @ axes[:2].T
    low, high = shown.min(axis=0), shown.max(axis=0)
    extent = np.maximum(high - low, 0.3 * (high - low).max() + 1e-9)
    px = width * (1 - 2 * MARGIN) / extent[0]
    height = int(min(extent[1] * px / (1 - 2 * MARGIN), width))
    px = min(px, height * (1 - 2 * MARGIN) / extent[1])
    offset = np.array([width, height]) / 2 - px * (low + high) / 2

    def to_picture(points):
        q = np.clip(points @ axes[:2].T * px + offset, -4 * width, 5 * width)
        return np.round(q * 2**FRACTION_BITS).astype(np.int32)

    def lines(segments, colour, thickness=1, closed=False):
        many = [to_picture(s) for s in segments]
        cv2.polylines(picture, many, closed, colour, thickness, cv2.LINE_AA, FRACTION_BITS)

    picture = np.full((height, width, 3), BACKGROUND, np.uint8)
    lines(of.model, MODEL)
    lines(of.seen, SEEN)
    for ring, matched in zip(of.facets, of.matched, strict=True):
        colour = MATCHED if matched else OTHER
        filled = picture.copy()
        cv2.fillPoly(filled, [to_picture(ring)], colour, cv2.LINE_AA, FRACTION_BITS)
        picture = cv2.addWeighted(filled, FILL, picture, 1 - FILL, 0)
        lines([ring], colour, 2, closed=True)
    for f in frusta:
        lines(f, CAMERA)
    return picture


def _frustum(size):
    """(8, 2, 3): the edges of a small pyramid, its tip at the camera."""
    base = size * np.array([[-0.5, -0.375, 1], [0.5, -0.375, 1], [0.5, 0.375, 1], [-0.5, 0.375, 1]])
    return np.concatenate(
        [np.stack([np.zeros_like(base), base], axis=1), np.stack([base, np.roll(base, -1, axis=0)], axis=1)]
    )
