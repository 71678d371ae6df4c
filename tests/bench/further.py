"""Further photographs of random rooms: errors of their poses, and whether those of other rooms are refused.

    $ python -m tests.bench.further build/further 1 2 3             # rooms 1, 2, 3, four photographs each; known lenses
    $ python -m tests.bench.further build/further --unknown 1 2 3   # their focal lengths are unknown
    $ python -m tests.bench.further build/further --other 1 2 3     # in each room the photographs of the next one

Rooms, pictures and truth: lib/synthetic/further_views.py.  Each line of further.csv is one photograph.
"""

import argparse
import csv
import time
from pathlib import Path

import numpy as np

from lib.given import model as models
from lib.given.cameras import Camera, intrinsics, rt_from_matrix
from lib.given.image import Photograph
from lib.synthetic import further_views as views_
from lib.verdict.vision_errors import angle_deg
from lib.vision.location import files, session
from lib.vision.location.locate import FIRST_FOCAL, Taken

HEAD = ("seed", "name", "status", "deg", "mm", "chi2", "focal", "support", "nats", "likeness", "cpu_s", "why")
CHI2_6 = 12.59  # 95 % of chi-square with 6 degrees of freedom


def one(seed, out, mode):
    """Rows of HEAD."""
    case = views_.further_views(seed)
    shown = views_.further_views(seed + 1) if mode == "other" else case
    size = case.recipe.size
    path = out / f"{seed}.obj"
    path.write_text(case.recipe.model()[0])
    model = models.load(path)
    left, shots = (views_.photographs(views) for views in (case, shown))
    photograph = lambda picture: Photograph(picture / 255.0, 8, False, 3)
    first = photograph(left[0])
    camera = Camera(case.recipe.K, *size, case.recipe.T_cam_world)
    known = [session.known(model, "left", camera, first, files.grey(first))]
    rows = []
    for k, (picture, lens, T_true) in enumerate(zip(shots[1:], shown.lenses, shown.poses, strict=True)):
        shot = photograph(picture)
        K = intrinsics(FIRST_FOCAL * max(size), *size) if mode == "unknown" else lens.K
        taken = Taken(str(k), shot, files.grey(shot), Camera(K, *size, np.eye(4)), mode != "unknown")
        begin = time.process_time()
        place = session.locate_all(model, known, [taken])[taken.name]
        cpu = time.process_time() - begin
        said = (place.support, place.evidence, place.likeness, cpu, place.why)
        if place.camera is None:
            rows.append((seed, k, "refused", "", "", "", "", *said))
        elif mode == "other":
            rows.append((seed, k, "wrong", "", "", "", "", *said))
        else:
            rows.append((seed, k, "found", *errors(place, T_true), place.camera.K[0, 0] / lens.K[0, 0] - 1, *said))
    return rows


def errors(place, T_true):
    """(degrees, mm of the centre, chi2 of the six numbers)."""
    T = place.camera.T_cam_world
    e = rt_from_matrix(T_true @ np.linalg.inv(T))
    apart = np.linalg.inv(T)[:3, 3] - np.linalg.inv(T_true)[:3, 3]
    chi2 = float(e @ np.linalg.solve(place.covariance, e))
    return angle_deg(T[:3, :3] @ T_true[:3, :3].T), float(1000 * np.linalg.norm(apart)), chi2


def summary(rows):
    """One line of text."""
    good = np.array([[float(x) for x in r[3:7]] for r in rows if r[2] == "found"]).reshape(-1, 4)
    text = f"{len(good)} of {len(rows)} found, {sum(r[2] == 'wrong' for r in rows)} of another room"
    if len(good):
        median, worst = np.median(np.abs(good), axis=0), np.abs(good).max(axis=0)
        inside = (good[:, 2] < CHI2_6).mean()
        text += f"; median {median[0]:.4f} deg, {median[1]:.2f} mm, focal length {median[3]:.2%}"
        text += f"; worst {worst[0]:.3f} deg, {worst[1]:.1f} mm, chi2 {worst[2]:.0f}; inside 95 % {inside:.0%}"
    return text + f"; {np.median([r[10] for r in rows]):.1f} CPU s each"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("seeds", type=int, nargs="+")
    parser.add_argument("--unknown", dest="mode", action="store_const", const="unknown", default="known")
    parser.add_argument("--other", dest="mode", action="store_const", const="other")
    opt = parser.parse_args()
    opt.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in opt.seeds:
        rows += one(seed, opt.out, opt.mode)
        print(seed, summary(rows), flush=True)
    with open(opt.out / f"further-{opt.mode}.csv", "w", newline="") as file:
        csv.writer(file).writerows([HEAD, *rows])


if __name__ == "__main__":
    main()
