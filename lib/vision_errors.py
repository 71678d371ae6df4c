"""What the vision half found against what is true: lenses, planes, disparities, pose.  Used by the comparison alone.

    pose.angle_deg, pose.centre_mm          rotation between the found and the true camera, distance of their centres
    pose.in_sigmas                          sqrt(e' C^-1 e / 6) of the six errors e, by the covariance that pose.json gives: near 1 if that is honest
    pose.vertices_px, pose.vertices_max_px  visible vertices of the model in the photograph's own pixels, each camera with its own lens: rms, worst
    lens.<side>.projection_px               rms distance between the two lenses' pixels of one direction, after the best common rotation
    lens.<side>.focal_relative              |f / f* - 1|
    pair.baseline_relative                  |b / b* - 1|                      pair.angle_deg     between the two relative rotations
    facets.angle_deg, facets.distance_relative     median over the facets that lie on the model: normal, distance at the facet's middle
    facets.within_95                        share of the planes inside the 95 % ellipsoid of their covariance
    facets.wrong                            share of the facets more than 5 degrees or 5 % from the model's facet they show
    disparity.median_px, disparity.covered  of the planes inside their left regions; share of the picture that these cover
"""
from __future__ import annotations

import numpy as np

CHI2_3 = 7.814727903251179          # 95 % of chi-square with 3 degrees of freedom


def angle_deg(R):
    """Angle of a rotation (3, 3) or of R_a R_b'; steady near 0.

    >>> angle_deg(np.eye(3))
    0.0
    """
    s = np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    return float(np.degrees(np.arctan2(s, (np.trace(R) - 1) / 2)))


def pose(T, T_true, covariance=None):
    """[(name, value, unit)]; T : (4, 4) world to camera; covariance : (6, 6) of (omega, tau), T_true = exp(omega, tau) T, rad and m."""
    centre = lambda M: -M[:3, :3].T @ M[:3, 3]
    out = [("pose.angle_deg", angle_deg(T[:3, :3] @ T_true[:3, :3].T), "deg"),
           ("pose.centre_mm", float(1000 * np.linalg.norm(centre(T) - centre(T_true))), "mm")]
    if covariance is not None:
        from lib.cameras import rt_from_matrix
        e = rt_from_matrix(T_true @ np.linalg.inv(T))              # to first order also the twist of se(3)
        out.append(("pose.in_sigmas", float(np.sqrt(max(e @ np.linalg.pinv(np.asarray(covariance, float)) @ e, 0) / 6)), "sigma"))
    return out


def vertices(project, project_true, T, T_true, model, depth=None, size=None):
    """rms and worst distance, in pixels, of the model's vertices that the true camera sees.

    project, project_true : (N, 3) camera coordinates -> (N, 2) px, of the found and the true lens
    depth : (H, W) m, from about the same place: a vertex behind it is hidden
    """
    p, p_true = (model.vertices @ M[:3, :3].T + M[:3, 3] for M in (T, T_true))
    front = (p[:, 2] > 0) & (p_true[:, 2] > 0)
    p, p_true = p[front], p_true[front]
    q, q_true = project(p), project_true(p_true)
    W, H = size
    inside = np.isfinite(q).all(1) & np.isfinite(q_true).all(1) & (q_true > -0.5).all(1) & (q_true < [W - 0.5, H - 0.5]).all(1)
    if depth is not None and inside.any():
        import cv2
        near = cv2.dilate(np.where(depth > 0, depth, np.inf).astype(np.float32), np.ones((5, 5), np.uint8))
        x, y = np.clip(np.rint(q[inside]).astype(int), 0, [W - 1, H - 1]).T
        inside[np.flatnonzero(inside)] = p[inside, 2] <= near[y, x] * 1.02
    if not inside.any():
        return []
    d = np.linalg.norm(q[inside] - q_true[inside], axis=1)
    return [("pose.vertices_px", float(np.sqrt((d ** 2).mean())), "px"), ("pose.vertices_max_px", float(d.max()), "px"), ("pose.vertices", int(len(d)), "1")]


