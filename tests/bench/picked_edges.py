"""Poses from picks that the photograph's edges refine, no lens given, in random rooms: errors and chi-square.

    $ python -m tests.bench.picked_edges --rooms 40 --centre 0 normal 0.03

Eight corners that the camera sees, picked to 1.5 px, in rooms of lib/synthetic/further_views.py, 640 x 480. --centre
as in tests/bench/picked_curves.py.
"""

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from lib.core.stage import BadInput
from lib.given import model as models
from lib.given.cameras import CENTRE_PART, Camera, intrinsics, rt_from_matrix
from lib.given.image import Photograph
from lib.given.picks import Picks
from lib.synthetic import further_views
from lib.vision import picked, picked_edges
from lib.vision.refinement.edges import model_edges, visible_samples

SIZE, PICKED, NOISE = (640, 480), 8, 1.5


def corners(model, camera):
    """(n, 3) ends of visible edges, each once."""
    edges = model_edges(model)
    s = visible_samples(model, edges, camera, 1, step_px=3.0)
    ends = np.unique(
        np.round(np.concatenate([edges.a, edges.b])[np.isin(np.tile(np.arange(len(edges.a)), 2), s.edge)], 9), axis=0
    )
    q = camera.project(ends)
    inside = np.isfinite(q).all(axis=1) & (q > 5).all(axis=1) & (q < np.subtract(SIZE, 5)).all(axis=1)
    near = np.linalg.norm(s.q[None] - np.nan_to_num(q, nan=-1e6)[:, None], axis=2).min(axis=1) < 3
    return ends[inside & near]


def trial(seed, centre, folder):
    """(errors as picked, as refined or None, seconds, why);  str: why nothing was solved;  None where there are too few corners."""
    case = further_views.further_views(seed, number=1)
    rng = np.random.default_rng([seed, 3])
    angle, drawn = rng.uniform(0, 2 * np.pi), rng.normal(0, CENTRE_PART, 2)
    off = SIZE[0] * (drawn if centre == "normal" else float(centre) * np.array([np.cos(angle), np.sin(angle)]))
    lens = case.lenses[0]
    K = lens.K.copy()
    K[:2, 2] += off
    core = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    case = replace(case, lenses=(type(lens)(core),))
    (folder / "m.obj").write_text(case.recipe.model()[0])
    model, camera = models.load(folder / "m.obj"), Camera(K, *SIZE, case.poses[0])
    p = corners(model, camera)
    if len(p) < PICKED:
        return None
    p = p[rng.choice(len(p), PICKED, replace=False)]
    q = camera.project(p) + rng.normal(0, NOISE, (PICKED, 2))
    told = Picks(
        q,
        p,
        np.full(PICKED, NOISE),
        tuple(map(str, range(PICKED))),
        np.zeros((0, 2, 2)),
        np.zeros((0, 2, 3)),
        np.zeros(0),
        (),
    )
    try:
        first = picked.solve(told, Camera(intrinsics(1.2 * SIZE[0], *SIZE), *SIZE, None), focal_known=False)
    except BadInput as bad:
        return str(bad)
    shown = further_views.photographs(case)[1]
    begin = time.process_time()
    found, _, why = picked_edges.refined(first, told, model, Photograph(shown / 255.0, 8, False, 3), False)
    return errors(first, camera), None if why else errors(found, camera), time.process_time() - begin, why


def errors(found, camera):
    """degrees, mm, sigma in mm, px of the principal point, chi2 of the pose, and of the focal length."""
    gap = rt_from_matrix(camera.T_cam_world @ np.linalg.inv(found.camera.T_cam_world))
    square = gap @ np.linalg.solve(found.covariance, gap)
    focal = np.log(camera.K[0, 0] / found.camera.K[0, 0]) / (found.focal_sigma_px / found.camera.K[0, 0])
    apart = 1000 * np.linalg.norm(found.camera.centre - camera.centre)
    centre = np.linalg.norm(camera.K[:2, 2] - found.camera.K[:2, 2])
    sigma = 1000 * np.sqrt(np.trace(found.covariance[3:, 3:]))
    return np.degrees(np.linalg.norm(gap[:3])), apart, sigma, centre, square, focal**2


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=40)
    parser.add_argument("--centre", nargs="+", default=["0", "normal", "0.03"])
    opt = parser.parse_args()
    for centre in opt.centre:
        with tempfile.TemporaryDirectory() as folder:
            rows = [row for k in range(opt.rooms) if (row := trial(500 + k, centre, Path(folder))) is not None]
        refused = [row for row in rows if isinstance(row, str)]
        rows = [row for row in rows if not isinstance(row, str)]
        for name, k in (("picked", 0), ("refined", 1)):
            of = np.array([row[k] for row in rows if row[k] is not None])
            middle = np.median(of, axis=0)
            inside, of_focal = np.mean(of[:, 4] < 12.59), np.mean(of[:, 5] < 3.84)
            print(
                f"{centre:7s} {name:8s} {len(of):3d} of {len(rows)} ({len(refused)} refused): median {middle[0]:.3f} deg",
                f"{middle[1]:.1f} mm (sigma {middle[2]:.1f}), centre {middle[3]:.1f} px; worst {of[:, 1].max():.0f} mm;",
                f"chi2 mean {of[:, 4].mean():.1f}, worst {of[:, 4].max():.0f}; inside 95 %: {inside:.0%},",
                f"focal length {of_focal:.0%}; {np.median([row[2] for row in rows]):.1f} CPU s",
                flush=True,
            )
        for row in rows:
            if row[3]:
                print("        ", row[3])


if __name__ == "__main__":
    main()
