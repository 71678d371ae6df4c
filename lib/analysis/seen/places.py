"""Where the photograph's edges put the camera, its principal point, objects and lamps: as causes, and in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.buffers.opengl import NoGraphics
from lib.given import cameras
from lib.given.cameras import Camera, matrix_from_rt
from lib.given.causes import GEOMETRIC
from lib.given.edges_file import Found, Loose
from lib.given.materials import Cause, Rival, Why
from lib.given.model.glb_writer import keeps_parts, write_glb
from lib.given.model.mesh import Model
from lib.given.view import View
from lib.vision.registration.mistakes import mistake
from lib.vision.registration.register import Registration, register

SHOWN = 0.85  # of the edges, from which they are no other place's
TWIST = "twist_covariance"  # (6, 6) of an object's turn and move, world, beside the sigma of what it found


@dataclass(frozen=True)
class Places:
    """What stands elsewhere than the given files say, the likeliest first.

    registration : None where the edges cannot be looked at
    causes : [Cause], as materials.json lists them;  why : [Why], the same in words
    is_lost : the photograph does not show the model as it is given
    """

    registration: Registration | None
    causes: list
    why: list
    is_lost: bool = False

    def refined(self, view: View, causes) -> Refined | None:
        """Camera and model where the edges have them; None where nothing is off, or where not all of it may be taken.

        causes : that may be, as scene.yaml has them; None: all
        """
        leave = {"principal_point": "pose"}
        may = GEOMETRIC if causes is None else causes
        if self.is_lost or not self.causes or any(leave.get(c.cause, c.cause) not in may for c in self.causes):
            return None
        found = self.registration
        moved = found.pose is not None or found.centre_px is not None
        camera = found.camera(view.camera) if moved else None
        model = found.model(view.model) if found.objects else None
        return Refined(camera, model) if model is None or keeps_parts(model) else None

    @property
    def told(self) -> Found:
        """The same as edges.json has it."""
        found = self.registration
        if found is None:
            return Found()
        loose = [Loose(name, tuple(map(tuple, C.tolist()))) for name, C in found.loose.items()]
        px = (found.before_px, found.after_px)
        shares = (float(found.seen.found), float(found.seen.chance))
        return Found(True, self.is_lost, self.causes, self.why, loose, *px, found.n_edges, *shares)


@dataclass(frozen=True, eq=False)
class Refined:
    """camera, model : None where they are as given"""

    camera: Camera | None
    model: Model | None

    def write(self, camera, model):
        """The files of what is not as given."""
        if self.camera is not None:
            cameras.write_cameramodel(camera, self.camera)
        if self.model is not None:
            write_glb(model, self.model)


def by_edges(view: View, lamps) -> Places:
    """lamps : names of the groups that emit"""
    try:
        found = register(view.model, view.camera, view.photograph)
    except (ImportError, NoGraphics):
        return Places(None, [], [])
    slip = mistake(view.model, view.camera, view.photograph, found.seen) if found.seen.found < SHOWN else None
    if slip is not None:
        return Places(found, [], [Why(slip.cause, None, slip.text, None)], is_lost=True)
    if found.seen.is_surely_lost:
        return Places(found, [], _lost(found), is_lost=True)
    pairs = [*_camera(found), *(_thing(found, view.model, name, lamps) for name in found.objects)]
    pairs.sort(key=lambda pair: -(pair[0].evidence_nats or 0))
    return Places(found, *([pair[k] for pair in pairs] for k in (0, 1)))


def _lost(found):
    """[Why] the photograph hardly shows the model's edges."""
    text = (
        f"the photograph has {found.seen.found:.0%} of the model's edges, too few"
        f" ({found.seen.chance:.0%} by chance): the camera, the model's unit or its axes are not as"
        " given, or noise hides them"
    )
    return [Why("camera", None, text, None)]


def _camera(found):
    """(Cause, Why) of the pose and of the principal point, as far as they are off."""
    if found.pose is not None:
        degrees, mm = np.degrees(np.linalg.norm(found.pose[:3])), 1000 * np.linalg.norm(found.pose[3:])
        text = f"the camera is turned by {degrees:.2f} degrees and moved by {mm:.0f} mm"
        yield _pair(found, "pose", "pose", None, "rt_correction", found.pose, found.covariance, text)
    if found.centre_px is not None:
        x, y = found.centre_px
        text = f"the principal point is off by ({x:+.2f}, {y:+.2f}) px"
        key = "principal_point"
        yield _pair(found, key, key, None, "offset_px", found.centre_px, found.centre_covariance, text)


def _thing(found, model, name, lamps):
    """(Cause, Why) of an object that stands elsewhere."""
    moved, lamp = found.objects[name], lamp_of(model, name, lamps)
    middle = middle_of(model, name)
    T = matrix_from_rt(moved.rt)
    offset = T[:3, :3] @ middle + T[:3, 3] - middle
    text = f"object {name!r} stands {1000 * np.linalg.norm(offset):.0f} mm from where the model has it"
    if lamp:
        shift = np.hstack([_cross(middle), np.eye(3)])  # of the middle, by a turn and a move of the world
        return _pair(
            found,
            ("objects", name),
            "lamp_place",
            lamp,
            "offset_m",
            offset,
            shift @ moved.covariance @ shift.T,
            text,
        )
    return _pair(found, ("objects", name), "objects", name, "rt_world_object", moved.rt, moved.covariance, text)


def _cross(p):
    """(3, 3): omega x p = _cross(p) @ omega."""
    return np.array([[0, p[2], -p[1]], [-p[2], 0, p[0]], [p[1], -p[0], 0]])


def _pair(found, key, cause, subject, value, numbers, covariance, text):
    nats = found.nats.get(key)
    nats = None if nats is None else float(nats)
    rivals = [Rival(kind, float(n)) for kind, n in found.rivals.items() if kind != cause and isinstance(kind, str)]
    values = {value: [float(v) for v in numbers]}
    sigma = {value: [float(s) for s in np.sqrt(np.maximum(np.diag(covariance), 0))]}
    if subject is not None:
        sigma[TWIST] = found.objects[key[1]].covariance.tolist()
    said = f"{text}, say the edges of the photograph (median {found.before_px:.2f} px off, then {found.after_px:.2f})"
    return Cause(cause, subject, values, sigma, nats, rivals), Why(cause, subject, said, nats)


def _facets(model, name):
    return np.flatnonzero(np.asarray(model.facet_object) == model.objects.index(name))


def middle_of(model, name):
    """(3,) m, of the object's vertices."""
    triangles = np.isin(model.triangle_facet, _facets(model, name))
    return model.vertices[model.triangles[triangles]].reshape(-1, 3).mean(axis=0)


def object_of(model, cause: Cause):
    """The number of the object that a cause moves."""
    if cause.cause != "lamp_place":
        return model.objects.index(cause.subject)
    facets = np.asarray(model.facet_group) == model.groups.index(cause.subject)
    return int(np.asarray(model.facet_object)[facets][0])


def lamp_of(model, name, lamps):
    """The lamp that is of this object, or None."""
    groups = {model.groups[g] for g in np.asarray(model.facet_group)[_facets(model, name)]}
    return next((lamp for lamp in lamps if lamp in groups), None)
