"""What the vision half found against what is true: lenses, planes, disparities, pose. Used by the comparison alone.

pose.angle_deg, pose.centre_mm   rotation between the found and the true camera, distance of their centres
pose.in_sigmas                   sqrt(e' C^-1 e / 6) of the six errors e, C of pose.json: near 1 if C is honest
pose.vertices_px                 rms of the visible vertices of the model, in the photograph's own pixels
pose.vertices_max_px             the worst of them;  pose.vertices: how many they are
objects.mm, .deg                 movable objects: of the middle, and of the turn; medians, and max_mm, max_deg
objects.in_sigmas                as pose.in_sigmas, rms;  objects.missed, .invented: how many
photos.mm, .deg                  further photographs: of the centre and the turn; medians, and max_mm, max_deg
photos.in_sigmas                 as pose.in_sigmas, rms;  photos.missed, .invented: how many
lens.<side>.projection_px        rms distance of the pixels that two lenses give one direction, after the best rotation
lens.<side>.focal_relative       |f / f* - 1|
pair.baseline_relative           |b / b* - 1|
pair.angle_deg                   between the two relative rotations
facets.angle_deg                 median over the facets that lie on the model: of the normals
facets.distance_relative         the same of the distance at the facet's middle
facets.compared                  how many they are
facets.within_95                 share of the planes inside the 95 % ellipsoid of their covariance
facets.wrong                     share of their area, loose ones apart: off by WRONG_DEG or WRONG_DISTANCE and outside
                                 their 99.9 % ellipsoid, or of a surface that spans two planes
facets.loose                     share of all facets' area that is of loose ones
disparity.median_px              of the planes inside their left surfaces
disparity.bad_1px                share of these pixels that are off by more than 1 px
disparity.covered                share of the picture that they cover
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lib.given.cameras import matrix_from_rt, rt_from_matrix
from lib.given.model import parts
from lib.verdict.answers import Answers
from lib.verdict.records import Calibration
from lib.vision.recognition import symmetry

WRONG_DEG, WRONG_DISTANCE = 5, 0.05  # of a facet that is counted as wrong
CHI2_3, CHI2_3_999 = 7.814727903251179, 16.26623619623813  # 95, 99.9 % of chi-square with 3 degrees of freedom
SPANNING = 0.9  # of a surface on one plane; with less it spans two
COPLANAR = 1e-4, 0.01  # 1 - cosine between the normals, m between the planes


def angle_deg(R):
    """Angle of a rotation (3, 3) or of R_a R_b'; steady near 0.

    >>> angle_deg(np.eye(3))
    0.0
    """
    s = np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    return float(np.degrees(np.arctan2(s, (np.trace(R) - 1) / 2)))


def pose(T, T_true, covariance=None):
    """[(name, value, unit)] of a pose T (4, 4), world to camera.

    covariance : (6, 6) of (omega, tau) with T_true = exp(omega, tau) T, rad and m
    """
    centre = lambda M: -M[:3, :3].T @ M[:3, 3]
    errors = [
        ("pose.angle_deg", angle_deg(T[:3, :3] @ T_true[:3, :3].T), "deg"),
        ("pose.centre_mm", float(1000 * np.linalg.norm(centre(T) - centre(T_true))), "mm"),
    ]
    if covariance is not None:
        e = rt_from_matrix(T_true @ np.linalg.inv(T))  # to first order also the twist of se(3)
        squared = e @ np.linalg.pinv(np.asarray(covariance, float)) @ e
        errors.append(("pose.in_sigmas", float(np.sqrt(max(squared, 0) / 6)), "sigma"))
    return errors


def vertices(project, project_true, T, T_true, model, depth=None, size=None):
    """[(name, value, unit)]: rms and worst distance, in pixels, of the model's vertices that the true camera sees.

    project, project_true : (N, 3) camera coordinates -> (N, 2) px, of the found and the true lens
    depth : (H, W) m, from about the same place: a vertex behind it is hidden;  size : (W, H) px
    """
    p, p_true = (model.vertices @ M[:3, :3].T + M[:3, 3] for M in (T, T_true))
    front = (p[:, 2] > 0) & (p_true[:, 2] > 0)
    p, p_true = p[front], p_true[front]
    q, q_true = project(p), project_true(p_true)
    W, H = size
    inside = (
        np.isfinite(q).all(1)
        & np.isfinite(q_true).all(1)
        & (q_true > -0.5).all(1)
        & (q_true < [W - 0.5, H - 0.5]).all(1)
    )
    if depth is not None and inside.any():
        import cv2

        near = cv2.dilate(np.where(depth > 0, depth, np.inf).astype(np.float32), np.ones((5, 5), np.uint8))
        x, y = np.clip(np.rint(q[inside]).astype(int), 0, [W - 1, H - 1]).T
        inside[np.flatnonzero(inside)] = p[inside, 2] <= near[y, x] * 1.02
    if not inside.any():
        return []
    d = np.linalg.norm(q[inside] - q_true[inside], axis=1)
    return [
        ("pose.vertices_px", float(np.sqrt((d**2).mean())), "px"),
        ("pose.vertices_max_px", float(d.max()), "px"),
        ("pose.vertices", int(len(d)), "1"),
    ]


def lens(unproject, project_true, unproject_true, size, side):
    """rms distance of the pixels that two lenses give one direction, after the rotation that best aligns them."""
    W, H = size
    x, y = np.meshgrid(np.linspace(0, W - 1, 21), np.linspace(0, H - 1, 16))
    q = np.column_stack([x.ravel(), y.ravel()])
    v, v_true = (f(q) for f in (unproject, unproject_true))
    v, v_true = (a / np.linalg.norm(a, axis=1, keepdims=True) for a in (v, v_true))
    U, _, Vt = np.linalg.svd(v_true.T @ v)
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    d = np.linalg.norm(project_true(v @ R.T) - q, axis=1)
    d = d[np.isfinite(d)]
    return [(f"lens.{side}.projection_px", float(np.sqrt((d**2).mean())), "px")]


def pair(T, T_true):
    """Relative poses. T, T_true : (4, 4) left camera to right camera"""
    b, b_true = (np.linalg.norm(M[:3, 3]) for M in (T, T_true))
    return [
        ("pair.baseline_relative", float(abs(b / b_true - 1)), "1"),
        ("pair.angle_deg", angle_deg(T[:3, :3] @ T_true[:3, :3].T), "deg"),
    ]


def planes(facets, T_true, model, facet_image, surfaces, scale=1.0):
    """Reconstructed planes against those of the model's facets that their surfaces show.

    facets : [facets_file.Facet], in the left frame     T_true : (4, 4) world to left camera
    facet_image : (H, W) model facet + 1 per pixel  surfaces : (H, W) left labels     scale : metres per unit of facets
    """
    deviations, area, wrong, loose = [], [], [], []
    for f in facets:
        shown = facet_image[surfaces == f.left_label]
        count = np.bincount(shown) if shown.size else np.zeros(1, int)
        count[0] = 0
        best = int(count.argmax())
        if not count[best]:
            continue
        deviation = _plane_deviation(f, _plane_seen(model, best - 1, T_true, scale))
        on_plane = sum(count[k] for k in np.flatnonzero(count) if _coplanar(model, k - 1, best - 1))
        area.append(shown.size)
        wrong.append(on_plane < SPANNING * count.sum() or deviation.is_wrong)
        loose.append(bool(f.loose))
        # a region that is not of one facet is segmentation's error, not the plane's
        if count[best] >= 0.8 * shown.size:
            deviations.append(deviation)
    if not deviations:
        return []
    area, wrong, loose = np.array(area, float), np.array(wrong), np.array(loose)
    known = [d.chi2 <= CHI2_3 for d in deviations if d.chi2 is not None]
    errors = [
        ("facets.angle_deg", float(np.median([d.angle_deg for d in deviations])), "deg"),
        ("facets.distance_relative", float(np.median([d.distance for d in deviations])), "1"),
        ("facets.wrong", float(area[wrong & ~loose].sum() / max(area[~loose].sum(), 1)), "1"),
        ("facets.loose", float(area[loose].sum() / area.sum()), "1"),
        ("facets.compared", len(deviations), "1"),
    ]
    return errors + ([("facets.within_95", float(np.mean(known)), "1")] if known else [])


def _coplanar(model, a, b):
    """Two facets of a model lie on one plane."""
    turned, apart = COPLANAR
    same = model.facet_normal[a] @ model.facet_normal[b]
    offset = abs(model.facet_offset[a] - np.sign(same) * model.facet_offset[b])
    return 1 - abs(same) < turned and offset < apart


class PlaneDeviation(NamedTuple):
    """distance : relative, at the facet's middle;  chi2 : of the covariance, None without one"""

    angle_deg: float
    distance: float
    chi2: float | None

    @property
    def is_wrong(self):
        """By far, and its covariance does not know."""
        far = self.angle_deg > WRONG_DEG or self.distance > WRONG_DISTANCE
        return far and (self.chi2 is None or self.chi2 > CHI2_3_999)


