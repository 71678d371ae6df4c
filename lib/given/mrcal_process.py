"""What is asked of mrcal's Python functions. Runs under mrcal's own interpreter, never ours: NumPy 1 there, 2 here.

    $ /usr/bin/python3 lib/given/mrcal_process.py judge  request.json answer.json
    $ /usr/bin/python3 lib/given/mrcal_process.py project   some.cameramodel points.npy pixels.npy
    $ /usr/bin/python3 lib/given/mrcal_process.py unproject some.cameramodel pixels.npy directions.npy

Only mrcal and NumPy are imported; files in, files out (mrcal_runner.py calls it).
"""

import json
import sys

import mrcal
import numpy as np


def listed(array):
    """Nested lists; what is not finite becomes null."""
    return [listed(row) for row in array] if np.ndim(array) else (float(array) if np.isfinite(array) else None)


def grid(model, count):
    """(rows, count, 2) px from edge to edge."""
    width, height = model.imagersize()
    rows = max(2, int(round(count * height / width)))
    return np.stack(np.meshgrid(np.linspace(0, width - 1, count), np.linspace(0, height - 1, rows)), -1)


def views(model, side):
    """Per observation of one camera: shot, RMS of its residuals, outliers, distance and tilt of the board."""
    inputs = model.optimization_inputs()
    boards, indices = inputs["observations_board"], inputs["indices_frame_camintrinsics_camextrinsics"]
    residuals = mrcal.optimizer_callback(**inputs)[1][: boards[..., :2].size].reshape(boards[..., :2].shape)
    frames, extrinsics, spacing = (
        inputs["frames_rt_toref"],
        inputs["extrinsics_rt_fromref"],
        inputs["calibration_object_spacing"],
    )
    rows, columns = boards.shape[1:3]
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2, 0]) * spacing
    found = []
    for observation, (frame, camera, extrinsic) in zip(range(len(boards)), indices, strict=True):
        if camera != side:
            continue
        weight = boards[observation, ..., 2]
        used = weight > 0
        rt_cam_board = frames[frame] if extrinsic < 0 else mrcal.compose_rt(extrinsics[extrinsic], frames[frame])
        p = mrcal.transform_point_rt(rt_cam_board, middle)
        normal = mrcal.R_from_r(rt_cam_board[:3])[:, 2]
        normal = normal * np.sign(normal[2] or 1)  # away from the camera
        error = residuals[observation][used]
        found.append(
            {
                "path": inputs["imagepaths"][observation],
                "rms_px": float(np.sqrt((error**2).sum(-1).mean())) if used.any() else None,
                "corners": int(used.sum()),
                "outliers": [[int(y), int(x)] for y, x in zip(*np.nonzero(~used), strict=True)],
                "distance_m": float(np.linalg.norm(p)),
                "normal": listed(normal),
                "residuals_px": listed(residuals[observation]),
                "q": listed(boards[observation, ..., :2]),
            }
        )
    return found


def relative(models):
    """rt_right_left, its covariance (6x6), and sigma of the length of t, from the solve's own Jacobian.

    The left camera is the solve's reference, so that the right one's extrinsics are the relative pose.
    """
    inputs = models[0].optimization_inputs()
    rt = inputs["extrinsics_rt_fromref"][0]
    packed, x, J, factorisation = mrcal.optimizer_callback(**inputs)
    start = mrcal.state_index_extrinsics(0, **inputs)
    units = np.ones(len(packed))
    mrcal.unpack_state(units, **inputs)  # units[i]: what one packed unit is in rad, m, px
    rhs = np.zeros((6, len(packed)))
    rhs[np.arange(6), start + np.arange(6)] = units[start : start + 6]
    solved = factorisation.solve_xt_JtJ_bt(rhs)
    noise = float(np.std(mrcal.residuals_chessboard(inputs, residuals=x).ravel()))
    covariance = noise**2 * solved @ rhs.T
    t = rt[3:] / np.linalg.norm(rt[3:])
    return {
        "rt_right_left": listed(rt),
        "covariance": listed(covariance),
        "noise_px": noise,
        "baseline_m": float(np.linalg.norm(rt[3:])),
        "baseline_sigma_m": float(np.sqrt(max(0, t @ covariance[3:, 3:] @ t))),
    }