def lens(unproject, project_true, unproject_true, size, side):
    """rms distance of the pixels that two lenses give one direction, after the rotation that brings their directions together."""
    W, H = size
    x, y = np.meshgrid(np.linspace(0, W - 1, 21), np.linspace(0, H - 1, 16))
    q = np.column_stack([x.ravel(), y.ravel()])
    v, v_true = (f(q) for f in (unproject, unproject_true))
    v, v_true = (a / np.linalg.norm(a, axis=1, keepdims=True) for a in (v, v_true))
    U, _, Vt = np.linalg.svd(v_true.T @ v)
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    d = np.linalg.norm(project_true(v @ R.T) - q, axis=1)
    d = d[np.isfinite(d)]
    return [(f"lens.{side}.projection_px", float(np.sqrt((d ** 2).mean())), "px")]


def pair(T, T_true):
    """T, T_true : (4, 4) left camera to right camera."""
    b, b_true = (np.linalg.norm(M[:3, 3]) for M in (T, T_true))
    return [("pair.baseline_relative", float(abs(b / b_true - 1)), "1"), ("pair.angle_deg", angle_deg(T[:3, :3] @ T_true[:3, :3].T), "deg")]


def planes(facets, T_true, model, facet_image, regions, scale=1.0):
    """Reconstructed planes against those of the model's facets that their regions show.

    facets : of facets.json, in the left frame          T_true : (4, 4) world to left camera
    facet_image : (H, W) model facet + 1 per pixel      regions : (H, W) left labels         scale : metres per unit of facets.json
    """
    normals, distances, inside, wrong = [], [], [], []
    for f in facets:
        shown = facet_image[regions == f["left_label"]]
        count = np.bincount(shown) if shown.size else np.zeros(1, int)
        count[0] = 0
        best = int(count.argmax())
        if count[best] < 0.8 * max(shown.size, 1):
            continue                                     # the region is not of one facet: segmentation's affair, not the plane's
        n_world, offset = model.facet_normal[best - 1], model.facet_offset[best - 1]
        n = T_true[:3, :3] @ n_world
        d = (offset + n @ T_true[:3, 3]) / scale
        m_true = n / d
        n0, d0 = np.asarray(f["plane"]["n"], float), float(f["plane"]["d"])
        m = n0 / d0
        ray = np.mean(np.asarray(f["polygon"], float), axis=0)
        ray = ray / ray[2]
        angle = np.degrees(np.arccos(np.clip(abs(n @ n0), 0, 1)))
        distance = abs((ray @ m_true) / (ray @ m) - 1)
        normals.append(angle)
        distances.append(distance)
        wrong.append(angle > 5 or distance > 0.05)
        if f.get("covariance") is not None:
            e = m - m_true
            inside.append(float(e @ np.linalg.pinv(np.asarray(f["covariance"], float)) @ e) <= CHI2_3)
    if not normals:
        return []
    out = [("facets.angle_deg", float(np.median(normals)), "deg"), ("facets.distance_relative", float(np.median(distances)), "1"),
           ("facets.wrong", float(np.mean(wrong)), "1"), ("facets.compared", len(normals), "1")]
    return out + ([("facets.within_95", float(np.mean(inside)), "1")] if inside else [])


def disparity(facets, left, right, regions, true):
    """Disparity x_left - x_right of the planes inside their regions against a map of it; true : (H, W) px, nan where unknown."""
    T = right.T_cam_world @ np.linalg.inv(left.T_cam_world)
    found = np.full(true.shape, np.nan)
    for f in facets:
        here = regions == f["left_label"]
        y, x = np.nonzero(here)
        v = left.directions(np.column_stack([x, y]))
        m = np.asarray(f["plane"]["n"], float) / f["plane"]["d"]
        p = v / (v @ m)[:, None]
        p = p @ T[:3, :3].T + T[:3, 3]
        q = (p / p[:, 2:]) @ right.K.T
        found[here] = x - q[:, 0]
    both = np.isfinite(found) & np.isfinite(true)
    if not both.any():
        return [("disparity.covered", 0.0, "1")]
    e = np.abs(found[both] - true[both])
    return [("disparity.median_px", float(np.median(e)), "px"), ("disparity.bad_1px", float((e > 1).mean()), "1"), ("disparity.covered", float(np.isfinite(found).mean()), "1")]


