"""What may be moved: the camera, its principal point, and objects of the model. And how edges follow."""

from dataclasses import dataclass, field, replace

import numpy as np

from lib.given.cameras import Camera, matrix_from_rt

CONTACT = 3e-4  # in diagonals of the model: a vertex that near to a facet of another object lies on it
FLAT = 0.2  # in spans of an object: one thinner than this that touches nothing slides in its own plane, as a lamp does
STATIC = 0.5  # objects whose box has more of the model's diagonal than this are not moved: walls, floor
POSE_PRIOR = (0.02, 0.02)  # sigma of a turn, rad, and of a move, in depths of the scene
CENTRE_PRIOR_PX = 20.0
OBJECT_PRIOR = (0.1, 0.1)  # sigma of an object's turn, rad, and of its move, m


@dataclass(frozen=True, eq=False)
class State:
    """Where camera and objects are taken to be.

    correction : (4, 4), given camera's coordinates to corrected ones        centre_px : (2,) added to cx, cy
    objects : {index: (4, 4)}, the model as given to the model as corrected, world
    """

    correction: np.ndarray = field(default_factory=lambda: np.eye(4))
    centre_px: np.ndarray = field(default_factory=lambda: np.zeros(2))
    objects: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Block:
    """Numbers of one cause.  kind : "pose" (6), "principal_point" (2), "object" (2 or 3) or "turn" (1)"""

    kind: str
    thing: int = -1


def corrected_camera(camera, correction, centre_px=(0.0, 0.0)) -> Camera:
    """The camera whose coordinates are `correction` (4, 4) x the given camera's, its principal point moved."""
    K = camera.K.copy()
    K[:2, 2] += centre_px
    return Camera(K, camera.width, camera.height, np.asarray(correction) @ camera.T_cam_world)


def corrected_model(model, objects):
    """The model with objects moved. Facets, groups, objects and their numbers stay.

    objects : {index of the object: (4, 4) world}
    """
    if not objects:
        return model
    vertices, normal, offset = model.vertices, model.facet_normal, model.facet_offset
    triangles = model.triangles.copy()
    triangle_object = model.facet_object[model.triangle_facet]
    normal, offset, extra = normal.copy(), offset.copy(), []
    number = len(vertices)
    for thing, T in objects.items():
        mine = triangle_object == thing
        used, where = np.unique(triangles[mine], return_inverse=True)  # others may use the same vertices
        extra.append(model.vertices[used] @ T[:3, :3].T + T[:3, 3])
        triangles[mine] = number + where.reshape(-1, 3)
        number += len(used)
        facets = model.facet_object == thing
        normal[facets] = normal[facets] @ T[:3, :3].T
        offset[facets] += normal[facets] @ T[:3, 3]
    vertices = np.concatenate([vertices, *extra])
    kept, where = np.unique(triangles, return_inverse=True)  # what nobody uses any more would still count as extent
    return replace(
        model,
        vertices=vertices[kept],
        triangles=where.reshape(-1, 3).astype(np.int32),
        facet_normal=normal,
        facet_offset=offset,
    )


