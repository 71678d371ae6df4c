"""Poses from picked points, focal length unknown: errors beside their bound, and beside pycolmap's solver.

    $ python -m tests.bench.picked_curves --trials 200                             # principal point in the middle
    $ python -m tests.bench.picked_curves --trials 40 --centre normal 0.03         # and elsewhere

60 degrees wide, points in depths of 2 to 6 m. --centre: where the principal point truly is, as a part of the width:
0.03 is that far off in a random direction, `normal` is drawn from the prior. The bound is Cramer's and Rao's of the
right points, once with the prior (Bayes) and once for a principal point that is known. `median` and `rms` are of each
trial's error over its bound; a normal error has .67 and 1 of the focal length, .9 to 1 and 1 of the rotation.
"""

import argparse
import time

import numpy as np

from lib.core.stage import BadInput
from lib.given import cameras
from lib.given.cameras import CENTRE_PART, Camera, intrinsics, matrix_from_rt, rt_from_matrix
from lib.given.picks import Picks
from lib.vision import picked

CASES = [(100, 0, 1.0), (100, 50, 1.0), (8, 0, 1.0), (8, 0, 2.0), (8, 1, 2.0)]  # points, wrong, px
SIZES = [(640, 480), (4000, 3000)]
INSIDE = 12.59, 14.07  # 95 % of chi-square, 6 and 7 numbers
HEAD = (
    "size       points wrong px  centre  method    trials refused | rotation median rms (known: rms) | focal median rms"
    " (known: rms) | chi2 mean worst | inside 6 and 7 | named | ms"
)


def shot(rng, size, n, centre):
    """(Camera, q, p) of n points. centre : part of the width, or "normal" """
    W, H = size
    K = intrinsics(W / 2 / np.tan(np.radians(30)), W, H)
    angle = rng.uniform(0, 2 * np.pi)
    drawn = rng.normal(0, CENTRE_PART, 2)
    K[:2, 2] += W * (drawn if centre == "normal" else float(centre) * np.array([np.cos(angle), np.sin(angle)]))
    camera = Camera(K, W, H, matrix_from_rt([*rng.normal(size=3), *rng.normal(0, 2, 3)]))
    q = rng.uniform((0, 0), size, (n, 2))
    p = camera.centre + rng.uniform(2, 6, n)[:, None] * camera.directions(q) @ camera.T_cam_world[:3, :3]
    return camera, q, p


def picks_of(rng, shown, noise, wrong):
    camera, q, p = shown
    q = q + rng.normal(0, noise, q.shape)
    q[:wrong] = rng.uniform((0, 0), (camera.width, camera.height), (wrong, 2))
    none = np.zeros((0, 2, 2))
    names = tuple(map(str, range(len(q))))
    return Picks(q, p, np.full(len(q), noise), names, none, np.zeros((0, 2, 3)), np.zeros(0), ())


def derivatives(camera, p):
    """(2 n, 9) px by omega, tau, ln f, centre, in closed form: not the solver's."""
    x, y, z = camera.points(p).T
    f = camera.K[0, 0]
    one, nought = np.ones(len(p)), np.zeros(len(p))
    u = [f * np.stack(row, axis=1) for row in ([1 / z, nought, -x / z**2], [nought, 1 / z, -y / z**2])]
    at = np.stack([x, y, z], axis=1)
    rows = []
    for k, by_point in enumerate(u):
        rest = np.stack([f * (x, y)[k] / z, one if k == 0 else nought, nought if k == 0 else one], axis=1)
        rows.append(np.concatenate([np.cross(at, by_point), by_point, rest], axis=1))
    return np.stack(rows, axis=1).reshape(-1, 9)


def bounds(camera, p, noise):
    """(covariance (9, 9) with the prior, (7, 7) of a known principal point)."""
    J = derivatives(camera, p) / noise
    prior = np.diag([0.0] * 7 + [(CENTRE_PART * camera.width) ** -2] * 2)
    return np.linalg.inv(J.T @ J + prior), np.linalg.inv(J[:, :7].T @ J[:, :7])