# ---- all of it ----

def against_truth(found, true):
    """[(stage, name, value, unit)] from what there is.

    found, true : {"lens", "lens_right": lenses.Lens; "camera", "camera_right", "posed": Camera; "calibration", "pose", "facets": as in their files;
    "regions", "facet": (H, W) labels; "depth", "disparity": (H, W); "model": Model}, each of which may be missing
    """
    out = []

    def add(stage, rows):
        out.extend((stage, *row) for row in rows)

    def both(name):
        return found.get(name) is not None and true.get(name) is not None

    def relative_pose(cameras):
        left, right = (cameras.get(name) for name in ("lens", "lens_right"))
        return right.T_cam_ref @ np.linalg.inv(left.T_cam_ref) if left and right else None

    for name, side in (("lens", "left"), ("lens_right", "right")):
        if both(name):
            a, b = found[name], true[name]
            add("calibrate", lens(a.unproject, b.project, b.unproject, (b.width, b.height), side))
            add("calibrate", [(f"lens.{side}.focal_relative", float(abs(a.K[0, 0] / b.K[0, 0] - 1)), "1")])
    published = (true.get("calibration") or {}).get("cameras") or {}
    for side, values in published.items():
        mine = ((found.get("calibration") or {}).get("cameras") or {}).get(side)
        if mine and "fx" in values:
            add("calibrate", [(f"lens.{side}.focal_relative", abs(mine["fx"] / values["fx"] - 1), "1")])
    baseline, mine = ((c.get("calibration") or {}).get("pair") or {} for c in (true, found))
    if baseline.get("baseline_m") and mine.get("baseline_m"):
        add("calibrate", [("pair.baseline_relative", abs(mine["baseline_m"] / baseline["baseline_m"] - 1), "1")])
    T, T_true = relative_pose(found), relative_pose(true)
    if T is not None and T_true is not None and np.linalg.norm(T[:3, 3]) > 0 and np.linalg.norm(T_true[:3, 3]) > 0:
        add("calibrate", pair(T, T_true))

    if true.get("disparity") is not None and found.get("facets") and all(found.get(n) is not None for n in ("camera", "camera_right", "regions")):
        add("reconstruct", disparity(found["facets"]["facets"], found["camera"], found["camera_right"], found["regions"], true["disparity"]))
    if true.get("posed") is None:
        return out
    T_true, model = true["posed"].T_cam_world, found.get("model")
    if found.get("pose") is not None:
        from lib.cameras import matrix_from_rt
        T = matrix_from_rt(found["pose"]["rt_cam_world"])
        add("recognise", pose(T, T_true, found["pose"].get("covariance")))
        if model is not None and found.get("posed") is not None:
            # in the photograph's own pixels, each camera with its own lens; without lenses in the pinholes'
            pinhole = lambda camera: lambda p: (p / p[:, 2:]) @ camera.K[:2].T
            projects = [c["lens"].project if both("lens") else pinhole(c["posed"]) for c in (found, true)]
            add("recognise", vertices(*projects, T, T_true, model, found.get("depth"), (true["posed"].width, true["posed"].height)))
    if found.get("facets") and model is not None and all(found.get(n) is not None for n in ("facet", "regions")) and found["facet"].shape == found["regions"].shape:
        size = (found.get("pose") or {}).get("scale") or 1.0
        if found["facets"].get("unit") == "m" or (found.get("pose") or {}).get("scale"):
            add("reconstruct", planes(found["facets"]["facets"], T_true, model, found["facet"], found["regions"], size))
    return out
