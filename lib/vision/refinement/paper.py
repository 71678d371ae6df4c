"""The paper's refinement: its gradient on the vertices of matched facets; a method to compare with."""

import math

import numpy as np

from lib.vision.recognition.closed_form import moved
from lib.vision.refinement.edges import draw
from lib.vision.refinement.rig import point, project


def paper_method(model, rig, T, scale, matches, labels, trace, iterations=400):
    """(T, RMS px): corners of the recognised facets onto the corners of their regions, by plain gradient descent.

    matches : (n, 2) scene facet, model facet; labels : (N, 2) of the scene facets' regions; trace : points are added

    Each corner that a camera sees goes with the nearest corner of its region's outline. The step is the longest that
    cannot diverge. It is taken again until the error stops falling. Simplest, least accurate: regions end where colours
    do.
    """
    targets = _targets(model, rig, matches, labels)
    before = math.inf
    for iteration in range(iterations):
        if iteration % 20 == 0:  # who sees what, who goes with whom
            pairs = list(_pairs(model, rig.cameras(T, scale), targets))
        H, g, cost, number = np.zeros((6, 6)), np.zeros(6), 0.0, 0
        for side, p, wanted in pairs:
            q, J = project(rig, side, T, scale, p, True)
            r = q - wanted
            H += np.einsum("nik,nil->kl", J, J)
            g += np.einsum("nik,ni->k", J, r)
            cost, number = cost + (r**2).sum(), number + len(p)
        if number < 3:
            break
        error = math.sqrt(cost / number)
        trace[0]["error_px"] = trace[0]["error_px"] or error
        trace.append(point(trace, T, error, samples=number))
        if iteration % 20 == 19 and error > before * (1 - 1e-3):
            break
        before = error if iteration % 20 == 19 else before
        T = moved(T, -g / np.linalg.eigvalsh(H)[-1])
    return T, trace[-1]["error_px"]


def _targets(model, rig, matches, labels):
    """[(side, facet, its corners (k, 3) m, the corners of its region's outline (n, 2) px)]."""
    import cv2

    targets = []
    for side, s in enumerate(rig.sides):
        for i, f in matches:
            label = labels[i, side]
            if s.surfaces is None or label <= 0:
                continue
            mask = (s.surfaces == label).astype(np.uint8)
            contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
            if contours:
                outline = cv2.approxPolyDP(max(contours, key=cv2.contourArea), 2.0, True)[:, 0].astype(float)
                p = model.vertices[np.unique(model.triangles[model.triangle_facet == f])]
                targets.append((side, f, p, outline))
    return targets


def _pairs(model, cameras, targets):
    """(side, corners (k, 3) m that the camera sees, the corner of the region (k, 2) px that each goes with)."""
    drawn = [draw(model, camera).facet for camera in cameras]
    for side, f, p, outline in targets:
        q, camera = cameras[side].project(p), cameras[side]
        inside = (q > -0.5).all(axis=1) & (q < np.array([camera.width, camera.height]) - 0.5).all(axis=1)
        p, q = p[inside], q[inside]
        at = np.rint(q).astype(int)
        beside = [drawn[side][max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3] for x, y in at]
        shown = np.array([(here == f).any() for here in beside], bool)
        p, q = p[shown], q[shown]
        if len(p):
            gap = np.linalg.norm(q[:, None] - outline[None], axis=2)
            near = gap.min(axis=1) < 0.3 * max(np.ptp(outline, axis=0).max(), 10)
            yield side, p[near], outline[gap.argmin(axis=1)[near]]