def _plane_seen(model, facet, T_true, scale):
    """(n, d) of a model's facet in the left camera's frame: n . x = d."""
    n = T_true[:3, :3] @ model.facet_normal[facet]
    return n, (model.facet_offset[facet] + n @ T_true[:3, 3]) / scale


def _plane_deviation(f, true_plane):
    n, d = true_plane
    m_true = n / d
    n0, d0 = np.asarray(f.plane.n, float), float(f.plane.d)
    m = n0 / d0
    ray = np.mean(np.asarray(f.polygon, float), axis=0)
    ray = ray / ray[2]
    chi2 = None
    if f.covariance is not None:
        e = m - m_true
        chi2 = float(e @ np.linalg.pinv(np.asarray(f.covariance, float)) @ e)
    angle_deg = np.degrees(np.arccos(np.clip(abs(n @ n0), 0, 1)))
    return PlaneDeviation(angle_deg, abs((ray @ m_true) / (ray @ m) - 1), chi2)


def disparity(facets, left, right, surfaces, true):
    """Disparity x_left - x_right of the planes inside their surfaces. true : (H, W) px, NaN where it is unknown"""
    T = right.T_cam_world @ np.linalg.inv(left.T_cam_world)
    found = np.full(true.shape, np.nan)
    for f in facets:
        here = surfaces == f.left_label
        y, x = np.nonzero(here)
        v = left.directions(np.column_stack([x, y]))
        m = np.asarray(f.plane.n, float) / f.plane.d
        p = v / (v @ m)[:, None]
        p = p @ T[:3, :3].T + T[:3, 3]
        q = (p / p[:, 2:]) @ right.K.T
        found[here] = x - q[:, 0]
    both = np.isfinite(found) & np.isfinite(true)
    if not both.any():
        return [("disparity.covered", 0.0, "1")]
    e = np.abs(found[both] - true[both])
    return [
        ("disparity.median_px", float(np.median(e)), "px"),
        ("disparity.bad_1px", float((e > 1).mean()), "1"),
        ("disparity.covered", float(np.isfinite(found).mean()), "1"),
    ]


