"""Where the photograph's edges put the camera and the objects, in words: what is likeliest wrong with the geometry."""

from __future__ import annotations

import numpy as np

from lib.buffers.opengl import NoGraphics
from lib.given.materials import Why
from lib.given.view import View
from lib.vision.registration.register import register

LOOK = 0.4  # Result.correlated from which the edges are looked at; exact rooms have .2 to .45


def displaced(view: View, lamps) -> list[Why]:
    """What stands elsewhere than the given files say; [] where the edges agree, or cannot be looked at.

    lamps : names of the groups that emit
    """
    try:
        found = register(view.model, view.camera, view.photograph)
    except (ImportError, NoGraphics):
        return []
    why = []
    if found.pose is not None:
        text = f"the camera is turned by {_degrees(found.pose):.2f} degrees and moved by {_mm(found.pose):.0f} mm"
        why.append(_why("pose", None, text, found, "pose"))
    if found.centre_px is not None:
        x, y = found.centre_px
        text = f"the principal point is off by ({x:+.2f}, {y:+.2f}) px"
        why.append(_why("principal_point", None, text, found, "principal_point"))
    for name, moved in found.objects.items():
        lamp = _lamp_of(view.model, name, lamps)
        offset = moved.rt[3:] + _turned(moved.rt[:3], _centre(view.model, name)) - _centre(view.model, name)
        text = f"object {name!r} stands {1000 * np.linalg.norm(offset):.0f} mm from where the model has it"
        why.append(_why("lamp_place" if lamp else "objects", lamp or name, text, found, ("objects", name)))
    return sorted(why, key=lambda w: -(w.evidence_nats or 0))


def _why(cause, subject, text, found, key):
    nats = found.nats.get(key)
    said = f"{text}, say the edges of the photograph (median {found.before_px:.2f} px off, then {found.after_px:.2f})"
    return Why(cause, subject, said, None if nats is None else float(nats))


def _degrees(rt):
    return np.degrees(np.linalg.norm(rt[:3]))


def _mm(rt):
    return 1000 * np.linalg.norm(rt[3:])


def _turned(r, point):
    import cv2

    return cv2.Rodrigues(np.asarray(r, float))[0] @ point


def _facets(model, name):
    return np.flatnonzero(np.asarray(model.facet_object) == model.objects.index(name))


def _centre(model, name):
    """(3,) m, of the object's vertices."""
    triangles = np.isin(model.triangle_facet, _facets(model, name))
    return model.vertices[model.triangles[triangles]].reshape(-1, 3).mean(axis=0)


def _lamp_of(model, name, lamps):
    """The lamp that is of this object, or None."""
    groups = {model.groups[g] for g in np.asarray(model.facet_group)[_facets(model, name)]}
    return next((lamp for lamp in lamps if lamp in groups), None)