def triangulated(models, distance):
    """Sigma of the range of a point straight ahead of the pair at `distance`, from the calibration alone, m."""
    width, height = models[0].imagersize()
    p = (
        mrcal.unproject(np.array([(width - 1) / 2, (height - 1) / 2]), *models[0].intrinsics(), normalize=True)
        * distance
    )
    q_right = mrcal.project(mrcal.transform_point_rt(models[1].extrinsics_rt_fromref(), p), *models[1].intrinsics())
    q = np.array([[(width - 1) / 2, (height - 1) / 2], q_right])
    found, variance = mrcal.triangulate(q, models, q_calibration_stdev=-1)
    if not np.any(found):  # the rays diverge
        return None
    v = p / np.linalg.norm(p)
    return float(np.sqrt(max(0, v @ variance.reshape(3, 3) @ v)))


class Attempts:
    """Calls of which each may fail without the others: what went wrong is kept in words."""

    def __init__(self):
        self.failed = []

    def __call__(self, what, function, /, *arguments, **options):
        """What function returns; None where mrcal refuses, whatever it raises."""
        try:
            return function(*arguments, **options)
        except Exception as error:
            words = (" ".join(str(error).split()) or type(error).__name__)[:200]
            if f"{what}: {words}" not in self.failed:
                self.failed.append(f"{what}: {words}")
            return None


def difference(halves, side, **options):
    """(rows, columns, 2) px by which one camera's two halves project otherwise."""
    return mrcal.projection_diff([mrcal.cameramodel(pair[side]) for pair in halves], **options)[1]


def baselines(halves):
    """m, of either half."""
    poses = [mrcal.cameramodel(pair[1]).extrinsics_rt_fromref() for pair in halves]
    return [float(np.linalg.norm(rt[3:])) for rt in poses]


def judge(request):
    """request: models [left, right], halves [[left, right], [left, right]] or [], distance_m, columns.

    Without the relative pose and what the boards say there is no answer. Of the rest each may fail: `not_computed`.
    """
    attempt = Attempts()
    models = [mrcal.cameramodel(path) for path in request["models"]]
    distance, columns = request["distance_m"], request["columns"]
    answer = {"cameras": [], "pair": relative(models)}
    inputs = models[0].optimization_inputs()
    answer["board_warp_m"] = listed(inputs["calobject_warp"]) if inputs["calobject_warp"] is not None else None
    for side, model in enumerate(models):
        q = grid(model, columns)
        v = mrcal.unproject(q, *model.intrinsics(), normalize=True)
        camera = {
            "lens": model.intrinsics()[0],
            "intrinsics": listed(model.intrinsics()[1]),
            "views": views(model, side),
            "q": listed(q),
        }
        if distance is None:
            distance = float(np.median([view["distance_m"] for view in camera["views"]]))
        sigma = attempt("uncertainty", mrcal.projection_uncertainty, v * distance, model, what="worstdirection-stdev")
        camera["uncertainty_px"] = listed(np.full(q.shape[:-1], np.nan) if sigma is None else sigma)
        if request["halves"]:
            options = {"gridn_width": columns, "gridn_height": q.shape[0], "distance": distance}
            found = attempt("cross-validation", difference, request["halves"], side, **options)
            if found is not None:
                camera["difference_px"] = listed(found)
        answer["cameras"].append(camera)
    answer["distance_m"] = distance
    answer["pair"]["range_sigma_m"] = attempt("the range's sigma", triangulated, models, distance)
    if request["halves"]:
        answer["pair"]["halves_baseline_m"] = attempt("the halves' baselines", baselines, request["halves"])
    answer["not_computed"] = attempt.failed
    return answer


def main(verb, first, second, third=None):
    if verb == "judge":
        with open(first) as file:
            request = json.load(file)
        with open(second, "w") as file:
            json.dump(judge(request), file)
    elif verb in ("project", "unproject"):
        model = mrcal.cameramodel(first)
        given = np.load(second)
        np.save(
            third,
            mrcal.project(given, *model.intrinsics())
            if verb == "project"
            else mrcal.unproject(given, *model.intrinsics(), normalize=True),
        )
    else:
        sys.exit(f"{verb}: judge, project or unproject")


if __name__ == "__main__":
    main(*sys.argv[1:])
