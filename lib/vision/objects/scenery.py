"""What the photographs show of a model whose objects may stand elsewhere, or nowhere."""

from dataclasses import dataclass, field, replace

import numpy as np

from lib.given.cameras import Camera
from lib.vision.refinement.edges import model_edges, pyramid, visible_samples
from lib.vision.refinement.rig import Rig, rig_of
from lib.vision.registration.motions import corrected_model

MARGIN_PX = 48  # about an object that is looked at alone
GRID_PX = 16  # of a window: so that its reduced pictures have whole pixels


@dataclass(frozen=True, eq=False)
class Photographs:
    """The posed photographs, or windows of them.

    rig : Rig; its T is the left camera's    pyramids : {factor: Level} per side    T_left_world : (4, 4)
    """

    rig: Rig
    pyramids: list
    T_left_world: np.ndarray

    @classmethod
    def of(cls, sides, depth):
        """sides : rig.Side of the left photograph, and of the right one if there is one, posed.  depth : m"""
        pyramids = [pyramid(side.photograph, 8) for side in sides]
        return cls(rig_of(sides, depth), pyramids, sides[0].camera.T_cam_world)

    def cameras(self):
        return self.rig.cameras(self.T_left_world, 1.0)

    def window(self, p_world):
        """The parts that show points (N, 3) m, and some margin; None where no photograph does."""
        sides, relative, pyramids = [], [], []
        for side, D, levels, camera in zip(
            self.rig.sides, self.rig.relative, self.pyramids, self.cameras(), strict=True
        ):
            x = camera.points(p_world)
            low, high = np.zeros(2), np.array([camera.width, camera.height])
            if x[:, 2].min() > 0.02 * self.rig.depth:
                q = camera.project(p_world)
                low = np.maximum(low, q.min(axis=0) - MARGIN_PX) // GRID_PX * GRID_PX
                high = np.minimum(high, -(-(q.max(axis=0) + MARGIN_PX) // GRID_PX) * GRID_PX)
            elif x[:, 2].max() <= 0:
                continue
            if (high - low < MARGIN_PX).any():
                continue
            (x0, y0), (x1, y1) = low.astype(int), high.astype(int)
            K = camera.K.copy()
            K[:2, 2] -= x0, y0
            sides.append(replace(side, camera=Camera(K, x1 - x0, y1 - y0, side.camera.T_cam_world)))
            relative.append(D)
            pyramids.append({f: _cut(level, x0 // f, x1 // f, y0 // f, y1 // f) for f, level in levels.items()})
        if not sides:
            return None
        return Photographs(Rig(tuple(sides), tuple(relative), self.rig.depth), pyramids, self.T_left_world)


def _cut(level, x0, x1, y0, y1):
    return replace(level, picture=np.ascontiguousarray(level.picture[y0:y1, x0:x1]))


@dataclass(frozen=True, eq=False)
class Scenery:
    """A model, and where its objects are.

    model : Model with every object as drawn, or in the frame of its own file
    poses : {index of the object: T_world_object (4, 4), or None where it is absent}; the others are as drawn
    """

    model: object
    poses: dict = field(default_factory=dict)

    def at(self, thing, T):
        """With one object elsewhere."""
        return Scenery(self.model, {**self.poses, thing: T})

    def posed(self):
        """The Model with its objects in place. All numbers stay; an absent object's facets have no triangles."""
        gone = [thing for thing, T in self.poses.items() if T is None]
        moved = {k: T for k, T in self.poses.items() if T is not None and not np.array_equal(T, np.eye(4))}
        model = corrected_model(self.model, moved)
        if not gone:
            return model
        kept = ~np.isin(model.facet_object[model.triangle_facet], gone)
        return replace(model, triangles=model.triangles[kept], triangle_facet=model.triangle_facet[kept])

    def points(self, thing):
        """(N, 3) m: the corners of an object, in its own frame."""
        model = self.model
        return model.vertices[np.unique(model.triangles[model.facet_object[model.triangle_facet] == thing])]


def own_samples(scenery, thing, photographs, factor, reach, step_px=3.0):
    """Samples of an object's visible edges per side; p in the world. Whatever stands before it hides them."""
    model = scenery.posed()
    edges = model_edges(model)
    owner = np.append(model.facet_object, -1)
    mine = (owner[edges.facets] == thing).any(axis=1)
    out = []
    for camera in photographs.cameras():
        s = visible_samples(model, edges, camera, factor, step_px=step_px, reach=reach)
        keep = mine[s.edge] & (owner[np.maximum(s.sides, -1)] == thing).any(axis=1)
        out.append(replace(s, **{name: getattr(s, name)[keep] for name in s.__dataclass_fields__}))
    return out