def by_colmap(picks, camera):
    """(Camera, outliers) of pycolmap's absolute pose and its refinement, both with the focal length free."""
    import pycolmap

    K = intrinsics(1.2 * camera.width, camera.width, camera.height)
    view = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=camera.width, height=camera.height, params=[K[0, 0], K[0, 2], K[1, 2]]
    )
    estimation, refinement = pycolmap.AbsolutePoseEstimationOptions(), pycolmap.AbsolutePoseRefinementOptions()
    estimation.estimate_focal_length = refinement.refine_focal_length = True
    estimation.ransac.max_error = 3 * float(picks.sigma[0])
    estimation.ransac.random_seed = 1
    found = pycolmap.estimate_and_refine_absolute_pose(picks.q, picks.p, view, estimation, refinement)
    if found is None:
        raise BadInput("nothing")
    T = np.vstack([found["cam_from_world"].matrix(), [0, 0, 0, 1]])
    return Camera(view.calibration_matrix(), camera.width, camera.height, T), ~np.asarray(found["inlier_mask"]), None


def by_us(picks, camera):
    start = Camera(cameras.intrinsics(1.2 * camera.width, camera.width, camera.height), *_size(camera), None)
    found = picked.solve(picks, start, focal_known=False)
    return found.camera, found.outlier, found.joint


def _size(camera):
    return camera.width, camera.height


def trial(seed, size, case, centre, solve):
    """(rotation, focal) over both bounds, chi2 of 6 and of 7, were just the wrong named, seconds; None: refused."""
    n, wrong, noise = case
    rng = np.random.default_rng(seed)
    shown = shot(rng, size, n, centre)
    picks, (camera, _, p) = picks_of(rng, shown, noise, wrong), shown
    begin = time.process_time()
    try:
        found, outlier, C = solve(picks, camera)
    except BadInput:
        return None
    spent = time.process_time() - begin
    twist = rt_from_matrix(camera.T_cam_world @ np.linalg.inv(found.T_cam_world))
    gap = np.append(twist, np.log(camera.K[0, 0] / found.K[0, 0]))
    parts = []
    for bound in bounds(camera, p[wrong:], noise):
        parts += [np.linalg.norm(twist[:3]) / np.sqrt(np.trace(bound[:3, :3])), abs(gap[6]) / np.sqrt(bound[6, 6])]
    squares = [gap[:k] @ np.linalg.solve(C[:k, :k], gap[:k]) if C is not None else np.nan for k in (6, 7)]
    return [*parts, *squares, set(np.flatnonzero(outlier)) == set(range(wrong)), spent]


def line(size, case, centre, name, rows):
    kept = np.array([row for row in rows if row is not None], float)
    rotation, focal, rotation_known, focal_known, six, seven, named, spent = kept.T
    rms = lambda x: np.sqrt(np.mean(x**2))
    return (
        f"{'x'.join(map(str, size)):10s} {case[0]:6d} {case[1]:5d} {case[2]:.0f} {centre:>7s}  {name:9s} {len(rows):6d}"
        f" {len(rows) - len(kept):7d} | {np.median(rotation):6.2f} {rms(rotation):6.2f} ({rms(rotation_known):6.2f})"
        f" | {np.median(focal):6.2f} {rms(focal):6.2f} ({rms(focal_known):6.2f}) | {np.mean(six):6.1f}"
        f" {np.max(six):6.1f} | {np.mean(six < INSIDE[0]):4.0%} {np.mean(seven < INSIDE[1]):4.0%}"
        f" | {np.mean(named):4.0%} | {1000 * np.median(spent):4.0f}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--centre", nargs="+", default=["0"])
    opt = parser.parse_args()
    print(HEAD)
    for size in SIZES:
        for case in CASES:
            for centre in opt.centre:
                for name, solve in (("ours", by_us), ("pycolmap", by_colmap)):
                    rows = [trial(seed, size, case, centre, solve) for seed in range(opt.trials)]
                    print(line(size, case, centre, name, rows), flush=True)


if __name__ == "__main__":
    main()
