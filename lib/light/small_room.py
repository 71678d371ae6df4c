"""A small room with a lamp: what warms kernels up, so that a bench's times are those of its work."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from lib.given.model.lids import Lids
from lib.light import adapt, form_factors, lamps
from lib.light import surface as surfaces

# A corner and two edges each: floor, ceiling, west and east walls, a lamp facing down, a table, a mat on the floor.
QUADS = [
    ((0, 0, 0), (1, 0, 0), (0, 1, 0)),
    ((0, 0, 1), (0, 1, 0), (1, 0, 0)),
    ((0, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 0, 0), (0, 0, 1), (0, 1, 0)),
    ((0.3, 0.3, 0.9), (0, 0.3, 0), (0.3, 0, 0)),
    ((0.3, 0.3, 0.5), (0.3, 0, 0), (0, 0.3, 0)),
    ((0.6, 0.6, 0), (0.2, 0, 0), (0, 0.2, 0)),
]


def small_room(*groups) -> surfaces.Surface:
    """The room's first quads, one group named for each; "lamp" emits."""
    o, a, b = (np.array(QUADS[: len(groups)], float)[:, k] for k in range(3))
    names = tuple(dict.fromkeys(groups))
    normal = np.cross(a, b) / np.linalg.norm(np.cross(a, b), axis=1)[:, None]
    model = SimpleNamespace(
        vertices=np.stack([o, o + a, o + a + b, o + b], axis=1).reshape(-1, 3),
        triangles=(4 * np.arange(len(o))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
        triangle_facet=np.repeat(np.arange(len(o)), 2).astype(np.int32),
        facet_normal=normal,
        facet_group=np.array([names.index(group) for group in groups], np.int32),
        facet_object=np.zeros(len(o), np.int32),
        groups=names,
        solid_objects=lambda: np.array([False]),
        lids=Lids(),
    )
    return surfaces.surface(model, ["lamp"])


def warm_up():
    """Load or compile every kernel of form factors, lamps and patches."""
    surface = small_room("wall", "wall", "wall", "wall", "lamp", "wall", "wall")
    emitters = lamps.emitters(surface, ["lamp"])
    mesh = adapt.build(surface, patches=20, max_level=1, contrast=0.1, emitters=emitters)
    form_factors.rays(surface, mesh, n_rays=16)
    lamps.patch_direct(surface, mesh, emitters, 1, n_points=4)
    form_factors.gather(surface, mesh, mesh.centre, np.arange(len(mesh) + 1), mesh.side, np.full(len(mesh), 16))
