"""Poses from picked points, focal length unknown: errors beside their bound, pycolmap's solver, and CPU time.

    $ python -m tests.bench.picked_curves --trials 200     # a table of points in the air
    $ python -m tests.bench picked                         # picked.csv, picked.png: rooms whose edges refine the pose

Points: 60 degrees wide, depths of 2 to 6 m, principal point in the middle.  The bound is Cramer's and Rao's of the
right points, computed for each trial in closed form.  `median` and `rms` are of each trial's error over its bound; a
normal error has .67 and 1 of the focal length, .9 to 1 and 1 of the rotation.  `inside` is how many of the 95 %
ellipsoids of (omega, tau) and of (omega, tau, ln f) hold the truth; `covered` the same of trials that named other
points than those that were wrong, refused ones counted in.

Rooms: eight corners that the camera sees, picked to 1.5 px, in rooms of lib/synthetic/further_views.py, 640 x 480.
"""

import argparse
import csv
import tempfile
import time
from pathlib import Path

import numpy as np

from lib.core.stage import BadInput
from lib.given.cameras import Camera, intrinsics, matrix_from_rt, rt_from_matrix
from lib.given.picks import Picks
from lib.vision import picked

ROOT = Path(__file__).resolve().parents[2]
CASES = [(100, 0, 1.0), (100, 50, 1.0), (8, 0, 2.0), (8, 1, 2.0)]  # points, wrong ones, px
SIZES = [(640, 480), (4000, 3000)]
INSIDE = 12.59, 14.07  # 95 % of chi-square, 6 and 7 numbers
TABLE = (
    "size       points wrong px  method    trials refused | rotation median  rms | focal median  rms | chi2 mean worst"
    " | inside 6 and 7 | named covered |   ms"
)
HEAD = ("seed", "method", "cpu_s", "rotation_deg", "apart_mm", "chi2")
ROOM_PX, PICKED, NOISE_PX, SEEDS = (640, 480), 8, 1.5, range(540, 560)


# -- points in the air


def shot(rng, size, n):
    """(Camera, q, p) of n points."""
    W, H = size
    K = intrinsics(W / 2 / np.tan(np.radians(30)), W, H)
    camera = Camera(K, W, H, matrix_from_rt([*rng.normal(size=3), *rng.normal(0, 2, 3)]))
    q = rng.uniform((0, 0), size, (n, 2))
    p = camera.centre + rng.uniform(2, 6, n)[:, None] * camera.directions(q) @ camera.T_cam_world[:3, :3]
    return camera, q, p


def picks_of(q, p, noise):
    none = np.zeros((0, 2, 2))
    names = tuple(map(str, range(len(q))))
    return Picks(q, p, np.full(len(q), noise), names, none, np.zeros((0, 2, 3)), np.zeros(0), ())


def bound(camera, p, noise):
    """(7, 7) covariance of omega, tau and ln f, principal point known; derivatives in closed form, not the solver's."""
    x, y, z = camera.points(p).T
    f, nought = camera.K[0, 0], np.zeros(len(p))
    at = np.stack([x, y, z], axis=1)
    rows = []
    for k, by_point in enumerate(([1 / z, nought, -x / z**2], [nought, 1 / z, -y / z**2])):
        u = f * np.stack(by_point, axis=1)
        rows.append(np.concatenate([np.cross(at, u), u, (f * (x, y)[k] / z)[:, None]], axis=1))
    J = np.concatenate(rows) / noise
    return np.linalg.inv(J.T @ J)


def by_colmap(picks, camera):
    """(Camera, outliers, None) of pycolmap's absolute pose and its refinement, both with the focal length free."""
    import pycolmap

    K = intrinsics(1.2 * camera.width, camera.width, camera.height)
    params = [K[0, 0], K[0, 2], K[1, 2]]
    view = pycolmap.Camera(model="SIMPLE_PINHOLE", width=camera.width, height=camera.height, params=params)
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
    """(Camera, outliers, covariance (7, 7))."""
    size = camera.width, camera.height
    found = picked.solve(picks, Camera(intrinsics(1.2 * camera.width, *size), *size, None), focal_known=False)
    return found.camera, found.outlier, found.joint


def trial(seed, size, case, solve):
    """(rotation, focal) over the bound, chi2 of 6 and of 7, were just the wrong named, seconds; None: refused."""
    n, wrong, noise = case
    rng = np.random.default_rng(seed)
    camera, q, p = shot(rng, size, n)
    q = q + rng.normal(0, noise, q.shape)
    q[:wrong] = rng.uniform((0, 0), size, (wrong, 2))
    begin = time.process_time()
    try:
        found, outlier, C = solve(picks_of(q, p, noise), camera)
    except BadInput:
        return None
    spent = time.process_time() - begin
    gap = np.append(_twist(camera, found), np.log(camera.K[0, 0] / found.K[0, 0]))
    least = bound(camera, p[wrong:], noise)
    errors = np.linalg.norm(gap[:3]) / np.sqrt(np.trace(least[:3, :3])), abs(gap[6]) / np.sqrt(least[6, 6])
    squares = [gap[:k] @ np.linalg.solve(C[:k, :k], gap[:k]) if C is not None else np.nan for k in (6, 7)]
    return [*errors, *squares, set(np.flatnonzero(outlier)) == set(range(wrong)), spent]


def _twist(true, found):
    return rt_from_matrix(true.T_cam_world @ np.linalg.inv(found.T_cam_world))