# ---- all of it ----


def against_truth(found: Answers, true: Answers):
    """[(stage, name, value, unit)] from what there is."""
    errors = [("calibrate", *error) for error in _calibration(found, true)]
    errors += [("reconstruct", *error) for error in _disparity(found, true)]
    if true.posed is not None:
        true = _in_the_same_turn(found, true)
        errors += [("recognise", *error) for error in _pose(found, true)]
        errors += [("reconstruct", *error) for error in _planes(found, true)]
    errors += [("place", *error) for error in _objects(found, true)]
    return errors + [("locate", *error) for error in _further(found, true)]


def _further(found: Answers, true: Answers):
    """Where further photographs were taken from, of those that truth says something of; given poses apart."""
    if found.poses is None or true.poses is None:
        return []
    rows, missed, invented = [], 0, 0
    for name, where in true.poses.photographs.items():
        entry = found.poses.photographs.get(name)
        if entry is None or entry.status == "given":
            continue
        missed += bool(where.rt_cam_world and not entry.rt_cam_world)
        invented += bool(entry.rt_cam_world and not where.rt_cam_world)
        if where.rt_cam_world and entry.rt_cam_world:
            T, T_true = (matrix_from_rt(one.rt_cam_world) for one in (entry, where))
            rows.append([value for _, value, _ in pose(T, T_true, entry.covariance)])
    errors = [("photos.missed", missed, "1"), ("photos.invented", invented, "1")]
    if rows:
        deg, mm, *sigmas = np.array(rows, float).T
        errors += [("photos.deg", float(np.median(deg)), "deg"), ("photos.max_deg", float(deg.max()), "deg")]
        errors += [("photos.mm", float(np.median(mm)), "mm"), ("photos.max_mm", float(mm.max()), "mm")]
        errors += [("photos.in_sigmas", float(np.sqrt(np.mean(s**2))), "sigma") for s in sigmas]
    return errors


def _objects(found: Answers, true: Answers):
    """Where movable objects are, of those that truth says something of, up to what brings each onto itself."""
    if found.pose is None or not found.pose.objects or true.pose is None or found.model is None:
        return []
    rows, missed, invented = [], 0, 0
    for name, where in true.pose.objects.items():
        entry = found.pose.objects.get(name)
        if entry is None:
            continue
        missed += bool(where.found and not entry.found)
        invented += bool(where.found is False and entry.found)
        if where.found and entry.found:
            T, T_true = matrix_from_rt(entry.rt_world_object), matrix_from_rt(where.rt_world_object)
            rows.append(object_error(T, T_true, entry.covariance, parts.only(found.model, [name])))
    errors = [("objects.missed", missed, "1"), ("objects.invented", invented, "1")]
    if rows:
        mm, deg, sigmas = np.array(rows, float).T
        errors += [("objects.mm", float(np.median(mm)), "mm"), ("objects.max_mm", float(mm.max()), "mm")]
        errors += [("objects.deg", float(np.median(deg)), "deg"), ("objects.max_deg", float(deg.max()), "deg")]
        errors.append(("objects.in_sigmas", float(np.sqrt(np.mean(sigmas**2))), "sigma"))
    return errors