class World:
    """The given camera and model, and in which directions each object may move."""

    def __init__(self, model, camera, fixed=()):
        self.model, self.camera = model, camera
        owner = model.facet_object[model.triangle_facet]
        corners = model.corners()
        self.corners = [corners[owner == thing].reshape(-1, 3) for thing in range(len(model.objects))]
        absent = np.array([len(p) == 0 for p in self.corners])  # objects that are not there are not moved
        self.corners = [p if len(p) else np.zeros((1, 3)) for p in self.corners]
        self.span = np.array([np.linalg.norm(np.ptp(p, axis=0)) for p in self.corners])
        self.span[absent] = np.inf
        self.middle = np.array([(p.min(axis=0) + p.max(axis=0)) / 2 for p in self.corners])
        whole = np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0))
        named = np.isin(model.objects, list(fixed))
        self.movable = np.flatnonzero((self.span < STATIC * whole) & ~named)
        self._axes = {}
        self._near = CONTACT * whole
        self._owner, self._triangles = owner, corners

    def axes(self, thing):
        """((n, 3) unit directions, normal (3,) or None): an object slides on what it stands on, or is free."""
        if thing not in self._axes:
            n = self._support(thing, self._near)
            n = self._own_plane(thing) if n is None else n
            if n is None:
                self._axes[thing] = (np.eye(3), None)
            else:
                a = np.eye(3)[np.argmin(np.abs(n))]
                u = np.cross(n, a) / np.linalg.norm(np.cross(n, a))
                self._axes[thing] = (np.array([u, np.cross(n, u)]), n)
        return self._axes[thing]

    def _own_plane(self, thing):
        """(3,) normal of a flat object's largest facet, None for another object."""
        facets = np.flatnonzero(self.model.facet_object == thing)
        n = self.model.facet_normal[facets[np.argmax(self.model.facet_area()[facets])]]
        return n if np.ptp(self.corners[thing] @ n) < FLAT * self.span[thing] else None

    def _support(self, thing, near):
        """(3,) normal of the plane that an object stands on or hangs at: that with most contacts, level ones first."""
        p = np.unique(self.corners[thing].round(9), axis=0)
        low, high = p.min(axis=0) - near, p.max(axis=0) + near
        t = self._triangles
        close = (self._owner != thing) & (t.min(axis=1) < high).all(axis=1) & (t.max(axis=1) > low).all(axis=1)
        t, n = t[close], self.model.facet_normal[self.model.triangle_facet[close]]
        if len(t) == 0 or len(p) * len(t) > 2_000_000:
            return None
        on = np.abs(np.einsum("vtk,tk->vt", p[:, None] - t[None, :, 0], n)) < near
        for k in range(3):
            side = np.cross(n, t[:, (k + 1) % 3] - t[:, k])
            side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-300)
            on &= np.einsum("vtk,tk->vt", p[:, None] - t[None, :, k], side) > -near
        up = -self.camera.T_cam_world[1, :3]
        best, normal = 0.0, None
        for i in np.flatnonzero(on.any(axis=0)):
            alike = np.abs(n @ n[i]) > 0.999
            contacts = np.count_nonzero(on[:, alike].any(axis=1))
            merit = contacts * (1 + 3 * (abs(n[i] @ up) > 0.8))
            if contacts >= 3 and merit > best:
                best, normal = merit, n[i]
        return normal

    def camera_at(self, state) -> Camera:
        return corrected_camera(self.camera, state.correction, state.centre_px)

    def model_at(self, state):
        return corrected_model(self.model, state.objects)

    def size(self, block) -> int:
        if block.kind == "object":
            return len(self.axes(block.thing)[0])
        return {"pose": 6, "principal_point": 2, "turn": 1}[block.kind]

    def prior(self, blocks, depth) -> np.ndarray:
        """(n,) sigma of each number: wide, so that what the edges do not tell stays where it is."""
        sigma = []
        for block in blocks:
            if block.kind == "pose":
                sigma += 3 * [POSE_PRIOR[0]] + 3 * [POSE_PRIOR[1] * depth]
            elif block.kind == "principal_point":
                sigma += 2 * [CENTRE_PRIOR_PX]
            elif block.kind == "turn":
                sigma.append(OBJECT_PRIOR[0])
            else:
                sigma += self.size(block) * [OBJECT_PRIOR[1]]
        return np.array(sigma)

    def project(self, state, p, owner):
        """(N, 2) px of points of the given model, each moved with its object."""
        return self.camera_at(state).project(self.moved(state, p, owner))

    def moved(self, state, p, owner):
        """(N, 3) m: points of the given model where the state has them."""
        p = p.copy()
        for thing, T in state.objects.items():
            mine = owner == thing
            p[mine] = p[mine] @ T[:3, :3].T + T[:3, 3]
        return p

    def jacobian(self, state, blocks, p, owner):
        """(N, 2, n) px: how projections follow the numbers of the blocks.  p : (N, 3) m, where the state has them"""
        camera = self.camera_at(state)
        x = camera.points(p)
        z = np.maximum(x[:, 2], 1e-9)
        K, zero = camera.K, np.zeros(len(p))
        row = lambda *columns: np.stack(columns, axis=-1)
        dq = np.stack(
            [
                row(K[0, 0] / z, K[0, 1] / z, -(K[0, 0] * x[:, 0] + K[0, 1] * x[:, 1]) / z**2),
                row(zero, K[1, 1] / z, -K[1, 1] * x[:, 1] / z**2),
            ],
            axis=1,
        )
        columns = []
        for block in blocks:
            mine = (owner == block.thing)[:, None, None]
            if block.kind == "pose":
                cross = np.cross(np.eye(3)[None], x[:, None])  # d(omega x x) / d omega_k = e_k x x
                columns += [np.einsum("nij,nkj->nik", dq, cross), dq]
            elif block.kind == "principal_point":
                columns.append(np.broadcast_to(np.eye(2), (len(p), 2, 2)))
            else:
                dx = dq @ camera.T_cam_world[:3, :3]
                columns.append(mine * np.einsum("nij,nkj->nik", dx, self._ways(state, block, p)))
        return np.concatenate(columns, axis=2) if columns else np.zeros((len(p), 2, 0))

    def _ways(self, state, block, p):
        """(N, n, 3): how points move with the numbers of an object's block."""
        axes, normal = self.axes(block.thing)
        if block.kind == "object":
            return np.broadcast_to(axes, (len(p), *axes.shape))
        return np.cross(normal, p - self._middle_at(state, block.thing))[:, None]

    def twist(self, state, block):
        """(6, n): the turn and move of the world, (omega, tau), by the numbers of an object's block."""
        axes, normal = self.axes(block.thing)
        if block.kind == "object":
            return np.concatenate([np.zeros((3, len(axes))), axes.T])
        return np.concatenate([normal, -np.cross(normal, self._middle_at(state, block.thing))])[:, None]

    def _middle_at(self, state, thing):
        T = state.objects.get(thing, np.eye(4))
        return T[:3, :3] @ self.middle[thing] + T[:3, 3]

    def step(self, state, blocks, numbers) -> State:
        """The state after the blocks' numbers were added to it."""
        correction, centre, objects = state.correction, state.centre_px, dict(state.objects)
        at = 0
        for block in blocks:
            v = numbers[at : at + self.size(block)]
            at += len(v)
            if block.kind == "pose":
                correction = matrix_from_rt(v) @ correction
            elif block.kind == "principal_point":
                centre = centre + v
            else:
                objects[block.thing] = self._change(state, block, v) @ objects.get(block.thing, np.eye(4))
        return State(correction, centre, objects)

    def _change(self, state, block, v):
        """(4, 4) world: a slide along the object's axes, or a turn about its support's normal through its middle."""
        axes, normal = self.axes(block.thing)
        if block.kind == "object":
            return matrix_from_rt([0, 0, 0, *(v @ axes)])
        T = matrix_from_rt([*(v[0] * normal), 0, 0, 0])
        middle = self._middle_at(state, block.thing)
        T[:3, 3] = middle - T[:3, :3] @ middle
        return T

    def without(self, state, block) -> State:
        """The state with one cause taken back. A turn goes with its slide; alone, its object keeps its middle."""
        if block.kind == "pose":
            return replace(state, correction=np.eye(4))
        if block.kind == "principal_point":
            return replace(state, centre_px=np.zeros(2))
        objects = {k: T for k, T in state.objects.items() if k != block.thing}
        if block.kind == "turn":
            slide = np.eye(4)
            slide[:3, 3] = self._middle_at(state, block.thing) - self.middle[block.thing]
            objects[block.thing] = slide
        return replace(state, objects=objects)