def line(size, case, name, rows):
    """One of TABLE."""
    kept = np.array([row for row in rows if row is not None], float)
    rotation, focal, six, seven, named, spent = kept.T
    rms, refused = lambda x: np.sqrt(np.mean(x**2)), len(rows) - len(kept)
    missed = refused + (named == 0).sum()
    covered = (refused + ((named == 0) & (six < INSIDE[0])).sum()) / missed if missed else np.nan
    return (
        f"{'x'.join(map(str, size)):10s} {case[0]:6d} {case[1]:5d} {case[2]:.0f}   {name:9s} {len(rows):5d}"
        f" {refused:7d} | {np.median(rotation):15.2f} {rms(rotation):4.2f}"
        f" | {np.median(focal):12.2f} {rms(focal):4.2f} | {np.mean(six):9.1f} {np.max(six):5.1f}"
        f" | {np.mean(six < INSIDE[0]):8.1%} {np.mean(seven < INSIDE[1]):4.1%}"
        f" | {np.mean(named):5.0%} {covered:6.0%} | {1000 * np.median(spent):4.0f}"
    )


# -- rooms


def corners(model, camera):
    """(n, 3) ends of visible edges, each once."""
    from lib.vision.refinement.edges import model_edges, visible_samples

    edges = model_edges(model)
    s = visible_samples(model, edges, camera, 1, step_px=3.0)
    own = np.isin(np.tile(np.arange(len(edges.a)), 2), s.edge)
    ends = np.unique(np.round(np.concatenate([edges.a, edges.b])[own], 9), axis=0)
    q = camera.project(ends)
    inside = np.isfinite(q).all(axis=1) & (q > 5).all(axis=1) & (q < np.subtract(ROOM_PX, 5)).all(axis=1)
    near = np.linalg.norm(s.q[None] - np.nan_to_num(q, nan=-1e6)[:, None], axis=2).min(axis=1) < 3
    return ends[inside & near]


def room(seed, folder):
    """Rows of HEAD: by our mixture, that refined on edges, and by pycolmap; [] where too few corners are seen."""
    from lib.given import model as models
    from lib.given.image import Photograph
    from lib.synthetic import further_views
    from lib.vision import picked_edges

    case, rng, rows = further_views.further_views(seed, number=1), np.random.default_rng([seed, 3]), []
    (folder / "m.obj").write_text(case.recipe.model()[0])
    model, camera = models.load(folder / "m.obj"), Camera(case.lenses[0].K, *ROOM_PX, case.poses[0])
    p = corners(model, camera)
    if len(p) < PICKED:
        return []
    p = p[rng.choice(len(p), PICKED, replace=False)]
    told = picks_of(camera.project(p) + rng.normal(0, NOISE_PX, (PICKED, 2)), p, NOISE_PX)
    photograph = Photograph(further_views.photographs(case)[1] / 255.0, 8, False, 3)

    def row(method, spent, found, C):
        twist = _twist(camera, found)
        far, apart = np.degrees(np.linalg.norm(twist[:3])), 1000 * np.linalg.norm(found.centre - camera.centre)
        return (
            seed,
            method,
            spent,
            float(far),
            float(apart),
            "" if C is None else float(twist @ np.linalg.solve(C, twist)),
        )

    begin = time.process_time()
    try:
        first = picked.solve(told, Camera(intrinsics(1.2 * ROOM_PX[0], *ROOM_PX), *ROOM_PX, None), focal_known=False)
        spent = time.process_time() - begin
        rows.append(row("picked", spent, first.camera, first.covariance))
        begin = time.process_time()
        found, _, why = picked_edges.refined(first, told, model, photograph, False)
        if not why:
            rows.append(row("and edges", spent + time.process_time() - begin, found.camera, found.covariance))
        begin = time.process_time()
        theirs = by_colmap(told, camera)[0]
        rows.append(row("pycolmap", time.process_time() - begin, theirs, None))
    except BadInput as bad:
        print(f"    {seed}: {bad}")
    return rows


def curves(out_folder):
    """picked.csv and picked.png into out_folder."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    out, rows = Path(out_folder), []
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        room(SEEDS[0], Path(folder))  # compiles
        for seed in SEEDS:
            rows += room(seed, Path(folder))
    with open(out / "picked.csv", "w", newline="") as file:
        csv.writer(file).writerows([HEAD, *rows])
    figure, ax = plt.subplots(figsize=(6, 4.6), layout="constrained")
    for method in ("pycolmap", "picked", "and edges"):
        mine = [r for r in rows if r[1] == method]
        middle = np.median([r[2] for r in mine]), np.median([r[4] for r in mine])
        ax.loglog([r[2] for r in mine], [r[4] for r in mine], "o", ms=4, label=f"{method}: median {middle[1]:.3g} mm")
        print(f"    {method}: {len(mine)} rooms, {middle[0]:.3g} CPU s, median {middle[1]:.3g} mm")
    ax.set(title="eight corners picked to 1.5 px, focal length unknown", xlabel="CPU s", ylabel="camera apart, mm")
    ax.legend(fontsize=7)
    figure.savefig(out / "picked.png", dpi=110)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    opt = parser.parse_args()
    print(TABLE)
    for size in SIZES:
        for case in CASES:
            for name, solve in (("ours", by_us), ("pycolmap", by_colmap)):
                rows = [trial(opt.first + seed, size, case, solve) for seed in range(opt.trials)]
                print(line(size, case, name, rows), flush=True)


if __name__ == "__main__":
    main()