def object_error(T, T_true, covariance, thing):
    """(mm of the middle, degrees, sqrt(e' C^-1 e / 6)) of T_world_object.  thing : Model of the object as found"""
    middle = np.append((thing.vertices.min(axis=0) + thing.vertices.max(axis=0)) / 2, 1)
    best = None
    for motion in (np.eye(4), *(m.T for m in symmetry.motions(thing) if m.is_exact)):
        e = T_true @ np.linalg.inv(motion @ T)
        now = angle_deg(e[:3, :3]), float(1000 * np.linalg.norm((e @ middle - middle)[:3])), e
        best = now if best is None or now[:2] < best[:2] else best
    numbers = rt_from_matrix(best[2])
    squared = np.nan if covariance is None else numbers @ np.linalg.solve(np.array(covariance), numbers)
    return best[1], best[0], float(np.sqrt(max(squared, 0) / 6))


def _calibration(found: Answers, true: Answers):
    """Lenses, by their models or by published numbers, and the relative pose."""
    errors = []
    for side, ours, theirs in (("left", found.lens, true.lens), ("right", found.lens_right, true.lens_right)):
        if ours is not None and theirs is not None:
            errors += lens(ours.unproject, theirs.project, theirs.unproject, (theirs.width, theirs.height), side)
            errors.append(_focal(side, ours.K[0, 0], theirs.K[0, 0]))
    ours, published = found.calibration or Calibration(), true.calibration or Calibration()
    for side, camera in published.cameras.items():
        if side in ours.cameras and camera.fx is not None:
            errors.append(_focal(side, ours.cameras[side].fx, camera.fx))
    if ours.pair.baseline_m and published.pair.baseline_m:
        ratio = ours.pair.baseline_m / published.pair.baseline_m
        errors.append(("pair.baseline_relative", abs(ratio - 1), "1"))
    T, T_true = (_T_right_left(answers) for answers in (found, true))
    if T is not None and T_true is not None and np.linalg.norm(T[:3, 3]) > 0 and np.linalg.norm(T_true[:3, 3]) > 0:
        errors += pair(T, T_true)
    return errors


def _focal(side, f, f_true):
    return f"lens.{side}.focal_relative", float(abs(f / f_true - 1)), "1"


def _T_right_left(answers: Answers):
    if not (answers.lens and answers.lens_right):
        return None
    return answers.lens_right.T_cam_ref @ np.linalg.inv(answers.lens.T_cam_ref)


def _disparity(found: Answers, true: Answers):
    needed = (true.disparity, found.facets, found.camera, found.camera_right, found.surfaces)
    if any(part is None for part in needed):
        return []
    return disparity(found.facets.facets, found.camera, found.camera_right, found.surfaces, true.disparity)


def _in_the_same_turn(found: Answers, true: Answers) -> Answers:
    """A symmetric model has several true poses: the one that is nearest to what was found."""
    if found.pose is None or found.pose.status != "symmetric":
        return true
    T, back = matrix_from_rt(found.pose.rt_cam_world), np.linalg.inv(true.posed.T_cam_world)
    turns = [np.eye(4), *(np.linalg.solve(T, matrix_from_rt(o["rt_cam_world"])) for o in found.pose.ambiguous)]
    nearest = min(turns, key=lambda turn: np.linalg.norm(T @ turn @ back - np.eye(4)))
    posed = replace(true.posed, T_cam_world=true.posed.T_cam_world @ np.linalg.inv(nearest))
    return replace(true, posed=posed)


def _pose(found: Answers, true: Answers):
    if found.pose is None:
        return []
    T, T_true = matrix_from_rt(found.pose.rt_cam_world), true.posed.T_cam_world
    errors = pose(T, T_true, found.pose.covariance)
    if found.model is not None and found.posed is not None:
        # in the photograph's own pixels, each camera with its own lens; without lenses in the pinholes'
        with_lenses = found.lens is not None and true.lens is not None
        projects = [a.lens.project if with_lenses else _pinhole(a.posed) for a in (found, true)]
        size = (true.posed.width, true.posed.height)
        errors += vertices(*projects, T, T_true, found.model, found.depth, size)
    return errors


def _pinhole(camera):
    return lambda p: (p / p[:, 2:]) @ camera.K[:2].T


def _planes(found: Answers, true: Answers):
    if any(part is None for part in (found.facets, found.model, found.facet, found.surfaces)):
        return []
    scale = found.pose.scale if found.pose else None
    if found.facet.shape != found.surfaces.shape or not (found.facets.unit == "m" or scale):
        return []
    facets, T_true = found.facets.facets, true.posed.T_cam_world
    return planes(facets, T_true, found.model, found.facet, found.surfaces, scale or 1.0)
